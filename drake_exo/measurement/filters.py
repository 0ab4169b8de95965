"""Filtering, differentiation and gap filling of recorded signals.

The low-pass is a Butterworth filter, run forward and backward (zero lag). Both
passes together damp the cut-off frequency by 1/sqrt(2), so each is designed
for a cut-off whose warped frequency is (2^(1/2) - 1)^(-1/(2 n)) times higher,
n the order of a pass (D. A. Winter, Biomechanics and Motor Control of Human
Movement, 2.2.4.4).

Short gaps of a marker are filled by a cubic spline through its neighbouring
frames. Longer gaps, and those at either end, are bridged by straight lines,
and inverse kinematics gives them almost no weight. `Gaps.check` refuses them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData, between, missing_column, runs

MIN_FRAMES = 20
MIN_RATE_OVER_CUTOFF = 4.0


def check_filterable(
    source: str, num_frames: int, rate_hz: float, cutoff_hz: float
) -> None:
    """Refuse recordings too short or too slow for the filter.

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
            f"to {rate_hz / MIN_RATE_OVER_CUTOFF:g} or record faster; times "
            "are in seconds"
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
        order: of both passes together (even); each has half of it.
        source: file name, for messages.

    Raises:
        InputError: as `check_filterable`.
    """
    # Imported here: it loads scipy.stats, a second that most runs save.
    from scipy.signal import butter, sosfiltfilt

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
    """First and second time derivatives (N, ...) of smooth values (N, ...).

    Those of the interpolating quintic spline: exact for polynomials of degree
    five, without smoothing.
    """
    spline = make_interp_spline(time, values, k=5, axis=0)
    return spline.derivative(1)(time), spline.derivative(2)(time)


def resample(
    time: np.ndarray, values: np.ndarray, new_time: np.ndarray
) -> np.ndarray:
    """Values of smooth signals (N, ...) at other times, by cubic spline."""
    return make_interp_spline(time, values, k=3, axis=0)(new_time)


def linear(
    time: np.ndarray, values: np.ndarray, new_time: np.ndarray
) -> np.ndarray:
    """Signals (N, k) at other times, linear between and held beyond samples."""
    return np.column_stack([np.interp(new_time, time, x) for x in values.T])


def minimum_jerk(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimum-jerk step s^3 (10 - 15 s + 6 s^2), at rest at both ends.

    Args:
        s: elapsed share of the duration, clipped to 0 to 1.

    Returns:
        The step and its first and second derivatives with respect to s.
    """
    s = np.clip(s, 0.0, 1.0)
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


_NEIGHBOURS = 10  # visible frames on each side that the spline goes through
_TOLD = 12  # most gaps listed in a message


@dataclass(frozen=True)
class Gap:
    """One gap: consecutive frames in which a marker is hidden.

    Attributes:
        marker: name of the marker.
        start_s: time of the first frame of the gap.
        frames: number of frames.
        length_s: number of frames over frame rate.
    """

    marker: str
    start_s: float
    frames: int
    length_s: float

    def __str__(self) -> str:
        return (
            f"{self.marker!r} in {self.frames} frames from {self.start_s:g} s "
            f"({self.length_s:g} s)"
        )


@dataclass(frozen=True)
class Gaps:
    """Gaps of the markers in use.

    Attributes:
        time: (N,) of the markers [s].
        rate_hz: frames per second.
        longest_s: longest gap that is filled [s].
        source: file name.
        unseen: marker -> (N,) bool, true where hidden; only markers with gaps.
    """

    time: np.ndarray
    rate_hz: float
    longest_s: float
    source: str
    unseen: dict[str, np.ndarray]

    def frames(self, start_s: float, end_s: float) -> dict[str, int]:
        """Marker -> number of hidden frames in a part, if there are any."""
        inside = between(self.time, start_s, end_s)
        counts = {n: int((m & inside).sum()) for n, m in self.unseen.items()}
        return {name: count for name, count in counts.items() if count}

    def too_long(self, start_s: float, end_s: float) -> list[Gap]:
        """Gaps too long to be filled that reach into a part."""
        inside = between(self.time, start_s, end_s)
        return [
            Gap(name, float(self.time[a]), b - a, (b - a) / self.rate_hz)
            for name, mask in self.unseen.items()
            for a, b in runs(mask)
            if self._is_too_long(a, b) and inside[a:b].any()
        ]

    def hidden(self, names: Iterable[str]) -> np.ndarray:
        """Frames (N, len(names)) bool in gaps too long to be filled."""
        columns = []
        for name in names:
            column = np.zeros(len(self.time), bool)
            mask = self.unseen.get(name, column)
            for a, b in runs(mask):
                column[a:b] = self._is_too_long(a, b)
            columns.append(column)
        return np.stack(columns, axis=1)

    def check(self, start_s: float = -np.inf, end_s: float = np.inf) -> None:
        """Refuse gaps too long to be filled, all in one message.

        Raises:
            InputError: a marker has one in the part.
        """
        found = self.too_long(start_s, end_s)
        if found:
            raise InputError(
                f"{self.source}: {self.sentence(found)}; "
                f"{gap_remedy(self.longest_s)}"
            )

    def sentence(self, found: list[Gap]) -> str:
        """Words for a message: which markers are hidden, when, how long."""
        more = len(found) - _TOLD
        text = ", ".join(str(gap) for gap in found[:_TOLD])
        if more > 0:
            text += f" and {more} more gaps"
        return f"marker without a value: {text}"

    def _is_too_long(self, start: int, end: int) -> bool:
        at_end = start == 0 or end == len(self.time)
        return at_end or (end - start) / self.rate_hz > self.longest_s + 1e-9


@dataclass(frozen=True)
class MarkerFault:
    """A marker motion that is impossible on a body: a leap or standstill.

    Attributes:
        marker: its name.
        time_s: of the first frame of the fault.
        size: [m/s] of a leap; of a standstill the others' median travel [m].
    """

    marker: str
    time_s: float
    size: float


def leaps(
    data: MarkerData, names: Iterable[str], most_m_s: float
) -> tuple[MarkerFault, ...]:
    """Frames where a marker's velocity changes by more than `most_m_s`.

    The change between frames tells more than the speed, which limbs reach too.
    """
    found = []
    for name in names:
        p = data.positions[:, data.names.index(name)]
        change = np.diff(p, n=2, axis=0)
        size = data.rate_hz * np.linalg.norm(change, axis=1)
        found += [
            MarkerFault(name, float(data.time[k + 2]), float(size[k]))
            for k in np.flatnonzero(size > most_m_s)
        ]
    return tuple(found)


_STILL_FRAMES = 5


def standstills(
    data: MarkerData, groups: Iterable[Sequence[str]]
) -> tuple[MarkerFault, ...]:
    """Where a marker is frozen for 5 frames or more while its segment moves.

    Args:
        data: markers as recorded.
        groups: names of the markers on each segment.
    """
    found = []
    for names in groups:
        p = data.positions[:, [data.names.index(name) for name in names]]
        still = (np.diff(p, axis=0) == 0.0).all(axis=2)
        for i, name in enumerate(names):
            for start, end in runs(still[:, i]):
                if end - start < _STILL_FRAMES:
                    continue
                others = np.delete(p[start : end + 1], i, axis=1)
                moved = np.linalg.norm(np.ptp(others, axis=0), axis=1)
                moved = moved[np.isfinite(moved)]
                if len(moved):
                    at, size = data.time[start], np.median(moved)
                    found.append(MarkerFault(name, float(at), float(size)))
    return tuple(found)


def gap_remedy(longest_s: float) -> str:
    """End of a message: what to do about gaps too long to be filled."""
    return (
        f"gaps up to laboratory.fill_gaps_s ({longest_s:g} s) are filled, but "
        "not at the ends of the recording: raise it, fill the gaps in the "
        "motion-capture software, or use a part without gaps"
    )


def fill_gaps(
    data: MarkerData, names: Iterable[str], longest_s: float
) -> tuple[MarkerData, Gaps]:
    """Fill gaps by splines; those too long are bridged by straight lines.

    Args:
        data: markers on an even time base.
        names: the markers that are needed; others stay as they are.
        longest_s: longest gap that may be filled [s].

    Returns:
        The markers without gaps, and the gaps that they had.

    Raises:
        InputError: a marker is missing.
    """
    names = tuple(dict.fromkeys(names))
    for name in names:
        if name not in data.names:
            raise missing_column(data.source, name, data.names, "marker")
    positions, unseen = data.positions.copy(), {}
    for name in names:
        p = positions[:, data.names.index(name)]
        mask = ~np.isfinite(p).all(axis=1)
        if mask.any():
            unseen[name] = mask
    gaps = Gaps(data.time, data.rate_hz, longest_s, data.source, unseen)
    for name, mask in unseen.items():
        p = positions[:, data.names.index(name)]
        _fill(data.time, p, mask, gaps.hidden([name])[:, 0])
    return replace(data, positions=positions), gaps


def _fill(time, p: np.ndarray, unseen: np.ndarray, hidden: np.ndarray) -> None:
    """Fill p (N, 3) in place where `unseen` (N,); straight where `hidden`."""
    seen = np.flatnonzero(~unseen)
    if not len(seen):
        p[:] = 0.0
        return
    for start, end in runs(unseen):
        before = seen[seen < start][-_NEIGHBOURS:]
        after = seen[seen >= end][:_NEIGHBOURS]
        if hidden[start]:
            knots = np.r_[before[-1:], after[:1]]
            p[start:end] = linear(time[knots], p[knots], time[start:end])
            continue
        knots = np.r_[before, after]
        degree = min(3, len(knots) - 1)
        spline = make_interp_spline(time[knots], p[knots], k=degree)
        p[start:end] = spline(time[start:end])
