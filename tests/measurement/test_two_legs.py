"""Walking legs: every one followed and loaded on its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import MultibodyForces
from scipy.optimize import least_squares
from synthetic_recording import load, write_recording

from drake_exo.errors import InputError
from drake_exo.measurement.kinematics import (
    Poses,
    ankle_paths,
    coordinates,
)
from drake_exo.measurement.settings import Plates, SidedMarkers
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.description import nominal_human
from drake_exo.study import RecordedStudy, read_study

TWO = {"human": {"legs": "two"}}


@pytest.fixture(scope="module")
def walk(data_root):
    """Study of a real walk, from right stance to left stance."""
    path = Path(__file__).parents[1] / "studies" / "opencap_walking.yaml"
    return read_study(path, data_root)


@pytest.mark.slow
def test_legs_that_move_alike_have_the_angles_of_one(tmp_path):
    _, study = write_recording(tmp_path, nominal_human())
    one = load(study, tmp_path)[1][0]
    _, study = write_recording(tmp_path, nominal_human(), model=TWO)
    subject, (two, _) = load(study, tmp_path)
    for joint in ("hip", "knee", "ankle"):
        for side in ("left", "right"):
            np.testing.assert_allclose(
                two.coordinate(f"{joint}_{side}"),
                one.coordinate(joint),
                atol=1e-6,
            )
    # Plates bear 40 % on the right, and no foot is doubled or moved.
    share = two.feet["right"].force_z / two.ground.force_z
    np.testing.assert_allclose(share, 0.4, atol=1e-6)
    np.testing.assert_allclose(two.ground.array, one.ground.array, atol=1e-6)
    assert subject.model.tree.root == "pelvis"
    # Moments of both legs together are those of the one leg.
    both = two.moment("knee_left") + two.moment("knee_right")
    np.testing.assert_allclose(both, one.moment("knee"), atol=0.01)
    # The left bears 60 %.
    ratio = two.moment("knee_left") / two.moment("knee_right")
    assert np.median(ratio) == pytest.approx(1.5, abs=0.05)


@pytest.mark.slow
def test_plates_are_timed_though_feet_begin_and_end_beside_them(walk):
    """As the rises of that day say: one frame late."""
    file = walk.file
    timed = replace(
        file.laboratory, force_delay_s=0.0, estimate_force_delay=True
    )
    study = RecordedStudy(replace(file, laboratory=timed), walk.root)
    lags = [t.provenance["delays_s"]["forces"] for t in study.trials()]
    np.testing.assert_allclose(lags, 0.01, atol=0.002)
    clock = [c for c in study.plausibility() if c.name.endswith("force_clock")]
    assert len(clock) == 3 and all(c.holds for c in clock)


@pytest.mark.slow
def test_a_planar_body_is_found_again(walk):
    """What lies in the plane has no hips fore and aft of each other."""
    subject, tree = walk.subject, walk.model.tree
    markers = subject.markers
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (6, tree.num_positions))
    flat = replace(
        markers,
        ankles={
            side: np.array(
                [
                    0.0 if name == "pelvis" else lever
                    for name, lever in zip(
                        markers.segments, levers, strict=True
                    )
                ]
            )
            for side, levers in _planar_ankles(tree, markers).items()
        },
    )
    angles = np.column_stack(
        [tree.body_angles(q, name) for name in markers.segments]
    )
    poses = Poses(q[:, 0] + 1j * q[:, 1], angles, np.zeros((6, 1)))
    found = coordinates(walk.model, flat, poses)
    np.testing.assert_allclose(found, q, atol=1e-9)


def test_a_body_in_space_is_met_as_near_as_its_parts_are_known(walk):
    """Hips 1 cm, ankles 2 mm; feet and pelvis 0.01 rad, legs 0.03 rad."""
    markers, tree = walk.subject.markers, walk.model.tree
    rng = np.random.default_rng(1)
    angles = rng.uniform(-0.4, 0.4, (2, len(markers.segments)))
    poses = Poses(np.array([0.1 + 0.9j, 0.9j]), angles, np.zeros((2, 1)))
    found = coordinates(walk.model, markers, poses)
    ankles = ankle_paths(markers, poses)
    sigma = [0.03 if "thigh" in n or "shank" in n else 0.01
             for n in markers.segments]  # fmt: skip

    def off(q, k):
        q = q[None]
        parts = [
            (tree.body_angles(q, name)[0] - angle) / size
            for name, angle, size in zip(
                markers.segments, angles[k], sigma, strict=True
            )
        ]
        hip = [poses.hip[k].real, poses.hip[k].imag]
        for body, p, size in (
            ("pelvis", hip, 0.01),
            ("foot_left", ankles["left"][k], 0.002),
            ("foot_right", ankles["right"][k], 0.002),
        ):
            at = tree.point_positions(q, body, (0.0, 0.0))[0]
            parts += list((at - p) / size)
        return np.array(parts)

    for k, q in enumerate(found):
        assert np.abs(off(q, k)).max() > 0.05
        best = least_squares(off, 0.0 * q, args=(k,), xtol=1e-12).x
        np.testing.assert_allclose(q, best, atol=1e-6)


def _planar_ankles(tree, markers):
    """Levers of the ankles on a body whose hips are one."""
    found = {}
    for side in ("left", "right"):
        lengths = tree.origins[tree.body_index(f"foot_{side}")]
        lever = np.zeros(len(markers.segments), complex)
        for name in (f"thigh_{side}", f"shank_{side}"):
            segment = tree.segment_of[tree.body_index(name)]
            lever[markers.segments.index(name)] = lengths[segment]
        found[side] = lever
    return found


@pytest.mark.slow
def test_feet_stay_where_they_are_in_space(walk):
    """Angles give way by a degree or two, feet that stand do not."""
    for trial in walk.trials():
        tree = walk.model.tree
        for side in ("left", "right"):
            place = tree.point_positions(trial.q, f"foot_{side}", (0.0, 0.0))
            flat = np.abs(tree.body_angles(trial.q, f"foot_{side}")) < 0.05
            flat &= trial.feet[side].force_z > 300.0
            assert flat.sum() > 20
            assert np.ptp(place[flat, 0]) < 0.01
        assert set(trial.feet) == {"left", "right"}
        total = trial.feet["left"] + trial.feet["right"]
        np.testing.assert_allclose(total.array, trial.ground.array)


def test_joint_moments_are_drakes_with_the_forces_on_the_feet(walk):
    """Inverse dynamics of two legs, by the plant and not by the tree."""
    (trial, _) = walk.trials()
    model = walk.model
    plant = model.plant()
    context = plant.CreateDefaultContext()
    for i in (0, 30, 60, 90):
        plant.SetPositions(context, trial.q[i])
        plant.SetVelocities(context, trial.v[i])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        for side, wrench in trial.feet.items():
            foot = plant.GetBodyByName(f"foot_{side}")
            p_WF = plant.EvalBodyPoseInWorld(context, foot).translation()
            F_x, F_z, M_y = wrench.array[i]
            moment = M_y - (p_WF[2] * F_x - p_WF[0] * F_z)
            foot.AddInForceInWorld(
                context, SpatialForce([0, moment, 0], [F_x, 0, F_z]), forces
            )
        expected = plant.CalcInverseDynamics(context, trial.a[i], forces)
        np.testing.assert_allclose(
            trial.moments[i], expected[3:], atol=1e-9 * 1e3
        )


def test_trials_of_two_feet_come_back_from_disk(walk, tmp_path):
    (trial, _) = walk.trials()
    trial.save(tmp_path / "walk")
    again = Trial.load(tmp_path / "walk")
    assert list(again.feet) == list(trial.feet)
    for side, wrench in trial.feet.items():
        np.testing.assert_array_equal(again.feet[side].array, wrench.array)
    part = trial.sample(np.array([0.1, 0.2]))
    assert part.feet["left"].array.shape == (2, 3)


def test_several_plates_in_turn_are_one_foot():
    plates = Plates(left=2, right=(1, 3))
    assert plates.of("right") == (1, 3)
    assert plates.of("both") == ()
    with pytest.raises(InputError, match="plate 3 cannot be left and right"):
        Plates(left=(2, 3), right=(1, 3))
    with pytest.raises(InputError, match="'RASI' is one name; give a list"):
        SidedMarkers(left="RASI")
    with pytest.raises(InputError, match="left names plate 2 more than once"):
        Plates(left=(2, 2), right=1)
    with pytest.raises(InputError, match="right names no plate; name one"):
        Plates(left=2, right=())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"plates": Plates(both=1)}, "plates.left is missing"),
        ({"end_s": 0.4}, "left foot's plates are never loaded"),
    ],
)
def test_feet_without_forces_are_refused(walk, change, words):
    first = replace(walk.file.trials[0], **change)
    study = RecordedStudy(replace(walk.file, trials=(first,)), walk.root)
    with pytest.raises(InputError, match=f"trial walking1: .*{words}"):
        study.trials()


def test_toes_need_a_marker(walk):
    segments = replace(
        walk.file.markers.segments,
        toes=type(walk.file.markers.segments.toes)(),
    )
    markers = replace(walk.file.markers, segments=segments)
    hinged = Assembly(Person("two", "hinged"))
    file = replace(walk.file, markers=markers, model=hinged)
    study = RecordedStudy(file, walk.root)
    with pytest.raises(InputError, match="markers on thigh, shank, foot, toes"):
        study.subject  # noqa: B018


@pytest.mark.slow
def test_two_legs_need_the_markers_of_both(tmp_path):
    _, study = write_recording(tmp_path, nominal_human(), model=TWO)
    centres = study.markers.joint_centres
    knee = replace(centres.knee, left=())
    markers = replace(study.markers, joint_centres=replace(centres, knee=knee))
    with pytest.raises(InputError, match="only the right one has all its"):
        load(replace(study, markers=markers), tmp_path)
