"""`drake-exo demo`: the whole exoskeleton job, in the virtual laboratory.

It writes a simulated campaign of a person who stands up in an exoskeleton, in
the files of a gait laboratory. From these files alone it calibrates the contact
of foot and ground and of person and device (Phases A and B). It predicts six
movements that were not used (C1), and predicts them again with stiffer cuffs
(C2). Finally it reports the results beside the paper's figures and writes a
page that replays every movement.
"""

import argparse
import contextlib
import io
from pathlib import Path

from drake_exo.calibration.clocks import Clock
from drake_exo.cli import add_out
from drake_exo.cli.calibrate import write_interaction
from drake_exo.cli.lab import PROCESSES
from drake_exo.cli.predict import write_predictions
from drake_exo.cli.report import write_report
from drake_exo.cli.view import REPLAY, write_view
from drake_exo.contact.parameters import ContactModel
from drake_exo.files.output import (
    FAILS_CODE,
    Check,
    OutputFolder,
    prepare_output_folder,
)
from drake_exo.jobs.engine import Beside
from drake_exo.report.gathering import gather
from drake_exo.study import Study, find_clocks, read_study
from drake_exo.virtual_laboratory.campaign import write_campaign

_SEED, _TRUTH = 1, "wide"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_out(parser, required=True)


def run(args: argparse.Namespace) -> int:
    """Run the steps one after the other; stops if one is not solved."""
    folder = prepare_output_folder(args.out, args.force)
    with folder as out:
        code = folder.end(_steps(out))
    if code in (0, FAILS_CODE):
        print(f"all of it is in {args.out}; open in a browser:")
        print(f"  {(args.out / REPLAY).resolve()}")
    return code


def _steps(out: Path) -> int:
    """Run the demo's parts, each into a folder of its own; the exit code."""

    def part(name: str, title: str) -> OutputFolder:
        print(f"== {title}", flush=True)
        return prepare_output_folder(out / name)

    title = f"virtual laboratory: nine movements, seed {_SEED}, {_TRUTH} truth"
    with part("laboratory", title) as folder:
        file = write_campaign(folder, _SEED, truth=_TRUTH, processes=PROCESSES)
        study = read_study(file)
    title = "Phases A and B: calibrate from three movements"
    with Beside() as beside:
        ahead = beside(to_predict, study=study)
        with part("calibration", title) as folder:
            checks = study.gate("calibration")
            code = write_interaction(study, folder, checks=checks)
            if code not in (0, FAILS_CODE):
                return code
            contact, made_of = study.calibrated(folder, ["all"])
            predicted, checks = ahead.value()
        clocks = _timed(predicted, contact, beside)
        # C1 and C2 both only read the calibration: a core for each.
        how = {
            "study": predicted,
            "contact": contact,
            "checks": [*checks, *made_of],
            "clocks": clocks,
        }
        with prepare_output_folder(out / "prediction_stiff") as folder:
            stiff = beside(predict_stiff, out=folder, **how)
            title = "Phase C1: predict six movements from their end states"
            with part("prediction", title) as folder:
                soft = write_predictions(out=folder, **how)
            if soft not in (0, FAILS_CODE):
                stiff.stop()
                return soft
            title = "Phase C2: again with cuffs 1.4 times as stiff"
            print(f"== {title}", flush=True)
            stiffer, said = stiff.value()
            print(said, end="", flush=True)
            if stiffer not in (0, FAILS_CODE):
                return stiffer
        code = max(code, soft, stiffer)
    with part("report", "report") as folder:
        write_report(folder, gather(out))
    print("== replay", flush=True)
    write_view(out, out / REPLAY)
    return code


def to_predict(study: Study) -> tuple[Study, list[Check]]:
    """The study with only its trials for prediction, and their checks."""
    checks = list(study.gate("prediction"))
    return study.alone(study.trials("prediction")), checks


def _timed(study: Study, contact: ContactModel, beside: Beside) -> list[Clock]:
    """Clocks of the prediction trials by calibrated cuffs, in two processes."""
    trials = study.trials("prediction")
    half, other = trials[::2], trials[1::2]
    those = beside(
        find_clocks, study=study.alone(other), trials=other, contact=contact
    )
    return [*find_clocks(study, half, contact), *those.value()]


def predict_stiff(**how) -> tuple[int, str]:
    """Write Phase C2, see `write_predictions`; exit code, what it printed."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = write_predictions(scale_interaction=1.4, **how)
    return code, said.getvalue()
