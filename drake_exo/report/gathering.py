"""Results of earlier commands, found on disk."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drake_exo.errors import InputError
from drake_exo.laboratory.trial import Trial
from drake_exo.phases.measured import from_trial
from drake_exo.phases.results import read_trajectory

_PHASES = ("foot-ground", "interaction", "prediction")


@dataclass(frozen=True)
class Results:
    """What one phase left in a folder.

    Attributes:
        folder: where.
        summary: its summary.json.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def phase(self) -> str:
        """foot-ground, interaction or prediction."""
        return self.summary["phase"]

    @property
    def scale(self) -> float:
        """Of the interaction, in a prediction."""
        return self.summary.get("scale_interaction", 1.0)

    @property
    def label(self) -> str:
        """The paper's name for a prediction, or one that tells it apart."""
        parts = ["C1" if self.scale == 1.0 else "C2"]
        if self.scale not in (1.0, 1.4):
            parts.append(f"x{self.scale:g}")
        if self.summary.get("objective", "tracking") != "tracking":
            parts.append(self.summary["objective"])
        if self.summary.get("controller"):
            parts.append(self.summary["controller"].rpartition(":")[2])
        return " ".join(parts)

    def curves(self):
        """(runs, trials) as `phase_figures` draws them."""
        names = [row["trial"] for row in self.summary["rmsd"]]
        trials = [
            from_trial(Trial.load(self.folder / f"measured_{name}"))
            for name in names
        ]
        found = [read_trajectory(self.folder, name) for name in names]
        return {"model": found}, trials


def gather(folder: Path) -> list[Results]:
    """All results under a folder, in the order of their paths.

    Raises:
        InputError: there are none, or a summary cannot be read.
    """
    found = []
    for path in sorted(Path(folder).rglob("summary.json")):
        try:
            summary = json.loads(path.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{path}: cannot be read ({error}); run the command that "
                "wrote it again"
            ) from error
        if isinstance(summary, dict) and summary.get("phase") in _PHASES:
            found.append(Results(path.parent, summary))
    if not found:
        raise InputError(
            f"{folder}: holds no results; give a folder that 'drake-exo "
            "calibrate' or 'drake-exo predict' wrote"
        )
    return found
