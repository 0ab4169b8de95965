"""Plant, contact, bushings and a controller as one Drake diagram.

    model = build_diagram("coupled")
    simulator = build_simulator(model)
    model.plant.SetPositions(model.plant_context(simulator.get_context()), q)
    simulator.AdvanceTo(1.0)

Keep apart the diagram for planning and the one for viewing: with a meshcat
inside, the diagram converts to no other scalar type.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForceMultiplexer,
    MultibodyPlant,
)
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import (
    BasicVector_,
    Context,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    LeafSystem_,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import ContactParameters, nominal_contact
from drake_exo.contact.systems import (
    FootGroundContact,
    HumanExoskeletonBushings,
)
from drake_exo.errors import InputError
from drake_exo.model.description import fit_exoskeleton, nominal_human
from drake_exo.model.plant import GRAVITY, build_plant
from drake_exo.model.segments import (
    CONTACT_RADIUS_M,
    ExoskeletonParameters,
    HumanParameters,
)

BUSHINGS = ("shank", "thigh", "pelvis")

# Ports that a force or controller may have as inputs, fed by the diagram.
_PLANT_PORTS = ("body_poses", "body_spatial_velocities", "state")


@dataclass(frozen=True)
class ExoskeletonDiagram:
    """A diagram with its parts.

    Attributes:
        diagram: outputs state, ground_reaction, sphere_wrenches and, for the
            coupled kind, interaction_forces, deflections, energies; input
            joint_torques if there is no controller.
        plant: finalized.
        contact: `FootGroundContact`.
        bushings: `HumanExoskeletonBushings`, None unless coupled.
        controller: as given.
    """

    diagram: Diagram
    plant: MultibodyPlant
    contact: LeafSystem
    bushings: LeafSystem | None
    controller: LeafSystem | None

    def plant_context(self, context: Context) -> Context:
        """The plant's part of the diagram's context, mutable."""
        return self.plant.GetMyMutableContextFromRoot(context)


def nominal_bushings(
    human: HumanParameters, exoskeleton: ExoskeletonParameters
) -> dict[str, BushingParameters]:
    """Bushings of usual stiffness at the cuffs.

    A cuff of the exoskeleton that is not where the human's is makes a preload.
    """
    bushings = {}
    for name in BUSHINGS:
        x, z = getattr(human, f"{name}_cuff_m")
        device_x, device_z = getattr(exoskeleton, f"{name}_cuff_m")
        bushings[name] = BushingParameters(
            origin_x=x,
            origin_z=z,
            preload_x=device_x - x,
            preload_z=device_z - z,
        )
    return bushings


def build_diagram(
    kind: str,
    human: HumanParameters | None = None,
    exoskeleton: ExoskeletonParameters | None = None,
    *,
    contact: ContactParameters | None = None,
    bushings: Mapping[str, BushingParameters] | None = None,
    controller: LeafSystem | None = None,
    forces: Sequence[LeafSystem] = (),
    gravity: float = GRAVITY,
    meshcat: Meshcat | None = None,
) -> ExoskeletonDiagram:
    """Builds the plant with its forces, ready to simulate.

    Args:
        kind: "coupled", "rigid" or "human", as in `plant.build_plant`.
        human: the subject; the nominal adult if None.
        exoskeleton: the device; fitted to the human if None.
        contact: foot–ground contact; the simbody law with usual values at the
            plate's (kind "human": the foot's) heel and toe if None.
        bushings: by "shank", "thigh", "pelvis"; `nominal_bushings` if None.
            A missing name is a missing bushing. Only for the kind "coupled".
        controller: has the output port joint_torques [N·m], one for each
            coordinate after the foot's three, and any of the inputs state,
            body_poses, body_spatial_velocities, ground_reaction,
            interaction_forces, which are connected by name.
        forces: further systems with the output spatial_forces and inputs
            named as the controller's, such as a chair.
        gravity: magnitude, downwards [m/s²].
        meshcat: shows the motion there; forbids scalar conversion.

    Raises:
        InputError: parameters out of bounds, bushings where there are none.
        ValueError: as `plant.build_plant`.
    """
    human = human or nominal_human()
    if kind != "human":
        exoskeleton = exoskeleton or fit_exoskeleton(human)
    if bushings is not None and kind != "coupled":
        raise InputError(f"a diagram of kind '{kind}' takes no bushings")
    builder = DiagramBuilder()
    plant = _add_plant(builder, kind, human, exoskeleton, gravity, meshcat)
    foot = exoskeleton or human
    contact_system = builder.AddSystem(
        FootGroundContact(
            plant.GetBodyByName("exo_foot" if exoskeleton else "foot").index(),
            contact
            or nominal_contact(
                "simbody", foot.heel_m, foot.toe_m, CONTACT_RADIUS_M
            ),
        )
    )
    systems = [contact_system]
    bushing_system = None
    if kind == "coupled":
        if bushings is None:
            bushings = nominal_bushings(human, exoskeleton)
        if bushings:
            bushing_system = builder.AddSystem(_bushings(plant, bushings))
            systems.append(bushing_system)
    systems.extend(builder.AddSystem(force) for force in forces)
    _connect(builder, plant, systems, controller, bushing_system)
    return ExoskeletonDiagram(
        builder.Build(), plant, contact_system, bushing_system, controller
    )


def build_simulator(
    model: ExoskeletonDiagram,
    context: Context | None = None,
    accuracy: float = 1e-3,
    integrator: str = "radau3",
) -> Simulator:
    """A simulator with an error-controlled integrator for stiff contact.

    Stiff spheres under a light foot, and friction with a transition velocity
    of centimetres a second, have time constants under a millisecond: explicit
    schemes take five to twenty times as many evaluations.

    Args:
        model: the diagram.
        context: of the diagram; the default one if None.
        accuracy: of the integrator, relative.
        integrator: name as in Drake's `SimulatorConfig`.
    """
    simulator = (
        Simulator(model.diagram)
        if context is None
        else Simulator(model.diagram, context)
    )
    config = SimulatorConfig(
        integration_scheme=integrator,
        max_step_size=0.01,
        accuracy=accuracy,
        use_error_control=True,
    )
    ApplySimulatorConfig(config, simulator)
    return simulator


@TemplateSystem.define("JointTorques_")
def JointTorques_(T):
    """Joint torques as generalised forces; nothing pushes the foot.

    Input joint_torques: one for each coordinate after the foot's three
    [N·m], zero where not connected. Output generalized_force.

    Args of the constructor:
        num_velocities: of the plant.
    """

    class Impl(LeafSystem_[T]):
        def _construct(self, num_velocities: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self.set_name("joint_torques")
            self._num_velocities = num_velocities
            self.DeclareVectorInputPort("joint_torques", num_velocities - 3)
            self.DeclareVectorOutputPort(
                "generalized_force",
                BasicVector_[T](num_velocities),
                self._calc_generalized_force,
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._num_velocities, converter=converter)

        def _calc_generalized_force(self, context, output):
            output.SetZero()
            port = self.GetInputPort("joint_torques")
            if port.HasValue(context):
                for i, torque in enumerate(port.Eval(context)):
                    output.SetAtIndex(3 + i, torque)

    return Impl


JointTorques = JointTorques_[None]


def _add_plant(builder, kind, human, exoskeleton, gravity, meshcat):
    if meshcat is None:
        plant = build_plant(kind, human, exoskeleton, gravity=gravity)
        plant.set_name("plant")
        return builder.AddSystem(plant)
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    build_plant(kind, human, exoskeleton, gravity=gravity, plant=plant)
    plant.Finalize()
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    return plant


def _bushings(plant, bushings) -> LeafSystem:
    unknown = set(bushings) - set(BUSHINGS)
    if unknown:
        raise InputError(
            f"no bushing is called {', '.join(sorted(unknown))}; "
            f"known are {', '.join(BUSHINGS)}"
        )
    ordered = {name: bushings[name] for name in BUSHINGS if name in bushings}
    pairs = {
        name: tuple(
            plant.GetBodyByName(prefix + name).index()
            for prefix in ("", "exo_")
        )
        for name in ordered
    }
    return HumanExoskeletonBushings(pairs, ordered)


def _connect(builder, plant, systems, controller, bushing_system) -> None:
    """Connects forces and controller to the plant and exports ports."""
    contact = systems[0]
    sources = {name: plant.GetOutputPort(name) for name in _PLANT_PORTS}
    for name in ("ground_reaction", "sphere_wrenches"):
        sources[name] = contact.GetOutputPort(name)
    if bushing_system is not None:
        for name in ("interaction_forces", "deflections", "energies"):
            sources[name] = bushing_system.GetOutputPort(name)
    total = builder.AddNamedSystem(
        "forces", ExternallyAppliedSpatialForceMultiplexer(len(systems))
    )
    for i, system in enumerate(systems):
        builder.Connect(
            system.GetOutputPort("spatial_forces"), total.get_input_port(i)
        )
    builder.Connect(
        total.get_output_port(), plant.get_applied_spatial_force_input_port()
    )
    torques = builder.AddSystem(JointTorques(plant.num_velocities()))
    builder.Connect(
        torques.get_output_port(),
        plant.get_applied_generalized_force_input_port(),
    )
    if controller is None:
        builder.ExportInput(torques.get_input_port(), "joint_torques")
    else:
        builder.AddSystem(controller)
        builder.Connect(
            controller.GetOutputPort("joint_torques"), torques.get_input_port()
        )
        sources["joint_torques"] = controller.GetOutputPort("joint_torques")
        systems = [*systems, controller]
    for system in systems:
        for name, port in sources.items():
            if system.HasInputPort(name):
                builder.Connect(port, system.GetInputPort(name))
    for name, port in sources.items():
        if name not in ("body_poses", "body_spatial_velocities"):
            builder.ExportOutput(port, name)
