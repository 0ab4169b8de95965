"""CSV tables of signals: one line of names with units, then numbers.

time [s],exo_ankle [deg],exo_knee [deg],exo_hip [deg]
"""

import re
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import Table, check_increasing
from drake_exo.files.text import number_rows, read_text, shown

# Factors to s, rad, N m, N, m.
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
    """Read a CSV table; values in SI units, angles in radians.

    Raises:
        InputError: unreadable, a column without a known unit, damaged rows,
            no time, or time that does not increase.
    """
    lines = [s for s in read_text(path).splitlines() if s.strip()]
    if len(lines) < 3:
        raise InputError(f"{path}: holds fewer than two samples")
    names, factors = _header(path, lines[0].split(","))
    rows = [(i, line.split(",")) for i, line in enumerate(lines[1:], 2)]
    values = number_rows(path, rows, len(names))
    values = values * factors
    check_increasing(str(path), values[:, 0])
    return Table(
        values[:, 0], tuple(names[1:]), values[:, 1:], False, str(path)
    )


def _header(path, cells: list[str]) -> tuple[list[str], np.ndarray]:
    names, factors = [], []
    for cell in cells:
        match = _COLUMN.fullmatch(cell)
        unit = match["unit"].strip().lower() if match else None
        if unit not in UNITS:
            raise InputError(
                f"{path}:1: column {shown(cell)!r} names no unit that is "
                f"known; write it as 'name [unit]' with one of "
                f"{', '.join(UNITS)}"
            )
        if match["name"] in names:
            raise InputError(
                f"{path}:1: two columns are named "
                f"{shown(match['name'])!r}; rename one"
            )
        names.append(match["name"])
        factors.append(UNITS[unit])
    if names[0].lower() != "time":
        raise InputError(f"{path}:1: the first column must be 'time [s]'")
    return names, np.array(factors)


def write_csv_table(path: str | Path, table: Table, units: list[str]) -> None:
    """Write a table in the given units (of `UNITS`), time in seconds."""
    factors = np.array([UNITS[u.lower()] for u in units])
    cells = [f"{n} [{u}]" for n, u in zip(table.names, units, strict=True)]
    rows = np.column_stack([table.time, table.values / factors])
    body = [",".join(f"{x:.10g}" for x in row) for row in rows]
    text = "\n".join([",".join(["time [s]", *cells]), *body])
    Path(path).write_text(text + "\n", encoding="utf-8")
