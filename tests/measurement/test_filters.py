import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.filters import (
    Gap,
    derivatives,
    fill_gaps,
    low_pass,
    minimum_jerk,
    resample,
)


def sine(hz, rate, seconds=20.0):
    t = np.arange(int(seconds * rate)) / rate
    return t, np.sin(2.0 * np.pi * hz * t)


def gain(hz, rate, **settings):
    """Amplitude and phase [rad] of the filtered sine, away from the ends."""
    t, x = sine(hz, rate)
    y = low_pass(x, rate, **settings)
    inner = slice(int(5 * rate), int(15 * rate))
    c = 2.0 * np.mean(y[inner] * np.exp(-2j * np.pi * hz * t[inner])) * 1j
    return abs(c), np.angle(c)


@pytest.mark.parametrize("rate", [25.0, 100.0, 1000.0])
@pytest.mark.parametrize("order", [2, 4, 8])
def test_cutoff_holds_after_both_passes(rate, order):
    amplitude, phase = gain(6.0, rate, order=order)
    assert amplitude == pytest.approx(np.sqrt(0.5))
    assert phase == pytest.approx(0.0, abs=1e-9)


def test_order_is_in_effect():
    # Two decades of amplitude a decade of frequency and order 2 of a pass:
    # fourth order falls by 2^4 an octave, far above the cut-off.
    low, _ = gain(24.0, 1000.0)
    high, _ = gain(48.0, 1000.0)
    assert low / high == pytest.approx(16.0, rel=0.05)


def test_constants_and_columns_pass():
    x = np.ones((40, 2, 3)) * np.arange(6).reshape(2, 3)
    np.testing.assert_allclose(low_pass(x, 100.0), x, atol=1e-12)


def test_slow_motion_is_untouched_up_to_the_ends():
    _, x = sine(0.5, 100.0, 1.0)
    assert np.abs(low_pass(x, 100.0) - x).max() < 1.5e-4


def test_refuses_slow_sampling():
    with pytest.raises(InputError, match=r"f\.trc.*23 Hz.*four times"):
        low_pass(np.zeros(100), 23.0, 6.0, source="f.trc")
    low_pass(np.zeros(100), 24.0, 6.0)


def test_refuses_short_recordings():
    with pytest.raises(InputError, match=r"holds 19 frames.*20"):
        low_pass(np.zeros(19), 100.0)
    low_pass(np.zeros(20), 100.0)


def test_derivatives_are_exact_for_quintics():
    t = np.linspace(0.0, 2.0, 30)
    p = np.poly1d([1.0, -3.0, 2.0, 0.5, -1.0, 4.0])
    x = np.column_stack([p(t), t])
    v, a = derivatives(t, x)
    np.testing.assert_allclose(v[:, 0], p.deriv()(t), atol=1e-9)
    np.testing.assert_allclose(a[:, 0], p.deriv(2)(t), atol=1e-7)
    np.testing.assert_allclose(v[:, 1], 1.0, atol=1e-10)


def test_resampling_a_smooth_signal():
    t, x = sine(1.0, 100.0, 2.0)
    new = np.linspace(0.0, t[-1], 357)
    expected = np.sin(2.0 * np.pi * new)
    assert np.abs(resample(t, x, new) - expected).max() < 1.5e-7


def test_minimum_jerk_and_its_derivatives():
    s = np.linspace(0.0, 1.0, 2001)
    step, rate, bend = minimum_jerk(s)
    np.testing.assert_allclose(step[[0, 1000, -1]], [0.0, 0.5, 1.0])
    np.testing.assert_allclose(rate[[0, 1000, -1]], [0.0, 15 / 8, 0.0])
    np.testing.assert_allclose(
        np.gradient(step, s)[1:-1], rate[1:-1], atol=1e-5
    )
    np.testing.assert_allclose(
        np.gradient(rate, s)[1:-1], bend[1:-1], atol=1e-4
    )
    beyond = np.array(minimum_jerk(np.array([-1.0, 2.0])))
    np.testing.assert_array_equal(beyond, [[0, 1], [0, 0], [0, 0]])


@pytest.mark.parametrize("order", [2, 4, 8])
def test_what_passes_beyond_the_cut_off(order):
    """Both passes of a bilinear Butterworth: 1 / (1 + c x^2n)."""
    amplitude, _ = gain(9.0, 100.0, order=order)
    x = np.tan(np.pi * 9.0 / 100.0) / np.tan(np.pi * 6.0 / 100.0)
    expected = 1.0 / (1.0 + (np.sqrt(2.0) - 1.0) * x**order)
    assert amplitude == pytest.approx(expected)


def hidden_markers():
    """Three markers on cubics, 100 Hz; gaps of 5, 8, 20 and at an end."""
    time = 2.0 + np.arange(100) / 100.0
    curve = np.polynomial.Polynomial([0.3, 0.2, -0.4, 0.1])
    path = np.column_stack([curve(time), 2.0 * curve(time), 1.0 - time])
    p = np.stack([path, path + 1.0, path + 2.0], axis=1)
    for marker, a, b in ((0, 10, 15), (0, 40, 48), (1, 30, 50), (2, 95, 100)):
        p[a:b, marker] = np.nan
    return path, MarkerData(time, ("A", "B", "C"), p, 100.0, "m.trc")


def test_short_gaps_are_filled_by_splines_long_ones_by_lines():
    path, data = hidden_markers()
    filled, gaps = fill_gaps(data, ("A", "B", "C"), 0.08)
    p = filled.positions
    np.testing.assert_allclose(p[:, 0], path, atol=1e-9)
    lines = np.column_stack(
        [np.interp(data.time[30:50], data.time[[29, 50]], x)
         for x in path[[29, 50]].T]
    )  # fmt: skip
    np.testing.assert_allclose(p[30:50, 1], lines + 1.0)
    np.testing.assert_allclose(p[95:, 2], np.tile(path[94] + 2.0, (5, 1)))
    _, exact = fill_gaps(data, ("A",), np.nextafter(0.08, 0.0))
    assert not exact.hidden(["A"]).any()
    hidden = gaps.hidden(["A", "B", "C"])
    assert not hidden[:, 0].any()
    assert np.flatnonzero(hidden[:, 1]).tolist() == list(range(30, 50))
    assert np.flatnonzero(hidden[:, 2]).tolist() == list(range(95, 100))


def test_gaps_are_told_where_they_reach_into_a_part():
    _, data = hidden_markers()
    _, gaps = fill_gaps(data, ("A", "B", "C"), 0.07)
    found = gaps.too_long(2.0, 2.99)
    assert [(g.marker, g.frames) for g in found] == [
        ("A", 8), ("B", 20), ("C", 5),
    ]  # fmt: skip
    assert found[1].start_s == pytest.approx(2.30)
    assert found[1].length_s == pytest.approx(0.2)
    assert [g.marker for g in gaps.too_long(2.49, 2.6)] == ["B"]
    assert gaps.too_long(2.50, 2.6) == []
    assert gaps.frames(2.12, 2.44) == {"A": 3 + 5, "B": 15}
    # However a time is rounded.
    start, end = np.nextafter(data.time[[12, 44]], [3.0, 0.0])
    assert gaps.frames(start, end) == {"A": 3 + 5, "B": 15}
    with pytest.raises(InputError, match=r"'B' in 20 frames from 2\.3 s"):
        gaps.check(2.4, 2.6)
    gaps.check(2.6, 2.9)
    many = [Gap(f"m{k}", 1.0, 2, 0.02) for k in range(14)]
    said = gaps.sentence(many)
    assert "'m11'" in said and "'m12'" not in said
    assert said.endswith("and 2 more gaps")
