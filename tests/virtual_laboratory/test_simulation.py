"""What a simulation records, against how it moved."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.virtual_laboratory.plan import Planner, Posture, RisePlan
from drake_exo.virtual_laboratory.simulation import equilibrium, simulate
from drake_exo.virtual_laboratory.truth import TRUTH, draw_truth

STANDING = Posture(shank=9.0, knee=14.0, trunk=2.0)
DIP = RisePlan(
    STANDING,
    Posture(shank=11.0, knee=20.0, trunk=5.0),
    STANDING,
    quiet_s=0.0,
    lean_s=0.25,
    rise_s=0.25,
    stand_s=0.0,
)


@pytest.fixture(scope="module")
def truth():
    made = draw_truth(np.random.default_rng(1), frozenset(TRUTH))
    return replace(made, friction=replace(made.friction, speed=0.3))


@pytest.fixture(scope="module")
def dipped(truth):
    planner = Planner(truth.model.rigid.tree, truth.contact)
    plan = planner.movement(DIP)
    trial = simulate("dip", truth, plan, None, (0.0, 0.2, 0.2), (0.0, 0.5))
    return plan, trial


@pytest.mark.slow
def test_accelerations_are_how_the_velocity_changed(truth, dipped):
    """Drake moved the body; ground, cuffs and torques told explain it."""
    _, trial = dipped
    np.testing.assert_allclose(trial.times, np.arange(501) / 1000.0)
    # Over 50 ms: a stiff foot trembles within them.
    gained = trial.v[60:-10] - trial.v[10:-60]
    sums = np.cumsum(trial.a, axis=0) / 1000.0
    given = (sums[60:-10] - sums[10:-60]) - 0.0005 * (
        trial.a[60:-10] - trial.a[10:-60]
    )
    off = np.sqrt(np.mean((gained - given) ** 2, axis=0))
    # The simulator is as exact as that.
    assert (off < 2.5e-3).all()
    assert np.abs(gained).max() > 0.05
    turned = np.gradient(trial.q, trial.times, axis=0)
    np.testing.assert_allclose(turned[5:-5], trial.v[5:-5], atol=2e-3)
    # What the ground gives, less the weight, moves the centre of mass.
    tree = truth.model.tree
    com = tree.center_of_mass(trial.q)
    speed = np.gradient(com, trial.times, axis=0)
    gained = (tree.weight / 9.81) * (speed[-6] - speed[5])
    force = trial.ground.force - [0.0, tree.weight]
    given = np.trapezoid(force[5:-5], trial.times[5:-5], axis=0)
    np.testing.assert_allclose(given, gained, atol=2e-3)


@pytest.mark.slow
def test_what_is_recorded_is_near_the_plan(truth, dipped):
    plan, trial = dipped
    names = trial.coordinates
    body = trial.q[:, names.body_columns]
    meant = np.column_stack(
        [np.interp(trial.times, plan.times, x) for x in plan.q.T]
    )
    assert np.abs(body - meant).max() < np.deg2rad(0.1)
    assert trial.name == "dip" and trial.source == "simulated"
    assert trial.mass_kg == truth.human.mass_kg
    assert not trial.feet and not trial.chair.force.any()
    assert set(trial.cuffs) == {"shank", "thigh", "pelvis"}
    # Human and device, together, as what both were meant to give.
    torque = trial.moments[:, :3] + trial.moments[:, 3:]
    meant = np.column_stack(
        [np.interp(trial.times, plan.times, x) for x in plan.moments.T]
    )
    assert np.sqrt(np.mean((torque - meant) ** 2)) < 1.5
    assert np.abs(trial.moments[:, 3:]).max() > 3.0


@pytest.mark.slow
def test_at_rest_nothing_is_left_over(truth):
    """A small step of any free coordinate costs, none drives."""
    planner = Planner(truth.model.rigid.tree, truth.contact)
    stood = planner.standing(0.2, 0.045)
    q = equilibrium(truth, None, stood.q[0])
    names = truth.model.coordinates
    shank = stood.q[0][3] - stood.q[0][2]
    at = dict(zip(names.names, q, strict=True))
    root = names.root
    assert at["ankle"] - at[root[2]] == pytest.approx(shank)
    assert at["knee"] == stood.q[0][4] and at["hip"] == stood.q[0][5]
    trial = simulate("still", truth, stood)
    np.testing.assert_allclose(trial.v, 0.0, atol=7e-4)
    np.testing.assert_allclose(trial.q[0], q, atol=2e-4)
    np.testing.assert_allclose(
        trial.ground.force_z, truth.model.tree.weight, rtol=3e-5
    )
