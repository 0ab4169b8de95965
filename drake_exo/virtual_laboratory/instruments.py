"""From what happened to what a laboratory's instruments say."""

from dataclasses import dataclass

import numpy as np

from drake_exo.laboratory.opensim_files import (
    PlateRecording,
    write_table,
    write_trc,
)
from drake_exo.laboratory.sagittal import COP_THRESHOLD_N, PlanarWrench
from drake_exo.laboratory.tables import MarkerData, Table
from drake_exo.plant import COUPLED_COORDINATES
from drake_exo.virtual_laboratory.marker_set import (
    HALF_STANCE_M,
    Marker,
    marker_positions,
)
from drake_exo.virtual_laboratory.simulation import RATE_HZ, Simulated

MARKER_RATE_HZ = 100.0
ENCODER_RATE_HZ = 200.0
PLATES = {"left": 1, "right": 2, "chair": 3}

# What `--without` switches off, by name.
DISTURBANCES = {
    "marker_noise": "0.3 mm white noise on every marker coordinate",
    "plate_noise": "0.5 N and 0.2 N m white noise on every plate",
    "encoder_noise": "0.02 degree white noise, 0.01 degree resolution",
}
_MARKER_NOISE_M = 3e-4
_FORCE_NOISE_N = 0.5
_MOMENT_NOISE_NM = 0.2
_ENCODER_NOISE_DEG = 0.02
_ENCODER_STEP_DEG = 0.01

# Where a plate without load says that its force acts.
_CENTRES = {"left": 0.06, "right": 0.06, "chair": -0.35}


@dataclass(frozen=True)
class Instruments:
    """The laboratory's equipment.

    Attributes:
        markers: on the subject, by name.
        left_share: of the ground reaction, under the left foot.
        disturbances: names of those that act.
    """

    markers: dict[str, Marker]
    left_share: float
    disturbances: frozenset[str]

    def write_markers(self, path, movement: Simulated, rng) -> None:
        """Marker positions, 100 Hz (.trc)."""
        q = _every(MARKER_RATE_HZ, movement.q)
        p = marker_positions(movement.tree, q, self.markers)
        if "marker_noise" in self.disturbances:
            p = p + rng.normal(0.0, _MARKER_NOISE_M, p.shape)
        time = np.arange(len(q)) / MARKER_RATE_HZ
        write_trc(
            path,
            MarkerData(time, tuple(self.markers), p, MARKER_RATE_HZ),
        )

    def write_plates(self, path, movement: Simulated, rng) -> None:
        """Plates under the feet and the tared one under the chair (.mot)."""
        share = {"left": self.left_share, "right": 1.0 - self.left_share}
        wrenches = {
            foot: PlanarWrench(
                s * movement.ground.force, s * movement.ground.moment
            )
            for foot, s in share.items()
        }
        wrenches["chair"] = movement.chair
        names, columns = [], []
        for place, number in PLATES.items():
            w = wrenches[place]
            if "plate_noise" in self.disturbances:
                w = PlanarWrench(
                    w.force + rng.normal(0.0, _FORCE_NOISE_N, w.force.shape),
                    w.moment
                    + rng.normal(0.0, _MOMENT_NOISE_NM, w.moment.shape),
                )
            plate = plate_recording(number, w, place)
            for label, values in (
                ("force_{}_v", plate.force),
                ("force_{}_p", plate.point),
                ("torque_{}_", plate.torque),
            ):
                names += [f"ground_{label.format(number)}{a}" for a in "xyz"]
                columns.append(values)
        table = Table(movement.times, tuple(names), np.hstack(columns))
        write_table(path, table)

    def write_encoders(self, path, movement: Simulated, rng) -> None:
        """Joint angles of the exoskeleton, 200 Hz, degrees (.mot)."""
        angles = np.rad2deg(_every(ENCODER_RATE_HZ, movement.q[:, 6:]))
        if "encoder_noise" in self.disturbances:
            angles = angles + rng.normal(0.0, _ENCODER_NOISE_DEG, angles.shape)
            angles = _ENCODER_STEP_DEG * np.round(angles / _ENCODER_STEP_DEG)
        time = np.arange(len(angles)) / ENCODER_RATE_HZ
        table = Table(time, COUPLED_COORDINATES[6:], angles, in_degrees=True)
        write_table(path, table)


def plate_recording(
    number: int, wrench: PlanarWrench, place: str
) -> PlateRecording:
    """A plate's force, point and free moment in OpenSim's axes.

    Below 20 N the point is the plate's middle, and the free moment makes up
    for it, so that the wrench stays what it was.
    """
    F_x, F_z = wrench.force.T
    lateral = {"left": -HALF_STANCE_M, "right": HALF_STANCE_M}
    loaded = F_z > COP_THRESHOLD_N
    force, point, torque = np.zeros((3, len(F_z), 3))
    force[:, 0], force[:, 1] = F_x, F_z
    point[:, 0] = np.where(
        loaded, -wrench.moment / np.where(loaded, F_z, 1.0), _CENTRES[place]
    )
    point[:, 2] = lateral.get(place, 0.0)
    # About y (left) in the plane, so about -z (right) in the file; a force
    # off the midline has no part in it, its moments are about x and y.
    torque[:, 2] = -(wrench.moment + point[:, 0] * F_z)
    return PlateRecording(number, force, point, torque, True)


def _every(rate_hz: float, values: np.ndarray) -> np.ndarray:
    return values[:: round(RATE_HZ / rate_hz)]
