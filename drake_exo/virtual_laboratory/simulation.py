"""One movement of the virtual subject, simulated as a Drake diagram.

Plant, foot-ground contact, cuffs and chair are systems of the diagram; the
subject is a controller that follows its plan. What a laboratory would measure
comes out of the simulation, not out of the plan.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import EventStatus, LeafSystem
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from drake_exo.forces.diagram import build_diagram, build_simulator
from drake_exo.laboratory.sagittal import PlanarWrench
from drake_exo.output import Progress
from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import build_plant
from drake_exo.virtual_laboratory.loads import (
    applied,
    chair_wrench,
    ground_wrench,
    interaction,
)
from drake_exo.virtual_laboratory.plan import Reference
from drake_exo.virtual_laboratory.seat import Seat, SeatParameters
from drake_exo.virtual_laboratory.truth import Truth

RATE_HZ = 1000.0
_SETTLE_S = 0.4
_ACCURACY = 1e-3
_STEP_S = 0.05
# Of the subject's own feedback, both legs: ankle, knee, hip.
_STIFFNESS = np.array([3000.0, 2000.0, 2000.0])  # N m/rad
_DAMPING = np.array([250.0, 120.0, 120.0])  # N m s/rad
# What the feedback holds, of the rigid model's coordinates: the ankle holds
# the shank against the vertical, not against the foot. On soft soles a foot
# that tips would otherwise take the body along.
_HELD = np.eye(6)[3:] - np.outer([1.0, 0.0, 0.0], np.eye(6)[2])


@dataclass(frozen=True)
class Simulated:
    """What really happened in one movement, at 1000 Hz.

    Attributes:
        name: of the trial.
        times: (N,) from 0 [s].
        q, v, a: (N, 9) coordinates of the coupled model.
        torque: (N, 6) of the human's and the device's joints [N m].
        ground: wrench (N,) of the ground on the feet.
        chair: wrench (N,) of the chair on the pelvis.
        interaction: (N, 9) cuff forces on the human: tangential, normal,
            rotation of shank, thigh, pelvis [N, N m].
        tree: the coupled model.
    """

    name: str
    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    ground: PlanarWrench
    chair: PlanarWrench
    interaction: np.ndarray
    tree: PlanarTree


class SubjectController(LeafSystem):
    """Feed-forward joint torques and feedback towards a plan.

    Input state; output joint_torques: ankle, knee, hip, and zero for the
    passive exoskeleton [N m].

    Args:
        reference: the plan; its ends are held before and after.
    """

    def __init__(self, reference: Reference):
        super().__init__()
        self.set_name("subject")
        self._span = reference.times[[0, -1]]
        targets = [reference.q @ _HELD.T, reference.v @ _HELD.T]
        self._plan = CubicSpline(
            reference.times, np.hstack([*targets, reference.torque])
        )
        self.DeclareVectorInputPort("state", 18)
        self.DeclareVectorOutputPort("joint_torques", 6, self._calc)

    def torques(self, time, q, v) -> np.ndarray:
        """Human joint torques (N, 3) at times (N,) and states (N, 9)."""
        wanted = self._plan(np.clip(time, *self._span))
        moving = (time >= self._span[0]) & (time <= self._span[1])
        position, velocity, torque = np.split(wanted, 3, axis=-1)
        error = position - q[..., :6] @ _HELD.T
        rate = np.where(moving[..., None], velocity, 0.0)
        rate = rate - v[..., :6] @ _HELD.T
        return torque + _STIFFNESS * error + _DAMPING * rate

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        q, v = state[:9], state[9:]
        time = np.array(context.get_time())
        output.SetFromVector(np.r_[self.torques(time, q, v), 0.0, 0.0, 0.0])


def simulate(
    name: str,
    truth: Truth,
    reference: Reference,
    seat: SeatParameters | None,
    progress: Progress | None = None,
) -> Simulated:
    """Let the subject follow its plan.

    Args:
        name: of the trial.
        truth: the subject.
        reference: its plan.
        seat: the chair, if there is one.
        progress: told of every step.
    """
    plant = build_plant(
        "coupled", truth.human, truth.exoskeleton, gravity=truth.gravity
    )
    tree = PlanarTree.from_plant(plant)
    controller = SubjectController(reference)
    chair = []
    if seat is not None:
        chair = [Seat(plant.GetBodyByName("pelvis").index(), seat)]
    model = build_diagram(
        "coupled",
        truth.human,
        truth.exoskeleton,
        contact=truth.contact,
        bushings=truth.bushings,
        controller=controller,
        forces=chair,
        gravity=truth.gravity,
    )
    simulator = build_simulator(model, accuracy=_ACCURACY)
    simulator.get_mutable_integrator().set_maximum_step_size(_STEP_S)
    context = simulator.get_mutable_context()
    context.SetTime(-_SETTLE_S)
    q = equilibrium(tree, truth, seat, reference.q[0])
    model.plant.SetPositions(model.plant_context(context), q)
    motion = _advance(simulator, name, float(reference.times[-1]), progress)
    return _recorded(name, tree, truth, seat, controller, motion)


def equilibrium(
    tree: PlanarTree,
    truth: Truth,
    seat: SeatParameters | None,
    posture: np.ndarray,
) -> np.ndarray:
    """Coordinates (9,) at rest: foot and device give way to the loads.

    Args:
        tree: the coupled model.
        truth: the subject.
        seat: the chair, if there is one.
        posture: (6,) of the rigid model; shank, knee and hip are kept.
    """
    free = np.eye(9)[[1, 2, 6, 7, 8]]
    free[1, 3] = 1.0  # The foot tips under a shank that stays.
    q = np.r_[posture, posture[3:]]
    for _ in range(60):
        trial = q + np.vstack([np.zeros(9), 1e-7 * free])
        rest = np.zeros_like(trial)
        r = tree.inverse_dynamics(trial, rest, rest) - applied(
            tree, truth.contact, truth.bushings, seat, trial, rest
        )
        r = r[:, [1, 2, 6, 7, 8]]
        J = (r[1:] - r[0]).T / 1e-7
        step = np.clip(-np.linalg.solve(J, r[0]), -5e-3, 5e-3)
        q = q + step @ free
        if np.abs(step).max() < 1e-9:
            break
    return q


def _advance(simulator, name, end, progress) -> CubicHermiteSpline:
    """The state (18,) from 0 to `end`, through every step and its slope."""
    system, steps = simulator.get_system(), []

    def note(context):
        time = context.get_time()
        if progress:
            progress.update(f"{name}, {time:.2f} of {end:.2f} s")
        if time >= 0.0:
            slope = system.EvalTimeDerivatives(context).CopyToVector()
            state = context.get_continuous_state_vector().CopyToVector()
            steps.append((time, state, slope))
        return EventStatus.DidNothing()

    simulator.Initialize()
    simulator.AdvanceTo(0.0)
    note(simulator.get_context())
    simulator.set_monitor(note)
    simulator.AdvanceTo(end)
    times, states, slopes = (
        np.array(column) for column in zip(*steps, strict=True)
    )
    _, new = np.unique(times, return_index=True)
    return CubicHermiteSpline(times[new], states[new], slopes[new])


def _recorded(name, tree, truth, seat, controller, motion) -> Simulated:
    end = motion.x[-1]
    times = np.arange(round(end * RATE_HZ) + 1) / RATE_HZ
    state = motion(np.minimum(times, end))
    q, v = state[:, :9], state[:, 9:]
    torque = np.zeros((len(times), 6))
    torque[:, :3] = controller.torques(times, q, v)
    loads = applied(tree, truth.contact, truth.bushings, seat, q, v)
    loads[:, 3:] += torque
    return Simulated(
        name,
        times,
        q,
        v,
        _accelerations(tree, q, v, loads),
        torque,
        ground_wrench(tree, truth.contact, q, v),
        chair_wrench(tree, seat, q, v),
        interaction(tree, truth.bushings, q, v)[0],
        tree,
    )


def _accelerations(tree: PlanarTree, q, v, loads) -> np.ndarray:
    """Accelerations (N, 9) under generalized forces (N, 9).

    From the equations of motion; the slope of the interpolated velocities
    would be off by newtons between steps.
    """
    rest = np.zeros_like(q)
    mass = tree.inverse_dynamics_jacobians(q, rest, rest)[2]
    excess = loads - tree.inverse_dynamics(q, v, rest)
    return np.linalg.solve(mass, excess[:, :, None])[:, :, 0]
