"""`drake-exo calibrate`: from a study file to calibrated contact.

Without --phase it calibrates the foot-ground contact (Phase A, written to the
subfolder foot_ground) and then the interaction of human and exoskeleton
(Phase B). For a model without cuffs it runs Phase A only.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drake_exo.calibration.phases import (
    check_has_cuffs,
    check_is_measured,
    pareto_front,
)
from drake_exo.calibration.results import read_calibration
from drake_exo.cli import add_accept, add_out, add_study
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.files.output import (
    FAILS_CODE,
    NOT_SOLVED_CODE,
    STOPPED_CODE,
    UNSOLVED,
    Check,
    Verdict,
    checksum,
    prepare_output_folder,
    read_json,
    save_figure,
    stored,
    write_json,
)
from drake_exo.measurement.exoskeleton import spring_stiffness
from drake_exo.measurement.quality import assess
from drake_exo.measurement.settings import Use
from drake_exo.nlp.ipopt import Solution
from drake_exo.report.figures import front_figure
from drake_exo.report.gathering import (
    audit_table,
    clocks_table,
    front_table,
    parameters_table,
    rmsd_table,
)
from drake_exo.study import (
    Calibration,
    RecordedStudy,
    Study,
    calibrate_foot_ground,
    calibrate_interaction,
    read_study,
    write_inputs,
)

FOOT_GROUND, SUMMARY = "foot_ground", "summary.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--phase",
        choices=["foot-ground", "interaction"],
        help="calibrate only this phase; interaction calibrates the "
        "foot-ground contact first unless --calibration gives it",
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
        help="skip the Pareto front of kinematics against forces, which is "
        "drawn if only the foot-ground contact is calibrated",
    )
    add_study_arguments(parser)


def add_study_arguments(
    parser: argparse.ArgumentParser, resume: bool = True
) -> None:
    """Add the arguments that all commands on a study share.

    Args:
        parser: of the command.
        resume: whether it can continue where it was cut off.
    """
    add_study(parser)
    add_out(parser, required=True)
    add_accept(parser)
    if resume:
        parser.add_argument(
            "--resume",
            action="store_true",
            help="continue a run that was cut off, in --out",
        )


def print_remarks(study: RecordedStudy, use: Use) -> None:
    """Print what `check` remarks on the trials of a use."""
    for remark in assess(study.subject, study.trials(use)).remarks:
        print(f"! {remark}")


def run(args: argparse.Namespace) -> int:
    """Calibrate, audit, and write everything to --out."""
    study = read_study(args.study, args.data_root)
    # Bad input is refused before a folder is made.
    only_foot = args.phase == "foot-ground" or (
        args.phase is None and not study.model.cuffs
    )
    contact = None
    if only_foot and args.calibration is not None:
        raise InputError(
            "--calibration is of no use to the foot-ground phase, which is "
            "the first; leave it out"
        )
    if not only_foot:
        check_has_cuffs(study.model)
        check_is_measured(study.trials("calibration"))
    checks = list(study.gate("calibration", args.accept))
    print_remarks(study, "calibration")
    if not only_foot and args.calibration is not None:
        contact, made_of = study.calibrated(args.calibration, args.accept)
        checks += made_of
    folder = prepare_output_folder(
        args.out, args.force, args.resume, [*study.reads, args.calibration]
    )
    drawn = bool(study.foot_ground.front) and not args.no_front
    front = drawn and study.sole is None
    with folder as out:
        if only_foot:
            code = write_foot_ground(
                study, out, args.resume, front, checks, args.accept
            )
        else:
            code = write_interaction(
                study, out, args.resume, contact, checks, args.accept
            )
        folder.end(code)
    print(f"results in {folder.path}{to_resume(code)}")
    return code


def write_foot_ground(
    study: Study,
    out: Path,
    resume: bool = False,
    front: bool = False,
    checks: Sequence[Check] = (),
    accepted: Sequence[str] = (),
) -> int:
    """Run Phase A, write it to a folder; returns the exit code."""
    of = inputs(study, "calibration", study.foot_ground)
    points = len(study.foot_ground.front_factors) if front else 0
    done = finished(out, of, points) if resume else None
    if done is not None:
        return done.exit_code
    write_inputs(out, study.model, study.trials("calibration"))
    found = calibrate_foot_ground(study, folder=out, resume=resume)
    return _write(found, out, {"inputs": of}, front, checks, accepted)


def write_interaction(
    study: Study,
    out: Path,
    resume: bool = False,
    contact: ContactModel | None = None,
    checks: Sequence[Check] = (),
    accepted: Sequence[str] = (),
) -> int:
    """Run Phase A, unless its contact is given, then Phase B; the exit code."""
    of = inputs(study, "calibration", study.interaction, contact)
    done = finished(out, of) if resume else None
    if done is not None:
        return done.exit_code
    more = {"inputs": of}
    if contact is None:
        folder = out / FOOT_GROUND
        folder.mkdir(exist_ok=True)
        code = write_foot_ground(study, folder, resume, False, checks, accepted)
        if code not in (0, FAILS_CODE):
            return code
        again = "run the command again"
        more["foot_ground"] = read_json(folder / SUMMARY, again)
        contact = read_calibration(folder).contact
        # A check that fails in Phase A fails for Phase B as well.
        found = stored(more["foot_ground"]).checks
        checks = [
            *checks,
            *(c for c in found if not c.holds and c not in checks),
        ]
    write_inputs(out, study.model, study.trials("calibration"))
    found = calibrate_interaction(
        study, contact=contact, folder=out, resume=resume
    )
    return _write(found, out, more, False, checks, accepted)


def inputs(study: Study, use: Use, settings, contact=None, **more) -> str:
    """Hash of all that results are computed from.

    Args:
        study: with its name and its trials of the use.
        use: calibration or prediction.
        settings: of the phase; those of Phase A count as well, and for a
            prediction those of Phase B, which find its clocks, and the
            device's springs.
        contact: calibrated before, if any.
        more: whatever else counts, by name.
    """
    trials = study.trials(use)
    clocks = [(t.lags_s, [*t.provenance.get("clocks", ())]) for t in trials]
    trials = [replace(t, provenance={}) for t in trials]
    known = contact and [contact.values(), contact.posterior]
    said = [study.foot_ground, settings]
    if use == "prediction":
        springs = spring_stiffness(study.device, study.model.coordinates)
        said += [study.interaction, springs]
    who = study.name, study.model, study.sole
    return checksum([use, who, said, trials, clocks, known, more])


def finished(folder: Path, of: str, points: int = 0) -> Verdict | None:
    """Verdict of a finished run in a folder; None if there is more to do.

    Args:
        folder: of the run.
        of: hash of what it must be computed from, see `inputs`.
        points: number of points of its front, if it draws one.

    Raises:
        InputError: it was computed from something else.
    """
    path = folder / SUMMARY
    if not path.is_file():
        return None
    summary = read_json(path, "leave out --resume to start afresh")
    found = stored(summary, path)
    if found is None or found.word == UNSOLVED:
        return None
    if summary.get("inputs") != of:
        raise InputError(
            f"{folder}: is complete, of another study or other settings; "
            "choose another folder for --out, or replace it with --force "
            "instead of --resume"
        )
    if "front" in summary and len(summary["front"]) < points:
        return None
    print(f"{folder} is complete and kept as it is")
    return found


def _write(
    found: Calibration,
    out: Path,
    more: dict,
    front: bool,
    checks: Sequence[Check],
    accepted: Sequence[str],
) -> int:
    """Write and print what a phase found; returns the exit code."""
    verdict = found.verdict(checks, accepted)
    summary, stopped = found.write(out, verdict) | more, False
    print(parameters_table(summary["parameters"]))
    if summary["clocks"]:
        print(clocks_table(summary["clocks"]))
    print(rmsd_table(summary["rmsd"], summary["measured_sd"]))
    if found.success:
        print(audit_table(summary["audit"]))
        if front:
            rows = summary["front"] = pareto_front(found.result)
            stopped = len(rows) < len(found.study.foot_ground.front_factors)
            print("Pareto front of kinematics against forces")
            print(front_table(rows) + told_stopped(stopped, len(rows)))
            save_figure(out / "front.png", front_figure(rows), verdict.mark)
    write_json(out / SUMMARY, summary)
    print(verdict.text())
    if not found.success:
        return report_failure(found.solution)
    return STOPPED_CODE if stopped else verdict.exit_code


def told_stopped(stopped: bool, count: int) -> str:
    """Line to add to a front's table if the user stopped it, else ""."""
    return f"\nstopped by the user after {count} points" if stopped else ""


def to_resume(code: int) -> str:
    """What to add where results are told, if the user stopped the run."""
    return "; --resume goes on from there" if code == STOPPED_CODE else ""


def report_failure(
    solution: Solution,
    kept: str = "What was reached so far is written, marked as failed.",
) -> int:
    """Say why a solve failed, and what is kept; returns the exit code."""
    print(
        f"not solved: {solution.status} after {solution.iterations} "
        f"iterations. {solution.explain()} {kept}"
    )
    return STOPPED_CODE if solution.was_stopped else NOT_SOLVED_CODE
