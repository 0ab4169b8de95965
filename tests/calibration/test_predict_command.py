"""Calibrated contact predicts rises of a real recording; runs resume."""

import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from drake_exo.cli import main

_STUDY = "tests/studies/opencap_predict.yaml"


@pytest.fixture(scope="module")
def command(request):
    data_root = request.getfixturevalue("data_root")
    study = str(request.config.rootpath / _STUDY)
    return lambda name: [name, study, "--data-root", str(data_root)]


@pytest.fixture(scope="module")
def calibrated(command, tmp_path_factory):
    out = tmp_path_factory.mktemp("predict") / "cal"
    assert main([*command("calibrate"), "--no-front", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def predicted(command, calibrated):
    out = calibrated.parent / "c1"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    assert main([*command("predict"), *more]) == 0
    return out


def test_unseen_rises_are_predicted(predicted):
    """The paper's C1: angles up to 3.3 deg."""
    summary = json.loads((predicted / "summary.json").read_text("utf-8"))
    assert summary["success"] is True
    assert [r["trial"] for r in summary["rmsd"]] == ["rise4", "rise5"]
    for row in summary["rmsd"]:
        assert max(row["angles_deg"].values()) < 3.3
        assert max(row["velocities_deg_s"].values()) < 25.0
        assert max(row["grf_n"].values()) < 15.0
        assert set(row["moments_nm"]) == {"ankle", "knee", "hip"}
        assert row["interaction_n"] == {}
    assert all(row["holds"] for row in summary["audit"])


def test_intervals_are_reported(calibrated):
    summary = json.loads((calibrated / "summary.json").read_text("utf-8"))
    free = [p for p in summary["parameters"] if p["free"]]
    assert free
    for p in free:
        assert p["half_width_95"] > 0.0
        assert isinstance(p["identifiable"], bool)


def test_a_limit_too_low_fails_with_names(
    command, calibrated, tmp_path, capsys
):
    out = tmp_path / "low"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    assert main([*command("predict"), *more, "--torque-limit", "5"]) == 1
    text = capsys.readouterr().out
    assert "torque" in text and "its bound is" in text
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["success"] is False
    assert summary["rmsd"] == []
    assert all(s["binding_bounds"] for s in summary["solves"])


_KILL = """
import os, signal, sys
from drake_exo import cli
from drake_exo.calibration import solving

solving._CHECKPOINT_SECONDS = 0.0
call = solving.SolveWatch.__call__

def watch(self, iterate):
    call(self, iterate)
    if iterate.iteration == 6:
        os.kill(os.getpid(), signal.SIGKILL)

solving.SolveWatch.__call__ = watch
cli.main(sys.argv[1:])
"""


def test_a_killed_run_resumes(command, calibrated, tmp_path, capsys):
    out = tmp_path / "cut"
    again = [*command("calibrate"), "--no-front", "--out", str(out)]
    killed = subprocess.run(
        [sys.executable, "-c", _KILL, *again], capture_output=True, timeout=120
    )
    assert killed.returncode == -signal.SIGKILL
    assert (out / "checkpoint.npz").is_file()
    assert main(again) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*again, "--resume"]) == 0
    assert "resumed" in capsys.readouterr().out
    assert not (out / "checkpoint.npz").exists()
    first, second = (
        json.loads((folder / "summary.json").read_text("utf-8"))
        for folder in (calibrated, out)
    )
    assert second["objective"] == pytest.approx(first["objective"], rel=1e-5)
    assert main([*again, "--resume"]) == 0
    assert "nothing to resume" in capsys.readouterr().out


def test_a_checkpoint_of_another_problem_is_refused(command, tmp_path, capsys):
    out = tmp_path / "other"
    out.mkdir()
    np.savez(out / "checkpoint.npz", x=np.zeros(3), fingerprint="another")
    again = [*command("calibrate"), "--out", str(out), "--resume"]
    assert main(again) == 2
    error = capsys.readouterr().err
    assert "--resume" in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--scale-interaction", "0"], "--scale-interaction"),
        (["--torque-limit", "nan"], "--torque-limit"),
        (["--controller", "nowhere"], "MODULE:NAME"),
    ],
)
def test_bad_options_are_one_sentence(
    options, words, command, calibrated, tmp_path, capsys
):
    more = ["--calibration", str(calibrated), "--out", str(tmp_path / "x")]
    assert main([*command("predict"), *more, *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


def test_a_folder_that_holds_no_calibration(
    command, calibrated, tmp_path, capsys
):
    copy = tmp_path / "copy"
    shutil.copytree(calibrated, copy)
    (copy / "parameters.json").write_text('{"law": "simbody"}')
    more = ["--calibration", str(copy), "--out", str(tmp_path / "x")]
    assert main([*command("predict"), *more]) == 2
    error = capsys.readouterr().err
    assert "parameters.json" in error and error.count("\n") == 1
