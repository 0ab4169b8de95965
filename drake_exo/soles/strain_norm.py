"""A differentiable measure of the largest strain over elements and samples.

Φ = (Σ_q Σ_e tr ε_qe^p)^(1/p) with even p: the p-norm of all principal
strains, never below the largest |principal strain| and smooth without
eigenvalues. Small strain ε of u = N f, with f the nodal forces in the sole
frame.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.soles.adjoint import ForceTerm
from drake_exo.soles.elasticity import Sole, displacement_gradient
from drake_exo.soles.element_gradient import stiffness_gradient
from drake_exo.soles.simulation import StepHistory

_DOUBLINGS = 5
ORDER = 2**_DOUBLINGS  # p
_BATCH = 32  # samples at a time
_NEGLIGIBLE = 1e-12  # of the largest derivative: samples left out


@dataclass
class StrainNorm:
    """Φ of one simulated design and its derivatives.

    Args:
        sole: The sole.
        history: Its simulation.
        unit: Strain that counts as one, near the largest, so that powers
            neither over- nor underflow.
    """

    sole: Sole
    history: StepHistory
    unit: float = 0.3

    def __post_init__(self):
        history = self.history
        self._f = np.einsum("qmi,qij->qmj", history.F, history.R)
        self._u = self.sole.displacement(self._f)
        total = 0.0
        for part in self._batches():
            power = self.sole.strain(self._u[part]) / self.unit
            for _ in range(_DOUBLINGS):
                power = power @ power
            total += np.trace(power, axis1=-2, axis2=-1).sum()
        self.value = self.unit * float(total ** (1 / ORDER))

    def _batches(self):
        return [slice(k, k + _BATCH) for k in range(0, len(self._u), _BATCH)]

    def derivatives(self) -> tuple[list[list[ForceTerm]], np.ndarray]:
        """By the nodal forces and, at fixed forces, by the node positions.

        Returns:
            Terms for every sample, ∂Φ/∂X (n, 3).
        """
        sole, mesh = self.sole, self.sole.mesh
        pull, by_nodes = np.zeros_like(self._u), np.zeros_like(mesh.nodes)
        for part in self._batches():
            H = displacement_gradient(mesh, self._u[part])
            G = self._by_strain(0.5 * (H + np.swapaxes(H, -1, -2)))
            local = np.einsum("qeij,eaj->qeai", G, mesh.gradients)
            for q, row in enumerate(local):
                _scatter(pull[part.start + q], mesh.tets, row)
            # Gradients of the shape functions change with the nodes.
            turned = (np.swapaxes(H, -1, -2) @ G).sum(axis=0)
            moved = np.einsum("eij,eaj->eai", turned, mesh.gradients)
            _scatter(by_nodes, mesh.tets, -moved)
        size = np.abs(pull).max(axis=(1, 2))
        heavy = np.flatnonzero(size > _NEGLIGIBLE * size.max())
        free = sole.free
        u = self._u[heavy][:, free].reshape(len(heavy), -1).T
        v = sole.solve(pull[heavy][:, free].reshape(len(heavy), -1).T)
        by_nodes += _bilinear_gradient(sole, u, v)
        terms = [[] for _ in self._f]
        for q, column in zip(heavy, v[sole.contact_rows].T, strict=True):
            terms[q].append(ForceTerm(column.reshape(-1, 3)))
        return terms, by_nodes

    def _by_strain(self, eps: np.ndarray) -> np.ndarray:
        """∂Φ/∂ε = (ε/Φ)^(p−1), (..., 3, 3)."""
        square = eps / self.value
        out = square
        for _ in range(_DOUBLINGS - 1):
            square = square @ square
            out = out @ square
        return out


def _bilinear_gradient(sole: Sole, u: np.ndarray, v: np.ndarray):
    """∂/∂X of −Σ vᵀ K u at fixed fields (3 n_f, k), as two quadratic forms."""
    ratio = np.linalg.norm(u, axis=0) / np.linalg.norm(v, axis=0)
    weight = np.concatenate([0.25 / ratio, -0.25 / ratio])
    fields = np.concatenate([u + ratio * v, u - ratio * v], axis=1)
    return stiffness_gradient(sole, weight, lambda part: fields[:, part])


def _scatter(out: np.ndarray, tets: np.ndarray, local: np.ndarray) -> None:
    """Add element rows (e, 4, 3) to node rows (n, 3)."""
    for axis in range(3):
        out[:, axis] += np.bincount(
            tets.ravel(), local[:, :, axis].ravel(), minlength=len(out)
        )
