"""Simulations: settling, sliding, coming together, ports of the diagram."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PlanarJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.diagram import (
    ExoskeletonDiagram,
    build_diagram,
    build_simulator,
    integrate,
)
from drake_exo.contact.hunt_crossley import (
    PaperConstants,
    SimbodyConstants,
    paper_stiffness,
)
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
    nominal_contact,
)
from drake_exo.contact.systems import (
    FootGroundContact,
    HumanExoskeletonBushings,
    declare_force_ports,
)
from drake_exo.errors import InputError
from drake_exo.model.description import fit_exoskeleton, nominal_human
from drake_exo.model.plant import Model, nominal_model

pytestmark = pytest.mark.slow

LAWS = ("paper", "simbody")
RADIUS = 0.032
GRAVITY = 9.81


class HoldPosture(LeafSystem):
    """Spring and damper of every joint towards a posture."""

    def __init__(self, posture, stiffness, damping):
        super().__init__()
        self._posture = np.array(posture)
        self._gains = np.array(stiffness), np.array(damping)
        n = len(posture)
        self.DeclareVectorInputPort("state", 2 * (n + 3))
        self.DeclareVectorOutputPort("joint_torques", n, self._calc)

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        n = len(self._posture)
        stiffness, damping = self._gains
        output.SetFromVector(
            stiffness * (self._posture - state[3 : 3 + n])
            - damping * state[-n:]
        )


def standing(kind, law):
    """Somebody held upright above the ground, weight over the middle foot."""
    subject = nominal_model(kind)
    device = kind == "coupled"
    lean = [0.06, 0.0, 0.0]
    controller = HoldPosture(
        lean * (1 + device),
        [5000.0, 3000.0, 3000.0] + [0.0] * 3 * device,
        [300.0, 150.0, 150.0] + [20.0] * 3 * device,
    )
    contact = nominal_contact(subject, law)
    model = build_diagram(subject, contact, controller=controller)
    simulator = build_simulator(model)
    q = np.zeros(model.plant.num_positions())
    q[1] = RADIUS - subject.spheres["heel"][1] + 0.005
    q[3:] = lean * (1 + device)
    plant_context = model.plant_context(simulator.get_context())
    model.plant.SetPositions(plant_context, q)
    return model, simulator, plant_context


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    "kind",
    ["human", "rigid", pytest.param("coupled", marks=pytest.mark.slow)],
)
def test_settles_to_body_weight(kind, law):
    model, simulator, plant_context = standing(kind, law)
    assert simulator.get_context().get_time() == 0.0
    before = model.diagram.GetOutputPort("ground_reaction").Eval(
        simulator.get_context()
    )
    simulator.AdvanceTo(2.0)
    reaction = model.diagram.GetOutputPort("ground_reaction").Eval(
        simulator.get_context()
    )
    weight = GRAVITY * model.plant.CalcTotalMass(plant_context)
    assert before[1] < 0.1 * weight
    assert abs(reaction[1] / weight - 1.0) < 1e-3, reaction[1] / weight
    # Still upright, its centre of mass over the centre of pressure.
    com = model.plant.CalcCenterOfMassPositionInWorld(plant_context)
    assert com[2] > 0.8
    assert -reaction[2] / reaction[1] == pytest.approx(com[0], abs=0.02)


def test_motion_is_that_of_drakes_own_integrator():
    """Dropped onto the ground, at tolerances far apart, by two methods."""
    model, simulator, plant_context = standing("rigid", "simbody")
    simulator.get_mutable_integrator().set_target_accuracy(1e-6)
    context = model.diagram.CreateDefaultContext()
    start = model.plant.GetPositionsAndVelocities(plant_context)
    context.SetContinuousState(start)
    told = []
    motion = integrate(
        model.diagram,
        context,
        0.2,
        lambda t, x: told.append((t, x.copy())),
    )
    assert (motion.t_min, motion.t_max) == (0.0, 0.2)
    assert len(told) == len(motion.ts) - 1
    assert np.diff(motion.ts).max() <= 0.05
    np.testing.assert_allclose(told[3][1], motion(told[3][0]), atol=1e-12)
    off = []
    for time in np.linspace(0.0, 0.2, 21):
        simulator.AdvanceTo(time)
        known = model.plant.GetPositionsAndVelocities(plant_context)
        off.append(motion(time) - known)
    q, v = np.split(np.abs(off), 2, axis=1)
    moved = np.abs(motion(0.2) - start)
    assert moved[1] > 5e-3
    assert q.max() < 2e-5 and v.max() < 3e-3, (q.max(), v.max())


def test_motion_that_cannot_go_on_ends_there():
    class Breaks(HoldPosture):
        def _calc(self, context, output):
            left = 0.1 - context.get_time()
            output.SetFromVector(np.full(output.size(), 1.0 / left**2))

    controller = Breaks([0.0] * 3, [100.0] * 3, [10.0] * 3)
    model = build_diagram(nominal_model("rigid"), controller=controller)
    context = model.diagram.CreateDefaultContext()
    motion = integrate(model.diagram, context, 0.3)
    assert 0.05 < motion.t_max <= 0.1
    assert np.isfinite(motion(motion.t_max)).all()


def test_a_state_that_changes_no_rate_ends_no_motion():
    """SciPy widens its differences along it tenfold at each Jacobian."""

    class Rough(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareContinuousState(2)

        def DoCalcTimeDerivatives(self, context, derivatives):
            state = context.get_continuous_state_vector().CopyToVector()
            if not np.isfinite(state).all():
                raise RuntimeError("as Drake's plant does")
            turn = np.sign(np.sin(97.0 * context.get_time()))
            rate = 1e3 * (np.sin(300.0 * state[1]) - turn)
            derivatives.SetFromVector([1.0, rate])

    builder = DiagramBuilder()
    builder.AddSystem(Rough())
    diagram = builder.Build()
    motion = integrate(diagram, diagram.CreateDefaultContext(), 0.3)
    assert motion.t_max == pytest.approx(0.3)
    assert motion(0.3)[0] == pytest.approx(0.3)


def test_an_error_of_a_controller_is_no_end_of_a_motion():
    class Breaks(HoldPosture):
        def _calc(self, context, output):
            if context.get_time() > 0.01:
                raise FloatingPointError("of the controller")
            output.SetFromVector(np.zeros(output.size()))

    controller = Breaks([0.0] * 3, [100.0] * 3, [10.0] * 3)
    model = build_diagram(nominal_model("rigid"), controller=controller)
    context = model.diagram.CreateDefaultContext()
    with pytest.raises(FloatingPointError, match="of the controller"):
        integrate(model.diagram, context, 0.3)


def sliding_block(law, friction):
    """A 20 kg block on two spheres, free in the sagittal plane."""
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
    inertia = SpatialInertia(
        20.0, np.zeros(3), UnitInertia.SolidBox(0.3, 0.1, 0.05)
    )
    block = plant.AddRigidBody("block", inertia)
    turn = RigidTransform(
        RotationMatrix(
            np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        )
    )
    ground = plant.AddFrame(
        FixedOffsetFrame("ground", plant.world_frame(), turn)
    )
    middle = plant.AddFrame(
        FixedOffsetFrame("middle", block.body_frame(), turn)
    )
    plant.AddJoint(PlanarJoint("planar", ground, middle, np.zeros(3)))
    plant.Finalize()
    constants = {
        "static_friction": friction,
        "dynamic_friction": friction,
        "viscous_friction": 0.0,
        "transition_velocity": 0.01,
    }
    kind = PaperConstants if law == "paper" else SimbodyConstants
    stiffness = 5e6 if law == "simbody" else paper_stiffness(5e6)
    spheres = {
        name: ContactSphere(stiffness, 2.0, x, 0.0, RADIUS)
        for name, x in (("heel", -0.14), ("toe", 0.14))
    }
    parameters = GroundContact(law, spheres, kind(**constants))
    builder = DiagramBuilder()
    builder.AddSystem(plant)
    contact = builder.AddSystem(FootGroundContact(block.index(), parameters))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), contact.GetInputPort(name))
    builder.Connect(
        contact.GetOutputPort("spatial_forces"),
        plant.get_applied_spatial_force_input_port(),
    )
    builder.ExportOutput(
        contact.GetOutputPort("ground_reaction"), "ground_reaction"
    )
    return ExoskeletonDiagram(builder.Build(), plant, contact, None, None)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("friction", [0.4, 0.8])
def test_slides_the_analytic_distance(law, friction):
    model = sliding_block(law, friction)
    simulator = build_simulator(model)
    plant, context = model.plant, model.plant_context(simulator.get_context())
    plant.SetPositions(context, [0.0, RADIUS, 0.0])
    # Let it sink into the ground before it is pushed.
    simulator.AdvanceTo(1.0)
    settled = plant.GetPositions(context)
    reaction = model.diagram.GetOutputPort("ground_reaction").Eval(
        simulator.get_context()
    )
    assert reaction[1] == pytest.approx(20.0 * GRAVITY, rel=1e-3)
    plant.SetVelocities(context, [1.0, 0.0, 0.0])
    simulator.Initialize()
    simulator.AdvanceTo(1.0 + 1.0 / (friction * GRAVITY) + 0.3)
    distance = plant.GetPositions(context)[0] - settled[0]
    analytic = 1.0 / (2.0 * friction * GRAVITY)
    assert distance == pytest.approx(analytic, rel=0.02)
    assert abs(plant.GetVelocities(context)[0]) < 0.005


def floating_pair(damping):
    """Human and device apart, far above the ground, without gravity."""
    subject = replace(nominal_model("coupled"), gravity_m_s2=0.0)
    contact = nominal_contact(subject)
    if not damping:
        bushings = {
            name: type(b)(*b.origin, *b.stiffness, 0.0, 0.0, 0.0)
            for name, b in contact.bushings.items()
        }
        contact = replace(contact, bushings=bushings)
    model = build_diagram(subject, contact)
    simulator = build_simulator(model, integrator="runge_kutta3", accuracy=1e-4)
    context = model.plant_context(simulator.get_context())
    q = np.array([0.0, 5.0, 0.0, 0.1, 0.4, 0.5, 0.0, 0.3, 0.4])
    model.plant.SetPositions(context, q)
    return model, simulator, context


def energies_while(model, simulator, duration):
    """Kinetic plus stored energy after every step."""
    energies = []
    context = simulator.get_context()
    stored = model.diagram.GetOutputPort("energies")
    plant = model.plant

    def monitor(root):
        energies.append(
            plant.EvalKineticEnergy(plant.GetMyContextFromRoot(root))
            + np.sum(stored.Eval(root))
        )
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    simulator.AdvanceTo(context.get_time() + duration)
    return np.array(energies)


@pytest.mark.slow
def test_bushings_bring_the_chains_together():
    model, simulator, context = floating_pair(damping=True)
    root = simulator.get_context()
    apart = np.abs(model.diagram.GetOutputPort("deflections").Eval(root))
    assert apart.reshape(3, 3)[:, :2].max() > 0.02
    energies = energies_while(model, simulator, 2.0)
    assert len(energies) > 100
    assert np.max(np.diff(energies)) <= 1e-6 * energies[0]
    # What is left is motion of both together, without a joint to damp it.
    stored = np.sum(model.diagram.GetOutputPort("energies").Eval(root))
    assert stored < 0.01 * energies[0]
    q = model.plant.GetPositions(context)
    np.testing.assert_allclose(q[6:], q[3:6], atol=0.03)


def test_bushings_without_damping_keep_the_energy():
    model, simulator, _ = floating_pair(damping=False)
    energies = energies_while(model, simulator, 0.5)
    assert len(energies) > 100
    np.testing.assert_allclose(energies, energies[0], rtol=2e-4)


class Push(LeafSystem):
    """A further force, such as a chair: nothing but a recorded call."""

    def __init__(self):
        super().__init__()
        declare_force_ports(self, float, self._calc)
        self.calls = 0

    def _calc(self, context, output):
        poses = self.GetInputPort("body_poses").Eval(context)
        self.calls += len(poses) > 5
        output.set_value([])


def test_further_forces_and_torques_reach_the_plant():
    push = Push()
    model = build_diagram(nominal_model("coupled"), forces=[push])
    context = model.diagram.CreateDefaultContext()
    model.plant.SetPositions(
        model.plant_context(context), [0.0, 5.0, 0.0] + [0.0] * 6
    )
    free = model.diagram.EvalTimeDerivatives(context).CopyToVector()
    assert push.calls == 1
    # Nothing touches the ground: all falls as one.
    np.testing.assert_allclose(free[9:], [0.0, -GRAVITY] + [0.0] * 7, atol=1e-6)
    torques = np.arange(1.0, 7.0)
    model.diagram.GetInputPort("joint_torques").FixValue(context, torques)
    driven = model.diagram.EvalTimeDerivatives(context).CopyToVector()
    mass = model.plant.CalcMassMatrix(model.plant_context(context))
    np.testing.assert_allclose(
        mass @ (driven - free)[9:], [0.0] * 3 + list(torques), atol=1e-9
    )


def test_ports_of_each_kind():
    names = {"state", "ground_reaction", "sphere_wrenches"}
    interaction = {"interaction_forces", "deflections", "energies"}
    for kind, expected in (
        ("human", names),
        ("rigid", names),
        ("coupled", names | interaction),
    ):
        diagram = build_diagram(nominal_model(kind)).diagram
        outputs = {
            diagram.get_output_port(i).get_name()
            for i in range(diagram.num_output_ports())
        }
        assert outputs == expected
    coupled = nominal_model("coupled")
    free = build_diagram(coupled, ContactModel(nominal_contact(coupled).ground))
    assert free.bushings is None


def test_other_inputs_of_a_controller_are_the_diagram_s():
    class Asked(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareVectorInputPort("state", 12)
            self.DeclareVectorInputPort("wish", 3)
            self.DeclareVectorOutputPort("joint_torques", 3, self._calc)

        def _calc(self, context, output):
            output.SetFromVector(self.GetInputPort("wish").Eval(context))

    diagram = build_diagram(nominal_model("human"), controller=Asked()).diagram
    assert diagram.num_input_ports() == 1
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("wish").FixValue(context, [1.0, 2.0, 3.0])
    torques = diagram.GetOutputPort("joint_torques").Eval(context)
    np.testing.assert_equal(torques, [1.0, 2.0, 3.0])


def test_a_cuff_that_is_off_preloads_the_bushing():
    human = nominal_human()
    x, z = human.thigh_cuff_m
    device = replace(fit_exoskeleton(human), thigh_cuff_m=(x + 0.004, z))
    model = build_diagram(Model("coupled", human, device))
    context = model.diagram.CreateDefaultContext()
    deflections = model.diagram.GetOutputPort("deflections").Eval(context)
    expected = np.zeros(9)
    expected[3 * 1 + 1] = 0.004  # normal, of the second cuff
    np.testing.assert_allclose(deflections, expected, atol=1e-15)


def test_bad_requests_are_refused():
    coupled = nominal_model("coupled")
    contact = nominal_contact(coupled)
    with pytest.raises(InputError, match="kind 'rigid' has none"):
        build_diagram(coupled.rigid, contact)
    foot = {"foot": contact.bushings["shank"]}
    with pytest.raises(InputError, match="has shank, thigh, pelvis"):
        build_diagram(coupled, replace(contact, bushings=foot))
    for given, words in (
        (("coupled",), "model is 'coupled'; give a Model"),
        ((coupled, coupled), "give a ContactModel"),
    ):
        with pytest.raises(InputError, match=words):
            build_diagram(*given)
    for name in ("controller", "forces"):
        with pytest.raises(InputError, match="give a System"):
            build_diagram(coupled, contact, **{name: ["gains"]})
    built = build_diagram(coupled, contact)
    with pytest.raises(InputError, match="give a Context"):
        build_simulator(built, coupled)


def test_meshcat_shows_the_simulation():
    meshcat = Meshcat()
    model = build_diagram(nominal_model("coupled"), meshcat=meshcat)
    simulator = Simulator(model.diagram)
    model.plant.SetPositions(
        model.plant_context(simulator.get_context()), [0.0, 5.0] + [0.0] * 7
    )
    simulator.AdvanceTo(0.001)
    assert meshcat.HasPath("/drake/visualizer/human/pelvis")
    model.diagram.ToAutoDiffXd()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"integrator": "radau33"}, "no integrator 'radau33'; .*mean 'radau3'"),
        ({"accuracy": 0.0}, "accuracy is 0, but must be above 0"),
    ],
)
def test_settings_of_a_simulator_are_checked(wrong, words):
    built = build_diagram(nominal_model("human"))
    with pytest.raises(InputError, match=words):
        build_simulator(built, **wrong)


def test_cuffs_that_leave_the_plane_are_refused():
    """Turned about, their springs would act elsewhere."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    limb, cuff = (
        plant.AddRigidBody(
            name, SpatialInertia.SolidBoxWithMass(5, 0.1, 0.1, 0.1)
        )
        for name in ("limb", "cuff")
    )
    plant.Finalize()
    pairs = {"cuff": (limb.index(), cuff.index())}
    bushing = {"cuff": BushingParameters()}
    cuffs = builder.AddSystem(HumanExoskeletonBushings(pairs, bushing))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), cuffs.GetInputPort(name))
    builder.ExportOutput(cuffs.GetOutputPort("interaction_forces"), "forces")
    diagram = builder.Build()

    def forces(diagram, roll, pitch, yaw):
        context = diagram.CreateDefaultContext()
        at = plant.CreateDefaultContext()
        turned = RotationMatrix(RollPitchYaw(roll, pitch, yaw))
        plant.SetFreeBodyPose(at, limb, RigidTransform(turned, [0, 0, 0.01]))
        state = plant.GetPositionsAndVelocities(at)
        context.SetContinuousState(state)
        return diagram.GetOutputPort("forces").Eval(context)

    assert np.abs(forces(diagram, 1e-3, 0.0, 1e-3)).max() > 1.0
    for turned in (diagram, diagram.ToAutoDiffXd()):
        for roll, yaw in ((0.0, np.pi), (0.0, 0.5 * np.pi), (0.3, 0.0)):
            with pytest.raises(
                InputError,
                match=r"human_exoskeleton_bushings: body 1 .* out of the x",
            ):
                forces(turned, roll, 0.0, yaw)
