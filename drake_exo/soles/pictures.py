"""Figures of soles and of their steps; each `..._figure` function returns one.

Of a step: load (the paper's Figs. 6, 7), stiffness (Fig. 13), pose, pressure.
Of an optimisation: its iterations and the front of both costs. Of soles: a
drawing, and shaded orthographic views (Figs. 8-12), drawn as polygons: faces
that look away are dropped, the others painted from far to near, all at one
scale, in millimetres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import PowerNorm, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from matplotlib.tri import Triangulation
from scipy.spatial import ConvexHull

from drake_exo.files.output import COLOURS, STYLE
from drake_exo.soles.contact.law import FLAT, Ground
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import (
    EDGES,
    UPWARDS,
    SphericalSpline,
    TetMesh,
    normals_of,
    rings,
)
from drake_exo.soles.surface import crossings

_AMBIENT, _DIFFUSE = 0.4, 0.65
_LIGHT = np.array([-0.4, -0.2, 0.894])  # right, up, towards the viewer


@dataclass(frozen=True)
class View:
    """Direction from a sole to the viewer, and that up in the picture."""

    name: str
    toward: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def axes(self) -> np.ndarray:
        """Rows: right, up and towards the viewer, (3, 3)."""
        toward = np.array(self.toward) / np.linalg.norm(self.toward)
        right = np.cross(self.up, toward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(toward, right), toward])


VIEWS = (
    View("from below", (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
    View("left side", (0.0, 1.0, 0.0)),
    View("back", (-1.0, 0.0, 0.0)),
    View("from below, back left", (-1.0, 0.9, -0.8)),
)


def draw(axis, corners: np.ndarray, colours: np.ndarray, view: View) -> None:
    """Paint shaded outward triangles (f, 3, 3) [mm] of RGB colours (f, 3)."""
    seen = corners @ view.axes().T
    normal = normals_of(seen)
    facing = normal[:, 2] > 0
    seen, normal = seen[facing], normal[facing]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lit = _AMBIENT + _DIFFUSE * np.clip(normal @ _LIGHT, 0.0, 1.0)
    order = np.argsort(seen[:, :, 2].mean(axis=1), kind="stable")
    colour = np.clip(colours[facing] * lit[:, None], 0.0, 1.0)[order]
    axis.add_collection(
        PolyCollection(
            seen[order][:, :, :2],
            facecolors=colour,
            edgecolors=colour,
            linewidths=0.8,
            rasterized=True,
        )
    )


def outline(axis, mesh: TetMesh, view: View) -> None:
    """Draw the silhouette of a sole, dashed."""
    seen = 1e3 * mesh.nodes @ view.axes().T
    faces = mesh.boundary_faces
    # Above rounding: else some edge-on faces would count.
    facing = normals_of(seen[faces])[:, 2] > 1e-6
    lines = [seen[np.append(r, r[0]), :2] for r in rings(faces[facing])]
    spans = [np.ptp(line, axis=0).prod() for line in lines]
    for line, span in zip(lines, spans, strict=True):
        if span > 0.05 * max(spans):  # borders of small dents are left out
            axis.plot(*line.T, color="0.25", lw=0.8, ls=(0, (4, 3)))


def extent(nodes: np.ndarray, view: View) -> np.ndarray:
    """Lower and upper corner of nodes [m] in a view [mm], (2, 2)."""
    flat = 1e3 * nodes @ view.axes()[:2].T
    return np.stack([flat.min(axis=0), flat.max(axis=0)])


_COLOURS = matplotlib.colormaps["coolwarm"]
_GAP, _BETWEEN = 14.0, 24.0  # mm between views, and between soles
_HEAD, _FOOT = 0.4, 0.75  # inches above and below the soles
_LEAST_ERROR = 1e-8  # smaller errors are drawn as this
_INCH = 1.0 / 62.0  # inches for a millimetre of sole
_AXES = {"x": COLOURS[1], "y": COLOURS[2], "z": COLOURS[0]}
STIFFNESS = "sigma_max_tr_n_per_m", "sigma_min_rot_nm_per_rad"


def style():
    """Style of all figures, as a decorator or context."""
    layout = {"figure.constrained_layout.use": True}
    return matplotlib.rc_context(STYLE | layout)


def panels(rows: int, columns: int, size: tuple[float, float], **shared):
    """A figure of `size` [inch] with rows × columns of axes; both."""
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, **shared)


@style()
def load_figure(
    load: Load, outline: np.ndarray, ground: Ground = FLAT
) -> Figure:
    """ZMP on the sole's outline, and force over time (Figs. 6 and 7).

    Contours show a ground that is not flat. `outline` has the places of the
    sole's nodes as it is set down [m], (m, 2).
    """
    figure, (left, right) = panels(1, 2, (9.0, 3.8))
    # With less, equal scales push long labels on the left out of the figure.
    figure.get_layout_engine().set(w_pad=0.12)
    around = ConvexHull(outline).vertices
    ring = 1e3 * outline[np.append(around, around[0])]
    left.fill(*ring.T, color="0.93", zorder=0)
    left.plot(*ring.T, color="0.5", lw=1)
    if not ground.is_flat:
        low, high = outline.min(axis=0), outline.max(axis=0)
        low, high = 1.05 * low - 0.05 * high, 1.05 * high - 0.05 * low
        # Set first, as the contours' labels are placed within the limits.
        left.set(
            xlim=(1e3 * low[0], 1e3 * high[0]),
            ylim=(1e3 * low[1], 1e3 * high[1]),
            aspect="equal",
        )
        low = np.maximum(low, [ground.x[0], ground.y[0]])
        high = np.minimum(high, [ground.x[-1], ground.y[-1]])
        x, y = np.meshgrid(*np.linspace(low, high, 101).T)
        places = np.stack([x.ravel(), y.ravel()], axis=1)
        z = ground.height(places).reshape(x.shape)
        heights = left.contour(1e3 * x, 1e3 * y, 1e3 * z, 8, cmap="copper")
        left.clabel(heights, fmt="%g mm", fontsize=7)
    points = left.scatter(
        *(1e3 * load.zmp.T), c=load.times, s=9, cmap="viridis", zorder=3
    )
    figure.colorbar(points, ax=left, label="time [s]", shrink=0.8)
    struck = 1e3 * load.zmp[list(load.begins)]
    left.plot(*struck.T, "o", mfc="none", mec="k", ms=9)
    # With a prescribed pose the simulated ZMP differs.
    which = "Recorded ZMP" if load.is_measured.any() else "ZMP"
    left.set(
        xlabel="x, forward [mm]",
        ylabel="y, left [mm]",
        title=f"{which} on the sole (○: heel strike)",
        aspect="equal",
    )
    for (axis, colour), force in zip(_AXES.items(), load.force.T, strict=True):
        _over_time(right, load.begins, load.times, force,
                   color=colour, label=f"$F_{axis}$")  # fmt: skip
    right.set(xlabel="time [s]", ylabel="force [N]", title="Ground force")
    _legend_below(right, -0.14)
    return figure


def _legend_below(axis, place: float) -> None:
    """Put three entries in a row below the axes, clear of many loads' curves.

    `place` is their upper edge, in heights of the axes.
    """
    axis.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, place))


def _over_time(axis, begins: Sequence[int], t, values, **look) -> None:
    """Plot values (N,) over time, with a gap between contact phases.

    A phase of one sample is a point.
    """
    if 1 in np.diff([*begins, len(t)]):
        look["marker"] = "."
    if np.ptp(t) == 0:  # times around it would overlap
        axis.set_xticks(t[:1])
    axis.plot(
        *(np.insert(x.astype(float), begins[1:], np.nan) for x in (t, values)),
        **look,
    )


def _as_written(name: str) -> str:
    """A name with $ escaped, so that no formula is made of it."""
    return name.replace("$", r"\$")


def _columns(count: int, height: float, **shared):
    """A figure with two rows of axes, a column for each sole."""
    width = max(1.2 + 2.7 * count, 6.0)
    return panels(2, count, (width, height), squeeze=False, **shared)


@style()
def stiffness_figure(
    soles: Mapping[str, Mapping[str, dict]], strikes: Sequence[tuple[int, int]]
):
    """σ_max(K_tr) and σ_min(K_rot) over the step, a column a sole (Fig. 13).

    Args:
        soles: By name and label the columns of `Step.table`, each (N,); the
            label "initial" is drawn in the background.
        strikes: Index of heel strike's first sample, and of the next after it,
            of every load.
    """
    begins = [first for first, _ in strikes]
    figure, axes = _columns(len(soles), 5.4, sharex=True, sharey="row")
    for column, (name, curves) in enumerate(soles.items()):
        own = [label for label in curves if label != "initial"]
        for label, columns in curves.items():
            look = {"color": "0.45", "ls": "--"}
            if label != "initial":
                k = column + own.index(label)
                look = {"color": COLOURS[k % len(COLOURS)]}
            t = columns["time_s"] - columns["time_s"][0]
            look["label"] = _as_written(label)
            tr, rot = (columns[key] for key in STIFFNESS)
            _over_time(axes[0, column], begins, t, 1e-3 * tr, **look)
            _over_time(axes[1, column], begins, t, rot, **look)
        for axis in axes[:, column]:
            for k, (first, end) in enumerate(strikes):
                axis.axvspan(
                    t[first], t[end - 1], color=COLOURS[4], alpha=0.15,
                    lw=1, label="" if k else "heel strike",
                )  # fmt: skip
            axis.margins(x=0.01)
        axes[0, column].set_title(_as_written(name))
        which = "contact" if len(strikes) == 1 else "the first contact"
        axes[1, column].set_xlabel(f"time since {which} [s]")
    axes[0, 0].legend(fontsize=8)
    for axis in axes[:, 0]:
        axis.set_ylim(0, None)
    axes[0, 0].set_ylabel(r"$\sigma_{\max}(K_c^{\mathrm{tr}})$ [kN/m]")
    axes[1, 0].set_ylabel(r"$\sigma_{\min}(K_c^{\mathrm{rot}})$ [N·m/rad]")
    return figure


@style()
def pose_figure(columns: dict[str, np.ndarray]) -> Figure:
    """Pose, stability and nodes in contact over time, from `Step.table`.

    Samples that did not converge are left out.
    """
    begins = [0]
    if "load" in columns:
        begins += list(np.flatnonzero(np.diff(columns["load"])) + 1)

    def draw(axis, values, **look):
        values = np.where(columns["converged"], values, np.nan)
        _over_time(axis, begins, columns["time_s"], values, **look)

    figure, axes = panels(2, 2, (9.0, 6.0), sharex=True)
    (place, turn), (stable, nodes) = axes
    for axis, colour in _AXES.items():
        values = columns[f"origin_{axis}_m"]
        offset = values[0] if axis == "z" else 0.0
        label = f"{axis} − {1e3 * offset:.1f} mm" if offset else axis
        draw(place, 1e3 * (values - offset), label=label, color=colour)
    place.set(ylabel="origin [mm]", title="Place of the foot")
    turns = ("roll", "pitch", "yaw")
    for name, colour in zip(turns, _AXES.values(), strict=True):
        draw(turn, columns[f"{name}_deg"], label=name, color=colour)
    turn.set(ylabel="angle [°]", title="Orientation (Rx·Ry·Rz)")
    draw(stable, 1e-3 * columns["stability_n_per_m"], color="k")
    stable.axhline(0.0, color=COLOURS[1], lw=1, ls="--")
    stable.set(
        xlabel="time [s]",
        ylabel="eigenvalue [kN/m]",
        title=r"Stability: least eigenvalue of $S\,\mathrm{sym}(-K_c)\,S$",
    )
    draw(nodes, columns["nodes_in_contact"], color="k")
    nodes.set(xlabel="time [s]", ylabel="number", ylim=(0, None))
    nodes.set_title("Nodes in contact")
    _legend_below(place, -0.02)
    _legend_below(turn, -0.02)
    return figure


@style()
def pressure_figure(
    mesh: TetMesh,
    times: np.ndarray,
    zmp: np.ndarray,
    pressure: np.ndarray,
    converged: np.ndarray,
) -> Figure | None:
    """Contact pressure under the sole at up to eight samples of the step.

    From times [s] (N,), ZMPs in the sole's frame [m] (N, 2), pressures at the
    contact nodes [Pa] (N, m) and which samples converged (N,); None if none.
    """
    picked = np.flatnonzero(converged)
    if len(picked) == 0:
        return None
    count = min(8, len(picked))
    picked = picked[np.linspace(0, len(picked) - 1, count).round().astype(int)]
    pressure = 1e-3 * pressure[picked]
    top = max(float(pressure.max()), 1e-9)
    columns, rows = min(count, 4), -(-count // 4)
    size = max(1.0 + 2.5 * columns, 6.0), 0.6 + 1.8 * rows
    look = {"sharex": True, "sharey": True, "squeeze": False}
    figure, axes = panels(rows, columns, size, **look)
    for axis in axes.flat[count:]:
        axis.set_axis_off()
    for axis, q, p in zip(axes.flat, picked, pressure, strict=False):
        drawn = _pressed(axis, mesh, p, top)
        axis.plot(*(1e3 * zmp[q]), "+", color="cyan", ms=9, mew=2)
        axis.set_title(f"{times[q]:.3f} s")
        axis.set_aspect("equal")
        axis.grid(False)
    for axis in axes[-1]:
        axis.set_xlabel("x [mm]")
    for axis in axes[:, 0]:
        axis.set_ylabel("y [mm]")
    figure.colorbar(drawn, ax=axes, label="contact pressure [kPa]", shrink=0.85)
    figure.suptitle(
        "Contact pressure, seen from above through the sole (+ ZMP)"
    )
    return figure


def _pressed(axis, mesh: TetMesh, kpa: np.ndarray, largest=None):
    """Draw pressures at the contact nodes [kPa], (m,), on the underside."""
    faces, place = _underside(mesh)
    return axis.tripcolor(
        Triangulation(*(1e3 * place.T), faces),
        kpa,
        shading="gouraud",
        cmap="inferno",
        # Root scale: mid-stance has a tenth of heel strike's pressure.
        norm=PowerNorm(0.5, 0.0, largest),
    )


def _underside(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Faces that look down (f, 3), as indices of contact nodes; nodes' x, y.

    The lowest come last, to be drawn over the ceilings of hollows.
    """
    faces = mesh.contact_faces
    normal, size = mesh.areas(faces)
    down = normal[:, 2] < -0.05 * size
    down &= np.isin(faces, mesh.contact).all(axis=1)
    faces = faces[down]
    faces = faces[np.argsort(-mesh.nodes[faces, 2].sum(axis=1), kind="stable")]
    local = np.searchsorted(mesh.contact, faces)
    return local[:, [0, 2, 1]], mesh.nodes[mesh.contact][:, :2]


@style()
def histories_figure(histories: Mapping[str, Mapping[str, np.ndarray]]):
    """Cost, violation and optimality error over iterations, a column a sole.

    Args:
        histories: By sole, the columns of history.csv by name, each (N,).
    """
    figure, axes = _columns(len(histories), 5.0, sharex="col")
    entries = ((), ())
    for column, (name, trace) in enumerate(histories.items()):
        cost, error = axes[:, column]
        cost.set_title(_as_written(name))
        error.set_xlabel("iteration")
        x = np.arange(len(trace["stage"]))
        if len(x) == 0:
            cost.text(0.5, 0.5, "no iterations", ha="center",
                      transform=cost.transAxes)  # fmt: skip
            continue
        for stage in np.unique(trace["stage"]):
            rows = trace["stage"] == stage
            cost.plot(x[rows], trace["cost"][rows], ".-", ms=4,
                      label=f"stage {stage:.0f}")  # fmt: skip
        for key, label, look in (
            ("dual_infeasibility", "dual infeasibility", {"color": "k"}),
            ("violation", "constraint violation",
             {"color": COLOURS[1], "ls": ":"}),
        ):  # fmt: skip
            error.semilogy(x, np.maximum(trace[key], _LEAST_ERROR),
                           label=label, **look)  # fmt: skip
        cost.legend(fontsize=8)
        entries = error.get_legend_handles_labels()
    figure.legend(*entries, fontsize=8, ncols=2, loc="outside lower center")
    axes[0, 0].set_ylabel(r"cost $c/|c_0|$ with regulariser")
    axes[1, 0].set_ylabel("scaled error")
    return figure


@style()
def pareto_figure(
    fronts: dict[str, list[dict]], rows=(), paper: dict | None = None
) -> Figure:
    """c_tr against c_rot, over the initial shape's, beside the paper's.

    Args:
        fronts: Points with ratio_tr and ratio_rot, by label.
        rows: Summaries of designs with name, ratio_tr and ratio_rot.
        paper: The paper's (ratio of c_tr, ratio of c_rot) by design's name.
    """
    figure, axis = panels(1, 1, (6.0, 4.2))
    for k, row in enumerate(rows):
        colour = COLOURS[k % len(COLOURS)]
        axis.plot(row["ratio_tr"], row["ratio_rot"], "o", color=colour,
                  label=_as_written(row["name"]))  # fmt: skip
        if paper and row["name"] in paper:
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
        xlabel=r"$c^{tr}$ over the initial shape's (less is better)",
        ylabel=r"$c^{rot}$ over the initial shape's (more is better)",
    )
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.minorticks_off()  # Matplotlib labels some if less than a decade
    axis.legend()
    return figure


def radial_change(
    mesh: TetMesh, spline: SphericalSpline, p: np.ndarray
) -> np.ndarray:
    """Radial change of a design's nodes [%], 0 at the origin, (n,)."""
    there = np.linalg.norm(mesh.nodes, axis=1) > 1e-9
    return np.where(there, 100 * (spline.stretch(mesh.nodes, p) - 1), 0.0)


@style()
def soles_figure(soles: Sequence[tuple]) -> Figure:
    """Every sole from below, the left, the back and obliquely, at one scale.

    Colour is the radial change; the initial shape's outline is dashed.

    Args:
        soles: Of each the name, the caption beside it, the mesh before the
            optimisation and after, and the nodes' radial change [%], (n,).
    """
    every = np.concatenate([m.nodes for s in soles for m in s[2:4]])
    boxes = [extent(every, view) for view in VIEWS]
    widths, heights = np.transpose([np.ptp(box, axis=0) for box in boxes])
    widths, height = widths + _GAP, heights.max() + _BETWEEN
    wide = _INCH * widths.sum()
    tall = _INCH * height * len(soles) + _FOOT + _HEAD
    figure = Figure(figsize=(wide, tall), layout="none")
    axes = figure.subplots(
        len(soles), len(VIEWS), squeeze=False,
        width_ratios=widths,
        gridspec_kw={"left": 0, "right": 1, "wspace": 0, "hspace": 0,
                     "bottom": _FOOT / tall, "top": 1 - _HEAD / tall},
    )  # fmt: skip
    largest = max(np.abs(change).max() for *_, change in soles)
    norm = TwoSlopeNorm(0.0, -largest, largest)
    for row, sole in zip(axes, soles, strict=True):
        title, caption, initial, mesh, change = sole
        corners = 1e3 * mesh.nodes[mesh.boundary_faces]
        colours = _coloured(mesh, change, norm)
        for axis, view, box in zip(row, VIEWS, boxes, strict=True):
            draw(axis, corners, colours, view)
            outline(axis, initial, view)
            _ends(axis, initial, mesh, view)
            half = 0.5 * np.array([np.ptp(box[:, 0]) + _GAP, height])
            low, high = box.mean(axis=0) - half, box.mean(axis=0) + half
            axis.set(
                xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal"
            )
            axis.set_axis_off()
        look = {"y": row[0].get_position().y1, "va": "top"}
        name = figure.text(
            0.012, s=_as_written(title), size=11, weight="bold", **look
        )
        end = name.get_window_extent().x1 / figure.bbox.width
        beside = max(0.10, end + 0.02)
        figure.text(beside, s=caption, size=9, color="0.25", **look)
    for axis, view in zip(axes[0], VIEWS, strict=True):
        box = axis.get_position()
        figure.text(0.5 * (box.x0 + box.x1), 1 - 0.12 / tall, view.name,
                    size=10, ha="center", va="top")  # fmt: skip
    _legend(figure, norm, wide, tall)
    return figure


def _coloured(mesh: TetMesh, change: np.ndarray, norm) -> np.ndarray:
    """RGB colours of boundary faces by their mean change, (f, 3)."""
    return _COLOURS(norm(change[mesh.boundary_faces].mean(axis=1)))[:, :3]


def _ends(axis, initial: TetMesh, mesh: TetMesh, view: View) -> None:
    """Write heel and toe, or left and right, below both shapes."""
    right = view.axes()[0]
    if max(np.abs(right)) < 0.9:
        return
    is_along = abs(right[0]) > 0.9
    words = ("heel", "toe") if is_along else ("right", "left")
    if (right[0] if is_along else right[1]) < 0:
        words = words[::-1]
    low, high = extent(initial.nodes, view)
    below = min(low[1], extent(mesh.nodes, view)[0][1]) - 3
    look = {"va": "top", "fontsize": 8, "color": "0.4"}
    axis.text(low[0], below, words[0], ha="left", **look)
    axis.text(high[0], below, words[1], ha="right", **look)


def _legend(figure, norm, wide: float, total: float) -> None:
    """Draw the colour bar, a scale bar and the key of the dashed outline."""
    bar = figure.add_axes([0.06, 0.45 / total, 0.3, 0.11 / total])
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


_UNDERCUT = (0.86, 0.15, 0.15)
_RUBBER = (0.62, 0.66, 0.72)
_MARGIN = 18.0  # mm around a view of the drawing
_CUTS = (0.15, 0.5, 0.85)  # parts of the length at which it is cut across


@style()
def drawing_figure(mesh: TetMesh, name: str, peak: np.ndarray) -> Figure:
    """Drawing of a sole: views and sections with dimensions in mm.

    `peak` is the largest pressure of the step at the contact nodes [Pa], (m,).
    """
    nodes = 1e3 * mesh.nodes
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    length, width, height = high - low
    at = low[0] + length * np.array(_CUTS)
    apart = height + 28.0  # distance of the drawn cuts
    tall = np.array(
        [width + 3 * _MARGIN, height + 4 * _MARGIN, max(width, 3 * apart) + 50]
    )
    scale = 5.6 / (length + 2 * _MARGIN)  # inches for a millimetre
    figure = Figure(figsize=(12.0, scale * tall.sum() + 1.2))
    axes = figure.subplots(3, 2, height_ratios=tall)
    for axis in axes.flat:
        axis.set(aspect="equal", xlim=(low[0] - _MARGIN, high[0] + _MARGIN))
        axis.set_axis_off()
    (above, below), (side, along), (across, pressed) = axes
    under = f"undercut {100 * mesh.undercut:.1f} %"
    _shaded(above, mesh, View("", (0, 0, 1), (0, 1, 0)),
            f"from above; {under} (red)")  # fmt: skip
    _dimension(above, low[:2] - [0, 7], (length, 0), f"{length:.1f}")
    _dimension(above, (high[0] + 7, low[1]), (0, width), f"{width:.1f}")
    for x, letter in zip(at, "ABC", strict=True):
        above.plot([x, x], [low[1] - 3, high[1] + 3], "k-.", lw=0.7)
        above.text(x, high[1] + 4, letter, ha="center", va="bottom")
    for axis, view in (
        (below, VIEWS[0]),
        (side, View("right side", (0, -1, 0))),
    ):
        _shaded(axis, mesh, view, view.name)
        _ends(axis, mesh, mesh, view)
    _dimension(side, (high[0] + 7, low[2]), (0, height), f"{height:.1f}")
    middle = 0.5 * (low[1] + high[1])
    _section(along, mesh, 1, middle, lambda p: p[:, [0, 2]])
    along.set(title="cut along the middle", ylim=(low[2] - 16, _MARGIN))
    for x in at:
        _thickness(along, mesh, x, middle, x)
    across.set_title("cuts A, B, C, seen from behind")
    centre = 0.5 * (low[0] + high[0]) + middle
    for k, (x, letter) in enumerate(zip(at, "ABC", strict=True)):
        down = np.array([centre, -k * apart])
        cut = _section(across, mesh, 0, x,
                       lambda p, d=down: d + p[:, 1:] * [-1, 1])  # fmt: skip
        if cut is not None:
            wide = np.ptp(cut[:, 0])
            _dimension(across, cut[0] - [0, 6], (wide, 0), f"{wide:.1f}")
            _thickness(across, mesh, x, middle, centre - middle, down[1])
            across.text(cut[0, 0] - 6, cut[:, 1].mean(), letter, ha="right",
                        va="center")  # fmt: skip
    across.set_ylim(low[2] - 2 * apart - 16, 8)
    _peak(figure, pressed, mesh, peak)
    figure.suptitle(
        f"{_as_written(name)}: {length:.0f} × {width:.0f} × {height:.0f} mm, "
        f"{1e6 * mesh.volume:.0f} cm³ (dimensions in mm)"
    )
    return figure


def _shaded(axis, mesh: TetMesh, view: View, title: str) -> None:
    """Draw the sole in a view, bare faces that look upwards in red."""
    faces = np.concatenate([mesh.top_faces, mesh.contact_faces])
    normal, size = mesh.areas(faces)
    up = normal[:, 2] > UPWARDS * size
    up[: len(mesh.top_faces)] = False
    colours = np.where(up[:, None], _UNDERCUT, _RUBBER)
    draw(axis, 1e3 * mesh.nodes[faces], colours, view)
    low, high = extent(mesh.nodes, view)
    axis.set_ylim(low[1] - _MARGIN, high[1] + _MARGIN)
    axis.set_title(title)


def _dimension(axis, start, span, text: str) -> None:
    """Draw a double arrow from start over span, and a text at its middle."""
    start, span = np.asarray(start), np.asarray(span)
    look = {"arrowstyle": "<->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", start + span, start, arrowprops=look)
    axis.text(
        *(start + 0.5 * span), text, ha="center", va="center", size=8,
        rotation=90 if span[1] else 0, color="k",
        bbox={"fc": "w", "ec": "none", "pad": 0.6},
    )  # fmt: skip


def _section(axis, mesh: TetMesh, normal: int, at: float, flat):
    """Draw the section of a sole by a plane across axis `normal` (0: x, 1: y).

    The plane is at `at` [mm]; `flat` maps points (k, 3) [mm] to the picture.
    Returns the corners of the section's box, (2, 2), or None if it is empty.
    """
    x = 1e3 * mesh.nodes[mesh.tets]
    x = x[np.abs(np.sign(x[:, :, normal] - at).sum(axis=1)) < 4]
    pieces = []
    for tet in x:
        ends = tet[EDGES]
        d = ends[:, :, normal] - at
        cut = (d[:, 0] < 0) != (d[:, 1] < 0)
        if cut.sum() < 3:
            continue
        d, ends = d[cut], ends[cut]
        share = (d[:, 0] / (d[:, 0] - d[:, 1]))[:, None]
        points = flat(ends[:, 0] + share * (ends[:, 1] - ends[:, 0]))
        turn = points - points.mean(axis=0)
        pieces.append(points[np.argsort(np.arctan2(turn[:, 1], turn[:, 0]))])
    if not pieces:
        return None
    axis.add_collection(
        PolyCollection(pieces, facecolors=_RUBBER, edgecolors=_RUBBER, lw=0.8)
    )
    every = np.concatenate(pieces)
    return np.stack([every.min(axis=0), every.max(axis=0)])


def _thickness(axis, mesh: TetMesh, x, y, place, lift=0.0) -> None:
    """Draw the dimension of the sole's thickness at a point (x, y) [mm].

    It is drawn at `place` in the picture, where z = 0 is at `lift`.
    """
    corners = 1e3 * mesh.nodes[mesh.boundary_faces]
    # Moved off the edges and diagonals of regular meshes.
    point = np.array([[x, y]]) + 1e-4 * np.array([np.pi, np.e])
    for _, (z,) in crossings(corners, point):
        low, high = z.min(), z.max()
        text = f"{high - low:.1f}"
        _dimension(axis, (place, lift + low), (0, high - low), text)


def _peak(figure, axis, mesh: TetMesh, peak: np.ndarray) -> None:
    place, kpa = 1e3 * mesh.nodes[mesh.contact][:, :2], 1e-3 * peak
    drawn = _pressed(axis, mesh, kpa)
    top = int(np.argmax(kpa))
    axis.plot(*place[top], "x", color="cyan")
    axis.set_ylim(place[:, 1].min() - _MARGIN, place[:, 1].max() + _MARGIN)
    axis.set_title(
        f"largest pressure of the step, from above; ×: {kpa[top]:.0f} kPa"
    )
    figure.colorbar(drawn, ax=axis, label="pressure [kPa]", shrink=0.8)
