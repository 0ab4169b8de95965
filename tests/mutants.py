"""Plants errors one at a time and tells which ones no test notices.

    python tests/mutants.py                       all of the list
    python tests/mutants.py scores tables         of files so named alone
    python tests/mutants.py --drawn 30 --seed 1   drawn from the whole package
    python tests/mutants.py --drawn 30 soles/     drawn from files so named

Each error is planted in a copy, never in the working tree. The tests meant for
its file (`mutants_listed.TESTS`) run until the first fails: those that are not
slow and, should they all pass, the slow ones, which `--quick` leaves out. Exit
code 0: none survived; 1: some did; 2: an entry of the list fits no more, or
sound code fails.
"""

import argparse
import ast
import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mutants_listed import LISTED, TESTS

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "drake_exo"
# However busy the machine is, tests that take longer hang.
_LONGEST_S = {"not slow": 900.0, "slow": 1800.0}
_IGNORED = shutil.ignore_patterns(
    ".*", "__pycache__", "demo_results", "*.egg-info", "api"
)
# What every test imports before it comes to the package: once, not each time.
_COMMON = (
    *("numpy", "scipy.signal", "scipy.optimize", "scipy.sparse.linalg"),
    *("pydrake.all", "matplotlib.figure", "numba", "meshio", "meshcat"),
    *("yaml", "ezc3d", "pytest"),
)


@dataclass(frozen=True)
class Mutant:
    """One planted error.

    Attributes:
        file: below the root.
        start, end: bytes of the source that are replaced.
        new: what takes their place.
        kind: "listed", or the operator.
    """

    file: str
    start: int
    end: int
    new: str
    kind: str

    def planted(self, source: bytes) -> bytes:
        """The source with the error."""
        return source[: self.start] + self.new.encode() + source[self.end :]

    def __str__(self):
        source = (ROOT / self.file).read_bytes()
        line = source[: self.start].count(b"\n") + 1
        old = " ".join(source[self.start : self.end].decode().split())
        new = " ".join(self.new.split())
        return f"{self.file}:{line} {self.kind}: {old}  ->  {new}"


def listed(chosen: list[str]) -> tuple[list[Mutant], list[str]]:
    """Mutants of the list, and what is wrong with its entries."""
    found, wrong = [], []
    for file, entries in LISTED.items():
        if chosen and not any(name in file for name in chosen):
            continue
        source = (ROOT / file).read_bytes()
        for old, new in entries:
            count = source.count(old.encode())
            if count != 1:
                wrong.append(f"{file}: found {count} times, not once: {old}")
                continue
            start = source.index(old.encode())
            end = start + len(old.encode())
            found.append(Mutant(file, start, end, new, "listed"))
    return found, wrong


_UNITS = {1e3, 1e-3, 1e2, 1e-2, 1e6, 1e-6, 60.0, 180.0, 9.81}
_TURNS = {"rad2deg", "deg2rad", "radians", "degrees"}


def sites(tree: ast.AST) -> Iterator[tuple[str, ast.expr, str]]:
    """(kind, expression, what it becomes) for all that may be planted.

    Messages, annotations and texts are left alone.
    """
    if isinstance(tree, ast.Raise | ast.JoinedStr):
        return
    if isinstance(tree, ast.AnnAssign):
        if tree.value is not None:
            yield from _at(tree.value)
            yield from sites(tree.value)
        return
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                if isinstance(child, ast.expr):
                    yield from _at(child)
                yield from sites(child)


def _at(node: ast.expr) -> Iterator[tuple[str, ast.expr, str]]:
    text = ast.unparse
    if isinstance(node, ast.BinOp) and not _is_text(node):
        left, right = text(node.left), text(node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            other = "-" if isinstance(node.op, ast.Add) else "+"
            yield "sign", node, f"({left} {other} ({right}))"
            yield "dropped term", node, f"({left})"
        if isinstance(node.op, ast.Mult | ast.Div):
            yield "factor 2", node, f"(2 * ({text(node)}))"
            yield "dropped factor", node, f"({left})"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        if not isinstance(node.operand, ast.Constant):
            yield "sign", node, f"({text(node.operand)})"
    elif isinstance(node, ast.Subscript):
        for index in _indices(node.slice):
            value = ast.literal_eval(index)
            other = value + 1 if value >= 0 else value - 1
            yield "index", index, f"{other}"
    elif isinstance(node, ast.Constant) and node.value in _UNITS:
        if isinstance(node.value, float):
            yield "unit", node, "1.0"
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "attr", "")
        if name in _TURNS and len(node.args) == 1:
            yield "unit", node, f"({text(node.args[0])})"


def _is_text(node: ast.AST) -> bool:
    return any(
        isinstance(n, ast.JoinedStr)
        or (isinstance(n, ast.Constant) and isinstance(n.value, str))
        for n in (node.left, node.right)
    )


def _indices(node: ast.expr) -> Iterator[ast.expr]:
    """Whole numbers of an index: its own, of a tuple's or a slice's parts."""
    if isinstance(node, ast.Tuple):
        for part in node.elts:
            yield from _indices(part)
    elif isinstance(node, ast.Slice):
        for part in (node.lower, node.upper):
            if part is not None:
                yield from _indices(part)
    elif isinstance(node, ast.Constant | ast.UnaryOp):
        with contextlib.suppress(ValueError):
            if type(ast.literal_eval(node)) is int:
                yield node


def drawn(count: int, seed: int, chosen: Sequence[str] = ()) -> list[Mutant]:
    """Errors that nobody chose, all kinds alike, over the whole package.

    Args:
        chosen: parts of paths; other files are left alone. Empty: none is.

    Raises:
        ValueError: no file is so named, or they hold too few places.
    """
    kinds: dict[str, list[Mutant]] = {}
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        if chosen and not any(name in path.as_posix() for name in chosen):
            continue
        source = path.read_bytes()
        lines = source.splitlines(keepends=True)
        begins = [0]
        for line in lines:
            begins.append(begins[-1] + len(line))
        for kind, node, new in sites(ast.parse(source)):
            start = begins[node.lineno - 1] + node.col_offset
            end = begins[node.end_lineno - 1] + node.end_col_offset
            file = path.relative_to(ROOT).as_posix()
            mutant = Mutant(file, start, end, new, kind)
            kinds.setdefault(kind, []).append(mutant)
    places = len({mutant for some in kinds.values() for mutant in some})
    if places < count:
        raise ValueError(f"{places} places in files so named, {count} wanted")
    rng = random.Random(seed)
    names = sorted(kinds)
    found: dict[Mutant, None] = {}
    while len(found) < count:
        found[rng.choice(kinds[rng.choice(names)])] = None
    return list(found)


def tests_of(file: str) -> list[list[str]]:
    """Those meant for a file in groups, the nearest first."""
    fitting = [prefix for prefix in TESTS if file.startswith(prefix)]
    fitting.sort(key=len, reverse=True)
    return [TESTS[prefix] for prefix in fitting]


class Copy:
    """A copy of the checkout in which tests run.

    Args:
        folder: an empty one.
    """

    def __init__(self, folder: Path):
        self.folder = folder / "checkout"
        shutil.copytree(ROOT, self.folder, ignore=_IGNORED)
        self.log = folder / "log"
        self._now = int(time.time())
        self._sound: set[tuple[str, ...]] = set()

    def survives(self, mutant: Mutant, marks: Sequence[str]) -> bool:
        """Whether all tests pass with it, those of each mark in turn.

        Raises:
            RuntimeError: some fail without it.
        """
        path = self.folder / mutant.file
        source = path.read_bytes()
        for mark in marks:
            for tests in tests_of(mutant.file):
                self._check_sound(tests, mark)
                self._write(path, mutant.planted(source))
                try:
                    if not self.pass_all(tests, mark):
                        return False
                finally:
                    self._write(path, source)
        return True

    def _check_sound(self, tests: list[str], mark: str) -> None:
        """Run tests on sound code, once."""
        key = (mark, *tests)
        if key not in self._sound and not self.pass_all(tests, mark):
            raise RuntimeError(self.log.read_text())
        self._sound.add(key)

    def pass_all(self, tests: list[str], marked: str) -> bool:
        """Run tests in a process of its own; False where one fails or hangs."""
        process = os.fork()
        if process == 0:
            os.setpgid(0, 0)
            self._run(tests, marked)
        end = time.monotonic() + _LONGEST_S[marked]
        while time.monotonic() < end:
            done, status = os.waitpid(process, os.WNOHANG)
            if done:
                # Nothing collected is nothing that fails.
                return os.waitstatus_to_exitcode(status) in (0, 5)
            time.sleep(0.02)
        os.killpg(process, signal.SIGKILL)
        os.waitpid(process, 0)
        return False

    def _run(self, tests, marked) -> None:
        code = 1
        try:
            with self.log.open("w") as file:
                os.dup2(file.fileno(), 1)
                os.dup2(file.fileno(), 2)
            os.chdir(self.folder)
            os.environ["PYTHONPATH"] = str(self.folder)
            sys.path.insert(0, str(self.folder))
            import pytest

            options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
            code = int(pytest.main([*options, "-m", marked, *tests]))
        finally:
            os._exit(code)

    def _write(self, path: Path, source: bytes) -> None:
        """Compiled files tell sources apart by whole seconds and size."""
        path.write_bytes(source)
        self._now += 1
        os.utime(path, (self._now, self._now))


def report(copy: Copy, mutants: list[Mutant], marks: Sequence[str]) -> int:
    """Plant all, print what becomes of each; the number of survivors."""
    survivors = []
    begun = time.monotonic()
    for k, mutant in enumerate(mutants, 1):
        start = time.monotonic()
        alive = copy.survives(mutant, marks)
        word = "SURVIVED" if alive else "killed"
        seconds = time.monotonic() - start
        print(f"{k}/{len(mutants)} {word} {seconds:.0f} s {mutant}", flush=True)
        if alive:
            survivors.append(mutant)
    print(
        f"\n{len(mutants)} planted, {len(survivors)} survived, "
        f"{time.monotonic() - begun:.0f} s"
    )
    for mutant in survivors:
        print(f"  {mutant}")
    return len(survivors)


def main() -> int:
    """Run; see the module."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("name", nargs="*", help="part of a file's path")
    parser.add_argument("--drawn", type=int, default=0, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="no slow tests")
    given = parser.parse_args()
    wrong = []
    if given.drawn:
        mutants = drawn(given.drawn, given.seed, given.name)
    else:
        mutants, wrong = listed(given.name)
    for sentence in wrong:
        print(sentence, file=sys.stderr)
    if wrong:
        return 2
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    for name in _COMMON:
        __import__(name)
    # The folder of the data is beside the checkout, not beside its copy.
    data = ROOT.parent / "shared" / "data"
    os.environ.setdefault("DRAKE_EXO_DATA", str(data))
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        marks = ("not slow",) if given.quick else ("not slow", "slow")
        try:
            return 1 if report(copy, mutants, marks) else 0
        except RuntimeError as error:
            print(f"{error}\nsound code fails", file=sys.stderr)
            return 2


if __name__ == "__main__":
    raise SystemExit(main())
