"""`drake-exo demo`: the main job on the embedded virtual laboratory.

Writes a simulated campaign of a person who stands up in an exoskeleton, in
the files of a gait laboratory, and calibrates from them alone.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from drake_exo.cli import main
from drake_exo.output import prepare_output_folder
from drake_exo.report.tables import format_table

_SEED = "1"


def add_parser(subparsers) -> None:
    """Add `demo` to the command line."""
    parser = subparsers.add_parser(
        "demo",
        help="write a virtual campaign and calibrate from it",
        description=__doc__,
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--force", action="store_true", help="replace results in --out"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the campaign, calibrate, and compare with the truth."""
    with prepare_output_folder(args.out, args.force) as out:
        laboratory, results = out / "laboratory", out / "foot_ground"
        for step in (
            ["lab", "--seed", _SEED, "--out", str(laboratory)],
            [
                "calibrate",
                str(laboratory / "study.yaml"),
                "--phase",
                "foot-ground",
                "--out",
                str(results),
            ],
        ):
            code = main(step)
            if code:
                return code
        _compare(laboratory, results)
    print(f"all of it is in {args.out}")
    return 0


def _compare(laboratory: Path, results: Path) -> None:
    """Print calibrated beside true parameters; only here truth is read."""
    truth = json.loads(
        (laboratory / "truth" / "foot_ground.json").read_text("utf-8")
    )["parameters"]
    found = json.loads((results / "parameters.json").read_text("utf-8"))
    rows = [
        [name, f"{value:.4g}", f"{truth[name]:.4g}", found["units"][name]]
        for name, value in found["parameters"].items()
        if name in truth
    ]
    print("Calibrated parameters beside the true ones")
    print(format_table(["parameter", "calibrated", "true", "unit"], rows))
