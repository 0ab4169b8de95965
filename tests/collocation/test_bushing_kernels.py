"""Cuffs' energy and wrench, and controllers, against independent formulas.

Derivatives and the bushing's force: test_kernels.py.
"""

import numpy as np
import pytest

from drake_exo.collocation.bushing_kernels import (
    BushingKernel,
    DesignDynamicsKernel,
    EnergyKernel,
    MovedWeight,
)
from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    ControllerKernel,
    DynamicsKernel,
)
from drake_exo.contact.bushing import (
    BushingKinematics,
    bushing_deflection,
    bushing_energy,
    bushing_wrench,
)
from drake_exo.contact.systems import AssistController, TrackingController
from drake_exo.errors import InputError

N = 7
CUFFS = ("shank", "thigh", "pelvis")
STIFFNESS = np.array([1800.0, 5200.0, 55.0])
SLIP = 0.01
PRELOAD = (0.01, -0.02, 0.05)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def motion(rng):
    return rng.uniform(-0.7, 0.7, (N, 9)), rng.uniform(-2.0, 2.0, (N, 9))


def origins(rng):
    return rng.uniform(-0.1, 0.3, (N, 2))


def link(tree, q, v, name):
    """Pose and motion of a link, rates by differences along the motion."""

    def pose(q):
        p = tree.point_positions(q, name, (0.0, 0.0))
        return np.vstack([p.T, tree.body_angles(q, name)])

    h = 1e-6
    return pose(q), (pose(q + h * v) - pose(q - h * v)) / (2.0 * h)


def law(tree, segment, q, v, origin, preload=PRELOAD):
    human, device = (link(tree, q, v, s + segment) for s in ("", "exo_"))
    return (
        *bushing_deflection(*human, *device, origin.T, preload),
        human[0],
        device[0],
    )


@pytest.mark.parametrize("segment", CUFFS)
def test_energy_is_the_laws(tree, rng, segment):
    q, v = motion(rng)
    origin = origins(rng)
    bushing = BushingKinematics(tree, segment, PRELOAD)
    kernel = EnergyKernel(bushing, [0, 1, 2], 2.0)
    stiffness = np.tile([*STIFFNESS, SLIP], (N, 1))
    weight = rng.uniform(1.0, 2.0, (N, 1))
    found = kernel.evaluate(np.hstack([q, origin, stiffness]), weight)
    deflection, *_ = law(tree, segment, q, v, origin)
    expected = bushing_energy(deflection, STIFFNESS, SLIP)
    np.testing.assert_allclose(
        2.0 * found, weight * np.column_stack(expected), rtol=1e-9
    )
    one = EnergyKernel(bushing, [1], 2.0)
    np.testing.assert_allclose(
        one.evaluate(np.hstack([q, origin, stiffness]), weight), found[:, 1:2]
    )


def test_dynamics_feel_the_wrench_of_the_law(tree, rng):
    """Virtual work of the world wrench at F2's origin on both links."""
    q, v = motion(rng)
    rest = np.hstack([rng.uniform(-9, 9, (N, 9)), rng.uniform(-99, 99, (N, 9))])
    forces = rng.uniform(-50.0, 50.0, (N, 9))
    places = np.hstack([origins(rng) for _ in CUFFS])
    kernel = DynamicsKernel(
        tree, bushings=[BushingKinematics(tree, s) for s in CUFFS]
    )
    plain = np.hstack([q, v, rest])
    found = kernel.evaluate(np.hstack([plain, forces, places]), None)
    found = found - DynamicsKernel(tree).evaluate(plain, None)
    expected = np.zeros((N, 9))
    for b, segment in enumerate(CUFFS):
        origin = places[:, 2 * b : 2 * b + 2]
        human, device = (link(tree, q, v, s + segment)[0] for s in ("", "exo_"))
        w = bushing_wrench(
            forces[:, 3 * b : 3 * b + 3].T, human, device, origin.T
        )
        for sign, name, pose in (
            (1, segment, human),
            (-1, "exo_" + segment, device),
        ):
            for i in range(N):
                d = np.array([w.point_x[i], w.point_z[i]]) - pose[:2, i]
                c, s = np.cos(pose[2, i]), np.sin(pose[2, i])
                local = (c * d[0] + s * d[1], -s * d[0] + c * d[1])
                J = tree.point_jacobian(q[i : i + 1], name, local)[0]
                turn = np.zeros(9)
                segment_index = tree.segment_of[tree.body_index(name)]
                turn[2:] = tree.angle_map[segment_index]
                force = np.array([w.force_x[i], w.force_z[i]])
                expected[i] += sign * (force @ J + w.moment[i] * turn)
    np.testing.assert_allclose(
        -FORCE_UNIT * found, expected, rtol=1e-9, atol=1e-9
    )


def test_controller_and_its_derivatives(rng):
    controller = AssistController(knee_nm=12.0, hip_nm=7.0, damping=0.3)
    kernel = ControllerKernel(controller, 3)
    x, times = rng.uniform(-1.0, 1.0, (N, 9)), np.linspace(0, 1, N)[:, None]
    found = 100.0 * kernel.evaluate(x, times) + x[:, 6:]
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(
        found[:, 1], -12.0 * np.sin(x[:, 1]) - 0.3 * x[:, 4]
    )
    J = kernel.jacobian(x, times)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        change = kernel.evaluate(x + step, times)
        change = (change - kernel.evaluate(x - step, times)) / 2e-6
        np.testing.assert_allclose(J[:, :, k], change, atol=1e-8)
    # Differenced twice, it would take most of a solve.
    assert not kernel.curved_inputs.any()


def test_unfit_controllers_are_refused():
    stateful = TrackingController(
        np.arange(4.0), *np.zeros((3, 4, 9)), np.zeros((4, 6))
    )
    with pytest.raises(InputError, match="exoskeleton_state"):
        ControllerKernel(stateful, 3)


def moving(tree, cuff):
    """The device's frame moved in its own axes, and with a knee's place."""
    own, below = (
        tree.segment_of[tree.body_index(b)]
        for b in (tree.cuffs[cuff][1], "exo_shank")
    )
    return [(own, 1.0), (own, 1j), (below, 1j)]


def test_a_moved_frame_is_a_preload(tree, rng):
    """Places beyond the origin against the preload that they stand for."""
    q, v = motion(rng)
    origin = origins(rng)[0]
    free = BushingKinematics(tree, "thigh", moving=moving(tree, "thigh"))
    places = np.broadcast_to(np.r_[origin, PRELOAD[:2], 0.0], (N, 5))
    d = free.deflection(q, free.terms(q, places))
    (expected, *_) = law(
        tree, "thigh", q, v, np.tile(origin, (N, 1)), (*PRELOAD[:2], 0.0)
    )
    np.testing.assert_allclose(d.T, expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["law", "dynamics"])
def test_derivatives_by_places(tree, rng, kind):
    b = BushingKinematics(tree, "thigh", PRELOAD, moving(tree, "thigh"))
    if kind == "law":
        kernel = BushingKernel(b, np.array([40.0, 90.0, 2.0]))
    else:
        shank = tree.segment_of[tree.body_index("exo_shank")]
        kernel = DesignDynamicsKernel(
            tree, bushings=[b], moved=[MovedWeight(0, 4, shank, 70.0j)]
        )
    x = rng.uniform(-0.5, 0.5, (N, kernel.sparsity.shape[1]))
    weights = rng.uniform(-1.0, 1.0, (N, len(kernel.sparsity)))
    H = kernel.curvature(x, weights, None)
    J = kernel.jacobian(x, None)

    def bent(x):
        return np.einsum("no,noi->ni", weights, kernel.jacobian(x, None))

    curved = kernel.curved_inputs
    for k in range(x.shape[1]):
        h = np.zeros_like(x)
        h[:, k] = 1e-6
        change = kernel.evaluate(x + h, None) - kernel.evaluate(x - h, None)
        np.testing.assert_allclose(
            J[:, :, k], change / 2e-6, rtol=1e-6, atol=1e-7
        )
        assert not J[:, ~kernel.sparsity[:, k], k].any()
        if not curved[k]:
            assert not H[:, k].any()
            continue
        expected = (bent(x + h) - bent(x - h))[:, curved] / 2e-6
        np.testing.assert_allclose(H[:, k][:, curved], expected, atol=1e-6)
