"""Drake's own IpoptSolver on the same program, for comparison.

It evaluates binding by binding and knows no Hessian, so it suits small cases
only; that it reaches the same optimum checks the batched derivatives.
"""

import time

import numpy as np
from pydrake.solvers import IpoptSolver
from pydrake.solvers import SolverOptions as DrakeSolverOptions

from drake_exo.nlp.batch import BatchedProgram
from drake_exo.nlp.ipopt import SolverOptions
from drake_exo.nlp.solution import Solution
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
    result = solver.Solve(program.prog, guess, settings)
    elapsed = time.perf_counter() - start
    values = result.GetSolution(program.prog.decision_variables())
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
