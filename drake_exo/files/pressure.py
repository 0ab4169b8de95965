"""Read pressure files: Novel's .asc (pedar, pliance) and CSV matrices."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import (
    UNITS,
    check_gaps,
    check_increasing,
    comma_separated,
    number_rows,
    read_text,
    shown,
)

_LARGEST_PA = 5e6  # wearable mats measure up to some 1.2 MPa
_RATE_ERROR = 0.01  # relative error of the header's rate, beside half a frame
_PASCALS = {"pa": 1.0, "kpa": 1e3, "n/cm2": 1e4, "n/cm^2": 1e4}


@dataclass(frozen=True)
class PressureRecording:
    """Pressure of every cell over time.

    Attributes:
        time: (N,) increasing [s].
        pressure: (N, C) [Pa].
        groups: name of a mat or insole -> its columns in `pressure`.
        source: file name.
    """

    time: np.ndarray
    pressure: np.ndarray
    groups: dict[str, np.ndarray]
    source: str

    def matrix(self, group: str, rows: int, columns: int) -> np.ndarray:
        """Pressure of one mat as (N, rows, columns) [Pa].

        Raises:
            InputError: the mat has another number of cells.
        """
        cells = self.pressure[:, self.groups[group]]
        if cells.shape[1] != rows * columns:
            raise InputError(
                f"{self.source}: {group!r} has {cells.shape[1]} cells, not "
                f"{rows} x {columns}; correct the size of the mat in the "
                "study, or export the right one"
            )
        return cells.reshape(len(cells), rows, columns)


def read_novel_asc(path: str | Path) -> PressureRecording:
    """Read Novel's text export (.asc) of one recording.

    Cells are grouped by the mask definition ("left insole: 1,2,..."); without
    one, all belong to the group "mat".

    Raises:
        InputError: another format, unknown unit, truncated or damaged rows,
            gaps, or time that does not increase.
    """
    lines = read_text(path).splitlines()
    start = next(
        (i for i, s in enumerate(lines) if s.lower().startswith("time[secs]")),
        None,
    )
    if start is None:
        raise InputError(
            f"{path}: has no line of column names starting with time[secs]; "
            "export ASCII from Novel's software"
        )
    head = "\n".join(lines[:start])
    # Only lines on pressure: names of files and sensors may look like units.
    values = re.findall(r"^\s*pressure.*", head, re.IGNORECASE | re.MULTILINE)
    scale = _unit(path, "\n".join(values))
    rate = _number(path, head, r"scanning rate \[hz\]", "rate")
    total = _number(path, head, r"total time \[secs\]", "time")
    count = len(lines[start].split())
    values = _table(path, lines, start + 1, count, None)
    check_increasing(str(path), values[:, 0])
    steps, span = len(values) - 1, float(np.ptp(values[:, 0]))
    if abs(span * rate - steps) > 0.5 + _RATE_ERROR * steps:
        raise InputError(
            f"{path}: announces {rate:g} Hz, but its time column runs at "
            f"{steps / span:.4g} Hz; correct the wrong one, or export it again"
        )
    if abs(len(values) - total * rate) > 1.5:
        raise InputError(
            f"{path}: announces {total:g} s at {rate:g} Hz, but holds "
            f"{len(values)} frames; the file is truncated"
        )
    groups = _groups(path, head, lines[start].split()[1:])
    return _recording(path, values, scale, groups)


def read_pressure_csv(
    path: str | Path, mats: dict[str, tuple[int, int]]
) -> PressureRecording:
    """Read a CSV table of time and each mat's cells, row by row.

    The first line names the columns. Its first cell states the units of time
    (s or ms) and pressure: "time [s]; kPa".

    Args:
        path: the file.
        mats: name -> (rows, columns), in the order of the columns.

    Raises:
        InputError: as `read_novel_asc`; or the numbers of cells in file and
            mats differ.
    """
    lines = read_text(path).splitlines()
    used = [i for i, line in enumerate(lines) if line.strip()]
    if len(used) < 3:
        raise InputError(f"{path}: holds fewer than two frames of pressure")
    head = comma_separated(path, lines[used[0]])
    first = head[0]
    scale = _unit(path, first)
    time = re.match(r"\s*time\s*\[\s*(m?s)\s*\]", first, re.IGNORECASE)
    if not time:
        raise InputError(
            f"{path}:{used[0] + 1}: the first column must begin with "
            f"'time [s]' or 'time [ms]', but is {shown(first)!r}"
        )
    groups = split(path, len(head) - 1, mats)
    values = _table(path, lines, used[1], len(head), ",")
    values[:, 0] *= UNITS[time[1].lower()]
    check_increasing(str(path), values[:, 0])
    return _recording(path, values, scale, groups)


_PLACE = ["row", "column", "x", "y", "z"]


def read_places(path: str | Path) -> np.ndarray:
    """Read a CSV table of the positions of a mat's cells.

    Returns:
        Row, column (from 1), x, y and z of each cell (n, 5), unit of the file.

    Raises:
        InputError: unreadable, columns in another order, damaged rows, or a
            position that is missing or beyond 1e6.
    """
    head, *rows = read_text(path).splitlines() or [""]
    named = [n.strip().lower() for n in comma_separated(path, head)]
    if named != _PLACE and sorted(named) == sorted(_PLACE):
        raise InputError(
            f"{path}:1: columns are {', '.join(named)}; write them in the "
            f"order {', '.join(_PLACE)}"
        )
    cells = [(i, x.split(",")) for i, x in enumerate(rows, 2) if x.strip()]
    table = number_rows(path, cells, len(_PLACE))
    if not (np.abs(table) < 1e6).all():
        raise InputError(
            f"{path}: places of cells are missing or out of all bounds; "
            "correct them or export it again"
        )
    return table


def split(
    path, cells: int, mats: dict[str, tuple[int, int]]
) -> dict[str, np.ndarray]:
    """Mat -> its columns (rows * columns,), for mats one after the other.

    Args:
        path: for messages.
        cells: number of cells in the file.
        mats: name -> (rows, columns), in the order of the file.

    Raises:
        InputError: the file has another number of cells than the mats.
    """
    wanted = sum(r * c for r, c in mats.values())
    if cells != wanted:
        sizes = ", ".join(f"{n} {r} x {c}" for n, (r, c) in mats.items())
        raise InputError(
            f"{path}: has {cells} cells, but the mats ({sizes}) have "
            f"{wanted}; correct the sizes in the study or the export"
        )
    groups, at = {}, 0
    for name, (r, c) in mats.items():
        groups[name] = np.arange(at, at + r * c)
        at += r * c
    return groups


def _recording(path, values, scale, groups) -> PressureRecording:
    pressure = scale * values[:, 1:]
    check_gaps(str(path), "a cell", values[:, 0], pressure)
    if pressure.min() < 0.0:
        raise InputError(
            f"{path}: holds pressures below zero; export it without offset"
        )
    if pressure.max() > _LARGEST_PA:
        frame = int(np.argmax(pressure.max(axis=1)))
        raise InputError(
            f"{path}: a cell reaches {pressure[frame].max() / 1e3:.4g} kPa at "
            f"{values[frame, 0]:g} s, more than mats measure; correct the unit "
            "of pressure in the header, or that cell"
        )
    return PressureRecording(values[:, 0], pressure, groups, str(path))


def _unit(path, text: str) -> float:
    words = re.findall(r"[a-z]+(?:/cm\^?2)?", text.lower())
    found = {_PASCALS[unit] for unit in words if unit in _PASCALS}
    if len(found) == 1:
        return found.pop()
    raise InputError(
        f"{path}: the header names no unit of pressure, or several; "
        "write one of Pa, kPa, N/cm2, as in 'pressure values in kPa'"
    )


def _number(path, text: str, key: str, what: str) -> float:
    pattern = rf"{key}:\s*([\d.]+(?:,\d+)?)"
    match = re.search(pattern, text, re.IGNORECASE)
    if match and "," in match[1]:
        raise InputError(
            f"{path}: the {what} in the header is {match[1]!r}; export it with "
            "decimal points, not commas"
        )
    if not match or not float(match[1]) > 0.0:
        raise InputError(
            f"{path}: the header names no {what} (scanning rate [Hz], total "
            "time [secs]); export it again"
        )
    return float(match[1])


def _table(path, lines, start: int, width: int, separator) -> np.ndarray:
    rows = (
        (i + 1, lines[i].split(separator))
        for i in range(start, len(lines))
        if lines[i].strip()
    )
    return number_rows(path, rows, width)


def _groups(path, head: str, cells: list[str]) -> dict[str, np.ndarray]:
    """Mat -> its columns, by the header's mask definition."""
    groups, at, told = {}, 0, []
    masks = re.findall(r"^(.+?):\s*((?:\d+,\s*)*\d+),?\s*$", head, re.MULTILINE)
    for name, numbers in masks:
        own = [n.strip() for n in numbers.split(",")]
        if len(own) > 1:
            groups[name.strip()] = np.arange(at, at + len(own))
            at += len(own)
            told += own
    if not groups:
        return {"mat": np.arange(len(cells))}
    if at != len(cells):
        raise InputError(
            f"{path}: the mask definition names {at} cells, but the table "
            f"has {len(cells)}; export it again"
        )
    if told != cells and sorted(told) == sorted(cells):
        raise InputError(
            f"{path}: the table's columns are in another order than the "
            "cells of the mask definition; export it again"
        )
    return groups
