"""Sound studies, cases and results, and the readers of each."""

import io
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
from sound_files import written

from drake_exo.calibration.problem import Trajectory
from drake_exo.calibration.results import (
    read_calibration,
    read_model,
    read_trajectory,
    write_model,
    write_trajectories,
)
from drake_exo.calibration.solving import read_checkpoint as read_iterate
from drake_exo.cli.report import comparison
from drake_exo.collocation.bushing_kernels import BUSHING_PARAMETERS, BUSHINGS
from drake_exo.collocation.kernels import SPHERE_PARAMETERS
from drake_exo.contact.hunt_crossley import SimbodyConstants
from drake_exo.measurement.trial import Trial
from drake_exo.model.description import nominal_exoskeleton, nominal_human
from drake_exo.model.plant import COUPLED_COORDINATES
from drake_exo.report.gathering import gather
from drake_exo.soles.settings import Settings
from drake_exo.study import load_study

_ROOT = Path(__file__).resolve().parents[2]


def studies() -> dict:
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
        "case yaml": ("case.yaml", "text", case, Settings.read),
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


def results() -> dict:
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
        "model": (
            "model.json",
            "json",
            written(
                lambda p: write_model(
                    p.parent,
                    ("coupled", nominal_human(), nominal_exoskeleton()),
                ),
                "model.json",
            ),
            lambda p: read_model(p.parent),
        ),
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
    }
