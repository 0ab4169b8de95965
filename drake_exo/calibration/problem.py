"""What the phases share: a program, its trials, solving and reading it."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drake_exo.calibration.measured import LEAST_FORCE, MeasuredMovement
from drake_exo.calibration.settings import (
    EndTolerance,
    FootGroundSettings,
    Solver,
    TrackingNoise,
)
from drake_exo.collocation.bushing_kernels import Bushing, BushingKernel
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.collocation.loads import AppliedWrench
from drake_exo.collocation.trial_program import Movement, Tracking
from drake_exo.contact.parameters import ContactParameter
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.nlp import drake_ipopt, ipopt
from drake_exo.nlp import infeasibility as preflight
from drake_exo.nlp.ipopt import Iterate, Solution
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sparse import SparseProgram


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
        interaction: (n, 9) forces on the human's shank, thigh, pelvis:
            tangential, normal [N], moment [N m] each; None without cuffs.
    """

    name: str
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    jerk: np.ndarray
    torque: np.ndarray
    ground: np.ndarray
    interaction: np.ndarray | None = None

    @property
    def cop_x(self) -> np.ndarray:
        """Centre of pressure (n,) [m]; NaN where the foot hardly loads."""
        load = np.where(
            self.ground[:, 1] > LEAST_FORCE, self.ground[:, 1], np.nan
        )
        return -self.ground[:, 2] / load


@dataclass(frozen=True)
class PhaseResult:
    """What a phase found.

    Attributes:
        solution: state of the solve.
        parameters: calibrated ones with their value as nominal.
        trajectories: one for each trial.
        settings: of the phase.
    """

    solution: Solution
    parameters: list[ContactParameter]
    trajectories: list[Trajectory]
    settings: object

    def values(self) -> np.ndarray:
        """Parameter values in the order of `parameters`."""
        return np.array([p.nominal for p in self.parameters])


class PhaseProblem(ABC):
    """One phase posed as one MathematicalProgram.

    Attributes:
        program: may be added to before `solve`.
        movements: one for each trial.
        parameters: calibrated and fixed contact parameters.
        parameter_variables: their decision variables.
        foot: settings of Phase A, for the law under the foot.
        kernel: that law.
        bushings, laws: geometry and law of each human-exoskeleton contact;
            empty where the chains do not touch.
        build_seconds: time to pose and compile; a solve adds that of its
            guess and checks.
    """

    parameter_variables: np.ndarray
    foot: FootGroundSettings
    kernel: FootGroundKernel
    bushings: Sequence[Bushing] = ()
    laws: Sequence[BushingKernel] = ()

    def __init__(
        self,
        tree: PlanarTree,
        trials: list[MeasuredMovement],
        parameters: list[ContactParameter],
        settings,
    ):
        start = time.perf_counter()
        self.tree = tree
        self.trials = trials
        self.parameters = parameters
        self.settings = settings
        self.program = BatchedProgram()
        self._add_parameters()
        self.movements = [self._add(trial) for trial in trials]
        self.build_seconds = time.perf_counter() - start
        self._compiled: SparseProgram | None = None

    @property
    def _solver(self) -> Solver:
        return self.settings.solver

    @abstractmethod
    def contact_values(self, values: np.ndarray):
        """Parameters of spheres (10,) and of bushings (len(bushings), 5).

        Args:
            values: of `parameters`.
        """

    @abstractmethod
    def _add_parameters(self) -> None:
        """Set `parameter_variables`."""

    @abstractmethod
    def _add(self, trial: MeasuredMovement) -> Movement:
        """Add a trial: dynamics, contact, ends, cost."""

    @abstractmethod
    def guess(self, values: np.ndarray | None = None) -> np.ndarray:
        """Program variables to start from, given parameter values."""

    def compile(self) -> SparseProgram:
        """The sparse problem; computed once."""
        if self._compiled is None:
            start = time.perf_counter()
            substitutions = (
                tuple(m.grid.substitution(self.program) for m in self.movements)
                if self._solver.reduce
                else ()
            )
            self._compiled = SparseProgram(
                self.program, substitutions, self._solver.hessian == "exact"
            )
            self.build_seconds += time.perf_counter() - start
        return self._compiled

    def solve(
        self,
        guess: np.ndarray | None = None,
        on_iterate: Callable[[Iterate], None] | None = None,
    ) -> PhaseResult:
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
        if self._solver.solver == "drake":
            solution = drake_ipopt.solve(
                self.program,
                problem.expand(problem.restrict(guess)),
                self._solver.options(),
            )
        else:
            solution = ipopt.solve(
                problem, guess, self._solver.options(), on_iterate
            )
        solution.seconds["build"] = self.build_seconds + prepared
        return self.result(solution)

    def result(self, solution: Solution) -> PhaseResult:
        """Read parameters and trajectories of a solution.

        A failed solution stays sealed; its result is for inspection.
        """
        x = solution.raw_values()
        found = x[self.program.indices(self.parameter_variables)]
        parameters = [
            replace(p, nominal=float(np.clip(value, p.lower, p.upper)))
            for p, value in zip(self.parameters, found, strict=True)
        ]
        solution.active_bounds = [
            p.name for p in parameters if p.free and p.at_bound(p.nominal)
        ]
        trajectories = [self._read(m, x) for m in self.movements]
        return PhaseResult(solution, parameters, trajectories, self.settings)

    def _read(self, movement: Movement, x: np.ndarray) -> Trajectory:
        def read(variables):
            return x[self.program.indices(variables)]

        grid = movement.grid
        return Trajectory(
            movement.name,
            grid.times,
            read(grid.q),
            read(grid.v),
            read(grid.a),
            read(grid.jerk),
            read(movement.torque),
            read(movement.ground),
            None
            if movement.interaction is None
            else read(movement.interaction),
        )


def fix_ends(
    movement: Movement, at: MeasuredMovement, tolerance: EndTolerance
) -> None:
    """Give initial and final states; the foot within a tolerance (II-C)."""
    reach = np.array(
        [tolerance.x_m, tolerance.z_m, np.deg2rad(tolerance.pitch_deg)]
    )
    speed = np.array(
        [np.inf if tolerance.velocity_m_s is None else tolerance.velocity_m_s]
        * 2
        + [
            np.inf
            if tolerance.pitch_rate_deg_s is None
            else np.deg2rad(tolerance.pitch_rate_deg_s)
        ]
    )
    grid = movement.grid
    for i in (0, -1):
        movement.bound(grid.q[i, 3:], at.q[i, 3:], at.q[i, 3:])
        movement.bound(grid.v[i, 3:], at.v[i, 3:], at.v[i, 3:])
        foot, moving = at.q[i, :3], at.v[i, :3]
        movement.bound(grid.q[i, :3], foot - reach, foot + reach)
        movement.bound(grid.v[i, :3], moving - speed, moving + speed)


def kinematic_terms(movement, at, noise: TrackingNoise) -> list[Tracking]:
    """Tracking of coordinates and velocities.

    Args:
        movement: the trial's variables.
        at: measured values at the nodes.
        noise: standard deviations.
    """
    grid = movement.grid
    device = grid.q.shape[1] - 6
    sigma_q = np.r_[
        noise.foot_m,
        noise.foot_m,
        np.deg2rad(noise.foot_pitch_deg),
        np.full(3, np.deg2rad(noise.angle_deg)),
        np.full(device, np.deg2rad(noise.exo_angle_deg)),
    ]
    sigma_v = np.r_[
        noise.foot_velocity_m_s,
        noise.foot_velocity_m_s,
        np.deg2rad(noise.foot_pitch_rate_deg_s),
        np.full(3, np.deg2rad(noise.velocity_deg_s)),
        np.full(device, np.deg2rad(noise.exo_velocity_deg_s)),
    ]
    return [
        Tracking(grid.q, at.q, sigma_q, role="position"),
        Tracking(grid.v, at.v, sigma_v, role="velocity"),
    ]


def ground_terms(movement, at, noise: TrackingNoise) -> list[Tracking]:
    """Tracking of ground reaction and centre of pressure.

    The latter as (M_y + CoP F_z)/F_ref, without dividing by a force that
    varies; samples that hardly load are left out.
    """
    load = at.ground[:, 1]
    loaded = load > LEAST_FORCE
    reference = load[loaded].mean()
    cop = np.where(loaded, -at.ground[:, 2] / np.where(loaded, load, 1.0), 0.0)
    rows = np.zeros((len(load), 1, 2))
    rows[:, 0, 0], rows[:, 0, 1] = cop, 1.0
    spread = np.where(loaded, noise.cop_m * reference, np.inf)[:, None]
    return [
        Tracking(movement.ground[:, :2], at.ground[:, :2], noise.force_n),
        Tracking(
            movement.ground[:, 1:], np.zeros((len(load), 1)), spread, rows
        ),
    ]


def chair_wrench(
    tree: PlanarTree, trial: MeasuredMovement
) -> AppliedWrench | None:
    """The measured wrench of a chair in a trial that starts seated."""
    if trial.chair is None:
        return None
    return AppliedWrench(tree, trial.chair_shares, trial.times, trial.chair)


def needed_ground(q: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Ground reaction (n, 3) that balances root forces of inverse dynamics.

    Args:
        q: (n, nq) positions.
        forces: (n, nq) generalized forces.
    """
    moment = -forces[:, 2] + q[:, 1] * forces[:, 0] - q[:, 0] * forces[:, 1]
    return np.column_stack([forces[:, :2], moment])
