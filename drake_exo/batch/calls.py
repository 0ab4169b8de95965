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

_LEAVE_SECONDS = 20.0  # that a call may take to write what it has


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


class Beside:
    """A call that another process makes meanwhile.

    Args:
        pool: of one process.
        job: the call.
    """

    def __init__(self, pool: Processes, job: Job):
        self._pool, self._name = pool, job.name
        pool.start(job)

    def value(self) -> Any:
        """Wait for what it returns.

        Raises:
            InputError: as the call does.
            RuntimeError: whatever else ended it.
        """
        progress, ended = Progress(self._name, interval_seconds=5.0), []
        while not ended:
            ended = self._pool.wait(POLL_SECONDS)
            progress.update("at work in another process")
        (row,) = ended
        if row.state != "done":
            if row.state == "failed" and not row.trace:
                raise InputError(row.error)
            raise RuntimeError(f"{self._name}: {row.error}\n{row.trace}")
        return row.value

    def stop(self) -> None:
        """Ctrl-C for the call, which leaves what it has so far."""
        self._pool.interrupt()
        self._pool.wait(_LEAVE_SECONDS)


@contextmanager
def beside(function: Callable, **arguments) -> Iterator[Beside]:
    """A call that another process makes meanwhile; left, it is ended.

    Args:
        function: of a module; what it prints is lost.
        arguments: of the call; they are pickled.
    """
    job = Job(function.__name__, _name(function), arguments)
    with Processes(1) as pool:
        yield Beside(pool, job)


def _name(function: Callable) -> str:
    return f"{_module(function)}:{function.__name__}"


def _module(function: Callable) -> str:
    """Under which a process imports it; a script goes by another name."""
    if function.__module__ != "__main__":
        return function.__module__
    main = sys.modules["__main__"]
    spec = getattr(main, "__spec__", None)
    return Path(main.__file__).stem if spec is None else spec.name
