"""The three plants: coupled (9 DOF), rigid (6 DOF) and human only (6 DOF).

All are made of the same links. Drake's SDF parser knows no planar joint to
the world and the model files hold no joints at all, because the rigid plant
welds what the coupled plant hinges: joints are added here.

Signs: the pitch of the foot is positive toes up; dorsiflexion, knee flexion
and hip flexion are positive. Seen from the right, counter-clockwise (about
-y) relative angles are pitch, -ankle, +knee, -hip.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

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
)

from drake_exo.errors import InputError, check_bounds
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.description import (
    body_width,
    exoskeleton_sdf,
    fit_exoskeleton,
    human_sdf,
    models_path,
    nominal_human,
)
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.segments import ExoskeletonParameters, HumanParameters

GRAVITY = 9.81

Kind = Literal["coupled", "rigid", "human"]
KINDS = get_args(Kind)

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
        kind: "coupled" (two chains on one foot), "rigid" (the device's links
            welded to the human's) or "human" (no device).
        human: the subject.
        exoskeleton: the device; None for the kind "human".
        gravity_m_s2: magnitude of gravity.

    >>> human = nominal_human()
    >>> model = Model("coupled", human, fit_exoskeleton(human))
    >>> model.tree.coordinates.device
    ('exo_ankle', 'exo_knee', 'exo_hip')
    >>> list(model.cuffs)
    ['shank', 'thigh', 'pelvis']
    """

    kind: Kind
    human: HumanParameters
    exoskeleton: ExoskeletonParameters | None = None
    gravity_m_s2: float = GRAVITY

    def __post_init__(self):
        if self.kind not in KINDS:
            raise InputError(
                f"there is no model {self.kind!r}; choose one of "
                f"{', '.join(KINDS)}"
            )
        if self.kind != "human" and self.exoskeleton is None:
            raise InputError(
                f"a model of kind {self.kind!r} needs an exoskeleton; "
                "give one, or choose 'human'"
            )
        check_bounds("gravity_m_s2", self.gravity_m_s2, {"minimum": 0.0})

    @cached_property
    def tree(self) -> PlanarTree:
        """Batched dynamics of the plant."""
        return PlanarTree.from_plant(self.plant())

    @cached_property
    def rigid(self) -> "Model":
        """The same with the device welded on, if there is one."""
        return replace(self, kind="rigid") if self.exoskeleton else self

    @property
    def coordinates(self) -> Coordinates:
        """Names of the coordinates."""
        return self.tree.coordinates

    @property
    def spheres(self) -> dict[str, tuple[float, float]]:
        """Contact sphere -> nominal centre (x, z) in the foot [m]."""
        foot = self.exoskeleton or self.human
        return {"heel": foot.heel_m, "toe": foot.toe_m}

    @property
    def cuffs(self) -> dict[str, tuple[float, float]]:
        """Cuff -> nominal place (x, z) in its segment of the human [m]."""
        return {c: self.human.cuff_m(c) for c in self.tree.cuffs}

    def plant(self, plant: MultibodyPlant | None = None) -> MultibodyPlant:
        """A new plant; or added to the one given, see `build_plant`."""
        return build_plant(
            self.kind,
            self.human,
            self.exoskeleton,
            gravity=self.gravity_m_s2,
            plant=plant,
        )


def nominal_model(kind: Kind = "coupled") -> Model:
    """The nominal adult, with the device that fits, unless alone.

    >>> round(nominal_model("human").tree.mass, 6)
    70.0
    """
    human = nominal_human()
    device = None if kind == "human" else fit_exoskeleton(human)
    return Model(kind, human, device)


def build_plant(
    kind: str,
    human: HumanParameters | None = None,
    exoskeleton: ExoskeletonParameters | None = None,
    *,
    gravity: float = GRAVITY,
    plant: MultibodyPlant | None = None,
) -> MultibodyPlant:
    """Build the human, with or without the exoskeleton, as a plant.

    Positions and velocities are x, z and pitch of the foot, then ankle, knee
    and hip of the human and, if coupled, of the exoskeleton.

    Args:
        kind: "coupled" (human and exoskeleton are two chains on one foot,
            9 DOF), "rigid" (the exoskeleton's links welded to the human's,
            6 DOF) or "human" (6 DOF).
        human: the subject; the nominal adult if None.
        exoskeleton: the device; fitted to the human if None. Must be None for
            the kind "human".
        gravity: magnitude of gravity, downwards [m/s²].
        plant: an unfinalized plant to add to, such as one registered with a
            SceneGraph; it is left unfinalized. If None, a continuous plant is
            made, and finalized.

    Returns:
        The plant, the given one or the new one.

    Raises:
        ValueError: unknown kind, negative gravity, or an exoskeleton for a
            plant without one.
    """
    if kind not in KINDS:
        raise ValueError(
            f"kind must be one of {', '.join(KINDS)}, not {kind!r}"
        )
    if kind == "human" and exoskeleton is not None:
        raise ValueError("a plant of kind 'human' takes no exoskeleton")
    if not gravity >= 0.0:
        raise ValueError(
            f"gravity must be a magnitude in m/s², not {gravity!r}"
        )
    ours = plant is None
    plant = MultibodyPlant(0.0) if ours else plant
    human = human or nominal_human()
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(models_path() / "package.xml"))
    (body,) = parser.AddModelsFromString(human_sdf(human), "sdf")
    _add_human_joints(plant, body)
    if kind != "human":
        exoskeleton = exoskeleton or fit_exoskeleton(human)
        text = exoskeleton_sdf(exoskeleton, body_width(human))
        (device,) = parser.AddModelsFromString(text, "sdf")
        # Human first: Drake numbers positions in the order joints are added.
        _join_exoskeleton(plant, body, device, hinged=kind == "coupled")
    if plant.geometry_source_is_registered():
        _draw_ground(plant)
    if ours:
        plant.Finalize()
    return plant


def _add_human_joints(plant: MultibodyPlant, body: ModelInstanceIndex) -> None:
    foot = plant.GetFrameByName("foot", body)
    plant.AddJoint(
        PlanarJoint(
            "foot",
            _turned(plant, plant.world_frame(), _Z_TO_MINUS_Y, "ground"),
            _turned(plant, foot, _Z_TO_MINUS_Y, "foot_planar"),
            np.zeros(3),
        )
    )
    _hinge(plant, "ankle", foot, plant.GetFrameByName("shank", body))
    _hinge(
        plant,
        "knee",
        plant.GetFrameByName("knee_centre", body),
        plant.GetFrameByName("thigh", body),
    )
    _hinge(
        plant,
        "hip",
        plant.GetFrameByName("hip_centre", body),
        plant.GetFrameByName("pelvis", body),
    )


def _join_exoskeleton(
    plant: MultibodyPlant,
    body: ModelInstanceIndex,
    device: ModelInstanceIndex,
    hinged: bool,
) -> None:
    def exo(name: str) -> Frame:
        return plant.GetFrameByName(f"exo_{name}", device)

    plant.WeldFrames(plant.GetFrameByName("foot", body), exo("foot"))
    if hinged:
        _hinge(plant, "exo_ankle", exo("foot"), exo("shank"))
        _hinge(plant, "exo_knee", exo("knee_centre"), exo("thigh"))
        _hinge(plant, "exo_hip", exo("hip_centre"), exo("pelvis"))
        return
    for name in ("shank", "thigh", "pelvis"):
        plant.WeldFrames(plant.GetFrameByName(name, body), exo(name))


def _hinge(
    plant: MultibodyPlant, name: str, parent: Frame, child: Frame
) -> None:
    """Add a revolute joint; knees flex about -y, ankles and hips about +y."""
    turn = _Z_TO_MINUS_Y if name.endswith("knee") else _Z_TO_PLUS_Y
    plant.AddJoint(
        RevoluteJoint(
            name,
            _turned(plant, parent, turn, f"{name}_parent"),
            _turned(plant, child, turn, f"{name}_child"),
            [0.0, 0.0, 1.0],
        )
    )


def _turned(
    plant: MultibodyPlant, frame: Frame, turn: RotationMatrix, name: str
) -> Frame:
    """Add a frame at the origin of another, its z along the joint's axis."""
    return plant.AddFrame(FixedOffsetFrame(name, frame, RigidTransform(turn)))


def _draw_ground(plant: MultibodyPlant) -> None:
    """Draw the floor: no body, so that the plant's mass is the subject's."""
    plant.RegisterVisualGeometry(
        plant.world_body(),
        RigidTransform([0.0, 0.0, -0.005]),
        Box(2.4, 1.6, 0.01),
        "ground",
        np.array([0.82, 0.83, 0.85, 1.0]),
    )
