"""What a run leaves behind: its folder, its JSON files, its progress lines."""

import contextlib
import dataclasses
import fcntl
import hashlib
import io
import json
import math
import os
import shutil
import sys
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import read_bytes

# Names what a run wrote, so that replacing results never removes files that
# somebody else put into the folder.
MANIFEST = ".drake_exo_files"
# Held while a run writes; the system lets go of it when the process ends,
# however that is.
LOCK = ".drake_exo_lock"
_LARGEST_ARRAYS = 2**31  # bytes of one file, unpacked


class OutputFolder:
    """A folder of results that never mixes two runs.

    Use as a context manager; `path` is where to write, from the start:

        with prepare_output_folder("results", force=False) as folder:
            write_json(folder / "summary.json", summary)

    A fresh folder is written in place, so an interrupted run leaves its best
    so far there. With results already present (`force`), the new ones grow in
    `NAME.partial` beside it and replace the old ones at the end; a run that
    fails leaves the old results untouched and its own in `NAME.partial`.
    """

    def __init__(self, target: Path, path: Path, lock: int):
        self.target = target
        self.path = path
        self._lock = lock

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, kind, value, traceback) -> None:
        try:
            if kind is None:
                self.commit()
            elif self.path == self.target:
                # What ended the run matters more than a full disk.
                with contextlib.suppress(OSError):
                    _write_manifest(self.target, _files(self.target))
        finally:
            _release(self.target, self._lock)

    def commit(self) -> None:
        """Make the results final: replace old ones, note what was written."""
        written = _files(self.path)
        if self.path != self.target:
            for name in _read_manifest(self.target) - written:
                (self.target / name).unlink(missing_ok=True)
            for name in sorted(written):
                place = self.target / name
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(self.path / name, place)
            shutil.rmtree(self.path)
            self.path = self.target
        _write_manifest(self.target, written)


def prepare_output_folder(
    path: str | Path, force: bool = False, resume: bool = False
) -> OutputFolder:
    """Create the folder `path` for results; see `OutputFolder`.

    Args:
        path: the folder.
        force: replace results in it.
        resume: go on in it, or in what a run with `force` left of its own.

    Raises:
        InputError: it already holds files and `force` is not set, it cannot
            be created, or another run is writing there.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_dir():
            raise InputError(f"{target}: is a file; give a folder for --out")
        target.mkdir(parents=True, exist_ok=True)
        lock = _locked(target)
        try:
            return OutputFolder(target, _place(target, force, resume), lock)
        except BaseException:
            _release(target, lock)
            raise
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); choose "
            "another folder for --out"
        ) from error


def _place(target: Path, force: bool, resume: bool) -> Path:
    """Where to write what ends up in `target`, ready for it."""
    occupied = bool(_files(target))
    if occupied and not (force or resume):
        raise InputError(
            f"{target}: already holds results; choose another folder for "
            "--out, or replace them with --force"
        )
    partial = _beside(target)
    if resume and occupied:
        return partial if force and partial.is_dir() else target
    if occupied:
        shutil.rmtree(partial, ignore_errors=True)
    place = partial if occupied else target
    place.mkdir(parents=True, exist_ok=True)
    _write_manifest(place, set())  # before hours of work, not after
    return place


def _beside(target: Path) -> Path:
    """Where new results grow; "." has no name, its whole path has."""
    plain = target.name not in ("", "..")
    named = target if plain else target.resolve()
    return named.with_name(target.resolve().name + ".partial")


def _files(folder: Path) -> set[str]:
    return {
        p.relative_to(folder).as_posix()
        for p in folder.rglob("*")
        if p.is_file() and p.name not in (MANIFEST, LOCK)
    }


def _release(folder: Path, lock: int) -> None:
    with contextlib.suppress(OSError):
        (folder / LOCK).unlink()
    os.close(lock)


def _locked(folder: Path) -> int:
    """Descriptor of the folder's lock.

    Raises:
        InputError: another run holds it.
    """
    path = folder / LOCK
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock), os.stat(path)):
                return lock
        except FileNotFoundError:
            pass  # a run that ended meanwhile has taken its file away
        except BlockingIOError:
            os.close(lock)
            raise InputError(
                f"{folder}: another run is writing there; wait for it, or "
                "choose another folder for --out"
            ) from None
        os.close(lock)


def _read_manifest(folder: Path) -> set[str]:
    place = folder / MANIFEST
    lines = place.read_text("utf-8").splitlines() if place.is_file() else []
    return {line for line in lines if line and _is_inside(folder, line)}


def _is_inside(folder: Path, name: str) -> bool:
    """Whether a name from a file means something in a folder, not beyond."""
    return (folder / name).parent.resolve().is_relative_to(folder.resolve())


def _write_manifest(folder: Path, names: set[str]) -> None:
    text = "".join(f"{name}\n" for name in sorted(names))
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def write_json(path: str | Path, obj: Any) -> None:
    """Write `obj` as JSON with sorted keys, whole or not at all.

    Dataclasses, numpy arrays and scalars, paths, tuples and sets are
    understood. JSON has no NaN nor infinity: they become null.
    """
    path = Path(path)
    text = json.dumps(
        _jsonable(obj),
        sort_keys=True,
        indent=2,
        ensure_ascii=False,
        allow_nan=False,
    )
    draft = path.with_name(path.name + ".tmp")
    try:
        draft.write_text(text + "\n", encoding="utf-8")
        os.replace(draft, path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def checksum(obj: Any) -> str:
    """Sixteen digits that tell contents apart: JSON, numbers to six digits.

    Other machines round otherwise; six digits are the same on all.

    >>> checksum({"mass_kg": 75.0}) == checksum({"mass_kg": 75.0 + 1e-9})
    True
    """
    text = json.dumps(_rounded(_jsonable(obj)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    # Zero has no sign here.
    return float(f"{value:.6g}") + 0.0 if isinstance(value, float) else value


def read_json(path: str | Path, remedy: str) -> Any:
    """What a JSON file holds.

    Args:
        path: the file.
        remedy: ends the message, such as "run it again".

    Raises:
        InputError: it cannot be read, or is no JSON.
    """
    data = read_bytes(path, remedy)
    try:
        return json.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON; {remedy}") from error


def read_arrays(path: str | Path, remedy: str) -> dict[str, np.ndarray]:
    """All arrays of a .npz file; arguments and errors as `read_json`.

    The file is checked as a whole before any array is believed: its
    checksums, and that it holds numbers or text alone.
    """
    whole = io.BytesIO(read_bytes(path, remedy))
    try:
        with zipfile.ZipFile(whole) as parts:
            size = sum(part.file_size for part in parts.infolist())
    except zipfile.BadZipFile as error:
        raise InputError(f"{path}: is damaged; {remedy}") from error
    if size > _LARGEST_ARRAYS:
        raise InputError(
            f"{path}: unpacks to {size / 1e9:.1f} GB, more than any result "
            f"holds; {remedy}"
        )
    whole.seek(0)
    try:
        with np.load(whole, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except Exception as error:  # whatever damage makes of zip and array
        raise InputError(f"{path}: is damaged; {remedy}") from error


def check_arrays(
    path: str | Path,
    arrays: Mapping[str, np.ndarray],
    shapes: Mapping[str, tuple],
    remedy: str,
) -> None:
    """Refuse arrays of other types or shapes than a file should hold.

    Args:
        path: of the file, for messages.
        arrays: what it holds.
        shapes: name -> sizes; letters stand for sizes that must agree.
            A name ending in ":int" is of whole numbers, others are floats.
        remedy: as in `read_json`.

    Raises:
        InputError: naming the first array that does not fit.
    """
    sizes: dict[str, int] = {}
    for label, shape in shapes.items():
        name, _, kind = label.partition(":")
        x = arrays.get(name)
        fits = (
            x is not None
            and x.ndim == len(shape)
            and np.issubdtype(x.dtype, np.integer if kind else np.floating)
            and all(
                n == (sizes.setdefault(s, n) if isinstance(s, str) else s)
                for n, s in zip(x.shape, shape, strict=True)
            )
        )
        if not fits:
            raise InputError(
                f"{path}: {name} is missing or of another shape; {remedy}"
            )


def _jsonable(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: _jsonable(getattr(value, f.name))
            for f in dataclasses.fields(value)
        }
    if isinstance(value, Mapping):
        return {str(key): _jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [_jsonable(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted(_jsonable(item) for item in value)
    if isinstance(value, np.generic):
        return _jsonable(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


class Progress:
    """Progress of one job: a line now and then, to a terminal or a pipe.

    Nothing is printed for jobs shorter than `interval_seconds`, except what
    `close` is given to say.

    Args:
        title: begins every line.
        total: number of steps, if known.
        interval_seconds: least time between two lines.
        stream: where to print; by default sys.stdout of the moment.
        clock: seconds, monotonic; for tests.
    """

    def __init__(
        self,
        title: str,
        total: int | None = None,
        *,
        interval_seconds: float = 0.5,
        stream: TextIO | None = None,
        clock=time.monotonic,
    ):
        self.title = title
        self.total = total
        self.interval_seconds = interval_seconds
        self._stream = stream
        self._clock = clock
        self._start = self._last = clock()

    @property
    def elapsed_seconds(self) -> float:
        """Seconds since the job began."""
        return self._clock() - self._start

    def update(self, text: str = "", done: int | None = None) -> bool:
        """Print a line if the last one is old enough; True if printed."""
        if self._clock() - self._last < self.interval_seconds:
            return False
        self._print(text, done)
        return True

    def close(self, text: str = "") -> None:
        """End the job; prints `text`, if any, in every case."""
        if text:
            self._print(text, None)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _print(self, text: str, done: int | None) -> None:
        self._last = self._clock()
        count = ""
        if done is not None:
            count = f"{done}/{self.total}" if self.total else f"{done}"
        parts = [p for p in (count, text) if p]
        print(
            f"{self.title}: {', '.join(parts)} ({self.elapsed_seconds:.1f} s)",
            file=self._stream or sys.stdout,
            flush=True,
        )
