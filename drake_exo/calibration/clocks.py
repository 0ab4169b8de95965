"""Clocks of encoders and mats, as the error model finds them with all else.

Where a device moves behind its cuffs, nothing but the whole movement tells
when its encoders and mats were read: forces, motion and clock have to agree.
Phase B has the clocks of its own trials among its unknowns. Those of a trial
that is to be predicted follow likewise, with cuffs that are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drake_exo.calibration.error_model import CLOCKS, ErrorModel
from drake_exo.calibration.interaction import InteractionCalibration
from drake_exo.calibration.problem import PhaseProblem, PhaseResult
from drake_exo.calibration.settings import InteractionSettings
from drake_exo.calibration.uncertainty import QUANTILE_95, posterior
from drake_exo.contact.parameters import ContactModel, Posterior
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model
from drake_exo.nlp.sensitivity import Optimum

# A clock is known if 95 % of what it may be is within this [s]: a device that
# turns by 100 degrees a second is then known to a degree.
LARGEST_DOUBT_S = 0.01


@dataclass(frozen=True)
class Clock:
    """Lag of a system's clock behind the markers' in one trial.

    Attributes:
        trial: its name.
        system: "encoders" or "pressure".
        lag_s: in all, with what was taken out of the recording.
        sd_s: standard deviation.

    >>> Clock("rise1", "encoders", 0.031, 0.004).sure
    True
    >>> Clock("rise1", "pressure", 0.0, 0.015).sure
    False
    """

    trial: str
    system: str
    lag_s: float
    sd_s: float

    @property
    def half_width_s(self) -> float:
        """Half of its 95 % interval."""
        return QUANTILE_95 * self.sd_s

    @property
    def sure(self) -> bool:
        """Whether it is known to 10 ms."""
        return self.half_width_s <= LARGEST_DOUBT_S

    @property
    def sentence(self) -> str:
        """What is known, in words."""
        return f"{1e3 * self.lag_s:+.0f} ± {1e3 * self.half_width_s:.0f} ms"

    def summary(self) -> dict:
        """What summary.json holds."""
        return {
            "trial": self.trial,
            "system": self.system,
            "lag_s": self.lag_s,
            "half_width_95_s": self.half_width_s,
            "sure": self.sure,
        }


def clocks(trials: Iterable[Trial], known: Posterior) -> list[Clock]:
    """Clocks of recorded trials, as far as they were estimated.

    Args:
        trials: measured.
        known: errors of theirs among what it knows.
    """
    found = []
    for trial in trials:
        for system, lag in trial.provenance.get("delays_s", {}).items():
            name = f"{trial.name}.{CLOCKS.get(system)}"
            if name in known.names:
                (late,), ((variance,),) = known.of([name])
                sd = float(np.sqrt(max(variance, 0.0)))
                found.append(Clock(trial.name, system, float(lag + late), sd))
    return found


def left(trial: Trial, own: Sequence[Clock]) -> Posterior:
    """What a recorded trial's own clocks lag besides what was taken out."""
    lags = trial.provenance.get("delays_s", {})
    return Posterior(
        tuple(f"{trial.name}.{CLOCKS[c.system]}" for c in own),
        np.array([c.lag_s - lags[c.system] for c in own]),
        np.diag([c.sd_s**2 for c in own]),
    )


class Timing(InteractionCalibration):
    """Movement and forces as measured, on cuffs that are known.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated, with its posterior.
        settings: of Phase B.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: InteractionSettings,
        *,
        refined: Mapping[str, int] | None = None,
    ):
        errors = ErrorModel(model, trials, settings.errors, contact.posterior)
        PhaseProblem.__init__(
            self, model, trials, contact, [], settings, errors, refined
        )


def timed(result: PhaseResult) -> list[Clock]:
    """Clocks that a Timing tells.

    What is not known of the cuffs is not known of the clocks either.
    """
    problem = result.problem
    known, before = posterior(result), problem.contact.posterior
    cuffs = [n for n in before.names if n in problem.contact.values()]
    program, place = problem.compiled, problem.program.indices
    errors = place(problem.error_variables)
    optimum = Optimum(
        program,
        program.restrict(result.values),
        program.unknowns.column_of(errors),
    )
    moved = optimum.by_fixed(place(problem.variables_of(cuffs)))
    moved = (program.unknowns.matrix @ moved)[errors]
    more = moved @ before.of(cuffs)[1] @ moved.T
    known = Posterior(known.names, known.values, known.covariance + more)
    return clocks(problem.trials, known)
