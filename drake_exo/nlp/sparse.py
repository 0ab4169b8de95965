"""A BatchedProgram as sparse arrays: values, Jacobian and Hessian.

Program variables x follow from the unknowns y of the solver through
x = offset + B y. The plain choice only drops fixed variables and applies the
program's variable scaling; a transcription may hand over a sparse B whose
columns satisfy its linear constraints exactly, and those constraints then
leave the problem.
"""

import hashlib
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.batch import Batch, BatchedProgram, BindingKernel
from drake_exo.nlp.program_arrays import (
    linear_rows,
    quadratic_cost,
    variable_bounds,
    variable_scaling,
)

_IDENTICALLY_ZERO = 1e-9
# Far from feasible points the multipliers, and so the curvature, mean little:
# below the first violation curvature enters, above the second it leaves.
_NEARLY_FEASIBLE = 0.1
_FAR = 1.0


@dataclass(frozen=True)
class Substitution:
    """Program variables as an affine function of fewer unknowns.

    Attributes:
        variables: (na,) indices of the program variables substituted.
        matrix: (na, ny) sparse; x[variables] = matrix @ y + offset.
        offset: (na,).
        scale: (ny,) typical size of each unknown.
        accuracy: (na,) how well a guess of each variable is to be kept.
    """

    variables: np.ndarray
    matrix: sp.csr_array
    offset: np.ndarray
    scale: np.ndarray
    accuracy: np.ndarray


class _Block:
    """A batch seen from the unknowns: f(offset + B y), B gathered by node."""

    def __init__(self, batch: Batch, matrix: sp.csr_array):
        self.batch = batch
        n, n_in = batch.indices.shape
        ny = matrix.shape[1]
        rows = matrix[batch.indices.ravel()].tocoo()
        node, slot = np.divmod(rows.row, n_in)
        key, position = np.unique(node * ny + rows.col, return_inverse=True)
        first = np.searchsorted(key, np.arange(n) * ny)
        rank = np.arange(len(key)) - first[key // ny]
        width = int(rank.max()) + 1 if len(rank) else 1
        self.columns = np.full((n, width), -1)
        self.columns[key // ny, rank] = key % ny
        self.local = np.zeros((n, n_in, width))
        self.local[node, slot, rank[position]] = rows.data
        structure = np.abs(self.local) > 0
        if np.ptp(self.local, axis=0).max(initial=0.0) < 1e-14:
            self.local = self.local[0]
            structure = structure[:1]
        pattern = batch.kernel.sparsity.astype(float) @ structure > 0
        pattern = np.broadcast_to(pattern, (n, batch.num_outputs, width))
        self.pattern = pattern & (self.columns >= 0)[:, None, :]
        inputs = batch.kernel.sparsity.any(axis=0)
        inputs = getattr(batch.kernel, "curved_inputs", inputs)
        self.curved = structure[:, inputs].any(axis=1) & (self.columns >= 0)

    def values(self, x):
        return self.batch.kernel.evaluate(
            x[self.batch.indices], self.batch.data
        )

    def jacobian(self, x):
        """Dense blocks (n, n_out, width) with respect to the unknowns."""
        J = self.batch.kernel.jacobian(x[self.batch.indices], self.batch.data)
        if self.local.ndim == 3:
            return J @ self.local
        if J.strides[0] == 0:
            return np.broadcast_to(
                J[0] @ self.local, (*J.shape[:2], self.local.shape[1])
            )
        # One large product is much faster than many small ones.
        flat = J.reshape(-1, J.shape[2]) @ self.local
        return flat.reshape(*J.shape[:2], -1)

    def curvature(self, x, weights):
        """sum_i weights_i d2 f_i/dy2, (n, width, width).

        By differences of the Jacobian where the kernel has no `curvature`.
        """
        kernel, data = self.batch.kernel, self.batch.data
        z = x[self.batch.indices]
        if hasattr(kernel, "curvature"):
            H = kernel.curvature(z, weights, data)
        else:
            n, n_in = z.shape
            H = np.zeros((n, n_in, n_in))
            for k in np.flatnonzero(kernel.sparsity.any(axis=0)):
                H[:, k] = _directional(kernel, z, data, weights, k)
            H = 0.5 * (H + H.transpose(0, 2, 1))
        return np.swapaxes(self.local, -1, -2) @ H @ self.local


def _directional(kernel, z, data, weights, k):
    """d/dz_k of weights^T J by central differences."""
    h = 1e-6 * np.maximum(1.0, np.abs(z[:, k]))
    up, down = z.copy(), z.copy()
    up[:, k] += h
    down[:, k] -= h
    J = kernel.jacobian(up, data) - kernel.jacobian(down, data)
    J /= (2.0 * h)[:, None, None]
    return np.einsum("no,noi->ni", weights, J)


def _accumulate(g: np.ndarray, block: _Block, local: np.ndarray) -> None:
    """Add a block's parts of a gradient (n, width) where they belong."""
    keep = block.columns >= 0
    g += np.bincount(block.columns[keep], local[keep], minlength=len(g))


class SparseProgram:
    """Objective, constraints and derivatives in the unknowns y.

    Attributes:
        num_unknowns: length of y.
        num_constraints: rows of g(y).
        y_lower, y_upper: bounds on y.
        g_lower, g_upper: bounds on g.
        jacobian_structure: (rows, columns) of the nonzeros.
        hessian_structure: (rows, columns) of the lower triangle.
        matrix, offset: B and offset of x = offset + B y.
        linear_matrix: the first rows of g(y), which are linear.
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
        x_lower, x_upper = variable_bounds(program.prog)
        self._x_bounds = x_lower, x_upper
        self._reduce(x_lower, x_upper, substitutions)
        self._collect_constraints(x_lower, x_upper)
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

    # -- unknowns ---------------------------------------------------------

    def _reduce(self, x_lower, x_upper, substitutions):
        """Build x = offset + B y, with y in units of its typical size."""
        n = self.program.prog.num_vars()
        fixed = x_lower == x_upper
        direct = ~fixed
        for s in substitutions:
            direct[s.variables] = False
        kept = np.flatnonzero(direct)
        scale = variable_scaling(self.program.prog)
        blocks = [
            (kept, sp.diags_array(scale[kept]).tocsr(), np.zeros(len(kept)))
        ]
        for s in substitutions:
            matrix = s.matrix @ sp.diags_array(s.scale)
            blocks.append((s.variables, matrix.tocsr(), s.offset))
        rows = np.concatenate([b[0] for b in blocks])
        stacked = sp.block_diag([b[1] for b in blocks], format="coo")
        self.matrix = sp.csr_array(
            (stacked.data, (rows[stacked.row], stacked.col)),
            shape=(n, stacked.shape[1]),
        )
        self.offset = np.where(fixed, x_lower, 0.0)
        for s in substitutions:
            self.offset[s.variables] = s.offset
        self.num_unknowns = self.matrix.shape[1]
        self.y_lower = np.full(self.num_unknowns, -np.inf)
        self.y_upper = np.full(self.num_unknowns, np.inf)
        self.y_lower[: len(kept)] = x_lower[kept] / scale[kept]
        self.y_upper[: len(kept)] = x_upper[kept] / scale[kept]
        self._direct = kept
        self._substituted = np.setdiff1d(
            np.concatenate([s.variables for s in substitutions] or [[]]),
            kept,
        ).astype(int)
        self._row_scale = scale
        self._accuracy = scale.copy()
        for s in substitutions:
            self._accuracy[s.variables] = s.accuracy

    def expand(self, y: np.ndarray) -> np.ndarray:
        """Program variables x of unknowns y."""
        return self.offset + self.matrix @ y

    def restrict(self, x: np.ndarray) -> np.ndarray:
        """Unknowns y whose x is nearest to the given one.

        Distances of substituted variables count in units of their accuracy.
        """
        y = np.zeros(self.num_unknowns)
        scale = self._row_scale
        y[: len(self._direct)] = x[self._direct] / scale[self._direct]
        rows = self._substituted
        if len(rows):
            unit = self._accuracy[rows]
            weight = sp.diags_array(1.0 / unit)
            W = (weight @ self.matrix[rows][:, len(self._direct) :]).tocsc()
            r = (x[rows] - self.offset[rows]) / unit
            y[len(self._direct) :] = sp.linalg.spsolve(W.T @ W, W.T @ r)
        return np.clip(y, self.y_lower, self.y_upper)

    # -- what is in the problem -------------------------------------------

    def _collect_constraints(self, x_lower, x_upper):
        loose, _ = self.program.loose_bindings()
        singles = [
            Batch(
                b.evaluator().get_description() or "constraint",
                BindingKernel(b),
                self.program.indices(b.variables())[None],
                b.evaluator().lower_bound()[None],
                b.evaluator().upper_bound()[None],
            )
            for b in loose
        ]
        blocks = [
            _Block(batch, self.matrix)
            for batch in [*self.program.constraints, *singles]
        ]
        self._blocks = [b for b in blocks if not self._satisfied(b)]
        A, lower, upper, names = linear_rows(self.program.prog)
        rows = self._substituted
        bounded = rows[np.isfinite(x_lower[rows]) | np.isfinite(x_upper[rows])]
        picked = sp.csr_array(
            (
                1.0 / self._row_scale[bounded],
                (np.arange(len(bounded)), bounded),
            ),
            shape=(len(bounded), len(x_lower)),
        )
        A = sp.vstack([A, picked]).tocsr()
        unit = self._row_scale[bounded]
        lower = np.r_[lower, x_lower[bounded] / unit]
        upper = np.r_[upper, x_upper[bounded] / unit]
        names = [
            *names,
            *(
                f"bounds of {self.program.variable_name(int(i))}"
                for i in bounded
            ),
        ]
        self._bounded = bounded
        self.linear_matrix = (A @ self.matrix).tocsr()
        shift = A @ self.offset
        self._linear_names = names
        parts_lower = [lower - shift]
        parts_upper = [upper - shift]
        for b in self._blocks:
            parts_lower.append(b.batch.lower.ravel())
            parts_upper.append(b.batch.upper.ravel())
        self.g_lower = np.concatenate(parts_lower)
        self.g_upper = np.concatenate(parts_upper)
        self.num_constraints = len(self.g_lower)

    def _satisfied(self, block: _Block) -> bool:
        """Whether a batch holds for every y: then it leaves the problem."""
        kernel = block.batch.kernel
        if not hasattr(kernel, "A"):
            return False
        J = block.jacobian(self.offset)
        size = np.abs(kernel.A) @ np.abs(block.local)
        size = size.max(axis=-1, keepdims=True)
        small = np.abs(J) <= _IDENTICALLY_ZERO * size
        if not small.all():
            return False
        f = block.values(self.offset)
        return bool(
            (np.abs(f - block.batch.lower) < _IDENTICALLY_ZERO).all()
            and (np.abs(f - block.batch.upper) < _IDENTICALLY_ZERO).all()
        )

    def _collect_costs(self):
        self.residual_blocks = [
            _Block(batch, self.matrix) for batch in self.program.residuals
        ]
        # Kept in program variables: a basis of splines would lose digits in
        # the cancellation of its large coefficients.
        self._Q, self._b, self._c = quadratic_cost(self.program.prog)
        _, loose = self.program.loose_bindings()
        self._costs = [
            _Block(
                Batch(
                    binding.evaluator().get_description() or "cost",
                    BindingKernel(binding),
                    self.program.indices(binding.variables())[None],
                    np.zeros((1, 1)),
                    np.zeros((1, 1)),
                ),
                self.matrix,
            )
            for binding in loose
        ]

    def _lay_out_jacobian(self):
        coo = self.linear_matrix.tocoo()
        rows, columns = [coo.row], [coo.col]
        first = self.linear_matrix.shape[0]
        for b in self._blocks:
            node, out, slot = np.nonzero(b.pattern)
            rows.append(first + node * b.batch.num_outputs + out)
            columns.append(b.columns[node, slot])
            first += b.batch.lower.size
        self.jacobian_structure = (
            np.concatenate(rows).astype(np.int32),
            np.concatenate(columns).astype(np.int32),
        )
        self._A_values = coo.data

    def _lay_out_hessian(self):
        """Union of all blocks' lower triangles, and where each one lands."""
        curved = [*self.residual_blocks, *self._costs]
        curved += [b for b in self._blocks if self._is_curved(b)]
        Q = self.matrix.T @ self._Q @ self.matrix
        coo = sp.tril(Q).tocoo()
        ny = self.num_unknowns
        keys = [coo.row.astype(np.int64) * ny + coo.col]
        self._triangles = []
        for b in curved:
            row = np.broadcast_to(
                b.columns[:, :, None], (*b.columns.shape, b.columns.shape[1])
            )
            column = row.transpose(0, 2, 1)
            keep = (row >= column) & (column >= 0)
            if b not in self.residual_blocks:
                keep &= b.curved[:, :, None] & b.curved[:, None, :]
            keys.append(row[keep].astype(np.int64) * ny + column[keep])
            self._triangles.append((b, keep))
        unique, inverse = np.unique(np.concatenate(keys), return_inverse=True)
        parts = np.split(inverse, np.cumsum([len(k) for k in keys])[:-1])
        self._H_constant = np.bincount(
            parts[0], coo.data, minlength=len(unique)
        )
        self._H_places = parts[1:]
        self.hessian_structure = (
            (unique // ny).astype(np.int32),
            (unique % ny).astype(np.int32),
        )

    def _is_curved(self, block: _Block) -> bool:
        """Whether a constraint's curvature enters the Hessian."""
        kernel = block.batch.kernel
        if self.exact_hessian:
            return not hasattr(kernel, "A")
        return hasattr(kernel, "curvature")

    # -- bounds of single variables ---------------------------------------

    def relaxable(self, kinds) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns, and rows of g, that are bounded labelled variables.

        Args:
            kinds: of labels that count.
        """
        known = self.program.labelled
        labelled = [i for kind in kinds for i in known.get(kind, [])]
        bounded = np.isfinite(self.y_lower) | np.isfinite(self.y_upper)
        bounded = np.flatnonzero(bounded[: len(self._direct)])
        columns = bounded[np.isin(self._direct[bounded], labelled)]
        rows = self._first_bounded + np.flatnonzero(
            np.isin(self._bounded, labelled)
        )
        return columns, rows

    @property
    def _first_bounded(self) -> int:
        return len(self._linear_names) - len(self._bounded)

    def variable_of_column(self, columns: np.ndarray) -> np.ndarray:
        """Program variable of an unknown that is one by itself."""
        return self._direct[columns]

    def variable_of_row(self, rows: np.ndarray) -> np.ndarray:
        """Program variable that a row of g bounds."""
        return self._bounded[rows - self._first_bounded]

    def row_of_variable(self, variables: np.ndarray) -> np.ndarray:
        """Row of g that bounds each variable; -1 where none does."""
        order = np.argsort(self._bounded)
        place = np.searchsorted(self._bounded, variables, sorter=order)
        place = order[np.minimum(place, len(order) - 1)]
        hit = self._bounded[place] == variables
        return np.where(hit, self._first_bounded + place, -1)

    def column_of_variable(self, variables: np.ndarray) -> np.ndarray:
        """Unknown that is a program variable by itself, up to its scale.

        Raises:
            ValueError: a variable is fixed or substituted.
        """
        place = np.searchsorted(self._direct, variables)
        if (
            self._direct[np.minimum(place, len(self._direct) - 1)] != variables
        ).any():
            raise ValueError("not an unknown by itself")
        return place

    def scale_of(self, variables: np.ndarray) -> np.ndarray:
        """Typical size of program variables."""
        return self._row_scale[variables]

    def bound_of(self, variable: int, upper: bool) -> float:
        """Bound of a program variable in its own unit."""
        return float(self._x_bounds[int(upper)][variable])

    def fingerprint(self) -> str:
        """Digest of bounds, costs and structure: what a checkpoint is of."""
        digest = hashlib.sha256()
        for part in (
            self.y_lower,
            self.y_upper,
            self.g_lower,
            self.g_upper,
            self._b,
            self._H_constant,
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
        g = self.matrix.T @ (self._Q @ x + self._b)
        g += self.residual_gradient(y)
        for b in self._costs:
            _accumulate(g, b, b.jacobian(x)[:, 0])
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
            _accumulate(g, b, np.einsum("no,now->nw", r, J))
        return g

    def constraints(self, y: np.ndarray) -> np.ndarray:
        """Constraint values g(y)."""

        def compute():
            x = self.expand(y)
            parts = [self.linear_matrix @ y]
            parts += [b.values(x).ravel() for b in self._blocks]
            return np.concatenate(parts)

        return self._timed("constraints", y, compute)

    def jacobian(self, y: np.ndarray) -> np.ndarray:
        """Nonzeros of dg/dy, in the order of jacobian_structure."""

        def compute():
            x = self.expand(y)
            parts = [self._A_values]
            parts += [b.jacobian(x)[b.pattern] for b in self._blocks]
            return np.concatenate(parts)

        return self._timed("jacobian", y, compute)

    def hessian(self, y, multipliers, factor) -> np.ndarray:
        """Nonzeros of the Lagrangian's Hessian (lower triangle).

        Residuals contribute their Gauss-Newton term; once the constraints
        nearly hold, they add their curvature where the kernel knows it. With
        exact_hessian the curvature of all of them is added from the start.
        """
        start = time.perf_counter()
        H = factor * self._H_constant
        x = self.expand(y)
        jacobians = dict(
            zip(
                map(id, self.residual_blocks),
                self._residual_jacobians(y),
                strict=True,
            )
        )
        weights = self._curvature_weights(y, multipliers, factor)
        for (b, keep), places in zip(
            self._triangles, self._H_places, strict=True
        ):
            terms = []
            if id(b) in jacobians:
                J = jacobians[id(b)]
                terms.append(factor * (J.transpose(0, 2, 1) @ J))
            if id(b) in weights:
                terms.append(b.curvature(x, weights[id(b)]))
            for term in terms:
                H += np.bincount(places, term[keep], minlength=len(H))
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
        first = self.linear_matrix.shape[0]
        for b in self._blocks:
            size = b.batch.lower.size
            part = multipliers[first : first + size]
            weights[id(b)] = part.reshape(b.batch.lower.shape)
            first += size
        return weights

    def _violation(self, y) -> float:
        """Largest constraint violation."""
        g = self.constraints(y)
        return max(
            np.max(self.g_lower - g, initial=0.0),
            np.max(g - self.g_upper, initial=0.0),
        )

    # -- reports ----------------------------------------------------------

    def row_name(self, row: int) -> str:
        """What constraint a row of g belongs to."""
        if row < len(self._linear_names):
            return self._linear_names[row]
        row -= len(self._linear_names)
        for b in self._blocks:
            if row < b.batch.lower.size:
                node, out = divmod(row, b.batch.num_outputs)
                return f"{b.batch.name}[{node}] row {out}"
            row -= b.batch.lower.size
        raise IndexError("no such constraint")

    def worst_constraints(self, y, count: int = 5):
        """The most violated constraints: list of (name, violation)."""
        g = self.constraints(y)
        violation = np.maximum(self.g_lower - g, g - self.g_upper)
        order = np.argsort(violation)[::-1][:count]
        return [
            (self.row_name(int(i)), float(violation[i]))
            for i in order
            if violation[i] > 0.0
        ]
