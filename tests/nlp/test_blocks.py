"""How batches lie among the unknowns: as narrow as may be."""

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.program import BatchedProgram, LinearKernel, Substitution
from drake_exo.nlp.sparse import Block, SparseProgram


def test_a_block_is_as_wide_as_what_its_instances_see():
    """Two unknowns each, wherever they stand."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(6, "x")
    links = np.stack([x[:-1], x[1:]], axis=1)
    batch = program.add_residuals("link", LinearKernel([[1.0, -1.0]]), links)
    problem = SparseProgram(program)
    block = Block(batch, problem.unknowns.matrix)
    expected = np.column_stack([np.arange(5), np.arange(1, 6)])
    np.testing.assert_array_equal(np.sort(block.columns, axis=1), expected)
    assert block.pattern.shape == (5, 1, 2) and block.pattern.all()


def test_instances_that_see_fewer_unknowns_are_filled_up():
    """The first knows one; a column of -1 holds nothing."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(3, "x")
    links = np.stack([x[:-1], x[1:]], axis=1)
    batch = program.add_residuals("link", LinearKernel([[1.0, -1.0]]), links)
    # x0 and x1 are one unknown, x2 is both's sum.
    own = Substitution(
        np.arange(3),
        sp.csr_array([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),
        np.zeros(3),
        np.ones(2),
        np.ones(3),
    )
    problem = SparseProgram(program, (own,))
    unbound = (np.full(2, -np.inf), np.full(2, np.inf))
    np.testing.assert_array_equal((problem.y_lower, problem.y_upper), unbound)
    block = Block(batch, problem.unknowns.matrix)
    assert [sorted(row) for row in block.columns.tolist()] == [[-1, 0], [0, 1]]
    y = np.array([2.0, 3.0])
    # 0, and x1 - x2 = -y1.
    assert problem.objective(y) == 0.5 * 3.0**2
    np.testing.assert_allclose(problem.gradient(y), [0.0, 3.0])
