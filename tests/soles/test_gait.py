"""A walk and its sole: the walk's derivatives, limits, and the search."""

import json
from dataclasses import replace

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.settings import Settings
from drake_exo.soles.walking_pattern import Gait, Robot, plan, smooth_share

FREE = ("step_length", "step_time", "double_support", "zmp")
_LOAD = EXAMPLE[EXAMPLE.index("load:") : EXAMPLE.index("optimize:")]


def _case(stage="{samples: 12, layer_m: 1.0e-4, kappa: 0.2, iterations: 4}"):
    text = EXAMPLE.replace(
        _LOAD, f"load: {{pattern: {{free: [{', '.join(FREE)}]}}}}\n"
    )
    return text.replace("{layer_m: 1.0e-4, kappa: 0.2, iterations: 5}", stage)


@pytest.fixture(scope="module")
def gait():
    return Gait(Robot(free=FREE), 0.8)


def test_the_case_s_own_walk_is_where_it_starts(gait):
    assert gait.numbers(gait.at(gait.start)) == pytest.approx(
        gait.numbers(gait.robot)
    )
    own, again = Robot().load(), gait.load(gait.start)
    np.testing.assert_allclose(again.force, own.force, atol=1e-6)
    np.testing.assert_allclose(again.zmp, own.zmp, atol=1e-9)
    assert kept(gait, gait.start) and not gait.limits(gait.start)["speed"]


def kept(gait, x):
    return all((limit >= 0).all() for limit in gait.limits(x).values())


@pytest.mark.slow
def test_walks_to_begin_with_differ_and_keep_the_limits(gait):
    """The same ones every time; the own walk where there are none."""
    found = [gait.walk(k) for k in range(4)]
    np.testing.assert_array_equal(found[0], gait.start)
    for k in range(1, 4):
        assert kept(gait, found[k])
        assert np.abs(found[k] - found[k - 1]).max() > 0.1
        np.testing.assert_array_equal(found[k], gait.walk(k))
    # One number's middle is the own walk again.
    single = Gait(Robot(free=("double_support",)), 0.8)
    assert len({float(single.walk(k)[0]) for k in range(4)}) == 4
    slower = Gait(Robot(free=("step_time",)), 1e-3)  # slips, however slow
    np.testing.assert_array_equal(slower.walk(2), slower.start)


def test_samples_are_as_many_and_even_over_the_contact(gait):
    """It begins and ends with the same part of the weight."""
    x = gait.start + 0.2
    robot, load = gait.at(x), gait.load(x)
    own = Robot().load()
    assert len(load.times) == len(own.times)
    apart = np.diff(load.times)
    np.testing.assert_allclose(apart, apart[0])
    assert apart[0] != pytest.approx(0.005, rel=0.05)
    D, step = robot.double_support_s, robot.step_time_s
    begin, end = robot.bearing
    assert smooth_share(begin / D) == pytest.approx(robot.least_share)
    assert 1 - smooth_share((end - step) / D) == pytest.approx(
        robot.least_share
    )
    # The case's own first sample is up to a period later.
    assert 0 <= load.times[0] - begin <= apart[0]
    assert gait.limits(x)["contact"] == pytest.approx(
        1 - np.ptp(load.times) / np.ptp(own.times)
    )


def test_limits_are_those_of_the_robot(gait):
    """A longer, slower walk; one that is drawn to the side."""
    x = gait.start.copy()
    names = list(gait.ranges)
    x[names.index("step_time")] = 1.0
    assert gait.limits(x)["speed"] == pytest.approx(1 / 1.25 - 1)
    robot = gait.at(x)
    load = gait.load(x)
    slip = np.hypot(*load.force[:, :2].T) / load.force[:, 2] / 0.8
    np.testing.assert_allclose(
        gait.limits(x)["friction"], 0.9 - slip, atol=1e-12
    )
    assert (load.zmp[:, 0] >= robot.bounds[0, 0] - 1e-6).all()
    assert (load.zmp[:, 0] <= robot.bounds[1, 0] + 1e-6).all()


def test_friction_of_a_walk_is_along_the_ground(tmp_path):
    """On a slope more than the horizontal force over the vertical."""
    rows = [
        f"{x:g},{y:g},{0.3 * x:g}"
        for x in np.linspace(-0.3, 0.3, 4)
        for y in np.linspace(-0.2, 0.2, 4)
    ]
    (tmp_path / "slope.csv").write_text("\n".join(["x_m,y_m,z_m", *rows]))
    text = _case() + "ground: {heights: slope.csv}\n"
    case = Case.from_text(text, tmp_path)
    gait = case.gait
    least = gait.limits(gait.start)["friction"].min()
    assert least == pytest.approx(0.9 - case.friction_used / 0.8)


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
    for name, share in zip(("acceleration", "sway"), shares, strict=True):
        np.testing.assert_allclose(gait.limits(x)[name], 1.1 - share, atol=1e-6)


@pytest.mark.parametrize("back_m", [None, -0.07])
def test_slopes_of_a_walk_agree_with_wider_differences(back_m):
    """Of force, ZMP and limits, by each variable; on bounds, too."""
    robot = Robot(back_m=back_m, free=("step_time", "double_support"))
    gait = Gait(robot, 0.8)
    x, h = gait.start + np.array([0.03, -0.02]), 3e-4

    def there(x):
        load = gait.load(x)
        limits = np.concatenate(list(gait.limits(x).values()))
        return np.hstack([load.force, load.zmp]), limits

    loads, limits = gait.slopes(x)
    assert list(limits) == list(gait.limits(x))
    limits = np.concatenate(list(limits.values()))
    assert loads.shape == (2, len(gait.load(x).times), 5)
    for k, d in enumerate(h * np.eye(2)):
        for got, ahead, behind in zip(
            (loads[k], limits[:, k]), there(x + d), there(x - d), strict=True
        ):
            wanted = (ahead - behind) / (2 * h)
            size = np.abs(wanted).max(axis=0)
            assert (np.abs(got - wanted) <= 2e-3 * size + 1e-6).all()


@pytest.mark.slow
def test_slopes_agree_with_differences():
    """Of cost and all limits by shape and walk, through plan and simulation."""
    case = Case.from_text(_case())
    problem = ShapeProblem(case, case.settings.optimize.stages[0])
    bounds = problem.within((0.3, 1.4))
    own = problem.spline.count
    np.testing.assert_array_equal(bounds[:, 0], [0.3, 1.4])
    np.testing.assert_array_equal(bounds[:, own:], [[0] * 6, [1] * 6])
    p = problem.undeformed
    p[own:] += 0.03
    p[:own] += 0.01 * np.sin(np.arange(own))
    assert problem.names()[-5:] == list(case.gait.limits(p[own:]))
    gradient, rows = problem.derivatives(p)
    rough = problem.regularization(p)
    assert not rough[1][own:].any() and not rough[2][own:].any()
    gradient = gradient + rough[1]
    rng, h = np.random.default_rng(0), 6e-6
    for _ in range(2):
        d = rng.standard_normal(len(p))
        ahead, behind = p + h * d, p - h * d
        numeric = (problem.cost(ahead) - problem.cost(behind)) / (2 * h)
        assert gradient @ d == pytest.approx(numeric, rel=1e-4)
        assert 1.001 * gradient @ d != pytest.approx(numeric, rel=1e-4)
        change = problem.constraints(ahead) - problem.constraints(behind)
        np.testing.assert_allclose(
            rows @ d, change / (2 * h), rtol=1e-3, atol=1e-4
        )


@pytest.mark.slow
def test_the_worst_of_a_walk_counts():
    """Little more than the least of each limit's samples."""
    case = Case.from_text(_case())
    problem = ShapeProblem(case, case.settings.optimize.stages[0])
    least = [
        limit.min() for limit in case.gait.limits(case.gait.start).values()
    ]
    values = problem.constraints(problem.undeformed)[-5:]
    assert (values <= np.array(least) + 1e-12).all()
    np.testing.assert_allclose(values, least, atol=np.log(220) / 200)


@pytest.mark.slow
def test_what_cannot_be_simulated_has_no_limits():
    """A shape of nothing; a step of 10 m, which no ZMP carries."""
    case = Case.from_text(_case())
    problem = ShapeProblem(case, case.settings.optimize.stages[0])
    own, length = problem.spline.count, next(iter(case.gait.ranges))
    assert length == "step_length"
    for place, value in ((slice(own), 0.0), (own, 100.0)):
        p = problem.undeformed
        p[place] = value
        values = problem.constraints(p)
        assert np.isnan(values).all() and len(values) == len(problem.names())


@pytest.mark.slow
def test_sole_and_walk_are_sought_together(tmp_path):
    path = tmp_path / "case.yaml"
    stage = "{samples: 40, layer_m: 3.0e-4, kappa: 0.2, iterations: 10}"
    text = _case(f"{stage}, {stage}").replace("[4, 3, 2]", "[8, 5, 2]")
    text = text.replace("{free:", "{period_s: 0.01, free:")
    path.write_text(text.replace("[3, 3]", "[5, 5]"))
    with undrawn():
        argv = ["sole", "optimize", str(path), "--out", str(tmp_path / "out")]
        assert cli.main(argv) in (0, 3)
    said = json.loads((tmp_path / "out" / "summary.json").read_text())
    walk = said["gait"]["walk"]
    assert set(FREE) - {"zmp"} < set(walk)
    assert said["gait"]["least_limit"] >= -1e-3
    length, time = walk["step_length"], walk["step_time"]
    assert length[1] / time[1] >= 0.999 * length[0] / time[0]
    assert said["gait"]["contact_s"][1] <= 1.001 * said["gait"]["contact_s"][0]
    assert any(a != b for a, b in walk.values())
    # Without the noise of its rounding, and with as many samples.
    found = Settings.read(tmp_path / "out" / "case.yaml").load.pattern
    assert found.period_s == float(f"{found.period_s:.12g}")
    assert len(found.load().times) == said["loads"][0]["steps"]
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
    assert "load.pattern.free" in error and error.count("\n") == 1
    other = "{constant: {force_n: [0, 0, 9], zmp_m: [0, 0]}}"
    two = _case().replace("load: ", f"loads:\n  - {other}\n  - ")
    with pytest.raises(InputError, match=r"loads\[1\]\.pattern\.free: a walk"):
        Case.from_text(two)


def test_a_zmp_that_nothing_draws_cannot_be_sought():
    """Without a weight the range of how strongly it is drawn is empty."""
    text = _case().replace("{free:", "{torque_weight: 0, free:")
    with pytest.raises(InputError, match=r"free: zmp .* torque_weight is 0"):
        Case.from_text(text)
    assert Case.from_text(text.replace(", zmp]", "]")).gait.start.size == 3


def test_a_walk_of_one_sample_cannot_be_sought():
    """How long its foot is loaded is told by the first and the last."""
    text = _case().replace("{free:", "{period_s: 0.7, free:")
    with pytest.raises(InputError, match=r"free: .* two samples or more"):
        Case.from_text(text)
    still = text[: text.index(", free:")] + "}}\n"
    still += text[text.index("optimize:") :]
    assert len(Case.from_text(still).load.times) == 1


def test_a_load_of_another_walk_cannot_be_sought():
    """Put in by Python: the search would have sought the pattern's."""
    case = Case.from_text(_case())
    for other in (case.load.every(9), Robot(mass_kg=81.0).load()):
        with pytest.raises(InputError, match="is not the load of the walk"):
            replace(case, load=other).optimize()
    case._check_walk()
    step = replace(case, load=case.load.every(9)).simulate()
    assert step.failed_steps == 0
