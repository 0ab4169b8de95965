"""Results of earlier commands, found on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drake_exo.calibration.results import read_trial
from drake_exo.errors import InputError
from drake_exo.files.output import read_json
from drake_exo.files.verdict import SOLVED, is_accepted, stored, stored_mark
from drake_exo.measurement.trial import Trial

_LARGEST = 1e30  # of a score
_PHASES = ("foot-ground", "interaction", "prediction")


@dataclass(frozen=True)
class Results:
    """What one phase left in a folder.

    Attributes:
        folder: where.
        summary: its summary.json.
    """

    folder: Path
    summary: dict[str, Any]

    @property
    def phase(self) -> str:
        """foot-ground, interaction or prediction."""
        return self.summary["phase"]

    @property
    def scale(self) -> float:
        """Of the interaction, in a prediction."""
        return self.summary.get("scale_interaction", 1.0)

    @property
    def label(self) -> str:
        """The paper's name for a prediction, or one that tells it apart."""
        parts = ["C1" if self.scale == 1.0 else "C2"]
        if self.scale not in (1.0, 1.4):
            parts.append(f"x{self.scale:g}")
        objective = self.summary.get("objective") or "tracking"
        if objective != "tracking":
            parts.append(objective)
        if self.summary.get("controller"):
            parts.append(self.summary["controller"].rpartition(":")[2])
        return " ".join(parts)

    @property
    def mark(self) -> str:
        """What has to stand wherever it is shown; empty where it holds."""
        return stored_mark(self.summary)

    @property
    def is_solved(self) -> bool:
        """Whether every solve met its tolerances."""
        return bool(self.summary.get("success"))

    @property
    def not_solved(self) -> list[str]:
        """Names of trials of a prediction that were not solved."""
        solves = self.summary.get("solves", [])
        return [s["trial"] for s in solves if not s.get("success")]

    def pairs(self) -> list[tuple[Trial, Trial]]:
        """Every scored trial as found, and as measured."""
        return [
            (
                read_trial(self.folder, row["trial"]),
                read_trial(self.folder, row["trial"], "measured"),
            )
            for row in self.summary["rmsd"]
        ]


def is_design(folder: Path) -> bool:
    """Whether `drake-exo design` wrote a folder."""
    path = Path(folder) / "summary.json"
    if not path.exists():
        return False
    found = read_json(path, "run the command that wrote it again")
    return isinstance(found, dict) and found.get("phase") == "design"


def gather(folder: Path, accept: Sequence[str] = ()) -> list[Results]:
    """All results under a folder, in the order of their paths.

    Args:
        folder: to look through.
        accept: "solved" lets pass what was not solved, marked.

    Raises:
        InputError: there are none, a summary cannot be read, or one is of a
            solve that failed.
    """
    found = []
    for path in sorted(Path(folder).rglob("summary.json")):
        summary = read_json(path, "run the command that wrote it again")
        if isinstance(summary, dict) and summary.get("phase") in _PHASES:
            _check(path, summary)
            found.append(Results(path.parent, summary))
    if not found:
        raise InputError(
            f"{folder}: holds no results; give a folder that 'drake-exo "
            "calibrate' or 'drake-exo predict' wrote"
        )
    failed = [r for r in found if not r.is_solved]
    if failed and not is_accepted(SOLVED, accept):
        raise InputError(
            f"{failed[0].folder}: is {failed[0].mark or 'not solved'}; solve "
            f"it again, or show it, marked, with --accept {SOLVED}"
        )
    return found


def check_one_study(found: Sequence[Results]) -> None:
    """Refuse what would be mixed up in one table.

    Raises:
        InputError: results are of several subjects, or two have one label.
    """
    first: dict[tuple, Results] = {}
    for r in found:
        if r.summary["subject"] != found[0].summary["subject"]:
            raise InputError(
                f"{r.folder}: is of subject {r.summary['subject']!r}, "
                f"{found[0].folder} of {found[0].summary['subject']!r}; report "
                "a folder of one subject"
            )
        label = r.label if r.phase == "prediction" else ""
        other = first.setdefault((r.phase, label), r)
        if other is not r:
            raise InputError(
                f"{r.folder}: and {other.folder} are both {label or r.phase}; "
                "report a folder with one of them"
            )


def _check(path: Path, summary: dict[str, Any]) -> None:
    """Refuse a summary that is not as a phase writes it."""
    try:
        stored(summary)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    rows = summary.get("rmsd")
    solves = summary.get("solves", [])
    whole = (
        isinstance(rows, list)
        and isinstance(solves, list)
        and all(
            isinstance(s, dict) and isinstance(s.get("trial"), str)
            for s in solves
        )
        and isinstance(summary.get("subject"), str)
        and _is_number(summary.get("scale_interaction", 1.0))
        and _is_objective(summary)
        and isinstance(summary.get("controller"), str | None)
        and all(isinstance(r, dict) and _are_scores(r) for r in rows)
        and all(isinstance(r.get("trial"), str) for r in rows)
        and isinstance(summary.get("measured_sd"), dict)
        and _are_scores(summary["measured_sd"])
    )
    if not whole:
        raise InputError(
            f"{path}: is not as a phase writes it (subject, rmsd, "
            "measured_sd); run the command that wrote it again"
        )


def _is_objective(summary: dict[str, Any]) -> bool:
    """A prediction's is a name, a calibration's the value reached."""
    found = summary.get("objective")
    if summary["phase"] == "prediction":
        return isinstance(found, str | None)
    return found is None or _is_number(found)


def _are_scores(value: Any) -> bool:
    """Numbers or nothing, by name, in groups or not."""
    if isinstance(value, dict):
        return all(k == "trial" or _are_scores(v) for k, v in value.items())
    return value is None or _is_number(value)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) < _LARGEST
