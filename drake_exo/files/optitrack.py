"""Read OptiTrack Motive's CSV exports: markers, and one force plate."""

import csv
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import Progress
from drake_exo.files.tables import (
    LENGTH_WORDS,
    MarkerData,
    PlateRecording,
    check_count,
    check_increasing,
    frame_rate,
    number_rows,
    plate_axes,
    read_text,
    without_zeros,
)

_TOTAL = "Total Exported Frames"
_MULTIPLE = "Mocap Rate Multiple"
# In the order of C3D: (+x, +y), (-x, +y), (-x, -y), (+x, -y) of the plate.
_CORNERS = ("PosX_PosY", "NegX_PosY", "NegX_NegY", "PosX_NegY")
_CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def read_markers_csv(path: str | Path) -> MarkerData:
    """Read a marker export of Motive (format versions 1.2 to 1.25).

    Raises:
        InputError: another format, unknown unit, truncated or damaged rows,
            or time that does not increase.
    """
    numbered = _rows(path)
    rows = [row for _, row in numbered]
    head = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    if "Format Version" not in head or "Length Units" not in head:
        raise InputError(
            f"{path}: is not a marker export of Motive; export 'CSV' with "
            "its header"
        )
    scale = LENGTH_WORDS.get(head["Length Units"].strip().lower())
    if scale is None:
        raise InputError(
            f"{path}: Length Units is {head['Length Units']!r}; export in "
            "meters, centimeters or millimeters"
        )
    start = _find(path, rows, "Frame")
    kinds, names = _label_rows(path, rows[: start + 1])
    columns: dict[str, list[tuple[str, int]]] = {}
    for i, axis in enumerate(rows[start]):
        if kinds[i] == "Marker" and axis.strip() in ("X", "Y", "Z"):
            columns.setdefault(names[i].strip(), []).append((axis.strip(), i))
    ordered = [sorted(found) for found in columns.values()]
    if not columns or any(
        "".join(axis for axis, _ in found) != "XYZ" for found in ordered
    ):
        raise InputError(
            f"{path}: has no markers with X, Y and Z; export markers' "
            "positions, each with a name of its own"
        )
    # Other columns may hold text: Motive's TimeCode.
    used = {1} | {i for found in ordered for _, i in found}
    body = (
        (line, [cell if i in used else "" for i, cell in enumerate(cells)])
        for line, cells in numbered[start + 1 :]
    )
    values = number_rows(path, body, len(rows[start]))
    check_increasing(str(path), values[:, 1])
    positions = np.stack(
        [values[:, [i for _, i in found]] for found in ordered], axis=1
    )
    check_count(path, head.get(_TOTAL), len(values), _TOTAL, "frames")
    return MarkerData(
        time=values[:, 1],
        names=tuple(columns),
        positions=scale * without_zeros(positions),
        rate_hz=frame_rate(
            path, head.get("Export Frame Rate"), "Export Frame Rate"
        ),
        source=str(path),
    )


def read_plate_csv(
    path: str | Path,
) -> tuple[np.ndarray, dict[int, PlateRecording]]:
    """Read Motive's export of a force plate, as the wrench on the body.

    The export holds the wrench of the body on the plate, in the plate's frame
    (z down), in N and N m about the middle of its surface. It is reversed and
    turned into the axes in which the corners are given. Samples before the
    device began to stream, which are all zero, are left out.

    Returns:
        Times (N,) [s], and {1: the plate}.

    Raises:
        InputError: another format, no corners, truncated or damaged rows,
            or time that does not increase.
    """
    numbered = _rows(path)
    rows = [row for _, row in numbered]
    start = _find(path, rows, "MocapFrame")
    head = {r[0].strip(): r[1] for r in rows[:start] if len(r) > 1}
    if (space := head.get("Coordinate Space", "Local").strip()) != "Local":
        raise InputError(
            f"{path}: the plate's Coordinate Space is {space!r}; export it in "
            "'Local', the plate's own"
        )
    names = [n.strip() for n in rows[start]]
    for name in ("MocapTime", *_CHANNELS):
        if name not in names:
            raise InputError(
                f"{path}: has no column {name!r}; export the plate's force "
                "and moment"
            )
    values = number_rows(path, numbered[start + 1 :], len(names))
    time, multiple = _sample_times(path, head, names, values)
    check_increasing(str(path), time)
    told = head.get(_TOTAL)
    if told != str(len(values)):  # of samples, else of frames
        count = int(len(values) // multiple)
        check_count(path, told, count, _TOTAL, "frames")
    signals = values[:, [names.index(c) for c in _CHANNELS]]
    if not np.isfinite(signals).all():
        raise InputError(f"{path}: forces have gaps; export it again")
    streaming = np.flatnonzero(signals.any(axis=1))
    first = int(streaming[0]) if len(streaming) else 0
    corners = _corners(path, head)
    sides = corners[0] - corners[1], corners[0] - corners[3]
    if not np.linalg.norm(np.cross(*sides)) > 1e-9:
        raise InputError(
            f"{path}: the plate's corners span no area; export the device's "
            "header"
        )
    R = plate_axes(corners)
    reaction = -signals[first:]
    plate = PlateRecording(
        number=1,
        force=reaction[:, :3] @ R.T,
        point=np.tile(corners.mean(axis=0), (len(reaction), 1)),
        torque=reaction[:, 3:] @ R.T,
    )
    return time[first:], {1: plate}


def _sample_times(
    path, head: dict, names: list[str], values: np.ndarray
) -> tuple[np.ndarray, float]:
    """Times (N,) of a plate's samples [s], and how many a mocap frame has.

    If several, all of them may state the frame's time.
    """
    time = values[:, names.index("MocapTime")]
    multiple = frame_rate(path, head.get(_MULTIPLE, "1"), _MULTIPLE)
    is_told = multiple == 1.0 or "DeviceFrame" not in names
    if is_told or (np.diff(time) > 0.0).all():
        return time, multiple
    rate_hz = frame_rate(path, head.get("Mocap Rate"), "Mocap Rate")
    sample = values[:, names.index("DeviceFrame")]
    even = time[0] + (sample - sample[0]) / (rate_hz * multiple)
    if not (np.abs(even - time) < 1.0 / rate_hz).all():
        raise InputError(
            f"{path}: DeviceFrame and MocapTime do not agree at {multiple:g} "
            f"samples in each of {rate_hz:g} frames a second; export it again"
        )
    return even, multiple


def _rows(path) -> list[tuple[int, list[str]]]:
    """Line number and cells of each line that is not blank."""
    reader = csv.reader(read_text(path).splitlines())
    progress, found = Progress(f"reading {Path(path).name}"), []
    try:
        for row in reader:
            if any(map(str.strip, row)):
                found.append((reader.line_num, row))
            progress.update(f"{reader.line_num} lines")
    except csv.Error as error:
        raise InputError(
            f"{path}:{reader.line_num}: holds no cells between commas "
            f"({error}); is a quote open? Export it again"
        ) from error
    if not found:
        raise InputError(f"{path}: is empty; export it again")
    return found


def _find(path, rows, first: str) -> int:
    for i, row in enumerate(rows):
        if row[0].strip() == first:
            return i
    raise InputError(
        f"{path}: has no line of column names starting with {first!r}; "
        "export 'CSV' from Motive"
    )


def _label_rows(path, rows) -> tuple[list[str], list[str]]:
    """The rows of kinds (Marker, ...) and names above the columns, the last."""
    labels = [row for row in rows[1:] if not row[0].strip()][:2]
    if len(labels) < 2 or min(map(len, labels)) < len(rows[-1]):
        raise InputError(
            f"{path}: has no rows of marker names over all columns; export "
            "with the header"
        )
    return labels[0], labels[1]


def _corners(path, head) -> np.ndarray:
    """Corners (4, 3) of the plate [m], in the order of `_CORNERS`."""
    try:
        corners = np.array(
            [[float(head[f"{c}_{a}"]) for a in "XYZ"] for c in _CORNERS]
        )
        if not (np.abs(corners) < 1e6).all():
            raise ValueError("one is out of all bounds")
        return corners
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path}: has no corners of the plate ({error}); export the "
            "device's header"
        ) from error
