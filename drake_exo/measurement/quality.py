"""Quality report of a study's recordings, without solving anything."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_exo.files.output import Check
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.plausibility import LIMITS
from drake_exo.measurement.subject import SubjectModel
from drake_exo.measurement.trial import Trial

# Beyond these a line of the report is marked; only `plausibility` refuses.
LARGEST_MARKER_RMS_M = 0.02
LARGEST_RESIDUAL_N = 0.05  # of body weight
LARGEST_GAPS = 0.1  # of the marker frames
LARGEST_DELAY_S = 0.03


@dataclass(frozen=True)
class TrialQuality:
    """Quality of one trial.

    Attributes:
        name: of the trial.
        start_s, end_s: start and end of the used part in the recording.
        marker_rms_m: marker -> RMS distance from the model.
        worst_marker: the marker with the largest RMS distance.
        marker_rms_all_m: RMS of these values over all markers.
        gaps: share of the used part's marker frames that were filled.
        filled_frames: number of filled frames, sum over the markers.
        left_out: markers left out because they are hidden for too long.
        residual_n: RMS residuals of F_x and F_z in Newton's law.
        residual_nm: RMS residual of the pitch moment about the ankle, with
            two legs about the hips.
        residual: (N, 3) these residuals over time [N, N, N m].
        delays_s: instrument -> lag of its clock that was removed.
        notes: sentences on what was doubled, estimated, levelled.
        warnings: sentences on what is beyond the limits above.
    """

    name: str
    start_s: float
    end_s: float
    marker_rms_m: dict[str, float]
    worst_marker: str
    marker_rms_all_m: float
    gaps: float
    filled_frames: int
    left_out: tuple[str, ...]
    residual_n: tuple[float, float]
    residual_nm: float
    residual: np.ndarray
    delays_s: dict[str, float]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """Everything but time series."""
        return {k: v for k, v in vars(self).items() if k != "residual"}


@dataclass(frozen=True)
class Quality:
    """Quality of a study.

    Attributes:
        standing_mass_kg: body mass by quiet standing, None without plates.
        stated_mass_kg: body mass by study or OpenSim model, or None.
        trials: quality of each trial, in the study's order.
        warnings: sentences on the standing trial.
        notes: sentences on how device and OpenSim model were read.
        checks: plausibility checks.
    """

    standing_mass_kg: float | None
    stated_mass_kg: float | None
    trials: tuple[TrialQuality, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()

    @property
    def remarks(self) -> list[str]:
        """What deserves a look, by trial."""
        found = [(t.name, w) for t in self.trials for w in t.warnings]
        return [*self.warnings, *(f"{name}: {w}" for name, w in found)]

    def summary(self) -> dict[str, Any]:
        """Everything but time series."""
        rest = {k: v for k, v in vars(self).items() if k != "checks"}
        return {**rest, "trials": [t.summary() for t in self.trials]}


def force_residual(subject: SubjectModel, trial: Trial) -> np.ndarray:
    """Residual of Newton's and Euler's law: required less measured wrench.

    Returns:
        (N, 3) F_x, F_z [N] and pitch moment [N m] about the ankle, with two
        legs about the hips.
    """
    tree = subject.model.rigid.tree
    Q = inverse_dynamics(tree, *trial.body, trial.loads(tree.root))
    return Q[:, tree.coordinates.root_columns]


def assess(
    subject: SubjectModel,
    trials: tuple[Trial, ...],
    checks: tuple[Check, ...] = (),
) -> Quality:
    """Assess the quality of a study's standing trial and trials.

    Args:
        subject: the subject's model, fitted to standing.
        trials: measured trials.
        checks: their plausibility checks.
    """
    report = subject.report
    measured = report.get("standing_mass_kg")
    stated = report["stated_mass_kg"]
    warnings = []
    if measured is not None and stated is not None:
        off = measured / stated - 1.0
        if 100.0 * abs(off) > LIMITS["mass"][0]:
            warnings.append(
                f"standing gives {measured:.1f} kg, the study says "
                f"{stated:.1f} kg ({100 * off:+.0f} %); check plates and mass"
            )
    return Quality(
        measured,
        stated,
        tuple(_of_trial(subject, trial) for trial in trials),
        tuple(warnings),
        tuple(_model_notes(report)),
        checks,
    )


def _model_notes(report: dict[str, Any]):
    """Lines on how the device and the OpenSim model were read."""
    yield from report.get("device_notes", ())
    said = report.get("osim")
    if said is None:
        return
    yield (
        f"model: {said['file']}, {said['mass_kg']:.1f} kg"
        + (
            f", scaled to {report['stated_mass_kg']:.1f} kg"
            if report["mass_from"] != "OpenSim model"
            else ""
        )
    )
    yield from said["notes"]
    if said["not_seen"]:
        yield (
            "markers of the model that standing lacks: "
            f"{', '.join(said['not_seen'])}"
        )


def _of_trial(subject: SubjectModel, trial: Trial) -> TrialQuality:
    said = trial.provenance
    markers = said["marker_residual_rms_m"]
    residual = force_residual(subject, trial)
    size = np.sqrt(np.mean(residual**2, axis=0))
    gaps = sum(said["gaps_filled"].values()) / max(len(markers), 1)
    worst = max(markers, key=markers.get)
    weight = subject.model.tree.weight
    warnings = []
    if markers[worst] > LARGEST_MARKER_RMS_M:
        warnings.append(
            f"marker {worst} lies {1e3 * markers[worst]:.0f} mm off the model"
        )
    if size[:2].max() > LARGEST_RESIDUAL_N * weight:
        warnings.append(
            f"Newton's law misses {size[:2].max():.0f} N "
            f"({100 * size[:2].max() / weight:.0f} % of body weight)"
        )
    if gaps > LARGEST_GAPS:
        warnings.append(f"{100 * gaps:.0f} % of marker frames are filled")
    if said["markers_left_out"]:
        names = ", ".join(said["markers_left_out"])
        warnings.append(f"left out, hidden for too long: {names}")
    warnings += [
        f"the clock of {name} is {1e3 * d:+.0f} ms off"
        for name, d in said["delays_s"].items()
        if abs(d) > LARGEST_DELAY_S
    ]
    warnings += [
        f"stuck cells of {mat}: {found['stuck_cells']} never change, are twice "
        "as high as all others, and count in the cuff's force"
        for mat, found in said["mats"].items()
        if "stuck_cells" in found
    ]
    return TrialQuality(
        name=trial.name,
        start_s=trial.start_s,
        end_s=trial.start_s + trial.duration,
        marker_rms_m=markers,
        worst_marker=worst,
        marker_rms_all_m=float(
            np.sqrt(np.mean(np.square(list(markers.values()))))
        ),
        gaps=float(gaps),
        filled_frames=round(
            sum(said["gaps_filled"].values()) * len(trial.times)
        ),
        left_out=tuple(said["markers_left_out"]),
        residual_n=(float(size[0]), float(size[1])),
        residual_nm=float(size[2]),
        residual=residual,
        delays_s=said["delays_s"],
        notes=tuple(_notes(trial)),
        warnings=tuple(warnings),
    )


# Format of each entry in a plate's levels and in a mat's report.
_LEVELS = {
    "empty_plate_n": "{:.1f} N while empty",
    "offset_n": "offset {:.1f} N",
    "drift_n_s": "drift {:.2f} N/s",
    "unloaded_s": "unloaded for {:.1f} s",
}
_MATS = {
    "surface": "surface {}",
    "cell_distance_mm": "cells {:.1f} mm apart",
    "peak_kpa": "at most {:.3g} kPa",
    "at_peak_share": "{:.0%} of what is loaded reads that",
    "forward_share": "forward part of its push {:+.0%}",
    "stuck_cells": "{} cells are stuck",
    "doubled": "{}",
}


def _notes(trial: Trial):
    """Lines on how a trial was processed."""
    said = trial.provenance
    for name, text in said["clocks"].items():
        yield f"clock of {name}: {text}"
    for plate, found in said["plate_levels"].items():
        parts = [_LEVELS[k].format(v) for k, v in found.items()]
        yield f"plate {plate} levelled: {', '.join(parts)}"
    if said["one_leg_doubled"]:
        yield "one foot on a plate: its forces are doubled"
    if said["legs_followed"] != ["left", "right"]:
        yield f"markers follow the {said['legs_followed'][0]} leg alone"
    if said.get("encoder_legs", "both") != "both":
        yield f"encoders of the {said['encoder_legs']} leg stand for both"
    if said.get("markers_absent"):
        names = ", ".join(said["markers_absent"])
        yield f"markers of the model that the file lacks: {names}"
    moments = ", ".join(f"{k}: {v}" for k, v in said["moments"].items())
    yield f"joint moments: {moments}"
    names = trial.coordinates.device
    if names and trial.moments is not None:
        # A wrong sign or unit shows only here, see docs/plausibility.md.
        found = np.abs(trial.device_moments).max(axis=0)
        most = zip(names, found, strict=True)
        yield (
            f"device: {', '.join(f'{n} up to {x:.3g} N m' for n, x in most)}; "
            f"does {trial.device_work:+.3g} J on the movement"
        )
    yield f"chair: {said['chair']}"
    for load in said.get("loads", ()):
        yield f"load: {load}"
    for mat, found in said["mats"].items():
        parts = [_MATS[k].format(v) for k, v in found.items()]
        parts = [part.replace("%", " %") for part in parts]
        yield f"mat {mat}: {', '.join(parts)}"


def text_of(quality: Quality) -> str:
    """The report as text."""
    lines = ["standing"]
    if quality.standing_mass_kg is None:
        lines.append("  body mass: not measured (no plates)")
    else:
        stated = "not stated"
        if quality.stated_mass_kg is not None:
            stated = f"stated {quality.stated_mass_kg:.1f} kg"
        lines.append(
            f"  body mass: {quality.standing_mass_kg:.1f} kg by the plates, "
            f"{stated}"
        )
    lines += [f"  {note}" for note in quality.notes]
    lines += [f"  ! {w}" for w in quality.warnings]
    for t in quality.trials:
        worst = 1e3 * t.marker_rms_m[t.worst_marker]
        lines += [
            f"{t.name} ({t.start_s:.2f} to {t.end_s:.2f} s)",
            f"  markers: {1e3 * t.marker_rms_all_m:.1f} mm from the model, "
            f"worst {t.worst_marker} {worst:.1f} mm; "
            f"gaps filled in {t.filled_frames} marker frames"
            + (f" ({100 * t.gaps:.2g} %)" if t.filled_frames else ""),
            f"  Newton's law misses: F_x {t.residual_n[0]:.1f} N, "
            f"F_z {t.residual_n[1]:.1f} N, moment {t.residual_nm:.1f} N m "
            "(RMS)",
            "  lag taken out: "
            + ", ".join(
                f"{name} {1e3 * d:+.0f} ms" for name, d in t.delays_s.items()
            ),
        ]
        lines += [f"  {note}" for note in t.notes]
        lines += [f"  ! {w}" for w in t.warnings]
    return "\n".join(lines)
