"""A recording made from the plant itself, so that the truth is known.

One person sits, stands up, sits down, stands up. Markers sit on both legs;
the chair bears a share of the weight until seat-off, behind the hips as far as
keeps the centre of pressure under the feet.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.files import schema
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.tables import MarkerData, Table
from drake_exo.measurement.filters import derivatives
from drake_exo.measurement.kinematics import (
    inverse_dynamics,
)
from drake_exo.measurement.processing import Recordings
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.subject import fit_subject
from drake_exo.model.description import fit_exoskeleton
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.study import StudyFile

RATE = 100.0
SEAT_OFF = (1.5, 6.5)
STANDING = (2.6, 7.6)
PRESSURE_X = 0.05  # in front of the ankle while seated
POINTS = {  # body -> name -> (x, z) on it
    "foot": {"heel": (-0.05, -0.03), "meta": (0.12, -0.04), "ank": (0, 0)},
    "shank": {"sh1": (0.05, 0.2), "sh2": (-0.04, 0.3), "kne": (0, None)},
    "thigh": {"th1": (0.06, 0.2), "th2": (-0.05, 0.25), "hip": (0, None)},
    "pelvis": {"asis": (0.08, 0.1), "psis": (-0.1, 0.12)},
}


@dataclass(frozen=True)
class Recording:
    """The truth behind the files."""

    tree: PlanarTree
    time: np.ndarray
    q: np.ndarray
    wrench: PlanarWrench
    chair: PlanarWrench


def load(study, folder):
    """Subject and trials of a study's files."""
    subject = fit_subject(study, folder)
    return subject, Recordings(study, folder, subject).trials(study.trials)


def step(t, start, end):
    """Rises smoothly from 0 to 1 (minimum jerk)."""
    s = np.clip((t - start) / (end - start), 0.0, 1.0)
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def motion(time, human):
    seated = np.array([0.3, human.ankle_height_m, 0.0, 0.35, 1.6, 1.9])
    upright = np.array([0.3, human.ankle_height_m, 0.0, 0.08, 0.1, 0.02])
    share = (
        step(time, 1.2, STANDING[0])
        - step(time, 3.8, 5.2)
        + step(time, 6.2, STANDING[1])
    )
    return seated + share[:, None] * (upright - seated)


def record(human, gravity=9.81, kind="human"):
    """Simulate by inverse dynamics; returns the truth."""
    device = None if kind == "human" else fit_exoskeleton(human)
    tree = Model(kind, human, device, gravity).tree
    time = np.arange(850) / RATE
    q = motion(time, human)
    v, a = derivatives(time, q)
    seated = (
        1.0
        - step(time, 1.1, SEAT_OFF[0])
        + (step(time, 4.8, 5.2) - step(time, 6.1, SEAT_OFF[1]))
    )
    nothing = inverse_dynamics(tree, q, v, a, {})
    _, F_z, moment = tree.ground_reaction(q, nothing).T
    bears = 0.7 * tree.weight * seated
    under = q[:, 0] + PRESSURE_X
    chair = PlanarWrench(
        np.column_stack([0.0 * bears, bears]),
        seated * (moment + under * (F_z - bears)),
    )
    Q = inverse_dynamics(tree, q, v, a, {"pelvis": chair})
    wrench = PlanarWrench.of(tree.ground_reaction(q, Q))
    left = tree.wrench_on_body(q, "foot", wrench.array) - Q
    assert np.abs(left[:, :3]).max() < 1e-8
    return Recording(tree, time, q, wrench, chair)


def marker_data(tree, human, time, q):
    """Markers of both legs in OpenSim's axes (x forward, y up, z right)."""
    ends = {"shank": human.shank.length_m, "thigh": human.thigh.length_m}
    names, positions = [], []
    for body, points in POINTS.items():
        for name, (x, z) in points.items():
            z = ends[body] if z is None else z
            p = tree.point_positions(q, body, (x, z))
            for side, lateral in (("L", -0.1), ("R", 0.1)):
                names.append(f"{side}_{name}")
                depth = np.full(len(time), lateral)
                positions.append(np.column_stack([p, depth]))
    return MarkerData(
        time, tuple(names), np.stack(positions, axis=1), RATE, "synthetic"
    )


def force_table(time, wrench, share=0.4):
    """Plates 1 (right, `share` of the load) and 2, in OpenSim's columns."""
    names, columns = [], []
    F_x, F_z = wrench.force.T
    for number, part in ((1, share), (2, 1.0 - share)):
        zero = np.zeros(len(time))
        force = [part * F_x, part * F_z, zero]
        x = -wrench.moment / F_z
        point = [x, zero, zero + (0.1 if number == 1 else -0.1)]
        for kind, values in (("v", force), ("p", point), ("m", [zero] * 3)):
            names += [f"ground_force_{number}_{kind}{a}" for a in "xyz"]
            columns += values
    return Table(time, tuple(names), np.column_stack(columns), False)


def study_text(human, **changes):
    sided = {
        body: {
            side: [f"{s}_{name}" for name in points]
            for side, s in (("left", "L"), ("right", "R"))
        }
        for body, points in POINTS.items()
    }
    sided["shank"]["left"].append("L_ank")
    centres = {
        joint: {"left": [f"L_{name}"], "right": [f"R_{name}"]}
        for joint, name in (("ankle", "ank"), ("knee", "kne"), ("hip", "hip"))
    }
    plates = {"left": 2, "right": 1}
    data = {
        "subject": {
            "name": "nobody",
            "height_m": human.height_m,
            "mass_kg": human.mass_kg,
        },
        "model": "human",
        "standing": {
            "markers": "static.trc",
            "forces": "static.mot",
            "plates": plates,
        },
        "markers": {"joint_centres": centres, "segments": sided},
        "trials": [
            {
                "name": f"rise{k}",
                "markers": "sts.trc",
                "forces": "sts.mot",
                "plates": plates,
                "rise": k,
            }
            for k in (1, 2)
        ],
    }
    data.update(changes)
    return schema.yaml.safe_dump(data, sort_keys=False)


def write_recording(folder, human, **changes):
    """Write sts.* and static.* into `folder`; returns truth and study."""
    truth = record(human)
    write_trc(
        folder / "sts.trc",
        marker_data(truth.tree, human, truth.time, truth.q),
    )
    write_table(folder / "sts.mot", force_table(truth.time, truth.wrench))
    time = np.arange(100) / RATE
    q = np.zeros((100, 6))
    q[:, 1] = human.ankle_height_m
    still = inverse_dynamics(truth.tree, q, 0 * q, 0 * q, {})
    wrench = PlanarWrench.of(truth.tree.ground_reaction(q, still))
    write_trc(folder / "static.trc", marker_data(truth.tree, human, time, q))
    write_table(folder / "static.mot", force_table(time, wrench))
    text = study_text(human, **changes)
    (folder / "study.yaml").write_text(text)
    return truth, schema.load_text(text, StudyFile)
