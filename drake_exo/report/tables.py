"""Tables as text: what a terminal shows and what a page can quote."""

from collections.abc import Sequence

import numpy as np


def format_table(
    header: Sequence[str], rows: Sequence[Sequence], digits: int = 2
) -> str:
    """Columns aligned; the first is text, numbers have fixed decimals."""
    cells = [[_cell(value, digits) for value in row] for row in rows]
    widths = [
        max(len(row[i]) for row in [list(header), *cells])
        for i in range(len(header))
    ]

    def line(row):
        first = row[0].ljust(widths[0])
        rest = (c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))
        return "  ".join([first, *rest]).rstrip()

    rule = "  ".join("-" * w for w in widths)
    return "\n".join([line(list(header)), rule, *map(line, cells)])


def _cell(value, digits: int) -> str:
    if isinstance(value, str):
        return value
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.{digits}f}"


def rmsd_table(rmsd: list[dict], spread: dict | None = None) -> str:
    """RMSD of every signal: one column a trial, mean, SD, and spread.

    Args:
        rmsd: one dictionary for each trial, see `phases.scores.rmsd`.
        spread: one standard deviation over the measured trials.
    """
    header = ["RMSD", *(r["trial"] for r in rmsd), "mean", "SD"]
    if spread is not None:
        header.append("measured SD")
    rows = []
    for label, path in _signals(rmsd[0]):
        values = [_get(r, path) for r in rmsd]
        sd = float(np.std(values, ddof=1)) if len(values) > 1 else None
        row = [label, *values, float(np.mean(values)), sd]
        if spread is not None:
            row.append(_get(spread, path))
        rows.append(row)
    return format_table(header, rows)


_UNITS = {
    "angles_deg": "angle {} [deg]",
    "velocities_deg_s": "velocity {} [deg/s]",
    "grf_n": "ground reaction {} [N]",
}


def _signals(example):
    for key, label in _UNITS.items():
        for name in example[key]:
            yield label.format(name), (key, name)
    yield "centre of pressure [mm]", ("cop_mm",)


def _get(tree, path):
    for key in path:
        tree = tree.get(key) if isinstance(tree, dict) else None
        if tree is None:
            return None
    return float(tree)
