"""Poor elements made better by moving the inner nodes of their patch.

Towards the centre of its neighbours, or off the face opposite in its worst
element, as far as the worst gains most (constrained Laplacian and
optimisation-based smoothing; Freitag, AMD 220, 1997).
"""

import numba
import numpy as np

from drake_exo.soles.mesh import FACES, TetMesh

_SWEEPS, _MOVES = 6, 4
_PARTS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)


def untangled(mesh: TetMesh, least: float) -> TetMesh:
    """The mesh with inner nodes of its poor elements moved.

    Args:
        mesh: Elements may be inverted; nodes of the surface stay.
        least: Quality below which an element is poor.
    """
    nodes = mesh.nodes.copy()
    inner = np.ones(len(nodes), dtype=bool)
    inner[np.unique(mesh.boundary_faces)] = False
    for _ in range(_SWEEPS):
        poor = np.flatnonzero(mesh.with_nodes(nodes).quality() < least)
        if not len(poor):
            break
        # Neighbours of poor elements make room for them.
        around = np.isin(mesh.tets, mesh.tets[poor]).any(axis=1)
        movable = np.unique(mesh.tets[around])
        for node in movable[inner[movable]]:
            star = mesh.tets[(mesh.tets == node).any(axis=1)]
            neighbours = np.setdiff1d(star, node)
            _relax(nodes, node, star, neighbours)
    return mesh.with_nodes(nodes)


@numba.njit(cache=True, error_model="numpy")
def _relax(nodes, node, star, neighbours) -> None:
    """Move one node where the worst of its elements gains most.

    Args:
        nodes: Of the mesh, (n, 3); changed.
        node: Which.
        star: Its elements, (k, 4).
        neighbours: Their other nodes, (j,).
    """
    here, start, place = nodes[node], np.empty(3), np.empty(3)
    ways = np.empty((2, 3))
    for _ in range(_MOVES):
        best, worst = _least_quality(nodes, star)
        _uprighting(nodes, star[worst], node, ways[1])
        for axis in range(3):
            start[axis] = place[axis] = here[axis]
            ways[0, axis] = -here[axis]
            for i in neighbours:
                ways[0, axis] += nodes[i, axis] / len(neighbours)
        moved = False
        for part in _PARTS:
            for way in ways:
                for axis in range(3):
                    here[axis] = start[axis] + part * way[axis]
                quality, _ = _least_quality(nodes, star)
                if quality > best:
                    best, moved = quality, True
                    for axis in range(3):
                        place[axis] = here[axis]
        for axis in range(3):
            here[axis] = place[axis]
        if not moved:
            break


@numba.njit(cache=True, error_model="numpy")
def _least_quality(nodes, star):
    """Least mean-ratio quality, as `TetMesh.quality`, and whose."""
    least, worst = np.inf, 0
    normal = np.empty(3)
    for k in range(len(star)):
        tet = star[k]
        l2, v = 0.0, 0.0
        _area(nodes, tet, normal)
        for axis in range(3):
            for a in range(4):
                for b in range(a):
                    l2 += (nodes[tet[a], axis] - nodes[tet[b], axis]) ** 2
            up = nodes[tet[3], axis] - nodes[tet[0], axis]
            v += normal[axis] * up / 3.0
        quality = 12.0 * np.sign(v) * (3.0 * abs(v)) ** (2 / 3) / l2
        if quality < least or quality != quality:  # once NaN, always NaN
            least, worst = quality, k
    return least, worst


@numba.njit(cache=True, error_model="numpy")
def _uprighting(nodes, tet, node, out):
    """Move of one of a tet's nodes that adds volume, half its extent long."""
    a = 0
    while tet[a] != node:
        a += 1
    _area(nodes, tet[FACES[a]], out)
    extent, area = 0.0, 0.0
    for axis in range(3):
        least, most = np.inf, -np.inf
        for i in tet:
            least = min(least, nodes[i, axis])
            most = max(most, nodes[i, axis])
        extent += (most - least) ** 2
        area += out[axis] ** 2
    for axis in range(3):
        out[axis] *= -0.5 * np.sqrt(extent / area)


@numba.njit(cache=True)
def _area(nodes, face, out):
    """Area vector of a face's first three nodes, into out (3,)."""
    i, j, k = face[0], face[1], face[2]
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        au, av = nodes[j, u] - nodes[i, u], nodes[j, v] - nodes[i, v]
        bu, bv = nodes[k, u] - nodes[i, u], nodes[k, v] - nodes[i, v]
        out[axis] = 0.5 * (au * bv - av * bu)
