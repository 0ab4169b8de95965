"""Walking on a belt, told as over ground that rests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.opensim import (
    read_plates,
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.measurement.events import event_s
from drake_exo.measurement.recording import FootForces
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import Ground
from drake_exo.study import RecordedStudy, read_study


@pytest.fixture(scope="module")
def walk(data_root):
    path = Path(__file__).parents[1] / "studies" / "treadmill_walk.yaml"
    return read_study(path, data_root)


def stance(trial, side):
    """Frames in which a foot bears the body, flat."""
    return trial.feet[side].force_z > 500.0


@pytest.mark.slow
def test_a_foot_that_bears_the_body_rests(walk):
    (trial,), tree = walk.trials(), walk.model.tree
    ahead = trial.coordinate("pelvis_x")
    speed = (ahead[-1] - ahead[0]) / trial.duration
    assert speed == pytest.approx(1.24, abs=0.05)
    for side in ("left", "right"):
        place = tree.point_positions(trial.q, f"foot_{side}", (0.0, 0.0))
        bears = stance(trial, side)
        moved = np.gradient(place[:, 0], trial.times)[bears]
        assert abs(np.median(moved)) < 0.03
        # The centre of pressure is under it, however far it has come.
        ahead = (trial.feet[side].cop_x - place[:, 0])[bears]
        assert -0.08 < ahead.min() < ahead.max() < 0.2
        # Four contacts each.
        starts = np.diff(bears.astype(int)) == 1
        assert starts.sum() + bears[0] >= 4


def part(walk, **window):
    """The walk from one event to another, as the study's trial."""
    (files,) = walk.file.trials
    files = replace(files, start_s=None, end_s=None, **window)
    return RecordedStudy(replace(walk.file, trials=(files,)), walk.root)


@pytest.mark.slow
def test_a_part_starts_and_ends_with_events(walk, data_root):
    """As the plates' own files say, sample by sample."""
    path = data_root / "treadmill_walk" / "walk2_grf.mot"
    time, plates = read_plates(path)
    on = {n: p.force[:, 1] >= 20.0 for n, p in plates.items()}
    strikes = time[1:][np.diff(on[1].astype(int)) == 1]
    lifts = time[:-1][np.diff(on[2].astype(int)) == -1]
    assert len(strikes) == 5 and len(lifts) == 5
    study = part(walk, begin="toe_off right 1", end="heel_strike left 4")
    (trial,) = study.trials()
    frame = 0.01
    assert 0.0 <= trial.start_s - lifts[0] < frame
    assert 0.0 <= strikes[3] - (trial.start_s + trial.duration) < frame
    said = trial.provenance["part"]
    assert said["start"] == {"event": "toe_off right 1", "time_s": lifts[0]}
    assert said["end"]["time_s"] == strikes[3]
    # The right foot stands when the recording begins: no heel strike of it.
    (trial,) = part(walk, begin="heel_strike right 1").trials()
    assert trial.start_s > lifts[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "window, sentence",
    [
        (
            {"begin": "heel_strike left 6"},
            "from: heel_strike left 6: the recording has 5 heel_strike of the "
            "left foot at 0.64 s, 1.74 s, 2.85 s, 3.96 s, 5.06 s; name",
        ),
        (
            {"begin": "toe_off left 2", "end": "heel_strike left 1"},
            "ends at 0.64 s, not after it starts .2.447 s",
        ),
    ],
)
def test_an_event_that_is_not_there_is_named(walk, window, sentence):
    with pytest.raises(InputError, match=sentence):
        part(walk, **window).trials()


@pytest.mark.parametrize(
    "text, sentence",
    [
        (
            "from: heel_strike both 1",
            "from: 'heel_strike both 1' is not an event",
        ),
        ("from: heel_strike left", "as in 'heel_strike right 1'"),
        ("to: toe_off left 0", "which from 1"),
        ("to: toe_off left 1 2", "to: 'toe_off left 1 2' is not an event"),
        ("from: toe_off left 1", "from and start_s both say where"),
        ("to: toe_off left 1", "to and end_s both say where"),
    ],
)
def test_words_that_say_no_event_are_refused(tmp_path, text, sentence):
    study = Path(__file__).parents[1] / "studies" / "treadmill_walk.yaml"
    written = study.read_text("utf-8").replace(
        "    end_s: 5.02", f"    {text}\n    end_s: 5.02"
    )
    path = tmp_path / "study.yaml"
    path.write_text(written, "utf-8")
    with pytest.raises(InputError, match=sentence):
        read_study(path)


def test_a_foot_without_a_plate_of_its_own_has_no_events():
    event = "toe_off left 1"
    with pytest.raises(InputError, match="no plate is the left foot's alone"):
        event_s(event, {"right": []})
    with pytest.raises(InputError, match="of the left foot; give a time"):
        event_s(event, {"left": []})


@pytest.mark.slow
def test_a_belt_that_is_not_declared_is_named(walk):
    still = RecordedStudy(replace(walk.file, ground=Ground()), walk.root)
    (found,) = (c for c in still.plausibility() if c.name.endswith("belt"))
    assert not found.holds
    assert "treadmill; say 'ground: {belt_speed_m_s: 1.23}'" in found.sentence
    with pytest.raises(InputError, match="as on a treadmill"):
        still.gate()
    (found,) = (c for c in walk.plausibility() if c.name.endswith("belt"))
    assert found.holds


def test_forces_are_carried_with_the_belt():
    time = np.array([0.0, 1.0, 2.0])
    plate = np.array([[5.0, 7.0, 100.0, 1.0, -30.0, 2.0]] * 3)
    wrench = PlanarWrench(plate[:, [0, 2]], plate[:, 4])
    forces = FootForces(time, {"left": wrench}, "", recorded={"left": plate})
    moved = forces.on_belt(1.5)
    np.testing.assert_allclose(moved.wrenches["left"].cop_x, 0.3 + 1.5 * time)
    r = np.column_stack([1.5 * time, 0.0 * time, 0.0 * time])
    np.testing.assert_allclose(
        moved.recorded["left"][:, 3:],
        plate[:, 3:] + np.cross(r, plate[:, :3]),
    )
    np.testing.assert_array_equal(moved.recorded["left"][:, :3], plate[:, :3])


def test_centres_of_pressure_are_held_at_small_forces():
    F_z = np.array([5.0, 50.0, 200.0, 300.0, 60.0, 5.0, 30.0, 400.0])
    x = np.array([0.0, 0.4, 1.0, 1.1, 0.7, 0.0, 0.5, 2.0])
    wrench = PlanarWrench(np.column_stack([0.0 * F_z, F_z]), -x * F_z)
    held = wrench.held(100.0)
    found = -held.moment / F_z
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, 1.1, 1.1, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(held.force, wrench.force)
    np.testing.assert_array_equal(wrench.held(0.0).moment, wrench.moment)
    np.testing.assert_array_equal(wrench.held(1e3).moment, wrench.moment)


def test_a_part_of_a_recording_counts_its_own_frames(tmp_path, data_root):
    """Its header tells the frames of the whole, its rows begin later."""
    whole = data_root / "treadmill_walk" / "walk2.trc"
    assert len(read_trc(whole).time) == 536
    lines = whole.read_text("utf-8").splitlines(keepends=True)
    path = tmp_path / "part.trc"
    # One frame more than the header has room for.
    path.write_text("".join(lines).replace("\t579\t", "\t557\t"), "utf-8")
    with pytest.raises(InputError, match="NumFrames=557"):
        read_trc(path)


@pytest.mark.slow
def test_standing_may_face_another_way(walk):
    standing = replace(walk.file.standing, marker_axes=None)
    study = RecordedStudy(replace(walk.file, standing=standing), walk.root)
    lengths = walk.subject.markers.lengths_m
    assert lengths["thigh"] == pytest.approx(0.44, abs=0.03)
    toe = walk.subject.markers.names.index("RTOE")
    ahead = walk.subject.markers.levers[toe].sum().real
    assert ahead > 0.1
    turned = study.subject.markers.levers[toe].sum().real
    assert abs(turned) < 0.1


@pytest.mark.slow
def test_a_trial_starts_here_however_long_the_belt_has_run(walk, tmp_path):
    """The same files, 5 minutes later on the clock of a long recording."""
    (files,), late = walk.file.trials, 300.0
    seen = read_trc(walk.root / files.markers)
    forces = read_table(walk.root / files.forces)
    write_trc(tmp_path / "m.trc", replace(seen, time=seen.time + late))
    path = tmp_path / "f.mot"
    write_table(path, replace(forces, time=forces.time + late), digits=17)
    files = replace(
        files,
        markers=tmp_path / "m.trc",
        forces=path,
        start_s=files.start_s + late,
        end_s=files.end_s + late,
    )
    study = RecordedStudy(replace(walk.file, trials=(files,)), walk.root)
    (trial,), (usual,) = study.trials(), walk.trials()
    np.testing.assert_allclose(trial.q, usual.q, atol=1e-6)
    for side, wrench in usual.feet.items():
        found = trial.feet[side].array
        np.testing.assert_allclose(found, wrench.array, atol=1e-3)
    assert all(check.holds for check in study.plausibility())
