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

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags

from drake_exo.errors import InputError
from drake_exo.soles.elasticity.cholesky import SparseCholesky
from drake_exo.soles.mesh import TetMesh

Element = Literal["linear", "smoothed"]


def node_dofs(nodes: np.ndarray) -> np.ndarray:
    """Dofs 3i, 3i+1, 3i+2 of nodes, (3k,)."""
    return (3 * np.asarray(nodes)[:, None] + np.arange(3)).ravel()


def edges_of(mesh: TetMesh) -> np.ndarray:
    """Numbers of the edges of every element, (e, 6)."""
    i, j = np.triu_indices(4, 1)
    pairs = np.stack([mesh.tets[:, i], mesh.tets[:, j]], axis=-1)
    pairs = np.sort(pairs, axis=-1).reshape(-1, 2)
    code = pairs[:, 0] * len(mesh.nodes) + pairs[:, 1]
    _, owner = np.unique(code, return_inverse=True)
    return owner.reshape(-1, 6)


def edge_average(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages around edges: matrix (k, e), volumes of edges [m³], (k,)."""
    return _average(edges_of(mesh).ravel(), mesh.volumes, 6)


def node_average(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages around nodes: matrix (n, e), volumes of nodes [m³], (n,)."""
    return _average(mesh.tets.ravel(), mesh.volumes, 4)


def _average(owner, volumes, shares: int):
    """Each element gives an equal part of its volume to its owners."""
    part = np.repeat(volumes / shares, shares)
    total = np.bincount(owner, part)
    element = np.repeat(np.arange(len(volumes)), shares)
    share = csr_matrix(
        (part, (owner, element)), shape=(len(total), len(volumes))
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


def stiffness_matrix(
    mesh: TetMesh, material: Material, element: Element = "linear"
) -> csr_matrix:
    """Assembled stiffness of all nodes [N/m], (3n, 3n).

    K_ab = V [μ (g_a·g_b I + g_b g_aᵀ) + λ g_a g_bᵀ] for "linear"; for
    "smoothed" see the top of this file.
    """
    if element == "smoothed":
        return _smoothed_stiffness(mesh, material)
    g, V = mesh.gradients, mesh.volumes
    shear, lam = material.shear_modulus, material.lame_lambda
    gg = np.einsum("eai,ebi->eab", g, g)
    outer = np.einsum("eai,ebj->eaibj", g, g)
    Ke = lam * outer + shear * outer.transpose(0, 1, 4, 3, 2)
    for i in range(3):
        Ke[:, :, i, :, i] += shear * gg
    Ke *= V[:, None, None, None, None]
    dofs = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    size = 3 * len(mesh.nodes)
    rows, cols = np.repeat(dofs, 12, axis=1), np.tile(dofs, (1, 12))
    return csr_matrix(
        (Ke.reshape(-1), (rows.ravel(), cols.ravel())), shape=(size, size)
    )


def _smoothed_stiffness(mesh: TetMesh, material: Material) -> csr_matrix:
    """Deviator averaged around edges, dilatation around nodes."""
    gradient = gradient_operators(mesh)
    edge, V_edge = edge_average(mesh)
    node, V_node = node_average(mesh)
    G = [edge @ g for g in gradient]
    D = [node @ g for g in gradient]
    shear = material.shear_modulus
    W, bulk = diags(shear * V_edge), diags(material.bulk_modulus * V_node)
    laplacian = sum(g.T @ W @ g for g in G)
    blocks = [[None] * 3 for _ in range(3)]
    for i in range(3):
        for j in range(3):
            K = G[j].T @ W @ G[i] - 2 / 3 * (G[i].T @ W @ G[j])
            K = K + D[i].T @ bulk @ D[j]
            blocks[i][j] = K + laplacian if i == j else K
    n = len(mesh.nodes)
    order = (np.arange(3) * n + np.arange(n)[:, None]).ravel()
    return bmat(blocks, format="csr")[order][:, order]


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

    @cached_property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed to the foot."""
        return np.setdiff1d(np.arange(len(self.mesh.nodes)),
                            self.mesh.fixed)  # fmt: skip

    @property
    def positions(self) -> np.ndarray:
        """Rest positions of the contact nodes in the sole frame, (m, 3)."""
        return self.mesh.nodes[self.mesh.contact]

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements of the free dofs under forces, both (3 n_f, k)."""
        return self._factor.solve(forces)

    @cached_property
    def _factor(self) -> SparseCholesky:
        dofs = node_dofs(self.free)
        return SparseCholesky(
            stiffness_matrix(self.mesh, self.material, self.element)[dofs][
                :, dofs
            ],
            self.mesh.nodes[self.free],
            np.searchsorted(self.free, self.mesh.contact),
        )

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
