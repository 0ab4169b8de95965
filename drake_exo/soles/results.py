"""Figures of one simulation: tables over time, summary, nodal quantities."""

import csv
from pathlib import Path

import numpy as np

from drake_exo.soles.contact.newton import Start
from drake_exo.soles.contact.node_law import ContactLaw
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.rotations import angles_xyz, tilt_deg
from drake_exo.soles.step import stiffness
from drake_exo.soles.step.simulation import StepHistory


def nodal_areas(mesh: TetMesh) -> np.ndarray:
    """Rest area around each contact node [m²], (m,)."""
    x = mesh.nodes[mesh.contact_faces]
    area = 0.5 * np.linalg.norm(
        np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
    )
    total = np.bincount(
        mesh.contact_faces.ravel(),
        np.repeat(area / 3, 3),
        minlength=len(mesh.nodes),
    )
    return total[mesh.contact]


def principal_strains(eps: np.ndarray) -> np.ndarray:
    """Eigenvalues of symmetric 3 × 3 matrices, largest first, (..., 3).

    Trigonometric closed form (Smith, Comm. ACM 4, 1961).
    """
    q = np.trace(eps, axis1=-2, axis2=-1) / 3
    dev = eps - q[..., None, None] * np.eye(3)
    p = np.sqrt((dev**2).sum(axis=(-2, -1)) / 6)
    safe = np.where(p > 0, p, 1.0)
    r = np.linalg.det(dev / safe[..., None, None]) / 2
    phi = np.arccos(np.clip(r, -1.0, 1.0)) / 3
    angle = phi[..., None] + 2 * np.pi / 3 * np.array([0, 2, 1])
    values = q[..., None] + 2 * p[..., None] * np.cos(angle)
    return -np.sort(-values, axis=-1)


def largest_strain(sole: Sole, history: StepHistory) -> float:
    """Largest |principal strain| over elements and converged samples."""
    f_L = history.F @ history.R
    largest = 0.0
    for q in np.flatnonzero(history.converged):
        eps = sole.strain(sole.displacement(f_L[q]))
        # |λ| <= Frobenius norm: most elements need no eigenvalues.
        norm = np.sqrt((eps**2).sum(axis=(1, 2)))
        able = norm > largest
        if able.any():
            values = np.abs(principal_strains(eps[able]))
            largest = max(largest, float(values.max()))
    return largest


def complementarity(
    history: StepHistory, law: ContactLaw, start: Start, lP: np.ndarray
) -> float:
    """Largest violation of Signorini's and Coulomb's laws, normalised.

    Forces by |F| of the sample, lengths by |F|/r: negative force, gap,
    force times gap, force outside the cone, and force not opposite to the
    slip.
    """
    worst = 0.0
    before = None
    for q in np.flatnonzero(history.converged):
        F, P, R = history.F[q], history.P[q], history.R[q]
        scale = np.linalg.norm(F.sum(axis=0))
        Q = start.reference(R, lP) if before is None else before[:, :2]
        f = F / scale
        gap = P[:, 2] * law.penalty / scale
        slip = (P[:, :2] - Q) * law.penalty / scale
        size = np.linalg.norm(f[:, :2], axis=1)
        room = law.friction * f[:, 2] - size
        speed = np.linalg.norm(slip, axis=1)
        touching = f[:, 2] > 0
        # Slip with room in the cone, or not against the force.
        free = np.minimum(room, speed)[touching]
        along = (f[:, :2] * slip).sum(axis=1) + size * speed
        worst = max(
            worst,
            -f[:, 2].min(),
            -gap.min(),
            np.abs(f[:, 2] * gap).max(),
            -room.min(),
            free.max(initial=0.0),
            along[touching].max(initial=0.0),
        )
        before = P
    return float(worst)


def step_table(load: Load, history: StepHistory) -> dict[str, np.ndarray]:
    """Columns over time, by name with unit."""
    angles = np.rad2deg(angles_xyz(history.R))
    touching = history.F[:, :, 2] > 0
    columns = {"time_s": load.times}
    for k, axis in enumerate("xyz"):
        columns[f"force_{axis}_n"] = load.force[:, k]
    columns["zmp_x_m"], columns["zmp_y_m"] = load.zmp.T
    for k, axis in enumerate("xyz"):
        columns[f"origin_{axis}_m"] = history.O[:, k]
    for k, name in enumerate(("roll", "pitch", "yaw")):
        columns[f"{name}_deg"] = angles[:, k]
    columns["tilt_deg"] = tilt_deg(history.R)
    columns["sigma_max_tr_n_per_m"] = stiffness.sigma_max_translation(
        history.K_c
    )
    columns["sigma_min_rot_nm_per_rad"] = stiffness.sigma_min_rotation(
        history.K_c
    )
    columns["stability_n_per_m"] = stiffness.stability(history.K_c)
    columns["nodes_in_contact"] = touching.sum(axis=1)
    columns["newton_iterations"] = np.array(
        [r.iterations for r in history.reports]
    )
    columns["residual"] = np.array([r.residual for r in history.reports])
    columns["converged"] = history.converged.astype(int)
    return columns


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Columns of equal length under a header line."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([f"{float(v):.10g}" for v in row])


def write_history(path: Path, mesh: TetMesh, load: Load, history) -> None:
    """Forces, poses, places and stiffness over time as NPZ."""
    np.savez_compressed(
        path,
        times=load.times,
        force_W=history.F,
        origin_W=history.O,
        rotation_WL=history.R,
        place_W=history.P,
        stiffness=history.K_c,
        contact_nodes=mesh.contact,
        nodes_L=mesh.nodes,
        tets=mesh.tets,
    )


def summary(case, sole: Sole, history: StepHistory) -> dict:
    """What summary.json says about one simulation (no seconds)."""
    weight, fraction = case.cost.weight, case.cost.heel_strike_fraction
    c_tr, c_rot, c = history.costs(weight, fraction)
    margin = stiffness.stability(history.K_c)
    mesh = sole.mesh
    density = sole.material.density_kg_per_m3
    failures = [
        {"step": q, "message": report.message}
        for q, report in enumerate(history.reports)
        if not report.converged
    ]
    iterations = [r.iterations for r in history.reports]
    return {
        "name": case.name,
        "c_tr": c_tr,
        "c_rot": c_rot,
        "c": c,
        "weight": weight,
        "steps": len(history.reports),
        "failed_steps": history.failed_steps,
        "failures": failures[:20],
        "contact_nodes": len(mesh.contact),
        "nodes": len(mesh.nodes),
        "tets": len(mesh.tets),
        "volume_cm3": 1e6 * mesh.volume,
        "mass_kg": mesh.volume * density,
        "least_quality": float(mesh.quality().min()),
        "stable": bool(history.failed_steps == 0 and margin.min() > 0),
        "stability_min_n_per_m": float(np.min(margin)),
        "tilt_max_deg": float(tilt_deg(history.R).max()),
        "max_strain": largest_strain(sole, history),
        "newton_iterations_mean": float(np.mean(iterations)),
        "newton_iterations_max": int(np.max(iterations)),
    }
