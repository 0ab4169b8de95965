"""Processes of this machine that run jobs, and outlive one that is killed."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.connection import wait as wait_for

from drake_exo.batch.jobs import Ended, Job

ATTEMPTS = 3  # of a job whose process ends under it
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
_NO_MEMORY = ("bad_alloc", "MemoryError", "annot allocate memory")


class Worker:
    """A process that runs one job at a time.

    Args:
        memory_mb: that it may use; no bound if None.
    """

    def __init__(self, memory_mb: int | None = None):
        self.memory_mb = memory_mb
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
        # More threads than workers only wait for each other; and sums come
        # out the same wherever a job runs.
        env = os.environ | dict.fromkeys(_THREADS, "1")
        env["PYTHONPATH"] = os.pathsep.join(p or os.getcwd() for p in sys.path)
        command = [sys.executable, "-m", "drake_exo.batch.process_child"]
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
        """Readable once there is an answer, or none to come."""
        return self._process.stdout

    def end(self) -> Ended | None:
        """How the job ended; waits. None if it is worth another attempt."""
        job, self.job = self.job, None
        try:
            answer = pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            return self._died(job)
        if answer["state"] == "memory":
            answer["error"] = self._too_large(job)
        return Ended(job.name, attempts=self.attempt, **answer)

    def _died(self, job: Job) -> Ended | None:
        self._process.stdin.close()
        self._process.stdout.close()
        code = self._process.wait()
        said = self._last_words()
        self._said.close()
        self._process = None
        seconds = time.monotonic() - self.since
        how = {"seconds": seconds, "attempts": self.attempt}
        if self.memory_mb is not None and any(w in said for w in _NO_MEMORY):
            return Ended(job.name, "memory", error=self._too_large(job), **how)
        if self.attempt < ATTEMPTS:
            return None
        word = signal.Signals(-code).name if code < 0 else f"code {code}"
        last = said.strip().splitlines()[-1:] if code >= 0 else []
        return Ended(
            job.name,
            "lost",
            error=f"its process ended {self.attempt} times ({word})"
            + "".join(f", saying {line[:120]!r}" for line in last)
            + "; where memory is short, use fewer workers",
            **how,
        )

    def _last_words(self) -> str:
        self._said.seek(0, 2)
        self._said.seek(max(self._said.tell() - 4000, 0))
        return self._said.read().decode("utf-8", "replace")

    def _too_large(self, job: Job) -> str:
        return (
            f"needs more than the {self.memory_mb} MB that --memory allows; "
            "allow more, with fewer workers if need be"
        )

    def interrupt(self) -> None:
        """Ctrl-C for its job."""
        if self._process is not None:
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End it at once, with whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process.stdout.close()
            self._said.close()
            self._process = None


class Processes:
    """Workers on this machine; see `jobs.Pool`.

    Args:
        workers: processes at once.
        memory_mb: that each may use; no bound if None.
    """

    def __init__(self, workers: int, memory_mb: int | None = None):
        self._workers = [Worker(memory_mb) for _ in range(workers)]

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def room(self) -> int:
        """See `jobs.Pool`."""
        return sum(w.job is None for w in self._workers)

    def start(self, job: Job) -> None:
        """See `jobs.Pool`."""
        next(w for w in self._workers if w.job is None).start(job)

    def wait(self, seconds: float) -> list[Ended]:
        """See `jobs.Pool`."""
        busy = {w.pipe: w for w in self._workers if w.job is not None}
        ended = []
        for pipe in wait_for(list(busy), seconds):
            worker, job = busy[pipe], busy[pipe].job
            row = worker.end()
            if row is None:
                worker.start(job, worker.attempt + 1)
            else:
                ended.append(row)
        return ended

    def running(self) -> dict[str, float]:
        """See `jobs.Pool`."""
        now = time.monotonic()
        return {w.job.name: now - w.since for w in self._workers if w.job}

    def workers(self) -> int:
        """See `jobs.Pool`."""
        return len(self._workers)

    def interrupt(self) -> None:
        """Ctrl-C for all jobs."""
        for worker in self._workers:
            worker.interrupt()

    def close(self) -> None:
        """See `jobs.Pool`."""
        for worker in self._workers:
            worker.close()
