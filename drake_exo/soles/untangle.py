"""Poor elements made better by moving the inner nodes of their patch.

Towards the centre of its neighbours, or away from the face opposite in its
worst element, as far as that element gains most (constrained Laplacian and
optimisation-based smoothing; Freitag, AMD 220, 1997).
"""

import numpy as np

from drake_exo.soles.mesh import TetMesh

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
            _relax(mesh, nodes, node)
    return mesh.with_nodes(nodes)


def _relax(mesh: TetMesh, nodes: np.ndarray, node: int) -> None:
    """Move one node where the worst of its elements gains most."""
    star = mesh.tets[(mesh.tets == node).any(axis=1)]
    for _ in range(_MOVES):
        there = nodes[node].copy()
        around = TetMesh(nodes, star, star[0])
        quality = around.quality()
        k = int(quality.argmin())
        best, place = quality[k], there
        centre = nodes[np.setdiff1d(star, node)].mean(axis=0) - there
        away = around.gradients[k][star[k] == node][0]  # from the face opposite
        size = np.linalg.norm(np.ptp(nodes[star[k]], axis=0))
        away *= 0.5 * size / np.linalg.norm(away)
        for part in _PARTS:
            for way in (centre, away):
                nodes[node] = there + part * way
                worst = TetMesh(nodes, star, star[0]).quality().min()
                if worst > best:
                    best, place = worst, nodes[node].copy()
        nodes[node] = place
        if place is there:
            break
