"""Mats on scanned bodies: places of cells, and the forces they measure."""

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement.mats import (
    Surface,
    _along,
    _seen,
    _to_segment,
    cell_directions,
    place_cells,
    read_mat_forces,
    read_surface,
)
from drake_exo.measurement.settings import (
    Axes,
    Filter,
    Mat,
    Plates,
    PressureFile,
    Scan,
    TrialFiles,
)

RADIUS, HEIGHT = 0.08, 0.4
CORNERS = (  # a quarter of the front, 0.1 m high, from the left up
    (0.0566, 0.0566, 0.15),
    (0.0566, -0.0566, 0.15),
    (0.0566, -0.0566, 0.25),
    (0.0566, 0.0566, 0.25),
)


def cylinder(num_around=180, num_up=41):
    """Upright tube: x forward, y left, z up [m]."""
    phi = 2 * np.pi * np.arange(num_around) / num_around
    z = np.linspace(0.0, HEIGHT, num_up)
    grid = np.stack(
        [
            np.tile(RADIUS * np.cos(phi), (num_up, 1)),
            np.tile(RADIUS * np.sin(phi), (num_up, 1)),
            np.repeat(z[:, None], num_around, axis=1),
        ],
        axis=2,
    )
    index = np.arange(num_up * num_around).reshape(num_up, num_around)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = np.roll(index, -1, axis=1)[1:], index[1:]
    triangles = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    return grid.reshape(-1, 3), triangles


def write(path, points, triangles, binary=True):
    mesh = meshio.Mesh(points, [("triangle", triangles)])
    # Text takes seconds.
    kind = {"binary": binary} if path.suffix == ".stl" else {}
    meshio.write(path, mesh, **kind)
    return path


def scan(**changes):
    given = {"file": "scan.stl", "unit": "m", "corners": CORNERS}
    return Scan(**{**given, **changes})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stl", "text.stl", "ply", "obj"])
def test_reads_every_format(tmp_path, kind):
    binary = not kind.startswith("text")
    path = write(tmp_path / f"scan.{kind}", *cylinder(), binary)
    surface = read_surface(path, scan())
    points = np.array([[0.2, 0.0, 0.2], [0.0, -0.2, 0.1]])
    on, triangles = surface.closest(points)
    np.testing.assert_allclose(
        on, [[RADIUS, 0.0, 0.2], [0.0, -RADIUS, 0.1]], atol=1e-8
    )
    normals = surface.normals(on, triangles, 0.007)
    np.testing.assert_allclose(
        normals, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], atol=4e-3
    )


def test_a_scan_is_made_a_surface_once_until_it_changes(tmp_path):
    points, triangles = cylinder()
    path = write(tmp_path / "scan.stl", points, triangles)
    surface = read_surface(path, scan())
    # Another mat on it is elsewhere, told in Python by lists.
    other = replace(scan(), corners=[[0.0, 0.0, 0.1]] * 4)
    assert read_surface(path, other) is surface
    write(path, 1.1 * points, triangles)
    on, _ = read_surface(path, scan()).closest(np.array([[0.2, 0.0, 0.2]]))
    np.testing.assert_allclose(on[0, 0], 1.1 * RADIUS, atol=1e-8)


def test_triangles_that_face_inwards_are_turned(tmp_path):
    points, triangles = cylinder()
    path = write(tmp_path / "scan.stl", points, triangles[:, ::-1])
    surface = read_surface(path, scan())
    on, found = surface.closest(np.array([[0.2, 0.0, 0.2]]))
    assert surface.normals(on, found, 0.007)[0, 0] > 0.99


@pytest.mark.parametrize(
    ("bent", "ahead", "refused"),
    [
        (1.5, False, False),  # it bulges
        (1.5, True, True),  # inside out
        (-1.5, False, True),  # a lumbar spine
        (0.0, False, False),
        (0.0, True, False),
    ],
)
def test_no_patch_of_a_back_is_turned(tmp_path, bent, ahead, refused):
    y, z = (0.01 * i.ravel() for i in np.indices((11, 11)))
    x = 0.1 * y + bent * (z - 0.05) ** 2
    i = np.arange(110).reshape(10, 11)[:, :10].ravel()
    triangles = np.concatenate(
        [np.stack(t, 1) for t in ((i, i + 11, i + 12), (i, i + 12, i + 1))]
    )
    if not ahead:
        triangles = triangles[:, ::-1]
    path = tmp_path / "scan.stl"
    write(path, np.column_stack([x, y, z]), triangles)
    if refused:
        with pytest.raises(InputError, match="outer side cannot be told"):
            read_surface(path, scan())
        return
    surface = read_surface(path, scan())
    on, found = surface.closest(np.array([[0.005, 0.05, 0.05]]))
    normal = surface.normals(on, found, 0.007)[0, 0]
    assert abs(normal - (1.0 if ahead else -1.0)) < 0.02


def test_units_and_axes_of_the_scanner(tmp_path):
    """A scan in mm whose y is up and z is to the right."""
    points, triangles = cylinder()
    turned = 1e3 * points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    path = write(tmp_path / "scan.stl", turned, triangles)
    corners = tuple((1e3 * x, 1e3 * z, -1e3 * y) for x, y, z in CORNERS)
    where = scan(unit="mm", axes=Axes("x", "y"), corners=corners)
    surface = read_surface(path, where)
    cells = place_cells(surface, where, 4, 3, tmp_path)
    plain = read_surface(write(tmp_path / "m.stl", points, triangles), scan())
    expected = place_cells(plain, scan(), 4, 3, tmp_path)
    np.testing.assert_allclose(cells, expected, atol=1e-5)


def test_the_nearest_point_of_a_triangle_in_each_of_its_regions():
    """Of corners (0, 0), (2, 0), (0, 1): inside, sides, corners; a line."""
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    wanted = {
        (0.3, 0.2, 0.7): (0.3, 0.2, 0.0),
        (0.5, -0.4, 0.1): (0.5, 0.0, 0.0),
        (-0.3, 0.6, -2.0): (0.0, 0.6, 0.0),
        (2.0, 2.5, 1.0): (1.0, 0.5, 0.0),  # half way between two corners
        (-1.0, -1.0, 0.0): (0.0, 0.0, 0.0),
        (3.0, -0.1, 0.5): (2.0, 0.0, 0.0),
        (-0.5, 2.0, 0.5): (0.0, 1.0, 0.0),
    }
    p, on = (np.array(list(x)) for x in (wanted, wanted.values()))
    one = np.array([[0, 1, 2]])
    for turned in (corners, corners[::-1], corners[[1, 2, 0]]):
        found, _ = Surface(turned, one, "it").closest(p)
        np.testing.assert_allclose(found, on, atol=1e-12)
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    found, _ = Surface(flat, one, "it").closest(np.array([[2.0, 1.0, 1.0]]))
    np.testing.assert_allclose(found, [[2.0, 0.0, 0.0]])


def test_closest_point_agrees_with_brute_force():
    rng = np.random.default_rng(0)
    # One triangle far larger than the others, as scans have them.
    points = np.r_[rng.normal(size=(200, 3)) * 0.1, 5.0 * np.eye(3)]
    triangles = np.r_[rng.integers(0, 200, (60, 3)), [[200, 201, 202]]]
    surface = Surface(points, triangles, "random")
    wanted = rng.normal(size=(20, 3))
    found, _ = surface.closest(wanted)
    u, v = np.meshgrid(*2 * [np.linspace(0, 1, 60)])
    inside = u + v <= 1.0
    u, v = u[inside], v[inside]
    a, b, c = points[triangles].transpose(1, 0, 2)
    some = a[:, None] + u[:, None] * (b - a)[:, None]
    some = (some + v[:, None] * (c - a)[:, None]).reshape(-1, 3)
    for p, on in zip(wanted, found, strict=True):
        sampled = np.linalg.norm(some - p, axis=1).min()
        distance = np.linalg.norm(on - p)
        assert distance <= sampled + 1e-12
        assert distance > sampled - 0.09  # a step on the large one


def test_cells_lie_evenly_around_the_body(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    cells = place_cells(surface, scan(), 5, 8, tmp_path).reshape(5, 8, 3)
    np.testing.assert_allclose(
        np.hypot(cells[..., 0], cells[..., 1]), RADIUS, atol=1e-4
    )
    phi = np.arctan2(cells[..., 1], cells[..., 0])
    share = (np.arange(8) + 0.5) / 8
    expected = np.pi / 4 * (1.0 - 2.0 * share)
    np.testing.assert_allclose(phi, np.tile(expected, (5, 1)), atol=3e-5)
    np.testing.assert_allclose(
        cells[:, 0, 2], 0.15 + 0.1 * (np.arange(5) + 0.5) / 5
    )


def test_cells_may_be_placed_one_by_one(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    rows = ["row,column,x,y,z", "1,2,0.09,0.01,0.2", "1,1,0.09,0,0.2"]
    (tmp_path / "cells.csv").write_text("\n".join(rows))
    where = scan(corners=None, cells="cells.csv")
    cells = place_cells(surface, where, 1, 2, tmp_path)
    np.testing.assert_allclose(cells[0], [RADIUS, 0.0, 0.2], atol=1e-8)
    assert cells[1, 1] > 0.005
    with pytest.raises(InputError, match="each of the 4 cells once"):
        place_cells(surface, where, 2, 2, tmp_path)
    between = "\n".join(rows).replace("1,2,", "1,2.4,")
    (tmp_path / "cells.csv").write_text(between)
    with pytest.raises(InputError, match="each of the 2 cells once"):
        place_cells(surface, where, 1, 2, tmp_path)
    turned = "\n".join(["row,column,z,x,y", *rows[1:]])
    (tmp_path / "cells.csv").write_text(turned)
    with pytest.raises(InputError, match="in the order row, column, x, y, z"):
        place_cells(surface, where, 1, 2, tmp_path)
    (tmp_path / "cells.csv").write_text("\n".join(rows).replace(",", ";"))
    with pytest.raises(InputError, match="csv:1: semicolons separate"):
        place_cells(surface, where, 1, 2, tmp_path)
    (tmp_path / "cells.csv").write_text("row\n\n1,one")
    with pytest.raises(InputError, match="csv:3: has 2 values where 5"):
        place_cells(surface, where, 1, 2, tmp_path)


def test_cells_off_the_body_are_named_with_their_file(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    rows = ["row,column,x,y,z", "1,1,0.09,0,0.2", "1,2,0.5,0.0,0.2"]
    (tmp_path / "cells.csv").write_text("\n".join(rows))
    where = scan(corners=None, cells="cells.csv")
    with pytest.raises(InputError, match=r"/cells\.csv: cell 2 .* 0\.42 m off"):
        place_cells(surface, where, 1, 2, tmp_path)


def test_refuses_a_scan_in_another_unit(tmp_path):
    points, triangles = cylinder()
    path = write(tmp_path / "scan.stl", 1e3 * points, triangles)
    with pytest.raises(InputError, match=r"spans 400 m .* 'unit: mm'"):
        read_surface(path, scan())
    path = write(tmp_path / "scan.stl", points, triangles)
    with pytest.raises(InputError, match=r"spans 0\.4 mm .* 'unit: m'"):
        read_surface(path, scan(unit="mm"))


def test_refuses_files_that_are_no_scan(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_surface(tmp_path / "none.stl", scan())
    with pytest.raises(InputError, match=r"give one of \.stl"):
        read_surface(tmp_path / "scan.step", scan())
    path = tmp_path / "damaged.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(InputError, match="not a readable mesh"):
        read_surface(path, scan())
    path = write(tmp_path / "cut.stl", *cylinder(12, 3))
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(InputError, match=r"cut\.stl: is not a readable mesh"):
        read_surface(path, scan())
    mesh = meshio.Mesh(np.eye(3), [("line", np.array([[0, 1], [1, 2]]))])
    meshio.write(tmp_path / "lines.ply", mesh)
    with pytest.raises(InputError, match=r"lines\.ply: holds no triangles"):
        read_surface(tmp_path / "lines.ply", scan())


def test_refuses_corners_off_the_body(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    far = replace(scan(), corners=((0.5, 0.0, 0.2), *CORNERS[1:]))
    with pytest.raises(InputError, match=r"corner 1 .* lies 0\.42 m off"):
        place_cells(surface, far, 2, 2, tmp_path)


def test_a_mat_is_placed_in_one_way():
    with pytest.raises(InputError, match="either corners or cells"):
        Scan("scan.stl", "m")


FILTER = Filter()
TIME = np.arange(100) / 50.0
# Five rows over 0.1 m, eight columns over a quarter of the circumference.
AREA = 0.1 / 5 * RADIUS * np.pi / 2 / 8
MAT = Mat(
    "shank",
    5,
    8,
    AREA,
    scan=Scan(Path("scan.stl"), "m", corners=CORNERS),
)
FLAT = Mat("pelvis", 2, 3, 2e-4, plane_normal=(-1.0, 0.0, 0.0))
KPA = 20.0


@pytest.fixture
def folder(tmp_path):
    write(tmp_path / "scan.stl", *cylinder())
    return tmp_path


def write_pressure(path, *mats, kpa=KPA):
    """Uniform pressure on every cell of some mats."""
    cells = sum(m.rows * m.columns for m in mats)
    names = [f"c{i + 1}" for i in range(cells)]
    rows = [",".join(["time [s]; kPa", *names])]
    for t in TIME:
        rows.append(",".join([f"{t:g}", *[f"{kpa:g}"] * cells]))
    path.write_text("\n".join(rows) + "\n")


def forces(folder, mats, *names):
    file = PressureFile(Path("p.csv"), names)
    return read_mat_forces((file,), mats, folder, FILTER)


def test_known_load_on_a_curved_surface(folder):
    """p over a quarter of a cylinder: p times its projected area, backwards.

    A chamber at 20 kPa against the front of a shank of 8 cm radius, between
    -45 and 45 degrees and 10 cm high, pushes with p 2 r sin(45) h.
    """
    write_pressure(folder / "p.csv", MAT)
    (found,) = forces(folder, {"front": MAT}, "front")
    mean = np.sin(np.pi / 4.0) / (np.pi / 4.0)
    assert found.report["forward_share"] == pytest.approx(-mean, rel=0.01)
    load = 1e3 * KPA * 2 * RADIUS * np.sin(np.pi / 4) * 0.1
    assert load == pytest.approx(226.3, abs=0.1)
    np.testing.assert_allclose(found.normal, -load, rtol=5e-3)
    np.testing.assert_allclose(found.values[:, 1:], 0.0, atol=1e-9)
    assert found.segment == "shank"
    # Not the plain sum of pressure times area, which is 11 % more.
    assert 1.1 * load < 1e3 * KPA * AREA * 40


def test_a_mat_behind_pushes_forwards(folder):
    behind = tuple((-x, -y, z) for x, y, z in CORNERS)
    mat = replace(MAT, scan=replace(MAT.scan, corners=behind))
    write_pressure(folder / "p.csv", mat)
    (found,) = forces(folder, {"back": mat}, "back")
    assert found.normal.mean() == pytest.approx(226.3, rel=5e-3)


def test_a_segment_that_leant_in_the_scan(folder):
    """Its own axes count: a shank tilted forwards by 30 degrees."""
    points, triangles = cylinder()
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    write(folder / "scan.stl", points @ R.T, triangles)
    corners = tuple(map(tuple, (np.array(CORNERS) @ R.T).tolist()))
    axis = ((0.0, 0.0, 0.0), tuple((R @ [0.0, 0.0, 0.4]).tolist()))
    scan = replace(MAT.scan, corners=corners, segment_axis=axis)
    write_pressure(folder / "p.csv", MAT)
    (leant,) = forces(folder, {"m": replace(MAT, scan=scan)}, "m")
    np.testing.assert_allclose(leant.normal, -226.3, rtol=5e-3)
    np.testing.assert_allclose(leant.values[:, 2], 0.0, atol=1e-5)
    scan = replace(scan, segment_axis=None)
    (upright,) = forces(folder, {"m": replace(MAT, scan=scan)}, "m")
    np.testing.assert_allclose(upright.normal, -226.3 * c, rtol=5e-3)


def test_flat_mat_and_doubling(folder):
    write_pressure(folder / "p.csv", FLAT)
    (both,) = forces(folder, {"m": FLAT}, "m")
    np.testing.assert_allclose(both.normal, 1e3 * KPA * 6 * 2e-4, rtol=1e-9)
    assert "doubled" not in both.report
    one = replace(FLAT, legs="left")
    (doubled,) = forces(folder, {"m": one}, "m")
    np.testing.assert_allclose(doubled.normal, 2.0 * both.normal)
    assert doubled.report["doubled"] == "left leg measured, doubled"
    # Both legs measured stand for themselves, in one file or two.
    legs = {"m": one, "n": replace(FLAT, legs="right")}
    write_pressure(folder / "q.csv", FLAT)
    files = [PressureFile(Path(f"{f}.csv"), (m,)) for f, m in ("pm", "qn")]
    each = read_mat_forces(tuple(files), legs, folder, FILTER)
    for own in each:
        np.testing.assert_allclose(own.normal, both.normal)
        assert "doubled" not in own.report
    # Another segment's leg says nothing of this one.
    apart = legs | {"n": replace(FLAT, legs="right", segment="shank")}
    for own in read_mat_forces(tuple(files), apart, folder, FILTER):
        np.testing.assert_allclose(own.normal, 2.0 * both.normal)


def test_two_mats_in_one_file_keep_their_columns(folder):
    cells = MAT.rows * MAT.columns
    write_pressure(folder / "p.csv", MAT, FLAT)
    lines = (folder / "p.csv").read_text().splitlines()
    body = [
        ",".join([*row.split(",")[: cells + 1], *["0"] * 6])
        for row in lines[1:]
    ]
    (folder / "p.csv").write_text("\n".join([lines[0], *body]) + "\n")
    front, back = forces(folder, {"a": MAT, "b": FLAT}, "a", "b")
    assert front.normal.mean() == pytest.approx(-226.3, rel=5e-3)
    np.testing.assert_allclose(back.normal, 0.0, atol=1e-9)


def write_novel(path, cells, masks=()):
    """Novel's .asc with 20 kPa on every one of some cells, by their numbers."""
    head = [
        "file name:  x.sol\tdate/time  01.01.26",
        "sensor type:  S2140",
        "total time [secs]:  2.0\ttime per frame [secs]:  0.02\t"
        "scanning rate [Hz]:   50",
        "pressure values in  kPa",
        "",
        *masks,
        "\t".join(["time[secs]", *map(str, cells)]),
    ]
    pressed = ["20.000"] * len(cells)
    rows = ["\t".join([f"{t + 0.02:.3f}", *pressed]) for t in TIME]
    path.write_text("\n".join([*head, *rows]) + "\n")


def test_novel_export_without_a_mask(folder):
    write_novel(folder / "p.asc", range(1, 7))
    file = PressureFile(Path("p.asc"), ("m",))
    (found,) = read_mat_forces((file,), {"m": FLAT}, folder, FILTER)
    np.testing.assert_allclose(found.normal, 24.0, rtol=1e-9)
    wrong = replace(FLAT, rows=3)
    with pytest.raises(InputError, match=r"has 6 cells, but .*m 3 x 3.* 9"):
        read_mat_forces((file,), {"m": wrong}, folder, FILTER)


def test_every_mat_of_a_file_counts_once(folder):
    masks = [f"{name}: 1,2,3,4,5,6," for name in ("m", "n")]
    cells = [*range(1, 7)] * 2
    write_novel(folder / "p.asc", cells, ["mask definition:", *masks, ""])

    def read(names, mats):
        file = PressureFile(Path("p.asc"), names)
        return read_mat_forces(
            (file,), dict.fromkeys(mats, FLAT), folder, FILTER
        )

    assert [mat.name for mat in read(("n", "m"), "mn")] == ["n", "m"]
    # One that the study does not know is nobody's.
    (alone,) = read(("m",), "m")
    np.testing.assert_allclose(alone.normal, 24.0, rtol=1e-9)
    with pytest.raises(InputError, match=r"p\.asc: holds the mat n, too"):
        read(("m",), "mn")
    # Of names that the file does not know the order counts, if it can.
    assert [mat.name for mat in read(("o", "n"), "no")] == ["o", "n"]
    with pytest.raises(InputError, match=r"the mats m, n; n is elsewhere in"):
        read(("n", "o"), "no")
    with pytest.raises(InputError, match="names m more than once"):
        PressureFile(Path("p.asc"), ("m", "n", "m"))
    twice = tuple(PressureFile(Path(f), ("m",)) for f in ("p.asc", "q.asc"))
    markers, forces = Path("m.trc"), Path("f.mot")
    with pytest.raises(InputError, match="names m in two files"):
        TrialFiles("one", markers, forces, Plates(both=1), pressure=twice)


def test_refuses_a_matrix_of_the_wrong_size(folder):
    write_pressure(folder / "p.csv", FLAT)
    with pytest.raises(InputError, match=r"p\.csv.* 6 cells.*m 4 x 3"):
        forces(folder, {"m": replace(FLAT, rows=4)}, "m")


def test_refuses_a_mat_that_does_not_fit_its_place(folder):
    with pytest.raises(InputError, match=r"but measure 50\.0 mm"):
        cell_directions(replace(MAT, cell_area_m2=2.5e-3), "m", folder)


def test_refuses_other_kinds_of_files(folder):
    file = PressureFile(Path("p.xls"), ("m",))
    with pytest.raises(InputError, match=r"Novel's \.asc or \.csv"):
        read_mat_forces((file,), {"m": FLAT}, folder, FILTER)


def test_an_axis_needs_two_points(folder):
    point = (0.0, 0.0, 0.1)
    for other in (point, (400.0, 0.0, 0.5)):  # or one of another unit
        scan = replace(MAT.scan, segment_axis=(point, other))
        with pytest.raises(InputError, match="lower and the upper joint"):
            cell_directions(replace(MAT, scan=scan), "m", folder)


def test_an_axis_goes_upwards(folder):
    scan = replace(MAT.scan, segment_axis=((0, 0, 0.4), (0, 0, 0)))
    with pytest.raises(InputError, match=r"0\.4 m below the first"):
        cell_directions(replace(MAT, scan=scan), "m", folder)


def test_a_mat_lies_on_a_scan_or_a_plane():
    with pytest.raises(InputError, match="either scan or plane_normal"):
        Mat("shank", 1, 1, 1e-4)
    with pytest.raises(InputError, match="two different axes"):
        Axes("x", "-x")


def test_saturation_shows_in_the_report(folder):
    write_pressure(folder / "p.csv", FLAT, kpa=200.0)
    (found,) = forces(folder, {"m": FLAT}, "m")
    assert found.report["peak_kpa"] == pytest.approx(200.0)
    assert found.report["at_peak_share"] == 1.0


def test_places_along_a_bent_line():
    line = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 1.0, 0.0]])
    found = _along(line, np.array([0.0, 0.375, 0.75, 0.875, 1.0]))
    wanted = [[0, 0, 0], [1.5, 0, 0], [3, 0, 0], [3, 0.5, 0], [3, 1, 0]]
    np.testing.assert_allclose(found, wanted)
    spot = np.tile([1.0, 2.0, 3.0], (4, 1))
    np.testing.assert_allclose(_along(spot, np.array([0.3])), spot[:1])


def test_a_segments_axes_follow_its_joint_centres():
    """Leaning forward by 3 in 5: z along it, x a quarter turn before."""
    axis = ((10.0, 5.0, 20.0), (310.0, 8.0, 420.0))  # mm
    R = _to_segment(Scan("s.stl", "mm", corners=CORNERS, segment_axis=axis))
    np.testing.assert_allclose(R @ [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(
        R @ [0.8, 0.0, -0.6], [1.0, 0.0, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(R @ [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


def test_saturation_is_told_from_a_peak(folder):
    """Of the loaded readings, those that sit at the largest one."""
    pressure = np.array([[0.0, 1e3, 2e3], [4e3, 4e3, 0.0]])
    assert _seen(pressure) == {"peak_kpa": 4.0, "at_peak_share": 0.5}
    assert _seen(0.0 * pressure) == {"peak_kpa": 0.0, "at_peak_share": 0.0}


@pytest.mark.parametrize(("at_pa", "stuck"), [(8.1e3, True), (7.9e3, False)])
def test_cells_that_stand_still_above_all_others_are_stuck(at_pa, stuck):
    """One at 4 kPa moves; strapped ones at 1 kPa do not, and may."""
    pressure = np.array([[0.0, 1e3, at_pa], [4e3, 1e3, at_pa]])
    assert _seen(pressure).get("stuck_cells") == (1 if stuck else None)
    assert "stuck_cells" not in _seen(pressure[:1])  # all stand still


@pytest.mark.parametrize("side", [0.0795, 0.0805, 2.99, 3.01])
def test_a_body_is_of_8_cm_to_3_m(tmp_path, side):
    points = np.array([[0.0, 0.0, 0.0], [0.01, side, 0.02], [0.0, 0.0, 0.01]])
    path = write(tmp_path / "s.stl", 1e3 * points, [[0, 1, 2]])
    if 0.08 <= side <= 3.0:
        read_surface(path, scan(unit="mm"))
        return
    with pytest.raises(InputError, match=r"spans .* mm in the study's unit"):
        read_surface(path, scan(unit="mm"))


def test_cells_lie_as_far_apart_as_they_are_large(folder):
    """Within half and double; the report says how far."""
    write(folder / "scan.stl", *cylinder(72, 9))
    small = replace(MAT, rows=2, columns=3)
    area = 0.1 / 2 * RADIUS * np.pi / 2 / 3
    _, report = cell_directions(replace(small, cell_area_m2=area), "m", folder)
    pitch = 1e-3 * report["cell_distance_mm"]
    up, around = 0.1 / 2, RADIUS * np.pi / 2 / 3
    # Chords, where cells are large.
    assert pitch == pytest.approx((3 * up + 4 * around) / 7, rel=0.01)
    for times in (0.52, 1.9):
        area = (pitch / times) ** 2
        cell_directions(replace(small, cell_area_m2=area), "m", folder)
    for times in (0.48, 2.1):
        area = (pitch / times) ** 2
        with pytest.raises(InputError, match="mm apart on the scan"):
            cell_directions(replace(small, cell_area_m2=area), "m", folder)


def test_rows_that_are_columns_are_told_by_their_distance(folder):
    """5 rows of 12 on a quarter of the front; corners may be turned, too."""
    write(folder / "scan.stl", *cylinder(72, 9))
    area = 0.1 / 4 * RADIUS * np.pi / 2 / 11
    long = replace(MAT, rows=5, columns=12, cell_area_m2=area)
    cell_directions(long, "m", folder)
    turned = replace(long.scan, corners=(*CORNERS[1:], CORNERS[0]))
    for wrong, words in (
        (replace(long, rows=12, columns=5), r"8\.3 mm .* row to row, 25\.0 mm"),
        (replace(long, scan=turned), r"25\.0 mm .* row to row, 8\.3 mm"),
    ):
        with pytest.raises(InputError, match=f"{words}.* look exchanged"):
            cell_directions(wrong, "m", folder)
    single = replace(MAT, rows=1, columns=5, cell_area_m2=1e-3)
    cell_directions(single, "m", folder)
    alone = replace(single, columns=1)  # which has no neighbour
    inward, report = cell_directions(alone, "m", folder)
    np.testing.assert_allclose(inward, [[-1.0, 0.0, 0.0]], atol=0.05)
    assert report == {"surface": "scan.stl"}
