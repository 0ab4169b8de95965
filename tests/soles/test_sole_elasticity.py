"""Elasticity: assembly, patch test, rigid modes, convergence, locking."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from skfem.models.elasticity import lame_parameters, linear_elasticity
from stiffness import stiffness_matrix

from drake_exo.errors import InputError
from drake_exo.soles.elasticity import (
    MATERIALS,
    Material,
    Sole,
    energy_gradients,
    node_dofs,
)
from drake_exo.soles.mesh import brick

SIZE = (0.23, 0.13, 0.03)
RUBBER = MATERIALS["neoprene"]
ELEMENTS = ["linear", "smoothed"]


def _distorted(divisions=(4, 3, 3), amount=0.15):
    mesh = brick(SIZE, divisions)
    rng = np.random.default_rng(0)
    inner = np.setdiff1d(
        np.arange(len(mesh.nodes)), np.unique(mesh.boundary_faces)
    )
    nodes = mesh.nodes.copy()
    step = np.array(SIZE) / divisions
    nodes[inner] += amount * step * rng.uniform(-1, 1, (len(inner), 3))
    return mesh.with_nodes(nodes)


def test_linear_stiffness_is_that_of_scikit_fem():
    mesh = _distorted()
    other = skfem.MeshTet(mesh.nodes.T.copy(), mesh.tets.T.copy())
    basis = skfem.Basis(other, skfem.ElementVector(skfem.ElementTetP1()))
    lam, mu = lame_parameters(RUBBER.youngs_modulus_pa, RUBBER.poissons_ratio)
    expected = skfem.asm(linear_elasticity(lam, mu), basis)
    dofs = basis.nodal_dofs.T.ravel()  # node-wise x, y, z
    expected = expected[dofs][:, dofs]
    K = stiffness_matrix(mesh, RUBBER)
    scale = abs(K).max()
    assert abs(K - expected).max() < 1e-12 * scale


@pytest.mark.parametrize("element", ELEMENTS)
def test_rigid_body_modes_cost_nothing(element):
    mesh = _distorted()
    K = stiffness_matrix(mesh, RUBBER, element)
    x = mesh.nodes
    modes = [np.tile(e, (len(x), 1)) for e in np.eye(3)]
    modes += [np.cross(e, x) for e in np.eye(3)]
    for mode in modes:
        force = np.abs(K @ mode.ravel()).max()
        assert force < 1e-12 * abs(K).max() * np.abs(mode).max()
    values = np.linalg.eigvalsh(K.toarray())
    assert (np.abs(values) < 1e-9 * values[-1]).sum() == 6


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_patch_of_constant_strain(element, nu):
    mesh = _distorted()
    material = replace(RUBBER, poissons_ratio=nu)
    K = stiffness_matrix(mesh, material, element)
    H = np.array([[1, 0.3, -0.2], [0.1, -0.5, 0.4], [0.2, 0.7, 0.3]]) * 1e-3
    u = mesh.nodes @ H.T
    inner = np.setdiff1d(
        np.arange(len(mesh.nodes)), np.unique(mesh.boundary_faces)
    )
    force = (K @ u.ravel()).reshape(-1, 3)
    assert np.abs(force[inner]).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("element", ELEMENTS)
def test_energies_have_right_derivatives_by_the_nodes(element):
    mesh = _distorted()
    sole = Sole(mesh, RUBBER, element)
    rng = np.random.default_rng(3)
    w = rng.standard_normal((3 * len(sole.free), 20))
    factors = rng.standard_normal(20)
    direction = rng.standard_normal(mesh.nodes.shape)
    dofs = node_dofs(sole.free)

    def energy(h):
        K = stiffness_matrix(
            mesh.with_nodes(mesh.nodes + h * direction), RUBBER, element
        )[dofs][:, dofs]
        return -((w * (K @ w)).sum(axis=0) @ factors)

    h = 1e-7
    difference = (energy(h) - energy(-h)) / (2 * h)
    found = (energy_gradients(sole, [(w, factors)]) * direction).sum()
    assert found == pytest.approx(difference, rel=1e-6)


def test_condensation_agrees_with_a_direct_solve():
    sole = Sole(_distorted(), RUBBER)
    rng = np.random.default_rng(1)
    f = rng.standard_normal((len(sole.mesh.contact), 3))
    u = sole.displacement(f)
    load = np.zeros_like(sole.mesh.nodes)
    load[sole.mesh.contact] = f
    dofs = (3 * sole.free[:, None] + np.arange(3)).ravel()
    K = stiffness_matrix(sole.mesh, sole.material, sole.element)[dofs][
        :, dofs
    ].toarray()
    expected = np.linalg.solve(K, load.ravel()[dofs])
    np.testing.assert_allclose(
        u[sole.free].ravel(), expected, atol=1e-10 * np.abs(expected).max()
    )
    assert (u[sole.mesh.fixed] == 0).all()
    np.testing.assert_allclose(
        (sole.compliance @ f.ravel()).reshape(-1, 3),
        u[sole.mesh.contact],
        atol=1e-10 * np.abs(expected).max(),
    )


def _bent(divisions, element, nu):
    """Tip deflection of a clamped column sheared at its free end."""
    material = Material("m", 1e6, nu, 1000.0)
    mesh = brick((0.02, 0.02, 0.08), divisions)
    sole = Sole(mesh, material, element)
    low = np.isclose(mesh.nodes[mesh.contact][:, 2], -0.08)
    faces = mesh.boundary_faces
    tip = np.isclose(mesh.nodes[faces][:, :, 2], -0.08).all(axis=1)
    x = mesh.nodes[faces[tip]]
    area = 0.5 * np.linalg.norm(
        np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
    )
    weight = np.bincount(
        faces[tip].ravel(), np.repeat(area / 3, 3), len(mesh.nodes)
    )
    f = np.zeros((len(mesh.contact), 3))
    f[:, 0] = weight[mesh.contact] / weight.sum()
    u = sole.displacement(f)[mesh.contact][low]
    return float((u[:, 0] * f[low, 0]).sum())


@pytest.mark.slow
def test_energy_converges_under_refinement():
    """P1 energy error falls with h^1.2 or faster (corners limit it)."""
    u = [_bent((n, n, 4 * n), "linear", 0.3) for n in (2, 4, 8)]
    ratio = (u[1] - u[0]) / (u[2] - u[1])
    rate = np.log2(ratio)
    assert u[0] < u[1] < u[2]
    assert rate > 1.2, f"observed rate {rate:.2f}"


PAD = (0.24, 0.12, 0.03)


def _patch_on_pad(x):
    """Points of the loaded patch in the middle of the pad's underside."""
    on = np.isclose(x[2], -PAD[2])
    return on & (np.abs(x[0]) < 0.0601) & (np.abs(x[1]) < 0.0301)


def _indentation(divisions, element, nu):
    """Work of a uniform unit load on the patch (P1 unknowns) [J]."""
    mesh = brick(PAD, divisions)
    sole = Sole(mesh, Material("m", 1e6, nu, 1000.0), element)
    faces = mesh.contact_faces
    x = mesh.nodes[faces]
    loaded = _patch_on_pad(x.transpose(2, 0, 1)).all(axis=1)
    x = x[loaded]
    area = 0.5 * np.linalg.norm(
        np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
    )
    weight = np.bincount(
        faces[loaded].ravel(), np.repeat(area / 3, 3), len(mesh.nodes)
    )[mesh.contact]
    force = np.zeros((3 * len(sole.free), 1))
    force[sole.contact_rows[2::3], 0] = weight / weight.sum()
    return float(force[:, 0] @ sole.factor.solve(force)[:, 0])


def _quadratic_indentation(divisions, nu):
    mesh = brick(PAD, divisions)
    other = skfem.MeshTet(mesh.nodes.T.copy(), mesh.tets.T.copy())
    basis = skfem.Basis(other, skfem.ElementVector(skfem.ElementTetP2()))
    K = skfem.asm(linear_elasticity(*lame_parameters(1e6, nu)), basis)

    @skfem.LinearForm
    def traction(v, _):
        return v[2] / (0.12 * 0.06)

    patch = basis.boundary(other.facets_satisfying(_patch_on_pad))
    f = skfem.asm(traction, patch)
    top = basis.get_dofs(lambda x: np.isclose(x[2], 0.0))
    u = skfem.solve(*skfem.condense(K, f, D=top))
    return float(f @ u)


@pytest.mark.slow
def test_smoothed_element_does_not_lock():
    """Excess stiffness over quadratic tets at ν = 0.3 and 0.49."""
    table = {}
    for nu in (0.3, 0.49):
        reference = _quadratic_indentation((16, 8, 4), nu)
        for element in ELEMENTS:
            soft = _indentation((16, 8, 4), element, nu)
            table[nu, element] = reference / soft - 1
    text = ", ".join(f"{k}: {v:+.3f}" for k, v in table.items())
    for nu in (0.3, 0.49):
        assert abs(table[nu, "smoothed"]) < 0.1, text
        assert table[nu, "smoothed"] < 0.5 * table[nu, "linear"], text
    assert table[0.49, "linear"] > 0.2, text


def test_averages_keep_constants_and_weigh_by_volume():
    mesh = _distorted()
    A = Sole(mesh, RUBBER).node_average
    np.testing.assert_allclose(A @ np.ones(len(mesh.tets)), 1.0)
    around = (A > 0) @ mesh.volumes
    np.testing.assert_allclose(
        (A @ mesh.volumes**-1) * around, (A > 0).sum(1).A1
    )


def test_smoothed_energy_is_that_of_averaged_strains():
    mesh, energy = _distorted(), 0.0
    u = np.random.default_rng(0).standard_normal(mesh.nodes.shape)
    H = np.einsum("eai,eaj->eij", u[mesh.tets], mesh.gradients)
    eps = 0.5 * (H + H.swapaxes(1, 2))
    kappa = RUBBER.lame_lambda + 2 / 3 * RUBBER.shear_modulus
    for groups, shear, bulk in (
        (mesh.edges()[1], RUBBER.shear_modulus, 0.0),
        (mesh.tets, 0.0, kappa),
    ):
        for group in range(groups.max() + 1):
            e = np.flatnonzero((groups == group).any(axis=1))
            share = mesh.volumes[e] / groups.shape[1]
            mean = np.tensordot(share / share.sum(), eps[e], 1)
            dev = mean - np.trace(mean) / 3 * np.eye(3)
            density = shear * (dev**2).sum() + 0.5 * bulk * np.trace(mean) ** 2
            energy += share.sum() * density
    K = stiffness_matrix(mesh, RUBBER, "smoothed")
    assert 0.5 * u.ravel() @ K @ u.ravel() == pytest.approx(energy, rel=1e-11)


@pytest.mark.parametrize("nu", [0.5, 0.6, -1.0])
def test_impossible_poissons_ratio_is_refused(nu):
    with pytest.raises(InputError, match="poissons_ratio"):
        Material("m", 1e6, nu, 1000.0)


@pytest.mark.parametrize("element", ["linear", "smoothed"])
def test_fronts_solve_what_dense_algebra_does(element):
    """Sparse factorisation against numpy's, on a mesh of several fronts."""
    sole = Sole(brick((0.2, 0.1, 0.03), (9, 5, 3)), RUBBER, element)
    dofs = node_dofs(sole.free)
    K = stiffness_matrix(sole.mesh, RUBBER, element)[dofs][:, dofs].toarray()
    inverse = np.linalg.inv(K)
    b = np.random.default_rng(0).standard_normal((len(K), 3))
    scale = np.abs(inverse).max()
    np.testing.assert_allclose(
        sole.factor.solve(b),
        inverse @ b,
        atol=1e-11 * np.abs(inverse @ b).max(),
    )
    rows = sole.contact_rows
    np.testing.assert_allclose(
        sole.compliance, inverse[np.ix_(rows, rows)], atol=1e-11 * scale
    )


def test_a_matrix_that_is_not_definite_is_refused():
    mesh = brick((0.2, 0.1, 0.03), (6, 4, 3))
    nodes = mesh.nodes.copy()
    nodes[mesh.tets[0, 0]] += [0.2, 0.0, 0.0]  # elements turn over
    with pytest.raises(np.linalg.LinAlgError):
        _ = Sole(mesh.with_nodes(nodes), RUBBER).compliance
