"""The front of c_tr against c_rot: least c_tr for floors of c_rot.

An epsilon-constraint: c_tr alone is minimised under c_rot >= floor, from the
lowest floor to the highest. The first point starts from the case's own
optimum, each further one from the point before, with what was learnt of the
curvature. On the coarse mesh with a few samples, judged by the exact law there
with all samples.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import (
    Progress,
    prepare_output_folder,
    read_json,
    write_json,
)
from drake_exo.papers.de_magistris_cases import TABLE_2
from drake_exo.soles.case import Case, Stage, open_case
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.optimize import design as designs
from drake_exo.soles.optimize.optimizer import (
    Optimum,
    QuasiNewton,
    WarmStart,
    merits,
    minimise,
)
from drake_exo.soles.optimize.verification import by_exact_law, exact_history

# A thick layer for the case's own optimum, then a thin one for all points.
STAGES = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 60),
    Stage((10, 6, 3), 72, 5e-5, 0.2, 40),
)
# Of a floor that the exact law misses or overshoots, and by how much it may.
_CORRECTIONS, _OVERSHOOT = 2, 1.005
_FEASIBLE = 1e-3  # a point is worked on until its violation is below
_AIM = 1.002  # above the floor
_LEAP = 0.25  # of the brick's c_rot at a time
# Of a study: where a case's points are, and the case with the whole front.
_FILE, _WHOLE = "front.json", "1-Ref"
_ROUGHNESS = 3.0  # of single points: their designs bend but once
# Floors over the brick's c_rot; the first is the paper's 1-Ref.
FLOORS = (0.9721, 1.1, 1.2, 1.3, 1.4, 1.55, 1.7, 1.85)


def run_front(args) -> int:
    """`drake-exo sole front CASE.yaml`; 0 where every point simulates."""
    case, load, own, start = open_case(args.case, args.data_root, args.mesh)
    if args.limits == "none":
        case = designs.without_limits(case)
    with prepare_output_folder(args.out, args.force) as out:
        points = front(case, load, own, start, FLOORS)
        _write(out, case, points)
    print(table(points))
    print(f"{case.name}: results in {args.out}")
    return 1 if any(p["failed_steps"] for p in points) else 0


def study_job(folder: Path, case: Case, root: Path, mesh_file) -> None:
    """Write a case's part of a study: front.json.

    The front of 1-Ref; of every other case the paper's own ratio.
    """
    tr0, tr, rot0, rot = TABLE_2[case.name]
    floors = FLOORS
    if case.name != _WHOLE:
        floors = (rot / rot0,)
        block = replace(case.optimize, roughness=_ROUGHNESS)
        case = replace(case, optimize=block)
    points = front(case, *case.open(root, mesh_file), floors)
    points[0]["paper_ratio_tr"] = tr / tr0
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / _FILE, points)


def study_front(folder: Path, cases: list[Case]) -> dict:
    """The points on disk: those of 1-Ref, the first of every case."""
    found = {"points": [], "at_paper": []}
    for case in cases:
        file = folder / case.name / _FILE
        if not file.is_file():
            continue
        points = read_json(file, "run the study again")
        if case.name == _WHOLE:
            found["points"] = points
        found["at_paper"] += points[:1]
    return found


def front(
    case: Case, load: Load, own: TetMesh, start: Start, floors
) -> list[dict]:
    """Least c_tr for every floor of c_rot (over the brick's), lowest first.

    Returns:
        For every floor: floor, c_tr, c_rot and their ratios to the brick's,
        by the exact law; optimality_error; failed_steps.
    """
    base = _brick(case, own, load, start)
    progress = Progress(f"{case.name}, front", interval_seconds=2.0)
    at = _solve(
        designs.stage_problem(
            _without_floor(case), own, load, start, STAGES[0]
        ),
        None, case.optimize, STAGES[0].iterations,
        lambda iteration, best: progress.update(
            f"own optimum, iteration {iteration}: c/|c0| "
            f"{best.trace[-1][1]:+.4f}"
        ),
    )  # fmt: skip
    points, margin = [], _AIM
    for floor in sorted(floors):

        def say(iteration, best, floor=floor):
            progress.update(
                f"c_rot above {floor:.3f} of the brick's, iteration "
                f"{iteration}: c_tr {best.trace[-1][1]:.4f} of the brick's"
            )

        tried, iterations = [], STAGES[1].iterations
        for _ in range(_CORRECTIONS + 1):
            for aim in _steps(at.ratio, floor * margin):
                problem = _problem(case, own, load, start, aim)
                at = _solve(problem, at, case.optimize, iterations, say)
            tried.append(
                _judge(case, problem, at.best, floor, base, load, start)
            )
            ratio = tried[-1]["ratio_rot"]
            held = at.ratio < _OVERSHOOT * floor * margin
            over = held and ratio > _OVERSHOOT * floor
            if over or ratio < floor:
                # The smoothed law on fewer samples takes c_rot for another.
                margin *= _AIM * floor / ratio
            elif tried[-1]["violation"] < _FEASIBLE or np.isnan(ratio):
                break
            iterations = STAGES[1].iterations // 2
        points.append(min(tried, key=_rank))
    return points


def _rank(point: dict) -> tuple:
    """Within all limits and above its floor first, then by c_tr."""
    outside = not point["violation"] <= _FEASIBLE
    below = not point["ratio_rot"] >= point["floor"]
    return below, outside, point["ratio_tr"]


def _problem(case, own, load, start, floor):
    """c_tr alone with c_rot at least `floor` times the brick's.

    The floor is in the smoothed measures of this very problem.
    """
    alone = replace(_without_floor(case), cost=replace(case.cost, weight=0.0))
    problem = designs.stage_problem(alone, own, load, start, STAGES[1])
    problem.add_rotation_floor(floor * problem.first.c_rot)
    return problem


def _without_floor(case: Case) -> Case:
    block = replace(case.optimize, c_rot_nm_per_rad=None)
    return replace(case, optimize=block)


def _steps(reached: float, floor: float) -> np.ndarray:
    """Floors on the way up, none a long leap."""
    count = max(1, int(np.ceil((floor - reached) / _LEAP)))
    return np.linspace(min(reached, floor), floor, count + 1)[1:]


@dataclass
class _At:
    """Where the continuation stands."""

    best: Optimum
    learnt: QuasiNewton
    ratio: float  # c_rot over the brick's, smoothed law


def _solve(problem, at: _At | None, block, iterations, say) -> _At:
    bounds = tuple(block.bounds)
    if at is None:
        p, warm = designs.first_design(problem, bounds), None
        learnt = QuasiNewton(len(p))
    else:
        p, learnt = at.best.p, at.learnt
        warm = None
        if len(at.best.multipliers) == len(problem.names()):
            warm = WarmStart(at.best.multipliers, *at.best.at_bounds)
    best = minimise(
        problem, p, bounds, iterations, block.tolerance, say,
        refining=at is not None, learnt=learnt, warm=warm,
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
    return _At(best, learnt, ratio)


def _brick(case, own, load, start):
    """c_tr and c_rot of the initial shape on the front's mesh, exact law."""
    mesh = designs.stage_mesh(case, own, STAGES[-1])
    sole = Sole(mesh, case.material.material(), case.mesh.element)
    history = exact_history(case, sole, load, start, sole.penalty)
    return history.costs(0.0, case.cost.heel_strike_fraction)[:2]


def _judge(case, problem, best, floor, base, load, start) -> dict:
    p, _, history = by_exact_law(
        case, problem, load, start, best.p, best.former
    )
    violation = best.violation if p is best.p else merits(problem, p)[1]
    c_tr, c_rot, _ = history.costs(0.0, case.cost.heel_strike_fraction)
    return {
        "case": case.name,
        "floor": floor,
        "c_tr": c_tr,
        "c_rot": c_rot,
        "ratio_tr": c_tr / base[0],
        "ratio_rot": c_rot / base[1],
        "optimality_error": best.error,
        "violation": violation,
        "failed_steps": history.failed_steps,
        "coefficients": p,
    }


def table(points: list[dict]) -> str:
    """One line for every point."""
    lines = [
        f"{'case':11s} {'floor':>6s} {'c_tr':>9s} {'ratio':>6s} "
        f"{'paper':>6s} {'c_rot':>9s} {'ratio':>6s} {'error':>8s}"
    ]
    lines += [
        f"{p['case']:11s} {p['floor']:6.3f} {p['c_tr']:9.2e} "
        f"{p['ratio_tr']:6.3f} {_paper(p):6s} {p['c_rot']:9.2e} "
        f"{p['ratio_rot']:6.3f} {p['optimality_error']:8.1e}"
        for p in points
    ]
    return "\n".join(lines)


def _paper(point: dict) -> str:
    ratio = point.get("paper_ratio_tr")
    return "" if ratio is None else f"{ratio:6.3f}"


def _write(out: Path, case: Case, points: list[dict]) -> None:
    from drake_exo.papers.de_magistris_pictures import front_figure

    write_json(out / "summary.json", {"name": case.name, "front": points})
    front_figure(out / "front.png", [], {}, {"front": points})
