"""A wearer stands up from a chair on a plate, with known joint moments.

The device is aligned with the human (or deflected, where a test says so);
the chair's wrench, the plates and the encoders are written as a laboratory
hands them over.
"""

from dataclasses import dataclass

import numpy as np
from synthetic_recording import (
    RATE,
    marker_data,
    record,
    study_text,
)

from drake_exo.files import schema
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.tables import Table, write_csv_table
from drake_exo.measurement.filters import derivatives
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.study import StudyFile

# Friction of the device, known to the study.
VISCOUS = np.array([1.0, 2.0, 3.0])  # N m s/rad
PLATES = {"left": 2, "right": 1, "chair": 3}
JOINTS = ("ankle", "knee", "hip")
EXO_JOINTS = tuple(f"exo_{joint}" for joint in JOINTS)


@dataclass(frozen=True)
class Seated:
    """The truth behind the files."""

    tree: object
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    chair: PlanarWrench
    resultant: np.ndarray
    exo: np.ndarray


def _plates(time, feet: PlanarWrench, chair: PlanarWrench) -> Table:
    names, columns = [], []
    zero = np.zeros(len(time))
    parts = ((1, 0.4, feet, 0.1), (2, 0.6, feet, -0.1), (3, 1.0, chair, 0.0))
    for number, share, wrench, right in parts:
        F_x, F_z = share * wrench.force.T
        x = np.where(wrench.is_loaded, wrench.cop_x, 0.0) if right else zero
        columns += [F_x, F_z, zero, x, zero, zero + right]
        # Elsewhere, the whole moment is a free one (about -z).
        columns += [zero, zero, -(share * wrench.moment + x * F_z)]
        names += [
            f"ground_force_{number}_{kind}{a}" for kind in "vpm" for a in "xyz"
        ]
    return Table(time, tuple(names), np.column_stack(columns), False)


def write_seated(folder, human, **changes):
    """Write the files into `folder`; returns the truth and the study."""
    truth = record(human, kind="rigid")
    tree, time, q = truth.tree, truth.time, truth.q
    v, a = derivatives(time, q)
    chair = truth.chair
    loads = {"pelvis": chair, "foot": truth.wrench}
    resultant = inverse_dynamics(tree, q, v, a, loads)[:, 3:]
    exo = -VISCOUS * v[:, 3:]
    write_trc(folder / "sts.trc", marker_data(tree, human, time, q))
    write_table(folder / "sts.mot", _plates(time, truth.wrench, chair))
    write_csv_table(
        folder / "exo.csv", Table(time, EXO_JOINTS, q[:, 3:]), ["deg"] * 3
    )
    names = tuple(f"{joint}_moment" for joint in EXO_JOINTS)
    write_csv_table(folder / "moments.csv", Table(time, names, exo), ["Nm"] * 3)
    _write_standing(folder, human, tree)
    text = study_text(
        human,
        model="coupled",
        trials=[
            {
                "name": "rise1",
                "markers": "sts.trc",
                "forces": "sts.mot",
                "plates": PLATES,
                "encoders": "exo.csv",
                "rise": 1,
                "seated_s": 0.8,
            }
        ],
        device={
            joint: {"viscous_nm_s": float(b)}
            for joint, b in zip(JOINTS, VISCOUS, strict=True)
        },
        **changes,
    )
    (folder / "study.yaml").write_text(text)
    study = schema.load_text(text, StudyFile)
    return Seated(tree, time, q, v, a, chair, resultant, exo), study


def _write_standing(folder, human, tree):
    time = np.arange(100) / RATE
    q = np.zeros((100, 6))
    q[:, 1] = human.ankle_height_m
    still = inverse_dynamics(tree, q, 0 * q, 0 * q, {})
    wrench = PlanarWrench.of(tree.ground_reaction(q, still))
    nobody = PlanarWrench(0.0 * wrench.force, 0.0 * wrench.moment)
    write_trc(folder / "static.trc", marker_data(tree, human, time, q))
    write_table(folder / "static.mot", _plates(time, wrench, nobody))


def edit(folder, old, new):
    """Its study with other words."""
    path = folder / "study.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
