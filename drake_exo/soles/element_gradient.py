"""From the compliance's derivative to the node positions', element by element.

dC = −Nᵀ dK N, and an element's share of uᵀ dK u follows from Eshelby's
tensor. With energies of fields averaged around edges and nodes ("smoothed")
the element's stress and energy are replaced by means over its own averages.
"""

from collections.abc import Callable

import numpy as np

from drake_exo.soles.elasticity import Sole
from drake_exo.soles.smoothing import gradient_operators

_CHUNK = 64
_NEGLIGIBLE = 1e-10


def compliance_gradient(
    sole: Sole, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Derivative of tr(C̄ᵀ C) by the node positions for C̄ = left rightᵀ.

    Args:
        sole: The condensed sole.
        left, right: (3m, c).

    Returns:
        (n, 3).
    """
    touched = np.flatnonzero(
        np.any(left != 0, axis=1) | np.any(right != 0, axis=1)
    )
    C_bar = left[touched] @ right[touched].T
    weight, Q = np.linalg.eigh(0.5 * (C_bar + C_bar.T))
    keep = np.abs(weight) > _NEGLIGIBLE * np.abs(weight).max()
    weight, Q = weight[keep], Q[:, keep]
    N = sole.influence[:, touched]
    return stiffness_gradient(sole, weight, lambda part: N @ Q[:, part])


def stiffness_gradient(
    sole: Sole, weight: np.ndarray, modes: Callable[[slice], np.ndarray]
) -> np.ndarray:
    """Derivative of −Σ w_k u_kᵀ K u_k by the node positions, u_k held.

    Args:
        sole: The sole.
        weight: w (k,).
        modes: Gives the free displacements u of a range, (3 n_f, len).

    Returns:
        (n, 3).
    """
    mesh = sole.mesh
    gradient = gradient_operators(mesh)
    M = np.zeros((len(mesh.tets), 9, 9))  # Σ w σ ⊗ H
    energy = np.zeros(len(mesh.tets))  # Σ w 2 ψ̄
    for start in range(0, len(weight), _CHUNK):
        part = slice(start, start + _CHUNK)
        w = weight[part]
        U = np.zeros((len(mesh.nodes), 3 * len(w)))
        U[sole.free] = modes(part).reshape(-1, 3 * len(w))
        H = np.empty((len(mesh.tets), 3, 3, len(w)))
        for j, D in enumerate(gradient):  # ∂/∂X_j of every mode at once
            H[:, :, j] = (D @ U).reshape(-1, 3, len(w))
        sigma, density = _stress_and_energy(sole, H)
        energy += 2 * density @ w
        M += (sigma * w).reshape(-1, 9, len(w)) @ H.reshape(
            -1, 9, len(w)
        ).transpose(0, 2, 1)
    M = M.reshape(-1, 3, 3, 3, 3)
    work = np.einsum("eijij->e", M)
    turned = np.einsum("eibia->eab", M)  # Hᵀ σ
    S = -(2 * work - energy)[:, None, None] * np.eye(3) + 2 * turned
    local = mesh.volumes[:, None, None] * np.einsum(
        "eij,eaj->eai", S, mesh.gradients
    )
    out = np.zeros_like(mesh.nodes)
    np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
    return out


def _stress_and_energy(sole: Sole, H: np.ndarray):
    """As `Sole.stress_and_energy`, modes last: (e, 3, 3, k), (e, k)."""
    if sole.element != "linear":
        sigma, energy = sole.stress_and_energy(np.moveaxis(H, -1, 0))
        return np.moveaxis(sigma, 0, -1), energy.T
    material = sole.material
    sigma = material.shear_modulus * (H + H.transpose(0, 2, 1, 3))
    trace = material.lame_lambda * (H[:, 0, 0] + H[:, 1, 1] + H[:, 2, 2])
    for i in range(3):
        sigma[:, i, i] += trace
    return sigma, 0.5 * np.einsum("eijk,eijk->ek", sigma, H)
