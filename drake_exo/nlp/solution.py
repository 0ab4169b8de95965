"""A solution that says whether it succeeded, and is sealed if it did not."""

from dataclasses import dataclass, field

import numpy as np

from drake_exo.nlp.infeasibility import Excess


class SealedSolutionError(RuntimeError):
    """A failed solution was read without `unseal()`."""


@dataclass
class Solution:
    """Result of one solve.

    Attributes:
        success: whether the solver met its tolerances.
        status: in words.
        iterations: of the solver, all attempts together.
        objective: at the returned point.
        infeasibility: largest scaled constraint violation there.
        worst_constraints: (name, violation), largest first.
        binding: bounds that exclude each other, of an infeasible problem.
        active_bounds: names of named parameters that sit at a bound.
        num_variables, num_constraints, jacobian_nonzeros: of the problem
            that the solver saw.
        seconds: time by part ("build", "solve", "linear_algebra", ...).
        evaluations: calls by part.
        strategy: barrier strategy of the last attempt.
    """

    success: bool
    status: str
    iterations: int
    objective: float
    infeasibility: float
    worst_constraints: list[tuple[str, float]]
    num_variables: int
    num_constraints: int
    jacobian_nonzeros: int
    strategy: str = ""
    binding: list[Excess] = field(default_factory=list)
    active_bounds: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    evaluations: dict[str, int] = field(default_factory=dict)
    _values: np.ndarray = field(default=None, repr=False)
    _sealed: bool = field(default=False, repr=False)

    def __post_init__(self):
        self._sealed = not self.success

    @property
    def is_sealed(self) -> bool:
        """Whether reading values raises."""
        return self._sealed

    def unseal(self) -> "Solution":
        """Allow a failed solution to be read; returns itself."""
        self._sealed = False
        return self

    def values(self, indices: np.ndarray) -> np.ndarray:
        """Values of program variables by index, same shape.

        Raises:
            SealedSolutionError: if the solve failed and nobody unsealed it.
        """
        if self._sealed:
            raise SealedSolutionError(
                f"the solve failed ({self.status}); its values are not a "
                "solution. Call unseal() to look at them all the same. "
                + self.explain()
            )
        return self._values[indices]

    def raw_values(self) -> np.ndarray:
        """All program variables, sealed or not: for reports of failures."""
        return self._values

    def explain(self) -> str:
        """The worst constraints by name, and what to try next."""
        if self.success:
            return "all constraints hold"
        if self.binding:
            return (
                "Bounds that are in the way, and the least change found: "
                + "; ".join(map(str, self.binding))
                + "."
            )
        if not self.worst_constraints:
            return (
                "All constraints hold: the point is feasible but not yet "
                "optimal; allow more iterations."
            )
        worst = "; ".join(
            f"{name} off by {violation:.3g}"
            for name, violation in self.worst_constraints
        )
        return f"Worst constraints (scaled): {worst}."
