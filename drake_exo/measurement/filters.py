"""Low-pass filtering and derivatives of recorded signals.

Zero-lag Butterworth: once forward, once backward. Both passes together damp
the cut-off by 1/sqrt(2), so each is designed for a higher one, by the factor
(2^(1/2) - 1)^(-1/(2 n)) of the warped frequency, n the order of a pass
(D. A. Winter, Biomechanics and Motor Control of Human Movement, 2.2.4.4).
"""

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from drake_exo.errors import InputError

MIN_FRAMES = 20
MIN_RATE_OVER_CUTOFF = 4.0


def check_filterable(
    source: str, num_frames: int, rate_hz: float, cutoff_hz: float
) -> None:
    """Refuse recordings that the filter cannot treat.

    Raises:
        InputError: fewer than 20 frames, or sampled below four times the
            cut-off.
    """
    if num_frames < MIN_FRAMES:
        raise InputError(
            f"{source}: holds {num_frames} frames, but filtering needs at "
            f"least {MIN_FRAMES}; record or export a longer part"
        )
    if rate_hz < MIN_RATE_OVER_CUTOFF * cutoff_hz * (1.0 - 1e-9):
        raise InputError(
            f"{source}: is sampled at {rate_hz:g} Hz, below four times the "
            f"filter's cut-off of {cutoff_hz:g} Hz; lower filter.cutoff_hz "
            f"to {rate_hz / MIN_RATE_OVER_CUTOFF:g} or record faster"
        )


def low_pass(
    values: np.ndarray,
    rate_hz: float,
    cutoff_hz: float = 6.0,
    order: int = 4,
    source: str = "signal",
) -> np.ndarray:
    """Zero-lag Butterworth low-pass along the first axis.

    Args:
        values: (N, ...) without gaps.
        rate_hz: samples per second.
        cutoff_hz: frequency damped by 1/sqrt(2) after both passes.
        order: in effect, after both passes (even).
        source: for messages.

    Raises:
        InputError: as `check_filterable`.
    """
    check_filterable(source, len(values), rate_hz, cutoff_hz)
    n = order // 2
    warped = np.tan(np.pi * cutoff_hz / rate_hz)
    warped *= (np.sqrt(2.0) - 1.0) ** (-0.5 / n)
    sos = butter(n, 2.0 / np.pi * np.arctan(warped), output="sos")
    # Three cut-off periods of odd reflection let the start transients die.
    pad = min(len(values) - 1, int(np.ceil(3.0 * rate_hz / cutoff_hz)))
    return sosfiltfilt(sos, values, axis=0, padtype="odd", padlen=pad)


def derivatives(
    time: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First and second time derivatives of smooth values (N, ...).

    By the interpolating quintic spline: exact for polynomials of degree
    five, no further smoothing.
    """
    spline = make_interp_spline(time, values, k=5, axis=0)
    return spline.derivative(1)(time), spline.derivative(2)(time)


def resample(
    time: np.ndarray, values: np.ndarray, new_time: np.ndarray
) -> np.ndarray:
    """Values of smooth signals (N, ...) at other times, by cubic spline."""
    return make_interp_spline(time, values, k=3, axis=0)(new_time)


def minimum_jerk(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The quintic step s^3 (10 - 15 s + 6 s^2), at rest at both ends.

    Args:
        s: share of the way; held at 0 and 1 beyond.

    Returns:
        The step and its first and second derivatives by s.
    """
    s = np.clip(s, 0.0, 1.0)
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )
