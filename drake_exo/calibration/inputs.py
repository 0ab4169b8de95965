"""From a study file to what the phases need; shared by the commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from pydrake.systems.framework import System

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.interaction import InteractionProblem
from drake_exo.calibration.measured import MeasuredMovement, from_trial
from drake_exo.calibration.prediction import PredictionProblem
from drake_exo.calibration.results import Calibration
from drake_exo.calibration.settings import (
    FootGroundSettings,
    PredictionSettings,
)
from drake_exo.collocation.bushing_kernels import BUSHINGS
from drake_exo.contact.parameters import ContactParameter
from drake_exo.errors import InputError
from drake_exo.measurement.processing import load_trials
from drake_exo.measurement.subject import SubjectModel
from drake_exo.measurement.trial import Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant
from drake_exo.study import Study, Use, load_study, trials_for


@dataclass(frozen=True)
class CalibrationInputs:
    """A study, read.

    Attributes:
        study: the study file.
        subject: the fitted model.
        loaded: trials as the laboratory gives them.
        trials: the same as a phase tracks them.
        tree: dynamics of the study's model.
        parameters: foot-ground parameters, nominal values and bounds.
    """

    study: Study
    subject: SubjectModel
    loaded: tuple[Trial, ...]
    trials: list[MeasuredMovement]
    tree: PlanarTree
    parameters: list[ContactParameter]

    @property
    def settings(self) -> FootGroundSettings:
        """Settings of Phase A."""
        return self.study.foot_ground

    @property
    def trial_names(self) -> list[str]:
        """Names of the trials."""
        return [t.name for t in self.trials]

    @property
    def model(self) -> tuple:
        """(kind, human, exoskeleton), as the plant builder takes them."""
        return self.study.model, self.subject.human, self.subject.exoskeleton

    def problem(self) -> FootGroundProblem:
        """Phase A posed."""
        return FootGroundProblem(
            self.tree, self.trials, self.parameters, self.settings
        )

    def check_has_exoskeleton(self) -> None:
        """Raises InputError if there is nothing to interact with."""
        if self.study.model != "coupled":
            raise InputError(
                f"the study's model is '{self.study.model}': there is no "
                "exoskeleton to interact with; use 'model: coupled', or "
                "--phase foot-ground"
            )

    def interaction_problem(self, contact: Calibration) -> InteractionProblem:
        """Phase B posed, with the foot-ground contact fixed.

        Raises:
            InputError: the study's model has no exoskeleton.
        """
        self.check_has_exoskeleton()
        settings = self.study.interaction
        human = self.subject.human
        places = {s: getattr(human, f"{s}_cuff_m") for s in BUSHINGS}
        return InteractionProblem(
            self.tree,
            self.trials,
            settings.parameters(places),
            settings,
            damping=settings.damping,
            foot=self._foot(contact),
            foot_values=contact.spheres(),
        )

    def prediction_problem(
        self,
        trial: MeasuredMovement,
        contact: Calibration,
        settings: PredictionSettings,
        scale: float = 1.0,
        controller: System | None = None,
    ) -> PredictionProblem:
        """Phase C posed for one trial.

        Args:
            trial: to predict.
            contact: calibrated models.
            settings: of the prediction.
            scale: of the interaction's stiffness and damping.
            controller: gives the exoskeleton's torques.

        Raises:
            InputError: the model has an exoskeleton, but the interaction was
                not calibrated.
        """
        bushings = []
        if self.study.model == "coupled":
            if not contact.has_bushings:
                raise InputError(
                    "the calibration holds no interaction parameters; run "
                    "'drake-exo calibrate' without --phase, or with "
                    "--phase interaction"
                )
            bushings = contact.bushings()
        return PredictionProblem(
            self.tree,
            [trial],
            bushings,
            settings,
            damping=contact.damping,
            foot=self._foot(contact),
            foot_values=contact.spheres(),
            scale=scale,
            controller=controller,
        )

    def _foot(self, contact: Calibration) -> FootGroundSettings:
        return replace(
            self.settings, law=contact.law, constants=contact.constants
        )


def load_inputs(
    path: Path, data_root: Path | None, use: Use = "calibration"
) -> CalibrationInputs:
    """Read a study and the files of its trials of one use.

    Raises:
        InputError: the study or a file is not as it should be.
    """
    study, root = load_study(path, data_root)
    study = trials_for(study, use)
    settings = study.foot_ground
    settings.law_constants()
    subject, loaded = load_trials(study, root)
    foot = subject.exoskeleton or subject.human
    plant = build_plant(
        study.model,
        subject.human,
        subject.exoskeleton,
        gravity=study.gravity_m_s2,
    )
    return CalibrationInputs(
        study,
        subject,
        loaded,
        [from_trial(t) for t in loaded],
        PlanarTree.from_plant(plant),
        settings.parameters(foot.heel_m, foot.toe_m),
    )
