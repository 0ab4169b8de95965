"""Movements with a passive exoskeleton whose truth is the model of Phase B.

The exoskeleton hangs on known cuffs without torque of its own; human moments
and the foot's place are found close to a drawn rise. What comes out satisfies
dynamics, contact and cuffs exactly.
"""

from dataclasses import dataclass, replace

import numpy as np

from drake_exo.calibration.interaction import CoupledProblem, InteractionProblem
from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.prediction import PredictionProblem
from drake_exo.calibration.problem import kinematic_terms
from drake_exo.calibration.settings import (
    FootGroundSettings,
    InteractionNoise,
    InteractionSettings,
    PredictionSettings,
    Range,
    Solver,
    SphereSettings,
    Spread,
)
from drake_exo.collocation.bushing_kernels import BUSHINGS, NORMAL
from drake_exo.collocation.trial_program import Tracking, minimised
from drake_exo.contact.parameters import ContactParameter
from drake_exo.model.description import fit_exoskeleton, nominal_human
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant
from drake_exo.virtual_laboratory.twin import draw, rises

# Offset of the cuff's origin [m], then stiffnesses [N/m, N/m, N m/rad].
TRUE_CUFFS = {
    "shank": (0.01, 0.03, 1500.0, 4000.0, 30.0),
    "thigh": (-0.01, -0.02, 2500.0, 7000.0, 60.0),
    "pelvis": (0.02, 0.03, 3000.0, 6000.0, 80.0),
}
# Mats of each trial in turn: the paper's two configurations.
MATS = (("pelvis",), ("pelvis",), ("shank", "thigh"))
# What is left of instruments' noise after the filter: markers of 0.3 mm,
# encoders of 0.02 degree, plates of 0.5 N, mats in steps. Cuffs' energy and
# jerk hardly count.
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
# What the device's joints do besides following: nothing, nearly.
_DEVICE_NM = 0.5
_SPHERE = SphereSettings(
    modulus_n_m2=Range(5e6, 1e6, 5e7),
    x_m=Spread(0.05, 0.05),
    z_m=Spread(0.02, 0.02),
)


@dataclass(frozen=True)
class InteractionTwin:
    """A model with known cuffs, and data that it made.

    Attributes:
        tree: coupled model.
        foot: settings of Phase A.
        foot_values: sphere parameters.
        truth: cuff parameters, fixed at their true values.
        trials: exact movements.
        nodes_per_second: of the grid on which they are exact.
    """

    tree: PlanarTree
    foot: FootGroundSettings
    foot_values: np.ndarray
    truth: list[ContactParameter]
    trials: list[MeasuredMovement]
    nodes_per_second: float

    def settings(self, **changes) -> InteractionSettings:
        """Settings of Phase B on the twin's grid."""
        solver = Solver(self.nodes_per_second, tolerance=1e-6)
        return replace(InteractionSettings(solver=solver), **changes)

    def calibration(
        self, settings: InteractionSettings, trials=None
    ) -> InteractionProblem:
        """Phase B on the twin's data, or on others."""
        return InteractionProblem(
            self.tree,
            trials or self.trials,
            settings.parameters(_places()),
            settings,
            damping=settings.damping,
            foot=self.foot,
            foot_values=self.foot_values,
        )

    def prediction(
        self,
        settings: PredictionSettings,
        trial: MeasuredMovement,
        parameters: list[ContactParameter] | None = None,
        **options,
    ) -> PredictionProblem:
        """Phase C of one trial, with the true cuffs or others."""
        return PredictionProblem(
            self.tree,
            [trial],
            parameters or self.truth,
            settings,
            damping=InteractionSettings().damping,
            foot=self.foot,
            foot_values=self.foot_values,
            **options,
        )


class _PassiveDevice(CoupledProblem):
    """The drawn rise, loosely, with a device that has no torque."""

    def _add(self, trial):
        movement = self._movement(trial)
        at = trial.sample(movement.grid.times)
        loose = replace(
            self.settings.noise,
            angle_deg=5.0,
            velocity_deg_s=20.0,
            exo_angle_deg=5.0,
            exo_velocity_deg_s=20.0,
            foot_pitch_deg=2.0,
        )
        movement.track(
            [
                *kinematic_terms(movement, at, loose),
                minimised(movement.torque[:, :3], loose.torque_nm),
                Tracking(
                    movement.torque[:, 3:],
                    np.zeros((len(at.times), 3)),
                    _DEVICE_NM,
                ),
            ]
        )
        for i in (0, -1):
            still = np.zeros(9)
            movement.bound(movement.grid.v[i], still, still)
        movement.damp_jerk(loose.jerk)
        return movement


def interaction_twin(
    count: int = 3,
    nodes_per_second: float = 50.0,
    duration_s: float = 1.5,
    seed: int = 0,
) -> InteractionTwin:
    """Make a twin.

    Args:
        count: of trials; mats alternate as in the paper.
        nodes_per_second: of its grid.
        duration_s: of each movement.
        seed: of the rises.

    Raises:
        SealedSolutionError: no such movements were found.
    """
    human = nominal_human()
    device = fit_exoskeleton(human)
    tree = PlanarTree.from_plant(build_plant("coupled", human, device))
    foot = FootGroundSettings(heel=_SPHERE, toe=_SPHERE)
    spheres = foot.parameters(device.heel_m, device.toe_m)
    settings = InteractionSettings(solver=Solver(nodes_per_second))
    truth = _true(settings.parameters(_places()))
    values = np.array([p.nominal for p in spheres])
    problem = _PassiveDevice(
        tree,
        [
            _on_ground(draw(tree, rise), human)
            for rise in rises(count, duration_s, seed)
        ],
        truth,
        settings,
        damping=settings.damping,
        foot=foot,
        foot_values=values,
    )
    result = problem.solve()
    result.solution.values(np.zeros(0, int))
    trials = [
        _measured(t, MATS[i % len(MATS)])
        for i, t in enumerate(result.trajectories)
    ]
    return InteractionTwin(tree, foot, values, truth, trials, nodes_per_second)


def exact_settings(twin: InteractionTwin) -> InteractionSettings:
    """Phase B with regularisers towards zero: exact data, exact recovery."""
    noise = InteractionNoise(energy_j=1e3, jerk=1e5)
    return twin.settings(noise=noise, prior_weight=1e-6)


def _places():
    human = nominal_human()
    return {name: getattr(human, f"{name}_cuff_m") for name in BUSHINGS}


def _true(parameters):
    made = []
    for k, p in enumerate(parameters):
        segment, _ = p.name.split(".")
        value = TRUE_CUFFS[segment][k % 5]
        value += p.nominal if k % 5 < 2 else 0.0
        made.append(replace(p, nominal=value, free=False))
    return made


def _on_ground(movement: MeasuredMovement, human) -> MeasuredMovement:
    """The drawn rise with its foot at the height of the standing ankle."""
    q = movement.q.copy()
    q[:, 1] += human.ankle_height_m - 1e-3 - q[0, 1]
    return replace(movement, q=q)


def _measured(t, mats) -> MeasuredMovement:
    forces = {
        name: t.interaction[:, 3 * BUSHINGS.index(name) + NORMAL]
        for name in mats
    }
    return MeasuredMovement(
        t.name,
        t.times,
        t.q,
        t.v,
        t.a,
        t.ground,
        moments=t.torque,
        normal_force=forces,
    )
