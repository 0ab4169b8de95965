"""Output of a run: its folder, JSON and CSV files, progress lines, verdict.

Every command makes one list of checks. If a check of level "fail" does not
hold, the command ends with exit code 3 (1 if it is the solve itself), unless
the user accepts the check by name. A check of level "note" is only printed. A
result that does not hold carries `Verdict.mark` wherever it is shown, accepted
or not.
"""

from __future__ import annotations

import base64
import contextlib
import csv
import dataclasses
import fcntl
import hashlib
import html
import io
import json
import math
import os
import shutil
import sys
import textwrap
import time
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

import numpy as np

from drake_exo.errors import InputError, path_of

# Lists the files that a run wrote, so that replacing results never removes
# files that somebody else put into the folder.
MANIFEST = ".drake_exo_files"
# In a manifest while its run writes: the run owns all but the files listed.
_WHOLE = "*"
# Locked while a run writes; the system releases the lock when the process
# ends, however it does.
LOCK = ".drake_exo_lock"
_PARTIAL = ".partial"
_LARGEST_ARRAYS = 2**31  # bytes of one file, unpacked


class OutputFolder:
    """A folder of results that never mixes those of two runs.

    Use it as a context manager, which gives the folder to write into:

        with prepare_output_folder("results", force=False) as folder:
            write_json(folder / "summary.json", summary)

    A fresh folder is written in place, so that an interrupted run leaves its
    best result there. If results are already present (`force`), the new ones
    are written to `NAME.partial` beside it and replace the old ones at the
    end. A run that fails or is stopped leaves the old results untouched and
    its own in `NAME.partial`. A run that fails before it has written anything
    removes the folder that it made.
    """

    def __init__(
        self, target: Path, path: Path, lock: contextlib.ExitStack, made: bool
    ):
        self.target, self._made = target, made
        self.path = path
        self._lock = lock
        self._final = True
        # Files that no run wrote are never removed.
        self._others = _files(path) - _own(path)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, kind, value, traceback) -> None:
        try:
            if kind is None and (self._final or self.path == self.target):
                self.commit()
            elif self.path == self.target:
                # A full disk must not hide the error that ended the run.
                with contextlib.suppress(OSError):
                    _write_manifest(self.target, self._written())
        finally:
            self._lock.close()
            if kind is not None and self._made and not _files(self.target):
                self._withdraw()

    def _withdraw(self) -> None:
        """Remove the folder that the run made, if it is still empty."""
        with contextlib.suppress(OSError):
            (self.target / MANIFEST).unlink(missing_ok=True)
            self.target.rmdir()

    def end(self, code: int) -> int:
        """Note and return the exit code; unsolved replaces no old results."""
        self._final = code in (0, FAILS_CODE)
        return code

    def _written(self) -> set[str]:
        return _files(self.path) - self._others

    def commit(self) -> None:
        """Make the results final: replace old ones and write the manifest.

        Raises:
            InputError: a file that no run wrote has the name of a result.
        """
        written = self._written()
        if self.path != self.target:
            others = _files(self.target) - _own(self.target)
            if taken := sorted(written & others):
                raise InputError(
                    f"{self.target / taken[0]}: no run wrote this file, but a "
                    "result has the same name; move it; the results are in "
                    f"{self.path}"
                )
            old = _own(self.target) - written
            _write_manifest(self.target, {_WHOLE, *others})
            for name in old:
                (self.target / name).unlink(missing_ok=True)
            for name in sorted(written):
                place = self.target / name
                place.parent.mkdir(parents=True, exist_ok=True)
                os.replace(self.path / name, place)
            shutil.rmtree(self.path)
            self.path = self.target
        _write_manifest(self.target, written)


def prepare_output_folder(
    path: str | Path,
    force: bool = False,
    resume: bool | None = None,
    reads: Iterable[str | Path | None] = (),
) -> OutputFolder:
    """Create the folder `path` for results; see `OutputFolder`.

    Args:
        path: the folder.
        force: replace the results in it.
        resume: continue in it or, with `force`, in what `NAME.partial` holds;
            None for a command without such an option.
        reads: files and folders that the run reads, and must not replace.

    Raises:
        InputError: it holds files and neither `force` nor `resume` is set;
            `force` would replace one of `reads`; `NAME.partial` has a file
            that no run wrote; it cannot be created; or another run uses it.
    """
    target = Path(path)
    replaced = [target, _beside(target)] if force else [target]
    for source in filter(None, reads):
        whole = Path(os.path.realpath(source))  # of a link to itself, too
        if any(whole.is_relative_to(os.path.realpath(p)) for p in replaced):
            raise InputError(
                f"{target}: --out would replace {source}, which is read; "
                "choose another folder for --out"
            )
    try:
        if target.exists() and not target.is_dir():
            raise InputError(f"{target}: is a file; give a folder for --out")
        made = not target.exists()
        target.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as lock:
            lock.enter_context(locked(target))
            place = _place(target, force, resume)
            return OutputFolder(target, place, lock.pop_all(), made)
    except OSError as error:
        raise InputError(
            f"{target}: cannot be written ({error.strerror}); choose "
            "another folder for --out"
        ) from error


def _place(target: Path, force: bool, resume: bool | None) -> Path:
    """Folder to write to: target, or `NAME.partial`, emptied if no resume."""
    occupied = _files(target)
    if occupied and not (force or resume):
        cut_off = resume is not None and any(
            Path(name).stem == "checkpoint" for name in occupied
        )
        raise InputError(
            f"{target}: already holds results; choose another folder for "
            "--out, or replace them with --force"
            + (", or continue this run with --resume" if cut_off else "")
        )
    partial = _beside(target)
    if occupied and force and (others := _files(partial) - _own(partial)):
        raise InputError(
            f"{partial / min(others)}: no run wrote this file, but new results "
            "are written there before they replace the old ones; move it"
        )
    if occupied and not resume:
        shutil.rmtree(partial, ignore_errors=True)
    place = target
    if occupied and force and (partial.is_dir() or not resume):
        place = partial
    place.mkdir(parents=True, exist_ok=True)
    # Written first, so that an unwritable folder fails before hours of work.
    _write_manifest(place, {_WHOLE, *(_files(place) - _own(place))})
    return place


def _beside(target: Path) -> Path:
    """Path of `NAME.partial`; a target like "." is resolved to its name."""
    whole = Path(os.path.realpath(target))
    named = target if target.name not in ("", "..") else whole
    return named.with_name(whole.name + _PARTIAL)


def check_new(path: Path, force: bool) -> None:
    """Refuse a file that exists as --out, unless `force` replaces it.

    Raises:
        InputError: it exists and `force` is not set.
    """
    if path.exists() and not force:
        raise InputError(
            f"{path}: exists; choose another file for --out, or replace it "
            "with --force"
        )


def summaries(folder: Path) -> list[Path]:
    """Paths of `summary.json` of all results below a folder, sorted.

    Without those that a stopped run left in `NAME.partial`.

    Raises:
        InputError: there is no such folder.
    """
    if not Path(folder).is_dir():
        raise InputError(
            f"{folder}: is not a folder; give the --out folder of a command"
        )
    found = sorted(Path(folder).rglob("summary.json"))
    return [
        path
        for path in found
        if all(p.suffix != _PARTIAL for p in path.relative_to(folder).parents)
    ]


def _files(folder: Path) -> set[str]:
    return {
        p.relative_to(folder).as_posix()
        for p in folder.rglob("*")
        if p.is_file() and p.name not in (MANIFEST, LOCK)
    }


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder, so that only one run writes there.

    Raises:
        InputError: another run is writing there.
    """
    path = folder / LOCK
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock), os.stat(path)):
                break
        except FileNotFoundError:
            pass  # a run that just ended has removed the file; try again
        except BlockingIOError:
            os.close(lock)
            raise InputError(
                f"{folder}: another run is writing there; wait for it, or "
                "choose another folder for --out"
            ) from None
        os.close(lock)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(lock)


def _read_manifest(folder: Path) -> set[str]:
    place = folder / MANIFEST
    text = place.read_bytes() if place.is_file() else b""
    # Of a damaged manifest, use the lines that are still file names.
    lines = os.fsdecode(text).split("\n")
    names = {line.replace("\0", "\n") for line in lines if line}
    # Ignore names that point outside the folder.
    whole = folder.resolve()
    return {
        name
        for name in names
        if (folder / name).parent.resolve().is_relative_to(whole)
    }


def _own(folder: Path) -> set[str]:
    """Names of the files that runs, finished or not, wrote into a folder."""
    listed = _read_manifest(folder)
    return _files(folder) - listed if _WHOLE in listed else listed


def _write_manifest(folder: Path, names: set[str]) -> None:
    # A file's name may contain a line break, which is written as \0.
    lines = (name.replace("\n", "\0") + "\n" for name in sorted(names))
    (folder / MANIFEST).write_bytes(os.fsencode("".join(lines)))


def write_json(path: str | Path, obj: Any) -> None:
    """Write `obj` as JSON with sorted keys, atomically.

    Accepts dataclasses, numpy arrays and scalars, paths, tuples and sets.
    JSON has neither NaN nor infinity: they become null.
    """
    text = json.dumps(
        _jsonable(obj),
        sort_keys=True,
        indent=2,
        ensure_ascii=False,
        allow_nan=False,
        default=os.fspath,
    )
    replace_file(Path(path), f"{text}\n".encode())


def replace_file(path: Path, data: bytes) -> None:
    """Write a file atomically: the new content entirely, or the old one."""
    draft = path.with_name(path.name + ".tmp")
    try:
        draft.write_bytes(data)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def write_csv(path: Path, columns: dict[str, Sequence]) -> None:
    """Write columns of equal length as CSV under a header line."""

    def shown(value):
        is_number = not isinstance(value, str | bool | int)
        return f"{float(value) + 0.0:.10g}" if is_number else value

    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(map(shown, row))


def checksum(obj: Any) -> str:
    """Checksum (16 hexadecimal digits) of contents, for comparison.

    Numbers count to six significant digits, which machines that round
    differently share. Paths count by their file names only.

    >>> checksum({"mass_kg": 75.0}) == checksum({"mass_kg": 75.0 + 1e-9})
    True
    """
    content = _rounded(_jsonable(obj))
    text = json.dumps(content, sort_keys=True, default=lambda path: path.name)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    # Adding 0.0 turns -0.0 into 0.0.
    return float(f"{value:.6g}") + 0.0 if isinstance(value, float) else value


def rounded(value: float) -> str:
    """A number with three significant digits, without a power of ten.

    >>> rounded(52947.3)
    '52 900'
    """
    return f"{float(f'{value:.3g}'):,.10g}".replace(",", " ")


def read_bytes(path: str | Path, remedy: str = "check the path") -> bytes:
    """Read the bytes of a file.

    Raises:
        InputError: it cannot be read, or is not a regular file (a device or a
            pipe may never end); `remedy` ends the message.
    """
    path = path_of(path, "path")
    try:
        if not (path.is_file() or path.is_dir()) and path.exists():
            raise InputError(
                f"{path}: cannot be read (no regular file); {remedy}"
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); {remedy}"
        ) from error


def read_json(path: str | Path, remedy: str) -> Any:
    """Read a JSON file.

    Args:
        path: the file.
        remedy: advice that ends the message, such as "run it again".

    Raises:
        InputError: it cannot be read, or is not JSON.
    """
    data = read_bytes(path, remedy)
    try:
        return json.loads(data.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid JSON; {remedy}") from error


def read_arrays(path: str | Path, remedy: str) -> dict[str, np.ndarray]:
    """Read all arrays of a .npz file; arguments and errors as `read_json`.

    Returns nothing unless the whole file is sound: its checksums hold, it
    unpacks to at most 2 GiB, and it holds only numbers and text.
    """
    whole = io.BytesIO(read_bytes(path, remedy))
    try:
        with zipfile.ZipFile(whole) as parts:
            size = sum(part.file_size for part in parts.infolist())
    except Exception as error:  # damage may raise anything
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
    except Exception as error:  # likewise
        raise InputError(f"{path}: is damaged; {remedy}") from error


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
        return value + 0.0 if math.isfinite(value) else None  # no -0.0
    return value


class Progress:
    """Prints progress lines of one job, at most one per interval.

    A job shorter than `interval_seconds` prints nothing.

    Args:
        title: begins every line.
        total: number of steps, if known.
        interval_seconds: least time between two lines.
        stream: where to print; by default the current sys.stdout.
    """

    def __init__(
        self,
        title: str,
        total: int | None = None,
        *,
        interval_seconds: float = 0.5,
        stream: TextIO | None = None,
    ):
        self.title = title
        self.total = total
        self.interval_seconds = interval_seconds
        self._stream = stream
        self._newest: tuple[str, int | None] = "", None
        self._start = self._last = time.monotonic()

    def repeat(self) -> None:
        """Print the newest news, printed or not, likewise."""
        self.update(*self._newest)

    def update(self, text: str = "", done: int | None = None) -> None:
        """Print a line if the last one is old enough."""
        self._newest = text, done
        now = time.monotonic()
        if now - self._last < self.interval_seconds:
            return
        self._last = now
        count = ""
        if done is not None:
            count = f"{done}/{self.total}" if self.total else f"{done}"
        parts = [p for p in (count, text) if p]
        seconds = now - self._start
        told = f"{self.title}: {', '.join(parts)} ({seconds:.1f} s)"
        print(told, file=self._stream or sys.stdout, flush=True)


if TYPE_CHECKING:  # matplotlib takes half a second to load
    from matplotlib.figure import Figure

SOLVED = "solved"
HOLDS, FAILS, UNSOLVED = "holds", "does not hold", "not solved"
NOT_SOLVED_CODE, FAILS_CODE, STOPPED_CODE = 1, 3, 130
_ALL = "all"
_RED, _PLAIN = "\x1b[31m", "\x1b[0m"


Level = Literal["fail", "note"]


@dataclass(frozen=True)
class Check:
    """One criterion of a result, and whether it holds.

    Attributes:
        name: by which the user accepts it; dotted if several are of a kind.
        holds: whether it does.
        value: found, in `unit`; None if it is not a number.
        limit: with which `value` was compared, likewise.
        unit: of value and limit.
        where: trial, signal or file.
        sentence: what is wrong and its likely cause; empty if it holds.
        level: "fail" if the result fails with it, "note" if not.
    """

    name: str
    holds: bool
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    sentence: str = ""
    level: Level = "fail"

    def __post_init__(self):
        if self.holds:
            object.__setattr__(self, "sentence", "")


@dataclass(frozen=True)
class Verdict:
    """All checks of a result.

    Attributes:
        checks: in the order in which they were made.
        accepted: names of checks, or dotted beginnings, that the user accepts.

    >>> audit = Check("audit", False, 2.5, 1.0, "N", "rise1")
    >>> made = Verdict((Check("solved", True), audit))
    >>> made.word, made.exit_code, made.mark
    ('does not hold', 3, 'DOES NOT HOLD: audit (rise1, 2.5 N, limit 1 N)')
    >>> Verdict(made.checks, ("audit",)).exit_code
    0
    """

    checks: tuple[Check, ...]
    accepted: tuple[str, ...] = ()

    @property
    def failing(self) -> tuple[Check, ...]:
        """Checks of level "fail" that do not hold, accepted or not."""
        return tuple(
            c for c in self.checks if c.level == "fail" and not c.holds
        )

    @property
    def refused(self) -> tuple[Check, ...]:
        """Failing checks that the user has not accepted."""
        return tuple(
            c for c in self.failing if not is_accepted(c.name, self.accepted)
        )

    @property
    def holds(self) -> bool:
        """Whether nothing fails, accepted or not."""
        return not self.failing

    @property
    def word(self) -> str:
        """One of "holds", "does not hold" and "not solved"."""
        if any(c.name == SOLVED for c in self.failing):
            return UNSOLVED
        return HOLDS if self.holds else FAILS

    @property
    def exit_code(self) -> int:
        """Exit code of the command: 0, 1 (not solved) or 3 (a check fails).

        A failed solve gives 1 even if the user accepts it.
        """
        if self.word == UNSOLVED:
            return NOT_SOLVED_CODE
        return FAILS_CODE if self.refused else 0

    @property
    def mark(self) -> str:
        """Warning line for figures, tables and pages; empty if all holds."""
        return mark_of(self.word, [_short(c) for c in self.failing])

    @property
    def unmatched(self) -> tuple[str, ...]:
        """What is accepted although no check has that name."""
        names = [c.name for c in self.checks]
        return tuple(
            word
            for word in self.accepted
            if not any(is_accepted(name, [word]) for name in names)
        )

    def summary(self) -> dict[str, Any]:
        """The keys of summary.json: checks, verdict and accepted."""
        return {
            "checks": [asdict(c) for c in self.checks],
            "verdict": self.word,
            "accepted": list(self.accepted),
        }

    def text(self, color: bool | None = None) -> str:
        """The verdict as lines: one per kind that holds, one per failure.

        Failures of one name and sentence share a line.

        Args:
            color: whether failures are red; by default on a terminal.
        """
        color = sys.stdout.isatty() if color is None else color
        lines = [f"verdict: {self.word}"]
        lines += [f"  {line}" for line in _aligned(_holding(self.checks))]
        notes = [c for c in self.checks if c.level == "note" and not c.holds]
        lines += [f"  note  {told}" for _, told in _told(notes)]
        for name, told in _told(self.failing):
            accepted = is_accepted(name, self.accepted)
            line = f"  {'accepted' if accepted else 'FAILS'}  {told}"
            lines.append(f"{_RED}{line}{_PLAIN}" if color else line)
        lines += [
            f"  note  --accept {word}: no check has that name"
            for word in self.unmatched
        ]
        if self.refused and self.word != UNSOLVED:
            names = dict.fromkeys(c.name for c in self.refused)
            options = " ".join(f"--accept {name}" for name in names)
            lines.append(f"  to take it all the same: {options}")
        return "\n".join(lines)


def mark_of(word: str, failed: Sequence[str]) -> str:
    """A `Verdict.mark` from the verdict's word and the failed checks."""
    if word == HOLDS:
        return ""
    return f"{word.upper()}: {'; '.join(failed)}"


def joined_mark(marks: Mapping[str, str]) -> str:
    """Common mark of several results shown together: name -> own mark.

    >>> joined_mark({"a": "", "b": "DOES NOT HOLD: x", "c": "NOT SOLVED: y"})
    'DOES NOT HOLD: b: x; c: NOT SOLVED: y'
    """
    said = f"{FAILS.upper()}: "
    told = [f"{n}: {m.removeprefix(said)}" for n, m in marks.items() if m]
    return mark_of(FAILS, told) if told else ""


def write_text(path: Path, text: str, mark: str = "") -> None:
    """Write a text file, headed by the result's mark if it has one."""
    text = f"{mark}\n\n{text}" if mark else text
    path.write_text(text + "\n", encoding="utf-8")


# Distinct in print and for colour-blind readers (Okabe, Ito).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
# matplotlib settings of every figure.
STYLE = {
    "font.size": 9,
    "axes.titlesize": "medium",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.92",
    "axes.axisbelow": True,
    "axes.prop_cycle": f"cycler(color={list(COLOURS)})",
    "legend.frameon": False,
    "savefig.dpi": 200,
}


def save_figure(path: Path, figure: Figure, mark: str = "") -> None:
    """Write a figure in `STYLE`; the same input gives the same bytes.

    Args:
        path: the picture's file.
        figure: to be written.
        mark: `Verdict.mark`: drawn across, printed below, and in the metadata.
    """
    import matplotlib

    # Leave out the time (PDF) or the software's version, which vary.
    unsaid = "CreationDate" if path.suffix == ".pdf" else "Software"
    metadata = {unsaid: None}
    if mark:
        _draw_mark(figure, mark)
        metadata["Description"] = mark
    with matplotlib.rc_context(STYLE):
        figure.savefig(
            path, metadata=metadata, bbox_inches="tight" if mark else None
        )


def embedded(path: Path, text: str) -> str:
    """HTML element that holds a PNG file, with a text for those who cannot see.

    Args:
        path: the picture's file.
        text: what it shows.
    """
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{data}">'


def _draw_mark(figure: Figure, mark: str) -> None:
    width, height = figure.get_size_inches()
    style = {"color": "#c8102e", "ha": "center", "parse_math": False}
    figure.text(
        0.5,
        0.5,
        mark.partition(":")[0],
        va="center",
        rotation=math.degrees(math.atan2(height, width)),
        fontsize=7.0 * math.hypot(width, height) * 0.6,
        alpha=0.18,
        weight="bold",
        **style,
    )
    if figure.legends:  # a tight box would take them along, onto the mark
        figure.draw_without_rendering()  # lays out, with room for them
        figure.set_layout_engine("none")
        for legend in figure.legends:
            legend.set_bbox_to_anchor((0, 0, 1, 1), figure.transFigure)
    lines = textwrap.wrap(mark, int(12 * width))
    figure.text(0.5, -0.02, "\n".join(lines), va="top", fontsize=9, **style)


def stored_mark(
    summary: Mapping[str, Any], path: str | Path = "summary.json"
) -> str:
    """The mark of a stored result by its summary.json; empty if it holds.

    A summary without checks, as earlier versions wrote it, is marked, too.
    """
    found = stored(summary, path)
    if found is None:
        return mark_of(FAILS, ["written by a version without checks"])
    return found.mark


def stored(summary: Any, path: str | Path = "summary.json") -> Verdict | None:
    """The verdict in a summary.json; None if the summary has no checks.

    Args:
        summary: what the file holds.
        path: the file, for messages.

    Raises:
        InputError: its checks are damaged; names `path`.
    """
    if isinstance(summary, Mapping) and "checks" not in summary:
        return None
    try:
        rows = [Check(**row) for row in summary["checks"]]
        accepted = tuple(summary.get("accepted", ()))
        whole = all(isinstance(name, str) for name in accepted) and all(
            isinstance(r.name, str)
            and isinstance(r.holds, bool)
            and isinstance(r.level, str)
            and isinstance(r.value, int | float | None)
            and isinstance(r.limit, int | float | None)
            for r in rows
        )
    except TypeError:
        whole = False
    if not whole:
        raise InputError(
            f"{path}: checks are not as a command writes them; run it again"
        )
    return Verdict(tuple(rows), accepted)


def is_accepted(name: str, accepted: Iterable[str]) -> bool:
    """Whether a check's name, or a dotted beginning of it, is accepted.

    >>> is_accepted("plausibility.mass", ["plausibility"])
    True
    >>> is_accepted("audit", ["plausibility"])
    False
    """
    return any(
        name == a or name.startswith(a + ".") or a == _ALL for a in accepted
    )


def _short(*checks: Check) -> str:
    """Checks of one name, in short."""
    found = []
    for check in checks:
        parts = [check.where, _amount(check.value, check.unit)]
        if check.limit is not None:
            parts.append(f"limit {_amount(check.limit, check.unit)}")
        found.append(", ".join(p for p in parts if p))
    inside = "; ".join(filter(None, found))
    return f"{checks[0].name} ({inside})" if inside else checks[0].name


def _told(checks: Iterable[Check]) -> Iterator[tuple[str, str]]:
    """Name and line of checks that have name and sentence in common."""
    groups: dict[tuple[str, str], list[Check]] = {}
    for check in checks:
        groups.setdefault((check.name, check.sentence), []).append(check)
    for (name, sentence), group in groups.items():
        yield name, f"{_short(*group)}{': ' if sentence else ''}{sentence}"


def _amount(value: float | None, unit: str) -> str:
    unit = "" if unit == "1" else unit
    return "" if value is None else f"{value:.3g} {unit}".rstrip()


def _holding(checks: Iterable[Check]) -> list[tuple[str, ...]]:
    """One row per kind of check that holds: count, and nearest to limit."""
    groups: dict[str, list[Check]] = {}
    for c in checks:
        if c.holds:
            groups.setdefault(c.name.partition(".")[0], []).append(c)
    rows = []
    for name, group in groups.items():
        nearest = min(group, key=_margin)
        count = f"{len(group)} hold" if len(group) > 1 else "holds"
        told = _short(nearest) if np.isfinite(_margin(nearest)) else ""
        if nearest.name == name:
            told = told.removeprefix(name).strip()
        rows.append((name, count, f"nearest {told}" if told else ""))
    return rows


def _margin(check: Check) -> float:
    """Distance of a check's value from its limit, relative; or infinity."""
    if check.value is None or not check.limit:
        return float("inf")
    return abs(check.value - check.limit) / abs(check.limit)


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max((len(r[i]) for r in rows), default=0) for i in range(2)]
    return [
        f"{a.ljust(widths[0])}  {b.ljust(widths[1])}  {c}".rstrip()
        for a, b, c in rows
    ]
