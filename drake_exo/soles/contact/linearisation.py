"""Newton matrix of the contact problem, reduced to few unknowns.

With S = C_AA⁻¹ of the compliance between the touching nodes A, the force
increments follow from the place increments: dF = S (dδ − D_p dp). Firmly
sticking nodes have dδ = −δ, so only slipping nodes, those inside the smoothed
layer ("loose" nodes) and the six pose unknowns remain. Matrices are in the sole
frame, so that S stays valid as the pose changes; most Newton steps change A by
a few nodes, for which S is bordered or deflated (O(n²) per node) instead of
being factorised anew.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs, dpotrf, dpotri

from drake_exo.soles.contact.law import (
    ContactLaw,
    firmly_sticking,
    project_with_derivative,
)
from drake_exo.soles.elasticity import mirrored, node_dofs
from drake_exo.soles.numerics import hat

# Updates of S accumulate rounding: factorise afresh after so many.
_UPDATES_BEFORE_REFRESH = 80


class ActiveSet:
    """Ordered set of active (touching) contact nodes with S = C_AA⁻¹.

    Attributes:
        nodes: Active contact nodes, in the order of S's blocks, (k,).
        S: C_AA⁻¹ [N/m], (3k, 3k).
    """

    def __init__(self, C: np.ndarray):
        self._C = C
        self.nodes = np.zeros(0, dtype=np.int64)
        self.S = np.zeros((0, 0))
        self._updates = 0

    def refresh(self) -> None:
        """Invert C_AA from scratch."""
        self._updates = 0
        if len(self.nodes) == 0:
            self.S = np.zeros((0, 0))
            return
        own = node_dofs(self.nodes)
        A = self._C[np.ix_(own, own)].T
        factor, info = dpotrf(A, lower=1, clean=0, overwrite_a=1)
        inverse, info2 = dpotri(factor, lower=1, overwrite_c=1)
        if info or info2:
            raise np.linalg.LinAlgError("compliance is not positive definite")
        self.S = mirrored(inverse).T  # symmetric: now its rows are contiguous

    def update(self, wanted: np.ndarray) -> None:
        """Make `wanted` (contact nodes, any order) the active set."""
        is_wanted = np.zeros(len(self._C) // 3, dtype=bool)
        is_wanted[wanted] = True
        keep = is_wanted[self.nodes]
        drop = np.flatnonzero(~keep)
        is_wanted[self.nodes] = False
        add = np.flatnonzero(is_wanted)
        change = len(drop) + len(add)
        if change == 0:
            return
        self._updates += 1
        if 3 * change > len(wanted) or self._updates > _UPDATES_BEFORE_REFRESH:
            self.nodes = np.concatenate([self.nodes[keep], add])
            self.refresh()
            return
        if len(drop):
            self._remove(drop)
        if len(add):
            self._append(add)

    def _remove(self, places: np.ndarray) -> None:
        """Remove nodes at `places`: moved to the end, S11 − S12 S22⁻¹ S21."""
        k = len(self.nodes)
        tail = np.arange(k - len(places), k)
        movers = np.setdiff1d(tail, places)
        holes = np.setdiff1d(places, tail)
        there, back = np.hstack([holes, movers]), np.hstack([movers, holes])
        a, b, S = node_dofs(there), node_dofs(back), self.S
        S[a] = S[b]
        S[:, a] = S[:, b]
        self.nodes[there] = self.nodes[back]
        n = 3 * (k - len(places))
        V = S[:n, n:].copy()
        self.S = S[:n, :n] - V @ np.linalg.solve(S[n:, n:], V.T)
        self.nodes = self.nodes[: k - len(places)].copy()

    def _append(self, new: np.ndarray) -> None:
        """Append nodes: S becomes the inverse of [[C_AA, B], [Bᵀ, C_aa]]."""
        own, more = node_dofs(self.nodes), node_dofs(new)
        B = self._C[np.ix_(own, more)]
        V = self.S @ B
        corner = self._C[np.ix_(more, more)] - B.T @ V
        T = np.linalg.inv(0.5 * (corner + corner.T))
        self.nodes = np.concatenate([self.nodes, new])
        VT = V @ T
        self.S = np.block([[self.S + VT @ V.T, -VT], [-VT.T, T]])


@dataclass(frozen=True)
class Turn:
    """How nodes' planes follow the foot's turn before contact, (k, 3, 3) each.

    Attributes:
        places: Derivative of the nodes' references on the planes [m/rad].
        axes: Derivative of the planes' own turns [rad/rad].
    """

    places: np.ndarray
    axes: np.ndarray


class Linearisation:
    """Derivatives of node law and wrench at one state, k active nodes only.

    Args:
        active: Active set with S; valid until its next update, see `kept`.
        law: Contact law.
        point: `ContactSolver`'s evaluation at the state, of all nodes: P_i −
            Z_des [m] and forces [N], world, τ = F − r δ [N] in the axes of
            their planes.
    """

    def __init__(self, active: ActiveSet, law: ContactLaw, point):
        self.nodes, self.S = active.nodes, active.S
        self.law, self.r, self.R = law, law.penalty, point.state.R
        self.arm, self.F, self.tau, self.axes = (
            of_all[self.nodes]
            for of_all in (point.arm, point.state.F, point.tau, point.axes)
        )
        self.loose = np.flatnonzero(~firmly_sticking(self.tau, law))
        self._g = node_dofs(self.loose)
        _, D = project_with_derivative(self.tau[self.loose], law)
        turn = self.axes[self.loose] @ self.R
        self.D = turn.transpose(0, 2, 1) @ D @ turn
        self._lu = None
        self._S_g = self.S[:, self._g]
        if len(self.loose):
            # (I − D) S_gg + r D.
            M = -self._less(self._S_g[self._g])
            of_node = M.reshape(len(D), 3, len(D), 3)
            every = np.arange(len(D))
            of_node[every, :, every] += self.r * self.D
            factor, pivots, info = dgetrf(M, overwrite_a=1)
            if info:
                raise np.linalg.LinAlgError("singular law at the loose nodes")
            self._lu = factor, pivots

    def _less(self, x: np.ndarray) -> np.ndarray:
        """(D − I) x at the loose nodes, (3g, c)."""
        rows = x.reshape(len(self.D), 3, -1)
        return (self.D @ rows - rows).reshape(x.shape)

    def _respond(self, T, known, phi_g=None, turned=None):
        """Solve dF = S dδ + S rhs for dF and dδ, (3k, c) each, sole frame.

        `known` is dδ of the firm nodes; the loose nodes' (0) are filled in. T
        is S (known + rhs). The loose nodes' law residual is `phi_g` (3g,) in
        the first column, and `turned` (3g, 3) in the last three.
        """
        if self._lu is None:
            return T, known
        rhs = self._less(T[self._g])
        if phi_g is not None:
            rhs[:, 0] -= phi_g
        if turned is not None:
            rhs[:, -3:] -= turned
        x = dgetrs(*self._lu, rhs)[0]
        known[self._g] = x
        return T + self._S_g @ x, known

    def pose_response(self, turn: Turn | None = None):
        """Response to unit pose increments (dzO, dω), with `turn` of planes.

        Returns:
            dF and dδ of nodes, world, (k, 3, 6); [dF; dΓ] about the ZMP (6, 6).
        """
        T = self._S_times_pose(turn)
        turned = self._law_turned(turn)
        both = self._respond(T, np.zeros_like(T), turned=turned)
        world = [self.R @ x.reshape(len(self.nodes), 3, -1) for x in both]
        return *world, self._pose_wrench(*both, turn)

    def _law_turned(self, turn) -> np.ndarray | None:
        """Derivative of loose nodes' law residual by turning planes, (3g, 3).

        T of a plane turned by α changes by α × T − D (α × τ).
        """
        if turn is None:
            return None
        at, R = self.loose, self.R
        by = hat(self.F[at]) - R @ self.D @ R.T @ hat(self.tau_world[at])
        return (R.T @ by @ turn.axes[at]).reshape(-1, 3)

    @property
    def tau_world(self) -> np.ndarray:
        """τ in the world's axes [N], (k, 3)."""
        return np.einsum("kji,kj->ki", self.axes, self.tau)

    def _pose_wrench(self, dF, dP, turn=None) -> np.ndarray:
        """[dF; dΓ] about the ZMP of responses whose last 6 are the pose's."""
        if turn is not None:
            dP[:, -3:] += self._to_sole(turn.places)
        out = -self._arms.T @ dF
        out[3:] += self._turned.T @ dP
        return out

    @cached_property
    def _arms(self) -> np.ndarray:
        """Rᵀ (−I, hat(P − Z)) of every node, (3k, 6)."""
        shift = np.tile(-self.R.T, (len(self.nodes), 1))
        return np.concatenate((shift, self._hats(self.arm)), axis=1)

    @cached_property
    def _turned(self) -> np.ndarray:
        """Rᵀ hat(F), (3k, 3)."""
        return self._hats(self.F)

    def _S_times_pose(self, turn, *first: np.ndarray) -> np.ndarray:
        """S times columns `first` (3k, c) each and −D_p, (3k, c + 6)."""
        pose = self._arms
        if turn is not None:
            pose = pose.copy()
            pose[:, 3:] += self._to_sole(turn.places)
        T = self.S @ np.concatenate((*first, pose), axis=1)
        # D_p's part in F needs no product: S W hat(F) = hat(F).
        T[:, -3:] -= self._turned
        return T

    def _hats(self, v: np.ndarray) -> np.ndarray:
        """Rᵀ hat(v) of vectors (k, 3), (3k, 3)."""
        return hat(v @ self.R).reshape(-1, 3) @ self.R.T

    def _to_sole(self, x: np.ndarray) -> np.ndarray:
        return (self.R.T @ x).reshape(3 * len(self.nodes), -1)

    def solve(self, phi, wrench, asked, turn=None):
        """Newton step dF (k, 3), world [N], and dp = (dzO, dω) (6,).

        For residuals phi (k, 3) of the law and `wrench` (6,); dp and wrench
        only in the components `asked`; `turn` if the planes turn.
        """
        local, dp = (phi @ self.R).reshape(-1, 1), np.zeros(6)
        # dδ of firm nodes, residual of the loose ones.
        offset, phi_g = -local / self.r, local[self._g, 0]
        offset[self._g] = 0.0
        if not len(asked):
            dF, _ = self._respond(self.S @ offset, offset, phi_g)
            return dF.reshape(-1, 3) @ self.R.T, dp
        # One product with S, one solution for offset and pose together.
        T = self._S_times_pose(turn, offset)
        known = np.zeros_like(T)
        known[:, :1] = offset
        dF, dP = self._respond(T, known, phi_g, self._law_turned(turn))
        G = self._pose_wrench(dF, dP, turn)
        at = np.ix_(asked, asked)
        dp[asked] = np.linalg.solve(G[:, 1:][at], -(wrench + G[:, 0])[asked])
        step = dF[:, 0] + dF[:, 1:] @ dp
        return step.reshape(-1, 3) @ self.R.T, dp

    @cached_property
    def cartesian_stiffness(self) -> np.ndarray:
        """K_c (6, 6): [dF; dΓ_Z] = K_c [dzO; dω], references frozen."""
        return self.frozen_response[2]

    @cached_property
    def frozen_response(self):
        """`pose_response` with the references frozen."""
        return self.pose_response()

    def kept(self) -> "Linearisation":
        """Itself, now independent of the active set's later updates."""
        self.S, self.nodes = self.S.copy(), self.nodes.copy()
        return self

    def solve_transposed(self, Sb: np.ndarray):
        """Solve J_Fᵀ z = b for b given as S b, world, (c, k, 3).

        Returns z, y = Bᵀ z = r Dᵀ z, and e = (I − D)ᵀ z with W y = b − e.
        """
        local = (Sb @ self.R).reshape(len(Sb), -1)
        y, e, z_g = local, np.zeros_like(local), None
        if self._lu is not None:
            z_g = dgetrs(*self._lu, local[:, self._g].T, trans=1)[0].T
            rows = z_g.reshape(len(Sb), -1, 1, 3)
            e[:, self._g] = z_g - (rows @ self.D).reshape(z_g.shape)
            y = local - e[:, self._g] @ self._S_g.T
        z = y / self.r
        if z_g is not None:
            z[:, self._g] = z_g
        return tuple(x.reshape(Sb.shape) @ self.R.T for x in (z, y, e))

    def times_S(self, x: np.ndarray) -> np.ndarray:
        """S in world axes (W_AA⁻¹, W = R C Rᵀ) times fields x (c, k, 3)."""
        local = (x @ self.R).reshape(len(x), -1) @ self.S
        return local.reshape(x.shape) @ self.R.T

    def second_order(self, d_tau: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(∂D/∂τ · dτ)ᵀ z at every node, world, all (c, k, 3).

        By a complex step, hence exact; zero at firmly sticking nodes.
        """
        out = np.zeros(d_tau.shape)
        if len(self.loose):
            axes = self.axes[self.loose]
            d_tau, z = (
                np.einsum("kij,ckj->cki", axes, x[:, self.loose])
                for x in (d_tau, z)
            )
            tau = self.tau[self.loose] + 1e-30j * d_tau
            _, D = project_with_derivative(tau.reshape(-1, 3), self.law)
            change = D.imag.reshape(*tau.shape, 3) / 1e-30
            out[:, self.loose] = np.einsum("ckij,cki,kjl->ckl", change, z, axes)
        return out
