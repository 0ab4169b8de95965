"""Force on a segment from the pressures of a mat's cells.

The scanned body gives the positions and directions of the cells. Each cell's
force is pressure times area along the body's inward normal. The forces are
summed in the segment's axes; their x component, across the segment in the
sagittal plane, is the normal force of the paper. Shear is not measured.
"""

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import igl
import numpy as np
from scipy.spatial import cKDTree

from drake_exo.errors import InputError
from drake_exo.files.mesh import read_cells
from drake_exo.files.pressure import (
    PressureRecording,
    read_novel_asc,
    read_places,
    read_pressure_csv,
    split,
)
from drake_exo.files.tables import LENGTHS, kept, kind_of, uniform_time
from drake_exo.measurement.exoskeleton import Signal
from drake_exo.measurement.filters import linear
from drake_exo.measurement.sagittal import Axes
from drake_exo.measurement.settings import Filter, Mat, PressureFile, Scan
from drake_exo.model.assembly import SIDES

# Largest extent of a scan, of a body or a part of it [m].
_PLAUSIBLE_M = (0.08, 3.0)
_FARTHEST_M = 0.05  # of a mat's corner or cell from the surface
_SAMPLES = 65  # points of a line projected onto the surface
# |vector area| / area above this is a patch: 0 if closed, 0.64 half a cylinder.
_PATCH_SHARE = 0.8


class Surface:
    """A triangulated surface; x forward, y left, z up.

    Args:
        vertices: (V, 3) [m].
        triangles: (F, 3) vertex indices, counter-clockwise from outside.
        source: file name.
    """

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, source: str
    ):
        self.vertices, self.triangles = vertices, triangles
        self.source = source
        corners = vertices[triangles]
        a, b, c = corners.transpose(1, 0, 2)
        self._area = 0.5 * np.cross(b - a, c - a)
        self._centres = corners.mean(axis=1)
        self._tree = cKDTree(self._centres)
        self._boxes = igl.AABB()
        self._boxes.init(vertices, triangles)

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest points (P, 3) of the surface, and their triangles (P,)."""
        _, triangles, on = self._boxes.squared_distance(
            self.vertices, self.triangles, points
        )
        return on, triangles

    def normals(self, points, triangles, radius: float) -> np.ndarray:
        """Outward unit normals (P, 3), averaged within a radius [m]."""
        total = self._area[triangles].copy()
        for i, near in enumerate(self._tree.query_ball_point(points, radius)):
            if near:
                total[i] += self._area[near].sum(axis=0)
        return total / np.linalg.norm(total, axis=1, keepdims=True)

    def lay(self, start, end) -> np.ndarray:
        """Chords between points (L, 3), projected on the surface (L, S, 3)."""
        t = np.linspace(0.0, 1.0, _SAMPLES)[None, :, None]
        chord = start[:, None] + t * (end - start)[:, None]
        on, _ = self.closest(chord.reshape(-1, 3))
        return on.reshape(chord.shape)


def read_surface(path: Path, scan: Scan) -> Surface:
    """Read a scan (.stl, .ply, .obj).

    Raises:
        InputError: unreadable, no triangles, a size impossible for a body in
            the study's unit, or a patch whose outer side is ambiguous.
    """
    kind_of(path, (".stl", ".ply", ".obj"), "a scan")
    return _surface(path, scan.unit, scan.axes)


@kept(8)  # every trial reads the scans of all mats
def _surface(path: Path, unit: str, axes: Axes) -> Surface:
    raw, triangles, _ = read_cells(path, "triangle", "export it again")
    if len(triangles) == 0:
        raise InputError(f"{path}: holds no triangles; export a mesh")
    extent = float(np.ptp(raw[np.unique(triangles)], axis=0).max())
    low, high = _PLAUSIBLE_M
    if not low <= LENGTHS[unit] * extent <= high:
        fitting = [u for u, s in LENGTHS.items() if low <= s * extent <= high]
        hint = f"say 'unit: {' or '.join(fitting)}' in its scan"
        raise InputError(
            f"{path}: the scan spans {extent:.4g} {unit} in the study's unit, "
            f"which no body does; {hint if fitting else 'check the file'}"
        )
    points = LENGTHS[unit] * raw @ axes.R_PL.T
    return _outwards(Surface(points, triangles, str(path)))


def _outwards(surface: Surface) -> Surface:
    """Flip all triangles if they face the body's middle.

    A flat surface keeps the orientation of its file.

    Raises:
        InputError: a patch faces its own middle, so that it may be either a
            hollow or inside out.
    """
    area = surface._area
    away = area * (surface._centres - surface._centres.mean(axis=0))
    if away.sum() >= -1e-4 * np.abs(away).sum():
        return surface
    whole = np.linalg.norm(area, axis=1).sum()
    if np.linalg.norm(area.sum(axis=0)) > _PATCH_SHARE * whole:
        raise InputError(
            f"{surface.source}: shows so little of the body, and is hollow or "
            "inside out, that its outer side cannot be told; scan the segment "
            "further around, or give plane_normal instead"
        )
    flipped = surface.triangles[:, ::-1]
    return Surface(surface.vertices, flipped, surface.source)


def place_cells(
    surface: Surface, scan: Scan, rows: int, columns: int, root: Path
) -> np.ndarray:
    """Centres (rows * columns, 3) of a mat's cells on the surface [m].

    The edges along the mat's first and last column are projected onto the
    surface, then every row between them; cells lie evenly along these lines.

    Raises:
        InputError: corners or cells are off the surface, or the file of
            cells does not fit the mat.
    """
    given, what, source = scan.corners, "corner", surface.source
    if scan.cells is not None:
        what, source = "cell", root / scan.cells
        given = _read_cells(source, rows, columns)
    points = LENGTHS[scan.unit] * np.array(given) @ scan.axes.R_PL.T
    on = surface.closest(points)[0]
    off = np.linalg.norm(on - points, axis=1)
    if off.max() > _FARTHEST_M:
        raise InputError(
            f"{source}: {what} {int(off.argmax()) + 1} of the mat "
            f"lies {off.max():.3g} m off the scanned surface "
            f"({surface.source}); give the whole scan, and both in its own "
            "unit and axes"
        )
    if scan.cells is not None:
        return on
    first, last = surface.lay(on[[0, 1]], on[[3, 2]])
    share = (np.arange(rows) + 0.5) / rows
    lines = surface.lay(_along(first, share), _along(last, share))
    share = (np.arange(columns) + 0.5) / columns
    return np.concatenate([_along(line, share) for line in lines])


def _along(line: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Points (k, 3) at shares (k,) of the length of a line (S, 3)."""
    length = np.linalg.norm(np.diff(line, axis=0), axis=1)
    s = np.r_[0.0, np.cumsum(length)]
    s = s / s[-1] if s[-1] > 0.0 else np.linspace(0.0, 1.0, len(s))
    return linear(s, line, share)


def _read_cells(path: Path, rows: int, columns: int) -> np.ndarray:
    """Positions of the cells (rows * columns, 3), row by row."""
    table = read_places(path)
    wanted = [(r, c) for r in range(rows) for c in range(columns)]
    found = {(row - 1, column - 1): xyz for row, column, *xyz in table}
    if sorted(found) != wanted or len(table) != len(wanted):
        raise InputError(
            f"{path}: must hold row (1 to {rows}), column (1 to {columns}), "
            f"x, y, z of each of the {rows * columns} cells once"
        )
    return np.array([found[key] for key in wanted])


_PITCH = (0.5, 2.0)  # distance of neighbouring cells on the scan over size
_LONG = 3.0  # above this ratio of pitches, rows and columns are exchanged


@dataclass(frozen=True, kw_only=True)
class MatForce(Signal):
    """Filtered force of one mat on the human; doubled if of one leg alone.

    Values are (N, 3) in the segment's axes: x forward, y left, z up [N].

    Attributes:
        name, segment: of the mat, and of the cuff under which it lies.
        report: fit of the cells to the scan, peak pressure, doubling.
    """

    name: str
    segment: str
    report: dict[str, Any]

    @property
    def normal(self) -> np.ndarray:
        """Force (N,) on the human normal to the segment [N]."""
        return self.values[:, 0]


def read_mat_forces(
    files: tuple[PressureFile, ...],
    mats: dict[str, Mat],
    root: Path,
    settings: Filter,
) -> tuple[MatForce, ...]:
    """Read the pressure recordings of a trial as forces of its mats.

    Raises:
        InputError: unreadable; another number of cells than the mats have;
            too short or too slow for the filter; a scan that does not fit.
    """
    found, seen = [], defaultdict(set)
    for mat in (mats[name] for file in files for name in file.mats):
        seen[mat.segment].add(mat.legs)
    for file in files:
        recording = _read(root / file.file, file.mats, mats)
        time = uniform_time(recording.source, recording.time)
        rate = (len(time) - 1) / (time[-1] - time[0])
        for name in file.mats:
            mat = mats[name]
            inward, report = cell_directions(mat, name, root)
            pressure = recording.matrix(name, mat.rows, mat.columns)
            cells = pressure.reshape(len(time), -1) * mat.cell_area_m2
            force = settings.smooth(cells @ inward, rate, recording.source)
            report |= _seen(pressure)
            report["forward_share"] = float(inward[:, 0].mean())
            if mat.legs != "both" and not seen[mat.segment] >= set(SIDES):
                force = 2.0 * force
                report["doubled"] = f"{mat.legs} leg measured, doubled"
            about = {"name": name, "segment": mat.segment, "report": report}
            found.append(MatForce(time, force, recording.source, **about))
    return tuple(found)


def _seen(pressure: np.ndarray) -> dict[str, float]:
    """Peak pressure, share of loaded readings at the peak, and stuck cells.

    Cells saturate at one value, so many readings at the peak mean that forces
    are underestimated. A cell that never changes and shows more than twice
    what any other cell reaches is broken.
    """
    peak = float(pressure.max())
    loaded = pressure > 0.0
    share = 0.0
    if peak > 0.0:
        share = float((pressure[loaded] >= peak * (1.0 - 1e-9)).mean())
    cells = pressure.reshape(len(pressure), -1)
    moves = np.ptp(cells, axis=0) > 0.0
    beyond = cells[0, ~moves] > 2.0 * cells[:, moves].max(initial=0.0)
    found = {"peak_kpa": 1e-3 * peak, "at_peak_share": share}
    if moves.any() and beyond.any():
        found["stuck_cells"] = int(beyond.sum())
    return found


def _read(path: Path, names, mats: dict[str, Mat]) -> PressureRecording:
    sizes = {n: (mats[n].rows, mats[n].columns) for n in names}
    kind = path.suffix.lower()
    if kind == ".csv":
        return read_pressure_csv(path, sizes)
    if kind != ".asc":
        raise InputError(
            f"{path}: is not a pressure file that can be read; give Novel's "
            ".asc or .csv"
        )
    recording = read_novel_asc(path)
    if all(name in recording.groups for name in names):
        for name in recording.groups:
            if name in mats and name not in names:
                raise InputError(
                    f"{path}: holds the mat {name}, too; name it in "
                    "pressure.mats, or leave it out of the study's mats"
                )
        return recording
    groups = split(path, recording.pressure.shape[1], sizes)
    for name, own in recording.groups.items():
        # A file without a mask has one group of all cells.
        named = len(recording.groups) > 1 and name in groups
        if named and not np.array_equal(own, groups[name]):
            raise InputError(
                f"{path}: holds the mats {', '.join(recording.groups)}; "
                f"{name} is elsewhere in pressure.mats: name them all as the "
                "file does, or list them in its order"
            )
    return replace(recording, groups=groups)


def cell_directions(
    mat: Mat, name: str, root: Path
) -> tuple[np.ndarray, dict[str, Any]]:
    """Inward unit normals (cells, 3) of a mat's cells in the segment's axes.

    Args:
        mat: number and position of the cells.
        name: the mat's, for messages.
        root: folder of the scan.

    Returns:
        The normals, and a report of how the cells fit the surface.

    Raises:
        InputError: see `read_surface` and `place_cells`; also if the cells'
            pitch on the scan does not fit their size.
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
    # Distances of neighbours: from row to row, and within a row.
    grid = points.reshape(mat.rows, mat.columns, 3)
    steps = [
        np.linalg.norm(np.diff(grid, axis=k), axis=2).ravel() for k in (0, 1)
    ]
    steps = [d for d in steps if len(d)]
    pitch = np.concatenate(steps).mean() if steps else size
    if not _PITCH[0] < pitch / size < _PITCH[1]:
        raise InputError(
            f"{surface.source}: cells of {name} lie {1e3 * pitch:.1f} mm "
            f"apart on the scan, but measure {1e3 * size:.1f} mm; correct "
            "the mat's corners, its size or cell_area_m2"
        )
    apart = [1e3 * d.mean() for d in steps]
    if apart and max(apart) > _LONG * min(apart):
        raise InputError(
            f"{surface.source}: cells of {name} lie {apart[0]:.1f} mm apart "
            f"from row to row, {apart[1]:.1f} mm in a row; rows and columns "
            "look exchanged, or the mat's corners begin with another one"
        )
    outward = surface.normals(on, triangles, 0.5 * size)
    report = {"surface": scan.file.as_posix()}
    if steps:
        report["cell_distance_mm"] = 1e3 * float(pitch)
    return -outward @ _to_segment(scan).T, report


_AXIS = 0.02, 2.0  # shortest and longest segment [m]


def _to_segment(scan: Scan) -> np.ndarray:
    """Rotation (3, 3) from forward, left, up to the segment's axes."""
    if scan.segment_axis is None:
        return np.eye(3)
    low, high = LENGTHS[scan.unit] * scan.axes.points(scan.segment_axis)
    x, z = high - low
    length = np.hypot(x, z)
    if not _AXIS[0] < length < _AXIS[1]:
        raise InputError(
            f"{scan.file}: the two points of segment_axis are {length:.3g} m "
            "apart; give the lower and the upper joint centre in the scan's "
            "unit"
        )
    if z < -0.5 * length:  # a lying segment passes
        raise InputError(
            f"{scan.file}: the second point of segment_axis is {-z:.3g} m "
            "below the first; give the lower joint centre first, or correct "
            "up in the scan's axes"
        )
    # z along the segment in the sagittal plane, x perpendicular, forward.
    return np.array([[z, 0.0, -x], [0.0, length, 0.0], [x, 0.0, z]]) / length
