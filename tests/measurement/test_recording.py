"""Gaps of markers filled, and plates levelled."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.filters import fill_gaps
from drake_exo.measurement.recording import (
    FootForces,
    check_loaded,
    force_delay,
    level,
    unloaded,
)
from drake_exo.measurement.sagittal import PlanarWrench

FRAMES = np.arange(200) / 100.0
PATH = np.column_stack([np.sin(FRAMES), FRAMES**2, np.cos(2.0 * FRAMES)])


@pytest.fixture
def data():
    p = np.stack([PATH, 2.0 * PATH], axis=1)
    p[50:60, 1] = np.nan
    p[62:65, 1] = np.nan
    return MarkerData(FRAMES, ("a", "b"), p, 100.0, "f.c3d")


def test_gaps_are_filled_smoothly(data):
    found, gaps = fill_gaps(data, ["a", "b", "b"], 0.1)
    assert gaps.frames(0.0, 2.0) == {"b": 13}
    assert gaps.frames(0.55, 0.63) == {"b": 7}
    assert gaps.frames(0.7, 2.0) == {} and not gaps.too_long(0.0, 2.0)
    assert not gaps.hidden(["a", "b"]).any()
    gaps.check()
    np.testing.assert_allclose(found.positions[:, 1], 2.0 * PATH, atol=2e-5)
    np.testing.assert_array_equal(found.positions[:, 0], PATH)
    assert np.isnan(data.positions[55, 1]).all()  # the input stays


def test_markers_that_are_not_needed_keep_their_gaps(data):
    found, gaps = fill_gaps(data, ["a"], 0.0)
    assert gaps.unseen == {} and np.isnan(found.positions[55, 1]).all()


def test_longer_gaps_are_told_all_at_once(data):
    data.positions[:2, 0] = np.nan
    _, gaps = fill_gaps(data, ["a", "b"], 0.09)
    with pytest.raises(InputError) as error:
        gaps.check()
    text = str(error.value)
    assert "'a' in 2 frames from 0 s (0.02 s)" in text  # at the end
    assert "'b' in 10 frames from 0.5 s (0.1 s)" in text
    assert "0.62 s" not in text and "fill_gaps_s (0.09 s)" in text
    assert [g.marker for g in gaps.too_long(0.0, 0.4)] == ["a"]
    assert [g.marker for g in gaps.too_long(0.595, 2.0)] == []
    gaps.check(0.6, 2.0)


def test_what_is_hidden_for_long_is_bridged_and_marked(data):
    data.positions[-4:, 0] = np.nan
    found, gaps = fill_gaps(data, ["a", "b"], 0.05)
    hidden = gaps.hidden(["a", "b"])
    assert hidden[-4:, 0].all() and hidden[50:60, 1].all()
    assert hidden.sum() == 14
    assert np.ptp(found.positions[-5:, 0], axis=0).max() == 0.0
    middle = found.positions[[49, 60], 1].mean(axis=0)
    between = found.positions[54:56, 1].mean(axis=0)
    np.testing.assert_allclose(between, middle, atol=1e-9)


def test_unknown_markers_are_refused(data):
    with pytest.raises(InputError, match="no marker 'c'"):
        fill_gaps(data, ["c"], 1.0)


TIME = np.arange(4000) / 1000.0


def stance(start, end, force=400.0):
    ramp = 0.15
    up = np.clip((TIME - start) / ramp, 0.0, 1.0)
    down = np.clip((end - TIME) / ramp, 0.0, 1.0)
    return force * np.minimum(up, down)


def wrench(F_z, offset=(0.0, 0.0, 0.0), drift=(0.0, 0.0, 0.0)):
    rng = np.random.default_rng(0)
    values = np.column_stack([0.1 * F_z, F_z, -0.2 * F_z])
    values = values + offset + np.outer(TIME, drift)
    values = values + rng.normal(0.0, 1.0, values.shape)
    return PlanarWrench(values[:, :2], values[:, 2])


def test_offset_and_drift_come_out():
    F_z = stance(1.0, 3.0)
    raw = wrench(F_z, (2.0, -9.0, 1.5), (0.5, 2.0, -0.3))
    found, report = level(TIME, raw.array, 1, 20.0)
    assert report["offset_n"] == pytest.approx(-9.0, abs=0.2)
    assert report["drift_n_s"] == pytest.approx(2.0, abs=0.005)
    assert 1.0 < report["unloaded_s"] < 2.0
    truth = wrench(F_z)
    assert np.abs(found[:, :2] - truth.force).max() < 0.4
    assert np.abs(found[:, 2] - truth.moment).max() < 0.12


def test_a_plate_without_drift_is_left_as_it_is():
    raw = wrench(stance(-1.0, 1.5))
    found, report = level(TIME, raw.array, 1, 20.0)
    # Noise of 1 N over 2.3 s, extrapolated to the start: 0.07 N (one sigma).
    assert abs(report["offset_n"]) < 0.25 and abs(report["drift_n_s"]) < 0.1
    np.testing.assert_allclose(found[:, :2], raw.force, atol=0.3)


def test_one_short_unloaded_end_gives_an_offset_alone():
    raw = wrench(stance(-1.0, 3.0), (0.0, 6.0, 0.0))
    _, report = level(TIME, raw.array, 1, 20.0)
    assert report["drift_n_s"] == 0.0
    assert report["offset_n"] == pytest.approx(6.0, abs=0.2)


def test_a_loaded_plate_is_never_taken_for_empty():
    """Feet of somebody seated are a load, not an offset."""
    raw = wrench(150.0 + stance(1.0, 5.0))
    assert not unloaded(TIME, raw.force[:, 1], 20.0).any()
    found, report = level(TIME, raw.array, 1, 20.0)
    np.testing.assert_array_equal(found, raw.array)
    assert report == {"unloaded_s": 0.0}


def test_a_chair_is_tared():
    raw = wrench(60.0 + stance(-1.0, 2.0, 500.0))
    found, report = level(TIME, raw.array, 1, 200.0)
    assert report["offset_n"] == pytest.approx(60.0, abs=0.03)
    assert found[3000:, 1].mean() == pytest.approx(0.0, abs=0.1)


def test_moments_shorter_than_a_tenth_of_a_second_do_not_count():
    F_z = 300.0 * (1.0 - np.exp(-(((TIME - 2.0) / 0.03) ** 2)))
    assert not unloaded(TIME, F_z, 20.0).any()


SECONDS = np.arange(300) / 100.0


def pulse(t):
    return 700.0 + 300.0 * np.exp(-(((t - 1.4) / 0.2) ** 2))


@pytest.mark.parametrize("late", [-0.021, 0.0, 0.017])
def test_plates_are_timed_by_what_the_feet_must_bear(late):
    """To a millisecond, an offset of the force notwithstanding."""
    used = (SECONDS > 0.5) & (SECONDS < 2.5)
    force = pulse(SECONDS - late) + 15.0
    found = force_delay(SECONDS, pulse(SECONDS), force, used)
    assert found == pytest.approx(late)


def test_a_search_ends_at_its_reach():
    used = np.ones(300, bool)
    force = pulse(SECONDS - 0.1)
    assert force_delay(SECONDS, pulse(SECONDS), force, used, 0.03) == 0.03


def test_the_edges_of_an_unloaded_part_do_not_count():
    """A tenth of a second on either side, where it is longer than that."""
    F_z = np.full(len(TIME), 500.0)
    F_z[1000:2000] = 5.0
    F_z[3000:3280] = 5.0  # 80 ms are left of it: too few
    found = unloaded(TIME, F_z, 20.0)
    # Smoothing over 25 ms has taken 12 before.
    at = np.flatnonzero(found)
    assert at[0] == 1000 + 100 + 12
    assert at[-1] == 1999 - 100 - 12
    assert found.sum() == at[-1] - at[0] + 1
    F_z[3280:3360] = 5.0  # and now enough
    longer = unloaded(TIME, F_z, 20.0)
    assert longer[3100:3260].any()
    for least, seen in ((21.0, False), (19.0, True)):
        lifted = np.where(F_z < 10.0, least, F_z)
        assert unloaded(TIME, lifted, 20.0).any() == seen


def test_only_what_is_within_12_newtons_of_the_lowest_is_unloaded():
    F_z = np.full(len(TIME), 500.0)
    F_z[1000:2000] = 2.0
    for more, seen in ((11.0, True), (13.0, False)):
        F_z[2000:3000] = 2.0 + more
        assert unloaded(TIME, F_z, 20.0)[2500] == seen


def test_a_trend_needs_unloaded_parts_half_the_recording_apart():
    for last, powers in ((0.55, 2), (0.45, 1)):
        F_z = np.full(len(TIME), 500.0) + 2.0 * TIME
        n = len(TIME)
        F_z[: n // 8] = 2.0 * TIME[: n // 8]
        a, b = round((last - 0.1) * n), round((last + 0.06) * n)
        F_z[a:b] = 2.0 * TIME[a:b]
        raw = PlanarWrench(np.column_stack([0.0 * F_z, F_z]), 0.0 * F_z)
        _, report = level(TIME, raw.array, 1, 20.0)
        drift = report["drift_n_s"]
        assert drift == (pytest.approx(2.0) if powers == 2 else 0.0)


def test_feet_that_hang_for_a_while_are_loaded():
    force = np.array([[0.0, 0.0], [0.0, 700.0]])
    check_loaded("a.mot", PlanarWrench(force, [0.0, 0.0]), 700.0, "all")
    with pytest.raises(InputError, match=r"bear 0\.7 N at most \(all\)"):
        kilo = PlanarWrench(1e-3 * force, [0.0, 0.0])
        check_loaded("a.mot", kilo, 700.0, "all")


def both_plates(**wrenches):
    n = 5
    time = 2.0 + np.arange(n) / 1000.0
    found = {
        name: PlanarWrench.of(np.tile(np.array(w, float), (n, 1)))
        for name, w in wrenches.items()
    }
    plain = {
        name: np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (n, 1))
        for name in found
        if name != "chair"
    }
    return FootForces(time, found, "f.mot", recorded=plain)


def test_empty_plates_are_taken_out_by_their_mean():
    forces = both_plates(left=(1, 700, -30), chair=(2, 300, 50))
    empty = both_plates(left=(0.5, -4, 1), chair=(-0.5, 6, 2))
    found = forces.without(empty)
    np.testing.assert_allclose(found.wrenches["left"].array[0], [0.5, 704, -31])
    np.testing.assert_allclose(found.wrenches["chair"].array[0], [2.5, 294, 48])
    assert found.levels == {
        "left": {"empty_plate_n": -4.0}, "chair": {"empty_plate_n": 6.0},
    }  # fmt: skip
    # What judges centres of pressure would see feet in the air as loaded.
    bare = replace(empty, recorded={"left": np.full((7, 6), 0.5)})
    recorded = forces.without(bare).recorded["left"]
    np.testing.assert_allclose(recorded[0], [0.5, 1.5, 2.5, 3.5, 4.5, 5.5])


def test_one_plate_of_two_feet_counts_twice():
    for names, total in (
        (("left", "right"), 1000.0), (("left",), 1000.0), (("both",), 500.0),
    ):  # fmt: skip
        forces = both_plates(**dict.fromkeys(names, (0, 500, 0)))
        feet = forces.at(forces.time)
        np.testing.assert_allclose(forces.total(feet), total)
        assert forces.is_one_leg == (names == ("left",))
    assert forces.rate_hz == pytest.approx(1000.0)
    ramp = np.outer(np.arange(5.0), [1.0, 100.0, -7.0])
    forces = replace(forces, wrenches={"both": PlanarWrench.of(ramp)})
    beyond = forces.at(np.array([0.0, 2.0015, 9.0]))["both"]
    np.testing.assert_allclose(
        beyond.array, np.outer([0.0, 1.5, 4.0], [1.0, 100.0, -7.0]), atol=1e-9
    )


def test_a_belt_carries_the_plates_along():
    """Seen from the belt: each force acts further on, by speed and time."""
    forces = both_plates(left=(10, 700, -30))
    found = forces.on_belt(1.5)
    ahead = 1.5 * forces.time
    w, was = found.wrenches["left"], forces.wrenches["left"]
    np.testing.assert_allclose(w.force, was.force)
    np.testing.assert_allclose(w.cop_x - was.cop_x, ahead)
    shifted = np.cross(
        np.outer(ahead, [1.0, 0.0, 0.0]), forces.recorded["left"][:, :3]
    )
    np.testing.assert_allclose(
        found.recorded["left"][:, 3:], forces.recorded["left"][:, 3:] + shifted
    )
