"""`drake-exo export opensim`: calibrated contacts in an OpenSim model.

It adds spheres, cuffs and the device to the scaled model that the study's
person was read from, and writes states and ground forces of the movements
beside it.
"""

import argparse
from pathlib import Path

from drake_exo.cli import add_accept, add_out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    kinds = parser.add_subparsers(dest="kind", required=True)
    opensim = kinds.add_parser(
        "opensim",
        help="an OpenSim model with calibrated contacts",
        description=__doc__,
    )
    opensim.add_argument(
        "results",
        type=Path,
        metavar="DIR",
        help="results of calibrate, predict or design",
    )
    opensim.add_argument(
        "--model", type=Path, required=True, help="the scaled .osim file"
    )
    add_out(
        opensim,
        "replace files that are there",
        required=True,
        help="the .osim file to write",
    )
    add_accept(opensim)


def run(args: argparse.Namespace) -> int:
    """Write the model, and say what became of the calibration in it."""
    from drake_exo.report.opensim_export import export_opensim

    done = export_opensim(
        args.results, args.model, args.out, args.force, args.accept
    )
    for line in done.lines:
        print(line)
    for path in done.files:
        print(path)
    return 0
