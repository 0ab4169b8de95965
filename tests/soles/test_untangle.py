"""Inner nodes move until the elements around them are sound."""

import numpy as np

from drake_exo.soles.mesh import brick
from drake_exo.soles.optimize.remeshing import untangled


def _spoilt(seed):
    """A brick whose inner nodes lie at random within a cell's width."""
    mesh = brick((0.2, 0.1, 0.06), (8, 4, 4))
    inner = np.setdiff1d(
        np.arange(len(mesh.nodes)), np.unique(mesh.boundary_faces)
    )
    nodes = mesh.nodes.copy()
    shift = np.random.default_rng(seed).uniform(-1, 1, (len(inner), 3))
    nodes[inner] += 0.012 * shift
    return mesh.with_nodes(nodes), inner


def test_inverted_elements_become_sound():
    for seed in range(3):
        mesh, inner = _spoilt(seed)
        assert mesh.quality().min() < 0
        better = untangled(mesh, 0.3)
        assert better.quality().min() > 0.2
        moved = (better.nodes != mesh.nodes).any(axis=1)
        assert np.isin(np.flatnonzero(moved), inner).all()


def test_sound_elements_stay_as_they_are():
    mesh = brick((0.2, 0.1, 0.06), (8, 4, 4))
    np.testing.assert_array_equal(untangled(mesh, 0.3).nodes, mesh.nodes)


def test_what_inner_nodes_cannot_mend_stays_without_harm():
    """A surface folded over: other elements get no worse than poor."""
    mesh = brick((0.2, 0.1, 0.06), (8, 4, 4))
    nodes = mesh.nodes.copy()
    corner = np.flatnonzero((nodes == nodes.min(axis=0)).all(axis=1))
    nodes[corner] += [0.06, 0.0, 0.0]
    folded = mesh.with_nodes(nodes)
    better = untangled(folded, 0.3)
    np.testing.assert_array_equal(better.nodes[corner], nodes[corner])
    assert better.quality().min() >= folded.quality().min()


def test_a_face_without_area_moves_nothing_to_nowhere():
    mesh = brick((0.2, 0.1, 0.06), (4, 4, 4))
    inner = np.setdiff1d(
        np.arange(len(mesh.nodes)), np.unique(mesh.boundary_faces)
    )
    nodes = mesh.nodes.copy()
    nodes[inner[0]] = nodes[inner[1]]
    flat = mesh.with_nodes(nodes)
    better = untangled(flat, 0.3)
    assert np.isfinite(better.nodes).all()
    assert better.quality().min() > flat.quality().min()
