"""Solving a SparseProgram with IPOPT, with progress and a way to cancel.

If one strategy fails, `solve` tries the next. Reading a `Solution` of a failed
solve raises until it is unsealed.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.solvers import IpoptSolver, MathematicalProgram
from pydrake.solvers import SolverOptions as DrakeSolverOptions

from drake_exo.nlp import stop_on_interrupt
from drake_exo.nlp.infeasibility import Excess, relax
from drake_exo.nlp.ipopt_library import Outcome, run_ipopt
from drake_exo.nlp.program import (
    BatchedProgram,
    nonlinear_constraints,
    nonlinear_costs,
    variable_bounds,
    variable_scaling,
)
from drake_exo.nlp.sparse import SparseProgram, violation

# Status of a solve that the user stopped.
STOPPED_BY_USER = "stopped by the user"
# IPOPT's ApplicationReturnStatus.
_STATUS = {
    0: "solved",
    1: "solved to acceptable level",
    2: "converged to a point of local infeasibility",
    3: "search direction becomes too small",
    4: "iterates diverge",
    5: STOPPED_BY_USER,
    6: "feasible point found",
    -1: "maximum number of iterations exceeded",
    -2: "restoration failed",
    -3: "error in step computation",
    -4: "maximum CPU time exceeded",
    -5: "maximum wall-clock time exceeded",
    -10: "not enough degrees of freedom",
    -11: "invalid problem definition",
    -12: "invalid option",
    -13: "invalid number: a function returned NaN or infinity",
    -100: "unrecoverable exception",
    -101: "exception outside IPOPT",
    -102: "insufficient memory",
    -199: "internal error",
}
_STOPPED = 5
_ACCEPTED = (0, 1)
_INFEASIBLE = "infeasible: no solution keeps all bounds"
# An attempt is given up after so many iterations in IPOPT's restoration, or
# without lowering the larger of infeasibility and optimality error by a tenth.
_RESTORING = 12
_STALLED = 40
_ELASTIC_ITERATIONS = 80
_ELASTIC_TOLERANCE = 1e-4
_FEASIBLE = 1e-4
# Strategies with exact second derivatives, and from near a solution.
_EXACT = ("exact", "near_exact")
_NEARBY = ("near", "near_exact")


@dataclass(frozen=True)
class SolverOptions:
    """How to solve.

    Attributes:
        tolerance: IPOPT's scaled optimality error.
        max_iterations: largest number of iterations of each attempt.
        strategies: tried one after the other until one succeeds. "adaptive" and
            "monotone" are updates of the barrier with the program's Hessian
            (adaptive is faster, monotone survives strong noise). "exact", also
            adaptive, adds all curvature from the start, which tight bounds may
            need. "patient", skipped if bounds are known that may be in the way,
            is adaptive and never given up. `near_solution` puts "near" or
            "near_exact" before them, for starts near a solution (the barrier
            begins low, and bounds do not repel).
        extra: further IPOPT options by name.
    """

    tolerance: float = 1e-6
    max_iterations: int = 300
    strategies: tuple[str, ...] = ("adaptive", "exact", "monotone", "patient")
    extra: dict = field(default_factory=dict)

    def near_solution(self, exact: bool = False) -> "SolverOptions":
        """A copy for a start near a solution, see `strategies`."""
        first = "near_exact" if exact else "near"
        return replace(self, strategies=(first, *self.strategies))


@dataclass(frozen=True)
class Iterate:
    """One iteration as progress and checkpoints see it.

    Attributes:
        x: program variables, or None before the first evaluation; during
            IPOPT's feasibility restoration, those at which it began.
    """

    strategy: str
    iteration: int
    objective: float
    infeasibility: float
    x: np.ndarray | None


class SealedSolutionError(RuntimeError):
    """A failed solution was read without `unseal()`.

    >>> failed = Solution(False, "no progress", 3, 0.0, 1.0, [], 1, 1, 1)
    >>> try:
    ...     failed.values([0])
    ... except SealedSolutionError as error:
    ...     print(str(error)[:30])
    the solve failed (no progress)
    """


@dataclass
class Solution:
    """Result of one solve.

    Attributes:
        success: whether the solver met its tolerances.
        status: in words.
        iterations: number of iterations, all attempts together.
        objective: cost at the returned point.
        infeasibility: largest scaled constraint violation there.
        worst_constraints: (name, violation), largest first.
        binding: bounds that exclude each other if the problem is infeasible;
            bounds that may do so if it could not be solved otherwise.
        active_bounds: names of free parameters that sit at a bound.
        num_variables, num_constraints, jacobian_nonzeros: sizes of the problem
            that the solver saw.
        seconds: time by part ("build", "solve", "linear_algebra_and_ipopt"...).
        evaluations: number of calls by part.
        strategy: strategy of the last attempt.
        is_sealed: whether reading values raises.
    """

    success: bool
    status: str
    iterations: int
    objective: float
    infeasibility: float
    worst_constraints: list[tuple[str, float]]
    num_variables: int
    num_constraints: int
    jacobian_nonzeros: int
    strategy: str = ""
    binding: list[Excess] = field(default_factory=list)
    active_bounds: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    evaluations: dict[str, int] = field(default_factory=dict)
    _values: np.ndarray = field(default=None, repr=False)
    is_sealed: bool = field(init=False, repr=False)

    def __post_init__(self):
        self.is_sealed = not self.success

    @property
    def was_stopped(self) -> bool:
        """Whether the user stopped the solve."""
        return self.status == STOPPED_BY_USER

    def unseal(self) -> "Solution":
        """Allow a failed solution to be read; returns itself."""
        self.is_sealed = False
        return self

    def check(self) -> None:
        """Refuse to read a failed solve.

        Raises:
            SealedSolutionError: if the solve failed and nobody unsealed it.
        """
        if self.is_sealed:
            raise SealedSolutionError(
                f"the solve failed ({self.status}); its values are not a "
                "solution. Call unseal() to look at them all the same. "
                + self.explain()
            )

    def values(self, indices: np.ndarray) -> np.ndarray:
        """Values of program variables, shape as indices; see `check`."""
        self.check()
        return self._values[indices]

    def raw_values(self) -> np.ndarray:
        """All program variables even if sealed, for reports of failures."""
        return self._values

    def explain(self) -> str:
        """Why the solve failed, as text: bounds, or the worst constraints."""
        if self.success:
            return "all constraints hold"
        if self.binding:
            return (
                (
                    "Bounds that are in the way, and the least change found: "
                    if self.status == _INFEASIBLE
                    else "Bounds that may be in the way: "
                )
                + "; ".join(map(str, self.binding))
                + "."
            )
        worst = "; ".join(
            f"{name} off by {off:.3g}"
            for name, off in self.worst_constraints
            if off > _FEASIBLE
        )
        if worst:
            return f"Worst constraints (scaled): {worst}."
        remedy = "resume" if self.was_stopped else "allow more iterations"
        if self.status == _STATUS[-13]:
            remedy = "look for settings far from the usual, as a noise near 0"
        return (
            "All constraints hold: the point is feasible but not yet optimal; "
            f"{remedy}."
        )


def solve(
    problem: SparseProgram,
    guess: np.ndarray,
    options: SolverOptions | None = None,
    on_iterate: Callable[[Iterate], None] | None = None,
) -> Solution:
    """Solve from a guess of all program variables.

    Ctrl-C stops after the running iteration. A stopped or failed solve returns
    its best iterate in a sealed solution.

    Args:
        problem: the compiled program.
        guess: (num_vars,) program variables.
        options: tolerances and strategies; IPOPT options set in the
            MathematicalProgram (`SetSolverOption`) take precedence.
        on_iterate: called once for each iteration.

    Raises:
        InputError: IPOPT has no such option, or refuses its value.
        KeyboardInterrupt: Ctrl-C after the last iteration.
    """
    options = options or SolverOptions()
    own = _program_options(problem.program.prog)
    options = replace(options, extra={**options.extra, **own})
    start = time.perf_counter()
    # Count this solve alone: a program may be solved from several guesses.
    problem.seconds.clear()
    problem.evaluations.clear()
    y0 = problem.restrict(guess)
    watches, binding, infeasible = [], None, False
    exact = problem.exact_hessian
    stop = threading.Event()

    def tell(iterate):
        if iterate.x is not None:
            problem.program.show(iterate.x)
        if on_iterate is not None:
            on_iterate(iterate)

    soft = replace(
        options,
        tolerance=max(_ELASTIC_TOLERANCE, options.tolerance),
        max_iterations=min(_ELASTIC_ITERATIONS, options.max_iterations),
    )

    def relaxed(program, y):
        """Solve an elastic program; None if that fails."""
        watch = _Watch(program, "elastic", tell, stop)
        found = _attempt(program, y, soft, watch)
        return found.x if found.status in _ACCEPTED else None

    with stop_on_interrupt(stop):
        for strategy in options.strategies:
            if strategy == "patient" and binding:
                continue  # it takes long, and bounds explain the failure
            watch = _Watch(problem, strategy, tell, stop)
            watches.append(watch)
            problem.exact_hessian = exact or strategy in _EXACT
            try:
                found = _attempt(problem, y0, options, watch)
            finally:
                problem.exact_hessian = exact
            y, objective, status = found.x, found.cost, found.status
            if status in _ACCEPTED or infeasible or stop.is_set():
                break
            if binding is None and watch.best_key[0] > 0.0:
                # Either bounds exclude each other, or a point at which none
                # has to yield is a better start.
                y0, binding, infeasible = relax(problem, y0, relaxed)
    best = min(watches, key=lambda w: w.best_key).best
    if status not in _ACCEPTED and best is not None:
        y = best
        objective = problem.objective(y)
    total = sum(w.iterations for w in watches)
    elapsed = time.perf_counter() - start
    solution = _solution(problem, y, objective, status, watch, total, elapsed)
    if solution.success:
        if stop.is_set():  # heard too late for this solve, not for the next
            raise KeyboardInterrupt
        return solution
    if stop.is_set():
        solution.status = STOPPED_BY_USER
        return solution
    solution.binding = binding or []
    if infeasible:
        solution.status = _INFEASIBLE
    elif watch.gave_up and status == _STOPPED:
        solution.status = "no progress"
    return solution


class _Watch:
    """Follows one attempt: best iterate, progress, interruption.

    Attributes:
        gave_up: whether it stopped the attempt for lack of progress.
        best, best_key: best iterate, its violation (0 if feasible) and cost.
    """

    def __init__(self, problem, strategy, on_iterate, stop):
        self.gave_up = False
        self._restoring = 0
        self._least, self._least_at = np.inf, 0
        self.problem = problem
        self.strategy = strategy
        self.on_iterate = on_iterate
        self.stop = stop
        self.current = None
        self.best = None
        self.best_key = (np.inf, np.inf)
        self.iterations = 0

    def accepted(self, y):
        self.current = y.copy()

    def __call__(self, mode, iteration, objective, inf_pr, inf_du, *_):
        self.iterations = iteration
        # In restoration (mode 1) IPOPT reports points that are not seen here.
        # Its violation counts slacks as well, so it is computed anew.
        if mode == 0 and self.current is not None and np.isfinite(objective):
            off = violation(self.problem, self.current)
            # Feasible iterates compare by cost, others by violation.
            key = (off if off > _FEASIBLE else 0.0, objective)
            if key < self.best_key:
                self.best_key, self.best = key, self.current
        y = self.current
        x = None if y is None else self.problem.expand(y)
        self.on_iterate(Iterate(self.strategy, iteration, objective, inf_pr, x))
        self._judge(mode, iteration, max(inf_pr, inf_du))
        return not (self.stop.is_set() or self.gave_up)

    def _judge(self, mode, iteration, error):
        self._restoring += mode != 0
        if error < 0.9 * self._least:
            self._least, self._least_at = error, iteration
        self.gave_up = self.strategy != "patient" and (
            self._restoring > _RESTORING
            or iteration - self._least_at > _STALLED
        )


# A barrier of the usual height would first lead away from the solution. On fine
# grids entries differ by 1e11; with the usual pivot tolerance of 1e-6 MUMPS
# miscounts negative eigenvalues, and IPOPT corrects a curvature that was right:
# objectives rose a hundredfold and needed fifty iterations to come back.
# Initial multipliers by least squares, which the first step finds anyway, need
# a factorisation that fills up: 66 of 71 s of a rise on a sole's law, or more.
_NEAR = {
    "mumps_pivtol": 1e-3,
    "constr_mult_init_max": 0.0,
    "mu_strategy": "monotone",
    "mu_init": 1e-5,
    "bound_push": 1e-6,
    "bound_frac": 1e-6,
    "slack_bound_push": 1e-6,
    "slack_bound_frac": 1e-6,
}


def _program_options(prog: MathematicalProgram) -> dict:
    """IPOPT options set in a MathematicalProgram, by name."""
    return prog.solver_options().options.get(IpoptSolver.id().name(), {})


def _ipopt_options(options, strategy) -> dict:
    return {
        "tol": options.tolerance,
        # On fine grids rounding ends the descent just above the tolerance; for
        # walking steps on the finest grids at 20 times the tolerance.
        "acceptable_tol": (
            options.tolerance * (100.0 if strategy in _NEARBY else 10.0)
        ),
        "acceptable_iter": 3,
        "acceptable_obj_change_tol": 1e-7,
        "max_iter": options.max_iterations,
        "mu_strategy": ("monotone" if strategy == "monotone" else "adaptive"),
        "print_level": 0,
        "sb": "yes",
        "linear_solver": "mumps",
        # QAMD measured fastest on collocation problems with contact: it sets
        # aside the rows of unknowns that all nodes share, over which 0 (AMD)
        # takes up to a tenth of a solve.
        "mumps_pivot_order": 6,
        # MUMPS' matching takes the longer the more rows share a parameter, up
        # to half of a solve, and has never saved an iteration.
        "mumps_permuting_scaling": 0,
        # Extra memory for delayed pivots in % of the estimate, doubled if it
        # does not suffice; IPOPT's 1000 % is allocated at each factorisation.
        "mumps_mem_percent": 20,
        # Bounds are relaxed while it searches; results keep them.
        "honor_original_bounds": "yes",
        **(_NEAR if strategy in _NEARBY else {}),
        **options.extra,
    }


def _attempt(problem, y0, options, watch) -> Outcome:
    def gradient(y):
        watch.accepted(y)
        return problem.gradient(y)

    problem.start_again()
    # A trial step may overflow; IPOPT shortens it if a value is infinite.
    with np.errstate(all="ignore"):
        return run_ipopt(
            y0,
            (problem.y_lower, problem.y_upper),
            (problem.g_lower, problem.g_upper),
            problem.jacobian_structure,
            problem.hessian_structure,
            problem.objective,
            gradient,
            problem.constraints,
            problem.jacobian,
            problem.hessian,
            watch,
            options=_ipopt_options(options, watch.strategy),
        )


def _solution(problem, y, objective, status, watch, iterations, elapsed):
    off = violation(problem, y)
    values = problem.expand(y)
    values.flags.writeable = False  # all later results are read from them
    seconds = {"solve": elapsed, **problem.seconds}
    seconds["linear_algebra_and_ipopt"] = elapsed - sum(
        problem.seconds.values()
    )
    return Solution(
        success=status in _ACCEPTED,
        status=_STATUS.get(status, f"unknown status {status}"),
        iterations=iterations,
        objective=float(objective),
        infeasibility=float(off),
        worst_constraints=problem.worst_constraints(y),
        num_variables=problem.num_unknowns,
        num_constraints=problem.num_constraints,
        jacobian_nonzeros=len(problem.jacobian_structure[0]),
        strategy=watch.strategy,
        seconds=seconds,
        evaluations=dict(problem.evaluations),
        _values=values,
    )


def solve_with_drake(
    program: BatchedProgram,
    guess: np.ndarray,
    options: SolverOptions | None = None,
) -> Solution:
    """Solve with Drake's own IpoptSolver from a guess of x, for comparison.

    It evaluates binding by binding and without a Hessian, so it suits small
    cases only; reaching the same optimum verifies the batched derivatives. It
    ignores the program's variable scaling, without which it does not converge
    here, so it is given a copy in scaled variables.
    """
    options = options or SolverOptions()
    settings = DrakeSolverOptions()
    solver = IpoptSolver()
    given = {"tol": options.tolerance, "max_iter": options.max_iterations}
    for name, value in (given | _program_options(program.prog)).items():
        settings.SetOption(solver.solver_id(), name, value)
    start = time.perf_counter()
    scale = variable_scaling(program.prog)
    scaled = _scaled_copy(program.prog, scale)
    result = solver.Solve(scaled, guess / scale, settings)
    elapsed = time.perf_counter() - start
    values = scale * result.GetSolution(scaled.decision_variables())
    told = result.get_solver_details().ConvertStatusToString()
    problem = SparseProgram(program)
    y = problem.restrict(values)
    worst = problem.worst_constraints(y)
    return Solution(
        success=result.is_success(),
        status=_STATUS[0] if result.is_success() else told.lower(),
        iterations=0,
        objective=float(result.get_optimal_cost()),
        infeasibility=max((v for _, v in worst), default=0.0),
        worst_constraints=worst,
        num_variables=program.prog.num_vars(),
        num_constraints=problem.num_constraints,
        jacobian_nonzeros=len(problem.jacobian_structure[0]),
        strategy="drake",
        seconds={"solve": elapsed},
        _values=values,
    )


def _scaled_copy(prog: MathematicalProgram, scale) -> MathematicalProgram:
    """A copy of the program in the variables z = x / scale."""
    scaled = MathematicalProgram()
    z = scaled.NewContinuousVariables(prog.num_vars(), "z")
    lower, upper = variable_bounds(prog)
    scaled.AddBoundingBoxConstraint(lower / scale, upper / scale, z)

    def parts(binding):
        index = prog.FindDecisionVariableIndices(binding.variables())
        return binding.evaluator(), scale[index], z[index]

    for binding in (
        *prog.linear_constraints(),
        *prog.linear_equality_constraints(),
    ):
        linear, unit, variables = parts(binding)
        bounds = linear.lower_bound(), linear.upper_bound()
        scaled.AddLinearConstraint(
            linear.GetDenseA() * unit, *bounds, variables
        )
    for binding in prog.linear_costs():
        linear, unit, variables = parts(binding)
        scaled.AddLinearCost(linear.a() * unit, linear.b(), variables)
    for binding in prog.quadratic_costs():
        cost, unit, variables = parts(binding)
        Q = cost.Q() * np.outer(unit, unit)
        scaled.AddQuadraticCost(Q, cost.b() * unit, cost.c(), variables)
    for binding in nonlinear_constraints(prog):
        evaluator, unit, variables = parts(binding)
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        scaled.AddConstraint(_scaled(evaluator, unit), *bounds, variables)
    for binding in nonlinear_costs(prog):
        evaluator, unit, variables = parts(binding)
        cost = _scaled(evaluator, unit)
        scaled.AddCost(lambda x, f=cost: f(x)[0], variables)
    return scaled


def _scaled(evaluator, unit):
    return lambda z: evaluator.Eval(unit * z)
