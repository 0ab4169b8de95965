"""Phase C: predict movement and interaction of trials not seen before.

Serrancoli et al., II-C: only the initial and final states are given. C1
tracks ground reaction, centre of pressure and joint torques and minimises the
contact energy of all components; C2 does so with the bushings' stiffness and
damping scaled (`ContactModel.scaled`). The objective "comfort" tracks nothing:
it minimises the interaction with bounded effort, for designs that were never
measured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pydrake.systems.framework import System

from drake_exo.calibration.error_model import ErrorModel
from drake_exo.calibration.interaction import EVERY
from drake_exo.calibration.problem import (
    PhaseProblem,
    ground_terms,
    kinematic_terms,
    torque_terms,
)
from drake_exo.calibration.settings import PredictionSettings
from drake_exo.collocation.initial_guess import straight_line
from drake_exo.collocation.kernels import SoleKernel
from drake_exo.collocation.loads import ControllerKernel
from drake_exo.collocation.trial_program import (
    Tracking,
    TrialProgram,
    minimised,
)
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.files.tables import runs
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model
from drake_exo.nlp.program import AffineKernel

# An end counts as a second of tracking does: noise of a signal is one size
# for about that long.
END_WEIGHT_S = 1.0
_TOES_RAD = np.deg2rad(3.0)
# How far joints turn where nothing else says so, as the American Academy of
# Orthopaedic Surgeons tells it; ankles bend further under load.
_RANGES_DEG = {
    "hip": (-30.0, 120.0),
    "knee": (0.0, 140.0),
    "ankle": (-50.0, 35.0),
    "toes": (-30.0, 70.0),
}


class PredictionProblem(PhaseProblem):
    """Phase C posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: their kinematics serve for the end states and duration, and
            are compared with, not tracked.
        contact: calibrated.
        settings: objective, noise, grid.
        controller: gives the exoskeleton's torques; None where they are
            measured (tracked) or free.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = PredictionProblem(made.model, made.trials, made.contact)
    >>> sorted(posed.bushings)
    ['pelvis', 'shank', 'thigh']

    Raises:
        InputError: the model has cuffs, but the contact knows nothing of
            them; or the controller is none that can be used.
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: PredictionSettings | None = None,
        *,
        controller: System | None = None,
        refined: Mapping[str, int] | None = None,
    ):
        if not set(model.cuffs) <= set(contact.bushings):
            raise InputError(
                "the calibration holds no interaction parameters; run "
                "'drake-exo calibrate' without --phase, or with --phase "
                "interaction"
            )
        self._controller = (
            None
            if controller is None
            else ControllerKernel(controller, len(model.coordinates.device))
        )
        settings = settings or PredictionSettings()
        # A human alone has no use for the cuffs of a calibration.
        own = {cuff: contact.bushings[cuff] for cuff in model.cuffs}
        contact = replace(contact, bushings=own)
        errors = ErrorModel(model, trials, settings.errors, contact.posterior)
        super().__init__(model, trials, contact, [], settings, errors, refined)

    def _add(self, trial: Trial) -> TrialProgram:
        if self.settings.ends == "periodic":
            return self._step(trial)
        movement, at, effects = self._begin(trial)
        settings, noise = self.settings, self.settings.noise
        if effects is not None or len(self.feet) > 1:
            # Where feet and joints are free, so are the ends between them.
            at_ends = np.zeros(len(at.times))
            at_ends[[0, -1]] = END_WEIGHT_S
            movement.add_tracking_cost(
                kinematic_terms(movement, at, noise, effects),
                self.error_variables,
                at_ends,
            )
        self._limit(movement)
        if settings.objective == "tracking":
            terms = [
                *ground_terms(movement, at, noise),
                *torque_terms(movement, at, noise, effects),
                *_held_toes(movement, at),
            ]
        else:
            terms = [
                minimised(movement.torque, noise.torque_nm),
                *_held_toes(movement, at),
            ]
        movement.add_tracking_cost(terms, self.error_variables)
        movement.add_jerk_cost(self.jerk)
        everything = dict.fromkeys(self.bushings, EVERY)
        self.minimise_energy(movement, everything, noise.energy_j)
        if self._controller is not None:
            self._drive(movement)
        return movement

    def _limit(self, movement: TrialProgram) -> None:
        limit = np.full(movement.torque.size, self.settings.torque_limit_nm)
        movement.bound(movement.torque.ravel(), -limit, limit)

    def _step(self, trial: Trial) -> TrialProgram:
        """A step that could go on for ever, with little effort.

        The other leg's step is its mirror image: half a cycle says it all.
        """
        movement = self._movement(trial)
        grid, names = movement.grid, movement.coordinates
        at = trial.sample(grid.times)
        x, *_ = names.root_columns
        mirrored = _mirrored(names)
        speed = self.settings.speed_m_s
        if speed is None:
            speed = (at.q[-1, x] - at.q[0, x]) / trial.duration
        ahead = np.zeros(len(names))
        ahead[x] = speed * trial.duration
        movement.bound(grid.q[0, [x]], at.q[0, [x]], at.q[0, [x]])
        # The root's accelerations follow from all else.
        for what, values, rows, gain in (
            ("positions", grid.q, slice(None), ahead),
            ("velocities", grid.v, slice(None), 0.0),
            ("accelerations", grid.a, names.joint_columns, 0.0),
        ):
            self.program.add_constraints(
                f"{movement.name} mirrored {what}",
                AffineKernel(np.hstack([np.eye(len(names)), -mirrored])[rows]),
                np.hstack([values[-1], values[0]])[None],
                gain,
                gain,
            )
        for side, wrench in at.feet.items():
            foot = f"foot_{side}"
            swings = _middle(~wrench.is_loaded)
            if not len(swings):
                continue
            kernel = SoleKernel(self.sphere_values(self.contact, foot))
            self.program.add_constraints(
                f"{movement.name} clearance of {foot}",
                kernel,
                movement.poses[foot][swings],
                self.settings.clearance_m,
                np.inf,
            )
        for name in names.human:
            lower, upper = np.deg2rad(_RANGES_DEG[name.split("_")[0]])
            q, own = grid.q[:, names.index(name)], at.coordinate(name)
            movement.bound(
                q,
                np.full(len(q), min(lower, own.min())),
                np.full(len(q), max(upper, own.max())),
            )
        self._limit(movement)
        effort = minimised(movement.torque, self.settings.noise.torque_nm)
        movement.add_tracking_cost([effort])
        movement.add_jerk_cost(self.jerk)
        return movement

    def _drive(self, movement: TrialProgram) -> None:
        """Tie the exoskeleton's torques to the controller."""
        grid, names = movement.grid, movement.coordinates
        device = names.device_columns
        torque = movement.torque[:, names.is_device_joint]
        self.program.add_constraints(
            f"{movement.name} controller",
            self._controller,
            np.hstack([grid.q[:, device], grid.v[:, device], torque]),
            data=grid.times[:, None],
        )

    def _start(self, movement: TrialProgram, trial: Trial) -> Trial:
        steps = len(self.feet) > 1
        if self.settings.guess == "line" and steps:
            raise InputError(
                "prediction.guess: a line between the ends is no start for "
                "legs that step; say data, or leave it out"
            )
        if steps or self.settings.guess == "data":
            return super()._start(movement, trial)
        return straight_line(trial, movement.grid.times)


def _mirrored(names: Coordinates) -> np.ndarray:
    """Matrix (nq, nq) that exchanges left and right.

    Raises:
        InputError: a coordinate has no other side.
    """
    other = {"left": "right", "right": "left"}
    found = np.zeros((len(names), len(names)))
    for i, name in enumerate(names.names):
        parts = [other.get(part, part) for part in name.split("_")]
        if i >= len(names.root) and parts == name.split("_"):
            raise InputError(
                f"prediction.ends: {name} is of both legs at once; a periodic "
                "step needs two, say human: {legs: two}"
            )
        found[i, names.index("_".join(parts))] = 1.0
    return found


def _middle(free: np.ndarray) -> np.ndarray:
    """The middle half of the longest run of nodes (n,) without load."""
    longest = max(runs(free), key=lambda r: r[1] - r[0], default=(0, 0))
    quarter = (longest[1] - longest[0]) // 4
    return np.arange(longest[0] + quarter, longest[1] - quarter)


def _held_toes(movement: TrialProgram, at: Trial) -> list[Tracking]:
    """Hinged toes near the line between their ends.

    They weigh next to nothing and how a plate's force is shared with them is
    not known: without this they would flutter.
    """
    toes = [n for n in at.coordinates.joints if n.startswith("toes")]
    if not toes:
        return []
    columns = at.coordinates.columns(toes)
    share = (at.times / at.times[-1])[:, None]
    line = (1.0 - share) * at.q[0, columns] + share * at.q[-1, columns]
    return [Tracking(movement.grid.q[:, columns], line, _TOES_RAD)]
