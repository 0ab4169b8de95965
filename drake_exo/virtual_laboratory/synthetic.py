"""Movements that satisfy the model exactly: for examples, tests, benchmarks.

A rise from sitting to standing is drawn in joint space. Then the trajectory
problem with known contact is solved near it. The result satisfies dynamics,
contact laws and collocation exactly, so a calibration with such data must find
the parameters that made them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    InteractionCalibration,
    PredictionProblem,
)
from drake_exo.calibration.problem import PhaseProblem, kinematic_terms
from drake_exo.calibration.settings import (
    FootGroundSettings,
    InteractionNoise,
    InteractionSettings,
    PredictionSettings,
    Range,
    Solver,
    SphereSettings,
    Spread,
    TrackingNoise,
)
from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.collocation.trial_program import Tracking, minimised
from drake_exo.contact.parameters import ContactModel, ContactParameter
from drake_exo.measurement.filters import low_pass, minimum_jerk
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model, nominal_model

__all__ = [
    "INSTRUMENT_NOISE",
    "RisesInDevice",
    "noisy",
    "random_values",
    "rises_in_device",
    "rises_on_spheres",
]
# Knots of the drawn path per second; margins of filtered noise.
_KNOTS = 40.0
_MARGIN_S = 1.0
# Large for the foot and for forces, which follow from the contact.
_DRAWN = TrackingNoise(
    foot_m=0.05,
    foot_pitch_deg=10.0,
    foot_velocity_m_s=0.5,
    foot_pitch_rate_deg_s=50.0,
    force_n=50.0,
    cop_m=0.02,
)
# Offset of the cuff's origin [m], stiffnesses [N/m, N/m, N m/rad], slip [1/N].
TRUE_CUFFS = {
    "shank": (0.01, 0.03, 1500.0, 4000.0, 30.0, 0.03),
    "thigh": (-0.01, -0.02, 2500.0, 7000.0, 60.0, 0.04),
    "pelvis": (0.02, 0.03, 3000.0, 6000.0, 80.0, 0.03),
}
# Cuffs with mats in successive trials: the paper's two configurations.
MATS = (("pelvis",), ("pelvis",), ("shank", "thigh"))
# Noise that the filter leaves of instruments: markers of 0.3 mm, encoders of
# 0.02 degree, plates of 0.5 N, mats in steps. Contact energy and jerk have
# almost no weight.
INSTRUMENT_NOISE = InteractionNoise(
    angle_deg=0.02,
    velocity_deg_s=0.3,
    exo_angle_deg=0.01,
    exo_velocity_deg_s=0.15,
    foot_m=1e-4,
    foot_pitch_deg=0.02,
    foot_velocity_m_s=1.5e-3,
    foot_pitch_rate_deg_s=0.3,
    force_n=0.3,
    cop_m=2e-4,
    moment_nm=0.5,
    exo_moment_nm=0.05,
    normal_force_n=1.0,
    energy_j=100.0,
)
# Lag of the device's successive joints, in parts of `Rise.lag_deg`.
_LAGS = (1.0, -0.5, 0.7)
# Standard deviation of the passive device's joint torques about zero.
_DEVICE_NM = 0.5
_SPHERE = SphereSettings(
    modulus_n_m2=Range(5e6, 1e6, 5e7),
    x_m=Spread(0.05, 0.05),
    z_m=Spread(0.02, 0.02),
)


@dataclass(frozen=True)
class Rise:
    """Posture and timing of a sit-to-stand rise to be drawn.

    Attributes:
        name: name of the trial.
        duration_s: of the movement.
        knee_deg, hip_deg: angles at seat-off and when standing.
        balance_m: centre of mass ahead of the ankle at the start, in the
            middle and at the end.
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
    tree: PlanarTree, rise: Rise, contact: ContactModel | None = None
) -> Trial:
    """A rise in joint space, balanced over the foot.

    The ankle's angle puts the centre of mass where the rise says; the ground
    reaction follows from inverse dynamics.

    Args:
        tree: human or coupled model.
        rise: posture and timing.
        contact: law that the foot rests on; None: the foot is at the origin.
    """
    names = tree.coordinates
    count = max(round(rise.duration_s * _KNOTS), 20) + 1
    times = np.linspace(0.0, rise.duration_s, count)
    s = times / rise.duration_s
    step = minimum_jerk(s)[0]
    bump = (4.0 * s * (1.0 - s)) ** 2
    q = np.zeros((count, tree.num_positions))
    for joint, ends in (("knee", rise.knee_deg), ("hip", rise.hip_deg)):
        angle = np.deg2rad(ends[0] + (ends[1] - ends[0]) * step)
        q[:, names.index(joint)] = angle
    start, top, end = rise.balance_m
    balance = start + (end - start) * step + (top - 0.5 * (start + end)) * bump
    shares = np.resize(_LAGS, len(names.device))
    lag = np.outer(np.deg2rad(rise.lag_deg) * bump, shares)
    if contact is not None:
        foot = _standing(tree, contact, times, balance)
        q[:, names.root_columns] = foot
    _balance(tree, q, balance, lag)
    path = make_interp_spline(times, q, k=7)
    v, a = path.derivative(1)(times), path.derivative(2)(times)
    ground = tree.ground_reaction(q, tree.inverse_dynamics(q, v, a))
    wrench = PlanarWrench.of(ground)
    return Trial(rise.name, names, times, q, v, a, wrench, source="simulated")


def _standing(tree, contact: ContactModel, times, balance):
    """Foot coordinates (n, 3) at which the contact bears a slow rise."""
    weight = np.full(len(times), tree.weight)
    ground = np.column_stack([0.0 * weight, weight, -balance * weight])
    values = [
        p.nominal for s in contact.ground.spheres for p in contact.fixed(s)
    ]
    kernel = FootGroundKernel(contact.ground)
    still = np.zeros((len(times), 3))
    return settle_foot(kernel, np.array(values), times, still, ground)[0]


def _balance(tree: PlanarTree, q, balance, lag):
    """Solve for the ankle that puts the centre of mass at `balance` [m]."""
    names, h = tree.coordinates, 1e-6
    ankle = names.index("ankle")
    along = names.turned_by[:, names.human.index("ankle")]
    for _ in range(8):
        if names.device:
            body = names.aligned(q[:, names.body_columns])
            q[:, names.device_columns] = body[:, names.device_columns] + lag
        bent = q.copy()
        bent[:, ankle] += h
        bent[:, names.device_columns] += h * along
        x = tree.center_of_mass(q)[:, 0]
        slope = (tree.center_of_mass(bent)[:, 0] - x) / h
        q[:, ankle] += (balance + q[:, 0] - x) / slope


def consistent(
    model: Model,
    drawn: list[Rise],
    truth: list[ContactParameter],
    settings: FootGroundSettings,
) -> list[Trial]:
    """Movements near drawn rises that satisfy the model exactly.

    They do so at the nodes of the settings' grid.

    Args:
        model: subject and device.
        drawn: the rises.
        truth: parameters whose nominal values make the data.
        settings: law, constants and grid; its noise is not used.

    Raises:
        SealedSolutionError: no such movement was found.
    """
    settings = replace(settings, noise=_DRAWN, prior_weight=0.0)
    fixed = [replace(p, free=False) for p in truth]
    contact = settings.contact(model.spheres).with_values(
        {p.name: p.nominal for p in truth}
    )
    made = []
    for rise in drawn:
        start = draw(model.tree, rise, contact)
        problem = FootGroundCalibration(model, [start], settings, fixed)
        made += _made(problem, [()])
    return made


def _made(problem: PhaseProblem, mats) -> list[Trial]:
    """Trials of the solution, each with the normal forces of its mats."""
    result = problem.solve()
    result.solution.values(np.zeros(0, int))  # raises if it failed
    return [
        replace(
            trial,
            source="simulated",
            jerk=None,
            moments=trial.moments if trial.cuffs else None,
            cuffs={c: CuffForce(trial.cuffs[c].normal) for c in seen},
        )
        for trial, seen in zip(result.trials, mats, strict=True)
    ]


def rises_on_spheres(
    count: int = 3,
    nodes_per_second: float = 100.0,
    duration_s: float = 1.5,
    seed: int = 0,
) -> tuple[Model, list[Trial]]:
    """The nominal adult alone, rising on the default settings' spheres.

    Args:
        count: number of trials, named rise1, rise2, ...
        nodes_per_second: of the grid on which they are exact.
        duration_s: duration of each.
        seed: of the random numbers.

    >>> model, trials = rises_on_spheres(1, nodes_per_second=40)
    >>> trials[0].name, model.kind
    ('rise1', 'human')
    """
    model = nominal_model("human")
    settings = FootGroundSettings(solver=Solver(nodes_per_second))
    truth = settings.parameters(model.spheres)
    drawn = rises(count, duration_s, seed)
    return model, consistent(model, drawn, truth, settings)


@dataclass(frozen=True)
class RisesInDevice:
    """Exact movements of a person in a passive exoskeleton on known cuffs.

    Attributes:
        model: subject and device.
        contact: true contact of the foot and of the cuffs.
        trials: exact movements.
        nodes_per_second: of the grid on which they are exact.

    >>> made = rises_in_device(1, nodes_per_second=40)
    >>> made.contact.values()["pelvis.rotational_stiffness"]
    80.0
    """

    model: Model
    contact: ContactModel
    trials: list[Trial]
    nodes_per_second: float

    def settings(self, **changes) -> InteractionSettings:
        """Settings of Phase B on the grid of the data."""
        solver = Solver(self.nodes_per_second, tolerance=1e-6)
        usual = InteractionSettings(solver=solver, errors=NO_ERRORS)
        return replace(usual, **changes)

    def exact_settings(self) -> InteractionSettings:
        """Settings of Phase B with nearly no regularisation, for exact data."""
        noise = InteractionNoise(normal_force_n=0.5, energy_j=1e3, jerk=1e5)
        solver = Solver(self.nodes_per_second, tolerance=1e-9)
        return self.settings(noise=noise, prior_weight=1e-9, solver=solver)

    def calibration(
        self, settings: InteractionSettings, trials=None
    ) -> InteractionCalibration:
        """Phase B on these trials, or on others."""
        return InteractionCalibration(
            self.model, trials or self.trials, self.contact, settings
        )

    def prediction(
        self,
        settings: PredictionSettings,
        trial: Trial,
        contact: ContactModel | None = None,
        controller=None,
    ) -> PredictionProblem:
        """Phase C of one trial, with the true contact or another.

        Errors of measurement are switched off, since these data have none.
        """
        return PredictionProblem(
            self.model,
            [trial],
            contact or self.contact,
            replace(settings, errors=NO_ERRORS),
            controller=controller,
        )


class _PassiveDevice(PhaseProblem):
    """A trajectory near the drawn rise, with nearly no device torque."""

    def _hold_ends(self, movement, at):
        movement.bound(movement.grid.v[[0, -1]], 0.0, 0.0)

    def _terms(self, movement, at, effects):
        loose = replace(
            self.settings.noise,
            angle_deg=5.0,
            velocity_deg_s=20.0,
            exo_angle_deg=5.0,
            exo_velocity_deg_s=20.0,
            foot_pitch_deg=2.0,
        )
        device = movement.coordinates.is_device_joint
        passive = movement.torque[:, device]
        return [
            *kinematic_terms(movement, at, loose),
            minimised(movement.torque[:, ~device], loose.torque_nm),
            Tracking(passive, np.zeros(passive.shape), _DEVICE_NM),
        ]


def rises_in_device(
    count: int = 3,
    nodes_per_second: float = 50.0,
    duration_s: float = 1.5,
    seed: int = 0,
    model: Model | None = None,
) -> RisesInDevice:
    """The nominal adult rises in a passive exoskeleton on known cuffs.

    The exoskeleton has no torque of its own; human moments and the foot's place
    are found near a drawn rise.

    Args:
        count: number of trials; mats alternate as in the paper, while another
            device than the shipped one has mats at all cuffs.
        nodes_per_second: of the grid.
        duration_s: duration of each movement.
        seed: of the random numbers.
        model: one leg in a device; the nominal coupled model by default.

    Raises:
        SealedSolutionError: no such movements were found.

    >>> made = rises_in_device(1, nodes_per_second=40)
    >>> list(made.trials[0].cuffs)
    ['pelvis']
    """
    model = model or nominal_model("coupled")
    settings = InteractionSettings(solver=Solver(nodes_per_second))
    foot = FootGroundSettings(heel=_SPHERE, toe=_SPHERE)
    truth = {}
    for cuff, (x, z) in model.cuffs.items():
        dx, dz, *values = TRUE_CUFFS.get(cuff, TRUE_CUFFS["thigh"])
        names = settings.parameters({cuff: (x, z)})
        values = (x + dx, z + dz, *values)
        truth |= {p.name: v for p, v in zip(names, values, strict=True)}
    contact = replace(
        foot.contact(model.spheres), bushings=settings.bushings(model.cuffs)
    ).with_values(truth)
    drawn = [
        _on_ground(draw(model.tree, rise), model)
        for rise in rises(count, duration_s, seed)
    ]
    problem = _PassiveDevice(model, drawn, contact, [], settings)
    cycle = MATS if model.assembly.is_fitted else (tuple(model.cuffs),)
    mats = [cycle[i % len(cycle)] for i in range(count)]
    trials = _made(problem, mats)
    return RisesInDevice(model, contact, trials, nodes_per_second)


def _on_ground(trial: Trial, model: Model) -> Trial:
    """The drawn rise with its foot at the height of the standing ankle."""
    q = trial.q.copy()
    z = model.coordinates.index(model.coordinates.root[1])
    q[:, z] += model.human.ankle_height_m - 1e-3 - q[0, z]
    return replace(trial, q=q)


def noisy(
    trial: Trial, seed: int, noise: TrackingNoise, cutoff_hz: float = 6.0
) -> Trial:
    """Add smooth measurement noise of the given standard deviations.

    Args:
        trial: without noise.
        seed: of the random numbers.
        noise: of angles, foot, forces and centre of pressure, and of moments
            and mats if there are any; noise of velocities is the derivative
            of that of positions.
        cutoff_hz: of the low-pass filter that the noise has passed.

    >>> model, [trial] = rises_on_spheres(1, nodes_per_second=40)
    >>> seen = noisy(trial, 0, INSTRUMENT_NOISE)
    >>> float(np.std(seen.ground.force_x - trial.ground.force_x).round(3))
    0.3
    """
    rng = np.random.default_rng(seed)
    device, times = trial.coordinates.is_device_joint, trial.times
    joints = np.where(device, noise.exo_angle_deg, noise.angle_deg)
    pitch = np.deg2rad(noise.foot_pitch_deg)
    sigma = np.r_[noise.foot_m, noise.foot_m, pitch, np.deg2rad(joints)]
    dq = _smooth(rng, times, sigma, cutoff_hz)
    path = make_interp_spline(times, dq, k=5)
    force = _smooth(rng, times, [noise.force_n] * 2, cutoff_hz)
    cop = _smooth(rng, times, [noise.cop_m], cutoff_hz)[:, 0]
    ground = trial.ground
    center = -ground.moment / ground.force_z + cop
    force = ground.force + force
    moments = trial.moments
    if moments is not None:
        spread = np.where(device, noise.exo_moment_nm, noise.moment_nm)
        moments = moments + _smooth(rng, times, spread, cutoff_hz)
    cuffs = {
        cuff: CuffForce(
            seen.normal
            + _smooth(rng, times, [noise.normal_force_n], cutoff_hz)[:, 0]
        )
        for cuff, seen in trial.cuffs.items()
    }
    return replace(
        trial,
        q=trial.q + dq,
        v=trial.v + path.derivative(1)(times),
        a=trial.a + path.derivative(2)(times),
        ground=PlanarWrench(force, -center * force[:, 1]),
        moments=moments,
        cuffs=cuffs,
    )


def _smooth(rng, times, sigma, cutoff_hz):
    """White noise through the laboratory's filter, scaled to sigma.

    Margins are filtered too and cut off: a movement is part of a longer
    recording, so the filter does not ring at the movement's ends.
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
    """Random starts within the bounds; fixed parameters stay nominal.

    >>> x = ContactParameter("heel.x", "m", 0.0, -0.1, 0.1)
    >>> [values] = random_values([x], 1, seed=0)
    >>> bool(x.lower < values[0] < x.upper)
    True
    """
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.array(
            [
                rng.uniform(p.lower, p.upper) if p.free else p.nominal
                for p in parameters
            ]
        )
