"""Plant, contact, bushings and a controller as one Drake diagram.

    model = build_diagram(nominal_model("coupled"))
    simulator = build_simulator(model)
    model.plant.SetPositions(model.plant_context(simulator.get_context()), q)
    simulator.AdvanceTo(1.0)

The diagram converts to AutoDiffXd and, without a meshcat, to Expression, if the
controller and further forces that were given do.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    ExternallyAppliedSpatialForceMultiplexer,
    MultibodyPlant,
)
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    LeafSystem_,
    System,
)
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.integrate import OdeSolution, Radau

from drake_exo.contact.parameters import ContactModel, nominal_contact
from drake_exo.contact.systems import (
    FootGroundContact_,
    HumanExoskeletonBushings_,
)
from drake_exo.errors import InputError, check_bounds, check_type, nearest
from drake_exo.model.plant import Model

# Ports of the plant that feed inputs of the same name.
_BODY_PORTS = ("body_poses", "body_spatial_velocities")
_PLANT_PORTS = (*_BODY_PORTS, "state")


@dataclass(frozen=True)
class ExoskeletonDiagram:
    """A diagram and its parts, as `build_diagram` returns them.

    Attributes:
        diagram: outputs state, ground_reaction, sphere_wrenches (both named
            ..._SEGMENT if several segments touch the ground) and, with
            bushings, interaction_forces, deflections, energies; input
            joint_torques [N·m] if there is no controller, zero where it is
            not connected. What they hold is told by `FootGroundContact` and
            `HumanExoskeletonBushings`; bushings are in the model's order.
        plant: finalized.
        contacts: segment that touches the ground -> its `FootGroundContact`.
        bushings: `HumanExoskeletonBushings`, None where there are none.
        controller: as given to `build_diagram`.
    """

    diagram: Diagram
    plant: MultibodyPlant
    contacts: dict[str, LeafSystem]
    bushings: LeafSystem | None
    controller: LeafSystem | None

    @property
    def contact(self) -> LeafSystem:
        """The only `FootGroundContact`, if one segment touches the ground."""
        (only,) = self.contacts.values()
        return only

    def plant_context(self, context: Context) -> Context:
        """The plant's mutable context within the diagram's."""
        return self.plant.GetMyMutableContextFromRoot(context)


def build_diagram(
    model: Model,
    contact: ContactModel | None = None,
    *,
    controller: LeafSystem | None = None,
    forces: Sequence[LeafSystem] = (),
    meshcat: Meshcat | None = None,
) -> ExoskeletonDiagram:
    """Builds the plant with its forces, ready to simulate.

    Args:
        model: subject and device.
        contact: of the foot and of the cuffs; `nominal_contact` if None. A
            cuff without a bushing transmits no force.
        controller: has the output port joint_torques [N·m], one for each
            hinge, and any of the inputs state, body_poses,
            body_spatial_velocities, ground_reaction, interaction_forces,
            which are connected by name. Inputs of other names become inputs
            of the diagram.
        forces: further systems with the output spatial_forces and inputs
            named as the controller's, such as a chair.
        meshcat: where the motion is shown; it forbids conversion to
            Expression.

    Raises:
        InputError: parameters out of bounds, bushings of cuffs that the
            model has not, a controller without that output port.

    >>> from drake_exo.model.plant import nominal_model
    >>> built = build_diagram(nominal_model("coupled"))
    >>> built.diagram.GetOutputPort("interaction_forces").size()
    9
    """
    check_type(model, Model, "model")
    contact = nominal_contact(model) if contact is None else contact
    check_type(contact, ContactModel, "contact")
    if controller is not None:
        check_type(controller, System, "controller")
    for force in forces:
        check_type(force, System, "a system of forces")
    builder = DiagramBuilder()
    plant = _add_plant(builder, model, meshcat)
    contacts = {
        body: builder.AddSystem(
            FootGroundContact_[float](plant.GetBodyByName(body).index(), own)
        )
        for body, own in contact.ground.under(model).items()
    }
    if len(contacts) > 1:
        for body, system in contacts.items():
            system.set_name(f"{system.get_name()}_{body}")
    systems = list(contacts.values())
    bushings = None
    if contact.bushings:
        bushings = builder.AddSystem(_bushings(plant, model, contact.bushings))
        systems.append(bushings)
    systems.extend(builder.AddSystem(force) for force in forces)
    _connect(builder, plant, contacts, systems, controller, bushings)
    return ExoskeletonDiagram(
        builder.Build(), plant, contacts, bushings, controller
    )


def connect_forces(
    builder: DiagramBuilder, plant: MultibodyPlant, systems: Sequence[System]
) -> None:
    """Connects all systems that apply forces to the bodies of a plant.

    Args:
        builder: of the diagram; plant and systems are added to it.
        plant: any; its port applied_spatial_force is taken.
        systems: each has the output spatial_forces and any of the inputs
            body_poses and body_spatial_velocities, such as `SoleLaw.under`.

    Raises:
        InputError: the plant's port is taken already, or one is no system.

    >>> from pydrake.multibody.tree import SpatialInertia
    >>> from drake_exo.contact.parameters import ContactSphere, GroundContact
    >>> builder = DiagramBuilder()
    >>> plant = builder.AddSystem(MultibodyPlant(0.0))
    >>> box = SpatialInertia.SolidBoxWithMass(5.0, 0.3, 0.1, 0.1)
    >>> foot = plant.AddRigidBody("foot", box)
    >>> plant.Finalize()
    >>> middle = ContactSphere(5e6, 2.0, x=0.0, z=-0.02, radius=0.03)
    >>> contact = builder.AddSystem(FootGroundContact_[float](
    ...     foot.index(), GroundContact("simbody", {"middle": middle})))
    >>> connect_forces(builder, plant, [contact])
    >>> builder.Build().num_continuous_states()
    13
    """
    for system in systems:
        check_type(system, System, "a system of forces")
    into = plant.get_applied_spatial_force_input_port()
    if builder.IsConnectedOrExported(into):
        raise InputError(
            "the plant's port applied_spatial_force is connected already; give "
            "all systems that apply forces to connect_forces at once"
        )
    total = builder.AddNamedSystem(
        "forces", ExternallyAppliedSpatialForceMultiplexer(len(systems))
    )
    for i, system in enumerate(systems):
        builder.Connect(
            system.GetOutputPort("spatial_forces"), total.get_input_port(i)
        )
        for name in _BODY_PORTS:
            if system.HasInputPort(name):
                builder.Connect(
                    plant.GetOutputPort(name), system.GetInputPort(name)
                )
    builder.Connect(total.get_output_port(), into)


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
        accuracy: relative, of the error control.
        integrator: name as in Drake's `SimulatorConfig`.

    Raises:
        InputError: no such integrator, or an accuracy that is not above 0.

    >>> from drake_exo.model.plant import nominal_model
    >>> simulator = build_simulator(build_diagram(nominal_model("human")))
    >>> simulator.get_integrator().get_target_accuracy()
    0.001
    """
    check_type(model, ExoskeletonDiagram, "model")
    if context is not None:
        check_type(context, Context, "context")
    check_bounds("accuracy", accuracy, {"above": 0.0})
    schemes = GetIntegrationSchemes()
    if integrator not in schemes:
        raise InputError(
            f"there is no integrator {integrator!r}; Drake has "
            f"{', '.join(schemes)}{nearest(integrator, schemes)}"
        )
    simulator = Simulator(model.diagram, context)
    config = SimulatorConfig(
        integration_scheme=integrator,
        max_step_size=0.01,
        accuracy=accuracy,
        use_error_control=True,
    )
    ApplySimulatorConfig(config, simulator)
    return simulator


# Largest step: a short event, such as foot strike, is not stepped over.
_STEP_S = 0.05
# Largest of SciPy's differences, over the state; in walks they reach 1e5.
_WIDEST = 1e8


def integrate(
    diagram: Diagram,
    context: Context,
    end_s: float,
    tell: Callable[[float, np.ndarray], None] | None = None,
    accuracy: float = 1e-3,
) -> OdeSolution:
    """Simulates from the context's state by Radau's method of fifth order.

    Drake's implicit integrators estimate their error from the trapezoidal rule,
    which can hold them at steps of 0.1 ms for seconds; at the same tolerance
    they take two to three times as many evaluations for a third of the digits.

    Args:
        diagram: of an `ExoskeletonDiagram`, all its inputs connected.
        context: of the diagram, at the start; it is changed, and holds the
            integrator's last evaluation afterwards.
        end_s: time to stop at [s].
        tell: called after every step with the time and the state.
        accuracy: relative tolerance; the absolute one (m, rad and their
            rates) is a tenth of it.

    Returns:
        The state (2 nq,), positions and velocities, as a function of time, to
        `t_max`: `end_s`, or earlier where the integrator failed.

    Source:
        Hairer, Wanner 1996, Solving Ordinary Differential Equations II, IV.8.
    """

    def rates(time, state):
        context.SetTime(time)
        context.SetContinuousState(state)
        return diagram.EvalTimeDerivatives(context).CopyToVector()

    start = context.get_continuous_state_vector().CopyToVector()
    solver = Radau(
        rates,
        context.get_time(),
        start,
        end_s,
        max_step=_STEP_S,
        rtol=accuracy,
        atol=0.1 * accuracy,
    )
    times, parts = [solver.t], []
    while solver.status == "running":
        # SciPy widens its differences along a state that changes no rate, such
        # as where the body is while it touches nothing, until they overflow.
        solver.jac_factor = np.minimum(solver.jac_factor, _WIDEST)
        solver.step()
        if solver.status == "failed":
            break
        times.append(solver.t)
        parts.append(solver.dense_output())
        if tell:
            tell(solver.t, solver.y)
    return OdeSolution(times, parts)


@TemplateSystem.define("JointTorques_", scope=sys.modules[__name__])
def JointTorques_(T):
    """Joint torques as generalised forces, zero for the root's coordinates.

    Input joint_torques: one for each coordinate after the root's three
    [N·m], zero where not connected. Output generalized_force.

    Args of the constructor:
        num_velocities: number of the plant's velocities.
    """

    class Impl(LeafSystem_[T]):
        def _construct(self, num_velocities: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self.set_name("joint_torques")
            self._num_velocities = num_velocities
            self.DeclareVectorInputPort("joint_torques", num_velocities - 3)
            self.DeclareVectorOutputPort(
                "generalized_force", num_velocities, self._calc
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._num_velocities, converter=converter)

        def _calc(self, context, output):
            output.SetZero()
            port = self.GetInputPort("joint_torques")
            if port.HasValue(context):
                torques = port.Eval(context)
                pushed = np.zeros(3, torques.dtype)
                output.SetFromVector(np.concatenate([pushed, torques]))

    return Impl


def _add_plant(builder, model: Model, meshcat):
    if meshcat is None:
        plant = model.plant()
        plant.set_name("plant")
        return builder.AddSystem(plant)
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    model.plant(plant)
    plant.Finalize()
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    return plant


def _bushings(plant, model: Model, bushings) -> LeafSystem:
    cuffs = model.tree.cuffs
    unknown = set(bushings) - set(cuffs)
    if unknown:
        raise InputError(
            f"no cuff is called {', '.join(sorted(unknown))}; this model of "
            f"kind '{model.name}' has {', '.join(cuffs) or 'none'}"
        )
    pairs = {
        name: tuple(plant.GetBodyByName(link).index() for link in links)
        for name, links in cuffs.items()
        if name in bushings
    }
    return HumanExoskeletonBushings_[float](
        pairs, {name: bushings[name] for name in pairs}
    )


def _connect(
    builder, plant, contacts, systems, controller, bushing_system
) -> None:
    """Connects forces and controller to the plant; exports the ports."""
    sources = {name: plant.GetOutputPort(name) for name in _PLANT_PORTS}
    for body, contact in contacts.items():
        end = f"_{body}" if len(contacts) > 1 else ""
        for name in ("ground_reaction", "sphere_wrenches"):
            sources[name + end] = contact.GetOutputPort(name)
    if bushing_system is not None:
        for name in ("interaction_forces", "deflections", "energies"):
            sources[name] = bushing_system.GetOutputPort(name)
    connect_forces(builder, plant, systems)
    torques = builder.AddSystem(JointTorques_[float](plant.num_velocities()))
    builder.Connect(
        torques.get_output_port(),
        plant.get_applied_generalized_force_input_port(),
    )
    if controller is None:
        builder.ExportInput(torques.get_input_port(), "joint_torques")
    else:
        if not controller.HasOutputPort("joint_torques"):
            raise InputError(
                f"controller {controller.get_name()!r} has no output port "
                "joint_torques; a controller of the device alone, such as "
                "AssistController, is for predict"
            )
        builder.AddSystem(controller)
        builder.Connect(
            controller.GetOutputPort("joint_torques"), torques.get_input_port()
        )
        sources["joint_torques"] = controller.GetOutputPort("joint_torques")
        systems = [*systems, controller]
    for system in systems:
        for i in range(system.num_input_ports()):
            port = system.get_input_port(i)
            if builder.IsConnectedOrExported(port):
                continue
            if port.get_name() in sources:
                builder.Connect(sources[port.get_name()], port)
            else:
                builder.ExportInput(port, port.get_name())
    for name, port in sources.items():
        if name not in _BODY_PORTS:
            builder.ExportOutput(port, name)
