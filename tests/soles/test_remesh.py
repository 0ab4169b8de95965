"""New elements for a worn-out design, pulled back to the undeformed sole."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles.mesh import TetMesh, brick
from drake_exo.soles.optimize import design as designs
from drake_exo.soles.optimize import remeshing
from drake_exo.soles.optimize.remeshing import (
    RemeshError,
    halved,
    in_eighths,
    remesh,
    sharp_edges,
)
from drake_exo.soles.shape import SphericalSpline, onto_edges, pull_back, reach

pytestmark = pytest.mark.slow

SIZE = (0.23, 0.13, 0.03)


def _at(mesh, spline, p):
    return mesh.with_nodes(spline.deform(mesh.nodes, p))


def _worn(divisions, least=0.04, seed=6, intervals=3):
    """Brick, spline and a design with elements close to inversion."""
    spline = SphericalSpline((intervals, intervals))
    mesh = brick(SIZE, divisions)
    way = np.random.default_rng(seed).normal(size=spline.count)
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        p = np.clip(0.85 + middle * way, 0.3, 1.4)
        ratio = _at(mesh, spline, p).volumes / mesh.volumes
        low, high = (middle, high) if ratio.min() > least else (low, middle)
    return mesh, spline, np.clip(0.85 + low * way, 0.3, 1.4)


@pytest.fixture(scope="module")
def design():
    return _worn((8, 6, 3))


@pytest.fixture(scope="module")
def kept(design):
    return remeshing._with_surface(*design)


@pytest.fixture(scope="module")
def free(design):
    return remeshing._with_halves(*design)


def test_the_design_is_worn(design):
    mesh, spline, p = design
    assert _at(mesh, spline, p).quality().min() < 0.12


def test_pulled_back_and_deformed_is_where_it_was(design):
    _, spline, p = design
    x = np.random.default_rng(0).normal(size=(200, 3)) * 0.1
    x[:, 2] = -np.abs(x[:, 2])
    x[:20, 2] = 0.0
    x[0] = 0.0
    X = pull_back(x, spline, p)
    np.testing.assert_allclose(spline.deform(X, p), x, rtol=0, atol=1e-15)


def test_a_kept_surface_keeps_volume_and_contact_nodes(design, kept):
    mesh, spline, p = design
    before, after = _at(mesh, spline, p), _at(kept, spline, p)
    assert kept.volume == pytest.approx(mesh.volume, rel=1e-13)
    assert after.volume == pytest.approx(before.volume, rel=1e-13)
    for which in ("contact", "fixed"):
        places = [
            np.array(sorted(map(tuple, m.nodes[getattr(m, which)])))
            for m in (mesh, kept)
        ]
        np.testing.assert_array_equal(*places)


def test_a_kept_surface_moves_no_node_that_mmg_placed(design, monkeypatch):
    mesh, spline, p = design
    placed = []

    def spy(*args, **kinds):
        placed.append(mmg(*args, **kinds))
        return placed[-1]

    mmg = remeshing._mmg
    monkeypatch.setattr(remeshing, "_mmg", spy)
    new = remeshing._with_surface(mesh, spline, p)
    np.testing.assert_allclose(
        spline.deform(new.nodes, p), placed[0]["nodes"], rtol=0, atol=1e-12
    )


def test_a_free_surface_is_still_the_bricks(design, free):
    mesh = design[0]
    assert free.volume == pytest.approx(mesh.volume, rel=1e-12)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    x = free.nodes[free.contact]
    near = np.minimum(np.abs(x - low), np.abs(x - high))
    assert near.min(axis=1).max() < 1e-12


def test_the_glued_plane_stays_plane_and_its_rim_sharp(design, free):
    _, spline, p = design
    assert (free.nodes[free.fixed, 2] == 0.0).all()
    others = np.setdiff1d(np.arange(len(free.nodes)), free.fixed)
    assert free.nodes[others, 2].max() < -1e-3
    rim = [e for e in sharp_edges(free) if np.isin(e, free.fixed).all()]
    length = np.linalg.norm(np.diff(free.nodes[rim], axis=1)[:, 0], axis=1)
    assert length.sum() == pytest.approx(2 * (SIZE[0] + SIZE[1]), rel=1e-12)
    shaped = _at(free, spline, p)
    assert (shaped.nodes[free.fixed, 2] == 0.0).all()


def test_elements_are_sound_again_and_about_as_many(design, kept, free):
    mesh, spline, p = design
    before = _at(mesh, spline, p).quality().min()
    assert _at(kept, spline, p).quality().min() > 1.5 * before
    assert _at(free, spline, p).quality().min() > 0.3
    for new in (kept, free):
        assert _at(new, spline, p).volumes.min() > 0
        assert len(new.tets) == pytest.approx(len(mesh.tets), rel=0.35)
    assert len(free.contact) == pytest.approx(len(mesh.contact), rel=0.2)


@pytest.mark.slow
def test_the_surface_is_kept_only_where_that_is_sound(design, kept, free):
    mesh, spline, p = design
    np.testing.assert_array_equal(remesh(mesh, spline, p).nodes, free.nodes)
    new = remesh(mesh, spline, p, lambda new: len(new.nodes) == len(kept.nodes))
    np.testing.assert_array_equal(new.nodes, kept.nodes)


def test_the_same_design_gives_the_same_bytes(design, free):
    again = remeshing._with_halves(*design)
    assert again.nodes.tobytes() == free.nodes.tobytes()
    assert again.tets.tobytes() == free.tets.tobytes()


def test_a_new_mesh_can_be_meshed_anew(free, design):
    _, spline, p = design
    milder = 1.0 + 0.9 * (p - 1.0)
    new = remeshing._with_halves(free, spline, milder)
    assert new.volume == pytest.approx(free.volume, rel=1e-12)
    assert _at(new, spline, milder).quality().min() > 0.2


def test_inverted_elements_are_refused():
    mesh, spline = brick(SIZE, (4, 3, 2)), SphericalSpline((6, 6))
    p = np.where(np.arange(spline.count) % 2, 0.3, 1.4)
    assert _at(mesh, spline, p).volumes.min() < 0
    with pytest.raises(RemeshError, match="inverted already"):
        remesh(mesh, spline, p)


@pytest.mark.slow
def test_without_a_better_mesh_there_is_none(design):
    mesh, spline, p = design
    with pytest.raises(RemeshError, match="no element is better"):
        remesh(mesh, spline, p, lambda new: False)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("raise SystemExit('Mmg: no memory')", "Mmg: no memory"),
        ("print('hello')", "gave no mesh"),
        ("import os; os.kill(os.getpid(), 11)", "ended with code -11"),
        (
            "import resource as r; r.setrlimit(r.RLIMIT_CPU, (1, 1))\n"
            "while True: pass",
            "ended with code",
        ),
    ],
)
def test_a_remesher_that_fails_says_so(
    design, tmp_path, monkeypatch, script, said
):
    child = tmp_path / "child.py"
    child.write_text(script)
    monkeypatch.setattr(remeshing, "_CHILD", child)
    with pytest.raises(RemeshError, match=said):
        remeshing._with_surface(*design)


def test_halves_fill_the_same_body():
    mesh = brick(SIZE, (2, 2, 1))
    fine, values = halved(mesh, mesh.nodes[:, 0])
    assert len(fine.tets) == 8 * len(mesh.tets)
    assert fine.volumes.min() > 0
    assert fine.volume == pytest.approx(mesh.volume, rel=1e-13)
    np.testing.assert_allclose(values, fine.nodes[:, 0], atol=1e-16)
    top = np.flatnonzero(fine.nodes[:, 2] == 0.0)
    np.testing.assert_array_equal(np.sort(fine.fixed), top)


def test_eighths_of_a_worn_design_are_upright_and_see_more_of_it(design):
    mesh, spline, p = design
    coarse = _at(mesh, spline, p)
    shaped, fine, _ = in_eighths(mesh, spline, p)
    assert len(shaped.tets) == 8 * len(mesh.tets)
    assert (shaped.volumes > 0).all()
    assert np.ptp(shaped.nodes[shaped.fixed, 2]) == 0
    new = np.setdiff1d(shaped.contact, np.arange(len(mesh.nodes)))
    exact = spline.deform(fine.nodes, p)
    chord, _ = halved(coarse, np.zeros(len(mesh.nodes)))
    on = (shaped.nodes[new] == exact[new]).all(axis=1)
    off = (shaped.nodes[new] == chord.nodes[new]).all(axis=1)
    assert (on | off).all()
    assert on.mean() > 0.8


def test_edges_of_a_try_follow_from_the_one_before(monkeypatch):
    mesh, spline = brick(SIZE, (4, 3, 2)), SphericalSpline((6, 6))
    cells = iter([(6, 4, 3), None, (6, 4, 2), (5, 5, 2), (7, 4, 2), None])
    sizes = []

    def built(mesh, spline, p, cut, size):
        sizes.append(size)
        n = next(cells)
        if n is None:
            raise RemeshError("no elements")
        return brick(SIZE, n)

    monkeypatch.setattr(remeshing, "_from_eighths", built)
    p = np.ones(spline.count)
    new = remeshing.remesh_with(mesh, spline, p, 300, lambda m: len(sizes) > 4)
    assert len(new.tets) == 7 * 4 * 2 * 6
    fewer = (288 / 300 / 1.05) ** (1 / 3)
    ratio = [0.94, 0.94, fewer, 0.94]
    np.testing.assert_allclose(np.divide(sizes[1:], sizes[:-1]), ratio)


def test_a_finer_check_where_mmg_fails(monkeypatch):
    def fails(*_, **__):
        raise RemeshError("no elements")

    monkeypatch.setattr(designs, "remesh_with", fails)
    kinds = set()
    for seed in (6, 7, 8):
        mesh, spline, p = _worn((6, 4, 2), seed=seed, intervals=6)
        problem = SimpleNamespace(mesh=mesh, spline=spline)
        base, shaped = designs._finer(SIZE, (6, 4, 2), problem, p, mesh)
        assert shaped.volumes.min() > 0
        assert len(shaped.tets) >= 2 * len(mesh.tets)
        if len(shaped.tets) == 8 * len(mesh.tets):
            kinds.add("eighths")
            continue
        exact = spline.deform(base.nodes, p)
        moved = np.flatnonzero((shaped.nodes != exact).any(axis=1))
        assert not np.isin(moved, np.unique(shaped.boundary_faces)).any()
        kinds.add("moved" if len(moved) else "brick")
    assert kinds == {"brick", "moved", "eighths"}


def test_points_move_along_their_rays():
    mesh = brick(SIZE, (2, 2, 1))
    corners = mesh.nodes[mesh.contact_faces]
    at = corners.mean(axis=1)
    factor = np.linspace(0.8, 1.2, len(at))[:, None]
    found = reach(factor * at, corners)
    np.testing.assert_allclose(found, 1 / factor[:, 0], rtol=1e-12)
    assert np.isinf(reach(np.zeros((1, 3)), corners))
    ends = mesh.nodes[sharp_edges(mesh)]
    at = ends.mean(axis=1)
    factor = np.linspace(0.8, 1.2, len(at))[:, None]
    np.testing.assert_allclose(onto_edges(factor * at, ends), at, atol=1e-15)


def test_sharp_edges_are_those_of_the_brick():
    mesh = brick(SIZE, (4, 3, 2))
    length = np.linalg.norm(
        np.diff(mesh.nodes[sharp_edges(mesh)], axis=1)[:, 0], axis=1
    )
    assert length.sum() == pytest.approx(4 * sum(SIZE))
    corners = np.vstack([np.eye(3), np.zeros((1, 3))])
    ball = TetMesh(corners, np.array([[3, 0, 1, 2]]), np.array([3]))
    assert len(sharp_edges(ball)) == 6
