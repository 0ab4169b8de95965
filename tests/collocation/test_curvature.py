"""Second derivatives of kernels, each against differences of the Jacobian."""

import numpy as np
import pytest

from drake_exo.collocation.bushing_kernels import (
    BushingKernel,
    CuffKernel,
    DesignDynamicsKernel,
    ForceNormKernel,
    MigrationKernel,
    MovedWeight,
    PressureKernel,
    slipping,
    slipping_bends,
)
from drake_exo.collocation.kernels import DynamicsKernel, PoseKernel
from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.strap import BY_AREA
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human

CUFFS = ("shank", "thigh", "pelvis")


@pytest.fixture(scope="module")
def tree(nominal):
    return nominal("coupled").tree


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def by_differences(jacobian, x, weights):
    """sum_i weights_i d2 f_i/dx2 (n, n_in, n_in)."""
    H = np.zeros((len(x), x.shape[1], x.shape[1]))
    for k in range(x.shape[1]):
        h = 1e-6 * max(1.0, np.abs(x[:, k]).max())
        up, down = x.copy(), x.copy()
        up[:, k] += h
        down[:, k] -= h
        change = (jacobian(up) - jacobian(down)) / (2.0 * h)
        H[:, k] = np.einsum("no,noi->ni", weights, change)
    return H


def check(kernel, x, weights, jacobian=None, data=None, rtol=1e-5):
    """Entry by entry, against the largest of its row; and what is curved."""
    jacobian = jacobian or (lambda x: kernel.jacobian(x, data))
    found = kernel.curvature(x, weights, data)
    expected = by_differences(jacobian, x, weights)
    size = np.abs(expected).max(axis=0)
    scale = np.sqrt(np.outer(size.max(axis=0), size.max(axis=1))) + 1e-12
    off = (np.abs(found - expected) / scale).max(axis=0)
    # Differences of a difference of large numbers are no better.
    noise = 1e-9 * np.abs(expected).max() / scale
    wrong = np.argwhere(off > rtol + noise)
    assert not len(wrong), (wrong[:5], off.max())
    np.testing.assert_allclose(
        found, found.transpose(0, 2, 1), rtol=1e-12, atol=1e-12
    )
    curved = getattr(kernel, "curved_inputs", None)
    if curved is not None:
        assert curved.shape == (x.shape[1],)
        assert not found[:, ~curved].any()
    # The solver leaves no room for pairs that no output depends on.
    together = kernel.sparsity.T.astype(int) @ kernel.sparsity > 0
    assert not found[:, ~together].any()
    assert np.abs(expected).max() > 0.0


def test_poses(rng):
    model = Model(Assembly(Person("two", "hinged")), scale_human(70.0, 1.75))
    tree = model.tree
    for body in ("foot_left", "toes_right"):
        kernel = PoseKernel(tree, body)
        x = rng.uniform(-1.0, 1.0, (4, 2 * tree.num_positions + 6))
        check(kernel, x, rng.standard_normal((4, 6)))


@pytest.mark.parametrize("slip", [5e-4, 2e-3, 8e-3])
def test_springs_of_cuffs(tree, rng, slip):
    """Without dampers nothing is left out; held, or slipping."""
    moving = [(int(tree.segment_of[tree.body_index("exo_shank")]), 1j)]
    for segment in CUFFS:
        bushing = BushingKinematics(tree, segment, (0.01, -0.02, 0.03), moving)
        kernel = BushingKernel(bushing, (0.0, 0.0, 0.0))
        n_in = kernel.sparsity.shape[1]
        x = 0.3 * rng.uniform(-1.0, 1.0, (6, n_in))
        x[:, -4:] = [900.0, 3000.0, 40.0, slip]
        check(kernel, x, rng.standard_normal((6, 3)), rtol=1e-4)


def test_slipping_by_complex_steps():
    """Slopes and bends of a held force F (1 + (slip F)^4)^(-1/4)."""
    force = np.array([-300.0, -40.0, 5.0, 90.0, 250.0])
    slip = np.full(5, 0.01)

    def held(force, slip):
        return force * (1.0 + (slip * force) ** 4) ** -0.25

    h = 1e-30
    by_force, by_slip = slipping(force, slip)
    np.testing.assert_allclose(by_force, held(force + h * 1j, slip).imag / h)
    np.testing.assert_allclose(by_slip, held(force, slip + h * 1j).imag / h)

    def slope_by_force(force, slip):
        return (1.0 + (slip * force) ** 4) ** -1.25

    def slope_by_slip(force, slip):
        x = slip * force
        return -(force**2) * x**3 * (1.0 + x**4) ** -1.25

    both, slips = slipping_bends(force, slip)
    np.testing.assert_allclose(
        slip * both, slope_by_force(force + h * 1j, slip).imag / h
    )
    np.testing.assert_allclose(
        force * both, slope_by_force(force, slip + h * 1j).imag / h
    )
    np.testing.assert_allclose(
        slips, slope_by_slip(force, slip + h * 1j).imag / h
    )


def test_dynamics_of_a_design(tree, rng):
    """All but what bodies' inertia adds; weights of links that move, too."""
    segments = [
        int(tree.segment_of[tree.body_index(f"exo_{s}")])
        for s in ("shank", "thigh")
    ]
    bushings = [
        BushingKinematics(
            tree, s, (0.0, 0.0, 0.02), [(segments[0], 1.0), (segments[1], 1j)]
        )
        for s in CUFFS
    ]
    moved = [
        MovedWeight(1, 2, segments[0], 12.0),
        MovedWeight(2, 3, segments[1], 7.0j),
    ]
    kernel = DesignDynamicsKernel(tree, bushings, None, moved)
    n_in = kernel.sparsity.shape[1]
    x = rng.uniform(-0.5, 0.5, (3, n_in))
    own = DynamicsKernel(tree)
    first = own.sparsity.shape[1]
    x[:, first : first + 9] *= 50.0

    def jacobian(x):
        J = kernel.jacobian(x, None)
        J[:, :, :first] -= own.jacobian(x[:, :first], None)
        return J

    check(kernel, x, rng.standard_normal((3, 9)), jacobian)
    # First derivatives, too, and where there are none.
    for k in range(n_in):
        step = np.zeros(n_in)
        step[k] = 1e-6
        change = kernel.evaluate(x + step, None)
        change = (change - kernel.evaluate(x - step, None)) / 2e-6
        np.testing.assert_allclose(
            kernel.jacobian(x, None)[:, :, k], change, atol=1e-6
        )
        assert not np.abs(change[:, ~kernel.sparsity[:, k]]).max(initial=0.0)


@pytest.mark.parametrize("order", [4.0, 8.0])
def test_norm_of_forces(rng, order):
    kernel = ForceNormKernel(order, 30.0, 0.25)
    x = np.column_stack(
        [
            rng.uniform(-60.0, 60.0, (6, 2)),
            rng.uniform(0.5, 2.0, 6),
        ]
    )
    data = rng.uniform(0.5, 1.0, (6, 1))
    check(kernel, x, rng.standard_normal((6, 1)), data=data)


@pytest.mark.parametrize(
    "name", ["CuffKernel", "MigrationKernel", "PressureKernel"]
)
def test_kernels_of_a_design(tree, rng, name):
    data = None
    if name == "CuffKernel":
        kernel = CuffKernel(BY_AREA)
        x = rng.uniform(0.1, 0.9, (4, kernel.sparsity.shape[1]))
        data = rng.uniform(1e-3, 0.5, (4, 5))
    elif name == "PressureKernel":
        kernel = PressureKernel(0.012)
        x = rng.uniform(0.5, 2.0, (4, 3)) * [50.0, 1.0, 5.0]
    else:
        kernel = MigrationKernel(BushingKinematics(tree, "thigh"))
        x = rng.uniform(-0.5, 0.5, (4, kernel.sparsity.shape[1]))
    if not hasattr(kernel, "curvature"):
        pytest.skip("has no second derivatives of its own")
    weights = rng.standard_normal((4, kernel.sparsity.shape[0]))
    check(kernel, x, weights, data=data)
