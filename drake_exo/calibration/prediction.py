"""Phase C: predict movement and interaction of trials not seen before.

Serrancoli et al., II-C: only the initial and final states are given. C1
tracks ground reaction, centre of pressure and joint torques and minimises the
contact energy of all components; C2 does so with the bushings' stiffness and
damping scaled. The objective "comfort" tracks nothing: it minimises the
interaction with bounded effort, for designs that were never measured.
"""

from dataclasses import replace

import numpy as np
from pydrake.systems.framework import System

from drake_exo.calibration.interaction import CoupledProblem, torque_terms
from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import fix_ends, ground_terms
from drake_exo.collocation.loads import ControllerKernel
from drake_exo.collocation.trial_program import Movement, minimised

_EXO = slice(6, 9)  # coordinates of the exoskeleton


class PredictionProblem(CoupledProblem):
    """Phase C posed; `settings` are PredictionSettings.

    Args:
        controller: gives the exoskeleton's torques; None where they are
            measured (tracked) or free.
        trials: their kinematics serve for the end states and duration, and
            are compared with, not tracked.

    Further arguments as CoupledProblem; parameters are held fixed.
    """

    def __init__(
        self,
        tree,
        trials,
        parameters,
        settings,
        *,
        controller: System | None = None,
        **model,
    ):
        self._controller = (
            None if controller is None else ControllerKernel(controller)
        )
        fixed = [replace(p, free=False) for p in parameters]
        super().__init__(tree, trials, fixed, settings, **model)

    def _add(self, trial: MeasuredMovement) -> Movement:
        movement = self._movement(trial)
        at = trial.sample(movement.grid.times)
        settings = self.settings
        noise = settings.noise
        fix_ends(movement, at, settings.end_tolerance)
        limit = np.full(movement.torque.shape, settings.torque_limit_nm)
        movement.bound(movement.torque.ravel(), -limit.ravel(), limit.ravel())
        if settings.objective == "tracking":
            terms = [
                *ground_terms(movement, at, noise),
                *torque_terms(movement, at, noise),
            ]
        else:
            terms = [minimised(movement.torque, noise.torque_nm)]
        movement.track(terms)
        movement.damp_jerk(noise.jerk)
        self.minimise_energy(movement, [[0, 1, 2]] * 3, noise.energy_j)
        if self._controller is not None:
            self._drive(movement)
        return movement

    def _drive(self, movement: Movement) -> None:
        """Tie the exoskeleton's torques to the controller."""
        grid = movement.grid
        self.program.add_constraints(
            f"{movement.name} controller",
            self._controller,
            np.hstack(
                [grid.q[:, _EXO], grid.v[:, _EXO], movement.torque[:, 3:]]
            ),
            data=grid.times[:, None],
        )

    def _start(self, movement, trial) -> MeasuredMovement:
        if self.settings.guess == "data":
            return super()._start(movement, trial)
        return straight_line(trial, movement.grid.times)


def straight_line(
    trial: MeasuredMovement, times: np.ndarray
) -> MeasuredMovement:
    """Minimum-jerk line between a trial's end states, without its data.

    Args:
        trial: first and last positions are used.
        times: (n,) [s].
    """
    start, end = trial.q[0], trial.q[-1]
    T = times[-1]
    s = (times / T)[:, None]
    p = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    dp = 30.0 * s**2 * (1.0 - s) ** 2 / T
    ddp = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / T**2
    change = end - start
    return MeasuredMovement(
        trial.name,
        times,
        start + p * change,
        dp * change,
        ddp * change,
        np.zeros((len(times), 3)),
    )
