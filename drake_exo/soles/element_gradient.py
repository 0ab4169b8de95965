"""From the compliance's derivative to the node positions', element by element.

dC = −Nᵀ dK N, and an element's share of uᵀ dK u follows from Eshelby's
tensor. With energies of fields averaged around edges and nodes ("smoothed")
the element's stress and energy are replaced by means over its own averages.
"""

import numpy as np

from drake_exo.soles.elasticity import Sole, displacement_gradient

_CHUNK = 64
_NEGLIGIBLE = 1e-11


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
    mesh = sole.mesh
    N = sole.influence[:, touched]
    M = np.zeros((len(mesh.tets), 9, 9))  # Σ w σ ⊗ H
    energy = np.zeros(len(mesh.tets))  # Σ w 2 ψ̄
    for start in range(0, len(weight), _CHUNK):
        part = slice(start, start + _CHUNK)
        w = weight[part]
        U = np.zeros((len(w), len(mesh.nodes), 3))
        U[:, sole.free] = (N @ Q[:, part]).T.reshape(len(w), -1, 3)
        H = displacement_gradient(mesh, U)
        sigma, density = sole.stress_and_energy(H)
        energy += 2 * w @ density
        flat = (sigma * w[:, None, None, None]).reshape(len(w), -1, 9)
        M += flat.transpose(1, 2, 0) @ H.reshape(len(w), -1, 9).transpose(
            1, 0, 2
        )
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
