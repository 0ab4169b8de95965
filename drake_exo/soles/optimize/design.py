"""Stages of an optimisation: coarse to fine, fewer to all samples.

The smoothing layer comes down from stage to stage; every stage starts from
the best design of the one before. A stage whose elements are worn out goes on
with new ones. Ctrl-C leaves the best so far on disk.
"""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.soles.case import Case, Stage
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.contact.node_law import ContactLaw
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, brick, maximum_volume
from drake_exo.soles.optimize.checkpoint import Checkpoint
from drake_exo.soles.optimize.limits import Limits
from drake_exo.soles.optimize.optimizer import QuasiNewton, WarmStart, minimise
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.program import minimise_by_snopt
from drake_exo.soles.optimize.remeshing import (
    RemeshError,
    carried,
    is_worn,
    record,
    renewed,
)
from drake_exo.soles.optimize.verification import Design, judged
from drake_exo.soles.shape import SphericalSpline

_CHECKPOINT_EVERY = 3  # iterations
_LEAST_ROUND = 5  # iterations before elements are made anew
_WORN_OUT = "elements worn out"
_BARRIER = 1e-4  # IPOPT's μ on new elements


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
        block.roughness if stage.roughness is None else stage.roughness,
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
    optima, seconds = [], []
    at = resume or Checkpoint()
    for number in range(at.stage, len(stages)):
        began = time.perf_counter()
        problem = stage_problem(case, own, load, start, stages[number])
        if at.p is None:
            first = first_design(problem, tuple(case.optimize.bounds))
            at = Checkpoint(p=first, latest=first)
        at.check_fits(problem)
        problem, at = _on_mesh(problem, case, own, number, at, say)
        best, learnt, problem, at = _run_rounds(
            problem, case.optimize, number, at, out, say
        )
        optima.append(best)
        seconds.append(time.perf_counter() - began)
        best.latest = (best.p, best.multipliers, WarmStart.barrier)
        following = min(number + 1, len(stages) - 1)
        at = Checkpoint.of(following, 0, best, learnt, problem, at.remeshed)
        at.write(out)
    return judged(case, problem, at, load, start, optima, seconds)


def _on_mesh(problem, case, own, number, at: Checkpoint, say):
    """The stage's problem on elements that carry the design it starts from.

    Its own brick's where they are sound, else new ones made from those of the
    stage before, else the brick's where they do at all, else those of the
    stage before.
    """
    stages = case.optimize.stages
    last = stages[max(number - 1, 0)]
    same = stages[number].divisions == last.divisions
    if at.iteration > 0 or same:
        return at.on_its_mesh(problem), at
    before = at.mesh or stage_mesh(case, own, last)
    at = replace(at, mesh=None, meshed_at=None)
    p, renewable = at.latest, case.optimize.remeshes > 0
    if not is_worn(problem, p):
        return problem, at
    new = None
    if renewable:
        try:
            new = carried(problem, before, p)
        except RemeshError as error:
            say(f"stage {number + 1}: elements stay as they are: {error}")
    begin = p if renewable else settle(problem, p)
    if new is None and problem.evaluate(begin) is not None:
        return problem, at
    new = new or problem.with_mesh(before, p)
    row = record(number + 1, 0, problem, new, p)
    say(_remeshed_line(row))
    return new, replace(at, remeshed=(*at.remeshed, row))


def _run_rounds(problem, block, number, at: Checkpoint, out, say):
    """One stage, on new elements whenever a design has worn them out.

    Returns:
        Its optimum, what was learnt, the last problem and where it stands.
    """
    trace = []
    rounds = block.remeshes - sum(
        row["stage"] == number + 1 and row["iteration"] > 0
        for row in at.remeshed
    )
    while True:
        best, learnt = _run_stage(
            problem, block, number, at, out, say, rounds > 0
        )
        done = at.iteration + (best.trace[-1][0] if best.trace else 0)
        trace += [(at.iteration + row[0], *row[1:]) for row in best.trace]
        worn = rounds > 0 and is_worn(problem, best.p)
        if not worn or done >= block.stages[number].iterations:
            best.trace = trace
            return best, learnt, problem, at
        try:
            new = renewed(problem, best.p)
        except RemeshError as error:
            say(f"stage {number + 1}: elements stay as they are: {error}")
            if best.status != _WORN_OUT:
                best.trace = trace
                return best, learnt, problem, at
            rounds, new, rows = 0, problem, at.remeshed
        else:
            row = record(number + 1, done, problem, new, best.p)
            say(_remeshed_line(row))
            rounds, rows = rounds - 1, (*at.remeshed, row)
        best.latest = (best.p, _without_floor(best.multipliers), _BARRIER)
        at = Checkpoint.of(number, done, best, learnt, new, rows)
        at.write(out)
        # As after an interruption: a resumed run goes the same way.
        problem = at.on_its_mesh(new)


def _without_floor(multipliers: np.ndarray) -> np.ndarray:
    """That of the element floor (after the volume's) is none on new ones."""
    out = multipliers.copy()
    out[1] = 0.0
    return out


def _remeshed_line(row: dict) -> str:
    before, after = row["before"], row["after"]
    tr = [x["c_tr"] or np.nan for x in (before, after)]
    return (
        f"stage {row['stage']}, iteration {row['iteration']}: elements made "
        f"anew, {row['tets']} tets, least quality "
        f"{before['least_quality']:.2f} -> {after['least_quality']:.2f}, "
        f"c_tr {tr[0]:.3g} -> {tr[1]:.3g}"
    )


def _run_stage(
    problem, block, number, at: Checkpoint, out: Path, say, renewable
):
    """One stage from where it stands; its optimum, what it learnt.

    Where elements can be made anew it ends once they are worn out.
    """
    stage, bounds = block.stages[number], tuple(block.bounds)
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
        if iteration and iteration % _CHECKPOINT_EVERY == 0:
            Checkpoint.of(
                number, at.iteration + iteration, best, learnt, problem,
                at.remeshed,
            ).write(out)  # fmt: skip
        if renewable and iteration >= _LEAST_ROUND and is_worn(problem, best.p):
            return _WORN_OUT
        return None

    left = max(stage.iterations - at.iteration, 0)
    if block.solver == "snopt":
        found = minimise_by_snopt(
            problem, begin, bounds, left, block.tolerance, note
        )
        return found, learnt
    best = minimise(
        problem, begin, bounds, left, block.tolerance, note,
        refining=number > 0, learnt=learnt, warm=at.warm_start(bounds),
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


def finish_on_own_mesh(case: Case) -> Case:
    """The last stage on the case's own mesh, such as one given by --mesh."""
    return _with_last_stage(case, divisions=None)


def with_iterations(case: Case, iterations: int | None) -> Case:
    """So many iterations in the last stage; None: the case's."""
    if iterations is None:
        return case
    return _with_last_stage(case, iterations=iterations)


def _with_last_stage(case: Case, **changes) -> Case:
    stages = case.optimize.stages
    last = replace(stages[-1], **changes)
    return replace(
        case, optimize=replace(case.optimize, stages=(*stages[:-1], last))
    )


def without_limits(case: Case) -> Case:
    """The paper's own problem: neither stability, tilt nor strain limited.

    Every stage has the block's roughness: it alone holds the shape there.
    """
    block = case.optimize
    block = replace(
        block,
        stability_n_per_m=None,
        tilt_deg=None,
        strain=None,
        stages=tuple(replace(s, roughness=None) for s in block.stages),
    )
    return replace(case, optimize=block)
