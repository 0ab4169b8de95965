"""The markers on the subject: 56 of them, as in the paper, and their errors.

Places are in the links' frames, in parts of what scales with the body: the
length of the segment and, of the foot, the height of the ankle. Errors are
what stands between bones and marker positions.
"""

from dataclasses import dataclass, replace

import numpy as np

from drake_exo.model.assembly import SIDES
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.segments import HumanParameters

# Half the distance between the legs' midlines [m].
HALF_STANCE_M = 0.09


@dataclass(frozen=True)
class Marker:
    """A marker fixed to a link.

    Attributes:
        body: link of the human.
        x_m, z_m: place in the link's frame.
        y_m: to the left of the body's midplane.
    """

    body: str
    x_m: float
    z_m: float
    y_m: float

    @property
    def segment(self) -> str:
        """Its link, whichever leg it is of."""
        return self.body.split("_")[0]

    def on_own_leg(self) -> "Marker":
        """The same on a person whose legs move on their own."""
        if self.body == "pelvis":
            return self
        return replace(self, body=f"{self.body}_{self.side}")

    @property
    def side(self) -> str:
        """Of the midplane."""
        return "left" if self.y_m > 0.0 else "right"


# Of each leg: link, x and z [m], z [segment's length], outwards [m].
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
# Of each foot: x [foot's length], z [ankle's height], outwards [m].
_FOOT = {
    "CAL": (-0.215, -0.55, 0.0),
    "MT1": (0.470, -0.60, -0.04),
    "MT5": (0.400, -0.70, 0.05),
    "TOE": (0.600, -0.65, 0.0),
}
# Of pelvis and trunk, on both sides: x [m], z [hip to vertex], y [m].
_SIDED_TRUNK = {
    "ASI": (0.090, 0.090, 0.13),
    "PSI": (-0.110, 0.100, 0.05),
    "SHO": (0.000, 0.610, 0.19),
    "ELB": (-0.030, 0.270, 0.24),
    "WRI": (0.020, -0.040, 0.25),
    "FHD": (0.090, 0.900, 0.07),
    "BHD": (-0.090, 0.910, 0.07),
}
# On the midline: x [m], z [hip to vertex].
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


def marker_set(human: HumanParameters) -> dict[str, Marker]:
    """All markers by name, left and right legs alike."""
    markers = {}
    foot, trunk = human.foot.length_m, human.pelvis.length_m
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        letter = side[0].upper()
        for name, (x, z, out) in _FOOT.items():
            place = (x * foot, z * human.ankle_height_m)
            y = sign * (HALF_STANCE_M + out)
            markers[f"{letter}_{name}"] = Marker("foot", *place, y)
        for name, (body, x, z, share, out) in _LEG.items():
            place = (x, z + share * getattr(human, body).length_m)
            y = sign * (HALF_STANCE_M + out)
            markers[f"{letter}_{name}"] = Marker(body, *place, y)
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
# Spread of how far skin slides for each radian of the joint nearby [m/rad].
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
    """How each marker slides (M, 2) along x and z of its link [m/rad]."""
    spread = np.array([_SLIDE[m.segment] for m in markers.values()])
    return spread[:, None] * rng.normal(size=(len(markers), 2))


@dataclass(frozen=True)
class Skin:
    """How the markers of a segment turn on it with what lies beneath.

    By linear * f + quadratic * f^2 about their middle, f being flexion of the
    neighbouring joints a lag before, each by its share.

    Attributes:
        shares: joint -> its share of f.
        linear: [rad/rad].
        quadratic: [rad/rad^2].
        lag_s: lag.
    """

    shares: dict[str, float]
    linear: float
    quadratic: float
    lag_s: float

    def turn(self, tree: PlanarTree, q: np.ndarray, rate_hz: float):
        """Angle (N,) [rad] along a motion q (N, nq) of that rate."""
        joints = [tree.coordinates.index(name) for name in self.shares]
        f = q[:, joints] @ np.array(list(self.shares.values()))
        before = np.arange(len(f)) - self.lag_s * rate_hz
        f = np.interp(before, np.arange(len(f)), f)
        return self.linear * f + self.quadratic * f * f


def draw_skin(rng: np.random.Generator) -> dict[str, Skin]:
    """Skin of the segments that have some, by name.

    Thigh artefacts are close to linear in the flexions of hip and knee,
    subject by subject (Camomilla et al., J. Biomechanics 46, 2013).
    """
    found = {}
    for name, joints in _NEIGHBOURS.items():
        share = rng.uniform()
        shares = dict(zip(joints, (share, 1.0 - share), strict=False))
        if len(joints) == 1:
            shares = {joints[0]: 1.0}
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
    """Displacement (N, M, 3) by skin that turns, in OpenSim's axes [m]."""
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
    """Displacement (N, M, 3) by sliding skin in OpenSim's axes [m].

    In proportion to the flexion of the joint nearby, so that there is next
    to none in standing, where markers are placed.
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
