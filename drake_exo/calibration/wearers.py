"""Wearers of a design, and how they move in a device whose contact is given.

`OwnMovement`: the person moves as measured and the device's torques are as
measured; the device's motion and the cuffs' forces follow from the equations of
motion. With today's cuffs this is what a design is compared with; with other
cuffs it is the design's forecast. Mats and encoders are not tracked then, since
other cuffs would change what they show.

Besides the people who were calibrated, wearers are drawn from a calibration's
posterior (`drawn`) or have bodies of other sizes (`sized`).

`hold` tells whether cuffs hold a device: with the person held still, springs of
the cuffs, springs across joints and gravity give it a potential energy. If its
curvature by the device's joints is negative in some direction, the device's own
weight moves it away: it hangs loose, even if a movement on it can be solved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from drake_exo.calibration.error_model import NO_ERRORS, shared_moments
from drake_exo.calibration.phases import check_has_cuffs
from drake_exo.calibration.problem import (
    Answer,
    PhaseProblem,
    ground_terms,
    has_encoders,
    kinematic_terms,
    solved,
    torque_terms,
)
from drake_exo.calibration.settings import (
    DesignSettings,
    Population,
    PredictionSettings,
)
from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import Design, links_above, movable
from drake_exo.errors import InputError
from drake_exo.measurement.exoskeleton import (
    friction_moments,
    spring_moments,
    spring_stiffness,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import Device
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import named_so
from drake_exo.model.description import refitted
from drake_exo.model.plant import Model
from drake_exo.model.segments import CUFFED, SEGMENTS, HumanParameters

# Law of contact -> power of body mass to which a sphere's stiffness scales.
_POWER = {"simbody": 1.0, "paper": 2.0 / 3.0}
# Residual of `posture_law` that is accepted, as a multiple of the torque's
# noise: angles are noisy, too.
_EXPLAINED = 2.0
_STEP_RAD = 1e-5


class OwnMovement(PhaseProblem):
    """The movement of measured trials on given cuffs, posed as a program.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated.
        settings: noise, errors and grid, as those of Phase C.
        seen: track encoders, too: the device's true motion on the cuffs with
            which it was measured.
        answers: trial -> how its torques change if the device moves otherwise
            than measured; a trial not named keeps its torques.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = OwnMovement(made.model, made.trials, made.contact)
    >>> len(posed.movements[0].tracked)
    5

    Raises:
        InputError: the model has no cuffs.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: PredictionSettings | None = None,
        *,
        seen: bool = False,
        answers: Mapping[str, Answer | None] | None = None,
    ):
        check_has_cuffs(model)
        self._seen = seen
        self._answers = answers or {}
        settings = settings or PredictionSettings()
        super().__init__(model, trials, contact, [], settings, settings.errors)

    def _terms(self, movement, at, effects):
        noise = self.settings.noise
        return [
            *kinematic_terms(movement, at, noise, effects, encoders=self._seen),
            *ground_terms(movement, at, noise),
            *torque_terms(
                movement,
                at,
                noise,
                effects,
                answer=self._answers.get(movement.name),
            ),
        ]


def posture_law(wearer: Wearer, noise_nm: float) -> dict[str, np.ndarray]:
    """How a device's drive torques depend on its posture, from recordings.

    A drive that carries weight gives moments in proportion to the sine of the
    inclination of each link beyond its joint. These and a constant are fitted
    to all trials. A drive whose residual exceeds twice the torque's noise does
    not follow posture.

    Args:
        wearer: whose trials have the device's true motion; the law is empty
            without any.
        noise_nm: standard deviation of the device's torques [N m].

    Returns:
        Joint whose drive follows posture -> torque by the sine of each link's
        inclination (m,) [N m], links in the order of the device's joints.
    """
    trials, model, law = wearer.trials, wearer.model, {}
    if not trials:
        return law
    names = model.coordinates
    drive = np.concatenate([wearer.drive(t) for t in trials])
    leant = np.sin(np.concatenate([_inclined(model, t.q) for t in trials]))
    for i, joint in enumerate(names.device):
        above = links_above(model, joint)
        own = [
            k for k, j in enumerate(names.device) if _link(model, j) in above
        ]
        A = np.hstack([leant[:, own], np.ones((len(leant), 1))])
        found, *_ = np.linalg.lstsq(A, drive[:, i], rcond=None)
        left = drive[:, i] - A @ found
        if np.std(left) <= _EXPLAINED * noise_nm < np.std(drive[:, i]):
            law[joint] = np.zeros(len(names.device))
            law[joint][own] = found[:-1]
    return law


def _link(model: Model, joint: str) -> str:
    return model.tree.joints[joint][1]


def _turning(model: Model) -> np.ndarray:
    """Turn of the device's links by its joint angles (m, m), root level."""
    names = model.coordinates
    return np.array(
        [
            model.tree.turning(_link(model, joint))[names.device_columns]
            for joint in names.device
        ]
    )


def _inclined(model: Model, q: np.ndarray) -> np.ndarray:
    """Inclination (n, m) of the device's links [rad], from its joint angles."""
    return q[:, model.coordinates.device_columns] @ _turning(model).T


def _found(contact: ContactModel | None, error: str, joints) -> np.ndarray:
    """Calibrated size (m,) of an error at each joint; 0 if not estimated."""
    known = None if contact is None else contact.posterior
    names = () if known is None else known.names
    return np.array(
        [
            known.of([name])[0][0] if name in names else 0.0
            for name in (f"{error}.{joint}" for joint in joints)
        ]
    )


def _device_angles(trial: Trial, contact: ContactModel | None) -> np.ndarray:
    """True angles (n, m) of the device's joints [rad].

    Recorded ones less the encoders' offsets. Angles of a solution have none,
    nor those taken from the person where there are no encoders.
    """
    names = trial.coordinates
    if trial.source in ("solved", "not solved") or not has_encoders(trial):
        return trial.q[:, names.device_columns]
    off = _found(contact, "encoder", names.device)
    return trial.q[:, names.device_columns] - off


def _is_modelled(trial: Trial) -> bool:
    """Whether a trial's device moments are from the study's device model."""
    source = trial.provenance.get("moments", {}).get("exoskeleton", "")
    return "device model" in source


def assisted(
    trial: Trial,
    design: Design,
    contact: ContactModel | None = None,
    passive: np.ndarray | float = 0.0,
) -> Trial:
    """A trial with the device's torques as a design changes them.

    Torques are taken at the trial's own angles and rates, although other cuffs
    would change those. Factors over the movement span the whole trial. The
    person's moments are less by what the device's are more. Forces of cuffs
    that are left out are dropped.

    Args:
        trial: measured; moments are totals of drive, friction and springs.
        design: acts on the drives, at the true angles of their joints.
        contact: its posterior gives the encoders' offsets.
        passive: see `Wearer.passive`.
    """
    trial = _without(trial, design.removed)
    if trial.moments is None or not design.given:
        return trial
    names = trial.coordinates
    share = trial.times / trial.duration
    drive = trial.device_moments - passive
    angles = _device_angles(trial, contact)
    torques = design.torques(
        names.device, drive, angles, trial.v[:, names.device_columns], share
    )
    return with_more(trial, torques - drive)


def with_more(trial: Trial, torques: np.ndarray) -> Trial:
    """A trial with `torques` (n, m) [N m] moved from person to device."""
    change = shared_moments(trial.coordinates, torques)
    return replace(trial, moments=trial.moments + change)


@dataclass(frozen=True)
class Wearer:
    """Somebody who wears the design.

    Attributes:
        name: unique.
        model: subject and device.
        contact: calibrated, with today's cuffs; or those of a design (`on`).
        trials: recorded; or own movements on these cuffs (`OwnMovement`).
        is_drawn: whether drawn from a posterior or of another size: a limit
            exceeded today is then raised to today's value.
        differ: cuff -> ratio of its force as mats show it today to the model's;
            1 if not measured.
        device: as the study file describes it: friction and springs of its
            joints.
        slid: cuff -> ratio of its migration today by encoders and markers to
            the model's; 1 if not measured.
        law: how its drives follow posture, see `posture_law`.
    """

    name: str
    model: Model
    contact: ContactModel
    trials: tuple[Trial, ...]
    is_drawn: bool = False
    differ: Mapping[str, float] = field(default_factory=dict)
    device: Device | None = None
    slid: Mapping[str, float] = field(default_factory=dict)
    law: Mapping[str, np.ndarray] = field(default_factory=dict)

    def on(self, design: Design) -> Wearer:
        """The same person on a design; trials without cuffs that it leaves out.

        Raises:
            InputError: nothing is left to hold the device.
        """
        design.check(self.model)
        if design == Design():
            return self
        return replace(
            self,
            model=design.model(self.model),
            contact=design.contact(self.contact),
            trials=tuple(_without(t, design.removed) for t in self.trials),
        )

    def shown(self, cuff: str) -> float:
        """Factor on the model's force of a cuff for what mats would show."""
        return self.differ.get(cuff, 1.0)

    def slides(self, cuff: str) -> float:
        """Factor on the model's migration for what encoders would tell."""
        return self.slid.get(cuff, 1.0)

    def passive(self, trial: Trial) -> np.ndarray:
        """Torques of friction and springs at the device's joints (n, m) [N m].

        Friction is as identified on a bench, corrected by the error that the
        calibration found in it; springs are at true angles. Zero without
        `device`. Of a trial, measured or solved, angles and rates are used.
        """
        names, tree = trial.coordinates, self.model.tree
        if self.device is None:
            return np.zeros((len(trial.times), len(names.device)))
        share = 1.0 - _found(self.contact, "friction", names.device)
        friction = friction_moments(self.device, tree, trial.v)
        # Moments by the study's device model are those at the recorded angles.
        known = None if _is_modelled(trial) else self.contact
        q = trial.q.copy()
        q[:, names.device_columns] = _device_angles(trial, known)
        springs = spring_moments(self.device, tree, q)
        return np.maximum(share, 0.0) * friction + springs

    @property
    def springs(self) -> np.ndarray:
        """Stiffness across the device's joints (m,) [N m/rad]."""
        return spring_stiffness(self.device, self.model.coordinates)

    def drive(self, trial: Trial) -> np.ndarray:
        """Torques of the drives (n, m) in a trial [N m].

        Zero if the torques are from the model of a device that does not carry
        itself: its springs and rotors are not drives.
        """
        given = trial.device_moments
        by_model = self.device is not None and _is_modelled(trial)
        if by_model and not self.device.carries_itself:
            return np.zeros(given.shape)
        return given - self.passive(trial)

    def largest_force(self, cuff: str) -> np.ndarray:
        """Largest tangential, normal force, moment (3,) of a cuff [N, N m]."""
        forces = [np.abs(t.cuffs[cuff].components) for t in self.trials]
        return np.concatenate(forces).max(axis=0)

    def largest_rate(self, cuff: str) -> float:
        """Largest rate of its normal force, sample to sample [N/s]."""
        rises = [
            np.diff(t.cuffs[cuff].normal) / np.diff(t.times)
            for t in self.trials
        ]
        return float(np.abs(np.concatenate(rises)).max())

    def mean_force(self, cuff: str) -> float:
        """Mean size of its normal force, over time and then trials [N]."""
        means = [
            np.trapezoid(np.abs(t.cuffs[cuff].normal), t.times) / t.duration
            for t in self.trials
        ]
        return float(np.mean(means))

    def largest_deflection(self, cuff: str) -> np.ndarray:
        """Its largest deflection (3,) [m, m, rad]."""
        own = self.contact.bushings[cuff]
        geometry = BushingKinematics(self.model.tree, cuff, own.preload)
        return geometry.largest(self.trials, own.origin)

    @property
    def largest_moments(self) -> np.ndarray:
        """Largest moment of each of the person's joints (m,) [N m]."""
        human = ~self.model.coordinates.is_device_joint
        moments = [np.abs(t.moments[:, human]) for t in self.trials]
        return np.concatenate(moments).max(axis=0)

    def slope(self, q: np.ndarray) -> np.ndarray:
        """Slope of the drives' torques by the device's angles, by `law`.

        Args:
            q: (n, nq).

        Returns:
            (n, m, m) [N m/rad].
        """
        turning, joints = _turning(self.model), self.model.coordinates.device
        rows = [self.law.get(j, np.zeros(len(joints))) for j in joints]
        lean = np.cos(_inclined(self.model, q))
        return np.einsum("ik,nk,kj->nij", np.array(rows), lean, turning)


def answer(trial: Trial, wearer: Wearer, own: Trial, design: Design) -> Answer:
    """How torques of drives and springs change with the device's motion.

    Args:
        trial: measured, today.
        wearer: `law` of the drives, and `device` with its springs.
        own: the own movement on today's cuffs, along which drives give the
            measured torque; springs give theirs along `trial`.
        design: changes the drives, see `assisted`; springs are not changed.
    """
    drives = drives_answer(trial, wearer, own, design)
    springs = springs_answer(trial.sample(own.times), wearer.device)
    if springs is None:
        return drives
    return replace(
        springs,
        slope=drives.slope + springs.slope,
        there=drives.there + springs.there,
    )


def drives_answer(
    trial: Trial, wearer: Wearer, own: Trial, design: Design
) -> Answer:
    """How drive torques on a design change with motion, see `answer`."""
    names = trial.coordinates
    at = trial.sample(own.times)
    angles = _device_angles(at, wearer.contact)
    rates, share = at.v[:, names.device_columns], at.times / trial.duration
    given, none = (
        design.torques(names.device, today, angles, rates, share)
        for today in (np.ones(angles.shape), np.zeros(angles.shape))
    )
    slope = wearer.slope(own.q)
    slope *= (given - none)[:, :, None]
    there = np.einsum("nij,nj->ni", slope, own.q[:, names.device_columns])
    return Answer(own.times, slope, there, np.zeros(slope.shape[1]))


def springs_answer(trial: Trial, device: Device | None) -> Answer | None:
    """How springs' torques change with motion, see `answer`; None without any.

    Args:
        trial: measured; torques are as measured along it.
        device: as the study file describes it.
    """
    springs = spring_stiffness(device, trial.coordinates)
    if not springs.any():
        return None
    slope = np.tile(np.diag(-springs), (len(trial.times), 1, 1))
    there = -springs * trial.q[:, trial.coordinates.device_columns]
    # Then the torques belong to just these angles: errors of encoders cancel.
    exact = _is_modelled(trial) or not has_encoders(trial)
    return Answer(
        trial.times, slope, there, 0.0 * springs if exact else springs
    )


def _without(trial: Trial, removed: Sequence[str]) -> Trial:
    if not removed:
        return trial
    left = {c: force for c, force in trial.cuffs.items() if c not in removed}
    return replace(trial, cuffs=left)


class Hold(NamedTuple):
    """How well a device is held.

    Attributes:
        stiffness: least curvature of the energy by the device's joint angles
            (least eigenvalue), over all postures [N m/rad].
        joint: the joint that turns most in that direction.
    """

    stiffness: float
    joint: str

    def __str__(self) -> str:
        return (
            f"at {self.joint} the cuffs are {-self.stiffness:.1f} N m/rad too "
            "soft to hold its weight"
        )


def hold(wearer: Wearer) -> Hold:
    """Least stiffness that holds the device on a wearer who keeps still.

    In the postures of the wearer's trials.
    """
    tree, names = wearer.model.tree, wearer.model.coordinates
    device = names.device_columns
    cuffs = [
        (BushingKinematics(tree, cuff, b.preload), b)
        for cuff, b in wearer.contact.bushings.items()
    ]

    def slope(q: np.ndarray) -> np.ndarray:
        """Energy's slope by the device's joints (n, m) at q (n, nq)."""
        rest = np.zeros_like(q)
        found = tree.inverse_dynamics(q, rest, rest)
        for kinematics, bushing in cuffs:
            places = np.broadcast_to(bushing.origin, (len(q), 2))
            terms = kinematics.terms(q, places)
            d = kinematics.deflection(q, terms)
            found += np.einsum(
                "nc,ncq->nq",
                kinematics.force(d, bushing),
                kinematics.deflection_jacobian(terms),
            )
        return found[:, device]

    q = np.concatenate([t.q for t in wearer.trials])
    curvature = np.empty((len(q), len(device), len(device)))
    for i, column in enumerate(device):
        step = np.zeros(q.shape[1])
        step[column] = _STEP_RAD
        change = slope(q + step) - slope(q - step)
        curvature[:, :, i] = change / (2.0 * _STEP_RAD)
    # Symmetric but for errors of differences, also where a cuff slips.
    curvature = 0.5 * (curvature + curvature.transpose(0, 2, 1))
    curvature += wearer.springs * np.eye(len(device))
    least, modes = np.linalg.eigh(curvature)
    worst = int(np.argmin(least[:, 0]))
    joint = names.device[int(np.argmax(np.abs(modes[worst, :, 0])))]
    return Hold(float(least[worst, 0]), joint)


def check_population(wearer: Wearer) -> None:
    """Refuse a wearer who cannot be scaled to a population's bodies.

    Raises:
        InputError: the device does not adjust to a body, or the person's model
            has two legs, or a trial has a chair or a load.
    """
    assembly = wearer.model.assembly
    if not assembly.is_fitted or assembly.human.sides:
        raise InputError(
            "design.population: needs the shipped device, which adjusts to a "
            "body, and a person whose one leg stands for both; leave it out"
        )
    loaded = [t.name for t in wearer.trials if t.borne()]
    if loaded:
        raise InputError(
            f"design.population: trial {loaded[0]} has a chair or a load, and "
            "it is not known how another body would bear it; leave "
            "design.population out"
        )


def check_wearers(wearers: Sequence[Wearer], settings: DesignSettings) -> None:
    """Refuse wearers that no design can be made for.

    Raises:
        InputError: see DesignProblem.
    """
    if not wearers:
        raise InputError("there are no wearers; give at least one calibration")
    first = wearers[0].model
    for cuff in settings.cuffs:
        if cuff not in named_so(first.cuffs):
            raise InputError(
                f"design.cuffs.{cuff}: the model has no such cuff; it has "
                f"{', '.join(first.cuffs) or 'none'}"
            )
    for joint in settings.joints:
        if joint not in movable(first):
            raise InputError(
                f"design.joints.{joint}: a design moves no such joint of the "
                f"device; it moves {', '.join(movable(first)) or 'none'}"
            )
    for joint in settings.limits.drives:
        if joint not in first.coordinates.device:
            raise InputError(
                f"design.limits.drives.{joint}: the device has no such joint; "
                f"it has {', '.join(first.coordinates.device)}"
            )
    for wearer in wearers:
        for what, own, usual in (
            ("cuffs", wearer.model.cuffs, first.cuffs),
            (
                "joints",
                wearer.model.coordinates.device,
                first.coordinates.device,
            ),
        ):
            if list(own) != list(usual):
                raise InputError(
                    f"the device of {wearer.name} has the {what} "
                    f"{', '.join(own)}, but that of {wearers[0].name} has "
                    f"{', '.join(usual)}; design for wearers of one device"
                )
        for cuff, bushing in wearer.contact.bushings.items():
            if min(bushing.stiffness) <= 0.0:
                raise InputError(
                    f"{wearer.name}: a spring of the {cuff} cuff has no "
                    "stiffness, so nothing is known of the tissue under it; "
                    "design from a calibration without a slide or hinge there"
                )
        for trial in wearer.trials:
            if trial.moments is None:
                raise InputError(
                    f"trial {trial.name}: the device's torques are not "
                    "known; give exo_moments or device in the study"
                )


def drawn(wearer: Wearer, count: int, seed: int = 0) -> list[Wearer]:
    """Wearers with cuff parameters drawn from the calibration's posterior.

    Stiffness and slip are log-normal, so that they stay positive.

    Args:
        wearer: as calibrated.
        count: number of draws.
        seed: seed of the random numbers.

    Returns:
        The drawn wearers; an empty list without a posterior.
    """
    known = wearer.contact.posterior
    if known is None or not count:
        return []
    values = wearer.contact.values()
    names = [
        n
        for n in known.names
        if n in values and n.partition(".")[0] in wearer.contact.bushings
    ]
    middle, covariance = known.of(names)
    log = np.array([n.endswith(("_stiffness", "slip")) for n in names])
    unit = np.where(log, middle, 1.0)
    root = np.linalg.cholesky(
        covariance / np.outer(unit, unit) + 1e-12 * np.eye(len(names))
    )
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        change = root @ rng.standard_normal(len(names))
        new = np.where(
            log, middle * np.exp(np.clip(change, -2.0, 2.0)), middle + change
        )
        contact = wearer.contact.with_values(dict(zip(names, new, strict=True)))
        found.append(
            replace(
                wearer,
                name=f"{wearer.name} draw {k + 1}",
                contact=contact,
                is_drawn=True,
            )
        )
    return found


@dataclass(frozen=True)
class Size:
    """Size of a body relative to that of a calibrated person.

    Attributes:
        name: name of the size.
        height, mass: ratios to that person's.
    """

    name: str
    height: float
    mass: float

    def human(self, human: HumanParameters) -> HumanParameters:
        """The person's body with all lengths and masses scaled."""
        parts = {
            name: replace(
                part,
                mass_kg=self.mass * part.mass_kg,
                com_m=self._point(part.com_m),
                inertia_kg_m2=self.mass * self.height**2 * part.inertia_kg_m2,
                length_m=self.height * part.length_m,
            )
            for name in (*SEGMENTS, "toes")
            if (part := getattr(human, name)) is not None
        }
        places = ("heel_m", "toe_m", "ball_m", *(f"{c}_cuff_m" for c in CUFFED))
        points = {
            name: self._point(point)
            for name in places
            if (point := getattr(human, name)) is not None
        }
        ankle = self.height * human.ankle_height_m
        return replace(human, **parts, **points, ankle_height_m=ankle)

    def _point(self, point: tuple[float, float]) -> tuple[float, float]:
        x, z = point
        return self.height * x, self.height * z

    def contact(self, contact: ContactModel, ankle_m: float) -> ContactModel:
        """The person's contact with cuffs and spheres moved to fit this body.

        Tissue is as stiff as the calibrated person's; spheres' stiffness grows
        with the mass. There is no posterior: its uncertainty is not known.

        Args:
            contact: the person's.
            ankle_m: height of the person's ankle above the sole.
        """
        spheres = {
            name: replace(
                sphere,
                stiffness=self.mass ** _POWER[contact.ground.law]
                * sphere.stiffness,
                x=self.height * sphere.x,
                z=sphere.z - (self.height - 1.0) * ankle_m,
            )
            for name, sphere in contact.ground.spheres.items()
        }
        bushings = {
            name: replace(
                cuff,
                origin_x=self.height * cuff.origin_x,
                origin_z=self.height * cuff.origin_z,
            )
            for name, cuff in contact.bushings.items()
        }
        ground = replace(contact.ground, spheres=spheres)
        return replace(
            contact, ground=ground, bushings=bushings, posterior=None
        )

    def trial(self, trial: Trial, model: Model, ankle_m: float) -> Trial:
        """The person's movement by this body, in the same time.

        Joint angles are the same; ground reaction and moments follow from the
        equations of motion; the device's moments scale with mass and height.

        Args:
            trial: the person's.
            model: this body's.
            ankle_m: height of the person's ankle above the sole.
        """
        names = trial.coordinates
        q, v, a = trial.q.copy(), trial.v.copy(), trial.a.copy()
        x, z, _ = names.root_columns
        for part in (q, v, a):
            part[:, x] *= self.height
        q[:, z] += (self.height - 1.0) * ankle_m
        forces = model.tree.inverse_dynamics(q, v, a)
        moments = forces[:, names.joint_columns]
        given = self.mass * self.height * trial.device_moments
        device = names.is_device_joint
        moments = moments + shared_moments(names, given - moments[:, device])
        return replace(
            trial,
            q=q,
            v=v,
            a=a,
            ground=PlanarWrench.of(model.tree.ground_reaction(q, forces)),
            moments=moments,
            cuffs={},
            mass_kg=model.human.mass_kg,
        )


def sized(
    wearer: Wearer, population: Population, settings: PredictionSettings
) -> list[Wearer]:
    """Wearers with bodies of a population, who move as a calibrated person.

    Args:
        wearer: as calibrated, see `check_population`.
        population: gives percentiles of height and mass.
        settings: noise and grid of their own movements.

    Raises:
        InputError: a body's movement cannot be solved.
    """
    model = wearer.model
    human, found = model.human, []
    ankle = human.ankle_height_m
    settings = replace(settings, errors=NO_ERRORS)
    for name, height, mass in population.bodies():
        size = Size(name, height / human.height_m, mass / human.mass_kg)
        body = size.human(human)
        device = refitted(model.exoskeleton, human, body)
        own = replace(model, human=body, exoskeleton=device)
        contact = size.contact(wearer.contact, ankle)
        trials = [size.trial(t, own, ankle) for t in wearer.trials]
        moved = solved(
            OwnMovement(own, trials, contact, settings),
            f"design.population: {size.name} cannot make the movements of "
            f"{wearer.name}; choose percentiles nearer to 50",
        )
        found.append(
            replace(
                wearer,
                name=f"{wearer.name}, {size.name}",
                model=own,
                contact=contact,
                trials=tuple(moved.trials),
                is_drawn=True,
                law={
                    joint: size.mass * size.height * by
                    for joint, by in wearer.law.items()
                },
            )
        )
    return found
