"""One function called many times, on several processes, or once beside."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drake_exo.batch.jobs import (
    POLL_SECONDS,
    BatchProgress,
    Ended,
    Job,
    run_jobs,
)
from drake_exo.batch.processes import Processes
from drake_exo.errors import InputError
from drake_exo.files.output import Progress


def run_calls(
    function: Callable,
    calls: Sequence[Mapping[str, Any]],
    workers: int = 2,
    title: str = "",
    tell: Callable[[Any], object] | None = None,
) -> list:
    """What a function returns, for each set of arguments.

    Args:
        function: of a module, or of the script that runs; what it prints is
            lost.
        calls: arguments by name.
        workers: processes at once.
        title: begins lines of progress on standard error.
        tell: told each value as it comes.

    Returns:
        The values, in the order of `calls`.

    Raises:
        RuntimeError: a call failed; those that wait are not made.
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


@contextmanager
def beside(function: Callable, **arguments) -> Iterator[Callable[[], Any]]:
    """A call that another process makes meanwhile; left, it is ended.

    Args:
        function: of a module; what it prints is lost.
        arguments: of the call; they are pickled.

    Yields:
        What waits for the value and returns it. It raises InputError as the
        call does, RuntimeError for whatever else ends it.
    """
    job = Job(function.__name__, _name(function), arguments)

    def value() -> Any:
        progress, ended = Progress(job.name, interval_seconds=5.0), []
        while not ended:
            ended = pool.wait(POLL_SECONDS)
            progress.update("at work in another process")
        (row,) = ended
        if row.state != "done":
            if row.state == "failed" and not row.trace:
                raise InputError(row.error)
            raise RuntimeError(f"{job.name}: {row.error}\n{row.trace}")
        return row.value

    with Processes(1) as pool:
        pool.start(job)
        yield value


def _name(function: Callable) -> str:
    return f"{_module(function)}:{function.__name__}"


def _module(function: Callable) -> str:
    """Under which a process imports it; a script goes by another name."""
    if function.__module__ != "__main__":
        return function.__module__
    main = sys.modules["__main__"]
    spec = getattr(main, "__spec__", None)
    return Path(main.__file__).stem if spec is None else spec.name
