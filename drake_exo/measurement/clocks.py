"""Clock offsets between motion capture and the other systems.

Systems that are started by hand, or filtered on their way, are milliseconds
apart; in a fast rise ten of them are tens of newtons. What the feet must bear
by Newton's law, from the markers alone, tells the plates' offset; that of
encoders and mats comes from the cuffs between the two chains.

Encoders cannot be timed by the human's joint angles: soft cuffs let the
device lag or lead by tens of milliseconds, as its weight and inertia ask. But
what it asks for must be what springs between it and the human give. With
their stiffnesses free (and not negative), the equations of motion of the
device's joints hold for one offset only. The deflection found there
tells the offset of the mats in turn.
"""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import nnls

from drake_exo.contact.bushing import NORMAL, BushingKinematics
from drake_exo.measurement.exoskeleton import Signal
from drake_exo.model.plant import Model

_STEP_S = 0.001
_COARSE = 4  # steps of the first search
# Share of variance that must be explained before a lag is believed.
EXPLAINED = 0.8


def _lags(reach_s: float) -> np.ndarray:
    count = round(reach_s / _STEP_S)
    return _STEP_S * np.arange(-count, count + 1)


def force_delay(
    time: np.ndarray,
    needed: np.ndarray,
    force: np.ndarray,
    used: np.ndarray,
    reach_s: float = 0.05,
) -> float:
    """By how much the recorded force lags behind the motion [s].

    Args:
        time: (N,) evenly spaced [s].
        needed: (N,) m (a_com + g) of the filtered motion [N].
        force: (N,) filtered vertical force of feet and chair [N].
        used: (N,) bool, where they alone bear the body.
        reach_s: largest delay either way.

    Returns:
        The delay, to 1 ms, at which the difference varies least.
    """
    delays = _lags(reach_s)
    spread = [
        np.std(needed[used] - np.interp(time[used] + delay, time, force))
        for delay in delays
    ]
    return round(float(delays[int(np.argmin(spread))]), 6)


def search_delay(
    left: Callable[[float], float], reach_s: float
) -> tuple[float, float]:
    """The delay that leaves the least unexplained, to 1 ms.

    Args:
        left: share of variance that a delay leaves unexplained.
        reach_s: largest delay either way [s].

    Returns:
        The delay [s], and the share that is explained there.
    """
    coarse = _lags(reach_s)[::_COARSE]
    best = min(coarse, key=left)
    fine = best + _STEP_S * np.arange(1 - _COARSE, _COARSE)
    fine = fine[np.abs(fine) <= reach_s + 1e-9]
    values = [left(delay) for delay in fine]
    found = int(np.argmin(values))
    return round(float(fine[found]), 6), 1.0 - values[found]


def cuff_deflections(
    model: Model, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How the cuffs are strained, and what that does to the device.

    Args:
        model: with exoskeleton.
        q: (N, nq) coordinates.

    Returns:
        Tangential, normal [m] and rotational [rad] deflection (N, cuffs, 3),
        of the device seen from the human; and the moments (N, device's
        joints, cuffs, 3) at the device's joints for unit stiffness of each.
    """
    tree = model.tree
    device = tree.coordinates.device_columns
    d = np.empty((len(q), len(tree.cuffs), 3))
    Q = np.empty((len(q), len(device), len(tree.cuffs), 3))
    for i, (cuff, origin) in enumerate(model.cuffs.items()):
        gap = model.preload(cuff)
        bushing = BushingKinematics(tree, cuff, (*gap, 0.0))
        terms = bushing.terms(q, np.broadcast_to(origin, (len(q), 2)))
        d[:, i] = bushing.deflection(q, terms)
        J = bushing.deflection_jacobian(terms)[:, :, device]
        Q[:, :, i] = -(d[:, i, :, None] * J).transpose(0, 2, 1)
    return d, Q


def encoder_delay(
    time: np.ndarray,
    body: tuple[np.ndarray, ...],
    angles: Signal,
    drive: Callable,
    model: Model,
    reach_s: float,
) -> tuple[float, float]:
    """By how much encoders lag behind the markers [s].

    Args:
        time: (N,) of the markers [s].
        body: q, v, a (N, .) of the rigid model.
        angles: encoders on their own clock.
        drive: function of time on that clock and of q, v, a (n, nq) to the
            moments (n, joints) of the device's joints.
        model: with exoskeleton.
        reach_s: largest delay either way.

    Returns:
        The delay, and the share of the device's demand that springs explain
        there.
    """
    margin = 1.001 * reach_s
    inside = (time > angles.time[0] + margin) & (
        time < angles.time[-1] - margin
    )
    if inside.sum() < 20:
        return 0.0, 0.0
    t, motion = time[inside], [x[inside] for x in body]
    tree, device = model.tree, model.coordinates.device_columns
    spline = make_interp_spline(angles.time, angles.values, k=5)

    def left(delay: float) -> float:
        at = t + delay
        q, v, a = (
            np.hstack([x, spline.derivative(k)(at) if k else spline(at)])
            for k, x in enumerate(motion)
        )
        demand = tree.inverse_dynamics(q, v, a)[:, device]
        demand = (demand - drive(at, q, v, a)).ravel()
        A = cuff_deflections(model, q)[1].reshape(len(demand), -1)
        size = np.linalg.norm(A, axis=0)
        _, rest = nnls(A / np.maximum(size, 1e-12), demand)
        return float((rest / np.linalg.norm(demand)) ** 2)

    return search_delay(left, reach_s)


def mat_delay(
    time: np.ndarray,
    q: np.ndarray,
    mats: list[tuple[str, np.ndarray, np.ndarray]],
    model: Model,
    reach_s: float,
) -> tuple[float, float]:
    """By how much mats lag behind the cuffs' normal deflection [s].

    Args:
        time: (N,) [s].
        q: (N, nq) motion with encoders on the right clock.
        mats: cuff, time and normal force of each.
        model: with exoskeleton.
        reach_s: largest delay either way.

    Returns:
        The delay, and the share of the mats' variance that is explained.
    """
    d = cuff_deflections(model, q)[0][:, :, NORMAL]
    cases = []
    cuffs = list(model.cuffs)
    for cuff, signal_time, force in mats:
        inside = (time > signal_time[0] + reach_s) & (
            time < signal_time[-1] - reach_s
        )
        if inside.sum() < 20:
            continue
        x = d[inside, cuffs.index(cuff)]
        # Cuffs may stiffen: a cubic with a constant, orthonormal.
        x = (x - x.mean()) / max(float(np.ptp(x)), 1e-9)
        U = np.linalg.qr(np.vander(x, 4))[0]
        cases.append((time[inside], U, signal_time, force))
    if not cases:
        return 0.0, 0.0

    def left(delay: float) -> float:
        shares = []
        for t, U, signal_time, force in cases:
            y = np.interp(t + delay, signal_time, force)
            r = y - U @ (U.T @ y)
            shares.append(
                (r @ r) / max(float(((y - y.mean()) ** 2).sum()), 1e-12)
            )
        return float(np.mean(shares))

    return search_delay(left, reach_s)
