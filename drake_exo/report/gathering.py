"""Finds results of earlier commands, compares them, makes text tables."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.calibration.results import (
    MODEL,
    read_calibration,
    read_model,
    read_trial,
)
from drake_exo.errors import InputError
from drake_exo.files.output import (
    SOLVED,
    checksum,
    is_accepted,
    read_json,
    stored,
    stored_mark,
    summaries,
)
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import without_side

_LARGEST = 1e30  # of a score
_PHASES = ("foot-ground", "interaction", "prediction")


@dataclass(frozen=True)
class Results:
    """Results that one phase wrote to a folder.

    Attributes:
        folder: the folder.
        summary: contents of its summary.json.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def phase(self) -> str:
        """foot-ground, interaction or prediction."""
        return self.summary["phase"]

    @property
    def scale(self) -> float:
        """Factor of a prediction on stiffness and damping of the cuffs."""
        return self.summary.get("scale_interaction", 1.0)

    @property
    def label(self) -> str:
        """The paper's name of a prediction (C1, C2), and what else differs."""
        parts = ["C1" if self.scale == 1.0 else "C2"]
        if self.scale not in (1.0, 1.4):
            parts.append(f"x{self.scale:g}")
        objective = self.summary.get("objective") or "tracking"
        if objective != "tracking":
            parts.append(objective)
        if self.summary.get("controller"):
            parts.append(self.summary["controller"].rpartition(":")[2])
        return " ".join(parts)

    @property
    def mark(self) -> str:
        """Text to show wherever the result is shown; empty if it holds."""
        return stored_mark(self.summary)

    @property
    def is_solved(self) -> bool:
        """Whether every solve met its tolerances."""
        return bool(self.summary.get("success"))

    @property
    def not_solved(self) -> list[str]:
        """Names of trials of a prediction that were not solved."""
        solves = self.summary.get("solves", [])
        return [s["trial"] for s in solves if not s.get("success")]

    @property
    def uncalibrated(self) -> list[dict]:
        """Scores of a prediction's trials with nominal cuffs, if any."""
        rows = self.summary.get("rmsd_uncalibrated", [])
        return [row for row in rows if row is not None]

    def pairs(self) -> list[tuple[Trial, Trial]]:
        """Every scored trial, as computed and as measured."""
        return [
            (
                read_trial(self.folder, row["trial"], accept=[SOLVED]),
                read_trial(self.folder, row["trial"], "measured"),
            )
            for row in self.summary["rmsd"]
        ]

    def uncalibrated_trial(self, trial: str) -> Trial | None:
        """A trial predicted with nominal cuffs; None if not solved."""
        source = "uncalibrated"
        if not (self.folder / f"{source}_{trial}.json").is_file():
            return None
        return read_trial(self.folder, trial, source)


def not_solved_uncalibrated(summary: dict[str, Any]) -> list[str]:
    """Names of trials that were not solved with nominal cuffs."""
    rows = summary.get("rmsd_uncalibrated", [])
    pairs = zip(summary["rmsd"], rows, strict=False)
    return [row["trial"] for row, usual in pairs if usual is None]


def gather(folder: Path, accept: Sequence[str] | None = None) -> list[Results]:
    """All results under a folder, in the order of their paths.

    Args:
        folder: to look through.
        accept: "solved" keeps what was not solved, marked; None if the
            command has no --accept.

    Raises:
        InputError: there are none, a summary cannot be read, one is of a
            solve that failed, or no trial of any was solved.
    """
    found = []
    for path in summaries(folder):
        summary = read_json(path, "run the command that wrote it again")
        if isinstance(summary, dict) and summary.get("phase") in _PHASES:
            _check(path, summary)
            found.append(Results(path.parent, summary))
    if not found:
        raise InputError(
            f"{folder}: holds no results; give a folder that 'drake-exo "
            "calibrate' or 'drake-exo predict' wrote"
        )
    failed = [r for r in found if not r.is_solved]
    if failed and not is_accepted(SOLVED, accept or ()):
        way = "" if accept is None else ", or show it, marked, with --accept"
        raise InputError(
            f"{failed[0].folder}: is {failed[0].mark or 'not solved'}; solve "
            f"it again{way and f'{way} {SOLVED}'}"
        )
    shown = [r for r in found if r.summary["rmsd"]]
    if not shown:
        raise InputError(
            f"{folder}: holds no solved trial; see its summary.json"
        )
    return shown


def check_one_study(found: Sequence[Results]) -> None:
    """Refuse results that one table would mix up.

    Raises:
        InputError: results are of several subjects, or two have one label.
    """
    first: dict[tuple, Results] = {}
    for r in found:
        if r.summary["subject"] != found[0].summary["subject"]:
            raise InputError(
                f"{r.folder}: is of subject {r.summary['subject']!r}, but "
                f"{found[0].folder} is of {found[0].summary['subject']!r}; "
                "report a folder of one subject"
            )
        bodies = {_body(r), _body(found[0])} - {None}
        if len(bodies) > 1:
            raise InputError(
                f"{r.folder}: is of a subject of the same name as that of "
                f"{found[0].folder}, but with another body; report a folder "
                "of one subject"
            )
        label = r.label if r.phase == "prediction" else ""
        other = first.setdefault((r.phase, label), r)
        if other is not r:
            raise InputError(
                f"{r.folder}: this and {other.folder} are both "
                f"{label or r.phase}; report a folder with one of them"
            )


def _body(results: Results) -> str | None:
    """Checksum of a subject's segments; None if they were not written."""
    if not (results.folder / MODEL).is_file():
        return None
    person = read_model(results.folder).human
    return checksum([person.foot, person.shank, person.thigh, person.pelvis])


def _check(path: Path, summary: dict[str, Any]) -> None:
    """Refuse a summary that is not as a phase writes it."""
    stored(summary, path)
    rows = summary.get("rmsd")
    usual = summary.get("rmsd_uncalibrated", [])
    solves = summary.get("solves", [])
    parameters = summary.get("parameters", [])
    whole = (
        isinstance(rows, list)
        and isinstance(usual, list)
        and all(isinstance(r, dict | None) and _are_scores(r) for r in usual)
        and isinstance(solves, list)
        and all(
            isinstance(s, dict) and isinstance(s.get("trial"), str)
            for s in solves
        )
        and isinstance(summary.get("subject"), str)
        and _is_number(summary.get("scale_interaction", 1.0))
        and _is_objective(summary)
        and isinstance(summary.get("controller"), str | None)
        and all(isinstance(r, dict) and _are_scores(r) for r in rows)
        and all(isinstance(r.get("trial"), str) for r in rows)
        and isinstance(summary.get("measured_sd"), dict)
        and _are_scores(summary["measured_sd"])
        and isinstance(parameters, list)
        and all(map(_is_parameter, parameters))
    )
    if not whole:
        raise InputError(
            f"{path}: is not as a phase writes it (subject, rmsd, "
            "measured_sd, parameters); run the command that wrote it again"
        )


def _is_objective(summary: dict[str, Any]) -> bool:
    """Whether it is a prediction's name, or a calibration's value reached."""
    found = summary.get("objective")
    if summary["phase"] == "prediction":
        return isinstance(found, str | None)
    return found is None or _is_number(found)


def _is_parameter(row: Any) -> bool:
    return (
        isinstance(row, dict)
        and isinstance(row.get("name"), str)
        and isinstance(row.get("unit"), str)
        and _is_number(row.get("value"))
        and _are_scores(row.get("half_width_95"))
    )


def _are_scores(value: Any) -> bool:
    """Whether it is a number, None, or nested dictionaries of these."""
    if isinstance(value, dict):
        return all(k == "trial" or _are_scores(v) for k, v in value.items())
    return value is None or _is_number(value)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) < _LARGEST


# Keys of summary.json that say how a result was asked for.
_ASKED = (
    "subject",
    "settings",
    "scale_interaction",
    "controller",
    "design",
    "accepted",
)


@dataclass(frozen=True)
class Comparison:
    """Results of one phase, side by side.

    Attributes:
        labels: shortest names that tell the folders apart.
        results: one for each label.
        trials: names of the trials that all results have.
        runs: these trials as each result has them.
        measured: likewise, as measured.
    """

    labels: tuple[str, ...]
    results: tuple[Results, ...]
    trials: tuple[str, ...]
    runs: list[list[Trial]]
    measured: list[list[Trial]]

    def text(self) -> str:
        """All tables as text, with marks of results that do not hold."""
        settings = self.settings()
        parts = [
            ("what differs in settings", settings),
            ("parameters", self.parameters()),
            ("RMSD, mean of the trials that all have", self.rmsd()),
            ("largest forces, mean of these trials", self.forces()),
        ]
        tables = [
            f"{title}\n{self._table(rows)}" for title, rows in parts if rows
        ]
        marks = [f"{name}: {mark}" for name, mark in self.marks().items()]
        same = [] if settings else ["no setting differs"]
        return "\n\n".join([*marks, *same, *tables])

    def marks(self) -> dict[str, str]:
        """Label -> mark of each result that does not hold."""
        pairs = zip(self.labels, self.results, strict=True)
        return {label: r.mark for label, r in pairs if r.mark}

    def _table(self, rows: dict[str, list[str]]) -> str:
        count = max(map(len, rows.values())) - len(self.labels)
        header = ["", *self.labels, *["measured"] * count]
        return format_table(header, [[k, *cells] for k, cells in rows.items()])

    def settings(self) -> dict[str, list[str]]:
        """Dotted key -> value of each result, for keys that differ.

        Includes the contact that predictions use; if all are of one subject,
        the model and the common trials' windows; and the filter of the first
        of these trials, and the lags that were taken out of its recordings. If
        these are the same, a checksum tells whether something else made the
        measured trials differ, such as loads, axes or a belt.
        """
        found, sums = [], []
        for r, measured in zip(self.results, self.measured, strict=True):
            asked = {k: r.summary.get(k) for k in _ASKED}
            asked["accepted"] = ", ".join(asked["accepted"] or ()) or None
            if r.phase == "prediction":  # else it is the value reached
                asked["objective"] = r.summary.get("objective")
                asked["contact"] = read_calibration(r.folder).contact.values()
            if self._is_of_one():
                asked["model"] = asdict(read_model(r.folder))
                asked["window"] = {
                    t.name: {"start_s": t.start_s, "duration_s": t.duration}
                    for t in measured
                }
            asked["filter"] = measured[0].provenance.get("filter")
            # As the study gives them, without what was found since.
            found_since = measured[0].shifts_s
            asked |= {
                f"lag_of_{system}_s": round(lag - found_since.get(system, 0), 3)
                for system, lag in measured[0].lags_s.items()
            }
            found.append(dict(_leaves(asked, "")))
            loads = [w.array for t in measured for w in t.applied.values()]
            own = [x for t in measured for x in (t.body[0], t.ground.array)]
            sums.append(checksum([*own, *loads])[:8])
        rows = {}
        for key in dict.fromkeys(key for asked in found for key in asked):
            cells = [_plain(asked.get(key)) for asked in found]
            if len(set(cells)) > 1:
                rows[key] = _first_difference(cells)
        told = any(k.startswith(("window", "filter", "lag_of")) for k in rows)
        if self._is_of_one() and len(set(sums)) > 1 and not told:
            rows["measured trials, checksum"] = sums
        return rows

    def _is_of_one(self) -> bool:
        """Whether all results are of one subject."""
        return len({r.summary["subject"] for r in self.results}) == 1

    def parameters(self) -> dict[str, list[str]]:
        """Name and unit -> value and half of the 95 % interval of each."""
        rows: dict[str, list[str]] = {}
        for k, r in enumerate(self.results):
            for p in r.summary.get("parameters", []):
                row = rows.setdefault(
                    f"{p['name']} [{p['unit']}]", ["-"] * len(self.results)
                )
                half = p.get("half_width_95")
                width = "" if half is None else f" ± {half:.2g}"
                row[k] = f"{p['value']:.4g}{width}"
        return rows

    def rmsd(self) -> dict[str, list[str]]:
        """Signal -> mean over the common trials, of each result."""
        ours = [
            [row for row in r.summary["rmsd"] if row["trial"] in self.trials]
            for r in self.results
        ]
        signals = rmsd_signals([row for rows in ours for row in rows])
        return {
            label: [
                _cell(mean_and_sd([lookup(row, path) for row in rows])[0])
                for rows in ours
            ]
            for label, path in signals
        }

    def forces(self) -> dict[str, list[str]]:
        """Signal -> largest value (mean of trials) of each result, measured.

        For a cuff over the trials in which a mat measured it, if any.
        """
        measured = self.measured[0]
        runs = [*self.runs, measured]
        cuffs = dict.fromkeys(c for run in runs for t in run for c in t.cuffs)
        rows = {
            "ground reaction, vertical [N]": [
                _peak([t.ground.force_z for t in run]) for run in runs
            ]
        }
        for cuff in cuffs:
            # Not every trial has mats on every cuff: compare the same ones.
            use = [cuff in t.cuffs for t in measured]
            use = use if any(use) else [True] * len(use)
            rows[f"normal force {cuff} [N]"] = [
                _peak(
                    [
                        t.cuffs[cuff].normal
                        for t, wanted in zip(run, use, strict=True)
                        if wanted and cuff in t.cuffs
                    ]
                )
                for run in runs
            ]
        return rows

    def figures(self) -> dict:
        """Figures of all results over the measured curves, by name.

        For one subject in the first result's times, since windows may differ.
        """
        from drake_exo.report import figures

        measured = self.measured[0]
        runs = dict(zip(self.labels, self.runs, strict=True))
        if self._is_of_one():
            runs = {
                label: [
                    replace(t, times=t.times + (t.start_s - m.start_s))
                    for t, m in zip(run, measured, strict=True)
                ]
                for label, run in runs.items()
            }
        drawn = {
            "kinematics": figures.kinematics_figure(runs, measured),
            "ground_reaction": figures.ground_reaction_figure(runs, measured),
        }
        if all(t.cuffs for run in runs.values() for t in run):
            drawn["interaction"] = figures.interaction_figure(runs, measured)
        return drawn


def compare(folders: Sequence[str | Path]) -> Comparison:
    """Compare results of one phase.

    Args:
        folders: at least two, each of one `calibrate` or `predict`.

    Raises:
        InputError: a folder holds no results, or several; or they cannot be
            compared: different phases or coordinates, no trial in common.
    """
    if len(folders) < 2:
        raise InputError("one result cannot be compared; give two or more")
    results = tuple(_results(Path(folder)) for folder in folders)
    first = results[0]
    for r in results[1:]:
        if r.phase != first.phase:
            raise InputError(
                f"{first.folder} is of phase {first.phase}, but {r.folder} is "
                f"of {r.phase}; compare results of one phase"
            )
    names = [[row["trial"] for row in r.summary["rmsd"]] for r in results]
    common = tuple(n for n in names[0] if all(n in own for own in names))
    if not common:
        raise InputError(
            f"{first.folder} and {results[-1].folder} have no trial in "
            "common; compare results of the same trials"
        )
    runs, measured = (
        [
            [read_trial(r.folder, n, source, [SOLVED]) for n in common]
            for r in results
        ]
        for source in ("solution", "measured")
    )
    for r, (trial, *_) in zip(results, runs, strict=True):
        if trial.coordinates.names != runs[0][0].coordinates.names:
            raise InputError(
                f"{first.folder} and {r.folder} are of models with other "
                "coordinates; compare results of one model"
            )
    labels = _labels([r.folder for r in results])
    return Comparison(labels, results, common, runs, measured)


def _results(folder: Path) -> Results:
    """The results in a folder itself, or the only ones below it."""
    found = gather(folder)
    own = [r for r in found if r.folder == folder]
    if not own and len(found) > 1:
        raise InputError(
            f"{folder}: holds {len(found)} results; name one of them, such "
            f"as {found[0].folder}"
        )
    return (own or found)[0]


def _labels(folders: list[Path]) -> tuple[str, ...]:
    """The parts of paths that tell them apart; numbers where none does."""
    parts = [Path(os.path.abspath(f)).parts for f in folders]
    while all(len(p) > 1 for p in parts) and len({p[0] for p in parts}) == 1:
        parts = [p[1:] for p in parts]
    while all(len(p) > 1 for p in parts) and len({p[-1] for p in parts}) == 1:
        parts = [p[:-1] for p in parts]
    labels = ["/".join(p) for p in parts]
    if len(set(labels)) < len(labels):
        labels = [f"{k + 1}: {label}" for k, label in enumerate(labels)]
    return tuple(labels)


def _leaves(tree: Any, place: str):
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _leaves(value, f"{place}.{key}" if place else key)
    else:
        yield place, tree


def _plain(value) -> str:
    if value is None:
        return "-"
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_plain, value))})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _first_difference(cells: list[str]) -> list[str]:
    """Cells; of texts such as a device's file, the first place that differs."""
    if not any("\n" in cell for cell in cells):
        return cells
    together = enumerate(zip(*cells, strict=False))
    differ = (at for at, of in together if len(set(of)) > 1)
    at = next(differ, min(map(len, cells)))
    line = cells[0].count("\n", 0, at) + 1
    start = max(cells[0].rfind("\n", 0, at) + 1, at - 24)
    parts = [cell[start : at + 16].partition("\n")[0] for cell in cells]
    return [f"line {line}: {part}" for part in parts]


def _peak(signals: list[np.ndarray]) -> str:
    """Mean of the signals' largest absolute values, as text."""
    peaks = [np.nanmax(np.abs(x)) for x in signals]
    return _cell(float(np.mean(peaks)) if peaks else None)


def format_table(
    header: Sequence[str], rows: Sequence[Sequence], digits: int = 2
) -> str:
    """Text table with aligned columns; numbers have `digits` decimals."""
    cells = [[_cell(value, digits) for value in row] for row in rows]
    widths = [
        max(len(row[i]) for row in [list(header), *cells])
        for i in range(len(header))
    ]

    def line(row):
        first = row[0].ljust(widths[0])
        rest = (c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))
        return "  ".join([first, *rest]).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(list(header)), rule, *map(line, cells)])


def _cell(value, digits: int = 2) -> str:
    if isinstance(value, str):
        return value
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.{digits}f}"


def rmsd_table(rmsd: list[dict], spread: dict | None = None) -> str:
    """Text table of every signal's RMSD: each trial, mean, SD, and spread.

    Args:
        rmsd: one dictionary for each trial, see `audit.rmsd`.
        spread: one standard deviation over the measured trials.
    """
    header = ["RMSD", *(r["trial"] for r in rmsd), "mean", "SD"]
    if spread is not None:
        header.append("measured SD")
    rows = []
    for label, path in rmsd_signals(rmsd):
        values = [lookup(r, path) for r in rmsd]
        row = [label, *values, *mean_and_sd(values)]
        if spread is not None:
            row.append(lookup(spread, path))
        rows.append(row)
    return format_table(header, rows)


def mean_and_sd(values) -> tuple[float | None, float | None]:
    """Mean and standard deviation of those that are not None."""
    known = [v for v in values if v is not None]
    sd = float(np.std(known, ddof=1)) if len(known) > 1 else None
    return (float(np.mean(known)) if known else None), sd


_ORDER = (
    *("ankle", "knee", "hip", "exo_ankle", "exo_knee", "exo_hip"),
    *("horizontal", "vertical", "pelvis", "thigh", "shank"),
)
_UNITS = {
    "angles_deg": "angle {} [deg]",
    "velocities_deg_s": "velocity {} [deg/s]",
    "grf_n": "ground reaction {} [N]",
    "cop_mm": "centre of pressure {} [mm]",
    "moments_nm": "moment {} [N m]",
    "interaction_n": "normal force {} [N]",
}


def rmsd_signals(rmsd: list[dict]):
    """(label, path of keys) of every signal that some trial has."""
    for key, label in _UNITS.items():
        names: dict = {}
        for trial in rmsd:
            value = trial.get(key, {})
            if not isinstance(value, dict):
                yield label.replace(" {}", ""), (key,)
                break
            names |= dict.fromkeys(value)
        for name in sorted(names, key=place):
            yield label.format(name), (key, name)


def place(name: str) -> tuple[int, str]:
    """Sort key of a coordinate, component or segment in a table.

    Left is beside right; unknown names are last, by name: files keep no order.
    """
    both = without_side(name.replace(" ", "_"))
    return _ORDER.index(both) if both in _ORDER else len(_ORDER), name


def lookup(tree, path) -> float | None:
    """Number at a path of keys in nested dictionaries; None without one."""
    for key in path:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return None if tree is None or isinstance(tree, dict) else float(tree)


def parameters_table(parameters: list[dict]) -> str:
    """Text table of a summary's parameters; a phrase if there are none."""
    if not parameters:
        return "no parameters: the law of a sole is known"
    rows = [
        [
            p["name"],
            f"{p['value']:.4g}",
            _interval(p),
            f"{p['lower']:.4g}",
            f"{p['upper']:.4g}",
            p["unit"],
            _remark(p),
        ]
        for p in parameters
    ]
    header = ["parameter", "value", "95 %", "lower", "upper", "unit", ""]
    return format_table(header, rows)


def _remark(parameter: dict) -> str:
    if not parameter["free"]:
        return "fixed"
    if parameter["at_bound"]:
        return "at bound"
    return "" if parameter.get("identifiable", True) else "weakly determined"


def _interval(parameter: dict) -> str:
    half = parameter.get("half_width_95")
    return "-" if half is None else f"± {half:.2g}"


def clocks_table(clocks: list[dict]) -> str:
    """Text table of clocks, given as in summary.json."""
    rows = [
        [
            f"{c['trial']}, {c['system']}",
            f"{1e3 * c['lag_s']:+.0f}",
            f"± {1e3 * c['half_width_95_s']:.0f}",
            "" if c["sure"] else "unsure",
        ]
        for c in clocks
    ]
    return format_table(["clock", "lag [ms]", "95 %", ""], rows)


def audit_table(rows: list[dict]) -> str:
    """Text table of audits, given as in summary.json, by trial."""
    header = [
        "audit",
        "between nodes [N]",
        "[N m]",
        "simulated F_x [N]",
        "F_z [N]",
        "angles [deg]",
        "interaction [N]",
    ]
    return format_table(
        header,
        [
            [
                r["trial"],
                r["force_n"],
                r["moment_nm"],
                *r["simulated_grf_n"],
                r["simulated_angles_deg"],
                r["simulated_interaction_n"],
            ]
            for r in rows
        ],
    )


def front_table(rows: list[dict]) -> str:
    """Text table of a Pareto front, as `pareto_front` finds it."""
    header = [
        "noise of forces ×",
        "angles [deg]",
        "worst",
        "velocities [deg/s]",
        "worst",
        "GRF [N]",
        "worst",
        "CoP [mm]",
        "worst",
    ]
    keys = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")
    return format_table(
        header,
        [
            [
                f"{r['factor']:g}" + ("" if r["success"] else " (failed)"),
                *(r[k + e] for k in keys for e in ("", "_worst")),
            ]
            for r in rows
        ],
    )
