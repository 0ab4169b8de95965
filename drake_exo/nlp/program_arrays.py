"""Bounds, scaling, linear rows and quadratic costs of a program as arrays."""

import numpy as np
import scipy.sparse as sp


def variable_bounds(prog) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (num_vars,) from bounding-box constraints."""
    lower = np.full(prog.num_vars(), -np.inf)
    upper = np.full(prog.num_vars(), np.inf)
    bindings = prog.bounding_box_constraints()
    for binding, index in zip(bindings, _indices(prog, bindings), strict=True):
        evaluator = binding.evaluator()
        np.maximum.at(lower, index, evaluator.lower_bound())
        np.minimum.at(upper, index, evaluator.upper_bound())
    return lower, upper


def variable_scaling(prog) -> np.ndarray:
    """Typical size (num_vars,) of each variable, 1 where none is set."""
    scale = np.ones(prog.num_vars())
    for index, value in prog.GetVariableScaling().items():
        scale[index] = value
    return scale


def linear_rows(prog):
    """All linear constraints that are not in a batch: lower <= A x <= upper.

    Returns:
        A (sparse), lower, upper, and the rows' names.
    """
    rows, columns, values, lower, upper, names = [], [], [], [], [], []
    bindings = [
        *prog.linear_constraints(),
        *prog.linear_equality_constraints(),
    ]
    for binding, index in zip(bindings, _indices(prog, bindings), strict=True):
        evaluator = binding.evaluator()
        A = sp.coo_array(evaluator.get_sparse_A())
        rows.append(A.row + len(names))
        columns.append(index[A.col])
        values.append(A.data)
        lower.append(evaluator.lower_bound())
        upper.append(evaluator.upper_bound())
        name = evaluator.get_description() or "linear constraint"
        names.extend(f"{name} row {i}" for i in range(A.shape[0]))
    A = _sparse(rows, columns, values, (len(names), prog.num_vars()))
    return A, _joined(lower), _joined(upper), names


def quadratic_cost(prog):
    """All linear and quadratic costs as 1/2 x^T Q x + b^T x + c.

    Returns:
        Q (sparse), b, c.
    """
    n = prog.num_vars()
    b, c = np.zeros(n), 0.0
    rows, columns, values = [], [], []
    bindings = prog.linear_costs()
    for binding, index in zip(bindings, _indices(prog, bindings), strict=True):
        np.add.at(b, index, binding.evaluator().a())
        c += binding.evaluator().b()
    bindings = prog.quadratic_costs()
    for binding, index in zip(bindings, _indices(prog, bindings), strict=True):
        evaluator = binding.evaluator()
        Q = evaluator.Q()
        row, column = np.nonzero(Q)
        rows.append(index[row])
        columns.append(index[column])
        values.append(Q[row, column])
        np.add.at(b, index, evaluator.b())
        c += evaluator.c()
    return _sparse(rows, columns, values, (n, n)), b, c


def _indices(prog, bindings) -> list[np.ndarray]:
    """Program indices of each binding's variables; one look-up for all."""
    variables = [binding.variables() for binding in bindings]
    if not variables:
        return []
    found = prog.FindDecisionVariableIndices(np.concatenate(variables))
    ends = np.cumsum([len(v) for v in variables])[:-1]
    return np.split(np.asarray(found, int), ends)


def _sparse(rows, columns, values, shape) -> sp.csr_array:
    place = (_joined(rows).astype(int), _joined(columns).astype(int))
    return sp.csr_array((_joined(values), place), shape=shape)


def _joined(parts) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros(0)
