"""Shaded views of a surface, drawn as polygons in the plane.

Orthographic: faces that look away are dropped, the others painted from far
to near. Every view has the same scale, in millimetres.

Plots of a step: load (Figs. 6, 7), stiffness (Fig. 13), pose, pressure.
"""

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.tri import Triangulation
from scipy.spatial import ConvexHull

from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.step.simulation import StepHistory

# Faces that meet at less are shaded as one smooth surface.
_CREASE = np.cos(np.deg2rad(40.0))
_AMBIENT, _DIFFUSE = 0.4, 0.65
_LIGHT = np.array([-0.4, -0.2, 0.894])  # right, up, towards the viewer


@dataclass(frozen=True)
class View:
    """Where from a sole is seen; x forward, y left, z up.

    Attributes:
        name: Title.
        toward: From the sole to the viewer.
        up: What is up in the picture.
    """

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


@dataclass(frozen=True)
class Surface:
    """Triangles with colours and smooth normals, ready for any view.

    Attributes:
        corners: (f, 3, 3) [mm].
        normals: Unit normals at the corners, (f, 3, 3).
        colours: At the corners, RGB, (f, 3, 3).
    """

    corners: np.ndarray
    normals: np.ndarray
    colours: np.ndarray

    def refined(self) -> "Surface":
        """Every triangle cut into four."""
        cut = [_cut(a) for a in (self.corners, self.normals, self.colours)]
        cut[1] /= np.linalg.norm(cut[1], axis=2, keepdims=True)
        return Surface(*cut)


def _cut(a: np.ndarray) -> np.ndarray:
    p, q, r = a[:, 0], a[:, 1], a[:, 2]
    pq, qr, rp = 0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + p)
    parts = [(p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def surface(
    nodes: np.ndarray, faces: np.ndarray, colours: np.ndarray
) -> Surface:
    """A surface with normals smoothed but for creases.

    Args:
        nodes: (n, 3) [m].
        faces: Outward triangles, (f, 3).
        colours: RGB of the nodes, (n, 3).
    """
    corners = 1e3 * nodes[faces]
    across = np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    )
    flat = across / np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.empty_like(corners)
    order = np.argsort(faces.ravel(), kind="stable")
    ends = np.searchsorted(faces.ravel()[order], np.arange(len(nodes) + 1))
    for node in range(len(nodes)):
        mine = order[ends[node] : ends[node + 1]]
        around = mine // 3
        smooth = flat[around] @ flat[around].T > _CREASE
        normals.reshape(-1, 3)[mine] = smooth @ across[around]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Surface(corners, normals, colours[faces])


def draw(axis, shape: Surface, view: View) -> None:
    """Paint a surface into an axis of equal aspect."""
    frame = view.axes()
    seen = shape.corners @ frame.T
    edge = seen[:, 1:, :2] - seen[:, :1, :2]
    facing = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0] > 0
    seen = seen[facing]
    order = np.argsort(seen[:, :, 2].mean(axis=1), kind="stable")
    light = frame.T @ _LIGHT
    normal = shape.normals[facing].mean(axis=1)
    lit = _AMBIENT + _DIFFUSE * np.clip(normal @ light, 0.0, 1.0)
    colour = shape.colours[facing].mean(axis=1) * lit[:, None]
    colour = np.clip(colour, 0.0, 1.0)[order]
    axis.add_collection(
        PolyCollection(
            seen[order][:, :, :2],
            facecolors=colour,
            edgecolors=colour,
            linewidths=0.3,
            rasterized=True,
        )
    )


def outline(axis, nodes: np.ndarray, view: View) -> None:
    """Dashed silhouette of the convex hull of nodes [m]."""
    flat = 1e3 * nodes @ view.axes()[:2].T
    ring = flat[ConvexHull(flat).vertices]
    ring = np.concatenate([ring, ring[:1]])
    axis.plot(*ring.T, color="0.25", lw=0.8, ls=(0, (4, 3)))


def extent(nodes: np.ndarray, view: View) -> np.ndarray:
    """Lower and upper corner of nodes [m] in a view [mm], (2, 2)."""
    flat = 1e3 * nodes @ view.axes()[:2].T
    return np.stack([flat.min(axis=0), flat.max(axis=0)])


matplotlib.use("Agg")


_STYLE = {
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 150,
}


def _save(figure, path: Path) -> None:
    # No software version in the file: same input, same bytes.
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def load_figure(path: Path, load: Load, mesh: TetMesh) -> None:
    """ZMP on the sole's outline, and force over time (Figs. 6 and 7)."""
    with plt.rc_context(_STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8))
        outline = mesh.nodes[mesh.contact][:, :2]
        ring = ConvexHull(outline).vertices
        ring = np.append(ring, ring[0])
        left.fill(*(1e3 * outline[ring].T), color="0.93", zorder=0)
        left.plot(*(1e3 * outline[ring].T), color="0.5", lw=1)
        points = left.scatter(
            *(1e3 * load.zmp.T), c=load.times, s=9, cmap="viridis", zorder=3
        )
        figure.colorbar(points, ax=left, label="time [s]", shrink=0.8)
        left.plot(*(1e3 * load.zmp[0]), "o", mfc="none", mec="k", ms=9)
        left.annotate(
            "heel strike",
            1e3 * load.zmp[0],
            (8, 5),
            textcoords="offset points",
        )
        left.set(
            xlabel="x, forward [mm]",
            ylabel="y, left [mm]",
            title="ZMP on the sole",
            aspect="equal",
        )
        for k, (axis, colour) in enumerate(zip("xyz", "rgb", strict=True)):
            right.plot(
                load.times,
                load.force[:, k],
                color=f"tab:{dict(r='red', g='green', b='blue')[colour]}",
                label=f"$F_{axis}$",
            )
        right.set(xlabel="time [s]", ylabel="force [N]", title="Ground force")
        right.legend(ncols=3)
        _save(figure, path)


def stiffness_figure(path: Path, curves: dict, heel_strike: float) -> None:
    """σ_max(K_tr) and σ_min(K_rot) over the step (Fig. 13).

    Args:
        path: PNG file.
        curves: Label -> (times [s], σ_max [N/m], σ_min [N·m/rad]).
        heel_strike: End of heel strike [s].
    """
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6))
        titles = (
            r"$\sigma_{\max}(K_c^{\mathrm{tr}})$ [kN/m]",
            r"$\sigma_{\min}(K_c^{\mathrm{rot}})$ [N·m/rad]",
        )
        for k, axis in enumerate(axes):
            for label, values in curves.items():
                scale = 1e-3 if k == 0 else 1.0
                axis.plot(values[0], scale * values[k + 1], label=label)
            start = min(v[0][0] for v in curves.values())
            axis.axvspan(start, heel_strike, color="tab:orange", alpha=0.15,
                         lw=0, label="heel strike")  # fmt: skip
            axis.set(xlabel="time [s]", title=titles[k], ylim=(0, None))
            axis.margins(x=0.01)
        axes[0].legend()
        _save(figure, path)


def pose_figure(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Pose, stability and nodes in contact over time."""
    t = columns["time_s"]
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(2, 2, figsize=(9.0, 6.0), sharex=True)
        (place, turn), (stable, nodes) = axes
        for axis in "xyz":
            values = columns[f"origin_{axis}_m"]
            offset = values[0] if axis == "z" else 0.0
            label = f"{axis} − {1e3 * offset:.1f} mm" if offset else axis
            place.plot(t, 1e3 * (values - offset), label=label)
        place.set(ylabel="origin [mm]", title="Place of the foot")
        for name in ("roll", "pitch", "yaw"):
            turn.plot(t, columns[f"{name}_deg"], label=name)
        turn.set(ylabel="angle [°]", title="Orientation (Rx·Ry·Rz)")
        stable.plot(t, 1e-3 * columns["stability_n_per_m"], color="k")
        stable.axhline(0.0, color="tab:red", lw=1, ls="--")
        stable.set(
            xlabel="time [s]",
            ylabel="[kN/m]",
            title=r"Stability: least eigenvalue of $S\,\mathrm{sym}(-K_c)\,S$",
        )
        nodes.plot(t, columns["nodes_in_contact"], color="k")
        nodes.set(xlabel="time [s]", title="Nodes in contact", ylim=(0, None))
        place.legend()
        turn.legend()
        _save(figure, path)


def pressure_figure(
    path: Path, mesh: TetMesh, load: Load, history: StepHistory, areas
) -> None:
    """Contact pressure from below at eight samples of the step."""
    picked = np.flatnonzero(history.converged)
    if len(picked) == 0:
        return
    picked = picked[np.linspace(0, len(picked) - 1, 8).round().astype(int)]
    pressure = 1e-3 * history.F[picked][:, :, 2] / areas
    faces, place = _underside(mesh)
    top = max(float(pressure.max()), 1e-9)
    with plt.rc_context(_STYLE):
        figure, axes = plt.subplots(
            2, 4, figsize=(11.0, 4.2), sharex=True, sharey=True
        )
        for axis, q, p in zip(axes.flat, picked, pressure, strict=True):
            drawn = axis.tripcolor(
                Triangulation(*(1e3 * place.T), faces),
                p,
                shading="gouraud",
                cmap="inferno",
                vmin=0,
                vmax=top,
            )
            axis.plot(*(1e3 * load.zmp[q]), "+", color="cyan", ms=9, mew=2)
            axis.set_title(f"{load.times[q] - load.times[0]:.3f} s")
            axis.set_aspect("equal")
            axis.grid(False)
        for axis in axes[-1]:
            axis.set_xlabel("x [mm]")
        for axis in axes[:, 0]:
            axis.set_ylabel("y [mm]")
        figure.colorbar(
            drawn, ax=axes, label="contact pressure [kPa]", shrink=0.85
        )
        figure.suptitle(
            "Contact pressure, seen from above through the sole (+ ZMP)"
        )
        _save(figure, path)


def _underside(mesh: TetMesh) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that look down, as contact-node indices, and their places."""
    faces = mesh.contact_faces
    x = mesh.nodes[faces]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    down = normal[:, 2] < -0.3 * np.linalg.norm(normal, axis=1)
    down &= np.isin(faces, mesh.contact).all(axis=1)
    local = np.searchsorted(mesh.contact, faces[down])
    return local[:, [0, 2, 1]], mesh.nodes[mesh.contact][:, :2]
