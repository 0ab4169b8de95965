"""Inverse dynamics of a walking model against OpenSim's own output."""

import numpy as np
import pytest
from angles import in_radians
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    JacobianWrtVariable,
    MultibodyForces,
    PlanarJoint,
    PrismaticJoint,
    RevoluteJoint,
    RotationalInertia,
    SpatialInertia,
    UnitInertia,
)
from scipy.signal import butter, filtfilt

from drake_exo.files.opensim import read_plates, read_table
from drake_exo.files.osim import read_osim
from drake_exo.files.tables import uniform_time
from drake_exo.measurement.filters import derivatives, resample
from drake_exo.measurement.kinematics import (
    inverse_dynamics,
)
from drake_exo.measurement.sagittal import (
    Axes,
    PlanarWrench,
    spatial_wrench,
)
from drake_exo.model.planar_tree import PlanarTree

COORDINATES = (
    "pelvis_tx",
    "pelvis_ty",
    "pelvis_tilt",
    "hip_flexion_r",
    "knee_angle_r",
    "ankle_angle_r",
    "hip_flexion_l",
    "knee_angle_l",
    "ankle_angle_l",
    "lumbar_extension",
)
FORCES = ("pelvis_tx", "pelvis_ty")


class DrakeModel:
    """A Drake plant evaluated state by state, seen in two of its axes."""

    # Of its own points, Jacobians and turns.
    by_wrench = PlanarTree.by_wrench
    wrench_on_body = PlanarTree.wrench_on_body

    def __init__(self, plant, axes):
        self.plant, self.axes = plant, list(axes)
        self.context = plant.CreateDefaultContext()

    def inverse_dynamics(self, q, v, vdot):
        plant, context = self.plant, self.context
        rows = []
        for state in zip(q, v, vdot, strict=True):
            plant.SetPositions(context, state[0])
            plant.SetVelocities(context, state[1])
            forces = MultibodyForces(plant)
            plant.CalcForceElementsContribution(context, forces)
            rows.append(plant.CalcInverseDynamics(context, state[2], forces))
        return np.array(rows)

    def turning(self, body):
        world = self.plant.world_frame()
        J = self.plant.CalcJacobianAngularVelocity(
            self.context,
            JacobianWrtVariable.kQDot,
            self.plant.GetFrameByName(body),
            world,
            world,
        )
        return np.cross(*np.eye(3)[self.axes]) @ J

    def _each(self, q, function):
        rows = []
        for positions in q:
            self.plant.SetPositions(self.context, positions)
            rows.append(function())
        return np.array(rows)

    def _point(self, p_BoP):
        p = np.zeros(3)
        p[self.axes] = p_BoP
        return p

    def point_positions(self, q, body, p_BoP=(0.0, 0.0)):
        frame = self.plant.GetFrameByName(body)
        world = self.plant.world_frame()
        return self._each(
            q,
            lambda: self.plant.CalcPointsPositions(
                self.context, frame, self._point(p_BoP), world
            )[self.axes, 0],
        )

    def point_jacobian(self, q, body, p_BoP=(0.0, 0.0)):
        frame = self.plant.GetFrameByName(body)
        world = self.plant.world_frame()
        return self._each(
            q,
            lambda: self.plant.CalcJacobianTranslationalVelocity(
                self.context,
                JacobianWrtVariable.kQDot,
                frame,
                self._point(p_BoP),
                world,
                world,
            )[self.axes],
        )


def walker(osim):
    """The .osim's planar walker in OpenSim's axes (y up, joints about z).

    OpenSim's knee slides while it turns: two prismatic joints without mass
    carry the sliding.
    """
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector([0.0, -9.80665, 0.0])
    massless = SpatialInertia(0.0, np.zeros(3), UnitInertia(0.0, 0.0, 0.0))
    for name, body in osim.bodies.items():
        inertia = SpatialInertia.MakeFromCentralInertia(
            body.mass_kg,
            body.com_m,
            RotationalInertia(*np.diag(body.inertia_kg_m2)),
        )
        plant.AddRigidBody(name, inertia)
    z = np.array([0.0, 0.0, 1.0])
    world = plant.world_frame()

    def link(name):
        return plant.GetFrameByName(name)

    def offset(parent, p):
        return plant.AddFrame(
            FixedOffsetFrame(
                f"{parent}_{plant.num_frames()}",
                link(parent),
                RigidTransform(p),
            )
        )

    def weld(parent, p, child):
        plant.WeldFrames(offset(parent, p), link(child))

    plant.AddJoint(PlanarJoint("ground", world, link("pelvis")))
    places = {joint.child: joint.X_PF.p for joint in osim.joints}
    for s in "rl":
        hip = offset("pelvis", places[f"femur_{s}"])
        plant.AddJoint(RevoluteJoint(f"hip_{s}", hip, link(f"femur_{s}"), z))
        for name in ("slide_x", "slide_y"):
            plant.AddRigidBody(f"{name}_{s}", massless)
        plant.AddJoint(
            PrismaticJoint(
                f"kx_{s}", link(f"femur_{s}"), link(f"slide_x_{s}"), [1, 0, 0]
            )
        )
        plant.AddJoint(
            PrismaticJoint(
                f"ky_{s}",
                link(f"slide_x_{s}"),
                link(f"slide_y_{s}"),
                [0, 1, 0],
            )
        )
        plant.AddJoint(
            RevoluteJoint(
                f"knee_{s}", link(f"slide_y_{s}"), link(f"tibia_{s}"), z
            )
        )
        ankle = offset(f"tibia_{s}", places[f"talus_{s}"])
        plant.AddJoint(
            RevoluteJoint(f"ankle_{s}", ankle, link(f"talus_{s}"), z)
        )
        weld(f"talus_{s}", places[f"calcn_{s}"], f"calcn_{s}")
        weld(f"calcn_{s}", places[f"toes_{s}"], f"toes_{s}")
    back = offset("pelvis", places["torso"])
    plant.AddJoint(RevoluteJoint("back", back, link("torso"), z))
    plant.Finalize()
    return plant


def with_sliding_knees(osim, q, v, a):
    """Plant states (N, 14) from OpenSim's ten coordinates, and d/dq."""
    columns = [[], [], []]
    J = np.zeros((len(q), 14, 10))
    row = 0
    for i, name in enumerate(COORDINATES):
        if name.startswith("knee"):
            joint = osim.joint_of(name.replace("knee_angle", "tibia"))
            for axis in joint.translations[:2]:
                value, slope, bend = (
                    axis.function(q[:, i], k) for k in range(3)
                )
                columns[0].append(value)
                columns[1].append(slope * v[:, i])
                columns[2].append(slope * a[:, i] + bend * v[:, i] ** 2)
                J[:, row, i] = slope
                row += 1
        for column, values in zip(columns, (q, v, a), strict=True):
            column.append(values[:, i])
        J[:, row, i] = 1.0
        row += 1
    return *(np.column_stack(c) for c in columns), J


@pytest.fixture(scope="module")
def walk(data_root):
    folder = data_root / "opensim_gait10dof"
    ik = in_radians(read_table(folder / "subject01_walk_IK.mot"))
    time = uniform_time(ik.source, ik.time)
    # OpenSim's tool: third order each way, cut-off not corrected, padded by
    # half the recording; its setup for this example says 6 Hz.
    b, a = butter(3, 6.0 / 30.0)
    q = filtfilt(b, a, ik.columns(COORDINATES), axis=0, padlen=75)
    # OpenSim looks forces up at the times as the files print them, rounded to
    # 0.1 ms: that alone is worth 0.07 N m.
    t_plates, plates = read_plates(folder / "subject01_walk_grf.mot")
    expected = read_table(folder / "subject01_walk_ID.sto")
    names = [
        f"{n}_force" if n in FORCES else f"{n}_moment" for n in COORDINATES
    ]
    return (
        read_osim(folder / "subject01.osim"),
        time,
        q,
        (t_plates, expected.time),
        list(plates.values()),
        expected.columns(names),
    )


def planar(plate, frame):
    return PlanarWrench.of_spatial(spatial_wrench(plate, frame))


def moments(walk):
    osim, time, q, (t_plates, looked_up), plates, _ = walk
    v, a = derivatives(time, q)
    model = DrakeModel(walker(osim), (0, 1))
    Q, V, A, J = with_sliding_knees(osim, q, v, a)
    loads = {}
    for body, plate in zip(("calcn_r", "calcn_l"), plates, strict=True):
        wrench = planar(plate, Axes())
        loads[body] = PlanarWrench(
            resample(t_plates, wrench.force, looked_up),
            resample(t_plates, wrench.moment, looked_up),
        )
    full = inverse_dynamics(model, Q, V, A, loads)
    return np.einsum("nij,ni->nj", J, full)


def test_joint_moments_equal_opensims(walk):
    found, expected = moments(walk), walk[-1]
    # The first and last frames depend on how the filter pads.
    inner = slice(5, -5)
    error = np.abs(found - expected)[inner]
    joints = list(range(2, len(COORDINATES)))
    assert error[:, joints].max() < 0.005  # N m, of 200
    assert error[:, :2].max() < 0.02  # N, of 800


def test_a_shifted_plate_would_be_seen(walk):
    osim, time, q, t_plates, plates, expected = walk
    shifted = [
        type(p)(p.number, p.force, p.point + np.array([0.02, 0, 0]), p.torque)
        for p in plates
    ]
    found = moments((osim, time, q, t_plates, shifted, expected))
    assert np.abs(found - expected)[5:-5, 2:].max() > 10.0


def test_batched_tree_and_drake_agree_on_wrenches(nominal):
    model = nominal("rigid")
    tree, drake = model.tree, DrakeModel(model.plant(), (0, 2))
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1, 1, (3, 4, 6))
    wrench = PlanarWrench(rng.normal(size=(4, 2)), rng.normal(size=4))
    for body in ("foot", "thigh", "pelvis"):
        np.testing.assert_allclose(
            tree.wrench_on_body(q, body, wrench.array),
            drake.wrench_on_body(q, body, wrench.array),
            atol=1e-10,
        )
    np.testing.assert_allclose(
        inverse_dynamics(tree, q, v, a, {"foot": wrench}),
        inverse_dynamics(drake, q, v, a, {"foot": wrench}),
        atol=1e-9,
    )
