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
import os

# Before numpy loads its BLAS: matrices here are small, two threads are slower
# than one where the cores have other work, and sums would depend on how many
# cores there are.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

# Imported when they are asked for: a half never loads the other one.
_PLACES = {
    "calibration.phases": [
        "FootGroundCalibration",
        "InteractionCalibration",
        "PredictionProblem",
    ],
    "calibration.results": ["read_contact", "read_trial"],
    "calibration.settings": [
        "DesignSettings",
        "FootGroundSettings",
        "InteractionSettings",
        "PredictionSettings",
    ],
    "contact.systems": ["AssistController"],
    "contact.diagram": ["build_diagram", "build_simulator"],
    "contact.parameters": ["ContactModel", "nominal_contact"],
    "contact.strap": ["read_design"],
    "designing": ["design"],
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


def on_demand(package: str, places: dict, rooms: dict | None = None) -> tuple:
    """`__getattr__`, `__dir__`, `__all__` of a package with late imports.

    Args:
        package: its `__name__`.
        places: module below the package -> names that it defines.
        rooms: name -> module below the package that stands for it.
    """
    rooms = rooms or {}
    homes = {name: place for place, names in places.items() for name in names}
    every = sorted([*homes, *rooms])

    def __getattr__(name: str):  # noqa: N807
        if name not in homes and name not in rooms:
            from drake_exo.errors import nearest

            raise AttributeError(
                f"module {package!r} has no attribute {name!r}"
                f"{nearest(name, every)}"
            )
        place = rooms.get(name) or homes[name]
        module = importlib.import_module(f"{package}.{place}")
        return module if name in rooms else getattr(module, name)

    return __getattr__, lambda: every, every


__getattr__, __dir__, __all__ = on_demand(__name__, _PLACES, _ROOMS)
