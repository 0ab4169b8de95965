"""A BatchedProgram as sparse arrays: values, Jacobian and Hessian.

Everything is a function of the solver's unknowns y (`Unknowns`). A batch
becomes a `Block`, in which each instance depends on the few unknowns that
determine its inputs. `ConstraintRows` stacks the rows of g(y), and
`HessianLayout` sums the blocks' parts of the Lagrangian's Hessian.
"""

import hashlib
import time
from collections import defaultdict

import numpy as np
import scipy.sparse as sp
from pydrake.solvers import IpoptSolver

from drake_exo.errors import InputError
from drake_exo.nlp.program import (
    Batch,
    BatchedProgram,
    BindingKernel,
    Substitution,
    Unknowns,
    linear_rows,
)

# Far from feasible points multipliers, and so the constraints' curvature, mean
# little: it enters below the first violation and leaves above the second.
_NEARLY_FEASIBLE = 0.2
_FAR = 2.0
# Tolerance for coefficients and bounds of constraints that hold for every y.
_IDENTICALLY_ZERO = 1e-9
_ROUNDING = 1e-12  # relative, of coefficients


class SparseProgram:
    """Objective, constraints and derivatives in the unknowns y.

    Attributes:
        unknowns: meaning of y, and map to the program's variables.
        expand, restrict: those of `unknowns`.
        rows: meaning of the rows of g(y).
        num_unknowns: length of y.
        num_constraints: rows of g(y).
        y_lower, y_upper: bounds on y.
        g_lower, g_upper: bounds on g.
        jacobian_structure: (rows, columns) of the nonzeros.
        hessian_structure: (rows, columns) of the lower triangle.
        exact_hessian: whether all curvature enters `hessian`, everywhere.
        residual_blocks: least-squares terms of the cost.
        seconds: time spent by part, filled while solving.
        evaluations: calls by part.

    Raises:
        InputError: the program holds what IPOPT cannot solve.
    """

    def __init__(
        self,
        program: BatchedProgram,
        substitutions: tuple[Substitution, ...] = (),
        exact_hessian: bool = False,
    ):
        # Else binary variables and complementarity would be ignored.
        why = IpoptSolver().ExplainUnsatisfiedProgramAttributes(program.prog)
        if why:
            raise InputError(f"{why.rstrip('.')}; take out what was added")
        self.program = program
        self.exact_hessian = exact_hessian
        self.seconds: dict[str, float] = defaultdict(float)
        self.evaluations: dict[str, int] = defaultdict(int)
        self._cache: dict[str, tuple] = {}
        self._is_near = False
        self.unknowns = unknowns = Unknowns(program.prog, substitutions)
        self.num_unknowns = unknowns.count
        self.expand, self.restrict = unknowns.expand, unknowns.restrict
        self.y_lower, self.y_upper = unknowns.lower, unknowns.upper
        self.rows = ConstraintRows(program, unknowns)
        self.g_lower, self.g_upper = self.rows.lower, self.rows.upper
        self.num_constraints = len(self.g_lower)
        self._moved = np.zeros(self.rows.linear.shape[0])  # by `move_fixed`
        matrix = unknowns.matrix
        self.residual_blocks = [Block(b, matrix) for b in program.residuals]
        self._costs = [Block(b, matrix) for b in program.loose_costs()]
        # Kept in program variables: in a basis of splines the large
        # coefficients would cancel and lose digits.
        self._Q, self._b, self._c = program.quadratic_cost()
        self._lay_out_jacobian()
        self._layouts = {}  # exact_hessian -> HessianLayout

    def start_again(self) -> None:
        """Reset to "far from feasible"; to be called before each attempt."""
        self._is_near = False

    def move_fixed(self, variable: int, step: float) -> None:
        """Change the value of a fixed program variable; y stays."""
        self.unknowns.offset[variable] += step
        self._moved += step * self.rows.slope(variable)
        self._cache.clear()

    # -- structure ---------------------------------------------------------

    def _lay_out_jacobian(self):
        coo = self.rows.linear.tocoo()
        rows, columns = [coo.row], [coo.col]
        self._entries = []
        for b, place in self.rows.numbered_blocks():
            self._entries.append(np.flatnonzero(b.pattern))
            numbers = np.arange(place.start, place.stop)
            rows.append(np.repeat(numbers, b.pattern.sum(axis=2).ravel()))
            every = np.broadcast_to(b.columns[:, None], b.pattern.shape)
            columns.append(every[b.pattern])
        self.jacobian_structure = (
            np.concatenate(rows).astype(np.int32),
            np.concatenate(columns).astype(np.int32),
        )
        self._A_values = coo.data

    @property
    def hessian_structure(self) -> tuple[np.ndarray, np.ndarray]:
        """See the attributes of the class."""
        return self._layout.structure

    @property
    def _layout(self) -> "HessianLayout":
        if self.exact_hessian not in self._layouts:
            matrix = self.unknowns.matrix
            blocks = [*self.residual_blocks, *self.rows.blocks]
            curved = [b for b in blocks if self._is_curved(b)]
            self._layouts[self.exact_hessian] = HessianLayout(
                matrix.T @ self._Q @ matrix,
                self.residual_blocks,
                [*self._costs, *curved],
            )
        return self._layouts[self.exact_hessian]

    def _is_curved(self, block: "Block") -> bool:
        """Whether the curvature of a block may enter the Hessian."""
        kernel = block.batch.kernel
        if self.exact_hessian:
            return not hasattr(kernel, "A") and bool(block.bent.any())
        # A constraint that a user adds may be curved in any way.
        return _bends(kernel) or isinstance(kernel, BindingKernel)

    def fingerprint(self) -> tuple[str, np.ndarray]:
        """Identity of the problem: digest of structure; bounds and costs.

        Bounds and costs are numbers (k,), to be compared with a tolerance:
        their last digits differ between machines.
        """
        digest = hashlib.sha256()
        for part in self.jacobian_structure:
            digest.update(np.ascontiguousarray(part).tobytes())
        values = np.concatenate(
            [
                self.y_lower,
                self.y_upper,
                self.g_lower,
                self.g_upper,
                self._b,
                self._Q.data,
            ]
        )
        return digest.hexdigest(), values

    # -- evaluation -------------------------------------------------------

    def _timed(self, part, y, compute):
        """As `_once`, of program variables x; time and calls are counted."""

        def timed():
            start = time.perf_counter()
            result = compute(self._expanded(y))
            self.seconds[part] += time.perf_counter() - start
            self.evaluations[part] += 1
            return result

        return self._once(part, y, timed)

    def _once(self, part, y, compute):
        """Result of `compute`, kept for as long as y is the same."""
        cached = self._cache.get(part)
        if cached is None or not np.array_equal(cached[0], y):
            cached = self._cache[part] = y.copy(), compute()
        return cached[1]

    def _expanded(self, y):
        """`expand`, computed once for each y; not to be changed."""
        return self._once("expanded", y, lambda: self.expand(y))

    def _residual_terms(self, y):
        blocks = self.residual_blocks
        return self._timed(
            "residuals", y, lambda x: [b.values(x) for b in blocks]
        )

    def _residual_jacobians(self, y):
        blocks = self.residual_blocks
        return self._timed(
            "residual_jacobian", y, lambda x: [b.jacobian(x) for b in blocks]
        )

    def objective(self, y: np.ndarray) -> float:
        """Cost at y."""
        x = self._expanded(y)
        value = 0.5 * x @ (self._Q @ x) + self._b @ x + self._c
        for r in self._residual_terms(y):
            value += 0.5 * np.sum(r * r)
        if self._costs:
            value += sum(b.values(x).sum() for b in self._costs)
        return float(value)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """Derivative of the cost, (ny,)."""
        x = self._expanded(y)
        g = self.unknowns.matrix.T @ (self._Q @ x + self._b)
        g += self.residual_gradient(y)
        for b in self._costs:
            accumulate(g, b, b.jacobian(x)[:, 0])
        return g

    def residual_gradient(
        self, y: np.ndarray, without: type | tuple[type, ...] = ()
    ) -> np.ndarray:
        """The gradient (ny,) of the cost of least-squares residuals.

        Args:
            y: unknowns.
            without: classes of kernels whose residuals are left out.
        """
        g = np.zeros(self.num_unknowns)
        for b, r, J in zip(
            self.residual_blocks,
            self._residual_terms(y),
            self._residual_jacobians(y),
            strict=True,
        ):
            if not isinstance(b.batch.kernel, without):
                accumulate(g, b, np.einsum("no,now->nw", r, J))
        return g

    def constraints(self, y: np.ndarray) -> np.ndarray:
        """Constraint values g(y)."""

        def compute(x):
            parts = [self.rows.linear @ y + self._moved]
            parts += [b.values(x).ravel() for b in self.rows.blocks]
            return np.concatenate(parts)

        return self._timed("constraints", y, compute)

    def jacobian(self, y: np.ndarray) -> np.ndarray:
        """Nonzeros of dg/dy, in the order of jacobian_structure."""

        def compute(x):
            parts = [self._A_values]
            for b, entries in zip(self.rows.blocks, self._entries, strict=True):
                parts.append(b.jacobian(x).ravel()[entries])
            return np.concatenate(parts)

        return self._timed("jacobian", y, compute)

    def moved_conditions(
        self, y: np.ndarray, multipliers: np.ndarray, variable: int, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the Lagrangian (ny,) and g if a fixed variable moves.

        For differences by the variable: only terms that depend on it are
        evaluated, all others are left at zero.

        Args:
            y: unknowns, which stay.
            multipliers: multipliers of all rows of g.
            variable: fixed program variable, moved by `step`.
        """
        x = self.expand(y)
        x[variable] += step
        slope = self.unknowns.matrix.T @ (self._Q @ x)
        value = np.zeros(self.num_constraints)
        value[: len(self._moved)] = step * self.rows.slope(variable)

        def touched(blocks):
            return [b for b in blocks if (b.batch.indices == variable).any()]

        def add(b, weights) -> None:
            J = b.jacobian(x)
            accumulate(slope, b, np.einsum("no,now->nw", weights, J))

        for b in touched(self.residual_blocks):
            add(b, b.values(x))
        for b in touched(self._costs):
            add(b, np.ones((1, 1)))
        places = dict(self.rows.numbered_blocks())
        for b in touched(places):
            value[places[b]] = b.values(x).ravel()
            add(b, multipliers[places[b]].reshape(b.batch.lower.shape))
        return slope, value

    def hessian(self, y, multipliers, factor) -> np.ndarray:
        """Nonzeros of the Lagrangian's Hessian (lower triangle).

        Residuals contribute their Gauss-Newton term, and their curvature if the
        kernel has it; constraints contribute theirs once they nearly hold. With
        exact_hessian the curvature of all of them is added from the start.
        """
        start = time.perf_counter()
        weights = self._curvature_weights(y, multipliers, factor)
        H = self._curved(y, factor, weights)
        self.seconds["hessian"] += time.perf_counter() - start
        self.evaluations["hessian"] += 1
        return H

    def gauss_newton(self, y: np.ndarray) -> np.ndarray:
        """The cost's part of `hessian`, without its residuals' curvature."""
        return self._curved(y, 1.0, self._cost_weights(1.0))

    def _curved(self, y, factor, weights):
        x, jacobians = self._expanded(y), self._residual_jacobians(y)
        return self._layout.values(factor, x, jacobians, weights)

    def _cost_weights(self, factor):
        return {b: np.full((1, 1), factor) for b in self._costs}

    def _curvature_weights(self, y, multipliers, factor):
        weights = self._cost_weights(factor)
        terms = self._residual_terms(y)
        for b, r in zip(self.residual_blocks, terms, strict=True):
            if self.exact_hessian or _bends(b.batch.kernel):
                weights[b] = factor * r
        if not self.exact_hessian:
            enough = _FAR if self._is_near else _NEARLY_FEASIBLE
            self._is_near = violation(self, y) <= enough
            if not self._is_near:
                return weights
        for b, place in self.rows.numbered_blocks():
            weights[b] = multipliers[place].reshape(b.batch.lower.shape)
        return weights

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


def _bends(kernel) -> bool:
    """Whether a kernel's curvature enters a Hessian that is not exact."""
    only = getattr(kernel, "exact_only", False)
    return hasattr(kernel, "curvature") and not only


def violation(problem: SparseProgram, y: np.ndarray) -> float:
    """Largest violation of a constraint, also for an ElasticProgram."""
    g = problem.constraints(y)
    return max(
        np.max(problem.g_lower - g, initial=0.0),
        np.max(g - problem.g_upper, initial=0.0),
    )


class ConstraintRows:
    """The rows of g(y), and what they belong to.

    In this order: linear constraints, bounds of program variables that are
    substituted, blocks of kernels. Linear constraints that a substitution
    satisfies exactly are left out.

    Attributes:
        linear: (nl, ny) matrix of the linear rows, which come first.
        blocks: nonlinear constraints.
        lower, upper: bounds on all rows.
    """

    def __init__(self, program: BatchedProgram, unknowns: Unknowns):
        self._unknowns = unknowns
        every = [*program.constraints, *program.loose_constraints()]
        self.blocks = [
            Block(batch, unknowns.matrix)
            for batch in every
            if not self._satisfied(batch)
        ]
        A, lower, upper, names = linear_rows(program.prog)
        rows = unknowns.substituted
        x_lower, x_upper = unknowns.x_lower[rows], unknowns.x_upper[rows]
        has_bound = np.isfinite(x_lower) | np.isfinite(x_upper)
        self._bounded = bounded = rows[has_bound]
        unit = unknowns.scale[bounded]
        picked = sp.csr_array(
            (1.0 / unit, (np.arange(len(bounded)), bounded)),
            shape=(len(bounded), A.shape[1]),
        )
        A = sp.vstack([A, picked]).tocsr()
        self._first_bounded = len(names)
        self._names = [
            *names,
            *(f"bounds of {program.variable_name(int(i))}" for i in bounded),
        ]
        self._A = A.tocsc()  # by program variables
        self.linear = (A @ unknowns.matrix).tocsr()
        shift = A @ unknowns.offset
        lower = np.r_[lower, x_lower[has_bound] / unit] - shift
        upper = np.r_[upper, x_upper[has_bound] / unit] - shift
        batches = [b.batch for b in self.blocks]
        self.lower = np.concatenate(
            [lower, *(b.lower.ravel() for b in batches)]
        )
        self.upper = np.concatenate(
            [upper, *(b.upper.ravel() for b in batches)]
        )

    def _satisfied(self, batch: Batch) -> bool:
        """Whether a batch holds for every y, so that it can be left out."""
        kernel = batch.kernel
        if not hasattr(kernel, "A"):
            return False
        f = kernel.evaluate(self._unknowns.offset[batch.indices], batch.data)
        off = np.maximum(np.abs(f - batch.lower), np.abs(f - batch.upper))
        if not (off < _IDENTICALLY_ZERO).all():
            return False
        A = sp.kron(sp.eye_array(len(f)), kernel.A, format="csr")
        B = self._unknowns.matrix[batch.indices.ravel()]
        largest = np.abs(A @ B).max(axis=1).toarray()
        summed = (np.abs(A) @ np.abs(B)).max(axis=1).toarray()
        return bool((largest <= _IDENTICALLY_ZERO * summed).all())

    def numbered_blocks(self):
        """Yield every block with the slice of its rows."""
        first = self.linear.shape[0]
        for block in self.blocks:
            last = first + block.batch.lower.size
            yield block, slice(first, last)
            first = last

    def name(self, row: int) -> str:
        """Name of the constraint of a row."""
        if row < len(self._names):
            return self._names[row]
        for block, rows in self.numbered_blocks():
            if row < rows.stop:
                node, out = divmod(row - rows.start, block.batch.num_outputs)
                return f"{block.batch.name}[{node}] row {out}"
        raise IndexError("no such constraint")

    def slope(self, variable: int) -> np.ndarray:
        """Derivative (nl,) of the linear rows by a program variable."""
        return self._A[:, [variable]].toarray()[:, 0]

    def bounding(self, variables) -> tuple[np.ndarray, np.ndarray]:
        """Rows that bound given substituted variables; the variable of each."""
        hit = np.flatnonzero(np.isin(self._bounded, variables))
        return self._first_bounded + hit, self._bounded[hit]

    def row_of(self, variables: np.ndarray) -> np.ndarray:
        """Row that bounds each variable; -1 where none does."""
        rows = np.full(len(self._unknowns.offset), -1)
        rows[self._bounded] = self._first_bounded + np.arange(
            len(self._bounded)
        )
        return rows[variables]


class Block:
    """A batch as a function of the unknowns, f(offset + B y).

    Attributes:
        batch: n instances with n_in inputs.
        columns: (n, width) unknowns on which each instance depends, filled up
            with -1.
        local: (n, n_in, width) part of B that gives each instance's inputs, or
            (n_in, width) if it is the same for all.
        pattern: (n, n_out, width) where the Jacobian may be nonzero.
        bent: (n, n_out, width) unknowns by which outputs may be curved.
    """

    def __init__(self, batch: Batch, matrix: sp.csr_array):
        self.batch = batch
        n, n_in = batch.indices.shape
        ny = matrix.shape[1]
        rows = matrix[batch.indices.ravel()].tocoo()
        node, slot = np.divmod(rows.row, n_in)
        key, position = _numbered(node * ny + rows.col)
        first = np.searchsorted(key, np.arange(n) * ny)
        rank = np.arange(len(key)) - first[key // ny]
        width = int(rank.max()) + 1 if len(rank) else 1
        self.columns = np.full((n, width), -1)
        self.columns[key // ny, rank] = key % ny
        self.local = np.zeros((n, n_in, width))
        self.local[node, slot, rank[position]] = rows.data
        structure = np.abs(self.local) > 0
        # On an even grid parts of B differ only by rounding.
        size = np.abs(self.local).max(axis=(0, 2), initial=0.0)[:, None]
        if (np.ptp(self.local, axis=0) <= _ROUNDING * size).all():
            self.local = self.local[0]
            structure = structure[:1]
        seen = (self.columns >= 0)[:, None, :]
        sparsity = batch.kernel.sparsity.astype(float)
        self.pattern = (sparsity @ structure > 0) & seen
        curved = getattr(batch.kernel, "curved_inputs", sparsity.any(axis=0))
        self._curved_inputs = np.flatnonzero(curved)
        self.bent = ((sparsity * curved) @ structure > 0) & seen
        self._bent_slots = _touched(self.bent)

    def values(self, x):
        """Outputs (n, n_out) at program variables x."""
        return self.batch.kernel.evaluate(
            x[self.batch.indices], self.batch.data
        )

    def jacobian(self, x):
        """Derivatives (n, n_out, width) by the unknowns `columns`."""
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
        """sum_i weights_i d2 f_i/dy2, by unknowns that `bent` has anywhere.

        By differences of the Jacobian if the kernel has no `curvature`.
        """
        kernel, data = self.batch.kernel, self.batch.data
        z = x[self.batch.indices]
        if hasattr(kernel, "curvature"):
            H = kernel.curvature(z, weights, data)
        else:
            n, n_in = z.shape
            H = np.zeros((n, n_in, n_in))
            for k in self._curved_inputs:
                h = 1e-6 * np.maximum(1.0, np.abs(z[:, k]))
                up, down = z.copy(), z.copy()
                up[:, k] += h
                down[:, k] -= h
                J = kernel.jacobian(up, data) - kernel.jacobian(down, data)
                J /= (2.0 * h)[:, None, None]
                H[:, k] = np.einsum("no,noi->ni", weights, J)
            H = 0.5 * (H + H.transpose(0, 2, 1))
        # Often most inputs, and the unknowns behind them, are not curved.
        inputs = self._curved_inputs
        local = self.local[..., inputs, :][..., self._bent_slots]
        H = H[:, inputs[:, None], inputs]
        if local.ndim == 2:  # one large product, as above
            half = H.reshape(-1, len(inputs)) @ local
            half = half.reshape(len(z), len(inputs), -1)
        else:
            half = H @ local
        return np.swapaxes(local, -1, -2) @ half


def _numbered(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sorted unique keys, and the place of each key among them.

    np.unique with return_inverse does the same; this sort makes use of long
    runs of keys and is five times as fast.
    """
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    new = np.ones(len(keys), bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    place = np.empty(len(keys), int)
    place[order] = np.cumsum(new) - 1
    return ordered[new], place


def accumulate(g: np.ndarray, block: Block, local: np.ndarray) -> None:
    """Add a block's parts `local` (n, width) of a gradient to g (ny,)."""
    keep = block.columns >= 0
    g += np.bincount(block.columns[keep], local[keep], minlength=len(g))


def _touched(pattern: np.ndarray) -> np.ndarray:
    """Slots (of width) at which a pattern (n, n_out, width) has any True."""
    return np.flatnonzero(pattern.any(axis=(0, 1)))


class HessianLayout:
    """Sparsity of the Hessian, and the place in it of each block's entries.

    Only unknowns on which one output depends together may be coupled.

    Args:
        constant: (ny, ny) Hessian of the quadratic cost.
        gauss_newton: blocks that contribute J^T J.
        curved: blocks that may contribute their curvature.

    Attributes:
        structure: (rows, columns) of the lower triangle's nonzeros.
        constant: the quadratic cost's values at these.
    """

    def __init__(
        self,
        constant: sp.sparray,
        gauss_newton: list[Block],
        curved: list[Block],
    ):
        coo = sp.tril(constant).tocoo()
        ny = constant.shape[0]
        keys, triangles = [coo.row.astype(np.int64) * ny + coo.col], []
        for b, pattern in (
            *((b, b.pattern) for b in gauss_newton),
            *((b, b.bent) for b in curved),
        ):
            slots = _touched(pattern)
            own = b.columns[:, slots]
            P = pattern[:, :, slots].astype(np.float32)
            coupled = P.transpose(0, 2, 1) @ P > 0
            coupled &= own[:, :, None] >= own[:, None, :]
            node, row, column = np.nonzero(coupled)
            keys.append(own[node, row].astype(np.int64) * ny)
            keys[-1] += own[node, column]
            triangles.append((b, slots, np.flatnonzero(coupled)))
        unique, inverse = _numbered(np.concatenate(keys))
        parts = np.split(inverse, np.cumsum([len(k) for k in keys])[:-1])
        self.constant = np.bincount(parts[0], coo.data, minlength=len(unique))
        landing = [(*t, p) for t, p in zip(triangles, parts[1:], strict=True)]
        self._gauss_newton = landing[: len(gauss_newton)]
        self._curved = landing[len(gauss_newton) :]
        self.structure = (
            (unique // ny).astype(np.int32),
            (unique % ny).astype(np.int32),
        )

    def values(self, factor, x, jacobians, weights) -> np.ndarray:
        """Nonzeros in the order of `structure`.

        Args:
            factor: factor of the cost.
            x: (n,) program variables.
            jacobians: of the blocks `gauss_newton`, in their order.
            weights: block -> weights of its outputs' curvature; blocks
                without weights are left out.
        """
        H = factor * self.constant
        for (_, slots, kept, places), J in zip(
            self._gauss_newton, jacobians, strict=True
        ):
            J = J[:, :, slots]
            term = factor * (J.transpose(0, 2, 1) @ J)
            np.add.at(H, places, term.ravel()[kept])
        for b, _, kept, places in self._curved:
            if b in weights:
                term = b.curvature(x, weights[b])
                np.add.at(H, places, term.ravel()[kept])
        return H
