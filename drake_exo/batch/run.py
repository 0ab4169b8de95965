"""A batch from its file to its tables; what is done is not done again."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

from drake_exo.batch.file import BatchFile, check_key, file_class, read_batch
from drake_exo.batch.jobs import BatchProgress, Ended, Job, Pool, run_jobs
from drake_exo.batch.tasks import Task, is_sole, tasks_of
from drake_exo.batch.work import (
    DRAFTS,
    Outcome,
    log_of,
    outcome,
    read_outcome,
)
from drake_exo.errors import InputError
from drake_exo.files.output import write_json

_MARK = "tasks.json"


@dataclass(frozen=True)
class Batch:
    """Tasks and how they ended.

    Attributes:
        out: folder of all results.
        tasks: in the order of the batch file.
        outcomes: name -> how it ended.
        fresh: how many were run now.
        interrupted: by Ctrl-C; what was not done then is "not begun".
    """

    out: Path
    tasks: tuple[Task, ...]
    outcomes: dict[str, Outcome]
    fresh: int
    interrupted: bool = False

    @property
    def bad(self) -> list[tuple[Task, Outcome]]:
        """Tasks that failed or do not hold."""
        rows = [(task, self.outcomes[task.name]) for task in self.tasks]
        return [(task, found) for task, found in rows if found.code != 0]

    @property
    def exit_code(self) -> int:
        """0 where every task is done and holds, 130 by Ctrl-C, else 3."""
        if self.interrupted:
            return 130
        return 3 if self.bad else 0


def run_batch(
    path: str | Path,
    out: str | Path,
    open_pool: Callable[[], AbstractContextManager[Pool]],
    parse: str,
) -> Batch:
    """Run what of a batch is not done yet.

    Args:
        path: of the batch file.
        out: folder of results; of the same batch's, too, as far as it came.
        open_pool: makes the pool, where there is something to do.
        parse: "module:name" of what turns a command into its arguments.

    Raises:
        InputError: the batch file is not as it should be, or `out` holds
            something else.
    """
    path, out = Path(path).resolve(), Path(out).resolve()
    batch = read_batch(path)
    try:
        tasks = tasks_of(batch, path.parent)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    done = _done(tasks, out)
    todo = [task for task in tasks if task.name not in done]
    if todo:
        _check_sweep(batch, path)
    _prepare(out, tasks)
    ended: dict[str, Ended] = {}
    interrupted = False
    if todo:
        jobs = [_job(task, out, parse, path.parent) for task in todo]
        ready, held = _without_failed(jobs, done)
        ended |= {row.name: row for row in held}

        def end(row: Ended) -> None:
            ended[row.name] = row
            _tell(row)

        try:
            with open_pool() as pool:
                run_jobs(ready, pool, end, BatchProgress("batch"))
        except KeyboardInterrupt:
            interrupted = True
    found = done | {
        task.name: _outcome(task, ended.get(task.name), out) for task in todo
    }
    if all(row.code is not None for row in found.values()):
        # Else what was cut short may go on from there.
        shutil.rmtree(out / DRAFTS, ignore_errors=True)
    return Batch(out, tuple(tasks), found, len(todo), interrupted)


def _done(tasks: list[Task], out: Path) -> dict[str, Outcome]:
    """Tasks whose results are there already."""
    rows = {task.name: read_outcome(out / task.name) for task in tasks}
    return {
        task.name: rows[task.name]
        for task in tasks
        if rows[task.name] is not None and rows[task.name].key == task.key
    }


def _check_sweep(batch: BatchFile, path: Path) -> None:
    """Refuse keys that no file can have, before hours of work."""
    for key in dict.fromkeys(k for v in batch.variants() for k in v):
        try:
            check_key(file_class(is_sole(key)), key)
        except InputError as error:
            raise InputError(f"{path.name}: {error}") from error


def _prepare(out: Path, tasks: list[Task]) -> None:
    """Make the folder, or see that it is a batch's."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        held = any(out.iterdir())
        if held and not (out / _MARK).is_file():
            raise InputError(
                f"{out}: holds something that is no batch; choose another "
                "folder for --out"
            )
        write_json(out / _MARK, {task.name: task.key for task in tasks})
    except OSError as error:
        raise InputError(
            f"{out}: cannot be written ({error.strerror}); choose another "
            "folder for --out"
        ) from error


def _job(task: Task, out: Path, parse: str, near: Path) -> Job:
    arguments = {
        "task": vars(task),
        "out": str(out),
        "parse": parse,
        "near": str(near),
    }
    return Job(
        task.name,
        "drake_exo.batch.work:run_task",
        arguments,
        tuple(task.needs.values()),
        str(log_of(task, out)),
    )


def _without_failed(
    jobs: list[Job], done: dict[str, Outcome]
) -> tuple[list[Job], list[Ended]]:
    """Jobs that can run, free of what is done; and those that never can."""
    ready, held = [], {}
    for job in jobs:
        lacking = [
            need
            for need in job.needs
            if need in held or (need in done and not done[need].is_solved)
        ]
        if lacking:
            reason = f"not begun: {lacking[0]} was not done"
            held[job.name] = Ended(job.name, "skipped", error=reason)
        else:
            needs = tuple(need for need in job.needs if need not in done)
            ready.append(replace(job, needs=needs))
    return ready, list(held.values())


def _outcome(task: Task, row: Ended | None, out: Path) -> Outcome:
    """By task.json, or by what the pool says where there is none."""
    found = read_outcome(out / task.name)
    if found is not None and found.key == task.key:
        return found
    error = "interrupted" if row is None else row.error
    return outcome(task, None, error)


def _tell(row: Ended) -> None:
    """A task that failed is told at once."""
    if row.state != "done":
        print(f"{row.name}: {row.error}", flush=True)
        if row.trace:
            print(row.trace, flush=True)
