"""A start from which nothing springs: the foot where its contact carries it.

Measured feet are off by millimetres, which is kilonewtons on stiff spheres.
Before a solve the foot is lowered, tilted and made to creep at each node, so
that the contact law gives the ground reaction that was measured. The force on
each sphere follows from statics, and the law is monotone in the indentation
and in the slip velocity, so both are found by bisection: nothing can diverge.
"""

import numpy as np

from drake_exo.collocation.kernels import SPHERE_PARAMETERS, FootGroundKernel
from drake_exo.contact.hunt_crossley import contact_arm, sphere_force

# Each sphere bears at least this share, so that the foot stays on both.
_LEAST_SHARE = 0.02
_LEAST_FORCE = 1.0  # N, on each sphere
# Brackets: clearance and indentation [m], slip velocity [m/s].
_CLEARANCE = 0.05
_DEEPEST = 0.2
_FASTEST = 0.2
_BISECTIONS = 45
_LARGEST_SLOPE = 0.5  # sine of the foot's tilt
_PASSES = 3


def settle_foot(
    kernel: FootGroundKernel,
    parameters: np.ndarray,
    times: np.ndarray,
    foot: np.ndarray,
    ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Foot motion whose contact forces are the given ones.

    Sinking is taken as slow: the dissipative part of the force is left out.

    Args:
        kernel: the contact law, of two spheres.
        parameters: its parameters, in the kernel's order.
        times: (n,) [s].
        foot: (n, 3) x, z, pitch of the foot as measured [m, rad].
        ground: (n, 3) F_x, F_z, M_y about the laboratory origin.

    Returns:
        Foot positions (n, 3) and velocities (n, 3). Where the law cannot
        give the force (centre of pressure off the foot, more than friction
        holds), the nearest is returned: it is only a guess.
    """
    count = len(SPHERE_PARAMETERS)
    spheres = np.asarray(parameters[: 2 * count], float).reshape(2, count)
    spheres = spheres[np.argsort(spheres[:, 2])]
    q = foot.astype(float)
    drift, height = np.zeros(len(times)), np.zeros(len(times))
    for _ in range(_PASSES):
        # The drift is kept about the measured place.
        q[:, 0] = foot[:, 0].mean() + drift - drift.mean()
        loads = _loads(spheres, q, ground, height)
        depths = _depths(kernel, spheres, loads)
        q[:, 1:] = _pose(spheres, depths)
        height = _height(kernel.law, spheres, loads, depths)
        slip = _slip(kernel, spheres, loads, ground[:, 0])
        v = np.gradient(q, times, axis=0)
        v[:, 0] = slip - (q[:, 1] - height) * v[:, 2]
        steps = 0.5 * np.diff(times) * (v[1:, 0] + v[:-1, 0])
        drift = np.r_[0.0, np.cumsum(steps)]
    return q, v


def _loads(spheres, q, ground, height):
    """Normal force (n, 2) on heel and toe that F_z and M_y ask for [N].

    Args:
        spheres: parameters (2, 5), heel first.
        q: (n, 3) of the foot.
        ground: (n, 3) reaction.
        height: (n,) of the point where it acts [m].
    """
    sine, cosine = np.sin(q[:, 2]), np.cos(q[:, 2])
    x = q[:, :1] + np.outer(cosine, spheres[:, 2])
    x -= np.outer(sine, spheres[:, 3])
    total = np.maximum(ground[:, 1], 2.0 * _LEAST_FORCE)
    center = (height * ground[:, 0] - ground[:, 2]) / total
    share = (center - x[:, 0]) / (x[:, 1] - x[:, 0])
    share = np.clip(share, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
    loads = total[:, None] * np.column_stack([1.0 - share, share])
    return np.maximum(loads, _LEAST_FORCE)


def _depths(kernel, spheres, loads):
    """Indentations (n, 2) that carry the loads [m]."""

    def excess(depth):
        force, _ = sphere_force(
            kernel.law,
            depth,
            0.0,
            0.0,
            spheres[:, 0],
            spheres[:, 1],
            spheres[:, 4],
            kernel.constants,
        )
        return force - loads

    return _root(excess, -_CLEARANCE, _DEEPEST, loads.shape)


def _height(law, spheres, loads, depths):
    """Mean height (n,) of the contact points, weighted by load [m]."""
    r = spheres[:, 4]
    points = r - depths - contact_arm(law, depths, r)
    return np.sum(loads * points, axis=1) / np.sum(loads, axis=1)


def _slip(kernel, spheres, loads, force_x):
    """Slip velocity (n,) at which friction gives F_x [m/s]."""

    def excess(slip):
        # Friction is proportional to the normal force: one sphere's will do.
        normal, friction = sphere_force(
            kernel.law,
            0.01,
            0.0,
            slip,
            spheres[0, 0],
            spheres[0, 1],
            spheres[0, 4],
            kernel.constants,
        )
        return force_x - loads.sum(axis=1) * friction / normal

    return _root(excess, -_FASTEST, _FASTEST, force_x.shape)


def _root(increasing, lower, upper, shape):
    """Bisection for all entries at once; an end where there is no root."""
    low, high = np.full(shape, lower), np.full(shape, upper)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        above = increasing(middle) > 0.0
        high = np.where(above, middle, high)
        low = np.where(above, low, middle)
    return 0.5 * (low + high)


def _pose(spheres, depths):
    """Height and pitch (n, 2) of the foot at given indentations."""
    (px, pz), r = spheres[:, 2:4].T, spheres[:, 4]
    heights = r - depths
    dx, dz = np.diff(px)[0], np.diff(pz)[0]
    rise = np.diff(heights, axis=1)[:, 0] / np.hypot(dx, dz)
    pitch = np.arcsin(np.clip(rise, -_LARGEST_SLOPE, _LARGEST_SLOPE))
    pitch -= np.arctan2(dz, dx)
    z = heights[:, 0] - np.sin(pitch) * px[0] - np.cos(pitch) * pz[0]
    return np.column_stack([z, pitch])
