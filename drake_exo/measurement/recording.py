"""Read marker and force files: even times, plate offsets, lag of the plates.

The signals returned are unfiltered, unless `FootForces.filtered` is called.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.c3d import read_c3d
from drake_exo.files.opensim import (
    plates_of,
    read_plates,
    read_table,
    read_trc,
)
from drake_exo.files.optitrack import read_markers_csv, read_plate_csv
from drake_exo.files.osim import read_osim
from drake_exo.files.tables import (
    MarkerData,
    PlateRecording,
    between,
    kind_of,
    read_csv_table,
    read_text,
    runs,
    uniform_time,
)
from drake_exo.measurement.filters import check_filterable, resample
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import (
    Filter,
    Laboratory,
    Plates,
    RecordingSettings,
    Standing,
    TrialFiles,
    listed,
    several,
)
from drake_exo.model.assembly import SIDES

_BAND_N = 12.0  # unloaded samples scatter within this around their level
_SMOOTH_S = 0.025  # moving average before that
_SHORTEST_S = 0.1  # shortest unloaded part
_EDGE_S = 0.1  # cut from either end of an unloaded part
_STEP_S = 0.001  # of the lags that are tried
_TREND_SHARE = 0.5  # of the recording: least span of unloaded parts for a drift
# A larger offset is a load. A chair's plate may not have been tared.
LARGEST_FOOT_N = 20.0
LARGEST_CHAIR_N = 200.0


def unloaded(time: np.ndarray, F_z: np.ndarray, largest_n: float):
    """Samples (N,) bool at which a plate bears nothing.

    The lowest steady level of the recording counts as unloaded if it is
    within `largest_n` of zero.

    Args:
        time: (N,) evenly spaced [s].
        F_z: (N,) vertical force [N], unfiltered.
        largest_n: largest level that counts as offset, not as load [N].
    """
    step = time[1] - time[0]
    width = max(round(_SMOOTH_S / step), 1)
    padded = np.pad(F_z, width, mode="edge")
    smooth = np.convolve(padded, np.ones(width) / width, mode="same")
    smooth = smooth[width:-width]
    near = np.abs(smooth - np.quantile(smooth, 0.02)) < _BAND_N
    for start, end in runs(near):
        # At its ends the plate is still, or already, partly loaded.
        cut = round(_EDGE_S / step)
        long = end - start - 2 * cut >= _SHORTEST_S / step
        near[start : start + cut if long else end] = False
        near[end - cut if long else start : end] = False
    if not near.any() or abs(np.median(F_z[near])) > largest_n:
        return np.zeros(len(time), bool)
    return near


def level(
    time: np.ndarray, wrench: np.ndarray, vertical: int, largest_n: float
) -> tuple[np.ndarray, dict]:
    """Remove a plate's offset, and its linear drift if that is visible.

    Args:
        time: (N,) [s].
        wrench: (N, k) components, unfiltered.
        vertical: column of the vertical force [N].
        largest_n: as for `unloaded` [N].

    Returns:
        The levelled wrench, and a report: of F_z offset_n at the start and
        drift_n_s; unloaded_s, the total time without load.
    """
    empty = unloaded(time, wrench[:, vertical], largest_n)
    if not empty.any():
        return wrench, {"unloaded_s": 0.0}
    t = (time - time[0]) / (time[-1] - time[0])
    spans = t[empty].max() - t[empty].min()
    A = np.vander(t, 2 if spans > _TREND_SHARE else 1, increasing=True)
    offset = A @ np.linalg.lstsq(A[empty], wrench[empty], rcond=None)[0]
    first, last = offset[[0, -1], vertical]
    return wrench - offset, {
        "offset_n": float(first),
        "drift_n_s": float((last - first) / (time[-1] - time[0])),
        "unloaded_s": float(empty.sum() * (time[1] - time[0])),
    }


@dataclass(frozen=True)
class FootForces:
    """Plates' wrenches in the sagittal plane, by foot, at their own rate.

    Attributes:
        time: (N,) evenly spaced [s].
        wrenches: of "left" and "right", or "both" for one plate under both
            feet; of "chair" if a plate is under it.
        source: file name.
        levels: "left", ..., "chair" -> offset and drift that were removed.
        recorded: the same -> force [N], moment about the origin [N m] (N, 6):
            forward, left, up, unfiltered, only empty plates subtracted.
    """

    time: np.ndarray
    wrenches: dict[str, PlanarWrench]
    source: str
    levels: dict[str, dict] = field(default_factory=dict)
    recorded: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return (len(self.time) - 1) / (self.time[-1] - self.time[0])

    def filtered(self, settings: Filter) -> "FootForces":
        """The same forces, low-pass filtered."""

        def smooth(_, w):
            values = settings.smooth(w.array, self.rate_hz, self.source)
            return PlanarWrench.of(values)

        return self._by_plate(smooth)

    def delayed(self, delay_s: float) -> "FootForces":
        """The same forces with their clock's lag removed from the times."""
        return replace(self, time=self.time - delay_s)

    def on_belt(self, speed_m_s: float) -> "FootForces":
        """The same forces in axes that move with the treadmill's belt."""
        ahead = speed_m_s * self.time

        def moved(w):
            force, moment = w[:, :3], w[:, 3:].copy()
            moment[:, 1] -= ahead * force[:, 2]
            moment[:, 2] += ahead * force[:, 1]
            return np.hstack([force, moment])

        return replace(
            self._by_plate(lambda _, w: w.shifted(ahead)),
            recorded={name: moved(w) for name, w in self.recorded.items()},
        )

    def held(self, below_n: float) -> "FootForces":
        """Feet's CoP held at small forces, see `PlanarWrench.held`."""
        return self._by_plate(
            lambda name, w: w if name == "chair" else w.held(below_n)
        )

    def without(self, empty: "FootForces") -> "FootForces":
        """The same forces less the means of a recording of empty plates."""
        levels = {}

        def less(name, w):
            zero = empty.wrenches[name]
            force, moment = zero.force.mean(axis=0), zero.moment.mean()
            levels[name] = {"empty_plate_n": float(force[1])}
            return PlanarWrench(w.force - force, w.moment - moment)

        found = self._by_plate(less)
        recorded = {
            name: w - empty.recorded[name].mean(axis=0)
            for name, w in self.recorded.items()
        }
        return replace(found, levels=levels, recorded=recorded)

    def levelled(self, feet: bool) -> "FootForces":
        """The same forces less each plate's offset and drift, see `level`.

        Args:
            feet: whether to level the feet's plates, too. The chair's always
                is, because the chair itself has weight.
        """
        levels = {}

        def flat(name, w):
            if name != "chair" and not feet:
                return w
            largest = LARGEST_CHAIR_N if name == "chair" else LARGEST_FOOT_N
            array, found = level(self.time, w.array, 1, largest)
            levels[name] = {**self.levels.get(name, {}), **found}
            return PlanarWrench.of(array)

        found = self._by_plate(flat)
        return replace(found, levels=self.levels | levels)

    def _by_plate(self, function) -> "FootForces":
        """The same with every wrench replaced by function(name, wrench)."""
        return replace(
            self, wrenches={n: function(n, w) for n, w in self.wrenches.items()}
        )

    @property
    def feet(self) -> dict[str, PlanarWrench]:
        """The wrenches without that of the chair."""
        return {n: w for n, w in self.wrenches.items() if n != "chair"}

    def at(self, time: np.ndarray) -> dict[str, PlanarWrench]:
        """Wrenches at times (n,); beyond the recording those at its ends."""
        time = np.clip(time, self.time[0], self.time[-1])
        return {
            name: PlanarWrench.of(resample(self.time, w.array, time))
            for name, w in self.wrenches.items()
        }

    def total(self, feet: dict[str, PlanarWrench]) -> np.ndarray:
        """Sum of the feet's vertical forces (N,), doubled if only one [N]."""
        total = sum(w.force_z for w in feet.values())
        return 2.0 * total if self.is_one_leg else total

    @property
    def is_one_leg(self) -> bool:
        """Whether only one foot has a plate, which then counts for both."""
        return len(self.feet) == 1 and "both" not in self.wrenches


def _markers_of_c3d(path: Path) -> MarkerData:
    markers = read_c3d(path).markers
    if markers is None:
        raise InputError(f"{path}: holds no markers; give another file")
    return markers


def _plates_of_c3d(path: Path):
    file = read_c3d(path)
    if not file.plates:
        raise InputError(f"{path}: holds no force plate; give another file")
    return file.plate_time, file.plates


def _plates_of_csv(path: Path):
    # A table's first column is its time; Motive's plates begin otherwise.
    if read_text(path).lstrip()[:5].strip('"').lower().startswith("time"):
        table = read_csv_table(path)
        return table.time, plates_of(table)
    return read_plate_csv(path)


_MARKER_READERS = {
    ".trc": read_trc,
    ".c3d": _markers_of_c3d,
    ".csv": read_markers_csv,
}
_FORCE_READERS = {
    ".mot": read_plates,
    ".sto": read_plates,
    ".c3d": _plates_of_c3d,
    ".csv": _plates_of_csv,
}


def _read_plates(
    paths: Sequence[Path],
) -> tuple[np.ndarray, Mapping[int, PlateRecording]]:
    """Even times (N,) [s] and plates of a force file, or of one file each."""
    files = []
    for path in paths:
        read = _FORCE_READERS[kind_of(path, _FORCE_READERS, "a force file")]
        time, recorded = read(path)
        files.append((uniform_time(str(path), time), recorded))
    if len(files) == 1:
        return files[0]
    # Devices begin to stream one after the other.
    start = max(time[0] for time, _ in files)
    end = min(time[-1] for time, _ in files)
    common, joined = None, {}
    for number, (path, (time, recorded)) in enumerate(
        zip(paths, files, strict=True), 1
    ):
        if len(recorded) != 1:
            raise InputError(
                f"{path}: holds {len(recorded)} force plates, but each file "
                "of a list must hold one; give this file alone, or export "
                "each plate by itself"
            )
        slack = 0.25 * (time[1] - time[0])
        inside = between(time, start - slack, end + slack)
        common = time[inside] if common is None else common
        if (
            inside.sum() != len(common)
            or not (np.abs(time[inside] - common) < slack).all()
        ):
            raise InputError(
                f"{path}: is not sampled at the times of {paths[0]}; export "
                "the plates of one recording at one rate"
            )
        (plate,) = recorded.values()
        joined[number] = PlateRecording(
            number,
            plate.force[inside],
            plate.point[inside],
            plate.torque[inside],
        )
    if len(common) < 2:
        raise InputError(
            f"{listed(paths)}: do not overlap in time; give files of the same "
            "recording"
        )
    return common, joined


def read_markers(
    file: Path, settings: RecordingSettings, root: Path
) -> MarkerData:
    """Read a marker file (.trc, .c3d, Motive's .csv) onto an even time base.

    Coordinates of the study's OpenSim model (.mot, .sto) move its markers. A
    model's marker `NAME` may be called `SUBJECT:NAME` in the file.

    Raises:
        InputError: unreadable, of another kind, or uneven in time; too short
            or too slow for the filter.
    """
    path, osim = root / file, settings.assembly.human.osim
    if path.suffix.lower() in (".mot", ".sto"):
        if osim is None:
            raise InputError(
                f"{path}: is not a marker file that can be read; give one of "
                f"{', '.join(_MARKER_READERS)}, or name the OpenSim model "
                "whose coordinates it holds (model.human.osim)"
            )
        data = read_osim(root / osim).markers_along(read_table(path))
    else:
        read = _MARKER_READERS[kind_of(path, _MARKER_READERS, "a marker file")]
        data = read(path)
        if osim is not None and settings.markers is None:
            data = _without_subject(data, read_osim(root / osim).markers)
    time = uniform_time(data.source, data.time, data.rate_hz)
    cutoff_hz = settings.filter.cutoff_hz
    check_filterable(data.source, len(time), data.rate_hz, cutoff_hz)
    return replace(data, time=time)


def _without_subject(data: MarkerData, known: Iterable[str]) -> MarkerData:
    """Markers `SUBJECT:NAME` under the NAME by which a model knows them.

    Those of two subjects keep theirs, since either may be meant.
    """
    plain = [name.rpartition(":")[2] for name in data.names]
    names = tuple(
        short
        if short in known and plain.count(short) == 1 and name not in known
        else name
        for name, short in zip(data.names, plain, strict=True)
    )
    return replace(data, names=names)


def read_foot_forces(
    paths: Path | Sequence[Path],
    plates: Plates,
    laboratory: Laboratory,
    settings: Filter,
    loaded: bool = True,
) -> FootForces:
    """Read the plates under feet and chair from force files, unfiltered.

    Files are .mot, .sto, .c3d, and .csv: a table, or Motive's.

    Args:
        paths: the file, or files of one plate each.
        plates: numbers of the plates; places in the list of files.
        laboratory: axes and signs.
        settings: filter that will be applied later.
        loaded: whether a person stands on the plates; then signs are checked.

    Raises:
        InputError: unreadable, of another kind, or uneven in time; no such
            plate; too short or too slow for the filter; downward forces.
    """
    paths = [paths] if isinstance(paths, Path) else paths
    time, recorded = _read_plates(paths)
    plain = {}
    for foot in (*SIDES, "both", "chair"):
        used = [_plate(paths, recorded, n) for n in plates.of(foot)]
        if used:
            plain[foot] = sum(map(laboratory.on_body, used))
    wrenches = {foot: PlanarWrench.of_spatial(w) for foot, w in plain.items()}
    forces = FootForces(time, wrenches, listed(paths), recorded=plain)
    check_filterable(
        forces.source, len(time), forces.rate_hz, settings.cutoff_hz
    )
    if loaded:
        _check_direction(forces, laboratory)
    return forces


def plates_under(
    paths: Sequence[Path], numbers: tuple[int, ...]
) -> tuple[np.ndarray, list[PlateRecording]]:
    """Even times (N,) [s] of force files, and some of their plates.

    Raises:
        InputError: unreadable, of another kind, uneven in time, no such plate.
    """
    time, recorded = _read_plates(paths)
    return time, [_plate(paths, recorded, n) for n in numbers]


def _plate(paths, recorded: Mapping[int, PlateRecording], number: int):
    if number in recorded:
        return recorded[number]
    numbers = ", ".join(map(str, recorded))
    raise InputError(
        f"{listed(paths)}: has no force plate {number}; it holds plates "
        f"{numbers}"
    )


def _check_direction(forces: FootForces, laboratory: Laboratory) -> None:
    """Refuse forces that point down: those on the body point up."""
    F_z = forces.total(forces.feet)
    if -F_z.min() > max(F_z.max(), 50.0):
        on = "body" if laboratory.forces_act_on == "plate" else "plate"
        raise InputError(
            f"{forces.source}: the vertical force reaches {F_z.min():.0f} N, "
            f"downwards; say 'forces_act_on: {on}' in laboratory if these "
            f"are the forces on the {on}, or correct force_axes"
        )


def read_feet(
    files: TrialFiles | Standing,
    laboratory: Laboratory,
    settings: Filter,
    root: Path,
) -> FootForces:
    """Read the forces of a trial's plates and level them as the study says.

    Raises:
        InputError: as `read_foot_forces`.
    """
    forces = read_foot_forces(
        several(files.forces, root), files.plates, laboratory, settings
    )
    if files.empty_plates is not None:
        empty = read_foot_forces(
            several(files.empty_plates, root),
            files.plates,
            laboratory,
            settings,
            loaded=False,
        )
        check_empty(empty.source, empty.recorded.values())
        forces = forces.without(empty)
    return forces.levelled(laboratory.remove_plate_drift)


def check_empty(source: object, wrenches: Iterable[np.ndarray]) -> None:
    """Refuse a recording of empty plates (N, 6) that are not empty.

    Raises:
        InputError: together they bear more than 200 N on average.
    """
    borne = sum(float(w[:, 2].mean()) for w in wrenches)
    if abs(borne) > _LARGEST_EMPTY_N:
        raise InputError(
            f"{source}: empty_plates bear {borne:.0f} N; name a recording of "
            "the plates with nothing on them, or leave the key out"
        )


# Largest offset of amplifiers; beyond it somebody stands on the plates.
_LARGEST_EMPTY_N = 200.0
# Of body weight; if plates bear less, numbers or units are wrong.
_LEAST_LOAD = 0.1


def check_loaded(
    source: str, wrench: PlanarWrench, weight: float, where: str
) -> None:
    """Refuse feet that never bear 10 % of body weight.

    Args:
        source: file name.
        wrench: of both feet in the used part.
        weight: of the body [N].
        where: name of that part, for the message.

    Raises:
        InputError: they do not; with the likely cause.
    """
    most = float(wrench.force_z.max())
    if most > _LEAST_LOAD * weight:
        return
    cause = (
        "check the numbers in plates, laboratory.force_axes, the unit of "
        "force (N, not kN), subject.mass_kg, a device's masses and the part "
        "that is used"
    )
    raise InputError(
        f"{source}: the feet bear {most:.4g} N at most ({where}), but the body "
        f"weighs {weight:.0f} N; {cause}"
    )


def force_delay(
    time: np.ndarray,
    needed: np.ndarray,
    force: np.ndarray,
    used: np.ndarray,
    reach_s: float = 0.05,
) -> float:
    """Estimate the lag of the recorded force behind the motion [s].

    Systems started by hand, or filtered on the way, are milliseconds apart; in
    a fast rise 10 ms are tens of newtons.

    Args:
        time: (N,) evenly spaced [s].
        needed: (N,) m (a_com + g) of the filtered motion [N].
        force: (N,) filtered vertical force of feet and chair [N].
        used: (N,) bool, where feet and chair alone bear the body.
        reach_s: largest delay either way.

    Returns:
        The delay, to 1 ms, with the least mean absolute deviation of needed
        less recorded force from its median. Squares would be dominated by the
        ends of a walk, where the other foot bears weight beside the plates.
    """
    count = round(reach_s / _STEP_S)
    delays = _STEP_S * np.arange(-count, count + 1)
    at = time[used] + delays[:, None]
    off = needed[used] - np.interp(at, time, force)
    spread = np.abs(off - np.median(off, axis=1, keepdims=True)).mean(axis=1)
    return round(float(delays[int(np.argmin(spread))]), 6)


def common_time(
    markers: MarkerData, forces: FootForces, settings: Filter
) -> np.ndarray:
    """Marker times (N,) at which forces were recorded, too.

    Raises:
        InputError: the files do not overlap, or too briefly for the filter.
    """
    inside = between(markers.time, forces.time[0], forces.time[-1])
    if not inside.any():
        raise InputError(
            f"{forces.source}: forces ({_span(forces.time)}) and markers "
            f"({_span(markers.time)}, {markers.source}) do not overlap in "
            "time; give files of the same recording, or correct "
            "laboratory.force_delay_s, taken off here"
        )
    time = markers.time[inside]
    check_filterable(
        f"{markers.source} together with {forces.source}",
        len(time),
        markers.rate_hz,
        settings.cutoff_hz,
    )
    return np.clip(time, forces.time[0], forces.time[-1])


def _span(time: np.ndarray) -> str:
    return f"{time[0]:g} to {time[-1]:g} s"
