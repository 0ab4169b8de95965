"""Results of a phase on disk: model, contact, summary and trajectories."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.calibration.uncertainty import Bands
from drake_exo.contact.bushing import CALIBRATED, COMPONENTS, BushingParameters
from drake_exo.contact.parameters import (
    SPHERE_PARAMETERS,
    TYPICAL_JERK,
    ContactModel,
    ContactSphere,
    GroundContact,
    Posterior,
)
from drake_exo.errors import InputError, check_fields, path_of
from drake_exo.files import schema
from drake_exo.files.opensim import write_table
from drake_exo.files.output import (
    HOLDS,
    SOLVED,
    Check,
    Verdict,
    checksum,
    is_accepted,
    write_json,
)
from drake_exo.files.tables import Table
from drake_exo.measurement.sagittal import external_loads
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model
from drake_exo.nlp.ipopt import Solution

MODEL, PARAMETERS = "model.json", "parameters.json"
_DAMPING = ("tangential_damping", "normal_damping", "rotational_damping")
_PRELOAD = ("preload_x", "preload_z", "preload_angle")
_LARGEST = 1e12  # bound on the size of any parameter, in SI units


def write_model(folder: Path, model: Model) -> None:
    """Write the model with which results were computed into their folder."""
    write_json(folder / MODEL, model)


def read_model(folder: Path) -> Model:
    """Read what `write_model` wrote.

    Raises:
        InputError: it is missing or damaged.
    """
    path = Path(folder) / MODEL
    if not path.is_file():
        raise InputError(
            f"{path}: is missing, so the model of these results is unknown; "
            "run the command that wrote them again"
        )
    return schema.load(path, Model)


@dataclass(frozen=True)
class _StoredPosterior:
    """A `Posterior` as `parameters.json` holds it.

    Attributes:
        names: names of contact parameters and errors of measurement (m,).
        values: mean of each, in SI units.
        covariance: (m, m).
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def read(self, contact: Iterable[str]) -> Posterior:
        """The posterior, of which `contact` names what is no error.

        Raises:
            InputError: it is no covariance, or leaves errors no variance.
        """
        m = len(self.names)
        if len(set(self.names)) < m:
            raise InputError("posterior: names repeat")
        if [len(self.values), *map(len, self.covariance)] != [m] * (m + 1):
            raise InputError("posterior: sizes of its parts differ")
        covariance = np.array(self.covariance).reshape(m, m)
        # Checked as correlations; a parameter at a bound has no variance.
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        sd = np.where(sd > 0.0, sd, 1.0)
        correlation = covariance / np.outer(sd, sd)
        errors = ~np.isin(self.names, list(contact))
        for part, least in (
            (correlation, -1e-6),
            (correlation[np.ix_(errors, errors)], 1e-12),  # it is inverted
        ):
            found = np.linalg.eigvalsh(part)
            if found.min(initial=1.0) < least or (part != part.T).any():
                raise InputError("posterior: the covariance is not positive")
        return Posterior(self.names, np.array(self.values), covariance)


@dataclass(frozen=True)
class Origin:
    """Inputs of a calibration, and its verdict.

    Attributes:
        subject: name of the study's subject.
        model: checksum of subject and device.
        data: trial -> checksum of its measured data.
        verdict: see `Verdict.word`.
        failed: names of the checks that failed.
    """

    subject: str
    model: str
    data: dict[str, str]
    verdict: str
    failed: tuple[str, ...] = ()

    @staticmethod
    def of(subject: str, model: Model, trials, verdict: Verdict) -> Origin:
        """The origin from a phase's inputs and its verdict."""
        return Origin(
            subject,
            checksum(model),
            {t.name: _checksum_of(t) for t in trials},
            verdict.word,
            tuple(dict.fromkeys(c.name for c in verdict.failing)),
        )


def _frames(trials: Iterable[Trial]) -> set[bytes]:
    """Plates' forces in each loaded frame, however trials are cut."""
    return {f.tobytes() for t in trials for f in t.ground.force if f.any()}


def _read_with(trials: Iterable[Trial]) -> dict[str, set[str]]:
    """Setting of how forces and motion are read -> its values in trials."""
    found: dict[str, set[str]] = {}
    for said in (t.provenance for t in trials):
        own = {f"filter.{k}": v for k, v in said.get("filter", {}).items()}
        # An estimated lag is each recording's own.
        if "forces" not in said.get("clocks", ()) and "force_delay_s" in said:
            own["laboratory.force_delay_s"] = said["force_delay_s"]
        for key, value in own.items():
            found.setdefault(key, set()).add(str(value))
    return found


def _words(values: set[str]) -> str:
    return " and ".join(sorted(values))


def _checksum_of(trial: Trial) -> str:
    # Without the device's angles, which are shifted to the clock found.
    return checksum([trial.times, trial.body[0], trial.ground.array])


@dataclass(frozen=True)
class _Stored:
    """A `ContactModel` as `parameters.json` holds it.

    Attributes:
        law: law of the foot-ground contact.
        constants: constants of that law by name.
        parameters: name -> value, of spheres and, after Phase B, of cuffs.
        units: parameter name -> unit.
        damping: cuff -> tangential, normal, rotational damping; empty after
            Phase A.
        preload: cuff -> x, z, angle of its preload; only cuffs that have one.
        posterior: uncertainty of the calibration; None if not calibrated.
        jerk: typical jerk of the calibration's trials [rad/s^3].
        origin: inputs and verdict of the calibration; None if not known.
        of_sole: whether the spheres stand for a sole.
    """

    law: Literal["simbody", "paper"]
    constants: dict[str, float]
    parameters: dict[str, float]
    units: dict[str, str]
    damping: dict[str, tuple[float, float, float]]
    preload: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    posterior: _StoredPosterior | None = None
    jerk: float = field(default=TYPICAL_JERK, metadata={"above": 0.0})
    origin: Origin | None = None
    of_sole: bool = False

    def __post_init__(self):
        settings = FootGroundSettings(self.law, self.constants)
        spheres = self._groups(SPHERE_PARAMETERS)
        cuffs = self._groups(CALIBRATED)
        cuffs |= dict.fromkeys((*self.damping, *self.preload))
        for cuff in cuffs:
            if cuff not in self.damping:
                raise InputError(f"damping of {cuff} is missing")
        ground = {
            s: ContactSphere(**self._values(s, SPHERE_PARAMETERS))
            for s in spheres
        }
        none = (0.0, 0.0, 0.0)
        bushings = {
            c: BushingParameters(
                **self._values(c, CALIBRATED[:-1]),
                slip=self.parameters.get(f"{c}.slip", 0.0),
                **dict(zip(_DAMPING, self.damping[c], strict=True)),
                **dict(zip(_PRELOAD, self.preload.get(c, none), strict=True)),
            )
            for c in cuffs
        }
        for cuff, bushing in bushings.items():
            check_fields(bushing, cuff)
        contact = GroundContact(
            self.law, ground, settings.law_constants(), self.of_sole
        )
        object.__setattr__(
            self,
            "contact",
            ContactModel(
                contact.checked(),
                bushings,
                self.posterior and self.posterior.read(self.parameters),
                self.jerk,
            ),
        )
        for name, unit in self.contact.units().items():
            if self.units.get(name, unit) != unit:
                raise InputError(
                    f"units: {name} is in {self.units[name]!r}, but is read in "
                    f"{unit!r}; give it so"
                )

    def _groups(self, names) -> dict[str, None]:
        """Spheres or cuffs (as keys) that have parameters of these names."""
        parts = (name.rpartition(".") for name in self.parameters)
        return dict.fromkeys(group for group, _, what in parts if what in names)

    def _values(self, group: str, names) -> dict[str, float]:
        found = {}
        for name in names:
            whole = f"{group}.{name}"
            if whole not in self.parameters or whole not in self.units:
                raise InputError(f"{whole} is missing")
            if not abs(self.parameters[whole]) < _LARGEST:
                raise InputError(f"{whole} is out of all bounds")
            found[name] = self.parameters[whole]
        return found


def write_contact(
    folder: Path, contact: ContactModel, origin: Origin | None = None
) -> None:
    """Write all that a later phase needs of the contact.

    Args:
        folder: folder of the results.
        contact: calibrated or not.
        origin: the calibration's; `read_contact` refuses one without it.
    """
    bushings = contact.bushings.items()
    stored = {
        "law": contact.ground.law,
        "constants": contact.ground.constants,
        "parameters": contact.values(),
        "units": contact.units(),
        "damping": {c: b.damping for c, b in bushings},
        "jerk": contact.jerk,
    }
    if_any = {
        "preload": {c: b.preload for c, b in bushings if any(b.preload)},
        "posterior": contact.posterior,
        "of_sole": contact.ground.of_sole,
        "origin": origin,
    }
    stored |= {key: value for key, value in if_any.items() if value}
    write_json(folder / PARAMETERS, stored)


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration on disk.

    Attributes:
        folder: folder from which it was read.
        contact: the calibrated contact.
        origin: its inputs and verdict; None if not known.
    """

    folder: Path
    contact: ContactModel
    origin: Origin | None

    def checks(
        self,
        subject: str,
        model: Model,
        law: str | None,
        trials: Sequence[Trial] = (),
    ) -> list[Check]:
        """Checks "provenance": it holds, and belongs to the study.

        Args:
            subject, model, law: the study's; law is None if a sole's contact
                replaces the calibrated one.
            trials: trials for which it is to be used.
        """
        made_of, own = self.origin, self.own_check
        if made_of is None:
            return [own]
        check, measured = self._check, self._measured
        then, now = _read_with(measured), _read_with(trials)
        differ = [k for k in now if k in then and then[k] != now[k]]
        return [
            own,
            check(
                "subject",
                made_of.subject == subject,
                f"it is of subject {made_of.subject!r}, but the study is of "
                f"{subject!r}",
            ),
            check(
                "model",
                made_of.model == checksum(model),
                "it was made with another model of subject and device (mass, "
                "segments, device or cuffs differ)",
            ),
            check(
                "law",
                law is None or self.contact.ground.law == law,
                f"its foot-ground law is {self.contact.ground.law!r}, but "
                f"the study's is {law!r}",
            ),
            check(
                "unseen",
                # By the data, since the same trial may have another name, or
                # be cut elsewhere from the same recording.
                not {_checksum_of(t) for t in trials}
                & set(made_of.data.values())
                and not _frames(trials) & _frames(measured),
                "it was calibrated on trials that it is to predict",
                "note",
            ),
            check(
                "settings",
                not differ,
                "it was calibrated on recordings read with "
                + ", ".join(f"{k} {_words(then[k])}" for k in differ)
                + ", but the study has "
                + ", ".join(f"{k} {_words(now[k])}" for k in differ),
                "note",
            ),
        ]

    @property
    def _measured(self) -> list[Trial]:
        """What it was calibrated on, as far as it lies beside it."""
        names = [f"measured_{name}" for name in self.origin.data]
        here = [n for n in names if (self.folder / f"{n}.npz").is_file()]
        return [Trial.load(self.folder / n) for n in here]

    @property
    def own_check(self) -> Check:
        """Whether the calibration itself holds."""
        made_of = self.origin
        if made_of is None:
            return self._check(
                "calibration",
                False,
                "it is not known what it was calibrated on; name a folder "
                "that 'drake-exo calibrate' wrote (not a prediction's or a "
                "design's), or run that again",
            )
        return self._check(
            "calibration",
            made_of.verdict == HOLDS,
            f"the calibration itself: {made_of.verdict} "
            f"({', '.join(made_of.failed)})",
        )

    def _check(self, name, holds, sentence, level="fail") -> Check:
        name, where = f"provenance.{name}", self.folder.name
        return Check(name, holds, None, None, "", where, sentence, level)

    def taken(
        self, checks: Sequence[Check], accepted: Sequence[str]
    ) -> ContactModel:
        """The contact, unless a check fails that is not accepted.

        Args:
            checks: some of `checks`.
            accepted: names of checks, or beginnings of them, that may fail.

        Raises:
            InputError: a check fails that is not accepted.
        """
        refused = Verdict(tuple(checks), tuple(accepted)).refused
        if refused:
            why = "; ".join(c.sentence for c in refused)
            options = " ".join(f"--accept {c.name}" for c in refused)
            raise InputError(
                f"{self.folder}: is refused: {why}. Give a calibration of this "
                f"study that holds, or accept it: {options} (in Python "
                f"{[c.name for c in refused]})"
            )
        return self.contact


def read_calibration(folder: str | Path) -> StoredCalibration:
    """Read a calibration from its folder, whether it holds or not.

    Raises:
        InputError: the folder holds no calibration, or a damaged one.
    """
    folder = path_of(folder, "folder")
    path = folder / PARAMETERS
    try:
        stored = schema.load(path, _Stored)
    except InputError as error:
        raise InputError(
            f"no calibrated parameters ({error}); give the folder that a "
            "successful calibration was written to"
        ) from error
    return StoredCalibration(folder, stored.contact, stored.origin)


def read_contact(
    folder: str | Path, accept: Sequence[str] = ()
) -> ContactModel:
    """Read the contact of a calibration that holds.

    Args:
        folder: folder of a calibration's results.
        accept: names of checks that need not hold.

    Raises:
        InputError: the folder holds no calibration, or one that does not hold.

    >>> import tempfile
    >>> from drake_exo.contact.parameters import nominal_contact
    >>> from drake_exo.model.plant import nominal_model
    >>> contact = nominal_contact(nominal_model("coupled"))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_contact(Path(folder), contact)
    ...     found = read_contact(folder, accept=["provenance"])
    ...     found.values() == contact.values()
    True
    """
    found = read_calibration(folder)
    return found.taken([found.own_check], accept)


def solve_summary(solution: Solution) -> dict:
    """Entries of a solve in summary.json: status, sizes and times."""
    return {
        "success": solution.success,
        "status": solution.status,
        "strategy": solution.strategy,
        "iterations": solution.iterations,
        "objective": solution.objective,
        "infeasibility": solution.infeasibility,
        "worst_constraints": solution.worst_constraints,
        "binding_bounds": [str(b) for b in solution.binding],
        "build_seconds": solution.seconds["build"],
        "solve_seconds": solution.seconds["solve"],
        "part_seconds": solution.seconds,
        "evaluations": solution.evaluations,
        "num_variables": solution.num_variables,
        "num_constraints": solution.num_constraints,
        "jacobian_nonzeros": solution.jacobian_nonzeros,
    }


def write_trial(folder: Path, trial: Trial, mark: str = "") -> None:
    """Write motion and forces as OpenSim reads them, and the trial as .npz.

    Args:
        folder: folder of the results.
        trial: a solution.
        mark: `Verdict.mark`, for the first line of each table.
    """
    names = trial.coordinates

    def write(kind, columns, values, title, in_degrees=False):
        path = folder / f"{trial.name}_{kind}.sto"
        table = Table(trial.times, tuple(columns), values, in_degrees)
        write_table(path, table, title, mark)

    for kind, values in (("coordinates", trial.q), ("speeds", trial.v)):
        degrees = np.where(names.is_angle, np.rad2deg(values), values)
        write(kind, names.names, degrees, kind.capitalize(), True)
    columns, force = external_loads(
        {
            "" if side == "both" else f"_{side}": ground
            for side, ground in trial.soles.items()
        }
    )
    write("ground_reaction", columns, force, "Ground reaction")
    moments = [f"{n}_moment" for n in names.joints]
    write("torques", moments, trial.moments, "Joint moments")
    if trial.cuffs:
        columns = [f"{cuff}_{c}" for cuff in trial.cuffs for c in COMPONENTS]
        force = np.hstack([f.components for f in trial.cuffs.values()])
        write("interaction", columns, force, "Interaction on the human")
    trial.save(folder / f"solution_{trial.name}")


def write_bands(
    folder: Path, trial: Trial, found: Bands, mark: str = ""
) -> None:
    """Write lower and upper ends of 95 % bands as a table that OpenSim reads.

    They are around the prediction; JOINT_reading and JOINT_speed_reading are
    around what markers or encoders would show, CUFF_mats around what a cuff's
    mats would show of its normal force: `Bands.coverage` and figures use these.
    """
    names = trial.coordinates
    unit = np.where(names.is_angle, np.rad2deg(1.0), 1.0)
    columns: list[str] = []
    values: list[np.ndarray] = []

    def add(name, middle, width):
        columns.extend((f"{name}_lower", f"{name}_upper"))
        values.extend((middle - width, middle + width))

    for k, name in enumerate(names.names):
        add(name, unit[k] * trial.q[:, k], unit[k] * found.q[:, k])
        add(f"{name}_speed", unit[k] * trial.v[:, k], unit[k] * found.v[:, k])
    q, v = trial.q + found.off_q, trial.v + found.off_v
    for joint in names.joints:
        k = names.index(joint)
        # Infinite where nothing measured the joint.
        if np.isfinite(found.seen_q[:, k]).all():
            at = np.rad2deg([q[:, k], found.seen_q[:, k]])
            add(f"{joint}_reading", *at)
            at = np.rad2deg([v[:, k], found.seen_v[:, k]])
            add(f"{joint}_speed_reading", *at)
    for cuff, width in found.cuffs.items():
        force = trial.cuffs[cuff].components
        for i, component in enumerate(COMPONENTS):
            add(f"{cuff}_{component}", force[:, i], width[:, i])
    for cuff, width in found.mats.items():
        shown = trial.cuffs[cuff].normal + found.off_mats[cuff]
        add(f"{cuff}_mats", shown, width)
    table = Table(
        trial.times, tuple(columns), np.column_stack(values), in_degrees=True
    )
    path = folder / f"{trial.name}_bands.sto"
    write_table(path, table, "Bands of 95 %", mark)


_SOURCES = ("solution", "measured", "uncalibrated", "before", "after")


def read_trial(
    folder: str | Path,
    name: str,
    source: str = "solution",
    accept: Sequence[str] = (),
) -> Trial:
    """Read what `write_trial` wrote, or the measured trial beside it.

    Args:
        folder: folder of the results.
        name: name of the trial.
        source: "solution" or "measured"; for a prediction "uncalibrated" (with
            nominal cuffs); for a design "before" or "after".
        accept: ["solved"] reads where a solve that failed stopped, too.

    Raises:
        InputError: the file is missing or damaged, there is no such source, or
            the trial was not solved and that is not accepted.

    >>> import tempfile
    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, [trial] = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     trial.save(Path(folder) / "measured_rise1")
    ...     read_trial(folder, "rise1", "measured").duration
    1.5
    """
    if source not in _SOURCES:
        raise InputError(
            f"source is {source!r}; give one of {', '.join(_SOURCES)}"
        )
    found = Trial.load(path_of(folder, "folder") / f"{source}_{name}")
    if found.source == "not solved" and not is_accepted(SOLVED, accept):
        raise InputError(
            f"{folder}: trial {name} was not solved; see summary.json, and "
            f"solve it again, or read it all the same with accept=['{SOLVED}']"
        )
    return found
