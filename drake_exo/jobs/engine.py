"""Runs jobs that depend on each other in parallel processes.

A job is a call of a module's function. It runs in a `Pool`: `Processes` of this
machine (one that is killed is replaced), a Dask `Cluster`, or `Here`.
`run_jobs` starts each job once those that it needs are done, and skips it if
one failed. `Beside` makes a call in the background.

A Dask worker hands its job to a `Worker`, a process of its own: compiled code
that holds Python's lock (GIL) cannot then cost the Dask worker its connection,
and a process that is killed costs one attempt at one job. Large results travel
as files, so every machine must see the same folders.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Any, Literal, Protocol, TextIO

from drake_exo.errors import InputError, reason
from drake_exo.files.output import Progress
from drake_exo.jobs.process_child import function_of

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
        needs: names of jobs that must be done first.
        log: file whose last line tells its progress; None if there is none.
        given: name of the argument that gets what the needed jobs returned
            (name -> value); None to pass nothing on.
    """

    name: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    log: str | None = None
    given: str | None = None

    def told(self, **more) -> Job:
        """The job with more arguments."""
        return replace(self, arguments={**self.arguments, **more})


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
        raised: the exception, where it was the system's (a full disk).
        seconds: of the last attempt.
        attempts: how often it was begun.
        cause: error of the job for which it was skipped.
    """

    name: str
    state: State
    value: Any = None
    error: str = ""
    trace: str = ""
    raised: OSError | None = None
    seconds: float = 0.0
    attempts: int = 0
    cause: str = ""

    def result(self) -> Any:
        """What the function returned.

        Raises:
            InputError: as the function did; or its process was killed each
                time, for want of memory perhaps.
            OSError: as the function did.
            RuntimeError: whatever else ended it.
        """
        if self.raised is not None:
            raise self.raised from RuntimeError(self.trace)
        if self.state == "failed" and not self.trace:
            raise InputError(self.error)
        if self.state in ("lost", "memory"):
            raise InputError(f"{self.name}: {self.error}")
        if self.state != "done":
            raise RuntimeError(f"{self.name}: {self.error}\n{self.trace}")
        return self.value


class Pool(Protocol):
    """Runs jobs; is closed at the end of a `with` block."""

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def room(self) -> int:
        """How many more jobs it takes now."""

    def start(self, job: Job) -> None:
        """Begin a job, or put it in a queue of its own."""

    def wait(self, seconds: float) -> list[Ended]:
        """Wait until a job ends, or that long; the jobs that have ended."""

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
    progress: BatchProgress | Heard | None = None,
    before: Mapping[str, Ended] | None = None,
) -> dict[str, Ended]:
    """Run jobs, each once those that it needs are done.

    Of the jobs that may begin, the first one given begins first.

    Args:
        jobs: with unique names; each needs only jobs of these and `before`.
        pool: that runs them; left open.
        on_end: called with every job as it ends.
        progress: updated about once a second.
        before: name -> how it ended, of jobs of earlier runs that may be
            needed.

    Returns:
        name -> how it ended, in the order given.
    """
    before = before or {}
    ended: dict[str, Ended] = {}

    def end(row: Ended) -> None:
        ended[row.name] = row
        if on_end is not None:
            on_end(row)

    waiting = list(jobs)
    while len(ended) < len(jobs):
        waiting = _begin(waiting, ChainMap(ended, before), pool, end)
        if len(ended) == len(jobs):
            break
        for row in pool.wait(POLL_SECONDS):
            end(row)
        if progress is not None:
            progress.update(ended, pool, jobs)
    return {job.name: ended[job.name] for job in jobs}


def _begin(waiting, ended, pool, end) -> list[Job]:
    """Start the jobs that can start; return those that still wait."""
    left, room = [], pool.room()
    for job in waiting:
        lacking = [
            n for n in job.needs if n in ended and ended[n].state != "done"
        ]
        if lacking:
            reason = f"not begun: {lacking[0]} was not done"
            cause = ended[lacking[0]].cause or ended[lacking[0]].error
            end(Ended(job.name, "skipped", error=reason, cause=cause))
        elif room > 0 and all(n in ended for n in job.needs):
            if job.given is not None:
                values = {name: ended[name].value for name in job.needs}
                job = job.told(**{job.given: values})
            pool.start(job)
            room -= 1
        else:
            left.append(job)
    return left


class BatchProgress:
    """Prints counts, the jobs at work, and how long the rest will take.

    Every 2 s on a terminal, every 30 s in a log.

    Args:
        title: begins every report.
        stream: to print to; by default sys.stdout as it is now.
    """

    def __init__(self, title: str, stream: TextIO | None = None):
        self.title = title
        self._stream = stream or sys.stdout
        self._interval_s = 2.0 if self._stream.isatty() else 30.0
        self._start = self._last = time.monotonic()

    def update(
        self, ended: Mapping[str, Ended], pool: Pool, jobs: Sequence[Job]
    ) -> None:
        """Print if the last report is old enough."""
        now = time.monotonic()
        if now - self._last < self._interval_s:
            return
        self._last = now
        running = pool.running()
        failed = sum(row.state != "done" for row in ended.values())
        parts = [f"{len(ended)}/{len(jobs)} done"]
        if failed:
            parts.append(f"{failed} failed")
        parts.append(f"{len(running)} running")
        left = _left_seconds(ended, running, jobs, pool.workers())
        if left:
            parts.append(f"about {_duration(left)} left")
        lines = [
            f"{self.title}: {', '.join(parts)} ({now - self._start:.0f} s)"
        ]
        logs = {job.name: job.log for job in jobs}
        oldest = sorted(running.items(), key=lambda item: -item[1])
        lines += [
            f"  {name}, {seconds:.0f} s{_told(logs[name])}"
            for name, seconds in oldest[:_SHOWN]
        ]
        if len(oldest) > _SHOWN:
            lines.append(f"  and {len(oldest) - _SHOWN} more")
        print("\n".join(lines), file=self._stream, flush=True)


def append(log: str, line: str) -> None:
    """Append one line to a job's log."""
    with open(log, "a", encoding="utf-8") as file:
        file.write(f"{line}\n")


def logged(jobs: Sequence[Job], folder: Path) -> list[Job]:
    """Jobs with an argument `say`, which writes to a log in the folder."""
    logs = [str(folder / f"{k}.log") for k in range(len(jobs))]
    return [
        replace(job.told(say=partial(append, log)), log=log)
        for job, log in zip(jobs, logs, strict=True)
    ]


class Heard:
    """Passes on the last line of each job's log; progress for `run_jobs`.

    It goes through the jobs forwards and backwards in turn, since of lines
    said at one time `Progress` shows only the first.

    Args:
        say: called with a line.
    """

    def __init__(self, say: Callable[[str], object]):
        self._say, self._last, self._way = say, {}, -1

    def update(self, ended, pool: Pool, jobs: Sequence[Job]) -> None:
        """Pass on the last line of each log if it is new."""
        self._way = -self._way
        for job in jobs[:: self._way]:
            line = last_line(job.log) if job.log else ""
            if line and line != self._last.get(job.name):
                self._last[job.name] = line
                self._say(line)


def _left_seconds(ended, running, jobs, workers) -> float:
    """Time left [s], by mean times of jobs whose names end in the same part.

    0 if nothing tells it: no job has ended, or all that are left are overdue.
    """

    def kind(name: str) -> str:
        return name.rpartition("/")[2]

    times: dict[str, list[float]] = {}
    for row in ended.values():
        if row.state == "done" and row.seconds > 0.0:
            times.setdefault(kind(row.name), []).append(row.seconds)
    if not times:
        return 0.0
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


def _told(log: str | None) -> str:
    """Last line that a running job printed, cut to 70 characters."""
    line = "" if log is None else last_line(log)
    return f": {line[:70]}" if line else ""


def last_line(log: str) -> str:
    """Last line of a job's log; empty if there is none yet."""
    try:
        with Path(log).open("rb") as file:
            file.seek(0, 2)
            file.seek(max(file.tell() - 400, 0))
            lines = file.read().decode("utf-8", "replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].strip() if lines else ""


ATTEMPTS = 3  # at a job whose process is killed or crashes
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
_NO_MEMORY = (
    *("bad_alloc", "MemoryError", "annot allocate memory"),
    "can't start new thread",
)


class Worker:
    """A process that runs one job at a time.

    Args:
        memory_mb: memory that it may use; no limit if None.

    Attributes:
        code: exit code of its last process that ended at work, else None.
    """

    def __init__(self, memory_mb: int | None = None):
        self.memory_mb = memory_mb
        self.code: int | None = None
        self.job: Job | None = None
        self.attempt = 0
        self.since = 0.0
        self._process: subprocess.Popen | None = None

    def start(self, job: Job, attempt: int = 1) -> None:
        """Begin a job; the process is made if there is none."""
        if self._process is None:
            self._process = self._open()
        self.job, self.attempt, self.since = job, attempt, time.monotonic()
        try:
            pickle.dump(
                (job.function, dict(job.arguments)), self._process.stdin
            )
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended, which `end` will find

    def _open(self) -> subprocess.Popen:
        # One thread each: more would only wait for each other, and sums come
        # out the same wherever a job runs.
        env = os.environ | dict.fromkeys(_THREADS, "1")
        env["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
        command = [sys.executable, "-m", "drake_exo.jobs.process_child"]
        if self.memory_mb is not None:
            command.append(str(self.memory_mb))
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 (outlives this)
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=env,
            start_new_session=True,  # Ctrl-C is its master's to handle
        )

    @property
    def pipe(self):
        """Stream, readable once the job has answered or its process ended."""
        return self._process.stdout

    def end(self) -> Ended | None:
        """Wait for the job; how it ended, None if it was begun again."""
        job, self.job = self.job, None
        try:
            answer = pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            return self._died(job)
        if answer["state"] == "memory":
            answer["error"] = self._too_large()
        return Ended(job.name, attempts=self.attempt, **answer)

    def _died(self, job: Job) -> Ended | None:
        self._close_pipes()
        self.code = code = self._process.wait()
        self._said.seek(0, 2)
        self._said.seek(max(self._said.tell() - 4000, 0))
        said = self._said.read().decode("utf-8", "replace")
        self._said.close()
        self._process = None
        seconds = time.monotonic() - self.since
        how = {"seconds": seconds, "attempts": self.attempt}
        if self.memory_mb is not None and any(w in said for w in _NO_MEMORY):
            return Ended(job.name, "memory", error=self._too_large(), **how)
        if self.attempt < ATTEMPTS:
            self.start(job, self.attempt + 1)
            return None
        word = signal.Signals(-code).name if code < 0 else f"code {code}"
        last = said.strip().splitlines()[-1:] if code >= 0 else []
        return Ended(
            job.name,
            "lost",
            error=f"its process ended {self.attempt} times ({word})"
            + "".join(f", saying {line[:120]!r}" for line in last)
            + "; where memory is short, use fewer workers"
            + (" or allow more --memory" if self.memory_mb else ""),
            **how,
        )

    def _close_pipes(self) -> None:
        # Closing flushes a job that the process never read.
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.stdout.close()

    def _too_large(self) -> str:
        if self.memory_mb is None:
            return "needs more memory than there is; use fewer workers"
        return (
            f"needs more than the {self.memory_mb} MB that --memory allows; "
            "allow more, with fewer workers if need be"
        )

    def interrupt(self) -> None:
        """Send Ctrl-C (SIGINT) to its job."""
        if self._process is not None:
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Kill the process at once, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._close_pipes()
            self._said.close()
            self._process = None


class Processes(Pool):
    """Workers on this machine; see `Pool`.

    Args:
        workers: number of processes.
        memory_mb: memory that each may use; no limit if None.

    Raises:
        InputError: `workers` is below 1.
    """

    def __init__(self, workers: int, memory_mb: int | None = None):
        if workers < 1:
            raise InputError(f"{workers} processes do no work; give 1 or more")
        self._workers = [Worker(memory_mb) for _ in range(workers)]

    def room(self) -> int:
        """See `Pool`."""
        return sum(w.job is None for w in self._workers)

    def start(self, job: Job) -> None:
        """See `Pool`."""
        next(w for w in self._workers if w.job is None).start(job)

    def wait(self, seconds: float) -> list[Ended]:
        """See `Pool`."""
        busy = {w.pipe: w for w in self._workers if w.job is not None}
        rows = [busy[pipe].end() for pipe in wait_for(list(busy), seconds)]
        return [row for row in rows if row is not None]

    def running(self) -> dict[str, float]:
        """See `Pool`."""
        now = time.monotonic()
        return {w.job.name: now - w.since for w in self._workers if w.job}

    def workers(self) -> int:
        """See `Pool`."""
        return len(self._workers)

    def interrupt(self) -> None:
        """Send Ctrl-C (SIGINT) to all jobs."""
        for worker in self._workers:
            worker.interrupt()

    def close(self) -> None:
        """See `Pool`."""
        for worker in self._workers:
            worker.close()


class Here(Pool):
    """Runs jobs in this process, one at a time; what they raise is raised."""

    def __init__(self):
        self._job: Job | None = None

    def room(self) -> int:
        """See `Pool`."""
        return int(self._job is None)

    def start(self, job: Job) -> None:
        """See `Pool`; `wait` makes the call."""
        self._job = job

    def wait(self, seconds: float) -> list[Ended]:
        """See `Pool`."""
        job, self._job = self._job, None
        value = function_of(job.function)(**job.arguments)
        return [Ended(job.name, "done", value, attempts=1)]


_LEAVE_SECONDS = 20.0  # for a stopped call to write what it has


class Beside(Processes):
    """A second process that makes calls in the background, one by one.

    What a call prints is lost. The process ends with the `with` block.
    """

    def __init__(self):
        super().__init__(1)

    def __call__(self, function: Callable, **arguments) -> Beside:
        """Begin a call of a module's function; its arguments are pickled."""
        name = f"{function.__module__}:{function.__name__}"
        self.start(Job(function.__name__, name, arguments))
        return self

    def value(self) -> Any:
        """Wait for the call; what it returns.

        Raises:
            InputError: as the call does.
            RuntimeError: whatever else ended it.
        """
        (name,) = self.running()
        progress, ended = Progress(name, interval_seconds=5.0), []
        while not ended:
            ended = self.wait(POLL_SECONDS)
            progress.update("at work in another process")
        return ended[0].result()

    def stop(self) -> None:
        """Send Ctrl-C to the call and wait while it writes what it has."""
        self.interrupt()
        self.wait(_LEAVE_SECONDS)


_CONNECT_SECONDS = 60.0  # for a scheduler to answer, which may be restarting
_HERE = threading.local()


def run_on_worker(job: Job, memory_mb: int | None) -> Ended:
    """Run a job on a Dask worker, in a process that its thread owns."""
    worker = getattr(_HERE, "worker", None)
    if worker is None or worker.memory_mb != memory_mb:
        worker = _HERE.worker = Worker(memory_mb)
    worker.start(job)
    while (ended := worker.end()) is None:
        pass
    return ended


class Cluster(Pool):
    """Workers behind a Dask scheduler; see `Pool`.

    Args:
        address: of the scheduler, tcp://HOST:PORT, or tls:// with
            certificates as Dask's configuration names them.
        memory_mb: memory that each job's process may use; no limit if None.

    Raises:
        InputError: dask.distributed is not installed, or no scheduler
            answers.
    """

    def __init__(self, address: str, memory_mb: int | None = None):
        try:
            import distributed
        except ImportError as error:
            raise InputError(
                "--scheduler needs dask.distributed; install it with "
                "pip install 'drake_exo[batch]', or leave it out"
            ) from error
        self._dask = distributed
        self.address = address
        self.memory_mb = memory_mb
        self._jobs: dict[str, Job] = {}
        self._since: dict[str, float] = {}
        self._futures: dict = {}
        self._done: queue.SimpleQueue = queue.SimpleQueue()
        self._client = self._connect()

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's page; empty if it has none."""
        services = self._client.scheduler_info().get("services", {})
        return self._client.dashboard_link if "dashboard" in services else ""

    def _connect(self):
        """A client of the scheduler, as soon as it answers."""
        until = time.monotonic() + _CONNECT_SECONDS
        while True:
            try:
                return self._dask.Client(
                    self.address, timeout=5, set_as_default=False
                )
            except (OSError, TimeoutError, ValueError, TypeError) as error:
                late = time.monotonic() > until
                if late or not isinstance(error, OSError | TimeoutError):
                    raise InputError(
                        f"--scheduler {self.address}: does not answer "
                        f"({reason(error)}); start one with 'dask scheduler'"
                    ) from error
            time.sleep(1.0)

    def room(self) -> int:
        """No limit: the scheduler queues jobs."""
        return 2**31

    def start(self, job: Job) -> None:
        """See `Pool`."""
        self._jobs[job.name] = job
        self._since[job.name] = time.monotonic()
        self._submit(job)

    def _submit(self, job: Job) -> None:
        future = self._client.submit(
            run_on_worker,
            job,
            self.memory_mb,
            key=f"{job.name}-{time.monotonic_ns()}",
            pure=False,
        )
        self._futures[future] = job.name
        future.add_done_callback(self._done.put)

    def wait(self, seconds: float) -> list[Ended]:
        """See `Pool`."""
        if self._client.status != "running":
            self._begin_again()
        ended = []
        with contextlib.suppress(queue.Empty):
            future = self._done.get(timeout=seconds)
            while True:
                name = self._futures.pop(future, None)
                if name is not None and future.cancelled():
                    self._submit(self._jobs[name])
                elif name is not None:
                    try:
                        ended.append(self._end(future, name))
                    except OSError:  # the scheduler died with the answer
                        self._submit(self._jobs[name])
                future = self._done.get_nowait()
        return ended

    def _end(self, future, name: str) -> Ended:
        error = future.exception()
        if error is None:
            found = future.result()
        else:  # a Dask worker was lost too often, or cannot import this package
            why = f"the cluster says: {reason(error)}"
            found = Ended(name, "lost", error=why)
        del self._jobs[name], self._since[name]
        return found

    def _begin_again(self) -> None:
        """Connect to a restarted scheduler and submit unfinished jobs again."""
        self._client.close(timeout=1)
        self._client = self._connect()
        self._futures.clear()
        for job in self._jobs.values():
            self._submit(job)

    def running(self) -> dict[str, float]:
        """See `Pool`; includes jobs that wait at the scheduler."""
        now = time.monotonic()
        found = {}
        with contextlib.suppress(OSError, TimeoutError, ValueError):
            at_work = self._client.processing().values()
            for key in (k for keys in at_work for k in keys):
                name = str(key).rpartition("-")[0]
                if name in self._since:
                    found[name] = now - self._since[name]
        return found

    def workers(self) -> int:
        """See `Pool`."""
        with contextlib.suppress(OSError, TimeoutError, ValueError):
            return sum(self._client.nthreads().values())
        return 1

    def close(self) -> None:
        """See `Pool`."""
        with contextlib.suppress(OSError, TimeoutError):
            self._client.cancel(list(self._futures), force=True)
            self._client.close(timeout=2)
