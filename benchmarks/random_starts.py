"""How many calibrations from random starts agree on one optimum.

    python benchmarks/random_starts.py [--starts N] [--json] [--workers N]
                                       [--exact] [--nodes-per-second R]
                                       [--walk DATA]

Three noisy trials of the coupled model (9 degrees of freedom) with a known
contact are calibrated from starts drawn uniformly inside the parameters'
bounds. Prints each start's objective, iterations and time, how many reach the
optimum that most reach (objective within 1e-4), and how many a better one.
With --exact the data hold no noise and the regularisers are switched off, so
that the optimum is the truth. With --walk it is Phase A of
tests/studies/opencap_walking.yaml with recordings in DATA. Starts then have
joints off by up to 5 degrees, the pelvis by up to 10 mm at either end, spheres'
stiffness and dissipation by up to a factor of 2 and their places by 10 mm; the
feet are settled as always.
"""

import argparse
import json
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from calls import run_calls

from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import (
    FootGroundSettings,
    Range,
    Solver,
    SphereSettings,
)
from drake_exo.model.plant import nominal_model
from drake_exo.report.gathering import format_table
from drake_exo.study import read_study
from drake_exo.virtual_laboratory import synthetic

_TOLERANCE = 1e-4
_NEGLIGIBLE = 1e-6  # of exact data's objective, which is zero at the truth
_TRUTH = {"stiffness": 1.3, "dissipation": 1.4}


@cache
def _problem(nodes_per_second: float, exact: bool):
    """The problem, its nominal parameters and the true ones."""
    model = nominal_model("coupled")
    sphere = SphereSettings(
        modulus_n_m2=Range(4e6, 5e5, 2e7), dissipation_s_m=Range(1.0, 0.0, 5.0)
    )
    solver = Solver(nodes_per_second=nodes_per_second)
    settings = FootGroundSettings(heel=sphere, toe=sphere, solver=solver)
    nominal = settings.parameters(model.spheres)
    truth = [
        replace(p, nominal=_TRUTH.get(p.name.split(".")[1], 1.0) * p.nominal)
        for p in nominal
    ]
    data = synthetic.consistent(model, synthetic.rises(3), truth, settings)
    noise = settings.noise
    if exact:
        noise = replace(noise, torque_nm=1e9, jerk=1e9)
        settings = replace(settings, noise=noise, prior_weight=1e-9)
    else:
        noise = replace(
            noise,
            angle_deg=0.3,
            foot_m=0.0005,
            foot_pitch_deg=0.1,
            force_n=3.0,
            cop_m=0.002,
        )
        data = [
            synthetic.noisy(movement, seed, noise, cutoff_hz=2.0)
            for seed, movement in enumerate(data)
        ]
    return FootGroundCalibration(model, data, settings), nominal, truth


def solve(nodes_per_second: float, exact: bool, values: list[float]) -> dict:
    """Calibrate from one start (parameters' values); its row."""
    problem, nominal, truth = _problem(nodes_per_second, exact)
    start = time.perf_counter()
    result = problem.solve(problem.guess(np.array(values)))
    solution = result.solution
    free = [p.free for p in nominal]
    found, true = (
        np.array([p.nominal for p in parameters])[free]
        for parameters in (result.parameters, truth)
    )
    return {
        "success": solution.success,
        "status": solution.status,
        "objective": solution.objective,
        "iterations": solution.iterations,
        "seconds": time.perf_counter() - start,
        "furthest_from_truth": float(np.abs(found / true - 1.0).max()),
    }


@cache
def _walk(data: str, nodes_per_second: float) -> FootGroundCalibration:
    """Phase A of a recorded walk."""
    folder = Path(__file__).parents[1] / "tests" / "studies"
    study = read_study(folder / "opencap_walking.yaml", data)
    settings = study.foot_ground
    solver = replace(settings.solver, nodes_per_second=nodes_per_second)
    settings = replace(settings, solver=solver)
    trials = study.trials("calibration")
    return FootGroundCalibration(study.model, trials, settings)


def solve_walk(data: str, nodes_per_second: float, start: int) -> dict:
    """Calibrate the walk from a random start; start 0 is not moved."""
    problem = _walk(data, nodes_per_second)
    (trial,) = measured = problem.trials
    rng = np.random.default_rng(start)
    names, size = trial.coordinates, float(start > 0)
    q = trial.q.copy()
    joints = names.joint_columns
    q[:, joints] += size * np.deg2rad(rng.uniform(-5.0, 5.0, len(joints)))
    first, last = size * rng.uniform(-0.01, 0.01, (2, 2))
    at = np.linspace(0.0, 1.0, len(q))[:, None]
    q[:, names.root_columns[:2]] += (1.0 - at) * first + at * last
    values = []
    for p in problem.parameters:
        moved, off = p.nominal, rng.uniform(-1.0, 1.0)
        if p.free and p.name.endswith((".x", ".z")):
            moved += size * 0.01 * off
        elif p.free:
            moved *= 2.0 ** (size * off)
        values.append(float(np.clip(moved, p.lower, p.upper)))
    began = time.perf_counter()
    problem.trials = [replace(trial, q=q)]
    guess = problem.guess(np.array(values))
    problem.trials = measured
    solution = problem.solve(guess).solution
    return {
        "success": solution.success,
        "status": solution.status,
        "objective": solution.objective,
        "iterations": solution.iterations,
        "seconds": time.perf_counter() - began,
    }


def told(rows: list[dict], allowed: float | None = None) -> list[dict]:
    """Mark rows at the optimum that most reach ("same"), or a better one."""
    found = np.array([r["objective"] for r in rows if r["success"]])
    allowed = _TOLERANCE * found.min() if allowed is None else allowed
    near = np.abs(found[:, None] - found) <= allowed
    most = found[np.argmax(near.sum(axis=1))]
    for row in rows:
        off = row["objective"] - most
        row["same"] = bool(row["success"] and abs(off) <= allowed)
        row["better"] = bool(row["success"] and off < -allowed)
    return rows


def run(
    starts: int,
    nodes_per_second: float,
    exact: bool,
    seed: int = 0,
    workers: int = 2,
) -> list[dict]:
    """Solve from every start.

    Returns:
        A row for each start, with the largest relative difference of its
        parameters from the true ones.
    """
    _, nominal, _ = _problem(nodes_per_second, exact)
    calls = [
        {
            "nodes_per_second": nodes_per_second,
            "exact": exact,
            "values": [float(v) for v in values],
        }
        for values in synthetic.random_values(nominal, starts, seed)
    ]
    rows = run_calls(solve, calls, workers, "random starts")
    return told(rows, _NEGLIGIBLE if exact else None)


def main() -> None:
    """Print a row for each start, and how many agree."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--nodes-per-second", type=float, default=50.0)
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--walk", metavar="DATA")
    args = parser.parse_args()
    rate = args.nodes_per_second
    if args.walk is not None:
        calls = [
            {"data": args.walk, "nodes_per_second": rate, "start": i}
            for i in range(args.starts)
        ]
        rows = told(run_calls(solve_walk, calls, args.workers, "random starts"))
    else:
        rows = run(args.starts, rate, args.exact, workers=args.workers)
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    best = min(r["objective"] for r in rows if r["success"])
    print(
        format_table(
            ["start", "status", "above best", "iterations", "s", "off truth"],
            [
                [
                    str(i + 1),
                    row["status"],
                    f"{row['objective'] - best:.1e}",
                    str(row["iterations"]),
                    f"{row['seconds']:.1f}",
                    f"{100.0 * row['furthest_from_truth']:.3g} %"
                    if "furthest_from_truth" in row
                    else "-",
                ]
                for i, row in enumerate(rows)
            ],
        )
    )
    print(f"best objective {best:.8g}")
    same = sum(r["same"] for r in rows)
    better = sum(r["better"] for r in rows)
    print(
        f"{same} of {len(rows)} starts reach the same optimum, {better} better"
    )


if __name__ == "__main__":
    main()
