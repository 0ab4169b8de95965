"""What a result has to hold, and the verdict: one list for every command.

A check of level "fail" that does not hold makes the command end with exit
code 3 (1 where it is the solve itself), unless the user accepts it by name;
one of level "note" is told and changes nothing. A result that does not hold
carries `Verdict.mark` wherever it is shown, accepted or not.
"""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drake_exo.errors import InputError

if TYPE_CHECKING:  # matplotlib takes half a second to load
    from matplotlib.figure import Figure

SOLVED = "solved"
HOLDS, FAILS, UNSOLVED = "holds", "does not hold", "not solved"
NOT_SOLVED_CODE, FAILS_CODE, STOPPED_CODE = 1, 3, 130
_ALL = "all"
_RED, _PLAIN = "\x1b[31m", "\x1b[0m"


@dataclass(frozen=True)
class Check:
    """One thing that a result has to hold.

    Attributes:
        name: by which it is accepted; dotted where several are of one kind.
        holds: whether it does.
        value: what was found, in `unit`; None where it is no number.
        limit: what it was held against, likewise.
        unit: of both.
        where: trial, signal or file.
        sentence: what is wrong and its likely cause; may be empty where the
            check holds.
        level: whether a result that does not hold it fails.
    """

    name: str
    holds: bool
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    where: str = ""
    sentence: str = ""
    level: Literal["fail", "note"] = "fail"


@dataclass(frozen=True)
class Verdict:
    """All checks of a result.

    Attributes:
        checks: in the order in which they were made.
        accepted: names, or beginnings of dotted ones, that the user accepts.

    >>> audit = Check("audit", False, 2.5, 1.0, "N", "rise1")
    >>> made = Verdict((Check("solved", True), audit))
    >>> made.word, made.exit_code, made.mark
    ('does not hold', 3, 'DOES NOT HOLD: audit (rise1, 2.5 N, limit 1 N)')
    >>> Verdict(made.checks, ("audit",)).exit_code
    0
    """

    checks: tuple[Check, ...]
    accepted: tuple[str, ...] = ()

    @property
    def failing(self) -> tuple[Check, ...]:
        """Checks of level "fail" that do not hold, accepted or not."""
        return tuple(
            c for c in self.checks if c.level == "fail" and not c.holds
        )

    @property
    def refused(self) -> tuple[Check, ...]:
        """Those of them that nobody accepted."""
        return tuple(
            c for c in self.failing if not is_accepted(c.name, self.accepted)
        )

    @property
    def holds(self) -> bool:
        """Whether nothing fails, accepted or not."""
        return not self.failing

    @property
    def word(self) -> str:
        """One of "holds", "does not hold" and "not solved"."""
        if any(c.name == SOLVED for c in self.failing):
            return UNSOLVED
        return HOLDS if self.holds else FAILS

    @property
    def exit_code(self) -> int:
        """Of the command: 0, 1 (not solved) or 3 (a check fails).

        What was not solved stays so, accepted or not.
        """
        if self.word == UNSOLVED:
            return NOT_SOLVED_CODE
        return FAILS_CODE if self.refused else 0

    @property
    def mark(self) -> str:
        """One line for figures, tables and pages; empty where all holds."""
        return mark_of(self.word, [_short(c) for c in self.failing])

    def summary(self) -> dict[str, Any]:
        """The keys of summary.json: checks, verdict and accepted."""
        return {
            "checks": [asdict(c) for c in self.checks],
            "verdict": self.word,
            "accepted": list(self.accepted),
        }

    def text(self, color: bool | None = None) -> str:
        """One table: a line for each kind that holds, one for each failure.

        Args:
            color: failures in red; by default on a terminal.
        """
        color = sys.stdout.isatty() if color is None else color
        lines = [f"verdict: {self.word}"]
        lines += [f"  {line}" for line in _aligned(_holding(self.checks))]
        notes = [c for c in self.checks if c.level == "note" and not c.holds]
        lines += [f"  note  {_told(c)}" for c in notes]
        for c in self.failing:
            accepted = is_accepted(c.name, self.accepted)
            line = f"  {'accepted' if accepted else 'FAILS'}  {_told(c)}"
            lines.append(f"{_RED}{line}{_PLAIN}" if color else line)
        if self.refused and self.word != UNSOLVED:
            names = dict.fromkeys(c.name for c in self.refused)
            options = " ".join(f"--accept {name}" for name in names)
            lines.append(f"  to take it all the same: {options}")
        return "\n".join(lines)


def mark_of(word: str, failed: Sequence[str]) -> str:
    """See `Verdict.mark`; of what a file says: its word, what failed."""
    if word == HOLDS:
        return ""
    return f"{word.upper()}: {'; '.join(failed)}"


def joined_mark(marks: Mapping[str, str]) -> str:
    """The mark of what shows several results, whose marks these are by name.

    >>> joined_mark({"a": "", "b": "NOT SOLVED: solved"})
    'DOES NOT HOLD: b: NOT SOLVED: solved'
    """
    told = [f"{name}: {mark}" for name, mark in marks.items() if mark]
    return mark_of(FAILS, told) if told else ""


def write_text(path: Path, text: str, mark: str = "") -> None:
    """Write a text for a reader, under its mark if it has one."""
    text = f"{mark}\n\n{text}" if mark else text
    path.write_text(text + "\n", encoding="utf-8")


def save_figure(path: Path, figure: Figure, mark: str = "") -> None:
    """Write a figure; the same input gives the same bytes.

    Args:
        path: of the picture.
        figure: to be written.
        mark: `Verdict.mark`: across it, under it, and as its description.
    """
    # Without the software's name.
    metadata = {"Software": None}
    if mark:
        _draw_mark(figure, mark)
        metadata["Description"] = mark
    figure.savefig(
        path, metadata=metadata, bbox_inches="tight" if mark else None
    )


def _draw_mark(figure: Figure, mark: str) -> None:
    width, height = figure.get_size_inches()
    style = {"color": "#c8102e", "ha": "center"}
    figure.text(
        0.5,
        0.5,
        mark.partition(":")[0],
        va="center",
        rotation=math.degrees(math.atan2(height, width)),
        fontsize=7.0 * math.hypot(width, height) * 0.6,
        alpha=0.18,
        weight="bold",
        **style,
    )
    lines = textwrap.wrap(mark, int(12 * width))
    figure.text(0.5, -0.02, "\n".join(lines), va="top", fontsize=9, **style)


def stored_mark(summary: Mapping[str, Any]) -> str:
    """The mark of a result by its summary.json; empty where it holds.

    A summary without a verdict, as earlier versions wrote it, is marked.
    """
    found = stored(summary)
    if found is None:
        return mark_of(FAILS, ["written by a version without checks"])
    return found.mark


def stored(summary: Mapping[str, Any]) -> Verdict | None:
    """The verdict that a summary.json holds, None where it holds none.

    Raises:
        InputError: it is damaged.
    """
    if "checks" not in summary:
        return None
    try:
        rows = [Check(**row) for row in summary["checks"]]
        accepted = tuple(map(str, summary.get("accepted", ())))
        whole = all(
            isinstance(r.name, str)
            and isinstance(r.holds, bool)
            and isinstance(r.level, str)
            for r in rows
        )
    except TypeError:
        whole = False
    if not whole:
        raise InputError(
            "checks are not as a command writes them; run it again"
        )
    return Verdict(tuple(rows), accepted)


def is_accepted(name: str, accepted: Iterable[str]) -> bool:
    """Whether a check's name, or a beginning of it, is among the accepted.

    >>> is_accepted("plausibility.mass", ["plausibility"])
    True
    >>> is_accepted("audit", ["plausibility"])
    False
    """
    return any(
        name == a or name.startswith(a + ".") or a == _ALL for a in accepted
    )


def _short(check: Check) -> str:
    parts = [check.where, _amount(check.value, check.unit)]
    if check.limit is not None:
        parts.append(f"limit {_amount(check.limit, check.unit)}")
    inside = ", ".join(p for p in parts if p)
    return f"{check.name} ({inside})" if inside else check.name


def _told(check: Check) -> str:
    return f"{_short(check)}{': ' if check.sentence else ''}{check.sentence}"


def _amount(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.3g} {unit}".rstrip()


def _holding(checks: Iterable[Check]) -> list[tuple[str, ...]]:
    """A row for each kind: the check that came nearest to its limit."""
    groups: dict[str, list[Check]] = {}
    for c in checks:
        if c.holds:
            groups.setdefault(c.name.partition(".")[0], []).append(c)
    rows = []
    for name, group in groups.items():
        nearest = min(group, key=_room)
        count = f"{len(group)} hold" if len(group) > 1 else "holds"
        told = _short(nearest)
        if nearest.name == name:
            told = told.removeprefix(name).strip()
        rows.append((name, count, f"nearest {told}" if told else ""))
    return rows


def _room(check: Check) -> float:
    """How far from its limit, in units of the limit."""
    if check.value is None or check.limit is None:
        return float("inf")
    return abs(check.value - check.limit) / (abs(check.limit) or 1.0)


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max((len(r[i]) for r in rows), default=0) for i in range(2)]
    return [
        f"{a.ljust(widths[0])}  {b.ljust(widths[1])}  {c}".rstrip()
        for a, b, c in rows
    ]
