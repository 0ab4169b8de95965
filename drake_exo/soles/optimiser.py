"""Solve a shape problem with IPOPT, or any solver of a MathematicalProgram.

IPOPT is called directly (its wheel brings MUMPS) with a limited-memory
Hessian: second derivatives of a simulation are not worth their cost.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drake_exo.soles.problem import ShapeProblem

_STATUS = {
    0: "optimal",
    1: "acceptable",
    2: "infeasible",
    3: "steps became tiny",
    -1: "iteration limit",
    -2: "restoration failed",
    5: "stopped by the user",
    -13: "invalid number",
}


@dataclass
class Optimum:
    """Outcome of one solve.

    Attributes:
        p: Best feasible design met (least cost with violation below 1e-4),
            or the last where none was feasible.
        cost: Its scaled cost.
        status: IPOPT's return code in words.
        optimal: Whether IPOPT's tolerance was met.
        error: IPOPT's last dual infeasibility.
        multipliers: Of the constraints.
        violation: Largest constraint violation at p.
        trace: Rows (iteration, cost, violation, dual infeasibility).
    """

    p: np.ndarray
    cost: float
    status: str
    optimal: bool
    error: float
    multipliers: np.ndarray
    violation: float
    trace: list


def minimise(
    problem: ShapeProblem,
    p0: np.ndarray,
    bounds: tuple[float, float],
    iterations: int = 60,
    tolerance: float = 1e-4,
    on_iterate: Callable[[int, "Optimum"], None] | None = None,
    options: dict | None = None,
) -> Optimum:
    """Run IPOPT from p0.

    Args:
        problem: What to minimise.
        p0: First design; clipped into the bounds.
        bounds: Lower and upper bound of every coefficient.
        iterations: IPOPT iterations.
        tolerance: IPOPT's scaled optimality error.
        on_iterate: Called with the iteration and the best so far.
        options: More options of IPOPT.
    """
    import ipyopt

    n, m = problem.spline.count, len(problem.names())
    best = Optimum(
        np.clip(p0, *bounds), np.inf, "", False, np.inf, np.zeros(m), np.inf,
        [],
    )  # fmt: skip
    cache = {}
    stopped = []

    def guarded(function):
        """Ctrl-C must not surface inside IPOPT's C++: stop at the next
        iteration instead, and raise it again afterwards.
        """

        def call(*args):
            try:
                return function(*args)
            except KeyboardInterrupt:
                stopped.append(True)
                return np.nan

        return call

    def derivatives(p):
        key = p.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = problem.derivatives(p)
            consider(p)
        return cache[key]

    def consider(p):
        """Keep the best: derivatives are asked for at accepted points."""
        cost = problem.cost(p)
        violation = max(0.0, -float(problem.constraints(p).min()))
        feasible = violation < 1e-4
        if (feasible and (cost < best.cost or best.violation >= 1e-4)) or (
            not feasible and violation < best.violation
        ):
            best.p, best.cost, best.violation = p.copy(), cost, violation

    def gradient(p, out):
        out[()] = derivatives(p)[0]

    def constraints(p, out):
        out[()] = problem.constraints(p)

    def jacobian(p, out):
        out[()] = derivatives(p)[1].ravel()

    def watch(mode, iteration, cost, inf_pr, inf_du, *_):
        best.trace.append((iteration, cost, inf_pr, inf_du))
        best.error = inf_du
        if on_iterate is not None:
            on_iterate(iteration, best)
        return not stopped

    rows, columns = np.divmod(np.arange(m * n), n)
    solver = ipyopt.Problem(
        n,
        np.full(n, bounds[0]),
        np.full(n, bounds[1]),
        m,
        np.zeros(m),
        np.full(m, 1e20),
        (rows, columns),
        (np.arange(0), np.arange(0)),
        guarded(problem.cost),
        guarded(gradient),
        guarded(constraints),
        guarded(jacobian),
        intermediate_callback=watch,
        ipopt_options={
            "hessian_approximation": "limited-memory",
            "limited_memory_max_history": 20,
            "max_iter": iterations,
            "tol": tolerance,
            "acceptable_iter": 0,
            "mu_strategy": "adaptive",
            # Far outside the limits a simulation says little.
            "theta_max_fact": 0.1,
            "nlp_scaling_method": "none",
            "bound_relax_factor": 0.0,
            "print_level": 0,
            "sb": "yes",
            **(options or {}),
        },
    )
    multipliers = np.zeros(m)
    _, _, status = solver.solve(best.p.copy(), mult_g=multipliers)
    if stopped:
        raise KeyboardInterrupt
    best.status = _STATUS.get(status, f"IPOPT code {status}")
    best.optimal = status == 0
    best.multipliers = multipliers
    return best


def mathematical_program(problem: ShapeProblem, bounds: tuple[float, float]):
    """The same problem as a MathematicalProgram, for SNOPT and others.

    Returns:
        The program and its decision variables.
    """
    from pydrake.autodiffutils import ExtractValue, InitializeAutoDiff
    from pydrake.solvers import MathematicalProgram

    prog = MathematicalProgram()
    n = problem.spline.count
    p = prog.NewContinuousVariables(n, "p")
    prog.AddBoundingBoxConstraint(*bounds, p)

    def with_gradient(function, row):
        def evaluate(x):
            if x.dtype == float:
                return np.atleast_1d(function(x))
            value = ExtractValue(x).ravel()
            gradient, jacobian = problem.derivatives(value)
            J = gradient[None] if row else jacobian
            y = np.atleast_1d(function(value))
            # A linear chain: derivatives of x need not be the identity.
            dx = np.array([xi.derivatives() for xi in x])
            return InitializeAutoDiff(y, gradient=J @ dx).ravel()

        return evaluate

    cost = with_gradient(problem.cost, True)
    prog.AddCost(lambda x: cost(x)[0], vars=p, description="c")
    m = len(problem.names())
    prog.AddConstraint(
        with_gradient(problem.constraints, False),
        np.zeros(m),
        np.full(m, np.inf),
        vars=p,
        description=", ".join(problem.names()),
    )
    return prog, p
