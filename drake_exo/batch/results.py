"""Results of a batch: one long table, an HTML page, figures, a summary.

The table has one row for each number. The page needs no network; it holds every
distinct text of a column once and rows refer to it by index. Its script draws
only the rows in view, so hundreds of thousands stay usable. Figures show RMSD
over subjects (mean, SD) and predicted against measured peaks (Bland-Altman).
"""

from __future__ import annotations

import base64
import csv
import html
import io
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, fields, replace
from importlib.resources import files
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_exo.batch.file import Task
from drake_exo.batch.run import Batch, read_outcome
from drake_exo.errors import InputError
from drake_exo.files.output import (
    COLOURS,
    FAILS,
    HOLDS,
    STYLE,
    embedded,
    mark_of,
    read_json,
    replace_file,
    save_figure,
    write_json,
)

# A batch that is done already needs neither Drake nor matplotlib.
if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from drake_exo.measurement.trial import Trial

_AGAIN = "run the batch again"
# Replay pages: the one that soles write, and the one of `view --out`.
_REPLAYS = ("animation.html", "replay.html")
# Unit -> ends of keys whose numbers have it; the first unit that fits counts.
_UNITS = {
    "": ("_samples",),
    "N m/rad": ("_nm_per_rad", "c_rot", "c_rot_initial", "c_rot_sole_alone"),
    "N/m": (
        "_n_per_m",
        "c_tr",
        "c_tr_initial",
        "c_tr_sole_alone",
        "c_tr_finite",
        "c_tr_small",
    ),
    "deg/s": ("_deg_s",),
    "N/s": ("_n_s",),
    "cm^3": ("_cm3",),
    "deg": ("_deg",),
    "N m": ("_nm",),
    "kPa": ("_kpa",),
    "mm": ("_mm",),
    "kg": ("_kg",),
    "m": ("_m", "step_length", "aim_x", "aim_y"),
    "N": ("_n", "parts"),
    "s": ("_s", "step_time", "double_support"),
    "W": ("_w",),
}
# Parts of summary.json that are lists of one dictionary for each trial.
_OF_TRIALS = ("rmsd", "rmsd_uncalibrated", "band_coverage", "audit", "solves")
# Parts whose numbers are below names (of joints, cuffs or wearers).
_BY_NAME = (*_OF_TRIALS, "measured_sd", "peaks_n", "wearers_n")
_NOT_TOLD = frozenset(
    ("evaluations", "binding_bounds", "worst_constraints", "settings")
)


@dataclass(frozen=True)
class Row:
    """One number of a batch: a row of its table.

    Attributes:
        subject: name of the subject or sole in the batch.
        trial: name of the trial; "" if the number is not of one trial.
        phase: step of the batch file.
        signal: dotted key of the number.
        value: None in the row of a task without results.
        unit: of the value; "" if it has none.
        verdict: of the task, with its sentence if it does not hold.
        variant: name of what the sweep changed.
        folder: of the results, relative to the batch's.
    """

    subject: str
    trial: str
    phase: str
    signal: str
    value: float | None
    unit: str
    verdict: str
    variant: str
    folder: str


COLUMNS = tuple(f.name for f in fields(Row))


def rows_of(batch: Batch) -> list[Row]:
    """Every number of every task, and a row for each without results.

    Raises:
        InputError: a result file is damaged.
    """
    found = []
    for task in batch.tasks:
        outcome = batch.outcomes[task.name]
        verdict = outcome.verdict
        if outcome.sentence:
            verdict += f": {outcome.sentence}"

        numbers = [] if outcome.code in (0, 3) else [("", "", None, "")]
        # The folder may still hold results of another key.
        lies = read_outcome(batch.out / task.name)
        if lies is not None and lies.key == task.key:
            numbers += _numbers(batch.out, task)
        of = task.variant, task.name
        found += [
            Row(task.entry, trial, task.step, *number, verdict, *of)
            for trial, *number in numbers
        ]
    return found


def _numbers(out: Path, task: Task) -> Iterator[tuple[str, str, float, str]]:
    """(trial, signal, value, unit) of a task's results."""
    folder = out / task.name
    for name, told in (("quality.json", _quality), ("summary.json", _summary)):
        if (folder / name).is_file():
            found = read_json(folder / name, _AGAIN)
            try:
                rows = list(told(found))
            except (AttributeError, LookupError, TypeError) as error:
                raise InputError(
                    f"{folder}: {name} is damaged; {_AGAIN}"
                ) from error
            yield from rows


def _quality(found: dict) -> Iterator[tuple]:
    rest = {k: v for k, v in found.items() if k not in ("trials", "standing")}
    yield from _leaves("", rest, "")
    for trial in found.get("trials", []):
        yield from _leaves(str(trial.get("name", "")), trial, "")


def _summary(summary: dict[str, Any]) -> Iterator[tuple]:
    for part in _OF_TRIALS:
        for found in summary.get(part) or []:
            if isinstance(found, dict):
                yield from _leaves(str(found.get("trial", "")), found, part)
    for clock in summary.get("clocks") or []:
        place = f"clocks.{clock['system']}"
        yield from _leaves(str(clock["trial"]), clock, place)
    for fold in summary.get("folds") or []:
        yield from _leaves(str(fold["trial"]), fold, "")
    for p in summary.get("parameters") or []:
        name = f"parameters.{p['name']}"
        yield "", name, p["value"], p["unit"]
        if p.get("half_width_95") is not None:
            yield "", f"{name}.half_width_95", p["half_width_95"], p["unit"]
    for v in summary.get("variables") or []:  # of a design
        yield "", f"variables.{v['name']}", v["value"], v["unit"]
        yield "", f"variables.{v['name']}.today", v["today"], v["unit"]
    for part, of in (("felt", "cuff"), ("drives", "joint")):
        for row in summary.get(part) or []:
            yield from _leaves("", row, f"{part}.{row[of]}")
    if isinstance(first := summary.get("foot_ground"), dict):
        for trial, name, *told in _summary(first):
            yield trial, f"foot_ground.{name}", *told
    for when, energy in (summary.get("support") or {}).items():
        if energy is not None:
            yield "", f"support.{when}", energy, "J"
    apart = {
        *(*_OF_TRIALS, "folds", "parameters", "checks", "foot_ground"),
        *("variables", "felt", "drives", "support"),
    }
    rest = {k: v for k, v in summary.items() if k not in apart}
    yield from _leaves("", rest, "")


def _leaves(trial: str, tree, place: str) -> Iterator[tuple]:
    """Numbers of nested dictionaries, by dotted key."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key not in _NOT_TOLD:
                where = f"{place}.{key}" if place else key
                yield from _leaves(trial, value, where)
    elif isinstance(tree, list):
        if len(tree) <= 3 and all(_is_number(v) for v in tree):
            for k, value in enumerate(tree):
                yield trial, f"{place}.{k}", float(value), unit_of(place)
    elif _is_number(tree):
        yield trial, place, float(tree), unit_of(place)


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def unit_of(signal: str) -> str:
    """Unit of a number by its dotted name; "" for shares.

    The last part with a known ending counts; the first where names that users
    gave (joints, cuffs) follow.

    >>> unit_of("rmsd.velocities_deg_s.exo_hip"), unit_of("rmsd.cop_mm")
    ('deg/s', 'mm')
    """
    parts = signal.split(".")
    if parts[0] == "band_coverage" and parts[1] != "half_width_n":
        return ""
    if parts[0] == "multipliers":  # of limits that are scaled
        return ""
    if parts[0] not in _BY_NAME:
        parts.reverse()
    for part in parts:
        for unit, ends in _UNITS.items():
            if part.endswith(ends):
                return unit
    return ""


def write_table(folder: Path, rows: list[Row]) -> list[str]:
    """Write results.csv and, where pyarrow is installed, results.parquet.

    Returns:
        Names of the files.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(map(astuple, rows))
    replace_file(folder / "results.csv", text.getvalue().encode())
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return ["results.csv"]
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    kinds = {name: pyarrow.string() for name in COLUMNS}
    kinds["value"] = pyarrow.float64()
    table = pyarrow.table(columns, schema=pyarrow.schema(list(kinds.items())))
    sink = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(table, sink)
    replace_file(folder / "results.parquet", sink.getvalue().to_pybytes())
    return ["results.csv", "results.parquet"]


LARGEST_BYTES = 20_000_000
_BYTES_OF_ROW = 4 / 3 * (4 * (len(COLUMNS) - 1) + 8)
_TEXT_BYTES = 6_000_000  # that pictures, texts and the script may take

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>{css}</style></head><body>
<h1>{title}</h1>
<p>{counts}</p>
{failures}
<section><h2>Over subjects</h2>
<p><label>phase <select id="phase"></select></label>
<label>signal <select id="signal"></select></label>
<label>a box for each <select id="by"><option>variant</option>
<option>subject</option></select></label>
<span id="box-note"></span></p>
<div id="boxes"></div>{pictures}</section>
<section><h2>All numbers</h2>
<p><span id="shown"></span> A click on a name sorts, text below it filters
(numbers: <code>&gt;5</code>, <code>&lt;5</code>).</p>
<div id="head"></div><div id="view"><div id="space"></div></div></section>
<script>const RESULTS = {data};</script>
<script>{script}</script></body></html>
"""


def write_report(
    batch: Batch, rows: list[Row], pictures: dict[str, str]
) -> None:
    """Write report.html.

    Args:
        batch: whose folder it goes to.
        rows: of its table; those that do not hold come first, so that they
            are kept if not all fit.
        pictures: name of a PNG in that folder -> what it shows.
    """
    rows = sorted(rows, key=lambda row: row.verdict == "holds")
    most = int((LARGEST_BYTES - _TEXT_BYTES) / _BYTES_OF_ROW)
    good = len(batch.tasks) - len(batch.bad)
    counts = f"{good} of {len(batch.tasks)} tasks hold."
    if len(rows) > most:
        counts += (
            f" The first {most} of {len(rows)} rows are shown here; all of "
            "them are in results.csv."
        )
    page = _PAGE.format(
        title="Results of a batch",
        css=_asset("report.css"),
        counts=html.escape(counts),
        failures=_failures(batch),
        pictures="".join(
            _picture(batch.out / name, text) for name, text in pictures.items()
        ),
        data=_data(rows[:most], _links(batch)),
        script=_asset("report.js"),
    )
    replace_file(batch.out / "report.html", page.encode())


def _asset(name: str) -> str:
    return files("drake_exo.batch").joinpath(name).read_text("utf-8")


def _failures(batch: Batch) -> str:
    """A table of what failed or does not hold; at most 2 000 of them."""
    if not batch.bad:
        return ""
    lines = []
    for task, found in batch.bad[:2000]:
        cells = (
            _link(batch.out, task.name),
            html.escape(found.verdict),
            html.escape(found.sentence),
        )
        lines.append(f"<tr>{''.join(f'<td>{c}</td>' for c in cells)}</tr>")
    title = f"Failed or does not hold ({len(batch.bad)})"
    return (
        f"<section><h2>{title}</h2><table id='failures'>"
        f"{''.join(lines)}</table></section>"
    )


def _link(out: Path, name: str) -> str:
    text = html.escape(name)
    if not (out / name).is_dir():
        return text
    return f'<a href="{_address(name)}/">{text}</a>'


def _address(name: str) -> str:
    from urllib.parse import quote

    return html.escape(quote(name))


def _links(batch: Batch) -> dict[str, str]:
    """Task -> address of its replay page, for those that have one."""
    return {
        task.name: f"{_address(task.name)}/{page}"
        for task in batch.tasks
        for page in _REPLAYS
        if (batch.out / task.name / page).is_file()
    }


def _picture(path: Path, text: str) -> str:
    caption = f"<figcaption>{html.escape(text)}</figcaption>"
    return f"<figure>{embedded(path, text)}{caption}</figure>"


def _data(rows: list[Row], replays: dict[str, str]) -> str:
    """What the script reads, as JSON."""
    columns = {}
    for name in COLUMNS:
        cells = [getattr(row, name) for row in rows]
        if name == "value":
            numbers = [np.nan if x is None else x for x in cells]
            columns[name] = {"data": _packed(numbers, "f8")}
            continue
        texts = list(dict.fromkeys(cells))
        places = {text: k for k, text in enumerate(texts)}
        numbers = [places[text] for text in cells]
        columns[name] = {"texts": texts, "data": _packed(numbers, "u4")}
    data = {"columns": columns, "count": len(rows), "replays": replays}
    # "</" would end the script that holds the data.
    return json.dumps(data, ensure_ascii=False).replace("</", "<\\/")


def _packed(numbers, kind: str) -> str:
    data = np.asarray(numbers, dtype=f"<{kind}").tobytes()
    return base64.b64encode(data).decode("ascii")


SUMMARY = "summary.json"


def write_results(batch: Batch) -> list[str]:
    """Write results.csv, results.parquet, figures, report.html, summary.json.

    Returns:
        Names of the files in the batch's folder.

    Raises:
        InputError: a result file is damaged.
    """
    rows = rows_of(batch)
    for name in _FIGURES:  # those of an earlier batch file, too
        for old in batch.out.glob(name.replace(".png", "*.png")):
            old.unlink()
    pictures: dict[str, str] = {}
    if any(row.phase == "predict" and row.trial for row in rows):
        rows += peak_rows(batch, rows)
        pictures = draw_figures(batch.out, rows)
    names = write_table(batch.out, rows)
    write_report(batch, rows, pictures)
    write_json(batch.out / SUMMARY, summary(batch))
    return [*names, *pictures, "report.html", SUMMARY]


def is_told(batch: Batch) -> bool:
    """Whether the tables of just these results are already written."""
    names = (SUMMARY, "results.csv", "report.html")
    if not all((batch.out / name).is_file() for name in names):
        return False
    told = read_json(batch.out / SUMMARY, "remove it")
    return not batch.fresh and told == summary(batch)


def summary(batch: Batch) -> dict:
    """What summary.json holds: counts, replays, and how each task ended."""
    found = batch.outcomes
    return {
        "tasks": [
            {
                "name": task.name,
                "key": task.key,
                "step": task.step,
                "code": found[task.name].code,
                "verdict": found[task.name].verdict,
                "sentence": found[task.name].sentence,
            }
            for task in batch.tasks
        ],
        "replays": _links(batch),
        "verdicts": dict(Counter(row.verdict for row in found.values())),
        "verdict": FAILS if batch.bad else HOLDS,
    }


PREDICTED, MEASURED = "peak.predicted.", "peak.measured."
_GROUPS = {
    "rmsd.angles_deg": "RMSD of angles [°]",
    "rmsd.grf_n": "RMSD of ground reaction [N]",
    "rmsd.interaction_n": "RMSD of normal forces [N]",
    "rmsd.moments_nm": "RMSD of joint moments [N m]",
}


def peak_rows(batch: Batch, rows: list[Row]) -> list[Row]:
    """Rows of the largest forces and moments, predicted and measured.

    Args:
        batch: of the results.
        rows: its table, which tells the predicted trials.

    Raises:
        InputError: a trial's files are damaged.
    """
    from drake_exo.calibration.results import read_trial

    found = []
    seen = {}
    for row in rows:
        if row.phase == "predict" and row.trial and row.signal[:5] == "rmsd.":
            seen.setdefault((row.folder, row.trial), row)
    for (folder, trial), row in seen.items():
        place = batch.out / folder
        predicted = _peaks(read_trial(place, trial))
        measured = _peaks(read_trial(place, trial, "measured"))
        both = [key for key in predicted if key in measured]
        found += [
            replace(row, signal=source + key[0], value=peaks[key], unit=key[1])
            for source, peaks in ((PREDICTED, predicted), (MEASURED, measured))
            for key in both
        ]
    return found


def _peaks(trial: Trial) -> dict[tuple[str, str], float]:
    """Largest size of each signal of a trial, by (name, unit)."""
    signals = {("ground reaction", "N"): trial.ground.force_z}
    for cuff, force in trial.cuffs.items():
        signals[f"normal force {cuff}", "N"] = force.normal
    if trial.moments is not None:
        for joint, moment in zip(
            trial.coordinates.joints, trial.moments.T, strict=True
        ):
            signals[f"moment {joint}", "N m"] = moment
    return {k: float(np.nanmax(np.abs(x))) for k, x in signals.items()}


def limits_of_agreement(
    differences: Sequence[float], subjects: Sequence[str]
) -> tuple[float, float, float]:
    """Bland-Altman bias and limits of agreement, bias -/+ 1.96 SD.

    The variance of single differences is that between subjects and that
    within them, by a one-way analysis of variance: Bland, Altman: Agreement
    between methods of measurement with multiple observations per individual.
    J. Biopharmaceutical Statistics 17 (2007).

    Args:
        differences: (n,) predicted minus measured, of each trial.
        subjects: (n,) subject of each trial.
    """
    y, bias = np.asarray(differences, float), float(np.mean(differences))
    _, of = np.unique(np.asarray(subjects), return_inverse=True)
    counts = np.bincount(of)
    means = np.bincount(of, y) / counts
    n, k = len(y), len(counts)
    within = np.sum((y - means[of]) ** 2) / max(n - k, 1)
    variance = within
    if k > 1:
        between = np.sum(counts * (means - bias) ** 2) / (k - 1)
        each = (n - np.sum(counts**2) / n) / (k - 1)  # trials of a subject
        variance += max(between - within, 0.0) / each
    sd = float(np.sqrt(variance))
    return bias, bias - 1.96 * sd, bias + 1.96 * sd


_MOST_VARIANTS = 6  # with pictures of their own, which the page holds


def draw_figures(out: Path, rows: list[Row]) -> dict[str, str]:
    """Draw the figures that there are enough rows for, variant by variant.

    Returns:
        Name of each file -> what it shows.
    """
    import matplotlib

    drawn = {}
    # Soles have no predictions.
    rows = [row for row in rows if row.phase == "predict"]
    variants = list(dict.fromkeys(row.variant for row in rows))
    for variant in variants[:_MOST_VARIANTS]:
        own = [row for row in rows if row.variant == variant]
        end = f"_{variant}" if len(variants) > 1 else ""
        with matplotlib.rc_context(STYLE):
            for name, (draw, shows) in _FIGURES.items():
                figure = draw(own)
                if figure is not None:
                    if end:
                        figure.suptitle(variant, fontsize=9)
                    name = name.replace(".png", f"{end}.png")
                    save_figure(out / name, figure, _mark(own))
                    drawn[name] = f"{variant}: {shows}" if end else shows
    return drawn


def _mark(rows: list[Row]) -> str:
    """Mark for a figure: which of the drawn results do not hold."""
    off = [row.folder for row in rows if not row.verdict.startswith(HOLDS)]
    return mark_of(FAILS, list(dict.fromkeys(off))) if off else ""


def _over_subjects(rows: list[Row]) -> Figure | None:
    """Mean and SD over subjects of each signal's RMSD."""
    from matplotlib.figure import Figure

    from drake_exo.report.gathering import place

    values: dict[str, dict[str, dict]] = {}
    for row in rows:
        if row.value is not None:
            group, _, name = row.signal.rpartition(".")
            if group in _GROUPS:
                of_subjects = values.setdefault(group, {}).setdefault(name, {})
                of_subjects.setdefault(row.subject, []).append(row.value)
    if not values:
        return None
    figure = Figure(figsize=(3.2 * len(values), 3.2), layout="constrained")
    axes = figure.subplots(1, len(values), squeeze=False)[0]
    for ax, (group, signals) in zip(axes, values.items(), strict=True):
        signals = {name: signals[name] for name in sorted(signals, key=place)}
        for k, of_subjects in enumerate(signals.values()):
            means = [np.mean(v) for v in of_subjects.values()]
            sd = np.std(means, ddof=1) if len(means) > 1 else None
            ax.bar(k, np.mean(means), yerr=sd, color="#cfe2f3", capsize=3)
            ax.plot([k] * len(means), means, ".", color="0.2", ms=4)
        look = {"rotation": 60, "ha": "right", "rotation_mode": "anchor"}
        ax.set_xticks(range(len(signals)), list(signals), **look)
        ax.set_ylabel(_GROUPS[group])
        ax.set_ylim(0.0, None)
        counts = [len(of_subjects) for of_subjects in signals.values()]
        fewest, most = min(counts), max(counts)
        span = f"{most}" if fewest == most else f"{fewest} to {most}"
        ax.set_title(f"{span} subject{'s' * (most > 1)}")
    return figure


def _bland_altman(rows: list[Row]) -> Figure | None:
    """Bland-Altman plot of each signal with at least three trials."""
    from matplotlib.figure import Figure

    both: dict[str, dict[tuple, dict[str, Row]]] = {}
    for row in rows:
        for source in (PREDICTED, MEASURED):
            if row.signal.startswith(source):
                signal = row.signal.removeprefix(source)
                trial = both.setdefault(signal, {})
                trial.setdefault((row.folder, row.trial), {})[source] = row
    panels = {name: t for name, t in both.items() if len(t) >= 3}
    if not panels:
        return None
    columns = min(len(panels), 4)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.8 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    subjects = {row.subject: None for row in rows}
    colours = dict(zip(subjects, cycle(COLOURS), strict=False))
    for ax, (signal, trials) in zip(axes, panels.items(), strict=False):
        pairs = [(t[PREDICTED], t[MEASURED]) for t in trials.values()]
        x = np.array([(a.value + b.value) / 2 for a, b in pairs])
        y = np.array([a.value - b.value for a, b in pairs])
        ax.scatter(x, y, s=12, c=[colours[a.subject] for a, _ in pairs])
        for level, style, what in zip(
            limits_of_agreement(y, [a.subject for a, _ in pairs]),
            ("-", "--", "--"),
            ("bias", "−1.96 SD", "+1.96 SD"),
            strict=True,
        ):
            ax.axhline(level, color="0.3", ls=style, lw=0.9)
            ax.annotate(
                f" {what}\n {level:.3g}".replace("-", "−"),
                (1.0, level),
                xycoords=("axes fraction", "data"),
                va="center",
                fontsize=7,
            )
        unit = pairs[0][0].unit
        ax.set_title(f"peak {signal}", fontsize=9)
        ax.set_xlabel(f"mean of both [{unit}]")
        ax.set_ylabel(f"predicted − measured [{unit}]")
    if 1 < len(colours) <= len(COLOURS):  # else one colour, or some twice
        for subject, colour in colours.items():
            axes[0].scatter([], [], s=12, c=colour, label=subject)
        # Beside the panels, whose lines would cross it.
        figure.legend(fontsize=7, loc="outside lower center", ncols=4)
    return figure


_FIGURES = {
    "over_subjects.png": (
        _over_subjects,
        "RMSD of predictions: mean and standard deviation over subjects, a "
        "point for each",
    ),
    "bland_altman.png": (
        _bland_altman,
        "Predicted against measured: largest value of each trial; bias and "
        "limits of agreement (1.96 SD), subjects by colour",
    ),
}
