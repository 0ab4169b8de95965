"""The command `drake-exo`: one subcommand for each job.

`drake-exo COMMAND --help` explains a command and its options.
"""

import argparse
import errno
import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from drake_exo import __version__
from drake_exo.errors import InputError, first_line, was_interrupted

# Each has a module here with `add_arguments(parser)` and `run(args)`;
# subcommands set their own `run`. It is imported on demand: `drake-exo sole`
# must not load the exoskeleton half, nor `drake-exo --help` either of them.
_COMMANDS = {
    "inspect": "list what recorded files hold",
    "check": "read and clean a study's recordings and report their quality",
    "calibrate": "calibrate contact models from a study's recordings",
    "predict": "predict movement and interaction with calibrated contact",
    "design": "design cuffs and assistance with calibrated contact",
    "crossvalidate": "leave each calibration trial out in turn and predict it",
    "report": "make the paper's tables and figures from results",
    "sensitivity": "say which contact parameters the data determine",
    "contact": "draw the contact laws (Figures 8 and 9 of the paper)",
    "demo": "run a virtual campaign, calibration, prediction and report",
    "lab": "simulate a measurement campaign with known truth",
    "sole": "simulate and optimise compliant soles",
    "batch": "run many studies, seeds, cases and settings at once",
    "compare": "put results of two or more folders side by side",
    "export": "write results for other programs",
    "view": "replay results in a browser, or save the page",
}

# Errors of a full or read-only disk; any other is a bug of this program.
_NO_ROOM = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.EIO,
)


# Errors of an impossible path: too long a name, a link to itself, a file for a
# folder, a folder for a file.
_NO_PATH = (
    errno.ENAMETOOLONG,
    errno.ELOOP,
    errno.EEXIST,
    errno.ENOTDIR,
    errno.EISDIR,
)


def count(text: str) -> int:
    """A whole number on the command line."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a whole number from 0 on"
        )
    return int(text)


def positive(text: str) -> int:
    """A whole number above 0 on the command line."""
    if (number := count(text)) == 0:
        raise argparse.ArgumentTypeError("0 does no work; give 1 or more")
    return number


def above_zero(text: str) -> float:
    """A finite number above 0 on the command line."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return number


def add_study(parser: argparse.ArgumentParser, **options) -> None:
    """Add the study file and --data-root, which every command on one takes."""
    options = {"help": "study file that describes the recordings", **options}
    parser.add_argument("study", type=Path, metavar="STUDY.yaml", **options)
    parser.add_argument(
        "--data-root",
        type=Path,
        help="folder that the study's relative paths start from (default: "
        "the study file's own)",
    )


def add_out(
    parser: argparse.ArgumentParser,
    force: str = "replace results in --out",
    **options,
) -> None:
    """Add --out, with argparse's options, and --force, with its help."""
    options = {"help": "folder for the results", **options}
    parser.add_argument("--out", type=Path, **options)
    parser.add_argument("--force", action="store_true", help=force)


def add_accept(parser: argparse.ArgumentParser) -> None:
    """Add --accept, which every command that ends with checks has."""
    parser.add_argument(
        "--accept",
        action="append",
        default=[],
        metavar="CHECK",
        help="accept a result although this check fails, such as audit or "
        "plausibility.mass; the beginning of a dotted name and all are "
        "possible, too; may be repeated, and is recorded",
    )


def main(argv: list[str] | None = None) -> int:
    """Run one subcommand and return its exit code (2 for bad input)."""
    with _terminated_as_interrupted():
        return _run(lambda: parse(sys.argv[1:] if argv is None else argv))


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Take SIGTERM for Ctrl-C, which keeps the best so far and ends workers.

    Clusters, containers and `timeout` send it.
    """

    def handle(number, frame):
        signal.raise_signal(signal.SIGINT)

    is_main = threading.current_thread() is threading.main_thread()
    # A job started with `&` ignores Ctrl-C: then SIGTERM ends it at once.
    if not is_main or not callable(signal.getsignal(signal.SIGINT)):
        yield
        return
    before = signal.signal(signal.SIGTERM, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def parse(argv: list[str]) -> argparse.Namespace:
    """Arguments of one subcommand, and its function as `run`."""
    parser = argparse.ArgumentParser(prog="drake-exo", description=__doc__)
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(dest="command", required=True)
    wanted = next((a for a in argv if not a.startswith("-")), None)
    for name, told in _COMMANDS.items():
        command = subparsers.add_parser(name, help=told)
        if name == wanted:
            module = importlib.import_module(f"{__name__}.{name}")
            command.description = module.__doc__
            if hasattr(module, "run"):
                command.set_defaults(run=module.run)
            module.add_arguments(command)
    return parser.parse_args(argv)


def _run(parsed: Callable[[], argparse.Namespace]) -> int:
    """Run a command; print errors that a user can act upon as a sentence."""
    args = None
    try:
        args = parsed()  # which imports the command, for a second or two
        return args.run(args) or 0
    except InputError as error:
        said = str(error)
    except BrokenPipeError:
        # Whoever read the output has gone, such as `head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        place = error.filename or getattr(args, "out", None) or "the results"
        if error.errno in _NO_PATH:
            place = first_line(str(error.filename))
            said = f"{place}: {error.strerror}; give another path"
        elif error.errno in _NO_ROOM:
            said = (
                f"{place}: cannot be written ({error.strerror}); make room or "
                "choose another folder for --out; what was written before is "
                "kept"
            )
        else:
            raise
    except MemoryError as error:
        said = (
            f"more memory is needed than there is ({error}); give a coarser "
            "mesh or grid, or fewer samples"
        )
    except BaseException as error:
        if not was_interrupted(error):
            raise
        # `--resume DIR` of a sole is a path.
        resumes = isinstance(getattr(args, "resume", None), bool)
        told = "; --resume goes on from what is kept" if resumes else ""
        print(f"drake-exo: interrupted{told}", file=sys.stderr)
        return 130
    print(f"drake-exo: error: {said}", file=sys.stderr)
    return 2
