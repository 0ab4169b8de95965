"""Intervals of Phase B with errors of measurement among its unknowns."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration import uncertainty as intervals
from drake_exo.calibration.phases import InteractionCalibration
from drake_exo.calibration.settings import InteractionSettings, Solver
from drake_exo.calibration.uncertainty import (
    by_target,
    posterior,
    uncertainty,
)
from drake_exo.collocation.trial_program import LogKernel, Tracking
from drake_exo.nlp.sensitivity import response
from drake_exo.nlp.sparse import accumulate
from drake_exo.virtual_laboratory.synthetic import rises_in_device


@pytest.fixture(scope="module")
def coarse():
    """Two trials at 20 nodes a second; errors as a study has them."""
    made = rises_in_device(2, nodes_per_second=20)
    settings = InteractionSettings(solver=Solver(20.0, tolerance=1e-8))
    problem = InteractionCalibration(
        made.model, made.trials, made.contact, settings
    )
    return made, problem.solve()


def _by_x(problem, result):
    """Parameters (m, num_vars) by changes of the gradient."""
    program = problem.compiled
    y = program.restrict(result.values)
    free = [p.free for p in problem.parameters]
    index = problem.program.indices(problem.parameter_variables[free])
    columns = program.unknowns.column_of(index)
    border = program.unknowns.column_of(intervals._shared(result))
    found = response(program, y, columns, border)
    unit = program.unknowns.scale[index][:, None]
    return index, unit * found.by_gradient @ program.unknowns.matrix.T


@pytest.mark.slow
def test_intervals_are_of_the_program_that_was_solved():
    """Whatever is added to it and solved afterwards."""
    made = rises_in_device(1, nodes_per_second=20)
    settings = InteractionSettings(solver=Solver(20.0))
    problem = InteractionCalibration(
        made.model, made.trials, made.contact, settings
    )
    first = problem.solve()
    before = uncertainty(first).sd
    prog = problem.program.prog
    stiffness = problem.variables_of(["thigh.normal_stiffness"])
    prog.AddQuadraticErrorCost(np.eye(1) * 10.0, np.array([6e3]), stiffness)
    surplus = prog.NewContinuousVariables(1)
    prog.AddQuadraticCost((surplus[0] - 1.0) ** 2)
    assert not np.allclose(uncertainty(problem.solve()).sd, before, rtol=0.1)
    np.testing.assert_allclose(uncertainty(first).sd, before, rtol=1e-12)


@pytest.mark.slow
def test_what_encoders_show_moves_parameters_as_a_second_solve_says(coarse):
    """Errors take up what they can: they move with the targets, too."""
    made, result = coarse
    problem = result.problem
    index, by_x = _by_x(problem, result)
    first, *rest = made.trials
    k = first.coordinates.index("exo_knee")
    bump = 1.0 + np.cos(2 * np.pi * first.times / first.times[-1])
    q = first.q.copy()
    q[:, k] += np.deg2rad(0.05) * bump
    other = InteractionCalibration(
        made.model, [replace(first, q=q), *rest], made.contact,
        problem.settings,
    )  # fmt: skip
    moved = other.solve(result.values)
    assert moved.success
    expected = np.zeros(len(index))
    for movement, changed in zip(
        problem.movements, other.movements, strict=True
    ):
        for term, new in zip(movement.tracked, changed.tracked, strict=True):
            shift = new.target - term.target
            R = by_target(term, problem, by_x)
            expected += np.einsum("pnr,nr->p", R, shift)
    change = moved.values[index] - result.values[index]
    sd = uncertainty(result).sd
    assert np.abs(change / sd).max() > 0.01
    np.testing.assert_allclose(expected / sd, change / sd, atol=3e-3)


@pytest.mark.slow
def test_noise_and_curvature_tell_nearly_the_same(coarse):
    """Two paths: noise sent through the optimum, and the cost's curvature."""
    _, result = coarse
    found, known = uncertainty(result), posterior(result)
    free = len(found.names)
    curvature = np.sqrt(np.diag(known.covariance)[:free])
    ratio = found.sd / curvature
    assert (ratio > 0.82).all() and (ratio < 1.05).all()
    assert (found.sd <= 1.001 * found.prior_sd).all()
    # Intervals say besides that no cuff is a bushing.
    value = {p.name: p.nominal for p in result.parameters}
    k = found.names.index("thigh.normal_stiffness")
    wide = np.sqrt(
        found.sd[k] ** 2
        + found.pull[k] ** 2
        + (0.25 * value[found.names[k]]) ** 2
    )
    expected = 1.959964 * min(wide, found.prior_sd[k])
    assert found.half_width[k] == pytest.approx(expected, rel=1e-6)
    assert (found.half_width <= 2.0 * found.prior_sd).all()


@pytest.mark.slow
def test_a_prior_pulls_nothing(coarse):
    """It is a measurement; energy and jerk are none."""
    _, result = coarse
    problem = result.problem
    program = problem.compiled
    y = program.restrict(result.values)
    x = result.values
    g = np.zeros(program.num_unknowns)
    for block in program.residual_blocks:
        if not isinstance(block.batch.kernel, LogKernel):
            slope = np.einsum("no,now->nw", block.values(x), block.jacobian(x))
            accumulate(g, block, slope)
    jerk = intervals._jerk_weights(problem, len(x)) * x
    g += program.unknowns.matrix.T @ jerk
    for movement in problem.movements:
        weights = movement.grid.quadrature[:, None]
        for term in movement.tracked:
            if term.role == "regulariser":
                index = problem.program.indices(term.variables)
                own = np.zeros(len(x))
                own[index] = weights * x[index] / term.sigma**2
                g += program.unknowns.matrix.T @ own
    found = intervals._regulariser(problem, program, y)
    np.testing.assert_allclose(found, g, atol=1e-9 * np.abs(g).max())
    assert np.abs(program.residual_gradient(y) - g).max() > 1e-3


@pytest.mark.slow
def test_a_parameter_that_the_program_holds_is_known(coarse):
    made, result = coarse
    held = InteractionCalibration(
        made.model, made.trials, made.contact, result.problem.settings
    )
    name = "thigh.normal_stiffness"
    variable = held.variables_of([name])
    value = result.values[held.program.indices(variable)]
    held.program.prog.AddBoundingBoxConstraint(value, value, variable)
    found = held.result(result.solution)
    for told in (posterior, uncertainty):
        left = [n for n in told(result).names if n != name]
        assert list(told(found).names) == left
        assert name in told(result).names


def test_noise_of_every_foot_counts():
    """Where two feet are tracked beside the coordinates."""
    times = np.linspace(0.0, 1.0, 21)
    variables = np.arange(42).reshape(21, 2)

    tracked = []
    for column, size in ((0, 1.0), (1, 2.0)):
        for role in ("position", "velocity"):
            term = Tracking(
                variables[:, [column]], np.zeros((21, 1)), 0.1, role=role
            )
            term.weights = np.full(21, 0.05 * size)
            tracked.append(term)
    unknowns = SimpleNamespace(scale=np.ones(42))
    result = SimpleNamespace(
        problem=SimpleNamespace(program=SimpleNamespace(indices=lambda v: v)),
        compiled=SimpleNamespace(
            rows=SimpleNamespace(row_of=lambda v: np.full(len(v), -1)),
            unknowns=unknowns,
        ),
    )
    movement = SimpleNamespace(
        grid=SimpleNamespace(times=times), tracked=tracked
    )
    found = SimpleNamespace(by_bounds=np.zeros((2, 0)))
    by_x = np.zeros((2, 42))  # each parameter follows one foot
    by_x[0, variables[:, 0]] = by_x[1, variables[:, 1]] = 1.0
    parts = list(intervals._noise(movement, result, found, by_x, 6.0, 4))
    first, second = (np.linalg.norm(p, axis=1) for p in parts)
    assert first[0] > 0.0 and first[1] == 0.0
    assert second[1] == pytest.approx(2.0 * first[0]) and second[0] == 0.0
    for term in tracked[:2]:  # one that nobody measured
        term.sigma = np.full(term.sigma.shape, np.inf)
    none, again = intervals._noise(movement, result, found, by_x, 6.0, 4)
    assert not none.any()
    np.testing.assert_array_equal(again, parts[1])
