"""A folder as calibrate leaves it, of a made-up rise."""

from dataclasses import replace

import numpy as np

from drake_exo.calibration.results import (
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
)
from drake_exo.files.output import Verdict, write_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import nominal_model
from drake_exo.report.scene import Scene

MODEL = nominal_model("coupled")
TIMES = np.linspace(0.0, 1.0, 101)
NAME = "rise_1"
# Tangential, normal and moment on the human.
INTERACTION = {
    "shank": (5.0, 30.0, 0.0),
    "thigh": (-8.0, 20.0, 0.0),
    "pelvis": (0.0, -40.0, 0.0),
}
LEAD = 0.1 * (np.arange(9) == 5)  # of the measured motion: hip [rad]
STIFFNESS = {
    "tangential_stiffness": 2000.0,
    "normal_stiffness": 5000.0,
    "rotational_stiffness": 50.0,
}
CONTACT = ContactModel(
    GroundContact(
        "simbody",
        {
            sphere: ContactSphere(
                stiffness=4e6, dissipation=1.5, x=x, z=-0.05, radius=0.032
            )
            for sphere, x in (("heel", -0.05), ("toe", 0.15))
        },
    ).checked(),
    {
        cuff: BushingParameters(*place, **STIFFNESS)
        for cuff, place in MODEL.cuffs.items()
    },
)


def rise():
    """Positions (101, 9) from sitting to standing, the device behind."""
    seated = Scene(MODEL).upright_pose((8.0, 92.0, 84.0))
    q = np.linspace(seated, np.r_[seated[:3], np.zeros(6)], len(TIMES))
    q[:, 0] += 0.3  # the laboratory's origin is elsewhere
    q[:, MODEL.coordinates.device_columns] -= 0.03
    return q


def solution(chair=False):
    """What was computed: forces that grow with time."""
    felt = np.outer(TIMES < 0.4, [0.0, 300.0, 60.0])
    zero = np.zeros((len(TIMES), 9))
    ground = np.column_stack([50.0 * TIMES, 800.0 * TIMES, -280.0 * TIMES])
    return Trial(
        NAME,
        MODEL.coordinates,
        TIMES,
        rise(),
        zero,
        zero,
        PlanarWrench.of(ground),
        source="solved",
        moments=zero[:, MODEL.coordinates.joint_columns],
        cuffs={
            cuff: CuffForce.of(np.tile(force, (len(TIMES), 1)))
            for cuff, force in INTERACTION.items()
        },
        chair=PlanarWrench.of(felt) if chair else None,
        jerk=zero[:-1],
    )


def measured(chair=False):
    """The same; its motion leads by 0.1 rad at the hip, one mat is there."""
    found = solution(chair)
    return replace(
        found,
        q=found.q + LEAD,
        source="measured",
        moments=None,
        cuffs={"pelvis": CuffForce(0.0 * TIMES - 35.0)},
        jerk=None,
        mass_kg=70.0,
    )


def write_results(folder, chair=False, checks=()):
    """Write the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_model(folder, MODEL)
    write_trial(folder, solution(chair))
    measured(chair).save(folder / f"measured_{NAME}")
    write_contact(folder, CONTACT)
    write_json(
        folder / "summary.json",
        {
            "phase": "interaction",
            "subject": "made_up",
            "rmsd": [{"trial": NAME}],
            "measured_sd": {},
            "success": True,
            **Verdict(checks).summary(),
        },
    )
    return folder
