"""The rows of a sparse program's constraints g(y), and what they belong to.

In this order: linear constraints, bounds of single variables that a
substitution took away, blocks of kernels.
"""

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.batch import Batch, BatchedProgram, BindingKernel
from drake_exo.nlp.block import Block
from drake_exo.nlp.program_arrays import linear_rows
from drake_exo.nlp.unknowns import Unknowns

_IDENTICALLY_ZERO = 1e-9


class ConstraintRows:
    """Constraints of a batched program, seen from the unknowns.

    Attributes:
        linear: (nl, ny) matrix of the linear rows, which come first.
        blocks: nonlinear constraints.
        lower, upper: bounds on all rows.
    """

    def __init__(self, program: BatchedProgram, unknowns: Unknowns):
        self._unknowns = unknowns
        loose, _ = program.loose_bindings()
        singles = [
            Batch(
                b.evaluator().get_description() or "constraint",
                BindingKernel(b),
                program.indices(b.variables())[None],
                b.evaluator().lower_bound()[None],
                b.evaluator().upper_bound()[None],
            )
            for b in loose
        ]
        blocks = [
            Block(batch, unknowns.matrix)
            for batch in [*program.constraints, *singles]
        ]
        self.blocks = [b for b in blocks if not self._satisfied(b)]
        lower, upper = self._add_linear(program)
        batches = [b.batch for b in self.blocks]
        self.lower = np.concatenate(
            [lower, *(b.lower.ravel() for b in batches)]
        )
        self.upper = np.concatenate(
            [upper, *(b.upper.ravel() for b in batches)]
        )

    def _add_linear(self, program):
        """Linear constraints, and bounds of substituted variables."""
        A, lower, upper, names = linear_rows(program.prog)
        unknowns = self._unknowns
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
        self.linear = (A @ unknowns.matrix).tocsr()
        shift = A @ unknowns.offset
        lower = np.r_[lower, x_lower[has_bound] / unit] - shift
        upper = np.r_[upper, x_upper[has_bound] / unit] - shift
        return lower, upper

    def _satisfied(self, block: Block) -> bool:
        """Whether a batch holds for every y: then it leaves the problem."""
        kernel = block.batch.kernel
        if not hasattr(kernel, "A"):
            return False
        offset = self._unknowns.offset
        J = block.jacobian(offset)
        size = np.abs(kernel.A) @ np.abs(block.local)
        size = size.max(axis=-1, keepdims=True)
        if not (np.abs(J) <= _IDENTICALLY_ZERO * size).all():
            return False
        f = block.values(offset)
        return bool(
            (np.abs(f - block.batch.lower) < _IDENTICALLY_ZERO).all()
            and (np.abs(f - block.batch.upper) < _IDENTICALLY_ZERO).all()
        )

    def numbered_blocks(self):
        """Every block with the slice of the rows that it fills."""
        first = self.linear.shape[0]
        for block in self.blocks:
            last = first + block.batch.lower.size
            yield block, slice(first, last)
            first = last

    def name(self, row: int) -> str:
        """What constraint a row belongs to."""
        if row < len(self._names):
            return self._names[row]
        for block, rows in self.numbered_blocks():
            if row < rows.stop:
                node, out = divmod(row - rows.start, block.batch.num_outputs)
                return f"{block.batch.name}[{node}] row {out}"
        raise IndexError("no such constraint")

    def bounding(self, variables) -> np.ndarray:
        """Rows that bound one of some substituted variables."""
        hit = np.isin(self._bounded, variables)
        return self._first_bounded + np.flatnonzero(hit)

    def variable_of(self, rows: np.ndarray) -> np.ndarray:
        """Program variable that each row bounds."""
        return self._bounded[rows - self._first_bounded]

    def row_of(self, variables: np.ndarray) -> np.ndarray:
        """Row that bounds each variable; -1 where none does."""
        order = np.argsort(self._bounded)
        place = np.searchsorted(self._bounded, variables, sorter=order)
        place = order[np.minimum(place, len(order) - 1)]
        hit = self._bounded[place] == variables
        return np.where(hit, self._first_bounded + place, -1)
