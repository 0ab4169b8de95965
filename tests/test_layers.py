"""Rooms of the package stand on each other; its files are few and not short."""

import ast
import functools
from pathlib import Path

import pytest

import drake_exo

ROOT = Path(drake_exo.__file__).parent
# A room imports lower ones alone: those before it here.
ROOMS = (
    "errors",
    "files",
    "jobs",
    "player",
    "nlp",
    "soles",
    "model",
    "contact",
    "measurement",
    "collocation",
    "calibration",
    "virtual_laboratory",
    "report",
    "study",
    "designed",
    "designing",
    "batch",
    "papers",
    "cli",
)
FILES = sorted(ROOT.rglob("*.py"))
MODULES = [path for path in FILES if path != ROOT / "__init__.py"]


def room_of(path: Path) -> str:
    return path.relative_to(ROOT).with_suffix("").parts[0]


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def imported(path: Path) -> set[str]:
    """Other rooms that a file imports, anywhere in it."""
    return rooms_in(tree_of(path)) - {room_of(path)}


def rooms_in(tree: ast.Module) -> set[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    parts = [name.split(".") for name in names if name != "drake_exo"]
    found = {p[1] for p in parts if p[0] == "drake_exo"}
    return found - {"__version__"}


def test_imports_are_seen_wherever_they_stand():
    text = """
import numpy as np, drake_exo.nlp.ipopt
from drake_exo import __version__, soles
def late():
    from drake_exo.report.scene import Scene
    class Inner:
        import drake_exo.files as f
"""
    assert rooms_in(ast.parse(text)) == {"nlp", "soles", "report", "files"}


def test_every_room_has_its_place():
    assert {room_of(path) for path in MODULES} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_lower_ones_alone(room):
    lower = set(ROOMS[: ROOMS.index(room)])
    wrong = {
        str(path.relative_to(ROOT)): sorted(imported(path) - lower)
        for path in MODULES
        if room_of(path) == room and imported(path) - lower
    }
    assert not wrong


def test_soles_and_programs_know_no_exoskeleton():
    allowed = {
        "soles": {"errors", "files", "jobs", "player", "nlp"},
        "jobs": {"errors", "files"},
        "nlp": {"errors"},
    }
    users = set()
    for path in MODULES:
        room = room_of(path)
        assert imported(path) <= allowed.get(room, set(ROOMS)), path
        if "soles" in imported(path):
            users.add(room)
    assert users <= {"papers", "cli", "batch"}


def test_files_are_worth_opening():
    short = [
        str(path.relative_to(ROOT))
        for path in MODULES
        if len(path.read_text(encoding="utf-8").splitlines()) < 40
        and path.name != "__init__.py"
        and not path.name.endswith("_child.py")
        and room_of(path) != "cli"
    ]
    assert not short
    assert len(FILES) <= 150


@pytest.mark.slow
def test_no_files_import_each_other():
    """In a room, too, and also where an import stands within a function."""
    names = {".".join(("drake_exo", *parts(p))): p for p in MODULES}
    left = {p: files_in(tree_of(p), names) for p in MODULES}
    while free := [p for p, own in left.items() if not own & set(left) - {p}]:
        for path in free:
            del left[path]
    assert not left, sorted(str(p.relative_to(ROOT)) for p in left)


def parts(path: Path) -> tuple[str, ...]:
    own = path.relative_to(ROOT).with_suffix("").parts
    return own[:-1] if own[-1] == "__init__" else own


def files_in(tree: ast.Module, names: dict[str, Path]) -> set[Path]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            wanted = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in wanted:
            name = name if name in names else name.rpartition(".")[0]
            if name in names:
                found.add(names[name])
    return found
