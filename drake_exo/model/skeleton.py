"""The person's links and hinges, for one leg or two, with or without toes.

human.sdf holds the links of both legs as one. Two legs are that leg twice,
each with half its mass and inertia; toes are cut from the foot at its ball, so
that foot and toes together weigh and balance as the foot did.
"""

import copy
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace

from drake_exo.model.assembly import Person
from drake_exo.model.segments import HumanParameters, SegmentParameters

# Ours: the metatarsal heads lie at 72 % of the foot's length from the heel
# (22 % of it are behind the ankle), the sphere under them a little behind;
# toes are 14 % of the foot's mass, as in OpenSim's gait models.
_BALL_JOINT, _BALL_SPHERE = 0.50, 0.47
_TOE_MASS = 0.14
_TOE_TIP = 0.78
# Rod about its middle.
_ROD = 1.0 / 12.0


@dataclass(frozen=True)
class Hinge:
    """A hinge of the person.

    Attributes:
        name: of its coordinate.
        parent, child: frames that meet there.
        axis: 1 where the child turns toes down (about +y) as it grows, -1
            where it turns toes up.
    """

    name: str
    parent: str
    child: str
    axis: int


def hinges(person: Person) -> list[Hinge]:
    """Hinges of a person, from the root on.

    Flexion of knee and hip, dorsiflexion and toes up are positive.

    >>> [h.name for h in hinges(Person())]
    ['ankle', 'knee', 'hip']
    """
    if not person.sides:
        found = [
            Hinge("ankle", "foot", "shank", 1),
            Hinge("knee", "knee_centre", "thigh", -1),
            Hinge("hip", "hip_centre", "pelvis", 1),
        ]
    else:
        found = []
        for e in person.suffixes:
            found += [
                Hinge(f"hip{e}", "pelvis", f"hip_centre{e}", -1),
                Hinge(f"knee{e}", f"thigh{e}", f"knee_centre{e}", 1),
                Hinge(f"ankle{e}", f"shank{e}", f"foot{e}", -1),
            ]
    if person.toes == "hinged":
        # Each after its own leg.
        for e in person.suffixes:
            place = max(i for i, h in enumerate(found) if h.name.endswith(e))
            toes = Hinge(f"toes{e}", f"ball_centre{e}", f"toes{e}", -1)
            found.insert(place + 1, toes)
    return found


def ball_m(human: HumanParameters) -> tuple[float, float]:
    """Place (x, z) of the toes' hinge in the foot [m]."""
    if human.ball_m is not None:
        return human.ball_m
    return _BALL_JOINT * human.foot.length_m, human.toe_m[1]


def soles(
    human: HumanParameters, person: Person
) -> dict[str, dict[str, tuple[float, float]]]:
    """Segment -> its spheres' usual centres (x, z) in it [m]."""
    ball = (_BALL_SPHERE * human.foot.length_m, human.toe_m[1])
    foot = {"heel": human.heel_m, "ball": ball}
    toes: dict[str, tuple[float, float]] = {}
    if person.toes == "hinged":
        x, z = ball_m(human)
        toes = {"toe": (human.toe_m[0] - x, human.toe_m[1] - z)}
    else:
        foot["toe"] = human.toe_m
    found = {}
    for end in person.suffixes:
        found[f"foot{end}"] = foot
        if toes:
            found[f"toes{end}"] = toes
    return found


def assembled(
    model: ET.Element, human: HumanParameters, person: Person
) -> None:
    """Turn the one leg of human.sdf into the person's, in place."""
    inner = model.find("model")
    if person.toes == "hinged":
        _cut_toes(inner, human)
    if not person.sides:
        return
    leg = [
        element
        for element in inner
        if element.get("name") in person.parts
        or element.get("attached_to") in person.parts
    ]
    for element in leg:
        inner.remove(element)
    for side in person.sides:
        for element in leg:
            inner.append(_of_side(element, side))


def _of_side(element: ET.Element, side: str) -> ET.Element:
    """A link or frame of the leg as that of one side."""
    other = "left" if side == "right" else "right"
    element = copy.deepcopy(element)
    element.set("name", f"{element.get('name')}_{side}")
    if element.tag == "frame":
        element.set("attached_to", f"{element.get('attached_to')}_{side}")
        return element
    for number in ("mass", "inertia/ixx", "inertia/iyy", "inertia/izz"):
        found = element.find(f"inertial/{number}")
        found.text = repr(0.5 * float(found.text))
    for visual in element.findall("visual"):
        if visual.get("name").startswith(other):
            element.remove(visual)
    return element


def foot_and_toes(
    human: HumanParameters,
) -> tuple[SegmentParameters, SegmentParameters]:
    """The foot without its toes, and the toes in their own frame."""
    foot, (x, z) = human.foot, ball_m(human)
    toes = human.toes
    if toes is None:
        length = _TOE_TIP * foot.length_m - x
        mass = _TOE_MASS * foot.mass_kg
        toes = SegmentParameters(
            mass, (0.5 * length, 0.0), _ROD * mass * length**2, length
        )
    mass = toes.mass_kg
    rest = foot.mass_kg - mass
    place = (x + toes.com_m[0], z + toes.com_m[1])
    com = tuple(
        (foot.mass_kg * whole - mass * cut) / rest
        for whole, cut in zip(foot.com_m, place, strict=True)
    )

    def about(m, at):
        return m * sum(
            (a - b) ** 2 for a, b in zip(at, foot.com_m, strict=True)
        )

    inertia = foot.inertia_kg_m2 - toes.inertia_kg_m2
    inertia -= about(mass, place) + about(rest, com)
    # A foot so slender that nothing is left keeps a rod's.
    inertia = max(inertia, _ROD * rest * x**2)
    return replace(foot, mass_kg=rest, com_m=com, inertia_kg_m2=inertia), toes


def _cut_toes(model: ET.Element, human: HumanParameters) -> None:
    foot, toes = foot_and_toes(human)
    link = model.find("link[@name='foot']")
    _set_inertial(link.find("inertial"), foot)
    cut = ET.SubElement(model, "link", name="toes")
    cut.append(copy.deepcopy(link.find("inertial")))
    _set_inertial(cut.find("inertial"), toes)
    x, z = ball_m(human)
    frame = ET.SubElement(
        model, "frame", name="ball_centre", attached_to="foot"
    )
    ET.SubElement(frame, "pose").text = f"{x!r} 0 {z!r} 0 0 0"


def _set_inertial(inertial: ET.Element, segment: SegmentParameters) -> None:
    x, z = segment.com_m
    inertial.find("pose").text = f"{float(x)!r} 0 {float(z)!r} 0 0 0"
    inertial.find("mass").text = repr(float(segment.mass_kg))
    for axis in ("ixx", "iyy", "izz"):
        moment = inertial.find(f"inertia/{axis}")
        moment.text = repr(float(segment.inertia_kg_m2))
