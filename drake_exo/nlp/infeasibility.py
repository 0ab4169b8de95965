"""Diagnosis of a program that cannot be solved, by the names of its bounds.

Before a solve, `check` refuses input that would waste it. After a solve that
found no feasible point, `relax` finds which bounds make the program infeasible,
and by how much: bounds of trajectories (torque limits, given end states) become
springs, and those that stay stretched are reported. Everything else, such as
dynamics and contact, keeps holding. Soft springs yield to costs as well, so
only the stiffest prove that there is no solution.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from drake_exo.errors import InputError
from drake_exo.nlp.sparse import SparseProgram

# A parameter has no influence if all derivatives by it are below this.
_INFLUENCE = 1e-9
# Kinds of bounds -> stiffness of their springs against costs of order one,
# softest first: each solve starts from the last. A bound that is merely active
# yields by its multiplier over the stiffness. Limits come before given states.
_STAGES = {("limit",): (1.0, 30.0, 1e3, 1e5), ("state",): (30.0, 1e3, 1e5)}
# Least excess that is reported, in the variables' typical sizes.
SIGNIFICANT = 5e-3
_TOLD = 8  # bounds that are reported at most


def check(
    problem: SparseProgram, guess: np.ndarray, parameters: dict[str, int]
) -> None:
    """Refuse a faulty guess, bounds, or parameters without influence.

    Args:
        problem: the compiled program.
        guess: (num_vars,) program variables.
        parameters: program index of each free parameter by name.

    Raises:
        InputError: the guess has another length or holds NaN, bounds exclude
            each other, a constraint is not finite at the guess, or a parameter
            influences neither a constraint nor a residual.
    """
    size = problem.program.prog.num_vars()
    if np.shape(guess) != (size,):
        raise InputError(
            f"the guess has the shape {np.shape(guess)}, but the program has "
            f"{size} variables; give one value for each"
        )
    if not np.isfinite(guess).all():
        bad = int(np.flatnonzero(~np.isfinite(guess))[0])
        name = problem.program.prog.decision_variable(bad).get_name()
        raise InputError(
            f"the guess of {name} is {guess[bad]}; check the trial's "
            "data for gaps"
        )
    for lower, upper, what in (
        (problem.y_lower, problem.y_upper, "a variable"),
        (problem.g_lower, problem.g_upper, "a constraint"),
    ):
        if (lower > upper).any():
            raise InputError(
                f"{what} has a lower bound above its upper bound; check the "
                "bounds of parameters and end states"
            )
    y = problem.restrict(guess)
    g = problem.constraints(y)
    if not np.isfinite(g).all():
        row = int(np.flatnonzero(~np.isfinite(g))[0])
        raise InputError(
            f"{problem.rows.name(row)} is not finite at the guess; check the "
            "trial's data and the parameters' nominal values"
        )
    influence = _influence(problem, y)
    for name, index in parameters.items():
        columns = problem.unknowns.matrix[[index]].indices
        if influence[columns].max(initial=0.0) <= _INFLUENCE:
            raise InputError(
                f"parameter {name} influences nothing that was measured; fix "
                "it (free: false) or add data that depends on it"
            )


def _influence(problem, y):
    """Largest derivative (ny,) of any constraint, residual by each unknown."""
    _, columns = problem.jacobian_structure
    influence = np.zeros(problem.num_unknowns)
    np.maximum.at(influence, columns, np.abs(problem.jacobian(y)))
    for block in problem.residual_blocks:
        J = np.abs(block.jacobian(problem.expand(y))).max(axis=1)
        keep = block.columns >= 0
        np.maximum.at(influence, block.columns[keep], J[keep])
    return influence


@dataclass(frozen=True)
class Excess:
    """A bound that had to give way.

    Attributes:
        name: label of the variable.
        needed: value that it takes beyond its bound.
        bound: the bound that it exceeds.
        unit: unit of both.
    """

    name: str
    needed: float
    bound: float
    unit: str

    def __str__(self) -> str:
        return (
            f"{self.name} would be {self.needed:.4g} {self.unit}, "
            f"its bound is {self.bound:.4g} {self.unit}"
        )


def relax(
    problem: SparseProgram,
    y: np.ndarray,
    attempt: Callable[["ElasticProgram", np.ndarray], np.ndarray | None],
) -> tuple[np.ndarray, list[Excess], bool]:
    """Find the bounds that exclude each other.

    Args:
        problem: the problem that could not be solved.
        y: start (ny,).
        attempt: solves an elastic program from a start; None if it fails.

    Returns:
        Start for the next attempt, a better one than y if springs settled the
        question; bounds that yielded to the stiffest springs that could be
        solved; and whether these were the stiffest of all: infeasible.
    """
    hint = []
    for kinds, stiffnesses in _STAGES.items():
        found, at = [], y
        for stiffness in stiffnesses:
            elastic = ElasticProgram(problem, kinds, stiffness)
            if not elastic.num_springs:
                break
            solved = attempt(elastic, at)
            if solved is None:
                break
            at, found = solved, elastic.binding(solved)
            if not found or stiffness == stiffnesses[-1]:
                at = np.clip(at, problem.y_lower, problem.y_upper)
                return at, found, bool(found)
        hint = hint or found
    return y, hint, False


class ElasticProgram:
    """A SparseProgram with springs in place of some bounds; same interface.

    Args:
        problem: the problem to relax. Only bounds of labelled variables
            (`BatchedProgram.label`) yield; those of fixed variables do only
            if the collocation constraints were substituted.
        kinds: kinds of labels whose bounds yield.
        weight: stiffness of the springs.

    Attributes:
        num_springs: number of variables and rows whose bounds yield.
    """

    def __init__(self, problem: SparseProgram, kinds, weight: float):
        self._problem = problem
        self._weight = weight
        labelled = problem.program.labelled(kinds)
        columns, direct = problem.unknowns.bounding(labelled)
        rows, substituted = problem.rows.bounding(labelled)
        self._variables = np.r_[direct, substituted]
        unit = sp.eye_array(problem.num_unknowns, format="csr")
        self._ends = sp.vstack(
            [unit[columns], problem.rows.linear[rows]], format="csr"
        )
        self._lower = np.r_[problem.y_lower[columns], problem.g_lower[rows]]
        self._upper = np.r_[problem.y_upper[columns], problem.g_upper[rows]]
        self.num_springs = len(self._lower)
        self.y_lower = _with(problem.y_lower, columns, -np.inf)
        self.y_upper = _with(problem.y_upper, columns, np.inf)
        self.g_lower = _with(problem.g_lower, rows, -np.inf)
        self.g_upper = _with(problem.g_upper, rows, np.inf)
        # The springs' entries follow the problem's; IPOPT adds duplicates.
        own = [self._entries(k) for k in range(self.num_springs)]
        spring, *place, self._curvature = np.hstack([np.zeros((4, 0)), *own])
        self._spring = spring.astype(int)
        self.hessian_structure = tuple(
            np.concatenate([others, part.astype(np.int32)])
            for others, part in zip(
                problem.hessian_structure, place, strict=True
            )
        )

    def _entries(self, spring: int) -> np.ndarray:
        """A spring's Hessian entries (4, k): number, row, column, value."""
        ends = self._ends
        part = slice(ends.indptr[spring], ends.indptr[spring + 1])
        index, data = ends.indices[part], ends.data[part]
        i, j = np.nonzero(index[:, None] >= index)
        number = np.full(len(i), spring)
        return np.stack([number, index[i], index[j], data[i] * data[j]])

    def __getattr__(self, name):
        """Take everything that springs do not change from the problem."""
        return getattr(self._problem, name)

    def excess(self, y: np.ndarray) -> np.ndarray:
        """Excess (num_springs,) of variables, then rows, over their bounds."""
        z = self._ends @ y
        return z - np.clip(z, self._lower, self._upper)

    def objective(self, y):
        """The problem's objective plus the springs' energy."""
        e = self.excess(y)
        return self._problem.objective(y) + 0.5 * self._weight * float(e @ e)

    def gradient(self, y):
        """Derivative of the objective."""
        e = self._weight * self.excess(y)
        return self._problem.gradient(y) + self._ends.T @ e

    def hessian(self, y, multipliers, factor):
        """See SparseProgram; in the order of hessian_structure."""
        stretched = self.excess(y)[self._spring] != 0.0
        own = factor * self._weight * self._curvature * stretched
        return np.r_[self._problem.hessian(y, multipliers, factor), own]

    def binding(self, y: np.ndarray) -> list[Excess]:
        """The bounds that are exceeded most, one for each signal."""
        excess = self.excess(y)
        x = self._problem.expand(y)
        found: dict[str, Excess] = {}
        for k in np.argsort(-np.abs(excess)):
            if abs(excess[k]) < SIGNIFICANT or len(found) == _TOLD:
                break
            i = int(self._variables[k])
            program, known = self._problem.program, self._problem.unknowns
            bounds = known.x_upper if excess[k] > 0.0 else known.x_lower
            signal, _, (unit, factor) = program.label_of(i)
            found.setdefault(
                signal,
                Excess(
                    program.variable_name(i),
                    factor * x[i],
                    factor * bounds[i],
                    unit,
                ),
            )
        return list(found.values())


def _with(bounds, index, value):
    changed = bounds.copy()
    changed[index] = value
    return changed
