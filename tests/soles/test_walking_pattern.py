"""Walking pattern: dynamics, periodicity, shares, the authors' step."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from drake_exo.errors import InputError
from drake_exo.soles.load_blocks import OneFoot, Playback
from drake_exo.soles.walking_pattern import (
    Robot,
    _feet,
    _least_squares,
    _mirrored,
    plan,
    smooth_share,
)

ROBOT = Robot(
    80.0, 0.8085, 0.2633, 0.162, 1.0, 0.195, -0.1, 0.1, 0.05, -0.05
)  # fmt: skip


@pytest.fixture(scope="module")
def pattern():
    return plan(ROBOT)


def test_zmp_and_com_obey_the_pendulum(pattern):
    t = np.linspace(0.01, 1.0, 57)
    omega2 = 9.81 / 0.8085
    np.testing.assert_allclose(
        pattern.zmp(t), pattern.com(t) - pattern.com(t, 2) / omega2, atol=1e-9
    )


def test_step_repeats_mirrored_and_ahead(pattern):
    for order in range(5):
        here, there = pattern.com(0.0, order), pattern.com(1.0, order)
        shift = [0.2633, 0.162] if order == 0 else [0, 0]
        scale = max(1.0, np.abs(here).max())
        np.testing.assert_allclose(
            there, [1, -1] * here + shift, atol=1e-5 * scale
        )


def test_zmp_is_twice_differentiable(pattern):
    knots = np.linspace(0, 1.0, 17)[1:-1]
    for order in (0, 1, 2):
        left = pattern.zmp(knots - 1e-9, order)
        right = pattern.zmp(knots + 1e-9, order)
        scale = max(1.0, np.abs(left).max())
        np.testing.assert_allclose(left, right, atol=1e-5 * scale)


def test_both_feet_carry_the_whole_load(pattern):
    load = plan(replace(ROBOT, least_share=1e-6)).foot_load()
    first = load.times[0]
    share = load.force[:, 2] / (80 * 9.81)
    middle = (load.times > 0.2) & (load.times < 1.0)
    np.testing.assert_allclose(share[middle], 1.0, atol=1e-12)
    # Landing and lift-off of one double support add up to the whole.
    t = np.arange(0.01, 0.19, 0.005)

    def at(values, when):
        return np.interp(when, load.times, values)

    both = at(share, t) + at(share, 1.0 + t)
    np.testing.assert_allclose(both, 1.0, atol=1e-9)
    z = pattern.zmp(t)
    for k, (sign, shift) in enumerate(((1, 0.2633), (-1, 0.162))):
        # The lifting foot's ZMP, seen from the landing foot.
        other = sign * (at(load.zmp[:, k], 1.0 + t) - shift)
        total = at(share, t) * at(load.zmp[:, k], t)
        total += at(share, 1.0 + t) * other
        np.testing.assert_allclose(total, z[:, k], atol=1e-9)
    assert first < 0.02
    # 5 ms apart: no jump, the ZMP moves at most at 0.6 m/s.
    assert np.abs(np.diff(load.zmp, axis=0)).max() < 3e-3
    assert np.abs(np.diff(load.force[:, 2])).max() < 0.06 * 80 * 9.81


def test_a_foot_comes_to_rest_and_another_sets_off(pattern):
    """The landing foot's own path begins at rest, the unloading one's ends so.

    Both go on with the speed of single support; sums of both feet do not tell,
    they are right with any paths.
    """
    h, D = 1e-6, ROBOT.double_support_s
    z = pattern.zmp
    a, b = _feet(z, 0.0, np.array([0.0, h, D - h, D]), D)
    np.testing.assert_allclose(a[0], z(0.0), atol=1e-12)
    np.testing.assert_allclose(b[3], z(D), atol=1e-12)
    speed = np.abs(z(np.array([0.0, D]), 1)).max()
    for early, late, expected in (
        (a[0], a[1], z(0.0, 1)),
        (a[2], a[3], 0.0),
        (b[0], b[1], 0.0),
        (b[2], b[3], z(D, 1)),
    ):
        found = (late - early) / h
        np.testing.assert_allclose(
            found, expected + 0 * found, atol=1e-5 * speed
        )


def test_where_a_foot_lands_and_lifts_off_is_limited(pattern):
    """Its own path's ends, which the programme's rows are of."""
    T, D = ROBOT.step_time_s, ROBOT.double_support_s
    landing = _feet(pattern.zmp, T, 0.0, D)[1]
    off = _feet(pattern.zmp, T, D, D)[0]
    a, b = _feet(pattern.zmp, 0.0, np.array([0.0, D]), D)
    np.testing.assert_allclose(landing, b[0], atol=1e-9)
    np.testing.assert_allclose(off, _mirrored(a[1:], ROBOT)[0], atol=1e-6)
    # They hold where the bounds are tight.
    held = plan(replace(ROBOT, back_m=-0.05, front_m=0.05))
    a, b = _feet(held.zmp, 0.0, np.array([0.0, D]), D)
    ends = b[0, 0], _mirrored(a[1:], ROBOT)[0, 0]
    np.testing.assert_allclose(np.abs(ends).max(), 0.05, atol=1e-6)


def test_horizontal_forces_move_the_body(pattern):
    """Newton, with accelerations by differences; the next step mirrored."""
    load = plan(replace(ROBOT, least_share=1e-6)).foot_load()
    h, T = 1e-4, 1.0
    t = load.times
    ahead = t > T
    here = np.where(ahead, t - T, t)
    here = np.clip(here, h, T - h)
    c = pattern.com
    acceleration = (c(here + h) - 2.0 * c(here) + c(here - h)) / h**2
    acceleration[ahead, 1] *= -1.0
    share = load.force[:, 2] / (80.0 * 9.81)
    expected = 80.0 * share[:, None] * acceleration
    size = np.abs(expected).max(axis=0)
    assert (size > 5.0).all()
    assert (np.abs(load.force[:, :2] - expected) < 0.01 * size).all()


def test_loads_share_goes_over_twice_differentiably():
    s = np.linspace(0.0, 1.0, 2001)
    share = smooth_share(s)
    np.testing.assert_allclose(share[[0, 1000, -1]], [0.0, 0.5, 1.0])
    slope = np.gradient(share, s)
    bend = np.gradient(slope, s)
    assert slope.max() == pytest.approx(15.0 / 8.0, rel=2e-6)
    assert np.abs(bend[[2, -3]]).max() < 0.2 and np.abs(bend).max() > 5.0
    np.testing.assert_allclose(smooth_share(np.array([-1.0, 2.0])), [0, 1])


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("back_m", 0.12, "back_m must be below front_m"),
        ("outer_m", 0.06, "outer_m below inner_m"),
        ("double_support_s", 1.2, "double_support_s must be above 0"),
    ],
)
def test_contradictory_walk_is_refused(key, value, words):
    with pytest.raises(InputError, match=words):
        replace(ROBOT, **{key: value})


def test_the_programme_is_solved():
    """Against SciPy on a random problem with active bounds."""
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((12, 6)), rng.standard_normal(12)
    equal, value = rng.standard_normal((2, 6)), rng.standard_normal(2)
    rows = np.eye(6)[:4]
    p = _least_squares(A, b, equal, value, rows, -0.2, 0.25)
    np.testing.assert_allclose(equal @ p, value, atol=1e-9)
    other = minimize(
        lambda x: ((A @ x - b) ** 2).sum(),
        np.zeros(6),
        jac=lambda x: 2 * A.T @ (A @ x - b),
        bounds=[(-0.2, 0.25)] * 4 + [(None, None)] * 2,
        constraints=[{"type": "eq", "fun": lambda x: equal @ x - value,
                      "jac": lambda x: equal}],
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )  # fmt: skip
    assert other.success
    assert (
        np.isclose(other.x[:4], -0.2).any()
        | np.isclose(other.x[:4], 0.25).any()
    )
    np.testing.assert_allclose(p, other.x, atol=1e-5)
    # All signs turned round, lower bounds hold instead of upper ones.
    turned = _least_squares(A, -b, equal, -value, rows, -0.25, 0.2)
    np.testing.assert_allclose(turned, -p, atol=1e-6)


def test_each_foot_keeps_inside_its_bounds(pattern):
    """In single support exactly, in double support but for ρ."""
    t = np.linspace(0.195, 1.0, 200)
    z = pattern.zmp(t)
    assert (np.abs(z) <= [0.1 + 1e-6, 0.05 + 1e-6]).all()
    load = plan(replace(ROBOT, least_share=0.01)).foot_load()
    assert (np.abs(load.zmp) <= [0.102, 0.052]).all()


def test_tight_bounds_hold_the_zmp():
    free = plan(ROBOT).zmp(np.linspace(0.195, 1.0, 100))
    bound = 0.6 * np.abs(free[:, 0]).max()
    held = plan(replace(ROBOT, back_m=-bound, front_m=bound))
    z = held.zmp(np.linspace(0.195, 1.0, 161))
    assert np.abs(z[:, 0]).max() == pytest.approx(bound, rel=2e-4)


@pytest.mark.parametrize("weight", [0.6, 0.01, 0.0])
def test_bounds_that_hold_the_zmp_are_met(weight):
    """Where the programme looks, exactly; without torque, too."""
    t = np.linspace(0.0, 1.0, 161)
    held = plan(replace(ROBOT, back_m=-0.05, torque_weight=weight))
    z = held.zmp(t[t >= 0.195])
    landing = _feet(held.zmp, 1.0, 0.0, 0.195)[1]
    assert min(z[:, 0].min(), landing[0]) == pytest.approx(-0.05, abs=1e-10)
    assert z[:, 0].max() <= 0.1 + 1e-10


def test_a_walk_that_no_zmp_carries_is_refused():
    with pytest.raises(InputError, match="widen back_m to front_m"):
        plan(replace(ROBOT, double_support_s=0.05, front_m=0.02))
    # A slow step asks for the ZMP to change feet as slowly, not more slowly.
    slow = replace(ROBOT, step_time_s=10.0)
    with pytest.raises(InputError, match="or lengthen double_support_s"):
        plan(slow)
    plan(replace(slow, double_support_s=0.5))


def test_bounds_are_15_mm_inside_the_sole():
    """By default; of a sole that is no rectangle those of the largest one."""
    brick = np.array([[x, y] for x in (-0.115, 0.115) for y in (-0.065, 0.065)])
    np.testing.assert_allclose(Robot().within(brick).bounds, Robot().bounds)
    given = Robot(front_m=0.02).within(2 * brick)
    np.testing.assert_allclose(
        given.bounds, [[-0.215, -0.115], [0.02, 0.115]], atol=1e-9
    )
    angle = np.linspace(0, 2 * np.pi, 2000)
    disc = 0.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = (0.1 - 0.015) / np.sqrt(2)  # a square's, half
    np.testing.assert_allclose(
        Robot().within(disc).bounds, [[-side] * 2, [side] * 2], atol=1.5e-5
    )
    for narrow in (0.2 * brick, brick * [1.0, 0.2]):
        with pytest.raises(InputError, match="no place of the sole lies 15 mm"):
            Robot().within(narrow)


def test_straight_goes_from_heel_to_toe(pattern):
    load = pattern.foot_load().straight()
    assert np.abs(load.zmp[:, 1]).max() == 0.0
    assert np.abs(load.force[:, 1]).max() == 0.0
    assert load.zmp[0, 0] < -0.07
    assert load.zmp[-1, 0] > 0.04
    assert (np.diff(load.zmp[:, 0]) > -1e-3).all()


def test_authors_step_is_met(data_root):
    """ZMP within 5 mm RMS and vertical force within 3 %."""
    path = data_root / "soft_sole_hrp4/trajectory/one_foot_80kg_200Hz.txt"
    origin = (1.274728354176543, -0.056000000000611)
    theirs = OneFoot(path, origin).load(data_root)
    ours = Robot(least_share=0.01).load()
    # The file starts as the foot lands, 5.81 s; rows before 5.86 are cut.
    t = theirs.times - 5.81
    zmp = np.stack(
        [np.interp(t, ours.times, ours.zmp[:, k]) for k in range(2)], axis=1
    )
    rms = np.sqrt(((zmp - theirs.zmp) ** 2).sum(axis=1).mean())
    assert rms < 5e-3
    force = np.interp(t, ours.times, ours.force[:, 2])
    error = np.sqrt(((force - theirs.force[:, 2]) ** 2).mean())
    assert error < 0.03 * theirs.force[:, 2].max()


@pytest.mark.slow
def test_a_cycle_of_the_playback_is_met(data_root):
    """HRP-4: ZMP within 5 mm RMS, vertical force within 3 %.

    Mass, CoM height, timing and footprints are the playback's; the bounds
    leave 15 mm to the sole's edges and the weights are the defaults.
    """
    path = data_root / "soft_sole_hrp4/trajectory/hrp4_playback.txt"
    table = np.loadtxt(path)
    landing, period = 1283, 0.005  # right foot's, one step is 240 rows
    robot = Robot(
        43.0, 0.781739, 0.0525, 0.2301, 1.2, 0.4, -0.098, 0.098, 0.05, -0.05,
        ankle_m=(-0.015, 0.011), least_share=0.005,
    )  # fmt: skip
    pattern = plan(robot)
    # The total ZMP from landing to lift-off, in the right sole's frame.
    t = np.arange(321) * period
    centre = table[landing + 160, 22:24] + [0.015, -0.011]
    total = table[landing : landing + 321, 1:3] - centre
    error = pattern.at(pattern.zmp, t) - total
    assert np.sqrt((error**2).sum(axis=1).mean()) < 5e-3
    # One foot's, as the double supports are shared in a simulation.
    block = Playback(path, "right", 2, 43.0, least_force_n=5.0)
    theirs = block.load(data_root)
    ours = pattern.foot_load()
    when = theirs.times - landing * period
    own = np.stack(
        [np.interp(when, ours.times, ours.zmp[:, k]) for k in range(2)], axis=1
    )
    assert np.sqrt(((own - theirs.zmp) ** 2).sum(axis=1).mean()) < 5e-3
    force = np.interp(when, ours.times, ours.force[:, 2])
    error = np.abs(force - theirs.force[:, 2])
    assert error.max() < 0.03 * theirs.force[:, 2].max()
