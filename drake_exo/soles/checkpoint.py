"""What an interrupted optimisation needs to go on as if nothing had been."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.output import write_json
from drake_exo.soles.contact import State

_FILE = "checkpoint.json"


@dataclass(frozen=True)
class Checkpoint:
    """Where a run of stages stands.

    Attributes:
        stage, iteration: Stage to go on with, its iterations done.
        p: Best design so far (P,); None before the first.
        curvature: Learnt Hessian (P, P).
        origin, orientation: Foot pose at its first sample, O (3,), R (3, 3).
    """

    stage: int = 0
    iteration: int = 0
    p: np.ndarray | None = None
    curvature: np.ndarray | None = None
    origin: np.ndarray | None = None
    orientation: np.ndarray | None = None

    @classmethod
    def of(cls, stage, iteration, p, learnt, problem) -> "Checkpoint":
        """Of a running stage."""
        first = problem.branch
        return cls(stage, iteration, p, learnt.matrix, first.O, first.R)

    def branch(self, nodes: int) -> State | None:
        """Pose to look for the first contact at, on a mesh of this stage."""
        if self.origin is None:
            return None
        unloaded = np.zeros((nodes, 3))
        return State(unloaded, self.origin.copy(), self.orientation)

    def write(self, folder: Path) -> None:
        """Write checkpoint.json, whole or not at all."""
        lower = np.tril_indices(len(self.p))
        write_json(
            folder / _FILE,
            {
                "stage": self.stage,
                "iteration": self.iteration,
                "coefficients": self.p,
                "curvature": self.curvature[lower],
                "origin_m": self.origin,
                "orientation": self.orientation,
            },
        )


def read_checkpoint(path: Path) -> Checkpoint:
    """A checkpoint of an earlier run, given as file or folder.

    Raises:
        InputError: Missing or not a checkpoint.
    """
    file = path / _FILE if path.is_dir() else path
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        p = np.array(data["coefficients"], dtype=float)
        B = np.zeros((len(p), len(p)))
        B[np.tril_indices(len(p))] = data["curvature"]
        return Checkpoint(
            int(data["stage"]),
            int(data["iteration"]),
            p,
            B + np.tril(B, -1).T,
            np.array(data["origin_m"], dtype=float),
            np.array(data["orientation"], dtype=float).reshape(3, 3),
        )
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{file}: not a checkpoint; give the folder of an interrupted run"
        ) from None
