"""Shapes: a radial deformation by a B-spline in spherical angles.

X' = s(p, θ, φ) X with θ = atan2(y, -z), φ = atan2(x, √(y² + z²)) and
s = Σ p_jk N_j(θ) N_k(φ), degree 2, clamped at ±π/2 (paper, (4) and (5)).
X' is linear in p, and every point moves along its ray from the sole frame's
origin.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

from drake_exo.errors import InputError

_DEGREE = 2


def spherical_angles(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """θ and φ [rad] of points (n, 3), origin on the top plane."""
    x, y, z = nodes.T
    # 0.0 - z, not -z: atan2(0, -0.0) = π on the top plane.
    theta = np.arctan2(y, 0.0 - z)
    return theta, np.arctan2(x, np.hypot(y, z))


@dataclass(frozen=True)
class SphericalSpline:
    """The spline's bookkeeping: knots, tied poles, fixed top.

    >>> import numpy as np
    >>> import drake_exo as dx
    >>> spline = dx.soles.SphericalSpline((4, 4))
    >>> spline.deform(np.array([[0.1, 0.0, -0.02]]), np.full(spline.count, 1.5))
    array([[ 0.15,  0.  , -0.03]])

    Free coefficients: with n_θ and n_φ knot intervals there are
    (n_θ + 2)(n_φ + 2) coefficients; each pole's n_θ + 2 are one, which
    leaves (n_θ + 2) n_φ + 2 (122 at the paper's spacing π/10). With the top
    surface fixed the first and last θ rows and the poles are 1, which leaves
    n_θ n_φ (100).

    Attributes:
        intervals: Number of knot intervals over [-π/2, π/2] in θ and φ.
        fixed_top: Keep the top surface as it is (the paper's case 5).
    """

    intervals: tuple[int, int] = (10, 10)
    fixed_top: bool = False

    def __post_init__(self):
        if min(self.intervals) < 1:
            raise InputError(
                f"spline: intervals {self.intervals} must be at least 1"
            )

    @property
    def count(self) -> int:
        """Number of free coefficients."""
        n_theta, n_phi = self.intervals
        if self.fixed_top:
            return n_theta * n_phi
        return (n_theta + 2) * n_phi + 2

    def free_map(self) -> tuple[csr_matrix, np.ndarray]:
        """T, p0 with (all coefficients, θ-major) = T · free + p0."""
        n_theta, n_phi = (n + 2 for n in self.intervals)
        column = np.full((n_theta, n_phi), -1)
        if self.fixed_top:
            inner = np.arange((n_theta - 2) * (n_phi - 2))
            column[1:-1, 1:-1] = inner.reshape(n_theta - 2, n_phi - 2)
        else:
            inner = np.arange(n_theta * (n_phi - 2))
            column[:, 1:-1] = inner.reshape(n_theta, n_phi - 2)
            column[:, 0] = inner.size
            column[:, -1] = inner.size + 1
        column = column.ravel()
        rows = np.flatnonzero(column >= 0)
        T = csr_matrix(
            (np.ones(len(rows)), (rows, column[rows])),
            shape=(column.size, self.count),
        )
        return T, (column < 0).astype(float)

    def basis(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scale s = M p + s0 at the nodes: M (n, count), s0 (n,)."""
        theta, phi = spherical_angles(nodes)
        N_theta = _basis_matrix(theta, self.intervals[0])
        N_phi = _basis_matrix(phi, self.intervals[1])
        full = np.einsum("nj,nk->njk", N_theta, N_phi).reshape(len(nodes), -1)
        T, p0 = self.free_map()
        return full @ T, full @ p0

    def stretch(self, nodes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Factor s in the directions of points, deformed or not (n,)."""
        M, s0 = self.basis(nodes)
        return M @ p + s0

    def deform(self, nodes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Node positions X' of the shape with free coefficients p."""
        return self.stretch(nodes, p)[:, None] * nodes


def _basis_matrix(angle: np.ndarray, intervals: int) -> np.ndarray:
    knots = np.linspace(-np.pi / 2, np.pi / 2, intervals + 1)
    t = np.concatenate(
        [np.full(_DEGREE, knots[0]), knots, np.full(_DEGREE, knots[-1])]
    )
    inside = np.clip(angle, knots[0], knots[-1])
    return BSpline.design_matrix(inside, t, _DEGREE).toarray()


def pull_back(
    nodes: np.ndarray, spline: SphericalSpline, p: np.ndarray
) -> np.ndarray:
    """Undeformed places X = X'/s of deformed nodes X' (n, 3) [m].

    s depends on the direction alone; the origin stays where it is.
    """
    return nodes / spline.stretch(nodes, p)[:, None]
