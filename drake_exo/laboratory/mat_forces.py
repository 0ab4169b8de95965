"""From the pressure of a mat's cells to the force on a segment.

Pressure times area acts along the inward normal of the body's surface. The
vectors are summed, and turned into the segment's axes: what is across the
segment in the sagittal plane (its x) is the normal force of the paper. Shear
is not measured.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.body_surface import (
    LENGTHS,
    place_cells,
    read_surface,
)
from drake_exo.laboratory.filters import check_filterable, low_pass
from drake_exo.laboratory.instruments import Mat, PressureFile, Scan
from drake_exo.laboratory.pressure_files import (
    PressureRecording,
    read_novel_asc,
    read_pressure_csv,
)
from drake_exo.laboratory.sagittal import SagittalFrame
from drake_exo.laboratory.tables import uniform_time
from drake_exo.study import Filter

_PITCH = (0.5, 2.0)  # cells' distance on the scan against their size


@dataclass(frozen=True)
class MatForce:
    """Force of one mat on the human, filtered, of both legs.

    Attributes:
        name, segment: of the mat and of what it lies on.
        time: (N,) evenly spaced [s].
        force: (N, 3) in the segment's axes (x forward, y left, z up) [N].
        source: file name.
        report: how cells were mapped, what was doubled.
    """

    name: str
    segment: str
    time: np.ndarray
    force: np.ndarray
    source: str
    report: dict[str, Any]

    @property
    def normal(self) -> np.ndarray:
        """Force (N,) on the human normal to the segment [N]."""
        return self.force[:, 0]

    def delayed(self, delay_s: float) -> "MatForce":
        """The same force with a lag of its clock taken out."""
        return replace(self, time=self.time - delay_s)


def read_mat_forces(
    files: tuple[PressureFile, ...],
    mats: dict[str, Mat],
    root: Path,
    settings: Filter,
) -> tuple[MatForce, ...]:
    """Read the pressure recordings of a trial.

    Raises:
        InputError: unreadable; another number of cells than the mats have;
            too short or too slow for the filter; a scan that does not fit.
    """
    found = []
    for file in files:
        recording = _read(root / file.file, file.mats, mats)
        time = uniform_time(recording.source, recording.time)
        rate = (len(time) - 1) / (time[-1] - time[0])
        check_filterable(recording.source, len(time), rate, settings.cutoff_hz)
        for name in file.mats:
            mat = mats[name]
            inward, report = cell_directions(mat, name, root)
            pressure = recording.matrix(name, mat.rows, mat.columns)
            cells = pressure.reshape(len(time), -1) * mat.cell_area_m2
            force = low_pass(
                cells @ inward,
                rate,
                settings.cutoff_hz,
                settings.order,
                recording.source,
            )
            report |= _seen(pressure)
            if mat.legs != "both":
                force = 2.0 * force
                report["doubled"] = f"{mat.legs} leg measured, doubled"
            found.append(
                MatForce(
                    name, mat.segment, time, force, recording.source, report
                )
            )
    return tuple(found)


def _seen(pressure: np.ndarray) -> dict[str, float]:
    """Peak, and how much of the readings sits exactly at it.

    Cells that saturate do so at one value: many readings at the peak mean
    that forces are underestimated.
    """
    peak = float(pressure.max())
    loaded = pressure > 0.0
    share = 0.0
    if peak > 0.0:
        share = float((pressure[loaded] >= peak * (1.0 - 1e-9)).mean())
    return {"peak_kpa": 1e-3 * peak, "at_peak_share": share}


def _read(path: Path, names, mats: dict[str, Mat]) -> PressureRecording:
    sizes = {n: (mats[n].rows, mats[n].columns) for n in names}
    kind = path.suffix.lower()
    if kind == ".csv":
        return read_pressure_csv(path, sizes)
    if kind != ".asc":
        raise InputError(
            f"{path}: is no pressure file that can be read; give Novel's "
            ".asc or .csv"
        )
    recording = read_novel_asc(path)
    if all(name in recording.groups for name in names):
        return recording
    cells = recording.pressure.shape[1]
    wanted = sum(r * c for r, c in sizes.values())
    if cells != wanted:
        said = ", ".join(f"{n} {r} x {c}" for n, (r, c) in sizes.items())
        raise InputError(
            f"{path}: has {cells} cells, but the mats ({said}) have {wanted}; "
            "correct the sizes in the study or the export"
        )
    groups, at = {}, 0
    for name, (r, c) in sizes.items():
        groups[name] = np.arange(at, at + r * c)
        at += r * c
    return replace(recording, groups=groups)


def cell_directions(
    mat: Mat, name: str, root: Path
) -> tuple[np.ndarray, dict[str, Any]]:
    """Inward unit normals (cells, 3) in the segment's axes.

    Args:
        mat: which cells, and where they are.
        name: for messages.
        root: folder of the scan.

    Returns:
        The normals, and how well the cells fit the surface.

    Raises:
        InputError: see `read_surface` and `place_cells`; cells that lie much
            closer or farther apart than they are large.
    """
    count = mat.rows * mat.columns
    if mat.plane_normal is not None:
        n = np.array(mat.plane_normal, float)
        inward = np.tile(-n / np.linalg.norm(n), (count, 1))
        return inward, {"surface": "plane"}
    scan = mat.scan
    surface = read_surface(root / scan.file, scan)
    points = place_cells(surface, scan, mat.rows, mat.columns, root)
    on, triangles = surface.closest(points)
    size = np.sqrt(mat.cell_area_m2)
    pitch = _pitch(points.reshape(mat.rows, mat.columns, 3))
    if pitch and not _PITCH[0] < pitch / size < _PITCH[1]:
        raise InputError(
            f"{surface.source}: cells of {name} lie {1e3 * pitch:.1f} mm "
            f"apart on the scan, but measure {1e3 * size:.1f} mm; correct "
            "the mat's corners, its size or cell_area_m2"
        )
    outward = surface.normals(on, triangles, 0.5 * size)
    report = {"surface": scan.file.as_posix()}
    if pitch:
        report["cell_distance_mm"] = 1e3 * pitch
    return -outward @ _to_segment(scan).T, report


def _pitch(grid: np.ndarray) -> float | None:
    """Mean distance of neighbouring cells; None for a single one."""
    steps = [
        np.linalg.norm(np.diff(grid, axis=k), axis=2).ravel() for k in (0, 1)
    ]
    steps = np.concatenate(steps)
    return float(steps.mean()) if len(steps) else None


def _to_segment(scan: Scan) -> np.ndarray:
    """Rotation (3, 3) from forward, left, up to the segment's axes."""
    if scan.segment_axis is None:
        return np.eye(3)
    frame = SagittalFrame(scan.axes.forward, scan.axes.up)
    low, high = LENGTHS[scan.unit] * frame.points(scan.segment_axis)
    x, z = high - low
    length = np.hypot(x, z)
    if not length > 0.02:
        raise InputError(
            f"{scan.file}: the two points of segment_axis are {length:.3g} m "
            "apart; give the lower and the upper joint centre"
        )
    # The segment's z in the sagittal plane, its x a quarter turn before.
    return np.array([[z, 0.0, -x], [0.0, length, 0.0], [x, 0.0, z]]) / length
