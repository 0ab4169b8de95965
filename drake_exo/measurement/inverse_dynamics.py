"""Generalized forces of the rigid model from motion and measured forces.

Among these are wrenches of what a person carries, of what pulls and pushes.

A carried mass acts with its weight and inertia where it is: the force on the
body is -m (a + g), a being the acceleration of its centre. That centre is the
mean of markers, or a place on a segment. While the mass is lifted off, or put
down, the body bears a part of it that grows from nothing to all.
"""

from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.filters import derivatives, fill_gaps, minimum_jerk
from drake_exo.measurement.recording import read_foot_forces
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import (
    Load,
    Plates,
    RecordingSettings,
    TrialFiles,
)
from drake_exo.model.planar_tree import PlanarTree


def wrench_on_body(
    model: PlanarTree, q: np.ndarray, body: str, wrench: PlanarWrench
) -> np.ndarray:
    """Generalized forces (N, nq) of a wrench about the world's origin.

    Args:
        model: the dynamics.
        q: (N, nq) positions.
        body: the body that the wrench acts on.
        wrench: force [N] and moment M_y about the origin [N m].
    """
    p = model.point_positions(q, body, (0, 0))
    J = model.point_jacobian(q, body, (0, 0))
    F_x, F_z = wrench.force.T
    moment = wrench.moment - (p[:, 1] * F_x - p[:, 0] * F_z)
    Q = np.einsum("nij,ni->nj", J, wrench.force)
    # M_y is about y, angles are about -y.
    return Q - moment[:, None] * model.turning(body)


def inverse_dynamics(
    model: PlanarTree,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    loads: dict[str, PlanarWrench],
) -> np.ndarray:
    """Generalized forces that remain after the measured loads.

    With the foot as root, the first three components are the forces
    [N] and the pitch moment [N m] about the ankle that motion demands and no
    load explains (zero for perfect data), and the joint moments are those of
    the segments above each joint.

    Args:
        model: the dynamics.
        q, v, a: (N, nq) filtered positions, velocities, accelerations.
        loads: body name -> wrench on it.

    Returns:
        (N, nq).
    """
    Q = model.inverse_dynamics(q, v, a)
    for body, wrench in loads.items():
        Q = Q - wrench_on_body(model, q, body, wrench)
    return Q


def from_the_ground_up(
    model: PlanarTree, q: np.ndarray, Q: np.ndarray, top: str = "pelvis"
) -> np.ndarray:
    """Move the unexplained force from the foot to the topmost body.

    Joint moments then follow from the ground reaction and the segments
    below each joint, as OpenSim computes them; the first three components
    become zero, and what was there acts on `top` instead.

    Args:
        model: the dynamics.
        q: (N, nq) positions.
        Q: (N, nq) from `inverse_dynamics`.
        top: body that takes the residual.

    Returns:
        (N, nq) with joint moments changed.
    """
    residual = PlanarWrench.of(model.ground_reaction(q, Q))
    return Q - wrench_on_body(model, q, top, residual)


def carried(
    load: Load, time: np.ndarray, place: np.ndarray, gravity: float
) -> PlanarWrench:
    """Wrench on the body that bears a mass.

    Args:
        load: the mass, and when it is carried.
        time: (n,) of the recording [s].
        place: (n, 2) x and z of its centre, smooth [m].
        gravity: its magnitude [m/s^2].

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
    """Part of the mass that the body bears (n,)."""
    share = np.ones(len(time))
    if load.from_s is not None:
        share *= minimum_jerk((time - load.from_s) / load.over_s)[0]
    if load.to_s is not None:
        share *= 1.0 - minimum_jerk((time - load.to_s) / load.over_s)[0]
    return share


def wrenches(
    files: TrialFiles,
    settings: RecordingSettings,
    root: Path,
    tree: PlanarTree,
    time: np.ndarray,
    q: np.ndarray,
    recorded: MarkerData,
) -> dict[str, PlanarWrench]:
    """Segment -> wrench (n,) of all that it bears.

    Args:
        files: of the trial.
        settings: of the study.
        root: folder that its paths start from.
        tree: of the person without a device that moves.
        time: (n,) of the recording [s].
        q: (n, nq) filtered motion.
        recorded: its markers.

    Raises:
        InputError: markers or forces are missing, or do not cover it.
    """
    found: dict[str, PlanarWrench] = {}
    for load in files.loads:
        if load.forces is not None:
            wrench = _of_file(load, settings, root, time)
        else:
            place = _place(load, settings, tree, time, q, recorded)
            wrench = carried(load, time, place, settings.gravity_m_s2)
        if load.body in found:
            wrench = found[load.body] + wrench
        found[load.body] = wrench
    return found


def _place(load, settings, tree, time, q, recorded) -> np.ndarray:
    if load.at_m is not None:
        return tree.point_positions(q, load.body, load.at_m)
    filled, gaps = fill_gaps(
        recorded, load.markers, settings.laboratory.fill_gaps_s
    )
    gaps.check()
    frame = settings.laboratory.marker_axes.frame
    middle = frame.points(filled.of(load.markers)).mean(axis=1)
    smooth = settings.filter.smooth(middle, recorded.rate_hz, recorded.source)
    first = np.searchsorted(recorded.time, time[0] - 1e-9)
    return smooth[first : first + len(time)]


def _of_file(load, settings, root, time) -> PlanarWrench:
    path, laboratory = root / load.forces, settings.laboratory
    forces = read_foot_forces(
        path, Plates(both=load.plate), laboratory, settings.filter, loaded=False
    ).delayed(laboratory.force_delay_s)
    step = 1.0 / forces.rate_hz
    if forces.time[0] > time[0] + step or forces.time[-1] < time[-1] - step:
        raise InputError(
            f"{path}: runs from {forces.time[0]:g} to {forces.time[-1]:g} s, "
            f"the recording from {time[0]:g} to {time[-1]:g} s; export the "
            "whole file"
        )
    forces = forces.on_belt(settings.ground.belt_speed_m_s)
    return forces.filtered(settings.filter).at(time)["both"]
