"""Linear elasticity of the sole and its condensation onto contact nodes.

K_ab = V [μ (g_a·g_b I + g_b g_aᵀ) + λ g_a g_bᵀ] for linear tetrahedra; the
fixed nodes do not move; K_ff N = E gives the compliance C = Eᵀ N of the
nodes that may touch, in the sole frame (paper, (7)-(9)).

The locking-free element "smoothed" takes the deviatoric strain as its
average around each edge and the dilatation as its average around each node
(edge- and node-based smoothed finite elements: Nguyen-Thoi, Liu, Lam, Zhang,
Int. J. Numer. Meth. Engng 78, 2009; node averages: Bonet and Burton, Commun.
Numer. Meth. Engng 14, 1998). The unknowns stay those of linear tetrahedra,
and so do the contact nodes.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags

from drake_exo.errors import InputError
from drake_exo.soles.elasticity.cholesky import (
    Front,
    SparseCholesky,
    fronts_of,
    node_dofs,
)
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.numerics import njit

Element = Literal["linear", "smoothed"]


def edges_of(mesh: TetMesh) -> np.ndarray:
    """Numbers of the edges of every element, (e, 6)."""
    i, j = np.triu_indices(4, 1)
    pairs = np.stack([mesh.tets[:, i], mesh.tets[:, j]], axis=-1)
    pairs = np.sort(pairs, axis=-1).reshape(-1, 2)
    code = pairs[:, 0] * len(mesh.nodes) + pairs[:, 1]
    _, owner = np.unique(code, return_inverse=True)
    return owner.reshape(-1, 6)


def node_average(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages around nodes: matrix (n, e), volumes of nodes [m³], (n,).

    Each element gives an equal part of its volume to its nodes.
    """
    part = np.repeat(mesh.volumes / 4, 4)
    total = np.bincount(mesh.tets.ravel(), part)
    element = np.repeat(np.arange(len(mesh.tets)), 4)
    share = csr_matrix(
        (part, (mesh.tets.ravel(), element)), (len(total), len(mesh.tets))
    )
    return (diags(1 / total) @ share).tocsr(), total


def gradient_operators(mesh: TetMesh) -> list[csr_matrix]:
    """∂/∂x, ∂/∂y, ∂/∂z of a nodal field in every element, (e, n) each."""
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
        if not self.youngs_modulus_pa > 0:
            raise InputError(
                f"material {self.name}: youngs_modulus_pa "
                f"{self.youngs_modulus_pa} must be above 0"
            )
        if not -1.0 < self.poissons_ratio < 0.5:
            raise InputError(
                f"material {self.name}: poissons_ratio {self.poissons_ratio} "
                "must lie between -1 and 0.5 (0.5 is incompressible; use "
                "0.49 with element smoothed)"
            )
        if not self.density_kg_per_m3 > 0:
            raise InputError(
                f"material {self.name}: density_kg_per_m3 "
                f"{self.density_kg_per_m3} must be above 0"
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

    @property
    def bulk_modulus(self) -> float:
        """κ = λ + 2/3 μ [Pa]."""
        return self.lame_lambda + 2 / 3 * self.shear_modulus


# Young's moduli of the paper's Table 1; butyl's density from its v_max of
# 1098 cm³ for 1 kg.
MATERIALS = {
    "neoprene": Material("neoprene", 1.0e6, 0.3, 1230.0),
    "butyl": Material("butyl", 1.4e6, 0.3, 1.0 / 1098e-6),
}


@dataclass(frozen=True)
class Pattern:
    """Which blocks of a stiffness matrix there are, wherever the nodes are.

    Attributes:
        nodes: Rows of the matrix, (k,).
        around: Elements around every edge and around every node, pairs
            (indptr, elements); empty for linear elements.
        graph: Which of its rows touch, (k, k).
        fronts: In which its nodes are eliminated, contact nodes last.
    """

    nodes: np.ndarray
    around: tuple
    graph: csr_matrix
    fronts: list[Front]

    @classmethod
    def of(cls, mesh: TetMesh, nodes: np.ndarray, element: Element):
        """Of some nodes, the others fixed; contact nodes are among them."""
        tets, around = mesh.tets, []
        corners = _incidence(tets, len(mesh.nodes))
        graph = corners.T @ corners
        if element == "smoothed":
            for owner in (edges_of(mesh), tets):
                shares = _incidence(owner).T.tocsr()
                around.append((shares.indptr, shares.indices))
                near = shares @ corners
                graph = graph + near.T @ near
        graph = graph.tocsr()[nodes][:, nodes]
        graph.sort_indices()
        last = np.searchsorted(nodes, mesh.contact)
        fronts = fronts_of(graph, mesh.nodes[nodes], last)
        return cls(nodes, tuple(around), graph, fronts)


def _incidence(owner: np.ndarray, count: int | None = None) -> csr_matrix:
    """Elements (rows) and what they have."""
    rows = np.repeat(np.arange(len(owner)), owner.shape[1])
    ones = np.ones(owner.size, dtype=np.int32)
    count = owner.max() + 1 if count is None else count
    return csr_matrix((ones, (rows, owner.ravel())), (len(owner), count))


def assembled(mesh, material, pattern: Pattern) -> bsr_matrix:
    """The stiffness of a pattern's nodes, the others fixed [N/m]."""
    graph = pattern.graph
    data = np.zeros((graph.nnz, 3, 3))
    for groups in groups_of(mesh, material, pattern):
        _assemble(*groups, graph.indptr, graph.indices, data)
    return bsr_matrix((data, graph.indices, graph.indptr))


def groups_of(mesh: TetMesh, material: Material, pattern: Pattern):
    """Groups of elements over which strains are averaged, for compiled code.

    Returns:
        A tuple for each part of the energy: where each group begins among
        the elements that follow, (k + 1,); tets; gradients of their shape
        functions; what an element gives to each of its groups [m³], (e,);
        μ and λ [Pa]; rows of the nodes in the matrix, -1 where fixed.
    """
    shear, bulk = material.shear_modulus, material.bulk_modulus
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
    """Σ v g of a group's shape functions [m²], into G by row of nodes.

    Args:
        elements: Of the group.
        tets, g, volumes, number: See `groups_of`.
        slot: -1 everywhere; gets each node's row, to be reset by the caller.
        nodes, G: Get the nodes' numbers in the matrix, and the gradients.

    Returns:
        How many rows, the volume Σ v.
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
    """Add the groups' energies to a matrix, see `groups_of`."""
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
        """The same elements at other places; what these do not change stays."""
        out = replace(self, mesh=self.mesh.with_nodes(nodes))
        out.__dict__["pattern"] = self.pattern
        return out

    @property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed to the foot."""
        return self.pattern.nodes

    @cached_property
    def pattern(self) -> Pattern:
        """Of its stiffness matrix."""
        free = np.setdiff1d(np.arange(len(self.mesh.nodes)), self.mesh.fixed)
        return Pattern.of(self.mesh, free, self.element)

    @property
    def positions(self) -> np.ndarray:
        """Rest positions of the contact nodes in the sole frame, (m, 3)."""
        return self.mesh.nodes[self.mesh.contact]

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements of the free dofs under forces, both (3 n_f, k)."""
        return self._factor.solve(forces)

    @cached_property
    def _factor(self) -> SparseCholesky:
        K = assembled(self.mesh, self.material, self.pattern)
        return SparseCholesky(K, self.pattern.fronts)

    def carry(self, forces: np.ndarray) -> np.ndarray:
        """Free displacements under contact forces: N f = K_ff⁻¹ E f.

        Args:
            forces: At the contact dofs, sole frame [N], (3m, k).

        Returns:
            (3 n_f, k).
        """
        return self._factor.carry(forces)

    @cached_property
    def contact_rows(self) -> np.ndarray:
        """Rows of the contact dofs among the free dofs, (3m,)."""
        return node_dofs(np.searchsorted(self.free, self.mesh.contact))

    @property
    def compliance(self) -> np.ndarray:
        """C = Eᵀ N in the sole frame [m/N], (3m, 3m), symmetric."""
        return self._factor.last_inverse

    @property
    def penalty(self) -> float:
        """Scale r = 1 / median(C_nn) [N/m] of the contact law."""
        return float(1.0 / np.median(np.diag(self.compliance)[2::3]))

    def displacement(self, f_L: np.ndarray) -> np.ndarray:
        """Displacement of every node under contact forces (sole frame).

        Args:
            f_L: Forces at the contact nodes, sole frame [N], (..., m, 3).

        Returns:
            Displacements [m], sole frame, (..., n, 3).
        """
        lead = f_L.shape[:-2]
        f_L = f_L.reshape(-1, len(self.mesh.contact), 3)
        u = np.zeros((len(f_L), len(self.mesh.nodes), 3))
        moved = self.carry(f_L.reshape(len(u), -1).T)
        u[:, self.free] = moved.T.reshape(len(u), -1, 3)
        return u.reshape(*lead, -1, 3)

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Small strain of every element, (..., e, 3, 3).

        With "smoothed", around every node, (..., n, 3, 3): that of a single
        element has no energy of its own, and scatters.
        """
        H = displacement_gradient(self.mesh, u)
        eps = 0.5 * (H + np.swapaxes(H, -1, -2))
        if self.element == "linear":
            return eps
        flat = np.moveaxis(eps, -3, 0)
        mean = self.node_average @ flat.reshape(len(flat), -1)
        return np.moveaxis(mean.reshape(-1, *flat.shape[1:]), 0, -3)

    @cached_property
    def node_average(self) -> csr_matrix:
        """Averages around nodes, see `node_average`."""
        return node_average(self.mesh)[0]


def displacement_gradient(mesh: TetMesh, u: np.ndarray) -> np.ndarray:
    """H_ij = ∂u_i/∂X_j in every element, (..., e, 3, 3)."""
    return np.einsum("...eai,eaj->...eij", u[..., mesh.tets, :], mesh.gradients)
