"""A device of the user's own: reading its SDF or URDF, checking it is planar.

The file's text is adapted once, when a study is read: x points forward, joints
to be held become fixed, frames of links are turned so that y is normal to the
sagittal plane, and links with the name of a person's segment are renamed.
"""

import logging
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, ModelInstanceIndex

from drake_exo.errors import InputError, first_line, nearest
from drake_exo.files.tables import kind_of, read_text
from drake_exo.model.assembly import Assembly, DeviceFile, Weld
from drake_exo.model.description import numbers

_STRAIGHT = 1e-5  # tolerated deviation of an axis from y, as of 3.1416 for pi
_QUARTER = np.pi / 2.0
_FAR_M = 5.0  # of a device from the person; more is in millimetres


def with_text(assembly: Assembly, root: Path) -> Assembly:
    """The assembly with the adapted text of its device's file filled in.

    Args:
        assembly: as read from a study.
        root: folder that the file's path is relative to.

    Raises:
        InputError: it cannot be read, is no SDF or URDF, or as `brought_in`.
    """
    device = assembly.device
    if device is None or device.file is None or device.text is not None:
        return assembly
    path = root / device.file
    if path.suffix.lower() == ".xacro":
        raise _is_xacro(path)
    kind_of(path, (".sdf", ".urdf"), "a device")
    return brought_in(assembly, read_text(path, "check model.device.file"))


def _is_xacro(path) -> InputError:
    name = Path(path).name
    out = Path(name.removesuffix(".xacro"))
    if out.suffix not in (".sdf", ".urdf"):
        out = Path(f"{out}.urdf")
    if out.name == name:
        out = out.with_stem(f"{out.stem}_plain")
    return InputError(
        f"{path}: is a xacro file; expand it first ('xacro {name} > {out}') "
        "and give what comes out"
    )


# Rotation by 180 degrees about z.
_TURNED = RigidTransform(RotationMatrix(np.diag([-1.0, -1.0, 1.0])))
# What belongs to other programs, of which Drake would tell at every parse.
_OTHERS = {
    *("transmission", "gazebo", "plugin", "self_collide", "sensor", "gravity"),
    *("allow_auto_disable", "enable_wind", "kinematic", "velocity_decay"),
    *("safety_controller", "calibration"),
}
_OWN = "device_"  # prefix of a link that is named as a segment of the person


def brought_in(assembly: Assembly, text: str) -> Assembly:
    """The assembly with its device's text adapted to the person's frames.

    Raises:
        InputError: it is no XML, Drake cannot read it, a joint to fix is
            missing, a joint mimics another, links are held by something else
            than joints, or an inertia is missing or physically impossible.
    """
    device, notes = assembly.device, []
    root, owner = _owner(device, text)
    for element in list(owner):
        if element.tag in _OTHERS:
            owner.remove(element)
        space, _, tag = element.tag.rpartition("}")
        if "drake" in space and tag != "collision_filter_group":
            raise InputError(
                f"{device.name}: drake:{tag} holds links together, but here "
                "only hinges do, without loops; take it out, and give a spring "
                "across a hinge as device.joints.NAME"
            )
        for other in [e for e in element if e.tag in _OTHERS]:
            element.remove(other)
        notes += _without_dynamics(device, element)
    for link in owner.findall("link"):
        notes += _possible_inertia(device, link)
    _whole_turns(owner)
    joints = {joint.get("name"): joint for joint in owner.findall("joint")}
    for name, joint in joints.items():
        if joint.get("type") != "fixed" and name not in device.fixed:
            _ordered_limits(device, joint)
        follows = joint.find(".//{*}mimic") is not None
        stays = name in device.fixed or _ends(joint) <= set(device.weld)
        if follows and not stays:
            raise InputError(
                f"{device.name}: joint {name!r} follows another one (mimic), "
                "but here every joint turns by itself; take it out, or make "
                "the joint fixed"
            )
    for name in (*device.fixed, *device.upright_deg):
        if name not in joints:
            raise InputError(
                f"{device.name}: has no joint {name!r}"
                f"{' to fix' if name in device.fixed else ''}; it has "
                f"{', '.join(str(n) for n in joints) or 'none'}"
            )
    for name in device.upright_deg:
        if (kind := joints[name].get("type")) not in ("revolute", "continuous"):
            raise InputError(
                f"{device.name}: joint {name!r} is {kind}, and turns by no "
                "angle; leave it out of upright_deg"
            )
    for name in device.fixed:
        joints[name].set("type", "fixed")
        for tag in ("axis", "limit", "dynamics", "{*}mimic"):
            for element in joints[name].findall(tag):
                joints[name].remove(element)
    _without_meshes(owner)
    _into_plane(device, root, owner)
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
            upright_deg={},
            notes=tuple(notes),
            text=ET.tostring(root, encoding="unicode"),
        ),
        cuffs={
            name: replace(cuff, device=own(cuff.device))
            for name, cuff in assembly.cuffs.items()
        },
    )


# Moment of inertia that counts [kg m^2]; frames and sensors may have any.
_LARGE = 0.1
_MOMENTS, _PRODUCTS = ("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz")


def _possible_inertia(device: DeviceFile, link: ET.Element):
    """Remove impossible products of inertia from a link; yield a note on it.

    Only the moment about the plane's normal matters.
    """
    where = f"{device.name}: link {link.get('name')!r}"
    told = ("mass", *(f"inertia/{key}" for key in _MOMENTS))
    if device.kind == "sdf" and not all(
        (link.findtext(f"inertial/{key}") or "").strip() for key in told
    ):  # SDF's defaults would be 1 kg and 1 kg m^2
        raise InputError(
            f"{where}: has no mass or not all moments of inertia; give mass, "
            "ixx, iyy and izz, zeros if it weighs nothing"
        )
    tags = [part.tag for part in link]
    meant = {tag for tag in tags if nearest("inertial", [tag])}
    if meant and "inertial" not in tags:
        yield f"{where}: <{min(meant)}> is not read; is it <inertial>?"
    inertia = link.find("inertial/inertia")
    if inertia is None:
        inertia = ET.Element("inertia")  # a point mass, or massless

    def number(key: str, text: str) -> float:
        try:
            found = float(text)
        except ValueError:
            found = np.nan
        if not np.isfinite(found):  # Drake would replace the mass
            raise InputError(f"{where}: {key} is {text!r}; give a number")
        return found

    def value(key: str) -> float:
        return number(key, inertia.get(key) or inertia.findtext(key) or "0")

    a, b, c = moments = [value(key) for key in _MOMENTS]
    mass = link.find("inertial/mass")
    if mass is None:
        mass = ET.Element("mass")
    text = (mass.get("value") or mass.text or "").strip()
    kg = number("mass", text or "0")
    if kg < 0.0 or (kg == 0.0 and any(moments)):  # as above
        turns = "moments of inertia but " if any(moments) else ""
        raise InputError(
            f"{where}: has {turns}a mass of {text or 'nothing'}; give one "
            "above zero"
        )
    if max(moments) > max(kg, _LARGE):
        radius = np.sqrt(max(moments) / kg)
        raise InputError(
            f"{where}: {max(moments):g} kg m^2 of {kg:g} kg is that of a ring "
            f"of {radius:.2g} m radius; correct one of them, kg m^2 and kg"
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
        f"but its {a:g}, {b:g}, {c:g} kg m^2 are kept"
    )


def _without_dynamics(device: DeviceFile, joint: ET.Element):
    """Remove damping, springs, rotors from a joint; yield a note on it."""
    said: list[str] = []
    for owner in (joint, *joint.findall("axis")):
        for tag in ("dynamics", "{*}rotor_inertia", "{*}gear_ratio"):
            for element in owner.findall(tag):
                owner.remove(element)
                said += [*element.attrib.values(), *element.itertext()]
    if any(text.strip().strip("0.-+e") for text in said):
        name = joint.get("name")
        yield (
            f"{device.name}: joint {name!r}: its dynamics in the file are left "
            f"out; give them as device.joints.{name}"
        )


def _ordered_limits(device: DeviceFile, joint: ET.Element) -> None:
    """Refuse limits of a URDF by which Drake would end the process."""
    for limit in joint.findall("limit"):
        try:
            lower, upper = (float(limit.get(k, 0)) for k in ("lower", "upper"))
        except ValueError:
            continue  # Drake tells
        if not lower <= upper:
            raise InputError(
                f"{device.name}: joint {joint.get('name')!r} has a lower limit "
                f"of {lower:g}, but an upper one of {upper:g}; correct them"
            )


def _whole_turns(owner: ET.Element) -> None:
    """Make angles of 1.57, 3.14 and the like the quarter turns that they mean.

    Else a joint's axis would leave the plane by as much.
    """
    for pose in (*owner.iterfind("joint/origin"), *owner.iterfind("./*/pose")):
        text = pose.text if pose.tag == "pose" else pose.get("rpy")
        values = (text or "").split()
        is_euler = pose.get("rotation_format", "euler_rpy") == "euler_rpy"
        if not is_euler or pose.get("degrees") in ("true", "1"):
            continue
        meant = [*values[:-3], *map(_quarters, values[-3:])]
        if meant == values:
            continue
        if pose.tag == "pose":
            pose.text = " ".join(meant)
        else:
            pose.set("rpy", " ".join(meant))


def _quarters(text: str) -> str:
    """An angle, exact if it is rounded from one or more quarter turns."""
    last = 10.0 ** -len(text.partition(".")[2])
    try:
        count = round(float(text) / _QUARTER)
    except (ValueError, OverflowError):
        return text
    short = abs(count) * _QUARTER - abs(float(text))  # cut off, or rounded
    rounded = last < 0.05 and -0.5 * last <= short < last
    return repr(count * _QUARTER) if count and rounded else text


def _into_plane(device: DeviceFile, root: ET.Element, owner) -> None:
    """Give each link a frame whose y is normal to the plane, in place.

    Link frames from CAD have any orientation. A frame whose y differs from that
    of the welded link that it hangs from takes that link's axes, at the same
    origin; all are turned about z if the file's x points backward. Joints count
    from where an upright person wears them. Poses in an
    SDF are then given relative to the model and to links only, since joints
    and names of links may change.
    """
    is_sdf = owner.tag == "model"
    plant = MultibodyPlant(0.0)
    text = ET.tostring(root, encoding="unicode")
    instance = add_device(Parser(plant), plant, device, text)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    hung = [plant.get_joint(i) for i in plant.GetJointIndices(instance)]
    q = plant.GetPositions(context)
    for joint in hung:
        if joint.num_positions() == 1:
            upright = np.deg2rad(device.upright_deg.get(joint.name(), 0.0))
            q[joint.position_start()] = upright
    plant.SetPositions(context, q)
    bodies = [plant.get_body(i) for i in plant.GetBodyIndices(instance)]
    # Frames: L of a link in the file, P of the link in the plane, M the model.
    X_ML = {b.name(): b.EvalPoseInWorld(context) for b in bodies}
    ends = [(j.parent_body().name(), j.child_body().name()) for j in hung]
    X_LP = {}
    for part in connected(X_ML, ends):
        R_MW = next(X_ML[w].rotation() for w in device.weld if w in part)
        for name in part:
            R_LW = X_ML[name].rotation().inverse() @ R_MW
            off = np.abs(R_LW.matrix()[:, 1] - [0.0, 1.0, 0.0]).max()
            is_kept = name in device.weld or off <= _STRAIGHT
            X_LP[name] = RigidTransform() if is_kept else RigidTransform(R_LW)
            if device.forward == "-x":
                X_LP[name] = X_LP[name] @ _TURNED
    turned = {n for n, X in X_LP.items() if not X.IsExactlyIdentity()}
    told = {key for element in root.iter() for key in element.attrib}
    if not turned and not told & _TOLD_FROM and not device.upright_deg:
        return
    X_MP = {name: X_ML[name] @ X_LP[name] for name in X_ML}
    for link in owner.findall("link"):
        name = link.get("name")
        if not is_sdf and name not in turned:
            continue
        for shape in link.findall("visual"):
            X_LV = _place(shape)
            if X_LV is None:  # only its drawing is lost
                link.remove(shape)
            else:
                _put(shape, is_sdf, X_LP[name].inverse() @ X_LV)
        if is_sdf:
            _put(link, is_sdf, X_MP[name])
        if link.find("inertial") is not None:
            body = plant.GetBodyByName(name, instance)
            _write_inertia(link, is_sdf, body, context, X_LP[name])
    elements = {e.get("name"): e for e in owner.findall("joint")}
    for joint, (a, b) in zip(hung, ends, strict=True):
        if a not in X_MP:  # Drake's joint of a floating base
            continue
        bent = joint.name() in device.upright_deg
        if not is_sdf and not bent and not {a, b} & turned:
            continue
        element, kind = elements[joint.name()], joint.type_name()
        if is_sdf:
            # The joint's frame gets the model's axes: in those, or in its own,
            # as the file's version has it, the axis is given.
            X_LJ = joint.frame_on_child().GetFixedPoseInBodyFrame()
            X_MJ = X_ML[b] @ X_LJ
            straight = RigidTransform(X_MJ.translation())
            _put(element, is_sdf, X_MP[b].inverse() @ straight)
            for end, link in (("parent", a), ("child", b)):
                element.find(end).text = link
            if kind in _AXIS:
                xyz = _filled(_filled(element, "axis"), "xyz")
                xyz.attrib.clear()
                xyz.text = numbers(
                    X_MJ.rotation() @ getattr(joint, _AXIS[kind])()
                )
        else:
            _put(element, is_sdf, X_MP[a].inverse() @ X_MP[b])
            if kind in _AXIS:
                R_PL = X_LP[b].rotation().inverse()
                along = R_PL @ getattr(joint, _AXIS[kind])()
                _filled(element, "axis").set("xyz", numbers(along))
    for frame in owner.findall("frame"):
        owner.remove(frame)
    for key in ("canonical_link", "placement_frame"):
        owner.attrib.pop(key, None)


# Joint type -> Drake's method for its axis, in the joint's frame.
_AXIS = {"revolute": "revolute_axis", "prismatic": "translation_axis"}
# Attributes of an SDF that make a pose relative to another frame.
_TOLD_FROM = {
    "relative_to",
    "attached_to",
    "expressed_in",
    "placement_frame",
    "canonical_link",
}


def _filled(owner: ET.Element, tag: str) -> ET.Element:
    """The child element of that tag; an empty one is made if missing."""
    found = owner.find(tag)
    return ET.SubElement(owner, tag) if found is None else found


def connected(names, edges) -> list[set[str]]:
    """Connected components of a graph of names with edges (a, b)."""
    parts = [{name} for name in names]
    for edge in edges:
        met = [part for part in parts if part & set(edge)]
        parts = [part for part in parts if part not in met]
        parts.append(set().union(*met))
    return [part for part in parts if part]


def _place(shape: ET.Element) -> RigidTransform | None:
    """Pose of a shape in its link, None if it cannot be told."""
    origin, pose = shape.find("origin"), shape.find("pose")
    if pose is not None and pose.get("relative_to"):
        return None
    try:
        if origin is not None:
            p, r = (origin.get(k, "0 0 0").split() for k in ("xyz", "rpy"))
        elif pose is not None and (pose.text or "").strip():
            p, r = np.split(np.array(pose.text.split(), float), [3])
            if pose.get("rotation_format") == "quat_xyzw":
                return RigidTransform(Quaternion(r[[3, 0, 1, 2]]), p)
            if pose.get("degrees") in ("true", "1"):
                r = np.deg2rad(r)
        else:
            return RigidTransform()
        p, r = np.array(p, float).reshape(3), np.array(r, float).reshape(3)
    except ValueError:
        return None
    return RigidTransform(RollPitchYaw(r), p)


def _put(owner: ET.Element, is_sdf: bool, X: RigidTransform) -> None:
    """Replace an element's pose (SDF) or origin (URDF)."""
    for element in owner.findall("pose" if is_sdf else "origin"):
        owner.remove(element)
    rpy = X.rotation().ToRollPitchYaw().vector()
    if is_sdf:
        pose = ET.SubElement(owner, "pose")
        pose.text = numbers([*X.translation(), *rpy])
    else:
        place = {"xyz": numbers(X.translation()), "rpy": numbers(rpy)}
        ET.SubElement(owner, "origin", place)


def _write_inertia(link, is_sdf: bool, body, context, X_LP) -> None:
    """Write a link's mass and inertia, in the axes of its turned frame."""
    M_L = body.CalcSpatialInertiaInBodyFrame(context)
    p, R = M_L.get_com(), X_LP.rotation().inverse().matrix()
    central = M_L.Shift(p).CalcRotationalInertia().CopyToFullMatrix3()
    turned, mass = R @ central @ R.T, repr(M_L.get_mass())
    link.remove(link.find("inertial"))
    inertial = ET.SubElement(link, "inertial")
    _put(inertial, is_sdf, RigidTransform(R @ p))
    values = {
        key: repr(float(turned["xyz".index(key[1]), "xyz".index(key[2])]))
        for key in (*_MOMENTS, *_PRODUCTS)
    }
    if is_sdf:
        ET.SubElement(inertial, "mass").text = mass
        inertia = ET.SubElement(inertial, "inertia")
        for key, value in values.items():
            ET.SubElement(inertia, key).text = value
    else:
        ET.SubElement(inertial, "mass", value=mass)
        ET.SubElement(inertial, "inertia", values)


def _rename(root: ET.Element, old: str, new: str) -> None:
    """Rename a link wherever the file refers to it."""
    for element in root.iter():
        if element.tag == "link" and element.get("name") == old:
            element.set("name", new)
        if element.get("link") == old:
            element.set("link", new)
        ends = element.tag in ("parent", "child")
        if ends and (element.text or "").strip() == old:
            element.text = new


def _owner(device: DeviceFile, text: str) -> tuple[ET.Element, ET.Element]:
    """The document's root, and its element that holds links and joints."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        if "unbound prefix" in str(error) and "<xacro:" in text:
            raise _is_xacro(device.name) from error
        raise InputError(f"{device.name}: is not XML ({error})") from error
    if any("xacro" in element.tag.partition("}")[0] for element in root.iter()):
        raise _is_xacro(device.name)  # Drake would read but part of it
    owner = root if root.tag == "robot" else root.find("model")
    if owner is None or owner.find("model") is not None:
        raise InputError(
            f"{device.name}: holds no <robot> and no <model>, or models in "
            "one; give the URDF or SDF of one device"
        )
    if not owner.get("name"):  # by which Drake would end the process
        raise InputError(
            f"{device.name}: its <{owner.tag}> has no name; give it one"
        )
    return root, owner


def _ends(joint: ET.Element) -> set[str | None]:
    """Names of the parent and child link of a joint in the file."""
    ends = [joint.find(end) for end in ("parent", "child")]
    return {
        None if end is None else end.get("link") or (end.text or "").strip()
        for end in ends
    }


def _without_meshes(owner: ET.Element) -> None:
    """Remove meshes, collision geometry and shapes without size.

    Mesh files are not stored with results, which must be readable on any
    machine; links of a device overlap, and Drake would push them apart; Drake
    cannot draw a plate without thickness.
    """
    for link in owner.findall("link"):
        for shape in link.findall("visual") + link.findall("collision"):
            mesh = shape.find("geometry/mesh") is not None
            if mesh or shape.tag == "collision" or not _has_size(shape):
                link.remove(shape)


def _has_size(shape: ET.Element) -> bool:
    """Whether all of a shape's dimensions are finite and above zero."""
    told: list[str] = []
    for element in shape.iterfind("geometry//*"):
        told += [*element.attrib.values(), element.text or ""]
    try:
        sizes = [float(size) for size in " ".join(told).split()]
    except ValueError:
        return False
    return all(0.0 < size < np.inf for size in sizes)


# Start of Drake's messages that is cut: the line number, which is not that of
# the user's file, and the XML path from its root.
_PLACE = re.compile(
    r"^(<[^>]*>\S*:\d+: )?(error: )?"
    r'(At XML path /sdf(/model(\[@name="[^"]*"\])?)?)?'
)


def _is_no_error(record: logging.LogRecord) -> bool:
    """Log filter that drops errors, which Drake also raises."""
    return record.levelno < logging.ERROR


def add_device(
    parser, plant: MultibodyPlant, device: DeviceFile, text: str
) -> ModelInstanceIndex:
    """Parse a device into a plant, its links not yet welded.

    Raises:
        InputError: Drake cannot read it, a welded link is missing, a link is
            attached to nothing, or joints close a loop.
    """
    root, owner = _owner(device, text)
    for joint in owner.findall("joint"):
        if _ends(joint) <= set(device.weld):  # part of the person, rigid
            owner.remove(joint)
    text = ET.tostring(root, encoding="unicode")
    log = logging.getLogger("drake")
    log.addFilter(_is_no_error)
    try:
        (instance,) = parser.AddModelsFromString(text, device.kind)
    except (RuntimeError, ValueError) as error:
        said = first_line(_PLACE.sub("", str(error))).rstrip(".")
        raise InputError(f"{device.name}: {said}; correct it") from error
    finally:
        log.removeFilter(_is_no_error)
    links = link_names(plant, instance)
    for link in device.weld:
        if link not in links:
            raise missing_link(device, link, links)
    # All welded links count as one: they are fixed to the person.
    first, *others = device.weld
    edges = [(first, link) for link in others]
    for index in plant.GetJointIndices(instance):
        joint = plant.get_joint(index)
        ends = [joint.parent_body().name(), joint.child_body().name()]
        if not set(ends) <= set(links):
            raise InputError(
                f"{device.name}: joint {joint.name()!r} holds the device to "
                "the world; take it out, weld places the device"
            )
        if any(part.issuperset(ends) for part in connected(links, edges)):
            raise InputError(
                f"{device.name}: joint {joint.name()!r} closes a loop; weld "
                "one link fewer, or take the joint out"
            )
        edges.append(ends)
    (held,) = (part for part in connected(links, edges) if first in part)
    for link in links:
        if link not in held:
            raise InputError(
                f"{device.name}: link {link!r} is attached to nothing; weld "
                "it to a segment of the person, or give it a joint"
            )
    return instance


def link_names(plant, instance) -> list[str]:
    """Names of the links of a model instance."""
    return [plant.get_body(i).name() for i in plant.GetBodyIndices(instance)]


def missing_link(device: DeviceFile, link: str, known) -> InputError:
    """The error about a link that the file does not have."""
    return InputError(
        f"{device.name}: has no link {link!r}; it has {', '.join(known)}"
    )


def placed(weld: Weld) -> RigidTransform:
    """Pose of a welded link in its segment; pitch is about -y."""
    x, z = weld.at_m
    R = RotationMatrix.MakeYRotation(-np.deg2rad(weld.pitch_deg))
    return RigidTransform(R, [x, 0.0, z])


def check_planar(plant: MultibodyPlant, device: DeviceFile) -> None:
    """Refuse a device whose motion leaves the sagittal plane.

    Args:
        plant: finalized, with person and device.
        device: for messages.

    Raises:
        InputError: a joint is not revolute about y, or a moving link has no
            mass or no inertia about its joint, or lies far off the person.
    """
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    inertia = np.diag(plant.CalcMassMatrix(context))
    person = plant.get_joint(JointIndex(0)).model_instance()
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if not joint.num_positions() or joint.model_instance() == person:
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
                "y; make it fixed, or weld a link whose x is forward and z up"
            )
        ends = joint.child_body(), joint.parent_body()
        places = [frame.translation()]
        for end in ends:
            com = end.CalcCenterOfMassInBodyFrame(context)
            places.append(end.EvalPoseInWorld(context) @ com)
        if (far := max(map(np.linalg.norm, places))) > _FAR_M:
            raise InputError(
                f"{where}, or a link's centre of mass beside it, lies "
                f"{far:.4g} m off the person; give the file's lengths in metres"
            )
        for end in ends:
            moved = plant.GetBodiesWeldedTo(end)
            if not sum(body.get_mass(context) for body in moved) > 0.0:
                raise InputError(
                    f"{device.name}: link {end.name()!r} moves and weighs "
                    "nothing; give it a mass and an inertia"
                )
        if not inertia[joint.velocity_start()] > 0.0:
            raise InputError(
                f"{where}: what it turns has no inertia about it; give the "
                "link an inertia, or a centre of mass off the axis"
            )
