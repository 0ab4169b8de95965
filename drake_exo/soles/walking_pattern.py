"""Walking pattern of one cyclic step: ZMP, CoM and forces of one foot.

`plan` solves the quadratic programme of docs/soles.md for the CoM c and the ZMP
z: c̈ = ω² (c − z), ω² = g / h. One step later the state is the same, mirrored
and one step length ahead. The landing foot is the right one; its sole frame is
used (y to the left). `Gait` gives a search walks to choose from.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import null_space
from scipy.optimize import LinearConstraint, brentq, minimize, nnls
from scipy.spatial import ConvexHull

from drake_exo.errors import InputError
from drake_exo.files.schema import not_negative, positive, quantity
from drake_exo.soles.loads import Load

_DEGREE, _PIECES, _GRID = 5, 16, 161
_SPEED_TIME = 0.03  # [s]; turns the ZMP's speed into a distance in the cost
_LEAST = 1e-8  # regularisation, over the cost's size
_LEFT = 1e-10  # residual (of 1) below which no ZMP keeps inside its bounds
_HOLD = 1e2  # weight [1/s²] of keeping the feet's own ZMPs to parabolas
_SIDES = "back_m", "outer_m", "front_m", "inner_m"
_INSIDE = 0.015  # metres that the ZMP stays inside a sole's outline


def gravity() -> Any:
    """A settings field for gravity, of the moon as well [m/s²]."""
    return quantity("m/s²", 9.81, minimum=0.1, maximum=100.0)


def _place(default: Any) -> Any:
    """A settings field for places in a sole's frame, which are no mm."""
    return quantity("m", default, minimum=-2.0, maximum=2.0)


@dataclass(frozen=True)
class Robot:
    """Robot (or person) and step to plan; defaults: the authors' 80 kg robot.

    Attributes:
        step_length_m: Distance between consecutive footprints along x.
        step_width_m: Distance between the middles of the soles along y.
        step_time_s: Duration of one step, double support included.
        back_m, front_m: Bounds of the ZMP in single support along the sole.
        outer_m, inner_m: Likewise across, the latter towards the other
            foot. By default those of `within` the sole, or without a sole
            those of the authors' robot.
        ankle_m: Place of the ankle in the sole frame (x, y).
        torque_weight: Factor w of the ankle torque in the cost.
        period_s: Time between samples.
        first_s: Time since landing from which samples are counted.
        least_share: Samples are left out below this part of the weight.
        free: What a search may change of it; zmp is the ZMP's path, by the
            place near the ankle that it is drawn to, and how strongly.
    """

    mass_kg: float = quantity("kg", 80.0, minimum=0.5)
    com_height_m: float = quantity("m", 0.8085, minimum=0.01, maximum=3.0)
    step_length_m: float = quantity("m", 0.2633, above=0.0, maximum=3.0)
    step_width_m: float = quantity("m", 0.162, above=0.0, maximum=3.0)
    step_time_s: float = quantity("s", 1.0, above=0.0, maximum=20.0)
    double_support_s: float = positive("s", 0.195)
    back_m: float | None = _place(None)
    front_m: float | None = _place(None)
    inner_m: float | None = _place(None)
    outer_m: float | None = _place(None)
    ankle_m: tuple[float, float] = _place((-0.017, 0.011))
    torque_weight: float = not_negative("", 0.6)
    gravity_m_per_s2: float = gravity()
    period_s: float = quantity("s", 0.005, minimum=1e-4)
    first_s: float = quantity("s", 0.0, minimum=0.0, maximum=40.0)
    least_share: float = quantity(None, 0.13, above=0.0, below=1.0)
    free: tuple[
        Literal["step_length", "step_time", "double_support", "zmp"], ...
    ] = ()

    def __post_init__(self):
        if not 0 < self.double_support_s < self.step_time_s:
            raise InputError(
                "pattern: double_support_s must be above 0 and below "
                "step_time_s"
            )
        if "zmp" in self.free and self.torque_weight == 0.0:
            raise InputError(
                "pattern.free: zmp is sought by the place that the ZMP is "
                "drawn to, and how strongly, but torque_weight is 0; give one "
                "above 0, or leave zmp out"
            )
        low, high = self.bounds
        if not (low < high).all():
            raise InputError(
                "pattern: back_m must be below front_m and outer_m below "
                "inner_m: places in the sole's frame; leave them out for "
                "15 mm inside the sole"
            )

    @property
    def omega2(self) -> float:
        """ω² [1/s²]."""
        return self.gravity_m_per_s2 / self.com_height_m

    @property
    def bounds(self) -> np.ndarray:
        """Bounds of the ZMP in single support [m]: low, high (x, y), (2, 2)."""
        given = [getattr(self, name) for name in _SIDES]
        both = zip(given, (-0.1, -0.05, 0.1, 0.05), strict=True)
        return np.reshape([b if a is None else a for a, b in both], (2, 2))

    @property
    def bearing(self) -> tuple[float, float]:
        """Times since landing between which it bears `least_share` [s]."""
        begin = self.double_support_s * brentq(
            lambda s: smooth_share(s) - self.least_share, 0.0, 1.0
        )
        return begin, self.step_time_s + self.double_support_s - begin

    def within(self, places: np.ndarray) -> "Robot":
        """The robot with bounds that are not given set 15 mm inside a sole.

        Args:
            places: Places of the sole's nodes in its frame [m], (m, 2); the
                bounds are those of the largest rectangle inside.

        Raises:
            InputError: The sole is too narrow.
        """
        free = [name for name in _SIDES if getattr(self, name) is None]
        if not free:
            return self
        fit = dict(zip(_SIDES, _rectangle(places), strict=True))
        return replace(self, **{name: fit[name] for name in free})

    def load(self, root: Path | None = None) -> Load:
        """Plan the step and return the right foot's load."""
        load = plan(self).foot_load()
        if self.free and len(load.times) < 2:
            raise InputError(
                "pattern.free: a walk is sought over two samples or more, and "
                "this one has one; give a smaller period_s or first_s"
            )
        return load


def _rectangle(places: np.ndarray) -> list[float]:
    """Largest axis-parallel rectangle 15 mm inside the hull of places (m, 2).

    Returns lowest x, y and highest x, y [m], to 0.1 mm.
    """
    *normal, offset = ConvexHull(places).equations.T
    # Inside, if its farthest corner in the direction of every edge is.
    corner = np.vstack([np.minimum(normal, 0), np.maximum(normal, 0)]).T
    margin = -offset - _INSIDE
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    found = minimize(
        lambda x: -np.log(np.maximum(x[2:] - x[:2], 1e-9)).sum(),
        np.concatenate([middle - 1e-3, middle + 1e-3]),
        method="SLSQP",
        constraints=LinearConstraint(corner, -np.inf, margin),
    )
    low, high = np.split(found.x, 2)
    if (corner @ found.x > margin + 1e-6).any() or (low >= high).any():
        raise InputError(
            "pattern: no place of the sole lies 15 mm inside its outline; "
            "give back_m, front_m, outer_m and inner_m, or a larger sole"
        )
    return np.round(found.x, 4).tolist()


@dataclass(frozen=True)
class Pattern:
    """Planned motion of one step, from landing to the next landing.

    Attributes:
        robot: Robot and step that were planned.
        com: Spline of the CoM's x, y [m] over [0, step_time].
    """

    robot: Robot
    com: BSpline

    def zmp(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """ZMP z = c − c̈ / ω² at times t [s], or a derivative, (n, 2)."""
        return _zmp(self.com, self.robot.omega2, t, order)

    def at(self, spline: BSpline, t: np.ndarray, order: int = 0) -> np.ndarray:
        """A spline (or derivative) over this step and the mirrored next one."""
        T = self.robot.step_time_s
        late = t > T
        out = spline(np.where(late, t - T, t), order)
        if order:
            out[late, 1] *= -1
        else:
            out[late] = _mirrored(out[late], self.robot)
        return out

    def foot_load(self, like: Robot | None = None) -> Load:
        """Force and ZMP of the right foot over its whole contact phase.

        Args:
            like: Robot whose number of samples is taken, spread over the time
                in which this foot bears at least `least_share`.
        """
        robot, other = self.robot, like or self.robot
        T, D = robot.step_time_s, robot.double_support_s
        first, last = other.bearing
        t = np.arange(robot.first_s, last + 1e-9, robot.period_s)
        t = t[t >= first]
        if len(t) == 0:
            raise InputError(
                f"pattern: no sample lies between {first:.3g} and {last:.3g} s "
                "after landing, where the foot bears least_share of the "
                "weight; give a smaller period_s or first_s"
            )
        if like is not None:
            begin, end = robot.bearing
            t = begin + (t - first) * (end - begin) / (last - first)
        z, acceleration = self.at(self.zmp, t), self.at(self.com, t, 2)
        share = smooth_share(t / D) * (1 - smooth_share((t - T) / D))
        upward = np.full((len(t), 1), robot.gravity_m_per_s2)
        total = robot.mass_kg * np.hstack([acceleration, upward])
        return Load(
            t, share[:, None] * total, self._own_zmp(t, z), "walking pattern"
        )

    def _own_zmp(self, t, z):
        """ZMP under the right foot at times t, of the total ZMP z, (n, 2).

        In double support the feet's ZMPs are parabolas a(t) and b(t) that
        continue those of single support, plus ρ = z − (1 − α) a − α b each.
        """
        T, D = self.robot.step_time_s, self.robot.double_support_s
        own = z.copy()
        for first in (True, False):
            rows = t <= D if first else t >= T
            s = t[rows] - (0.0 if first else T)
            a, b = _feet(self.zmp, 0.0, s, D)
            share = smooth_share(s / D)[:, None]
            line = b if first else a
            if not first:
                line = _mirrored(line, self.robot)
                a, b = (_mirrored(q, self.robot) for q in (a, b))
            own[rows] = line + z[rows] - (1 - share) * a - share * b
        return own


def smooth_share(s: np.ndarray) -> np.ndarray:
    """Share of weight on the landing foot: quintic from 0 to 1, C² at ends."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def _feet(z, last: float, s, D: float):
    """ZMPs of the foot that unloads and of the landing one, s after landing.

    The first is a parabola from z's place and speed at time `last` to rest; the
    second starts at rest and reaches z's place and speed at D.
    """
    s = np.asarray(s)[..., None]
    forth, back = s - s**2 / (2 * D), (s - D) + (s - D) ** 2 / (2 * D)
    return z(last) + forth * z(last, 1), z(D) + back * z(D, 1)


def _mirrored(points, robot: Robot):
    """Points (n, 2) a step later: ahead by its length, mirrored sideways."""
    return np.stack(
        [points[:, 0] + robot.step_length_m, robot.step_width_m - points[:, 1]],
        axis=1,
    )


def plan(robot: Robot) -> Pattern:
    """Plan the step: solve the quadratic programme, one for x and one for y.

    Raises:
        InputError: No ZMP inside the bounds carries such a step.
    """
    T, D = robot.step_time_s, robot.double_support_s
    omega2 = robot.omega2
    knots = np.pad(np.linspace(0, T, _PIECES + 1), _DEGREE, mode="edge")
    basis = BSpline(knots, np.eye(_PIECES + _DEGREE), _DEGREE)
    t = np.linspace(0, T, _GRID)
    z = partial(_zmp, basis, omega2)
    landing, alone, off = t[t < D], t[t >= D], t[t <= D]
    # The bounds hold as the right foot lands and as it lifts off, too.
    ends = _feet(z, T, 0.0, D)[1], _feet(z, T, D, D)[0]
    inside = np.vstack([z(alone), *ends])
    # In double support z = (1 − α) a + α b is a term of the cost.
    alpha, (a, b) = smooth_share(off / D)[:, None], _feet(z, 0.0, off, D)
    hold = _HOLD * (z(off) - (1 - alpha) * a - alpha * b)
    # One foot's ZMP times its share, from landing to lift-off.
    own = _feet(z, T, landing, D)[1], z(alone), _feet(z, T, off, D)[0]
    share = np.concatenate(
        [smooth_share(landing / D), 0 * alone + 1, 1 - smooth_share(off / D)]
    )
    own = share[:, None] * np.concatenate(own)
    torque = np.sqrt(robot.torque_weight) * omega2
    speed = _SPEED_TIME * (omega2 * basis(t, 1) - basis(t, 3))
    coefficients = []
    for k, (sign, shift, low, high) in enumerate(
        zip(
            (1.0, -1.0), (robot.step_length_m, robot.step_width_m),
            *robot.bounds, strict=True,
        )
    ):  # fmt: skip
        # Ankle torque m g (z − a) times the share, over m h: an acceleration.
        A = np.concatenate([basis(t, 2), torque * own, hold, speed])
        b = np.zeros(len(A))
        b[len(t) : len(t) + len(own)] = torque * share * robot.ankle_m[k]
        # Cyclic in all derivatives o: c⁽ᵒ⁾(T) = ± c⁽ᵒ⁾(0), one step ahead.
        cycle = [basis(T, o) - sign * basis(0.0, o) for o in range(_DEGREE)]
        size = np.linalg.norm(cycle, axis=1)
        ahead = shift * np.eye(_DEGREE)[0] / size
        coefficients.append(
            _least_squares(
                A, b, cycle / size[:, None], ahead, inside, low, high
            )
        )
    return Pattern(robot, BSpline(knots, np.stack(coefficients, 1), _DEGREE))


def _least_squares(A, b, equal, value, rows, low, high) -> np.ndarray:
    """The p of least |A p − b|² with equal p = value, low <= rows p <= high.

    Equalities are eliminated: with fourth derivatives beside positions they are
    badly conditioned. p is smooth while the same inequalities are active.
    """
    p0 = np.linalg.lstsq(equal, value)[0]
    free = null_space(equal)
    H, r, inside = A @ free, b - A @ p0, rows @ free
    low, high = low - rows @ p0, high - rows @ p0
    rows, at = np.vstack([inside, -inside]), np.concatenate([low, -high])
    held = _held(H, r, rows, at)
    if not held.any():
        return p0 + free @ np.linalg.lstsq(H, r)[0]
    base = np.linalg.lstsq(rows[held], at[held])[0]
    Z = null_space(rows[held])
    y = base + Z @ np.linalg.lstsq(H @ Z, r - H @ base)[0]
    return p0 + free @ y


def _held(H, r, rows, at) -> np.ndarray:
    """Which of rows y >= at are active at the y of least |H y − r|, (k,) bool.

    Least-distance programming in x = R y − Qᵀ r, H = Q R: the rows with a
    multiplier above 0 (Lawson and Hanson, Solving Least Squares Problems,
    1974, chapter 23).
    """
    # Without a cost of torque some walks cost nothing: R would be singular.
    least = _LEAST * np.linalg.norm(H) * np.eye(H.shape[1])
    Q, R = np.linalg.qr(np.vstack([H, least]))
    W = np.linalg.solve(R.T, rows.T)
    size = np.linalg.norm(W, axis=0)
    above = (at - W.T @ (Q[: len(H)].T @ r)) / size
    E = np.vstack([W / size, above / np.abs(above).max()])
    multipliers, left = nnls(E, np.eye(len(E))[-1])
    if left < _LEFT:
        raise InputError(
            "pattern: no ZMP inside its bounds carries this step; widen "
            "back_m to front_m and outer_m to inner_m, slow the step, or "
            "lengthen double_support_s"
        )
    return multipliers > 0


def _zmp(spline, omega2, at, order=0):
    """ZMP z = c − c̈/ω² of a CoM's spline at times `at`, or a derivative."""
    return spline(at, order) - spline(at, order + 2) / omega2


# Robot's attribute of a walk's number, and its range as factors.
_REACH = {
    "step_length": ("step_length_m", 0.75, 1.25),
    "step_time": ("step_time_s", 0.75, 1.25),
    "double_support": ("double_support_s", 0.5, 2.0),
    "torque_weight": ("torque_weight", 0.25, 4.0),
}
_AIM = {"aim_x": 0.04, "aim_y": 0.02}  # range to both sides of the ankle [m]
_MORE = 1.1  # limit on acceleration and sway over the case's own walk
_SLIP = 0.9  # limit on friction used, over μ
_DRAWN = 100  # trials at most for one walk that keeps the limits
_STEP = 1e-4  # step of central differences, over a variable's range


@dataclass(frozen=True)
class Gait:
    """A walk with G free numbers, each a variable from 0 to 1 in its range.

    The number of samples stays the same, evenly over the contact. Limits, at
    least 0 where kept: the walk is no slower and its foot loaded no longer; the
    CoM's acceleration and sway stay within 1.1 of those of the case's own walk,
    friction within 0.9 of the cone.

    Attributes:
        robot: The case's own walk.
        friction: Coulomb's coefficient μ.
        up: Normal of the plane that fits the ground, (3,).
    """

    robot: Robot
    friction: float
    up: tuple[float, ...] = (0.0, 0.0, 1.0)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of the free numbers, by name."""
        own, free = self.numbers(self.robot), self.robot.free
        by_zmp = "zmp" in free
        found = {
            name: (low * own[name], high * own[name])
            for name, (_, low, high) in _REACH.items()
            if name in free or (name == "torque_weight" and by_zmp)
        }
        aims = _AIM.items() if by_zmp else ()
        return found | {n: (own[n] - by, own[n] + by) for n, by in aims}

    @staticmethod
    def numbers(robot: Robot) -> dict[str, float]:
        """All numbers that may be free, by name."""
        own = {name: getattr(robot, key) for name, (key, *_) in _REACH.items()}
        return own | dict(zip(_AIM, robot.ankle_m, strict=True))

    @property
    def start(self) -> np.ndarray:
        """Variables of the case's own walk, (G,)."""
        own, ranges = self.numbers(self.robot), self.ranges
        low, high = np.transpose(list(ranges.values()))
        return (np.array([own[n] for n in ranges]) - low) / (high - low)

    def walk(self, number: int) -> np.ndarray:
        """Variables of the case's own walk (0) or of another start, (G,).

        The others are the points of Halton's sequence that keep the limits.
        """
        if number == 0:
            return self.start
        # SciPy's statistics take a second to load.
        from scipy.stats.qmc import Halton

        found, drawn = 0, Halton(len(self.start), scramble=False)
        for _ in range(_DRAWN * number):
            (x,) = drawn.random(1)
            try:
                limits = self.limits(x).values()
            except InputError:  # no such walk
                continue
            keeps = all((limit >= 0).all() for limit in limits)
            # With a single free number the sequence meets the case's own.
            found += keeps and not np.allclose(x, self.start)
            if found == number:
                return x
        return self.start

    def at(self, x: np.ndarray) -> Robot:
        """The walk of variables (G,)."""
        own, ranges = self.numbers(self.robot), self.ranges
        low, high = np.transpose(list(ranges.values()))
        own |= zip(ranges, (low + x * (high - low)).tolist(), strict=True)
        ankle = own.pop("aim_x"), own.pop("aim_y")
        named = {_REACH[name][0]: value for name, value in own.items()}
        return replace(self.robot, ankle_m=ankle, **named)

    def load(self, x: np.ndarray) -> Load:
        """Load of the right foot in the walk of variables x (G,)."""
        return self._walked(self.at(x))[0]

    def _walked(self, robot: Robot):
        """Load, speed [m/s], |c̈| [m/s²] and the CoM's sway [m] over time."""
        pattern, t = plan(robot), np.linspace(0, robot.step_time_s, 41)
        return (
            pattern.foot_load(self.robot),
            robot.step_length_m / robot.step_time_s,
            np.linalg.norm(pattern.com(t, 2), axis=1),
            pattern.com(t)[:, 1] - robot.step_width_m / 2,
        )

    @cached_property
    def _own(self):
        return self._walked(self.robot)

    def limits(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Scaled limits of a walk, at least 0 where kept, by name."""
        return self._planned(x)[1]

    def _planned(self, x) -> tuple[Load, dict[str, np.ndarray]]:
        load, speed, acceleration, sway = self._walked(self.at(x))
        first, usual, own, its = self._own
        used = load.friction_used(np.array(self.up))
        bears = np.ptp(load.times) / np.ptp(first.times)
        return load, {
            "speed": np.array([speed / usual - 1.0]),
            "contact": np.array([1.0 - bears]),
            "acceleration": _MORE - acceleration / own.max(),
            "sway": _MORE - np.abs(sway) / np.abs(its).max(),
            "friction": _SLIP - used / self.friction,
        }

    def slopes(self, x: np.ndarray) -> tuple[np.ndarray, dict]:
        """Derivatives by the variables: of force and ZMP (G, N, 5), of limits.

        Limits are by name, (k, G). By central differences of the programme's
        exact optimum, which is smooth while the same bounds hold the ZMP.
        """
        loads, limits = [], []
        for d in _STEP * np.eye(len(x)):
            (a, ahead), (b, behind) = (
                self._planned(x + s * d) for s in (1, -1)
            )
            loads.append(np.hstack([a.force - b.force, a.zmp - b.zmp]))
            limits.append([ahead[name] - behind[name] for name in ahead])
        by_name = zip(ahead, zip(*limits, strict=True), strict=True)
        return np.array(loads) / (2 * _STEP), {
            name: np.transpose(change) / (2 * _STEP) for name, change in by_name
        }
