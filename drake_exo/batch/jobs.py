"""Jobs that need each other, run by whatever has room for them.

A job is a call of a module's function in another process. What runs it is a
`Pool`: processes of this machine (`processes.Processes`) or a Dask cluster
(`cluster.Cluster`). Here is what both have in common: which job may begin,
what a failure means for those that need it, progress.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TextIO

from drake_exo.errors import InputError

POLL_SECONDS = 1.0
_SHOWN = 8  # running jobs that progress names one by one

State = Literal["done", "failed", "lost", "memory", "skipped"]


@dataclass(frozen=True)
class Job:
    """A call in another process.

    Attributes:
        name: unique.
        function: "module:name".
        arguments: of the call, by name; they are pickled.
        needs: names of jobs that must have been done before.
        log: file whose last line tells how far it is; None if there is none.
    """

    name: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    log: str | None = None


@dataclass(frozen=True)
class Ended:
    """How a job ended.

    Attributes:
        name: of the job.
        state: "done"; "failed", it raised; "lost", its process ended each
            time; "memory", it needs more than it may have; "skipped", a job
            that it needs was not done.
        value: what the function returned, if done.
        error: one sentence otherwise.
        trace: of the exception, where it was not bad input.
        seconds: of the last attempt.
        host: where that was.
        attempts: how often it was begun.
    """

    name: str
    state: State
    value: Any = None
    error: str = ""
    trace: str = ""
    seconds: float = 0.0
    host: str = ""
    attempts: int = 0


class Pool(Protocol):
    """What runs jobs."""

    def room(self) -> int:
        """How many more jobs it takes now."""

    def start(self, job: Job) -> None:
        """Begin a job, or put it in a queue of its own."""

    def wait(self, seconds: float) -> list[Ended]:
        """Jobs that ended, as soon as there is one."""

    def running(self) -> dict[str, float]:
        """Names of jobs at work and for how long [s]."""

    def workers(self) -> int:
        """How many jobs run at once."""

    def close(self) -> None:
        """End every process at once."""


def run_jobs(
    jobs: Sequence[Job],
    pool: Pool,
    on_end: Callable[[Ended], None] | None = None,
    progress: BatchProgress | None = None,
) -> dict[str, Ended]:
    """Run jobs as those that they need are done.

    Of the jobs that may begin, that with the longest chain behind it goes
    first (Hu, Operations Research 9(6), 1961), then in the order given.

    Args:
        jobs: with names of their own.
        pool: left open.
        on_end: told of every job as it ends.
        progress: told now and then.

    Returns:
        name -> how it ended, in the order given.

    Raises:
        InputError: a job needs one that is not there, or itself.
    """
    chain = _chains(jobs)
    order = sorted(jobs, key=lambda job: -chain[job.name])
    ended: dict[str, Ended] = {}

    def end(row: Ended) -> None:
        ended[row.name] = row
        if on_end is not None:
            on_end(row)

    waiting = list(order)
    while len(ended) < len(jobs):
        waiting = _begin(waiting, ended, pool, end)
        if len(ended) == len(jobs):
            break
        for row in pool.wait(POLL_SECONDS):
            end(row)
        if progress is not None:
            progress.update(ended, pool, jobs)
    return {job.name: ended[job.name] for job in jobs}


def _begin(waiting, ended, pool, end) -> list[Job]:
    """Start what can start; the jobs that still wait."""
    left, room = [], pool.room()
    for job in waiting:
        lacking = [n for n in job.needs if n in ended and _failed(ended[n])]
        if lacking:
            reason = f"not begun: {lacking[0]} was not done"
            end(Ended(job.name, "skipped", error=reason))
        elif room > 0 and all(n in ended for n in job.needs):
            pool.start(job)
            room -= 1
        else:
            left.append(job)
    return left


def _failed(row: Ended) -> bool:
    return row.state != "done"


def _chains(jobs: Sequence[Job]) -> dict[str, int]:
    """How many jobs follow one another, from each on."""
    names = {job.name for job in jobs}
    if len(names) < len(jobs):
        twice = [job.name for job in jobs if job.name in names]
        raise InputError(f"two jobs are named {twice[0]!r}")
    followers: dict[str, list[str]] = {name: [] for name in names}
    for job in jobs:
        for need in job.needs:
            if need not in names:
                raise InputError(f"{job.name} needs {need!r}, which is no job")
            followers[need].append(job.name)
    found: dict[str, int] = {}
    # From the ends on; whatever is left at the end needs itself.
    left = list(followers)
    while left:
        ready = [n for n in left if all(f in found for f in followers[n])]
        if not ready:
            raise InputError(f"{left[0]} needs itself, by way of others")
        for name in ready:
            behind = (found[f] for f in followers[name])
            found[name] = 1 + max(behind, default=0)
        left = [n for n in left if n not in found]
    return found


class BatchProgress:
    """Counts, the jobs at work, and how long the rest will take.

    Args:
        title: begins every line.
        interval_seconds: between two reports; by default 2 s for a person, 30
            s for a log.
        stream: sys.stdout of the moment by default.
        clock: seconds, monotonic; for tests.
    """

    def __init__(
        self,
        title: str,
        interval_seconds: float | None = None,
        stream: TextIO | None = None,
        clock=time.monotonic,
    ):
        self.title = title
        self.stream = stream or sys.stdout
        if interval_seconds is None:
            interval_seconds = 2.0 if self.stream.isatty() else 30.0
        self.interval_seconds = interval_seconds
        self._clock = clock
        self._start = self._last = clock()

    def update(
        self, ended: Mapping[str, Ended], pool: Pool, jobs: Sequence[Job]
    ) -> bool:
        """Print if the last report is old enough; True if printed."""
        now = self._clock()
        if now - self._last < self.interval_seconds:
            return False
        self._last = now
        running = pool.running()
        failed = sum(_failed(row) for row in ended.values())
        parts = [f"{len(ended)}/{len(jobs)} done"]
        if failed:
            parts.append(f"{failed} failed")
        parts.append(f"{len(running)} running")
        left = _left_seconds(ended, running, jobs, pool.workers())
        if left is not None:
            parts.append(f"about {_duration(left)} left")
        lines = [
            f"{self.title}: {', '.join(parts)} ({now - self._start:.0f} s)"
        ]
        logs = {job.name: job.log for job in jobs}
        oldest = sorted(running.items(), key=lambda item: -item[1])
        lines += [
            f"  {name}, {seconds:.0f} s{_last_line(logs[name])}"
            for name, seconds in oldest[:_SHOWN]
        ]
        if len(oldest) > _SHOWN:
            lines.append(f"  and {len(oldest) - _SHOWN} more")
        print("\n".join(lines), file=self.stream, flush=True)
        return True


def _left_seconds(ended, running, jobs, workers) -> float | None:
    """By the mean time of jobs with the same last word in their name."""

    def kind(name: str) -> str:
        return name.rpartition("/")[2]

    times: dict[str, list[float]] = {}
    for row in ended.values():
        if row.state == "done" and row.seconds > 0.0:
            times.setdefault(kind(row.name), []).append(row.seconds)
    if not times:
        return None
    means = {k: sum(t) / len(t) for k, t in times.items()}
    usual = sum(means.values()) / len(means)
    left = 0.0
    for job in jobs:
        if job.name not in ended:
            mean = means.get(kind(job.name), usual)
            left += max(mean - running.get(job.name, 0.0), 0.0)
    return left / max(workers, 1)


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"


def _last_line(log: str | None) -> str:
    """What a running job printed last, short."""
    if log is None:
        return ""
    try:
        with Path(log).open("rb") as file:
            file.seek(0, 2)
            file.seek(max(file.tell() - 400, 0))
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
    except OSError:
        return ""
    return f": {lines[-1].strip()[:70]}" if lines else ""
