"""Movements whose truth is the model: for twin experiments and benchmarks.

A rise from sitting to standing is drawn in joint space, then made consistent:
the movement problem with known contact parameters is solved close to it. What
comes out satisfies dynamics, contact law and collocation exactly, so that a
calibration of such data must find the parameters that made them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import needed_ground
from drake_exo.calibration.settings import FootGroundSettings, TrackingNoise
from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.parameters import ContactParameter
from drake_exo.measurement.filters import low_pass
from drake_exo.model.planar_tree import PlanarTree

# Knots of the drawn path per second, and samples of what is handed on.
_KNOTS = 40.0
_MARGIN_S = 1.0
# Contact law and values of its parameters.
Contact = tuple[FootGroundKernel, np.ndarray]

# Loose on the foot and on forces, which the contact decides.
_DRAWN = TrackingNoise(
    foot_m=0.05,
    foot_pitch_deg=10.0,
    foot_velocity_m_s=0.5,
    foot_pitch_rate_deg_s=50.0,
    force_n=50.0,
    cop_m=0.02,
)


@dataclass(frozen=True)
class Rise:
    """A sit-to-stand rise as it is drawn.

    Attributes:
        name: of the trial.
        duration_s: of the movement.
        knee_deg, hip_deg: at seat-off and when standing.
        balance_m: centre of mass ahead of the ankle, at both ends and in
            the middle.
        lag_deg: largest difference of the exoskeleton's angles from the
            human's, where the model has an exoskeleton.
    """

    name: str
    duration_s: float = 1.5
    knee_deg: tuple[float, float] = (80.0, 5.0)
    hip_deg: tuple[float, float] = (85.0, 5.0)
    balance_m: tuple[float, float, float] = (0.05, 0.08, 0.06)
    lag_deg: float = 2.0


def rises(count: int, duration_s: float = 1.5, seed: int = 0) -> list[Rise]:
    """Rises that differ in posture and balance, named rise1, rise2, ..."""
    rng = np.random.default_rng(seed)
    made = []
    for i in range(count):
        sit, stand = rng.uniform(-5.0, 5.0), rng.uniform(0.0, 6.0)
        made.append(
            Rise(
                f"rise{i + 1}",
                duration_s,
                (80.0 + sit, 4.0 + stand),
                (85.0 + sit + rng.uniform(-4.0, 4.0), 4.0 + stand),
                tuple(
                    np.array([0.05, 0.08, 0.06]) + rng.uniform(-0.01, 0.01, 3)
                ),
            )
        )
    return made


def draw(
    tree: PlanarTree, rise: Rise, contact: Contact | None = None
) -> MeasuredMovement:
    """A rise in joint space, over the middle of the foot.

    The ankle keeps the centre of mass where the rise says; the ground
    reaction is what inverse dynamics needs.

    Args:
        tree: human or coupled model.
        rise: posture and time.
        contact: carries the foot; without one it stands still at the origin.
    """
    count = max(round(rise.duration_s * _KNOTS), 20) + 1
    times = np.linspace(0.0, rise.duration_s, count)
    s = times / rise.duration_s
    step = s**3 * (10.0 + s * (6.0 * s - 15.0))
    bump = (4.0 * s * (1.0 - s)) ** 2
    q = np.zeros((count, tree.num_positions))
    for column, ends in ((4, rise.knee_deg), (5, rise.hip_deg)):
        q[:, column] = np.deg2rad(ends[0] + (ends[1] - ends[0]) * step)
    start, top, end = rise.balance_m
    balance = start + (end - start) * step + (top - 0.5 * (start + end)) * bump
    lag = np.deg2rad(rise.lag_deg) * bump
    if contact is not None:
        q[:, :3] = _standing(tree, contact, times, balance)
    _balance(tree, q, balance, lag)
    path = make_interp_spline(times, q, k=7)
    v, a = path.derivative(1)(times), path.derivative(2)(times)
    ground = needed_ground(q, tree.inverse_dynamics(q, v, a))
    return MeasuredMovement(rise.name, times, q, v, a, ground)


def _standing(tree, contact, times, balance):
    """The foot (n, 3) under a body that rises slowly."""
    weight = np.full(len(times), tree.mass * tree.gravity)
    ground = np.column_stack([0.0 * weight, weight, -balance * weight])
    return settle_foot(*contact, times, np.zeros((len(times), 3)), ground)[0]


def _balance(tree, q, balance, lag):
    """Bend the ankle until the centre of mass is where it shall be."""
    for _ in range(8):
        if tree.num_positions == 9:
            q[:, 6:] = q[:, 3:6] + np.outer(lag, [1.0, -0.5, 0.7])
        q[:, 3] += _ankle_step(tree, q, balance)


def _ankle_step(tree, q, balance):
    """Newton step of the ankle that brings the centre of mass in place."""
    h = 1e-6
    bent = q.copy()
    bent[:, 3] += h
    if tree.num_positions == 9:
        bent[:, 6] += h
    x = tree.center_of_mass(q)[:, 0]
    slope = (tree.center_of_mass(bent)[:, 0] - x) / h
    return (balance + q[:, 0] - x) / slope


def consistent(
    tree: PlanarTree,
    rises: list[Rise],
    truth: list[ContactParameter],
    settings: FootGroundSettings,
) -> list[MeasuredMovement]:
    """Movements near drawn rises that satisfy the model exactly.

    They hold at the nodes of the settings' grid.

    Args:
        tree: the model.
        rises: to draw.
        truth: parameters whose nominal values make the data.
        settings: law, constants and grid; its noise is not used.

    Raises:
        SealedSolutionError: no such movement was found.
    """
    settings = replace(settings, noise=_DRAWN, prior_weight=0.0)
    fixed = [replace(p, free=False) for p in truth]
    kernel = FootGroundKernel(settings.law, settings.law_constants())
    values = np.array([p.nominal for p in truth])
    made = []
    for rise in rises:
        drawn = draw(tree, rise, (kernel, values))
        result = FootGroundProblem(tree, [drawn], fixed, settings).solve()
        result.solution.values(np.zeros(0, int))  # raises if it failed
        found = result.trajectories[0]
        made.append(
            MeasuredMovement(
                rise.name,
                found.times,
                found.q,
                found.v,
                found.a,
                found.ground,
            )
        )
    return made


def noisy(
    movement: MeasuredMovement,
    seed: int,
    noise: TrackingNoise,
    cutoff_hz: float = 6.0,
) -> MeasuredMovement:
    """Add smooth measurement noise of the given standard deviations.

    Args:
        movement: without noise.
        seed: of the random numbers.
        noise: of angles, foot, forces and centre of pressure, and of moments
            and mats where there are some; noise of velocities is the
            derivative of that of positions.
        cutoff_hz: of the filter that the noise has passed.
    """
    rng = np.random.default_rng(seed)
    nq = movement.q.shape[1]
    sigma = np.r_[
        noise.foot_m,
        noise.foot_m,
        np.deg2rad(noise.foot_pitch_deg),
        np.full(3, np.deg2rad(noise.angle_deg)),
        np.full(nq - 6, np.deg2rad(noise.exo_angle_deg)),
    ]
    dq = _smooth(rng, movement.times, sigma, cutoff_hz)
    path = make_interp_spline(movement.times, dq, k=5)
    force = _smooth(
        rng, movement.times, [noise.force_n, noise.force_n], cutoff_hz
    )
    cop = _smooth(rng, movement.times, [noise.cop_m], cutoff_hz)[:, 0]
    ground = movement.ground.copy()
    center = -ground[:, 2] / ground[:, 1] + cop
    ground[:, :2] += force
    ground[:, 2] = -center * ground[:, 1]
    moments = movement.moments
    if moments is not None:
        spread = [noise.moment_nm] * 3 + [noise.exo_moment_nm] * (nq - 6)
        moments = moments + _smooth(rng, movement.times, spread, cutoff_hz)
    mats = {
        name: force
        + _smooth(rng, movement.times, [noise.normal_force_n], cutoff_hz)[:, 0]
        for name, force in movement.normal_force.items()
    }
    return replace(
        movement,
        q=movement.q + dq,
        v=movement.v + path.derivative(1)(movement.times),
        a=movement.a + path.derivative(2)(movement.times),
        ground=ground,
        moments=moments,
        normal_force=mats,
    )


def _smooth(rng, times, sigma, cutoff_hz):
    """White noise through the laboratory's filter, scaled to sigma.

    A movement is cut from a longer recording: filters ring at its ends, not
    at the movement's.
    """
    rate = (len(times) - 1) / (times[-1] - times[0])
    margin = round(rate * _MARGIN_S)
    white = rng.standard_normal((len(times) + 2 * margin, len(sigma)))
    filtered = low_pass(white, rate, cutoff_hz, 4, "noise")
    filtered = filtered / filtered[margin:-margin].std(axis=0)
    return filtered[margin:-margin] * sigma


def random_values(
    parameters: list[ContactParameter], count: int, seed: int
) -> Iterator[np.ndarray]:
    """Starts anywhere inside the bounds; fixed parameters stay."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.array(
            [
                rng.uniform(p.lower, p.upper) if p.free else p.nominal
                for p in parameters
            ]
        )
