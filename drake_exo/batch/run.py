"""Runs the tasks of a batch file that are not done yet.

A worker runs a task's command, which writes into a draft folder below
DIR/.drafts. When the command has ended, the draft is renamed to the task's
folder, so results are never half there. It then holds task.json (how the task
ended) and timing.json (alone with times, the host, and what was printed).
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import shutil
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from drake_exo.batch.file import (
    BUILDS_ON,
    LAB,
    BatchFile,
    Task,
    changed_text,
    check_key,
    file_class,
    is_sole,
    tasks_of,
)
from drake_exo.errors import InputError, first_line
from drake_exo.files import schema
from drake_exo.files.output import (
    FAILS,
    HOLDS,
    MANIFEST,
    UNSOLVED,
    locked,
    write_json,
)
from drake_exo.jobs.engine import BatchProgress, Ended, Job, Pool, run_jobs
from drake_exo.jobs.process_child import function_of

TASK, TIMING = "task.json", "timing.json"
DRAFTS = ".drafts"
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
# Step -> file from which a killed run continues to the same result.
_CHECKPOINTS = {"sole optimize": "checkpoint.json"}
_WORDS = {0: HOLDS, 1: UNSOLVED, 2: "failed", 3: FAILS}


@dataclass(frozen=True)
class Outcome:
    """How a task ended, as task.json holds it.

    Attributes:
        key: hash of all that the results depend on, see `batch.file`.
        code: exit code of its command; None if the command did not end.
        verdict: "holds", "does not hold", "not solved", "failed", or "not
            done" if the user stopped it.
        sentence: why, if it does not hold.
        task: what was run: entry, variant, step, options, changes.
    """

    key: str
    code: int | None
    verdict: str
    sentence: str = ""
    task: dict[str, Any] = field(default_factory=dict)

    @property
    def is_solved(self) -> bool:
        """Whether other tasks can build on it."""
        return self.code in (0, 3)


def read_outcome(folder: Path) -> Outcome | None:
    """Outcome in a folder's task.json; None if that is missing or damaged."""
    try:
        return Outcome(**json.loads((folder / TASK).read_text("utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def outcome(
    task: Task, code: int | None, sentence: str = "", verdict: str = ""
) -> Outcome:
    """Outcome of a task, with the verdict of its exit code if none is given.

    A result accepted with failing checks has code 0 but "does not hold".
    """
    told = {
        "entry": task.entry,
        "variant": task.variant,
        "step": task.step,
        "options": list(task.options),
        "changes": task.changes,
    }
    word = verdict or _WORDS.get(code, "failed")
    return Outcome(task.key, code, word, sentence, told)


def log_of(task: Task, out: Path) -> Path:
    """File that a task prints to while it runs."""
    return out / DRAFTS / f"{_mark(task)}.log"


def _mark(task: Task) -> str:
    """Name that a task's drafts begin with; differs for tasks of equal key."""
    return sha256(f"{task.name} {task.key}".encode()).hexdigest()[:16]


def run_task(task: dict[str, Any], out: str, parse: str, near: str) -> str:
    """Run one task; called in a worker.

    Args:
        task: fields of a `Task`.
        out: folder of the batch's results.
        parse: "module:name" of the function that parses a command line.
        near: folder of the batch file; sentences omit it from paths.

    Returns:
        The verdict, if other tasks can build on the results.

    Raises:
        InputError: the task failed or was not solved, as task.json says; or
            the disk is full: without task.json the next run repeats it.
    """
    task, out = Task(**task), Path(out)
    drafts = out / DRAFTS
    drafts.mkdir(parents=True, exist_ok=True)
    earlier = sorted(drafts.glob(f"{_mark(task)}-*"))
    draft = Path(tempfile.mkdtemp(prefix=f"{_mark(task)}-", dir=drafts))
    results, log = draft / "out", log_of(task, out)
    start = time.perf_counter()
    with _printing_to(log):
        try:
            code, sentence = _run(task, out, draft, earlier, parse, near)
        except Exception:
            if _CHECKPOINTS.get(task.step) is None:
                shutil.rmtree(draft, ignore_errors=True)
            raise
    sentence = _without(sentence, draft, out, Path(near))
    found = outcome(task, code, sentence, _verdict(results, code))
    results.mkdir(exist_ok=True)
    timing = _take_times(results)
    timing |= {
        "seconds": time.perf_counter() - start,
        "host": socket.gethostname(),
        "log": log.read_text("utf-8", "replace").splitlines(),
    }
    swept = draft / (task.source.name if task.source else "study.yaml")
    if swept.is_file():
        # An optimised sole already has a case file, with the start found.
        name = swept.name
        name = f"swept_{name}" if (results / name).exists() else name
        os.replace(swept, results / name)
    write_json(results / TIMING, timing)
    write_json(results / TASK, found)
    _place(results, out / task.name, draft)
    for old in (*earlier, draft):
        shutil.rmtree(old, ignore_errors=True)
    log.unlink(missing_ok=True)
    if not found.is_solved:
        raise InputError(found.sentence)
    return found.verdict


def _run(task, out, draft, earlier, parse, near) -> tuple[int, str]:
    """Exit code of the task's command, and a sentence on what is wrong."""
    try:
        # Paths and modules in options start from the batch file's folder.
        with _in_folder(near):
            args = function_of(parse)(_command(task, out, draft, earlier))
            code = args.run(args) or 0
    except InputError as error:
        _raise_if_full(error)
        return 2, str(error)
    except OSError as error:
        _raise_if_full(error)
        raise
    return code, _why(draft / "out", code, log_of(task, out))


@contextlib.contextmanager
def _in_folder(folder: str):
    """Work in a folder, and let Python import its modules."""
    before = os.getcwd()
    os.chdir(folder)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        os.chdir(before)


def _command(task: Task, out: Path, draft: Path, earlier) -> list[str]:
    """Arguments of `drake-exo`; writes the changed study or case, if any."""
    to = ["--out", str(draft / "out")]
    if task.step == LAB:
        return [LAB, *task.options, "--jobs", "1", *to]
    source, root = task.source, task.root
    if source is None:
        source = out / task.needs[LAB] / "study.yaml"
    of_sole = task.step.startswith("sole")
    if root is None and not of_sole:  # a case's recording has its own root
        root = source.parent
    if task.changes:
        text = changed_text(source, file_class(of_sole), task.changes, root)
        source = draft / source.name
        source.write_text(text, encoding="utf-8")
    command = [*task.step.split(), str(source)]
    if root is not None:
        command += ["--data-root", str(root)]
    if "calibrate" in task.needs:
        command += ["--calibration", str(out / task.needs["calibrate"])]
    checkpoint = _CHECKPOINTS.get(task.step)
    if checkpoint is not None:
        left = [d for d in earlier if (d / "out" / checkpoint).is_file()]
        if left:
            newest = max(left, key=lambda d: (d / "out").stat().st_mtime)
            command += ["--resume", str(newest / "out")]
    return [*command, *task.options, *to]


def _summary(results: Path) -> dict:
    """Contents of the command's summary; {} without one."""
    try:
        found = json.loads((results / "summary.json").read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _verdict(results: Path, code: int) -> str:
    """Verdict in the command's summary; "" if there is none."""
    word = _summary(results).get("verdict") if code != 2 else None
    return word if isinstance(word, str) else ""


def _why(results: Path, code: int, log: Path) -> str:
    """Sentence on what is wrong with the results; "" if nothing is."""
    for check in _summary(results).get("checks", []):
        if check["level"] == "fail" and not check["holds"]:
            parts = (check["name"], check["where"], check["sentence"])
            return ": ".join(part for part in parts if part)
    if code == 0:
        return ""
    said = [line for line in _lines(log) if line.startswith("not solved")]
    return said[0] if said else _last_line(log)


def _raise_if_full(error: BaseException) -> None:
    """Raise an InputError that says so if the disk is full."""
    cause = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _NO_ROOM:
            raise InputError(
                f"its results cannot be written ({cause.strerror}); make "
                "room and run the batch again"
            ) from error
        cause = cause.__cause__ or cause.__context__


@contextlib.contextmanager
def _printing_to(log: Path):
    """Send what Python and compiled code print to a file."""
    kept = [os.dup(1), os.dup(2)]
    with log.open("a", encoding="utf-8", buffering=1) as file:
        file.truncate(0)
        for fd in (1, 2):
            os.dup2(file.fileno(), fd)
        try:
            with (
                contextlib.redirect_stdout(file),
                contextlib.redirect_stderr(file),
            ):
                yield
        finally:
            for fd, old in zip((1, 2), kept, strict=True):
                os.dup2(old, fd)
                os.close(old)


def _lines(log: Path) -> list[str]:
    return log.read_text("utf-8", "replace").splitlines()


def _last_line(log: Path) -> str:
    lines = [line.strip() for line in _lines(log) if line.strip()]
    return first_line(lines[-1]) if lines else "it said nothing"


def _without(sentence: str, draft: Path, *folders: Path) -> str:
    """The sentence, with paths relative to the folders that they are in."""
    for folder in (draft, *folders):
        sentence = sentence.replace(f"{folder}{os.sep}", "")
    return sentence


def _take_times(results: Path) -> dict[str, Any]:
    """Move all durations out of a folder's JSON files; file -> durations."""
    found = {}
    for path in sorted(results.rglob("*.json")):
        try:
            tree = json.loads(path.read_text("utf-8"))
        except ValueError:
            continue
        times: dict[str, Any] = {}
        rest = _without_times(tree, "", times)
        if times:
            found[path.relative_to(results).as_posix()] = times
            write_json(path, rest)
    return {"files": found}


def _without_times(tree, place: str, times: dict[str, Any]):
    """The tree without its times, which go to `times` by dotted key."""
    if isinstance(tree, dict):
        rest = {}
        for key, value in tree.items():
            where = f"{place}.{key}" if place else key
            if key == "seconds" or key.endswith("_seconds"):
                times[where] = value
            else:
                rest[key] = _without_times(value, where, times)
        return rest
    if isinstance(tree, list):
        return [
            _without_times(value, f"{place}.{k}", times)
            for k, value in enumerate(tree)
        ]
    return tree


def _place(results: Path, target: Path, draft: Path) -> None:
    """Replace earlier results by renaming, so none are ever half there."""
    (results / MANIFEST).unlink(missing_ok=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists():
        os.replace(target, draft / "old")
    os.replace(results, target)


_MARK = "tasks.json"


@dataclass(frozen=True)
class Batch:
    """Tasks and how they ended.

    Attributes:
        out: folder of all results.
        tasks: in the order of the batch file.
        outcomes: task's name -> how it ended.
        fresh: number of tasks that this run began.
        interrupted: by Ctrl-C; tasks that have not ended are "not done".
    """

    out: Path
    tasks: tuple[Task, ...]
    outcomes: dict[str, Outcome]
    fresh: int
    interrupted: bool = False

    @property
    def bad(self) -> list[tuple[Task, Outcome]]:
        """Tasks that failed or do not hold, accepted or not."""
        rows = [(task, self.outcomes[task.name]) for task in self.tasks]
        return [
            (task, found)
            for task, found in rows
            if found.code != 0 or found.verdict != HOLDS
        ]

    @property
    def exit_code(self) -> int:
        """0 where every task holds or is accepted, 130 by Ctrl-C, else 3."""
        if self.interrupted:
            return 130
        return 3 if any(found.code != 0 for _, found in self.bad) else 0


def run_batch(
    path: str | Path,
    out: str | Path,
    open_pool: Callable[[], AbstractContextManager[Pool]],
    parse: str,
    write: Callable[[Batch], object],
) -> Batch:
    """Run the tasks of a batch that are not done yet.

    Args:
        path: of the batch file.
        out: folder of results; may hold those of an earlier run.
        open_pool: makes the pool; called only if there are tasks to run.
        parse: "module:name" of the function that parses a command line.
        write: called with the returned batch while `out` is still locked.

    Raises:
        InputError: the batch file is not as it should be, or `out` holds
            something else.
    """
    path, out = (Path(os.path.realpath(p)) for p in (path, out))
    batch = schema.load(path, BatchFile)
    try:
        tasks = tasks_of(batch, path.parent)
        done = _done(tasks, out)
        todo = [task for task in tasks if task.name not in done]
        if todo:  # before hours of work
            for key in dict.fromkeys(k for v in batch.variants() for k in v):
                check_key(file_class(is_sole(key)), key)
            _check_values(tasks)
            _check_options(batch, function_of(parse), path.parent)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from error
    with _prepared(out, tasks):
        near = path.parent
        found = _run_all(out, tasks, done, todo, open_pool, parse, near)
        write(found)
    return found


def _run_all(out, tasks, done, todo, open_pool, parse, near) -> Batch:
    ended: dict[str, Ended] = {}
    interrupted = False
    if todo:
        jobs = [_job(task, out, parse, near) for task in todo]
        before = {
            name: Ended(name, "done" if row.is_solved else "failed")
            for name, row in done.items()
        }

        def end(row: Ended) -> None:
            ended[row.name] = row
            _tell(row)

        try:
            with open_pool() as pool:
                run_jobs(jobs, pool, end, BatchProgress("batch"), before)
        except KeyboardInterrupt:
            interrupted = True
    found = done | {
        task.name: _outcome(task, ended.get(task.name), out) for task in todo
    }
    if all(row.code is not None for row in found.values()):
        # Otherwise a run that was cut short may resume from its draft.
        shutil.rmtree(out / DRAFTS, ignore_errors=True)
    begun = sum(row.state != "skipped" for row in ended.values())
    return Batch(out, tuple(tasks), found, begun, interrupted)


def _done(tasks: list[Task], out: Path) -> dict[str, Outcome]:
    """Outcomes of tasks whose results carry their key, by name."""
    rows = {task.name: read_outcome(out / task.name) for task in tasks}
    return {
        task.name: rows[task.name]
        for task in tasks
        if rows[task.name] is not None and rows[task.name].key == task.key
    }


def _check_values(tasks: Sequence[Task]) -> None:
    """Refuse a swept key's value that none of the tasks' files can have."""
    sound: set[tuple[str, str]] = set()
    wrong: dict[tuple[str, str], InputError] = {}
    # Steps on one file differ in nothing that is read here.
    for task in {(t.source, t.variant): t for t in tasks}.values():
        values = {(key, repr(value)) for key, value in task.changes.items()}
        if values <= sound:
            continue
        try:
            if task.source is not None:  # else a laboratory writes it first
                cls = file_class(any(map(is_sole, task.changes)))
                name = f"{task.source}, {task.variant}"
                text = changed_text(task.source, cls, task.changes, task.root)
                schema.load_text(text, cls, name)
        except InputError as error:
            wrong |= dict.fromkeys(values - wrong.keys(), error)
        else:
            sound |= values
    for value, error in wrong.items():
        if value not in sound:
            raise error


def _check_options(batch: BatchFile, parse: Callable, near: Path) -> None:
    """Refuse options that a command does not have, and a design that is none.

    Paths in options start from the folder `near`.
    """
    told = dict(batch.options)
    if batch.laboratories is not None:
        told[LAB] = batch.laboratories.options()
    for step, options in told.items():
        given = ["--calibration", "DIR"] if step in BUILDS_ON else []
        file = [] if step == LAB else ["FILE"]
        command = [*step.split(), *file, "--out", "DIR", *given, *options]
        said = io.StringIO()
        try:
            with (
                contextlib.redirect_stderr(said),
                contextlib.redirect_stdout(io.StringIO()),
            ):
                args = parse(command)
        except SystemExit as error:
            text = said.getvalue().strip().splitlines()
            why = text[-1].rpartition("error: ")[2] if error.code else "help"
            raise InputError(
                f"options of {step}: {why}; see 'drake-exo {step} --help'"
            ) from error
        if getattr(args, "design", None) is not None:
            from drake_exo.contact.strap import read_design

            try:
                with _in_folder(str(near)):
                    read_design(args.design)
            except InputError as error:
                raise InputError(f"options of {step}: {error}") from error


@contextlib.contextmanager
def _prepared(out: Path, tasks: list[Task]):
    """Make the folder, or check that it is a batch's, and lock it."""
    with contextlib.ExitStack() as held:
        try:
            out.mkdir(parents=True, exist_ok=True)
            strange = any(out.iterdir()) and not (out / _MARK).is_file()
            if strange:
                raise InputError(
                    f"{out}: holds something that is not a batch; choose "
                    "another folder for --out"
                )
            held.enter_context(locked(out))
            write_json(out / _MARK, {task.name: task.key for task in tasks})
        except OSError as error:
            raise InputError(
                f"{out}: cannot be written ({error.strerror}); choose another "
                "folder for --out"
            ) from error
        yield


def _job(task: Task, out: Path, parse: str, near: Path) -> Job:
    arguments = {
        "task": vars(task),
        "out": str(out),
        "parse": parse,
        "near": str(near),
    }
    return Job(
        task.name,
        "drake_exo.batch.run:run_task",
        arguments,
        tuple(task.needs.values()),
        str(log_of(task, out)),
    )


def _outcome(task: Task, row: Ended | None, out: Path) -> Outcome:
    """Outcome by task.json, or by what the pool says if there is none."""
    found = read_outcome(out / task.name)
    if found is not None and found.key == task.key:
        return found
    if row is None:
        return outcome(task, None, "stopped by the user", "not done")
    return outcome(task, None, row.error)


def _tell(row: Ended) -> None:
    """Print why a task failed, as soon as it has."""
    if row.state != "done":
        print(f"{row.name}: {row.error}", flush=True)
        if row.trace:
            print(row.trace, flush=True)
