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
    Parts,
    PhaseProblem,
    ground_terms,
    kinematic_terms,
    torque_terms,
)
from drake_exo.calibration.settings import PredictionSettings
from drake_exo.collocation.initial_guess import straight_line
from drake_exo.collocation.kernels import ControllerKernel
from drake_exo.collocation.trial_program import (
    Tracking,
    TrialProgram,
    minimised,
)
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model

# An end counts as a second of tracking does: noise of a signal is one size
# for about that long.
END_WEIGHT_S = 1.0
_TOES_RAD = np.deg2rad(3.0)


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
        ValueError: the settings ask for other ends, see `PeriodicStep`.
    """

    ends = "measured"

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: PredictionSettings | None = None,
        *,
        controller: System | None = None,
        refined: Mapping[str, Parts] | None = None,
    ):
        settings = settings or PredictionSettings(ends=self.ends)
        if settings.ends != self.ends:
            raise ValueError(f"the settings ask for {settings.ends} ends")
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
        # A human alone has no use for the cuffs of a calibration.
        own = {cuff: contact.bushings[cuff] for cuff in model.cuffs}
        contact = replace(contact, bushings=own)
        errors = ErrorModel(model, trials, settings.errors, contact.posterior)
        super().__init__(model, trials, contact, [], settings, errors, refined)

    def _terms(self, movement, at, effects):
        noise, toes = self.settings.noise, _held_toes(movement, at)
        if self.settings.objective == "comfort":
            return [minimised(movement.torque, noise.torque_nm), *toes]
        return [
            *ground_terms(movement, at, noise),
            *torque_terms(movement, at, noise, effects),
            *toes,
        ]

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        super()._hold_ends(movement, at)
        effects = self._effects(at)
        if effects is None and len(self.feet) == 1:
            return
        # Where feet and joints are free, so are the ends between them.
        at_ends = np.zeros(len(at.times))
        at_ends[[0, -1]] = END_WEIGHT_S
        movement.add_tracking_cost(
            kinematic_terms(movement, at, self.settings.noise, effects),
            self.error_variables,
            at_ends,
        )

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        self._limit(movement)
        everything = dict.fromkeys(self.bushings, EVERY)
        self.minimise_energy(movement, everything, self.settings.noise.energy_j)
        if self._controller is not None:
            self._drive(movement)
        return movement

    def _limit(self, movement: TrialProgram) -> None:
        limit = np.full(movement.torque.size, self.settings.torque_limit_nm)
        movement.bound(movement.torque.ravel(), -limit, limit)

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
