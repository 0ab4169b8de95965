"""Pictures of designs: views of a sole (Figs. 8-12), cost histories."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.pictures import _STYLE, _save
from drake_exo.soles.results import write_csv

# Name, elevation, azimuth [°]; x is forward, y left.
_VIEWS = (
    ("from below, behind left", -30, 135),
    ("from below, ahead right", -30, -45),
    ("from below", -90, -90),
    ("from the left", 0, 90),
    ("from behind", 0, 180),
    ("from above", 90, -90),
)
_TRACE = ("stage", "iteration", "cost", "violation", "dual_infeasibility")
_LIGHT = np.array([0.4, 0.5, -0.8]) / np.linalg.norm([0.4, 0.5, 0.8])


def shape_figure(path: Path, mesh: TetMesh, title: str, outline=None) -> None:
    """Six shaded views of a sole; the initial shape's box in grey.

    Args:
        path: PNG file.
        mesh: Shape to draw.
        title: Heading.
        outline: Initial mesh, drawn as its bounding box.
    """
    with plt.rc_context({**_STYLE, "figure.constrained_layout.use": False}):
        figure = plt.figure(figsize=(12.0, 6.0))
        for k, (name, elevation, azimuth) in enumerate(_VIEWS):
            axis = figure.add_subplot(2, 3, k + 1, projection="3d")
            _draw(axis, mesh, elevation, azimuth, outline)
            axis.set_title(name, y=0.94, fontsize=10)
        figure.suptitle(title)
        figure.subplots_adjust(0.0, 0.0, 1.0, 0.9, 0.0, 0.05)
        _save(figure, path)


def _draw(axis, mesh, elevation, azimuth, outline):
    faces = 1e3 * mesh.nodes[mesh.boundary_faces]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    glued = np.isin(mesh.boundary_faces, mesh.dirichlet).all(axis=1)
    light = _LIGHT * ([1, 1, -1] if elevation > 45 else [1, 1, 1])
    shade = 0.62 + 0.38 * normal @ light
    colour = np.where(glued[:, None], [0.65, 0.65, 0.7], [0.85, 0.55, 0.3])
    axis.add_collection3d(
        Poly3DCollection(
            faces,
            facecolors=np.clip(colour * shade[:, None], 0, 1),
            edgecolors=(0, 0, 0, 0.12),
            linewidths=0.2,
        )
    )
    points = [1e3 * mesh.nodes]
    if outline is not None:
        points.append(_box(axis, 1e3 * outline.nodes))
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    axis.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2])
    )
    axis.set_box_aspect(high - low, zoom=1.12)
    axis.set_proj_type("ortho")
    axis.view_init(elevation, azimuth)
    axis.set_axis_off()


def _box(axis, nodes) -> np.ndarray:
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    corner = np.array(np.meshgrid(*zip(low, high, strict=True), indexing="ij"))
    corner = corner.reshape(3, -1).T
    for i in range(8):
        for bit in (1, 2, 4):
            if not i & bit:
                axis.plot(*corner[[i, i | bit]].T, color="0.6", lw=0.7)
    return corner


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
    path: Path, rows: list[dict], paper: dict, points: list[dict] = ()
) -> None:
    """c_tr against c_rot, each over its brick's, beside the paper's.

    Args:
        path: PNG file.
        rows: Summaries with name, ratio_tr and ratio_rot.
        paper: Name -> (ratio of c_tr, ratio of c_rot).
        points: Of the front, with ratio_tr and ratio_rot.
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
        if points:
            axis.plot(
                [p["ratio_tr"] for p in points],
                [p["ratio_rot"] for p in points],
                ".-", color="0.4", label="front",
            )  # fmt: skip
        axis.set(
            xscale="log",
            xlabel=r"$c^{tr}$ over the brick's (less is better)",
            ylabel=r"$c^{rot}$ over the brick's (more is better)",
        )
        axis.legend()
        _save(figure, path)
