"""From the compliance's derivative to the node positions', element by element.

dC = −Nᵀ dK N, and an element's share of vᵀ dK u follows from Eshelby's
tensor. With energies of fields averaged around edges and nodes ("smoothed")
the element's stress and energy are replaced by means over its own averages.
"""

import numba
import numpy as np

from drake_exo.soles.active_set import node_dofs
from drake_exo.soles.elasticity import Sole, displacement_gradient
from drake_exo.soles.mesh import scatter

_FIELDS = 64  # at a time


def compliance_gradients(
    sole: Sole, products: list[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Derivatives of tr(C̄ᵀ C) by the node positions for each C̄.

    Args:
        sole: The condensed sole.
        products: C̄ = left rightᵀ as (left, right), (3m, c) each.

    Returns:
        (f, n, 3).
    """
    both = np.hstack([x for pair in products for x in pair])
    touched = np.flatnonzero(both.any(axis=1).reshape(-1, 3).any(axis=1))
    N, dofs = sole.influence(touched), node_dofs(touched)
    pairs = [(left[dofs], right[dofs]) for left, right in products]
    columns = np.cumsum([0, *(left.shape[1] for left, _ in pairs)])
    if columns[-1] >= len(dofs):
        v = np.empty((len(pairs), *N.shape))
        for k, (left, right) in enumerate(pairs):
            np.matmul(N, left @ right.T, out=v[k])
        return stiffness_gradients(sole, v, N)
    v = np.zeros((len(pairs), len(N), columns[-1]))
    for k, (left, _) in enumerate(pairs):
        v[k, :, columns[k] : columns[k + 1]] = N @ left
    u = N @ np.hstack([right for _, right in pairs])
    return stiffness_gradients(sole, v, u)


def stiffness_gradients(sole: Sole, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Derivatives of −Σ v_kᵀ K u_k by the node positions, fields held.

    Args:
        sole: The sole.
        v: Free displacements of every functional, (f, 3 n_f, k).
        u: Free displacements, (3 n_f, k).

    Returns:
        (f, n, 3).
    """
    mesh = sole.mesh
    if sole.element == "linear":
        turned, energy = _linear(sole, v, u)
    else:
        turned, energy = _smoothed(sole, v, u)
    work = np.trace(turned, axis1=2, axis2=3)
    S = -(2 * work - energy)[..., None, None] * np.eye(3) + 2 * turned
    local = mesh.gradients @ S.swapaxes(2, 3)
    local *= mesh.volumes[:, None, None]
    out = np.zeros((len(v), *mesh.nodes.shape))
    for own, rows in zip(out, local, strict=True):
        scatter(own, mesh.tets, rows)
    return out


def _at_nodes(sole: Sole, fields: np.ndarray) -> np.ndarray:
    """Fields at all nodes, (..., 3n_f, k) -> (..., n, 3, k)."""
    *lead, _, k = fields.shape
    out = np.zeros((*lead, len(sole.mesh.nodes), 3, k))
    out[..., sole.free, :, :] = fields.reshape(*lead, -1, 3, k)
    return out


def _linear(sole: Sole, v, u):
    """Σ_k H(u)ᵀ σ(v), symmetric in v and u, and twice the energy.

    Args:
        sole: With linear elements.
        v, u: As for `stiffness_gradients`.

    Returns:
        (f, e, 3, 3), (f, e).
    """
    material, mesh = sole.material, sole.mesh
    between, place = _between_nodes(mesh.tets, sole.free, v, u)
    turned = np.array(
        [
            _turned(
                products,
                place,
                mesh.gradients,
                material.shear_modulus,
                material.lame_lambda,
            )
            for products in between
        ]
    )
    return turned, np.trace(turned, axis1=2, axis2=3)


def _between_nodes(tets, free, v, u):
    """Σ_k v_a u_bᵀ for all nodes a, b with an element in common.

    Elements share these products: far cheaper than the gradients of every
    field.

    Args:
        tets: (e, 4).
        free: Nodes that move, (n_f,).
        v, u: Fields at these nodes, (f, 3 n_f, k) and (3 n_f, k).

    Returns:
        Products (f, pairs, 3, 3), and where each element's are, (e, 4, 4).
    """
    f, _, k = v.shape
    v, u = v.reshape(f, -1, 3, k), u.reshape(-1, 3, k)
    n = tets.max() + 1
    codes = tets[:, :, None] * n + tets[:, None, :]
    pairs, place = np.unique(codes, return_inverse=True)
    out = np.zeros((f, len(pairs), 3, 3))
    at = np.full(n, -1)
    at[free] = np.arange(len(free))
    a, b = at[pairs // n], at[pairs % n]
    moving = np.flatnonzero((a >= 0) & (b >= 0))
    ends = np.searchsorted(a[moving], np.arange(len(free) + 1))
    for node in range(len(free)):
        part = moving[ends[node] : ends[node + 1]]
        around = u[b[part]].reshape(-1, k)
        product = v[:, node].reshape(-1, k) @ around.T
        out[:, part] = product.reshape(f, 3, -1, 3).swapaxes(1, 2)
    return out, place.reshape(codes.shape)


@numba.njit(cache=True)
def _turned(between, place, gradients, shear, lam):
    """Σ_k H(u)ᵀ σ(v), made symmetric in v and u, (e, 3, 3).

    σ = μ (H + Hᵀ) + λ tr H I and H_ij = Σ_a v_a,i g_a,j; the products P of
    nodes a and b take the place of v_a u_bᵀ.
    """
    out = np.zeros((len(place), 3, 3))
    for e in range(len(place)):
        g = gradients[e]
        for a in range(4):
            for b in range(4):
                there, back = between[place[e, a, b]], between[place[e, b, a]]
                trace = 0.0
                along, across = np.zeros(3), np.zeros(3)  # P g_a, Pᵀ g_a
                for i in range(3):
                    trace += 0.5 * (there[i, i] + back[i, i])
                    for j in range(3):
                        P = 0.5 * (there[i, j] + back[j, i])
                        along[i] += P * g[a, j]
                        across[j] += P * g[a, i]
                for i in range(3):
                    of_v = shear * (trace * g[a, i] + along[i])
                    of_v += lam * across[i]
                    for j in range(3):
                        out[e, j, i] += of_v * g[b, j]
    return out


def _smoothed(sole: Sole, v, u):
    """As `_linear` with "smoothed" elements: from the fields v and u ± each.

    Only the energy of one field is known here, hence the two squares.
    """
    v, u = _at_nodes(sole, v), _at_nodes(sole, u)
    turned = np.zeros((len(v), len(sole.mesh.tets), 3, 3))
    energy = np.zeros(turned.shape[:2])
    for f, own in enumerate(v):
        there = np.flatnonzero(own.any(axis=(0, 1)) & u.any(axis=(0, 1)))
        for first in range(0, len(there), _FIELDS):
            part = there[first : first + _FIELDS]
            x, y = own[..., part], u[..., part]
            size = np.linalg.norm(y, axis=(0, 1))
            size /= np.linalg.norm(x, axis=(0, 1))
            for sign in (1.0, -1.0):
                field = np.moveaxis(y + sign * size * x, -1, 0)
                H = displacement_gradient(sole.mesh, field)
                sigma, density = sole.stress_and_energy(H)
                w = sign * 0.25 / size
                energy[f] += 2 * w @ density
                turned[f] += np.einsum("k,keia,keib->eab", w, H, sigma)
    return turned, energy
