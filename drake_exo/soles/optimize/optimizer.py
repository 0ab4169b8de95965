"""Solve a `ShapeProblem` with IPOPT.

IPOPT is called directly. Its Hessian is the exact one of the regularization
plus a dense BFGS approximation of all that comes out of simulations (Nocedal
and Wright, Numerical Optimization, 2nd ed., procedure 18.2: Powell's damping
keeps it positive definite). Unlike IPOPT's limited-memory approximation it
forgets nothing, and the fine stages start from what the cheap coarse ones have
built up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Event

import numpy as np

from drake_exo.nlp import stop_on_interrupt
from drake_exo.nlp.ipopt_library import run_ipopt
from drake_exo.soles.optimize.limits import FEASIBLE
from drake_exo.soles.optimize.problem import ShapeProblem

_DAMPING = 0.2


class QuasiNewton:
    """Dense damped BFGS approximation of a Lagrangian's Hessian.

    Args:
        metric: Matrix (P, P); a multiple of it is the first approximation.
        matrix: Approximation (P, P) of an earlier stage; None begins anew.
    """

    def __init__(self, metric: np.ndarray, matrix: np.ndarray | None = None):
        self.fresh, self._metric = matrix is None, metric
        self.matrix = 0.1 * metric if self.fresh else matrix.copy()
        self._last = None

    def forget_point(self) -> None:
        """Skip the next difference: its point is of another problem."""
        self._last = None

    def update(self, p, gradient, jacobian, multipliers) -> None:
        """Update the matrix with an accepted point p (P,).

        Takes the cost's gradient (P,) and the constraints' Jacobian (m, P)
        there; the multipliers (m,) are used at this point and the last one.
        """
        last, self._last = self._last, (p.copy(), gradient, jacobian)
        if last is None or np.array_equal(p, last[0]):
            return
        s = p - last[0]
        y = gradient - last[1] + (jacobian - last[2]).T @ multipliers
        if self.fresh and y @ s > 0:
            self.matrix = self._metric * (y @ s) / (s @ self._metric @ s)
            self.fresh = False
        Bs = self.matrix @ s
        sBs, sy = s @ Bs, s @ y
        if sy < _DAMPING * sBs:
            share = (1 - _DAMPING) * sBs / (sBs - sy)
            y = share * y + (1 - share) * Bs
        self.matrix += np.outer(y, y) / (s @ y) - np.outer(Bs, Bs) / sBs


# A stage ends after _PATIENCE iterations, or _REJECTED rejected simulations, in
# which the cost changed by less than _PROGRESS (which no finer mesh would
# confirm), the violation by less than _CLOSER, and the optimality error did not
# fall below 1 and to _NEARER of its value.
_PATIENCE, _REJECTED, _NEARER = 15, 60, 0.3
_PROGRESS, _CLOSER = 2e-3, 1e-3  # of the cost, of the violation
_OPTIONS = {
    "acceptable_iter": 0,
    # Adaptive barriers leap about where costs are not quadratic.
    "mu_strategy": "monotone",
    "mu_init": 1e-3,
    "nlp_scaling_method": "none",
    "bound_relax_factor": 0.0,
    # Second-order corrections cost a simulation each, and win little.
    "max_soc": 0,
    # MUMPS would end the process over a derivative that is no number.
    "check_derivatives_for_naninf": "yes",
    "print_level": 0,
    "sb": "yes",
}
# Contacts open and close along a step, so line searches cut it; a factor on the
# Hessian makes the next steps as short at once. It grows by _STIFFER for each
# rejected trial (two at most), shrinks by _SOFTER if none, up to _STIFFEST.
_STIFFER, _SOFTER, _STIFFEST = 2.0, 1 / 1.5, 64.0
WARM_BARRIER = 1e-7
# IPOPT would otherwise push a warm start away from its bounds.
_WARM = {
    "warm_start_init_point": "yes",
    "warm_start_bound_push": 1e-6,
    "warm_start_bound_frac": 1e-6,
    "warm_start_slack_bound_push": 1e-6,
    "warm_start_slack_bound_frac": 1e-6,
    "warm_start_mult_bound_push": 1e-6,
}

ITERATION_LIMIT = "iteration limit"
# 1 (acceptable point) is switched off; 5 (ended by `watch`) is named elsewhere.
_STATUS = {
    0: "optimal",
    2: "infeasible",
    3: "steps became tiny",
    -1: ITERATION_LIMIT,
    -2: "restoration failed",
    -3: "line search failed",
    -13: "invalid number",
}


@dataclass
class Optimum:
    """Outcome of one solve.

    Attributes:
        p: IPOPT's last design where it met its tolerance, else the best
            feasible one met (least cost, violation up to `FEASIBLE`), or the
            least infeasible where none was feasible.
        cost: Scaled cost at p.
        status: IPOPT's return code in words.
        optimal: Whether IPOPT's tolerance was met.
        error: IPOPT's scaled optimality error at its last point.
        complementarity: Largest |multiplier × distance| of bounds and
            constraints at its last point.
        multipliers: Multipliers of the constraints, (m,).
        at_bounds: Multipliers of lower and upper bounds, (P,) each.
        violation: Largest violation of the scaled constraints at p.
        latest: IPOPT's latest point, multipliers and barrier parameter.
        simulations: Number of simulations.
        trace: Rows (iteration, cost, violation, dual infeasibility).
        former: Earlier values of p, the newest last.
        stage: Stage of the search, from 0.
        seconds: Computing time of the stage [s].
        cost_finer: Cost on a finer mesh, to compare starts; None if unknown.
    """

    p: np.ndarray
    cost: float = np.inf
    status: str = ""
    optimal: bool = False
    error: float = np.inf
    complementarity: float = np.inf
    multipliers: np.ndarray | None = None
    at_bounds: tuple = ()
    latest: tuple = ()
    violation: float = np.inf
    simulations: int = 0
    trace: list = field(default_factory=list)
    former: list = field(default_factory=list)
    stage: int = 0
    seconds: float = 0.0
    cost_finer: float | None = None

    def consider(self, p: np.ndarray, cost: float, violation: float) -> None:
        """Take this design as p if it is better."""
        feasible = violation <= FEASIBLE
        better = cost < self.cost or self.violation > FEASIBLE
        if (feasible and better) or (
            not feasible and violation < self.violation
        ):
            self.former.append(self.p)
            self.p, self.cost, self.violation = p.copy(), cost, violation

    @property
    def rank(self) -> tuple:
        """Sort key: feasible first, then by the cost on a finer mesh."""
        if self.violation > FEASIBLE:
            return True, 0.0, self.violation
        finer = np.inf if self.cost_finer is None else self.cost_finer
        return False, finer, self.cost

    def fall_back(self, problem: ShapeProblem) -> None:
        """Go back to the last best p that a cold start can simulate."""
        if problem.evaluate(self.p) is not None:
            return
        self.status, self.optimal = "only followed from a neighbour", False
        while problem.evaluate(self.p) is None and self.former:
            self.p = self.former.pop()
        self.cost, self.violation = cost_and_violation(problem, self.p)


class _Callbacks:
    """IPOPT's callbacks; it asks for derivatives at accepted points only."""

    def __init__(
        self,
        problem,
        curvature: QuasiNewton,
        best: Optimum,
        say,
        refining=False,
    ):
        self.problem, self.curvature, self.best = problem, curvature, best
        self.say = say
        self.stop, self.stalled = Event(), False
        # Cost, violation, error, iteration, rejections at the last progress.
        self._mark = (np.inf, np.inf, np.inf, 0, 0)
        self._point, self._derivatives = None, None
        self._barrier = _OPTIONS["mu_init"]
        # Factor on the Hessian (see _STIFFER); simulations when it was set.
        self._refining, self._caution, self._before = refining, 1.0, None

    def at(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of cost (without regularization) and constraints.

        Computed once for each accepted point; its pose branch is kept.
        """
        if p.tobytes() != self._point:
            self._derivatives = self.problem.derivatives(p)
            self._point = p.tobytes()
            self.problem.accept(p)
            self.best.consider(p, *cost_and_violation(self.problem, p))
        return self._derivatives

    def interruptible(self, function):
        """The function, which raises KeyboardInterrupt after a Ctrl-C."""

        def call(*args):
            if self.stop.is_set():
                raise KeyboardInterrupt
            return function(*args)

        return call

    def gradient(self, p):
        """Gradient of the cost, (P,)."""
        return self.at(p)[0] + self.problem.regularization(p)[1]

    def jacobian(self, p):
        """The constraints' Jacobian, row by row, (m P,)."""
        return self.at(p)[1].ravel()

    def hessian(self, p, multipliers, factor):
        """The Hessian's lower triangle; restoration has a factor of 0."""
        if factor > 0:
            self.curvature.update(p, *self.at(p), multipliers / factor)
            self.best.latest = (p.copy(), multipliers / factor, self._barrier)
            self._adapt()
            factor *= self._caution
        else:
            self._before = None  # restoration's trials are no rejected steps
        B = self.curvature.matrix + self.problem.regularization(p)[2]
        return max(factor, 1e-3) * B[np.tril_indices(len(p))]

    def _adapt(self) -> None:
        """Adapt the factor on the Hessian to the trials rejected since."""
        done, before = self.problem.evaluations, self._before
        self._before = done
        if not self._refining or before is None:
            return
        rejected = min(max(done - before - 1, 0), 2)
        factor = _STIFFER**rejected if rejected else _SOFTER
        self._caution = np.clip(factor * self._caution, 1.0, _STIFFEST)

    def watch(self, mode, iteration, cost, inf_pr, inf_du, barrier, *_):
        """Record the iteration; return False to end a run without progress."""
        self.best.trace.append((iteration, cost, inf_pr, inf_du))
        self.best.error, self._barrier = inf_du, barrier
        if self.say is not None:
            self.say(iteration, self.best)
        rejected, mark = self.problem.evaluations - iteration, self._mark
        changed = abs(cost - mark[0]) >= _PROGRESS * abs(cost)
        changed = changed or abs(inf_pr - mark[1]) > _CLOSER
        if changed or inf_du < min(1.0, _NEARER * mark[2]):
            self._mark = mark = (cost, inf_pr, inf_du, iteration, rejected)
        self.stalled = (
            iteration - mark[3] >= _PATIENCE or rejected - mark[4] > _REJECTED
        )
        return not self.stalled


def cost_and_violation(problem, p) -> tuple[float, float]:
    """Cost and largest violation; both infinite if the simulation fails."""
    values = problem.constraints(p)
    if not np.isfinite(values).all():
        return np.inf, np.inf
    return problem.cost(p), max(0.0, -float(values.min()))


def minimise(
    problem: ShapeProblem,
    p0: np.ndarray,
    bounds: Sequence[float] | np.ndarray,
    iterations: int = 60,
    tolerance: float = 1e-4,
    on_iterate: Callable[[int, "Optimum"], object] | None = None,
    refining: bool = False,
    hessian_approximation: QuasiNewton | None = None,
    warm=None,
) -> Optimum:
    """Minimise the problem's cost with IPOPT, from p0 clipped to the bounds.

    Args:
        problem, p0: What to minimise, and from where (P,).
        bounds: Lower and upper bound, numbers or (P,) each.
        iterations: Largest number of iterations.
        tolerance: IPOPT's scaled optimality error.
        on_iterate: Called with the iteration and the best so far.
        refining: p0 is good already: rejected trials shorten later steps.
        hessian_approximation: Approximation to start from; it is updated.
        warm: `Checkpoint` of an interrupted run to continue.
    """
    n, m = len(p0), len(problem.names())
    p0, before = np.clip(p0, *bounds), problem.evaluations
    best = Optimum(p0.copy())
    curvature = hessian_approximation or QuasiNewton(problem.metric)
    curvature.forget_point()
    calls = _Callbacks(problem, curvature, best, on_iterate, refining)
    outside = float(np.maximum(-problem.constraints(p0), 0.0).sum())
    multipliers, at_bounds = None, None
    if warm is not None:  # multipliers of the bounds from the barrier
        multipliers = warm.multipliers
        at_bounds = (
            warm.barrier / np.maximum(warm.latest - bounds[0], 1e-9),
            warm.barrier / np.maximum(bounds[1] - warm.latest, 1e-9),
        )
        if problem.evaluate(warm.p) is not None:
            best.consider(warm.p, *cost_and_violation(problem, warm.p))
    functions = (
        *(problem.cost, calls.gradient, problem.constraints),
        *(calls.jacobian, calls.hessian, calls.watch),
    )
    with stop_on_interrupt(calls.stop):
        found = run_ipopt(
            p0,
            tuple(np.full(n, side) for side in bounds),
            (np.zeros(m), np.full(m, np.inf)),
            np.divmod(np.arange(m * n), n),
            np.tril_indices(n),
            *map(calls.interruptible, functions),
            options={
                "max_iter": iterations,
                "tol": tolerance,
                # Caps the violation: far outside, a simulation says little.
                "theta_max_fact": max(0.1, 1.5 * outside),
                **_OPTIONS,
                **({**_WARM, "mu_init": warm.barrier} if warm else {}),
            },
            multipliers=multipliers,
            at_bounds=at_bounds,
        )
    if calls.stop.is_set():
        raise KeyboardInterrupt
    p, status = found.x, found.status
    best.status = _STATUS.get(status, f"IPOPT code {status}")
    if calls.stalled:
        best.status = "no more progress"
    best.optimal = status == 0
    best.multipliers, best.at_bounds = found.multipliers, found.at_bounds
    if problem.evaluate(p) is not None:
        _verify(problem, best, p, bounds, *calls.at(p))
    # From here on designs are simulated from a cold start.
    problem.leave_branch()
    best.fall_back(problem)
    best.simulations = problem.evaluations - before
    return best


def _verify(problem, best, p, bounds, gradient, jacobian) -> None:
    """Set error (Wächter and Biegler's (5)) and complementarity at p."""
    low, high = best.at_bounds
    gradient = gradient + problem.regularization(p)[1]
    values, lam = problem.constraints(p), best.multipliers
    dual = gradient + jacobian.T @ lam - low + high
    products = np.concatenate(
        [low * (p - bounds[0]), high * (bounds[1] - p), lam * values]
    )
    best.complementarity = float(np.abs(products).max())
    size = np.abs(np.concatenate([lam, low, high]))
    s_d = max(100.0, size.mean()) / 100.0
    cost, violation = cost_and_violation(problem, p)
    best.error = max(
        float(np.abs(dual).max()) / s_d, best.complementarity / s_d, violation
    )
    if best.optimal:
        best.p, best.cost, best.violation = p.copy(), cost, violation
