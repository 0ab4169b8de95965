"""Phase D: time by number of movements, and random starts.

    python benchmarks/design.py STUDY.yaml CALIBRATION [--starts N] [--json]

Prints a table of problems with 3, 6 and 12 movements (one to three wearers, the
second and third drawn from the calibration's posterior), and what N random
starts within the bounds lead to. Times mean little unless the machine is idle.
"""

import argparse
import json
import resource
import time
from dataclasses import replace

import numpy as np

import drake_exo as dx
from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.wearers import Wearer, drawn
from drake_exo.designing import movements, wearer
from drake_exo.report.gathering import format_table

# Movements -> trials, wearers.
SIZES = {3: (3, 1), 6: (6, 1), 12: (4, 3)}
# Optima whose cost is within this share of the best count as the same.
_ONE = 0.01


def wearers_of(somebody: Wearer, trials: int, count: int) -> list[Wearer]:
    """The calibrated wearer and some drawn ones, in their first trials."""
    own = replace(somebody, trials=somebody.trials[:trials])
    return [own, *drawn(own, count - 1)]


def main() -> None:
    """Print table and starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study")
    parser.add_argument("calibration")
    parser.add_argument("--starts", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    study, contact = (
        dx.read_study(args.study),
        dx.read_contact(args.calibration),
    )
    settings = study.design
    who = Wearer(study.name, study.model, contact, (), device=study.device)
    somebody = wearer(study, who, movements(study, who, settings))
    rows = []
    for size, (trials, count) in SIZES.items():
        people = wearers_of(somebody, trials, count)
        today = DesignProblem.of_today(people, settings).solve()
        start, cpu = time.perf_counter(), time.process_time()
        found = DesignProblem(people, settings, today=today).solve()
        elapsed = time.perf_counter() - start
        cpu = time.process_time() - cpu
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        solution = found.solution
        rows.append(
            {
                "movements": size,
                "wearers": count,
                "iterations": solution.iterations,
                "seconds": elapsed,
                "cpu_seconds": cpu,
                "gb_so_far": memory,
                "norm_n": today.norm_n,
                "designed_norm_n": found.norm_n,
                "status": solution.status,
            }
        )
        if size == min(SIZES):
            first = people, today, found
    starts = None
    if args.starts:
        starts = random_starts(*first, settings, args.starts)
    if args.json:
        print(json.dumps({"sizes": rows, "starts": starts}, indent=2))
        return
    cells = [[str(m), str(w), *rest] for m, w, *rest in map(dict.values, rows)]
    print(format_table([k.replace("_", " ") for k in rows[0]], cells, 1))
    if starts:
        print(
            "{at_best} of {starts} random starts at one optimum (cost "
            "{best:.4g}), {solved} solved; others at {others}".format(**starts)
        )


def random_starts(people, today, found, settings, count: int) -> dict:
    """Optima that starts drawn within the bounds lead to."""
    problem = DesignProblem(people, settings, today=today)
    rng = np.random.default_rng(0)
    costs, start = [], time.process_time()
    for _ in range(count):
        values = {v.name: rng.uniform(v.lower, v.upper) for v in problem.design}
        solution = problem.solve(problem.guess(values)).solution
        costs.append(solution.objective if solution.success else np.inf)
    best = min([*costs, found.solution.objective])
    at = sum(cost <= (1.0 + _ONE) * best for cost in costs)
    solved = np.isfinite(costs).sum()
    rest = sorted(
        c for c in costs if np.isfinite(c) and c > (1.0 + _ONE) * best
    )
    return {
        "starts": count,
        "cpu_seconds": time.process_time() - start,
        "solved": int(solved),
        "at_best": int(at),
        "best": float(best),
        "others": [round(float(c), 4) for c in rest],
    }


if __name__ == "__main__":
    main()
