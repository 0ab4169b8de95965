"""Events in recordings: seat-off and standing, heel strike and toe-off.

Heel strike and toe-off are where the force on a foot's own plates passes 20 N.

Seat-off is when the feet alone carry the body by Newton's law: the force that
the chair must bear, m (a_com + g) - F_z, has fallen to 5 % of body weight. A
threshold on F_z itself would be passed while the person still sits, because
the rise begins with a push well above body weight.

The wrench of a plate under the chair is used until its vertical force has
fallen to 5 % of body weight. The rest is faded out within 50 ms, so that no
step remains in the dynamics.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import COP_THRESHOLD_N, runs
from drake_exo.measurement.filters import minimum_jerk
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.assembly import SIDES

SEATED_SHARE = 0.5  # of body weight on the chair: clearly seated
CHAIR_SHARE = 0.05  # of body weight on the chair: seat-off
STEADY_SHARE = 0.1  # force within this share of body weight: standing
STEADY_S = 0.1  # time for which it must stay there
_MIN_RANGE_M = 0.15  # least vertical travel of the hips in a rise
_SHORTEST_S = 0.1  # shorter contacts are noise
_STOOD_SHARE = 0.1  # of the largest load: the foot stood there before
_CLEAR_S = 0.02  # least time between a whole contact and the file's ends


@dataclass(frozen=True)
class Rise:
    """One sit-to-stand rise, as told in provenance; recording's times [s].

    Attributes:
        seat_off_s: when the chair no longer bears weight (if it never did:
            when the hips are lowest).
        halfway_s: when the hips pass half their vertical range.
        standing_s: when body weight is borne steadily, else at the top.
        chair_bore_weight: whether a chair bore weight before.
        standing_is_steady: whether it was, before the next movement.
    """

    seat_off_s: float
    halfway_s: float
    standing_s: float
    chair_bore_weight: bool
    standing_is_steady: bool

    @property
    def part(self) -> tuple[float, float]:
        """Where a trial of it starts and ends [s]."""
        return self.seat_off_s, self.standing_s


@dataclass(frozen=True)
class Sit:
    """One stand-to-sit movement, likewise: a rise backwards.

    Attributes:
        standing_s: until when body weight is borne steadily, else the top.
        halfway_s: when the hips pass half their vertical range.
        seat_on_s: until when the chair bears no weight (if it never does:
            when the hips are lowest).
        chair_bore_weight: whether a chair bore weight afterwards.
        standing_is_steady: whether it was, after the movement before.
    """

    standing_s: float
    halfway_s: float
    seat_on_s: float
    chair_bore_weight: bool
    standing_is_steady: bool

    @property
    def part(self) -> tuple[float, float]:
        """Where a trial of it starts and ends [s]."""
        return self.standing_s, self.seat_on_s


def find_rises(
    time: np.ndarray,
    hip_z: np.ndarray,
    chair_force: np.ndarray,
    F_z: np.ndarray,
    weight: float,
) -> list[Rise]:
    """Find the sit-to-stand rises of a recording.

    Args:
        time: (N,) [s].
        hip_z: (N,) height of the hips [m], low-passed.
        chair_force: (N,) of the chair's plate, or m (a_com + g) - F_z [N].
        F_z: (N,) vertical force of the feet, less that of loads carried [N].
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
        # A rise may falter halfway, but must not sit down again.
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


def find_sits(time, hip_z, chair_force, F_z, weight: float) -> list[Sit]:
    """Find the stand-to-sit movements of a recording; as `find_rises`."""
    signals = (x[::-1] for x in (-time, hip_z, chair_force, F_z))
    return [
        Sit(
            -back.standing_s,
            -back.halfway_s,
            -back.seat_off_s,
            back.chair_bore_weight,
            back.standing_is_steady,
        )
        for back in reversed(find_rises(*signals, weight))
    ]


def _seat_off(hip_z, chair_force, weight, before, up):
    """Index of seat-off in `before` to `up`; whether a chair bore weight."""
    seated = np.flatnonzero(chair_force[before:up] > SEATED_SHARE * weight)
    if len(seated) == 0:
        return before + int(np.argmin(hip_z[before:up])), False
    start = before + seated[-1]
    free = np.flatnonzero(chair_force[start:up] < CHAIR_SHARE * weight)
    return (start + int(free[0]) if len(free) else up), True


def _standing(time, hip_z, F_z, weight, up, after):
    """Index of the first steady standing, else of the top; and if steady."""
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
    """Chair's wrench (N,), faded out where it bears below 5 % of weight.

    Args:
        time: (N,) [s].
        wrench: of the chair's plate, filtered and without offset.
        weight: body weight [N].
    """
    seated = np.flatnonzero(wrench.force[:, 1] >= CHAIR_SHARE * weight)
    if len(seated) == 0:
        return wrench.scaled(0.0)
    after = np.searchsorted(seated, np.arange(len(time)))
    later = time[seated[np.minimum(after, len(seated) - 1)]]
    earlier = time[seated[np.maximum(after - 1, 0)]]
    away = np.minimum(np.abs(later - time), np.abs(time - earlier))
    share = 1.0 - minimum_jerk(away / _FADE_S)[0]
    return wrench.scaled(share)


@dataclass(frozen=True)
class Contact:
    """A period in which a foot's plates are loaded.

    Attributes:
        start_s, end_s: times of the first and last loaded sample [s].
        begins, ends: whether touch-down and lift-off were recorded.
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
    """Periods in which a foot's plates bear at least a given force.

    Args:
        time: (N,) [s].
        F_z: (N,) sum of the plates' vertical forces, unfiltered [N].
        least_n: the force above which the foot is in contact [N].
    """
    found = []
    for a, b in runs(F_z >= least_n):
        if time[b - 1] - time[a] >= _SHORTEST_S:
            begins = bool(time[a] - time[0] >= _CLEAR_S)
            ends = bool(time[-1] - time[b - 1] >= _CLEAR_S)
            at = float(time[a]), float(time[b - 1])
            found.append(Contact(*at, begins, ends))
    return found


def heel_strikes(time: np.ndarray, F_z: np.ndarray) -> list[float]:
    """When a foot comes down [s]; a cycle may begin and end with the samples.

    Args:
        time: (N,) [s].
        F_z: (N,) vertical force under the foot [N].
    """
    found = []
    for a, b in runs(F_z >= COP_THRESHOLD_N):
        is_noise = time[b - 1] - time[a] < _SHORTEST_S and b < len(time)
        stood_before = a == 0 and F_z[0] > _STOOD_SHARE * F_z.max()
        if not (is_noise or stood_before):
            found.append(float(time[a]))
    return found


# Kind -> attributes of `Contact`: whether it was recorded, and its time.
_EVENTS = {"heel_strike": ("begins", "start_s"), "toe_off": ("ends", "end_s")}


def event_of(text: str) -> tuple[str, str, int]:
    """Kind, side and number, from 1, of an event of a foot in a recording.

    Raises:
        InputError: the text is not like "heel_strike right 1".

    >>> event_of("toe_off left 2")
    ('toe_off', 'left', 2)
    """
    known = f"({'|'.join(_EVENTS)}) ({'|'.join(SIDES)}) (0*[1-9][0-9]*)"
    match = re.fullmatch(known, " ".join(text.split()))
    if not match:
        raise InputError(
            f"{text!r} is not an event; say {' or '.join(_EVENTS)}, left "
            "or right, and which from 1, as in 'heel_strike right 1'"
        )
    return match[1], match[2], int(match[3])


def event_s(text: str, feet: Mapping[str, Sequence[Contact]]) -> float:
    """Time of an event in the recording [s].

    Args:
        text: the event, as for `event_of`.
        feet: side -> contacts of that foot; a foot without plates of its own
            has no entry.

    Raises:
        InputError: as `event_of`; the foot has no entry, or the event was not
            recorded.
    """
    kind, side, number = event_of(text)
    event = f"{kind} {side} {number}"
    if side not in feet:
        raise InputError(
            f"{event}: no plate is the {side} foot's alone; name it in "
            f"plates.{side}, or give a time"
        )
    whole, at = _EVENTS[kind]
    found = [getattr(c, at) for c in feet[side] if getattr(c, whole)]
    if number > len(found):
        when = ", ".join(f"{t:.2f} s" for t in found)
        raise InputError(
            f"{event}: the recording has {len(found)} {kind} of the "
            f"{side} foot{' at ' if when else ''}{when}; "
            f"{'name one of them, or ' if when else ''}give a time"
        )
    return found[number - 1]
