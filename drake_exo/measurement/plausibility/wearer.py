"""Whether encoders tell of the movement that markers saw, by other trials.

A device leans on soft cuffs, so that its joints differ from the person's by
several degrees. By how much follows, to first order, from what is the same in
all trials of one wearer: offsets of encoders, skin that slides with flexion,
cuffs that give to the device's weight, inertia, friction and drive. Two trials
are explained by one set of these sizes and by a set for each; encoders of
another movement need the latter. The ratio of the two likelihoods decides.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from drake_exo.files.verdict import Check
from drake_exo.measurement.plausibility.device import misfit
from drake_exo.measurement.plausibility.evidence import Evidence

LARGEST_DISAGREEMENT = 0.45  # for each independent sample
_REACH_S = 0.06
_DEG = np.pi / 180.0
# Standard deviations of what the difference of angles depends on.
_OFFSET, _SKIN, _BEND = 2.0 * _DEG, 0.03, 0.015  # rad, rad/rad, rad/rad^2
_WEIGHT = 2.0 * _DEG  # by a segment of the device that lies instead of stands
_INERTIA = 0.05 * _DEG  # for each rad/s^2
_FRICTION = 1.0 * _DEG
_DRIVE = 0.2 * _DEG  # for each N m
_CLOCK_S = 0.03
_REST_RAD_S = 0.05  # slower, friction has no direction yet
_NOISE, _CORRELATED_S = 0.5 * _DEG, 0.1


@dataclass(frozen=True)
class _Difference:
    """Angles of the device less the person's in one trial, standardised.

    Attributes:
        by: (n J, sizes) what sizes of standard deviation 1 make of it.
        by_clock: (n J,) likewise the clock of the trial.
        found: (n J,) over its noise.
        count: of independent samples.
    """

    by: np.ndarray
    by_clock: np.ndarray
    found: np.ndarray
    count: float

    @staticmethod
    def of(e: Evidence, lag_s: float) -> "_Difference":
        """With the lag of its clock taken out but for a rest."""
        trial, tree = e.trial, e.subject.model.tree
        time, angles = trial.start_s + trial.times, e.recording.angles
        signal = angles.delayed(lag_s)
        time = np.clip(time, signal.time[0], signal.time[-1])
        d, v, a = signal.motion(time)
        human = e.expected(e.body[0])
        q = trial.q.copy()
        q[:, trial.coordinates.device_columns] = d
        links = [tree.joints[name][1] for name in trial.coordinates.device]
        pitch = np.column_stack([tree.body_angles(q, body) for body in links])
        parts = [
            np.full((len(d), 1), _OFFSET),
            _SKIN * human,
            _BEND * human**2,
            _WEIGHT * np.sin(pitch),
            _INERTIA * a,
            _FRICTION * np.tanh(v / _REST_RAD_S),
        ]
        if e.recording.moments is not None:
            drive = trial.moments[:, trial.coordinates.is_device_joint]
            parts.append(_DRIVE * drive)
        joints = d.shape[1]
        step = trial.duration / (len(d) - 1)
        scale = np.sqrt(step / _CORRELATED_S) / _NOISE
        return _Difference(
            scale * np.kron(np.eye(joints), np.hstack(parts)),
            scale * _CLOCK_S * v.T.ravel(),
            scale * (d - human).T.ravel(),
            joints * trial.duration / _CORRELATED_S,
        )


def _cost(*differences: _Difference) -> float:
    """Least squares with priors, of trials that share all but their clocks."""
    clocks = [
        np.where(np.arange(len(differences)) == k, d.by_clock[:, None], 0.0)
        for k, d in enumerate(differences)
    ]
    by = np.hstack([np.vstack([d.by for d in differences]), np.vstack(clocks)])
    found = np.concatenate([d.found for d in differences])
    # Of y = A x + e, x and e of unit variance: y' (I + A A')^-1 y.
    normal = np.eye(by.shape[1]) + by.T @ by
    explained = by.T @ found
    return float(found @ found - explained @ np.linalg.solve(normal, explained))


def _alike(e: Evidence, other: Evidence) -> bool:
    """Whether two trials can be compared: movements of their own, both with
    recorded moments or both without; a drive bends cuffs far more.
    """
    driven = [x.recording.moments is not None for x in (e, other)]
    return e.files.markers != other.files.markers and driven[0] == driven[1]


def disagreement(evidence: Sequence[Evidence]) -> np.ndarray:
    """How much worse two trials are explained together than each alone.

    Args:
        evidence: (k,) of trials with encoders.

    Returns:
        (k, k) cost for each independent sample; NaN where nothing can be
        said, as of a trial with itself.
    """
    fits = [misfit(e, e, _REACH_S) for e in evidence]
    known = {
        k: _Difference.of(e, lag)
        for k, (e, (share, lag)) in enumerate(zip(evidence, fits, strict=True))
        if np.isfinite(share)
    }
    alone = {k: _cost(d) for k, d in known.items()}
    found = np.full((len(evidence), len(evidence)), np.nan)
    for i, j in combinations(known, 2):
        if not _alike(evidence[i], evidence[j]):
            continue
        more = _cost(known[i], known[j]) - alone[i] - alone[j]
        found[i, j] = found[j, i] = more / (known[i].count + known[j].count)
    return found


def wearer_checks(evidence: Sequence[Evidence]) -> Iterator[Check]:
    """Of each trial with encoders, against the one that is most like it."""
    known = [e for e in evidence if e.recording.angles is not None]
    for e, row in zip(known, disagreement(known), strict=True):
        if np.isnan(row).all():
            continue
        best = int(np.nanargmin(row))
        others = "every other trial"
        if np.sum(~np.isnan(row)) == 1:
            others = f"{known[best].trial.name}, or of the two that one's"
        yield e.check(
            "encoder_stranger",
            row[best],
            LARGEST_DISAGREEMENT,
            "",
            e.files.encoders,
            f"the device moves against the person otherwise than in {others}; "
            "the encoders' file may be of a trial that is not in the study",
        )
