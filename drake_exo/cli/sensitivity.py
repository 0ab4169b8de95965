"""`drake-exo sensitivity`: which contact parameters the data determine.

It solves Phase A, then analyses all parameters of the spheres, including the
radius.
"""

import argparse

import numpy as np

from drake_exo.calibration.uncertainty import contact_sensitivity
from drake_exo.cli.calibrate import add_study_arguments, report_failure
from drake_exo.errors import InputError
from drake_exo.files.output import prepare_output_folder, write_json
from drake_exo.report.gathering import format_table
from drake_exo.study import calibrate_foot_ground, read_study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_study_arguments(parser, resume=False)


def run(args: argparse.Namespace) -> int:
    """Solve, analyse, print and write sensitivity.json."""
    study = read_study(args.study, args.data_root)
    if study.sole is not None:
        raise InputError(
            f"{args.study}: the law of a sole has no parameters to look at; "
            "give foot_ground.law: simbody"
        )
    plausible = study.gate("calibration", args.accept)
    folder = prepare_output_folder(args.out, args.force, reads=study.reads)
    with folder as out:
        calibrated = calibrate_foot_ground(study)
        verdict = calibrated.verdict(plausible, args.accept)
        write_json(
            out / "summary.json", {"subject": study.name} | verdict.summary()
        )
        if not calibrated.success:
            return folder.end(report_failure(calibrated.solution))
        found = contact_sensitivity(calibrated.result)
        _print(found)
        write_json(
            out / "sensitivity.json", {**vars(found), "advice": found.advice()}
        )
    print(verdict.text())
    print(f"results in {args.out}")
    return verdict.exit_code


def _print(found) -> None:
    print("Influence on the forces, in noise, of a quarter of the range")
    print(
        format_table(
            ["parameter", "influence"],
            list(zip(found.names, found.influence, strict=True)),
        )
    )
    print("Singular values and the strongest parts of their directions")
    table = []
    for value, direction in zip(
        found.singular_values, found.directions, strict=True
    ):
        order = np.argsort(-np.abs(direction))[:3]
        parts = ", ".join(
            f"{direction[k]:+.2f} {found.names[k]}" for k in order
        )
        table.append([f"{value:.4g}", parts])
    print(format_table(["singular value", "direction"], table))
    for line in found.advice():
        print(line)
