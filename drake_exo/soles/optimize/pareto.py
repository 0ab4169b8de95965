"""The front of c_tr against c_rot: least c_tr for floors of c_rot.

An epsilon-constraint: c_tr alone is minimised under c_rot >= floor, from the
lowest floor to the highest. The first point starts from the case's own
optimum, each further one from the point before, with what was learnt of the
curvature. On the coarse mesh with a few samples, verified by the exact law
there with all samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drake_exo.errors import InputError
from drake_exo.soles.optimize.design import by_exact_law
from drake_exo.soles.optimize.optimizer import (
    Optimum,
    QuasiNewton,
    WarmStart,
    cost_and_violation,
    minimise,
)
from drake_exo.soles.optimize.search import (
    first_design,
    stage_mesh,
    stage_problem,
)
from drake_exo.soles.settings import Setup, Stage
from drake_exo.soles.step.results import Step

# A thick layer for the case's own optimum, then a thin one for all points.
STAGES = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 60),
    Stage((10, 6, 3), 72, 5e-5, 0.2, 40),
)
# Of a floor that the exact law misses or overshoots, and by how much it may.
_CORRECTIONS, _OVERSHOOT = 2, 1.005
_FEASIBLE = 1e-3  # a point is worked on until its violation is below
_AIM = 1.002  # above the floor
_LEAP = 0.25  # of the initial shape's c_rot at a time


def pareto_front(
    setup: Setup,
    floors: Sequence[float],
    say: Callable[[str], object] | None = None,
    stages: tuple[Stage, Stage] = STAGES,
) -> list[dict]:
    """Least c_tr for every floor of c_rot, lowest first.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> stages = case.settings.optimize.stages * 2
    >>> (point,) = dx.soles.pareto_front(case, [0.9], stages=stages)
    >>> point["case"], point["floor"], point["failed_steps"]
    ('example', 0.9, 0)

    Args:
        setup: A sole and its step.
        floors: Of c_rot, over the initial shape's.
        say: Called with one line of progress now and then.
        stages: For the case's own optimum, and for every point.

    Returns:
        For every floor: case, floor, c_tr [N/m], c_rot [N·m/rad] and their
        ratios to the initial shape's by the exact law, ratio_tr and
        ratio_rot; coefficients; optimality_error; violation; failed_steps.

    Raises:
        InputError: The first design cannot be simulated.
    """
    say, block = say or (lambda text: None), setup.settings.optimize
    base = _initial(setup, stages[1])
    at = _solve(
        stage_problem(_without_floor(setup), stages[0]),
        None, block, stages[0].iterations,
        lambda iteration, best: say(
            f"own optimum, iteration {iteration}: c/|c0| "
            f"{best.trace[-1][1]:+.4f}"
        ),
    )  # fmt: skip
    points, margin = [], _AIM
    for floor in sorted(floors):

        def note(iteration, best, floor=floor):
            say(
                f"c_rot above {floor:.3f} of the brick's, iteration "
                f"{iteration}: c_tr {best.trace[-1][1]:.4f} of the brick's"
            )

        tried, iterations = [], stages[1].iterations
        for _ in range(_CORRECTIONS + 1):
            for aim in _steps(at.ratio, floor * margin):
                problem = _problem(setup, stages[1], aim)
                at = _solve(problem, at, block, iterations, note)
            tried.append(_verify(setup, problem, at.best, floor, base))
            ratio = tried[-1]["ratio_rot"]
            held = at.ratio < _OVERSHOOT * floor * margin
            over = held and ratio > _OVERSHOOT * floor
            if over or ratio < floor:
                # The smoothed law on fewer samples takes c_rot for another.
                margin *= _AIM * floor / ratio
            elif tried[-1]["violation"] < _FEASIBLE or np.isnan(ratio):
                break
            iterations = stages[1].iterations // 2
        points.append(min(tried, key=_rank))
    return points


def _rank(point: dict) -> tuple:
    """Within all limits and above its floor first, then by c_tr."""
    outside = not point["violation"] <= _FEASIBLE
    below = not point["ratio_rot"] >= point["floor"]
    return below, outside, point["ratio_tr"]


def _problem(setup: Setup, stage: Stage, floor: float):
    """c_tr alone with c_rot at least `floor` times the initial shape's.

    The floor is in the smoothed measures of this very problem.
    """
    alone = _without_floor(setup)
    cost = replace(alone.settings.cost, weight=0.0)
    alone = replace(alone, settings=replace(alone.settings, cost=cost))
    problem = stage_problem(alone, stage)
    problem.add_rotation_floor(floor * problem.first.c_rot)
    return problem


def _without_floor(setup: Setup) -> Setup:
    return setup.optimizing(c_rot_nm_per_rad=None)


def _steps(reached: float, floor: float) -> np.ndarray:
    """Floors on the way up, none a long leap."""
    count = max(1, int(np.ceil((floor - reached) / _LEAP)))
    return np.linspace(min(reached, floor), floor, count + 1)[1:]


@dataclass
class _At:
    """Where the continuation stands."""

    best: Optimum
    hessian_approximation: QuasiNewton
    ratio: float  # c_rot over the initial shape's, smoothed law


def _solve(problem, at: _At | None, block, iterations, say) -> _At:
    bounds = tuple(block.bounds)
    if at is None:
        p, warm = first_design(problem, bounds), None
        approximation = QuasiNewton(len(p))
    else:
        p, approximation = at.best.p, at.hessian_approximation
        warm = None
        if len(at.best.multipliers) == len(problem.names()):
            warm = WarmStart(at.best.multipliers, *at.best.at_bounds)
    best = minimise(
        problem, p, bounds, iterations, block.tolerance, say,
        refining=at is not None, hessian_approximation=approximation,
        warm=warm,
    )  # fmt: skip
    found = problem.evaluate(best.p)
    if found is None:
        if at is None:
            raise InputError(
                "the front's first design cannot be simulated; simulate the "
                "case first, or change its load or its bounds"
            )
        return at  # what stands stays
    ratio = found.c_rot / problem.first.c_rot
    return _At(best, approximation, ratio)


def _initial(setup: Setup, stage: Stage) -> Step:
    """The initial shape on the front's mesh, exact law."""
    sole = setup.sole(stage_mesh(setup.mesh, stage))
    return Step.by_exact_law(setup, sole, sole.penalty)


def _verify(setup: Setup, problem, best, floor, base: Step) -> dict:
    p, step = by_exact_law(setup, problem, best.p, best.former)
    violation = best.violation
    if p is not best.p:
        violation = cost_and_violation(problem, p)[1]
    return {
        "case": setup.name,
        "floor": floor,
        "c_tr": step.c_tr,
        "c_rot": step.c_rot,
        "ratio_tr": step.c_tr / base.c_tr,
        "ratio_rot": step.c_rot / base.c_rot,
        "optimality_error": best.error,
        "violation": violation,
        "failed_steps": step.failed_steps,
        "coefficients": p,
    }
