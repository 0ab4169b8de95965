"""How far a solution is from what was measured."""

import numpy as np

from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import Trajectory
from drake_exo.collocation.bushing_kernels import BUSHINGS, NORMAL
from drake_exo.model.plant import COUPLED_COORDINATES

_PHASE_SAMPLES = 101


def rms(values: np.ndarray) -> np.ndarray:
    """Root mean square over time, ignoring NaN; (n, m) to (m,)."""
    return np.sqrt(np.nanmean(np.square(values), axis=0))


def rmsd(
    trajectory: Trajectory, trial: MeasuredMovement, loads: bool = True
) -> dict:
    """Root mean square differences of one trial.

    Args:
        trajectory: of the model.
        trial: as measured.
        loads: compare joint moments and interaction forces, which mean
            nothing while human and exoskeleton do not touch (Phase A).

    Returns:
        trial, angles_deg and velocities_deg_s by joint, foot (x_mm, z_mm,
        pitch_deg), grf_n (horizontal, vertical), cop_mm; where they were
        measured, moments_nm by joint and interaction_n (normal force) by
        segment, empty otherwise.
    """
    at = trial.sample(trajectory.times)
    joints = COUPLED_COORDINATES[3 : trajectory.q.shape[1]]
    d_q = rms(trajectory.q - at.q)
    d_v = rms(trajectory.v - at.v)
    d_ground = rms(trajectory.ground[:, :2] - at.ground[:, :2])
    cop = (trajectory.cop_x - measured_cop(at))[:, None]
    return {
        "trial": trajectory.name,
        "angles_deg": _by_joint(joints, np.rad2deg(d_q[3:])),
        "velocities_deg_s": _by_joint(joints, np.rad2deg(d_v[3:])),
        "foot": {
            "x_mm": 1e3 * d_q[0],
            "z_mm": 1e3 * d_q[1],
            "pitch_deg": np.rad2deg(d_q[2]),
        },
        "grf_n": {"horizontal": d_ground[0], "vertical": d_ground[1]},
        "cop_mm": 1e3 * rms(cop)[0],
        "moments_nm": (
            {}
            if at.moments is None or not loads
            else _by_joint(joints, rms(trajectory.torque - at.moments))
        ),
        "interaction_n": (
            {}
            if trajectory.interaction is None
            else {
                name: float(rms(normal_force(trajectory, name) - force))
                for name, force in at.normal_force.items()
            }
        ),
    }


def normal_force(trajectory: Trajectory, segment: str) -> np.ndarray:
    """Normal force (n,) of a cuff on the human's segment [N]."""
    return trajectory.interaction[:, 3 * BUSHINGS.index(segment) + NORMAL]


def measured_cop(at: MeasuredMovement) -> np.ndarray:
    """Measured centre of pressure (n,) [m]; NaN where hardly loaded."""
    load = np.where(at.ground[:, 1] > 20.0, at.ground[:, 1], np.nan)
    return -at.ground[:, 2] / load


def spread(trials: list[MeasuredMovement]) -> dict:
    """One standard deviation over the measured trials, time-normalised.

    The mean over the movement of the standard deviation at each percent of
    it; the paper compares its RMSD with that. NaN for a single trial. Keys as
    in `rmsd`; the centre of pressure is taken from the foot.
    """
    joints = COUPLED_COORDINATES[3 : trials[0].q.shape[1]]
    sampled = [
        t.sample(np.linspace(0.0, t.duration, _PHASE_SAMPLES)) for t in trials
    ]

    def deviation(signal):
        values = np.stack([signal(t) for t in sampled])
        if len(values) < 2:
            return np.full(values.shape[2], np.nan)
        return values.std(axis=0, ddof=1).mean(axis=0)

    moments, interaction = {}, {}
    if all(t.moments is not None for t in trials):
        moments = _by_joint(joints, deviation(lambda t: t.moments))
    for name in BUSHINGS:
        having = [t for t in sampled if name in t.normal_force]
        if having:
            values = np.stack([t.normal_force[name] for t in having])
            interaction[name] = (
                float(values.std(axis=0, ddof=1).mean())
                if len(values) > 1
                else None
            )
    force = deviation(lambda t: t.ground[:, :2])
    cop = deviation(lambda t: (measured_cop(t) - t.q[:, 0])[:, None])
    return {
        "angles_deg": _by_joint(
            joints, np.rad2deg(deviation(lambda t: t.q[:, 3:]))
        ),
        "velocities_deg_s": _by_joint(
            joints, np.rad2deg(deviation(lambda t: t.v[:, 3:]))
        ),
        "grf_n": {"horizontal": force[0], "vertical": force[1]},
        "cop_mm": 1e3 * cop[0],
        "moments_nm": moments,
        "interaction_n": interaction,
    }


def _by_joint(joints, values) -> dict[str, float]:
    return {name: float(v) for name, v in zip(joints, values, strict=True)}
