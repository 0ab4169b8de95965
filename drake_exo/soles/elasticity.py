"""Linear elasticity of the sole: compliance of its contact nodes, derivatives.

Element stiffness K_ab = V [μ (g_a·g_b I + g_b g_aᵀ) + λ g_a g_bᵀ], condensed to
the compliance C: K_ff N = E, C = Eᵀ N (paper, (7)-(9)), in the sole frame.
"Smoothed" elements average strains around edges and nodes: Nguyen-Thoi, Liu,
Lam, Zhang, Int. J. Numer. Meth. Engng 78, 2009; Bonet and Burton, Commun.
Numer. Meth. Engng 14, 1998.

K is factorised by the multifrontal method (Duff and Reid, ACM Trans. Math.
Softw. 9, 1983): nested dissection by places (George, SIAM J. Numer. Anal. 10,
1973) halves the nodes until few are left; a front is the dense matrix of a
separator and its neighbours among later nodes. Contact nodes come last.

Derivatives by the node positions follow from dC = −Nᵀ dK N: derivatives of
Σ λ wᵀ K w for fixed nodal fields w, all from the one matrix Σ λ w wᵀ.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse import bsr_matrix, csr_matrix, diags

from drake_exo.errors import InputError
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.numerics import njit

_FEW = 48  # nodes that are halved no further
_BLOCK = 32  # rows that are mirrored at a time


@dataclass(frozen=True)
class Front:
    """Nodes eliminated together, and the later nodes coupled to them.

    Attributes:
        own: Nodes eliminated here, (k,).
        border: Later nodes coupled to them, in order of elimination, (b,).
        children: Numbers of the fronts whose updates are added here.
    """

    own: np.ndarray
    border: np.ndarray
    children: list[int]


class SparseCholesky:
    """Factorisation K = L Lᵀ of a symmetric positive definite matrix.

    Args:
        K: The matrix, in blocks of three dofs, (3n, 3n).
        fronts: Fronts of its pattern, see `fronts_of`.

    Attributes:
        last_inverse: Block of K⁻¹ of the last front's dofs, (3m, 3m).

    Raises:
        LinAlgError: K is not positive definite.
    """

    def __init__(self, K: bsr_matrix, fronts: list[Front]):
        self._count = K.shape[0]
        self._parts = []  # own dofs, border's dofs, their blocks of L
        place, updates = np.full(self._count // 3, -1), {}
        for number, front in enumerate(fronts):
            both = np.concatenate([front.own, front.border])
            place[both] = np.arange(len(both))
            k, b = 3 * len(front.own), 3 * len(front.border)
            A = np.zeros((k + b, k), order="F")
            _collect(A, K.indptr, K.indices, K.data, front.own, place)
            # Lower triangles are enough: borders are in elimination order.
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
        self._root = node_dofs(fronts[-1].own)
        inverse, _ = dpotri(factor, lower=1, overwrite_c=1)
        # Symmetric: transposed for rows that are contiguous in memory.
        self.last_inverse = mirrored(inverse).T

    def solve(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ b of right-hand sides b, (3n, c)."""
        x = np.array(b, dtype=float)
        for own, border, factor, below in self._parts:
            y = dtrsm(1.0, factor, x[own], lower=1)
            x[own] = y
            x[border] -= below @ y
        x[self._root] = self.last_inverse @ x[self._root]
        return self._substituted(x)

    def carry(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ x, (3n, c), for x that is b (3m, c) at the last dofs, else 0."""
        x = np.zeros((self._count, b.shape[1]))
        x[self._root] = self.last_inverse @ b
        return self._substituted(x)

    def _substituted(self, x: np.ndarray) -> np.ndarray:
        """Back substitution from the last dofs, in place."""
        for own, border, factor, below in reversed(self._parts):
            y = x[own] - below.T @ x[border]
            x[own] = dtrsm(1.0, factor, y, lower=1, trans_a=1)
        return x


def node_dofs(nodes: np.ndarray) -> np.ndarray:
    """Dofs 3i, 3i+1, 3i+2 of nodes i (k,), (3k,)."""
    return (3 * np.asarray(nodes)[:, None] + np.arange(3)).ravel()


@njit()
def _collect(A, indptr, indices, data, own, place):
    """Copy the columns of a front's own nodes into A, at its rows."""
    for j in range(len(own)):
        for entry in range(indptr[own[j]], indptr[own[j] + 1]):
            i = place[indices[entry]]
            if i >= 0:
                for a in range(3):
                    for b in range(3):  # the matrix is symmetric
                        A[3 * i + a, 3 * j + b] = data[entry, b, a]


@njit()
def _extend(A, update, new, where):
    """Add a child's update to a front's own columns A and its update."""
    k, b = A.shape[1], len(where)
    for j in range(3 * b):
        column = 3 * where[j // 3] + j % 3
        # A node's diagonal block is added whole: its upper part is not used.
        for node in range(j // 3, b):
            row = 3 * where[node]
            for i in range(3):
                if column < k:
                    A[row + i, column] += new[3 * node + i, j]
                else:
                    update[row - k + i, column - k] += new[3 * node + i, j]


@njit()
def mirrored(lower):
    """Fill a symmetric matrix's upper triangle from its lower one, in place."""
    n = len(lower)
    for first in range(0, n, _BLOCK):
        last = min(first + _BLOCK, n)
        for j in range(last):
            for i in range(max(first, j + 1), last):
                lower[j, i] = lower[i, j]
    return lower


def fronts_of(
    graph: csr_matrix, places: np.ndarray, last: np.ndarray
) -> list[Front]:
    """Fronts in the order of elimination, the nodes `last` in the last one.

    From the graph of coupled nodes (n, n), their places (n, 3), last (m,).
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
    """Append parts (own nodes, children), separators after what they separate.

    Numbers of the parts that are children of whatever separator comes next.
    """
    if len(nodes) == 0:
        return []
    below, own = [], nodes
    if len(nodes) > _FEW:
        cuts = [_halves(graph, places, nodes, axis) for axis in range(3)]
        low, high, separator = min(cuts, key=_cost)
        if min(len(low), len(high)) > 0:
            below = _dissect(graph, places, low, parts)
            below += _dissect(graph, places, high, parts)
            own = separator
            if len(own) == 0:
                return below
    parts.append((own, below))
    return [len(parts) - 1]


def _cost(halves) -> float:
    """Cost of a cut: separator nodes over those of the smaller half."""
    low, high, separator = halves
    least = min(len(low), len(high))
    return len(separator) / least if least else np.inf


def _halves(graph, places, nodes, axis):
    """Nodes split along an axis: low, high, and the separator (of the high)."""
    x = places[nodes, axis]
    high = x > np.median(x)
    is_low = np.zeros(len(places), dtype=np.int32)
    is_low[nodes[~high]] = 1
    touching = graph[nodes[high]] @ is_low > 0
    return nodes[~high], nodes[high][~touching], nodes[high][touching]


Element = Literal["linear", "smoothed"]


def gradient_operators(mesh: TetMesh) -> list[csr_matrix]:
    """Matrices of ∂/∂x, ∂/∂y, ∂/∂z of a nodal field in elements, (e, n)."""
    e, n = len(mesh.tets), len(mesh.nodes)
    rows, cols = np.repeat(np.arange(e), 4), mesh.tets.ravel()
    return [
        csr_matrix((mesh.gradients[:, :, k].ravel(), (rows, cols)), (e, n))
        for k in range(3)
    ]


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material."""

    name: str
    youngs_modulus_pa: float
    poissons_ratio: float
    density_kg_per_m3: float

    def __post_init__(self):
        if not -1.0 < self.poissons_ratio < 0.5:
            raise InputError(
                f"material {self.name}: poissons_ratio {self.poissons_ratio} "
                "must lie between -1 and 0.5 (0.5 is incompressible; use "
                "0.49 with element smoothed)"
            )

    @property
    def shear_modulus(self) -> float:
        """μ [Pa]."""
        return self.youngs_modulus_pa / (2 * (1 + self.poissons_ratio))

    @property
    def lame_lambda(self) -> float:
        """λ [Pa]."""
        nu = self.poissons_ratio
        return self.youngs_modulus_pa * nu / ((1 + nu) * (1 - 2 * nu))


# Young's moduli of the paper's Table 1; butyl's density from its v_max of
# 1098 cm³ for 1 kg.
MATERIALS = {
    "neoprene": Material("neoprene", 1.0e6, 0.3, 1230.0),
    "butyl": Material("butyl", 1.4e6, 0.3, 1.0 / 1098e-6),
}


@dataclass(frozen=True)
class Pattern:
    """Sparsity of a stiffness matrix, whatever the nodes' positions.

    Attributes:
        nodes: Mesh nodes that are the matrix's rows, (k,).
        around: Elements around every edge and around every node, pairs
            (indptr, elements); empty for linear elements.
        graph: Which of its rows are coupled, (k, k).
        fronts: Fronts in which they are eliminated, contact nodes last.
    """

    nodes: np.ndarray
    around: tuple
    graph: csr_matrix
    fronts: list[Front]

    @classmethod
    def of(cls, mesh: TetMesh, nodes: np.ndarray, element: Element):
        """Pattern of free nodes, contact nodes among them; others are fixed."""
        tets, around = mesh.tets, []
        corners = _incidence(tets)
        graph = corners.T @ corners
        if element == "smoothed":
            for owner in (mesh.edges()[1], tets):
                shares = _incidence(owner).T.tocsr()
                around.append((shares.indptr, shares.indices))
                near = shares @ corners
                graph = graph + near.T @ near
        graph = graph.tocsr()[nodes][:, nodes]
        graph.sort_indices()
        last = np.searchsorted(nodes, mesh.contact)
        fronts = fronts_of(graph, mesh.nodes[nodes], last)
        return cls(nodes, tuple(around), graph, fronts)


def _incidence(owner: np.ndarray) -> csr_matrix:
    """Incidence of elements (rows) with their nodes or edges `owner`."""
    rows = np.repeat(np.arange(len(owner)), owner.shape[1])
    ones = np.ones(owner.size, dtype=np.int32)
    return csr_matrix((ones, (rows, owner.ravel())))


def assembled(mesh, material, pattern: Pattern) -> bsr_matrix:
    """Stiffness matrix of a pattern's nodes, the others fixed [N/m]."""
    graph = pattern.graph
    data = np.zeros((graph.nnz, 3, 3))
    for groups in groups_of(mesh, material, pattern):
        _assemble(*groups, graph.indptr, graph.indices, data)
    return bsr_matrix((data, graph.indices, graph.indptr))


def groups_of(mesh: TetMesh, material: Material, pattern: Pattern):
    """Groups of elements over which strains are averaged, for compiled code.

    One tuple for each part of the energy: where each group begins (k + 1,) in
    an array of elements; that array; tets; gradients of their shape functions;
    volume that an element gives to each of its groups [m³], (e,); μ and λ
    [Pa]; matrix row of every node, -1 if fixed.
    """
    shear = material.shear_modulus
    bulk = material.lame_lambda + 2 / 3 * shear
    elements = np.arange(len(mesh.tets) + 1, dtype=np.int32)
    parts = [((elements, elements[:-1]), shear, bulk, 1)]
    if pattern.around:
        of_edges, of_nodes = pattern.around
        parts = [(of_edges, shear, 0.0, 6), (of_nodes, 0.0, bulk, 4)]
    number = np.full(len(mesh.nodes), -1)
    number[pattern.nodes] = np.arange(len(pattern.nodes))
    return [
        (*around, mesh.tets, mesh.gradients, mesh.volumes / shares,
         mu, kappa - 2 / 3 * mu, number)
        for around, mu, kappa, shares in parts
    ]  # fmt: skip


@njit()
def average_gradients(elements, tets, g, volumes, number, slot, nodes, G):
    """Write Σ v g [m²] of a group's shape functions into G, a row per node.

    `nodes` gets the rows' nodes; `slot`, -1 everywhere, gets each node's row
    and is reset by the caller. Returns the number of rows and Σ v [m³].
    """
    count, V = 0, 0.0
    for e in elements:
        V += volumes[e]
        for a in range(4):
            node = number[tets[e, a]]
            if node < 0:
                continue
            if slot[node] < 0:
                slot[node] = count
                nodes[count] = node
                G[count] = 0.0
                count += 1
            for i in range(3):
                G[slot[node], i] += volumes[e] * g[e, a, i]
    return count, V


@njit()
def _assemble(
    start, around, tets, g, volumes, shear, lam, number, indptr, indices, data
):
    """Add the groups' stiffness to a matrix's data, see `groups_of`."""
    slot = np.full(len(number), -1)
    nodes, G = np.empty(len(number), np.int64), np.empty((len(number), 3))
    for group in range(len(start) - 1):
        elements = around[start[group] : start[group + 1]]
        count, V = average_gradients(
            elements, tets, g, volumes, number, slot, nodes, G
        )
        for a in range(count):
            slot[nodes[a]] = -1
            low, high = indptr[nodes[a]], indptr[nodes[a] + 1]
            row = indices[low:high]
            for b in range(count):
                entry = low + np.searchsorted(row, nodes[b])
                dot = 0.0
                for i in range(3):
                    dot += G[a, i] * G[b, i]
                for i in range(3):
                    data[entry, i, i] += shear * dot / V
                    for j in range(3):
                        data[entry, i, j] += (
                            shear * G[b, i] * G[a, j] + lam * G[a, i] * G[b, j]
                        ) / V


@dataclass(eq=False)
class Sole:
    """A meshed sole of one material, ready for contact.

    Attributes:
        mesh: The mesh at rest.
        material: Its material.
        element: "linear" (the paper's) or "smoothed" (locking-free).
    """

    mesh: TetMesh
    material: Material
    element: Element = "linear"

    def with_nodes(self, nodes: np.ndarray) -> "Sole":
        """The same sole with nodes at other positions (n, 3); pattern kept."""
        out = replace(self, mesh=self.mesh.with_nodes(nodes))
        out.__dict__["pattern"] = self.pattern
        return out

    @property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed to the foot."""
        return self.pattern.nodes

    @cached_property
    def pattern(self) -> Pattern:
        """Sparsity pattern of its stiffness matrix."""
        free = np.setdiff1d(np.arange(len(self.mesh.nodes)), self.mesh.fixed)
        return Pattern.of(self.mesh, free, self.element)

    @property
    def positions(self) -> np.ndarray:
        """Rest positions of the contact nodes in the sole frame, (m, 3)."""
        return self.mesh.nodes[self.mesh.contact]

    @cached_property
    def factor(self) -> SparseCholesky:
        """Cholesky factor of the free nodes' stiffness, sole frame [N/m]."""
        K = assembled(self.mesh, self.material, self.pattern)
        return SparseCholesky(K, self.pattern.fronts)

    @cached_property
    def contact_rows(self) -> np.ndarray:
        """Rows of the contact dofs among the free dofs, (3m,)."""
        return node_dofs(np.searchsorted(self.free, self.mesh.contact))

    @property
    def compliance(self) -> np.ndarray:
        """C = Eᵀ N in the sole frame [m/N], (3m, 3m), symmetric."""
        return self.factor.last_inverse

    @property
    def penalty(self) -> float:
        """Scale r = 1 / median(C_nn) [N/m] of the contact law."""
        return float(1.0 / np.median(np.diag(self.compliance)[2::3]))

    def displacement(self, f_L: np.ndarray) -> np.ndarray:
        """Displacement of every node [m], (..., n, 3), under contact forces.

        Forces f_L [N] (..., m, 3) and displacements are in the sole frame.
        """
        lead = f_L.shape[:-2]
        f_L = f_L.reshape(-1, 3 * len(self.mesh.contact))
        u = np.zeros((len(f_L), *self.mesh.nodes.shape))
        u[:, self.free] = self.factor.carry(f_L.T).T.reshape(
            -1, len(self.free), 3
        )
        return u.reshape(*lead, *u.shape[1:])

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Small strain of every element, (e, 3, 3), in displacements u (n, 3).

        With "smoothed", averaged around every node, (n, 3, 3): a single
        element's strain has no energy of its own, and scatters.
        """
        H = np.einsum("eai,eaj->eij", u[self.mesh.tets], self.mesh.gradients)
        eps = 0.5 * (H + np.swapaxes(H, 1, 2))
        if self.element == "linear":
            return eps
        return (self.node_average @ eps.reshape(-1, 9)).reshape(-1, 3, 3)

    @cached_property
    def node_average(self) -> csr_matrix:
        """Matrix (n, e) that averages elements' values around every node.

        An element's weight is a quarter of its volume at each of its nodes.
        """
        tets, part = self.mesh.tets, self.mesh.volumes / 4
        total = np.bincount(tets.ravel(), np.repeat(part, 4))
        share = _incidence(tets).T @ diags(part)
        return (diags(1 / total) @ share).tocsr()


# Part of the largest eigenvalue below which fields are left out: half of them,
# which changes a gradient by some 1e-7 of its largest entry.
_NEGLIGIBLE = 1e-7


def compliance_gradients(sole: Sole, terms: list, held: list) -> np.ndarray:
    """Derivatives of tr(C̄ᵀ C), C̄ = left rightᵀ, by node positions, (f, n, 3).

    `terms` has left and right, (3m, c) each, of every C̄; `held` further fields
    and factors of `energy_gradients`, or None. As C is symmetric, the fields
    needed are those of the eigenvectors of C̄'s symmetric part.
    """
    forces, factors = zip(
        *(_forces(sole, *term) for term in terms), strict=True
    )
    ends = np.cumsum([f.shape[1] for f in forces])
    fields = np.split(sole.factor.carry(np.hstack(forces)), ends[:-1], axis=1)
    both = list(zip(fields, factors, strict=True))
    for k, more in enumerate(held):
        if more is not None:
            both[k] = tuple(
                np.concatenate(x, axis=-1)
                for x in zip(both[k], more, strict=True)
            )
    return energy_gradients(sole, both)


def _forces(sole: Sole, left: np.ndarray, right: np.ndarray):
    """Forces (3m, k), factors (k,): eigenpairs of left rightᵀ, symmetrised."""
    dofs = np.flatnonzero(left.any(axis=1) | right.any(axis=1))
    left, right = left[dofs], right[dofs]
    if 2 * left.shape[1] < len(dofs):
        basis, _ = np.linalg.qr(np.hstack([left, right]))
        left, right = basis.T @ left, basis.T @ right
    else:
        basis = None
    half = 0.5 * left @ right.T
    values, vectors = np.linalg.eigh(half + half.T)
    kept = np.abs(values) > _NEGLIGIBLE * np.abs(values).max(initial=0.0)
    vectors = vectors[:, kept] if basis is None else basis @ vectors[:, kept]
    forces = np.zeros((3 * len(sole.mesh.contact), kept.sum()))
    forces[dofs] = vectors
    return forces, values[kept]


def pairs(v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fields w (d, 2k) and factors λ (2k,) with Σ λ wᵀ K w = Σ vᵀ K u.

    K is any symmetric matrix; the columns of v and u, (d, k), are fields.
    """
    sizes = [np.linalg.norm(x, axis=0) for x in (u, v)]
    there = (sizes[0] > 0) & (sizes[1] > 0)
    size = sizes[0][there] / sizes[1][there]
    v, u = size * v[:, there], u[:, there]
    return np.hstack([u + v, u - v]), np.concatenate([1 / size, -1 / size]) / 4


def energy_gradients(sole: Sole, fields: list) -> np.ndarray:
    """Derivatives of −Σ λ wᵀ K w by the node positions, w fixed, (f, n, 3).

    `fields` are pairs of free displacements w (3 n_f, k), factors λ (k,).
    """
    pattern = sole.pattern
    indptr, indices = pattern.graph.indptr, pattern.graph.indices
    W = np.empty((len(indices), len(fields), 3, 3))
    for which, (w, factors) in enumerate(fields):
        w = np.ascontiguousarray(w).reshape(len(sole.free), 3, -1)
        _products(indptr, indices, w, factors, W[:, which])
    out = np.zeros((len(fields), *sole.mesh.nodes.shape))
    for groups in groups_of(sole.mesh, sole.material, pattern):
        _add_gradients(*groups, indptr, indices, W, out)
    return out


@njit(fastmath=True)
def _products(indptr, indices, w, factors, out):
    """Write Σ λ w_a w_bᵀ of the matrix's blocks, a <= b, into (nnz, 3, 3)."""
    for a in range(len(indptr) - 1):
        x, y, z = factors * w[a, 0], factors * w[a, 1], factors * w[a, 2]
        for entry in range(indptr[a], indptr[a + 1]):
            if indices[entry] < a:
                continue
            for j in range(3):
                v = w[indices[entry], j]
                p = q = r = 0.0
                for k in range(len(v)):
                    p += x[k] * v[k]
                    q += y[k] * v[k]
                    r += z[k] * v[k]
                out[entry, 0, j], out[entry, 1, j], out[entry, 2, j] = p, q, r


@njit()
def _add_gradients(
    start, around, tets, g, volumes, shear, lam, number, indptr, indices, W, out
):
    """Add −∂(W : K)/∂X of the groups' energies, see `groups_of`.

    W : K of a group is Σ G_aᵀ M_ab G_b / V with G = Σ v g, V = Σ v and
    M = μ (tr W I + Wᵀ) + λ W. W has the blocks with a <= b, (nnz, f, 3, 3);
    out is (f, n, 3).
    """
    slot = np.full(len(number), -1)
    nodes, G = np.empty(len(number), np.int64), np.empty((len(number), 3))
    by_G = np.empty((len(number), len(out), 3))
    for group in range(len(start) - 1):
        elements = around[start[group] : start[group + 1]]
        count, V = average_gradients(
            elements, tets, g, volumes, number, slot, nodes, G
        )
        by_G[:count] = 0.0
        for a in range(count):
            low, high = indptr[nodes[a]], indptr[nodes[a] + 1]
            row = indices[low:high]
            for b in range(count):
                if nodes[b] < nodes[a]:
                    continue
                entry = low + np.searchsorted(row, nodes[b])
                for f in range(len(out)):
                    w = W[entry, f]
                    trace = w[0, 0] + w[1, 1] + w[2, 2]
                    for i in range(3):
                        for j in range(3):
                            M = shear * w[j, i] + lam * w[i, j]
                            if i == j:
                                M += shear * trace
                            by_G[a, f, i] += M * G[b, j]
                            if a != b:
                                by_G[b, f, j] += M * G[a, i]
        for f in range(len(out)):
            energy = 0.0
            for a in range(count):
                for i in range(3):
                    energy += by_G[a, f, i] * G[a, i]
                    by_G[a, f, i] *= 2 / V
            _by_places(
                elements, tets, g, volumes, number, slot,
                by_G, f, -energy / V**2, out,
            )  # fmt: skip
        for a in range(count):
            slot[nodes[a]] = -1


@njit()
def _by_places(
    elements, tets, g, volumes, number, slot, by_G, f, by_volume, out
):
    """Subtract a group's derivative number f by the nodes from out (f, n, 3).

    Chain rule through G and V: dv = v g_c·dX_c, dg_a = −g_c (g_a·dX_c).
    """
    rows = np.empty(4, np.int64)
    for e in elements:
        size, v = by_volume, volumes[e]
        for a in range(4):
            node = number[tets[e, a]]
            rows[a] = slot[node] if node >= 0 else -1
            if node >= 0:
                for i in range(3):
                    size += by_G[rows[a], f, i] * g[e, a, i]
        for c in range(4):
            to = tets[e, c]
            x = out[f, to, 0] - v * size * g[e, c, 0]
            y = out[f, to, 1] - v * size * g[e, c, 1]
            z = out[f, to, 2] - v * size * g[e, c, 2]
            for a in range(4):
                if rows[a] < 0:
                    continue
                along = 0.0
                for i in range(3):
                    along += by_G[rows[a], f, i] * g[e, c, i]
                x += v * along * g[e, a, 0]
                y += v * along * g[e, a, 1]
                z += v * along * g[e, a, 2]
            out[f, to, 0], out[f, to, 1], out[f, to, 2] = x, y, z
