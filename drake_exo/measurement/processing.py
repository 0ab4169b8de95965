"""Process recordings (read, synchronise, filter) and cut trials out of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import Progress
from drake_exo.files.tables import MarkerData, between
from drake_exo.measurement.events import (
    Contact,
    Rise,
    Sit,
    contacts,
    event_s,
    find_rises,
    find_sits,
    until_seat_off,
)
from drake_exo.measurement.exoskeleton import (
    Signal,
    drive_moments,
    friction_moments,
    read_angles,
    read_moments,
)
from drake_exo.measurement.filters import (
    Gap,
    Gaps,
    MarkerFault,
    derivatives,
    fill_gaps,
    gap_remedy,
    leaps,
    standstills,
)
from drake_exo.measurement.kinematics import (
    MarkerModel,
    ankle_paths,
    carried,
    coordinates,
    inverse_dynamics,
    leg_angles,
    residual_rms,
    residuals,
    solve_poses,
)
from drake_exo.measurement.mats import MatForce, read_mat_forces
from drake_exo.measurement.recording import (
    FootForces,
    check_loaded,
    common_time,
    force_delay,
    read_feet,
    read_foot_forces,
    read_markers,
)
from drake_exo.measurement.sagittal import Axes, PlanarWrench, merge_plates
from drake_exo.measurement.settings import (
    Device,
    Laboratory,
    Load,
    Plates,
    RecordingSettings,
    TrialFiles,
    listed,
)
from drake_exo.measurement.subject import SubjectModel
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.assembly import SIDES
from drake_exo.model.plant import Model

# Leaps from here on are noted; a heel strike changes a velocity by 2 m/s.
LEAST_LEAP_M_S = 4.0
# Lags of clocks are some tens of milliseconds; a trial knows its instruments'
# readings for this long before and after, too [s].
_AROUND_S = 0.1
# Most passes of the search for the plates' lag, and the change that ends it.
_CLOCK_PASSES, _SETTLED_S = 5, 1.5e-3
_TO_FIND = "left to the calibration, unsure"  # lag of encoders or mats


@dataclass(frozen=True)
class Motion:
    """Motion of the body without a device, by inverse kinematics.

    Attributes:
        time: (N,) [s].
        q, v, a: (N, nq) filtered coordinates and time derivatives [m, rad].
        ankles: side -> (N, 2) filtered ankle centres [m].
        hip_z: (N,) filtered height of the mid-point of the hips [m].
        residuals_m: marker -> (N,) distance from the model, NaN where hidden.
        gaps: of the markers.
        known: (N,) bool, whether visible markers determine every segment.
        legs: side -> (N, 3) filtered ankle, knee, hip of that leg [rad].
        feet: side -> (N, k, 3) markers of the foot: forward, left, up [m].
        ground_plan: (N, k, 2) all markers: forward, left [m].
        without: markers left out because they are hidden for too long.
        absent: markers of an OpenSim model that the file lacks.
        applied: segment -> wrench (N,) of the loads on it.
        load_gaps: gaps of the markers on each load of the trial.
        leaps: of the markers, see `filters.leaps` [m/s].
        standstills: of the markers, see `filters.standstills` [m].
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ankles: dict[str, np.ndarray]
    hip_z: np.ndarray
    residuals_m: dict[str, np.ndarray]
    gaps: Gaps
    known: np.ndarray
    legs: dict[str, np.ndarray]
    feet: dict[str, np.ndarray]
    ground_plan: np.ndarray
    without: tuple[str, ...] = ()
    absent: tuple[str, ...] = ()
    applied: dict[str, PlanarWrench] = field(default_factory=dict)
    load_gaps: tuple[Gaps, ...] = ()
    leaps: tuple[MarkerFault, ...] = ()
    standstills: tuple[MarkerFault, ...] = ()

    def cut(self, rows: slice) -> "Motion":
        """The motion in some samples; gaps and marker faults stay whole."""
        one = ("time", "q", "v", "a", "hip_z", "known", "ground_plan")
        several = ("ankles", "residuals_m", "legs", "feet")
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in one},
            **{
                name: {side: x[rows] for side, x in getattr(self, name).items()}
                for name in several
            },
            applied={body: w.cut(rows) for body, w in self.applied.items()},
        )


@dataclass(frozen=True)
class Recording:
    """A whole processed recording, from which trials are cut.

    Attributes:
        motion: of the body.
        forces: filtered forces of the plates on the markers' clock.
        feet: foot -> wrench (N,) at the markers' times.
        chair: wrench (N,) of the chair while it bears weight; None without a
            plate under it.
        rises: sit-to-stand rises found.
        sits: stand-to-sit movements found.
        contacts: side -> periods in which that foot stood on its own plates.
        angles: of the encoders, None without a file.
        moments: recorded exoskeleton moments, None without a file.
        mats: force of each mat.
        delays_s: of "forces", "encoders" and "pressure", where recorded: lag
            of its clock behind the markers' that was removed.
        clocks: of those whose lag is estimated: words on that.
        belt_speed_m_s: speed of the treadmill's belt, by the study.
    """

    motion: Motion
    forces: FootForces
    feet: dict[str, PlanarWrench]
    chair: PlanarWrench | None
    rises: list[Rise]
    sits: list[Sit]
    contacts: dict[str, list[Contact]]
    angles: Signal | None
    moments: Signal | None
    mats: tuple[MatForce, ...]
    delays_s: dict[str, float]
    clocks: dict[str, str]
    belt_speed_m_s: float = 0.0


class Recordings:
    """A study's recordings, each processed once, and the trials cut from them.

    Args:
        settings: of the study.
        root: folder that the study's paths start from.
        subject: the subject's model, fitted to the standing trial.
    """

    def __init__(
        self, settings: RecordingSettings, root: Path, subject: SubjectModel
    ):
        self._subject, self._settings, self._root = subject, settings, root
        self._laboratory, self._filter = settings.laboratory, settings.filter
        self._found: dict[Any, Recording] = {}

    def of(self, files: TrialFiles, without: tuple[str, ...] = ()) -> Recording:
        """A trial's whole recording, without some markers.

        Raises:
            InputError: as `trials`.
        """
        key = _recording(files), without
        if key not in self._found:
            self._found[key] = self._processed(*key)
        return self._found[key]

    def used(self, files: TrialFiles) -> Recording:
        """As `of`, without markers hidden for too long in the used part."""
        return self.of(
            files, tuple(sorted({g.marker for g in self._long(files)}))
        )

    def problem(self, files: TrialFiles) -> str | None:
        """Message if hidden markers leave a segment undetermined, or None."""
        long = self._long(files)
        motion = self.of(files).motion
        gone = [*(gap.marker for gap in long), *motion.absent]
        loose = self._subject.markers.without(gone).loose()
        if loose is None:
            return None
        return (
            f"{motion.gaps.source}: trial {files.name}: "
            f"{motion.gaps.sentence(long)}, and "
            f"too few others are left on the {loose.replace('_', ' ')}"
        )

    def trials(self, files: Sequence[TrialFiles]) -> tuple[Trial, ...]:
        """Read and process recordings, and cut their trials out.

        Trials from the same recording share its inverse kinematics. Markers
        hidden for too long in the used part are left out if enough others of
        their segment remain.

        Raises:
            InputError: a file is unreadable or does not fit the study.
        """
        problems = [p for p in map(self.problem, files) if p is not None]
        if problems:
            longest = self._laboratory.fill_gaps_s
            raise InputError(f"{'; '.join(problems)}; {gap_remedy(longest)}")
        return tuple(map(self._trial, files))

    def _long(self, files: TrialFiles) -> list[Gap]:
        found = self.of(files)
        start, end, _ = _bounds(files, found)
        reach = self._filter.reach_s
        return found.motion.gaps.too_long(start - reach, end + reach)

    def _processed(
        self, files: TrialFiles, without: tuple[str, ...]
    ) -> Recording:
        """Read, clean, synchronise and filter a recording; see `of`."""
        settings, root = self._settings, self._root
        laboratory = self._laboratory.facing(files.marker_axes)
        axes, low_pass_filter = laboratory.marker_axes, self._filter
        seen = read_markers(files.markers, settings, root)
        recorded = _on_belt(seen, axes, settings.ground.belt_speed_m_s)
        absent: tuple[str, ...] = ()
        if settings.markers is None:
            absent = _absent(self._subject.markers, recorded)
        followed = self._subject.markers.without((*without, *absent))
        model = self._subject.model
        markers, gaps = fill_gaps(
            recorded, followed.names, laboratory.fill_gaps_s
        )
        forces = read_feet(files, laboratory, low_pass_filter, root)
        on_time = forces.delayed(laboratory.force_delay_s)
        time = common_time(markers, on_time, low_pass_filter)
        load_gaps = tuple(
            fill_gaps(recorded, load.markers, laboratory.fill_gaps_s)[1]
            for load in files.loads
        )
        motion = replace(
            self._follow(markers, gaps, time, followed, axes),
            without=without, absent=absent, load_gaps=load_gaps,
            leaps=leaps(recorded, followed.names, LEAST_LEAP_M_S),
            standstills=standstills(seen, followed.by_segment()),
        )  # fmt: skip
        delays, clocks = {"forces": laboratory.force_delay_s}, {}
        loads = files.loads
        applied = self._applied(
            loads, motion, recorded, delays["forces"], laboratory
        )
        motion = replace(motion, applied=applied)
        if laboratory.estimate_force_delay:
            pulls = [load for load in loads if load.forces is not None]
            found = self._applied(
                pulls, motion, recorded, delays["forces"], laboratory
            )
            late = _force_delay(
                motion,
                on_time.filtered(low_pass_filter),
                model.rigid,
                laboratory,
                sum(wrench.force_z for wrench in found.values()),
            )
            delays["forces"] += late
            clocks["forces"] = _said(late, laboratory)
            # With the new lag, forces and markers overlap elsewhere.
            on_time = forces.delayed(delays["forces"])
            frames = replace(markers, time=time)
            time = common_time(frames, on_time, low_pass_filter)
            first = np.searchsorted(motion.time, time[0] - 1e-9)
            motion = motion.cut(slice(first, first + len(time)))
            applied = self._applied(
                loads, motion, recorded, delays["forces"], laboratory
            )
            motion = replace(motion, applied=applied)
        forces = on_time
        stood = {
            side: contacts(forces.time, wrench.force_z)
            for side, wrench in forces.wrenches.items()
            if side in SIDES
        }
        # Before the filter: on the belt, a standing foot's CoP is steady.
        forces = forces.on_belt(settings.ground.belt_speed_m_s)
        hold = laboratory.hold_cop_below_n
        _check_hold(files, forces, hold, model.rigid.tree.weight)
        forces = forces.held(hold).filtered(low_pass_filter)
        feet = forces.at(time)
        chair = feet.pop("chair", None)
        if chair is not None:
            chair = until_seat_off(time, chair, model.tree.weight)
        lag = _lag(files.encoder_delay_s, laboratory.encoder_delay_s)
        angles, moments = self._device(files, lag)
        if angles is not None or moments is not None:
            delays["encoders"] = lag
            if laboratory.estimate_encoder_delay:
                clocks["encoders"] = _TO_FIND
        worn = files.pressure if model.cuffs else ()
        mats = read_mat_forces(worn, settings.mats, root, low_pass_filter)
        if mats:
            lag = _lag(files.pressure_delay_s, laboratory.pressure_delay_s)
            delays["pressure"] = lag
            if laboratory.estimate_pressure_delay:
                clocks["pressure"] = _TO_FIND
            mats = tuple(mat.delayed(lag) for mat in mats)
        seating = _seating(motion, feet, chair, forces, model.rigid)
        return Recording(
            motion,
            forces,
            feet,
            chair,
            find_rises(*seating),
            find_sits(*seating),
            stood,
            angles,
            moments,
            mats,
            delays,
            clocks,
            settings.ground.belt_speed_m_s,
        )

    def _follow(
        self,
        markers: MarkerData,
        gaps: Gaps,
        time: np.ndarray,
        model: MarkerModel,
        axes: Axes,
    ) -> Motion:
        """Filtered motion in the frames at `time` (N,), see `solve_poses`."""
        first = np.searchsorted(markers.time, time[0] - 1e-9)
        inside = slice(first, first + len(time))
        places = axes.space(markers.of(model.names))[inside]
        hidden = gaps.hidden(model.names)[inside]
        progress = Progress(
            f"inverse kinematics of {Path(markers.source).name}"
        )
        poses = solve_poses(
            model, places[..., ::2], markers.source, progress, hidden
        )
        ankles = ankle_paths(model, poses)
        q = coordinates(self._subject.model, model, poses)

        def smooth(x):
            return self._filter.smooth(x, markers.rate_hz, markers.source)

        q = smooth(q)
        v, a = derivatives(time, q)
        return Motion(
            time,
            q,
            v,
            a,
            {side: smooth(p) for side, p in ankles.items()},
            smooth(poses.hip.imag),
            residuals(model, poses),
            gaps,
            model.determined(hidden),
            {side: smooth(x) for side, x in leg_angles(model, poses).items()},
            {
                side: axes.space(markers.of(model.on("foot", side)))[inside]
                for side in model.sides
            },
            places[..., :2],
        )

    def _applied(
        self,
        loads: Iterable[Load],
        motion: Motion,
        recorded: MarkerData,
        lag_s: float,
        laboratory: Laboratory,
    ) -> dict[str, PlanarWrench]:
        """Segment -> sum of the wrenches (N,) of loads on it.

        Markers are those of the recording, unfilled; `lag_s` is of the plates'
        clock.
        """
        time = motion.time
        found: dict[str, PlanarWrench] = {}
        for load in loads:
            late = load.from_s is not None and load.from_s >= time[-1]
            if late or (load.to_s is not None and load.to_s <= time[0]):
                raise InputError(
                    f"{recorded.source}: lasts from {time[0]:g} to "
                    f"{time[-1]:g} s, when the load on the {load.body} is "
                    "never carried; correct from_s and to_s of loads"
                )
            if load.forces is not None:
                wrench = self._of_file(load, time, lag_s, laboratory)
            else:
                axes = laboratory.marker_axes
                place = self._place(load, motion, recorded, axes)
                wrench = carried(load, time, place, self._settings.gravity_m_s2)
            if load.body in found:
                wrench = found[load.body] + wrench
            found[load.body] = wrench
        return found

    def _place(
        self, load: Load, motion: Motion, recorded: MarkerData, axes: Axes
    ) -> np.ndarray:
        """Centre of a mass that is carried, (N, 2) [m]."""
        if load.at_m is not None:
            tree = self._subject.model.rigid.tree
            return tree.point_positions(motion.q, load.body, load.at_m)
        longest = self._laboratory.fill_gaps_s
        filled, _ = fill_gaps(recorded, load.markers, longest)
        middle = axes.points(filled.of(load.markers)).mean(axis=1)
        smooth = self._filter.smooth(middle, recorded.rate_hz, recorded.source)
        first = np.searchsorted(recorded.time, motion.time[0] - 1e-9)
        return smooth[first : first + len(motion.time)]

    def _of_file(
        self, load: Load, time, lag_s: float, laboratory: Laboratory
    ) -> PlanarWrench:
        """Wrench (N,) of a load's file of forces."""
        path, plates = self._root / load.forces, Plates(both=load.plate)
        forces = read_foot_forces(
            path, plates, laboratory, self._filter, loaded=False
        ).delayed(lag_s)
        step = 1.0 / forces.rate_hz
        if forces.time[0] > time[0] + step or forces.time[-1] < time[-1] - step:
            raise InputError(
                f"{path}: runs from {forces.time[0]:g} to "
                f"{forces.time[-1]:g} s, the recording from {time[0]:g} to "
                f"{time[-1]:g} s; export the whole file"
            )
        forces = forces.on_belt(self._settings.ground.belt_speed_m_s)
        return forces.filtered(self._filter).at(time)["both"]

    def _device(self, files: TrialFiles, lag_s: float):
        """Encoder angles and recorded moments, on the markers' clock.

        Each None without a file, or without a device.
        """
        joints = self._subject.model.coordinates.device
        device = self._settings.device or Device()

        def read(reader, file: Path | None, legs: str) -> Signal | None:
            if file is None or not joints:
                return None
            found = reader(self._root / file, joints, legs, self._filter)
            return found.delayed(lag_s)

        moments = read(read_moments, files.exo_moments, device.moment_legs)
        return read(read_angles, files.encoders, device.encoder_legs), moments

    def _trial(self, files: TrialFiles) -> Trial:
        """Cut one trial out of its recording.

        Raises:
            InputError: no such rise or event, a part outside the recording or
                too short for the filter, encoders, moments or mats that do not
                cover it, or a load whose markers are hidden in it.
        """
        recording, model = self.used(files), self._subject.model
        motion, reach = recording.motion, self._filter.reach_s
        start, end, how = _bounds(files, recording)
        inside = between(motion.time, start, end)
        for load, gaps in zip(files.loads, motion.load_gaps, strict=True):
            lifted, put_down = load.carried_s
            gaps.check(max(start, lifted) - reach, min(end, put_down) + reach)
        if inside.sum() < 2:
            raise InputError(
                f"trial {files.name}: {start:g} to {end:g} s holds no part of "
                f"the recording ({motion.time[0]:g} to {motion.time[-1]:g} s); "
                "correct start_s and end_s"
            )
        if end - start < reach:
            raise InputError(
                f"trial {files.name}: {start:g} to {end:g} s is shorter than a "
                "period of what the filter leaves "
                f"({self._filter.cutoff_hz:g} Hz); give a longer part by "
                "start_s and end_s"
            )
        trial = self._part(files, recording, inside)
        check_loaded(
            recording.forces.source,
            trial.ground,
            model.rigid.tree.weight,
            f"trial {files.name}, {start:g} to {end:g} s",
        )
        around = None
        if model.coordinates.device:
            around = self._part(files, recording, _around(recording, inside))
            around = replace(around, provenance={})
        provenance = trial.provenance | {"part": how}
        return replace(trial, provenance=provenance, around=around)

    def _part(
        self, files: TrialFiles, recording: Recording, inside: np.ndarray
    ) -> Trial:
        """The frames `inside` (N,) of a recording as a trial."""
        motion, model = recording.motion, self._subject.model
        # Start at the origin: belts run so far in minutes that digits get lost.
        ahead = recording.belt_speed_m_s * float(motion.time[inside][0])

        def here(wrench: PlanarWrench) -> PlanarWrench:
            return wrench.cut(inside).shifted(-ahead)

        feet = {foot: here(w) for foot, w in recording.feet.items()}
        if model.assembly.human.sides:
            wrench, shifts = _both_feet(files, feet), {}
        else:
            places = {side: p[inside] for side, p in motion.ankles.items()}
            (wrench, shifts), feet = merge_plates(feet, places), {}
        time = motion.time[inside]
        (q, v, a), exo = _coordinates(files, recording, inside, model)
        q[:, model.coordinates.root_columns[0]] -= ahead
        cuffs, mats = _cuff_forces(recording, time)
        trial = Trial(
            name=files.name,
            coordinates=model.coordinates,
            times=time - time[0],
            start_s=float(time[0]),
            q=q,
            v=v,
            a=a,
            ground=wrench,
            feet=feet,
            cuffs=cuffs,
            chair=None if recording.chair is None else here(recording.chair),
            chair_on_thighs=self._laboratory.chair_on_thighs,
            applied={b: here(w) for b, w in motion.applied.items()},
            mass_kg=self._subject.mass_kg,
        )
        moments, friction, source = self._moments(recording, trial, time)
        provenance = {
            **self._provenance(files, recording),
            "marker_residual_rms_m": residual_rms(
                {name: x[inside] for name, x in motion.residuals_m.items()}
            ),
            "gaps_filled": {
                name: count / int(inside.sum())
                for name, count in motion.gaps.frames(time[0], time[-1]).items()
            },
            "plate_shift_m": shifts,
            "moments": source,
            "loads": [_said_of(load) for load in files.loads],
            "chair": "plate" if recording.chair is not None else "not measured",
            "mats": mats,
            **exo,
        }
        return replace(
            trial, moments=moments, friction=friction, provenance=provenance
        )

    def _moments(self, recording: Recording, trial: Trial, time):
        """Joint moments (n, n_joints), friction (n, joints), their origin."""
        model, device = self._subject.model, self._settings.device
        if not model.coordinates.device:
            moments = trial.with_moments(model).moments
            return moments, None, {"human": "resultant"}
        friction = None
        if recording.moments is not None:
            exo = recording.moments.at(time, "exoskeleton moments")
            source = "recorded"
            if recording.moments.one_leg:
                source += f", {recording.moments.one_leg} leg doubled"
        elif device is not None:
            exo = drive_moments(device, model.tree, trial.q, trial.v, trial.a)
            friction = friction_moments(device, model.tree, trial.v)
            source = "device model"
            if recording.angles is None:
                source += " at the human's angles"
        else:
            return (
                None,
                None,
                {"human": "unknown: neither exo_moments nor device are given"},
            )
        said = {"human": "resultant - exoskeleton", "exoskeleton": source}
        return trial.with_moments(model, exo).moments, friction, said

    def _provenance(self, files: TrialFiles, recording: Recording) -> dict:
        """Provenance of a recording: files, filter, and processing."""
        return {
            "markers": files.markers.as_posix(),
            "forces": listed(files.forces),
            "filter": {"kind": "Butterworth, zero lag", **vars(self._filter)},
            "force_delay_s": recording.delays_s["forces"],
            "delays_s": dict(recording.delays_s),
            "clocks": dict(recording.clocks),
            "plate_levels": recording.forces.levels,
            "one_leg_doubled": recording.forces.is_one_leg,
            "legs_followed": list(self._subject.markers.sides),
            "markers_left_out": list(recording.motion.without),
            "markers_absent": list(recording.motion.absent),
        }


def _recording(files: TrialFiles) -> TrialFiles:
    """Settings of the recording alone: equal for all trials cut from it."""
    return replace(
        files,
        name="",
        use="calibration",
        rise=None,
        sit=None,
        seated_s=0.0,
        start_s=None,
        end_s=None,
        begin=None,
        end=None,
    )


def _absent(model: MarkerModel, recorded: MarkerData) -> tuple[str, ...]:
    """Markers of an OpenSim model that a file lacks."""
    absent = tuple(n for n in model.names if n not in recorded.names)
    loose = model.without(absent).loose()
    if loose is not None:
        raise InputError(
            f"{recorded.source}: lacks {', '.join(absent)} of the model's "
            f"markers, and too few are left on the {loose.replace('_', ' ')}; "
            "list markers in the study"
        )
    return absent


def _on_belt(markers: MarkerData, axes: Axes, speed: float) -> MarkerData:
    """Markers in axes that move with the treadmill's belt at `speed` [m/s]."""
    ahead = speed * markers.time
    moved = markers.positions + ahead[:, None, None] * axes.R_PL[0]
    return replace(markers, positions=moved)


def _check_hold(
    files: TrialFiles, forces: FootForces, hold_n: float, weight: float
) -> None:
    """Refuse to hold the CoP below a force that no foot ever bears."""
    feet = list(forces.feet.values())
    most = max(wrench.force_z.max() for wrench in feet)
    if hold_n <= most:
        return
    # Plates that bear next to nothing have another cause, told first.
    both, where = sum(feet[1:], feet[0]), "in the whole recording"
    check_loaded(forces.source, both, weight, where)
    raise InputError(
        f"{listed(files.forces)}: laboratory.hold_cop_below_n is "
        f"{hold_n:g}, but no foot bears more than {most:.0f} N, so "
        "that there is no centre of pressure to hold; lower it"
    )


def needed_force(rigid: Model, motion: Motion) -> np.ndarray:
    """Vertical support force (N,) that the motion requires [N]."""
    Q = inverse_dynamics(
        rigid.tree, motion.q, motion.v, motion.a, motion.applied
    )
    return rigid.tree.ground_reaction(motion.q, Q)[:, 1]


def _seating(motion, feet, chair, forces, rigid: Model) -> tuple:
    """What tells rises and sits, see `find_rises`.

    Without a chair's plate its force is what the feet do not bear.
    """
    F_z = forces.total(feet)
    on_chair = (
        needed_force(rigid, motion) - F_z if chair is None else chair.force_z
    )
    # Loads rest on the feet, too; `own` is the body's part.
    own = F_z + sum(w.force_z for w in motion.applied.values())
    weight = rigid.tree.weight
    return motion.time, motion.hip_z, on_chair, own, weight


def _force_delay(
    motion, forces: FootForces, rigid: Model, laboratory, pulled=0.0
) -> float:
    """Lag of the forces [s], by the rises (or else all loaded frames).

    `pulled` (N,): vertical force of loads in files, which have their clock.
    """
    time = motion.time
    feet = forces.at(time)
    chair = feet.pop("chair", None)
    needed, F_z = needed_force(rigid, motion), forces.total(feet)
    reach = laboratory.largest_delay_s
    if chair is not None:  # feet and chair always bear the whole body
        total = F_z + chair.force_z
        return force_delay(
            time, needed + pulled, total + pulled, motion.known, reach
        )
    late = 0.0
    for _ in range(_CLOCK_PASSES):  # seat-off is found on the plates' clock
        used = _borne_by_feet(motion, forces.delayed(late), rigid)
        before = late
        late = force_delay(time, needed + pulled, F_z + pulled, used, reach)
        if abs(late - before) < _SETTLED_S:
            break
    return late


def _borne_by_feet(motion, forces: FootForces, rigid: Model) -> np.ndarray:
    """Frames (N,) bool with no chair: rises, or else those under load."""
    time, feet = motion.time, forces.at(motion.time)
    F_z = forces.total(feet)
    rises = find_rises(*_seating(motion, feet, None, forces, rigid))
    used = np.zeros(len(time), bool)
    for rise in rises:
        used |= (time >= rise.seat_off_s) & (time <= rise.standing_s)
    if not rises:
        used = F_z > 0.5 * rigid.tree.weight
    if not (used & motion.known).any():
        raise InputError(
            f"{forces.source}: the plates bear {F_z.max():.3g} N at most, but "
            f"the body weighs {rigid.tree.weight:.0f} N; check plates and the "
            "unit of force (N, not kN), or do not estimate_force_delay"
        )
    return used & motion.known


def _said(late: float, laboratory) -> str:
    """Words on an estimated lag; warns if it is at the search's edge."""
    text = f"estimated {1e3 * late:+.0f} ms"
    if abs(late) > laboratory.largest_delay_s - 1.5e-3:
        text += "; at the edge of the search, raise laboratory.largest_delay_s"
    return text


def _lag(of_trial: float | None, of_laboratory: float) -> float:
    """Lag [s] that the study gives; systems may be started trial by trial."""
    return of_laboratory if of_trial is None else of_trial


def _around(recording: Recording, inside: np.ndarray) -> np.ndarray:
    """Frames (N,) of a part and shortly before and after it, all recorded."""
    motion = recording.motion
    time, seen = motion.time, motion.known
    first, last = np.flatnonzero(inside)[[0, -1]]
    ends = [(time[first] - _AROUND_S, time[last] + _AROUND_S)]
    for signal in (recording.angles, recording.moments, *recording.mats):
        if signal is not None:
            ends.append((signal.time[0], signal.time[-1]))
    for start, end in ends:
        seen = seen & between(time, start, end)
    missing = np.flatnonzero(~seen)
    before, after = missing[missing < first], missing[missing > last]
    frames = np.arange(len(time))
    return (frames > before.max(initial=-1)) & (
        frames < after.min(initial=len(time))
    )


def _said_of(load: Load) -> str:
    """A load in words, for the report."""
    if load.forces is not None:
        return f"force of {load.forces.as_posix()} on the {load.body}"
    since = "" if load.from_s is None else f" from {load.from_s:g} s"
    until = "" if load.to_s is None else f" to {load.to_s:g} s"
    return f"{load.mass_kg:g} kg on the {load.body}{since}{until}"


def _both_feet(files: TrialFiles, feet: dict[str, PlanarWrench]):
    """Sum of both feet's wrenches."""
    for side in SIDES:
        if side not in feet:
            raise InputError(
                f"trial {files.name}: the model has two legs; name the plates "
                f"of each foot, plates.{side} is missing"
            )
        if not feet[side].is_loaded.any():
            raise InputError(
                f"trial {files.name}: the {side} foot's plates are never "
                f"loaded; correct plates.{side}, start_s and end_s"
            )
    return feet["left"] + feet["right"]


def _bounds(files: TrialFiles, recording: Recording):
    """Start and end of a trial [s], and their origin for the provenance."""
    time = recording.motion.time
    start, end = float(time[0]), float(time[-1])
    how: dict[str, Any] = {"from": "whole recording"}
    for what, number, found in (
        ("rise", files.rise, recording.rises),
        ("sit", files.sit, recording.sits),
    ):
        if number is None:
            continue
        if number > len(found):
            parts = ", ".join(
                "{:.2f} to {:.2f} s".format(*m.part) for m in found
            )
            raise InputError(
                f"trial {files.name}: {what} {number} was asked for, but "
                f"{len(found)} were found in {files.markers}"
                f"{f' ({parts})' if parts else ''}; give start_s and end_s "
                "instead"
            )
        movement = found[number - 1]
        start, end = movement.part
        how = {"from": what, what: number, **vars(movement)}
        if files.seated_s > 0.0:
            how["seated_s"] = files.seated_s
            if what == "rise":
                start -= files.seated_s
            else:
                end += files.seated_s
    if files.start_s is not None:
        start, how["start_s"] = files.start_s, files.start_s
    if files.end_s is not None:
        end, how["end_s"] = files.end_s, files.end_s
    if files.begin is not None:
        start, how["start"] = _event(files, recording, "from", files.begin)
    if files.end is not None:
        end, how["end"] = _event(files, recording, "to", files.end)
    if end <= start:
        raise InputError(
            f"trial {files.name}: its part ends at {end:g} s, not after it "
            f"starts ({start:g} s); correct from and to, or start_s and end_s"
        )
    outside = max(time[0] - start, end - time[-1])
    if outside > time[1] - time[0]:
        raise InputError(
            f"trial {files.name}: {start:g} to {end:g} s reaches beyond the "
            f"recording ({time[0]:g} to {time[-1]:g} s) that both "
            f"{files.markers} and {listed(files.forces)} hold; correct "
            "start_s and end_s, or export the whole file"
        )
    return start, end, how


def _event(files: TrialFiles, recording: Recording, key: str, name: str):
    """Time of an event [s], and its entry in the provenance."""
    try:
        time = event_s(name, recording.contacts)
    except InputError as error:
        raise InputError(
            f"trial {files.name}, {listed(files.forces)}: {key}: {error}"
        ) from None
    return time, {"event": name, "time_s": time}


def _coordinates(files, recording: Recording, inside, model: Model):
    """Coordinates q, v, a (n, nq), and the origin of the device's angles."""
    motion = recording.motion
    body = [x[inside] for x in (motion.q, motion.v, motion.a)]
    if not model.coordinates.device:
        return body, {}
    if recording.angles is None:
        aligned = [model.coordinates.aligned(x) for x in body]
        return aligned, {"exoskeleton_angles": "as the human's (no encoders)"}
    exo = recording.angles.motion(motion.time[inside])
    names = model.coordinates
    return [names.joined(*pair) for pair in zip(body, exo, strict=True)], {
        "encoders": files.encoders.as_posix(),
        "encoder_legs": recording.angles.one_leg or "both",
    }


def _cuff_forces(recording: Recording, time):
    """Cuff -> normal force at `time`, and the reports of its mats."""
    total: dict[str, np.ndarray] = {}
    notes: dict[str, Any] = {}
    for mat in recording.mats:
        force = mat.at(time, f"pressures of {mat.name}")[:, 0]
        total[mat.segment] = total.get(mat.segment, 0.0) + force
        notes[mat.name] = mat.report
    return {name: CuffForce(force) for name, force in total.items()}, notes
