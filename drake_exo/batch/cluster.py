"""Workers of a Dask cluster that run jobs, each in a process of its own.

A Dask worker hands its job to a `jobs.Worker`: compiled code that keeps
Python's lock cannot then cost the Dask worker its connection, and a process
that is killed costs one attempt at one job. Results travel by files, so every
machine sees the same folders.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time

from drake_exo.batch.jobs import Ended, Job, Worker
from drake_exo.errors import InputError, reason

_CONNECT_SECONDS = 60.0  # a scheduler that starts again has that long
_HERE = threading.local()


def run_on_worker(job: Job, memory_mb: int | None) -> Ended:
    """On a Dask worker: the job in this thread's own process."""
    worker = getattr(_HERE, "worker", None)
    if worker is None or worker.memory_mb != memory_mb:
        worker = _HERE.worker = Worker(memory_mb)
    ended, attempt = None, 0
    while ended is None:
        attempt += 1
        worker.start(job, attempt)
        ended = worker.end()
    return ended


class Cluster:
    """Workers behind a Dask scheduler; see `jobs.Pool`.

    Args:
        address: of the scheduler, tcp://HOST:PORT, or tls:// with
            certificates as Dask's configuration names them.
        memory_mb: that each job's process may use; no bound if None.

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

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_) -> None:
        self.close()

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
        """As many as there are: the scheduler keeps what waits."""
        return 2**31

    def start(self, job: Job) -> None:
        """See `jobs.Pool`."""
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
        """See `jobs.Pool`."""
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
                    ended.append(self._end(future, name))
                future = self._done.get_nowait()
        return ended

    def _end(self, future, name: str) -> Ended:
        del self._jobs[name], self._since[name]
        error = future.exception()
        if error is None:
            return future.result()
        # A Dask worker was lost too often, or cannot import this package.
        return Ended(name, "lost", error=f"the cluster says: {reason(error)}")

    def _begin_again(self) -> None:
        """After a scheduler that has gone: whatever was running, anew."""
        self._client.close(timeout=1)
        self._client = self._connect()
        self._futures.clear()
        for job in self._jobs.values():
            self._submit(job)

    def running(self) -> dict[str, float]:
        """Jobs that the scheduler has, those included that wait there."""
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
        """See `jobs.Pool`."""
        with contextlib.suppress(OSError, TimeoutError, ValueError):
            return sum(self._client.nthreads().values())
        return 1

    def close(self) -> None:
        """See `jobs.Pool`."""
        with contextlib.suppress(OSError, TimeoutError):
            self._client.cancel(list(self._futures), force=True)
            self._client.close(timeout=2)
