"""What a design's surface has to keep: depth, height, draft, patches, sides."""

import json
from dataclasses import replace

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.mesh import SphericalSpline, brick
from drake_exo.soles.optimize.limits import SurfaceLimits
from drake_exo.soles.settings import ShapeBlock, stage_mesh

SIZE = (0.24, 0.1, 0.03)
ALL = {"depth": 0.02, "height": 0.04, "draft_deg": 3.0}


@pytest.fixture(scope="module")
def bent():
    """A mesh, a spline and a smooth bend of it."""
    mesh, spline = brick(SIZE, (8, 4, 2)), SphericalSpline((5, 5))
    p = 1 + 0.1 * np.random.default_rng(3).standard_normal(spline.count)
    return mesh, spline, p


def _deformed(mesh, spline, p):
    return mesh.with_nodes(spline.deform(mesh.nodes, p))


def test_a_corner_cut_off_at_the_rim_is_no_bottom(bent):
    """It looks downwards like the bottom, but reaches the top."""
    mesh = bent[0]
    corner = np.argmin(
        np.linalg.norm(mesh.nodes - [0.12, 0.05, -0.015], axis=1)
    )
    cut = mesh.nodes.copy()
    cut[corner] = [0.112, 0.043, -0.01]
    cut = mesh.with_nodes(cut)
    assert cut.volumes.min() > 0
    normals, size = cut.areas(cut.contact_faces)
    slanted = (normals[:, 2] < -0.5 * size) & np.isin(
        cut.contact_faces, corner
    ).any(axis=1)  # fmt: skip
    assert slanted.any()
    assert np.isin(cut.contact_faces[slanted], cut.fixed).any(axis=1).all()
    limits = SurfaceLimits(ALL, cut, np.ones(len(cut.nodes), bool))
    assert limits.measures(cut)["depth"] == pytest.approx(0.03)


def test_values_are_those_of_the_surface(bent):
    """By a loop over nodes and faces; soft minima err on the safe side."""
    mesh, spline, p = bent
    shaped = _deformed(mesh, spline, p)
    limits = SurfaceLimits(ALL, mesh, np.ones(len(mesh.nodes), bool))
    level = np.isclose(mesh.nodes[:, 2], -SIZE[2])
    depth = min(-z for z in shaped.nodes[level, 2])
    height = max(-z for z in shaped.nodes[:, 2])
    steepest = -90.0
    for face in shaped.contact_faces:
        a, b, c = shaped.nodes[face]
        n = np.cross(b - a, c - a)
        up = np.rad2deg(np.arcsin(n[2] / np.linalg.norm(n)))
        steepest = max(steepest, up)
    found = limits.measures(shaped)
    assert found == {
        "depth": pytest.approx(depth),
        "height": pytest.approx(height),
        "draft": pytest.approx(-steepest),
    }
    wanted = [
        depth / 0.02 - 1,
        1 - height / 0.04,
        -np.sin(np.deg2rad(steepest)) - np.sin(np.deg2rad(3.0)),
    ]
    values = [value for _, value, _ in limits.evaluate(shaped)]
    # In tenths of a radian, and what counts as feasible has all of it.
    values[2] = 0.1 * (values[2] + 0.005)
    assert np.all(np.array(values) <= np.array(wanted) + 1e-12)
    np.testing.assert_allclose(values, wanted, atol=1.5e-3)


def _slopes(bent, wrong=1.0):
    mesh, spline, p = bent
    limits, step = (
        SurfaceLimits(ALL, mesh, np.ones(len(mesh.nodes), bool)),
        1e-6,
    )
    d = np.random.default_rng(1).standard_normal(len(p))
    ahead, behind = (
        limits.evaluate(_deformed(mesh, spline, p + s * step * d))
        for s in (1, -1)
    )
    moved = spline.stretch(mesh.nodes, d) - spline.basis(mesh.nodes)[1]
    for (_, a, _), (_, b, _), (_, _, x) in zip(
        ahead, behind, limits.evaluate(_deformed(mesh, spline, p)), strict=True
    ):
        x = x * wrong
        yield (a - b) / (2 * step), (x * moved[:, None] * mesh.nodes).sum()


def test_gradients_agree_with_differences(bent):
    for numeric, exact in _slopes(bent):
        assert exact == pytest.approx(numeric, rel=1e-5)


def test_what_does_not_move_is_not_limited(bent):
    """The toe's half, whatever it is like."""
    mesh, spline, p = bent
    shaped = _deformed(mesh, spline, p)
    back = mesh.nodes[:, 0] < 0
    found = SurfaceLimits(ALL, mesh, back).measures(shaped)
    assert found["height"] == pytest.approx(-shaped.nodes[back, 2].min())
    level = back & np.isclose(mesh.nodes[:, 2], -SIZE[2])
    assert found["depth"] == pytest.approx(-shaped.nodes[level, 2].max())


def test_a_face_on_an_upright_edge_that_is_held_has_no_draft():
    """Whatever its third node does: a search would never be within it."""
    mesh = brick(SIZE, (8, 4, 2))
    moving = np.abs(mesh.nodes[:, 0]) > 0.05
    depth = -mesh.nodes[:, 2] / SIZE[2]
    leaning = mesh.nodes * (1 - 0.1 * np.outer(depth * moving, [1, 1, 0]))
    leaning = mesh.with_nodes(leaning)
    limits = SurfaceLimits({"draft_deg": 0.0}, mesh, moving)
    assert limits.measures(leaning)["draft"] > 0.5
    ((_, value, _),) = limits.evaluate(leaning)
    assert value > 0


def test_a_wrong_gradient_is_caught(bent):
    assert all(
        abs(exact - numeric) > 1e-3 * abs(numeric)
        for numeric, exact in _slopes(bent, 1.01)
    )


def test_left_and_right_are_alike():
    spline = SphericalSpline((5, 4), symmetric=True)
    p = 1 + 0.1 * np.random.default_rng(0).standard_normal(spline.count)
    points = np.random.default_rng(1).uniform(-0.1, 0, (50, 3))
    np.testing.assert_allclose(
        spline.stretch(points, p),
        spline.stretch(points * [1, -1, 1], p),
        rtol=1e-12,
    )
    assert spline.count == 4 * 4 + 2  # four of seven rows, and two poles


def _spline(mesh, **optimize):
    case = replace(Case.from_text(EXAMPLE), mesh=mesh)
    return case.optimizing(**optimize).spline()


def test_a_patch_stays():
    mesh = brick(SIZE, (12, 6, 3))
    block = ShapeBlock(fixed_m=(((0.08, -1, -1), (1, 1, 1)),))
    spline = _spline(mesh, intervals=(8, 8), shape=block)
    p = np.full(spline.count, 1.3)
    moved = np.linalg.norm(spline.deform(mesh.nodes, p) - mesh.nodes, axis=1)
    inside = mesh.nodes[mesh.bare, 0] >= 0.08
    assert moved[mesh.bare][inside].max() < 1e-15
    assert moved.max() > 0.02
    free = SphericalSpline((8, 8))
    assert spline.count == free.count - len(
        set(free._column[list(spline.kept)])
    )


def test_a_top_stays_that_is_not_level():
    mesh, held = (
        brick(SIZE, (6, 4, 2)),
        {"intervals": (6, 6), "fixed_top": True},
    )
    for toes in (0.0, 0.004, -0.004):
        nodes = mesh.nodes.copy()
        nodes[mesh.fixed, 2] += toes * (nodes[mesh.fixed, 0] > 0.1)
        spline = _spline(replace(mesh, nodes=nodes), **held)
        moved = spline.deform(nodes, np.full(spline.count, 1.3)) - nodes
        assert np.abs(moved[mesh.fixed]).max() < 1e-15
        assert np.abs(moved).max() > 1e-3
    assert not _spline(mesh, **held).kept
    below = replace(mesh, nodes=mesh.nodes - [0.0, 0.0, 0.05])
    with pytest.raises(InputError, match="origin lies in a top"):
        _spline(below, **held).free_map()


@pytest.mark.slow
def test_a_patch_stays_on_the_meshes_of_all_stages():
    heel = "{shape: {fixed_m: [[[-1, -1, -1], [-0.06, 1, 1]]]}}"
    head, _, _ = EXAMPLE.partition("optimize:")
    case = Case.from_text(f"{head}optimize: {heel}")
    spline = case.spline()
    for stage in case.settings.optimize.stages:
        nodes = stage_mesh(case.mesh, stage).nodes
        moved = spline.deform(nodes, np.full(spline.count, 1.3)) - nodes
        there = nodes[:, 0] <= -0.06
        assert np.abs(moved[there]).max() < 1e-15 < np.abs(moved).max()


@pytest.mark.parametrize(
    ("block", "words"),
    [
        ("{fixed_m: [[[1, 1, 1], [2, 2, 2]]]}", "fixed_m[0]"),
        (
            "{fixed_m: [[[-1, -1, -1], [1, 1, 1]]]}",
            "no part of the sole is left",
        ),
        ("{least_depth_m: 0.05, largest_height_m: 0.04}", "below"),
        ("{draft_deg: 60}", "draft_deg"),
        ("{least_depth_m: 0}", "least_depth_m"),
    ],
)
def test_what_cannot_be_is_refused(block, words, tmp_path, capsys):
    path = tmp_path / "case.yaml"
    assert "optimize:" in EXAMPLE
    path.write_text(
        EXAMPLE.replace("optimize:", f"optimize:\n  shape: {block}")
    )
    out = tmp_path / "out"
    argv = ["sole", "optimize", str(path), "--out", str(out)]
    assert cli.main(argv) == 2
    error = capsys.readouterr().err
    assert f"{path}:" in error
    assert words in error and error.count("\n") == 1


@pytest.mark.slow
def test_a_design_keeps_them_all(tmp_path, capsys):
    """And says which hold it."""
    case = Case.from_text(EXAMPLE)
    shape = ShapeBlock(True, (), 0.026, 0.034, 2.0)
    settings = replace(
        case.settings,
        optimize=replace(case.settings.optimize, shape=shape),
    )
    path = tmp_path / "case.yaml"
    path.write_text(schema.dump_text(settings))
    with undrawn():
        argv = ["sole", "optimize", str(path), "--out", str(tmp_path / "out")]
        assert cli.main([*argv, "--iterations", "30"]) in (0, 3)
    said = json.loads((tmp_path / "out" / "summary.json").read_text())
    checks = {c["name"]: c for c in said["checks"]}
    for name in ("bounds.depth", "bounds.height", "bounds.draft"):
        assert checks[name]["holds"], checks[name]
    assert "symmetric" in said["active"]
    assert {"depth", "height", "draft_deg"} & set(said["active"])
    assert "held by" in capsys.readouterr().out
    design = Case.read(tmp_path / "out" / "case.yaml")
    assert design.settings.optimize.shape == shape


def test_a_lower_sole_than_its_depth_is_refused():
    with pytest.raises(InputError, match="least_depth_m"):
        ShapeBlock(least_depth_m=0.03, largest_height_m=0.02)
