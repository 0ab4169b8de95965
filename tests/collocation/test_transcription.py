"""Both grids against independent formulas and a known solution."""

import numpy as np
import pytest

from drake_exo.collocation.transcription import (
    TRANSCRIPTIONS,
    HermiteSimpson,
    radau_points,
    stands_for,
)
from drake_exo.nlp import ipopt
from drake_exo.nlp.ipopt import SolverOptions
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sparse import SparseProgram

_GRIDS = sorted(TRANSCRIPTIONS)
_FINER = [1, 1, 2, 4, 8, 8, 4, 3, 2, 1, 1, 1]  # parts of twelve intervals


def _grid(name, num_dof=2, duration=0.8, intervals=12, parts=1):
    program = BatchedProgram()
    grid = TRANSCRIPTIONS[name](
        program, "t", num_dof, duration, intervals, parts
    )
    return program, grid


@pytest.mark.parametrize("name", _GRIDS)
def test_a_grid_is_split_where_it_is_asked_for(name):
    _, grid = _grid(name, parts=_FINER)
    assert grid.num_intervals == sum(_FINER)
    even = 0.8 / 12
    np.testing.assert_allclose(
        grid.steps, np.repeat(even / np.array(_FINER), _FINER)
    )
    assert set(grid.mesh) <= set(grid.times)
    np.testing.assert_allclose(
        grid.mesh[[0, 2, 4, -1]], [0, 2 * even, 3 * even, 0.8]
    )
    # What both sums of weights are for.
    for weights in (grid.quadrature, grid.jerk_weights):
        assert weights.sum() == pytest.approx(0.8)
    assert grid.quadrature @ grid.times == pytest.approx(0.5 * 0.8**2)
    finest = grid.jerk_weights.min()
    assert finest < grid.jerk_weights.max() / 7.0
    _, even = _grid(name)
    np.testing.assert_allclose(even.jerk_weights, 0.8 / len(even.jerk))


@pytest.mark.parametrize("parts", [1, _FINER], ids=["even", "uneven"])
@pytest.mark.parametrize("name", _GRIDS)
def test_basis_satisfies_the_collocation_constraints(name, parts):
    program, grid = _grid(name, parts=parts)
    reduced = SparseProgram(program, (grid.substitution(program),))
    assert reduced.num_constraints == 0
    full = SparseProgram(program)
    y = np.random.default_rng(0).normal(size=reduced.num_unknowns)
    x = reduced.expand(y)
    defects = full.constraints(full.restrict(x))
    jerk = np.abs(x[program.indices(grid.jerk)]).max()
    assert np.abs(defects).max() < 1e-12 * jerk
    basis, _ = grid._scalar_basis()
    rows = sum(len(part) for part in (grid.q, grid.v, grid.a, grid.jerk))
    assert basis.shape[0] == rows
    # As many unknowns as the constraints leave free.
    assert reduced.num_unknowns == full.num_unknowns - full.num_constraints


@pytest.mark.parametrize("parts", [1, _FINER], ids=["even", "uneven"])
def test_hermite_simpson_defects_from_their_definition(parts):
    """Cubic through the ends, its midpoint slope against the dynamics."""
    program, grid = _grid("hermite_simpson", num_dof=1, parts=parts)
    problem = SparseProgram(program)
    rng = np.random.default_rng(1)
    x = rng.normal(size=program.prog.num_vars())
    y = problem.restrict(x)
    x = problem.expand(y)
    h = grid.steps[:, None]
    state = np.hstack([x[program.indices(v)] for v in (grid.q, grid.v, grid.a)])
    jerk = x[program.indices(grid.jerk)]
    slope = np.hstack([state[:, 1:], jerk])
    middle = 0.5 * (state[:-1] + state[1:]) + h / 8 * (slope[:-1] - slope[1:])
    mid_slope = np.hstack([middle[:, 1:], 0.5 * (jerk[:-1] + jerk[1:])])
    cubic = 1.5 / h * (state[1:] - state[:-1]) - 0.25 * (slope[:-1] + slope[1:])
    expected = mid_slope - cubic
    np.testing.assert_allclose(
        np.sort(np.abs(problem.constraints(y))),
        np.sort(np.abs(expected).ravel()),
        atol=1e-10,
    )


def test_radau_points_integrate_and_differentiate_exactly():
    points, weights, D = radau_points()
    for degree in range(5):  # Radau with 3 points: exact up to degree 4
        assert weights @ points**degree == pytest.approx(1 / (degree + 1))
    nodes = np.r_[0.0, points]
    for degree in range(4):
        slope = degree * points ** max(degree - 1, 0)
        np.testing.assert_allclose(D @ nodes**degree, slope, atol=1e-13)


def _quintic(s):
    p = 10 * s**3 - 15 * s**4 + 6 * s**5
    dp = 30 * s**2 - 60 * s**3 + 30 * s**4
    return p, dp


def _minimum_jerk(name, intervals, parts=1):
    """Error of the minimum-jerk motion from rest to rest."""
    duration = 0.8
    program, grid = _grid(name, 1, duration, intervals, parts)
    for i, value in ((0, 0.0), (-1, 1.0)):
        for array, target in ((grid.q, value), (grid.v, 0.0), (grid.a, 0.0)):
            program.prog.AddBoundingBoxConstraint(target, target, array[i])
    weights = grid.quadrature[len(grid.times) - len(grid.jerk) :]
    for row, weight in zip(grid.jerk, weights, strict=True):
        program.prog.AddQuadraticCost(
            weight * np.eye(1), np.zeros(1), row, is_convex=True
        )
    problem = SparseProgram(program, (grid.substitution(program),))
    solution = ipopt.solve(
        problem,
        np.zeros(program.prog.num_vars()),
        SolverOptions(tolerance=1e-6),
    )
    assert solution.success
    q = solution.values(program.indices(grid.q))[:, 0]
    return np.abs(q - _quintic(grid.times / duration)[0]).max()


@pytest.mark.parametrize("name", _GRIDS)
def test_minimum_jerk_quintic_converges(name):
    coarse, fine = (_minimum_jerk(name, n) for n in (16, 32))
    order = np.log2(coarse / fine)
    assert fine < 1e-3, f"{name}: error {fine:.2e}"
    assert order > 1.7, f"{name}: errors {coarse:.2e}, {fine:.2e}: {order:.2f}"


@pytest.mark.parametrize("name", _GRIDS)
def test_minimum_jerk_quintic_on_an_uneven_grid(name):
    """Near to it as its longest intervals are: nothing swings beside them."""
    uneven = _minimum_jerk(name, 12, [1, 1] + 8 * [2] + [1, 1])
    assert uneven < 2.0 * _minimum_jerk(name, 12)


@pytest.mark.parametrize("parts", [1, [1, 2, 4, 2, 1, 1]], ids=["even", "not"])
@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("name", _GRIDS)
def test_states_between_nodes_follow_the_polynomials(name, fraction, parts):
    """A quartic position has every state within reach of both grids."""
    _, grid = _grid(name, 1, 0.6, 6, parts)
    t = grid.times
    # Cubic states on the Radau grid allow a cubic position only.
    c = [0.3, -1.0, 2.0, 4.0, 0.0 if name == "pseudospectral" else 9.0]
    poly = np.polynomial.Polynomial(c)
    arrays = [
        poly.deriv(k)(t)[:, None] if k else poly(t)[:, None] for k in range(4)
    ]
    jerk = arrays[3][len(t) - len(grid.jerk) :]
    times = grid.mesh[:-1] + fraction * grid.steps
    q, v, a = grid.at(times, *arrays[:3], jerk)
    for found, order in ((q, 0), (v, 1), (a, 2)):
        expected = poly.deriv(order)(times) if order else poly(times)
        np.testing.assert_allclose(found[:, 0], expected, atol=1e-11)


@pytest.mark.parametrize("parts", [1, [1, 2, 4, 2, 1, 1]], ids=["even", "not"])
def test_what_alternates_between_nodes_is_what_the_nodes_miss(parts):
    """Nodes of a still motion may hide a jerk that swings from node to node."""
    program, grid = _grid("hermite_simpson", 1, 0.6, 6, parts)
    n = len(grid.times)
    jerk = 100.0 * (-1.0) ** np.arange(n)
    still = np.zeros((n, 1))
    middle = grid.mesh[:-1] + 0.5 * grid.steps
    *_, midway = grid.at(middle, *(still,) * 3, jerk[:, None])
    variables, factors, lasting = grid.alternating()
    where = program.indices(variables) - program.indices(grid.jerk)[0, 0]
    assert where.shape == (n - 2, 1, 3)
    steps = grid.steps
    np.testing.assert_allclose(lasting, 0.5 * (steps[:-1] + steps[1:]))
    # Between nodes, a = s (j0 + s snap/2) starts and ends at zero.
    np.testing.assert_allclose(np.abs(midway[:, 0]), 0.25 * steps * 100.0)

    def told(jerk):
        return np.sum(jerk[where][:, 0] * factors, axis=1)

    np.testing.assert_allclose(np.abs(told(jerk)), 0.25 * lasting * 100.0)
    # A jerk that grows evenly tells of nothing.
    np.testing.assert_allclose(told(3.0 + grid.times), 0.0, atol=1e-12)


def test_points_of_the_radau_grid_tell_all():
    _, grid = _grid("pseudospectral", 2, 0.6, 6)
    variables, *_ = grid.alternating()
    assert variables.shape == (0, 2, 1)


def test_constraints_are_named_by_trial():
    program = BatchedProgram()
    for name in ("rise1", "rise2"):
        HermiteSimpson(program, name, 1, 1.0, 5)
    problem = SparseProgram(program)
    names = {
        problem.rows.name(i).split(" row")[0]
        for i in range(problem.num_constraints)
    }
    assert "rise1 collocation[0]" in names
    assert "rise2 collocation[4]" in names
    described = [
        b.evaluator().get_description()
        for b in program.prog.generic_constraints()
    ]
    assert "rise2 collocation[4]" in described


def test_time_that_nodes_stand_for():
    """Half the way to either side; at the ends as much as the next step."""
    found = stands_for(np.array([0.1, 0.3, 0.5, 0.2]))
    np.testing.assert_allclose(found, [0.1, 0.2, 0.4, 0.35, 0.2])
