"""Parameters of the planar segments of the human and of the exoskeleton.

All values are sums over both legs (the legs move as one), in SI units, in the
segment's own frame: origin at its lower joint (the foot: at the ankle), x
forward and z up along the segment when standing straight. Points are (x, z).
"""

from collections.abc import Mapping
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

SEGMENTS = ("foot", "shank", "thigh", "pelvis")
CUFFED = SEGMENTS[1:]  # segments with a place for a cuff

# Radius of the heel and toe contact spheres when nothing else is said [m].
CONTACT_RADIUS_M = 0.032

_KILOGRAM = {"unit": "kg", "above": 0.0}
_METRE = {"unit": "m", "above": 0.0}
_INERTIA = {"unit": "kg m^2", "above": 0.0}
_POINT = {"unit": "m"}


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

    mass_kg: float = field(metadata=_KILOGRAM)
    com_m: tuple[float, float] = field(metadata=_POINT)
    inertia_kg_m2: float = field(metadata=_INERTIA)
    length_m: float = field(metadata=_METRE)


class _Chain:
    """What human and exoskeleton share."""

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
        heel_m, toe_m: centres of the contact spheres in the foot frame.
        shank_cuff_m, thigh_cuff_m, pelvis_cuff_m: origins (l_x, l_z) of the
            human-exoskeleton bushings in the human segments.
        toes: of the foot, in a frame at their hinge; by the foot's length if
            None.
        ball_m: place of that hinge in the foot; likewise.
    """

    foot: SegmentParameters
    shank: SegmentParameters
    thigh: SegmentParameters
    pelvis: SegmentParameters
    ankle_height_m: float = field(metadata=_METRE)
    heel_m: tuple[float, float] = field(metadata=_POINT)
    toe_m: tuple[float, float] = field(metadata=_POINT)
    shank_cuff_m: tuple[float, float] = field(metadata=_POINT)
    thigh_cuff_m: tuple[float, float] = field(metadata=_POINT)
    pelvis_cuff_m: tuple[float, float] = field(metadata=_POINT)
    toes: SegmentParameters | None = None
    ball_m: tuple[float, float] | None = field(default=None, metadata=_POINT)

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
        heel_m, toe_m: centres of the contact spheres in that frame.
        shank_cuff_m, thigh_cuff_m, pelvis_cuff_m: bushing origins in the
            exoskeleton's segments; they coincide with the human's when both
            chains are aligned.
        knee_off_m, hip_off_m: how far (x, z) these joints are from the end of
            the segment below, where the wearer's are.
    """

    foot: SegmentParameters
    shank: SegmentParameters
    thigh: SegmentParameters
    pelvis: SegmentParameters
    heel_m: tuple[float, float] = field(metadata=_POINT)
    toe_m: tuple[float, float] = field(metadata=_POINT)
    shank_cuff_m: tuple[float, float] = field(metadata=_POINT)
    thigh_cuff_m: tuple[float, float] = field(metadata=_POINT)
    pelvis_cuff_m: tuple[float, float] = field(metadata=_POINT)
    knee_off_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=_POINT)
    hip_off_m: tuple[float, float] = field(default=(0.0, 0.0), metadata=_POINT)


def _overrides(name: str, of: type, doc: str) -> type:
    """A dataclass with the fields of another, each None unless replaced."""
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
    "Values that replace scaled ones; None keeps the scaled value.",
)
HumanOverrides = _overrides(
    "HumanOverrides",
    HumanParameters,
    "Values of `HumanParameters` that replace scaled ones.",
)
ExoskeletonOverrides = _overrides(
    "ExoskeletonOverrides",
    ExoskeletonParameters,
    "Values of `ExoskeletonParameters` that replace fitted ones.",
)

_T = TypeVar("_T", SegmentParameters, HumanParameters, ExoskeletonParameters)


def with_overrides(parameters: _T, overrides: Any, where: str) -> _T:
    """Replace single values, segment by segment.

    Args:
        parameters: what scaling gave.
        overrides: None, an overrides dataclass, or a plain mapping such as
            `{"shank": {"mass_kg": 6.5}, "heel_m": (-0.05, -0.06)}`. Values
            that are None are kept as scaled.
        where: name of the owner for messages, e.g. "human".

    Raises:
        InputError: unknown name, value not finite, or not positive where it
            must be.
    """
    known = {f.name: f for f in fields(parameters) if f.default is MISSING}
    changes = {}
    for name, value in _items(overrides, where):
        if name not in known:
            raise InputError(
                f"{where} has no value '{name}' to override; "
                f"known are {', '.join(known)}"
            )
        if value is None:
            continue
        current = getattr(parameters, name)
        label = f"{where}.{name}"
        if is_dataclass(current):
            changes[name] = with_overrides(current, value, label)
        elif isinstance(current, tuple):
            changes[name] = _point(value, label)
        else:
            check_bounds(label, value, known[name].metadata)
            changes[name] = float(value)
    return replace(parameters, **changes)


def _items(overrides: Any, where: str) -> list[tuple[str, Any]]:
    if overrides is None:
        return []
    if isinstance(overrides, Mapping):
        return list(overrides.items())
    if is_dataclass(overrides):
        return [(f.name, getattr(overrides, f.name)) for f in fields(overrides)]
    raise InputError(
        f"{where}: overrides are names with values, not {overrides!r}"
    )


def _point(value: Any, label: str) -> tuple[float, float]:
    if isinstance(value, str) or not hasattr(value, "__len__"):
        raise InputError(f"{label} must be two numbers (x, z) in m")
    if len(value) != 2:
        raise InputError(f"{label} must be two numbers (x, z) in m")
    for coordinate in value:
        check_bounds(label, coordinate, _POINT)
    x, z = map(float, value)
    return x, z
