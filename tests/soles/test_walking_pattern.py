"""Walking pattern: dynamics, periodicity, shares, the authors' step."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.soles import loads
from drake_exo.soles.case import Pattern as PatternBlock
from drake_exo.soles.walking_pattern import Robot, plan

ROBOT = Robot(
    80.0, 0.9, 0.2695, 0.165, 1.005, 0.19, -0.1, 0.048, 0.05, -0.055,
    torque_weight=0.7,
)  # fmt: skip


@pytest.fixture(scope="module")
def pattern():
    return plan(ROBOT)


def test_zmp_and_com_obey_the_pendulum(pattern):
    t = np.linspace(0.01, 1.0, 57)
    omega2 = 9.81 / 0.9
    np.testing.assert_allclose(
        pattern.zmp(t), pattern.com(t) - pattern.com(t, 2) / omega2, atol=1e-9
    )


def test_step_repeats_mirrored_and_ahead(pattern):
    for order in range(5):
        here, there = pattern.com(0.0, order), pattern.com(1.005, order)
        shift = [0.2695, 0.165] if order == 0 else [0, 0]
        scale = max(1.0, np.abs(here).max())
        np.testing.assert_allclose(
            there, [1, -1] * here + shift, atol=1e-5 * scale
        )


def test_zmp_is_twice_differentiable(pattern):
    knots = np.linspace(0, 1.005, 17)[1:-1]
    for order in (0, 1, 2):
        left = pattern.zmp(knots - 1e-9, order)
        right = pattern.zmp(knots + 1e-9, order)
        scale = max(1.0, np.abs(left).max())
        np.testing.assert_allclose(left, right, atol=1e-5 * scale)


def test_both_feet_carry_the_whole_load(pattern):
    load = pattern.foot_load(period=0.005, least=1e-6)
    first = load.times[0]
    share = load.force[:, 2] / (80 * 9.81)
    middle = (load.times > 0.2) & (load.times < 1.0)
    np.testing.assert_allclose(share[middle], 1.0, atol=1e-12)
    # Landing and lift-off of one double support: shares add up to one.
    landing = share[load.times <= 0.19 + 1e-9]
    off = share[load.times >= 1.005 - 1e-9]
    t_off = load.times[load.times >= 1.005 - 1e-9] - 1.005
    t_on = load.times[load.times <= 0.19 + 1e-9]
    both = np.interp(t_on, t_off, off) + landing
    inside = t_on < t_off[-1]
    np.testing.assert_allclose(both[inside], 1.0, atol=2e-3)
    assert first < 0.02
    # 5 ms apart: no jump, the ZMP moves at most at 0.6 m/s.
    assert np.abs(np.diff(load.zmp, axis=0)).max() < 3e-3
    assert np.abs(np.diff(load.force[:, 2])).max() < 0.06 * 80 * 9.81


@pytest.mark.parametrize(
    ("key", "value"),
    [("back", 0.06), ("outer", 0.06), ("double_support", 1.2)],
)
def test_contradictory_walk_is_refused(key, value):
    with pytest.raises(InputError, match="pattern"):
        replace(ROBOT, **{key: value})


def test_authors_step_is_met(data_root):
    """ZMP within 5 mm RMS and vertical force within 3 %."""
    path = data_root / "soft_sole_hrp4/trajectory/one_foot_80kg_200Hz.txt"
    theirs = loads.read_one_foot(path).placed(
        [1.274728354176543, -0.056000000000611], 0.0
    )
    ours = PatternBlock(least_share=0.01).load()
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
