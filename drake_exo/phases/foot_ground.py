"""Phase A: calibrate the foot-ground contact from several trials at once.

Serrancoli et al., II-C: kinematics, ground reaction and centre of pressure
are tracked, joint torques minimised; the spheres' parameters are shared by
all trials; initial and final states are given; human and exoskeleton do not
touch.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drake_exo.nlp import drake_ipopt, ipopt, preflight
from drake_exo.nlp.batch import BatchedProgram
from drake_exo.nlp.ipopt import Iterate
from drake_exo.nlp.solution import Solution
from drake_exo.nlp.sparse import SparseProgram
from drake_exo.optimal_control.kernels import FootGroundKernel
from drake_exo.optimal_control.movement import (
    Movement,
    Tracking,
    add_parameters,
)
from drake_exo.optimal_control.settle import settle_foot
from drake_exo.parameters import ContactParameter
from drake_exo.phases.measured import MeasuredMovement
from drake_exo.phases.settings import FootGroundSettings
from drake_exo.planar_tree import PlanarTree

# Samples with less vertical force have no centre of pressure [N].
_LEAST_FORCE = 20.0


@dataclass(frozen=True)
class Trajectory:
    """One trial of a solution.

    Attributes:
        name: of the trial.
        times: (n,) [s].
        q, v, a: (n, nq) coordinates and derivatives [m, rad, s].
        jerk: (n_controls, nq).
        torque: (n, nq - 3) joint torques [N m].
        ground: (n, 3) F_x, F_z [N], M_y about the laboratory origin [N m].
    """

    name: str
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    jerk: np.ndarray
    torque: np.ndarray
    ground: np.ndarray

    @property
    def cop_x(self) -> np.ndarray:
        """Centre of pressure (n,) [m]; NaN where the foot hardly loads."""
        load = np.where(
            self.ground[:, 1] > _LEAST_FORCE, self.ground[:, 1], np.nan
        )
        return -self.ground[:, 2] / load


@dataclass(frozen=True)
class FootGroundResult:
    """What Phase A found.

    Attributes:
        solution: state of the solve.
        parameters: with the calibrated value as nominal.
        trajectories: one for each trial.
        settings: that were used.
    """

    solution: Solution
    parameters: list[ContactParameter]
    trajectories: list[Trajectory]
    settings: FootGroundSettings

    def values(self) -> np.ndarray:
        """Parameter values in the kernel's order."""
        return np.array([p.nominal for p in self.parameters])


class FootGroundProblem:
    """Phase A posed as one MathematicalProgram.

    Attributes:
        program: may be added to before `solve`.
        movements: one for each trial.
        kernel: the contact law.
        parameter_variables: decision variables, in the order of parameters.
        build_seconds: time to pose and compile; a solve adds that of its
            guess and checks.
    """

    def __init__(
        self,
        tree: PlanarTree,
        trials: list[MeasuredMovement],
        parameters: list[ContactParameter],
        settings: FootGroundSettings,
    ):
        start = time.perf_counter()
        self.tree = tree
        self.trials = trials
        self.parameters = parameters
        self.settings = settings
        self.program = BatchedProgram()
        self.kernel = FootGroundKernel(settings.law, settings.law_constants())
        self.parameter_variables = add_parameters(
            self.program, parameters, settings.prior_weight
        )
        self.movements = [self._add(trial) for trial in trials]
        self.build_seconds = time.perf_counter() - start
        self._compiled: SparseProgram | None = None

    def _add(self, trial: MeasuredMovement) -> Movement:
        solver = self.settings.solver
        movement = Movement(
            self.program,
            trial.name,
            self.tree,
            trial.duration,
            solver.nodes_per_second,
            solver.transcription,
        )
        movement.stand_on(self.kernel, self.parameter_variables)
        at = trial.sample(movement.grid.times)
        self._fix_ends(movement, at)
        movement.track(tracking_terms(movement, at, self.settings.noise))
        movement.damp_jerk(self.settings.noise.jerk)
        return movement

    def _fix_ends(self, movement, at):
        tolerance = self.settings.end_tolerance
        reach = np.array(
            [tolerance.x_m, tolerance.z_m, np.deg2rad(tolerance.pitch_deg)]
        )
        grid = movement.grid
        for i in (0, -1):
            movement.bound(grid.q[i, 3:], at.q[i, 3:], at.q[i, 3:])
            movement.bound(grid.v[i, 3:], at.v[i, 3:], at.v[i, 3:])
            foot = at.q[i, :3]
            movement.bound(grid.q[i, :3], foot - reach, foot + reach)

    def compile(self) -> SparseProgram:
        """The sparse problem; computed once."""
        if self._compiled is None:
            start = time.perf_counter()
            solver = self.settings.solver
            substitutions = (
                tuple(m.grid.substitution(self.program) for m in self.movements)
                if solver.reduce
                else ()
            )
            self._compiled = SparseProgram(
                self.program, substitutions, solver.hessian == "exact"
            )
            self.build_seconds += time.perf_counter() - start
        return self._compiled

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
            times = movement.grid.times
            at = trial.sample(times)
            q, v = at.q.copy(), at.v.copy()
            forces = self.tree.inverse_dynamics(q, v, at.a)
            ground = _needed_ground(q, forces)
            q[:, :3], v[:, :3] = settle_foot(
                self.kernel, values, times, at.q[:, :3], ground
            )
            forces = self.tree.inverse_dynamics(q, v, at.a)
            grid = movement.grid
            for variables, numbers in (
                (grid.q, q),
                (grid.v, v),
                (grid.a, at.a),
                (movement.torque, forces[:, 3:]),
                (movement.ground, ground),
            ):
                x[self.program.indices(variables)] = numbers
        return x

    def solve(
        self,
        guess: np.ndarray | None = None,
        on_iterate: Callable[[Iterate], None] | None = None,
    ) -> FootGroundResult:
        """Check, solve and collect.

        Raises:
            InputError: from the pre-flight check.
        """
        problem = self.compile()
        start = time.perf_counter()
        guess = self.guess() if guess is None else guess
        index = self.program.indices(self.parameter_variables)
        free = {
            p.name: int(i)
            for p, i in zip(self.parameters, index, strict=True)
            if p.free
        }
        preflight.check(problem, guess, free)
        prepared = time.perf_counter() - start
        if self.settings.solver.solver == "drake":
            solution = drake_ipopt.solve(
                self.program,
                problem.expand(problem.restrict(guess)),
                self.settings.solver.options(),
            )
        else:
            solution = ipopt.solve(
                problem, guess, self.settings.solver.options(), on_iterate
            )
        solution.seconds["build"] = self.build_seconds + prepared
        return self.result(solution)

    def result(self, solution: Solution) -> FootGroundResult:
        """Read parameters and trajectories of a solution.

        A failed solution stays sealed; its result is for inspection.
        """
        x = solution.raw_values()
        read = lambda variables: x[self.program.indices(variables)]  # noqa: E731
        found = read(self.parameter_variables)
        parameters = [
            replace(p, nominal=float(np.clip(value, p.lower, p.upper)))
            for p, value in zip(self.parameters, found, strict=True)
        ]
        solution.active_bounds = [
            p.name for p in parameters if p.free and p.at_bound(p.nominal)
        ]
        trajectories = [
            Trajectory(
                m.name,
                m.grid.times,
                *(read(v) for v in (m.grid.q, m.grid.v, m.grid.a)),
                read(m.grid.jerk),
                read(m.torque),
                read(m.ground),
            )
            for m in self.movements
        ]
        return FootGroundResult(
            solution, parameters, trajectories, self.settings
        )


def tracking_terms(movement, at, noise) -> list[Tracking]:
    """Terms of the cost that every phase shares.

    Args:
        movement: the trial's variables.
        at: measured values at the nodes.
        noise: standard deviations.
    """
    grid = movement.grid
    joints = grid.q.shape[1] - 3
    sigma_q = np.r_[
        noise.foot_m,
        noise.foot_m,
        np.deg2rad(noise.foot_pitch_deg),
        np.full(joints, np.deg2rad(noise.angle_deg)),
    ]
    sigma_v = np.r_[
        noise.foot_velocity_m_s,
        noise.foot_velocity_m_s,
        np.deg2rad(noise.foot_pitch_rate_deg_s),
        np.full(joints, np.deg2rad(noise.velocity_deg_s)),
    ]
    return [
        Tracking(grid.q, at.q, sigma_q),
        Tracking(grid.v, at.v, sigma_v),
        Tracking(movement.ground[:, :2], at.ground[:, :2], noise.force_n),
        _center_of_pressure(movement, at, noise.cop_m),
        Tracking(
            movement.torque, np.zeros(movement.torque.shape), noise.torque_nm
        ),
    ]


def _center_of_pressure(movement, at, sigma):
    """(M_y + CoP F_z)/F_ref, without dividing by a force that varies."""
    load = at.ground[:, 1]
    loaded = load > _LEAST_FORCE
    reference = load[loaded].mean()
    cop = np.where(loaded, -at.ground[:, 2] / np.where(loaded, load, 1.0), 0.0)
    rows = np.zeros((len(load), 1, 2))
    rows[:, 0, 0], rows[:, 0, 1] = cop, 1.0
    spread = np.where(loaded, sigma * reference, np.inf)[:, None]
    return Tracking(
        movement.ground[:, 1:], np.zeros((len(load), 1)), spread, rows
    )


def _needed_ground(q, forces):
    """Ground reaction that balances root forces, moment about the origin."""
    moment = -forces[:, 2] + q[:, 1] * forces[:, 0] - q[:, 0] * forces[:, 1]
    return np.column_stack([forces[:, :2], moment])
