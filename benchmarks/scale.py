"""Overhead of a batch beside its tasks, on a Dask scheduler of many workers.

    python benchmarks/scale.py [--workers 4 16 64] [--tasks 10]
                               [--seconds 1] [--json]

The scheduler runs in a process of its own, the workers in another. Their tasks
only sleep, so any further time is that of scheduler, client and network.
Prints, for each number of workers, tasks per second, the share of the time that
is sleep, the scheduler's processor time and memory, and the bytes of a task.
Needs dask.distributed.
"""

import argparse
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from drake_exo.jobs.engine import Cluster, Job, run_jobs
from drake_exo.report.gathering import format_table

# Many workers in one process, on one event loop: enough for tasks that sleep.
_WORKERS = """
import asyncio, sys
from distributed import Worker

async def main():
    workers = [
        Worker(sys.argv[1], nthreads=1, dashboard=False, memory_limit=0)
        for _ in range(int(sys.argv[2]))
    ]
    await asyncio.gather(*workers)
    await asyncio.gather(*(w.finished() for w in workers))

asyncio.run(main())
"""


class SleepingCluster(Cluster):
    """A cluster whose workers sleep instead of running a job's process."""

    def _submit(self, job: Job) -> None:
        future = self._client.submit(
            _sleep, job, key=f"{job.name}-{time.monotonic_ns()}", pure=False
        )
        self._futures[future] = job.name
        future.add_done_callback(self._done.put)


def _sleep(job: Job):
    from drake_exo.jobs.engine import Ended

    time.sleep(job.arguments["seconds"])
    return Ended(job.name, "done", "holds", seconds=job.arguments["seconds"])


def measure(workers: int, tasks: int, seconds: float) -> dict:
    """Time a batch on so many workers: one row of the table."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, sys.path))}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        scheduler = subprocess.Popen(
            [
                *(sys.executable, "-m", "distributed.cli.dask_scheduler"),
                *("--no-dashboard", "--host", "127.0.0.1", "--port", "0"),
                *("--scheduler-file", str(file)),
            ],
            env=env,
            **quiet,
        )
        while not (file.is_file() and file.stat().st_size):
            if scheduler.poll() is not None:
                sys.exit("no scheduler: pip install 'drake_exo[batch]'")
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        crowd = subprocess.Popen(
            [sys.executable, "-c", _WORKERS, address, str(workers)],
            env=env,
            **quiet,
        )
        try:
            return _timed(address, scheduler.pid, workers, tasks, seconds)
        finally:
            for process in (crowd, scheduler):
                process.kill()
                process.wait()


def _timed(address, scheduler: int, workers, tasks, seconds) -> dict:
    # Like a batch's: the task's description travels, not its files.
    arguments = {
        "seconds": seconds,
        "out": "/data/study/results",
        "task": {"options": ["--no-front"], "changes": {"a.b.c": 1.0}},
    }
    jobs = [
        Job(f"seed_{k}/calibrate", "m:run_task", arguments, (), "/data/log")
        for k in range(tasks)
    ]
    with SleepingCluster(address) as cluster:
        while cluster.workers() < workers:
            time.sleep(0.2)
        before, start = _cpu(scheduler), time.perf_counter()
        own = time.process_time()
        ended = run_jobs(jobs, cluster)
        took = time.perf_counter() - start
        busy = _cpu(scheduler) - before
        own = time.process_time() - own
    assert all(row.state == "done" for row in ended.values())
    return {
        "workers": workers,
        "tasks_per_second": tasks / took,
        "share_asleep": tasks * seconds / workers / took,
        "scheduler_ms_per_task": 1e3 * busy / tasks,
        "client_ms_per_task": 1e3 * own / tasks,
        "scheduler_mb": _memory_mb(scheduler),
        "task_bytes": len(pickle.dumps(jobs[0])),
        "answer_bytes": len(pickle.dumps(ended[jobs[0].name])),
    }


def _cpu(pid: int) -> float:
    """Processor time of a process so far [s] (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[4, 16, 64])
    parser.add_argument("--tasks", type=int, default=10, help="for each worker")
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = [measure(w, args.tasks * w, args.seconds) for w in args.workers]
    if args.json:
        print(json.dumps(rows, indent=2))
        return
    keys = list(rows[0])
    print(
        format_table(
            [k.replace("_", " ") for k in keys],
            [[str(r["workers"]), *(r[k] for k in keys[1:])] for r in rows],
        )
    )


if __name__ == "__main__":
    main()
