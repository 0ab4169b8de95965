"""Clock offset between motion capture and the plates.

Systems that are started by hand, or filtered on their way, are milliseconds
apart; in a fast rise ten of them are tens of newtons. What the feet must bear
by Newton's law, from the markers alone, tells the plates' offset. That of a
device's encoders and mats nothing tells before the cuffs are known: they are
unknowns of the calibration (`calibration.clocks`).
"""

import numpy as np

_STEP_S = 0.001


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
