"""Does the solution hold between its nodes, and does it simulate?

Audit of all trials of a command, as a table and for summary.json.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.calibration import audit
from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import PhaseProblem, PhaseResult, Trajectory
from drake_exo.calibration.scores import rms
from drake_exo.collocation.bushing_kernels import (
    BUSHING_PARAMETERS,
    BUSHINGS,
    UNITS,
)
from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    GROUND_MOMENT_UNIT,
    SPHERE_PARAMETERS,
)
from drake_exo.collocation.transcription import TRANSCRIPTIONS
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.controllers import TrackingController
from drake_exo.contact.diagram import build_diagram, build_simulator
from drake_exo.contact.parameters import ContactParameters, ContactSphere
from drake_exo.contact.systems import Chair
from drake_exo.files.output import Progress
from drake_exo.model.plant import build_plant
from drake_exo.model.segments import ExoskeletonParameters, HumanParameters
from drake_exo.report.tables import format_table

FORCE_TOLERANCE = 1.0  # N
MOMENT_TOLERANCE = 0.5  # N m


@dataclass(frozen=True)
class Audit:
    """Residuals of one trial.

    Attributes:
        force_n: largest force missing between nodes.
        moment_nm: largest moment missing between nodes.
        simulated_grf_n: RMS difference of the simulated ground reaction
            (horizontal, vertical) from the solution's.
        simulated_angles_deg: largest RMS difference of a joint angle.
        simulated_interaction_n: largest RMS difference of an interaction
            force; None without bushings.
        holds: whether both residuals are within tolerance.
    """

    force_n: float
    moment_nm: float
    simulated_grf_n: tuple[float, float]
    simulated_angles_deg: float
    simulated_interaction_n: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the residuals between nodes are within tolerance."""
        return (
            self.force_n <= FORCE_TOLERANCE
            and self.moment_nm <= MOMENT_TOLERANCE
        )


def between_nodes(
    problem: PhaseProblem, result: PhaseResult, index: int
) -> tuple[float, float]:
    """Largest force [N] and moment [N m] missing midway between nodes.

    Controls are cubic splines through the nodes.

    Args:
        problem: that was solved.
        result: its solution.
        index: of the trial.
    """
    trajectory = result.trajectories[index]
    grid = TRANSCRIPTIONS[result.settings.solver.transcription]
    times, q, v, a = grid.midpoints(
        trajectory.times,
        trajectory.q,
        trajectory.v,
        trajectory.a,
        trajectory.jerk,
    )

    def at(values):
        return CubicSpline(trajectory.times, values)(times)

    def repeated(values):
        return np.broadcast_to(values, (len(times), len(values)))

    spheres, bushings = problem.contact_values(result.values())
    ground = at(trajectory.ground)
    inputs = [q, v, a, at(trajectory.torque), ground]
    if len(bushings):
        interaction = at(trajectory.interaction)
        inputs += [interaction, repeated(bushings[:, :2].ravel())]
    movement = problem.movements[index]
    dynamics = FORCE_UNIT * movement.dynamics.evaluate(
        np.hstack(inputs), movement.loads(times)
    )
    contact = problem.kernel.evaluate(
        np.hstack([q[:, :3], v[:, :3], ground, repeated(spheres)]), None
    )
    contact = contact * [FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT]
    forces = [dynamics[:, :2], contact[:, :2]]
    moments = [dynamics[:, 2:], contact[:, 2:]]
    for b, (law, values) in enumerate(zip(problem.laws, bushings, strict=True)):
        force = interaction[:, 3 * b : 3 * b + 3]
        r = UNITS * law.evaluate(
            np.hstack([q, v, force, repeated(values)]), None
        )
        forces.append(r[:, :2])
        moments.append(r[:, 2:])
    return tuple(
        float(max(np.abs(r).max() for r in parts))
        for parts in (forces, moments)
    )


def simulate(
    kind: str,
    human: HumanParameters,
    exoskeleton: ExoskeletonParameters | None,
    gravity: float,
    problem: PhaseProblem,
    result: PhaseResult,
    index: int,
) -> Trajectory:
    """Run a trial in the Diagram with the phase's contact.

    The solution's torques act, with feedback that keeps it from drifting. In
    Phase A, human and exoskeleton do not touch.

    Args:
        kind, human, exoskeleton, gravity: the model.
        problem, result, index: as `between_nodes`.

    Returns:
        The simulated motion at the solution's nodes.
    """
    trajectory = result.trajectories[index]
    model = build_diagram(
        kind,
        human,
        exoskeleton,
        contact=contact_parameters(problem, result),
        bushings=(
            bushing_parameters(problem, result) if kind == "coupled" else None
        ),
        controller=TrackingController(
            trajectory.times, trajectory.q, trajectory.v, trajectory.torque
        ),
        forces=_chair(kind, human, exoskeleton, problem.trials[index]),
        gravity=gravity,
    )
    simulator = build_simulator(model)
    context = simulator.get_mutable_context()
    plant_context = model.plant_context(context)
    model.plant.SetPositions(plant_context, trajectory.q[0])
    model.plant.SetVelocities(plant_context, trajectory.v[0])
    simulator.Initialize()
    ports = ["state", "ground_reaction", "joint_torques"]
    if model.bushings is not None:
        ports.append("interaction_forces")
    rows = {name: [] for name in ports}
    for t in trajectory.times:
        simulator.AdvanceTo(float(t))
        for name in ports:
            value = model.diagram.GetOutputPort(name).Eval(context)
            rows[name].append(value)
    q, v = np.split(np.array(rows["state"]), 2, axis=1)
    interaction = rows.get("interaction_forces")
    return Trajectory(
        trajectory.name,
        trajectory.times,
        q,
        v,
        np.gradient(v, trajectory.times, axis=0),
        np.zeros_like(trajectory.jerk),
        np.array(rows["joint_torques"]),
        np.array(rows["ground_reaction"]),
        None if interaction is None else np.array(interaction),
    )


def _chair(kind, human, exoskeleton, trial: MeasuredMovement) -> list:
    """The chair that a trial starts on, if it does."""
    if trial.chair is None:
        return []
    plant = build_plant(kind, human, exoskeleton)
    bodies = {
        plant.GetBodyByName(name).index(): share
        for name, share in trial.chair_shares.items()
    }
    return [Chair(bodies, trial.times, trial.chair)]


def contact_parameters(
    problem: PhaseProblem, result: PhaseResult
) -> ContactParameters:
    """The foot-ground contact as the LeafSystem takes it."""
    values, _ = problem.contact_values(result.values())
    spheres = {
        name: ContactSphere(
            **dict(zip(SPHERE_PARAMETERS, map(float, row), strict=True))
        )
        for name, row in zip(
            ("heel", "toe"),
            values.reshape(-1, len(SPHERE_PARAMETERS)),
            strict=True,
        )
    }
    return ContactParameters(
        problem.foot.law, spheres, problem.foot.law_constants()
    )


def bushing_parameters(
    problem: PhaseProblem, result: PhaseResult
) -> dict[str, BushingParameters]:
    """The bushings as the LeafSystem takes them, scaled as in the phase."""
    _, table = problem.contact_values(result.values())
    if not len(table):
        return {}
    parameters = {}
    for name, row in zip(BUSHINGS, table, strict=True):
        tangential, normal, rotational = problem.damping[name]
        x, z, angle = problem.preload.get(name, (0.0, 0.0, 0.0))
        parameters[name] = BushingParameters(
            **dict(zip(BUSHING_PARAMETERS, map(float, row), strict=True)),
            tangential_damping=tangential,
            normal_damping=normal,
            rotational_damping=rotational,
            preload_x=x,
            preload_z=z,
            preload_angle=angle,
        ).scaled(problem.scale)
    return parameters


def compare(
    solution: Trajectory, simulated: Trajectory, residuals: tuple[float, float]
) -> Audit:
    """Join the two halves of an audit."""
    d_ground = simulated.ground[:, :2] - solution.ground[:, :2]
    d_angles = np.rad2deg(simulated.q[:, 3:] - solution.q[:, 3:])
    interaction = None
    if solution.interaction is not None:
        d_force = simulated.interaction - solution.interaction
        linear = d_force.reshape(len(d_force), -1, 3)[:, :, :2]
        interaction = float(rms(linear.reshape(len(d_force), -1)).max())
    grf = rms(d_ground)
    return Audit(
        force_n=residuals[0],
        moment_nm=residuals[1],
        simulated_grf_n=(float(grf[0]), float(grf[1])),
        simulated_angles_deg=float(rms(d_angles).max()),
        simulated_interaction_n=interaction,
    )


def audit_trials(
    model: tuple,
    gravity: float,
    solved: Sequence[tuple[PhaseProblem, PhaseResult]],
) -> list[dict]:
    """Look between the nodes and simulate; prints a table.

    Args:
        model: kind, human, exoskeleton.
        gravity: [m/s^2].
        solved: problems with their results, one or more trials each.

    Returns:
        One row for each trial, see `audit.Audit`.
    """
    pairs = [
        (problem, result, i)
        for problem, result in solved
        for i in range(len(result.trajectories))
    ]
    rows = []
    progress = Progress("simulate", total=len(pairs))
    for k, (problem, result, i) in enumerate(pairs):
        found = result.trajectories[i]
        residuals = audit.between_nodes(problem, result, i)
        simulated = audit.simulate(*model, gravity, problem, result, i)
        checked = audit.compare(found, simulated, residuals)
        progress.update(found.name, done=k + 1)
        rows.append(
            {"trial": found.name, "holds": checked.holds, **asdict(checked)}
        )
    header = [
        "audit",
        "between nodes [N]",
        "[N m]",
        "simulated F_x [N]",
        "F_z [N]",
        "angles [deg]",
        "interaction [N]",
    ]
    table = [
        [
            r["trial"],
            r["force_n"],
            r["moment_nm"],
            *r["simulated_grf_n"],
            r["simulated_angles_deg"],
            r["simulated_interaction_n"],
        ]
        for r in rows
    ]
    print(format_table(header, table))
    return rows
