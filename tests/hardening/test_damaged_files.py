"""Damaged files of every format end in one sentence, never in a traceback.

More tries: `python tests/hardening/damaged_files.py 2000`.
"""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from damage import damaged
from readers import formats

pytestmark = pytest.mark.slow

_SCRIPT = Path(__file__).with_name("damaged_files.py")
_TRIES = 100
_SLOW = {"c3d": 25}  # read in a process of its own


def read_damaged(*arguments) -> list[dict]:
    """What the script says; a crash or hang of it is a failure too."""
    done = subprocess.run(
        [sys.executable, str(_SCRIPT), *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    lines = [json.loads(s) for s in done.stdout.splitlines() if s[:1] == "{"]
    last = lines[-1] if lines else ""
    assert done.returncode == 0, f"ended at {last}: {done.stderr[-2000:]}"
    return lines


def test_damaged_files_end_in_one_sentence():
    quick = [name for name in formats() if name not in _SLOW]
    assert len(quick) >= 34
    lines = read_damaged(str(_TRIES), *quick)
    assert [line for line in lines if "wrong" in line] == []
    assert len(lines) == len(quick) * (_TRIES + 1)


@pytest.mark.parametrize("name", _SLOW)
def test_damage_that_libraries_do_not_survive(name):
    lines = read_damaged(str(_SLOW[name]), name)
    assert [line for line in lines if "wrong" in line] == []
    assert len(lines) == _SLOW[name] + 1


@pytest.mark.parametrize("kind", ["text", "json", "npz", "binary"])
def test_every_try_is_damaged_in_its_own_way(kind):
    data = b'{"a": [1.5, 2], "b": "text"}\n'
    if kind == "npz":
        file = io.BytesIO()
        np.savez(file, a=np.arange(5.0), b="text")
        data = file.getvalue()
    tries = [
        damaged(kind, data, np.random.default_rng(seed)) for seed in range(200)
    ]
    assert data not in tries
    assert len(set(tries)) > 100
    assert damaged(kind, data, np.random.default_rng(7)) == tries[7]
