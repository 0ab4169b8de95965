"""Movements that start on a chair, solved and simulated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drake_exo.calibration.audit import audit
from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.measurement.kinematics import (
    inverse_dynamics,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human

pytestmark = pytest.mark.slow

TIMES = np.linspace(0.0, 1.4, 141)


def step(t, start, end):
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


@pytest.fixture(scope="module")
def model():
    return Model("human", scale_human(70.0, 1.75))


@pytest.fixture(scope="module")
def seated(model):
    """A rise; the chair takes what lies behind the middle of the foot."""
    tree = model.tree
    height = model.human.ankle_height_m - 0.004
    low = np.array([0.0, height, 0.0, 0.3, 1.5, 1.9])
    high = np.array([*low[:3], 0.08, 0.05, 0.0])
    q = low + step(TIMES, 0.1, 1.3)[:, None] * (high - low)
    spline = make_interp_spline(TIMES, q, k=5)
    v, a = (spline.derivative(k)(TIMES) for k in (1, 2))
    free = tree.ground_reaction(q, inverse_dynamics(tree, q, v, a, {}))
    hip = tree.point_positions(q, "pelvis", (0.0, 0.0))[:, 0]
    middle = 0.05
    # F_z at the hips that brings the centre of pressure to the middle.
    share = (free[:, 2] + middle * free[:, 1]) / (middle - hip)
    share = share * (1.0 - step(TIMES, 0.3, 0.7))
    chair = PlanarWrench.of(np.column_stack([0.0 * share, share, -hip * share]))
    left = inverse_dynamics(tree, q, v, a, {"pelvis": chair})
    ground = PlanarWrench.of(tree.ground_reaction(q, left))
    return Trial(
        "seated",
        model.coordinates,
        TIMES,
        q,
        v,
        a,
        ground,
        moments=left[:, model.coordinates.joint_columns],
        chair=chair,
    )


@pytest.fixture(scope="module")
def result(model, seated):
    # A prior that keeps the soles from bounds: one rise hardly tells them.
    settings = FootGroundSettings(prior_weight=10.0)
    return FootGroundCalibration(model, [seated], settings).solve()


def test_the_chair_bears_its_share_in_the_solution(model, seated, result):
    assert result.success
    found = result.trials[0]
    at = seated.sample(found.times)
    assert at.chair.force_z[0] > 200.0
    # The feet alone bear far less than the body at first.
    assert found.ground.force_z[0] < 0.75 * model.tree.weight
    off = found.ground.force - at.ground.force
    assert np.sqrt((off**2).mean(axis=0)).max() < 20.0
    np.testing.assert_array_equal(found.chair.array, at.chair.array)


def test_newton_holds_with_the_chair_where_the_pelvis_really_is(
    model, seated, result
):
    tree, found = model.tree, result.trials[0]
    chair = seated.sample(found.times).chair
    left = inverse_dynamics(tree, found.q, found.v, found.a, {"pelvis": chair})
    left[:, found.coordinates.joint_columns] -= found.moments
    left -= tree.wrench_on_body(found.q, "foot", found.ground.array)
    assert np.abs(left).max() < 1e-4


@pytest.mark.slow
def test_the_simulation_sits_on_the_same_chair(result):
    found = audit(result)
    assert max(found.simulated_grf_n) < 2.0
    assert found.simulated_angles_deg < 0.1
    assert found.holds


def test_thighs_may_take_a_share(seated):
    shared = replace(seated, chair_on_thighs=0.25)
    assert shared.chair_shares == {"pelvis": 0.75, "thigh": 0.25}
    assert seated.chair_shares == {"pelvis": 1.0}
    assert replace(seated, chair=None).chair_shares == {}
    half = shared.sample(TIMES[::2])
    np.testing.assert_allclose(
        half.chair.array, seated.chair.array[::2], atol=1e-9
    )
    assert half.chair_on_thighs == 0.25
