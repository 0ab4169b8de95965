"""Closed surfaces swept along a path, for drawing bodies and devices.

Every function returns rings (n, m, 3) [m]: n closed curves of m points, the
first and last shrunk to a point or small enough to leave no visible hole.
"""

import numpy as np
from scipy.interpolate import PchipInterpolator


def superellipse(count: int, power: float) -> np.ndarray:
    """Unit superellipse (count, 2); power 2 is a circle, 8 almost a square."""
    angle = 2.0 * np.pi * np.arange(count) / count
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack(
        [np.sign(t) * np.abs(t) ** (2.0 / power) for t in (c, s)]
    )


def smooth(keys: list, count: int) -> np.ndarray:
    """Interpolate rows of numbers (n, m) by a parameter in their first column.

    Returns:
        (count, m) rows at equal steps of the parameter.
    """
    table = np.array(keys, dtype=float)
    at = np.linspace(table[0, 0], table[-1, 0], count)
    return np.column_stack(
        [at, PchipInterpolator(table[:, 0], table[:, 1:])(at)]
    )


def rounded_ends(rings: np.ndarray, roundness: float, steps: int = 5):
    """Close a tube (n, m, 3) with domes of depth roundness times radius."""

    def dome(ring: np.ndarray, inner: np.ndarray) -> np.ndarray:
        centre = ring.mean(axis=0)
        radius = np.linalg.norm(ring - centre, axis=1).mean()
        out = centre - inner.mean(axis=0)
        out *= roundness * radius / np.linalg.norm(out)
        angle = np.linspace(0.0, 0.5 * np.pi, steps + 1)[1:]
        return np.array(
            [
                centre + np.cos(a) * (ring - centre) + np.sin(a) * out
                for a in angle
            ]
        )

    first, last = dome(rings[0], rings[1]), dome(rings[-1], rings[-2])
    return np.concatenate([first[::-1], rings, last])


def tube(keys, *, count=16, around=24, power=2.0, roundness=0.3):
    """Limb along z from rows (z, x, half depth, half width)."""
    rows = smooth(keys, count)
    shape = superellipse(around, power)
    rings = np.zeros((count, around, 3))
    for ring, (z, x, depth, width) in zip(rings, rows, strict=True):
        ring[:, 0] = x + depth * shape[:, 0]
        ring[:, 1] = width * shape[:, 1]
        ring[:, 2] = z
    return rounded_ends(rings, roundness)


def loaf(keys, *, count=20, around=24, power=2.6, roundness=0.45):
    """Shoe along x from rows (x, half width, bottom z, top z)."""
    rows = smooth(keys, count)
    shape = superellipse(around, power)
    rings = np.zeros((count, around, 3))
    for ring, (x, width, low, high) in zip(rings, rows, strict=True):
        ring[:, 0] = x
        ring[:, 1] = width * shape[:, 0]
        ring[:, 2] = 0.5 * (low + high) + 0.5 * (high - low) * shape[:, 1]
    return rounded_ends(rings, roundness, 4)


def beam(
    path,
    widths,
    *,
    count=24,
    around=16,
    power=5.0,
    roundness=0.15,
    aside=(1.0, 0.0, 0.0),
):
    """Beam along a path of points (n, 3).

    Args:
        path: points the axis passes through.
        widths: two half sizes, or one pair for each point: across the path
            and across `aside`, then along `aside`.
        aside: a direction the path never runs along.
    """
    path = np.array(path, dtype=float)
    at = np.linspace(0.0, 1.0, len(path))
    fine = np.linspace(0.0, 1.0, count)
    centres = PchipInterpolator(at, path)(fine)
    half = np.broadcast_to(np.array(widths, dtype=float), (len(path), 2))
    half = PchipInterpolator(at, half)(fine)
    tangent = np.gradient(centres, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    first = np.cross(tangent, aside)
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(first, tangent)
    shape = superellipse(around, power)
    rings = (
        centres[:, None]
        + half[:, :1, None] * shape[None, :, :1] * first[:, None]
        + half[:, 1:, None] * shape[None, :, 1:] * second[:, None]
    )
    return rounded_ends(rings, roundness, 3)


def shell(keys, arc_deg, *, thickness, count=9, around=28):
    """Cuff: a thick part of a tube about z.

    Args:
        keys: rows (z, x, half depth, half width) of the inner surface.
        arc_deg: from and to, counter-clockwise from x (front) seen from above.
        thickness: of the wall [m].
    """
    rows = smooth(keys, count)
    angle = np.radians(np.linspace(*arc_deg, around))
    profile = np.concatenate([rows, rows[::-1]])
    grow = np.concatenate([np.zeros(count), np.full(count, thickness)])
    rings = np.zeros((around, 2 * count, 3))
    for ring, a in zip(rings, angle, strict=True):
        ring[:, 0] = profile[:, 1] + (profile[:, 2] + grow) * np.cos(a)
        ring[:, 1] = (profile[:, 3] + grow) * np.sin(a)
        ring[:, 2] = profile[:, 0]
    return rounded_ends(rings, 0.02, 1)


def mirrored(rings: np.ndarray) -> np.ndarray:
    """The same part on the right: y changes sign, the turning sense too."""
    return (rings * [1.0, -1.0, 1.0])[:, ::-1]


def obj_text(rings: np.ndarray) -> str:
    """A closed tube of rings (n, m, 3) as Wavefront OBJ with normals."""
    n, m, _ = rings.shape
    vertices = np.round(rings.reshape(-1, 3), 5)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(m), indexing="ij")
    a, b = i * m + j, i * m + (j + 1) % m
    quads = np.stack([a, b, b + m, a + m], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    # The dome's last ring is a point repeated: fill it with nothing.
    corners = vertices[faces]
    normal = np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    )
    keep = np.linalg.norm(normal, axis=1) > 1e-12
    faces, normal, corners = faces[keep], normal[keep], corners[keep]
    if np.einsum("ij,ij->", corners[:, 0], normal) < 0.0:  # signed volume
        faces, normal = faces[:, ::-1], -normal
    normals = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(normals, corner, normal)
    # Points that coincide share one normal, or the poles would look creased.
    _, group = np.unique(vertices, axis=0, return_inverse=True)
    shared = np.zeros((group.max() + 1, 3))
    np.add.at(shared, group.ravel(), normals)
    normals = shared[group.ravel()]
    normals /= np.linalg.norm(normals, axis=1)[:, None] + 1e-300
    # Adding 0.0 turns -0.0 into 0.0.
    lines = ["v {:.5f} {:.5f} {:.5f}".format(*v) for v in vertices + 0.0]
    normals = np.round(normals, 3) + 0.0
    lines += ["vn {:.3f} {:.3f} {:.3f}".format(*v) for v in normals]
    lines += ["f " + " ".join(f"{v}//{v}" for v in face) for face in faces + 1]
    return "\n".join(lines) + "\n"
