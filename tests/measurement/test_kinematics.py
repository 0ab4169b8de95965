from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from angles import in_radians
from osim_kinematics import Osim
from synthetic_recording import marker_data, motion, study_text

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import read_table
from drake_exo.measurement import kinematics
from drake_exo.measurement.filters import low_pass
from drake_exo.measurement.kinematics import (
    ankle_paths,
    build_marker_model,
    merge_legs,
    residual_rms,
    residuals,
    solve_poses,
)
from drake_exo.measurement.processing import Recordings
from drake_exo.measurement.sagittal import Axes
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human
from drake_exo.study import StudyFile, read_study

FRAME = Axes()


@pytest.fixture(scope="module")
def human():
    return scale_human(70.0, 1.75)


@pytest.fixture(scope="module")
def tree(human):
    return Model("human", human).tree


@pytest.fixture(scope="module")
def markers(human):
    return schema.load_text(study_text(human), StudyFile).markers


def standing(tree, human):
    q = np.zeros((30, 6))
    q[:, 1] = human.ankle_height_m
    return marker_data(tree, human, np.arange(30) / 100.0, q)


@pytest.fixture(scope="module")
def model(tree, human, markers):
    return build_marker_model(standing(tree, human), markers, FRAME)


def test_plants_own_motion_comes_back(tree, human, model):
    """Signs, frames and zeros are those of the plant."""
    time = np.arange(0.0, 8.0, 0.05)
    q = motion(time, human)
    q[:, 2] = 0.1 * np.sin(time)
    data = marker_data(tree, human, time, q)
    poses = solve_poses(model, FRAME.points(data.of(model.names)))
    found, ankles = merge_legs(model, poses), ankle_paths(model, poses)
    np.testing.assert_allclose(found, q, atol=1e-8)
    np.testing.assert_allclose(ankles["left"], q[:, :2], atol=1e-9)
    assert max(residual_rms(residuals(model, poses)).values()) < 1e-8
    np.testing.assert_allclose(
        np.column_stack([poses.hip.real, poses.hip.imag]),
        tree.point_positions(q, "pelvis", (0.0, 0.0)),
        atol=1e-9,
    )


def test_lengths_are_those_of_the_body(human, model):
    assert model.lengths_m["shank"] == pytest.approx(human.shank.length_m)
    assert model.lengths_m["thigh"] == pytest.approx(human.thigh.length_m)
    assert model.ankle_height_m == pytest.approx(human.ankle_height_m)
    # As they stand: heel, forefoot and ankle, see POINTS.
    z = human.ankle_height_m + np.array([-0.03, -0.04, 0.0])
    np.testing.assert_allclose(model.foot_heights_m("left"), z, atol=1e-9)
    segments = dict(zip(model.segments, model.by_segment(), strict=True))
    assert segments["foot_right"] == ["R_heel", "R_meta", "R_ank"]


@pytest.mark.parametrize(
    ("forward", "up", "order", "signs"),
    [("y", "z", [2, 0, 1], [1, 1, 1]), ("-z", "x", [1, 2, 0], [1, 1, -1])],
)
def test_any_axes_of_the_laboratory(
    tree, human, markers, forward, up, order, signs
):
    def turned(data):
        return replace(data, positions=data.positions[..., order] * signs)

    frame = Axes(forward, up)
    model = build_marker_model(turned(standing(tree, human)), markers, frame)
    time = np.array([0.0, 2.0])
    q = motion(time, human)
    data = turned(marker_data(tree, human, time, q))
    poses = solve_poses(model, frame.points(data.of(model.names)))
    np.testing.assert_allclose(merge_legs(model, poses), q, atol=1e-8)


def test_angles_of_the_legs_are_averaged(tree, human, model):
    time = np.arange(3) / 100.0
    q = np.tile(motion(np.array([0.0]), human), (3, 1))
    bent = q.copy()
    bent[:, 2:5] += [0.04, 0.1, 0.06]
    # Keep the hips together: move the other leg's foot.
    gap = tree.point_positions(q, "pelvis", (0, 0)) - tree.point_positions(
        bent, "pelvis", (0, 0)
    )
    bent[:, :2] += gap
    bent[:, 5] += 0.06 - 0.1 + 0.04  # the pelvis keeps its attitude
    a = marker_data(tree, human, time, q)
    b = marker_data(tree, human, time, bent)
    left = np.array([n.startswith("L_") for n in a.names])
    p = np.where(left[None, :, None], a.positions, b.positions)
    data = replace(a, positions=p)
    poses = solve_poses(model, FRAME.points(data.of(model.names)))
    found, ankles = merge_legs(model, poses), ankle_paths(model, poses)
    np.testing.assert_allclose(found, 0.5 * (q + bent), atol=1e-8)
    np.testing.assert_allclose(ankles["right"], bent[:, :2], atol=1e-9)


def test_one_leg_alone(tree, human, markers):
    segments, centres = markers.segments, markers.joint_centres

    def right_only(group, names):
        return replace(
            group,
            **{n: replace(getattr(group, n), left=()) for n in names},
        )

    single = replace(
        markers,
        segments=right_only(segments, ("foot", "shank", "thigh")),
        joint_centres=right_only(centres, ("ankle", "knee", "hip")),
    )
    model = build_marker_model(standing(tree, human), single, FRAME)
    assert model.sides == ("right",)
    q = motion(np.array([0.0, 2.0]), human)
    data = marker_data(tree, human, np.array([0.0, 2.0]), q)
    poses = solve_poses(model, FRAME.points(data.of(model.names)))
    np.testing.assert_allclose(merge_legs(model, poses), q, atol=1e-8)


def test_a_marker_without_weight_has_no_say(tree, human, markers):
    light = replace(markers, weights={"L_sh1": 0.0})
    model = build_marker_model(standing(tree, human), light, FRAME)
    q = motion(np.array([2.0]), human)
    data = marker_data(tree, human, np.array([2.0]), q)
    data.positions[:, data.names.index("L_sh1"), 0] += 0.1
    poses = solve_poses(model, FRAME.points(data.of(model.names)))
    np.testing.assert_allclose(merge_legs(model, poses), q, atol=1e-8)
    assert residual_rms(residuals(model, poses))["L_sh1"] == pytest.approx(0.1)


def test_the_marker_that_keeps_it_from_converging_is_named(
    tree, human, markers
):
    model = build_marker_model(standing(tree, human), markers, FRAME)
    times = np.linspace(2.0, 2.1, 5)
    data = marker_data(tree, human, times, motion(times, human))
    data.positions[2, data.names.index("L_sh1"), 0] = -999.0
    with pytest.raises(
        InputError,
        match=r"'L_sh1' lies up to 9.* m off .*say where the subject faced",
    ):
        solve_poses(model, FRAME.points(data.of(model.names)))


def refusal(tree, human, markers, frame=FRAME):
    with pytest.raises(InputError) as caught:
        build_marker_model(standing(tree, human), markers, frame)
    return str(caught.value)


@pytest.mark.parametrize(
    ("group", "part"), [("joint_centres", "knee"), ("segments", "thigh")]
)
def test_sides_that_are_exchanged_in_a_part_are_refused(
    tree, human, markers, group, part
):
    """Angles were off by 3 degrees, and no check told."""
    parts = getattr(markers, group)
    own = getattr(parts, part)
    other = replace(own, left=own.right, right=own.left)
    off = replace(markers, **{group: replace(parts, **{part: other})})
    assert f"left and right of markers.{group}.{part}" in refusal(
        tree, human, off
    )


@pytest.mark.parametrize(
    ("group", "part"), [("joint_centres", "hip"), ("segments", "foot")]
)
def test_only_the_pelvis_has_markers_in_the_middle(markers, group, part):
    """Nothing followed those of other parts, and nothing said so."""
    parts = getattr(markers, group)
    own = replace(getattr(parts, part), middle=("SACR",))
    with pytest.raises(InputError, match=f"{part} has markers in the middle"):
        replace(parts, **{part: own})


def test_axes_that_are_not_the_files_are_named(tree, human, markers):
    lies = Axes("x", "z")
    assert "marker_axes say is up" in refusal(tree, human, markers, lies)


def test_refuses_markers_that_leave_a_segment_free(tree, human, markers):
    segments = markers.segments
    loose = replace(
        markers,
        segments=replace(
            segments,
            foot=replace(segments.foot, left=("L_ank",)),
        ),
    )
    message = refusal(tree, human, loose)
    assert "cannot determine the angle of the foot left" in message


def test_refuses_incomplete_legs(tree, human, markers):
    segments = markers.segments
    none = replace(
        markers,
        segments=replace(
            segments, shank=replace(segments.shank, left=(), right=())
        ),
    )
    assert "name no leg" in refusal(tree, human, none)


def test_refuses_joint_centres_on_one_spot(tree, human, markers):
    centres = markers.joint_centres
    same = replace(markers, joint_centres=replace(centres, knee=centres.ankle))
    assert "measures 0.000 m" in refusal(tree, human, same)


def test_refuses_a_marker_that_is_named_twice(markers):
    left = markers.segments.shank.left
    with pytest.raises(InputError, match=f"left names the marker '{left[0]}'"):
        replace(markers.segments.shank, left=(*left, left[0]))


def test_refuses_weights_of_unknown_markers(tree, human, markers):
    odd = replace(markers, weights={"nose": 2.0})
    assert "'nose', which is on no segment" in refusal(tree, human, odd)


@pytest.fixture(scope="module")
def opencap(data_root, request):
    """Our angles and OpenSim's, both sagittal and of both legs [rad]."""
    path = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    study = read_study(path, data_root)
    file, subject = study.file, study.subject
    recording = Recordings(file, study.root, subject).of(file.trials[0])
    motion = recording.motion
    folder = data_root / "opencap_subject4"
    ik = in_radians(read_table(folder / "IK/STS1_ik.mot"))
    osim = Osim(folder / "Models/optimized_scale_and_markers.osim")
    X = osim.poses({name: ik.column(name) for name in ik.names})

    def along(upper, lower):
        d = (X[upper][1] - X[lower][1])[:, :2] @ [1.0, 1.0j]
        return np.unwrap(np.angle(d / 1j))

    def mean(function):
        return 0.5 * (function("_r") + function("_l"))

    def pitch(body, column, sign):
        R = X[body][0]
        x, z = R[:, 0, column], R[:, 1, column]
        angle = np.arctan2(z, x) if sign > 0 else np.arctan2(-x, z)
        return np.unwrap(angle)

    foot = mean(lambda s: pitch("calcn" + s, 0, 1))
    shank = mean(lambda s: along("tibia" + s, "talus" + s))
    thigh = mean(lambda s: along("femur" + s, "tibia" + s))
    trunk = pitch("torso", 1, -1)
    theirs = np.column_stack([foot - shank, thigh - shank, thigh - trunk])
    in_rises = np.zeros(len(motion.time), bool)
    for rise in recording.rises:
        in_rises |= (motion.time >= rise.seat_off_s) & (
            motion.time <= rise.standing_s
        )
    # The markers outlast the plates, whose clock is late.
    theirs = low_pass(theirs, 100.0)[: len(motion.time)]
    difference = motion.q[:, 3:] - theirs
    return np.rad2deg(difference[in_rises])


@pytest.mark.slow
def test_angles_follow_opensims_inverse_kinematics(opencap):
    """Against a 3D model's angles, less the mean (zeros are defined apart).

    The knee differs most: the thighs are 8 to 18 degrees abducted, so in the
    sagittal plane they look shorter while seated, and a planar chain of
    fixed lengths bends more to keep feet and hips where they are.
    """
    ankle, knee, hip = opencap.std(axis=0)
    assert ankle < 1.0
    assert knee < 3.0
    assert hip < 2.0
    assert np.abs(opencap.mean(axis=0)).max() < 10.0


def test_a_first_guess_turns_each_segments_own_markers(tree, human, model):
    """Rigid turns are found at once, however far; one marker says nothing."""
    q = motion(np.array([0.0, 2.0]), human)
    q[:, 2] = 2.5, -1.2
    data = marker_data(tree, human, np.array([0.0, 0.01]), q)
    points = FRAME.points(data.of(model.names))
    p = points[..., 0] + 1j * points[..., 1]
    guess = kinematics._first_guess(model, p)
    for k, segment in enumerate(model.segments):
        turned = tree.body_angles(q, segment.partition("_")[0])
        off = np.angle(np.exp(1j * (guess[:, k] - turned)))
        # The left shank's markers have the foot's own among them.
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
    lone = model.without(model.on("foot", "left")[1:])
    guess = kinematics._first_guess(lone, p[:, : len(lone.names)])
    at = model.index("foot", "left")
    np.testing.assert_allclose(guess[:, at], model.standing_angles[at])


def test_markers_that_are_seen_hold_a_segment_or_not(model):
    """All of a foot's but the ankle's are hidden in the second frame."""
    hidden = np.zeros((3, len(model.names)), bool)
    foot = [n for n in model.on("foot", "left") if n != "L_ank"]
    for name in foot:
        hidden[1, model.names.index(name)] = True
    np.testing.assert_array_equal(model.determined(hidden), [True, False, True])
    assert model.without(foot).loose() == "foot_left"
    assert model.loose() is None


@pytest.mark.parametrize("scale", [0.19, 0.22, 4.5, 5.5])
def test_markers_in_another_unit_are_told_by_their_spread(model, scale):
    """Five times as far apart as in standing, or a fifth, is too much."""
    standing = model.levers @ np.exp(1j * model.standing_angles)
    p = 3.0 + scale * np.tile(standing, (4, 1))
    if 0.2 < scale < 5.0:
        kinematics._check_spread(model, p, "f")
        return
    with pytest.raises(InputError, match="in another unit of length"):
        kinematics._check_spread(model, p, "f")


def test_a_marker_ten_metres_away_is_named(model):
    standing = model.levers @ np.exp(1j * model.standing_angles)
    p = np.tile(standing, (5, 1))
    p[:2, 3] += 1e3  # in two of five frames: not in the median one
    p[:, 4] += 9.0
    kinematics._check_spread(model, p, "f")
    p[:, 4] += 3.0
    with pytest.raises(InputError, match=f"{model.names[4]} lie 1"):
        kinematics._check_spread(model, p, "f")


def test_each_leg_has_its_own_angles(tree, human, model):
    """As differences of segments: left and right of another posture."""
    n = 2
    angles = np.random.default_rng(0).uniform(-1, 1, (n, len(model.segments)))
    poses = kinematics.Poses(np.zeros(n, complex), angles, None)
    found = kinematics.leg_angles(model, poses)
    at = dict(zip(model.segments, angles.T, strict=True))
    for side in ("left", "right"):
        foot, shank, thigh = (
            at[f"{s}_{side}"] for s in ("foot", "shank", "thigh")
        )
        # Positive where the shank leans over the foot, where knee and hip
        # bend: the thigh turns on from the shank, the pelvis back from it.
        np.testing.assert_allclose(
            found[side],
            np.column_stack(
                [foot - shank, thigh - shank, thigh - at["pelvis"]]
            ),
        )
    mean = kinematics.merge_legs(model, poses)[:, 3:]
    np.testing.assert_allclose(mean, 0.5 * (found["left"] + found["right"]))


def test_a_welded_foot_counts_a_hundredfold(tree, human, markers):
    """Its markers cannot slide; a weight that is given goes before."""
    own = replace(markers, weights={"L_heel": 3.0})
    data = standing(tree, human)
    if "L_heel" not in data.names:
        own = replace(markers, weights={})
    model = build_marker_model(data, own, FRAME, welded=("foot",))
    for name, k, weight in zip(
        model.names, model.segment_of, model.weights, strict=True
    ):
        usual = 100.0 if model.segments[k].startswith("foot") else 1.0
        assert weight == own.weights.get(name, usual)


def test_toes_are_counted_from_the_foot(tree, human, markers):
    """Hinged: their angle less the foot's, behind the hip's."""
    segments = ("pelvis", "thigh_left", "shank_left", "foot_left", "toes_left")
    angles = np.array([[0.1, 0.2, -0.3, 0.4, 0.9]])
    model = SimpleNamespace(
        segments=segments,
        sides=("left",),
        ankles={"left": np.zeros(5, complex)},
        index=lambda s, side: segments.index(f"{s}_{side}"),
    )
    q = kinematics.merge_legs(
        model, kinematics.Poses(np.array([1.0 + 2.0j]), angles, None)
    )
    np.testing.assert_allclose(q, [[1.0, 2.0, 0.4, 0.7, 0.5, 0.1, 0.5]])
