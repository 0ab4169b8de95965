"""Movements that start on a chair, solved and simulated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from drake_exo.calibration import audit
from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import needed_ground
from drake_exo.calibration.settings import FootGroundSettings, Solver
from drake_exo.measurement.inverse_dynamics import (
    inverse_dynamics,
    wrench_on_body,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.anthropometry import scale_human
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant

TIMES = np.linspace(0.0, 1.4, 141)


def step(t, start, end):
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


@pytest.fixture(scope="module")
def human():
    return scale_human(70.0, 1.75)


@pytest.fixture(scope="module")
def tree(human):
    return PlanarTree.from_plant(build_plant("human", human))


@pytest.fixture(scope="module")
def seated(human, tree):
    """A rise; the chair takes what lies behind the middle of the foot."""
    low = np.array([0.0, human.ankle_height_m - 0.004, 0.0, 0.3, 1.5, 1.9])
    high = np.array([*low[:3], 0.08, 0.05, 0.0])
    q = low + step(TIMES, 0.1, 1.3)[:, None] * (high - low)
    spline = make_interp_spline(TIMES, q, k=5)
    v, a = (spline.derivative(k)(TIMES) for k in (1, 2))
    free = needed_ground(q, inverse_dynamics(tree, q, v, a, {}))
    hip = tree.point_positions(q, "pelvis", (0.0, 0.0))[:, 0]
    middle = 0.05
    # F_z at the hips that brings the centre of pressure to the middle.
    share = (free[:, 2] + middle * free[:, 1]) / (middle - hip)
    share = share * (1.0 - step(TIMES, 0.3, 0.7))
    chair = np.column_stack([0.0 * share, share, -hip * share])
    w = PlanarWrench(chair[:, :2], chair[:, 2])
    left = inverse_dynamics(tree, q, v, a, {"pelvis": w})
    ground = needed_ground(q, left)
    return MeasuredMovement(
        "seated", TIMES, q, v, a, ground, left[:, 3:], chair=chair
    )


@pytest.fixture(scope="module")
def solved(human, tree, seated):
    settings = replace(
        FootGroundSettings(), solver=Solver(nodes_per_second=200)
    )
    parameters = settings.parameters(human.heel_m, human.toe_m)
    problem = FootGroundProblem(tree, [seated], parameters, settings)
    return problem, problem.solve()


def test_the_chair_bears_its_share_in_the_solution(seated, solved):
    problem, result = solved
    assert result.solution.success
    found = result.trajectories[0]
    at = seated.sample(found.times)
    assert at.chair[0, 1] > 200.0
    weight = problem.tree.mass * problem.tree.gravity
    # The feet alone bear far less than the body at first.
    assert found.ground[0, 1] < 0.75 * weight
    off = found.ground[:, :2] - at.ground[:, :2]
    assert np.sqrt((off**2).mean(axis=0)).max() < 20.0


def test_newton_holds_with_the_chair_where_the_pelvis_really_is(
    tree, seated, solved
):
    _, result = solved
    found = result.trajectories[0]
    chair = seated.sample(found.times).chair
    w = PlanarWrench(chair[:, :2], chair[:, 2])
    left = inverse_dynamics(tree, found.q, found.v, found.a, {"pelvis": w})
    left[:, 3:] -= found.torque
    feet = PlanarWrench(found.ground[:, :2], found.ground[:, 2])
    left -= wrench_on_body(tree, found.q, "foot", feet)
    assert np.abs(left).max() < 1e-4


def test_the_simulation_sits_on_the_same_chair(human, solved):
    problem, result = solved
    simulated = audit.simulate("human", human, None, 9.81, problem, result, 0)
    found = audit.compare(
        result.trajectories[0],
        simulated,
        audit.between_nodes(problem, result, 0),
    )
    assert max(found.simulated_grf_n) < 2.0
    assert found.simulated_angles_deg < 0.1
    assert found.holds


def test_thighs_may_take_a_share(seated):
    shared = replace(seated, chair_on_thighs=0.25)
    assert shared.chair_shares == {"pelvis": 0.75, "thigh": 0.25}
    assert seated.chair_shares == {"pelvis": 1.0}
    assert replace(seated, chair=None).chair_shares == {}
    half = shared.sample(TIMES[::2])
    np.testing.assert_allclose(half.chair, seated.chair[::2], atol=1e-9)
    assert half.chair_on_thighs == 0.25
