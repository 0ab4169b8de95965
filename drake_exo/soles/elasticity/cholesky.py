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
from scipy.sparse import csc_matrix, csr_matrix

from drake_exo.soles.compiled import njit

_FEW = 48  # nodes of a leaf
_BLOCK = 512  # rows that are mirrored at a time


@dataclass
class _Front:
    """Nodes eliminated together and those of later fronts beside them.

    Attributes:
        own: Dofs as in the matrix, (k,).
        border: Dofs of later fronts that own ones or their descendants'
            touch, (b,), in the order of elimination.
        children: Numbers of the fronts whose borders end here.
        factor: Lower triangle L with L Lᵀ the front's own part, (k, k).
        below: Rows of the border, (b, k).
    """

    own: np.ndarray
    border: np.ndarray
    children: list[int]
    factor: np.ndarray | None = None
    below: np.ndarray | None = None


class SparseCholesky:
    """K = L Lᵀ of a symmetric positive definite matrix.

    Args:
        K: The matrix of all dofs, three a node, (3n, 3n).
        places: Of the nodes, (n, 3).
        last: Nodes that are eliminated last, together, (m,), m > 0.

    Attributes:
        last_inverse: The block of K⁻¹ of the last nodes' dofs, (3m, 3m).

    Raises:
        LinAlgError: K is not positive definite.
    """

    def __init__(self, K: csr_matrix, places: np.ndarray, last: np.ndarray):
        self._count = K.shape[0]
        self._fronts = _fronts(K, places, np.asarray(last))
        self._eliminate(K.T)  # columns that lie together; K is symmetric
        *self._fronts, self._root = self._fronts
        inverse, _ = dpotri(self._root.factor, lower=1, overwrite_c=1)
        # Symmetric: turned so that its rows lie together in memory.
        self.last_inverse = mirrored(inverse).T

    def _eliminate(self, K: csc_matrix) -> None:
        place = np.zeros(K.shape[0], dtype=np.int64)
        rank = np.empty_like(place)
        order = np.concatenate([front.own for front in self._fronts])
        rank[order] = np.arange(len(order))
        updates = {}
        for number, front in enumerate(self._fronts):
            k, b = len(front.own), len(front.border)
            place[front.own] = np.arange(k)
            place[front.border] = np.arange(k, k + b)
            A = np.zeros((k + b, k), order="F")
            columns = K[:, front.own].tocoo()
            later = rank[columns.row] >= rank[front.own[0]]
            A[place[columns.row[later]], columns.col[later]] = columns.data[
                later
            ]
            # Lower triangles are enough: borders lie in order.
            update = np.zeros((b, b), order="F")
            for child in front.children:
                where = place[self._fronts[child].border]
                _extend(A, update, updates.pop(child), where)
            front.factor, info = dpotrf(A[:k], lower=1, overwrite_a=b == 0)
            if info:
                raise np.linalg.LinAlgError("matrix is not positive definite")
            if b:
                front.below = dtrsm(
                    1.0, front.factor, A[k:], side=1, lower=1, trans_a=1
                )
                updates[number] = dsyrk(
                    -1.0, front.below, 1.0, update, lower=1, overwrite_c=1
                )

    def solve(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ b, (3n, c)."""
        x = np.array(b, dtype=float)
        for front in self._fronts:
            y = dtrsm(1.0, front.factor, x[front.own], lower=1)
            x[front.own] = y
            x[front.border] -= front.below @ y
        x[self._root.own] = self.last_inverse @ x[self._root.own]
        return self._substituted(x)

    def carry(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ of what is b at the last dofs, (3m, c), and zero elsewhere."""
        x = np.zeros((self._count, b.shape[1]))
        x[self._root.own] = self.last_inverse @ b
        return self._substituted(x)

    def _substituted(self, x: np.ndarray) -> np.ndarray:
        """Backwards from the last dofs, in place."""
        for front in reversed(self._fronts):
            y = x[front.own] - front.below.T @ x[front.border]
            x[front.own] = dtrsm(1.0, front.factor, y, lower=1, trans_a=1)
        return x


@njit()
def _extend(A, update, new, where):
    """Add a child's update to its place in both parts of a front."""
    k = A.shape[1]
    for j in range(len(where)):
        for i in range(j, len(where)):
            if where[j] < k:
                A[where[i], where[j]] += new[i, j]
            else:
                update[where[i] - k, where[j] - k] += new[i, j]


def mirrored(lower: np.ndarray) -> np.ndarray:
    """A symmetric matrix from its lower triangle, in place."""
    n = len(lower)
    for i in range(0, n, _BLOCK):
        part = slice(i, min(i + _BLOCK, n))
        lower[part, part.stop :] = lower[part.stop :, part].T
        corner = np.tril(lower[part, part])
        lower[part, part] = corner + np.tril(corner, -1).T
    return lower


def _fronts(K: csr_matrix, places: np.ndarray, last: np.ndarray):
    """Fronts in the order of elimination, without numbers yet."""
    graph = _graph(K)
    others = np.setdiff1d(np.arange(len(places)), last)
    parts: list[tuple[np.ndarray, list[int]]] = []
    top = _dissect(graph, places, others, parts)
    parts.append((last, top))
    rank = np.empty(len(places), dtype=np.int64)
    order = np.concatenate([own for own, _ in parts])
    rank[order] = np.arange(len(order))
    fronts, borders = [], []
    for own, children in parts:
        near = [graph[own].indices, *(borders[c] for c in children)]
        near = np.unique(np.concatenate(near))
        near = near[rank[near] > rank[own].max()]
        borders.append(near[np.argsort(rank[near])])
        fronts.append(_Front(_dofs(own), _dofs(borders[-1]), children))
    return fronts


def _dofs(nodes: np.ndarray) -> np.ndarray:
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def _graph(K: csr_matrix) -> csr_matrix:
    """Which nodes touch."""
    K = K.tocoo()
    n = K.shape[0] // 3
    ones = np.ones(len(K.row), dtype=np.int32)
    return csr_matrix((ones, (K.row // 3, K.col // 3)), shape=(n, n))


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
            key=lambda h: len(h[2]) / max(1, min(len(h[0]), len(h[1]))),
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


def _halves(graph, places, nodes, axis):
    """Low and high half along an axis, and the high nodes between them."""
    x = places[nodes, axis]
    high = x > np.median(x)
    is_low = np.zeros(len(places), dtype=np.int32)
    is_low[nodes[~high]] = 1
    touching = graph[nodes[high]] @ is_low > 0
    return nodes[~high], nodes[high][~touching], nodes[high][touching]
