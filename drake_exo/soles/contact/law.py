"""Contact law of a node (Signorini's and Coulomb's), and the ground.

The law is φ = 0 with the residual φ = F − T(τ), τ = F − r δ: F is the force of
the ground on the node, δ the node's place relative to its reference, and

    p = plus_ε(τ_n),  g = μ p,  T = (τ_t / s, p),  s = 1 + plus_κ(|τ_t|/g − 1)

the projection onto the friction cone. ε = r ℓ (layer thickness ℓ) and κ smooth
its corners to be twice differentiable; ε = κ = 0 is the exact law, with the
same solutions as Alart–Curnier's. With D = ∂T/∂τ: ∂φ/∂F = I − D, ∂φ/∂δ = r D.

The ground is flat, or a bicubic spline through heights on a grid. A node meets
its tangent plane below the node's place at the sample before: exact on a slope
and for nodes that stick, else off by half the curvature times the slip squared.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline

from drake_exo.errors import InputError
from drake_exo.soles.numerics import hat, njit


@dataclass(frozen=True)
class ContactLaw:
    """Parameters of the contact law.

    Attributes:
        friction: Coulomb's coefficient μ.
        penalty: r [N/m], positive; scales the residual, fixed over designs.
        layer: Thickness ℓ of the smoothed normal law [m]; 0 is exact.
        kappa: Width κ of the smoothed stick-slip corner; 0 is exact.
    """

    friction: float
    penalty: float
    layer: float = 0.0
    kappa: float = 0.0

    @property
    def epsilon(self) -> float:
        """ε = r ℓ [N]."""
        return self.penalty * self.layer


@njit()
def smooth_plus(x, width):
    """max(x, 0) with a twice differentiable corner, and its slope.

    The corner is [-width, width]; x may be complex (complex-step derivatives).
    """
    if x.real <= -width:
        return 0.0 * x, 0.0 * x
    if not x.real < width:  # NaN, too
        return x, 1.0 + 0.0 * x
    t = x / width
    square = t * t  # a power of a complex number would lose the tiny step
    value = width * (t / 2 + 3 / 8 * square - square * square / 16 + 3 / 16)
    return value, 1 / 2 + 3 / 4 * t - square * t / 4


def project(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """T(τ) [N] of nodes, both in the axes of their planes, (k, 3)."""
    return project_with_derivative(tau, law)[0]


def project_with_derivative(
    tau: np.ndarray, law: ContactLaw
) -> tuple[np.ndarray, np.ndarray]:
    """T(τ) (k, 3) and D = ∂T/∂τ (k, 3, 3) of nodes, see `project`."""
    tau = np.ascontiguousarray(tau)
    return _project(tau, law.friction, law.epsilon, law.kappa)


@njit()
def _project(tau, mu, epsilon, kappa):
    T = np.empty_like(tau)
    D = np.empty((len(tau), 3, 3), tau.dtype)
    for i in range(len(tau)):
        project_node(tau[i], mu, epsilon, kappa, T[i], D[i])
    return T, D


@njit()
def project_node(tau, mu, epsilon, kappa, T, D):
    """Write T(τ) and D of one node into T (3,) and D (3, 3)."""
    p, dp = smooth_plus(tau[2], epsilon)
    g = mu * p
    T[:] = 0.0
    T[2] = p
    D[:, :] = 0.0
    D[2, 2] = dp
    if g.real <= 0.0:
        return
    rho = np.sqrt(tau[0] * tau[0] + tau[1] * tau[1])
    if rho.real <= (1.0 - kappa) * g.real:  # sticks
        T[0], T[1] = tau[0], tau[1]
        D[0, 0] = D[1, 1] = 1.0
        return
    # T_t = scale τ_t; its derivatives along τ_t (less scale) and by g.
    if rho.real >= (1.0 + kappa) * g.real:  # slips
        scale = g / rho
        radial, by_g = -scale, 1.0 + 0.0 * scale
    else:
        plus, slope = smooth_plus(rho / g - 1.0, kappa)
        s = 1.0 + plus
        scale = 1.0 / s
        share = rho / (g * s)
        radial, by_g = -slope * share / s, slope * share * share
    for a in range(2):
        T[a] = scale * tau[a]
        for b in range(2):
            D[a, b] = radial * (tau[a] / rho) * (tau[b] / rho)
        D[a, a] += scale
        D[a, 2] = by_g * mu * dp * tau[a] / rho


def firmly_sticking(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """Which nodes have T(τ) = τ: pressed beyond ε and inside the cone, (k,)."""
    rho = np.hypot(tau[:, 0], tau[:, 1])
    cone = (1 - law.kappa) * law.friction * tau[:, 2]
    return (tau[:, 2] > law.epsilon) & (rho <= cone)


_EDGE = 1e-10  # of the whole force: error that a node's force is left with


def at_rest(tau: np.ndarray, law: ContactLaw, force: np.ndarray) -> np.ndarray:
    """τ (m, 3) in planes' axes, with nodes at the cone's edge moved inside it.

    These slipped and came to rest, so they stick; else rounding would decide
    whether they slip. `force` is the whole sole's [N], (3,).
    """
    left, along = _EDGE * np.linalg.norm(force), np.hypot(*tau[:, :2].T)
    rests = np.abs(along - law.friction * project(tau, law)[:, 2]) <= left
    inside = np.maximum(1 - 2 * left / np.maximum(along, left), 0)
    out = tau.copy()
    out[rests, :2] *= inside[rests, None]
    return out


COLUMNS = ("x_m", "y_m", "z_m")
ARRAYS = ("ground_x", "ground_y", "ground_z")
_LEAST = 4  # grid lines along an axis, for cubic pieces
_STEEPEST = 1.0  # 45°
_WIDEST_M = 1.0  # between grid lines
_ZMP_STEPS = 8  # of Newton's


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground: heights over a grid, or without any the plane z = 0.

    Attributes:
        x, y: Increasing grid lines [m], (a,) and (b,).
        z: Heights [m], (a, b).
    """

    x: np.ndarray = None
    y: np.ndarray = None
    z: np.ndarray = None

    @classmethod
    def of_table(cls, table: dict[str, np.ndarray], name: str) -> "Ground":
        """Make the ground from columns `COLUMNS`, a row for each grid point.

        Raises:
            InputError: Points are no grid, too few, too far apart, too steep.
        """
        x, y, z = (table[key] for key in COLUMNS)
        (lines_x, i), (lines_y, j) = (
            np.unique(np.round(v, 9), return_inverse=True) for v in (x, y)
        )
        count = len(lines_x), len(lines_y)
        cells = np.unique(i * count[1] + j)
        # A cloud of points would be a grid too large for any memory.
        if not len(z) == len(cells) == count[0] * count[1]:
            raise InputError(
                f"{name}: {len(z)} points are not a grid of {count[0]} x "
                f"{count[1]}; give one row for every x with every y"
            )
        heights = np.empty(count)
        heights[i, j] = z
        if min(count) < _LEAST:
            raise InputError(
                f"{name}: a grid of {count[0]} x {count[1]} points is too "
                f"small; give at least {_LEAST} x {_LEAST}"
            )
        apart = max(np.diff(lines_x).max(), np.diff(lines_y).max())
        if apart > _WIDEST_M:
            raise InputError(
                f"{name}: its points lie up to {apart:g} m apart, too far for "
                "a sole to stand on several; give places in metres"
            )
        slopes = np.hypot(*np.gradient(heights, lines_x, lines_y))
        if slopes.max() > _STEEPEST:
            a, b = np.unravel_index(slopes.argmax(), count)
            raise InputError(
                f"{name}: near x {lines_x[a]:g} m, y {lines_y[b]:g} m the "
                f"ground is as steep as {slopes.max():.3g}, but a sole cannot "
                "stand on slopes above 1 (45°); give heights in metres"
            )
        return cls(lines_x, lines_y, heights)

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return self.z is None

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        return RectBivariateSpline(self.x, self.y, self.z)

    def _at(self, P: np.ndarray, dx: int = 0, dy: int = 0) -> np.ndarray:
        """Height or a derivative below places (k, 2 or 3); (k,)."""
        if self.is_flat:
            return np.zeros(len(P))
        return self._spline.ev(P[:, 0], P[:, 1], dx=dx, dy=dy)

    def height(self, P: np.ndarray) -> np.ndarray:
        """Height of the ground [m], (k,), below places (k, 2) or (k, 3) [m]."""
        return self._at(P)

    def slope(self, P: np.ndarray) -> np.ndarray:
        """∂h/∂x and ∂h/∂y below places, (k, 2)."""
        return np.stack([self._at(P, 1, 0), self._at(P, 0, 1)], axis=1)

    def check_below(self, places: np.ndarray, name: str) -> None:
        """Refuse a grid that does not reach below all places (k, 2) [m].

        Raises:
            InputError: Says where heights are needed.
        """
        if self.is_flat:
            return
        low, high = places.min(axis=0), places.max(axis=0)
        here = np.array([[self.x[0], self.y[0]], [self.x[-1], self.y[-1]]])
        if (low < here[0]).any() or (high > here[1]).any():
            raise InputError(
                f"{name}: the grid spans x {here[0, 0]:g} to {here[1, 0]:g} m "
                f"and y {here[0, 1]:g} to {here[1, 1]:g} m, and the sole "
                f"stands on x {low[0]:g} to {high[0]:g} m and y {low[1]:g} to "
                f"{high[1]:g} m; give heights below all of it, in its frame"
            )

    def normal(self, P: np.ndarray) -> np.ndarray:
        """Upward normal of the plane that fits the ground below P, (3,)."""
        n = np.append(-self.slope(P).mean(axis=0), 1.0)
        return n / np.linalg.norm(n)

    def planes(self, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tangent planes of the ground below world places P (m, 3) [m].

        Returns:
            The places projected onto these planes [m], (m, 3); the planes'
            axes as rows, two along them and the normal, (m, 3, 3).
        """
        if self.is_flat:
            return P * [1.0, 1.0, 0.0], np.tile(np.eye(3), (len(P), 1, 1))
        hx, hy = self.slope(P).T
        zero, one = np.zeros_like(hx), np.ones_like(hx)
        n = np.stack([-hx, -hy, one], axis=1)
        along = np.stack([one, zero, hx], axis=1)
        n, along = (
            v / np.linalg.norm(v, axis=1, keepdims=True) for v in (n, along)
        )
        gap = (P[:, 2] - self.height(P)) * n[:, 2]
        axes = np.stack([along, np.cross(n, along), n], axis=1)
        return P - gap[:, None] * n, axes

    def plane_derivatives(self, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `planes` by the places, (m, 3, 3) each.

        Of the projected places, and of the planes' turn [rad/m].
        """
        n = self.planes(P)[1][:, 2]
        xx, xy, yy = (self._at(P, *d) for d in ((2, 0), (1, 1), (0, 2)))
        by = np.zeros((len(P), 3, 3))  # of (−∂h/∂x, −∂h/∂y, 1)
        by[:, 0, 0], by[:, 0, 1] = -xx, -xy
        by[:, 1, 0], by[:, 1, 1] = -xy, -yy
        across = np.eye(3) - n[:, :, None] * n[:, None, :]
        by_n = n[:, 2, None, None] * across @ by
        above = P[:, 2] - self.height(P)
        moved = across - above[:, None, None] * (
            n[:, :, None] * by_n[:, 2:] + n[:, 2, None, None] * by_n
        )
        return moved, hat(n) @ by_n

    def zero_moment_point(self, F: np.ndarray, P: np.ndarray) -> np.ndarray:
        """ZMP on the ground with its height [m], (N, 3), of nodal forces.

        F [N] at places P [m], (N, m, 3) each; NaN without upward force.
        """
        out = np.full((len(F), 3), np.nan)
        there = F[:, :, 2].sum(axis=1) != 0
        F, P = F[there], P[there]
        total, level = F.sum(axis=1), P[:, :, :2] * F[:, :, 2:]
        z = level.sum(axis=1) / total[:, 2:]
        level = (level - P[:, :, 2:] * F[:, :, :2]).sum(axis=1)
        along, up = total[:, :2], total[:, 2:]
        for _ in range(1 if self.is_flat else _ZMP_STEPS):
            off = level + self.height(z)[:, None] * along - up * z
            slope = self.slope(z)
            rise, turn = (
                (slope * x).sum(axis=1, keepdims=True) for x in (off, along)
            )
            z = z + (off + along * rise / (up - turn)) / up
        out[there] = np.column_stack([z, self.height(z)])
        return out

    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays to keep in history.npz; none of a flat ground."""
        if self.is_flat:
            return {}
        return dict(zip(ARRAYS, (self.x, self.y, self.z), strict=True))

    @classmethod
    def of_arrays(cls, kept) -> "Ground":
        """The ground whose `arrays` are among those kept, else the flat one."""
        if ARRAYS[0] not in kept:
            return FLAT
        return cls(*(kept[name] for name in ARRAYS))

    def summary(self, P: np.ndarray) -> dict[str, float]:
        """What summary.json says of the ground below places (k, 2)."""
        h, slope = self.height(P), np.hypot(*self.slope(P).T)
        return {
            "relief_m": float(np.ptp(h)),
            "steepest_deg": float(np.rad2deg(np.arctan(slope.max()))),
        }


FLAT = Ground()
