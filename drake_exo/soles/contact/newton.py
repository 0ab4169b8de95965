"""Nodal forces and foot pose together by one semismooth Newton method.

Unknowns: world forces F_i of the ground on the contact nodes and the foot's
pose (O, R). Equations: the node law at every contact node, and force and
moment about the desired ZMP. What depends on every contact node is compiled.
Symbols as in docs/soles.md.
"""

from dataclasses import dataclass, field

import numpy as np

from drake_exo.soles.compiled import njit
from drake_exo.soles.contact.linearisation import ActiveSet, Linearisation
from drake_exo.soles.contact.node_law import ContactLaw, project_node
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.rotations import (
    exp_rotation,
    hat,
    rotation_vector,
    rotation_z,
    yaw_of,
)


@njit()
def deformed(C, lP, R, F):
    """Y = R (lP + C Rᵀ F): places relative to O, world [m], (m, 3).

    Args:
        C: Compliance of the contact nodes, sole frame [m/N], (3m, 3m).
        lP: Their rest positions, sole frame [m], (m, 3).
        R: Orientation, (3, 3).
        F: Forces on them, world [N], (m, 3); most are zero.
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
        # Added last: rest positions are large against displacements.
        x, y, z = lP[i] + u[3 * i : 3 * i + 3]
        for k in range(3):
            Y[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z
    return Y


@njit()
def residual(P, F, Q_t, zmp, r, mu, epsilon, kappa):
    """Residuals of the node law and of the wrench at places P.

    Args:
        P: World places [m], (m, 3).
        F: World forces [N], (m, 3).
        Q_t: Tangential references [m], (m, 2).
        zmp: Desired ZMP on the ground [m], (2,).
        r: Penalty [N/m].
        mu, epsilon, kappa: The contact law's, see `node_law`.

    Returns:
        τ = F − r δ and φ = F − T(τ) (m, 3) [N], arms P − ZMP (m, 3) [m],
        force and moment about the ZMP (6,), largest |φ|.
    """
    m = len(P)
    tau, phi, arm = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))
    wrench, largest = np.zeros(6), 0.0
    T, D = np.empty(3), np.empty((3, 3))
    for i in range(m):
        tau[i, 0] = F[i, 0] - r * (P[i, 0] - Q_t[i, 0])
        tau[i, 1] = F[i, 1] - r * (P[i, 1] - Q_t[i, 1])
        tau[i, 2] = F[i, 2] - r * P[i, 2]
        project_node(tau[i], mu, epsilon, kappa, T, D)
        arm[i, 0], arm[i, 1] = P[i, 0] - zmp[0], P[i, 1] - zmp[1]
        arm[i, 2] = P[i, 2]
        for j in range(3):
            k, h = (j + 1) % 3, (j + 2) % 3
            phi[i, j] = F[i, j] - T[j]
            size = abs(phi[i, j])
            if size > largest or size != size:  # once NaN, always NaN
                largest = size
            wrench[j] += F[i, j]
            wrench[3 + j] += arm[i, k] * F[i, h] - arm[i, h] * F[i, k]
    return tau, phi, arm, wrench, largest


# Increments (dzO, dω) of a free pose, and of one whose orientation is given;
# the same components of the wrench are asked for.
_WHOLE, _SHIFT = np.arange(6), np.arange(3)
MOMENT_SCALE = 0.05  # metres; moments are divided by it in norms
_MAX_TURN, _MAX_SHIFT = 0.15, 0.01  # caps on one Newton step: rad, m
_HALVINGS = 6
_ALIKE = 0.15  # merits of steps that go in circles


@dataclass(frozen=True)
class Start:
    """How the sole is held just before the first contact.

    Attributes:
        point_L: Fixed point l_a of the sole, sole frame [m].
        point_W: Its place O_a before contact, world [m] (z is not used).
        yaw: Yaw ψ_ini [rad] before contact.
    """

    point_L: np.ndarray  # noqa: N815
    point_W: np.ndarray  # noqa: N815
    yaw: float = 0.0

    def reference(self, R: np.ndarray, lP: np.ndarray) -> np.ndarray:
        """Tangential references Q_t of the first step, (m, 2)."""
        R_ini = R @ rotation_z(self.yaw - yaw_of(R))
        return (self.point_W + (lP - self.point_L) @ R_ini.T)[:, :2]

    def reference_derivative(self, R, lP) -> np.ndarray:
        """dQ/dω with a zero normal row, (m, 3, 3)."""
        R_ini = R @ rotation_z(self.yaw - yaw_of(R))
        gamma = np.array([0.0, R[1, 2], R[2, 2]]) / (1 - R[0, 2] ** 2)
        M = np.eye(3) - np.outer(R[:, 2], gamma)
        dQ = -hat((lP - self.point_L) @ R_ini.T) @ M
        dQ[:, 2] = 0.0
        return dQ


@dataclass
class State:
    """Forces and pose at one step: F (m, 3) [N], O (3,) [m], R (3, 3)."""

    F: np.ndarray
    O: np.ndarray  # noqa: E741
    R: np.ndarray

    def copy(self) -> "State":
        """A deep copy."""
        return State(self.F.copy(), self.O.copy(), self.R.copy())


@dataclass
class Target:
    """What one step must reach.

    Attributes:
        force: [N], (3,).
        zmp: On the ground [m], (2,).
        reference: Q_t (m, 2), or a Start for the first step.
        moment: About the vertical through the ZMP [N·m].
        rotation: Orientation (3, 3); where it is given, the force alone is
            reached.
    """

    force: np.ndarray
    zmp: np.ndarray
    reference: "np.ndarray | Start"
    moment: float = 0.0
    rotation: np.ndarray | None = None

    @property
    def asked(self) -> np.ndarray:
        """Components of the wrench that are asked for, and of the pose."""
        return _WHOLE if self.rotation is None else _SHIFT

    def references(self, R: np.ndarray, lP: np.ndarray) -> np.ndarray:
        """Tangential references of nodes at rest positions lP, (m, 2)."""
        if isinstance(self.reference, Start):
            return self.reference.reference(R, lP)
        return self.reference

    def reference_turn(self, R, lP) -> np.ndarray | None:
        """Their derivative by the turn (m, 3, 3), if they have one."""
        if isinstance(self.reference, Start):
            return self.reference.reference_derivative(R, lP)
        return None

    def partway(self, before: "Target", part: float) -> "Target":
        """A part of the way from `before` to here, at this reference."""
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
        )

    def missed(self, wrench: np.ndarray) -> np.ndarray:
        """What a wrench (6,) about the ZMP lacks where it is asked for."""
        out = np.zeros(6)
        aim = np.array([*self.force, 0.0, 0.0, self.moment])
        out[self.asked] = (wrench - aim)[self.asked]
        return out

    def turned(self, O, R) -> tuple[np.ndarray, np.ndarray]:  # noqa: E741
        """Place and orientation turned about the ZMP as is asked for."""
        if self.rotation is None:
            return O, R
        Z = np.array([*self.zmp, 0.0])
        return Z + self.rotation @ R.T @ (O - Z), self.rotation


@dataclass
class Convergence:
    """What a Newton solve reports."""

    converged: bool
    iterations: int
    residual: float
    message: str = ""
    history: list = field(default_factory=list)
    parts: int = 1  # of the time since the sample before


class ContactSolver:
    """Semismooth Newton for one condensed sole and one contact law.

    Args:
        C: Compliance of the contact nodes, sole frame [m/N], (3m, 3m).
        lP: Rest positions of the contact nodes, sole frame [m], (m, 3).
        law: The contact law.
        tolerance: On the scaled residual's largest entry.
        max_iterations: Newton steps before giving up.
    """

    def __init__(
        self,
        C: np.ndarray,
        lP: np.ndarray,
        law: ContactLaw,
        tolerance: float = 1e-11,
        max_iterations: int = 20,
    ):
        self.C, self.lP, self.law = C, lP, law
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.active = ActiveSet(C)

    @classmethod
    def of(cls, sole: Sole, law: ContactLaw, **options) -> "ContactSolver":
        """Of a sole."""
        return cls(sole.compliance, sole.positions, law, **options)

    def deformed(self, F: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Y = R (lP + C Rᵀ F): places relative to O, world, (m, 3)."""
        return deformed(self.C, self.lP, R, F)

    def solve(
        self, state: State, target: Target, fixed_pose: bool = False
    ) -> tuple[State, Convergence]:
        """Newton from `state`; returns the last state and its report.

        Args:
            state: First guess; not changed.
            target: Desired force, ZMP and references.
            fixed_pose: Keep the pose and solve for the forces alone (the
                paper's Algorithm 3); target.force only scales the residual.
        """
        state = state.copy()
        if not fixed_pose:
            state.O, state.R = target.turned(state.O, state.R)
        scale = max(float(np.linalg.norm(target.force)), 1e-12)
        history, message = [], ""
        point = self._evaluate(state, target, fixed_pose, scale)
        for iteration in range(self.max_iterations + 1):
            history.append(point.merit)
            if point.merit <= self.tolerance:
                state.F[~point.active] = 0.0
                return state, Convergence(
                    True, iteration, point.merit, "", history
                )
            if iteration == self.max_iterations or _goes_in_circles(history):
                break
            try:
                direction = self._direction(point, target, fixed_pose)
            except np.linalg.LinAlgError:
                touching = int(point.active.sum())
                message = (
                    f"singular Newton matrix with {touching} nodes in contact"
                )
                break
            point = self._line_search(
                point, direction, target, fixed_pose, scale
            )
            state = point.state
        self.active.refresh()  # rounding of a way that led nowhere
        steps = len(history) - 1
        message = message or f"no convergence in {steps} Newton steps"
        return state, Convergence(False, steps, history[-1], message, history)

    def linearise(
        self, state: State, target: Target, P: np.ndarray
    ) -> Linearisation:
        """Derivatives at a state; references count as frozen.

        Args:
            state, target: A solution.
            P: World places of the contact nodes there [m], (m, 3).
        """
        point = self._evaluate(state, target, False, 1.0, P)
        return self._linearisation(point, target)

    def _evaluate(self, state, target, fixed_pose, scale, P=None) -> "_Point":
        F, law = state.F, self.law
        if P is None:
            P = self.deformed(F, state.R) + state.O
        Q_t = target.references(state.R, self.lP)
        tau, phi, arm, wrench, largest = residual(
            P, F, Q_t, target.zmp,
            law.penalty, law.friction, law.epsilon, law.kappa,
        )  # fmt: skip
        merit = largest / scale
        if fixed_pose:
            wrench = np.zeros(6)
        else:
            wrench = target.missed(wrench)
            off = np.abs(wrench)
            off[3:] /= MOMENT_SCALE
            merit = float(np.maximum(merit, off.max() / scale))  # NaN stays
        active = tau[:, 2] > -law.epsilon
        return _Point(state, P, arm, tau, phi, wrench, active, merit)

    def _linearisation(self, point, target) -> Linearisation:
        if not point.active.any():
            raise np.linalg.LinAlgError("no node in contact")
        self.active.update(np.flatnonzero(point.active))
        nodes = self.active.nodes
        return Linearisation(
            self.active,
            self.law,
            point.state.R,
            point.arm[nodes],
            point.state.F[nodes],
            point.tau[nodes],
        )

    def _direction(self, point, target, fixed_pose):
        """Newton step (dF, dzO, dω) at a point, inactive forces released."""
        state = point.state
        stray = ~point.active & np.any(state.F != 0.0, axis=1)
        if stray.any():  # their Newton step is dF = −F: take it at once
            released = state.copy()
            released.F[stray] = 0.0
            active = point.active
            point_new = self._evaluate(released, target, fixed_pose, 1.0)
            point_new.active = active
            point_new.merit = point.merit
            point.__dict__.update(point_new.__dict__)
        lin = self._linearisation(point, target)
        dF = np.zeros_like(state.F)
        phi = point.phi[lin.nodes]
        if fixed_pose:
            dF[lin.nodes] = lin.solve_forces(phi)
            return dF, np.zeros(6)
        dQ = target.reference_turn(state.R, self.lP[lin.nodes])
        dF[lin.nodes], dp = lin.solve(phi, point.wrench, target.asked, dQ)
        if not np.isfinite(dp).all():
            raise np.linalg.LinAlgError
        return dF, dp

    def _line_search(self, point, direction, target, fixed_pose, scale):
        dF, dp = direction
        turn, shift = np.linalg.norm(dp[3:]), np.linalg.norm(dp[:3])
        step = min(
            1.0, _MAX_TURN / max(turn, 1e-300), _MAX_SHIFT / max(shift, 1e-300)
        )
        best = None
        for _ in range(_HALVINGS + 1):
            trial = move(point.state, step * dF, step * dp, target.zmp)
            new = self._evaluate(trial, target, fixed_pose, scale)
            if best is None or new.merit < best.merit:
                best = new
            if new.merit < point.merit:
                break
            step *= 0.5
        return best


def _goes_in_circles(merits: list[float]) -> bool:
    """Whether the last three steps were much the same as those before."""
    if len(merits) < 6:
        return False
    before, last = np.array(merits[-6:-3]), np.array(merits[-3:])
    return bool((np.abs(last - before) < _ALIKE * before).all())


@dataclass
class _Point:
    """Everything evaluated at one state."""

    state: State
    P: np.ndarray
    arm: np.ndarray
    tau: np.ndarray
    phi: np.ndarray
    wrench: np.ndarray
    active: np.ndarray
    merit: float


def move(state: State, dF, dp, zmp) -> State:
    """State after force increments and a pose increment (dzO, dω) about Z."""
    Z = np.array([zmp[0], zmp[1], 0.0])
    turn = exp_rotation(dp[3:])
    O = Z + turn @ (state.O - Z) + dp[:3]  # noqa: E741
    return State(state.F + dF, O, turn @ state.R)
