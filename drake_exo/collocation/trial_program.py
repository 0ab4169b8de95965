"""A trial of a planar model on the ground, as part of a program.

`TrialProgram` adds trajectories on a collocation grid, joint torques, ground
reaction and cuff forces as controls, and the equations that tie them. Several
trials share one program and one set of contact parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from drake_exo.collocation.bushing_kernels import UNITS as CUFF_UNITS
from drake_exo.collocation.kernels import (
    MOMENT_UNIT,
    WRENCH_UNITS,
    AppliedWrench,
    DynamicsKernel,
    PoseKernel,
)
from drake_exo.collocation.transcription import TRANSCRIPTIONS, Transcription
from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.parameters import ContactParameter
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.nlp.program import BatchedProgram, Kernel

# Typical size of alternating accelerations of the root [m/s^2, rad/s^2] in the
# cost: about a newton by a body's mass, as much as an audit allows.
ALTERNATING = 0.0125
_FEWEST = 4  # mesh intervals of a trial
_NOTHING = np.array([], object)

Role = Literal["position", "velocity", "measured", "regulariser"]


class TrialProgram:
    """Variables and constraints of one trial.

    Attributes:
        name: name of the trial.
        coordinates: the model's coordinates.
        grid: transcription with q, v, a and jerk.
        torque: (n, n_joints) joint torques [N m].
        ground: (n, 3 k) ground reactions on all k bodies side by side.
        grounds: body that touches the ground -> (n, 3) of these: F_x, F_z [N]
            and M_y about the laboratory origin [N m].
        poses: such a body -> (n, 6) x, z, pitch and their rates: the root's
            coordinates, or further variables tied by kinematics, so that the
            law under every body is the same function.
        cuffs: cuff -> (n, 3) force of its bushing on the human: tangential,
            normal [N], moment [N m].
        dynamics: kernel of the equations of motion; its inputs are q, v, a,
            torque, ground and, with bushings, their forces and places.
        tracked: tracking terms of the cost.
        damped: variables (m, k), their weights (m, k) in m accelerations, in
            units of ALTERNATING, and the time (m,) each stands for [s]; see
            `damp`.

    Args:
        program: program to add to.
        name: name of the trial.
        tree: dynamics of the model.
        duration: duration of the movement [s].
        nodes_per_second: mesh intervals per second; at least four in all.
        transcription: name in TRANSCRIPTIONS.
        bushings: cuff -> kinematics of its bushing, and its places as
            decision variables.
        chair: wrenches of chair and carried loads, if any.
        bodies: bodies that touch the ground; the root by default.
        equations: makes the kernel of the equations of motion.
        parts: number of parts of each interval, see `Transcription`.
    """

    def __init__(
        self,
        program: BatchedProgram,
        name: str,
        tree: PlanarTree,
        duration: float,
        nodes_per_second: float,
        transcription: str = "hermite_simpson",
        bushings: dict[str, tuple[BushingKinematics, np.ndarray]] | None = None,
        chair: AppliedWrench | None = None,
        bodies: Sequence[str] | None = None,
        equations: Callable[..., DynamicsKernel] = DynamicsKernel,
        parts: np.ndarray | int = 1,
    ):
        self.name = name
        self.program = program
        self.tree = tree
        self.coordinates = tree.coordinates
        intervals = max(round(duration * nodes_per_second), _FEWEST)
        self.grid: Transcription = TRANSCRIPTIONS[transcription](
            program, name, tree.num_positions, duration, intervals, parts
        )
        moments = np.full(tree.coordinates.num_joints, MOMENT_UNIT)
        self.torque = self.new("torque", moments)
        bodies = (tree.root,) if bodies is None else tuple(bodies)
        wrench = tuple(WRENCH_UNITS)
        self.ground = self.new("ground", wrench * len(bodies))
        parts = np.split(self.ground, len(bodies), axis=1)
        self.grounds = dict(zip(bodies, parts, strict=True))
        self.poses: dict[str, np.ndarray] = {}
        grid, root = self.grid, tree.coordinates.root_columns
        for body in bodies:
            if body == tree.root:
                pose = np.hstack([grid.q[:, root], grid.v[:, root]])
            else:
                pose = self.new(f"{body} pose", np.ones(6))
                program.add_constraints(
                    f"{name} pose of {body}",
                    PoseKernel(tree, body),
                    np.hstack([grid.q, grid.v, pose]),
                )
            self.poses[body] = pose
        self._label()
        inputs = [grid.q, grid.v, grid.a, self.torque, self.ground]
        bushings, self.cuffs = bushings or {}, {}
        if bushings:
            units = np.tile(CUFF_UNITS, len(bushings))
            forces = self.new("interaction", units)
            places = np.concatenate([own for _, own in bushings.values()])
            inputs += [forces, self.at_nodes(places)]
            parts = np.split(forces, len(bushings), axis=1)
            self.cuffs = dict(zip(bushings, parts, strict=True))
        kinematics = [bushing for bushing, _ in bushings.values()]
        self._chair = chair
        self.dynamics = equations(tree, bodies, kinematics, chair)
        self.tracked: list[Tracking] = []
        nothing = self.grid.jerk[:0]
        self.damped = nothing, np.ones(nothing.shape), np.ones(0)
        program.add_constraints(
            f"{name} dynamics",
            self.dynamics,
            np.hstack(inputs),
            data=self.loads(grid.times),
        )

    def new(self, what: str, units, rows: int | None = None) -> np.ndarray:
        """New variables (rows, len(units)), sizes `units`; a row per node."""
        prog, n = self.program.prog, rows or len(self.grid.times)
        variables = prog.NewContinuousVariables(
            n * len(units), f"{self.name} {what}"
        ).reshape(n, len(units))
        for column, unit in zip(variables.T, units, strict=True):
            for variable in column:
                prog.SetVariableScaling(variable, unit)
        return variables

    def at_nodes(self, variables: np.ndarray) -> np.ndarray:
        """Variables (m,) repeated for every node, (n, m)."""
        return np.broadcast_to(
            variables, (len(self.grid.times), len(variables))
        )

    def loads(self, times: np.ndarray) -> np.ndarray | None:
        """Data of the dynamics kernel: wrenches (n, 3 m), if any."""
        return None if self._chair is None else self._chair.at(times)

    def applied(self, q: np.ndarray) -> np.ndarray | float:
        """Generalized forces (n, nq) of chair and loads at the nodes."""
        if self._chair is None:
            return 0.0
        return self._chair.generalized(q, self._chair.at(self.grid.times))

    def _label(self) -> None:
        """Label variables that may be bounded, for reports of `relax`."""
        names = self.coordinates
        at = [f"at {t:.3g} s" for t in self.grid.times]
        degrees = np.rad2deg(1.0)
        positions = [
            ("deg", degrees) if angle else ("m", 1.0)
            for angle in names.is_angle
        ]
        rates = [(f"{unit}/s", factor) for unit, factor in positions]
        moments = [("N m", 1.0)] * names.num_joints
        for kind, variables, of, what, units in (
            ("state", self.grid.q, names.names, "", positions),
            ("state", self.grid.v, names.names, " velocity", rates),
            ("limit", self.torque, names.joints, " torque", moments),
        ):
            columns = [f"{self.name} {name}{what}" for name in of]
            self.program.label(kind, variables, columns, at, units)

    def add_law(self, what: str, law: Kernel, variables, parameters) -> None:
        """Tie variables of all nodes to a law, whose outputs become zero.

        Args:
            what: what is tied, for reports.
            law: its kernel.
            variables: arrays (n, .), its first inputs.
            parameters: (k,) variables that all nodes share, its last inputs.
        """
        inputs = np.hstack([*variables, self.at_nodes(parameters)])
        self.program.add_constraints(f"{self.name} {what}", law, inputs)

    def bound(self, variables, lower, upper) -> None:
        """Bound variables of this trial; equal bounds fix them.

        Args:
            variables: array of decision variables.
            lower, upper: bounds, broadcast to its shape.
        """
        lower, upper = (
            np.broadcast_to(x, variables.shape).ravel().astype(float)
            for x in (lower, upper)
        )
        self.program.prog.AddBoundingBoxConstraint(
            lower, upper, variables.ravel()
        )

    def add_tracking_cost(
        self,
        terms: "list[Tracking]",
        errors: np.ndarray = _NOTHING,
        weights: np.ndarray | None = None,
    ) -> None:
        """Add 1/2 integral of sum ((A z + E e - target)/sigma)^2 dt as cost.

        Args:
            terms: signals z with their rows A and effects E.
            errors: (k,) variables e that all terms with effects share; none
                by default.
            weights: (n,) weights of the nodes [s]; the quadrature by default.
        """
        weights = self.grid.quadrature if weights is None else weights
        self.tracked.extend(terms)
        variables = np.hstack([t.variables for t in terms])
        shared = variables.shape[1]
        variables = np.hstack([variables, self.at_nodes(errors)])
        n, m = variables.shape
        Q, b, c = np.zeros((n, m, m)), np.zeros((n, m)), np.zeros(n)
        ends = np.cumsum([term.variables.shape[1] for term in terms])
        for term, end in zip(terms, ends, strict=True):
            term.weights = weights
            columns = np.arange(end - term.variables.shape[1], end)
            A = term.rows
            if term.effects is not None:
                columns = np.r_[columns, shared:m]
                A = np.concatenate([A, term.effects], axis=2)
            A = A / term.sigma[:, :, None]
            y = term.target / term.sigma
            Q[np.ix_(range(n), columns, columns)] += A.transpose(0, 2, 1) @ A
            b[:, columns] -= np.einsum("nrm,nr->nm", A, y)
            c += 0.5 * np.sum(y * y, axis=1)
        # Nodes without weight get no cost.
        used = weights > 0.0
        weight = weights[used]
        self.program.add_quadratic_costs(
            f"{self.name} cost",
            weight[:, None, None] * Q[used],
            weight[:, None] * b[used],
            weight * c[used],
            variables[used],
        )

    def add_jerk_cost(self, sigma) -> None:
        """Add 1/2 integral of |jerk/sigma|^2 dt; sigma: one, or (n_dof,)."""
        jerk = self.grid.jerk
        self.jerk_sigma = np.broadcast_to(sigma, jerk.shape[1:])
        weights = self.grid.jerk_weights
        self.program.add_quadratic_costs(
            f"{self.name} jerk",
            np.multiply.outer(weights, np.diag(1.0 / self.jerk_sigma**2)),
            np.zeros(jerk.shape),
            np.zeros(len(jerk)),
            jerk,
        )

    @property
    def may_alternate(self) -> bool:
        """Whether accelerations of the root may alternate between nodes.

        True for a root in the air: no torque balances the residual that this
        causes between nodes. A root on the ground is held by its contact.
        """
        return self.tree.root not in self.grounds

    @property
    def is_tracked(self) -> bool:
        """Whether data are tracked; else damping would shape the motion."""
        return any(term.role != "regulariser" for term in self.tracked)

    def damp(self) -> None:
        """Add alternating accelerations of the root, squared, as cost."""
        if not self.may_alternate:
            return
        variables, factors, times = self.grid.alternating()
        root = self.coordinates.root_columns
        variables = variables[:, root].reshape(-1, variables.shape[2])
        factors, times = (np.repeat(x, len(root), 0) for x in (factors, times))
        factors = factors / ALTERNATING
        self.damped = variables, factors, times
        self.program.add_quadratic_costs(
            f"{self.name} between nodes",
            np.einsum("n,ni,nj->nij", times, factors, factors),
            np.zeros(variables.shape),
            np.zeros(len(variables)),
            variables,
        )


@dataclass(eq=False, repr=False)
class Tracking:
    """One tracked signal: (rows @ variables - target)/sigma in the cost.

    Attributes:
        variables: (n, m) decision variables.
        target: (n, r) measured values.
        sigma: noise, broadcast to (n, r); infinite where not tracked.
        rows: (n, r, m) linear map A; identity by default.
        role: kind of target: "position" or "velocity" (whose noise is the
            derivative of the position's), another "measured" signal, or
            "regulariser" for a target that is no measurement.
        effects: (n, r, k) effects E of unknown errors; none by default.
        weights: (n,) of the nodes [s], set when it is added to a cost.
    """

    variables: np.ndarray
    target: np.ndarray
    sigma: np.ndarray | float
    rows: np.ndarray | None = None
    role: Role = "measured"
    effects: np.ndarray | None = None
    weights: np.ndarray = field(init=False)

    def __post_init__(self):
        self.target = np.asarray(self.target, float)
        sigma = np.asarray(self.sigma, float)
        self.sigma = np.broadcast_to(sigma, self.target.shape)
        if self.rows is None:
            n, m = self.variables.shape
            self.rows = np.broadcast_to(np.eye(m), (n, m, m))


def minimised(variables: np.ndarray, sigma) -> Tracking:
    """A term that pulls variables (n, m) to zero."""
    zero = np.zeros(variables.shape)
    return Tracking(variables, zero, sigma, role="regulariser")


def add_parameters(
    program: BatchedProgram,
    parameters: list[ContactParameter],
) -> np.ndarray:
    """Add contact parameters as decision variables.

    Free ones are bounded, others fixed at their nominal values. A free one that
    has a prior_sd gets the prior 1/2 ((p - nominal)/prior_sd)^2 as cost; with
    `log_prior`, of logarithms.

    Returns:
        (len(parameters),) variables.
    """
    prog = program.prog
    variables = program.add_variables(
        [p.name for p in parameters],
        [max(abs(p.nominal), 0.1 * p.span) or 1.0 for p in parameters],
    )
    for variable, p in zip(variables, parameters, strict=True):
        bounds = (p.lower, p.upper) if p.free else (p.nominal, p.nominal)
        prog.AddBoundingBoxConstraint(*bounds, variable)
        if not p.free or p.prior_sd is None:
            continue
        if p.log_prior:
            program.add_residuals(
                f"prior of {p.name}",
                LogKernel(p.nominal, p.prior_sd),
                np.array([[variable]]),
            )
            continue
        weight = 0.5 / p.prior_sd**2  # the cost below has no factor 1/2
        prog.AddQuadraticErrorCost(
            np.array([[weight]]), [p.nominal], [variable]
        )
    return variables


class LogKernel:
    """Residual ln(x / middle) / sd of a log-normal prior; x positive."""

    sparsity = np.ones((1, 1), bool)

    def __init__(self, middle: float, sd: float):
        self._middle = middle
        self._sd = sd

    def evaluate(self, x, data):
        """See Kernel."""
        return np.log(x / self._middle) / self._sd

    def jacobian(self, x, data):
        """See Kernel."""
        return 1.0 / (self._sd * x[:, :, None])
