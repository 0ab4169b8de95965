"""Neo-Hookean elements: tangent, closed form, frames, small strain."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from scipy.special import lambertw
from stiffness import stiffness_matrix

from drake_exo.soles import finite_strain
from drake_exo.soles.elasticity import Material, Sole
from drake_exo.soles.finite_strain import NeoHookeanBody
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import exp_rotation

MATERIAL = Material("test", 1.0e6, 0.3, 1230.0)
SIZE = (0.06, 0.04, 0.03)


@pytest.fixture
def body():
    """An irregular mesh of a brick."""
    mesh = brick(SIZE, (4, 3, 3))
    nodes = mesh.nodes.copy()
    inside = np.setdiff1d(np.arange(len(nodes)), np.unique(mesh.boundary_faces))
    rng = np.random.default_rng(1)
    nodes[inside] += 2e-3 * rng.uniform(-1, 1, (len(inside), 3))
    return NeoHookeanBody(mesh.with_nodes(nodes), MATERIAL)


def _bumpy(body, size=1e-3, seed=2):
    u = np.zeros_like(body.mesh.nodes)
    rng = np.random.default_rng(seed)
    u[body.free] = size * rng.standard_normal((len(body.free), 3))
    return u


def _tangent_error(body, u) -> float:
    """Largest difference from a complex step of the forces, relative."""
    direction = _bumpy(body, 1.0, seed=3)
    step = body.internal_force(u + 1e-30j * direction).imag / 1e-30
    ours = body.tangent(u) @ direction[body.free].ravel()
    return np.abs(ours - step[body.free].ravel()).max() / np.abs(ours).max()


def _cauchy_stress(F, material):
    """σ = P Fᵀ / J."""
    P = finite_strain.first_stress(F, material)
    return P @ np.swapaxes(F, -1, -2) / np.linalg.det(F)[..., None, None]


def test_tangent_is_the_derivative_of_the_forces(body):
    assert _tangent_error(body, _bumpy(body)) < 1e-13


def test_a_wrong_tangent_is_caught(body, monkeypatch):
    right = NeoHookeanBody.element_tangents

    def without_dilatation(self, u):
        F = self.deformation_gradient(u)
        log_J = np.log(np.linalg.det(F))
        return right(self, u) * (1 + 1e-6 * log_J)[:, None, None, None, None]

    monkeypatch.setattr(NeoHookeanBody, "element_tangents", without_dilatation)
    assert _tangent_error(body, _bumpy(body)) > 1e-8


def _energy(F):
    """W [J/m³] of deformation gradients."""
    log_J = np.log(np.linalg.det(F))
    I1 = (F * F).sum(axis=(-2, -1))
    shear, lam = MATERIAL.shear_modulus, MATERIAL.lame_lambda
    return 0.5 * shear * (I1 - 3 - 2 * log_J) + 0.5 * lam * log_J**2


def test_stress_is_the_derivative_of_the_energy():
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.2 * rng.standard_normal((5, 3, 3))
    P = finite_strain.first_stress(F, MATERIAL)
    for i, j in np.ndindex(3, 3):
        h = np.zeros((3, 3))
        h[i, j] = 1e-6
        slope = (_energy(F + h) - _energy(F - h)) / 2e-6
        np.testing.assert_allclose(P[:, i, j], slope, rtol=1e-6, atol=1e-2)


def test_tangent_at_rest_is_the_small_strain_stiffness(body):
    K = body.tangent(np.zeros_like(body.mesh.nodes))
    sole = Sole(body.mesh, MATERIAL)
    dofs = (3 * body.free[:, None] + np.arange(3)).ravel()
    small = stiffness_matrix(sole.mesh, sole.material)[dofs][:, dofs]
    assert abs(K - small).max() < 1e-12 * abs(small).max()


def test_rigid_motion_gives_no_stress(body):
    R = exp_rotation(np.array([1.0, -2.0, 0.7]))
    X = body.mesh.nodes
    f = body.internal_force(X @ R.T - X + [0.1, 0.2, -0.3])
    assert np.abs(f).max() < 1e-12 * MATERIAL.youngs_modulus_pa * 0.03**2


def test_forces_turn_with_the_body(body):
    R = exp_rotation(np.array([0.5, 1.0, -1.5]))
    X, u = body.mesh.nodes, _bumpy(body)
    turned = body.internal_force((X + u) @ R.T - X)
    plain = body.internal_force(u)
    np.testing.assert_allclose(
        turned, plain @ R.T, atol=1e-12 * np.abs(plain).max()
    )
    F = body.deformation_gradient(u)
    sigma = _cauchy_stress(F, MATERIAL)
    seen = _cauchy_stress(R @ F, MATERIAL)
    np.testing.assert_allclose(seen, R @ sigma @ R.T, atol=1e-3)


def _lateral_stretch(axial: float) -> float:
    """Closed form of μ(y − 1) + λ ln(axial y) = 0, y = stretch²."""
    a = MATERIAL.shear_modulus / MATERIAL.lame_lambda
    y = lambertw(a * np.exp(a) / axial).real / a
    return float(np.sqrt(y))


@pytest.mark.parametrize("axial", [0.5, 0.8, 1.6])
def test_uniaxial_stretch_is_the_closed_form(body, axial):
    """Newton from rest with sliding ends finds the homogeneous solution."""
    X = body.mesh.nodes
    low, high = X.min(axis=0), X.max(axis=0)
    held = np.zeros(X.shape, dtype=bool)
    held[:, 2] = (X[:, 2] == low[2]) | (X[:, 2] == high[2])
    held[:, 0] = X[:, 0] == low[0]
    held[:, 1] = X[:, 1] == low[1]
    all_free = NeoHookeanBody(body.mesh, MATERIAL)
    all_free.__dict__["free"] = np.arange(len(X))
    u = np.zeros_like(X)
    for part in np.linspace(0.2, 1.0, 5):
        u[held] = 0.0
        u[:, 2] = np.where(
            held[:, 2], part * (axial - 1) * (X[:, 2] - high[2]), u[:, 2]
        )
        for _ in range(12):
            f = all_free.internal_force(u)
            if np.abs(f[~held]).max() < 1e-10:
                break
            dofs = np.flatnonzero(~held.ravel())
            K = all_free.tangent(u)[dofs][:, dofs]
            du = np.zeros(X.size)
            du[dofs] = -spsolve(K.tocsc(), f.ravel()[dofs])
            u += du.reshape(X.shape)
    side = _lateral_stretch(axial)
    stretch = np.array([side, side, axial])
    np.testing.assert_allclose(
        u, (stretch - 1) * (X - [low[0], low[1], high[2]]), atol=1e-12
    )
    J = axial * side**2
    F = all_free.deformation_gradient(u)
    np.testing.assert_allclose(np.linalg.det(F), J, rtol=1e-10)
    mu, lam = MATERIAL.shear_modulus, MATERIAL.lame_lambda
    pull = mu * (axial - 1 / axial) + lam * np.log(J) / axial
    total = all_free.internal_force(u)[X[:, 2] == high[2], 2].sum()
    assert total == pytest.approx(pull * SIZE[0] * SIZE[1], rel=1e-9)


def test_inverted_elements_have_no_forces(body):
    u = np.zeros_like(body.mesh.nodes)
    u[body.free[0]] = [0.0, 0.0, 0.05]
    assert np.isnan(body.internal_force(u)).all()
