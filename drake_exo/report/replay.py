"""A page that plays a motion with its forces, to be shared as one file.

The arrows are made beforehand and stretched frame by frame, so that a page
holds the meshes once and each frame only numbers: a rise takes about 7 MB.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_exo.report.pictures import FROM_THE_RIGHT, View, set_stage
from drake_exo.report.scene import Scene

_SHAFT_RADIUS = 0.011
_HEAD_LENGTH, _HEAD_RADIUS = 0.06, 0.026
_ROOT = "/forces"


@dataclass(frozen=True)
class ForceTrace:
    """A force over time, drawn as an arrow that starts at its point.

    Attributes:
        name: unique; a name in the page's scene tree.
        point_m: (N, 2) where it acts, world x and z [m].
        force_n: (N, 2) world x and z [N].
        colour: red, green, blue, 0 to 1.
        y_m: how far left of the sagittal plane it is drawn; to the right by
            default, where neither legs nor arms hide it.
    """

    name: str
    point_m: np.ndarray
    force_n: np.ndarray
    colour: tuple[float, float, float] = (0.85, 0.10, 0.10)
    y_m: float = -0.33


def save_replay(
    path: Path,
    time_s: np.ndarray,
    q: np.ndarray,
    *,
    kind: str = "coupled",
    forces: Sequence[ForceTrace] = (),
    metres_per_newton: float = 8e-4,
    smallest_n: float = 5.0,
    frames_per_second: float = 30.0,
    view: View = FROM_THE_RIGHT,
    **model,
) -> None:
    """Write a motion as a page (static HTML) with play and pause buttons.

    Args:
        path: of the page; a motion of minutes stays under 20 MB.
        time_s: (N,) increasing times.
        q: (N, nq) positions in the order of the plant of this kind.
        kind: "coupled", "rigid" or "human".
        forces: arrows to draw; name unique, N rows each.
        metres_per_newton: length of the arrows.
        smallest_n: weaker forces are not drawn.
        frames_per_second: of the page; motion and forces are interpolated.
        view: where the camera stands at first.
        model: `human`, `exoskeleton`, `chair_height_m`, as for `Scene`.

    Raises:
        ValueError: arrays that do not fit together, or are not finite.
    """
    time_s, q = np.asarray(time_s, dtype=float), np.asarray(q, dtype=float)
    _check(time_s, q, forces)
    meshcat = Meshcat()
    scene = Scene(kind, meshcat=meshcat, **model)
    set_stage(meshcat, view)
    for trace in forces:
        _make_arrow(meshcat, trace)
    start, span = time_s[0], time_s[-1] - time_s[0]
    count = max(2, round(span * frames_per_second) + 1)
    meshcat.StartRecording(frames_per_second=frames_per_second)
    for frame in np.linspace(0.0, span, count):
        now = start + frame
        scene.set_pose(_at(now, time_s, q), time_s=frame)
        scene.diagram.ForcedPublish(scene.context)
        for trace in forces:
            _set_arrow(
                meshcat,
                trace,
                _at(now, time_s, trace.point_m),
                _at(now, time_s, trace.force_n),
                metres_per_newton,
                smallest_n,
                frame,
            )
    meshcat.StopRecording()
    meshcat.PublishRecording()
    Path(path).write_text(meshcat.StaticHtml())


def _check(
    time_s: np.ndarray, q: np.ndarray, forces: Sequence[ForceTrace]
) -> None:
    n = len(time_s)
    if n < 2 or not (np.diff(time_s) > 0.0).all():
        raise ValueError("replay needs at least two increasing times")
    if q.ndim != 2 or len(q) != n:
        raise ValueError(f"replay has {n} times but positions {q.shape}")
    if not np.isfinite(q).all():
        raise ValueError("replay positions hold NaN or infinite values")
    for trace in forces:
        for part in (trace.point_m, trace.force_n):
            if np.shape(part) != (n, 2):
                raise ValueError(
                    f"force '{trace.name}' needs shape ({n}, 2), "
                    f"not {np.shape(part)}"
                )
            if not np.isfinite(part).all():
                raise ValueError(
                    f"force '{trace.name}' holds NaN or infinite values"
                )
    if len({trace.name for trace in forces}) < len(forces):
        raise ValueError("names of forces must differ")


def _at(now: float, time_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows (N, m) interpolated at one time, (m,)."""
    return np.array([np.interp(now, time_s, column) for column in rows.T])


def _make_arrow(meshcat: Meshcat, trace: ForceTrace) -> None:
    """An arrow of 1 m along z: shaft from 0 to 1, head on top."""
    colour = Rgba(*trace.colour, 1.0)
    path = f"{_ROOT}/{trace.name}"
    meshcat.SetObject(
        f"{path}/shaft/unit", Cylinder(_SHAFT_RADIUS, 1.0), colour
    )
    meshcat.SetTransform(f"{path}/shaft/unit", RigidTransform([0, 0, 0.5]))
    cone = MeshcatCone(_HEAD_LENGTH, _HEAD_RADIUS, _HEAD_RADIUS)
    meshcat.SetObject(f"{path}/head/cone", cone, colour)
    # Drake's cone has its tip at the origin and its base above it.
    meshcat.SetTransform(
        f"{path}/head/cone",
        RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, 0]),
    )


def _set_arrow(
    meshcat: Meshcat,
    trace: ForceTrace,
    point: np.ndarray,
    force: np.ndarray,
    metres_per_newton: float,
    smallest_n: float,
    frame_s: float,
) -> None:
    """Place, turn and stretch one arrow at one time of the recording."""
    path, size = f"{_ROOT}/{trace.name}", float(np.hypot(*force))
    meshcat.SetProperty(path, "visible", size >= smallest_n, frame_s)
    if size < smallest_n:
        return
    # z to the force's direction: a turn about y from the vertical.
    turn = RotationMatrix.MakeYRotation(float(np.arctan2(force[0], force[1])))
    X_WA = RigidTransform(turn, [point[0], trace.y_m, point[1]])
    meshcat.SetTransform(path, X_WA, frame_s)
    length = size * metres_per_newton
    shaft = max(length - _HEAD_LENGTH, 1e-3)
    meshcat.SetProperty(f"{path}/shaft", "scale", [1.0, 1.0, shaft], frame_s)
    meshcat.SetTransform(
        f"{path}/head",
        RigidTransform([0.0, 0.0, shaft + _HEAD_LENGTH]),
        frame_s,
    )
