"""A design judged: exact law, cold start, all samples, and a finer mesh."""

from dataclasses import dataclass

import numpy as np

from drake_exo.soles import results
from drake_exo.soles.case import Case
from drake_exo.soles.contact.newton import ContactSolver, Start
from drake_exo.soles.contact.node_law import ContactLaw
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, brick
from drake_exo.soles.optimize.optimizer import Optimum, merits
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.remeshing import (
    RemeshError,
    in_eighths,
    remesh_with,
    untangled,
)
from drake_exo.soles.step.simulation import StepHistory, simulate

_SOUND = 0.15  # least quality at which a finer brick judges a design
_FORMER = 5  # earlier designs to fall back on
_NEEDLE = 0.02  # quality below which inner nodes are moved


@dataclass
class Design:
    """An optimised sole beside its brick, both with the exact law.

    Attributes:
        p: Free coefficients.
        mesh: Optimised mesh (that of the last stage).
        sole, history: Simulated with the exact law from a cold start.
        first_sole, first_history: The initial shape likewise.
        optima: Outcome of every stage.
        seconds: Of every stage.
        problem: The last stage's problem.
        remeshed: When elements were made anew, see `renewal.record`.
    """

    p: np.ndarray
    mesh: TetMesh
    sole: Sole
    history: StepHistory
    first_sole: Sole
    first_history: StepHistory
    optima: list[Optimum]
    seconds: list[float]
    problem: ShapeProblem
    remeshed: tuple[dict, ...] = ()

    @property
    def smoothed(self) -> tuple[float, float] | None:
        """c_tr and c_rot by the last stage's smoothed law."""
        e = self.problem.evaluate(self.p)
        return None if e is None else (e.c_tr, e.c_rot)


def exact_history(case: Case, sole: Sole, load: Load, start: Start, r: float):
    """Cold start, all samples, exact law."""
    law = ContactLaw(case.contact.friction, r)
    solver = ContactSolver.of(sole, law)
    return simulate(solver, load.force, load.zmp, start)


def by_exact_law(
    case: Case, problem: ShapeProblem, load: Load, start: Start, p, former
) -> tuple[np.ndarray, Sole, StepHistory]:
    """A design by the exact law; where that fails, one of the last before.

    Args:
        case, load, start: As for a simulation.
        problem: Whose mesh it is.
        p: The design.
        former: Those before it, the last one last.

    Returns:
        p, its sole and history, or those of the last former design without
        failed steps.
    """

    def judge(p):
        sole = case.sole(problem.deformed(p))
        r = problem.law.penalty
        return p, sole, exact_history(case, sole, load, start, r)

    last = judge(p)
    if last[2].failed_steps == 0:
        return last
    others = map(judge, former[: -_FORMER - 1 : -1])
    return next((x for x in others if x[2].failed_steps == 0), last)


def judged(case, problem, at, load, start, optima, seconds) -> Design:
    """The design where a search stands, see `by_exact_law`.

    Args:
        case, load, start: As for a simulation.
        problem: The last stage's problem.
        at: The last checkpoint.
        optima, seconds: Of every stage.
    """
    former = optima[-1].former if optima else []
    p, sole, history = by_exact_law(case, problem, load, start, at.p, former)
    if p is not at.p:
        optima[-1].status += ", an earlier design by the exact law"
        optima[-1].optimal = False
        optima[-1].cost, optima[-1].violation = merits(problem, p)
    first = problem.first.sole
    return Design(
        p,
        sole.mesh,
        sole,
        history,
        first,
        exact_history(case, first, load, start, problem.law.penalty),
        optima,
        seconds,
        problem,
        at.remeshed,
    )


def design_summary(case: Case, design: Design) -> dict:
    """The row of a study's table for one case (no seconds)."""
    w, fraction = case.cost.weight, case.cost.heel_strike_fraction
    now = results.summary(case, design.sole, design.history)
    tr0, rot0, c0 = design.first_history.costs(w, fraction)
    last = design.optima[-1] if design.optima else None
    row = {
        key: now[key]
        for key in (
            "name", "c_tr", "c_rot", "c", "failed_steps", "failures",
            "volume_cm3", "stable", "stability_min_n_per_m", "tilt_max_deg",
            "max_strain", "tets", "contact_nodes", "least_quality", "weight",
        )
    }  # fmt: skip
    row |= {
        "c_tr_initial": tr0,
        "c_rot_initial": rot0,
        "c_initial": c0,
        "ratio_tr": now["c_tr"] / tr0,
        "ratio_rot": now["c_rot"] / rot0,
        "optimal": bool(last and last.optimal),
        "remeshed": design.remeshed,
    }
    if last is not None:
        row |= {
            "status": last.status,
            "optimality_error": last.error,
            "complementarity": last.complementarity,
            "violation": last.violation,
            "multipliers": dict(
                zip(design.problem.names(), last.multipliers, strict=True)
            ),
            "iterations": [
                int(o.trace[-1][0] - o.trace[0][0]) if o.trace else 0
                for o in design.optima
            ],
            "simulations": design.problem.evaluations,
        }
    if design.smoothed is not None:
        c_tr, c_rot = design.smoothed
        c = c_tr - w * c_rot
        row |= {"c_smoothed": c, "exact_change": now["c"] / c - 1}
    return row


def _at_least_twice(divisions) -> tuple[int, int, int]:
    """Divisions with at least twice, and little more, cells."""
    wanted = 2 * int(np.prod(divisions))
    finer = [int(np.ceil(2 ** (1 / 3) * n)) for n in divisions]
    for axis in range(3):
        fewer = [n - (k == axis) for k, n in enumerate(finer)]
        if np.prod(fewer) >= wanted:
            finer = fewer
    return tuple(finer)


def _finer(size, divisions, design: Design) -> tuple[TetMesh, TetMesh]:
    """A finer brick and the design on a mesh as fine.

    The brick's own elements where they are sound at the design, else new ones,
    else the brick's, where inverted of one finer in plan with inner nodes
    moved, else eighths of the design's own.
    """
    mesh, spline, p = design.problem.mesh, design.problem.spline, design.p

    def shape(finer):
        base = brick(size, finer)
        return base, base.with_nodes(spline.deform(base.nodes, p))

    base, shaped = shape(_at_least_twice(divisions))
    if shaped.quality().min() >= _SOUND:
        return base, shaped
    try:
        other = remesh_with(mesh, spline, p, 2 * len(design.mesh.tets))
        return base, other.with_nodes(spline.deform(other.nodes, p))
    except RemeshError:
        if shaped.volumes.min() > 0:
            return base, shaped
    nx, ny, nz = divisions
    flat, shaped = shape((_times_root_two(nx), _times_root_two(ny), nz))
    shaped = untangled(shaped, _NEEDLE)
    if shaped.volumes.min() > 0:
        return flat, shaped
    return base, in_eighths(mesh, spline, p)[0]


def _times_root_two(cells: int) -> int:
    return int(np.ceil(np.sqrt(2) * cells))


def finer_check(case: Case, own, load, start, design: Design) -> dict | None:
    """The design on a mesh of at least twice the tets, beside the brick.

    `change` and `brick_change` are those of c against the last stage's mesh.
    """
    divisions = next(
        (s.divisions for s in reversed(case.optimize.stages)
         if s.divisions is not None), None,
    )  # fmt: skip
    if divisions is None:
        return None
    base, shaped = _finer(tuple(np.ptp(own.nodes, axis=0)), divisions, design)
    out = {"tets": len(shaped.tets)}
    undeformed, deformed = (case.sole(mesh) for mesh in (base, shaped))
    r = undeformed.penalty
    for name, sole in (("brick", undeformed), ("design", deformed)):
        history = exact_history(case, sole, load, start, r)
        c_tr, c_rot, c = history.costs(
            case.cost.weight, case.cost.heel_strike_fraction
        )
        out[name] = {
            "c_tr": c_tr, "c_rot": c_rot, "c": c,
            "failed_steps": history.failed_steps,
        }  # fmt: skip
    w, fraction = case.cost.weight, case.cost.heel_strike_fraction
    for key, name, before in (
        ("change", "design", design.history),
        ("brick_change", "brick", design.first_history),
    ):
        out[key] = out[name]["c"] / before.costs(w, fraction)[2] - 1
    return out
