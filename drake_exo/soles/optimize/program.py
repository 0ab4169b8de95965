"""A shape problem as a MathematicalProgram, for SNOPT and other solvers.

The way of `optimiser` (IPOPT with a learnt Hessian) needs fewer simulations;
this one is there to compare with.
"""

import numpy as np

from drake_exo.soles.optimize.optimizer import (
    AcceptedDesigns,
    Optimum,
    conclude,
)
from drake_exo.soles.optimize.problem import ShapeProblem

_STATUS = {
    1: "optimal",
    3: "optimal, but not to the accuracy asked for",
    13: "infeasible",
    32: "iteration limit",
    41: "no better point found",
}


class Program:
    """The problem as a MathematicalProgram.

    Where a simulation fails cost and constraints are NaN, which SNOPT takes
    as a rejected step.

    Args:
        problem: What to minimise.
        bounds: Lower and upper bound of every coefficient.
        derivatives: Gives gradient, without smoothness, and Jacobian at a
            design.

    Attributes:
        prog: The program.
        p: Its decision variables, (P,).
        stopped: Ctrl-C came, which must not surface in the solver's code;
            all is NaN from then on, so that it ends.
    """

    def __init__(self, problem: ShapeProblem, bounds, derivatives):
        from pydrake.solvers import MathematicalProgram

        self.problem, self.derivatives = problem, derivatives
        self.stopped = False
        self.prog = prog = MathematicalProgram()
        self.p = prog.NewContinuousVariables(problem.spline.count, "p")
        prog.AddBoundingBoxConstraint(*bounds, self.p)
        cost = self._with_gradient(problem.cost, 1, 0)
        prog.AddCost(lambda x: cost(x)[0], vars=self.p, description="c")
        m = len(problem.names())
        prog.AddConstraint(
            self._with_gradient(problem.constraints, m, 1),
            np.zeros(m),
            np.full(m, np.inf),
            vars=self.p,
            description=", ".join(problem.names()),
        )

    def _with_gradient(self, function, count: int, which: int):
        from pydrake.autodiffutils import ExtractValue, InitializeAutoDiff

        problem = self.problem

        def values(p, dx):
            y = np.atleast_1d(function(p))
            if dx is None or not np.isfinite(y).all():
                return y, np.nan
            gradient, jacobian = self.derivatives(p)
            gradient = gradient + problem.smoothness(p)[1]
            rows = jacobian if which else gradient
            # A linear chain: derivatives of x need not be the identity.
            return y, np.atleast_2d(rows) @ dx

        def evaluate(x):
            plain = x.dtype == float
            p = x if plain else ExtractValue(x).ravel()
            dx = None if plain else np.array([xi.derivatives() for xi in x])
            y = J = np.nan
            try:
                if not self.stopped:
                    y, J = values(p, dx)
            except KeyboardInterrupt:
                self.stopped = True
            y = np.broadcast_to(y, count)
            if plain:
                return y
            J = np.broadcast_to(J, (count, dx.shape[1]))
            return InitializeAutoDiff(y, gradient=J).ravel()

        return evaluate


def minimise_by_snopt(
    problem: ShapeProblem,
    p0: np.ndarray,
    bounds: tuple[float, float],
    iterations: int,
    tolerance: float,
    on_iterate=None,
) -> Optimum:
    """Run SNOPT from p0; arguments as for `optimiser.minimise`.

    `on_iterate` is called at designs whose derivatives SNOPT asks for.
    """
    from pydrake.solvers import SnoptSolver, SolverOptions

    best = Optimum(np.clip(p0, *bounds))
    p = best.p

    def note(design, cost, violation):
        best.trace.append((len(best.trace), cost, violation, np.nan))
        if on_iterate is not None:
            on_iterate(len(best.trace) - 1, best)

    options = SolverOptions()
    for name, value in (
        ("Major iterations limit", iterations),
        ("Major optimality tolerance", tolerance),
        ("Verify level", -1),
    ):
        options.SetOption(SnoptSolver.id(), name, value)
    derivatives = AcceptedDesigns(problem, best, note).at
    program = Program(problem, bounds, derivatives)
    result = SnoptSolver().Solve(program.prog, p, options)
    if program.stopped:
        raise KeyboardInterrupt
    details = result.get_solver_details()
    best.optimal = details.info == 1
    best.status = _STATUS.get(details.info, f"SNOPT info {details.info}")
    # Its multipliers are derivatives of the cost by the bounds.
    best.multipliers = -details.Fmul[1:]
    best.at_bounds = np.maximum(details.xmul, 0), np.maximum(-details.xmul, 0)
    conclude(problem, best, result.get_x_val(), bounds, derivatives)
    return best
