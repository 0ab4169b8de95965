"""Plates against feet: units, sides, axes, channels that do not measure."""

from collections.abc import Iterator

import numpy as np

from drake_exo.files.tables import runs
from drake_exo.files.verdict import Check
from drake_exo.measurement.plausibility.evidence import Evidence

LARGEST_ALONG_M = 0.03
LARGEST_ACROSS_M = 0.05
_FAR_M = 2.0  # beyond it, a unit is the likelier cause
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2}
# A plate repeats itself to the last digit only where it does not measure.
LARGEST_FLAT_SHARE = 0.25  # of the time it is loaded
_FLAT_SAMPLES, _FLAT_S = 5, 0.05
_FLAT_N = 20.0
_MOVES_SHARE = 0.02  # of body weight: the motion asks for another force
LARGEST_CHAIR_SHARE = 0.15  # of body weight, RMS


def plate_checks(e: Evidence) -> Iterator[Check]:
    """Of the plates in one trial."""
    for foot in e.plates:
        if np.isfinite(e.outside(foot)[0]):
            yield from _pressure(e, foot)
    if e.has_two_plates and e.has_both_feet:
        yield _sides(e)
    for name, w in e.recording.forces.recorded.items():
        yield _flat(e, name, w[:, 2])
        yield _clipped(e, name, w[:, 2])
    if e.recording.chair is not None:
        yield _chair(e)


def likely_cause(e: Evidence) -> str | None:
    """What would put the centres of pressure under their feet, in words."""
    if _fits(e):
        return None
    knees = [a[e.inside, 1].min() for a in e.recording.motion.legs.values()]
    if np.rad2deg(min(knees)) < -20.0:
        return "laboratory.marker_axes look turned round"
    for unit, scale in _LENGTHS.items():
        if _fits(e, scale=scale):
            return f"the points of the force file look like {unit}"
    exchanged = e.has_two_plates and e.has_both_feet and e.off_side() < 0.0
    if exchanged and e.pitch_error() <= e.pitch_error(turned=True):
        return "plates.left and plates.right look exchanged"
    if _fits(e, turned=True):
        return "laboratory.force_axes look turned round"
    return (
        "check plates, laboratory.force_axes and that markers and plates "
        "share one origin"
    )


def _fits(e: Evidence, **changed) -> bool:
    """Whether each centre of pressure would be under its own foot."""
    for foot in e.plates:
        along, across = e.outside(foot, **changed)
        if along > LARGEST_ALONG_M or across > LARGEST_ACROSS_M:
            return False
    if e.has_two_plates and e.has_both_feet:
        return e.off_side(**changed) >= 0.0
    return True


def _pressure(e: Evidence, foot: str) -> Iterator[Check]:
    along, across = e.outside(foot)
    cause = likely_cause(e)
    for name, value, limit, words in (
        ("cop_along", along, LARGEST_ALONG_M, "in front of or behind"),
        ("cop_across", across, LARGEST_ACROSS_M, "beside"),
    ):
        if not np.isfinite(value):
            continue
        yield e.check(
            name,
            value,
            limit,
            "m",
            e.files.forces,
            f"the centre of pressure of plate {foot!r} is {value:.3g} m "
            f"{words} the foot that its markers show; {cause}",
        )
    size = float(np.median(np.abs(e.cop(foot))))
    is_unit = any(_fits(e, scale=s) for s in _LENGTHS.values())
    yield e.check(
        "cop_unit",
        size,
        _FAR_M,
        "m",
        e.files.forces,
        f"the centre of pressure of plate {foot!r} is {size:.3g} m from the "
        f"origin; {cause}",
        size <= _FAR_M or _fits(e) or not is_unit,
    )


def _sides(e: Evidence) -> Check:
    nearer = e.off_side()
    return e.check(
        "plate_sides",
        nearer,
        0.0,
        "m",
        e.files.forces,
        f"the centre of pressure of each plate is {-nearer:.2f} m nearer to "
        f"the other foot; {likely_cause(e)}",
        nearer >= 0.0,
    )


def _repeats(e: Evidence, F_z: np.ndarray) -> list[tuple[int, int]]:
    """Runs in which a loaded plate repeats itself while the body moves."""
    forces, motion = e.recording.forces, e.recording.motion
    loaded = np.abs(F_z) > _FLAT_N
    same = np.r_[False, np.diff(F_z) == 0.0] & loaded
    least = max(_FLAT_SAMPLES, _FLAT_S * forces.rate_hz)
    needed = np.interp(forces.time, motion.time, e.needed_z)
    return [
        (a, b)
        for a, b in runs(same)
        if b - a >= least and np.ptp(needed[a:b]) > _MOVES_SHARE * e.weight
    ]


def _flat(e: Evidence, name: str, F_z: np.ndarray) -> Check:
    found = _repeats(e, F_z)
    loaded = max(int((np.abs(F_z) > _FLAT_N).sum()), 1)
    share = sum(b - a for a, b in found) / loaded
    longest = max(found, key=lambda run: run[1] - run[0], default=(0, 0))
    seconds = (longest[1] - longest[0]) / e.recording.forces.rate_hz
    return e.check(
        "flat_channel",
        100.0 * share,
        100.0 * LARGEST_FLAT_SHARE,
        "%",
        e.files.forces,
        f"plate {name!r} stays at exactly {F_z[longest[0]]:.4g} N for "
        f"{seconds:.2g} s while the body moves; the channel is a filler, not "
        "a measurement: leave the plate out of plates or export its signal",
    )


def _clipped(e: Evidence, name: str, F_z: np.ndarray) -> Check:
    """A peak that is cut off: level on top while the body moves."""
    top = F_z.max()
    found = [(a, b) for a, b in _repeats(e, F_z) if F_z[a] == top]
    longest = max((b - a for a, b in found), default=0)
    seconds = longest / e.recording.forces.rate_hz
    return e.check(
        "saturated_channel",
        seconds,
        0.0,
        "s",
        e.files.forces,
        f"plate {name!r} is cut off at {top:.4g} N for {seconds:.2g} s; its "
        "amplifier is saturated: choose a larger range and record again",
    )


def _chair(e: Evidence) -> Check:
    """Whether feet and chair together bear the body, seated and rising."""
    recording = e.recording
    borne = recording.forces.total(recording.feet) + recording.chair.force_z
    left = (e.needed_z - borne)[recording.motion.known]
    rms = float(np.sqrt(np.mean(left**2))) if len(left) else 0.0
    return e.check(
        "chair",
        rms,
        LARGEST_CHAIR_SHARE * e.weight,
        "N",
        e.files.forces,
        f"feet and chair together miss {rms:.0f} N RMS of what the motion "
        "asks for over the whole recording; the plate named as plates.chair "
        "may be another, or not measure",
    )
