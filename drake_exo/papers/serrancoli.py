"""Tables and figures of Serrancoli et al., from results on disk.

Beside the virtual subject's numbers stand the paper's: ranges and bounds from
its text (Results and Discussion), since its tables give them for each trial of
another subject.
"""

from collections.abc import Callable
from pathlib import Path

from drake_exo.files.output import joined_mark, save_figure
from drake_exo.report import figures
from drake_exo.report.gathering import (
    Results,
    format_table,
    lookup,
    mean_and_sd,
    not_solved_uncalibrated,
    rmsd_signals,
)

VIRTUAL_SUBJECT = "virtual_subject"

# Phase -> signal or segment -> the paper's RMSD, as text.
PAPER = {
    "A": {
        "angles_deg": "<= 0.8",
        "velocities_deg_s": "<= 6.5",
        "grf_n": "< 10",
        "cop_mm": "< 1",
    },
    "B": {
        "angles_deg": "<= 1.1",
        "velocities_deg_s": "<= 6.8",
        "grf_n": "8.4, worst 22.9",
        "moments_nm": "< 10",
        "pelvis": "5.4",
        "thigh": "2.3",
        "shank": "2.2",
    },
    "C1": {
        "angles_deg": "1.0 to 3.3",
        "velocities_deg_s": "6.1 to 14.3",
        "interaction_n": "<= 13.1",
    },
    "C2": {
        "angles_deg": "like C1",
        "velocities_deg_s": "like C1",
        "pelvis": "> 30",
        "thigh": "> 10",
    },
}


def tables(found: list[Results]) -> tuple[dict[str, list[list]], list[str]]:
    """Tables II and III, and all texts to print.

    Args:
        found: results of calibration and prediction.

    Returns:
        Name of a table -> its rows, header first; and texts to print, the
        tables among them.
    """
    predicted = _predictions(found)
    made, texts = {}, []
    for title, name, runs in (
        ("Table II: calibration", "table_2", _calibrations(found)),
        ("Table III: prediction", "table_3", predicted),
    ):
        if runs:
            rows = made[name] = comparison(runs)
            texts.append(f"{title}, RMSD\n{format_table(rows[0], rows[1:])}")
    return made, [
        *texts,
        *_missing(predicted),
        *_starts(predicted),
        *_changes(predicted),
    ]


def _calibrations(found: list[Results]) -> dict[str, Results]:
    names = {"foot-ground": "A", "interaction": "B"}
    runs = {names[r.phase]: r for r in found if r.phase in names}
    return dict(sorted(runs.items()))


def _predictions(found: list[Results]) -> dict[str, Results]:
    return {r.label: r for r in found if r.phase == "prediction"}


def comparison(runs: dict[str, Results]) -> list[list]:
    """Rows of a table of RMSD, one for each signal, header first.

    Columns of each run: mean and SD over trials, and for a prediction the mean
    with nominal cuffs; a run that does not hold says so in its header. Then
    one standard deviation of the measured trials and, for the virtual subject
    with one leg that stands for both, the paper's numbers.
    """
    every = [s for r in runs.values() for s in r.summary["rmsd"]]
    last = list(runs.values())[-1].summary
    knee = any(path[-1] == "knee" for _, path in rmsd_signals(every))
    beside = knee and last["subject"] == VIRTUAL_SUBJECT
    header = ["signal"]
    for label, run in runs.items():
        name = f"{label} ({run.mark.partition(':')[0]})" if run.mark else label
        header += [f"{name} mean", f"{name} SD"]
        if run.uncalibrated:
            header.append(f"{label} uncalibrated")
    header.append("measured SD")
    if beside:
        header += [f"paper {label}" for label in runs]
    rows = [header]
    for label, path in rmsd_signals(every):
        row = [label]
        for r in runs.values():
            values = [lookup(s, path) for s in r.summary["rmsd"]]
            row += mean_and_sd(values)
            if r.uncalibrated:
                usual = [lookup(s, path) for s in r.uncalibrated]
                row.append(mean_and_sd(usual)[0])
        row.append(lookup(last["measured_sd"], path))
        if beside:
            for name in runs:
                texts = PAPER.get(name, {})
                row.append(texts.get(path[-1], texts.get(path[0], "")))
        rows.append(row)
    return rows


def _missing(runs: dict[str, Results]) -> list[str]:
    """Lines that name trials which were not solved and are in no mean."""
    sets = []
    for label, r in runs.items():
        sets.append((label, r.summary["rmsd"], r.not_solved))
        if r.uncalibrated:
            failed = not_solved_uncalibrated(r.summary)
            sets.append((f"{label} uncalibrated", r.uncalibrated, failed))
    return [
        f"{label}: means are of {len(rows)} trials; not solved: "
        + ", ".join(failed)
        for label, rows, failed in sets
        if failed
    ]


def _starts(runs: dict[str, Results]) -> list[str]:
    """Lines that say from what the predicted movements start."""
    starts = {label: r.summary.get("starts_from") for label, r in runs.items()}
    return [f"{k}: movements start from {v}" for k, v in starts.items() if v]


def _changes(runs: dict[str, Results]) -> list[str]:
    """Tables of how much worse scaled cuffs predict each normal force."""

    def mean(run: Results, name: str) -> float | None:
        path = "interaction_n", name
        return mean_and_sd([lookup(s, path) for s in run.summary["rmsd"]])[0]

    base = runs.get("C1")
    texts = []
    for label, run in runs.items():
        if base is None or run is base or run.scale == 1.0:
            continue
        rows = []
        for name in ("pelvis", "thigh", "shank"):
            pair = mean(base, name), mean(run, name)
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


def draw_figures(folder: Path, found: list[Results]) -> None:
    """Draw those of Figures 2 to 7 that there are results for."""
    calibrated = _calibrations(found)
    shown: list[tuple[int, Callable, dict[str, Results]]] = []
    for number, phase, draw in (
        (2, "A", figures.ground_reaction_figure),
        (3, "A", figures.kinematics_figure),
        (4, "B", figures.interaction_figure),
        (5, "B", figures.moments_figure),
    ):
        if phase in calibrated:
            shown.append((number, draw, {"model": calibrated[phase]}))
    predicted = _predictions(found)
    if predicted:
        shown.append((6, figures.kinematics_figure, predicted))
        if any(t.cuffs for t in _curves(predicted)[1]):
            shown.append((7, figures.interaction_figure, predicted))
    for number, draw, own in shown:
        mark = joined_mark({label: r.mark for label, r in own.items()})
        path = folder / f"figure_{number}.png"
        save_figure(path, draw(*_curves(own)), mark)


def _curves(results: dict[str, Results]):
    """Runs and measured trials as `figures` takes them; None for failures."""
    pairs = {label: r.pairs() for label, r in results.items()}
    trials = {m.name: m for run in pairs.values() for _, m in run}
    runs = {}
    for label, run in pairs.items():
        found = {t.name: t for t, _ in run}
        runs[label] = [found.get(name) for name in trials]
    for label, result in results.items():
        usual = [result.uncalibrated_trial(name) for name in trials]
        if any(usual):
            runs[f"{label} uncalibrated"] = usual
            break  # scaled ones lie so close that they would only hide it
    return runs, list(trials.values())
