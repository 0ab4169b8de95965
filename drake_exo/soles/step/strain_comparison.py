"""Heel strike in small beside finite strain: followed, compared, tabulated."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drake_exo.files.output import write_text
from drake_exo.soles.contact.finite_strain import (
    FiniteState,
    FiniteStrainSolver,
    NeoHookeanBody,
)
from drake_exo.soles.contact.law import FLAT, ContactLaw, Ground
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.numerics import tilt_deg
from drake_exo.soles.settings import Setup
from drake_exo.soles.step.results import principal_strains
from drake_exo.soles.step.simulation import (
    StepHistory,
    first_step,
    lead,
    sample_weights,
    sigma_max_translation,
    sigma_min_rotation,
    simulate,
    stability,
)

# Parts of the first sample's load at which to enter from small strain.
_ENTRIES = (1.0, 0.5, 0.25, 0.1, 0.04)


@dataclass
class FiniteHistory:
    """States over the samples; a failed one keeps what was reached.

    Attributes:
        states: State of every sample, None where there was none.
        K_c: Cartesian stiffness about the ZMP, NaN where failed, (N, 6, 6).
        reports: Convergence of every sample.
        reached: Part of the way from the sample before to this one's load
            that found an equilibrium, (N,); 1 where converged.
    """

    states: list[FiniteState | None] = field(default_factory=list)
    K_c: np.ndarray = field(default_factory=lambda: np.zeros((0, 6, 6)))
    reports: list[Convergence] = field(default_factory=list)
    reached: list[float] = field(default_factory=list)

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,)."""
        return np.array([r.converged for r in self.reports], dtype=bool)


def follow(
    sole: Sole,
    law: ContactLaw,
    load: Load,
    start: Start,
    entry: State | None = None,
    progress: Callable[[int, int], None] | None = None,
    ground: Ground = FLAT,
) -> FiniteHistory:
    """Follow force and ZMP sample by sample, with the contact's history.

    The first sample is entered from the small-strain solution, at a part of
    its load where need be; the others from the sample before. Where Newton
    fails the load's way is bisected. Without an equilibrium the contact's
    history ends: the samples that follow are left out.

    Args:
        sole: Mesh and material.
        law: Contact law, as in small strain.
        load: What is asked for at N samples.
        start: How the sole is held just before contact.
        entry: Small-strain solution of the first sample, if known.
        progress: Called with samples done and samples in all.
        ground: What it stands on.
    """
    body = NeoHookeanBody(sole.mesh, sole.material)
    solver = FiniteStrainSolver(body, law, ground=ground)
    count = len(load.times)
    history = FiniteHistory(K_c=np.full((count, 6, 6), np.nan))
    for q in range(count):
        if q in load.begins:
            target = load.target(q, start, ground)
            largest = load.largest_force
            if q:
                entry = None
            state, report, reached = _enter(
                sole, solver, target, largest, entry
            )
        else:
            reference = solver.places(state)
            target = load.target(q, reference, ground)
            before = load.target(q - 1, reference, ground)
            state, report, reached = lead(solver, state, before, target)
        history.states.append(state)
        history.reports.append(report)
        history.reached.append(reached)
        if not report.converged:
            _leave_out(history, count - q - 1)
            break
        history.K_c[q] = solver.cartesian_stiffness(state, target)
        if progress is not None:
            progress(q + 1, count)
    return history


def _leave_out(history: FiniteHistory, count: int) -> None:
    rest = Convergence(False, 0, np.inf, "left out after a failure")
    history.states += [None] * count
    history.reports += [rest] * count
    history.reached += [0.0] * count


def _enter(sole, solver, target: Target, largest: float, known: State | None):
    """First sample: small strain at a part of the load, then all of it."""
    small = ContactSolver.of(sole, solver.law, ground=solver.ground)
    best = None
    for part in _ENTRIES:
        aim = replace(
            target, force=part * target.force, moment=part * target.moment
        )
        guess = known if part == 1.0 else None
        if guess is None:
            guess, report = first_step(small, aim, part * largest)
            if not report.converged:
                best = best or (None, report, 0.0)
                continue
        u = sole.displacement(guess.F @ guess.R)
        state = FiniteState(guess.F, u, guess.O, guess.R)
        state, report = solver.solve(state, aim)
        if not report.converged:
            best = best or (None, report, 0.0)
            continue
        entry = report.iterations
        state, report, way = lead(solver, state, aim, target)
        report.iterations += entry
        reached = part + way * (1.0 - part)
        if report.converged:
            return state, report, 1.0
        if best is None or reached > best[2]:
            best = (state, report, reached)
    return best


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


def compare_strains(
    setup: Setup, say: Callable[[str], object] | None = None
) -> dict:
    """Follow heel strike in small and in finite strain, exact contact law.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> found = dx.soles.compare_strains(case)
    >>> found["converged_samples"], found["heel_strike_samples"]
    (1, 1)
    >>> print(f"{found['c_tr_finite'] / found['c_tr_small']:.2f}")
    1.02

    Both in linear elements, whatever the case's are: finite strain knows no
    others.

    Args:
        setup: A sole and its step.
        say: Called with one line of progress now and then.

    Returns:
        c_tr of both kinds, samples converged, and `samples`: the figures of
        both at the first, middle and last sample (1, 11 and 21 of the
        paper's 21), NaN where there is no equilibrium.
    """
    mesh = setup.mesh.touching_everywhere()
    sole = Sole(mesh, setup.settings.material.material(), "linear")
    load, start = setup.load, setup.start
    cost = setup.settings.cost
    by_tr, _ = sample_weights(load, cost.heel_strike_fraction)
    strike = load.at(np.flatnonzero(by_tr))
    count = len(strike.times)
    law = ContactLaw(setup.settings.contact.friction, sole.penalty)
    small = simulate(
        ContactSolver.of(sole, law, ground=setup.ground),
        strike,
        start,
        largest_force=load.largest_force,
    )
    entry = small.state(0) if small.reports[0].converged else None

    def progress(done: int, count: int) -> None:
        if say is not None:
            say(f"finite strain, {done} of {count} samples")

    finite = follow(sole, law, strike, start, entry, progress, setup.ground)
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
    """What `compare_strains` returned, out of a file: its null is NaN again."""

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
    return float(sigma_max_translation(K_c).sum())


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
        sigma_max_translation(K_c),
        sigma_min_rotation(K_c),
        stability(K_c),
    ]


def _small_shape(sole: Sole, history: StepHistory, q: int) -> list[float]:
    """Tilt, and one plus the largest and the least principal strain."""
    u = sole.displacement(history.F[q] @ history.R[q])
    eps = principal_strains(sole.strain(u))
    return [tilt_deg(history.R[q]), 1 + eps.max(), 1 + eps.min()]


def table(found: dict[str, dict]) -> str:
    """Text table of several soles, small beside finite strain.

    Args:
        found: Sole's name -> what `compare_strains` returned.
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


def write_table(folder: Path, found: dict[str, dict], mark: str = "") -> str:
    """Write finite_strain.txt, marked, and .csv; the text."""
    text = table(found)
    write_text(folder / "finite_strain.txt", text, mark)
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
