"""Contact law: derivatives, smoothness, limits."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.soles.contact.law import (
    ContactLaw,
    firmly_sticking,
    project,
    project_with_derivative,
    smooth_plus,
)

EXACT = ContactLaw(friction=0.6, penalty=1e4)
SMOOTH = replace(EXACT, layer=5e-4, kappa=0.2)  # ε = 5 N


def _samples(count=400):
    rng = np.random.default_rng(3)
    tau = rng.uniform(-12, 12, (count, 3))
    tau[::4, :2] *= 0.2  # sticking
    tau[1::4, 2] = rng.uniform(-5, 5, len(tau[1::4]))  # inside the layer
    return tau


def _complex_step_error(law, tau, D):
    h, worst = 1e-30, 0.0
    for k in range(3):
        stepped = tau.astype(complex)
        stepped[:, k] += 1j * h
        column = project(stepped, law).imag / h
        worst = max(worst, np.abs(column - D[:, :, k]).max())
    return worst


@pytest.mark.parametrize("law", [EXACT, SMOOTH], ids=["exact", "smooth"])
def test_derivative_matches_complex_step(law):
    tau = _samples()
    T, D = project_with_derivative(tau, law)
    np.testing.assert_allclose(T, project(tau, law), atol=1e-14)
    assert _complex_step_error(law, tau, D) < 1e-12
    planted = D.copy()
    planted[:, 0, 2] *= 1.001
    assert _complex_step_error(law, tau, planted) > 1e-5


def test_second_derivative_by_complex_step_is_finite_everywhere():
    tau = _samples()
    direction = np.random.default_rng(4).standard_normal(tau.shape)
    _, D = project_with_derivative(tau + 1e-30j * direction, SMOOTH)
    second = D.imag / 1e-30
    h = 1e-6
    plus = project_with_derivative(tau + h * direction, SMOOTH)[1]
    minus = project_with_derivative(tau - h * direction, SMOOTH)[1]
    difference = (plus - minus) / (2 * h)
    error = np.abs(second - difference).max(axis=(1, 2))
    assert np.quantile(error, 0.99) < 1e-8  # a few straddle a branch
    assert np.isfinite(second).all()


def test_smoothed_plus_is_twice_differentiable_at_its_ends():
    for end, value, slope in [(-1.0, 0.0, 0.0), (1.0, 1.0, 1.0)]:
        inside = end * (1 - 1e-9)
        v, s = smooth_plus(inside, 1.0)
        assert v == pytest.approx(value, abs=1e-8)
        assert s == pytest.approx(slope, abs=1e-8)
        curvature = (smooth_plus(end * (1 - 1e-5), 1.0)[1] - slope) / 1e-5
        assert abs(curvature) < 3e-5


def test_exact_law_is_the_projection_on_the_cone():
    tau = _samples()
    T = project(tau, EXACT)
    off = tau[:, 2] <= 0
    assert (T[off] == 0).all()
    cone = EXACT.friction * T[:, 2]
    size = np.linalg.norm(T[:, :2], axis=1)
    assert (size <= cone * (1 + 1e-12)).all()
    firm = firmly_sticking(tau, EXACT)
    np.testing.assert_allclose(T[firm], tau[firm], rtol=1e-14)
    slipping = ~off & ~firm
    np.testing.assert_allclose(size[slipping], cone[slipping], rtol=1e-12)


def test_smoothed_law_tends_to_the_exact_one():
    tau = _samples()
    errors = [
        np.abs(
            project(tau, replace(EXACT, layer=5e-4 * f, kappa=0.2 * f))
            - project(tau, EXACT)
        ).max()
        for f in (1.0, 0.1, 0.01)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.05


def test_without_friction_nothing_is_tangential():
    T, D = project_with_derivative(_samples(), replace(EXACT, friction=0.0))
    assert (T[:, :2] == 0).all()
    assert (D[:, :2] == 0).all()
