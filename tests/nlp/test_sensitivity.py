"""The response of an optimum against the problem solved once more."""

import numpy as np
import pytest
import scipy.sparse as sp
from small_programs import valleys

from drake_exo.nlp import ipopt
from drake_exo.nlp.ipopt import SolverOptions
from drake_exo.nlp.program import BatchedProgram, LinearKernel
from drake_exo.nlp.sensitivity import Optimum, response
from drake_exo.nlp.sparse import SparseProgram

N = 7


class Off(LinearKernel):
    """Of a variable from what `data` says."""

    def __init__(self):
        super().__init__([[1.0]])

    def evaluate(self, x, data):
        return x - data


def _problem(pull=None, rise=0.0, level=1.0, held=0.0):
    """A chain pulled to a wave, over a ground, with one end held.

    Linear in all, so that Gauss-Newton's is the Hessian, and the response is
    exact while no bound changes sides.
    """
    program = BatchedProgram()
    prog = program.prog
    x = prog.NewContinuousVariables(N, "x")
    wave = np.sin(1.3 * np.arange(N))
    program.add_residuals("wave", Off(), x[:, None], wave[:, None])
    links = np.stack([x[:-1], x[1:]], axis=1)
    program.add_residuals("link", LinearKernel([[-0.5, 0.5]]), links)
    program.add_constraints(
        "end", LinearKernel([[1.0, 1.0]]), links[:1], level, level
    )
    program.add_constraints(  # active in the trough of the wave only
        "ground", LinearKernel([[1.0]]), x[3:, None], rise - 0.1, np.inf
    )
    prog.AddBoundingBoxConstraint(-5.0, 0.35, x[1])  # active
    if held:
        prog.AddQuadraticCost(held * np.eye(N), np.zeros(N), x)
    if pull is not None:
        prog.AddLinearCost(pull, x)
    for variable in x[::2]:
        prog.SetVariableScaling(variable, 10.0)
    return SparseProgram(program)


def _optimum(problem):
    options = SolverOptions(tolerance=1e-11, extra={"bound_relax_factor": 0.0})
    solution = ipopt.solve(problem, np.zeros(N), options)
    assert solution.success
    return problem.restrict(solution.raw_values())


@pytest.fixture(scope="module")
def solved():
    problem = _problem()
    y = _optimum(problem)
    found = response(problem, y, np.arange(N))
    g = problem.constraints(y)
    active = g - problem.g_lower < 1e-6
    # The test means something only if both kinds of rows are there.
    assert active[0] and 0 < active[1:].sum() < len(active) - 1
    assert y[1] == pytest.approx(problem.y_upper[1], abs=1e-8)
    return problem, y, found


def test_response_to_a_pull_equals_another_solve(solved):
    problem, y, found = solved
    pull = 1e-3 * np.random.default_rng(0).normal(size=N)
    other = _problem(pull=pull)
    actual = _optimum(other) - y
    change = other.gradient(y) - problem.gradient(y)
    predicted = found.by_gradient @ change
    scale = np.abs(actual).max()
    assert scale > 1e-6
    np.testing.assert_allclose(predicted, actual, atol=1e-4 * scale)
    # The planted error: the other sign is not taken for the response.
    assert np.abs(predicted + actual).max() > scale


def test_response_to_bounds_equals_another_solve(solved):
    problem, y, found = solved
    for change in ({"rise": 1e-4}, {"level": 1.0 + 1e-4}):
        other = _problem(**change)
        actual = _optimum(other) - y
        moved = other.g_lower - problem.g_lower
        predicted = found.by_bounds @ moved
        scale = np.abs(actual).max()
        assert scale > 1e-6
        np.testing.assert_allclose(predicted, actual, atol=1e-4 * scale)


def test_unknowns_at_a_bound_and_rows_that_are_slack_have_no_part(solved):
    problem, y, found = solved
    assert (found.by_gradient[1] == 0.0).all()
    assert (found.by_gradient[:, 1] == 0.0).all()
    slack = problem.constraints(y) - problem.g_lower > 1e-3
    assert slack.any() and (found.by_bounds[:, slack] == 0.0).all()


def test_some_unknowns_respond_as_among_all(solved):
    problem, y, found = solved
    few = response(problem, y, np.array([5, 1, 2]))
    np.testing.assert_allclose(
        few.by_gradient, found.by_gradient[[5, 1, 2]], atol=1e-9
    )
    np.testing.assert_allclose(
        few.by_bounds, found.by_bounds[[5, 1, 2]], atol=1e-9
    )


def test_curvature_left_out_is_that_of_a_problem_without_it(solved):
    _, y, found = solved
    held = BatchedProgram()
    x = held.prog.NewContinuousVariables(N, "x")
    held.prog.AddQuadraticCost(3.0 * np.eye(N), np.zeros(N), x)
    for variable in x[::2]:
        held.prog.SetVariableScaling(variable, 10.0)
    more = sp.diags_array(
        SparseProgram(held).hessian(np.zeros(N), np.zeros(0), 1.0)
    )
    stiffer = _problem(held=3.0)
    counted = response(stiffer, y, np.arange(N))
    scale = np.abs(found.by_gradient).max()
    assert np.abs(counted.by_gradient - found.by_gradient).max() > 0.1 * scale
    without = response(stiffer, y, np.arange(N), without=more)
    np.testing.assert_allclose(
        without.by_gradient, found.by_gradient, atol=1e-9 * scale
    )


def test_gauss_newton_s_response_is_that_of_an_exact_program_too():
    program, _ = valleys(radius=1.2)
    y = ipopt.solve(SparseProgram(program), np.zeros(6)).raw_values()
    found, exact = (
        response(SparseProgram(program, exact_hessian=e), y, np.arange(6))
        for e in (False, True)
    )
    np.testing.assert_allclose(
        exact.by_gradient, found.by_gradient, rtol=1e-9, atol=1e-15
    )


def _with_fixed(value, linear=False):
    """A residual and a constraint, or row, that a fixed variable enters."""
    program = BatchedProgram()
    prog = program.prog
    x, p = prog.NewContinuousVariables(2, "x"), prog.NewContinuousVariables(1)
    prog.AddBoundingBoxConstraint(value, value, p[0])
    prog.SetVariableScaling(p[0], 3.0)
    program.add_residuals(
        "pull", LinearKernel([[1.0, 0.0, 0.7], [0.3, 1.0, 0.0]]), _row(x, p)
    )
    tie = np.array([[1.0, -2.0, -1.5]])
    if linear:
        prog.AddLinearEqualityConstraint(tie, [1.0], _row(x, p)[0])
    else:
        program.add_constraints("tie", LinearKernel(tie), _row(x, p), 1.0, 1.0)
    return SparseProgram(program), program.indices(p)


def _row(x, p):
    return np.concatenate([x, p])[None]


@pytest.mark.parametrize("linear", [False, True])
def test_the_optimal_cost_follows_a_fixed_variable(linear):
    costs = []
    for value in (0.8 - 1e-4, 0.8 + 1e-4):
        problem, _ = _with_fixed(value, linear)
        y = ipopt.solve(
            problem, np.zeros(3), SolverOptions(tolerance=1e-11)
        ).raw_values()
        costs.append(problem.objective(problem.restrict(y)))
    problem, index = _with_fixed(0.8, linear)
    x = ipopt.solve(
        problem, np.zeros(3), SolverOptions(tolerance=1e-11)
    ).raw_values()
    optimum = Optimum(problem, problem.restrict(x), np.zeros(0, int))
    expected = (costs[1] - costs[0]) / 2e-4
    assert abs(expected) > 0.1
    assert optimum.cost_by_fixed(index)[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("bordered", [False, True])
def test_the_optimum_follows_a_fixed_variable(bordered, linear):
    """Where it goes, against two other solves; linear, so to rounding."""

    def solved(value):
        problem, _ = _with_fixed(value, linear)
        return ipopt.solve(
            problem, np.zeros(3), SolverOptions(tolerance=1e-11)
        ).raw_values()

    problem, index = _with_fixed(0.8, linear)
    x = solved(0.8)
    border = np.array([1]) if bordered else np.zeros(0, int)
    optimum = Optimum(problem, problem.restrict(x), border)
    found = problem.unknowns.matrix @ optimum.by_fixed(index)[:, 0]
    expected = (solved(1.0) - solved(0.6)) / 0.4
    expected[index] = 0.0  # is no unknown
    assert np.abs(expected).min(initial=1.0, where=expected != 0) > 0.05
    np.testing.assert_allclose(found, expected, atol=1e-5)
    # By a pull on one of them: the constraint keeps x0 - 2 x1.
    change = optimum.by_gradient(np.array([[1.0], [0.0]]))[:, 0]
    # Least of (x0 + c)^2/2 + (0.3 x0 + x1 + c)^2/2 + x0, x1 = (x0 - d)/2.
    slope = -1.0 / (1.0 + 0.8**2)
    np.testing.assert_allclose(change, [slope, 0.5 * slope], atol=1e-5)
