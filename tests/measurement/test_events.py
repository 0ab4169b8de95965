import numpy as np
import pytest

from drake_exo.measurement.events import find_rises, until_seat_off
from drake_exo.measurement.sagittal import PlanarWrench

TIME = np.arange(600) / 100.0
WEIGHT = 600.0


def smooth(start, end):
    s = np.clip((TIME - start) / (end - start), 0.0, 1.0)
    return 3 * s**2 - 2 * s**3


@pytest.fixture
def rise():
    """Heights, chair force and force of the feet of one rise."""
    hip = 0.5 + 0.4 * smooth(2.0, 3.0)
    chair = 0.9 * WEIGHT * (1.0 - smooth(1.4, 2.0))
    # The feet bear more than body weight while the hips accelerate.
    push = 250.0 * np.sin(2.0 * np.pi * np.clip(TIME - 2.0, 0.0, 1.0))
    return hip, chair, WEIGHT - chair + push


def find(hip, chair, F_z):
    return find_rises(TIME, hip, chair, F_z, WEIGHT)


def test_seat_off_is_where_the_chair_is_empty(rise):
    (found,) = find(*rise)
    _, chair, _ = rise
    at = np.searchsorted(TIME, found.seat_off_s - 1e-9)
    assert chair[at] < 0.05 * WEIGHT < chair[at - 1]
    assert found.had_chair
    assert found.halfway_s == pytest.approx(2.5, abs=0.02)
    # Standing: the swing of the force after the rise has settled.
    assert 2.85 < found.standing_s < 3.05 and found.is_steady


def test_a_push_before_seat_off_is_no_seat_off(rise):
    hip, chair, F_z = rise
    # The trunk is thrown forward: the feet see body weight, the chair more.
    bump = 500.0 * np.exp(-(((TIME - 1.0) / 0.1) ** 2))
    (found,) = find(hip, chair + 0.1 * bump, F_z + bump)
    assert found.seat_off_s > 1.8


def test_a_squat_starts_at_its_lowest_point():
    hip = 0.9 - 0.4 * np.sin(np.pi * TIME / 6.0) ** 2
    (found,) = find(hip, np.zeros(600), np.full(600, WEIGHT))
    assert found.seat_off_s == pytest.approx(3.0, abs=0.02)
    assert not found.had_chair


def test_the_chair_bears_until_a_twentieth_of_the_weight_is_left():
    """Then it fades within 50 ms."""
    load = np.interp(TIME, [1.0, 2.0], [0.5 * WEIGHT, 0.0])
    force = np.column_stack([0.1 * load, load])
    found = until_seat_off(TIME, PlanarWrench(force, -0.2 * load), WEIGHT)
    off = 1.0 + 0.9
    before, after = off - 1e-9 > TIME, off + 0.06 < TIME
    np.testing.assert_allclose(found.force[before], force[before])
    np.testing.assert_allclose(found.moment[before], -0.2 * load[before])
    assert not found.array[after].any()


def test_sitting_down_is_no_rise(rise):
    hip, chair, F_z = (x[::-1] for x in rise)
    assert find(hip, chair, F_z) == []


def test_half_a_rise_is_none(rise):
    hip, chair, F_z = rise
    tried = 0.5 + 0.25 * np.exp(-(((TIME - 1.0) / 0.2) ** 2))
    both = np.maximum(hip, tried)
    assert len(find(both, chair, F_z)) == 1


@pytest.mark.parametrize(("lowest", "count"), [(0.6, 2), (0.64, 1)])
def test_who_only_dips_does_not_rise_again(lowest, count):
    """Below 30 % of the way up from the lowest place is seated."""
    hip = 0.5 + 0.4 * smooth(0.5, 1.5)
    hip -= (0.9 - lowest) * (smooth(2.5, 3.2) - smooth(3.6, 4.3))
    rises = find(hip, np.zeros(600), np.full(600, WEIGHT))
    assert len(rises) == count


def test_shuffling_is_no_rise():
    hip = 0.9 + 0.05 * np.sin(TIME)
    assert find(hip, np.zeros(600), np.full(600, WEIGHT)) == []


def test_rise_cut_off_before_standing_is_steady(rise):
    hip, chair, F_z = (x[:280] for x in rise)
    hip = np.concatenate([hip, hip[::-1]])
    chair = np.concatenate([chair, chair[::-1]])
    F_z = np.concatenate([F_z, F_z[::-1]])
    (found,) = find_rises(np.arange(560) / 100.0, hip, chair, F_z, WEIGHT)
    assert not found.is_steady
    assert found.standing_s == pytest.approx(2.79, abs=0.02)
