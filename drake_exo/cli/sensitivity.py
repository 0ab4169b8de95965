"""`drake-exo sensitivity`: which contact parameters the data determine.

Solves Phase A, then looks at all parameters of the spheres, the radius too,
and calibrates again with other radii: the same forces come out with the
spheres' centres moved.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.inputs import load_inputs
from drake_exo.calibration.scores import rms
from drake_exo.calibration.uncertainty import contact_sensitivity
from drake_exo.files.output import Progress, prepare_output_folder, write_json
from drake_exo.report.tables import format_table

_RADIUS_FACTORS = (0.75, 1.0, 1.25)


def add_parser(subparsers) -> None:
    """Add `sensitivity` to the command line."""
    parser = subparsers.add_parser(
        "sensitivity",
        help="which contact parameters the data determine",
        description=__doc__,
    )
    parser.add_argument("study", type=Path, metavar="STUDY.yaml")
    parser.add_argument("--data-root", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--force", action="store_true")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Solve, analyse, print and write sensitivity.json."""
    inputs = load_inputs(args.study, args.data_root)
    with prepare_output_folder(args.out, args.force) as out:
        progress = Progress("sensitivity", total=len(_RADIUS_FACTORS) + 1)
        result = inputs.problem().solve()
        progress.update("calibrated", done=1)
        found = contact_sensitivity(result)
        rows = [
            _with_radius(inputs, factor, progress, i + 2)
            for i, factor in enumerate(_RADIUS_FACTORS)
        ]
        _print(found, rows)
        write_json(
            out / "sensitivity.json",
            {
                "names": found.names,
                "influence": found.influence,
                "singular_values": found.singular_values,
                "directions": found.directions,
                "cosines": found.cosines,
                "advice": found.advice(),
                "radius_profile": rows,
            },
        )
    print(f"results in {args.out}")
    return 0


def _with_radius(inputs, factor, progress, done) -> dict:
    """Calibrate with both radii scaled; the prior follows the lowest point."""
    parameters = []
    shift = {}
    for p in inputs.parameters:
        sphere, what = p.name.split(".")
        if what == "radius":
            shift[sphere] = (factor - 1.0) * p.nominal
            p = replace(p, nominal=factor * p.nominal, free=False)
        parameters.append(p)
    parameters = [
        replace(
            p,
            nominal=p.nominal + shift[p.name.split(".")[0]],
            lower=p.lower + shift[p.name.split(".")[0]],
            upper=p.upper + shift[p.name.split(".")[0]],
        )
        if p.name.endswith(".z")
        else p
        for p in parameters
    ]
    result = FootGroundProblem(
        inputs.tree, inputs.trials, parameters, inputs.settings
    ).solve()
    values = {p.name: p.nominal for p in result.parameters}
    errors = [
        rms(t.ground[:, 1:2] - trial.sample(t.times).ground[:, 1:2])[0]
        for t, trial in zip(result.trajectories, inputs.trials, strict=True)
    ]
    progress.update(f"radius x {factor:g}", done=done)
    return {
        "radius_factor": factor,
        "success": result.solution.success,
        "objective": result.solution.objective,
        "vertical_force_rmsd_n": float(np.mean(errors)),
        **{k: values[k] for k in values if k.endswith((".radius", ".z"))},
    }


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
    print("Calibrated again with other radii")
    print(
        format_table(
            [
                "radius ×",
                "objective",
                "F_z RMSD [N]",
                "heel.z [mm]",
                "heel lowest [mm]",
                "toe.z [mm]",
                "toe lowest [mm]",
            ],
            [
                [
                    f"{r['radius_factor']:g}",
                    r["objective"],
                    r["vertical_force_rmsd_n"],
                    *(
                        1e3 * value
                        for s in ("heel", "toe")
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
