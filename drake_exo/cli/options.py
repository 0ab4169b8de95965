"""Options that commands of both halves share."""

import argparse


def add_accept(parser: argparse.ArgumentParser) -> None:
    """Add --accept, which every command that ends with checks has."""
    parser.add_argument(
        "--accept",
        action="append",
        default=[],
        metavar="CHECK",
        help="take a result although this check does not hold, such as "
        "audit or plausibility.mass; a beginning of dotted names, or all; "
        "may be given several times, and is recorded",
    )
