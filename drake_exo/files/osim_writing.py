"""Elements added to a .osim file: bodies, joints, contacts, bushings.

Each function makes one element as OpenSim 4 writes it; `OsimFile` puts them
into their sets. Frames on bodies are given as a pose: rotation and place.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drake_exo.errors import InputError
from drake_exo.files.osim import Pose
from drake_exo.files.text import read_text

_TINY = 1e-12  # half an ulp of a turn is no turn


class OsimFile:
    """A .osim file to which elements are added.

    Args:
        path: of a file that `read_osim` takes.
    """

    def __init__(self, path: str | Path):
        self.source = str(path)
        self.root = ET.fromstring(read_text(path))
        self.model = self.root.find("Model")
        self._names = {e.get("name") for e in self.model.iter()} - {None}

    def add(self, kind: str, element: ET.Element) -> None:
        """Put an element into a set such as "ForceSet".

        Raises:
            InputError: the model has something of its name.
        """
        name = element.get("name")
        if name in self._names:
            raise InputError(
                f"{self.source}: has a {name!r} already; give the model as it "
                "was before an export"
            )
        self._names.add(name)
        group = self.model.find(kind)
        if group is None:
            group = ET.SubElement(self.model, kind, name=kind.lower())
        objects = group.find("objects")
        if objects is None:
            objects = ET.SubElement(group, "objects")
        objects.append(element)

    def body(self, name: str) -> ET.Element:
        """The element of a body."""
        return self.model.find(f"BodySet/objects/Body[@name='{name}']")

    def write(self, path: Path) -> None:
        """Write all of it."""
        ET.indent(self.root, "\t")
        ET.ElementTree(self.root).write(
            path, encoding="UTF-8", xml_declaration=True
        )


def text_of(values: Iterable[float]) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def _element(kind: str, name: str, children: dict[str, str]) -> ET.Element:
    made = ET.Element(kind, name=name)
    for tag, text in children.items():
        ET.SubElement(made, tag).text = text
    return made


def body(name: str, mass_kg: float, com_m, inertia_kg_m2) -> ET.Element:
    """A body.

    Args:
        name: of it.
        mass_kg: its mass.
        com_m: (3,) centre of mass.
        inertia_kg_m2: (3, 3) about it.
    """
    inertia = np.asarray(inertia_kg_m2)
    six = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    return _element(
        "Body",
        name,
        {
            "mass": repr(float(mass_kg)),
            "mass_center": text_of(com_m),
            "inertia": text_of(six),
        },
    )


def _frames(owner: ET.Element, ends: dict[str, tuple[str, Pose]]) -> None:
    """Offset frames of a joint or force, by name: their bodies and poses."""
    frames = ET.SubElement(owner, "frames")
    for name, (on, pose) in ends.items():
        angles = Rotation.from_matrix(pose.R).as_euler("XYZ")
        angles = np.where(np.abs(angles) < _TINY, 0.0, angles)
        frames.append(
            _element(
                "PhysicalOffsetFrame",
                name,
                {
                    "socket_parent": f"/bodyset/{on}",
                    "translation": text_of(pose.p),
                    "orientation": text_of(angles),
                },
            )
        )


def joint(
    name: str,
    coordinate: str | None,
    parent: tuple[str, Pose],
    child: tuple[str, Pose],
) -> ET.Element:
    """A pin about the frames' z, or a weld without a coordinate."""
    made = ET.Element("PinJoint" if coordinate else "WeldJoint", name=name)
    ends = {f"{name}_parent": parent, f"{name}_child": child}
    for end, frame in zip(("parent", "child"), ends, strict=True):
        ET.SubElement(made, f"socket_{end}_frame").text = frame
    if coordinate:
        coordinates = ET.SubElement(made, "coordinates")
        ET.SubElement(coordinates, "Coordinate", name=coordinate)
    _frames(made, ends)
    return made


def half_space(name: str) -> ET.Element:
    """The ground below y = 0."""
    return _element(
        "ContactHalfSpace",
        name,
        {
            "socket_frame": "/ground",
            "location": "0 0 0",
            "orientation": text_of([0.0, 0.0, -0.5 * np.pi]),
        },
    )


def sphere(name: str, on: str, place_m, radius_m: float) -> ET.Element:
    """A contact sphere, its centre at a place (3,) of a body."""
    return _element(
        "ContactSphere",
        name,
        {
            "socket_frame": f"/bodyset/{on}",
            "location": text_of(place_m),
            "orientation": "0 0 0",
            "radius": repr(float(radius_m)),
        },
    )


def sphere_force(
    name: str, on: str, ground: str, values: dict[str, float]
) -> ET.Element:
    """A SmoothSphereHalfSpaceForce.

    Args:
        name: of the force.
        on, ground: contact sphere and half space.
        values: OpenSim's names of its properties.
    """
    return _element(
        "SmoothSphereHalfSpaceForce",
        name,
        {
            "socket_sphere": f"/contactgeometryset/{on}",
            "socket_half_space": f"/contactgeometryset/{ground}",
            **{key: repr(float(value)) for key, value in values.items()},
        },
    )


def bushing(
    name: str,
    human: tuple[str, Pose],
    device: tuple[str, Pose],
    values: dict[str, Iterable[float] | str],
    kind: str = "BushingForce",
) -> ET.Element:
    """A BushingForce, or another of its kind, between frames on two bodies.

    Args:
        name: of the force.
        human, device: bodies and the frames on them; it acts along the axes
            of the first.
        values: OpenSim's names of its properties, three numbers each, or an
            expression.
        kind: or "ExpressionBasedBushingForce".
    """
    made = ET.Element(kind, name=name)
    ends = {f"{name}_human": human, f"{name}_device": device}
    for i, frame in enumerate(ends):
        ET.SubElement(made, f"socket_frame{i + 1}").text = frame
    for key, three in values.items():
        text = three if isinstance(three, str) else text_of(three)
        ET.SubElement(made, key).text = text
    _frames(made, ends)
    return made
