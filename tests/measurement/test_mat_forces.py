from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_body_surface import CORNERS, RADIUS, cylinder, write

from drake_exo.errors import InputError
from drake_exo.measurement.mats import cell_directions, read_mat_forces
from drake_exo.measurement.settings import (
    Axes,
    Filter,
    Mat,
    PressureFile,
    Scan,
)

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
    load = 1e3 * KPA * 2 * RADIUS * np.sin(np.pi / 4) * 0.1
    assert load == pytest.approx(226.3, abs=0.1)
    np.testing.assert_allclose(found.normal, -load, rtol=5e-3)
    np.testing.assert_allclose(found.force[:, 1:], 0.0, atol=0.5)
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
    np.testing.assert_allclose(leant.force[:, 2], 0.0, atol=0.5)
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


def test_novel_export_without_a_mask(folder):
    head = [
        "file name:  x.sol\tdate/time  01.01.26",
        "sensor type:  S2140",
        "total time [secs]:  2.0\ttime per frame [secs]:  0.02\t"
        "scanning rate [Hz]:   50",
        "pressure values in  kPa",
        "",
        "\t".join(["time[secs]", *map(str, range(1, 7))]),
    ]
    rows = ["\t".join([f"{t + 0.02:.3f}", *["20.000"] * 6]) for t in TIME]
    (folder / "p.asc").write_text("\n".join([*head, *rows]) + "\n")
    file = PressureFile(Path("p.asc"), ("m",))
    (found,) = read_mat_forces((file,), {"m": FLAT}, folder, FILTER)
    np.testing.assert_allclose(found.normal, 24.0, rtol=1e-9)
    wrong = replace(FLAT, rows=3)
    with pytest.raises(InputError, match=r"has 6 cells, but .*m 3 x 3.* 9"):
        read_mat_forces((file,), {"m": wrong}, folder, FILTER)


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
    scan = replace(MAT.scan, segment_axis=(point, point))
    with pytest.raises(InputError, match="lower and the upper joint"):
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
