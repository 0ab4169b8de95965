"""The paper's solver: Gauss–Seidel on the nodes inside a Newton on the pose.

Algorithms 1, 3 and 4 with their misprints corrected. Each sweep solves node
after node: sticking if that holds, else slipping by Newton on Alart–Curnier's
equations with (21). Sweeps stop early by the relaxation (25). Kept as the
faithful reference; `newton.ContactSolver` is the default.
"""

from dataclasses import replace

import numpy as np

from drake_exo.soles.contact.law import FLAT, Ground, project_node
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    State,
    Target,
    capped,
    move,
    wrench_size,
)
from drake_exo.soles.numerics import njit

_POSE_STEPS, _LOCAL_STEPS = 60, 60
_WRENCH_TOLERANCE = 1e-10  # ε4, on the scaled wrench
# λ of (25): the sweeps' tolerance over the wrench's residual.
_RELAXATION = 0.1
_MAX_SWEEPS = 20000  # over all pose steps of a sample


class GaussSeidelSolver(ContactSolver):
    """Drop-in replacement for `ContactSolver`, by nested iterations.

    Args:
        C, lP, law, ground: As for `ContactSolver`; the law must be exact.
        sweep_tolerance: ε1, relative change of the forces in one sweep.
    """

    def __init__(
        self, C, lP, law, sweep_tolerance: float = 1e-10, ground: Ground = FLAT
    ):
        super().__init__(C, lP, law, ground=ground)
        self.sweep_tolerance = sweep_tolerance
        self.sweeps = 0

    def solve(self, state: State, target: Target) -> tuple[State, Convergence]:
        """Solve as `ContactSolver.solve`: Newton on the pose around sweeps."""
        state = state.copy()
        state.O, state.R = target.turned(state.O, state.R)
        scale = max(float(np.linalg.norm(target.force)), 1e-12)
        self.sweeps = 0
        need = 0.0 if target.is_held else np.inf
        for iteration in range(_POSE_STEPS):
            tolerance = max(self.sweep_tolerance, min(1e-3, _RELAXATION * need))
            while True:
                change = self._sweeps(state, target, tolerance)
                point = self._evaluate(state, target, scale)
                need = wrench_size(point.wrench) / scale
                asked = max(self.sweep_tolerance, _RELAXATION * need)
                if tolerance <= asked:
                    break  # (25): exact enough for this wrench
                tolerance = asked
            if change > tolerance:
                said = "Gauss–Seidel sweeps did not settle"
                return state, Convergence(False, iteration, need, said)
            done = need < _WRENCH_TOLERANCE
            if done and change <= self.sweep_tolerance:
                worst = max(need, change)
                return state, Convergence(True, iteration + 1, worst)
            if done:
                need = self.sweep_tolerance
                continue
            try:
                self._pose_step(state, point, target)
            except np.linalg.LinAlgError as error:
                said = str(error)
                return state, Convergence(False, iteration, need, said)
        return state, Convergence(
            False, _POSE_STEPS, need, "pose Newton did not settle"
        )

    def _sweeps(self, state: State, target: Target, tolerance) -> float:
        """Algorithm 3: update the state's forces at its pose; last change."""
        R = state.R
        m = len(self.lP)
        Q, axes = self.ground.planes(target.places_before(R, self.lP))
        C, B = self.C.reshape(m, 3, m, 3), axes @ R
        W = np.einsum("iab,ibjc,jdc->iajd", B, C, B, optimize=True)
        W = np.ascontiguousarray(W.reshape(3 * m, 3 * m))
        delta = self.places(state) - Q
        F, delta = (np.einsum("iab,ib->ia", axes, x) for x in (state.F, delta))
        budget = _MAX_SWEEPS - self.sweeps
        change, used = _gauss_seidel(
            W, F, delta, self.law.friction, tolerance, budget
        )
        state.F = np.einsum("iba,ib->ia", axes, F)
        self.sweeps += used
        return change

    def _pose_step(self, state, point, target) -> None:
        """Take the Newton step (24) of the pose; forces follow in sweeps."""
        # The sweeps have solved the law: the wrench alone is missed.
        solved = replace(point, phi=np.zeros_like(point.phi))
        dF, dp = self._direction(solved, target)
        step = capped(dp, 0.15, 0.01)
        new = move(state, np.zeros_like(state.F), step * dp, target.point)
        # The linearisation's forces are the next sweeps' start.
        new.F += step * dF
        normal = (point.axes[:, 2] * new.F).sum(axis=1)
        new.F[normal < 0] = 0.0
        state.F, state.O, state.R = new.F, new.O, new.R


@njit(fastmath=True)
def _gauss_seidel(W, F, delta, mu, tolerance, max_sweeps):
    """Sweep until the relative change of F is below the tolerance.

    F (m, 3) and delta = W F + delta_free (m, 3) are updated in place; only
    nodes whose force changes cost a product with W. Last change, sweeps used.
    """
    m = F.shape[0]
    place = delta.reshape(3 * m)
    own = np.empty((m, 3, 3))
    inverse = np.empty((m, 3, 3))
    for a in range(m):
        own[a] = W[3 * a : 3 * a + 3, 3 * a : 3 * a + 3]
        inverse[a] = np.linalg.inv(own[a])
    others, new, step = np.empty(3), np.empty(3), np.empty(3)
    change, used = np.inf, 0
    for _ in range(max_sweeps):
        used += 1
        diff, norm = 0.0, 0.0
        for a in range(m):
            for k in range(3):
                others[k] = place[3 * a + k] - (
                    own[a, k, 0] * F[a, 0]
                    + own[a, k, 1] * F[a, 1]
                    + own[a, k, 2] * F[a, 2]
                )
            new[:] = 0.0
            if others[2] < 0.0:
                new[:] = -(inverse[a] @ others)
                size = np.hypot(new[0], new[1])
                if new[2] <= 0.0 or size > mu * new[2]:
                    new[:] = _slip(own[a], others, mu)
            moved = False
            for k in range(3):
                step[k] = new[k] - F[a, k]
                diff += step[k] * step[k]
                norm += new[k] * new[k]
                moved = moved or step[k] != 0.0
                F[a, k] = new[k]
            if moved:  # W is symmetric: its rows lie together in memory
                s0, s1, s2 = step[0], step[1], step[2]
                r0, r1, r2 = W[3 * a], W[3 * a + 1], W[3 * a + 2]
                for b in range(3 * m):
                    place[b] += r0[b] * s0 + r1[b] * s1 + r2[b] * s2
        change = np.sqrt(diff / norm) if norm > 0.0 else 0.0
        if change < tolerance:
            break
    return change, used


@njit()
def _slip(Waa, others, mu):
    """Force (3,) of a slipping node: Newton on Alart–Curnier's with (21)."""
    mean = 0.5 * (Waa[0, 0] + Waa[1, 1])
    spread = np.sqrt(
        0.25 * (Waa[0, 0] - Waa[1, 1]) ** 2 + Waa[0, 1] * Waa[1, 0]
    )
    q_t = (mean - spread) / (mean + spread) ** 2
    q = np.array([q_t, q_t, 1.0 / Waa[2, 2]])
    F, D, T = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    F[2] = -others[2] / Waa[2, 2]
    one = np.eye(3)
    for _ in range(_LOCAL_STEPS):
        tau = F - q * (others + Waa @ F)
        if tau[2] <= 0.0:
            return np.zeros(3)
        project_node(tau, mu, 0.0, 0.0, T, D)
        phi = F - T
        if np.linalg.norm(phi) <= 1e-15 * (abs(F[2]) + 1e-300):
            break
        J = one - D @ (one - q.reshape(3, 1) * Waa)
        F = F - np.linalg.solve(J, phi)
    return F
