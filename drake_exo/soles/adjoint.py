"""Gradient of stiffness measures with respect to the shape, by the adjoint.

Backwards through the samples (contact and pose), then once through the
condensation and the elements. Formulas and signs as in docs/soles.md.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.soles.contact import ContactSolver, Start, State, Target
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.element_gradient import compliance_gradient
from drake_exo.soles.rotations import cross, rotation_z, yaw_of
from drake_exo.soles.simulation import StepHistory

_NEGLIGIBLE = 1e-12  # of the largest derivative: samples left out


@dataclass(frozen=True)
class Term:
    """alpha · uᵀ K_c v of one sample, with u and v held fixed."""

    alpha: float
    u: np.ndarray
    v: np.ndarray


@dataclass
class Sensitivity:
    """Derivatives of one functional by what the elements hand over.

    Attributes:
        lP: By the rest positions of the contact nodes, (m, 3).
        left, right: Columns with ∂/∂C = Σ left rightᵀ, lists of (3m,).
    """

    lP: np.ndarray  # noqa: N815
    left: list
    right: list
    mu: np.ndarray  # by the tangential places of the sample before

    @classmethod
    def zero(cls, m: int) -> "Sensitivity":
        """Nothing yet."""
        return cls(np.zeros((m, 3)), [], [], np.zeros((m, 3)))

    def add(self, left: np.ndarray, right: np.ndarray) -> None:
        """∂/∂C += left rightᵀ for fields (m, 3)."""
        self.left.append(left.ravel())
        self.right.append(right.ravel())


@dataclass(frozen=True)
class TurnTerm:
    """A functional of one sample's orientation: its derivative by ω."""

    by_turn: np.ndarray


@dataclass(frozen=True)
class ForceTerm:
    """A functional of one sample's nodal forces.

    Attributes:
        by_force: Its derivative by the forces in the sole frame, (m, 3).
    """

    by_force: np.ndarray

    def times(self, factor: float) -> "ForceTerm":
        """The same for a multiple of the functional."""
        return ForceTerm(factor * self.by_force)


def singular_terms(K_c: np.ndarray, by_tr: np.ndarray, by_rot: np.ndarray):
    """Terms of Σ by_tr σ_max(K_tr) + Σ by_rot σ_min(K_rot).

    Args:
        K_c: (N, 6, 6).
        by_tr, by_rot: Factors at every sample, (N,).

    Returns:
        For every sample a list of terms.
    """
    terms = []
    for K, tr, rot in zip(K_c, by_tr, by_rot, strict=True):
        here = []
        if tr:
            U, _, Vt = np.linalg.svd(K[:3, :3])
            here.append(_padded(tr, U[:, 0], Vt[0], slice(0, 3)))
        if rot:
            U, _, Vt = np.linalg.svd(K[3:, 3:])
            here.append(_padded(rot, U[:, 2], Vt[2], slice(3, 6)))
        terms.append(here)
    return terms


def stability_terms(K_c: np.ndarray, factors: np.ndarray, length: float):
    """Terms of Σ factor · min eig(S sym(−K_c) S)."""
    scale = np.array([1.0] * 3 + [1.0 / length] * 3)
    terms = [[] for _ in K_c]
    for q in heavy(factors):
        K, factor = K_c[q], factors[q]
        sym = -0.5 * (K + K.T) * np.outer(scale, scale)
        v = scale * np.linalg.eigh(sym)[1][:, 0]
        terms[q].append(Term(-factor, v, v))
    return terms


def tilt_terms(R: np.ndarray, factors: np.ndarray):
    """Terms of Σ factor · R_zz (the cosine of the tilt)."""
    up = np.array([0.0, 0.0, 1.0])
    terms = [[] for _ in R]
    for q in heavy(factors):
        terms[q].append(TurnTerm(factors[q] * np.cross(R[q, :, 2], up)))
    return terms


def heavy(derivatives: np.ndarray) -> np.ndarray:
    """Samples that count: soft extremes give most of them next to nothing.

    Args:
        derivatives: By something of each sample, (N, ...).
    """
    size = np.abs(derivatives).reshape(len(derivatives), -1).max(axis=1)
    return np.flatnonzero(size > _NEGLIGIBLE * size.max())


def _padded(alpha, u, v, part) -> Term:
    U, V = np.zeros(6), np.zeros(6)
    U[part], V[part] = u, v
    return Term(alpha, U, V)


def shape_gradients(
    sole: Sole,
    solver: ContactSolver,
    force: np.ndarray,
    zmp: np.ndarray,
    start: Start,
    history: StepHistory,
    functionals: list[list[list[Term]]],
) -> list[np.ndarray]:
    """Derivative of each functional by all node positions, (n, 3) each.

    Args:
        sole: The condensed sole.
        solver: The solver of the forward simulation (its law counts).
        force, zmp, start: Its load and start.
        history: Its result, all samples converged.
        functionals: For each functional and sample a list of terms.
    """
    sums = [Sensitivity.zero(len(sole.positions)) for _ in functionals]
    for q in reversed(range(len(force))):
        reference = start if q == 0 else history.P[q - 1][:, :2]
        target = Target(force[q], zmp[q], reference)
        step = _Step(solver, history.state(q), target, history.K_c[q])
        for total, functional in zip(sums, functionals, strict=True):
            if functional[q] or total.mu.any():
                step.reverse(total, functional[q])
    out = []
    for total in sums:
        X = compliance_gradient(
            sole, np.array(total.left).T, np.array(total.right).T
        )
        X[sole.mesh.contact] += total.lP
        out.append(X)
    return out


class _Step:
    """One sample, linearised once and reversed for every functional."""

    def __init__(self, solver, state: State, target: Target, K_c):
        self.solver, self.state, self.target = solver, state, target
        self.lin = solver.linearise(state, target)
        self.nodes = self.lin.nodes
        self.dF, self.dP = self.lin.pose_response()
        self.first = isinstance(target.reference, Start)
        self.G, self.dQ = K_c, None
        if self.first:
            lP = solver.lP[self.nodes]
            self.dQ = target.reference.reference_derivative(state.R, lP)
            dF, dP = self.lin.pose_response(self.dQ)
            dP = dP.copy()
            dP[:, :, 3:] += self.dQ
            self.G = self.lin.wrench_change(dF, dP)
        self.Y = solver.deformed(state.F, state.R)  # relative to O

    def reverse(self, total: Sensitivity, terms: list[Term]) -> None:
        """Add this sample's share; leaves total.mu for the one before."""
        R, F = self.state.R, self.lin.F
        k, m = len(self.nodes), len(total.lP)
        bP, bF, bQ = np.zeros((3, k, 3))
        b_w = np.zeros(3)
        for term in terms:
            if isinstance(term, TurnTerm):
                b_w += term.by_turn
                continue
            if isinstance(term, ForceTerm):
                pull = term.by_force[self.nodes] @ R.T
                bF += pull
                b_w -= cross(F, pull).sum(axis=0)
                continue
            b_w += self._term(total, term, bP, bF, bQ)
        if self.first:
            b_w += np.einsum("kij,ki->j", self.dQ, bQ)
        # Reverse P = O + R (lP + C Rᵀ F), with what the next sample asks.
        bP_all = total.mu.copy()
        bP_all[self.nodes] += bP
        b_O = bP_all.sum(axis=0)
        b_w += cross(self.Y, bP_all).sum(axis=0)
        by = bP_all @ R
        f = self.state.F @ R
        total.lP += by
        total.add(by, f)
        dofs = (3 * self.nodes[:, None] + np.arange(3)).ravel()
        lift = (self.solver.C[dofs] @ by.ravel()).reshape(k, 3) @ R.T
        bF += lift
        b_w -= cross(F, lift).sum(axis=0)
        y, l_m = self._adjoint(bF, b_O, b_w)
        bP = y + cross(F, l_m)
        bQ -= y
        local = np.zeros((m, 3))
        local[self.nodes] = bP @ R
        total.lP += local
        total.add(local, f)
        bQ[:, 2] = 0.0
        total.mu = np.zeros((m, 3))
        if self.first:
            # Q_t = t (O_a + R_ini (lP − l_a)).
            start = self.target.reference
            lP = self.solver.lP
            slope = _reference_by_position(start, R, lP)
            total.lP[self.nodes] += bQ @ slope
        else:
            total.mu[self.nodes] = bQ

    def _term(self, total, term: Term, bP, bF, bQ) -> np.ndarray:
        """Direct derivatives of one α uᵀ K_c v; returns its b_ω."""
        lin, R, F, arm = self.lin, self.state.R, self.lin.F, self.lin.arm
        u_f, u_m = term.alpha * term.u[:3], term.alpha * term.u[3:]
        shift, turn = term.v[:3], term.v[3:]
        dF, dP = self.dF @ term.v, self.dP @ term.v
        # J_Fᵀ z = w_Fᵀ u with S w_Fᵀ u = S (u_f − arm × u_m) + F × u_m.
        plain = u_f - cross(arm, u_m)
        Sb = lin.times_S(plain[:, :, None])
        Sb += cross(F, u_m)[:, :, None]
        z, y, e = (a[:, :, 0] for a in lin.solve_transposed(Sb))
        r = lin.r
        change = lin.law_derivative_change(dF - r * dP)
        p = np.einsum("kij,ki->kj", change, z)
        gg = dF - cross(turn, F)
        R_du = dP - shift - cross(turn, arm)
        b_dP = cross(F, u_m) - y
        bP += cross(dF, u_m) - r * p + cross(b_dP, turn)
        bF += cross(u_m, dP) + p
        bQ += r * p
        # h = R C Rᵀ b_dP without a product with C.
        h = e - plain
        bF -= cross(h, turn)
        left, right = np.zeros((2, *total.lP.shape))
        left[self.nodes], right[self.nodes] = b_dP @ R, gg @ R
        total.add(left, right)
        return cross(R_du, b_dP).sum(axis=0) - cross(gg, h).sum(axis=0)

    def _adjoint(self, bF, b_O, b_w):
        """Solve the transposed Newton system; Bᵀ λ (k, 3) and l_w's moment."""
        lin, F, arm = self.lin, self.lin.F, self.lin.arm
        Z = np.array([*self.target.zmp, 0.0])
        b_p = np.concatenate([b_O, b_w + np.cross(self.state.O - Z, b_O)])
        Sb0 = -lin.times_S(bF[:, :, None])
        _, y0, e0 = (a[:, :, 0] for a in lin.solve_transposed(Sb0))
        W_y0 = -bF - e0
        J_pT = np.concatenate(
            [
                y0.sum(axis=0),
                cross(arm, y0).sum(axis=0) - cross(F, W_y0).sum(axis=0),
            ]
        )
        if self.dQ is not None:
            J_pT[3:] -= np.einsum("kij,ki->j", self.dQ, y0)
        l_w = np.linalg.solve(self.G.T, -b_p - J_pT)
        plain = l_w[:3] - cross(arm, l_w[3:])
        Sb = Sb0 - lin.times_S(plain[:, :, None])
        Sb -= cross(F, l_w[3:])[:, :, None]
        _, y, _ = lin.solve_transposed(Sb)
        return y[:, :, 0], l_w[3:]


def _reference_by_position(start: Start, R, lP) -> np.ndarray:
    """Matrix A with bar(lP) = bar(Q) A: R_ini itself."""
    return R @ rotation_z(start.yaw - yaw_of(R))
