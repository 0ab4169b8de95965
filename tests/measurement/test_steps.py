"""One step out of a recording: known ones come back, bad ones are named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import (
    read_plates,
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.events import Contact
from drake_exo.measurement.filters import minimum_jerk
from drake_exo.measurement.sagittal import Axes
from drake_exo.measurement.steps import (
    _at_frames,
    _chosen,
    _cop,
    _ends,
    _flat,
    nearest_rotations,
    recorded_step,
)
from drake_exo.soles.numerics import rotation_z, rotations_xyz
from drake_exo.study import StudyFile, read_study

STUDY = """
subject: {name: somebody, height_m: 1.7, mass_kg: 60.0}
model: {human: {legs: two, toes: hinged}}
standing: {markers: standing.trc}
laboratory: {force_delay_s: 0.02}
filter: {cutoff_hz: 20.0}
markers:
  joint_centres:
    ankle: {left: [LA], right: [LA]}
    knee: {left: [LA], right: [LA]}
    hip: {left: [LA], right: [LA]}
  segments:
    foot: {left: [heel, side, LA], right: [heel, side, LA]}
    toes: {left: [toe], right: [toe]}
    shank: {left: [LA], right: [LA]}
    thigh: {left: [LA], right: [LA]}
    pelvis: {left: [LA], right: [LA]}
trials:
  - {name: walk, markers: walk.trc, forces: walk.mot, plates: {left: [1, 2], right: 3}}
"""  # noqa: E501
NAMES = ("heel", "side", "LA", "toe")
# In the foot's frame, as it stands: forward, left, up [m].
FOOT = np.array(
    [[-0.11, 0.0, 0.05], [0.06, 0.05, 0.04], [-0.05, 0.04, 0.1],
     [0.11, 0.0, 0.05]]
)  # fmt: skip
PLACE, YAW, SURFACE = np.array([1.3, 0.2]), 0.15, 0.006
TIME = np.arange(0.0, 1.2, 0.01)
ON, OFF = 0.3, 0.9


def _pose(t):
    """Roll, pitch and yaw: heel first, flat for long, then over the toes."""
    early = -0.3 * (1 - minimum_jerk((t - 0.2) / 0.25)[0])
    late = 0.6 * minimum_jerk((t - 0.75) / 0.3)[0]
    return np.stack([0 * t, early + late, 0 * t], axis=1)


def _opensim(points):
    """Forward, left, up -> x, y up, z right."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def _write(folder, belt=0.0, second=None, start=ON, end=OFF):
    """A study of one step; the second plate takes over from a time on."""
    turn = rotation_z(YAW) @ rotations_xyz(_pose(TIME))
    path = np.r_[PLACE, 0.0] + np.outer(TIME - 0.6, [belt, 0.0, 0.0])
    feet = np.einsum("nij,kj->nki", turn, FOOT) + path[:, None]
    write_trc(
        folder / "walk.trc",
        MarkerData(TIME, NAMES, _opensim(feet), 100.0),
    )
    still = np.repeat(_opensim(FOOT)[None], 60, axis=0)
    write_trc(
        folder / "standing.trc",
        MarkerData(0.01 * np.arange(60), NAMES, still, 100.0),
    )
    t = np.arange(0.0, 1.2, 0.001)
    moment, x, y = _truth(t)
    loaded = (t >= start) & (t <= end)
    rows = np.zeros((3, len(t), 9))
    force = rotation_z(YAW) @ np.stack([0 * t + 30.0, 0 * t, 0 * t + 500.0])
    cop = rotation_z(YAW)[:2, :2] @ np.stack([x, y])
    place = np.stack([*(cop + PLACE[:, None]), 0 * t + SURFACE])
    place[0] += belt * (t - 0.6)
    which = np.zeros(len(t), int) if second is None else (t >= second) * 1
    for plate in range(2):
        here = loaded & (which == plate)
        for part, values in ((0, force), (3, place)):
            values = _opensim(values.T) * here[:, None]
            rows[plate, :, part : part + 3] = values
        rows[plate, :, 7] = moment * here
    columns = ["time"] + [
        f"ground_force_{p}_{k}{a}" for p in (1, 2, 3) for k in "vpm"
        for a in "xyz"
    ]  # fmt: skip
    lag = 0.02
    body = np.column_stack([t + lag, *rows.transpose(0, 2, 1).reshape(27, -1)])
    text = "\n".join("\t".join(f"{v:.9g}" for v in row) for row in body)
    (folder / "walk.mot").write_text(
        f"walk\nnRows={len(t)}\nnColumns=28\nendheader\n"
        + "\t".join(columns) + f"\n{text}\n"
    )  # fmt: skip
    (folder / "study.yaml").write_text(STUDY)
    return schema.load(folder / "study.yaml", StudyFile)


def _truth(t):
    """Free moment and centre of pressure in the foot's frame."""
    s = np.clip((t - ON) / (OFF - ON), 0, 1)
    return 2.0 * np.sin(np.pi * s), -0.1 + 0.2 * s, 0.01 * np.sin(np.pi * s)


@pytest.mark.parametrize("belt", [0.0, -1.2])
def test_a_known_step_comes_back(tmp_path, belt):
    study = _write(tmp_path, belt)
    _is_known(recorded_step(study, tmp_path, "walk", "left"), belt)


def test_a_known_step_comes_back_from_a_walk_across_the_laboratory(tmp_path):
    """Walked along +z of files whose x is to the left."""
    study = _write(tmp_path)
    data = read_trc(tmp_path / "walk.trc")
    turned = data.positions[..., [2, 1, 0]] * [-1.0, 1.0, 1.0]
    write_trc(tmp_path / "walk.trc", replace(data, positions=turned))
    forces = read_table(tmp_path / "walk.mot")
    values = forces.values.reshape(len(forces.values), -1, 3)
    values = values[..., [2, 1, 0]] * [-1.0, 1.0, 1.0]
    values = values.reshape(forces.values.shape)
    write_table(tmp_path / "walk.mot", replace(forces, values=values))
    axes = Axes("x", "y", -90.0)
    trials = tuple(replace(t, marker_axes=axes) for t in study.trials)
    study = replace(study, trials=trials)
    _is_known(recorded_step(study, tmp_path, "walk", "left"))


def _is_known(step, belt=0.0):
    inside = (step.times > ON + 0.006) & (step.times < OFF - 0.006)
    assert step.times[0] == pytest.approx(ON)
    assert step.times[-1] == pytest.approx(OFF)
    assert step.yaw == pytest.approx(YAW, abs=1e-8)
    np.testing.assert_allclose(step.belt, [belt, 0.0], atol=1e-7)
    moment, x, y = _truth(step.times)
    np.testing.assert_allclose(
        step.force[inside], [[30.0, 0.0, 500.0]] * inside.sum(), atol=1e-3
    )
    np.testing.assert_allclose(step.cop[inside, 0], x[inside], atol=5e-8)
    np.testing.assert_allclose(step.cop[inside, 1], y[inside], atol=5e-6)
    np.testing.assert_allclose(
        step.free_moment[inside], moment[inside], atol=1e-3
    )
    wanted = rotations_xyz(_pose(step.times))
    np.testing.assert_allclose(step.rotation, wanted, atol=3e-4)
    if not belt:
        np.testing.assert_allclose(step.place, PLACE, atol=1e-4)


def test_a_step_is_its_own_plates_alone(tmp_path):
    """The foot's other plate is off by 10 N, higher, and bears more later."""
    study = _write(tmp_path)
    alone = recorded_step(study, tmp_path, "walk", "left")
    head, mark, body = (tmp_path / "walk.mot").read_text().partition("header\n")
    names, *lines = body.strip().split("\n")
    values = np.array([[float(v) for v in x.split("\t")] for x in lines])
    first = names.split("\t").index("ground_force_2_vy")
    values[:, first] = np.where(values[:, 0] > 1.1, 900.0, 10.0)
    values[:, first + 2 : first + 5] = 3.0, 0.4, 1.0
    body = "\n".join("\t".join(f"{v:.9g}" for v in row) for row in values)
    (tmp_path / "walk.mot").write_text(f"{head}{mark}{names}\n{body}\n")
    step = recorded_step(study, tmp_path, "walk", "left")
    np.testing.assert_allclose(step.cop, alone.cop, atol=1e-9)
    np.testing.assert_allclose(step.force, alone.force, atol=1e-9)


@pytest.mark.slow
def test_plates_are_levelled_as_the_study_says(tmp_path):
    """Amplifiers that drift by 12 N would hold the foot down past its step."""
    study = _write(tmp_path, start=0.42, end=0.78)
    text = (tmp_path / "walk.mot").read_text()
    head, _, body = text.partition("nColumns=28\nendheader\n")
    names, *lines = body.strip().split("\n")
    values = np.array([[float(v) for v in x.split("\t")] for x in lines])
    first = names.split("\t").index("ground_force_1_vy")
    values[:, first] += 12.0 + 4.0 * values[:, 0]
    body = "\n".join("\t".join(f"{v:.9g}" for v in row) for row in values)
    (tmp_path / "walk.mot").write_text(
        f"{head}nColumns=28\nendheader\n{names}\n{body}\n"
    )

    def vertical(settings):
        step = recorded_step(settings, tmp_path, "walk", "left")
        inside = (step.times > 0.45) & (step.times < 0.75)
        return step.force[inside, 2]

    assert vertical(study).min() > 510.0
    lab = replace(study.laboratory, remove_plate_drift=True)
    levelled = replace(study, laboratory=lab)
    np.testing.assert_allclose(vertical(levelled), 500.0)
    # The same plates with nothing on them.
    values[:, 1:] = 0.0
    values[:, first] = 14.0
    body = "\n".join("\t".join(f"{v:.9g}" for v in row) for row in values)
    (tmp_path / "empty.mot").write_text(
        f"{head}nColumns=28\nendheader\n{names}\n{body}\n"
    )
    files = replace(study.trials[0], empty_plates=Path("empty.mot"))
    emptied = replace(study, trials=(files, *study.trials[1:]))
    found = vertical(emptied)
    np.testing.assert_allclose(found, vertical(study) - 14.0, atol=1e-6)
    # Somebody stands on them.
    values[:, first] = 300.0
    body = "\n".join("\t".join(f"{v:.9g}" for v in row) for row in values)
    (tmp_path / "stood.mot").write_text(
        f"{head}nColumns=28\nendheader\n{names}\n{body}\n"
    )
    loaded = replace(files, empty_plates=Path("stood.mot"))
    with pytest.raises(InputError, match=r"empty_plates bear \d+ N; name"):
        vertical(replace(study, trials=(loaded, *study.trials[1:])))
    object.__setattr__(study, "markers", None)
    with pytest.raises(InputError, match=r"give them as markers\.segments"):
        vertical(study)


def test_part_of_a_step_by_its_times(tmp_path):
    study = _write(tmp_path)
    step = recorded_step(study, tmp_path, "walk", "left", 0.5, 0.7)
    assert step.times[[0, -1]] == pytest.approx([0.5, 0.7])
    # However a time is rounded, the frame at it belongs to the part.
    start, end = np.nextafter(0.5, 1.0), np.nextafter(0.7, 0.0)
    inner = recorded_step(study, tmp_path, "walk", "left", start, end)
    np.testing.assert_array_equal(inner.times, step.times)
    again = read_study(tmp_path / "study.yaml").step("walk", "left", 0.5, 0.7)
    np.testing.assert_array_equal(again.cop, step.cop)


@pytest.mark.parametrize(
    ("start", "end", "number", "chosen"),
    [
        ("heel_strike", 2.2, 0, 1),
        (1.8, "toe_off", 0, 1),
        (2.3, "toe_off", 0, 2),
        (0.4, 0.5, 0, 0),
        ("heel_strike", "toe_off", 2, 2),
        (0.4, "toe_off", 1, None),
        (0.8, 2.0, 0, None),
    ],
)
def test_a_part_is_of_one_contact(start, end, number, chosen):
    """The foot is in the air between two: no step goes on there."""
    times = (0.3, 1.0), (1.7, 2.25), (2.7, 3.3)
    every = [Contact(*at, True, True) for at in times]
    if chosen is None:
        with pytest.raises(InputError, match="times within one of them"):
            _chosen(every, start, end, number, "walk", 20.0)
    else:
        found = _chosen(every, start, end, number, "walk", 20.0)
        assert found is every[chosen]


BAD = {
    "no second step": (
        {}, ("walk", "left", "heel_strike", "toe_off", 1),
        "no step 1 .* 0.30 to 0.90 s",
    ),
    "cut at the start": (
        {"start": -1.0}, ("walk", "left"), "recording begins within it",
    ),
    "faded out at the end": (
        {"end": 1.19}, ("walk", "left"), "recording ends within it",
    ),
    "cut at the end": (
        {"end": 9.0}, ("walk", "left"), "recording ends within it",
    ),
    "on two plates": (
        {"second": 0.5}, ("walk", "left"), "plates 1 and 2 .from 0.50 s on",
    ),
    "no such trial": ({}, ("run", "left"), "none of the study's .walk."),
    "never loaded": (
        {}, ("walk", "right"),
        r"contacts found: none, of 20 N or more \(least_force_n\)",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_step_that_cannot_be_used_is_named(tmp_path, name):
    kinds, which, sentence = BAD[name]
    study = _write(tmp_path, **kinds)
    with pytest.raises(InputError, match=sentence):
        recorded_step(study, tmp_path, *which)


@pytest.mark.slow
def test_a_treadmill_s_steps_go_along_with_its_belt(data_root, tmp_path):
    """Four whole steps, much alike; the fifth is cut off."""
    folder = tmp_path / "treadmill_walk"
    folder.mkdir()
    for name in ("walk2.trc", "walk2_grf.mot", "static.trc"):
        text = (data_root / "treadmill_walk" / name).read_text()
        # The header announces more frames than there are.
        text = text.replace("100\t100\t579\t", "100\t100\t536\t")
        (folder / name).write_text(text)
    file = Path(__file__).parents[1] / "studies" / "treadmill_walking.yaml"
    study = read_study(file, tmp_path)
    steps = [
        study.step("walk2", "left", number=n, least_force_n=150.0)
        for n in range(4)
    ]
    for step in steps:
        # 1.24 m/s by the description of the data.
        np.testing.assert_allclose(step.belt, [-1.24, 0.0], atol=0.02)
        assert 0.6 < step.times[-1] - step.times[0] < 0.7
        assert -0.13 < step.cop[0, 0] < -0.05 < 0.15 < step.cop[-1, 0] < 0.2
        assert np.abs(step.cop[:, 1]).max() < 0.045
    with pytest.raises(InputError, match="ends within it"):
        study.step("walk2", "left", number=4, least_force_n=150.0)


def test_nearest_rotations_are_those_of_a_rigid_motion():
    rng = np.random.default_rng(0)
    R = rotations_xyz(rng.uniform(-1, 1, (5, 3)))
    moved = FOOT @ np.swapaxes(R, 1, 2) + rng.standard_normal((5, 1, 3))
    np.testing.assert_allclose(nearest_rotations(FOOT, moved), R, atol=1e-12)


@pytest.mark.parametrize(
    ("trial", "start", "end"),
    [("walking1", 0.53, 1.19), ("walking4", 0.57, 1.25)],
)
def test_steps_of_a_recorded_walk(data_root, trial, start, end):
    """Against the plate's own columns, and how people walk."""
    file = Path(__file__).parents[1] / "studies" / "opencap_walking.yaml"
    step = read_study(file, data_root).step(trial, "left")
    assert step.times[[0, -1]] == pytest.approx([start, end])
    path = data_root / "opencap_subject4" / "ID" / f"{trial}_grf.mot"
    time, plates = read_plates(path)
    plate = plates[2]
    lag = 0.01  # of the plates
    rows = np.searchsorted(time, step.times + lag - 1e-6)
    np.testing.assert_allclose(step.force[:, 2], plate.force[rows, 1])
    np.testing.assert_allclose(
        step.free_moment, plate.torque[rows, 1], atol=1e-5
    )
    turn = rotation_z(step.yaw)[:2, :2]
    cop = step.cop @ turn.T + step.place
    # The first sample of walking4 acts below the others.
    point = plate.point[rows]
    np.testing.assert_allclose(cop[:, 0], point[:, 0], atol=6e-4)
    np.testing.assert_allclose(cop[1:, 0], point[1:, 0], atol=1e-5)
    np.testing.assert_allclose(cop[1:, 1], -point[1:, 2], atol=1e-5)
    # From heel to toe, toes up at first and down at last.
    assert step.cop[0, 0] < -0.1 and step.cop[-1, 0] > 0.13
    pitch = np.arcsin(step.rotation[:, 0, 2])
    assert pitch[0] < -0.2 and pitch[-1] > 0.7
    assert np.abs(pitch[15:35]).max() < 0.03


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 0, 1], [1, 3, 2, 0]])
def test_a_foot_goes_from_its_rearmost_to_its_foremost_marker(order):
    """Seen from above: one high over the heel does not count."""
    points = np.vstack([FOOT, [[-0.1, 0.0, 0.5]]])[[*order, 4]]
    names = np.array([*NAMES, "high"])[[*order, 4]]
    heel, toe = _ends(points, tuple(names))
    assert (names[heel], names[toe]) == ("heel", "toe")
    _ends(points * [0.5, 0.5, 1.0], tuple(names))
    with pytest.raises(InputError, match=r"lie within 99 mm"):
        _ends(points * [0.45, 0.45, 1.0], tuple(names))


def test_frames_see_the_mean_over_one_of_them():
    """Plates at 1000 Hz, markers at 100 Hz: the 10 ms about the frame."""
    time = np.arange(0.0, 1.0, 0.001)
    ramp = np.column_stack([time, 1.0 - 2.0 * time] + [0.0 * time] * 4)
    pulse = np.zeros((1000, 6))
    pulse[500, 2] = 10.0
    frames = MarkerData(np.arange(0.2, 1.2, 0.01), ("a",), None, 100.0)
    found = _at_frames(time, ramp, frames)
    inner = frames.time < 0.99
    np.testing.assert_allclose(found[inner, 0], frames.time[inner])
    np.testing.assert_allclose(
        found[inner, 1], 1.0 - 2.0 * frames.time[inner], atol=1e-12
    )
    assert not found[frames.time > 1.0].any()
    seen = _at_frames(time, pulse, frames)[:, 2]
    assert seen.sum() == pytest.approx(1.0) and seen.max() <= 1.0 + 1e-12
    # At the markers' own rate nothing is averaged.
    slow = np.arange(0.0, 1.0, 0.01)
    pulse = np.eye(100)[:, [50] * 6]
    alike = _at_frames(slow, pulse, frames)
    assert alike[30, 0] == pytest.approx(1.0)


def test_a_wrench_acts_where_its_moment_is_vertical():
    """r × F + T e_z, of a point that is known, at a height."""
    rng = np.random.default_rng(0)
    F = rng.normal(size=(5, 3)) * 100.0 + [0.0, 0.0, 700.0]
    r = np.column_stack([rng.normal(size=(5, 2)), np.full(5, 0.03)])
    T = rng.normal(size=5)
    M = np.cross(r, F) + np.outer(T, [0.0, 0.0, 1.0])
    point, moment = _cop(np.hstack([F, M]), 0.03)
    np.testing.assert_allclose(point, r[:, :2])
    np.testing.assert_allclose(moment, T, atol=1e-9)


def test_a_foot_is_flat_where_it_turns_least():
    """A fifth of the contact's frames, by the fastest of its markers."""
    time = np.arange(100) / 100.0
    angle = np.where(time < 0.5, 0.5 - time, 0.0) ** 2
    points = np.einsum(
        "nij,kj->nki", rotations_xyz(np.outer(angle, [0.0, 1.0, 0.0])), FOOT
    )
    points[75, 1] += 0.02
    stands = (time >= 0.2) & (time < 0.8)
    flat = _flat(
        points + np.outer(time, [1.0, 0.0, 0.0])[:, None], time, stands
    )
    assert len(flat) == 12 and (flat >= 50).all() and (flat < 80).all()
    assert not {74, 76} & set(flat.tolist())
