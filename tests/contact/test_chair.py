import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.multibody.tree import MultibodyForces

from drake_exo.contact.diagram import build_diagram, build_simulator
from drake_exo.contact.systems import Chair
from drake_exo.errors import InputError
from drake_exo.measurement.kinematics import (
    inverse_dynamics,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.plant import nominal_model

TIMES = np.linspace(0.0, 1.0, 21)
WRENCH = np.column_stack(
    [20.0 * np.sin(6 * TIMES), 400.0 - 300.0 * TIMES, 60.0 + 5.0 * TIMES]
)
Q = np.array([0.3, 0.07, 0.02, 0.3, 1.5, 1.4])
HUMAN = nominal_model("human")


@pytest.fixture(scope="module")
def plant():
    return HUMAN.plant()


def chair(plant, **shares):
    bodies = {
        plant.GetBodyByName(name).index(): share
        for name, share in (shares or {"pelvis": 1.0}).items()
    }
    return Chair(bodies, TIMES, WRENCH)


def seated(plant, **shares):
    model = build_diagram(HUMAN, forces=[chair(plant, **shares)])
    context = model.diagram.CreateDefaultContext()
    model.plant.SetPositions(model.plant_context(context), Q)
    return model, context


@pytest.mark.parametrize(
    "shares", [{"pelvis": 1.0}, {"pelvis": 0.6, "thigh": 0.4}]
)
def test_acts_as_inverse_dynamics_takes_it(plant, shares):
    model, context = seated(plant, **shares)
    context.SetTime(0.4)
    plant_context = model.plant_context(context)
    forces = MultibodyForces(model.plant)
    port = model.diagram.GetSubsystemByName("chair").GetOutputPort(
        "spatial_forces"
    )
    system = model.diagram.GetSubsystemByName("chair")
    entries = port.Eval(system.GetMyContextFromRoot(context))
    found = np.zeros(6)
    for entry in entries:
        forces.SetZero()
        body = model.plant.get_body(entry.body_index)
        body.AddInForceInWorld(plant_context, entry.F_Bq_W, forces)
        zero = np.zeros(6)
        gravity = MultibodyForces(model.plant)
        found -= model.plant.CalcInverseDynamics(
            plant_context, zero, forces
        ) - model.plant.CalcInverseDynamics(plant_context, zero, gravity)
    tree = HUMAN.tree
    k = int(np.argmin(np.abs(TIMES - 0.4)))
    expected = 0.0
    for body, share in shares.items():
        part = PlanarWrench(
            share * WRENCH[k : k + 1, :2], share * WRENCH[k : k + 1, 2]
        )
        expected = expected + tree.wrench_on_body(Q[None], body, part.array)
    np.testing.assert_allclose(found, expected[0], atol=1e-9)


def test_bears_a_seated_body_at_rest(plant):
    """With what inverse dynamics asks for, nothing accelerates."""
    tree = HUMAN.tree
    q = Q[None].copy()
    zero = np.zeros((1, 6))
    w = PlanarWrench(WRENCH[:1, :2], WRENCH[:1, 2])
    left = inverse_dynamics(tree, q, zero, zero, {"pelvis": w})[0]
    model, context = seated(plant)
    context.SetTime(0.0)
    torque = model.diagram.GetInputPort("joint_torques")
    torque.FixValue(context, left[3:])
    # The foot is off the ground here: only joints and pelvis are in play.
    derivative = model.diagram.EvalTimeDerivatives(context).CopyToVector()
    M = model.plant.CalcMassMatrix(model.plant_context(context))
    ground = model.diagram.GetOutputPort("ground_reaction").Eval(context)
    missing = M @ derivative[6:]
    foot = PlanarWrench(ground[None, :2], ground[None, 2])
    missing -= tree.wrench_on_body(q, "foot", foot.array)[0]
    np.testing.assert_allclose(missing[:3], -left[:3], atol=1e-6)
    np.testing.assert_allclose(missing[3:], 0.0, atol=1e-6)


def test_plays_its_time_series_and_holds_its_ends(plant):
    model, context = seated(plant)
    system = model.diagram.GetSubsystemByName("chair")
    for t, k in ((-1.0, 0), (0.0, 0), (0.5, 10), (1.0, -1), (3.0, -1)):
        context.SetTime(t)
        part = system.GetMyContextFromRoot(context)
        value = system.GetOutputPort("chair_reaction").Eval(part)
        np.testing.assert_allclose(value, WRENCH[k], atol=1e-12)


def test_simulates(plant):
    model = build_diagram(HUMAN, forces=[chair(plant)])
    simulator = build_simulator(model)
    context = simulator.get_mutable_context()
    model.plant.SetPositions(model.plant_context(context), Q)
    model.diagram.GetInputPort("joint_torques").FixValue(context, np.zeros(3))
    simulator.AdvanceTo(0.05)
    state = model.diagram.GetOutputPort("state").Eval(context)
    assert np.isfinite(state).all()


def test_survives_conversion_to_autodiff(plant):
    model, context = seated(plant)
    context.SetTime(0.4)
    converted = model.diagram.ToAutoDiffXd()
    ad = converted.CreateDefaultContext()
    ad.SetTimeStateAndParametersFrom(context)
    part = converted.GetSubsystemByName("chair")
    here = part.GetMyContextFromRoot(ad)
    plant_ad = converted.GetSubsystemByName("plant")
    q = np.array([AutoDiffXd(v, np.eye(6)[i]) for i, v in enumerate(Q)])
    plant_ad.SetPositions(plant_ad.GetMyMutableContextFromRoot(ad), q)
    (entry,) = part.GetOutputPort("spatial_forces").Eval(here)
    moment = entry.F_Bq_W.rotational()[1]
    F_x, F_z = WRENCH[8, :2]
    gradient = ExtractGradient(np.array([moment])).ravel()
    # M about the pelvis = M_y - (z F_x - x F_z).
    np.testing.assert_allclose(gradient[:2], [F_z, -F_x], atol=1e-9)
    model.plant.SetPositions(model.plant_context(context), Q)
    plain = model.diagram.GetSubsystemByName("chair")
    (number,) = plain.GetOutputPort("spatial_forces").Eval(
        plain.GetMyContextFromRoot(context)
    )
    value = ExtractValue(np.array([moment])).item()
    assert value == pytest.approx(number.F_Bq_W.rotational()[1])


def test_refuses_shares_and_shapes_that_do_not_fit(plant):
    with pytest.raises(InputError, match="sum to 1"):
        chair(plant, pelvis=0.5)
    body = plant.GetBodyByName("pelvis").index()
    with pytest.raises(InputError, match="shape"):
        Chair({body: 1.0}, TIMES, WRENCH[:3])
