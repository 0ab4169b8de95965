"""Spheres under a foot that moves in space: the law, balances, a sole's law."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from force_models import unusual_ground
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex, FixedOffsetFrame, SpatialInertia
from pydrake.symbolic import Evaluate
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import Integrator

from drake_exo.contact.diagram import connect_forces
from drake_exo.contact.hunt_crossley import (
    SimbodyConstants,
    friction_coefficient,
    sphere_force,
)
from drake_exo.contact.parameters import ContactSphere, GroundContact
from drake_exo.contact.reduction import (
    SoleLaw,
    SoleSphere,
    reduce_sole,
    softened,
)
from drake_exo.contact.systems import FootGroundContact
from drake_exo.errors import InputError
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.loads import Load
from drake_exo.soles.results import sole_samples

LAWS = ("paper", "simbody")
MASS, GRAVITY = 20.0, 9.81
FOOT = BodyIndex(1)


def spatial_ground(law):
    """Spheres with all three coordinates."""
    ground = unusual_ground(law)
    spheres = {
        name: replace(sphere, y=y)
        for (name, sphere), y in zip(
            ground.spheres.items(), (0.01, 0.04, -0.05), strict=True
        )
    }
    return replace(ground, spheres=spheres)


def random_state(seed, speed=0.5):
    """Pose near the ground and motion: R, p, w, v."""
    rng = np.random.default_rng(seed)
    roll, pitch = rng.uniform(-0.3, 0.3, 2)
    R = RotationMatrix(RollPitchYaw(roll, pitch, rng.uniform(-3, 3))).matrix()
    p = np.array([*rng.uniform(-1, 1, 2), rng.uniform(0.06, 0.1)])
    return R, p, *rng.uniform(-speed, speed, (2, 3))


def evaluate(system, R, p, w, v):
    """Wrench about the origin (6,), and (forces, points) of the spheres."""
    context = system.CreateDefaultContext()
    X = RigidTransform(RotationMatrix(R), p)
    for name, values in (
        ("body_poses", [RigidTransform(), X]),
        ("body_spatial_velocities",
         [SpatialVelocity.Zero(), SpatialVelocity(w, v)]),
    ):  # fmt: skip
        system.GetInputPort(name).FixValue(context, AbstractValue.Make(values))
    entries = system.GetOutputPort("spatial_forces").Eval(context)
    assert all(entry.body_index == FOOT for entry in entries)
    assert all(not entry.F_Bq_W.rotational().any() for entry in entries)
    forces = np.array([entry.F_Bq_W.translational() for entry in entries])
    points = np.array([X @ entry.p_BoBq_B for entry in entries])
    total = system.GetOutputPort("spatial_reaction").Eval(context)
    plane = system.GetOutputPort("ground_reaction").Eval(context)
    np.testing.assert_array_equal(plane, total[[3, 5, 1]])
    flat = system.GetOutputPort("sphere_wrenches").Eval(context).reshape(-1, 4)
    np.testing.assert_array_equal(flat[:, :2], forces[:, ::2])
    np.testing.assert_allclose(flat[:, 2:], points[:, ::2], atol=1e-15)
    return total, forces, points


@pytest.mark.parametrize("law", LAWS)
def test_forces_are_those_of_the_closed_form(law):
    ground = spatial_ground(law)
    system, constants = FootGroundContact(FOOT, ground), ground.constants
    smooth = (
        constants.slip_smoothing
        if law == "paper"
        else np.sqrt(constants.constant_contact_force)
    )
    for seed in range(20):
        R, p, w, v = random_state(seed)
        total, forces, points = evaluate(system, R, p, w, v)
        for sphere, force, point in zip(
            ground.spheres.values(), forces, points, strict=True
        ):
            center = p + R @ [sphere.x, sphere.y, sphere.z]
            depth = sphere.radius - center[2]
            lowest = sphere.radius - (0 if law == "paper" else 0.5 * depth)
            touch = center - [0, 0, lowest]
            slip = (v + np.cross(w, touch - p))[:2]
            sinks = -(v + np.cross(w, center - p))[2]
            normal, _ = sphere_force(
                law, depth, sinks, 0.0, sphere.stiffness, sphere.dissipation,
                sphere.radius, constants,
            )  # fmt: skip
            speed = np.hypot(np.linalg.norm(slip), smooth)
            mu = friction_coefficient(law, speed, constants)
            wanted = [*(-mu * normal * slip / speed), normal]
            np.testing.assert_allclose(force, wanted, rtol=1e-11, atol=1e-11)
            np.testing.assert_allclose(point, touch, atol=1e-14)
        moment = np.cross(points, forces).sum(axis=0)
        wanted = [*moment, *forces.sum(axis=0)]
        np.testing.assert_allclose(total, wanted, atol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_forces_turn_with_the_foot(law):
    """About the vertical, and move along over the ground."""
    system = FootGroundContact(FOOT, spatial_ground(law))
    for seed in range(5):
        R, p, w, v = random_state(seed)
        _, forces, points = evaluate(system, R, p, w, v)
        Z = RotationMatrix.MakeZRotation(0.7 + seed).matrix()
        away = np.array([0.3, -2.0, 0.0])
        _, turned, moved = evaluate(system, Z @ R, Z @ p + away, Z @ w, Z @ v)
        np.testing.assert_allclose(turned, forces @ Z.T, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(moved, points @ Z.T + away, atol=1e-12)


def stored(sphere, depth, constants):
    """Elastic energy of a "simbody" sphere [J], by quadrature."""
    x = np.linspace(-0.1, depth, 4001)
    still = 0 * x
    force, _ = sphere_force(
        "simbody", x, still, still, sphere.stiffness, 0.0, sphere.radius,
        constants,
    )  # fmt: skip
    return np.trapezoid(force, x)


def test_contact_takes_power_and_never_gives_it():
    """Friction wherever the ground presses; all but elastic power always."""
    ground = spatial_ground("simbody")
    system = FootGroundContact(FOOT, ground)
    for seed in range(60):
        R, p, w, v = random_state(seed, speed=1.5)
        _, forces, points = evaluate(system, R, p, w, v)
        velocity = v + np.cross(w, points - p)
        slides = (forces * velocity)[:, :2].sum(axis=1)
        assert (slides[forces[:, 2] >= 0.0] <= 0.0).all()
        for k, sphere in enumerate(ground.spheres.values()):
            depth = sphere.radius - (p + R @ [sphere.x, sphere.y, sphere.z])[2]
            elastic, _ = sphere_force(
                "simbody", depth, 0.0, 0.0, sphere.stiffness, 0.0,
                sphere.radius, ground.constants,
            )  # fmt: skip
            assert forces[k] @ velocity[k] - elastic * velocity[k, 2] <= 1e-9


class Power(LeafSystem):
    """Power of forces on one body [W], from what the plant is given."""

    def __init__(self):
        super().__init__()
        for name, kind in (
            ("forces", ExternallyAppliedSpatialForce()),
            ("body_poses", RigidTransform()),
            ("body_spatial_velocities", SpatialVelocity()),
        ):
            self.DeclareAbstractInputPort(name, AbstractValue.Make([kind]))
        self.DeclareVectorOutputPort("power", 1, self._calc)

    def _calc(self, context, output):
        forces, poses, motions = (
            self.get_input_port(i).Eval(context) for i in range(3)
        )
        R, motion = poses[1].rotation(), motions[1]
        power = sum(motion.Shift(R @ e.p_BoBq_B).dot(e.F_Bq_W) for e in forces)
        output.SetFromVector([power])


HALF = np.array([0.14, 0.05, 0.03])


def block(ground=None, friction=0.5, system=None):
    """A free box on spheres at its lower corners, and what they do to it.

    Returns:
        Diagram with the outputs reaction, impulse (6) and work (1), the plant.
    """
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY])
    inertia = SpatialInertia.SolidBoxWithMass(MASS, *(2 * HALF))
    box = plant.AddRigidBody("box", inertia)
    plant.Finalize()
    contact = builder.AddSystem(
        FootGroundContact(box.index(), ground or corners(friction))
    )
    connect_forces(builder, plant, [contact])
    power = builder.AddSystem(Power())
    builder.Connect(
        contact.GetOutputPort("spatial_forces"), power.GetInputPort("forces")
    )
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), power.GetInputPort(name))
    reaction = contact.GetOutputPort("spatial_reaction")
    builder.ExportOutput(reaction, "reaction")
    for name, port, size in (
        ("impulse", reaction, 6),
        ("work", power.get_output_port(), 1),
        ("state_sum", plant.get_state_output_port(), 13),
    ):
        total = builder.AddSystem(Integrator(size))
        builder.Connect(port, total.get_input_port())
        builder.ExportOutput(total.get_output_port(), name)
    return builder.Build(), plant


def corners(friction):
    """Spheres whose lowest points are the box's lower corners."""
    radius = 0.02
    spheres = {
        f"{x:g} {y:g}": ContactSphere(
            4e6, 1.0, x * HALF[0], radius - HALF[2], radius, y * HALF[1]
        )
        for x in (-1, 1)
        for y in (-1, 1)
    }
    constants = SimbodyConstants(
        static_friction=friction,
        dynamic_friction=friction,
        viscous_friction=0.0,
        transition_velocity=0.01,
        constant_contact_force=1e-7,
        hertz_smoothing=3000.0,
    )
    return GroundContact("simbody", spheres, constants)


def simulator_of(diagram, accuracy=1e-5):
    simulator = Simulator(diagram)
    config = SimulatorConfig(
        integration_scheme="radau3", max_step_size=0.02, accuracy=accuracy
    )
    ApplySimulatorConfig(config, simulator)
    return simulator


def momentum(plant, context):
    """Angular about the world's origin and linear (6,)."""
    box = plant.GetBodyByName("box")
    found = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
    assert box.get_mass(context) == MASS
    return found.get_coeffs()


def check_balances(diagram, plant, root, before, near):
    """Momentum and energy against impulse and work of the ground."""
    context = plant.GetMyContextFromRoot(root)
    port = {
        name: diagram.GetOutputPort(name).Eval(root)
        for name in ("impulse", "work", "state_sum")
    }
    weight = np.array([0.0, 0.0, -MASS * GRAVITY])
    gravity = np.r_[
        np.cross(port["state_sum"][4:7], weight), root.get_time() * weight
    ]
    gained = momentum(plant, context) - before[0]
    scale = MASS * GRAVITY * root.get_time()
    np.testing.assert_allclose(
        gained, port["impulse"] + gravity, atol=near * scale
    )
    assert energy(plant, context) - before[1] == pytest.approx(
        port["work"][0], abs=near * abs(before[1])
    )


def energy(plant, context):
    return plant.EvalKineticEnergy(context) + plant.EvalPotentialEnergy(context)


@pytest.mark.slow
def test_a_block_slides_to_rest_by_friction():
    """Any way over the ground, its deceleration is μ g; then it stands."""
    mu, speed, heading = 0.4, 1.0, 2.1
    diagram, plant = block(friction=mu)
    simulator = simulator_of(diagram)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    box = plant.GetBodyByName("box")
    yaw = RotationMatrix.MakeZRotation(0.5)
    plant.SetFreeBodyPose(context, box, RigidTransform(yaw, [0, 0, HALF[2]]))
    simulator.AdvanceTo(1.0)
    weight = diagram.GetOutputPort("reaction").Eval(root)
    np.testing.assert_allclose(
        weight, [0, 0, 0, 0, 0, MASS * GRAVITY], atol=1e-3 * MASS * GRAVITY
    )
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    start = box.EvalPoseInWorld(context).translation()
    motion = SpatialVelocity(np.zeros(3), speed * ahead)
    plant.SetFreeBodySpatialVelocity(context, box, motion)
    simulator.Initialize()
    simulator.AdvanceTo(1.1)
    first = box.EvalSpatialVelocityInWorld(context).translational()
    simulator.AdvanceTo(1.2)
    then = box.EvalSpatialVelocityInWorld(context).translational()
    rate = (first - then)[:2] / 0.1
    np.testing.assert_allclose(
        rate, mu * GRAVITY * ahead[:2], atol=0.03 * mu * GRAVITY
    )
    simulator.AdvanceTo(1.0 + speed / (mu * GRAVITY) + 0.8)
    way = box.EvalPoseInWorld(context).translation() - start
    distance = speed**2 / (2 * mu * GRAVITY)
    np.testing.assert_allclose(way, distance * ahead, atol=0.02 * distance)
    end = box.EvalSpatialVelocityInWorld(context).get_coeffs()
    assert np.abs(end).max() < 1e-3


@pytest.mark.slow
def test_a_tilted_block_falls_and_comes_to_rest():
    """Momentum and energy change by what the ground does, at every height."""
    ground = corners(0.5)
    diagram, plant = block(ground)
    simulator = simulator_of(diagram)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    box = plant.GetBodyByName("box")
    tilt = RotationMatrix(RollPitchYaw(0.3, -0.2, 0.8))
    plant.SetFreeBodyPose(context, box, RigidTransform(tilt, [0, 0, 0.12]))
    plant.SetFreeBodySpatialVelocity(
        context, box, SpatialVelocity([0.5, -1.0, 2.0], [0.4, -0.3, 0.0])
    )
    before = momentum(plant, context), energy(plant, context)
    whole = []

    def monitor(root):
        own = plant.GetMyContextFromRoot(root)
        X = box.EvalPoseInWorld(own)
        kept = sum(
            stored(s, s.radius - (X @ [s.x, s.y, s.z])[2], ground.constants)
            for s in ground.spheres.values()
        )
        whole.append(energy(plant, own) + kept)
        return EventStatus.DidNothing()

    simulator.set_monitor(monitor)
    for time in (0.1, 0.2, 0.5, 1.0):
        simulator.AdvanceTo(time)
        check_balances(diagram, plant, root, before, 1e-3)
    assert len(whole) > 50
    assert np.diff(whole).max() < 1e-3 * whole[0]
    assert whole[-1] < 0.4 * whole[0]
    simulator.AdvanceTo(1.5)
    reaction = diagram.GetOutputPort("reaction").Eval(root)
    assert reaction[5] == pytest.approx(MASS * GRAVITY, rel=1e-3)
    end = box.EvalSpatialVelocityInWorld(context).get_coeffs()
    assert np.abs(end).max() < 5e-3


@pytest.fixture(scope="module")
def spun():
    """A box in the ground, turned and moving, with spheres of every kind."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    inertia = SpatialInertia.SolidBoxWithMass(MASS, *(2 * HALF))
    box = plant.AddRigidBody("box", inertia)
    plant.Finalize()
    contact = builder.AddSystem(
        FootGroundContact(box.index(), spatial_ground("simbody"))
    )
    connect_forces(builder, plant, [contact])
    builder.ExportOutput(contact.GetOutputPort("spatial_reaction"), "reaction")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    R, p, w, v = random_state(3)
    own = plant.GetMyMutableContextFromRoot(context)
    X = RigidTransform(RotationMatrix(R), p)
    plant.SetFreeBodyPose(own, box, X)
    plant.SetFreeBodySpatialVelocity(own, box, SpatialVelocity(w, v))
    return diagram, context


def test_derivatives_are_those_of_differences(spun):
    diagram, context = spun
    state = context.get_continuous_state_vector().CopyToVector()
    other = diagram.ToAutoDiffXd()
    active = other.CreateDefaultContext()
    active.SetContinuousState(InitializeAutoDiff(state).ravel())
    port = other.GetOutputPort("reaction").Eval(active)
    gradient = ExtractGradient(port.reshape(-1, 1))
    assert gradient.shape == (6, 13)
    moved = diagram.CreateDefaultContext()
    for column, value in enumerate(np.eye(13)):
        reaction = []
        for step in (1e-6, -1e-6):
            moved.SetContinuousState(state + step * value)
            reaction.append(diagram.GetOutputPort("reaction").Eval(moved))
        slope = (reaction[0] - reaction[1]) / 2e-6
        np.testing.assert_allclose(
            gradient[:, column], slope, atol=1e-6 * np.abs(slope).max() + 1e-4
        )


def test_forces_are_expressions(spun):
    diagram, context = spun
    symbolic = diagram.ToSymbolic()
    other = symbolic.CreateDefaultContext()
    other.SetTimeStateAndParametersFrom(context)
    found = Evaluate(symbolic.GetOutputPort("reaction").Eval(other)).ravel()
    wanted = diagram.GetOutputPort("reaction").Eval(context)
    assert wanted[5] > 10.0
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_spheres_come_back_from_a_context():
    ground = spatial_ground("simbody")
    system = FootGroundContact(FOOT, ground)
    context = system.CreateDefaultContext()
    assert system.parameters(context) == ground
    spheres = {n: replace(s, y=-s.y) for n, s in ground.spheres.items()}
    system.set_parameters(context, replace(ground, spheres=spheres))
    assert system.parameters(context).spheres == spheres
    toe = astuple(spheres["toe"])
    assert toe[:-1] == spheres["toe"].in_plane and toe[-1] == 0.05


def sole_law():
    spheres = {
        name: SoleSphere(2e7, x_m=x, y_m=y, z_m=0.01)
        for name, x, y in (
            ("heel", -0.1, 0.0), ("inner", 0.1, 0.04), ("outer", 0.08, -0.03)
        )
    }  # fmt: skip
    return SoleLaw((0.26, 0.1, 0.022), spheres, softened(0.15))


def test_a_sole_lies_where_its_frame_is():
    """Its spheres are in the frame's place, not in the foot's own."""
    law = sole_law()
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia.SolidBoxWithMass(MASS, *(2 * HALF))
    foot = plant.AddRigidBody("foot", inertia)
    X_BF = RigidTransform(
        RollPitchYaw(0.1, -0.2, np.pi / 2), [0.03, -0.01, -0.08]
    )
    sole = plant.AddFrame(FixedOffsetFrame("sole", foot.body_frame(), X_BF))
    system = law.under(sole)
    found = system.parameters()
    assert found.constants == law.constants
    R, p, w, v = random_state(1)
    p[2] = 0.105
    X_WF = RigidTransform(RotationMatrix(R), p) @ X_BF
    own = law.under(foot.body_frame())
    arm = X_WF.translation() - p
    total, *_ = evaluate(system, R, p, w, v)
    there, *_ = evaluate(
        own, X_WF.rotation().matrix(), X_WF.translation(), w,
        v + np.cross(w, arm),
    )  # fmt: skip
    assert total[5] > 10.0
    np.testing.assert_allclose(total, there, rtol=1e-9)
    with pytest.raises(InputError, match=r"is <RigidBody .*; give a Frame"):
        law.under(foot)


def test_the_other_foot_s_sole_is_its_mirror_image():
    law = sole_law()
    body = MultibodyPlant(0.0).world_frame()
    left, right = law.under(body), law.mirrored().under(body)
    assert law.mirrored().mirrored() == law
    left, right = (
        [astuple(s) for s in system.parameters().spheres.values()]
        for system in (left, right)
    )
    sign = [1, 1, 1, 1, 1, -1]
    np.testing.assert_array_equal(np.array(left) * sign, right)


def test_forces_are_connected_once():
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    inertia = SpatialInertia.SolidBoxWithMass(MASS, *(2 * HALF))
    feet = [plant.AddRigidBody(name, inertia) for name in ("left", "right")]
    plant.Finalize()
    soles = [
        builder.AddSystem(sole_law().under(foot.body_frame())) for foot in feet
    ]
    with pytest.raises(InputError, match="a system of forces is <RigidBody"):
        connect_forces(builder, plant, feet)
    connect_forces(builder, plant, soles)
    with pytest.raises(InputError, match="connected already; give all"):
        connect_forces(builder, plant, soles)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    own = plant.GetMyMutableContextFromRoot(context)
    for foot, height in zip(feet, (0.0205, 0.021), strict=True):
        plant.SetFreeBodyPose(own, foot, RigidTransform([0, 0, height]))
    given = plant.get_applied_spatial_force_input_port().Eval(own)
    assert [int(e.body_index) for e in given] == [1, 1, 1, 2, 2, 2]
    pressed = [e.F_Bq_W.translational()[2] for e in given]
    assert min(pressed[:3]) > max(pressed[3:]) > 10.0


@pytest.fixture(scope="module")
def pressed():
    """A sole whose centre of pressure goes round, and four spheres for it."""
    case = Case.from_text(EXAMPLE)
    turn = np.linspace(0.0, 2 * np.pi, 17)
    zmp = np.column_stack([0.05 * np.cos(turn), 0.02 * np.sin(turn)])
    force = np.column_stack([0 * turn, 0 * turn, 300 + 50 * np.sin(3 * turn)])
    step = replace(case, load=Load(0.1 * turn, force, zmp)).simulate()
    samples = sole_samples(step)
    return step, samples, reduce_sole(samples, 4)


@pytest.mark.slow
def test_a_sole_s_law_bears_what_the_reduction_says(pressed):
    """Force, centre of pressure and free moment at the simulation's poses."""
    _, samples, found = pressed
    system = found.law.under(MultibodyPlant(0.0).world_frame())
    system = FootGroundContact(FOOT, system.parameters())
    force, cop, spin = [], [], []
    for R, p in zip(samples.rotation, samples.origin, strict=True):
        total, *_ = evaluate(system, R, p, np.zeros(3), np.zeros(3))
        assert np.abs(total[2:5]).max() < 1e-9  # at rest there is no friction
        force.append(total[5])
        cop.append([-total[1] / total[5], total[0] / total[5]])
        # It turns about its centre of pressure, fast.
        centre = np.array([*cop[-1], 0.0])
        w = np.array([0.0, 0.0, 50.0])
        turned, *_ = evaluate(system, R, p, w, np.cross(w, p - centre))
        spin.append(-(turned[2] - np.cross(centre, turned[3:])[2]))
    np.testing.assert_allclose(force, found.force, rtol=1e-9)
    np.testing.assert_allclose(cop, found.cop, atol=1e-9)
    rows = found.table()
    np.testing.assert_allclose(spin, rows["spin_spheres_n_m"], rtol=1e-6)
    off = np.array(force) - samples.force
    assert found.law.force_error_rms == pytest.approx(
        np.sqrt((off**2).mean()) / samples.force.max()
    )
    off = np.linalg.norm(cop - samples.cop, axis=1)
    assert found.law.cop_error_rms_m == pytest.approx(np.sqrt((off**2).mean()))
    off = np.array(spin) - rows["spin_n_m"]
    assert found.law.spin_error_rms == pytest.approx(
        np.sqrt((off**2).mean()) / rows["spin_n_m"].max(), rel=1e-5
    )
    assert found.is_near


@pytest.mark.slow
def test_the_sole_s_own_free_moment_is_that_of_its_nodes(pressed):
    step, samples, found = pressed
    rows = found.table()
    history = step.history
    for q in (0, 5):
        moment = 0.0
        for node, push in zip(history.P[q], history.F[q], strict=True):
            reach = np.hypot(*(node[:2] - samples.cop[q]))
            moment += samples.friction * push[2] * reach
        assert rows["spin_n_m"][q] == pytest.approx(moment)
