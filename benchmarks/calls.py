"""Calls one function many times, in processes of the package."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from drake_exo.jobs.engine import (
    BatchProgress,
    Ended,
    Job,
    Processes,
    run_jobs,
)


def run_calls(
    function: Callable,
    calls: Sequence[Mapping[str, Any]],
    workers: int = 2,
    title: str = "",
    tell: Callable[[Any], object] | None = None,
) -> list:
    """Call a function once for each set of arguments.

    Args:
        function: of a module, or of the script that runs; what it prints is
            lost.
        calls: arguments by name.
        workers: number of processes.
        title: begins lines of progress on standard error.
        tell: called with each value as it comes.

    Returns:
        The values, in the order of `calls`.

    Raises:
        RuntimeError: a call failed; those not begun are not made.
    """
    name = _name(function)
    jobs = [Job(f"{k}/{title}", name, call) for k, call in enumerate(calls)]

    def end(row: Ended) -> None:
        if row.state != "done":
            call = dict(calls[int(row.name.partition("/")[0])])
            raise RuntimeError(f"{name}({call}): {row.error}\n{row.trace}")
        if tell is not None:
            tell(row.value)

    progress = BatchProgress(title, stream=sys.stderr)
    with Processes(workers) as pool:
        ended = run_jobs(jobs, pool, end, progress)
    return [row.value for row in ended.values()]


def _name(function: Callable) -> str:
    """Name by which a process imports it, where a script is not __main__."""
    module = function.__module__
    if module == "__main__":
        main = sys.modules[module]
        spec = getattr(main, "__spec__", None)
        module = Path(main.__file__).stem if spec is None else spec.name
    return f"{module}:{function.__name__}"
