"""Conversion of a scaled OpenSim model to the planar person.

The model is taken with all coordinates at zero, except those that it locks or
couples elsewhere and the lengths among them, and projected on its sagittal
plane, seen from the right.
Thigh, shank, foot and toes are the bodies femur, tibia, talus with calcn, and
toes of OpenSim's gait models, with what hangs on them; the rest (pelvis, torso,
arms) is one trunk. A knee that rolls and slides (a CustomJoint) becomes a pin
at its place at 0°. Legs that differ are averaged.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.osim import OsimJoint, OsimModel, read_osim
from drake_exo.model.assembly import Person
from drake_exo.model.segments import (
    HumanParameters,
    SegmentParameters,
    scale_human,
)

ENDS = {"left": "_l", "right": "_r"}
# Body of the file -> segment; bodies that hang on it belong to it, too.
_BODIES = {
    "femur": "thigh",
    "tibia": "shank",
    "talus": "foot",
    "calcn": "foot",
    "toes": "toes",
}
_TRUNK = ("pelvis", "torso")  # bodies whose markers follow the trunk
# Joint -> the body below it.
JOINTS = {"hip": "femur", "knee": "tibia", "ankle": "talus", "toes": "toes"}
# The metatarsal heads lie at this part of the foot's length from the heel, as
# in `skeleton`; calcn's origin is the heel's back.
_BALL = 0.72
_TOE_TIP = 1.0
# A foot's length by that, over the usual one at this stature; beyond these
# calcn's origin is not the heel, but a joint or what CAD or CT left.
_SHORTEST, _LONGEST = 0.7, 1.4
_FLEXED = np.deg2rad(100.0)  # flexion up to which a joint is compared to a pin
_STEP = 1e-6  # rad


@dataclass(frozen=True)
class OsimPerson:
    """An OpenSim model projected on the sagittal plane, coordinates at zero.

    Points are complex, x + i z [m], from the middle of the hips, z up.

    Attributes:
        osim: the model.
        human: parameters of the planar person, sums over both legs.
        segments: body -> (segment, side) that it is part of; the trunk's is
            ("pelvis", None).
        middle: midpoint of the hips, from the pelvis's origin.
        places: side -> "hip", "knee", "ankle", "heel" and, where there are
            toes, "toes" (their hinge) -> point.
        markers: name -> (segment, side, point); none of the arms.
        notes: sentences on what the projection changed.
    """

    osim: OsimModel
    human: HumanParameters
    segments: dict[str, tuple[str, str | None]]
    middle: complex
    places: dict[str, dict[str, complex]]
    markers: dict[str, tuple[str, str | None, complex]]
    notes: tuple[str, ...]


def read_person(
    path: str | Path, person: Person, height_m: float, sex: str = "male"
) -> OsimPerson:
    """Read the planar person from a .osim file.

    Lengths, masses, centres of mass and inertias are the file's. What it does
    not hold follows from the stature: heights of the vertex and of the ankle,
    places of contact spheres and of cuffs.

    Args:
        path: path of the file.
        person: which legs and toes the planar person has.
        height_m: stature.
        sex: "male" or "female", for de Leva's tables.

    Raises:
        InputError: no such file, or not the bodies of OpenSim's gait models.
    """
    osim = read_osim(path)
    segments = _segments(osim)
    apart = [name for name in osim.bodies if name not in segments]
    osim = _without(osim, apart)
    hinges = _hinges(osim, person, segments)
    kept = {c for _, _, c in hinges} | {*osim.joint_of("pelvis").coordinates}
    rest = {name: at for name, at in osim.rest.items() if name not in kept}
    osim = replace(osim, rest=rest)
    poses = {name: (R[0], p[0]) for name, (R, p) in osim.poses().items()}
    R_GP, p_GP = upright(osim), poses["pelvis"][1]

    def flat(body: str, p_B: np.ndarray) -> complex:
        R, p = poses[body]
        x, y, _ = R_GP.T @ (p + R @ p_B - p_GP)
        return complex(x, y)

    def own(end: str) -> dict[str, complex]:
        found = {
            joint: flat(body + end, osim.joint_of(body + end).X_CM.p)
            for joint, body in JOINTS.items()
            if segments.get(body + end, ("",))[0] == _BODIES[body]
        }
        return {**found, "heel": flat(f"calcn{end}", np.zeros(3))}

    places = {side: own(end) for side, end in ENDS.items()}
    toes = all("toes" in found for found in places.values())
    if person.toes == "hinged" and not toes:
        raise InputError(
            f"{path}: has no bodies toes_r and toes_l; say toes: rigid"
        )
    middle = complex(np.mean([found["hip"] for found in places.values()]))
    places = {
        side: {name: p - middle for name, p in found.items()}
        for side, found in places.items()
    }
    lumps: dict[tuple[str, str | None], _Lump] = {}
    for name, body in osim.bodies.items():
        turned = R_GP.T @ poses[name][0]
        inertia = turned @ body.inertia_kg_m2 @ turned.T
        com = flat(name, body.com_m) - middle
        one = _Lump(body.mass_kg, com, float(inertia[2, 2]))
        lumps[segments[name]] = lumps.get(segments[name], _Lump()) + one
    for side, at in places.items():
        for name, upper, lower in (
            ("thigh", "hip", "knee"),
            ("shank", "knee", "ankle"),
        ):
            if not 0.05 < abs(at[upper] - at[lower]) < 1.5:
                raise InputError(
                    f"{path}: the {side} {name} is "
                    f"{abs(at[upper] - at[lower]):.3f} m long, not 0.05 to "
                    "1.5 m; give a model in metres, scaled to the person"
                )
    legs = [_leg(lumps, side, at) for side, at in places.items()]
    markers = {
        name: (*segments[body], flat(body, p_B) - middle)
        for name, (body, p_B) in osim.markers.items()
        if segments[body][0] != "pelvis" or body in _TRUNK
    }
    usual = scale_human(osim.mass_kg, height_m, sex)
    human = _human(osim, lumps["pelvis", None], legs, places, usual, person)
    notes = (
        *([_APART + ", ".join(apart)] if apart else []),
        *_unlike(legs),
        *_heel_note(legs, human),
        *_joint_notes(osim, hinges),
    )
    return OsimPerson(osim, human, segments, middle, places, markers, notes)


_APART = "left out, as the ground holds them, not the pelvis: "


def _without(osim: OsimModel, apart: list[str]) -> OsimModel:
    """The model without some bodies, such as a chair."""
    return replace(
        osim,
        bodies={n: b for n, b in osim.bodies.items() if n not in apart},
        joints=tuple(j for j in osim.joints if j.child not in apart),
        markers={n: m for n, m in osim.markers.items() if m[0] not in apart},
    )


def upright(osim: OsimModel) -> np.ndarray:
    """Rotation (3, 3) to the ground from the axes in which the pelvis moves.

    These are x forward, y up; a pelvis's own may be others, such as CT's.
    """
    (R, *_), _ = osim.poses()["pelvis"]
    return R @ osim.joint_of("pelvis").X_CM.R


def _segments(osim: OsimModel) -> dict[str, tuple[str, str | None]]:
    """Body -> the (segment, side) that it is part of."""
    known = {"pelvis": ("pelvis", None)}
    for side, end in ENDS.items():
        known |= {body + end: (s, side) for body, s in _BODIES.items()}
    if not all(f"toes{end}" in osim.bodies for end in ENDS.values()):
        # A foot without toes, such as a prosthesis: both are rigid.
        known = {b: s for b, s in known.items() if s[0] != "toes"}
    needed = [b for b in known if not b.startswith("toes")]
    missing = [b for b in needed if b not in osim.bodies]
    if missing:
        raise InputError(
            f"{osim.source}: has no body {missing[0]!r}; a person is read from "
            "bodies named as in OpenSim's gait models: pelvis, femur_r, "
            f"tibia_r, talus_r, calcn_r, likewise _l; it has "
            f"{', '.join(osim.bodies)}"
        )
    found: dict[str, tuple[str, str | None]] = {}
    for joint in osim.joints:  # parents first
        if joint.parent in found or joint.child == "pelvis":
            above = found.get(joint.parent)
            found[joint.child] = known.get(joint.child, above)
    chain = ["pelvis", *_BODIES]
    for body in needed:
        name, _, end = body.rpartition("_")
        above = chain[chain.index(name) - 1] if name else "ground"
        above = f"{above}_{end}" if above in _BODIES else above
        if osim.joint_of(body).parent != above:
            raise InputError(
                f"{osim.source}: body {body!r} hangs from "
                f"{osim.joint_of(body).parent!r}, not from {above!r} as in "
                "OpenSim's gait models; rename the bodies of another model"
            )
    return found


@dataclass(frozen=True)
class _Lump:
    """Bodies as one: mass [kg], centre x + i z [m], inertia about it."""

    mass: float = 0.0
    com: complex = 0.0
    inertia: float = 0.0

    def __add__(self, other: "_Lump") -> "_Lump":
        mass = self.mass + other.mass
        if not mass > 0.0:
            return self
        com = (self.mass * self.com + other.mass * other.com) / mass
        inertia = sum(
            part.inertia + part.mass * abs(part.com - com) ** 2
            for part in (self, other)
        )
        return _Lump(mass, com, inertia)

    def seen(self, origin: complex, along: complex) -> "_Lump":
        """The same in a frame at `origin` with z along the vector `along`."""
        return replace(self, com=(self.com - origin) * 1j * abs(along) / along)


# Segment -> its mass distribution and its length [m].
_Leg = dict[str, tuple[_Lump, float]]


def _leg(lumps, side: str, at: dict[str, complex]) -> _Leg:
    """Segments of one leg in their own frames, from joint places `at`."""
    thigh, shank = at["hip"] - at["knee"], at["knee"] - at["ankle"]
    leg = {
        "thigh": (lumps["thigh", side].seen(at["knee"], thigh), abs(thigh)),
        "shank": (lumps["shank", side].seen(at["ankle"], shank), abs(shank)),
    }
    foot = lumps["foot", side]
    length = abs((at["ankle"] - at["heel"]).real)
    if "toes" in at:
        toes = lumps["toes", side]
        foot += toes
        length = (at["toes"] - at["heel"]).real / _BALL
        leg["toes"] = (toes.seen(at["toes"], 1j), 0.0)  # by the foot's
    leg["foot"] = (foot.seen(at["ankle"], 1j), length)
    return leg


def _human(
    osim, trunk: _Lump, legs, places, usual: HumanParameters, person: Person
) -> HumanParameters:
    """The planar person; what the model lacks follows from the stature."""

    def both(name: str) -> SegmentParameters:
        pair = [leg[name][0] for leg in legs]
        if any(not (lump.mass > 0.0 and lump.inertia > 0.0) for lump in pair):
            raise InputError(
                f"{osim.source}: the {name} weighs nothing or has no inertia "
                "about the sideways axis; give it mass and inertia there"
            )
        com = np.mean([lump.com for lump in pair])
        return SegmentParameters(
            sum(lump.mass for lump in pair),
            (float(com.real), float(com.imag)),
            float(sum(lump.inertia for lump in pair)),
            float(np.mean([leg[name][1] for leg in legs])),
        )

    height_m = usual.height_m
    thigh, shank, foot = both("thigh"), both("shank"), both("foot")
    toes, ball, told = None, None, 0.0
    if all("toes" in leg for leg in legs):
        told = foot.length_m / usual.foot.length_m
        # Some models leave toes next to nothing, and all to the rest.
        own = [leg["toes"][0] for leg in legs]
        if person.toes == "hinged" or all(x.mass * x.inertia for x in own):
            toes = both("toes")
        forward = np.mean([p["toes"] - p["ankle"] for p in places.values()])
        ball = float(forward.real), float(forward.imag)
    # Else nothing in the model says how long the foot is.
    if not _SHORTEST < told < _LONGEST:
        foot = replace(foot, length_m=usual.foot.length_m)
    if toes is not None:
        tip = (_TOE_TIP - _BALL) * foot.length_m
        toes = replace(toes, length_m=tip)
    ratio = foot.length_m / usual.foot.length_m
    above = height_m - usual.ankle_height_m - shank.length_m - thigh.length_m
    return replace(
        usual,
        foot=foot,
        shank=shank,
        thigh=thigh,
        pelvis=SegmentParameters(
            trunk.mass,
            (float(trunk.com.real), float(trunk.com.imag)),
            float(trunk.inertia),
            above,
        ),
        heel_m=(ratio * usual.heel_m[0], usual.heel_m[1]),
        toe_m=(ratio * usual.toe_m[0], usual.toe_m[1]),
        shank_cuff_m=_along(usual.shank_cuff_m, shank, usual.shank),
        thigh_cuff_m=_along(usual.thigh_cuff_m, thigh, usual.thigh),
        toes=toes,
        ball_m=ball,
    )


def _along(cuff_m, segment, usual) -> tuple[float, float]:
    """Place of a cuff, its height scaled to the segment's length."""
    x, z = cuff_m
    return x, z * segment.length_m / usual.length_m


def _unlike(legs: list[_Leg]):
    """Yield a note for each segment that differs between the legs."""
    left, right = legs
    for name, (lump, length) in left.items():
        other, width = right[name]
        off = max(abs(lump.com - other.com), abs(length - width))
        heavier = abs(lump.mass - other.mass)
        if off > 1e-4 or heavier > 1e-3:
            yield (
                f"the {name}s differ by {1e3 * off:.1f} mm and "
                f"{heavier:.3f} kg; their mean is taken"
            )


def _heel_note(legs: list[_Leg], human: HumanParameters):
    """Yield a note if the foot's length is not the model's."""
    told = np.mean([leg["foot"][1] for leg in legs])
    if human.ball_m is not None and abs(told - human.foot.length_m) > 1e-9:
        yield (
            f"calcn's origin is not at the heel (the foot would be {told:.2f} "
            f"m long); its length, {human.foot.length_m:.2f} m, is by stature"
        )


def flexing(osim: OsimModel, joint: OsimJoint) -> tuple[str, float] | None:
    """The joint's coordinate that turns its child most in the sagittal plane.

    Returns:
        Its name, and the child's rotation per unit of it, counter-clockwise
        seen from the right; None if no coordinate turns the child there.
    """
    rates = {
        name: _turned(osim, joint, name, np.array([-_STEP, _STEP]))[0]
        for name in joint.coordinates
    }
    rates = {n: (x[1] - x[0]) / (2.0 * _STEP) for n, x in rates.items()}
    best = max(rates, key=lambda name: abs(rates[name]), default=None)
    if best is None or not abs(rates[best]) > 0.5:
        return None
    return best, float(rates[best])


def _turned(osim: OsimModel, joint: OsimJoint, coordinate: str, q: np.ndarray):
    """Child's rotation in the plane and tilt out of it, both (n,) [rad]."""
    poses = osim.poses({coordinate: q}, len(q))
    R_GP = upright(osim)
    zero = osim.poses()[joint.child][0][0]
    R = R_GP.T @ poses[joint.child][0] @ zero.T @ R_GP
    return np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arccos(
        np.clip(R[:, 2, 2], -1.0, 1.0)
    )


def _hinges(osim: OsimModel, person: Person, segments):
    """(Name, joint, its coordinate or None) of each hinge that a person has."""
    found = []
    for end in ENDS.values():
        for name, body in JOINTS.items():
            if segments.get(body + end, ("",))[0] != _BODIES[body]:
                continue
            if name == "toes" and person.toes == "rigid":
                continue
            joint = osim.joint_of(body + end)
            coordinate, _ = flexing(osim, joint) or (None, 0.0)
            if coordinate is None and name != "toes":
                raise InputError(
                    f"{osim.source}: joint {joint.name!r} has no coordinate "
                    "that turns it in the sagittal plane; free one there"
                )
            found.append((name, joint, coordinate))
    return found


def _joint_notes(osim: OsimModel, hinges):
    """Yield notes on joints that are no pins about the plane's normal."""
    kept = {"pelvis_tilt", "pelvis_tx", "pelvis_ty"}
    for name, joint, coordinate in hinges:
        if coordinate is None:
            yield f"joint {joint.name!r} is fixed; here it is a hinge"
            continue
        kept.add(coordinate)
        if name != "hip":
            yield from _strays(osim, joint, coordinate)
    lost = [c for j in osim.joints for c in j.coordinates if c not in kept]
    if still := [c for c in lost if c not in osim.rest]:
        names = ", ".join(still)
        yield f"stay at zero, as the planar person lacks them: {names}"
    if held := [f"{c} at {osim.rest[c]:.4g}" for c in lost if c in osim.rest]:
        yield (
            "stay where the model has them by default (rad or m): "
            f"{', '.join(held)}"
        )


def _strays(osim: OsimModel, joint: OsimJoint, coordinate: str):
    """Yield notes on how far a joint is from a pin at its 0 degrees."""
    lower, upper = joint.ranges[joint.coordinates.index(coordinate)]
    q = np.linspace(max(lower, -_FLEXED), min(upper, _FLEXED), 101)
    rest = osim.at_rest
    _, p, *_ = joint.across(rest(len(q)) | {coordinate: q}, len(q))
    off = np.linalg.norm(p - joint.across(rest(1), 1)[1], axis=1)
    if off.max() > 1e-5:
        yield (
            f"joint {joint.name!r} slides; it becomes a pin where it is at 0 "
            f"degrees, up to {1e3 * off.max():.1f} mm away (at "
            f"{np.rad2deg(q[np.argmax(off)]):.0f} degrees), "
            f"{1e3 * np.sqrt(np.mean(off**2)):.1f} mm RMS"
        )
    _, out = _turned(osim, joint, coordinate, q)
    if out.max() > np.deg2rad(1.0):
        yield (
            f"joint {joint.name!r} leaves the sagittal plane by up to "
            f"{np.rad2deg(out.max()):.0f} degrees (at "
            f"{np.rad2deg(q[np.argmax(out)]):.0f} degrees); here it does not"
        )
