"""What the plate under the chair says of the body on it.

Its wrench acts on the pelvis (a share on the thighs, if the study says so)
until its vertical force has fallen to 5 % of body weight. What is left then
is faded out within 50 ms, so that no step remains in the dynamics.
"""

import numpy as np

from drake_exo.laboratory.rises import CHAIR_SHARE
from drake_exo.laboratory.sagittal import PlanarWrench

_FADE_S = 0.05


def until_seat_off(
    time: np.ndarray, wrench: PlanarWrench, weight: float
) -> PlanarWrench:
    """The chair's wrench while somebody sits on it, zero elsewhere.

    Args:
        time: (N,) [s].
        wrench: filtered and tared.
        weight: body weight [N].
    """
    seated = np.flatnonzero(wrench.force[:, 1] >= CHAIR_SHARE * weight)
    if len(seated) == 0:
        return PlanarWrench(0.0 * wrench.force, 0.0 * wrench.moment)
    after = np.searchsorted(seated, np.arange(len(time)))
    later = time[seated[np.minimum(after, len(seated) - 1)]]
    earlier = time[seated[np.maximum(after - 1, 0)]]
    away = np.minimum(np.abs(later - time), np.abs(time - earlier))
    s = np.clip(away / _FADE_S, 0.0, 1.0)
    share = 1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return PlanarWrench(share[:, None] * wrench.force, share * wrench.moment)


def on_segments(chair: np.ndarray, on_thighs: float) -> dict[str, PlanarWrench]:
    """The chair's wrench (N, 3) as loads of inverse dynamics, by segment."""
    loads = {}
    for segment, share in (("pelvis", 1.0 - on_thighs), ("thigh", on_thighs)):
        if share > 0.0:
            loads[segment] = PlanarWrench(
                share * chair[:, :2], share * chair[:, 2]
            )
    return loads
