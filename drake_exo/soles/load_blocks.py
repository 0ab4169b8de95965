"""Blocks of a case file that say where force and ZMP come from."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from drake_exo.soles import loads
from drake_exo.soles.case_fields import (
    Vector2,
    Vector3,
    exactly_one,
    not_negative,
    positive,
)


@dataclass(frozen=True)
class OneFoot:
    """The soft-sole authors' file of one foot."""

    file: str
    origin_m: Vector2
    skip_first: int = 10
    skip_last: int = 11


@dataclass(frozen=True)
class Csv:
    """A plain CSV of force and ZMP."""

    file: str
    origin_m: Vector2 = (0.0, 0.0)
    yaw_rad: float = 0.0


@dataclass(frozen=True)
class ForcePlate:
    """One foot's force plate in an OpenSim .mot file."""

    file: str
    prefix: str
    start_s: float
    end_s: float
    origin_m: Vector2
    yaw_rad: float = 0.0
    least_force_n: float = positive("N", 20.0)


@dataclass(frozen=True)
class Playback:
    """One stance of an HRP-4 playback file."""

    file: str
    foot: Literal["left", "right"]
    step: int
    mass_kg: float = positive("kg", 43.0)
    period_s: float = positive("s", 0.005)
    gravity_m_per_s2: float = positive("m/s²", 9.81)
    ankle_to_centre_m: Vector2 = (0.015, 0.011)
    least_force_n: float = positive("N", 20.0)


@dataclass(frozen=True)
class Prediction:
    """Ground reaction of a prediction of the exoskeleton half, both feet."""

    file: str
    origin_m: Vector2
    share: float = field(
        default=0.5, metadata={"above": 0.0, "maximum": 1.0}
    )  # fmt: skip
    least_force_n: float = positive("N", 20.0)


@dataclass(frozen=True)
class Constant:
    """The same force and ZMP at every sample."""

    force_n: Vector3
    zmp_m: Vector2
    samples: int = field(default=1, metadata={"minimum": 1})


@dataclass(frozen=True)
class Pattern:
    """Own walking pattern; the defaults are the authors' 80 kg robot's.

    The ZMP bounds leave 15 mm to the sole's edges.
    """

    mass_kg: float = positive("kg", 80.0)
    com_height_m: float = positive("m", 0.8085)
    step_length_m: float = positive("m", 0.2633)
    step_width_m: float = positive("m", 0.162)
    step_time_s: float = positive("s", 1.0)
    double_support_s: float = positive("s", 0.195)
    back_m: float = -0.1
    front_m: float = 0.1
    inner_m: float = 0.05
    outer_m: float = -0.05
    ankle_m: Vector2 = (-0.017, 0.011)
    torque_weight: float = not_negative("", 0.6)
    gravity_m_per_s2: float = positive("m/s²", 9.81)
    period_s: float = positive("s", 0.005)
    least_share: float = field(
        default=0.13, metadata={"above": 0.0, "below": 1.0}
    )

    def load(self) -> loads.Load:
        """Plan the step; the right foot's load."""
        from drake_exo.soles.walking_pattern import Robot, plan

        robot = Robot(
            self.mass_kg,
            self.com_height_m,
            self.step_length_m,
            self.step_width_m,
            self.step_time_s,
            self.double_support_s,
            self.back_m,
            self.front_m,
            self.inner_m,
            self.outer_m,
            self.ankle_m,
            self.torque_weight,
            self.gravity_m_per_s2,
        )
        return plan(robot).foot_load(self.period_s, self.least_share)


_KINDS = (
    "pattern", "one_foot", "csv", "force_plate", "playback", "prediction",
    "constant",
)  # fmt: skip


@dataclass(frozen=True)
class LoadBlock:
    """Where force and ZMP come from: exactly one kind."""

    pattern: Pattern | None = None
    one_foot: OneFoot | None = None
    csv: Csv | None = None
    force_plate: ForcePlate | None = None
    playback: Playback | None = None
    prediction: Prediction | None = None
    constant: Constant | None = None
    straight: bool = False

    def __post_init__(self):
        exactly_one(self, _KINDS)

    def load(self, root: Path) -> loads.Load:
        """Read the load; files are relative to `root`."""
        load = self._read(root)
        return load.straight() if self.straight else load

    def _read(self, root: Path) -> loads.Load:
        if self.pattern is not None:
            return self.pattern.load()
        if (c := self.one_foot) is not None:
            load = loads.read_one_foot(root / c.file, c.skip_first, c.skip_last)
            return load.placed(c.origin_m, 0.0)
        if (c := self.csv) is not None:
            return loads.read_csv(root / c.file).placed(c.origin_m, c.yaw_rad)
        if (c := self.force_plate) is not None:
            load = loads.read_force_plate(
                root / c.file, c.prefix, c.start_s, c.end_s, c.least_force_n
            )
            return load.placed(c.origin_m, c.yaw_rad)
        if (c := self.playback) is not None:
            return loads.read_playback(
                root / c.file,
                c.foot,
                c.step,
                c.mass_kg,
                c.period_s,
                c.gravity_m_per_s2,
                c.ankle_to_centre_m,
                c.least_force_n,
            )
        if (c := self.prediction) is not None:
            load = loads.read_prediction(
                root / c.file, c.share, c.least_force_n
            )
            return load.placed(c.origin_m, 0.0)
        c = self.constant
        return loads.constant(c.force_n, c.zmp_m, c.samples)
