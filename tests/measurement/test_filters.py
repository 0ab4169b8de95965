import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement.filters import (
    derivatives,
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
    assert amplitude == pytest.approx(np.sqrt(0.5), abs=1e-3)
    assert phase == pytest.approx(0.0, abs=1e-3)


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
    assert np.abs(low_pass(x, 100.0) - x).max() < 0.02


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
    assert np.abs(resample(t, x, new) - expected).max() < 1e-5


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
