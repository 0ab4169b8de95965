"""Phase B: calibrate the human-exoskeleton contact, three trials at once.

Serrancoli et al., II-C: as Phase A, with the foot-ground contact fixed; the
bushings' forces are further controls, tied to their law. Joint moments and
the normal forces that mats measured are tracked, the contact energy of all
other components is minimised.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from drake_exo.calibration.error_model import ErrorModel
from drake_exo.calibration.problem import (
    Parts,
    PhaseProblem,
    ground_terms,
    kinematic_terms,
    normal_force_terms,
    torque_terms,
)
from drake_exo.calibration.settings import InteractionSettings
from drake_exo.collocation.trial_program import TrialProgram
from drake_exo.contact.bushing import COMPONENTS, NORMAL
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model

EVERY = list(range(len(COMPONENTS)))


class InteractionCalibration(PhaseProblem):
    """Phase B posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: measured.
        contact: of foot and ground, calibrated; its bushings are not used.
        settings: noise, bounds, grid.

    Raises:
        InputError: the model has no cuffs.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = InteractionCalibration(made.model, made.trials, made.contact)
    >>> [p.name for p in posed.parameters][:2]
    ['shank.origin_x', 'shank.origin_z']
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: InteractionSettings | None = None,
        *,
        refined: Mapping[str, Parts] | None = None,
    ):
        check_has_cuffs(model)
        settings = settings or InteractionSettings()
        super().__init__(
            model,
            trials,
            replace(contact, bushings=settings.bushings(model.cuffs)),
            settings.parameters(model.cuffs),
            settings,
            ErrorModel(model, trials, settings.errors),
            refined,
        )

    def _terms(self, movement, at, effects):
        noise = self.settings.noise
        return [
            *kinematic_terms(movement, at, noise, effects),
            *ground_terms(movement, at, noise),
            *torque_terms(movement, at, noise, effects),
            *normal_force_terms(movement, at, noise, effects),
        ]

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        unmeasured = {
            cuff: [c for c in EVERY if c != NORMAL or cuff not in trial.cuffs]
            for cuff in self.bushings
        }
        self.minimise_energy(movement, unmeasured, self.settings.noise.energy_j)
        return movement


def check_has_cuffs(model: Model) -> None:
    """Raises InputError if there is nothing to interact with."""
    if not model.cuffs:
        raise InputError(
            f"the study's model is '{model.name}': there is no exoskeleton "
            "to interact with; use 'model: coupled', or --phase foot-ground"
        )


def check_is_measured(trials: Sequence[Trial]) -> None:
    """Raises InputError if nothing of the device was measured.

    Without angles, moments and mats there is nothing that cuffs could be
    calibrated with.
    """
    if not any(
        t.cuffs or t.moments is not None or "encoders" in t.provenance
        for t in trials
    ):
        raise InputError(
            "nothing of the exoskeleton was measured: no trial has encoders, "
            "exo_moments or pressure, and the study has no device; say "
            "'model: human' if none was worn, or use --phase foot-ground"
        )
