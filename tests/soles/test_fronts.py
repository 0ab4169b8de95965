"""Fronts of the elimination, and what a sole says of its own elasticity."""

import numpy as np
import pytest

from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.elasticity import (
    MATERIALS,
    Material,
    Sole,
    _halves,
    fronts_of,
    mirrored,
)
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import exp_rotation
from drake_exo.soles.settings import MaterialBlock


@pytest.fixture(scope="module")
def long():
    """A long sole of two layers: 5 free nodes in each of 61 sections."""
    return Sole(brick((0.6, 0.05, 0.03), (60, 4, 2)), MATERIALS["butyl"])


def test_halves_do_not_touch_but_for_their_separator(long):
    graph, places = long.pattern.graph, long.mesh.nodes[long.free]
    nodes = np.arange(len(places))
    for axis in range(2):
        low, high, between = _halves(graph, places, nodes, axis)
        assert sorted([*low, *high, *between]) == nodes.tolist()
        assert places[low, axis].max() < places[high, axis].min() + 1e-12
        assert graph[low][:, high].nnz == 0
        if axis == 0:
            assert abs(len(low) - len(nodes) / 2) <= 15
            assert len(np.unique(places[between, 0].round(9))) == 1


def test_fronts_are_sections_of_a_long_sole(long):
    """Every node once; a cut is one section, what is left is small."""
    graph, places = long.pattern.graph, long.mesh.nodes[long.free]
    last = np.searchsorted(long.free, long.mesh.contact)
    fronts = fronts_of(graph, places, last)
    own = np.concatenate([front.own for front in fronts])
    assert sorted(own) == list(range(len(places)))
    np.testing.assert_array_equal(fronts[-1].own, last)
    rank = np.empty(len(own), int)
    rank[own] = np.arange(len(own))
    others = len(places) - len(last)
    assert len(fronts) - 1 >= others / 48
    for number, front in enumerate(fronts[:-1]):
        assert len(front.own) <= 48
        assert (np.diff(rank[front.border]) > 0).all()
        assert rank[front.border].min() > rank[front.own].max()
        near = np.unique(graph[front.own].indices)
        later = near[rank[near] > rank[front.own].max()]
        assert np.isin(later, front.border).all()
        for child in front.children:
            assert child < number
            within = np.concatenate([front.own, front.border])
            assert np.isin(fronts[child].border, within).all()
    parents = [c for front in fronts for c in front.children]
    assert sorted(parents) == list(range(len(fronts) - 1))
    # Cuts lie across: a front's nodes are near one another.
    spans = [np.ptp(places[front.own, 0]) for front in fronts[:-1]]
    assert max(spans) < 0.1


@pytest.mark.parametrize("n", [3, 32, 700])
def test_a_lower_triangle_is_mirrored(n):
    A = np.random.default_rng(0).standard_normal((n, n))
    lower, upper = np.tril(A), np.triu(np.full((n, n), 9.0), 1)
    found = mirrored((lower + upper).copy())
    np.testing.assert_array_equal(found, lower + np.tril(A, -1).T)


@pytest.fixture(scope="module", params=["linear", "smoothed"])
def sole(request):
    mesh = brick((0.2, 0.1, 0.03), (5, 3, 2))
    return Sole(mesh, Material("m", 2e6, 0.35, 900.0), request.param)


def test_the_law_s_scale_is_a_usual_node_s_normal_stiffness(sole):
    """Pressed alone by a newton, half of the nodes go deeper than 1/r."""
    m = len(sole.mesh.contact)
    deep = []
    for k in range(m):
        f = np.zeros((m, 3))
        f[k, 2] = 1.0
        deep.append(sole.displacement(f)[sole.mesh.contact[k], 2])
    assert sole.penalty == pytest.approx(1 / np.median(deep))
    law = ContactLaw(0.5, sole.penalty, 2e-4)
    assert law.epsilon == pytest.approx(2e-4 * sole.penalty)


def test_strain_of_a_linear_field_is_its_symmetric_part(sole):
    """A turn has none."""
    rng = np.random.default_rng(1)
    H = rng.standard_normal((4, 3, 3))
    u = np.einsum("nj,qij->qni", sole.mesh.nodes, H)
    eps = np.array([sole.strain(one) for one in u])
    wanted = 0.5 * (H + H.transpose(0, 2, 1))[:, None]
    np.testing.assert_allclose(eps, wanted + 0 * eps, atol=1e-12)
    parts = len(sole.mesh.nodes if sole.element == "smoothed" else
                sole.mesh.tets)  # fmt: skip
    assert eps.shape == (4, parts, 3, 3)
    w = 1e-7 * rng.standard_normal(3)
    turned = sole.mesh.nodes @ (exp_rotation(w) - np.eye(3)).T
    assert np.abs(sole.strain(turned)).max() < 1e-12


def test_displacements_of_several_loads_are_each_one_s(sole):
    m = len(sole.mesh.contact)
    f = np.random.default_rng(2).standard_normal((2, 3, m, 3))
    u = sole.displacement(f)
    assert u.shape == (2, 3, len(sole.mesh.nodes), 3)
    np.testing.assert_allclose(u[1, 2], sole.displacement(f[1, 2]), atol=1e-15)
    # Maxwell–Betti: work of one load on the other's displacement.
    contact = sole.mesh.contact
    a, b = f[0, 0], f[1, 1]
    assert (a * u[1, 1, contact]).sum() == pytest.approx(
        (b * u[0, 0, contact]).sum()
    )


def test_moduli_go_together():
    """E = 9 κ μ / (3 κ + μ); κ = λ + 2 μ / 3; ν = λ / (2 (λ + μ))."""
    for name, modulus in (("neoprene", 1.0e6), ("butyl", 1.4e6)):
        material = MaterialBlock(name).material()
        mu, lam = material.shear_modulus, material.lame_lambda
        kappa = lam + 2 * mu / 3
        assert 9 * kappa * mu / (3 * kappa + mu) == pytest.approx(modulus)
        assert lam / (2 * (lam + mu)) == pytest.approx(0.3)
    # A kilogram is 813 cm³ of neoprene and 1098 of butyl.
    volumes = [1e6 / MATERIALS[n].density_kg_per_m3 for n in MATERIALS]
    np.testing.assert_allclose(volumes, [813.0, 1098.0], rtol=1e-4)
