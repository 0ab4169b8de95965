"""Events of a sit-to-stand: seat-off and standing, and the chair until then.

And of a walk: heel strike and toe-off, where a foot's own plates pass 20 N.

Seat-off is where the feet carry the whole body by Newton's law: what the
chair must bear, m (a_com + g) - F_z, has fallen to a small share of body
weight. A bare threshold on F_z would be passed while still seated, since the
rise begins with a push well above body weight.

The wrench of a plate under the chair counts until its vertical force has
fallen to 5 % of body weight. What is left then is faded out within 50 ms, so
that no step remains in the dynamics.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import runs
from drake_exo.measurement.filters import minimum_jerk
from drake_exo.measurement.sagittal import COP_THRESHOLD_N, PlanarWrench
from drake_exo.model.assembly import SIDES

SEATED_SHARE = 0.5  # of body weight on the chair: clearly seated
CHAIR_SHARE = 0.05  # of body weight on the chair: seat-off
STEADY_SHARE = 0.1  # force within this share of body weight: standing
STEADY_S = 0.1  # for so long
_MIN_RANGE_M = 0.15  # hips that move less do not rise
_SHORTEST_S = 0.1  # contacts below are noise
_CLEAR_S = 0.02  # a whole contact leaves so much at either end of the file


@dataclass(frozen=True)
class Rise:
    """One rise.

    Attributes:
        seat_off_s: the chair bears nothing any more (without a chair: the
            lowest point).
        halfway_s: the hips pass half their height.
        standing_s: body weight is borne steadily, or else the highest point.
        had_chair: whether a chair bore weight before.
        is_steady: whether standing became steady before the next movement.
    """

    seat_off_s: float
    halfway_s: float
    standing_s: float
    had_chair: bool
    is_steady: bool


def find_rises(
    time: np.ndarray,
    hip_z: np.ndarray,
    chair_force: np.ndarray,
    F_z: np.ndarray,
    weight: float,
) -> list[Rise]:
    """Find rises in a recording.

    Args:
        time: (N,) [s].
        hip_z: (N,) height of the hips [m], low-passed.
        chair_force: (N,) m (a_com + g) - F_z [N].
        F_z: (N,) vertical force of the feet, less what is carried [N].
        weight: body weight [N].
    """
    low, high = hip_z.min(), hip_z.max()
    if high - low < _MIN_RANGE_M:
        return []
    rises = []
    above = hip_z > 0.5 * (low + high)
    sits = hip_z < low + 0.3 * (high - low)
    stands = hip_z >= low + 0.8 * (high - low)
    ups = np.flatnonzero(~above[:-1] & above[1:]) + 1
    downs = np.flatnonzero(above[:-1] & ~above[1:]) + 1
    for up in ups:
        before = downs[downs < up].max(initial=0)
        top = up + int(np.argmax(stands[up:]))
        # It may falter halfway, but does not sit down again.
        if not sits[before:up].any() or not stands[top] or sits[up:top].any():
            continue
        after = downs[downs > top].min(initial=len(time) - 1)
        start, had_chair = _seat_off(hip_z, chair_force, weight, before, up)
        end, steady = _standing(time, hip_z, F_z, weight, up, after)
        rises.append(
            Rise(
                float(time[start]),
                float(time[up]),
                float(time[end]),
                had_chair,
                steady,
            )
        )
    return rises


def _seat_off(hip_z, chair_force, weight, before, up):
    """Index of seat-off between `before` and `up`."""
    seated = np.flatnonzero(chair_force[before:up] > SEATED_SHARE * weight)
    if len(seated) == 0:
        return before + int(np.argmin(hip_z[before:up])), False
    start = before + seated[-1]
    free = np.flatnonzero(chair_force[start:up] < CHAIR_SHARE * weight)
    return (start + int(free[0]) if len(free) else up), True


def _standing(time, hip_z, F_z, weight, up, after):
    """Index where body weight is first borne steadily, after the top."""
    top = up + int(
        np.argmax(hip_z[up : after + 1] >= 0.98 * (hip_z[up : after + 1].max()))
    )
    steady = np.abs(F_z - weight) < STEADY_SHARE * weight
    count = max(round(STEADY_S / (time[1] - time[0])), 1)
    for i in range(top, after - count + 1):
        if steady[i : i + count + 1].all():
            return i, True
    return up + int(np.argmax(hip_z[up : after + 1])), False


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
    share = 1.0 - minimum_jerk(away / _FADE_S)[0]
    return PlanarWrench(share[:, None] * wrench.force, share * wrench.moment)


@dataclass(frozen=True)
class Contact:
    """Times between which a plate is loaded, and what of it was recorded.

    Attributes:
        start_s, end_s: first and last loaded sample [s].
        begins, ends: whether the recording holds its begin and its end.
    """

    start_s: float
    end_s: float
    begins: bool
    ends: bool

    def __str__(self) -> str:
        cut = []
        if not self.begins:
            cut.append("the recording begins within it")
        if not self.ends:
            cut.append("the recording ends within it")
        said = f" ({', '.join(cut)})" if cut else ""
        return f"{self.start_s:.2f} to {self.end_s:.2f} s{said}"


def contacts(
    time: np.ndarray, F_z: np.ndarray, least_n: float = COP_THRESHOLD_N
) -> list[Contact]:
    """Where a foot's plates bear a force or more.

    Args:
        time: (N,) [s].
        F_z: (N,) vertical force of all of them, unfiltered [N].
        least_n: that force [N].
    """
    found = []
    for a, b in runs(F_z >= least_n):
        if time[b - 1] - time[a] >= _SHORTEST_S:
            begins = bool(time[a] - time[0] >= _CLEAR_S)
            ends = bool(time[-1] - time[b - 1] >= _CLEAR_S)
            at = float(time[a]), float(time[b - 1])
            found.append(Contact(*at, begins, ends))
    return found


@dataclass(frozen=True)
class FootEvent:
    """An event of a walk by name.

    Attributes:
        kind: "heel_strike" or "toe_off".
        side: of the foot.
        number: which of them in the recording, from 1.
    """

    kind: str
    side: str
    number: int

    @staticmethod
    def of(text: str) -> "FootEvent":
        """From words such as "heel_strike right 1".

        Raises:
            InputError: it does not say an event.

        >>> FootEvent.of("toe_off left 2").number
        2
        """
        known = f"({'|'.join(_EVENTS)}) ({'|'.join(SIDES)}) (0*[1-9][0-9]*)"
        match = re.fullmatch(known, " ".join(text.split()))
        if not match:
            raise InputError(
                f"{text!r} is not an event; say {' or '.join(_EVENTS)}, left "
                "or right, and which from 1, as in 'heel_strike right 1'"
            )
        return FootEvent(match[1], match[2], int(match[3]))

    def __str__(self) -> str:
        return f"{self.kind} {self.side} {self.number}"

    def time_s(self, feet: Mapping[str, Sequence[Contact]]) -> float:
        """When it is [s].

        Args:
            feet: side -> contacts of that foot; those without a plate of
                their own are left out.

        Raises:
            InputError: it was not recorded.
        """
        if self.side not in feet:
            raise InputError(
                f"{self}: no plate is the {self.side} foot's alone; name it in "
                f"plates.{self.side}, or give a time"
            )
        whole, at = _EVENTS[self.kind]
        found = [getattr(c, at) for c in feet[self.side] if getattr(c, whole)]
        if self.number > len(found):
            when = ", ".join(f"{t:.2f} s" for t in found)
            raise InputError(
                f"{self}: the recording has {len(found)} {self.kind} of the "
                f"{self.side} foot{' at ' if when else ''}{when}; name one of "
                "them, or give a time"
            )
        return found[self.number - 1]


# Which contacts have such an event, and when.
_EVENTS = {"heel_strike": ("begins", "start_s"), "toe_off": ("ends", "end_s")}
