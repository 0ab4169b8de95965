"""Second derivatives of kernels, each against differences of the Jacobian."""

import numpy as np
import pytest
from kernel_derivatives import check_curvature, check_jacobian

from drake_exo.collocation.bushing_kernels import (
    BushingKernel,
    DesignDynamicsKernel,
    MovedWeight,
    slipping,
    slipping_bends,
)
from drake_exo.collocation.kernels import DynamicsKernel
from drake_exo.contact.bushing import BushingKinematics

CUFFS = ("shank", "thigh", "pelvis")


@pytest.fixture
def rng():
    return np.random.default_rng(11)


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
        check_curvature(kernel, x, rng.standard_normal((6, 3)), rtol=1e-4)


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
    kernel = DesignDynamicsKernel(tree, None, bushings, None, moved)
    n_in = kernel.sparsity.shape[1]
    x = rng.uniform(-0.5, 0.5, (3, n_in))
    own = DynamicsKernel(tree)
    first = own.sparsity.shape[1]
    x[:, first : first + 9] *= 50.0

    def jacobian(x):
        J = kernel.jacobian(x, None)
        J[:, :, :first] -= own.jacobian(x[:, :first], None)
        return J

    check_curvature(kernel, x, rng.standard_normal((3, 9)), jacobian)
    check_jacobian(kernel, x)
