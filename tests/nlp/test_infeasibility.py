"""Faults of a program: told before a solve, and found after one."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from program_derivatives import check_derivatives
from small_programs import PUSHES, pushed_cart, valleys

from drake_exo.errors import InputError
from drake_exo.nlp import infeasibility, ipopt
from drake_exo.nlp.infeasibility import ElasticProgram
from drake_exo.nlp.program import BatchedProgram, Substitution
from drake_exo.nlp.sparse import SparseProgram


def test_what_is_wrong_is_named():
    program, x = valleys()
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


@pytest.mark.parametrize("shape", [(5,), (7,), (6, 1)])
def test_a_guess_of_another_program_is_refused(shape):
    """A longer one would be read from its begin on."""
    problem = SparseProgram(valleys()[0])
    with pytest.raises(InputError, match="but the program has 6 variables"):
        infeasibility.check(problem, np.zeros(shape), {})


def test_crossed_bounds_are_refused():
    program, x = valleys()
    program.prog.AddBoundingBoxConstraint(1.0, 2.0, x[0, 0])
    program.prog.AddBoundingBoxConstraint(-2.0, 0.0, x[0, 0])
    with pytest.raises(InputError, match="lower bound above"):
        infeasibility.check(SparseProgram(program), np.zeros(6), {})


class _Root:
    sparsity = np.ones((1, 1), bool)

    def evaluate(self, x, data):
        with np.errstate(invalid="ignore"):
            return np.sqrt(x)

    def jacobian(self, x, data):
        return 0.5 / np.sqrt(x)[:, None]


def test_a_function_that_is_not_finite_is_named():
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(2, "x")
    program.add_constraints("root", _Root(), x[:, None], 0.0, 1.0)
    problem = SparseProgram(program)
    with pytest.raises(InputError, match=r"root\[1\] row 0 is not finite"):
        infeasibility.check(problem, np.array([1.0, -1.0]), {})


def test_the_limit_in_the_way_is_named_with_what_it_would_take():
    program, *_ = pushed_cart(distance=10.0)  # five of 1 reach 5
    solution = ipopt.solve(SparseProgram(program), np.zeros(2 * PUSHES + 1))
    assert solution.status.startswith("infeasible")
    (found,) = solution.binding
    assert found.name.startswith("push at ")
    assert found.needed == pytest.approx(2e-3)
    assert found.bound == pytest.approx(1e-3)
    assert "push at " in solution.explain()
    assert "its bound is 0.001 kN" in solution.explain()
    # The opposite limit, by its sign.
    program, *_ = pushed_cart(distance=-10.0)
    solution = ipopt.solve(SparseProgram(program), np.zeros(2 * PUSHES + 1))
    (found,) = solution.binding
    assert found.needed == pytest.approx(-2e-3)
    assert found.bound == pytest.approx(-1e-3)


def test_limits_that_suffice_are_not_blamed():
    program, _, push = pushed_cart(distance=4.9)
    problem = SparseProgram(program)
    solution = ipopt.solve(problem, np.zeros(2 * PUSHES + 1))
    assert solution.success and solution.binding == []
    pushes = solution.values(program.indices(push))
    np.testing.assert_allclose(pushes, 0.98, atol=1e-6)

    def attempt(elastic, y):
        return problem.restrict(solution.raw_values())

    y, binding, infeasible = infeasibility.relax(
        problem, np.zeros(problem.num_unknowns), attempt
    )
    assert binding == [] and not infeasible
    np.testing.assert_allclose(
        problem.expand(y)[program.indices(push)], 0.98, atol=1e-6
    )


def test_nothing_is_said_where_no_elastic_program_could_be_solved():
    program, _, _ = pushed_cart(distance=10.0)
    problem = SparseProgram(program)
    y = np.zeros(problem.num_unknowns)
    same, *found = infeasibility.relax(problem, y, lambda elastic, at: None)
    assert found == [[], False] and same is y


def test_what_gives_way_to_soft_springs_alone_is_no_verdict(monkeypatch):
    """It is a hint, of a problem that nothing solved."""
    program, *_ = pushed_cart(distance=4.9)
    problem = SparseProgram(program)
    y = np.zeros(problem.num_unknowns)
    soft = np.full(problem.num_unknowns, 1.2)
    answers = iter([soft, None])
    same, (found,), infeasible = infeasibility.relax(
        problem, y, lambda elastic, at: next(answers)
    )
    assert same is y and found.name.startswith("push at ") and not infeasible

    tried = []

    def attempt(program, y, options, watch):
        tried.append(watch.strategy)
        return SimpleNamespace(x=y, cost=np.inf, status=-2)

    monkeypatch.setattr(ipopt, "relax", lambda *_: (y, [found], infeasible))
    monkeypatch.setattr(ipopt, "_attempt", attempt)
    solution = ipopt.solve(problem, np.zeros(2 * PUSHES + 1))
    assert tried == ["adaptive", "exact", "monotone"]
    assert solution.status == "restoration failed"
    assert "may be in the way" in solution.explain()


def _straight_cart():
    """The cart at places on a line: their bounds become rows."""
    program, place, _ = pushed_cart(distance=10.0, limit=0.4)
    index = program.indices(place)
    line = Substitution(
        index,
        sp.csr_array(
            np.column_stack([np.ones(len(index)), np.arange(len(index))])
        ),
        np.zeros(len(index)),
        np.ones(2),
        np.ones(len(index)),
    )
    return SparseProgram(program, (line,))


def test_substituted_variables_give_way_as_rows():
    problem = _straight_cart()
    elastic = ElasticProgram(problem, ("state",), 10.0)
    assert elastic.num_springs == 2  # first and last place
    # Held at 0 and 10, the line starts at 1 and ends at 11.
    y = np.r_[np.zeros(PUSHES), 1.0, 2.0]
    np.testing.assert_allclose(elastic.excess(y), [1.0, 1.0])
    assert elastic.objective(y) == pytest.approx(
        problem.objective(y) + 0.5 * 10.0 * 2.0
    )
    (found,) = elastic.binding(y)
    assert str(found) in (
        "place at 0 s would be 1 m, its bound is 0 m",
        "place at 5 s would be 11 m, its bound is 10 m",
    )
    rows, _ = problem.rows.bounding([0, 5])
    assert not np.isfinite(elastic.g_lower[rows]).any()


@pytest.mark.parametrize("kinds", [("limit",), ("state",), ("limit", "state")])
def test_derivatives_of_an_elastic_program(kinds):
    problem = _straight_cart()
    elastic = ElasticProgram(problem, kinds, 30.0)
    rng = np.random.default_rng(4)
    ny = problem.num_unknowns
    beyond = rng.uniform(0.5, 2.0, ny)  # each bound
    assert (elastic.excess(beyond) != 0.0).all()
    within = 0.2 * beyond  # the limits, whose springs are slack
    assert (elastic.excess(within) == 0.0).any() == ("limit" in kinds)
    multipliers = rng.normal(size=problem.num_constraints)  # all is affine
    for y in beyond, within:
        assert check_derivatives(elastic, y) < 1e-7
        values = elastic.hessian(y, multipliers, 0.7)
        H = sp.coo_array((values, elastic.hessian_structure), (ny, ny))
        H = H.toarray()
        H += np.tril(H, -1).T
        expected = [
            0.7 * (elastic.gradient(y + h) - elastic.gradient(y - h)) / 2e-5
            for h in 1e-5 * np.eye(ny)
        ]
        np.testing.assert_allclose(H, expected, atol=1e-6)
