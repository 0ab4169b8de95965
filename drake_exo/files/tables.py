"""Tables, markers and force plates over time, and checks common to readers.

Missing values are NaN. A column or marker with gaps is refused only when it is
asked for, with the time of the gap.

Mistakes in text files of numbers are reported with their line. A CSV table of
signals has one line of names with units, then numbers:

time [s],exo_ankle [deg],exo_knee [deg],exo_hip [deg]
"""

import functools
import hashlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from drake_exo.errors import InputError, nearest, printable
from drake_exo.files.output import Progress, read_bytes

Reader = TypeVar("Reader", bound=Callable)
# Larger than any measurement in any unit, but squares do not overflow.
_LARGEST = 1e30
_BLOCK = 200  # rows made numbers at a time
_SHOWN = 40  # characters of a cell in a message
# Below this vertical force the centre of pressure is undefined [N].
COP_THRESHOLD_N = 20.0


def kind_of(path: str | Path, known: Iterable[str], what: str) -> str:
    """The suffix, in lower case, that tells the format of a file.

    Raises:
        InputError: it is none of those known; `what` says what is read.
    """
    kind = Path(path).suffix.lower()
    if kind not in known:
        raise InputError(
            f"{path}: is not {what} that can be read; give one of "
            f"{', '.join(known)}"
        )
    return kind


def kept(count: int) -> Callable[[Reader], Reader]:
    """Decorator: cache a reader's results while the files do not change.

    A study reads a file once for each foot, mat or trial. A hash of its bytes
    shows whether it has changed. Results are shared: do not write to their
    arrays.

    Args:
        count: number of results kept.
    """

    def keeping(read: Reader) -> Reader:
        @functools.lru_cache(count)
        def known(path: Path, digest: bytes, *args):
            return read(path, *args)

        @functools.wraps(read)
        def reader(path, *args):
            data = read_bytes(path)
            return known(Path(path), hashlib.sha256(data).digest(), *args)

        return reader

    return keeping


def read_text(path: str | Path, remedy: str = "check the path") -> str:
    """Read a text file; bytes that are not UTF-8 become replacement marks.

    Raises:
        InputError: it cannot be read, or is binary.
    """
    data = read_bytes(path, remedy)
    if b"\0" in data:
        raise InputError(
            f"{path}: is a binary file, not text, or in UTF-16; save it as "
            "UTF-8"
        )
    text = data.decode("utf-8-sig", errors="replace")
    # Texts of damaged files end up in messages, so keep them printable.
    return printable(text, keep="\t\r\n")


def shown(cell: str) -> str:
    """A cell for use in a message: at most 40 characters."""
    cell = cell.strip()
    return cell if len(cell) <= _SHOWN else cell[:_SHOWN] + "..."


def number_rows(
    path: str | Path, rows: Iterable[tuple[int, list[str]]], width: int
) -> np.ndarray:
    """Rows of text cells as numbers (N, width); empty cells are NaN.

    Prints progress if that takes long.

    Args:
        path: for messages.
        rows: line number and cells of each of the N rows.
        width: number of cells that each row must have.

    Raises:
        InputError: there are no rows; or, with the line, another number of
            cells, a cell that is not a number, or one larger than any
            measurement.
    """
    progress = Progress(f"reading {Path(path).name}")
    rows, blocks, count = iter(rows), [], 0
    while block := list(islice(rows, _BLOCK)):
        blocks.append(_numbers(path, block, width))
        count += len(block)
        progress.update(f"{count} rows")
    if not blocks:
        raise InputError(f"{path}: holds no data rows; export it again")
    return np.concatenate(blocks)


def _numbers(
    path: str | Path, rows: list[tuple[int, list[str]]], width: int
) -> np.ndarray:
    for line, cells in rows:
        if len(cells) != width:
            raise InputError(
                f"{path}:{line}: has {len(cells)} values where {width} are "
                "named; the file is truncated or damaged, or its numbers have "
                "decimal commas"
            )
    texts = [[cell.strip() or "nan" for cell in cells] for _, cells in rows]
    try:
        if not all(map(_is_plain, map("".join, texts))):
            raise ValueError
        values = np.array(texts, dtype=float)
    except ValueError:
        raise _not_a_number(path, rows, texts) from None
    large = np.abs(values) > _LARGEST
    if large.any():
        i, j = np.argwhere(large)[0]
        raise InputError(
            f"{path}:{rows[i][0]}: {shown(texts[i][j])!r} is larger than "
            "any measurement; the file is damaged"
        )
    return values


def frame_rate(path: str | Path, text: str | None, key: str) -> float:
    """Frame rate [Hz] from the text of a header's `key`.

    Raises:
        InputError: it is no number, or not between 0 and 1e6.
    """
    try:
        rate = float(text)
    except (TypeError, ValueError):
        rate = 0.0
    if not 0.0 < rate < 1e6:
        raise InputError(
            f"{path}: {key} in the header is {text and shown(text)!r}; write "
            "frames per second"
        )
    return rate


def _is_plain(text: str) -> bool:
    """Whether a text is free of 1_000 and of digits of other scripts."""
    return text.isascii() and "_" not in text


def _not_a_number(path, rows, texts) -> InputError:
    for (line, _), cells in zip(rows, texts, strict=True):
        for cell in cells:
            try:
                float(cell if _is_plain(cell) else "text")
            except ValueError:
                remedy = "correct it or export it again"
                if re.fullmatch(r"[+-]?\d*,\d+", cell):
                    remedy = "export it with decimal points, not commas"
                return InputError(
                    f"{path}:{line}: holds text among numbers "
                    f"({shown(cell)!r}); {remedy}"
                )
    return InputError(f"{path}: holds text among numbers; export it again")


LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}  # to m
# As Motive and SIMM write them.
LENGTH_WORDS = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3}
# Largest error of a rounded time stamp, in steps; beyond, a frame is missing.
_JITTER = 0.45


@dataclass(frozen=True)
class Table:
    """Columns of numbers over time.

    Attributes:
        time: (N,) [s], increasing.
        names: column names without time, length C.
        values: (N, C), in units of the file (of a CSV: SI); NaN where missing.
        in_degrees: what the header says of angles; None if nothing.
        source: file name, for messages and provenance.
        units: of each column, if the file names them; of a CSV those in the
            file, before conversion to SI.
    """

    time: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray
    in_degrees: bool | None = None
    source: str = ""
    units: tuple[str, ...] = ()

    def column(self, name: str) -> np.ndarray:
        """One column (N,).

        Raises:
            InputError: no such column, or it has gaps.
        """
        if name not in self.names:
            raise missing_column(self.source, name, self.names)
        values = self.values[:, self.names.index(name)]
        check_gaps(self.source, f"column {name!r}", self.time, values)
        return values

    def columns(self, names) -> np.ndarray:
        """Several columns (N, len(names)); raises as `column`."""
        return np.stack([self.column(name) for name in names], axis=1)

    def in_radians(self, angles: Sequence[str]) -> "Table":
        """The same table with the columns `angles` in radians.

        The header's statement is compared with the values. No joint turns by
        more than a full turn, so values beyond 2 pi are degrees. Values within
        pi that vary by more than 0.35 (20 degrees, if in radians) are radians:
        as degrees, all joints would stay within 3.2 degrees of zero and yet
        move.

        Raises:
            InputError: header and values contradict each other, or the header
                says nothing.
        """
        if self.in_degrees is None:
            raise InputError(
                f"{self.source}: the header does not say whether angles are "
                "in degrees; add 'inDegrees=yes' or 'inDegrees=no'"
            )
        columns = [self.names.index(name) for name in angles]
        values = self.values.copy()
        # Columns without any value are refused when they are asked for.
        found = values[:, columns]
        found = found[:, np.isfinite(found).any(axis=0)]
        largest = np.nanmax(np.abs(found), initial=0.0)
        motion = (np.nanmax(found, 0) - np.nanmin(found, 0)).max(initial=0.0)
        if not self.in_degrees and largest > 2.0 * np.pi:
            raise InputError(
                f"{self.source}: inDegrees=no, but angles reach "
                f"{largest:.4g}, which can only be degrees; correct the header "
                "to inDegrees=yes"
            )
        if self.in_degrees and largest <= np.pi and motion > np.deg2rad(20.0):
            raise InputError(
                f"{self.source}: inDegrees=yes, but no angle exceeds "
                f"{largest:.3g}, so these look like radians; correct the "
                "header to inDegrees=no, or write so small a movement in "
                "radians"
            )
        if self.in_degrees:
            values[:, columns] = np.deg2rad(values[:, columns])
        return replace(self, values=values, in_degrees=False)


@dataclass(frozen=True)
class MarkerData:
    """Marker positions over time.

    Attributes:
        time: (N,) [s], increasing.
        names: marker names, length M.
        positions: (N, M, 3) [m] in the file's axes; NaN where not seen.
        rate_hz: frames per second as the header says.
        source: file name.
    """

    time: np.ndarray
    names: tuple[str, ...]
    positions: np.ndarray
    rate_hz: float
    source: str = ""

    def of(self, names) -> np.ndarray:
        """Positions (N, len(names), 3) of some markers, without gaps.

        Raises:
            InputError: a marker is missing, or has gaps.
        """
        found = []
        for name in names:
            if name not in self.names:
                raise missing_column(self.source, name, self.names, "marker")
            p = self.positions[:, self.names.index(name)]
            check_gaps(self.source, f"marker {name!r}", self.time, p)
            found.append(p)
        return np.stack(found, axis=1)


def without_zeros(positions: np.ndarray) -> np.ndarray:
    """Markers (N, M, 3), NaN where exporters wrote unseen ones as (0, 0, 0)."""
    unseen = (positions == 0.0).all(axis=2, keepdims=True)
    return np.where(unseen, np.nan, positions)


@dataclass(frozen=True)
class PlateRecording:
    """One force plate as recorded, in the file's axes.

    Attributes:
        number: from 1, by the columns' names, else in their order.
        force: (N, 3) on the body, or see `Laboratory.forces_act_on` [N].
        point: (N, 3) where the force acts [m].
        torque: (N, 3) free moment about that point [N m]; zeros where the
            file has none.
    """

    number: int
    force: np.ndarray
    point: np.ndarray
    torque: np.ndarray

    def moment_about_origin(self) -> np.ndarray:
        """Moment (N, 3) about the file's origin [N m]."""
        return np.cross(self.point, self.force) + self.torque


def plate_axes(corners: np.ndarray) -> np.ndarray:
    """Axes of a force plate's own frame as columns (3, 3).

    Args:
        corners: (4, 3) at (+x, +y), (-x, +y), (-x, -y), (+x, -y) of the plate.
    """
    x, y = corners[0] - corners[1], corners[0] - corners[3]
    z = np.cross(x, y)
    axes = (x, np.cross(z, x), z)
    return np.stack([e / np.linalg.norm(e) for e in axes], axis=1)


def missing_column(source, name, names, what="column") -> InputError:
    """Error for a missing column; suggests the nearest name."""
    hint = nearest(name, names)
    if not hint:
        hint = f"; there are {', '.join(names[:8])}"
        hint += ", ..." if len(names) > 8 else ""
    return InputError(f"{source}: has no {what} {name!r}{hint}")


def check_gaps(source, what, time, values) -> None:
    """Refuse values (N,) or (N, k) that are not finite.

    Raises:
        InputError: naming the first gap and the number of missing frames.
    """
    bad = ~np.isfinite(values.reshape(len(time), -1)).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{source}: {what} has no value in {bad.sum()} of {len(time)} "
            f"frames, first at {time[first]:g} s; fill the gaps or use "
            "another one"
        )


def between(time: np.ndarray, start_s: float, end_s: float) -> np.ndarray:
    """Samples (N,) bool from start to end, both included within 1 ns."""
    return (time >= start_s - 1e-9) & (time <= end_s + 1e-9)


def runs(mask: np.ndarray) -> list[list[int]]:
    """Start and end (exclusive) index of each run of True in a (N,) bool."""
    edges = np.flatnonzero(np.diff(np.r_[0, mask, 0]))
    return edges.reshape(-1, 2).tolist()


def uniform_time(
    source: str, time: np.ndarray, rate_hz: float | None = None
) -> np.ndarray:
    """Evenly spaced times (N,) [s] for possibly rounded time stamps.

    Args:
        source: file name, for messages.
        time: (N,) time stamps, increasing [s].
        rate_hz: frames per second by the header, if it states them.

    Raises:
        InputError: a frame is missing or repeated, or header and time
            stamps disagree.
    """
    check_increasing(source, time)
    n = len(time)
    if n < 2:
        raise InputError(f"{source}: holds {n} frames; at least two are needed")
    usual = float(np.median(np.diff(time)))
    if rate_hz and abs(usual * rate_hz - 1.0) > 0.2:
        raise _wrong_rate(source, rate_hz, usual)
    step = (time[-1] - time[0]) / (n - 1)
    grid = time[0] + step * np.arange(n)
    # Stamps rounded to milliseconds must not stretch the grid; the unit of
    # rounding is four times their mean error.
    rounding = 4.0 * np.abs(time - grid).mean() + 1e-9
    if rate_hz and abs(step - 1.0 / rate_hz) * (n - 1) < rounding:
        step = 1.0 / rate_hz
        grid = time[0] + step * np.arange(n)
    off = np.abs(time - grid)
    if off.max() > _JITTER * step:
        # A missing frame shifts all later ones; find the odd step instead.
        worst = int(np.argmax(np.abs(np.diff(time) - step))) + 1
        raise InputError(
            f"{source}: time is not evenly spaced around {time[worst]:g} s "
            f"(frame {worst + 1}); resample the file at a constant rate"
        )
    if rate_hz and n >= 20 and abs(step * rate_hz - 1.0) > 0.02:
        raise _wrong_rate(source, rate_hz, step)
    return grid


def _wrong_rate(source: str, rate_hz: float, step: float) -> InputError:
    return InputError(
        f"{source}: the header says {rate_hz:g} frames a second, the time "
        f"column {1.0 / step:.4g}; correct the one that is wrong"
    )


def check_increasing(source: str, time: np.ndarray) -> None:
    """Refuse times that are missing or do not increase.

    Raises:
        InputError: naming the frame.
    """
    if not np.isfinite(time).all():
        frame = int(np.argmin(np.isfinite(time)))
        raise InputError(
            f"{source}: time of frame {frame + 1} is missing; correct it or "
            "export it again"
        )
    steps = np.diff(time)
    if len(steps) and steps.min() <= 0.0:
        frame = int(np.argmax(steps <= 0.0)) + 1
        raise InputError(
            f"{source}: time does not increase from {time[frame - 1]:g} to "
            f"{time[frame]:g} s (frame {frame + 1}); sort or re-export it"
        )


# Unit of a CSV column -> factor to s, rad, N m, N or m.
UNITS = {
    "s": 1.0,
    "ms": 1e-3,
    "rad": 1.0,
    "deg": np.pi / 180.0,
    "nm": 1.0,
    "n m": 1.0,
    "n": 1.0,
    "m": 1.0,
    "mm": 1e-3,
}
_COLUMN = re.compile(r"\s*(?P<name>[^\[\]]+?)\s*\[(?P<unit>[^\[\]]*)\]\s*")


def read_csv_table(path: str | Path) -> Table:
    """Read a CSV table with units; values are converted to SI, angles to rad.

    Raises:
        InputError: unreadable, a column without a known unit, damaged rows,
            no time, or time that does not increase.
    """
    lines = enumerate(read_text(path).splitlines(), 1)
    (_, head), *rows = [one for one in lines if one[1].strip()] or [(1, "")]
    if len(rows) < 2:
        raise InputError(f"{path}: holds fewer than two samples")
    names, units = _header(path, comma_separated(path, head))
    cells = ((i, line.split(",")) for i, line in rows)
    values = number_rows(path, cells, len(names))
    values = values * [UNITS[unit] for unit in units]
    check_increasing(str(path), values[:, 0])
    time, values = values[:, 0], values[:, 1:]
    named, units = tuple(names[1:]), tuple(units[1:])
    return Table(time, named, values, False, str(path), units)


def comma_separated(path, header: str) -> list[str]:
    """Split a CSV file's first line into cells, which may be quoted.

    Raises:
        InputError: semicolons or tabs separate them.
    """
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header and "," not in header:
            raise InputError(
                f"{path}:1: {name} separate the columns; export it with "
                "commas between columns and decimal points"
            )
    return header.replace('"', "").split(",")


def check_count(path, text: str | None, count: int, key, what) -> None:
    """Refuse a file whose header announces another count than it holds."""
    if text is not None and text.strip().isdecimal() and int(text) != count:
        raise InputError(
            f"{path}: the header says {key}={text}, but there are {count} "
            f"{what}; the file is truncated or its header wrong"
        )


def check_names(path, line: int, names: list[str]) -> None:
    """Refuse repeated column names in a line of a file."""
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{path}:{line}: two columns are named {shown(name)!r}; "
                "rename one"
            )


def _header(path, cells: list[str]) -> tuple[list[str], list[str]]:
    names, units = [], []
    for cell in cells:
        match = _COLUMN.fullmatch(cell)
        unit = match["unit"].strip().lower() if match else None
        if unit not in UNITS:
            raise InputError(
                f"{path}:1: column {shown(cell)!r} names no unit that is "
                f"known; write it as 'name [unit]' with one of "
                f"{', '.join(UNITS)}, or leave the column out"
            )
        names.append(match["name"])
        units.append(unit)
    check_names(path, 1, names)
    if names[0].lower() != "time" or units[0] not in ("s", "ms"):
        raise InputError(
            f"{path}:1: the first column must be 'time [s]' or 'time [ms]'"
        )
    return names, units


def write_csv_table(path: str | Path, table: Table, units: list[str]) -> None:
    """Write a table in the given units (of `UNITS`), time in seconds."""
    factors = np.array([UNITS[u.lower()] for u in units])
    cells = [f"{n} [{u}]" for n, u in zip(table.names, units, strict=True)]
    rows = np.column_stack([table.time, table.values / factors]) + 0.0
    body = [",".join(f"{x:.10g}" for x in row) for row in rows]
    text = "\n".join([",".join(["time [s]", *cells]), *body])
    Path(path).write_text(text + "\n", encoding="utf-8")
