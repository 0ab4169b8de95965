"""What `drake-exo inspect` says of each format, and of a bad file."""

import os
from dataclasses import replace
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.files.c3d import write_c3d
from drake_exo.files.inspection import inspect
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.tables import (
    MarkerData,
    PlateRecording,
    Table,
    write_csv_table,
)

TIME = np.arange(200) / 100.0


@pytest.fixture
def markers():
    p = np.tile([[0.1, 0.2, 0.3], [1.0, 1.1, 1.2]], (200, 1, 1))
    p[50:60, 1] = np.nan
    p[-3:, 1] = np.nan
    return MarkerData(TIME, ("A", "B"), p, 100.0)


def test_markers_and_their_gaps(tmp_path, markers):
    write_trc(tmp_path / "a.trc", markers)
    found = inspect(tmp_path / "a.trc")
    assert "2 markers, positions in m, 100 Hz, 0 to 1.99 s, 200" in found
    assert "  A: around (0.100, 0.200, 0.300) m\n" in found
    assert "  B: around (1.000, 1.100, 1.200) m; not seen in 13 frames: " in (
        found
    )
    assert "0.5 to 0.59, 1.97 to 1.99 s" in found


def test_a_gap_of_one_frame_is_one_time(tmp_path, markers):
    markers.positions[7, 0] = np.nan
    write_trc(tmp_path / "a.trc", markers)
    assert "m; not seen in 1 frame: 0.07 s\n" in inspect(tmp_path / "a.trc")


def test_hidden_markers_may_be_written_as_zeros(tmp_path, markers):
    markers.positions[:5, 0] = 0.0
    write_trc(tmp_path / "a.trc", markers)
    assert "m; not seen in 5 frames: 0 to 0.04 s\n" in inspect(
        tmp_path / "a.trc"
    )


def plate(number, force_z):
    force = np.zeros((len(force_z), 3))
    force[:, 2] = force_z
    rest = np.zeros_like(force)
    return PlateRecording(number, force, rest, rest)


@pytest.mark.slow
def test_c3d_markers_plates_and_channels(tmp_path, markers):
    load = np.where(TIME < 1.0, 0.0, 600.0)
    square = [[0.3, 0.3, 0], [-0.3, 0.3, 0], [-0.3, -0.3, 0], [0.3, -0.3, 0]]
    write_c3d(
        tmp_path / "a.c3d",
        markers,
        [plate(1, load), plate(2, 0.0 * load)],
        [np.array(square)] * 2,
    )
    found = inspect(tmp_path / "a.c3d")
    assert "2 markers" in found and "not seen in 13 frames" in found
    assert "2 force plates, 100 Hz" in found
    assert "plate 1: loaded 50 % of the time, 1 to 1.99 s; up to 600 N" in found
    assert "mostly along z (600 N)" in found
    assert "plate 2: never above 20 N" in found
    assert "12 channels" in found and "Fz_1: " in found
    write_c3d(
        tmp_path / "one.c3d",
        replace(
            markers, names=("a",), positions=markers.positions[:, :1] + 1.0
        ),
        [plate(1, load)],
        [np.array(square)],
    )
    found = inspect(tmp_path / "one.c3d")
    assert "\n1 marker, positions" in found
    assert "\n1 force plate, 100 Hz" in found


def test_tables_say_their_unit_of_angles(tmp_path):
    values = np.column_stack([np.linspace(0, 90, 200), np.full(200, 5.0)])
    table = Table(TIME, ("knee", "hip"), values, True)
    write_table(tmp_path / "a.mot", table)
    found = inspect(tmp_path / "a.mot")
    assert (
        "2 channels, angles in degrees, else in SI units, 100 Hz, 0 to 1.99 s"
        in found
    )
    assert "knee: 0 to 90" in found and "hip: 5 throughout" in found
    names = [f"ground_force_1_{k}{a}" for k in "vp" for a in "xyz"]
    force = np.zeros((200, 6))
    force[:, 1] = 700.0
    write_table(tmp_path / "b.sto", Table(TIME, tuple(names), force, False))
    assert "mostly along y (700 N)" in inspect(tmp_path / "b.sto")


def test_what_truly_happened_is_no_file_of_plates(tmp_path):
    """Its forces are planar: ground_force_x, ground_force_z."""
    names = ("ground_force_x", "ground_force_z", "ground_moment_y")
    write_table(tmp_path / "a.sto", Table(TIME, names, np.ones((200, 3))))
    assert "  ground_force_z: 1 throughout" in inspect(tmp_path / "a.sto")


def test_csv_of_signals_and_of_pressure(tmp_path):
    table = Table(TIME, ("exo_knee",), TIME[:, None], False)
    write_csv_table(tmp_path / "a.csv", table, ["deg"])
    assert "exo_knee: 0 to 1.99" in inspect(tmp_path / "a.csv")
    rows = ["time [s]; kPa,1,2,3"]
    rows += [f"{t:g},0,{10 * t:g},0" for t in TIME]
    (tmp_path / "p.csv").write_text("\n".join(rows) + "\n")
    found = inspect(tmp_path / "p.csv")
    assert "cells: 3 cells, up to 19.9 kPa, 1 of them pressed" in found
    (tmp_path / "a.csv").write_text("time [s];exo_knee [deg]\n0,0;1\n0,1;2\n")
    with pytest.raises(InputError, match="semicolons separate the columns"):
        inspect(tmp_path / "a.csv")
    rows = ["Row,Column,X,Y,Z", "1,1,20.5,75,703", "1,2,21,75,717"]
    (tmp_path / "cells.csv").write_text("\n".join(rows) + "\n")
    found = inspect(tmp_path / "cells.csv")
    assert "1 by 2 cells of a mat, in the scan's unit" in found
    assert "z: 703 to 717" in found
    (tmp_path / "cells.csv").write_text("row,column,x,y,z\n1,1,a,2,3\n")
    with pytest.raises(InputError, match=r"cells\.csv:2: holds text among"):
        inspect(tmp_path / "cells.csv")
    rows[0] = '"row","column","x","y","z"'
    (tmp_path / "cells.csv").write_text("\n".join(rows) + "\n")
    assert inspect(tmp_path / "cells.csv") == found


def test_numbered_channels_that_are_no_plates_are_channels(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],imu1_vx [m],imu2_px [m]\n0,1,2\n1,2,3\n")
    assert inspect(path).splitlines()[1].startswith("2 channels")


def test_a_table_of_a_sole_s_step(tmp_path):
    """As the sole half writes and reads them: units are in the names."""
    path = tmp_path / "steps.csv"
    path.write_text("time_s, force_z_n,zmp_x_m\n0,200,-0.05\n0.1,400,nan\n")
    assert inspect(path).splitlines()[1:] == [
        "2 channels, units in their names, 10 Hz, 0 to 0.1 s, 2 samples",
        "  force_z_n: 200 to 400",
        "  zmp_x_m: -0.05 throughout; not seen in 1 frame: 0.1 s",
    ]
    path.write_text("time_s,force_z_n\n0,200\n0.1\n")
    with pytest.raises(InputError, match=r"steps.csv:3: has 1 values where 2"):
        inspect(path)


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "vtk"])
def test_meshes_by_their_size(tmp_path, ending):
    """A tetrahedron of 30 by 20 by 10, as its faces or as itself."""
    points = np.array([[1, 1, 1], [31, 1, 1], [1, 21, 1], [1, 1, 11.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    cells = [("triangle", faces)]
    if ending == "vtk":
        cells.append(("tetra", np.array([[0, 1, 2, 3]])))
    path = tmp_path / f"a.{ending}"
    meshio.Mesh(points, cells).write(path)
    found = inspect(path)
    assert "4 triangles, 30 by 20 by 10" in found
    assert ("1 tetrahedron, 30 by 20 by 10" in found) == (ending == "vtk")


@pytest.mark.slow
def test_real_files_of_every_kind(data_root):
    for name, words in (
        ("boxlifting_squat/SquatLifting_Markers.csv", "BODY:RANK: around"),
        ("boxlifting_squat/SquatLifting_Forceplate.csv", "plate 1: loaded"),
        ("c3d/opensim_walking5.c3d", "2 force plates"),
    ):
        assert words in inspect(data_root / name)
    path = data_root / "opensim_gait10dof/subject01.osim"
    masses = [float(x.text) for x in ElementTree.parse(path).iter("mass")]
    found = inspect(path)
    assert f"12 bodies, {sum(masses):.4g} kg" in found
    assert "hip_r: PinJoint, pelvis to femur_r, hip_flexion_r" in found
    assert "39 markers" in found
    asc = next((data_root / "novel_asc").glob("*.asc"))
    assert "99 cells" in inspect(asc)


@pytest.mark.parametrize(
    "ending",
    ["c3d", "trc", "mot", "csv", "asc", "osim", "stl", "obj", "vtk", "avi"],
)
def test_a_bad_file_is_one_sentence(tmp_path, capsys, ending):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(b"nothing of the kind\n")
    assert main(["inspect", str(path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith("drake-exo: error: ") and str(path) in message
    assert message.count("\n") == 1


@pytest.mark.parametrize("ending", ["c3d", "csv", "asc", "osim", "obj"])
def test_a_pipe_or_a_folder_is_one_sentence(tmp_path, ending):
    for make, words in ((os.mkfifo, "no regular file"), (os.mkdir, "Is a dir")):
        path = tmp_path / f"{make.__name__}.{ending}"
        make(path)
        with pytest.raises(InputError, match=words):
            inspect(path)


@pytest.mark.parametrize("ending", ["stl", "obj", "vtk", "msh"])
def test_a_byte_order_mark_before_a_mesh_is_named(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    path.write_text("v 0 0 0", encoding="utf-8-sig")
    with pytest.raises(InputError, match="save it as UTF-8 without"):
        inspect(path)


def test_the_command_prints_it(tmp_path, capsys, markers):
    write_trc(tmp_path / "a.trc", markers)
    assert main(["inspect", str(tmp_path / "a.trc")]) == 0
    assert capsys.readouterr().out.startswith(
        f"{tmp_path / 'a.trc'}\n2 markers"
    )
