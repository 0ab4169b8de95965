"""`drake-exo sensitivity`: which contact parameters the data determine.

It solves Phase A, then analyses all parameters of the spheres, including the
radius. It also calibrates again with other radii, to show that the same forces
come out with the spheres' centres moved.
"""

import argparse

import numpy as np

from drake_exo.calibration.uncertainty import (
    contact_sensitivity,
    radius_profile,
)
from drake_exo.cli.calibrate import add_study_arguments, report_failure
from drake_exo.errors import InputError
from drake_exo.files.output import Progress, prepare_output_folder, write_json
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
        result = calibrated.result
        found = contact_sensitivity(result)
        progress = Progress("sensitivity")
        rows = []
        for row in radius_profile(result):
            rows.append(row)
            factor = row["radius_factor"]
            progress.update(f"radius x {factor:g}", done=len(rows))
        _print(found, rows)
        write_json(
            out / "sensitivity.json",
            {**vars(found), "advice": found.advice(), "radius_profile": rows},
        )
    print(verdict.text())
    print(f"results in {args.out}")
    return verdict.exit_code


def _print(found, rows) -> None:
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
    spheres = [n.removesuffix(".z") for n in rows[0] if n.endswith(".z")]
    print("Calibrated again with other radii; z and lowest point in mm")
    print(
        format_table(
            [
                "radius ×",
                "objective",
                "F_z RMSD [N]",
                *(f"{s}{what}" for s in spheres for what in (".z", " lowest")),
            ],
            [
                [
                    f"{r['radius_factor']:g}"
                    + ("" if r["success"] else " (failed)"),
                    r["objective"],
                    r["vertical_force_rmsd_n"],
                    *(
                        1e3 * value
                        for s in spheres
                        for value in (
                            r[f"{s}.z"],
                            r[f"{s}.z"] - r[f"{s}.radius"],
                        )
                    ),
                ]
                for r in rows
            ],
        )
    )
