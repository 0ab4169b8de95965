"""How far one movement is from another, and how far trials are apart."""

import numpy as np

from drake_exo.collocation.transcription import stands_for
from drake_exo.measurement.trial import Trial

_PHASE_SAMPLES = 101


def rms(values: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
    """Root mean square over time, ignoring NaN.

    Args:
        values: (n, m), or (n,).
        times: (n,) of them: a value counts as long as it stands for, so that
            places where a grid is fine do not count more; even if None.

    Returns:
        (m,), or a number; NaN where there is nothing.
    """
    steps = np.ones(len(values) - 1) if times is None else np.diff(times)
    lengths = stands_for(steps)
    known = ~np.isnan(values)
    square = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(lengths @ square / (lengths @ known))


def rmsd(found: Trial, measured: Trial, loads: bool = True) -> dict:
    """Root mean square differences of one trial.

    Args:
        found: of the model.
        measured: the same trial as measured.
        loads: compare joint moments and interaction forces, which mean
            nothing while human and exoskeleton do not touch (Phase A).

    Returns:
        trial, angles_deg and velocities_deg_s by joint, the root's place under
        its name (x_mm, z_mm, pitch_deg), grf_n (horizontal, vertical) and
        cop_mm, each by foot where there are two; where they were measured,
        moments_nm by joint and interaction_n (normal force) by cuff, empty
        otherwise.
    """
    at, names = measured.sample(found.times), found.coordinates
    times = found.times
    d_q, d_v = rms(found.q - at.q, times), rms(found.v - at.v, times)
    grf, cop = {}, {}
    for side, measured_wrench in at.soles.items():
        wrench = found.soles[side]
        d_ground = rms(wrench.force - measured_wrench.force, times)
        off = (wrench.cop_x - measured_wrench.cop_x)[:, None]
        end = "" if side == "both" else f" {side}"
        grf |= _by_name((f"horizontal{end}", f"vertical{end}"), d_ground)
        cop[side] = float(1e3 * rms(off, times)[0])
    x, z, pitch = d_q[names.root_columns]
    moments, interaction = {}, {}
    if at.moments is not None and loads:
        moments = _by_name(names.joints, rms(found.moments - at.moments, times))
    for cuff, force in at.cuffs.items():
        if cuff in found.cuffs:
            off = found.cuffs[cuff].normal - force.normal
            interaction[cuff] = float(rms(off, times))
    return {
        "trial": found.name,
        "angles_deg": _of_joints(names, d_q),
        "velocities_deg_s": _of_joints(names, d_v),
        names.root[0].removesuffix("_x"): {
            "x_mm": float(1e3 * x),
            "z_mm": float(1e3 * z),
            "pitch_deg": float(np.rad2deg(pitch)),
        },
        "grf_n": grf,
        "cop_mm": cop.get("both", cop),
        "moments_nm": moments,
        "interaction_n": interaction,
    }


def spread(trials: list[Trial]) -> dict:
    """One standard deviation over the measured trials, time-normalised.

    The mean over the movement of the standard deviation at each percent of
    it; the paper compares its RMSD with that. NaN for a single trial. Keys as
    in `rmsd`; the centre of pressure is taken from the foot.
    """
    names = trials[0].coordinates
    sampled = [
        t.sample(np.linspace(0.0, t.duration, _PHASE_SAMPLES)) for t in trials
    ]

    def deviation(signal, of=sampled):
        values = np.stack([signal(t) for t in of])
        if len(values) < 2:
            return np.full(values.shape[2:], np.nan)
        return values.std(axis=0, ddof=1).mean(axis=0)

    moments, interaction = {}, {}
    if all(t.moments is not None for t in trials):
        found = deviation(lambda t: t.moments)
        moments = _by_name(names.joints, found)
    for cuff in dict.fromkeys(c for t in trials for c in t.cuffs):
        having = [t for t in sampled if cuff in t.cuffs]
        found = deviation(lambda t, c=cuff: t.cuffs[c].normal, having)
        interaction[cuff] = None if np.isnan(found) else float(found)
    grf, cop = {}, {}
    root = names.root[0]
    for side in trials[0].soles:
        end = "" if side == "both" else f" {side}"
        force = deviation(lambda t, side=side: t.soles[side].force)
        grf |= _by_name((f"horizontal{end}", f"vertical{end}"), force)
        with np.errstate(invalid="ignore"):
            cop[side] = 1e3 * deviation(
                lambda t, side=side: t.soles[side].cop_x - t.coordinate(root)
            )
    return {
        "angles_deg": _of_joints(names, deviation(lambda t: t.q)),
        "velocities_deg_s": _of_joints(names, deviation(lambda t: t.v)),
        "grf_n": grf,
        "cop_mm": cop.get("both", cop),
        "moments_nm": moments,
        "interaction_n": interaction,
    }


def _of_joints(names, values) -> dict[str, float]:
    """Values (nq,) [rad] of the joints, in degrees."""
    return _by_name(names.joints, np.rad2deg(values[names.joint_columns]))


def _by_name(names, values) -> dict[str, float]:
    return {name: float(v) for name, v in zip(names, values, strict=True)}
