"""Results of a batch as one long table: a row a number."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from drake_exo.batch.run import Batch
from drake_exo.batch.tasks import Task
from drake_exo.errors import InputError
from drake_exo.files.output import read_json

_AGAIN = "run the batch again"
# Ends of keys that tell the unit of the numbers below them.
_UNITS = {
    "_deg_s": "deg/s",
    "_deg": "deg",
    "_nm": "N m",
    "_mm": "mm",
    "_kg": "kg",
    "_m": "m",
    "_n": "N",
    "_s": "s",
}
# Parts of summary.json that are lists of one dictionary for each trial.
_OF_TRIALS = ("rmsd", "rmsd_uncalibrated", "band_coverage", "audit", "solves")
_NOT_TOLD = frozenset(
    ("evaluations", "binding_bounds", "worst_constraints", "settings")
)


@dataclass(frozen=True)
class Row:
    """A number of a batch.

    Attributes:
        subject: or sole, as the batch calls it.
        trial: "" of what is not of one trial.
        phase: the step.
        signal: what the number is of.
        value: None in the row of a task without results.
        unit: of it.
        verdict: of the task; its sentence where it does not hold.
        variant: what the sweep changed.
        folder: of the results, below the batch's.
    """

    subject: str
    trial: str
    phase: str
    signal: str
    value: float | None
    unit: str
    verdict: str
    variant: str
    folder: str


COLUMNS = tuple(f.name for f in fields(Row))


def rows_of(batch: Batch) -> list[Row]:
    """Every number of every task, and a row for each without results.

    Raises:
        InputError: a result file is damaged.
    """
    found = []
    for task in batch.tasks:
        outcome = batch.outcomes[task.name]
        verdict = outcome.verdict
        if outcome.sentence:
            verdict += f": {outcome.sentence}"

        def row(trial, signal, value, unit, task=task, verdict=verdict):
            return Row(
                task.entry,
                trial,
                task.step,
                signal,
                value,
                unit,
                verdict,
                task.variant,
                task.name,
            )

        rows = [row(*number) for number in _numbers(batch.out, task)]
        if outcome.code not in (0, 3):
            rows.insert(0, row("", "", None, ""))
        found += rows
    return found


def _numbers(out: Path, task: Task) -> Iterator[tuple[str, str, float, str]]:
    """(trial, signal, value, unit) of a task's results."""
    folder = out / task.name
    if (folder / "quality.json").is_file():
        yield from _quality(read_json(folder / "quality.json", _AGAIN))
    if (folder / "summary.json").is_file():
        summary = read_json(folder / "summary.json", _AGAIN)
        if not isinstance(summary, dict):
            raise InputError(f"{folder}: summary.json is damaged; {_AGAIN}")
        yield from _summary(summary)


def _quality(found: dict) -> Iterator[tuple]:
    rest = {k: v for k, v in found.items() if k not in ("trials", "standing")}
    yield from _leaves("", rest, "")
    for trial in found.get("trials", []):
        yield from _leaves(str(trial.get("name", "")), trial, "")


def _summary(summary: dict[str, Any]) -> Iterator[tuple]:
    for part in _OF_TRIALS:
        for found in summary.get(part) or []:
            if isinstance(found, dict):
                yield from _leaves(str(found.get("trial", "")), found, part)
    for fold in summary.get("folds") or []:
        yield from _leaves(str(fold["trial"]), fold, "")
    for p in summary.get("parameters") or []:
        name = f"parameters.{p['name']}"
        yield "", name, p["value"], p["unit"]
        if p.get("half_width_95") is not None:
            yield "", f"{name}.half_width_95", p["half_width_95"], p["unit"]
    apart = {*_OF_TRIALS, "folds", "parameters", "checks", "foot_ground"}
    rest = {k: v for k, v in summary.items() if k not in apart}
    yield from _leaves("", rest, "")


def _leaves(trial: str, tree, place: str) -> Iterator[tuple]:
    """Numbers of nested dictionaries, by dotted key."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key not in _NOT_TOLD:
                where = f"{place}.{key}" if place else key
                yield from _leaves(trial, value, where)
    elif isinstance(tree, list):
        if len(tree) <= 3 and all(_is_number(v) for v in tree):
            for k, value in enumerate(tree):
                yield trial, f"{place}.{k}", float(value), unit_of(place)
    elif _is_number(tree):
        yield trial, place, float(tree), unit_of(place)


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def unit_of(signal: str) -> str:
    """By the last part of a dotted name that tells one.

    >>> unit_of("rmsd.velocities_deg_s.exo_hip"), unit_of("rmsd.cop_mm")
    ('deg/s', 'mm')
    """
    for part in reversed(signal.split(".")):
        for end, unit in _UNITS.items():
            if part.endswith(end):
                return unit
    return ""


def write_table(folder: Path, rows: list[Row]) -> list[str]:
    """Write results.csv and, where pyarrow is installed, results.parquet.

    Returns:
        Names of the files.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow("" if x is None else x for x in astuple_of(row))
    replace_file(folder / "results.csv", text.getvalue().encode())
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return ["results.csv"]
    columns = {name: [getattr(row, name) for row in rows] for name in COLUMNS}
    kinds = {name: pyarrow.string() for name in COLUMNS}
    kinds["value"] = pyarrow.float64()
    table = pyarrow.table(columns, schema=pyarrow.schema(list(kinds.items())))
    sink = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(table, sink)
    replace_file(folder / "results.parquet", sink.getvalue().to_pybytes())
    return ["results.csv", "results.parquet"]


def astuple_of(row: Row) -> tuple:
    """The row's cells in the order of `COLUMNS`."""
    return tuple(getattr(row, name) for name in COLUMNS)


def replace_file(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    draft = path.with_name(path.name + ".tmp")
    draft.write_bytes(data)
    os.replace(draft, path)
