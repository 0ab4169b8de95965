from dataclasses import replace

import meshio
import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement.mats import Surface, place_cells, read_surface
from drake_exo.measurement.settings import Axes, Scan

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


def write(path, points, triangles):
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]))
    return path


def scan(**changes):
    given = {"file": "scan.stl", "unit": "m", "corners": CORNERS}
    return Scan(**{**given, **changes})


@pytest.mark.parametrize("kind", ["stl", "ply", "obj"])
def test_reads_every_format(tmp_path, kind):
    path = write(tmp_path / f"scan.{kind}", *cylinder())
    surface = read_surface(path, scan())
    points = np.array([[0.2, 0.0, 0.2], [0.0, -0.2, 0.1]])
    on, triangles = surface.closest(points)
    np.testing.assert_allclose(
        on, [[RADIUS, 0.0, 0.2], [0.0, -RADIUS, 0.1]], atol=1e-4
    )
    normals = surface.normals(on, triangles, 0.007)
    np.testing.assert_allclose(
        normals, [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], atol=0.02
    )


def test_triangles_that_face_inwards_are_turned(tmp_path):
    points, triangles = cylinder()
    path = write(tmp_path / "scan.stl", points, triangles[:, ::-1])
    surface = read_surface(path, scan())
    on, found = surface.closest(np.array([[0.2, 0.0, 0.2]]))
    assert surface.normals(on, found, 0.007)[0, 0] > 0.99


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


def test_closest_point_agrees_with_brute_force():
    rng = np.random.default_rng(0)
    # One triangle far larger than the others, as scans have them.
    points = np.r_[rng.normal(size=(200, 3)) * 0.1, 5.0 * np.eye(3)]
    triangles = np.r_[rng.integers(0, 200, (300, 3)), [[200, 201, 202]]]
    surface = Surface(points, triangles, "random")
    wanted = rng.normal(size=(40, 3))
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
    np.testing.assert_allclose(phi, np.tile(expected, (5, 1)), atol=0.01)
    np.testing.assert_allclose(
        cells[:, 0, 2], 0.15 + 0.1 * (np.arange(5) + 0.5) / 5, atol=1e-4
    )


def test_cells_may_be_placed_one_by_one(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    rows = ["row,column,x,y,z", "1,2,0.09,0.01,0.2", "1,1,0.09,0,0.2"]
    (tmp_path / "cells.csv").write_text("\n".join(rows))
    where = scan(corners=None, cells="cells.csv")
    cells = place_cells(surface, where, 1, 2, tmp_path)
    np.testing.assert_allclose(cells[0], [RADIUS, 0.0, 0.2], atol=1e-4)
    assert cells[1, 1] > 0.005
    with pytest.raises(InputError, match="each of the 4 cells once"):
        place_cells(surface, where, 2, 2, tmp_path)
    (tmp_path / "cells.csv").write_text("row\n1,one")
    with pytest.raises(InputError, match="has 2 values where 5"):
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
    with pytest.raises(InputError, match=r"cut\.stl"):
        read_surface(path, scan())
    mesh = meshio.Mesh(np.eye(3), [("line", np.array([[0, 1], [1, 2]]))])
    meshio.write(tmp_path / "lines.ply", mesh)
    with pytest.raises(InputError, match=r"lines\.ply"):
        read_surface(tmp_path / "lines.ply", scan())


def test_refuses_corners_off_the_body(tmp_path):
    surface = read_surface(write(tmp_path / "s.stl", *cylinder()), scan())
    far = replace(scan(), corners=((0.5, 0.0, 0.2), *CORNERS[1:]))
    with pytest.raises(InputError, match=r"corner 1 .* lies 0\.42 m off"):
        place_cells(surface, far, 2, 2, tmp_path)


def test_a_mat_is_placed_in_one_way():
    with pytest.raises(InputError, match="either corners or cells"):
        Scan("scan.stl", "m")
