"""Starts of feet that roll, lift and come down again.

As `initial_guess.settle_foot`, for feet that are not flat all the time: pitch
stays near what was measured, since heel strike and push-off stand on one end
of the sole; the height is what gives the measured force at that pitch; where
the foot bears nothing it is carried clear of the ground.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from drake_exo.collocation.initial_guess import (
    bisected,
    slip_velocity,
    static_force,
    sunk,
)
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.hunt_crossley import contact_arm
from drake_exo.contact.parameters import SPHERE_PARAMETERS

_LOADED_N = 5.0
_PITCH_RAD = 0.1  # that the settled foot may turn from the measured one
_SMOOTH_S = 0.02  # of that turn
_FADE_S = 0.1  # of offsets, while the foot is in the air
_CLEAR_M = 0.005  # of a foot that bears nothing
_CLEARANCE, _PITCHES = 0.3, 20
_RADIUS = SPHERE_PARAMETERS.index("radius")


def settle_rolling(
    kernel: FootGroundKernel,
    spheres: np.ndarray,
    places: np.ndarray,
    times: np.ndarray,
    foot: np.ndarray,
    ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of a foot whose contact forces are near the given ones.

    Args:
        kernel: the law.
        spheres: parameters (m, 5) of all spheres under the foot.
        places: (n, m, 2) their centres in the foot; those of hinged toes move.
        times: (n,) [s].
        foot: (n, 3) x, z, pitch as measured [m, rad].
        ground: (n, 3) F_x, F_z, M_y about the laboratory origin.

    Returns:
        Positions (n, 3) and velocities (n, 3) of the foot.
    """
    loaded = ground[:, 1] > _LOADED_N
    q = foot.astype(float)
    if loaded.any():
        off = np.zeros(len(times))
        off[loaded] = _pitches(kernel, spheres, places, q, ground, loaded)
        off = _bridged(off, loaded, times)
        width = _SMOOTH_S / (times[1] - times[0])
        q[:, 2] += gaussian_filter1d(off, width, mode="nearest")
        height = q[:, 1].copy()
        height[loaded] = _heights(
            kernel,
            spheres,
            places[loaded],
            q[loaded, 2],
            ground[loaded, 1],
        )[0]
        q[:, 1] += _bridged(height - q[:, 1], loaded, times)
    _, below = _reach(places, q[:, 2])
    lowest = (q[:, 1, None] + below - spheres[:, _RADIUS]).min(axis=1)
    q[~loaded, 1] += np.maximum(_CLEAR_M - lowest[~loaded], 0.0)
    v = np.gradient(q, times, axis=0)
    for start, end in _runs(loaded):
        _creep(kernel, spheres, places, times, q, v, ground, slice(start, end))
    q[:, 0] = foot[:, 0] + _bridged(q[:, 0] - foot[:, 0], loaded, times)
    v[~loaded] = np.gradient(q, times, axis=0)[~loaded]
    return q, v


def _reach(places, pitch):
    """How far (n, m) centres are before and above the foot's origin [m]."""
    c, s = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    x, z = places[..., 0], places[..., 1]
    return c * x - s * z, s * x + c * z


def _heights(kernel, spheres, places, pitch, force):
    """Height (n,) of the foot that gives a force, and forces (n, m)."""
    _, up = _reach(places, pitch)
    below = spheres[:, _RADIUS] - up
    height, depths = sunk(kernel, spheres, below, force, _CLEARANCE)
    return height, static_force(kernel, spheres, depths)


def _pitches(kernel, spheres, places, q, ground, loaded):
    """Turn (k,) of the loaded foot that moves its load under the force."""
    places, at, w = places[loaded], q[loaded], ground[loaded]
    centre = -w[:, 2] / w[:, 1] - at[:, 0]

    def behind(turn):
        """Toes up, and the force goes back."""
        pitch = at[:, 2] + turn
        ahead, _ = _reach(places, pitch)
        _, force = _heights(kernel, spheres, places, pitch, w[:, 1])
        return centre - np.sum(force * ahead, axis=1) / force.sum(axis=1)

    turn = bisected(behind, -_PITCH_RAD, _PITCH_RAD, centre.shape, _PITCHES)
    # On one end of the sole no turn brings the load there.
    return np.where(np.abs(turn) < 0.99 * _PITCH_RAD, turn, 0.0)


def _creep(kernel, spheres, places, times, q, v, ground, rows) -> None:
    """Let a loaded foot slip so that friction gives F_x, in place."""
    if rows.stop - rows.start < 2:
        return
    _, up = _reach(places[rows], q[rows, 2])
    depths = spheres[:, _RADIUS] - up - q[rows, 1, None]
    force = static_force(kernel, spheres, depths)
    total = np.maximum(force.sum(axis=1), 1e-9)
    radius = spheres[:, _RADIUS]
    points = radius - depths - contact_arm(kernel.law, depths, radius)
    height = np.sum(force * points, axis=1) / total
    slip = slip_velocity(kernel, spheres, force, ground[rows, 0])
    v[rows, 0] = slip - (q[rows, 1] - height) * v[rows, 2]
    t = times[rows]
    steps = 0.5 * np.diff(t) * (v[rows][1:, 0] + v[rows][:-1, 0])
    path = np.r_[0.0, np.cumsum(steps)]
    # Kept about the measured place, most of all where it bears most.
    weight = ground[rows, 1]
    q[rows, 0] = path + np.average(q[rows, 0] - path, weights=weight)


def _bridged(off, loaded, times):
    """Offsets (n,) of loaded samples, fading over the others."""
    if loaded.all() or not loaded.any():
        return off
    index = np.arange(len(off))
    known = index[loaded]
    after = np.clip(np.searchsorted(known, index), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(index - known[after]) < np.abs(index - known[before])
    nearest = np.where(nearer, known[after], known[before])
    far = (times - times[nearest]) / _FADE_S
    return np.where(loaded, off, off[nearest] * np.exp(-(far**2)))


def _runs(mask) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.r_[0, mask.astype(int), 0]))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
