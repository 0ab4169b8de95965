"""The measurement campaign, and its calibration, that tutorials share."""

import os
from dataclasses import replace
from pathlib import Path

from drake_exo.calibration.inputs import CalibrationInputs, load_inputs
from drake_exo.calibration.results import read_calibration, write_parameters
from drake_exo.virtual_laboratory.campaign import write_campaign

# Set by the tests: the same code with less to compute.
SHORT = bool(os.environ.get("DRAKE_EXO_SHORT"))
# Where tutorials keep what they share.
WORK = Path(os.environ.get("DRAKE_EXO_TUTORIALS", "tutorial_results"))

# Noise without systematic errors: what is calibrated can be compared with
# the truth number by number.
NOISE = (
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
        growing.mkdir(parents=True)
        study = write_campaign(growing, 1, NOISE, _MOVEMENTS)
        text = study.read_text("utf-8")
        head, _, tail = text.rpartition("use: ")
        kept = tail.partition("\n")[2]
        study.write_text(f"{head}use: prediction\n{kept}", encoding="utf-8")
        growing.rename(folder)
    return folder


def inputs(use: str = "calibration") -> CalibrationInputs:
    """The campaign's study with the tutorials' number of nodes."""
    found = load_inputs(laboratory() / "study.yaml", None, use)

    def on_grid(settings):
        solver = replace(settings.solver, nodes_per_second=_NODES_PER_SECOND)
        return replace(settings, solver=solver)

    phases = ("foot_ground", "interaction", "prediction")
    changes = {name: on_grid(getattr(found.study, name)) for name in phases}
    return replace(found, study=replace(found.study, **changes))


def calibration() -> Path:
    """Folder of the calibrated contacts, as tutorial 6 finds them."""
    folder = WORK / "calibration"
    if not (folder / "parameters.json").is_file():
        growing = WORK / f"calibration_{os.getpid()}"
        growing.mkdir(parents=True)
        known = inputs()
        problem = known.problem()
        write_parameters(growing, problem, problem.solve())
        problem = known.interaction_problem(read_calibration(growing))
        write_parameters(growing, problem, problem.solve())
        growing.rename(folder)
    return folder
