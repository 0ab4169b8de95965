"""Every script of the gallery is short, runs from nothing and draws."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from egl import drawn

_FOLDER = Path(__file__).resolve().parents[2] / "examples"
_SCRIPTS = sorted(_FOLDER.glob("*.py"))
_MOST_LINES = 40


def lines(path: Path) -> int:
    return len(path.read_text("utf-8").splitlines())


def test_all_are_short_and_listed():
    page = (_FOLDER / "README.md").read_text("utf-8")
    rows = re.findall(r"\]\((plot_\w+\.py)\) \| (\d+) \|", page)
    assert dict(rows) == {p.name: str(lines(p)) for p in _SCRIPTS}
    assert len(_SCRIPTS) == 5
    assert max(map(lines, _SCRIPTS)) <= _MOST_LINES


@pytest.mark.slow
@pytest.mark.parametrize("path", [*map(drawn, _SCRIPTS)])
def test_runs_and_draws(path, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path), str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert done.stdout.strip()
    (drawn,) = tmp_path.iterdir()
    assert drawn.name == path.stem.removeprefix("plot_") + ".png"
    assert drawn.read_bytes().startswith(b"\x89PNG")
