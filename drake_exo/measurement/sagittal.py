"""From the laboratory's axes to the sagittal plane, and plates to one foot.

Planar frame: x forward, z up, y left. A wrench in the plane is F_x, F_z and
the moment M_y = z F_x - x F_z about the laboratory's origin at z = 0; the
centre of pressure is CoP_x = -M_y / F_z.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import PlateRecording

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
# Below this vertical force a centre of pressure means nothing [N].
COP_THRESHOLD_N = 20.0


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

    @staticmethod
    def of(R_PL: np.ndarray) -> "Axes":
        """Axes of this rotation, of right angles alone."""
        forward, _, up = (
            ("-" if row.sum() < 0.0 else "") + "xyz"[np.argmax(np.abs(row))]
            for row in R_PL
        )
        return Axes(forward, up)

    @property
    def R_PL(self) -> np.ndarray:
        """Rotation (3, 3) from them to forward, left, up."""
        x, z = _unit(self.forward), _unit(self.up)
        return np.stack([x, np.cross(z, x), z])

    def points(self, p: np.ndarray) -> np.ndarray:
        """Points or forces (..., 3) -> their (..., 2) x and z."""
        return np.asarray(p) @ self.R_PL[[0, 2]].T

    def space(self, p: np.ndarray) -> np.ndarray:
        """Points, forces or moments (..., 3) -> forward, left, up (..., 3)."""
        return np.asarray(p) @ self.R_PL.T


def _unit(axis: str) -> np.ndarray:
    e = np.zeros(3)
    e["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return e


def fixed(given) -> np.ndarray:
    """A copy of numbers that cannot be written to.

    >>> fixed([1, 2]).flags.writeable
    False
    """
    array = np.array(given, dtype=float)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class PlanarWrench:
    """Force in the sagittal plane and its moment about the origin.

    Attributes:
        force: (N, 2) F_x, F_z [N].
        moment: (N,) M_y about the laboratory's origin at z = 0 [N m].

    Arrays cannot be written to; change a copy.

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
        _, _, moment = array.T
        return PlanarWrench(array[:, :2], moment)

    @staticmethod
    def of_spatial(wrench: np.ndarray) -> "PlanarWrench":
        """What of (N, 6) force and moment, forward, left, up, is in plane."""
        return PlanarWrench(wrench[:, [0, 2]], wrench[:, 4])

    @property
    def array(self) -> np.ndarray:
        """F_x, F_z, M_y (N, 3)."""
        return np.column_stack([self.force, self.moment])

    @property
    def force_x(self) -> np.ndarray:
        """Forward (N,) [N]."""
        return self.force[:, 0]

    @property
    def force_z(self) -> np.ndarray:
        """Upward (N,) [N]."""
        return self.force[:, 1]

    @property
    def is_loaded(self) -> np.ndarray:
        """Where a centre of pressure means something (N,) bool."""
        return self.force_z > COP_THRESHOLD_N

    @property
    def cop_x(self) -> np.ndarray:
        """Centre of pressure -M_y/F_z (N,) [m]; NaN where below 20 N."""
        loaded = self.is_loaded
        load = np.where(loaded, self.force_z, 1.0)
        return np.where(loaded, -self.moment / load, np.nan)

    def __add__(self, other: "PlanarWrench") -> "PlanarWrench":
        return PlanarWrench(
            self.force + other.force, self.moment + other.moment
        )

    def shifted(self, dx: float | np.ndarray) -> "PlanarWrench":
        """The same wrench acting `dx` further forward [m]."""
        return PlanarWrench(self.force, self.moment - dx * self.force_z)

    def held(self, below_n: float) -> "PlanarWrench":
        """The same with the centre of pressure held at small forces.

        Args:
            below_n: vertical force at which it is that of the nearest sample
                with a larger one [N]; 0 for nowhere.
        """
        known = np.flatnonzero(self.force_z >= below_n)
        if below_n == 0.0 or not len(known):
            return self
        index = np.arange(len(self.moment))
        after = np.searchsorted(known, index).clip(0, len(known) - 1)
        before = (after - 1).clip(0)
        sooner = index - known[before] < known[after] - index
        nearest = known[np.where(sooner, before, after)]
        at = -self.moment[nearest] / self.force_z[nearest]
        held = np.where(
            self.force_z >= below_n, self.moment, -at * self.force_z
        )
        return PlanarWrench(self.force, held)

    def reversed(self) -> "PlanarWrench":
        """Equal and opposite: on the plate instead of on the body."""
        return PlanarWrench(-self.force, -self.moment)

    def doubled(self) -> "PlanarWrench":
        """One leg's wrench taken for both."""
        return PlanarWrench(2.0 * self.force, 2.0 * self.moment)

    def cut(self, rows) -> "PlanarWrench":
        """Some of its samples."""
        return PlanarWrench(self.force[rows], self.moment[rows])


def external_loads(
    wrenches: Mapping[str, PlanarWrench], share: float = 1.0
) -> tuple[list[str], np.ndarray]:
    """Wrenches as OpenSim's external loads have them, in its axes.

    They act on the ground below the centre of pressure; where that means
    nothing, at the origin, with the moment as a free one.

    Args:
        wrenches: end of the columns' names, such as "_r" -> wrench (N,).
        share: of force and moment.

    Returns:
        Names of columns, and their values (N, 9 for each wrench).
    """
    names, values = [], []
    for end, wrench in wrenches.items():
        names += [f"ground_force{end}_{k}{a}" for k in "vp" for a in "xyz"]
        names += [f"ground_torque{end}_{a}" for a in "xyz"]
        F_x, F_z = share * wrench.force.T
        cop, zero = np.nan_to_num(wrench.cop_x), np.zeros_like(F_x)
        # About y (left) in the plane, so about -z (right) there.
        free = np.where(wrench.is_loaded, 0.0, -share * wrench.moment)
        values += [F_x, F_z, zero, cop, zero, zero, zero, zero, free]
    return names, np.column_stack(values)


def spatial_wrench(plate: PlateRecording, axes: Axes) -> np.ndarray:
    """A plate's force on the body and its moment about the origin.

    The free moment and the height of the plate's surface are in it.

    Returns:
        (N, 6) force [N] and moment [N m], each forward, left, up.
    """
    return np.hstack(
        [axes.space(plate.force), axes.space(plate.moment_about_origin())]
    )


def merge_plates(
    feet: Mapping[str, PlanarWrench], ankles: Mapping[str, np.ndarray]
) -> tuple[PlanarWrench, dict[str, float]]:
    """Both feet's plates as one, each taken into its own foot's frame.

    Feet stand centimetres apart fore and aft; merged as they are, a shift of
    load from one to the other would look like a moving centre of pressure.
    Each plate's wrench is moved by the distance from its own ankle to the
    mean of both.

    Args:
        feet: "left" and "right"; one of them, which counts twice; or "both".
        ankles: side -> (N, 2) ankle centres [m], of the legs that are known,
            of a foot without a plate, too: the mean is of all.

    Returns:
        The sum, and the shift applied to each [m].
    """
    if "both" in feet:
        return feet["both"], {"both": 0.0}
    x = {side: float(p[:, 0].mean()) for side, p in ankles.items()}
    middle = float(np.mean(list(x.values())))
    shifts = {side: middle - x.get(side, middle) for side in feet}
    moved = [w.shifted(shifts[side]) for side, w in feet.items()]
    if len(moved) == 1:
        return moved[0].doubled(), shifts
    return moved[0] + moved[1], shifts
