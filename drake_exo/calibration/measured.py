"""A measured movement in the coordinates of the plant that a phase uses."""

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.measurement.trial import Trial

# Under this vertical force there is no centre of pressure to speak of [N].
LEAST_FORCE = 20.0


@dataclass(frozen=True)
class MeasuredMovement:
    """What a phase tracks of one trial.

    Attributes:
        name: of the trial.
        times: (n,) from 0 [s].
        q, v, a: (n, nq) coordinates and their derivatives [m, rad, s].
        ground: (n, 3) F_x, F_z [N] and M_y about the laboratory origin
            [N m], both feet together.
        moments: (n, nq - 3) joint moments, human's then exoskeleton's [N m];
            None where not known.
        normal_force: segment -> (n,) force on the human normal to it [N],
            where a pressure mat measured it.
        chair: (n, 3) F_x, F_z [N] and M_y about the laboratory origin [N m]
            of the chair on the body; None where it starts at seat-off.
        chair_on_thighs: share of that on the thighs, the rest on the pelvis.
    """

    name: str
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ground: np.ndarray
    moments: np.ndarray | None = None
    normal_force: dict[str, np.ndarray] = field(default_factory=dict)
    chair: np.ndarray | None = None
    chair_on_thighs: float = 0.0

    @property
    def chair_shares(self) -> dict[str, float]:
        """Segment -> share of the chair's wrench; none without a chair."""
        if self.chair is None:
            return {}
        parts = {
            "pelvis": 1.0 - self.chair_on_thighs,
            "thigh": self.chair_on_thighs,
        }
        return {name: share for name, share in parts.items() if share > 0.0}

    @property
    def duration(self) -> float:
        """Length of the movement [s]."""
        return float(self.times[-1] - self.times[0])

    def sample(self, times: np.ndarray) -> "MeasuredMovement":
        """The same movement at other times, by cubic splines."""

        def at(values):
            return CubicSpline(self.times, values)(times)

        return MeasuredMovement(
            self.name,
            times,
            *map(at, (self.q, self.v, self.a, self.ground)),
            moments=None if self.moments is None else at(self.moments),
            normal_force={k: at(f) for k, f in self.normal_force.items()},
            chair=None if self.chair is None else at(self.chair),
            chair_on_thighs=self.chair_on_thighs,
        )


def from_trial(trial: Trial) -> MeasuredMovement:
    """A laboratory trial as a phase sees it."""
    return MeasuredMovement(
        trial.name,
        trial.time - trial.time[0],
        trial.q,
        trial.v,
        trial.a,
        np.column_stack([trial.grf, trial.moment_y]),
        trial.moments,
        trial.normal_force,
        # Zero all the time is no chair, and costs nothing.
        trial.chair if trial.chair is not None and trial.chair.any() else None,
        trial.chair_on_thighs,
    )
