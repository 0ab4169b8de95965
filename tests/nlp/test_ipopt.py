"""Solving: status, sealing, strategies, interruption."""

import contextlib
import os
import signal
import threading

import numpy as np
import pytest
from pydrake.math import cos
from pydrake.solvers import IpoptSolver, MathematicalProgram
from small_programs import Circle, pushed_cart, valleys

from drake_exo.errors import InputError
from drake_exo.nlp import ipopt, stop_on_interrupt
from drake_exo.nlp.ipopt import SealedSolutionError, SolverOptions
from drake_exo.nlp.program import BatchedProgram, variable_bounds
from drake_exo.nlp.sparse import SparseProgram


def test_solves_and_reads():
    program, x = valleys()
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


def test_options_of_ipopt_that_the_program_holds_count():
    program, _ = valleys()
    program.prog.SetSolverOption(IpoptSolver.id(), "max_iter", 2)
    once = SolverOptions(strategies=("adaptive",))
    found = ipopt.solve(SparseProgram(program), np.zeros(6), once)
    assert found.status == "maximum number of iterations exceeded"
    assert found.iterations == 2
    theirs = ipopt.solve_with_drake(program, np.zeros(6))
    assert not theirs.success and theirs.status == "max iteration exceeded"
    for name, value in (("max_iter", 2.5), ("iterations", 2)):
        program, _ = valleys()
        program.prog.SetSolverOption(IpoptSolver.id(), name, value)
        with pytest.raises(InputError, match=f"no option '{name}' of {value}"):
            ipopt.solve(SparseProgram(program), np.zeros(6))


@pytest.mark.parametrize(
    ("add", "what"),
    [
        (lambda prog, x: prog.NewBinaryVariables(1), "BinaryVariable"),
        (
            lambda prog, x: prog.AddLinearComplementarityConstraint(
                np.eye(6), np.full(6, -1.0), x.ravel()
            ),
            "LinearComplementarityConstraint",
        ),
    ],
)
def test_what_ipopt_cannot_solve_is_refused(add, what):
    """Left in, a binary variable is 0.3 and complementarity is not seen."""
    program, x = valleys()
    add(program.prog, x)
    with pytest.raises(InputError, match=rf"{what}\}}; take out what was"):
        SparseProgram(program)


def test_visualization_callbacks_are_called_at_each_iteration():
    program, x = valleys()
    told, shown = [], []
    last = x.ravel()[::-1]
    program.prog.AddVisualizationCallback(
        lambda values: shown.append(values.copy()), last
    )
    index = program.indices(last)
    ipopt.solve(
        SparseProgram(program),
        np.zeros(6),
        on_iterate=lambda iterate: told.append(iterate.x[index]),
    )
    assert len(shown) > 2
    np.testing.assert_array_equal(shown, told)


def test_a_constraint_that_a_user_adds_has_curvature():
    """The point of a disc that is nearest to one outside."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(2, "x")
    program.prog.AddQuadraticErrorCost(np.eye(2), [1.5, 2.0], x)
    program.prog.AddConstraint(lambda z: [z @ z], [-np.inf], [1.0], x)
    found = ipopt.solve(SparseProgram(program), np.array([0.5, -0.2]))
    assert found.strategy == "adaptive" and found.iterations < 20
    np.testing.assert_allclose(found.raw_values(), [0.6, 0.8], atol=1e-5)


def test_drakes_own_solver_reaches_the_same_optimum():
    program, x = valleys(radius=1.2)
    ours = ipopt.solve(
        SparseProgram(program), np.zeros(6), SolverOptions(tolerance=1e-9)
    )
    theirs = ipopt.solve_with_drake(
        program, np.zeros(6), SolverOptions(tolerance=1e-9)
    )
    assert ours.success
    assert theirs.success and theirs.status == ours.status == "solved"
    assert ours.objective == pytest.approx(theirs.objective, rel=1e-7)
    index = program.indices(x)
    np.testing.assert_allclose(
        ours.values(index), theirs.values(index), atol=1e-5
    )


def test_a_failed_solution_is_sealed_and_names_constraints():
    program, x = valleys()
    program.add_constraints("far", Circle(), x[:1], 9.0, 9.0)
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


def test_constraints_off_by_rounding_are_not_blamed():
    off = [("step[3] row 0", 3e-4), ("end row 1", 4e-16)]
    failed = ipopt.Solution(False, "no progress", 3, 0.0, 3e-4, off, 1, 1, 1)
    assert "step[3] row 0 off by 0.0003." in failed.explain()
    failed.worst_constraints = off[1:]
    assert "allow more iterations" in failed.explain()
    failed.status = ipopt.STOPPED_BY_USER
    assert "not yet optimal; resume." in failed.explain()
    failed.status = "invalid number: a function returned NaN or infinity"
    assert "far from the usual, as a noise near 0." in failed.explain()


def test_a_second_strategy_is_tried_when_the_first_fails():
    program, _ = valleys()
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


def test_a_strategy_leaves_the_program_as_it_was():
    program, _ = valleys(radius=1.2)
    problem = SparseProgram(program)
    before = problem.hessian_structure
    for strategy in ("exact", "near_exact"):
        options = SolverOptions(strategies=(strategy,))
        assert ipopt.solve(problem, np.zeros(6), options).success
        assert not problem.exact_hessian
    np.testing.assert_array_equal(problem.hessian_structure, before)


def test_the_best_of_all_attempts_is_kept():
    """Not the start of the one that was stopped as it began."""
    program, _ = valleys()
    seen = []

    def interrupt(iterate):
        if iterate.infeasibility <= 1e-4:
            seen.append(iterate.objective)
        if iterate.strategy == "monotone":
            os.kill(os.getpid(), signal.SIGINT)

    found = ipopt.solve(
        SparseProgram(program),
        np.zeros(6),
        SolverOptions(max_iterations=6),
        interrupt,
    )
    assert found.was_stopped
    assert found.objective == pytest.approx(min(seen))
    assert found.objective < seen[-1]


def test_interruption_keeps_the_best_iterate():
    program, x = valleys()
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


def test_an_interruption_after_the_last_iteration_is_not_forgotten(
    monkeypatch,
):
    """The solve has ended by then; what follows must not begin."""
    program, _ = valleys()
    attempt = ipopt._attempt

    def interrupted(*given):
        found = attempt(*given)
        os.kill(os.getpid(), signal.SIGINT)
        return found

    monkeypatch.setattr(ipopt, "_attempt", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ipopt.solve(SparseProgram(program), np.zeros(6))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(("last", "nth"), [("elastic", 4), ("exact", 1)])
def test_interruption_is_told_of_an_infeasible_problem_too(last, nth):
    """Among the stiffer springs, and after all of them."""
    program, *_ = pushed_cart(distance=10.0)
    seen = []

    def interrupt(iterate):
        seen.append(iterate.strategy)
        if iterate.strategy == last and seen.count(last) == nth:
            os.kill(os.getpid(), signal.SIGINT)

    found = ipopt.solve(
        SparseProgram(program), np.zeros(11), on_iterate=interrupt
    )
    assert seen.count(last) >= nth
    assert found.was_stopped and found.binding == []


@pytest.mark.parametrize("fixed", [(0,), (0, 1)])
@pytest.mark.parametrize("least", [0.5, 1.5])
def test_a_constraint_on_what_is_fixed(fixed, least):
    """It holds or not, whatever else is found."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(2, "x")
    program.prog.AddQuadraticCost((x[1] - 3.0) ** 2)
    for i in fixed:
        program.prog.AddBoundingBoxConstraint(1.0, 1.0, x[i])
    program.prog.AddConstraint(lambda x: x**3, [least], [9.0], x[:1])
    found = ipopt.solve(SparseProgram(program), np.ones(2))
    assert found.success is (least < 1.0)
    if found.success:
        free = 1.0 if len(fixed) == 2 else 3.0
        np.testing.assert_allclose(found.values([0, 1]), [1.0, free])


def test_bounds_are_kept_exactly():
    """IPOPT relaxes them while it searches."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(1, "x")
    program.prog.AddQuadraticCost((x[0] + 1.0) ** 2)
    program.prog.AddBoundingBoxConstraint(0.0, 9.0, x)
    found = ipopt.solve(SparseProgram(program), np.ones(1))
    assert found.success and 0.0 <= found.values([0])[0] < 1e-6


def test_a_second_interruption_that_is_lost_is_raised_at_the_end():
    """ctypes drops what a handler raises before a function's own code."""
    stop = threading.Event()
    with pytest.raises(KeyboardInterrupt), stop_on_interrupt(stop):
        os.kill(os.getpid(), signal.SIGINT)
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_a_second_interruption_is_not_withheld():
    stop = threading.Event()
    with pytest.raises(KeyboardInterrupt), stop_on_interrupt(stop):
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.is_set()
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_job_that_ignores_interruption_goes_on_ignoring_it():
    """As shells have it of those that are begun by `&`."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with stop_on_interrupt(stop := threading.Event()):
            os.kill(os.getpid(), signal.SIGINT)
        assert not stop.is_set()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_start_near_a_solution_stays_near():
    program, _ = valleys(radius=1.2)
    options = SolverOptions(tolerance=1e-9)
    first = ipopt.solve(SparseProgram(program), np.zeros(6), options)
    start = first.raw_values() + 1e-4

    def detour(own):
        """How far the objective goes off on the way."""
        seen = []
        solution = ipopt.solve(
            SparseProgram(program),
            start,
            own,
            lambda i: seen.append(i.objective),
        )
        assert solution.success
        assert solution.objective == pytest.approx(first.objective, rel=1e-7)
        return np.abs(np.array(seen) - first.objective).max()

    straight = max(detour(options.near_solution(e)) for e in (False, True))
    assert straight < 0.1 * detour(options)


def test_near_a_solution_no_multipliers_are_sought_first(monkeypatch):
    """On a fine grid their factor costs more than all of the solve."""
    program, _ = valleys(radius=1.2)
    options, first = SolverOptions(tolerance=1e-9), []
    start = ipopt.solve(SparseProgram(program), np.zeros(6), options)
    own = SparseProgram.hessian

    def hessian(self, y, multipliers, factor):
        first.append(np.abs(multipliers).max())
        return own(self, y, multipliers, factor)

    monkeypatch.setattr(SparseProgram, "hessian", hessian)
    for kind, begins in ((options, 1e-3), (options.near_solution(), 0.0)):
        first.clear()
        ipopt.solve(SparseProgram(program), start.raw_values() + 1e-4, kind)
        assert (first[0] > begins) if begins else (first[0] == 0.0)
        assert max(first) > 1e-3


def test_a_program_in_other_units_is_the_same_program():
    """Costs, constraints and bounds at z = x / scale, of every kind."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    scale = np.array([0.1, 5.0, 20.0])
    prog.AddBoundingBoxConstraint([-1.0, 2.0], [4.0, 6.0], x[1:])
    prog.AddLinearConstraint(x[0] + 3.0 * x[1] <= 2.0)
    prog.AddLinearEqualityConstraint(2.0 * x[2] - x[1] == 1.0)
    prog.AddLinearCost(3.0 * x[0] - x[2] + 7.0)
    prog.AddQuadraticCost((x[0] - 2.0 * x[1] + 1.0) ** 2 + 4.0 * x[2] * x[2])
    prog.AddCost(lambda v: v[0] ** 3 * v[1], x[:2])
    prog.AddConstraint(lambda v: [v[0] * v[1] ** 2], [-1.0], [9.0], x[1:])
    scaled = ipopt._scaled_copy(prog, scale)

    def values(program, point, *kinds):
        found = [
            float(program.EvalBinding(binding, point)[0])
            for kind in kinds
            for binding in getattr(program, kind)()
        ]
        return sorted(found)

    linear = ("linear_constraints", "linear_equality_constraints")
    for at in np.random.default_rng(1).standard_normal((3, 3)):
        # An equality comes back as a linear constraint.
        for kinds in (("GetAllCosts",), linear, ("generic_constraints",)):
            own = values(scaled, at / scale, *kinds)
            assert own == pytest.approx(values(prog, at, *kinds))
            assert own
    lower, upper = variable_bounds(scaled)
    np.testing.assert_allclose(lower * scale, [-np.inf, -1.0, 2.0])
    np.testing.assert_allclose(upper * scale, [np.inf, 4.0, 6.0])


def test_an_iterate_is_judged_by_its_own_constraints():
    """Not by IPOPT's slacks, nor by where IPOPT restores feasibility."""
    program, _ = valleys(radius=3.0)
    watch = ipopt._Watch(
        SparseProgram(program), "adaptive", lambda _: None, threading.Event()
    )
    outside, inside = np.full(6, 2.0), np.full(6, 0.5)
    watch.accepted(outside)
    watch(0, 0, 7.0, 0.0, 1.0)
    assert watch.best_key == (5.0, 7.0)
    watch(1, 1, 6.0, 0.0, 1.0)
    assert watch.best_key == (5.0, 7.0)
    watch.accepted(inside)
    watch(0, 2, 8.0, 9.0, 1.0)
    assert watch.best_key[0] == 0.0
    np.testing.assert_array_equal(watch.best, inside)


def test_an_attempt_that_leads_nowhere_is_given_up():
    """Forty iterations in which the error does not fall by a tenth."""
    watch = ipopt._Watch(None, "adaptive", None, None)
    watch._judge(0, 0, 1.0)
    for k in range(1, 41):
        watch._judge(0, k, 0.95)
        assert not watch.gave_up
    watch._judge(0, 40, 0.85)  # by more than a tenth: a new start
    watch._judge(0, 80, 0.80)
    assert not watch.gave_up
    watch._judge(0, 81, 0.80)
    assert watch.gave_up
    patient = ipopt._Watch(None, "patient", None, None)
    for k in range(200):
        patient._judge(1, k, 1.0)
    assert not patient.gave_up
    lost = ipopt._Watch(None, "adaptive", None, None)
    for k in range(13):
        assert not lost.gave_up
        lost._judge(1, k, 0.5**k)
    assert lost.gave_up


def test_drakes_own_solver_starts_where_it_is_told_to():
    """In one of many valleys, in the variable's own units."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(1, "x")
    program.prog.SetVariableScaling(x[0], 10.0)
    program.prog.AddCost(lambda v: cos(v[0]), x)
    program.prog.AddBoundingBoxConstraint(-50.0, 50.0, x)
    for start, valley in ((3.0, np.pi), (-9.6, -3.0 * np.pi)):
        found = ipopt.solve_with_drake(program, np.array([start]))
        assert found.success
        assert found.raw_values()[0] == pytest.approx(valley, abs=1e-7)
        assert found.infeasibility == 0.0


@pytest.mark.parametrize(
    ("strategy", "tenfold"), [("near", 100.0), ("adaptive", 10.0)]
)
def test_rounding_ends_a_solve_that_is_near(strategy, tenfold):
    """Where the objective moves no more; a finer grid's audit is the judge."""
    found = ipopt._ipopt_options(SolverOptions(tolerance=1e-5), strategy)
    assert found["acceptable_tol"] == pytest.approx(tenfold * 1e-5)
    assert found["acceptable_iter"] == 3
    assert found["acceptable_obj_change_tol"] == 1e-7
