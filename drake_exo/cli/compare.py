"""`drake-exo compare`: two or more results of one phase side by side.

It prints what differs in settings, parameters with their intervals, RMSD and
largest forces. With --out it also writes these tables to a file, and draws
figures of all results overlaid.
"""

import argparse
from pathlib import Path

from drake_exo.cli import add_out
from drake_exo.files.output import (
    joined_mark,
    prepare_output_folder,
    save_figure,
    write_text,
)
from drake_exo.report.gathering import compare


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "results",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="results of calibrate or predict, two or more",
    )
    add_out(parser, help="write table and figures to this folder")


def run(args: argparse.Namespace) -> int:
    """Print the tables; write them with figures to --out, if given."""
    found = compare(args.results)
    text = found.text()
    if args.out is not None:
        with prepare_output_folder(
            args.out, args.force, reads=args.results
        ) as out:
            write_text(out / "compared.txt", text)
            mark = joined_mark(found.marks())
            for name, figure in found.figures().items():
                save_figure(out / f"{name}.png", figure, mark)
    print(text)
    if args.out is not None:
        print(f"results in {args.out}")
    return 0
