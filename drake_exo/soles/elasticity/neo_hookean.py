"""Compressible neo-Hookean solid on linear tetrahedra, total Lagrangian.

Energy per rest volume, I1 = tr FᵀF (Bonet and Wood, Nonlinear Continuum
Mechanics for Finite Element Analysis, 2nd ed., chapter 6):

    W = μ/2 (I1 − 3 − 2 ln J) + λ/2 (ln J)²

with Lamé's constants λ and μ of small strain, which it tends to. With
F = I + Σ u_a g_aᵀ and the pushed-forward gradients ĝ = F⁻ᵀ g:

    P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ
    K_ab = V [μ g_a·g_b I + (μ − λ ln J) ĝ_b ĝ_aᵀ + λ ĝ_a ĝ_bᵀ]
"""

from functools import cached_property

import numpy as np
from scipy.sparse import csc_matrix

from drake_exo.soles.elasticity.linear import Material
from drake_exo.soles.mesh import TetMesh


def energy(F: np.ndarray, material: Material) -> np.ndarray:
    """W [J/m³] of deformation gradients (..., 3, 3); J must be positive."""
    log_J = np.log(np.linalg.det(F))
    I1 = (F * F).sum(axis=(-2, -1))
    shear, lam = material.shear_modulus, material.lame_lambda
    return 0.5 * shear * (I1 - 3 - 2 * log_J) + 0.5 * lam * log_J**2


def first_stress(F: np.ndarray, material: Material) -> np.ndarray:
    """First Piola–Kirchhoff stress P = ∂W/∂F [Pa], (..., 3, 3)."""
    inverse = np.swapaxes(np.linalg.inv(F), -1, -2)
    log_J = np.log(np.linalg.det(F))[..., None, None]
    shear, lam = material.shear_modulus, material.lame_lambda
    return shear * (F - inverse) + lam * log_J * inverse


class NeoHookeanBody:
    """Internal forces and tangent of a meshed sole fixed at its top.

    Args:
        mesh: The mesh at rest.
        material: Its Lamé constants.
    """

    def __init__(self, mesh: TetMesh, material: Material):
        self.mesh, self.material = mesh, material

    @cached_property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed."""
        every = np.arange(len(self.mesh.nodes))
        return np.setdiff1d(every, self.mesh.fixed)

    def deformation_gradient(self, u: np.ndarray) -> np.ndarray:
        """F of every element under displacements u (n, 3), (e, 3, 3)."""
        mesh = self.mesh
        H = np.swapaxes(u[mesh.tets], 1, 2) @ mesh.gradients
        return np.eye(3) + H

    def stretches(self, u: np.ndarray) -> tuple[float, float]:
        """Largest and least principal stretch over the elements."""
        F = self.deformation_gradient(u)
        values = np.linalg.svd(F, compute_uv=False)
        return float(values.max()), float(values.min())

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        """Σ_e V P g_a at every node [N], (n, 3).

        Entries are NaN where an element is inverted.
        """
        F = self.deformation_gradient(u)
        mesh = self.mesh
        if (np.real(np.linalg.det(F)) <= 0).any():
            return np.full((len(mesh.nodes), 3), np.nan)
        P = first_stress(F, self.material)
        local = mesh.volumes[:, None, None] * (
            mesh.gradients @ np.swapaxes(P, 1, 2)
        )
        out = np.zeros((len(mesh.nodes), 3), dtype=local.dtype)
        np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
        return out

    def element_tangents(self, u: np.ndarray) -> np.ndarray:
        """∂(element forces)/∂(element displacements), (e, 4, 3, 4, 3)."""
        F = self.deformation_gradient(u)
        g, V = self.mesh.gradients, self.mesh.volumes
        pushed = g @ np.linalg.inv(F)
        log_J = np.log(np.linalg.det(F))
        shear, lam = self.material.shear_modulus, self.material.lame_lambda
        outer = np.einsum("eai,ebj->eaibj", pushed, pushed)
        K = lam * outer
        second = (shear - lam * log_J)[:, None, None, None, None]
        K += second * outer.transpose(0, 1, 4, 3, 2)
        gg = shear * np.einsum("eai,ebi->eab", g, g)
        for i in range(3):
            K[:, :, i, :, i] += gg
        K *= V[:, None, None, None, None]
        return K

    def tangent(self, u: np.ndarray) -> csc_matrix:
        """Tangent stiffness of the free dofs [N/m], sparse symmetric."""
        indptr, indices, place, inside = self._pattern
        values = self.element_tangents(u).reshape(-1)[inside]
        data = np.bincount(place, values, minlength=len(indices))
        size = 3 * len(self.free)
        return csc_matrix((data, indices, indptr), shape=(size, size))

    @cached_property
    def _pattern(self):
        """Sparsity of the free dofs, and where each element entry goes."""
        row_of = np.full(len(self.mesh.nodes), -1)
        row_of[self.free] = np.arange(len(self.free))
        nodes = row_of[self.mesh.tets]
        dofs = np.where(
            nodes[:, :, None] < 0, -1, 3 * nodes[:, :, None] + np.arange(3)
        ).reshape(-1, 12)
        rows = np.repeat(dofs, 12, axis=1).ravel()
        cols = np.tile(dofs, (1, 12)).ravel()
        inside = np.flatnonzero((rows >= 0) & (cols >= 0))
        size = 3 * len(self.free)
        key = cols[inside] * size + rows[inside]
        unique, place = np.unique(key, return_inverse=True)
        indptr = np.searchsorted(unique, np.arange(size + 1) * size)
        return indptr, unique % size, place, inside
