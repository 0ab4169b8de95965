"""Linear elasticity of the sole and its condensation onto contact nodes.

K_ab = V [μ (g_a·g_b I + g_b g_aᵀ) + λ g_a g_bᵀ] for linear tetrahedra; the
glued nodes do not move; K_ff N = E gives the compliance C = Eᵀ N of the
nodes that may touch, in the sole frame (paper, (7)-(9)).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from drake_exo.errors import InputError
from drake_exo.soles.mesh import TetMesh

Element = Literal["linear", "nodal_pressure"]


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
                "0.49 with element nodal_pressure)"
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

    `nodal_pressure` takes the dilatation as an average around each node
    (Bonet and Burton, Commun. Numer. Meth. Engng 14, 1998), which does not
    lock for ν near 0.5 and keeps the linear tetrahedra's contact nodes.
    """
    g, V = mesh.gradients, mesh.volumes
    shear, lam = material.shear_modulus, material.lame_lambda
    if element == "nodal_pressure":
        lam = -2 / 3 * shear  # deviatoric part alone
    gg = np.einsum("eai,ebi->eab", g, g)
    outer = np.einsum("eai,ebj->eaibj", g, g)
    Ke = lam * outer + shear * outer.transpose(0, 1, 4, 3, 2)
    for i in range(3):
        Ke[:, :, i, :, i] += shear * gg
    Ke *= V[:, None, None, None, None]
    dofs = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    size = 3 * len(mesh.nodes)
    rows, cols = np.repeat(dofs, 12, axis=1), np.tile(dofs, (1, 12))
    K = csr_matrix(
        (Ke.reshape(-1), (rows.ravel(), cols.ravel())), shape=(size, size)
    )
    if element == "nodal_pressure":
        D, V_node = nodal_dilatation(mesh)
        scale = csr_matrix(
            (material.bulk_modulus * V_node, (range(len(V_node)),) * 2)
        )
        K = (K + D.T @ scale @ D).tocsr()
    return K


def nodal_dilatation(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages of div u around nodes: matrix (n, 3n), node volumes [m³]."""
    n, V = len(mesh.nodes), mesh.volumes
    quarter = np.repeat(V / 4, 4)
    V_node = np.bincount(mesh.tets.ravel(), quarter, minlength=n)
    share = csr_matrix(
        (quarter, (mesh.tets.ravel(), np.repeat(np.arange(len(V)), 4))),
        shape=(n, len(V)),
    )
    dofs = (3 * mesh.tets[:, :, None] + np.arange(3)).reshape(-1, 12)
    div = csr_matrix(
        (
            mesh.gradients.reshape(-1),
            (np.repeat(np.arange(len(V)), 12), dofs.ravel()),
        ),
        shape=(len(V), 3 * n),
    )
    inverse = csr_matrix((1 / V_node, (range(n),) * 2), shape=(n, n))
    return (inverse @ share @ div).tocsr(), V_node


@dataclass(eq=False)
class Sole:
    """A meshed sole of one material, ready for contact.

    Attributes:
        mesh: The mesh at rest.
        material: Its material.
        element: "linear" (the paper's) or "nodal_pressure" (locking-free).
    """

    mesh: TetMesh
    material: Material
    element: Element = "linear"
    _factor: object = field(default=None, init=False, repr=False)

    @cached_property
    def free(self) -> np.ndarray:
        """Nodes that are not glued."""
        return np.setdiff1d(np.arange(len(self.mesh.nodes)),
                            self.mesh.dirichlet)  # fmt: skip

    @cached_property
    def stiffness(self) -> csr_matrix:
        """Stiffness matrix of all nodes."""
        return stiffness_matrix(self.mesh, self.material, self.element)

    @property
    def positions(self) -> np.ndarray:
        """Rest positions of the contact nodes in the sole frame, (m, 3)."""
        return self.mesh.nodes[self.mesh.contact]

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements of the free dofs under forces, both (3 n_f, k)."""
        if self._factor is None:
            dofs = _dofs(self.free)
            K = self.stiffness[dofs][:, dofs]
            self._factor = _Factor(K)
        return self._factor.solve(forces)

    @cached_property
    def influence(self) -> np.ndarray:
        """N = K_ff⁻¹ E: free displacements per contact force, (3n_f, 3m)."""
        E = np.zeros((3 * len(self.free), 3 * len(self.mesh.contact)))
        E[self.contact_rows, np.arange(E.shape[1])] = 1.0
        return self.solve(E)

    @cached_property
    def contact_rows(self) -> np.ndarray:
        """Rows of the contact dofs among the free dofs, (3m,)."""
        return _dofs(np.searchsorted(self.free, self.mesh.contact))

    @cached_property
    def compliance(self) -> np.ndarray:
        """C = Eᵀ N in the sole frame [m/N], (3m, 3m), symmetric."""
        C = self.influence[self.contact_rows]
        return 0.5 * (C + C.T)

    @cached_property
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
        flat = f_L.reshape(-1, 3 * len(self.mesh.contact))
        u = np.zeros((len(flat), len(self.mesh.nodes), 3))
        u[:, self.free] = (flat @ self.influence.T).reshape(len(flat), -1, 3)
        return u.reshape(*lead, -1, 3)

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Small strain of every element, (..., e, 3, 3)."""
        H = displacement_gradient(self.mesh, u)
        return 0.5 * (H + np.swapaxes(H, -1, -2))

    def stress(self, u: np.ndarray) -> np.ndarray:
        """Cauchy stress of every element [Pa], (..., e, 3, 3).

        With `nodal_pressure` the pressure is the mean of the nodes' own.
        """
        eps = self.strain(u)
        trace = np.trace(eps, axis1=-2, axis2=-1)
        lam = self.material.lame_lambda
        if self.element == "nodal_pressure":
            D, _ = nodal_dilatation(self.mesh)
            flat = u.reshape(-1, u.shape[-2] * 3)
            node = (D @ flat.T).T.reshape(*u.shape[:-2], -1)
            mean = node[..., self.mesh.tets].mean(axis=-1)
            volumetric = self.material.bulk_modulus * mean
            volumetric = (
                volumetric - 2 / 3 * self.material.shear_modulus * trace
            )
        else:
            volumetric = lam * trace
        sigma = 2 * self.material.shear_modulus * eps
        return sigma + volumetric[..., None, None] * np.eye(3)


def displacement_gradient(mesh: TetMesh, u: np.ndarray) -> np.ndarray:
    """H_ij = ∂u_i/∂X_j in every element, (..., e, 3, 3)."""
    return np.einsum("...eai,eaj->...eij", u[..., mesh.tets, :], mesh.gradients)


def _dofs(nodes: np.ndarray) -> np.ndarray:
    return (3 * nodes[:, None] + np.arange(3)).ravel()


class _Factor:
    """Sparse Cholesky with many right-hand sides (cholespy), or splu."""

    def __init__(self, K: csr_matrix):
        self._K = K
        self._lu = None
        K = K.tocsc()
        K.sort_indices()
        try:
            from cholespy import CholeskySolverD, MatrixType
        except ImportError:
            from scipy.sparse.linalg import splu

            self._lu = splu(csc_matrix(K))
            return
        self._cholesky = CholeskySolverD(
            K.shape[0], K.indptr, K.indices, K.data, MatrixType.CSC
        )

    def solve(self, b: np.ndarray) -> np.ndarray:
        flat = np.ascontiguousarray(b.reshape(b.shape[0], -1))
        if self._lu is not None:
            return self._lu.solve(flat).reshape(b.shape)
        x = np.zeros_like(flat)
        # cholespy takes at most 128 right-hand sides at a time.
        for start in range(0, flat.shape[1], 128):
            rhs = np.ascontiguousarray(flat[:, start : start + 128])
            out = np.zeros_like(rhs)
            self._cholesky.solve(rhs, out)
            x[:, start : start + 128] = out
        return x.reshape(b.shape)
