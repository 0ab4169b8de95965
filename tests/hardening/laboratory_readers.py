"""Sound files of a laboratory, and the readers of each."""

from pathlib import Path

import meshio
import numpy as np
from angles import in_radians
from plate_types import PlateDesign, write_types
from small_osim import small_osim
from sound_files import written

from drake_exo.files.c3d import read_c3d
from drake_exo.files.opensim import (
    read_plates,
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.optitrack import read_markers_csv, read_plate_csv
from drake_exo.files.pressure import read_novel_asc, read_pressure_csv
from drake_exo.files.tables import (
    MarkerData,
    PlateRecording,
    Table,
    read_csv_table,
    write_csv_table,
)
from drake_exo.measurement import mats as body_surface
from drake_exo.measurement.exoskeleton import read_angles, read_moments
from drake_exo.measurement.settings import Filter, Scan
from drake_exo.model.assembly import Person
from drake_exo.model.osim_person import read_person
from drake_exo.soles.mesh import brick

_JOINTS = ("exo_ankle", "exo_knee", "exo_hip")


def _markers(frames=12) -> MarkerData:
    rng = np.random.default_rng(1)
    return MarkerData(
        np.arange(frames) / 100.0,
        ("heel", "toe", "knee"),
        rng.normal(size=(frames, 3, 3)),
        100.0,
    )


def _plate(kind, frames=24) -> tuple[PlateRecording, PlateDesign]:
    n = np.arange(frames)[:, None]
    plate = PlateRecording(
        1,
        np.array([5.0, 2.0, 700.0]) + n,
        np.tile([0.2, 0.1, 0.0], (frames, 1)),
        np.tile([0.0, 0.0, 1.0], (frames, 1)),
    )
    corners = np.array(
        [[0.4, 0.6, 0.0], [0.0, 0.6, 0.0], [0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]
    )
    origin = (0.12, 0.2, -0.04) if kind == 3 else (0.0, 0.0, -0.04)
    matrix = np.diag([100.0, 100, 200, 5e4, 5e4, 3e4]) if kind == 4 else None
    return plate, PlateDesign(corners, kind, origin, matrix)


def _c3d(path):
    pairs = [_plate(kind) for kind in (1, 2, 3, 4)]
    write_types(path, _markers(), *zip(*pairs, strict=True), 2)


def _joints(ending="") -> Table:
    time = np.arange(80) / 100.0
    names = tuple(joint + ending for joint in _JOINTS)
    angles = 40.0 * np.sin(time[:, None] + np.arange(3))
    return Table(time, names, angles, True)


def plates_table() -> Table:
    time = np.arange(30) / 100.0
    names = [f"ground_force_{i}_{k}{a}" for i in "12" for k in "vp"
             for a in "xyz"] + [f"ground_torque_{i}_{a}" for i in "12"
             for a in "xyz"]  # fmt: skip
    values = np.random.default_rng(2).normal(size=(30, len(names)))
    return Table(time, tuple(names), values, True)


def _motive_markers() -> str:
    head = (
        "Format Version,1.22,Take Name,x,Export Frame Rate,50.000000,"
        "Total Exported Frames,9,Length Units,Meters\n\n"
        ",,Marker,Marker,Marker,Marker,Marker,Marker\n"
        ",,A:HEE,A:HEE,A:HEE,A:TOE,A:TOE,A:TOE\n,,1,1,1,3,3,3\n"
        ",,Position,Position,Position,Position,Position,Position\n"
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z\n"
    )
    rows = (f"{i},{i / 50:.6f},{0.1 + i},0.05,0.1,,," for i in range(9))
    return head + "\n".join(rows) + "\n"


def _motive_plate() -> str:
    names = ("PosX_PosY", "NegX_PosY", "NegX_NegY", "PosX_NegY")
    places = ((0.4, 0, 0.6), (0, 0, 0.6), (0, 0, 0), (0.4, 0, 0))
    lines = ["Format Version,1.0,", "Total Exported Frames,9,"]
    for name, place in zip(names, places, strict=True):
        lines += [f"{name}_{a},{x}" for a, x in zip("XYZ", place, strict=True)]
    lines.append("MocapFrame, MocapTime, DeviceFrame, Fx, Fy, Fz, Mx, My, Mz")
    lines += [f"{i},{i / 50:g},{i},-5,10,700,7,-35,2" for i in range(9)]
    return "\n".join(lines) + "\n"


def laboratory() -> dict:
    degrees = ["deg"] * 3
    moments = _joints("_moment")
    return {
        "trc": (
            "a.trc",
            "text",
            written(lambda p: write_trc(p, _markers())),
            read_trc,
        ),
        "sto": (
            "a.sto",
            "text",
            written(lambda p: write_table(p, _joints())),
            lambda p: (
                in_radians(read_table(p)),
                read_angles(p, _JOINTS, "both", Filter()),
            ),
        ),
        "mot": (
            "a.mot",
            "text",
            written(lambda p: write_table(p, plates_table())),
            read_plates,
        ),
        "c3d": (
            "a.c3d",
            "binary",
            written(_c3d, "a.c3d"),
            lambda p: dict(read_c3d(p).plates),
        ),
        "encoders": (
            "a.csv",
            "text",
            written(lambda p: write_csv_table(p, _joints(), degrees)),
            lambda p: (
                read_csv_table(p),
                read_angles(p, _JOINTS, "left", Filter()),
            ),
        ),
        "moments": (
            "a.csv",
            "text",
            written(lambda p: write_csv_table(p, moments, ["Nm"] * 3)),
            lambda p: read_moments(p, _JOINTS, "both", Filter()),
        ),
        "motive markers": (
            "a.csv",
            "text",
            _motive_markers(),
            read_markers_csv,
        ),
        "motive plate": ("a.csv", "text", _motive_plate(), read_plate_csv),
        "osim": (
            "a.osim",
            "text",
            small_osim("CustomJoint"),
            lambda p: read_person(p, Person("two", "hinged"), 1.75),
        ),
    }


def pressure() -> dict:
    head = (
        "file name:  mat.sol\ntotal time [secs]:  0.2\ttime per frame "
        "[secs]:  0.02000\tscanning rate [Hz]:   50\npressure values in  kPa"
        "\n\nmask definition:\nleft mat: 1,2,\nright mat: 1,2,3,\n\n"
        "time[secs]\t  1\t  2\t  1\t  2\t  3\t\n"
    )
    cells = "\t".join(f"{2.5 * k:8.3f}" for k in range(5))
    rows = "".join(f"{0.02 * (i + 1):10.5f}\t{cells}\t\n" for i in range(10))
    table = "time [s]; kPa," + ",".join(f"c{i}" for i in range(6)) + "\n"
    table += "".join(f"{i / 50},1,2,3,4,5,6\n" for i in range(10))

    def read_csv(path):
        found = read_pressure_csv(path, {"shank": (2, 2), "thigh": (1, 2)})
        return found.matrix("shank", 2, 2)

    return {
        "pressure asc": ("a.asc", "text", head + rows, read_novel_asc),
        "pressure csv": ("a.csv", "text", table, read_csv),
    }


def _scan(name, cells=None) -> Scan:
    corners = ((-0.02, 0.06, 0.0), (-0.02, -0.06, 0.0),
               (-0.02, -0.06, -0.02), (-0.02, 0.06, -0.02))  # fmt: skip
    return Scan(
        Path(name),
        "m",
        corners=None if cells else corners,
        cells=Path(cells) if cells else None,
    )


def scans() -> dict:
    sole = brick((0.2, 0.12, 0.03), (2, 2, 1))
    surface = meshio.Mesh(sole.nodes, [("triangle", sole.boundary_faces)])

    def read(path):
        scan = _scan(path.name)
        found = body_surface.read_surface(path, scan)
        return body_surface.place_cells(found, scan, 2, 3, path.parent)

    def scanned(name, **options):
        return written(lambda p: surface.write(p, **options), name)

    whole = body_surface.Surface(sole.nodes, sole.boundary_faces, "a.stl")

    def read_cells(path):
        scan = _scan("a.stl", path.name)
        return body_surface.place_cells(whole, scan, 1, 2, path.parent)

    cells = "row,column,x,y,z\n1,1,-0.02,0.06,0\n1,2,-0.02,-0.06,0\n"
    found = {
        f"scan {name}": (file, kind, scanned(file, **options), read)
        for name, file, kind, options in (
            ("stl", "a.stl", "text", {}),
            ("stl, binary", "a.stl", "binary", {"binary": True}),
            ("ply", "a.ply", "binary", {}),
            ("ply, text", "a.ply", "text", {"binary": False}),
            ("obj", "a.obj", "text", {}),
        )
    }
    return found | {"cells": ("cells.csv", "text", cells, read_cells)}
