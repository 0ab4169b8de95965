"""The command `drake-exo lab`: a virtual measurement campaign."""

import argparse
import os

from drake_exo.contact.strap import read_design
from drake_exo.files.output import prepare_output_folder
from drake_exo.virtual_laboratory.campaign import (
    FILES,
    NUM_USED,
    write_campaign,
)
from drake_exo.virtual_laboratory.truth import DISTURBANCES, KINDS

PROCESSES = min(
    os.cpu_count() or 1, 2
)  # a core for each; more memory is not worth it


def add_parser(subparsers) -> None:
    """Declare the command and its options."""
    parser = subparsers.add_parser(
        "lab",
        help="simulate a measurement campaign with known truth",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Simulate a measurement campaign with known truth.",
        epilog="disturbances:\n"
        + "".join(f"  {k}: {v}\n" for k, v in DISTURBANCES.items()),
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", required=True, metavar="DIR")
    parser.add_argument(
        "--force", action="store_true", help="replace results in DIR"
    )
    parser.add_argument(
        "--trials",
        type=int,
        default=NUM_USED,
        help="movements to record, the three of calibration first",
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
        default=KINDS[0],
        help="how far truth may lie from what a calibration begins with",
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
        type=int,
        default=PROCESSES,
        help="processes at a time (default: a core for each, at most 2)",
    )
    parser.add_argument(
        "--design",
        metavar="DIR",
        help="results of 'drake-exo design': its cuffs and assistance on the "
        "same subject",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the campaign."""
    off = set(args.without)
    if "all" in off:
        off |= set(DISTURBANCES) - {"variation"}
    active = [name for name in DISTURBANCES if name not in off]
    design = None if args.design is None else read_design(args.design)
    with prepare_output_folder(args.out, args.force) as folder:
        study = write_campaign(
            folder,
            args.seed,
            active,
            args.trials,
            full=args.full,
            files=args.files,
            truth=args.truth,
            processes=max(min(args.jobs, args.trials), 1),
            design=design,
        )
        name = study.name
    print(f"wrote {args.out}/{name} with {args.trials} trials")
    return 0
