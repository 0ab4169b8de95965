"""Whether recordings can be what they are taken for, told before a solve."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from drake_exo.errors import InputError
from drake_exo.files.verdict import Check, Verdict
from drake_exo.measurement.plausibility.body import (
    body_checks,
    standing_checks,
)
from drake_exo.measurement.plausibility.device import (
    between_trials,
    device_checks,
)
from drake_exo.measurement.plausibility.evidence import Evidence
from drake_exo.measurement.plausibility.plates import plate_checks
from drake_exo.measurement.plausibility.wearer import wearer_checks
from drake_exo.measurement.settings import Standing
from drake_exo.measurement.subject import SubjectModel


def plausibility(
    subject: SubjectModel, standing: Standing, evidence: Sequence[Evidence]
) -> tuple[Check, ...]:
    """Judge whether recordings can be what the study takes them for.

    Args:
        subject: fitted to standing.
        standing: names its files.
        evidence: of each trial.

    Returns:
        Checks by the name of "plausibility." and what was looked at, each
        with the file and the likely cause where it does not hold.
    """
    checks = [*standing_checks(subject, standing)]
    for e in evidence:
        checks += [*body_checks(e), *plate_checks(e), *device_checks(e)]
    return (*checks, *between_trials(evidence), *wearer_checks(evidence))


def refuse(checks: Iterable[Check], accepted: Iterable[str], study: str | Path):
    """End where a check fails that nobody accepted.

    Args:
        checks: of `plausibility`.
        accepted: names, or beginnings of them.
        study: for the message.

    Raises:
        InputError: naming the checks, their likely causes and --accept.
    """
    refused = Verdict(tuple(checks), tuple(accepted)).refused
    if not refused:
        return
    # One sentence for each name: the same mistake shows in many trials.
    first = {c.name: c for c in reversed(refused)}
    told = [f"{c.name} ({c.where}): {c.sentence}" for c in first.values()]
    names = " ".join(f"--accept {name}" for name in first)
    raise InputError(
        f"{study}: recordings are not plausible: {'; '.join(told)}; correct "
        f"them, see all with 'drake-exo check', or take them with {names}"
    )
