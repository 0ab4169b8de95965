"""Memory and processor time of a simulated step over the number of elements.

python benchmarks/sole_memory.py [--data-root DIR] [--most TETS] [--json]

Each mesh runs in a process of its own; the step is that of `drake-exo sole
study` with 41 samples, the exact law and smoothed elements.
"""

import argparse
import json
import multiprocessing
import os
import resource
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

MESHES = ((18, 12, 4), (26, 18, 5), (36, 25, 8), (50, 34, 10))
SAMPLES = 41
KEYS = (
    *("tets", "c_tr", "c_rot", "strain", "failed_steps"),
    *("cpu_seconds", "peak_memory_gb"),
)


def simulate(divisions, root, results) -> None:
    """Simulate a step on one mesh and put its row, as in KEYS, in `results`."""
    from drake_exo.papers.de_magistris import SIZE, step_block
    from drake_exo.soles.contact.law import ContactLaw
    from drake_exo.soles.contact.newton import ContactSolver, Start
    from drake_exo.soles.elasticity import MATERIALS, Sole
    from drake_exo.soles.mesh import brick
    from drake_exo.soles.results import Step
    from drake_exo.soles.simulation import (
        heel_strike_count,
        sigma_max_translation,
        sigma_min_rotation,
        simulate,
    )

    load = step_block(root).load(root or Path(".")).every(SAMPLES)
    start = Start(np.array([-0.115, 0, -0.03]), np.array([-0.115, 0.0, 0.0]))
    began = time.process_time()
    sole = Sole(brick(SIZE, divisions), MATERIALS["neoprene"], "smoothed")
    law = ContactLaw(0.8, sole.penalty)
    solver = ContactSolver.of(sole, law)
    history = simulate(solver, load, start)
    strain = Step(None, sole, law, history).largest_strain
    seconds = time.process_time() - began
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    tets = len(sole.mesh.tets)
    strike = history.K_c[: heel_strike_count(SAMPLES)]
    c_tr = sigma_max_translation(strike).sum()
    c_rot = sigma_min_rotation(history.K_c).sum()
    results.put(
        (tets, c_tr, c_rot, strain, history.failed_steps, seconds, most)
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data-root", type=Path)
    parser.add_argument("--most", type=int, default=200_000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    before, rows = None, []
    if not args.json:
        print("   tets      c_tr     c_rot strain failed  CPU s  GB  growth")
    for divisions in MESHES:
        if 6 * np.prod(divisions) > args.most:
            break
        results = context.Queue()
        process = context.Process(
            target=simulate, args=(divisions, args.data_root, results)
        )
        process.start()
        row = results.get()
        process.join()
        growth = ""
        if before:
            pair = [np.log(a[k] / b[k]) for a, b, k in
                    ((row, before, 5), (row, before, 0))]  # fmt: skip
            growth = f"N^{pair[0] / pair[1]:.2f}"
        rows.append(dict(zip(KEYS, row, strict=True)))
        if not args.json:
            print(
                f"{row[0]:7d} {row[1]:9.4g} {row[2]:9.4g} {row[3]:6.3f} "
                f"{row[4]:6d} {row[5]:6.1f} {row[6]:4.1f} {growth}",
                flush=True,
            )
        before = row
    if args.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
