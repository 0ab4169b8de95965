"""A movement of a planar model on the ground, as part of a program.

One `Movement` is one trial: trajectories on a collocation grid, joint torques
and ground reaction as controls, and the equations that tie them. Several
movements share one program and one set of contact parameters.
"""

from typing import Literal

import numpy as np

from drake_exo.collocation.bushing_kernels import UNITS as INTERACTION_UNITS
from drake_exo.collocation.bushing_kernels import (
    Bushing,
    BushingKernel,
    CoupledDynamicsKernel,
)
from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    GROUND_MOMENT_UNIT,
    MOMENT_UNIT,
    DynamicsKernel,
    FootGroundKernel,
)
from drake_exo.collocation.loads import AppliedWrench, LoadedDynamicsKernel
from drake_exo.collocation.transcription import TRANSCRIPTIONS, Transcription
from drake_exo.contact.parameters import ContactParameter
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import COUPLED_COORDINATES
from drake_exo.nlp.program import BatchedProgram

Role = Literal["position", "velocity", "measured", "regulariser"]


class Movement:
    """Variables and constraints of one trial.

    Attributes:
        name: of the trial.
        grid: transcription with q, v, a and jerk.
        torque: (n, nq - 3) joint torques [N m].
        ground: (n, 3) ground reaction F_x, F_z [N] and M_y about the
            laboratory origin [N m].
        interaction: (n, 9) forces of the bushings on the human's shank,
            thigh and pelvis (tangential, normal [N], moment [N m] each), or
            None where the model has no bushings.
        dynamics: kernel of the equations of motion; its inputs are q, v, a,
            torque, ground and, with bushings, interaction and origins.
        tracked: terms of the cost.

    Args:
        program: to add to.
        name: of the trial.
        tree: dynamics of the model.
        duration: of the movement [s].
        nodes_per_second: mesh intervals per second.
        transcription: name in TRANSCRIPTIONS.
        bushings: couple human and exoskeleton, with `origins` (2 each) as
            decision variables.
        chair: wrench of the chair, if the movement starts seated.
    """

    def __init__(
        self,
        program: BatchedProgram,
        name: str,
        tree: PlanarTree,
        duration: float,
        nodes_per_second: float,
        transcription: str = "hermite_simpson",
        bushings: list[Bushing] | None = None,
        origins: np.ndarray | None = None,
        chair: AppliedWrench | None = None,
    ):
        self.name = name
        self.program = program
        nq = tree.num_positions
        intervals = max(round(duration * nodes_per_second), 1)
        self.grid: Transcription = TRANSCRIPTIONS[transcription](
            program, name, nq, duration, intervals
        )
        n = len(self.grid.times)
        prog = program.prog
        torque = prog.NewContinuousVariables(n * (nq - 3), f"{name} torque")
        self.torque = torque.reshape(n, nq - 3)
        ground = prog.NewContinuousVariables(n * 3, f"{name} ground")
        self.ground = ground.reshape(n, 3)
        for variable in torque:
            prog.SetVariableScaling(variable, MOMENT_UNIT)
        units = (FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT)
        for column, unit in zip(self.ground.T, units, strict=True):
            for variable in column:
                prog.SetVariableScaling(variable, unit)
        self._label(tree)
        grid = self.grid
        inputs = [grid.q, grid.v, grid.a, self.torque, self.ground]
        kernel = DynamicsKernel(tree)
        self.interaction = None
        if bushings:
            kernel = CoupledDynamicsKernel(tree, bushings)
            self.interaction = self._interaction_variables(len(bushings))
            inputs.append(self.interaction)
            inputs.append(np.broadcast_to(origins, (n, len(origins))))
        self._chair = chair
        if chair is not None:
            kernel = LoadedDynamicsKernel(kernel, chair)
        self.dynamics = kernel
        self.tracked: list[Tracking] = []
        program.add_constraints(
            f"{name} dynamics",
            kernel,
            np.hstack(inputs),
            data=self.loads(grid.times),
        )

    def loads(self, times: np.ndarray) -> np.ndarray | None:
        """Data of the dynamics kernel: the chair's wrench (n, 3), if any."""
        return None if self._chair is None else self._chair.at(times)

    def applied(self, q: np.ndarray) -> np.ndarray | float:
        """Generalized forces (n, nq) of the chair at the nodes."""
        if self._chair is None:
            return 0.0
        return self._chair.generalized(q, self._chair.at(self.grid.times))

    def _label(self, tree):
        """Name what may be bounded, for reports of infeasible problems."""
        joints = COUPLED_COORDINATES[: tree.num_positions]
        at = [f"at {t:.3g} s" for t in self.grid.times]
        turns = len(joints) - 2
        degrees = np.rad2deg(1.0)
        for kind, variables, names, what, units in (
            (
                "state",
                self.grid.q,
                joints,
                "",
                [("m", 1.0)] * 2 + [("deg", degrees)] * turns,
            ),
            (
                "state",
                self.grid.v,
                joints,
                " velocity",
                [("m/s", 1.0)] * 2 + [("deg/s", degrees)] * turns,
            ),
            (
                "limit",
                self.torque,
                joints[3:],
                " torque",
                [("N m", 1.0)] * (turns - 1),
            ),
        ):
            columns = [f"{self.name} {joint}{what}" for joint in names]
            self.program.label(kind, variables, columns, at, units)

    def _interaction_variables(self, num_bushings):
        prog = self.program.prog
        n = len(self.grid.times)
        variables = prog.NewContinuousVariables(
            n * 3 * num_bushings, f"{self.name} interaction"
        ).reshape(n, -1)
        units = np.tile(INTERACTION_UNITS, num_bushings)
        for column, unit in zip(variables.T, units, strict=True):
            for variable in column:
                prog.SetVariableScaling(variable, unit)
        return variables

    def stand_on(self, kernel: FootGroundKernel, parameters: np.ndarray):
        """Tie the ground reaction to the contact law.

        Args:
            kernel: the law.
            parameters: its decision variables, in the kernel's order.
        """
        grid = self.grid
        n = len(grid.times)
        variables = np.hstack(
            [
                grid.q[:, :3],
                grid.v[:, :3],
                self.ground,
                np.broadcast_to(parameters, (n, len(parameters))),
            ]
        )
        self.program.add_constraints(
            f"{self.name} foot-ground", kernel, variables
        )

    def strap(self, index: int, kernel: BushingKernel, parameters) -> None:
        """Tie the forces of one bushing to its law.

        Args:
            index: of the bushing.
            kernel: the law.
            parameters: its decision variables, as BUSHING_PARAMETERS.
        """
        grid = self.grid
        n = len(grid.times)
        force = self.interaction[:, 3 * index : 3 * index + 3]
        self.program.add_constraints(
            f"{self.name} bushing {index}",
            kernel,
            np.hstack(
                [
                    grid.q,
                    grid.v,
                    force,
                    np.broadcast_to(parameters, (n, len(parameters))),
                ]
            ),
        )

    def bound(self, variables, lower, upper) -> None:
        """Bound variables of this movement; equal bounds fix them."""
        self.program.prog.AddBoundingBoxConstraint(
            np.asarray(lower, float), np.asarray(upper, float), variables
        )

    def track(self, terms: "list[Tracking]") -> None:
        """Add 1/2 integral of sum ((A z - target)/sigma)^2 dt as cost."""
        grid = self.grid
        self.tracked.extend(terms)
        variables = np.hstack([t.variables for t in terms])
        n, m = variables.shape
        Q, b, c = np.zeros((n, m, m)), np.zeros((n, m)), np.zeros(n)
        first = 0
        for term in terms:
            last = first + term.variables.shape[1]
            A = term.rows / term.sigma[:, :, None]
            y = term.target / term.sigma
            Q[:, first:last, first:last] += A.transpose(0, 2, 1) @ A
            b[:, first:last] -= np.einsum("nrm,nr->nm", A, y)
            c += 0.5 * np.sum(y * y, axis=1)
            first = last
        for t, weight in enumerate(grid.quadrature):
            if weight > 0.0:
                cost = self.program.prog.AddQuadraticCost(
                    weight * Q[t],
                    weight * b[t],
                    weight * c[t],
                    variables[t],
                    is_convex=True,
                )
                cost.evaluator().set_description(f"{self.name} cost[{t}]")

    def damp_jerk(self, sigma) -> None:
        """Add 1/2 integral of |jerk/sigma|^2 dt, one sigma for each dof."""
        jerk = self.grid.jerk
        self.jerk_sigma = np.broadcast_to(sigma, jerk.shape[1:])
        Q = np.diag(1.0 / np.broadcast_to(sigma, jerk.shape[1:]) ** 2)
        weight = self.jerk_weight
        zero = np.zeros(len(Q))
        for row in jerk:
            self.program.prog.AddQuadraticCost(
                weight * Q, zero, row, is_convex=True
            )

    @property
    def jerk_weight(self) -> float:
        """Quadrature weight of each row of jerk [s]."""
        return self.grid.step * self.grid.num_intervals / len(self.grid.jerk)


class Tracking:
    """One tracked signal: rows A (n, r, m) of variables, targets, sigmas.

    Args:
        variables: (n, m) decision variables.
        target: (n, r) measured values.
        sigma: noise, broadcast to (n, r); infinite where not tracked.
        rows: (n, r, m) linear map; identity by default.
        role: what the target is: "position" or "velocity" (noise of the
            second is the derivative of the first's), another "measured"
            signal, or a "regulariser", which is none.
    """

    def __init__(
        self, variables, target, sigma, rows=None, role: Role = "measured"
    ):
        self.role = role
        self.variables = variables
        self.target = np.asarray(target, float)
        self.sigma = np.broadcast_to(
            np.asarray(sigma, float), self.target.shape
        )
        if rows is None:
            m = variables.shape[1]
            rows = np.broadcast_to(np.eye(m), (len(variables), m, m))
        self.rows = rows


def minimised(variables: np.ndarray, sigma) -> Tracking:
    """A term that pulls variables (n, m) to zero."""
    zero = np.zeros(variables.shape)
    return Tracking(variables, zero, sigma, role="regulariser")


def add_parameters(
    program: BatchedProgram,
    parameters: list[ContactParameter],
    prior_weight: float,
) -> np.ndarray:
    """Add contact parameters as decision variables.

    Free ones are bounded, others fixed at their nominal values. The prior is
    1/2 weight ((p - nominal)/span)^2 for each free one.

    Returns:
        (len(parameters),) variables.
    """
    prog = program.prog
    variables = np.array(
        [prog.NewContinuousVariables(1, p.name)[0] for p in parameters]
    )
    for variable, p in zip(variables, parameters, strict=True):
        bounds = (p.lower, p.upper) if p.free else (p.nominal, p.nominal)
        prog.AddBoundingBoxConstraint(*bounds, variable)
        prog.SetVariableScaling(variable, max(abs(p.nominal), 0.1 * p.span))
        if p.free and prior_weight > 0.0:
            weight = prior_weight / p.span**2
            prog.AddQuadraticErrorCost(
                np.array([[weight]]), [p.nominal], [variable]
            )
    return variables
