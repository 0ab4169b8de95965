"""The front of c_tr against c_rot: least c_tr for floors of c_rot.

An epsilon-constraint: c_tr alone is minimised under c_rot >= floor, from the
lowest floor to the highest. The first point starts from the case's own
optimum, each further one from the point before, with what was learnt of the
curvature. On the coarse mesh with a few samples, verified by the exact law
there with all samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from drake_exo.errors import InputError
from drake_exo.soles.optimize.optimizer import QuasiNewton, minimise
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
    Stage((10, 6, 3), 72, 5e-5, 0.2, 60),
)
# Above the floor: the exact law with all samples has a c_rot up to 1 % lower.
_AIM = 1.01


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
    bounds, free = tuple(block.bounds), setup.optimizing(c_rot_nm_per_rad=None)
    brick = setup.sole(stage_mesh(setup.mesh, stages[1]))
    base = Step.by_exact_law(setup, brick, brick.penalty)

    def found(problem, p, stage, title, approximation):
        def note(iteration, best):
            say(f"{title}, iteration {iteration}: {best.trace[-1][1]:+.4f}")

        return minimise(
            problem, p, bounds, stage.iterations, block.tolerance, note,
            hessian_approximation=approximation,
        )  # fmt: skip

    problem = stage_problem(free, stages[0])
    p = first_design(problem, bounds)
    if problem.evaluate(p) is None:
        raise InputError(
            "the front's first design cannot be simulated; simulate the case "
            "first, or change its load or its bounds"
        )
    own = QuasiNewton(problem.metric)
    p = found(problem, p, stages[0], "own optimum", own).p
    cost = replace(setup.settings.cost, weight=0.0)
    alone = replace(free, settings=replace(free.settings, cost=cost))
    points, approximation = [], QuasiNewton(problem.metric)
    for floor in sorted(floors):
        problem = stage_problem(alone, stages[1])
        problem.add_rotation_floor(_AIM * floor * problem.first.c_rot)
        title = f"c_rot above {floor:.3f} of the brick's"
        best = found(problem, p, stages[1], title, approximation)
        points.append(_verify(setup, problem, best, floor, base))
        p = best.p
    return points


def _verify(setup: Setup, problem, best, floor, base: Step) -> dict:
    sole = setup.sole(problem.deformed(best.p))
    step = Step.by_exact_law(setup, sole, problem.law.penalty)
    return {
        "case": setup.name,
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
