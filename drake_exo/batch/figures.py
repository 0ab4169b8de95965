"""Figures over subjects: mean and deviation, predicted against measured."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from drake_exo.batch.results import Row
from drake_exo.batch.run import Batch
from drake_exo.calibration.results import read_trial
from drake_exo.files.verdict import FAILS, HOLDS, mark_of, save_figure
from drake_exo.measurement.trial import Trial
from drake_exo.report.figures import STYLE

PREDICTED, MEASURED = "peak.predicted.", "peak.measured."
_GROUPS = {
    "rmsd.angles_deg": "angles [deg]",
    "rmsd.grf_n": "ground reaction [N]",
    "rmsd.interaction_n": "normal forces [N]",
    "rmsd.moments_nm": "joint moments [N m]",
}


def peak_rows(batch: Batch, rows: list[Row]) -> list[Row]:
    """Largest forces and moments of every predicted trial, and measured.

    Args:
        batch: of the results.
        rows: its table, which says what was predicted.

    Raises:
        InputError: a trial's files are damaged.
    """
    found = []
    seen = {}
    for row in rows:
        if row.phase == "predict" and row.trial and row.signal[:5] == "rmsd.":
            seen.setdefault((row.folder, row.trial), row)
    for (folder, trial), row in seen.items():
        place = batch.out / folder
        pair = read_trial(place, trial), read_trial(place, trial, "measured")
        for source, peaks in zip(
            (PREDICTED, MEASURED), _peaks(*pair), strict=True
        ):
            for (signal, unit), value in peaks.items():
                values = vars(row) | {"signal": source + signal}
                found.append(Row(**values | {"value": value, "unit": unit}))
    return found


def _peaks(found: Trial, measured: Trial) -> tuple[dict, dict]:
    """Of signals that both have, by (name, unit)."""
    signals = {
        ("ground reaction", "N"): lambda t: t.ground.force_z,
    }
    for cuff in found.cuffs:
        if cuff in measured.cuffs:
            signals[f"normal force {cuff}", "N"] = lambda t, cuff=cuff: (
                t.cuffs[cuff].normal
            )
    if found.moments is not None and measured.moments is not None:
        for k, joint in enumerate(found.coordinates.joints):
            signals[f"moment {joint}", "N m"] = lambda t, k=k: t.moments[:, k]
    peaks = {}, {}
    for key, signal in signals.items():
        for trial, into in zip((found, measured), peaks, strict=True):
            into[key] = float(np.nanmax(np.abs(signal(trial))))
    return peaks


def limits_of_agreement(differences) -> tuple[float, float, float]:
    """Bias and limits of agreement, bias -/+ 1.96 SD.

    Bland, Altman: Statistical methods for assessing agreement between two
    methods of clinical measurement. Lancet 327 (1986).
    """
    bias = float(np.mean(differences))
    sd = float(np.std(differences, ddof=1))
    return bias, bias - 1.96 * sd, bias + 1.96 * sd


def draw_figures(out: Path, rows: list[Row]) -> dict[str, str]:
    """Draw what there is enough of.

    Returns:
        Name of each file -> what it shows.
    """
    drawn = {}
    mark = _mark(rows)
    with matplotlib.rc_context(STYLE):
        for name, (draw, shows) in _FIGURES.items():
            figure = draw(rows)
            if figure is not None:
                save_figure(out / name, figure, mark)
                drawn[name] = shows
    return drawn


def _mark(rows: list[Row]) -> str:
    """Which of the results that are drawn do not hold."""
    shown = [row for row in rows if row.phase == "predict"]
    off = [row.folder for row in shown if not row.verdict.startswith(HOLDS)]
    return mark_of(FAILS, list(dict.fromkeys(off))) if off else ""


def _over_subjects(rows: list[Row]) -> Figure | None:
    """Mean and SD over subjects of each signal's RMSD."""
    values: dict[str, dict[str, dict]] = {}
    for row in rows:
        if row.phase == "predict" and row.value is not None:
            group, _, name = row.signal.rpartition(".")
            if group in _GROUPS:
                of_subjects = values.setdefault(group, {}).setdefault(name, {})
                of_subjects.setdefault(row.subject, []).append(row.value)
    if not values:
        return None
    figure = Figure(figsize=(3.2 * len(values), 3.2))
    axes = figure.subplots(1, len(values), squeeze=False)[0]
    for ax, (group, signals) in zip(axes, values.items(), strict=True):
        for k, of_subjects in enumerate(signals.values()):
            means = [np.mean(v) for v in of_subjects.values()]
            sd = np.std(means, ddof=1) if len(means) > 1 else 0.0
            ax.bar(k, np.mean(means), yerr=sd, color="#cfe2f3", capsize=3)
            ax.plot([k] * len(means), means, ".", color="0.2", ms=4)
        ax.set_xticks(range(len(signals)), list(signals), rotation=60)
        ax.set_ylabel(_GROUPS[group])
    figure.tight_layout()
    return figure


def _bland_altman(rows: list[Row]) -> Figure | None:
    """A panel for each signal with at least three trials."""
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
    figure = Figure(figsize=(3.2 * columns, 2.8 * lines))
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    subjects = {row.subject: None for row in rows}
    colours = {s: f"C{k % 10}" for k, s in enumerate(subjects)}
    for ax, (signal, trials) in zip(axes, panels.items(), strict=False):
        pairs = [(t[PREDICTED], t[MEASURED]) for t in trials.values()]
        x = np.array([(a.value + b.value) / 2 for a, b in pairs])
        y = np.array([a.value - b.value for a, b in pairs])
        ax.scatter(x, y, s=12, c=[colours[a.subject] for a, _ in pairs])
        for level, style in zip(
            limits_of_agreement(y), ("-", "--", "--"), strict=True
        ):
            ax.axhline(level, color="0.3", ls=style, lw=0.9)
            ax.annotate(
                f"{level:.3g}",
                (1.0, level),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize=7,
            )
        unit = pairs[0][0].unit
        ax.set_title(signal, fontsize=9)
        ax.set_xlabel(f"mean of both [{unit}]")
        ax.set_ylabel(f"predicted - measured [{unit}]")
    figure.tight_layout()
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
        "limits of agreement (1.96 SD)",
    ),
}
