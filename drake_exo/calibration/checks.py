"""What a phase's result has to hold; see `files.verdict`."""

from collections.abc import Iterable, Sequence

from drake_exo.calibration.audit import Audit
from drake_exo.calibration.problem import PhaseResult
from drake_exo.files.verdict import SOLVED, Check
from drake_exo.measurement.trial import Trial


def phase_checks(result: PhaseResult, audits: Sequence[Audit]) -> list[Check]:
    """Solved, audit and simulation; as notes bounds and clocks.

    Args:
        result: of a phase.
        audits: of its trials; none after a failed solve.
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
    return made + clock_checks(result.problem.trials)


def clock_checks(trials: Iterable[Trial]) -> list[Check]:
    """Whether the lag of each clock is known, as notes."""
    made = []
    for trial in trials:
        for clock, said in trial.provenance.get("clocks", {}).items():
            sure = not said.endswith("unsure")
            made.append(
                Check(
                    "clocks",
                    sure,
                    where=f"{trial.name}, {clock}",
                    sentence="" if sure else said,
                    level="note",
                )
            )
    return made
