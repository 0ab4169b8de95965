"""LeafSystems against the pure laws and Drake's own bushing."""

import numpy as np
import pytest
from force_models import (
    body_state,
    coupled,
    generalized_force,
    random_state,
    unusual_bushings,
    unusual_ground,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    LinearBushingRollPitchYaw,
    MultibodyForces,
)

from drake_exo.contact.bushing import (
    BushingParameters,
    bushing_deflection,
    bushing_energy,
    bushing_force,
)
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.hunt_crossley import sphere_wrench
from drake_exo.contact.parameters import ContactModel, nominal_contact
from drake_exo.contact.systems import (
    FootGroundContact,
    HumanExoskeletonBushings,
    TrackingController,
)
from drake_exo.errors import InputError
from drake_exo.model.plant import nominal_model

LAWS = ("paper", "simbody")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("seed", range(5))
def test_contact_equals_the_pure_law(law, seed):
    model = coupled(law)
    context = random_state(model, seed)
    plant_context = model.plant_context(context)
    pose, motion = body_state(model.plant, plant_context, "foot")
    c, s = np.cos(pose[2]), np.sin(pose[2])
    parameters = unusual_ground(law)
    forces = model.contact.GetOutputPort("spatial_forces").Eval(
        model.contact.GetMyContextFromRoot(context)
    )
    expected = []
    for sphere, entry in zip(parameters.spheres.values(), forces, strict=True):
        arm = (c * sphere.x - s * sphere.z, s * sphere.x + c * sphere.z)
        wrench = sphere_wrench(
            law,
            pose[0] + arm[0],
            pose[1] + arm[1],
            motion[0] - motion[2] * arm[1],
            motion[1] + motion[2] * arm[0],
            motion[2],
            sphere.stiffness,
            sphere.dissipation,
            sphere.radius,
            parameters.constants,
        )
        expected.append(wrench)
        np.testing.assert_allclose(
            entry.F_Bq_W.get_coeffs(),
            [0, 0, 0, wrench.force_x, 0, wrench.force_z],
            rtol=1e-10,
            # Nearly closed gates round at 1e-16 of a force of kilonewtons.
            atol=1e-12,
        )
        foot = model.plant.GetBodyByName("foot")
        assert entry.body_index == foot.index()
        point = foot.EvalPoseInWorld(plant_context) @ entry.p_BoBq_B
        np.testing.assert_allclose(
            point, [wrench.point_x, 0.0, wrench.point_z], atol=1e-14
        )
    sums = model.diagram.GetOutputPort("ground_reaction").Eval(context)
    f_x, f_z, x, z = np.transpose(expected)
    np.testing.assert_allclose(
        sums, [sum(f_x), sum(f_z), z @ f_x - x @ f_z], rtol=1e-9
    )
    assert sums[1] > 10.0
    np.testing.assert_allclose(
        model.diagram.GetOutputPort("sphere_wrenches").Eval(context),
        np.ravel(expected),
        rtol=1e-9,
        atol=1e-12,
    )


@pytest.mark.parametrize("seed", range(5))
def test_bushings_equal_the_pure_law(seed):
    model = coupled("paper")
    context = random_state(model, seed)
    plant, plant_context = model.plant, model.plant_context(context)
    expected, generalized = [], np.zeros(9)
    for name, p in unusual_bushings().items():
        pose_h, motion_h = body_state(plant, plant_context, name)
        pose_e, motion_e = body_state(plant, plant_context, f"exo_{name}")
        deflection, rate = bushing_deflection(
            pose_h, motion_h, pose_e, motion_e, p.origin, p.preload
        )
        force = bushing_force(deflection, rate, p.stiffness, p.damping)
        expected.append(
            [force, deflection, bushing_energy(deflection, p.stiffness)]
        )
        # Another path to the generalised force: -(dd/dq)ᵀ F.
        by_human, by_device = deflection_by_pose(pose_h, pose_e, p)
        for by_pose, body in ((by_human, name), (by_device, f"exo_{name}")):
            jacobian = planar_jacobian(plant, plant_context, body)
            generalized -= (by_pose @ jacobian).T @ force
    for i, port in enumerate(("interaction_forces", "deflections", "energies")):
        np.testing.assert_allclose(
            model.diagram.GetOutputPort(port).Eval(context),
            np.ravel([values[i] for values in expected]),
            rtol=1e-9,
            atol=1e-12,
        )
    applied = model.bushings.GetOutputPort("spatial_forces").Eval(
        model.bushings.GetMyContextFromRoot(context)
    )
    np.testing.assert_allclose(
        generalized_force(model, context, applied), generalized, atol=1e-9
    )
    assert np.max(np.abs(generalized[3:])) > 1.0
    # The pair is internal: nothing pushes or turns the whole.
    np.testing.assert_allclose(generalized[:3], 0.0, atol=1e-9)


def deflection_by_pose(pose_h, pose_e, parameters):
    """Derivatives (3, 3) by the human's and the device's pose."""
    rest, step = np.zeros(3), 1e-30j
    columns = []
    for change in step * np.eye(6):
        moved, _ = bushing_deflection(
            pose_h + change[:3],
            rest,
            pose_e + change[3:],
            rest,
            parameters.origin,
            parameters.preload,
        )
        columns.append(np.imag(moved) / 1e-30)
    return np.hsplit(np.transpose(columns), 2)


def planar_jacobian(plant, plant_context, body):
    """Of (x, z, angle) of a body by the velocities."""
    jacobian = plant.CalcJacobianSpatialVelocity(
        plant_context,
        JacobianWrtVariable.kV,
        plant.GetFrameByName(body),
        np.zeros(3),
        plant.world_frame(),
        plant.world_frame(),
    )
    return np.array([jacobian[3], jacobian[5], -jacobian[1]])


@pytest.mark.parametrize("seed", range(5))
def test_equal_stiffness_without_damping_is_drakes_bushing(seed):
    stiffness, rotational, origin = 3000.0, 40.0, (0.05, 0.2)
    bushing = BushingParameters(
        *origin, stiffness, stiffness, rotational, 0.0, 0.0, 0.0
    )
    subject = nominal_model("coupled")
    ground = nominal_contact(subject).ground
    model = build_diagram(subject, ContactModel(ground, {"thigh": bushing}))
    context = random_state(model, seed)
    ours = model.bushings.GetOutputPort("spatial_forces").Eval(
        model.bushings.GetMyContextFromRoot(context)
    )
    plant = subject.plant(MultibodyPlant(0.0))
    frames = [
        plant.AddFrame(
            FixedOffsetFrame(
                f"{name}_bushing",
                plant.GetFrameByName(name),
                RigidTransform([origin[0], 0.0, origin[1]]),
            )
        )
        for name in ("thigh", "exo_thigh")
    ]
    element = plant.AddForceElement(
        LinearBushingRollPitchYaw(
            *frames,
            torque_stiffness_constants=[0.0, rotational, 0.0],
            torque_damping_constants=np.zeros(3),
            force_stiffness_constants=np.full(3, stiffness),
            force_damping_constants=np.zeros(3),
        )
    )
    plant.Finalize()
    other = plant.CreateDefaultContext()
    plant.SetPositions(
        other, model.plant.GetPositions(model.plant_context(context))
    )
    # Drake's force on the second frame, at its origin.
    on_device = element.CalcBushingSpatialForceOnFrameC(other)
    rotation = frames[1].CalcPoseInWorld(other).rotation()
    np.testing.assert_allclose(
        ours[1].F_Bq_W.get_coeffs(),
        np.concatenate(
            [
                rotation @ on_device.rotational(),
                rotation @ on_device.translational(),
            ]
        ),
        atol=1e-9,
    )
    np.testing.assert_allclose(
        ours[1].p_BoBq_B, [origin[0], 0.0, origin[1]], atol=1e-14
    )
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(other, forces)
    gravity = plant.CalcGravityGeneralizedForces(other)
    drakes = plant.CalcGeneralizedForces(other, forces) - gravity
    np.testing.assert_allclose(
        generalized_force(model, context, ours), drakes, atol=1e-8
    )
    assert np.max(np.abs(drakes)) > 1.0


def test_a_tracking_controller_is_torque_and_feedback():
    """By hand: what is ahead of its reference is held back."""
    rng = np.random.default_rng(2)
    times = np.linspace(0.0, 1.0, 5)
    q, v, a = rng.standard_normal((3, 5, 6))
    torque = rng.standard_normal((5, 3))
    controller = TrackingController(times, q, v, a, torque, 400.0, 20.0)
    context = controller.CreateDefaultContext()
    state, port = (
        controller.GetInputPort("state"),
        controller.GetOutputPort("joint_torques"),
    )
    for k in (0, 3):
        context.SetTime(times[k])
        state.FixValue(context, np.r_[q[k], v[k]])
        np.testing.assert_allclose(port.Eval(context), torque[k])
        off, rate = rng.standard_normal((2, 6))
        state.FixValue(context, np.r_[q[k] + off, v[k] + rate])
        expected = torque[k] - 400.0 * off[3:] - 20.0 * rate[3:]
        np.testing.assert_allclose(port.Eval(context), expected)
    # Before and after its times the ends are held.
    for k, time in ((0, -1.0), (-1, 3.0)):
        context.SetTime(time)
        state.FixValue(context, np.r_[q[k], v[k]])
        np.testing.assert_allclose(port.Eval(context), torque[k])


def test_wrong_parts_of_a_system_are_told():
    """Before a diagram is built of it, not by Drake at its first step."""
    human = nominal_model("human")
    ground = nominal_contact(human).ground
    foot = human.plant().GetBodyByName("foot")
    cuff = {"thigh": BushingParameters()}
    still = np.zeros((2, 6))
    for make, words in (
        (lambda: FootGroundContact(foot, ground), "give its index"),
        (
            lambda: FootGroundContact(foot.index(), nominal_contact(human)),
            "give a GroundContact",
        ),
        (
            lambda: HumanExoskeletonBushings({"thigh": ("a", "b")}, cuff),
            "pairs: thigh is 'a'; give its index",
        ),
        (
            lambda: TrackingController([0, 1], *[still] * 3, still[:, 4:]),
            r"\(2, 2\); for 2 times",
        ),
        (
            lambda: TrackingController([1, 0], *[still] * 3, still[:, 3:]),
            "do not increase",
        ),
    ):
        with pytest.raises(InputError, match=words):
            make()
    lists = still.tolist()
    TrackingController([0, 1], *[lists] * 3, still[:, 3:].tolist())


def test_each_hinge_has_its_own_feedback():
    still = np.zeros((2, 6))
    controller = TrackingController(
        [0, 1], *[still] * 3, still[:, 3:], [1, 2, 3], [4, 5, 6]
    )
    context = controller.CreateDefaultContext()
    state = np.r_[0, 0, 0, 0.1, 0.1, 0.1, 0, 0, 0, 1, 1, 1]
    controller.GetInputPort("state").FixValue(context, state)
    torques = controller.GetOutputPort("joint_torques").Eval(context)
    np.testing.assert_allclose(torques, [-4.1, -5.2, -6.3])
