"""Figures 2 and 3 of the paper: ground reaction and kinematics of Phase A."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from drake_exo.phases.measured import MeasuredMovement
from drake_exo.phases.problem import Trajectory
from drake_exo.phases.scores import measured_cop

_MEASURED = {"color": "0.15", "lw": 1.6}
_SIMULATED = {"color": "#c8102e", "lw": 1.6, "ls": "--"}
_DEVICE = {"color": "#1f6fb4", "lw": 1.6, "ls": "--"}
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "savefig.dpi": 150,
}


def ground_reaction_figure(
    path: Path,
    trajectories: list[Trajectory],
    trials: list[MeasuredMovement],
) -> None:
    """Forces and centre of pressure, one column for each trial (Fig. 2)."""
    rows = [
        ("$F_x$ [N]", lambda g: g.ground[:, 0]),
        ("$F_z$ [N]", lambda g: g.ground[:, 1]),
        ("CoP $x$ [m]", _cop),
    ]
    with plt.rc_context(_STYLE):
        figure, axes = _panels(len(rows), len(trials))
        for column, (found, trial) in enumerate(
            zip(trajectories, trials, strict=True)
        ):
            at = trial.sample(found.times)
            for row, (label, signal) in enumerate(rows):
                ax = axes[row, column]
                ax.plot(at.times, signal(at), label="measured", **_MEASURED)
                ax.plot(found.times, signal(found), label="model", **_SIMULATED)
                if column == 0:
                    ax.set_ylabel(label)
            axes[0, column].set_title(found.name)
        _finish(figure, axes, path)


def kinematics_figure(
    path: Path,
    trajectories: list[Trajectory],
    trials: list[MeasuredMovement],
) -> None:
    """Joint angles and velocities of human and exoskeleton (Fig. 3)."""
    device = trials[0].q.shape[1] > 6
    with plt.rc_context(_STYLE):
        figure, axes = _panels(6, len(trials), height=1.35)
        for column, (found, trial) in enumerate(
            zip(trajectories, trials, strict=True)
        ):
            at = trial.sample(found.times)
            for joint, name in enumerate(("ankle", "knee", "hip")):
                for row, key, unit in (
                    (joint, "q", "°"),
                    (joint + 3, "v", "°/s"),
                ):
                    ax = axes[row, column]
                    measured = np.rad2deg(getattr(at, key))
                    model = np.rad2deg(getattr(found, key))
                    ax.plot(
                        at.times,
                        measured[:, 3 + joint],
                        label="measured",
                        **_MEASURED,
                    )
                    ax.plot(
                        found.times,
                        model[:, 3 + joint],
                        label="human" if device else "model",
                        **_SIMULATED,
                    )
                    if device:
                        ax.plot(
                            found.times,
                            model[:, 6 + joint],
                            label="exoskeleton",
                            **_DEVICE,
                        )
                    if column == 0:
                        ax.set_ylabel(f"{name} [{unit}]")
            axes[0, column].set_title(found.name)
        _finish(figure, axes, path)


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


def _panels(rows, columns, height=1.9):
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(max(3.0 * columns, 4.0), height * rows + 0.6),
        sharex="col",
        sharey="row",
        squeeze=False,
    )
    return figure, axes


def _finish(figure, axes, path):
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.align_ylabels()
    figure.tight_layout(rect=(0, 0, 1, 0.965))
    figure.legend(
        handles, labels, loc="upper center", ncol=len(labels), frameon=False
    )
    # Without the software's name the same input gives the same bytes.
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)
