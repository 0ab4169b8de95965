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
        rmsd: one dictionary for each trial, see `scores.rmsd`.
        spread: one standard deviation over the measured trials.
    """
    header = ["RMSD", *(r["trial"] for r in rmsd), "mean", "SD"]
    if spread is not None:
        header.append("measured SD")
    rows = []
    for label, path in rmsd_signals(rmsd):
        values = [lookup(r, path) for r in rmsd]
        row = [label, *values, *mean_and_sd(values)]
        if spread is not None:
            row.append(lookup(spread, path))
        rows.append(row)
    return format_table(header, rows)


def mean_and_sd(values) -> tuple[float | None, float | None]:
    """Mean and standard deviation of those that are not None."""
    known = [v for v in values if v is not None]
    sd = float(np.std(known, ddof=1)) if len(known) > 1 else None
    return (float(np.mean(known)) if known else None), sd


_ORDER = (
    *("ankle", "knee", "hip", "exo_ankle", "exo_knee", "exo_hip"),
    *("horizontal", "vertical", "pelvis", "thigh", "shank"),
)
_UNITS = {
    "angles_deg": "angle {} [deg]",
    "velocities_deg_s": "velocity {} [deg/s]",
    "grf_n": "ground reaction {} [N]",
    "cop_mm": "centre of pressure {} [mm]",
    "moments_nm": "moment {} [N m]",
    "interaction_n": "normal force {} [N]",
}


def rmsd_signals(rmsd: list[dict]):
    """(label, keys) of every signal that some trial has."""
    for key, label in _UNITS.items():
        names: dict = {}
        for trial in rmsd:
            value = trial.get(key, {})
            if not isinstance(value, dict):
                yield label.replace(" {}", ""), (key,)
                break
            names |= dict.fromkeys(value)
        for name in sorted(names, key=_place):
            yield label.format(name), (key, name)


def _place(name: str) -> int:
    """Where a coordinate, component or segment stands in a table."""
    return _ORDER.index(name) if name in _ORDER else len(_ORDER)


def lookup(tree, path) -> float | None:
    """Follow keys into nested dictionaries; None where no number is."""
    for key in path:
        tree = tree.get(key) if isinstance(tree, dict) else None
    return None if tree is None or isinstance(tree, dict) else float(tree)


def parameters_table(parameters: list[dict]) -> str:
    """The parameters of a summary as text."""
    rows = [
        [
            p["name"],
            f"{p['value']:.4g}",
            _interval(p),
            f"{p['lower']:.3g}",
            f"{p['upper']:.3g}",
            p["unit"],
            _remark(p),
        ]
        for p in parameters
    ]
    header = ["parameter", "value", "95 %", "lower", "upper", "unit", ""]
    return format_table(header, rows)


def _remark(parameter: dict) -> str:
    if not parameter["free"]:
        return "fixed"
    if parameter["at_bound"]:
        return "at bound"
    return "" if parameter.get("identifiable", True) else "weakly determined"


def _interval(parameter: dict) -> str:
    half = parameter.get("half_width_95")
    return "-" if half is None else f"± {half:.2g}"


def clocks_table(clocks: list[dict]) -> str:
    """Clocks as summary.json holds them, a line for each."""
    rows = [
        [
            f"{c['trial']}, {c['system']}",
            f"{1e3 * c['lag_s']:+.0f}",
            f"± {1e3 * c['half_width_95_s']:.0f}",
            "" if c["sure"] else "unsure",
        ]
        for c in clocks
    ]
    return format_table(["clock", "lag [ms]", "95 %", ""], rows)


def audit_table(rows: list[dict]) -> str:
    """Audits as summary.json holds them, a line for each trial."""
    header = [
        "audit",
        "between nodes [N]",
        "[N m]",
        "simulated F_x [N]",
        "F_z [N]",
        "angles [deg]",
        "interaction [N]",
    ]
    return format_table(
        header,
        [
            [
                r["trial"],
                r["force_n"],
                r["moment_nm"],
                *r["simulated_grf_n"],
                r["simulated_angles_deg"],
                r["simulated_interaction_n"],
            ]
            for r in rows
        ],
    )


def front_table(rows: list[dict]) -> str:
    """A Pareto front as `pareto_front` finds it."""
    header = [
        "noise of forces ×",
        "angles [deg]",
        "worst",
        "velocities [deg/s]",
        "worst",
        "GRF [N]",
        "worst",
        "CoP [mm]",
        "worst",
    ]
    keys = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")
    return format_table(
        header,
        [
            [
                f"{r['factor']:g}" + ("" if r["success"] else " (failed)"),
                *(r[k + e] for k in keys for e in ("", "_worst")),
            ]
            for r in rows
        ],
    )


def rounded(value: float) -> str:
    """Three digits, without a power of ten.

    >>> rounded(52947.3)
    '52 900'
    """
    return f"{float(f'{value:.3g}'):,.10g}".replace(",", " ")
