"""Phase B: calibrate the human-exoskeleton contact, three trials at once.

Serrancoli et al., II-C: as Phase A, with the foot-ground contact fixed; the
bushings' forces are further controls, tied to their law. Joint moments and
the normal forces that mats measured are tracked, the contact energy of all
other components is minimised.
"""

import numpy as np

from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import (
    PhaseProblem,
    chair_wrench,
    fix_ends,
    ground_terms,
    kinematic_terms,
    needed_ground,
)
from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.collocation.bushing_kernels import (
    BUSHING_PARAMETERS,
    BUSHINGS,
    NORMAL,
    Bushing,
    BushingKernel,
    EnergyKernel,
)
from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.collocation.trial_program import (
    Movement,
    Tracking,
    add_parameters,
    minimised,
)
from drake_exo.contact.parameters import ContactParameter
from drake_exo.model.planar_tree import PlanarTree

_NUM = len(BUSHING_PARAMETERS)


class CoupledProblem(PhaseProblem):
    """Phases B and C: human and exoskeleton coupled by three bushings.

    A model of the human alone has none; then nothing else is different.

    Args:
        tree: the model.
        trials: measured movements.
        parameters: of the bushings, BUSHING_PARAMETERS for each.
        settings: of the phase.
        damping: segment -> tangential, normal [N s/m] and rotational
            [N m s/rad] damping.
        foot: settings of Phase A: the law.
        foot_values: calibrated parameters of the spheres, fixed here.
        scale: multiplies stiffness and damping (Phase C2).
        preload: segment -> (x, z, angle) of the exoskeleton's frame.

    Attributes:
        segments: names of the segments that have a bushing.
    """

    prior_weight = 0.0

    def __init__(
        self,
        tree: PlanarTree,
        trials: list[MeasuredMovement],
        parameters: list[ContactParameter],
        settings,
        *,
        damping: dict[str, tuple[float, float, float]],
        foot: FootGroundSettings,
        foot_values: np.ndarray,
        scale: float = 1.0,
        preload: dict[str, tuple] | None = None,
    ):
        self.preload = preload or {}
        self.damping = damping
        self.scale = scale
        self.segments = BUSHINGS if tree.num_positions == 9 else ()
        self.foot = foot
        self.kernel = FootGroundKernel(foot.law, foot.law_constants())
        self.foot_values = np.asarray(foot_values, float)
        self.bushings = [
            Bushing(tree, name, self.preload.get(name, (0.0, 0.0, 0.0)))
            for name in self.segments
        ]
        self.laws = [
            BushingKernel(b, damping[name], scale)
            for name, b in zip(self.segments, self.bushings, strict=True)
        ]
        super().__init__(tree, trials, parameters, settings)

    def contact_values(self, values):
        """See PhaseProblem."""
        return self.foot_values, values.reshape(-1, _NUM)

    def _add_parameters(self):
        self.parameter_variables = add_parameters(
            self.program, self.parameters, self.prior_weight
        )
        fixed = [
            ContactParameter(f"foot[{i}]", "", v, v - 1.0, v + 1.0, False)
            for i, v in enumerate(self.foot_values)
        ]
        self._foot_variables = add_parameters(self.program, fixed, 0.0)

    def _movement(self, trial: MeasuredMovement) -> Movement:
        """Variables, dynamics and contact of a trial, without its cost."""
        table = self.parameter_variables.reshape(-1, _NUM)
        movement = Movement(
            self.program,
            trial.name,
            self.tree,
            trial.duration,
            self._solver.nodes_per_second,
            self._solver.transcription,
            self.bushings,
            table[:, :2].ravel(),
            chair_wrench(self.tree, trial),
        )
        movement.stand_on(self.kernel, self._foot_variables)
        for i, law in enumerate(self.laws):
            movement.strap(i, law, table[i])
        return movement

    def minimise_energy(self, movement, components, sigma) -> None:
        """Add the squared contact energy of components as a cost.

        Args:
            movement: the trial.
            components: for each bushing, indices of its components.
            sigma: typical energy [J].
        """
        grid = movement.grid
        n = len(grid.times)
        table = self.parameter_variables.reshape(-1, _NUM)
        # The integral's weights belong inside the square.
        used = grid.quadrature > 0.0
        for b, chosen in enumerate(components[: len(self.bushings)]):
            if not chosen:
                continue
            kernel = _Weighted(
                EnergyKernel(self.bushings[b], chosen, sigma, self.scale)
            )
            variables = np.hstack(
                [grid.q, np.broadcast_to(table[b], (n, _NUM))]
            )
            self.program.add_residuals(
                f"{movement.name} energy {BUSHINGS[b]}",
                kernel,
                variables[used],
                np.sqrt(grid.quadrature[used])[:, None],
            )

    def guess(self, values: np.ndarray | None = None) -> np.ndarray:
        """Near the data, with the foot settled and the cuffs as they lie."""
        if values is None:
            values = np.array([p.nominal for p in self.parameters])
        x = np.zeros(self.program.prog.num_vars())
        x[self.program.indices(self.parameter_variables)] = values
        x[self.program.indices(self._foot_variables)] = self.foot_values
        for movement, trial in zip(self.movements, self.trials, strict=True):
            at = self._start(movement, trial)
            self._fill(x, movement, at, values.reshape(-1, _NUM))
        return x

    def _start(self, movement, trial) -> MeasuredMovement:
        """Motion that the guess follows."""
        return trial.sample(movement.grid.times)

    def _fill(self, x, movement, at, values):
        grid = movement.grid
        q, v = at.q.copy(), at.v.copy()
        a, ground = at.a.copy(), at.ground
        if not ground.any():  # not measured
            forces = self.tree.inverse_dynamics(q, v, a)
            forces -= movement.applied(q)
            ground = needed_ground(q, forces)
        q[:, :3], v[:, :3] = settle_foot(
            self.kernel, self.foot_values, grid.times, at.q[:, :3], ground
        )
        a[:, :3] = np.gradient(v[:, :3], grid.times, axis=0)
        forces = self.tree.inverse_dynamics(q, v, a)
        forces -= movement.applied(q)
        interaction = np.zeros((len(q), 3 * len(self.bushings)))
        for b, bushing in enumerate(self.bushings):
            origin = np.broadcast_to(values[b, :2], (len(q), 2))
            terms = bushing.terms(q, origin)
            J = bushing.deflection_jacobian(terms)
            d = bushing.deflection(q, terms)
            force = self.scale * values[b, 2:] * d
            interaction[:, 3 * b : 3 * b + 3] = force
            forces += np.einsum("nc,ncq->nq", force, J)
        filled = [
            (grid.q, q),
            (grid.v, v),
            (grid.a, a),
            (movement.torque, forces[:, 3:]),
            (movement.ground, ground),
        ]
        if self.bushings:
            filled.append((movement.interaction, interaction))
        for variables, numbers in filled:
            x[self.program.indices(variables)] = numbers


class InteractionProblem(CoupledProblem):
    """Phase B posed; `settings` are InteractionSettings."""

    @property
    def prior_weight(self) -> float:
        """Of the parameters' prior."""
        return self.settings.prior_weight

    def _add(self, trial: MeasuredMovement) -> Movement:
        movement = self._movement(trial)
        at = trial.sample(movement.grid.times)
        noise = self.settings.noise
        fix_ends(movement, at, self.settings.end_tolerance)
        movement.track(
            [
                *kinematic_terms(movement, at, noise),
                *ground_terms(movement, at, noise),
                *torque_terms(movement, at, noise),
                *normal_force_terms(movement, at, noise),
            ]
        )
        movement.damp_jerk(noise.jerk)
        unmeasured = [
            [
                c
                for c in range(3)
                if c != NORMAL or name not in trial.normal_force
            ]
            for name in BUSHINGS
        ]
        self.minimise_energy(movement, unmeasured, noise.energy_j)
        return movement


def torque_terms(movement, at, noise) -> list[Tracking]:
    """Joint moments tracked where known, minimised otherwise."""
    if at.moments is None:
        return [minimised(movement.torque, noise.torque_nm)]
    sigma = np.repeat([noise.moment_nm, noise.exo_moment_nm], 3)
    sigma = sigma[: movement.torque.shape[1]]
    return [Tracking(movement.torque, at.moments, sigma)]


def normal_force_terms(movement, at, noise) -> list[Tracking]:
    """Normal forces tracked where a mat measured them."""
    return [
        Tracking(
            movement.interaction[:, [3 * b + NORMAL]],
            at.normal_force[name][:, None],
            noise.normal_force_n,
        )
        for b, name in enumerate(BUSHINGS)
        if name in at.normal_force
    ]


class _Weighted:
    """A kernel times a weight for each instance, given as its data."""

    def __init__(self, kernel):
        self._kernel = kernel
        self.sparsity = kernel.sparsity

    def evaluate(self, x, data):
        """See Kernel."""
        return data * self._kernel.evaluate(x, None)

    def jacobian(self, x, data):
        """See Kernel."""
        return data[:, :, None] * self._kernel.jacobian(x, None)
