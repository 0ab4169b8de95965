"""A device of the user's own: its file, and whether it fits into the plane.

What the file says is brought into the person's frames once, when a study is
read: x forward, joints that are to be held made fixed, and links that are
named as segments of the person renamed.
"""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from drake_exo.errors import InputError, reason
from drake_exo.files.tables import read_text
from drake_exo.model.assembly import Assembly, DeviceFile, Weld

_KINDS = (".sdf", ".urdf")
_STRAIGHT = 1e-6  # largest part of an axis that leaves y


def with_text(assembly: Assembly, root: Path) -> Assembly:
    """The assembly with what its device's file says.

    Args:
        assembly: as a study has it.
        root: folder that the file's path starts from.

    Raises:
        InputError: it cannot be read, or is of another kind.
    """
    device = assembly.device
    if device is None or device.file is None or device.text is not None:
        return assembly
    path = root / device.file
    if path.suffix.lower() == ".xacro":
        raise InputError(
            f"{path}: is a xacro file; expand it first ('xacro {path.name} > "
            f"{path.stem}.urdf') and give what comes out"
        )
    if path.suffix.lower() not in _KINDS:
        raise InputError(
            f"{path}: is no device that can be read; give one of "
            f"{', '.join(_KINDS)}"
        )
    return brought_in(assembly, read_text(path, "check model.device.file"))


# Whether an element's numbers are xyz and rpy of a frame, turned by half a
# circle about z with all the others.
_TURNED = np.array([-1.0, -1.0, 1.0])
_OWN = "device_"  # before the name of a link that the person has, too


def brought_in(assembly: Assembly, text: str) -> Assembly:
    """The assembly with its device's text in the person's frames.

    Raises:
        InputError: it is no XML, a joint to fix is missing, or an inertia is
            that of no body.
    """
    device, notes = assembly.device, []
    root, owner = _owner(device, text)
    for element in list(owner):
        if element.tag in ("transmission", "gazebo"):
            owner.remove(element)
        for limits in element.findall("safety_controller"):
            element.remove(limits)
        notes += _without_dynamics(device, element)
    for link in owner.findall("link"):
        notes += _possible_inertia(device, link)
    joints = {joint.get("name"): joint for joint in owner.findall("joint")}
    for name in device.fixed:
        if name not in joints:
            raise InputError(
                f"{device.name}: has no joint {name!r} to fix; it has "
                f"{', '.join(str(n) for n in joints) or 'none'}"
            )
        joints[name].set("type", "fixed")
        for tag in ("axis", "limit", "dynamics", "mimic"):
            for element in joints[name].findall(tag):
                joints[name].remove(element)
    if device.forward == "-x":
        _turn(device, root)
    links = {link.get("name") for link in owner.findall("link")}
    twice = links & set(assembly.human.segments)
    for name in twice:
        _rename(root, name, _OWN + name)

    def own(name: str) -> str:
        return _OWN + name if name in twice else name

    return replace(
        assembly,
        device=replace(
            device,
            weld={own(link): to for link, to in device.weld.items()},
            forward="x",
            fixed=(),
            notes=tuple(notes),
            text=ET.tostring(root, encoding="unicode"),
        ),
        cuffs={
            name: replace(cuff, device=own(cuff.device))
            for name, cuff in assembly.cuffs.items()
        },
    )


_MOMENTS, _PRODUCTS = ("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz")


def _possible_inertia(device: DeviceFile, link: ET.Element):
    """Take products that no body has out of a link's inertia, and say so.

    In the plane the moment about y alone counts.
    """
    inertia = link.find("inertial/inertia")
    if inertia is None:
        return
    where = f"{device.name}: link {link.get('name')!r}"

    def value(key: str) -> float:
        text = inertia.get(key) or inertia.findtext(key) or "0"
        try:
            return float(text)
        except ValueError as error:
            raise InputError(f"{where}: {key} is {text!r}") from error

    a, b, c = moments = [value(key) for key in _MOMENTS]
    mass = link.find("inertial/mass")
    if mass is not None and any(moments):
        text = mass.get("value") or mass.text or ""
        try:
            heavy = float(text) > 0.0
        except ValueError:
            heavy = False
        if not heavy:  # Drake would take another one
            raise InputError(
                f"{where}: has moments of inertia but a mass of "
                f"{text.strip() or 'nothing'}; give one above zero"
            )
    xy, xz, yz = (value(key) for key in _PRODUCTS)

    def is_bodys(x, y, z) -> bool:
        slack = 1e-9 * max(x, y, z)
        return min(x, y, z, x + y - z, x + z - y, y + z - x) >= -slack

    if is_bodys(*np.linalg.eigvalsh([[a, xy, xz], [xy, b, yz], [xz, yz, c]])):
        return
    if not is_bodys(*moments):
        raise InputError(
            f"{where}: no body has moments of inertia of "
            f"{', '.join(f'{x:g}' for x in moments)} kg m^2; correct them"
        )
    for key in _PRODUCTS:
        inertia.attrib.pop(key, None)
        for child in inertia.findall(key):
            inertia.remove(child)
        if inertia.get("ixx") is not None:
            inertia.set(key, "0")
    yield (
        f"{where}: no body has such products of inertia; they are left out, "
        f"its {b:g} kg m^2 about y stay"
    )


def _without_dynamics(device: DeviceFile, joint: ET.Element):
    """Take damping and springs out of a joint, and say so."""
    for owner in (joint, *joint.findall("axis")):
        for element in owner.findall("dynamics"):
            owner.remove(element)
            said = [*element.attrib.values(), *(e.text for e in element)]
            if any((text or "").strip(" \n0.-+e") for text in said):
                name = joint.get("name")
                yield (
                    f"{device.name}: joint {name!r}: its dynamics in the file "
                    f"are left out; give them as device.joints.{name}"
                )


def _turn(device: DeviceFile, root: ET.Element) -> None:
    """Turn every frame by half a circle about its z axis, in place."""

    def turned(text: str) -> str:
        try:
            values = np.array(text.split(), dtype=float).reshape(-1, 3)
        except ValueError as error:
            raise InputError(
                f"{device.name}: {text!r} is not a place or an attitude"
            ) from error
        return " ".join(repr(x) for x in (values * _TURNED).ravel().tolist())

    for element in root.iter():
        if element.tag in ("origin", "axis"):
            for key in {"xyz", "rpy"} & set(element.keys()):
                element.set(key, turned(element.get(key)))
        if element.tag in ("pose", "xyz") and (element.text or "").strip():
            element.text = turned(element.text)
        if element.tag == "inertia":
            for key in ("ixz", "iyz"):
                if element.get(key) is not None:
                    element.set(key, _negated(element.get(key)))
                for child in element.findall(key):
                    child.text = _negated(child.text)


def _negated(number: str) -> str:
    number = number.strip()
    return number[1:] if number.startswith("-") else f"-{number}"


def _rename(root: ET.Element, old: str, new: str) -> None:
    """Another name for a link, wherever the file speaks of it."""
    for element in root.iter():
        if element.tag == "link" and element.get("name") == old:
            element.set("name", new)
        for key in ("link", "attached_to", "relative_to"):
            if element.get(key) == old:
                element.set(key, new)
        if element.tag in ("parent", "child") and element.text == old:
            element.text = new


def _owner(device: DeviceFile, text: str) -> tuple[ET.Element, ET.Element]:
    """The document, and its element that holds links and joints."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{device.name}: is no XML ({error})") from error
    owner = root if root.tag == "robot" else root.find("model")
    if owner is None:
        raise InputError(
            f"{device.name}: holds no <robot> and no <model>; give the URDF or "
            "SDF of one device"
        )
    return root, owner


def without_stiff_joints(device: DeviceFile, text: str) -> str:
    """The file without joints between welded links, and without meshes.

    Meshes of the user's are left out: they lie elsewhere, and results must be
    readable on any machine.

    Raises:
        InputError: it is no XML, or holds not exactly one model.
    """
    root, owner = _owner(device, text)
    for joint in owner.findall("joint"):
        ends = [joint.find(end) for end in ("parent", "child")]
        names = {
            None if end is None else end.get("link") or (end.text or "").strip()
            for end in ends
        }
        if names <= set(device.weld):
            owner.remove(joint)
    if device.file is not None:
        for link in owner.findall("link"):
            for shape in link.findall("visual") + link.findall("collision"):
                if shape.find("geometry/mesh") is not None:
                    link.remove(shape)
    return ET.tostring(root, encoding="unicode")


def add_device(
    parser, plant: MultibodyPlant, device: DeviceFile, text: str
) -> ModelInstanceIndex:
    """Parse a device into a plant, its links not yet welded.

    Raises:
        InputError: Drake cannot read it, a welded link is missing, a link is
            attached to nothing, or joints close a loop.
    """
    text = without_stiff_joints(device, text)
    try:
        (instance,) = parser.AddModelsFromString(text, device.kind)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{device.name}: {reason(error)}") from error
    links = link_names(plant, instance)
    for link in device.weld:
        if link not in links:
            raise missing_link(device, link, links)
    # Everything welded is one with the person.
    group = {link: link for link in links}

    def of(name):
        while group[name] != name:
            name = group[name]
        return name

    first = next(iter(device.weld))
    for link in device.weld:
        group[of(link)] = of(first)
    for index in plant.GetJointIndices(instance):
        joint = plant.get_joint(index)
        ends = [joint.parent_body().name(), joint.child_body().name()]
        if not set(ends) <= set(links):
            raise InputError(
                f"{device.name}: joint {joint.name()!r} holds the device to "
                "the world; take it out, weld places the device"
            )
        a, b = map(of, ends)
        if a == b:
            raise InputError(
                f"{device.name}: joint {joint.name()!r} closes a loop; weld "
                "one link fewer, or take the joint out"
            )
        group[a] = b
    for link in links:
        if of(link) != of(first):
            raise InputError(
                f"{device.name}: link {link!r} is attached to nothing; weld "
                "it to a segment of the person, or give it a joint"
            )
    return instance


def link_names(plant, instance) -> list[str]:
    """Links of a model instance."""
    return [plant.get_body(i).name() for i in plant.GetBodyIndices(instance)]


def missing_link(device: DeviceFile, link: str, known) -> InputError:
    """What to say of a link that the file does not have."""
    return InputError(
        f"{device.name}: has no link {link!r}; it has {', '.join(known)}"
    )


def placed(weld: Weld) -> RigidTransform:
    """Pose of a welded link in its segment; pitch is about -y."""
    pitch = -np.deg2rad(weld.pitch_deg)
    x, z = weld.at_m
    R = (
        RotationMatrix()
        if pitch == 0.0
        else RotationMatrix.MakeYRotation(pitch)
    )
    return RigidTransform(R, [x, 0.0, z])


def check_planar(plant: MultibodyPlant, device: DeviceFile) -> None:
    """Refuse a device whose motion leaves the sagittal plane.

    Args:
        plant: finalized, with person and device.
        device: for messages.

    Raises:
        InputError: a joint that slides or turns about another axis than y, a
            link that moves and weighs nothing.
    """
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if not joint.num_positions() or joint.type_name() == "planar":
            continue
        where = f"{device.name}: joint {joint.name()!r}"
        if joint.type_name() != "revolute":
            raise InputError(
                f"{where} is {joint.type_name()}; in the sagittal plane a "
                "joint turns about y: make it fixed, or leave its links out"
            )
        frame = joint.frame_on_parent().CalcPoseInWorld(context)
        axis = frame.rotation() @ joint.revolute_axis()
        if np.hypot(axis[0], axis[2]) > _STRAIGHT:
            raise InputError(
                f"{where} turns about ({axis[0]:.3g}, {axis[1]:.3g}, "
                f"{axis[2]:.3g}), out of the sagittal plane, whose normal is "
                "y; make it fixed"
            )
        child = joint.child_body()
        moved = plant.GetBodiesWeldedTo(child)
        if not sum(body.get_mass(context) for body in moved) > 0.0:
            raise InputError(
                f"{device.name}: link {child.name()!r} moves and weighs "
                "nothing; give it a mass and an inertia"
            )
