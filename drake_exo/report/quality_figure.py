"""A trial's quality at a glance."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drake_exo.laboratory.quality import TrialQuality
from drake_exo.laboratory.trial import Trial


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
    _finish(ax, "missed by Newton's law", "N, N m")
    ax = axes[1, 0]
    if trial.moments is not None:
        for i, name in enumerate(trial.coordinates[3:]):
            style = "--" if name.startswith("exo_") else "-"
            ax.plot(
                t, trial.moments[:, i], style, color=f"C{i % 3}", label=name
            )
    _finish(ax, "joint moments", "N m")
    ax = axes[1, 1]
    for name, force in trial.normal_force.items():
        ax.plot(t, force, label=name)
    _finish(ax, "mats: normal force on the human", "N")
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
    _finish(ax, "angles", "deg")


def _forces(ax, trial: Trial) -> None:
    ax.plot(trial.time, trial.grf[:, 0], label="feet F_x")
    ax.plot(trial.time, trial.grf[:, 1], label="feet F_z")
    if trial.chair is not None:
        ax.plot(trial.time, trial.chair[:, 1], label="chair F_z")
    _finish(ax, "forces on the body", "N")


def _markers(ax, quality: TrialQuality) -> None:
    items = sorted(quality.marker_rms_m.items(), key=lambda item: item[1])
    values = [1e3 * value for _, value in items]
    ax.barh(range(len(items)), values, color="0.6")
    ax.set_yticks(range(len(items)), [name for name, _ in items], fontsize=5)
    ax.set_title("markers' distance from the model", fontsize=9)
    ax.set_xlabel("mm")


def _finish(ax, title: str, unit: str) -> None:
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
