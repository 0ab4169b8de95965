"""Where a solve starts, part by part: on a model of two legs and toes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from drake_exo.calibration import start
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.hunt_crossley import sphere_wrench
from drake_exo.contact.parameters import (
    ContactSphere,
    GroundContact,
    nominal_contact,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import scale_human
from drake_exo.virtual_laboratory.synthetic import Rise, draw


@pytest.fixture(scope="module")
def tree():
    kind = Assembly(Person("two", "hinged"))
    return Model(kind, scale_human(70.0, 1.75)).tree


def _postures(tree, n=3, seed=0):
    rng = np.random.default_rng(seed)
    return 0.3 * rng.standard_normal((n, tree.num_positions))


def test_least_change_is_the_least_that_brings_what_is_missing(tree):
    """By a minimiser: centimetres of the pelvis against 0.05 rad of joints."""
    q = _postures(tree, 2)
    J = tree.pose_jacobian(q, "foot_left")
    missing = np.array([[0.01, -0.02, 0.03], [0.0, 0.02, -0.01]])
    found = start._least_change(tree, J, missing)
    size = np.where(tree.coordinates.is_angle, 0.05, 0.01)
    for own, way, wanted in zip(found, J, missing, strict=True):
        np.testing.assert_allclose(way @ own, wanted, atol=1e-5)
        least = minimize(
            lambda d: np.sum((d / size) ** 2),
            np.zeros(len(size)),
            jac=lambda d: 2.0 * d / size**2,
            constraints={
                "type": "eq",
                "fun": lambda d, way=way, wanted=wanted: way @ d - wanted,
                "jac": lambda d, way=way: way,
            },
            method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 300},
        )
        assert least.success
        np.testing.assert_allclose(own, least.x, atol=2e-5)


def test_what_is_missing_gives_way_where_nothing_brings_it(tree):
    """Feet by a ten thousandth of what coordinates do."""
    nq = tree.num_positions
    J = np.zeros((1, 1, nq))
    J[0, 0, 0] = 1e-2  # of a pelvis that moves by centimetres: as stiff
    found = start._least_change(tree, J, np.array([[1.0]]))
    assert found[0, 0] == pytest.approx(0.5 * 100.0)


def test_a_foot_s_jacobian_is_that_of_its_pose(tree):
    q, foot, h = _postures(tree), "toes_right", 1e-6
    found = tree.pose_jacobian(q, foot)
    for k, e in enumerate(np.eye(tree.num_positions)):
        change = tree.poses(q + h * e, foot) - tree.poses(q - h * e, foot)
        np.testing.assert_allclose(
            found[:, :, k], change / (2.0 * h), atol=1e-8
        )


def test_spheres_in_the_foot_s_frame(tree):
    """Those of the foot where they are; toes turned about their hinge."""
    q = _postures(tree)
    foot = tree.poses(q, "foot_left")
    spheres = np.array([[1e6, 1, -0.05, -0.06, 0.03], [1e6, 1, 0.1, 0, 0.02]])
    found = start._in_foot(tree, q, foot, "foot_left", spheres)
    assert found.shape == (len(q), 2, 2)
    places = [[-0.05, -0.06], [0.1, 0.0]]
    np.testing.assert_allclose(
        found, np.tile(places, (len(q), 1, 1)), atol=1e-12
    )
    hinge = start._in_foot(
        tree, q, foot, "toes_left", [[1.0, 1.0, 0.0, 0.0, 0.0]]
    )
    tip = start._in_foot(
        tree, q, foot, "toes_left", [[1.0, 1.0, 0.06, 0.01, 0.0]]
    )
    np.testing.assert_allclose(
        hinge, np.tile(hinge[0], (len(q), 1, 1)), atol=1e-9
    )
    arm = (tip - hinge)[:, 0] @ [1.0, 1j]
    bent = q[:, tree.coordinates.index("toes_left")]
    expected = (0.06 + 0.01j) * np.exp(1j * bent)
    np.testing.assert_allclose(arm, expected, atol=1e-9)


def test_coordinates_follow_their_feet(tree):
    """Both feet in place, and nothing else moves more than it must."""
    q = _postures(tree)
    near = q + 0.02 * _postures(tree, seed=1)
    targets = []
    for foot in ("foot_left", "foot_right"):
        targets.append((foot, tree.poses(near, foot), None))
    found = start._followed(tree, q, targets)
    size = np.where(tree.coordinates.is_angle, 0.05, 0.01)
    for foot, pose, _ in targets:
        now = tree.poses(found, foot)
        np.testing.assert_allclose(now, pose, atol=1e-5)
    # The change has no part that moves no foot: it is from its rows alone.
    J = np.hstack([tree.pose_jacobian(found, foot) for foot, _, _ in targets])
    for own, way in zip((found - q) / size, J * size, strict=True):
        null = own - np.linalg.pinv(way) @ (way @ own)
        np.testing.assert_allclose(null, 0.0, atol=1e-9)
        assert np.abs(own).max() > 1e-3


@pytest.fixture
def problem(tree):
    """A sphere under each segment, as `PhaseProblem` has them."""
    q, _ = _standing(tree)
    hinge = tree.point_positions(q, "toes_left", (0.0, 0.0))[0, 1]
    # As deep in the ground as that of the foot while all stands.
    depth = {"foot": -0.06, "toes": 0.03 - 1e-3 - hinge}
    sphere = ContactSphere(4e6, 1.5, 0.02, -0.06, 0.03)
    contact = GroundContact("simbody", {"heel": sphere}).checked()
    kernel = FootGroundKernel(contact)

    def values(contact, body):
        return np.array([[4e6, 1.5, 0.02, depth[body[:4]], 0.03]])

    def law_inputs(contact, body, q, v):
        pose = tree.states(q, v, body)
        rows = np.tile(values(contact, body)[0], (len(q), 1))
        return np.hstack([pose, np.zeros((len(q), 3)), rows])

    feet = {side: (f"foot_{side}",) for side in ("left", "right")}
    soles = {f"foot_{side}": ["heel"] for side in feet}
    return SimpleNamespace(
        tree=tree,
        feet=feet,
        soles=soles,
        kernels=dict.fromkeys(soles, kernel),
        law_inputs=law_inputs,
        sphere_values=values,
        constants=contact.constants,
    )


def _standing(tree):
    """Upright, soles a millimetre in the ground, sliding slowly."""
    q = np.zeros((3, tree.num_positions))
    foot = tree.states(q, q, "foot_left")[0]
    q[:, 1] -= foot[1] - (0.06 + 0.03 - 1e-3)
    v = np.zeros_like(q)
    v[:, 0] = [0.01, -0.02, 0.03]
    return q, v


def test_the_law_under_a_foot_and_its_slope(tree, problem):
    q, v = _standing(tree)
    wrench, slope = start._law(problem, None, "foot_left", q, v)
    pose = tree.states(q, v, "foot_left")
    x, z, _, vx, vz, _ = pose.T

    def force(vx):
        # Centre of the sphere, of a foot that does not turn.
        inputs = (x + 0.02, z - 0.06, vx, vz, 0.0 * vx)
        at = sphere_wrench(
            "simbody", *inputs, 4e6, 1.5, 0.03, problem.constants
        )
        return at

    at = force(vx)
    np.testing.assert_allclose(wrench[:, 0], at.force_x, rtol=1e-9)
    np.testing.assert_allclose(wrench[:, 1], at.force_z, rtol=1e-9)
    moment = at.point_z * at.force_x - at.point_x * at.force_z
    np.testing.assert_allclose(wrench[:, 2], moment, rtol=1e-9)
    assert wrench[0, 1] > 20.0
    h = 1e-6
    expected = (force(vx + h).force_x - force(vx - h).force_x) / (2.0 * h)
    np.testing.assert_allclose(slope, expected, rtol=1e-5)


def test_a_step_of_the_feet_mends_the_force_forwards(tree, problem):
    """By Newton's step of F_x, at most 3 cm/s; of the left foot alone here."""
    q, v = _standing(tree)
    force = {}
    for side in ("left", "right"):
        wrench, slope = start._law(problem, None, f"foot_{side}", q, v)
        assert (np.abs(slope) > 100.0).any()
        force[side] = wrench[:, 0] + (slope * 1e-3 if side == "left" else 0.0)
    at = SimpleNamespace(
        soles={s: SimpleNamespace(force_x=f) for s, f in force.items()}
    )
    found = start._slip(problem, None, at, q, v)
    assert found.shape == (3, 6)
    np.testing.assert_allclose(found[:, 0], 1e-3, rtol=1e-9)
    np.testing.assert_allclose(found[:, 1:], 0.0, atol=1e-12)
    for s in force:
        at.soles[s].force_x = at.soles[s].force_x - 1e5
    found = start._slip(problem, None, at, q, v)
    np.testing.assert_allclose(np.abs(found[:, [0, 3]]), 0.03)
    # In the air nothing is mended.
    q[:, 1] += 0.1
    np.testing.assert_array_equal(start._slip(problem, None, at, q, v), 0.0)


def test_feet_settled_under_a_body_that_follows(tree, problem):
    """Both feet sink in until they bear, and stay; knees bend above them."""
    q, _ = _standing(tree)
    times = np.linspace(0.0, 1.0, 21)
    q = np.tile(q[0], (len(times), 1))
    names, bend = tree.coordinates, 0.3 * np.sin(6.0 * times)
    for side in problem.feet:
        for joint, share in (("hip", 1.0), ("knee", 2.0), ("ankle", 1.0)):
            q[:, names.index(f"{joint}_{side}")] = share * bend
    measured = tree.poses(q, "foot_left")
    # Measured a few millimetres above where they bear, and at one place.
    q[:, :2] -= measured[:, :2] - measured[:1, :2] - [0.0, 5e-3]
    measured = tree.poses(q, "foot_left")
    load = 300.0 + 20.0 * np.sin(times)
    cop = measured[:, 0] + 0.02
    forward = 0.1 * load
    wrench = np.column_stack([forward, load, -cop * load])
    at = SimpleNamespace(
        q=q,
        v=np.gradient(q, times, axis=0),
        soles={
            side: SimpleNamespace(array=wrench, force_x=forward)
            for side in problem.feet
        },
    )
    movement = SimpleNamespace(grid=SimpleNamespace(times=times))
    found = start.settled(problem, movement, at, None)
    for side in problem.feet:
        ground = found.ground[f"foot_{side}"]
        off = (ground - wrench)[2:-2]
        assert np.abs(off[:, 0]).max() < 1e-9
        assert np.abs(off[:, 1]).max() < 1.0
        pose = tree.states(found.q, found.v, f"foot_{side}")
        assert (pose[:, 1] < measured[:, 1] - 3e-3).all()
        # The grid is coarse: differences of q alone let feet lift and turn.
        assert np.abs(pose[:, 4]).max() < 5e-4
        assert np.abs(pose[:, 5]).max() < 5e-3
    np.testing.assert_allclose(
        np.gradient(found.v, times, axis=0), found.a, atol=1e-9
    )
    rates = np.gradient(found.q, times, axis=0)
    naive = tree.states(found.q, rates, "foot_left")
    assert np.abs(naive[:, 4]).max() > 5e-3
    assert np.abs(found.v - rates)[2:-2].max() < 0.03


def test_toes_that_creep_leave_their_foot_s_force_as_measured(tree, problem):
    """What slides under hinged toes, the foot makes good."""
    q, _ = _standing(tree)
    times = np.linspace(0.0, 0.5, 21)
    q = np.tile(q[0], (len(times), 1))
    bend = 0.02 * np.sin(8.0 * times)
    for side in problem.feet:
        q[:, tree.coordinates.index(f"toes_{side}")] = bend
        problem.feet[side] = (f"foot_{side}", f"toes_{side}")
        problem.soles[f"toes_{side}"] = ["heel"]
        problem.kernels[f"toes_{side}"] = problem.kernels[f"foot_{side}"]
    foot = tree.poses(q, "foot_left")
    load = np.full(len(times), 400.0)
    wrench = np.column_stack([0.0 * load, load, -(foot[:, 0] + 0.08) * load])
    at = SimpleNamespace(
        q=q,
        v=np.gradient(q, times, axis=0),
        soles={
            side: SimpleNamespace(array=wrench, force_x=wrench[:, 0])
            for side in problem.feet
        },
    )
    movement = SimpleNamespace(grid=SimpleNamespace(times=times))
    found = start.settled(problem, movement, at, None)
    for side in problem.feet:
        parts = [found.ground[f"{b}_{side}"] for b in ("foot", "toes")]
        assert min(np.abs(p[:, 1]).max() for p in parts) > 20.0
        assert np.abs(sum(parts)[2:-2, 0]).max() < 1e-9
        assert np.abs(parts[1][2:-2, 0]).max() > 5.0


def test_a_foot_that_touches_with_its_toes_alone_is_settled(tree, problem):
    """As if on tiptoe; the other stands on its whole sole."""
    q, _ = _standing(tree)
    times = np.linspace(0.0, 0.2, 11)
    q = np.tile(q[0], (len(times), 1))
    foot, toes = "foot_right", "toes_right"
    problem.feet["right"] = (toes,)
    problem.soles[toes] = problem.soles.pop(foot)
    problem.kernels[toes] = problem.kernels.pop(foot)
    load = np.full(len(times), 300.0)
    wrench = np.column_stack([0.0 * load, load, -0.1 * load])
    at = SimpleNamespace(
        q=q,
        v=np.zeros_like(q),
        soles={
            side: SimpleNamespace(array=wrench, force_x=wrench[:, 0])
            for side in problem.feet
        },
    )
    movement = SimpleNamespace(grid=SimpleNamespace(times=times))
    found = start.settled(problem, movement, at, None)
    assert list(found.ground) == ["foot_left", toes]
    for ground in found.ground.values():
        np.testing.assert_allclose(ground[:, 1], load, atol=0.06)


def test_one_foot_bears_what_a_chair_does_not(nominal_human):
    """Where no plate was under it, by the equations of motion."""
    model, trial = nominal_human
    tree, names = model.tree, model.coordinates
    contact = nominal_contact(model)
    times = trial.times
    lift = np.zeros_like(trial.q)
    lift[:, names.index("foot_z")] = 120.0
    unknown = PlanarWrench.of(np.zeros((len(times), 3)))
    at = replace(trial, ground=unknown)
    values = np.array(
        [[p.nominal for p in contact.fixed(s)] for s in contact.ground.spheres]
    )
    problem = SimpleNamespace(
        tree=tree,
        soles={tree.root: list(contact.ground.spheres)},
        kernels={tree.root: FootGroundKernel(contact.ground)},
        sphere_values=lambda contact, body: values,
    )
    movement = SimpleNamespace(
        grid=SimpleNamespace(times=times), applied=lambda q: lift
    )
    found = start.settled(problem, movement, at, contact)
    force = found.ground[tree.root][:, 1]
    np.testing.assert_allclose(force, trial.ground.force_z - 120.0)
    root = names.root_columns
    np.testing.assert_allclose(
        found.a[:, root], np.gradient(found.v[:, root], times, axis=0)
    )
    np.testing.assert_array_equal(found.q[:, 3:], trial.q[:, 3:])
    assert np.abs(found.q[:, root] - trial.q[:, root]).max() > 1e-4


@pytest.fixture(scope="module")
def nominal_human():
    model = nominal_model("human")
    return model, draw(model.tree, Rise("rise"))
