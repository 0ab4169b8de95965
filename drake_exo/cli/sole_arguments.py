"""Arguments that several jobs of `drake-exo sole` share."""

from argparse import ArgumentTypeError
from pathlib import Path

from drake_exo.errors import InputError
from drake_exo.files.output import OutputFolder, prepare_output_folder


def add_case_arguments(parser) -> None:
    """Where a case finds its mesh and its files."""
    parser.add_argument(
        "--mesh", type=Path, help="mesh file used instead of the case's"
    )
    parser.add_argument(
        "--data-root",
        type=Path,
        help="folder that the case's paths are relative to "
        "(default: the case file's)",
    )


def add_common_arguments(parser) -> None:
    """Arguments that every job on a case file has."""
    add_case_arguments(parser)
    _add_out(parser, required=True, help="folder for the results")


def add_source_arguments(parser, help: str) -> None:
    """A folder that an optimisation left, and where what follows goes."""
    parser.add_argument("source", type=Path, metavar="DIR", help=help)
    _add_out(parser, help="folder for the results (default: DIR)")


def _add_out(parser, **options) -> None:
    parser.add_argument("--out", type=Path, **options)
    parser.add_argument(
        "--force", action="store_true", help="replace earlier results"
    )


def add_limits_argument(parser, choices) -> None:
    """Whether stability, tilt and strain are limited."""
    parser.add_argument(
        "--limits",
        choices=choices,
        default="all",
        help="limits on stability, tilt and strain: the case's, or none as "
        "in the paper (default: all)",
    )


def add_iterations_argument(parser) -> None:
    """How long the last stage may go on."""
    parser.add_argument(
        "--iterations",
        type=_count,
        metavar="N",
        help="at most so many in the last stage (default: the case's; an "
        "optimum takes some 190 to 540)",
    )


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    return int(text)


def prepare_out_or_source(args, name: str) -> OutputFolder:
    """The folder --out, or the source itself.

    Args:
        args: With the arguments of `add_source_arguments`.
        name: File among the results that earlier ones are known by.

    Raises:
        InputError: It holds earlier results and --force is not given.
    """
    if args.out is not None:
        return prepare_output_folder(args.out, args.force)
    if (args.source / name).exists() and not args.force:
        raise InputError(
            f"{args.source}: already holds {name}; give --out, or replace "
            "earlier results with --force"
        )
    return prepare_output_folder(args.source, resume=True)
