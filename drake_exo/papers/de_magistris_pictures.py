"""Pictures of optimisations: cost histories, the front of both costs.

Pictures of a study: soles (Figs. 8–12), stiffness (Fig. 13), costs.
"""

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm

from drake_exo.soles import pictures as views
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.pictures import _STYLE, _save
from drake_exo.soles.results import write_csv
from drake_exo.soles.shape import SphericalSpline

matplotlib.use("Agg")


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


matplotlib.use("Agg")


_COLOURS = plt.get_cmap("coolwarm")
_GAP = 14.0  # mm between views
_HEAD, _FOOT = 0.4, 0.75  # inches above and below the soles
_FLOOR = 1e-8  # errors below are drawn there
_INCH = 1.0 / 62.0  # inches a millimetre of sole


@dataclass(frozen=True)
class DrawnSole:
    """What the pictures need of one sole.

    Attributes:
        name: Case.
        caption: Second line of its title.
        initial: Mesh before optimisation.
        mesh: Optimised mesh.
        change: Radial change of its every node [%], (n,).
    """

    name: str
    caption: str
    initial: TetMesh
    mesh: TetMesh
    change: np.ndarray


@dataclass(frozen=True)
class _Sheet:
    """Where each view goes: a row a sole, a column a view, one scale.

    Attributes:
        boxes: Extent of all soles in each view [mm], (2, 2) each.
        rows: Number of soles.
    """

    boxes: list[np.ndarray]
    rows: int

    @property
    def widths(self) -> np.ndarray:
        """Of the columns [mm]."""
        return np.array([np.ptp(b, axis=0)[0] + _GAP for b in self.boxes])

    @property
    def height(self) -> float:
        """Of a row [mm]."""
        return max(np.ptp(b, axis=0)[1] for b in self.boxes) + 24.0

    @property
    def size(self) -> np.ndarray:
        """Width and height of the figure [inches]."""
        tall = _INCH * self.height * self.rows + _FOOT + _HEAD
        return np.array([_INCH * self.widths.sum(), tall])

    def place(self, row: int, column: int) -> np.ndarray:
        """Left, bottom, width and height in parts of the figure."""
        left = _INCH * self.widths[:column].sum()
        bottom = _FOOT + _INCH * self.height * (self.rows - row - 1)
        width, height = _INCH * self.widths[column], _INCH * self.height
        return np.array([left, bottom, width, height]) / np.tile(self.size, 2)


def radial_change(
    mesh: TetMesh, spline: SphericalSpline, p: np.ndarray
) -> np.ndarray:
    """Radial change of a design's nodes [%], zero at the origin, (n,)."""
    there = np.linalg.norm(mesh.nodes, axis=1) > 1e-9
    return np.where(there, 100 * (spline.stretch(mesh.nodes, p) - 1), 0.0)


def soles_figure(path: Path, soles: list[DrawnSole]) -> None:
    """Every sole from below, the left, the back and in perspective.

    One scale for all; colour is the radial change, the initial outline is
    dashed.
    """
    every = np.concatenate(
        [m.nodes for s in soles for m in (s.mesh, s.initial)]
    )
    boxes = [views.extent(every, view) for view in views.VIEWS]
    sheet = _Sheet(boxes, len(soles))
    largest = max(np.abs(s.change).max() for s in soles)
    norm = TwoSlopeNorm(0.0, -largest, largest)
    style = {**_STYLE, "figure.constrained_layout.use": False}
    with plt.rc_context(style):
        figure = plt.figure(figsize=sheet.size)
        for row, sole in enumerate(soles):
            shape = _coloured(sole, norm)
            for column, view in enumerate(views.VIEWS):
                axis = figure.add_axes(sheet.place(row, column))
                _view(axis, sole, shape, view, boxes[column], sheet)
                _ends(axis, sole, view)
            _, bottom, _, height = sheet.place(row, 0)
            look = {"y": bottom + height, "va": "top"}
            figure.text(0.012, s=sole.name, size=11, weight="bold", **look)
            figure.text(0.10, s=sole.caption, size=9, color="0.25", **look)
        top = 1 - 0.12 / sheet.size[1]
        for column, view in enumerate(views.VIEWS):
            left, _, width, _ = sheet.place(0, column)
            figure.text(left + 0.5 * width, top, view.name, size=10,
                        ha="center", va="top")  # fmt: skip
        _legend(figure, norm, sheet.size)
        _save(figure, path)


def _coloured(sole: DrawnSole, norm) -> views.Surface:
    colours = _COLOURS(norm(sole.change))[:, :3]
    shape = views.surface(
        sole.mesh.nodes, sole.mesh.boundary_faces, np.asarray(colours)
    )
    return shape.refined()


def _view(axis, sole, shape, view, box, sheet) -> None:
    views.draw(axis, shape, view)
    views.outline(axis, sole.initial.nodes, view)
    middle = box.mean(axis=0)
    width = np.ptp(box, axis=0)[0] + _GAP
    axis.set(
        xlim=middle[0] + 0.5 * np.array([-width, width]),
        ylim=middle[1] + 0.5 * sheet.height * np.array([-1, 1]),
        aspect="equal",
    )
    axis.set_axis_off()


def _ends(axis, sole, view) -> None:
    """Write heel and toe, or left and right, under either shape."""
    low, high = views.extent(sole.initial.nodes, view)
    below = min(low[1], views.extent(sole.mesh.nodes, view)[0][1])
    right = view.axes()[0]
    words = ("heel", "toe") if abs(right[0]) > 0.9 else ("right", "left")
    if max(np.abs(right)) < 0.9:
        return
    along = right[0] if abs(right[0]) > 0.9 else right[1]
    words = words if along > 0 else words[::-1]
    for x, word, side in zip(
        (low[0], high[0]), words, ("left", "right"), strict=True
    ):
        axis.text(
            x, below - 3, word, ha=side, va="top", fontsize=8, color="0.4"
        )


def _legend(figure, norm, size) -> None:
    """Colour bar, scale bar and what is dashed."""
    wide, total = size
    bar = figure.add_axes([0.06, 0.42 / total, 0.3, 0.11 / total])
    figure.colorbar(
        ScalarMappable(norm, _COLOURS),
        cax=bar,
        orientation="horizontal",
        label="radial change of the surface [%]",
    )
    axis = figure.add_axes([0.4, 0.1 / total, 0.58, (_FOOT - 0.15) / total])
    axis.set_axis_off()
    axis.set(xlim=(0, 0.58 * wide / _INCH), ylim=(0, 1))
    axis.plot([0, 50], [0.62, 0.62], color="k", lw=2, solid_capstyle="butt")
    axis.text(25, 0.5, "50 mm", ha="center", va="top")
    axis.plot([80, 105], [0.62, 0.62], color="0.25", lw=0.8,
              ls=(0, (4, 3)))  # fmt: skip
    axis.text(110, 0.62, "initial shape", va="center")


def stiffness_figure(path: Path, curves: dict[str, dict], strike: int) -> None:
    """σ_max(K_tr) and σ_min(K_rot) over the step, a column a sole (Fig. 13).

    Args:
        path: PNG file.
        curves: Case -> {"initial": steps.csv columns, "optimised": same}.
        strike: Number of samples of heel strike.
    """
    keys = ("sigma_max_tr_n_per_m", "sigma_min_rot_nm_per_rad")
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(
            2, len(curves), figsize=(1.2 + 2.7 * len(curves), 5.4),
            sharex=True, sharey="row", squeeze=False,
        )  # fmt: skip
        for column, (name, pair) in enumerate(curves.items()):
            for axis, key, scale in zip(
                axes[:, column], keys, (1e-3, 1.0), strict=True
            ):
                for label, look in (
                    ("initial", {"color": "0.45", "ls": "--"}),
                    ("optimised", {"color": f"C{column}"}),
                ):
                    steps = pair[label]
                    t = steps["time_s"] - steps["time_s"][0]
                    axis.plot(t, scale * steps[key], label=label, **look)
                axis.axvspan(t[0], t[strike - 1], color="tab:orange",
                             alpha=0.15, lw=0, label="heel strike")  # fmt: skip
                axis.margins(x=0.01)
            axes[0, column].set_title(name)
            axes[1, column].set_xlabel("time since contact [s]")
        axes[0, 0].legend(fontsize=8)
        for axis in axes[:, 0]:
            axis.set_ylim(0, None)
        axes[0, 0].set_ylabel(r"$\sigma_{\max}(K_c^{\mathrm{tr}})$ [kN/m]")
        axes[1, 0].set_ylabel(r"$\sigma_{\min}(K_c^{\mathrm{rot}})$ [N·m/rad]")
        _save(figure, path)


def histories_figure(path: Path, traces: dict[str, np.ndarray]) -> None:
    """Cost, violation and optimality error over iterations, case by case.

    Args:
        path: PNG file.
        traces: Case -> rows (stage, iteration, cost, violation, dual
            infeasibility).
    """
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(
            2, len(traces), figsize=(1.2 + 2.7 * len(traces), 5.0),
            sharex="col", squeeze=False,
        )  # fmt: skip
        for column, (name, trace) in enumerate(traces.items()):
            cost, error = axes[:, column]
            cost.set_title(name)
            error.set_xlabel("iteration")
            if len(trace) == 0:
                cost.text(0.5, 0.5, "no iterations", ha="center",
                          transform=cost.transAxes)  # fmt: skip
                continue
            x = np.arange(len(trace))
            for stage in np.unique(trace[:, 0]):
                rows = trace[:, 0] == stage
                cost.plot(x[rows], trace[rows, 2], ".-", ms=4,
                          label=f"stage {stage:.0f}")  # fmt: skip
            floor = np.maximum(trace[:, 3:], _FLOOR)
            error.semilogy(x, floor[:, 1], color="k", lw=1.2,
                           label="dual infeasibility")  # fmt: skip
            error.semilogy(x, floor[:, 0], color="tab:red", ls=":",
                           label="constraint violation")  # fmt: skip
            cost.legend(fontsize=8)
        axes[0, 0].set_ylabel(r"cost $c/|c_0|$ with regulariser")
        axes[1, 0].set_ylabel("scaled error")
        axes[1, 0].legend(fontsize=8)
        _save(figure, path)
