"""From a study's files to its trials."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.chair_plate import on_segments
from drake_exo.laboratory.exoskeleton_signals import (
    check_covers,
    drive_moments,
)
from drake_exo.laboratory.filters import resample
from drake_exo.laboratory.inverse_dynamics import (
    from_the_ground_up,
    inverse_dynamics,
)
from drake_exo.laboratory.movement import Movement, process
from drake_exo.laboratory.sagittal import PlanarWrench, merge_feet
from drake_exo.laboratory.subject import SubjectModel, fit_subject
from drake_exo.laboratory.trial import Trial
from drake_exo.plant import COUPLED_COORDINATES, RIGID_COORDINATES
from drake_exo.study import Study, TrialFiles

__all__ = ["Movement", "cut", "load_trial", "load_trials", "process"]


def load_trials(
    study: Study, root: Path
) -> tuple[SubjectModel, tuple[Trial, ...]]:
    """Read a study's files, fit the subject, and cut out its trials.

    Trials from the same recording share its inverse kinematics.

    Raises:
        InputError: a file or the study is not as it should be.
    """
    subject = fit_subject(study, root)
    movements: dict[Any, Movement] = {}
    trials = []
    for files in study.trials:
        key = _recording(files)
        if key not in movements:
            movements[key] = process(files, subject, study, root)
        trials.append(cut(files, movements[key], subject, study))
    return subject, tuple(trials)


def load_trial(
    files: TrialFiles, subject: SubjectModel, study: Study, root: Path
) -> Trial:
    """Read, process and cut one trial; raises as `load_trials`."""
    movement = process(files, subject, study, root)
    return cut(files, movement, subject, study)


def cut(
    files: TrialFiles,
    movement: Movement,
    subject: SubjectModel,
    study: Study,
) -> Trial:
    """Cut one trial out of a processed recording.

    Raises:
        InputError: no such rise, a part outside the recording, or encoders,
            moments or mats that do not cover it.
    """
    start, end, how = _bounds(files, movement)
    inside = (movement.time >= start - 1e-9) & (movement.time <= end + 1e-9)
    if inside.sum() < 2:
        raise InputError(
            f"trial {files.name}: {start:g} to {end:g} s holds no part of "
            f"the recording ({movement.time[0]:g} to "
            f"{movement.time[-1]:g} s); correct start_s and end_s"
        )
    wrench, shifts = _merge(movement, inside)
    time = movement.time[inside]
    q, v, a, names, exo = _coordinates(files, movement, inside, study)
    chair, on_thighs = _chair(movement, inside, study)
    moments, source = _moments(
        movement, subject, study, (time, q, v, a), wrench, chair
    )
    normal_force, mats = _normal_forces(movement, time)
    provenance = {
        **_provenance(files, movement, subject, study),
        "part": how,
        "plate_shift_m": shifts,
        "moments": source,
        "chair": "plate" if chair is not None else "not measured",
        "mats": mats,
        **exo,
    }
    return Trial(
        name=files.name,
        coordinates=names,
        time=time,
        q=q,
        v=v,
        a=a,
        grf=wrench.force,
        moment_y=wrench.moment,
        mass_kg=subject.mass_kg,
        provenance=provenance,
        moments=moments,
        normal_force=normal_force,
        chair=chair,
        chair_on_thighs=on_thighs,
    )


def _provenance(
    files: TrialFiles, movement: Movement, subject: SubjectModel, study: Study
) -> dict[str, Any]:
    """Which files, which filter, what was done to the whole recording."""
    return {
        "markers": files.markers.as_posix(),
        "forces": files.forces.as_posix(),
        "filter": {
            "kind": "Butterworth, zero lag",
            "cutoff_hz": study.filter.cutoff_hz,
            "order": study.filter.order,
        },
        "force_delay_s": movement.delays_s["forces"],
        "delays_s": movement.delays_s,
        "clocks": movement.clocks,
        "plate_levels": movement.plate_levels,
        "one_leg_doubled": movement.is_one_leg,
        "legs_followed": list(subject.markers.sides),
        "marker_residual_rms_m": movement.marker_residuals_m,
        "gaps_filled": movement.gaps_filled,
    }


def _bounds(files: TrialFiles, movement: Movement):
    """Start and end of a trial, and how they came about."""
    start, end = float(movement.time[0]), float(movement.time[-1])
    how: dict[str, Any] = {"from": "whole recording"}
    if files.rise is not None:
        found = movement.rises
        if files.rise > len(found):
            raise InputError(
                f"trial {files.name}: rise {files.rise} was asked for, but "
                f"{len(found)} were found in {files.markers}; give start_s "
                "and end_s instead"
            )
        rise = found[files.rise - 1]
        start, end = rise.seat_off_s, rise.standing_s
        how = {
            "from": "rise",
            "rise": files.rise,
            "seat_off_s": rise.seat_off_s,
            "halfway_s": rise.halfway_s,
            "standing_s": rise.standing_s,
            "chair_bore_weight": rise.had_chair,
            "standing_is_steady": rise.is_steady,
        }
        if files.seated_s > 0.0:
            start, how["seated_s"] = start - files.seated_s, files.seated_s
    if files.start_s is not None:
        start, how["start_s"] = files.start_s, files.start_s
    if files.end_s is not None:
        end, how["end_s"] = files.end_s, files.end_s
    outside = max(movement.time[0] - start, end - movement.time[-1])
    if outside > movement.time[1] - movement.time[0]:
        raise InputError(
            f"trial {files.name}: {start:g} to {end:g} s reaches beyond the "
            f"recording ({movement.time[0]:g} to {movement.time[-1]:g} s); "
            "correct start_s and end_s"
        )
    return start, end, how


def _merge(movement: Movement, inside: np.ndarray):
    """Both feet's wrench in the part, and the shift of each plate [m]."""
    part = {
        foot: PlanarWrench(w.force[inside], w.moment[inside])
        for foot, w in movement.forces.items()
    }
    if "both" in part:
        return part["both"], {"both": 0.0}
    places = {
        side: float(p[inside, 0].mean()) for side, p in movement.ankles.items()
    }
    middle = float(np.mean(list(places.values())))
    return merge_feet(part, {side: places.get(side, middle) for side in part})


def _recording(files: TrialFiles) -> TrialFiles:
    """What trials of one recording have in common."""
    return replace(
        files,
        name="",
        use="calibration",
        rise=None,
        seated_s=0.0,
        start_s=None,
        end_s=None,
    )


def _coordinates(files, movement: Movement, inside, study: Study):
    """Coordinates of the study's model; adds the exoskeleton's angles."""
    q, v, a = (x[inside] for x in (movement.q, movement.v, movement.a))
    if study.model == "human":
        return q, v, a, RIGID_COORDINATES, {}
    if movement.angles is None:
        parts = [np.hstack([x, x[:, 3:]]) for x in (q, v, a)]
        note = {"exoskeleton_angles": "as the human's (no encoders)"}
        return *parts, COUPLED_COORDINATES, note
    exo = movement.angles.motion(movement.time[inside])
    parts = [np.hstack([x, y]) for x, y in zip((q, v, a), exo, strict=True)]
    note = {
        "encoders": files.encoders.as_posix(),
        "encoder_legs": movement.angles.one_leg or "both",
    }
    return *parts, COUPLED_COORDINATES, note


def _chair(movement: Movement, inside, study: Study):
    """Wrench (n, 3) of the chair in the part, and the thighs' share."""
    if movement.chair is None:
        return None, 0.0
    w = movement.chair
    chair = np.column_stack([w.force, w.moment])[inside]
    return chair, study.laboratory.chair_on_thighs


def _moments(movement, subject, study: Study, motion, wrench, chair):
    """Joint moments (n, nq - 3), and where they come from.

    The resultant is that of the rigid model, from the ground up; the human's
    is what the exoskeleton's leaves of it.
    """
    time, q, v, a = motion
    loads = {"foot": wrench}
    if chair is not None:
        loads |= on_segments(chair, study.laboratory.chair_on_thighs)
    rigid = [x[:, :6] for x in (q, v, a)]
    Q = inverse_dynamics(subject.rigid, *rigid, loads)
    resultant = from_the_ground_up(subject.rigid, rigid[0], Q)[:, 3:]
    if study.model == "human":
        return resultant, {"human": "resultant"}
    if movement.moments is not None:
        exo = movement.moments.at(time, "exoskeleton moments")
        source = "recorded"
        if movement.moments.one_leg:
            source += f", {movement.moments.one_leg} leg doubled"
    elif study.device is not None:
        exo = drive_moments(study.device, subject.coupled, q, v, a)
        source = "device model"
        if movement.angles is None:
            source += " at the human's angles"
    else:
        return None, {
            "human": "unknown: neither exo_moments nor device are given"
        }
    moments = np.hstack([resultant - exo, exo])
    return moments, {"human": "resultant - exoskeleton", "exoskeleton": source}


def _normal_forces(movement: Movement, time):
    """Normal force by segment, both legs, and what was doubled."""
    total: dict[str, np.ndarray] = {}
    notes: dict[str, Any] = {}
    for mat in movement.mats:
        check_covers(mat.source, mat.time, time, f"pressures of {mat.name}")
        at = np.clip(time, mat.time[0], mat.time[-1])
        force = resample(mat.time, mat.normal, at)
        total[mat.segment] = total.get(mat.segment, 0.0) + force
        notes[mat.name] = mat.report
    return total, notes
