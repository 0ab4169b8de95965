"""Loads as a case file describes them: files, walking pattern, recording.

Every block reads a `Load` from the files that it names, relative to a folder.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drake_exo.errors import InputError, check_bounds
from drake_exo.files.opensim import read_table
from drake_exo.files.schema import exactly_one, positive, quantity
from drake_exo.files.tables import COP_THRESHOLD_N, between, missing_column
from drake_exo.soles.loads import (
    MOST_SAMPLES,
    Load,
    numbers_of,
    read_csv,
    text_lines,
)
from drake_exo.soles.numerics import without_yaw
from drake_exo.soles.walking_pattern import Robot, gravity

Vector3 = tuple[float, float, float]
Vector2 = tuple[float, float]


def angle() -> Any:
    """A settings field for an angle [rad], at most one turn."""
    return quantity("rad", 0.0, minimum=-6.29, maximum=6.29)


@dataclass(frozen=True)
class OneFoot:
    """The soft-sole authors' file of one foot: t, ZMP xy, CoM xy, force xyz."""

    file: str
    origin_m: Vector2
    skip_first: int = quantity(None, 10, minimum=0)
    skip_last: int = quantity(None, 11, minimum=0)

    def load(self, root: Path) -> Load:
        """Read the load; `file` is relative to `root`."""
        path = root / self.file
        head, *lines = text_lines(path) or [""]
        if len(head.split()) >= 8 and not head.strip("0123456789.+-eE \t"):
            raise InputError(
                f"{path}:1: holds numbers where the columns are named; put a "
                "line of names before them"
            )
        table = numbers_of(path, lines, 2, 8)
        rows = len(table) - self.skip_first - self.skip_last
        if rows < 1:
            raise InputError(
                f"{path}: skip_first {self.skip_first} and skip_last "
                f"{self.skip_last} leave none of its {len(table)} rows; give "
                "smaller ones"
            )
        table = table[self.skip_first :][:rows]
        t, zmp, force = table[:, 0], table[:, 1:3], table[:, 5:8]
        return Load(t, force, zmp, str(path)).placed(self.origin_m, 0.0)


@dataclass(frozen=True)
class Csv:
    """A CSV of force and ZMP, see `read_csv`."""

    file: str
    origin_m: Vector2 = (0.0, 0.0)
    yaw_rad: float = angle()

    def load(self, root: Path) -> Load:
        """Read the load; `file` is relative to `root`."""
        return read_csv(root / self.file).placed(self.origin_m, self.yaw_rad)


@dataclass(frozen=True)
class ForcePlate:
    """One plate of an OpenSim `.mot` file (x forward, y up, z right).

    Attributes:
        file: File with columns `<prefix>_vx`, `_px`, `_my` and so on.
        prefix: The plate's, such as "ground_force_2".
        start_s, end_s: Window of time that is read.
        origin_m, yaw_rad: Place and heading of the sole's frame in the
            laboratory (x forward, y left).
        least_force_n: Samples below are left out at both ends.
    """

    file: str
    prefix: str
    start_s: float
    end_s: float
    origin_m: Vector2
    yaw_rad: float = angle()
    least_force_n: float = positive("N", COP_THRESHOLD_N)

    def __post_init__(self):
        if self.end_s < self.start_s:
            raise InputError(
                f"end_s ({self.end_s:g}) is before start_s ({self.start_s:g})"
            )

    def load(self, root: Path) -> Load:
        """Read the load; `file` is relative to `root`."""
        path, prefix = root / self.file, self.prefix
        names = [[f"{prefix}_{s}{axis}" for axis in "xyz"] for s in "vpm"]
        table = _opensim_columns(path, [n for row in names for n in row])
        time = table["time"]
        rows = between(time, self.start_s, self.end_s)

        def turned(columns):  # (x, y up, z right) -> (x, y left, z up)
            x, y, z = (table[name][rows] for name in columns)
            return np.stack([x, -z, y], axis=1)

        F, P, M = map(turned, names)
        keep = _loaded(
            F[:, 2], self.least_force_n,
            f"{path}: {prefix} carries less than {self.least_force_n:g} N "
            f"from {self.start_s:g} to {self.end_s:g} s; choose another window "
            "or a lower least_force_n",
        )  # fmt: skip
        load = Load(
            time[rows][keep],
            F[keep],
            P[keep, :2],
            f"{path} {prefix}",
            M[keep, 2],
        )
        return load.placed(self.origin_m, self.yaw_rad)


@dataclass(frozen=True)
class Playback:
    """One stance of an HRP-4 playback file (37 columns, no times).

    The first column is 0 in double support, 1 on the left foot, 2 on the right.
    The force is m (a + g); in double support the feet share it by the ZMP's
    progress from one to the other (`share_double_support`).

    Attributes:
        foot, step: Which foot, and which of its whole stances (from 0).
        period_s: Time between rows.
        ankle_to_centre_m: Sole's centre from the ankle: forward, and outward
            (away from the other foot).
        least_force_n: Samples below are left out at both ends.
    """

    file: str
    foot: Literal["left", "right"]
    step: int
    mass_kg: float = positive("kg", 43.0)
    period_s: float = positive("s", 0.005)
    gravity_m_per_s2: float = gravity()
    ankle_to_centre_m: Vector2 = (0.015, 0.011)
    least_force_n: float = positive("N", COP_THRESHOLD_N)

    def load(self, root: Path) -> Load:
        """Read the load; `file` is relative to `root`."""
        path = root / self.file
        table = numbers_of(path, text_lines(path), 1, 37)
        phase = table[:, 0].astype(int)
        other = table[:, 0][~np.isin(table[:, 0], (0, 1, 2))]
        if len(other):
            raise InputError(
                f"{path}: column 1 holds the phase {other[0]:g}; write 0 where "
                "both feet bear, 1 where the left one does, 2 the right one"
            )
        mine = {"left": 1, "right": 2}[self.foot]
        runs = stances(phase, mine)
        if not 0 <= self.step < len(runs):
            raise InputError(
                f"{path}: the {self.foot} foot has {len(runs)} stances; step "
                f"{self.step} does not exist (counted from 0)"
            )
        first, last = runs[self.step]
        weight = [0.0, 0.0, self.gravity_m_per_s2]
        total = self.mass_kg * (table[:, 10:13] + weight)
        with np.errstate(invalid="ignore"):
            share, zmp = share_double_support(table[:, 1:3], phase, mine)
        rows = np.arange(first, last)
        if not np.isfinite(share[rows]).all():
            raise InputError(
                f"{path}: the ZMP (columns 2 and 3) does not move from one "
                "foot to the other in double support; export it again"
            )
        rows = rows[share[rows] * total[rows, 2] >= self.least_force_n]
        if len(rows) == 0:
            raise InputError(
                f"{path}: the {self.foot} foot never carries "
                f"{self.least_force_n:g} N; check mass_kg, gravity_m_per_s2 "
                "and least_force_n"
            )
        column = 13 if self.foot == "left" else 22
        middle = rows[phase[rows] == mine]
        ankle = table[middle[len(middle) // 2], column : column + 2]
        outward = self.ankle_to_centre_m[1] * (1 if mine == 1 else -1)
        load = Load(
            rows * self.period_s,
            share[rows, None] * total[rows],
            zmp[rows],
            f"{path} {self.foot} step {self.step}",
        )
        return load.placed(
            ankle + np.array([self.ankle_to_centre_m[0], outward]), 0.0
        )


def stances(phase: np.ndarray, mine: int) -> list[tuple[int, int]]:
    """Rows (first, end) of each whole stance of the foot in phase `mine`.

    They are its single support and the double supports around it. Standing at
    either end of the file is left out.
    """
    edges = _edges(phase)
    return [
        (int(edges[k - 1]), int(edges[k + 2]))
        for k in range(2, len(edges) - 3)
        if phase[edges[k]] == mine
    ]


def _edges(phase: np.ndarray) -> np.ndarray:
    """Rows at which a phase begins, and the number of rows."""
    change = np.flatnonzero(np.diff(phase)) + 1
    return np.concatenate([[0], change, [len(phase)]])


def share_double_support(zmp, phase, mine):
    """Share of the force on one foot (n,) and its own ZMP (n, 2).

    In each double support the total ZMP Z goes from A, under the foot that
    unloads, to B, under the one that loads. With α the progress of Z along
    AB and ρ = Z − (1 − α) A − α B, the feet take (1 − α) at A + ρ and α at
    B + ρ: force and ZMP are continuous and add up to the total.
    """
    share, own = (phase == mine).astype(float), zmp.copy()
    edges = _edges(phase)
    for k in range(1, len(edges) - 2):
        rows = slice(edges[k], edges[k + 1])
        if phase[edges[k]] != 0:
            continue
        A, B = zmp[edges[k] - 1], zmp[edges[k + 1]]
        AB = B - A
        alpha = np.clip((zmp[rows] - A) @ AB / (AB @ AB), 0.0, 1.0)
        rho = zmp[rows] - A - alpha[:, None] * AB
        if phase[edges[k] - 1] == mine:
            share[rows], own[rows] = 1 - alpha, A + rho
        elif phase[edges[k + 1]] == mine:
            share[rows], own[rows] = alpha, B + rho
    return share, own


# Ground reaction of a planar prediction: time, forward, up, CoP forward.
STO_COLUMNS = ("time", "ground_force_vx", "ground_force_vy", "ground_force_px")


@dataclass(frozen=True)
class Prediction:
    """A prediction of an exoskeleton study, in the sagittal plane.

    `drake-exo predict` and `calibrate` write `NAME_ground_reaction.sto`
    (x forward, y up; `STO_COLUMNS`), the ground reaction of both feet and its
    centre of pressure. Samples are taken evenly, as far apart as most rows.

    Attributes:
        origin_m: Sole's centre in the laboratory.
        share: Part of the force on this foot.
        least_force_n: Samples below are left out at both ends.
    """

    file: str
    origin_m: Vector2
    share: float = quantity(None, 0.5, above=0.0, maximum=1.0)
    least_force_n: float = positive("N", COP_THRESHOLD_N)

    def load(self, root: Path) -> Load:
        """Read the load; `file` is relative to `root`."""
        path = root / self.file
        table = _opensim_columns(path, STO_COLUMNS[1:])
        # A prediction's grid is finer in places; c sums over samples.
        rows = np.stack([table[name] for name in STO_COLUMNS])
        if rows.shape[1] < 2:
            raise InputError(f"{path}: holds one row; give a whole prediction")
        step = np.median(np.diff(rows[0]))
        if np.ptp(rows[0]) > MOST_SAMPLES * step:
            raise InputError(
                f"{path}: most rows are {step:g} s apart over "
                f"{np.ptp(rows[0]):g} s, more than {MOST_SAMPLES} samples; "
                "correct its times"
            )
        even = np.arange(rows[0, 0], rows[0, -1] + 0.5 * step, step)
        t, fx, fz, x = (np.interp(even, rows[0], row) for row in rows)
        keep = _loaded(
            self.share * fz, self.least_force_n,
            f"{path}: a foot never carries {self.least_force_n:g} N; "
            "check the file, share and least_force_n",
        )  # fmt: skip
        zero = np.zeros_like(t)
        force = self.share * np.stack([fx, zero, fz], axis=1)
        zmp = np.stack([x, zero], axis=1)
        load = Load(t[keep], force[keep], zmp[keep], str(path))
        return load.placed(self.origin_m, 0.0)


def _loaded(force: np.ndarray, least_n: float, refusal: str) -> slice:
    """Slice from the first to the last sample that bears `least_n` [N]."""
    loaded = np.flatnonzero(force >= least_n)
    if len(loaded) == 0:
        raise InputError(refusal)
    return slice(loaded[0], loaded[-1] + 1)


def _opensim_columns(path, needed) -> dict[str, np.ndarray]:
    """Time and the columns `needed` of an OpenSim .mot or .sto file."""
    table = read_table(path)
    for name in needed:
        if name not in table.names:
            raise missing_column(str(path), name, table.names)
    found = dict(zip(table.names, table.values.T, strict=True))
    return {"time": table.time, **found}


@dataclass(frozen=True)
class Constant:
    """The same force and ZMP at every sample, 5 ms apart."""

    force_n: Vector3
    zmp_m: Vector2
    samples: int = quantity(None, 1, minimum=1, maximum=MOST_SAMPLES)

    def load(self, root: Path | None = None) -> Load:
        """Make the load; `root` is not used."""
        return Load(
            0.005 * np.arange(self.samples),
            np.tile(np.array(self.force_n, float), (self.samples, 1)),
            np.tile(np.array(self.zmp_m, float), (self.samples, 1)),
            "constant load",
        )


# Reads a step as a `measurement.steps.RecordedStep`, in the foot's frame; takes
# the study's path, trial, foot, start, end, step (from 0), least force [N].
StepReader = Callable
_FILES = (
    "pattern", "one_foot", "csv", "force_plate", "playback", "prediction",
    "constant",
)  # fmt: skip
_OF_RECORDING = (
    "trial", "foot", "begin", "end", "step", "least_force_n", "shift_m",
)  # fmt: skip


@dataclass(frozen=True)
class LoadBlock:
    """Where force and ZMP come from: exactly one source.

    `recording` is a study file; the keys after it say which of its steps.
    """

    pattern: Robot | None = None
    one_foot: OneFoot | None = None
    csv: Csv | None = None
    force_plate: ForcePlate | None = None
    playback: Playback | None = None
    prediction: Prediction | None = None
    constant: Constant | None = None
    recording: str | None = None
    trial: str | None = None
    foot: Literal["left", "right"] | None = None
    begin: float | Literal["heel_strike"] = field(
        default="heel_strike", metadata={"key": "from", "unit": "s"}
    )
    end: float | Literal["toe_off"] = field(
        default="toe_off", metadata={"key": "to", "unit": "s"}
    )
    step: int = quantity(None, 0, minimum=0)
    least_force_n: float = positive("N", COP_THRESHOLD_N)
    shift_m: Vector2 = (0.0, 0.0)
    pose: Literal["free", "measured"] = "free"
    straight: bool = False
    weight: float = positive("", 1.0)

    def __post_init__(self):
        exactly_one(self, (*_FILES, "recording"))
        for name in ("begin", "end"):
            (of,) = (f for f in fields(self) if f.name == name)
            if (value := getattr(self, name)) != of.default:
                check_bounds(of.metadata["key"], value, of.metadata)
        if self.recording is None:
            given = [
                f.metadata.get("key", f.name)
                for f in fields(self)
                if f.name in (*_OF_RECORDING, "pose")
                and getattr(self, f.name) != f.default
            ]
            if given:
                raise InputError(
                    f"{given[0]} belongs to a recording; leave it out here"
                )
        elif self.trial is None or self.foot is None:
            raise InputError("a recording takes trial and foot; give both")
        elif self.straight and self.pose == "measured":
            raise InputError("straight and pose: measured exclude each other")
        elif (
            self.begin != "heel_strike"
            and self.end != "toe_off"
            and self.begin >= self.end
        ):
            raise InputError(
                f"from {self.begin:g} s has to be before to {self.end:g} s"
            )

    @property
    def file(self) -> str | None:
        """Path of the file of forces; None if none, or for a recording."""
        return getattr(self._block, "file", None)

    @property
    def _block(self):
        """The block that is given; None for a recording."""
        return next(filter(None, (getattr(self, n) for n in _FILES)), None)

    def load(self, root: Path, read_step: StepReader | None = None) -> Load:
        """Read the load.

        Args:
            root: Folder that files are relative to.
            read_step: Reader of a recording's step, see `Case.read`.
        """
        if self.recording is not None:
            load = self._recorded(read_step)
        else:
            load = self._block.load(root)
        return load.straight() if self.straight else load

    def _recorded(self, read_step: StepReader | None) -> Load:
        if read_step is None:
            raise InputError(
                f"{self.recording}: a recording is read with the laboratory's "
                "readers; give read_step (the command drake-exo sole does)"
            )
        step = read_step(
            self.recording, self.trial, self.foot, self.begin, self.end,
            self.step, self.least_force_n,
        )  # fmt: skip
        rotation = None
        if self.pose == "measured":
            # Yaw stays as the foot was set down: a sticking sole would answer
            # the markers' noise with moments that no ground bears.
            rotation = without_yaw(step.rotation)
        load = Load(
            step.times, step.force, step.cop, step.name, step.free_moment,
            rotation,
        )  # fmt: skip
        return load.placed(self.shift_m, 0.0)
