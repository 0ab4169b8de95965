"""What a user runs, and what happens when the input is bad."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from angles import in_radians

from drake_exo.cli import main
from drake_exo.files.opensim import read_table


@pytest.fixture
def study_text(command):
    return Path(command("calibrate")[1]).read_text("utf-8")


@pytest.fixture(scope="module")
def summary(calibrated):
    return json.loads((calibrated / "summary.json").read_text("utf-8"))


@pytest.mark.slow
def test_summary_holds_the_contract(summary):
    for key in (
        "success",
        "status",
        "iterations",
        "build_seconds",
        "solve_seconds",
        "num_variables",
        "num_constraints",
        "jacobian_nonzeros",
    ):
        assert key in summary
    assert summary["success"] is True
    assert {"name", "unit", "value", "lower", "upper", "at_bound"} <= set(
        summary["parameters"][0]
    )
    assert len(summary["rmsd"]) == 3
    for trial in summary["rmsd"]:
        assert set(trial["angles_deg"]) == {"ankle", "knee", "hip"}
        assert set(trial["velocities_deg_s"]) == {"ankle", "knee", "hip"}
        assert set(trial["grf_n"]) == {"horizontal", "vertical"}
        assert trial["cop_mm"] > 0.0


@pytest.mark.slow
def test_real_recording_beats_the_baseline(summary):
    """Baseline: 1.2 deg, 9 deg/s, 18 N, 5 mm, spheres at their bounds."""
    for trial in summary["rmsd"]:
        assert max(trial["angles_deg"].values()) < 0.8
        assert max(trial["velocities_deg_s"].values()) < 8.5
        assert max(trial["grf_n"].values()) < 12.0
        assert trial["cop_mm"] < 3.5
    assert not any(p["at_bound"] for p in summary["parameters"])


@pytest.mark.slow
def test_solution_holds_between_nodes_and_simulates(summary):
    for row in summary["audit"]:
        assert row["holds"]
        assert max(row["simulated_grf_n"]) < 1.0
        assert row["simulated_angles_deg"] < 0.1


@pytest.mark.slow
def test_intervals_are_reported(summary):
    free = [p for p in summary["parameters"] if p["free"]]
    assert free
    for p in free:
        assert p["half_width_95"] > 0.0
        assert isinstance(p["identifiable"], bool)


@pytest.mark.slow
def test_trajectories_are_read_back(calibrated):
    table = read_table(calibrated / "rise1_coordinates.sto")
    table = in_radians(table)
    assert table.names[:3] == ("foot_x", "foot_z", "foot_pitch")
    assert np.isfinite(table.values).all()


@pytest.mark.slow
def test_results_are_not_overwritten(command, calibrated, capsys):
    before = (calibrated / "summary.json").read_bytes()
    assert main([*command("calibrate"), "--out", str(calibrated)]) == 2
    assert "--force" in capsys.readouterr().err
    assert (calibrated / "summary.json").read_bytes() == before


def _run(tmp_path, text, data_root=None):
    study = tmp_path / "study.yaml"
    study.write_text(text, encoding="utf-8")
    root = ["--data-root", str(data_root)] if data_root else []
    return main(
        ["calibrate", str(study), *root, "--out", str(tmp_path / "out")]
    )


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("mass_kg: 60.0", "mass_kg: 0.0", ["study.yaml", "mass_kg"]),
        ("mass_kg: 60.0", "mas_kg: 60.0", ["mas_kg", "mass_kg"]),
        ("model: human", "model: humen", ["model", "human"]),
        ("prior_weight: 10.0", "prior_weight: .nan", ["prior_weight"]),
        ("  law: simbody", "  law: simbod", ["law", "simbody"]),
        (
            "  law: simbody",
            "  law: simbody\n  constants: {stiction: 0.8}",
            ["stiction", "static_friction"],
        ),
        (
            "model: human",
            "model: human\nmodel: human",
            ["study.yaml", "model"],
        ),
        ("rise: 3", "rise: 30", ["rise3", "30"]),
        ("STS1.trc", "STS9.trc", ["STS9.trc"]),
        ("upper: 1.0e7", "upper: 1.0e4", ["heel.modulus_n_m2", "bound"]),
    ],
)
def test_bad_study_is_one_sentence(
    before, after, words, study_text, data_root, tmp_path, capsys
):
    assert before in study_text
    text = study_text.replace(before, after)
    assert _run(tmp_path, text, data_root) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert error.count("\n") == 1
    for word in words:
        assert word in error


@pytest.mark.slow
def test_bad_recording_is_one_sentence(study_text, data_root, tmp_path, capsys):
    """Radians in a file whose header says degrees, and the like."""
    shutil.copytree(
        data_root / "opencap_subject4", tmp_path / "opencap_subject4"
    )
    trc = tmp_path / "opencap_subject4" / "MarkerData" / "STS1.trc"
    lines = trc.read_text("utf-8").splitlines(keepends=True)
    trc.write_text("".join(lines[:700]), encoding="utf-8")
    assert _run(tmp_path, study_text, tmp_path) == 2
    error = capsys.readouterr().err
    assert "STS1.trc" in error
    assert error.count("\n") == 1
