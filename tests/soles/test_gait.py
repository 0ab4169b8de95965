"""A walk and its sole: the walk's derivatives, limits, and the search."""

import json

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo import cli
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.load_blocks import Pattern
from drake_exo.soles.optimize import search
from drake_exo.soles.optimize.search import GaitProblem, stage_problem
from drake_exo.soles.walking_pattern import plan

FREE = ("step_length", "step_time", "double_support", "zmp")
_LOAD = EXAMPLE[EXAMPLE.index("load:") : EXAMPLE.index("optimize:")]


def _case(stage="{samples: 12, layer_m: 1.0e-4, kappa: 0.2, iterations: 4}"):
    text = EXAMPLE.replace(
        _LOAD, f"load: {{pattern: {{free: [{', '.join(FREE)}]}}}}\n"
    )
    return text.replace("{layer_m: 1.0e-4, kappa: 0.2, iterations: 5}", stage)


@pytest.fixture(scope="module")
def gait():
    return Pattern(free=FREE).gait(0.8)


def test_the_case_s_own_walk_is_where_it_starts(gait):
    assert gait.numbers(gait.at(gait.start)) == pytest.approx(
        gait.numbers(gait.robot)
    )
    own, again = Pattern().load(), gait.load(gait.start)
    np.testing.assert_allclose(again.force, own.force, atol=1e-6)
    np.testing.assert_allclose(again.zmp, own.zmp, atol=1e-9)
    assert gait.limits(gait.start).min() >= 0


def test_samples_stay_at_the_same_parts_of_both_supports(gait):
    x = gait.start + 0.2
    robot, load = gait.at(x), gait.load(x)
    own = Pattern().load()
    assert len(load.times) == len(own.times)
    early = own.times < gait.robot.double_support_s
    np.testing.assert_allclose(
        load.times[early] / robot.double_support_s,
        own.times[early] / gait.robot.double_support_s,
    )
    np.testing.assert_allclose(
        load.force[early, 2], own.force[early, 2], rtol=1e-9
    )


def test_limits_are_those_of_the_robot(gait):
    """A longer, slower walk; one that is drawn to the side."""
    x = gait.start.copy()
    names = list(gait.ranges)
    x[names.index("step_time")] = 1.0
    assert gait.limits(x)[0] == pytest.approx(1 / 1.25 - 1)
    robot = gait.at(x)
    load = gait.load(x)
    slip = np.hypot(*load.force[:, :2].T) / load.force[:, 2] / 0.8
    np.testing.assert_allclose(
        gait.limits(x)[-len(slip) :], 0.9 - slip, atol=1e-12
    )
    assert (load.zmp[:, 0] >= robot.bounds[0, 0] - 1e-6).all()
    assert (load.zmp[:, 0] <= robot.bounds[1, 0] + 1e-6).all()


def test_a_walk_may_shake_the_body_little_more_than_the_own_one(gait):
    """By a tenth: acceleration, of the inverted pendulum, and sway."""
    x = gait.start + 0.1

    def shaken(robot):
        found, times = plan(robot), np.linspace(0, robot.step_time_s, 41)
        com, zmp = found.at(found.com, times), found.at(found.zmp, times)
        omega2 = robot.gravity_m_per_s2 / robot.com_height_m
        size = omega2 * np.hypot(*(com - zmp).T)
        return size, np.abs(com[:, 1] - 0.5 * robot.step_width_m)

    shares = [
        mine / own.max()
        for mine, own in zip(
            shaken(gait.at(x)), shaken(gait.robot), strict=True
        )
    ]
    assert shares[0].max() != pytest.approx(shares[1].max(), rel=0.01)
    np.testing.assert_allclose(
        gait.limits(x)[1:83], 1.1 - np.concatenate(shares), atol=1e-6
    )


def test_slopes_of_a_walk_agree_with_wider_differences():
    """Of force, ZMP and limits, by each variable."""
    gait = Pattern(free=("step_time", "double_support")).gait(0.8)
    x, h = gait.start + np.array([0.03, -0.02]), 3e-4

    def there(x):
        load = gait.load(x)
        return np.hstack([load.force, load.zmp]), gait.limits(x)

    loads, limits = gait.slopes(x)
    assert loads.shape == (2, len(gait.load(x).times), 5)
    for k, d in enumerate(h * np.eye(2)):
        for got, ahead, behind in zip(
            (loads[k], limits[:, k]), there(x + d), there(x - d), strict=True
        ):
            wanted = (ahead - behind) / (2 * h)
            size = np.abs(wanted).max(axis=0)
            assert (np.abs(got - wanted) <= 2e-3 * size + 1e-6).all()


@pytest.mark.slow
def test_slopes_agree_with_differences(gait):
    """Of cost and all limits, through plan and simulation; and of each load."""
    case = Case.from_text(_case())
    problem = stage_problem(case, case.settings.optimize.stages[0])
    x = gait.start + 0.03
    found = GaitProblem(gait, problem, np.ones(problem.spline.count), x)
    cost, limits = found.slopes(x)
    rng, h = np.random.default_rng(0), 3e-5
    for _ in range(2):
        d = rng.standard_normal(len(x))
        numeric = (found.cost(x + h * d) - found.cost(x - h * d)) / (2 * h)
        assert cost @ d == pytest.approx(numeric, rel=1e-4)
        assert 1.001 * cost @ d != pytest.approx(numeric, rel=1e-4)
        rows = (found.limits(x + h * d) - found.limits(x - h * d)) / (2 * h)
        np.testing.assert_allclose(
            limits @ d, rows, rtol=1e-3, atol=1e-4 * np.abs(rows).max()
        )


@pytest.mark.slow
def test_sole_and_walk_are_sought_together(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "_GAIT_ITERATIONS", 5)
    monkeypatch.setattr(search, "_ROUNDS", 1)
    path = tmp_path / "case.yaml"
    path.write_text(_case())
    with undrawn():
        argv = ["sole", "optimize", str(path), "--out", str(tmp_path / "out")]
        assert cli.main(argv) in (0, 3)
    said = json.loads((tmp_path / "out" / "summary.json").read_text())
    walk = said["gait"]["walk"]
    assert set(FREE) - {"zmp"} < set(walk)
    assert said["gait"]["least_limit"] >= -1e-3
    length, time = walk["step_length"], walk["step_time"]
    assert length[1] / time[1] >= 0.999 * length[0] / time[0]
    assert any(a != b for a, b in walk.values())
    w = said["weight"]
    before = (
        said["gait"]["c_tr_sole_alone"] - w * said["gait"]["c_rot_sole_alone"]
    )
    assert said["c"] < before


def test_a_walk_of_several_loads_is_refused(tmp_path, capsys):
    path = tmp_path / "case.yaml"
    path.write_text(_case().replace("zmp]}", "zmp]}, straight: true"))
    argv = ["sole", "optimize", str(path), "--out", str(tmp_path / "out")]
    assert cli.main(argv) == 2
    error = capsys.readouterr().err
    assert "pattern.free" in error and error.count("\n") == 1
