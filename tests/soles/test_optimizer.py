"""The search by IPOPT on a quadratic whose optimum is known in closed form."""

import os
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles.optimize import optimizer
from drake_exo.soles.optimize.files import Checkpoint
from drake_exo.soles.optimize.limits import FEASIBLE
from drake_exo.soles.optimize.optimizer import (
    Optimum,
    QuasiNewton,
    _Callbacks,
    _verify,
    cost_and_violation,
    minimise,
)

AIM = np.array([3.0, 0.4, -1.0, 0.7])


class Quadratic:
    """½ |p − AIM|² + 1.5 (p₀ − p₁)², with 2 − Σp ≥ 0 and p₃ − 0.8 ≥ 0.

    The second term is what is known exactly, like a regularization.
    """

    def __init__(self):
        self.spline = SimpleNamespace(count=4)
        self.metric = 3.0 * np.eye(4)
        self.evaluations, self.known = 0, None
        self.accepted, self.left = [], 0
        self.lost = lambda p: False

    def names(self):
        return ["sum", "last"]

    def evaluate(self, p):
        if self.known is None or not np.array_equal(self.known, p):
            self.known = p.copy()
            self.evaluations += 1
        return None if self.lost(p) else "simulated"

    def cost(self, p):
        if self.evaluate(p) is None:
            return np.nan
        return 0.5 * ((p - AIM) ** 2).sum() + self.regularization(p)[0]

    def constraints(self, p):
        if self.evaluate(p) is None:
            return np.full(2, np.nan)
        return np.array([2.0 - p.sum(), p[3] - 0.8])

    def derivatives(self, p):
        return p - AIM, np.array([[-1.0] * 4, [0.0, 0, 0, 1]])

    def regularization(self, p):
        d = np.array([1.0, -1.0, 0.0, 0.0])
        H = 3.0 * np.outer(d, d)
        return 0.5 * p @ H @ p, H @ p, H

    def accept(self, p):
        self.accepted.append(p.copy())

    def leave_branch(self):
        self.left += 1


def _by_hand(problem, low, high):
    """Optimum and multipliers from the equations of who is active.

    Active: the sum's limit, p₂ at its lower bound, the last one's limit.
    """
    H = np.eye(4) + problem.regularization(AIM)[2]
    rows = np.array([[1.0] * 4, [0, 0, 1, 0], [0, 0, 0, 1]])
    system = np.block([[H, rows.T], [rows, np.zeros((3, 3))]])
    solution = np.linalg.solve(system, [*AIM, 2.0, low, 0.8])
    return solution[:4], solution[4:]


@pytest.fixture(scope="module")
def found():
    problem, said = Quadratic(), []
    p0 = np.array([9.0, 0.1, 0.1, 0.9])
    best = minimise(
        problem, p0, (0.0, 2.0), 60, 1e-7,
        lambda iteration, best: said.append((iteration, best.error)),
    )  # fmt: skip
    return problem, best, said


def test_the_optimum_is_the_one_by_hand(found):
    problem, best, said = found
    p, (total, lowest, last) = _by_hand(problem, 0.0, 2.0)
    assert best.optimal and best.status == "optimal"
    np.testing.assert_allclose(best.p, p, atol=1e-6)
    # IPOPT: constraints at least 0 have multipliers at most 0.
    np.testing.assert_allclose(best.multipliers, [-total, last], atol=1e-5)
    low, high = best.at_bounds
    np.testing.assert_allclose(low, [0, 0, -lowest, 0], atol=1e-5)
    assert -lowest > 0.1
    np.testing.assert_allclose(high, 0.0, atol=1e-5)
    assert best.cost == problem.cost(best.p)
    assert best.violation < 1e-7
    assert best.complementarity < 1e-6 and best.error < 1e-6
    assert [row[0] for row in best.trace] == list(range(len(best.trace)))
    assert said == [(row[0], row[3]) for row in best.trace]
    # From p0 within the bounds, a hundredth of them away.
    np.testing.assert_allclose(problem.accepted[0], [1.98, 0.1, 0.1, 0.9])
    assert problem.left == 1
    assert best.simulations == problem.evaluations


def test_what_was_simulated_before_is_not_counted():
    problem = Quadratic()
    problem.evaluations = 1000
    best = minimise(problem, np.full(4, 0.4), (0.0, 2.0), 3, 1e-9)
    assert best.status == "iteration limit" and not best.optimal
    assert best.simulations == problem.evaluations - 1000 > 3


def test_curvature_learnt_before_and_multipliers_shorten_the_search(found):
    problem, best, _ = found
    curvature = QuasiNewton(problem.metric, np.eye(4))
    p = _by_hand(problem, 0.0, 2.0)[0]
    warm = Checkpoint(
        p=np.full(4, 0.1), latest=p, multipliers=best.multipliers, barrier=1e-9
    )
    again = minimise(
        Quadratic(), p, (0.0, 2.0), 60, 1e-6, None, True, curvature, warm
    )
    assert again.optimal
    assert len(again.trace) < 0.6 * len(best.trace)
    np.testing.assert_allclose(again.p, best.p, atol=1e-5)


def test_the_best_of_a_run_that_was_interrupted_is_kept():
    problem = Quadratic()
    p, _ = _by_hand(problem, 0.0, 2.0)
    warm = Checkpoint(
        p=p, latest=np.full(4, 0.5), multipliers=np.zeros(2), barrier=1e-3
    )
    best = minimise(problem, np.full(4, 0.5), (0.0, 2.0), 0, 1e-9, warm=warm)
    np.testing.assert_array_equal(best.p, p)
    problem.lost = lambda q: np.array_equal(q, p)
    best = minimise(problem, np.full(4, 0.5), (0.0, 2.0), 0, 1e-9, warm=warm)
    assert not np.array_equal(best.p, p)


def test_ctrl_c_surfaces_after_the_search():
    problem = Quadratic()
    plain, left = problem.cost, [4]

    def cost(p):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return plain(p)

    problem.cost = cost
    with pytest.raises(KeyboardInterrupt):
        minimise(problem, np.full(4, 0.4), (0.0, 2.0), 50)


def test_ctrl_c_does_not_surface_within_ipopt():
    """What runs ends, nothing else is computed, the old handler is back."""
    costs, problem = [], Quadratic()
    plain = problem.cost

    def cost(p):
        if len(costs) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        costs.append((plain(p), problem.evaluations))
        return costs[-1][0]

    problem.cost = cost
    with pytest.raises(KeyboardInterrupt):
        minimise(problem, np.full(4, 0.4), (0.0, 2.0), 50)
    assert len(costs) == 4 and problem.evaluations == costs[-1][1]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_progress_raises_ends_the_search():
    def tell(iteration, best):
        if iteration == 2:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        minimise(Quadratic(), np.full(4, 0.4), (0.0, 2.0), 50, 1e-9, tell)


def test_optimality_is_that_of_ipopts_formula():
    """At a point that is none: each part by hand, then the scaling."""
    problem = Quadratic()
    p = np.array([1.0, 0.5, 0.25, 0.5])
    best = Optimum(np.zeros(4), multipliers=np.array([-2.0, -3.0]))
    best.at_bounds = np.array([0.1, 0, 0, 0]), np.array([0, 0, 0.2, 0])
    gradient, jacobian = problem.derivatives(p)
    _verify(problem, best, p, (0.0, 2.0), gradient, jacobian)
    # λ c: −2 · (−0.25), −3 · (−0.3); bounds: 0.1 · 1, 0.2 · 1.75.
    assert best.complementarity == pytest.approx(0.9)
    # p − AIM, 3 (p₀ − p₁), Jᵀ λ, − low, + high:
    dual = [-2 + 1.5 + 2 - 0.1, 0.1 - 1.5 + 2, 1.25 + 2 + 0.2, -0.2 + 2 - 3]
    assert best.error == pytest.approx(max(dual)) == pytest.approx(3.45)
    assert best.cost == np.inf  # not said to be optimal
    best.optimal, best.multipliers = True, np.array([-2e3, -3.0])
    _verify(problem, best, p, (0.0, 2.0), gradient, jacobian)
    # Of 10 multipliers the mean is 200.33: everything over 2.0033.
    assert best.complementarity == pytest.approx(500.0)
    size = (2003.0 + 0.1 + 0.2) / 10 / 100
    assert best.error == pytest.approx(2001.45 / size)
    np.testing.assert_array_equal(best.p, p)
    assert best.cost == problem.cost(p)
    assert best.violation == pytest.approx(0.3)
    # Each product by itself; it may be the largest part of the error, too.
    bounds, at = (-0.5, 2.0), AIM * [0.5, 1, 0.25, 1]
    still = problem.derivatives(at)[0] * 0 - problem.regularization(at)[1]
    for k, distance in enumerate([2.0, 0.9, 0.25, 1.2, 0.5, 1.6, 2.25, 1.3]):
        sides = np.zeros(8)
        sides[k] = 3.0
        best.multipliers, best.at_bounds = np.zeros(2), np.split(sides, 2)
        low, high = best.at_bounds
        # Its own gradient is balanced, so that the product alone is left.
        _verify(problem, best, at, bounds, still + low - high, jacobian)
        assert best.complementarity == pytest.approx(3.0 * distance)
        assert best.error == pytest.approx(3.0 * distance)
    best.multipliers, best.at_bounds = np.zeros(2), (np.zeros(4), np.zeros(4))
    still = problem.derivatives(AIM)[0] - problem.regularization(AIM)[1]
    _verify(problem, best, AIM, (-9.0, 9.0), still, jacobian)
    assert best.error == pytest.approx(1.1)  # the violation, Σ AIM = 3.1


def _ipopt(monkeypatch, solve=None):
    """The settings that IPOPT is given from now on; or another solver."""
    asked, solve = [], solve or optimizer.run_ipopt

    def run(*args, options, **more):
        asked.append(options)
        return solve(*args, options=options, **more)

    monkeypatch.setattr(optimizer, "run_ipopt", run)
    return asked


def test_an_interrupted_run_s_bounds_have_multipliers_of_the_barrier(
    monkeypatch,
):
    p, best = np.array([0.5, 0.3, 1.4, 1.0]), np.full(4, 0.4)
    m, problem, asked = np.array([-0.1, -0.2]), Quadratic(), []

    def solve(*_, multipliers, at_bounds, **more):
        asked.append((multipliers, *at_bounds))
        raise KeyboardInterrupt

    _ipopt(monkeypatch, solve)
    warm = Checkpoint(p=best, latest=p, multipliers=m, barrier=1e-3)
    with pytest.raises(KeyboardInterrupt):
        minimise(problem, p, (0.3, 1.4), 5, warm=warm)
    ((given, low, high),) = asked
    np.testing.assert_array_equal(given, m)
    np.testing.assert_allclose(low[:3], [5e-3, 1e6, 1e-3 / 1.1])
    np.testing.assert_allclose(high[:3], [1e-3 / 0.9, 1e-3 / 1.1, 1e6])
    np.testing.assert_array_equal(problem.known, best)


def test_how_far_outside_a_search_may_go(monkeypatch):
    """One and a half times the sum of what is violated, at least 0.1."""
    problem = Quadratic()
    p = np.array([1.0, 1.0, 0.5, 0.3])  # by 0.8 and by 0.5
    asked = _ipopt(monkeypatch)
    for p0 in (p, np.array([0, 0, 0, 0.9])):
        minimise(problem, p0, (0.0, 2.0), 0)
    far, near = (options["theta_max_fact"] for options in asked)
    assert far == pytest.approx(1.5 * 1.3) and near == 0.1
    assert cost_and_violation(problem, p)[1] == pytest.approx(0.8)
    assert cost_and_violation(problem, np.array([0, 0, 0, 0.9]))[1] == 0.0
    assert cost_and_violation(problem, p)[0] == problem.cost(p)
    problem.lost = lambda p: True
    assert cost_and_violation(problem, p) == (np.inf, np.inf)


def test_the_better_design_is_kept():
    """Less violation until one is feasible, then less cost."""
    best, good, bad = Optimum(np.zeros(1)), 0.9 * FEASIBLE, 1.1 * FEASIBLE
    for k, (cost, violation, kept) in enumerate(
        [(5.0, 0.5, True), (1.0, 0.6, False), (9.0, bad, True),
         (9.5, good, True), (9.6, 0.0, False), (9.4, good, True),
         (0.0, bad, False)], 1
    ):  # fmt: skip
        before = best.p
        best.consider(np.array([float(k)]), cost, violation)
        assert (best.p[0] == k) == kept
        if kept:
            assert (best.cost, best.violation) == (cost, violation)
            assert best.former[-1] is before
    ranks = [
        Optimum(None, 3.0, violation=v).rank for v in (0.0, good, bad, 0.5)
    ]
    assert ranks == [
        (False, np.inf, 3.0), (False, np.inf, 3.0), (True, 0.0, bad),
        (True, 0.0, 0.5),
    ]  # fmt: skip


def test_a_design_that_was_only_followed_gives_way_to_the_one_before():
    problem = Quadratic()
    best = Optimum(np.full(4, 0.4), status="optimal", optimal=True)
    best.former = [np.full(4, 0.1), np.full(4, 0.2)]
    best.fall_back(problem)
    assert best.optimal and best.p[0] == 0.4
    problem.lost = lambda p: p[0] > 0.15
    best.fall_back(problem)
    assert not best.optimal and "neighbour" in best.status
    assert best.p[0] == 0.1
    assert (best.cost, best.violation) == cost_and_violation(problem, best.p)


def test_ipopt_gets_the_lower_triangle():
    """Of the learnt curvature times a factor, with what is known exactly."""
    problem, best = Quadratic(), Optimum(np.zeros(4))
    rng = np.random.default_rng(0)
    B = rng.standard_normal((4, 4))
    B = B @ B.T
    calls = _Callbacks(problem, QuasiNewton(np.eye(4), B), best, None, True)
    p = np.full(4, 0.3)
    multipliers = np.array([-2.0, -4.0])

    def lower(factor, cautious):
        H = factor * cautious * (B + problem.regularization(p)[2])
        return [H[i, j] for i in range(4) for j in range(i + 1)]

    learnt = []
    calls.curvature.update = lambda *given: learnt.append(given)
    out = calls.hessian(p, multipliers, 2.0)
    where, gradient, jacobian, scaled = learnt[0]
    np.testing.assert_array_equal(where, p)
    np.testing.assert_array_equal(gradient, p - AIM)
    np.testing.assert_array_equal(jacobian, problem.derivatives(p)[1])
    np.testing.assert_array_equal(scaled, multipliers / 2.0)
    np.testing.assert_allclose(out, lower(2.0, 1.0))
    assert best.latest[2] == 1e-3
    np.testing.assert_array_equal(best.latest[0], p)
    np.testing.assert_array_equal(best.latest[1], multipliers / 2.0)
    problem.evaluations += 2  # one of them was rejected
    out = calls.hessian(p, multipliers, 1.0)
    np.testing.assert_allclose(out, lower(1.0, 2.0))
    # In restoration the factor is 0; what it simulates says nothing.
    out = calls.hessian(p, multipliers, 0.0)
    np.testing.assert_allclose(out, lower(1e-3, 1.0))
    problem.evaluations += 9
    out = calls.hessian(p, multipliers, 1.0)
    np.testing.assert_allclose(out, lower(1.0, 2.0))
    expected = p - AIM + problem.regularization(p)[1]
    np.testing.assert_allclose(calls.gradient(p), expected)
    jacobian = [-1, -1, -1, -1, 0, 0, 0, 1]
    np.testing.assert_array_equal(calls.jacobian(p), jacobian)
    assert len(problem.accepted) == 1


def test_a_search_that_creeps_is_stopped():
    """More than 60 rejected simulations without a change end it."""
    for rejected, ends in ((60, False), (61, True)):
        problem, best = Quadratic(), Optimum(np.zeros(4))
        calls = _Callbacks(problem, None, best, None)
        assert calls.watch(0, 0, 1.0, 0.0, 5.0, 0.1)
        problem.evaluations += 1 + rejected
        assert calls.watch(0, 1, 1.0, 0.0, 5.0, 0.2) is not ends
        assert calls.stalled is ends and calls._barrier == 0.2
        assert best.trace == [(0, 1.0, 0.0, 5.0), (1, 1.0, 0.0, 5.0)]
    # A change by a five-hundredth of the cost, or of the violation by a
    # thousandth, is one.
    for cost, violation, ends in (
        (1.0021, 0.0, False),
        (1.0019, 0.0, True),
        (1.0, 1.1e-3, False),
        (1.0, 0.9e-3, True),
    ):
        problem, best = Quadratic(), Optimum(np.zeros(4))
        calls = _Callbacks(problem, None, best, None)
        calls.watch(0, 0, 1.0, 0.5, 5.0, 0.1)
        problem.evaluations += 62
        calls.watch(0, 1, cost, 0.5 - violation, 5.0, 0.1)
        assert calls.stalled is ends


def test_curvature_meets_the_secant_equation_unless_it_is_damped():
    """B s = y; where y s is too small, s B s is a fifth of what it was."""
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 5))
    metric = root @ root.T + np.eye(5)
    learnt = QuasiNewton(metric)
    np.testing.assert_allclose(learnt.matrix, 0.1 * metric)
    J, lam = rng.standard_normal((2, 5)), np.array([0.3, -0.7])
    p, g = rng.standard_normal((2, 5))
    learnt.update(p, g, J, lam)
    np.testing.assert_allclose(learnt.matrix, 0.1 * metric)
    s = rng.standard_normal(5)
    dJ = 0.1 * rng.standard_normal((2, 5))
    wanted = 4.0 * s  # of the Lagrangian's gradient
    learnt.update(p + s, g + wanted - dJ.T @ lam, J + dJ, lam)
    np.testing.assert_allclose(learnt.matrix @ s, wanted)
    assert not learnt.fresh
    # Across, the metric has been scaled by what s tells: s y / s M s.
    t = np.linalg.svd((metric @ s)[None])[2][1:]
    scaled = metric * (wanted @ s) / (s @ metric @ s)
    u = t[0] - (t[0] @ wanted) / (s @ wanted) * s
    np.testing.assert_allclose(
        u @ learnt.matrix @ u,
        u @ scaled @ u - (u @ scaled @ s) ** 2 / (s @ scaled @ s)
        + (u @ wanted) ** 2 / (s @ wanted),
    )  # fmt: skip
    before = learnt.matrix.copy()
    learnt.update(p + s, g, J, lam)  # no step, nothing learnt
    np.testing.assert_array_equal(learnt.matrix, before)
    d = rng.standard_normal(5)
    learnt.update(p + s + d, g - 3.0 * d, J, lam)
    assert d @ learnt.matrix @ d == pytest.approx(0.2 * (d @ before @ d))
    assert np.linalg.eigvalsh(learnt.matrix).min() > 0
    e, before = rng.standard_normal(5), learnt.matrix
    for part, kept in ((0.21, 0.21), (0.19, 0.2), (-5.0, 0.2)):
        again = QuasiNewton(metric, before)
        again.update(p, g, J, lam)
        again.update(p + e, g + part * before @ e, J, lam)
        share = (e @ again.matrix @ e) / (e @ before @ e)
        assert share == pytest.approx(kept)
    learnt.forget_point()
    before = learnt.matrix.copy()
    learnt.update(p, g, J, lam)
    np.testing.assert_array_equal(learnt.matrix, before)


def test_settings_of_the_search_are_what_ipopt_knows():
    """An unknown one would be refused; a warm start brings its barrier."""
    with pytest.MonkeyPatch.context() as patch:
        asked = _ipopt(patch)
        minimise(Quadratic(), np.full(4, 0.4), (0.0, 2.0), 1)
        warm = Checkpoint(
            p=np.full(4, 0.4), latest=np.full(4, 0.4),
            multipliers=np.zeros(2), barrier=1e-5,
        )  # fmt: skip
        minimise(Quadratic(), np.full(4, 0.4), (0.0, 2.0), 1, warm=warm)
    cold, warm = asked
    assert (cold["mu_init"], warm["mu_init"]) == (1e-3, 1e-5)
    assert cold["max_iter"] == 1 and cold["tol"] == 1e-4
    assert cold["theta_max_fact"] == pytest.approx(1.5 * 0.4)
    pushed = [v for k, v in warm.items() if k.endswith(("push", "frac"))]
    assert len(pushed) == 5 and max(pushed) <= 1e-5
    assert "warm_start_init_point" not in cold
