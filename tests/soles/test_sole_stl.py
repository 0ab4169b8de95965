"""STL of sole and mould: closed, outward, of the right volume."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles.mesh import (
    SphericalSpline,
    brick,
    is_watertight,
    mould_triangles,
    solid,
    write_triangles,
)
from drake_exo.soles.optimize.design import Design
from drake_exo.soles.surface import crossings

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


def test_any_outline_and_any_top_has_a_mould(mesh):
    """A bean, which turns back; a cup, deeper than the walls are thick."""
    base = brick(SIZE, (16, 6, 3))
    x, y, z = base.nodes.T
    bean = np.stack([x, y + 25 * x**2, z], 1)
    cup = np.stack([x, y, z + 3 * x**2], 1)
    tops = []
    for nodes in (bean, cup):
        shape = base.with_nodes(nodes)
        corners = mould_triangles(shape)
        assert is_watertight(corners)
        top = nodes[shape.fixed, 2].max()  # all of the sole is within
        tops.append(top)
        assert corners[..., 2].max() == pytest.approx(top)
        # Lines from below meet the mould's floor, the cavity and, beside it
        # alone, the block's top.
        for at, count in (((0.0, 0.0), 2), ((0.11, y.min() - 0.005), 2)):
            met = [z.shape[1] for _, z in crossings(corners, np.array([at]))]
            assert met == [count]
    span = np.ptp(bean, axis=0) + np.array([0.02, 0.02, 0.01])
    sole = base.with_nodes(bean)
    assert _volume(mould_triangles(sole)) == pytest.approx(
        np.prod(span) - sole.volume, rel=1e-6
    )
    assert tops[0] == 0 < 0.01 < tops[1]


def test_a_sole_that_is_not_closed_has_no_mould(mesh, tmp_path, monkeypatch):
    told = {"depth": 0.02, "height": 0.04, "draft": 1.0}
    for name, has_mould in (("closed", True), ("open", False)):
        folder = tmp_path / name
        folder.mkdir()
        if not has_mould:
            faces = mesh.contact_faces[1:]
            monkeypatch.setitem(mesh.__dict__, "contact_faces", faces)
        checked = Design._write_stl(
            SimpleNamespace(mesh=mesh, _surface=told), folder
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


@pytest.mark.parametrize("hollows", [0, 1, 2])
def test_a_closed_hollow_is_a_loose_core_of_the_mould(hollows):
    whole = brick((0.24, 0.12, 0.06), (8, 4, 4))
    middle = whole.nodes[whole.tets].mean(axis=1)
    middle[:, 2] += 0.03
    x, y, z = np.abs(middle).T
    within = (x > 0.03) & (x < 0.06) & (y < 0.03) & (z < 0.015)
    cut = within & np.isin(np.sign(middle[:, 0]), [1.0, -1.0][:hollows])
    mesh = replace(whole, tets=whole.tets[~cut])
    mould = mould_triangles(mesh).reshape(-1, 3)
    nodes, faces = np.unique(mould, axis=0, return_inverse=True)
    bodies = solid(nodes, faces.reshape(-1, 3)).decompose()
    assert len(bodies) - 1 == mesh.hollows == hollows
