"""Systematic errors of measurement as unknowns of a phase.

A measured signal is the true one plus effects that are linear in a few unknown
sizes: skin that slides, encoders with an offset, mats that measure only part of
the force, clocks that lag. The sizes are estimated with the contact, each with
a prior. An effect has one size at all nodes, so that errors of a signal are
correlated in time as they are in reality.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from drake_exo.contact.parameters import Posterior
from drake_exo.files.schema import not_negative, quantity
from drake_exo.measurement.kinematics import (
    from_the_ground_up,
    inverse_dynamics,
)
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model

_DIFFERENCE = 1e-4  # step of an unknown for differences [rad/rad]
# System of a trial -> name of its clock among the unknowns.
CLOCKS = {"encoders": "encoder_clock", "pressure": "mat_clock"}


@dataclass(frozen=True)
class ErrorSizes:
    """Standard deviation of each systematic error; 0 for no such error.

    Attributes:
        skin: turn of a segment's markers for each radian of flexion of a
            neighbouring joint. Thigh artefacts are close to linear in the
            flexions of hip and knee, subject by subject (Camomilla et al.,
            J. Biomechanics 46, 2013), and reach 3 to 8 degrees in a deep
            flexion (Peters et al., Gait & Posture 31, 2010).
        skin_bend: likewise, for each square radian.
        encoder_offset_deg: how far the zero of a joint's encoder is from its
            angle while the person stands upright.
        mat_share: share of a cuff's force that its mats do not measure.
        mat_offset_n: offset of a cuff's mats at rest.
        friction: error of the device's friction as a bench identified it, as a
            share.
        encoder_clock_s, mat_clock_s: lag that remains in this clock; systems
            that are started by hand are up to 50 ms apart.

    >>> ErrorSizes(skin=0.0).encoder_offset_deg
    2.0
    """

    # Skin turns less than the joint, an angle by no more than half a circle.
    # Of friction that is off by more than a factor of 10 nothing is known.
    skin: float = quantity("rad/rad", 0.03, minimum=0.0, maximum=1.0)
    skin_bend: float = quantity("rad/rad^2", 0.015, minimum=0.0, maximum=1.0)
    encoder_offset_deg: float = quantity("deg", 2.0, minimum=0.0, maximum=180.0)
    mat_share: float = quantity("1", 0.05, minimum=0.0, maximum=1.0)
    mat_offset_n: float = not_negative("N", 3.0)
    friction: float = quantity("1", 0.4, minimum=0.0, maximum=10.0)
    encoder_clock_s: float = quantity("s", 0.03, minimum=0.0, maximum=1.0)
    mat_clock_s: float = quantity("s", 0.03, minimum=0.0, maximum=1.0)


# For instruments without any errors but noise.
NO_ERRORS = ErrorSizes(*[0.0] * len(fields(ErrorSizes)))


@dataclass(frozen=True)
class Unknown:
    """Unknown size of one error.

    Attributes:
        kind: such as ("skin", "thigh", "knee").
        sd: standard deviation of its prior.
        trial: the trial it belongs to; None if all share it.
        mean: mean of its prior.
    """

    kind: tuple[str, ...]
    sd: float
    trial: str | None = None
    mean: float = 0.0

    @property
    def name(self) -> str:
        """Such as "skin.thigh.knee"; that of a trial begins with its name."""
        return ".".join(part for part in (self.trial, *self.kind) if part)


@dataclass(frozen=True)
class Effects:
    """Change of measured signals by m unknowns of size 1.

    Attributes:
        q, v: (n, nq, m) coordinates and velocities.
        moments: (n, n_joints, m) joint moments [N m].
        normal: cuff -> (n, m) normal force [N].
    """

    q: np.ndarray
    v: np.ndarray
    moments: np.ndarray
    normal: dict[str, np.ndarray]


class ErrorModel:
    """Unknown errors of some trials, and their effects on signals.

    Args:
        model: subject and device.
        trials: measured.
        sizes: standard deviations of the priors.
        known: posterior of a calibration, prior of errors that trials share.
        solved: solutions of the trials, or of some. They tell at what rates
            readings change without their noise, with which a lag would seem
            too short and too sure.

    Attributes:
        unknowns: all unknowns, in the order of effects' last axis.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        sizes: ErrorSizes,
        known: Posterior | None = None,
        solved: Sequence[Trial] = (),
    ):
        self._known = known
        self._solved = {trial.name: trial for trial in solved}
        self._model = model
        names = model.coordinates
        found = [
            Unknown((kind, segment, joint), sd)
            for kind, sd in (("skin", sizes.skin), ("bend", sizes.skin_bend))
            for segment, joints in _moved(model).items()
            for joint in joints
        ]
        offset = float(np.deg2rad(sizes.encoder_offset_deg))
        found += [Unknown(("encoder", d), offset) for d in names.device]
        if any(t.friction is not None for t in trials):
            found += [
                Unknown(("friction", d), sizes.friction) for d in names.device
            ]
        for cuff in dict.fromkeys(c for t in trials for c in t.cuffs):
            found.append(Unknown(("mat", cuff, "unseen"), sizes.mat_share))
            found.append(Unknown(("mat", cuff, "offset"), sizes.mat_offset_n))
        for trial in trials:
            clocks = {"encoders": sizes.encoder_clock_s}
            if trial.cuffs:
                clocks["pressure"] = sizes.mat_clock_s
            found += [
                Unknown(
                    (CLOCKS[system],),
                    sd,
                    trial.name,
                    -trial.shifts_s.get(system, 0.0),
                )
                for system, sd in clocks.items()
                if _is_unknown(trial, system)
            ]
        self.unknowns = [u for u in found if u.sd > 0.0] if names.device else []

    @property
    def names(self) -> list[str]:
        """Names of the unknowns."""
        return [u.name for u in self.unknowns]

    def prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean (m,) and covariance (m, m) of the unknowns."""
        mean = np.array([u.mean for u in self.unknowns])
        covariance = np.diag([u.sd**2 for u in self.unknowns])
        known = [] if self._known is None else self._known.names
        i = [k for k, name in enumerate(self.names) if name in known]
        if i:
            found = self._known.of([self.names[k] for k in i])
            mean[i], covariance[np.ix_(i, i)] = found
        return mean, covariance

    def effects(self, at: Trial) -> Effects:
        """Effect of each unknown on the signals of a trial."""
        names = self._model.coordinates
        m, n = len(self.unknowns), len(at.times)
        q, v, a = np.zeros((3, n, len(names), m))
        moments = np.zeros((n, names.num_joints, m))
        normal = {cuff: np.zeros((n, m)) for cuff in at.cuffs}
        device = names.device_columns
        near = self._solved.get(at.name)
        near = at if near is None else near.sample(at.times)
        moved, human = _moved(self._model), names.columns(names.human)
        alone = self._model.tree.turned_alone(moved, human)
        turns = dict(zip(moved, alone, strict=True))
        for k, unknown in enumerate(self.unknowns):
            if unknown.trial not in (None, at.name):
                continue
            kind, *rest = unknown.kind
            if kind in ("skin", "bend"):
                segment, joint = rest
                j = names.index(joint)
                flexion = [x[:, j] for x in (at.q, at.v, at.a)]
                if kind == "bend":
                    flexion = _squared(*flexion)
                for x, f in zip((q, v, a), flexion, strict=True):
                    x[:, :, k] = np.outer(f, turns[segment])
                moments[:, :, k] = self._moments(at, q, v, a, k)
            elif kind == "encoder":
                q[:, names.index(rest[0]), k] = 1.0
            elif kind == "friction":
                if at.friction is not None:
                    moments[:, :, k] = shared_moments(
                        names, at.friction, rest[0]
                    )
            elif kind == "mat":
                cuff, what = rest
                if cuff in normal:
                    f = at.cuffs[cuff].normal
                    normal[cuff][:, k] = -f if what == "unseen" else 1.0
            elif kind == "encoder_clock":
                q[:, device, k] = -near.v[:, device]
                v[:, device, k] = -near.a[:, device]
                # Recorded with the angles or computed from them: same lag.
                if at.moments is not None:
                    rates = np.gradient(near.device_moments, at.times, axis=0)
                    moments[:, :, k] = shared_moments(names, -rates)
            else:
                for cuff in at.cuffs:
                    force = near.cuffs[cuff].normal
                    normal[cuff][:, k] = -np.gradient(force, at.times)
        return Effects(q, v, moments, normal)

    def _moments(self, at: Trial, q, v, a, k) -> np.ndarray:
        """Change (n, n_joints) of the human's moments by sliding skin (k)."""
        tree, names = self._model.rigid.tree, self._model.coordinates
        body = names.body_columns
        loads = at.loads(tree.root)

        def resultant(size):
            x = [
                of[:, body] + size * by[:, body, k]
                for of, by in ((at.q, q), (at.v, v), (at.a, a))
            ]
            Q = inverse_dynamics(tree, *x, loads)
            Q = from_the_ground_up(tree, x[0], Q)
            return Q[:, tree.coordinates.joint_columns]

        change = resultant(_DIFFERENCE) - resultant(-_DIFFERENCE)
        found = np.zeros((len(at.times), names.num_joints))
        found[:, ~names.is_device_joint] = change / (2.0 * _DIFFERENCE)
        return found


def _is_unknown(trial: Trial, system: str) -> bool:
    """Whether a clock's lag is unknown: the study did not give it."""
    said = trial.provenance
    return "delays_s" not in said or system in said.get("clocks", {})


def shared_moments(
    names: Coordinates, change: np.ndarray, joint: str | None = None
) -> np.ndarray:
    """Change (n, n_joints) of all moments by the device's (n, m) [N m].

    The human's moments decrease by what the device's increase.

    Args:
        names: names of the coordinates.
        change: change of the device's moments.
        joint: the only device joint whose change counts; all by default.
    """
    found = np.zeros((len(change), names.num_joints))
    human = ~names.is_device_joint
    for i, device in enumerate(names.device):
        if joint in (None, device):
            found[:, names.joint(device)] += change[:, i]
            found[:, human] -= np.outer(change[:, i], names.turned_by[i])
    return found


def _squared(f, rate, acceleration):
    """f^2 with its first and second time derivative."""
    return f * f, 2.0 * f * rate, 2.0 * (rate * rate + f * acceleration)


def _moved(model: Model) -> dict[str, tuple[str, ...]]:
    """Segment that each human joint moves -> the joints at its ends."""
    joints = {name: model.tree.joints[name] for name in model.coordinates.human}
    return {
        child: tuple(name for name, ends in joints.items() if child in ends)
        for _, child in joints.values()
    }
