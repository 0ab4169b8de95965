import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PlanarJoint,
    RevoluteJoint,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)

from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.planar_tree import PlanarTree

_LINKS = {
    "base": (2.0, 0.3, (0.1, 0.02)),
    "a": (3.0, 0.2, (0.01, 0.3)),
    "b": (5.0, 0.4, (-0.02, 0.2)),
    "c": (1.0, 0.1, (0.05, 0.1)),
    "welded": (0.7, 0.05, (0.02, -0.1)),
}


def test_hinges_are_where_drake_has_them():
    plant = _plant()
    tree = PlanarTree.from_plant(plant)
    context = plant.CreateDefaultContext()
    for name in ("a", "b", "c"):
        frame = plant.GetJointByName(name).frame_on_parent()
        x, _, z = frame.CalcPoseInWorld(context).translation()
        np.testing.assert_allclose(tree.hinge_place(name), [x, z], atol=1e-12)


def _plant(axis=(0.0, -1.0, 0.0)):
    """A branched tree: base with chain a-b and branch c; a weld on b."""
    plant = MultibodyPlant(0.0)
    for name, (mass, radius, (x, z)) in _LINKS.items():
        unit = UnitInertia.SolidEllipsoid(radius, radius / 2, radius)
        plant.AddRigidBody(
            name,
            SpatialInertia.MakeFromCentralInertia(
                mass, [x, 0.03, z], unit * mass
            ),
        )
    turn = RotationMatrix(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]))
    frame_W = plant.AddFrame(
        FixedOffsetFrame(
            "ground_p", plant.world_frame(), RigidTransform(turn, [0, 0, 0])
        )
    )
    base = plant.GetBodyByName("base")
    frame_B = plant.AddFrame(
        FixedOffsetFrame(
            "base_p", base.body_frame(), RigidTransform(turn, [0, 0, 0])
        )
    )
    plant.AddJoint(PlanarJoint("planar", frame_W, frame_B, [0, 0, 0]))
    for parent, child, p, ax in [
        ("base", "a", (0.0, 0.0, 0.1), (0, 1, 0)),
        ("a", "b", (0.02, 0.0, 0.4), (0, -1, 0)),
        ("base", "c", (0.1, 0.0, -0.05), axis),
    ]:
        plant.AddJoint(
            RevoluteJoint(
                child,
                plant.AddFrame(
                    FixedOffsetFrame(
                        child + "_p",
                        plant.GetBodyByName(parent).body_frame(),
                        RigidTransform(p),
                    )
                ),
                plant.GetBodyByName(child).body_frame(),
                ax,
            )
        )
    plant.AddJoint(
        WeldJoint(
            "weld",
            plant.GetBodyByName("b").body_frame(),
            plant.GetBodyByName("welded").body_frame(),
            RigidTransform(RollPitchYaw(0, 0.3, 0), [0.1, 0, 0.2]),
        )
    )
    plant.Finalize()
    return plant


def _states(n, seed=3):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (3, n, 6))


def test_inverse_dynamics_equals_drake():
    from pydrake.multibody.tree import MultibodyForces

    plant = _plant()
    tree = PlanarTree.from_plant(plant)
    context = plant.CreateDefaultContext()
    q, v, vdot = _states(20)
    found = tree.inverse_dynamics(q, v, vdot)
    for i in range(20):
        plant.SetPositions(context, q[i])
        plant.SetVelocities(context, v[i])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        expected = plant.CalcInverseDynamics(context, vdot[i], forces)
        np.testing.assert_allclose(
            found[i], expected, atol=1e-11 * np.abs(expected).max()
        )


@pytest.mark.parametrize("body", list(_LINKS))
def test_points_equal_drake(body):
    plant = _plant()
    tree = PlanarTree.from_plant(plant)
    context = plant.CreateDefaultContext()
    q = _states(5)[0]
    found = tree.point_positions(q, body, [0.12, -0.34])
    for i in range(5):
        plant.SetPositions(context, q[i])
        X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(body))
        expected = X_WB.multiply([0.12, 0.0, -0.34])
        np.testing.assert_allclose(found[i], expected[[0, 2]], atol=1e-12)
        com = plant.CalcCenterOfMassPositionInWorld(context)
        np.testing.assert_allclose(
            tree.center_of_mass(q)[i], com[[0, 2]], atol=1e-12
        )
        x_axis = X_WB.rotation().matrix()[:, 0]
        angle = tree.body_angles(q, body)[i]
        np.testing.assert_allclose(
            [np.cos(angle), np.sin(angle)], x_axis[[0, 2]], atol=1e-12
        )


def _central(function, x, step=1e-6):
    columns = []
    for k in range(x.shape[1]):
        dx = np.zeros(x.shape[1])
        dx[k] = step
        columns.append((function(x + dx) - function(x - dx)) / (2 * step))
    return np.stack(columns, axis=-1)


def test_jacobians_equal_finite_differences():
    tree = PlanarTree.from_plant(_plant())
    q, v, vdot = _states(4)
    J_q, J_v, J_a = tree.inverse_dynamics_jacobians(q, v, vdot)
    f = tree.inverse_dynamics
    np.testing.assert_allclose(
        J_q, _central(lambda x: f(x, v, vdot), q), atol=2e-8
    )
    np.testing.assert_allclose(
        J_v, _central(lambda x: f(q, x, vdot), v), atol=2e-8
    )
    np.testing.assert_allclose(
        J_a, _central(lambda x: f(q, v, x), vdot), atol=2e-8
    )
    np.testing.assert_allclose(
        tree.point_jacobian(q, "c", [0.1, 0.2]),
        _central(lambda x: tree.point_positions(x, "c", [0.1, 0.2]), q),
        atol=1e-8,
    )


def test_ground_reaction_takes_the_place_of_the_roots_forces():
    tree = PlanarTree.from_plant(_plant())
    q, Q, _ = _states(5)
    wrench = PlanarWrench.of(tree.ground_reaction(q, Q))
    found = tree.wrench_on_body(q, tree.root, wrench.array)
    np.testing.assert_allclose(found[:, :3], Q[:, :3], atol=1e-12)
    assert not found[:, 3:].any()
    assert tree.weight == pytest.approx(11.7 * 9.81)


def test_a_plant_that_leaves_the_plane_is_refused():
    with pytest.raises(ValueError, match="not a planar tree"):
        PlanarTree.from_plant(_plant(axis=(1.0, 0.0, 0.0)))
