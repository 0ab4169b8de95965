"""A measured movement in the coordinates of the plant that a phase uses."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.laboratory.trial import Trial


@dataclass(frozen=True)
class MeasuredMovement:
    """What a phase tracks of one trial.

    Attributes:
        name: of the trial.
        times: (n,) from 0 [s].
        q, v, a: (n, nq) coordinates and their derivatives [m, rad, s].
        ground: (n, 3) F_x, F_z [N] and M_y about the laboratory origin
            [N m], both feet together.
    """

    name: str
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ground: np.ndarray

    @property
    def duration(self) -> float:
        """Length of the movement [s]."""
        return float(self.times[-1] - self.times[0])

    def sample(self, times: np.ndarray) -> "MeasuredMovement":
        """The same movement at other times, by cubic splines."""
        splines = (
            CubicSpline(self.times, values)(times)
            for values in (self.q, self.v, self.a, self.ground)
        )
        return MeasuredMovement(self.name, times, *splines)


def from_trial(trial: Trial) -> MeasuredMovement:
    """A laboratory trial as a phase sees it."""
    return MeasuredMovement(
        trial.name,
        trial.time - trial.time[0],
        trial.q,
        trial.v,
        trial.a,
        np.column_stack([trial.grf, trial.moment_y]),
    )
