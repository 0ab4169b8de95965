"""A design with its forecast: results of Phase D, checks, tables and files.

Movements on today's cuffs and on the design are compared with each other, and
with those measured on the design once it is built.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from drake_exo.calibration.design import (
    DesignResult,
    joint_norm,
    works,
)
from drake_exo.calibration.design_variables import Variable, is_assistance
from drake_exo.calibration.results import solve_summary, write_contact
from drake_exo.calibration.settings import DesignSettings, DriveLimits
from drake_exo.calibration.uncertainty import Bands
from drake_exo.calibration.wearers import Hold, Wearer, hold
from drake_exo.contact.bushing import (
    NORMAL,
    ROTATION,
    TANGENTIAL,
)
from drake_exo.contact.strap import (
    STIFF,
    TODAY,
    CuffDesign,
    Design,
    device_sdf,
    write_design,
)
from drake_exo.errors import path_of
from drake_exo.files.output import (
    SOLVED,
    Check,
    Verdict,
    rounded,
    save_figure,
    write_json,
    write_text,
)
from drake_exo.measurement.trial import Trial
from drake_exo.nlp.ipopt import Solution
from drake_exo.report.gathering import format_table
from drake_exo.study import write_inputs

# A cuff that is moved further than this is outside of what was calibrated.
_KNOWN_M = 0.03
_BOLD = 1e-3  # least relative change that counts as one
_REMOVED = ".removed"
# Share by which a forecast may exceed the norm that the design promised.
_KEPT = 0.1
# Multiple of a limit above which a forecast counts as beyond it.
_BEYOND = 1.02
_BEYOND_LIMIT = (
    "is beyond its limit in the forecast, where the person moves as before: "
    "lower limits."
)
# Reported quantity of a drive -> unit.
_DRIVES = {"torque_nm": "N m", "speed_deg_s": "deg/s", "power_w": "W"}


@dataclass(frozen=True)
class Moved:
    """A trial's own movement on some cuffs.

    Attributes:
        trial: solved.
        bands: bands of 95 %; None if the contact has no posterior.
        measured: the trial as recorded, on today's cuffs.
        seen: solved with encoders tracked, so that the device moves as it did
            on the cuffs on which it was measured; None on other cuffs.
    """

    trial: Trial
    bands: Bands | None
    measured: Trial
    seen: Trial | None = None


@dataclass(frozen=True)
class Peak:
    """Largest normal force of one cuff in a trial, mean over trials [N].

    Attributes:
        measured_before: by mats; None without mats.
        today: value to compare the forecast with: measured_before, unless the
            model differs from it by more than a factor of 2.
        model_before, model_after: the model's, on today's cuffs and on the
            design; 0 for a cuff that is left out.
        forecast_after: reading of mats expected on the design: the model's
            times today's ratio of mats to model.
        forecast_low, forecast_high: ends of its band of 95 %.
        measured_after: by mats, once the design is built.
    """

    measured_before: float | None
    today: float
    model_before: float
    model_after: float
    forecast_after: float
    forecast_low: float
    forecast_high: float
    measured_after: float | None = None


@dataclass(frozen=True)
class Tried:
    """A design with some cuffs left out.

    Attributes:
        without: the cuffs left out.
        norm_n: norm of all cuffs' forces [N]; None if there is no such design.
        forecast_n: that norm in the forecast of the design [N], or None.
        design: the design, or None.
        why_not: sentence that says why there is none; else empty.
    """

    without: tuple[str, ...]
    norm_n: float | None = None
    forecast_n: float | None = None
    design: Design | None = None
    why_not: str = ""

    @property
    def name(self) -> str:
        """Names of the cuffs left out, joined by "and"."""
        return " and ".join(self.without) or "none"


@dataclass(frozen=True)
class Designed:
    """A design with its forecast; see `design`.

    Attributes:
        settings: the design's.
        today, found: solution with nothing changed, and of the design.
        before, after: wearer -> its movements on today's cuffs and on the
            design.
        parts: what was free to change ("nothing", "places alone", ..., "all")
            -> norm of forces that this reached [N].
        measured: wearer -> its trials on the design, once it is built.
        seen: likewise, solved with encoders tracked.
        inputs: checks of the studies and calibrations used.
        tried: designs with removable cuffs left out in turn, the one with
            every cuff first; empty if none is removable.
        stopped: whether the user stopped what follows a design: leaving out
            cuffs, or `parts`.
    """

    settings: DesignSettings
    today: DesignResult
    found: DesignResult
    before: dict[str, list[Moved]]
    after: dict[str, list[Moved]]
    parts: dict[str, float] = field(default_factory=dict)
    measured: dict[str, Sequence[Trial]] = field(default_factory=dict)
    seen: dict[str, Sequence[Trial]] = field(default_factory=dict)
    inputs: tuple[Check, ...] = ()
    tried: tuple[Tried, ...] = ()
    stopped: bool = False

    def __repr__(self) -> str:
        head = f"Designed({self.solution.status!r})"
        if not self.success:
            return head
        norm = f"{self.today.norm_n:.1f} N today, {self.found.norm_n:.1f} N"
        free = [v for v in self.found.problem.design if v.free]
        width = max((len(v.name) for v in free), default=0)
        rows = [
            f"  {v.name:<{width}} {self.found.values[v.name]:.4g} {v.unit}"
            for v in free
        ]
        return "\n".join([f"{head}, norm of forces {norm}", *rows])

    @property
    def solution(self) -> Solution:
        """State of the solve."""
        return self.found.solution

    @property
    def success(self) -> bool:
        """Whether the solver met its tolerances."""
        return self.solution.success

    @property
    def design(self) -> Design:
        """The design to be built; SealedSolutionError if the solve failed."""
        return self.found.design

    @cached_property
    def worn(self) -> dict[str, Wearer]:
        """Wearers by name, those drawn or of other sizes included."""
        return {w.name: w for w in self.found.problem.wearers}

    @property
    def first(self) -> tuple[Wearer, list[Moved]]:
        """The first wearer, and its movements on today's cuffs."""
        name, moved = next(iter(self.before.items()))
        return self.worn[name], moved

    @cached_property
    def held(self) -> Hold:
        """Least stiffness with which its cuffs, as built, hold the device.

        Of wearers with a forecast, in their movements there.
        """
        return min(
            hold(
                replace(
                    self.worn[name].on(self.design),
                    trials=[m.trial for m in moved],
                )
            )
            for name, moved in self.after.items()
        )

    @cached_property
    def forecast_n(self) -> float:
        """Forecast of the norm of forces on the design as built [N].

        The norm that the program promises for all wearers, times the ratio of
        forecast to promised norm of the calibrated ones.
        """
        wearers = [self.found.wearers[name] for name in self.after]
        moved = [
            replace(own, trials=[m.trial for m in ms])
            for own, ms in zip(wearers, self.after.values(), strict=True)
        ]
        forecast, promised = (
            joint_norm(map(self.found.norm, these))
            for these in (moved, wearers)
        )
        return forecast / promised * self.found.norm_n

    @cached_property
    def peaks(self) -> dict[str, Peak]:
        """Cuff -> its peak over all wearers' trials."""
        self.solution.check()
        (first, *_) = self.before.values()
        return {cuff: self._peak(cuff) for cuff in first[0].trial.cuffs}

    def _peak(self, cuff: str) -> Peak:
        rows = [
            (self.worn[name].shown(cuff), before, after)
            for name, moved in self.before.items()
            for before, after in zip(moved, self.after[name], strict=True)
        ]
        seen = [row for row in rows if cuff in row[1].measured.cuffs]
        ratio, was, now = np.transpose(
            [
                (r, *(largest_force(m.trial, cuff) for m in moved))
                for r, *moved in seen or rows
            ]
        )
        halves = [
            _half_widths(after, cuff, r)[NORMAL] for r, _, after in seen or rows
        ]
        built = [
            t for ts in self.measured.values() for t in ts if cuff in t.cuffs
        ]
        forecast = float(np.mean(ratio * now))
        width = float(np.mean(halves))
        return Peak(
            _mean([largest_force(m.measured, cuff) for _, m, _ in seen]),
            float(np.mean(ratio * was)),
            float(np.mean(was)),
            float(np.mean(now)),
            forecast,
            max(forecast - width, 0.0),
            forecast + width,
            _mean([largest_force(t, cuff) for t in built]),
        )

    @property
    def support(self) -> dict[str, float | None]:
        """Work of the device over all trials [J], before, after, measured.

        Before and after are along the device's movement of today.
        """
        return {
            "before": sum(works(self.today)[name] for name in self.before),
            "after": sum(works(self.found)[name] for name in self.before),
            "measured_before": sum(
                _measured_work(m.measured)
                for moved in self.before.values()
                for m in moved
            ),
            "measured_after": sum(
                _measured_work(t) for ts in self.measured.values() for t in ts
            )
            or None,
        }

    @cached_property
    def slopes(self) -> dict[str, float]:
        """Change of cost/weight by a step (size) of each variable today."""
        slopes, weight = self.today.slopes(), self.today.problem.settings.weight
        return {
            v.name: slopes[v.name] * v.size / weight
            for v in self.found.problem.design
            if v.name in slopes
        }

    def variables(self) -> list[dict]:
        """One row for each free design variable, and each removable cuff."""

        def row(v: Variable, value: float) -> dict:
            return {
                "name": v.name,
                "unit": v.unit,
                "today": v.today,
                "value": value,
                "lower": v.lower,
                "upper": v.upper,
                "at_bound": v.at_bound(value),
                "slope_today": self.slopes.get(v.name),
                "extrapolated": v.unit == "m" and abs(value) > _KNOWN_M,
            }

        rows = []
        for v in self.found.problem.design:
            if not v.free:
                continue
            rows.append(row(v, self.found.values[v.name]))
            if v.is_strap:
                cuff, _, what = v.name.partition(".")
                strap = getattr(self.design.cuffs[cuff], what)
                rows[-1] |= {"strap": strap, "strap_unit": _strap_unit(v)}
        for cuff in self.peaks:
            if self.settings.freedom(cuff).removable:
                v = Variable(f"{cuff}{_REMOVED}", "1", 0.0, 1.0, 0.0, 1.0)
                left_out = float(cuff in self.design.removed)
                rows.append(row(v, left_out) | {"at_bound": False})
        return rows

    def felt(self, wearers: Sequence[str] | None = None) -> list[dict]:
        """Largest loads of every cuff on the person, before and after.

        Over all wearers, or those named. Forces across the limb are as mats
        would show them, migration as encoders would. `measured_migration_mm`
        is that on the built design, `half_width_95` that of the forecast's
        forces (None without bands); for a mean it is the mean half width, since
        errors of a cuff do not average out over time.
        """
        rows = []
        for cuff in self.peaks:
            row: dict = {"cuff": cuff, "half_width_95": None}
            for what, design, all_moved in (
                ("before", Design(), self.before),
                ("after", self.design, self.after),
            ):
                moved = {n: all_moved[n] for n in wearers or all_moved}
                if cuff in design.removed:
                    row[what] = dict.fromkeys(row["before"], 0.0)
                    continue
                area = self.settings.freedom(cuff).area_m2
                area *= design.cuffs.get(cuff, CuffDesign()).area
                peaks, rates, means, halves, far = [], [], [], [], []
                for name, own in moved.items():
                    w = self.worn[name].on(design)
                    shown, slides = np.ones(3), np.ones(3)
                    shown[NORMAL] = factor = w.shown(cuff)
                    slides[TANGENTIAL] = w.slides(cuff)
                    for m in own:
                        one = replace(w, trials=(m.trial,))
                        peaks.append(shown * one.largest_force(cuff))
                        rates.append(factor * one.largest_rate(cuff))
                        means.append(factor * one.mean_force(cuff))
                        far.append(slides * one.largest_deflection(cuff))
                        halves.append(_half_widths(m, cuff, factor))
                peak, deflection = np.max(peaks, axis=0), np.max(far, axis=0)
                row[what] = {
                    "peak_n": float(peak[NORMAL]),
                    "mean_n": float(np.mean(means)),
                    "rate_n_s": float(max(rates)),
                    "shear_n": float(peak[TANGENTIAL]),
                    "moment_nm": float(peak[ROTATION]),
                    "pressure_kpa": float(1e-3 * peak[NORMAL] / area),
                    "migration_mm": float(1e3 * deflection[TANGENTIAL]),
                    "deflection_mm": float(1e3 * deflection[NORMAL]),
                }
                if what == "after" and all(
                    m.bands is not None for own in moved.values() for m in own
                ):
                    halves = np.array(halves)
                    half = halves[np.argmax(peaks, axis=0), range(3)]
                    row["half_width_95"] = {
                        "peak_n": float(half[NORMAL]),
                        "mean_n": float(halves[:, 3].mean()),
                        "shear_n": float(half[TANGENTIAL]),
                        "moment_nm": float(half[ROTATION]),
                        "pressure_kpa": float(1e-3 * half[NORMAL] / area),
                    }
            built = None
            if self.seen and cuff not in self.design.removed:
                worn = [
                    replace(self.worn[name].on(self.design), trials=trials)
                    for name, trials in self.seen.items()
                ]
                found = [w.largest_deflection(cuff)[TANGENTIAL] for w in worn]
                built = float(1e3 * max(found))
            row["measured_migration_mm"] = built
            rows.append(row)
        return rows

    def drives(self, wearers: Sequence[str] | None = None) -> list[dict]:
        """Largest torque, speed and power of every drive, before and after.

        Over all wearers, or those named. The torque is without the joint's
        friction and spring; power is torque times speed.
        """
        joints = self.first[0].model.coordinates.device
        rows: list[dict] = [{"joint": joint} for joint in joints]
        for what, all_moved in (("before", self.before), ("after", self.after)):
            torques, speeds = [], []
            for name in wearers or all_moved:
                for m in all_moved[name]:
                    names = m.trial.coordinates
                    torques.append(self.worn[name].drive(m.trial))
                    speeds.append(m.trial.v[:, names.device_columns])
            torque, speed = np.vstack(torques), np.vstack(speeds)
            for row, *most in zip(
                rows,
                np.abs(torque).max(axis=0),
                np.rad2deg(np.abs(speed).max(axis=0)),
                np.abs(torque * speed).max(axis=0),
                strict=True,
            ):
                row[what] = dict(zip(_DRIVES, map(float, most), strict=True))
        return rows

    def wearers(self) -> dict[str, dict[str, float]]:
        """Wearer -> norm of its cuffs' forces today and on the design [N].

        From the program, including drawn and sized wearers.
        """
        return {
            name: {
                "before": self.today.norm(today).newton,
                "after": self.found.norm(self.found.wearers[name]).newton,
            }
            for name, today in self.today.wearers.items()
        }

    def checks(self) -> tuple[Check, ...]:
        """All checks: inputs, solve, goals of the design, notes."""
        solution = self.solution
        said = ""
        if not self.success:
            said = f"{solution.status}: {solution.explain()}"
        solved = Check(SOLVED, solution.success, sentence=said)
        if not self.success:
            return (*self.inputs, solved)
        return (*self.inputs, solved, *self._goals(), *self._notes())

    def _goals(self) -> Iterator[Check]:
        """Checks of what a solved design has to reach."""
        s, limit = self.support, 3.0
        change = 100.0 * abs(s["after"] / s["before"] - 1.0)
        yield Check(
            "design.support",
            change <= limit or self.settings.limits.support is None,
            change,
            limit,
            "%",
            sentence="the device does not do the work that it does today: "
            "tighten design.limits.support",
        )
        most = (1.0 + _KEPT) * self.found.norm_n
        yield Check(
            "design.forecast",
            self.forecast_n <= most,
            self.forecast_n,
            most,
            "N",
            sentence="the design keeps its promise only if the person moves "
            "otherwise: "
            + (
                "lower design.own_angle_deg or weight"
                if self.settings.response == "own"
                else "while the person moves as before the cuffs bear more; "
                "design for response: own"
            ),
        )
        largest = max(p.forecast_after for p in self.peaks.values())
        today = max(p.today for p in self.peaks.values())
        yield Check(
            "design.better",
            largest < today,
            largest,
            today,
            "N",
            sentence="the largest force does not fall: give the design "
            "more freedom or wider limits",
        )
        yield Check(
            "design.attached",
            self.held.stiffness > 0.0,
            self.held.stiffness,
            0.0,
            "N m/rad",
            self.held.joint,
            "the device hangs loose: its weight pushes it off by more "
            "than its cuffs hold it; leave out fewer of them, and less to "
            "slides and hinges",
        )

    def _notes(self) -> Iterator[Check]:
        """Notes: forces as built, migration, limits, bounds, extrapolation."""
        note = partial(Check, level="note")
        for cuff, peak in self.peaks.items():
            value = peak.measured_after
            if value is not None:
                less = value < peak.forecast_after
                yield note(
                    "design.measured",
                    peak.forecast_low <= value <= peak.forecast_high,
                    value,
                    peak.forecast_low if less else peak.forecast_high,
                    "N",
                    cuff,
                    "its force measured on the built design lies outside the "
                    "band of its forecast",
                )
        note = partial(note, holds=False)
        most = self.settings.limits.migration_mm
        for row in self.felt():
            value = row["after"]["migration_mm"]
            if most is not None and value > _BEYOND * most:
                yield note(
                    "design.migration",
                    value=value,
                    limit=most,
                    unit="mm",
                    where=row["cuff"],
                    sentence="deflects along the limb by more than its limit "
                    "(on the device of today "
                    f"{row['before']['migration_mm']:.1f} mm): other limits "
                    "keep the design from coming nearer to it, or the cuff "
                    "slides further in the forecast: lower "
                    "limits.migration_mm",
                )
        for wearer in self.after:  # limits are relative to each one's today
            others = f", {wearer}" if len(self.after) > 1 else ""
            for of, value, unit, name, limit in self._limited(wearer):
                if limit is not None and value > _BEYOND * limit:
                    yield note(
                        "design.limits",
                        value=value,
                        limit=limit,
                        unit=unit,
                        where=of + others,
                        sentence=_BEYOND_LIMIT + name,
                    )
        rows = self.variables()
        gains = self.settings.assistance_over == "gains"
        if gains and not any(is_assistance(row["name"]) for row in rows):
            said = "has nothing to act on: no drive of the device gives torque"
            where = "design.assistance_over: gains"
            yield note("design.assistance", where=where, sentence=said)
        for row in rows:
            at = {k: row[k] for k in ("value", "unit")}
            at["where"] = row["name"]
            if row["at_bound"]:
                said = "is at a bound: values beyond it were not tried"
                yield note("design.bounds", **at, sentence=said)
            if row["extrapolated"]:
                said = "moves a cuff to where nothing was calibrated"
                at["limit"] = _KNOWN_M
                yield note("design.extrapolation", **at, sentence=said)
        for cuff in self.softened():
            said = "deflects further than in any trial of today"
            yield note("design.extrapolation", where=cuff, sentence=said)

    def _limited(self, wearer: str) -> Iterator[tuple]:
        """Yield cuff or joint, value, unit, limit's name, limit or None."""
        limits = self.settings.limits
        units = {"shear_n": "N", "peak_n": "N", "moment_nm": "N m"}
        keys = list(units)  # as components are counted
        others = {"pressure_kpa": "kPa", "mean_n": "N", "rate_n_s": "N/s"}
        for row in self.felt([wearer]):
            cuff, after = row["cuff"], row["after"]
            for key, unit in others.items():
                yield cuff, after[key], unit, key, getattr(limits, key)
            today = [row["before"][key] for key in keys]
            for k, name, most in limits.of_forces(today):
                yield cuff, after[keys[k]], units[keys[k]], name, most
        for row in self.drives([wearer]):
            joint, after = row["joint"], row["after"]
            own = limits.drives.get(joint, DriveLimits())
            for key, unit in _DRIVES.items():
                name = f"drives.{joint}.{key}"
                yield joint, after[key], unit, name, getattr(own, key)

    def softened(self) -> list[str]:
        """Cuffs that deflect further than in any trial of today."""
        return [
            row["cuff"]
            for row in self.felt()
            if any(
                row["after"][k] > (1.0 + _BOLD) * row["before"][k]
                for k in ("deflection_mm", "migration_mm")
            )
        ]

    def verdict(self, accepted: Sequence[str] = ()) -> Verdict:
        """All checks, with names of those that need not hold."""
        return Verdict(self.checks(), tuple(accepted))

    def summary(self, accepted: Sequence[str] = ()) -> dict:
        """Contents of summary.json."""
        found = {
            "phase": "design",
            "subjects": list(self.before),
            **solve_summary(self.solution),
            "settings": asdict(self.settings),
            **self.verdict(accepted).summary(),
        }
        if not self.success:
            return found
        first, *others = self.before.items()
        name, moved = first
        return found | {
            "trials": [
                trial_label(m.trial, name if others else "") for m in moved
            ],
            "response": self.settings.response,
            "peaks_n": {c: asdict(p) for c, p in self.peaks.items()},
            "support": self.support,
            "norm_n": {
                "before": self.today.norm_n,
                "after": self.found.norm_n,
                "forecast": self.forecast_n,
            },
            "felt": self.felt(),
            "drives": self.drives(),
            "wearers_n": self.wearers(),
            "variables": self.variables(),
            "parts": self.parts,
            "tried": [asdict(t) for t in self.tried],
            "extrapolated": bool(self.beyond()),
        }

    def table(self) -> str:
        """Text of design.txt: loads before and after, and the design."""
        beyond = self.beyond()
        rows = [
            [
                cuff + (" *" if cuff in beyond else ""),
                p.measured_before,
                p.model_before,
                p.forecast_after,
                p.forecast_low,
                p.forecast_high,
                p.measured_after,
            ]
            for cuff, p in self.peaks.items()
        ]
        header = ["peak force [N]", "measured", "model", "forecast"]
        header += ["from", "to", "built"]
        parts = [format_table(header, rows, 1)]
        rows = []
        for row in self.felt():
            for what in ("before", "after"):
                own = row[what]
                rows.append([f"{row['cuff']} {what}", *own.values()])
            if row["half_width_95"] is not None:
                half = dict.fromkeys(row["after"]) | row["half_width_95"]
                rows.append([f"{row['cuff']} after ±", *half.values()])
            if row["measured_migration_mm"] is not None:
                built = dict.fromkeys(row["after"])
                built["migration_mm"] = row["measured_migration_mm"]
                rows.append([f"{row['cuff']} built", *built.values()])
        header = ["cuff", "peak N", "mean N", "rate N/s", "shear N"]
        header += ["moment N m", "pressure kPa", "migration mm"]
        header += ["deflection mm"]
        parts.append(format_table(header, rows, 1))
        rows = [
            [f"{row['joint']} {what}", *row[what].values()]
            for row in self.drives()
            for what in ("before", "after")
        ]
        header = ["drive", "torque N m", "speed deg/s", "power W"]
        parts.append(format_table(header, rows, 1))
        rows = [
            [
                row["name"] + (" *" if row["extrapolated"] else ""),
                _told(row),
                "at its bound" if row["at_bound"] else "",
                row["slope_today"],
            ]
            for row in self.variables()
        ]
        header = ["design", "value", "", "cost by a step"]
        parts.append(format_table(header, rows, 3))
        s = self.support
        how = _RESPONSE[self.settings.response]
        parts.append(
            f"work of the device {s['before']:.1f} J today, "
            f"{s['after']:.1f} J on the design; the person moves {how}"
        )
        if len(self.found.wearers) > len(self.before):
            rows = [[k, *v.values()] for k, v in self.wearers().items()]
            header = ["norm of forces [N]", "today", "design"]
            parts.append(format_table(header, rows, 1))
        if self.parts:
            parts.append(
                format_table(
                    ["what may change", "norm of forces [N]"],
                    list(self.parts.items()),
                )
            )
        if self.tried:
            rows = [
                [
                    t.name,
                    t.norm_n,
                    t.forecast_n,
                    "chosen" if t.design == self.design else "",
                ]
                for t in self.tried
            ]
            header = ["cuffs left out", "norm of forces [N]", "forecast", ""]
            reasons = [
                f"without {t.name}: {t.why_not}"
                for t in self.tried
                if t.why_not
            ]
            parts.append("\n".join([format_table(header, rows), *reasons]))
        if beyond:
            parts.append("* beyond what was calibrated: an extrapolation")
        return "\n\n".join(parts)

    def beyond(self) -> list[str]:
        """Cuffs and joints at which the design extrapolates."""
        moved = [r["name"] for r in self.variables() if r["extrapolated"]]
        names = [*self.softened(), *(n.partition(".")[0] for n in moved)]
        return [n for n in (*self.peaks, *self.design.joints) if n in names]

    def write(
        self, folder: str | Path, accepted: Sequence[str] = ()
    ) -> Verdict:
        """Write design.yaml, tables, figures, trials and summary.json."""
        from drake_exo.report.figures import DESIGN_FIGURES

        folder = path_of(folder, "folder")
        folder.mkdir(parents=True, exist_ok=True)
        verdict = self.verdict(accepted)
        if self.success:
            write_design(folder, self.design)
            for t in self.tried:
                if t.design is not None and t.design != self.design:
                    name = f"design_without_{'_'.join(t.without) or 'none'}"
                    write_design(folder, t.design, f"{name}.yaml")
            write_text(folder / "design.txt", self.table(), verdict.mark)
            for name, draw in DESIGN_FIGURES.items():
                save_figure(folder / name, draw(self), verdict.mark)
            wearer, moved = self.first
            write_inputs(folder, wearer.model, [m.measured for m in moved])
            write_contact(folder, self.design.contact(wearer.contact))
            (folder / TODAY).mkdir(exist_ok=True)
            write_contact(folder / TODAY, wearer.contact)
            text = device_sdf(wearer.model, self.design)
            if text is not None:
                (folder / "device.sdf").write_text(text, encoding="utf-8")
            for what in ("before", "after"):
                for name, movements in getattr(self, what).items():
                    for m in movements:
                        who = name if len(self.before) > 1 else ""
                        label = trial_label(m.trial, who)
                        m.trial.save(folder / f"{what}_{label}")
        write_json(folder / "summary.json", self.summary(accepted))
        return verdict


_RESPONSE = {
    "own": "as before (own movement)",
    "free": "as is least effort between the ends of its movement (free)",
}


def trial_label(trial: Trial, who: str) -> str:
    """Name of a trial's file; with the wearer's name if there are several."""
    return f"{who}_{trial.name}" if who else trial.name


def largest_force(trial: Trial, cuff: str) -> float:
    """A cuff's largest normal force in a trial [N]; 0 if it is left out."""
    if cuff not in trial.cuffs:
        return 0.0
    return float(np.abs(trial.cuffs[cuff].normal).max())


def _half_widths(moved: Moved, cuff: str, shown: float) -> np.ndarray:
    """Half widths (4,): bands at each largest component; mean of normal's.

    0 without bands. `shown`: see Wearer.
    """
    if moved.bands is None or cuff not in moved.trial.cuffs:
        return np.zeros(4)
    trial, widths = moved.trial, moved.bands.cuffs[cuff].copy()
    widths[:, NORMAL] = max(shown, 1.0) * moved.bands.normal(cuff)
    at = np.abs(trial.cuffs[cuff].components).argmax(axis=0)
    mean = np.trapezoid(widths[:, NORMAL], trial.times) / trial.duration
    return np.append(widths[at, range(3)], mean)


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _measured_work(trial: Trial) -> float:
    return 0.0 if trial.moments is None else trial.device_work


def _strap_unit(v: Variable) -> str:
    return "N m/rad" if v.unit.startswith("rad") else "N/m"


def _told(row: dict) -> str:
    if row["name"].endswith(_REMOVED):
        return "left out" if row["value"] else "kept"
    if "strap" in row:
        strap, unit = row["strap"], row["strap_unit"]
        if strap is None or strap > STIFF[unit]:
            return "stiff"
        return f"{rounded(strap)} {unit}"
    if row["unit"] == "m":
        return f"{1e3 * row['value']:+.1f} mm"
    unit = "" if row["unit"] == "1" else f" {row['unit']}"
    return f"{row['value']:.3f}{unit}"
