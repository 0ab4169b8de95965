"""Plots of a step: load (Figs. 6, 7), stiffness (Fig. 13), pose, pressure."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation
from scipy.spatial import ConvexHull

from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.simulation import StepHistory

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
