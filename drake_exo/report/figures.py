"""Figures 2 to 7 of the paper: measured curves with those of the model.

A run is a list of trajectories with a label; several runs (C1 and C2) are
drawn over the same measured curves. One column for each trial.

A trial's quality at a glance.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import Trajectory
from drake_exo.calibration.scores import measured_cop, normal_force
from drake_exo.collocation.bushing_kernels import BUSHINGS
from drake_exo.measurement.quality import TrialQuality
from drake_exo.measurement.trial import Trial

matplotlib.use("Agg")


Runs = Mapping[str, Sequence[Trajectory]]

_MEASURED = {"color": "0.15", "lw": 1.6}
_MEASURED_DEVICE = {"color": "0.6", "lw": 1.6}
# The paper's: red for the model, in C blue for C1 and red for C2.
_ONE = ("#c8102e",)
_SEVERAL = ("#1f6fb4", "#c8102e", "#2a8c4a", "#8a5fbf")
_DEVICE = "#1f6fb4"
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "savefig.dpi": 150,
}
_JOINTS = ("ankle", "knee", "hip")


def draw_figures(
    folder: Path,
    trajectories: Sequence[Trajectory],
    trials: Sequence[MeasuredMovement],
) -> None:
    """Figures of one phase into a folder, as far as there are signals."""
    runs = {"model": trajectories}
    ground_reaction_figure(folder / "ground_reaction.png", runs, trials)
    kinematics_figure(folder / "kinematics.png", runs, trials)
    if trajectories[0].interaction is not None:
        interaction_figure(folder / "interaction.png", runs, trials)
    if trials[0].moments is not None:
        moments_figure(folder / "moments.png", runs, trials)


def ground_reaction_figure(
    path: Path, runs: Runs, trials: Sequence[MeasuredMovement]
) -> None:
    """Forces and centre of pressure (Fig. 2)."""
    rows = [
        ("$F_x$ [N]", _same(lambda g: g.ground[:, 0])),
        ("$F_z$ [N]", _same(lambda g: g.ground[:, 1])),
        ("CoP $x$ [m]", _same(_cop)),
    ]
    _draw(path, runs, trials, rows)


def kinematics_figure(
    path: Path, runs: Runs, trials: Sequence[MeasuredMovement]
) -> None:
    """Joint angles and velocities of human and exoskeleton (Figs. 3, 6)."""
    rows = []
    for key, unit in (("q", "°"), ("v", "°/s")):
        for joint, name in enumerate(_JOINTS):

            def signal(item, key=key, joint=joint):
                return np.rad2deg(getattr(item, key)[:, 3 + joint])

            def device(item, key=key, joint=joint):
                return np.rad2deg(getattr(item, key)[:, 6 + joint])

            rows.append((f"{name} [{unit}]", signal, signal, device))
    _draw(path, runs, trials, rows, height=1.35)


def interaction_figure(
    path: Path, runs: Runs, trials: Sequence[MeasuredMovement]
) -> None:
    """Normal force of each cuff on the human (Figs. 4, 7)."""
    rows = []
    for name in BUSHINGS:

        def found(item, name=name):
            return normal_force(item, name)

        def measured(item, name=name):
            return item.normal_force.get(name)

        rows.append((f"{name} [N]", found, measured))
    _draw(path, runs, trials, rows)


def moments_figure(
    path: Path, runs: Runs, trials: Sequence[MeasuredMovement]
) -> None:
    """Joint moments, the exoskeleton's on axes of their own (Fig. 5)."""
    rows = []
    prefixes = ["", "exo. "] if trials[0].q.shape[1] > 6 else [""]
    for block, prefix in enumerate(prefixes):
        for joint, name in enumerate(_JOINTS):

            def found(item, column=3 * block + joint):
                return item.torque[:, column]

            def measured(item, column=3 * block + joint):
                return None if item.moments is None else item.moments[:, column]

            rows.append((f"{prefix}{name} [N m]", found, measured))
    _draw(path, runs, trials, rows, height=1.35)


def front_figure(path: Path, rows: list[dict]) -> None:
    """Pareto front: force error against angle error."""
    with plt.rc_context(_STYLE):
        figure, ax = plt.subplots(figsize=(4.5, 3.4))
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
        figure.savefig(path, metadata={"Software": None})
        plt.close(figure)


def _cop(item):
    return item.cop_x if isinstance(item, Trajectory) else measured_cop(item)


def _same(signal: Callable):
    return signal, signal


def _draw(path, runs, trials, rows, height=1.9) -> None:
    """Panels of rows (label, of a run, of a trial[, device's]) by trial."""
    rows = [
        (row[0], *row[1]) if isinstance(row[1], tuple) else row for row in rows
    ]
    colors = _ONE if len(runs) == 1 else _SEVERAL
    with plt.rc_context(_STYLE):
        figure, axes = _panels(len(rows), len(trials), height)
        for column, trial in enumerate(trials):
            axes[0, column].set_title(trial.name)
            for row, (label, found, measured, *device) in enumerate(rows):
                ax = axes[row, column]
                curves = _measured_curves(trial, measured, device)
                for k, (name, trajectories) in enumerate(runs.items()):
                    item = trajectories[column]
                    if item is not None:
                        curves += _run_curves(
                            item, name, found, device, colors[k], len(runs)
                        )
                for times, values, style in curves:
                    ax.plot(times, values, **style)
                if column == 0:
                    ax.set_ylabel(label)
        _finish(figure, axes, path)


def _measured_curves(trial, measured, device):
    values = measured(trial)
    if values is None:
        return []
    curves = [(trial.times, values, {"label": "measured", **_MEASURED})]
    if device and trial.q.shape[1] > 6:
        style = {"label": "measured, exoskeleton", **_MEASURED_DEVICE}
        curves.append((trial.times, device[0](trial), style))
    return curves


def _run_curves(item, name, found, device, color, count):
    style = {"label": name, "color": color, "lw": 1.6, "ls": "--"}
    curves = [(item.times, found(item), style)]
    if device and item.q.shape[1] > 6:
        device_color = _DEVICE if count == 1 else color
        style = {
            "label": f"{name}, exoskeleton",
            "color": device_color,
            "lw": 1.3,
            "ls": ":",
        }
        curves.append((item.times, device[0](item), style))
    return curves


def _panels(rows, columns, height):
    return plt.subplots(
        rows,
        columns,
        figsize=(max(3.0 * columns, 4.0), height * rows + 0.6),
        sharex="col",
        sharey="row",
        squeeze=False,
    )


def _finish(figure, axes, path):
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    entries = {}
    for ax in axes.flat:
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.align_ylabels()
    columns = min(len(entries), 4)
    legend = 0.1 + 0.22 * -(-len(entries) // columns)  # inches
    top = 1.0 - legend / figure.get_size_inches()[1]
    figure.tight_layout(rect=(0, 0, 1, top))
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="upper center",
        ncol=columns,
        frameon=False,
    )
    # Without the software's name the same input gives the same bytes.
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def quality_figure(path: Path, trial: Trial, quality: TrialQuality) -> None:
    """Draw angles, forces, what Newton misses, moments, mats and markers.

    Args:
        path: of the picture (.png).
        trial: as loaded.
        quality: of the same trial.
    """
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    t = trial.time
    _angles(axes[0, 0], trial)
    _forces(axes[0, 1], trial)
    ax = axes[0, 2]
    for column, name in enumerate(("F_x [N]", "F_z [N]", "M [N m]")):
        ax.plot(t, quality.residual[:, column], label=name)
    ax.axhline(0.0, color="0.7", lw=0.8)
    _finish_axes(ax, "missed by Newton's law", "N, N m")
    ax = axes[1, 0]
    if trial.moments is not None:
        for i, name in enumerate(trial.coordinates[3:]):
            style = "--" if name.startswith("exo_") else "-"
            ax.plot(
                t, trial.moments[:, i], style, color=f"C{i % 3}", label=name
            )
    _finish_axes(ax, "joint moments", "N m")
    ax = axes[1, 1]
    for name, force in trial.normal_force.items():
        ax.plot(t, force, label=name)
    _finish_axes(ax, "mats: normal force on the human", "N")
    _markers(axes[1, 2], quality)
    figure.suptitle(trial.name)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _angles(ax, trial: Trial) -> None:
    for i, name in enumerate(trial.coordinates[3:]):
        style = "--" if name.startswith("exo_") else "-"
        ax.plot(
            trial.time,
            np.rad2deg(trial.q[:, 3 + i]),
            style,
            color=f"C{i % 3}",
            label=name,
        )
    _finish_axes(ax, "angles", "deg")


def _forces(ax, trial: Trial) -> None:
    ax.plot(trial.time, trial.grf[:, 0], label="feet F_x")
    ax.plot(trial.time, trial.grf[:, 1], label="feet F_z")
    if trial.chair is not None:
        ax.plot(trial.time, trial.chair[:, 1], label="chair F_z")
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
