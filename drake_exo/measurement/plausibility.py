"""Plausibility checks of a study's recordings, made before a solve.

Of the body: mass, posture, joint ranges, Newton's and Euler's law, both legs.
Of plates against feet: units, sides, axes, dead channels. Of the device against
the person: sign, offset and unit of each joint. Of files against the movements
of other trials: are encoders, forces and wearer those of this trial?
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.constants import g

from drake_exo.errors import InputError
from drake_exo.files.output import Check, Level, Verdict
from drake_exo.files.tables import COP_THRESHOLD_N, between, runs
from drake_exo.measurement.filters import MarkerFault, linear
from drake_exo.measurement.kinematics import inverse_dynamics, residual_rms
from drake_exo.measurement.mats import MatForce
from drake_exo.measurement.processing import (
    LEAST_LEAP_M_S,
    Recording,
    needed_force,
)
from drake_exo.measurement.sagittal import centre_of_pressure
from drake_exo.measurement.settings import (
    Plates,
    Standing,
    TrialFiles,
    listed,
)
from drake_exo.measurement.subject import SubjectModel
from drake_exo.measurement.trial import Trial, saw_device
from drake_exo.model.assembly import SIDES
from drake_exo.model.plant import Model
from drake_exo.model.segments import LEG_JOINTS

# Below this force a plate's centre of pressure is too uncertain to judge [N].
LOADED_N = 50.0
# Peak sideways speed: a CoM that sways by ±25 mm in strides of 1.1 s.
_SWAY_M_S = 0.15
_STEP_M = 0.1  # between the ankles, fore and aft: a foot is in front
# RMS fore-aft force, in body weights, below which its sign cannot be told.
_SHEAR_OF_WEIGHT = 0.002
# Added behind a foot's rearmost marker, and to its length [m].
_HEEL_M = 0.03
# Markers that span less of the foot's length include none at the heel.
_WHOLE = 0.5


# Check -> limit, its unit, and the file that its message names. How each was
# chosen, and how often it is wrong: docs/plausibility.md.
LIMITS: dict[str, tuple[float, str, str]] = {
    # of standing
    "mass": (5.0, "%", "standing"),
    "standing_posture": (35.0, "deg", "standing"),
    "stature": (10.0, "%", "standing"),
    "standing_balance": (0.10, "m", "standing"),
    # of the body
    "ankle_range": (60.0, "deg", "markers"),
    "knee_range": (165.0, "deg", "markers"),
    "hip_range": (150.0, "deg", "markers"),
    "facing": (15.0, "deg", "markers"),
    "markers": (0.05, "m", "markers"),
    "marker_leap": (8.0, "m/s", "markers"),
    "marker_frozen": (0.02, "m", "markers"),
    "floor": (0.015, "m", "markers"),
    "newton": (0.15, "N", "forces"),
    "euler": (0.10, "N m", "forces"),
    "mean_forward": (0.03, "N", "forces"),
    "mean_sideways": (0.03, "N", "forces"),
    "mean_weight": (7.0, "%", "forces"),
    "shear_sign": (1.1, "", "forces"),
    # Feet over ground move at 0.02 m/s, slow belts at 0.5.
    "belt": (0.3, "m/s", "markers"),
    "end": (0.15, "m/s", "forces"),
    "end_joints": (30.0, "deg/s", "markers"),
    "overlap": (0.0, "s", "markers"),
    "leg_angles": (15.0, "deg", "markers"),
    "feet_apart": (0.10, "m", "markers"),
    "leg_share": (65.0, "%", "forces"),
    "lifted_foot": (5.0, "%", "forces"),
    # Feet that stay move by 7 mm, those of a poor inverse kinematics by 38.
    "foot_slides": (0.02, "m", "markers"),
    # of the plates
    "cop_along": (0.03, "m", "forces"),
    "cop_across": (0.05, "m", "forces"),
    "cop_unit": (2.0, "m", "forces"),
    "cop_light": (0.05, "m", "forces"),
    "foot_sides": (0.0, "m", "markers"),
    "plate_sides": (0.0, "m", "forces"),
    # A loaded plate repeats a value exactly only where it does not measure.
    "flat_channel": (25.0, "%", "forces"),
    "saturated_channel": (0.0, "s", "forces"),
    "chair": (0.15, "N", "forces"),
    "force_clock": (25.0, "ms", "forces"),
    "force_file": (1.25, "", "forces"),
    "force_swap": (1.25, "", "forces"),
    # of the device
    "device_joint": (0.20, "m", "standing"),
    "encoder_sign": (0.5, "", "encoders"),
    "encoder_unit": (2.5, "", "encoders"),
    "encoder_offset": (9.0, "deg", "encoders"),
    "encoder_frozen": (5.0, "deg", "encoders"),
    "encoder_joints": (1.1, "", "encoders"),
    "encoder_motion": (35.0, "%", "encoders"),
    # Largest ratio by which encoders may fit another trial's movement better,
    # and by which two trials may fit better with files exchanged.
    "encoder_file": (1.5, "", "encoders"),
    "encoder_swap": (1.25, "", "encoders"),
    "encoder_stranger": (0.45, "", "encoders"),
    "mat_still": (1.0, "N", "pressure"),
    "mat_sides": (0.9, "", "pressure"),
    "device_moment": (0.5, "N m", "exo_moments"),
    "device_worn": (1.0, "trials", "encoders"),
}
_LEAST = {  # checks whose limit is a minimum
    *("foot_sides", "plate_sides", "encoder_sign", "mat_still"),
    "device_worn",
}
_OF_WEIGHT = {  # checks whose limit is a share of body weight
    *("newton", "euler", "mean_forward", "mean_sideways", "chair"),
    "device_moment",
}


def _judged(
    name: str,
    value: float,
    where: str,
    sentence: str,
    holds: bool | None = None,
    limit: float | None = None,
    level: Level = "fail",
    weight: float = 1.0,
) -> Check:
    """A check against `LIMITS`, or another limit.

    `holds` overrules the comparison, if more than the limit decides.
    """
    usual, unit, _ = LIMITS[name]
    limit = usual if limit is None else limit
    limit *= weight if name in _OF_WEIGHT else 1.0
    if holds is None:
        holds = value >= limit if name in _LEAST else value <= limit
    return Check(
        f"plausibility.{name}",
        bool(holds),
        float(value),
        float(limit),
        unit,
        where,
        sentence,
        level,
    )


@dataclass(frozen=True)
class Made:
    """A trial of a model: what its motion asks for, and what was measured.

    Attributes:
        trial: n samples.
        model: subject and device.
    """

    trial: Trial
    model: Model

    def check(
        self, name: str, value: float, sentence: str, **changed: Any
    ) -> Check:
        """A check of this trial: by default that a value is within its limit.

        Args:
            name: key of `LIMITS`.
            value: found.
            sentence: message if it does not hold.
            changed: as in `_judged`.
        """
        where, weight = self.trial.name, self.weight
        return _judged(name, value, where, sentence, weight=weight, **changed)

    @property
    def weight(self) -> float:
        """Weight of body and device together [N]."""
        return self.model.rigid.tree.weight

    @cached_property
    def needed(self) -> np.ndarray:
        """External F_x, F_z [N], M_y [N m] (n, 3) that the motion requires.

        About the laboratory's origin; feet, chair and loads together.
        """
        tree = self.model.rigid.tree
        q, v, a = self.trial.body
        return tree.ground_reaction(q, inverse_dynamics(tree, q, v, a, {}))

    @cached_property
    def measured(self) -> np.ndarray:
        """Measured counterpart (n, 3) of `needed`."""
        others = self.trial.loads(None).values()
        return sum((w.array for w in others), self.trial.ground.array)

    def pitch_error(self, turned: bool = False) -> float:
        """RMS residual moment of Euler's law [N m].

        About the body's root: the ankle; with two legs the mid-point of hips.

        Args:
            turned: with the plates' axes turned by 180° about the vertical.
        """
        measured = self.measured * ([-1.0, 1.0, -1.0] if turned else 1.0)
        F_x, F_z, moment = (self.needed - measured).T
        x, z = self.trial.body[0][:, :2].T
        return float(np.sqrt(np.mean((moment - (z * F_x - x * F_z)) ** 2)))


@dataclass(frozen=True)
class Evidence(Made):
    """A trial that is cut from a recording, n samples of N.

    Attributes:
        files: names of the trial's files.
        recording: the recording from which it was cut.
        subject: the subject's model, fitted to standing.
    """

    files: TrialFiles
    recording: Recording
    subject: SubjectModel

    def check(
        self, name: str, value: float, sentence: str, file=None, **changed
    ) -> Check:
        """As `Made.check`; the message names the usual file, or another."""
        file = file or getattr(self.files, LIMITS[name][2])
        return super().check(name, value, f"{file}: {sentence}", **changed)

    @cached_property
    def inside(self) -> np.ndarray:
        """Frames (N,) bool of the recording in the used part."""
        start, duration = self.trial.start_s, self.trial.duration
        return between(self.recording.motion.time, start, start + duration)

    def expected(self, body: np.ndarray) -> np.ndarray:
        """Device's joint angles or speeds (n, joints), if it follows the body.

        Args:
            body: (n, nq) positions or velocities of the body.
        """
        names = self.trial.coordinates
        return body[:, -len(names.human) :] @ names.turned_by.T

    @cached_property
    def needed_z(self) -> np.ndarray:
        """Vertical force (N,) that the recording's motion requires [N]."""
        return needed_force(self.model.rigid, self.recording.motion)

    @cached_property
    def plates(self) -> dict[str, np.ndarray]:
        """Foot -> force, moment about the origin (n, 6), drift not removed."""
        forces = self.recording.forces
        time = self.recording.motion.time[self.inside]
        return {
            foot: linear(forces.time, w, time)
            for foot, w in forces.recorded.items()
            if foot != "chair"
        }

    @property
    def has_two_plates(self) -> bool:
        """Whether each foot has its own plate."""
        return all(side in self.plates for side in SIDES)

    def loaded(self, foot: str) -> np.ndarray:
        """Frames (n,) bool in which a plate bears more than 50 N."""
        return self.plates[foot][:, 2] > LOADED_N

    def cop(self, foot: str, turned: bool = False, scale: float = 1.0):
        """Centre of pressure (k, 2), forward and left [m], k loaded frames.

        Args:
            foot: of the plate.
            turned: with the plates' axes turned by 180° about the vertical.
            scale: factor on lengths, to try another unit.
        """
        w = self.plates[foot][self.loaded(foot)]
        x = centre_of_pressure(w[:, 0], w[:, 2], w[:, 4])
        y = centre_of_pressure(w[:, 1], w[:, 2], -w[:, 3])
        return (-scale if turned else scale) * np.stack([x, y], 1)

    def sole(self, foot: str, plate: str | None = None) -> np.ndarray | None:
        """Edges of a foot: back, front, right, left (k, 4) [m].

        Args:
            foot: "left", "right" or "both".
            plate: whose loaded frames are wanted; that of the foot if None.

        Returns:
            None without markers of the foot. Sideways the outermost markers
            are the edges; NaN for "both" if one foot has no markers.
        """
        feet = self.recording.motion.feet
        sides = SIDES if foot == "both" else (foot,)
        known = [feet[s] for s in sides if s in feet]
        if not known:
            return None
        p = np.concatenate(known, axis=1)[self.inside]
        p = p[self.loaded(plate or foot)]
        x, y = p[..., 0], p[..., 1]
        length = self.model.human.foot.length_m + _HEEL_M
        back = x.min(axis=1) - _HEEL_M
        span = np.ptp(x, axis=1)
        if len(p) and np.median(span) < _WHOLE * length:  # no heel marker
            back = x.max(axis=1) - length
        front = np.maximum(x.max(axis=1), x.min(axis=1) + length)
        right, left = y.min(axis=1), y.max(axis=1)
        if len(known) < len(sides):
            right, left = np.full((2, len(p)), np.nan)
        return np.column_stack([back, front, right, left])

    def outside(self, foot: str, **changed) -> tuple[float, float]:
        """Distances of the CoP outside the foot, along and across [m].

        95th percentile over the loaded frames; negative inside the foot, NaN
        without markers or load.
        """
        sole = self.sole(foot)
        if sole is None or not len(sole):
            return np.nan, np.nan
        x, y = self.cop(foot, **changed).T
        along, across = _beyond(x, *sole[:, :2].T), _beyond(y, *sole[:, 2:].T)
        return float(np.quantile(along, 0.95)), float(np.quantile(across, 0.95))

    def astray(self, foot: str) -> tuple[float, float]:
        """Largest distance of the processed CoP in front of or behind the foot.

        Returns:
            That distance [m], negative inside the foot, and the largest force
            [N] while the CoP is beyond the limit of `cop_light`; NaN and 0
            without markers or load.
        """
        sole = self.sole(foot)
        if sole is None or not len(sole):
            return np.nan, 0.0
        time = self.recording.motion.time[self.inside][self.loaded(foot)]
        used = self.recording.forces.at(time)[foot]
        bears = used.force_z > LOADED_N
        beyond = _beyond(used.cop_x[bears], *sole[bears, :2].T)
        far = beyond > LIMITS["cop_light"][0]
        return (
            float(beyond.max(initial=-np.inf)),
            float(used.force_z[bears][far].max(initial=0.0)),
        )

    def off_side(self, **changed) -> float:
        """How much nearer the CoP is to a plate's own foot, sideways [m].

        Mean of both feet; negative if it is nearer to the other foot.
        """
        nearer = []
        for side, other in (SIDES, SIDES[::-1]):
            y = self.cop(side, **changed)[:, 1]
            own, far = (
                np.abs(y - self.sole(s, side)[:, 2:].mean(axis=1))
                for s in (side, other)
            )
            nearer.append(np.median(far - own) if len(y) else np.nan)
        if not np.isfinite(nearer).any():
            return 0.0
        # Beside both feet the two cancel; rounding must not decide the sign.
        return round(float(np.nanmean(nearer)), 6)

    @property
    def feet_apart_m(self) -> float:
        """Distance of the left foot to the left of the right one [m]."""
        feet = self.recording.motion.feet
        left, right = (
            feet[side][self.inside, :, 1].mean(axis=1) for side in SIDES
        )
        return float(np.median(left - right))

    @property
    def has_both_feet(self) -> bool:
        """Whether both feet carry markers."""
        return all(side in self.recording.motion.feet for side in SIDES)


_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2}
_FLAT_SAMPLES, _FLAT_S = 5, 0.05
_MOVES_SHARE = 0.02  # of body weight: change of force that motion requires


def plate_checks(e: Evidence) -> Iterator[Check]:
    """Checks of the plates in one trial."""
    for foot in e.plates:
        if np.isfinite(e.outside(foot)[0]):
            yield from _pressure(e, foot)
    if e.has_both_feet:
        yield _foot_sides(e)
        if e.has_two_plates:
            yield _sides(e)
    for name, w in e.recording.forces.recorded.items():
        yield from _stuck(e, name, w[:, 2])
    if e.recording.chair is not None:
        yield _chair(e)


def _beyond(x, low, high):
    """Distance of x outside the range low to high; negative inside."""
    return np.maximum(low - x, x - high)


def likely_cause(e: Evidence) -> str | None:
    """Mistake that would explain CoPs beside their feet; None if they fit."""
    if _fits(e):
        return None
    if _knees_bend_backwards(e):
        return "laboratory.marker_axes look turned round"
    for unit, scale in _LENGTHS.items():
        if _fits(e, scale=scale):
            return f"the points of the force file look like {unit}"
    exchanged = e.has_two_plates and e.has_both_feet and e.off_side() < 0.0
    if exchanged and e.feet_apart_m < 0.0:
        return "the names of left and right markers look exchanged"
    if exchanged and e.pitch_error() <= e.pitch_error(turned=True):
        return "plates.left and plates.right look exchanged"
    if _fits(e, turned=True):
        return "laboratory.force_axes look turned round"
    return (
        "check plates, laboratory.force_axes and that markers and plates "
        "share one origin"
    )


def _knees_bend_backwards(e: Evidence) -> bool:
    """Whether a knee is overextended by more than 20 degrees."""
    knees = [a[e.inside, 1].min() for a in e.recording.motion.legs.values()]
    return np.rad2deg(min(knees)) < -20.0


def _fits(e: Evidence, **changed) -> bool:
    """Whether each CoP is under its own foot, with `cop`'s `changed`."""
    for foot in e.plates:
        along, across = e.outside(foot, **changed)
        if along > LIMITS["cop_along"][0] or across > LIMITS["cop_across"][0]:
            return False
    if e.has_two_plates and e.has_both_feet:
        return e.off_side(**changed) >= 0.0
    return True


def _pressure(e: Evidence, foot: str) -> Iterator[Check]:
    along, across = e.outside(foot)
    cause = likely_cause(e)
    for name, value, words in (
        ("cop_along", along, "in front of or behind"),
        ("cop_across", across, "beside"),
    ):
        if not np.isfinite(value):
            continue
        yield e.check(
            name,
            value,
            f"the centre of pressure of plate {foot!r} is {value:.3g} m "
            f"{words} the foot that its markers show; {cause}",
        )
    if along <= LIMITS["cop_along"][0]:
        most, borne = e.astray(foot)
        yield e.check(
            "cop_light",
            most,
            f"the centre of pressure of plate {foot!r} strays {most:.3g} m off "
            f"the foot while up to {borne:.0f} N are borne, as points that "
            "were filtered do at touch-down and lift-off; set "
            f"laboratory.hold_cop_below_n to about {10 * round(borne / 5):.0f}",
            level="note",
        )
    far = float(np.fmax(along, across))
    is_unit = any(_fits(e, scale=s) for s in _LENGTHS.values())
    yield e.check(
        "cop_unit",
        far,
        f"the centre of pressure of plate {foot!r} is {far:.3g} m off the "
        f"foot that its markers show; {cause}",
        holds=not far > LIMITS["cop_unit"][0] or not is_unit,
    )


def _foot_sides(e: Evidence) -> Check:
    """Whether the left foot is left of the right one."""
    apart = e.feet_apart_m
    cause = (
        "laboratory.marker_axes look turned round"
        if _knees_bend_backwards(e)
        else "the names of left and right markers look exchanged"
    )
    return e.check(
        "foot_sides",
        apart,
        f"markers of the left foot lie {-apart:.2f} m right of the other's; "
        f"{cause}",
    )


def _sides(e: Evidence) -> Check:
    nearer = e.off_side()
    return e.check(
        "plate_sides",
        nearer,
        f"the centre of pressure of each plate is {-nearer:.2f} m nearer to "
        f"the other foot; {likely_cause(e)}",
    )


def _repeats(e: Evidence, F_z: np.ndarray) -> list[tuple[int, int]]:
    """Runs (start, end) of an unchanged load while motion requires change."""
    forces, motion = e.recording.forces, e.recording.motion
    loaded = np.abs(F_z) > COP_THRESHOLD_N
    same = np.r_[False, np.diff(F_z) == 0.0] & loaded
    least = max(_FLAT_SAMPLES, _FLAT_S * forces.rate_hz)
    needed = np.interp(forces.time, motion.time, e.needed_z)
    return [
        (a, b)
        for a, b in runs(same)
        if b - a >= least and np.ptp(needed[a:b]) > _MOVES_SHARE * e.weight
    ]


def _stuck(e: Evidence, name: str, F_z: np.ndarray) -> Iterator[Check]:
    """Checks for a plate that does not measure, or whose peaks are clipped."""
    found, top = _repeats(e, F_z), F_z.max()
    rate = e.recording.forces.rate_hz
    loaded = max(int((np.abs(F_z) > COP_THRESHOLD_N).sum()), 1)
    share = sum(b - a for a, b in found) / loaded
    longest = max(found, key=lambda run: run[1] - run[0], default=(0, 0))
    seconds = (longest[1] - longest[0]) / rate
    yield e.check(
        "flat_channel",
        100.0 * share,
        f"plate {name!r} stays at exactly {F_z[longest[0]]:.4g} N for "
        f"{seconds:.2g} s while the body moves; the channel is a filler, not "
        "a measurement: leave the plate out of plates or export its signal",
    )
    seconds = max((b - a for a, b in found if F_z[a] == top), default=0) / rate
    yield e.check(
        "saturated_channel",
        seconds,
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
        f"feet and chair together miss {rms:.0f} N RMS of what the motion asks "
        "for over the whole recording; plates.chair may name the wrong plate, "
        "or one that does not measure",
    )


RANGES_DEG = {"ankle": (-50.0, 60.0), "knee": (-20.0, 165.0)}
RANGES_DEG["hip"] = (-45.0, 150.0)
_LEAP_REACH_S = 0.25  # how far the filter carries a fault into the used part
_LIFTED, _STANDS = 0.05, 0.3  # of body weight: at most, and at least
# Least mean square speed along a direction, over that across it.
_ALONG = 4.0
# kgf and daN differ by 2 %, too little to tell apart.
_UNITS = {"kN": 1e-3, "lbf": 1.0 / 4.448, "kgf or daN": 0.1}


def standing_checks(
    subject: SubjectModel, standing: Standing
) -> Iterator[Check]:
    """Checks of the standing trial."""
    said = subject.report
    measured, stated = said.get("standing_mass_kg"), said["stated_mass_kg"]
    if measured is not None and stated is not None:
        off = measured / stated - 1.0
        # The unit of force is judged by all that the plates bear, device too.
        device = subject.model.tree.mass - subject.mass_kg
        borne = (measured + device) / (stated + device)
        beyond = "beyond the device " if device > 0.5 else ""
        yield _judged(
            "mass",
            100.0 * abs(off),
            "standing",
            f"{listed(standing.forces)}: the plates bear {measured:.3g} kg "
            f"{beyond}in standing, subject.mass_kg says {stated:.3g} kg; "
            + (_unit_of(borne) or "correct the mass or standing.plates")
            + (", or say 'model: human' if no device was worn" * bool(beyond)),
        )
    joints = subject.model.coordinates.human
    angles = dict(zip(joints, said["standing_angles_deg"][1:], strict=True))
    worst = max(angles, key=lambda name: abs(angles[name]))
    yield _judged(
        "standing_posture",
        abs(angles[worst]),
        "standing",
        f"{standing.markers}: {worst} at {angles[worst]:.0f} deg in standing; "
        "laboratory.marker_axes may be wrong, markers.joint_centres may name "
        "other markers, or the subject does not stand upright",
    )
    leg = said["lengths_m"]["shank"] + said["lengths_m"]["thigh"]
    leg += said["ankle_height_m"]
    ratio = leg / said["table_leg_m"]
    yield _judged(
        "stature",
        100.0 * abs(ratio - 1.0),
        "standing",
        f"{standing.markers}: the hips are {leg:.2f} m above the floor, which "
        f"is {100 * ratio:.0f} % of what is usual for subject.height_m; check "
        "the height, markers.joint_centres, and that the floor is at z = 0 in "
        f"the files (ankles are {1e3 * said['ankle_height_m']:.0f} mm above)",
        level="note",
    )
    if "standing_cop_x_m" in said:
        gap = said["standing_cop_x_m"] - said["standing_com_x_m"]
        if "trunk_com_shift_m" in said:
            gap = said["trunk_com_shift_m"]
        yield _judged(
            "standing_balance",
            abs(gap),
            "standing",
            f"{listed(standing.forces)}: the centre of pressure is "
            f"{abs(gap):.2f} m {'in front of' if gap > 0.0 else 'behind'} "
            "the centre of mass in standing; laboratory.force_axes or "
            "marker_axes may be turned round, or plates and markers have "
            "another origin",
        )


def body_checks(e: Evidence) -> Iterator[Check]:
    """Checks of the body in one trial."""
    if e.has_both_feet:
        yield from _facing(e)
    yield from _ranges(e)
    yield _markers(e)
    yield _leap(e)
    yield _standstill(e)
    yield from _floor(e)
    yield from _dynamics(e)
    if e.model.assembly.human.sides:
        yield _belt(e)
        yield _end_joints(e)
    else:  # two legs: a step ends in mid-movement, and legs move differently
        yield _end(e)
        yield _slides(e)
        if e.has_both_feet:
            yield from _legs(e)


def _belt(e: Evidence) -> Check:
    """Whether feet that bear the body are at rest, not on an unstated belt."""
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
        f"feet that bear the body move at {speed:+.2f} m/s, as on a "
        f"treadmill; say 'ground: {{belt_speed_m_s: {belt:.2f}}}'",
    )


def _facing(e: Evidence) -> Iterator[Check]:
    """Whether markers move forward and back rather than obliquely."""
    steps = np.diff(e.recording.motion.ground_plan[e.inside], axis=0)
    x, y = steps[np.isfinite(steps).all(axis=2)].T
    squares = (x + 1j * y) ** 2
    spread = np.abs(squares).sum()
    along = 0.5 * (spread + np.abs(squares.sum()))
    if along < _ALONG * (spread - along):
        return  # who stands or bobs up and down moves in no direction
    turned = float(np.rad2deg(np.angle(squares.sum()) / 2.0))
    facing = turned
    if _knees_bend_backwards(e):
        facing -= np.copysign(180.0, turned)
    yield e.check(
        "facing",
        abs(turned),
        f"the markers move in a plane that is turned {abs(turned):.0f} deg to "
        f"the {'left' if turned > 0.0 else 'right'} of forward; add "
        f"{facing:.0f} to facing_deg of laboratory.marker_axes and force_axes, "
        "or of the trial's own marker_axes",
    )


def _ranges(e: Evidence) -> Iterator[Check]:
    for side, angles in e.recording.motion.legs.items():
        deg = np.rad2deg(angles[e.inside])
        for joint, x in zip(LEG_JOINTS, deg.T, strict=True):
            low, high = RANGES_DEG[joint]
            bent = x.min() if low - x.min() > x.max() - high else x.max()
            backwards = joint == "knee" and bent < low
            yield e.check(
                f"{joint}_range",
                bent,
                f"the {side} {joint} turns to {bent:.0f} deg, beyond "
                f"{low:.0f} to {high:.0f} deg; "
                + (
                    "the knee bends backwards: laboratory.marker_axes look "
                    "turned round"
                    if backwards
                    else "check the names of markers and marker_axes"
                ),
                holds=low <= x.min() and x.max() <= high,
                limit=low if bent == x.min() else high,
            )


def _markers(e: Evidence) -> Check:
    off = e.recording.motion.residuals_m
    rms = residual_rms({name: x[e.inside] for name, x in off.items()})
    worst = max(rms, key=rms.get)
    overall = float(np.sqrt(np.mean(np.square(list(rms.values())))))
    return e.check(
        "markers",
        overall,
        f"markers lie {1e3 * overall:.0f} mm off a body of rigid segments, "
        f"most {worst} ({1e3 * rms[worst]:.0f} mm); markers may be exchanged, "
        "or laboratory.marker_axes wrong",
    )


def _leap(e: Evidence) -> Check:
    """Whether a marker leaps: confused with another or with a reflection."""
    worst = _worst(e, e.recording.motion.leaps)
    far = worst.size > LIMITS["marker_leap"][0]
    return e.check(
        "marker_leap",
        worst.size,
        f"marker {worst.marker!r} leaps at {worst.time_s:g} s "
        f"(by {worst.size:.3g} m/s from frame to frame); it was taken for "
        "another marker or for a reflection: correct its label, or delete it "
        "in these frames (gaps are filled)",
        limit=None if far else LEAST_LEAP_M_S,
        level="fail" if far else "note",
    )


def _standstill(e: Evidence) -> Check:
    """Whether a marker is frozen while the others of its segment move."""
    worst = _worst(e, e.recording.motion.standstills)
    return e.check(
        "marker_frozen",
        worst.size,
        f"marker {worst.marker!r} stays in exactly one place from "
        f"{worst.time_s:g} s on while its segment moves by "
        f"{worst.size:.2g} m; it was filled in, not measured: delete it in "
        "these frames",
    )


def _worst(e: Evidence, found: Iterable[MarkerFault]) -> MarkerFault:
    """Largest fault in the used part, and where the filter reaches from."""
    start, end = e.trial.start_s, e.trial.start_s + e.trial.duration
    near = [
        one
        for one in found
        if start - _LEAP_REACH_S < one.time_s < end + _LEAP_REACH_S
    ]
    nothing = MarkerFault("", start, 0.0)
    return max(near, key=lambda one: one.size, default=nothing)


def _floor(e: Evidence) -> Iterator[Check]:
    """Whether markers of loaded feet are as high as in standing."""
    motion = e.recording.motion
    model = e.subject.markers.without((*motion.without, *motion.absent))
    for side, markers in motion.feet.items():
        plate = side if side in e.plates else "both"
        if plate not in e.plates or not e.loaded(plate).any():
            continue
        z = markers[e.inside, :, 2][e.loaded(plate)]
        # Markers are lowest while the foot is flat, as in standing.
        higher = z - model.foot_heights_m(side)
        above = float(np.quantile(higher.mean(axis=1), 0.05))
        lowest = higher[higher.mean(axis=1) <= above].mean(axis=0)
        limit = LIMITS["floor"][0]
        # On its toes or heel a foot is tilted, and is never flat.
        near = min(0.5 * float(np.ptp(lowest)), 2.0 * limit)
        if above > limit and np.abs(lowest).min() <= near:
            continue
        yield e.check(
            "floor",
            abs(above),
            f"markers of the {side} foot are {1e3 * abs(above):.0f} mm "
            f"{'higher' if above > 0.0 else 'lower'} than in standing while it "
            "bears weight; the floor of the two recordings, or where markers "
            "are on the foot, differs",
        )


def _laws(e: Evidence | Made, cause: str) -> Iterator[Check]:
    """Newton's and Euler's law."""
    rms = np.sqrt(np.mean((e.needed - e.measured) ** 2, axis=0))
    moment = e.pitch_error()
    force = float(rms[:2].max())
    root = "hips" if e.model.assembly.human.sides else "ankle"
    yield e.check(
        "newton",
        force,
        f"Newton's law misses {force:.0f} N RMS "
        f"({100 * force / e.weight:.0f} % of body weight); {cause}",
    )
    yield e.check(
        "euler",
        moment,
        f"Euler's law misses {moment:.0f} N m RMS about the {root}; {cause}",
    )


def made_checks(model: Model, trial: Trial) -> Iterator[Check]:
    """Checks of a trial that is not cut from a recording: Newton's and Euler's.

    None if it is of another model or holds NaN, which is refused elsewhere.
    """
    if trial.coordinates == model.coordinates and trial.not_finite() is None:
        cause = (
            "check the model's mass, signs and units of q, v, a and ground, "
            "and that moments are about the origin; a chair or a load that "
            "acts belongs in chair or applied"
        )
        yield from _laws(Made(trial, model), cause)


def _dynamics(e: Evidence) -> Iterator[Check]:
    missing = e.needed - e.measured
    borne = float(np.mean(e.measured[:, 1]) / np.mean(e.needed[:, 1]))
    unit = _unit_of(borne)
    yield from _laws(
        e, unit or likely_cause(e) or "check plates, axes and clocks"
    )
    means = {"forward": (float(missing[:, 0].mean()), 0.0)}
    if not e.recording.forces.is_one_leg:
        across = sum(w[:, 1] for w in e.plates.values()).mean()
        means["sideways"] = -float(across), _sway(e)
    for way, (mean, more) in means.items():
        yield e.check(
            f"mean_{way}",
            abs(mean),
            f"plates bear {-mean:+.0f} N {way} on average that the motion does "
            f"not ask for ({100 * abs(mean) / e.weight:.0f} % of body weight); "
            "a plate's axes, or its corners in the file, look turned",
            limit=LIMITS[f"mean_{way}"][0] + more,
        )
    yield e.check(
        "mean_weight",
        100.0 * abs(borne - 1.0),
        f"plates bear {100 * borne:.0f} % of what the motion asks for; "
        + (
            unit
            or "check subject.mass_kg, each plate's gain, a foot beside its "
            "plate, or a part in which the chair still bears"
        ),
    )


def _sway(e: Evidence) -> float:
    """Mean sideways force of a walker in the used part, in body weights.

    Zero if it ends on the same feet as it begins on, and not with the other one
    in front, as a stance or a swing does: the CoM sways back.
    """
    first, last = ([e.loaded(p)[k] for p in e.plates] for k in (0, -1))
    ankles = e.recording.motion.ankles
    ahead = np.zeros(2)
    if all(side in ankles for side in SIDES):
        left, right = (ankles[side][e.inside, 0] for side in SIDES)
        ahead = (left - right)[[0, -1]]
    passed = ahead.min() < -_STEP_M and ahead.max() > _STEP_M
    swayed = passed or first != last
    return 2.0 * _SWAY_M_S / (g * e.trial.duration) * swayed


def shear_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Whether fore-aft forces have the sign that the motion requires.

    Of each plate and of all plates, over all trials with the same plates: the
    fore-aft force in one trial may be too small to judge.
    """
    groups: dict[Plates, list[Evidence]] = {}
    for e in evidence:
        groups.setdefault(e.files.plates, []).append(e)
    for group in groups.values():
        names = list(group[0].plates)
        turned = [[name] for name in names]
        if len(names) > 1:
            turned.append(names)
        own = sum(_shear_missed(e) for e in group)
        fits = [sum(_shear_missed(e, some) for e in group) for some in turned]
        best = int(np.argmin(fits))
        least = _SHEAR_OF_WEIGHT**2 * sum(len(e.measured) for e in group)
        ratio = float(np.sqrt(own / max(fits[best], least)))
        which = " and ".join(map(repr, turned[best]))
        yield group[0].check(
            "shear_sign",
            ratio,
            f"fore-aft force of plate {which} fits the motion {ratio:.2g} "
            f"times better turned round ({len(group)} trials); its axes, "
            "corners or laboratory.force_axes look wrong",
        )


def _shear_missed(e: Evidence, turned: Iterable[str] = ()) -> float:
    """Sum of squares of F_x's residual about its mean, in body weights.

    Args:
        e: a trial.
        turned: plates whose F_x is taken with the opposite sign.
    """
    factor = 2.0 if e.recording.forces.is_one_leg else 1.0
    added = factor * sum(2.0 * e.plates[name][:, 0] for name in turned)
    missed = (e.needed - e.measured)[:, 0] + added
    return float(np.sum((missed - missed.mean()) ** 2)) / e.weight**2


def _unit_of(ratio: float) -> str | None:
    """Unit of force, in words, that explains measured over required force."""
    for unit, factor in _UNITS.items():
        if abs(ratio / factor - 1.0) < 0.15:
            return f"forces look like {unit}: export newtons"
    return None


def _end(e: Evidence) -> Check:
    """Whether the recording starts or ends while the hips move."""
    motion = e.recording.motion
    first, last = np.flatnonzero(e.inside)[[0, -1]]
    hips = np.abs(np.gradient(motion.hip_z, motion.time))
    starts = float(hips[first]) if first <= 1 else 0.0
    stops = float(hips[last]) if last >= len(motion.time) - 2 else 0.0
    speed, said = _worse_end(motion.time, starts, stops)
    return e.check(
        "end",
        speed,
        f"{said} while the hips move at {speed:.2f} m/s, in the middle of the "
        "movement: export the whole trial",
    )


def _worse_end(time, starts: float, stops: float) -> tuple[float, str]:
    """The larger of the speeds at start and end, and which, in words."""
    if starts > stops:
        return starts, f"the recording starts at {time[0]:g} s"
    return stops, f"the recording ends at {time[-1]:g} s"


def _end_joints(e: Evidence) -> Check:
    """Whether joints are slow where the used part is near the file's ends.

    The filter continues a recording beyond its ends without acceleration, so
    accelerations there are lost, and are wrong within half of its reach.
    """
    time, legs = e.recording.motion.time, e.recording.motion.legs
    angles = np.rad2deg(np.hstack(list(legs.values())))
    speeds = np.abs(np.gradient(angles, time, axis=0)).max(axis=1)
    reach = 0.5 / e.trial.provenance["filter"]["cutoff_hz"]
    first, last = np.flatnonzero(e.inside)[[0, -1]]
    starts, stops = (
        float(speeds[rows].max()) if gap < reach else 0.0
        for rows, gap in (
            (slice(first + 1), time[first] - time[0]),
            (slice(last, None), time[-1] - time[last]),
        )
    )
    speed, said = _worse_end(time, starts, stops)
    return e.check(
        "end_joints",
        speed,
        f"{said}, within {1e3 * reach:.0f} ms of the used part, while a joint "
        f"turns at {speed:.0f} deg/s; the filter does not know how the "
        "movement goes on: export more of it, or use a part further from there",
    )


def _slides(e: Evidence) -> Check:
    """Whether feet stay where they stand; heels may rise, but not toes too."""
    paths = {
        side: float(np.ptp(markers[e.inside, :, 0], axis=0).min())
        for side, markers in e.recording.motion.feet.items()
    }
    side = max(paths, key=paths.__getitem__)
    return e.check(
        "foot_slides",
        paths[side],
        f"every marker of the {side} foot moves by {1e3 * paths[side]:.0f} mm "
        "or more along the floor, and calibrated contact would slip; use a "
        "part in which feet stay (if these are coordinates of inverse "
        "kinematics: give the markers)",
        level="note",
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
        f"left and right {LEG_JOINTS[worst]} differ by {rms[worst]:.0f} deg "
        f"RMS, but {one}; this may be walking or a step, or markers of left "
        "and right exchanged",
    )
    x = [motion.ankles[s][e.inside, 0].mean() for s in SIDES]
    yield e.check(
        "feet_apart",
        abs(x[0] - x[1]),
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
        f"one foot is in the air for {100 * lifted.mean():.0f} % of the used "
        f"part, but {one}; this may be walking, not a rise",
    )


GAINS = (0.4, 2.5)
_REACH_S = 0.06
_FACES = 0.3  # floor of a cuff's summed forward shares: mats at the sides
_MOVES_DEG = 10.0  # joints of smaller range are not judged by their angles
_FAR_DEG = 30.0  # joints of smaller range are not judged by their speeds
_UPRIGHT_SHARE = 0.05  # of the trial, around its most upright posture
_STEP_S = 0.005  # of lags that are tried
_STILL_DEG_S, _FROZEN_S = 0.5, 0.1  # slower for this long is a standstill


def device_checks(e: Evidence) -> Iterator[Check]:
    """Checks of the encoders in one trial."""
    if e.recording.angles is None:
        return
    names = e.trial.coordinates
    human = np.rad2deg(e.expected(e.trial.body[0]))
    device = np.rad2deg(e.trial.q[:, names.device_columns])
    offsets = _offsets(e)
    for i, name in enumerate(names.device):
        h, d = human[:, i], device[:, i]
        if np.ptp(h) > _MOVES_DEG:
            yield from _follows(e, name, h, d)
        offset = float(offsets[i])
        yield e.check(
            "encoder_offset",
            abs(offset),
            f"{name} reads {offset:+.0f} deg off the person's "
            f"{names.follows(name) or 'stance'} in the most upright posture; "
            "the encoder's zero is wrong, or it is another joint's",
        )
        yield _frozen(e, i)
    spans = np.ptp(human, axis=0)
    yield from _exchanged(e, human, device, np.flatnonzero(spans > _MOVES_DEG))
    if (spans > _FAR_DEG).any():
        missed = 100.0 * misfit(e, e)[0]
        yield e.check(
            "encoder_motion",
            missed,
            f"{missed:.0f} % of the joints' speed is not in the encoders; the "
            "file may be of another trial, or its clock far off",
        )


def load_checks(e: Evidence) -> Iterator[Check]:
    """Checks of mats, and of the device's joint moments, in one trial."""
    for cuff, force in e.trial.cuffs.items():
        mats = [m for m in e.recording.mats if m.segment == cuff]
        file = next(f for f in e.files.pressure if mats[0].name in f.mats).file
        change = float(np.ptp(force.normal))
        yield e.check(
            "mat_still",
            change,
            f"the force of {cuff}'s mats changes by {change:.3g} N in the "
            "whole trial; they are unplugged, or stand still",
            file=file,
        )
        yield _one_sided(e, mats, file)
    if e.trial.moments is None:
        return
    names = e.trial.coordinates.device
    for name, moment in zip(names, e.trial.device_moments.T, strict=True):
        found = float(np.abs(moment).max())
        yield e.check(
            "device_moment",
            found,
            f"the moment of {name} reaches {found:.3g} N m, more than the "
            f"body's weight makes {LIMITS['device_moment'][0]:g} m away; it "
            "may be in N mm, or friction of device is in other units",
            file=e.files.exo_moments or "device",
        )


def _one_sided(e: Evidence, mats: Sequence[MatForce], file: Path) -> Check:
    """Whether a cuff has mats both in front of and behind its segment."""
    faces = np.array([m.report["forward_share"] for m in mats])
    share = abs(faces.sum()) / max(np.abs(faces).sum(), _FACES)
    side = "behind" if faces.sum() > 0.0 else "the front"
    return e.check(
        "mat_sides",
        share,
        f"mats of {mats[0].segment} ({', '.join(m.name for m in mats)}) all "
        f"press from {side}; if a mat lies on the other side, name it, too",
        file=file,
        level="note",
    )


def _offsets(e: Evidence) -> np.ndarray:
    """Offsets (joints,) of the encoders from the person's angles [deg], in the
    most upright posture of the recording: the used part may end before it.
    """
    angles, motion = e.recording.angles, e.recording.motion
    both = between(motion.time, angles.time[0], angles.time[-1])
    human = np.rad2deg(e.expected(motion.q[both]))
    device = linear(angles.time, angles.values, motion.time[both])
    upright = _most_upright(human)
    off = np.rad2deg(device) - human
    return off[upright].mean(axis=0)


def _most_upright(human: np.ndarray) -> np.ndarray:
    """Frames (n,) bool around the one whose joints are bent least."""
    at = int(np.argmin(np.abs(human).sum(axis=1)))
    reach = max(2, round(0.5 * _UPRIGHT_SHARE * len(human)))
    return np.abs(np.arange(len(human)) - at) <= reach


def _follows(e: Evidence, name: str, h, d) -> Iterator[Check]:
    moves = np.std(d) > 0.0
    r = float(np.corrcoef(h, d)[0, 1]) if moves else 0.0
    yield e.check(
        "encoder_sign",
        r,
        f"{name} does not follow the person's joint (correlation {r:.2f}); "
        + (
            "its sign looks flipped: negate the column"
            if r < -LIMITS["encoder_sign"][0]
            else "the file may be of another joint or trial"
        ),
    )
    gain = float(np.std(d) / np.std(h))
    low, high = GAINS
    yield e.check(
        "encoder_unit",
        gain,
        f"{name} moves {gain:.3g} times as far as the person's joint; degrees "
        "may be taken for radians or the other way round",
        holds=low <= gain <= high,
        limit=low if gain < 1.0 else high,
    )


def _frozen(e: Evidence, i: int) -> Check:
    """Whether an encoder is frozen while the person's joint moves."""
    angles, motion = e.recording.angles, e.recording.motion
    human = e.expected(motion.q)[:, i]
    human = np.rad2deg(np.interp(angles.time, motion.time, human))
    speed = np.gradient(np.rad2deg(angles.values[:, i]), angles.time)
    start, end = e.trial.start_s, e.trial.start_s + e.trial.duration
    still = np.abs(speed) < _STILL_DEG_S
    still &= between(angles.time, start, end)
    least = _FROZEN_S / (angles.time[1] - angles.time[0])
    moved = [np.ptp(human[a:b]) for a, b in runs(still) if b - a >= least]
    most = max(moved, default=0.0)
    return e.check(
        "encoder_frozen",
        most,
        f"{e.trial.coordinates.device[i]} stands still while the person's "
        f"joint turns by {most:.0f} deg; the channel is flat or saturated",
    )


def _exchanged(e: Evidence, human, device, moving) -> Iterator[Check]:
    """Whether two encoders fit better with their columns exchanged."""
    names = e.trial.coordinates.device
    # Means are removed: an offset is for `encoder_offset` to find.
    human = human - human.mean(axis=0)
    device = device - device.mean(axis=0)
    # A flipped sign is no exchange either; `encoder_sign` finds it.
    alike = np.where(np.sum(device * human, axis=0) < 0.0, -device, device)
    for a, b in combinations(moving, 2):
        expected = human[:, [a, b]]
        own = float(np.linalg.norm(alike[:, [a, b]] - expected))
        other = float(np.linalg.norm(device[:, [b, a]] - expected))
        yield e.check(
            "encoder_joints",
            own / max(other, 1e-9),
            f"{names[a]} moves as the joint of {names[b]} should, and the "
            "other way round; their columns look exchanged",
        )


def misfit(e: Evidence, encoders: Evidence) -> tuple[float, float]:
    """Relative misfit of encoder speeds to a person's joint speeds.

    Of `e`'s joints that move by 30° against the files of `encoders`, at the
    best lag of the clock within 60 ms.

    Returns:
        The misfit and that lag [s]; infinite if the encoders do not cover the
        movement, or no joint moves by 30°.
    """
    q, v = map(e.expected, e.trial.body[:2])
    moving = np.ptp(np.rad2deg(q), axis=0) > _FAR_DEG
    if not moving.any():
        return np.inf, 0.0
    time, v = e.trial.start_s + e.trial.times, v[:, moving]
    angles = encoders.recording.angles
    rates = np.gradient(angles.values[:, moving], angles.time, axis=0)
    best = np.inf, 0.0
    for lag in np.arange(-_REACH_S, _REACH_S + 1e-9, _STEP_S):
        t = time + lag
        if t[0] < angles.time[0] - 0.1 or t[-1] > angles.time[-1] + 0.1:
            continue
        d = linear(angles.time, rates, t)
        share = float(np.linalg.norm(d - v) / np.linalg.norm(v))
        best = min(best, (share, float(lag)))
    return best


def between_trials(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Checks whether encoders belong to the trial that names them."""
    known = [e for e in evidence if e.recording.angles is not None]
    # Misfit of each movement (rows) with each file (columns).
    fits = np.array([[misfit(e, o)[0] for o in known] for e in known])
    hidden = _hidden(fits)
    for i, e in enumerate(known):
        others = [
            j for j, o in enumerate(known) if o.files.markers != e.files.markers
        ]
        if not others:
            continue
        own = e.recording.angles.values
        same = [
            j
            for j in others
            if np.array_equal(own, known[j].recording.angles.values)
        ]
        name = known[same[0]].trial.name if same else ""
        best = min(others, key=lambda j, i=i: fits[j, i])
        ratio = _ratio(fits[i, i], max(fits[best, i], hidden))
        yield e.check(
            "encoder_file",
            ratio,
            f"holds the same angles as the file of trial {name}; one of the "
            "two is another trial's"
            if same
            else f"its angles fit the movement of trial "
            f"{known[best].trial.name} {ratio:.1f} times better; it is "
            "another trial's file",
            holds=not same and ratio <= LIMITS["encoder_file"][0],
        )
        yield _swap("encoder_swap", known, fits, i, others, "fail")


LARGEST_COMMON_LAG_MS = 12.0  # of all trials together
_COMMON_S, _COMMON_BETTER = 0.045, 1.15
_BETTER = 1.7  # least ratio of misfits by which another lag must be better
_FITS = 0.01  # of body weight: smaller misfits count as this much
_LAGS_S = np.linspace(-0.2, 0.2, 41)
_NOW = len(_LAGS_S) // 2  # index of no lag
_RECORDED = 0.9  # least share of the used part that plates must cover


def force_misfit(e: Evidence, other: Evidence, lag_s: float = 0.0) -> float:
    """Standard deviation of measured less required vertical force [N].

    Args:
        e: whose motion requires the force, in the used part.
        other: whose plates measure it.
        lag_s: of the plates' clock.

    Returns:
        Infinite if the plates cover less than 90 % of the used part (a
        clock's lag costs milliseconds at an end).
    """
    forces = other.recording.forces
    time = e.recording.motion.time[e.inside] + lag_s
    known = (time >= forces.time[0]) & (time <= forces.time[-1])
    if known.mean() < _RECORDED:
        return np.inf
    # One foot alone on a plate stands for both.
    feet = [name for name in forces.recorded if name in SIDES]
    borne = sum(
        w[:, 2] * (2.0 if [name] == feet else 1.0)
        for name, w in forces.recorded.items()
    )
    missed = np.interp(time, forces.time, borne) - e.needed_z[e.inside]
    return float(np.std(missed[known]))


def _best_lag(
    missed: np.ndarray, least: float, reach_s: float = np.inf
) -> tuple[float, float]:
    """Lag of the least misfit [ms], and the ratio by which it is better.

    The lag is 0 if the ratio is below `least` or the lag beyond `reach_s`.
    """
    best = int(np.argmin(missed))
    lag, better = float(_LAGS_S[best]), _ratio(missed[_NOW], missed[best])
    is_told = better >= least and abs(lag) <= reach_s
    return 1e3 * lag if is_told else 0.0, better


def force_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Checks of the plates' clock, and whether forces are of this trial."""
    if not evidence:
        return
    missed = np.array(
        [[force_misfit(e, e, lag) for lag in _LAGS_S] for e in evidence]
    )
    if len(evidence) > 1:
        # Of all trials together: skin motion shifts each one differently.
        together = np.linalg.norm(missed, axis=0)
        lag, better = _best_lag(together, _COMMON_BETTER, _COMMON_S)
        yield evidence[0].check(
            "force_clock",
            abs(lag),
            f"forces of all {len(evidence)} trials fit the motion {better:.2g} "
            f"times better if they are taken as {lag:+.0f} ms late; plates are "
            "filtered differently from markers, or their clock is not the "
            "markers' (laboratory.estimate_force_delay)",
            limit=LARGEST_COMMON_LAG_MS,
            level="note",
        )
    # Misfit of each movement (rows) with each file (columns).
    fits = np.array([[force_misfit(e, o) for o in evidence] for e in evidence])
    for i, e in enumerate(evidence):
        lag, better = _best_lag(missed[i], _BETTER)
        lifted = any(
            np.isfinite(load.carried_s).any() for load in e.files.loads
        )
        yield e.check(
            "force_clock",
            abs(lag),
            f"forces fit the motion {better:.1f} times better if they are "
            f"taken as {lag:+.0f} ms late; "
            + "loads are not carried from from_s to to_s, or "
            * lifted
            + "the plates' clock is not the markers' "
            "(laboratory.estimate_force_delay)",
        )
        others = [
            j
            for j, o in enumerate(evidence)
            if o.files.forces != e.files.forces
        ]
        if not others:
            continue
        best = min(others, key=lambda j, i=i: fits[i, j])
        # Of nearly equal movements, errors of the inertias would prefer one.
        ratio = _ratio(fits[i, i], max(fits[i, best], _FITS * e.weight))
        yield e.check(
            "force_file",
            ratio,
            f"forces of trial {evidence[best].trial.name} fit this motion "
            f"{ratio:.1f} times better; the file is another trial's",
        )
        yield _swap("force_swap", evidence, fits, i, others, "note")


def _swap(
    name: str,
    evidence: Sequence[Evidence],
    fits: np.ndarray,
    i: int,
    others: Sequence[int],
    level: Level,
) -> Check:
    """Check whether two trials fit better with their files exchanged.

    Errors that cuffs or inertias cause in all movements alike cancel.

    Args:
        name: of the check.
        evidence: of k trials.
        fits: (k, k) misfit of each movement with each file, or of each file
            with each movement.
        i: index of the trial.
        others: indices of trials with other files.
        level: of the check.
    """
    swapped = {
        j: _ratio(
            np.hypot(fits[i, i], fits[j, j]), np.hypot(fits[i, j], fits[j, i])
        )
        for j in others
    }
    other = max(swapped, key=swapped.get)
    return evidence[i].check(
        name,
        swapped[other],
        f"this trial and {evidence[other].trial.name} fit "
        f"{swapped[other]:.2f} times better with each other's "
        f"{LIMITS[name][2]}; the two files look exchanged",
        level=level,
    )


def _hidden(fits: np.ndarray) -> float:
    """Misfit that compliant cuffs cause: the lower median of the best misfits.

    Each file's best misfit, with whichever movement, is taken. A file that
    fits better than this does so by chance: the device may happen to move more
    like the person in another trial than like its wearer.

    Args:
        fits: (k, k) misfit of each movement with each file.
    """
    least = fits.min(axis=0, initial=np.inf)
    least = least[np.isfinite(least)]
    if not len(least):
        return 0.0
    return float(np.quantile(least, 0.5, method="lower"))


def _ratio(own: float, other: float) -> float:
    """Ratio of the own misfit to another; 0 if the own is not finite."""
    return float(own / max(other, 1e-9)) if np.isfinite(own) else 0.0


_DEG = np.pi / 180.0
# Prior standard deviations of the causes of angle differences between device
# and person. _SKIN and _BEND are linear and quadratic in the person's angle.
_OFFSET, _SKIN, _BEND = 2.0 * _DEG, 0.03, 0.015  # rad, rad/rad, rad/rad^2
_WEIGHT = 2.0 * _DEG  # of a device's link that lies instead of standing
_INERTIA = 0.05 * _DEG  # per rad/s^2
_FRICTION = 1.0 * _DEG
_DRIVE = 0.2 * _DEG  # per N m
_CLOCK_S = 0.03
_REST_RAD_S = 0.05  # joint speed over which friction's sign is smoothed
_NOISE, _CORRELATED_S = 0.5 * _DEG, 0.1


@dataclass(frozen=True)
class _Difference:
    """Angles of the device less the person's in one trial, over their noise.

    Attributes:
        by: (n J, causes) effect of each cause at one standard deviation.
        by_clock: (n J,) effect of the trial's clock, likewise.
        found: (n J,) differences, n samples of J joints.
        count: number of independent samples.
    """

    by: np.ndarray
    by_clock: np.ndarray
    found: np.ndarray
    count: float

    @staticmethod
    def of(e: Evidence, lag_s: float) -> "_Difference":
        """Difference in a trial, its clock shifted by an estimated lag [s]."""
        trial, tree = e.trial, e.model.tree
        time, angles = trial.start_s + trial.times, e.recording.angles
        signal = angles.delayed(lag_s)
        time = np.clip(time, signal.time[0], signal.time[-1])
        d, v, a = signal.motion(time)
        human = e.expected(e.trial.body[0])
        q = trial.q.copy()
        q[:, trial.coordinates.device_columns] = d
        links = [tree.joints[name][1] for name in trial.coordinates.device]
        pitch = np.column_stack([tree.body_angles(q, body) for body in links])
        parts = [
            np.full((len(d), 1), _OFFSET),
            _SKIN * human,
            _BEND * human**2,
            _WEIGHT * np.sin(pitch),
            _INERTIA * a,
            _FRICTION * np.tanh(v / _REST_RAD_S),
        ]
        if e.recording.moments is not None:
            parts.append(_DRIVE * trial.device_moments)
        joints = d.shape[1]
        step = trial.duration / (len(d) - 1)
        scale = np.sqrt(step / _CORRELATED_S) / _NOISE
        return _Difference(
            scale * np.kron(np.eye(joints), np.hstack(parts)),
            scale * _CLOCK_S * v.T.ravel(),
            scale * (d - human).T.ravel(),
            joints * trial.duration / _CORRELATED_S,
        )


def _cost(*differences: _Difference) -> float:
    """Least-squares cost with priors; trials share all causes but clocks."""
    clocks = [
        np.where(np.arange(len(differences)) == k, d.by_clock[:, None], 0.0)
        for k, d in enumerate(differences)
    ]
    by = np.hstack([np.vstack([d.by for d in differences]), np.vstack(clocks)])
    found = np.concatenate([d.found for d in differences])
    # For y = A x + e with unit variances of x and e: y' (I + A A')^-1 y.
    normal = np.eye(by.shape[1]) + by.T @ by
    explained = by.T @ found
    return float(found @ found - explained @ np.linalg.solve(normal, explained))


def _alike(e: Evidence, other: Evidence) -> bool:
    """Whether two trials can be compared: of two movements, both with or both
    without recorded moments, since drives deform cuffs far more.
    """
    driven = [x.recording.moments is not None for x in (e, other)]
    return e.files.markers != other.files.markers and driven[0] == driven[1]


def disagreement(evidence: Sequence[Evidence]) -> np.ndarray:
    """How much worse one wearer explains two trials together than apart.

    Args:
        evidence: of k trials with encoders.

    Returns:
        (k, k) added cost per independent sample; NaN on the diagonal and for
        pairs that cannot be compared.
    """
    fits = [misfit(e, e) for e in evidence]
    known = {
        k: _Difference.of(e, lag)
        for k, (e, (share, lag)) in enumerate(zip(evidence, fits, strict=True))
        if np.isfinite(share)
    }
    alone = {k: _cost(d) for k, d in known.items()}
    found = np.full((len(evidence), len(evidence)), np.nan)
    for i, j in combinations(known, 2):
        if not _alike(evidence[i], evidence[j]):
            continue
        more = _cost(known[i], known[j]) - alone[i] - alone[j]
        found[i, j] = found[j, i] = more / (known[i].count + known[j].count)
    return found


def wearer_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Checks for encoders that fit the wearer in no other trial."""
    known = [e for e in evidence if e.recording.angles is not None]
    for e, row in zip(known, disagreement(known), strict=True):
        if np.isnan(row).all():
            continue
        best = int(np.nanargmin(row))
        others, files = "every other trial", "the encoders' file"
        if np.sum(~np.isnan(row)) == 1:  # of two trials either may be the one
            others = known[best].trial.name
            files += f", or that of {others},"
        yield e.check(
            "encoder_stranger",
            row[best],
            f"the device moves differently on the person than in {others}; "
            f"{files} may be of a trial that is not in the study",
        )


def fit_checks(model: Model) -> Iterator[Check]:
    """Check that joints of the user's own device are beside the person's."""
    assembly = model.assembly
    if not model.has_device or assembly.is_fitted:
        return
    tree, names = model.tree, model.coordinates
    off: dict[str, float] = {}
    for name, row in zip(names.device, names.turned_by, strict=True):
        if np.count_nonzero(row) == 1:  # else it is beside none of them
            places = map(tree.hinge_place, (name, names.follows(name)))
            off[name] = float(np.linalg.norm(np.subtract(*places)))
    if not off:
        return
    worst = max(off, key=off.get)
    yield _judged(
        "device_joint",
        off[worst],
        "standing",
        f"{assembly.device.name}: joint {worst!r} lies {off[worst]:.2f} m from "
        f"the {names.follows(worst)} that it turns with, while both stand "
        "upright with all joints at zero; the welded link's frame may not have "
        "x forward and z up, the file's zero may be another posture (say "
        "model.device.upright_deg), or model.device.weld another place",
    )


def worn_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Note if nothing of the device was measured: perhaps nobody wore it."""
    trials = [e.trial for e in evidence]
    if any(t.coordinates.device for t in trials) and not any(
        map(saw_device, trials)
    ):
        yield _judged(
            "device_worn",
            0.0,
            ", ".join(t.name for t in trials),
            "nothing of the device was measured (encoders, exo_moments or "
            "pressure); say 'model: human' if none was worn",
            level="note",
        )


def overlap_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Notes of trials with time in common: what they show counts twice."""
    for one, e in combinations(evidence, 2):
        start = max(x.trial.start_s for x in (one, e))
        end = min(x.trial.start_s + x.trial.duration for x in (one, e))
        # One may begin with the frame that ends the other.
        if one.files.markers == e.files.markers and end - start > 1e-6:
            yield e.check(
                "overlap",
                end - start,
                f"this part overlaps with {one.trial.name}, whose frames count "
                "twice; neither is unseen by a calibration with the other",
                level="note",
            )


def plausibility(
    subject: SubjectModel, standing: Standing, evidence: Sequence[Evidence]
) -> tuple[Check, ...]:
    """Make all plausibility checks of a study's recordings.

    Args:
        subject: the subject's model, fitted to standing.
        standing: settings of the standing trial, which name its files.
        evidence: of each trial.

    Returns:
        Checks named "plausibility." and a key of `LIMITS`, each with the file
        and the likely cause where it does not hold.
    """
    checks = [*standing_checks(subject, standing), *fit_checks(subject.model)]
    for e in evidence:
        checks += [*body_checks(e), *plate_checks(e), *device_checks(e)]
        checks += load_checks(e)
    checks += [*shear_checks(evidence), *force_checks(evidence)]
    checks += [*between_trials(evidence), *wearer_checks(evidence)]
    return (*checks, *overlap_checks(evidence), *worn_checks(evidence))


def refuse(checks: Iterable[Check], accepted: Iterable[str], study: str | Path):
    """Refuse recordings if a check fails that the user has not accepted.

    Args:
        checks: those of `plausibility`.
        accepted: names of checks, or their dotted beginnings.
        study: name of the study, for the message.

    Raises:
        InputError: naming the checks, their likely causes and --accept.
    """
    refused = Verdict(tuple(checks), tuple(accepted)).refused
    if not refused:
        return
    # One sentence for each name: the same mistake shows in many trials.
    first = {c.name: c for c in reversed(refused)}
    told = [f"{c.name} ({c.where}): {c.sentence}" for c in first.values()]
    names = " ".join(f"--accept {name}" for name in first)
    raise InputError(
        f"{study}: recordings are not plausible: {'; '.join(told)}; correct "
        f"them, see all with 'drake-exo check', or take them with {names} (in "
        f"Python: study.plausibility(), study.gate(accepted={list(first)}) "
        "before)"
    )
