"""Shapes: a radial deformation by a B-spline in spherical angles.

X' = s(p, θ, φ) X with θ = atan2(y, -z), φ = atan2(x, √(y² + z²)) and
s = Σ p_jk N_j(θ) N_k(φ), degree 2, clamped at ±π/2 (paper, (4) and (5)).
X' is linear in p, and every point moves along its ray from the sole frame's
origin.
"""

from dataclasses import dataclass
from functools import cached_property

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
        symmetric: Left and right alike: s(−θ, φ) = s(θ, φ).
        kept: Of all coefficients, θ-major, further ones that are 1.
    """

    intervals: tuple[int, int] = (10, 10)
    fixed_top: bool = False
    symmetric: bool = False
    kept: tuple[int, ...] = ()

    def __post_init__(self):
        if min(self.intervals) < 1:
            raise InputError(
                f"spline: intervals {self.intervals} must be at least 1"
            )

    @property
    def count(self) -> int:
        """Number of free coefficients."""
        return int(self._column.max()) + 1

    @cached_property
    def _column(self) -> np.ndarray:
        """Of all coefficients, θ-major, the free one each is; -1: it is 1."""
        shape = n_theta, n_phi = tuple(n + 2 for n in self.intervals)
        index = np.arange(n_theta * n_phi).reshape(shape)
        tied = index.copy()
        # All of a pole's are one, the last ones: after those between.
        tied[:, 0], tied[:, -1] = index.size, index.size + 1
        if self.symmetric:
            tied = np.minimum(tied, tied[::-1])
        held = np.zeros(shape, dtype=bool)
        if self.fixed_top:
            held[[0, -1]] = held[:, [0, -1]] = True
        held.ravel()[list(self.kept)] = True
        held = np.isin(tied, tied[held])  # with those it is tied to
        if held.all():
            raise InputError(
                "optimize.shape: nothing of the sole is left to change; give "
                "smaller fixed patches, or more intervals"
            )
        out = np.full(shape, -1)
        out[~held] = np.unique(tied[~held], return_inverse=True)[1]
        return out.ravel()

    def free_map(self) -> tuple[csr_matrix, np.ndarray]:
        """T, p0 with (all coefficients, θ-major) = T · free + p0."""
        column = self._column
        rows = np.flatnonzero(column >= 0)
        T = csr_matrix(
            (np.ones(len(rows)), (rows, column[rows])),
            shape=(column.size, self.count),
        )
        return T, (column < 0).astype(float)

    def around(self, points: np.ndarray) -> tuple[int, ...]:
        """The coefficients that any of some points feels."""
        return tuple(np.flatnonzero(self._full(points).any(axis=0)).tolist())

    def _full(self, points: np.ndarray) -> np.ndarray:
        theta, phi = spherical_angles(points)
        N_theta = _basis_matrix(theta, self.intervals[0])
        N_phi = _basis_matrix(phi, self.intervals[1])
        full = np.einsum("nj,nk->njk", N_theta, N_phi)
        return full.reshape(len(points), -1)

    def basis(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scale s = M p + s0 at the nodes: M (n, count), s0 (n,)."""
        full = self._full(nodes)
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
