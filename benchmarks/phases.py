"""Build and solve times of Phases B and C1, and random starts.

    python benchmarks/phases.py [--json] [--nodes-per-second R] [--starts N]

Synthetic data (truth = model) with noise, by default of the paper's size: three
trials of 1.5 s at 200 nodes per second. Prints one row for each problem; for
random starts how many of N reach the best objective (within 1e-4 of it).
"""

import argparse
import json
import resource
import sys
from dataclasses import replace

import numpy as np

from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.files.output import Progress
from drake_exo.report.gathering import format_table
from drake_exo.virtual_laboratory.synthetic import (
    INSTRUMENT_NOISE,
    RisesInDevice,
    noisy,
    random_values,
    rises_in_device,
)

_TOLERANCE = 1e-4


def row(name: str, problem, guess=None, trials: int = 1) -> dict:
    """Solve a problem once; its row of the table."""
    result = problem.solve(guess)
    solution = result.solution
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {
        "problem": name,
        "trials": trials,
        "nodes_per_second": problem.settings.solver.nodes_per_second,
        "transcription": problem.settings.solver.transcription,
        "success": solution.success,
        "iterations": solution.iterations,
        "build_seconds": solution.seconds["build"],
        "solve_seconds": solution.seconds["solve"],
        "objective": solution.objective,
        "num_variables": solution.num_variables,
        "num_constraints": solution.num_constraints,
        "peak_memory_mb": peak,
    }


def measured(made: RisesInDevice):
    """The exact trials, with noise of instruments added."""
    return [noisy(t, k, INSTRUMENT_NOISE) for k, t in enumerate(made.trials)]


def times(made: RisesInDevice) -> list[dict]:
    """Rows of B, of C1 from a line and from data, of C2, and of comfort."""
    trials = measured(made)
    solver = Solver(made.nodes_per_second)
    settings = made.settings(noise=INSTRUMENT_NOISE, solver=solver)
    rows = [row("B", made.calibration(settings, trials), None, 3)]
    base = PredictionSettings(solver=solver)
    for name, changes, scale in (
        ("C1 from a line", {"guess": "line"}, 1.0),
        ("C1 from data", {"guess": "data"}, 1.0),
        ("C2 from a line", {"guess": "line"}, 1.4),
        ("comfort", {"objective": "comfort"}, 1.0),
    ):
        problem = made.prediction(
            replace(base, **changes), trials[0], made.contact.scaled(scale)
        )
        rows.append(row(name, problem))
    return rows


def random_starts(made: RisesInDevice, count: int) -> dict:
    """Phase B from starts anywhere inside the parameters' bounds."""
    settings = made.settings(
        noise=INSTRUMENT_NOISE, solver=Solver(made.nodes_per_second)
    )
    problem = made.calibration(settings, measured(made))
    objectives, iterations = [problem.solve().solution.objective], []
    progress = Progress("random starts", count, stream=sys.stderr)
    for k, values in enumerate(
        random_values(problem.parameters, count, seed=0)
    ):
        solution = problem.solve(problem.guess(values)).solution
        objectives.append(solution.objective if solution.success else np.inf)
        iterations.append(solution.iterations)
        progress.update(f"{objectives[-1]:.8g}", done=k + 1)
    best = min(objectives)
    return {
        "problem": "B from random starts",
        "nodes_per_second": made.nodes_per_second,
        "starts": count,
        "reached": int(
            sum(o <= best * (1 + _TOLERANCE) for o in objectives[1:])
        ),
        "best_objective": best,
        "from_data": objectives[0],
        "median_iterations": float(np.median(iterations)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--nodes-per-second", type=float, default=200.0)
    parser.add_argument("--starts", type=int, default=0)
    parser.add_argument("--start-nodes-per-second", type=float, default=50.0)
    args = parser.parse_args()
    rows = times(rises_in_device(nodes_per_second=args.nodes_per_second))
    if args.starts:
        coarse = rises_in_device(nodes_per_second=args.start_nodes_per_second)
        rows.append(random_starts(coarse, args.starts))
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    keys = ("iterations", "build_seconds", "solve_seconds", "peak_memory_mb")
    print(
        format_table(
            ["problem", *keys],
            [[r["problem"], *(r.get(k) for k in keys)] for r in rows],
        )
    )
    if args.starts:
        print(f"{rows[-1]['reached']} of {args.starts} reached one optimum")


if __name__ == "__main__":
    main()
