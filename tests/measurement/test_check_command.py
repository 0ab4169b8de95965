"""`drake-exo check` as a user runs it, and what bad input does."""

import json
from dataclasses import replace

import numpy as np
import pytest
from seated_recording import edit, write_seated

from drake_exo.cli import main
from drake_exo.files.c3d import write_c3d
from drake_exo.files.opensim import read_plates, read_trc, write_trc
from drake_exo.files.output import MANIFEST
from drake_exo.measurement.trial import Trial
from drake_exo.model.segments import scale_human

pytestmark = pytest.mark.slow


@pytest.fixture
def folder(tmp_path):
    write_seated(tmp_path, scale_human(70.0, 1.75))
    return tmp_path


def refusal(folder, capsys):
    """The message of exit code 2: one sentence, no traceback, no folder."""
    out = folder / "out"
    assert main(["check", str(folder / "study.yaml"), "--out", str(out)]) == 2
    assert not out.exists()
    message = capsys.readouterr().err
    assert message.startswith("drake-exo: error: ")
    assert message.count("\n") == 1 and "Traceback" not in message
    return message


def test_prints_and_writes_the_report(folder, capsys):
    out = folder / "out"
    study = folder / "study.yaml"
    assert main(["check", str(study), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    for words in (
        "body mass: 70.0 kg by the plates, stated 70.0 kg",
        "rise1 (0.",
        "markers: ",
        "gaps filled in 0 marker frames",
        "Newton's law misses: F_x",
        "lag taken out: forces +0 ms, encoders +0 ms",
        "exoskeleton: device model",
        "chair: plate",
    ):
        assert words in text
    assert "!" not in text
    assert (out / "quality.txt").read_text().strip() in text
    (trial,) = json.loads((out / "quality.json").read_text())["trials"]
    assert trial["name"] == "rise1" and trial["warnings"] == []
    assert max(trial["residual_n"]) < 10.0
    drawn = Trial.load(out / "rise1")
    assert trial["start_s"] == drawn.start_s
    assert trial["end_s"] == pytest.approx(drawn.start_s + drawn.times[-1])
    assert trial["marker_rms_all_m"] < 1e-8
    assert (out / "rise1.png").read_bytes().startswith(b"\x89PNG")
    assert Trial.load(out / "rise1").chair is not None
    assert main(["check", str(study), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


def test_who_only_calibrates_is_told_what_check_remarks(folder, capsys):
    data = read_trc(folder / "sts.trc")
    positions = data.positions.copy()
    positions[:, data.names.index("L_th1"), 0] += 0.06
    write_trc(folder / "sts.trc", replace(data, positions=positions))
    study = str(folder / "study.yaml")
    assert main(["check", study]) == 0
    remark = "marker L_th1 lies"
    assert f"  ! {remark}" in capsys.readouterr().out
    # It ends after the recordings were read: the folder is not empty.
    phase = ["--phase", "foot-ground", "--out", str(folder)]
    assert main(["calibrate", study, *phase]) == 2
    assert f"! rise1: {remark}" in capsys.readouterr().out


def test_recordings_of_an_earlier_run_are_not_replaced(folder, capsys):
    # A laboratory's folder lists all its files as a run's own.
    names = sorted(path.name for path in folder.iterdir())
    (folder / MANIFEST).write_text("\n".join(names), encoding="utf-8")
    study = str(folder / "study.yaml")
    root = ["--data-root", str(folder), "--out", str(folder), "--force"]
    other = folder.parent / f"{folder.name}.yaml"
    other.write_bytes((folder / "study.yaml").read_bytes())
    for words in ([study, *root[2:]], [str(other), *root]):
        assert main(["check", *words]) == 2
        assert "would replace" in capsys.readouterr().err
    assert names == sorted(
        path.name for path in folder.iterdir() if path.name != MANIFEST
    )


@pytest.mark.slow
def test_same_input_same_files(folder):
    study = str(folder / "study.yaml")
    for name in ("a", "b"):
        assert main(["check", study, "--out", str(folder / name)]) == 0
    for path in (folder / "a").iterdir():
        assert path.read_bytes() == (folder / "b" / path.name).read_bytes()


def test_marks_what_is_out_of_line(folder, capsys):
    edit(folder, "mass_kg: 70.0", "mass_kg: 84.0")
    assert main(["check", str(folder / "study.yaml")]) == 3
    text = capsys.readouterr().out
    assert "FAILS  plausibility.mass" in text
    assert "! standing gives 70.0 kg, the study says 84.0 kg (-17 %)" in text
    assert "! Newton's law misses" in text


def test_refuses_a_marker_set_that_cannot_determine_the_model(folder, capsys):
    path = folder / "study.yaml"
    text = path.read_text()
    for side in "LR":
        for name in ("asis", "psis"):
            text = text.replace(f"\n      - {side}_{name}", "")
    text = text.replace("pelvis:\n      left:\n      right:\n", "pelvis: {}\n")
    text = text.replace("pelvis:\n      left:", "pelvis:\n      left: [L_hip]")
    text = text.replace("[L_hip]\n      right:", "[L_hip]\n      right: []")
    path.write_text(text)
    message = refusal(folder, capsys)
    assert "cannot determine the angle of the pelvis" in message


def as_c3d(folder):
    """The trial's markers and plates as one c3d file."""
    markers = read_trc(folder / "sts.trc")
    _, plates = read_plates(folder / "sts.mot")
    square = np.array([[0.3, 0.3], [-0.3, 0.3], [-0.3, -0.3], [0.3, -0.3]])
    # x forward, y up, z right: plates lie in x and z, their z points down.
    corners = np.column_stack([square[:, 0], np.zeros(4), square[:, 1]])
    plates = list(plates.values())
    write_c3d(folder / "sts.c3d", markers, plates, [corners] * 3)
    edit(folder, "markers: sts.trc", "markers: sts.c3d")
    edit(folder, "forces: sts.mot", "forces: sts.c3d")


def test_c3d_gives_what_text_files_give(folder, capsys):
    texts = []
    for change in (lambda _: None, as_c3d):
        change(folder)
        assert main(["check", str(folder / "study.yaml")]) == 0
        lines = capsys.readouterr().out.splitlines()
        # Residuals are rounding: which marker has the largest is chance.
        lines = [x for x in lines if "plausibility." not in x]
        texts.append([x.split(", worst")[0] for x in lines])
    assert texts[0] == texts[1]


def test_refuses_a_truncated_c3d(folder, capsys):
    as_c3d(folder)
    path = folder / "sts.c3d"
    path.write_bytes(path.read_bytes()[:-3000])
    assert "the file is truncated" in refusal(folder, capsys)


def test_refuses_a_plate_without_corners(folder, capsys):
    as_c3d(folder)
    path = folder / "sts.c3d"
    data = path.read_bytes()
    at = data.index(b"CORNERS")
    start = at + len("CORNERS") + 2 + 1 + 1 + 3  # offset, type, dimensions
    size = 3 * 4 * 3 * 4
    path.write_bytes(data[:start] + bytes(size) + data[start + size :])
    assert "has no corners" in refusal(folder, capsys)


def test_refuses_unknown_mats_and_keys(folder, capsys):
    edit(
        folder, "  rise: 1", "  pressure: [{file: p.csv, mats: [m]}]\n  rise: 1"
    )
    assert "'m' is none of the mats" in refusal(folder, capsys)
    edit(folder, "pressure:", "presure:")
    assert "did you mean 'pressure'" in refusal(folder, capsys)


def test_refuses_a_sphere_without_a_place(folder, capsys):
    """As `calibrate` would, not after it was told that the study holds."""
    edit(folder, "model: coupled", "model: {ground: {foot: [heel, arch]}}")
    assert "'arch' has no usual place on foot" in refusal(folder, capsys)


def test_the_real_study_passes(data_root, request, capsys):
    study = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    assert main(["check", str(study), "--data-root", str(data_root)]) == 0
    text = capsys.readouterr().out
    assert "body mass: 60.0 kg by the plates, stated 60.0 kg" in text
    assert text.count("clock of forces: estimated +8 ms") == 3
