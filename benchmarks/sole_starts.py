"""How far the optimum of a sole depends on where the search starts.

Random feasible shapes (smooth, within bounds and volume), case 1-Ref without
limits as in the paper, coarse mesh, thick layer then thinner. Prints the
spread of the optima.

python benchmarks/sole_starts.py [--json] [--data-root DIR] [--starts 10]
    [--iterations 60] [--workers N]
"""

import argparse
import json
import os
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drake_exo.batch.jobs import run_calls
from drake_exo.papers.de_magistris import five_cases, step_block
from drake_exo.soles.optimize.optimizer import QuasiNewton, WarmStart, minimise
from drake_exo.soles.optimize.search import stage_problem, start_design
from drake_exo.soles.settings import Setup, Stage

STAGES = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 60),
    Stage((10, 6, 3), 24, 1e-4, 0.2, 30),
)


@cache
def setup_of(root):
    """Case 1-Ref without limits, coarse."""
    settings = five_cases(step_block(root), coarse=True)[0]
    return Setup.open(settings, root).without_limits()


def optimum(root, start, iterations):
    """Cost, errors and ratios from one start.

    Args:
        root: of the data.
        start: design.
        iterations: at most in a stage.
    """
    setup = setup_of(root)
    bounds = tuple(setup.settings.optimize.bounds)
    p = np.array(start)
    approximation = warm = begun = None
    for stage in STAGES:
        problem = stage_problem(setup, stage)
        if begun is None:
            begun = problem.cost(p)
            approximation = QuasiNewton(problem.metric)
        found = minimise(
            problem, p, bounds, min(stage.iterations, iterations),
            hessian_approximation=approximation, warm=warm,
        )  # fmt: skip
        if not np.isfinite(found.cost):  # the thinner law does not carry it
            break
        best, p = found, found.p
        warm = WarmStart(best.multipliers, *best.at_bounds)
        e, first = problem.evaluate(p), problem.first
    return {
        "start_cost": begun,
        "cost": best.cost,
        "optimality_error": best.error,
        "ratio_tr": e.c_tr / first.c_tr,
        "ratio_rot": e.c_rot / first.c_rot,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--data-root", type=Path)
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--iterations", type=int, default=60)
    args = parser.parse_args()
    root = args.data_root or Path(".")
    setup = setup_of(root)
    bounds = tuple(setup.settings.optimize.bounds)
    problem = stage_problem(setup, STAGES[0])
    calls = [
        {
            "root": root,
            "start": start_design(problem, bounds, k).tolist(),
            "iterations": args.iterations,
        }
        for k in range(1, args.starts + 1)
    ]

    def tell(row):
        text = ", ".join(
            f"{n} {'-' if v is None else format(v, '.4g')}"
            for n, v in row.items()
        )
        print(text, flush=True)

    rows = run_calls(
        optimum, calls, args.workers, "starts", None if args.json else tell
    )
    costs = np.array([row["cost"] for row in rows])
    spread = {
        "least": costs.min(), "median": np.median(costs),
        "largest": costs.max(), "deviation": costs.std(),
    }  # fmt: skip
    if args.json:
        print(json.dumps({"starts": rows, "cost": spread}, indent=2))
        return
    print("cost: " + ", ".join(f"{n} {v:.4g}" for n, v in spread.items()))


if __name__ == "__main__":
    main()
