"""Inverse of the compliance between the nodes in contact, kept up to date.

Most Newton steps change the set of touching nodes by a few, so that the
inverse S = C_AA⁻¹ is bordered or deflated (O(n²) a node) instead of being
factorised anew. It lives in the sole frame and hence outlasts pose changes.
"""

import numba
import numpy as np
from scipy.linalg import get_lapack_funcs

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

    @property
    def dofs(self) -> np.ndarray:
        """Contact dofs of the active nodes, (3k,)."""
        return node_dofs(self.nodes)

    def refresh(self) -> None:
        """Invert C_AA from scratch."""
        n = 3 * len(self.nodes)
        self._reserve(n)
        self._updates = 0
        if n == 0:
            return
        A = blocks(self._C, self.nodes, self.nodes)
        potrf, potri = get_lapack_funcs(("potrf", "potri"), (A,))
        factor, info = potrf(A, lower=True, clean=False)
        inverse, info2 = potri(factor, lower=True)
        if info or info2:
            raise np.linalg.LinAlgError("compliance is not positive definite")
        lower = np.tril(inverse)
        self._S[:n, :n] = lower + np.tril(inverse, -1).T

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


@numba.njit(cache=True)
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


def node_dofs(nodes: np.ndarray) -> np.ndarray:
    """Dofs 3i, 3i+1, 3i+2 of nodes, (3k,)."""
    return (3 * np.asarray(nodes)[:, None] + np.arange(3)).ravel()
