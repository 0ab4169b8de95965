"""Variables of a design, and the design that their values make."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from drake_exo.calibration.settings import DesignSettings, JointFreedom
from drake_exo.calibration.wearers import Wearer
from drake_exo.contact.strap import (
    MOVABLE,
    RELEASES,
    STRAPS,
    Assistance,
    CuffDesign,
    Design,
    Gains,
    JointDesign,
    links_above,
    movable,
)
from drake_exo.errors import InputError
from drake_exo.model.assembly import other_side, without_side
from drake_exo.model.plant import Model
from drake_exo.model.segments import CUFFED

# Least distance of a cuff from the joints at its limb's ends.
_FROM_JOINT_M = 0.05
# A joint counts as driven if its torque reaches this share of the largest.
_DRIVEN = 0.05
# Displacements of the device's half of a cuff alone (forwards, up), and of a
# joint's place.
PRELOADS = ("preload_across_m", "preload_along_m")
OFFSETS = ("across_m", "along_m")
# What may change of a cuff beside its straps, and the device's place alone and
# gains of a joint's controller: field of the design -> typical size.
_CUFF = {
    "across_m": 0.01,
    "along_m": 0.01,
    **dict.fromkeys(PRELOADS, 0.005),
    "area": 0.1,
    **dict.fromkeys(RELEASES, 0.1),
}
_JOINT = dict.fromkeys(OFFSETS, 0.005)
GAINS = {
    "support": 0.1,
    "constant_nm": 1.0,
    "stiffness_nm_rad": 2.0,
    "damping_nm_s_rad": 0.5,
}
# How the name of a factor on a joint's torque begins, and ends if at an angle.
FACTOR, _DEG = "factor_at_", "_deg"


@dataclass(frozen=True)
class Variable:
    """A design variable.

    Attributes:
        name: such as "thigh.along_m" or "exo_knee.factor".
        unit: unit of its values.
        lower, upper: bounds; equal ones fix it.
        today: value that changes nothing.
        size: typical size of a change.
    """

    name: str
    unit: str
    lower: float
    upper: float
    today: float
    size: float

    @property
    def free(self) -> bool:
        """Whether it may change."""
        return self.lower < self.upper

    @property
    def is_strap(self) -> bool:
        """Whether it is the compliance of a strap."""
        return self.name.partition(".")[2] in STRAPS.values()

    def clipped(self, value: float) -> float:
        """The nearest value within the bounds."""
        return float(np.clip(value, self.lower, self.upper))

    def at_bound(self, value: float) -> bool:
        """Whether a value sits at a bound, within 0.5 % of the range.

        Natural limits do not count: a rigid strap; no slide, spring or damper
        at all; a free slide.
        """
        margin = 5e-3 * (self.upper - self.lower)
        what = self.name.partition(".")[2]
        released = what in RELEASES
        absent = self.lower == self.today == 0.0 and (released or what in GAINS)
        below = value <= self.lower + margin and not (self.is_strap or absent)
        above = value >= self.upper - margin and not (
            released and self.upper == 1.0
        )
        return self.free and (below or above)


def design_variables(
    wearers: Sequence[Wearer], settings: DesignSettings
) -> list[Variable]:
    """All variables: cuffs', then places of joints, then assistance.

    Straps are varied as compliance [m/N, rad/(N m)]; 0 is a rigid strap. If the
    design is symmetric, twins (`mirror_of`) have the bounds that both allow.

    Raises:
        InputError: it is symmetric, but the cuffs of a pair may not change
            alike, or a cuff or driven joint of one leg has no namesake.
    """
    found = []
    model = wearers[0].model
    for cuff in model.cuffs:
        _check_has_partner(
            cuff, model.tree.cuffs[cuff][0], model.cuffs, settings
        )
        freedom = settings.freedom(cuff)
        other = partner(cuff, model.cuffs, settings)
        if settings.freedom(other) != freedom:
            raise InputError(
                f"design.cuffs: {cuff} and {other} may not change alike, but "
                "symmetric is true; give both the same, under "
                f"{without_side(cuff)}"
            )
        along = _along(cuff, wearers, freedom.along_m)
        bounds = {**vars(freedom), "along_m": along}
        found += _variables(cuff, CuffDesign, bounds, _CUFF)
        for strap in STRAPS.values():
            softest, unit, size = (
                (freedom.strap_nm_rad, "rad/(N m)", 1e-2)
                if strap.endswith("rad")
                else (freedom.strap_n_m, "m/N", 1e-4)
            )
            most = 0.0 if softest is None else 1.0 / softest
            name = f"{cuff}.{strap}"
            found.append(Variable(name, unit, 0.0, most, 0.0, size))
    for joint in movable(model):
        free = settings.joints.get(joint, JointFreedom())
        found += _variables(joint, JointDesign, vars(free), _JOINT)
    gains = {
        "support": settings.assistance,
        "constant_nm": settings.gains.constant_nm,
        "stiffness_nm_rad": (0.0, settings.gains.stiffness_nm_rad),
        "damping_nm_s_rad": (0.0, settings.gains.damping_nm_s_rad),
    }
    names = model.coordinates
    for joint in _driven(wearers, settings):
        beside = names.follows(joint) or joint
        _check_has_partner(joint, beside, names.device, settings)
        if settings.assistance_over == "gains":
            found += _variables(joint, Gains, gains, GAINS)
            continue
        for place in _factors_at(joint, wearers, settings):
            name = f"{joint}.{FACTOR}{place}"
            found.append(Variable(name, "1", *settings.assistance, 1.0, 0.1))
    if not settings.symmetric:
        return found
    named = {v.name: v for v in found}
    pairs = [(v, named.get(mirror_of(v.name), v)) for v in found]
    return [
        replace(v, lower=max(v.lower, t.lower), upper=min(v.upper, t.upper))
        for v, t in pairs
    ]


def mirror_of(name: str) -> str:
    """Name of the variable of the other leg; itself if it has no side."""
    group, _, what = name.partition(".")
    return f"{other_side(group)}.{what}"


def partner(part: str, parts: Sequence[str], settings: DesignSettings) -> str:
    """The cuff or joint that changes alike; itself if there is none.

    Args:
        part: its name.
        parts: names of all.
        settings: the design's.
    """
    other = other_side(part)
    return other if settings.symmetric and other in parts else part


def _check_has_partner(part: str, limb: str, parts, settings) -> None:
    """Refuse a part of one leg that has none on the other to be alike.

    Args:
        part: a cuff's or joint's name.
        limb: the person's segment or joint that it goes with.
        parts: names of all.
        settings: the design's.
    """
    alone = partner(part, parts, settings) == part
    if settings.symmetric and alone and other_side(limb) != limb:
        raise InputError(
            f"design.symmetric: {part} goes with {limb}, but there is no name "
            "that differs from it in left and right alone; give both sides "
            f"such names, as {limb} and {other_side(limb)}, or leave "
            "symmetric out"
        )


def _variables(group: str, cls: type, bounds, sizes) -> list[Variable]:
    """A cuff's or joint's: units and today's values are those of the design."""
    known = {f.name: f for f in fields(cls)}
    return [
        Variable(
            f"{group}.{name}",
            known[name].metadata["unit"],
            *bounds[name],
            known[name].default,
            size,
        )
        for name, size in sizes.items()
    ]


def _driven(wearers: Sequence[Wearer], settings: DesignSettings) -> list[str]:
    """Joints of the device that are driven, not merely resist by friction.

    If the design is symmetric, with those that change alike.
    """
    names = wearers[0].model.coordinates
    trials = [(w, t) for w in wearers for t in w.trials]
    # Friction identified on a bench may be wrong: the torque has to be large
    # enough both with and without it.
    most, drive = (
        np.max([np.abs(x).max(axis=0) for x in torques], axis=0)
        for torques in (
            [t.device_moments for _, t in trials],
            [w.drive(t) for w, t in trials],
        )
    )
    driven = [
        joint
        for joint, moment in zip(
            names.device, np.minimum(most, drive), strict=True
        )
        if moment > _DRIVEN * most.max()
    ]
    return [
        joint
        for joint in names.device
        if {joint, partner(joint, names.device, settings)} & {*driven}
    ]


def _factors_at(joint: str, wearers, settings: DesignSettings) -> list[str]:
    """Ends of the names of a joint's factors: angles or places in time."""
    if settings.assistance_over == "angle":
        device = wearers[0].model.coordinates.device
        joints = {joint, partner(joint, device, settings)}
        angles = _angles(joints, wearers, settings.points)
        return [f"{angle:g}{_DEG}" for angle in angles]
    return [f"{k + 1}_of_{settings.points}" for k in range(settings.points)]


def _angles(joints: Iterable[str], wearers, count: int) -> np.ndarray:
    """Whole degrees (k,), evenly over the range of the joints' angles."""
    trials = [t for w in wearers for t in w.trials]
    seen = [t.coordinate(joint) for joint in joints for t in trials]
    lower, upper = (
        float(np.rad2deg(f([f(x) for x in seen]))) for f in (min, max)
    )
    points = np.round(np.linspace(lower, upper, count)) + 0.0  # no -0
    return np.unique(points) if count > 1 else np.zeros(1)


def _along(cuff: str, wearers, wanted) -> tuple[float, float]:
    """Bounds on a cuff's shift along the limb, for all wearers [m]."""
    lower, upper = wanted
    for wearer in wearers:
        segment = without_side(wearer.model.tree.cuffs[cuff][0])
        human = wearer.model.human
        place = wearer.contact.bushings[cuff].origin_z
        if segment in CUFFED:
            lowest = _FROM_JOINT_M
            highest = getattr(human, segment).length_m - _FROM_JOINT_M
        else:  # a foot has no length along its z: from the sole to the ankle
            lowest, highest = -human.ankle_height_m, 0.0
        lower = max(lower, min(lowest - place, 0.0))
        upper = min(upper, max(highest - place, 0.0))
    return lower, upper


def joints_below(model: Model, cuff: str) -> list[str]:
    """Joints that displace a cuff's link if their own place is moved."""
    _, link = model.tree.cuffs[cuff]
    return [j for j in movable(model) if link in links_above(model, j)]


def design_of(
    values: Mapping[str, float], without: Sequence[str] = ()
) -> Design:
    """The design that values of all variables make.

    Args:
        values: value of each variable by name.
        without: cuffs that are left out.
    """
    cuffs: dict[str, dict] = {cuff: {"removed": True} for cuff in without}
    joints: dict[str, dict] = {}
    factors: dict[str, dict[float, float]] = {}
    for name, value in values.items():
        group, _, what = name.partition(".")
        value = float(value)
        if is_assistance(name):
            factors.setdefault(group, {})[what] = value
        elif group in MOVABLE:
            joints.setdefault(group, {})[what] = value
        elif what.startswith("strap"):
            strap = 1.0 / value if value > 0.0 else None
            cuffs.setdefault(group, {})[what] = strap
        else:
            cuffs.setdefault(group, {})[what] = value
    given = {joint: assistance_of(v) for joint, v in factors.items()}
    return Design(
        {cuff: CuffDesign(**v) for cuff, v in cuffs.items()},
        {j: a for j, a in given.items() if isinstance(a, Assistance)},
        {joint: JointDesign(**v) for joint, v in joints.items()},
        {j: a for j, a in given.items() if isinstance(a, Gains)},
    )


def is_assistance(name: str) -> bool:
    """Whether a variable changes the torque of one of the device's joints."""
    what = name.partition(".")[2]
    return what.startswith(FACTOR) or what in GAINS


def assistance_of(factors: Mapping[str, float]) -> Assistance | Gains:
    """A joint's assistance, from its variables by the end of their names."""
    if set(factors) <= set(GAINS):
        return Gains(**factors)
    values = tuple(factors.values())
    places = [n.removeprefix(FACTOR) for n in factors]
    angles = [n.removesuffix(_DEG) for n in places if n.endswith(_DEG)]
    if angles:
        return Assistance(tuple(map(float, angles)), values)
    return Assistance((), values, "movement")
