"""A folder as calibrate leaves it, of a made-up rise."""

import numpy as np

from drake_exo.calibration.problem import Trajectory
from drake_exo.calibration.results import write_model, write_trajectories
from drake_exo.files.output import write_json
from drake_exo.measurement.trial import Trial
from drake_exo.model.description import fit_exoskeleton, nominal_human
from drake_exo.model.plant import COUPLED_COORDINATES
from drake_exo.report.scene import SEATED_DEG, Scene, upright_pose

TIMES = np.linspace(0.0, 1.0, 101)
NAME = "rise_1"
# Tangential, normal and moment at shank, thigh, pelvis.
INTERACTION = (5.0, 30.0, 0.0, -8.0, 20.0, 0.0, 0.0, -40.0, 0.0)
LEAD = 0.1 * (np.arange(9) == 5)  # of the measured motion: hip [rad]
SPHERE = {"stiffness": 4e6, "dissipation": 1.5, "z": -0.05, "radius": 0.032}
STIFFNESS = {
    "tangential_stiffness": 2000.0,
    "normal_stiffness": 5000.0,
    "rotational_stiffness": 50.0,
}


def rise():
    """Positions (101, 9) from sitting to standing, the device behind."""
    seated = upright_pose(Scene("coupled"), SEATED_DEG)
    q = np.linspace(seated, np.r_[seated[:3], np.zeros(6)], len(TIMES))
    q[:, 0] += 0.3  # the laboratory's origin is elsewhere
    q[:, 6:] -= 0.03
    return q


def trajectory():
    """What was computed: forces that grow with time."""
    zero = np.zeros((len(TIMES), 9))
    ground = np.column_stack([50.0 * TIMES, 800.0 * TIMES, -280.0 * TIMES])
    interaction = np.tile(INTERACTION, (len(TIMES), 1))
    return Trajectory(
        NAME,
        TIMES,
        rise(),
        zero,
        zero,
        zero[:-1],
        zero[:, 3:],
        ground,
        interaction,
    )


def write_results(folder, chair=False):
    """Write the folder; the measured motion leads by 0.1 rad at the hip."""
    folder.mkdir(parents=True, exist_ok=True)
    human = nominal_human()
    write_model(folder, ("coupled", human, fit_exoskeleton(human)))
    found = trajectory()
    write_trajectories(folder, [found])
    felt = np.column_stack(
        [0.0 * TIMES, 300.0 * (TIMES < 0.4), 60.0 * (TIMES < 0.4)]
    )
    Trial(
        NAME,
        COUPLED_COORDINATES,
        TIMES,
        found.q + LEAD,
        found.v,
        found.a,
        found.ground[:, :2],
        found.ground[:, 2],
        70.0,
        normal_force={"pelvis": 0.0 * TIMES - 35.0},
        chair=felt if chair else None,
    ).save(folder / f"measured_{NAME}")
    values = {}
    for sphere, x in (("heel", -0.05), ("toe", 0.15)):
        for name, value in {**SPHERE, "x": x}.items():
            values[f"{sphere}.{name}"] = value
    for segment in ("shank", "thigh", "pelvis"):
        x, z = getattr(human, f"{segment}_cuff_m")
        for name, value in {**STIFFNESS, "origin_x": x, "origin_z": z}.items():
            values[f"{segment}.{name}"] = value
    write_json(
        folder / "parameters.json",
        {
            "law": "simbody",
            "constants": {},
            "parameters": values,
            "units": dict.fromkeys(values, "SI"),
            "damping": dict.fromkeys(
                ("shank", "thigh", "pelvis"), (10.0, 10.0, 0.1)
            ),
        },
    )
    write_json(
        folder / "summary.json",
        {
            "phase": "interaction",
            "subject": "made_up",
            "rmsd": [{"trial": NAME}],
            "measured_sd": {},
        },
    )
    return folder
