"""Phase A at full size: time and memory over trials, nodes and grids.

    python benchmarks/phase_a.py [--json] [--repeat N] [--only SUBSTRING]

Trials of 1.5 s of the coupled model (9 degrees of freedom), consistent with a
known contact, with smooth noise of fixed seed. They are made beforehand and
not timed. Every row runs in a fresh process, so that its peak memory is its
own; build + solve is what a user waits for.
"""

import argparse
import json
import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import (
    FootGroundSettings,
    Range,
    Solver,
    SphereSettings,
    Spread,
    TrackingNoise,
)
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import nominal_model
from drake_exo.report.gathering import format_table
from drake_exo.virtual_laboratory.synthetic import consistent, noisy, rises

_DURATION = 1.5
_TRUE_MODULUS = 5e6
# What is left of a gait laboratory's noise after filtering.
_NOISE = TrackingNoise(angle_deg=0.1, force_n=1.0, foot_m=0.0002)
_ROWS = [
    *((3, nodes, "hermite_simpson") for nodes in (50, 100, 200)),
    *((trials, 200, "hermite_simpson") for trials in (1, 2, 6)),
    (3, 200, "pseudospectral"),
]


def _settings(modulus, free, shift, **solver):
    sphere = SphereSettings(
        modulus_n_m2=Range(modulus, 1e6, 5e7, free),
        dissipation_s_m=Range(1.0, 0.0, 5.0, free),
        x_m=Spread(0.05, 0.05, 3.0 * shift, free),
        z_m=Spread(0.02, 0.02, -shift, free),
    )
    return FootGroundSettings(heel=sphere, toe=sphere, solver=Solver(**solver))


def make_trials(count: int) -> list[Trial]:
    """Movements that obey the true contact, with smooth noise on top."""
    model = nominal_model("coupled")
    settings = _settings(_TRUE_MODULUS, False, 0.0, nodes_per_second=100.0)
    truth = settings.parameters(model.spheres)
    exact = consistent(model, rises(count, _DURATION), truth, settings)
    return [noisy(m, i, _NOISE) for i, m in enumerate(exact)]


def run_row(data: Path, trials: int, nodes: float, transcription: str):
    """Calibrate once; prints one JSON object."""
    movements = pickle.loads(data.read_bytes())[:trials]
    model = nominal_model("coupled")
    settings = _settings(
        1e7,
        True,
        0.003,
        nodes_per_second=nodes,
        transcription=transcription,
    )
    start, cpu = time.perf_counter(), time.process_time()
    result = FootGroundCalibration(model, movements, settings).solve()
    total = time.perf_counter() - start
    cpu = time.process_time() - cpu
    solution = result.solution
    row = {
        "trials": trials,
        "nodes_per_second": nodes,
        "transcription": transcription,
        "build_seconds": total - solution.seconds["solve"],
        "solve_seconds": solution.seconds["solve"],
        "linear_algebra_seconds": solution.seconds["linear_algebra_and_ipopt"],
        "cpu_seconds": cpu,
        "iterations": solution.iterations,
        "success": result.success,
        "num_variables": solution.num_variables,
        "num_constraints": solution.num_constraints,
        "peak_memory_mb": _peak_memory_mb(),
    }
    print(json.dumps(row))


def _peak_memory_mb() -> float:
    """Peak of this process alone: its ru_maxrss begins with its parent's."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (peak,) = [line for line in lines if line.startswith("VmHWM:")]
    return int(peak.split()[1]) / 1024.0


def _measure(data, row, repeat):
    """Median of each figure over fresh processes."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    runs = []
    for _ in range(repeat):
        done = subprocess.run(
            [sys.executable, __file__, "--row", str(data), *map(str, row)],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        )
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    middle = dict(runs[0])
    for key, value in middle.items():
        if isinstance(value, float) and key != "nodes_per_second":
            middle[key] = statistics.median(r[key] for r in runs)
    return middle


def main() -> None:
    """Print the table, or one row's figures in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--only", default="", help="rows whose name has this")
    parser.add_argument("--row", nargs=4, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        data, trials, nodes, transcription = args.row
        run_row(Path(data), int(trials), float(nodes), transcription)
        return
    rows = [r for r in _ROWS if args.only in f"{r[0]}x{r[1]} {r[2]}"]
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "trials.pickle"
        data.write_bytes(pickle.dumps(make_trials(max(r[0] for r in rows))))
        found = []
        for row in rows:
            found.append(_measure(data, row, args.repeat))
            if not args.json:
                print(f"{row[0]} x {row[1]}/s {row[2]} done", flush=True)
    if args.json:
        print(json.dumps(found, indent=2))
        return
    keys = [k for k in found[0] if k not in ("transcription", "success")]
    print(
        format_table(
            ["grid", *(k.replace("_", " ") for k in keys)],
            [[r["transcription"], *(r[k] for k in keys)] for r in found],
        )
    )


if __name__ == "__main__":
    main()
