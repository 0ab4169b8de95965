"""The bridge against dense references and finite differences."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from program_derivatives import DerivativeError, check_derivatives

from drake_exo.nlp import ipopt
from drake_exo.nlp.program import BatchedProgram, LinearKernel, Substitution
from drake_exo.nlp.sparse import SparseProgram, violation

_N = 6


class _Curve:
    """f = (x0 x1 - data, sin x2 + x0): small, nonlinear."""

    sparsity = np.array([[True, True, False], [True, False, True]])

    def evaluate(self, x, data):
        return np.stack(
            [x[:, 0] * x[:, 1] - data[:, 0], np.sin(x[:, 2]) + x[:, 0]], axis=1
        )

    def jacobian(self, x, data):
        J = np.zeros((len(x), 2, 3))
        J[:, 0, 0], J[:, 0, 1] = x[:, 1], x[:, 0]
        J[:, 1, 0], J[:, 1, 2] = 1.0, np.cos(x[:, 2])
        return J


class _Wrong(_Curve):
    def jacobian(self, x, data):
        J = super().jacobian(x, data)
        J[:, 1, 2] *= 1.001
        return J


def _program(kernel=None):
    """Everything that may stand in a program, mixed."""
    program = BatchedProgram()
    prog = program.prog
    x = prog.NewContinuousVariables(3 * _N, "x").reshape(_N, 3)
    p = prog.NewContinuousVariables(2, "p")
    data = np.linspace(0.1, 0.5, _N)[:, None]
    program.add_constraints("curve", kernel or _Curve(), x, data=data)
    program.add_residuals("pull", _Curve(), x, data=0.5 * data)
    prog.AddLinearConstraint(x[0, 0] + 2.0 * x[1, 1] <= 3.0)
    prog.AddLinearEqualityConstraint(x[2, 2] - p[0] == 0.25)
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x[:, 0])
    prog.AddBoundingBoxConstraint(0.7, 0.7, p[1])
    prog.AddQuadraticCost((x[0, 0] - 1.0) ** 2 + 3.0 * x[0, 1] * x[0, 0])
    prog.AddLinearCost(2.0 * p[0] + 1.0)
    prog.AddConstraint(
        lambda z: [z[0] ** 2 + z[1]],
        [-1.0],
        [9.0],
        [x[3, 0], p[1]],
        description="loose",
    )
    prog.AddCost(lambda z: z[0] ** 4 + z[0] * z[1], [x[4, 1], p[0]])
    for variable in x[:, 1]:
        prog.SetVariableScaling(variable, 10.0)
    return program, x, p


def _point(problem, seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, problem.num_unknowns)


def _dense_jacobian(problem, y):
    rows, columns = problem.jacobian_structure
    J = sp.coo_array(
        (problem.jacobian(y), (rows, columns)),
        shape=(problem.num_constraints, problem.num_unknowns),
    )
    return J.toarray()


def _dense_hessian(problem, y, multipliers, factor):
    rows, columns = problem.hessian_structure
    ny = problem.num_unknowns
    L = sp.coo_array(
        (problem.hessian(y, multipliers, factor), (rows, columns)),
        shape=(ny, ny),
    ).toarray()
    return L + np.tril(L, -1).T


def test_costs_and_constraints_equal_drakes_own_evaluation():
    program, _, _ = _program()
    problem = SparseProgram(program)
    y = _point(problem)
    x = problem.expand(y)
    prog = program.prog
    cost = sum(prog.EvalBinding(b, x)[0] for b in prog.GetAllCosts())
    assert problem.objective(y) == pytest.approx(cost, rel=1e-13)
    bindings = [
        b
        for b in prog.GetAllConstraints()
        if "BoundingBox" not in type(b.evaluator()).__name__
    ]
    expected = np.concatenate([prog.EvalBinding(b, x) for b in bindings])
    np.testing.assert_allclose(
        np.sort(problem.constraints(y)), np.sort(expected), atol=1e-13
    )


def test_derivatives_agree_with_differences():
    program, _, _ = _program()
    problem = SparseProgram(program)
    assert check_derivatives(problem, _point(problem)) < 1e-7


def test_a_wrong_derivative_is_caught_and_named():
    program, _, _ = _program(_Wrong())
    problem = SparseProgram(program)
    with pytest.raises(DerivativeError, match=r"curve\[\d\] row 1"):
        check_derivatives(problem, _point(problem), tolerance=1e-6)


def test_a_check_of_nothing_fails():
    program = BatchedProgram()
    program.prog.NewContinuousVariables(3, "x")
    problem = SparseProgram(program)
    with pytest.raises(DerivativeError, match="nothing was checked"):
        check_derivatives(problem, np.zeros(3))


def test_exact_hessian_equals_differences_of_the_gradient():
    program, _, _ = _program()
    problem = SparseProgram(program, exact_hessian=True)
    y = _point(problem)
    rng = np.random.default_rng(1)
    multipliers = rng.normal(size=problem.num_constraints)

    def lagrangian_gradient(z):
        return 0.7 * problem.gradient(z) + multipliers @ _dense_jacobian(
            problem, z
        )

    h = 1e-6
    expected = np.stack(
        [
            (lagrangian_gradient(y + h * e) - lagrangian_gradient(y - h * e))
            / (2 * h)
            for e in np.eye(problem.num_unknowns)
        ]
    )
    found = _dense_hessian(problem, y, multipliers, 0.7)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_a_kernel_without_curved_inputs_adds_nothing_to_the_hessian():
    """A controller: differences of its derivatives would take too long."""

    class Straight(_Curve):
        curved_inputs = np.zeros(3, bool)

    found = []
    for kernels in ([_Curve()], [_Curve(), Straight()]):
        program = BatchedProgram()
        x = program.prog.NewContinuousVariables(3 * _N, "x").reshape(_N, 3)
        for k, kernel in enumerate(kernels):
            data = np.full((_N, 1), 0.3)
            program.add_constraints(f"curve {k}", kernel, x, data=data)
        problem = SparseProgram(program, exact_hessian=True)
        y = _point(problem)
        multipliers = np.linspace(-1.0, 2.0, 2 * _N)
        multipliers = np.r_[multipliers, np.ones(2 * _N * (len(kernels) - 1))]
        found.append(_dense_hessian(problem, y, multipliers, 1.0))
    assert np.abs(found[0]).max() > 0.1
    np.testing.assert_array_equal(found[0], found[1])


def test_gauss_newton_hessian_is_the_residuals_jacobian_squared():
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(3 * _N, "x").reshape(_N, 3)
    data = np.full((_N, 1), 0.3)
    program.add_residuals("pull", _Curve(), x, data=data)
    problem = SparseProgram(program)
    y = _point(problem)
    J = np.zeros((2 * _N, 3 * _N))
    for t, block in enumerate(_Curve().jacobian(y.reshape(_N, 3), data)):
        J[2 * t : 2 * t + 2, 3 * t : 3 * t + 3] = block
    found = _dense_hessian(problem, y, np.zeros(0), 1.0)
    np.testing.assert_allclose(found, J.T @ J, atol=1e-13)


def test_fixed_variables_leave_and_scaling_is_undone():
    program, x, p = _program()
    problem = SparseProgram(program)
    assert problem.num_unknowns == 3 * _N + 1
    values = problem.expand(_point(problem))
    assert values[program.indices(p)[1]] == 0.7
    y = problem.restrict(values)
    assert np.array_equal(problem.restrict(list(values)), y)  # any sequence
    np.testing.assert_allclose(problem.expand(y), values, atol=1e-12)
    ones = np.zeros(program.prog.num_vars())
    ones[program.indices(x[:, 1])] = 10.0
    assert np.isclose(problem.restrict(ones), 1.0).sum() >= _N


def test_nonzeros_are_only_the_structural_ones():
    program, _, _ = _program()
    problem = SparseProgram(program)
    # Curve 4 an instance, linear rows 2 + 2, the loose one has a fixed input.
    assert len(problem.jacobian_structure[0]) == 4 * _N + 4 + 1


def test_a_substitution_drops_the_constraints_it_satisfies():
    program = BatchedProgram()
    prog = program.prog
    x = prog.NewContinuousVariables(4, "x")
    # x1 - x0 = x2 and x3 = x1, satisfied by two unknowns.
    program.add_constraints(
        "tie", LinearKernel([[-1.0, 1.0, -1.0, 0.0]]), x[None]
    )
    program.add_constraints(
        "copy", LinearKernel([[0.0, 1.0, 0.0, -1.0]]), x[None]
    )
    prog.AddBoundingBoxConstraint(0.0, 5.0, x[2])
    prog.AddQuadraticErrorCost(np.eye(4), [1.0, 2.0, 0.0, 4.0], x)
    basis = sp.csr_array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [1.0, 1.0]])
    reduced = SparseProgram(
        program,
        (
            Substitution(
                np.arange(4), basis, np.zeros(4), np.ones(2), np.ones(4)
            ),
        ),
    )
    assert reduced.num_unknowns == 2
    # Only the bound of x2 is left, as a row.
    assert reduced.num_constraints == 1
    y = np.array([0.3, 0.4])
    full = SparseProgram(program)
    x_value = reduced.expand(y)
    held = full.constraints(full.restrict(x_value))
    np.testing.assert_allclose(held, 0.0, atol=1e-14)
    assert reduced.objective(y) == pytest.approx(
        full.objective(full.restrict(x_value)), rel=1e-14
    )
    assert check_derivatives(reduced, y) < 1e-8


def test_rows_are_named():
    program, _, _ = _program()
    problem = SparseProgram(program)
    names = [problem.rows.name(i) for i in range(problem.num_constraints)]
    assert "curve[2] row 1" in names
    assert any(name.startswith("loose") for name in names)
    y = _point(problem)
    worst = problem.worst_constraints(y, 3)
    assert [v for _, v in worst] == sorted((v for _, v in worst), reverse=True)


def test_a_bound_that_a_substitution_leaves_is_met_where_it_is():
    """In units of the variable: where x is at its bound, so is the row."""
    program = BatchedProgram()
    prog = program.prog
    x = prog.NewContinuousVariables(2, "x")
    prog.SetVariableScaling(x[1], 10.0)
    prog.AddBoundingBoxConstraint(-3.0, 5.0, x[1])
    basis = sp.csr_array([[1.0, 0.0], [2.0, 1.0]])
    own = Substitution(
        np.arange(2), basis, np.array([0.5, 1.0]), np.ones(2), np.ones(2)
    )
    reduced = SparseProgram(program, (own,))
    assert reduced.num_constraints == 1
    for y0 in (0.0, 0.3):
        # x1 = 1 + 2 y0 + y1.
        for bound, side in ((-3.0, reduced.g_lower), (5.0, reduced.g_upper)):
            y = np.array([y0, bound - 1.0 - 2.0 * y0])
            assert reduced.expand(y)[1] == pytest.approx(bound)
            assert reduced.constraints(y) == pytest.approx(side)


@pytest.mark.parametrize(("shift", "left"), [(0.0, 0), (0.5, 2)])
def test_what_holds_by_the_substitution_alone_leaves(shift, left):
    """With values that are not zero: x1 - x0 = 2 as the basis says, or not."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(2, "x")
    program.add_constraints(
        "tie",
        LinearKernel([[-1.0, 1.0], [-2.0, 2.0]]),
        x[None],
        np.array([[2.0 + shift, 4.0]]),
        np.array([[2.0 + shift, 4.0]]),
    )
    own = Substitution(
        np.arange(2),
        sp.csr_array([[1.0], [1.0]]),
        np.array([0.0, 2.0]),
        np.ones(1),
        np.ones(2),
    )
    assert SparseProgram(program, (own,)).num_constraints == left


def test_the_most_violated_constraints_are_told():
    """By how much, on either side; what holds is not."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(4, "x")
    data = np.array([[1.0], [2.0], [3.0], [4.0]])

    class Line:
        sparsity = np.ones((1, 1), bool)

        def evaluate(self, x, data):
            return x + data

        def jacobian(self, x, data):
            return np.ones((len(x), 1, 1))

    program.add_constraints("line", Line(), x[:, None], 2.5, 3.5, data)
    problem = SparseProgram(program)
    y = problem.restrict(np.zeros(4))
    found = problem.worst_constraints(y)
    assert [v for _, v in found] == pytest.approx([1.5, 0.5, 0.5])
    names = [name for name, _ in found]
    assert names[0].startswith("line[0]")
    assert {n.split()[0] for n in names[1:]} == {"line[1]", "line[3]"}
    assert problem.worst_constraints(y, 1) == found[:1]
    assert violation(problem, y) == pytest.approx(1.5)
    watch = SimpleNamespace(strategy="adaptive")
    seconds = sum(problem.seconds.values())
    told = ipopt._solution(problem, y, 4.0, 0, watch, 9, seconds + 2.0)
    assert told.infeasibility == pytest.approx(1.5)
    assert told.worst_constraints == found
    left = told.seconds["linear_algebra_and_ipopt"]
    # Looking at the constraints once more takes next to nothing.
    assert left == pytest.approx(2.0, abs=0.2)
    high = problem.restrict(np.array([1.5, 1.0, 0.0, 2.0]))
    assert violation(problem, high) == pytest.approx(2.5)


def test_every_row_has_its_name():
    """In order: linear ones, then each batch's by instance."""
    program, x, _ = _program()
    program.add_constraints("more", _Curve(), x, data=np.ones((_N, 1)))
    problem = SparseProgram(program)
    names = [problem.rows.name(k) for k in range(problem.num_constraints)]
    for batch in ("curve", "more"):
        own = [n for n in names if n.startswith(batch)]
        outputs = len(own) // _N
        assert own == [
            f"{batch}[{k}] row {out}"
            for k in range(_N)
            for out in range(outputs)
        ]
    with pytest.raises(IndexError):
        problem.rows.name(problem.num_constraints)


def test_the_row_that_bounds_a_variable():
    """-1 for one without, also beyond the last, or where there is none."""
    program, *_ = _program()
    rows = SparseProgram(program).rows
    assert (rows.row_of(np.arange(4)) == -1).all()
    program = BatchedProgram()
    prog = program.prog
    x = prog.NewContinuousVariables(5, "x")
    prog.AddLinearConstraint(x[0] + x[2] <= 1.0)
    prog.AddBoundingBoxConstraint(0.0, 1.0, x[1])
    prog.AddBoundingBoxConstraint(0.0, 1.0, x[3])
    own = Substitution(
        np.arange(5),
        sp.eye_array(5, format="csr"),
        np.zeros(5),
        np.ones(5),
        np.ones(5),
    )
    rows = SparseProgram(program, (own,)).rows
    found = rows.row_of(np.arange(5))
    np.testing.assert_array_equal(found, [-1, 1, -1, 2, -1])
    bounding, variables = rows.bounding([0, 1, 3])
    np.testing.assert_array_equal(bounding, found[[1, 3]])
    np.testing.assert_array_equal(variables, [1, 3])


def test_fingerprint_tells_bounds_costs_and_structure_apart():
    def fingerprint(change=None):
        program, x, _ = _program()
        if change:
            change(program.prog, x)
        return SparseProgram(program).fingerprint()

    changes = (
        lambda prog, x: prog.AddBoundingBoxConstraint(-1.9, 2.0, x[0, 0]),
        lambda prog, x: prog.AddLinearCost(x[0, 1] + 0.0),
        lambda prog, x: prog.AddQuadraticCost(1e-3 * x[1, 2] ** 2),
        lambda prog, x: prog.AddLinearConstraint(x[0, 0] + x[5, 1] <= 9.0),
    )
    structure, values = fingerprint()
    same = fingerprint()
    assert same[0] == structure and np.array_equal(same[1], values)
    for change in changes:
        digest, found = fingerprint(change)
        assert digest != structure or (
            found.shape != values.shape
            or not np.allclose(found, values, 1e-6, 1e-6)
        )


def test_rows_and_unknowns_of_single_variables():
    program, x, p = _program()
    problem = SparseProgram(program)
    index = program.indices(x[:, 1])
    y = np.zeros(problem.num_unknowns)
    y[problem.unknowns.column_of(index)] = 1.0
    np.testing.assert_allclose(problem.expand(y)[index], 10.0)  # the scale
    fixed = program.indices(p)[1:]
    with pytest.raises(ValueError, match="not an unknown by itself"):
        problem.unknowns.column_of(fixed)
