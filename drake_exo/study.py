"""A study: one subject, its trials, and the settings of all phases.

The top level of the package: read recordings (`read_study`), calibrate
(`calibrate_foot_ground`, `calibrate_interaction`), predict (`predict`), plot
and write results. Of the layers below nothing imports this module.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy, deepcopy
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import System

from drake_exo.calibration import audit
from drake_exo.calibration.clocks import (
    Clock,
    Timing,
    clocks_of,
    of_trial,
    phase_checks,
    retimed,
    settle,
    timed,
)
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    InteractionCalibration,
    PeriodicStep,
    PredictionProblem,
    check_has_cuffs,
    check_is_measured,
)
from drake_exo.calibration.problem import PhaseResult, has_encoders
from drake_exo.calibration.results import (
    Origin,
    read_calibration,
    solve_summary,
    write_bands,
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.calibration.settings import (
    DesignSettings,
    FootGroundSettings,
    InteractionSettings,
    PredictionSettings,
    own_keys,
)
from drake_exo.calibration.solving import add_up, forget, solve
from drake_exo.calibration.uncertainty import (
    Bands,
    Uncertainty,
    bands,
    posterior,
    uncertainty,
)
from drake_exo.calibration.wearers import springs_answer
from drake_exo.contact.parameters import (
    ContactModel,
    ContactParameter,
    GroundContact,
    Posterior,
    nominal_contact,
)
from drake_exo.errors import (
    InputError,
    check_bounds,
    check_data_root,
    check_file_name,
    check_type,
    nearest,
    path_of,
)
from drake_exo.files import schema
from drake_exo.files.output import (
    Check,
    Progress,
    Verdict,
    write_json,
    write_text,
)
from drake_exo.measurement.plausibility import (
    Evidence,
    made_checks,
    plausibility,
    refuse,
)
from drake_exo.measurement.processing import Recordings
from drake_exo.measurement.quality import Quality, assess
from drake_exo.measurement.settings import (
    Device,
    Filter,
    RecordingSettings,
    Use,
)
from drake_exo.measurement.steps import RecordedStep, recorded_step
from drake_exo.measurement.subject import SubjectModel, fit_subject
from drake_exo.measurement.trial import Trial, as_trials
from drake_exo.model.assembly import Assembly, named_so
from drake_exo.model.plant import Model
from drake_exo.nlp.ipopt import Solution
from drake_exo.report.gathering import rmsd_table

# Pictures and simulation take a second to import, for which a user of `check`
# would wait: they are imported where they are used.
if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from drake_exo.calibration.audit import Audit
    from drake_exo.contact.reduction import SoleLaw


@dataclass(frozen=True)
class StudyFile(RecordingSettings):
    """The groups of a study file."""

    foot_ground: FootGroundSettings = field(default_factory=FootGroundSettings)
    interaction: InteractionSettings = field(
        default_factory=InteractionSettings
    )
    prediction: PredictionSettings = field(default_factory=PredictionSettings)
    design: DesignSettings = field(default_factory=DesignSettings)

    def __post_init__(self):
        super().__post_init__()
        for name in ("foot_ground", "interaction", "design"):
            _check_names(name, getattr(self, name), self.assembly)


def _check_names(phase: str, settings, model: Assembly) -> None:
    """Refuse settings of spheres, cuffs or constants that do not exist."""
    if phase == "foot_ground":
        settings.law_constants()
        group = "spheres"
        own = [s for named in model.spheres.values() for s in named]
    elif phase in ("interaction", "design"):
        group, own = "cuffs", model.cuffs
    else:
        return
    known = named_so(own)
    for key, given in (
        (f"{phase}.{group}", getattr(settings, group)),
        (phase, own_keys(settings)),
    ):
        for name in given:
            if known and name not in known:
                raise InputError(
                    f"{key}: the model has no {name!r}; it has "
                    f"{', '.join(known)}{nearest(name, known)}"
                )


# Attributes of a study: settings, other parts, and those set by its classes.
_SETTINGS = {
    "foot_ground": FootGroundSettings,
    "interaction": InteractionSettings,
    "prediction": PredictionSettings,
    "design": DesignSettings,
    "filter": Filter,
}
_PARTS = "name", "model", "sole", "device"
_KEPT = "file", "root", "path", "_trials", "_loaded", "_judged"
# Per second; twice as many change lags by up to 0.5 ms, 25 by up to 3 ms.
_NODES_FOR_LAGS = 50.0


class Study:
    """A subject with its trials, and the settings of the phases.

    Args:
        model: subject and device.
        trials: measured, simulated or made in any other way.
        name: name of the subject.
        foot_ground, interaction, prediction, design: settings of Phases A
            to D (classes of all settings are in `drake_exo.settings`).
        filter: filter that was applied to the trials' signals.
        sole: contact law of a sole that the feet wear; without it, their
            contact is calibrated.
        device: how the device was measured; friction and springs of its joints.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, trials = synthetic.rises_on_spheres(2, nodes_per_second=40)
    >>> study = Study(model, trials, name="two rises")
    >>> [trial.name for trial in study.trials()]
    ['rise1', 'rise2']
    """

    reads: Sequence[Path] = ()  # files from which it is made

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        *,
        name: str = "subject",
        foot_ground: FootGroundSettings | None = None,
        interaction: InteractionSettings | None = None,
        prediction: PredictionSettings | None = None,
        design: DesignSettings | None = None,
        filter: Filter | None = None,
        sole: SoleLaw | None = None,
        device: Device | None = None,
    ):
        self.model = model
        self.sole = sole
        self.name = name
        self.device = device
        self.foot_ground = foot_ground
        self.interaction = interaction
        self.prediction = prediction
        self.design = design
        self.filter = filter
        self._trials = _given(trials)
        self._judged: dict[str, Trial] = {}

    def __setattr__(self, name: str, value: object) -> None:
        # A misspelt name would otherwise be set and never read.
        if name in _SETTINGS:
            value = schema.checked(value, _SETTINGS[name], name)
            _check_names(name, value, self._assembly)
        elif name in _PARTS:
            value = self._part(name, value)
        elif name not in _KEPT:
            near = nearest(name, (*_SETTINGS, *_PARTS))
            raise AttributeError(f"a study has no {name!r} to set{near}")
        parts = {"sole": None, **vars(self), name: value}
        worn = parts.get("foot_ground")
        if worn and worn.of_sole and parts["sole"] is None:
            raise InputError(
                f"foot_ground.law is {str(worn.law)!r}, the law of a sole that "
                "the study does not have; give "
                "sole=drake_exo.contact.SoleLaw.read(...)"
            )
        super().__setattr__(name, value)

    def _part(self, name: str, value: object) -> object:
        """The value, checked, of a part of the study."""
        if name in ("name", "model"):
            check_type(value, str if name == "name" else Model, name)
        elif name == "device" and value is not None:
            value = schema.check(value, Device, "device")
            value.check(self.model.coordinates)
        elif name == "sole" and value is not None:
            # SciPy's optimiser takes a moment to load.
            from drake_exo.contact.reduction import SoleLaw

            check_type(value, SoleLaw, "sole")
        return value

    @property
    def _assembly(self) -> Assembly:
        """Descriptions of which the model is assembled."""
        return self.model.assembly

    def __repr__(self) -> str:
        return f"Study({self.name!r}, {_named(self._trials)})"

    def trials(self, use: Use | None = None) -> tuple[Trial, ...]:
        """The trials; of a study file, those of one use, or all by default.

        Raises:
            InputError: there is no such use or no trial of it, or the files
                are faulty.
        """
        _check_use(use)
        return self._trials

    def alone(self, trials: Sequence[Trial]) -> Study:
        """A copy with other trials, which are not cut from recordings.

        >>> from drake_exo.virtual_laboratory import synthetic
        >>> made = Study(*synthetic.rises_on_spheres(2, nodes_per_second=40))
        >>> len(made.alone(made.trials()[:1]).trials())
        1
        """
        parts = (*_SETTINGS, *_PARTS)
        own = {name: getattr(self, name) for name in parts}
        made = Study(trials=trials, **own)
        made._judged |= self._judged
        return made

    @property
    def ground(self) -> GroundContact | None:
        """Contact of the feet by the sole's law; None without a sole."""
        if self.sole is None:
            return None
        return self.sole.ground(self.model, self.foot_ground.sole_at_m)

    @contextmanager
    def named(self) -> Iterator[None]:
        """Put the study file's name before errors that begin with its keys."""
        try:
            yield
        except InputError as error:
            path = getattr(self, "path", None)
            if path and schema.has_key(StudyFile, str(error)):
                raise InputError(f"{path}: {error}") from error
            raise

    def plausibility(self, use: Use | None = None) -> tuple[Check, ...]:
        """Checks whether trials are plausible for what they are taken for.

        Those that are not cut from recordings are judged by Newton's and
        Euler's law alone.

        Args:
            use: use of the trials to check; all by default.
        """
        return self._judge(self.trials(use))

    def _judge(self, trials: Sequence[Trial]) -> tuple[Check, ...]:
        self._judged.update({trial.name: trial for trial in trials})
        return self._checks(trials)

    def _checks(self, trials: Sequence[Trial]) -> tuple[Check, ...]:
        return tuple(c for t in trials for c in made_checks(self.model, t))

    def gate(
        self, use: Use | None = None, accepted: Sequence[str] = ()
    ) -> tuple[Check, ...]:
        """Checks of `plausibility` and a worn sole's law; raises if one fails.

        Args:
            use: use of the trials to check; all by default.
            accepted: names of checks, or beginnings of them, that may fail.

        Raises:
            InputError: a check fails that is not accepted.

        >>> from drake_exo.virtual_laboratory import synthetic
        >>> made = Study(*synthetic.rises_on_spheres(1, nodes_per_second=40))
        >>> [check.name for check in made.gate()]
        ['plausibility.newton', 'plausibility.euler']
        """
        checks = self.plausibility(use)
        refuse(checks, accepted, self.name)
        if self.sole is not None:
            checks += self.sole.checks(str(self.foot_ground.law))
        return checks

    def warn_of(self, trials: Sequence[Trial]) -> None:
        """Warn of trials that `gate` would refuse and has not yet checked."""
        new = [t for t in trials if self._judged.get(t.name) is not t]
        try:
            refuse(self._judge(new) if new else (), (), self.name)
        except InputError as error:
            # Point to the line that called this method's caller.
            warnings.warn(str(error), stacklevel=3)

    def calibrated(
        self,
        folder: str | Path,
        accepted: Sequence[str] = (),
        trials: Sequence[Trial] = (),
    ) -> tuple[ContactModel, list[Check]]:
        """A calibration's contact, if it holds and belongs to this study.

        Args:
            folder: folder that a calibration has written.
            accepted: names of checks that may fail, see `gate`.
            trials: trials for which it is to be used.

        Returns:
            The contact, on the study's sole if it has one, and the checks of
            its provenance.

        Raises:
            InputError: there is none, or a check fails that is not accepted.
        """
        found = read_calibration(folder)
        law = None if self.sole else self.foot_ground.law
        checks = found.checks(self.name, self.model, law, trials)
        return self.worn(found.taken(checks, accepted)), checks

    def worn(self, contact: Calibration | ContactModel) -> ContactModel:
        """The contact, see `contact_of`, with the study's sole if any."""
        contact = contact_of(contact)
        if self.sole is None:
            return contact
        return replace(contact, ground=self.ground)


class RecordedStudy(Study):
    """A study whose trials are cut from recordings when they are asked for.

    Attributes:
        file: contents of the study file.
        root: folder to which its paths are relative.
        path: path of the study file, if it was read from one.
    """

    def __init__(self, file: StudyFile, root: Path, path: Path | None = None):
        self.file = file
        self.root = root
        self.path = path
        self.name = file.subject.name
        self.sole = None
        if file.foot_ground.of_sole:
            from drake_exo.contact.reduction import SoleLaw

            self.sole = SoleLaw.read(root / file.foot_ground.law)
            self.sole.check_worn(file.assembly.human)
        self.foot_ground = file.foot_ground
        self.interaction = file.interaction
        self.prediction = file.prediction
        self.design = file.design
        self._loaded: dict[str, Trial] = {}
        self._judged: dict[str, Trial] = {}

    def __setattr__(self, name: str, value: object) -> None:
        again = name in ("file", "root") and name in vars(self)
        if again or name in ("model", "filter", "device"):
            raise AttributeError(
                f"recordings were read with the study file's {name}: change it "
                "there and read the file again, or make a drake_exo.Study(...) "
                "of the trials with another one"
            )
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        return f"Study({self.name!r}, {_named(self.file.trials)})"

    @property
    def reads(self) -> Sequence[Path]:
        """The study file and all files that it names."""
        named = [self.root / name for name in schema.paths_of(self.file)]
        return [*named, self.path] if self.path else named

    @cached_property
    def recordings(self) -> Recordings:
        """The recordings from which trials are cut."""
        return Recordings(self.file, self.root, self.subject)

    @cached_property
    def subject(self) -> SubjectModel:
        """The subject, fitted to the standing trial."""
        with self.named():
            return fit_subject(self.file, self.root)

    @property
    def model(self) -> Model:
        """Subject and device."""
        return self.subject.model

    @property
    def filter(self) -> Filter:
        """Filter that is applied to the trials' signals."""
        return self.file.filter

    @property
    def device(self) -> Device | None:
        """How the device was measured, and its joints' friction."""
        return self.file.device

    @property
    def _assembly(self) -> Assembly:
        return self.file.assembly

    def trials(self, use: Use | None = None) -> tuple[Trial, ...]:
        """See Study."""
        _check_use(use)
        files = tuple(t for t in self.file.trials if use in (None, t.use))
        if not files:
            raise InputError(
                f"{self.path or self.name}: no trial is for {use}; give at "
                f"least one with 'use: {use}'"
            )
        missing = tuple(f for f in files if f.name not in self._loaded)
        found = self.recordings.trials(missing)
        self._loaded |= {trial.name: trial for trial in found}
        return tuple(self._loaded[f.name] for f in files)

    def step(self, *which, **more) -> RecordedStep:
        """One step of a foot; arguments as `recorded_step`, from `trial` on."""
        return recorded_step(self.file, self.root, *which, **more)

    def quality(self) -> Quality:
        """Quality of the recordings, without solving anything."""
        return assess(self.subject, self.trials(), self.plausibility())

    def _checks(self, trials: Sequence[Trial]) -> tuple[Check, ...]:
        cut = [t for t in trials if self._loaded.get(t.name) is t]
        checks = super()._checks([t for t in trials if t not in cut])
        if not cut:
            return checks
        evidence = [
            Evidence(
                trial, self.model, f, self.recordings.used(f), self.subject
            )
            for trial in cut
            for f in self.file.trials
            if f.name == trial.name
        ]
        own = plausibility(self.subject, self.file.standing, evidence)
        return (*own, *checks)


def read_study(
    path: str | Path, data_root: str | Path | None = None
) -> RecordedStudy:
    """Read a study file; recordings are read when trials are asked for.

    Args:
        path: the YAML file.
        data_root: folder to which its paths are relative; by default the
            folder of the study file.

    Raises:
        InputError: the file cannot be read or holds something that is not
            allowed, or `data_root` is no folder.

    >>> read_study("nowhere.yaml")
    Traceback (most recent call last):
    drake_exo.errors.InputError: nowhere.yaml: cannot be read (No such file \
or directory); check the path
    """
    file, path = schema.load(path, StudyFile), Path(path)
    root = path.parent if data_root is None else path_of(data_root, "data_root")
    check_data_root(root)
    return RecordedStudy(file, root, path)


class _Solved:
    """Base of classes that hold the result of a solve."""

    result: PhaseResult

    @property
    def solution(self) -> Solution:
        """State of the solve."""
        return self.result.solution

    @property
    def success(self) -> bool:
        """Whether the solver met its tolerances."""
        return self.result.success


# Which problem each phase of a `Calibration` solves.
_POSED = {
    "foot-ground": FootGroundCalibration,
    "interaction": InteractionCalibration,
}


@dataclass(frozen=True, eq=False)
class Calibration(_Solved):
    """Result of Phase A or B; see `calibrate_foot_ground`.

    Attributes:
        phase: "foot-ground" or "interaction".
        study: copy of the study that was calibrated.
        result: result of the solve; `result.problem.program.prog` is Drake's
            MathematicalProgram.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> found = calibrate_foot_ground(Study(model, trials))
    >>> found.rmsd()[0]["grf_n"]["vertical"] < 5.0
    True
    """

    phase: str
    study: Study = field(repr=False)
    result: PhaseResult = field(repr=False)

    def __post_init__(self):
        if self.phase not in tuple(_POSED):
            raise InputError(
                f"phase is {self.phase!r:.60}; give one of {', '.join(_POSED)}"
            )
        check_type(self.study, Study, "study")
        check_type(self.result, PhaseResult, "result")
        check_type(self.result.problem, _POSED[self.phase], "result.problem")

    def __repr__(self) -> str:
        head = f"Calibration({self.phase!r}, {self.solution.status!r})"
        if not self.success:
            return head
        width = max((len(p.name) for p in self.parameters), default=0)
        rows = [
            f"  {p.name:<{width}} {p.nominal:.4g} {p.unit}".rstrip()
            for p in self.parameters
        ]
        return "\n".join([head, *rows])

    @property
    def contact(self) -> ContactModel:
        """The contact with all that was calibrated up to this phase.

        This and what follows raises SealedSolutionError after a failed solve,
        until `solution.unseal()`.
        """
        own = self.result.contact.with_values({})  # a copy, free to change
        if self.posterior is None:
            return own
        return replace(own, posterior=self.posterior)

    @cached_property
    def _known(self) -> Posterior:
        """Posterior of all that Phase B estimates."""
        return posterior(self.result)

    @property
    def posterior(self) -> Posterior | None:
        """Posterior of Phase B's parameters and errors that trials share."""
        if self.phase == "foot-ground":
            return None
        errors = self.result.problem.errors
        own = {u.name for u in errors.unknowns if u.trial is not None}
        return self._known.part([n for n in self._known.names if n not in own])

    @property
    def clocks(self) -> list[Clock]:
        """Lags of encoders and mats that Phase B found; empty for Phase A."""
        if self.phase == "foot-ground":
            return []
        return clocks_of(self.result.problem.trials, self._known)

    @cached_property
    def _measured(self) -> list[Trial]:
        """The measured trials, readings shifted by the lags found."""
        found = self.clocks if self.success else []
        return [retimed(t, found) for t in self.result.problem.trials]

    @property
    def trials(self) -> list[Trial]:
        """The solution of each trial."""
        return list(self.result.trials)

    @property
    def parameters(self) -> list[ContactParameter]:
        """The calibrated parameters, with their values as `nominal`."""
        return list(self.result.parameters)

    def parameter(self, name: str) -> ContactParameter:
        """A calibrated parameter, with its value as `nominal`.

        Raises:
            InputError: no parameter has that name.
        """
        known = {p.name: p for p in self.parameters}
        if name not in known:
            raise InputError(
                f"there is no parameter {name!r}; known are {', '.join(known)}"
                f"{nearest(name, known)}"
            )
        return known[name]

    def uncertainty(self) -> Uncertainty | None:
        """95 % intervals of the free parameters; None if not available.

        `names`, `sd`, `half_width`, `identifiable`: (m,) each, in the units of
        `contact.units()`. See `calibration.uncertainty.uncertainty`.
        """
        f = self.study.filter
        return uncertainty(self.result, f.cutoff_hz, f.order)

    def rmsd(self) -> list[dict]:
        """RMS differences from the measured trials, a dictionary for each.

        Readings are shifted by the lags found. See `audit.rmsd` for the keys.
        """
        return self._rmsd(self.result)

    def _rmsd(self, found: PhaseResult) -> list[dict]:
        return [
            audit.rmsd(trial, measured, loads=self.phase != "foot-ground")
            for trial, measured in zip(
                found.trials, self._measured, strict=True
            )
        ]

    def audit(self) -> list[Audit]:
        """Each trial's residuals between its nodes and in a simulation."""
        return list(self._audits)

    @cached_property
    def _audits(self) -> tuple[Audit, ...]:
        return tuple(audit_all(self.result)) if self.success else ()

    def verdict(
        self, checks: Sequence[Check] = (), accepted: Sequence[str] = ()
    ) -> Verdict:
        """All checks of the result.

        Args:
            checks: checks of its input, which come first.
            accepted: names of checks that need not hold.
        """
        found = self.clocks if self.success else []
        own = phase_checks(self.result, self._audits, found)
        if self.success and self.phase == "interaction":
            own += audit.cuff_checks(self.trials, self._measured)
        return Verdict((*checks, *own), tuple(accepted))

    def plot(self) -> Figure:
        """Figure of the calibrated forces, beside the measured ones.

        Phase A: the ground reaction; Phase B: the cuffs' normal forces.
        `plot_trials` draws all signals.
        """
        from drake_exo.report import figures

        draw = (
            figures.ground_reaction_figure
            if self.phase == "foot-ground"
            else figures.interaction_figure
        )
        return draw({"model": self.trials}, self._measured)

    def summary(self, verdict: Verdict | None = None) -> dict:
        """Contents of summary.json.

        Args:
            verdict: verdict to write; `self.verdict()` if None.
        """
        found = self.result.unsealed()
        problem, intervals = found.problem, {}
        known = self.uncertainty() if self.success else None
        if known is not None:
            intervals = {
                name: {
                    "sd": _known(known.sd[k]),
                    "pull": known.pull[k],
                    "half_width_95": _known(known.half_width[k]),
                    "identifiable": bool(known.identifiable[k]),
                }
                for k, name in enumerate(known.names)
            }
        clocks = self.clocks if self.success else []
        return {
            "phase": self.phase,
            "subject": self.study.name,
            **solve_summary(found.solution),
            "settings": asdict(problem.settings),
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "value": p.nominal,
                    "lower": p.lower,
                    "upper": p.upper,
                    "free": p.free,
                    "at_bound": p.free and p.at_bound(p.nominal),
                    **intervals.get(p.name, {}),
                }
                for p in found.parameters
            ],
            "rmsd": self._rmsd(found),
            "measured_sd": audit.spread(self._measured, problem.tree),
            **(verdict or self.verdict()).summary(),
            "audit": [a.summary() for a in self._audits],
            "clocks": [c.summary() for c in clocks],
        }

    def write(self, folder: str | Path, verdict: Verdict | None = None) -> dict:
        """Write model, contact, trajectories, tables and figures.

        Args:
            folder: made if it does not exist. A result that failed or does not
                hold is written as well, and marked in every file.
            verdict: verdict to write; `self.verdict()` if None.

        Returns:
            Contents of summary.json.
        """
        from drake_exo.report import figures

        folder, found = path_of(folder, "folder"), self.result.unsealed()
        folder.mkdir(parents=True, exist_ok=True)
        verdict = verdict or self.verdict()
        summary, mark = self.summary(verdict), verdict.mark
        model, trials = found.problem.model, found.problem.trials
        # Readings shifted, as they are compared with the solution.
        write_inputs(folder, model, self._measured)
        write_contact(
            folder,
            self.contact if self.success else found.contact,
            Origin.of(self.study.name, model, trials, verdict),
        )
        for trial in found.trials:
            write_trial(folder, trial, mark)
        text = rmsd_table(summary["rmsd"], summary["measured_sd"])
        write_text(folder / "rmsd.txt", text, mark)
        figures.draw_figures(folder, found.trials, self._measured, mark=mark)
        write_json(folder / "summary.json", summary)
        if self.success:
            forget(folder)
        return summary


_SIGNALS = frozenset(
    ("q", "v", "a", "ground", "feet", "moments", "cuffs", "jerk")
)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Prediction(_Solved, Trial):
    """A predicted trial; see `Trial` for its signals.

    Signals of a failed solve raise SealedSolutionError until
    `solution.unseal()`.

    Attributes:
        result: result of the solve.
        clocks: lags of the trial's encoders and mats that were used.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> study = Study(made.model, made.trials)
    >>> found = predict(study, made.trials[0], made.contact)
    >>> found.rmsd(made.trials[0])["angles_deg"]["exo_hip"] < 3.0
    True
    """

    result: PhaseResult = field(repr=False)
    clocks: tuple[Clock, ...] = ()

    def __post_init__(self):
        """No checks: the trial of which this is made has been checked."""

    def __repr__(self) -> str:
        return f"Prediction({self.name!r}, {self.solution.status!r})"

    def __getattribute__(self, name: str):
        if name in _SIGNALS:
            object.__getattribute__(self, "result").solution.check()
        return super().__getattribute__(name)

    def sample(self, times: np.ndarray) -> Trial:
        """The movement alone at other times; see `Trial.sample`."""
        own = {f.name: getattr(self, f.name) for f in fields(Trial)}
        return Trial(**own).sample(times)

    def rmsd(self, measured: Trial) -> dict:
        """RMS differences from the measured trial; see `audit.rmsd`.

        Its readings are shifted by the lags found.
        """
        return audit.rmsd(self, self.timed(measured))

    def timed(self, measured: Trial) -> Trial:
        """The measured trial, its readings shifted by the lags found."""
        check_type(measured, Trial, "measured")
        return retimed(measured, self.clocks if measured.lags_s else ())

    def audit(self) -> Audit:
        """Residuals between its nodes and in a simulation."""
        return audit_all(self.result)[0]

    def bands(self) -> Bands | None:
        """Bands of 95 %; None if the contact has no posterior."""
        self.solution.check()
        return deepcopy(self._bands)  # free to change

    @cached_property
    def _bands(self) -> Bands | None:
        return bands(self.result)

    def write(self, folder: str | Path, verdict: Verdict | None = None) -> None:
        """Write the trial as predicted and as measured, and bands.

        `read_trial` reads the trials, OpenSim the tables (docs/results.md).

        Args:
            folder: made if it does not exist.
            verdict: verdict that marks the tables; if None, that of the solve
                and its audit.
        """
        folder, band = path_of(folder, "folder"), self.bands()
        if verdict is None:
            verdict = Verdict(tuple(phase_checks(self.result, [self.audit()])))
        folder.mkdir(parents=True, exist_ok=True)
        write_trial(folder, self, verdict.mark)
        # Encoders shifted, as it is compared with the prediction.
        (measured,) = self.result.problem.trials
        measured.save(folder / f"measured_{self.name}")
        if band is not None:
            write_bands(folder, self, band, verdict.mark)

    def plot(self, measured: Trial | None = None) -> Figure:
        """Figure of angles, velocities and forces, beside the measured ones.

        All but the ground reaction have bands of 95 % if the contact has a
        posterior.

        Args:
            measured: trial to compare with, see `timed`; by default the one
                that was predicted.
        """
        from drake_exo.report import figures

        beside = measured or self.result.problem.trials[0]
        beside = self.timed(beside)
        return figures.overview_figure(self, beside, self.bands())

    def view(self, meshcat: Meshcat) -> None:
        """Animate the movement with its ground reaction in meshcat."""
        check_type(meshcat, Meshcat, "meshcat")
        from drake_exo.report.replay import show_trial

        show_trial(meshcat, self.result.problem.model, self)


def _check_use(use: Use | None) -> None:
    if use is not None and str(use) not in get_args(Use):
        raise InputError(
            f"use is {use!r}; give one of {', '.join(get_args(Use))}"
        )


def _named(trials) -> str:
    """Number and names of trials, as text."""
    count = f"{len(trials)} trial{'s' * (len(trials) != 1)}"
    return f"{count}: {', '.join(t.name for t in trials)}"


def _given(trials) -> tuple[Trial, ...]:
    """As `as_trials`; their names must serve for files of results, too."""
    found = as_trials(trials)
    for trial in found:
        check_file_name("a trial's name", trial.name)
    return found


def calibrate_foot_ground(
    study: Study,
    trials: Sequence[Trial] | None = None,
    *,
    folder: Path | None = None,
    resume: bool = False,
) -> Calibration:
    """Phase A: calibrate the contact of foot and ground, on several trials.

    If the study's feet wear a sole, their contact is known: no parameter is
    calibrated, but movement and forces that agree with it are found.

    Args:
        study: model and settings.
        trials: trials to calibrate on; the study's "calibration" by default.
        folder: keeps the newest iterate (checkpoint.npz) until results are
            written there.
        resume: start from that iterate, if there is one.

    Raises:
        InputError: trials or settings are faulty.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> contact = calibrate_foot_ground(Study(model, trials))
    >>> contact.success, contact.parameter("heel.x").unit
    (True, 'm')
    """
    check_type(study, Study, "study")
    trials = study.trials("calibration") if trials is None else _given(trials)
    study.warn_of(trials)
    pose = partial(
        FootGroundCalibration,
        *(study.model, trials, study.foot_ground),
        ground=study.ground,
    )
    result = solve(pose, "calibrate foot-ground", folder, resume)
    return Calibration("foot-ground", copy(study), result)


def calibrate_interaction(
    study: Study,
    trials: Sequence[Trial] | None = None,
    contact: Calibration | ContactModel | None = None,
    *,
    folder: Path | None = None,
    resume: bool = False,
) -> Calibration:
    """Phase B: calibrate the cuffs between human and exoskeleton.

    Args:
        study: model and settings.
        trials: trials to calibrate on; the study's "calibration" by default.
        contact: contact of foot and ground; calibrated first if None.
        folder, resume: see `calibrate_foot_ground`.

    Raises:
        InputError: the model has no cuffs, nothing of the device was measured,
            or trials or settings are faulty.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> study = Study(made.model, made.trials)
    >>> cuffs = calibrate_interaction(study, made.trials, made.contact)
    >>> cuffs.success, cuffs.parameter("thigh.normal_stiffness").unit
    (True, 'N/m')
    """
    check_type(study, Study, "study")
    check_has_cuffs(study.model)
    trials = study.trials("calibration") if trials is None else _given(trials)
    check_is_measured(trials)
    study.warn_of(trials)
    if contact is None:
        contact = calibrate_foot_ground(study, trials)
    ground = study.worn(contact)
    title = "calibrate interaction"
    made = partial(InteractionCalibration, study.model, contact=ground)
    timing = partial(made, settings=_coarse(study.interaction))
    timed, clocks = settle(trials, timing, f"{title}, clocks")
    if timed is not None and timed.solution.was_stopped:
        return Calibration("interaction", copy(study), timed)
    on_time = [retimed(t, clocks) for t in trials]
    near = timed if clocks else None
    solved = () if near is None else near.trials
    pose = partial(made, on_time, settings=study.interaction, solved=solved)
    result = solve(pose, title, folder, resume, near)
    if timed is not None:
        add_up(result.solution, timed.solution)
    return Calibration("interaction", copy(study), result)


def _coarse(settings: InteractionSettings) -> InteractionSettings:
    """The same with a grid and a tolerance that suffice for lags."""
    rate = min(settings.solver.nodes_per_second, _NODES_FOR_LAGS)
    solver = replace(settings.solver, nodes_per_second=rate, tolerance=1e-2)
    return replace(settings, solver=solver)


def find_clocks(
    study: Study, trials: Sequence[Trial], contact: Calibration | ContactModel
) -> list[Clock]:
    """Lags of encoders and mats in trials, with calibrated cuffs.

    Each trial is solved as in Phase B, with the calibration as prior of the
    cuffs: readings have to agree with forces and movement.

    Args:
        study: model and settings (those of Phase B are used).
        trials: recorded with the calibrated device; those without encoders are
            skipped.
        contact: calibrated.

    Returns:
        Clocks of all trials that could be solved; empty if the contact has no
        posterior.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> find_clocks(Study(made.model, made.trials), made.trials, made.contact)
    []
    """
    found, known = [], study.worn(contact)
    for trial in trials:
        result, own = _timing(study, trial, known)
        if result is not None and result.solution.was_stopped:
            raise KeyboardInterrupt
        found += own
    return found


def _timing(
    study: Study, trial: Trial, contact: ContactModel
) -> tuple[PhaseResult | None, list[Clock]]:
    """Solve a trial with calibrated cuffs, for its clocks; see `find_clocks`.

    The result is None if clocks cannot be found, the list empty if the solve
    failed.
    """
    timed = "encoders" in trial.lags_s and has_encoders(trial)
    if contact.posterior is None or not timed:
        return None, []
    settings = _coarse(study.interaction)
    pose = partial(Timing, study.model, contact=contact, settings=settings)
    return settle([trial], pose, f"time {trial.name}")


def predict(
    study: Study,
    trial: Trial,
    contact: Calibration | ContactModel,
    *,
    settings: PredictionSettings | None = None,
    scale_interaction: float = 1.0,
    controller: System | None = None,
    folder: Path | None = None,
    resume: bool = False,
    near: Prediction | None = None,
    clocks: Sequence[Clock] | None = None,
) -> Prediction:
    """Phase C: predict a movement and its interaction forces.

    Args:
        study: model and settings.
        trial: gives the end states; compared with, its motion not tracked.
        contact: calibrated for foot and ground and for the cuffs; the latter
            are enough if the study's feet wear a sole.
        settings: settings to use instead of the study's.
        scale_interaction: factor on the cuffs' stiffness and damping; 1.4 is
            Phase C2.
        controller: a stateless LeafSystem that gives the exoskeleton's
            torques; by default they are as measured, with springs across its
            joints (study's `device`) following the predicted movement.
        folder, resume: see `calibrate_foot_ground`.
        near: prediction of the same trial with another contact, from which to
            start; by default the start is that of the settings. Both have the
            same nodes_per_second.
        clocks: the trial's, among others; found by `find_clocks` by default.

    Raises:
        InputError: the contact lacks the model's cuffs, or trial, settings,
            controller or `near` are faulty.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> study = Study(made.model, made.trials)
    >>> found = predict(study, made.trials[0], made.contact)
    >>> found.success, found.coordinate("exo_hip").shape == found.times.shape
    (True, True)
    """
    check_type(study, Study, "study")
    check_bounds("scale_interaction", scale_interaction, {"above": 0.0})
    if scale_interaction != 1.0 and not study.model.cuffs:
        raise InputError(
            f"scale_interaction is {scale_interaction:g}, but the study's "
            f"model '{study.model.name}' has no cuffs; leave it out"
        )
    study.warn_of(_given([trial]))
    # Refused before the clocks are sought, which takes a solve.
    settings = schema.checked(
        settings, PredictionSettings, "settings", study.prediction
    )
    if near is not None:
        check_type(near, Prediction, "near")
        _check_near(near, trial, settings)
    known = study.worn(contact)
    if clocks is None:
        timing, clocks = _timing(study, trial, known)
        if timing is not None and timing.solution.was_stopped:
            return _prediction(timing)
    for clock in clocks:
        check_type(clock, Clock, "clocks")
    own = tuple(of_trial(trial, clocks))
    trial = retimed(trial, own)
    scaled = timed(known.scaled(scale_interaction), trial, own)
    kind = PeriodicStep if settings.ends == "periodic" else PredictionProblem
    answers = {trial.name: springs_answer(trial, study.device)}
    pose = partial(
        kind,
        *(study.model, [trial], scaled, settings),
        controller=controller,
        answers=answers,
    )
    start = None if near is None else near.result
    result = solve(pose, f"predict {trial.name}", folder, resume, start)
    return _prediction(result, own)


def _check_near(
    near: Prediction, trial: Trial, settings: PredictionSettings
) -> None:
    """Refuse a start whose refined grid belongs to other intervals."""
    if near.coordinates != trial.coordinates:
        raise InputError(
            f"near has the coordinates {', '.join(near.coordinates.names)}, "
            f"but trial {trial.name} has {', '.join(trial.coordinates.names)}; "
            "give a prediction of the same trial"
        )
    own = settings.solver.nodes_per_second
    rate = near.result.problem.settings.solver.nodes_per_second
    if rate != own:
        raise InputError(
            f"near was solved with {rate:g} nodes_per_second, but the settings "
            f"say {own:g}; solve both with the same"
        )
    (posed,) = near.result.problem.trials
    if posed.duration != trial.duration:
        raise InputError(
            f"near lasts {posed.duration:g} s, but trial {trial.name} "
            f"{trial.duration:g} s; give a prediction of the same trial"
        )


def _prediction(
    result: PhaseResult, clocks: tuple[Clock, ...] = ()
) -> Prediction:
    (found,) = result.unsealed().trials
    own = {f.name: getattr(found, f.name) for f in fields(found)}
    return Prediction(**own, result=result, clocks=clocks)


def uncalibrated(
    model: Model, contact: Calibration | ContactModel
) -> ContactModel:
    """The same foot-ground contact with nominal cuffs, for comparison."""
    nominal = nominal_contact(model).bushings
    return replace(contact_of(contact), bushings=nominal, posterior=None)


def contact_of(contact: Calibration | ContactModel) -> ContactModel:
    """The contact of a calibration; a contact is returned as it is.

    Raises:
        InputError: `contact` is neither.
    """
    if isinstance(contact, Calibration):
        return contact.contact
    if not isinstance(contact, ContactModel):
        raise InputError(
            f"contact is {contact!r:.60}; give a calibration, or what "
            "drake_exo.read_contact returns"
        )
    return contact


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def audit_all(result: PhaseResult) -> list[Audit]:
    """Audit every trial of a result, with progress."""
    progress = Progress("simulate", total=len(result.trials))
    rows = []
    for i, trial in enumerate(result.trials):
        rows.append(audit.audit(result, i))
        progress.update(trial.name, done=len(rows))
    return rows


def write_inputs(folder: Path, model: Model, trials: Sequence[Trial]) -> None:
    """Write model and measured trials into the folder of the results."""
    write_model(folder, model)
    for trial in trials:
        trial.save(folder / f"measured_{trial.name}")
