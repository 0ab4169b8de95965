"""`drake-exo inspect`: what a laboratory's file holds.

It lists markers with their gaps, force plates with their load, channels, rates,
units and duration, for every format that drake-exo reads.
"""

import argparse
from pathlib import Path

from drake_exo.files.inspection import inspect


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="recorded file, OpenSim model or mesh",
    )


def run(args: argparse.Namespace) -> int:
    """Print the contents of each file."""
    for path in args.file:
        print(inspect(path))
    return 0
