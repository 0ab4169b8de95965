"""Clock offsets between motion capture and the other systems.

Systems that are started by hand, or filtered on their way, are milliseconds
apart; in a fast rise ten of them are tens of newtons. What the feet must bear
by Newton's law, from the markers alone, tells the plates' offset; that of
encoders and mats is found in `cuff_clock`.
"""

from collections.abc import Callable

import numpy as np

_STEP_S = 0.001
_COARSE = 4  # steps of the first search
# Share of variance that must be explained before a lag is believed.
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


def search_delay(
    left: Callable[[float], float], reach_s: float
) -> tuple[float, float]:
    """The delay that leaves the least unexplained, to 1 ms.

    Args:
        left: share of variance that a delay leaves unexplained.
        reach_s: largest delay either way [s].

    Returns:
        The delay [s], and the share that is explained there.
    """
    coarse = _lags(reach_s)[::_COARSE]
    best = min(coarse, key=left)
    fine = best + _STEP_S * np.arange(1 - _COARSE, _COARSE)
    fine = fine[np.abs(fine) <= reach_s + 1e-9]
    values = [left(delay) for delay in fine]
    found = int(np.argmin(values))
    return round(float(fine[found]), 6), 1.0 - values[found]
