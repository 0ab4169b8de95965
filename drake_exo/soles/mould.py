"""A block with the sole as its cavity, open at the glued surface, as STL.

Radial deformations keep the directions of the glued outline from the sole
frame's origin: the ring between it and the block's edge is filled by going
round both.
"""

from pathlib import Path

import numpy as np

from drake_exo.soles.mesh import TetMesh, write_triangles

WALL = 0.01  # metres around and below the sole


def mould_triangles(mesh: TetMesh, wall: float = WALL) -> np.ndarray:
    """Outward triangles of the mould's closed surface [m], (f, 3, 3).

    Args:
        mesh: The sole.
        wall: Least thickness around and below it [m].
    """
    low, high = mesh.nodes.min(axis=0) - wall, mesh.nodes.max(axis=0) + wall
    top = mesh.nodes[mesh.dirichlet, 2].mean()
    corners = np.array(
        [
            [low[0], low[1]],
            [high[0], low[1]],
            [high[0], high[1]],
            [low[0], high[1]],
        ]
    )
    rim = mesh.nodes[_rim(mesh)]
    block = np.column_stack([corners, np.full(4, top)])
    floor = np.column_stack([corners, np.full(4, low[2])])
    sides = []
    for k in range(4):
        a, b, c, d = floor[k], floor[k - 3], block[k - 3], block[k]
        sides += [[a, b, c], [a, c, d]]
    sides += [[floor[0], floor[2], floor[1]], [floor[0], floor[3], floor[2]]]
    cavity = mesh.nodes[mesh.contact_faces[:, [0, 2, 1]]]
    return np.concatenate([np.array(sides), _ring(block, rim), cavity])


def write_mould(path: Path | str, mesh: TetMesh, wall: float = WALL) -> bool:
    """Write the mould as binary STL in millimetres.

    Returns:
        False, and no file, where the glued outline turns back on its way
        round the origin.
    """
    if not has_star_outline(mesh):
        return False
    triangles = mould_triangles(mesh, wall)
    write_triangles(path, triangles, "mould of a sole, millimetres")
    return True


def _rim(mesh: TetMesh) -> np.ndarray:
    """Nodes around the glued surface, counter-clockwise from above."""
    glued = np.isin(mesh.boundary_faces, mesh.dirichlet).all(axis=1)
    faces = mesh.boundary_faces[glued]
    edges = np.concatenate(
        [faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]
    )
    there = {tuple(e) for e in edges.tolist()}
    after = {a: b for a, b in there if (b, a) not in there}
    first = min(after)
    ring = [first]
    while after[ring[-1]] != first:
        ring.append(after[ring[-1]])
    return np.array(ring)


def _ring(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Upward triangles between two loops around the origin's vertical."""
    outer, inner = (
        np.roll(p, -int(np.argmin(_angle(p))), axis=0) for p in (outer, inner)
    )
    angles = [
        np.append(_angle(p), 2 * np.pi + _angle(p[:1])) for p in (outer, inner)
    ]
    i = j = 0
    triangles = []
    while i < len(outer) or j < len(inner):
        a, b = outer[i % len(outer)], inner[j % len(inner)]
        ahead = j == len(inner) or (
            i < len(outer) and angles[0][i + 1] <= angles[1][j + 1]
        )
        if ahead:
            i += 1
            triangles.append([a, outer[i % len(outer)], b])
        else:
            j += 1
            triangles.append([a, inner[j % len(inner)], b])
    return np.array(triangles)


def has_star_outline(mesh: TetMesh) -> bool:
    """Whether the glued outline goes round the origin without turning back."""
    angle = _angle(mesh.nodes[_rim(mesh)])
    turn = (np.diff(np.append(angle, angle[0])) + np.pi) % (2 * np.pi) - np.pi
    return bool((turn > 0).all() and abs(turn.sum() - 2 * np.pi) < 1e-6)


def _angle(points: np.ndarray) -> np.ndarray:
    return np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
