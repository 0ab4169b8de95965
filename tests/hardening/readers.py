"""Every reader with a small, sound file of its format.

`FORMATS` maps a name to (suffix, kind of damage, bytes of a sound file,
function of a path). Reading the sound file succeeds; reading a damaged one
may fail in one way only, by an InputError.
"""

import io
import json
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import meshio
import numpy as np

from drake_exo.forces.contact_constants import SimbodyConstants
from drake_exo.laboratory import body_surface, instruments
from drake_exo.laboratory.c3d_files import read_c3d
from drake_exo.laboratory.c3d_writing import PlateDesign, write_c3d
from drake_exo.laboratory.csv_files import read_csv_table, write_csv_table
from drake_exo.laboratory.exoskeleton_signals import read_angles, read_moments
from drake_exo.laboratory.opensim_files import (
    PlateRecording,
    read_coordinates,
    read_plates,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.laboratory.optitrack_files import (
    read_markers_csv,
    read_plate_csv,
)
from drake_exo.laboratory.pressure_files import (
    read_novel_asc,
    read_pressure_csv,
)
from drake_exo.laboratory.tables import MarkerData, Table
from drake_exo.laboratory.trial import Trial
from drake_exo.phases.problem import Trajectory
from drake_exo.phases.results import (
    read_calibration,
    read_trajectory,
    write_trajectories,
)
from drake_exo.phases.solving import read_checkpoint as read_iterate
from drake_exo.plant import COUPLED_COORDINATES
from drake_exo.report.command import comparison
from drake_exo.report.gathering import gather
from drake_exo.soles import loads
from drake_exo.soles.case import read_case
from drake_exo.soles.checkpoint import Checkpoint, read_checkpoint
from drake_exo.soles.mesh import brick, read_mesh
from drake_exo.study import Filter, load_study

_ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Attributes:
        name: of the file.
        kind: of damage, see `damage.damaged`.
        original: a sound file.
        read: reads it.
    """

    name: str
    kind: str
    original: bytes
    read: Callable[[Path], object]


def formats() -> dict[str, Format]:
    """All formats by name."""
    found = {}
    for group in (_laboratory, _pressure, _scans, _yaml, _results, _soles):
        for key, (name, kind, original, read) in group().items():
            if isinstance(original, str):
                original = original.encode()
            found[key] = Format(name, kind, original, read)
    return found


def _written(write, name="a") -> bytes:
    """What `write(path)` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


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
        True,
    )
    corners = np.array(
        [[0.4, 0.6, 0.0], [0.0, 0.6, 0.0], [0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]
    )
    origin = (0.12, 0.2, -0.04) if kind == 3 else (0.0, 0.0, -0.04)
    matrix = np.diag([100.0, 100, 200, 5e4, 5e4, 3e4]) if kind == 4 else None
    return plate, PlateDesign(corners, kind, origin, matrix)


def _c3d(path):
    pairs = [_plate(kind) for kind in (1, 2, 3, 4)]
    write_c3d(path, _markers(), *zip(*pairs, strict=True), 2)


def _joints(ending="") -> Table:
    time = np.arange(80) / 100.0
    names = tuple(f"exo_{j}{ending}" for j in ("ankle", "knee", "hip"))
    angles = 40.0 * np.sin(time[:, None] + np.arange(3))
    return Table(time, names, angles, True)


def _plates_table() -> Table:
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


def _laboratory() -> dict:
    degrees = ["deg"] * 3
    moments = _joints("_moment")
    return {
        "trc": (
            "a.trc",
            "text",
            _written(lambda p: write_trc(p, _markers())),
            read_trc,
        ),
        "sto": (
            "a.sto",
            "text",
            _written(lambda p: write_table(p, _joints())),
            lambda p: (read_coordinates(p), read_angles(p, "both", Filter())),
        ),
        "mot": (
            "a.mot",
            "text",
            _written(lambda p: write_table(p, _plates_table())),
            read_plates,
        ),
        "c3d": ("a.c3d", "binary", _written(_c3d, "a.c3d"), read_c3d),
        "encoders": (
            "a.csv",
            "text",
            _written(lambda p: write_csv_table(p, _joints(), degrees)),
            lambda p: (read_csv_table(p), read_angles(p, "left", Filter())),
        ),
        "moments": (
            "a.csv",
            "text",
            _written(lambda p: write_csv_table(p, moments, ["Nm"] * 3)),
            lambda p: read_moments(p, "both", Filter()),
        ),
        "motive markers": (
            "a.csv",
            "text",
            _motive_markers(),
            read_markers_csv,
        ),
        "motive plate": ("a.csv", "text", _motive_plate(), read_plate_csv),
    }


def _pressure() -> dict:
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
        return found.normal_force("shank", 2e-4)

    return {
        "pressure asc": ("a.asc", "text", head + rows, read_novel_asc),
        "pressure csv": ("a.csv", "text", table, read_csv),
    }


def _scan(name, cells=None) -> instruments.Scan:
    corners = ((-0.02, 0.06, 0.0), (-0.02, -0.06, 0.0),
               (-0.02, -0.06, -0.02), (-0.02, 0.06, -0.02))  # fmt: skip
    return instruments.Scan(
        Path(name),
        "m",
        corners=None if cells else corners,
        cells=Path(cells) if cells else None,
    )


def _scans() -> dict:
    sole = brick((0.2, 0.12, 0.03), (2, 2, 1))
    surface = meshio.Mesh(sole.nodes, [("triangle", sole.boundary_faces)])

    def read(path):
        scan = _scan(path.name)
        found = body_surface.read_surface(path, scan)
        return body_surface.place_cells(found, scan, 2, 3, path.parent)

    def written(name, **options):
        return _written(lambda p: surface.write(p, **options), name)

    triangles = sole.boundary_faces
    found = body_surface.Surface(sole.nodes, triangles, "a.stl")
    cells = "row,column,x,y,z\n1,1,-0.02,0.06,0\n1,2,-0.02,-0.06,0\n"
    return {
        "scan stl": ("a.stl", "text", written("a.stl"), read),
        "scan stl, binary": (
            "a.stl",
            "binary",
            written("a.stl", binary=True),
            read,
        ),
        "scan ply": ("a.ply", "binary", written("a.ply"), read),
        "scan ply, text": (
            "a.ply",
            "text",
            written("a.ply", binary=False),
            read,
        ),
        "scan obj": ("a.obj", "text", written("a.obj"), read),
        "cells": (
            "cells.csv",
            "text",
            cells,
            lambda p: body_surface.place_cells(
                found, _scan("a.stl", p.name), 1, 2, p.parent
            ),
        ),
    }


def _yaml() -> dict:
    study = (_ROOT / "tests/studies/opencap_predict.yaml").read_bytes()
    squat = (_ROOT / "tests/studies/boxlifting_squat.yaml").read_bytes()
    case = (_ROOT / "tests/cases/sole_1_ref.yaml").read_bytes()

    def read_study(path):
        found, _ = load_study(path)
        found.foot_ground.law_constants()
        found.foot_ground.parameters((0.0, 0.0), (0.2, 0.0))
        places = dict.fromkeys(("shank", "thigh", "pelvis"), (0.0, 0.2))
        return found.interaction.parameters(places)

    return {
        "study yaml": ("study.yaml", "text", study, read_study),
        "study yaml, another": ("study.yaml", "text", squat, read_study),
        "case yaml": ("case.yaml", "text", case, read_case),
    }


def _trajectory(n=6) -> Trajectory:
    rng = np.random.default_rng(3)
    shapes = ((n, 9), (n, 9), (n, 9), (n, 9), (n, 6), (n, 3), (n, 9))
    arrays = [rng.normal(size=shape) for shape in shapes]
    return Trajectory("rise", np.arange(n) / 50.0, *arrays)


def _trial(n=6) -> Trial:
    rng = np.random.default_rng(4)
    shapes = ((n, 9), (n, 9), (n, 9), (n, 2), (n,))
    arrays = [rng.normal(size=shape) for shape in shapes]
    return Trial(
        "rise",
        COUPLED_COORDINATES,
        np.arange(n) / 50.0,
        *arrays,
        70.0,
        moments=rng.normal(size=(n, 6)),
        normal_force={"thigh": rng.normal(size=n)},
        chair=rng.normal(size=(n, 3)),
    )


def _summary() -> dict:
    signals = {
        "trial": "rise",
        "angles_deg": {"ankle": 0.1, "knee": 0.2, "hip": 0.3},
        "grf_n": {"horizontal": 1.0, "vertical": 2.0},
        "cop_mm": 1.0,
        "interaction_n": {"pelvis": 1.0, "thigh": 2.0, "shank": None},
    }
    return {
        "phase": "prediction",
        "subject": "virtual",
        "scale_interaction": 1.4,
        "objective": "tracking",
        "controller": None,
        "rmsd": [signals],
        "measured_sd": {k: v for k, v in signals.items() if k != "trial"},
    }


def _calibration() -> dict:
    spheres = ("stiffness", "dissipation", "radius", "x", "z")
    values = {f"{s}.{n}": 1.0 for s in ("heel", "toe") for n in spheres}
    cuffs = ("tangential", "normal", "rotation", "x", "z")
    return values, cuffs


def _results() -> dict:
    from drake_exo.optimal_control.interaction_kernels import (
        BUSHING_PARAMETERS,
        BUSHINGS,
    )
    from drake_exo.optimal_control.kernels import SPHERE_PARAMETERS

    names = [f"{s}.{n}" for s in ("heel", "toe") for n in SPHERE_PARAMETERS]
    names += [f"{s}.{n}" for s in BUSHINGS for n in BUSHING_PARAMETERS]
    parameters = json.dumps(
        {
            "law": "simbody",
            "constants": asdict(SimbodyConstants()),
            "parameters": dict.fromkeys(names, 1.0),
            "units": dict.fromkeys(names, "m"),
            "damping": dict.fromkeys(BUSHINGS, (1.0, 2.0, 0.1)),
        }
    )

    def calibration(path):
        found = read_calibration(path.parent)
        if found.has_bushings:
            found.bushings()
        return found

    iterate = io.BytesIO()
    np.savez(iterate, x=np.arange(5.0), fingerprint="abc")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_trajectories(folder, [_trajectory()])
        solution = (folder / "solution_rise.npz").read_bytes()
        _trial().save(folder / "measured_rise")
        numbers = (folder / "measured_rise.npz").read_bytes()
        rest = (folder / "measured_rise.json").read_bytes()

    def trial(path):
        (path.parent / "a.npz").write_bytes(numbers)
        return Trial.load(path.parent / "a")

    def trial_numbers(path):
        (path.parent / "a.json").write_bytes(rest)
        return Trial.load(path.parent / "a")

    def report(path):
        for name, data in (
            ("solution_rise.npz", solution),
            ("measured_rise.npz", numbers),
            ("measured_rise.json", rest),
        ):
            (path.parent / name).write_bytes(data)
        found = gather(path.parent)
        for one in found:
            one.curves()
        return comparison({one.label: one for one in found})

    return {
        "parameters": ("parameters.json", "json", parameters, calibration),
        "summary": ("summary.json", "json", json.dumps(_summary()), report),
        "checkpoint": (
            "checkpoint.npz",
            "npz",
            iterate.getvalue(),
            lambda p: read_iterate(p, "abc", 5),
        ),
        "trajectory": (
            "solution_rise.npz",
            "npz",
            solution,
            lambda p: read_trajectory(p.parent, "rise"),
        ),
        "trial": ("a.json", "json", rest, trial),
        "trial numbers": ("a.npz", "npz", numbers, trial_numbers),
        "sole checkpoint": (
            "checkpoint.json",
            "json",
            _written(_sole_checkpoint, "checkpoint.json"),
            read_checkpoint,
        ),
    }


def _sole_checkpoint(path):
    state = (np.ones(9), np.eye(9), np.zeros(3), np.eye(3))
    Checkpoint(1, 2, *state).write(path.parent)


def _soles() -> dict:
    sole = brick((0.2, 0.12, 0.03), (2, 2, 1))
    mesh = meshio.Mesh(sole.nodes, [("tetra", sole.tets)])

    def written(name, **options):
        return _written(lambda p: mesh.write(p, **options), name)

    def numbers(shape, seed=5):
        return np.random.default_rng(seed).uniform(1.0, 2.0, shape)

    def text(table, head="", separator=" "):
        rows = (separator.join(f"{x:.6g}" for x in row) for row in table)
        return head + "\n".join(rows) + "\n"

    def timed(columns, rows=30, column=0):
        table = numbers((rows, columns))
        table[:, column] = np.arange(rows) / 200.0
        return table

    playback = numbers((60, 37))
    phases = np.repeat([0, 2, 0, 1, 0, 2, 0, 1, 0, 2, 0], 6)[:60]
    playback[:, 0] = phases
    plates = _plates_table()
    plates.values[:, [1, 7]] += 300.0
    found = {
        f"mesh {name}": (file, kind, written(file, **options), read_mesh)
        for name, file, kind, options in (
            ("msh 2.2", "a.msh", "text",
             {"file_format": "gmsh22", "binary": False}),
            ("msh 4.1", "a.msh", "binary", {"file_format": "gmsh"}),
            ("vtk", "a.vtk", "binary", {}),
            ("vtk, text", "a.vtk", "text",
             {"file_format": "vtk42", "binary": False}),
            ("vtu", "a.vtu", "text", {"binary": False}),
        )
    }  # fmt: skip
    return found | {
        "load one foot": (
            "a.txt",
            "text",
            text(timed(8), "t zx zy cx cy fx fy fz\n"),
            lambda p: loads.read_one_foot(p, 2, 2),
        ),
        "load csv": (
            "a.csv",
            "text",
            text(timed(6), ",".join(loads.CSV_COLUMNS) + "\n", ","),
            loads.read_csv,
        ),
        "load force plate": (
            "a.mot",
            "text",
            _written(lambda p: write_table(p, plates)),
            lambda p: loads.read_force_plate(
                p, "ground_force_1", 0.0, 0.2, suffixes=("v", "p", "p")
            ),
        ),
        "load playback": (
            "a.txt",
            "text",
            text(playback),
            lambda p: loads.read_playback(p, "left", 0, 43.0),
        ),
        "load prediction": (
            "a.csv",
            "text",
            text(
                timed(4) * [1.0, 1.0, 100.0, 1.0],
                ",".join(loads.PREDICTION_COLUMNS) + "\n",
                ",",
            ),
            loads.read_prediction,
        ),
    }
