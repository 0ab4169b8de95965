"""Derivatives of elastic energies and of the compliance by the node positions.

dC = −Nᵀ dK N, so that all that is needed are derivatives of wᵀ K w for fields
w held at the nodes; an element's share follows from Eshelby's tensor. With
energies of fields averaged around edges and nodes ("smoothed") the element's
stress and energy are means over its own averages.
"""

import numpy as np

from drake_exo.soles.compiled import njit
from drake_exo.soles.elasticity.linear import Sole, edges_of
from drake_exo.soles.mesh import scatter

_TOGETHER = 16  # fields taken at a time
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
    mesh, material = sole.mesh, sole.material
    e, g = len(mesh.tets), mesh.gradients
    turned, energy = np.zeros((e, 3, 3)), np.zeros(e)
    owner = edges_of(mesh)
    if sole.element == "smoothed":
        volumes = [
            np.bincount(who.ravel(), np.repeat(mesh.volumes / n, n))
            for who, n in ((owner, 6), (mesh.tets, 4))
        ]
        of_edges, of_nodes = (np.zeros(len(v)) for v in volumes)
    for first in range(0, len(factors), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        field = np.zeros((len(mesh.nodes), 3, len(factors[part])))
        field[sole.free] = w[:, part].reshape(len(sole.free), 3, -1)
        if sole.element == "smoothed":
            _averaged(
                mesh.tets, owner, g, mesh.volumes, *volumes,
                material.shear_modulus, material.bulk_modulus,
                field, factors[part], turned, of_edges, of_nodes,
            )  # fmt: skip
        else:
            _by_element(
                mesh.tets, g, material.shear_modulus, material.lame_lambda,
                field, factors[part], turned, energy,
            )  # fmt: skip
    if sole.element == "smoothed":
        energy = of_edges[owner].mean(axis=1) + of_nodes[mesh.tets].mean(axis=1)
    work = np.trace(turned, axis1=1, axis2=2)
    S = -(2 * work - 2 * energy)[:, None, None] * np.eye(3) + 2 * turned
    local = g @ S.swapaxes(1, 2)
    local *= mesh.volumes[:, None, None]
    out = np.zeros_like(mesh.nodes)
    scatter(out, mesh.tets, local)
    return out


# Fields w are (n, 3, k) in what follows, strains and stresses (6, k): xx, yy,
# zz, yz, xz, xy.


@njit(fastmath=True)
def _gradient(tet, g, w, H):
    """H_ij = ∂w_i/∂X_j of an element, into (3, 3, k)."""
    for i in range(3):
        p, q, r, s = w[tet[0], i], w[tet[1], i], w[tet[2], i], w[tet[3], i]
        for j in range(3):
            a, b, c, d = g[0, j], g[1, j], g[2, j], g[3, j]
            for k in range(len(p)):
                H[i, j, k] = a * p[k] + b * q[k] + c * r[k] + d * s[k]


@njit(fastmath=True)
def _symmetric(H, eps):
    """Strains of displacement gradients."""
    for k in range(H.shape[2]):
        for i in range(3):
            eps[i, k] = H[i, i, k]
        eps[3, k] = 0.5 * (H[1, 2, k] + H[2, 1, k])
        eps[4, k] = 0.5 * (H[0, 2, k] + H[2, 0, k])
        eps[5, k] = 0.5 * (H[0, 1, k] + H[1, 0, k])


@njit(fastmath=True)
def _turn(H, sigma, factors, out):
    """Add Σ_k λ_k Hᵀ σ to out (3, 3)."""
    which = ((0, 5, 4), (5, 1, 3), (4, 3, 2))
    for a in range(3):
        for b in range(3):
            total = 0.0
            for i in range(3):
                h, s = H[i, a], sigma[which[i][b]]
                for k in range(len(factors)):
                    total += factors[k] * h[k] * s[k]
            out[a, b] += total


@njit(fastmath=True)
def _by_element(tets, g, shear, lam, w, factors, turned, energy):
    """Add Σ λ Hᵀ σ and the sum of energy densities, linear elements."""
    H, s = np.empty((3, 3, len(factors))), np.empty((6, len(factors)))
    for e in range(len(tets)):
        _gradient(tets[e], g[e], w, H)
        _symmetric(H, s)
        for k in range(len(factors)):
            trace, density = s[0, k] + s[1, k] + s[2, k], 0.0
            for m in range(6):
                density += shear * s[m, k] ** 2 * (1.0 if m < 3 else 2.0)
                s[m, k] = 2 * shear * s[m, k] + (lam * trace if m < 3 else 0.0)
            energy[e] += factors[k] * (density + 0.5 * lam * trace**2)
        _turn(H, s, factors, turned[e])


@njit(fastmath=True)
def _averaged(
    tets, owner, g, volumes, V_edge, V_node, shear, bulk,
    w, factors, turned, of_edges, of_nodes,
):  # fmt: skip
    """Add Σ λ Hᵀ σ of elements and the energy densities of edges and nodes.

    σ is the mean of an element's edges (deviator) and nodes (pressure).
    """
    c = len(factors)
    around = np.zeros((len(V_edge), 6, c))
    within = np.zeros((len(V_node), c))
    H, s = np.empty((3, 3, c)), np.empty((6, c))
    for e in range(len(tets)):
        _gradient(tets[e], g[e], w, H)
        _symmetric(H, s)
        for b in range(6):
            a = owner[e, b]
            share = volumes[e] / (6 * V_edge[a])
            for m in range(6):
                for k in range(c):
                    around[a, m, k] += share * s[m, k]
        for b in range(4):
            a = tets[e, b]
            share = volumes[e] / (4 * V_node[a])
            for k in range(c):
                within[a, k] += share * (s[0, k] + s[1, k] + s[2, k])
    for a in range(len(V_edge)):
        x = around[a]
        for k in range(c):
            mean, density = (x[0, k] + x[1, k] + x[2, k]) / 3, 0.0
            for m in range(6):
                if m < 3:
                    x[m, k] -= mean
                density += x[m, k] ** 2 * (1.0 if m < 3 else 2.0)
                x[m, k] *= 2 * shear
            of_edges[a] += factors[k] * shear * density
    for a in range(len(V_node)):
        for k in range(c):
            of_nodes[a] += 0.5 * bulk * factors[k] * within[a, k] ** 2
            within[a, k] *= bulk
    for e in range(len(tets)):
        _gradient(tets[e], g[e], w, H)
        i, j, h, m, n, o = owner[e]
        for a in range(6):
            for k in range(c):
                s[a, k] = (
                    around[i, a, k] + around[j, a, k] + around[h, a, k]
                    + around[m, a, k] + around[n, a, k] + around[o, a, k]
                ) / 6  # fmt: skip
        i, j, h, m = tets[e]
        for k in range(c):
            p = within[i, k] + within[j, k] + within[h, k] + within[m, k]
            for a in range(3):
                s[a, k] += p / 4
        _turn(H, s, factors, turned[e])
