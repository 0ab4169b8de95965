"""The figure of a design: forces of each cuff before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib
from matplotlib.figure import Figure

from drake_exo.contact.bushing import NORMAL
from drake_exo.report.figures import STYLE

if TYPE_CHECKING:
    from drake_exo.measurement.trial import Trial

_BEFORE, _AFTER = "#1f6fb4", "#c8102e"


def forces_figure(designed) -> Figure:
    """Normal forces over time: a row for each cuff, a column for each trial.

    Args:
        designed: a `designing.Designed`.
    """
    wearers = list(designed.before)
    pairs = [
        (name, before, after)
        for name in wearers
        for before, after in zip(
            designed.before[name], designed.after[name], strict=True
        )
    ]
    cuffs = list(designed.peaks)
    built: dict[str, dict[str, Trial]] = {
        name: {t.name: t for t in trials}
        for name, trials in designed.measured.items()
    }
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            (2.2 * len(pairs) + 0.6, 1.9 * len(cuffs) + 0.5),
            layout="constrained",
        )
        axes = figure.subplots(
            len(cuffs), len(pairs), sharex="col", sharey="row", squeeze=False
        )
        for column, (name, before, after) in enumerate(pairs):
            for row, cuff in enumerate(cuffs):
                axis = axes[row, column]
                _draw(axis, cuff, before, after, built.get(name, {}))
                if column == 0:
                    axis.set_ylabel(f"{cuff} [N]")
            axes[0, column].set_title(before.trial.name, fontsize=8)
            axes[-1, column].set_xlabel("time [s]")
        axes[0, 0].legend(fontsize=7)
        marks = designed.verdict().mark
        extrapolated = designed.softened() or any(
            row["extrapolated"] for row in designed.variables()
        )
        title = (
            "EXTRAPOLATED beyond what was calibrated" if extrapolated else ""
        )
        if marks or title:
            text = ". ".join(t for t in (marks, title) if t)
            figure.suptitle(text, color=_AFTER, fontsize=9)
    return figure


def front_figure(rows: list[dict]) -> Figure:
    """Norm of the forces against the device's work.

    Args:
        rows: as `designing.front` gives them.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure((4.2, 3.2), layout="constrained")
        axis = figure.subplots()
        axis.plot(
            [row["work_j"] for row in rows],
            [row["norm_n"] for row in rows],
            "o-",
            color=_AFTER,
            ms=4,
        )
        axis.set_xlabel("work of the device [J]")
        axis.set_ylabel("norm of the cuffs' forces [N]")
    return figure


def _draw(axis, cuff: str, before, after, built) -> None:
    """One cuff in one trial."""
    for moved, color, label in (
        (before, _BEFORE, "today"),
        (after, _AFTER, "design"),
    ):
        trial = moved.trial
        force = trial.cuffs[cuff].normal
        axis.plot(trial.times, force, color=color, lw=1.4, label=label)
    if after.bands is not None:
        width = after.bands.cuffs[cuff][:, NORMAL]
        force = after.trial.cuffs[cuff].normal
        axis.fill_between(
            after.trial.times,
            force - width,
            force + width,
            color=_AFTER,
            alpha=0.15,
            lw=0,
        )
    if cuff in before.measured.cuffs:
        axis.plot(
            before.measured.times,
            before.measured.cuffs[cuff].normal,
            color="0.15",
            lw=1.0,
            label="measured today",
        )
    trial = built.get(before.trial.name)
    if trial is not None and cuff in trial.cuffs:
        axis.plot(
            trial.times,
            trial.cuffs[cuff].normal,
            color="0.15",
            lw=1.0,
            ls="--",
            label="measured as built",
        )
