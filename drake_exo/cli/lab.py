"""The command `drake-exo lab`: a virtual measurement campaign."""

import argparse
import os

from drake_exo.cli import add_out, positive
from drake_exo.contact.strap import read_design
from drake_exo.errors import InputError
from drake_exo.files.output import prepare_output_folder
from drake_exo.virtual_laboratory.campaign import NUM_USED, write_campaign
from drake_exo.virtual_laboratory.instruments import FILES
from drake_exo.virtual_laboratory.truth import DISTURBANCES, KINDS
from drake_exo.virtual_laboratory.two_legs import MOVEMENTS, write_movements

# One for each core; more than two are not worth their memory.
PROCESSES = min(os.cpu_count() or 1, 2)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = "Simulate a measurement campaign with known truth."
    parser.epilog = "disturbances:\n" + "".join(
        f"  {k}: {v}\n" for k, v in DISTURBANCES.items()
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="of the simulated subject and the noise; the same seed gives the "
        "same files (default: 0)",
    )
    add_out(parser, "replace results in DIR", required=True, metavar="DIR")
    parser.add_argument(
        "--trials",
        type=int,
        help="number of movements to record, the three for calibration first "
        f"(default: {NUM_USED}; with --model 3)",
    )
    parser.add_argument(
        "--full",
        action="store_true",
        help="record all 60 movements of the protocol, whether used or not",
    )
    parser.add_argument(
        "--files",
        choices=FILES,
        default=FILES[0],
        help="format of markers and forces: c3d, or OpenSim's .trc and .mot "
        f"(default: {FILES[0]})",
    )
    parser.add_argument(
        "--truth",
        choices=KINDS,
        help="how far the truth may lie from where a calibration starts "
        f"(default: {KINDS[0]})",
    )
    parser.add_argument(
        "--without",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        choices=[*DISTURBANCES, "all"],
        help="disturbances to switch off; all switches off all but variation",
    )
    parser.add_argument(
        "--jobs",
        type=positive,
        default=PROCESSES,
        help="processes at a time (default: the number of cores, at most 2)",
    )
    parser.add_argument(
        "--design",
        metavar="DIR",
        help="results of 'drake-exo design': record the same subject with its "
        "cuffs and assistance",
    )
    parser.add_argument(
        "--model",
        metavar="FILE",
        help="file with what a study's 'model' says, for a person with two "
        "legs: simulate that person with the device passive instead",
    )
    parser.add_argument(
        "--movement",
        choices=MOVEMENTS,
        default=MOVEMENTS[0],
        help=f"with --model: what the person does (default: {MOVEMENTS[0]})",
    )
    parser.add_argument(
        "--left-share",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="with --model: share of the ground's force that the left leg "
        "bears (default: 0.5)",
    )


def run(args: argparse.Namespace) -> int:
    """Write the campaign."""
    off = set(args.without)
    if "all" in off:
        off |= set(DISTURBANCES) - {"variation"}
    active = [name for name in DISTURBANCES if name not in off]
    shipped = args.model is None
    _check(args, shipped)
    trials = args.trials
    if trials is None:
        trials = NUM_USED if shipped else 3
    processes = max(min(args.jobs, trials), 1)
    design = None if args.design is None else read_design(args.design)
    with prepare_output_folder(
        args.out, args.force, reads=[args.design, args.model]
    ) as folder:
        if shipped:
            write_campaign(
                folder,
                args.seed,
                active,
                trials,
                full=args.full,
                files=args.files,
                truth=args.truth or KINDS[0],
                processes=processes,
                design=design,
            )
        else:
            write_movements(
                folder,
                args.model,
                args.movement,
                args.seed,
                active,
                trials,
                left_share=args.left_share,
                files=args.files,
                processes=processes,
            )
    several = "s" * (trials != 1)
    print(f"wrote {args.out}/study.yaml with {trials} trial{several}")
    return 0


def _check(args: argparse.Namespace, shipped: bool) -> None:
    """Refuse options that do not fit the kind of person, or each other."""
    if not shipped:
        if args.full or args.design is not None or args.truth is not None:
            raise InputError(
                "--full, --truth and --design work with the shipped "
                "exoskeleton alone; leave them out, or --model"
            )
    elif args.movement != MOVEMENTS[0] or args.left_share != 0.5:
        raise InputError(
            "--movement and --left-share need a person of two legs; give "
            "--model FILE"
        )
    elif args.full and args.trials is not None:
        raise InputError("--full records all movements; leave out --trials")
