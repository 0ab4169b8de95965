"""C3D files: markers, force plates of types 1 to 4, analog channels.

The bytes are decoded by ezc3d; what the plates' signals mean is worked out
here (The C3D File Format, FORCE_PLATFORM group). A plate's own frame comes
from its corners: x from corner 2 to 1, y from corner 4 to 1, z = x × y, which
points down for a plate in the floor. ORIGIN runs from the origin of the
plate's signals to the middle of its surface, so its z is negative; files with
a positive one are common and are corrected.

    type 1: F, point of application from the middle, free moment
    type 2: F and M about the signals' origin
    type 3: eight channels of four piezoelectric sensors
    type 4: as type 2, after the calibration matrix
"""

from dataclasses import dataclass, field
from pathlib import Path

import ezc3d
import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.opensim_files import PlateRecording
from drake_exo.laboratory.tables import MarkerData, Table

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_FORCES = {"n": 1.0, "kn": 1e3, "mn": 1e-3}
_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}


@dataclass(frozen=True)
class C3d:
    """Contents of a C3D file.

    Attributes:
        markers: None if the file has none.
        plates: force plates, numbered from 1, in the file's axes; forces on
            the body.
        plate_time: (N,) of the plates' samples [s].
        analog: all analog channels; None if the file has none.
        analog_units: channel name -> unit as the file says.
        corners: (P, 4, 3) of each plate [m].
    """

    markers: MarkerData | None
    plates: list[PlateRecording]
    plate_time: np.ndarray
    analog: Table | None
    analog_units: dict[str, str] = field(default_factory=dict)
    corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 3)))


def read_c3d(path: str | Path) -> C3d:
    """Read a C3D file; time starts at zero with its first frame.

    Raises:
        InputError: unreadable or truncated file, unknown units, a plate
            without corners or channels, or of another type.
    """
    path = Path(path)
    _check_complete(path)
    try:
        file = ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError, IndexError) as error:
        raise InputError(
            f"{path}: is not a readable C3D file ({error}); export it again"
        ) from error
    parameters = file["parameters"]
    markers = _markers(path, file, parameters)
    analog, units = _analog(path, file, parameters)
    group = parameters.get("FORCE_PLATFORM", {})
    count = int(_numbers(group, "USED", (1,), [0])[0])
    plates, corners = [], np.zeros((count, 4, 3))
    for i in range(count):
        plate = _PlateSignals(path, group, i, analog, units, parameters)
        plates.append(plate.recording())
        corners[i] = plate.corners
    time = np.zeros(0) if analog is None else analog.time
    return C3d(markers, plates, time, analog, units, corners)


def _check_complete(path: Path) -> None:
    """Refuse a file shorter than its header announces."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); check the path"
        ) from error
    if len(data) < 1024 or data[1] != 0x50:
        raise InputError(f"{path}: is not a C3D file; check the path")
    # Processor 84: little-endian IEEE; the other two are rare and are left
    # to ezc3d.
    place = (data[0] - 1) * 512
    if len(data) <= place + 3 or data[place + 3] != 84:
        if len(data) <= place + 3:
            raise _truncated(path)
        return
    words = np.frombuffer(data[:24], "<u2").astype(int)
    points, analogs, first, last, start = (
        words[1],
        words[2],
        words[3],
        words[4],
        words[8],
    )
    is_float = np.frombuffer(data[12:16], "<f4")[0] < 0.0
    frames = last - first + 1
    if last == 0xFFFF:  # longer than the header can say
        return
    size = (4 * points + analogs) * (4 if is_float else 2)
    if len(data) < (start - 1) * 512 + frames * size:
        raise _truncated(path)


def _truncated(path) -> InputError:
    return InputError(
        f"{path}: ends before its last frame; the file is truncated, copy "
        "or export it again"
    )


def _numbers(group, name: str, shape, default=None) -> np.ndarray:
    values = group.get(name, {}).get("value")
    if values is None or np.size(values) == 0:
        values = [] if default is None else default
    return np.asarray(values, float).reshape(shape) if shape else values


def _texts(group, name: str) -> list[str]:
    """Text entries of a parameter and its continuations (LABELS2, ...)."""
    found = []
    for suffix in ("", *range(2, 10)):
        value = group.get(f"{name}{suffix}", {}).get("value") or []
        found += [str(v).strip() for v in value]
    return found


def _unit(path, text: str, known: dict[str, float], what: str) -> float:
    unit = text.strip().lower().replace(".", "").replace("*", "")
    if unit not in known:
        names = ", ".join(known)
        raise InputError(
            f"{path}: the unit of {what} is {text!r}; correct it to one of "
            f"{names}"
        )
    return known[unit]


def _point_unit(path, parameters) -> float:
    units = _texts(parameters["POINT"], "UNITS")
    return _unit(path, units[0] if units else "", _LENGTHS, "POINT:UNITS")


def _unique(names: list[str], count: int, prefix: str) -> tuple[str, ...]:
    """One name for each of `count` columns; repeated ones get a number."""
    names = [*names[:count], *[""] * (count - len(names))]
    found: list[str] = []
    for i, name in enumerate(names):
        name = name or f"{prefix}{i + 1}"
        found.append(f"{name}_{i + 1}" if name in found else name)
    return tuple(found)


def _markers(path, file, parameters) -> MarkerData | None:
    points = file["data"]["points"][:3]
    if points.shape[1] == 0 or points.shape[2] == 0:
        return None
    rate = float(file["header"]["points"]["frame_rate"])
    if not rate > 0.0:
        raise InputError(f"{path}: says no frame rate; correct POINT:RATE")
    p = _point_unit(path, parameters) * points.transpose(2, 1, 0)
    # Some exporters write unseen markers as zeros instead of residual -1.
    p = np.where((p == 0.0).all(axis=2, keepdims=True), np.nan, p)
    names = _texts(parameters["POINT"], "LABELS")
    return MarkerData(
        time=np.arange(len(p)) / rate,
        names=_unique(names, p.shape[1], "marker"),
        positions=p,
        rate_hz=rate,
        source=str(path),
    )


def _analog(path, file, parameters) -> tuple[Table | None, dict[str, str]]:
    values = file["data"]["analogs"][0].T
    if values.size == 0:
        return None, {}
    rate = float(file["header"]["analogs"]["frame_rate"])
    if not rate > 0.0:
        raise InputError(f"{path}: says no analog rate; correct ANALOG:RATE")
    group = parameters["ANALOG"]
    names = _unique(_texts(group, "LABELS"), values.shape[1], "channel")
    units = _texts(group, "UNITS")
    units += [""] * (len(names) - len(units))
    table = Table(
        time=np.arange(len(values)) / rate,
        names=names,
        values=values,
        source=str(path),
    )
    return table, dict(zip(names, units, strict=False))


class _PlateSignals:
    """One plate of a file: its geometry and its signals."""

    def __init__(self, path, group, index, analog, units, parameters):
        self.path, self.index = path, index
        self.kind = self._type(group)
        length = _point_unit(path, parameters)
        self.corners = length * self._corners(group)
        self.origin = length * self._origin(group)
        raw, self.units = self._signals(group, analog, units)
        self.length = length
        if self.kind == 4:
            raw = raw @ self._calibration(group).T
        self.raw = raw

    @property
    def name(self) -> str:
        return f"force plate {self.index + 1}"

    def _error(self, message: str) -> InputError:
        return InputError(f"{self.path}: {self.name} {message}")

    def _type(self, group) -> int:
        types = _numbers(group, "TYPE", (-1,))
        if len(types) <= self.index:
            raise self._error("has no FORCE_PLATFORM:TYPE; export it again")
        kind = int(types[self.index])
        if kind not in _CHANNELS:
            raise self._error(
                f"is of type {kind}; types 1 to 4 can be read, export it as "
                "type 2"
            )
        return kind

    def _corners(self, group) -> np.ndarray:
        values = np.asarray(_numbers(group, "CORNERS", None), float)
        if values.ndim != 3 or values.shape[2] <= self.index:
            raise self._error("has no corners; complete FORCE_PLATFORM:CORNERS")
        corners = values[:, :, self.index].T
        sides = corners[0] - corners[1], corners[0] - corners[3]
        if not np.linalg.norm(np.cross(*sides)) > 1e-9:
            raise self._error(
                "has no corners (they span no area); complete "
                "FORCE_PLATFORM:CORNERS"
            )
        return corners

    def _origin(self, group) -> np.ndarray:
        values = np.asarray(_numbers(group, "ORIGIN", None), float)
        if values.ndim != 2 or values.shape[1] <= self.index:
            raise self._error("has no FORCE_PLATFORM:ORIGIN; complete it")
        origin = values[:, self.index]
        return -origin if origin[2] > 0.0 else origin

    def _signals(self, group, analog, units):
        channels = np.asarray(_numbers(group, "CHANNEL", None), int)
        count = _CHANNELS[self.kind]
        if (
            analog is None
            or channels.ndim != 2
            or channels.shape[1] <= self.index
            or channels.shape[0] < count
        ):
            raise self._error(
                f"of type {self.kind} lacks its {count} analog channels; "
                "complete FORCE_PLATFORM:CHANNEL"
            )
        index = channels[:count, self.index] - 1
        if index.min() < 0 or index.max() >= len(analog.names):
            raise self._error(
                f"names analog channel {index.max() + 1}, but there are "
                f"{len(analog.names)}; correct FORCE_PLATFORM:CHANNEL"
            )
        names = [analog.names[i] for i in index]
        values = analog.values[:, index]
        if not np.isfinite(values).all():
            raise self._error("has gaps in its channels; export it again")
        return values, [units[n] for n in names]

    def _calibration(self, group) -> np.ndarray:
        values = np.asarray(_numbers(group, "CAL_MATRIX", None), float)
        if values.ndim != 3 or values.shape[2] <= self.index:
            raise self._error(
                "of type 4 has no calibration matrix; complete "
                "FORCE_PLATFORM:CAL_MATRIX"
            )
        matrix = values[:6, :6, self.index]
        if not np.abs(np.linalg.det(matrix)) > 0.0:
            raise self._error(
                "of type 4 has a singular calibration matrix; correct "
                "FORCE_PLATFORM:CAL_MATRIX"
            )
        return matrix

    def _scales(self) -> tuple[float, float]:
        """Factors to N and N m of force and moment channels.

        After a calibration matrix channels that count volts are newtons, and
        newtons times the file's unit of length (C3D manual).
        """
        moments = {"nm": 1.0, "ncm": 1e-2, "nmm": 1e-3}
        force, moment = self.units[0], self.units[-1]
        if self.kind == 4 and force.strip().lower() in ("v", "mv", "uv", ""):
            return 1.0, self.length
        what = f"the channels of {self.name}"
        scale = _unit(self.path, force, _FORCES, what)
        if self.kind == 3:
            return scale, scale
        return scale, _unit(self.path, moment, moments, what)

    def _wrench(self) -> tuple[np.ndarray, np.ndarray]:
        """Force and moment about the surface's middle, in the plate."""
        force_scale, moment_scale = self._scales()
        if self.kind == 3:
            F, M = _of_four_sensors(force_scale * self.raw, self.origin)
            return F, M - np.cross([0.0, 0.0, self.origin[2]], F)
        F = force_scale * self.raw[:, :3]
        if self.kind == 1:
            length = _unit(
                self.path, self.units[3], _LENGTHS, f"P of {self.name}"
            )
            p = np.zeros_like(F)
            # From the surface's middle, as BTK and ezc3d read it too.
            p[:, :2] = length * self.raw[:, 3:5]
            M = np.cross(p, F)
            M[:, 2] += moment_scale * self.raw[:, 5]
            return F, M
        M = moment_scale * self.raw[:, 3:]
        return F, M - np.cross(self.origin, F)

    def recording(self) -> PlateRecording:
        x = self.corners[0] - self.corners[1]
        y = self.corners[0] - self.corners[3]
        z = np.cross(x, y)
        y = np.cross(z, x)
        R = np.stack([e / np.linalg.norm(e) for e in (x, y, z)], axis=1)
        F, M = self._wrench()
        middle = self.corners.mean(axis=0)
        return PlateRecording(
            number=self.index + 1,
            force=F @ R.T,
            point=np.tile(middle, (len(F), 1)),
            torque=M @ R.T,
            has_torque=True,
        )


def _of_four_sensors(f: np.ndarray, origin: np.ndarray):
    """Kistler's channels Fx12 Fx34 Fy14 Fy23 Fz1..4 as force and moment.

    ORIGIN holds the sensors' distances a, b from the middle, and their depth.
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
