"""Equilibrium of one sample: nodal forces and foot pose by one Newton method.

The method is semismooth. Unknowns are the forces F_i of the ground on the
contact nodes (world frame) and the foot's pose (O, R); equations are the law at
every contact node, and force and moment about the desired ZMP. Loops over all
contact nodes are compiled. Symbols as in docs/soles.md.
"""

from dataclasses import dataclass, replace

import numpy as np

from drake_exo.soles.contact.law import (
    FLAT,
    ContactLaw,
    Ground,
    at_rest,
    project_node,
)
from drake_exo.soles.contact.linearisation import ActiveSet, Linearisation, Turn
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.numerics import (
    exp_rotation,
    hat,
    njit,
    rotation_vector,
    rotation_z,
    yaw_of,
)


@njit()
def deformed(C, lP, R, F):
    """Places of the contact nodes relative to O, world [m], (m, 3).

    Y = R (lP + C Rᵀ F); C, lP as in `ContactSolver`, F (m, 3) in the world.
    """
    m = len(lP)
    u = np.zeros(3 * m)
    for i in range(m):
        x, y, z = F[i, 0], F[i, 1], F[i, 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        f0 = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
        f1 = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
        f2 = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        # C is symmetric: its rows lie together in memory.
        c0, c1, c2 = C[3 * i], C[3 * i + 1], C[3 * i + 2]
        for j in range(3 * m):
            u[j] += f0 * c0[j] + f1 * c1[j] + f2 * c2[j]
    Y = np.empty((m, 3))
    for i in range(m):
        # Added last: rest positions are large compared with displacements.
        x, y = lP[i, 0] + u[3 * i], lP[i, 1] + u[3 * i + 1]
        z = lP[i, 2] + u[3 * i + 2]
        for k in range(3):
            Y[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z
    return Y


@njit()
def residual(P, F, Q, axes, zmp, r, mu, epsilon, kappa):
    """Residuals at world places P [m] and forces F [N], (m, 3) each.

    Q and axes are those of `Ground.planes`. Returns τ = F − r δ in the planes'
    axes and φ = F − T(τ) in the world, [N], arms P − ZMP [m], (m, 3) each,
    force and moment about the ZMP (6,), and the largest |φ| [N].
    """
    m = len(P)
    tau, phi, arm = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))
    wrench, largest = np.zeros(6), 0.0
    T, D, x = np.empty(3), np.empty((3, 3)), np.empty(3)
    for i in range(m):
        A = axes[i]
        for j in range(3):
            x[j] = F[i, j] - r * (P[i, j] - Q[i, j])
            arm[i, j] = P[i, j] - zmp[j]
        for j in range(3):
            tau[i, j] = A[j, 0] * x[0] + A[j, 1] * x[1] + A[j, 2] * x[2]
        project_node(tau[i], mu, epsilon, kappa, T, D)
        for j in range(3):
            k, h = (j + 1) % 3, (j + 2) % 3
            held = A[0, j] * T[0] + A[1, j] * T[1] + A[2, j] * T[2]
            phi[i, j] = F[i, j] - held
            size = abs(phi[i, j])
            if size > largest or size != size:  # once NaN, always NaN
                largest = size
            wrench[j] += F[i, j]
            wrench[3 + j] += arm[i, k] * F[i, h] - arm[i, h] * F[i, k]
    return tau, phi, arm, wrench, largest


# Indices of the unknowns (dzO, dω) of a free pose, of one whose orientation is
# given, of one that is held; the wrench must be met in the same components.
_WHOLE, _SHIFT, _NOTHING = np.arange(6), np.arange(3), np.arange(0)
_SIZES = np.repeat([1.0, 0.05], 3)  # moments are divided by 50 mm in norms
_MAX_TURN, _MAX_SHIFT = 0.15, 0.01  # caps on one Newton step: rad, m
_HALVINGS, _MOST_STEPS = 6, 20
_ALIKE = 0.15  # relative difference of merits below which Newton cycles


@dataclass(frozen=True)
class Start:
    """How the sole is held just before the first contact.

    Attributes:
        point_L: Fixed point l_a of the sole, sole frame [m].
        point_W: Its place O_a before contact, on the ground, world [m].
        yaw: Yaw ψ_ini [rad] before contact.
    """

    point_L: np.ndarray  # noqa: N815
    point_W: np.ndarray  # noqa: N815
    yaw: float = 0.0

    def orientation(self, R: np.ndarray) -> np.ndarray:
        """R_ini (3, 3): the sole's orientation with the yaw before contact."""
        return R @ rotation_z(self.yaw - yaw_of(R))

    def places(self, R: np.ndarray, lP: np.ndarray) -> np.ndarray:
        """Places before contact of nodes at rest at lP, world [m], (m, 3)."""
        return self.point_W + (lP - self.point_L) @ self.orientation(R).T

    def places_by_turn(self, R, lP) -> np.ndarray:
        """Derivative of `places` by the foot's turn [m/rad], (m, 3, 3)."""
        gamma = np.array([0.0, R[1, 2], R[2, 2]]) / (1 - R[0, 2] ** 2)
        M = np.eye(3) - np.outer(R[:, 2], gamma)
        return -hat((lP - self.point_L) @ self.orientation(R).T) @ M


@dataclass
class State:
    """Nodal forces F (m, 3) [N], world, and pose O (3,) [m], R (3, 3)."""

    F: np.ndarray
    O: np.ndarray  # noqa: E741
    R: np.ndarray

    def copy(self) -> "State":
        """A copy with forces and pose of its own."""
        return replace(self, F=self.F.copy(), O=self.O.copy(), R=self.R.copy())


@dataclass
class Target:
    """What one sample must reach, world frame.

    Attributes:
        force: Force of the ground [N], (3,).
        zmp: Zero-moment point [m], (2,).
        reference: Nodes' places at the sample before [m], (m, 3), or a Start
            for the first sample.
        moment: Moment about the vertical through the ZMP [N·m].
        rotation: Prescribed orientation (3, 3); only the force is then met.
            None if the orientation follows from ZMP and moment.
        height: Height of the ground at the ZMP [m].
        is_held: The pose stays, and nodal forces alone are solved for (the
            paper's Algorithm 3); `force` only scales the residual.
    """

    force: np.ndarray
    zmp: np.ndarray
    reference: "np.ndarray | Start"
    moment: float = 0.0
    rotation: np.ndarray | None = None
    height: float = 0.0
    is_held: bool = False

    @property
    def point(self) -> np.ndarray:
        """The ZMP on the ground, world [m], (3,)."""
        return np.array([*self.zmp, self.height])

    @property
    def asked(self) -> np.ndarray:
        """Indices of wrench components to meet, and of the pose's to find."""
        if self.is_held:
            return _NOTHING
        return _WHOLE if self.rotation is None else _SHIFT

    def places_before(self, R: np.ndarray, lP: np.ndarray) -> np.ndarray:
        """References of nodes at rest positions lP, world [m], (m, 3)."""
        if isinstance(self.reference, Start):
            return self.reference.places(R, lP)
        return self.reference

    def turn(self, ground: Ground, R, lP) -> Turn | None:
        """How references and planes follow the turn before contact, or None."""
        if not isinstance(self.reference, Start):
            return None
        P = self.reference.places(R, lP)
        by_turn = self.reference.places_by_turn(R, lP)
        return Turn(*(x @ by_turn for x in ground.plane_derivatives(P)))

    def partway(self, before: "Target", part: float) -> "Target":
        """The target at a part (0 to 1) of the way from `before` to this."""
        rotation = self.rotation
        if rotation is not None and before.rotation is not None:
            turn = rotation_vector(rotation @ before.rotation.T)
            rotation = exp_rotation(part * turn) @ before.rotation
        return Target(
            before.force + part * (self.force - before.force),
            before.zmp + part * (self.zmp - before.zmp),
            self.reference,
            before.moment + part * (self.moment - before.moment),
            rotation,
            before.height + part * (self.height - before.height),
        )

    def about_own_zmp(self, F, P, ground: Ground) -> "Target":
        """The target; with a given pose, about the ZMP that comes out.

        That is the ZMP of nodal forces F [N] at places P [m], (m, 3) each.
        """
        if self.rotation is None:
            return self
        (zmp,) = ground.zero_moment_point(F[None], P[None])
        return replace(self, zmp=zmp[:2], height=float(zmp[2]))

    def missed(self, wrench: np.ndarray) -> np.ndarray:
        """Residual (6,) of a wrench about the ZMP; 0 if not `asked`."""
        out = np.zeros(6)
        aim = np.array([*self.force, 0.0, 0.0, self.moment])
        out[self.asked] = (wrench - aim)[self.asked]
        return out

    def turned(self, O, R) -> tuple[np.ndarray, np.ndarray]:  # noqa: E741
        """O and R, turned about the ZMP to a prescribed orientation if any."""
        if self.rotation is None:
            return O, R
        Z = self.point
        return Z + self.rotation @ R.T @ (O - Z), self.rotation


@dataclass
class Convergence:
    """Report of a Newton solve; `residual` is over the wanted force."""

    converged: bool
    iterations: int
    residual: float
    message: str = ""
    parts: int = 1  # of the time since the sample before
    reached: float = 0.0  # part of the way to the load, by `simulation.lead`


class ContactSolver:
    """Semismooth Newton for one condensed sole and one contact law.

    Args:
        C: Compliance of the contact nodes, sole frame [m/N], (3m, 3m).
        lP: Rest positions of the contact nodes, sole frame [m], (m, 3).
        law: The contact law.
        tolerance: Largest entry allowed of the scaled residual.
        ground: The ground it stands on.
    """

    def __init__(
        self,
        C: np.ndarray,
        lP: np.ndarray,
        law: ContactLaw,
        tolerance: float = 1e-11,
        ground: Ground = FLAT,
    ):
        self.C, self.lP, self.law, self.ground = C, lP, law, ground
        self.tolerance, self.active = tolerance, ActiveSet(C)

    @classmethod
    def of(cls, sole: Sole, law: ContactLaw, **options) -> "ContactSolver":
        """The solver of a sole, with further arguments as `options`."""
        return cls(sole.compliance, sole.positions, law, **options)

    def places(self, state: State) -> np.ndarray:
        """World places of the contact nodes [m], (m, 3)."""
        return deformed(self.C, self.lP, state.R, state.F) + state.O

    def solve(self, state: State, target: Target) -> tuple[State, Convergence]:
        """Solve from `state`, which is not changed; last state and report."""
        state = state.copy()
        state.O, state.R = target.turned(state.O, state.R)

        def improved(point):
            point = self._released(point, target)
            dF, dp = self._direction(point, target)

            def trial(step):
                there = move(point.state, step * dF, step * dp, target.point)
                return self._evaluate(there, target, scale)

            step = capped(dp, _MAX_TURN, _MAX_SHIFT)
            return line_search(point, trial, step, _HALVINGS)

        scale = max(float(np.linalg.norm(target.force)), 1e-12)
        point, report = newton(
            self._evaluate(state, target, scale), improved,
            self.tolerance, _MOST_STEPS,
        )  # fmt: skip
        if report.converged:
            point.state.F[~point.active] = 0.0
        else:
            self.active.refresh()  # drop rounding errors of a failed solve
        return point.state, report

    def linearise(
        self, state: State, target: Target, P: np.ndarray
    ) -> Linearisation:
        """Linearise at a solution with its nodes at P (m, 3), world [m].

        About the ZMP; with a given pose, about the one that comes out.
        """
        target = target.about_own_zmp(state.F, P, self.ground)
        point = self._evaluate(state, target, 1.0, P)
        point.tau = at_rest(point.tau, self.law, target.force)
        return self._linearisation(point)

    def _evaluate(self, state, target, scale, P=None) -> "_Point":
        F, law = state.F, self.law
        if P is None:
            P = self.places(state)
        Q, axes = self.ground.planes(target.places_before(state.R, self.lP))
        tau, phi, arm, wrench, largest = residual(
            P, F, Q, axes, target.point,
            law.penalty, law.friction, law.epsilon, law.kappa,
        )  # fmt: skip
        wrench = target.missed(wrench)
        merit = float(np.maximum(largest, wrench_size(wrench)) / scale)
        active = tau[:, 2] > -law.epsilon
        return _Point(state, axes, arm, tau, phi, wrench, active, merit)

    def _linearisation(self, point) -> Linearisation:
        if not point.active.any():
            raise np.linalg.LinAlgError("no node in contact")
        self.active.update(np.flatnonzero(point.active))
        return Linearisation(self.active, self.law, point)

    def _released(self, point, target):
        """The point without inactive forces: their Newton step is dF = −F."""
        stray = ~point.active & np.any(point.state.F != 0.0, axis=1)
        if not stray.any():
            return point
        released = point.state.copy()
        released.F[stray] = 0.0
        new = self._evaluate(released, target, 1.0)
        return replace(new, active=point.active, merit=point.merit)

    def _direction(self, point, target):
        """Newton step dF, (dzO, dω) at a released point."""
        state = point.state
        try:
            lin = self._linearisation(point)
            dF, phi = np.zeros_like(state.F), point.phi[lin.nodes]
            turn = target.turn(self.ground, state.R, self.lP[lin.nodes])
            dF[lin.nodes], dp = lin.solve(phi, point.wrench, target.asked, turn)
        except np.linalg.LinAlgError:
            dp = np.full(6, np.nan)
        if not np.isfinite(dp).all():
            touching = point.active.sum()
            raise np.linalg.LinAlgError(
                f"singular Newton matrix with {touching} nodes in contact"
            )
        return dF, dp


def newton(
    point, improved, tolerance: float, most: int
) -> tuple["_Point", Convergence]:
    """Iterate from a point with a `merit`; the last point and a report.

    `improved` gives the next point, or raises LinAlgError. Ends when the merit
    is within the tolerance, after `most` steps, or when merits cycle.
    """
    history, message = [point.merit], ""
    while not (
        point.merit <= tolerance  # NaN is not
        or len(history) > most
        or _goes_in_circles(history)
    ):
        try:
            point = improved(point)
        except np.linalg.LinAlgError as error:
            message = str(error)
            break
        history.append(point.merit)
    steps, merit = len(history) - 1, history[-1]
    if merit <= tolerance:
        return point, Convergence(True, steps, merit)
    message = message or f"no convergence in {steps} Newton steps"
    return point, Convergence(False, steps, merit, message)


def wrench_size(wrench: np.ndarray) -> float:
    """Largest component [N] of a wrench (6,), moments over 50 mm."""
    return float(np.abs(wrench / _SIZES).max())


def capped(dp: np.ndarray, turn: float, shift: float) -> float:
    """Largest step, at most 1, of a pose increment (6,) in caps [rad, m]."""
    return min(
        1.0,
        turn / max(np.linalg.norm(dp[3:]), 1e-300),
        shift / max(np.linalg.norm(dp[:3]), 1e-300),
    )


def line_search(point, trial, step: float, halvings: int):
    """The first point of less merit as the step is halved, else the best met.

    `trial` gives the point, with a `merit`, that a step leads to.
    """
    best = None
    for _ in range(halvings + 1):
        new = trial(step)
        if best is None or new.merit < best.merit:
            best = new
        if new.merit < point.merit:
            break
        step *= 0.5
    return best


def _goes_in_circles(merits: list[float]) -> bool:
    """Whether the last three merits are much the same as the three before."""
    if len(merits) < 6:
        return False
    before, last = np.array(merits[-6:-3]), np.array(merits[-3:])
    return bool((np.abs(last - before) < _ALIKE * before).all())


@dataclass
class _Point:
    """State with its residuals, see `residual`; `wrench` is what is missed."""

    state: State
    axes: np.ndarray
    arm: np.ndarray
    tau: np.ndarray
    phi: np.ndarray
    wrench: np.ndarray
    active: np.ndarray
    merit: float


def move(state: State, dF, dp, Z) -> State:
    """State after dF (m, 3) and a pose increment (dzO, dω) about Z."""
    turn = exp_rotation(dp[3:])
    O = Z + turn @ (state.O - Z) + dp[:3]  # noqa: E741
    return State(state.F + dF, O, turn @ state.R)
