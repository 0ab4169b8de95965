"""Offset and drift of force plates, from samples with nothing on them."""

import numpy as np

from drake_exo.laboratory.sagittal import PlanarWrench

_BAND_N = 12.0  # unloaded samples scatter within this around their level
_SMOOTH_S = 0.025
_SHORTEST_S = 0.1  # unloaded for at least so long
_EDGE_S = 0.1  # cut from either side of an unloaded part
_TREND_SHARE = 0.5  # of the recording that unloaded parts must span
# A level beyond this is a load, not drift. A chair may not have been tared.
LARGEST_FOOT_N = 20.0
LARGEST_CHAIR_N = 200.0


def unloaded(time: np.ndarray, F_z: np.ndarray, largest_n: float):
    """Samples (N,) at which a plate bears nothing.

    The lowest steady level of the recording counts as unloaded if it is
    within `largest_n` of zero.

    Args:
        time: (N,) evenly spaced [s].
        F_z: (N,) vertical force [N], unfiltered.
        largest_n: largest offset that may be drift.
    """
    step = time[1] - time[0]
    width = max(round(_SMOOTH_S / step), 1)
    padded = np.pad(F_z, width, mode="edge")
    smooth = np.convolve(padded, np.ones(width) / width, mode="same")
    smooth = smooth[width:-width]
    near = np.abs(smooth - np.quantile(smooth, 0.02)) < _BAND_N
    edges = np.flatnonzero(np.diff(np.r_[0, near, 0])).reshape(-1, 2)
    for start, end in edges:
        # Its edges are still, or already, a load.
        cut = round(_EDGE_S / step)
        long = end - start - 2 * cut >= _SHORTEST_S / step
        near[start : start + cut if long else end] = False
        near[end - cut if long else start : end] = False
    if not near.any() or abs(np.median(F_z[near])) > largest_n:
        return np.zeros(len(time), bool)
    return near


def level(
    time: np.ndarray, wrench: PlanarWrench, largest_n: float
) -> tuple[PlanarWrench, dict]:
    """Take offset, and a linear drift where it shows, out of a plate.

    Args:
        time: (N,) [s].
        wrench: unfiltered, as recorded.
        largest_n: as for `unloaded`.

    Returns:
        The levelled wrench, and what was found: offset_n of F_z at the
        start, drift_n_s, and unloaded_s, the time it was seen for.
    """
    empty = unloaded(time, wrench.force[:, 1], largest_n)
    seen = float(empty.sum() * (time[1] - time[0]))
    if not empty.any():
        return wrench, {"unloaded_s": 0.0}
    t = (time - time[0]) / (time[-1] - time[0])
    spans = t[empty].max() - t[empty].min()
    powers = 2 if spans > _TREND_SHARE else 1
    A = np.vander(t, powers, increasing=True)
    values = np.column_stack([wrench.force, wrench.moment])
    c = np.linalg.lstsq(A[empty], values[empty], rcond=None)[0]
    values = values - A @ c
    drift = float(c[1, 1] / (time[-1] - time[0])) if powers == 2 else 0.0
    return PlanarWrench(values[:, :2], values[:, 2]), {
        "offset_n": float(c[0, 1]),
        "drift_n_s": drift,
        "unloaded_s": seen,
    }
