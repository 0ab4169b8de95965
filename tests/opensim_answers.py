"""OpenSim's answers, in a process of its own, where it is installed."""

import json
import os
import subprocess
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]


def opensim_python() -> Path:
    """A Python with the opensim wheel; skips where there is none."""
    usual = _ROOT / ".opensim/bin/python"
    python = Path(os.environ.get("DRAKE_EXO_OPENSIM", usual))
    if not python.is_file():
        pytest.skip(f"OpenSim is not at {python} ('make opensim' installs it)")
    return python


_EXPAND = """
import re, sys, xacro
text = open(sys.argv[1]).read()
# What is included belongs to another program, which is not here.
open(sys.argv[2], "w").write(re.sub("<xacro:include[^>]*/>", "", text))
done = xacro.process_file(sys.argv[2], mappings={"ground_gait": "true"})
print(done.toxml())
"""


def expanded(source: Path, folder: Path) -> str:
    """What xacro makes of a file; skips where it is not installed."""
    python = opensim_python()
    done = subprocess.run(
        [python, "-c", _EXPAND, source, folder / source.name],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if "No module named 'xacro'" in done.stderr:
        pytest.skip(f"{python} has no xacro ('make opensim' installs it)")
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def ask(folder: Path, **request) -> dict:
    """What `opensim_child.py` answers."""
    python = opensim_python()
    question, answer = folder / "request.json", folder / "answer.json"
    question.write_text(json.dumps(request))
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [python, _ROOT / "tests/opensim_child.py", question, answer],
        capture_output=True,
        text=True,
        timeout=300,
        env=env,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(answer.read_text())
