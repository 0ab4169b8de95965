"""What a phase's result has to hold; see `files.verdict`."""

from collections.abc import Iterable, Sequence

from drake_exo.calibration.audit import Audit
from drake_exo.calibration.clocks import LARGEST_DOUBT_S, Clock
from drake_exo.calibration.problem import PhaseResult
from drake_exo.files.verdict import SOLVED, Check
from drake_exo.measurement.trial import Trial


def phase_checks(
    result: PhaseResult, audits: Sequence[Audit], clocks: Sequence[Clock] = ()
) -> list[Check]:
    """Solved, audit and simulation; as notes bounds and clocks.

    Args:
        result: of a phase.
        audits: of its trials; none after a failed solve.
        clocks: that were found with it.
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
            sentence="the data ask for a value beyond its bound"
            if p.name in at_bound
            else "",
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
    """Whether the lag of each clock is known, as notes.

    Args:
        trials: recorded; of a clock that was not found it counts what was
            said when the recording was read.
        found: those that were.
    """
    known = {(c.trial, c.system): c for c in found}
    made = []
    for trial in trials:
        said = trial.provenance.get("clocks", {})
        for system in trial.provenance.get("delays_s", {}):
            clock, doubt = known.get((trial.name, system)), (None, None, "")
            if clock is not None:
                sure, text = clock.sure, clock.sentence
                doubt = 1e3 * clock.half_width_s, 1e3 * LARGEST_DOUBT_S, "ms"
            elif system in said:
                sure, text = not said[system].endswith("unsure"), said[system]
            else:
                continue
            where, text = f"{trial.name}, {system}", "" if sure else text
            made.append(Check("clocks", sure, *doubt, where, text, "note"))
    return made
