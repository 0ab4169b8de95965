"""A neo-Hookean sole: elements, contact and pose by one Newton method.

The compressible solid on linear tetrahedra, total Lagrangian. Energy per rest
volume, I1 = tr FᵀF (Bonet and Wood, Nonlinear Continuum Mechanics for Finite
Element Analysis, 2nd ed., chapter 6):

    W = μ/2 (I1 − 3 − 2 ln J) + λ/2 (ln J)²

with Lamé's constants λ and μ of small strain, which it tends to. With
F = I + Σ u_a g_aᵀ and the pushed-forward gradients ĝ = F⁻ᵀ g:

    P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ
    K_ab = V [μ g_a·g_b I + (μ − λ ln J) ĝ_b ĝ_aᵀ + λ ĝ_a ĝ_bᵀ]

The node law F = T(τ), τ = F − r δ (see `node_law`) is solved in τ: a contact
node carries F = T(τ) and lies at P = Q + (T(τ) − τ)/r, so that Signorini's
and Coulomb's laws hold exactly at every iterate. Unknowns are the
displacements of the interior nodes, τ of the contact nodes and the six of
the pose; equations are the balance of every free node and the wrench:

    f_int(u) − Eᵀ Rᵀ F = 0,  Σ F = F_des,  Σ (P − Z_des) × F = 0.

With D = ∂T/∂τ and dτ = r R ζ a contact node has, in the sole frame,
du = (D̂ − I) ζ and dF = r D̂ ζ at fixed pose, D̂ = Rᵀ D R; a unit pose
increment adds Rᵀ(−dzO + hat(P − Z) dω) to du. Eliminating all but the pose
from the Newton matrix of a converged state gives K_c.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csc_matrix
from scipy.sparse.linalg import splu

from drake_exo.soles.contact.law import (
    FLAT,
    ContactLaw,
    Ground,
    project,
    project_with_derivative,
)
from drake_exo.soles.contact.newton import (
    MOMENT_SCALE,
    Convergence,
    Target,
    capped,
    line_search,
)
from drake_exo.soles.elasticity import Material
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.numerics import exp_rotation, hat


def energy(F: np.ndarray, material: Material) -> np.ndarray:
    """W [J/m³] of deformation gradients (..., 3, 3); J must be positive."""
    log_J = np.log(np.linalg.det(F))
    I1 = (F * F).sum(axis=(-2, -1))
    shear, lam = material.shear_modulus, material.lame_lambda
    return 0.5 * shear * (I1 - 3 - 2 * log_J) + 0.5 * lam * log_J**2


def first_stress(F: np.ndarray, material: Material) -> np.ndarray:
    """First Piola–Kirchhoff stress P = ∂W/∂F [Pa], (..., 3, 3)."""
    inverse = np.swapaxes(np.linalg.inv(F), -1, -2)
    log_J = np.log(np.linalg.det(F))[..., None, None]
    shear, lam = material.shear_modulus, material.lame_lambda
    return shear * (F - inverse) + lam * log_J * inverse


class NeoHookeanBody:
    """Internal forces and tangent of a meshed sole fixed at its top.

    Args:
        mesh: The mesh at rest.
        material: Its Lamé constants.
    """

    def __init__(self, mesh: TetMesh, material: Material):
        self.mesh, self.material = mesh, material

    @cached_property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed."""
        every = np.arange(len(self.mesh.nodes))
        return np.setdiff1d(every, self.mesh.fixed)

    def deformation_gradient(self, u: np.ndarray) -> np.ndarray:
        """F of every element under displacements u (n, 3), (e, 3, 3)."""
        mesh = self.mesh
        H = np.swapaxes(u[mesh.tets], 1, 2) @ mesh.gradients
        return np.eye(3) + H

    def stretches(self, u: np.ndarray) -> tuple[float, float]:
        """Largest and least principal stretch over the elements."""
        F = self.deformation_gradient(u)
        values = np.linalg.svd(F, compute_uv=False)
        return float(values.max()), float(values.min())

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        """Σ_e V P g_a at every node [N], (n, 3).

        Entries are NaN where an element is inverted.
        """
        F = self.deformation_gradient(u)
        mesh = self.mesh
        if (np.real(np.linalg.det(F)) <= 0).any():
            return np.full((len(mesh.nodes), 3), np.nan)
        P = first_stress(F, self.material)
        local = mesh.volumes[:, None, None] * (
            mesh.gradients @ np.swapaxes(P, 1, 2)
        )
        out = np.zeros((len(mesh.nodes), 3), dtype=local.dtype)
        np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
        return out

    def element_tangents(self, u: np.ndarray) -> np.ndarray:
        """∂(element forces)/∂(element displacements), (e, 4, 3, 4, 3)."""
        F = self.deformation_gradient(u)
        g, V = self.mesh.gradients, self.mesh.volumes
        pushed = g @ np.linalg.inv(F)
        log_J = np.log(np.linalg.det(F))
        shear, lam = self.material.shear_modulus, self.material.lame_lambda
        outer = np.einsum("eai,ebj->eaibj", pushed, pushed)
        K = lam * outer
        second = (shear - lam * log_J)[:, None, None, None, None]
        K += second * outer.transpose(0, 1, 4, 3, 2)
        gg = shear * np.einsum("eai,ebi->eab", g, g)
        for i in range(3):
            K[:, :, i, :, i] += gg
        K *= V[:, None, None, None, None]
        return K

    def tangent(self, u: np.ndarray) -> csc_matrix:
        """Tangent stiffness of the free dofs [N/m], sparse symmetric."""
        indptr, indices, place, inside = self._pattern
        values = self.element_tangents(u).reshape(-1)[inside]
        data = np.bincount(place, values, minlength=len(indices))
        size = 3 * len(self.free)
        return csc_matrix((data, indices, indptr), shape=(size, size))

    @cached_property
    def _pattern(self):
        """Sparsity of the free dofs, and where each element entry goes."""
        row_of = np.full(len(self.mesh.nodes), -1)
        row_of[self.free] = np.arange(len(self.free))
        nodes = row_of[self.mesh.tets]
        dofs = np.where(
            nodes[:, :, None] < 0, -1, 3 * nodes[:, :, None] + np.arange(3)
        ).reshape(-1, 12)
        rows = np.repeat(dofs, 12, axis=1).ravel()
        cols = np.tile(dofs, (1, 12)).ravel()
        inside = np.flatnonzero((rows >= 0) & (cols >= 0))
        size = 3 * len(self.free)
        key = cols[inside] * size + rows[inside]
        unique, place = np.unique(key, return_inverse=True)
        indptr = np.searchsorted(unique, np.arange(size + 1) * size)
        return indptr, unique % size, place, inside


_MAX_TURN, _MAX_SHIFT = 0.1, 0.005  # caps on one Newton step: rad, m
_HALVINGS = 8


@dataclass
class FiniteState:
    """A deformed sole on its foot.

    Attributes:
        F: Forces of the ground on the contact nodes, world [N], (m, 3).
        u: Displacements of all nodes, sole frame [m], (n, 3).
        O: Place of the sole frame's origin, world [m], (3,).
        R: Orientation, (3, 3).
    """

    F: np.ndarray
    u: np.ndarray
    O: np.ndarray  # noqa: E741
    R: np.ndarray


class FiniteStrainSolver:
    """Newton for one neo-Hookean sole and one contact law.

    Args:
        body: The sole.
        law: The contact law.
        tolerance: On the largest unbalanced nodal force over |F_des|.
        max_iterations: Newton steps before giving up.
        ground: What it stands on.
    """

    def __init__(
        self,
        body: NeoHookeanBody,
        law: ContactLaw,
        tolerance: float = 1e-9,
        max_iterations: int = 25,
        ground: Ground = FLAT,
    ):
        self.body, self.law, self.ground = body, law, ground
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.nodes = body.mesh.contact
        self.rest = body.mesh.nodes[self.nodes]
        rows = np.searchsorted(body.free, self.nodes)
        self._rows = (3 * rows[:, None] + np.arange(3)).ravel()
        self._blocks = rows

    def places(self, state: FiniteState) -> np.ndarray:
        """World places of the contact nodes [m], (m, 3)."""
        return state.O + (self.rest + state.u[self.nodes]) @ state.R.T

    def solve(
        self, state: FiniteState, target: Target
    ) -> tuple[FiniteState, Convergence]:
        """Newton from `state`; the last state and its report."""
        state = replace(state)
        state.O, state.R = target.turned(state.O, state.R)
        scale = max(float(np.linalg.norm(target.force)), 1e-12)
        point = self._evaluate(self._tau(state, target), state, target, scale)
        history = []
        message = f"no convergence in {self.max_iterations} Newton steps"
        for iteration in range(self.max_iterations + 1):
            history.append(point.merit)
            if point.merit <= self.tolerance:
                return point.state, Convergence(
                    True, iteration, point.merit, "", history
                )
            if not np.isfinite(point.merit):
                message = "inverted elements at the start"
                break
            if iteration == self.max_iterations:
                break
            try:
                step = self._linearise(point, target).newton_step(target.asked)
            except (np.linalg.LinAlgError, RuntimeError):
                message = "singular Newton matrix"
                break
            point = self._line_search(point, step, target, scale)
        return point.state, Convergence(
            False, len(history) - 1, history[-1], message, history
        )

    def cartesian_stiffness(
        self, state: FiniteState, target: Target
    ) -> np.ndarray:
        """K_c (6, 6) about the ZMP at a solution, references frozen."""
        before = target.places_before(state.R, self.rest)
        frozen = replace(target, reference=before)
        point = self._evaluate(self._tau(state, frozen), state, frozen, 1.0)
        return self._linearise(point, frozen).wrench_response()

    def _planes(self, target, R):
        """What the contact nodes meet, see `Ground.planes`."""
        return self.ground.planes(target.places_before(R, self.rest))

    def _tau(self, state, target) -> np.ndarray:
        Q, _ = self._planes(target, state.R)
        return state.F - self.law.penalty * (self.places(state) - Q)

    def _evaluate(self, tau, guess, target, scale) -> "_Point":
        """Residuals with forces and contact places that follow from τ."""
        O, R = guess.O, guess.R  # noqa: E741
        Q, axes = self._planes(target, R)
        F = np.einsum("kij,kj->ki", axes, tau)
        F = np.einsum("kji,kj->ki", axes, project(F, self.law))
        P = Q + (F - tau) / self.law.penalty
        u = guess.u.copy()
        u[self.nodes] = (P - O) @ R - self.rest
        internal = self.body.internal_force(u)
        balance = internal[self.body.free]
        balance[self._blocks] -= F @ R
        arm = P - target.point
        wrench = np.concatenate([F.sum(axis=0), np.cross(arm, F).sum(axis=0)])
        wrench = target.missed(wrench)
        merit = np.inf
        if np.isfinite(balance).all():
            merit = max(
                float(np.abs(balance).max()),
                float(np.abs(wrench[:3]).max()),
                float(np.abs(wrench[3:]).max()) / MOMENT_SCALE,
            )
        state = FiniteState(F, u, O, R)
        return _Point(state, tau, axes, arm, balance, wrench, merit / scale)

    def _linearise(self, point, target) -> "_Linearisation":
        # That planes turn with the foot, too, Newton's steps do without.
        turn = target.turn(self.ground, point.state.R, self.rest)
        return _Linearisation(self, point, turn and turn.places)

    def _line_search(self, point, step, target, scale):
        du, zeta, dp = step
        Z, old = target.point, point.state
        d_tau = self.law.penalty * zeta @ old.R.T

        def trial(size):
            turn = exp_rotation(size * dp[3:])
            u = old.u.copy()
            u[self.body.free] += size * du
            O = Z + turn @ (old.O - Z) + size * dp[:3]  # noqa: E741
            guess = FiniteState(old.F, u, O, turn @ old.R)
            tau = point.tau + size * d_tau
            return self._evaluate(tau, guess, target, scale)

        step = capped(dp, _MAX_TURN, _MAX_SHIFT)
        return line_search(point, trial, step, _HALVINGS)


@dataclass
class _Point:
    """Everything evaluated at one iterate."""

    state: FiniteState
    tau: np.ndarray
    axes: np.ndarray
    arm: np.ndarray
    balance: np.ndarray
    wrench: np.ndarray
    merit: float


class _Linearisation:
    """Newton matrix at an iterate, with all but the pose eliminated."""

    def __init__(self, solver: FiniteStrainSolver, point: _Point, dQ):
        self.solver, self.point = solver, point
        self.R, self.dQ = point.state.R, dQ
        tau = np.einsum("kij,kj->ki", point.axes, point.tau)
        turn = point.axes @ self.R
        _, D = project_with_derivative(tau, solver.law)
        self.D = turn.transpose(0, 2, 1) @ D @ turn
        K = solver.body.tangent(point.state.u)
        r = solver.law.penalty
        count = len(solver.body.free)
        node = np.tile(np.eye(3), (count, 1, 1))
        node[solver._blocks] = self.D - np.eye(3)
        force = np.zeros((count, 3, 3))
        force[solver._blocks] = r * self.D
        A = K @ _block_diagonal(node) - _block_diagonal(force)
        self._lu = splu(
            A.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.05,
            options={"SymmetricMode": True},
        )
        self._pose = self._response_to_pose(K)

    def _response_to_pose(self, K):
        """ζ and interior displacements for unit pose increments."""
        s, m = self.solver, len(self.solver.nodes)
        shift = np.zeros((m, 3, 6))
        shift[:, :, :3] = -np.eye(3)
        shift[:, :, 3:] = hat(self.point.arm)
        if self.dQ is not None:
            shift[:, :, 3:] += self.dQ
        rhs = K[:, s._rows] @ (self.R.T @ shift).reshape(3 * m, 6)
        turned = self.R.T @ hat(self.point.state.F)
        rhs[s._rows, 3:] -= turned.reshape(3 * m, 3)
        return self._lu.solve(-rhs)

    def _split(self, x):
        """Node ζ (m, 3, c) of solutions x (3 n_f, c)."""
        return x[self.solver._rows].reshape(len(self.solver.nodes), 3, -1)

    def _wrench_change(self, x, with_pose: bool) -> np.ndarray:
        zeta = self._split(x)
        F, arm = self.point.state.F, self.point.arm
        dF = self.solver.law.penalty * self.R @ (self.D @ zeta)
        dP = self.R @ (self.D @ zeta - zeta)
        if with_pose and self.dQ is not None:
            dP = dP.copy()
            dP[:, :, 3:] += self.dQ
        moment = np.einsum("kij,kjc->ic", hat(arm), dF)
        moment -= np.einsum("kij,kjc->ic", hat(F), dP)
        return np.concatenate([dF.sum(axis=0), moment])

    def wrench_response(self) -> np.ndarray:
        """[dF; dΓ_Z] for unit pose increments (dzO, dω), (6, 6)."""
        return self._wrench_change(self._pose, True)

    def newton_step(self, asked):
        """Interior du (n_f, 3), ζ (m, 3), pose increment (6,).

        Args:
            asked: Components of wrench and pose that are solved for.
        """
        x = self._lu.solve(-self.point.balance.reshape(-1, 1))
        carried = self._wrench_change(x, False)[:, 0]
        dp, G = np.zeros(6), self.wrench_response()[np.ix_(asked, asked)]
        lacking = self.point.wrench + carried
        dp[asked] = np.linalg.solve(G, -lacking[asked])
        if not np.isfinite(dp).all():
            raise np.linalg.LinAlgError
        x = x[:, 0] + self._pose @ dp
        return x.reshape(-1, 3), x[self.solver._rows].reshape(-1, 3), dp


def _block_diagonal(blocks: np.ndarray):
    """Sparse matrix with 3 × 3 blocks (k, 3, 3) on its diagonal."""
    k = len(blocks)
    return bsr_matrix((blocks, np.arange(k), np.arange(k + 1))).tocsc()
