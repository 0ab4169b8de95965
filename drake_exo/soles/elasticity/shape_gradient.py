"""Derivatives of elastic energies and of the compliance by the node positions.

dC = −Nᵀ dK N, so that all that is needed are derivatives of wᵀ K w for fields
w held at the nodes: all fields together are one matrix Σ λ w wᵀ, of which the
stiffness matrix's own blocks count.
"""

import numpy as np

from drake_exo.soles.elasticity.linear import Sole, average_gradients, groups_of
from drake_exo.soles.numerics import njit

# Of the largest eigenvalue: what is left out changes a gradient by some 1e-7
# of its largest entry, and is half of the fields.
_NEGLIGIBLE = 1e-7


def compliance_gradients(sole: Sole, terms: list, held: list) -> np.ndarray:
    """Derivatives of tr(C̄ᵀ C) with C̄ = left rightᵀ by the nodes, (f, n, 3).

    C is symmetric: the eigenvectors of C̄'s symmetric part are all the fields
    that it takes.

    Args:
        sole: The condensed sole.
        terms: Pairs of left and right, (3m, c) each, one for each C̄.
        held: For each further fields and factors as of `energy_gradients`,
            whose derivative is added, or None.
    """
    forces, factors = zip(
        *(_forces(sole, *term) for term in terms), strict=True
    )
    ends = np.cumsum([f.shape[1] for f in forces])
    fields = np.split(sole.carry(np.hstack(forces)), ends[:-1], axis=1)
    both = list(zip(fields, factors, strict=True))
    for k, more in enumerate(held):
        if more is not None:
            both[k] = tuple(
                np.concatenate(x, axis=-1)
                for x in zip(both[k], more, strict=True)
            )
    return energy_gradients(sole, both)


def _forces(sole: Sole, left: np.ndarray, right: np.ndarray):
    """At the contact dofs (3m, k) and factors (k,): those that C̄ takes."""
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
    return forces, values[kept]


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


def energy_gradients(sole: Sole, fields: list) -> np.ndarray:
    """Derivatives of −Σ λ wᵀ K w by the node positions, fields held, (f, n, 3).

    Args:
        sole: The sole.
        fields: Pairs of free displacements w (3 n_f, k) and factors λ (k,).
    """
    pattern = sole.pattern
    indptr, indices = pattern.graph.indptr, pattern.graph.indices
    W = np.empty((len(indices), len(fields), 3, 3))
    for which, (w, factors) in enumerate(fields):
        w = np.ascontiguousarray(w).reshape(len(sole.free), 3, -1)
        _products(indptr, indices, w, factors, W[:, which])
    out = np.zeros((len(fields), *sole.mesh.nodes.shape))
    for groups in groups_of(sole.mesh, sole.material, pattern):
        _add_gradients(*groups, indptr, indices, W, out)
    return out


@njit(fastmath=True)
def _products(indptr, indices, w, factors, out):
    """Σ λ w_a w_bᵀ of the matrix's blocks with a <= b, into (nnz, 3, 3)."""
    for a in range(len(indptr) - 1):
        x, y, z = factors * w[a, 0], factors * w[a, 1], factors * w[a, 2]
        for entry in range(indptr[a], indptr[a + 1]):
            if indices[entry] < a:
                continue
            for j in range(3):
                v = w[indices[entry], j]
                p = q = r = 0.0
                for k in range(len(v)):
                    p += x[k] * v[k]
                    q += y[k] * v[k]
                    r += z[k] * v[k]
                out[entry, 0, j], out[entry, 1, j], out[entry, 2, j] = p, q, r


@njit()
def _add_gradients(
    start, around, tets, g, volumes, shear, lam, number, indptr, indices, W, out
):
    """Add −∂(W : K)/∂X of the groups' energies, see `groups_of`.

    That of a group is Σ G_aᵀ M_ab G_b / V with G = Σ v g, V = Σ v and
    M = μ (tr W I + Wᵀ) + λ W.

    Args:
        W: Blocks with a <= b, (nnz, f, 3, 3).
        out: (f, n, 3).
    """
    slot = np.full(len(number), -1)
    nodes, G = np.empty(len(number), np.int64), np.empty((len(number), 3))
    by_G = np.empty((len(number), len(out), 3))
    for group in range(len(start) - 1):
        elements = around[start[group] : start[group + 1]]
        count, V = average_gradients(
            elements, tets, g, volumes, number, slot, nodes, G
        )
        by_G[:count] = 0.0
        for a in range(count):
            low, high = indptr[nodes[a]], indptr[nodes[a] + 1]
            row = indices[low:high]
            for b in range(count):
                if nodes[b] < nodes[a]:
                    continue
                entry = low + np.searchsorted(row, nodes[b])
                for f in range(len(out)):
                    w = W[entry, f]
                    trace = w[0, 0] + w[1, 1] + w[2, 2]
                    for i in range(3):
                        for j in range(3):
                            M = shear * w[j, i] + lam * w[i, j]
                            if i == j:
                                M += shear * trace
                            by_G[a, f, i] += M * G[b, j]
                            if a != b:
                                by_G[b, f, j] += M * G[a, i]
        for f in range(len(out)):
            energy = 0.0
            for a in range(count):
                for i in range(3):
                    energy += by_G[a, f, i] * G[a, i]
                    by_G[a, f, i] *= 2 / V
            _by_places(
                elements, tets, g, volumes, number, slot,
                by_G[:, f], -energy / V**2, out[f],
            )  # fmt: skip
        for a in range(count):
            slot[nodes[a]] = -1


@njit()
def _by_places(elements, tets, g, volumes, number, slot, by_G, by_volume, out):
    """Subtract a group's derivative by the nodes from out (n, 3).

    ∂v = v g_c·dX_c and ∂g_a = −g_c (g_a·dX_c), added up in G and V.
    """
    for e in elements:
        size = by_volume
        for a in range(4):
            node = number[tets[e, a]]
            if node >= 0:
                for i in range(3):
                    size += by_G[slot[node], i] * g[e, a, i]
        for c in range(4):
            for i in range(3):
                out[tets[e, c], i] -= volumes[e] * size * g[e, c, i]
            for a in range(4):
                node = number[tets[e, a]]
                if node < 0:
                    continue
                along = 0.0
                for i in range(3):
                    along += by_G[slot[node], i] * g[e, c, i]
                for i in range(3):
                    out[tets[e, c], i] += volumes[e] * along * g[e, a, i]
