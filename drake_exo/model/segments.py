"""Parameters of the planar segments of the human and of the exoskeleton.

All values are sums over both legs, in SI units and in the segment's own frame:
origin at its lower joint (foot: at the ankle), x forward and z up along the
segment in upright standing. Points are (x, z).

A subject's values follow from body mass, height and sex: P. de Leva,
"Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", J.
Biomechanics 29(9), 1996, Table 4: lengths, masses, centres of mass and radii of
gyration between joint centres, gamma-ray scans of 100 men (1.741 m, 73.0 kg)
and 15 women (1.735 m, 61.9 kg). The table prints no ankle height; it is taken
from D. A. Winter, Biomechanics and Motor Control of Human Movement, Fig. 4.1
(Drillis and Contini): 0.039 of the height.
"""

from dataclasses import (
    MISSING,
    dataclass,
    field,
    fields,
    is_dataclass,
    make_dataclass,
    replace,
)
from typing import Any, TypeVar

from drake_exo.errors import InputError, check_bounds
from drake_exo.files.schema import quantity

SEGMENTS = ("foot", "shank", "thigh", "pelvis")
CUFFED = SEGMENTS[1:]  # segments with a place for a cuff
LEG_JOINTS = ("ankle", "knee", "hip")  # between the segments, upwards

# Default radius of the contact spheres [m].
CONTACT_RADIUS_M = 0.032

# Its height as measured: of a small child, and in thick soles.
ANKLE = {"minimum": 0.02, "maximum": 0.3}
_FAR_M = 3.0  # a larger coordinate in a body was given in mm
IN_BODY = {"unit": "m", "minimum": -_FAR_M, "maximum": _FAR_M}


def place(default: Any = MISSING) -> Any:
    """A field for a point (x, z) in a segment's frame."""
    return field(default=default, metadata=IN_BODY)


@dataclass(frozen=True)
class SegmentParameters:
    """Mass distribution of one rigid segment, both legs together.

    Attributes:
        mass_kg: mass.
        com_m: centre of mass (x, z) in the segment's frame.
        inertia_kg_m2: moment of inertia for pitch about the centre of mass.
        length_m: distance to the next joint (foot: heel to tip of the toes;
            pelvis: hip to vertex, exoskeleton's pelvis: its height).
    """

    mass_kg: float = quantity("kg", above=0.0)
    com_m: tuple[float, float] = place()
    inertia_kg_m2: float = quantity("kg m^2", above=0.0)
    length_m: float = quantity("m", above=0.0, maximum=_FAR_M)

    def heavier(self, ratio: float) -> "SegmentParameters":
        """The same with mass and inertia times `ratio`."""
        return replace(
            self,
            mass_kg=ratio * self.mass_kg,
            inertia_kg_m2=ratio * self.inertia_kg_m2,
        )


@dataclass(frozen=True)
class _Chain:
    """What human and exoskeleton have in common."""

    foot: SegmentParameters
    shank: SegmentParameters
    thigh: SegmentParameters
    pelvis: SegmentParameters

    @property
    def mass_kg(self) -> float:
        """Mass of all segments."""
        return sum(getattr(self, name).mass_kg for name in SEGMENTS)

    def cuff_m(self, segment: str) -> tuple[float, float]:
        """Place (x, z) of the cuff in a segment [m]."""
        return getattr(self, f"{segment}_cuff_m")


@dataclass(frozen=True)
class HumanParameters(_Chain):
    """The human as four segments; the pelvis carries trunk, head and arms.

    Attributes:
        ankle_height_m: height of the ankle joint above the sole.
        heel_m, toe_m: centre of this contact sphere in the foot frame.
        shank_cuff_m, thigh_cuff_m, pelvis_cuff_m: place (l_x, l_z) of this
            cuff (human-exoskeleton bushing) in the human segment.
        toes: the foot's toes, in a frame at their hinge; None: they follow
            from the foot's mass and length.
        ball_m: place of that hinge in the foot; None: from its length.
    """

    ankle_height_m: float = quantity("m", **ANKLE)
    heel_m: tuple[float, float] = place()
    toe_m: tuple[float, float] = place()
    shank_cuff_m: tuple[float, float] = place()
    thigh_cuff_m: tuple[float, float] = place()
    pelvis_cuff_m: tuple[float, float] = place()
    toes: SegmentParameters | None = None
    ball_m: tuple[float, float] | None = place(None)

    @property
    def height_m(self) -> float:
        """Stature: ankle height, shank, thigh, and hip to vertex."""
        return (
            self.ankle_height_m
            + self.shank.length_m
            + self.thigh.length_m
            + self.pelvis.length_m
        )


@dataclass(frozen=True)
class ExoskeletonParameters(_Chain):
    """The exoskeleton: foot-plate, shank, thigh and pelvis module.

    Attributes:
        foot: the foot-plate, in the human foot's frame (it is welded to it);
            its length is that of the plate.
        heel_m, toe_m: centre of this contact sphere in the human foot's frame.
        shank_cuff_m, thigh_cuff_m, pelvis_cuff_m: place of the device's half
            of this cuff in the exoskeleton's segment; by default it coincides
            with the human half when both chains are aligned.
        knee_off_m, hip_off_m: offset (x, z) of this joint from the end of the
            segment below, where the wearer's joint is.
    """

    heel_m: tuple[float, float] = place()
    toe_m: tuple[float, float] = place()
    shank_cuff_m: tuple[float, float] = place()
    thigh_cuff_m: tuple[float, float] = place()
    pelvis_cuff_m: tuple[float, float] = place()
    knee_off_m: tuple[float, float] = place((0.0, 0.0))
    hip_off_m: tuple[float, float] = place((0.0, 0.0))


def _overrides(name: str, of: type, doc: str) -> type:
    """A dataclass with the fields of another, None where not replaced."""
    known = [
        (f.name, SegmentOverrides, SegmentOverrides())
        if f.type is SegmentParameters
        else (f.name, f.type | None, field(default=None, metadata=f.metadata))
        for f in fields(of)
        if f.default is MISSING
    ]
    namespace = {"__doc__": doc, "__module__": __name__}
    return make_dataclass(name, known, frozen=True, namespace=namespace)


SegmentOverrides = _overrides(
    "SegmentOverrides",
    SegmentParameters,
    "Values that replace scaled ones; what is left out stays.",
)
HumanOverrides = _overrides(
    "HumanOverrides",
    HumanParameters,
    "Values of the person that replace scaled ones.",
)
ExoskeletonOverrides = _overrides(
    "ExoskeletonOverrides",
    ExoskeletonParameters,
    "Values of the exoskeleton that replace fitted ones.",
)

_T = TypeVar("_T", SegmentParameters, HumanParameters, ExoskeletonParameters)


def with_overrides(parameters: _T, overrides: Any, where: str) -> _T:
    """Replace single values, segment by segment.

    Args:
        parameters: scaled or fitted values.
        overrides: the matching overrides class; its fields that are None keep
            the scaled value. None replaces nothing.
        where: name of the owner for messages, e.g. "human".

    Raises:
        InputError: value not finite, or not positive where it must be.
    """
    changes = {}
    for field_ in () if overrides is None else fields(overrides):
        name, label = field_.name, f"{where}.{field_.name}"
        value = getattr(overrides, name)
        if is_dataclass(value):
            part = getattr(parameters, name)
            changes[name] = with_overrides(part, value, label)
        elif value is not None:
            for number in value if isinstance(value, tuple) else (value,):
                check_bounds(label, number, field_.metadata)
            changes[name] = value
    found = replace(parameters, **changes)
    if changes and isinstance(found, SegmentParameters):
        gyration = (found.inertia_kg_m2 / found.mass_kg) ** 0.5
        if gyration > 1.0:  # no segment has all its mass that far out
            raise InputError(
                f"{where}: inertia_kg_m2 {found.inertia_kg_m2:g} of "
                f"{found.mass_kg:g} kg is that of a ring of {gyration:.2g} m "
                "radius; correct one of them, kg m^2 and kg"
            )
    return found


@dataclass(frozen=True)
class DeLevaRow:
    """One row of Table 4; a limb's row is for one limb.

    Attributes:
        mass: share of body mass [%].
        length: between the two reference points [mm] at `MEAN_HEIGHT_MM`.
        com: distance of the centre of mass from the first reference point, in
            percent of the length.
        gyration: radius of gyration about the transverse (left-right) axis,
            in percent of the length.
    """

    mass: float
    length: float
    com: float
    gyration: float


MEAN_HEIGHT_MM = {"male": 1741.0, "female": 1735.0}

# First reference point: head from the vertex, trunk from the suprasternale
# (to the mid-hip), arm, forearm, thigh and shank from their proximal joint,
# hand from the wrist (to the third metacarpale), foot from the heel.
# Men's head is 6.94 %: 0.694 of body mass, as some reprints say, is a slip.
# Women's shank is 432.3 mm: reprints with 423.3 put its centre of mass
# elsewhere than the row from the knee to the lateral malleolus does.
DE_LEVA = {
    "male": {
        "head": DeLevaRow(6.94, 203.3, 59.76, 37.6),
        "trunk": DeLevaRow(43.46, 531.9, 44.86, 34.7),
        "upper_arm": DeLevaRow(2.71, 281.7, 57.72, 26.9),
        "forearm": DeLevaRow(1.62, 268.9, 45.74, 26.5),
        "hand": DeLevaRow(0.61, 86.2, 79.00, 51.3),
        "thigh": DeLevaRow(14.16, 422.2, 40.95, 32.9),
        "shank": DeLevaRow(4.33, 434.0, 44.59, 24.9),
        "foot": DeLevaRow(1.37, 258.1, 44.15, 24.5),
    },
    "female": {
        "head": DeLevaRow(6.68, 200.2, 58.94, 35.9),
        "trunk": DeLevaRow(42.57, 529.3, 41.51, 33.9),
        "upper_arm": DeLevaRow(2.55, 275.1, 57.54, 26.0),
        "forearm": DeLevaRow(1.38, 264.3, 45.59, 25.7),
        "hand": DeLevaRow(0.56, 78.0, 74.74, 45.4),
        "thigh": DeLevaRow(14.78, 368.5, 36.12, 36.4),
        "shank": DeLevaRow(4.81, 432.3, 44.16, 26.7),
        "foot": DeLevaRow(1.29, 228.3, 40.14, 27.9),
    },
}

# Heights above the mid-hip, along the trunk [mm]: vertex (VERT-CERV plus
# CERV-MIDH) and mid-shoulder (MIDS-MIDH), alternative rows of Table 4.
VERTEX_HEIGHT_MM = {"male": 242.9 + 603.3, "female": 243.7 + 614.8}
SHOULDER_HEIGHT_MM = {"male": 515.5, "female": 497.9}

HEIGHTS_M, MASSES_KG = (0.9, 2.6), (15.0, 350.0)  # accepted of a subject
_ANKLE_HEIGHT = 0.039  # of body height, Winter
# Own choice, in parts of the foot's length: how far the heel's surface lies
# behind the ankle, and x of the spheres under calcaneus and toes.
_HEEL_BEHIND_ANKLE = 0.22
_HEEL_SPHERE = -0.173
_TOE_SPHERE = 0.636
# Own choice: cuffs in parts of the segment's length, hip belt of height.
_SHANK_CUFF = 0.60
_THIGH_CUFF = 0.55
_BELT = 0.060


def scale_human(
    mass_kg: float, height_m: float, sex: str = "male"
) -> HumanParameters:
    """Scale de Leva's mean body to a subject; arms hang at the sides.

    Lengths are in proportion to height, masses to body mass (their sum is the
    body mass exactly), centres of mass and radii of gyration to lengths.

    Args:
        mass_kg: body mass, without the exoskeleton.
        height_m: stature.
        sex: "male" or "female".

    Raises:
        InputError: mass, height or body mass index that nobody has; unknown
            sex.
    """
    if sex not in DE_LEVA:
        raise InputError(f"subject sex must be male or female, not {sex!r}")
    check_body(mass_kg, height_m, "subject")
    rows = DE_LEVA[sex]
    scale = height_m / MEAN_HEIGHT_MM[sex]
    ankle_height = _ANKLE_HEIGHT * height_m
    foot_length = rows["foot"].length * scale
    percent = {
        name: row.mass if name in ("head", "trunk") else 2.0 * row.mass
        for name, row in rows.items()
    }
    total = sum(percent.values())  # women's column adds up to 99.99
    mass = {name: mass_kg * (part / total) for name, part in percent.items()}

    def both_legs(name: str, com_m: tuple[float, float]) -> SegmentParameters:
        row, length = rows[name], rows[name].length * scale
        inertia = mass[name] * (row.gyration / 100.0 * length) ** 2
        return SegmentParameters(mass[name], com_m, inertia, length)

    def from_lower_joint(name: str) -> tuple[float, float]:
        row = rows[name]
        return 0.0, (1.0 - row.com / 100.0) * row.length * scale

    shank = both_legs("shank", from_lower_joint("shank"))
    thigh = both_legs("thigh", from_lower_joint("thigh"))
    foot_com_x = (rows["foot"].com / 100.0 - _HEEL_BEHIND_ANKLE) * foot_length
    sphere_z = CONTACT_RADIUS_M - ankle_height
    above_hip = height_m * (1.0 - _ANKLE_HEIGHT)
    above_hip = above_hip - shank.length_m - thigh.length_m
    return HumanParameters(
        foot=both_legs("foot", (foot_com_x, -0.5 * ankle_height)),
        shank=shank,
        thigh=thigh,
        pelvis=_upper_body(sex, mass, scale, above_hip),
        ankle_height_m=ankle_height,
        heel_m=(_HEEL_SPHERE * foot_length, sphere_z),
        toe_m=(_TOE_SPHERE * foot_length, sphere_z),
        shank_cuff_m=(0.0, _SHANK_CUFF * shank.length_m),
        thigh_cuff_m=(0.0, _THIGH_CUFF * thigh.length_m),
        pelvis_cuff_m=(0.0, _BELT * height_m),
    )


def check_body(mass_kg: float, height_m: float, who: str) -> None:
    """Refuse a mass and a height that nobody has.

    Raises:
        InputError: it names `who`, and what is wrong.
    """
    low, high = HEIGHTS_M
    if not low <= height_m <= high:
        raise InputError(
            f"{who} height_m must lie between {low:g} and {high:g} m, not "
            f"{height_m:g}; give metres"
        )
    low, high = MASSES_KG
    if not low <= mass_kg <= high:
        raise InputError(
            f"{who} mass_kg must lie between {low:g} and {high:g} kg, not "
            f"{mass_kg:g}; give kilograms"
        )
    index = mass_kg / height_m**2
    if not 8.0 <= index <= 100.0:
        raise InputError(
            f"{who} mass_kg {mass_kg:g} and height_m {height_m:g} give a "
            f"body mass index of {index:.1f}, which nobody has; check both"
        )


def _upper_body(
    sex: str, mass: dict[str, float], scale: float, length_m: float
) -> SegmentParameters:
    """Pelvis, trunk, head and straight arms as one rigid body."""
    rows = DE_LEVA[sex]
    elbow = SHOULDER_HEIGHT_MM[sex] - rows["upper_arm"].length
    wrist = elbow - rows["forearm"].length
    top = {
        "head": VERTEX_HEIGHT_MM[sex],
        "trunk": rows["trunk"].length,
        "upper_arm": SHOULDER_HEIGHT_MM[sex],
        "forearm": elbow,
        "hand": wrist,
    }
    z = {
        name: (top[name] - rows[name].com / 100.0 * rows[name].length) * scale
        for name in top
    }
    total = sum(mass[name] for name in top)
    com_z = sum(mass[name] * z[name] for name in top) / total
    inertia = sum(
        mass[name]
        * (
            (rows[name].gyration / 100.0 * rows[name].length * scale) ** 2
            + (z[name] - com_z) ** 2
        )
        for name in top
    )
    return SegmentParameters(total, (0.0, com_z), inertia, length_m)
