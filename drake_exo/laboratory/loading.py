"""From a study's files to its trials."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.cleaning import fill_gaps
from drake_exo.laboratory.filters import (
    check_filterable,
    derivatives,
    low_pass,
    resample,
)
from drake_exo.laboratory.inverse_dynamics import inverse_dynamics
from drake_exo.laboratory.inverse_kinematics import (
    merge_legs,
    residual_rms,
    solve_poses,
)
from drake_exo.laboratory.opensim_files import read_coordinates
from drake_exo.laboratory.recording import (
    FootForces,
    common_time,
    read_foot_forces,
    read_markers,
)
from drake_exo.laboratory.rises import Rise, find_rises
from drake_exo.laboratory.sagittal import (
    PlanarWrench,
    SagittalFrame,
    merge_feet,
)
from drake_exo.laboratory.subject import SubjectModel, fit_subject
from drake_exo.laboratory.synchronise import force_delay
from drake_exo.laboratory.tables import uniform_time
from drake_exo.laboratory.trial import Trial
from drake_exo.output import Progress
from drake_exo.plant import COUPLED_COORDINATES, RIGID_COORDINATES
from drake_exo.study import Study, TrialFiles

_EXO = COUPLED_COORDINATES[len(RIGID_COORDINATES) :]


@dataclass(frozen=True)
class Movement:
    """A whole recording, processed: what trials are cut from.

    Attributes:
        time: (N,) [s].
        q, v, a: (N, 6) filtered motion of the rigid model.
        ankles: side -> (N, 2) filtered ankle centres [m].
        hip_z: (N,) height of the middle of the hips [m].
        forces: foot -> filtered wrench (N,).
        is_one_leg: whether only one foot stood on a plate.
        force_delay_s: lag of the plates' clock that was taken out [s].
        rises: sit-to-stand rises found in it.
        marker_residuals_m: marker -> RMS distance from the model.
        gaps_filled: marker -> share of frames that was filled.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ankles: dict[str, np.ndarray]
    hip_z: np.ndarray
    forces: dict[str, PlanarWrench]
    is_one_leg: bool
    force_delay_s: float
    rises: list[Rise]
    marker_residuals_m: dict[str, float]
    gaps_filled: dict[str, float]


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
        key = (files.markers, files.forces, files.plates)
        if key not in movements:
            movements[key] = process(files, subject, study, root)
        trials.append(cut(files, movements[key], subject, study, root))
    return subject, tuple(trials)


def load_trial(
    files: TrialFiles, subject: SubjectModel, study: Study, root: Path
) -> Trial:
    """Read, process and cut one trial; raises as `load_trials`."""
    movement = process(files, subject, study, root)
    return cut(files, movement, subject, study, root)


def process(
    files: TrialFiles, subject: SubjectModel, study: Study, root: Path
) -> Movement:
    """Inverse kinematics, filtering and rises of a whole recording.

    Raises:
        InputError: as `load_trials`.
    """
    markers, gaps = fill_gaps(
        read_markers(root / files.markers, study.filter),
        subject.markers.names,
        study.laboratory.fill_gaps_s,
    )
    forces = read_foot_forces(
        root / files.forces, files.plates, study.laboratory, study.filter
    )
    time = common_time(markers, forces, study.filter)
    frame = SagittalFrame(
        study.laboratory.marker_axes.forward, study.laboratory.marker_axes.up
    )
    points = frame.points(markers.of(subject.markers.names))
    inside = np.searchsorted(markers.time, time[0] - 1e-9)
    points = points[inside : inside + len(time)]
    with Progress(f"inverse kinematics of {files.name}") as progress:
        poses = solve_poses(subject.markers, points, markers.source, progress)
    q, ankles = merge_legs(subject.markers, poses)

    def smooth(values):
        return low_pass(
            values,
            markers.rate_hz,
            study.filter.cutoff_hz,
            study.filter.order,
            markers.source,
        )

    q = smooth(q)
    v, a = derivatives(time, q)
    hip_z = smooth(poses.hip.imag)
    forces = forces.filtered(study.filter)
    delay = study.laboratory.force_delay_s
    if study.laboratory.estimate_force_delay:
        delay += _delay(time, q, v, a, hip_z, forces.delayed(delay), subject)
    wrenches = forces.delayed(delay).at(time)
    return Movement(
        time=time,
        q=q,
        v=v,
        a=a,
        ankles={side: smooth(p) for side, p in ankles.items()},
        hip_z=hip_z,
        forces=wrenches,
        is_one_leg=forces.is_one_leg,
        force_delay_s=delay,
        rises=_rises(time, q, v, a, hip_z, wrenches, forces, subject),
        marker_residuals_m=residual_rms(subject.markers, poses),
        gaps_filled=gaps,
    )


def _rises(time, q, v, a, hip_z, wrenches, forces: FootForces, subject):
    tree = subject.rigid
    F_z = sum(w.force[:, 1] for w in wrenches.values())
    F_z = 2.0 * F_z if forces.is_one_leg else F_z
    needed = inverse_dynamics(tree, q, v, a, {})[:, 1]
    weight = tree.mass * tree.gravity
    return find_rises(time, hip_z, needed - F_z, F_z, weight)


def _delay(time, q, v, a, hip_z, forces: FootForces, subject):
    """Lag of the forces, from the rises (or from all loaded frames)."""
    wrenches = forces.at(time)
    rises = _rises(time, q, v, a, hip_z, wrenches, forces, subject)
    F_z = sum(w.force[:, 1] for w in wrenches.values())
    F_z = 2.0 * F_z if forces.is_one_leg else F_z
    used = np.zeros(len(time), bool)
    for rise in rises:
        used |= (time >= rise.seat_off_s) & (time <= rise.standing_s)
    if not rises:
        used = F_z > 0.5 * subject.rigid.mass * subject.rigid.gravity
    needed = inverse_dynamics(subject.rigid, q, v, a, {})[:, 1]
    return force_delay(time, needed, F_z, used)


def cut(
    files: TrialFiles,
    movement: Movement,
    subject: SubjectModel,
    study: Study,
    root: Path,
) -> Trial:
    """Cut one trial out of a processed recording.

    Raises:
        InputError: no such rise, a part outside the recording, or encoder
            angles that do not cover it.
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
    q, v, a, names, exo = _with_exoskeleton(
        files, movement, inside, study, root
    )
    provenance = {
        "markers": files.markers.as_posix(),
        "forces": files.forces.as_posix(),
        "filter": {
            "kind": "Butterworth, zero lag",
            "cutoff_hz": study.filter.cutoff_hz,
            "order": study.filter.order,
        },
        "part": how,
        "plate_shift_m": shifts,
        "force_delay_s": movement.force_delay_s,
        "one_leg_doubled": movement.is_one_leg,
        "legs_followed": list(subject.markers.sides),
        "marker_residual_rms_m": movement.marker_residuals_m,
        "gaps_filled": movement.gaps_filled,
        **exo,
    }
    return Trial(
        name=files.name,
        coordinates=names,
        time=movement.time[inside],
        q=q,
        v=v,
        a=a,
        grf=wrench.force,
        moment_y=wrench.moment,
        mass_kg=subject.mass_kg,
        provenance=provenance,
    )


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


def _with_exoskeleton(files, movement, inside, study: Study, root: Path):
    """Coordinates of the study's model; adds the exoskeleton's angles."""
    q, v, a = (x[inside] for x in (movement.q, movement.v, movement.a))
    if study.model == "human":
        return q, v, a, RIGID_COORDINATES, {}
    if files.encoders is None:
        parts = [np.hstack([x, x[:, 3:]]) for x in (q, v, a)]
        note = {"exoskeleton_angles": "as the human's (no encoders)"}
        return *parts, COUPLED_COORDINATES, note
    exo = _encoders(root / files.encoders, movement.time[inside], study)
    parts = [np.hstack([x, y]) for x, y in zip((q, v, a), exo, strict=True)]
    note = {"encoders": files.encoders.as_posix()}
    return *parts, COUPLED_COORDINATES, note


def _encoders(path: Path, time: np.ndarray, study: Study):
    """Exoskeleton angles and derivatives (N, 3) at `time`."""
    table = read_coordinates(path)
    grid = uniform_time(table.source, table.time)
    angles = table.columns(_EXO)
    rate = (len(grid) - 1) / (grid[-1] - grid[0])
    check_filterable(table.source, len(grid), rate, study.filter.cutoff_hz)
    if grid[0] > time[0] + 1e-9 or grid[-1] < time[-1] - 1e-9:
        raise InputError(
            f"{table.source}: encoder angles cover {grid[0]:g} to "
            f"{grid[-1]:g} s, but the trial runs from {time[0]:g} to "
            f"{time[-1]:g} s; export the whole trial or shorten it with "
            "start_s and end_s"
        )
    angles = low_pass(
        angles,
        rate,
        study.filter.cutoff_hz,
        study.filter.order,
        table.source,
    )
    return tuple(
        resample(grid, x, time) for x in (angles, *derivatives(grid, angles))
    )
