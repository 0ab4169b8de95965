"""Read and write OpenSim's text files: .trc markers, .mot and .sto tables.

Real files end lines with tabs and carriage returns, round their time stamps
and name force plates in several ways. Whatever a file leaves ambiguous is
refused instead of guessed.
"""

import re
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import (
    LENGTH_WORDS,
    LENGTHS,
    MarkerData,
    PlateRecording,
    Table,
    check_count,
    check_gaps,
    check_increasing,
    check_names,
    frame_rate,
    number_rows,
    read_text,
    without_zeros,
)

# ground_force_1_vx, ground_force1_vx, ground_force_vx, 1_ground_force_vx,
# ground_torque_x, ground_moment_1_mx, ground_force_calcn_r_px, ...
_PLATE_COLUMN = re.compile(
    r"(?:(?P<before>\w+?)_)?ground_(?P<what>force|torque|moment)"
    r"(?:(?:_|(?=\d))(?P<after>\w+?))?_(?P<kind>[vpm])?(?P<axis>[xyz])"
)
# FP1_vx, plate1_px, force_1_vx, FP1_moment_x, torque1_x, ...: if a table has
# none of the above, what ends in a number is a plate.
_NUMBERED_COLUMN = re.compile(
    r"(?P<before>[^\W\d]*?)_?(?P<after>\d+)_"
    r"(?:(?P<what>force|torque|moment)_)?(?P<kind>[vpm])?(?P<axis>[xyz])",
    re.ASCII,
)


# What "v", "p" and "m" are, and their units in a CSV table.
_QUANTITIES = {
    "v": ("force", "n"),
    "p": ("point", "m", "mm"),
    "m": ("moment", "nm", "n m"),
}


def read_table(path: str | Path) -> Table:
    """Read a .mot or .sto file.

    Raises:
        InputError: the file is unreadable, truncated, holds text among
            numbers, or its time does not increase.
    """
    lines = read_text(path).splitlines()
    ends = [i for i, s in enumerate(lines) if s.strip() == "endheader"]
    if not ends:
        raise InputError(
            f"{path}: has no line 'endheader'; give an OpenSim .mot or .sto "
            "file"
        )
    header = _header(lines[: ends[0]])
    rest = [i for i in range(ends[0] + 1, len(lines)) if lines[i].strip()]
    if not rest:
        raise InputError(f"{path}: ends after its header; export it again")
    names = lines[rest[0]].split()
    if not names or names[0].lower() != "time":
        raise InputError(
            f"{path}:{rest[0] + 1}: the first column must be 'time'"
        )
    check_names(path, rest[0] + 1, names)
    for key in ("nColumns", "datacolumns"):
        announced = header.get(key.lower())
        check_count(path, announced, len(names), key, "column names")
    rows = ((i + 1, _cells(lines[i], len(names))) for i in rest[1:])
    values = number_rows(path, rows, len(names))
    for key in ("nRows", "datarows"):
        check_count(path, header.get(key.lower()), len(values), key, "rows")
    check_increasing(str(path), values[:, 0])
    return Table(
        time=values[:, 0],
        names=tuple(names[1:]),
        values=values[:, 1:],
        in_degrees=_yes_no(path, header.get("indegrees")),
        source=str(path),
    )


def read_trc(path: str | Path) -> MarkerData:
    """Read a .trc file; positions are converted to metres.

    Raises:
        InputError: the file is unreadable, truncated, or holds text among
            numbers, its unit is unknown, or its time does not increase.
    """
    lines = read_text(path).splitlines(keepends=True)
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: is not a .trc file; check the path")
    keys = [k.lower() for k in lines[1].split()]
    header = dict(zip(keys, lines[2].split(), strict=False))
    scale = _length_unit(path, header.get("units"))
    cells = [cell.strip() for cell in _split(lines[3])]
    names = [cell for cell in cells if cell][2:]
    check_names(path, 4, names)
    check_count(
        path, header.get("nummarkers"), len(names), "NumMarkers", "marker names"
    )
    width = 2 + 3 * len(names)
    rows = (
        (i, _fields(line, width))
        for i, line in enumerate(lines[5:], 6)
        if line.strip()
    )
    values = number_rows(path, rows, width)
    announced = header.get("numframes")
    is_whole = lines[-1].endswith(("\n", "\r"))
    if not (
        _is_cut_out(announced, values[:, 0])
        or _is_miscounted(announced, len(values), is_whole)
    ):
        check_count(path, announced, len(values), "NumFrames", "frames")
    check_increasing(str(path), values[:, 1])
    return MarkerData(
        time=values[:, 1],
        names=tuple(names),
        positions=scale
        * without_zeros(values[:, 2:].reshape(len(values), -1, 3)),
        rate_hz=frame_rate(path, header.get("datarate"), "DataRate"),
        source=str(path),
    )


def read_plates(
    path: str | Path,
) -> tuple[np.ndarray, dict[int, PlateRecording]]:
    """Read the force plates of a .mot or .sto file.

    Returns:
        Times (N,) [s], and number -> plate.

    Raises:
        InputError: as `read_table`; no plate, a component missing, or gaps.
    """
    table = read_table(path)
    return table.time, plates_of(table)


def has_plates(table: Table) -> bool:
    """Whether a table has plates, and all of their forces and points.

    Columns of other instruments may be named likewise, such as imu1_vx.
    """
    found = set(_plate_columns(table).values())
    whole = [kind + axis for kind in "vp" for axis in "xyz"]
    labels = {label for label, _ in found}
    return bool(found) and all(
        (label, part) in found for label in labels for part in whole
    )


def plates_of(table: Table) -> dict[int, PlateRecording]:
    """Number -> force plate, from the columns of a table; see `read_plates`."""
    columns: dict[str, dict[str, str]] = {}
    for name, (label, kind) in _plate_columns(table).items():
        first = columns.setdefault(label, {}).setdefault(kind, name)
        if first != name:
            raise InputError(
                f"{table.source}: columns {first!r} and {name!r} are the "
                "same of one force plate; rename or remove one"
            )
    if not columns:
        raise InputError(
            f"{table.source}: has no force plate; name columns like "
            "ground_force_1_vx, ground_force_1_px, ground_torque_1_x"
        )
    labels = sorted(columns, key=bool)  # the plate without a label is first
    # "ground_force_2_vx" is plate 2, and so is "FP2_ground_force_vx";
    # "1_ground_force_vx" beside "ground_force_vx" is OpenSim's second plate.
    told = [re.fullmatch(r"\D*0*([1-9]\d*)\D*", label) for label in labels]
    numbers = [int(match[1]) for match in told if match]
    if len(set(numbers)) < len(labels):
        numbers = list(range(1, len(labels) + 1))
    return {
        number: _plate(table, number, label, columns[label])
        for number, label in zip(numbers, labels, strict=True)
    }


def _plate_columns(table: Table) -> dict[str, tuple[str, str]]:
    """Column -> label of its plate, and "vx", ..., "pz" or "mz"."""
    found = {}
    for name in table.names:
        if match := _PLATE_COLUMN.fullmatch(name):
            kind = "m" if match["what"] != "force" else match["kind"] or "m"
            label = match["before"] or match["after"] or ""
            found[name] = label, kind + match["axis"]
    if found:
        return found
    for name in table.names:
        match = _NUMBERED_COLUMN.fullmatch(name)
        if not match:
            continue
        told = f"{match['before']}_{match['what']}".lower()
        kind = "m" if re.search("torque|moment", told) else match["kind"]
        if kind:
            found[name] = str(int(match["after"])), kind + match["axis"]
    return found


def _plate(table, number, label, columns) -> PlateRecording:
    example = next(iter(columns.values()))
    given = {}
    for kind in "vpm":
        parts = [columns.get(kind + axis) for axis in "xyz"]
        if kind == "m" and parts == [None] * 3:
            given[kind] = np.zeros((len(table.time), 3))
            continue
        for axis, part in zip("xyz", parts, strict=True):
            if part is None:
                what = _QUANTITIES[kind][0]
                raise InputError(
                    f"{table.source}: force plate {label or number} has no "
                    f"{axis} component of its {what} beside column "
                    f"{example!r}; export all three"
                )
        index = [table.names.index(part) for part in parts]
        _check_units(table, index, *_QUANTITIES[kind][1:])
        given[kind] = table.values[:, index]
    unloaded = (given["v"] == 0.0).all(axis=1)
    point = np.where(
        unloaded[:, None] & ~np.isfinite(given["p"]), 0.0, given["p"]
    )
    for kind, values in (("v", given["v"]), ("p", point), ("m", given["m"])):
        if kind + "x" in columns:
            check_gaps(
                table.source,
                f"column {columns[kind + 'x']!r} (or y, z)",
                table.time,
                values,
            )
    return PlateRecording(number, given["v"], point, given["m"])


def _check_units(table: Table, index: list[int], *known: str) -> None:
    """Refuse columns of a CSV table whose unit is another quantity's."""
    for k in index if table.units else ():
        if table.units[k] not in known:
            raise InputError(
                f"{table.source}:1: column {table.names[k]!r} is in "
                f"{table.units[k]!r}; give it in {' or '.join(known)}"
            )


def write_table(
    path: str | Path,
    table: Table,
    title: str = "",
    mark: str = "",
    *,
    digits: int = 10,
) -> None:
    """Write a .mot or .sto file that OpenSim reads.

    Args:
        path: the file.
        table: columns to write.
        title: its first line; the file's stem if empty.
        mark: `Verdict.mark`, appended to the title in brackets.
        digits: significant digits of each number; 17 lose nothing.
    """
    path = Path(path)
    degrees = "yes" if table.in_degrees else "no"
    head = [
        (title or path.stem) + (f" ({mark})" if mark else ""),
        "version=1",
        f"nRows={len(table.time)}",
        f"nColumns={len(table.names) + 1}",
        f"inDegrees={degrees}",
        "endheader",
        "\t".join(("time", *table.names)),
    ]
    rows = np.column_stack([table.time, table.values]) + 0.0  # no -0
    body = ["\t".join(f"{x:.{digits}g}" for x in row) for row in rows]
    path.write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")


def write_trc(path: str | Path, markers: MarkerData) -> None:
    """Write a .trc file in metres; gaps become empty fields."""
    path = Path(path)
    n, m = markers.positions.shape[:2]
    rate = f"{markers.rate_hz:g}"
    labels = [f"{a}{i + 1}" for i in range(m) for a in "XYZ"]
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate"
        "\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{n}\t{m}\tm\t{rate}\t1\t{n}",
        "Frame#\tTime\t" + "\t".join(f"{s}\t\t" for s in markers.names),
        "\t\t" + "\t".join(labels),
        "",
    ]
    body = []
    for i in range(n):
        p = markers.positions[i].ravel() + 0.0
        cells = ("" if np.isnan(x) else f"{x:.9g}" for x in p)
        body.append("\t".join((f"{i + 1}", f"{markers.time[i]:.10g}", *cells)))
    path.write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")


def _header(lines: list[str]) -> dict[str, str]:
    # SIMM separates name and value by blanks, OpenSim by "=".
    pairs = (re.split(r"\s*=\s*|\s+", s.strip(), maxsplit=1) for s in lines)
    return {p[0].lower(): p[1] for p in pairs if len(p) == 2}


def _yes_no(path, text: str | None) -> bool | None:
    if text is None:
        return None
    if text.lower() not in ("yes", "no"):
        raise InputError(
            f"{path}: inDegrees must be yes or no, but is {text!r}"
        )
    return text.lower() == "yes"


def _length_unit(path, unit: str | None) -> float:
    known = LENGTHS | LENGTH_WORDS
    if unit is None or unit.lower() not in known:
        raise InputError(
            f"{path}: Units in the header is {unit!r}; write m, cm or mm"
        )
    return known[unit.lower()]


def _is_cut_out(announced: str | None, frames: np.ndarray) -> bool:
    """Whether frame numbers (n,) are a part of a recording of `announced`."""
    if announced is None or not announced.isdecimal():
        return False
    return len(frames) > 0 and frames[0] > 1 and frames[-1] < int(announced)


def _is_miscounted(announced: str | None, count: int, is_whole: bool) -> bool:
    """Whether a header is off by one, as of exporters that count from zero.

    Nothing is lost if there is one row more. One row fewer is so little that a
    truncated file, which seldom ends with a whole line, would lose more.
    """
    if announced is None or not announced.isdecimal():
        return False
    return count - int(announced) in ((-1, 1) if is_whole else (1,))


def _cells(line: str, width: int) -> list[str]:
    """Cells of a .mot row between blanks or, if some are empty, tabs."""
    cells = line.split()
    if len(cells) < width <= line.count("\t") + 1:
        told = line.split("\t")
        if not "".join(told[width:]).strip():  # tabs behind the row
            return told[:width]
    return cells


def _split(line: str) -> list[str]:
    """Cells between tabs; of a line without tabs, between blanks."""
    line = line.rstrip()
    return line.split("\t" if "\t" in line else None)


def _fields(line: str, width: int) -> list[str]:
    """Cells of a .trc row; whole markers missing at its end become gaps.

    Not in a row without a line break, which may have been truncated, nor in
    one between blanks, where any marker may be missing.
    """
    cells = _split(line)
    is_whole = "\t" in line and line.endswith(("\n", "\r"))
    if (len(cells) - 2) % 3 == 0 and is_whole:
        cells += [""] * (width - len(cells))
    return cells
