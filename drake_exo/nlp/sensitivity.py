"""How an optimum moves with its data, from the system of its conditions.

At a solution, H dy + A^T dl = -dgradient and A dy = dbounds, with the
Gauss-Newton Hessian H and the Jacobian A of equations and active bounds.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from drake_exo.nlp.sparse import SparseProgram

# A bound closer than this, in units of the variable, is active.
_ACTIVE = 1e-5
# Keeps the system regular where active bounds repeat an equation.
_REGULAR = 1e-9


@dataclass(frozen=True)
class Response:
    """Derivatives of some unknowns at the optimum.

    Attributes:
        by_gradient: (m, num_unknowns), by changes of the cost's gradient
            (with the sign of a change that is added to it).
        by_bounds: (m, num_constraints), by changes of a constraint's bound;
            zero where it is not active.
    """

    by_gradient: np.ndarray
    by_bounds: np.ndarray


def response(
    problem: SparseProgram, y: np.ndarray, unknowns: np.ndarray
) -> Response:
    """Response of unknowns at an optimum y.

    Args:
        problem: that y solves.
        y: (num_unknowns,).
        unknowns: (m,) indices into y; those at an active bound do not move.
    """
    ny, ng = problem.num_unknowns, problem.num_constraints
    free = np.flatnonzero(
        np.minimum(y - problem.y_lower, problem.y_upper - y) > _ACTIVE
    )
    g = problem.constraints(y)
    slack = np.minimum(g - problem.g_lower, problem.g_upper - g)
    held = np.flatnonzero(slack < _ACTIVE)
    H = _hessian(problem, y)[free][:, free]
    rows, columns = problem.jacobian_structure
    A = sp.csr_array((problem.jacobian(y), (rows, columns)), shape=(ng, ny))
    A = A[held][:, free]
    K = sp.block_array(
        [
            [H + _REGULAR * sp.eye_array(len(free)), A.T],
            [A, -_REGULAR * sp.eye_array(len(held))],
        ],
        format="csc",
    )
    place = np.full(ny, -1)
    place[free] = np.arange(len(free))
    moving = np.flatnonzero(place[unknowns] >= 0)
    Z = _columns_of_inverse(K, place[unknowns[moving]]).T
    by_gradient = np.zeros((len(unknowns), ny))
    by_bounds = np.zeros((len(unknowns), ng))
    by_gradient[np.ix_(moving, free)] = -Z[:, : len(free)]
    by_bounds[np.ix_(moving, held)] = Z[:, len(free) :]
    return Response(by_gradient, by_bounds)


def _columns_of_inverse(K: sp.csc_array, index: np.ndarray) -> np.ndarray:
    """Columns (n, m) of the inverse of a symmetric K.

    The unknowns asked for touch everything; without them K is banded in time,
    and they follow from the Schur complement.
    """
    rest = np.setdiff1d(np.arange(K.shape[0]), index)
    inner = K[rest][:, rest].tocsc()
    order = csgraph.reverse_cuthill_mckee(inner, symmetric_mode=True)
    banded = inner[order][:, order].tocsc()
    factor = sp.linalg.splu(banded, permc_spec="NATURAL")
    border = K[rest][:, index].toarray()
    X = np.empty_like(border)
    X[order] = factor.solve(border[order])
    schur = K[index][:, index].toarray() - border.T @ X
    columns = np.empty((K.shape[0], len(index)))
    columns[index] = np.linalg.inv(schur)
    columns[rest] = -X @ columns[index]
    return columns


def _hessian(problem: SparseProgram, y: np.ndarray) -> sp.csr_array:
    """Gauss-Newton Hessian, both triangles."""
    rows, columns = problem.hessian_structure
    values = problem.hessian(y, np.zeros(problem.num_constraints), 1.0)
    ny = problem.num_unknowns
    lower = sp.csr_array((values, (rows, columns)), shape=(ny, ny))
    return (lower + sp.tril(lower, -1).T).tocsr()
