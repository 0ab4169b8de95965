"""Figures of a design: device and forces of each cuff, before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from drake_exo.contact.bushing import NORMAL
from drake_exo.contact.strap import EXTRAPOLATED, STIFF
from drake_exo.model.planar_tree import DEVICE
from drake_exo.report.figures import STYLE
from drake_exo.report.tables import rounded

if TYPE_CHECKING:
    from drake_exo.contact.strap import CuffDesign
    from drake_exo.measurement.trial import Trial

_BEFORE, _AFTER = "#1f6fb4", "#c8102e"
_PERSON, _DEVICE = "0.82", "0.35"


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
        # Not every trial has mats of every cuff.
        shown: dict[str, object] = {}
        for axis in axes.flat:
            lines, labels = axis.get_legend_handles_labels()
            shown |= dict(zip(labels, lines, strict=True))
        figure.legend(
            shown.values(),
            shown,
            fontsize=7,
            loc="outside lower center",
            ncols=len(shown),
        )
        _head(figure, designed)
    return figure


def device_figure(designed) -> Figure:
    """Person and device from the side, with cuffs of today and as designed.

    The first wearer at the beginning and at the end of the first trial. A
    cuff is drawn where it holds the limb.

    Args:
        designed: a `designing.Designed`.
    """
    wearer, moved = designed.first
    trial, tree = moved[0].trial, wearer.model.tree
    new = designed.design.contact(wearer.contact).bushings
    told = {c: _told(c, d) for c, d in designed.design.cuffs.items()}
    with matplotlib.rc_context(STYLE):
        figure = Figure((7.2, 4.4), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True, width_ratios=(1.0, 2.2))
        # Side by side, however narrow equal scales make them.
        for axis, side in zip(axes, "EW", strict=True):
            axis.set_anchor(side)
        for axis, row, title in ((axes[0], 0, "start"), (axes[1], -1, "end")):
            q = trial.q[[row]]
            for parent, child in tree.joints.values():
                _draw_link(axis, wearer.model, q, parent, child)
            _draw_ends(axis, wearer.model, q)
            for cuff, (link, _) in tree.cuffs.items():
                old, at = (
                    tree.point_positions(q, link, np.array(b.origin))[0]
                    for b in (wearer.contact.bushings[cuff], new[cuff])
                )
                axis.plot(*old, "o", mfc="none", mec=_BEFORE, ms=9)
                axis.plot(*at, "o", color=_AFTER, ms=6)
                if row == 0:
                    continue
                axis.annotate(
                    told.get(cuff, f"{cuff}: as today"),
                    at,
                    (at[0] + 0.25, at[1]),
                    fontsize=7,
                    va="center",
                    arrowprops={"arrowstyle": "-", "lw": 0.5, "color": "0.5"},
                )
            axis.set_aspect("equal")
            axis.set_title(title, fontsize=8)
            axis.set_xlabel("x [m]")
        axes[1].set_xlim(right=axes[1].get_xlim()[1] + 0.75)
        axes[0].set_ylabel("z [m]")
        axes[1].set_title(trial.name, fontsize=8, loc="right")
        for marker, face, edge, label in (
            ("o", "none", _BEFORE, "cuff today"),
            ("o", _AFTER, _AFTER, "cuff as designed"),
        ):
            axes[0].plot(
                [], [], marker, mfc=face, mec=edge, label=label, ls="none"
            )
        axes[0].plot([], [], color=_PERSON, lw=5, label="person")
        axes[0].plot([], [], color=_DEVICE, lw=1.5, label="device")
        figure.legend(fontsize=7, loc="outside lower center", ncols=4)
        _head(figure, designed)
    return figure


def _head(figure: Figure, designed) -> None:
    """What is an extrapolation, above a figure."""
    beyond = designed.beyond()
    if beyond:
        text = f"{EXTRAPOLATED}: {', '.join(beyond)}"
        figure.suptitle(text, color=_AFTER, fontsize=9)


def _told(cuff: str, design: CuffDesign) -> str:
    """What is to be built of a cuff, in a few words."""
    words = [
        f"{1e3 * abs(size):.0f} mm {up if size > 0.0 else down}"
        for size, up, down in (
            (design.along_m, "up", "down"),
            (design.across_m, "forwards", "backwards"),
        )
        if abs(size) >= 5e-4
    ]
    straps = [
        f"{what} strap {rounded(value)} {unit}"
        for what, value, unit in (
            ("normal", design.strap_normal_n_m, "N/m"),
            ("tangential", design.strap_tangential_n_m, "N/m"),
            ("rotational", design.strap_rotational_nm_rad, "N m/rad"),
        )
        if value is not None and value < STIFF[unit]
    ]
    said = [*words, *straps] or ["as today"]
    return f"{cuff}: " + "\n    ".join(said)


def _draw_link(axis, model, q, parent: str, child: str) -> None:
    """From one joint to the next."""
    tree = model.tree
    ends = [tree.point_positions(q, b, np.zeros(2))[0] for b in (parent, child)]
    device = child.startswith(DEVICE)
    axis.plot(
        *np.transpose(ends),
        color=_DEVICE if device else _PERSON,
        lw=1.5 if device else 5,
        marker="o" if device else None,
        ms=3,
        solid_capstyle="round",
        zorder=2 if device else 1,
    )


def _draw_ends(axis, model, q) -> None:
    """What no joint ends: trunk and head as long as they are, the sole."""
    tree, human = model.tree, model.human
    ends = {"pelvis": [(0.0, 0.0), (0.0, human.pelvis.length_m)]}
    ends["foot"] = [human.heel_m, (0.0, 0.0), human.toe_m]
    for body, points in ends.items():
        if body in tree.names:
            p_W = [tree.point_positions(q, body, p)[0] for p in points]
            axis.plot(
                *np.transpose(p_W), color=_PERSON, lw=5, solid_capstyle="round"
            )


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


FIGURES = {"forces.png": forces_figure, "device.png": device_figure}
