"""How far the optimum of a sole depends on where the search starts.

The case 1-Ref with all limits is searched several times, as `sole optimize`
does, from three starts: the brick and two smooth random bends of it, different
ones each time; with --bends three bends. Prints each optimum's c relative to
the brick's (same mesh, exact law), and how far the best and the worst are
apart.

python benchmarks/sole_starts.py [--json] [--data-root DIR] [--times 10]
    [--bends] [--coarse] [--iterations N] [--workers N]
"""

import argparse
import json
import os
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from calls import run_calls

from drake_exo.papers.de_magistris import five_cases, step_block
from drake_exo.soles.optimize.search import optimise
from drake_exo.soles.settings import Setup

STARTS = 3


@cache
def setup_of(root, coarse):
    """Case 1-Ref with all limits."""
    settings = five_cases(step_block(root), coarse=coarse)[0]
    return Setup.open(settings, root)


def starts_of(number, bends):
    """Numbers of the start shapes (0: brick) of a search, counted from 0."""
    if bends:
        return [1 + STARTS * number + k for k in range(STARTS)]
    further = STARTS - 1
    return [0, *(1 + further * number + k for k in range(further))]


def best_of_three(root, bends, coarse, iterations):
    """Result of one search.

    Args:
        root: folder of the data.
        bends: numbers of its start shapes.
        coarse: whether to use two coarse stages.
        iterations: of the last stage; None for the case's own.
    """
    setup = setup_of(root, coarse).with_iterations(iterations)
    design = optimise(setup, None, str, bends=bends)
    told = design.summary()
    return {
        "first_stage": [row["cost"] for row in design.starts],
        "c_over_brick": told["c"] / told["c_initial"],
        "failed_steps": told["failed_steps"],
        "finer_change": (design.check_finer() or {}).get("change"),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--data-root", type=Path)
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--bends", action="store_true", help="no brick")
    parser.add_argument("--coarse", action="store_true")
    parser.add_argument("--iterations", type=int, help="of the last stage")
    args = parser.parse_args()
    calls = [
        {
            "root": args.data_root or Path("."),
            "bends": starts_of(number, args.bends),
            "coarse": args.coarse,
            "iterations": args.iterations,
        }
        for number in range(args.times)
    ]

    def tell(row):
        first = ", ".join(f"{cost:+.4f}" for cost in row["first_stage"])
        finer = row["finer_change"]
        print(
            f"first stage {first}; c {row['c_over_brick']:.4f} of the brick's, "
            f"{row['failed_steps']} samples fail, finer "
            f"{'-' if finer is None else format(100 * finer, '+.1f')} %",
            flush=True,
        )

    rows = run_calls(
        best_of_three,
        calls,
        args.workers,
        "starts",
        None if args.json else tell,
    )
    c = np.array([row["c_over_brick"] for row in rows])
    spread = {
        "least": c.min(), "median": np.median(c), "largest": c.max(),
        "apart": (c.max() - c.min()) / abs(c.min()),
    }  # fmt: skip
    if args.json:
        print(json.dumps({"searches": rows, "c_over_brick": spread}, indent=2))
        return
    print("c: " + ", ".join(f"{n} {v:.4g}" for n, v in spread.items()))


if __name__ == "__main__":
    main()
