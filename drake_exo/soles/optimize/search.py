"""Search for the best shape: several starts, optimised stage by stage.

`search_jobs` lists a case's stages as jobs, `optimise` runs them. After each
stage but the last the better half of the starts continues (successive halving:
Jamieson and Talwalkar, AISTATS 2016). They are compared by cost on a finer
mesh, where a gain that is only an artefact of a design's own mesh vanishes. A
free walk is sought afterwards: from the sole for the case's own walk, sole and
walk are optimised together from several walks, and the best goes through the
last stage. Ctrl-C leaves a checkpoint of the best design so far.

`pareto_front` minimises c_tr alone subject to c_rot >= floor, lowest floor
first. The first point starts from the case's own optimum, each later one from
the point before; points share the Hessian approximation that they build up.
Floors that are not kept so are sought again from a shape of large c_rot,
highest floor first: then a lower one starts from a design that keeps it.
"""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice, repeat
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import Bounds, minimize

from drake_exo.errors import InputError, check_type
from drake_exo.files.output import SOLVED, Check
from drake_exo.jobs.engine import (
    Ended,
    Heard,
    Here,
    Job,
    Processes,
    logged,
    run_jobs,
)
from drake_exo.soles.optimize.design import Design, verified
from drake_exo.soles.optimize.files import Checkpoint, start_folder
from drake_exo.soles.optimize.limits import (
    FEASIBLE,
    ROUNDING,
    rotation_limit,
    strain_limit,
)
from drake_exo.soles.optimize.optimizer import (
    WARM_BARRIER,
    Optimum,
    QuasiNewton,
    minimise,
)
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Setup, Stage, stage_mesh, without_divisions
from drake_exo.soles.walking_pattern import Robot

_CHECKPOINT_EVERY = 3  # iterations
_WALKS = 4  # walks tried per start
_BEND, _WAVES = 0.03, 4  # random starts: amplitude, cosines along each axis
# Share of the strain limit: the norm's scale is not updated within a stage.
_STRAIN_AIM = 0.98
_ROOM = 0.01  # margin to the scaled limits at the start
# Random bends drawn at each size, largest first, until one can be simulated.
_TRIES, _SIZES = 20, (1.0, 0.5, 0.25)


@dataclass
class Found:
    """State of a search from one start, or from the best of all starts.

    Attributes:
        optima: Outcome of every stage so far.
        at: Checkpoint to continue from; None before a start's first stage.
        seconds: Computing time of the stages [s]; of a best, of all starts.
        start: Number of the start or walk, from 0.
        alone: If a walk is sought, result for the sole alone; None if a
            resumed run knows only that sole's coefficients.
    """

    optima: list[Optimum]
    at: Checkpoint | None
    seconds: float = 0.0
    start: int = 0
    alone: "Found | None" = None

    @property
    def stage(self) -> int:
        """Number of the stage it continues with, from 0."""
        return self.optima[-1].stage + 1 if self.optima else self.at.stage

    @property
    def rank(self) -> tuple:
        """Sort key: most stages done first, then the better latest optimum."""
        return -self.stage, *self.optima[-1].rank

    def after(self, best: Optimum, at: Checkpoint) -> "Found":
        """The state after one more stage, with its optimum and checkpoint."""
        seconds = self.seconds + best.seconds
        optima = [*self.optima, best]
        return replace(self, optima=optima, at=at, seconds=seconds)


def optimise(
    setup: Setup,
    out: Path | None,
    say: Callable[[str], object],
    resume: Checkpoint | None = None,
    at_once: int = 1,
    bends: Sequence[int] | None = None,
) -> Design:
    """Run the case's stages and return the design, see `Case.optimize`.

    While starts (or walks) are tried, each has a folder below `out`; `bends`
    are the starts' shapes (see `start_design`), by default 0, 1, 2, ...
    """
    began = time.perf_counter()
    if resume is not None:  # an interruption may come before the next one
        for start, begun in enumerate(resume.begun):
            if begun is not None:
                begun.write(start_folder(out, start))
        if resume.p is not None:
            resume.write(out)
    jobs = search_jobs(setup, out, resume, bends)

    def end(row: Ended) -> None:
        if row.state == "lost":
            raise InputError(
                "optimize.starts: the process of a start was killed, perhaps "
                "for want of memory; go on (resume) with one start at a time"
            )
        row.result()

    with TemporaryDirectory() as logs:
        # Without jobs side by side no other process is needed.
        widest = max(Counter(job.needs for job in jobs).values())
        if min(at_once, widest) == 1:
            jobs, pool = [job.told(say=say) for job in jobs], Here()
        else:
            jobs, pool = logged(jobs, Path(logs)), Processes(at_once)
        with pool:
            ended = run_jobs(jobs, pool, end, Heard(say))
    design = finished(setup, ended[jobs[-1].name].value)
    design.seconds = time.perf_counter() - began
    return design


def search_jobs(
    setup: Setup,
    out: Path | None,
    resume: Checkpoint | None = None,
    bends: Sequence[int] | None = None,
    name: str = "",
) -> list[Job]:
    """The stages of a case as jobs; the last one returns the final `Found`.

    They lack an argument `say`, called with one line of progress now and then.
    `name` is a prefix of their names; the rest is as for `optimise`.
    """
    block, at = setup.settings.optimize, resume or Checkpoint()
    jobs, still = [], in_own_walk(setup)

    def add(title: str, function: Callable, needs=(), **arguments) -> Job:
        here = {"setup": still, "out": out}
        return Job(
            name + title, f"{__name__}:{function.__name__}",
            here | arguments, tuple(job.name for job in needs),
            given="before" if needs else None,
        )  # fmt: skip

    if at.p is None:
        bends = tuple(range(block.starts) if bends is None else bends)
        begun = list(islice(chain(at.begun, repeat(None)), block.starts))
        for number in range(max(len(block.stages) - 1, 1)):
            jobs += [
                add(
                    f"{place + 1}/stage {number + 1}", race, jobs,
                    number=number, place=place, begun=at_start, bends=bends,
                )
                for place, at_start in enumerate(begun)
            ]  # fmt: skip
            begun = begun[: (len(begun) + 1) // 2]
    if setup.gait is None:
        return [*jobs, add("last stage", go_on, jobs, at=at)]
    if at.alone is None:
        jobs.append(add("last stage", go_on, jobs, at=at, is_alone=True))
    walks, count = [], block.starts * _WALKS
    if at.alone is None or at.is_alone:
        begun = chain(at.begun if at.is_alone else (), repeat(None))
        walks = [
            add(
                f"walk {number + 1}", in_walk, jobs[-1:], setup=setup, at=at,
                number=number, count=count, begun=begun_in,
            )
            for number, begun_in in enumerate(islice(begun, count))
        ]  # fmt: skip
    last = add("with its walk", go_on, walks, setup=setup, at=at)
    return [*jobs, *walks, last]


def race(
    setup: Setup,
    out,
    number: int,
    place: int,
    begun,
    bends: Sequence[int],
    say,
    before=(),
) -> Found:
    """Run stage `number` (from 0, not the last) of one start.

    `place` is its rank after the stage before (at first its number), `begun` a
    checkpoint if interrupted, `before` earlier jobs' results by name.
    """
    racer = Found([], begun, start=place)
    if before:
        racer = sorted(_racers(before), key=lambda r: r.rank)[place]
    prefix, starts = "", setup.settings.optimize.starts
    if starts > 1:
        out = start_folder(out, racer.start)
        prefix = f"start {racer.start + 1}/{starts}, "
    ended = from_start(
        setup, bends[racer.start], number, racer.at, out,
        lambda line: say(prefix + line),
    )  # fmt: skip
    return racer.after(*ended)


def in_walk(
    setup: Setup,
    out,
    at: Checkpoint,
    number: int,
    count: int,
    begun,
    say,
    before=(),
) -> Found:
    """Optimise sole and walk together from walk `number` of `count`.

    This is the last stage but one. It starts from the sole alone: the result in
    `before`, or else `at`. `begun` is the walk's checkpoint if interrupted.
    """
    alone = None
    if before:
        (alone,) = before.values()
        at = alone.at
    stage = max(len(setup.settings.optimize.stages) - 2, 0)
    if begun is None:
        p = np.append(at.alone, setup.gait.walk(number))
        begun = Checkpoint(
            stage, p=p, latest=p, case=setup.name, key=setup.key, alone=at.alone
        )
    ended = from_start(
        setup, 0, stage, begun, start_folder(out, number),
        lambda line: say(f"walk {number + 1}/{count}, {line}"),
    )  # fmt: skip
    return Found([], begun, start=number, alone=alone).after(*ended)


def _racers(before) -> list[Found]:
    """The latest result of every start, of the jobs' results by name."""
    return list({racer.start: racer for racer in before.values()}.values())


def go_on(
    setup: Setup, out, at: Checkpoint, say, before=(), is_alone: bool = False
) -> Found:
    """Run the remaining stages from a checkpoint or the best of the starts.

    With `is_alone` the result is kept as the sole alone of a sought walk.
    """
    prefix = "sole alone, " if is_alone else ""
    found = Found([], at)
    if before:
        racers = _racers(before)
        best = min(racers, key=lambda racer: racer.rank)
        at = replace(best.at, starts=tuple(r.at.starts[-1] for r in racers))
        seconds = sum(racer.seconds for racer in racers)
        found = Found(best.optima, at, seconds, alone=best.alone)
        at.write(out)
        if out is not None:
            for racer in racers:
                folder = start_folder(out, racer.start)
                shutil.rmtree(folder, ignore_errors=True)
    for number in range(found.stage, len(setup.settings.optimize.stages)):
        ended = _run_stage(
            setup, number, found.at, out, lambda line: say(prefix + line)
        )
        found = found.after(*ended)
        found.at.write(out)
    if is_alone:
        found.at = replace(found.at, alone=found.at.p)
        found.at.write(out)
    return found


def finished(setup: Setup, found: Found) -> Design:
    """The verified design of a search, with its walk if that is free."""
    began, design = time.perf_counter(), _verified(setup, found)
    if setup.gait:
        design = _with_walk(setup, design, found)
    design.seconds = found.seconds + time.perf_counter() - began
    return design


def _verified(setup: Setup, found: Found) -> Design:
    """The design of a search, by the exact law and the last stage's limits."""
    stages = setup.settings.optimize.stages
    problem = ShapeProblem(setup, stages[-1])
    if len(stages) > 1:
        _scale(problem, found.at)
    return verified(setup, problem, found.at, found.optima)


def in_own_walk(setup: Setup) -> Setup:
    """The setup with its walk fixed at the case's own."""
    return _walking(setup, setup.gait.robot) if setup.gait else setup


def _walking(setup: Setup, robot: Robot) -> Setup:
    """The setup with this walk, fixed, in its settings; the load stays."""
    load = replace(setup.settings.load, pattern=replace(robot, free=()))
    return replace(setup, settings=replace(setup.settings, load=load))


def _with_walk(setup: Setup, design: Design, found: Found) -> Design:
    """The design with `gait`, its walk before and after, filled in.

    It is the sole alone if that is no worse: within limits first, then by c.
    """
    gait = setup.gait
    at = replace(found.at, p=found.at.alone)
    of = found.alone or Found([], at)
    at = replace(at, strain_scale=of.at.strain_scale)
    alone = _verified(in_own_walk(setup), replace(of, at=at))
    own = alone.step

    def rank(one: Design):
        return not one.verdict().holds, one.step.c

    if rank(alone) <= rank(design):
        design = alone
    x = design.walk if len(design.walk) else gait.start
    robots = gait.robot, gait.at(x)
    before, after = map(gait.numbers, robots)
    times = (robot.bearing for robot in robots)
    spans = [end - begin for begin, end in times]
    limits = gait.limits(x).values()
    design.gait = {
        "walk": {name: [before[name], after[name]] for name in gait.ranges},
        "contact_s": spans,
        "least_limit": float(min(limit.min() for limit in limits)),
        "c_tr_sole_alone": own.c_tr,
        "c_rot_sole_alone": own.c_rot,
    }
    # So that case.yaml gives as many samples as the search had.
    walk = replace(
        robots[1],
        period_s=float(f"{gait.robot.period_s * spans[1] / spans[0]:.12g}"),
        first_s=float(design.setup.load.times[0]),
    )
    design.setup = _walking(design.setup, walk)
    return design


def from_start(
    setup: Setup, bend: int, number: int, at, out, say
) -> tuple[Optimum, Checkpoint]:
    """Run stage `number` from one start; its optimum, the next checkpoint.

    `bend` is the start's shape, see `start_design`; `at` its checkpoint, None
    to begin; `out` a folder for checkpoints, None for none.
    """
    began, block = time.perf_counter(), setup.settings.optimize
    rows = {} if at is None else {r.get("stage", 1): r for r in at.starts}
    if row := rows.get(number + 1):
        # The stage was finished before an interruption.
        done = Optimum(
            at.p, row["cost"], violation=row["violation"], stage=number,
            multipliers=at.multipliers, cost_finer=row.get("cost_finer"),
        )  # fmt: skip
        return done, at
    problem = _problem(setup, number)
    if at is None:
        bounds = problem.within(block.bounds)
        p = nearest_allowed(
            problem, bounds, start_design(problem, bounds, bend)
        )
        at = Checkpoint(p=p, latest=p, case=setup.name, key=setup.key)
    best, at = _run_stage(setup, number, at, out, say, problem)
    # Infeasible designs are compared by violation, without a finer mesh.
    compared = block.starts > 1 or setup.gait
    if compared and best.violation <= FEASIBLE:
        say(f"stage {number + 1}/{len(block.stages)}, on a finer mesh")
        best.cost_finer = problem.cost_on_finer(best.p)
    best.seconds = time.perf_counter() - began
    row = {
        "stage": number + 1, "cost": best.cost, "violation": best.violation,
        "cost_finer": best.cost_finer,
    }  # fmt: skip
    at = replace(at, starts=(*at.starts, row))
    at.write(out)
    return best, at


def start_design(problem: ShapeProblem, bounds, bend: int) -> np.ndarray:
    """Initial design p (P,) of a start, within the volume limit.

    Bend 0 is the undeformed shape; others seed a smooth random change of it.
    """
    if bend == 0:
        return first_design(problem, bounds)
    rng = np.random.default_rng(bend)
    T, p0 = problem.spline.free_map()
    grids = [np.linspace(0, np.pi, n + 2) for n in problem.spline.intervals]
    waves = [np.cos(np.outer(grid, np.arange(_WAVES))) for grid in grids]
    for size in np.repeat(_SIZES, _TRIES):
        bend = waves[0] @ rng.standard_normal((_WAVES, _WAVES)) @ waves[1].T
        full = 1.0 + size * _BEND * bend.ravel()
        p = np.linalg.lstsq(T.toarray(), full - p0, rcond=None)[0]
        p = first_design(problem, bounds, np.clip(p, *bounds))
        values = problem.constraints(p)
        if np.isfinite(values).all() and values[:2].min() >= 0:
            return p
    return first_design(problem, bounds)


def strain_scale(problem: ShapeProblem, p: np.ndarray) -> float:
    """Ratio of a design's largest strain to the strain norm that is limited.

    The largest strain is by the exact law with all samples; the norm is that
    of the stage's samples and smoothed law (adaptive scaling: Le, Norato,
    Bruns, Ha and Tortorelli 2010, for stresses). 1 if a simulation fails.
    """
    e = problem.evaluate(p)
    if e is None:
        return 1.0
    step = problem.step(p)
    if step.failed_steps:
        return 1.0
    return step.largest_strain / e.strain.value


def _scale(problem: ShapeProblem, at: Checkpoint) -> None:
    """Scale the limit on the strain norm, to limit the largest strain."""
    if "strain" in problem.limits:
        largest = _STRAIN_AIM * problem.limits["strain"] / at.strain_scale
        problem.limited["strain"] = partial(strain_limit, largest=largest)


def _problem(setup: Setup, number: int) -> ShapeProblem:
    """The problem of stage `number`; the first of several is of the mean."""
    stages = setup.settings.optimize.stages
    begun = _of_mean(setup) if number == 0 and len(stages) > 1 else setup
    return ShapeProblem(begun, stages[number])


def _of_mean(setup: Setup) -> Setup:
    """The setup with the mean of the loads' costs in place of the worst.

    A search for the least cost of the worst load begins so. Far from it all
    loads gain together; a maximum bends sharply where the worst one changes,
    and a search that begins on it comes to a standstill there. The worst knows
    no weights, so that mean has none.
    """
    if setup.settings.cost.of == "mean":
        return setup
    cost = replace(setup.settings.cost, of="mean")
    load = replace(setup.load, weights=(1.0,) * len(setup.load.weights))
    settings = replace(setup.settings, cost=cost)
    return replace(setup, settings=settings, load=load)


def _run_stage(setup: Setup, number, at: Checkpoint, out, say, problem=None):
    """Run a stage from checkpoint `at`; its optimum, the next checkpoint."""
    began, block = time.perf_counter(), setup.settings.optimize
    problem = problem or _problem(setup, number)
    at.check_fits(problem)
    if number:
        if at.iteration == 0 and "strain" in problem.limits:
            at = replace(at, strain_scale=strain_scale(problem, at.p))
        _scale(problem, at)
    bounds = problem.within(block.bounds)
    approximation = QuasiNewton(problem.metric, at.curvature)

    def note(iteration, best):
        cost, violation, error = best.trace[-1][1:]
        say(
            f"stage {number + 1}/{len(block.stages)}, iteration "
            f"{at.iteration + iteration}: cost {cost:+.4f}, violation "
            f"{violation:.1e}, error {error:.1e}, "
            f"{problem.evaluations} simulations"
        )
        if iteration and iteration % _CHECKPOINT_EVERY == 0:
            done = at.iteration + iteration
            at.after(number, done, best, approximation.matrix).write(out)

    left = max(block.stages[number].iterations - at.iteration, 0)
    best = minimise(
        problem, settle(problem, at.latest), bounds, left, block.tolerance,
        note, refining=number > 0, hessian_approximation=approximation,
        warm=None if at.barrier is None else at,
    )  # fmt: skip
    best.stage = number
    best.trace = [(at.iteration + row[0], *row[1:]) for row in best.trace]
    best.latest = (best.p, best.multipliers, WARM_BARRIER)
    following = min(number + 1, len(block.stages) - 1)
    at = at.after(following, 0, best, approximation.matrix)
    best.seconds = time.perf_counter() - began
    return best, at


def settle(problem: ShapeProblem, p: np.ndarray) -> np.ndarray:
    """The design p (P,), smoothed just enough for this mesh to simulate it.

    A design found on another mesh may invert elements of this one. Of
    increasing amounts of smoothing (a heat equation on the coefficients), the
    first is taken that keeps the elements' quality; p if none does.
    """
    H = problem.regularization(p)[2]
    eye = np.eye(len(p)) * np.abs(H).max()
    if not H.any():
        return p
    for amount in (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0):
        # Curvature about the undeformed shape, all ones.
        trial = 1.0 + np.linalg.solve(eye + amount * H, eye @ (p - 1.0))
        values = problem.constraints(trial)
        # The stage before met its limits to this tolerance only.
        if np.isfinite(values).all() and values[1] >= -FEASIBLE:
            return trial
    return p


def first_design(problem: ShapeProblem, bounds, p=None) -> np.ndarray:
    """The undeformed design, or p (P,), shrunk to meet the volume limit."""
    p, own = problem.undeformed if p is None else p, problem.spline.count
    for _ in range(60):
        if problem.deformed(p).volume <= 0.99 * problem.limits["volume"]:
            break
        p = np.concatenate([0.99 * p[:own], p[own:]])
    return np.clip(p, *bounds)


def nearest_allowed(problem: ShapeProblem, bounds, p) -> np.ndarray:
    """The design nearest to p (P,) that meets the limits on shape alone.

    Nearest in `ShapeProblem.metric`; if none is found, as near to the limits
    as SLSQP comes. A search that starts within them mostly stays there.
    """
    p, walk = np.split(p, [problem.spline.count])
    low, high = (np.broadcast_to(b, len(p) + len(walk)) for b in bounds)
    metric = problem.metric[: len(p), : len(p)]

    def limits(s):
        p = np.append(s, walk)
        return problem.shape_limits(p, problem.deformed(p))

    def away(s):
        pull = metric @ (s - p)
        return 0.5 * (s - p) @ pull, pull

    nearest = minimize(
        away, p, method="SLSQP", jac=True,
        bounds=Bounds(low[: len(p)], high[: len(p)]),
        constraints={
            "type": "ineq",
            "fun": lambda s: [value - _ROOM for _, value, _ in limits(s)],
            "jac": lambda s: [row for *_, row in limits(s)],
        },
    )  # fmt: skip
    return np.clip(np.append(nearest.x, walk), low, high)


# Thick smoothing layer for designs to start from, thin one for the points.
FRONT_STAGES = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 60),
    Stage((10, 6, 3), 72, 5e-5, 0.2, 60),
)
# Factor on a floor: the exact law with all samples gives up to 1 % less c_rot.
_AIM = 1.01
_STEADY = 1e3  # weight [rad/m²] of the paper's 2-Rot: c_rot all but alone


def pareto_front(
    setup: Setup,
    floors: Sequence[float],
    say: Callable[[str], object] | None = None,
    stages: tuple[Stage, Stage] = FRONT_STAGES,
    points: list[dict] | None = None,
) -> list[dict]:
    """Find the least c_tr for every floor (lower bound) of c_rot.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> stages = case.settings.optimize.stages * 2
    >>> (point,) = dx.soles.pareto_front(case, [0.9], stages=stages)
    >>> point["case"], point["floor"], point["failed_steps"]
    ('example', 0.9, 0)

    Args:
        setup: A case: a sole and its step.
        floors: Least values of c_rot, as ratios to the initial shape's.
        say: Called with one line of progress now and then.
        stages: One for the designs to start from, and one for every point. A
            mesh that is no brick is used as it is, whatever they say.
        points: List that is filled as points are found, so that they outlive
            an interruption.

    Returns:
        For every floor, lowest first: case, floor, c_tr [N/m] and c_rot
        [N·m/rad] by the exact law, their ratios to the initial shape's
        (ratio_tr, ratio_rot), coefficients, optimality_error, violation of
        the case's limits (not of the floor) and failed_steps. Where no design
        keeps a floor, the one of largest c_rot stands for it.

    Raises:
        InputError: The first design cannot be simulated, or floors are not
            numbers.
    """
    check_type(setup, Setup, "setup")
    if np.ndim(floors) != 1 or not np.isfinite(floors).all():
        raise InputError(f"floors are {floors}; give a list of ratios")
    say, block = say or (lambda text: None), setup.settings.optimize
    bounds = tuple(block.bounds)
    free = in_own_walk(setup).optimizing(c_rot_nm_per_rad=None)
    if not setup.mesh.is_block:
        stages = without_divisions(stages)
    brick = setup.sole(stage_mesh(setup.mesh, stages[1]))
    base = Step.of(setup, brick)

    def searched(problem, p, stage, title, approximation):
        def note(iteration, best):
            say(f"{title}, iteration {iteration}: {best.trace[-1][1]:+.4f}")

        return minimise(
            problem, p, bounds, stage.iterations, block.tolerance, note,
            hessian_approximation=approximation,
        )  # fmt: skip

    def weighing(weight: float) -> Setup:
        cost = replace(setup.settings.cost, weight=weight)
        return replace(free, settings=replace(free.settings, cost=cost))

    points, found = [] if points is None else points, []

    def sweep(own: Setup, title: str, floors) -> None:
        """Seek a point for each floor in turn, from the optimum of `own` on."""
        problem = ShapeProblem(_of_mean(own), stages[0])
        p = nearest_allowed(problem, bounds, first_design(problem, bounds))
        if problem.evaluate(p) is None:
            raise InputError(
                "the front's first design cannot be simulated; simulate the "
                "case first, or change its load, its bounds or what its shape "
                "begins within (cost.mass_limit_kg, optimize.shape)"
            )
        first = QuasiNewton(problem.metric)
        p = searched(problem, p, stages[0], title, first).p
        approximation = QuasiNewton(problem.metric)
        for floor in floors:
            problem = ShapeProblem(weighing(0.0), stages[1])
            problem.limited["c_rot"] = partial(
                rotation_limit, least=_AIM * floor * problem.first.c_rot,
                by_rot=problem.by_rot,
            )  # fmt: skip
            title = f"c_rot above {floor:.3f} of the initial shape's"
            best = searched(problem, p, stages[1], title, approximation)
            found.append(_point_of_front(problem, best, floor, base))
            p = best.p
            # Another floor's point may keep this one with less c_tr.
            points[:] = _best(found)

    sweep(free, "own optimum", sorted(floors))
    missed = [p["floor"] for p in points if not _keeps(p, p["floor"])]
    if missed:
        sweep(weighing(_STEADY), "large c_rot", missed[::-1])
    return points


def _keeps(point: dict, floor: float) -> bool:
    """Whether a design is within its limits and above a floor of c_rot."""
    return point["violation"] <= FEASIBLE and point["ratio_rot"] >= floor


def front_checks(points: Sequence[dict]) -> list[Check]:
    """Whether points of fronts simulate, and keep limits and floor."""
    return [check for point in points for check in _point_checks(point)]


def _point_checks(point: dict) -> list[Check]:
    floor, failed = point["floor"], point["failed_steps"]
    where = f"{point['case']}, floor {floor:.3f}"
    solved = Check(
        SOLVED, not failed, failed, 0, "samples", where,
        "samples that cannot be simulated",
    )  # fmt: skip
    if failed:
        return [solved]
    outside = point["violation"]
    within = Check(
        "bounds.limits", outside <= ROUNDING, outside, ROUNDING, "", where,
        "by the smoothed law the design misses a limit, or the least quality "
        "of elements, by this share; widen the case's limits, or begin with "
        "a shape that is within them",
    )  # fmt: skip
    ratio = point["ratio_rot"]
    keeps = Check(
        "bounds.c_rot", ratio >= floor, ratio, floor, "", where,
        "c_rot by the exact law, as a share of the initial shape's, is below "
        "the floor", "note",
    )  # fmt: skip
    return [solved, within, keeps]


def _best(found: list[dict]) -> list[dict]:
    """The point of least c_tr that keeps each floor, else of largest c_rot."""
    within = [point for point in found if _keeps(point, 0.0)] or found
    steadiest = max(within, key=lambda p: np.nan_to_num(p["ratio_rot"]))
    return [
        min(
            (point for point in found if _keeps(point, floor)),
            key=lambda point: point["ratio_tr"],
            default=steadiest,
        )
        | {"floor": floor}
        for floor in sorted({point["floor"] for point in found})
    ]


def _point_of_front(problem, best, floor, base: Step) -> dict:
    """A point of the front by the exact law, see `pareto_front`."""
    step = problem.step(best.p)
    values = zip(problem.names(), problem.constraints(best.p), strict=True)
    least = min(value for name, value in values if name != "c_rot")
    return {
        "case": step.setup.name,
        "floor": floor,
        "c_tr": step.c_tr,
        "c_rot": step.c_rot,
        "ratio_tr": step.c_tr / base.c_tr,
        "ratio_rot": step.c_rot / base.c_rot,
        "optimality_error": best.error,
        "violation": float(max(-least, 0.0)),
        "failed_steps": step.failed_steps,
        "coefficients": best.p,
    }
