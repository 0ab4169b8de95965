"""Gradients of cost and limits by the node positions and the load (adjoint).

The adjoint goes backwards through the samples (contact and pose), then once
through condensation and elements, see `elasticity.py`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy import cross

from drake_exo.soles.contact.newton import ContactSolver, Start, Target
from drake_exo.soles.elasticity import Sole, compliance_gradients
from drake_exo.soles.loads import Load
from drake_exo.soles.simulation import STABILITY_SCALE, StepHistory

_NEGLIGIBLE = 1e-12  # samples below this part of the largest are left out


@dataclass
class Derivative:
    """Direct derivatives of one functional, the adjoint's input.

    Attributes:
        pairs: By sample, vectors u, v (6,) of which it varies like uᵀ K_c v.
        by_turn: By sample, derivative by the foot's turn [1/rad], (3,).
        by_force: By sample, by nodal forces in the sole frame [1/N], (m, 3).
        by_nodes: By the nodes' positions at rest [1/m], (n, 3) or 0.
        fields: Fields and factors of its part through the stiffness matrix,
            see `energy_gradients`; None if there is none.
    """

    pairs: dict[int, list] = field(default_factory=dict)
    by_turn: dict[int, np.ndarray] = field(default_factory=dict)
    by_force: dict[int, np.ndarray] = field(default_factory=dict)
    by_nodes: np.ndarray | float = 0.0
    fields: tuple[np.ndarray, np.ndarray] | None = None


class Sensitivity:
    """Derivatives of one functional, summed over samples backwards.

    By rest positions of the contact nodes (`lP`) and their places at the sample
    before (`mu`), (m, 3) each; by C as columns (3m,), ∂/∂C = Σ left rightᵀ; by
    force and ZMP of every sample (`load`), (N, 5).
    """

    def __init__(self, m: int, samples: int):
        self.lP, self.mu = np.zeros((2, m, 3))
        self.left, self.right = [], []
        self.load = np.zeros((samples, 5))

    def add(self, left: np.ndarray, right: np.ndarray) -> None:
        """∂/∂C += left rightᵀ for fields (m, 3)."""
        self.left.append(left.ravel())
        self.right.append(right.ravel())


def singular_terms(
    K_c: np.ndarray, by_tr: np.ndarray, by_rot: np.ndarray
) -> Derivative:
    """Derivative of Σ by_tr σ_max(K_tr) + Σ by_rot σ_min(K_rot), both (N,)."""
    pairs = {}
    for q, K in enumerate(K_c):
        for factor, part, which in (
            (by_tr[q], slice(0, 3), 0),
            (by_rot[q], slice(3, 6), 2),
        ):
            if factor:
                U, _, Vt = np.linalg.svd(K[part, part])
                u, v = np.zeros((2, 6))
                u[part], v[part] = factor * U[:, which], Vt[which]
                pairs.setdefault(q, []).append((u, v))
    return Derivative(pairs)


def stability_terms(K_c: np.ndarray, factors: np.ndarray) -> Derivative:
    """Derivative of Σ factor · min eig(S sym(−K_c) S), factors (N,)."""
    pairs, scale = {}, STABILITY_SCALE
    for q in heavy(factors):
        sym = -0.5 * (K_c[q] + K_c[q].T) * np.outer(scale, scale)
        v = scale * np.linalg.eigh(sym)[1][:, 0]
        pairs[q] = [(-factors[q] * v, v)]
    return Derivative(pairs)


def tilt_terms(R: np.ndarray, up, factors: np.ndarray) -> Derivative:
    """Derivative of Σ factor · (R z) · up, the cosine of the tilt."""
    by_turn = {q: factors[q] * np.cross(R[q, :, 2], up) for q in heavy(factors)}
    return Derivative(by_turn=by_turn)


def heavy(derivatives: np.ndarray) -> np.ndarray:
    """Samples whose derivative (N, ...) matters; few of a soft minimum's."""
    size = np.abs(derivatives).reshape(len(derivatives), -1).max(axis=1)
    return np.flatnonzero(size > _NEGLIGIBLE * size.max())


def gradients(
    sole: Sole,
    solver: ContactSolver,
    load: Load,
    start: Start,
    history: StepHistory,
    functionals: list[Derivative],
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of f functionals, in one backward pass over the samples.

    By all node positions (f, n, 3); by every sample's force and ZMP (f, N, 5).
    All samples must have converged, and their linearisations been kept.
    """
    m, count = len(sole.positions), len(load.times)
    sums = [Sensitivity(m, count) for _ in functionals]
    for q in reversed(range(count)):
        live = [
            (total, own)
            for total, own in zip(sums, functionals, strict=True)
            if q in own.pairs | own.by_turn | own.by_force or total.mu.any()
        ]
        if not live:
            continue
        reference = start if q in load.begins else history.P[q - 1]
        target = load.target(q, reference, solver.ground)
        _Step(solver, history, q, target).reverse(*zip(*live, strict=True))
    out = compliance_gradients(
        sole,
        [(np.array(x.left).T, np.array(x.right).T) for x in sums],
        [functional.fields for functional in functionals],
    )
    for X, total, functional in zip(out, sums, functionals, strict=True):
        X[sole.mesh.contact] += total.lP
        X += functional.by_nodes
    return out, np.array([total.load for total in sums])


class _Step:
    """One sample, linearised once and reversed for all functionals."""

    def __init__(self, solver, history: StepHistory, q: int, target: Target):
        self.solver, self.q = solver, q
        self.state = state = history.state(q)
        self.target = target = target.about_own_zmp(
            state.F, history.P[q], solver.ground
        )
        self.lin = history.linear[q]
        self.nodes = self.lin.nodes
        self.dF, self.dP, self.G = self.lin.frozen_response
        rest, ground = solver.lP[self.nodes], solver.ground
        self.turn = target.turn(ground, state.R, rest)
        if self.turn is not None:
            self.G = self.lin.pose_response(self.turn)[2]
        before = target.places_before(state.R, solver.lP)[self.nodes]
        self.planes = ground.plane_derivatives(before)
        self.rise = ground.slope(target.point[None])[0]
        self.Y = history.P[q] - state.O

    def reverse(self, sums: list[Sensitivity], direct: list[Derivative]):
        """Add this sample's share to the sums; set mu for the sample before."""
        R, F = self.state.R, self.lin.F
        c, k, m = len(sums), len(self.nodes), len(self.solver.lP)
        # By places, forces, references and turns of the planes nodes meet.
        bP, bF, bQ, bA = np.zeros((4, c, k, 3))
        b_w = np.zeros((c, 3))
        of_stiffness = []
        for i, own in enumerate(direct):
            b_w[i] += own.by_turn.get(self.q, 0.0)
            if self.q in own.by_force:
                pull = own.by_force[self.q][self.nodes] @ R.T
                bF[i] += pull
                b_w[i] -= cross(F, pull).sum(axis=0)
            of_stiffness += [(i, *pair) for pair in own.pairs.get(self.q, ())]
        if of_stiffness:
            self._stiffness_terms(sums, of_stiffness, bP, bF, bQ, bA, b_w)
        if self.turn is not None:
            b_w += self._by_turn(bQ, bA)
        # Reverse P = O + R (lP + C Rᵀ F), with the next sample's share.
        bP_all = np.array([total.mu for total in sums])
        bP_all[:, self.nodes] += bP
        b_O = bP_all.sum(axis=1)
        b_w += cross(self.Y, bP_all).sum(axis=1)
        by = bP_all @ R
        # A contiguous block of C: faster than gathering its rows.
        there = np.append(np.flatnonzero(by.any(axis=(0, 2))), self.nodes)
        a, b = there.min(), there.max() + 1
        C = self.solver.C[3 * a : 3 * b, 3 * a : 3 * b]
        lift = by[:, a:b].reshape(c, -1) @ C
        lift = lift.reshape(c, -1, 3)[:, self.nodes - a] @ R.T
        bF += lift
        b_w -= cross(F, lift).sum(axis=1)
        y, turned, l_w = self._adjoint(bF, b_O, b_w)
        l_f, l_m = l_w[:, :3], l_w[:, 3:]
        # The wrench about Z is Σ F − F_d and Σ (P − Z) × F.
        about = cross(F.sum(axis=0)[None], l_m)
        for i, total in enumerate(sums):
            total.load[self.q] -= [*l_f[i], *self._on_ground(about[i])]
        by[:, self.nodes] += (y + cross(F, l_m[:, None])) @ R
        moved, turns = self.planes
        before = (bQ - y)[:, :, None] @ moved + (bA + turned)[
            :, :, None
        ] @ turns
        before = before[:, :, 0]
        f = self.state.F @ R
        for i, total in enumerate(sums):
            total.lP += by[i]
            total.add(by[i], f)
            total.mu = np.zeros((m, 3))
            if self.turn is None:
                total.mu[self.nodes] = before[i]
            else:  # O_a + R_ini (lP − l_a)
                R_ini = self.target.reference.orientation(R)
                total.lP[self.nodes] += before[i] @ R_ini

    def _by_turn(self, by_places, by_axes) -> np.ndarray:
        """By the turn, through references and axes that turn with the foot."""
        return np.einsum("kij,cki->cj", self.turn.places, by_places) + (
            np.einsum("kij,cki->cj", self.turn.axes, by_axes)
        )

    def _on_ground(self, by_point: np.ndarray) -> np.ndarray:
        """Derivative by the ZMP's x, y (2,): its z follows the ground."""
        return by_point[:2] + by_point[2] * self.rise

    def _own_zmp_adjoint(self, by_point: np.ndarray) -> np.ndarray:
        """Multiplier (1, 3) of Σ (P − Z) × F = 0 in x and y, which fixes Z."""
        turned = cross(self.lin.F.sum(axis=0)[None], np.eye(3)[:2])
        A = np.stack([self._on_ground(x) for x in turned], axis=1)
        return np.append(np.linalg.solve(A, by_point), 0.0)[None]

    def _stiffness_terms(self, sums, terms, bP, bF, bQ, bA, b_w) -> None:
        """Add the direct derivatives of uᵀ K_c v; terms are (functional, u, v).

        By places, forces, references and the turns of their planes (bP, bF,
        bQ, bA, (c, k, 3) each), and by the foot's turn (b_w, (c, 3)).
        """
        lin, R, F, arm = self.lin, self.state.R, self.lin.F, self.lin.arm
        owners, *both = zip(*terms, strict=True)
        u, v = map(np.array, both)
        u_f, u_m = u[:, None, :3], u[:, None, 3:]
        shift, turn = v[:, None, :3], v[:, None, 3:]
        dF, dP = ((x @ v.T).transpose(2, 0, 1) for x in (self.dF, self.dP))
        # J_Fᵀ z = w_Fᵀ u with S w_Fᵀ u = S (u_f − arm × u_m) + F × u_m.
        plain = u_f - cross(arm, u_m)
        z, y, e = lin.solve_transposed(lin.times_S(plain) + cross(F, u_m))
        r = lin.r
        d_tau = dF - r * dP
        p = lin.second_order(d_tau, z)
        tau = lin.tau_world
        by_axes = cross(dF, z) - cross(d_tau, y) / r - cross(tau, p)
        gg = dF - cross(turn, F)
        R_du = dP - shift - cross(turn, arm)
        b_dP = cross(F, u_m) - y
        # h = R C Rᵀ b_dP without a product with C.
        h = e - plain
        by_arm = cross(dF, u_m) + cross(b_dP, turn)
        by_P = by_arm - r * p
        by_F = cross(u_m, dP) + p - cross(h, turn)
        by_turn = (cross(R_du, b_dP) - cross(gg, h)).sum(axis=1)
        for i, functional in enumerate(owners):
            bP[functional] += by_P[i]
            # The arm is P − Z.
            by_point = -self._on_ground(by_arm[i].sum(axis=0))
            if self.target.rotation is None:
                sums[functional].load[self.q, 3:] += by_point
            else:
                level = self._own_zmp_adjoint(by_point)
                bP[functional] += cross(F, level)
                bF[functional] += cross(level, arm)
            bF[functional] += by_F[i]
            bQ[functional] += r * p[i]
            bA[functional] += by_axes[i]
            b_w[functional] += by_turn[i]
            left, right = np.zeros((2, len(self.solver.lP), 3))
            left[self.nodes], right[self.nodes] = b_dP[i] @ R, gg[i] @ R
            sums[functional].add(left, right)

    def _adjoint(self, bF, b_O, b_w):
        """Solve the transposed Newton system for all functionals.

        Returns Bᵀ λ (c, k, 3), the derivatives by turns of planes (c, k, 3),
        and the multipliers of the wrench, l_w (c, 6).
        """
        lin, F, arm = self.lin, self.lin.F, self.lin.arm
        tau, Z = lin.tau_world / lin.r, self.target.point
        shifted = cross((self.state.O - Z)[None], b_O)
        b_p = np.concatenate([b_O, b_w + shifted], axis=1)
        Sb0 = -lin.times_S(bF)
        z0, y0, e0 = lin.solve_transposed(Sb0)
        W_y0 = -bF - e0
        turned = cross(arm, y0) - cross(F, W_y0)
        J_pT = np.concatenate([y0.sum(axis=1), turned.sum(axis=1)], axis=1)
        if self.turn is not None:
            J_pT[:, 3:] += self._by_turn(-y0, cross(tau, y0) - cross(F, z0))
        asked, l_w = self.target.asked, np.zeros((len(b_p), 6))
        G = self.G[np.ix_(asked, asked)]
        l_w[:, asked] = np.linalg.solve(G.T, -(b_p + J_pT)[:, asked].T).T
        l_f, l_m = l_w[:, None, :3], l_w[:, None, 3:]
        plain = l_f - cross(arm, l_m)
        Sb = Sb0 - lin.times_S(plain) - cross(F, l_m)
        z, y, _ = lin.solve_transposed(Sb)
        return y, cross(tau, y) - cross(F, z), l_w
