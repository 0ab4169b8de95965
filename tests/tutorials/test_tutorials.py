"""Every tutorial runs as a user runs it, shortened by DRAKE_EXO_SHORT."""

import ast
import fcntl
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from egl import drawn

import drake_exo as dx

_ROOT = Path(__file__).resolve().parents[2]
_FOLDER = _ROOT / "tutorials"
_NOTEBOOKS = sorted(_FOLDER.glob("*.ipynb"))
_NUM_TUTORIALS = 11
# Seconds for a cell and for a kernel to start: a busy machine is no failure.
_PATIENCE = ("--timeout=600", "--startup_timeout=300")
# Meshcat tells where it listens; nothing else may be said on stderr.
_ALLOWED = "INFO:drake:Meshcat listening"
_PUBLIC = {
    "dx": set(dx.__all__),
    "dx.contact": set(dx.contact.__all__),
    "dx.soles": set(dx.soles.__all__),
}


def _named(path):
    return path.stem


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A copy of the tutorials with campaign and calibration, made once."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # common to all workers of this run
    copy = shared / "tutorials"
    with (shared / "tutorials.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not copy.exists():
            shutil.copytree(_FOLDER, copy)
            _run(
                copy,
                sys.executable,
                "-c",
                "import campaign as c; c.contact()",
            )
    return copy


def _run(folder, *command):
    """Run a command there; what it says on stderr if it fails."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "DRAKE_EXO_SHORT": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("path", [*map(drawn, _NOTEBOOKS)])
def test_runs(path, folder):
    execute = Path(sys.executable).with_name("jupyter-execute")
    _run(folder, execute, "--inplace", *_PATIENCE, path.name)
    notebook = nbformat.read(folder / path.name, as_version=4)
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    said = [o.text for o in outputs if o.get("name") == "stderr"]
    for line in "".join(said).splitlines():
        assert line.startswith(_ALLOWED), line
    assert any("image/png" in o.get("data", {}) for o in outputs)


@pytest.mark.parametrize("path", _NOTEBOOKS, ids=_named)
def test_is_stored_without_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.parametrize("path", _NOTEBOOKS, ids=_named)
def test_has_title_aim_equation_and_exercise(path):
    cells = nbformat.read(path, as_version=4).cells
    prose = [c.source for c in cells if c.cell_type == "markdown"]
    number = int(path.name[:2])
    assert prose[0].startswith(f"# {number}. ")
    assert "**You learn**" in prose[0]
    assert any("$$" in text for text in prose)
    assert "**Exercise.**" in prose[-1]
    assert cells[-1].cell_type == "markdown"
    assert not any("Exercise" in text for text in prose[:-1])
    code = [c.source for c in cells if c.cell_type == "code"]
    assert max(len(source.splitlines()) for source in code) <= 60


def test_all_are_listed():
    assert len(_NOTEBOOKS) == _NUM_TUTORIALS
    numbers = [int(path.name[:2]) for path in _NOTEBOOKS]
    assert numbers == list(range(1, _NUM_TUTORIALS + 1))
    listed = {
        "tutorials/README.md": "",
        "README.md": "tutorials/",
    }
    for page, prefix in listed.items():
        links = re.findall(r"\]\(([^)]+\.ipynb)\)", (_ROOT / page).read_text())
        names = [prefix + path.name for path in _NOTEBOOKS]
        assert sorted(links) == names, page


def _code(path) -> str:
    """Its Python, without IPython's magic lines."""
    if path.suffix == ".py":
        return path.read_text("utf-8")
    cells = nbformat.read(path, as_version=4).cells
    code = "\n".join(c.source for c in cells if c.cell_type == "code")
    return re.sub(r"^%.*$", "", code, flags=re.M)


@pytest.mark.parametrize(
    "path", [*_NOTEBOOKS, _FOLDER / "campaign.py"], ids=_named
)
def test_speaks_the_public_names_alone(path):
    tree = ast.parse(_code(path))
    own = [line for line in map(ast.unparse, _imports(tree)) if "exo" in line]
    assert own == ["import drake_exo as dx"]
    used = [
        (ast.unparse(node.value), node.attr)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
    ]
    for place, known in _PUBLIC.items():
        assert {name for p, name in used if p == place} <= known


def _imports(tree):
    kinds = (ast.Import, ast.ImportFrom)
    return [node for node in ast.walk(tree) if isinstance(node, kinds)]
