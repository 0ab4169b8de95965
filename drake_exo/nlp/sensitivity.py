"""Sensitivity of an optimum to its data, from its optimality conditions.

At a solution, H dy + A^T dl = -dgradient and A dy = dbounds, with the
Gauss-Newton Hessian H and the Jacobian A of equations and active bounds;
l are the multipliers.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from drake_exo.nlp.sparse import SparseProgram

# A bound that is closer than this, in units of the variable, counts as active.
_ACTIVE = 1e-5
# Added to the diagonal: active bounds may repeat an equation.
_REGULAR = 1e-9
_DIFFERENCE = 1e-5  # step, as a share of a fixed variable's typical size


@dataclass(frozen=True)
class Response:
    """Derivatives of m unknowns at the optimum.

    Attributes:
        by_gradient: (m, num_unknowns) by what is added to the cost's gradient.
        by_bounds: (m, num_constraints) by the active bound of each constraint;
            zero if none is active.
    """

    by_gradient: np.ndarray
    by_bounds: np.ndarray


def response(
    problem: SparseProgram,
    y: np.ndarray,
    unknowns: np.ndarray,
    border: np.ndarray | None = None,
    without: sp.sparray | None = None,
) -> Response:
    """Response of unknowns at an optimum y.

    Args:
        problem: the problem that y solves.
        y: (num_unknowns,) the optimum.
        unknowns: (m,) indices into y; those at an active bound do not move.
        border: see `Optimum`; `unknowns` by default.
        without: see `Optimum`.
    """
    border = unknowns if border is None else border
    optimum = Optimum(problem, y, border, without)
    free, held = optimum.free, optimum.held
    place = np.full(problem.num_unknowns, -1)
    place[free] = np.arange(len(free))
    moving = np.flatnonzero(place[unknowns] >= 0)
    unit = np.zeros((len(free) + len(held), len(moving)))
    unit[place[unknowns[moving]], np.arange(len(moving))] = 1.0
    Z = optimum.solve(unit).T
    by_gradient = np.zeros((len(unknowns), problem.num_unknowns))
    by_bounds = np.zeros((len(unknowns), problem.num_constraints))
    by_gradient[np.ix_(moving, free)] = -Z[:, : len(free)]
    by_bounds[np.ix_(moving, held)] = Z[:, len(free) :]
    return Response(by_gradient, by_bounds)


class Optimum:
    """Optimality conditions of an optimum, linearised and factorised.

    Args:
        problem: the problem that y solves.
        y: (num_unknowns,) the optimum.
        border: unknowns that all nodes share. Without them, and equations of
            them alone, the system is banded in time; they are solved for by
            the Schur complement.
        without: part (num_unknowns, num_unknowns) of the cost's curvature to
            leave out.

    Attributes:
        free: indices of unknowns that are not at a bound.
        held: indices of constraints that are equations or at a bound.
    """

    def __init__(
        self,
        problem: SparseProgram,
        y: np.ndarray,
        border: np.ndarray,
        without: sp.sparray | None = None,
    ):
        self._problem, self._y = problem, y
        self.free = free = np.flatnonzero(
            np.minimum(y - problem.y_lower, problem.y_upper - y) > _ACTIVE
        )
        g = problem.constraints(y)
        slack = np.minimum(g - problem.g_lower, problem.g_upper - g)
        self.held = held = np.flatnonzero(slack < _ACTIVE)
        # Gauss-Newton Hessian, both triangles.
        lower = sp.csr_array(
            (problem.gauss_newton(y), problem.hessian_structure),
            (len(y), len(y)),
        )
        H = (lower + sp.tril(lower, -1).T).tocsr()
        H = (H if without is None else H - without)[free][:, free]
        A = sp.csr_array(
            (problem.jacobian(y), problem.jacobian_structure), (len(g), len(y))
        )[held][:, free]
        K = sp.block_array(
            [
                [H + _REGULAR * sp.eye_array(len(free)), A.T],
                [A, -_REGULAR * sp.eye_array(len(held))],
            ],
            format="csc",
        )
        inside = np.isin(free, border)
        outside = np.diff(A[:, ~inside].indptr)
        alone = (outside == 0) & (np.diff(A.indptr) > 0)
        alone &= not inside.all()  # something is left to factorise
        index = self._index = np.flatnonzero(np.r_[inside, alone])
        rest = self._rest = np.setdiff1d(np.arange(K.shape[0]), index)
        inner = K[rest][:, rest].tocsc()
        self._order = csgraph.reverse_cuthill_mckee(inner, symmetric_mode=True)
        banded = inner[self._order][:, self._order].tocsc()
        self._factor = sp.linalg.splu(banded, permc_spec="NATURAL")
        self._border = K[rest][:, index].toarray()
        self._X = self._banded(self._border)
        schur = K[index][:, index].toarray() - self._border.T @ self._X
        self._schur = np.linalg.inv(schur)

    def _banded(self, b: np.ndarray) -> np.ndarray:
        x = np.empty_like(b)
        x[self._order] = self._factor.solve(b[self._order])
        return x

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solutions (n, k) for right-hand sides b: free rows, then held."""
        x = np.empty_like(b)
        inner = self._banded(b[self._rest])
        x[self._index] = self._schur @ (b[self._index] - self._border.T @ inner)
        x[self._rest] = inner - self._X @ x[self._index]
        return x

    def _moved(self, b: np.ndarray) -> np.ndarray:
        """Changes (num_unknowns, k) of y for right-hand sides b (n, k)."""
        dy = np.zeros((len(self._y), b.shape[1]))
        dy[self.free] = self.solve(b)[: len(self.free)]
        return dy

    def by_gradient(self, change: np.ndarray) -> np.ndarray:
        """Changes of y by changes (num_unknowns, k) of the cost's gradient."""
        none = np.zeros((len(self.held), change.shape[1]))
        return self._moved(np.vstack([-change[self.free], none]))

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Multipliers of the constraints `held` at the optimum."""
        start = np.concatenate(
            [
                -self._problem.gradient(self._y)[self.free],
                np.zeros(len(self.held)),
            ]
        )
        return self.solve(start[:, None])[len(self.free) :, 0]

    def cost_by_fixed(self, variables: np.ndarray) -> np.ndarray:
        """Derivative (k,) of the optimal cost by fixed program variables.

        It equals the Lagrangian's at constant y (envelope theorem), which is
        found by central differences.
        """
        problem, y = self._problem, self._y

        def lagrangian(variable: int, step: float) -> float:
            problem.move_fixed(variable, step)
            value = problem.constraints(y)[self.held] @ self.multipliers
            value += problem.objective(y)
            problem.move_fixed(variable, -step)
            return float(value)

        steps = _DIFFERENCE * problem.unknowns.scale[variables]
        return np.array(
            [
                (lagrangian(v, h) - lagrangian(v, -h)) / (2.0 * h)
                for v, h in zip(variables, steps, strict=True)
            ]
        )

    def by_fixed(self, variables: np.ndarray) -> np.ndarray:
        """Derivatives (num_unknowns, k) of y by fixed program variables.

        From central differences of the optimality conditions by each variable.
        """
        problem, y, size = self._problem, self._y, len(self.free)
        unit = problem.unknowns.scale[variables]

        multipliers = np.zeros(problem.num_constraints)
        multipliers[self.held] = self.multipliers

        def conditions(variable: int, step: float) -> np.ndarray:
            slope, value = problem.moved_conditions(
                y, multipliers, variable, step
            )
            return np.concatenate([slope[self.free], value[self.held]])

        change = np.empty((size + len(self.held), len(variables)))
        for k, variable in enumerate(variables):
            step = _DIFFERENCE * unit[k]
            change[:, k] = (
                conditions(variable, step) - conditions(variable, -step)
            ) / (2.0 * step)
        return self._moved(-change)
