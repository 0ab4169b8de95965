"""`drake-exo calibrate`: from a study file to calibrated contact.

Without --phase the foot-ground contact (Phase A, written to the folder
foot_ground) and then the interaction of human and exoskeleton (Phase B).
"""

import argparse
import json
from pathlib import Path

from drake_exo.calibration.interaction import check_has_cuffs
from drake_exo.calibration.pareto import pareto_front
from drake_exo.calibration.results import read_contact
from drake_exo.cli.options import add_accept
from drake_exo.contact.parameters import ContactModel
from drake_exo.files.output import prepare_output_folder, write_json
from drake_exo.nlp.ipopt import Solution
from drake_exo.report.figures import front_figure, save_figure
from drake_exo.report.tables import (
    audit_table,
    front_table,
    parameters_table,
    rmsd_table,
)
from drake_exo.study import (
    Calibration,
    Study,
    calibrate_foot_ground,
    calibrate_interaction,
    read_study,
    write_inputs,
)

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


def add_study_arguments(
    parser: argparse.ArgumentParser, resume: bool = True
) -> None:
    """Arguments that all commands on a study share.

    Args:
        parser: of the command.
        resume: whether it can continue where it was cut off.
    """
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
    add_accept(parser)
    if resume:
        parser.add_argument(
            "--resume",
            action="store_true",
            help="continue in --out where a run was cut off",
        )


def run(args: argparse.Namespace) -> int:
    """Calibrate, audit, and write everything to --out."""
    study = read_study(args.study, args.data_root)
    # Bad input ends before a folder is made.
    study.gate("calibration", args.accept)
    only_foot = args.phase == "foot-ground" or (
        args.phase is None and not study.model.cuffs
    )
    contact = None
    if not only_foot:
        check_has_cuffs(study.model)
        if args.calibration is not None:
            contact = read_contact(args.calibration)
    with prepare_output_folder(args.out, args.force, args.resume) as out:
        if args.resume and _succeeded(out):
            print(f"{args.out} is complete; nothing to resume")
            return 0
        if only_foot:
            front = not args.no_front and bool(study.foot_ground.front)
            code = write_foot_ground(study, out, args.resume, front)
        else:
            code = write_interaction(study, out, args.resume, contact)
    if not code:
        print(f"results in {args.out}")
    return code


def write_foot_ground(
    study: Study, out: Path, resume: bool = False, front: bool = False
) -> int:
    """Phase A into a folder; returns the exit code."""
    write_inputs(out, study.model, study.trials("calibration"))
    found = calibrate_foot_ground(study, folder=out, resume=resume)
    return _write(found, out, {}, front)


def write_interaction(
    study: Study,
    out: Path,
    resume: bool = False,
    contact: ContactModel | None = None,
) -> int:
    """Phase A, unless its contact is given, then Phase B; as above."""
    more = {}
    if contact is None:
        folder = out / FOOT_GROUND
        folder.mkdir(exist_ok=True)
        if not (resume and _succeeded(folder)):
            code = write_foot_ground(study, folder, resume)
            if code:
                return code
        text = (folder / "summary.json").read_text("utf-8")
        more = {"foot_ground": json.loads(text)}
        contact = read_contact(folder)
    write_inputs(out, study.model, study.trials("calibration"))
    found = calibrate_interaction(
        study, contact=contact, folder=out, resume=resume
    )
    return _write(found, out, more)


def _succeeded(folder: Path) -> bool:
    path = folder / "summary.json"
    return path.is_file() and json.loads(path.read_text("utf-8")).get(
        "success", False
    )


def _write(
    found: Calibration, out: Path, more: dict, front: bool = False
) -> int:
    """Write what a phase found and say it; returns the exit code."""
    summary = found.summary() | more
    found.write(out, summary)
    print(parameters_table(summary["parameters"]))
    print(rmsd_table(summary["rmsd"], summary["measured_sd"]))
    if not found.success:
        return report_failure(found.solution)
    summary["audit"] = [audit.summary() for audit in found.audit()]
    print(audit_table(summary["audit"]))
    if front:
        summary["front"] = pareto_front(found.result)
        print("Pareto front of kinematics against forces")
        print(front_table(summary["front"]))
        save_figure(out / "front.png", front_figure(summary["front"]))
    write_json(out / "summary.json", summary)
    return 0


def report_failure(solution: Solution) -> int:
    """Say why a solve failed; returns the command's exit code."""
    print(
        f"not solved: {solution.status} after {solution.iterations} "
        f"iterations. {solution.explain()} What was reached so far is "
        "written, marked as failed."
    )
    return 130 if solution.was_stopped else 1
