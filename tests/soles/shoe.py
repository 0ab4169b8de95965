"""The surface of a shoe's sole: outline of a foot, an arch, 15 to 30 mm.

`python tests/soles/shoe.py FILE.stl` writes it, in millimetres.
"""

import sys

import numpy as np

from drake_exo.soles.mesh import write_triangles

LENGTH = 0.27
_ALONG = [0, 0.1, 0.25, 0.45, 0.65, 0.8, 0.92, 1]
_HALF_WIDTH = [0.026, 0.031, 0.033, 0.03, 0.043, 0.046, 0.038, 0.024]
_THICK = ([0, 0.15, 0.4, 0.55, 0.75, 1], [28, 30, 24, 18, 17, 15])


def shoe_surface(along: int = 90, across: int = 14) -> np.ndarray:
    """Outward triangles [m], origin in the top's middle, (t, 3, 3)."""
    s = 0.5 * (1 - np.cos(np.pi * np.linspace(0, 1, along)))
    ends = np.sqrt(np.clip(1 - (2 * s - 1) ** 8, 0, 1))
    width = ends * np.interp(s, _ALONG, _HALF_WIDTH)
    middle = 0.008 * np.sin(2 * np.pi * (s - 0.1)) * (s > 0.1)
    thick = 1e-3 * np.interp(s, *_THICK)
    arch = 0.006 * np.exp(-(((s - 0.45) / 0.12) ** 2))
    y = np.linspace(-1, 1, across)
    top, bottom = np.zeros((2, along, across, 3))
    top[..., 0] = bottom[..., 0] = (s[:, None] - 0.5) * LENGTH
    top[..., 1] = middle[:, None] + width[:, None] * y
    bottom[..., 1] = middle[:, None] + 0.94 * width[:, None] * y
    own = 0.5 * (top[..., 1].min() + top[..., 1].max())
    top[..., 1] -= own
    bottom[..., 1] -= own
    bottom[..., 2] = -thick[:, None] + arch[:, None] * (1 - y) / 2

    def quads(grid):
        a, b = grid[:-1, :-1], grid[1:, :-1]
        c, d = grid[1:, 1:], grid[:-1, 1:]
        parts = [np.stack([a, b, c], 2), np.stack([a, c, d], 2)]
        return np.concatenate([p.reshape(-1, 3, 3) for p in parts])

    def wall(upper, lower):
        return quads(np.stack([lower, upper], axis=1))

    faces = np.concatenate(
        [
            quads(top),
            quads(bottom[:, ::-1]),
            wall(top[:, 0], bottom[:, 0]),
            wall(top[::-1, -1], bottom[::-1, -1]),
            wall(top[0, ::-1], bottom[0, ::-1]),
            wall(top[-1], bottom[-1]),
        ]
    )
    a, b, c = np.swapaxes(faces, 0, 1)
    return faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-15]


if __name__ == "__main__":
    write_triangles(sys.argv[1], shoe_surface())
