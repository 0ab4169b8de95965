"""`drake-exo predict`: movement and interaction of trials not calibrated on.

Each trial with `use: prediction` is predicted by itself from its initial and
final state. This is Phase C1; with --scale-interaction 1.4 it is Phase C2.
"""

import argparse
import importlib
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import FunctionType

from pydrake.systems.framework import System

from drake_exo.calibration.audit import rmsd, spread
from drake_exo.calibration.clocks import Clock, phase_checks
from drake_exo.calibration.results import solve_summary, write_contact
from drake_exo.calibration.solving import forget
from drake_exo.cli import above_zero
from drake_exo.cli.calibrate import (
    STOPPED_CODE,
    add_study_arguments,
    finished,
    inputs,
    print_remarks,
    report_failure,
    to_resume,
)
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import Design, read_design
from drake_exo.designing import on_design
from drake_exo.errors import InputError, reason
from drake_exo.files.output import (
    SOLVED,
    Check,
    Verdict,
    prepare_output_folder,
    read_json,
    stored,
    write_json,
    write_text,
)
from drake_exo.measurement.trial import Trial
from drake_exo.nlp.ipopt import STOPPED_BY_USER
from drake_exo.report.figures import draw_figures
from drake_exo.report.gathering import (
    audit_table,
    clocks_table,
    format_table,
    not_solved_uncalibrated,
    rmsd_table,
)
from drake_exo.study import (
    Prediction,
    Study,
    find_clocks,
    predict,
    read_study,
    uncalibrated,
    write_inputs,
)

# Errors of an angle above 5 deg may mislead who reads it [deg] (McGinley et
# al. 2009, The reliability of three-dimensional kinematic gait measurements).
_MISLEADING = 5.0

# Former name of the example, which may be in somebody's scripts.
_FORMER = {
    "drake_exo.forces.assist_controller:AssistController": (
        "drake_exo:AssistController"
    )
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_study_arguments(parser)
    parser.add_argument(
        "--calibration",
        type=Path,
        required=True,
        metavar="DIR",
        help="results of 'drake-exo calibrate'",
    )
    parser.add_argument(
        "--scale-interaction",
        type=above_zero,
        default=1.0,
        metavar="FACTOR",
        help="multiply stiffness and damping of the cuffs by this; 1.4 is "
        "Phase C2",
    )
    parser.add_argument(
        "--objective",
        choices=["tracking", "comfort"],
        help="used instead of the study's prediction.objective",
    )
    parser.add_argument(
        "--torque-limit",
        type=above_zero,
        metavar="NM",
        help="used instead of the study's prediction.torque_limit_nm",
    )
    parser.add_argument(
        "--controller",
        metavar="MODULE:NAME",
        help="a stateless LeafSystem that gives the exoskeleton's torques, "
        "such as drake_exo:AssistController; without it the measured torques "
        "are tracked",
    )
    parser.add_argument(
        "--design",
        type=Path,
        metavar="DIR",
        help="results of 'drake-exo design': predict with its cuffs, and with "
        "the device's torques of its forecast",
    )


def run(args: argparse.Namespace) -> int:
    """Predict every trial, audit, and write everything to --out."""
    changes = {
        "objective": args.objective,
        "torque_limit_nm": args.torque_limit,
    }
    changes = {k: v for k, v in changes.items() if v is not None}
    controller = load_controller(args.controller)
    study = read_study(args.study, args.data_root)
    study.prediction = replace(study.prediction, **changes)
    reads = [*study.reads, args.calibration, args.design]
    # Bad input is refused before a folder is made, or hours of work.
    worn = None if args.design is None else read_design(args.design)
    contact, checks = study.calibrated(
        args.calibration, args.accept, study.trials("prediction")
    )
    checks += study.gate("prediction", args.accept)
    print_remarks(study, "prediction")
    clocks = usual = None
    if worn is not None:
        checks += extrapolations(args.design)
        # By the cuffs that were worn, not the design's.
        clocks = find_clocks(study, study.trials("prediction"), contact)
        usual = worn.contact(uncalibrated(study.model, contact))
        study, contact = on_design(study, contact, worn, clocks)
    folder = prepare_output_folder(args.out, args.force, args.resume, reads)
    with folder as out:
        code = write_predictions(
            study,
            contact,
            out,
            scale_interaction=args.scale_interaction,
            controller=controller,
            controller_name=args.controller,
            resume=args.resume,
            checks=checks,
            accepted=args.accept,
            clocks=clocks,
            usual=usual,
            worn=worn,
        )
        folder.end(code)
    print(f"results in {folder.path}{to_resume(code)}")
    return code


def extrapolations(design: Path) -> list[Check]:
    """Notes of a design's results that it is beyond what was calibrated."""
    path = design / "summary.json"
    if not path.is_file():  # a design.yaml alone
        return []
    found = read_json(path, "run design again")
    verdict = stored(found, path) or Verdict(())
    return [c for c in verdict.checks if c.name == "design.extrapolation"]


def write_predictions(
    study: Study,
    contact: ContactModel,
    out: Path,
    *,
    scale_interaction: float = 1.0,
    controller: System | None = None,
    controller_name: str | None = None,
    resume: bool = False,
    checks: Sequence[Check] = (),
    accepted: Sequence[str] = (),
    clocks: Sequence[Clock] | None = None,
    usual: ContactModel | None = None,
    worn: Design | None = None,
) -> int:
    """Predict every trial for prediction to a folder; returns the exit code.

    `usual` is the contact to compare with, by default nominal cuffs. It is
    given with a design, `worn`, in whose device nothing was measured.
    """
    trials = study.trials("prediction")
    of = inputs(
        study,
        "prediction",
        study.prediction,
        contact,
        scale=scale_interaction,
        controller=controller_name,
    )
    done = finished(out, of) if resume else None
    if done is not None:
        return done.exit_code
    designed = usual is not None
    usual = usual or uncalibrated(study.model, contact)
    how = {"scale_interaction": scale_interaction, "controller": controller}
    found: list[Prediction] = []
    baseline: list[Prediction | None] = []
    checks, audits, stopped = list(checks), [], False
    refused: InputError | None = None
    for trial in trials:
        folder = out / f"unfinished_{trial.name}"
        folder.mkdir(exist_ok=True)
        beside, audited = None, []
        try:
            prediction = predict(
                study,
                trial,
                contact,
                folder=folder,
                resume=resume,
                clocks=clocks,
                **how,
            )
            if prediction.success:
                audited = [prediction.audit()]
                if study.model.cuffs:
                    # Nominal cuffs cannot tell a clock.
                    beside = predict(
                        study, trial, usual, near=prediction, clocks=(), **how
                    )
                    stopped = beside.solution.was_stopped
        except KeyboardInterrupt:
            # Between solves; what is finished is written all the same.
            stopped = True
            checks.append(Check(SOLVED, False, where=trial.name))
            break
        except InputError as error:
            if not found:
                raise  # what a problem refuses leaves no folder behind
            # As above: the hours of work before it are kept.
            refused = error
            said = str(error)
            checks.append(Check(SOLVED, False, where=trial.name, sentence=said))
            break
        finally:
            if not any(folder.iterdir()):
                folder.rmdir()
        if not prediction.success:
            print(trial.name, end=": ")
            stopped = report_failure(prediction.solution) == STOPPED_CODE
        found.append(prediction)
        baseline.append(beside)
        audits += audited
        checks += phase_checks(prediction.result, audited, prediction.clocks)
        if stopped:
            break
    if refused is not None:
        trials = trials[: len(found)]
    write_inputs(out, study.model, trials)
    write_contact(out, contact.scaled(scale_interaction))
    summary = {
        "inputs": of,
        "scale_interaction": scale_interaction,
        "controller": controller_name,
        "design": worn and {j: asdict(x) for j, x in worn.given.items()},
        **_summary(study, found, trials, refused),
    }
    if not designed:
        checks += [_accuracy(row) for row in summary["rmsd"]]
    verdict = Verdict(tuple(checks), tuple(accepted))
    summary |= verdict.summary()
    good = [
        (p, b if b is not None and b.success else None, p.timed(t))
        for p, b, t in zip(found, baseline, trials, strict=False)
        if p.success
    ]
    bands = [p.bands() for p, _, _ in good]
    summary["rmsd_uncalibrated"] = [
        None if b is None else b.rmsd(t) for _, b, t in good
    ]
    summary["band_coverage"] = [
        band.coverage(p, t)
        for band, (p, _, t) in zip(bands, good, strict=True)
        if band is not None
    ]
    summary["audit"] = [audit.summary() for audit in audits]
    summary["clocks"] = [c.summary() for p in found for c in p.clocks]
    if good:
        _write(out, good, bands, summary, verdict, designed)
        print(audit_table(summary["audit"]))
    if summary["clocks"]:
        print(clocks_table(summary["clocks"]))
    write_json(out / "summary.json", summary)
    is_whole = not stopped and refused is None
    for prediction in found:
        folder = out / f"unfinished_{prediction.name}"
        # Not before, nor if others are to come: --resume goes on from there.
        if prediction.success and folder.is_dir() and is_whole:
            forget(folder)
            folder.rmdir()
    print(verdict.text())
    if refused is not None:
        print(f"results in {out}")
        raise refused
    return STOPPED_CODE if stopped else verdict.exit_code


def load_controller(name: str | None) -> System | None:
    """Make the controller that MODULE:NAME names; None if `name` is None.

    Modules of the working folder are found as well.

    Raises:
        InputError: there is no such thing, or it cannot be made.
    """
    if name is None:
        return None
    name = _FORMER.get(name, name)
    if not re.fullmatch(r"[\w.]+:\w+", name):
        raise InputError(f"--controller is {name!r}; write it as MODULE:NAME")
    module, _, attribute = name.partition(":")
    remedy = (
        "give the name of a class or function without arguments, in a module "
        "of this folder or one that Python finds, that makes a LeafSystem"
    )
    here = str(Path.cwd())
    if here not in sys.path:  # an installed command does not look there
        sys.path.append(here)
    try:
        make = getattr(importlib.import_module(module), attribute)
        if not isinstance(make, type | FunctionType):
            raise TypeError("no class or function")
        found = make()
    except (Exception, SystemExit) as error:  # it is the user's own code
        raise InputError(
            f"--controller {name}: cannot be made ({reason(error)}); {remedy}"
        ) from error
    if not isinstance(found, System):
        raise InputError(
            f"--controller {name}: is not a Drake system; {remedy}"
        )
    return found


def _accuracy(row: dict) -> Check:
    """Whether a prediction's angles are near the measured ones."""
    joint, off = max(row["angles_deg"].items(), key=lambda item: item[1])
    return Check(
        "accuracy",
        off <= _MISLEADING,
        off,
        _MISLEADING,
        "deg",
        f"{row['trial']}, {joint}",
        "the predicted angle differs this much (RMSD) from the measured one: "
        "the equations are solved, but the person moved in another way",
        "note",
    )


def _summary(
    study: Study,
    found: list[Prediction],
    trials: Sequence[Trial],
    refused: InputError | None,
) -> dict:
    solves = [{"trial": p.name, **solve_summary(p.solution)} for p in found]
    failed = [s["status"] for s in solves if not s["success"]]
    if refused is not None:
        failed.append(str(refused))
    elif len(solves) < len(trials):
        failed.append(STOPPED_BY_USER)
    # On the clocks that were found.
    timed = [p.timed(t) for p, t in zip(found, trials, strict=False)]
    total = {
        key: sum(s[key] for s in solves)
        for key in (
            "iterations",
            "build_seconds",
            "solve_seconds",
            "num_variables",
            "num_constraints",
            "jacobian_nonzeros",
        )
    }
    return {
        "phase": "prediction",
        "subject": study.name,
        "objective": study.prediction.objective,
        "success": not failed,
        "status": failed[0] if failed else "solved",
        **total,
        "solves": solves,
        "settings": asdict(study.prediction),
        "parameters": [],
        "rmsd": [
            rmsd(p, t) for p, t in zip(found, timed, strict=True) if p.success
        ],
        "measured_sd": spread(
            [*timed, *trials[len(timed) :]], study.model.tree
        ),
        "starts_from": (
            "a state of their own, which ends them with legs exchanged"
            if study.prediction.ends == "periodic"
            else "their first measured state"
            if study.model.assembly.human.sides
            else "the measured chair force"
            if any(t.chair_shares for t in trials if _part(t) != "sit")
            else "seat-off or later, without a chair"
            if all(_part(t) == "rise" for t in trials)
            else "their first measured state"
        ),
    }


def _part(trial: Trial) -> str | None:
    """What a trial was cut from a recording as."""
    return trial.provenance.get("part", {}).get("from")


def _source_of_torques(summary: dict, found: Trial) -> str:
    """A line on the device's torques, where it is not plain whose they are."""
    designed, controlled = summary["design"], summary["controller"]
    if controlled:
        of = "the controller gives the device's torques"
    elif summary["settings"]["ends"] == "periodic" and found.coordinates.device:
        of = (
            "a step without data finds the device's torques as if it had drives"
        )
    else:
        return ""
    if designed:
        of += ": the design's assistance and gains have no effect"
    return "" if controlled and not designed else f"\n{of}"


def _write(
    out: Path,
    good: list[tuple],
    bands,
    summary: dict,
    verdict: Verdict,
    designed: bool,
) -> None:
    """Write trajectories, tables and figures of the trials that were solved."""
    for prediction, usual, _ in good:
        prediction.write(out, verdict)
        if usual is not None:
            usual.save(out / f"uncalibrated_{usual.name}")
    text = rmsd_table(summary["rmsd"], summary["measured_sd"])
    usual = [r for r in summary["rmsd_uncalibrated"] if r is not None]
    if usual:
        failed = not_solved_uncalibrated(summary)
        left = f" (not solved: {', '.join(failed)})" if failed else ""
        text += f"\n\nthe same with uncalibrated cuffs{left}\n"
        text += rmsd_table(usual)
    text += f"\nmovements start from {summary['starts_from']}"
    if designed:
        text += (
            "\nmeasured in the device of today: these differences include what "
            "the design changes"
        )
    text += _source_of_torques(summary, good[0][0])
    write_text(out / "rmsd.txt", text, verdict.mark)
    print(text)
    rows = [
        [
            s["trial"],
            str(s["iterations"]),
            s["build_seconds"],
            s["solve_seconds"],
            s["status"],
        ]
        for s in summary["solves"]
    ]
    print(format_table(["trial", "iterations", "build s", "solve s", ""], rows))
    draw_figures(
        out,
        [p for p, _, _ in good],
        [t for _, _, t in good],
        [b for _, b, _ in good],
        bands,
        verdict.mark,
    )
