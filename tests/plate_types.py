"""C3D files with plates of every type, as laboratories write them."""

from dataclasses import dataclass

import ezc3d
import numpy as np

from drake_exo.files.c3d import add_platforms, write_c3d
from drake_exo.files.tables import PlateRecording, plate_axes

_LABELS = {
    1: ("Fx", "Fy", "Fz", "Px", "Py", "Tz"),
    2: ("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
    3: ("Fx12", "Fx34", "Fy14", "Fy23", "Fz1", "Fz2", "Fz3", "Fz4"),
    4: ("Fx", "Fy", "Fz", "Mx", "My", "Mz"),
}
_UNITS = {
    1: ("N", "N", "N", "mm", "mm", "Nmm"),
    2: ("N", "N", "N", "Nmm", "Nmm", "Nmm"),
    3: ("N",) * 8,
    4: ("V",) * 6,
}


@dataclass(frozen=True)
class PlateDesign:
    """A plate as a laboratory builds it in.

    Attributes:
        corners: (4, 3) [m], in the order (+x, +y), (-x, +y), (-x, -y),
            (+x, -y) of the plate's own frame, whose z points down.
        kind: 1 to 4.
        origin: FORCE_PLATFORM:ORIGIN [m]; for type 3 the sensors' distances
            a, b from the middle and their (negative) depth.
        calibration: (6, 6), N and N mm for a volt, for type 4.
    """

    corners: np.ndarray
    kind: int = 2
    origin: tuple[float, float, float] = (0.0, 0.0, -0.04)
    calibration: np.ndarray | None = None

    def channels(self, recording: PlateRecording) -> np.ndarray:
        """Signals (N, 6 or 8) in the units of the file."""
        c = np.asarray(self.origin)
        corners = np.asarray(self.corners)
        R, middle = plate_axes(corners), corners.mean(axis=0)
        M = recording.moment_about_origin() - np.cross(middle, recording.force)
        F, M = recording.force @ R, M @ R
        if self.kind == 3:
            return self._four_sensors(F, M + np.cross([0, 0, c[2]], F))
        if self.kind == 1:
            F_z = np.where(np.abs(F[:, 2]) > 1e-9, F[:, 2], np.inf)
            p = np.column_stack([-M[:, 1] / F_z, M[:, 0] / F_z])
            T = M[:, 2] - (p[:, 0] * F[:, 1] - p[:, 1] * F[:, 0])
            return np.column_stack([F, 1e3 * p, 1e3 * T])
        M = 1e3 * (M + np.cross(c, F))
        both = np.hstack([F, M])
        if self.kind == 4:
            return np.linalg.solve(self.calibration, both.T).T
        return both

    def _four_sensors(self, F, M) -> np.ndarray:
        a, b = np.abs(self.origin[:2])
        p, q = M[:, 0] / b, M[:, 1] / a
        z = [F[:, 2] + p - q, F[:, 2] + p + q, F[:, 2] - p + q, F[:, 2] - p - q]
        half = 0.5 * M[:, 2] / b
        x = [0.5 * F[:, 0] - half, 0.5 * F[:, 0] + half]
        y = [0.5 * F[:, 1], 0.5 * F[:, 1]]
        return np.column_stack([*x, *y, *(0.25 * s for s in z)])


def write_types(path, markers, plates, designs, samples_per_frame=1) -> None:
    """Write markers [mm] and force plates to a C3D file.

    Args:
        path: the file.
        markers: gaps become unseen points.
        plates: forces on the body at `samples_per_frame` times the markers'
            rate, one recording for each design.
        designs: how the plates are built in.
        samples_per_frame: analog samples of one marker frame.
    """
    write_c3d(path, markers)
    file = ezc3d.c3d(str(path))
    analog = file["parameters"]["ANALOG"]
    labels, units, signals, used = [], [], [], []
    for i, (plate, design) in enumerate(zip(plates, designs, strict=True)):
        names = _LABELS[design.kind]
        used.append(len(labels) + 1 + np.arange(len(names)))
        labels += [f"{name}_{i + 1}" for name in names]
        units += _UNITS[design.kind]
        signals.append(design.channels(plate))
    if signals:
        analog["LABELS"]["value"] = labels
        analog["UNITS"]["value"] = units
        analog["RATE"]["value"] = [markers.rate_hz * samples_per_frame]
        file["data"]["analogs"] = np.hstack(signals).T[None]
        _add_platforms(file, designs, used)
    file.write(str(path))


def _add_platforms(file, designs, used) -> None:
    rows = max(map(len, used))
    entries = {
        "CORNERS": np.stack(
            [1e3 * np.asarray(d.corners).T for d in designs], 2
        ),
        "ORIGIN": np.stack([1e3 * np.asarray(d.origin) for d in designs], 1),
        "CHANNEL": np.stack([np.pad(u, (0, rows - len(u))) for u in used], 1),
    }
    if any(d.kind == 4 for d in designs):
        entries["CAL_MATRIX"] = np.stack(
            [
                np.eye(6) if d.calibration is None else d.calibration
                for d in designs
            ],
            2,
        )
    add_platforms(file, [d.kind for d in designs], **entries)
