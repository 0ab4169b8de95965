"""A study whose model is a description: one leg in a device of one joint."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from synthetic_recording import load, write_recording

from drake_exo.calibration.settings import (
    BushingSettings,
    InteractionSettings,
    Range,
)
from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.tables import Table, write_csv_table
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.description import models_path, nominal_human
from drake_exo.study import StudyFile, read_study

MODEL = {
    "device": {"file": "ankle_only.urdf", "weld": {"shoe": "foot"}},
    "cuffs": {"calf": {"human": "shank", "device": "calf"}},
}


@pytest.fixture
def folder(tmp_path):
    shutil.copy(models_path() / "ankle_only.urdf", tmp_path)
    return tmp_path


def changed(folder, **trial):
    """The study with its first trial changed."""
    text = (folder / "study.yaml").read_text()
    study = schema.yaml.safe_load(text)
    study["trials"] = [{**study["trials"][0], **trial}]
    text = schema.yaml.safe_dump(study, sort_keys=False)
    (folder / "study.yaml").write_text(text)
    return schema.load_text(text, StudyFile)


@pytest.mark.slow
def test_without_encoders_it_moves_as_the_person_does(folder):
    _, study = write_recording(folder, nominal_human(), model=MODEL)
    subject, (trial, _) = load(study, folder)
    assert trial.coordinates.device == ("motor",)
    np.testing.assert_allclose(
        trial.coordinate("motor"), trial.coordinate("ankle")
    )
    assert trial.moments is None
    # What stands on the plates is the person with the device.
    assert subject.report["standing_mass_kg"] == pytest.approx(66.4, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 0.25])
def test_joints_far_from_the_person_s_are_told(folder, off):
    """And what the device was read as is said."""
    path = folder / "ankle_only.urdf"
    parent = '<parent link="shoe"/>'
    moved = f'{parent}<origin xyz="0 0 {off}"/>'
    path.write_text(path.read_text().replace(parent, moved))
    write_recording(folder, nominal_human(), model=MODEL)
    study = read_study(folder / "study.yaml")
    (check,) = (
        c for c in study.plausibility() if c.name.endswith("device_joint")
    )
    assert check.value == pytest.approx(off, abs=1e-6)
    assert check.holds == (off < 0.2)
    said = "joint 'motor' lies 0.25 m from the ankle that it turns with"
    assert (said in check.sentence) == (off == 0.25)
    (note,) = (n for n in study.quality().notes if n.startswith("device:"))
    start = "device: ankle_only.urdf, 3.6 kg, its centre of mass "
    assert note.startswith(start)
    # 1.2 kg 0.07 m below and 2.4 kg 0.16 m above the ankle.
    human = study.subject.model.human
    z = (1.2 * -0.07 + 2.4 * (0.16 + off)) / 3.6
    down = human.shank.length_m + human.thigh.length_m - z
    x = (1.2 * 0.05 + 2.4 * 0.02) / 3.6
    assert f"{x:.2f} m in front of and {down:.2f} m below the hips" in note


@pytest.mark.slow
def test_its_own_columns_alone_are_read(folder):
    truth, _ = write_recording(folder, nominal_human(), model=MODEL)
    angle, moment = 0.1 * np.sin(truth.time), 8.0 * np.cos(truth.time)
    table = Table(truth.time, ("motor",), angle[:, None])
    write_csv_table(folder / "e.csv", table, ["rad"])
    table = Table(truth.time, ("motor_moment",), moment[:, None])
    write_csv_table(folder / "m.csv", table, ["Nm"])
    study = changed(folder, encoders="e.csv")
    bare = load(study, folder)[1][0]
    study = changed(folder, encoders="e.csv", exo_moments="m.csv")
    (trial,) = load(study, folder)[1]
    at = trial.start_s + trial.times
    np.testing.assert_allclose(
        trial.coordinate("motor"), 0.1 * np.sin(at), atol=2e-4
    )
    np.testing.assert_allclose(
        trial.moment("motor"), 8.0 * np.cos(at), atol=2e-2
    )
    # The person's ankle is relieved of it, knee and hip are not.
    assert bare.moments is None
    relieved = trial.moment("ankle") + trial.moment("motor")
    assert np.abs(trial.moment("motor")).max() > 2.0
    powered = changed(folder, encoders="e.csv", exo_moments="zero.csv")
    zero = Table(truth.time, ("motor_moment",), 0.0 * moment[:, None])
    write_csv_table(folder / "zero.csv", zero, ["Nm"])
    (idle,) = load(powered, folder)[1]
    np.testing.assert_allclose(relieved, idle.moment("ankle"), atol=1e-6)
    for joint in ("knee", "hip"):
        np.testing.assert_allclose(
            trial.moment(joint), idle.moment(joint), atol=1e-6
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "words"),
    [
        (
            {**MODEL, "device": {"file": "none.urdf", "weld": {"a": "foot"}}},
            "none.urdf: cannot be read",
        ),
        (
            {**MODEL, "cuffs": {"calf": {"human": "shank", "device": "x"}}},
            "ankle_only.urdf: has no link 'x'",
        ),
        ({"human": {"legs": "none"}}, "model.human.legs must be one of"),
    ],
)
def test_bad_descriptions_end_a_command(folder, capsys, model, words):
    write_recording(folder, nominal_human())
    path = folder / "study.yaml"
    study = schema.yaml.safe_load(path.read_text())
    path.write_text(schema.yaml.safe_dump({**study, "model": model}))
    out = folder / "out"
    assert main(["check", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_values_of_another_device_are_not_passed_over(folder):
    shipped = {"exoskeleton": {"thigh": {"mass_kg": 2.0}}}
    with pytest.raises(
        InputError, match=r"the model's device is ankle_only\.urdf"
    ):
        write_recording(folder, nominal_human(), model=MODEL, **shipped)


@pytest.mark.slow
def test_a_mat_lies_on_a_cuff(folder):
    mat = {
        "segment": "thigh",
        "rows": 2,
        "columns": 2,
        "cell_area_m2": 1e-4,
        "plane_normal": [1.0, 0.0, 0.0],
    }
    with pytest.raises(InputError, match=r"'thigh' has no cuff"):
        write_recording(folder, nominal_human(), model=MODEL, mats={"m": mat})
    mat |= {"segment": "calf", "legs": "left"}
    two = {
        "human": {"legs": "two"},
        "device": MODEL["device"] | {"weld": {"shoe": "foot_left"}},
        "cuffs": {"calf": {"human": "shank_left", "device": "calf"}},
    }
    with pytest.raises(InputError, match=r"mats\.m: legs is 'left', which"):
        write_recording(folder, nominal_human(), model=two, mats={"m": mat})


LOOSE = """<link name="loose"><inertial><mass value="1"/><inertia ixx="1"
  iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
WELD = {"weld": {"shoe": "foot"}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "device", "words"),
    [
        ('xyz="0 1 0"', 'xyz="1 0 0"', WELD, "turns about (1, 0, 0)"),
        ("</robot>", LOOSE, WELD, "'loose' is attached to nothing"),
        ('value="2.4"', 'value="0"', WELD, "'calf': has moments of in"),
        ("", "", {"weld": {"boot": "foot"}}, "has no link 'boot'"),
        ("", "", {"weld": {"shoe": "sole"}}, "no segment 'sole'"),
        ("", "", {"weld": {}}, "attached to nothing"),
        (
            "",
            "",
            {**WELD, "fixed": ["knee"]},
            "has no joint 'knee' to fix; it has motor",
        ),
        ('link="calf"', 'link="clf"', WELD, "ankle_only.urdf: "),
        (
            '<joint name="motor" type="revolute">',
            '<joint name="m2" type="fixed"><parent link="calf"/>'
            '<child link="shoe"/></joint>'
            '<joint name="motor" type="revolute">',
            WELD,
            "ankle_only.urdf: ",
        ),
    ],
)
def test_devices_that_cannot_be_end_a_command(
    folder, capfd, old, new, device, words
):
    """One sentence, exit code 2, nothing computed."""
    write_recording(folder, nominal_human())
    file = folder / "ankle_only.urdf"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new) if old else text)
    path = folder / "study.yaml"
    study = schema.yaml.safe_load(path.read_text())
    model = {**MODEL, "device": {"file": "ankle_only.urdf", **device}}
    path.write_text(schema.yaml.safe_dump({**study, "model": model}))
    assert main(["check", str(path), "--out", str(folder / "out")]) == 2
    said = capfd.readouterr().err
    assert words in said
    assert "Traceback" not in said
    (sentence,) = (s for s in said.splitlines() if "drake-exo: error" in s)
    assert sentence == said.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "words"),
    [
        (
            {"joints": {"moter": {"coulomb_nm": 2}}},
            "study.yaml: device.joints.moter: the device has no such joint; it "
            "has motor; did you mean 'motor'?",
        ),
        (
            {"hip": {"coulomb_nm": 2}},
            "device.hip: the device has no such joint; it has ankle",
        ),
        (
            {"ankle": {"viscous_nm_s": 1}, "joints": {"motor": {}}},
            "device.ankle is used for no joint, since device.joints has values "
            "of motor; keep one of them",
        ),
    ],
)
def test_friction_of_no_joint_ends_a_command(folder, capsys, device, words):
    write_recording(folder, nominal_human())
    path = folder / "study.yaml"
    study = schema.yaml.safe_load(path.read_text())
    said = {**study, "model": MODEL, "device": device}
    path.write_text(schema.yaml.safe_dump(said))
    assert main(["check", str(path), "--out", str(folder / "out")]) == 2
    assert words in capsys.readouterr().err
    names = Coordinates(("x", "z", "pitch", "ankle", "motor_ankle"))
    drives = Device(joints={"moter": JointDrive()})
    drives.check(names)  # of a person alone nothing is asked
    with pytest.raises(InputError, match="moter"):
        drives.check(replace(names, device=("motor_ankle",)))


def test_a_recording_named_like_a_key_is_no_key(folder, monkeypatch):
    """Its errors name it alone, wherever the command is given."""
    write_recording(folder, nominal_human())
    monkeypatch.chdir(folder)
    (folder / "standing.trc").write_text("no markers")
    path = folder / "study.yaml"
    path.write_text(path.read_text().replace("static.trc", "standing.trc"))
    with pytest.raises(InputError, match=r"^standing\.trc: "):
        _ = read_study("study.yaml").subject


def test_cuffs_of_either_leg_have_their_segment_s_settings():
    stiff = BushingSettings(normal_n_m=Range(9e3, 1e3, 2e4))
    own = BushingSettings(normal_n_m=Range(7e3, 1e3, 2e4))
    found = InteractionSettings(thigh=stiff, cuffs={"thigh_right": own})
    assert found.of("thigh_left") == found.of("thigh") == stiff
    assert found.of("thigh_right") == own
    assert found.of("strap") == found.of("shank_left") == BushingSettings()
