"""From a study file to what Phase A needs; shared by the commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drake_exo.laboratory.loading import load_trials
from drake_exo.laboratory.subject import SubjectModel
from drake_exo.laboratory.trial import Trial
from drake_exo.parameters import ContactParameter
from drake_exo.phases.foot_ground import FootGroundProblem
from drake_exo.phases.measured import MeasuredMovement, from_trial
from drake_exo.phases.settings import FootGroundSettings
from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import build_plant
from drake_exo.study import Study, load_study


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
    def model(self) -> tuple:
        """(kind, human, exoskeleton), as the plant builder takes them."""
        return self.study.model, self.subject.human, self.subject.exoskeleton

    def problem(self) -> FootGroundProblem:
        """Phase A posed."""
        return FootGroundProblem(
            self.tree, self.trials, self.parameters, self.settings
        )


def load_inputs(path: Path, data_root: Path | None) -> CalibrationInputs:
    """Read a study and its files.

    Raises:
        InputError: the study or a file is not as it should be.
    """
    study, root = load_study(path, data_root)
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
