from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement.events import (
    Contact,
    contacts,
    event_of,
    event_s,
    find_rises,
    find_sits,
    heel_strikes,
    until_seat_off,
)
from drake_exo.measurement.processing import _seating
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
    assert found.chair_bore_weight
    assert found.halfway_s == pytest.approx(2.5, abs=0.02)
    # Standing: the swing of the force after the rise has settled.
    assert 2.85 < found.standing_s < 3.05 and found.standing_is_steady


@pytest.mark.parametrize("kg", [15.0, -15.0])
def test_standing_is_found_whatever_is_carried(rise, kg):
    """As without a rucksack, or a hand that pulls up, of a quarter's weight."""
    hip, chair, F_z = rise
    (plain,) = find(*rise)

    def wrench(force):
        return PlanarWrench(np.column_stack([0 * TIME, force]), 0 * TIME)

    carried = wrench(0 * TIME - 9.81 * kg)
    motion = SimpleNamespace(time=TIME, hip_z=hip, applied={"pelvis": carried})
    plates = SimpleNamespace(total=lambda feet: F_z + 9.81 * kg)
    rigid = SimpleNamespace(tree=SimpleNamespace(weight=WEIGHT))
    seating = _seating(motion, {}, wrench(chair), plates, rigid)
    assert find_rises(*seating) == [plain]


def test_a_push_before_seat_off_is_no_seat_off(rise):
    hip, chair, F_z = rise
    # The trunk is thrown forward: the feet see body weight, the chair more.
    bump = 500.0 * np.exp(-(((TIME - 1.0) / 0.1) ** 2))
    (found,) = find(hip, chair + 0.1 * bump, F_z + bump)
    assert found.seat_off_s > 1.8


def test_a_squat_starts_at_its_lowest_point():
    hip = 0.9 - 0.4 * np.sin(np.pi * TIME / 6.0) ** 2
    (found,) = find(hip, np.zeros(600), np.full(600, WEIGHT))
    assert found.seat_off_s == pytest.approx(3.0)
    assert not found.chair_bore_weight


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


def test_a_sit_is_a_rise_backwards(rise):
    """From steady standing until the chair bears a twentieth of the weight."""
    (up,) = find(*rise)
    hip, chair, F_z = (x[::-1] for x in rise)
    (down,) = find_sits(TIME, hip, chair, F_z, WEIGHT)
    assert down.part == pytest.approx(
        (5.99 - up.standing_s, 5.99 - up.seat_off_s)
    )
    at = np.searchsorted(TIME, down.seat_on_s - 1e-9)
    assert chair[at] < 0.05 * WEIGHT < chair[at + 1]
    assert down.halfway_s == pytest.approx(5.99 - up.halfway_s)
    assert down.chair_bore_weight and down.standing_is_steady
    assert find_sits(TIME, *rise, WEIGHT) == []


def test_sits_are_numbered_as_they_come(rise):
    """Down, up and down again."""
    hip, chair, F_z = (np.concatenate([x[::-1], x, x[::-1]]) for x in rise)
    time = np.arange(1800) / 100.0
    first, second = find_sits(time, hip, chair, F_z, WEIGHT)
    assert first.seat_on_s < 6.0 and second.standing_s > 12.0


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


def test_who_falters_halfway_rises_all_the_same():
    """It passes half its height twice, and the chair is left once."""
    hip = 0.5 + 0.21 * smooth(1.0, 1.6) + 0.19 * smooth(2.4, 3.0)
    hip -= 0.02 * smooth(1.6, 1.8) - 0.02 * smooth(2.0, 2.2)
    hip += 0.5 * (smooth(4.5, 5.0) * 0.0)
    chair = 0.9 * WEIGHT * (1.0 - smooth(0.4, 1.0))
    (rise,) = find(hip, chair, WEIGHT - chair)
    assert 0.8 < rise.seat_off_s < 1.05 and rise.chair_bore_weight
    assert 1.2 < rise.halfway_s < 1.6
    assert rise.standing_s > 2.8


def test_shuffling_is_no_rise():
    hip = 0.9 + 0.05 * np.sin(TIME)
    assert find(hip, np.zeros(600), np.full(600, WEIGHT)) == []


def test_rise_cut_off_before_standing_is_steady(rise):
    hip, chair, F_z = (x[:280] for x in rise)
    hip = np.concatenate([hip, hip[::-1]])
    chair = np.concatenate([chair, chair[::-1]])
    F_z = np.concatenate([F_z, F_z[::-1]])
    (found,) = find_rises(np.arange(560) / 100.0, hip, chair, F_z, WEIGHT)
    assert not found.standing_is_steady
    assert found.standing_s == pytest.approx(2.79)


def test_a_chairs_force_fades_with_least_jerk_on_either_side():
    """Who sits from 1 to 2 s: half is left 25 ms before and after."""
    time = np.arange(3001) / 1000.0
    inside = (time >= 1.0) & (time <= 2.0)
    load = np.where(inside, 300.0, 0.04 * WEIGHT)
    wrench = PlanarWrench(np.column_stack([load, load]), -load)
    found = until_seat_off(time, wrench, WEIGHT)

    def at(t):
        return found.force[round(1000 * t), 1] / (0.04 * WEIGHT)

    # 10 s³ - 15 s⁴ + 6 s⁵ at a fifth, a half and four fifths of 50 ms.
    for s, gone in ((0.2, 0.05792), (0.5, 0.5), (0.8, 0.94208)):
        for t in (1.0 - 0.05 * s, 2.0 + 0.05 * s):
            assert at(t) == pytest.approx(1.0 - gone)
    np.testing.assert_allclose(found.force[:, 0], -found.moment)
    np.testing.assert_allclose(found.force[inside], 300.0)
    none = until_seat_off(time, wrench, 1e5)
    assert not none.array.any()


def test_a_contact_is_long_enough_and_whole_or_not():
    """0.1 s or more; whole where 20 ms are left before and after."""
    time = np.arange(2000) / 1000.0
    spans = [(0, 150), (300, 399), (500, 603), (1000, 1500), (1800, 1990)]
    F_z = np.zeros(2000)
    for a, b in spans:
        F_z[a:b] = 20.0
    F_z[620:900] = 19.9
    found = contacts(time, F_z)
    assert [(c.start_s, c.end_s) for c in found] == [
        (0.0, 0.149),
        (0.5, 0.602),
        (1.0, 1.499),
        (1.8, 1.989),
    ]
    assert [c.begins for c in found] == [False, True, True, True]
    assert [c.ends for c in found] == [True, True, True, False]
    assert "begins within" in str(found[0]) and "ends within" in str(found[3])
    assert str(found[2]) == "1.00 to 1.50 s"
    shifted = contacts(time + 3.0, F_z)
    assert [c.begins for c in shifted] == [c.begins for c in found]
    # A millisecond more and less than 20 ms.
    for skipped, whole in ((21, True), (19, False)):
        at = np.arange(20.0 - skipped, 1020.0 - skipped) / 1000.0
        F_z = np.zeros(1000)
        F_z[skipped : 1000 - skipped] = 50.0
        (found,) = contacts(at, F_z)
        assert (found.begins, found.ends) == (whole, whole)


def test_events_of_a_walk_are_counted_among_whole_contacts():
    cut = Contact(0.0, 0.4, begins=False, ends=True)
    whole = Contact(1.0, 1.6, begins=True, ends=True)
    last = Contact(2.1, 2.9, begins=True, ends=False)
    feet = {"left": [cut, whole, last]}
    for text, time in (
        ("heel_strike left 1", 1.0),
        ("heel_strike left 2", 2.1),
        ("toe_off left 1", 0.4),
        ("toe_off left 2", 1.6),
    ):
        assert " ".join(map(str, event_of(text))) == text
        assert event_s(text, feet) == time
    with pytest.raises(InputError, match=r"2 toe_off .* at 0\.40 s, 1\.60 s"):
        event_s("toe_off left 3", feet)
    for text in ("toe_off left", "toe_off left 0", "toe_off both 1", "a b c d",
                 "toe_off left 1 2"):  # fmt: skip
        with pytest.raises(InputError, match="is not an event"):
            event_of(text)


def test_standing_is_steady_within_a_tenth_for_a_tenth_of_a_second(rise):
    """From the first such sample on, near the top."""
    hip, chair, _ = rise
    F_z = np.full(600, 1.2 * WEIGHT)
    F_z[296:305] = WEIGHT  # nine samples are too few
    F_z[330:341] = 1.09 * WEIGHT  # eleven are 0.1 s
    (found,) = find(hip, chair, F_z)
    assert found.standing_is_steady and found.standing_s == pytest.approx(3.3)
    F_z[330:341] = 1.11 * WEIGHT
    (found,) = find(hip, chair, F_z)
    assert not found.standing_is_steady
    # Where 98 % of the height are reached, at the earliest.
    (found,) = find(hip, chair, np.full(600, WEIGHT))
    top = TIME[np.argmax(hip >= 0.98 * 0.9)]
    assert found.standing_s == pytest.approx(top)


@pytest.mark.parametrize(("highest", "count"), [(0.79, 0), (0.83, 1)])
def test_who_rises_four_fifths_of_the_way_rises(highest, count):
    """After one whole rise, another from the chair."""
    hip = 0.5 + 0.4 * (smooth(0.5, 1.2) - smooth(2.0, 2.7))
    hip += (highest - 0.5) * smooth(3.5, 4.2)
    rises = find(hip, np.zeros(600), np.full(600, WEIGHT))
    assert len(rises) == 1 + count
    assert rises[0].halfway_s == pytest.approx(0.85, abs=0.02)


def test_hips_move_15_cm_in_a_rise(rise):
    _, chair, F_z = rise
    for high, count in ((0.149, 0), (0.151, 1)):
        hip = 0.5 + high * smooth(2.0, 3.0)
        assert len(find(hip, chair, F_z)) == count


def test_the_chair_bore_half_the_weight_before(rise):
    hip, _, F_z = rise
    for share, had in ((0.49, False), (0.51, True)):
        chair = share * WEIGHT * (1.0 - smooth(1.4, 2.0))
        (found,) = find(hip, chair, F_z)
        assert found.chair_bore_weight is had


@pytest.mark.parametrize(
    ("force", "strikes"),
    [
        ([0, 0, 700, 700, 700, 0, 0, 30], [0.2, 0.7]),  # the trial's last
        ([50, 400, 700, 700, 0, 0, 0, 0], [0.0]),  # its first
        ([600, 700, 700, 0, 0, 0, 0, 0], []),  # stood there before
        ([0, 0, 30, 0, 700, 700, 700, 0], [0.4]),  # noise
    ],
)
def test_a_cycle_may_begin_and_end_with_the_trial(force, strikes):
    times = 0.1 * np.arange(8.0)
    found = heel_strikes(times, np.array(force, dtype=float))
    np.testing.assert_allclose(found, strikes)
