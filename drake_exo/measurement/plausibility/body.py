"""The body: mass, posture, ranges of joints, Newton and Euler, both legs."""

from collections.abc import Iterator

import numpy as np

from drake_exo.files.verdict import Check
from drake_exo.measurement.plausibility.evidence import JOINTS, Evidence
from drake_exo.measurement.plausibility.plates import likely_cause
from drake_exo.measurement.settings import Standing
from drake_exo.measurement.subject import SubjectModel
from drake_exo.model.assembly import SIDES

# How each limit was chosen, and how often it errs: docs/plausibility.md.
LARGEST_MASS_ERROR = 0.05
LARGEST_STANDING_DEG = 35.0  # ankle, knee, hip
LARGEST_STANDING_GAP_M = 0.10
RANGES_DEG = {"ankle": (-50.0, 60.0), "knee": (-20.0, 165.0)}
RANGES_DEG["hip"] = (-45.0, 150.0)
LARGEST_MARKER_RMS_M = 0.05
LARGEST_FORCE_SHARE = 0.15  # RMS, of body weight
LARGEST_MOMENT_M = 0.10  # RMS, over body weight
LEAST_SHEAR_CORRELATION = -0.3
_SHEAR_SHARE = 0.02  # of body weight: less says nothing of a sign
LARGEST_LEG_SHARE = 0.65
LARGEST_FEET_APART_M = 0.10
LARGEST_LEG_DIFFERENCE_DEG = 15.0
LARGEST_LIFTED_SHARE = 0.05
_LIFTED, _STANDS = 0.05, 0.3  # of body weight, on one foot and the other
LARGEST_END_SPEED_M_S = 0.15
# Of feet that bear half the body; 0.02 over ground, slow belts start at 0.5.
LARGEST_STANDING_M_S = 0.3
# The last two differ by 2 %, less than plates of people do.
_UNITS = {"kN": 1e-3, "lbf": 1.0 / 4.448, "kgf or daN": 0.1}


def standing_checks(
    subject: SubjectModel, standing: Standing
) -> Iterator[Check]:
    """Of the standing trial."""
    said = subject.report
    measured, stated = said.get("standing_mass_kg"), said["stated_mass_kg"]
    if measured is not None and stated is not None:
        off = measured / stated - 1.0
        # A unit is told by all that plates bear, the device too.
        device = subject.model.tree.mass - subject.mass_kg
        borne = (measured + device) / (stated + device)
        beyond = "beyond the device " if device > 0.5 else ""
        yield _of_standing(
            "mass",
            100.0 * abs(off),
            100.0 * LARGEST_MASS_ERROR,
            "%",
            f"{standing.forces}: the plates bear {measured:.3g} kg {beyond}in "
            f"standing, subject.mass_kg says {stated:.3g} kg; "
            + (_unit_of(borne) or "correct the mass or standing.plates"),
        )
    joints = subject.model.coordinates.human
    angles = dict(zip(joints, said["standing_angles_deg"][1:], strict=True))
    worst = max(angles, key=lambda name: abs(angles[name]))
    yield _of_standing(
        "standing_posture",
        abs(angles[worst]),
        LARGEST_STANDING_DEG,
        "deg",
        f"{standing.markers}: {worst} at {angles[worst]:.0f} deg in standing; "
        "laboratory.marker_axes may be wrong, markers.joint_centres may name "
        "other markers, or this is no upright standing",
    )
    if "standing_cop_x_m" in said:
        gap = said["standing_cop_x_m"] - said["standing_com_x_m"]
        if "trunk_com_shift_m" in said:
            gap = said["trunk_com_shift_m"]
        yield _of_standing(
            "standing_balance",
            abs(gap),
            LARGEST_STANDING_GAP_M,
            "m",
            f"{standing.forces}: the centre of pressure is {gap:.2f} m in "
            "front of the centre of mass in standing; laboratory.force_axes "
            "or marker_axes may be turned round, or plates and markers have "
            "another origin",
        )


def _of_standing(name, value, limit, unit, sentence) -> Check:
    holds = bool(value <= limit)
    return Check(
        f"plausibility.{name}",
        holds,
        float(value),
        limit,
        unit,
        "standing",
        "" if holds else sentence,
    )


def body_checks(e: Evidence) -> Iterator[Check]:
    """Of the body in one trial."""
    yield from _ranges(e)
    yield _markers(e)
    yield from _dynamics(e)
    if e.subject.model.assembly.human.sides:
        yield _belt(e)
    # A step ends in the middle of a movement, and its legs do not move alike.
    if not e.subject.model.assembly.human.sides:
        yield _end(e)
        if e.has_both_feet:
            yield from _legs(e)


def _belt(e: Evidence) -> Check:
    """Whether feet that bear the body stand."""
    motion, speeds = e.recording.motion, [np.zeros(0)]
    for side, markers in motion.feet.items():
        forward = np.gradient(markers[..., 0].mean(axis=1), motion.time)
        bears = e.trial.feet[side].force_z > 0.5 * e.weight
        speeds.append(forward[e.inside][bears])
    speeds = np.concatenate(speeds)
    speed = float(np.median(speeds)) if len(speeds) else 0.0
    belt = e.recording.belt_speed_m_s - speed
    return e.check(
        "belt",
        abs(speed),
        LARGEST_STANDING_M_S,
        "m/s",
        e.files.markers,
        f"feet that bear the body move at {speed:+.2f} m/s, as on a "
        f"treadmill; say 'ground: {{belt_speed_m_s: {belt:.2f}}}'",
    )


def _ranges(e: Evidence) -> Iterator[Check]:
    for side, angles in e.recording.motion.legs.items():
        deg = np.rad2deg(angles[e.inside])
        for joint, x in zip(JOINTS, deg.T, strict=True):
            low, high = RANGES_DEG[joint]
            bent = x.min() if low - x.min() > x.max() - high else x.max()
            backwards = joint == "knee" and bent < low
            yield e.check(
                f"{joint}_range",
                bent,
                low if bent == x.min() else high,
                "deg",
                e.files.markers,
                f"the {side} {joint} turns to {bent:.0f} deg, beyond "
                f"{low:.0f} to {high:.0f} deg; "
                + (
                    "the knee bends backwards: laboratory.marker_axes look "
                    "turned round"
                    if backwards
                    else "check the names of markers and marker_axes"
                ),
                low <= x.min() and x.max() <= high,
            )


def _markers(e: Evidence) -> Check:
    rms = e.recording.motion.residuals_m
    worst = max(rms, key=rms.get)
    overall = float(np.sqrt(np.mean(np.square(list(rms.values())))))
    return e.check(
        "markers",
        overall,
        LARGEST_MARKER_RMS_M,
        "m",
        e.files.markers,
        f"markers lie {1e3 * overall:.0f} mm off a body of rigid segments, "
        f"most {worst} ({1e3 * rms[worst]:.0f} mm); markers may be exchanged, "
        "or laboratory.marker_axes wrong",
    )


def _dynamics(e: Evidence) -> Iterator[Check]:
    missing = e.needed - e.measured
    rms = np.sqrt(np.mean(missing**2, axis=0))
    moment = e.pitch_error()
    force = float(rms[:2].max())
    borne = float(np.mean(e.measured[:, 1]) / np.mean(e.needed[:, 1]))
    cause = _unit_of(borne) or likely_cause(e)
    if cause is None and abs(borne - 1.0) > 0.1:
        cause = (
            f"plates bear {100 * borne:.0f} % of what the motion asks for: "
            "subject.mass_kg, a foot beside its plate, or a part in which "
            "the chair still bears"
        )
    cause = cause or "check subject.mass_kg, plates, axes and clocks"
    yield e.check(
        "newton",
        force,
        LARGEST_FORCE_SHARE * e.weight,
        "N",
        e.files.forces,
        f"Newton's law misses {force:.0f} N RMS "
        f"({100 * force / e.weight:.0f} % of body weight); {cause}",
    )
    yield e.check(
        "euler",
        moment,
        LARGEST_MOMENT_M * e.weight,
        "N m",
        e.files.forces,
        f"Euler's law misses {moment:.0f} N m RMS about the ankle; {cause}",
    )
    needed, measured = e.needed[:, 0], e.measured[:, 0]
    least = _SHEAR_SHARE * e.weight
    if np.std(needed) > least and np.std(measured) > 1e-3 * e.weight:
        found = float(np.corrcoef(needed, measured)[0, 1])
        yield e.check(
            "shear_sign",
            found,
            LEAST_SHEAR_CORRELATION,
            "",
            e.files.forces,
            f"fore-aft force goes against the motion (correlation {found:.2f})"
            "; laboratory.force_axes or marker_axes look turned round",
            found >= LEAST_SHEAR_CORRELATION,
        )


def _unit_of(ratio: float) -> str | None:
    """A unit of force that explains what plates bear, as a share."""
    for unit, factor in _UNITS.items():
        if abs(ratio / factor - 1.0) < 0.15:
            return f"forces look like {unit}: export newtons"
    return None


def _end(e: Evidence) -> Check:
    """Whether the recording stops while the body still rises."""
    motion = e.recording.motion
    at = np.flatnonzero(e.inside)[-1]
    hips = np.gradient(motion.hip_z, motion.time)
    speed = abs(float(hips[at])) if at >= len(motion.time) - 2 else 0.0
    return e.check(
        "end",
        speed,
        LARGEST_END_SPEED_M_S,
        "m/s",
        e.files.forces,
        f"the recording ends at {motion.time[-1]:g} s while the hips still "
        f"move at {speed:.2f} m/s; markers or forces stop in the middle of "
        "the movement: export the whole trial",
    )


def _legs(e: Evidence) -> Iterator[Check]:
    motion = e.recording.motion
    left, right = (np.rad2deg(motion.legs[s][e.inside]) for s in SIDES)
    rms = np.sqrt(np.mean((left - right) ** 2, axis=0))
    worst = int(np.argmax(rms))
    one = "the model has one leg, the mean of both"
    yield e.check(
        "leg_angles",
        rms[worst],
        LARGEST_LEG_DIFFERENCE_DEG,
        "deg",
        e.files.markers,
        f"left and right {JOINTS[worst]} differ by {rms[worst]:.0f} deg RMS, "
        f"but {one}; this may be walking or a step, or markers of left and "
        "right exchanged",
    )
    x = [motion.ankles[s][e.inside, 0].mean() for s in SIDES]
    yield e.check(
        "feet_apart",
        abs(x[0] - x[1]),
        LARGEST_FEET_APART_M,
        "m",
        e.files.markers,
        f"the feet stand {1e3 * abs(x[0] - x[1]):.0f} mm apart fore and aft, "
        f"but {one}; record with the feet side by side",
    )
    if e.has_two_plates:
        yield from _shares(e, one)


def _shares(e: Evidence, one: str) -> Iterator[Check]:
    bear = {side: e.plates[side][:, 2] for side in SIDES}
    total = np.maximum(bear["left"] + bear["right"], 1.0)
    share = float(np.mean(bear["left"]) / np.mean(total))
    most = "left" if share > 0.5 else "right"
    share = max(share, 1.0 - share)
    yield e.check(
        "leg_share",
        100.0 * share,
        100.0 * LARGEST_LEG_SHARE,
        "%",
        e.files.forces,
        f"the {most} leg bears {100 * share:.0f} % of the weight, but {one}; "
        "one foot may stand beside its plate",
    )
    lifted = np.zeros(len(total), bool)
    for side, other in (SIDES, SIDES[::-1]):
        up = bear[side] < _LIFTED * e.weight
        lifted |= up & (bear[other] > _STANDS * e.weight)
    yield e.check(
        "lifted_foot",
        100.0 * lifted.mean(),
        100.0 * LARGEST_LIFTED_SHARE,
        "%",
        e.files.forces,
        f"one foot is in the air for {100 * lifted.mean():.0f} % of the used "
        f"part, but {one}; this may be walking, not a rise",
    )
