"""`drake-exo view`: replays results in a browser, or saves the page.

DIR is a folder that `calibrate`, `predict`, `design`, `demo`, `sole simulate`,
`sole optimize` or `sole study` wrote. The page is one HTML file that needs no
network. It has a list of trials and a time slider, and shows measured beside
simulated movements, forces as arrows, and a sole's contact pressure in colour.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import webbrowser
from collections.abc import Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from drake_exo.cli import add_accept, add_out
from drake_exo.errors import InputError
from drake_exo.files.output import check_new, read_json, summaries

REPLAY = "replay.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "results", type=Path, metavar="DIR", help="folder with results"
    )
    add_out(
        parser,
        "replace an earlier FILE.html",
        metavar="FILE.html",
        help="save the page to this file instead of serving it",
    )
    parser.add_argument(
        "--no-browser",
        action="store_true",
        help="serve the page and print its address, but open no browser",
    )
    add_accept(parser)


def run(args: argparse.Namespace) -> int:
    """Write the page, then say where it is or serve it.

    Raises:
        InputError: there is nothing to replay in DIR, or FILE.html exists
            or is none.
    """
    if args.out is not None:
        _check_target(args.out, args.force)
        write_view(args.results, args.out, args.accept)
        print(f"replay in {args.out}: open it in a browser")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        write_view(args.results, Path(folder) / REPLAY, args.accept)
        _serve(Path(folder), not args.no_browser)
    return 0


def write_view(results: Path, path: Path, accept: Sequence[str] = ()) -> None:
    """Write the page of all results under a folder.

    Args:
        results: the folder.
        path: of the page.
        accept: "solved" shows what was not solved, marked.

    Raises:
        InputError: there is nothing to replay, or it cannot be written.
    """
    results = Path(results)
    if not summaries(results) and any(results.rglob("checkpoint.*")):
        raise InputError(
            f"{results}: holds a run that was cut off, and nothing to replay "
            "yet; go on with it by --resume"
        )
    # Neither half of the package loads the other one.
    if _holds_soles(results):
        from drake_exo.soles.animation import replay_soles as replay
    else:
        from drake_exo.report.replay import replay_results

        replay = partial(replay_results, accept=accept)
    try:
        replay(results, Path(path))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose another "
            "place for --out"
        ) from error


def _holds_soles(results: Path) -> bool:
    """Whether the results under a folder are of soles, not of movements."""
    halves: dict[bool, Path] = {}
    for path in summaries(results):
        found = read_json(path, "run the command that wrote it again")
        if isinstance(found, dict) and "phase" in found:
            halves[False] = path.parent
        elif isinstance(found, dict) and ("c_rot" in found or "cases" in found):
            halves[True] = path.parent
    if len(halves) > 1:
        raise InputError(
            f"{results}: holds movements and soles; view one of its folders, "
            f"such as {halves[False]} or {halves[True]}"
        )
    return True in halves


def _check_target(path: Path, force: bool) -> None:
    if path.is_dir() or path.suffix.lower() != ".html":
        what = "a folder" if path.is_dir() else "no page"
        raise InputError(f"{path}: is {what}; give a .html file for --out")
    check_new(path, force)


class _Silent(SimpleHTTPRequestHandler):
    """Serves the page without a line for every request."""

    def log_message(self, format: str, *args) -> None:
        """Say nothing."""


def _serve(folder: Path, open_browser: bool) -> None:
    """Serve the page until Ctrl-C."""
    # A Meshcat must end in the thread that made it, not in one that serves;
    # Drake keeps its Diagram and builder in a cycle that only this ends
    # (internal::ref_cycle, RobotLocomotion/drake 22068).
    gc.collect()
    handler = partial(_Silent, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        address = f"http://localhost:{server.server_port}/{REPLAY}"
        print(f"replay at {address}; Ctrl-C ends", flush=True)
        if open_browser:
            webbrowser.open(address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
