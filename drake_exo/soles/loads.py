"""Loads: desired force and ZMP of one foot over one or more contact phases.

They are in the sole's world frame: x forward, y left, z up, the origin below
the sole frame's origin as the foot is set down. `load_blocks.py` reads them
from files.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from drake_exo.errors import InputError
from drake_exo.files.tables import (
    check_names,
    comma_separated,
    number_rows,
    read_text,
    shown,
)
from drake_exo.soles.contact.law import FLAT, Ground
from drake_exo.soles.contact.newton import Target
from drake_exo.soles.numerics import rotation_z

_PAUSE_S = 0.2  # between loads that are joined
_FAR_M = 10.0  # off the sole: no laboratory's ZMP in metres
MOST_SAMPLES = 100_000  # of a load; each is a system to solve
# Shape of a sample's part of each array.
_SHAPES = {
    "times": (), "force": (3,), "zmp": (2,), "free_moment": (),
    "rotation": (3, 3), "moment_cut": (),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Load:
    """Force and ZMP of one foot at N samples; its arrays are read-only.

    >>> import drake_exo as dx
    >>> load = dx.soles.Load([0.0, 0.1], [[0, 0, 300.0]] * 2, [[0.0, 0.01]] * 2)
    >>> load.straight().zmp
    array([[0., 0.],
           [0., 0.]])
    >>> load.every(1).times
    array([0.])

    To put another load into a case, use `dataclasses.replace`:

    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> twice = replace(case.load, force=2.0 * case.load.force)
    >>> replace(case, load=twice).load.force[0]
    array([ 20.,   0., 800.])

    Raises:
        InputError: Samples are missing, not finite or of another shape; time
            does not increase; a vertical force is not above 0; or there is not
            one weight above 0 for each phase.

    Attributes:
        times: Times of the samples [s], (N,), strictly increasing.
        force: Force of the ground on the sole in the world frame [N], (N, 3).
        zmp: Zero-moment point on the ground in the world frame [m], (N, 2).
        name: Where the load came from, for messages.
        free_moment: Moment about the vertical through the ZMP [N·m], (N,);
            None means zero.
        rotation: Measured orientation of the sole, (N, 3, 3); the simulation
            then follows it and the force, not the ZMP. None means that the
            orientation follows from the ZMP.
        moment_cut: 1 where the free moment was cut to what friction bears,
            see `bearable`, and 0 elsewhere, (N,); None means nowhere.
        begins: Samples at which the foot is set down anew; the first is 0.
        weights: Weights in the cost of the contact phases that begin there.
    """

    times: np.ndarray
    force: np.ndarray
    zmp: np.ndarray
    name: str = "load"
    free_moment: np.ndarray | None = None
    rotation: np.ndarray | None = None
    moment_cut: np.ndarray | None = None
    begins: tuple[int, ...] = (0,)
    weights: tuple[float, ...] = (1.0,)

    def __repr__(self) -> str:
        # As Step's.
        return (
            f"Load({self.name!r}, {len(self.times)} samples, up to "
            f"{self.force[:, 2].max():.1f} N vertically)"
        )

    def __post_init__(self):
        for label, shape in _SHAPES.items():
            if (given := getattr(self, label)) is None:
                continue
            try:
                values = np.array(given, dtype=float)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{self.name}: {label} holds no numbers, or rows of "
                    "different lengths; give an array of them"
                ) from error
            values.flags.writeable = False
            object.__setattr__(self, label, values)
            if values.shape != (np.size(self.times), *shape):
                raise InputError(
                    f"{self.name}: {label} has the shape {values.shape}, for "
                    f"{np.size(self.times)} times it has to be "
                    f"{(np.size(self.times), *shape)}"
                )
            # Where a pose is not measured, it is NaN.
            if label != "rotation" and not np.isfinite(values).all():
                raise InputError(
                    f"{self.name}: {label} holds NaN or infinity; clean the "
                    "recording"
                )
        if self.rotation is not None:
            square = self.rotation @ self.rotation.transpose(0, 2, 1)
            mirrors = np.linalg.det(np.nan_to_num(self.rotation)) < 0
            if (np.abs(square - np.eye(3)) > 1e-6).any() or mirrors.any():
                raise InputError(
                    f"{self.name}: rotation holds matrices that are not "
                    "rotations; give rotation matrices"
                )
        if len(self.times) == 0:
            raise InputError(f"{self.name}: no samples; widen the window")
        begins = np.array([*self.begins, len(self.times)])
        if begins[0] != 0 or (np.diff(begins) <= 0).any():
            raise InputError(
                f"{self.name}: begins is {self.begins}; give increasing "
                f"numbers of samples, from 0, below {len(self.times)}"
            )
        weights = np.array(self.weights, dtype=float)
        sound = np.isfinite(weights) & (weights > 0.0)
        if len(weights) != len(self.begins) or not sound.all():
            raise InputError(
                f"{self.name}: weights are {self.weights}; give one above 0 "
                f"for each of {len(self.begins)} contact phases"
            )
        if (count := len(self.times)) > MOST_SAMPLES:
            raise InputError(
                f"{self.name}: {count} samples, more than {MOST_SAMPLES}; "
                "give fewer, 0.005 s apart for a step"
            )
        step = np.diff(self.times)
        if (step <= 0).any():
            first = int(np.argmax(step <= 0))
            what, remedy = "time runs backwards", "sort the rows by time"
            if step[first] == 0:
                what = "two samples at one time"
                remedy = "remove the repeated rows"
            raise InputError(
                f"{self.name}: {what} ({self.times[first + 1]:g} s); {remedy}"
            )
        low = self.force[:, 2] <= 0
        if low.any():
            first = int(np.argmax(low))
            raise InputError(
                f"{self.name}: the vertical force is "
                f"{self.force[first, 2]:g} N at {self.times[first]:g} s; it "
                "must be above 0 at every sample, so "
                + (
                    "turn all signs: forces are those of the ground on the "
                    "sole; or, where z points down, those of force y and z and "
                    "of zmp y alone: y is left, z up"
                    if np.median(self.force[:, 2]) < 0.0
                    else "leave the swing phase out, and give each contact "
                    "a load of its own"
                )
            )

    def straight(self) -> "Load":
        """The load without sideways ZMP, sideways force and free moment."""
        return replace(
            self,
            force=self.force * [1.0, 0.0, 1.0],
            zmp=self.zmp * [1.0, 0.0],
            free_moment=None,
            moment_cut=None,
        )

    def placed(self, origin, yaw: float) -> "Load":
        """The load in the frame of a foot at `origin` [m] (2,), yaw in rad."""
        turn = rotation_z(-yaw)
        return replace(
            self,
            force=self.force @ turn.T,
            zmp=(self.zmp - np.asarray(origin)) @ turn[:2, :2].T,
            rotation=None if self.rotation is None else turn @ self.rotation,
        )

    def every(self, count: int) -> "Load":
        """The load at `count` (or fewer) of its samples, evenly spread."""
        index = np.unique(
            np.round(np.linspace(0, len(self.times) - 1, count)).astype(int)
        )
        return self.at(index)

    def at(self, index: np.ndarray) -> "Load":
        """The load at some of its samples, given by increasing indices."""
        left, begins = np.unique(self.phase[index], return_index=True)
        arrays = {name: getattr(self, name) for name in _SHAPES}
        return replace(
            self,
            **{n: x[index] for n, x in arrays.items() if x is not None},
            begins=tuple(map(int, begins)),
            weights=tuple(self.weights[k] for k in left),
        )

    @property
    def phase(self) -> np.ndarray:
        """Number of the contact phase that a sample belongs to, (N,)."""
        numbers = np.zeros(len(self.times), dtype=int)
        numbers[list(self.begins[1:])] = 1
        return np.cumsum(numbers)

    @property
    def phases(self) -> list[slice]:
        """Slices of the samples, one for every contact phase."""
        ends = (*self.begins[1:], len(self.times))
        return [slice(a, b) for a, b in zip(self.begins, ends, strict=True)]

    @property
    def shares(self) -> np.ndarray:
        """Weights of the phases over their sum, (K,)."""
        return np.array(self.weights) / np.sum(self.weights)

    @classmethod
    def one_after_another(cls, loads, weights) -> "Load":
        """Join loads of one foot; each begins 0.2 s after the one before.

        >>> import drake_exo as dx
        >>> force, zmp = [[0, 0, 300.0]] * 2, [[0.0, 0.01]] * 2
        >>> step = dx.soles.Load([0.0, 0.1], force, zmp)
        >>> both = dx.soles.Load.one_after_another([step, step], [1, 2])
        >>> both.times, both.begins, both.shares
        (array([0. , 0.1, 0.3, 0.4]), (0, 2), array([0.33333333, 0.66666667]))

        Args:
            loads: The loads to join.
            weights: The weight of each load in the cost; a load of several
                phases divides it among them as before.

        Raises:
            InputError: There are no loads, or not as many weights.
        """
        loads, weights, shifted = list(loads), list(weights), []
        if not loads or len(loads) != len(weights):
            raise InputError(
                f"there are {len(loads)} loads and {len(weights)} weights; "
                "give at least one load, and a weight for each"
            )
        for load in loads:
            if shifted:
                end = shifted[-1].times[-1]
                shift = end + _PAUSE_S - load.times[0]
                load = replace(load, times=load.times + shift)
            shifted.append(load)
        first = np.cumsum([0, *(len(load.times) for load in loads[:-1])])
        each = list(zip(loads, first, weights, strict=True))
        return cls(
            **{name: _joined(shifted, name) for name in _SHAPES},
            name="; ".join(load.name for load in loads),
            begins=tuple(
                int(n + k) for load, n, _ in each for k in load.begins
            ),
            weights=tuple(
                float(w * s) for load, _, w in each for s in load.shares
            ),
        )

    def target(self, q: int, reference, ground: Ground = FLAT) -> Target:
        """What a simulation must reach at sample q, counted from 0.

        `reference` is the nodes' places at the sample before [m], (m, 3), or at
        the first sample of a phase a `Start`.
        """
        return Target(
            self.force[q],
            self.zmp[q],
            reference,
            0.0 if self.free_moment is None else float(self.free_moment[q]),
            self.rotation[q] if self.is_measured[q] else None,
            float(ground.height(self.zmp[q : q + 1])[0]),
        )

    @property
    def is_measured(self) -> np.ndarray:
        """Which samples have a prescribed pose, (N,) bool."""
        if self.rotation is None:
            return np.zeros(len(self.times), dtype=bool)
        return np.isfinite(self.rotation).all(axis=(1, 2))

    def check_friction(self, friction: float, up) -> None:
        """Refuse a force that no sole can carry without slipping away.

        Args:
            friction: Coulomb's coefficient μ.
            up: Normal of the plane that fits the ground, (3,).

        Raises:
            InputError: A force leaves the friction cone; names the first.
        """
        asked = self.friction_used(up)
        beyond = asked >= friction
        if beyond.any():
            q = int(np.argmax(beyond))
            raise InputError(
                f"{self.name}: the force at {self.times[q]:g} s asks for a "
                f"friction of {asked[q]:.3f} (force along the ground over "
                f"force across it; {beyond.sum()} of {len(beyond)} samples), "
                f"but contact.friction is {friction:g}: the sole slips away; "
                "leave these samples out (least_force_n, from, to; in a "
                "pattern least_share), or give a larger contact.friction"
            )

    def check_pressed(self, force: float) -> None:
        """Refuse an upward force of `force` [N] or more, for its unit.

        Raises:
            InputError: There is such a force; names the largest.
        """
        q = int(np.argmax(self.force[:, 2]))
        most = float(self.force[q, 2])
        if most >= force:
            raise InputError(
                f"{self.name}: the vertical force is {most:g} N at "
                f"{self.times[q]:g} s; {force:.3g} N would press the whole "
                "sole flat: check material.youngs_modulus_pa and the "
                "load's units (forces are in N, not mN)"
            )

    def bearable(self, friction: float, width: float, up) -> "Load":
        """The load with its free moments cut to what friction can bear.

        A line of contact across the sole, `width` w [m] long and evenly loaded
        by F_n, begins to turn about the ground's normal `up` (3,) at the moment
        (μ F_n − |F_t|) w / 4. At small loads plates and their filters report
        more than any ground bears.
        """
        if self.free_moment is None:
            return self
        across, along = self._on_ground(up)
        most = np.maximum(friction * across - along, 0.0) * width / 4 / up[2]
        cut = np.abs(self.free_moment) > most
        moment = np.clip(self.free_moment, -most, most)
        return replace(self, free_moment=moment, moment_cut=cut)

    @property
    def moments_cut(self) -> int:
        """Number of samples whose free moment was cut, see `bearable`."""
        return 0 if self.moment_cut is None else int(self.moment_cut.sum())

    @property
    def largest_force(self) -> float:
        """Largest |F| [N]."""
        return float(np.linalg.norm(self.force, axis=1).max())

    def friction_used(self, up) -> np.ndarray:
        """Tangential over normal force on a ground of normal `up`, (N,)."""
        across, along = self._on_ground(up)
        return np.where(across > 0, along / across, np.inf)

    def _on_ground(self, up) -> tuple[np.ndarray, np.ndarray]:
        """Normal and tangential force on a ground of normal `up` [N], (N,)."""
        across = self.force @ up
        return across, np.linalg.norm(self.force - np.outer(across, up), axis=1)

    def check_inside(self, places: np.ndarray) -> None:
        """Refuse a ZMP outside the sole's outline, unless poses are measured.

        Args:
            places: Places on the ground of the sole's nodes as it is set down
                level [m], (m, 2).

        Raises:
            InputError: The ZMP leaves the outline; names the first sample.
        """
        hull = ConvexHull(places)
        distance = (
            self.zmp @ hull.equations[:, :2].T + hull.equations[:, 2]
        ).max(axis=1)
        outside = (distance > 1e-9) & ~self.is_measured
        if outside.any():
            q = int(np.argmax(outside))
            x, y = self.zmp[q]
            spans = (self.zmp, places)
            off = np.subtract(*(s.min(axis=0) + s.max(axis=0) for s in spans))
            front = "in front" if off[0] >= 0 else "behind"
            left = "left" if off[1] >= 0 else "right"
            most = self.force[outside, 2].max()
            unit = ""
            if distance[outside].max() > _FAR_M:
                unit = "; the ZMP is in m, not mm"
            raise InputError(
                f"{self.name}: the ZMP is outside the sole by "
                f"{1e3 * distance[q]:.1f} mm at {self.times[q]:g} s (x {x:.4f} "
                f"m, y {y:.4f} m in the load's frame, {outside.sum()} of "
                f"{len(outside)} samples{unit}; {most:.3g} N at most there); "
                "the middle of its path lies "
                f"{abs(500 * off[0]):.0f} mm {front} and "
                f"{abs(500 * off[1]):.0f} mm to the {left} of the sole's: move "
                "the load (by its origin_m and yaw_rad, shift_m, "
                "ankle_to_centre_m, zmp_m or the pattern's bounds), the sole's "
                "frame (mesh.origin_m) or the block start, take a larger sole, "
                "or leave these samples out (least_force_n, from, to; in a "
                "pattern least_share)"
            )


def _joined(loads, name: str) -> np.ndarray | None:
    """Join an array of all loads, filled where missing; None if none has it."""
    parts = [getattr(load, name) for load in loads]
    if all(part is None for part in parts):
        return None
    fill = np.nan if name == "rotation" else 0.0
    return np.concatenate(
        [
            np.full((len(load.times), *_SHAPES[name]), fill) if x is None else x
            for load, x in zip(loads, parts, strict=True)
        ]
    )


CSV_COLUMNS = ("time_s", "force_x_n", "force_y_n", "force_z_n",
               "zmp_x_m", "zmp_y_m")  # fmt: skip


def read_csv(path) -> Load:
    """Read a load from a CSV file whose header names `CSV_COLUMNS`.

    Further columns may be free_moment_nm, and for several contact phases load
    (0, 1, ...) and weight.
    """
    used = (*CSV_COLUMNS, "free_moment_nm", "load", "weight")
    table = read_columns(path, CSV_COLUMNS, used)
    for name in table:
        meant = name.lower()
        if meant.startswith("free_moment"):
            meant = "free_moment_nm"
        if meant in used and name not in used:
            unit = ", in N·m" if meant == "free_moment_nm" else ""
            raise InputError(
                f"{path}:1: column {shown(name)!r} would not be read; name it "
                f"{meant}{unit}"
            )
    t, fx, fy, fz, zx, zy = (table[name] for name in CSV_COLUMNS)
    begins, weights = np.zeros(1, int), np.ones(1)
    if "weight" in table and "load" not in table:
        raise InputError(
            f"{path}:1: column 'weight' is of several loads and would not be "
            "used; number them in a column 'load', or rename it"
        )
    if "load" in table:
        number, weight = table["load"], table.get("weight", np.ones(len(t)))
        counts = np.isin(np.diff(number), (0, 1)).all()
        if (number[:1] != 0).any() or not counts:
            raise InputError(
                f"{path}: column 'load' has to count from 0 on, each number "
                "in rows that follow one another"
            )
        _, begins, phase = np.unique(
            number, return_index=True, return_inverse=True
        )
        weights = weight[begins]
        if not ((weight > 0) & (weight == weights[phase])).all():
            raise InputError(
                f"{path}: column 'weight' has to be above 0, and the same in "
                "all rows of a load"
            )
        for k in begins[1:]:  # a phase may have a clock of its own
            if t[k] <= t[k - 1]:
                t[k:] += t[k - 1] + _PAUSE_S - t[k]
    return Load(
        t,
        np.stack([fx, fy, fz], 1),
        np.stack([zx, zy], 1),
        str(path),
        table.get("free_moment_nm"),
        begins=tuple(map(int, begins)),
        weights=tuple(map(float, weights)),
    )


def read_columns(
    path, needed, used=None, may_be_empty: bool = False
) -> dict[str, np.ndarray]:
    """Columns of a CSV file by the names in its first line, (N,) each.

    Args:
        path: The file.
        needed: Names that it must have, in any order, among others.
        used: Names of columns that must have no gaps; all by default.
        may_be_empty: Allow a file without rows (of a run without steps).

    Raises:
        InputError: It cannot be read, a name is missing, or a row is damaged.
    """
    head, *lines = text_lines(path) or [""]
    names = [name.strip() for name in comma_separated(path, head)]
    missing = [name for name in needed if name not in names]
    if missing:
        raise InputError(
            f"{path}:1: column {missing[0]!r} is missing; the header must "
            f"name {', '.join(needed)}"
        )
    check_names(path, 1, names)
    if not lines and may_be_empty:
        return {name: np.zeros(0) for name in names}
    whole = [k for k, n in enumerate(names) if used is None or n in used]
    table = numbers_of(path, lines, 2, len(names), ",", whole)
    return dict(zip(names, table.T, strict=True))


def text_lines(path) -> list[str]:
    """Read the lines of a load's text file."""
    return read_text(
        path, "check path and data_root (--data-root)"
    ).splitlines()


def numbers_of(
    path, lines, first: int, columns: int, separator=None, whole=...
) -> np.ndarray:
    """Numbers (rows, columns) of `lines`, empty ones left out.

    `first` is the number of the first line, for messages; columns `whole` must
    have no gaps.
    """
    rows = [
        (number, line.split(separator))
        for number, line in enumerate(lines, first)
        if line.strip()
    ]
    values = number_rows(path, rows, columns)
    bad = np.flatnonzero(~np.isfinite(values[:, whole]).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}:{rows[bad[0]][0]}: a number is missing or NaN here "
            f"({len(bad)} such rows); clean the recording"
        )
    return values
