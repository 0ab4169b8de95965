"""The device against the person: sign, offset and unit of each joint.

Soft cuffs let the device lag and lean, but its joints follow the person's. In
the most upright posture of a trial cuffs are hardly loaded, and angles agree to
a few degrees; speeds agree to a third.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from drake_exo.files.tables import runs
from drake_exo.files.verdict import Check
from drake_exo.measurement.plausibility.evidence import Evidence

LEAST_CORRELATION = 0.5
GAINS = (0.4, 2.5)
LARGEST_OFFSET_DEG = 9.0
LARGEST_MISMATCH = 0.35  # of the joints' speed, at the best lag of clocks
LARGEST_EXCHANGED = 1.1
# So much better may encoders fit the movement of another trial.
LARGEST_RATIO = 1.5
LARGEST_SWAPPED = 1.25  # and two files the movements of each other
_REACH_S = 0.06
LARGEST_FROZEN_DEG = 5.0
_MOVES_DEG = 10.0  # a joint that moves less says little
_FAR_DEG = 30.0  # and of speeds, one that moves less
_UPRIGHT_SHARE = 0.05  # of the trial, around its most upright posture
_STEP_S = 0.005
_STILL_DEG_S, _FROZEN_S = 0.5, 0.1  # slower than that, for so long


def device_checks(e: Evidence) -> Iterator[Check]:
    """Of the encoders in one trial."""
    if e.recording.angles is None:
        return
    names = e.trial.coordinates
    human = np.rad2deg(e.expected(e.body[0]))
    device = np.rad2deg(e.trial.q[:, names.device_columns])
    upright = _most_upright(human)
    for i, name in enumerate(names.device):
        h, d = human[:, i], device[:, i]
        if np.ptp(h) > _MOVES_DEG:
            yield from _follows(e, name, h, d)
        offset = float(np.mean(d[upright] - h[upright]))
        yield e.check(
            "encoder_offset",
            abs(offset),
            LARGEST_OFFSET_DEG,
            "deg",
            e.files.encoders,
            f"{name} reads {offset:+.0f} deg off the person's "
            f"{names.follows(name)} in the most upright posture; the "
            "encoder's zero is wrong, or it is another joint's",
        )
        yield _frozen(e, i)
    moving = [i for i, h in enumerate(human.T) if np.ptp(h) > _FAR_DEG]
    yield from _exchanged(e, human, device, moving)
    if moving:
        yield _mismatch(e)


def _most_upright(human: np.ndarray) -> np.ndarray:
    """Frames around that in which joints are bent least (n,) bool."""
    at = int(np.argmin(np.abs(human).sum(axis=1)))
    reach = max(2, round(0.5 * _UPRIGHT_SHARE * len(human)))
    return np.abs(np.arange(len(human)) - at) <= reach


def _follows(e: Evidence, name: str, h, d) -> Iterator[Check]:
    moves = np.std(d) > 0.0
    r = float(np.corrcoef(h, d)[0, 1]) if moves else 0.0
    yield e.check(
        "encoder_sign",
        r,
        LEAST_CORRELATION,
        "",
        e.files.encoders,
        f"{name} does not follow the person's joint (correlation {r:.2f}); "
        + (
            "its sign looks flipped"
            if r < -LEAST_CORRELATION
            else "the file may be of another joint or trial"
        ),
        r >= LEAST_CORRELATION,
    )
    gain = float(np.std(d) / np.std(h))
    low, high = GAINS
    yield e.check(
        "encoder_unit",
        gain,
        low if gain < 1.0 else high,
        "",
        e.files.encoders,
        f"{name} moves {gain:.3g} times as far as the person's joint; degrees "
        "may be taken for radians or the other way round",
        low <= gain <= high,
    )


def _frozen(e: Evidence, i: int) -> Check:
    """Whether an encoder stands still while the person moves."""
    angles, motion = e.recording.angles, e.recording.motion
    human = e.expected(motion.q)[:, i]
    human = np.rad2deg(np.interp(angles.time, motion.time, human))
    speed = np.gradient(np.rad2deg(angles.values[:, i]), angles.time)
    still = np.abs(speed) < _STILL_DEG_S
    least = _FROZEN_S / (angles.time[1] - angles.time[0])
    moved = [np.ptp(human[a:b]) for a, b in runs(still) if b - a >= least]
    most = max(moved, default=0.0)
    return e.check(
        "encoder_frozen",
        most,
        LARGEST_FROZEN_DEG,
        "deg",
        e.files.encoders,
        f"{e.trial.coordinates.device[i]} stands still while the person's "
        f"joint turns by {most:.0f} deg; the channel is flat or saturated",
    )


def _exchanged(e: Evidence, human, device, moving) -> Iterator[Check]:
    """Whether two encoders fit better the other way round."""
    names = e.trial.coordinates.device
    for a, b in combinations(moving, 2):
        own, other = (
            float(np.linalg.norm(device[:, pair] - human[:, [a, b]]))
            for pair in ([a, b], [b, a])
        )
        yield e.check(
            "encoder_joints",
            own / max(other, 1e-9),
            LARGEST_EXCHANGED,
            "",
            e.files.encoders,
            f"{names[a]} moves as the joint of {names[b]} should, and the "
            "other way round; their columns look exchanged",
        )


def misfit(
    e: Evidence, encoders: Evidence, reach_s: float
) -> tuple[float, float]:
    """Share of a person's speed that some encoders do not follow.

    Of all joints that move far; at the best lag of the clocks within
    `reach_s`. Infinite where the encoders do not cover the movement, or
    nothing moves far.

    Returns:
        The share, and that lag [s].
    """
    moving = np.ptp(np.rad2deg(e.expected(e.body[0])), axis=0) > _FAR_DEG
    if not moving.any():
        return np.inf, 0.0
    time, v = e.trial.start_s + e.trial.times, e.expected(e.body[1])[:, moving]
    angles = encoders.recording.angles
    rates = np.gradient(angles.values[:, moving], angles.time, axis=0)
    best = np.inf, 0.0
    for lag in np.arange(-reach_s, reach_s + 1e-9, _STEP_S):
        t = time + lag
        if t[0] < angles.time[0] - 0.1 or t[-1] > angles.time[-1] + 0.1:
            continue
        d = np.column_stack([np.interp(t, angles.time, x) for x in rates.T])
        share = float(np.linalg.norm(d - v) / np.linalg.norm(v))
        best = min(best, (share, float(lag)))
    return best


def _mismatch(e: Evidence) -> Check:
    found, _ = misfit(e, e, _REACH_S)
    return e.check(
        "encoder_motion",
        100.0 * found,
        100.0 * LARGEST_MISMATCH,
        "%",
        e.files.encoders,
        f"{100 * found:.0f} % of the joints' speed is not in the "
        "encoders; the file may be of another trial, or its clock far off",
    )


def between_trials(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Whether encoders belong to the trial that names them."""
    known = [e for e in evidence if e.recording.angles is not None]
    # Of each movement with each file.
    fits = np.array([[misfit(e, o, _REACH_S)[0] for o in known] for e in known])
    for i, e in enumerate(known):
        others = [
            j for j, o in enumerate(known) if o.files.markers != e.files.markers
        ]
        if not others:
            continue
        same = [j for j in others if _equal(e, known[j])]
        name = known[same[0]].trial.name if same else ""
        best = min(others, key=lambda j, i=i: fits[j, i])
        ratio = _ratio(fits[i, i], fits[best, i])
        yield e.check(
            "encoder_file",
            ratio,
            LARGEST_RATIO,
            "",
            e.files.encoders,
            f"holds the same angles as the file of trial {name}; one of the "
            "two is another trial's"
            if same
            else f"its angles fit the movement of trial "
            f"{known[best].trial.name} {ratio:.1f} times better; it is "
            "another trial's file",
            not same and ratio <= LARGEST_RATIO,
        )
        # What cuffs make of all movements alike is in both and cancels.
        swapped = {
            j: _ratio(
                np.hypot(fits[i, i], fits[j, j]),
                np.hypot(fits[i, j], fits[j, i]),
            )
            for j in others
        }
        other = max(swapped, key=swapped.get)
        yield e.check(
            "encoder_swap",
            swapped[other],
            LARGEST_SWAPPED,
            "",
            e.files.encoders,
            f"this trial and {known[other].trial.name} fit "
            f"{swapped[other]:.2f} times better with each other's encoders; "
            "the two files look exchanged",
        )


def _ratio(own: float, other: float) -> float:
    """How much better another file fits; 0 where nothing can be said."""
    return float(own / max(other, 1e-9)) if np.isfinite(own) else 0.0


def _equal(e: Evidence, other: Evidence) -> bool:
    a, b = (x.recording.angles.values for x in (e, other))
    return a.shape == b.shape and np.array_equal(a, b)
