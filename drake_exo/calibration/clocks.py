"""Lags of encoder and mat clocks, and the checks that a phase has to pass.

Soft cuffs let a device lag or lead the limb, so a clock's lag can only be
estimated from the whole movement: forces, motion and clock have to agree.
Phase B estimates the clocks of its own trials along with the cuffs. `Timing`
estimates those of a trial that is to be predicted, with the cuffs known. How
certain a lag is becomes one of a phase's checks (`files.output.Verdict`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

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
from drake_exo.calibration.solving import SolveWatch, add_up
from drake_exo.calibration.uncertainty import (
    DISCREPANCY,
    QUANTILE_95,
    posterior,
)
from drake_exo.contact.parameters import ContactModel, Posterior
from drake_exo.errors import check_names
from drake_exo.files.output import SOLVED, Check
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model

# A clock is sure if its lag is known to within this [s] (95 %): angles of a
# device that turns by 100 degrees a second are then known to a degree.
LARGEST_DOUBT_S = 0.01
_PASSES = 6  # at most, to find lags
# Lags stay if they change by less than this share of their interval's
# half-width, or than this [s].
_SETTLED, _SETTLED_S = 0.5, 1e-3
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

    def __post_init__(self):
        check_names([self.system], CLOCKS)

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


def timed(
    contact: ContactModel, trial: Trial, clocks: Iterable[Clock]
) -> ContactModel:
    """The contact, whose posterior, if any, also tells of a trial's clocks."""
    if contact.posterior is None:
        return contact
    both = contact.posterior.beside(left(trial, of_trial(trial, clocks)))
    return replace(contact, posterior=both)


def of_trial(trial: Trial, clocks: Iterable[Clock]) -> list[Clock]:
    """Those of some clocks that are the trial's."""
    return [c for c in clocks if c.trial == trial.name]


def retimed(trial: Trial, clocks: Iterable[Clock]) -> Trial:
    """A recorded trial with its readings shifted by its lags among `clocks`.

    Readings are interpolated, from before and after the trial, too, as far as
    `Trial.around` knows them; beyond, the splines extrapolate.
    """
    own = of_trial(trial, clocks)
    late = {c.system: c.lag_s - trial.lags_s.get(c.system, 0.0) for c in own}
    if not late:
        return trial
    wide, gone = trial.readings, trial.shifts_s
    at = trial.times + trial.start_s - wide.start_s

    def moved(x: np.ndarray, system: str) -> np.ndarray:
        """Change of a reading, given in `wide`, by its shift."""
        # `wide` may have been shifted as well, as if it is the trial itself.
        old = at + gone.get(system, 0.0) - wide.shifts_s.get(system, 0.0)
        spline = CubicSpline(wide.times, x)
        return spline(old + late[system]) - spline(old)

    changed: dict[str, Any] = {}
    if "encoders" in late:
        names, device = trial.coordinates, trial.coordinates.device_columns
        if has_encoders(trial):
            for name in ("q", "v", "a"):
                x = changed[name] = getattr(trial, name).copy()
                x[:, device] += moved(
                    getattr(wide, name)[:, device], "encoders"
                )
        if trial.moments is not None:
            change = moved(wide.device_moments, "encoders")
            changed["moments"] = trial.moments + shared_moments(names, change)
        if trial.friction is not None:
            change = moved(wide.friction, "encoders")
            changed["friction"] = trial.friction + change
    if "pressure" in late:
        changed["cuffs"] = {
            cuff: replace(
                force,
                normal=force.normal
                + moved(wide.cuffs[cuff].normal, "pressure"),
            )
            for cuff, force in trial.cuffs.items()
        }
    words = dict(trial.provenance.get("clocks", {}))
    for clock in own:
        if clock.system in words:
            doubt = "" if clock.sure else ", unsure"
            words[clock.system] = clock.sentence + doubt
    said = {
        "delays_s": trial.lags_s | {c.system: c.lag_s for c in own},
        "shifted_s": gone | {k: gone.get(k, 0.0) + x for k, x in late.items()},
        "clocks": words,
    }
    provenance = trial.provenance | said
    return replace(trial, **changed, provenance=provenance, around=wide)


def settle(
    trials: Sequence[Trial],
    pose: Callable[..., PhaseProblem],
    title: str,
) -> tuple[PhaseResult | None, list[Clock]]:
    """Find the clocks of trials by solving them again and again.

    The error model shifts readings to first order, by rates that hold their
    noise. So trials are solved with readings as recorded, and then on the
    clocks found, with the solution's rates, until the lags stay.

    Args:
        trials: as recorded.
        pose: makes the phase from `trials` and, if any, their `solved` ones.
        title: beginning of every line of progress.

    Returns:
        The last result, None if no clock is unknown; and the clocks, none if
        it failed, less sure if lags still move.
    """
    recorded = {t.name for t in trials if t.lags_s}
    result, found = None, []
    for number in range(_PASSES):
        now = [retimed(t, found) for t in trials]
        solved = () if result is None else result.trials
        problem = pose(trials=now, solved=solved)
        if not any(u.trial in recorded for u in problem.errors.unknowns):
            return None, []
        again = problem.solve(on_iterate=SolveWatch(title), near=result)
        if result is not None:
            add_up(again.solution, result.solution)
        result = again
        if not result.success:
            return result, []
        lags = {t.name: t.lags_s for t in now}
        found = clocks_of(now, posterior(result))
        off = [abs(c.lag_s - lags[c.trial][c.system]) for c in found]
        if number > 0 and all(  # the first has the rates of readings
            x < max(_SETTLED * c.half_width_s, _SETTLED_S)
            for x, c in zip(off, found, strict=True)
        ):
            return result, found
    # They may be as far off as they still move.
    return result, [
        replace(c, sd_s=float(np.hypot(c.sd_s, x)))
        for x, c in zip(off, found, strict=True)
    ]


class Timing(InteractionCalibration):
    """Phase B of trials to be predicted, to find their clocks.

    The calibration is the prior of cuffs and errors. That of the cuffs is
    widened by what a bushing cannot represent: under load they stiffen or slip.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated, with its posterior.
        settings: Phase B's.
        solved: solutions of the trials, see `ErrorModel`.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: InteractionSettings,
        solved: Sequence[Trial] = (),
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
            solved=solved,
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
        trials: recorded, as they were solved; their provenance speaks for a
            clock not in `found`.
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
            off = abs(clock.lag_s - lag)
            if off > max(limit := clock.half_width_s, _SETTLED_S):
                far = 1e3 * off, 1e3 * limit, "ms"
                text += (
                    f", but readings were shifted by {1e3 * lag:+.0f} ms: a "
                    f"rough value; set {_GIVEN[system]} of this trial to it, "
                    "and run again"
                )
                made.append(Check("clocks", False, *far, where, text, "note"))
    return made
