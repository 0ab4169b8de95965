"""The command `drake-exo lab`: a virtual measurement campaign."""

import argparse
import os

from drake_exo.cli import add_out, positive
from drake_exo.contact.strap import read_design
from drake_exo.errors import InputError
from drake_exo.files.output import prepare_output_folder
from drake_exo.virtual_laboratory.campaign import (
    FILES,
    NUM_USED,
    write_campaign,
)
from drake_exo.virtual_laboratory.truth import DISTURBANCES, KINDS
from drake_exo.virtual_laboratory.two_legs import MOVEMENTS, write_movements

# A core for each; more memory is not worth it.
PROCESSES = min(os.cpu_count() or 1, 2)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = "Simulate a measurement campaign with known truth."
    parser.epilog = "disturbances:\n" + "".join(
        f"  {k}: {v}\n" for k, v in DISTURBANCES.items()
    )
    parser.add_argument("--seed", type=int, default=0)
    add_out(parser, "replace results in DIR", required=True, metavar="DIR")
    parser.add_argument(
        "--trials",
        type=int,
        help="movements to record, the three of calibration first "
        f"(default: {NUM_USED}; with --model 3)",
    )
    parser.add_argument(
        "--full",
        action="store_true",
        help="record all 60 movements of the protocol, used or not",
    )
    parser.add_argument(
        "--files",
        choices=FILES,
        default=FILES[0],
        help="c3d, or OpenSim's .trc and .mot",
    )
    parser.add_argument(
        "--truth",
        choices=KINDS,
        help="how far truth may lie from what a calibration begins with "
        f"(default: {KINDS[0]})",
    )
    parser.add_argument(
        "--without",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        choices=[*DISTURBANCES, "all"],
        help="disturbances to switch off, or all (but variation)",
    )
    parser.add_argument(
        "--jobs",
        type=positive,
        default=PROCESSES,
        help="processes at a time (default: a core for each, at most 2)",
    )
    parser.add_argument(
        "--design",
        metavar="DIR",
        help="results of 'drake-exo design': its cuffs and assistance on the "
        "same subject",
    )
    parser.add_argument(
        "--model",
        metavar="FILE",
        help="what a study's 'model' says, of two legs: simulate that person "
        "and device, passive, instead",
    )
    parser.add_argument(
        "--movement",
        choices=MOVEMENTS,
        default=MOVEMENTS[0],
        help="with --model",
    )
    parser.add_argument(
        "--left-share",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="with --model: of the ground's force, that the left leg bears",
    )


def run(args: argparse.Namespace) -> int:
    """Write the campaign."""
    off = set(args.without)
    if "all" in off:
        off |= set(DISTURBANCES) - {"variation"}
    active = [name for name in DISTURBANCES if name not in off]
    if args.model is not None:
        return _described(args, active)
    if args.movement != MOVEMENTS[0] or args.left_share != 0.5:
        raise InputError(
            "--movement and --left-share are of a person of two legs; give "
            "--model FILE"
        )
    if args.full and args.trials is not None:
        raise InputError("--full records all movements; leave out --trials")
    trials = NUM_USED if args.trials is None else args.trials
    design = None if args.design is None else read_design(args.design)
    with prepare_output_folder(
        args.out, args.force, reads=[args.design]
    ) as folder:
        study = write_campaign(
            folder,
            args.seed,
            active,
            trials,
            full=args.full,
            files=args.files,
            truth=args.truth or KINDS[0],
            processes=max(min(args.jobs, trials), 1),
            design=design,
        )
        name = study.name
    _told(args, name, trials)
    return 0


def _told(args: argparse.Namespace, name: str, trials: int) -> None:
    several = "s" * (trials != 1)
    print(f"wrote {args.out}/{name} with {trials} trial{several}")


def _described(args: argparse.Namespace, active: list[str]) -> int:
    """Write trials of a person and a device from a file."""
    if args.full or args.design is not None or args.truth is not None:
        raise InputError(
            "--full, --truth and --design are of the shipped exoskeleton; "
            "leave them out, or --model"
        )
    trials = 3 if args.trials is None else args.trials
    with prepare_output_folder(
        args.out, args.force, reads=[args.model]
    ) as folder:
        study = write_movements(
            folder,
            args.model,
            args.movement,
            args.seed,
            active,
            trials,
            left_share=args.left_share,
            files=args.files,
        )
        name = study.name
    _told(args, name, trials)
    return 0
