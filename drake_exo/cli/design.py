"""`drake-exo design`: cuffs and assistance for the people who wear them.

Give a study for each wearer, and a --calibration for each study in the same
order; `design` in the first study holds for all. The design is optimised for
the movements of their trials with `use: prediction`. design.yaml in --out holds
what is to be built: `drake-exo predict --design` and `drake-exo lab --design`
read it.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

from drake_exo.cli import add_accept, add_out, add_study
from drake_exo.cli.calibrate import report_failure, told_stopped
from drake_exo.contact.parameters import ContactModel
from drake_exo.designed import Designed
from drake_exo.designing import SHARES, built, design, pareto_front
from drake_exo.errors import InputError
from drake_exo.files.output import (
    STOPPED_CODE,
    Check,
    prepare_output_folder,
    save_figure,
    write_json,
)
from drake_exo.report.figures import design_front_figure
from drake_exo.report.gathering import format_table
from drake_exo.study import (
    Calibration,
    RecordedStudy,
    Study,
    calibrate_interaction,
    read_study,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_study(parser, nargs="+")
    parser.add_argument(
        "--calibration",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="results of 'drake-exo calibrate', one for each study",
    )
    add_out(parser, required=True)
    parser.add_argument(
        "--parts",
        action="store_true",
        help="also tell what places, straps and assistance reach each alone",
    )
    parser.add_argument(
        "--front",
        action="store_true",
        help="also draw the Pareto front of the norm of forces against the "
        "device's work",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="also build the design in the virtual laboratory that the study "
        "comes from, and measure it there; without --calibration, calibrate "
        "first",
    )
    add_accept(parser)


def run(args: argparse.Namespace) -> int:
    """Design, forecast, and write everything to --out."""
    files = set(map(os.path.realpath, args.study))
    if len(files) < len(args.study):
        raise InputError(
            f"{len(args.study)} studies, but {len(files)} files; give each "
            "wearer once"
        )
    studies = [read_study(path, args.data_root) for path in args.study]
    if args.verify and len(studies) > 1:
        raise InputError("--verify takes one study: one laboratory builds it")
    if not args.verify and not args.calibration:
        raise InputError(
            "--calibration is missing; give the --out folder of "
            "'drake-exo calibrate'"
        )
    if args.calibration and len(args.calibration) != len(studies):
        raise InputError(
            f"{len(args.calibration)} times --calibration for {len(studies)} "
            "studies; give one for each, in the same order"
        )
    # Bad input is refused before a folder is made.
    use = "prediction" if args.calibration else None
    checks: list[Check] = []
    contacts: list[ContactModel | Calibration] = []
    for study in studies:
        checks += study.gate(use, args.accept)
        checks += without_effect(study)
    for study, folder in zip(studies, args.calibration, strict=False):
        contact, made_of = study.calibrated(
            folder, args.accept, study.trials("prediction")
        )
        contacts.append(contact)
        checks += made_of
    laboratory = None
    if args.verify:
        laboratory = _laboratory(args.study[0], studies[0])
    reads = [path for study in studies for path in study.reads]
    reads += args.calibration
    folder = prepare_output_folder(args.out, args.force, reads=reads)
    with folder as out:
        if not contacts:
            found = calibrate_interaction(studies[0])
            if not found.success:
                return folder.end(report_failure(found.solution))
            contacts = [found]
            checks += found.verdict().checks
        made = design(studies, contacts, parts=args.parts)
        made = replace(made, inputs=tuple(checks))
        verdict = made.write(out, args.accept)
        if not made.success:
            kept = "Its verdict is written, marked as failed, without a design."
            return folder.end(report_failure(made.solution, kept))
        if laboratory is not None and not made.stopped:
            made = _built(made, studies[0], laboratory, out)
            verdict = made.write(out, args.accept)
        print(made.table())
        stopped = made.stopped or (args.front and not _write_front(made, out))
        print(verdict.text())
        folder.end(STOPPED_CODE if stopped else verdict.exit_code)
    print(f"results in {folder.path}")
    return STOPPED_CODE if stopped else verdict.exit_code


def without_effect(study: Study) -> list[Check]:
    """A note where a study is to predict a step without data, else none."""
    if study.prediction.ends == "measured":
        return []
    return [
        Check(
            "design.ends",
            False,
            where=f"{study.name}, prediction.ends: periodic",
            sentence="has no effect, nor has the step's speed: a design is "
            "made for the movements as they were recorded",
            level="note",
        )
    ]


def _laboratory(path: Path, study: RecordedStudy) -> dict:
    """Seed, disturbances and kind of the laboratory that recorded a study."""
    from drake_exo.virtual_laboratory.campaign import protocol, read_about

    # The study may be a changed copy elsewhere, as in a batch with a sweep.
    about = read_about((study.root / study.file.standing.markers).parent)
    built = [m.name for m in protocol() if m.mode == "assisted"]
    for name in _windows(study):
        if name not in built:
            raise InputError(
                f"{path}: trials: {name!r} is for prediction, but --verify "
                f"builds {', '.join(built)}; give the others another use"
            )
    return about


_WINDOW = "rise", "sit", "seated_s", "start_s", "end_s", "begin", "end"


def _windows(study: RecordedStudy) -> dict[str, dict]:
    """Used part of each trial for prediction, by its name."""
    return {
        t.name: {key: getattr(t, key) for key in _WINDOW}
        for t in study.file.trials
        if t.use == "prediction"
    }


def _built(
    made: Designed, study: RecordedStudy, laboratory: dict, out: Path
) -> Designed:
    """Build the design on the laboratory's subject, and measure it."""
    from drake_exo.virtual_laboratory.campaign import write_campaign

    folder = out / "built"
    folder.mkdir()
    path = write_campaign(
        folder, **laboratory, design=made.design, assisted=True
    )
    # Like with like: the study's trials, in its windows and by its filter.
    windows, there = _windows(study), read_study(path).file
    there = replace(
        there,
        filter=study.file.filter,
        trials=tuple(
            replace(t, **windows[t.name])
            for t in there.trials
            if t.name in windows
        ),
    )
    measured = RecordedStudy(there, folder).trials("prediction")
    (name,) = made.before
    return built(made, study, {name: measured})


def _told(row: dict) -> str:
    if not row["success"]:
        return " (failed)"
    return " (dominated)" if row["dominated"] else ""


def _write_front(made: Designed, out: Path) -> bool:
    """Compute, print and write the front; whether all its points are done."""
    rows = pareto_front(made)
    whole = len(rows) == len(SHARES)
    if not rows:
        print(told_stopped(True, 0).lstrip())
        return False
    write_json(out / "front.json", rows)
    print(
        format_table(
            ["work of the device, share", "work [J]", "norm of forces [N]"],
            [
                [f"{r['share']:g}{_told(r)}", r["work_j"], r["norm_n"]]
                for r in rows
            ],
        )
        + told_stopped(not whole, len(rows))
    )
    mark = made.verdict().mark
    save_figure(out / "front.png", design_front_figure(rows), mark)
    return whole
