"""Two or more results side by side: what they found, how they differ."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.calibration.results import read_trial
from drake_exo.errors import InputError
from drake_exo.files.verdict import stored_mark
from drake_exo.measurement.trial import Trial
from drake_exo.report.gathering import Results, gather
from drake_exo.report.tables import (
    format_table,
    lookup,
    mean_and_sd,
    rmsd_signals,
)

# Keys of summary.json that say how a result was asked for.
_ASKED = ("subject", "settings", "scale_interaction", "controller", "accepted")


@dataclass(frozen=True)
class Comparison:
    """Results of one phase.

    Attributes:
        labels: shortest that tell the folders apart.
        results: of each.
        trials: names of those that all have.
    """

    labels: tuple[str, ...]
    results: tuple[Results, ...]
    trials: tuple[str, ...]

    def text(self) -> str:
        """All tables."""
        parts = [
            ("what differs in settings", self.settings()),
            ("parameters", self.parameters()),
            ("RMSD, mean of the trials that all have", self.rmsd()),
            ("largest forces, mean of these trials", self.forces()),
        ]
        tables = [
            f"{title}\n{self._table(rows)}" for title, rows in parts if rows
        ]
        marks = [f"{name}: {mark}" for name, mark in self.marks().items()]
        return "\n\n".join([*marks, *tables])

    def marks(self) -> dict[str, str]:
        """Label -> mark of each result that does not hold."""
        marks = [stored_mark(r.summary) for r in self.results]
        return {
            label: mark
            for label, mark in zip(self.labels, marks, strict=True)
            if mark
        }

    def _table(self, rows: dict[str, list[str]]) -> str:
        count = max(map(len, rows.values())) - len(self.labels)
        header = ["", *self.labels, *["measured"] * count]
        return format_table(header, [[k, *cells] for k, cells in rows.items()])

    def settings(self) -> dict[str, list[str]]:
        """Dotted key -> what each says, of keys that are not the same."""
        found = []
        for r in self.results:
            asked = {k: r.summary.get(k) for k in _ASKED}
            asked["accepted"] = ", ".join(asked["accepted"] or ()) or None
            if r.phase == "prediction":  # else it is the value reached
                asked["objective"] = r.summary.get("objective")
            found.append(dict(_leaves(asked, "")))
        rows = {}
        for key in dict.fromkeys(key for asked in found for key in asked):
            cells = [_plain(asked.get(key)) for asked in found]
            if len(set(cells)) > 1:
                rows[key] = cells
        return rows

    def parameters(self) -> dict[str, list[str]]:
        """Name and unit -> value and half of the 95 % interval of each."""
        rows: dict[str, list[str]] = {}
        for k, r in enumerate(self.results):
            for p in r.summary.get("parameters", []):
                row = rows.setdefault(
                    f"{p['name']} [{p['unit']}]", ["-"] * len(self.results)
                )
                half = p.get("half_width_95")
                width = "" if half is None else f" ± {half:.2g}"
                row[k] = f"{p['value']:.4g}{width}"
        return rows

    def rmsd(self) -> dict[str, list[str]]:
        """Signal -> mean over the trials that all have, of each."""
        ours = [
            [row for row in r.summary["rmsd"] if row["trial"] in self.trials]
            for r in self.results
        ]
        signals = rmsd_signals([row for rows in ours for row in rows])
        return {
            label: [
                _number(mean_and_sd([lookup(row, path) for row in rows])[0])
                for rows in ours
            ]
            for label, path in signals
        }

    def forces(self) -> dict[str, list[str]]:
        """Signal -> largest value of each, last as measured.

        Of a cuff in the trials in which a mat measured it.
        """
        measured = self.measured()
        runs = [self.found(k) for k in range(len(self.results))] + [measured]
        cuffs = dict.fromkeys(c for run in runs for t in run for c in t.cuffs)
        rows = {
            "ground reaction, vertical [N]": [
                _peak([t.ground.force_z for t in run]) for run in runs
            ]
        }
        for cuff in cuffs:
            # Mats are not on every cuff in every trial: like with like.
            use = [cuff in t.cuffs for t in measured]
            use = use if any(use) else [True] * len(use)
            rows[f"normal force {cuff} [N]"] = [
                _peak(
                    [
                        t.cuffs[cuff].normal
                        for t, wanted in zip(run, use, strict=True)
                        if wanted and cuff in t.cuffs
                    ]
                )
                for run in runs
            ]
        return rows

    def found(self, k: int) -> list[Trial]:
        """The common trials as the k-th result has them."""
        return [read_trial(self.results[k].folder, n) for n in self.trials]

    def measured(self) -> list[Trial]:
        """The common trials as measured, by the first result."""
        folder = self.results[0].folder
        return [read_trial(folder, n, "measured") for n in self.trials]

    def figures(self) -> dict:
        """Curves of all results over the measured ones, by name."""
        from drake_exo.report import figures

        measured = self.measured()
        runs = {label: self.found(k) for k, label in enumerate(self.labels)}
        drawn = {
            "kinematics": figures.kinematics_figure(runs, measured),
            "ground_reaction": figures.ground_reaction_figure(runs, measured),
        }
        if all(t.cuffs for run in runs.values() for t in run):
            drawn["interaction"] = figures.interaction_figure(runs, measured)
        return drawn


def compare(folders: Sequence[str | Path]) -> Comparison:
    """Put results side by side.

    Args:
        folders: at least two, each of one `calibrate` or `predict`.

    Raises:
        InputError: a folder holds no results, or several; or they cannot be
            compared: other phases, other coordinates, no trial in common.
    """
    if len(folders) < 2:
        raise InputError("one result cannot be compared; give two or more")
    results = tuple(_results(Path(folder)) for folder in folders)
    first = results[0]
    for r in results[1:]:
        if r.phase != first.phase:
            raise InputError(
                f"{first.folder} is of phase {first.phase}, {r.folder} of "
                f"{r.phase}; compare results of one phase"
            )
    names = [[row["trial"] for row in r.summary["rmsd"]] for r in results]
    common = tuple(n for n in names[0] if all(n in own for own in names))
    if not common:
        raise InputError(
            f"{first.folder} and {results[-1].folder} have no trial in "
            "common; compare results of the same trials"
        )
    every = [read_trial(r.folder, common[0]).coordinates for r in results]
    for r, coordinates in zip(results, every, strict=True):
        if coordinates.names != every[0].names:
            raise InputError(
                f"{first.folder} and {r.folder} are of models with other "
                "coordinates; compare results of one model"
            )
    return Comparison(_labels([r.folder for r in results]), results, common)


def _results(folder: Path) -> Results:
    """Those of a folder itself, or the only ones below it."""
    found = gather(folder)
    own = [r for r in found if r.folder == folder]
    if not own and len(found) > 1:
        raise InputError(
            f"{folder}: holds {len(found)} results; name one of them, such "
            f"as {found[0].folder}"
        )
    return (own or found)[0]


def _labels(folders: list[Path]) -> tuple[str, ...]:
    """The parts of paths that tell them apart; numbers where none does."""
    parts = [Path(os.path.abspath(f)).parts for f in folders]
    while all(len(p) > 1 for p in parts) and len({p[0] for p in parts}) == 1:
        parts = [p[1:] for p in parts]
    while all(len(p) > 1 for p in parts) and len({p[-1] for p in parts}) == 1:
        parts = [p[:-1] for p in parts]
    labels = ["/".join(p) for p in parts]
    if len(set(labels)) < len(labels):
        labels = [f"{k + 1}: {label}" for k, label in enumerate(labels)]
    return tuple(labels)


def _leaves(tree: Any, place: str):
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _leaves(value, f"{place}.{key}" if place else key)
    else:
        yield place, tree


def _plain(value) -> str:
    if value is None:
        return "-"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _peak(signals: list[np.ndarray]) -> str:
    """Mean of the largest values."""
    peaks = [np.nanmax(np.abs(x)) for x in signals]
    return _number(float(np.mean(peaks)) if peaks else None)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
