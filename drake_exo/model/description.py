"""The model files, fitted to one subject by rewriting their numbers.

The SDF files hold links of a nominal adult and of an exoskeleton that fits
this adult. For a subject, mass properties and frames are taken from the
parameters, and visuals are stretched with the segment they are drawn on. This
module does not import pydrake, which takes long to load.

human.sdf holds the links of both legs as one. Two legs are that leg twice, each
with half its mass and inertia. Hinged toes are cut from the foot at its ball,
so that foot and toes together have the foot's mass, centre of mass and inertia.
"""

import copy
import importlib.resources
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drake_exo.model.assembly import Person
from drake_exo.model.segments import (
    SEGMENTS,
    ExoskeletonParameters,
    HumanParameters,
    SegmentParameters,
    scale_human,
    with_overrides,
)

# Own choice, x in parts of the foot's length from the ankle: the metatarsal
# heads lie at 72 % from the heel, which is 22 % behind the ankle; the sphere
# lies a little behind them. Toes are 14 % of its mass as in OpenSim's models.
_BALL_JOINT, _BALL_SPHERE = 0.50, 0.47
_TOE_MASS = 0.14
_TOE_TIP = 0.78
# Inertia of a rod about its middle, in parts of mass times length squared.
_ROD = 1.0 / 12.0


@dataclass(frozen=True)
class Hinge:
    """A hinge of the person.

    Attributes:
        name: name of its coordinate.
        parent, child: frames that it joins.
        axis: 1 if a growing coordinate turns the child toes down (about +y),
            -1 if toes up.
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
    found = []
    for e in person.suffixes:
        if person.sides:
            found += [
                Hinge(f"hip{e}", "pelvis", f"hip_centre{e}", -1),
                Hinge(f"knee{e}", f"thigh{e}", f"knee_centre{e}", 1),
                Hinge(f"ankle{e}", f"shank{e}", f"foot{e}", -1),
            ]
        else:
            found += [
                Hinge("ankle", "foot", "shank", 1),
                Hinge("knee", "knee_centre", "thigh", -1),
                Hinge("hip", "hip_centre", "pelvis", 1),
            ]
        if person.toes == "hinged":
            found.append(Hinge(f"toes{e}", f"ball_centre{e}", f"toes{e}", -1))
    return found


def ball_m(human: HumanParameters) -> tuple[float, float]:
    """Place (x, z) of the toes' hinge in the foot [m]."""
    if human.ball_m is not None:
        return human.ball_m
    return _BALL_JOINT * human.foot.length_m, human.toe_m[1]


def soles(
    human: HumanParameters, person: Person
) -> dict[str, dict[str, tuple[float, float]]]:
    """Segment -> sphere -> usual centre (x, z) in the segment [m]."""
    ball = (_BALL_SPHERE * human.foot.length_m, human.toe_m[1])
    parts = {"foot": {"heel": human.heel_m, "ball": ball, "toe": human.toe_m}}
    if person.toes == "hinged":
        (x, z), toe = ball_m(human), parts["foot"].pop("toe")
        parts["toes"] = {"toe": (toe[0] - x, toe[1] - z)}
    return {
        part + end: spheres
        for end in person.suffixes
        for part, spheres in parts.items()
    }


def assembled(
    model: ET.Element, human: HumanParameters, person: Person
) -> None:
    """Turn the one leg of human.sdf into the person's legs, in place."""
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
    """Copy of a link or frame of the one leg for one side, mass halved."""
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
    """The foot without its toes, and the toes in their hinge's frame."""
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
    # Where nothing is left of the inertia, the rest is taken as a rod.
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
    _set_pose(inertial, np.array([x, 0, z, 0, 0, 0]))
    inertial.find("mass").text = repr(float(segment.mass_kg))
    for axis in ("ixx", "iyy", "izz"):
        moment = inertial.find(f"inertia/{axis}")
        moment.text = repr(float(segment.inertia_kg_m2))


NOMINAL_MASS_KG = 70.0
NOMINAL_HEIGHT_M = 1.75
# Hinges of the shipped device: name, parent, frame on it, child, axis (±y).
_HINGES = (
    ("exo_ankle", "exo_foot", "exo_foot", "exo_shank", 1),
    ("exo_knee", "exo_shank", "exo_knee_centre", "exo_thigh", -1),
    ("exo_hip", "exo_thigh", "exo_hip_centre", "exo_pelvis", 1),
)


# Segment -> endings of the names of visuals that draw its cuff.
_CUFF_VISUALS = {
    "shank": ("_calf_strap", "_shin_guard"),
    "thigh": ("_thigh_strap", "_thigh_shell"),
    "pelvis": ("belt", "buckle"),
}


def models_path() -> Path:
    """Folder of package.xml and the SDF files, in checkout or wheel."""
    return Path(str(importlib.resources.files("drake_exo.models")))


@cache
def nominal_human() -> HumanParameters:
    """The adult that human.sdf describes."""
    return scale_human(NOMINAL_MASS_KG, NOMINAL_HEIGHT_M)


@cache
def nominal_exoskeleton() -> ExoskeletonParameters:
    """The device that exoskeleton.sdf describes."""
    model = _read("exoskeleton.sdf")

    def point(frame: str) -> tuple[float, float]:
        x, _, z = _pose(_frame(model, frame))[:3]
        return float(x), float(z)

    length = {
        "foot": point("plate_toe")[0] - point("plate_heel")[0],
        "shank": point("exo_knee_centre")[1],
        "thigh": point("exo_hip_centre")[1],
        "pelvis": point("pelvis_module_top")[1],
    }
    return ExoskeletonParameters(
        **{name: _segment(model, name, length[name]) for name in SEGMENTS},
        heel_m=point("exo_heel"),
        toe_m=point("exo_toe"),
        shank_cuff_m=point("exo_shank_cuff"),
        thigh_cuff_m=point("exo_thigh_cuff"),
        pelvis_cuff_m=point("exo_pelvis_cuff"),
    )


def fit_exoskeleton(
    human: HumanParameters, overrides: Any = None
) -> ExoskeletonParameters:
    """Fit the exoskeleton to a human: joints at joints, plate under the sole.

    Masses stay as in exoskeleton.sdf, since struts slide without getting
    heavier; centres of mass scale with length, inertias with its square.

    Args:
        human: the wearer.
        overrides: `ExoskeletonOverrides` that replace fitted values.

    Raises:
        InputError: an override is out of its bounds.
    """
    nominal, wearer = nominal_exoskeleton(), nominal_human()

    def slid(name: str) -> SegmentParameters:
        segment, length = getattr(nominal, name), getattr(human, name).length_m
        ratio = length / getattr(wearer, name).length_m
        x, z = segment.com_m
        return SegmentParameters(
            segment.mass_kg,
            (x, z * ratio),
            segment.inertia_kg_m2 * ratio**2,
            length,
        )

    plate_ratio = human.foot.length_m / wearer.foot.length_m
    drop = wearer.ankle_height_m - human.ankle_height_m

    def on_plate(point: tuple[float, float]) -> tuple[float, float]:
        return point[0] * plate_ratio, point[1] + drop

    foot = nominal.foot
    fitted = ExoskeletonParameters(
        foot=replace(
            foot,
            com_m=on_plate(foot.com_m),
            inertia_kg_m2=foot.inertia_kg_m2 * plate_ratio**2,
            length_m=foot.length_m * plate_ratio,
        ),
        shank=slid("shank"),
        thigh=slid("thigh"),
        pelvis=nominal.pelvis,
        heel_m=on_plate(nominal.heel_m),
        toe_m=on_plate(nominal.toe_m),
        shank_cuff_m=human.shank_cuff_m,
        thigh_cuff_m=human.thigh_cuff_m,
        pelvis_cuff_m=human.pelvis_cuff_m,
    )
    return with_overrides(fitted, overrides, "exoskeleton")


def refitted(
    device: ExoskeletonParameters,
    human: HumanParameters,
    other: HumanParameters,
) -> ExoskeletonParameters:
    """The device fitted to another body; values once overridden are kept.

    Args:
        device: fitted to `human`, with overrides.
        human: its wearer.
        other: the other body.
    """

    def kept(found, own, usual):
        changes = {}
        for name, value in vars(own).items():
            was = getattr(usual, name)
            if is_dataclass(value):
                changes[name] = kept(getattr(found, name), value, was)
            elif value != was:
                changes[name] = value
        return replace(found, **changes)

    return kept(fit_exoskeleton(other), device, fit_exoskeleton(human))


def human_sdf(
    human: HumanParameters, person: Person | None = None, drawn: bool = True
) -> str:
    """Text of human.sdf with this human's numbers and the person's legs.

    Args:
        human: the numbers.
        person: legs and toes; by default one leg for both.
        drawn: whether it keeps its visuals.
    """
    model, nominal = _read("human.sdf", drawn), nominal_human()
    width = body_width(human)
    for name in SEGMENTS:
        segment, reference = getattr(human, name), getattr(nominal, name)
        if name == "foot":
            x = segment.length_m / reference.length_m
            z = human.ankle_height_m / nominal.ankle_height_m
            size, place = (x, x, z), (x, width, z)
        else:
            z = segment.length_m / reference.length_m
            size = place = (width, width, z)
        _rewrite_link(model, name, segment, size, place)
    _set_frame(model, "knee_centre", (0.0, human.shank.length_m))
    _set_frame(model, "hip_centre", (0.0, human.thigh.length_m))
    _set_frame(model, "vertex", (0.0, human.pelvis.length_m))
    for name in ("heel", "toe", "shank_cuff", "thigh_cuff", "pelvis_cuff"):
        _set_frame(model, name, getattr(human, f"{name}_m"))
    assembled(model, human, person or Person())
    return _text(model)


def exoskeleton_sdf(
    exoskeleton: ExoskeletonParameters, width: float = 1.0, drawn: bool = True
) -> str:
    """Text of exoskeleton.sdf with this device's numbers.

    Args:
        exoskeleton: the device.
        width: the wearer's breadth over the nominal one, for the visuals.
        drawn: whether it keeps its visuals.
    """
    model, nominal = _read("exoskeleton.sdf", drawn), nominal_exoskeleton()
    for name in SEGMENTS:
        segment, reference = getattr(exoskeleton, name), getattr(nominal, name)
        x, z = width, segment.length_m / reference.length_m
        if name == "foot":
            x = z
            z = _sole_depth(exoskeleton) / _sole_depth(nominal)
        by = (x, width, z)
        _rewrite_link(model, f"exo_{name}", segment, by, by)
        if name in _CUFF_VISUALS:
            usual = np.array(nominal.cuff_m(name)) * (x, z)
            moved = np.array(exoskeleton.cuff_m(name)) - usual
            for visual in _cuff_visuals(_link(model, f"exo_{name}"), name):
                pose = _pose(visual)
                pose[[0, 2]] += moved
                _set_pose(visual, pose)
    for joint, below in (("knee", "shank"), ("hip", "thigh")):
        x, z = getattr(exoskeleton, f"{joint}_off_m")
        z += getattr(exoskeleton, below).length_m
        _set_frame(model, f"exo_{joint}_centre", (x, z))
    for name in ("heel", "toe", "shank_cuff", "thigh_cuff", "pelvis_cuff"):
        _set_frame(model, f"exo_{name}", getattr(exoskeleton, f"{name}_m"))
    return _text(model)


def _cuff_visuals(link: ET.Element, segment: str) -> list[ET.Element]:
    """Visuals of a device's link that draw its cuff."""
    ends = _CUFF_VISUALS[segment]
    return [v for v in link.findall("visual") if v.get("name").endswith(ends)]


def hinged(text: str) -> str:
    """The shipped device's SDF text with hinges added between its links."""
    model = ET.fromstring(text)
    for name, parent, frame, child, axis in _HINGES:
        pose = ET.Element("pose", relative_to=frame)
        pose.text = "0 0 0 0 0 0"
        _link(model, child).insert(0, pose)
        joint = ET.SubElement(
            model.find("model"), "joint", name=name, type="revolute"
        )
        for tag, text in (("parent", parent), ("child", child)):
            ET.SubElement(joint, tag).text = text
        xyz = ET.SubElement(ET.SubElement(joint, "axis"), "xyz")
        xyz.text = f"0 {axis} 0"
    return _text(model)


def without_cuffs(text: str, segments: Sequence[str]) -> str:
    """The shipped device's SDF text without the cuffs on some segments."""
    model = ET.fromstring(text)
    for segment in segments:
        link = _link(model, f"exo_{segment}")
        for visual in _cuff_visuals(link, segment):
            link.remove(visual)
        top = model.find("model")
        for frame in top.findall("frame"):
            if frame.get("name") == f"exo_{segment}_cuff":
                top.remove(frame)
    return _text(model)


def body_width(human: HumanParameters) -> float:
    """Breadth over the nominal human's, assuming equal density."""
    nominal = nominal_human()
    height = human.height_m / nominal.height_m
    return sqrt(human.mass_kg / nominal.mass_kg / height)


def _sole_depth(exoskeleton: ExoskeletonParameters) -> float:
    """Depth of the heel's sphere centre under the ankle; kept positive."""
    return max(-exoskeleton.heel_m[1], 0.01)


def _read(name: str, drawn: bool = True) -> ET.Element:
    """A shipped SDF file, without its visuals unless it is drawn."""
    root = ET.parse(models_path() / name).getroot()
    for link in () if drawn else root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return root


def _text(model: ET.Element) -> str:
    return ET.tostring(model, encoding="unicode")


def numbers(values) -> str:
    """Numbers as text for SDF or URDF: all digits, and 0 instead of -0."""
    return " ".join(repr(float(v) + 0.0) for v in values)


def _link(model: ET.Element, name: str) -> ET.Element:
    return model.find(f"model/link[@name='{name}']")


def _frame(model: ET.Element, name: str) -> ET.Element:
    return model.find(f"model/frame[@name='{name}']")


def _pose(element: ET.Element) -> np.ndarray:
    """Six numbers of the element's <pose>: x y z [m], roll pitch yaw [rad]."""
    return np.array(element.find("pose").text.split(), dtype=float)


def _set_pose(element: ET.Element, pose: np.ndarray) -> None:
    element.find("pose").text = numbers(pose)


def _set_frame(
    model: ET.Element, name: str, point: tuple[float, float]
) -> None:
    _set_pose(_frame(model, name), np.array([point[0], 0, point[1], 0, 0, 0]))


def _segment(
    model: ET.Element, name: str, length_m: float
) -> SegmentParameters:
    inertial = _link(model, f"exo_{name}").find("inertial")
    x, _, z = _pose(inertial)[:3]
    return SegmentParameters(
        float(inertial.find("mass").text),
        (float(x), float(z)),
        float(inertial.find("inertia/iyy").text),
        length_m,
    )


def _rewrite_link(
    model: ET.Element, name: str, segment: SegmentParameters, size, place
) -> None:
    """Set a link's inertia; scale sizes and places of its visuals by (3,)."""
    link = _link(model, name)
    _set_inertial(link.find("inertial"), segment)
    for visual in link.findall("visual"):
        _stretch_visual(visual, size, place)
    for frame in model.findall(f"model/frame[@attached_to='{name}']"):
        pose = _pose(frame)
        pose[:3] *= place
        _set_pose(frame, pose)


def _stretch_visual(visual: ET.Element, size, place) -> None:
    pose = _pose(visual)
    # A turned shape has its own axes; each grows by the stretch along it.
    # SDF's roll, pitch, yaw turn about fixed x, y, z.
    turn = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    axes = np.asarray(size)[:, None] * turn
    fx, fy, fz = np.linalg.norm(axes, axis=0)
    pose[:3] *= place
    _set_pose(visual, pose)
    shape = visual.find("geometry")[0]
    factors = {
        "size": (fx, fy, fz),
        "radii": (fx, fy, fz),
        "scale": (fx, fy, fz),
        "radius": (fx * fy * fz) ** (1.0 / 3.0)
        if shape.tag == "sphere"
        else sqrt(fx * fy),
        "length": fz,
    }
    for element in shape:
        if element.tag in factors:
            old = np.array(element.text.split(), dtype=float)
            element.text = numbers(np.atleast_1d(old * factors[element.tag]))
