"""Angles and moments of the exoskeleton's joints, recorded or modelled.

Columns of the files are exo_ankle, exo_knee, exo_hip for angles and
exo_ankle_moment, ... for moments, or each with the suffix _left or _right.
A moment is that of drive and friction together, positive in the direction of
the joint's angle.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table
from drake_exo.files.tables import (
    Table,
    kind_of,
    missing_column,
    read_csv_table,
    uniform_time,
)
from drake_exo.measurement.filters import derivatives, resample
from drake_exo.measurement.settings import Device, Filter, Legs
from drake_exo.model.assembly import SIDES
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.planar_tree import PlanarTree

_MOMENT = "_moment"
# Suffix of the columns -> what they hold, and its units in a .csv.
_UNITS = {
    "": ("an angle", ("deg", "rad")),
    _MOMENT: ("a moment", ("nm", "n m")),
}


@dataclass(frozen=True)
class Signal:
    """Filtered angles or moments of the device's joints, as sampled.

    Attributes:
        time: (N,) evenly spaced [s].
        values: (N, joints) [rad], or [N m] of both legs; (N, 3) of a mat.
        source: file name.
        one_leg: the leg that was measured, None for both.
    """

    time: np.ndarray
    values: np.ndarray
    source: str
    one_leg: str | None = None

    def delayed(self, delay_s: float) -> "Signal":
        """The same signal with its clock's lag removed from the times."""
        return replace(self, time=self.time - delay_s)

    def at(self, time: np.ndarray, what: str) -> np.ndarray:
        """Values (n, joints) at times (n,) that at most a sample is beyond.

        Raises:
            InputError: the signal starts later or ends earlier.
        """
        return resample(self.time, self.values, self._within(time, what))

    def motion(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Values and two time derivatives, each (n, joints), at times (n,)."""
        time = self._within(time, "encoder angles")
        v, a = derivatives(self.time, self.values)
        return tuple(resample(self.time, x, time) for x in (self.values, v, a))

    def _within(self, wanted: np.ndarray, what: str) -> np.ndarray:
        first, last = self.time[[0, -1]]
        step = self.time[1] - first
        if first > wanted[0] + step or last < wanted[-1] - step:
            raise InputError(
                f"{self.source}: {what} cover {first:g} to {last:g} s, but the "
                f"trial runs from {wanted[0]:g} to {wanted[-1]:g} s; export "
                "the whole trial, shorten it with start_s and end_s, or "
                "correct encoder_delay_s or pressure_delay_s, taken off here"
            )
        return np.clip(wanted, first, last)


def read_angles(
    path: Path, joints: tuple[str, ...], legs: Legs, settings: Filter
) -> Signal:
    """Read encoder angles (.mot, .sto, .csv), filtered [rad].

    Args:
        path: the file.
        joints: names of the device's joints.
        legs: which legs the file holds.
        settings: of the filter.

    Raises:
        InputError: unreadable, a joint missing, gaps, uneven time, too
            short or too slow for the filter.
    """
    return _read(path, joints, legs, settings, "")


def read_moments(
    path: Path, joints: tuple[str, ...], legs: Legs, settings: Filter
) -> Signal:
    """Read moments, sums of both legs [N m]; raises as `read_angles`."""
    return _read(path, joints, legs, settings, _MOMENT)


def _read(path, joints, legs, settings: Filter, ending: str) -> Signal:
    table = _table(path, joints, ending)
    time = uniform_time(table.source, table.time)
    rate = (len(time) - 1) / (time[-1] - time[0])
    values = np.column_stack(
        [_of_legs(table, joint + ending, legs) for joint in joints]
    )
    if ending == _MOMENT:
        values = 2.0 * values
    values = settings.smooth(values, rate, table.source)
    one_leg = None if legs == "both" else legs
    return Signal(time, values, table.source, one_leg)


def _table(path: Path, joints: tuple[str, ...], ending: str) -> Table:
    kinds = ".mot", ".sto", ".csv"
    if kind_of(path, kinds, "a file of exoskeleton joints") == ".csv":
        table = read_csv_table(path)
        what, known = _UNITS[ending]
        for name in _columns(table, joints, ending):
            unit = table.units[table.names.index(name)]
            if unit not in known:
                raise InputError(
                    f"{path}:1: column {name!r} is in {unit!r}; give {what} "
                    f"in {' or '.join(known)}"
                )
        return table
    table = read_table(path)
    if ending:
        return table
    return table.in_radians(_columns(table, joints, ending))


def _columns(table: Table, joints: tuple[str, ...], ending: str) -> list[str]:
    """Columns of the table that hold the joints' angles, or moments."""
    own = [joint + ending for joint in joints]
    sided = [f"{name}_{side}" for name in own for side in SIDES]
    return [name for name in table.names if name in (*own, *sided)]


def _of_legs(table: Table, name: str, legs: Legs) -> np.ndarray:
    """Angle or moment (N,) of one joint, per leg: the mean of the legs.

    A column without a side holds the mean angle or the summed moment of both
    legs if `legs` is "both", else the value of that leg.
    """
    sided = [f"{name}_{side}" for side in SIDES]
    is_moment = name.endswith(_MOMENT)
    if legs == "both":
        if all(s in table.names for s in sided):
            return table.columns(sided).mean(axis=1)
        for side, one in zip(SIDES, sided, strict=True):
            if one in table.names and name not in table.names:
                key = "moment_legs" if is_moment else "encoder_legs"
                raise InputError(
                    f"{table.source}: has no column {name!r}, and of "
                    f"{', '.join(sided)} only {one!r}; say '{key}: {side}' "
                    "in device, or add the other leg's"
                )
        return table.column(name) * (0.5 if is_moment else 1.0)
    one = f"{name}_{legs}"
    if one in table.names:
        return table.column(one)
    if any(s in table.names for s in sided):
        raise missing_column(table.source, one, table.names)
    return table.column(name)


def drive_moments(device: Device, tree: PlanarTree, q, v, a) -> np.ndarray:
    """Moments (N, joints) [N m] of the device by its identified dynamics.

    The drives provide a share of what inertia and weight of the device's links
    require; rotor inertia, friction and springs take from it:

        tau = share ID_exo(q, v, a) - J a - B v - C tanh(v/v_0) - K (q - q_0)

    Args:
        device: identified parameters.
        tree: dynamics of human and exoskeleton as two chains.
        q, v, a: (N, nq) motion.
    """
    names, columns = tree.coordinates, tree.coordinates.device_columns
    (inertia,) = _of_joints(device, names, "inertia_kg_m2")
    moments = np.zeros((len(q), len(columns)))
    if device.carries_itself:
        needed = tree.inverse_dynamics(q, v, a)[:, columns]
        moments += device.carries_itself * needed
    moments -= inertia * a[:, columns]
    springs = spring_moments(device, tree, q)
    return moments + springs + friction_moments(device, tree, v)


def spring_moments(device: Device, tree: PlanarTree, q) -> np.ndarray:
    """The springs' part (N, joints) of `drive_moments` [N m]."""
    names = tree.coordinates
    stiffness, rest_deg = _of_joints(
        device, names, "stiffness_nm_rad", "rest_deg"
    )
    angles = np.take(q, names.device_columns, axis=1)
    return -stiffness * (angles - np.deg2rad(rest_deg))


def spring_stiffness(device: Device | None, names: Coordinates) -> np.ndarray:
    """Stiffness (joints,) of springs across the device's joints [N m/rad]."""
    if device is None:
        return np.zeros(len(names.device))
    return _of_joints(device, names, "stiffness_nm_rad")[0]


def friction_moments(device: Device, tree: PlanarTree, v) -> np.ndarray:
    """Friction's part (N, joints) of `drive_moments` [N m]."""
    names = tree.coordinates
    viscous, dry, speed = _of_joints(
        device, names, "viscous_nm_s", "coulomb_nm", "coulomb_speed_rad_s"
    )
    rates = np.take(v, names.device_columns, axis=1)  # row-major, as v
    return -viscous * rates - dry * np.tanh(rates / speed)


def _of_joints(device: Device, names: Coordinates, *keys: str):
    """One array (joints,) per key: `JointDrive` values of the joints."""
    joints = [device.of(name, names.follows(name)) for name in names.device]
    return [np.array([getattr(joint, k) for joint in joints]) for k in keys]
