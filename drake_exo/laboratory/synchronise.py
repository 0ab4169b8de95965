"""Clock offset between motion capture and force plates.

Systems that are started by hand, or filtered on their way, are milliseconds
apart; in a fast rise ten of them are tens of newtons. What the feet must bear
by Newton's law, from the markers alone, tells the offset.
"""

import numpy as np

_REACH_S = 0.05
_STEP_S = 0.001


def force_delay(
    time: np.ndarray,
    needed: np.ndarray,
    force: np.ndarray,
    used: np.ndarray,
) -> float:
    """By how much the recorded force lags behind the motion [s].

    Args:
        time: (N,) evenly spaced [s].
        needed: (N,) m (a_com + g) of the filtered motion [N].
        force: (N,) filtered vertical force of both feet [N].
        used: (N,) bool, where the feet alone bear the body.

    Returns:
        The delay within 50 ms, to 1 ms, at which the difference varies
        least.
    """
    delays = np.arange(-_REACH_S, _REACH_S + 0.5 * _STEP_S, _STEP_S)
    spread = [
        np.std(needed[used] - np.interp(time[used] + delay, time, force))
        for delay in delays
    ]
    return round(float(delays[int(np.argmin(spread))]), 6)
