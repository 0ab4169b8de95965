"""Sound studies, cases and results, and the readers of each."""

import io
import json
import tempfile
from pathlib import Path

import numpy as np
from sound_files import written

from drake_exo.calibration.results import (
    read_calibration,
    read_model,
    read_trial,
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.calibration.solving import read_checkpoint
from drake_exo.contact.parameters import nominal_contact
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import nominal_model
from drake_exo.papers.serrancoli import comparison
from drake_exo.report.gathering import gather
from drake_exo.soles.settings import Settings
from drake_exo.study import read_study

_MODEL = nominal_model("coupled")
_ROOT = Path(__file__).resolve().parents[2]


def studies() -> dict:
    study = (_ROOT / "tests/studies/opencap_predict.yaml").read_bytes()
    squat = (_ROOT / "tests/studies/boxlifting_squat.yaml").read_bytes()
    case = (_ROOT / "tests/cases/sole_1_ref.yaml").read_bytes()

    def read(path):
        study = read_study(path)
        study.foot_ground.law_constants()
        study.foot_ground.parameters({"heel": (0.0, 0.0), "toe": (0.2, 0.0)})
        places = dict.fromkeys(("shank", "thigh", "pelvis"), (0.0, 0.2))
        return study.interaction.parameters(places)

    return {
        "study yaml": ("study.yaml", "text", study, read),
        "study yaml, another": ("study.yaml", "text", squat, read),
        "case yaml": ("case.yaml", "text", case, Settings.read),
    }


def _trial(source: str, n=6) -> Trial:
    rng = np.random.default_rng(3)
    names, solved = _MODEL.coordinates, source == "solved"
    q, v, a, jerk = rng.normal(size=(4, n, len(names)))
    wrench = rng.normal(size=(2, n, 3))
    if solved:
        parts = rng.normal(size=(3, n, 3))
        cuffs = map(CuffForce.of, parts)
        cuffs = dict(zip(_MODEL.cuffs, cuffs, strict=True))
    else:
        cuffs = {"thigh": CuffForce(rng.normal(size=n))}
    return Trial(
        "rise",
        names,
        np.arange(n) / 50.0,
        q,
        v,
        a,
        PlanarWrench.of(wrench[0]),
        source=source,
        moments=rng.normal(size=(n, names.num_joints)),
        cuffs=cuffs,
        chair=PlanarWrench.of(wrench[1]),
        jerk=jerk if solved else None,
        mass_kg=70.0,
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
        "success": True,
        "subject": "virtual",
        "scale_interaction": 1.4,
        "objective": "tracking",
        "controller": None,
        "rmsd": [signals],
        "measured_sd": {k: v for k, v in signals.items() if k != "trial"},
    }


def results() -> dict:
    iterate = io.BytesIO()
    np.savez(iterate, x=np.arange(5.0), structure="abc", values=np.ones(3))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_trial(folder, _trial("solved"))
        _trial("measured").save(folder / "measured_rise")
        saved = {
            path.name: path.read_bytes()
            for path in folder.iterdir()
            if path.suffix in (".npz", ".json")
        }

    def beside(path, *names):
        for name in names:
            (path.parent / name).write_bytes(saved[name])

    def trial(kind):
        """The half of a trial's two files that is damaged, and its reader."""

        def read(path):
            beside(path, *({f"{kind}_rise{e}" for e in ends} - {path.name}))
            return read_trial(path.parent, "rise", kind)

        ends = (".json", ".npz")
        return {
            end: (
                f"{kind}_rise{end}",
                end[1:],
                saved[f"{kind}_rise{end}"],
                read,
            )
            for end in ends
        }

    def report(path):
        beside(path, *saved)
        found = gather(path.parent)
        for one in found:
            one.pairs()
        return comparison({one.label: one for one in found})

    measured, solution = trial("measured"), trial("solution")
    return {
        "model": (
            "model.json",
            "json",
            written(lambda p: write_model(p.parent, _MODEL), "model.json"),
            lambda p: read_model(p.parent),
        ),
        "parameters": (
            "parameters.json",
            "json",
            written(
                lambda p: write_contact(p.parent, nominal_contact(_MODEL)),
                "parameters.json",
            ),
            lambda p: read_calibration(p.parent),
        ),
        "summary": ("summary.json", "json", json.dumps(_summary()), report),
        "checkpoint": (
            "checkpoint.npz",
            "npz",
            iterate.getvalue(),
            lambda p: read_checkpoint(p, ("abc", np.ones(3)), 5),
        ),
        "solution": solution[".json"],
        "solution numbers": solution[".npz"],
        "trial": measured[".json"],
        "trial numbers": measured[".npz"],
    }
