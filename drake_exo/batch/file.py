"""Reads a batch file: subjects and soles, steps, settings to vary.

`tasks_of` turns it into tasks. Each is one command on one subject or sole, with
one variant of the `sweep` (other values for keys of a study or a case). A
task's key is a hash of all that its results depend on: the contents of its
files, the keys changed in them, options, the keys of the tasks that it builds
on, and the code. A task whose results carry its key is done.
"""

from __future__ import annotations

import dataclasses
import glob
import hashlib
import importlib.metadata
import itertools
import json
import os
import re
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import yaml

import drake_exo
from drake_exo.errors import InputError, nearest
from drake_exo.files import schema
from drake_exo.files.output import read_bytes
from drake_exo.files.schema import quantity

STUDY_STEPS = ("check", "calibrate", "crossvalidate", "predict", "design")
CASE_STEPS = ("sole simulate", "sole optimize")
Step = Literal[(*STUDY_STEPS, *CASE_STEPS)]
# Step -> step whose results, for the same subject, it reads.
BUILDS_ON = {"predict": "calibrate", "design": "calibrate"}
_OURS = ("--out", "--force", "--resume", "--data-root", "--calibration")
_LONGEST = 100  # characters of a variant's name
_MOST_SEEDS = 100_000  # more tasks than a scheduler's memory holds


@dataclass(frozen=True)
class SeedRange:
    """Seeds from `first` to `last`, both included."""

    first: int = quantity(None, minimum=0)
    last: int = quantity(None, minimum=0)

    def __post_init__(self):
        if self.last < self.first:
            raise InputError(f"last ({self.last}) is before first")
        if self.last - self.first >= _MOST_SEEDS:
            raise InputError(
                f"first to last are {self.last - self.first + 1} subjects; "
                f"give {_MOST_SEEDS} at most"
            )


@dataclass(frozen=True)
class Laboratories:
    """Campaigns of the virtual laboratory, one subject for each seed.

    Attributes:
        seeds: a list, or `first` and `last`.
        truth: how far from a calibration's start: "wide" or "near".
        trials: number of movements; all nine by default.
        without: disturbances to switch off.
    """

    seeds: tuple[int, ...] | SeedRange = quantity(None, minimum=0)
    truth: Literal["wide", "near"] = "wide"
    trials: int | None = quantity(None, None, minimum=1, maximum=9)
    without: tuple[str, ...] = ()

    def __post_init__(self):
        if not self.all_seeds():
            raise InputError("seeds: give at least one")

    def all_seeds(self) -> tuple[int, ...]:
        """Every seed once, in the order given."""
        s = self.seeds
        if isinstance(s, SeedRange):
            return tuple(range(s.first, s.last + 1))
        return tuple(dict.fromkeys(s))

    def options(self) -> list[str]:
        """Options of `drake-exo lab`, except seed and folder."""
        found = ["--truth", self.truth]
        if self.trials is not None:
            found += ["--trials", str(self.trials)]
        return found + (["--without", *self.without] if self.without else [])


@dataclass(frozen=True)
class BatchFile:
    """Contents of a batch file.

    Attributes:
        steps: commands to run on every subject or sole.
        studies: study files; `*` and `**` as in a shell. Relative to the
            batch file, as all paths.
        laboratories: subjects that are simulated first.
        cases: case files of soles.
        data_root: folder that paths in studies and cases start from; by
            default each file's own.
        sweep: dotted key -> values, of which every combination is run; or a
            list of combinations.
        options: step -> further options of its command.
    """

    steps: tuple[Step, ...]
    studies: tuple[str, ...] = ()
    laboratories: Laboratories | None = None
    cases: tuple[str, ...] = ()
    data_root: Path | None = None
    sweep: dict[str, tuple[Any, ...]] | tuple[dict[str, Any], ...] = field(
        default_factory=dict
    )
    options: dict[Step, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self):
        subjects = bool(self.studies) or self.laboratories is not None
        wanted = [
            ("studies or laboratories", subjects, STUDY_STEPS),
            ("cases", bool(self.cases), CASE_STEPS),
        ]
        for what, given, steps in wanted:
            ours = [step for step in self.steps if step in steps]
            if given and not ours:
                raise InputError(
                    f"no step uses the {what}; add one of {', '.join(steps)} "
                    "to steps"
                )
            if ours and not given:
                raise InputError(f"step {ours[0]!r} needs {what}; name some")
        if not self.steps:
            raise InputError(
                f"steps is empty; name some of "
                f"{', '.join(STUDY_STEPS + CASE_STEPS)}"
            )
        for step, base in BUILDS_ON.items():
            if step in self.steps and base not in self.steps:
                raise InputError(
                    f"{step!r} builds on {base!r}; add {base} to steps"
                )
        for step, options in self.options.items():
            if step not in self.steps:
                raise InputError(f"options: {step!r} is not one of the steps")
            for option in options:
                word = option.partition("=")[0]
                # argparse accepts abbreviated option names.
                ours = [o for o in _OURS if o.startswith(word) and word[2:]]
                if ours:
                    raise InputError(
                        f"options of {step!r}: the batch itself gives "
                        f"{ours[0]}; leave {option} out"
                    )
        for key in (key for changes in self.variants() for key in changes):
            if not (self.cases if is_sole(key) else subjects):
                file, none = (
                    ("case", "cases") if is_sole(key)
                    else ("study", "studies or laboratories")
                )  # fmt: skip
                raise InputError(
                    f"sweep: {key!r} is a key of a {file} file, but the batch "
                    f"has no {none}; leave the key out"
                )

    def variants(self) -> list[dict[str, Any]]:
        """Key -> value of each variant of the sweep; one empty without sweep.

        Raises:
            InputError: a key has no values, or a combination is given twice.
        """
        if isinstance(self.sweep, dict):
            for key, values in self.sweep.items():
                if not values:
                    raise InputError(f"sweep: {key} has no values")
            found = [
                dict(zip(self.sweep, values, strict=True))
                for values in itertools.product(*self.sweep.values())
            ]
        else:
            found = list(self.sweep) or [{}]
        names = [variant_name(changes) for changes in found]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"sweep: {name or 'nothing'} is given twice")
        return found


@dataclass(frozen=True)
class Entry:
    """A subject or a sole.

    Attributes:
        name: unique; the folder of its results.
        path: of its study or case file; None for a laboratory's subject.
        seed: of the laboratory's subject.
    """

    name: str
    path: Path | None = None
    seed: int | None = None


def entries(batch: BatchFile, folder: Path) -> tuple[list[Entry], list[Entry]]:
    """Subjects and soles of a batch.

    Args:
        batch: contents of the batch file.
        folder: of the batch file.

    Raises:
        InputError: a pattern finds nothing, or two files share a name.
    """
    subjects = _found(batch.studies, folder, "studies")
    if batch.laboratories is not None:
        seeds = batch.laboratories.all_seeds()
        subjects += [Entry(f"seed_{seed}", seed=seed) for seed in seeds]
    soles = _found(batch.cases, folder, "cases")
    known: dict[str, Entry] = {}
    for entry in subjects + soles:
        if entry.name in known:
            raise InputError(
                f"{_told(known[entry.name])} and {_told(entry)} would both be "
                f"called {entry.name!r}; rename one"
            )
        known[entry.name] = entry
    return subjects, soles


def _told(entry: Entry) -> str:
    return str(entry.path or "laboratories")


def _found(patterns, folder: Path, key: str) -> list[Entry]:
    paths: dict[Path, None] = {}
    for pattern in patterns:
        # root_dir, since the folder's name may hold * or [.
        hits = sorted(glob.glob(pattern, root_dir=folder, recursive=True))
        hits = [hit for hit in hits if (folder / hit).is_file()]
        if not hits:
            raise InputError(f"{key}: {pattern} finds no file; check the path")
        paths |= dict.fromkeys(
            Path(os.path.normpath(folder / hit)) for hit in hits
        )
    return [Entry(_name(path, folder), path) for path in paths]


def _name(path: Path, folder: Path) -> str:
    """Name of an entry: path of its file without suffix, .., study, case."""
    parts = list(Path(os.path.relpath(path, folder)).with_suffix("").parts)
    parts = [part for part in parts if part != ".."]
    if len(parts) > 1 and parts[-1] in ("study", "case"):
        parts.pop()
    return "/".join(re.sub(r"[^\w.+-]", "_", part) for part in parts)


def variant_name(changes: dict[str, Any]) -> str:
    """Name of a variant's folder, such as "filter.cutoff_hz=6,mass=70"."""
    text = ",".join(f"{key}={_value(v)}" for key, v in changes.items())
    if len(text) <= _LONGEST:
        return text
    digest = hashlib.sha256(text.encode()).hexdigest()
    return f"{text[:_LONGEST]}~{digest[:8]}"


def _value(value: Any) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value, float) and float(text) != value:
        text = repr(value)
    return re.sub(r"[^\w.+-]", "_", text)


def changed_text(
    path: Path, cls: type, changes: Mapping[str, Any], root: Path | None = None
) -> str:
    """YAML text of a study or case with all its keys, some of them changed.

    It is for a file in another folder: paths of files become absolute, except
    those that start from a root.

    Args:
        path: of the file.
        cls: its dataclass.
        changes: dotted key -> value.
        root: folder that its paths start from; None for the file's own.

    Raises:
        InputError: the file says something that is not allowed, or has no
            such key.
    """
    tree = yaml.safe_load(schema.dump_text(schema.load(path, cls)))
    for key, value in changes.items():
        place, (*parts, last) = tree, key.split(".")
        for part in parts:
            below = _step(path, key, place, part)
            if below is None:  # a group that the file leaves out
                below = place[_index(place, part)] = {}
            place = below
        if place != {}:
            _step(path, key, place, last)
        place[_index(place, last)] = value
    # A recording's study is looked for beside its case, whatever the root.
    keys = ("recording",) if root else ("recording", "file", "heights")
    tree = _with_whole_paths(tree, keys, path.parent)
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=80)


def _with_whole_paths(tree, keys: Sequence[str], folder: Path):
    if isinstance(tree, list):
        return [_with_whole_paths(value, keys, folder) for value in tree]
    if not isinstance(tree, dict):
        return tree
    return {
        key: os.path.abspath(folder / value)
        if key in keys and isinstance(value, str)
        else _with_whole_paths(value, keys, folder)
        for key, value in tree.items()
    }


def _index(place, part: str):
    return int(part) if isinstance(place, list) and part.isdecimal() else part


def _step(path: Path, key: str, place, part: str):
    """Value at one part of a dotted key, where `place` is the part before."""
    index = _index(place, part)
    if isinstance(place, dict) and index in place:
        return place[index]
    if isinstance(place, list) and isinstance(index, int):
        if index < len(place):
            return place[index]
        remedy = f"; the list has {len(place)} elements, the first is 0"
    else:
        known = list(map(str, place)) if isinstance(place, dict) else []
        remedy = nearest(part, known) or "; give it in the file"
    raise InputError(
        f"{path}: has no key {key!r} to sweep: {part!r} is unknown{remedy}"
    )


def file_class(of_sole: bool) -> type:
    """The dataclass of a case file, or of a study file."""
    if of_sole:
        from drake_exo.soles.settings import Settings

        return Settings
    from drake_exo.study import StudyFile

    return StudyFile


def check_key(cls: type, key: str) -> None:
    """Refuse a dotted key that no file of the class can have.

    Raises:
        InputError: there is no such key; names the part that is unknown.
    """
    hints: list[Any] = [cls]
    for part in key.split("."):
        known: set[str] = set()
        found: list[Any] = []
        for hint in hints:
            if dataclasses.is_dataclass(hint):
                own = schema.keys(hint)
                known |= set(own)
                found += [own[part]] if part in own else []
            elif typing.get_origin(hint) is dict or hint is Any:
                found.append((*typing.get_args(hint), Any)[-1])
            elif part.isdecimal():
                found += [a for a in typing.get_args(hint) if a is not ...]
        if not found:
            raise InputError(
                f"sweep: {key!r} is not a key: {part!r} is "
                f"unknown{nearest(part, sorted(known))}"
            )
        hints = [option for hint in found for option in _options(hint)]


def _options(hint) -> list:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [o for o in typing.get_args(hint) if o is not type(None)]
    return [hint]


LAB = "lab"
_LIBRARIES = (
    *("drake", "numpy", "scipy", "casadi", "matplotlib"),
    *("numba", "mmgpy", "meshio", "ezc3d"),
)
_CODE = (".py", ".sdf", ".xml", ".obj", ".js", ".css")


@dataclass(frozen=True)
class Task:
    """One command of `drake-exo` on a subject or sole.

    Attributes:
        name: unique; the folder of its results.
        entry: name of the subject or sole.
        variant: name of the changes to its file, "" without any.
        step: "lab", or a step of the batch file.
        options: of the command, except files and folders.
        source: study or case file; None for a laboratory and its subjects.
        root: folder that its paths start from; None for the file's own.
        changes: dotted key -> value.
        needs: "lab" or "calibrate" -> name of the task whose results it reads.
        key: hash of all that its results depend on, see the module.
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
        batch: contents of the batch file.
        folder: of the batch file.

    Raises:
        InputError: see `entries`; no data_root; or nested results' folders.
    """
    subjects, soles = entries(batch, folder)
    root = None if batch.data_root is None else folder / batch.data_root
    if root is not None and not root.is_dir():
        raise InputError(f"data_root: {batch.data_root} is not a folder")
    tasks: dict[str, Task] = {}

    def add(task: Task, files: dict[str, str]) -> None:
        told = {
            "step": task.step,
            "options": task.options,
            "changes": task.changes,
            "files": files,
            "needs": [tasks[name].key for name in task.needs.values()],
            "code": code_digest(),
        }
        text = json.dumps(told, sort_keys=True, default=str)
        key = hashlib.sha256(text.encode()).hexdigest()
        tasks[task.name] = replace(task, key=key)

    further = {
        step: _of_options(words, folder)
        for step, words in batch.options.items()
    }
    for entry in subjects + soles:
        files, start, needs = {}, root, {}
        if entry.path is not None:
            files = _digests(entry.path, root)
        else:  # a laboratory's files lie beside its own study
            start, needs = None, {LAB: f"{entry.name}/{LAB}"}
            options = "--seed", str(entry.seed), *batch.laboratories.options()
            add(Task(needs[LAB], entry.name, "", LAB, options), {})
        known = STUDY_STEPS if entry in subjects else CASE_STEPS
        for variant, changes in _variants(batch, entry in soles).items():
            place = f"{entry.name}/{variant}" if variant else entry.name
            beside = entry.path.parent if entry.path else folder
            own = files | _named(changes, beside, start)
            for step in (step for step in known if step in batch.steps):
                base = BUILDS_ON.get(step)
                task = Task(
                    f"{place}/{step.replace(' ', '_')}",
                    entry.name,
                    variant,
                    step,
                    batch.options.get(step, ()),
                    entry.path,
                    start,
                    changes,
                    needs | ({base: f"{place}/{base}"} if base else {}),
                )
                add(task, own | further.get(step, {}))
    for task in tasks.values():
        for above in map(str, PurePosixPath(task.name).parents):
            if above in tasks:
                raise InputError(
                    f"results of {task.entry!r} would be written among those "
                    f"of {tasks[above].entry!r}, in {above}; rename one of the "
                    "two folders"
                )
    return list(tasks.values())


def _variants(batch: BatchFile, of_sole: bool) -> dict[str, dict[str, Any]]:
    """Name -> changes of each variant, those to cases or to studies only."""
    found: dict[str, dict] = {}
    for changes in batch.variants():
        ours = {k: v for k, v in changes.items() if is_sole(k) == of_sole}
        found.setdefault(variant_name(ours), ours)
    return found


# Keys of a case file; all others are a study's, which has its own `ground`.
SOLE_KEYS = (
    *("name", "mesh", "material", "load", "loads"),
    *("ground.heights", "contact", "start", "cost", "optimize"),
)


def is_sole(key: str) -> bool:
    """Whether a dotted key is of a case file, not of a study."""
    return any(f"{key}.".startswith(f"{own}.") for own in SOLE_KEYS)


@cache
def code_digest() -> str:
    """Hash of this package's code and of the versions of its libraries."""
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


def _digests(path: Path, root: Path | None, on=True) -> dict[str, str]:
    """Hashes of a study or case file and of every file that it names.

    Every text in it that is the path of a file counts, so that a new key
    cannot be forgotten here.
    """
    found = {"": _digest(path)}
    try:
        tree = yaml.load(read_bytes(path), Loader=_Loader)
        return found | _named(tree, path.parent, root, on)
    except (InputError, yaml.YAMLError, ValueError, RecursionError):
        return found  # its task says what is wrong


def _named(tree, beside: Path, root=None, on=True) -> dict[str, str]:
    """Hashes of files that texts in a tree name, from a root or `beside`.

    With `on` also of files that a named YAML file names: the recordings of a
    case are those of a study beside it.
    """
    words = sorted(set(_words(tree)))
    found = {word: _digest((root or beside) / word) for word in words}
    for word in words:
        if on and word.endswith((".yaml", ".yml")):
            named = _digests(beside / word, root, on=False)
            found |= {f"{word} {name}": own for name, own in named.items()}
    return {word: digest for word, digest in found.items() if digest}


def _of_options(options: Sequence[str], folder: Path) -> dict[str, str]:
    """Hashes of files, folders and modules that a command's options name."""
    words = [option.rpartition("=")[2] for option in options]
    words += [
        word.partition(":")[0].replace(".", "/") + ".py"
        for word in words
        if re.fullmatch(r"[\w.]+:\w+", word)
    ]
    inside = [
        str(Path(word) / path.relative_to(folder / word))
        for word in filter(None, words)
        for path in sorted((folder / word).rglob("*"))
    ]
    return _named([*words, *inside], folder)


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
    """Hash of a file's contents; "" if there is no such file."""
    try:
        return hashlib.sha256(read_bytes(path)).hexdigest()
    except (InputError, ValueError):
        return ""
