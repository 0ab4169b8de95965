"""`drake-exo report`: the paper's tables and figures from results on disk.

It looks through DIR for what `calibrate` and `predict` wrote. In DIR/report it
makes Table II (calibration) and Table III (prediction) as text and CSV, and
Figures 2 to 7. If the subject is that of the virtual laboratory in the shipped
exoskeleton, the paper's own numbers stand beside its results.
"""

import argparse
import csv
from pathlib import Path

from drake_exo.cli import add_accept, add_out
from drake_exo.files.output import prepare_output_folder, write_text
from drake_exo.papers.serrancoli import draw_figures, tables
from drake_exo.report.gathering import Results, check_one_study, gather


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "results",
        type=Path,
        metavar="DIR",
        help="folder with results of calibrate and predict",
    )
    add_out(
        parser,
        "replace an earlier report",
        help="folder for the report (default: DIR/report)",
        metavar="FOLDER",
    )
    add_accept(parser)


def run(args: argparse.Namespace) -> int:
    """Write the report and print its tables.

    Raises:
        InputError: there are no results in DIR, or a report already.
    """
    found = gather(args.results, args.accept)
    check_one_study(found)
    out = args.out or args.results / "report"
    with prepare_output_folder(out, args.force, reads=[args.results]) as folder:
        write_report(folder, found)
    print(f"report in {out}")
    return 0


def write_report(folder: Path, found: list[Results]) -> None:
    """Write tables and figures to a folder; prints the tables."""
    made, texts = tables(found)
    marks = [f"{r.folder.name}: {r.mark}" for r in found if r.mark]
    texts = [*marks, *texts]
    for name, rows in made.items():
        with open(
            folder / f"{name}.csv", "w", newline="", encoding="utf-8"
        ) as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    for text in texts:
        print(text)
    write_text(folder / "tables.txt", "\n\n".join(texts))
    draw_figures(folder, found)
