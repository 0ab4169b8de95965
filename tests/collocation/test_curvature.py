"""Second derivatives of kernels, each against differences of the Jacobian."""

import numpy as np
import pytest
from kernel_derivatives import check_curvature, check_jacobian

from drake_exo.collocation.bushing_kernels import (
    BushingKernel,
    DesignDynamicsKernel,
    EnergyKernel,
    MovedWeight,
    slipping,
    slipping_bends,
)
from drake_exo.collocation.kernels import AppliedWrench, DynamicsKernel
from drake_exo.contact.bushing import BushingKinematics

CUFFS = ("shank", "thigh", "pelvis")


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.mark.parametrize("slip", [5e-4, 2e-3, 8e-3])
def test_cuffs(tree, rng, slip):
    """Held, or slipping."""
    moving = [(int(tree.segment_of[tree.body_index("exo_shank")]), 1j)]
    for segment in CUFFS:
        bushing = BushingKinematics(tree, segment, (0.01, -0.02, 0.03), moving)
        kernel = BushingKernel(bushing, (40.0, 90.0, 2.0))
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


@pytest.mark.slow
def test_dynamics(tree, rng):
    """In a device, with loads, standing on a link far from the root."""
    bushings = [
        BushingKinematics(
            tree, s, (0.01, 0.0, 0.02), [(int(tree.segment_of[1]), 1j)]
        )
        for s in CUFFS
    ]
    times = np.linspace(0.0, 1.0, 6)
    wrench = 50.0 * rng.standard_normal((6, 3))
    load = AppliedWrench(tree, times, [({"thigh": 0.3, "pelvis": 0.7}, wrench)])
    bodies = (tree.root, "shank")
    kernel = DynamicsKernel(tree, bodies, bushings, load)
    n_in = kernel.sparsity.shape[1]
    x = rng.uniform(-1.0, 1.0, (6, n_in))
    x[:, 27:-9] *= 50.0
    weights = rng.standard_normal((6, 9))
    check_curvature(kernel, x, weights, data=wrench)
    # The check sees a wrong derivative.
    right = kernel.curvature(x, weights, wrench)
    for row, column in ((3, 3), (4, 12), (4, 13), (4, 18), (0, 37), (3, 39)):
        wrong = right.copy()
        wrong[:, [row, column], [column, row]] *= 1.01
        kernel.curvature = lambda *_, wrong=wrong: wrong
        with pytest.raises(AssertionError):
            check_curvature(kernel, x, weights, data=wrench)


@pytest.mark.slow
def test_dynamics_of_a_design(tree, rng):
    """With weights of links that move."""
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
    x[:, 33:42] *= 50.0
    check_curvature(kernel, x, rng.standard_normal((3, 9)))
    check_jacobian(kernel, x)


@pytest.mark.parametrize("slip", [5e-4, 2e-3, 8e-3])
def test_energy_of_cuffs(tree, rng, slip):
    bushing = BushingKinematics(tree, "thigh", (0.01, -0.02, 0.03))
    kernel = EnergyKernel(bushing, [0, 1, 2], 2.0)
    x = 0.3 * rng.uniform(-1.0, 1.0, (6, kernel.sparsity.shape[1]))
    x[:, -4:] = [900.0, 3000.0, 40.0, slip]
    share = rng.uniform(0.5, 1.0, (6, 1))
    weights = rng.standard_normal((6, 3))
    check_curvature(kernel, x, weights, data=share, rtol=1e-4)
    some = EnergyKernel(bushing, [2, 0], 2.0)
    check_curvature(some, x, weights[:, 1:], data=share, rtol=1e-4)
