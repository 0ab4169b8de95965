"""Shaded views of a surface, drawn as polygons in the plane.

Orthographic: faces that look away are dropped, the others painted from far
to near. Every view has the same scale, in millimetres.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.collections import PolyCollection
from scipy.spatial import ConvexHull

# Faces that meet at less are shaded as one smooth surface.
_CREASE = np.cos(np.deg2rad(40.0))
_AMBIENT, _DIFFUSE = 0.4, 0.65
_LIGHT = np.array([-0.4, -0.2, 0.894])  # right, up, towards the viewer


@dataclass(frozen=True)
class View:
    """Where from a sole is seen; x forward, y left, z up.

    Attributes:
        name: Title.
        toward: From the sole to the viewer.
        up: What is up in the picture.
    """

    name: str
    toward: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def axes(self) -> np.ndarray:
        """Rows: right, up and towards the viewer, (3, 3)."""
        toward = np.array(self.toward) / np.linalg.norm(self.toward)
        right = np.cross(self.up, toward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(toward, right), toward])


VIEWS = (
    View("from below", (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    View("left side", (0.0, 1.0, 0.0)),
    View("back", (-1.0, 0.0, 0.0)),
    View("from below, back left", (-1.0, 0.9, -0.8)),
)


@dataclass(frozen=True)
class Surface:
    """Triangles with colours and smooth normals, ready for any view.

    Attributes:
        corners: (f, 3, 3) [mm].
        normals: Unit normals at the corners, (f, 3, 3).
        colours: At the corners, RGB, (f, 3, 3).
    """

    corners: np.ndarray
    normals: np.ndarray
    colours: np.ndarray

    def refined(self) -> "Surface":
        """Every triangle cut into four."""
        cut = [_cut(a) for a in (self.corners, self.normals, self.colours)]
        cut[1] /= np.linalg.norm(cut[1], axis=2, keepdims=True)
        return Surface(*cut)


def _cut(a: np.ndarray) -> np.ndarray:
    p, q, r = a[:, 0], a[:, 1], a[:, 2]
    pq, qr, rp = 0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + p)
    parts = [(p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def surface(
    nodes: np.ndarray, faces: np.ndarray, colours: np.ndarray
) -> Surface:
    """A surface with normals smoothed but for creases.

    Args:
        nodes: (n, 3) [m].
        faces: Outward triangles, (f, 3).
        colours: RGB of the nodes, (n, 3).
    """
    corners = 1e3 * nodes[faces]
    across = np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    )
    flat = across / np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.empty_like(corners)
    order = np.argsort(faces.ravel(), kind="stable")
    ends = np.searchsorted(faces.ravel()[order], np.arange(len(nodes) + 1))
    for node in range(len(nodes)):
        mine = order[ends[node] : ends[node + 1]]
        around = mine // 3
        smooth = flat[around] @ flat[around].T > _CREASE
        normals.reshape(-1, 3)[mine] = smooth @ across[around]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Surface(corners, normals, colours[faces])


def draw(axis, shape: Surface, view: View) -> None:
    """Paint a surface into an axis of equal aspect."""
    frame = view.axes()
    seen = shape.corners @ frame.T
    edge = seen[:, 1:, :2] - seen[:, :1, :2]
    facing = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0] > 0
    seen = seen[facing]
    order = np.argsort(seen[:, :, 2].mean(axis=1), kind="stable")
    light = frame.T @ _LIGHT
    normal = shape.normals[facing].mean(axis=1)
    lit = _AMBIENT + _DIFFUSE * np.clip(normal @ light, 0.0, 1.0)
    colour = shape.colours[facing].mean(axis=1) * lit[:, None]
    colour = np.clip(colour, 0.0, 1.0)[order]
    axis.add_collection(
        PolyCollection(
            seen[order][:, :, :2],
            facecolors=colour,
            edgecolors=colour,
            linewidths=0.3,
            rasterized=True,
        )
    )


def outline(axis, nodes: np.ndarray, view: View) -> None:
    """Dashed silhouette of the convex hull of nodes [m]."""
    flat = 1e3 * nodes @ view.axes()[:2].T
    ring = flat[ConvexHull(flat).vertices]
    ring = np.concatenate([ring, ring[:1]])
    axis.plot(*ring.T, color="0.25", lw=0.8, ls=(0, (4, 3)))


def extent(nodes: np.ndarray, view: View) -> np.ndarray:
    """Lower and upper corner of nodes [m] in a view [mm], (2, 2)."""
    flat = 1e3 * nodes @ view.axes()[:2].T
    return np.stack([flat.min(axis=0), flat.max(axis=0)])
