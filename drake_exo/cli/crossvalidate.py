"""`drake-exo crossvalidate`: whether calibrating helps on trials not used.

Each calibration trial is left out in turn. Contact is calibrated on the others
(Phases A and B). The one left out is then predicted from its end states (Phase
C1), with calibrated cuffs and with nominal ones, and compared with its mats.
So the study needs a device with cuffs and mats.
"""

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

from drake_exo.calibration.clocks import Clock, clock_checks
from drake_exo.calibration.phases import check_has_cuffs, check_is_measured
from drake_exo.calibration.problem import check_distinct, has_encoders
from drake_exo.cli.calibrate import add_study_arguments
from drake_exo.errors import InputError
from drake_exo.files.output import (
    SOLVED,
    STOPPED_CODE,
    Check,
    Verdict,
    prepare_output_folder,
    write_json,
)
from drake_exo.report.gathering import clocks_table, format_table
from drake_exo.study import (
    Prediction,
    Study,
    calibrate_foot_ground,
    calibrate_interaction,
    predict,
    read_study,
    uncalibrated,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_study_arguments(parser, resume=False)


def run(args: argparse.Namespace) -> int:
    """Calibrate and predict fold by fold; each updates summary.json."""
    study = read_study(args.study, args.data_root)
    check_has_cuffs(study.model)
    trials = study.trials("calibration")
    if len(trials) < 2:
        raise InputError(
            f"{args.study}: has one trial with 'use: calibration', and none "
            "to leave out; give at least two"
        )
    check_is_measured(trials)
    check_distinct(trials)
    told = [t.name for t in trials if has_encoders(t)]
    with_mats = Counter(cuff for t in trials for cuff in t.cuffs)
    # The only trial with encoders stays: without it nothing is calibrated.
    trials = tuple(t for t in trials if [t.name] != told)
    if not any(t.cuffs for t in trials):
        raise InputError(
            f"{args.study}: no trial that can be left out has pressure mats to "
            "compare with; give 'pressure' for at least one, and 'encoders' "
            "for two"
        )
    plausible = study.gate("calibration", args.accept)
    alone = [c for t in trials for c in t.cuffs if with_mats[c] == 1]
    # What is not solved yet does not hold: a run may be killed at any time.
    folds = {t.name: _unsolved(t.name, False) for t in trials}
    clocks: list[Clock] = []
    notes: list[Check] = []
    folder = prepare_output_folder(args.out, args.force, reads=study.reads)
    with folder as out:
        for trial in trials:
            try:
                row, found = fold(study, trial.name)
            except KeyboardInterrupt:  # between solves
                row, found = _unsolved(trial.name, True), None
            folds[trial.name] = row
            rows = list(folds.values())
            if found is not None:
                clocks += found.clocks
                notes += clock_checks(found.result.problem.trials, found.clocks)
            solved = tuple(
                Check(SOLVED, f["success"], where=f"without {f['trial']}")
                for f in rows
            )
            checks = *plausible, *solved, *notes
            held = Verdict(checks, tuple(args.accept))
            summary = {"subject": study.name, "folds": rows}
            summary["clocks"] = [c.summary() for c in clocks]
            summary |= verdict(rows, alone) | held.summary()
            write_json(out / "summary.json", summary)
            if row["stopped"]:
                break
        code = folder.end(STOPPED_CODE if row["stopped"] else held.exit_code)
    print(_table(rows))
    if clocks:
        print(clocks_table(summary["clocks"]))
    if len(told) == 1:
        print(f"{told[0]} is never left out: only it has encoders")
    print(summary["sentence"])
    print(held.text())
    print(f"results in {folder.path}")
    return code


def fold(study: Study, name: str) -> tuple[dict, Prediction | None]:
    """Calibrate without one trial, then predict it.

    Returns:
        A row with trial; success of all solves; stopped, whether by the user;
        rmsd and rmsd_uncalibrated as of `audit.rmsd`, None if a solve failed.
        And the prediction with calibrated cuffs; None if a solve failed.
    """
    trials = study.trials("calibration")
    (left,) = (t for t in trials if t.name == name)
    others = [t for t in trials if t.name != name]

    def failed(solution):
        return _unsolved(name, solution.was_stopped), None

    ground = calibrate_foot_ground(study, others)
    if not ground.success:
        return failed(ground.solution)
    cuffs = calibrate_interaction(study, others, ground)
    if not cuffs.success:
        return failed(cuffs.solution)
    own = predict(study, left, cuffs.contact)
    if not own.success:
        return failed(own.solution)
    usual = predict(study, left, uncalibrated(study.model, ground))
    if not usual.success:
        return failed(usual.solution)
    # Nominal cuffs cannot tell a clock: both use the one found.
    measured = own.timed(left)
    row = {
        "trial": name,
        "success": True,
        "stopped": False,
        "rmsd": own.rmsd(measured),
        "rmsd_uncalibrated": usual.rmsd(measured),
    }
    return row, own


def _unsolved(name: str, stopped: bool) -> dict:
    return {
        "trial": name,
        "success": False,
        "stopped": stopped,
        "rmsd": None,
        "rmsd_uncalibrated": None,
    }


def verdict(folds: list[dict], alone: Sequence[str] = ()) -> dict:
    """Whether calibrating helps, and by how much.

    Args:
        folds: as `fold` gives them.
        alone: cuffs that only one trial has mats on.

    Returns:
        helps; ratio of the mean RMSD of normal forces, calibrated over
        nominal (both None if nothing can be compared); and a sentence.
    """
    own, usual = [], []
    for f in folds:
        if f["success"]:
            own += f["rmsd"]["interaction_n"].values()
            usual += f["rmsd_uncalibrated"]["interaction_n"].values()
    if not own:
        sentence = "nothing can be compared: no fold with mats was solved"
        return {"helps": None, "ratio": None, "sentence": sentence}
    ratio = float(np.mean(own) / np.mean(usual))
    better = sum(a < b for a, b in zip(own, usual, strict=True))
    word = "helps" if ratio < 1.0 else "does not help"
    sentence = (
        f"calibrating {word}: normal forces of trials left out are off by "
        f"{np.mean(own):.1f} N instead of {np.mean(usual):.1f} N with nominal "
        f"cuffs (means of {len(own)}, of which {better} are nearer; ratio "
        f"{ratio:.2f})"
    )
    if alone:
        sentence += (
            f"; only one trial has mats of {' and '.join(alone)}, and without "
            "it nothing tells their force"
        )
    return {"helps": ratio < 1.0, "ratio": ratio, "sentence": sentence}


def _table(folds: list[dict]) -> str:
    rows = []
    for f in folds:
        if not f["success"]:
            rows.append([f["trial"], "not solved", None, None])
            continue
        usual = f["rmsd_uncalibrated"]["interaction_n"]
        rows += [
            [f["trial"], cuff, value, usual[cuff]]
            for cuff, value in f["rmsd"]["interaction_n"].items()
        ]
    return format_table(
        ["left out", "cuff", "calibrated [N]", "uncalibrated [N]"], rows
    )
