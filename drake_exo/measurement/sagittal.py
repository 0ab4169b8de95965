"""Sagittal plane: a laboratory's axes, planar wrenches, merging of plates.

Planar frame: x forward, z up, y left. A wrench in the plane is F_x, F_z and
the moment M_y = z F_x - x F_z about the laboratory's origin at z = 0; the
centre of pressure is CoP_x = -M_y / F_z.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.schema import quantity
from drake_exo.files.tables import COP_THRESHOLD_N, PlateRecording

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(frozen=True)
class Axes:
    """Which axes of a file point forward and up; OpenSim's are x and y.

    Attributes:
        forward, up: name of the axis, with a minus if it points the other way.
        facing_deg: angle from that axis to where the subject faces, to the
            left seen from above.
    """

    forward: Axis = "x"
    up: Axis = "y"
    facing_deg: float = quantity("deg", 0.0, minimum=-360.0, maximum=360.0)

    def __post_init__(self):
        if self.forward[-1] == self.up[-1]:
            raise InputError(
                f"forward ({self.forward}) and up ({self.up}) must be two "
                "different axes"
            )

    @staticmethod
    def of(R_PL: np.ndarray) -> "Axes":
        """Axes whose `R_PL` is this rotation (3, 3); an axis points up."""
        forward, up = (
            ("-" if row[i] < 0.0 else "") + "xyz"[i]
            for row in R_PL[[0, 2]]
            for i in [np.argmax(np.abs(row))]
        )
        x, y, _ = Axes(forward, up).R_PL @ R_PL[0]
        return Axes(forward, up, float(np.rad2deg(np.arctan2(y, x))))

    @property
    def R_PL(self) -> np.ndarray:
        """Rotation (3, 3) from the file's axes to forward, left, up."""
        x, z = _unit(self.forward), _unit(self.up)
        y, facing = np.cross(z, x), np.deg2rad(self.facing_deg)
        x = np.cos(facing) * x + np.sin(facing) * y
        return np.stack([x, np.cross(z, x), z])

    def points(self, p: np.ndarray) -> np.ndarray:
        """Forward and up components (..., 2) of points or forces (..., 3)."""
        return np.asarray(p) @ self.R_PL[[0, 2]].T

    def space(self, p: np.ndarray) -> np.ndarray:
        """Points, forces or moments (..., 3) as forward, left, up (..., 3)."""
        return np.asarray(p) @ self.R_PL.T


def _unit(axis: str) -> np.ndarray:
    e = np.zeros(3)
    e["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return e


def fixed(given) -> np.ndarray:
    """A read-only copy of an array, as floats.

    >>> fixed([1, 2]).flags.writeable
    False
    """
    array = np.array(given, dtype=float)
    array.flags.writeable = False
    return array


def centre_of_pressure(along, up, moment, height: float = 0.0) -> np.ndarray:
    """Centre of pressure: where a force's line of action passes a height [m].

    Args:
        along, up: force along a horizontal axis and upwards [N].
        moment: z times `along` minus place times `up` [N m].
        height: of the plane above the origin [m].
    """
    return (height * along - moment) / up


@dataclass(frozen=True, eq=False)
class PlanarWrench:
    """Force in the sagittal plane and its moment about the origin.

    Attributes:
        force: (N, 2) F_x, F_z [N].
        moment: (N,) M_y about the laboratory's origin at z = 0 [N m].

    The arrays are read-only; change a copy.

    >>> standing = PlanarWrench(np.array([[0.0, 700.0]]), np.array([-70.0]))
    >>> standing.cop_x.tolist()
    [0.1]
    """

    force: np.ndarray
    moment: np.ndarray

    def __post_init__(self):
        for name, given in vars(self).copy().items():
            object.__setattr__(self, name, fixed(given))
        if self.force.shape != (*self.moment.shape, 2):
            raise ValueError(
                f"force has the shape {self.force.shape}, moment "
                f"{self.moment.shape}; give (N, 2) and (N,)"
            )

    def __repr__(self) -> str:
        largest = np.abs(self.force).max(axis=0, initial=0.0)
        return (
            f"PlanarWrench({len(self.force)} samples, up to "
            f"{largest[0]:.1f} N fore and aft, {largest[1]:.1f} N vertically)"
        )

    @staticmethod
    def of(array: np.ndarray) -> "PlanarWrench":
        """From F_x, F_z, M_y (N, 3)."""
        force_x, force_z, moment = np.asarray(array).T
        return PlanarWrench(np.column_stack([force_x, force_z]), moment)

    @staticmethod
    def of_spatial(wrench: np.ndarray) -> "PlanarWrench":
        """Sagittal part of force and moment, forward, left, up (N, 6)."""
        return PlanarWrench(wrench[:, [0, 2]], wrench[:, 4])

    @property
    def array(self) -> np.ndarray:
        """F_x, F_z, M_y (N, 3)."""
        return np.column_stack([self.force, self.moment])

    @property
    def force_x(self) -> np.ndarray:
        """Forward force (N,) [N]."""
        return self.force[:, 0]

    @property
    def force_z(self) -> np.ndarray:
        """Upward force (N,) [N]."""
        return self.force[:, 1]

    @property
    def is_loaded(self) -> np.ndarray:
        """Samples (N,) bool above 20 N, where the CoP is defined."""
        return self.force_z > COP_THRESHOLD_N

    @property
    def cop_x(self) -> np.ndarray:
        """Centre of pressure -M_y/F_z (N,) [m]; NaN below 20 N."""
        return self.cop_at(0.0)

    def cop_at(self, height: float) -> np.ndarray:
        """Centre of pressure (N,) [m] at a height [m]; NaN below 20 N."""
        load = np.where(self.is_loaded, self.force_z, np.nan)
        return centre_of_pressure(self.force_x, load, self.moment, height)

    def __add__(self, other: "PlanarWrench") -> "PlanarWrench":
        return PlanarWrench(
            self.force + other.force, self.moment + other.moment
        )

    def shifted(self, dx: float | np.ndarray) -> "PlanarWrench":
        """The same wrench acting `dx` further forward [m], float or (N,)."""
        return PlanarWrench(self.force, self.moment - dx * self.force_z)

    def held(self, below_n: float) -> "PlanarWrench":
        """The same forces with the centre of pressure held at small forces.

        Args:
            below_n: at vertical forces below this [N] the CoP is that of the
                nearest sample above it; 0 leaves all as they are.
        """
        known = np.flatnonzero(self.force_z >= below_n)
        if below_n == 0.0 or not len(known):
            return self
        index = np.arange(len(self.moment))
        after = np.searchsorted(known, index).clip(0, len(known) - 1)
        before = (after - 1).clip(0)
        sooner = index - known[before] < known[after] - index
        nearest = known[np.where(sooner, before, after)]
        at = centre_of_pressure(
            0.0, self.force_z[nearest], self.moment[nearest]
        )
        held = np.where(
            self.force_z >= below_n, self.moment, -at * self.force_z
        )
        return PlanarWrench(self.force, held)

    def scaled(self, factor: float | np.ndarray) -> "PlanarWrench":
        """Force and moment times a factor, float or (N,)."""
        force = np.asarray(factor)[..., None] * self.force
        return PlanarWrench(force, factor * self.moment)

    def cut(self, rows) -> "PlanarWrench":
        """The wrench at some samples: a slice, mask or indices."""
        return PlanarWrench(self.force[rows], self.moment[rows])


def external_loads(
    wrenches: Mapping[str, PlanarWrench], share: float = 1.0
) -> tuple[list[str], np.ndarray]:
    """Columns of OpenSim's external loads, in its axes (x forward, y up).

    Forces act at the centre of pressure on the ground; where that is undefined
    (below 20 N), at the origin, with the moment as free moment.

    Args:
        wrenches: suffix of the column names, such as "_r" -> wrench (N,).
        share: factor on force and moment, such as 0.5 for one of two legs.

    Returns:
        Column names, and values (N, 9 per wrench) [N, m, N m].
    """
    names, values = [], []
    for end, wrench in wrenches.items():
        names += [f"ground_force{end}_{k}{a}" for k in "vp" for a in "xyz"]
        names += [f"ground_torque{end}_{a}" for a in "xyz"]
        F_x, F_z = share * wrench.force.T
        cop, zero = np.nan_to_num(wrench.cop_x), np.zeros_like(F_x)
        # M_y is about y (left), which is OpenSim's -z.
        free = np.where(wrench.is_loaded, 0.0, -share * wrench.moment)
        values += [F_x, F_z, zero, cop, zero, zero, zero, zero, free]
    return names, np.column_stack(values)


def spatial_wrench(plate: PlateRecording, axes: Axes) -> np.ndarray:
    """A plate's force, and moment about the origin, in forward, left, up.

    The moment includes the free moment and the height of the plate's surface.

    Returns:
        (N, 6) force [N] and moment [N m], each forward, left, up.
    """
    return np.hstack(
        [axes.space(plate.force), axes.space(plate.moment_about_origin())]
    )


def merge_plates(
    feet: Mapping[str, PlanarWrench], ankles: Mapping[str, np.ndarray]
) -> tuple[PlanarWrench, dict[str, float]]:
    """Add both feet's wrenches, each first shifted to the mean ankle.

    Feet stand centimetres apart fore and aft. Without the shift, moving load
    from one foot to the other would look like a moving centre of pressure.
    Each wrench is shifted by the distance from its own ankle to the mean of
    all ankles, averaged over time.

    Args:
        feet: wrench of "left" and "right"; of one, then doubled; or of "both".
        ankles: side -> (N, 2) ankle centres [m] of all legs with markers,
            also of a foot without a plate.

    Returns:
        The sum, and the shift applied to each foot [m].
    """
    if "both" in feet:
        return feet["both"], {"both": 0.0}
    x = {side: float(p[:, 0].mean()) for side, p in ankles.items()}
    middle = float(np.mean(list(x.values())))
    shifts = {side: middle - x.get(side, middle) for side in feet}
    moved = [w.shifted(shifts[side]) for side, w in feet.items()]
    if len(moved) == 1:
        return moved[0].scaled(2.0), shifts
    return moved[0] + moved[1], shifts
