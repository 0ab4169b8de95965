"""A real lift, from Motive's CSV files through inverse dynamics."""

import numpy as np
import pytest

from drake_exo.measurement.kinematics import (
    from_the_ground_up,
    inverse_dynamics,
)
from drake_exo.study import read_study

pytestmark = pytest.mark.slow

BOX_KG = 10.5


@pytest.fixture(scope="module")
def lift(data_root, request):
    path = request.path.parents[1] / "studies" / "boxlifting_squat.yaml"
    study = read_study(path, data_root)
    (trial,) = study.trials()
    Q = inverse_dynamics(
        study.model.rigid.tree,
        trial.q,
        trial.v,
        trial.a,
        {"foot": trial.ground},
    )
    return study.subject, trial, Q


def during(trial, start, end):
    time = trial.start_s + trial.times
    return (time >= start) & (time <= end)


def test_one_leg_is_followed_on_one_plate_under_both_feet(lift):
    subject, trial, _ = lift
    assert trial.provenance["legs_followed"] == ["right"]
    assert trial.provenance["one_leg_doubled"] is False
    assert subject.mass_kg == pytest.approx(70.2, abs=0.5)


def test_squat_bends_the_legs(lift):
    _, trial, _ = lift
    ankle, knee, hip = np.rad2deg(trial.q[:, 3:6]).max(axis=0)
    assert 25.0 < ankle < 50.0
    assert 100.0 < knee < 130.0
    assert 105.0 < hip < 135.0


def test_what_newton_misses_is_the_box(lift):
    """Plates carry the box, the model does not know of it."""
    _, trial, Q = lift
    before = Q[during(trial, 5.94, 6.9), 1]
    carried = Q[during(trial, 10.1, 10.9), 1]
    after = Q[during(trial, 11.5, 12.6), 1]
    assert np.abs(before).mean() < 6.0
    assert np.abs(after).mean() < 8.0
    assert carried.mean() == pytest.approx(-BOX_KG * 9.81, abs=10.0)


def test_box_loads_knees_and_hips_from_the_ground_up(lift):
    """From below, moments hold the box; from above they do not know it."""
    subject, trial, Q = lift
    from_below = from_the_ground_up(subject.model.rigid.tree, trial.q, Q)
    np.testing.assert_allclose(from_below[:, :3], 0.0, atol=1e-9)
    carried = during(trial, 10.1, 10.9)
    extra = (from_below - Q)[carried, 3:].mean(axis=0)
    # The box before the body: plantar flexion and hip extension against it.
    assert extra[0] < -20.0 and extra[2] < -40.0
    # Where Newton holds, both ways agree.
    still = during(trial, 5.94, 6.9)
    assert np.abs((from_below - Q)[still, 3:]).max() < 15.0


def test_centre_of_pressure_stays_under_the_feet(lift):
    _, trial, _ = lift
    ahead = trial.ground.cop_x - trial.q[:, 0]
    assert ahead.min() > -0.05 and ahead.max() < 0.22
