"""Volume-weighted averages of element fields around edges and nodes.

The locking-free element "smoothed" takes the deviatoric strain as its
average around each edge and the dilatation as its average around each node
(edge- and node-based smoothed finite elements: Nguyen-Thoi, Liu, Lam, Zhang,
Int. J. Numer. Meth. Engng 78, 2009; node averages: Bonet and Burton, Commun.
Numer. Meth. Engng 14, 1998). The unknowns stay those of linear tetrahedra,
and so do the contact nodes.
"""

import numpy as np
from scipy.sparse import csr_matrix, diags

from drake_exo.soles.mesh import TetMesh


def edge_average(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages around edges: matrix (k, e), volumes of edges [m³], (k,)."""
    i, j = np.triu_indices(4, 1)
    pairs = np.stack([mesh.tets[:, i], mesh.tets[:, j]], axis=-1)
    pairs = np.sort(pairs, axis=-1).reshape(-1, 2)
    code = pairs[:, 0] * len(mesh.nodes) + pairs[:, 1]
    _, owner = np.unique(code, return_inverse=True)
    return _average(owner.ravel(), mesh.volumes, 6)


def node_average(mesh: TetMesh) -> tuple[csr_matrix, np.ndarray]:
    """Averages around nodes: matrix (n, e), volumes of nodes [m³], (n,)."""
    return _average(mesh.tets.ravel(), mesh.volumes, 4)


def _average(owner, volumes, shares: int):
    """Each element gives an equal part of its volume to its owners."""
    part = np.repeat(volumes / shares, shares)
    total = np.bincount(owner, part)
    element = np.repeat(np.arange(len(volumes)), shares)
    share = csr_matrix(
        (part, (owner, element)), shape=(len(total), len(volumes))
    )
    return (diags(1 / total) @ share).tocsr(), total


def gradient_operators(mesh: TetMesh) -> list[csr_matrix]:
    """∂/∂x, ∂/∂y, ∂/∂z of a nodal field in every element, (e, n) each."""
    e, n = len(mesh.tets), len(mesh.nodes)
    rows, cols = np.repeat(np.arange(e), 4), mesh.tets.ravel()
    return [
        csr_matrix((mesh.gradients[:, :, k].ravel(), (rows, cols)), (e, n))
        for k in range(3)
    ]
