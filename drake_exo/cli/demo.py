"""`drake-exo demo`: the main job on the embedded virtual laboratory.

Writes a simulated campaign of a person who stands up in an exoskeleton, in
the files of a gait laboratory; from them alone calibrates the contact of foot
and ground and of person and device (Phases A and B), predicts six movements
that were not used (C1), again with stiffer cuffs (C2), reports it all beside
the paper's figures, and writes a page that replays every movement.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path
from typing import TextIO

from drake_exo.cli import main
from drake_exo.cli.view import REPLAY
from drake_exo.files.output import prepare_output_folder

_SEED = "1"


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
    """Run the steps one after the other; stops at the first that fails."""
    with prepare_output_folder(args.out, args.force) as out:
        final = _FinalPaths(sys.stdout, str(out), str(args.out))
        for title, step in _steps(out):
            print(f"== {title}", flush=True)
            with contextlib.redirect_stdout(final):
                code = main(step)
            if code:
                return code
    print(f"all of it is in {args.out}; open in a browser:")
    print(f"  {(args.out / REPLAY).resolve()}")
    return 0


class _FinalPaths:
    """A stream that names files where they will be in the end.

    Replaced results grow in another folder (`prepare_output_folder`), which
    is gone when somebody follows what was printed.
    """

    def __init__(self, stream: TextIO, growing: str, final: str):
        self._stream, self._growing, self._final = stream, growing, final

    def write(self, text: str) -> int:
        return self._stream.write(text.replace(self._growing, self._final))

    def __getattr__(self, name: str):
        return getattr(self._stream, name)


def _steps(out: Path) -> list[tuple[str, list[str]]]:
    """Titles and command lines of the demo."""
    laboratory = out / "laboratory"
    study = str(laboratory / "study.yaml")
    calibration = str(out / "calibration")
    predict = ["predict", study, "--calibration", calibration]
    return [
        (
            "virtual laboratory: a campaign of nine movements",
            ["lab", "--seed", _SEED, "--out", str(laboratory)],
        ),
        (
            "Phases A and B: calibrate from three movements",
            ["calibrate", study, "--no-front", "--out", calibration],
        ),
        (
            "Phase C1: predict six movements from their end states",
            [*predict, "--out", str(out / "prediction")],
        ),
        (
            "Phase C2: again with cuffs 1.4 times as stiff",
            [
                *predict,
                "--scale-interaction",
                "1.4",
                "--out",
                str(out / "prediction_stiff"),
            ],
        ),
        ("report", ["report", str(out)]),
        ("replay", ["view", str(out), "--out", str(out / REPLAY)]),
    ]
