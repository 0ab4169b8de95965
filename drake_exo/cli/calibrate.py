"""`drake-exo calibrate`: from a study file to calibrated contact.

Without --phase the foot-ground contact (Phase A, written to the folder
foot_ground) and then the interaction of human and exoskeleton (Phase B).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from drake_exo.calibration.audit import audit_trials
from drake_exo.calibration.inputs import CalibrationInputs, load_inputs
from drake_exo.calibration.pareto import pareto_front
from drake_exo.calibration.problem import PhaseProblem, PhaseResult
from drake_exo.calibration.results import (
    parameters_table,
    phase_summary,
    read_calibration,
    write_model,
    write_parameters,
    write_trajectories,
)
from drake_exo.calibration.solving import report_failure, solve
from drake_exo.calibration.uncertainty import uncertainty
from drake_exo.files.output import prepare_output_folder, write_json
from drake_exo.report.figures import draw_figures
from drake_exo.report.tables import rmsd_table

FOOT_GROUND = "foot_ground"


def add_parser(subparsers) -> None:
    """Add `calibrate` to the command line."""
    parser = subparsers.add_parser(
        "calibrate",
        help="calibrate contact models from a study's recordings",
        description=__doc__,
    )
    parser.add_argument(
        "--phase",
        choices=["foot-ground", "interaction"],
        help="one phase alone; interaction calibrates the foot-ground "
        "contact first unless --calibration gives it",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="DIR",
        help="results of --phase foot-ground to build on",
    )
    parser.add_argument(
        "--no-front",
        action="store_true",
        help="skip the Pareto front of kinematics against forces, which "
        "--phase foot-ground draws",
    )
    add_study_arguments(parser)
    parser.set_defaults(run=run)


def add_study_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments that all commands on a study share."""
    parser.add_argument("study", type=Path, metavar="STUDY.yaml")
    parser.add_argument(
        "--data-root",
        type=Path,
        help="folder that the study's relative paths start from; by default "
        "the study file's own",
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--force", action="store_true", help="replace results in --out"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue in --out where a run was cut off",
    )


def run(args: argparse.Namespace) -> int:
    """Calibrate, audit, and write everything to --out."""
    inputs = load_inputs(args.study, args.data_root)
    only_foot = args.phase == "foot-ground" or (
        args.phase is None and inputs.study.model != "coupled"
    )
    contact = None
    if not only_foot:
        inputs.check_has_exoskeleton()
        if args.calibration is not None:
            contact = read_calibration(args.calibration)
    with prepare_output_folder(args.out, args.force, args.resume) as out:
        if args.resume and _succeeded(out / "summary.json"):
            print(f"{args.out} is complete; nothing to resume")
            return 0
        if only_foot:
            front = not args.no_front
            code = _foot_ground(inputs, out, args.resume, front)
        else:
            code = _both(inputs, out, args.resume, contact)
    if not code:
        print(f"results in {args.out}")
    return code


def _both(inputs, out: Path, resume: bool, contact) -> int:
    """Phase A, unless its contact is given, then Phase B."""
    foot = {}
    if contact is None:
        folder = out / FOOT_GROUND
        folder.mkdir(exist_ok=True)
        done = folder / "summary.json"
        if not (resume and _succeeded(done)):
            code = _foot_ground(inputs, folder, resume, front=False)
            if code:
                return code
        foot = json.loads(done.read_text("utf-8"))
        contact = read_calibration(folder)
    problem = inputs.interaction_problem(contact)
    extra = {"foot_ground": foot} if foot else {}
    return _calibrate(inputs, problem, "interaction", out, resume, extra)


def _succeeded(summary: Path) -> bool:
    return summary.is_file() and json.loads(summary.read_text("utf-8")).get(
        "success", False
    )


def _foot_ground(inputs, out: Path, resume: bool, front: bool) -> int:
    def more(result):
        if front and inputs.settings.front:
            return {"front": pareto_front(out, inputs, result)}
        return {}

    return _calibrate(
        inputs, inputs.problem(), "foot-ground", out, resume, {}, more
    )


def _calibrate(
    inputs: CalibrationInputs,
    problem: PhaseProblem,
    phase: str,
    out: Path,
    resume: bool,
    extra: dict,
    more=lambda result: {},
) -> int:
    """Solve one phase and write its results; returns the exit code."""
    write_model(out, inputs.model)
    for trial in inputs.loaded:
        trial.save(out / f"measured_{trial.name}")
    result = solve(problem, f"calibrate {phase}", out, resume)
    summary = phase_summary(
        phase, inputs.study.subject.name, result, inputs.trials
    )
    summary |= extra
    if result.solution.success:
        _add_intervals(summary["parameters"], problem, result, inputs)
    _write(out, problem, result, inputs, summary)
    if not result.solution.success:
        write_json(out / "summary.json", summary)
        return report_failure(result)
    summary["audit"] = audit_trials(
        inputs.model, inputs.study.gravity_m_s2, [(problem, result)]
    )
    summary |= more(result)
    write_json(out / "summary.json", summary)
    return 0


def _add_intervals(rows, problem, result, inputs) -> None:
    """95 % intervals of the free parameters, where they can be told."""
    filtered = inputs.study.filter
    found = uncertainty(problem, result, filtered.cutoff_hz, filtered.order)
    if found is None:
        return
    by_name = {row["name"]: row for row in rows}
    for name, sd, pull, half, known in zip(
        found.names,
        found.sd,
        found.pull,
        found.half_width,
        found.identifiable,
        strict=True,
    ):
        by_name[name] |= {
            "sd": sd,
            "pull": pull,
            "half_width_95": half,
            "identifiable": bool(known),
        }


def _write(
    out: Path,
    problem: PhaseProblem,
    result: PhaseResult,
    inputs: CalibrationInputs,
    summary: dict,
) -> None:
    write_trajectories(out, result.trajectories)
    write_parameters(out, problem, result)
    print(parameters_table(summary["parameters"]))
    text = rmsd_table(summary["rmsd"], summary["measured_sd"])
    (out / "rmsd.txt").write_text(text + "\n", encoding="utf-8")
    print(text)
    draw_figures(out, result.trajectories, inputs.trials)
