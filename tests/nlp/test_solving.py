"""Solving: status, sealing, strategies, interruption, pre-flight."""

import os
import signal

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.nlp import drake_ipopt, infeasibility, ipopt
from drake_exo.nlp.ipopt import SealedSolutionError, SolverOptions
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sparse import SparseProgram


class _Rosenbrock:
    """Residuals (1 - x, 10 (y - x^2)) of each pair."""

    sparsity = np.array([[True, False], [True, True]])

    def evaluate(self, x, data):
        return np.stack(
            [1.0 - x[:, 0], 10.0 * (x[:, 1] - x[:, 0] ** 2)], axis=1
        )

    def jacobian(self, x, data):
        J = np.zeros((len(x), 2, 2))
        J[:, 0, 0], J[:, 1, 0], J[:, 1, 1] = -1.0, -20.0 * x[:, 0], 10.0
        return J


class _Circle:
    sparsity = np.ones((1, 2), bool)

    def evaluate(self, x, data):
        return np.sum(x**2, axis=1)[:, None]

    def jacobian(self, x, data):
        return 2.0 * x[:, None, :]


def _program(radius=3.0):
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(6, "x").reshape(3, 2)
    program.add_residuals("valley", _Rosenbrock(), x)
    program.add_constraints("disc", _Circle(), x, -np.inf, radius)
    return program, x


def test_solves_and_reads():
    program, x = _program()
    solution = ipopt.solve(SparseProgram(program), np.zeros(6))
    assert solution.success
    assert not solution.is_sealed
    np.testing.assert_allclose(
        solution.values(program.indices(x)), 1.0, atol=1e-5
    )
    assert solution.num_variables == 6
    assert solution.jacobian_nonzeros == 6
    assert solution.evaluations["jacobian"] > 1
    assert "solve" in solution.seconds


def test_drakes_own_solver_reaches_the_same_optimum():
    program, x = _program(radius=1.2)
    ours = ipopt.solve(
        SparseProgram(program), np.zeros(6), SolverOptions(tolerance=1e-9)
    )
    theirs = drake_ipopt.solve(
        program, np.zeros(6), SolverOptions(tolerance=1e-9)
    )
    assert ours.success
    assert theirs.success
    assert ours.objective == pytest.approx(theirs.objective, rel=1e-7)
    index = program.indices(x)
    np.testing.assert_allclose(
        ours.values(index), theirs.values(index), atol=1e-5
    )


def test_a_failed_solution_is_sealed_and_names_constraints():
    program, x = _program()
    program.add_constraints("far", _Circle(), x[:1], 9.0, 9.0)
    solution = ipopt.solve(
        SparseProgram(program),
        np.full(6, 0.5),
        SolverOptions(max_iterations=60),
    )
    assert not solution.success
    with pytest.raises(SealedSolutionError, match=r"unseal\(\)"):
        solution.values(program.indices(x))
    assert "disc[0]" in solution.explain() or "far[0]" in solution.explain()
    assert np.isfinite(solution.unseal().values(program.indices(x))).all()


def test_a_second_strategy_is_tried_when_the_first_fails():
    program, _ = _program()
    used = []
    solution = ipopt.solve(
        SparseProgram(program),
        np.zeros(6),
        SolverOptions(max_iterations=2),
        on_iterate=lambda it: used.append(it.strategy),
    )
    assert not solution.success
    assert used[0] == "adaptive"
    assert "monotone" in used


def test_interruption_keeps_the_best_iterate():
    program, x = _program()
    seen = []

    def interrupt(iterate):
        seen.append(iterate)
        if iterate.iteration == 3:
            os.kill(os.getpid(), signal.SIGINT)

    solution = ipopt.solve(
        SparseProgram(program), np.zeros(6), on_iterate=interrupt
    )
    assert solution.status == "stopped by the user"
    assert solution.is_sealed
    values = solution.unseal().values(program.indices(x))
    assert np.isfinite(values).all()
    feasible = [it.objective for it in seen if it.infeasibility <= 1e-4]
    assert solution.objective <= min(feasible) + 1e-12
    # The handler of before is back.
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_preflight_names_what_is_wrong():
    program, x = _program()
    problem = SparseProgram(program)
    guess = np.zeros(6)
    guess[3] = np.nan
    with pytest.raises(InputError, match=r"x\(3\) is nan"):
        infeasibility.check(problem, guess, {})
    lonely = program.prog.NewContinuousVariables(1, "lonely")[0]
    problem = SparseProgram(program)
    index = int(program.prog.FindDecisionVariableIndex(lonely))
    with pytest.raises(InputError, match="lonely influences nothing"):
        infeasibility.check(problem, np.full(7, 0.3), {"lonely": index})
    known = {"x0": int(program.indices(x)[0, 0])}
    infeasibility.check(problem, np.full(7, 0.3), known)


def test_preflight_refuses_crossed_bounds():
    program, x = _program()
    program.prog.AddBoundingBoxConstraint(1.0, 2.0, x[0, 0])
    program.prog.AddBoundingBoxConstraint(-2.0, 0.0, x[0, 0])
    with pytest.raises(InputError, match="lower bound above"):
        infeasibility.check(SparseProgram(program), np.zeros(6), {})
