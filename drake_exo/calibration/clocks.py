"""Lags of encoder and mat clocks, and the checks that a phase has to pass.

Soft cuffs let a device lag or lead the limb, so a clock's lag can only be
estimated from the whole movement: forces, motion and clock have to agree.
Phase B estimates the clocks of its own trials along with the cuffs. `Timing`
estimates those of a trial that is to be predicted, with the cuffs known. How
certain a lag is becomes one of a phase's checks (`files.output.Verdict`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.calibration.audit import Audit
from drake_exo.calibration.error_model import CLOCKS, shared_moments
from drake_exo.calibration.phases import InteractionCalibration
from drake_exo.calibration.problem import (
    PhaseProblem,
    PhaseResult,
    has_encoders,
)
from drake_exo.calibration.settings import InteractionSettings
from drake_exo.calibration.uncertainty import DISCREPANCY, QUANTILE_95
from drake_exo.contact.parameters import ContactModel, Posterior
from drake_exo.files.output import SOLVED, Check
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model

# A clock is sure if its lag is known to within this [s] (95 %): angles of a
# device that turns by 100 degrees a second are then known to a degree.
LARGEST_DOUBT_S = 0.01
# Lags are estimated to first order: 80 ms come out as 55 to 68 in rises. Above
# this [s] an estimate counts as rough,
_FIRST_ORDER_S = 0.05
# and above this [rad] at the rate at which the signal changes: in walks with
# rates of 50 rad/s, mats 29 to 37 ms early come out as 17 to 19.
_FIRST_ORDER_RAD = 0.5
_GIVEN = {"encoders": "encoder_delay_s", "pressure": "pressure_delay_s"}
_ORIGIN_M = 1e-3  # standard deviation of a cuff's place from trial to trial


@dataclass(frozen=True)
class Clock:
    """Lag of a system's clock behind the markers' in one trial.

    Attributes:
        trial: name of the trial.
        system: "encoders" or "pressure" (the mats).
        lag_s: whole lag, including what was already taken out of the recording.
        sd_s: its standard deviation.

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
        """Half the width of the lag's 95 % interval."""
        return QUANTILE_95 * self.sd_s

    @property
    def sure(self) -> bool:
        """Whether the lag is known to within 10 ms."""
        return self.half_width_s <= LARGEST_DOUBT_S

    @property
    def sentence(self) -> str:
        """The lag with its 95 % interval, as text."""
        return f"{1e3 * self.lag_s:+.0f} ± {1e3 * self.half_width_s:.0f} ms"

    def summary(self) -> dict:
        """Entry of this clock in summary.json."""
        return {
            "trial": self.trial,
            "system": self.system,
            "lag_s": self.lag_s,
            "half_width_95_s": self.half_width_s,
            "sure": self.sure,
        }


def clocks_of(trials: Iterable[Trial], known: Posterior) -> list[Clock]:
    """Clocks of recorded trials that were estimated.

    Args:
        trials: measured.
        known: posterior that may hold the trials' clocks.
    """
    found = []
    for trial in trials:
        for system, lag in trial.lags_s.items():
            name = f"{trial.name}.{CLOCKS.get(system)}"
            if name in known.names:
                (late,), ((variance,),) = known.of([name])
                sd = float(np.sqrt(max(variance, 0.0)))
                found.append(Clock(trial.name, system, float(lag + late), sd))
    return found


def left(trial: Trial, own: Sequence[Clock]) -> Posterior:
    """Posterior of the lags that are left in a recorded trial."""
    return Posterior(
        tuple(f"{trial.name}.{CLOCKS[c.system]}" for c in own),
        np.array([c.lag_s - trial.lags_s.get(c.system, 0.0) for c in own]),
        np.diag([c.sd_s**2 for c in own]),
    )


def retimed(trial: Trial, own: Sequence[Clock]) -> Trial:
    """A recorded trial with its encoders shifted by the lag that was found.

    The error model shifts signals to first order only: too rough for tens of
    milliseconds if a torque sets in within a tenth of a second. The splines
    extrapolate at the ends: in the virtual laboratory angles there are off by
    at most 0.1 degrees for 40 ms (2 degrees for 100 ms); held constant, by 2.6.
    """
    lags = {c.system: c.lag_s for c in own if c.system == "encoders"}
    if not lags:
        return trial
    late = lags["encoders"] - trial.lags_s.get("encoders", 0.0)
    names, device = trial.coordinates, trial.coordinates.device_columns

    def shown(x: np.ndarray) -> np.ndarray:
        return CubicSpline(trial.times, x)(trial.times + late)

    motion = {k: getattr(trial, k).copy() for k in ("q", "v", "a")}
    for x in motion.values() if has_encoders(trial) else ():
        x[:, device] = shown(x[:, device])
    moments, friction = trial.moments, trial.friction
    if moments is not None:
        exo = trial.device_moments
        moments = moments + shared_moments(names, shown(exo) - exo)
    words = dict(trial.provenance.get("clocks", {}))
    for clock in own:
        if clock.system in words:
            doubt = "" if clock.sure else ", unsure"
            words[clock.system] = clock.sentence + doubt
    said = {"delays_s": trial.lags_s | lags, "clocks": words}
    return replace(
        trial,
        **motion,
        moments=moments,
        friction=None if friction is None else shown(friction),
        provenance=trial.provenance | said,
    )


class Timing(InteractionCalibration):
    """Phase B of trials to be predicted, to find their clocks.

    The calibration is the prior of cuffs and errors. That of the cuffs is
    widened by what a bushing cannot represent: under load they stiffen or slip.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated, with its posterior.
        settings: Phase B's.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: InteractionSettings,
    ):
        values = contact.values()
        # Slip stays as calibrated: a single trial may not slip at all.
        free = [
            p
            for p in settings.parameters(model.cuffs)
            if p.free and not p.name.endswith(".slip")
        ]
        # The value may be outside these bounds: other settings, or scaled.
        parameters = [
            replace(
                p,
                nominal=(value := values[p.name]),
                lower=min(p.lower, value),
                upper=max(p.upper, value),
                prior_sd=None,
            )
            for p in free
        ]
        PhaseProblem.__init__(
            self,
            model,
            trials,
            contact,
            parameters,
            settings,
            settings.errors,
        )

    def _prior(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Joint prior of parameters and errors: names, mean, covariance."""
        known = self.contact.posterior
        free = self.parameters
        cuffs = [p.name for p in free]
        names = cuffs + self.errors.names
        mean, covariance = np.zeros(len(names)), np.zeros((len(names),) * 2)
        k = len(free)
        mean[k:], covariance[k:, k:] = self.errors.prior()
        mean[:k] = [p.nominal for p in free]
        i = [j for j, name in enumerate(names) if name in known.names]
        _, covariance[np.ix_(i, i)] = known.of([names[j] for j in i])
        for j, p in enumerate(free):
            stiff = p.name.endswith("_stiffness")
            more = DISCREPANCY * p.nominal if stiff else _ORIGIN_M
            covariance[j, j] += more**2
        return cuffs, mean, covariance


def phase_checks(
    result: PhaseResult, audits: Sequence[Audit], clocks: Sequence[Clock] = ()
) -> list[Check]:
    """Checks: solved, audit, simulation; and, as notes, bounds and clocks.

    Args:
        result: solution of a phase.
        audits: one for each trial; none after a failed solve.
        clocks: estimated along with the solution.
    """
    solution = result.solution
    names = ", ".join(t.name for t in result.problem.trials)
    text = "" if solution.success else f"{solution.status}. "
    made = [
        Check(
            SOLVED,
            solution.success,
            where=names,
            sentence=text + solution.explain(),
        )
    ]
    for audit in audits:
        made += audit.checks()
    at_bound = set(solution.active_bounds)
    made += [
        Check(
            "bounds",
            p.name not in at_bound,
            where=p.name,
            sentence="the data ask for a value beyond its bound",
            level="note",
        )
        for p in result.problem.parameters
        if p.free
    ]
    if result.problem.bushings:  # nothing else uses encoders and mats
        made += clock_checks(result.problem.trials, clocks)
    return made


def clock_checks(
    trials: Iterable[Trial], found: Sequence[Clock] = ()
) -> list[Check]:
    """Notes that say whether the lag of each clock is known.

    Args:
        trials: recorded; their provenance speaks for a clock not in `found`.
        found: clocks that were estimated.
    """
    known = {(c.trial, c.system): c for c in found}
    made = []
    for trial in trials:
        said = trial.provenance.get("clocks", {})
        for system, lag in trial.lags_s.items():
            clock, doubt = known.get((trial.name, system)), (None, None, "")
            if clock is not None:
                sure, text = clock.sure, clock.sentence
                doubt = 1e3 * clock.half_width_s, 1e3 * LARGEST_DOUBT_S, "ms"
            elif system in said:
                sure, text = not said[system].endswith("unsure"), said[system]
            else:
                continue
            where = f"{trial.name}, {system}"
            made.append(Check("clocks", sure, *doubt, where, text, "note"))
            if clock is None:
                continue
            off, limit = abs(clock.lag_s - lag), _FIRST_ORDER_S
            if clock.sure:
                limit = min(limit, _FIRST_ORDER_RAD / _rate(trial, system))
            if off > limit:
                far = 1e3 * off, 1e3 * limit, "ms"
                text += (
                    ", too far off for more than a rough value: set "
                    f"{_GIVEN[system]} of this trial to it, and run again"
                )
                made.append(Check("clocks", False, *far, where, text, "note"))
    return made


def _rate(trial: Trial, system: str) -> float:
    """How fast a system's signals change [rad/s].

    That of a sine is its angular frequency.
    """
    if system == "encoders":
        device = trial.coordinates.device_columns
        rate, change = trial.v[:, device], trial.a[:, device]
    else:
        force = np.stack([c.normal for c in trial.cuffs.values()], axis=1)
        rate = np.gradient(force, trial.times, axis=0)
        change = np.gradient(rate, trial.times, axis=0)
    # Signals at rest change at no rate.
    return max(np.linalg.norm(change), 1e-9) / max(np.linalg.norm(rate), 1e-9)
