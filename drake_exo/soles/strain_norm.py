"""A differentiable measure of the largest strain over elements and samples.

Φ = (Σ_q n_q Σ_e tr ε_qe^p)^(1/p) with even p: the p-norm of all principal
strains, never below the largest |principal strain| and smooth without
eigenvalues. A sample that stands for n_q counts so often: thinned samples
then give about the norm of all. Small strain ε of u = N f, with f the nodal
forces in the sole frame.
"""

from dataclasses import dataclass

import numba
import numpy as np

from drake_exo.soles.adjoint import ForceTerm, heavy
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.element_gradient import stiffness_gradients
from drake_exo.soles.mesh import scatter
from drake_exo.soles.rotations import multiply
from drake_exo.soles.simulation import StepHistory
from drake_exo.soles.smoothing import gradient_operators

ORDER = 64  # p
_BATCH = 32  # samples at a time
# Strains (Frobenius) below this part of a principal one add less than 1e-13.
_FAINT = 0.5


@dataclass
class StrainNorm:
    """Φ of one simulated design and its derivatives.

    Args:
        sole: The sole.
        history: Its simulation.
        counts: How many samples each stands for, (N,), at least 1.
    """

    sole: Sole
    history: StepHistory
    counts: np.ndarray

    def __post_init__(self):
        history = self.history
        f = np.einsum("qmi,qij->qmj", history.F, history.R)
        self._u = self.sole.displacement(f)
        self._collect()
        unit = np.sqrt((self._eps**2).sum(axis=(1, 2)).max())
        power = _powers(self._eps / unit, ORDER)
        total = np.trace(power, axis1=1, axis2=2) @ self.counts[self._q]
        self.value = float(unit * total ** (1 / ORDER))

    def _collect(self) -> None:
        """Sample, element and gradient H of all strains that count."""
        mesh = self.sole.mesh
        operators = gradient_operators(mesh)
        found, largest = [], 0.0
        for first in range(0, len(self._u), _BATCH):
            u = self._u[first : first + _BATCH]
            flat = np.moveaxis(u, 0, -1).reshape(len(mesh.nodes), -1)
            H = np.stack(
                [(D @ flat).reshape(-1, 3, len(u)) for D in operators], axis=2
            )
            size = ((H + np.swapaxes(H, 1, 2)) ** 2).sum(axis=(1, 2)) / 4
            largest = max(largest, size.max())
            # The largest principal strain is at least largest / √3.
            e, q = np.nonzero(size > _FAINT**2 * largest / 3)
            found.append((q + first, e, H[e, :, :, q]))
        q, e, H = (np.concatenate(part) for part in zip(*found, strict=True))
        eps = 0.5 * (H + np.swapaxes(H, 1, 2))
        size = (eps**2).sum(axis=(1, 2))
        principal = np.abs(np.linalg.eigvalsh(eps[size.argmax()])).max()
        keep = size > (_FAINT * principal) ** 2
        self._q, self._e = q[keep], e[keep]
        self._H, self._eps = H[keep], eps[keep]

    def derivatives(self) -> tuple[list[list[ForceTerm]], np.ndarray]:
        """By the nodal forces and, at fixed forces, by the node positions.

        Returns:
            Terms for every sample, ∂Φ/∂X (n, 3).
        """
        sole, mesh = self.sole, self.sole.mesh
        G, tets = self._by_strain(), mesh.tets[self._e]
        g = np.swapaxes(mesh.gradients[self._e], 1, 2)
        shape = self._u.shape
        pull = np.zeros((shape[0] * shape[1], 3))
        place = self._q[:, None] * shape[1] + tets
        scatter(pull, place, np.swapaxes(G @ g, 1, 2))
        pull = pull.reshape(shape)
        # Gradients of the shape functions change with the nodes.
        by_nodes = np.zeros_like(mesh.nodes)
        moved = np.swapaxes(self._H, 1, 2) @ G @ g
        scatter(by_nodes, tets, -np.swapaxes(moved, 1, 2))
        kept = heavy(pull)
        free = sole.free
        u = self._u[kept][:, free].reshape(len(kept), -1).T
        v = sole.solve(pull[kept][:, free].reshape(len(kept), -1).T)
        by_nodes += stiffness_gradients(sole, v[None], u)[0]
        terms = [[] for _ in self._u]
        for q, column in zip(kept, v[sole.contact_rows].T, strict=True):
            terms[q].append(ForceTerm(column.reshape(-1, 3)))
        return terms, by_nodes

    def _by_strain(self) -> np.ndarray:
        """∂Φ/∂ε = n (ε/Φ)^(p−1), (k, 3, 3)."""
        out = _powers(self._eps / self.value, ORDER - 1)
        return out * self.counts[self._q][:, None, None]


@numba.njit(cache=True)
def _powers(matrices, order):
    """Powers of 3 × 3 matrices, by squaring."""
    out = np.empty_like(matrices)
    square, product = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(matrices)):
        square[:] = matrices[k]
        out[k] = np.eye(3)
        left = order
        while left:
            if left % 2:
                multiply(out[k], square, product)
                out[k] = product
            multiply(square, square, product)
            square[:] = product
            left //= 2
    return out
