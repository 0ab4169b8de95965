"""Equations of motion and contact, and their derivatives."""

import numpy as np
import pytest
from kernel_derivatives import check_jacobian, differences
from pydrake.multibody.tree import MultibodyForces

from drake_exo.collocation.bushing_kernels import (
    BushingKernel,
    EnergyKernel,
)
from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    DynamicsKernel,
    FootGroundKernel,
    SoleKernel,
    _motion_curvature,
)
from drake_exo.contact.bushing import (
    BushingKinematics,
    bushing_deflection,
    bushing_force,
)
from drake_exo.contact.hunt_crossley import sphere_wrench_derivatives
from drake_exo.contact.parameters import nominal_contact

CUFFS = ("shank", "thigh", "pelvis")


@pytest.fixture
def contact_kernel(nominal):
    """Function of the law."""
    model = nominal("coupled")
    return lambda law: FootGroundKernel(nominal_contact(model, law).ground)


def _check_tight(kernel, x, first):
    """From an input on, the pattern holds nothing that is always zero."""
    J = kernel.jacobian(x, None)[:, :, first:]
    found = (np.abs(J) > 1e-12).any(axis=0)
    np.testing.assert_array_equal(found, kernel.sparsity[:, first:])


def _states(n, width, seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n, width))


def _contact_inputs(law, n=40):
    x = np.zeros((n, 19))
    x[:, :9] = 0.03 * _states(n, 9)
    x[:, 1] += 0.065
    x[:, 6:9] *= 1e3
    stiffness = 1.5e4 if law == "paper" else 5e6
    x[:, 9:14] = [stiffness, 1.0, -0.05, -0.05, 0.03]
    x[:, 14:] = [1.3 * stiffness, 1.4, 0.15, -0.05, 0.035]
    return x


def test_dynamics_derivatives(tree):
    x = _states(5, 36)
    x[:, 27:] *= 100.0
    check_jacobian(DynamicsKernel(tree), x)
    _check_tight(DynamicsKernel(tree), x, 27)


def test_dynamics_equal_drakes_with_a_wrench_on_the_foot(plant, tree):
    from pydrake.multibody.math import SpatialForce

    x = _states(4, 36, seed=2)
    x[:, 27:] *= 100.0
    found = FORCE_UNIT * DynamicsKernel(tree).evaluate(x, None)
    context = plant.CreateDefaultContext()
    foot = plant.GetBodyByName("foot")
    for row, residual in zip(x, found, strict=True):
        q, v, a, torque, ground = np.split(row, [9, 18, 27, 33])
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        p_WF = plant.EvalBodyPoseInWorld(context, foot).translation()
        # Moment about the foot's origin from that about the laboratory's.
        moment = ground[2] - (p_WF[2] * ground[0] - p_WF[0] * ground[1])
        foot.AddInForceInWorld(
            context,
            SpatialForce([0, moment, 0], [ground[0], 0, ground[1]]),
            forces,
        )
        expected = plant.CalcInverseDynamics(context, a, forces)
        expected[3:] -= torque
        np.testing.assert_allclose(residual, expected, atol=1e-9)


@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_contact_derivatives(contact_kernel, law):
    check_jacobian(contact_kernel(law), _contact_inputs(law))


@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_contact_curvature_equals_differences_of_the_jacobian(
    contact_kernel, law
):
    kernel = contact_kernel(law)
    x = _contact_inputs(law)
    weights = _states(len(x), 3, seed=5)
    found = kernel.curvature(x, weights, None)
    # Typical sizes make entries comparable; the radius is left out.
    size = np.r_[np.full(6, 0.01), np.ones(3), x[0, 9:]]
    keep = np.delete(np.arange(19), [13, 18])
    H = differences(
        lambda x: np.einsum("no,noi->ni", weights, kernel.jacobian(x, None)), x
    )
    difference = (found - H) * np.abs(np.outer(size, size))
    largest = np.abs(H * np.outer(size, size)).max()
    picked = difference[:, keep][:, :, keep]
    assert np.abs(picked).max() < 2e-6 * largest


def test_what_a_foot_misses_is_told_about_it_however_far_it_has_come(
    contact_kernel,
):
    """A newton too much at the same place under the foot, from anywhere."""
    kernel = contact_kernel("simbody")
    x = _contact_inputs("simbody")
    F_x, F_z, own = missing = 30.0 * _states(3, len(x))
    for far in (0.0, 40.0):
        at = x.copy()
        at[:, 0] += far
        # M_y of a force at p is z F_x - x F_z.
        moment = own + at[:, 1] * F_x - at[:, 0] * F_z
        given = np.column_stack([F_x, F_z, moment])
        at[:, 6:9] = kernel.wrench(at) - given
        found = kernel.evaluate(at, None) * [100.0, 100.0, 10.0]
        np.testing.assert_allclose(found, missing.T, atol=1e-9)


def test_a_wrench_is_about_the_laboratorys_origin(contact_kernel):
    """Farther off by d, the moment is less by d F_z."""
    kernel = contact_kernel("simbody")
    x = _contact_inputs("simbody")
    moved = x + np.eye(1, x.shape[1])
    near, far = kernel.wrench(x), kernel.wrench(moved)
    near[:, 2] -= near[:, 1]
    assert np.abs(near[:, 1]).max() > 100.0
    np.testing.assert_allclose(far, near, rtol=1e-9, atol=1e-9)


def test_curvature_of_a_spheres_motion_is_exact(contact_kernel):
    """Entry by entry, each against its own size, by a complex step."""
    kernel = contact_kernel("simbody")
    rng = np.random.default_rng(9)
    x = rng.normal(size=(3, 19))
    weights = rng.normal(size=(3, 5))
    p, _, _ = kernel._sphere(x, 0)
    found = _motion_curvature(x, p, weights)
    columns = [*range(6), 11, 12]  # q, v, and where the first sphere sits

    def gradient(x):
        d = kernel._sphere(x, 0)[2]
        return np.einsum("no,nok->nk", weights, d)

    h = 1e-5
    for k, column in enumerate(columns):
        up, down = x.copy(), x.copy()
        up[:, column] += h
        down[:, column] -= h
        expected = (gradient(up) - gradient(down)) / (2.0 * h)
        np.testing.assert_allclose(
            found[:, k, : len(columns)], expected, atol=1e-8
        )


def test_a_wrong_contact_derivative_is_caught(monkeypatch, contact_kernel):
    def wrong(*args):
        wrench, d = sphere_wrench_derivatives(*args)
        d[1, 3] *= 1.0 + 1e-4
        return wrench, d

    monkeypatch.setattr(
        "drake_exo.collocation.kernels.sphere_wrench_derivatives", wrong
    )
    with pytest.raises(AssertionError, match="input"):
        check_jacobian(contact_kernel("simbody"), _contact_inputs("simbody"))


def test_coupled_dynamics_derivatives(tree):
    preload = (0.01, 0.02, 0.03)
    bushings = [BushingKinematics(tree, s, preload) for s in CUFFS]
    x = _states(5, 51)
    x[:, 27:45] *= 50.0
    check_jacobian(DynamicsKernel(tree, bushings=bushings), x)


@pytest.mark.parametrize("segment", CUFFS)
def test_bushing_and_energy_derivatives(tree, segment):
    bushing = BushingKinematics(tree, segment, (0.01, -0.02, 0.03))
    x = 0.5 * _states(20, 27)
    x[:, 18:21] *= 100.0
    # Held in the first half, slipping in the second.
    x[:, 23:] = [2000.0, 5000.0, 50.0, 0.0]
    x[10:, -1] = 0.002
    kernel = BushingKernel(bushing, (10.0, 10.0, 0.1))
    check_jacobian(kernel, x)
    _check_tight(kernel, x, 18)
    # Not curved by the force itself.
    np.testing.assert_array_equal(
        kernel.curved_inputs[18:], [False] * 3 + [True] * 6
    )
    columns = [*range(9), *range(21, 27)]
    weight = np.linspace(0.5, 2.0, len(x))[:, None]
    check_jacobian(EnergyKernel(bushing, [0, 2], 1.0), x[:, columns], weight)


@pytest.mark.parametrize("segment", CUFFS)
def test_bushing_kernel_equals_the_law(plant, tree, segment):
    """Through the plant's own kinematics and forces.bushing."""
    preload, origin = (0.01, -0.02, 0.03), np.array([0.02, 0.2])
    stiffness, damping = (1500.0, 4000.0, 30.0), (10.0, 12.0, 0.2)
    slip = 0.005
    kernel = BushingKernel(BushingKinematics(tree, segment, preload), damping)
    x = np.zeros((6, 27))
    x[:, :18] = 0.6 * _states(6, 18, seed=4)
    x[:, 21:23], x[:, 23:] = origin, (*stiffness, slip)
    found = kernel.evaluate(x, None) * [10.0, 10.0, 1.0]
    context = plant.CreateDefaultContext()
    for row, force in zip(x, found, strict=True):
        plant.SetPositions(context, row[:9])
        plant.SetVelocities(context, row[9:18])
        states = []
        for name in (segment, f"exo_{segment}"):
            body = plant.GetBodyByName(name)
            X_WB = plant.EvalBodyPoseInWorld(context, body)
            V_WB = plant.EvalBodySpatialVelocityInWorld(context, body)
            axis = X_WB.rotation().matrix()[:, 0]
            p, v = X_WB.translation(), V_WB.translational()
            states.append((p[0], p[2], np.arctan2(axis[2], axis[0])))
            states.append((v[0], v[2], -V_WB.rotational()[1]))
        d, rate = bushing_deflection(*states, origin, preload)
        expected = bushing_force(d, rate, stiffness, damping, slip)
        np.testing.assert_allclose(force, np.array(expected), atol=1e-8)


def test_soles_clear_the_ground():
    """Height of each sphere's lowest point, and its derivatives."""
    spheres = np.array(
        [[1e6, 1.0, -0.05, -0.04, 0.03], [1e6, 1, 0.15, 0, 0.02]]
    )
    kernel = SoleKernel(spheres)
    flat = np.array([[0.4, 0.07, 0.0, 1.0, 2.0, 3.0]])
    found = kernel.evaluate(flat, None)
    np.testing.assert_allclose(found, [[0.0, 0.05]], atol=1e-12)
    upright = flat.copy()
    upright[0, 2] = np.pi / 2  # toes up: places ahead are above
    found = kernel.evaluate(upright, None)
    np.testing.assert_allclose(found, [[-0.01, 0.2]], atol=1e-12)
    check_jacobian(kernel, _states(20, 6))
