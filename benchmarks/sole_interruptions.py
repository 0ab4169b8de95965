"""Whether a killed and resumed optimisation ends where a whole one does.

Case 1-Ref with all limits on the coarse mesh, by the command itself: once in
one go, then killed three times (SIGKILL) at random moments and resumed each
time. Prints c of both.

python benchmarks/sole_interruptions.py [--json] --data-root DIR
    [--divisions 10 6 3] [--samples 24] [--iterations 300] [--kills 3]
    [--seed 0]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from drake_exo.files.output import FAILS_CODE
from drake_exo.papers.de_magistris import SIZE

LAYERS = ((3e-4, 60), (1e-4, 60), (3e-5, 300))  # m, most iterations
CASE = Path(__file__).parents[1] / "tests" / "cases" / "hrp4_neoprene.yaml"


def write_case(folder, args):
    """Write the tests' case on a brick, with stages that reach an optimum."""
    case = yaml.safe_load(CASE.read_text())
    brick = {"size_m": list(SIZE), "divisions": args.divisions}
    case["mesh"] = {"brick": brick}
    case["optimize"] = {
        "stages": [
            {"divisions": args.divisions, "samples": args.samples,
             "layer_m": layer, "kappa": 0.2,
             "iterations": min(most, args.iterations)}
            for layer, most in LAYERS
        ]
    }  # fmt: skip
    file = folder / "case.yaml"
    file.write_text(yaml.safe_dump(case))
    return file


def start(case, out, root, resume=None):
    """Start the command; returns its process."""
    command = [sys.executable, "-m", "drake_exo.cli", "sole", "optimize"]
    command += [str(case), "--data-root", str(root), "--out", str(out)]
    if resume is not None:
        command += ["--resume", str(resume)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def finish(process, out):
    """Wait for the command; contents of its summary.json."""
    text = process.communicate()[0]
    if process.returncode not in (0, FAILS_CODE):
        sys.exit(text)
    return json.loads((out / "summary.json").read_text())


def kill_later(process, out, seconds):
    """Kill it then, or once there is a checkpoint; where that stands."""
    time.sleep(seconds)
    while not (out / "checkpoint.json").is_file():
        time.sleep(0.2)
    process.kill()
    process.communicate()
    place = json.loads((out / "checkpoint.json").read_text())
    return {"stage": place["stage"] + 1, "iteration": place["iteration"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--data-root", type=Path, required=True)
    parser.add_argument("--divisions", type=int, nargs=3, default=[10, 6, 3])
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case = write_case(folder, args)
        began = time.perf_counter()
        whole = finish(start(case, folder / "0", args.data_root), folder / "0")
        seconds = time.perf_counter() - began
        before, places = None, []
        for k in range(1, args.kills + 1):
            out = folder / str(k)
            process = start(case, out, args.data_root, before)
            wait = seconds / (args.kills + 1) * rng.uniform(0.3, 1.5)
            places.append(kill_later(process, out, wait))
            before = out
        out = folder / "end"
        parts = finish(start(case, out, args.data_root, before), out)
    keys = ("c", "c_tr", "c_rot", "optimal", "optimality_error", "status")
    out = {
        "in_one_go": {key: whole[key] for key in keys},
        "killed_at": places,
        "resumed": {key: parts[key] for key in keys},
        "difference": parts["c"] / whole["c"] - 1,
    }
    if args.json:
        print(json.dumps(out, indent=2))
        return
    for key, value in out.items():
        print(f"{key}: {value}")


if __name__ == "__main__":
    main()
