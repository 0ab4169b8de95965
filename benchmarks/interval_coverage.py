"""Does the 95 % interval of a calibrated parameter hold the truth?

Phase B on synthetic data whose only error is noise (filtered white noise), for
many seeds; the intervals come from the optimality conditions.

    python benchmarks/interval_coverage.py --seeds 200 [--json] [--workers N]
"""

import argparse
import json
from dataclasses import asdict, replace
from functools import cache

import numpy as np
from calls import run_calls

from drake_exo.calibration.uncertainty import uncertainty
from drake_exo.virtual_laboratory.synthetic import (
    INSTRUMENT_NOISE,
    noisy,
    rises_in_device,
)


@cache
def _made(nodes_per_second: float):
    """Exact trials, settings, and the true parameters by name."""
    made = rises_in_device(nodes_per_second=nodes_per_second)
    settings = made.settings(noise=INSTRUMENT_NOISE, prior_weight=0.01)
    settings = replace(
        settings, solver=replace(settings.solver, tolerance=1e-5)
    )
    names = [p.name for p in settings.parameters(made.model.cuffs)]
    truth = np.array([made.contact.values()[name] for name in names])
    return made, settings, dict(zip(names, truth, strict=True))


def solve(nodes_per_second: float, seed: int) -> tuple | None:
    """Each parameter's error, half width, identifiability; None if failed."""
    made, settings, truth = _made(nodes_per_second)
    trials = [
        noisy(trial, 1000 * seed + k, INSTRUMENT_NOISE)
        for k, trial in enumerate(made.trials)
    ]
    result = made.calibration(settings, trials).solve()
    if not result.success:
        return None
    found = uncertainty(result)
    off = np.array([p.nominal for p in result.parameters])
    off -= list(truth.values())
    return off, found.half_width, found.identifiable


def coverage(
    nodes_per_second: float, seeds: int, workers: int = 2
) -> list[dict]:
    """One row for each parameter: share of seeds whose interval holds it."""
    calls = [
        {"nodes_per_second": nodes_per_second, "seed": seed}
        for seed in range(seeds)
    ]
    found = run_calls(solve, calls, workers, "coverage")
    rows = [row for row in found if row is not None]
    failed = len(found) - len(rows)
    *_, truth = _made(nodes_per_second)
    error, half, identifiable = (np.array(x) for x in zip(*rows, strict=True))
    # A parameter counts as identifiable if most seeds call it so.
    return [
        {
            "parameter": name,
            "identifiable": bool(identifiable[:, k].mean() > 0.5),
            "coverage": float((np.abs(error[:, k]) <= half[:, k]).mean()),
            "bias": float(error[:, k].mean()),
            "error_sd": float(error[:, k].std()),
            "half_width_95": float(half[:, k].mean()),
            "true": float(true),
            "seeds": len(rows),
            "failed": failed,
        }
        for k, (name, true) in enumerate(truth.items())
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--nodes-per-second", type=float, default=50.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = coverage(args.nodes_per_second, args.seeds, args.workers)
    if args.json:
        print(
            json.dumps(
                {"noise": asdict(INSTRUMENT_NOISE), "rows": rows}, indent=2
            )
        )
        return
    for r in rows:
        print(
            f"{r['parameter']:28s} {'yes' if r['identifiable'] else 'no':4s}"
            f"{100 * r['coverage']:6.1f} %  true {r['true']:10.4g}  bias "
            f"{r['bias']:10.3g}  SD {r['error_sd']:10.3g}  95 % +- "
            f"{r['half_width_95']:10.3g}"
        )
    print(f"{rows[0]['seeds']} seeds, {rows[0]['failed']} failed")


if __name__ == "__main__":
    main()
