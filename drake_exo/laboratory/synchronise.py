"""Clock offsets between motion capture and the other systems.

Systems that are started by hand, or filtered on their way, are milliseconds
apart; in a fast rise ten of them are tens of newtons. What the feet must bear
by Newton's law, from the markers alone, tells the plates' offset; the human's
joint angles tell the encoders'; what the cuffs must bear to move the
exoskeleton tells the pressure mats'.
"""

import numpy as np

_STEP_S = 0.001
# Share of a mat's variation that must be explained before a lag is believed.
EXPLAINED = 0.8


def _lags(reach_s: float) -> np.ndarray:
    count = round(reach_s / _STEP_S)
    return _STEP_S * np.arange(-count, count + 1)


def force_delay(
    time: np.ndarray,
    needed: np.ndarray,
    force: np.ndarray,
    used: np.ndarray,
    reach_s: float = 0.05,
) -> float:
    """By how much the recorded force lags behind the motion [s].

    Args:
        time: (N,) evenly spaced [s].
        needed: (N,) m (a_com + g) of the filtered motion [N].
        force: (N,) filtered vertical force of feet and chair [N].
        used: (N,) bool, where they alone bear the body.
        reach_s: largest delay either way.

    Returns:
        The delay, to 1 ms, at which the difference varies least.
    """
    delays = _lags(reach_s)
    spread = [
        np.std(needed[used] - np.interp(time[used] + delay, time, force))
        for delay in delays
    ]
    return round(float(delays[int(np.argmin(spread))]), 6)


def regressed_delay(
    time: np.ndarray,
    regressors: np.ndarray,
    signal_time: np.ndarray,
    signal: np.ndarray,
    reach_s: float,
) -> tuple[float, float]:
    """By how much a signal lags behind what explains it linearly [s].

    Args:
        time: (N,) evenly spaced [s].
        regressors: (N, k), or (N, c, k) with its own for each channel; a
            constant is added.
        signal_time: (M,) of the signal's own clock [s].
        signal: (M, c), filtered.
        reach_s: largest delay either way.

    Returns:
        The delay, to 1 ms, with the least unexplained variance, and the
        share of variance that is explained there.
    """
    inside = (time > signal_time[0] + reach_s) & (
        time < signal_time[-1] - reach_s
    )
    t, R = time[inside], regressors[inside]
    if len(t) < 20:
        return 0.0, 0.0
    channels = signal.shape[1]
    if R.ndim == 2:
        R = np.repeat(R[:, None], channels, axis=1)
    bases = []
    for c in range(channels):
        A = np.column_stack([np.ones(len(t)), R[:, c]])
        U, s, _ = np.linalg.svd(A / np.linalg.norm(A, axis=0).clip(1e-12), 0)
        bases.append(U[:, s > 1e-9 * s[0]])
    delays = _lags(reach_s)
    left = np.zeros(len(delays))
    for i, delay in enumerate(delays):
        total = 0.0
        for c, U in enumerate(bases):
            y = np.interp(t + delay, signal_time, signal[:, c])
            r = y - U @ (U.T @ y)
            left[i] += r @ r
            total += np.sum((y - y.mean()) ** 2)
        left[i] /= max(total, 1e-12)
    best = int(np.argmin(left))
    return round(float(delays[best]), 6), float(1.0 - left[best])
