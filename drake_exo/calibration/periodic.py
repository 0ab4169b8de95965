"""A step of two legs that could go on for ever, with little effort.

The other leg's step is its mirror image, so that half a cycle says it all:
what ends with left and right exchanged as it began. Nothing is tracked.
"""

import numpy as np

from drake_exo.calibration.prediction import PredictionProblem
from drake_exo.collocation.kernels import SoleKernel
from drake_exo.collocation.trial_program import TrialProgram, minimised
from drake_exo.errors import InputError
from drake_exo.files.tables import runs
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.nlp.program import AffineKernel

# How far joints turn where nothing else says so, as the American Academy of
# Orthopaedic Surgeons tells it; ankles bend further under load.
_RANGES_DEG = {
    "hip": (-30.0, 120.0),
    "knee": (0.0, 140.0),
    "ankle": (-50.0, 35.0),
    "toes": (-30.0, 70.0),
}


class PeriodicStep(PredictionProblem):
    """A periodic step posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: where the search starts, and how long each step lasts.
        contact: calibrated.
        settings: speed, clearance, bounds, effort, grid.

    Raises:
        InputError: the model has one leg for both; or as PredictionProblem.
    """

    ends = "periodic"

    def _terms(self, movement, at, effects):
        return [minimised(movement.torque, self.settings.noise.torque_nm)]

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        grid, names = movement.grid, movement.coordinates
        x, *_ = names.root_columns
        other = mirrored(names)
        speed = self.settings.speed_m_s
        if speed is None:
            speed = (at.q[-1, x] - at.q[0, x]) / at.duration
        ahead = np.zeros(len(names))
        ahead[x] = speed * at.duration
        movement.bound(grid.q[0, [x]], at.q[0, [x]], at.q[0, [x]])
        # The root's accelerations follow from all else.
        for what, values, rows, gain in (
            ("positions", grid.q, slice(None), ahead),
            ("velocities", grid.v, slice(None), 0.0),
            ("accelerations", grid.a, names.joint_columns, 0.0),
        ):
            self.program.add_constraints(
                f"{movement.name} mirrored {what}",
                AffineKernel(np.hstack([np.eye(len(names)), -other])[rows]),
                np.hstack([values[-1], values[0]])[None],
                gain,
                gain,
            )

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        grid, names = movement.grid, movement.coordinates
        at = trial.sample(grid.times)
        for side, wrench in at.feet.items():
            foot = f"foot_{side}"
            swings = _middle(~wrench.is_loaded)
            if not len(swings):
                continue
            kernel = SoleKernel(self.sphere_values(self.contact, foot))
            self.program.add_constraints(
                f"{movement.name} clearance of {foot}",
                kernel,
                movement.poses[foot][swings],
                self.settings.clearance_m,
                np.inf,
            )
        for name in names.human:
            lower, upper = np.deg2rad(_RANGES_DEG[name.split("_")[0]])
            q, own = grid.q[:, names.index(name)], at.coordinate(name)
            movement.bound(
                q,
                np.full(len(q), min(lower, own.min())),
                np.full(len(q), max(upper, own.max())),
            )
        return movement


def mirrored(names: Coordinates) -> np.ndarray:
    """Matrix (nq, nq) that exchanges left and right.

    Raises:
        InputError: a coordinate has no other side.
    """
    other = {"left": "right", "right": "left"}
    found = np.zeros((len(names), len(names)))
    for i, name in enumerate(names.names):
        parts = [other.get(part, part) for part in name.split("_")]
        if i >= len(names.root) and parts == name.split("_"):
            raise InputError(
                f"prediction.ends: {name} is of both legs at once; a periodic "
                "step needs two, say human: {legs: two}"
            )
        found[i, names.index("_".join(parts))] = 1.0
    return found


def _middle(free: np.ndarray) -> np.ndarray:
    """The middle half of the longest run of nodes (n,) without load."""
    longest = max(runs(free), key=lambda r: r[1] - r[0], default=(0, 0))
    quarter = (longest[1] - longest[0]) // 4
    return np.arange(longest[0] + quarter, longest[1] - quarter)
