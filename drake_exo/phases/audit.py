"""Does the solution hold between its nodes, and does it simulate?"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.forces.contact_parameters import (
    ContactParameters,
    ContactSphere,
)
from drake_exo.forces.diagram import build_diagram, build_simulator
from drake_exo.forces.tracking_controller import TrackingController
from drake_exo.optimal_control.kernels import (
    FORCE_UNIT,
    GROUND_MOMENT_UNIT,
    SPHERE_PARAMETERS,
    DynamicsKernel,
    FootGroundKernel,
)
from drake_exo.optimal_control.transcription import TRANSCRIPTIONS
from drake_exo.phases.problem import PhaseResult, Trajectory
from drake_exo.planar_tree import PlanarTree
from drake_exo.segments import ExoskeletonParameters, HumanParameters

FORCE_TOLERANCE = 1.0  # N
MOMENT_TOLERANCE = 0.5  # N m
_REPORTS_PER_SECOND = 100.0


@dataclass(frozen=True)
class Audit:
    """Residuals of one trial.

    Attributes:
        force_n: largest force missing between nodes.
        moment_nm: largest moment missing between nodes.
        simulated_grf_n: RMS difference of the simulated ground reaction
            (horizontal, vertical) from the solution's.
        simulated_angles_deg: largest RMS difference of a joint angle.
        holds: whether both residuals are within tolerance.
    """

    force_n: float
    moment_nm: float
    simulated_grf_n: tuple[float, float]
    simulated_angles_deg: float

    @property
    def holds(self) -> bool:
        """Whether the residuals between nodes are within tolerance."""
        return (
            self.force_n <= FORCE_TOLERANCE
            and self.moment_nm <= MOMENT_TOLERANCE
        )


def between_nodes(
    tree: PlanarTree, result: PhaseResult, trajectory: Trajectory
) -> tuple[float, float]:
    """Largest force [N] and moment [N m] missing midway between nodes.

    Controls are cubic splines through the nodes.
    """
    grid = TRANSCRIPTIONS[result.settings.solver.transcription]
    times, q, v, a = grid.midpoints(
        trajectory.times,
        trajectory.q,
        trajectory.v,
        trajectory.a,
        trajectory.jerk,
    )
    torque = CubicSpline(trajectory.times, trajectory.torque)(times)
    ground = CubicSpline(trajectory.times, trajectory.ground)(times)
    dynamics = FORCE_UNIT * DynamicsKernel(tree).evaluate(
        np.hstack([q, v, a, torque, ground]), None
    )
    settings = result.settings
    kernel = FootGroundKernel(settings.law, settings.law_constants())
    values = np.broadcast_to(
        result.values(), (len(times), len(result.parameters))
    )
    contact = kernel.evaluate(
        np.hstack([q[:, :3], v[:, :3], ground, values]), None
    )
    contact = contact * [FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT]
    force = max(np.abs(dynamics[:, :2]).max(), np.abs(contact[:, :2]).max())
    moment = max(np.abs(dynamics[:, 2:]).max(), np.abs(contact[:, 2]).max())
    return float(force), float(moment)


def simulate(
    kind: str,
    human: HumanParameters,
    exoskeleton: ExoskeletonParameters | None,
    gravity: float,
    result: PhaseResult,
    trajectory: Trajectory,
) -> Trajectory:
    """Run a trial in the Diagram with the calibrated contact.

    The solution's torques act, with feedback that keeps it from drifting; as
    in Phase A, human and exoskeleton do not touch.

    Returns:
        The simulated motion at the solution's nodes.
    """
    controller = TrackingController(
        trajectory.times, trajectory.q, trajectory.v, trajectory.torque
    )
    model = build_diagram(
        kind,
        human,
        exoskeleton,
        contact=contact_parameters(result),
        bushings={} if kind == "coupled" else None,
        controller=controller,
        gravity=gravity,
    )
    simulator = build_simulator(model)
    context = simulator.get_mutable_context()
    plant_context = model.plant_context(context)
    model.plant.SetPositions(plant_context, trajectory.q[0])
    model.plant.SetVelocities(plant_context, trajectory.v[0])
    simulator.Initialize()
    state, ground, torque = [], [], []
    for t in trajectory.times:
        simulator.AdvanceTo(float(t))
        state.append(model.diagram.GetOutputPort("state").Eval(context))
        ground.append(
            model.diagram.GetOutputPort("ground_reaction").Eval(context)
        )
        torque.append(
            model.diagram.GetOutputPort("joint_torques").Eval(context)
        )
    q, v = np.split(np.array(state), 2, axis=1)
    return Trajectory(
        trajectory.name,
        trajectory.times,
        q,
        v,
        np.gradient(v, trajectory.times, axis=0),
        np.zeros_like(trajectory.jerk),
        np.array(torque),
        np.array(ground),
    )


def contact_parameters(result: PhaseResult) -> ContactParameters:
    """The calibrated contact as the LeafSystem takes it."""
    values = result.values().reshape(-1, len(SPHERE_PARAMETERS))
    spheres = {
        name: ContactSphere(
            **dict(zip(SPHERE_PARAMETERS, map(float, row), strict=True))
        )
        for name, row in zip(("heel", "toe"), values, strict=True)
    }
    settings = result.settings
    return ContactParameters(settings.law, spheres, settings.law_constants())


def compare(
    solution: Trajectory, simulated: Trajectory, residuals: tuple[float, float]
) -> Audit:
    """Join the two halves of an audit."""
    d_ground = simulated.ground[:, :2] - solution.ground[:, :2]
    d_angles = np.rad2deg(simulated.q[:, 3:] - solution.q[:, 3:])
    grf = np.sqrt(np.mean(d_ground**2, axis=0))
    return Audit(
        force_n=residuals[0],
        moment_nm=residuals[1],
        simulated_grf_n=(float(grf[0]), float(grf[1])),
        simulated_angles_deg=float(np.sqrt(np.mean(d_angles**2, axis=0)).max()),
    )
