import numpy as np
import pytest

from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    AppliedWrench,
    DynamicsKernel,
)
from drake_exo.measurement.sagittal import PlanarWrench

TIMES = np.linspace(0.0, 1.0, 12)


@pytest.fixture(scope="module", params=["human", "coupled"])
def tree(request, nominal):
    return nominal(request.param).tree


@pytest.fixture
def load(tree):
    rng = np.random.default_rng(3)
    wrench = rng.normal(size=(len(TIMES), 3)) * [50.0, 400.0, 150.0]
    carried = rng.normal(size=(len(TIMES), 3)) * [20.0, 100.0, 40.0]
    shares = {"pelvis": 0.7, "thigh": 0.3}
    parts = [(shares, wrench), ({"shank": 1.0}, carried)]
    return AppliedWrench(tree, TIMES, parts)


def positions(tree, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (len(TIMES), tree.num_positions))


def test_is_what_inverse_dynamics_takes_a_wrench_for(tree, load):
    q, w = positions(tree), load.at(TIMES)
    expected = 0.0
    for body, share in (("pelvis", 0.7), ("thigh", 0.3)):
        part = PlanarWrench(share * w[:, :2], share * w[:, 2])
        expected = expected + tree.wrench_on_body(q, body, part.array)
    carried = PlanarWrench(w[:, 3:5], w[:, 5])
    expected = expected + tree.wrench_on_body(q, "shank", carried.array)
    np.testing.assert_allclose(load.generalized(q, w), expected, atol=1e-9)


def complex_step(kernel, x, data):
    h = 1e-30
    J = np.empty((len(x), kernel.sparsity.shape[0], x.shape[1]))
    for i in range(x.shape[1]):
        step = x.astype(complex)
        step[:, i] += 1j * h
        J[:, :, i] = kernel.evaluate(step, data).imag / h
    return J


class OnlyLoad:
    """The load without equations of motion, whose step is complex."""

    def __init__(self, tree, load):
        self.load = load
        self.sparsity = np.ones((tree.num_positions,) * 2, bool)

    def evaluate(self, x, data):
        return self.load.generalized(x, data)


def test_derivatives_are_those_of_the_complex_step(tree, load):
    q, w = positions(tree, 1), load.at(TIMES)
    expected = complex_step(OnlyLoad(tree, load), q, w)
    found = load.by_positions(q, w)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # The check sees a wrong derivative.
    found[:, 4, 3] *= 1.01
    assert np.abs(found - expected).max() > 1e-3


def test_kernel_takes_the_load_off_the_demand(tree, load):
    inner = DynamicsKernel(tree)
    kernel = DynamicsKernel(tree, load=load)
    rng = np.random.default_rng(5)
    x = rng.uniform(-1.0, 1.0, (len(TIMES), inner.sparsity.shape[1]))
    w = load.at(TIMES)
    q = x[:, : tree.num_positions]
    difference = inner.evaluate(x, None) - kernel.evaluate(x, w)
    np.testing.assert_allclose(
        FORCE_UNIT * difference, load.generalized(q, w), atol=1e-9
    )
    J = kernel.jacobian(x, w)
    assert not J[:, ~kernel.sparsity].any()
    h = 1e-6
    for i in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[i] = h
        slope = kernel.evaluate(x + step, w) - kernel.evaluate(x - step, w)
        np.testing.assert_allclose(J[:, :, i], slope / (2 * h), atol=1e-6)
