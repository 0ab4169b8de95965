"""The virtual laboratory's instruments: from the true motion to recordings.

The subject wears 56 markers, as in the paper. Their places in the links' frames
scale with the segment's length and, on the foot, with the ankle's height.
Their errors are noise, gaps, and skin that slides and turns on the bones.

Every cuff presses on the front and the back of the segment; straps hold it
with a tension, so both of its pressure mats see pressure at rest. The resultant
along the segment's x is the cuff's normal force. A scan gives the mats' places.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.c3d import write_c3d
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.tables import (
    MarkerData,
    PlateRecording,
    Table,
    write_csv_table,
)
from drake_exo.measurement.filters import linear
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import SIDES
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.model.segments import HumanParameters
from drake_exo.virtual_laboratory.simulation import RATE_HZ

# Half the distance between the legs' midlines [m].
HALF_STANCE_M = 0.09


@dataclass(frozen=True)
class Marker:
    """A marker fixed to a link.

    Attributes:
        body: link of the human.
        x_m, z_m: place in the link's frame.
        y_m: distance to the left of the body's midplane.
    """

    body: str
    x_m: float
    z_m: float
    y_m: float

    @property
    def segment(self) -> str:
        """Name of its link without the leg's side."""
        return self.body.split("_")[0]

    @property
    def side(self) -> str:
        """Side of the midplane that it is on."""
        return "left" if self.y_m > 0.0 else "right"


# Markers of each leg: link, x and z [m], z [segment's length], outwards [m].
_LEG = {
    "SHK1": ("shank", 0.040, 0.0, 0.30, 0.01),
    "SHK2": ("shank", -0.045, 0.0, 0.42, 0.03),
    "SHK3": ("shank", 0.035, 0.0, 0.62, 0.03),
    "SHK4": ("shank", -0.055, 0.0, 0.75, 0.02),
    "LMAL": ("shank", -0.004, -0.003, 0.0, 0.04),
    "MMAL": ("shank", 0.004, 0.003, 0.0, -0.04),
    "THI1": ("thigh", 0.060, 0.0, 0.30, 0.03),
    "THI2": ("thigh", -0.050, 0.0, 0.40, 0.05),
    "THI3": ("thigh", 0.070, 0.0, 0.62, 0.04),
    "THI4": ("thigh", -0.020, 0.0, 0.70, 0.07),
    "LKNE": ("thigh", -0.005, 0.004, 0.0, 0.055),
    "MKNE": ("thigh", 0.005, -0.004, 0.0, -0.055),
    "TROC": ("thigh", 0.000, 0.0, 1.0, 0.09),
}
# Markers of each foot: x [foot's length], z [ankle's height], outwards [m].
_FOOT = {
    "CAL": (-0.215, -0.55, 0.0),
    "MT1": (0.470, -0.60, -0.04),
    "MT5": (0.400, -0.70, 0.05),
    "TOE": (0.600, -0.65, 0.0),
}
# Markers of the trunk on both sides: x [m], z [hip to vertex], y [m].
_SIDED_TRUNK = {
    "ASI": (0.090, 0.090, 0.13),
    "PSI": (-0.110, 0.100, 0.05),
    "SHO": (0.000, 0.610, 0.19),
    "ELB": (-0.030, 0.270, 0.24),
    "WRI": (0.020, -0.040, 0.25),
    "FHD": (0.090, 0.900, 0.07),
    "BHD": (-0.090, 0.910, 0.07),
}
# Markers of the trunk on the midline: x [m], z [hip to vertex].
_MIDDLE_TRUNK = {
    "SACR": (-0.130, 0.080),
    "L1": (-0.110, 0.240),
    "T10": (-0.115, 0.390),
    "T4": (-0.105, 0.540),
    "C7": (-0.070, 0.660),
    "CLAV": (0.070, 0.560),
    "STRN": (0.110, 0.440),
    "VERT": (0.000, 1.010),
}


def marker_set(
    human: HumanParameters, sides: Collection[str] = ()
) -> dict[str, Marker]:
    """All markers by name, left and right legs alike.

    Args:
        human: the wearer.
        sides: of the model's legs; empty if one leg stands for both.
    """
    markers = {}
    foot, trunk = human.foot.length_m, human.pelvis.length_m
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        letter, end = side[0].upper(), f"_{side}" if side in sides else ""
        for name, (x, z, out) in _FOOT.items():
            place = (x * foot, z * human.ankle_height_m)
            y = sign * (HALF_STANCE_M + out)
            markers[f"{letter}_{name}"] = Marker(f"foot{end}", *place, y)
        for name, (body, x, z, share, out) in _LEG.items():
            place = (x, z + share * getattr(human, body).length_m)
            y = sign * (HALF_STANCE_M + out)
            markers[f"{letter}_{name}"] = Marker(body + end, *place, y)
        for name, (x, z, y) in _SIDED_TRUNK.items():
            place = (x, z * trunk, sign * y)
            markers[f"{letter}_{name}"] = Marker("pelvis", *place)
    for name, (x, z) in _MIDDLE_TRUNK.items():
        markers[name] = Marker("pelvis", x, z * trunk, 0.0)
    return markers


def marker_positions(
    tree: PlanarTree, q: np.ndarray, markers: dict[str, Marker]
) -> np.ndarray:
    """Positions (N, M, 3) in the laboratory: x forward, y up, z right [m]."""
    positions = np.empty((len(q), len(markers), 3))
    for i, m in enumerate(markers.values()):
        p = tree.point_positions(q, m.body, (m.x_m, m.z_m))
        positions[:, i, 0], positions[:, i, 1] = p.T
        positions[:, i, 2] = -m.y_m
    return positions


def study_markers() -> dict:
    """The section `markers` of the study file."""

    def legs(*names):
        return {
            side: [f"{side[0].upper()}_{name}" for name in names]
            for side in SIDES
        }

    return {
        "joint_centres": {
            "ankle": legs("LMAL", "MMAL"),
            "knee": legs("LKNE", "MKNE"),
            "hip": legs("TROC"),
        },
        "segments": {
            "foot": legs("CAL", "MT1", "MT5", "TOE"),
            "shank": legs("SHK1", "SHK2", "SHK3", "SHK4", "LMAL", "MMAL"),
            "thigh": legs(
                "THI1", "THI2", "THI3", "THI4", "LKNE", "MKNE", "TROC"
            ),
            "pelvis": {
                **legs("ASI", "PSI", "SHO"),
                "middle": ["SACR", "L1", "T10", "T4", "C7", "CLAV", "STRN"],
            },
        },
    }


NOISE_M = 3e-4
# Standard deviation of the skin's slide per flexion of the joint [m/rad].
_SLIDE = {"foot": 0.0, "shank": 0.004, "thigh": 0.006, "pelvis": 0.004}
_JOINT = {"foot": "ankle", "shank": "knee", "thigh": "knee", "pelvis": "hip"}
_NEIGHBOURS = {
    "shank": ("ankle", "knee"),
    "thigh": ("knee", "hip"),
    "pelvis": ("hip",),
}
_GAPS = 6
_GAP_FRAMES = (4, 13)


def slides(markers: dict[str, Marker], rng: np.random.Generator) -> np.ndarray:
    """Slide of each marker (M, 2) along x, z of its link [m/rad], drawn."""
    spread = np.array([_SLIDE[m.segment] for m in markers.values()])
    return spread[:, None] * rng.normal(size=(len(markers), 2))


@dataclass(frozen=True)
class Skin:
    """Rotation of a segment's markers, on their skin, relative to the bone.

    The angle is linear * f + quadratic * f^2 about the markers' middle, where f
    is the weighted flexion of the neighbouring joints, `lag_s` before.

    Attributes:
        shares: joint -> its weight in f; weights sum to 1.
        linear: [rad/rad].
        quadratic: [rad/rad^2].
        lag_s: delay of the skin.
    """

    shares: dict[str, float]
    linear: float
    quadratic: float
    lag_s: float

    def turn(self, tree: PlanarTree, q: np.ndarray, rate_hz: float):
        """Angle (N,) [rad] along a motion q (N, nq) sampled at `rate_hz`."""
        joints = [tree.coordinates.index(name) for name in self.shares]
        f = q[:, joints] @ np.array(list(self.shares.values()))
        before = np.arange(len(f)) - self.lag_s * rate_hz
        f = np.interp(before, np.arange(len(f)), f)
        return self.linear * f + self.quadratic * f * f


def draw_skin(rng: np.random.Generator) -> dict[str, Skin]:
    """Segment -> skin drawn for it; none on the foot.

    Thigh artefacts are close to linear in the flexions of hip and knee,
    subject by subject (Camomilla et al., J. Biomechanics 46, 2013).
    """
    found = {}
    for name, joints in _NEIGHBOURS.items():
        drawn = rng.uniform()
        share = drawn if len(joints) == 2 else 1.0
        shares = dict(zip(joints, (share, 1.0 - share), strict=False))
        sign = rng.choice([-1.0, 1.0])
        found[name] = Skin(
            shares,
            float(sign * rng.uniform(0.02, 0.06)),
            float(rng.uniform(-0.02, 0.02)),
            float(rng.uniform(0.02, 0.06)),
        )
    return found


def turned_skin(
    tree: PlanarTree,
    q: np.ndarray,
    rate_hz: float,
    markers: dict[str, Marker],
    skin: dict[str, Skin],
) -> np.ndarray:
    """Displacement (N, M, 3) of markers by `Skin`, in OpenSim's axes [m]."""
    moved = np.zeros((len(q), len(markers), 3))
    for body, own in skin.items():
        on = [i for i, m in enumerate(markers.values()) if m.body == body]
        places = [list(markers.values())[i] for i in on]
        p = np.array([complex(m.x_m, m.z_m) for m in places])
        turn = np.exp(1j * own.turn(tree, q, rate_hz)) - 1.0
        link = np.exp(1j * tree.body_angles(q, body))
        slid = (link * turn)[:, None] * (p - p.mean())
        moved[:, on, 0], moved[:, on, 1] = slid.real, slid.imag
    return moved


def soft_tissue(
    tree: PlanarTree,
    q: np.ndarray,
    markers: dict[str, Marker],
    slide: np.ndarray,
) -> np.ndarray:
    """Displacement (N, M, 3) of markers by `slides`, in OpenSim's axes [m].

    It is proportional to flexion of the joint nearby, so there is next to none
    in standing, where the model's markers are placed.
    """
    moved = np.zeros((len(q), len(markers), 3))
    for i, marker in enumerate(markers.values()):
        joint = _JOINT[marker.segment]
        if joint not in tree.coordinates.names:
            joint = f"{joint}_{marker.side}"
        flexion = q[:, tree.coordinates.index(joint)]
        turn = np.exp(1j * tree.body_angles(q, marker.body))
        p = flexion * turn * complex(*slide[i])
        moved[:, i, 0], moved[:, i, 1] = p.real, p.imag
    return moved


def hide(positions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same positions (N, M, 3) with a few short gaps (NaN)."""
    n, m = positions.shape[:2]
    seen = positions.copy()
    for marker in rng.choice(m, _GAPS, replace=False):
        length = int(rng.integers(*_GAP_FRAMES))
        first = int(rng.integers(1, n - length - 1))
        seen[first : first + length, marker] = np.nan
    return seen


MAT_RATE_HZ = 50.0
CELL_AREA_M2 = 2e-4
_STEP_PA = 2500.0
_LARGEST_PA = 30000.0
_PITCH_M = np.sqrt(CELL_AREA_M2)
_PATCH_RAD, _PATCH_M = 0.45, 0.02  # widths of the patch, around and along
_FACETS = 96


@dataclass(frozen=True)
class MatDesign:
    """A mat on one face of a segment.

    Attributes:
        cuff: name of the cuff that presses on it.
        body: link of the human that it lies on.
        face: "front" or "back".
        rows, columns: numbers of cells.
        around: which index counts around the segment, "rows" or "columns"; the
            other counts along it.
        legs: if one leg stands for both, "left" for a mat on that leg alone,
            else "both"; None on a person of two legs.
    """

    cuff: str
    body: str
    face: str
    rows: int
    columns: int
    around: str
    legs: str | None = None

    @property
    def name(self) -> str:
        """Name of the mat in study and files."""
        return f"{self.cuff}_{self.face}"

    @property
    def segment(self) -> str:
        """Segment that it lies on, without the leg's side."""
        return self.body.split("_")[0]

    @property
    def tension_n(self) -> float:
        """Straps' tension: both legs', or one leg's of two [N]."""
        own_leg = self.legs is None and self.body != self.segment
        return (0.5 if own_leg else 1.0) * _TENSION_N[self.segment]


# Half axes of the segment's cross section, forward and left [m], and tension
# of its straps, both legs together [N].
_SECTION = {
    "shank": (0.058, 0.052),
    "thigh": (0.085, 0.078),
    "pelvis": (0.120, 0.170),
}
_TENSION_N = {"shank": 40.0, "thigh": 50.0, "pelvis": 50.0}
# Rows, columns, and which of them runs around the segment.
_CELLS = {
    "shank": (16, 8, "columns"),
    "thigh": (16, 8, "rows"),
    "pelvis": (32, 8, "rows"),
}


def _faces(cuff: str, body: str, legs: str | None) -> list[MatDesign]:
    cells = _CELLS[body.split("_")[0]]
    return [
        MatDesign(cuff, body, face, *cells, legs) for face in ("front", "back")
    ]


# Mats on the shipped exoskeleton: at the pelvis or on one leg.
CONFIGURATIONS = {
    "pelvis": tuple(_faces("pelvis", "pelvis", "both")),
    "legs": tuple(
        mat for part in ("thigh", "shank") for mat in _faces(part, part, "left")
    ),
}


def mats_of(model: Model) -> tuple[MatDesign, ...]:
    """Mats under every cuff of a person of two legs, except on feet."""
    ends = {cuff: human for cuff, (human, _) in model.tree.cuffs.items()}
    return tuple(
        mat
        for cuff, body in ends.items()
        if body.split("_")[0] in _CELLS
        for mat in _faces(cuff, body, None)
    )


MARKER_RATE_HZ = 100.0
DEVICE_RATE_HZ = 200.0
FILES = ("c3d", "opensim")
PLATES = {"left": 1, "right": 2, "chair": 3}
LARGEST_LAG_S = 0.04
_PER_FRAME = round(RATE_HZ / MARKER_RATE_HZ)

_FORCE_NOISE_N = 0.5
_MOMENT_NOISE_NM = 0.2
_OFFSET = np.array([2.0, 4.0, 0.5])  # F_x, F_z [N], M_y [N m]
_DRIFT = np.array([0.5, 1.5, 0.2])  # over a recording
_WIDE_DRIFT = np.array([2.0, 5.0, 0.5])
_EMPTY, _EMPTY_S = "plates_empty", 2.0  # recording of the empty plates
_ANGLE_NOISE = np.deg2rad(0.02)
_ANGLE_STEP = np.deg2rad(0.01)
_EXO_MOMENT_NOISE_NM = 0.1

# Middle of each plate, forward and to the right [m].
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


def drawn_clocks(rng: np.random.Generator, active: frozenset[str]) -> Clocks:
    """Lags of a movement's clocks; drawn also if "clocks" is not active."""
    lags = rng.uniform(-LARGEST_LAG_S, LARGEST_LAG_S, 2).round(3)
    return Clocks(*lags.tolist()) if "clocks" in active else Clocks()


@dataclass(frozen=True)
class Faults:
    """Systematic errors of instruments with a wide truth; none by default.

    Attributes:
        skin: segment -> how its skin turns.
        left_share: left leg's share of ground and cuff forces.
        encoder_offset_rad: of the device's ankle, knee, hip.
        mat_share: cuff -> share of its force that mats see.
        friction_share: share of each joint's friction that the bench found.
        plate_drift: largest drift over a recording, F_x, F_z [N], M_y [N m].
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
    """Draw the faults of a wide truth.

    Args:
        rng: numbers are drawn in the same order whatever is active.
        active: names of the disturbances that act.
        cuffs: names of the cuffs.
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
    """The instruments, the same for all movements, and the files they write.

    Attributes:
        folder: where files go.
        model: the subject with the device.
        files: "c3d" (markers and plates in one .c3d, device as .csv) or
            "opensim" (.trc and .mot).
        markers: on the subject, by name.
        slide: (M, 2) slide of the skin under them [m/rad], see `slides`.
        offsets: plate -> F_x, F_z [N], M_y [N m] of the empty plate.
        disturbances: names of those that act.
        faults: systematic errors.
        walkway_m: how far the feet's plates are extended forward.
    """

    folder: Path
    model: Model
    files: str
    markers: dict[str, Marker]
    slide: np.ndarray
    offsets: dict[str, np.ndarray]
    disturbances: frozenset[str]
    faults: Faults
    walkway_m: float = 0.0

    def __post_init__(self):
        if self.files not in FILES:
            raise InputError(
                f"files is {self.files!r}; give one of {', '.join(FILES)}"
            )

    def motion_files(self, name: str) -> dict[str, str]:
        """File names "markers" and "forces" of a recording."""
        if self.files == "c3d":
            return {"markers": f"{name}.c3d", "forces": f"{name}.c3d"}
        return {"markers": f"{name}.trc", "forces": f"{name}_forces.mot"}

    def device_file(self, name: str, what: str) -> str:
        """Name of the device's file of "encoders" or "moments"."""
        return f"{name}_{what}.{'csv' if self.files == 'c3d' else 'mot'}"

    def record_motion(self, movement: Trial, rng, hidden=True) -> None:
        """Write markers at 100 Hz and plates at 1000 Hz.

        Args:
            movement: the true movement.
            rng: of this recording.
            hidden: whether markers may be hidden at times.
        """
        active, tree = self.disturbances, self.model.tree
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
            foot: movement.ground.scaled(s) for foot, s in feet.items()
        }
        wrenches["chair"] = movement.chair
        self._write(movement.name, p, self._disturbed(wrenches, rng))

    @property
    def empty_files(self) -> dict[str, str]:
        """The study's key `empty_plates`, if plates drift."""
        if "plate_drift" not in self.disturbances:
            return {}
        return {"empty_plates": self.motion_files(_EMPTY)["forces"]}

    def record_empty(self, rng) -> None:
        """Write a recording of the empty plates, if plates drift."""
        if not self.empty_files:
            return
        n = round(_EMPTY_S * RATE_HZ) + 1
        nothing = PlanarWrench(np.zeros((n, 2)), np.zeros(n))
        plates = self._disturbed(dict.fromkeys(PLATES, nothing), rng, 0.0)
        frames = (n - 1) // _PER_FRAME + 1
        corner = np.zeros((frames, 1, 3))
        alone = replace(self, markers={"FLOOR": Marker("world", 0, 0, 0)})
        alone._write(_EMPTY, corner, plates)

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
            [_corners(place, self.walkway_m) for place in PLATES],
            _PER_FRAME,
        )

    def record_device(
        self, movement: Trial, clocks: Clocks, with_moments: bool, rng
    ) -> None:
        """Write encoders, and joint moments if the device records them."""
        time = np.arange(0.0, movement.times[-1], 1.0 / DEVICE_RATE_HZ)
        at = time - clocks.device
        names = movement.coordinates
        angles = movement.q[:, names.device_columns]
        angles = linear(movement.times, angles, at)
        angles = angles + self.faults.encoder_offset_rad
        moments = linear(movement.times, movement.device_moments, at)
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

    def record_pressure(
        self, movement: Trial, mats: Sequence[MatDesign], lag_s: float
    ) -> None:
        """Write the mats' pressures, if any, as Novel's software exports them.

        Args:
            movement: the true movement.
            mats: in the order of the file's columns.
            lag_s: lag of the mats' clock.
        """
        if not mats:
            return
        end = movement.times[-1]
        time = np.arange(1.0 / MAT_RATE_HZ, end, 1.0 / MAT_RATE_HZ)
        readings = []
        for mat in mats:
            force = movement.cuff(mat.cuff).normal
            normal = np.interp(time - lag_s, movement.times, force)
            share = self.faults.mat_share.get(mat.cuff, 1.0)
            if mat.legs == "left":
                share *= self.faults.left_share
            readings.append(share * cell_pressures(mat, self.model, normal))
        pressure = np.hstack(readings)
        if "pressure_steps" in self.disturbances:
            pressure = _STEP_PA * np.round(pressure / _STEP_PA)
            pressure = np.minimum(pressure, _LARGEST_PA)
        _write_asc(self.folder / f"{movement.name}.asc", time, pressure, mats)

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

    Below 20 N the point is the plate's middle, and the free moment compensates,
    so that the wrench is the same.
    """
    F_x, F_z = wrench.force.T
    x, right = _MIDDLE[place]
    force, point, torque = np.zeros((3, len(F_z), 3))
    force[:, 0], force[:, 1] = F_x, F_z
    point[:, 0] = np.where(wrench.is_loaded, wrench.cop_x, x)
    point[:, 2] = right
    # M_y is about y (left), so about -z (right) in the file. The force's offset
    # from the midline has no part in it: its moments are about x and y.
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
    """Resized to `count` samples, z up; the last sample is repeated."""
    i = np.minimum(np.arange(count), len(plate.force) - 1)
    parts = (_z_up(x[i]) for x in (plate.force, plate.point, plate.torque))
    return PlateRecording(plate.number, *parts)


def _corners(place: str, walkway_m: float = 0.0) -> np.ndarray:
    """Corners (4, 3) of a plate: forward right, back right, ... [m]."""
    x, right = _MIDDLE[place]
    half_x, half_y = _HALF_SIZE.get(place, _CHAIR_HALF_SIZE)
    if place in _HALF_SIZE:
        x, half_x = x + 0.5 * walkway_m, half_x + 0.5 * walkway_m
    return np.array(
        [
            (x + a * half_x, -(right + b * half_y), 0.0)
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
    )


def cell_pressures(
    mat: MatDesign, model: Model, normal: np.ndarray
) -> np.ndarray:
    """Pressure (N, cells) under the cuff's normal force (N,) [Pa].

    The forces on front and back differ by the normal force, and their product
    is the square of the straps' tension, so neither ever pulls.
    """
    middle = np.hypot(0.5 * normal, mat.tension_n)
    side = middle + (0.5 if mat.face == "back" else -0.5) * normal
    _, inward, around, along = cells(mat, model)
    shape = np.exp(-((around / _PATCH_RAD) ** 2) - (along / _PATCH_M) ** 2)
    total = CELL_AREA_M2 * np.sum(shape * np.abs(inward[:, 0]))
    return np.outer(side / total, shape)


def cells(mat: MatDesign, model: Model):
    """Cells of a mat in its segment's frame.

    Returns:
        Centres (C, 3) x forward, y left, z up along the segment [m]; inward
        normals (C, 3); angle (C,) around from the middle of the mat [rad];
        distance (C,) along the segment from the cuff [m].
    """
    a, b = _SECTION[mat.segment]
    middle = 0.0 if mat.face == "front" else np.pi
    turns, lengths = mat.rows, mat.columns
    if mat.around == "columns":
        turns, lengths = lengths, turns
    angle = _even_angles(a, b, turns, middle)
    height = (np.arange(lengths) - 0.5 * (lengths - 1)) * _PITCH_M
    grid = np.meshgrid(angle, height, indexing="ij")
    if mat.around == "columns":
        grid = [g.T for g in grid]
    angle, height = (g.ravel() for g in grid)
    cuff = model.cuffs[mat.cuff][1]
    centres = np.column_stack(
        [a * np.cos(angle), b * np.sin(angle), cuff + height]
    )
    normals = np.column_stack(
        [np.cos(angle) / a, np.sin(angle) / b, np.zeros(len(angle))]
    )
    normals /= -np.linalg.norm(normals, axis=1, keepdims=True)
    return centres, normals, angle - middle, height


def _even_angles(a, b, count, middle) -> np.ndarray:
    """Ellipse parameters (count,) one cell of arc apart, about `middle`."""
    fine = np.linspace(-np.pi, np.pi, 4001)
    x, y = a * np.cos(fine + middle), b * np.sin(fine + middle)
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
    places = (np.arange(count) - 0.5 * (count - 1)) * _PITCH_M
    return middle + np.interp(places + 0.5 * s[-1], s, fine)


def write_scans(
    folder: Path, model: Model, q: np.ndarray, mats: Sequence[MatDesign]
) -> dict[str, dict]:
    """Write the scanned segments and the cells on them, standing, in mm.

    Args:
        folder: receives scan_SEGMENT.obj and cells_MAT.csv.
        model: wearer and device.
        q: (nq,) standing posture.
        mats: mats on the segments.

    Returns:
        The study's section `mats`: mat -> its entry.
    """
    section = {}
    for mat in mats:
        to_world = _placed(model.tree, q, mat.body)
        length = getattr(model.human, mat.segment).length_m
        scan = folder / f"scan_{mat.body}.obj"
        if mat.face == "front":  # one scan shows both
            _write_surface(scan, *_SECTION[mat.segment], length, to_world)
        rows, columns = np.indices((mat.rows, mat.columns)).reshape(2, -1) + 1
        centres = 1e3 * to_world(cells(mat, model)[0])
        lines = [
            f"{r},{c}," + ",".join(f"{x:.4f}" for x in p)
            for r, c, p in zip(rows, columns, centres, strict=True)
        ]
        text = "\n".join(["row,column,x,y,z", *lines]) + "\n"
        (folder / f"cells_{mat.name}.csv").write_text(text, encoding="utf-8")
        axis = 1e3 * to_world(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, length]]))
        section[mat.name] = {
            "segment": mat.cuff,
            "rows": mat.rows,
            "columns": mat.columns,
            "cell_area_m2": CELL_AREA_M2,
            **({} if mat.legs is None else {"legs": mat.legs}),
            "scan": {
                "file": scan.name,
                "unit": "mm",
                "cells": f"cells_{mat.name}.csv",
                "segment_axis": axis.round(4).tolist(),
            },
        }
    return section


def _placed(tree: PlanarTree, q, body):
    """Function from a segment's frame to the world, (n, 3) to (n, 3)."""
    ((x, z, angle),) = tree.poses(np.asarray(q)[None], body)
    c, s = np.cos(angle), np.sin(angle)

    def to_world(p):
        return np.column_stack(
            [
                x + c * p[:, 0] - s * p[:, 2],
                p[:, 1],
                z + s * p[:, 0] + c * p[:, 2],
            ]
        )

    return to_world


def _write_surface(path: Path, a, b, length, to_world) -> None:
    """An elliptic cylinder as OBJ, in mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, _FACETS, endpoint=False)
    rings = max(round(length / 0.01), 2)
    heights = np.linspace(0.0, length, rings)
    p = np.array(
        [(a * np.cos(t), b * np.sin(t), h) for h in heights for t in angle]
    )
    lines = ["v " + " ".join(f"{x:.4f}" for x in v) for v in 1e3 * to_world(p)]
    for ring in range(rings - 1):
        for k in range(_FACETS):
            i, j = (ring * _FACETS + m % _FACETS + 1 for m in (k, k + 1))
            up_i, up_j = i + _FACETS, j + _FACETS
            lines += [f"f {i} {j} {up_j}", f"f {i} {up_j} {up_i}"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_asc(path: Path, time, pressure, mats) -> None:
    masks = "".join(
        f"{mat.name}: "
        + "".join(f"{k + 1}," for k in range(mat.rows * mat.columns))
        + "\n"
        for mat in mats
    )
    numbers = [k + 1 for m in mats for k in range(m.rows * m.columns)]
    head = (
        f"file name:  {path.stem}.sol\n"
        "sensor type:  pliance 2 cm2\n"
        f"total time [secs]:  {len(time) / MAT_RATE_HZ:.3f}\t"
        f"time per frame [secs]:  {1.0 / MAT_RATE_HZ:.5f}\t"
        f"scanning rate [Hz]:   {MAT_RATE_HZ:g}\n"
        "pressure values in  kPa\n\n"
        f"mask definition: \n{masks}\n"
        "time[secs]\t" + "\t".join(f"{k}" for k in numbers) + "\n"
    )
    rows = [
        f"{t:.5f}\t" + "\t".join(f"{x:.4g}" for x in 1e-3 * p)
        for t, p in zip(time, pressure, strict=True)
    ]
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
