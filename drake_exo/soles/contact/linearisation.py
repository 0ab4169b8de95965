"""Newton matrix of the contact problem, eliminated onto few unknowns.

With S = C_AA⁻¹ of the compliance between the touching nodes A, the force
increments follow from the place increments: dF = S (dδ − D_p dp). A firmly
sticking node has dδ = −δ at once, so that only slipping nodes, those inside
the smoothed layer, and the six pose unknowns remain. All matrices are in the
sole frame here, so that S outlasts changes of the pose; as most Newton steps
change the set of touching nodes by a few, S is bordered or deflated (O(n²) a
node) instead of being factorised anew.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs, dpotrf, dpotri

from drake_exo.soles.contact.law import (
    ContactLaw,
    firmly_sticking,
    project_node,
    project_with_derivative,
)
from drake_exo.soles.elasticity import mirrored, node_dofs
from drake_exo.soles.numerics import hat, multiply, njit

# Borderings accumulate rounding: start afresh after so many.
_UPDATES_BEFORE_REFRESH = 80


class ActiveSet:
    """Ordered set of active contact nodes with S = C_AA⁻¹.

    Attributes:
        nodes: Active contact nodes, in the order of S's blocks, (k,).
    """

    def __init__(self, C: np.ndarray):
        self._C = C
        self.nodes = np.zeros(0, dtype=np.int64)
        self._S = np.zeros((0, 0))
        self._updates = 0

    @property
    def S(self) -> np.ndarray:
        """C_AA⁻¹ [N/m], (3k, 3k)."""
        return self._S[: 3 * len(self.nodes), : 3 * len(self.nodes)]

    def refresh(self) -> None:
        """Invert C_AA from scratch."""
        n = 3 * len(self.nodes)
        self._reserve(n)
        self._updates = 0
        if n == 0:
            return
        A = blocks(self._C, self.nodes, self.nodes).T
        factor, info = dpotrf(A, lower=1, clean=0, overwrite_a=1)
        inverse, info2 = dpotri(factor, lower=1, overwrite_c=1)
        if info or info2:
            raise np.linalg.LinAlgError("compliance is not positive definite")
        self._S[:n, :n] = mirrored(inverse)

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

    def _reserve(self, n: int) -> None:
        if n > len(self._S):
            size = min(len(self._C), n + 90)
            old = self._S
            self._S = np.zeros((size, size))
            self._S[: len(old), : len(old)] = old

    def _remove(self, places: np.ndarray) -> None:
        """Deflate: S11 − S12 S22⁻¹ S21, after moving `places` to the end."""
        k = len(self.nodes)
        tail = np.arange(k - len(places), k)
        movers = np.setdiff1d(tail, places)
        holes = np.setdiff1d(places, tail)
        S = self.S
        a, b = node_dofs(holes), node_dofs(movers)
        S[np.concatenate([a, b])] = S[np.concatenate([b, a])]
        S[:, np.concatenate([a, b])] = S[:, np.concatenate([b, a])]
        self.nodes[holes], self.nodes[movers] = (
            self.nodes[movers],
            self.nodes[holes].copy(),
        )
        n = 3 * (k - len(places))
        V = S[:n, n:].copy()
        S[:n, :n] -= V @ np.linalg.solve(S[n:, n:], V.T)
        self.nodes = self.nodes[: k - len(places)].copy()

    def _append(self, new: np.ndarray) -> None:
        """Border: the inverse of [[C_AA, B], [Bᵀ, C_aa]]."""
        n, k = 3 * len(self.nodes), 3 * len(new)
        B = blocks(self._C, self.nodes, new)
        V = self.S @ B
        corner = blocks(self._C, new, new) - B.T @ V
        T = np.linalg.inv(0.5 * (corner + corner.T))
        self.nodes = np.concatenate([self.nodes, new])
        self._reserve(n + k)
        S = self.S
        VT = V @ T
        S[:n, :n] += VT @ V.T
        S[:n, n:] = -VT
        S[n:, :n] = -VT.T
        S[n:, n:] = T


@njit()
def blocks(A, rows, columns):
    """The 3 × 3 blocks of A at some nodes, (3 rows, 3 columns)."""
    out = np.empty((3 * len(rows), 3 * len(columns)))
    for a in range(len(rows)):
        for i in range(3):
            row, to = A[3 * rows[a] + i], out[3 * a + i]
            for b in range(len(columns)):
                for j in range(3):
                    to[3 * b + j] = row[3 * columns[b] + j]
    return out


@dataclass(frozen=True)
class Turn:
    """How the planes that nodes meet follow the foot's turn, (k, 3, 3) each.

    Attributes:
        places: Derivative of the nodes' references on them [m/rad].
        axes: Of the planes' own turns.
    """

    places: np.ndarray
    axes: np.ndarray


class Linearisation:
    """Derivatives of node law and wrench at one state, active nodes only.

    Args:
        active: Active set with S; used at once, not kept beyond its update.
        law: Contact law.
        point: What `ContactSolver` evaluates at the state, of all nodes: P_i −
            Z_des [m] and forces [N], world, τ = F − r δ [N] in the axes of
            the planes that they meet.
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
        self.D, M = _law_matrix(
            self.S, self.loose, self.tau, self.axes, self.R, self.r,
            law.friction, law.epsilon, law.kappa,
        )  # fmt: skip
        self._lu = None
        if len(self.loose):
            factor, pivots, info = dgetrf(M, overwrite_a=1)
            if info:
                raise np.linalg.LinAlgError("singular law at the loose nodes")
            self._lu = factor, pivots
        self._S_g = blocks(self.S, np.arange(len(self.nodes)), self.loose)

    def _respond(self, T, known, phi_g=None, turned=None):
        """Solve dF = S dδ + S rhs for dF and dδ, (3k, c) each, sole frame.

        T is S times both rhs and the dδ that are `known` (zero elsewhere,
        filled). The law residual of the loose nodes is `phi_g` (3g,) in the
        first column, and `turned` (3g, 3) in the last ones.
        """
        if self._lu is None:
            return T, known
        rhs = _loose_rhs(self.D, T, self.loose)
        if phi_g is not None:
            rhs[:, 0] -= phi_g
        if turned is not None:
            rhs[:, -3:] -= turned
        x = dgetrs(*self._lu, rhs)[0]
        known[self._g] = x
        return T + self._S_g @ x, known

    def pose_response(self, turn: Turn | None = None):
        """What unit pose increments (dzO, dω) change, planes turning or not.

        Returns:
            dF and dδ (k, 3, 6), [dF; dΓ] about the ZMP (6, 6).
        """
        T = self._S_times(self._against_pose(turn))
        turned = self._law_turned(turn)
        both = self._respond(T, np.zeros_like(T), turned=turned)
        world = [self.R @ x.reshape(len(self.nodes), 3, -1) for x in both]
        return *world, self._pose_wrench(*both, turn)

    def _law_turned(self, turn) -> np.ndarray | None:
        """Of the loose nodes' law residual by planes that turn, (3g, 3).

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
        """[dF; dΓ] of what columns change that end with `_against_pose`'s."""
        if turn is not None:
            dP[:, -3:] += self._to_sole(turn.places)
        return _wrench_change(self.R, self.arm, self.F, dF, dP)

    def _against_pose(self, turn) -> np.ndarray:
        """−D_p but for its part in F, (3k, 6)."""
        shift = np.tile(-self.R.T, (len(self.nodes), 1))
        turned = _turned_hats(self.R, self.arm)
        if turn is not None:
            turned += self._to_sole(turn.places)
        return np.concatenate((shift, turned), axis=1)

    def _S_times(self, columns: np.ndarray) -> np.ndarray:
        """S times columns that end with those of `_against_pose`, whole.

        Their part in F needs no product: S W hat(F) = hat(F).
        """
        T = self.S @ columns
        T[:, -3:] -= _turned_hats(self.R, self.F)
        return T

    def _to_sole(self, x: np.ndarray) -> np.ndarray:
        return (self.R.T @ x).reshape(3 * len(self.nodes), -1)

    def solve(self, phi, wrench, asked, turn=None):
        """Newton step dF (k, 3), world, and dp = (dzO, dω) (6,).

        For law residual phi (k, 3) and wrench residual (6,), in the components
        of both that are `asked` for, with planes that `turn`, if they do.
        """
        local, dp = (phi @ self.R).reshape(-1, 1), np.zeros(6)
        # dδ of firm nodes, residual of the loose ones.
        offset, phi_g = -local / self.r, local[self._g, 0]
        offset[self._g] = 0.0
        if not len(asked):
            dF, _ = self._respond(self.S @ offset, offset, phi_g)
            return dF.reshape(-1, 3) @ self.R.T, dp
        pose = self._against_pose(turn)
        # One product with S, one solution for offset and pose together.
        T = self._S_times(np.concatenate((offset, pose), axis=1))
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
        """`pose_response` where the references stay."""
        return self.pose_response()

    def kept(self) -> "Linearisation":
        """Itself, for as long as it is needed: the active set goes on."""
        self.S, self.nodes = self.S.copy(), self.nodes.copy()
        return self

    def solve_transposed(self, Sb: np.ndarray):
        """Solve J_Fᵀ z = b for b given as S b, world, (c, k, 3).

        z, y = Bᵀ z = r Dᵀ z, and e = (I − D)ᵀ z with W y = b − e, likewise.
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
        """W_AA⁻¹ times fields, world, (c, k, 3)."""
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


@njit()
def _law_matrix(S, loose, tau, axes, R, r, mu, epsilon, kappa):
    """D of the loose nodes, sole frame (g, 3, 3), and (I − D) S_gg + r D."""
    g = len(loose)
    D = np.empty((g, 3, 3))
    M = np.empty((3 * g, 3 * g)).T  # columns lie together, as LAPACK's do
    T, plain, half = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    turn, x = np.empty((3, 3)), np.empty(3)
    for a in range(g):
        project_node(tau[loose[a]], mu, epsilon, kappa, T, plain)
        multiply(axes[loose[a]], R, turn)
        multiply(plain, turn, half)
        multiply(turn.T, half, D[a])
    for b in range(g):
        for j in range(3):
            column = 3 * loose[b] + j
            for a in range(g):
                # S is symmetric: its rows lie together in memory.
                for i in range(3):
                    x[i] = S[column, 3 * loose[a] + i]
                for i in range(3):
                    turned = D[a, i, 0] * x[0] + D[a, i, 1] * x[1]
                    turned += D[a, i, 2] * x[2]
                    M[3 * a + i, 3 * b + j] = x[i] - turned
                    if a == b:
                        M[3 * a + i, 3 * b + j] += r * D[a, i, j]
    return D, M


@njit()
def _loose_rhs(D, T, loose):
    """(D − I) T of the loose nodes, (3g, c)."""
    out = np.empty((T.shape[1], 3 * len(loose))).T
    for a in range(len(loose)):
        x = T[3 * loose[a] : 3 * loose[a] + 3]
        for i in range(3):
            for c in range(T.shape[1]):
                out[3 * a + i, c] = (
                    D[a, i, 0] * x[0, c]
                    + D[a, i, 1] * x[1, c]
                    + D[a, i, 2] * x[2, c]
                    - x[i, c]
                )
    return out


@njit()
def _turned_hats(R, v):
    """Rᵀ hat(v) of vectors v (k, 3), (3k, 3)."""
    out = np.empty((3 * len(v), 3))
    for n in range(len(v)):
        x, y, z = v[n]
        for i in range(3):
            a, b, c = R[0, i], R[1, i], R[2, i]
            row = out[3 * n + i]
            row[0], row[1], row[2] = b * z - c * y, c * x - a * z, a * y - b * x
    return out


@njit()
def _wrench_change(R, arm, F, dF, dP):
    """[ΣdF; Σ(P−Z)×dF + dP×F] for fields that R turns, (3k, c) -> (6, c)."""
    out = np.zeros((6, dF.shape[1]))
    f, x = np.empty(3), np.empty(3)
    for n in range(len(arm)):
        for c in range(dF.shape[1]):
            for i in range(3):
                f[i] = x[i] = 0.0
                for j in range(3):
                    f[i] += R[i, j] * dF[3 * n + j, c]
                    x[i] += R[i, j] * dP[3 * n + j, c]
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                out[i, c] += f[i]
                out[3 + i, c] += arm[n, j] * f[k] - arm[n, k] * f[j]
                out[3 + i, c] += x[j] * F[n, k] - x[k] * F[n, j]
    return out
