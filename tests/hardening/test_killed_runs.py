"""A run that is killed loses at most what came after its last checkpoint."""

import json
import signal
import subprocess
import sys

import pytest
from undrawn import undrawn

from drake_exo.cli import main

# Ends the process, as `kill -9` does, half-way through writing a checkpoint:
# the draft is there, the checkpoint still that of the iteration before.
_CUT = """
import os, signal, sys
from drake_exo import cli

def cut_short(module, name, last, half):
    whole, count = getattr(module, name), 0

    def write(file, *rest, **more):
        nonlocal count
        if "checkpoint" in str(file):
            count += 1
            if count == last:
                open(file, "wb").write(half)
                os.kill(os.getpid(), signal.SIGKILL)
        whole(file, *rest, **more)

    setattr(module, name, write)
"""
_CALIBRATE = """
from drake_exo.calibration import solving

solving._CHECKPOINT_SECONDS = 0.0
cut_short(solving.np, "savez", 6, b"PK half a file")
"""
_OPTIMISE = """
cut_short(os, "replace", 2, b"{half")
"""


def kill(where, command) -> None:
    script = _CUT + where + "cli.main(sys.argv[1:])"
    killed = subprocess.run(
        [sys.executable, "-c", script, *command],
        capture_output=True,
        timeout=300,
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr[-2000:]


@pytest.mark.slow
def test_calibrate_goes_on_after_a_kill(campaign, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["--phase", "foot-ground", "--no-front", "--out", str(out)]
    command = ["calibrate", str(campaign), *options]
    kill(_CALIBRATE, command)
    assert (out / "checkpoint.npz").is_file()
    assert not (out / "summary.json").exists()
    # Without --resume nothing is touched.
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    with undrawn():
        assert main([*command, "--resume"]) == 0
    assert "resumed from checkpoint.npz" in capsys.readouterr().out
    again = json.loads((out / "summary.json").read_text("utf-8"))
    with undrawn():
        assert main([*command, "--force"]) == 0
    fresh = json.loads((out / "summary.json").read_text("utf-8"))
    assert again["objective"] == pytest.approx(fresh["objective"], rel=1e-5)
    assert again["success"] and fresh["success"]
    # Five iterations were kept, the sixth was lost.
    assert again["iterations"] < fresh["iterations"]
    assert not list(out.glob("checkpoint*"))
    assert main([*command, "--resume"]) == 0
    assert "is complete and kept as it is" in capsys.readouterr().out


@pytest.mark.slow
def test_sole_optimize_goes_on_after_a_kill(sole_case, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["sole", "optimize", str(sole_case), "--out"]
    kill(_OPTIMISE, [*command, str(out)])
    found = json.loads((out / "checkpoint.json").read_text("utf-8"))
    assert found["stage"] == 0 and len(found["coefficients"]) > 10
    assert not (out / "summary.json").exists()
    assert main([*command, str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    more = tmp_path / "more"
    assert main([*command, str(more), "--resume", str(out)]) == 0
    row = json.loads((more / "summary.json").read_text("utf-8"))
    assert row["c"] < row["c_initial"]
