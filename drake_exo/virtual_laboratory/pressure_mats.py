"""Pressure mats between cuffs and body: geometry, readings, files.

Every cuff presses on the front and the back of the segment; straps hold it
with a tension, so both mats see pressure at rest. The resultant along the
segment's x is the cuff's normal force.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.measurement.trial import Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.segments import HumanParameters

RATE_HZ = 50.0
CELL_AREA_M2 = 2e-4
_STEP_PA = 2500.0
_LARGEST_PA = 30000.0
_PITCH_M = np.sqrt(CELL_AREA_M2)
_PATCH_RAD, _PATCH_M = 0.45, 0.02  # of the pressed area, around and along
_FACETS = 96


@dataclass(frozen=True)
class MatDesign:
    """A mat on one face of a segment.

    Attributes:
        segment: "shank", "thigh" or "pelvis".
        face: "front" or "back".
        rows, columns: cells; rows run around the segment or along it.
        around: which of them runs around.
        legs: "left" for a mat on the left leg alone.
    """

    segment: str
    face: str
    rows: int
    columns: int
    around: str
    legs: str

    @property
    def name(self) -> str:
        """Of the mat in study and files."""
        return f"{self.segment}_{self.face}"


# Half axes of the segment's cross section, forward and left [m], and tension
# of its straps, both legs together [N].
_SECTION = {
    "shank": (0.058, 0.052),
    "thigh": (0.085, 0.078),
    "pelvis": (0.120, 0.170),
}
_TENSION_N = {"shank": 40.0, "thigh": 50.0, "pelvis": 50.0}
CONFIGURATIONS = {
    "pelvis": tuple(
        MatDesign("pelvis", face, 32, 8, "rows", "both")
        for face in ("front", "back")
    ),
    "legs": tuple(
        MatDesign(segment, face, 16, 8, around, "left")
        for segment, around in (("thigh", "rows"), ("shank", "columns"))
        for face in ("front", "back")
    ),
}


def record_pressure(
    path: Path,
    movement: Trial,
    configuration: str,
    lag_s: float,
    human: HumanParameters,
    in_steps: bool,
    left_share: float = 0.5,
    seen: Mapping[str, float] | None = None,
) -> None:
    """Write a recording of the mats as Novel's software exports it.

    Args:
        path: the .asc file.
        movement: what happened.
        configuration: a name in CONFIGURATIONS.
        lag_s: of the mats' clock.
        human: the wearer.
        in_steps: quantised, and no more than the sensor's range.
        left_share: of what both legs press, which mats on the left leg see.
        seen: cuff -> share of its force that mats see; all by default.
    """
    seen = seen or {}
    time = np.arange(1.0 / RATE_HZ, movement.times[-1], 1.0 / RATE_HZ)
    mats = CONFIGURATIONS[configuration]
    readings = []
    for mat in mats:
        force = movement.cuff(mat.segment).normal
        normal = np.interp(time - lag_s, movement.times, force)
        share = seen.get(mat.segment, 1.0)
        if mat.legs == "left":
            share *= left_share
        readings.append(share * cell_pressures(mat, human, normal))
    pressure = np.hstack(readings)
    if in_steps:
        pressure = _STEP_PA * np.round(pressure / _STEP_PA)
        pressure = np.minimum(pressure, _LARGEST_PA)
    _write_asc(path, time, pressure, mats)


def cell_pressures(
    mat: MatDesign, human: HumanParameters, normal: np.ndarray
) -> np.ndarray:
    """Pressure (N, cells) under both legs' normal force (N,) [Pa].

    Front and back differ by the force and multiply to the square of the
    straps' tension, so that neither ever pulls.
    """
    tension = _TENSION_N[mat.segment]
    middle = np.hypot(0.5 * normal, tension)
    side = middle + (0.5 if mat.face == "back" else -0.5) * normal
    _, inward, around, along = cells(mat, human)
    shape = np.exp(-((around / _PATCH_RAD) ** 2) - (along / _PATCH_M) ** 2)
    total = CELL_AREA_M2 * np.sum(shape * np.abs(inward[:, 0]))
    return np.outer(side / total, shape)


def cells(mat: MatDesign, human: HumanParameters):
    """Cells of a mat in its segment's frame.

    Returns:
        Centres (C, 3) x forward, y left, z up along the segment [m]; inward
        normals (C, 3); angle (C,) around from the middle of the mat [rad];
        distance (C,) along the segment from the cuff [m].
    """
    a, b = _SECTION[mat.segment]
    middle = 0.0 if mat.face == "front" else np.pi
    turns, lengths = mat.rows, mat.columns
    if mat.around == "columns":
        turns, lengths = lengths, turns
    angle = _even_angles(a, b, turns, middle)
    height = (np.arange(lengths) - 0.5 * (lengths - 1)) * _PITCH_M
    grid = np.meshgrid(angle, height, indexing="ij")
    if mat.around == "columns":
        grid = [g.T for g in grid]
    angle, height = (g.ravel() for g in grid)
    cuff = human.cuff_m(mat.segment)[1]
    centres = np.column_stack(
        [a * np.cos(angle), b * np.sin(angle), cuff + height]
    )
    normals = np.column_stack(
        [np.cos(angle) / a, np.sin(angle) / b, np.zeros(len(angle))]
    )
    normals /= -np.linalg.norm(normals, axis=1, keepdims=True)
    return centres, normals, angle - middle, height


def _even_angles(a, b, count, middle) -> np.ndarray:
    """Parameters of an ellipse a cell apart, about its front or back."""
    fine = np.linspace(-np.pi, np.pi, 4001)
    x, y = a * np.cos(fine + middle), b * np.sin(fine + middle)
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
    places = (np.arange(count) - 0.5 * (count - 1)) * _PITCH_M
    return middle + np.interp(places + 0.5 * s[-1], s, fine)


def write_scans(
    folder: Path, tree: PlanarTree, q: np.ndarray, human: HumanParameters
) -> dict[str, dict]:
    """Write the scanned segments and the cells on them, standing, in mm.

    Args:
        folder: receives scan_SEGMENT.obj and cells_MAT.csv.
        tree: the model.
        q: (9,) standing posture.
        human: the wearer.

    Returns:
        The section `mats` of the study, by name.
    """
    section = {}
    for segment in tree.cuffs:
        length = getattr(human, segment).length_m
        to_world = _placed(tree, q, segment)
        _write_surface(
            folder / f"scan_{segment}.obj", *_SECTION[segment], length, to_world
        )
    for mat in (m for mats in CONFIGURATIONS.values() for m in mats):
        to_world = _placed(tree, q, mat.segment)
        rows, columns = np.indices((mat.rows, mat.columns)).reshape(2, -1) + 1
        centres = 1e3 * to_world(cells(mat, human)[0])
        lines = [
            f"{r},{c}," + ",".join(f"{x:.4f}" for x in p)
            for r, c, p in zip(rows, columns, centres, strict=True)
        ]
        text = "\n".join(["row,column,x,y,z", *lines]) + "\n"
        (folder / f"cells_{mat.name}.csv").write_text(text, encoding="utf-8")
        length = getattr(human, mat.segment).length_m
        axis = 1e3 * to_world(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, length]]))
        section[mat.name] = {
            "segment": mat.segment,
            "rows": mat.rows,
            "columns": mat.columns,
            "cell_area_m2": CELL_AREA_M2,
            "legs": mat.legs,
            "scan": {
                "file": f"scan_{mat.segment}.obj",
                "unit": "mm",
                "cells": f"cells_{mat.name}.csv",
                "segment_axis": axis.round(4).tolist(),
            },
        }
    return section


def _placed(tree: PlanarTree, q, segment):
    """Function from the segment's frame to x forward, y left, z up."""
    q = np.asarray(q)[None]
    x, z = tree.point_positions(q, segment, (0.0, 0.0))[0]
    angle = tree.body_angles(q, segment)[0]
    c, s = np.cos(angle), np.sin(angle)

    def to_world(p):
        return np.column_stack(
            [
                x + c * p[:, 0] - s * p[:, 2],
                p[:, 1],
                z + s * p[:, 0] + c * p[:, 2],
            ]
        )

    return to_world


def _write_surface(path: Path, a, b, length, to_world) -> None:
    """An elliptic cylinder as OBJ, in mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)
    rings = max(round(length / 0.01), 2)
    heights = np.linspace(0.0, length, rings)
    p = np.array(
        [(a * np.cos(t), b * np.sin(t), h) for h in heights for t in angle]
    )
    lines = ["v " + " ".join(f"{x:.4f}" for x in v) for v in 1e3 * to_world(p)]
    for ring in range(rings - 1):
        for k in range(_FACETS):
            i, j = (ring * _FACETS + m % _FACETS + 1 for m in (k, k + 1))
            up_i, up_j = i + _FACETS, j + _FACETS
            lines += [f"f {i} {j} {up_j}", f"f {i} {up_j} {up_i}"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_asc(path: Path, time, pressure, mats) -> None:
    masks = "".join(
        f"{mat.name}: "
        + "".join(f"{k + 1}," for k in range(mat.rows * mat.columns))
        + "\n"
        for mat in mats
    )
    numbers = [k + 1 for m in mats for k in range(m.rows * m.columns)]
    head = (
        f"file name:  {path.stem}.sol\n"
        "sensor type:  pliance 2 cm2\n"
        f"total time [secs]:  {len(time) / RATE_HZ:.3f}\t"
        f"time per frame [secs]:  {1.0 / RATE_HZ:.5f}\t"
        f"scanning rate [Hz]:   {RATE_HZ:g}\n"
        "pressure values in  kPa\n\n"
        f"mask definition: \n{masks}\n"
        "time[secs]\t" + "\t".join(f"{k}" for k in numbers) + "\n"
    )
    rows = [
        f"{t:.5f}\t" + "\t".join(f"{x:.4g}" for x in 1e-3 * p)
        for t, p in zip(time, pressure, strict=True)
    ]
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
