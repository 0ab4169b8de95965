"""From a closed surface to a sole: closed forms, units, faults by name."""

import meshio
import numpy as np
import pytest
from manifold3d import Manifold
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shoe import shoe_surface

import drake_exo.soles.surface as module
from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.soles import surface
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.mesh import (
    brick,
    corners_of,
    normals_of,
    write_triangles,
)
from drake_exo.soles.results import step_checks
from drake_exo.soles.surface import (
    MmgError,
    Surface,
    _lost,
    _nearest,
    _sharp,
    _Thickness,
    _top_faces,
    read_surface,
    sole_from_surface,
)

SIZE = (0.2, 0.08, 0.03)


def _obj(path, corners, scale=1.0):
    points = corners.reshape(-1, 3) * scale
    faces = np.arange(len(points)).reshape(-1, 3)
    meshio.Mesh(points, [("triangle", faces)]).write(path)


def _brick_surface():
    mesh = brick(SIZE, (4, 3, 2))
    return mesh.nodes[mesh.boundary_faces]


@pytest.mark.parametrize(
    ("scale", "unit"), [(1000.0, None), (1.0, None), (100.0, "cm")]
)
def test_lengths_are_metres_whatever_the_file_s_unit(tmp_path, scale, unit):
    path = tmp_path / "sole.obj"
    _obj(path, _brick_surface(), scale)
    surface = read_surface(path, unit)
    extent = np.ptp(surface.corners, axis=(0, 1))
    np.testing.assert_allclose(extent, SIZE, rtol=1e-6)
    assert surface.volume == pytest.approx(np.prod(SIZE), rel=1e-5)


def test_corners_a_rounding_apart_are_one(tmp_path):
    """Where a program writes each triangle's by itself, in single precision."""
    path, corners = tmp_path / "sole.stl", _brick_surface()
    off = np.random.default_rng(0).normal(0, 2e-8, corners.shape)
    write_triangles(path, corners + off)
    surface = read_surface(path)
    assert len(np.unique(surface.corners.reshape(-1, 3), axis=0)) == len(
        np.unique(corners.reshape(-1, 3), axis=0)
    )
    assert surface.volume == pytest.approx(np.prod(SIZE), rel=1e-5)


def test_triangles_that_look_inwards_are_turned(tmp_path):
    path = tmp_path / "sole.obj"
    _obj(path, _brick_surface()[:, ::-1])
    assert read_surface(path).volume == pytest.approx(np.prod(SIZE), rel=1e-5)


def _without_one(corners):
    return corners[1:]


def _one_turned(corners):
    return np.concatenate([corners[:1, ::-1], corners[1:]])


def _in_centimetres(corners):
    return 100 * corners


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (_without_one, "not closed: 3 edges are open"),
        (_one_turned, "turned against each other"),
        (_in_centimetres, "give mesh.unit"),
    ],
)
def test_a_surface_that_is_none_is_named(tmp_path, fault, sentence):
    path = tmp_path / "sole.obj"
    _obj(path, fault(_brick_surface()))
    with pytest.raises(InputError, match=sentence):
        read_surface(path)


@pytest.mark.parametrize("scale", [(1, 1, 0), (1, 0, 0), (1, 1, 1e-6)])
def test_a_sheet_is_no_sole(tmp_path, scale):
    path = tmp_path / "sheet.obj"
    _obj(path, _brick_surface() * scale)
    with pytest.raises(InputError, match="no volume; export a solid"):
        read_surface(path)


def test_a_surface_too_narrow_for_a_sole(tmp_path):
    path = tmp_path / "blade.obj"
    _obj(path, _brick_surface() * (1, 0.001, 1))
    with pytest.raises(InputError, match=r"nothing that is 1\.7 mm wide"):
        sole_from_surface(read_surface(path))


def test_nearest_points_of_a_sphere():
    """Against the radius: the sphere's triangles are close to it."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 60), np.linspace(0, 2 * np.pi, 90))
    at = np.stack(
        [np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1
    )
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    corners = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, 3),
         np.stack([a, c, d], 2).reshape(-1, 3, 3)]
    )  # fmt: skip
    points = np.random.default_rng(0).standard_normal((200, 3))
    points *= np.random.default_rng(1).uniform(0.5, 2, (200, 1))
    near, _, _ = _nearest(corners, points)
    assert _nearest(corners, points[:0])[0].shape == (0, 3)
    aim = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.abs(near - aim).max() < 0.08
    away = np.linalg.norm(near - points, axis=1)
    exact = np.abs(np.linalg.norm(points, axis=1) - 1)
    np.testing.assert_allclose(away, exact, atol=2e-3)


@pytest.mark.slow
def test_thickness_of_a_shoe():
    thickness = _Thickness(shoe_surface())
    places = np.array([[-0.095, 0.0, -0.01], [0.12, 0.0, -0.01]])
    np.testing.assert_allclose(thickness.at(places), [0.03, 0.0154], rtol=0.06)
    inside = thickness.inside(
        np.array([[-0.1, 0, -0.02], [-0.1, 0, -0.04], [0, 0.2, -0.01]]), 0.0
    )
    assert inside.tolist() == [True, False, False]


@pytest.fixture(scope="module")
def shoe():
    surface = Surface(shoe_surface(), "shoe")
    return surface, sole_from_surface(surface, 3000)


@pytest.mark.slow
def test_a_shoe_is_meshed(shoe):
    surface, mesh = shoe
    assert 1800 < len(mesh.tets) < 4500
    assert mesh.volume == pytest.approx(surface.volume, rel=0.03)
    assert np.percentile(mesh.quality(), 1) > 0.2
    top = mesh.nodes[mesh.fixed]
    assert np.ptp(top[:, 2]) < 1e-12 and top[0, 2] == pytest.approx(0.0)
    faces = mesh.boundary_faces[np.isin(mesh.boundary_faces, mesh.fixed).all(1)]
    a, b, c = np.swapaxes(mesh.nodes[faces], 0, 1)
    area = 0.5 * np.cross(b - a, c - a)[:, 2].sum()
    flat = surface.corners[(np.abs(surface.corners[:, :, 2]) < 1e-12).all(1)]
    a, b, c = np.swapaxes(flat, 0, 1)
    wanted = 0.5 * np.cross(b - a, c - a)[:, 2].sum()
    assert area == pytest.approx(wanted, rel=0.02)
    assert mesh.lost < 0.004


def test_how_much_of_a_surface_a_mesh_does_not_follow():
    """Grooves of 3 by 12 mm in a block whose elements are larger."""
    mesh = brick(SIZE, (8, 4, 2))
    assert _lost(mesh.nodes[mesh.boundary_faces], mesh) == 0
    grooved = corners_of(_grooved(0.003, 0.012))
    area = np.linalg.norm(normals_of(grooved), axis=1).sum() / 2
    near = 0.5 * np.cbrt(np.prod(SIZE) / len(mesh.tets))
    lost = 9 * (SIZE[1] - 2 * near) * (0.003 + 2 * (0.012 - near))
    assert _lost(grooved, mesh) == pytest.approx(lost / area, rel=0.05)


def _grooved(width, depth):
    body = Manifold.cube(SIZE).translate((-0.1, -0.04, -SIZE[2]))
    for place in np.linspace(-0.08, 0.08, 9):
        groove = Manifold.cube((width, 0.1, 2 * depth), center=True)
        body -= groove.translate((place, 0, -SIZE[2]))
    return body


@pytest.mark.slow
def test_a_case_whose_grooves_are_lost_says_so(tmp_path):
    write_triangles(tmp_path / "sole.stl", corners_of(_grooved(0.002, 0.006)))
    text = EXAMPLE.replace(
        "brick: {size_m: [0.23, 0.13, 0.03], divisions: [4, 3, 2]}",
        "file: sole.stl\n  tets: 500",
    )
    checks = step_checks(Case.from_text(text, tmp_path).simulate())
    (told,) = [c for c in checks if c.name == "plausibility.surface"]
    assert not told.holds and told.level == "note" and told.value > 0.05


@pytest.mark.slow
def test_thick_parts_have_larger_elements():
    """A wedge from 15 to 45 mm."""
    mesh = brick((0.25, 0.1, 0.03), (4, 2, 1))
    nodes = mesh.nodes * 1.0
    nodes[:, 2] *= 1.0 + nodes[:, 0] / 0.25
    surface = Surface(nodes[mesh.boundary_faces], "wedge")
    mesh = sole_from_surface(surface, 3000)
    x = mesh.nodes[mesh.tets].mean(axis=1)[:, 0]
    assert mesh.volume == pytest.approx(surface.volume, rel=2e-3)
    thin, thick = mesh.volumes[x < -0.05], mesh.volumes[x > 0.05]
    assert np.mean(thick) > 2 * np.mean(thin)


@pytest.mark.slow
def test_an_element_that_is_in_the_way_holds_its_own_nodes_back_alone():
    """Of a fine mesh all but a few nodes of the skin lie on the surface."""
    surface = Surface(shoe_surface(), "shoe")
    mesh = sole_from_surface(surface, 6000)
    flat = surface.corners[(np.abs(surface.corners[:, :, 2]) < 1e-12).all(1)]
    top = flat.reshape(-1, 3)
    middle = 0.5 * (top.min(axis=0) + top.max(axis=0))
    skin = mesh.nodes[np.unique(mesh.boundary_faces)] + middle
    on, _, _ = _nearest(surface.corners, skin)
    away = np.linalg.norm(on - skin, axis=1)
    assert np.mean(away > 1e-5) < 0.1
    assert np.mean(away > 1e-4) < 0.02


def _box(size) -> np.ndarray:
    """Outward triangles of a box below z = 0, two a side, (12, 3, 3)."""
    mesh = brick(size, (1, 1, 1))
    return mesh.nodes[mesh.boundary_faces]


def _spiked(box) -> np.ndarray:
    """With a spike of 0.1 mm on its top, as a scan has them."""
    top = np.flatnonzero((box[..., 2] == 0).all(axis=1))[0]
    A, B, C = box[top]
    a, b, c = (0.9999 * box[top].mean(axis=0) + 1e-4 * p for p in (A, B, C))
    tip = (a + b + c) / 3 + [0.0, 0.0, 1e-4]
    ring = [[A, B, b], [A, b, a], [B, C, c], [B, c, b], [C, A, a], [C, a, c]]
    spike = [[a, b, tip], [b, c, tip], [c, a, tip]]
    return np.concatenate([np.delete(box, top, axis=0), ring, spike])


def test_sharp_edges_of_a_box():
    """Turned and cut anew it has the same, and a little ball has none."""
    box = _box((0.25, 0.1, 0.03))
    turned = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    for corners in (box, box[::-1], box @ turned.T):
        patch, ends, points = _sharp(corners, 0.01)
        assert len(ends) == 12 and len(points) == 8
        sides = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        np.testing.assert_allclose(
            np.sort(sides), [0.03] * 4 + [0.1] * 4 + [0.25] * 4
        )
        # The largest first.
        area = np.linalg.norm(normals_of(corners), axis=1) / 2
        of = np.bincount(patch, area)
        assert len(of) == 6 and (np.diff(of) < 1e-12).all()
    # Of sides that are small beside an element none counts.
    patch, ends, points = _sharp(box, 0.03)
    assert (patch == -1).sum() == 4 and len(ends) == 4 and not len(points)


@pytest.mark.slow
@pytest.mark.parametrize(("tets", "scanned"), [(1000, True), (2500, False)])
def test_a_box_keeps_its_edges(tets, scanned):
    size = np.array([0.25, 0.1, 0.03])
    box = _box(size)
    mesh = sole_from_surface(
        Surface(_spiked(box) if scanned else box, ""), tets
    )
    assert mesh.volume == pytest.approx(size.prod(), rel=2e-3)
    assert mesh.undercut < 0.005
    assert np.percentile(mesh.quality(), 1) > 0.28
    normal, area = mesh.areas(mesh.contact_faces)
    slant = np.abs(normal / area[:, None]).max(axis=1) < 0.995
    assert area[slant].sum() < 0.025 * area.sum()
    corner = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * size / 2
    corner[:, 2] -= size[2] / 2
    away, _ = cKDTree(mesh.nodes).query(corner)
    assert (away < 1e-3).sum() >= 7


@pytest.mark.slow
@pytest.mark.parametrize("tets", [700, 3000])
def test_a_box_stands_on_all_of_its_bottom(tets):
    """No node is below it, and the sides are plane."""
    size = np.array([0.25, 0.1, 0.03])
    mesh = sole_from_surface(Surface(_box(size), ""), tets)
    np.testing.assert_allclose(np.ptp(mesh.nodes, axis=0), size, atol=1e-5)
    skin = mesh.nodes[np.unique(mesh.boundary_faces)]
    assert _nearest(_box(size), skin)[2].max() < 2e-4


def test_a_top_that_is_nearly_flat_is_glued_whole(monkeypatch):
    box = _spiked(_box(np.array([0.25, 0.1, 0.03])))
    off = 4e-4 * np.where(box[..., 2] < 0, 0, box[..., 0])
    nearly = Surface(box + np.dstack([0 * off, 0 * off, off]), "")

    def meshed(thickness, top, *_):
        corners = thickness.corners
        assert np.ptp(corners[top][..., 2]) == 0
        assert (corners[~top][..., 2].min(axis=1) < -0.02).all()
        volume = np.linalg.det(corners).sum() / 6
        assert volume == pytest.approx(7.5e-4)
        raise MmgError("seen")

    monkeypatch.setattr(surface, "_meshed", meshed)
    with pytest.raises(InputError, match="seen"):
        sole_from_surface(nearly)


@pytest.mark.slow
def test_what_ends_mmg_is_told(monkeypatch):
    """Its own words, or how its process ended, which is not begun again."""
    flat = {"nodes": np.zeros((4, 3)), "tets": np.arange(4)[None]}
    with pytest.raises(MmgError, match=r"^Mmg: \w"):
        surface.run_mmg(flat | {"size": np.ones(4)})
    job = surface.Job
    monkeypatch.setattr(surface, "Job", lambda name, *_: job(name, "os:abort"))
    with pytest.raises(MmgError, match=r"^Mmg ended with code -6$"):
        surface.run_mmg(flat)


def _words(key, rows, form="{:g}"):
    return "".join(
        f"{key} {' '.join(form.format(x) for x in row)}\n" for row in rows
    )


def test_an_obj_of_any_modeller_is_read(tmp_path):
    """Normals, textures, colours, groups, quads, concave ends, free forms."""
    path = tmp_path / "sole.obj"
    # A U, seen from above, of 180 mm by 60 less 120 by 40; 20 high.
    outline = np.array([[0, 0], [180, 0], [180, 60], [150, 60], [150, 20],
                        [30, 20], [30, 60], [0, 60]])  # fmt: skip
    n, i = len(outline), np.arange(1, len(outline) + 1)
    places = [(*p, z) for z in (-20, 0) for p in outline]
    quads = np.stack([i, i % n + 1, i % n + 1 + n, i + n], axis=1)
    volume = 1e-9 * 20 * (180 * 60 - 120 * 40)

    def read(text):
        path.write_bytes(text.encode("latin-1"))
        return read_surface(path).volume

    for end in (0, 1, 5):  # a concave polygon from any corner on
        ends = np.roll([i[::-1], i + n], end, axis=1)
        plain = _words("v", places) + _words("f", ends) + _words("f", quads)
        assert read(plain) == pytest.approx(volume, rel=1e-9)
        turned = np.roll(places, end, axis=1)
        found = read(_words("v", turned) + plain[plain.index("f") :])
        assert found == pytest.approx(volume, rel=1e-9)
    head = "# gr\xf6\xdfe\nmtllib a.mtl\no Sole\n"
    more = "vt 0 0\nvn 0 0 1\ng tread\nusemtl rubber\ns 1\n"
    behind = _words("f", [*(ends - 2 * n - 1), *(quads - 2 * n - 1)])
    colours = _words("v", [(*p, 1, 0, 0) for p in places])
    free = "cstype bspline\ndeg 2\ncurv 0 1 1 2 3\nparm u 0 1\nend\nl 1 2\n"
    faces = [*ends, *quads]
    for text in (
        head + plain + free,
        colours + more + _words("f", faces, "{}/1/1"),
        colours + more + _words("f", faces, "{}//1"),
        _words("v", places) + behind,
        plain.replace("f 1 2", "f 1 \\\n 2").replace("\n", " # x\r\n", 1),
    ):
        assert read(text) == pytest.approx(volume, rel=1e-9)
    for wrong in ("f 0 1 2", "f 1 2 99", "f -1 -2 -99"):
        said = "a face names a node that is not there"
        with pytest.raises(
            InputError, match=rf"sole\.obj: .*{said}.* as STL or OBJ$"
        ):
            read(plain + wrong)


def test_an_stl_of_any_program_is_read(tmp_path):
    """What a header says of a binary file, names and ends of lines of text."""
    path, corners = tmp_path / "sole.stl", _brick_surface()
    write_triangles(path, corners)
    plain = path.read_bytes()
    text = "solid S\xf6hle\n" + "".join(
        "facet normal 0 0 0\nouter loop\n" + _words("vertex", triangle)
        + "endloop\nendfacet\n"
        for triangle in 1e3 * corners
    )  # fmt: skip
    text += "endsolid\n"

    def read(data):
        path.write_bytes(data)
        return read_surface(path).volume

    for data in (
        b"solid of a CAD\n".ljust(80) + plain[80:],
        plain + bytes(20),
        text.encode("latin-1"),
        text.upper().replace("\n", "\r").encode("latin-1"),
        text.replace(
            "endfacet\n", "endfacet\nendsolid\n\nsolid b\n", 1
        ).encode(),
    ):
        assert read(data) == pytest.approx(np.prod(SIZE), rel=1e-5)
    count = len(corners)
    for data, said in (
        (
            plain[:-50],
            f"{count - 1} triangles follow a header that says {count}",
        ),
        (plain[:80] + plain[83:79:-1] + plain[84:], "header that says"),
        (text[: text.rindex("vertex")].encode(), "last triangle is cut off"),
        (text.replace(".", ",").encode(), "could not convert"),
    ):
        with pytest.raises(InputError, match=rf"sole\.stl: .*{said}.* as STL"):
            read(data)


@pytest.mark.parametrize("axes", [[1, 0, 2], [2, 1, 0]])
def test_a_sole_that_is_not_long_along_x_is_refused(axes):
    """Its walk would go sideways, or it would stand on its toe."""
    surface = Surface(_box(SIZE)[:, ::-1, axes], "turned.stl")
    with pytest.raises(InputError, match=r"turned\.stl: .* 200 .*; turn it$"):
        sole_from_surface(surface)


def test_parts_that_overlap_are_one(tmp_path):
    """Lugs sunk into a sole, a part within it; a hollow stays one."""
    path, sole = tmp_path / "tread.stl", _box(SIZE)
    lug = _box((0.02, 0.02, 0.02))
    inner = _box((0.05, 0.04, 0.01)) - [0.0, 0.0, 0.01]

    def volume(*parts):
        write_triangles(path, np.concatenate([sole, *parts]))
        return 1e6 * read_surface(path).volume

    lugs = [lug + np.array([x, 0.0, -0.02]) for x in (-0.06, 0.0, 0.09)]
    # Each stands out by 10 mm; of the last one half, over the sole's end.
    assert volume(*lugs) == pytest.approx(480.0 + 3 * 4.0)
    lugs[-1] += [0.01, 0.0, 0.0]
    assert volume(*lugs) == pytest.approx(480.0 + 3 * 4.0 + 2.0)
    assert volume(inner) == pytest.approx(480.0)
    assert volume(inner[:, ::-1]) == pytest.approx(460.0)
    assert volume(inner[:, ::-1], lugs[0]) == pytest.approx(464.0)
    # Neither outside of all parts, nor with another part in it.
    post = _box((0.01, 0.01, 0.02)) - [0.0, 0.0, 0.005]
    for parts in ([lugs[0][:, ::-1]], [inner[:, ::-1], post]):
        with pytest.raises(InputError, match=r"tread\.stl: a part .* not a ho"):
            volume(*parts)


def _mirrored(corners):
    """A box whose faces are cut along their other diagonals."""
    return corners[:, ::-1] * [-1.0, 1.0, 1.0]


@pytest.mark.parametrize("shuffled", [False, True])
@pytest.mark.parametrize("other", [_mirrored, lambda corners: corners])
def test_parts_that_touch_are_one(tmp_path, other, shuffled):
    """A midsole, an outsole of its outline and a heel that stands on it."""
    path, sole = tmp_path / "layers.stl", _box(SIZE)
    x, y, z = SIZE
    outsole = other(sole) - [0.0, 0.0, z]
    heel = other(_box((x / 4, y, z))) - [3 * x / 8, 0.0, 2 * z]
    parts = np.concatenate([sole, outsole, heel])
    if shuffled:
        parts = np.random.default_rng(0).permutation(parts)
    write_triangles(path, parts)
    surface = read_surface(path)
    assert surface.volume == pytest.approx(2.25 * np.prod(SIZE), rel=1e-6)
    area = 0.5 * np.linalg.norm(
        np.cross(*np.diff(surface.corners, axis=1).swapaxes(0, 1)), axis=1
    )
    outside = 2 * (x * y + (x + y) * 2 * z + (x / 4 + y) * z)
    assert area.sum() == pytest.approx(outside, rel=1e-6)


def test_parts_that_touch_along_an_edge_stay_two(tmp_path):
    path, sole = tmp_path / "steps.stl", _box(SIZE)
    lower = sole + np.array([SIZE[0], 0.0, -SIZE[2]])
    for parts in ((sole, lower), (lower[:, ::-1], sole[:, ::-1])):
        write_triangles(path, np.concatenate(parts))
        surface = read_surface(path)
        assert surface.volume == pytest.approx(2 * np.prod(SIZE), rel=1e-6)
        assert len(surface.corners) == 2 * len(sole)


@pytest.mark.slow
def test_a_top_that_is_not_flat_is_asked_for_and_taken():
    corners = shoe_surface(60, 10)
    corners[..., 2] += 4 * corners[..., 1] ** 2  # a cup for the foot
    surface = Surface(corners, "cup")
    with pytest.raises(InputError, match="top_m"):
        sole_from_surface(surface)
    mesh = sole_from_surface(surface, 3000, top_m=-0.004)
    assert mesh.volume == pytest.approx(surface.volume, rel=0.05)
    top = surface.corners[_top_faces(surface, -0.004)]
    low, high = top.reshape(-1, 3).min(axis=0), top.reshape(-1, 3).max(axis=0)
    fixed = mesh.nodes[mesh.fixed] + [*(low + high)[:2] / 2, high[2]]
    on, _, _ = _nearest(top, fixed)
    away = np.linalg.norm(on - fixed, axis=1)
    assert np.median(away) < 1e-6 and away.max() < 1e-3
    assert np.ptp(fixed[:, 0]) > 0.25


@pytest.mark.parametrize("top_m", [-5.0, 0.01])
def test_a_top_that_is_elsewhere_is_refused(top_m):
    """Given in millimetres, say: all that looks upwards were the foot's."""
    surface = Surface(_box(SIZE), "box")
    with pytest.raises(InputError, match="it reaches from"):
        sole_from_surface(surface, top_m=top_m)


@pytest.mark.parametrize(("height", "kept"), [(0.0, 1), (0.05, 0)])
def test_a_surface_whose_top_is_at_zero_keeps_its_frame(
    height, kept, monkeypatch
):
    """At the ankle, say; of another height it is put in the top's middle."""
    meshed = []

    def without_mmg(thickness, *_):
        meshed.append(thickness.corners)
        raise MmgError("that is all")

    monkeypatch.setattr(module, "_meshed", without_mmg)
    off = np.array([0.03, 0.01, height])
    with pytest.raises(InputError, match="that is all"):
        sole_from_surface(Surface(_brick_surface() + off, "it"))
    low, high = (f(meshed[0].reshape(-1, 3), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose((low + high)[:2] / 2, kept * off[:2])
    assert high[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_an_stl_is_simulated_by_one_command(tmp_path):
    """Of a shoe alone it is known who walks on it: the ZMP stays on it."""
    case = EXAMPLE[: EXAMPLE.index("load")]
    walk = "load: {pattern: {mass_kg: 70, period_s: 0.05}}\n"
    (tmp_path / "case.yaml").write_text(case + walk)
    path = tmp_path / "shoe.stl"
    write_triangles(path, shoe_surface())
    out = tmp_path / "out"
    code = cli.main(
        ["sole", "simulate", str(tmp_path / "case.yaml"), "--mesh", str(path),
         "--out", str(out)]
    )  # fmt: skip
    assert code == 0
    assert (out / "summary.json").is_file()


def test_a_sole_s_own_stl_is_closed(tmp_path):
    path = tmp_path / "sole.stl"
    mesh = brick(SIZE, (4, 3, 2))
    write_triangles(path, mesh.nodes[mesh.boundary_faces])
    assert read_surface(path).volume == pytest.approx(mesh.volume, rel=1e-5)
