"""List what a file holds, for every format that can be read."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.c3d import read_c3d
from drake_exo.files.mesh import read_cells
from drake_exo.files.opensim import has_plates, plates_of, read_table, read_trc
from drake_exo.files.optitrack import read_markers_csv, read_plate_csv
from drake_exo.files.osim import read_osim
from drake_exo.files.pressure import (
    PressureRecording,
    read_novel_asc,
    read_places,
    read_pressure_csv,
)
from drake_exo.files.tables import (
    COP_THRESHOLD_N,
    MarkerData,
    PlateRecording,
    Table,
    check_names,
    comma_separated,
    kind_of,
    number_rows,
    read_csv_table,
    read_text,
    runs,
)

_TOLD = 6  # most gaps listed in a line
_MESHES = (".stl", ".obj", ".ply", ".vtk", ".msh")


# A kind of signal, with rate and duration -> a line for each signal.
Contents = dict[str, list[str]]


def inspect(path: str | Path) -> str:
    """A file's contents as text: markers, gaps, plates and loads, channels.

    Args:
        path: .c3d, .trc, .mot, .sto, .csv (table, Motive's, pressure) or .asc;
            a mesh (.stl, .obj, .ply, .vtk, .msh) or a model (.osim).

    Raises:
        InputError: another format, or the file cannot be read.

    >>> inspect("walk.avi")
    Traceback (most recent call last):
    drake_exo.errors.InputError: walk.avi: is not in a format that can be \
read; give one of .c3d, .trc, .mot, .sto, .csv, .asc, .osim, .stl, .obj, \
.ply, .vtk, .msh
    """
    readers: dict[str, Callable[[Path], Contents]] = {
        ".c3d": _of_c3d,
        ".trc": lambda p: _markers(read_trc(p)),
        ".mot": _of_table,
        ".sto": _of_table,
        ".csv": _of_csv,
        ".asc": lambda p: _pressure(read_novel_asc(p)),
        ".osim": _of_model,
        **dict.fromkeys(_MESHES, _of_mesh),
    }
    contents = readers[kind_of(path, readers, "in a format")](Path(path))
    lines = [str(path)]
    for title, signals in contents.items():
        lines += [title, *(f"  {line}" for line in signals)]
    return "\n".join(lines)


def _of_c3d(path: Path) -> Contents:
    file = read_c3d(path)
    found = {} if file.markers is None else _markers(file.markers)
    if file.plates:
        found |= _plates(file.plate_time, file.plates)
    if file.analog is not None:
        found |= _channels(file.analog, "as the file has them")
    return found


def _of_table(path: Path) -> Contents:
    table = read_table(path)
    angles = {
        True: "angles in degrees, else in SI units",
        False: "angles in radians, else in SI units",
    }
    said = angles.get(table.in_degrees, "the header says no unit of angles")
    found = {}
    if has_plates(table):
        found = _plates(table.time, plates_of(table))
    return found | _channels(table, said)


def _of_csv(path: Path) -> Contents:
    lines = read_text(path).splitlines()
    first = next((s for s in lines if s.strip()), "")
    if any(s.startswith("MocapFrame") for s in lines):
        return _plates(*read_plate_csv(path))
    if "Format Version" in first:
        return _markers(read_markers_csv(path))
    cells = comma_separated(path, first)
    if [cell.strip().lower() for cell in cells[:2]] == ["row", "column"]:
        return _places(path)
    if ";" in cells[0] and len(cells) > 1:
        whole = {"cells": (1, len(cells) - 1)}
        return _pressure(read_pressure_csv(path, whole))
    if (names := [cell.strip() for cell in cells])[0] == "time_s":
        return _of_named_columns(path, lines, names)
    table = read_csv_table(path)
    found = {}
    if has_plates(table):
        found = _plates(table.time, plates_of(table))
    return found | _channels(table, "in SI units, angles in radians")


def _of_named_columns(path: Path, lines, names: list[str]) -> Contents:
    """Ranges in a table of a sole's step, whose names hold their units."""
    check_names(path, 1, names)
    _, *rows = [row for row in enumerate(lines, 1) if row[1].strip()]
    rows = [(number, line.split(",")) for number, line in rows]
    values = number_rows(path, rows, len(names))
    table = Table(values[:, 0], tuple(names[1:]), values[:, 1:], False)
    return _channels(table, "units in their names")


def _places(path: Path) -> Contents:
    """Range of the positions of a mat's cells."""
    table = read_places(path)
    low, high = table[:, 2:].min(axis=0), table[:, 2:].max(axis=0)
    count, across = (len(set(table[:, k])) for k in (0, 1))
    spans = [
        f"{axis}: {a:.4g} to {b:.4g}"
        for axis, a, b in zip("xyz", low, high, strict=True)
    ]
    title = f"{count} by {across} cells of a mat, in the scan's unit"
    return {title: spans}


def _of_mesh(path: Path) -> Contents:
    lines = []
    for kind, *names in (
        ("triangle", "triangle"),
        ("tetra", "tetrahedron", "tetrahedra"),
    ):
        nodes, cells, _ = read_cells(path, kind, "export it again")
        if len(cells):
            low, high = (f(nodes[cells], axis=(0, 1)) for f in (np.min, np.max))
            size = " by ".join(f"{x:.4g}" for x in high - low)
            lines.append(f"{_counted(len(cells), *names)}, {size}")
    if not lines:
        raise InputError(
            f"{path}: holds neither triangles nor tetrahedra; export them"
        )
    return {"mesh, lengths in the file's unit": lines}


def _of_model(path: Path) -> Contents:
    model = read_osim(path)
    bodies = [f"{n}: {b.mass_kg:.4g} kg" for n, b in model.bodies.items()]
    joints = [
        f"{j.name}: {j.kind}, {j.parent} to {j.child}"
        + "".join(f", {name}" for name in j.coordinates)
        for j in model.joints
    ]
    markers = [f"{n}: on {body}" for n, (body, _) in model.markers.items()]
    count = _counted(len(bodies), "body", "bodies")
    return {
        f"{count}, {model.mass_kg:.4g} kg": bodies,
        _counted(len(joints), "joint"): joints,
        _counted(len(markers), "marker"): markers,
    }


def _counted(count: int, one: str, several: str = "") -> str:
    return f"{count} {one if count == 1 else several or one + 's'}"


def _span(time: np.ndarray) -> str:
    """Rate, time range and number of samples, in words."""
    if len(time) < 2 or not time[-1] > time[0]:
        return f"{len(time)} samples"
    rate = (len(time) - 1) / (time[-1] - time[0])
    return f"{rate:.4g} Hz, {time[0]:g} to {time[-1]:g} s, {len(time)} samples"


def _markers(data: MarkerData) -> Contents:
    lines = []
    for i, name in enumerate(data.names):
        p = data.positions[:, i]
        unseen = ~np.isfinite(p).all(axis=1)
        if unseen.all():
            lines.append(f"{name}: never seen")
            continue
        middle = ", ".join(f"{x:.3f}" for x in np.median(p[~unseen], axis=0))
        lines.append(f"{name}: around ({middle}) m{_gaps(data.time, unseen)}")
    count = _counted(len(data.names), "marker")
    return {f"{count}, positions in m, {_span(data.time)}": lines}


def _gaps(time: np.ndarray, unseen: np.ndarray) -> str:
    found = runs(unseen)
    if not found:
        return ""
    told = [
        f"{time[a]:g}" + (f" to {time[b - 1]:g}" if b - a > 1 else "")
        for a, b in found[:_TOLD]
    ]
    more = ", ..." if len(found) > _TOLD else ""
    frames = _counted(unseen.sum(), "frame")
    return f"; not seen in {frames}: {', '.join(told)}{more} s"


def _plates(time: np.ndarray, plates: Mapping[int, PlateRecording]) -> Contents:
    lines = []
    for number in plates:
        line = f"plate {number}: "
        try:
            plate = plates[number]
        except InputError as error:
            lines.append(f"{line}cannot be read ({error})")
            continue
        size = np.linalg.norm(plate.force, axis=1)
        loaded = size > COP_THRESHOLD_N
        if not loaded.any():
            lines.append(
                f"{line}never above {COP_THRESHOLD_N:g} N (at most "
                f"{size.max(initial=0.0):.3g} N)"
            )
            continue
        first, last = time[loaded][[0, -1]]
        axis = int(np.argmax(np.abs(plate.force[loaded].mean(axis=0))))
        mean = plate.force[loaded, axis].mean()
        lines.append(
            f"{line}loaded {100 * loaded.mean():.0f} % of the time, "
            f"{first:g} to {last:g} s; up to {size.max():.0f} N, mostly along "
            f"{'-' if mean < 0 else ''}{'xyz'[axis]} ({abs(mean):.0f} N)"
        )
    return {f"{_counted(len(plates), 'force plate')}, {_span(time)}": lines}


def _channels(table: Table, said: str) -> Contents:
    lines = []
    for name, x in zip(table.names, table.values.T, strict=True):
        seen = x[np.isfinite(x)]
        if not len(seen):
            lines.append(f"{name}: no value")
            continue
        line = f"{name}: {seen.min():.4g} to {seen.max():.4g}"
        if seen.min() == seen.max():
            line = f"{name}: {seen[0]:.4g} throughout"
        lines.append(line + _gaps(table.time, ~np.isfinite(x)))
    count = _counted(len(table.names), "channel")
    return {f"{count}, {said}, {_span(table.time)}": lines}


def _pressure(data: PressureRecording) -> Contents:
    lines = []
    for name, cells in data.groups.items():
        p = data.pressure[:, cells]
        lines.append(
            f"{name}: {_counted(len(cells), 'cell')}, up to "
            f"{1e-3 * p.max():.3g} kPa, "
            f"{int((p > 0.0).any(axis=0).sum())} of them pressed"
        )
    return {f"pressure in kPa, {_span(data.time)}": lines}
