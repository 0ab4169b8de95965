"""Base of all phases: posing trials as one program, solving, reading it."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline, make_interp_spline

from drake_exo.calibration.error_model import (
    NO_ERRORS,
    Effects,
    ErrorModel,
    ErrorSizes,
)
from drake_exo.calibration.settings import EndTolerance, TrackingNoise
from drake_exo.calibration.start import settled
from drake_exo.collocation.bushing_kernels import BushingKernel, EnergyKernel
from drake_exo.collocation.kernels import (
    AppliedWrench,
    DynamicsKernel,
    FootGroundKernel,
)
from drake_exo.collocation.transcription import stands_for
from drake_exo.collocation.trial_program import (
    Tracking,
    TrialProgram,
    add_parameters,
    minimised,
)
from drake_exo.contact.bushing import CALIBRATED, NORMAL, BushingKinematics
from drake_exo.contact.parameters import (
    TYPICAL_JERK,
    ContactModel,
    ContactParameter,
)
from drake_exo.errors import InputError, check_names, check_type
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial, as_trials
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.nlp import infeasibility, ipopt
from drake_exo.nlp.ipopt import Iterate, Solution
from drake_exo.nlp.program import BatchedProgram, variable_bounds
from drake_exo.nlp.sparse import SparseProgram

Parts = np.ndarray | int
_NUM_ORIGIN = sum(name.startswith("origin") for name in CALIBRATED)
# Bounds on joints' end states about the measured ones, in a device: so wide
# that only faults reach them [rad, rad/s].
_END_REACH = 0.3
# Noise of a swinging leg's moments, as a share of its value while the foot
# bears the body; and for how long around stance the larger value is kept.
_IN_SWING, _SMEARED_S = 0.03, 0.1
_LONGEST_S = 120.0
_MOST_NODES = 24_000  # some 10 GB
# What v may miss of a movement, beside 0.1 m or rad: few samples add up badly.
_VELOCITY_MISSES = 0.2


@dataclass(frozen=True)
class PhaseResult:
    """Result of a phase; reading a failed one raises, see `unsealed`.

    Attributes:
        problem: the problem that was solved.
        solution: state of the solve.
        compiled: the program as solved; `problem.program` may have been added
            to since.
    """

    problem: "PhaseProblem"
    solution: Solution
    compiled: SparseProgram

    @property
    def success(self) -> bool:
        """Whether the solver met its tolerances."""
        return self.solution.success

    def unsealed(self) -> "PhaseResult":
        """A copy that may be read even if the solve failed."""
        return replace(self, solution=replace(self.solution).unseal())

    @cached_property
    def values(self) -> np.ndarray:
        """All program variables (num_vars,).

        This and what follows raises SealedSolutionError after a failed solve.
        """
        return self.solution.values(slice(None))

    @cached_property
    def parameters(self) -> list[ContactParameter]:
        """Calibrated parameters, with the value found as `nominal`."""
        return self.problem.parameters_at(self.values, self.compiled)

    @cached_property
    def contact(self) -> ContactModel:
        """The contact with the calibrated values."""
        found = {p.name: p.nominal for p in self.parameters}
        return self.problem.contact.with_values(found)

    @cached_property
    def trials(self) -> list[Trial]:
        """The solution of each trial."""
        problem = self.problem
        return [
            problem.read(movement, trial, self.values, self.success)
            for movement, trial in zip(
                problem.movements, problem.trials, strict=True
            )
        ]

    @cached_property
    def grounds(self) -> list[dict[str, np.ndarray]]:
        """Each trial's ground reactions: segment that touches -> (n, 3)."""
        indices = self.problem.program.indices
        return [
            {body: self.values[indices(w)] for body, w in m.grounds.items()}
            for m in self.problem.movements
        ]


def solved(
    problem: "PhaseProblem",
    why: str,
    on_iterate: Callable[[Iterate], None] | None = None,
) -> PhaseResult:
    """Solve a phase whose result is indispensable.

    Raises:
        InputError: the solve failed; the sentence begins with `why`.
        KeyboardInterrupt: the user stopped it.
    """
    result = problem.solve(on_iterate=on_iterate)
    if result.success:
        return result
    if result.solution.was_stopped:
        raise KeyboardInterrupt
    raise InputError(
        f"{why} ({result.solution.status}); {result.solution.explain()}"
    )


class Compiles:
    """Base of problems: compiles their program for the sparse solver.

    Attributes:
        program: program with all movements.
        movements: movement of each trial.
        settings: settings with `solver`.
        build_seconds: time to pose and compile.
    """

    _compiled_for: tuple | None = None

    @cached_property
    def compiled(self) -> SparseProgram:
        """The sparse problem that the solver sees.

        Made when first asked for; `compiled_anew` makes it again for a solve.
        """
        solver = self.settings.solver
        start = time.perf_counter()
        self._compiled_for = self.program.counts
        substitutions = (
            tuple(m.grid.substitution(self.program) for m in self.movements)
            if solver.reduce
            else ()
        )
        compiled = SparseProgram(
            self.program, substitutions, solver.hessian == "exact"
        )
        self.build_seconds += time.perf_counter() - start
        return compiled

    def compiled_anew(self) -> SparseProgram:
        """`compiled` for a solve, of the program as it is now.

        Counts show whether something was added, but not whether bounds or
        coefficients were changed: so each solve after the first compiles anew.
        """
        if self.program.counts != self._compiled_for:
            vars(self).pop("compiled", None)
        compiled, self._compiled_for = self.compiled, None
        return compiled


class PhaseProblem(Compiles, ABC):
    """One phase posed as one MathematicalProgram.

    Args:
        model: subject and device.
        trials: measured.
        contact: of the foot and, if human and device touch, of the cuffs;
            values of `parameters` replace its own.
        parameters: those of the contact that are calibrated.
        settings: of the phase, with solver and noise.
        errors: standard deviations of unknown errors' priors; none by default.
            The contact's posterior is the prior of errors that it holds.
        refined: trial -> number of parts into which each interval of the
            settings' grid is split, or one number for all; in these trials
            jerk that alternates from node to node is damped.
        program: program to add to; a new one by default.
        solved: see `ErrorModel`.

    Attributes:
        program: `program.prog` is a MathematicalProgram that may be added to
            before `solve`.
        movements: one for each trial.
        soles: segment that touches the ground -> its spheres' names.
        kernels: such a segment -> contact law under it.
        bushings, laws: cuff -> geometry, and law of its force.
        build_seconds: time to pose and compile; a solve adds that of its
            guess and checks.
    """

    # Typical size of jerk in the cost, as a share of the contact's.
    jerk_share = 1.0
    # Whether exact second derivatives save time near a solution.
    exact_near = False

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        parameters: list[ContactParameter],
        settings,
        errors: ErrorSizes = NO_ERRORS,
        refined: Mapping[str, Parts] | None = None,
        program: BatchedProgram | None = None,
        solved: Sequence[Trial] = (),
    ):
        start = time.perf_counter()
        self.model = model
        self.tree = model.tree
        self.trials = list(as_trials(trials))
        nodes_per_second = settings.solver.nodes_per_second
        _check_trials(self.trials, model, nodes_per_second)
        if parameters:  # calibrated on these trials
            _check_velocities(self.trials)
            contact = replace(contact, jerk=typical_jerk(self.trials))
        self.contact = contact = _in_order(contact, model)
        self.parameters = parameters
        self.settings = settings
        self.jerk = settings.noise.jerk or self.jerk_share * contact.jerk
        self.refined = refined or {}
        under = contact.ground.under(model)
        self.soles = {body: list(own.spheres) for body, own in under.items()}
        self.kernels = {
            body: FootGroundKernel(own) for body, own in under.items()
        }
        self.bushings = {
            cuff: BushingKinematics(
                self.tree, cuff, bushing.preload, self.moving(cuff)
            )
            for cuff, bushing in contact.bushings.items()
        }
        self.laws = {
            cuff: BushingKernel(self.bushings[cuff], bushing.damping)
            for cuff, bushing in contact.bushings.items()
        }
        self.errors = ErrorModel(
            model, self.trials, errors, contact.posterior, solved
        )
        self.program = program or BatchedProgram()
        self._add_parameters()
        self.error_variables = self._add_errors()
        self.movements = [self._add(trial) for trial in self.trials]
        self.build_seconds = time.perf_counter() - start

    def _add_parameters(self) -> None:
        """Decision variables of the whole contact, by sphere and cuff."""
        chosen = {p.name: p for p in self.parameters}
        self._variables: dict[str, np.ndarray] = {}
        for group in (*self.contact.ground.spheres, *self.contact.bushings):
            parameters = [
                chosen.get(p.name, p) for p in self.contact.fixed(group)
            ]
            self._variables[group] = self._add_group(group, parameters)
        names = [p.name for p in self.parameters]
        self.parameter_variables = self.variables_of(names)

    def _add_group(
        self, group: str, parameters: list[ContactParameter]
    ) -> np.ndarray:
        """Decision variables of one sphere or cuff."""
        return add_parameters(self.program, parameters)

    def _add_errors(self) -> np.ndarray:
        """Decision variables of the unknown errors, with their prior."""
        prog, unknowns = self.program.prog, self.errors.unknowns
        variables = self.program.add_variables(
            self.errors.names, [u.sd for u in unknowns]
        )
        if not unknowns:
            return variables
        names, mean, covariance = self._prior()
        # AddQuadraticErrorCost has no factor 1/2.
        weight = 0.5 * np.linalg.inv(covariance)
        both = np.r_[self.variables_of(names), variables]
        prog.AddQuadraticErrorCost(weight, mean, both)
        return variables

    def _prior(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Prior of some parameters and of all unknown errors together.

        Returns:
            Names of the parameters; mean (m,) and covariance (m, m) of them,
            followed by the errors.
        """
        return [], *self.errors.prior()

    def _effects(self, at: Trial) -> Effects | None:
        """Effects of the unknown errors on a trial's signals, if any."""
        return self.errors.effects(at) if self.errors.unknowns else None

    def variables_of(self, names: Sequence[str]) -> np.ndarray:
        """Decision variables of contact parameters by name, free or not.

        Raises:
            InputError: there is none of that name.
        """
        known = list(self.contact.values())
        every = np.concatenate(list(self._variables.values()))
        check_names(names, known)
        return every[[known.index(name) for name in names]]

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        """Bound initial and final states near the measured ones (II-C).

        With a device they are estimated, like the errors of measurement. Given
        exactly, they would throw the foot into a motion that dies out within
        milliseconds, which no grid follows. For a human alone joints are given
        exactly: real rises are predicted better so (hip 1.5, not 4.5 degrees).
        """
        grid, joints = movement.grid, movement.coordinates.joint_columns
        reach = rate = self._end_reach
        if len(self.feet) > 1:
            # Given feet and joints between them would contradict each other.
            pitch = np.deg2rad(self.settings.end_tolerance.pitch_deg)
            reach, rate = max(reach, pitch), np.inf
        ends = np.ix_([0, -1], joints)
        movement.bound(grid.q[ends], at.q[ends] - reach, at.q[ends] + reach)
        movement.bound(grid.v[ends], at.v[ends] - rate, at.v[ends] + rate)
        bound_feet(movement, at, self.settings.end_tolerance)

    @property
    def _end_reach(self) -> float:
        """How far joints may be from their measured ends [rad, rad/s]."""
        return _END_REACH if self.model.cuffs else 0.0

    @property
    def feet(self) -> dict[str, tuple[str, ...]]:
        """Side, or "both", -> its segments that touch the ground."""
        return self.model.assembly.human.feet(self.soles)

    def sphere_values(self, contact: ContactModel, body: str) -> np.ndarray:
        """Parameters (m, 5) of the spheres under a segment."""
        spheres = contact.ground.spheres
        return np.array([spheres[name].in_plane for name in self.soles[body]])

    def law_inputs(
        self, contact: ContactModel, body: str, q, v, wrench=None
    ) -> np.ndarray:
        """Inputs (n, .) of the law under a segment, see `kernels`.

        Args:
            contact: gives the spheres.
            body: the segment.
            q, v: (n, nq).
            wrench: (n, 3) to compare with the law's; zero by default.
        """
        pose = self.tree.states(q, v, body)
        values = self.sphere_values(contact, body).ravel()
        wrench = np.zeros((len(pose), 3)) if wrench is None else wrench
        return np.hstack([pose, wrench, np.tile(values, (len(pose), 1))])

    def _add(self, trial: Trial) -> TrialProgram:
        """Add a trial: dynamics, contact, ends, cost."""
        movement = self._movement(trial)
        at = trial.sample(movement.grid.times)
        self._hold_ends(movement, at)
        terms = self._terms(movement, at, self._effects(at))
        movement.add_tracking_cost(terms, self.error_variables)
        movement.add_jerk_cost(self.jerk)
        if movement.is_tracked and movement.name in self.refined:
            # Only here: on the first grid it would lead to other optima.
            movement.damp()
        return movement

    @abstractmethod
    def _terms(
        self, movement: TrialProgram, at: Trial, effects: Effects | None
    ) -> list[Tracking]:
        """Terms of the cost: what is tracked or minimised in a trial.

        Args:
            movement: the trial's variables.
            at: the measured trial at the nodes.
            effects: effects of the unknown errors on it.
        """

    # Kernel of the equations of motion.
    equations = DynamicsKernel

    def moving(self, cuff: str) -> Sequence[tuple[int, complex]]:
        """Inputs that displace the device's frame, see BushingKinematics."""
        return ()

    def places(self, cuff: str) -> np.ndarray:
        """Decision variables of a cuff's place, see BushingKinematics."""
        return self._variables[cuff][:_NUM_ORIGIN]

    def _movement(self, trial: Trial) -> TrialProgram:
        """Variables, dynamics and contact of a trial, without its cost."""
        solver = self.settings.solver
        borne = [(shares, wrench.array) for shares, wrench in trial.borne()]
        movement = TrialProgram(
            self.program,
            trial.name,
            self.tree,
            trial.duration,
            solver.nodes_per_second,
            solver.transcription,
            {
                cuff: (bushing, self.places(cuff))
                for cuff, bushing in self.bushings.items()
            },
            AppliedWrench(self.tree, trial.times, borne) if borne else None,
            self.soles,
            self.equations,
            self.refined.get(trial.name, 1),
        )
        grid = movement.grid
        for body, spheres in self.soles.items():
            movement.add_law(
                "foot-ground" + ("" if len(self.soles) == 1 else f" {body}"),
                self.kernels[body],
                [movement.poses[body], movement.grounds[body]],
                np.concatenate([self._variables[name] for name in spheres]),
            )
        for cuff, law in self.laws.items():
            stiffness = self._variables[cuff][_NUM_ORIGIN:]
            movement.add_law(
                f"bushing {cuff}",
                law,
                [grid.q, grid.v, movement.cuffs[cuff]],
                np.concatenate([self.places(cuff), stiffness]),
            )
        return movement

    def minimise_energy(
        self, movement: TrialProgram, components: dict[str, list[int]]
    ) -> None:
        """Add the squared contact energy of components as a cost.

        Args:
            movement: the trial.
            components: cuff -> indices of components in `bushing.COMPONENTS`.
        """
        grid, sigma = movement.grid, self.settings.noise.energy_j
        # Residuals are squared: each is scaled by the root of its weight.
        used = grid.quadrature > 0.0
        for cuff, chosen in components.items():
            if not chosen:
                continue
            parameters = self._variables[cuff]
            self.program.add_residuals(
                f"{movement.name} energy {cuff}",
                EnergyKernel(self.bushings[cuff], chosen, sigma),
                np.hstack([grid.q, movement.at_nodes(parameters)])[used],
                np.sqrt(grid.quadrature[used])[:, None],
            )

    def guess(self, values: np.ndarray | None = None) -> np.ndarray:
        """Program variables (num_vars,) near the data, with the foot settled.

        Args:
            values: values of `parameters`; nominal ones by default.
        """
        if values is None:
            values = [p.nominal for p in self.parameters]
        names = [p.name for p in self.parameters]
        contact = self.contact.with_values(
            dict(zip(names, values, strict=True))
        )
        x, known = self.program.start(), contact.values()
        index = self.program.indices(self.variables_of(known))
        x[index] = list(known.values())
        for movement, trial in zip(self.movements, self.trials, strict=True):
            self._settle(x, movement, self._start(movement, trial), contact)
        return x

    def guess_from(self, found: PhaseResult) -> np.ndarray:
        """Program variables from a solution on another or the same grid.

        Motion is interpolated by the polynomials of the solution's grid: a
        finer grid with all of its nodes starts from exactly the same motion.
        """
        x = self.program.start()
        # Parameters and errors come before all movements, in both programs.
        shared = [*self._variables.values(), self.error_variables]
        index = self.program.indices(np.concatenate(shared))
        x[index] = found.values[index]
        for movement, before, solved, ground in zip(
            self.movements,
            found.problem.movements,
            found.trials,
            found.grounds,
            strict=True,
        ):
            times, jerk = movement.grid.times, solved.jerk
            at, nodes = solved.sample(times), solved.times
            motion = before.grid.at(times, solved.q, solved.v, solved.a, jerk)
            own = movement.grid.jerk
            known = make_interp_spline(nodes[-len(jerk) :], jerk, k=1)
            x[self.program.indices(own)] = known(times[-len(own) :])
            self._fill(
                x,
                movement,
                motion,
                at.moments,
                {b: CubicSpline(nodes, w)(times) for b, w in ground.items()},
                {cuff: at.cuffs[cuff].components for cuff in movement.cuffs},
            )
        return x

    def _start(self, movement: TrialProgram, trial: Trial) -> Trial:
        """Motion from which the guess is made, at the nodes."""
        return trial.sample(movement.grid.times)

    def _settle(self, x, movement: TrialProgram, at: Trial, contact) -> None:
        """Set a trial's variables in x so that the equations of motion hold."""
        start = settled(self, movement, at, contact)
        q, v, a = start.q, start.v, start.a
        forces = self.tree.inverse_dynamics(q, v, a)
        forces -= movement.applied(q)
        for body, wrench in start.ground.items():
            forces -= self.tree.wrench_on_body(q, body, wrench)
        cuffs = {}
        for cuff, kinematics in self.bushings.items():
            _, cuffs[cuff], terms = self._cuff_at(x, cuff, q, contact)
            forces += np.einsum(
                "nc,ncq->nq", cuffs[cuff], kinematics.deflection_jacobian(terms)
            )
        moments = forces[:, self.tree.coordinates.joint_columns]
        self._fill(x, movement, (q, v, a), moments, start.ground, cuffs)

    def _cuff_at(self, x, cuff: str, q, contact: ContactModel):
        """A cuff's deflection and spring force at q (n, nq), placed as in x.

        Returns:
            Deflection (n, 3) [m, m, rad], force (n, 3) [N, N, N m], and the
            kinematics' terms.
        """
        kinematics = self.bushings[cuff]
        places = x[self.program.indices(self.places(cuff))]
        terms = kinematics.terms(
            q, np.broadcast_to(places, (len(q), len(places)))
        )
        deflection = kinematics.deflection(q, terms)
        return (
            deflection,
            kinematics.force(deflection, contact.bushings[cuff]),
            terms,
        )

    def _fill(self, x, movement: TrialProgram, motion, moments, ground, cuffs):
        """Set the variables of one trial in x.

        Args:
            x: all program variables.
            movement: the trial.
            motion: q, v, a, each (n, nq), at its nodes.
            moments: (n, nj) of the joints [N m].
            ground: segment that touches the ground -> wrench (n, 3).
            cuffs: cuff -> force (n, 3) [N, N, N m].
        """
        grid = movement.grid
        q, v, a = motion
        filled = [
            (grid.q, q),
            (grid.v, v),
            (grid.a, a),
            (movement.torque, moments),
        ]
        for body, pose in movement.poses.items():
            filled.append((pose, self.tree.states(q, v, body)))
            filled.append((movement.grounds[body], ground[body]))
        for cuff, force in cuffs.items():
            filled.append((movement.cuffs[cuff], force))
        for variables, numbers in filled:
            x[self.program.indices(variables)] = numbers

    def solve(
        self,
        guess: np.ndarray | None = None,
        on_iterate: Callable[[Iterate], None] | None = None,
        near: PhaseResult | None = None,
    ) -> PhaseResult:
        """Check the guess, solve, and collect the result.

        Args:
            guess: (num_vars,) program variables to start from; `guess()` by
                default.
            on_iterate: called once for each iteration.
            near: solution on another grid, or with another contact, to start
                from instead.

        Raises:
            InputError: see `infeasibility.check`.
        """
        if near is not None:
            check_type(near, PhaseResult, "near")
        problem, solver = self.compiled_anew(), self.settings.solver
        start, options = time.perf_counter(), solver.options()
        if near is not None:
            guess = self.guess_from(near)
            options = options.near_solution(self.exact_near)
        guess = self.guess() if guess is None else guess
        index = self.program.indices(self.parameter_variables)
        lower, upper = variable_bounds(self.program.prog)
        free = {
            p.name: int(i)
            for p, i in zip(self.parameters, index, strict=True)
            if p.free and lower[i] < upper[i]
        }
        if near is not None:
            free = {}  # at a solution some parameters may have no influence
        infeasibility.check(problem, guess, free)
        prepared = time.perf_counter() - start
        if solver.solver == "drake":
            solution = ipopt.solve_with_drake(
                self.program, problem.expand(problem.restrict(guess)), options
            )
        else:
            solution = ipopt.solve(problem, guess, options, on_iterate)
        solution.seconds["build"] = self.build_seconds + prepared
        return self.result(solution)

    def result(self, solution: Solution) -> PhaseResult:
        """The phase's result of a solution; sealed if the solve failed."""
        compiled = self.compiled
        found = self.parameters_at(solution.raw_values(), compiled)
        solution.active_bounds = [
            p.name for p in found if p.free and p.at_bound(p.nominal)
        ]
        return PhaseResult(self, solution, compiled)

    def parameters_at(
        self, x: np.ndarray, compiled: SparseProgram | None = None
    ) -> list[ContactParameter]:
        """Calibrated parameters with their values in x as `nominal`.

        Args:
            x: (num_vars,) program variables.
            compiled: the program as solved; what was added to it bounds or
                fixes parameters, too.
        """
        index = self.program.indices(self.parameter_variables)
        known, found = (compiled or self.compiled).unknowns, []
        for p, k in zip(self.parameters, index, strict=True):
            lower, upper = float(known.x_lower[k]), float(known.x_upper[k])
            value = float(np.clip(x[k], lower, upper))
            if p.free and lower < upper:
                p = replace(p, nominal=value, lower=lower, upper=upper)
            else:
                p = replace(p, nominal=value, free=False)
            found.append(p)
        return found

    def read(
        self, movement: TrialProgram, trial: Trial, x, success: bool
    ) -> Trial:
        """A trial's solution, with chair and applied loads as measured.

        Args:
            movement: the trial's variables.
            trial: the measured trial.
            x: all program variables.
            success: whether they solve the program.
        """

        def read(variables):
            return x[self.program.indices(variables)]

        grid = movement.grid
        zero = PlanarWrench.of(np.zeros((len(grid.times), 3)))
        feet = {
            side: sum(
                (PlanarWrench.of(read(movement.grounds[b])) for b in bodies),
                zero,
            )
            for side, bodies in self.feet.items()
        }
        given = trial.sample(grid.times) if trial.borne() else trial
        chair = given.chair if trial.chair_shares else None
        return Trial(
            trial.name,
            self.tree.coordinates,
            grid.times,
            read(grid.q),
            read(grid.v),
            read(grid.a),
            sum(feet.values(), zero),
            source="solved" if success else "not solved",
            feet=feet if self.model.assembly.human.sides else {},
            moments=read(movement.torque),
            cuffs={
                cuff: CuffForce.of(read(variables))
                for cuff, variables in movement.cuffs.items()
            },
            chair=chair,
            chair_on_thighs=trial.chair_on_thighs,
            applied=given.applied,
            jerk=read(grid.jerk),
            mass_kg=trial.mass_kg,
            start_s=trial.start_s,
            provenance=trial.provenance,
        )


def check_distinct(trials: Sequence[Trial]) -> None:
    """Refuse trials of which two are the same movement.

    Raises:
        InputError: it names the two.
    """
    for trial, other in combinations(trials, 2):
        if np.array_equal(trial.q, other.q) and np.array_equal(
            trial.ground.array, other.ground.array
        ):
            raise InputError(
                f"trials {trial.name} and {other.name} are the same part of a "
                "recording, which would count twice; leave one out"
            )


def _check_trials(
    trials: list[Trial], model: Model, nodes_per_second: float
) -> None:
    """Refuse trials that no program can be made of.

    Raises:
        InputError: two are the same movement; one is of another model, does
            not start at 0, holds NaN or infinity, has an angle beyond 2 pi, is
            too short, too long or has too many nodes, has a cuff, a foot or a
            segment that the model lacks, or lacks the force under a foot.
    """
    own = model.coordinates
    check_distinct(trials)
    for trial in trials:
        check_coordinates(trial, own)
        if trial.times[0] != 0.0:
            raise InputError(
                f"trial {trial.name}: times must start at 0; subtract the "
                "first one"
            )
        if len(trial.times) < 3 or trial.duration > _LONGEST_S:
            raise InputError(
                f"trial {trial.name}: has {len(trial.times)} samples of "
                f"{trial.duration:g} s in all; give at least three, and times "
                f"in seconds, at most {_LONGEST_S:g}"
            )
        if trial.duration * nodes_per_second > _MOST_NODES:
            raise InputError(
                f"trial {trial.name}: {nodes_per_second:g} nodes_per_second "
                f"over {trial.duration:g} s are too many for a computer's "
                f"memory; give {int(_MOST_NODES / trial.duration)} at most"
            )
        for what, given, known in (
            ("cuff", trial.cuffs, model.tree.cuffs),
            ("foot", trial.feet, model.assembly.human.sides),
            ("segment", trial.applied, model.tree.names),
        ):
            absent = [name for name in given if name not in known]
            if absent:
                raise InputError(
                    f"trial {trial.name}: the model has no {what} "
                    f"{absent[0]!r}; it has {', '.join(known) or 'none'}"
                )
        unknown = set(model.assembly.human.sides) - set(trial.feet)
        if unknown:
            raise InputError(
                f"trial {trial.name}: the force under the {min(unknown)} foot "
                "is not known; a model with two legs needs the force under "
                "each foot"
            )
        wrong = trial.not_finite()
        if wrong:
            raise InputError(
                f"trial {trial.name}: {wrong} holds values that are not finite "
                "numbers; cut or fill them"
            )
        turned = np.abs(trial.q[:, own.is_angle]).max()
        if turned > 2.0 * np.pi:
            raise InputError(
                f"trial {trial.name}: an angle reaches {turned:.3g} rad; give "
                "q in radians, v and a likewise"
            )


def check_coordinates(trial: Trial, own: Coordinates) -> None:
    """Refuse a trial of a model with other coordinates.

    Raises:
        InputError: it names both.
    """
    if trial.coordinates != own:
        raise InputError(
            f"trial {trial.name}: has the coordinates "
            f"{', '.join(trial.coordinates.names)}, but the model has "
            f"{', '.join(own.names)}; give trials of this model"
        )


def _check_velocities(trials: list[Trial]) -> None:
    """Refuse trials to calibrate on whose v is not the derivative of q.

    Those to predict only give their end states, which may be made up.
    """
    for trial in trials:
        moved = trial.q[1:] - trial.q[0]
        missed = cumulative_trapezoid(trial.v, trial.times, axis=0) - moved
        missed, moved = (np.abs(x).mean(axis=0) for x in (missed, moved))
        allowed = _VELOCITY_MISSES * moved + 0.1
        worst = np.argmax(missed / allowed)
        if missed[worst] > allowed[worst]:
            raise InputError(
                f"trial {trial.name}: v is not the derivative of q: "
                f"{trial.coordinates.names[worst]} is {missed[worst]:.3g} off, "
                "on average, what its v adds up to; give that of a spline "
                "through q"
            )


def typical_jerk(trials: Sequence[Trial]) -> float:
    """Three times the RMS of the human joints' jerk in some trials [rad/s^3].

    Large enough that measured motion is hardly distorted, small enough that a
    device does not swing on its cuffs. A brisk rise's if trials keep still.
    """
    rows = []
    for trial in trials:
        names = trial.coordinates
        human = names.joint_columns[~names.is_device_joint]
        rows.append(np.gradient(trial.a[:, human], trial.times, axis=0))
    jerk = 3.0 * float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
    return jerk or TYPICAL_JERK


def _in_order(contact: ContactModel, model: Model) -> ContactModel:
    """The contact with its cuffs in the order of the model's.

    Raises:
        InputError: it has other spheres than the model, or other cuffs.
    """
    for what, own, known in (
        ("spheres", contact.ground.spheres, model.spheres),
        ("cuffs", contact.bushings, model.tree.cuffs),
    ):
        if what == "spheres" and contact.ground.of_sole:
            continue
        if what == "spheres" and len(own) == 1:
            raise InputError(
                f"a foot has only the sphere {next(iter(own))} to roll over; "
                "give it two or more (model.ground)"
            )
        if not set(own) <= set(known) or (what == "spheres" and not own):
            raise InputError(
                f"the contact has the {what} {', '.join(own) or 'none'}, but "
                f"the model has {', '.join(known) or 'none'}; calibrate with "
                "this model"
            )
    cuffs = [cuff for cuff in model.tree.cuffs if cuff in contact.bushings]
    return replace(contact, bushings={c: contact.bushings[c] for c in cuffs})


def bound_feet(
    movement: TrialProgram, at: Trial, tolerance: EndTolerance
) -> None:
    """Bound the feet's pose within a tolerance at both ends (II-C)."""
    speed, degree = tolerance.velocity_m_s, np.deg2rad(1.0)
    pitch, rate = tolerance.pitch_deg, tolerance.pitch_rate_deg_s
    reach = [tolerance.x_m, tolerance.z_m, pitch, speed, speed, rate]
    # What is left free is None, in an array NaN.
    reach = np.array(reach, float) * np.tile([1.0, 1.0, degree], 2)
    reach[np.isnan(reach)] = np.inf
    for foot, measured in measured_feet(movement, at).items():
        ends, given = movement.poses[foot][[0, -1]], measured[[0, -1]]
        movement.bound(ends, given - reach, given + reach)


def measured_feet(movement: TrialProgram, at: Trial) -> dict[str, np.ndarray]:
    """Foot -> measured pose and rates (n, 6); toes do not count."""
    return {
        body: movement.tree.states(at.q, at.v, body)
        for body in movement.poses
        if body.startswith("foot")
    }


def kinematic_terms(
    movement: TrialProgram,
    at: Trial,
    noise: TrackingNoise,
    effects: Effects | None = None,
    *,
    encoders: bool = True,
) -> list[Tracking]:
    """Tracking of coordinates and velocities.

    Args:
        movement: the trial's variables.
        at: measured values at the nodes.
        noise: standard deviations.
        effects: effects of unknown errors.
        encoders: whether the device is tracked, too.
    """
    grid, names = movement.grid, movement.coordinates
    device = names.is_device_joint
    of_device = 1.0 if encoders else np.inf

    def of_pose(length: float, degrees: float) -> tuple:
        return length, length, np.deg2rad(degrees)

    foot_q = of_pose(noise.foot_m, noise.foot_pitch_deg)
    foot_v = of_pose(noise.foot_velocity_m_s, noise.foot_pitch_rate_deg_s)
    root_q, root_v, feet = foot_q, foot_v, {}
    if len(at.soles) > 1:
        root_q = of_pose(noise.pelvis_m, noise.angle_deg)
        root_v = of_pose(noise.pelvis_velocity_m_s, noise.velocity_deg_s)
        feet = measured_feet(movement, at)
    joint_q = np.where(device, of_device * noise.exo_angle_deg, noise.angle_deg)
    joint_v = np.where(
        device, of_device * noise.exo_velocity_deg_s, noise.velocity_deg_s
    )
    sigma_q = np.r_[root_q, np.deg2rad(joint_q)]
    sigma_v = np.r_[root_v, np.deg2rad(joint_v)]
    terms = [
        _against_the_foot(
            movement, grid.q, at.q, sigma_q, "position", effects and effects.q
        ),
        _against_the_foot(
            movement, grid.v, at.v, sigma_v, "velocity", effects and effects.v
        ),
    ]
    for foot, measured in feet.items():
        pose = movement.poses[foot]
        terms += [
            Tracking(pose[:, :3], measured[:, :3], foot_q, role="position"),
            Tracking(pose[:, 3:], measured[:, 3:], foot_v, role="velocity"),
        ]
    return terms


def has_encoders(trial: Trial) -> bool:
    """Whether the device's angles are its own, not taken as the human's."""
    return "exoskeleton_angles" not in trial.provenance


def _against_the_foot(
    movement: TrialProgram, variables, target, sigma, role, effects
) -> Tracking:
    """Tracking of coordinates with an error that all joints at the foot share.

    In a device: encoders measure to a tenth of a degree, but relative to the
    foot, and a contact of few spheres turns the foot differently from the
    measurement, by as much as its pitch is uncertain. The covariance is
    diag(sigma^2) + u u^T, u from `shared_noise`.
    """
    if effects is None:
        return Tracking(variables, target, sigma, role=role)
    known = np.isfinite(sigma)
    own = sigma[known]
    # (I + w w^T)^(-1/2), w = u/sigma, however far apart the noises are.
    turn = shared_noise(movement.tree, sigma)[known] / own
    size = np.sqrt(1.0 + turn @ turn)
    root = np.eye(len(own)) - np.outer(turn, turn) / (size * (size + 1.0))
    rows = np.eye(len(sigma))
    rows[np.ix_(known, known)] = own[:, None] * root / own
    return Tracking(
        variables,
        target @ rows.T,
        sigma,
        np.broadcast_to(rows, (len(target), *rows.shape)),
        role,
        np.einsum("rq,nqk->nrk", rows, effects),
    )


def shared_noise(tree: PlanarTree, sigma: np.ndarray) -> np.ndarray:
    """Error (nq,) of all coordinates if the foot turns by its pitch's noise.

    Args:
        tree: zero if its root is a pelvis.
        sigma: (nq,) standard deviations of the coordinates, or of their rates.
    """
    return foot_turn(tree) * (sigma[2] if tree.root.startswith("foot") else 0.0)


def foot_turn(tree: PlanarTree) -> np.ndarray:
    """Change (nq,) of all coordinates if only the root link turns, by 1 rad."""
    links = [tree.root, *(child for _, child in tree.joints.values())]
    columns = np.flatnonzero(tree.coordinates.is_angle)
    return tree.turned_alone(links, columns)[0]


def ground_terms(
    movement: TrialProgram, at: Trial, noise: TrackingNoise
) -> list[Tracking]:
    """Tracking of ground reaction and centre of pressure (CoP).

    The CoP as M_y + CoP F_z with the noise of the CoP times the mean force,
    which avoids dividing by a varying force; only where the foot is loaded.
    """
    terms = []
    for side, measured in at.soles.items():
        loaded = measured.is_loaded
        # Segments of one foot bear its force together.
        wrenches = [
            wrench
            for body, wrench in movement.grounds.items()
            if side == "both" or body.endswith(f"_{side}")
        ]
        forces = np.hstack([wrench[:, :2] for wrench in wrenches])
        loads = np.hstack([wrench[:, 1:] for wrench in wrenches])
        added = np.tile(np.eye(2), len(wrenches))
        rows = np.ones((len(loaded), 1, loads.shape[1]))
        rows[:, 0, 0::2] = np.where(loaded, measured.cop_x, 0.0)[:, None]
        # The CoP of a foot that is always in the air is not tracked.
        reference = 1.0
        if loaded.any():
            reference = _mean(measured.force_z, at.times, loaded)
        spread = np.where(loaded, noise.cop_m * reference, np.inf)[:, None]
        terms += [
            Tracking(
                forces,
                measured.force,
                noise.force_n,
                np.broadcast_to(added, (len(loaded), *added.shape)),
            ),
            Tracking(loads, np.zeros((len(loaded), 1)), spread, rows),
        ]
    return terms


def _mean(values: np.ndarray, times: np.ndarray, used=slice(None)) -> float:
    """Mean over time of values (n,), whatever the spacing of the grid."""
    lengths = stands_for(np.diff(times))
    return float(np.average(values[used], weights=lengths[used]))


@dataclass(frozen=True)
class Answer:
    """Change of drive and spring torques if a device moves otherwise.

    The torque is the measured one plus slope times angles, less `there`.

    Attributes:
        times: (n,) from the trial's start [s].
        slope: (n, m, m) of the torques by the device's angles [N m/rad].
        there: (n, m) slope times the angles at which torques are as measured
            [N m].
        springs: (m,) stiffness, within slope, of springs whose angle was
            measured by encoders, with their errors [N m/rad].
    """

    times: np.ndarray
    slope: np.ndarray
    there: np.ndarray
    springs: np.ndarray

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`slope` and `there` at other times (k,)."""
        return tuple(
            CubicSpline(self.times, x)(times) for x in (self.slope, self.there)
        )

    def given(self, trial: Trial, times: np.ndarray) -> np.ndarray:
        """Torque (k, m) added to the measured one along a trial [N m].

        Args:
            trial: solved; gives the device's angles.
            times: (k,) [s].
        """
        slope, there = self.at(times)
        q = CubicSpline(trial.times, trial.q)(times)
        angles = q[:, trial.coordinates.device_columns]
        return np.einsum("nij,nj->ni", slope, angles) - there


def torque_terms(
    movement: TrialProgram,
    at: Trial,
    noise,
    effects: Effects | None = None,
    *,
    device: bool = True,
    answer: Answer | None = None,
) -> list[Tracking]:
    """Tracking of joint moments if known; otherwise they are minimised.

    With two legs, a leg's moments are the more certain the less its foot bears,
    since their main error is the point at which the ground's force acts. Toes
    are not tracked: how foot and toes share a plate's force is not known. The
    device is tracked if `device`, at its measured moments plus what `answer`
    adds if it moves otherwise; a controller gives other moments.
    """
    if at.moments is None:
        return [minimised(movement.torque, noise.torque_nm)]
    names = movement.coordinates
    of_device = noise.exo_moment_nm if device else np.inf
    sigma = np.where(names.is_device_joint, of_device, noise.moment_nm)
    sigma = np.tile(sigma, (len(at.times), 1))
    # A device's joints may have any names: take the human joint beside each.
    beside = [
        (names.follows(name) if name in names.device else name) or ""
        for name in names.joints
    ]
    weight = _mean(at.ground.force_z, at.times)
    for side, wrench in at.feet.items():
        share = np.clip(wrench.force_z / weight, 0.0, 1.0)
        # Filters smear touch-down and lift-off: keep stance's noise near them.
        near = np.abs(at.times[:, None] - at.times) < _SMEARED_S
        share = np.where(near, share, 0.0).max(axis=1)
        own = [name.endswith(f"_{side}") for name in beside]
        sigma[:, own] *= np.maximum(share, _IN_SWING)[:, None]
    sigma[:, [name.startswith("toes") for name in names.joints]] = np.inf
    by_errors = effects and effects.moments
    if answer is None or not device:
        return [Tracking(movement.torque, at.moments, sigma, effects=by_errors)]
    own, m = names.is_device_joint, names.num_joints
    if effects is not None:
        by_errors = by_errors.copy()
        told = effects.q[:, names.device_columns]
        by_errors[:, own] += answer.springs[:, None] * told
    slope, there = answer.at(at.times)
    rows = np.zeros((*at.moments.shape, m + own.sum()))
    rows[:, :, :m] = np.eye(m)
    rows[:, own, m:] = -slope
    target = at.moments.copy()
    target[:, own] -= there
    angles = movement.grid.q[:, names.device_columns]
    variables = np.hstack([movement.torque, angles])
    return [Tracking(variables, target, sigma, rows, effects=by_errors)]


def normal_force_terms(
    movement: TrialProgram, at: Trial, noise, effects: Effects | None = None
) -> list[Tracking]:
    """Tracking of the cuffs' normal forces that mats measured."""
    return [
        Tracking(
            variables[:, [NORMAL]],
            at.cuffs[cuff].normal[:, None],
            noise.normal_force_n,
            effects=effects and effects.normal[cuff][:, None],
        )
        for cuff, variables in movement.cuffs.items()
        if cuff in at.cuffs
    ]
