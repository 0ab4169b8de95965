"""Derivatives of elastic energies and of the compliance by the node positions.

dC = −Nᵀ dK N, so that all that is needed are derivatives of wᵀ K w for fields
w held at the nodes; an element's share follows from Eshelby's tensor. With
energies of fields averaged around edges and nodes ("smoothed") the element's
stress and energy are means over its own averages.
"""

import numpy as np

from drake_exo.soles.compiled import njit
from drake_exo.soles.elasticity.linear import Sole, gradient_operators
from drake_exo.soles.mesh import scatter

_NUMBERS = 2e6  # in one displacement gradient of the fields taken at a time
# Of the largest eigenvalue: what is left out changes a gradient by some 1e-7
# of its largest entry, and is half of the fields.
_NEGLIGIBLE = 1e-7


def compliance_gradient(
    sole: Sole, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Derivative of tr(C̄ᵀ C) with C̄ = left rightᵀ by the nodes, (n, 3).

    C is symmetric: the eigenvectors of C̄'s symmetric part are all the fields
    that it takes.

    Args:
        sole: The condensed sole.
        left, right: (3m, c) each.
    """
    dofs = np.flatnonzero(left.any(axis=1) | right.any(axis=1))
    left, right = left[dofs], right[dofs]
    if 2 * left.shape[1] < len(dofs):
        basis, _ = np.linalg.qr(np.hstack([left, right]))
        left, right = basis.T @ left, basis.T @ right
    else:
        basis = None
    half = 0.5 * left @ right.T
    values, vectors = np.linalg.eigh(half + half.T)
    kept = np.abs(values) > _NEGLIGIBLE * np.abs(values).max(initial=0.0)
    vectors = vectors[:, kept] if basis is None else basis @ vectors[:, kept]
    forces = np.zeros((3 * len(sole.mesh.contact), kept.sum()))
    forces[dofs] = vectors
    return energy_gradient(sole, sole.carry(forces), values[kept])


def pairs(v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fields w and factors λ with Σ λ wᵀ K w = Σ vᵀ K u for any K.

    Args:
        v, u: Columns are fields, (d, k) each.

    Returns:
        (d, 2k), (2k,).
    """
    sizes = [np.linalg.norm(x, axis=0) for x in (u, v)]
    there = (sizes[0] > 0) & (sizes[1] > 0)
    size = sizes[0][there] / sizes[1][there]
    v, u = size * v[:, there], u[:, there]
    return np.hstack([u + v, u - v]), np.concatenate([1 / size, -1 / size]) / 4


def energy_gradient(
    sole: Sole, w: np.ndarray, factors: np.ndarray
) -> np.ndarray:
    """Derivative of −Σ λ wᵀ K w by the node positions, fields held, (n, 3).

    Args:
        sole: The sole.
        w: Free displacements, (3 n_f, k).
        factors: λ, (k,).
    """
    mesh = sole.mesh
    operators = gradient_operators(mesh)
    turned = np.zeros((len(mesh.tets), 3, 3))
    energy = np.zeros(len(mesh.tets))
    together = max(4, int(_NUMBERS / (3 * len(mesh.tets))))
    for first in range(0, len(factors), together):
        part = slice(first, first + together)
        k = len(factors[part])
        field = np.zeros((len(mesh.nodes), 3 * k))
        field[sole.free] = w[:, part].reshape(-1, 3 * k)
        # H_ij of all fields: rows are elements, j the first index.
        H = np.stack([D @ field for D in operators])
        H = H.reshape(3, len(mesh.tets), 3, k)
        stress = sole.stress_and_energy(H, factors[part])
        energy += stress[1]
        _turn(H, stress[0], factors[part], turned)
    work = np.trace(turned, axis1=1, axis2=2)
    S = -(2 * work - 2 * energy)[:, None, None] * np.eye(3) + 2 * turned
    local = mesh.gradients @ S.swapaxes(1, 2)
    local *= mesh.volumes[:, None, None]
    out = np.zeros_like(mesh.nodes)
    scatter(out, mesh.tets, local)
    return out


@njit(fastmath=True)
def _turn(H, sigma, factors, out):
    """Add Σ_k λ_k Hᵀ σ in every element to out.

    Args:
        H: Displacement gradients, (3 (j), e, 3 (i), k).
        sigma: Stresses xx, yy, zz, yz, xz, xy, (e, 6, k).
        factors: λ, (k,).
        out: (e, 3, 3).
    """
    which = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
    for e in range(H.shape[1]):
        for a in range(3):
            for b in range(3):
                total = 0.0
                for i in range(3):
                    h, s = H[a, e, i], sigma[e, which[i, b]]
                    for k in range(len(factors)):
                        total += factors[k] * h[k] * s[k]
                out[e, a, b] += total
