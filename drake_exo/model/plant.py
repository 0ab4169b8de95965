"""The model of a subject with or without a device, and its Drake plant.

The person's joints are added here, since Drake's SDF parser knows no planar
joint to the world and the person has one leg or two; the device's are in its
file.

Signs: the pitch of the root is positive toes up; dorsiflexion, knee flexion
and hip flexion are positive. Seen from the right, counter-clockwise (about
-y) relative angles are, from the foot up, pitch, -ankle, +knee, -hip.
"""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    ModelInstanceIndex,
    PlanarJoint,
    RevoluteJoint,
    SpatialInertia,
)

from drake_exo.errors import InputError, check_bounds
from drake_exo.files import schema
from drake_exo.model.assembly import (
    ASSEMBLIES,
    Assembly,
    Weld,
    without_side,
)
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.description import (
    NOMINAL_HEIGHT_M,
    NOMINAL_MASS_KG,
    body_width,
    exoskeleton_sdf,
    fit_exoskeleton,
    hinged,
    hinges,
    human_sdf,
    models_path,
    soles,
)
from drake_exo.model.device_file import (
    add_device,
    check_planar,
    link_names,
    missing_link,
    placed,
    with_text,
)
from drake_exo.model.planar_tree import DEVICE, PlanarTree
from drake_exo.model.segments import (
    CUFFED,
    ExoskeletonParameters,
    HumanParameters,
    scale_human,
)

GRAVITY = 9.81

Kind = Literal["coupled", "rigid", "human"]
KINDS = tuple(ASSEMBLIES)

_OWN = "take it out, or name others"
# A joint must be fit to name columns NAME, NAME_moment and parameters NAME.KEY.
_COLUMN = re.compile(
    r"""(?!time$|.*_moment$)[^\s.,;\[\]"]([^.,;\[\]"\t\n]*[^\s.,;\[\]"])?"""
)
_SHELL = "_shell"  # suffix to a cuff's name: the device body that it holds
_FITTED = f"those of the shipped device are {', '.join(CUFFED)}, on one leg"

# Turns z to -y and +y. Written out, because cos(pi/2) is not zero in floating
# point and would litter the symbolic equations of motion.
_Z_TO_MINUS_Y = RotationMatrix(
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
)
_Z_TO_PLUS_Y = RotationMatrix(
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
)


@dataclass(frozen=True)
class Model:
    """A subject, alone or in a device, as `model.json` holds it.

    Attributes:
        kind: bodies, cuffs and spheres; or the name of a shipped assembly:
            "coupled" (device on cuffs, foot-plate welded to the foot), "rigid"
            (the device's links welded to the human's) or "human" (no device).
        human: the subject's parameters.
        exoskeleton: parameters of the shipped device; None without it.
        gravity_m_s2: magnitude of gravity.

    Raises:
        InputError: parts do not fit together, or a value is out of bounds.

    >>> human, device = nominal_model().human, nominal_model().exoskeleton
    >>> model = Model("coupled", human, device)
    >>> model.tree.coordinates.device
    ('exo_ankle', 'exo_knee', 'exo_hip')
    >>> list(model.cuffs)
    ['shank', 'thigh', 'pelvis']

    A heavier thigh; `replace` is that of `dataclasses`:

    >>> thigh = replace(human.thigh, mass_kg=human.thigh.mass_kg + 5.0)
    >>> heavier = replace(model, human=replace(human, thigh=thigh))
    >>> round(heavier.tree.mass - model.tree.mass, 6)
    5.0
    """

    kind: Kind | Assembly
    human: HumanParameters
    exoskeleton: ExoskeletonParameters | None = None
    gravity_m_s2: float = GRAVITY

    def __post_init__(self):
        if not isinstance(self.kind, Assembly) and self.kind not in KINDS:
            raise InputError(
                f"there is no model {self.kind!r}; choose one of "
                f"{', '.join(KINDS)}; of a device of your own, nominal_model "
                "takes a .yaml file with what a study's 'model' says"
            )
        if self.assembly.is_fitted and self.exoskeleton is None:
            raise InputError(
                f"a model of kind {self.name!r} needs an exoskeleton; "
                "give one, or choose 'human'"
            )
        if self.exoskeleton is not None and not self.assembly.is_fitted:
            raise InputError(
                f"a model of kind {self.name!r} takes no exoskeleton; leave it "
                "out, or choose 'coupled'"
            )
        schema.check(self.human, HumanParameters, "human")
        if self.exoskeleton is not None:
            schema.check(self.exoskeleton, ExoskeletonParameters, "exoskeleton")
        check_bounds("gravity_m_s2", self.gravity_m_s2, {"minimum": 0.0})

    def __repr__(self) -> str:
        # Short, because notebooks print it: segments are left out.
        held = ", ".join(self.assembly.cuffs)
        return (
            f"Model({self.name!r}, {self.human.mass_kg:.1f} kg, "
            f"{self.human.height_m:.2f} m{held and f'; cuffs {held}'})"
        )

    @property
    def assembly(self) -> Assembly:
        """Its bodies, cuffs and spheres, also if `kind` is a name."""
        named = not isinstance(self.kind, Assembly)
        return ASSEMBLIES[self.kind] if named else self.kind

    @property
    def name(self) -> str:
        """Name of its kind, for messages."""
        return "described" if isinstance(self.kind, Assembly) else self.kind

    @property
    def has_device(self) -> bool:
        """Whether the subject wears a device."""
        return self.assembly.device is not None

    @cached_property
    def tree(self) -> PlanarTree:
        """Kinematics and dynamics of the plant, for many states at once.

        Raises:
            InputError: the device is not planar, its joints' names are unfit,
                or a cuff's links cannot move relative to each other.
        """
        plant, device = self.plant(), self.assembly.device
        if device is not None:
            check_planar(plant, device)
        tree = PlanarTree.from_plant(plant, _cuff_links(self.assembly))
        for cuff in self.assembly.closed:
            if cuff not in tree.cuffs:
                raise InputError(
                    f"cuff {cuff!r} does not join two links that move against "
                    "each other; "
                    f"{_FITTED if self.assembly.is_fitted else _OWN}"
                )
        if device is None or self.assembly.is_fitted:
            return tree
        names = tree.coordinates
        for joint in names.device:
            if names.names.count(joint) > 1:
                raise InputError(
                    f"{device.name}: joint {joint!r} has the name of one of "
                    "the person's joints; rename it in the file"
                )
            if not _COLUMN.fullmatch(joint):
                raise InputError(
                    f"{device.name}: joint {joint!r} cannot name a column; "
                    "rename it in the file, without dots, commas, brackets, "
                    "quotes or a blank at an end, not 'time' nor '..._moment'"
                )
        names = replace(names, coupling=_coupling(tree, _riding(self, tree)))
        return replace(tree, coordinates=names)

    @cached_property
    def rigid(self) -> "Model":
        """The same with the device, if any, welded to the person."""
        device = self.assembly.device
        if device is None:
            return self
        if self.kind == "coupled":
            return replace(self, kind="rigid")
        welds = {
            link: _seen_from(self, segment, link)
            for link, segment in _riding(self, self.tree).items()
        }
        welded = replace(self.assembly, device=replace(device, weld=welds))
        return replace(self, kind=replace(welded, cuffs={}))

    @property
    def coordinates(self) -> Coordinates:
        """Names of the coordinates."""
        return self.tree.coordinates

    @cached_property
    def soles(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Segment -> sphere -> nominal centre (x, z) in the segment [m].

        Raises:
            InputError: a sphere has no usual place, and none is given; or a
                heel is not behind its toe.
        """
        usual = soles(self.human, self.assembly.human)
        if self.exoskeleton is not None and "foot" in usual:
            heel, toe = self.exoskeleton.heel_m, self.exoskeleton.toe_m
            ball = usual["foot"]["ball"][0], toe[1]
            usual["foot"] |= {"heel": heel, "ball": ball, "toe": toe}
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for body, spheres in self.assembly.spheres.items():
            for name, place in spheres.items():
                either, on = without_side(name), body
                if place is None and either not in usual.get(body, {}):
                    # A foot's toe is on its toes where these are hinged.
                    on = body.replace("foot", "toes")
                place = place or usual.get(on, {}).get(either)
                if place is None:
                    known = ", ".join(usual.get(body, {})) or "none"
                    own = " or ".join(b for b in usual if either in usual[b])
                    raise InputError(
                        f"ground: {name!r} has no usual place on {body} "
                        f"(there are {known}); "
                        + (f"name it on {own}, or " if own else "")
                        + f"give {name}: [x, z] in m"
                    )
                found.setdefault(on, {})[name] = place
        for body, own in found.items():
            x = {without_side(name): at[0] for name, at in own.items()}
            if "heel" in x and "toe" in x and x["heel"] >= x["toe"]:
                raise InputError(
                    f"the heel of the {body} is at x = {x['heel']:.3g} m, its "
                    f"toe at {x['toe']:.3g} m, which is no further forward; "
                    "correct heel_m and toe_m, or model.ground"
                )
        return found

    @property
    def spheres(self) -> dict[str, tuple[float, float]]:
        """Contact sphere -> nominal centre (x, z) in its segment [m].

        Spheres of one name on several segments share their parameters.
        """
        found: dict[str, tuple[float, float]] = {}
        for spheres in self.soles.values():
            for name, place in spheres.items():
                if found.setdefault(name, place) != place:
                    raise InputError(
                        f"ground: sphere {name!r} has two places; spheres of "
                        "one name share their parameters, rename one"
                    )
        return found

    @cached_property
    def upright_poses(self) -> dict[str, np.ndarray]:
        """Body -> x, z [m], angle [rad] with all coordinates at zero."""
        plant, device = self.plant(), self.assembly.device
        if device is not None:
            check_planar(plant, device)
        tree = PlanarTree.from_plant(plant)
        q = np.zeros((1, tree.num_positions))
        return {name: tree.poses(q, name)[0] for name in tree.names}

    @property
    def cuffs(self) -> dict[str, tuple[float, float]]:
        """Cuff -> nominal place (x, z) in its segment of the human [m]."""
        return {c: self._cuff_m(c) for c in self.tree.cuffs}

    def _cuff_m(self, cuff: str) -> tuple[float, float]:
        links = self.assembly.cuffs[cuff]
        segment = links.human.split("_")[0]
        if links.at_m is not None:
            self.check_on_limb(f"model.cuffs.{cuff}.at_m", cuff, links.at_m)
            return links.at_m
        if segment not in CUFFED:
            raise InputError(
                f"cuff {cuff!r} has no usual place on {links.human}; give at_m"
            )
        key, own = f"{segment}_cuff_m", self.human.cuff_m(segment)
        self.check_on_limb(f"subject.segments.{key}", cuff, own)
        if self.exoskeleton is not None:
            device = self.exoskeleton.cuff_m(segment)
            self.check_on_limb(f"exoskeleton.{key}", cuff, device)
        return own

    def check_on_limb(self, what: str, cuff: str, place) -> None:
        """Refuse a place (x, z) [m] of a cuff that is off its segment.

        Raises:
            InputError: it names the field `what`.
        """
        segment = self.assembly.cuffs[cuff].human
        part = segment.split("_")[0]
        part = "foot" if part == "toes" else part
        length = getattr(self.human, part).length_m
        # No limb is thicker than it is long; a strap may lie a little beyond
        # its ends. A foot's origin, the ankle, is above its middle.
        limits = (-0.5, 0.5), (-0.25, 1.25)
        if part == "foot":
            limits = (-1.0, 1.0), (-1.0, 1.0)
        for axis, at, (low, high) in zip("xz", place, limits, strict=True):
            if not low * length <= at <= high * length:
                raise InputError(
                    f"{what}: {axis} is {at:.3g} m, which is off the "
                    f"{segment}, {length:.3g} m long; give [x, z] in m, x "
                    "forward and z up from its lower joint"
                )

    def preload(self, cuff: str) -> tuple[float, float]:
        """Place (x, z) of a cuff in the device minus that in the human [m].

        Each in its own link. It is zero for a device of the user's own, and for
        a cuff whose place the study gives.
        """
        links = self.assembly.cuffs[cuff]
        if self.exoskeleton is None or links.at_m is not None:
            return (0.0, 0.0)
        x, z = self._cuff_m(cuff)
        device_x, device_z = self.exoskeleton.cuff_m(links.human)
        return device_x - x, device_z - z

    def plant(self, plant: MultibodyPlant | None = None) -> MultibodyPlant:
        """The model as a plant.

        Positions and velocities are x, z and pitch of the root, then the
        hinges along its branches, as `coordinates` names them.

        Args:
            plant: an unfinalized plant to add to, such as one registered with
                a SceneGraph; it is left unfinalized. If None, a continuous
                plant is made, and finalized.

        Returns:
            The plant, the given one or the new one.

        Raises:
            InputError: the device's file does not fit the assembly.
        """
        if plant is not None:
            return _added(self, plant)
        plant = _added(self, MultibodyPlant(0.0))
        plant.Finalize()
        return plant


def nominal_model(
    kind: Kind | Path | str = "coupled",
    mass_kg: float = NOMINAL_MASS_KG,
    height_m: float = NOMINAL_HEIGHT_M,
    sex: str = "male",
) -> Model:
    """The nominal adult; with the fitted device unless `kind` is "human".

    Of another mass, height or sex, segments follow from de Leva's tables.

    Args:
        kind: see `Model`; or a .yaml file that holds what a study's `model`
            says, for a device of your own or two legs. Paths in it start from
            its folder.
        mass_kg, height_m: the person's.
        sex: "male" or "female".

    Raises:
        InputError: unknown kind; mass, height or sex that nobody has; or the
            file, or that of its device, is faulty.

    >>> round(nominal_model("human").tree.mass, 6)
    70.0
    >>> nominal_model(mass_kg=62.0, height_m=1.68, sex="female")
    Model('coupled', 62.0 kg, 1.68 m; cuffs shank, thigh, pelvis)
    """
    human = scale_human(mass_kg, height_m, sex)
    if str(kind).endswith((".yaml", ".yml")):
        kind = _described(Path(kind))
    described = isinstance(kind, Assembly)
    fitted = kind.is_fitted if described else kind != "human"
    return Model(kind, human, fit_exoskeleton(human) if fitted else None)


def _described(path: Path) -> Assembly:
    """The assembly that a file describes, the text of its device filled in."""
    found = schema.load(path, Assembly)
    if found.human.osim is not None:
        raise InputError(
            f"{path}: human.osim scales a person by a standing trial; leave it "
            "out, or take the model of a study, read_study(...).model"
        )
    return with_text(found, path.parent)


def _added(model: Model, plant: MultibodyPlant) -> MultibodyPlant:
    """The plant with all bodies, joints and visuals of a model added."""
    gravity = [0.0, 0.0, -model.gravity_m_s2]
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(models_path() / "package.xml"))
    assembly, human = model.assembly, model.human
    drawn = plant.geometry_source_is_registered()
    text = human_sdf(human, assembly.human, drawn)
    (body,) = parser.AddModelsFromString(text, "sdf")
    _add_human_joints(plant, body, assembly)
    device = assembly.device
    if device is not None:
        text = device.text
        if assembly.is_fitted:
            width = body_width(human)
            text = hinged(exoskeleton_sdf(model.exoskeleton, width, drawn))
        worn = add_device(parser, plant, device, text)
        for link, weld in device.welds.items():
            plant.WeldFrames(
                plant.GetFrameByName(weld.to, body),
                plant.GetFrameByName(link, worn),
                placed(weld),
            )
        _check_links(plant, worn, assembly)
        if not assembly.is_fitted:
            _add_shells(plant, worn, assembly, human)
    if drawn:
        _draw_ground(plant)
    return plant


def _add_human_joints(
    plant: MultibodyPlant, body: ModelInstanceIndex, assembly: Assembly
) -> None:
    name = assembly.human.root
    root = plant.GetFrameByName(name, body)
    plant.AddJoint(
        PlanarJoint(
            name,
            _turned(plant, plant.world_frame(), _Z_TO_MINUS_Y, "ground"),
            _turned(plant, root, _Z_TO_MINUS_Y, f"{name}_planar"),
            np.zeros(3),
        )
    )
    for hinge in hinges(assembly.human):
        turn = _Z_TO_PLUS_Y if hinge.axis > 0 else _Z_TO_MINUS_Y
        ends = []
        for end in ("parent", "child"):
            frame = plant.GetFrameByName(getattr(hinge, end), body)
            ends.append(_turned(plant, frame, turn, f"{hinge.name}_{end}"))
        plant.AddJoint(RevoluteJoint(hinge.name, *ends, [0.0, 0.0, 1.0]))


def _check_links(plant, worn, assembly: Assembly) -> None:
    """Check that cuffs are at links of the device, and names are unique."""
    known = link_names(plant, worn)
    for name, cuff in assembly.cuffs.items():
        if cuff.device not in known:
            raise missing_link(assembly.device, cuff.device, known)
        if name + _SHELL in known:
            raise InputError(
                f"{assembly.device.name}: link {name + _SHELL!r} has the name "
                f"of what cuff {name!r} holds on to; rename the cuff"
            )


def _cuff_links(assembly: Assembly) -> dict[str, tuple[str, str]]:
    """Closed cuff -> (link of the human, body of the device) that it joins.

    Of the shipped device only cuffs named as their segment are kept.
    """
    found = {n: assembly.cuffs[n] for n in assembly.closed}
    links = {n: (c.human, _held(assembly, n)) for n, c in found.items()}
    if not assembly.is_fitted:
        return links
    own = {n: (n, DEVICE + n) for n in CUFFED}
    return {n: ends for n, ends in links.items() if ends == own.get(n)}


def _held(assembly: Assembly, cuff: str) -> str:
    """Device body that a cuff holds: a shipped link, else its shell."""
    fitted = assembly.is_fitted
    return assembly.cuffs[cuff].device if fitted else cuff + _SHELL


def _add_shells(plant, worn, assembly: Assembly, human) -> None:
    """Add the bodies that cuffs hold on a device of the user's own.

    A cuff's deflection is the motion of the device's link relative to the
    segment. So the link gets a massless body whose frame coincides with the
    segment's in upright standing, as links of the shipped device do.
    """
    if not assembly.cuffs:
        return
    bare = Model(replace(assembly, cuffs={}), human)
    for name, cuff in assembly.cuffs.items():
        weld = _seen_from(bare, cuff.device, cuff.human)
        link = plant.GetFrameByName(cuff.device, worn)
        held = plant.AddRigidBody(name + _SHELL, worn, SpatialInertia.Zero())
        plant.WeldFrames(link, held.body_frame(), placed(weld))


def _seen_from(model: Model, base: str, body: str) -> Weld:
    """Pose of a body on another, `base`, in upright standing, as a weld."""
    poses = model.upright_poses
    x, z, angle = poses[body] - poses[base]
    c, s = np.cos(poses[base][2]), np.sin(poses[base][2])
    at = float(c * x + s * z), float(c * z - s * x)
    return Weld(base, at, float(np.rad2deg(angle)))


def _riding(model: Model, tree: PlanarTree) -> dict[str, str]:
    """Link of the device -> segment of the person that it moves with.

    That is the segment it, or a link that it is fixed to, is welded or strapped
    to (by an open cuff, too).

    Raises:
        InputError: a link is neither.
    """
    assembly = model.assembly
    plant = model.plant()
    rides = {link: weld.to for link, weld in assembly.device.welds.items()}
    for cuff in assembly.cuffs.values():
        rides.setdefault(cuff.device, cuff.human)
    if assembly.is_fitted:  # its links are named as segments
        rides = {DEVICE + name: name for name in CUFFED} | rides
    joints = [plant.get_joint(i) for i in plant.GetJointIndices()]
    fixed = [
        (j.parent_body().name(), j.child_body().name())
        for j in joints
        if not j.num_positions()
    ]
    for a, b in [*fixed, *((b, a) for a, b in fixed)] * len(fixed):
        if a in rides and b not in (*rides, *assembly.human.segments):
            rides[b] = rides[a]
    for link in (n for j in tree.coordinates.device for n in tree.joints[j]):
        if link not in (*rides, *assembly.human.segments):
            raise InputError(
                f"{assembly.device.name}: link {link!r} is neither welded nor "
                "strapped, so nothing says which segment it moves with; give "
                "it a cuff, with 'open: true' if it bears nothing"
            )
    shells = [name + _SHELL for name in assembly.cuffs]
    return {link: s for link, s in rides.items() if link not in shells}


def _coupling(tree: PlanarTree, rides) -> tuple[tuple[float, ...], ...]:
    """`Coordinates.coupling` of a device whose links ride on segments."""
    names = tree.coordinates
    columns = names.columns(names.human)
    rows = []
    for name in names.device:
        ends = tree.joints[name]
        sign = tree.turning(ends[1])[names.index(name)]
        inner, outer = (
            tree.turning(rides.get(end, end))[columns] for end in ends
        )
        rows.append(tuple(float(x) + 0.0 for x in sign * (outer - inner)))
    return tuple(rows)


def _turned(
    plant: MultibodyPlant, frame: Frame, turn: RotationMatrix, name: str
) -> Frame:
    """Add a frame at the origin of another, its z along the joint's axis."""
    return plant.AddFrame(FixedOffsetFrame(name, frame, RigidTransform(turn)))


def _draw_ground(plant: MultibodyPlant) -> None:
    """Draw the floor on the world body, so it adds no mass to the plant."""
    plant.RegisterVisualGeometry(
        plant.world_body(),
        RigidTransform([0.0, 0.0, -0.005]),
        Box(2.4, 1.6, 0.01),
        "ground",
        np.array([0.82, 0.83, 0.85, 1.0]),
    )
