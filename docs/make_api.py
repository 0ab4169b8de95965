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
)
ROOMS = ("drake_exo.contact", "drake_exo.soles")


def main(folder: str) -> None:
    """Write the pages."""
    for place in map(importlib.import_module, (*PAGES, *ROOMS)):
        vars(place).update({n: getattr(place, n) for n in place.__all__})
    pdoc.pdoc(*PAGES, output_directory=Path(folder))


if __name__ == "__main__":
    main(sys.argv[1])
