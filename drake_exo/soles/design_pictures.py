"""Pictures of optimisations: cost histories, the front of both costs."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from drake_exo.soles.pictures import _STYLE, _save
from drake_exo.soles.results import write_csv

_TRACE = ("stage", "iteration", "cost", "violation", "dual_infeasibility")


def write_traces(path: Path, optima) -> None:
    """Iterations of all stages as CSV."""
    rows = [
        [number + 1, *row]
        for number, best in enumerate(optima)
        for row in best.trace
    ]
    columns = np.array(rows, dtype=float).reshape(-1, len(_TRACE)).T
    write_csv(path, dict(zip(_TRACE, columns, strict=True)))


def trace_figure(path: Path, optima) -> None:
    """Cost and optimality error over iterations, stage by stage."""
    with plt.rc_context(_STYLE):
        figure, (cost, error) = plt.subplots(1, 2, figsize=(9.0, 3.4))
        start = 0
        for number, best in enumerate(optima):
            trace = np.array(best.trace)
            if len(trace) == 0:
                continue
            x = start + np.arange(len(trace))
            label = f"stage {number + 1}"
            cost.plot(x, trace[:, 1], ".-", label=label)
            error.semilogy(x, np.maximum(trace[:, 3], 1e-12), ".-")
            error.semilogy(x, np.maximum(trace[:, 2], 1e-12), ":", color="k",
                           lw=1)  # fmt: skip
            start += len(trace)
        cost.set(xlabel="iteration", title="cost $c/|c_0|$ with regulariser")
        error.set(
            xlabel="iteration",
            title="scaled dual infeasibility (dotted: violation)",
        )
        if start:
            cost.legend()
        _save(figure, path)


def front_figure(
    path: Path, rows: list[dict], paper: dict, fronts: dict[str, list[dict]]
) -> None:
    """c_tr against c_rot, each over its brick's, beside the paper's.

    Args:
        path: PNG file.
        rows: Summaries with name, ratio_tr and ratio_rot.
        paper: Name -> (ratio of c_tr, ratio of c_rot).
        fronts: Label -> points with ratio_tr and ratio_rot.
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(6.0, 4.2))
        for k, row in enumerate(rows):
            colour = f"C{k}"
            axis.plot(row["ratio_tr"], row["ratio_rot"], "o", color=colour,
                      label=row["name"])  # fmt: skip
            if row["name"] in paper:
                axis.plot(*paper[row["name"]], "x", color=colour, mew=2)
        if rows:
            axis.plot([], [], "kx", mew=2, label="paper")
        for (label, points), style in zip(
            fronts.items(), (".-", ".--"), strict=False
        ):
            axis.plot(
                [p["ratio_tr"] for p in points],
                [p["ratio_rot"] for p in points],
                style, color="0.4", label=label,
            )  # fmt: skip
        axis.set(
            xscale="log",
            xlabel=r"$c^{tr}$ over the brick's (less is better)",
            ylabel=r"$c^{rot}$ over the brick's (more is better)",
        )
        axis.legend()
        _save(figure, path)
