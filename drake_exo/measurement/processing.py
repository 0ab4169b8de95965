"""A whole recording, processed: what trials are cut from.

From a study's files to its trials.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import Progress
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.clocks import (
    EXPLAINED,
    encoder_delay,
    force_delay,
    mat_delay,
)
from drake_exo.measurement.events import (
    Rise,
    find_rises,
    on_segments,
    until_seat_off,
)
from drake_exo.measurement.exoskeleton import (
    Signal,
    check_covers,
    drive_moments,
    read_angles,
    read_moments,
)
from drake_exo.measurement.filters import derivatives, low_pass, resample
from drake_exo.measurement.instruments import Device
from drake_exo.measurement.inverse_dynamics import (
    from_the_ground_up,
    inverse_dynamics,
)
from drake_exo.measurement.kinematics import (
    merge_legs,
    residual_rms,
    solve_poses,
)
from drake_exo.measurement.mats import MatForce, read_mat_forces
from drake_exo.measurement.recording import (
    FootForces,
    common_time,
    fill_gaps,
    read_foot_forces,
    read_markers,
)
from drake_exo.measurement.sagittal import (
    PlanarWrench,
    SagittalFrame,
    merge_feet,
)
from drake_exo.measurement.subject import SubjectModel, fit_subject
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import COUPLED_COORDINATES, RIGID_COORDINATES
from drake_exo.study import Study, TrialFiles


@dataclass(frozen=True)
class Movement:
    """A whole recording, processed: what trials are cut from.

    Attributes:
        time: (N,) [s].
        q, v, a: (N, 6) filtered motion of the rigid model.
        ankles: side -> (N, 2) filtered ankle centres [m].
        hip_z: (N,) height of the middle of the hips [m].
        forces: foot -> filtered wrench (N,).
        chair: filtered wrench (N,) of the chair until seat-off, None where
            no plate is under it.
        is_one_leg: whether only one foot stood on a plate.
        delays_s: "forces", "encoders", "pressure" -> lag of the clock that
            was taken out [s].
        clocks: what the estimates of those say of themselves.
        plate_levels: plate -> offset and drift that were taken out.
        rises: sit-to-stand rises found in it.
        marker_residuals_m: marker -> RMS distance from the model.
        gaps_filled: marker -> share of frames that was filled.
        angles: encoders, None for none.
        moments: recorded exoskeleton moments, None for none.
        mats: force of each mat.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ankles: dict[str, np.ndarray]
    hip_z: np.ndarray
    forces: dict[str, PlanarWrench]
    chair: PlanarWrench | None
    is_one_leg: bool
    delays_s: dict[str, float]
    clocks: dict[str, str]
    plate_levels: dict[str, dict]
    rises: list[Rise]
    marker_residuals_m: dict[str, float]
    gaps_filled: dict[str, float]
    angles: Signal | None = None
    moments: Signal | None = None
    mats: tuple[MatForce, ...] = ()


@dataclass
class _Motion:
    """Markers, made coordinates."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ankles: dict[str, np.ndarray]
    hip_z: np.ndarray
    residuals: dict[str, float]


def process(
    files: TrialFiles, subject: SubjectModel, study: Study, root: Path
) -> Movement:
    """Read, clean, synchronise and filter a whole recording.

    Raises:
        InputError: as `loading.load_trials`.
    """
    markers, gaps = fill_gaps(
        read_markers(root / files.markers, study.filter),
        subject.markers.names,
        study.laboratory.fill_gaps_s,
    )
    forces = _read_forces(files, study, root)
    time = common_time(markers, forces, study.filter)
    motion = _follow(files.name, markers, time, subject, study)
    forces = forces.filtered(study.filter)
    delays = {"forces": study.laboratory.force_delay_s}
    clocks: dict[str, str] = {}
    if study.laboratory.estimate_force_delay:
        late = _force_delay(
            motion, forces.delayed(delays["forces"]), subject, study
        )
        delays["forces"] += late
        clocks["forces"] = _said(late, study, None)
    forces = forces.delayed(delays["forces"])
    wrenches, chair = forces.at(time), forces.chair_at(time)
    weight = subject.rigid.mass * subject.rigid.gravity
    if chair is not None:
        chair = until_seat_off(time, chair, weight)
    angles, moments = _exoskeleton(
        files, motion, subject, study, root, delays, clocks
    )
    mats = _mats(files, motion, angles, subject, study, root, delays, clocks)
    return Movement(
        time=time,
        q=motion.q,
        v=motion.v,
        a=motion.a,
        ankles=motion.ankles,
        hip_z=motion.hip_z,
        forces=wrenches,
        chair=chair,
        is_one_leg=forces.is_one_leg,
        delays_s=delays,
        clocks=clocks,
        plate_levels=forces.levels,
        rises=_rises(motion, wrenches, chair, forces.is_one_leg, subject),
        marker_residuals_m=motion.residuals,
        gaps_filled=gaps,
        angles=angles,
        moments=moments,
        mats=mats,
    )


def _read_forces(files: TrialFiles, study: Study, root: Path) -> FootForces:
    laboratory, settings = study.laboratory, study.filter
    forces = read_foot_forces(
        root / files.forces, files.plates, laboratory, settings
    )
    if files.empty_plates is not None:
        forces = forces.without(
            read_foot_forces(
                root / files.empty_plates,
                files.plates,
                laboratory,
                settings,
                loaded=False,
            )
        )
    return forces.levelled() if laboratory.remove_plate_drift else forces


def _follow(
    name: str,
    markers: MarkerData,
    time: np.ndarray,
    subject: SubjectModel,
    study: Study,
) -> _Motion:
    """Inverse kinematics of the frames at `time`, filtered."""
    frame = SagittalFrame(
        study.laboratory.marker_axes.forward, study.laboratory.marker_axes.up
    )
    points = frame.points(markers.of(subject.markers.names))
    inside = np.searchsorted(markers.time, time[0] - 1e-9)
    points = points[inside : inside + len(time)]
    with Progress(f"inverse kinematics of {name}") as progress:
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
    return _Motion(
        time,
        q,
        v,
        a,
        {side: smooth(p) for side, p in ankles.items()},
        smooth(poses.hip.imag),
        residual_rms(subject.markers, poses),
    )


def _vertical(wrenches: dict[str, PlanarWrench], is_one_leg: bool):
    F_z = sum(w.force[:, 1] for w in wrenches.values())
    return 2.0 * F_z if is_one_leg else F_z


def _rises(motion, wrenches, chair, is_one_leg, subject) -> list[Rise]:
    """Rises, by the chair's plate or else by what the feet leave over."""
    tree = subject.rigid
    F_z = _vertical(wrenches, is_one_leg)
    if chair is None:
        needed = inverse_dynamics(tree, motion.q, motion.v, motion.a, {})[:, 1]
        on_chair = needed - F_z
    else:
        on_chair = chair.force[:, 1]
    weight = tree.mass * tree.gravity
    return find_rises(motion.time, motion.hip_z, on_chair, F_z, weight)


def _force_delay(motion, forces: FootForces, subject, study) -> float:
    """Lag of the forces, from the rises (or from all loaded frames)."""
    time, tree = motion.time, subject.rigid
    wrenches, chair = forces.at(time), forces.chair_at(time)
    weight = tree.mass * tree.gravity
    needed = inverse_dynamics(tree, motion.q, motion.v, motion.a, {})[:, 1]
    F_z = _vertical(wrenches, forces.is_one_leg)
    reach = study.laboratory.largest_delay_s
    if chair is not None:  # together they bear the body all the time
        everywhere = np.ones(len(time), bool)
        total = F_z + chair.force[:, 1]
        return force_delay(time, needed, total, everywhere, reach)
    rises = _rises(motion, wrenches, chair, forces.is_one_leg, subject)
    used = np.zeros(len(time), bool)
    for rise in rises:
        used |= (time >= rise.seat_off_s) & (time <= rise.standing_s)
    if not rises:
        used = F_z > 0.5 * weight
    return force_delay(time, needed, F_z, used, reach)


def _said(delay: float, study: Study, explained: float | None) -> str:
    """What an estimated delay is worth, in words."""
    reach = study.laboratory.largest_delay_s
    text = f"estimated {1e3 * delay:+.0f} ms"
    if explained is not None:
        text += f", {100.0 * explained:.0f} % explained"
    if abs(delay) > reach - 1.5e-3:
        text += "; at the edge of the search, raise laboratory.largest_delay_s"
    return text


def _exoskeleton(files, motion, subject, study: Study, root, delays, clocks):
    """Encoders and recorded moments, on the markers' clock."""
    if study.model == "human":
        return None, None
    device = study.device or Device()
    angles, moments = None, None
    if files.exo_moments is not None:
        path = root / files.exo_moments
        moments = read_moments(path, device.moment_legs, study.filter)
    delay = study.laboratory.encoder_delay_s
    if files.encoders is not None:
        path = root / files.encoders
        angles = read_angles(path, device.encoder_legs, study.filter)
        if study.laboratory.estimate_encoder_delay:
            late, explained = encoder_delay(
                motion.time,
                (motion.q, motion.v, motion.a),
                angles.delayed(delay),
                _drive(device, moments, delay, subject),
                subject,
                study.laboratory.largest_delay_s,
            )
            delay += _believed("encoders", late, explained, study, clocks)
        angles = angles.delayed(delay)
        delays["encoders"] = delay
    if moments is not None:
        moments = moments.delayed(delay)
    return angles, moments


def _drive(device: Device, moments: Signal | None, delay: float, subject):
    """The device's joint moments as a function of its time and motion."""
    if moments is None:
        return lambda _, q, v, a: drive_moments(
            device, subject.coupled, q, v, a
        )
    time = moments.time - delay

    def recorded(at, *_):
        return np.column_stack(
            [np.interp(at, time, x) for x in moments.values.T]
        )

    return recorded


def _believed(name, late, explained, study: Study, clocks) -> float:
    """The estimate, or none if it explains too little; says which."""
    clocks[name] = _said(late, study, explained)
    if explained >= EXPLAINED:
        return late
    clocks[name] += "; too little, not applied"
    return 0.0


def _mats(files, motion, angles, subject, study: Study, root, delays, clocks):
    """Force of each mat, on the markers' clock."""
    mats = read_mat_forces(files.pressure, study.mats, root, study.filter)
    if not mats:
        return ()
    laboratory = study.laboratory
    delay = laboratory.pressure_delay_s
    if laboratory.estimate_pressure_delay:
        if angles is None:
            clocks["pressure"] = "not estimated: there are no encoders"
        else:
            late, explained = _pressure_delay(
                motion, angles, mats, delay, subject, laboratory
            )
            delay += _believed("pressure", late, explained, study, clocks)
    delays["pressure"] = delay
    return tuple(mat.delayed(delay) for mat in mats)


def _pressure_delay(motion, angles: Signal, mats, delay, subject, laboratory):
    """Lag of the mats behind the deflection between device and human."""
    seen = (motion.time >= angles.time[0]) & (motion.time <= angles.time[-1])
    time = motion.time[seen]
    q = np.hstack([motion.q[seen], angles.at(time, "encoder angles")])
    signals = [(m.segment, m.time - delay, m.normal) for m in mats]
    return mat_delay(time, q, signals, subject, laboratory.largest_delay_s)


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
