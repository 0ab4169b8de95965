"""`drake-exo report`: the paper's tables and figures from results on disk.

Looks through DIR for what `calibrate` and `predict` wrote and makes, in
DIR/report: Table II (calibration) and Table III (prediction) as text and CSV,
and Figures 2 to 7. The paper's own figures stand beside those of the virtual
subject.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from drake_exo.files.output import prepare_output_folder
from drake_exo.papers.serrancoli import PAPER, VIRTUAL_SUBJECT
from drake_exo.report import figures
from drake_exo.report.gathering import Results, gather
from drake_exo.report.tables import (
    format_table,
    lookup,
    mean_and_sd,
    rmsd_signals,
)


def add_parser(subparsers) -> None:
    """Add `report` to the command line."""
    parser = subparsers.add_parser(
        "report",
        help="tables and figures of the paper from results",
        description=__doc__,
    )
    parser.add_argument("results", type=Path, metavar="DIR")
    parser.add_argument(
        "--out", type=Path, help="instead of DIR/report", metavar="FOLDER"
    )
    parser.add_argument(
        "--force", action="store_true", help="replace an earlier report"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the report and print its tables.

    Raises:
        InputError: there are no results in DIR, or a report already.
    """
    found = gather(args.results)
    out = args.out or args.results / "report"
    with prepare_output_folder(out, args.force) as folder:
        texts = []
        for title, name, runs in (
            ("Table II: calibration", "table_2", _calibrations(found)),
            ("Table III: prediction", "table_3", _predictions(found)),
        ):
            if runs:
                rows = comparison(runs)
                _write_csv(folder / f"{name}.csv", rows)
                text = f"{title}, RMSD\n{format_table(rows[0], rows[1:])}"
                texts.append(text)
        texts += _starts(_predictions(found))
        texts += _changes(_predictions(found))
        for text in texts:
            print(text)
        (folder / "tables.txt").write_text(
            "\n\n".join(texts) + "\n", encoding="utf-8"
        )
        _draw(folder, found)
    print(f"report in {out}")
    return 0


def _calibrations(found: list[Results]) -> dict[str, Results]:
    names = {"foot-ground": "A", "interaction": "B"}
    runs = {names[r.phase]: r for r in found if r.phase in names}
    return dict(sorted(runs.items()))


def _predictions(found: list[Results]) -> dict[str, Results]:
    return {r.label: r for r in found if r.phase == "prediction"}


def comparison(runs: dict[str, Results]) -> list[list]:
    """Rows of a table over several runs, the first is the header.

    Mean and SD over trials of each, one standard deviation over the measured
    trials, and the paper's figure for the virtual subject.
    """
    every = [s for r in runs.values() for s in r.summary["rmsd"]]
    last = list(runs.values())[-1].summary
    beside = last["subject"] == VIRTUAL_SUBJECT
    header = ["signal"]
    for label in runs:
        header += [f"{label} mean", f"{label} SD"]
    header.append("measured SD")
    if beside:
        header += [f"paper {label}" for label in runs]
    rows = [header]
    for label, path in rmsd_signals(every):
        row = [label]
        for r in runs.values():
            values = [lookup(s, path) for s in r.summary["rmsd"]]
            row += mean_and_sd(values)
        row.append(lookup(last["measured_sd"], path))
        if beside:
            for name in runs:
                texts = PAPER.get(name, {})
                row.append(texts.get(path[-1], texts.get(path[0], "")))
        rows.append(row)
    return rows


def _starts(runs: dict[str, Results]) -> list[str]:
    """What stands for the chair while a predicted movement begins."""
    starts = {label: r.summary.get("starts_from") for label, r in runs.items()}
    return [f"{k}: movements start from {v}" for k, v in starts.items() if v]


def _changes(runs: dict[str, Results]) -> list[str]:
    """How much worse the scaled interaction predicts, force by force."""
    base = runs.get("C1")
    texts = []
    for label, run in runs.items():
        if base is None or run is base or run.scale == 1.0:
            continue
        rows = []
        for name in ("pelvis", "thigh", "shank"):
            pair = [
                mean_and_sd(
                    [
                        lookup(s, ("interaction_n", name))
                        for s in r.summary["rmsd"]
                    ]
                )[0]
                for r in (base, run)
            ]
            if None not in pair:
                rows.append([name, *pair, pair[1] / pair[0]])
        if rows:
            header = ["normal force RMSD [N]", "C1", label, "ratio"]
            texts.append(
                f"Interaction scaled by {run.scale:g} (the paper: 2 to 5 "
                "times worse at pelvis and thigh)\n"
                + format_table(header, rows)
            )
    return texts


def _write_csv(path: Path, rows: list[list]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in rows:
            writer.writerow(["" if cell is None else cell for cell in row])


def _draw(folder: Path, found: list[Results]) -> None:
    """Figures 2 to 7, as far as there are results."""
    calibrated = _calibrations(found)
    if "A" in calibrated:
        runs, trials = calibrated["A"].curves()
        figures.ground_reaction_figure(folder / "figure_2.png", runs, trials)
        figures.kinematics_figure(folder / "figure_3.png", runs, trials)
    if "B" in calibrated:
        runs, trials = calibrated["B"].curves()
        figures.interaction_figure(folder / "figure_4.png", runs, trials)
        figures.moments_figure(folder / "figure_5.png", runs, trials)
    predicted = _predictions(found)
    if not predicted:
        return
    trials = {}
    for r in predicted.values():
        trials |= {t.name: t for t in r.curves()[1]}
    trials = list(trials.values())
    runs = {
        label: _matched(r.curves()[0]["model"], trials)
        for label, r in predicted.items()
    }
    figures.kinematics_figure(folder / "figure_6.png", runs, trials)
    if any(t.normal_force for t in trials):
        figures.interaction_figure(folder / "figure_7.png", runs, trials)


def _matched(trajectories, trials):
    """Trajectories in the order of trials, None where one failed."""
    by_name = {t.name: t for t in trajectories}
    return [by_name.get(t.name) for t in trials]
