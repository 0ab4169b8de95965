"""What stands between bones and marker positions."""

import numpy as np

from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import COUPLED_COORDINATES
from drake_exo.virtual_laboratory.marker_set import Marker

NOISE_M = 3e-4
# Spread of how far skin slides for each radian of the joint nearby [m/rad].
_SLIDE = {"foot": 0.0, "shank": 0.004, "thigh": 0.006, "pelvis": 0.004}
_JOINT = {"foot": "ankle", "shank": "knee", "thigh": "knee", "pelvis": "hip"}
_GAPS = 6
_GAP_FRAMES = (4, 13)


def slides(markers: dict[str, Marker], rng: np.random.Generator) -> np.ndarray:
    """How each marker slides (M, 2) along x and z of its link [m/rad]."""
    spread = np.array([_SLIDE[m.body] for m in markers.values()])
    return spread[:, None] * rng.normal(size=(len(markers), 2))


def soft_tissue(
    tree: PlanarTree,
    q: np.ndarray,
    markers: dict[str, Marker],
    slide: np.ndarray,
) -> np.ndarray:
    """Displacement (N, M, 3) by sliding skin in OpenSim's axes [m].

    In proportion to the flexion of the joint nearby, so that there is next
    to none in standing, where markers are placed.
    """
    moved = np.zeros((len(q), len(markers), 3))
    for i, marker in enumerate(markers.values()):
        flexion = q[:, COUPLED_COORDINATES.index(_JOINT[marker.body])]
        turn = np.exp(1j * tree.body_angles(q, marker.body))
        p = flexion * turn * complex(*slide[i])
        moved[:, i, 0], moved[:, i, 1] = p.real, p.imag
    return moved


def hide(positions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same positions (N, M, 3) with a few short gaps (NaN)."""
    n, m = positions.shape[:2]
    seen = positions.copy()
    for marker in rng.choice(m, _GAPS, replace=False):
        length = int(rng.integers(*_GAP_FRAMES))
        first = int(rng.integers(1, n - length - 1))
        seen[first : first + length, marker] = np.nan
    return seen
