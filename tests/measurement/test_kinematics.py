from dataclasses import replace

import numpy as np
import pytest
from osim_kinematics import Osim
from synthetic_recording import marker_data, motion, study_text

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import read_table
from drake_exo.measurement.filters import low_pass
from drake_exo.measurement.kinematics import (
    build_marker_model,
    merge_legs,
    residual_rms,
    solve_poses,
)
from drake_exo.measurement.processing import process
from drake_exo.measurement.sagittal import SagittalFrame
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human
from drake_exo.study import StudyFile, read_study

FRAME = SagittalFrame()


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
    found, ankles = merge_legs(model, poses)
    np.testing.assert_allclose(found, q, atol=1e-8)
    np.testing.assert_allclose(ankles["left"], q[:, :2], atol=1e-9)
    assert max(residual_rms(model, poses).values()) < 1e-8
    np.testing.assert_allclose(
        np.column_stack([poses.hip.real, poses.hip.imag]),
        tree.point_positions(q, "pelvis", (0.0, 0.0)),
        atol=1e-9,
    )


def test_lengths_are_those_of_the_body(human, model):
    assert model.lengths_m["shank"] == pytest.approx(human.shank.length_m)
    assert model.lengths_m["thigh"] == pytest.approx(human.thigh.length_m)
    assert model.ankle_height_m == pytest.approx(human.ankle_height_m)


@pytest.mark.parametrize(
    ("forward", "up", "order", "signs"),
    [("y", "z", [2, 0, 1], [1, 1, 1]), ("-z", "x", [1, 2, 0], [1, 1, -1])],
)
def test_any_axes_of_the_laboratory(
    tree, human, markers, forward, up, order, signs
):
    def turned(data):
        return replace(data, positions=data.positions[..., order] * signs)

    frame = SagittalFrame(forward, up)
    model = build_marker_model(turned(standing(tree, human)), markers, frame)
    time = np.array([0.0, 2.0])
    q = motion(time, human)
    data = turned(marker_data(tree, human, time, q))
    poses = solve_poses(model, frame.points(data.of(model.names)))
    np.testing.assert_allclose(merge_legs(model, poses)[0], q, atol=1e-8)


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
    found, ankles = merge_legs(model, poses)
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
    np.testing.assert_allclose(merge_legs(model, poses)[0], q, atol=1e-8)


def test_a_marker_without_weight_has_no_say(tree, human, markers):
    light = replace(markers, weights={"L_sh1": 0.0})
    model = build_marker_model(standing(tree, human), light, FRAME)
    q = motion(np.array([2.0]), human)
    data = marker_data(tree, human, np.array([2.0]), q)
    data.positions[:, data.names.index("L_sh1"), 0] += 0.1
    poses = solve_poses(model, FRAME.points(data.of(model.names)))
    np.testing.assert_allclose(merge_legs(model, poses)[0], q, atol=1e-8)
    assert residual_rms(model, poses)["L_sh1"] == pytest.approx(0.1)


def refusal(tree, human, markers):
    with pytest.raises(InputError) as caught:
        build_marker_model(standing(tree, human), markers, FRAME)
    return str(caught.value)


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


def test_refuses_weights_of_unknown_markers(tree, human, markers):
    odd = replace(markers, weights={"nose": 2.0})
    assert "'nose', which is on no segment" in refusal(tree, human, odd)


@pytest.fixture(scope="module")
def opencap(data_root, request):
    """Our angles and OpenSim's, both sagittal and of both legs [rad]."""
    path = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    study = read_study(path, data_root)
    file, subject = study.file, study.subject
    recording = process(file.trials[0], subject, file, study.root)
    motion = recording.motion
    folder = data_root / "opencap_subject4"
    ik = read_table(folder / "IK/STS1_ik.mot").in_radians()
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
    difference = motion.q[:, 3:] - low_pass(theirs, 100.0)
    return np.rad2deg(difference[in_rises])


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
