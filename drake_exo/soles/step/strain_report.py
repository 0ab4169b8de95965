"""Small beside finite strain at heel strike: figures and their table."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.soles import results
from drake_exo.soles.contact.newton import ContactSolver, Start
from drake_exo.soles.contact.node_law import ContactLaw
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.elasticity.neo_hookean import NeoHookeanBody
from drake_exo.soles.loads import Load
from drake_exo.soles.rotations import tilt_deg
from drake_exo.soles.step import stiffness
from drake_exo.soles.step.finite_history import FiniteHistory, follow
from drake_exo.soles.step.simulation import StepHistory, simulate

_FIGURES = (
    "sigma_max_tr_n_per_m",
    "sigma_min_rot_nm_per_rad",
    "stability_n_per_m",
    "tilt_deg",
    "largest_stretch",
    "least_stretch",
)
_KINDS = ("small", "finite")
TABLE = "finite_strain.csv"


def compare(
    sole: Sole,
    friction: float,
    load: Load,
    start: Start,
    fraction: float = 0.1,
    progress: Callable[[int, int], None] | None = None,
) -> dict:
    """Follow heel strike in small and in finite strain, exact contact law.

    Args:
        sole: The design; linear elements.
        friction: μ.
        load: Whole contact phase.
        start: How the sole is held just before contact.
        fraction: Part of the samples that is heel strike.
        progress: Called with samples done and samples in all.

    Returns:
        c_tr of both kinds, samples converged, and `samples`: the figures of
        both at the first, middle and last sample (1, 11 and 21 of the
        paper's 21), NaN where there is no equilibrium.

    Raises:
        InputError: The sole has other elements than linear ones.
    """
    if sole.element != "linear":
        raise InputError(
            f"mesh.element {sole.element!r}: finite strain is computed with "
            "linear elements; use element linear"
        )
    count = stiffness.heel_strike_count(len(load.times), fraction)
    force, zmp = load.force[:count], load.zmp[:count]
    law = ContactLaw(friction, sole.penalty)
    small = simulate(
        ContactSolver.of(sole, law),
        force,
        zmp,
        start,
        largest_force=float(np.linalg.norm(load.force, axis=1).max()),
    )
    entry = small.state(0) if small.reports[0].converged else None
    finite = follow(sole, law, force, zmp, start, entry, progress)
    return {
        "heel_strike_samples": count,
        "converged_samples": int(finite.converged.sum()),
        "c_tr_small": _sum(small.K_c),
        "c_tr_finite": _sum(finite.K_c),
        "samples": [
            _sample(sole, small, finite, q)
            for q in np.unique([0, count // 2, count - 1])
        ],
        "failures": _failures(finite),
    }


def from_json(found: dict) -> dict:
    """What `compare` returned, out of a file: its null is NaN again."""

    def numbers(row: dict) -> dict:
        return {k: np.nan if v is None else v for k, v in row.items()}

    return numbers(found) | {"samples": [numbers(r) for r in found["samples"]]}


def _failures(finite: FiniteHistory) -> list[dict]:
    return [
        {
            "sample": int(q + 1),
            "reached": finite.reached[q],
            "message": finite.reports[q].message,
        }
        for q in np.flatnonzero(~finite.converged)
    ]


def _sum(K_c: np.ndarray) -> float:
    return float(stiffness.sigma_max_translation(K_c).sum())


def _sample(
    sole: Sole, small: StepHistory, finite: FiniteHistory, q: int
) -> dict:
    row = {
        "sample": int(q + 1),
        "converged": bool(finite.reports[q].converged),
        "reached": float(finite.reached[q]),
    }
    numbers = {
        "small": _stiffnesses(small.K_c[q]),
        "finite": _stiffnesses(finite.K_c[q]),
    }
    if small.reports[q].converged:
        numbers["small"] += _small_shape(sole, small, q)
    if finite.reports[q].converged:
        state = finite.states[q]
        body = NeoHookeanBody(sole.mesh, sole.material)
        numbers["finite"] += [tilt_deg(state.R), *body.stretches(state.u)]
    for kind in _KINDS:
        values = numbers[kind] + [np.nan] * (len(_FIGURES) - len(numbers[kind]))
        row |= {
            f"{name}_{kind}": float(value)
            for name, value in zip(_FIGURES, values, strict=True)
        }
    return row


def _stiffnesses(K_c: np.ndarray) -> list[float]:
    return [
        stiffness.sigma_max_translation(K_c),
        stiffness.sigma_min_rotation(K_c),
        stiffness.stability(K_c),
    ]


def _small_shape(sole: Sole, history: StepHistory, q: int) -> list[float]:
    """Tilt, and one plus the largest and the least principal strain."""
    u = sole.displacement(history.F[q] @ history.R[q])
    eps = results.principal_strains(sole.strain(u))
    return [tilt_deg(history.R[q]), 1 + eps.max(), 1 + eps.min()]


def table(found: dict[str, dict]) -> str:
    """Text table of several soles, small beside finite strain.

    Args:
        found: Sole's name -> what `compare` returned.
    """
    head = (
        f"{'sole':11s} {'sample':>6s} {'σ_max(K_tr) [N/m]':>21s} "
        f"{'σ_min(K_rot) [N·m/rad]':>22s} {'tilt [°]':>13s} "
        f"{'largest stretch':>15s} {'least stretch':>15s}"
    )
    widths = (10, 10, 6, 7, 7)
    under = " " * 18 + "".join(
        f" {'small':>{w}s} {'finite':>{w}s}" for w in widths
    )
    lines = [head, under, "-" * len(head)]
    for name, sole in found.items():
        for row in sole["samples"]:
            lines.append(_line(name, row))
        lines += _remarks(sole)
        lines.append("")
    return "\n".join(lines).rstrip()


def _line(name: str, row: dict) -> str:
    def pair(key, text):
        return " ".join(text.format(row[f"{key}_{k}"]) for k in _KINDS)

    return " ".join(
        [
            f"{name:11s} {row['sample']:6d}",
            pair("sigma_max_tr_n_per_m", "{:10.3g}"),
            pair("sigma_min_rot_nm_per_rad", "{:10.3g}"),
            pair("tilt_deg", "{:6.1f}"),
            pair("largest_stretch", "{:7.3f}"),
            pair("least_stretch", "{:7.3f}"),
        ]
    )


def _remarks(sole: dict) -> list[str]:
    lines = [
        f"{'':11s} c_tr {sole['c_tr_small']:.3g} in small, "
        f"{sole['c_tr_finite']:.3g} in finite strain"
    ]
    if sole["failures"]:
        first = sole["failures"][0]
        lines = [
            f"{'':11s} finite strain: {sole['converged_samples']} of "
            f"{sole['heel_strike_samples']} samples have an equilibrium; "
            f"sample {first['sample']}: {first['message']}"
        ]
    loose = [
        str(row["sample"])
        for row in sole["samples"]
        if row["stability_n_per_m_finite"] <= 0
    ]
    if loose:
        lines.append(
            f"{'':11s} finite strain: not stable at sample {', '.join(loose)}"
        )
    turned_over = any(r["least_stretch_small"] <= 0 for r in sole["samples"])
    if turned_over:
        lines.append(
            f"{'':11s} small strain turns elements inside out (least "
            "stretch below 0): its figures do not hold here"
        )
    return lines


def write_table(folder: Path, found: dict[str, dict]) -> str:
    """Write finite_strain.txt and .csv; the text."""
    text = table(found)
    (folder / "finite_strain.txt").write_text(text + "\n", encoding="utf-8")
    rows = [
        {"sole": name, **row}
        for name, sole in found.items()
        for row in sole["samples"]
    ]
    path = folder / TABLE
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {
                key: f"{v:.10g}" if isinstance(v, float) else v
                for key, v in row.items()
            }
            for row in rows
        )
    return text
