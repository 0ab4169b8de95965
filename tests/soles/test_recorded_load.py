"""A step of a recording as a sole's load, by the command and by hand."""

import json
from pathlib import Path

import numpy as np
import pytest

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.optimize.files import read_design
from drake_exo.study import RecordedStep, read_study

CASE = Path(__file__).parents[1] / "cases" / "opencap_step.yaml"
LOAD = """load:
  recording: there.yaml
  trial: walk
  foot: left
"""
COARSE = EXAMPLE.split("load:")[0] + LOAD


def _made_up(*asked):
    """A reader of steps that knows one, and keeps what it was asked for."""
    s = np.linspace(0, 1, 6)
    _made_up.asked = asked
    return RecordedStep(
        "made up",
        0.1 * s,
        np.stack([0 * s, 0 * s + 5.0, 200 + 300 * s], axis=1),
        np.stack([-0.05 + 0.1 * s, 0 * s], axis=1),
        0.5 * s,
        rotations_xyz(np.stack([0.01 * s, 0.02 * s, 0.3 * s], axis=1)),
        np.zeros(2),
        0.0,
        np.zeros(2),
    )


def _case(more="", **keys):
    return Case.from_text(COARSE + more, read_step=_made_up, **keys)


def test_a_step_becomes_a_load():
    case = _case("  from: 0.5\n  step: 2\n  shift_m: [0.01, 0.02]\n")
    assert _made_up.asked == (
        "there.yaml", "walk", "left", 0.5, "toe_off", 2, 20.0,
    )  # fmt: skip
    step = _made_up()
    np.testing.assert_allclose(case.load.zmp, step.cop - [0.01, 0.02])
    np.testing.assert_array_equal(case.load.force, step.force)
    np.testing.assert_array_equal(case.load.free_moment, step.free_moment)
    assert case.load.rotation is None


def test_a_measured_pose_keeps_roll_and_pitch_and_the_sole_s_yaw():
    case = _case("  pose: measured\nstart: {yaw_rad: 0.1}\n")
    s = np.linspace(0, 1, 6)
    wanted = rotations_xyz(np.stack([0.01 * s, 0.02 * s, 0.1 + 0 * s], axis=1))
    np.testing.assert_allclose(case.load.rotation, wanted, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("  trial: walk\n", "", "trial and foot"),
        ("  recording: there.yaml\n", "  constant: {force_n: [0, 0, 9], "
         "zmp_m: [0, 0]}\n", "trial belongs to a recording"),
        ("left\n", "left\n  pose: measured\n  straight: true\n", "exclude"),
        ("left\n", "left\n  from: 1 s\n", "load.from must be"),
        ("left\n", "left\n  weight: 2\n", "load.weight is 2, but a single"),
        ("left\n", "left\n  begin: 1\n", "'begin'"),
        ("left\n", "left\n  from: 0.7\n  to: 0.6\n",
         r":10: load: from 0\.7 s has to be before to 0\.6 s"),
    ],
)  # fmt: skip
def test_keys_that_do_not_fit_are_named(old, new, sentence):
    text = COARSE.replace(old, new)
    assert text != COARSE
    with pytest.raises(InputError, match=sentence):
        Case.from_text(text, read_step=_made_up)


def test_without_a_reader_the_remedy_is_told():
    with pytest.raises(InputError, match="read_step"):
        Case.from_text(COARSE)


@pytest.mark.slow
@pytest.mark.parametrize("pose", ["free", "measured"])
def test_a_design_s_folder_holds_the_load_that_it_is_for(tmp_path, pose):
    """So that `strain` and `report` need no recording."""
    text = EXAMPLE.replace(EXAMPLE[EXAMPLE.index("load:"):], LOAD) + (
        f"  pose: {pose}\noptimize: {{intervals: [3, 3], stages: "
        "[{layer_m: 1.0e-4, kappa: 0.2, iterations: 2}]}\n"
    )  # fmt: skip
    case = Case.from_text(text, read_step=_made_up)
    row = case.optimize().write(tmp_path)
    assert row["failed_steps"] == 0
    names = row["multipliers"].keys()
    assert ("tilt_deg" in names) == (pose == "free")
    stored = read_design(tmp_path).setup.load
    for name in ("times", "force", "zmp", "free_moment", "rotation"):
        mine, again = getattr(case.load, name), getattr(stored, name)
        if mine is None:
            assert again is None
        else:
            np.testing.assert_allclose(again, mine, rtol=1e-8, atol=1e-9)


def _command(tmp_path, data_root, *changes):
    text = CASE.read_text().replace(
        "../studies", str(CASE.parents[1] / "studies")
    )
    text = text.replace("[20, 8, 3]", "[10, 4, 2]")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "case.yaml").write_text(text)
    out = tmp_path / "out"
    code = cli.main(
        ["sole", "simulate", str(tmp_path / "case.yaml"), "--data-root",
         str(data_root), "--out", str(out)]
    )  # fmt: skip
    return code, out


@pytest.mark.slow
@pytest.mark.parametrize("trial", ["walking1", "walking4"])
def test_a_recorded_step_is_simulated(tmp_path, data_root, trial):
    code, out = _command(tmp_path, data_root, ("walking1", trial))
    assert code == 0
    summary = json.loads((out / "summary.json").read_text())
    step = read_study(
        CASE.parents[1] / "studies" / "opencap_walking.yaml", data_root
    ).step(trial, "left")
    assert summary["steps"] == len(step.times)
    assert summary["zmp_error_rms_m"] < 1e-9
    # Plates of the laboratory tell moments that 20 N do not bear.
    assert 0 < summary["free_moment_nm"]["cut_samples"] < 6


@pytest.mark.slow
def test_a_measured_pose_tells_how_far_its_zmp_is_off(tmp_path, data_root):
    code, out = _command(
        tmp_path, data_root, ("foot: left", "foot: left\n  pose: measured")
    )
    assert code == 0
    summary = json.loads((out / "summary.json").read_text())
    by_name = {check["name"]: check for check in summary["checks"]}
    assert not by_name["plausibility.zmp"]["holds"]
    assert by_name["plausibility.zmp"]["value"] > 0.02
    assert "plausibility.tilt" not in by_name
    assert summary["tilt_max_deg"] > 45


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[0.010, 0.0]", "[0.0, 0.0]", "outside the sole by 1.7 mm at 1.19 s"),
        ("friction: 0.8", "friction: 0.4", "at 1.16 s asks for a friction of"),
        ("foot: left", "foot: right", "the recording begins within it"),
        ("trial: walking1", "trial: running", "none of the study's"),
    ],
)
def test_bad_steps_are_one_sentence_with_a_time(
    tmp_path, data_root, capsys, old, new, sentence
):
    code, out = _command(tmp_path, data_root, (old, new))
    said = capsys.readouterr().err
    assert code == 2
    assert sentence in said
    assert said.count("\n") == 1
    assert not out.exists()
