"""Contact calibration and movement prediction for people in exoskeletons.

    import drake_exo as dx

    study = dx.read_study("study.yaml")
    trials = study.trials()
    contact = dx.calibrate_foot_ground(study, trials[:3])
    cuffs = dx.calibrate_interaction(study, trials[:3], contact)
    found = dx.predict(study, trials[3], cuffs)
    found.coordinate("exo_hip"), found.cuff("thigh").normal

and, apart from it, compliant soles for humanoids in `dx.soles`. Every name has
an example in its own documentation.
"""

import importlib

__version__ = "0.1.0"

# Imported when they are asked for: a half never loads the other one.
_PLACES = {
    "calibration.foot_ground": ["FootGroundCalibration"],
    "calibration.interaction": ["InteractionCalibration"],
    "calibration.prediction": ["PredictionProblem"],
    "calibration.results": ["read_contact", "read_trial"],
    "calibration.settings": [
        "FootGroundSettings",
        "InteractionSettings",
        "PredictionSettings",
    ],
    "contact.controllers": ["AssistController"],
    "contact.diagram": ["build_diagram", "build_simulator"],
    "contact.parameters": ["ContactModel", "nominal_contact"],
    "errors": ["InputError"],
    "measurement.sagittal": ["PlanarWrench"],
    "measurement.trial": ["CuffForce", "Trial"],
    "model.coordinates": ["Coordinates"],
    "model.plant": ["Model", "nominal_model"],
    "nlp.ipopt": ["SealedSolutionError"],
    "report.figures": ["plot_trials"],
    "report.scene": ["Scene"],
    "study": [
        "Calibration",
        "Prediction",
        "Study",
        "calibrate_foot_ground",
        "calibrate_interaction",
        "predict",
        "read_study",
    ],
    "virtual_laboratory.campaign": ["write_campaign"],
}
# Rooms with names of their own.
_ROOMS = {
    "contact": "contact",
    "settings": "calibration.settings",
    "soles": "soles",
    "synthetic": "virtual_laboratory.synthetic",
}
_NAMES = {name: place for place, names in _PLACES.items() for name in names}

__all__ = sorted([*_NAMES, *_ROOMS])


def __getattr__(name: str):
    if name in _ROOMS:
        return importlib.import_module(f"drake_exo.{_ROOMS[name]}")
    if name not in _NAMES:
        raise AttributeError(f"module 'drake_exo' has no attribute {name!r}")
    return getattr(importlib.import_module(f"drake_exo.{_NAMES[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
