"""Sound meshes, loads and checkpoints of soles, and the readers of each."""

from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
from laboratory_readers import plates_table
from sound_files import written

from drake_exo.files.opensim import write_table
from drake_exo.soles import loads
from drake_exo.soles.animation import SoleMotion
from drake_exo.soles.load_blocks import (
    STO_COLUMNS,
    ForcePlate,
    OneFoot,
    Playback,
    Prediction,
)
from drake_exo.soles.mesh import brick, read_mesh
from drake_exo.soles.optimize.files import Checkpoint, read_checkpoint
from drake_exo.soles.simulation import write_history


def _sole_checkpoint(path):
    Checkpoint(
        stage=1,
        iteration=2,
        p=np.ones(9),
        latest=np.ones(9),
        multipliers=np.zeros(4),
        barrier=1e-3,
        curvature=np.eye(9),
    ).write(path.parent)


def _history(path, mesh):
    """Three samples of a sole that hangs in the air."""
    n, touching = 3, len(mesh.contact)
    samples = SimpleNamespace(
        F=np.zeros((n, touching, 3)),
        O=np.zeros((n, 3)),
        R=np.tile(np.eye(3), (n, 1, 1)),
        P=np.tile(mesh.nodes[mesh.contact], (n, 1, 1)),
        K_c=np.tile(np.eye(6), (n, 1, 1)),
        friction=0.8,
    )
    write_history(path, mesh, np.arange(n) / 100.0, samples)


def _motion(path):
    found = SoleMotion.read(path, "a sole")
    return None if found is None else (found.faces, found.surface_places())


def soles() -> dict:
    sole = brick((0.2, 0.12, 0.03), (2, 2, 1))
    mesh = meshio.Mesh(sole.nodes, [("tetra", sole.tets)])

    def meshed(name, **options):
        return written(lambda p: mesh.write(p, **options), name)

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
    plates = plates_table()
    plates.values[:, [1, 7]] += 300.0
    moments = [n.replace("torque_1_", "force_1_m") for n in plates.names]
    plates = replace(plates, names=tuple(moments))
    found = {
        f"mesh {name}": (file, kind, meshed(file, **options), read_mesh)
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
        "sole history": (
            "history.npz",
            "npz",
            written(lambda p: _history(p, sole), "history.npz"),
            _motion,
        ),
        "sole steps": (
            "steps.csv",
            "text",
            text(timed(4), "time_s,a,b,c\n", ","),
            lambda path: loads.read_columns(path, ("time_s",)),
        ),
        "sole checkpoint": (
            "checkpoint.json",
            "json",
            written(_sole_checkpoint, "checkpoint.json"),
            read_checkpoint,
        ),
        "load one foot": (
            "a.txt",
            "text",
            text(timed(8), "t zx zy cx cy fx fy fz\n"),
            lambda p: OneFoot(p, (0.0, 0.0), 2, 2).load(p.parent),
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
            written(lambda p: write_table(p, plates)),
            lambda p: ForcePlate(
                p, "ground_force_1", 0.0, 0.2, (0.0, 0.0)
            ).load(p.parent),
        ),
        "load playback": (
            "a.txt",
            "text",
            text(playback),
            lambda p: Playback(p, "left", 0, 43.0).load(p.parent),
        ),
        "load prediction": (
            "a.sto",
            "text",
            text(
                timed(4) * [1.0, 1.0, 100.0, 1.0],
                "inDegrees=no\nendheader\n" + "\t".join(STO_COLUMNS) + "\n",
            ),
            lambda p: Prediction(p, (0.0, 0.0)).load(p.parent),
        ),
    }
