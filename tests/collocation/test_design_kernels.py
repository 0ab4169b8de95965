"""What a design adds to a program: values by hand, derivatives."""

import numpy as np
import pytest
from kernel_derivatives import check_curvature, check_jacobian

from drake_exo.collocation.bushing_kernels import (
    AssistanceKernel,
    CuffKernel,
    ForceNormKernel,
    MigrationKernel,
    ProductKernel,
)
from drake_exo.contact.bushing import BushingKinematics

N = 6


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def _felt(rng, n):
    """Two forces and an area."""
    return np.c_[rng.uniform(-40.0, 40.0, (n, 2)), rng.uniform(0.7, 1.5, n)]


def cases(rng, tree):
    """Name -> kernel, inputs and data."""
    bushing = BushingKinematics(tree, "thigh", moving=[(1, 0.6 - 0.8j)])
    cuff = np.array([0.02, 0.25, 3000.0, 5000.0, 60.0])
    own = np.array([0.0, 0.24, 1 / 4e3, 1 / 6e3, 1 / 70.0])
    strap = np.array([0.02, 0.01, 8e-5, 3e-5, 2e-3, 1.2, 0.3, 0.8])
    share = rng.uniform(0.9, 1.1, (N, 13))
    return {
        "cuff": (
            CuffKernel((1, 1, 2)),
            share * np.r_[cuff, strap],
            share[:, :5] * own,
        ),
        "assistance": (
            AssistanceKernel(2, 3),
            rng.uniform(-1.0, 1.0, (N, 6)),
            rng.uniform(-20.0, 20.0, (N, 11)),
        ),
        "peak": (
            ForceNormKernel(8.0, 25.0, 0.25),
            _felt(rng, N),
            rng.uniform(0.1, 1.0, (N, 1)),
        ),
        "mean": (
            ForceNormKernel(2.0, 25.0, 0.25),
            _felt(rng, N),
            rng.uniform(0.1, 1.0, (N, 1)),
        ),
        "migration": (
            MigrationKernel(bushing),
            rng.uniform(-0.5, 0.5, (N, bushing.nq + 4)),
            None,
        ),
        "pressure": (ProductKernel(20.0, 10.0), _felt(rng, N), None),
        "power": (
            ProductKernel(1.0, 10.0),
            rng.uniform(-3.0, 3.0, (N, 3)),
            rng.uniform(-1.0, 1.0, (N, 1)),
        ),
    }


CURVED = ["cuff", "peak", "mean", "migration", "pressure", "power"]
NAMES = [*CURVED, "assistance"]


@pytest.mark.parametrize("name", NAMES)
def test_derivatives(name, rng, nominal):
    kernel, x, data = cases(rng, nominal("coupled").tree)[name]
    check_jacobian(kernel, x, data)


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_derivative_is_caught(name, rng, nominal, monkeypatch):
    kernel, x, data = cases(rng, nominal("coupled").tree)[name]
    right = kernel.jacobian

    def wrong(x, data):
        J = right(x, data).copy()
        row, column = np.argwhere(kernel.sparsity)[-1]
        J[:, row, column] *= 1.001
        return J

    monkeypatch.setattr(kernel, "jacobian", wrong)
    with pytest.raises(AssertionError, match="input"):
        check_jacobian(kernel, x, data)


@pytest.mark.parametrize("name", CURVED)
def test_curvature(name, rng, nominal, monkeypatch):
    kernel, x, data = cases(rng, nominal("coupled").tree)[name]
    weights = rng.uniform(-1.0, 1.0, (N, len(kernel.sparsity)))
    check_curvature(kernel, x, weights, data=data)
    right = kernel.curvature

    def wrong(x, weights, data):
        H = right(x, weights, data).copy()
        row, column = np.argwhere(np.abs(H) == np.abs(H).max())[0, 1:]
        H[:, row, column] = H[:, column, row] = 1.001 * H[:, row, column]
        return H

    monkeypatch.setattr(kernel, "curvature", wrong)
    with pytest.raises(AssertionError, match="array"):
        check_curvature(kernel, x, weights, data=data)


def test_a_cuff_in_series_satisfies_its_kernel():
    own, strap = np.array([4000.0, 6000.0, 70.0]), np.array([2e3, 9e3, 30.0])
    tissue = own * [1.5, 1.5, 1.5**2]
    together = 1.0 / (1.0 / tissue + 1.0 / strap)
    together *= [0.4, 1.0, 0.0]  # a slide that is held a little, a hinge
    released = [0.6, 1.0]
    x = np.r_[0.03, 0.29, together, 0.03, 0.04, 1.0 / strap, 1.5, released]
    x = x[None]
    data = np.r_[0.0, 0.25, 1.0 / own][None]
    excess = CuffKernel((1, 1, 2)).evaluate(x, data)
    np.testing.assert_allclose(excess, 0.0, atol=1e-12)


def test_squares_sum_to_the_norm(rng):
    """Half of their sum is half the norm over its scale to its order."""
    order, scale, shear = 8.0, 30.0, 0.25
    force = rng.uniform(-50.0, 50.0, (40, 2))
    weights = rng.uniform(0.1, 1.0, 40)
    weights /= weights.sum()
    kernel = ForceNormKernel(order, scale, shear)
    area = 1.3
    felt = np.c_[area * force, np.full(40, area)]
    r = kernel.evaluate(felt, np.sqrt(weights)[:, None])
    size = np.hypot(force[:, 1], np.sqrt(shear) * force[:, 0])
    norm = (weights @ size**order) ** (1.0 / order)
    assert np.sum(r * r) == pytest.approx((norm / scale) ** order, rel=1e-4)


def test_pressure_is_force_over_area():
    """30 N on 1.5 times 200 cm^2: 1 kPa."""
    x = np.array([[30.0, 1.5, 1.0]])
    assert ProductKernel(20.0, 10.0).evaluate(x, None) == pytest.approx(0.0)


def test_power_is_the_drive_s_torque_times_speed():
    """8 N m at 2 rad/s, of which 3 N m are friction; 1 W more is 0.1."""
    x, friction = np.array([[11.0, 8.0, 2.0]]), np.array([[3.0]])
    off = ProductKernel(1.0, 10.0).evaluate(x, friction)
    np.testing.assert_allclose(off, [[0.1]], rtol=1e-14)
