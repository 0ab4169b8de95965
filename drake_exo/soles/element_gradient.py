"""From the compliance's derivative to the node positions', element by element.

dC = −Nᵀ dK N, and an element's share of vᵀ dK u follows from Eshelby's
tensor. With energies of fields averaged around edges and nodes ("smoothed")
the element's stress and energy are replaced by means over its own averages.
"""

import numpy as np

from drake_exo.soles.elasticity import Sole, displacement_gradient

_FIELDS = 64  # at a time


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
    N = sole.influence[:, touched]
    return stiffness_gradient(sole, N @ (left[touched] @ right[touched].T), N)


def stiffness_gradient(sole: Sole, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Derivative of −Σ v_kᵀ K u_k by the node positions, fields held.

    Args:
        sole: The sole.
        v, u: Free displacements, (3 n_f, k) each.

    Returns:
        (n, 3).
    """
    mesh = sole.mesh
    if sole.element == "linear":
        M = _work_linear(sole, v, u)
        energy = np.einsum("eijij->e", M)
    else:
        M, energy = _work_smoothed(sole, v, u)
    work = np.einsum("eijij->e", M)
    turned = np.einsum("eibia->eab", M)  # Hᵀ σ
    S = -(2 * work - energy)[:, None, None] * np.eye(3) + 2 * turned
    local = mesh.volumes[:, None, None] * np.einsum(
        "eij,eaj->eai", S, mesh.gradients
    )
    out = np.zeros_like(mesh.nodes)
    np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
    return out


def _at_nodes(sole: Sole, fields: np.ndarray) -> np.ndarray:
    """Fields at all nodes, (n, 3, k)."""
    out = np.zeros((len(sole.mesh.nodes), 3, fields.shape[1]))
    out[sole.free] = fields.reshape(-1, 3, fields.shape[1])
    return out


def _work_linear(sole: Sole, v, u) -> np.ndarray:
    """Σ_k of σ(v) ⊗ H(u), made symmetric in v and u, (e, 3, 3, 3, 3).

    By way of Σ_k v uᵀ between neighbouring nodes, which elements share: far
    cheaper than the gradients of every field.
    """
    mesh, g = sole.mesh, sole.mesh.gradients
    between, place = _between_nodes(
        mesh.tets, _at_nodes(sole, v), _at_nodes(sole, u)
    )
    pairs = between[place]  # (e, 4, 4, 3, 3)
    pairs = 0.5 * (pairs + pairs.transpose(0, 2, 1, 4, 3))
    half = np.einsum("eabik,ebl->eaikl", pairs, g)
    H = np.einsum("eaj,eaikl->eijkl", g, half)
    M = sole.material.shear_modulus * (H + H.transpose(0, 2, 1, 3, 4))
    trace = sole.material.lame_lambda * (H[:, 0, 0] + H[:, 1, 1] + H[:, 2, 2])
    for i in range(3):
        M[:, i, i] += trace
    return M


def _between_nodes(tets, v, u):
    """Σ_k v_a u_bᵀ for all nodes a, b with an element in common.

    Args:
        tets: (e, 4).
        v, u: Fields at all nodes, (n, 3, k).

    Returns:
        Products (pairs, 3, 3), and where each element's are, (e, 4, 4).
    """
    n = len(v)
    codes = tets[:, :, None] * n + tets[:, None, :]
    pairs, place = np.unique(codes, return_inverse=True)
    ends = np.searchsorted(pairs, n * np.arange(n + 1))
    out = np.empty((len(pairs), 3, 3))
    for a in range(n):
        part = slice(ends[a], ends[a + 1])
        around = u[pairs[part] - a * n]
        product = v[a] @ around.reshape(-1, u.shape[2]).T
        out[part] = product.reshape(3, -1, 3).swapaxes(0, 1)
    return out, place.reshape(codes.shape)


def _work_smoothed(sole: Sole, v, u):
    """As `_work_linear`, and Σ_k of twice the energy: v and u ± each other.

    Only the energy of one field is known here, hence the two squares.
    """
    v, u = _at_nodes(sole, v), _at_nodes(sole, u)
    size = np.linalg.norm(u, axis=(0, 1)) / np.linalg.norm(v, axis=(0, 1))
    M = np.zeros((len(sole.mesh.tets), 9, 9))
    energy = np.zeros(len(M))
    for sign in (1.0, -1.0):
        for first in range(0, len(size), _FIELDS):
            part = slice(first, first + _FIELDS)
            field = u[:, :, part] + sign * size[part] * v[:, :, part]
            H = displacement_gradient(sole.mesh, np.moveaxis(field, -1, 0))
            sigma, density = sole.stress_and_energy(H)
            w = sign * 0.25 / size[part]
            energy += 2 * w @ density
            flat = sigma.reshape(len(w), -1, 9).transpose(1, 2, 0)
            M += (flat * w) @ H.reshape(len(w), -1, 9).transpose(1, 0, 2)
    return M.reshape(-1, 3, 3, 3, 3), energy
