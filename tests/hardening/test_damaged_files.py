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

_SCRIPT = Path(__file__).with_name("damaged_files.py")
_TRIES = 100


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
    lines = read_damaged(str(_TRIES))
    assert [line for line in lines if "wrong" in line] == []
    finished = [line for line in lines if "finished" in line]
    assert len(finished) >= 35
    assert len(lines) == len(finished) * (_TRIES + 1)


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
