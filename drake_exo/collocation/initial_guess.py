"""Initial guesses: feet settled onto the measured forces; a straight line.

Measured feet are off by millimetres, which means kilonewtons on stiff spheres.
Before a solve the foot is lowered, tilted and made to creep at each node, so
that the contact law gives the measured ground reaction (`settle_foot`). Statics
gives the force on each sphere. The law is monotone in the indentation and in
the slip velocity, so both are found by bisection, which cannot diverge.

Feet of two legs roll, lift and come down again (`settle_rolling`). Their pitch
stays near the measured one, since at heel strike and push-off a foot stands on
one end of the sole; their height is the one that gives the measured force at
that pitch; in the air they are kept clear of the ground.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import distance_transform_edt, gaussian_filter1d

from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.hunt_crossley import contact_arm, sphere_force
from drake_exo.contact.parameters import SPHERE_PARAMETERS
from drake_exo.files.tables import runs
from drake_exo.measurement.filters import minimum_jerk
from drake_exo.measurement.sagittal import PlanarWrench, centre_of_pressure
from drake_exo.measurement.trial import Trial

# Each sphere bears at least this share, so that both touch the ground.
_LEAST_SHARE = 0.02
_LEAST_FORCE = 1.0  # N, on each sphere
# Brackets: clearance and indentation [m], slip velocity [m/s].
_CLEARANCE = 0.05
_DEEPEST = 0.2
_FASTEST = 0.2
_BISECTIONS, _STRAIGHT = 24, 6  # steps; the last ones by false position
_TILTS = 30  # bisections of the pitch, for more than two spheres
_LARGEST_SLOPE = 0.5  # sine of the foot's tilt
_PASSES = 3
_X, _Z, _RADIUS = (SPHERE_PARAMETERS.index(k) for k in ("x", "z", "radius"))
_PLACE = [_X, _Z]


def settle_foot(
    kernel: FootGroundKernel,
    parameters: np.ndarray,
    times: np.ndarray,
    foot: np.ndarray,
    ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of a standing foot whose contact forces are the given ones.

    Sinking is taken as slow: the dissipative part of the force is left out.
    Statics shares the force between two spheres; if there are more, they give
    it together, with the same centre of pressure.

    Args:
        kernel: the contact law, of two spheres or more.
        parameters: its parameters, in the kernel's order.
        times: (n,) [s].
        foot: (n, 3) x, z, pitch of the foot as measured [m, rad].
        ground: (n, 3) F_x, F_z, M_y about the laboratory origin.

    Returns:
        Foot positions (n, 3) and velocities (n, 3). If the law cannot give the
        force (centre of pressure off the foot, beyond friction), the nearest
        that it can is taken: it is only a guess.
    """
    spheres = np.asarray(parameters, float)
    spheres = spheres.reshape(kernel.num_spheres, len(SPHERE_PARAMETERS))
    spheres = spheres[np.argsort(spheres[:, _X])]
    ends = spheres[[0, -1]]
    q = foot.astype(float)
    drift, height = np.zeros(len(times)), np.zeros(len(times))
    for _ in range(_PASSES):
        # The mean place stays the measured one.
        q[:, 0] = foot[:, 0].mean() + drift - drift.mean()
        loads = _loads(ends, q, ground, height)
        if len(spheres) == 2:
            q[:, 1:], depths = _apart(kernel, ends, loads)
        else:
            q[:, 1:], loads, depths = _together(kernel, spheres, q, loads)
        height = _height(kernel.law, spheres, loads, depths)
        slip = slip_velocity(kernel, spheres, loads, ground[:, 0])
        v = np.gradient(q, times, axis=0)
        v[:, 0] = slip - (q[:, 1] - height) * v[:, 2]
        drift = cumulative_trapezoid(v[:, 0], times, initial=0.0)
    return q, v


def straight_line(trial: Trial, times: np.ndarray) -> Trial:
    """Minimum-jerk line between a trial's end positions.

    Args:
        trial: only its first and last positions are used.
        times: (n,) from 0 [s].
    """
    start, change = trial.q[0], trial.q[-1] - trial.q[0]
    T = times[-1]
    p, dp, ddp = (x[:, None] for x in minimum_jerk(times / T))
    return Trial(
        trial.name,
        trial.coordinates,
        times,
        start + p * change,
        dp * change / T,
        ddp * change / T**2,
        PlanarWrench.of(np.zeros((len(times), 3))),
        source="solved",
    )


def _loads(spheres, q, ground, height):
    """Normal force (n, 2) on heel and toe that balances F_z and M_y [N].

    Args:
        spheres: parameters (2, 5), heel first.
        q: (n, 3) of the foot.
        ground: (n, 3) reaction.
        height: (n,) height of the point where it acts [m].
    """
    x = q[:, :1] + _reach(spheres[:, _PLACE], q[:, 2])[0]
    total = np.maximum(ground[:, 1], 2.0 * _LEAST_FORCE)
    center = centre_of_pressure(ground[:, 0], total, ground[:, 2], height)
    share = (center - x[:, 0]) / (x[:, 1] - x[:, 0])
    share = np.clip(share, _LEAST_SHARE, 1.0 - _LEAST_SHARE)
    loads = total[:, None] * np.column_stack([1.0 - share, share])
    return np.maximum(loads, _LEAST_FORCE)


def _reach(places, pitch):
    """Centres of spheres ahead of and above the foot's origin, (2, n, m) [m].

    Args:
        places: (m, 2) in the foot frame, or (n, m, 2) [m].
        pitch: (n,) of the foot [rad].
    """
    c, s = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    x, z = places[..., 0], places[..., 1]
    return np.stack([c * x - s * z, s * x + c * z])


def _apart(kernel, spheres, loads):
    """Pose of the foot at which each of two spheres bears its load.

    Returns:
        Height and pitch (n, 2), indentations (n, 2).
    """

    def excess(depth):
        return static_force(kernel, spheres, depth) - loads

    depths = bisected(excess, -_CLEARANCE, _DEEPEST, loads.shape)
    _, _, px, pz, r = spheres.T
    heights = r - depths
    dx, dz = np.diff(px)[0], np.diff(pz)[0]
    rise = np.diff(heights, axis=1)[:, 0] / np.hypot(dx, dz)
    pitch = np.arcsin(np.clip(rise, -_LARGEST_SLOPE, _LARGEST_SLOPE))
    pitch -= np.arctan2(dz, dx)
    z = heights[:, 0] - np.sin(pitch) * px[0] - np.cos(pitch) * pz[0]
    return np.column_stack([z, pitch]), depths


def _height(law, spheres, loads, depths):
    """Mean height (n,) of the contact points, weighted by load [m]."""
    r = spheres[:, _RADIUS]
    points = r - depths - contact_arm(law, depths, r)
    total = np.maximum(loads.sum(axis=1), 1e-9)
    return np.sum(loads * points, axis=1) / total


def _together(kernel, spheres, q, loads):
    """Pose at which all spheres give the force and moment of the outer two.

    At each pitch one height gives the force; the higher the toes, the further
    back its centre.

    Args:
        kernel: the law.
        spheres: parameters (m, 5), hindmost first.
        q: (n, 3) pose of the foot at which `loads` were found.
        loads: (n, 2) by statics on the outer two spheres [N].

    Returns:
        Height and pitch (n, 2), loads and indentations (n, m).
    """
    places, total = spheres[:, _PLACE], loads.sum(axis=1)
    ahead, _ = _reach(places[[0, -1]], q[:, 2])
    moment = np.sum(loads * ahead, axis=1)

    def settled(pitch):
        return sunk(kernel, spheres, places, pitch, total, _CLEARANCE)

    def behind(pitch):
        *_, force = settled(pitch)
        return moment - np.sum(force * _reach(places, pitch)[0], axis=1)

    x, z = places[-1] - places[0]
    level, tilt = -np.arctan2(z, x), np.arcsin(_LARGEST_SLOPE)
    pitch = bisected(behind, level - tilt, level + tilt, total.shape, _TILTS)
    height, depths, forces = settled(pitch)
    return np.column_stack([height, pitch]), forces, depths


def sunk(kernel, spheres, places, pitch, force, clearance):
    """Height of a foot at which the law gives a vertical force.

    Args:
        kernel: the law.
        spheres: parameters (m, 5).
        places: (n, m, 2) or (m, 2) their centres in the foot frame [m].
        pitch: (n,) of the foot [rad].
        force: (n,) vertical force of all spheres [N].
        clearance: largest height of the lowest point above the ground [m].

    Returns:
        Height (n,), indentations (n, m) [m] and forces (n, m) [N].
    """
    below = spheres[:, _RADIUS] - _reach(places, pitch)[1]
    lowest = below.max(axis=1)

    def excess(depth):
        depths = below - (lowest - depth)[:, None]
        return static_force(kernel, spheres, depths).sum(axis=1) - force

    height = lowest - bisected(excess, -clearance, _DEEPEST, force.shape)
    depths = below - height[:, None]
    return height, depths, static_force(kernel, spheres, depths)


def _forces(kernel, spheres, depths, slip=0.0):
    """Normal force and friction (n, m) of spheres that do not sink [N].

    Args:
        kernel: the law.
        spheres: parameters (m, 5), or (5,) of one alone.
        depths: (n, m) indentations [m].
        slip: velocity [m/s].
    """
    k, c, _, _, r = spheres.T
    return sphere_force(
        kernel.law, depths, 0.0, slip, k, c, r, kernel.constants
    )


def static_force(kernel, spheres, depths):
    """Normal force (n, m) of spheres at rest at indentations (n, m) [N]."""
    return _forces(kernel, spheres, depths)[0]


def slip_velocity(kernel, spheres, loads, force_x):
    """Slip velocity (n,) at which friction gives F_x [m/s]."""

    def excess(slip):
        # Friction is proportional to the normal force: one sphere's will do.
        normal, friction = _forces(kernel, spheres[0], 0.01, slip)
        return force_x - loads.sum(axis=1) * friction / normal

    return bisected(excess, -_FASTEST, _FASTEST, force_x.shape)


def bisected(increasing, lower, upper, shape, steps=_BISECTIONS):
    """Roots of increasing functions, all entries at once; else the near end.

    Bisection, then false position in the remaining, nearly linear interval.
    """
    low, high = np.full(shape, lower), np.full(shape, upper)
    below, above = np.full(shape, -1.0), np.full(shape, 1.0)
    at = 0.5 * (low + high)
    for step in range(steps):
        value = increasing(at)
        beyond = value > 0.0
        high, above = np.where(beyond, (at, value), (high, above))
        low, below = np.where(beyond, (low, below), (at, value))
        share = below / (below - above) if step > steps - _STRAIGHT else 0.5
        at = low + share * (high - low)
    return at


_LOADED_N = 5.0
_PITCH_RAD = 0.1  # largest turn of the settled foot from the measured one
_SMOOTH_S = 0.02  # width of the Gaussian filter of that turn
_FADE_S = 0.1  # time in which offsets fade while the foot is in the air
_CLEAR_M = 0.005  # least clearance of a foot in the air
_HIGHEST_M, _PITCHES = 0.3, 20  # height to lower a foot from; bisections


def settle_rolling(
    kernel: FootGroundKernel,
    spheres: np.ndarray,
    places: np.ndarray,
    times: np.ndarray,
    foot: np.ndarray,
    ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Motion of a stepping foot whose contact forces are near the given ones.

    Args:
        kernel: the law.
        spheres: parameters (m, 5) of all spheres under the foot.
        places: (n, m, 2) their centres in the foot frame (hinged toes move).
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
        height[loaded], *_ = sunk(
            kernel,
            spheres,
            places[loaded],
            q[loaded, 2],
            ground[loaded, 1],
            _HIGHEST_M,
        )
        q[:, 1] += _bridged(height - q[:, 1], loaded, times)
    _, below = _reach(places, q[:, 2])
    lowest = (q[:, 1, None] + below - spheres[:, _RADIUS]).min(axis=1)
    q[~loaded, 1] += np.maximum(_CLEAR_M - lowest[~loaded], 0.0)
    v = np.gradient(q, times, axis=0)
    for start, end in runs(loaded):
        if end - start < 2:
            continue
        # It slips so that friction gives F_x.
        rows = slice(start, end)
        _, up = _reach(places[rows], q[rows, 2])
        depths = spheres[:, _RADIUS] - up - q[rows, 1, None]
        force = static_force(kernel, spheres, depths)
        height = _height(kernel.law, spheres, force, depths)
        slip = slip_velocity(kernel, spheres, force, ground[rows, 0])
        v[rows, 0] = slip - (q[rows, 1] - height) * v[rows, 2]
        path = cumulative_trapezoid(v[rows, 0], times[rows], initial=0.0)
        # The mean place, weighted by load, stays the measured one.
        weight = ground[rows, 1]
        q[rows, 0] = path + np.average(q[rows, 0] - path, weights=weight)
    q[:, 0] = foot[:, 0] + _bridged(q[:, 0] - foot[:, 0], loaded, times)
    v[~loaded] = np.gradient(q, times, axis=0)[~loaded]
    return q, v


def _pitches(kernel, spheres, places, q, ground, loaded):
    """Turn (k,) at the loaded nodes that puts the load under the CoP [rad]."""
    places, at, w = places[loaded], q[loaded], ground[loaded]
    centre = -w[:, 2] / w[:, 1] - at[:, 0]

    def behind(turn):
        """How far the load is behind the CoP [m]; it increases with turn."""
        pitch = at[:, 2] + turn
        ahead, _ = _reach(places, pitch)
        *_, force = sunk(kernel, spheres, places, pitch, w[:, 1], _HIGHEST_M)
        return centre - np.sum(force * ahead, axis=1) / force.sum(axis=1)

    turn = bisected(behind, -_PITCH_RAD, _PITCH_RAD, centre.shape, _PITCHES)
    # A foot on one end of its sole cannot reach the CoP by turning.
    return np.where(np.abs(turn) < 0.99 * _PITCH_RAD, turn, 0.0)


def _bridged(off, loaded, times):
    """Offsets (n,): as given at loaded nodes, fading to 0 away from them."""
    if loaded.all() or not loaded.any():
        return off
    (nearest,) = distance_transform_edt(
        ~loaded, return_distances=False, return_indices=True
    )
    far = (times - times[nearest]) / _FADE_S
    return np.where(loaded, off, off[nearest] * np.exp(-(far**2)))
