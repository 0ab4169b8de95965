"""Newton matrix of the contact problem, eliminated onto few unknowns.

With S = W_AA⁻¹ the force increments follow from the place increments:
dF = S (dδ − D_p dp). A firmly sticking node has dδ = −δ at once, so that
only slipping nodes, those inside the smoothed layer, and the six pose
unknowns remain. All matrices are in the sole frame here.
"""

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from drake_exo.soles.active_set import ActiveSet, node_dofs
from drake_exo.soles.node_law import (
    ContactLaw,
    firmly_sticking,
    project_with_derivative,
)
from drake_exo.soles.rotations import hat


class Linearisation:
    """Derivatives of node law and wrench at one state, active nodes only.

    Args:
        active: Active set with S; used at once, not kept beyond its update.
        law: Contact law.
        R: Foot orientation.
        arm: P_i − Z_des of the active nodes, world [m], (k, 3).
        F: Their forces, world [N], (k, 3).
        tau: Their τ = F − r δ, world [N], (k, 3).
    """

    def __init__(self, active: ActiveSet, law: ContactLaw, R, arm, F, tau):
        self.nodes, self.S = active.nodes, active.S
        self.R, self.arm, self.F = R, arm, F
        self.law, self.tau = law, tau
        self.r = law.penalty
        self._arm_cross, self._F_cross = hat(arm), hat(F)
        self.loose = np.flatnonzero(~firmly_sticking(tau, law))
        _, D = project_with_derivative(tau[self.loose], law)
        self.D = R.T @ D @ R
        self._g = node_dofs(self.loose)
        self._lu = self._factorise()
        self._S_g = self.S[:, self._g]

    def _factorise(self):
        """LU of M = (I − D) S_gg + r D."""
        n, k = len(self._g), len(self.loose)
        if n == 0:
            return None
        S_gg = self.S[np.ix_(self._g, self._g)]
        M = S_gg - self._times_D(S_gg)
        blocks = M.reshape(k, 3, k, 3)
        place = np.arange(k)
        blocks[place, :, place, :] += self.r * self.D
        factor, pivots, info = dgetrf(M)
        if info:
            raise np.linalg.LinAlgError("singular law at the loose nodes")
        return factor, pivots

    def _times_D(self, X: np.ndarray) -> np.ndarray:
        """D X for stacked rows X (3g, c)."""
        return (self.D @ X.reshape(len(self.loose), 3, -1)).reshape(X.shape)

    def _respond(self, offset: np.ndarray, S_rhs: np.ndarray, phi_g):
        """Solve dF = S dδ + S_rhs with firm dδ = offset.

        Args:
            offset: dδ of firm nodes, zero elsewhere (3k, c), or None.
            S_rhs: S times what is added to dδ, sole frame, (3k, c).
            phi_g: Law residual of the loose nodes, (3g, c) or None.

        Returns:
            dF and dδ, sole frame, (3k, c) each.
        """
        T = S_rhs if offset is None else S_rhs + self.S @ offset
        d_delta = np.zeros_like(T) if offset is None else offset.copy()
        if self._lu is None:
            return T, d_delta
        T_g = T[self._g]
        rhs = self._times_D(T_g) - T_g
        if phi_g is not None:
            rhs -= phi_g
        x = dgetrs(*self._lu, rhs)[0]
        d_delta[self._g] = x
        return T + self._S_g @ x, d_delta

    def pose_response(self, dQ: np.ndarray | None = None):
        """Changes dF and dδ for unit pose increments (dzO, dω), (k, 3, 6)."""
        dF, d_delta = self._respond(None, self._minus_S_pose(dQ), None)
        return self._to_world(dF), self._to_world(d_delta)

    def _minus_S_pose(self, dQ) -> np.ndarray:
        """−S D_p (3k, 6): S W hat(F) = hat(F) spares the product with C."""
        k = len(self.nodes)
        right = np.zeros((k, 3, 6))
        right[:, :, :3] = -np.eye(3)
        right[:, :, 3:] = self._arm_cross
        if dQ is not None:
            right[:, :, 3:] += dQ
        right = (self.R.T @ right).reshape(3 * k, 6)
        out = self.S @ right
        out.reshape(k, 3, 6)[:, :, 3:] -= self.R.T @ self._F_cross
        return out

    def _to_world(self, x: np.ndarray) -> np.ndarray:
        return self.R @ x.reshape(len(self.nodes), 3, -1)

    def law_response(self, phi: np.ndarray):
        """Newton step dF, dδ at fixed pose, world, (k, 3)."""
        local = (phi @ self.R).reshape(-1, 1)
        offset = -local / self.r
        offset[self._g] = 0.0
        dF, d_delta = self._respond(
            offset, np.zeros_like(offset), local[self._g]
        )
        return self._to_world(dF)[:, :, 0], self._to_world(d_delta)[:, :, 0]

    def solve_forces(self, phi: np.ndarray) -> np.ndarray:
        """Newton step of the forces at fixed pose, world [N], (k, 3)."""
        return self.law_response(phi)[0]

    def wrench_change(self, dF, dP) -> np.ndarray:
        """[ΣdF; Σ(P−Z)×dF + dP×F] for fields (k, 3, c) -> (6, c)."""
        force = dF.sum(axis=0)
        columns = dF.shape[2]
        moment = _side_by_side(self._arm_cross) @ dF.reshape(-1, columns)
        moment -= _side_by_side(self._F_cross) @ dP.reshape(-1, columns)
        return np.concatenate([force, moment])

    def solve(self, phi, wrench, dQ=None):
        """Newton step for law residual phi (k, 3) and wrench residual (6,).

        Returns:
            dF (k, 3) world, dp = (dzO, dω) (6,).
        """
        F0, x0 = self.law_response(phi)
        F1, x1 = self.pose_response(dQ)
        if dQ is not None:
            x1 = x1.copy()
            x1[:, :, 3:] += dQ
        G0 = self.wrench_change(F0[:, :, None], x0[:, :, None])[:, 0]
        G1 = self.wrench_change(F1, x1)
        dp = np.linalg.solve(G1, -(wrench + G0))
        return F0 + F1 @ dp, dp

    def cartesian_stiffness(self) -> np.ndarray:
        """K_c (6, 6): [dF; dΓ_Z] = K_c [dzO; dω], references frozen."""
        dF, d_delta = self.pose_response()
        return self.wrench_change(dF, d_delta)

    def solve_transposed(self, Sb: np.ndarray):
        """Solve J_Fᵀ z = b for b given as S b.

        Args:
            Sb: S times the right-hand sides, world, (c, k, 3).

        Returns:
            z, y = Bᵀ z = r Dᵀ z, and e = (I − D)ᵀ z with W y = b − e;
            world, (c, k, 3) each.
        """
        local = (Sb @ self.R).reshape(len(Sb), -1)
        y, e, z_g = local, np.zeros_like(local), None
        if self._lu is not None:
            z_g = dgetrs(*self._lu, local[:, self._g].T, trans=1)[0].T
            blocks = z_g.reshape(len(Sb), -1, 1, 3)
            e[:, self._g] = z_g - (blocks @ self.D).reshape(z_g.shape)
            y = local - e[:, self._g] @ self._S_g.T
        z = y / self.r
        if z_g is not None:
            z[:, self._g] = z_g
        return tuple(x.reshape(Sb.shape) @ self.R.T for x in (z, y, e))

    def times_S(self, x: np.ndarray) -> np.ndarray:
        """W_AA⁻¹ times fields, world, (c, k, 3)."""
        local = (x @ self.R).reshape(len(x), -1) @ self.S
        return local.reshape(x.shape) @ self.R.T

    def second_order(self, d_tau: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(∂D/∂τ · dτ)ᵀ z at every node, world, all (c, k, 3).

        By a complex step, hence exact; zero at firmly sticking nodes.
        """
        out = np.zeros(d_tau.shape)
        if len(self.loose):
            tau = self.tau[self.loose] + 1e-30j * d_tau[:, self.loose]
            _, D = project_with_derivative(tau.reshape(-1, 3), self.law)
            change = D.imag.reshape(*tau.shape, 3) / 1e-30
            out[:, self.loose] = np.einsum(
                "ckij,cki->ckj", change, z[:, self.loose]
            )
        return out


def _side_by_side(A: np.ndarray) -> np.ndarray:
    """Blocks (k, 3, 3) in one row, (3, 3k)."""
    return A.transpose(1, 0, 2).reshape(3, -1)
