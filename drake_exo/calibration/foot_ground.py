"""Phase A: calibrate the foot-ground contact from several trials at once.

Serrancoli et al., II-C: kinematics, ground reaction and centre of pressure
are tracked, joint torques minimised; the spheres' parameters are shared by
all trials; initial and final states are given; human and exoskeleton do not
touch.
"""

import numpy as np

from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import (
    PhaseProblem,
    chair_wrench,
    fix_ends,
    ground_terms,
    kinematic_terms,
)
from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.collocation.trial_program import (
    Movement,
    add_parameters,
    minimised,
)


class FootGroundProblem(PhaseProblem):
    """Phase A posed; `settings` are FootGroundSettings."""

    @property
    def foot(self):
        """Settings of this phase."""
        return self.settings

    def contact_values(self, values):
        """See PhaseProblem."""
        return values, np.zeros((0, 5))

    def _add_parameters(self):
        settings = self.settings
        self.kernel = FootGroundKernel(settings.law, settings.law_constants())
        self.parameter_variables = add_parameters(
            self.program, self.parameters, settings.prior_weight
        )

    def _add(self, trial: MeasuredMovement) -> Movement:
        movement = Movement(
            self.program,
            trial.name,
            self.tree,
            trial.duration,
            self._solver.nodes_per_second,
            self._solver.transcription,
            chair=chair_wrench(self.tree, trial),
        )
        movement.stand_on(self.kernel, self.parameter_variables)
        at = trial.sample(movement.grid.times)
        noise = self.settings.noise
        fix_ends(movement, at, self.settings.end_tolerance)
        movement.track(
            [
                *kinematic_terms(movement, at, noise),
                *ground_terms(movement, at, noise),
                minimised(movement.torque, noise.torque_nm),
            ]
        )
        movement.damp_jerk(noise.jerk)
        return movement

    def guess(self, values: np.ndarray | None = None) -> np.ndarray:
        """Program variables near the data, with the foot settled.

        Args:
            values: contact parameters; nominal ones by default.
        """
        if values is None:
            values = np.array([p.nominal for p in self.parameters])
        x = np.zeros(self.program.prog.num_vars())
        x[self.program.indices(self.parameter_variables)] = values
        for movement, trial in zip(self.movements, self.trials, strict=True):
            grid = movement.grid
            at = trial.sample(grid.times)
            q, v = at.q.copy(), at.v.copy()
            q[:, :3], v[:, :3] = settle_foot(
                self.kernel, values, grid.times, at.q[:, :3], at.ground
            )
            a = at.a.copy()
            a[:, :3] = np.gradient(v[:, :3], grid.times, axis=0)
            forces = self.tree.inverse_dynamics(q, v, a)
            forces -= movement.applied(q)
            for variables, numbers in (
                (grid.q, q),
                (grid.v, v),
                (grid.a, a),
                (movement.torque, forces[:, 3:]),
                (movement.ground, at.ground),
            ):
                x[self.program.indices(variables)] = numbers
        return x
