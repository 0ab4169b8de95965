"""A trial: one movement on one time base, filtered, with its provenance."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import read_arrays, read_json, write_json
from drake_exo.measurement.filters import resample
from drake_exo.measurement.sagittal import cop_x

_ARRAYS = ("time", "q", "v", "a", "grf", "moment_y")


@dataclass(frozen=True)
class Trial:
    """One movement of one subject; forces and angles are of both legs.

    Attributes:
        name: unique in its study.
        coordinates: names of the coordinates (6, or 9 with exoskeleton), in
            the order of the plant's positions.
        time: (N,) evenly spaced [s].
        q, v, a: (N, nq) positions [m, rad] and their time derivatives.
        grf: (N, 2) F_x, F_z on the feet [N].
        moment_y: (N,) moment of the ground reaction about the laboratory's
            origin at z = 0, M_y = z F_x - x F_z [N m].
        mass_kg: body mass without the exoskeleton.
        provenance: which files, which filter, what was shifted or doubled.
        moments: (N, nq - 3) joint moments [N m]: the human's (resultant of
            inverse dynamics minus the exoskeleton's), then the
            exoskeleton's; None where not known.
        normal_force: segment ("shank", "thigh", "pelvis") -> (N,) force on
            the human normal to the segment [N], where a mat measured it.
        chair: (N, 3) F_x, F_z [N] and M_y about the origin [N m] of the
            chair on the body, zero from seat-off on; None where no plate
            measured it.
        chair_on_thighs: share of it that acts on the thighs, the rest acts
            on the pelvis.
    """

    name: str
    coordinates: tuple[str, ...]
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    grf: np.ndarray
    moment_y: np.ndarray
    mass_kg: float
    provenance: dict[str, Any] = field(default_factory=dict)
    moments: np.ndarray | None = None
    normal_force: dict[str, np.ndarray] = field(default_factory=dict)
    chair: np.ndarray | None = None
    chair_on_thighs: float = 0.0

    def __post_init__(self):
        n, nq = len(self.time), len(self.coordinates)
        shapes = {
            "q": (n, nq),
            "v": (n, nq),
            "a": (n, nq),
            "grf": (n, 2),
            "moment_y": (n,),
            **{f"normal_force.{key}": (n,) for key in self.normal_force},
        }
        if self.moments is not None:
            shapes["moments"] = (n, nq - 3)
        if self.chair is not None:
            shapes["chair"] = (n, 3)
        for name, array in self._arrays().items():
            if array.shape != shapes[name]:
                raise ValueError(
                    f"trial {self.name}: {name} has shape "
                    f"{array.shape}, not {shapes[name]}"
                )

    def _arrays(self) -> dict[str, np.ndarray]:
        """All arrays by name but time."""
        arrays = {name: getattr(self, name) for name in _ARRAYS[1:]}
        if self.moments is not None:
            arrays["moments"] = self.moments
        if self.chair is not None:
            arrays["chair"] = self.chair
        for key, force in self.normal_force.items():
            arrays[f"normal_force.{key}"] = force
        return arrays

    def _with(self, time: np.ndarray, arrays: dict) -> "Trial":
        """The same trial with other numbers, named as in `_arrays`."""
        return replace(self, time=time, **_fields(arrays))

    @property
    def duration(self) -> float:
        """Length of the trial [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def cop_x(self) -> np.ndarray:
        """Centre of pressure (N,) [m]; NaN where the feet bear under 20 N."""
        return cop_x(self.grf[:, 1], self.moment_y)

    def window(self, start_s: float, end_s: float) -> "Trial":
        """The frames from `start_s` to `end_s`.

        Raises:
            InputError: fewer than two frames are left.
        """
        half = 0.5 * (self.time[1] - self.time[0])
        inside = (self.time >= start_s - half) & (self.time <= end_s + half)
        if inside.sum() < 2:
            raise InputError(
                f"trial {self.name}: {start_s:g} to {end_s:g} s lies outside "
                f"the recording ({self.time[0]:g} to {self.time[-1]:g} s); "
                "correct start_s and end_s"
            )
        arrays = {name: x[inside] for name, x in self._arrays().items()}
        return self._with(self.time[inside], arrays)

    def resample(self, nodes_per_second: float) -> "Trial":
        """The same movement on another even time base.

        Start and end stay; the rate is the nearest that divides the duration
        evenly. Positions, velocities and accelerations are interpolated each
        by itself, so that the ends keep what the whole recording said of
        them.
        """
        count = max(round(self.duration * nodes_per_second), 1) + 1
        time = np.linspace(self.time[0], self.time[-1], count)
        arrays = {
            name: resample(self.time, x, time)
            for name, x in self._arrays().items()
        }
        return self._with(time, arrays)

    def save(self, path: str | Path) -> None:
        """Write `path`.npz (numbers) and `path`.json (the rest)."""
        path = Path(path)
        np.savez(
            path.with_name(path.name + ".npz"),
            time=self.time,
            **self._arrays(),
        )
        write_json(
            path.with_name(path.name + ".json"),
            {
                "name": self.name,
                "coordinates": self.coordinates,
                "mass_kg": self.mass_kg,
                "chair_on_thighs": self.chair_on_thighs,
                "provenance": self.provenance,
            },
        )

    @staticmethod
    def load(path: str | Path) -> "Trial":
        """Read what `save` wrote.

        Raises:
            InputError: one of the files is missing or damaged.
        """
        path = Path(path)
        again = "save it again"
        arrays = read_arrays(path.with_name(path.name + ".npz"), again)
        rest = read_json(path.with_name(path.name + ".json"), again)
        try:
            trial = Trial(
                rest["name"],
                tuple(rest["coordinates"]),
                mass_kg=float(rest["mass_kg"]),
                provenance=dict(rest["provenance"]),
                chair_on_thighs=float(rest["chair_on_thighs"]),
                **_fields(arrays),
            )
            trial._check_numbers()
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise InputError(
                f"{path}: holds no trial ({error}); {again}"
            ) from error
        return trial

    def _check_numbers(self) -> None:
        """Raises ValueError unless all arrays hold finite numbers."""
        for name, x in {"time": self.time, **self._arrays()}.items():
            if x.dtype != float or not np.isfinite(x).all():
                raise ValueError(f"{name} does not hold finite numbers")


def _fields(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Fields of a Trial from arrays named as in `Trial._arrays`."""
    mats = {
        name.partition(".")[2]: array
        for name, array in arrays.items()
        if name.startswith("normal_force.")
    }
    rest = {k: x for k, x in arrays.items() if "." not in k}
    return {**rest, "normal_force": mats}
