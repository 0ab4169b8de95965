"""A person's own movement in a device whose contact is given.

The person moves as was measured and the device's torques are as measured;
where the device goes, and what its cuffs bear, follows from its equations of
motion. With the cuffs of today that is what a design is compared with, with
other cuffs it is the design's forecast: neither its mats nor its encoders are
believed, since other cuffs would change them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drake_exo.calibration.error_model import ErrorModel
from drake_exo.calibration.interaction import check_has_cuffs
from drake_exo.calibration.problem import (
    PhaseProblem,
    ground_terms,
    kinematic_terms,
    torque_terms,
)
from drake_exo.calibration.settings import PredictionSettings
from drake_exo.collocation.trial_program import TrialProgram
from drake_exo.contact.parameters import TYPICAL_JERK, ContactModel
from drake_exo.contact.strap import Design
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model


class OwnMovement(PhaseProblem):
    """The movement of measured trials on given cuffs, posed as a program.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated.
        settings: noise, errors and grid, as those of Phase C.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = OwnMovement(made.model, made.trials, made.contact)
    >>> len(posed.movements[0].tracked)
    5

    Raises:
        InputError: the model has no cuffs.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: PredictionSettings | None = None,
    ):
        check_has_cuffs(model)
        settings = settings or PredictionSettings()
        errors = ErrorModel(model, trials, settings.errors, contact.posterior)
        super().__init__(model, trials, contact, [], settings, errors)

    def _add(self, trial: Trial) -> TrialProgram:
        movement, at, effects = self._begin(trial)
        noise = self.settings.noise
        movement.add_tracking_cost(
            [
                *own_kinematics(movement, at, noise, effects),
                *ground_terms(movement, at, noise),
                *torque_terms(movement, at, noise, effects),
            ],
            self.error_variables,
        )
        # Loose: what a device does on its cuffs is what is asked for.
        movement.add_jerk_cost(noise.jerk or TYPICAL_JERK)
        return movement


def own_kinematics(movement, at: Trial, noise, effects=None) -> list:
    """`kinematic_terms` of the person alone: the device goes where it must."""
    terms = kinematic_terms(movement, at, noise, effects)
    device = movement.coordinates.device_columns
    for term in terms:
        term.sigma = term.sigma.copy()
        term.sigma[:, device] = np.inf
    return terms


def assisted(trial: Trial, design: Design) -> Trial:
    """A trial with the device's torques times a design's factors.

    What the device bears more the person bears less.
    """
    if trial.moments is None or not design.assistance:
        return trial
    names, moments = trial.coordinates, trial.moments.copy()
    angles = trial.q[:, names.device_columns]
    factors = design.factors(names.device, angles)
    for i, joint in enumerate(names.device):
        more = (factors[:, i] - 1.0) * trial.moment(joint)
        moments[:, names.joint(joint)] += more
        moments[:, names.joint(names.follows(joint))] -= more
    return replace(trial, moments=moments)
