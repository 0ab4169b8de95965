"""Each mistake that a laboratory makes once, planted and told.

One recording, sound as it is; every test spoils one thing and reads which check
says so, and what it says.
"""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from seated_recording import EXO_JOINTS, edit, write_seated
from unmarked import unmarked

import drake_exo as dx
from drake_exo.cli import main
from drake_exo.contact.parameters import nominal_contact
from drake_exo.errors import InputError
from drake_exo.files.opensim import (
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.tables import read_csv_table, write_csv_table
from drake_exo.measurement import plausibility
from drake_exo.measurement.plausibility import Evidence, misfit
from drake_exo.model.segments import scale_human
from drake_exo.study import Study, read_study
from drake_exo.virtual_laboratory import synthetic


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A trial with plates under both feet and the chair, and encoders."""
    folder = tmp_path_factory.mktemp("sound")
    write_seated(folder, scale_human(70.0, 1.75))
    return folder


@pytest.fixture
def folder(tmp_path, sound):
    for path in sound.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def failing(folder):
    """Name -> sentences of the checks that fail."""
    found = {}
    for c in read_study(folder / "study.yaml").plausibility():
        assert c.name.startswith("plausibility.")
        assert np.isfinite(c.value) and np.isfinite(c.limit)
        assert c.holds == (c.sentence == "")
        if not c.holds:
            name = c.name.removeprefix("plausibility.")
            found.setdefault(name, []).append(f"{c.where}: {c.sentence}")
    return found


def said(folder, name):
    """The first sentence of a check that must fail."""
    found = failing(folder)
    assert name in found, sorted(found)
    return found[name][0]


def forces(folder, change, names=r"ground_force_\d_\w+", file="sts.mot"):
    """Columns of the force file, each through a function of time and values."""
    table = read_table(folder / file)
    values = table.values.copy()
    for i, name in enumerate(table.names):
        if re.fullmatch(names, name):
            values[:, i] = change(table.time, values[:, i])
    write_table(folder / file, replace(table, values=values))


def encoders(folder, change):
    """The encoders (N, 3) ankle, knee, hip [rad] through a function."""
    table = read_csv_table(folder / "exo.csv")
    assert table.names == EXO_JOINTS
    table = replace(table, values=change(table.values.copy()))
    write_csv_table(folder / "exo.csv", table, ["deg"] * 3)


def markers(folder, change, file="sts.trc"):
    data = read_trc(folder / file)
    write_trc(folder / file, replace(data, positions=change(data)))


@pytest.mark.slow
def test_a_sound_recording_holds_every_check(folder):
    checks = read_study(folder / "study.yaml").plausibility()
    assert [c for c in checks if not c.holds] == []
    names = {c.name.removeprefix("plausibility.") for c in checks}
    assert names >= {
        "mass", "standing_posture", "standing_balance", "markers", "end",
        "ankle_range", "knee_range", "hip_range", "newton", "euler",
        "facing", "marker_leap", "marker_frozen", "floor", "foot_sides",
        "stature",
        "mean_forward", "mean_sideways", "mean_weight", "shear_sign",
        "leg_angles", "feet_apart", "leg_share", "lifted_foot", "foot_slides",
        "cop_along", "cop_across", "cop_unit", "plate_sides", "chair",
        "flat_channel", "saturated_channel", "encoder_sign",
        "encoder_offset", "encoder_unit", "encoder_joints",
        "encoder_motion", "encoder_frozen",
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ["marker_axes", "both"])
def test_markers_turned_round_bend_the_knees_backwards(folder, name):
    axes = "{marker_axes: {forward: -x, up: y}"
    if name == "both":
        axes += ", force_axes: {forward: -x, up: y}"
    edit(folder, "trials:", f"laboratory: {axes}}}\ntrials:")
    text = said(folder, "knee_range")
    assert "sts.trc" in text and "bends backwards" in text
    assert "marker_axes look turned round" in text
    # Left and right are exchanged by the same turn, not by names.
    assert "marker_axes look turned round" in said(folder, "foot_sides")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axes", "told"),
    [
        ("{forward: x, up: y, facing_deg: -30}", "30 deg to the left of"),
        ("{forward: x, up: y, facing_deg: 150}", "add -150 to facing_deg"),
    ],
)
def test_a_subject_who_faces_obliquely(folder, axes, told):
    """The file's forward is 30° to the right of the subject's, or behind."""
    trial = "forces: sts.mot"
    edit(folder, trial, f"{trial}\n  marker_axes: {axes}")
    text = said(folder, "facing")
    assert "sts.trc" in text and told in text
    assert "30 deg to the left of forward" in text


@pytest.mark.slow
def test_plates_turned_round(folder):
    axes = "{force_axes: {forward: -x, up: y}}"
    edit(folder, "trials:", f"laboratory: {axes}\ntrials:")
    found = failing(folder)
    assert "force_axes look turned round" in found["plate_sides"][0]
    assert "cop_along" in found and "euler" in found


@pytest.mark.slow
def test_encoders_that_count_the_other_way(folder):
    encoders(folder, lambda x: x * [1.0, -1.0, 1.0])
    text = said(folder, "encoder_sign")
    assert text.startswith("rise1: exo.csv: exo_knee")
    assert "sign looks flipped" in text


@pytest.mark.slow
@pytest.mark.parametrize("joint", range(3))
def test_an_encoder_with_an_offset(folder, joint):
    encoders(folder, lambda x: x + np.deg2rad(15.0) * np.eye(3)[joint])
    text = said(folder, "encoder_offset")
    assert f"{EXO_JOINTS[joint]} reads +15 deg off" in text


@pytest.mark.slow
def test_offsets_are_those_of_the_most_upright_posture(folder):
    """Cuffs that hide a seventh of the movement are no offset.

    The person stands upright after the used part ends.
    """
    encoders(folder, lambda x: 0.85 * x)
    study = read_study(folder / "study.yaml")
    checks = study.plausibility()
    off = [c.value for c in checks if c.name.endswith("encoder_offset")]
    (trial,) = study.trials()
    hidden = 0.15 * np.abs(np.rad2deg(trial.q[:, 3:6]))
    assert max(off) < 1.0 < hidden[-1].min()


def test_a_clock_that_is_off_is_no_other_movement():
    """The share that is missed is that at the best lag; both are told."""
    time = np.arange(0.0, 2.0, 0.01)
    own = (0.5 - 0.5 * np.cos(np.pi * time))[:, None]
    rate = (0.5 * np.pi * np.sin(np.pi * time))[:, None]
    e = SimpleNamespace(
        trial=SimpleNamespace(start_s=1.0, times=time, body=(own, rate)),
        expected=lambda x: x,
    )
    t = np.arange(0.0, 4.0, 0.005)
    for gain, late in ((1.0, 0.03), (0.8, -0.02)):
        moved = gain * (0.5 - 0.5 * np.cos(np.pi * (t - 1.0 - late)))
        angles = SimpleNamespace(time=t, values=moved[:, None])
        other = SimpleNamespace(recording=SimpleNamespace(angles=angles))
        share, lag = misfit(e, other)
        assert lag == pytest.approx(late, abs=1e-9)
        assert share == pytest.approx(1.0 - gain, abs=1.5e-4)


def test_euler_is_missed_by_moments_about_the_ankle():
    """A force too much at the ankle is Newton's matter alone."""
    x, z, n = 0.1, 0.08, 4
    needed = np.tile([30.0, 700.0, -60.0], (n, 1))
    force = np.array([20.0, -50.0])
    at_ankle = np.r_[force, z * force[0] - x * force[1]]
    for more in (0.0, 3.0):
        e = SimpleNamespace(
            measured=needed - at_ankle - [0.0, 0.0, more],
            needed=needed,
            trial=SimpleNamespace(body=(np.tile([x, z, 0.0], (n, 1)),)),
        )
        assert Evidence.pitch_error(e) == pytest.approx(more, abs=1e-9)
        e.measured = e.measured * [-1.0, 1.0, -1.0]
        assert Evidence.pitch_error(e) > 10.0
        found = Evidence.pitch_error(e, turned=True)
        assert found == pytest.approx(more, abs=1e-9)


@pytest.mark.slow
def test_knee_and_hip_exchanged(folder):
    encoders(folder, lambda x: x[:, [0, 2, 1]])
    assert "columns look exchanged" in said(folder, "encoder_joints")


@pytest.mark.slow
def test_encoders_in_another_unit(folder):
    encoders(folder, np.rad2deg)
    assert "degrees may be taken for radians" in said(folder, "encoder_unit")


@pytest.mark.slow
def test_an_encoder_that_stands_still(folder):
    def change(x):
        x[150:200, 1] = x[150, 1]
        return x

    encoders(folder, change)
    assert "exo_knee stands still" in said(folder, "encoder_frozen")


@pytest.mark.slow
def test_encoders_of_another_movement(folder):
    encoders(folder, lambda x: np.roll(x, 40, axis=0))
    text = said(folder, "encoder_motion")
    assert "the file may be of another trial" in text


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.08, -0.08])
def test_forces_on_another_clock(folder, late_s):
    table = read_table(folder / "sts.mot")
    write_table(folder / "sts.mot", replace(table, time=table.time + late_s))
    text = said(folder, "force_clock")
    assert f"better if they are taken as {1e3 * late_s:+.0f} ms late;" in text


def another_trial(folder, own="other.csv"):
    """A second trial, 0.4 s earlier on its own clock."""
    for old, new in (("sts.trc", "b.trc"), ("sts.mot", "b.mot")):
        shutil.copy(folder / old, folder / new)

    def earlier(data):
        return replace(data, time=data.time - 0.4)

    write_trc(folder / "b.trc", earlier(read_trc(folder / "b.trc")))
    write_table(folder / "b.mot", earlier(read_table(folder / "b.mot")))
    table = earlier(read_csv_table(folder / "exo.csv"))
    table = replace(table, values=1.01 * table.values)
    write_csv_table(folder / "other.csv", table, ["deg"] * 3)
    path = folder / "study.yaml"
    text = path.read_text()
    start = text.index("- name: rise1")
    entry = text[start : text.index("device:")]
    entry = entry.replace("rise1", "rise2").replace("exo.csv", own)
    entry = entry.replace("sts.", "b.")
    path.write_text(text.replace("device:", f"{entry}device:"))


@pytest.mark.slow
def test_encoders_of_another_trial_of_the_study(folder):
    another_trial(folder)
    assert failing(folder) == {}
    edit(folder, "encoders: exo.csv", "encoders: swap")
    edit(folder, "encoders: other.csv", "encoders: exo.csv")
    edit(folder, "encoders: swap", "encoders: other.csv")
    text = said(folder, "encoder_file")
    assert "fit the movement of trial rise2" in text


@pytest.mark.slow
def test_files_exchanged_between_nearly_the_same_movements(folder):
    """What soft cuffs hide in each trial alone, both together tell."""
    another_trial(folder)
    middle = read_trc(folder / "sts.trc").time.mean()
    for file, read, write in (
        ("b.trc", read_trc, write_trc),
        ("b.mot", read_table, write_table),
        ("other.csv", read_csv_table, written_in_degrees),
    ):
        data = read(folder / file)
        slower = middle + 1.06 * (data.time + 0.4 - middle)
        data = replace(data, time=slower)
        if file == "b.trc":
            data = replace(data, rate_hz=data.rate_hz / 1.06)
        write(folder / file, data)
    # Cuffs that take a fifth of the movement, in both alike.
    for file in ("exo.csv", "other.csv"):
        table = read_csv_table(folder / file)
        table = replace(table, values=0.8 * table.values)
        written_in_degrees(folder / file, table)
    assert "encoder_swap" not in failing(folder)
    edit(folder, "encoders: exo.csv", "encoders: swap")
    edit(folder, "encoders: other.csv", "encoders: exo.csv")
    edit(folder, "encoders: swap", "encoders: other.csv")
    found = failing(folder)
    assert "encoder_file" not in found
    assert "this trial and rise2 fit" in found["encoder_swap"][0]


def warped(folder, file, late_s):
    """Encoders of a movement that begins early and ends late."""
    table = read_csv_table(folder / file)
    middle = table.time[np.argmax(np.abs(np.gradient(table.values[:, 2])))]
    time = table.time + late_s * np.tanh((table.time - middle) / 0.3)
    values = np.column_stack(
        [np.interp(table.time, time, x) for x in table.values.T]
    )
    written_in_degrees(folder / file, replace(table, values=values))


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_encoders_of_a_trial_that_is_not_in_the_study(folder, late_s):
    """A little slower than its movement: no other check sees it."""
    another_trial(folder)
    warped(folder, "other.csv", late_s)
    found = failing(folder)
    assert set(found) == ({"encoder_stranger"} if late_s else set())
    if found:  # of two trials either may be the one
        first, second = found["encoder_stranger"]
        assert first.startswith("rise1: exo.csv: the device moves")
        assert "in rise2; the encoders' file, or that of rise2, may be" in first
        assert second.startswith("rise2: other.csv: the device moves")
        assert "of a trial that is not in the study" in second


@pytest.mark.slow
def test_a_third_trial_tells_whose_encoders_are_wrong(folder):
    another_trial(folder)
    text = (folder / "study.yaml").read_text()
    start = text.index("- name: rise2")
    entry = text[start : text.index("device:")]
    shutil.copy(folder / "other.csv", folder / "third.csv")
    for ending in ("trc", "mot"):
        shutil.copy(folder / f"b.{ending}", folder / f"c.{ending}")
    entry = entry.replace("rise2", "rise3").replace("other", "third")
    entry = entry.replace("b.trc", "c.trc").replace("b.mot", "c.mot")
    (folder / "study.yaml").write_text(
        text.replace("device:", f"{entry}device:")
    )
    table = read_csv_table(folder / "third.csv")
    table = replace(table, values=table.values - 0.002)
    written_in_degrees(folder / "third.csv", table)
    assert failing(folder) == {}
    warped(folder, "other.csv", 0.1)
    (sentence,) = failing(folder)["encoder_stranger"]
    assert sentence.startswith("rise2: other.csv")
    assert "differently on the person than in every other trial" in sentence


@pytest.mark.slow
def test_a_driven_trial_is_not_compared_with_a_passive_one(folder):
    another_trial(folder)
    warped(folder, "other.csv", 0.1)
    edit(
        folder,
        "encoders: exo.csv",
        "encoders: exo.csv\n  exo_moments: moments.csv",
    )
    assert "encoder_stranger" not in failing(folder)


def test_what_a_wearer_explains_costs_little():
    """Least squares with priors, by its definition."""
    rng = np.random.default_rng(2)
    first, second = (
        plausibility._Difference(
            rng.normal(size=(12, 3)),
            rng.normal(size=12),
            rng.normal(size=12),
            12.0,
        )
        for _ in range(2)
    )
    A = np.zeros((24, 5))
    A[:12, :3], A[12:, :3] = first.by, second.by
    A[:12, 3], A[12:, 4] = first.by_clock, second.by_clock
    y = np.r_[first.found, second.found]
    rows = np.vstack([A, np.eye(5)])
    cost = np.linalg.lstsq(rows, np.r_[y, np.zeros(5)], rcond=None)[1]
    assert plausibility._cost(first, second) == pytest.approx(cost[0])


def test_what_two_trials_cost_beyond_each_alone(monkeypatch):
    rng = np.random.default_rng(4)
    made = {
        lag: plausibility._Difference(
            rng.normal(size=(12, 3)), rng.normal(size=12),
            rng.normal(size=12), count,
        )
        for lag, count in ((0.01, 4.0), (0.02, 6.0))
    }  # fmt: skip
    trials = [
        SimpleNamespace(
            lag=lag,
            files=SimpleNamespace(markers=f"{lag}.trc"),
            recording=SimpleNamespace(moments=None),
        )
        for lag in (*made, 0.03)
    ]

    def misfit(e, other):
        return (0.1 if e.lag in made else np.inf), e.lag

    monkeypatch.setattr(plausibility, "misfit", misfit)
    monkeypatch.setattr(
        plausibility._Difference, "of", staticmethod(lambda e, lag: made[lag])
    )
    found = plausibility.disagreement(trials)
    first, second = made.values()
    more = plausibility._cost(first, second)
    more -= plausibility._cost(first) + plausibility._cost(second)
    expected = np.full((3, 3), np.nan)
    expected[0, 1] = expected[1, 0] = more / 10.0
    np.testing.assert_allclose(found, expected)


def test_a_trial_is_judged_by_the_one_most_like_it(monkeypatch):
    costs = np.array(
        [[np.nan, 0.2, 3.0, np.nan], [0.2, np.nan, 5.0, np.nan],
         [3.0, 5.0, np.nan, np.nan], [np.nan] * 4]
    )  # fmt: skip
    monkeypatch.setattr(plausibility, "disagreement", lambda known: costs)
    trials = [
        SimpleNamespace(
            trial=SimpleNamespace(name=name),
            recording=SimpleNamespace(angles=angles),
            files=SimpleNamespace(encoders=f"{name}.csv"),
            check=lambda *said, name=name: (name, *said[:2]),
        )
        for name, angles in zip("abscd", (1, 1, None, 1, 1), strict=True)
    ]
    assert list(plausibility.wearer_checks(trials)) == [
        ("a", "encoder_stranger", 0.2),
        ("b", "encoder_stranger", 0.2),
        ("c", "encoder_stranger", 3.0),
    ]
    assert plausibility.LIMITS["encoder_stranger"][0] == 0.45


@pytest.mark.slow
def test_what_the_difference_of_device_and_person_depends_on(folder):
    """Each size by itself; noise is half a degree in 0.1 s."""
    study = read_study(folder / "study.yaml")
    (trial,) = study.trials()
    recording = study.recordings.used(study.file.trials[0])
    files, subject = study.file.trials[0], study.subject
    e = Evidence(trial, study.model, files, recording, subject)
    found = plausibility._Difference.of(e, 0.02)
    n, joints = len(trial.times), 3
    d, v, a = recording.angles.motion(trial.start_s + trial.times + 0.02)
    human = trial.q[:, 3:6]  # the foot, then the person
    step = trial.times[1]
    scale = np.sqrt(step / 0.1) / np.deg2rad(0.5)
    assert found.count == pytest.approx(joints * trial.duration / 0.1)

    def close(own, expected):
        size = scale * np.abs(expected).max()
        np.testing.assert_allclose(own, scale * expected, atol=1e-6 * size)

    close(found.found, (d - human).T.ravel())
    close(found.by_clock, 0.03 * v.T.ravel())
    sizes = found.by.reshape(joints, n, joints, -1)
    pitch = trial.q[:, [2]] - np.cumsum(d * [1.0, -1.0, 1.0], axis=1)
    parts = np.hstack([
        np.full((n, 1), np.deg2rad(2.0)), 0.03 * human, 0.015 * human**2,
        np.deg2rad(2.0) * np.sin(pitch), np.deg2rad(0.05) * a,
        np.deg2rad(1.0) * np.tanh(v / 0.05),
    ])  # fmt: skip
    for j in range(joints):
        for k in range(joints):
            if j == k:
                close(sizes[j, :, k], parts)
            else:  # each joint has sizes of its own
                assert not sizes[j, :, k].any()


def written_in_degrees(path, table):
    write_csv_table(path, table, ["deg"] * len(table.names))


@pytest.mark.slow
def test_two_trials_with_the_same_encoders(folder):
    another_trial(folder, own="exo.csv")
    text = said(folder, "encoder_file")
    assert "holds the same angles as the file of trial rise" in text


@pytest.mark.slow
def test_centres_of_pressure_in_millimetres(folder):
    forces(folder, lambda _, x: 1e3 * x, r"ground_force_[12]_(p.|m.)")
    text = said(folder, "cop_unit")
    assert "sts.mot" in text and "look like millimetres" in text


@pytest.mark.slow
def test_plates_exchanged(folder):
    edit(folder, "left: 2\n    right: 1", "left: 1\n    right: 2")
    text = said(folder, "plate_sides")
    assert "plates.left and plates.right look exchanged" in text


@pytest.mark.slow
def test_left_and_right_exchanged_in_the_names_of_markers(folder):
    def renamed(name):
        return {"L": "R", "R": "L"}[name[0]] + name[1:]

    for file in ("sts.trc", "static.trc"):
        data = read_trc(folder / file)
        names = tuple(renamed(name) for name in data.names)
        write_trc(folder / file, replace(data, names=names))
    found = failing(folder)
    for name in ("foot_sides", "plate_sides"):
        assert "left and right markers look exchanged" in found[name][0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plates", "told"),
    [("1", "'right'"), ("2", "'left'"), ("[12]", "'left' and 'right'")],
)
def test_plates_whose_fore_aft_force_counts_backwards(folder, plates, told):
    names = rf"ground_force_{plates}_vx"
    forces(folder, lambda _, x: -x, names)
    text = said(folder, "shear_sign")
    assert "sts.mot" in text and f"of plate {told} fits the motion" in text


@pytest.mark.slow
def test_a_plate_with_another_gain_in_the_trial(folder):
    forces(folder, lambda _, x: 1.2 * x, r"ground_force_2_(v|m).")
    found = failing(folder)
    assert "newton" not in found and "mass" not in found
    assert "each plate's gain" in found["mean_weight"][0]


@pytest.mark.slow
def test_plates_that_push_the_person_over(folder):
    forces(folder, lambda _, x: x + 30.0, "ground_force_2_vz")
    assert "-30 N sideways on average" in said(folder, "mean_sideways")


@pytest.mark.slow
@pytest.mark.parametrize(("up_m", "word"), [(0.03, "higher"), (-0.03, "lower")])
def test_a_floor_that_is_not_that_of_standing(folder, up_m, word):
    markers(folder, lambda d: d.positions + np.array([0.0, up_m, 0.0]))
    text = said(folder, "floor")
    assert f"left foot are 30 mm {word} than in standing" in text


@pytest.mark.slow
def test_a_marker_that_is_off_for_three_frames(folder):
    def change(data):
        points = data.positions.copy()
        points[180:183, data.names.index("L_meta")] += [0.11, 0.0, 0.0]
        return points

    markers(folder, change)
    assert "'L_meta' leaps at 1.8" in said(folder, "marker_leap")


@pytest.mark.slow
def test_a_marker_that_was_filled_with_its_last_place(folder):
    def change(data):
        points = data.positions.copy()
        i = data.names.index("L_th1")
        points[160:200, i] = points[160, i]
        return points

    markers(folder, change)
    text = said(folder, "marker_frozen")
    assert "'L_th1' stays in exactly one place from 1.6 s on" in text


@pytest.mark.slow
def test_a_height_that_is_another_persons(folder):
    """Told, not refused: people's legs differ."""
    edit(folder, "height_m: 1.7", "height_m: 1.4")
    checks = read_study(folder / "study.yaml").plausibility()
    (check,) = [c for c in checks if c.name == "plausibility.stature"]
    assert check.level == "note" and "check the height" in check.sentence


@pytest.mark.slow
def test_a_mass_that_plates_do_not_show(folder):
    edit(folder, "mass_kg: 70.0", "mass_kg: 84.0")
    text = said(folder, "mass")
    assert "the plates bear 70 kg" in text and "mass_kg says 84 kg" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("newtons", "unit"), [(4.448, "lbf"), (9.81, "kgf"), (10.0, "daN")]
)
def test_forces_in_another_unit(folder, newtons, unit):
    forces(folder, lambda _, x: x / newtons, r"ground_force_\d_(v|m).")
    text = said(folder, "newton")
    assert "forces look like" in text and unit in text


@pytest.mark.slow
def test_standing_in_another_unit(folder):
    names = r"ground_force_\d_(v|m)."
    forces(folder, lambda _, x: x / 4.448, names, "static.mot")
    assert "forces look like lbf: export newtons" in said(folder, "mass")


@pytest.mark.slow
def test_forces_that_end_in_the_middle_of_the_rise(folder):
    table = read_table(folder / "sts.mot")
    rows = table.time <= 1.9
    table = replace(table, time=table.time[rows], values=table.values[rows])
    write_table(folder / "sts.mot", table)
    text = said(folder, "end")
    assert "the recording ends at 1.9 s while the hips move" in text


@pytest.mark.slow
def test_a_recording_that_starts_in_the_middle_of_the_rise(folder):
    table = read_table(folder / "sts.mot")
    rows = table.time >= 1.6
    table = replace(table, time=table.time[rows], values=table.values[rows])
    write_table(folder / "sts.mot", table)
    edit(folder, "seated_s: 0.8\n", "end_s: 2.6\n")
    edit(folder, "rise: 1\n", "start_s: 1.6\n")
    text = said(folder, "end")
    assert "the recording starts at 1.6 s while the hips move" in text


@pytest.mark.slow
def test_a_chair_that_is_a_filler(folder):
    forces(
        folder,
        lambda t, x: np.where(t > 4.0, 565.0, 0.0),
        "ground_force_3_vy",
    )
    forces(folder, lambda _, x: 0.0 * x, "ground_force_3_mz")
    text = said(folder, "flat_channel")
    assert "plate 'chair' stays at exactly 565 N" in text
    assert "chair" in failing(folder)


@pytest.mark.slow
def test_a_plate_that_is_cut_off(folder):
    forces(
        folder, lambda _, x: np.minimum(x, 0.9 * x.max()), "ground_force_2_vy"
    )
    text = said(folder, "saturated_channel")
    assert "plate 'left' is cut off at" in text


@pytest.mark.slow
def test_one_leg_bears_most(folder):
    forces(folder, lambda _, x: 0.26 / 0.4 * x, "ground_force_1_[vm].")
    forces(folder, lambda _, x: 0.74 / 0.6 * x, "ground_force_2_[vm].")
    assert "the left leg bears 74 %" in said(folder, "leg_share")


@pytest.mark.slow
def test_feet_apart(folder):
    def apart(data):
        p = data.positions.copy()
        for i, name in enumerate(data.names):
            if name[2:] not in ("asis", "psis"):
                p[:, i, 0] += 0.0725 if name.startswith("L") else -0.0725
        return p

    markers(folder, apart)
    assert "apart fore and aft" in said(folder, "feet_apart")


@pytest.mark.slow
def test_legs_that_move_in_turn(folder):
    """Walking is no movement of one leg."""

    def swung(data):
        p = data.positions.copy()
        hip = p[:, data.names.index("L_hip")].copy()
        turn = np.exp(1j * np.deg2rad(30.0))
        for i, name in enumerate(data.names):
            if name.startswith("L_") and name[2:] not in ("asis", "psis"):
                x, y = (p[:, i] - hip)[:, :2].T
                z = (x + 1j * y) * turn
                p[:, i, 0], p[:, i, 1] = hip[:, 0] + z.real, hip[:, 1] + z.imag
        return p

    markers(folder, swung)
    text = said(folder, "leg_angles")
    assert "may be walking" in text

    def lifted(t, x):
        return np.where((t > 1.5) & (t < 1.7), 0.0, x)

    forces(folder, lifted, "ground_force_1_[vm].")
    assert "in the air" in said(folder, "lifted_foot")


def refused(folder):
    with pytest.raises(InputError) as caught:
        read_study(folder / "study.yaml").plausibility()
    return str(caught.value)


@pytest.mark.slow
def test_forces_in_kilonewtons_end_with_a_sentence(folder):
    forces(folder, lambda _, x: 1e-3 * x, r"ground_force_\d_(v|m).")
    text = refused(folder)
    assert "sts.mot: the feet bear 0." in text and "not kN" in text
    assert "laboratory.force_axes" in text
    forces(
        folder, lambda _, x: 1e-3 * x, r"ground_force_\d_(v|m).", "static.mot"
    )
    assert "static.mot: the feet bear 0." in refused(folder)


@pytest.mark.slow
def test_plates_that_bear_nothing_end_with_a_sentence(folder):
    old = "forces: static.mot\n  plates:\n    left: 2\n    right: 1\n"
    edit(folder, old, "forces: static.mot\n  plates: {both: 3}\n")
    assert "static.mot: the feet bear 0 N at most (in standing)" in refused(
        folder
    )


@pytest.mark.slow
def test_the_command_ends_with_3_unless_it_is_accepted(folder, capsys):
    study = str(folder / "study.yaml")
    encoders(folder, lambda x: x + np.deg2rad(15.0) * np.eye(3)[2])
    assert main(["check", study]) == 3
    text = capsys.readouterr().out
    assert "FAILS  plausibility.encoder_offset (rise1, 15 deg" in text
    accept = "plausibility.encoder_offset"
    assert f"--accept {accept}" in text
    out = folder / "out"
    again = ["check", study, "--accept", accept, "--out", str(out)]
    assert main(again) == 0
    told = json.loads((out / "quality.json").read_text())
    assert told["accepted"] == [accept]
    assert told["verdict"] == "does not hold"
    summary = json.loads((out / "summary.json").read_text())
    assert summary["subject"] == "nobody"
    for key in ("checks", "verdict", "accepted"):
        assert summary[key] == told[key]
    assert unmarked(out) == [] and list(out.glob("*.png"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [["calibrate", "--phase", "foot-ground"], ["sensitivity"]]
)
def test_nothing_is_solved_with_input_that_cannot_be(folder, capsys, command):
    edit(folder, "left: 2\n    right: 1", "left: 1\n    right: 2")
    out = folder / "out"
    study = str(folder / "study.yaml")
    assert main([*command, study, "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "recordings are not plausible" in message
    assert "plausibility.plate_sides (rise1)" in message
    assert "--accept plausibility.plate_sides" in message
    assert not out.exists()


@pytest.mark.slow
def test_in_python_nothing_is_solved_without_a_warning(folder, monkeypatch):
    """Once, unless somebody has looked."""
    edit(folder, "left: 2\n    right: 1", "left: 1\n    right: 2")
    edit(folder, "name: rise1", "name: rise1\n  use: prediction")
    made = read_study(folder / "study.yaml")
    (trial,), contact = made.trials(), nominal_contact(made.model)
    for name in ("solve", "_prediction"):
        monkeypatch.setattr(f"drake_exo.study.{name}", lambda *_: None)
    monkeypatch.setattr("drake_exo.study.settle", lambda *_: (None, []))
    # Nothing is solved: a calibration of nothing.
    monkeypatch.setattr(dx.Calibration, "__post_init__", lambda self: None)
    monkeypatch.setattr("drake_exo.designing.movements", None)

    def design():
        with pytest.raises(TypeError):
            dx.design(made, contact)

    for solve in (
        lambda: dx.calibrate_foot_ground(made, [trial]),
        lambda: dx.calibrate_interaction(made, [trial], contact),
        lambda: dx.predict(made, trial, contact),
        design,
    ):
        made._judged.clear()
        said = r"plate_sides \(rise1\).*gate\(accepted=\['plausibility.plate"
        with pytest.warns(UserWarning, match=said) as told:
            solve()
        assert told[0].filename == __file__
        solve()
    made._judged.clear()
    made.gate(accepted=["plausibility"])
    solve()


@pytest.mark.slow
def test_a_device_that_nobody_measured_ends_before_anything_is_solved(
    folder, capsys
):
    """`model` left out means a device; here there is none.

    Whatever else does not fit then follows from that.
    """
    path = folder / "study.yaml"
    assert "device_worn" not in failing(folder)
    text = path.read_text()
    text = text[: text.index("device:")].replace("  encoders: exo.csv\n", "")
    path.write_text(text.replace("model: coupled\n", ""))
    edit(folder, "mass_kg: 70.0", "mass_kg: 84.0")
    out = folder / "out"
    assert main(["calibrate", str(path), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "nothing of the exoskeleton was measured" in message
    assert "say 'model: human'" in message and not out.exists()
    told = failing(folder)
    assert "or say 'model: human' if no device was worn" in told["mass"][0]
    edit(folder, "mass_kg: 84.0", "mass_kg: 70.0")
    assert main(["check", str(path)]) == 0
    told = capsys.readouterr().out
    assert "device_worn (rise1, 0 trials, limit 1 trials)" in told  # of these
    assert "nothing of the device was measured (encoders, exo_moments" in told
    assert "say 'model: human' if none was worn" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda w: w.scaled(0.5), "newton"),
        (lambda w: w.scaled(-1.0), "newton"),
        (lambda w: w.shifted(0.3), "euler"),
    ],
)
def test_trials_made_in_python_keep_newton_s_and_euler_s_law(change, name):
    model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    made = Study(model, [trial])
    newton, euler = made.gate()
    assert newton.value < 2.0 and euler.value < 1.0
    wrong = replace(trial, ground=change(trial.ground))
    made = Study(model, [wrong])
    with pytest.raises(InputError, match=rf"{name} \(rise1\): .*law misses"):
        made.gate()
    made = Study(model, [wrong])
    with pytest.warns(UserWarning, match=rf"{name} \(rise1\)"):
        made.warn_of([wrong])
    made.warn_of([wrong])  # once
    # What cannot be judged is refused elsewhere.
    q = np.full_like(trial.q, np.nan)
    assert Study(model, [replace(trial, q=q)]).gate() == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["opencap_sts1", "opencap_predict", "boxlifting_squat"]
)
def test_real_studies_raise_no_alarm(data_root, request, name):
    study = request.path.parents[1] / "studies" / f"{name}.yaml"
    checks = read_study(study, data_root).plausibility()
    assert [c for c in checks if not c.holds] == []


@pytest.mark.slow
def test_walking_is_no_rise(data_root, request, tmp_path):
    study = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    text = study.read_text()
    start = text.index("trials:")
    walk = """trials:
  - name: walk
    markers: opencap_subject4/MarkerData/walking1.trc
    forces: opencap_subject4/ID/walking1_grf.mot
    plates: {left: 2, right: 1}
    start_s: 0.3
    end_s: 1.0
"""
    path = tmp_path / "study.yaml"
    rest = text[text.index("foot_ground:") :]
    path.write_text(text[:start] + walk + rest)
    checks = read_study(path, data_root).plausibility()
    failed = {c.name for c in checks if not c.holds}
    assert "plausibility.leg_angles" in failed
    assert "plausibility.lifted_foot" in failed
    # As the sit-to-stand that it is taken for.
    path.write_text(
        path.read_text().replace("start_s: 0.3\n    end_s: 1.0", "rise: 1")
    )
    with pytest.raises(InputError, match="0 were found"):
        read_study(path, data_root).trials()
