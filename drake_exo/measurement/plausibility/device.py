"""The device against the person: sign, offset and unit of each joint.

Soft cuffs let the device lag and lean, but its joints follow the person's. In
the most upright posture of a trial cuffs are hardly loaded, and angles agree to
a few degrees; speeds agree to a third.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from drake_exo.files.verdict import Check
from drake_exo.measurement.gaps import runs
from drake_exo.measurement.plausibility.evidence import JOINTS, Evidence

LEAST_CORRELATION = 0.5
GAINS = (0.4, 2.5)
LARGEST_OFFSET_DEG = 9.0
LARGEST_MISMATCH = 0.35  # of the speed of knee and hip
LARGEST_SWAP = 1.1
_MOVES_DEG = 10.0  # a joint that moves less says little
_UPRIGHT_SHARE = 0.05  # of the trial, around its most upright posture
_STEP_S = 0.005
_FROZEN_DEG, _FROZEN_S = 5.0, 0.1


def device_checks(e: Evidence) -> Iterator[Check]:
    """Of the encoders in one trial."""
    if e.recording.angles is None:
        return
    names = e.trial.coordinates
    human = np.rad2deg(e.body[0][:, -len(JOINTS) :])
    device = np.rad2deg(e.trial.q[:, names.device_columns])
    upright = _most_upright(human)
    for i, name in enumerate(names.device):
        k = JOINTS.index(names.follows(name))
        h, d = human[:, k], device[:, i]
        if np.ptp(h) > _MOVES_DEG:
            yield from _follows(e, name, h, d)
        offset = float(np.mean(d[upright] - h[upright]))
        yield e.check(
            "encoder_offset",
            abs(offset),
            LARGEST_OFFSET_DEG,
            "deg",
            e.files.encoders,
            f"{name} reads {offset:+.0f} deg off the person's {JOINTS[k]} in "
            "the most upright posture; the encoder's zero is wrong, or it is "
            "another joint's",
        )
        yield _frozen(e, name, k)
    if len(names.device) == len(JOINTS):
        yield _swapped(e, human, device)
        yield _mismatch(e)


def _most_upright(human: np.ndarray) -> np.ndarray:
    """Frames around that of the least flexion of knee and hip (n,) bool."""
    at = int(np.argmin(human[:, 1] + human[:, 2]))
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


def _frozen(e: Evidence, name: str, k: int) -> Check:
    """Whether an encoder stands still while the person moves."""
    angles, motion = e.recording.angles, e.recording.motion
    x = angles.values[:, list(e.trial.coordinates.device).index(name)]
    human = np.interp(angles.time, motion.time, motion.q[:, -len(JOINTS) + k])
    still = np.abs(np.r_[1.0, np.diff(x)]) < 1e-7
    rate = 1.0 / (angles.time[1] - angles.time[0])
    moved = [
        np.ptp(np.rad2deg(human[a:b]))
        for a, b in runs(still)
        if (b - a) / rate >= _FROZEN_S
    ]
    most = max(moved, default=0.0)
    return e.check(
        "encoder_frozen",
        most,
        _FROZEN_DEG,
        "deg",
        e.files.encoders,
        f"{name} stands still while the person's joint turns by {most:.0f} "
        "deg; the channel is flat or saturated",
    )


def _swapped(e: Evidence, human, device) -> Check:
    """Whether knee and hip fit better the other way round."""
    own, other = (
        float(np.sqrt(np.mean((device[:, order] - human[:, 1:]) ** 2)))
        for order in ([1, 2], [2, 1])
    )
    ratio = own / max(other, 1e-9)
    return e.check(
        "encoder_joints",
        ratio,
        LARGEST_SWAP,
        "",
        e.files.encoders,
        "the encoder of the knee follows the person's hip, and that of the "
        "hip the knee; their columns look exchanged",
    )


def _speeds(e: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Time in the recording (n,) [s], speed of knee and hip (n, 2)."""
    return e.trial.start_s + e.trial.times, e.body[1][:, -2:]


def misfit(e: Evidence, encoders: Evidence, reach_s: float) -> float:
    """Share of a person's speed that some encoders do not follow.

    Of knee and hip together; at the best lag of the clocks within
    `reach_s`. Infinite where the encoders do not cover the movement.
    """
    time, v = _speeds(e)
    angles = encoders.recording.angles
    rates = np.gradient(angles.values[:, -2:], angles.time, axis=0)
    best = np.inf
    for lag in np.arange(-reach_s, reach_s + 1e-9, _STEP_S):
        t = time + lag
        if t[0] < angles.time[0] - 0.1 or t[-1] > angles.time[-1] + 0.1:
            continue
        d = np.column_stack([np.interp(t, angles.time, x) for x in rates.T])
        best = min(best, float(np.linalg.norm(d - v) / np.linalg.norm(v)))
    return best


def _mismatch(e: Evidence) -> Check:
    found = misfit(e, e, 0.0)
    return e.check(
        "encoder_motion",
        100.0 * found,
        100.0 * LARGEST_MISMATCH,
        "%",
        e.files.encoders,
        f"{100 * found:.0f} % of the speed of knee and hip is not in the "
        "encoders; the file may be of another trial, or its clock far off",
    )


# Of two trials, encoders fit the other so much better.
LARGEST_RATIO = 2.0
_REACH_S = 0.06


def between_trials(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Whether encoders belong to the trial that names them."""
    known = [e for e in evidence if e.recording.angles is not None]
    known = [e for e in known if len(e.trial.coordinates.device) == 3]
    for e in known:
        others = [o for o in known if o.files.markers != e.files.markers]
        if not others:
            continue
        same = [o for o in others if _equal(e, o)]
        name = same[0].trial.name if same else ""
        own = misfit(e, e, _REACH_S)
        fits = {o.trial.name: misfit(o, e, _REACH_S) for o in others}
        best = min(fits, key=fits.get)
        ratio = own / max(fits[best], 1e-9)
        yield e.check(
            "encoder_file",
            ratio,
            LARGEST_RATIO,
            "",
            e.files.encoders,
            f"holds the same angles as the file of trial {name}; one of the "
            "two is another trial's"
            if same
            else f"its angles fit the movement of trial {best} {ratio:.1f} "
            "times better; it is another trial's file",
            not same and ratio <= LARGEST_RATIO,
        )


def _equal(e: Evidence, other: Evidence) -> bool:
    a, b = (x.recording.angles.values for x in (e, other))
    return a.shape == b.shape and np.array_equal(a, b)
