"""`drake-exo demo`: the main job on the embedded virtual laboratory.

Writes a simulated campaign of a person who stands up in an exoskeleton, in
the files of a gait laboratory; from them alone calibrates the contact of foot
and ground and of person and device (Phases A and B), predicts six movements
that were not used (C1), again with stiffer cuffs (C2), reports it all beside
the paper's figures, and writes a page that replays every movement.
"""

import argparse
from pathlib import Path

from drake_exo.cli.calibrate import usable, write_interaction
from drake_exo.cli.lab import PROCESSES
from drake_exo.cli.predict import write_predictions
from drake_exo.cli.report import write_report
from drake_exo.cli.view import REPLAY, write_view
from drake_exo.files.output import OutputFolder, prepare_output_folder
from drake_exo.files.verdict import FAILS_CODE
from drake_exo.report.gathering import gather
from drake_exo.study import read_study
from drake_exo.virtual_laboratory.campaign import write_campaign

_SEED = 1


def add_parser(subparsers) -> None:
    """Add `demo` to the command line."""
    parser = subparsers.add_parser(
        "demo",
        help="virtual campaign, calibration, prediction and report",
        description=__doc__,
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--force", action="store_true", help="replace results in --out"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the steps one after the other; stops where nothing is solved."""
    with prepare_output_folder(args.out, args.force) as out:
        code = _steps(out)
    if code in (0, FAILS_CODE):
        print(f"all of it is in {args.out}; open in a browser:")
        print(f"  {(args.out / REPLAY).resolve()}")
    return code


def _steps(out: Path) -> int:
    """The demo's parts, each in its own folder of results."""

    def part(name: str, title: str) -> OutputFolder:
        print(f"== {title}", flush=True)
        return prepare_output_folder(out / name)

    title = "virtual laboratory: a campaign of nine movements"
    with part("laboratory", title) as folder:
        study = read_study(write_campaign(folder, _SEED, processes=PROCESSES))
    title = "Phases A and B: calibrate from three movements"
    with part("calibration", title) as folder:
        checks = study.gate("calibration")
        code = write_interaction(study, folder, checks=checks)
        if code not in (0, FAILS_CODE):
            return code
        contact, made_of = usable(folder, study, ["all"])
        checks = [*study.gate("prediction"), *made_of]
    for name, factor, title in (
        (
            "prediction",
            1.0,
            "Phase C1: predict six movements from their end states",
        ),
        (
            "prediction_stiff",
            1.4,
            "Phase C2: again with cuffs 1.4 times as stiff",
        ),
    ):
        with part(name, title) as folder:
            predicted = write_predictions(
                study, contact, folder, scale_interaction=factor, checks=checks
            )
            if predicted not in (0, FAILS_CODE):
                return predicted
            code = max(code, predicted)
    with part("report", "report") as folder:
        write_report(folder, gather(out))
    print("== replay", flush=True)
    write_view(out, out / REPLAY)
    return code
