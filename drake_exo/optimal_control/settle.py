"""A start from which nothing springs: the foot where its contact carries it.

Measured feet are off by millimetres, which is kilonewtons on stiff spheres.
Before a solve the foot is lowered, tilted and made to creep at each node, so
that the contact law gives the ground reaction that the movement needs.
"""

import numpy as np

from drake_exo.forces.hunt_crossley import hertz_factor
from drake_exo.optimal_control.kernels import (
    SPHERE_PARAMETERS,
    FootGroundKernel,
)

# Columns of the kernel's inputs: z, pitch, and velocity along x of the foot.
_UNKNOWNS = [1, 2, 3]
_SLIP = [3]
_LARGEST_STEP = np.array([np.inf, 2e-3, 0.02, 0.02])
_PASSES = 2
_NEWTON_STEPS = 12
_SETTLED = 1e-3  # of the kernel's units: it is only a guess


def settle_foot(
    kernel: FootGroundKernel,
    parameters: np.ndarray,
    times: np.ndarray,
    foot: np.ndarray,
    ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Foot motion whose contact forces are the given ones.

    Args:
        kernel: the contact law.
        parameters: its parameters, in the kernel's order.
        times: (n,) [s].
        foot: (n, 3) x, z, pitch of the foot as measured [m, rad].
        ground: (n, 3) F_x, F_z, M_y about the laboratory origin.

    Returns:
        Foot positions (n, 3) and velocities (n, 3). Where the law cannot
        give the force (lifted foot, more than friction holds), the nearest
        found is returned: it is only a guess.
    """
    n = len(times)
    q, v = foot.copy(), np.zeros((n, 3))
    q[:, 1:] = _two_spheres(kernel, parameters, foot[:, 0], ground)
    for _ in range(_PASSES):
        x = np.hstack(
            [q, v, ground, np.broadcast_to(parameters, (n, len(parameters)))]
        )
        _newton(kernel, x, _UNKNOWNS)
        q[:, 1:3] = x[:, 1:3]
        v[:, 0] = x[:, 3]
        creep = np.r_[0.0, np.cumsum(np.diff(times) * v[1:, 0])]
        # The drift is kept about the measured place.
        q[:, 0] = foot[:, 0].mean() + creep - creep.mean()
    # Sinking and tilting are slow: their damping is left to the solver, as
    # iterating on differentiated rates need not converge.
    v[:, 1:] = np.gradient(q[:, 1:], times, axis=0)
    x[:, :6] = np.hstack([q, v])
    _newton(kernel, x, _SLIP)
    v[:, 0] = x[:, 3]
    return q, v


def _two_spheres(kernel, parameters, x, ground):
    """Height and pitch (n, 2) at which Hertz' law alone carries the load."""
    count = len(SPHERE_PARAMETERS)
    k, _, px, pz, r = parameters[: 2 * count].reshape(2, count).T
    heel, toe = np.argsort(px)
    center = -ground[:, 2] / ground[:, 1] - x
    share = np.clip((center - px[heel]) / (px[toe] - px[heel]), 0.03, 0.97)
    heights = {}
    for sphere, part in ((heel, 1.0 - share), (toe, share)):
        load = np.maximum(part * ground[:, 1], 1.0)
        stiffness = hertz_factor(kernel.law, k[sphere], r[sphere])
        heights[sphere] = r[sphere] - (load / stiffness) ** (2.0 / 3.0)
    dx, dz = px[toe] - px[heel], pz[toe] - pz[heel]
    rise = (heights[toe] - heights[heel]) / np.hypot(dx, dz)
    pitch = np.arcsin(np.clip(rise, -0.5, 0.5)) - np.arctan2(dz, dx)
    z = heights[heel] - np.sin(pitch) * px[heel] - np.cos(pitch) * pz[heel]
    return np.column_stack([z, pitch])


def _newton(kernel, x, unknowns):
    """Solve for the unknowns of every node at once, in place.

    With one unknown only the friction is solved for.
    """
    rows = len(unknowns)
    largest = _LARGEST_STEP[unknowns]
    r = kernel.evaluate(x, None)[:, :rows]
    for _ in range(_NEWTON_STEPS):
        J = kernel.jacobian(x, None)[:, :rows, unknowns]
        J = J + 1e-9 * np.eye(rows)
        step = -np.linalg.solve(J, r[:, :, None])[:, :, 0]
        excess = np.max(np.abs(step) / largest, axis=1)
        step /= np.maximum(excess, 1.0)[:, None]
        size = np.linalg.norm(r, axis=1)
        for _ in range(6):
            trial = x.copy()
            trial[:, unknowns] += step
            r_trial = kernel.evaluate(trial, None)[:, :rows]
            worse = np.linalg.norm(r_trial, axis=1) > size
            if not worse.any():
                break
            step[worse] *= 0.5
        better = np.linalg.norm(r_trial, axis=1) <= size
        x[better] = trial[better]
        r[better] = r_trial[better]
        if np.abs(r).max() < _SETTLED:
            return
