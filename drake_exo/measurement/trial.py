"""A trial: one movement, measured, solved or simulated, on one time base."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.errors import (
    InputError,
    check_bounds,
    check_type,
    nearest,
    path_of,
)
from drake_exo.files.output import read_arrays, read_json, write_json
from drake_exo.measurement import kinematics
from drake_exo.measurement.sagittal import PlanarWrench, fixed
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model

Source = Literal["measured", "solved", "not solved", "simulated"]
INSTRUMENTS = "forces", "encoders", "pressure"  # with clocks of their own
_OUTSIDE_S = 1e-6  # rounding of a trial's end


@dataclass(frozen=True, eq=False)
class CuffForce:
    """Force of a cuff on the human, measured by mats or given by a model.

    Attributes:
        normal: (n,) across the segment, positive forward [N].
        tangential: (n,) along the segment, positive upward [N]; None if
            unknown, since mats do not measure it.
        moment: (n,) [N m], toes-up positive; None if unknown.

    >>> CuffForce(np.array([12.0])).tangential is None
    True
    """

    normal: np.ndarray
    tangential: np.ndarray | None = None
    moment: np.ndarray | None = None

    def __post_init__(self):
        for name, given in vars(self).copy().items():
            if given is not None:
                object.__setattr__(self, name, fixed(given))

    @staticmethod
    def of(components: np.ndarray) -> "CuffForce":
        """From tangential, normal, rotational components (n, 3)."""
        tangential, normal, moment = np.asarray(components).T
        return CuffForce(normal, tangential, moment)

    def __repr__(self) -> str:
        largest = np.abs(self.normal).max(initial=0.0)
        return (
            f"CuffForce({len(self.normal)} samples, normal up to "
            f"{largest:.1f} N)"
        )

    @property
    def components(self) -> np.ndarray:
        """Tangential, normal, rotational (n, 3); NaN where not known."""
        unknown = np.full(len(self.normal), np.nan)
        return np.column_stack(
            [
                unknown if x is None else x
                for x in (self.tangential, self.normal, self.moment)
            ]
        )


@dataclass(frozen=True, eq=False)
class Trial:
    """One movement of one subject; with one leg, forces are sums of both legs.

    Toes up, dorsiflexion, knee and hip flexion are positive, for angles and
    moments; all angles are zero in upright standing. Arrays are read-only:
    change a copy, and put it in with `dataclasses.replace`.

    Raises:
        InputError: a part is of another type, an array holds no real numbers,
            times do not increase, the chair's share is not within 0 to 1, or
            `provenance` asks for the clock of an unknown instrument.
        ValueError: an array has another shape.

    Attributes:
        name: unique in its study.
        coordinates: names of the coordinates.
        times: (n,) increasing, from 0 [s].
        q, v, a: (n, nq) positions [m, rad] and their time derivatives.
        ground: wrench (n,) of the ground on both feet.
        feet: side -> that foot's part of `ground`; empty in models of one leg.
        source: "measured", "solved", "not solved" (where a solve that
            failed stopped) or "simulated".
        moments: (n, n_joints) joint moments [N m]; the human's are those of
            the muscles: without the exoskeleton's, see `with_moments`. None
            where not known.
        cuffs: cuff -> its force (n,) on the human, where it is known.
        chair: wrench (n,) of the chair on the body; None if no plate was
            under it.
        chair_on_thighs: share of `chair` that acts on the thighs; the rest
            acts on the pelvis.
        applied: segment -> wrench (n,) of the loads that it carries, or that
            pull or push it.
        friction: (n, device's joints) part of `moments` that is identified
            friction [N m]; None where moments were measured.
        jerk: (n_controls, nq) controls of a solution; None otherwise.
        mass_kg: body mass without the exoskeleton; None where not known.
        start_s: time of the first sample in the recording [s].
        provenance: files, filters, and what was shifted or doubled. Clocks
            that it names under both "delays_s" (instrument -> lag taken out
            [s]) and "clocks" (instrument -> text) are found by Phases B and C:
            those of "encoders" and "pressure".
        around: what the device's instruments showed from shortly before until
            shortly after this trial, too, as a trial; None where not known.

    >>> import numpy as np
    >>> names = Coordinates(("foot_x", "foot_z", "foot_pitch", "ankle"))
    >>> times = np.linspace(0.0, 1.0, 5)
    >>> q = np.outer(times, [0.0, 0.0, 0.0, 0.4])
    >>> weight = np.column_stack([0 * times, 700 + 0 * times])
    >>> ground = PlanarWrench(weight, -0.1 * weight[:, 1])
    >>> trial = Trial("lean", names, times, q, 0 * q, 0 * q, ground)
    >>> trial.coordinate("ankle")[-1], float(trial.ground.cop_x[0])
    (np.float64(0.4), 0.1)
    """

    name: str
    coordinates: Coordinates
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ground: PlanarWrench
    source: Source = "measured"
    feet: dict[str, PlanarWrench] = field(default_factory=dict)
    moments: np.ndarray | None = None
    cuffs: dict[str, CuffForce] = field(default_factory=dict)
    chair: PlanarWrench | None = None
    chair_on_thighs: float = 0.0
    applied: dict[str, PlanarWrench] = field(default_factory=dict)
    friction: np.ndarray | None = None
    jerk: np.ndarray | None = None
    mass_kg: float | None = None
    start_s: float = 0.0
    provenance: dict[str, Any] = field(default_factory=dict)
    around: "Trial | None" = None

    def __post_init__(self):
        for name in ("times", "q", "v", "a", "moments", "friction", "jerk"):
            if (given := getattr(self, name)) is not None:
                numbers = np.asarray(given)
                if numbers.dtype.kind not in "iuf":
                    raise InputError(
                        f"trial {self.name}: {name} holds no real numbers; "
                        "give an array of them"
                    )
                object.__setattr__(self, name, fixed(numbers))
        for name in ("feet", "cuffs", "applied", "provenance"):
            object.__setattr__(self, name, dict(getattr(self, name)))
        parts = {"coordinates": self.coordinates, "ground": self.ground}
        if self.chair is not None:
            parts["chair"] = self.chair
        if self.around is not None:
            parts["around"] = self.around
        for group in ("feet", "applied", "cuffs"):
            own = getattr(self, group)
            parts |= {f"{group}.{key}": part for key, part in own.items()}
        kinds = {
            "coordinates": Coordinates,
            "cuffs": CuffForce,
            "around": Trial,
        }
        for name, part in parts.items():
            kind = kinds.get(name.partition(".")[0], PlanarWrench)
            check_type(part, kind, f"trial {self.name}: {name}")
        check_type(self.name, str, "name")
        if self.source not in get_args(Source):
            raise InputError(
                f"trial {self.name}: source is {self.source!r}; give one of "
                f"{', '.join(get_args(Source))}"
            )
        if self.mass_kg is not None:
            bounds = {"above": 0.0, "unit": "kg"}
            check_bounds(f"trial {self.name}: mass_kg", self.mass_kg, bounds)
        share, bounds = self.chair_on_thighs, {"minimum": 0.0, "maximum": 1.0}
        check_bounds(f"trial {self.name}: chair_on_thighs", share, bounds)
        for key in ("delays_s", "shifted_s"):
            lags = self.provenance.get(key, {})
            where = f"trial {self.name}: provenance.{key}"
            check_type(lags, dict, where)
            for clock, lag in lags.items():
                check_bounds(f"{where}.{clock}", lag, {"unit": "s"})
        clocks = self.provenance.get("clocks", {})
        check_type(clocks, dict, f"trial {self.name}: provenance.clocks")
        for clock in clocks:
            if clock in self.lags_s and clock not in INSTRUMENTS:
                raise InputError(
                    f"trial {self.name}: provenance.clocks names {clock!r}; "
                    f"lags are known of {', '.join(INSTRUMENTS)}"
                    f"{nearest(clock, INSTRUMENTS)}"
                )
        columns = {
            **dict.fromkeys(("q", "v", "a", "jerk"), len(self.coordinates)),
            "moments": self.coordinates.num_joints,
            "friction": len(self.coordinates.device),
            **dict.fromkeys(("ground", "chair"), 3),
        }
        for name, array in {"times": self.times, **self._arrays()}.items():
            rows = len(array if name == "jerk" else self.times)
            is_wrench = name.startswith(("feet.", "applied."))
            width = 3 if is_wrench else columns.get(name)
            wanted = (rows, width) if width is not None else (rows,)
            if array.shape != wanted:
                raise ValueError(
                    f"trial {self.name}: {name} has shape "
                    f"{array.shape}, not {wanted}"
                )
        if not len(self.times) or not (np.diff(self.times) > 0.0).all():
            raise InputError(
                f"trial {self.name}: times do not increase, or there are none; "
                "sort the samples and give each one once"
            )

    def __repr__(self) -> str:
        # Not the arrays: a notebook shows what its last line is.
        cuffs = f"; cuffs {', '.join(self.cuffs)}" if self.cuffs else ""
        return (
            f"Trial({self.name!r}, {self.source}, {self.duration:.2f} s, "
            f"{len(self.times)} samples; "
            f"{', '.join(self.coordinates.names)}{cuffs})"
        )

    def not_finite(self) -> str | None:
        """Name of an array that holds NaN or infinity; None if none does."""
        arrays = {"times": self.times, **self._arrays()}
        bad = (n for n, x in arrays.items() if not np.isfinite(x).all())
        return next(bad, None)

    def coordinate(self, name: str) -> np.ndarray:
        """Position (n,) of a coordinate by name [m or rad].

        Raises:
            InputError: there is none of that name.
        """
        return self.q[:, self.coordinates.index(name)]

    def velocity(self, name: str) -> np.ndarray:
        """Velocity (n,) of a coordinate [m/s or rad/s]; raises likewise."""
        return self.v[:, self.coordinates.index(name)]

    def acceleration(self, name: str) -> np.ndarray:
        """Acceleration (n,) by name [m/s^2 or rad/s^2]; raises likewise."""
        return self.a[:, self.coordinates.index(name)]

    def moment(self, name: str) -> np.ndarray:
        """Moment (n,) at a joint by name [N m].

        Raises:
            InputError: no such joint, or moments are not known.
        """
        place = self.coordinates.joint(name)
        if self.moments is None:
            raise InputError(
                f"trial {self.name}: joint moments are not known; give "
                "exo_moments or device in the study"
            )
        return self.moments[:, place]

    def with_moments(
        self, model: Model, device: np.ndarray | None = None
    ) -> "Trial":
        """The trial with its model's joint moments by inverse dynamics.

        Body and device move as one, from the ground up. The human's moments
        are the resultant less those of the device (n, m) [N m], in the order
        of `coordinates.device`.

        Raises:
            InputError: `model` is no model, or `device` has another shape.
        """
        check_type(model, Model, "model")
        names, tree = model.coordinates, model.rigid.tree
        wanted = len(self.times), len(names.device)
        exo = fixed(np.zeros((wanted[0], 0)) if device is None else device)
        if exo.shape != wanted:
            raise InputError(
                f"trial {self.name}: the device's moments have the shape "
                f"{exo.shape}, not {wanted}; give a column for each joint"
            )
        q, v, a = self.body
        Q = kinematics.inverse_dynamics(tree, q, v, a, self.loads(tree.root))
        resultant = kinematics.from_the_ground_up(tree, q, Q)
        resultant = resultant[:, tree.coordinates.joint_columns]
        human = resultant - exo @ names.turned_by
        return replace(self, moments=names.joined(human, exo))

    @property
    def body(self) -> list[np.ndarray]:
        """q, v, a (n, k) of the body without the device."""
        columns = self.coordinates.body_columns
        return [x[:, columns] for x in (self.q, self.v, self.a)]

    @property
    def device_moments(self) -> np.ndarray:
        """Columns (n, m) of `moments` at the device's m joints [N m]."""
        return self.moments[:, self.coordinates.is_device_joint]

    @property
    def device_work(self) -> float:
        """Work of the device's joints [J], by the trapezoid rule."""
        rates = self.v[:, self.coordinates.device_columns]
        power = np.sum(self.device_moments * rates, axis=1)
        return float(np.trapezoid(power, self.times))

    def cuff(self, name: str) -> "CuffForce":
        """Force of a cuff on the human.

        Raises:
            InputError: it is not known.
        """
        if name not in self.cuffs:
            raise InputError(
                f"trial {self.name}: nothing is known of a cuff {name!r}; "
                f"there are {', '.join(self.cuffs) or 'none'}"
                f"{nearest(name, self.cuffs)}"
            )
        return self.cuffs[name]

    @property
    def duration(self) -> float:
        """Length of the trial [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def lags_s(self) -> dict[str, float]:
        """Instrument -> lag removed from its clock [s]; {} if not measured."""
        return self.provenance.get("delays_s", {})

    @property
    def shifts_s(self) -> dict[str, float]:
        """Instrument -> part of `lags_s` that was found since reading [s]."""
        return self.provenance.get("shifted_s", {})

    @property
    def readings(self) -> "Trial":
        """`around` if it holds all that this trial does, else the trial."""
        wide, own = self.around, self._arrays().keys()
        is_known = wide is not None and own <= wide._arrays().keys()
        return wide if is_known else self

    @property
    def chair_shares(self) -> dict[str, float]:
        """Segment -> share of the chair's wrench; {} without a chair."""
        # A wrench that is always zero is no chair; leaving it out saves time.
        if self.chair is None or not self.chair.array.any():
            return {}
        parts = {
            "pelvis": 1.0 - self.chair_on_thighs,
            "thigh": self.chair_on_thighs,
        }
        return {name: share for name, share in parts.items() if share > 0.0}

    def loads(self, root: str | None) -> dict[str, PlanarWrench]:
        """Segment -> external wrench (n,) on it, for inverse dynamics.

        Args:
            root: root segment of the model: the foot if it has one leg; None
                for chair and loads alone, without the ground.
        """
        ground = {f"foot_{side}": w for side, w in self.feet.items()}
        found = {} if root is None else ground or {root: self.ground}
        for shares, wrench in self.borne():
            for body, share in shares.items():
                part = wrench.scaled(share)
                found[body] = found[body] + part if body in found else part
        return found

    def borne(self) -> list[tuple[dict[str, float], PlanarWrench]]:
        """Wrenches of chair and loads, each with segment -> share of it."""
        found = [(self.chair_shares, self.chair)] if self.chair_shares else []
        return [*found, *(({b: 1.0}, w) for b, w in self.applied.items())]

    @property
    def soles(self) -> dict[str, PlanarWrench]:
        """Wrench (n,) of the ground by foot: "left" and "right", or "both"."""
        return self.feet or {"both": self.ground}

    def sample(self, times: np.ndarray) -> "Trial":
        """The same movement at other times (m,) [s], by cubic splines.

        Raises:
            InputError: a time is outside the trial, or none is given.
        """
        times = np.atleast_1d(np.asarray(times, dtype=float))
        if not times.size:
            raise InputError(f"trial {self.name}: no times are asked for")
        first, last = self.times[[0, -1]]
        if not (
            (times >= first - _OUTSIDE_S) & (times <= last + _OUTSIDE_S)
        ).all():
            raise InputError(
                f"trial {self.name}: times from {times.min():g} to "
                f"{times.max():g} s are asked for, but it lasts from {first:g} "
                f"to {last:g} s; ask within that"
            )
        arrays = {
            name: CubicSpline(self.times, x)(times)
            for name, x in self._arrays().items()
            if name != "jerk"
        }
        kept = {"times": times, "jerk": None, "around": None}
        return replace(self, **kept, **_fields(arrays))

    def _arrays(self) -> dict[str, np.ndarray]:
        """Name -> array, of all arrays that are set, except times."""
        arrays = {"q": self.q, "v": self.v, "a": self.a}
        arrays["ground"] = self.ground.array
        for side, wrench in self.feet.items():
            arrays[f"feet.{side}"] = wrench.array
        for body, wrench in self.applied.items():
            arrays[f"applied.{body}"] = wrench.array
        if self.chair is not None:
            arrays["chair"] = self.chair.array
        arrays |= {"moments": self.moments, "friction": self.friction}
        arrays["jerk"] = self.jerk
        for cuff, force in self.cuffs.items():
            for part, x in vars(force).items():
                arrays[f"cuffs.{cuff}.{part}"] = x
        return {name: x for name, x in arrays.items() if x is not None}

    def save(self, path: str | Path) -> None:
        """Write `path`.npz (arrays) and `path`.json (the rest).

        Args:
            path: where, with or without one of the two endings.
        """
        arrays, rest = _files(path)
        np.savez(arrays, times=self.times, **self._arrays())
        write_json(
            rest,
            {
                "name": self.name,
                "source": self.source,
                "coordinates": self.coordinates.names,
                "device": self.coordinates.device,
                "coupling": self.coordinates.coupling,
                "mass_kg": self.mass_kg,
                "start_s": self.start_s,
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
        again = "run what wrote it again"
        arrays, rest = _files(path)
        arrays, rest = read_arrays(arrays, again), read_json(rest, again)
        try:
            for name, x in arrays.items():
                if x.dtype != float or not np.isfinite(x).all():
                    raise ValueError(f"{name} does not hold finite numbers")
            times, mass = arrays.pop("times"), rest["mass_kg"]
            return Trial(
                rest["name"],
                Coordinates(
                    tuple(rest["coordinates"]),
                    tuple(rest["device"]),
                    tuple(tuple(row) for row in rest.get("coupling", ())),
                ),
                times,
                source=rest["source"],
                mass_kg=None if mass is None else float(mass),
                start_s=float(rest["start_s"]),
                provenance=dict(rest["provenance"]),
                chair_on_thighs=float(rest["chair_on_thighs"]),
                **_fields(arrays),
            )
        except (
            InputError,
            ValueError,
            KeyError,
            TypeError,
            IndexError,
            OverflowError,
        ) as error:
            raise InputError(
                f"{path}: holds no trial ({error}); {again}"
            ) from error


def _fields(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Fields of a Trial from arrays named as in `Trial._arrays`."""
    fields = {k: x for k, x in arrays.items() if "." not in k}
    for name in ("ground", "chair"):
        if name in fields:
            fields[name] = PlanarWrench.of(fields[name])
    feet, applied = (
        {
            name.removeprefix(kind): PlanarWrench.of(x)
            for name, x in arrays.items()
            if name.startswith(kind)
        }
        for kind in ("feet.", "applied.")
    )
    parts: dict[str, dict[str, np.ndarray]] = {}
    for name, x in arrays.items():
        if name.startswith("cuffs."):
            cuff, _, part = name.removeprefix("cuffs.").rpartition(".")
            parts.setdefault(cuff, {})[part] = x
    cuffs = {cuff: CuffForce(**found) for cuff, found in parts.items()}
    return {**fields, "cuffs": cuffs, "feet": feet, "applied": applied}


def _files(path: str | Path) -> tuple[Path, Path]:
    """Files of a trial's arrays and of the rest."""
    path = path_of(path, "path")
    name = path.name.removesuffix(".npz").removesuffix(".json")
    return path.with_name(name + ".npz"), path.with_name(name + ".json")


def as_trials(trials) -> tuple[Trial, ...]:
    """Check trials given by a caller and return them as a tuple.

    Raises:
        InputError: not a list, none in it, something other than a trial, or
            two of one name.
    """
    if not isinstance(trials, Iterable) or isinstance(trials, str):
        raise InputError(f"{trials!r:.60} is not a list of trials; give a list")
    found = tuple(trials)
    if not found:
        raise InputError("there are no trials; give at least one")
    for trial in found:
        if not isinstance(trial, Trial):
            raise InputError(f"{trial!r:.60} is not a trial; give a Trial")
    names = [trial.name for trial in found]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError(
                f"two trials are called {name!r}; give each its own name"
            )
    return found


def saw_device(trial: Trial) -> bool:
    """Whether angles, moments or mats of the device were measured."""
    known = trial.cuffs or trial.moments is not None
    return bool(known or "encoders" in trial.provenance)
