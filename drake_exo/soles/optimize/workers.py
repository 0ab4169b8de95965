"""Several jobs in processes of their own, a few at a time."""

import multiprocessing
import sys
import time
from collections.abc import Callable

_POLL_SECONDS = 0.2


def run(jobs: list[tuple], at_once: int, on_end: Callable[[], None]) -> int:
    """Run (function, *arguments) each in its process; how many failed.

    Results travel by files. Ctrl-C reaches every process (they share the
    terminal's group), which keeps its best so far on disk; it is raised
    again once all have ended.

    Args:
        jobs: Module-level functions with picklable arguments.
        at_once: Processes at a time.
        on_end: Called here after every job.
    """
    context = multiprocessing.get_context("spawn")
    waiting, running, failed = list(jobs), [], 0
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                process = context.Process(target=_call, args=waiting.pop(0))
                process.start()
                running.append(process)
            time.sleep(_POLL_SECONDS)
            for process in [p for p in running if not p.is_alive()]:
                running.remove(process)
                failed += process.exitcode != 0
                on_end()
    finally:
        for process in running:
            process.join()
        if running:
            on_end()
    return failed


def _call(function, *arguments) -> None:
    try:
        function(*arguments)
    except KeyboardInterrupt:
        sys.exit(130)  # the parent says so
