"""A BatchedProgram as sparse arrays: values, Jacobian and Hessian.

Everything is a function of the solver's unknowns y (`Unknowns`). Linear
constraints that a substitution satisfies exactly leave the problem.
"""

import hashlib
import time
from collections import defaultdict

import numpy as np

from drake_exo.nlp.batch import Batch, BatchedProgram, BindingKernel
from drake_exo.nlp.block import Block, accumulate
from drake_exo.nlp.constraint_rows import ConstraintRows
from drake_exo.nlp.hessian import HessianLayout
from drake_exo.nlp.program_arrays import quadratic_cost
from drake_exo.nlp.unknowns import Substitution, Unknowns

# Far from feasible points the multipliers, and so the curvature, mean little:
# below the first violation curvature enters, above the second it leaves.
_NEARLY_FEASIBLE = 0.1
_FAR = 1.0


class SparseProgram:
    """Objective, constraints and derivatives in the unknowns y.

    Attributes:
        unknowns: what y is, and how the program's variables follow.
        rows: what the rows of g(y) are.
        num_unknowns: length of y.
        num_constraints: rows of g(y).
        y_lower, y_upper: bounds on y.
        g_lower, g_upper: bounds on g.
        jacobian_structure: (rows, columns) of the nonzeros.
        hessian_structure: (rows, columns) of the lower triangle.
        residual_blocks: least-squares terms of the cost.
        seconds: time spent by part, filled while solving.
        evaluations: calls by part.
    """

    def __init__(
        self,
        program: BatchedProgram,
        substitutions: tuple[Substitution, ...] = (),
        exact_hessian: bool = False,
    ):
        self.program = program
        self.exact_hessian = exact_hessian
        self.seconds: dict[str, float] = defaultdict(float)
        self.evaluations: dict[str, int] = defaultdict(int)
        self._cache: dict[str, tuple] = {}
        self._is_near = False
        self.unknowns = Unknowns(program.prog, substitutions)
        self.num_unknowns = self.unknowns.count
        self.y_lower, self.y_upper = self.unknowns.lower, self.unknowns.upper
        self.rows = ConstraintRows(program, self.unknowns)
        self.g_lower, self.g_upper = self.rows.lower, self.rows.upper
        self.num_constraints = len(self.g_lower)
        self._collect_costs()
        self._lay_out_jacobian()
        self._lay_out_hessian()

    def start_again(self) -> None:
        """Forget where the last attempt got to; call before each."""
        self._is_near = False

    def use_exact_hessian(self, exact: bool) -> None:
        """Whether to add the curvature of all constraints and residuals."""
        if self.exact_hessian != exact:
            self.exact_hessian = exact
            self._lay_out_hessian()

    def expand(self, y: np.ndarray) -> np.ndarray:
        """See Unknowns."""
        return self.unknowns.expand(y)

    def restrict(self, x: np.ndarray) -> np.ndarray:
        """See Unknowns."""
        return self.unknowns.restrict(x)

    # -- what is in the problem -------------------------------------------

    def _collect_costs(self):
        matrix = self.unknowns.matrix
        self.residual_blocks = [
            Block(batch, matrix) for batch in self.program.residuals
        ]
        # Kept in program variables: a basis of splines would lose digits in
        # the cancellation of its large coefficients.
        self._Q, self._b, self._c = quadratic_cost(self.program.prog)
        _, loose = self.program.loose_bindings()
        self._costs = [
            Block(
                Batch(
                    binding.evaluator().get_description() or "cost",
                    BindingKernel(binding),
                    self.program.indices(binding.variables())[None],
                    np.zeros((1, 1)),
                    np.zeros((1, 1)),
                ),
                matrix,
            )
            for binding in loose
        ]

    def _lay_out_jacobian(self):
        coo = self.rows.linear.tocoo()
        rows, columns = [coo.row], [coo.col]
        for b, place in self.rows.numbered_blocks():
            node, out, slot = np.nonzero(b.pattern)
            rows.append(place.start + node * b.batch.num_outputs + out)
            columns.append(b.columns[node, slot])
        self.jacobian_structure = (
            np.concatenate(rows).astype(np.int32),
            np.concatenate(columns).astype(np.int32),
        )
        self._A_values = coo.data

    def _lay_out_hessian(self):
        matrix = self.unknowns.matrix
        curved = [b for b in self.rows.blocks if self._is_curved(b)]
        self._hessian = HessianLayout(
            matrix.T @ self._Q @ matrix,
            self.residual_blocks,
            [*self._costs, *curved],
        )
        self.hessian_structure = self._hessian.structure

    def _is_curved(self, block: Block) -> bool:
        """Whether a constraint's curvature enters the Hessian."""
        kernel = block.batch.kernel
        if self.exact_hessian:
            return not hasattr(kernel, "A")
        return hasattr(kernel, "curvature")

    def relaxable(self, kinds) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns, and rows of g, that are bounded labelled variables.

        Args:
            kinds: of labels that count.
        """
        known = self.program.labelled
        labelled = [i for kind in kinds for i in known.get(kind, [])]
        columns = self.unknowns.bounded_columns()
        hit = np.isin(self.unknowns.variable_of(columns), labelled)
        return columns[hit], self.rows.bounding(labelled)

    def fingerprint(self) -> str:
        """Digest of bounds, costs and structure: what a checkpoint is of."""
        digest = hashlib.sha256()
        for part in (
            self.y_lower,
            self.y_upper,
            self.g_lower,
            self.g_upper,
            self._b,
            self._hessian.constant,
            *self.jacobian_structure,
        ):
            digest.update(np.ascontiguousarray(part).tobytes())
        return digest.hexdigest()

    # -- evaluation -------------------------------------------------------

    def _timed(self, part, y, compute):
        """Compute once for each part and y, and count time and calls."""
        cached = self._cache.get(part)
        if cached is not None and np.array_equal(cached[0], y):
            return cached[1]
        start = time.perf_counter()
        result = compute()
        self.seconds[part] += time.perf_counter() - start
        self.evaluations[part] += 1
        self._cache[part] = (y.copy(), result)
        return result

    def _residual_terms(self, y):
        def compute():
            x = self.expand(y)
            return [b.values(x) for b in self.residual_blocks]

        return self._timed("residuals", y, compute)

    def _residual_jacobians(self, y):
        def compute():
            x = self.expand(y)
            return [b.jacobian(x) for b in self.residual_blocks]

        return self._timed("residual_jacobian", y, compute)

    def objective(self, y: np.ndarray) -> float:
        """Cost at y."""
        x = self.expand(y)
        value = 0.5 * x @ (self._Q @ x) + self._b @ x + self._c
        for r in self._residual_terms(y):
            value += 0.5 * np.sum(r * r)
        if self._costs:
            value += sum(b.values(x).sum() for b in self._costs)
        return float(value)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """Derivative of the cost, (ny,)."""
        x = self.expand(y)
        g = self.unknowns.matrix.T @ (self._Q @ x + self._b)
        g += self.residual_gradient(y)
        for b in self._costs:
            accumulate(g, b, b.jacobian(x)[:, 0])
        return g

    def residual_gradient(self, y: np.ndarray) -> np.ndarray:
        """The part of the gradient that least-squares residuals have."""
        g = np.zeros(self.num_unknowns)
        for b, r, J in zip(
            self.residual_blocks,
            self._residual_terms(y),
            self._residual_jacobians(y),
            strict=True,
        ):
            accumulate(g, b, np.einsum("no,now->nw", r, J))
        return g

    def constraints(self, y: np.ndarray) -> np.ndarray:
        """Constraint values g(y)."""

        def compute():
            x = self.expand(y)
            parts = [self.rows.linear @ y]
            parts += [b.values(x).ravel() for b in self.rows.blocks]
            return np.concatenate(parts)

        return self._timed("constraints", y, compute)

    def jacobian(self, y: np.ndarray) -> np.ndarray:
        """Nonzeros of dg/dy, in the order of jacobian_structure."""

        def compute():
            x = self.expand(y)
            parts = [self._A_values]
            parts += [b.jacobian(x)[b.pattern] for b in self.rows.blocks]
            return np.concatenate(parts)

        return self._timed("jacobian", y, compute)

    def hessian(self, y, multipliers, factor) -> np.ndarray:
        """Nonzeros of the Lagrangian's Hessian (lower triangle).

        Residuals contribute their Gauss-Newton term; once the constraints
        nearly hold, they add their curvature where the kernel knows it. With
        exact_hessian the curvature of all of them is added from the start.
        """
        start = time.perf_counter()
        jacobians = dict(
            zip(
                map(id, self.residual_blocks),
                self._residual_jacobians(y),
                strict=True,
            )
        )
        weights = self._curvature_weights(y, multipliers, factor)
        H = self._hessian.values(factor, self.expand(y), jacobians, weights)
        self.seconds["hessian"] += time.perf_counter() - start
        self.evaluations["hessian"] += 1
        return H

    def _curvature_weights(self, y, multipliers, factor):
        weights = {id(b): np.full((1, 1), factor) for b in self._costs}
        if self.exact_hessian:
            terms = self._residual_terms(y)
            for b, r in zip(self.residual_blocks, terms, strict=True):
                weights[id(b)] = factor * r
        else:
            enough = _FAR if self._is_near else _NEARLY_FEASIBLE
            self._is_near = self._violation(y) <= enough
            if not self._is_near:
                return weights
        for b, place in self.rows.numbered_blocks():
            weights[id(b)] = multipliers[place].reshape(b.batch.lower.shape)
        return weights

    def _violation(self, y) -> float:
        """Largest constraint violation."""
        g = self.constraints(y)
        return max(
            np.max(self.g_lower - g, initial=0.0),
            np.max(g - self.g_upper, initial=0.0),
        )

    # -- reports ----------------------------------------------------------

    def worst_constraints(self, y, count: int = 5):
        """The most violated constraints: list of (name, violation)."""
        g = self.constraints(y)
        violation = np.maximum(self.g_lower - g, g - self.g_upper)
        order = np.argsort(violation)[::-1][:count]
        return [
            (self.rows.name(int(i)), float(violation[i]))
            for i in order
            if violation[i] > 0.0
        ]
