"""Cut a foot's step out of a recording: force, CoP, free moment and pose.

The step's frame lies on the ground: x from heel to toe while the foot is flat,
y left, z up, origin below the mid-point of the rearmost and the foremost
marker of the foot. On a treadmill the frame moves with the belt. Forces are
not filtered but averaged over one frame of the markers, because a low-pass
chosen for dynamics would smear the heel strike.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import (
    COP_THRESHOLD_N,
    MarkerData,
    PlateRecording,
    between,
)
from drake_exo.measurement.events import Contact, contacts
from drake_exo.measurement.filters import fill_gaps
from drake_exo.measurement.recording import (
    LARGEST_FOOT_N,
    check_empty,
    level,
    plates_under,
    read_markers,
)
from drake_exo.measurement.sagittal import Axes, centre_of_pressure
from drake_exo.measurement.settings import (
    RecordingSettings,
    Side,
    TrialFiles,
    listed,
    several,
)

_FLAT_SHARE = 0.2  # of a contact's frames counts as flat: slowest rotation
_BELT_M_S = 0.2  # a flat foot that moves faster stands on a belt
_SHORTEST_FOOT_M = 0.1  # least distance of rearmost and foremost marker

Begin = Literal["heel_strike"] | float
End = Literal["toe_off"] | float


@dataclass(frozen=True)
class RecordedStep:
    """One contact of a foot with N samples, in the step's frame.

    Attributes:
        name: file, foot and part, for messages.
        times: on the markers' clock [s], (N,).
        force: of the ground on the foot: x, y, z of the frame [N], (N, 3).
        cop: centre of pressure on the plate's surface: x, y [m], (N, 2).
        free_moment: about the vertical through the CoP [N m], (N,).
        rotation: of the foot from its flat pose, of the rigid body nearest
            to its markers, (N, 3, 3).
        place: position of the frame's origin in the laboratory, forward and
            left [m], (2,), at the middle of the flat part.
        yaw: angle of the frame's x axis from forward [rad].
        belt: velocity of the ground, forward and left [m/s], (2,).
    """

    name: str
    times: np.ndarray
    force: np.ndarray
    cop: np.ndarray
    free_moment: np.ndarray
    rotation: np.ndarray
    place: np.ndarray
    yaw: float
    belt: np.ndarray


def recorded_step(
    settings: RecordingSettings,
    root: Path,
    trial: str,
    foot: Side,
    start: Begin = "heel_strike",
    end: End = "toe_off",
    number: int = 0,
    least_force_n: float = COP_THRESHOLD_N,
) -> RecordedStep:
    """Cut one step of a foot out of a trial of a study.

    Heel strike and toe-off are where the force on the foot's own plate passes
    `least_force_n`.

    Args:
        settings: of the study.
        root: folder that the study's paths start from.
        trial: name of the trial.
        foot: "left" or "right".
        start, end: events, or times [s] on the markers' clock.
        number: of the step, from 0, among contacts that have start and end; a
            part between times that holds two contacts is no step.
        least_force_n: least vertical force of a contact [N].

    Raises:
        InputError: no such trial or contact, a contact on two plates, files
            that cannot be read, markers that are hidden.
    """
    files = _trial(settings, trial)
    lab = settings.laboratory.facing(files.marker_axes)
    time, plates = plates_under(
        several(files.forces, root), files.plates.of(foot)
    )
    where = f"{listed(files.forces)}, trial {trial}, {foot} foot"
    if not plates:
        raise InputError(
            f"trial {trial}: no plate is the {foot} foot's alone; name it in "
            f"plates.{foot}"
        )
    each = [lab.on_body(plate) for plate in plates]
    if files.empty_plates is not None:
        _, empty = plates_under(
            several(files.empty_plates, root), files.plates.of(foot)
        )
        bare = [lab.on_body(plate) for plate in empty]
        check_empty(listed(files.empty_plates), bare)
        each = [w - b.mean(axis=0) for w, b in zip(each, bare, strict=True)]
    if lab.remove_plate_drift:
        each = [level(time, w, 2, LARGEST_FOOT_N)[0] for w in each]
    time = time - lab.force_delay_s
    found = contacts(time, sum(each)[:, 2], least_force_n)
    contact = _chosen(found, start, end, number, where, least_force_n)
    first, last = _part(contact, start, end)
    used = _one_plate(time, each, (first, last), files.plates.of(foot), where)
    height = _surface(plates[used], each[used], lab.force_axes)
    markers = _foot_markers(settings, root, files, foot, contact)
    inside = between(markers.time, first, last)
    wrench = _at_frames(time, each[used], markers)
    inside &= wrench[:, 2] >= least_force_n
    if inside.sum() < 2:
        raise InputError(
            f"{where}: {first:g} to {last:g} s holds only {inside.sum()} "
            f"frames with {least_force_n:g} N or more; give a longer part"
        )
    return _step(
        f"{where}, {first:.2f} to {last:.2f} s",
        markers,
        contact,
        inside,
        wrench,
        height,
    )


def _trial(settings: RecordingSettings, name: str) -> TrialFiles:
    names = [files.name for files in settings.trials]
    if name not in names:
        raise InputError(
            f"trial {name!r} is none of the study's ({', '.join(names)})"
        )
    return settings.trials[names.index(name)]


def _part(contact: Contact, start: Begin, end: End) -> tuple[float, float]:
    """Start and end [s] of the step in a contact: its events, or times."""
    first = contact.start_s if isinstance(start, str) else start
    return first, contact.end_s if isinstance(end, str) else end


def _chosen(every, start, end, number, where, least_n) -> Contact:
    def is_whole(c):
        begins = c.begins or not isinstance(start, str)
        return begins and (c.ends or not isinstance(end, str))

    def met(c):  # contacts in the part; with two, the foot lifted between
        first, last = _part(c, start, end)
        return [k for k in every if k.start_s < last and k.end_s > first]

    fitting = [c for c in every if is_whole(c) and met(c) == [c]]
    if number < len(fitting):
        return fitting[number]
    found = "; ".join(map(str, every)) or "none"
    raise InputError(
        f"{where}: there is no step {number} (counted from 0) from {start} to "
        f"{end}; contacts found: {found}, of {least_n:g} N or more "
        "(least_force_n); name another trial or foot, or give from and to as "
        "times within one of them [s]"
    )


def _one_plate(time, each, part, numbers, where) -> int:
    """Index of the plate that a step lies on; refuses a step on two."""
    inside = between(time, *part)
    loaded = [inside & (w[:, 2] >= COP_THRESHOLD_N) for w in each]
    used = [i for i, here in enumerate(loaded) if here.any()]
    if len(used) > 1:
        a, b = used[:2]
        when = float(max(time[loaded[a]][0], time[loaded[b]][0]))
        raise InputError(
            f"{where}: the step lies on plates {numbers[a]} and {numbers[b]} "
            f"(from {when:.2f} s on); there the force of this foot cannot be "
            "told apart from that of the other: take another step"
        )
    return used[0] if used else 0


def _surface(plate: PlateRecording, wrench, axes: Axes) -> float:
    """Height of the plate's surface: median height of its CoP [m]."""
    loaded = wrench[:, 2] >= COP_THRESHOLD_N
    return float(np.median(axes.space(plate.point)[loaded, 2]))


def _foot_markers(
    settings: RecordingSettings,
    root: Path,
    files: TrialFiles,
    foot: Side,
    contact: Contact,
) -> MarkerData:
    """Filtered markers of foot and toes: forward, left, up (N, k, 3) [m]."""
    names = _names(settings, foot)
    lab = settings.laboratory.facing(files.marker_axes)
    data, gaps = fill_gaps(
        read_markers(files.markers, settings, root),
        names,
        lab.fill_gaps_s,
    )
    reach = settings.filter.reach_s
    gaps.check(contact.start_s - reach, contact.end_s + reach)
    points = lab.marker_axes.space(data.of(names))
    smooth = settings.filter.smooth(points, data.rate_hz, data.source)
    return MarkerData(data.time, names, smooth, data.rate_hz, data.source)


def _names(settings: RecordingSettings, foot: Side) -> tuple[str, ...]:
    if settings.markers is None:
        raise InputError(
            "a recorded step needs the markers of the foot; give them as "
            "markers.segments in the study, besides the OpenSim model"
        )
    segments = settings.markers.segments
    on = (*segments.foot.of(foot), *segments.toes.of(foot))
    names = tuple(dict.fromkeys(on))
    if len(names) < 3:
        raise InputError(
            f"markers.segments.foot.{foot}: the foot's pose needs three "
            "markers on foot and toes; name them"
        )
    return names


def _ends(points: np.ndarray, names: tuple[str, ...]) -> tuple[int, int]:
    """Indices of a flat foot's rearmost and foremost marker: farthest apart.

    Args:
        points: (k, 3) forward, left, up [m].
        names: of the markers.
    """
    flat = points[:, :2]
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    a, b = np.unravel_index(np.argmax(apart), apart.shape)
    if apart[a, b] < _SHORTEST_FOOT_M:
        raise InputError(
            f"the foot's markers ({', '.join(names)}) lie within "
            f"{1e3 * apart[a, b]:.0f} mm, so that its direction cannot be "
            "told; name one at the heel and one at the toes in "
            "markers.segments"
        )
    heel, toe = (a, b) if flat[a, 0] < flat[b, 0] else (b, a)
    return int(heel), int(toe)


def _at_frames(time, wrench: np.ndarray, markers: MarkerData) -> np.ndarray:
    """Wrench (N, 6) at the markers' frames, averaged over one frame each."""
    each = max(round((1 / markers.rate_hz) / (time[1] - time[0])), 1)
    if each > 1:
        ones = np.ones(each)
        if each % 2 == 0:  # half weight at both ends keeps it symmetric
            ones = np.r_[0.5, ones[1:], 0.5]
        ones /= each
        wrench = np.stack(
            [np.convolve(x, ones, mode="same") for x in wrench.T], axis=1
        )
    columns = [
        np.interp(markers.time, time, x, left=0.0, right=0.0) for x in wrench.T
    ]
    return np.stack(columns, axis=1)


def _step(name, markers, contact, inside, wrench, height) -> RecordedStep:
    """The step in its own frame, in the markers' frames `inside` (bool)."""
    points, time = markers.positions, markers.time
    stands = (time >= contact.start_s) & (time <= contact.end_s)
    flat = _flat(points, time, stands)
    heel, toe = _ends(points[flat].mean(axis=0), markers.names)
    middle = 0.5 * (points[:, heel] + points[:, toe])[:, :2]
    belt = np.gradient(middle, time, axis=0)[flat].mean(axis=0)
    belt = belt if np.hypot(*belt) > _BELT_M_S else np.zeros(2)
    when = float(time[flat].mean())
    points = points.copy()
    moved = (time - when)[:, None] * belt
    points[:, :, :2] -= moved[:, None]
    shape = points[flat].mean(axis=0)
    along = shape[toe] - shape[heel]
    yaw = float(np.arctan2(along[1], along[0]))
    place = 0.5 * (shape[heel] + shape[toe])[:2]
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    cop, moment = _cop(wrench[inside], height)
    return RecordedStep(
        name,
        time[inside],
        wrench[inside, :3] @ turn.T,
        (cop - moved[inside] - place) @ turn[:2, :2].T,
        moment,
        nearest_rotations(shape @ turn.T, points[inside] @ turn.T),
        place,
        yaw,
        belt,
    )


def _flat(points: np.ndarray, time, stands) -> np.ndarray:
    """Frames of a contact in which the foot turns least."""
    own = points - points.mean(axis=1, keepdims=True)
    rate = np.linalg.norm(np.gradient(own, time, axis=0), axis=2).max(axis=1)
    frames = np.flatnonzero(stands)
    count = max(round(_FLAT_SHARE * len(frames)), 1)
    return frames[np.argsort(rate[frames], kind="stable")[:count]]


def _cop(wrench: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Centre of pressure (N, 2) [m] at a height, free moment (N,) [N m].

    From M = r × F + T e_z about the laboratory's origin.
    """
    F, M = wrench[:, :3], wrench[:, 3:]
    x = centre_of_pressure(F[:, 0], F[:, 2], M[:, 1], height)
    y = centre_of_pressure(F[:, 1], F[:, 2], -M[:, 0], height)
    return np.stack([x, y], 1), M[:, 2] - (x * F[:, 1] - y * F[:, 0])


def nearest_rotations(shape: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) of a shape (k, 3) that best fit points (N, k, 3).

    Least squares over rigid motions (Kabsch, Acta Cryst. A 32, 1976).
    """
    a = shape - shape.mean(axis=0)
    b = points - points.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(np.einsum("nki,kj->nij", b, a))
    flip = np.ones((len(points), 3))
    flip[:, 2] = np.linalg.det(U @ Vt)
    return (U * flip[:, None]) @ Vt
