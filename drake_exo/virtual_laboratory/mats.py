"""Pressure mats between cuffs and body, and the scan that says where they lie.

Every cuff presses on the front and the back of the segment; straps hold it
with a tension, so both mats see pressure at rest. The resultant along the
segment's x is the cuff's normal force.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.measurement.trial import Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model

MAT_RATE_HZ = 50.0
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
        cuff: that presses on it.
        body: link of the human that it lies on.
        face: "front" or "back".
        rows, columns: cells; rows run around the segment or along it.
        around: which of them runs around.
        legs: where one leg stands for both, "left" for a mat on that leg
            alone; None on a person of two legs.
    """

    cuff: str
    body: str
    face: str
    rows: int
    columns: int
    around: str
    legs: str | None = None

    @property
    def name(self) -> str:
        """Of the mat in study and files."""
        return f"{self.cuff}_{self.face}"

    @property
    def segment(self) -> str:
        """That it lies on, whichever leg it is of."""
        return self.body.split("_")[0]

    @property
    def tension_n(self) -> float:
        """Of the straps whose force it shows, or shows a share of [N]."""
        own_leg = self.legs is None and self.body != self.segment
        return (0.5 if own_leg else 1.0) * _TENSION_N[self.segment]


# Half axes of the segment's cross section, forward and left [m], and tension
# of its straps, both legs together [N].
_SECTION = {
    "shank": (0.058, 0.052),
    "thigh": (0.085, 0.078),
    "pelvis": (0.120, 0.170),
}
_TENSION_N = {"shank": 40.0, "thigh": 50.0, "pelvis": 50.0}
# Rows, columns, and which of them runs around the segment.
_CELLS = {
    "shank": (16, 8, "columns"),
    "thigh": (16, 8, "rows"),
    "pelvis": (32, 8, "rows"),
}


def _faces(cuff: str, body: str, legs: str | None) -> list[MatDesign]:
    cells = _CELLS[body.split("_")[0]]
    return [
        MatDesign(cuff, body, face, *cells, legs) for face in ("front", "back")
    ]


# Of the shipped exoskeleton: there are mats for the pelvis or for one leg.
CONFIGURATIONS = {
    "pelvis": tuple(_faces("pelvis", "pelvis", "both")),
    "legs": tuple(
        mat for part in ("thigh", "shank") for mat in _faces(part, part, "left")
    ),
}


def mats_on(
    cuffs: Collection[str], configuration: str
) -> tuple[MatDesign, ...]:
    """Mats of a configuration, in cuffs that are there."""
    return tuple(m for m in CONFIGURATIONS[configuration] if m.cuff in cuffs)


def mats_of(model: Model) -> tuple[MatDesign, ...]:
    """Mats under every cuff of two legs; none lie on feet."""
    ends = {cuff: human for cuff, (human, _) in model.tree.cuffs.items()}
    return tuple(
        mat
        for cuff, body in ends.items()
        if body.split("_")[0] in _CELLS
        for mat in _faces(cuff, body, None)
    )


def record_pressure(
    path: Path,
    movement: Trial,
    mats: Sequence[MatDesign],
    lag_s: float,
    model: Model,
    in_steps: bool,
    left_share: float = 0.5,
    seen: Mapping[str, float] | None = None,
) -> None:
    """Write a recording of the mats as Novel's software exports it.

    Nothing where there are none.

    Args:
        path: the .asc file.
        movement: what happened.
        mats: in the order of the file's columns.
        lag_s: of the mats' clock.
        model: wearer and device.
        in_steps: quantised, and no more than the sensor's range.
        left_share: of what both legs press, which mats on the left leg see.
        seen: cuff -> share of its force that mats see; all by default.
    """
    seen = seen or {}
    time = np.arange(1.0 / MAT_RATE_HZ, movement.times[-1], 1.0 / MAT_RATE_HZ)
    if not mats:
        return
    readings = []
    for mat in mats:
        force = movement.cuff(mat.cuff).normal
        normal = np.interp(time - lag_s, movement.times, force)
        share = seen.get(mat.cuff, 1.0)
        if mat.legs == "left":
            share *= left_share
        readings.append(share * cell_pressures(mat, model, normal))
    pressure = np.hstack(readings)
    if in_steps:
        pressure = _STEP_PA * np.round(pressure / _STEP_PA)
        pressure = np.minimum(pressure, _LARGEST_PA)
    _write_asc(path, time, pressure, mats)


def cell_pressures(
    mat: MatDesign, model: Model, normal: np.ndarray
) -> np.ndarray:
    """Pressure (N, cells) under the cuff's normal force (N,) [Pa].

    Front and back differ by the force and multiply to the square of the
    straps' tension, so that neither ever pulls.
    """
    middle = np.hypot(0.5 * normal, mat.tension_n)
    side = middle + (0.5 if mat.face == "back" else -0.5) * normal
    _, inward, around, along = cells(mat, model)
    shape = np.exp(-((around / _PATCH_RAD) ** 2) - (along / _PATCH_M) ** 2)
    total = CELL_AREA_M2 * np.sum(shape * np.abs(inward[:, 0]))
    return np.outer(side / total, shape)


def cells(mat: MatDesign, model: Model):
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
    cuff = model.cuffs[mat.cuff][1]
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
    folder: Path, model: Model, q: np.ndarray, mats: Sequence[MatDesign]
) -> dict[str, dict]:
    """Write the scanned segments and the cells on them, standing, in mm.

    Args:
        folder: receives scan_SEGMENT.obj and cells_MAT.csv.
        model: wearer and device.
        q: (nq,) standing posture.
        mats: that lie on them.

    Returns:
        The section `mats` of the study, by name.
    """
    section = {}
    for mat in mats:
        to_world = _placed(model.tree, q, mat.body)
        length = getattr(model.human, mat.segment).length_m
        scan = folder / f"scan_{mat.body}.obj"
        if mat.face == "front":  # one scan shows both
            _write_surface(scan, *_SECTION[mat.segment], length, to_world)
        rows, columns = np.indices((mat.rows, mat.columns)).reshape(2, -1) + 1
        centres = 1e3 * to_world(cells(mat, model)[0])
        lines = [
            f"{r},{c}," + ",".join(f"{x:.4f}" for x in p)
            for r, c, p in zip(rows, columns, centres, strict=True)
        ]
        text = "\n".join(["row,column,x,y,z", *lines]) + "\n"
        (folder / f"cells_{mat.name}.csv").write_text(text, encoding="utf-8")
        axis = 1e3 * to_world(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, length]]))
        section[mat.name] = {
            "segment": mat.cuff,
            "rows": mat.rows,
            "columns": mat.columns,
            "cell_area_m2": CELL_AREA_M2,
            **({} if mat.legs is None else {"legs": mat.legs}),
            "scan": {
                "file": scan.name,
                "unit": "mm",
                "cells": f"cells_{mat.name}.csv",
                "segment_axis": axis.round(4).tolist(),
            },
        }
    return section


def _placed(tree: PlanarTree, q, body):
    """Function from the segment's frame to x forward, y left, z up."""
    q = np.asarray(q)[None]
    x, z = tree.point_positions(q, body, (0.0, 0.0))[0]
    angle = tree.body_angles(q, body)[0]
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
        f"total time [secs]:  {len(time) / MAT_RATE_HZ:.3f}\t"
        f"time per frame [secs]:  {1.0 / MAT_RATE_HZ:.5f}\t"
        f"scanning rate [Hz]:   {MAT_RATE_HZ:g}\n"
        "pressure values in  kPa\n\n"
        f"mask definition: \n{masks}\n"
        "time[secs]\t" + "\t".join(f"{k}" for k in numbers) + "\n"
    )
    rows = [
        f"{t:.5f}\t" + "\t".join(f"{x:.4g}" for x in 1e-3 * p)
        for t, p in zip(time, pressure, strict=True)
    ]
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
