"""Phase A over nodes and legs: is time in proportion to both?

    python benchmarks/legs.py [--json] [--data-root DIR] [--grids R ...]

The first squat of tests/studies/opencap_squats1.yaml, with one leg (6
coordinates, 2 spheres) and with two (9 coordinates, 3 spheres each), on grids
of 50 to 400 nodes per second, each started from the data. Prints CPU seconds
per iteration, and the power of the number of nodes with which they grow.
"""

import argparse
import contextlib
import json
import math
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import yaml

from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.report.gathering import format_table
from drake_exo.study import read_study

_HERE = Path(__file__).resolve().parents[1]
_STUDY = _HERE / "tests" / "studies" / "opencap_squats1.yaml"
_COLUMNS = ("legs", "nodes", "unknowns", "iterations", "s/iteration")


def study_of(legs: int, data_root: Path):
    """The study with one leg or two."""
    if legs == 2:
        return read_study(_STUDY, data_root)
    said = yaml.safe_load(_STUDY.read_text())
    said["model"] = "human"
    del said["foot_ground"]["spheres"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one_leg.yaml"
        path.write_text(yaml.safe_dump(said))
        return read_study(path, data_root)


def measured(study, nodes_per_second: float) -> dict:
    """Solve Phase A once; its row of the table."""
    settings = study.foot_ground
    solver = replace(settings.solver, nodes_per_second=nodes_per_second)
    problem = FootGroundCalibration(
        study.model,
        study.trials("calibration"),
        replace(settings, solver=solver),
    )
    problem.compiled.fingerprint()  # not part of an iteration
    start = time.process_time()
    found = problem.solve()
    seconds = time.process_time() - start
    solution = found.solution
    return {
        "nodes": len(problem.movements[0].grid.times),
        "unknowns": solution.num_variables,
        "success": solution.success,
        "iterations": solution.iterations,
        "seconds_per_iteration": seconds / max(solution.iterations, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--data-root", type=Path, default=_HERE.parent / "shared" / "data"
    )
    parser.add_argument(
        "--grids", type=float, nargs="+", default=[50.0, 100.0, 200.0, 400.0]
    )
    args = parser.parse_args()
    rows, powers = [], {}
    for legs in (1, 2):
        study = study_of(legs, args.data_root)
        # Progress of slow parts is not what the benchmark says.
        with contextlib.redirect_stdout(sys.stderr):
            own = [measured(study, rate) for rate in args.grids]
        rows += [{"legs": legs} | row for row in own]
        if len(own) > 1:
            first, last = own[0], own[-1]
            powers[legs] = math.log(
                last["seconds_per_iteration"] / first["seconds_per_iteration"]
            ) / math.log(last["nodes"] / first["nodes"])
    if args.json:
        print(json.dumps({"rows": rows, "power_of_nodes": powers}, indent=2))
        return
    print(
        format_table(
            _COLUMNS,
            [
                [
                    str(row["legs"]),
                    str(row["nodes"]),
                    str(row["unknowns"]),
                    f"{row['iterations']}" + ("" if row["success"] else "!"),
                    f"{row['seconds_per_iteration']:.4f}",
                ]
                for row in rows
            ],
        )
    )
    for legs, power in powers.items():
        print(f"legs {legs}: seconds an iteration as nodes to the {power:.2f}")


if __name__ == "__main__":
    main()
