"""Runs every benchmark.

    python benchmarks/all.py [--quick] [--json] [--data-root DIR]

They run one after the other; with --quick each in a small size and two at a
time, to see that they run, and roughly how fast. Prints the time of each, with
--json also its results. scale.py is left out if dask.distributed is not
installed, design.py always: it needs a study with its calibration.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
# Script -> options of the small size.
QUICK = {
    "phase_a.py": ("--only", "3x50"),
    "legs.py": ("--grids", "50"),
    "phases.py": ("--nodes-per-second", "50"),
    "random_starts.py": ("--starts", "4", "--nodes-per-second", "25"),
    "interval_coverage.py": ("--seeds", "4", "--nodes-per-second", "25"),
    "seeds.py": ("--seeds", "1", "--truth", "near"),
    "weights.py": ("--factors", "4"),
    "plausibility.py": (
        *("--seeds", "1", "--truth", "near"),
        *("--mistakes", "cop_unit", "floor", "encoder_sign"),
    ),
    "scale.py": ("--tasks", "5", "--workers", "1", "16"),
    "sole.py": ("--nodes", "100"),
    "sole_starts.py": ("--times", "1", "--coarse", "--iterations", "2"),
    "sole_memory.py": ("--most", "6000"),
    "sole_interruptions.py": (
        *("--divisions", *"642", "--samples", "8"),
        *("--iterations", "4", "--kills", "1"),
    ),
}
# They share simulated campaigns: the first writes, the second reads them. Both
# together take longest, so they begin first.
WITH_CAMPAIGNS = ("seeds.py", "plausibility.py")
WITH_DATA = (
    "legs.py",
    *("sole.py", "sole_starts.py", "sole_interruptions.py"),
    "sole_memory.py",
)


def run(script: str, quick: bool, data_root: Path, campaigns: str) -> dict:
    """Run a script: seconds, exit code, and its results (JSON) or error."""
    options = [*(QUICK[script] if quick else ()), "--json"]
    if script in WITH_DATA:
        options += ["--data-root", str(data_root)]
    if script in WITH_CAMPAIGNS:
        options += ["--data", campaigns]
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, str(HERE / script), *options],
        capture_output=True,
        text=True,
    )
    row = {"seconds": time.perf_counter() - start, "code": done.returncode}
    if done.returncode:
        return row | {"error": done.stderr.strip().splitlines()[-1:]}
    try:
        return row | {"says": json.loads(done.stdout)}
    except ValueError:
        return row | {"code": 1, "error": ["what it says is no JSON"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--data-root", type=Path, default=Path("../shared/data")
    )
    args = parser.parse_args()
    scripts = [
        script
        for script in QUICK
        if script != "scale.py" or find_spec("distributed") is not None
    ]
    alone = [(script,) for script in scripts if script not in WITH_CAMPAIGNS]
    rows, start = {}, time.perf_counter()
    with tempfile.TemporaryDirectory() as campaigns:

        def run_all(in_turn):
            for script in in_turn:
                row = run(script, args.quick, args.data_root, campaigns)
                rows[script] = row
                if not args.json:
                    failed = f", failed: {row['error']}" if row["code"] else ""
                    took = f"{row['seconds']:.1f} s"
                    print(f"{script}: {took}{failed}", flush=True)

        with ThreadPoolExecutor(2 if args.quick else 1) as pool:
            list(pool.map(run_all, [WITH_CAMPAIGNS, *alone]))
    seconds = time.perf_counter() - start
    if args.json:
        print(json.dumps({s: rows[s] for s in scripts}, indent=2))
    else:
        print(f"all: {seconds:.0f} s")
    sys.exit(any(row["code"] for row in rows.values()))


if __name__ == "__main__":
    main()
