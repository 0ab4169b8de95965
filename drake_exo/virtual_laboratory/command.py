"""The command `drake-exo lab`: a virtual measurement campaign."""

import argparse

from drake_exo.output import prepare_output_folder
from drake_exo.virtual_laboratory.campaign import NUM_TRIALS, write_campaign
from drake_exo.virtual_laboratory.instruments import DISTURBANCES


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
        "--trials", type=int, default=NUM_TRIALS, help="movements to record"
    )
    parser.add_argument(
        "--without",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        choices=[*DISTURBANCES, "all"],
        help="disturbances to switch off, or all",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the campaign."""
    off = set(args.without)
    active = [] if "all" in off else [d for d in DISTURBANCES if d not in off]
    with prepare_output_folder(args.out, args.force) as folder:
        study = write_campaign(folder, args.seed, active, args.trials)
        name = study.name
    print(f"wrote {args.out}/{name} with {args.trials} trials")
    return 0
