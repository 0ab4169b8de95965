"""A MathematicalProgram that evaluates constraints of one kind together.

Drake evaluates a program binding by binding. A collocation problem repeats the
same few functions at thousands of nodes: a `Batch` lists the instances of one
function (`Kernel`), so that one array operation evaluates all of them. The
program itself stays an ordinary MathematicalProgram that any of Drake's solvers
can take. What is in no batch (bounds, scaling, linear rows, quadratic costs) is
read from the program as arrays.

The program's variables are an affine function of the solver's unknowns,
x = offset + B y (`Unknowns`). By default this only drops fixed variables and
applies the variable scaling; a transcription may supply a sparse B whose
columns satisfy its linear constraints exactly (`Substitution`).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from pydrake.autodiffutils import (
    AutoDiffXd,
    ExtractGradient,
    ExtractValue,
    InitializeAutoDiff,
)
from pydrake.solvers import MathematicalProgram


class Kernel(Protocol):
    """A function of n_in inputs, evaluated for n instances at once.

    A kernel may also have `curvature(x, weights, data)`: the Hessians
    (n, n_in, n_in) of its outputs, summed with weights (n, n_out). They are
    added to the Gauss-Newton terms in the Lagrangian's Hessian, for residuals
    always, for constraints once they nearly hold, but with `exact_only` True
    for exact Hessians alone. `curved_inputs` (n_in,) bool may exclude inputs by
    which they are zero, or are left out.

    Attributes:
        sparsity: (n_out, n_in) bool, True where the Jacobian may be nonzero.
    """

    sparsity: np.ndarray

    def evaluate(self, x: np.ndarray, data: np.ndarray | None) -> np.ndarray:
        """Values (n, n_out) at inputs x (n, n_in), with data (n, ...)."""

    def jacobian(self, x: np.ndarray, data: np.ndarray | None) -> np.ndarray:
        """Derivatives (n, n_out, n_in)."""


class LinearKernel:
    """f(x) = A x with the same A (n_out, n_in) everywhere."""

    def __init__(self, A: np.ndarray):
        self.A = np.asarray(A, float)
        self.sparsity = self.A != 0.0

    def evaluate(self, x, data):
        """See Kernel."""
        return x @ self.A.T

    def jacobian(self, x, data):
        """See Kernel."""
        return np.broadcast_to(self.A, (len(x), *self.A.shape))


class BindingKernel:
    """Kernel of any binding of a program, evaluated by Drake's AutoDiff."""

    def __init__(self, binding):
        self._evaluator = binding.evaluator()
        n_out = self._evaluator.num_outputs()
        self.sparsity = np.ones((n_out, len(binding.variables())), bool)

    def evaluate(self, x, data):
        """See Kernel."""
        return np.stack([self._evaluator.Eval(row) for row in x])

    def jacobian(self, x, data):
        """See Kernel."""
        blocks = []
        for row in x:
            value = self._evaluator.Eval(InitializeAutoDiff(row))
            J = ExtractGradient(value)
            blocks.append(J if J.size else np.zeros(self.sparsity.shape))
        return np.stack(blocks)


@dataclass(frozen=True)
class Batch:
    """Instances of one kernel.

    Attributes:
        name: name in reports; instance t is "name[t]".
        kernel: the function.
        indices: (n, n_in) indices of the inputs among program variables.
        data: (n, ...) constants handed to the kernel, or None.
        lower, upper: (n, n_out) bounds; None for costs.
    """

    name: str
    kernel: Kernel
    indices: np.ndarray
    data: np.ndarray | None = None
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None

    @property
    def num_outputs(self) -> int:
        """Outputs of one instance."""
        return self.kernel.sparsity.shape[0]


class BatchedProgram:
    """A MathematicalProgram together with its batches.

    Attributes:
        prog: the program; anything that IPOPT can solve, and its options, may
            be added to it directly. What is not in a batch is evaluated
            binding by binding. Visualization callbacks are called once for
            each iteration.
        constraints: batches lower <= f(x) <= upper.
        residuals: batches whose cost is half the sum of squares of f(x).
    """

    def __init__(self):
        self.prog = MathematicalProgram()
        self.constraints: list[Batch] = []
        self.residuals: list[Batch] = []
        self._quadratics: list[_Quadratics] = []
        self._labels: list[tuple] = []
        self._covered: set[int] = set()
        self._keep_alive: list = []
        # id of a Python variable, kept alive -> its index: ten times faster
        # than Drake's look-up.
        self._known: dict[int, int] = {}

    def __getstate__(self):
        # Reached if a calibration or prediction is sent to another process.
        raise TypeError(
            "a solved problem holds a Drake program, which cannot be pickled "
            "or copied; pass on a calibration's contact and trials or a "
            "prediction's result.trials, or the folder that write() made, for "
            "read_contact and read_trial"
        )

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of variables, costs, constraints, which additions raise."""
        costs, constraints = self.prog.GetAllCosts, self.prog.GetAllConstraints
        return self.prog.num_vars(), len(costs()), len(constraints())

    def start(self) -> np.ndarray:
        """The program's initial guess (num_vars,), zero where none is set."""
        return np.nan_to_num(self.prog.initial_guess())

    def add_variables(self, names: list[str], sizes: list) -> np.ndarray:
        """New variables (m,) with these names and typical sizes (m,)."""
        found = [self.prog.NewContinuousVariables(1, n)[0] for n in names]
        for variable, size in zip(found, sizes, strict=True):
            self.prog.SetVariableScaling(variable, size)
        return np.array(found)

    def index(self, variable) -> int:
        """Index of one variable in the program."""
        return int(self.indices(np.array([variable]))[0])

    def indices(self, variables: np.ndarray) -> np.ndarray:
        """Indices of an array of variables in the program, same shape."""
        flat, known = variables.ravel().tolist(), self._known
        found = list(map(known.get, map(id, flat)))
        if None in found:
            new = [v for v, i in zip(flat, found, strict=True) if i is None]
            index = self.prog.FindDecisionVariableIndices(new)
            known.update(zip(map(id, new), index, strict=True))
            self._keep_alive.append(new)
            found = list(map(known.get, map(id, flat)))
        return np.array(found, int).reshape(variables.shape)

    def label(
        self,
        kind: str,
        variables: np.ndarray,
        columns: list[str],
        rows: list[str],
        units: list[tuple[str, float]],
    ) -> None:
        """Name the variables of a trajectory for reports.

        Args:
            kind: kind of bounds on them: "limit" or "state".
            variables: (n, m) decision variables.
            columns: (m,) name of each column, such as "first trial's torque".
            rows: (n,) place of each row, such as "at 0.2 s".
            units: (m,) unit for reports, and factor that converts to it.
        """
        index = self.indices(variables)
        self._labels.append((kind, index, columns, rows, units))

    def labelled(self, kinds) -> list[int]:
        """Indices of variables that `label` has named, of some kinds."""
        every = (index for kind, index, *_ in self._labels if kind in kinds)
        return [i for index in every for i in index.ravel()]

    def label_of(self, index: int) -> tuple[str, str, tuple[str, float]]:
        """Column, row and unit of a variable as labelled, or its name."""
        for _, where, columns, rows, units in self._labels:
            row, column = np.nonzero(where == index)
            if len(row):
                return columns[column[0]], rows[row[0]], units[column[0]]
        name = self.prog.decision_variable(index).get_name()
        return name, "", ("", 1.0)

    def variable_name(self, index: int) -> str:
        """Label of a variable, or its name in the program."""
        return " ".join(self.label_of(index)[:2]).strip()

    def add_constraints(
        self, name, kernel, variables, lower=0.0, upper=0.0, data=None
    ) -> Batch:
        """Constrain lower <= f(x_t) <= upper for every row of variables.

        Args:
            name: for reports.
            kernel: the function f.
            variables: (n, n_in) decision variables.
            lower: lower bounds, broadcast to (n, n_out).
            upper: upper bounds, likewise.
            data: (n, ...) constants for the kernel.
        """
        shape = (len(variables), kernel.sparsity.shape[0])
        lower = np.broadcast_to(np.asarray(lower, float), shape)
        upper = np.broadcast_to(np.asarray(upper, float), shape)
        bindings = [
            self.prog.AddConstraint(
                _scalar_function(kernel, data, t),
                lower[t],
                upper[t],
                variables[t],
                description=f"{name}[{t}]",
            )
            for t in range(len(variables))
        ]
        index = self.indices(variables)
        return self.register(name, kernel, bindings, index, lower, upper, data)

    def register(
        self, name, kernel, bindings, index, lower, upper, data=None
    ) -> Batch:
        """Declare constraint bindings already in the program as a batch.

        Args:
            bindings: n bindings.
            index: (n, n_in) indices of their inputs, in the kernel's order.
            name, kernel, lower, upper, data: see `add_constraints`.
        """
        batch = Batch(name, kernel, index, data, lower, upper)
        self.constraints.append(batch)
        self._cover(bindings)
        return batch

    def add_residuals(self, name, kernel, variables, data=None) -> Batch:
        """Add the cost 1/2 sum_t |f(x_t)|^2; see `add_constraints`."""
        bindings = []
        for t in range(len(variables)):
            function = _scalar_function(kernel, data, t)
            cost = self.prog.AddCost(
                lambda x, f=function: _half_square(f(x)),
                variables[t],
                description=f"{name}[{t}]",
            )
            bindings.append(cost)
        batch = Batch(name, kernel, self.indices(variables), data)
        self.residuals.append(batch)
        self._cover(bindings)
        return batch

    def add_quadratic_costs(self, name, Q, b, c, variables) -> None:
        """Add the convex costs 1/2 x_t^T Q_t x_t + b_t^T x_t + c_t.

        Args:
            name: for reports.
            Q: (n, m, m).
            b: (n, m).
            c: (n,).
            variables: (n, m) decision variables.
        """
        bindings = []
        for t, row in enumerate(variables):
            cost = self.prog.AddQuadraticCost(
                Q[t], b[t], c[t], row, is_convex=True
            )
            cost.evaluator().set_description(f"{name}[{t}]")
            bindings.append(cost)
        self._quadratics.append(_quadratics(self.indices(variables), Q, b, c))
        self._cover(bindings)

    def loose_constraints(self) -> list[Batch]:
        """Generic constraints in no batch, each as a batch of its own."""
        return [
            replace(
                self._alone(binding, "constraint"),
                lower=binding.evaluator().lower_bound()[None],
                upper=binding.evaluator().upper_bound()[None],
            )
            for binding in self._uncovered(nonlinear_constraints(self.prog))
        ]

    def loose_costs(self) -> list[Batch]:
        """Generic costs in no batch, each as a batch of its own."""
        loose = self._uncovered(nonlinear_costs(self.prog))
        return [self._alone(binding, "cost") for binding in loose]

    def _alone(self, binding, what: str) -> Batch:
        name = binding.evaluator().get_description() or what
        index = self.indices(binding.variables())[None]
        return Batch(name, BindingKernel(binding), index)

    def show(self, x: np.ndarray) -> None:
        """Call the visualization callbacks at variables x (num_vars,)."""
        callbacks = self.prog.visualization_callbacks()
        for callback, index in _indexed(self.prog, callbacks):
            callback.Eval(x[index])

    def quadratic_cost(self) -> tuple[sp.csr_array, np.ndarray, float]:
        """Q (sparse), b, c of all linear and quadratic costs.

        Their sum is 1/2 x^T Q x + b^T x + c.
        """
        prog = self.prog
        n = prog.num_vars()
        b, c = np.zeros(n), 0.0
        for cost, index in _indexed(prog, prog.linear_costs()):
            np.add.at(b, index, cost.a())
            c += cost.b()
        terms = list(self._quadratics)
        loose = self._uncovered(prog.quadratic_costs())
        for cost, index in _indexed(prog, loose):
            Q, slope = cost.Q()[None], cost.b()[None]
            terms.append(_quadratics(index[None], Q, slope, cost.c()))
        for term in terms:
            np.add.at(b, term.inputs, term.b)
            c += term.c
        Q = _sparse(
            [t.rows for t in terms],
            [t.columns for t in terms],
            [t.values for t in terms],
            (n, n),
        )
        return Q, b, c

    def keep_alive(self, thing) -> None:
        """Keep an object that the program's evaluators point to."""
        self._keep_alive.append(thing)

    def _uncovered(self, bindings):
        return [b for b in bindings if id(b.evaluator()) not in self._covered]

    def _cover(self, bindings):
        # Evaluators are recognised by id: pydrake returns the same wrapper as
        # long as one is alive.
        evaluators = [b.evaluator() for b in bindings]
        self._keep_alive.extend(evaluators)
        self._covered.update(map(id, evaluators))


def _half_square(r):
    # Not r ** 2: the power of some versions' AutoDiffXd warns at zero.
    return 0.5 * np.sum(r * r)


def _scalar_function(kernel, data, t):
    """Function of one instance t of a kernel, for floats and AutoDiffXd."""
    row = None if data is None else data[t : t + 1]

    def function(x):
        if x.dtype != object:
            return kernel.evaluate(x[None], row)[0]
        value = ExtractValue(x).reshape(-1)
        f = kernel.evaluate(value[None], row)[0]
        gradient = ExtractGradient(x)
        if gradient.size == 0:
            return np.array([AutoDiffXd(f_i) for f_i in f])
        J = kernel.jacobian(value[None], row)[0] @ gradient
        return np.array(
            [AutoDiffXd(f_i, J_i) for f_i, J_i in zip(f, J, strict=True)]
        )

    return function


def nonlinear_constraints(prog):
    """Bindings of constraints that are neither linear nor bounds."""
    linear = [
        *prog.linear_constraints(),
        *prog.linear_equality_constraints(),
        *prog.bounding_box_constraints(),
    ]
    return _others(prog.GetAllConstraints(), linear)


def nonlinear_costs(prog):
    """Bindings of costs that are neither linear nor quadratic."""
    quadratic = [*prog.linear_costs(), *prog.quadratic_costs()]
    return _others(prog.GetAllCosts(), quadratic)


def _others(every, known) -> list:
    """Bindings that are not among those known."""
    kept = [b.evaluator() for b in known]  # kept alive: ids stay unique
    skip = set(map(id, kept))
    return [b for b in every if id(b.evaluator()) not in skip]


def variable_bounds(prog) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (num_vars,) from bounding-box constraints."""
    lower = np.full(prog.num_vars(), -np.inf)
    upper = np.full(prog.num_vars(), np.inf)
    for box, index in _indexed(prog, prog.bounding_box_constraints()):
        np.maximum.at(lower, index, box.lower_bound())
        np.minimum.at(upper, index, box.upper_bound())
    return lower, upper


def variable_scaling(prog) -> np.ndarray:
    """Typical size (num_vars,) of each variable, 1 where none is set."""
    scale = np.ones(prog.num_vars())
    for index, value in prog.GetVariableScaling().items():
        scale[index] = value
    return scale


def linear_rows(prog):
    """All linear constraints in no batch as lower <= A x <= upper.

    Returns:
        A (sparse), lower, upper, and the rows' names.
    """
    rows, columns, values, lower, upper, names = [], [], [], [], [], []
    bindings = [*prog.linear_constraints(), *prog.linear_equality_constraints()]
    for evaluator, index in _indexed(prog, bindings):
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


class _Quadratics(NamedTuple):
    """Quadratic costs: entries of Q (k,); inputs, b (n, m); sum of all c."""

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    inputs: np.ndarray
    b: np.ndarray
    c: float


def _quadratics(inputs, Q, b, c) -> _Quadratics:
    """Costs of n instances with m inputs; Q (n, m, m) is kept sparse."""
    instance, row, column = np.nonzero(Q)
    return _Quadratics(
        inputs[instance, row],
        inputs[instance, column],
        Q[instance, row, column],
        inputs,
        b,
        float(np.sum(c)),
    )


def _indexed(prog, bindings) -> list[tuple]:
    """(evaluator, indices of its variables) of each binding."""
    variables = [binding.variables() for binding in bindings]
    if not variables:
        return []
    found = prog.FindDecisionVariableIndices(np.concatenate(variables))
    ends = np.cumsum([len(v) for v in variables])[:-1]
    evaluators = [binding.evaluator() for binding in bindings]
    parts = np.split(np.asarray(found, int), ends)
    return list(zip(evaluators, parts, strict=True))


def _sparse(rows, columns, values, shape) -> sp.csr_array:
    place = (_joined(rows).astype(int), _joined(columns).astype(int))
    return sp.csr_array((_joined(values), place), shape=shape)


def _joined(parts) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros(0)


@dataclass(frozen=True)
class Substitution:
    """Program variables as an affine function of fewer unknowns.

    Attributes:
        variables: (na,) indices of the program variables substituted.
        matrix: (na, ny) sparse; x[variables] = matrix @ y + offset.
        offset: (na,).
        scale: (ny,) typical size of each unknown.
        accuracy: (na,) tolerance to which a guess of each variable is kept.
    """

    variables: np.ndarray
    matrix: sp.csr_array
    offset: np.ndarray
    scale: np.ndarray
    accuracy: np.ndarray


class Unknowns:
    """The solver's unknowns y, each in units of its typical size.

    First come program variables that are unknowns themselves ("direct"), then
    the unknowns of the substitutions.

    Attributes:
        matrix, offset: B (n, ny) and offset (n,) of x = offset + B y.
        lower, upper: (ny,) bounds on y.
        x_lower, x_upper: (n,) bounds on x.
        scale: (n,) typical size of each program variable.
        substituted: indices of the program variables that are substituted.
    """

    def __init__(
        self,
        prog: MathematicalProgram,
        substitutions: tuple[Substitution, ...] = (),
    ):
        n = prog.num_vars()
        self.x_lower, self.x_upper = variable_bounds(prog)
        self.scale = variable_scaling(prog)
        fixed = self.x_lower == self.x_upper
        direct = ~fixed
        for s in substitutions:
            direct[s.variables] = False
        kept = self._direct = np.flatnonzero(direct)
        unit = self.scale[kept]
        blocks = [(kept, sp.diags_array(unit).tocsr())]
        self.offset = np.where(fixed, self.x_lower, 0.0)
        self._accuracy = self.scale.copy()
        for s in substitutions:
            matrix = s.matrix @ sp.diags_array(s.scale)
            blocks.append((s.variables, matrix.tocsr()))
            self.offset[s.variables] = s.offset
            self._accuracy[s.variables] = s.accuracy
        rows = np.concatenate([b[0] for b in blocks])
        stacked = sp.block_diag([b[1] for b in blocks], format="coo")
        self.matrix = sp.csr_array(
            (stacked.data, (rows[stacked.row], stacked.col)),
            shape=(n, stacked.shape[1]),
        )
        self.lower = np.full(self.count, -np.inf)
        self.upper = np.full(self.count, np.inf)
        self.lower[: len(kept)] = self.x_lower[kept] / unit
        self.upper[: len(kept)] = self.x_upper[kept] / unit
        self.substituted = np.setdiff1d(
            np.concatenate([s.variables for s in substitutions] or [[]]), kept
        ).astype(int)

    @property
    def count(self) -> int:
        """Length of y."""
        return self.matrix.shape[1]

    def expand(self, y: np.ndarray) -> np.ndarray:
        """Program variables x of unknowns y."""
        return self.offset + self.matrix @ y

    def restrict(self, x: np.ndarray) -> np.ndarray:
        """Unknowns y whose x is nearest to the given one.

        Distances of substituted variables count in units of their accuracy.
        """
        x, direct, rows = np.asarray(x), self._direct, self.substituted
        y = np.zeros(self.count)
        y[: len(direct)] = x[direct] / self.scale[direct]
        if len(rows):
            unit = self._accuracy[rows]
            weight = sp.diags_array(1.0 / unit)
            W = (weight @ self.matrix[rows][:, len(direct) :]).tocsc()
            r = (x[rows] - self.offset[rows]) / unit
            y[len(direct) :] = sp.linalg.spsolve(W.T @ W, W.T @ r)
        return np.clip(y, self.lower, self.upper)

    def bounding(self, variables) -> tuple[np.ndarray, np.ndarray]:
        """Columns of bounded unknowns that are given variables; these, too."""
        bounded = np.isfinite(self.lower) | np.isfinite(self.upper)
        hit = np.isin(self._direct, variables)
        columns = np.flatnonzero(bounded[: len(hit)] & hit)
        return columns, self._direct[columns]

    def column_of(self, variables: np.ndarray) -> np.ndarray:
        """Column of y of each program variable that is a direct unknown.

        Raises:
            ValueError: a variable is fixed or substituted.
        """
        place = np.searchsorted(self._direct, variables)
        last = len(self._direct) - 1
        if (self._direct[np.minimum(place, last)] != variables).any():
            raise ValueError("not an unknown by itself")
        return place
