"""Scripts that call one function many times."""

import os
import subprocess
import sys
import time
from pathlib import Path

import example_jobs
import pytest

from drake_exo.errors import InputError
from drake_exo.jobs.engine import Beside

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
import all as benchmarks
from calls import run_calls

pytestmark = pytest.mark.slow

SCRIPT = """
from calls import run_calls

def square(x):
    return x * x

if __name__ == "__main__":
    print(run_calls(square, [{"x": k} for k in range(5)], 2, "squares"))
"""


def test_values_in_the_order_of_the_calls():
    told = []
    calls = [{"seconds": 0.3}, {"seconds": 0.01}, {"seconds": 0.02}]
    found = run_calls(example_jobs.sleep, calls, 2, "naps", told.append)
    assert found == [0.3, 0.01, 0.02]
    assert sorted(told) == [0.01, 0.02, 0.3]


def test_a_call_that_fails_is_named():
    with pytest.raises(RuntimeError, match=r"add.*'b'.*TypeError"):
        run_calls(example_jobs.add, [{"a": 1, "b": "x"}], 1)


@pytest.mark.parametrize("how", [["room/script.py"], ["-m", "room.script"]])
def test_from_a_script(tmp_path, how):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "script.py").write_text(SCRIPT)
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, *how],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == "[0, 1, 4, 9, 16]", done.stderr


@pytest.mark.parametrize("how", [["benchmarks/{}.py"], ["-m", "benchmarks.{}"]])
def test_benchmarks_run_as_files_and_as_modules(how):
    root = Path(__file__).parents[2]
    scripts = (root / "benchmarks").glob("*.py")
    names = [path.stem for path in scripts if "run_calls(" in path.read_text()]
    assert len(names) > 4
    for name in set(names) - {"calls"}:
        words = [word.format(name) for word in how]
        subprocess.run([sys.executable, *words, "--help"], cwd=root, check=True)


@pytest.mark.parametrize("script", ["interval_coverage", "phases", "weights"])
def test_short_benchmarks_run(script, tmp_path):
    """Those of a few seconds; benchmarks/all.py --quick runs the others."""
    row = benchmarks.run(f"{script}.py", True, tmp_path, str(tmp_path))
    assert row["code"] == 0, row["error"]


def test_calls_beside_are_waited_for():
    with Beside() as beside:
        assert beside(example_jobs.sleep, seconds=0.2).value() == 0.2
        assert beside(example_jobs.add, a=1, b=2).value() == 3


def test_a_call_beside_fails_as_it_would_here():
    with Beside() as beside:
        with pytest.raises(InputError, match=r"a\.yaml: wrong"):
            beside(example_jobs.refuse).value()
        with pytest.raises(RuntimeError, match="TypeError"):
            beside(example_jobs.add, a=1, b="x").value()


def test_a_call_beside_ends_with_its_context():
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Beside() as beside:
        beside(example_jobs.sleep, seconds=60)
        raise KeyboardInterrupt
    assert time.monotonic() - start < 30.0


def test_a_call_beside_is_told_to_stop_and_leaves_what_it_has(tmp_path):
    path = tmp_path / "left.txt"
    with Beside() as beside:
        call = beside(example_jobs.interrupted, path=path)
        while not path.exists():
            time.sleep(0.05)
        call.stop()
    assert path.read_text() == "so far"
