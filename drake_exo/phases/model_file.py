"""The model that a result was computed with, on disk beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drake_exo.errors import InputError
from drake_exo.output import write_json
from drake_exo.schema import load
from drake_exo.segments import ExoskeletonParameters, HumanParameters

MODEL = "model.json"


@dataclass(frozen=True)
class ModelFile:
    """Subject and device, as `build_plant` takes them.

    Attributes:
        kind: of plant.
        human: the fitted subject.
        exoskeleton: the fitted device; None for the kind "human".
    """

    kind: Literal["coupled", "rigid", "human"]
    human: HumanParameters
    exoskeleton: ExoskeletonParameters | None = None


def write_model(folder: Path, model: tuple) -> None:
    """Write (kind, human, exoskeleton) into a folder of results."""
    write_json(folder / MODEL, ModelFile(*model))


def read_model(folder: Path) -> ModelFile:
    """Read what `write_model` wrote.

    Raises:
        InputError: it is missing or damaged.
    """
    path = Path(folder) / MODEL
    if not path.is_file():
        raise InputError(
            f"{path}: is missing, so the model of these results is unknown; "
            "run the command that wrote them again"
        )
    return load(path, ModelFile)
