"""Figures of movements: measured curves with those of the model.

A run is a list of solved trials with a label; several runs (C1 and C2) are
drawn over the same measured curves. One column for each trial.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from drake_exo.calibration.bands import Bands
from drake_exo.contact.bushing import NORMAL
from drake_exo.files.verdict import save_figure
from drake_exo.measurement.quality import TrialQuality
from drake_exo.measurement.trial import Trial

Runs = Mapping[str, Sequence[Trial | None]]

_MEASURED = {"color": "0.15", "lw": 1.6}
_MEASURED_DEVICE = {"color": "0.6", "lw": 1.6}
# The paper's: red for the model, in C blue for C1 and red for C2.
_ONE = ("#c8102e",)
_SEVERAL = ("#1f6fb4", "#c8102e", "#2a8c4a", "#8a5fbf")
_DEVICE = "#1f6fb4"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "savefig.dpi": 150,
}


def draw_figures(
    folder: Path,
    found: Sequence[Trial],
    measured: Sequence[Trial],
    uncalibrated: Sequence[Trial | None] = (),
    bands: Sequence[Bands | None] = (),
    mark: str = "",
) -> None:
    """Figures of one phase into a folder, as far as there are signals."""
    figures = plot_trials(found, measured, uncalibrated, bands)
    for name, figure in figures.items():
        save_figure(folder / f"{name}.png", figure, mark)


def plot_trials(
    found: Sequence[Trial],
    measured: Sequence[Trial],
    uncalibrated: Sequence[Trial | None] = (),
    bands: Sequence[Bands | None] = (),
) -> dict[str, Figure]:
    """All figures of some solved trials beside what was measured.

    Args:
        found: solved trials.
        measured: the same trials in the same order.
        uncalibrated: the same as predicted with nominal cuffs, if at all.
        bands: around `found`, if there are any.

    Returns:
        "ground_reaction", "kinematics" and, where there are such signals,
        "interaction" and "moments".

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> list(plot_trials(trials, trials))
    ['ground_reaction', 'kinematics']
    """
    runs: Runs = {"model": found}
    if any(t is not None for t in uncalibrated):
        runs = {"calibrated": found, "uncalibrated": uncalibrated}
    drawn = {
        "ground_reaction": ground_reaction_figure(runs, measured),
        "kinematics": kinematics_figure(runs, measured),
    }
    if found[0].cuffs:
        drawn["interaction"] = interaction_figure(runs, measured, bands)
    if measured[0].moments is not None:
        drawn["moments"] = moments_figure(runs, measured)
    return drawn


def ground_reaction_figure(runs: Runs, trials: Sequence[Trial]) -> Figure:
    """Forces and centre of pressure (Fig. 2)."""
    rows = []
    for side in trials[0].soles:
        foot = "" if side == "both" else f"{side} "
        for name, what in (
            ("$F_x$ [N]", "force_x"),
            ("$F_z$ [N]", "force_z"),
            ("CoP $x$ [m]", "cop_x"),
        ):
            rows.append(
                (
                    foot + name,
                    lambda t, s=side, w=what: getattr(t.soles[s], w),
                )
            )
    return _drawn(runs, trials, rows)


def kinematics_figure(runs: Runs, trials: Sequence[Trial]) -> Figure:
    """Joint angles and velocities of human and exoskeleton (Figs. 3, 6)."""
    names = trials[0].coordinates
    beside = {names.follows(name): name for name in names.device}
    rows = []
    for read, unit in ((Trial.coordinate, "°"), (Trial.velocity, "°/s")):
        for joint in names.human:
            signals = [
                lambda t, name=name, read=read: np.rad2deg(read(t, name))
                for name in (joint, beside.get(joint))
                if name
            ]
            rows.append((f"{joint} [{unit}]", *signals))
    return _drawn(runs, trials, rows, height=1.35)


def interaction_figure(
    runs: Runs, trials: Sequence[Trial], bands: Sequence[Bands | None] = ()
) -> Figure:
    """Normal force of each cuff on the human (Figs. 4, 7).

    Args:
        runs: label -> solved trials.
        trials: as measured.
        bands: around those of the first run, if there are any.
    """
    found = next(t for run in runs.values() for t in run if t is not None)

    def signal(cuff):
        return lambda t: t.cuffs[cuff].normal if cuff in t.cuffs else None

    rows = [(f"{cuff} [N]", signal(cuff)) for cuff in found.cuffs]
    figure = _drawn(runs, trials, rows)
    first = next(iter(runs.values()))
    axes = np.reshape(figure.axes, (len(rows), len(trials)))
    for column, (trial, band) in enumerate(zip(first, bands, strict=False)):
        if band is None or trial is None:
            continue
        for ax, cuff in zip(axes[:, column], found.cuffs, strict=True):
            middle = trial.cuffs[cuff].normal
            width = band.cuffs[cuff][:, NORMAL]
            ax.fill_between(
                trial.times,
                middle - width,
                middle + width,
                color=_SEVERAL[0] if len(runs) > 1 else _ONE[0],
                alpha=0.15,
                lw=0.0,
            )
    return figure


def moments_figure(runs: Runs, trials: Sequence[Trial]) -> Figure:
    """Joint moments, the exoskeleton's on axes of their own (Fig. 5)."""

    def signal(joint):
        return lambda t: None if t.moments is None else t.moment(joint)

    rows = [
        (f"{joint.replace('exo_', 'exo. ')} [N m]", signal(joint))
        for joint in trials[0].coordinates.joints
    ]
    return _drawn(runs, trials, rows, height=1.35)


def front_figure(rows: list[dict]) -> Figure:
    """Pareto front: force error against angle error."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.4))
        ax = figure.subplots()
        x = [r["angles_deg"] for r in rows]
        y = [r["grf_n"] for r in rows]
        ax.plot(x, y, "-o", color="#c8102e")
        for row, a, b in zip(rows, x, y, strict=True):
            ax.annotate(
                f"×{row['factor']:g}",
                (a, b),
                textcoords="offset points",
                xytext=(6, 4),
            )
        ax.set_xlabel("joint angles, mean RMSD [°]")
        ax.set_ylabel("ground reaction, mean RMSD [N]")
        ax.set_title("Noise of forces scaled by a factor", fontsize=9)
        figure.tight_layout()
    return figure


def _drawn(runs, trials, rows, height=1.9) -> Figure:
    """Panels of rows (label, signal[, the device's]) by trial."""
    colors = _ONE if len(runs) == 1 else _SEVERAL
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            figsize=(max(3.0 * len(trials), 4.0), height * len(rows) + 0.6)
        )
        axes = figure.subplots(
            len(rows), len(trials), sharex="col", sharey="row", squeeze=False
        )
        for column, trial in enumerate(trials):
            axes[0, column].set_title(trial.name)
            for row, (label, *signals) in enumerate(rows):
                ax = axes[row, column]
                curves = _measured_curves(trial, signals)
                for k, (name, found) in enumerate(runs.items()):
                    if found[column] is not None:
                        curves += _run_curves(
                            found[column],
                            name,
                            signals,
                            colors[k % len(colors)],
                            len(runs),
                        )
                for times, values, style in curves:
                    ax.plot(times, values, **style)
                if column == 0:
                    ax.set_ylabel(label)
        _finish(figure, axes)
    return figure


def _measured_curves(trial: Trial, signals):
    styles = (
        {"label": "measured", **_MEASURED},
        {"label": "measured, exoskeleton", **_MEASURED_DEVICE},
    )
    found = [(signal(trial), style) for signal, style in zip(signals, styles)]  # noqa: B905
    return [(trial.times, x, style) for x, style in found if x is not None]


def _run_curves(trial: Trial, name: str, signals, color, count):
    style = {"label": name, "color": color, "lw": 1.6, "ls": "--"}
    curves = [(trial.times, signals[0](trial), style)]
    for device in signals[1:]:
        style = {
            "label": f"{name}, exoskeleton",
            "color": _DEVICE if count == 1 else color,
            "lw": 1.3,
            "ls": ":",
        }
        curves.append((trial.times, device(trial), style))
    # Models that are compared may have other cuffs.
    return [curve for curve in curves if curve[1] is not None]


def _finish(figure: Figure, axes) -> None:
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    entries = {}
    for ax in axes.flat:
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    # "measured" first, whichever panel shows it.
    entries = dict(sorted(entries.items(), key=lambda e: e[0] != "measured"))
    figure.align_ylabels()
    columns = min(len(entries), 4)
    legend = 0.1 + 0.22 * -(-len(entries) // columns)  # inches
    top = 1.0 - legend / figure.get_size_inches()[1]
    figure.tight_layout(rect=(0, 0, 1, top))
    figure.set_layout_engine(None)  # saving would lay it out once more
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="upper center",
        ncol=columns,
        frameon=False,
    )


def quality_figure(trial: Trial, quality: TrialQuality) -> Figure:
    """Angles, forces, what Newton misses, moments, mats and markers.

    Args:
        trial: as loaded.
        quality: of the same trial.
    """
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    axes = figure.subplots(2, 3)
    t = trial.start_s + trial.times
    _by_joint(
        axes[0, 0], trial, t, lambda name: np.rad2deg(trial.coordinate(name))
    )
    _finish_axes(axes[0, 0], "angles", "deg")
    _forces(axes[0, 1], trial, t)
    ax = axes[0, 2]
    for column, name in enumerate(("F_x [N]", "F_z [N]", "M [N m]")):
        ax.plot(t, quality.residual[:, column], label=name)
    ax.axhline(0.0, color="0.7", lw=0.8)
    _finish_axes(ax, "missed by Newton's law", "N, N m")
    ax = axes[1, 0]
    if trial.moments is not None:
        _by_joint(ax, trial, t, trial.moment)
    _finish_axes(ax, "joint moments", "N m")
    ax = axes[1, 1]
    for name, force in trial.cuffs.items():
        ax.plot(t, force.normal, label=name)
    _finish_axes(ax, "mats: normal force on the human", "N")
    _markers(axes[1, 2], quality)
    figure.suptitle(trial.name)
    return figure


def _by_joint(ax, trial: Trial, t, signal: Callable) -> None:
    """A signal of every joint, the device's dashed in the human's colour."""
    names = trial.coordinates
    for joint in names.joints:
        device = joint in names.device
        human = names.follows(joint) if device else joint
        ax.plot(
            t,
            signal(joint),
            "--" if device else "-",
            color=f"C{names.human.index(human)}",
            label=joint,
        )


def _forces(ax, trial: Trial, t) -> None:
    for side, wrench in trial.soles.items():
        foot = "feet" if side == "both" else side
        ax.plot(t, wrench.force_x, label=f"{foot} F_x")
        ax.plot(t, wrench.force_z, label=f"{foot} F_z")
    if trial.chair is not None:
        ax.plot(t, trial.chair.force_z, label="chair F_z")
    _finish_axes(ax, "forces on the body", "N")


def _markers(ax, quality: TrialQuality) -> None:
    items = sorted(quality.marker_rms_m.items(), key=lambda item: item[1])
    values = [1e3 * value for _, value in items]
    ax.barh(range(len(items)), values, color="0.6")
    ax.set_yticks(range(len(items)), [name for name, _ in items], fontsize=5)
    ax.set_title("markers' distance from the model", fontsize=9)
    ax.set_xlabel("mm")


def _finish_axes(ax, title: str, unit: str) -> None:
    ax.set_title(title, fontsize=9)
    ax.set_xlabel("s")
    ax.set_ylabel(unit)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=7)
    else:
        ax.text(
            0.5,
            0.5,
            "not measured",
            ha="center",
            color="0.5",
            transform=ax.transAxes,
        )
