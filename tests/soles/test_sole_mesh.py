"""Meshes and shapes: volume, gradients, quality, files, bad meshes."""

from dataclasses import replace

import meshio
import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.soles.mesh import (
    SphericalSpline,
    TetMesh,
    brick,
    checked_mesh,
    halved,
    read_mesh,
    write_triangles,
    write_vtk,
)

SIZE = (0.23, 0.13, 0.03)


def test_brick_fills_its_box_at_any_density():
    for divisions in [(1, 1, 1), (5, 3, 2), (8, 4, 3)]:
        mesh = brick(SIZE, divisions)
        assert mesh.volume == pytest.approx(np.prod(SIZE), rel=1e-12)
        assert (mesh.volumes > 0).all()
        np.testing.assert_allclose(np.ptp(mesh.nodes, axis=0), SIZE, atol=1e-15)
        assert (mesh.nodes[mesh.fixed, 2] == 0).all()


def test_brick_of_even_divisions_is_symmetric():
    mesh = brick(SIZE, (4, 4, 2))
    centres = mesh.nodes[mesh.tets].mean(axis=1)

    def key(c):
        return np.sort(np.round(c * 1e6).astype(int) @ [10**12, 10**6, 1])

    np.testing.assert_array_equal(key(centres), key(centres * [-1, 1, 1]))
    np.testing.assert_array_equal(key(centres), key(centres * [1, -1, 1]))


@pytest.mark.slow
def test_halved_elements_fill_the_same_body():
    mesh = brick((0.2, 0.1, 0.03), (4, 3, 2))
    moved = mesh.nodes + 0.1 * np.sin(40 * mesh.nodes[:, ::-1]) * [
        0.1, 0.1, 0.02
    ] * (mesh.nodes[:, 2:] < 0)  # fmt: skip
    mesh = mesh.with_nodes(moved)
    found = halved(mesh)
    assert len(found.tets) == 8 * len(mesh.tets)
    assert found.volume == pytest.approx(mesh.volume, rel=1e-12)
    # An eighth each; as good as the worst is, but for the shape within.
    np.testing.assert_allclose(
        np.sort(found.volumes), np.sort(np.repeat(mesh.volumes / 8, 8))
    )
    assert found.quality().min() > 0.8 * mesh.quality().min()
    # Conforming: one surface with four triangles for each.
    assert len(found.boundary_faces) == 4 * len(mesh.boundary_faces)
    np.testing.assert_allclose(
        found.areas(found.boundary_faces)[0].sum(axis=0), 0, atol=1e-15
    )
    assert set(mesh.fixed) < set(found.fixed)
    top = np.flatnonzero(found.nodes[:, 2] == 0)
    assert found.fixed.tolist() == top.tolist()


def test_volume_gradient_matches_finite_differences():
    rng = np.random.default_rng(0)
    mesh = brick(SIZE, (4, 3, 2))
    d = rng.standard_normal(mesh.nodes.shape)
    h = 1e-6
    plus = mesh.with_nodes(mesh.nodes + h * d).volume
    minus = mesh.with_nodes(mesh.nodes - h * d).volume
    slope = (plus - minus) / (2 * h)
    assert (mesh.volume_gradient() * d).sum() == pytest.approx(slope, rel=1e-8)


def test_surface_normals_point_outwards():
    mesh = brick(SIZE, (3, 3, 2))
    x = mesh.nodes[mesh.boundary_faces]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    # Divergence theorem: the flux of x/3 is the volume.
    flux = (normal * x.mean(axis=1)).sum() / 6
    assert flux == pytest.approx(mesh.volume, rel=1e-12)


def test_quality_of_known_tetrahedra():
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    mesh = brick(SIZE, (2, 2, 2))
    assert (mesh.quality() > 0).all()
    tets = np.array([[0, 2, 1, 3]])
    one = TetMesh(regular, tets, np.array([0]))
    sign = np.sign(one.volumes[0])
    assert sign * one.quality()[0] == pytest.approx(1.0, rel=1e-12)


def test_authors_mesh_comes_in_the_sole_frame(data_root):
    folder = data_root / "soft_sole_hrp4" / "meshes"
    mesh = read_mesh(folder / "brick_0.23x0.13x0.030_164nodes.msh")
    assert len(mesh.nodes) == 164
    np.testing.assert_allclose(
        mesh.nodes.min(axis=0), [-0.115, -0.065, -0.03], atol=1e-12
    )
    np.testing.assert_allclose(
        mesh.nodes.max(axis=0), [0.115, 0.065, 0.0], atol=1e-12
    )
    assert mesh.volume == pytest.approx(897e-6, rel=1e-9)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh"])
def test_files_of_other_formats_are_read(tmp_path, suffix):
    mesh = brick(SIZE, (3, 2, 2))
    path = tmp_path / f"sole{suffix}"
    meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]).write(path)
    back = read_mesh(path)
    np.testing.assert_allclose(back.nodes, mesh.nodes, atol=1e-15)
    np.testing.assert_array_equal(back.contact, mesh.contact)


def test_a_mirrored_mesh_is_read(tmp_path):
    """The other foot's: all tets list their nodes the other way round."""
    mesh, path = brick(SIZE, (3, 2, 2)), tmp_path / "left.vtk"
    nodes = mesh.nodes * [1, -1, 1]
    meshio.Mesh(nodes, [("tetra", mesh.tets)]).write(path)
    back = read_mesh(path)
    np.testing.assert_allclose(back.volumes, mesh.volumes)
    np.testing.assert_array_equal(back.nodes, nodes)


def test_cells_that_are_no_tets_are_not_left_out(tmp_path):
    """A half of hexahedra would be missing in the sole."""
    mesh, path = brick(SIZE, (3, 2, 2)), tmp_path / "sole.msh"
    hexa = np.array([[0, 4, 6, 2, 1, 5, 7, 3]])
    two, one = ("hexahedron", np.vstack([hexa, hexa])), ("hexahedron", hexa)
    cells = [two, ("tetra", mesh.tets), one]
    meshio.write(path, meshio.Mesh(mesh.nodes, cells), file_format="gmsh22")
    with pytest.raises(InputError, match="3 cells of type hexahedron beside"):
        read_mesh(path)


def test_a_robot_s_mesh_of_another_kind_is_told_of_surfaces(tmp_path):
    (tmp_path / "foot.dae").write_text("<COLLADA/>")
    with pytest.raises(InputError, match=r"give a surface \(.stl, .obj\) or t"):
        read_mesh(tmp_path / "foot.dae")


def test_a_nastran_file_that_is_cut_off_is_refused(tmp_path):
    """After its first line of data meshio would read on forever."""
    path = tmp_path / "sole.bdf"
    path.write_text("$ made by a mesher\nBEGIN BULK\n")
    with pytest.raises(InputError, match="does not end with ENDDATA"):
        read_mesh(path)


@pytest.mark.parametrize("end", ["ENDDATA", "enddata"])
def test_a_nastran_file_in_either_case_is_read(tmp_path, end):
    mesh, path = brick(SIZE, (3, 2, 2)), tmp_path / "sole.bdf"
    nodes = [f"{i + 1},,{x},{y},{z}" for i, (x, y, z) in enumerate(mesh.nodes)]
    tets = [",".join(map(str, tet)) for tet in (mesh.tets + 1).tolist()]
    rows = ["begin bulk", *(f"grid,{node}" for node in nodes)]
    rows += [f"ctetra,{k + 1},1,{tet}" for k, tet in enumerate(tets)]
    words = "\n".join([*rows, end, ""])
    path.write_text(words if end.islower() else words.upper())
    back = read_mesh(path)
    np.testing.assert_allclose(back.nodes, mesh.nodes, atol=1e-12)
    np.testing.assert_array_equal(back.tets, mesh.tets)


@pytest.mark.parametrize(
    ("suffix", "rows", "words"),
    [
        (".su2", 1, "holds 71 of its elements"),
        (".mdpa", 100, "its nodes do not end"),
        (".msh", 100, "its last bracket does not close"),
        (".dat", 100, "it is cut off"),
    ],
)
def test_a_file_that_is_cut_off_is_refused(tmp_path, suffix, rows, words):
    """Of all but the first format meshio would read on forever."""
    mesh, path = brick(SIZE, (3, 2, 2)), tmp_path / f"sole{suffix}"
    made = meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)])
    if suffix == ".msh":
        meshio.ansys.write(path, made, binary=False)
    else:
        made.write(path)
    lines = path.read_bytes().splitlines(keepends=True)
    while lines[-1].startswith(b"NMARK"):
        lines.pop()
    path.write_bytes(b"".join(lines[:-rows]))
    with pytest.raises(InputError, match=words):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("sole.msh", "(2 3)\n(10 (0 1 36 0)", "its last bracket does not"),
        ("sole.off", "OFF\n# of a scanner\n", "numbers of nodes and faces are"),
    ],
)
def test_a_file_whose_end_meshio_would_seek_is_refused(
    tmp_path, name, text, words
):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_mesh(path)


def test_inverted_element_is_refused():
    mesh = brick(SIZE, (2, 2, 2))
    tets = mesh.tets.copy()
    tets[3] = tets[3][[1, 0, 2, 3]]
    with pytest.raises(InputError, match=r"inverted.*element 3"):
        checked_mesh(mesh.nodes, tets, mesh.fixed, "m")


def test_repeated_elements_are_refused():
    """Their outer faces would be taken for inner ones, which never touch."""
    mesh = brick(SIZE, (2, 2, 2))
    tets = np.concatenate([mesh.tets, mesh.tets[5:6]])
    with pytest.raises(InputError, match="there twice or overlap"):
        checked_mesh(mesh.nodes, tets, mesh.fixed, "m")


def test_unconnected_parts_are_refused():
    mesh = brick(SIZE, (2, 2, 2))
    nodes = np.concatenate([mesh.nodes, mesh.nodes + np.eye(3)[0]])
    tets = np.concatenate([mesh.tets, mesh.tets + len(mesh.nodes)])
    with pytest.raises(InputError, match="2 unconnected parts"):
        checked_mesh(nodes, tets, mesh.fixed, "m")


def test_a_mesh_without_flat_top_is_refused(tmp_path):
    mesh = brick(SIZE, (2, 2, 2))
    path = tmp_path / "tilted.vtk"
    c, s = np.cos(0.2), np.sin(0.2)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    meshio.Mesh(mesh.nodes @ turn.T, [("tetra", mesh.tets)]).write(path)
    with pytest.raises(InputError, match="no face is glued to the foot"):
        read_mesh(path)


def test_marks_of_glued_nodes_are_one_a_node(tmp_path):
    """Not three as of displacements: they would be of other nodes."""
    mesh = brick(SIZE, (2, 2, 2))
    given, path = [("tetra", mesh.tets)], tmp_path / "sole.vtk"
    for marks, words in (
        (np.ones_like(mesh.nodes), "81 numbers for 27 nodes"),
        (np.zeros(27), "no face is glued to the foot"),
        (np.ones(27), "an underside, free of nodes glued to the foot"),
    ):
        meshio.Mesh(mesh.nodes, given, {"fixed": marks}).write(path)
        with pytest.raises(InputError, match=words):
            read_mesh(path)


def test_a_mesh_that_is_long_along_y_is_refused_as_a_surface_is(tmp_path):
    """A block of a case says itself which way it lies, and so does its file."""
    mesh, path = brick((0.1, 0.25, 0.03), (2, 4, 2)), tmp_path / "turned.vtk"
    meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]).write(path)
    with pytest.raises(InputError, match=r"100 x 250 x 30 mm, .*; turn it"):
        read_mesh(path)
    write_vtk(path, mesh)
    np.testing.assert_array_equal(read_mesh(path).tets, mesh.tets)


def test_a_bump_is_no_top(tmp_path):
    """A sixth of what is seen from above: nobody glues a foot to it."""
    mesh = brick(SIZE, (6, 4, 2))
    middle = np.abs(mesh.nodes[mesh.fixed, :2]).sum(axis=1).argmin()
    near = mesh.nodes[mesh.fixed] - mesh.nodes[mesh.fixed[middle]]
    raised = (np.abs(near[:, :2]) < 0.3 * np.array(SIZE[:2])).all(axis=1)
    nodes = mesh.nodes.copy()
    nodes[mesh.fixed[raised], 2] += 0.005
    mesh = mesh.with_nodes(nodes)
    path = tmp_path / "bump.vtk"
    meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]).write(path)
    with pytest.raises(
        InputError, match=r"not a flat top .*point data 'fixed'"
    ):
        read_mesh(path)
    told = np.isin(np.arange(len(mesh.nodes)), mesh.fixed).astype(np.int32)
    cells = [("tetra", mesh.tets)]
    meshio.Mesh(mesh.nodes, cells, {"fixed": told}).write(path)
    np.testing.assert_array_equal(read_mesh(path).fixed, mesh.fixed)


def test_a_sole_without_an_underside_is_refused():
    nodes = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, -0.3]]) / 10
    with pytest.raises(InputError, match="lie in a line"):
        checked_mesh(nodes, np.array([[0, 2, 1, 3]]), np.arange(3), "one")


def test_stl_holds_the_closed_surface(tmp_path):
    mesh = brick(SIZE, (3, 2, 2))
    path = tmp_path / "sole.stl"
    write_triangles(path, mesh.nodes[mesh.boundary_faces])
    back = meshio.read(path)
    triangles = back.points[back.cells_dict["triangle"]]
    volume = np.linalg.det(triangles).sum() / 6
    assert volume == pytest.approx(mesh.volume * 1e9, rel=1e-5)


@pytest.mark.parametrize(
    ("intervals", "fixed", "count"),
    [((10, 10), False, 122), ((10, 10), True, 100), ((6, 6), False, 50)],
)
def test_spline_counts_its_free_coefficients(intervals, fixed, count):
    assert SphericalSpline(intervals, fixed).count == count


def test_spline_of_ones_is_the_initial_shape():
    mesh = brick(SIZE, (6, 4, 3))
    for fixed in (False, True):
        spline = SphericalSpline((10, 10), fixed)
        out = spline.deform(mesh.nodes, np.ones(spline.count))
        np.testing.assert_allclose(out, mesh.nodes, atol=1e-15)


def test_spline_keeps_top_flat_and_fixes_it_on_demand():
    rng = np.random.default_rng(1)
    mesh = brick(SIZE, (6, 4, 3))
    top = mesh.fixed
    free = SphericalSpline((10, 10))
    out = free.deform(mesh.nodes, rng.uniform(0.7, 1.2, free.count))
    assert (out[top, 2] == 0).all()
    assert np.abs(out[top] - mesh.nodes[top]).max() > 1e-3
    fixed = SphericalSpline((10, 10), fixed_top=True)
    out = fixed.deform(mesh.nodes, rng.uniform(0.7, 1.2, fixed.count))
    np.testing.assert_allclose(out[top], mesh.nodes[top], atol=1e-15)


def test_poles_are_tied():
    spline = SphericalSpline((10, 10))
    around = np.linspace(0.1, 2 * np.pi, 7)
    near = np.stack(
        [np.ones(7), 1e-9 * np.sin(around), -1e-9 * np.abs(np.cos(around))], 1
    )
    rng = np.random.default_rng(2)
    M, s0 = spline.basis(near)
    s = M @ rng.uniform(0.5, 1.5, spline.count) + s0
    assert np.ptp(s) < 1e-6


def test_volume_scales_with_the_cube_of_a_constant_factor():
    mesh = brick(SIZE, (4, 3, 2))
    spline = SphericalSpline((5, 5))
    bigger = mesh.with_nodes(
        spline.deform(mesh.nodes, np.full(spline.count, 1.1))
    )
    assert bigger.volume == pytest.approx(1.1**3 * mesh.volume, rel=1e-12)


def _cloud(seed=0, count=12):
    """Tetrahedra anywhere, no two alike."""
    nodes = np.random.default_rng(seed).standard_normal((4 * count, 3))
    return TetMesh(nodes, np.arange(4 * count).reshape(-1, 4), np.zeros(0, int))


def test_areas_are_those_of_their_sides():
    """Heron's formula; normals across both sides of a triangle."""
    mesh = _cloud()
    faces = np.random.default_rng(1).permutation(48).reshape(-1, 3)
    area, size = mesh.areas(faces)
    x = mesh.nodes[faces]
    a, b, c = (np.linalg.norm(x[:, k] - x[:, k - 1], axis=1) for k in range(3))
    s = 0.5 * (a + b + c)
    heron = np.sqrt(s * (s - a) * (s - b) * (s - c))
    np.testing.assert_allclose(size, 2 * heron)
    np.testing.assert_allclose(np.linalg.norm(area, axis=1), size)
    for k in range(3):
        side = x[:, k] - x[:, k - 1]
        np.testing.assert_allclose((area * side).sum(axis=1), 0, atol=1e-12)
    turned, _ = mesh.areas(faces[:, ::-1])
    np.testing.assert_allclose(turned, -area)


def test_gradients_of_linear_fields_are_exact():
    mesh, slope = _cloud(), np.array([1.0, -2.0, 0.5])
    values = (mesh.nodes @ slope + 7.0)[mesh.tets]
    found = np.einsum("ea,eai->ei", values, mesh.gradients)
    np.testing.assert_allclose(found, np.tile(slope, (12, 1)), atol=1e-9)


def test_quality_of_a_corner_and_of_one_turned_over():
    """12 (3 V)^(2/3) / Σ l²: of a unit corner V = 1/6, Σ l² = 9."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = TetMesh(
        3.0 * corner, np.array([[0, 1, 2, 3], [1, 0, 2, 3]]), np.zeros(0, int)
    )
    np.testing.assert_allclose(mesh.quality(), [1, -1] * np.array(
        4 / 3 * 0.5 ** (2 / 3)))  # fmt: skip


def test_slopes_of_quality():
    """One of the tets is turned over."""
    mesh = _cloud()
    mesh = replace(mesh, tets=[mesh.tets[0, [1, 0, 2, 3]], *mesh.tets[1:]])
    rng = np.random.default_rng(3)
    share, way = (
        rng.uniform(size=len(mesh.tets)),
        rng.normal(size=mesh.nodes.shape),
    )
    h = 1e-6
    ahead, behind = (
        share @ mesh.with_nodes(mesh.nodes + s * h * way).quality()
        for s in (1, -1)
    )
    found = mesh.quality_gradient(share)
    assert (found * way).sum() == pytest.approx((ahead - behind) / (2 * h))


@pytest.mark.parametrize(("out", "found"), [(0.01, True), (0.04, False)])
def test_a_top_has_a_middle_if_it_is_nearly_a_rectangle(tmp_path, out, found):
    """One corner further out by a part d: (1 + d/2) / (1 + d) of its box."""
    mesh = brick((0.2, 0.1, 0.03), (1, 1, 1))
    nodes = mesh.nodes.copy()
    corner = (nodes[:, :2] > 0).all(axis=1)
    nodes[corner, 0] += 0.2 * out
    write_vtk(
        tmp_path / "it.vtk", mesh.with_nodes(nodes + np.array([0.3, 0.4, 0.5]))
    )
    if found:
        read = read_mesh(tmp_path / "it.vtk")
        np.testing.assert_allclose(read.nodes, nodes - [0.1 * out, 0, 0])
    else:
        with pytest.raises(
            InputError, match=r"not a rectangle, and lies at z = 0\.5"
        ):
            read_mesh(tmp_path / "it.vtk")


def test_a_brick_has_the_cells_that_it_is_asked_for():
    mesh = brick((0.2, 0.1, 0.03), (5, 3, 2))
    assert len(mesh.tets) == 6 * 5 * 3 * 2
    for axis, count in enumerate((5, 3, 2)):
        lines = np.unique(mesh.nodes[:, axis].round(12))
        assert len(lines) == count + 1
        np.testing.assert_allclose(np.diff(lines), np.ptp(lines) / count)


@pytest.mark.parametrize(("part", "sound"), [(1e-8, True), (1e-10, False)])
def test_flat_elements_are_flat_beside_the_usual_one(part, sound):
    """However fine the mesh is: here a usual element has a fifth of a mm³."""
    mesh = brick((0.012, 0.012, 0.012), (12, 12, 12))
    usual = np.median(mesh.volumes)
    assert usual < 2e-10
    # A further one stands on a corner of the top.
    high = 6 * part * usual / 1e-6
    further = mesh.nodes[-1] + np.array(
        [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, high]]
    )
    n = len(mesh.nodes)
    nodes = np.concatenate([mesh.nodes, further])
    tets = np.concatenate([mesh.tets, [[n - 1, n, n + 1, n + 2]]])
    volume = TetMesh(nodes, tets, mesh.fixed).volumes[-1]
    assert volume == pytest.approx(part * usual)
    if sound:
        checked_mesh(nodes, tets, mesh.fixed, "m")
    else:
        with pytest.raises(InputError, match=r"1 of 10369 .* flat"):
            checked_mesh(nodes, tets, mesh.fixed, "m")


def test_millimetres_made_in_place_do_not_change_a_mesh():
    """A case and all its steps have one mesh, and what follows is kept."""
    mesh = brick(SIZE, (3, 2, 2))
    given = mesh.nodes.copy()
    moved = mesh.with_nodes(given)
    given *= 1e3
    np.testing.assert_array_equal(moved.nodes, mesh.nodes)
    with pytest.raises(ValueError, match="read-only"):
        mesh.nodes[:] *= 1e3


def test_a_brick_of_too_many_tets_is_refused():
    with pytest.raises(InputError, match="make 5382000 tets, more than"):
        brick((0.23, 0.13, 0.03), (230, 130, 30))


def test_a_curved_top_is_read_as_it_was_written(tmp_path):
    """What is glued stands in the file: no plane tells it."""
    mesh = brick((0.2, 0.1, 0.03), (6, 4, 3))
    nodes = mesh.nodes.copy()
    lift = 0.01 * np.cos(np.pi * nodes[:, 0] / 0.2)
    nodes[:, 2] += lift * (nodes[:, 2] + 0.03) / 0.03
    curved = mesh.with_nodes(nodes)
    write_vtk(tmp_path / "sole.vtk", curved)
    found = read_mesh(tmp_path / "sole.vtk")
    np.testing.assert_array_equal(found.fixed, mesh.fixed)
    np.testing.assert_array_equal(found.nodes, nodes)
