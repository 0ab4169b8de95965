"""Solving a SparseProgram with IPOPT, with progress and a way to cancel."""

import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import ipyopt
import numpy as np

from drake_exo.nlp.solution import Solution
from drake_exo.nlp.sparse import SparseProgram

# IPOPT's ApplicationReturnStatus.
_STATUS = {
    0: "solved",
    1: "solved to acceptable level",
    2: "converged to a point of local infeasibility",
    3: "search direction becomes too small",
    4: "iterates diverge",
    5: "stopped by the user",
    6: "feasible point found",
    -1: "maximum number of iterations exceeded",
    -2: "restoration failed",
    -3: "error in step computation",
    -4: "maximum CPU time exceeded",
    -10: "not enough degrees of freedom",
    -11: "invalid problem definition",
    -12: "invalid option",
    -13: "invalid number: a function returned NaN or infinity",
    -100: "unrecoverable exception",
    -102: "insufficient memory",
    -199: "internal error",
}
_STOPPED = 5
_ACCEPTED = (0, 1)


@dataclass(frozen=True)
class SolverOptions:
    """How to solve.

    Attributes:
        tolerance: IPOPT's scaled optimality error.
        max_iterations: for each attempt.
        strategies: barrier strategies; the next is tried by itself when one
            fails (adaptive is faster, monotone survives strong noise).
        pivot_order: MUMPS' ordering; 2 (AMF) measured fastest on
            collocation problems, about half the time of the default.
        extra: further IPOPT options by name.
    """

    tolerance: float = 1e-6
    max_iterations: int = 300
    strategies: tuple[str, ...] = ("adaptive", "monotone")
    pivot_order: int = 2
    extra: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Iterate:
    """What progress and checkpoints see of one iteration.

    Attributes:
        x: program variables, or None before the first evaluation.
    """

    strategy: str
    iteration: int
    objective: float
    infeasibility: float
    optimality: float
    elapsed_seconds: float
    x: np.ndarray | None


class _Watch:
    """Follows one attempt: best iterate, progress, interruption."""

    def __init__(self, problem, strategy, start, on_iterate, stop):
        self.problem = problem
        self.strategy = strategy
        self.start = start
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
        if self.current is not None and np.isfinite(objective):
            # Feasible iterates compare by cost, others by violation.
            feasible = inf_pr <= 1e-4
            key = (0.0, objective) if feasible else (inf_pr, objective)
            if key < self.best_key:
                self.best_key, self.best = key, self.current
        if self.on_iterate is not None:
            y = self.current
            self.on_iterate(
                Iterate(
                    self.strategy,
                    iteration,
                    objective,
                    inf_pr,
                    inf_du,
                    time.perf_counter() - self.start,
                    None if y is None else self.problem.expand(y),
                )
            )
        return not self.stop.is_set()


def solve(
    problem: SparseProgram,
    guess: np.ndarray,
    options: SolverOptions | None = None,
    on_iterate: Callable[[Iterate], None] | None = None,
) -> Solution:
    """Solve from a guess of all program variables.

    Ctrl-C stops after the running iteration; the best iterate is returned in
    a sealed solution.

    Args:
        problem: the compiled program.
        guess: (num_vars,) program variables.
        options: tolerances and strategies.
        on_iterate: called once for each iteration.
    """
    options = options or SolverOptions()
    start = time.perf_counter()
    y0 = problem.restrict(guess)
    total = 0
    stop = threading.Event()
    with _stop_on_interrupt(stop):
        for strategy in options.strategies:
            watch = _Watch(problem, strategy, start, on_iterate, stop)
            y, objective, status = _attempt(problem, y0, options, watch)
            total += watch.iterations
            if status in _ACCEPTED or status == _STOPPED:
                break
    if status not in _ACCEPTED and watch.best is not None:
        y = watch.best
        objective = problem.objective(y)
    elapsed = time.perf_counter() - start
    return _solution(problem, y, objective, status, watch, total, elapsed)


def _attempt(problem, y0, options, watch):
    def gradient(y, out):
        watch.accepted(y)
        out[:] = problem.gradient(y)

    def constraints(y, out):
        out[:] = problem.constraints(y)

    def jacobian(y, out):
        out[:] = problem.jacobian(y)

    def hessian(y, multipliers, factor, out):
        out[:] = problem.hessian(y, multipliers, factor)

    settings = {
        "tol": options.tolerance,
        "max_iter": options.max_iterations,
        "mu_strategy": watch.strategy,
        "print_level": 0,
        "sb": "yes",
        "linear_solver": "mumps",
        "mumps_pivot_order": options.pivot_order,
        "fixed_variable_treatment": "make_parameter",
        **options.extra,
    }
    nlp = ipyopt.Problem(
        problem.num_unknowns,
        _finite(problem.y_lower),
        _finite(problem.y_upper),
        problem.num_constraints,
        _finite(problem.g_lower),
        _finite(problem.g_upper),
        problem.jacobian_structure,
        problem.hessian_structure,
        problem.objective,
        gradient,
        constraints,
        jacobian,
        hessian,
        intermediate_callback=watch,
        ipopt_options=settings,
    )
    y, objective, status = nlp.solve(y0.copy())
    return y, objective, status


def _finite(bounds):
    """IPOPT's infinity."""
    return np.clip(bounds, -2e19, 2e19)


def _solution(problem, y, objective, status, watch, iterations, elapsed):
    g = problem.constraints(y)
    violation = np.maximum(problem.g_lower - g, g - problem.g_upper)
    seconds = {"solve": elapsed, **problem.seconds}
    seconds["linear_algebra_and_ipopt"] = elapsed - sum(
        problem.seconds.values()
    )
    return Solution(
        success=status in _ACCEPTED,
        status=_STATUS.get(status, f"unknown status {status}"),
        iterations=iterations,
        objective=float(objective),
        infeasibility=float(max(violation.max(initial=0.0), 0.0)),
        worst_constraints=problem.worst_constraints(y),
        num_variables=problem.num_unknowns,
        num_constraints=problem.num_constraints,
        jacobian_nonzeros=len(problem.jacobian_structure[0]),
        strategy=watch.strategy,
        seconds=seconds,
        evaluations=dict(problem.evaluations),
        _values=problem.expand(y),
    )


class _stop_on_interrupt:  # noqa: N801 (a context manager)
    """Turns the first Ctrl-C into a request to stop; the second raises."""

    def __init__(self, stop):
        self._stop = stop
        self._previous = None

    def __enter__(self):
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._handle)

    def _handle(self, number, frame):
        if self._stop.is_set():
            raise KeyboardInterrupt
        self._stop.set()

    def __exit__(self, *_):
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)
