"""New elements for a worn-out design, pulled back to the undeformed sole."""

import numpy as np
import pytest

from drake_exo.soles import mmg
from drake_exo.soles.mesh import brick
from drake_exo.soles.optimize import remeshing
from drake_exo.soles.optimize.remeshing import RemeshError, remesh
from drake_exo.soles.shape import SphericalSpline, pull_back

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
    return remesh(*design)


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


def test_elements_are_better_and_about_as_many(design, kept):
    mesh, spline, p = design
    before, after = _at(mesh, spline, p), _at(kept, spline, p)
    assert after.quality().min() > 1.5 * before.quality().min()
    assert after.volumes.min() > 0
    assert len(kept.tets) == pytest.approx(len(mesh.tets), rel=0.35)


def test_the_same_design_gives_the_same_bytes(design, kept):
    again = remesh(*design)
    assert again.nodes.tobytes() == kept.nodes.tobytes()
    assert again.tets.tobytes() == kept.tets.tobytes()


def test_inverted_elements_are_refused():
    mesh, spline = brick(SIZE, (4, 3, 2)), SphericalSpline((6, 6))
    p = np.where(np.arange(spline.count) % 2, 0.3, 1.4)
    assert _at(mesh, spline, p).volumes.min() < 0
    with pytest.raises(RemeshError, match="inverted already"):
        remesh(mesh, spline, p)


def test_elements_that_are_no_better_are_none(design, monkeypatch):
    mesh, spline, p = design
    deformed = _at(mesh, spline, p)
    same = deformed.nodes, deformed.tets
    monkeypatch.setattr(remeshing, "run_mmg", lambda *_: same)
    with pytest.raises(RemeshError, match="no element is better"):
        remesh(mesh, spline, p)
    moved = deformed.nodes.copy()
    moved[mesh.contact[0]] += 1e-6
    monkeypatch.setattr(remeshing, "run_mmg", lambda *_: (moved, deformed.tets))
    with pytest.raises(RemeshError, match="moved nodes of the surface"):
        remesh(mesh, spline, p)


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
    monkeypatch.setattr(mmg, "_CHILD", child)
    with pytest.raises(RemeshError, match=said):
        remesh(*design)
