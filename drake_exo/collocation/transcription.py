"""Jerk-driven trajectories in a program: two collocation grids, one interface.

The states of every coordinate are position, velocity and acceleration; the
control is jerk (implicit dynamics: the equations of motion are algebraic
constraints that the caller adds). This integrator is linear and the duration
is given, so the collocation constraints are linear with constant coefficients.
Each grid has a sparse basis of their solutions, with which the bridge to IPOPT
may substitute the trajectory and drop the constraints.
"""

from abc import ABC, abstractmethod

import numpy as np
import scipy.sparse as sp
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.planning import DirectCollocation
from pydrake.systems.primitives import LinearSystem
from scipy.interpolate import BSpline

from drake_exo.nlp.program import BatchedProgram, LinearKernel, Substitution

# Typical sizes of position, velocity, acceleration, jerk [rad or m, s].
_SIZES = (1.0, 1.0, 10.0, 100.0)
# Tolerance to which a guess of each is kept: a tenth of a millimetre is tens of
# newtons of contact force, while accelerations of a guess mean little.
_ACCURACY = (1e-4, 1e-2, 3.0, 1e4)


class Transcription(ABC):
    """One trajectory of n_dof coordinates on a grid of nodes.

    Attributes:
        times: (n,) node times from 0 to duration [s].
        quadrature: (n,) weights of an integral over time [s].
        parts: see below, broadcast to (num_intervals,).
        mesh: (m + 1,) ends of the mesh intervals [s].
        q, v, a: (n, n_dof) decision variables.
        jerk: (n_controls, n_dof) decision variables; one row for each node,
            except for a first node that is not a collocation point.

    Args:
        program: program to add to.
        name: name of the trajectory.
        num_dof: number of coordinates.
        duration: [s].
        num_intervals: number of even intervals.
        parts: (num_intervals,) number of mesh intervals into which each of
            these is split, or one number for all.
    """

    def __init__(
        self, program, name, num_dof, duration, num_intervals, parts=1
    ):
        self.name = name
        self.num_dof = num_dof
        self.parts = np.broadcast_to(parts, num_intervals)
        starts = [
            k + np.arange(count) / count for k, count in enumerate(self.parts)
        ]
        even = duration / num_intervals
        self.mesh = even * np.concatenate([*starts, [num_intervals]])
        self._add_to(program)
        for array, size in zip(self._arrays(), _SIZES, strict=True):
            if size == 1.0:
                continue  # the default scaling
            for variable in array.ravel():
                program.prog.SetVariableScaling(variable, size)

    def _arrays(self):
        return self.q, self.v, self.a, self.jerk

    @property
    def num_intervals(self) -> int:
        """Number of mesh intervals."""
        return len(self.mesh) - 1

    @property
    def steps(self) -> np.ndarray:
        """Lengths (m,) of the mesh intervals [s]."""
        return np.diff(self.mesh)

    @property
    @abstractmethod
    def jerk_weights(self) -> np.ndarray:
        """Weight of each row of jerk in an integral over time [s]."""

    def alternating(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Midpoint accelerations that values at the nodes do not determine.

        Returns:
            variables (m, n_dof, k), their weights (m, k) in m accelerations
            of each coordinate, and the time (m,) that each stands for [s];
            m = 0 if the nodes determine the state between them.
        """
        return self.jerk[:0, :, None], np.ones((0, 1)), np.ones(0)

    @abstractmethod
    def _add_to(self, program: BatchedProgram) -> None:
        """Add variables and collocation constraints."""

    @abstractmethod
    def at(self, when, q, v, a, jerk):
        """State of a solution at any times, by the grid's polynomials.

        Args:
            when: (m,) [s].
            q, v, a, jerk: values at the nodes.

        Returns:
            q, v, a (m, n_dof).
        """

    def _intervals(self, when):
        """Index, start and length of the mesh interval at times (m,)."""
        k = np.searchsorted(self.mesh, when, side="right") - 1
        k = np.clip(k, 0, self.num_intervals - 1)
        return k, self.mesh[k], self.steps[k]

    @abstractmethod
    def _scalar_basis(self) -> tuple[sp.csr_array, np.ndarray]:
        """Basis of one coordinate's solutions, and size of each unknown.

        Rows are q, v, a, jerk of all nodes.
        """

    def substitution(self, program: BatchedProgram) -> Substitution:
        """Substitution of all trajectory variables by this grid's basis."""
        basis, sizes = self._scalar_basis()
        matrix = sp.kron(basis, sp.eye_array(self.num_dof), format="csr")
        arrays = [x.ravel() for x in self._arrays()]
        stacked = np.concatenate(arrays)
        counts = [len(x) for x in arrays]
        return Substitution(
            variables=program.indices(stacked),
            matrix=sp.csr_array(matrix),
            offset=np.zeros(len(stacked)),
            scale=np.repeat(sizes, self.num_dof),
            accuracy=np.repeat(_ACCURACY, counts),
        )


class HermiteSimpson(Transcription):
    """Drake's DirectCollocation; nodes are the mesh points.

    With jerk linear in each interval, Hermite-Simpson integrates the three
    integrators exactly: positions are quartic splines with continuous jerk.
    """

    def _add_to(self, program):
        n_dof, n = self.num_dof, self.num_intervals + 1
        steps = self.steps
        self.times = self.mesh
        self.quadrature = 0.5 * (np.r_[steps, 0.0] + np.r_[0.0, steps])
        prog = program.prog
        before = len(prog.generic_constraints())
        system = _integrator(n_dof)
        collocation = DirectCollocation(
            system,
            system.CreateDefaultContext(),
            n,
            steps.min(),
            steps.max(),
            prog=prog,
        )
        time_steps = np.stack([collocation.time_step(i) for i in range(n - 1)])
        prog.AddBoundingBoxConstraint(steps, steps, time_steps.ravel())
        # The constraints refer to contexts of `collocation`, and to the system.
        program.keep_alive((system, collocation))
        states = np.stack([collocation.state(i) for i in range(n)])
        self.q, self.v, self.a = np.split(states, 3, axis=1)
        self.jerk = np.stack([collocation.input(i) for i in range(n)])
        bindings = prog.generic_constraints()[before:]
        # Otherwise constraints of all trials have the same names.
        for i, binding in enumerate(bindings):
            binding.evaluator().set_description(f"{self.name} collocation[{i}]")
        # In Drake's order of each constraint's inputs.
        at, x, u = map(program.indices, (time_steps, states, self.jerk))
        inputs = np.hstack([at, x[:-1], x[1:], u[:-1], u[1:]])
        for step, which in _by_length(steps):
            some = [bindings[i] for i in which]
            zero = np.zeros((len(some), 3 * n_dof))
            # The Jacobian is constant for a given time step.
            z = np.zeros(inputs.shape[1])
            z[0] = step
            defects = some[0].evaluator().Eval(InitializeAutoDiff(z))
            program.register(
                f"{self.name} collocation",
                LinearKernel(ExtractGradient(defects)),
                some,
                inputs[which],
                zero,
                zero,
            )

    @property
    def jerk_weights(self):
        """See Transcription; ends count as other nodes do."""
        weights = stands_for(self.steps)
        return weights * (self.steps.sum() / weights.sum())

    def alternating(self):
        """See Transcription.

        A jerk that alternates from node to node does not change the
        accelerations at the nodes, which fix j_k + j_{k+1} but not the
        difference. Once excited, as by a force with a corner, it is not damped.
        Returned is the acceleration midway that it makes.
        """
        j, before, after = self.jerk, self.steps[:-1], self.steps[1:]
        variables = np.stack([j[:-2], j[1:-1], j[2:]], axis=2)
        # Deviation of a jerk from the line between its neighbours.
        both = before + after
        off = np.column_stack(
            [after / both, -np.ones(len(both)), before / both]
        )
        return variables, both[:, None] / 16.0 * off, 0.5 * both

    def at(self, when, q, v, a, jerk):
        """See Transcription; jerk is linear in each interval."""
        k, start, h = self._intervals(when)
        s = (when - start)[:, None]
        q, v, a, j = (x[k] for x in (q, v, a, jerk))
        snap = (jerk[k + 1] - j) / h[:, None]
        return (
            q + s * (v + s * (a / 2.0 + s * (j / 6.0 + s * snap / 24.0))),
            v + s * (a + s * (j / 2.0 + s * snap / 6.0)),
            a + s * (j + s * snap / 2.0),
        )

    def _scalar_basis(self):
        mesh, beyond = self.mesh, np.arange(1.0, 5.0)
        knots = np.r_[
            mesh[0] - self.steps[0] * beyond[::-1],
            mesh,
            mesh[-1] + self.steps[-1] * beyond,
        ]
        n = len(mesh) + 3
        blocks, derived = [], sp.eye_array(n, format="csr")
        for order in range(4):
            # The spline is C3: its third derivative has a value at knots.
            degree = 4 - order
            inner = knots[order : len(knots) - order]
            of_degree = BSpline.design_matrix(mesh, inner, degree)
            blocks.append(of_degree @ derived)
            # Coefficients of the derivative, de Boor, 1978, X(12).
            between = inner[degree + 1 : -1] - inner[1 : -degree - 1]
            rates = degree / between
            ahead = sp.diags_array(
                [-rates, rates],
                offsets=[0, 1],
                shape=(len(rates), len(rates) + 1),
            )
            derived = ahead @ derived
        return sp.vstack(blocks).tocsr(), np.ones(n)


class Pseudospectral(Transcription):
    """Degree-3 polynomials at Radau points, as in the paper (II-C).

    Nodes are the start and the three collocation points of each interval;
    the last of them is the interval's end. The integrators hold at the
    collocation points.
    """

    def _add_to(self, program):
        n_dof, intervals = self.num_dof, self.num_intervals
        points, weights, D = radau_points()
        starts, steps = self.mesh[:-1, None], self.steps[:, None]
        self.times = np.r_[0.0, (starts + steps * points).ravel()]
        self.quadrature = np.r_[0.0, (steps * weights).ravel()]
        n = 3 * intervals + 1
        prog = program.prog
        states = prog.NewContinuousVariables(n * 3 * n_dof, f"{self.name} x")
        states = states.reshape(n, 3 * n_dof)
        self.q, self.v, self.a = np.split(states, 3, axis=1)
        jerk = prog.NewContinuousVariables((n - 1) * n_dof, f"{self.name} u")
        self.jerk = jerk.reshape(n - 1, n_dof)
        first = 3 * np.arange(intervals)
        columns = [
            array[first + k]
            for array in (self.q, self.v, self.a)
            for k in range(4)
        ]
        columns += [self.jerk[first + k] for k in range(3)]
        columns = np.concatenate(columns, axis=1)
        for step, which in _by_length(self.steps):
            A = np.kron(_interval_equations(D, step), np.eye(n_dof))
            program.add_constraints(
                f"{self.name} collocation", LinearKernel(A), columns[which]
            )

    @property
    def jerk_weights(self):
        """See Transcription; points of an interval count alike."""
        return np.repeat(self.steps / 3.0, 3)

    def at(self, when, q, v, a, jerk):
        """See Transcription; each state is a cubic in each interval."""
        k, start, h = self._intervals(when)
        fraction = ((when - start) / h)[:, None]
        nodes = np.r_[0.0, radau_points()[0]]
        weights = []
        for i in range(4):
            others = np.delete(nodes, i)
            weights.append(
                np.prod(fraction - others, axis=1) / np.prod(nodes[i] - others)
            )
        return tuple(
            sum(w[:, None] * x[3 * k + i] for i, w in enumerate(weights))
            for x in (q, v, a)
        )

    def _scalar_basis(self):
        """See Transcription; unknowns are q, v, a at the mesh points."""
        intervals = self.num_intervals
        n = 3 * intervals + 1
        # Columns: q0..q3, v0..v3, a0..a3, j1..j3, in units of h = 1.
        A = _interval_equations(radau_points()[2], 1.0)
        ends = [0, 4, 8, 3, 7, 11]
        inner = [1, 2, 5, 6, 9, 10, 12, 13, 14]
        orders = np.repeat([0, 1, 2, 3], [2, 2, 2, 3])
        inside = -np.linalg.solve(A[:, inner], A[:, ends])
        powers = np.tile([0.0, 1.0, 2.0], 2) - orders[:, None]
        inside = inside * self.steps[:, None, None] ** powers
        places = orders * n + np.array([1, 2, 1, 2, 1, 2, 0, 1, 2])
        k = 3 * np.arange(intervals)[:, None, None]
        shape = (intervals, 9, 6)
        mesh = 3 * np.arange(intervals + 1)[:, None]
        rows = [
            np.broadcast_to(k + places[:, None], shape).ravel(),
            (mesh + n * np.arange(3)).ravel(),
        ]
        columns = [
            np.broadcast_to(k + np.arange(6), shape).ravel(),
            (mesh + np.arange(3)).ravel(),
        ]
        values = [
            np.broadcast_to(inside, shape).ravel(),
            np.ones(3 * (intervals + 1)),
        ]
        basis = sp.csr_array(
            (
                np.concatenate(values),
                (np.concatenate(rows), np.concatenate(columns)),
            ),
            shape=(4 * n - 1, 3 * (intervals + 1)),
        )
        return basis, np.tile([1.0, 1.0, 10.0], intervals + 1)


TRANSCRIPTIONS = {
    "hermite_simpson": HermiteSimpson,
    "pseudospectral": Pseudospectral,
}


def stands_for(steps: np.ndarray) -> np.ndarray:
    """Time (m + 1,) that each node stands for, from m steps between nodes [s].

    Nodes at the ends count in full, like others.
    """
    beside = 0.5 * (steps[:-1] + steps[1:])
    return np.r_[steps[0], beside, steps[-1]]


def _by_length(steps: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """(length, indices of the intervals of that length) of steps (m,)."""
    # Equal lengths differ by rounding.
    _, first, of = np.unique(
        np.round(steps, 12), return_index=True, return_inverse=True
    )
    return [(steps[i], np.flatnonzero(of == k)) for k, i in enumerate(first)]


def radau_points():
    """Radau points of degree 3 on (0, 1].

    Returns:
        points (3,), quadrature weights (3,), and D (3, 4): derivatives at
        the points of the Lagrange polynomials through 0 and the points.
    """
    root6 = np.sqrt(6.0)
    points = np.array([(4.0 - root6) / 10.0, (4.0 + root6) / 10.0, 1.0])
    powers = np.vander(points, 3, increasing=True)
    weights = np.linalg.solve(powers.T, 1.0 / np.arange(1.0, 4.0))
    nodes = np.r_[0.0, points]
    D = np.empty((3, 4))
    for i in range(4):
        poly = np.poly1d(np.delete(nodes, i), r=True)
        D[:, i] = poly.deriv()(points) / poly(nodes[i])
    return points, weights, D


def _interval_equations(D, h):
    """D q = h v, D v = h a, D a = h j at the three points, (9, 15)."""
    A = np.zeros((9, 15))
    for block in range(3):
        rows = slice(3 * block, 3 * block + 3)
        A[rows, 4 * block : 4 * block + 4] = D
        first = 12 if block == 2 else 4 * (block + 1) + 1
        A[rows, first : first + 3] = -h * np.eye(3)
    return A


def _integrator(n_dof):
    """Triple integrator: states q, v, a; input jerk."""
    zero, eye = np.zeros((n_dof, n_dof)), np.eye(n_dof)
    A = np.block([[zero, eye, zero], [zero, zero, eye], [zero, zero, zero]])
    B = np.vstack([zero, zero, eye])
    return LinearSystem(A, B, np.zeros((0, 3 * n_dof)), np.zeros((0, n_dof)))
