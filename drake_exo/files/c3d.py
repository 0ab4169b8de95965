"""Read C3D files: markers, force plates of types 1 to 4, analog channels.

ezc3d decodes the file in a process of its own (`c3d_child.py`), since damaged
files make it crash, hang or exhaust the memory. Two things that it does not
tell are found here: whether a file is truncated (it returns the frames that
are left, and corrects the header's count), and what the signals of a plate
mean. Its own plate analysis ignores units, requires a calibration matrix for
types that have none, and turns the moments of type 1.

A plate's frame comes from its corners (The C3D File Format, FORCE_PLATFORM
group): x from corner 2 to 1, y from corner 4 to 1, z = x × y, which points
down for a plate in the floor. ORIGIN is the vector from the origin of the
plate's signals to the middle of its surface, so its z is negative; a positive
z is a common mistake in files, and is corrected.

    type 1: F, point of application from the middle, free moment
    type 2: F and M about the signals' origin
    type 3: eight channels of four piezoelectric sensors
    type 4: as type 2, after the calibration matrix

`write_c3d` writes markers and plates of type 2.
"""

import io
import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError, first_line, printable
from drake_exo.files.output import Progress, read_bytes
from drake_exo.files.tables import (
    LENGTHS,
    MarkerData,
    PlateRecording,
    Table,
    kept,
    plate_axes,
    without_zeros,
)

_CHILD = Path(__file__).with_name("c3d_child.py")
_FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e-3}
_MOMENTS = {"nm": 1.0, "ncm": 1e-2, "nmm": 1e-3}
_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}  # plate type -> number of channels
_MOST_PLATES = 64
_SIDES = 0.05, 20.0  # least and largest side of a plate [m]
_FARTHEST = 1e9  # largest marker coordinate, in any unit
_LARGEST = 1e30  # largest plate signal or calibration entry, in any unit


@dataclass(frozen=True)
class C3d:
    """Contents of a C3D file.

    Attributes:
        markers: None if the file has none.
        plates: number from 1 -> force plate in the file's axes, forces on
            the body. An unreadable plate raises InputError on access.
        plate_time: (N,) of the plates' samples [s].
        analog: all analog channels; None if the file has none.
    """

    markers: MarkerData | None
    plates: Mapping[int, PlateRecording]
    plate_time: np.ndarray
    analog: Table | None


def read_c3d(path: str | Path) -> C3d:
    """Read a C3D file; time starts at zero with its first frame.

    Raises:
        InputError: unreadable or truncated file, unknown units. A plate that
            lacks corners or channels, or has another type: see `C3d`.
    """
    path = Path(path)
    file = decode(path)
    markers = _markers(path, file)
    analog = _analog(path, file)
    used = file.numbers("FORCE_PLATFORM", "USED")
    count = 0 if used is None else int(np.clip(used.flat[0], 0, _MOST_PLATES))
    return C3d(
        markers=markers,
        plates=_Plates(count, path, file, analog),
        plate_time=np.zeros(0) if analog is None else analog.time,
        analog=analog,
    )


class _Plates(Mapping):
    """Number -> plate of a file; each is decoded on access."""

    def __init__(self, count: int, *of):
        self._numbers, self._of = range(1, count + 1), of

    def __getitem__(self, number: int) -> PlateRecording:
        if number not in self._numbers:
            raise KeyError(number)
        return _Plate(number, *self._of).recording()

    def __iter__(self):
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)


@dataclass(frozen=True)
class C3dContents:
    """Parameters and data of a C3D file, without interpretation.

    Attributes:
        parameters: group -> name -> numbers (in the file's dimensions) or a
            list of texts.
        points: (N, M, 3) in the file's unit; NaN where not seen.
        rate_hz: frames of the points per second.
        analogs: (N k, C) channels, scaled by ezc3d.
        analog_rate_hz: samples of the channels per second, k times `rate_hz`.
    """

    parameters: dict[str, dict[str, np.ndarray | list[str]]]
    points: np.ndarray
    rate_hz: float
    analogs: np.ndarray
    analog_rate_hz: float

    def numbers(self, group: str, name: str) -> np.ndarray | None:
        """A numeric parameter; None if it is absent, empty or text."""
        value = self.parameters.get(group, {}).get(name)
        if not isinstance(value, np.ndarray) or value.size == 0:
            return None
        return value.astype(float)

    def texts(self, group: str, name: str) -> list[str]:
        """Text entries of a parameter and its continuations (LABELS2, ...)."""
        found = []
        for suffix in ("", *range(2, 10)):
            value = self.parameters.get(group, {}).get(f"{name}{suffix}")
            found += value if isinstance(value, list) else []
        return found


@kept(2)  # a trial and the empty plates
def decode(path: Path) -> C3dContents:
    """Decode a C3D file in a process of its own.

    Raises:
        InputError: the file cannot be read, is not C3D, is truncated or
            damaged, or has more than 65535 frames that ezc3d cannot read.
    """
    is_long = _check_complete(path)
    code, out, said = _run_child(path)
    if code:
        what = first_line(said.decode("utf-8", "replace")) if code == 1 else ""
        raise _damaged(path, what or "its parts contradict each other")
    with np.load(io.BytesIO(out), allow_pickle=False) as found:
        arrays = {name: found[name] for name in found.files}
    for array in arrays.values():
        array.flags.writeable = False
    if is_long and len(arrays["points"]) <= _LONG:
        raise InputError(
            f"{path}: holds more than {_LONG} frames, and the others cannot be "
            "read; export the movement alone, or .trc and .mot"
        )
    if (np.abs(arrays["points"]) > _FARTHEST).any():
        raise _damaged(path, "a marker is out of all bounds")
    rate, analog_rate = arrays["rates"]
    if not 0.0 < rate < 1e6:
        raise InputError(f"{path}: says no frame rate; correct POINT:RATE")
    parameters: dict[str, dict] = {}
    for i, (group, name) in enumerate(json.loads(str(arrays["names"]))):
        value = arrays[f"parameter_{i}"]
        if value.dtype.kind == "U":
            value = [printable(text.strip()) for text in value.ravel()]
        parameters.setdefault(group, {})[name] = value
    return C3dContents(
        parameters,
        arrays["points"],
        float(rate),
        arrays["analogs"],
        float(analog_rate),
    )


def _run_child(path: Path) -> tuple[int, bytes, bytes]:
    """Exit code and outputs of the process; prints progress if it is long."""
    progress = Progress(f"reading {path.name}")
    command = [sys.executable, str(_CHILD), str(path.absolute())]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe) as child:
        while True:
            try:
                out, said = child.communicate(timeout=0.1)
                return child.returncode, out, said
            except subprocess.TimeoutExpired:
                progress.update("decoding")
            except BaseException:
                child.kill()
                raise


_BLOCK = 512  # bytes
_INTEL, _DEC, _MIPS = 84, 85, 86
_LONG = 0xFFFF  # last frame in the header if there are more than it can count


def _check_complete(path: Path) -> bool:
    """Refuse a file shorter than its header announces.

    Returns:
        Whether there are more frames than a header can count.
    """
    data = read_bytes(path)
    if len(data) < 2 * _BLOCK or data[1] != 0x50:
        raise InputError(f"{path}: is not a C3D file; check the path")
    processor = data[max(data[0] - 1, 0) * _BLOCK + 3 :][:1]
    if not processor:
        raise _truncated(path)
    if processor[0] not in (_INTEL, _DEC, _MIPS):
        raise _damaged(path, "names no processor type")
    if processor[0] == _MIPS:  # which ezc3d does not read
        raise InputError(
            f"{path}: holds numbers of a MIPS processor, which cannot be "
            "read; save it with those of a PC (Intel)"
        )
    words = np.frombuffer(data[:24], "<u2").astype(int)
    points, analogs, first, last, start = words[[1, 2, 3, 4, 8]]
    # Sign of the scale: if negative, numbers are 4-byte reals.
    sign = words[7] if processor[0] == _INTEL else words[6]
    size = (4 * points + analogs) * (4 if sign >> 15 else 2)
    beyond = len(data) - (start - 1) * _BLOCK - (last - first + 1) * size
    if last == _LONG:
        return beyond >= _BLOCK
    if beyond < 0:
        raise _truncated(path)
    # Some writers let the 16-bit count of frames overflow instead.
    return size > 0 and beyond >= (_LONG + 1) * size


def _truncated(path) -> InputError:
    return InputError(
        f"{path}: ends before its last frame; the file is truncated, copy or "
        "export it again"
    )


def _damaged(path, what: str) -> InputError:
    return InputError(f"{path}: is damaged ({what}); copy or export it again")


def _markers(path, file: C3dContents) -> MarkerData | None:
    p = file.points
    if p.size == 0:
        return None
    p = _point_unit(path, file) * p
    return MarkerData(
        time=np.arange(len(p)) / file.rate_hz,
        names=_unique(file.texts("POINT", "LABELS"), p.shape[1], "marker"),
        positions=without_zeros(p),
        rate_hz=file.rate_hz,
        source=str(path),
    )


def _analog(path, file: C3dContents) -> Table | None:
    if file.analogs.size == 0:
        return None
    values = _scaled(path, file)
    names = _unique(file.texts("ANALOG", "LABELS"), values.shape[1], "channel")
    units = file.texts("ANALOG", "UNITS")
    units += [""] * (len(names) - len(units))
    return Table(
        time=np.arange(len(values)) / file.analog_rate_hz,
        names=names,
        values=values,
        source=str(path),
        units=tuple(units[: len(names)]),
    )


def _scaled(path, file: C3dContents) -> np.ndarray:
    """Analog signals (N, C): (counts - OFFSET) times scales, in their units.

    Corrects ezc3d, which uses the magnitude of OFFSET, and reads unsigned
    counts as signed ones: large counts come out 65 536 too low.
    """
    values = file.analogs
    scale, told = (_by_channel(path, file, n) for n in ("SCALE", "OFFSET"))
    whole = file.numbers("ANALOG", "GEN_SCALE")
    one = scale if whole is None else whole.flat[0] * scale
    is_unsigned = file.texts("ANALOG", "FORMAT")[:1] == ["UNSIGNED"]
    offset = np.mod(told, 65536.0) if is_unsigned else told
    with np.errstate(invalid="ignore"):  # a scale may be NaN
        values = values + one * (np.abs(told) - offset)
    real = file.numbers("POINT", "SCALE")
    if not is_unsigned or (real is not None and real.flat[0] < 0.0):
        return values
    is_low = np.sign(one) * (values + offset * one) < -0.5 * np.abs(one)
    return values + 65536.0 * one * is_low


def _by_channel(path, file: C3dContents, name: str) -> np.ndarray:
    """A parameter of ANALOG (C,), one number per channel, all continuations."""
    found = [file.numbers("ANALOG", f"{name}{i}") for i in ("", *range(2, 10))]
    number = np.concatenate(
        [np.ravel(x) for x in found if x is not None] or [[]]
    )
    count = file.analogs.shape[1]
    if len(number) < count:
        raise InputError(
            f"{path}: ANALOG:{name} holds {len(number)} of {count} channels' "
            "numbers; export it again"
        )
    return number[:count]


def _unique(names: list[str], count: int, prefix: str) -> tuple[str, ...]:
    """Unique names of `count` columns; repeated and missing get a number."""
    names = [*names[:count], *[""] * (count - len(names))]
    found: list[str] = []
    for i, name in enumerate(names):
        name = name or f"{prefix}{i + 1}"
        found.append(f"{name}_{i + 1}" if name in found else name)
    return tuple(found)


def _point_unit(path, file: C3dContents) -> float:
    units = file.texts("POINT", "UNITS")
    return _unit(path, units[0] if units else "", LENGTHS, "POINT:UNITS")


def _unit(path, text: str, known: dict[str, float], what: str) -> float:
    unit = re.sub(r"[\s.*-]", "", text.lower())
    if unit not in known:
        names = ", ".join(known)
        raise InputError(
            f"{path}: the unit of {what} is {text!r}; correct it to one of "
            f"{names}"
        )
    return known[unit]


class _Plate:
    """One plate of a file: its geometry and its signals.

    Attributes:
        corners: (4, 3) [m], in the file's axes.
    """

    def __init__(self, number, path, file: C3dContents, analog):
        self._path, self._number, self._file = path, number, file
        self._name = f"force plate {number}"
        self._kind = self._type()
        self._length = _point_unit(path, file)
        self.corners = self._length * self._corners()
        self._origin = self._length * self._signals_origin()
        self._raw, self._units = self._signals(analog)
        if self._kind == 4:
            self._raw = self._raw @ self._calibration().T

    def recording(self) -> PlateRecording:
        """Force and moment about the middle of the surface, file's axes."""
        R = plate_axes(self.corners)
        F, M = self._wrench()
        middle = self.corners.mean(axis=0)
        return PlateRecording(
            number=self._number,
            force=F @ R.T,
            point=np.tile(middle, (len(F), 1)),
            torque=M @ R.T,
        )

    def _wrench(self) -> tuple[np.ndarray, np.ndarray]:
        """Force, moment about the surface's middle (N, 3), plate's axes."""
        force_scale, moment_scale = self._scales()
        if self._kind == 3:
            F, M = _of_four_sensors(force_scale * self._raw, self._origin)
            return F, M - np.cross([0.0, 0.0, self._origin[2]], F)
        F = force_scale * self._raw[:, :3]
        if self._kind == 1:
            length = _unit(
                self._path, self._units[3], LENGTHS, f"P of {self._name}"
            )
            p = np.zeros_like(F)
            # From the surface's middle, as BTK and ezc3d read it too.
            p[:, :2] = length * self._raw[:, 3:5]
            M = np.cross(p, F)
            M[:, 2] += moment_scale * self._raw[:, 5]
            return F, M
        M = moment_scale * self._raw[:, 3:]
        return F, M - np.cross(self._origin, F)

    def _scales(self) -> tuple[float, float]:
        """Factors of force and moment channels to N and N m.

        A calibration matrix turns channels in volts into newtons, and newtons
        times the file's unit of length (C3D manual).
        """
        force, moment = self._units[0], self._units[-1]
        if self._kind == 4 and force.strip().lower() in ("v", "mv", "uv", ""):
            return 1.0, self._length
        what = f"the channels of {self._name}"
        scale = _unit(self._path, force, _FORCES, what)
        if self._kind == 3:
            return scale, scale
        return scale, _unit(self._path, moment, _MOMENTS, what)

    # What FORCE_PLATFORM says of the plate -------------------------------

    def _parameter(self, name: str, dimensions: int) -> np.ndarray | None:
        """Entry of a parameter for this plate; None if absent, not finite."""
        values = self._file.numbers("FORCE_PLATFORM", name)
        if values is None or values.ndim != dimensions:
            return None
        if values.shape[-1] < self._number:
            return None
        own = values[..., self._number - 1]
        return own if np.isfinite(own).all() else None

    def _error(self, message: str) -> InputError:
        return InputError(f"{self._path}: {self._name} {message}")

    def _type(self) -> int:
        kind = self._parameter("TYPE", 1)
        if kind is None:
            raise self._error("has no FORCE_PLATFORM:TYPE; export it again")
        if float(kind) not in _CHANNELS:
            raise self._error(
                f"is of type {kind:g}; types 1 to 4 can be read, export it as "
                "type 2"
            )
        return int(kind)

    def _corners(self) -> np.ndarray:
        values = self._parameter("CORNERS", 3)
        if values is None or values.shape != (3, 4):
            raise self._error("has no corners; complete FORCE_PLATFORM:CORNERS")
        corners = values.T
        sides = corners[0] - corners[1], corners[0] - corners[3]
        if not 1e-9 < np.linalg.norm(np.cross(*sides)) < 1e12:
            raise self._error(
                "has no corners (they span no area); complete "
                "FORCE_PLATFORM:CORNERS"
            )
        a, b = (self._length * np.linalg.norm(side) for side in sides)
        if min(a, b) < _SIDES[0] or max(a, b) > _SIDES[1]:
            raise self._error(
                f"is {a:.3g} by {b:.3g} m by its corners: "
                "FORCE_PLATFORM:CORNERS are in another unit than POINT:UNITS; "
                "correct the wrong one"
            )
        return corners

    def _signals_origin(self) -> np.ndarray:
        origin = self._parameter("ORIGIN", 2)
        if origin is None or origin.shape != (3,):
            raise self._error("has no FORCE_PLATFORM:ORIGIN; complete it")
        return -origin if origin[2] > 0.0 else origin

    def _signals(self, analog) -> tuple[np.ndarray, list[str]]:
        """Channels (N, 6 or 8) as the file holds them, and their units."""
        channels = self._parameter("CHANNEL", 2)
        count = _CHANNELS[self._kind]
        if analog is None or channels is None or len(channels) < count:
            raise self._error(
                f"of type {self._kind} lacks its {count} analog channels; "
                "complete FORCE_PLATFORM:CHANNEL"
            )
        index = channels[:count].astype(int) - 1
        if index.min() < 0 or index.max() >= len(analog.names):
            raise self._error(
                f"names analog channel {index.max() + 1}, but there are "
                f"{len(analog.names)}; correct FORCE_PLATFORM:CHANNEL"
            )
        values = analog.values[:, index]
        if not (np.abs(values) < _LARGEST).all():
            raise self._error("has gaps in its channels; export it again")
        return values, [analog.units[i] for i in index]

    def _calibration(self) -> np.ndarray:
        matrix = self._parameter("CAL_MATRIX", 3)
        if matrix is None or min(matrix.shape) < 6:
            raise self._error(
                "of type 4 has no calibration matrix; complete "
                "FORCE_PLATFORM:CAL_MATRIX"
            )
        matrix = matrix[:6, :6]
        if np.abs(matrix).max() > _LARGEST or (
            np.linalg.matrix_rank(matrix) < 6
        ):
            raise self._error(
                "of type 4 has a singular calibration matrix; correct "
                "FORCE_PLATFORM:CAL_MATRIX"
            )
        return matrix


def _of_four_sensors(f: np.ndarray, origin: np.ndarray):
    """Force and moment from Kistler's channels Fx12 Fx34 Fy14 Fy23 Fz1..4.

    About the sensors' middle; ORIGIN holds their distances a, b and depth.
    """
    a, b = np.abs(origin[:2])
    x12, x34, y14, y23, z1, z2, z3, z4 = f.T
    F = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
    M = np.column_stack(
        [
            b * (z1 + z2 - z3 - z4),
            a * (-z1 + z2 + z3 - z4),
            b * (x34 - x12) + a * (y14 - y23),
        ]
    )
    return F, M


_LABELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
_ORIGIN_M = 0.0, 0.0, -0.04  # ORIGIN of the plates that are written


def write_c3d(
    path: str | Path,
    markers: MarkerData,
    plates: Sequence[PlateRecording] = (),
    corners: Sequence[np.ndarray] = (),
    samples_per_frame: int = 1,
) -> None:
    """Write markers [mm] and force plates of type 2 to a C3D file.

    Args:
        path: the file.
        markers: gaps become unseen points.
        plates: forces on the body at `samples_per_frame` times the markers'
            rate.
        corners: of each plate (4, 3) [m], see `tables.plate_axes`.
        samples_per_frame: analog samples per marker frame.

    Raises:
        InputError: the file, read back, is damaged: the disk may be full.
    """
    # Imported here: reading uses ezc3d only in a process of its own.
    import ezc3d

    file = ezc3d.c3d()
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["UNITS"]["value"] = ["mm"]
    point["RATE"]["value"] = [markers.rate_hz]
    point["LABELS"]["value"] = list(markers.names)
    p = 1e3 * markers.positions.transpose(2, 1, 0)
    file["data"]["points"] = np.concatenate([p, np.ones((1, *p.shape[1:]))])
    signals = [
        _channels(plate, np.asarray(own))
        for plate, own in zip(plates, corners, strict=True)
    ]
    if signals:
        numbers = range(1, len(signals) + 1)
        labels = [f"{name}_{i}" for i in numbers for name in _LABELS]
        analog["LABELS"]["value"] = labels
        analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * len(
            signals
        )
        analog["RATE"]["value"] = [markers.rate_hz * samples_per_frame]
        file["data"]["analogs"] = np.hstack(signals).T[None]
        count = len(corners)
        add_platforms(
            file,
            [2] * count,
            CORNERS=np.stack([1e3 * np.asarray(c).T for c in corners], 2),
            ORIGIN=1e3 * np.tile(_ORIGIN_M, (count, 1)).T,
            CHANNEL=1 + np.arange(6 * count).reshape(count, 6).T,
        )
    file.write(str(path))
    _check_written(Path(path))


def _channels(plate: PlateRecording, corners: np.ndarray) -> np.ndarray:
    """Signals (N, 6) of a plate [N, N mm]."""
    R, middle = plate_axes(corners), corners.mean(axis=0)
    M = plate.moment_about_origin() - np.cross(middle, plate.force)
    F, M = plate.force @ R, M @ R
    return np.hstack([F, 1e3 * (M + np.cross(_ORIGIN_M, F))])


def _check_written(path: Path) -> None:
    """Read a file back, since ezc3d does not report that a disk is full."""
    try:
        decode(path)
    except InputError as error:
        _, _, said = str(error).partition(": ")
        raise InputError(
            f"{path}: cannot be written (read back, it {said}); make room or "
            "choose another folder"
        ) from error


def add_platforms(file, kinds: Sequence[int], **entries) -> None:
    """Add FORCE_PLATFORM of plates of types `kinds` to an ezc3d file."""
    entries = {"USED": [len(kinds)], "TYPE": kinds, "ZERO": [0, 0], **entries}
    parameters = file["parameters"]
    for name, value in entries.items():
        value = np.asarray(value)
        file.add_parameter("FORCE_PLATFORM", name, value.astype(float))
        if value.dtype.kind == "i":  # ezc3d makes reals of whole numbers
            whole = parameters["POINT"]["USED"]["type"]
            parameters["FORCE_PLATFORM"][name]["type"] = whole
