"""From a surface to a mesh, step by step, each against a closed form."""

import tracemalloc

import numpy as np
import pytest
from scipy.spatial import Delaunay

from drake_exo.errors import InputError
from drake_exo.soles import surface as steps
from drake_exo.soles.mesh import TetMesh, brick, normals_of
from drake_exo.soles.surface import Surface

SIZE = (0.2, 0.08, 0.03)


def _boundary(mesh):
    return mesh.nodes[mesh.boundary_faces]


def _brick(size=SIZE, at=(0.0, 0.0, 0.0), divisions=(4, 3, 2)):
    return _boundary(brick(size, divisions)) + np.array(at)


def _wedge():
    """20 mm thick at −x, 40 at +x, its top flat."""
    mesh = brick((0.2, 0.1, 0.02), (4, 2, 1))
    nodes = mesh.nodes.copy()
    nodes[:, 2] *= 1.5 + nodes[:, 0] / 0.2
    return _boundary(mesh.with_nodes(nodes))


def _triangles(count, seed=0):
    return np.random.default_rng(seed).standard_normal((count, 3, 3))


# Reading


@pytest.mark.parametrize(
    ("longest", "factor"),
    [(0.11, 1.0), (0.44, 1.0), (110.0, 1e-3), (440.0, 1e-3)],
)
def test_the_unit_is_told_by_a_foot_s_length(longest, factor):
    assert steps._scale("file", longest, None) == factor


@pytest.mark.parametrize("longest", [0.09, 0.46, 26.0, 90.0, 460.0])
def test_what_is_no_foot_s_length_in_either_is_asked_for(longest):
    with pytest.raises(InputError, match=f"longest side is {longest:g},"):
        steps._scale("file", longest, None)


def test_given_units_are_kept():
    found = [steps._scale("f", 1.0, u) for u in ("m", "cm", "mm", "inch")]
    assert found == [1.0, 0.01, 0.001, 0.0254]


def test_corners_that_coincide_are_one():
    """Up to a millionth of the largest extent; slivers go with them."""
    near, far = 2e-7, 2e-5
    nodes = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, near, 0], [0, 1, 2], [0, far, 0]]
    )
    faces = np.array(
        [[0, 1, 2], [3, 2, 4], [1, 3, 4], [4, 1, 3], [3, 4, 1], [0, 5, 4]]
    )
    merged, kept = steps._merged(nodes, faces)
    assert len(merged) == 5
    np.testing.assert_allclose(
        merged[kept], nodes[faces[[0, 1, 5]]], atol=2 * near
    )
    assert kept[0, 1] == kept[1, 0] and kept[2, 0] != kept[2, 1]


def test_the_first_bad_edge_is_told_where_it_is():
    corners = _brick(at=(1.0, 2.0, 3.0))
    middle = corners.mean(axis=1)
    hole = int(np.argmin(np.linalg.norm(middle - [1.1, 2.04, 3.0], axis=1)))
    nodes, faces = steps._merged(
        corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    )
    assert steps._parted("file", nodes, faces)[0] is nodes
    with pytest.raises(InputError, match="3 edges are open") as caught:
        steps._parted("file", nodes, np.delete(faces, hole, axis=0))
    said = str(caught.value).split("near (")[1].split(")")[0]
    place = np.array([float(number) for number in said.split(",")])
    edges = 0.5 * (corners[hole] + np.roll(corners[hole], 1, axis=0))
    assert np.abs(edges - place).max(axis=1).min() < 1e-4
    fin = np.concatenate([faces, faces[:1, ::-1]])
    with pytest.raises(InputError, match="3 edges are shared by several"):
        steps._parted("file", nodes, fin)


# What lies where


def test_lines_meet_triangles_where_their_planes_say():
    """By solving for the barycentric coordinates; in more than one batch."""
    corners = _triangles(30)
    upright = np.array([[[0, 0, 0], [1, 0, 0], [0.5, 0, 1.0]]])
    corners = np.concatenate([corners, upright])
    places = np.random.default_rng(1).uniform(-1.5, 1.5, (600, 2))
    found = [[] for _ in places]
    for rows, heights in steps.crossings(corners, places):
        for row, own in zip(rows, heights, strict=True):
            assert not found[row]
            found[row] = sorted(own)
    wanted = [[] for _ in places]
    for triangle in corners[:-1]:
        system = np.vstack([triangle[:, :2].T, np.ones(3)])
        shares = np.linalg.solve(
            system, np.column_stack([places, np.ones(len(places))]).T
        )
        for row in np.flatnonzero((shares >= 0).all(axis=0)):
            wanted[row].append(triangle[:, 2] @ shares[:, row])
    assert max(map(len, wanted)) > 5
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_allclose(a, sorted(b), atol=1e-9)


@pytest.mark.slow
def test_lines_through_a_scan_take_little_memory():
    """Of 100 000 triangles: all with every line took two gigabytes."""
    corners = _boundary(brick((0.25, 0.1, 0.03), (120, 40, 2)))
    scan = (corners[:, None] * np.linspace(0.5, 1, 4)[:, None, None]).reshape(
        -1, 3, 3
    )
    scan = np.concatenate([scan, scan[::-1]])
    tracemalloc.start()
    steps._Thickness(scan)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 3e8


def test_inside_is_what_any_of_some_parts_holds():
    """A part that lies within another leaves no hollow; a cavity does."""
    corners = _boundary(brick((0.2, 0.1, 0.04), (2, 2, 2)))
    part = 0.5 * corners - [0.0, 0.0, 0.01]
    places = 0.01 * np.array([[1, 2, -2], [7, 1, -2], [0, 0, -5]])
    for inner, wanted in ((part, [1, 1, 0]), (part[:, ::-1], [0, 1, 0])):
        thickness = steps._Thickness(np.concatenate([corners, inner]))
        np.testing.assert_array_equal(thickness.inside(places, 0.0), wanted)


def test_a_mesh_that_misses_what_is_enclosed_is_refused(monkeypatch):
    surface = steps.Surface(_boundary(brick((0.2, 0.1, 0.04), (2, 2, 2))), "it")
    for y, refused in ((0.096, False), (0.094, True)):
        less = brick((0.2, y, 0.04), (2, 2, 2))
        monkeypatch.setattr(
            steps, "_meshed", lambda *more, m=less: (m.nodes, m.tets)
        )
        if not refused:
            assert steps.sole_from_surface(surface).volume == less.volume
            continue
        with pytest.raises(InputError, match=r"800.0 cm³, of which 752.0 cm³"):
            steps.sole_from_surface(surface)


def test_a_surface_that_encloses_nothing_is_refused():
    whole = brick((0.25, 0.125, 0.0625), (1, 1, 1))
    corners = _boundary(whole)
    both = np.concatenate([corners, corners[:, ::-1]])  # out- and inwards
    surface = steps.Surface(both, "it")
    assert surface.volume == 0.0
    with pytest.raises(InputError, match="encloses nothing"):
        steps.sole_from_surface(surface)


def test_thickness_of_a_wedge_is_linear():
    thickness = steps._Thickness(_wedge())
    assert thickness.step == pytest.approx(0.2 / 120)
    assert thickness.cell == pytest.approx(thickness.step**2)
    x = np.linspace(-0.095, 0.095, 20)
    places = np.column_stack([x, 0.03 * np.cos(x), x])
    np.testing.assert_allclose(
        thickness.at(places), 0.03 + 0.1 * x, atol=0.1 * thickness.step
    )
    # Beside the outline it is that of the nearest part.
    beside = np.array([[-0.3, 0.0, 0.0], [0.3, 0.2, 0.0]])
    np.testing.assert_allclose(thickness.at(beside), [0.02, 0.04], rtol=0.01)
    assert thickness.usual == pytest.approx(0.03, rel=0.01)
    area = (thickness.values > 0).sum() * thickness.cell
    assert area == pytest.approx(0.2 * 0.1, rel=0.03)
    volume = thickness.values.sum() * thickness.cell
    assert volume == pytest.approx(0.2 * 0.1 * 0.03, rel=0.03)


def test_no_line_runs_through_the_edges_of_a_regular_mesh():
    """Each would meet both triangles beside an edge, or none."""
    for divisions in ((4, 3, 2), (6, 4, 1), (12, 8, 2)):
        thickness = steps._Thickness(_brick(divisions=divisions))
        x, y = (
            thickness.low[k]
            + thickness.step * np.arange(thickness.values.shape[k])
            for k in (0, 1)
        )
        inside = np.outer(np.abs(x) < 0.1, np.abs(y) < 0.04)
        wanted = np.where(inside, 0.03, 0.0)
        np.testing.assert_allclose(thickness.values, wanted, atol=1e-12)


def test_two_parts_one_over_the_other_count_both():
    corners = np.concatenate(
        [_brick((0.2, 0.1, 0.01)), _brick((0.2, 0.1, 0.02), (0, 0, -0.03))]
    )
    thickness = steps._Thickness(corners, 40)
    found = thickness.values[thickness.values > 0]
    np.testing.assert_allclose(found, 0.03)
    z = np.array([0.001, -0.005, -0.02, -0.04, -0.051])
    line = np.column_stack([0.01 + 0 * z, 0.02 + 0 * z, z])
    wanted = [False, True, False, True, False]
    assert thickness.inside(line, 0.0).tolist() == wanted
    # Taken 2 mm lower, the one above is in, and the one below the top out.
    assert thickness.inside(line, 0.002).tolist() == [True, *wanted[1:]]
    beside = line + np.array([0.1, 0, 0])
    assert not thickness.inside(beside, 0.0).any()


def test_thin_parts_count_a_fifth_of_the_usual():
    corners = np.concatenate(
        [_brick((0.2, 0.1, 0.02)), _brick((0.1, 0.1, 0.001), (0.15, 0, 0))]
    )
    thickness = steps._Thickness(corners)
    found = np.unique(thickness.positive.round(9))
    np.testing.assert_allclose(found, [0.004, 0.02])
    place = np.array([[0.15, 0.0, 0.0]])
    np.testing.assert_allclose(thickness.at(place), 0.004)


@pytest.mark.parametrize("tets", [500, 4000])
def test_elements_are_as_large_as_their_number_asks_for(tets):
    """Of a slab: V = tets · h³ / 36."""
    corners = _brick()
    share = steps._share(steps._Thickness(corners), tets)
    edge = (36 * np.prod(SIZE) / tets) ** (1 / 3)
    assert share * SIZE[2] == pytest.approx(edge)


def test_nearest_points_of_triangles():
    """A projection onto a convex set: no corner lies towards the point."""
    corners, points = _triangles(400), _triangles(400, 1)[:, 0] * 2
    found = np.array(
        [steps._nearest(c[None], p[None])[0][0]
         for c, p in zip(corners, points, strict=True)]
    )  # fmt: skip
    shares = np.array(
        [np.linalg.lstsq(c.T, p, rcond=None)[0]
         for c, p in zip(corners, found, strict=True)]
    )  # fmt: skip
    assert shares.min() > -1e-9
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-8)
    towards = ((points - found)[:, None] * (corners - found[:, None])).sum(2)
    assert towards.max() < 1e-9
    # All kinds occur: in the face, on its edges, at its corners.
    kinds = np.bincount((shares > 1e-9).sum(axis=1))
    assert (kinds[1:] > 20).all()


def test_of_all_triangles_or_edges_the_nearest_counts():
    points = _triangles(60, 3)[:, 0]
    for corners in (_triangles(25) / 3, _triangles(25)[:, :2] / 3):
        near, on, least = steps._nearest(corners, points)
        every = np.array([steps._nearest(c[None], points)[2] for c in corners])
        away = np.linalg.norm(near - points, axis=1)
        np.testing.assert_allclose(away, every.min(axis=0), atol=1e-12)
        np.testing.assert_array_equal(on, every.argmin(axis=0))
        np.testing.assert_allclose(least, away, atol=1e-12)


# The top


def test_the_flat_top_is_what_is_highest_and_looks_upwards():
    corners = _brick()
    top = steps._top_faces(Surface(corners, "it"), None)
    np.testing.assert_array_equal(top, (corners[:, :, 2] == 0).all(axis=1))
    assert top.sum() == 2 * 4 * 3


@pytest.mark.parametrize(("dent", "count"), [(3.5e-4, 24), (4.5e-4, 12)])
def test_flat_is_flat_to_two_thousandths_of_the_length(dent, count):
    """Of 200 mm: 0.4 mm."""
    corners = _brick()
    corners[:, :, 2] -= dent * (
        (corners[:, :, 2] == 0) & (corners[:, :, 0] < -0.001)
    )
    top = steps._top_faces(Surface(corners, "it"), None)
    assert top.sum() == count


def _step(part):
    """Two bricks side by side, the second lower, over a part of both."""
    wide = np.array([part, 1 - part]) * 0.2
    return np.concatenate(
        [
            _brick((wide[0], 0.1, 0.02), (-0.5 * wide[0], 0, 0)),
            _brick((wide[1], 0.1, 0.01), (0.5 * wide[1], 0, -0.01)),
        ]
    )


def test_a_top_that_is_a_small_part_is_none():
    large = steps._top_faces(Surface(_step(0.31), "it"), None)
    assert large.sum() == 24
    with pytest.raises(InputError, match="29% of what is seen"):
        steps._top_faces(Surface(_step(0.29), "it"), None)


def test_faces_above_a_height_that_look_upwards_are_taken():
    corners = _step(0.2)
    top = steps._top_faces(Surface(corners, "it"), -0.0101)
    assert top.sum() == 48
    assert (corners[top][:, :, 2] >= -0.0101).all()
    assert steps._top_faces(Surface(corners, "it"), -0.005).sum() == 24
    with pytest.raises(InputError, match=r"no face above 0\.01 m"):
        steps._top_faces(Surface(corners, "it"), 0.01)


@pytest.mark.parametrize(("lean", "is_top"), [(70.0, True), (75.0, False)])
def test_a_steep_face_is_no_top(lean, is_top):
    """Beyond arccos 0.3, 72.5° off the horizontal."""
    c, s = np.cos(np.deg2rad(lean)), np.sin(np.deg2rad(lean))
    corners = np.array([[[0, 0, 0], [c, 0, s], [0, 1, 0]],
                        [[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]])  # fmt: skip
    top = steps._top_faces(Surface(corners, "it"), 0.0)
    assert top.tolist() == [is_top, True]


# The mesh


def _asked(monkeypatch, answers):
    """What Mmg is asked for, while it answers so."""
    asked, answers = [], list(answers)

    def run(body):
        asked.append(body)
        mesh = answers.pop(0)
        return mesh.nodes, mesh.tets

    monkeypatch.setattr(steps, "run_mmg", run)
    return asked


def _shrunk(by, size=SIZE):
    """A brick whose sides and bottom are off by as much, top kept."""
    mesh = brick(size, (6, 4, 2))
    ends = 0.5 * np.array(size) * [1, 1, 2]
    return mesh.with_nodes(mesh.nodes * (1 - by / ends))


def _of_brick(points, size=SIZE):
    """Signed distance to a brick's sides and bottom, from below its top."""
    half = 0.5 * np.array(size)
    off = np.abs(points + half * [0, 0, 1]) - half
    outside = np.linalg.norm(np.maximum(off, 0), axis=1)
    depth = np.maximum(off[:, :2].max(axis=1), -points[:, 2] - size[2])
    return np.where((off < 1e-12).all(axis=1), depth, outside)


def test_mmg_is_given_the_distance_and_the_size_of_elements(monkeypatch):
    at = np.array([0.3, -0.2, 0.7])
    asked = _asked(monkeypatch, 2 * [_shrunk(-1e-3)])
    surface = Surface(_brick(at=at), "it")
    mesh = steps.sole_from_surface(surface, 500)
    edge = (36 * np.prod(SIZE) / 500) ** (1 / 3)
    cut, size = asked
    h = cut["step"]
    assert h == pytest.approx(0.5 * edge)
    grid = cut["nodes"]
    low, high = grid.min(axis=0), grid.max(axis=0)
    np.testing.assert_allclose(low + 1.5 * h, [-0.1, -0.04, -0.03])
    np.testing.assert_allclose(high, [0.1 + 1.5 * h, 0.04 + 1.5 * h, 0.0])
    for axis in range(3):
        lines = np.unique(grid[:, axis].round(12))
        assert 0.6 * h < np.diff(lines).min() <= np.diff(lines).max() < h
    np.testing.assert_allclose(cut["level"], _of_brick(grid), atol=1e-5)
    np.testing.assert_allclose(size["size"], edge)
    # The answer's sides are moved onto the surface, the frame to its top.
    assert mesh.volume == pytest.approx(np.prod(SIZE), rel=1e-9)
    assert (mesh.nodes[mesh.fixed, 2] == 0).all()
    assert len(mesh.fixed) == 7 * 5


def test_a_top_that_is_not_flat_has_grid_above_it(monkeypatch):
    asked = _asked(monkeypatch, 2 * [_shrunk(1e-3)])
    origin = (0.01, 0.02, 0.1)
    surface = Surface(_brick(at=origin), "it")
    mesh = steps.sole_from_surface(surface, 500, 0.09, origin)
    grid, level = asked[0]["nodes"], asked[0]["level"]
    h = asked[0]["step"]
    assert grid[:, 2].max() == pytest.approx(1.5 * h)
    half = 0.5 * np.array(SIZE)
    off = np.abs(grid + half * [0, 0, 1]) - half
    wanted = np.where(
        off.max(axis=1) < 0,
        off.max(axis=1),
        np.linalg.norm(np.maximum(off, 0), axis=1),
    )
    np.testing.assert_allclose(level, wanted, atol=1e-5)
    # What is fixed lies on the top.
    assert (mesh.nodes[mesh.fixed, 2] > -1e-9).all() and len(mesh.fixed) == 35


def test_small_elements_are_no_smaller_than_a_third_of_the_usual(monkeypatch):
    """A thin lip of less than a tenth of the surface."""
    lip = np.concatenate(
        [_brick((0.2, 0.1, 0.02)), _brick((0.008, 0.1, 0.001), (0.104, 0, 0))]
    )
    body = _shrunk(0.0, (0.216, 0.1, 0.02))
    asked = _asked(monkeypatch, [body, body])
    steps._meshed(steps._Thickness(lip), np.zeros(len(lip), bool), False, 300)
    size = asked[1]["size"]
    usual = np.median(size)
    assert size.min() == pytest.approx(0.3 * usual)
    assert (np.isclose(size, 0.3 * usual)).sum() >= 6


def test_the_sole_frame_is_below_the_middle_of_the_top(monkeypatch):
    """In the plane; a wider bottom does not move it."""
    corners = _brick()
    low = corners[:, :, 2] < -0.02
    corners[low] = corners[low] * [1.2, 1, 1] + [0.02, 0, 0]
    asked = _asked(monkeypatch, 2 * [_shrunk(1e-3)])
    at = np.array([0.5, 0.3, 0.9])
    steps.sole_from_surface(Surface(corners + at, "it"), 300)
    grid = asked[0]["nodes"]
    h = asked[0]["step"]
    np.testing.assert_allclose(grid.min(axis=0) + 1.5 * h, [-0.1, -0.04, -0.03])
    np.testing.assert_allclose(grid.max(axis=0) - 1.5 * h,
                               [0.14, 0.04, -1.5 * h])  # fmt: skip


def test_nodes_that_no_cell_has_are_left_out(monkeypatch):
    nodes = 1e-2 * np.arange(18.0).reshape(6, 3)
    cells = np.array([[0, 2, 3, 5], [5, 3, 2, 0]])
    corners, given = _brick(), []
    monkeypatch.setattr(steps, "run_mmg", lambda *_: (nodes, cells))

    def onto(nodes, cells, *_):
        given.append((nodes, cells))
        return nodes, cells

    monkeypatch.setattr(steps, "_onto", onto)
    top = (corners[:, :, 2] == 0).all(axis=1)
    steps._meshed(steps._Thickness(corners), top, True, 300)
    kept, renumbered = given[0]
    np.testing.assert_array_equal(kept, nodes[[0, 2, 3, 5]])
    np.testing.assert_array_equal(kept[renumbered], nodes[cells])


def test_the_rim_is_what_has_faces_beside_the_top(monkeypatch):
    """Of the top these nodes alone are led to the sides."""
    mesh, corners = brick(SIZE, (4, 3, 2)), _brick()
    up, asked, plain = mesh.fixed, [], steps._nearest

    def nearest(triangles, points):
        asked.append(points)
        return plain(triangles, points)

    monkeypatch.setattr(steps, "_nearest", nearest)
    top = (corners[:, :, 2] == 0).all(axis=1)
    steps._onto(mesh.nodes, mesh.tets, corners, top, True)
    inner = (np.abs(mesh.nodes[up, :2]) < [0.0999, 0.0399]).all(axis=1)
    np.testing.assert_array_equal(asked[1], mesh.nodes[up[~inner]])
    assert inner.sum() == 3 * 2


@pytest.mark.parametrize("flat", [True, False])
def test_skin_is_moved_onto_the_surface_and_nothing_else(flat):
    """A block bulged by 1 mm: inner nodes and those of a flat top stay."""
    up = np.array([0, 0, 0.25])
    corners = _brick(at=up)
    top = (corners[:, :, 2] == 0.25).all(axis=1)
    mesh = _shrunk(-1e-3)
    mesh = mesh.with_nodes(mesh.nodes + up)
    inner = np.setdiff1d(np.arange(len(mesh.nodes)), mesh.boundary_faces)
    new, cells = steps._onto(mesh.nodes, mesh.tets, corners, top, flat)
    np.testing.assert_array_equal(cells, mesh.tets)
    np.testing.assert_array_equal(new[inner], mesh.nodes[inner])
    skin = np.unique(mesh.boundary_faces)
    least = steps._nearest(corners, new[skin])[2]
    np.testing.assert_allclose(least, 0.0, atol=1e-9)
    within = np.abs(mesh.nodes[mesh.fixed, :2]) < [0.0999, 0.0399]
    still = mesh.fixed[within.all(axis=1)]
    np.testing.assert_allclose(new[still], mesh.nodes[still], atol=1e-15)
    assert (new[mesh.fixed, 2] == 0.25).all()
    moved = TetMesh(new, cells, mesh.fixed)
    assert moved.volume == pytest.approx(np.prod(SIZE))


def test_a_rim_stays_in_its_top_while_sides_bulge_below():
    """Nodes of the top's edge go to the edge, not down to the nearest side."""
    corners = _brick()
    below = corners[:, :, 2] < -0.01
    corners[below] *= [0.9, 0.9, 1.0]  # sides that lean inwards
    top = (corners[:, :, 2] == 0).all(axis=1)
    mesh = _shrunk(2e-3)
    mesh = mesh.with_nodes(
        mesh.nodes + np.outer(mesh.nodes[:, 2] == 0, [0, 0, 5e-7])
    )
    new, _ = steps._onto(mesh.nodes, mesh.tets, corners, top, True)
    assert (new[mesh.fixed, 2] == 0).all()
    rim = mesh.fixed[
        (np.abs(mesh.nodes[mesh.fixed, :2]) > [0.097, 0.037]).any(axis=1)
    ]
    off = np.abs(new[rim, :2]) - [0.1, 0.04]
    assert np.abs(off.max(axis=1)).max() < 2e-3


def test_elements_in_the_way_hold_back_their_own_nodes():
    """Two tetrahedra far apart; one would be flattened."""
    one = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    nodes = 1e-2 * np.concatenate([one, one + 5 * np.eye(3)[0]])
    cells = np.arange(8).reshape(2, 4)
    # A plane into which all of the first lies, and the tip of the second.
    aim = nodes.copy()
    aim[3] = [0, 0, -1e-2]
    aim[7] = nodes[7] + [0, 0, 5e-3]
    on = np.zeros(8, int)
    corners = np.eye(3)[None]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps, "_nearest", lambda c, p: (aim, on, None))
        new, _ = steps._onto(nodes, cells, corners, None, False)
    np.testing.assert_allclose(new[4:], aim[4:])
    np.testing.assert_allclose(new[:3], nodes[:3])
    # 1 − 2 p of its height, first p = ¼; of what is left less may go.
    assert 1e-3 < new[3, 2] < 5e-3 and (new[3, :2] == 0).all()
    quality = TetMesh(new, cells, on[:0]).quality()
    assert quality[0] >= 0.3
    # Where no part is small enough, everything stays.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps, "_nearest", lambda c, p: (aim * 1e9, on, None))
        new, _ = steps._onto(nodes, cells, corners, None, False)
    np.testing.assert_array_equal(new, nodes)


@pytest.mark.parametrize(("off", "count"), [(0.08, 35), (0.13, 0)])
def test_fixed_is_what_lies_near_the_top(off, count):
    """A tenth of an element's size: the cube root of the median volume."""
    mesh = brick(SIZE, (6, 4, 2))
    size = np.cbrt(np.prod(SIZE) / len(mesh.tets))
    corners = _brick(at=(0, 0, off * size))
    top = (corners[:, :, 2] > off * size - 1e-9).all(axis=1)
    found = steps._fixed_nodes(mesh.nodes, mesh.tets, corners, top, False)
    assert len(found) == count
    flat = steps._fixed_nodes(mesh.nodes, mesh.tets, corners, top, True)
    assert len(flat) == 0
    up = np.array([0, 0, 0.25])
    again = steps._fixed_nodes(
        mesh.nodes + up, mesh.tets, _brick(at=up), top, True
    )
    np.testing.assert_array_equal(again, mesh.fixed)


def test_of_a_surface_volume_and_normals():
    surface = Surface(_wedge(), "it")
    assert surface.volume == pytest.approx(0.2 * 0.1 * 0.03)
    assert Surface(_wedge()[:, ::-1], "it").volume < 0
    normals = normals_of(surface.corners)
    np.testing.assert_allclose(normals.sum(axis=0), 0, atol=1e-15)
    up = normals[:, 2]
    assert up[up > 0].sum() == pytest.approx(2 * 0.2 * 0.1)
    # Convex, so that every normal looks away from the middle.
    middle = surface.corners.mean(axis=1) - surface.corners.mean((0, 1))
    assert (normals * middle).sum(axis=1).min() > 0


def test_delaunay_of_a_cloud_keeps_its_hull():
    """Bodies of any shape: the volume of the convex hull by its crossings."""
    points = np.random.default_rng(4).standard_normal((60, 3))
    hull = Delaunay(points)
    tets = hull.simplices.copy()
    x = points[tets]
    turned = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    tets[turned] = tets[turned][:, [1, 0, 2, 3]]
    mesh = TetMesh(points, tets, np.zeros(0, int))
    thickness = steps._Thickness(_boundary(mesh))
    volume = thickness.values.sum() * thickness.cell
    assert volume == pytest.approx(mesh.volume, rel=2e-4)
    cloud = np.random.default_rng(5).uniform(-3, 3, (500, 3))
    np.testing.assert_array_equal(
        thickness.inside(cloud, 0.0), hull.find_simplex(cloud) >= 0
    )
