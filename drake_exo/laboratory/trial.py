"""A trial: one movement on one time base, filtered, with its provenance."""

import io
import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.filters import resample
from drake_exo.laboratory.sagittal import cop_x
from drake_exo.output import write_json

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

    def __post_init__(self):
        n, nq = len(self.time), len(self.coordinates)
        shapes = {
            "q": (n, nq),
            "v": (n, nq),
            "a": (n, nq),
            "grf": (n, 2),
            "moment_y": (n,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"trial {self.name}: {name} has shape "
                    f"{getattr(self, name).shape}, not {shape}"
                )

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
        return replace(
            self, **{name: getattr(self, name)[inside] for name in _ARRAYS}
        )

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
            name: resample(self.time, getattr(self, name), time)
            for name in _ARRAYS[1:]
        }
        return replace(self, time=time, **arrays)

    def save(self, path: str | Path) -> None:
        """Write `path`.npz (numbers) and `path`.json (the rest)."""
        path = Path(path)
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez(path.with_name(path.name + ".npz"), **arrays)
        write_json(
            path.with_name(path.name + ".json"),
            {
                "name": self.name,
                "coordinates": self.coordinates,
                "mass_kg": self.mass_kg,
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
        try:
            numbers = path.with_name(path.name + ".npz").read_bytes()
            with np.load(io.BytesIO(numbers)) as data:
                arrays = {name: data[name] for name in _ARRAYS}
            text = path.with_name(path.name + ".json").read_text("utf-8")
            rest = json.loads(text)
            return Trial(
                rest["name"],
                tuple(rest["coordinates"]),
                mass_kg=rest["mass_kg"],
                provenance=rest["provenance"],
                **arrays,
            )
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise InputError(
                f"{path}: holds no trial ({error}); save it again"
            ) from error
