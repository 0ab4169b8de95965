"""From what happened to what a laboratory's instruments say."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drake_exo.files.csv import write_csv_table
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.tables import MarkerData, PlateRecording, Table
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.virtual_laboratory.c3d_writing import PlateDesign, write_c3d
from drake_exo.virtual_laboratory.markers import (
    HALF_STANCE_M,
    NOISE_M,
    Marker,
    Skin,
    draw_skin,
    hide,
    marker_positions,
    soft_tissue,
    turned_skin,
)
from drake_exo.virtual_laboratory.simulation import RATE_HZ

MARKER_RATE_HZ = 100.0
DEVICE_RATE_HZ = 200.0
PLATES = {"left": 1, "right": 2, "chair": 3}
LARGEST_LAG_S = 0.04
_PER_FRAME = round(RATE_HZ / MARKER_RATE_HZ)

_FORCE_NOISE_N = 0.5
_MOMENT_NOISE_NM = 0.2
_OFFSET = np.array([2.0, 4.0, 0.5])  # F_x, F_z [N], M_y [N m]
_DRIFT = np.array([0.5, 1.5, 0.2])  # over a recording
_WIDE_DRIFT = np.array([2.0, 5.0, 0.5])
_EMPTY_S = 2.0
_ANGLE_NOISE = np.deg2rad(0.02)
_ANGLE_STEP = np.deg2rad(0.01)
_EXO_MOMENT_NOISE_NM = 0.1

# Middle, along the walkway and to the right, of each plate [m].
_MIDDLE = {
    "left": (0.06, -HALF_STANCE_M),
    "right": (0.06, HALF_STANCE_M),
    "chair": (-0.45, 0.0),
}
_HALF_SIZE = {"left": (0.25, 0.085), "right": (0.25, 0.085)}
_CHAIR_HALF_SIZE = (0.24, 0.25)


def empty_plate_levels(rng: np.random.Generator) -> np.ndarray:
    """F_x, F_z [N] and M_y [N m] that a plate shows with nothing on it."""
    return rng.uniform(-1.0, 1.0, 3) * _OFFSET


@dataclass(frozen=True)
class Clocks:
    """Lag of each system's clock behind the markers' [s]."""

    device: float = 0.0
    mats: float = 0.0


@dataclass(frozen=True)
class Faults:
    """What instruments of a wide truth get wrong; nothing by default.

    Attributes:
        skin: segment -> how markers turn on it.
        left_share: of what both legs bear and press.
        encoder_offset_rad: of the device's ankle, knee, hip.
        mat_share: cuff -> share of its force that mats see.
        friction_share: of the device's joints, that the bench found.
        plate_drift: over a recording, F_x, F_z [N], M_y [N m].
        noisy_windows: whether trials are cut by what plates show.
    """

    skin: dict[str, Skin] = field(default_factory=dict)
    left_share: float = 0.5
    encoder_offset_rad: tuple[float, ...] = (0.0, 0.0, 0.0)
    mat_share: dict[str, float] = field(default_factory=dict)
    friction_share: tuple[float, ...] = (1.0, 1.0, 1.0)
    plate_drift: tuple[float, ...] = tuple(_DRIFT)
    noisy_windows: bool = False


def draw_faults(
    rng: np.random.Generator, active: frozenset[str], cuffs: Iterable[str]
) -> Faults:
    """Faults of a wide truth.

    Args:
        rng: numbers are drawn in the same order whatever is active.
        active: disturbances.
        cuffs: with mats.
    """

    def several(low: float, high: float) -> tuple[float, ...]:
        return tuple(rng.uniform(low, high, 3).tolist())

    reach = np.deg2rad(3.0)
    drawn = {
        "soft_tissue": {"skin": draw_skin(rng)},
        "legs": {"left_share": 0.5 * float(rng.uniform(0.95, 1.05))},
        "encoder_offset": {"encoder_offset_rad": several(-reach, reach)},
        "mat_share": {
            "mat_share": {c: float(rng.uniform(0.85, 1.0)) for c in cuffs}
        },
        "bench": {"friction_share": several(0.5, 1.5)},
        "plate_drift": {"plate_drift": tuple(_WIDE_DRIFT.tolist())},
        "windows": {"noisy_windows": True},
    }
    chosen = [values for name, values in drawn.items() if name in active]
    return Faults(**{k: v for values in chosen for k, v in values.items()})


@dataclass(frozen=True)
class Laboratory:
    """The equipment, the same for all movements.

    Attributes:
        folder: where files go.
        tree: the subject with the device.
        files: "c3d" (markers and plates in one .c3d, device as .csv) or
            "opensim" (.trc and .mot).
        markers: on the subject, by name.
        slide: (M, 2) of the skin under them.
        offsets: plate -> F_x, F_z, M_y of the empty plate.
        disturbances: names of those that act.
        faults: of a wide truth.
    """

    folder: Path
    tree: PlanarTree
    files: str
    markers: dict[str, Marker]
    slide: np.ndarray
    offsets: dict[str, np.ndarray]
    disturbances: frozenset[str]
    faults: Faults

    def motion_files(self, name: str) -> dict[str, str]:
        """Names of the files of markers and forces."""
        if self.files == "c3d":
            return {"markers": f"{name}.c3d", "forces": f"{name}.c3d"}
        return {"markers": f"{name}.trc", "forces": f"{name}_forces.mot"}

    def device_file(self, name: str, what: str) -> str:
        """Name of a file of the device: "encoders" or "moments"."""
        return f"{name}_{what}.{'csv' if self.files == 'c3d' else 'mot'}"

    def record_motion(self, movement: Trial, rng, hidden=True) -> None:
        """Write markers at 100 Hz and plates at 1000 Hz.

        Args:
            movement: what happened.
            rng: of this recording.
            hidden: whether markers may be hidden at times.
        """
        active, tree = self.disturbances, self.tree
        q = movement.q[::_PER_FRAME]
        p = marker_positions(tree, q, self.markers)
        if "soft_tissue" in active:
            p = p + soft_tissue(tree, q, self.markers, self.slide)
            p = p + turned_skin(
                tree, q, MARKER_RATE_HZ, self.markers, self.faults.skin
            )
        noise = rng.normal(0.0, NOISE_M, p.shape)
        if "marker_noise" in active:
            p = p + noise
        if "gaps" in active and hidden:
            p = hide(p, rng)
        share = float(rng.uniform(0.46, 0.54))
        if "variation" not in active:
            share = 0.5
        share += self.faults.left_share - 0.5
        feet = {"left": share, "right": 1.0 - share}
        wrenches = dict(movement.feet) or {
            foot: PlanarWrench.of(s * movement.ground.array)
            for foot, s in feet.items()
        }
        wrenches["chair"] = movement.chair
        self._write(movement.name, p, self._disturbed(wrenches, rng))

    def record_empty(self, name: str, rng) -> None:
        """Write the plates with nothing on them."""
        n = round(_EMPTY_S * RATE_HZ) + 1
        nothing = PlanarWrench(np.zeros((n, 2)), np.zeros(n))
        plates = self._disturbed(dict.fromkeys(PLATES, nothing), rng, 0.0)
        frames = (n - 1) // _PER_FRAME + 1
        corner = np.zeros((frames, 1, 3))
        alone = replace(self, markers={"FLOOR": Marker("world", 0, 0, 0)})
        alone._write(name, corner, plates)

    def _disturbed(self, wrenches, rng, drift=1.0) -> list[PlateRecording]:
        plates = []
        for place, number in PLATES.items():
            w = wrenches[place]
            values = w.array
            n = len(values)
            noise = rng.normal(size=(n, 3))
            slope = drift * rng.uniform(-1.0, 1.0, 3)
            slope *= np.array(self.faults.plate_drift)
            if "plate_noise" in self.disturbances:
                values[:, :2] += _FORCE_NOISE_N * noise[:, :2]
                values[:, 2] += _MOMENT_NOISE_NM * noise[:, 2]
            if "plate_drift" in self.disturbances:
                values += self.offsets[place]
                values += np.linspace(0.0, 1.0, n)[:, None] * slope
            w = PlanarWrench.of(values)
            plates.append(plate_recording(number, w, place))
        return plates

    def _write(self, name, positions, plates) -> None:
        time = np.arange(len(positions)) / MARKER_RATE_HZ
        names, paths = tuple(self.markers), self.motion_files(name)
        if self.files == "opensim":
            data = MarkerData(time, names, positions, MARKER_RATE_HZ)
            write_trc(self.folder / paths["markers"], data)
            _write_plates(self.folder / paths["forces"], plates)
            return
        count = len(time) * _PER_FRAME
        write_c3d(
            self.folder / paths["markers"],
            MarkerData(time, names, _z_up(positions), MARKER_RATE_HZ),
            [_resized(plate, count) for plate in plates],
            [_design(place) for place in PLATES],
            _PER_FRAME,
        )

    def record_device(
        self, movement: Trial, clocks: Clocks, with_moments: bool, rng
    ) -> None:
        """Write encoders, and joint moments if the device records them."""
        time = np.arange(0.0, movement.times[-1], 1.0 / DEVICE_RATE_HZ)
        at = time - clocks.device
        names = movement.coordinates
        exo = names.is_device_joint
        angles = _sampled(movement, movement.q[:, names.device_columns], at)
        angles = angles + self.faults.encoder_offset_rad
        moments = _sampled(movement, movement.moments[:, exo], at)
        noise = rng.normal(size=(2, *angles.shape))
        if "encoder_noise" in self.disturbances:
            angles = angles + _ANGLE_NOISE * noise[0]
            angles = _ANGLE_STEP * np.round(angles / _ANGLE_STEP)
            moments = moments + _EXO_MOMENT_NOISE_NM * noise[1]
        table = Table(time, names.device, angles, in_degrees=False)
        self._write_device(movement.name, "encoders", table, "deg")
        if with_moments:
            columns = tuple(f"{name}_moment" for name in names.device)
            table = Table(time, columns, moments, in_degrees=False)
            self._write_device(movement.name, "moments", table, "Nm")

    def _write_device(self, name, what, table: Table, unit: str) -> None:
        path = self.folder / self.device_file(name, what)
        if self.files == "c3d":
            write_csv_table(path, table, [unit] * len(table.names))
            return
        if unit == "deg":
            values = np.rad2deg(table.values)
            table = replace(table, values=values, in_degrees=True)
        write_table(path, table)


def plate_recording(
    number: int, wrench: PlanarWrench, place: str
) -> PlateRecording:
    """A plate's force, point and free moment in OpenSim's axes.

    Below 20 N the point is the plate's middle, and the free moment makes up
    for it, so that the wrench stays what it was.
    """
    F_x, F_z = wrench.force.T
    x, right = _MIDDLE[place]
    force, point, torque = np.zeros((3, len(F_z), 3))
    force[:, 0], force[:, 1] = F_x, F_z
    point[:, 0] = np.where(wrench.is_loaded, wrench.cop_x, x)
    point[:, 2] = right
    # About y (left) in the plane, so about -z (right) in the file; a force
    # off the midline has no part in it, its moments are about x and y.
    torque[:, 2] = -(wrench.moment + point[:, 0] * F_z)
    return PlateRecording(number, force, point, torque)


def _write_plates(path: Path, plates: list[PlateRecording]) -> None:
    names, columns = [], []
    for plate in plates:
        for label, values in (
            ("force_{}_v", plate.force),
            ("force_{}_p", plate.point),
            ("torque_{}_", plate.torque),
        ):
            names += [f"ground_{label.format(plate.number)}{a}" for a in "xyz"]
            columns.append(values)
    time = np.arange(len(columns[0])) / RATE_HZ
    write_table(path, Table(time, tuple(names), np.hstack(columns)))


def _z_up(values: np.ndarray) -> np.ndarray:
    """From OpenSim's axes to x forward, y left, z up."""
    return np.stack([values[..., 0], -values[..., 2], values[..., 1]], axis=-1)


def _resized(plate: PlateRecording, count: int) -> PlateRecording:
    """The first `count` samples, the last one repeated, z up."""
    i = np.minimum(np.arange(count), len(plate.force) - 1)
    parts = (_z_up(x[i]) for x in (plate.force, plate.point, plate.torque))
    return PlateRecording(plate.number, *parts)


def _design(place: str) -> PlateDesign:
    """Where a plate lies: forward right, back right, back left, ..."""
    x, right = _MIDDLE[place]
    half_x, half_y = _HALF_SIZE.get(place, _CHAIR_HALF_SIZE)
    corners = [
        (x + a * half_x, -(right + b * half_y), 0.0)
        for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    return PlateDesign(np.array(corners))


def _sampled(movement: Trial, values, at) -> np.ndarray:
    """Values (N, k) at other times; the ends' values beyond the ends."""
    columns = [np.interp(at, movement.times, column) for column in values.T]
    return np.column_stack(columns)
