"""Sparse Cholesky factorisation of a stiffness matrix by dense fronts.

Nested dissection by places (George, SIAM J. Numer. Anal. 10, 1973) halves
the nodes until few are left; a front is what a separator and its neighbours
among later ones make of a dense matrix (multifrontal method: Duff and Reid,
ACM Trans. Math. Softw. 9, 1983). Some nodes come last, all together: the
inverse of what is left there is the compliance between them. Nearly all of
the work is in LAPACK and BLAS.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse import bsr_matrix, csr_matrix

from drake_exo.soles.numerics import njit

_FEW = 48  # nodes of a leaf
_BLOCK = 512  # rows that are mirrored at a time


@dataclass(frozen=True)
class Front:
    """Nodes eliminated together and those of later fronts beside them.

    Attributes:
        own: Nodes, (k,).
        border: Nodes of later fronts that own ones or their descendants
            touch, (b,), in the order of elimination.
        children: Numbers of the fronts whose borders end here.
    """

    own: np.ndarray
    border: np.ndarray
    children: list[int]


class SparseCholesky:
    """K = L Lᵀ of a symmetric positive definite matrix.

    Args:
        K: The matrix of all dofs, blocks of three, (3n, 3n).
        fronts: What `fronts_of` makes of its pattern.

    Attributes:
        last_inverse: The block of K⁻¹ of the last nodes' dofs, (3m, 3m).

    Raises:
        LinAlgError: K is not positive definite.
    """

    def __init__(self, K: bsr_matrix, fronts: list[Front]):
        self._count = K.shape[0]
        self._parts = []  # own dofs, border's dofs, factor, rows below
        factor = self._eliminate(K, fronts)
        self._root = node_dofs(fronts[-1].own)
        inverse, _ = dpotri(factor, lower=1, overwrite_c=1)
        # Symmetric: turned so that its rows lie together in memory.
        self.last_inverse = mirrored(inverse).T

    def _eliminate(self, K: bsr_matrix, fronts: list[Front]) -> np.ndarray:
        """All fronts; the last one's lower triangle."""
        place = np.full(self._count // 3, -1)
        updates = {}
        for number, front in enumerate(fronts):
            both = np.concatenate([front.own, front.border])
            place[both] = np.arange(len(both))
            k, b = 3 * len(front.own), 3 * len(front.border)
            A = np.zeros((k + b, k), order="F")
            _collect(A, K.indptr, K.indices, K.data, front.own, place)
            # Lower triangles are enough: borders lie in order.
            update = np.zeros((b, b), order="F")
            for child in front.children:
                where = place[fronts[child].border]
                _extend(A, update, updates.pop(child), where)
            place[both] = -1
            factor, info = dpotrf(A[:k], lower=1, overwrite_a=b == 0)
            if info:
                raise np.linalg.LinAlgError("matrix is not positive definite")
            if b:
                below = dtrsm(1.0, factor, A[k:], side=1, lower=1, trans_a=1)
                updates[number] = dsyrk(
                    -1.0, below, 1.0, update, lower=1, overwrite_c=1
                )
                own, border = node_dofs(front.own), node_dofs(front.border)
                self._parts.append((own, border, factor, below))
        return factor

    def solve(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ b, (3n, c)."""
        x = np.array(b, dtype=float)
        for own, border, factor, below in self._parts:
            y = dtrsm(1.0, factor, x[own], lower=1)
            x[own] = y
            x[border] -= below @ y
        x[self._root] = self.last_inverse @ x[self._root]
        return self._substituted(x)

    def carry(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ of what is b at the last dofs, (3m, c), and zero elsewhere."""
        x = np.zeros((self._count, b.shape[1]))
        x[self._root] = self.last_inverse @ b
        return self._substituted(x)

    def _substituted(self, x: np.ndarray) -> np.ndarray:
        """Backwards from the last dofs, in place."""
        for own, border, factor, below in reversed(self._parts):
            y = x[own] - below.T @ x[border]
            x[own] = dtrsm(1.0, factor, y, lower=1, trans_a=1)
        return x


def node_dofs(nodes: np.ndarray) -> np.ndarray:
    """Dofs 3i, 3i+1, 3i+2 of nodes, (3k,)."""
    return (3 * np.asarray(nodes)[:, None] + np.arange(3)).ravel()


@njit()
def _collect(A, indptr, indices, data, own, place):
    """The matrix's columns of a front's own nodes: those rows it has."""
    for j in range(len(own)):
        for entry in range(indptr[own[j]], indptr[own[j] + 1]):
            i = place[indices[entry]]
            if i >= 0:
                for a in range(3):
                    for b in range(3):  # the matrix is symmetric
                        A[3 * i + a, 3 * j + b] = data[entry, b, a]


@njit()
def _extend(A, update, new, where):
    """Add a child's update to its place in both parts of a front."""
    k = A.shape[1]
    for j in range(new.shape[1]):
        column = 3 * where[j // 3] + j % 3
        for i in range(j, len(new)):
            row = 3 * where[i // 3] + i % 3
            if column < k:
                A[row, column] += new[i, j]
            else:
                update[row - k, column - k] += new[i, j]


def mirrored(lower: np.ndarray) -> np.ndarray:
    """A symmetric matrix from its lower triangle, in place."""
    n = len(lower)
    for i in range(0, n, _BLOCK):
        part = slice(i, min(i + _BLOCK, n))
        lower[part, part.stop :] = lower[part.stop :, part].T
        corner = np.tril(lower[part, part])
        lower[part, part] = corner + np.tril(corner, -1).T
    return lower


def fronts_of(
    graph: csr_matrix, places: np.ndarray, last: np.ndarray
) -> list[Front]:
    """Fronts in the order of elimination.

    Args:
        graph: Which nodes touch, (n, n).
        places: Of the nodes, (n, 3).
        last: Nodes that are eliminated last, together, (m,), m > 0.
    """
    others = np.setdiff1d(np.arange(len(places)), last)
    parts: list[tuple[np.ndarray, list[int]]] = []
    top = _dissect(graph, places, others, parts)
    parts.append((last, top))
    rank = np.empty(len(places), dtype=np.int64)
    order = np.concatenate([own for own, _ in parts])
    rank[order] = np.arange(len(order))
    fronts = []
    for own, children in parts:
        near = [graph[own].indices, *(fronts[c].border for c in children)]
        near = np.unique(np.concatenate(near))
        near = near[rank[near] > rank[own].max()]
        border = near[np.argsort(rank[near])]
        fronts.append(Front(own, border, children))
    return fronts


def _dissect(graph, places, nodes, parts) -> list[int]:
    """Add the parts of some nodes, separators after what they separate.

    Returns:
        Numbers of the parts whose borders may lie beyond these nodes.
    """
    if len(nodes) == 0:
        return []
    halves = None
    if len(nodes) > _FEW:
        halves = min(
            (_halves(graph, places, nodes, axis) for axis in range(3)),
            key=_cost,
        )
    if halves is None or min(len(halves[0]), len(halves[1])) == 0:
        parts.append((nodes, []))
        return [len(parts) - 1]
    low, high, separator = halves
    below = _dissect(graph, places, low, parts)
    below += _dissect(graph, places, high, parts)
    if len(separator) == 0:
        return below
    parts.append((separator, below))
    return [len(parts) - 1]


def _cost(halves) -> float:
    """Of a cut: its nodes over those of the smaller half."""
    low, high, separator = halves
    least = min(len(low), len(high))
    return len(separator) / least if least else np.inf


def _halves(graph, places, nodes, axis):
    """Low and high half along an axis, and the high nodes between them."""
    x = places[nodes, axis]
    high = x > np.median(x)
    is_low = np.zeros(len(places), dtype=np.int32)
    is_low[nodes[~high]] = 1
    touching = graph[nodes[high]] @ is_low > 0
    return nodes[~high], nodes[high][~touching], nodes[high][touching]
