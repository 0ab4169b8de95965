"""Stages of an optimisation: coarse to fine, fewer to all samples.

The smoothing layer comes down from stage to stage; every stage starts from
the best design of the one before. Ctrl-C leaves the best so far on disk.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.soles import results
from drake_exo.soles.case import Case, Stage
from drake_exo.soles.checkpoint import Checkpoint
from drake_exo.soles.contact import Start
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.limits import Limits
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, brick, maximum_volume
from drake_exo.soles.node_law import ContactLaw
from drake_exo.soles.optimiser import Optimum, WarmStart, minimise
from drake_exo.soles.problem import ShapeProblem
from drake_exo.soles.quasi_newton import QuasiNewton
from drake_exo.soles.shape import SphericalSpline
from drake_exo.soles.simulation import StepHistory, simulate

_CHECKPOINT_EVERY = 3  # iterations


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

    @property
    def smoothed(self) -> tuple[float, float] | None:
        """c_tr and c_rot by the last stage's smoothed law."""
        e = self.problem.evaluate(self.p)
        return None if e is None else (e.c_tr, e.c_rot)


def limits_of(case: Case) -> Limits:
    """The case's constraints."""
    block = case.optimize
    density = case.material.material().density_kg_per_m3
    return Limits(
        maximum_volume(case.cost.mass_limit_kg, density),
        block.stability_n_per_m,
        block.tilt_deg,
        block.strain,
        block.c_rot_nm_per_rad,
    )


def stage_mesh(case: Case, own: TetMesh, stage: Stage) -> TetMesh:
    """The stage's brick in the own mesh's bounding box, or the own mesh."""
    if stage.divisions is None:
        return own
    size = tuple(np.ptp(own.nodes, axis=0))
    filled = own.volume / np.prod(size)
    if abs(filled - 1) > 1e-6:
        raise InputError(
            "optimize.stages: divisions need a brick as the initial shape, "
            "and this mesh is none; leave them out"
        )
    return brick(size, stage.divisions)


def stage_problem(
    case: Case, own: TetMesh, load: Load, start: Start, stage: Stage
) -> ShapeProblem:
    """The shape problem of one stage."""
    block = case.optimize
    mesh = stage_mesh(case, own, stage)
    material = case.material.material()
    r = Sole(mesh, material, case.mesh.element).penalty
    return ShapeProblem(
        mesh,
        SphericalSpline(tuple(block.intervals), block.fixed_top),
        material,
        ContactLaw(case.contact.friction, r, stage.layer_m, stage.kappa),
        load,
        start,
        case.cost.weight,
        limits_of(case),
        case.mesh.element,
        block.roughness,
        case.cost.heel_strike_fraction,
        stage.samples,
        use_tr=block.use_tr,
    )


def optimise(
    case: Case,
    own: TetMesh,
    load: Load,
    start: Start,
    out: Path,
    say,
    resume: Checkpoint | None = None,
) -> Design:
    """Run the case's stages.

    Args:
        case: With its block `optimize`.
        own: The case's mesh, the initial shape.
        load, start: As for a simulation.
        out: Folder for checkpoint.json.
        say: Called with one line of progress now and then.
        resume: An earlier checkpoint to go on from.
    """
    stages = case.optimize.stages
    optima, seconds, warm = [], [], None
    at = resume or Checkpoint()
    for number in range(at.stage, len(stages)):
        began = time.perf_counter()
        problem = stage_problem(case, own, load, start, stages[number])
        if at.p is None:
            first = first_design(problem, tuple(case.optimize.bounds))
            at = Checkpoint(p=first, latest=first)
        at.check_fits(problem)
        best, learnt = _run_stage(
            problem, case.optimize, number, at, warm, out, say
        )
        optima.append(best)
        seconds.append(time.perf_counter() - began)
        warm = WarmStart(best.multipliers, *best.at_bounds)
        best.latest = ()
        following = min(number + 1, len(stages) - 1)
        at = Checkpoint.of(following, 0, best, learnt, problem)
        at.write(out)
    return _judge(case, problem, at.p, load, start, optima, seconds)


def _run_stage(problem, block, number, at: Checkpoint, warm, out: Path, say):
    """One stage from where it stands; its optimum, what it learnt."""
    stage, bounds = block.stages[number], tuple(block.bounds)
    problem.branch = at.branch(len(problem.mesh.contact))
    learnt = QuasiNewton(problem.spline.count, at.curvature)
    begin = settle(problem, at.latest)

    def note(iteration, best):
        cost, violation, error = best.trace[-1][1:]
        say(
            f"stage {number + 1}/{len(block.stages)}, iteration "
            f"{at.iteration + iteration}: c/|c0| {cost:+.4f}, violation "
            f"{violation:.1e}, error {error:.1e}, "
            f"{problem.evaluations} simulations"
        )
        if iteration % _CHECKPOINT_EVERY == 0:
            Checkpoint.of(
                number, at.iteration + iteration, best, learnt, problem
            ).write(out)

    left = max(stage.iterations - at.iteration, 0)
    best = minimise(
        problem, begin, bounds, left, block.tolerance, note,
        learnt=learnt, warm=warm or at.warm_start(bounds),
    )  # fmt: skip
    return best, learnt


def settle(problem: ShapeProblem, p: np.ndarray) -> np.ndarray:
    """The design, smoothed until this mesh can carry it.

    Elements that another mesh resolved may be inverted in this one; the
    least smoothing that leaves them room and lets the step be simulated is
    taken (a heat equation on the coefficients).
    """
    H = problem.smoothness(p)[2]
    eye = np.eye(len(p)) * np.abs(H).max()
    if not H.any():
        return p
    for amount in (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0):
        # Curvature about the undeformed shape, all ones.
        trial = 1.0 + np.linalg.solve(eye + amount * H, eye @ (p - 1.0))
        values = problem.constraints(trial)
        if np.isfinite(values).all() and values[1] >= 0:
            return trial
    return p


def first_design(problem: ShapeProblem, bounds, p=None) -> np.ndarray:
    """All coefficients one, or p, shrunk until the volume limit is met."""
    p = np.ones(problem.spline.count) if p is None else p
    for _ in range(60):
        if problem.deformed(p).volume <= 0.99 * problem.limits.volume:
            break
        p = 0.99 * p
    return np.clip(p, *bounds)


def exact_history(case: Case, sole: Sole, load: Load, start: Start, r: float):
    """Cold start, all samples, exact law."""
    law = ContactLaw(case.contact.friction, r)
    return simulate(
        sole.compliance, sole.positions, law, load.force, load.zmp, start
    )


def _judge(case, problem, p, load, start, optima, seconds) -> Design:
    mesh = problem.deformed(p)
    sole = Sole(mesh, problem.material, case.mesh.element)
    first = Sole(problem.mesh, problem.material, case.mesh.element)
    r = problem.law.penalty
    return Design(
        p,
        mesh,
        sole,
        exact_history(case, sole, load, start, r),
        first,
        exact_history(case, first, load, start, r),
        optima,
        seconds,
        problem,
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
            "iterations": [len(o.trace) - 1 for o in design.optima],
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
    finer = _at_least_twice(divisions)
    base = brick(tuple(np.ptp(own.nodes, axis=0)), finer)
    spline = design.problem.spline
    shaped = base.with_nodes(spline.deform(base.nodes, design.p))
    if shaped.volumes.min() <= 0:
        return {"tets": len(base.tets), "message": "inverted elements"}
    out = {"tets": len(base.tets)}
    r = Sole(base, design.problem.material, case.mesh.element).penalty
    for name, mesh in (("brick", base), ("design", shaped)):
        sole = Sole(mesh, design.problem.material, case.mesh.element)
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


def finish_on_own_mesh(case: Case) -> Case:
    """The last stage on the case's own mesh, such as one given by --mesh."""
    stages = case.optimize.stages
    last = replace(stages[-1], divisions=None)
    return replace(
        case, optimize=replace(case.optimize, stages=(*stages[:-1], last))
    )


def without_limits(case: Case) -> Case:
    """The paper's own problem: neither stability, tilt nor strain limited."""
    return replace(
        case,
        optimize=replace(
            case.optimize, stability_n_per_m=None, tilt_deg=None, strain=None
        ),
    )
