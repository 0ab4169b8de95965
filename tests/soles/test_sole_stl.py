"""STL of sole and mould: closed, outward, of the right volume."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles.mesh import (
    SphericalSpline,
    brick,
    has_star_outline,
    is_watertight,
    mould_triangles,
    write_triangles,
)
from drake_exo.soles.optimize.design import Design

SIZE = (0.23, 0.13, 0.03)


@pytest.fixture(scope="module")
def mesh():
    """A bumpy sole, wider below than where it is glued."""
    spline = SphericalSpline((8, 8))
    base = brick(SIZE, (8, 6, 3))
    p = 1 + 0.2 * np.random.default_rng(3).uniform(-1, 1, spline.count)
    shaped = base.with_nodes(spline.deform(base.nodes, p))
    assert shaped.volumes.min() > 0
    return shaped


def _read(path):
    """Normals and corners [mm] of a binary STL, as single precision."""
    data = path.read_bytes()
    count = int(np.frombuffer(data[80:84], "<u4")[0])
    kind = [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]
    record = np.frombuffer(data[84:], dtype=kind)
    assert len(record) == count
    return record["n"], record["v"]


def _open_edges(corners) -> int:
    """Directed edges without their opposite, corners merged bit by bit."""
    _, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3)
    edges = np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    there = {tuple(e) for e in edges.tolist()}
    assert len(there) == len(edges)  # no edge runs twice the same way
    return sum((b, a) not in there for a, b in there)


def _volume(corners) -> float:
    return float(np.linalg.det(corners.astype(float)).sum() / 6)


def test_the_sole_is_watertight_with_outward_normals(mesh, tmp_path):
    write_triangles(tmp_path / "sole.stl", mesh.nodes[mesh.boundary_faces])
    normals, corners = _read(tmp_path / "sole.stl")
    assert _open_edges(corners) == 0
    assert _volume(corners) == pytest.approx(1e9 * mesh.volume, rel=1e-5)
    across = np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    )
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    assert (normals * across).sum(axis=1).min() > 1 - 1e-4


def test_a_missing_triangle_is_noticed(mesh):
    assert _open_edges(mesh.nodes[mesh.boundary_faces[1:]]) == 3


def test_the_mould_is_a_block_less_the_sole(mesh, tmp_path):
    write_triangles(tmp_path / "mould.stl", mould_triangles(mesh))
    _, corners = _read(tmp_path / "mould.stl")
    assert _open_edges(corners) == 0
    span = np.ptp(mesh.nodes, axis=0) + np.array([0.02, 0.02, 0.01])
    assert _volume(corners) == pytest.approx(
        1e9 * (np.prod(span) - mesh.volume), rel=1e-5
    )


def test_an_outline_that_turns_back_has_no_mould(mesh, tmp_path):
    away = mesh.with_nodes(mesh.nodes + np.array([0.3, 0.0, 0.0]))
    told = {"depth": 0.02, "height": 0.04, "draft": 1.0}
    for shape, has_mould in ((mesh, True), (away, False)):
        assert has_star_outline(shape) == has_mould
        folder = tmp_path / str(has_mould)
        folder.mkdir()
        checked = Design._write_stl(
            SimpleNamespace(mesh=shape, _surface=told), folder
        )
        assert (folder / "mould.stl").exists() == has_mould
        assert ("mould.stl" in checked) == has_mould
        assert (folder / "sole.stl").exists() and "sole.stl" in checked


def test_what_a_slicer_refuses_is_not_watertight(mesh):
    """Holes, a face turned over, a surface inside out."""
    corners = mesh.nodes[mesh.boundary_faces]
    assert is_watertight(corners)
    assert is_watertight(mould_triangles(mesh))
    assert not is_watertight(corners[1:])
    turned = corners.copy()
    turned[0] = turned[0, ::-1]
    assert not is_watertight(turned)
    assert not is_watertight(corners[:, ::-1])
