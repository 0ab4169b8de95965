"""Settings of a study file: subject, recordings and their instruments.

That a signal is of one leg follows from what the study leaves out: a trial with
a plate under the right foot alone is one leg's, and its force is doubled.
Paths stay as written in the file, so that results do not depend on the machine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from drake_exo.errors import InputError, check_file_name, nearest
from drake_exo.files.schema import quantity
from drake_exo.files.tables import PlateRecording
from drake_exo.measurement.events import event_of
from drake_exo.measurement.filters import low_pass
from drake_exo.measurement.sagittal import Axes, spatial_wrench
from drake_exo.model.assembly import (
    ASSEMBLIES,
    SIDES,
    Assembly,
    without_side,
)
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.segments import (
    CUFFED,
    HEIGHTS_M,
    LEG_JOINTS,
    MASSES_KG,
    ExoskeletonOverrides,
    HumanOverrides,
    place,
)

Side = Literal["left", "right"]
Use = Literal["calibration", "prediction"]
Legs = Literal["left", "right", "both"]
Point = tuple[float, float, float]
Files = Path | tuple[Path, ...]
# Names of files that `check` and a batch write beside the trials' files.
_TAKEN = ("quality", "summary", "task", "timing")


@dataclass(frozen=True)
class JointDrive:
    """Identified dynamics of one joint of the device, both legs together.

    >>> JointDrive(coulomb_nm=2.0, viscous_nm_s=0.3).stiffness_nm_rad
    0.0

    Attributes:
        inertia_kg_m2: of rotor and gear, reflected to the joint (links have
            theirs in `exoskeleton`).
        viscous_nm_s: friction in proportion to speed.
        coulomb_nm: dry friction.
        coulomb_speed_rad_s: speed at which dry friction reaches tanh(1) of
            its full value; it is smoothed as tanh(speed / this).
        stiffness_nm_rad: stiffness of a spring across the joint.
        rest_deg: angle at which that spring is slack.
    """

    inertia_kg_m2: float = quantity("kg m^2", 0.0, minimum=0.0)
    viscous_nm_s: float = quantity("N m s/rad", 0.0, minimum=0.0)
    coulomb_nm: float = quantity("N m", 0.0, minimum=0.0)
    # Dry friction is full long before a joint turns at 1 rad/s; more was
    # given in deg/s.
    coulomb_speed_rad_s: float = quantity("rad/s", 0.05, above=0.0, maximum=1.0)
    stiffness_nm_rad: float = quantity("N m/rad", 0.0, minimum=0.0)
    rest_deg: float = quantity("deg", 0.0)


@dataclass(frozen=True)
class Device:
    """How the exoskeleton was measured, and its model where it was not.

    >>> device = Device(knee=JointDrive(coulomb_nm=2.0), carries_itself=1.0)
    >>> device.of("exo_knee", beside="knee").coulomb_nm
    2.0

    Attributes:
        encoder_legs: legs whose angles the files hold; those of both are
            averaged, those of one leg stand for both.
        moment_legs: legs whose moments the files hold; those of one leg are
            doubled.
        ankle, knee, hip: identified dynamics of the device's joint beside
            this joint of the person. In a model of two legs the joint of each
            leg has these values, not half of them.
        joints: the same, by the name of the device's own joint.
        carries_itself: share of the links' own weight and inertia that the
            drives bear: 0 for a passive device, 1 for a transparent one.
    """

    encoder_legs: Legs = "both"
    moment_legs: Legs = "both"
    ankle: JointDrive = JointDrive()
    knee: JointDrive = JointDrive()
    hip: JointDrive = JointDrive()
    joints: dict[str, JointDrive] = field(default_factory=dict)
    carries_itself: float = quantity(None, 0.0, minimum=0.0, maximum=1.0)

    def check(self, names: Coordinates) -> None:
        """Refuse values for joints that the device does not have.

        Raises:
            InputError: an unknown joint of the device, or a joint of the
                person beside which the device has none.
        """
        if not names.device:
            return
        beside = {(names.follows(n) or "").split("_")[0] for n in names.device}
        usual = [k for k in LEG_JOINTS if getattr(self, k) != JointDrive()]
        for key, own, known in (
            ("device.joints", self.joints, names.device),
            ("device", usual, sorted(beside - {""})),
        ):
            for name in own:
                if name not in known:
                    raise InputError(
                        f"{key}.{name}: the device has no such joint; it has "
                        f"{', '.join(known)}{nearest(name, known)}"
                    )
        for key in usual:
            ours = [
                n
                for n in names.device
                if (names.follows(n) or "").split("_")[0] == key
            ]
            if set(ours) <= set(self.joints):
                raise InputError(
                    f"device.{key} is used for no joint, since device.joints "
                    f"has values of {', '.join(ours)}; keep one of them"
                )

    def of(self, joint: str, beside: str | None) -> JointDrive:
        """Dynamics of a device's joint, beside this joint of the person."""
        usual = getattr(self, (beside or "").split("_")[0], JointDrive())
        return self.joints.get(joint, usual)


@dataclass(frozen=True)
class Scan:
    """The body with its mat, scanned while standing.

    Attributes:
        file: surface as .stl, .ply or .obj.
        unit: unit of the file and of all points below.
        axes: which axes of the file point forward and up.
        corners: corners of the mat: first row first cell, first row last
            cell, last row last cell, last row first cell.
        cells: CSV of "row, column, x, y, z" of the cells' centres, instead
            of corners.
        segment_axis: lower and upper joint centre of the segment; if left
            out, the segment is taken as upright.
    """

    file: Path
    unit: Literal["m", "cm", "mm"]
    axes: Axes = field(default=Axes("x", "z"))
    corners: tuple[Point, Point, Point, Point] | None = None
    cells: Path | None = None
    segment_axis: tuple[Point, Point] | None = None

    def __post_init__(self):
        if (self.corners is None) == (self.cells is None):
            raise InputError("place the mat by either corners or cells")


@dataclass(frozen=True)
class Mat:
    """A pressure matrix.

    Attributes:
        segment: name of the cuff under which it lies.
        rows, columns: number of cells; the file holds them row by row.
        cell_area_m2: area of one cell.
        legs: legs that it measured. The force of "left" or "right" is doubled
            if no mat of the trial lies on the same segment of the other leg.
            In a model of two legs each cuff belongs to one leg, and nothing
            is doubled.
        scan: scanned surface of the body on which the cells lie.
        plane_normal: instead of a scan, outward normal of a flat surface
            (x forward, y left, z up along the segment).
    """

    segment: str
    rows: int = quantity(None, minimum=1)
    columns: int = quantity(None, minimum=1)
    cell_area_m2: float = quantity("m^2", above=0.0, maximum=0.01)
    legs: Legs = "both"
    scan: Scan | None = None
    plane_normal: Point | None = None

    def __post_init__(self):
        if (self.scan is None) == (self.plane_normal is None):
            raise InputError("give either scan or plane_normal")
        if self.plane_normal is not None and not any(self.plane_normal):
            raise InputError("plane_normal must not be zero")


@dataclass(frozen=True)
class PressureFile:
    """A pressure recording of a trial.

    Attributes:
        file: Novel's .asc, or .csv.
        mats: names of the mats (keys of `mats`), in the order of the file's
            columns.
    """

    file: Path
    mats: tuple[str, ...]

    def __post_init__(self):
        _once(self.mats, "pressure.mats names {} more than once, and its force")


def _once(names: Sequence, told: str) -> None:
    """Refuse repeated names; `told.format(name)` begins the message."""
    if isinstance(names, str):
        raise InputError(f"{names!r} is one name; give a list of them")
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{told.format(name)} would count as often; name it once"
            )


@dataclass(frozen=True)
class Subject:
    """Who was measured.

    Attributes:
        height_m: stature.
        sex: which of de Leva's tables is used.
        mass_kg: body mass without the exoskeleton. If left out, it is that of
            the OpenSim model, or is taken from the forces of quiet standing.
        segments: values that replace those scaled from mass and height, as
            sums over both legs.
    """

    name: str
    height_m: float = quantity("m", minimum=HEIGHTS_M[0], maximum=HEIGHTS_M[1])
    mass_kg: float | None = quantity(
        "kg", None, minimum=MASSES_KG[0], maximum=MASSES_KG[1]
    )
    sex: Literal["male", "female"] = "male"
    segments: HumanOverrides = field(default_factory=HumanOverrides)


@dataclass(frozen=True)
class Laboratory:
    """Frames and clocks of the laboratory's files.

    Attributes:
        force_delay_s: lag of the plates' clock behind the markers'.
        marker_axes: axes of the marker files.
        force_axes: axes of the force files.
        estimate_force_delay: whether to find the remaining lag of the plates
            from Newton's law; the trial's provenance reports it.
        forces_act_on: whether files hold the forces on the body, or on the
            plate (equal and opposite).
        fill_gaps_s: longest gap of a marker that is filled; none by default.
        encoder_delay_s: lag of the encoders' clock behind the markers';
            `exo_moments` are on the same clock.
        pressure_delay_s: lag of the mats' clock behind the markers'.
        estimate_encoder_delay, estimate_pressure_delay: whether calibration
            and prediction find the remaining lag; if false, the lag is as
            given.
        largest_delay_s: largest lag, either way, that the estimate for the
            plates considers.
        remove_plate_drift: whether to remove a plate's offset and drift, as
            seen where nothing stands on it.
        hold_cop_below_n: while the vertical force of a foot is smaller, its
            centre of pressure is held where it was, or will be, at larger
            forces. For files whose points were filtered, because these drift
            towards the origin there.
        chair_on_thighs: share of the chair's wrench that acts on the thighs;
            the rest acts on the pelvis.
    """

    marker_axes: Axes = field(default_factory=Axes)
    force_axes: Axes = field(default_factory=Axes)
    force_delay_s: float = quantity("s", 0.0)
    estimate_force_delay: bool = False
    forces_act_on: Literal["body", "plate"] = "body"
    # Of a marker that is hidden for 10 s nothing is known; 200 was in ms.
    fill_gaps_s: float = quantity("s", 0.0, minimum=0.0, maximum=10.0)
    encoder_delay_s: float = quantity("s", 0.0)
    estimate_encoder_delay: bool = True
    pressure_delay_s: float = quantity("s", 0.0)
    estimate_pressure_delay: bool = True
    largest_delay_s: float = quantity("s", 0.05, above=0.0, maximum=1.0)
    remove_plate_drift: bool = False
    hold_cop_below_n: float = quantity("N", 0.0, minimum=0.0)
    chair_on_thighs: float = quantity(None, 0.0, minimum=0.0, maximum=1.0)

    def facing(self, axes: Axes | None) -> "Laboratory":
        """For a recording with `axes` of its markers; None if with these.

        A subject who faces another way does so on the plates, too.
        """
        if axes is None:
            return self
        turn = axes.R_PL @ self.marker_axes.R_PL.T
        turned = Axes.of(turn @ self.force_axes.R_PL)
        return replace(self, marker_axes=axes, force_axes=turned)

    def on_body(self, plate: PlateRecording) -> np.ndarray:
        """Wrench (N, 6) of a plate on the body, as `spatial_wrench`."""
        sign = -1.0 if self.forces_act_on == "plate" else 1.0
        return sign * spatial_wrench(plate, self.force_axes)


@dataclass(frozen=True)
class Ground:
    """What is walked on.

    Attributes:
        belt_speed_m_s: speed at which a treadmill carries standing feet
            backwards in all trials; markers and forces are converted as if
            the ground were at rest. In the standing trial the belt rests.

    >>> Ground(1.24).belt_speed_m_s
    1.24
    """

    # Nobody runs at 15 m/s.
    belt_speed_m_s: float = quantity("m/s", 0.0, minimum=-15.0, maximum=15.0)


@dataclass(frozen=True)
class SidedMarkers:
    """Names of markers on the left, on the right, and on the midline."""

    left: tuple[str, ...] = ()
    right: tuple[str, ...] = ()
    middle: tuple[str, ...] = ()

    def __post_init__(self):
        for side in (*SIDES, "middle"):
            told = side + " names the marker {!r} more than once, and it"
            _once(getattr(self, side), told)

    def of(self, side: Side) -> tuple[str, ...]:
        """The names on one side."""
        return self.left if side == "left" else self.right


@dataclass(frozen=True)
class JointCentres:
    """Markers whose mean is a joint's centre in the standing trial."""

    ankle: SidedMarkers
    knee: SidedMarkers
    hip: SidedMarkers

    def __post_init__(self):
        _no_middle(self, ("ankle", "knee", "hip"))


@dataclass(frozen=True)
class SegmentMarkers:
    """Markers fixed to each segment, which inverse kinematics follows.

    Attributes:
        toes: needed if the model's toes are hinged; one marker is enough.
    """

    foot: SidedMarkers
    shank: SidedMarkers
    thigh: SidedMarkers
    pelvis: SidedMarkers
    toes: SidedMarkers = SidedMarkers()

    def __post_init__(self):
        _no_middle(self, ("foot", "shank", "thigh", "toes"))


def _no_middle(parts: object, names: Sequence[str]) -> None:
    """Refuse markers on the midline of what has two sides."""
    for name in names:
        if getattr(parts, name).middle:
            raise InputError(
                f"{name} has markers in the middle, which nothing follows; "
                "only the pelvis may; name them left or right"
            )


@dataclass(frozen=True)
class Markers:
    """The marker set.

    Attributes:
        weights: weight of single markers in inverse kinematics. By default
            100 on a foot that a device is welded to, and 1 elsewhere.
    """

    joint_centres: JointCentres
    segments: SegmentMarkers
    weights: dict[str, float] = field(
        default_factory=dict, metadata={"minimum": 0.0}
    )


@dataclass(frozen=True)
class Plates:
    """Numbers of the force plates, from 1: under each foot, or under both.

    Attributes:
        left, right: plate under that foot, or several plates that it steps on
            in turn. If only one foot has a plate, its force is doubled.
        both: plate under both feet.
        chair: plate under the chair; the force on it with nobody seated is
            subtracted.
    """

    left: int | tuple[int, ...] | None = quantity(None, None, minimum=1)
    right: int | tuple[int, ...] | None = quantity(None, None, minimum=1)
    both: int | None = quantity(None, None, minimum=1)
    chair: int | None = quantity(None, None, minimum=1)

    def __post_init__(self):
        if (self.both is None) == (self.left is None and self.right is None):
            raise InputError(
                "name the plates of the feet as left and right, or as both"
            )
        for side in SIDES:
            if getattr(self, side) == ():
                raise InputError(
                    f"{side} names no plate; name one, or leave {side} out"
                )
            told = side + " names plate {} more than once, and its force"
            _once(self.of(side), told)
        twice = set(self.of("left")) & set(self.of("right"))
        if twice:
            plate = min(twice)
            raise InputError(
                f"plate {plate} cannot be left and right; say "
                f"'both: {plate}' if both feet stand on it"
            )
        feet = (*self.of("left"), *self.of("right"), self.both)
        if self.chair is not None and self.chair in feet:
            raise InputError(
                f"plate {self.chair} cannot be under the chair and a foot"
            )

    def of(self, foot: str) -> tuple[int, ...]:
        """Numbers of the plates of "left", "right", "both" or "chair"."""
        number = getattr(self, foot)
        if number is None:
            return ()
        return number if isinstance(number, tuple) else (number,)


@dataclass(frozen=True)
class Standing:
    """Quiet, upright standing; it scales the model and gives the body mass.

    Attributes:
        markers: marker file, or coordinates as in a trial; the standing
            posture is its mean.
        forces: force file of the same trial, if plates were recorded; or a
            list of files, as in a trial.
        empty_plates: recording of the same plates with nothing on them.
        start_s: start of the quiet part; that of the file by default.
        end_s: end of the quiet part; that of the file by default.
        marker_axes: axes of this marker file, if the subject faced another
            way than in the trials; the plates' axes turn along.
    """

    markers: Path
    forces: Files | None = None
    plates: Plates | None = None
    empty_plates: Files | None = None
    start_s: float | None = quantity("s", None)
    end_s: float | None = quantity("s", None)
    marker_axes: Axes | None = None

    def __post_init__(self):
        _check_window(self.start_s, self.end_s)
        if (self.forces is None) != (self.plates is None):
            raise InputError("forces and plates must be given together")
        _check_files(self)


def several(files: Files | None, root: Path = Path()) -> tuple[Path, ...]:
    """Paths from a root of one file or of several; empty if there is none."""
    if files is None:
        return ()
    paths = files if isinstance(files, tuple) else (files,)
    return tuple(root / file for file in paths)


def listed(files: Files | Sequence[Path]) -> str:
    """Names of one file or of several, for messages."""
    return ", ".join(map(str, [files] if isinstance(files, Path) else files))


def _check_files(of: "Standing | TrialFiles") -> None:
    """Refuse lists of plates' files that are empty, or name a file twice."""
    for key in ("forces", "empty_plates"):
        if getattr(of, key) == ():
            raise InputError(f"{key} names no file; name one")
        told = key + " names {} more than once, and its plate"
        _once([p.as_posix() for p in several(getattr(of, key))], told)


@dataclass(frozen=True)
class Filter:
    """Zero-lag Butterworth low-pass filter.

    >>> Filter(cutoff_hz=10.0)
    Filter(cutoff_hz=10.0, order=4)

    Attributes:
        cutoff_hz: frequency that is damped to 1/sqrt(2) after both passes.
        order: order in effect, after both passes; each pass has half of it.
    """

    cutoff_hz: float = quantity("Hz", 6.0, above=0)
    order: int = quantity(None, 4, minimum=2, maximum=12)

    def __post_init__(self):
        if self.order % 2:
            raise InputError(
                f"order is {self.order}, but two passes make it even"
            )

    @property
    def reach_s(self) -> float:
        """Time over which a sample influences filtered values [s]."""
        return 1.0 / self.cutoff_hz

    def smooth(
        self, values: np.ndarray, rate_hz: float, source: str
    ) -> np.ndarray:
        """Filtered signals (N, ...); raises as `filters.low_pass`."""
        return low_pass(values, rate_hz, self.cutoff_hz, self.order, source)


@dataclass(frozen=True)
class Scaling:
    """How the subject's model is fitted to the standing trial.

    Attributes:
        lengths: where the lengths of shank and thigh come from: "markers"
            (between joint centres) or "table" (from height). Centres of mass
            and radii of gyration follow in proportion. An OpenSim model keeps
            its own.
        trunk_com: fore-aft place of the centre of mass of pelvis, trunk,
            head and arms: "table" (straight above the hip), or "standing"
            (so that the body's centre of mass stands above the centre of
            pressure).
    """

    lengths: Literal["markers", "table"] = "markers"
    trunk_com: Literal["table", "standing"] = "table"


@dataclass(frozen=True)
class Load:
    """What the person carries, or what pulls and pushes.

    A mass that is carried, where markers on it (or a place on the segment)
    have it; or the force that a file holds.

    Attributes:
        body: segment that bears the load; a box in the hands is borne by
            `pelvis`, which includes trunk and arms.
        mass_kg: mass of what is carried.
        markers: markers on it; their mean is its centre.
        at_m: place (x, z) of the mass in the segment, instead of markers.
        from_s: when it starts to be lifted off; if left out, it is carried
            from the start.
        to_s: when it starts to be put down; if left out, it is carried to the
            end.
        over_s: how long it takes to lift it off and to put it down.
        forces: file with the force on the body, instead of a mass.
        plate: number of that force in the file.
    """

    body: str
    mass_kg: float | None = quantity("kg", None, above=0.0, maximum=500.0)
    markers: tuple[str, ...] = ()
    at_m: tuple[float, float] | None = place(None)
    from_s: float | None = quantity("s", None)
    to_s: float | None = quantity("s", None)
    over_s: float = quantity("s", 0.2, above=0.0, maximum=10.0)
    forces: Path | None = None
    plate: int = quantity(None, 1, minimum=1)

    def __post_init__(self):
        if (self.mass_kg is None) == (self.forces is None):
            raise InputError("a load is either a mass_kg or a file of forces")
        if self.mass_kg is not None and bool(self.markers) == (
            self.at_m is not None
        ):
            raise InputError(
                "where a mass is say either markers on it or at_m in the "
                "segment"
            )
        if self.forces is None and self.plate != 1:
            raise InputError(
                "plate is the number of a force in a load's file, but this one "
                "is a mass; leave plate out, or give forces"
            )
        placed = self.markers or self.at_m is not None
        timed = self.from_s is not None or self.to_s is not None
        if self.forces is not None and (placed or timed):
            raise InputError(
                "a load's file of forces says where and when they act; leave "
                "markers, at_m, from_s and to_s out"
            )
        start, _ = self.carried_s
        if self.to_s is not None and self.to_s <= start:
            raise InputError(
                f"to_s ({self.to_s:g}) must be after from_s ({start:g})"
            )

    @property
    def carried_s(self) -> tuple[float, float]:
        """Start of lifting off and end of putting down [s]; else infinite."""
        start = -np.inf if self.from_s is None else self.from_s
        end = np.inf if self.to_s is None else self.to_s + self.over_s
        return start, end


@dataclass(frozen=True)
class TrialFiles:
    """One movement: its files, and the part of them that is used.

    Attributes:
        name: name of the trial in results.
        markers: marker file, or coordinates (.mot, .sto) of
            `model.human.osim`, as inverse kinematics finds them.
        forces: force file; or a list of files of one plate each, whose
            numbers are then their places in the list.
        plates: which plate is under which foot.
        use: what the trial is for: to calibrate contact (Phases A and B), or
            to be predicted and compared with the measurement (Phase C).
        encoders: file with the angles of the exoskeleton's joints.
        exo_moments: file with the recorded moments of these joints, drive,
            friction and springs together; if left out, the moments follow
            from `device`.
        pressure: recordings of the mats.
        encoder_delay_s: lag of the encoders' clock in this trial, instead of
            the laboratory's.
        pressure_delay_s: lag of the mats' clock in this trial, instead of the
            laboratory's.
        empty_plates: recording of the same plates with nothing on them; it
            levels plates that are never unloaded in the trial.
        rise: which sit-to-stand rise found in the recording is used, from 1.
        sit: which stand-to-sit movement found in the recording is used, from
            1.
        seated_s: how long before seat-off a rise's used part starts, or after
            the first touch of the chair a sit's ends; needs the chair's plate.
        start_s: start of the used part, instead of a rise or sit that is
            found, or to overrule its start.
        end_s: end of the used part, instead of a rise or sit that is found,
            or to overrule its end.
        begin: start of the used part by an event of a walk, such as
            `toe_off left 1`: heel_strike or toe_off, the foot, and the event's
            number in the recording, from 1.
        end: end of the used part, likewise by an event of a walk.
        marker_axes: axes of this marker file, if the subject faced another
            way than in other trials; the plates' axes turn along.
        loads: what is carried, or pulls and pushes.
    """

    name: str
    markers: Path
    forces: Files
    plates: Plates
    use: Use = "calibration"
    encoders: Path | None = None
    exo_moments: Path | None = None
    pressure: tuple[PressureFile, ...] = ()
    encoder_delay_s: float | None = quantity("s", None)
    pressure_delay_s: float | None = quantity("s", None)
    empty_plates: Files | None = None
    rise: int | None = quantity(None, None, minimum=1)
    sit: int | None = quantity(None, None, minimum=1)
    seated_s: float = quantity("s", 0.0, minimum=0.0)
    start_s: float | None = quantity("s", None)
    end_s: float | None = quantity("s", None)
    begin: str | None = field(default=None, metadata={"key": "from"})
    end: str | None = field(default=None, metadata={"key": "to"})
    marker_axes: Axes | None = None
    loads: tuple[Load, ...] = ()

    def __post_init__(self):
        _check_window(self.start_s, self.end_s)
        _check_files(self)
        for key, event, time, seconds in (
            ("from", self.begin, "start_s", self.start_s),
            ("to", self.end, "end_s", self.end_s),
        ):
            if event is None:
                continue
            try:
                event_of(event)
            except InputError as error:
                raise InputError(f"{key}: {error}") from error
            if seconds is not None:
                raise InputError(
                    f"{key} and {time} both say where the used part "
                    f"{'starts' if key == 'from' else 'ends'}; leave one out"
                )
        for what, key, given in (
            ("rise", "start_s", self.start_s),
            ("rise", "from", self.begin),
            ("sit", "end_s", self.end_s),
            ("sit", "to", self.end),
        ):
            seated = self.seated_s > 0.0 and getattr(self, what) is not None
            if seated and given is not None:
                raise InputError(
                    f"seated_s and {key} both say where the {what} "
                    f"{'starts' if what == 'rise' else 'ends'}; leave one out"
                )
        mats = [name for file in self.pressure for name in file.mats]
        _once(mats, "pressure names {} in two files, and its force")
        if self.rise is not None and self.sit is not None:
            raise InputError(
                "rise and sit both say which part is used; leave one out"
            )
        if self.seated_s > 0.0 and self.rise is None and self.sit is None:
            raise InputError(
                "seated_s counts back from a rise, or on from a sit; name one"
            )
        if self.seated_s > 0.0 and self.plates.chair is None:
            raise InputError(
                "seated_s needs the chair's plate; name it in plates.chair"
            )


@dataclass(frozen=True)
class RecordingSettings:
    """A study's subject, recordings and model, without what is computed.

    Attributes:
        markers: which markers are on which segment. If `model.human.osim` is
            given, this may be left out, and the OpenSim model's own markers
            are used.
        model: `coupled` is the person with the shipped exoskeleton, `human`
            the person alone; or a description of person, device, cuffs and
            ground.
        gravity_m_s2: acceleration of gravity.
        device: how the exoskeleton was measured and what its joints do. If
            left out, joint moments are known only where they were recorded.
        mats: pressure matrices by name.
    """

    subject: Subject
    standing: Standing
    trials: tuple[TrialFiles, ...]
    markers: Markers | None = None
    model: Literal["coupled", "human"] | Assembly = "coupled"
    exoskeleton: ExoskeletonOverrides = field(
        default_factory=ExoskeletonOverrides
    )
    device: Device | None = None
    mats: dict[str, Mat] = field(default_factory=dict)
    gravity_m_s2: float = quantity("m/s^2", 9.81, above=0.0, maximum=30.0)
    ground: Ground = Ground()
    laboratory: Laboratory = Laboratory()
    filter: Filter = Filter()
    scaling: Scaling = Scaling()

    def __post_init__(self):
        names = [trial.name for trial in self.trials]
        for i, name in enumerate(names):
            check_file_name(f"trials[{i}].name", name)
            if name.lower() in _TAKEN:
                raise InputError(
                    f"trials[{i}].name is {name!r}, a name that a command "
                    "gives a file of its own; rename the trial"
                )
            if names.count(name) > 1:
                raise InputError(f"trials: two are named {name!r}; rename one")
        if not names:
            raise InputError("trials is empty; list at least one")
        if self.markers is None and self.assembly.human.osim is None:
            raise InputError(
                "markers is missing; list them, or give model.human.osim"
            )
        for trial in self.trials:
            for name in (m for p in trial.pressure for m in p.mats):
                if name not in self.mats:
                    raise InputError(
                        f"trial {trial.name}: {name!r} is none of the mats "
                        f"({', '.join(self.mats) or 'there are none'})"
                    )
        if self.assembly.human.sides and self.laboratory.chair_on_thighs:
            raise InputError(
                "laboratory.chair_on_thighs is for legs that move alike; with "
                "two legs the chair's plate does not tell which thigh bears "
                "what: leave it out"
            )
        worn, fitted = self.assembly.device, ExoskeletonOverrides()
        if worn and worn.file and self.exoskeleton != fitted:
            raise InputError(
                "exoskeleton has values of the shipped device, but the model's "
                f"device is {worn.name}; state them in that file, and leave "
                "exoskeleton out"
            )
        usual = {
            without_side(links.human)
            for links in self.assembly.cuffs.values()
            if links.at_m is None
        }
        for segment in CUFFED:
            key = f"{segment}_cuff_m"
            given = getattr(self.subject.segments, key) is not None
            if worn and worn.file and given and segment not in usual:
                raise InputError(
                    f"subject.segments.{key} is used for no cuff: of those in "
                    f"model.cuffs none is on the {segment}, or each has its "
                    "own at_m; leave it out"
                )
        for key in ("heel_m", "toe_m"):
            if self.assembly.is_fitted and getattr(self.subject.segments, key):
                raise InputError(
                    f"subject.segments.{key} places a sphere on the foot, but "
                    "here the exoskeleton's foot-plate touches the ground; "
                    f"give exoskeleton.{key}"
                )
        segments = self.assembly.human.segments
        for trial in self.trials:
            for load in trial.loads:
                if load.body not in segments:
                    raise InputError(
                        f"trial {trial.name}: loads: the person has no segment "
                        f"{load.body!r}; it has {', '.join(segments)}"
                    )
        device = self.device or Device()
        for key in ("encoder_legs", "moment_legs"):
            legs = getattr(device, key)
            if self.assembly.human.sides and legs != "both":
                raise InputError(
                    f"device.{key} is {legs!r}, which takes one leg for both; "
                    "in a model with two legs each joint belongs to one leg: "
                    "leave it out"
                )
        cuffs = self.assembly.closed
        for name, mat in self.mats.items():
            if self.assembly.device and mat.segment not in cuffs:
                raise InputError(
                    f"mats.{name}: segment {mat.segment!r} has no cuff; there "
                    f"are {', '.join(cuffs) or 'none'}"
                )
            if self.assembly.human.sides and mat.legs != "both":
                raise InputError(
                    f"mats.{name}: legs is {mat.legs!r}, which doubles the "
                    "force; in a model with two legs each cuff belongs to one "
                    "leg: leave it out"
                )

    @property
    def assembly(self) -> Assembly:
        """Description of the model: person, device, cuffs and ground."""
        if isinstance(self.model, Assembly):
            return self.model
        return ASSEMBLIES[self.model]


def _check_window(start_s: float | None, end_s: float | None) -> None:
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise InputError(
            f"end_s ({end_s:g}) must be after start_s ({start_s:g})"
        )
