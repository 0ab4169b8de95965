"""The search for a shape: several starts, then stage by stage.

After each stage but the last the better half of the starts goes on (successive
halving: Jamieson and Talwalkar, AISTATS 2016). Starts are compared by their
cost on a finer mesh: a gain that a design owes to the elements of its own mesh
does not survive there. Where a walk is free, this search finds the sole for the
case's own walk. From that sole, sole and walk then move together from several
walks, and the best of these goes on. Ctrl-C leaves the best so far on disk.

The front minimises c_tr alone under c_rot >= floor, from the lowest floor to
the highest. The first point begins at the case's own optimum, each further one
at the point before, with what was learnt of the curvature.
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

from drake_exo.errors import InputError
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
from drake_exo.soles.settings import Setup, Stage, stage_mesh
from drake_exo.soles.walking_pattern import Robot

_CHECKPOINT_EVERY = 3  # iterations
_WALKS = 4  # that are tried for each start
_BEND, _WAVES = 0.03, 4  # of smooth random starts: size, waves along an axis
# Of the strain that is allowed: what a stage changes, its scale does not know.
_STRAIN_AIM = 0.98
_ROOM = 0.01  # of limits at the start
# Bends drawn until one can be simulated, then smaller ones.
_TRIES, _SIZES = 20, (1.0, 0.5, 0.25)


@dataclass
class Found:
    """What a search has come to from one start, or from the best.

    Attributes:
        optima: Of the stages so far.
        at: Where it stands.
        seconds: What they took, in the end those of all starts.
        start: Its number.
        alone: Of a walk that is sought what the sole alone has come to; None
            where an interrupted run knows no more than its coefficients.
    """

    optima: list[Optimum]
    at: Checkpoint | None
    seconds: float = 0.0
    start: int = 0
    alone: "Found | None" = None

    @property
    def stage(self) -> int:
        """That it goes on with."""
        return self.optima[-1].stage + 1 if self.optima else self.at.stage

    @property
    def rank(self) -> tuple:
        """Those that went further first, then by their newest optimum."""
        return -self.stage, *self.optima[-1].rank

    def after(self, best: Optimum, at: Checkpoint) -> "Found":
        """One stage further."""
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
    """Run the case's stages, as `Case.optimize` says.

    While starts, or walks, are tried each has a folder below `out`; `bends` is
    the shape of each start, see `start_design`, by default the brick and the
    first bends.
    """
    began = time.perf_counter()
    if resume is not None:  # it may end before there is another checkpoint
        for start, begun in enumerate(resume.begun):
            if begun is not None:
                _keep(begun, start_folder(out, start))
        if resume.p is not None:
            _keep(resume, out)
    jobs = search_jobs(setup, out, resume, bends)

    def end(row: Ended) -> None:
        if row.state == "lost":
            raise InputError(
                "optimize.starts: the process of a start was killed, perhaps "
                "for want of memory; go on (resume) with one start at a time"
            )
        row.result()

    with TemporaryDirectory() as logs:
        # Where none run side by side, no other process is needed.
        widest = max(Counter(job.needs for job in jobs).values())
        if min(at_once, widest) == 1:
            jobs, pool = [job.told(say=say) for job in jobs], Here()
        else:
            jobs, pool = logged(jobs, Path(logs)), Processes(at_once)
        with pool:
            ended = run_jobs(jobs, pool, end, Heard(say))
    design = finished(setup, ended[jobs[-1].name].value, say)
    design.seconds = time.perf_counter() - began
    return design


def search_jobs(
    setup: Setup,
    out: Path | None,
    resume: Checkpoint | None = None,
    bends: Sequence[int] | None = None,
    name: str = "",
) -> list[Job]:
    """The stages of a case as jobs, the last of which returns what is `Found`.

    Each takes an argument `say` more, called with one line of progress now
    and then; `name` begins their names, the others are those of `optimise`.
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
    """One of the stages but the last (`number`, from 0), from a start.

    `place` is the start's after the stage before, `begun` where it was
    interrupted, if it was, `before` what jobs of earlier stages returned.
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
    """The last stage but one, from the sole alone in one of several walks.

    Sole and walk move together. `before` is what the sole alone has come to,
    or else `at` has it; `begun` is where the walk was interrupted, if it was.
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
    """All starts, as far as they went."""
    return list({racer.start: racer for racer in before.values()}.values())


def go_on(
    setup: Setup, out, at: Checkpoint, say, before=(), is_alone: bool = False
) -> Found:
    """The stages that are left to a checkpoint, or to the best of a race.

    What they come to is the sole alone of a walk that is sought, `is_alone`.
    """
    prefix = "sole alone, " if is_alone else ""
    found = Found([], at)
    if before:
        racers = _racers(before)
        best = min(racers, key=lambda racer: racer.rank)
        at = replace(best.at, starts=tuple(r.at.starts[-1] for r in racers))
        seconds = sum(racer.seconds for racer in racers)
        found = Found(best.optima, at, seconds, alone=best.alone)
        _keep(at, out)
        if out is not None:
            for racer in racers:
                folder = start_folder(out, racer.start)
                shutil.rmtree(folder, ignore_errors=True)
    for number in range(found.stage, len(setup.settings.optimize.stages)):
        ended = _run_stage(
            setup, number, found.at, out, lambda line: say(prefix + line)
        )
        found = found.after(*ended)
        _keep(found.at, out)
    if is_alone:
        found.at = replace(found.at, alone=found.at.p)
        _keep(found.at, out)
    return found


def finished(setup: Setup, found: Found, say) -> Design:
    """The design of a search; with its walk, where that is free."""
    began, design = time.perf_counter(), _verified(setup, found)
    if setup.gait:
        design = _with_walk(setup, design, found)
    design.seconds = found.seconds + time.perf_counter() - began
    return design


def _verified(setup: Setup, found: Found) -> Design:
    """Where a search stands, beside the limits of its last stage."""
    stages = setup.settings.optimize.stages
    problem = ShapeProblem(setup, stages[-1])
    if len(stages) > 1:
        _scale(problem, found.at)
    seconds = [best.seconds for best in found.optima]
    return verified(setup, problem, found.at, found.optima, seconds)


def in_own_walk(setup: Setup) -> Setup:
    """Nothing of its walk is free."""
    return _walking(setup, setup.gait.robot) if setup.gait else setup


def _walking(setup: Setup, robot: Robot) -> Setup:
    """What is planned is this walk, whatever was free; the load stays."""
    load = replace(setup.settings.load, pattern=replace(robot, free=()))
    return replace(setup, settings=replace(setup.settings, load=load))


def _with_walk(setup: Setup, design: Design, found: Found) -> Design:
    """Told what has become of its walk, and of the sole alone.

    That is the design where it is no worse: within its limits first, then by c.
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
    # The case that is written has the samples that the search had.
    walk = replace(
        robots[1],
        period_s=gait.robot.period_s * spans[1] / spans[0],
        first_s=float(design.setup.load.times[0]),
    )
    design.setup = _walking(design.setup, walk)
    return design


def from_start(
    setup: Setup, bend: int, number: int, at, out, say
) -> tuple[Optimum, Checkpoint]:
    """A stage from one start, see `start_design`; where to go on.

    `at` is where it stands, None to begin; `out` a folder for its
    checkpoint, None for none.
    """
    began, block = time.perf_counter(), setup.settings.optimize
    rows = {} if at is None else {r.get("stage", 1): r for r in at.starts}
    if row := rows.get(number + 1):
        # Finished before an interruption.
        done = Optimum(
            at.p, row["cost"], violation=row["violation"], stage=number,
            multipliers=at.multipliers, cost_finer=row.get("cost_finer"),
        )  # fmt: skip
        return done, at
    problem = ShapeProblem(setup, block.stages[number])
    if at is None:
        bounds = problem.within(block.bounds)
        p = nearest_allowed(
            problem, bounds, start_design(problem, bounds, bend)
        )
        at = Checkpoint(p=p, latest=p, case=setup.name, key=setup.key)
    best, at = _run_stage(setup, number, at, out, say, problem)
    # Outside of their limits they are compared by how far.
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
    _keep(at, out)
    return best, at


def start_design(problem: ShapeProblem, bounds, bend: int) -> np.ndarray:
    """The brick (bend 0) or a smooth random bend of it, within the volume."""
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


def _keep(at: Checkpoint, out: Path | None) -> None:
    if out is not None:
        at.write(out)


def strain_scale(problem: ShapeProblem, p: np.ndarray) -> float:
    """Largest strain of a design over the norm that stands for it.

    By the exact law with all samples: the norm is of all strains, of some
    samples and of a smoothed law (adaptive scaling, as Le, Norato, Bruns, Ha
    and Tortorelli 2010 have it for stresses). 1 where one cannot be simulated.
    """
    e = problem.evaluate(p)
    if e is None:
        return 1.0
    step = problem.step(p)
    if step.failed_steps:
        return 1.0
    return step.largest_strain / e.strain.value


def _scale(problem: ShapeProblem, at: Checkpoint) -> None:
    """Limit the norm of strains as it stands for the largest one."""
    if "strain" in problem.limits:
        largest = _STRAIN_AIM * problem.limits["strain"] / at.strain_scale
        problem.limited["strain"] = partial(strain_limit, largest=largest)


def _run_stage(setup: Setup, number, at: Checkpoint, out, say, problem=None):
    """One stage from where it stands; the optimum, where to go on."""
    began, block = time.perf_counter(), setup.settings.optimize
    problem = problem or ShapeProblem(setup, block.stages[number])
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
            f"{at.iteration + iteration}: c/|c0| {cost:+.4f}, violation "
            f"{violation:.1e}, error {error:.1e}, "
            f"{problem.evaluations} simulations"
        )
        if iteration and iteration % _CHECKPOINT_EVERY == 0:
            done = at.iteration + iteration
            _keep(at.after(number, done, best, approximation.matrix), out)

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
    """The design, smoothed until this mesh can carry it.

    Elements that another mesh resolved may be inverted in this one; the
    least smoothing that leaves them room and lets the step be simulated is
    taken (a heat equation on the coefficients).
    """
    H = problem.regularization(p)[2]
    eye = np.eye(len(p)) * np.abs(H).max()
    if not H.any():
        return p
    for amount in (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0):
        # Curvature about the undeformed shape, all ones.
        trial = 1.0 + np.linalg.solve(eye + amount * H, eye @ (p - 1.0))
        values = problem.constraints(trial)
        # The optimum of the stage before is one to this tolerance.
        if np.isfinite(values).all() and values[1] >= -FEASIBLE:
            return trial
    return p


def first_design(problem: ShapeProblem, bounds, p=None) -> np.ndarray:
    """All coefficients one, or p, shrunk until the volume limit is met."""
    p, own = problem.undeformed if p is None else p, problem.spline.count
    for _ in range(60):
        if problem.deformed(p).volume <= 0.99 * problem.limits["volume"]:
            break
        p = np.concatenate([0.99 * p[:own], p[own:]])
    return np.clip(p, *bounds)


def nearest_allowed(problem: ShapeProblem, bounds, p) -> np.ndarray:
    """The nearest design within the limits that take no simulation.

    In the metric of shapes; where none is found, as near to them as it comes.
    A search that begins within them mostly stays there.
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


# A thick layer for the case's own optimum, then a thin one for all points.
FRONT_STAGES = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 60),
    Stage((10, 6, 3), 72, 5e-5, 0.2, 60),
)
# Above the floor: the exact law with all samples has a c_rot up to 1 % lower.
_AIM = 1.01


def pareto_front(
    setup: Setup,
    floors: Sequence[float],
    say: Callable[[str], object] | None = None,
    stages: tuple[Stage, Stage] = FRONT_STAGES,
    points: list[dict] | None = None,
) -> list[dict]:
    """Find the least c_tr above every floor of c_rot, lowest floor first.

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
        stages: One for the case's own optimum, and one for every point. A
            mesh that is no brick is used as it is, whatever they say.
        points: List to fill as points are found, so that an interrupted
            search leaves them.

    Returns:
        For every floor: case, floor, c_tr [N/m] and c_rot [N·m/rad] by the
        exact law, their ratios to the initial shape's (ratio_tr and
        ratio_rot), coefficients, optimality_error, violation and
        failed_steps.

    Raises:
        InputError: The first design cannot be simulated.
    """
    say, block = say or (lambda text: None), setup.settings.optimize
    bounds = tuple(block.bounds)
    free = in_own_walk(setup).optimizing(c_rot_nm_per_rad=None)
    if not setup.mesh.is_block:
        stages = tuple(replace(s, divisions=None) for s in stages)
    brick = setup.sole(stage_mesh(setup.mesh, stages[1]))
    base = Step.by_exact_law(setup, brick, brick.penalty)

    def searched(problem, p, stage, title, approximation):
        def note(iteration, best):
            say(f"{title}, iteration {iteration}: {best.trace[-1][1]:+.4f}")

        return minimise(
            problem, p, bounds, stage.iterations, block.tolerance, note,
            hessian_approximation=approximation,
        )  # fmt: skip

    problem = ShapeProblem(free, stages[0])
    p = nearest_allowed(problem, bounds, first_design(problem, bounds))
    if problem.evaluate(p) is None:
        raise InputError(
            "the front's first design cannot be simulated; simulate the case "
            "first, or change its load or its bounds"
        )
    own = QuasiNewton(problem.metric)
    p = searched(problem, p, stages[0], "own optimum", own).p
    cost = replace(setup.settings.cost, weight=0.0)
    alone = replace(free, settings=replace(free.settings, cost=cost))
    points, found = [] if points is None else points, []
    approximation = QuasiNewton(problem.metric)
    for floor in sorted(floors):
        problem = ShapeProblem(alone, stages[1])
        problem.limited["c_rot"] = partial(
            rotation_limit, least=_AIM * floor * problem.first.c_rot,
            by_rot=problem.by_rot,
        )  # fmt: skip
        title = f"c_rot above {floor:.3f} of the brick's"
        best = searched(problem, p, stages[1], title, approximation)
        found.append(_point_of_front(problem, best, floor, base))
        p = best.p
        # What keeps a floor, or more of c_rot, is a point for any other.
        points[:] = [_best(found, own) for own in found]
    return points


def _best(found: list[dict], own: dict) -> dict:
    """Of least c_tr among those that keep a point's floor, or its c_rot."""
    least = min(own["floor"], own["ratio_rot"])  # the floor, where that is NaN
    able = [point for point in found if point["ratio_rot"] >= least]
    best = min(able, key=lambda point: point["ratio_tr"], default=own)
    return best | {"floor": own["floor"]}


def _point_of_front(problem, best, floor, base: Step) -> dict:
    """What front.json says of a point, by the exact law."""
    step = problem.step(best.p)
    return {
        "case": step.setup.name,
        "floor": floor,
        "c_tr": step.c_tr,
        "c_rot": step.c_rot,
        "ratio_tr": step.c_tr / base.c_tr,
        "ratio_rot": step.c_rot / base.c_rot,
        "optimality_error": best.error,
        "violation": best.violation,
        "failed_steps": step.failed_steps,
        "coefficients": best.p,
    }
