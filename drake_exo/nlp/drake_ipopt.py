"""Drake's own IpoptSolver on the same program, for comparison.

It evaluates binding by binding and knows no Hessian, so it suits small cases
only; that it reaches the same optimum checks the batched derivatives. It
ignores the program's variable scaling, without which it does not converge
here, so it is given a copy in scaled variables.
"""

import time

import numpy as np
from pydrake.solvers import IpoptSolver, MathematicalProgram
from pydrake.solvers import SolverOptions as DrakeSolverOptions

from drake_exo.nlp.ipopt import Solution, SolverOptions
from drake_exo.nlp.program import (
    BatchedProgram,
    nonlinear_constraints,
    nonlinear_costs,
    variable_bounds,
    variable_scaling,
)
from drake_exo.nlp.sparse import SparseProgram


def solve(
    program: BatchedProgram,
    guess: np.ndarray,
    options: SolverOptions | None = None,
) -> Solution:
    """Solve with pydrake.solvers.IpoptSolver from a guess of x."""
    options = options or SolverOptions()
    settings = DrakeSolverOptions()
    solver = IpoptSolver()
    settings.SetOption(solver.solver_id(), "tol", options.tolerance)
    settings.SetOption(solver.solver_id(), "max_iter", options.max_iterations)
    start = time.perf_counter()
    scale = variable_scaling(program.prog)
    scaled = _scaled_copy(program.prog, scale)
    result = solver.Solve(scaled, guess / scale, settings)
    elapsed = time.perf_counter() - start
    values = scale * result.GetSolution(scaled.decision_variables())
    problem = SparseProgram(program)
    y = problem.restrict(values)
    worst = problem.worst_constraints(y)
    return Solution(
        success=result.is_success(),
        status=result.get_solution_result().name,
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
    """The same program in z = x / scale."""
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
