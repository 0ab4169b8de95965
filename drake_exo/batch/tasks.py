"""Tasks of a batch: commands on subjects and soles, and their keys.

A task's key is made of all that its results depend on: the contents of its
files, what is changed in them, options, the keys of the tasks it builds on,
and the code. A task whose results carry its key is done.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

import drake_exo
from drake_exo.batch.file import (
    BUILDS_ON,
    CASE_STEPS,
    STUDY_STEPS,
    BatchFile,
    Entry,
    entries,
    variant_name,
)

LAB = "lab"
_LIBRARIES = (
    *("drake", "numpy", "scipy", "ipyopt", "matplotlib"),
    *("numba", "mmgpy", "meshio", "ezc3d"),
)
_CODE = (".py", ".sdf", ".xml", ".obj", ".js", ".css")


@dataclass(frozen=True)
class Task:
    """One command.

    Attributes:
        name: unique; the folder of its results.
        entry: subject or sole.
        variant: what is changed in its file, "" if nothing.
        step: "lab", or a step of the batch file.
        options: of the command, but for files and folders.
        source: study or case file; None of a laboratory, and of what uses it.
        root: folder that its paths start from; None for the file's own.
        changes: dotted key -> value.
        needs: names of tasks whose results it reads, lab and calibration.
        key: see the module.
    """

    name: str
    entry: str
    variant: str
    step: str
    options: tuple[str, ...] = ()
    source: Path | None = None
    root: Path | None = None
    changes: dict[str, Any] = field(default_factory=dict)
    needs: dict[str, str] = field(default_factory=dict)
    key: str = ""


def tasks_of(batch: BatchFile, folder: Path) -> list[Task]:
    """All tasks of a batch, each after those that it needs.

    Args:
        batch: what the file says.
        folder: that it stands in.

    Raises:
        InputError: see `file.entries`.
    """
    subjects, soles = entries(batch, folder)
    root = None if batch.data_root is None else folder / batch.data_root
    tasks: dict[str, Task] = {}
    digests = {e: _digests(e.path, root) for e in subjects + soles if e.path}
    for entry in subjects + soles:
        known = STUDY_STEPS if entry in subjects else CASE_STEPS
        steps = [step for step in known if step in batch.steps]
        if entry.seed is not None:
            _add(tasks, _laboratory(batch, entry))
        for changes in _variants(batch, entry in soles):
            for step in steps:
                task = _task(batch, entry, changes, step, root)
                keys = [tasks[name].key for name in task.needs.values()]
                _add(tasks, _keyed(task, digests.get(entry, {}), keys))
    return list(tasks.values())


def _add(tasks: dict[str, Task], task: Task) -> None:
    tasks[task.name] = task


def _variants(batch: BatchFile, of_sole: bool) -> list[dict[str, Any]]:
    """Changes to a study, or to a case: each key to where it belongs."""
    found: dict[str, dict] = {}
    for changes in batch.variants():
        ours = {k: v for k, v in changes.items() if is_sole(k) == of_sole}
        found.setdefault(variant_name(ours), ours)
    return list(found.values())


# The keys of a case file; every other is a study's.
SOLE_KEYS = (
    *("name", "mesh", "material", "load", "loads"),
    *("contact", "start", "cost", "optimize"),
)


def is_sole(key: str) -> bool:
    """Whether a dotted key is of a case file, not of a study."""
    return key.partition(".")[0] in SOLE_KEYS


def _laboratory(batch: BatchFile, entry: Entry) -> Task:
    options = ["--seed", str(entry.seed), *batch.laboratories.options()]
    name = f"{entry.name}/{LAB}"
    return _keyed(Task(name, entry.name, "", LAB, tuple(options)), {}, [])


def _task(batch, entry, changes, step, root) -> Task:
    variant = variant_name(changes)
    place = f"{entry.name}/{variant}" if variant else entry.name
    needs = {}
    if entry.seed is not None:
        needs[LAB] = f"{entry.name}/{LAB}"
    if step in BUILDS_ON:
        needs[BUILDS_ON[step]] = f"{place}/{BUILDS_ON[step]}"
    return Task(
        f"{place}/{step.replace(' ', '_')}",
        entry.name,
        variant,
        step,
        batch.options.get(step, ()),
        entry.path,
        root,
        changes,
        needs,
    )


def _keyed(task: Task, digests: dict, keys: list[str]) -> Task:
    told = {
        "step": task.step,
        "options": task.options,
        "changes": task.changes,
        "files": digests,
        "needs": keys,
        "code": code_digest(),
    }
    text = json.dumps(told, sort_keys=True, default=str)
    key = hashlib.sha256(text.encode()).hexdigest()
    return Task(**vars(task) | {"key": key})


@cache
def code_digest() -> str:
    """Of this package's code and the libraries that it computes with."""
    found = hashlib.sha256(drake_exo.__version__.encode())
    package = Path(drake_exo.__file__).parent
    for folder in (package, package.parent / "models"):
        for path in sorted(folder.rglob("*")):
            if path.suffix in _CODE:
                found.update(path.relative_to(folder).as_posix().encode())
                found.update(path.read_bytes())
    for name in _LIBRARIES:
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            version = "absent"
        found.update(f"{name} {version}".encode())
    return found.hexdigest()


def _digests(path: Path, root: Path | None) -> dict[str, str]:
    """Of a study or case file and of every file that it names.

    Whatever text in it is the path of a file counts as one, so that a key
    that comes new cannot be forgotten here.
    """
    found = {"": _digest(path)}
    try:
        tree = yaml.load(path.read_bytes(), Loader=_Loader)
    except (OSError, yaml.YAMLError, ValueError):
        return found  # its task says what is wrong
    base = path.parent if root is None else root
    for word in sorted(set(_words(tree))):
        found[word] = _digest(base / word)
    return {word: digest for word, digest in found.items() if digest}


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _words(tree) -> list[str]:
    if isinstance(tree, str):
        return [tree]
    if isinstance(tree, dict):
        return [word for value in tree.values() for word in _words(value)]
    if isinstance(tree, list):
        return [word for value in tree for word in _words(value)]
    return []


def _digest(path: Path) -> str:
    """Of a file's contents, "" if it is none."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError):
        return ""
