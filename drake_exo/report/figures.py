"""Draws figures of movements, computed over measured, and of contact laws.

A run is a list of solved trials with a label; several runs (C1 and C2) are
drawn over the same measured curves, in one column for each trial. Figures of a
design show the device and the force of each cuff, before and after.

The paper's Figures 8 and 9 show curves of contact laws without their
parameters; here they are stated in each figure and can be chosen on the
command line (`drake-exo contact --out DIR`).
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, pairwise
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from drake_exo.calibration.uncertainty import Bands
from drake_exo.contact.hunt_crossley import (
    LAWS,
    friction_coefficient,
    paper_stiffness,
    sphere_force,
    sphere_force_derivatives,
)
from drake_exo.contact.strap import EXTRAPOLATED, STIFF, CuffDesign
from drake_exo.errors import InputError, check_type
from drake_exo.files.output import (
    COLOURS,
    STYLE,
    rounded,
    save_figure,
    write_json,
)
from drake_exo.files.schema import quantity
from drake_exo.measurement.events import heel_strikes
from drake_exo.measurement.quality import TrialQuality
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.assembly import SIDES, without_side
from drake_exo.model.coordinates import Coordinates

Runs = Mapping[str, Sequence[Trial | None]]

_MEASURED = {"color": "0.15", "lw": 1.6}
_MEASURED_DEVICE = {"color": "0.6", "lw": 1.6}
# The model is blue, in C2 orange (the paper's are red), uncalibrated green.
_MODEL, _SECOND, _UNCALIBRATED, *_MORE = COLOURS
_RUNS = (_MODEL, _SECOND, *_MORE)
_DASHES = ("--", "-.", (0, (5, 1, 1, 1, 1, 1)))  # the device's are ":"


def draw_figures(
    folder: Path,
    found: Sequence[Trial],
    measured: Sequence[Trial],
    uncalibrated: Sequence[Trial | None] = (),
    bands: Sequence[Bands | None] = (),
    mark: str = "",
) -> None:
    """Draw the figures of one phase that there are signals for, to a folder."""
    figures = plot_trials(found, measured, uncalibrated, bands)
    for name, figure in figures.items():
        save_figure(folder / f"{name}.png", figure, mark)


def plot_trials(
    found: Sequence[Trial],
    measured: Sequence[Trial],
    uncalibrated: Sequence[Trial | None] = (),
    bands: Sequence[Bands | None] = (),
) -> dict[str, Figure]:
    """Figures of solved trials over the measured ones.

    Args:
        found: solved trials.
        measured: the same trials in the same order.
        uncalibrated: the same predicted with nominal cuffs, None if not solved.
        bands: 95 % bands around `found`, if any.

    Returns:
        "ground_reaction", "kinematics" and, where there are such signals,
        "interaction" and "moments" (not of a person and a device that do not
        touch, as in Phase A: theirs mean nothing); "gait" where a foot comes
        down twice: each leg from heel strike to the next [%].

    Raises:
        InputError: `found` and `measured` are not the same trials.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> list(plot_trials(trials, trials))
    ['ground_reaction', 'kinematics']
    """
    check_type(found, Sequence, "found")
    check_type(measured, Sequence, "measured")
    if not found or len(found) != len(measured):
        raise InputError(
            f"there are {len(found)} trials found and {len(measured)} "
            "measured; give as many of each, and one at least"
        )
    names = [[trial.name for trial in run] for run in (found, measured)]
    if names[0] != names[1]:
        raise InputError(
            f"trials found are {', '.join(names[0])}, but measured are "
            f"{', '.join(names[1])}; give the same in the same order"
        )
    runs: Runs = {"model": found}
    if any(t is not None for t in uncalibrated):
        runs = {"calibrated": found, "uncalibrated": uncalibrated}
    drawn = {
        "ground_reaction": ground_reaction_figure(runs, measured),
        "kinematics": kinematics_figure(runs, measured, bands),
    }
    if found[0].cuffs:
        drawn["interaction"] = interaction_figure(runs, measured, bands)
    touch = found[0].cuffs or not found[0].coordinates.device
    if touch and measured[0].moments is not None:
        drawn["moments"] = moments_figure(runs, measured)
    if cycles := _cycles(measured):
        drawn["gait"] = _gait_figure(runs, measured, cycles)
    return drawn


def ground_reaction_figure(runs: Runs, trials: Sequence[Trial]) -> Figure:
    """Forces and centre of pressure (Fig. 2)."""
    return _drawn(runs, trials, _ground_rows(trials[0]))


def _ground_rows(trial: Trial) -> list[tuple]:
    rows = []
    for side in trial.soles:
        foot = "" if side == "both" else f"{side} "
        for name, what in (
            ("$F_x$ [N]", "force_x"),
            ("$F_z$ [N]", "force_z"),
            ("CoP $x$ [m]", "cop_x"),
        ):
            rows.append(
                (foot + name, lambda t, s=side, w=what: getattr(t.soles[s], w))
            )
    return rows


def kinematics_figure(
    runs: Runs, trials: Sequence[Trial], bands: Sequence[Bands | None] = ()
) -> Figure:
    """Joint angles and velocities of human and exoskeleton (Figs. 3, 6).

    Args:
        runs: label -> solved trials.
        trials: as measured.
        bands: 95 % bands around the first run, if any.
    """
    rows = [
        row for signal in _JOINTS for row in _joint_rows(trials[0], *signal)
    ]
    return _drawn(runs, trials, rows, height=1.35, bands=bands)


_JOINTS = (Trial.coordinate, "°"), (Trial.velocity, "°/s")


def _joint_rows(trial: Trial, read, unit: str) -> list[tuple]:
    """Rows of all joints; a device's is in that of the human's beside it.

    There it has the human's sense, in which a device may count its own angle
    backwards.
    """
    names = trial.coordinates
    beside = {names.follows(name): name for name in names.device}
    beside.pop(None, None)  # of a joint that no human joint moves
    alone = [name for name in names.device if name not in beside.values()]
    rows = []
    for joint in (*names.human, *alone):
        drawn = {joint: 1.0}
        if own := beside.get(joint):
            turns = names.turned_by[names.device.index(own)]
            is_back = turns[names.human.index(joint)] < 0.0
            drawn[own] = -1.0 if is_back else 1.0
        signals = [
            lambda t, name=name, sense=sense: sense * np.rad2deg(read(t, name))
            for name, sense in drawn.items()
        ]
        rows.append((f"{_joint_name(names, joint)} [{unit}]", *signals))
    return rows


def _joint_name(names: Coordinates, joint: str) -> str:
    """Name of a joint on the axis of its own row."""
    if joint in names.device:
        return f"exo. {joint.removeprefix('exo_')}"
    return joint


def interaction_figure(
    runs: Runs, trials: Sequence[Trial], bands: Sequence[Bands | None] = ()
) -> Figure:
    """Normal force of each cuff on the human (Figs. 4, 7).

    Args:
        runs: label -> solved trials.
        trials: as measured.
        bands: 95 % bands around the first run, if any.
    """
    found = [t for run in runs.values() for t in run if t is not None]
    return _drawn(runs, trials, _cuff_rows(*found), bands=bands)


def _cuff_rows(*found: Trial) -> list[tuple]:
    def signal(cuff):
        return lambda t: t.cuffs[cuff].normal if cuff in t.cuffs else None

    # Models that are compared may have different cuffs.
    cuffs = dict.fromkeys(cuff for trial in found for cuff in trial.cuffs)
    return [(f"{cuff} normal [N]", signal(cuff)) for cuff in cuffs]


def _shade(axes, rows, trial: Trial | None, band: Bands | None) -> None:
    """Shade the rows' 95 % bands, as `Bands.coverage` counts them.

    They show what instruments would read; where there are none, the movement.
    """
    if trial is None or band is None:
        return
    names, cuffs = trial.coordinates, trial.cuffs.items()
    middle = SimpleNamespace(
        coordinates=names,
        q=trial.q + band.off_q,
        v=trial.v + band.off_v,
        cuffs={
            c: CuffForce(f.normal + band.off_mats.get(c, 0.0)) for c, f in cuffs
        },
    )
    width = SimpleNamespace(
        coordinates=names,
        q=np.where(np.isfinite(band.seen_q), band.seen_q, band.q),
        v=np.where(np.isfinite(band.seen_v), band.seen_v, band.v),
        cuffs={c: CuffForce(band.normal(c)) for c, _ in cuffs},
    )
    for ax, (_, *signals) in zip(axes, rows, strict=False):
        for signal in signals:
            at = signal(middle)
            if at is not None:
                _draw_band(ax, trial.times, at, signal(width), _MODEL)


def _draw_band(ax, times, middle, width, color: str) -> None:
    """Shade a 95 % band, arrays (n,)."""
    ax.fill_between(
        times,
        middle - width,
        middle + width,
        color=color,
        alpha=0.15,
        lw=0.0,
        label="95 % band",
    )


def overview_figure(
    found: Trial, measured: Trial, band: Bands | None = None
) -> Figure:
    """Figure of one predicted trial over the measured one.

    Columns hold joint angles, their velocities, normal forces of the cuffs
    (where there are any) and the ground reaction.

    Args:
        found: as predicted.
        measured: the same trial.
        band: 95 % band around movement and forces, if any.
    """
    cuffs = _cuff_rows(found)
    columns = [_joint_rows(measured, *signal) for signal in _JOINTS]
    columns += [cuffs] if cuffs else []
    columns.append(_ground_rows(measured))
    count = max(map(len, columns))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.9 * len(columns), 1.6 * count + 0.6))
        axes = figure.subplots(count, len(columns), sharex=True, squeeze=False)
        for rows, column in zip(columns, axes.T, strict=True):
            for ax in column[len(rows) :]:
                ax.remove()
            _fill(column, {"predicted": found}, measured, rows)
            if rows is not columns[-1]:
                _shade(column, rows, found, band)
            column[len(rows) - 1].set_xlabel("time [s]")
            column[len(rows) - 1].tick_params(labelbottom=True)
        below = _legend(figure) + 0.15  # inches: the name has its own line
        top = 1.0 - below / figure.get_size_inches()[1]
        figure.text(0.01, top, measured.name, va="bottom")
        figure.align_ylabels()
        figure.tight_layout(rect=(0, 0, 1, top))
        figure.set_layout_engine(None)
    return figure


def moments_figure(runs: Runs, trials: Sequence[Trial]) -> Figure:
    """Joint moments, the exoskeleton's on axes of their own (Fig. 5)."""

    def signal(joint):
        return lambda t: None if t.moments is None else t.moment(joint)

    names = trials[0].coordinates
    rows = []
    for joint in names.joints:
        rows.append((f"{_joint_name(names, joint)} [N m]", signal(joint)))
    return _drawn(runs, trials, rows, height=1.35)


def _cycles(trials: Sequence[Trial]) -> list[tuple]:
    """(number of the trial, side, heel strike, the next of that foot [s])."""
    found = []
    for k, trial in enumerate(trials):
        for side, ground in trial.feet.items():
            strikes = heel_strikes(trial.times, ground.force_z)
            found += [(k, side, *at) for at in pairwise(strikes)]
    return found


def _in_percent(start: float, end: float, times: np.ndarray) -> np.ndarray:
    return 100.0 * (times - start) / (end - start)


def _gait_figure(runs: Runs, trials: Sequence[Trial], cycles) -> Figure:
    """Angles and ground reaction of each leg over each of its cycles."""
    rows = _joint_rows(trials[0], *_JOINTS[0]) + _ground_rows(trials[0])
    rows = [row for row in rows if "CoP" not in row[0]]
    sides = sorted({side for _, side, *_ in cycles})
    of = {side: _of_side(rows, side) for side in sides}
    count = max(map(len, of.values()))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 1.5 * count + 0.6))
        axes = figure.subplots(
            count, len(sides), sharex=True, sharey="row", squeeze=False
        )
        for k, side, start, end in cycles:
            found = {name: run[k] for name, run in runs.items()}
            column = axes[:, sides.index(side)]
            percent = partial(_in_percent, start, end)
            _fill(column, found, trials[k], of[side], percent)
        axes[0, 0].set_xlim(0.0, 100.0)
        _finish(figure, axes, "gait cycle [%]")
    return figure


def front_figure(rows: list[dict]) -> Figure:
    """Pareto front of force against angle error; hollow: not solved."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.4), layout="constrained")
        ax = figure.subplots()
        for solved, style in ((True, "-o"), (False, "o")):
            some = [r for r in rows if r["success"] is solved]
            x = [r["angles_deg"] for r in some]
            y = [r["grf_n"] for r in some]
            face = None if solved else "none"
            ax.plot(x, y, style, color=_MODEL, mfc=face)
        for k, row in enumerate(rows):
            said = "" if row["success"] else ", not solved"
            at = row["angles_deg"], row["grf_n"]
            _beside(ax, at, f"×{row['factor']:g}{said}", k % 2 == 0)
        ax.margins(0.12)  # room for the texts
        ax.set_xlabel("joint angles, mean RMSD [°]")
        ax.set_ylabel("ground reaction, mean RMSD [N]")
        ax.set_title("Pareto front; ×: factor on the noise of forces")
    return figure


def _beside(axis, at: tuple[float, float], text: str, above: bool) -> None:
    """Write a text beside a point of a front.

    Above or below in turn, since neighbours may lie close.
    """
    axis.annotate(
        text,
        at,
        textcoords="offset points",
        xytext=(6, 4) if above else (-6, -4),
        ha="left" if above else "right",
        va="bottom" if above else "top",
    )


def _drawn(runs, trials, rows, height=1.9, bands=()) -> Figure:
    """Figure with a row for each (label, signal[, the device's]), by trial.

    A single trial of two legs has the left one's rows beside the right one's.
    Bands are those of the first run.
    """
    parts, legs = [rows], [_of_side(rows, side) for side in SIDES]
    halves = all(2 * len(leg) == len(rows) for leg in legs)
    if len(trials) == 1 and halves:
        parts = legs
    count, across = len(parts[0]), len(parts) * len(trials)
    width = _panel_width(across)
    first, banded = next(iter(runs.values())), dict(enumerate(bands))
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            figsize=(max(width * across, 4.4), height * count + 0.6)
        )
        axes = figure.subplots(
            count, across, sharex="col", sharey="row", squeeze=False
        )
        panels = [(k, part) for k in range(len(trials)) for part in parts]
        for column, (k, part) in zip(axes.T, panels, strict=True):
            # More fits in than in titles: letters are smaller.
            part = [(_wrapped(n, 1.25 * height), *of) for n, *of in part]
            column[0].set_title(_wrapped(trials[k].name, width))
            found = {name: run[k] for name, run in runs.items()}
            _fill(column, found, trials[k], part)
            _shade(column, part, first[k], banded.get(k))
        for ax in axes[:, len(parts) :].flat:
            ax.set_ylabel("")
        _finish(figure, axes)
    return figure


def _of_side(rows: list[tuple], side: str) -> list[tuple]:
    """Those of some rows that are of one leg."""
    return [
        row
        for row in rows
        if row[0].startswith(f"{side} ") or f"_{side} " in row[0]
    ]


def _panel_width(trials: int) -> float:
    """Width of a trial's panels [inches]; narrower if there are many."""
    return min(3.0, max(1.6, 18.0 / trials))


def _wrapped(name: str, width: float) -> str:
    """A name in lines of a width [inches], broken at "_" if possible."""
    whole = name.replace("_", "_ ").replace("N m", "N\u00a0m")
    lines = textwrap.fill(whole, int(11 * width))
    return lines.replace("_ ", "_").replace("\u00a0", " ")


def _fill(
    axes,
    found: dict[str, Trial | None],
    trial: Trial,
    rows,
    at: Callable[[np.ndarray], np.ndarray] = np.asarray,
) -> None:
    """Draw the panels of one trial: as measured, and by each run.

    `at` gives the places of times on the axis.
    """
    looks = [("measured", trial, _MEASURED, _MEASURED_DEVICE)]
    for k, (name, solved) in enumerate(found.items()):
        if solved is None:
            continue
        color = _RUNS[k % len(_RUNS)]
        if name.endswith("uncalibrated"):
            color = _UNCALIBRATED
        # Matplotlib leaves names out that begin with "_".
        said = f" {name}" if name.startswith("_") else name
        person = {"color": color, "lw": 1.6, "ls": _DASHES[k % len(_DASHES)]}
        device = {"color": color, "lw": 1.3, "ls": ":"}
        looks.append((said, solved, person, device))
    for ax, (label, *signals) in zip(axes, rows, strict=False):
        for said, moved, *styles in looks:
            names = said, f"{said}, exoskeleton"
            for signal, name, style in zip(
                signals, names, styles, strict=False
            ):
                if (values := signal(moved)) is not None:
                    ax.plot(at(moved.times), values, label=name, **style)
        ax.set_ylabel(label)


def _finish(figure: Figure, axes, label: str = "time [s]") -> None:
    for ax in axes[-1]:
        ax.set_xlabel(label)
    figure.align_ylabels()
    top = 1.0 - _legend(figure) / figure.get_size_inches()[1]
    # Only labels of outer panels stick out: measuring all takes seconds.
    inner = list(axes[1:-1, 1:].flat)
    for ax in inner:
        ax.set_visible(False)
    figure.tight_layout(rect=(0, 0, 1, top))
    for ax in inner:
        ax.set_visible(True)
    figure.set_layout_engine(None)  # saving would lay it out once more


def _legend(figure: Figure) -> float:
    """Add one legend for all panels, above them; its height [inches]."""
    # "measured" first, whichever panel shows it.
    entries = sorted(_entries(figure).items(), key=lambda e: e[0] != "measured")
    entries = dict(entries)
    width = figure.get_figwidth()
    # Runs are named as their folders, which may be a line of any length.
    names = [_wrapped(name, width - 0.5) for name in entries]
    lines = [name.splitlines() for name in names]
    longest = max(len(line) for name in lines for line in name)
    columns = min(len(names), 4, int(width / max(2.0, 0.5 + longest / 15.0)))
    rows = -(-len(names) // columns)
    more = 0.15 * rows * (max(map(len, lines)) - 1)
    figure.set_figheight(figure.get_figheight() + more)
    figure.legend(
        entries.values(),
        names,
        loc="upper center",
        ncol=columns,
        frameon=False,
    )
    return 0.1 + 0.22 * rows + more


def _entries(figure: Figure) -> dict[str, object]:
    """Label -> handle, for a legend of all panels together."""
    found = {}
    for ax in figure.axes:
        handles, labels = ax.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    return found


def quality_figure(trial: Trial, quality: TrialQuality) -> Figure:
    """Figure of angles, forces, Newton residual, moments, mats and markers.

    Of a person alone it shows the centre of pressure instead of mats.

    Args:
        trial: as loaded.
        quality: report on the same trial.
    """
    t = trial.start_s + trial.times
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 8.0), layout="constrained")
        axes = figure.subplots(2, 3)
        ax = axes[0, 0]
        _by_joint(ax, trial, t, lambda name: np.rad2deg(trial.coordinate(name)))
        _finish_axes(ax, "joint angles", "angle [°]")
        _forces(axes[0, 1], trial, t)
        ax = axes[0, 2]
        for column, name in enumerate(("$F_x$ [N]", "$F_z$ [N]", "$M$ [N m]")):
            ax.plot(t, quality.residual[:, column], label=name)
        ax.axhline(0.0, color="0.7", lw=0.8)
        _finish_axes(ax, "missed by Newton's law", "force [N], moment [N m]")
        ax = axes[1, 0]
        if trial.moments is not None:
            _by_joint(ax, trial, t, trial.moment)
        _finish_axes(ax, "joint moments", "moment [N m]")
        ax = axes[1, 1]
        if trial.coordinates.device:
            for name, look in _looks(trial.cuffs).items():
                ax.plot(t, trial.cuffs[name].normal, label=name, **look)
            _finish_axes(ax, "mats: normal force on the human", "force [N]")
        else:
            for side, wrench in trial.soles.items():
                foot = "feet" if side == "both" else side
                ax.plot(t, wrench.cop_x, ls=_dash(side), label=foot)
            _finish_axes(ax, "centre of pressure", "x [m]")
        _markers(axes[1, 2], quality)
        figure.suptitle(trial.name)
    return figure


def _by_joint(ax, trial: Trial, t, signal: Callable) -> None:
    """Draw a signal of every joint, the device's in the human's colour."""
    names = trial.coordinates
    looks = _looks(names.human)
    for joint in names.joints:
        beside = joint if joint in looks else names.follows(joint)
        look = looks.get(beside, {"color": "gray", "ls": ":"})
        if joint in names.device:
            look = look | {"ls": ":" if look["ls"] == "-." else "--"}
        ax.plot(t, signal(joint), label=joint, **look)


def _looks(names) -> dict[str, dict]:
    """Name -> style: a colour for each kind of names, a dash for each side."""
    kinds = dict.fromkeys(map(without_side, names))
    colours = dict(zip(kinds, cycle(COLOURS), strict=False))
    return {
        name: {"color": colours[without_side(name)], "ls": _dash(name)}
        for name in names
    }


def _dash(name: str) -> str:
    return "-." if name.endswith("right") else "-"


def _forces(ax, trial: Trial, t) -> None:
    for side, wrench in trial.soles.items():
        foot = "feet" if side == "both" else side
        for force, axis, color in (
            (wrench.force_x, "x", COLOURS[0]),
            (wrench.force_z, "z", COLOURS[1]),
        ):
            label = f"{foot} $F_{axis}$"
            ax.plot(t, force, color=color, ls=_dash(side), label=label)
    if trial.chair is not None:
        ax.plot(t, trial.chair.force_z, color="0.4", label="chair $F_z$")
    _finish_axes(ax, "forces on the body", "force [N]")


_MARKERS = 24  # the farthest are shown: more names cannot be read


def _markers(ax, quality: TrialQuality) -> None:
    every = sorted(quality.marker_rms_m.items(), key=lambda item: item[1])
    items = every[-_MARKERS:]
    values = [1e3 * value for _, value in items]
    ax.barh(range(len(items)), values, color="0.6")
    ax.set_yticks(range(len(items)), [name for name, _ in items], fontsize=6)
    ax.grid(visible=False, axis="y")
    title = "markers' distance from the model"
    if len(items) < len(every):
        title += f", {len(items)} of {len(every)}"
    ax.set_title(title)
    ax.set_xlabel("RMS [mm]")


def _finish_axes(ax, title: str, label: str) -> None:
    ax.set_title(title)
    count = len(ax.get_legend_handles_labels()[0])
    if not count:
        ax.set_axis_off()
        ax.text(
            0.5,
            0.5,
            "not measured",
            ha="center",
            color="0.5",
            transform=ax.transAxes,
        )
        return
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    # Below: curves may fill all of the panel.
    ax.legend(
        fontsize=7,
        ncols=2 if count == 4 else 3,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.15),
    )


_BEFORE, _AFTER = COLOURS[:2]
_PERSON, _LINKS = "0.82", "0.35"


def forces_figure(designed) -> Figure:
    """Normal forces over time: a row for each cuff, a column for each trial.

    Like the forecast, the model's are scaled to what mats would show.

    Args:
        designed: a `designed.Designed`.
    """
    pairs = [
        (name, before, after)
        for name in designed.before
        for before, after in zip(
            designed.before[name], designed.after[name], strict=True
        )
    ]
    cuffs = list(designed.peaks)
    width = _panel_width(len(pairs))
    built: dict[str, dict[str, Trial]] = {
        name: {t.name: t for t in trials}
        for name, trials in designed.measured.items()
    }
    with matplotlib.rc_context(STYLE):
        size = max(width * len(pairs), 4.4), 1.9 * len(cuffs) + 0.5
        figure = Figure(size, layout="constrained")
        axes = figure.subplots(
            len(cuffs), len(pairs), sharex="col", sharey="row", squeeze=False
        )
        for column, (name, before, after) in enumerate(pairs):
            for row, cuff in enumerate(cuffs):
                axis = axes[row, column]
                moved, shown = (before, after), designed.worn[name].shown(cuff)
                _draw(axis, cuff, moved, built.get(name, {}), shown)
                if column == 0:
                    out = cuff in designed.design.removed
                    end = ",\nleft out" if out else ""
                    axis.set_ylabel(f"{cuff} normal [N]{end}")
            several = f"{name}\n" if len(designed.worn) > 1 else ""
            title = f"{several}{_wrapped(before.trial.name, width)}"
            axes[0, column].set_title(title)
            axes[-1, column].set_xlabel("time [s]")
        # Not every trial has mats of every cuff.
        shown = _entries(figure)
        figure.legend(
            shown.values(),
            shown,
            fontsize=7,
            loc="outside lower center",
            ncols=min(len(shown), int(size[0] / 1.4)),
        )
        _head(figure, designed)
    return figure


def device_figure(designed) -> Figure:
    """Person and device from the side, with today's and the designed cuffs.

    The first wearer at the beginning and at the end of the first trial. A
    cuff is drawn where it holds the limb.

    Args:
        designed: a `designed.Designed`.
    """
    wearer, moved = designed.first
    trial, tree = moved[0].trial, wearer.model.tree
    old = wearer.contact.bushings
    new = designed.design.contact(wearer.contact).bushings
    told = {c: f"{c}: as today" for c in tree.cuffs}
    told |= {c: _told(c, d) for c, d in designed.design.cuffs.items()}
    lines = sum(1 + text.count("\n") for text in told.values())
    larger = max(1.0, lines / 22)  # lines that a figure of 4.4 inches holds
    with matplotlib.rc_context(STYLE):
        figure = Figure((5.4 * larger, 4.4 * larger), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        # Side by side, however narrow equal scales make them.
        for axis, side in zip(axes, "EW", strict=True):
            axis.set_anchor(side)
        end = f"end of {trial.name}"
        for axis, row, title in ((axes[0], 0, "start"), (axes[1], -1, end)):
            q = trial.q[[row]]
            for joint in tree.joints:
                _draw_link(axis, wearer.model, q, joint)
            _draw_ends(axis, wearer.model, q)
            _draw_arms(axis, tree, q, old)
            spots = {
                cuff: [
                    tree.point_positions(q, link, b.origin)[0]
                    for b in (old[cuff], new.get(cuff, old[cuff]))
                ]
                for cuff, (link, _) in tree.cuffs.items()
            }
            for cuff, (was, at) in spots.items():
                axis.plot(*was, "o", mfc="none", mec=_BEFORE, ms=9)
                axis.plot(*at, "o" if cuff in new else "x", color=_AFTER, ms=6)
            axis.set_aspect("equal")
            axis.margins(x=0.15)
            # Room for the numbers below somebody who stands.
            left, right = axis.get_xlim()
            more = max(0.6 - (right - left), 0.0) / 2.0
            axis.set_xlim(left - more, right + more)
            axis.xaxis.set_major_locator(MultipleLocator(0.5))
            axis.set_title(title)
            axis.set_xlabel("x [m]")
        _write_beside(
            axes[1], {told[c]: at for c, (_, at) in spots.items()}, larger
        )
        # One scale and one height.
        widths = [float(np.ptp(axis.get_xlim())) for axis in axes]
        axes[0].get_gridspec().set_width_ratios(widths)
        axes[0].set_ylabel("z [m]")
        for marker, face, edge, label in (
            ("o", "none", _BEFORE, "cuff today"),
            ("o", _AFTER, _AFTER, "cuff as designed"),
            ("x", _AFTER, _AFTER, "cuff left out"),
        ):
            if marker == "x" and not designed.design.removed:
                continue
            axes[0].plot(
                [], [], marker, mfc=face, mec=edge, label=label, ls="none"
            )
        axes[0].plot([], [], color=_PERSON, lw=5, label="person")
        axes[0].plot([], [], color=_LINKS, lw=1.5, label="device")
        figure.legend(fontsize=7, loc="outside lower center", ncols=5)
        _head(figure, designed)
    return figure


def _write_beside(axis, texts: dict[str, np.ndarray], larger: float) -> None:
    """Write texts to the right of their places, at their height if possible.

    Both legs' would overlap: they follow each other downwards, or upwards
    from the lower end of the axes.
    """
    half = {text: 0.042 / larger * (1 + text.count("\n")) for text in texts}
    low, right = axis.get_ylim()[0], axis.get_xlim()[1]
    heights, below = {}, np.inf  # m
    for text in sorted(texts, key=lambda text: -texts[text][1]):
        heights[text] = min(texts[text][1], below - half[text])
        below = heights[text] - half[text]
    for text in reversed(heights):
        heights[text] = max(heights[text], low + half[text])
        low = heights[text] + half[text]
    for text, height in heights.items():
        axis.annotate(
            text,
            texts[text],
            (right + 0.1, height),
            fontsize=7,
            va="center",
            arrowprops={
                "arrowstyle": "-",
                "lw": 0.5,
                "color": "0.5",
                "relpos": (0.0, 0.5),
            },
        )
    left = axis.get_xlim()[0]
    axis.set_xlim(left, right + 1.1)
    axis.set_xticks([x for x in axis.get_xticks() if left <= x <= right])
    axis.spines["bottom"].set_bounds(left, right)


def _head(figure: Figure, designed) -> None:
    """Write above a figure what in the design is extrapolated."""
    beyond = designed.beyond()
    if beyond:
        text = f"{EXTRAPOLATED}: {', '.join(beyond)}"
        text = textwrap.fill(text, int(11 * figure.get_size_inches()[0]))
        figure.suptitle(text, color=_AFTER, fontsize=9)


def _told(cuff: str, design: CuffDesign) -> str:
    """How a cuff of the design differs from today's, in a few words."""
    if design.removed:
        return f"{cuff}: left out"
    words = [
        f"{1e3 * abs(size):.0f} mm {up if size > 0.0 else down}"
        for size, up, down in (
            (design.along_m, "up", "down"),
            (design.across_m, "forwards", "backwards"),
            (design.preload_along_m, "up as preload", "down as preload"),
            (
                design.preload_across_m,
                "forwards as preload",
                "backwards as preload",
            ),
        )
        if abs(size) >= 5e-4
    ]
    if abs(design.area - 1.0) >= 5e-3:
        words.append(f"{100 * design.area:.0f} % of the area")
    straps = [
        f"{what} strap {rounded(value)} {unit}"
        for what, value, unit in (
            ("normal", design.strap_normal_n_m, "N/m"),
            ("tangential", design.strap_tangential_n_m, "N/m"),
            ("rotational", design.strap_rotational_nm_rad, "N m/rad"),
        )
        if value is not None and value < STIFF[unit]
    ]
    released = [
        what if share > 0.995 else f"{what} that takes {100 * share:.0f} %"
        for what, share in (("slide", design.slide), ("hinge", design.hinge))
        if share >= 5e-3
    ]
    said = [*words, *straps, *released] or ["as today"]
    return f"{cuff}: " + "\n    ".join(said)


def _draw_link(axis, model, q, joint: str) -> None:
    """Draw a line between the origins of the two links of a joint."""
    tree = model.tree
    ends = [tree.point_positions(q, link)[0] for link in tree.joints[joint]]
    device = joint in tree.coordinates.device
    axis.plot(
        *np.transpose(ends),
        color=_LINKS if device else _PERSON,
        lw=1.5 if device else 5,
        marker="o" if device else None,
        ms=3,
        solid_capstyle="round",
        zorder=2 if device else 1,
    )


def _draw_arms(axis, tree, q, bushings) -> None:
    """Draw lines from the device's joints to the cuffs on their links."""
    for cuff, (_, end) in tree.cuffs.items():
        tip = tree.point_positions(q, end, bushings[cuff].origin)[0]
        for joint in tree.coordinates.device:
            for link in tree.joints[joint]:
                if np.array_equal(tree.turning(link), tree.turning(end)):
                    root = tree.point_positions(q, link)[0]
                    axis.plot(*np.transpose([root, tip]), color=_LINKS, lw=1.5)


def _draw_ends(axis, model, q) -> None:
    """Draw what ends at no joint: trunk with head, and sole."""
    tree, human = model.tree, model.human
    ends = {"pelvis": [(0.0, 0.0), (0.0, human.pelvis.length_m)]}
    ends["foot"] = [human.heel_m, (0.0, 0.0), human.toe_m]
    for body in tree.names:
        if points := ends.get(without_side(body)):
            p_W = [tree.point_positions(q, body, p)[0] for p in points]
            axis.plot(
                *np.transpose(p_W), color=_PERSON, lw=5, solid_capstyle="round"
            )


def design_front_figure(rows: list[dict]) -> Figure:
    """Norm of the forces against the device's work, by its share of today's.

    Args:
        rows: as `designing.pareto_front` gives them.
    """
    rows = [row for row in rows if row["success"]]
    with matplotlib.rc_context(STYLE):
        figure = Figure((4.2, 3.2), layout="constrained")
        axis = figure.subplots()
        best = [row for row in rows if not row["dominated"]]
        for some, style, face in ((rows, "o-", "none"), (best, "o", _AFTER)):
            axis.plot(
                [row["work_j"] for row in some],
                [row["norm_n"] for row in some],
                style,
                color=_AFTER,
                ms=4,
                mfc=face,
            )
        for k, row in enumerate(rows):
            at = row["work_j"], row["norm_n"]
            _beside(axis, at, f"×{row['share']:g}", k % 2 == 0)
        axis.margins(0.12)  # room for the texts
        axis.set_title(
            "Pareto front; ×: share of today's work; hollow: dominated"
        )
        axis.set_xlabel("work of the device [J]")
        axis.set_ylabel("norm of the cuffs' forces [N]")
    return figure


def _draw(axis, cuff: str, moved, built, shown: float) -> None:
    """Draw one cuff's force in one trial, in today's device and the design."""
    before, after = moved

    def line(trial: Trial | None, label: str, factor=1.0, **style) -> None:
        if trial is not None and cuff in trial.cuffs:
            force = factor * trial.cuffs[cuff].normal
            axis.plot(trial.times, force, label=label, **style)

    line(before.trial, "today", shown, color=_BEFORE, lw=1.4)
    line(after.trial, "design", shown, color=_AFTER, lw=1.4)
    if after.bands is not None and cuff in after.trial.cuffs:
        trial = after.trial
        middle = shown * trial.cuffs[cuff].normal
        width = max(shown, 1.0) * after.bands.normal(cuff)
        _draw_band(axis, trial.times, middle, width, _AFTER)
    mats = {"color": "0.15", "lw": 1.0}
    line(before.measured, "measured today", **mats)
    as_built = built.get(before.trial.name)
    line(as_built, "measured as built", **mats, ls="--")


DESIGN_FIGURES = {"forces.png": forces_figure, "device.png": device_figure}


@dataclass(frozen=True)
class ContactCurves:
    """Parameters that the figures of contact laws are drawn for."""

    modulus: float = quantity("N/m²", 5e6, above=0, maximum=1e12)
    dissipation: float = quantity("s/m", 2.0, minimum=0)
    radius: float = quantity("m", 0.032, above=0, maximum=0.5)
    static_friction: float = quantity("", 0.9, above=0, maximum=10)
    dynamic_friction: float = quantity("", 0.6, above=0)
    viscous_friction: float = quantity("s/m", 0.5, minimum=0)
    transition_velocity: float = quantity("m/s", 0.05, above=0, maximum=1)

    def constants(self, law: str):
        """Constants of a law with these friction values."""
        return LAWS[law](
            static_friction=self.static_friction,
            dynamic_friction=self.dynamic_friction,
            viscous_friction=self.viscous_friction,
            transition_velocity=self.transition_velocity,
        )

    def parameters(self, law: str) -> tuple:
        """Stiffness (as the law defines it), dissipation, radius, constants."""
        stiffness = self.modulus
        if law == "paper":
            stiffness = paper_stiffness(self.modulus)
        return stiffness, self.dissipation, self.radius, self.constants(law)

    def normal(self, law: str, indentation, rate: float = 0.0):
        """Normal force [N] at indentations [m] and a rate [m/s]."""
        given = self.parameters(law)
        return sphere_force(law, indentation, rate, 0.0, *given)[0]


def measures(curves: ContactCurves) -> dict:
    """Numbers behind the figures: force and slope out of contact, friction.

    Returns:
        largest force [N] and least slope [N/m] of the paper's law from 50 mm
        above the ground to touching it, at rest, and the peak and end of the
        friction coefficient without its viscous part.
    """
    x = np.linspace(-0.05, 0.0, 1001)
    given = curves.parameters("paper")
    (normal, _), (slope, _) = sphere_force_derivatives(
        "paper", x, 0.0, 0.0, *given
    )
    dry = replace(curves.constants("paper"), viscous_friction=0.0)
    ratio = np.linspace(0.0, 4.0, 4001)
    mu = friction_coefficient("paper", ratio * dry.transition_velocity, dry)
    return {
        "parameters": curves,
        "force_out_of_contact_n": np.max(normal),
        "slope_out_of_contact_n_per_m": np.min(slope[0]),
        "peak_friction": np.max(mu),
        "peak_friction_at_v_rel": ratio[np.argmax(mu)],
        "friction_at_v_rel_3": mu[3000],
    }


def draw_normal_force(curves: ContactCurves):
    """Figure 8: normal force against indentation, zoom out of contact."""
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    axes = figure.subplots()
    x = np.linspace(-0.05, 0.02, 2801)
    for rate, style, label in (
        (0.1, (0, (4, 1.5)), "sinking at 0.1 m/s"),
        (0.0, "-", "at rest"),
        (-0.1, (0, (1, 1.2)), "leaving at 0.1 m/s"),
    ):
        axes.plot(
            1e3 * x,
            curves.normal("paper", x, rate),
            color=_MODEL,
            linestyle=style,
            label=f"paper, {label}",
        )
    axes.plot(
        1e3 * x,
        curves.normal("simbody", x),
        color=_SECOND,
        label="simbody, at rest",
    )
    axes.axvspan(-50.0, 0.0, color="0.92", zorder=0)
    axes.set_xlim(-50.0, 21.0)
    axes.set_ylim(0.0, 1.05 * np.max(curves.normal("paper", x)))
    axes.set_xlabel("indentation [mm]")
    axes.set_ylabel("normal force [N]")
    axes.legend(loc="upper left", handlelength=2.2)
    axes.text(
        0.03,
        0.69,
        f"$E$ = {1e-6 * curves.modulus:g} N/mm², "
        f"$c$ = {curves.dissipation:g} s/m, "
        f"$r$ = {1e3 * curves.radius:g} mm",
        transform=axes.transAxes,
        va="top",
        fontsize=8.0,
        color="0.4",
    )
    _draw_zoom(axes, curves)
    return figure


def _draw_zoom(axes, curves: ContactCurves) -> None:
    """Inset of the shaded region: force below 1 N, slope not zero."""
    inset = axes.inset_axes((0.115, 0.12, 0.50, 0.42))
    x = np.linspace(-0.05, 0.0, 501)
    force = curves.normal("paper", x)
    inset.set_facecolor("white")
    inset.plot(1e3 * x, force, color=_MODEL)
    inset.set_xlim(-50.0, 0.0)
    inset.set_ylim(0.0, 1.15 * np.max(force))
    inset.tick_params(labelsize=7.0)
    inset.spines[["top", "right"]].set_visible(True)
    inset.set_title(
        "zoom of the shaded part: paper, at rest", fontsize=7.5, pad=3.0
    )
    values = measures(curves)
    inset.text(
        0.06,
        0.92,
        f"force ≤ {_up(values['force_out_of_contact_n']):.2f} N\n"
        f"slope ≥ {-_up(-values['slope_out_of_contact_n_per_m']):.2f} N/m",
        transform=inset.transAxes,
        va="top",
        fontsize=7.5,
    )


def _up(value: float) -> float:
    """Round up to two decimals, so that a bound stays one."""
    return np.ceil(100.0 * value) / 100.0


def draw_friction(curves: ContactCurves):
    """Figure 9: friction coefficient against v_rel = |slip|/v_t."""
    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    ratio = np.linspace(0.0, 5.0, 1001)
    speed = ratio * curves.transition_velocity
    dry = replace(curves, viscous_friction=0.0)
    whole = (
        r"paper, $\mu_1 + \mu_2$ ($u_v$ = "
        f"{curves.viscous_friction:g} s/m)"
    )
    for law, own, label, style in (
        ("paper", dry, r"paper, $\mu_2$", {"color": _MODEL}),
        ("paper", curves, whole, {"color": _MODEL, "ls": (0, (4, 1.5))}),
        (
            "simbody",
            dry,
            "simbody, without viscous part",
            {"color": _SECOND, "lw": 1.2},
        ),
    ):
        mu = friction_coefficient(law, speed, own.constants(law))
        axes.plot(ratio, mu, label=label, **style)
    for level, text, start in (
        (curves.static_friction, "$u_s$", 1.0),
        (curves.dynamic_friction, "$u_d$", 3.0),
    ):
        _mark_level(axes, level, text, start)
    axes.set_xlim(0.0, 5.0)
    axes.set_ylim(0.0, None)
    axes.set_xlabel(
        r"relative slip speed $v_\mathrm{rel} = v_\mathrm{slip} / v_t$"
    )
    axes.set_ylabel(r"friction coefficient $\mu$")
    axes.legend(
        loc="lower right",
        frameon=True,
        facecolor="white",
        edgecolor="none",
        framealpha=1.0,
    )
    return figure


def _mark_level(axes, level: float, text: str, start: float):
    """Mark a friction coefficient on the axis, and where it is reached."""
    for x, y in (([0.0, start], [level] * 2), ([start] * 2, [0.0, level])):
        axes.plot(x, y, color="0.4", linewidth=0.7, zorder=1)
    axes.annotate(
        text,
        (0.0, level),
        xytext=(4.0, 2.0),
        textcoords="offset points",
        color="0.4",
        fontsize=8.0,
    )


def write_figures(folder: Path, curves: ContactCurves) -> list[Path]:
    """Write both figures as PNG and PDF and the numbers behind them.

    Args:
        folder: that exists.
        curves: what to draw.

    Returns:
        The files written.
    """
    files = []
    for name, draw in (
        ("figure_8_normal_force", draw_normal_force),
        ("figure_9_friction", draw_friction),
    ):
        with matplotlib.rc_context(STYLE):
            figure = draw(curves)
        for suffix in ("png", "pdf"):
            files.append(Path(folder) / f"{name}.{suffix}")
            save_figure(files[-1], figure)
    files.append(Path(folder) / "summary.json")
    write_json(files[-1], measures(curves))
    return files
