"""Writes the page of all public names from their docstrings.

    python docs/make_api.py FOLDER

Names are imported as they are asked for, which pdoc does not do.
"""

import importlib
import sys
from pathlib import Path

import pdoc

# pdoc adds subpackages of the first by itself.
PAGES = (
    "drake_exo",
    "drake_exo.calibration.settings",
    "drake_exo.virtual_laboratory.synthetic",
    # What public functions return, and what posed problems inherit.
    "drake_exo.calibration.audit",
    "drake_exo.calibration.problem",
    "drake_exo.calibration.uncertainty",
    "drake_exo.collocation.trial_program",
    "drake_exo.contact.diagram",
    "drake_exo.files.output",
    "drake_exo.nlp.ipopt",
    "drake_exo.nlp.program",
)
ROOMS = ("drake_exo.contact", "drake_exo.soles")


def main(folder: str) -> None:
    """Write the pages."""
    for place in map(importlib.import_module, (*PAGES, *ROOMS)):
        for name in getattr(place, "__all__", ()):
            thing = getattr(place, name)
            setattr(place, name, thing)
            # Drake names a template's instance after its scalar type, and pdoc
            # documents a class only under its own name.
            if getattr(thing, "__name__", "").startswith(f"{name}_𝓣"):
                thing.__name__ = thing.__qualname__ = name
                for own in [key for key in vars(thing) if key.startswith("To")]:
                    delattr(thing, own)  # conversion to another scalar
    pdoc.pdoc(*PAGES, output_directory=Path(folder))


if __name__ == "__main__":
    main(sys.argv[1])
