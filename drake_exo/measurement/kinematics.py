"""Planar inverse kinematics and inverse dynamics.

The marker model has seven segments in the sagittal plane: pelvis (with trunk,
head and arms), and thigh, shank and foot of each leg; nine if toes are hinged.
With complex positions p = x + i z and w_k = exp(i phi_k), phi_k the absolute
angle of segment k (counter-clockwise seen from the right), every marker lies
at p_0 + C w, where p_0 is the mid-point of the hips and C is constant. phi = 0
for vertical thighs and shanks, and for pelvis and feet as in standing.

Angles of all frames follow by weighted least squares (Gauss-Newton). The legs
are fitted separately. A model with one leg gets the mean of both, since feet
that stand apart fore and aft give the legs different angles.

Inverse dynamics takes the motion and the measured wrenches, among them those
of loads: what a person carries, or what pulls and pushes. A carried mass acts
on the body with the force -m (a + g), a the acceleration of its centre, which
is the mean of markers or a point of a segment. While the mass is lifted off or
put down, the share that the body bears rises from 0 to 1, or falls to 0.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import Progress
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.filters import derivatives, minimum_jerk
from drake_exo.measurement.sagittal import Axes, PlanarWrench
from drake_exo.measurement.settings import Load, Markers, SidedMarkers
from drake_exo.model.assembly import SIDES
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.model.segments import LEG_JOINTS

LEG = ("thigh", "shank", "foot", "toes")
# Weight of markers on a foot that a device is welded to: they stay within a
# millimetre, those on skin slide by 10 mm and more (Peters et al., Gait &
# Posture 31, 2010). With equal weights, skin that slides on the shank would
# turn the foot by two degrees.
_RIGID = 100.0
# Legs stand further apart than this from side to side, but not fore and aft.
_APART_M = 0.05
# The joint at the origin of each segment of a leg.
_ORIGIN = {"thigh": "knee", "shank": "ankle", "foot": "ankle", "toes": "ball"}


@dataclass(frozen=True)
class MarkerModel:
    """Segments, joint centres and marker positions of one subject.

    Attributes:
        segments: names, "pelvis" first, then "thigh_left", ...; length S.
        sides: the legs that carry markers.
        names: marker names, length M; one on two segments is listed twice.
        segment_of: (M,) segment index of each marker.
        levers: (M, S) complex C [m]: a marker lies at p_0 + C w.
        weights: (M,) of the markers in the least squares.
        ankles: side -> (S,) complex C of the ankle's centre [m].
        standing_angles: (S,) absolute segment angles in standing [rad].
        lengths_m: of "shank" and "thigh" between joint centres in the sagittal
            plane in standing, mean of the sides.
        ankle_height_m: of the ankle's centre in standing, mean of the sides.
    """

    segments: tuple[str, ...]
    sides: tuple[str, ...]
    names: tuple[str, ...]
    segment_of: np.ndarray
    levers: np.ndarray
    weights: np.ndarray
    ankles: dict[str, np.ndarray]
    standing_angles: np.ndarray
    lengths_m: dict[str, float]
    ankle_height_m: float

    def index(self, segment: str, side: str) -> int:
        """Index of a segment of one leg."""
        return self.segments.index(f"{segment}_{side}")

    def on(self, segment: str, side: str) -> list[str]:
        """Names of the markers on a segment of one leg."""
        return self.by_segment()[self.index(segment, side)]

    def by_segment(self) -> list[list[str]]:
        """Names of the markers on each segment."""
        return [
            [self.names[i] for i in np.flatnonzero(self.segment_of == k)]
            for k in range(len(self.segments))
        ]

    def foot_heights_m(self, side: str) -> np.ndarray:
        """Heights (k,) of the k markers on a foot in standing [m]."""
        foot = self.index("foot", side)
        own = self.segment_of == foot
        arm = self.levers[own, foot] - self.ankles[side][foot]
        return self.ankle_height_m + np.imag(
            np.exp(1j * self.standing_angles[foot]) * arm
        )

    def without(self, names: Iterable[str]) -> "MarkerModel":
        """The same model without some markers."""
        gone = set(names)
        keep = [i for i, n in enumerate(self.names) if n not in gone]
        return replace(
            self,
            names=tuple(self.names[i] for i in keep),
            segment_of=self.segment_of[keep],
            levers=self.levers[keep],
            weights=self.weights[keep],
        )

    def loose(self) -> str | None:
        """A segment whose angle the markers do not determine, or None."""
        w = np.exp(1j * self.standing_angles)
        J = (
            np.column_stack(
                [np.ones(len(self.names)), 1j * np.ones(len(self.names))]
                + [1j * w[k] * self.levers[:, k] for k in range(len(w))]
            )
            * np.sqrt(self.weights)[:, None]
        )
        _, values, rows = np.linalg.svd(np.concatenate([J.real, J.imag]))
        if len(values) >= len(w) + 2 and values[-1] >= 1e-3 * values[0]:
            return None
        return self.segments[int(np.argmax(np.abs(rows[-1][2:])))]

    def determined(self, hidden: np.ndarray) -> np.ndarray:
        """Frames (N,) whose visible markers determine every segment's angle.

        Args:
            hidden: (N, M) bool, markers in the order of `names`.
        """
        patterns, which = np.unique(hidden, axis=0, return_inverse=True)
        names = np.array(self.names)
        holds = [self.without(names[p]).loose() is None for p in patterns]
        return np.array(holds)[which.ravel()]


def build_marker_model(
    standing: MarkerData,
    markers: Markers,
    axes: Axes,
    ball_m: tuple[float, float] | None = None,
    welded: Collection[str] = (),
) -> MarkerModel:
    """Measure segment lengths and marker positions in a standing trial.

    Args:
        standing: quiet part of the trial; its mean posture is used.
        markers: which markers are on which segment.
        axes: which axes of the trial's file point forward and up.
        ball_m: position (x, z) of the toes' hinge relative to the ankle, foot
            flat; None where toes are rigid.
        welded: feet that a device is welded to; their markers do not slide.

    Raises:
        InputError: a marker is missing or has gaps, no leg is complete, left
            and right are not the same throughout, or the set cannot determine
            a segment's angle.
    """
    leg = LEG if ball_m else LEG[:-1]
    sides = _complete_sides(markers, standing.source, leg)
    if len(sides) == 2:
        _check_sides(markers, standing, axes)
    centres = {
        side: {
            joint: _mean_point(
                standing, getattr(markers.joint_centres, joint).of(side), axes
            )
            for joint in LEG_JOINTS
        }
        for side in sides
    }
    segments = ("pelvis", *(f"{s}_{side}" for side in sides for s in leg))
    hip = np.mean([centres[side]["hip"] for side in sides])
    w, joints = _skeleton(segments, centres, hip, standing.source)
    for side in sides if ball_m else ():
        centres[side]["ball"] = centres[side]["ankle"] + complex(*ball_m)
        lever = joints[side]["ankle"].copy()
        lever[segments.index(f"foot_{side}")] += complex(*ball_m)
        joints[side]["ball"] = lever
    # For each segment: markers, origin in standing, and the origin's C.
    on = markers.segments.pelvis
    own = (*on.left, *on.right, *on.middle)
    parts = [(own, hip, np.zeros(len(segments), complex))]
    for side in sides:
        for segment in leg:
            own, joint = getattr(markers.segments, segment), _ORIGIN[segment]
            place, lever = centres[side][joint], joints[side][joint]
            parts.append((own.of(side), place, lever))
    names, segment_of, levers, weights = [], [], [], []
    for k, (own, origin, base) in enumerate(parts):
        named = {segments[k], segments[k].partition("_")[0]}
        usual = _RIGID if named & set(welded) else 1.0
        for name in own:
            lever = base.copy()
            lever[k] += (_mean_point(standing, (name,), axes) - origin) / w[k]
            names.append(name)
            segment_of.append(k)
            levers.append(lever)
            weights.append(markers.weights.get(name, usual))
    model = MarkerModel(
        segments=segments,
        sides=sides,
        names=tuple(names),
        segment_of=np.array(segment_of),
        levers=np.array(levers),
        weights=np.array(weights),
        ankles={side: joints[side]["ankle"] for side in sides},
        standing_angles=np.angle(w),
        lengths_m={
            segment: float(
                np.mean([abs(c[above] - c[below]) for c in centres.values()])
            )
            for segment, below, above in (
                ("shank", "ankle", "knee"),
                ("thigh", "knee", "hip"),
            )
        },
        ankle_height_m=float(
            np.mean([c["ankle"].imag for c in centres.values()])
        ),
    )
    for name in markers.weights:
        if name not in names:
            raise InputError(
                f"markers.weights names {name!r}, which is on no segment; "
                "remove it or add it to markers.segments"
            )
    if (loose := model.loose()) is not None:
        raise InputError(
            f"{standing.source}: the marker set cannot determine the angle of "
            f"the {loose.replace('_', ' ')}; add markers to it in "
            "markers.segments"
        )
    return model


def _complete_sides(markers: Markers, source: str, leg) -> tuple[str, ...]:
    """Sides whose leg has all joint centres and markers on every segment."""
    sides = tuple(
        side
        for side in SIDES
        if all(getattr(markers.joint_centres, j).of(side) for j in LEG_JOINTS)
        and all(getattr(markers.segments, s).of(side) for s in leg)
    )
    if not sides:
        raise InputError(
            f"{source}: the study's markers name no leg with ankle, knee and "
            f"hip centres and markers on {', '.join(leg)}; complete "
            "markers.joint_centres and markers.segments for one side"
        )
    return sides


def _check_sides(markers: Markers, standing: MarkerData, axes: Axes) -> None:
    """Refuse joint centres and segments whose sides are not those of feet."""

    def apart(own: SidedMarkers) -> float:
        left, right = (
            axes.space(standing.of(own.of(side)))[..., 1].mean()
            for side in SIDES
        )
        return left - right

    feet = apart(markers.segments.foot)
    groups = {"joint_centres": LEG_JOINTS, "segments": ("shank", "thigh")}
    for group, parts in groups.items():
        for part in parts:
            own = getattr(getattr(markers, group), part)
            if apart(own) * feet < -(_APART_M**2):
                raise InputError(
                    f"{standing.source}: left and right of markers.{group}."
                    f"{part} are not those of markers.segments.foot; exchange "
                    "them in one of the two"
                )


def _mean_point(data: MarkerData, names, axes: Axes) -> complex:
    x, z = axes.points(data.of(names)).mean(axis=(0, 1))
    return complex(x, z)


def _skeleton(segments, centres, hip, source):
    """Standing w (S,) of the segments, and side -> joint -> C (S,) [m]."""
    w = np.ones(len(segments), complex)
    joints = {}
    for side, c in centres.items():
        thigh, shank = (
            segments.index(f"{s}_{side}") for s in ("thigh", "shank")
        )
        lengths = c["hip"] - c["knee"], c["knee"] - c["ankle"]
        for k, d in zip((thigh, shank), lengths, strict=True):
            if not 0.05 < abs(d) < 1.5:
                raise InputError(
                    f"{source}: the {segments[k].replace('_', ' ')} measures "
                    f"{abs(d):.3f} m in standing; check the markers of its "
                    "joint centres, which way marker_axes say is up, and the "
                    "unit of length (mm, cm, m) in the file's header"
                )
            w[k] = d / abs(d) / 1j  # along the segment is +z
        levers = {"hip": np.zeros(len(segments), complex)}
        levers["hip"][0] = c["hip"] - hip
        levers["knee"] = levers["hip"].copy()
        levers["knee"][thigh] = -1j * abs(lengths[0])
        levers["ankle"] = levers["knee"].copy()
        levers["ankle"][shank] = -1j * abs(lengths[1])
        joints[side] = levers
    return w, joints


_MAX_ITERATIONS = 200  # markers that fit badly converge slowly
_CONVERGED = 1e-10  # largest step [m or rad]
# Weight of a hidden marker: next to nothing, but keeps the equations regular.
_UNSEEN = 1e-8
# Largest ratio, either way, of the markers' spread to that in standing.
_SPREAD = 5.0


@dataclass(frozen=True)
class Poses:
    """Pose of the marker model in every frame.

    Attributes:
        hip: (N,) complex x + i z of the mid-point of the hips [m].
        angles: (N, S) absolute segment angles [rad].
        residuals: (N, M) complex, measured minus model [m]; NaN where hidden.
    """

    hip: np.ndarray
    angles: np.ndarray
    residuals: np.ndarray


def solve_poses(
    model: MarkerModel,
    points: np.ndarray,
    source: str = "markers",
    progress: Progress | None = None,
    hidden: np.ndarray | None = None,
) -> Poses:
    """Fit the marker model to measured points by Gauss-Newton.

    Args:
        model: M markers on S segments.
        points: (N, M, 2) x and z of the markers in the order of `model.names`
            [m], without gaps.
        source: file name, for messages.
        progress: prints a line now and then.
        hidden: (N, M) bool, where points are only bridged gaps and get almost
            no weight; nowhere by default.

    Raises:
        InputError: no convergence, or markers in another unit of length.
    """
    p = points[..., 0] + 1j * points[..., 1]
    if hidden is None:
        hidden = np.zeros(p.shape, bool)
    counts = model.determined(hidden)
    _check_spread(model, p[counts], source)
    phi = _first_guess(model, p)
    hip = np.mean(p - np.exp(1j * phi) @ model.levers.T, axis=1)
    W = np.sqrt(np.where(hidden, _UNSEEN, model.weights))
    for iteration in range(_MAX_ITERATIONS):
        w = np.exp(1j * phi)
        r = p - hip[:, None] - w @ model.levers.T
        J = np.empty((*p.shape, phi.shape[1] + 2), complex)
        J[..., 0], J[..., 1] = 1.0, 1j
        J[..., 2:] = 1j * w[:, None, :] * model.levers
        J *= W[..., None]
        A = np.concatenate([J.real, J.imag], axis=1)
        b = np.concatenate([(r * W).real, (r * W).imag], axis=1)
        normal = np.einsum("nmi,nmj->nij", A, A, optimize=True)
        step = np.linalg.solve(
            normal, np.einsum("nmi,nm->ni", A, b)[..., None]
        )[..., 0]
        # At most half a radian, so that any first guess converges.
        step[:, 2:] = np.clip(step[:, 2:], -0.5, 0.5)
        hip = hip + step[:, 0] + 1j * step[:, 1]
        phi = phi + step[:, 2:]
        largest = np.abs(step[counts]).max(initial=0.0)
        if progress:
            progress.update(f"iteration {iteration + 1}, step {largest:.1e}")
        if largest < _CONVERGED:
            break
    else:
        off = np.where(hidden, 0.0, np.abs(r))
        worst = int(np.argmax(off.max(axis=0)))
        raise InputError(
            f"{source}: inverse kinematics does not converge; marker "
            f"{model.names[worst]!r} lies up to {off[:, worst].max():.3g} m "
            "off the model; check where it is, that the markers are named as "
            "in the standing trial, and that laboratory.marker_axes, there "
            "standing.marker_axes, say where the subject faced"
        )
    phi = np.unwrap(phi, axis=0)
    r = p - hip[:, None] - np.exp(1j * phi) @ model.levers.T
    return Poses(hip, phi, np.where(hidden, np.nan, r))


def _check_spread(model: MarkerModel, p: np.ndarray, source: str) -> None:
    """Refuse markers (N, M) in another unit of length than in standing.

    Compares each marker's median distance from the median of all markers.
    """
    if not len(p):
        return
    standing = model.levers @ np.exp(1j * model.standing_angles)
    usual = np.abs(standing - _middle(standing))
    found = np.median(np.abs(p - _middle(p)[:, None]), axis=0)
    ratio = float(np.median(found) / np.median(usual))
    if not 1.0 / _SPREAD < ratio < _SPREAD:
        raise InputError(
            f"{source}: markers are {np.median(found):.3g} m apart, "
            f"{np.median(usual):.3g} m in standing; one of the two files is "
            "in another unit of length (mm, cm, m) than its header says"
        )
    far = found - usual > 10.0  # m; nobody is that large
    if far.any():
        names = ", ".join(np.array(model.names)[far])
        raise InputError(
            f"{source}: {names} lie {found[far].max():.3g} m from the other "
            "markers; they are in another unit of length (mm, cm, m), or "
            "not of this subject"
        )


def _middle(p: np.ndarray) -> np.ndarray:
    """Median of complex points along the last axis."""
    return np.median(p.real, axis=-1) + 1j * np.median(p.imag, axis=-1)


def _first_guess(model: MarkerModel, p: np.ndarray) -> np.ndarray:
    """Segment angles (N, S) [rad] by the turn of its own markers."""
    phi = np.tile(model.standing_angles, (len(p), 1))
    standing = model.levers @ np.exp(1j * model.standing_angles)
    for k in range(phi.shape[1]):
        of = model.segment_of == k
        if not of.any():  # all left out; neighbouring segments determine it
            continue
        s = standing[of] - standing[of].mean()
        if np.abs(s).max() > 0.01:
            c = p[:, of] - p[:, of].mean(axis=1, keepdims=True)
            phi[:, k] += np.angle(c @ np.conj(s))
    return phi


def ankle_paths(model: MarkerModel, poses: Poses) -> dict[str, np.ndarray]:
    """Side -> x and z of the ankle's centre (N, 2) [m]."""
    w = np.exp(1j * poses.angles)
    ankles = {s: poses.hip + w @ lever for s, lever in model.ankles.items()}
    return {s: np.column_stack([a.real, a.imag]) for s, a in ankles.items()}


def coordinates(model: Model, markers: MarkerModel, poses: Poses) -> np.ndarray:
    """Generalized coordinates (N, nq) of the subject without a device.

    Args:
        model: subject, with one leg or two.
        markers: the marker model.
        poses: pose of the marker model in every frame.
    """
    if model.assembly.human.sides:
        return _two_legs(model.rigid.tree, markers, poses)
    return merge_legs(markers, poses)


def merge_legs(model: MarkerModel, poses: Poses) -> np.ndarray:
    """Coordinates of a body with one leg: the mean of both.

    Returns:
        q (N, 6): foot_x, foot_z (the ankle's centre) [m], foot_pitch, ankle,
        knee, hip [rad], and toes where they are hinged.
    """
    angles = {
        s: np.mean(
            [poses.angles[:, model.index(s, side)] for side in model.sides],
            axis=0,
        )
        for s in LEG
        if f"{s}_{model.sides[0]}" in model.segments
    }
    pelvis = poses.angles[:, 0]
    foot, shank, thigh = (angles[s] for s in ("foot", "shank", "thigh"))
    ankle = np.mean(list(ankle_paths(model, poses).values()), axis=0)
    columns = [foot, foot - shank, thigh - shank, thigh - pelvis]
    if "toes" in angles:
        columns.append(angles["toes"] - foot)
    return np.column_stack([ankle, *columns])


# In reality the hips are fore and aft of each other and the legs are spread, so
# a planar body with one hip cannot match all segment angles and both feet.
# Standard deviations make the feet fit best: forces are measured under them.
_ANKLE_M, _FOOT_RAD = 0.002, 0.01
_HIP_M, _LEG_RAD = 0.01, 0.03
_PASSES = 8


def _two_legs(tree: PlanarTree, model: MarkerModel, poses: Poses) -> np.ndarray:
    """Coordinates (N, nq) that best fit hips, segment angles and ankles."""
    n, nq = len(poses.hip), tree.num_positions
    ankles = ankle_paths(model, poses)
    hip = np.column_stack([poses.hip.real, poses.hip.imag])
    points = [("pelvis", hip, _HIP_M)]
    points += [(f"foot_{s}", p, _ANKLE_M) for s, p in ankles.items()]
    angles = np.array([tree.turning(name) for name in model.segments])
    sigma = np.array(
        [
            _FOOT_RAD
            if name.startswith(("foot", "toes", "pelvis"))
            else _LEG_RAD
            for name in model.segments
        ]
    )
    # First guess: angles determine all coordinates but the root's position.
    q = np.zeros((n, nq))
    q[:, 2:] = poses.angles @ np.linalg.pinv(angles[:, 2:]).T
    q[:, :2] = hip
    for _ in range(_PASSES):
        J = [np.broadcast_to(angles / sigma[:, None], (n, *angles.shape))]
        r = [(poses.angles - q @ angles.T) / sigma]
        for body, p, size in points:
            J.append(tree.point_jacobian(q, body) / size)
            r.append((p - tree.point_positions(q, body)) / size)
        A, b = np.concatenate(J, axis=1), np.concatenate(r, axis=1)
        At = A.transpose(0, 2, 1)
        q = q + np.linalg.solve(At @ A, At @ b[..., None])[..., 0]
    return q


def residuals(model: MarkerModel, poses: Poses) -> dict[str, np.ndarray]:
    """Marker -> distance from the model (N,) [m]; NaN where it is hidden.

    A marker on two segments has one entry, the root mean square of both.
    """
    names = np.array(model.names)
    square = np.abs(poses.residuals) ** 2
    return {
        name: np.sqrt(square[:, names == name].mean(axis=1))
        for name in model.names
    }


def residual_rms(off: dict[str, np.ndarray]) -> dict[str, float]:
    """Marker -> root mean square of its `residuals` [m] where visible."""
    found = {}
    for name, x in off.items():
        seen = x[np.isfinite(x)]
        found[name] = float(np.sqrt(np.mean(seen**2))) if seen.size else 0.0
    return found


def leg_angles(model: MarkerModel, poses: Poses) -> dict[str, np.ndarray]:
    """Side -> ankle, knee and hip angle (N, 3) [rad], signs of `merge_legs`."""
    found = {}
    for side in model.sides:
        foot, shank, thigh = (
            poses.angles[:, model.index(s, side)]
            for s in ("foot", "shank", "thigh")
        )
        pelvis = poses.angles[:, 0]
        found[side] = np.column_stack(
            [foot - shank, thigh - shank, thigh - pelvis]
        )
    return found


def inverse_dynamics(
    model: PlanarTree,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    loads: dict[str, PlanarWrench],
) -> np.ndarray:
    """Generalized forces of the motion, less those of the measured loads.

    With the foot as root, the first three are the residual: the forces [N] and
    the pitch moment [N m] about the ankle that the motion requires and no load
    provides (zero for perfect data). Joint moments then follow from the
    segments above each joint.

    Args:
        model: multibody model.
        q, v, a: (N, nq) filtered positions, velocities, accelerations.
        loads: body name -> wrench (N,) on it.

    Returns:
        Generalized forces (N, nq) [N, N m].
    """
    Q = model.inverse_dynamics(q, v, a)
    for body, wrench in loads.items():
        Q = Q - model.wrench_on_body(q, body, wrench.array)
    return Q


def from_the_ground_up(
    model: PlanarTree, q: np.ndarray, Q: np.ndarray
) -> np.ndarray:
    """Move the residual of inverse dynamics from the foot to the pelvis.

    Joint moments then follow from the ground reaction and the segments below
    each joint, as OpenSim computes them. The first three components become
    zero: the residual acts on the pelvis instead.

    Args:
        model: multibody model.
        q: (N, nq) positions.
        Q: (N, nq) from `inverse_dynamics`.

    Returns:
        Generalized forces (N, nq) with other joint moments.
    """
    residual = model.ground_reaction(q, Q)
    return Q - model.wrench_on_body(q, "pelvis", residual)


def carried(
    load: Load, time: np.ndarray, place: np.ndarray, gravity: float
) -> PlanarWrench:
    """Wrench (n,) of a carried mass on the body, about the origin.

    Args:
        load: the mass, and when it is carried.
        time: (n,) of the recording [s].
        place: (n, 2) x and z of the mass's centre, filtered [m].
        gravity: magnitude of gravity [m/s^2].

    >>> bag = Load("pelvis", mass_kg=10.0, at_m=(0.0, 0.3))
    >>> time = np.linspace(0.0, 1.0, 11)
    >>> place = np.column_stack([0.2 + 0 * time, 1.0 + 0 * time])
    >>> wrench = carried(bag, time, place, 9.81)
    >>> round(float(wrench.force_z[5]), 6), round(float(wrench.moment[5]), 6)
    (-98.1, 19.62)
    """
    _, a = derivatives(time, place)
    borne = load.mass_kg * _share(load, time)[:, None]
    force = -borne * (a + np.array([0.0, gravity]))
    F_x, F_z = force.T
    return PlanarWrench(force, place[:, 1] * F_x - place[:, 0] * F_z)


def _share(load: Load, time: np.ndarray) -> np.ndarray:
    """Share of the load that the body bears (n,), 0 to 1."""
    share = np.ones(len(time))
    if load.from_s is not None:
        share *= minimum_jerk((time - load.from_s) / load.over_s)[0]
    if load.to_s is not None:
        share *= 1.0 - minimum_jerk((time - load.to_s) / load.over_s)[0]
    return share
