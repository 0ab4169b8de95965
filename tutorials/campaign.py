"""The measurement campaign, and its calibration, that tutorials share."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

import drake_exo as dx

# Set by the tests: the same code with less to compute.
SHORT = bool(os.environ.get("DRAKE_EXO_SHORT"))
# Where tutorials keep what they share.
WORK = Path(os.environ.get("DRAKE_EXO_TUTORIALS", "tutorial_results"))

# Noise without systematic errors: what is calibrated can be compared with
# the truth number by number.
_NOISE = (
    "marker_noise",
    "plate_noise",
    "encoder_noise",
    "pressure_steps",
    "variation",
)
_MOVEMENTS = 2 if SHORT else 4
_NODES_PER_SECOND = 40.0 if SHORT else 200.0


def laboratory() -> Path:
    """Folder of the campaign; simulated the first time, half a minute.

    All movements are for calibration but the last one, which is held out to
    be predicted.
    """
    folder = WORK / "laboratory"
    if not (folder / "study.yaml").is_file():
        growing = WORK / f"laboratory_{os.getpid()}"
        study = dx.write_campaign(growing, 1, _NOISE, _MOVEMENTS)
        head, _, tail = study.read_text("utf-8").rpartition("use: ")
        kept = tail.partition("\n")[2]
        study.write_text(f"{head}use: prediction\n{kept}", encoding="utf-8")
        growing.rename(folder)
    return folder


def study():
    """The campaign's study with the tutorials' number of nodes."""
    found = dx.read_study(laboratory() / "study.yaml")
    for phase in ("foot_ground", "interaction", "prediction"):
        settings = getattr(found, phase)
        solver = replace(settings.solver, nodes_per_second=_NODES_PER_SECOND)
        setattr(found, phase, replace(settings, solver=solver))
    return found


def contact() -> dx.ContactModel:
    """The calibrated contact, as tutorial 6 finds it."""
    folder = WORK / "calibration"
    if not (folder / "parameters.json").is_file():
        growing = WORK / f"calibration_{os.getpid()}"
        growing.mkdir(parents=True)
        dx.calibrate_interaction(study()).write(growing)
        growing.rename(folder)
    return dx.read_contact(folder)


def truth(phase: str) -> dict[str, float]:
    """True parameters by name, of "foot_ground" or "interaction"."""
    path = laboratory() / "truth" / f"{phase}.json"
    return json.loads(path.read_text("utf-8"))["parameters"]


def true_motion(trial: dx.Trial) -> np.ndarray:
    """What truly happened in a trial: columns by name, angles in radians."""
    lines = (laboratory() / "truth" / f"{trial.name}.sto").read_text("utf-8")
    table = lines.partition("endheader\n")[2].splitlines()
    return np.genfromtxt(table, names=True)
