"""What a study says of its instruments: exoskeleton, mats, body scan."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from drake_exo.errors import InputError

Legs = Literal["left", "right", "both"]
Segment = Literal["shank", "thigh", "pelvis"]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Axes:
    """Which axes of a file point forward and up; OpenSim's are x and y.

    Attributes:
        forward, up: an axis, with a minus where it points the other way.
    """

    forward: Axis = "x"
    up: Axis = "y"

    def __post_init__(self):
        if self.forward[-1] == self.up[-1]:
            raise InputError(
                f"forward ({self.forward}) and up ({self.up}) must be two "
                "different axes"
            )


@dataclass(frozen=True)
class JointDrive:
    """Identified dynamics of one joint of the device, both legs together.

    Attributes:
        inertia_kg_m2: of rotor and gear, reflected to the joint (links have
            theirs in `exoskeleton`).
        viscous_nm_s: friction in proportion to speed.
        coulomb_nm: dry friction.
        coulomb_speed_rad_s: speed at which tanh(1) of it acts.
        stiffness_nm_rad: of a spring across the joint.
        rest_deg: angle at which that spring is slack.
    """

    inertia_kg_m2: float = field(
        default=0.0, metadata={"unit": "kg m^2", "minimum": 0.0}
    )
    viscous_nm_s: float = field(
        default=0.0, metadata={"unit": "N m s/rad", "minimum": 0.0}
    )
    coulomb_nm: float = field(
        default=0.0, metadata={"unit": "N m", "minimum": 0.0}
    )
    coulomb_speed_rad_s: float = field(
        default=0.05, metadata={"unit": "rad/s", "above": 0.0}
    )
    stiffness_nm_rad: float = field(
        default=0.0, metadata={"unit": "N m/rad", "minimum": 0.0}
    )
    rest_deg: float = field(default=0.0, metadata={"unit": "deg"})


@dataclass(frozen=True)
class Device:
    """How the exoskeleton was measured, and its model where it was not.

    Attributes:
        encoder_legs, moment_legs: legs whose angles and moments the files
            hold; moments of one leg are doubled, angles are means.
        ankle, knee, hip: identified dynamics of the joints.
        carries_itself: share of the links' own weight and inertia that the
            drives bear, 0 for a passive device, 1 for a transparent one.
    """

    encoder_legs: Legs = "both"
    moment_legs: Legs = "both"
    ankle: JointDrive = JointDrive()
    knee: JointDrive = JointDrive()
    hip: JointDrive = JointDrive()
    carries_itself: float = field(
        default=0.0, metadata={"minimum": 0.0, "maximum": 1.0}
    )


@dataclass(frozen=True)
class Scan:
    """The body with its mat, scanned while standing.

    Attributes:
        file: surface as .stl, .ply or .obj.
        unit: of the file and of all points below.
        axes: which of its axes point forward and up.
        corners: of the mat: first row first cell, first row last cell, last
            row last cell, last row first cell.
        cells: CSV of "row, column, x, y, z" of the cells' centres, instead
            of corners.
        segment_axis: lower and upper joint centre of the segment; upright if
            left out.
    """

    file: Path
    unit: Literal["m", "cm", "mm"]
    axes: Axes = Axes("x", "z")
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
        segment: that it lies on.
        rows, columns: cells, in the order of the file (row by row).
        cell_area_m2: of one cell.
        legs: that it measured; "left" or "right" are doubled.
        scan: maps cells to the body's surface.
        plane_normal: outward normal of a flat surface instead (x forward,
            y left, z up along the segment).
    """

    segment: Segment
    rows: int = field(metadata={"minimum": 1})
    columns: int = field(metadata={"minimum": 1})
    cell_area_m2: float = field(
        metadata={"unit": "m^2", "above": 0.0, "maximum": 0.01}
    )
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
        mats: names in `mats`, in the order of the file's columns.
    """

    file: Path
    mats: tuple[str, ...]
