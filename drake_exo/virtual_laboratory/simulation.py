"""One movement of the virtual subject, simulated as a Drake diagram.

Plant, foot-ground contact, cuffs and chair are systems of the diagram; the
subject is a controller that follows its plan. What a laboratory would measure
comes out of the simulation, not out of the plan.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import EventStatus
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from drake_exo.contact.diagram import build_diagram, build_simulator
from drake_exo.files.output import Progress
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant
from drake_exo.virtual_laboratory.control import (
    DeviceController,
    SubjectController,
    controller,
)
from drake_exo.virtual_laboratory.forces import (
    Cuffs,
    Seat,
    SeatParameters,
    applied,
    chair_wrench,
    ground_wrench,
    interaction,
)
from drake_exo.virtual_laboratory.plan import Reference
from drake_exo.virtual_laboratory.truth import Truth

RATE_HZ = 1000.0
PASSIVE = (0.0, 0.0, 0.0)
_SETTLE_S = 0.4
_ACCURACY = 1e-3
_STEP_S = 0.05


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


def simulate(
    name: str,
    truth: Truth,
    reference: Reference,
    seat: SeatParameters | None = None,
    help_share: tuple[float, float, float] = PASSIVE,
    progress: Progress | None = None,
    done: int | None = None,
) -> Simulated:
    """Let the subject follow its plan.

    Args:
        name: of the trial.
        truth: the subject.
        reference: its plan.
        seat: the chair, if there is one.
        help_share: of the gravity torque at ankle, knee and hip, which the
            exoskeleton bears.
        progress: told of every step.
        done: movements simulated before.
    """
    plant = build_plant(
        "coupled", truth.human, truth.exoskeleton, gravity=truth.gravity
    )
    tree = PlanarTree.from_plant(plant)
    subject, device = _controllers(truth, reference, help_share)
    model = build_diagram(
        "coupled",
        truth.human,
        truth.exoskeleton,
        contact=truth.contact,
        bushings={},
        controller=controller(subject, device),
        forces=_forces(plant, truth, seat),
        gravity=truth.gravity,
    )
    simulator = build_simulator(model, accuracy=_ACCURACY)
    simulator.get_mutable_integrator().set_maximum_step_size(_STEP_S)
    context = simulator.get_mutable_context()
    context.SetTime(-_SETTLE_S)
    q = equilibrium(tree, truth, seat, reference.q[0])
    model.plant.SetPositions(model.plant_context(context), q)
    end = float(reference.times[-1])

    def tell(time: float) -> None:
        if progress:
            progress.update(f"{name}, {time:.2f} of {end:.2f} s", done)

    motion = _advance(simulator, end, tell)
    return _recorded(name, tree, truth, seat, (subject, device), motion)


def _controllers(truth, reference, help_share):
    rigid = build_plant(
        "rigid", truth.human, truth.exoskeleton, gravity=truth.gravity
    )
    device = DeviceController(
        PlanarTree.from_plant(rigid), help_share, truth.friction
    )
    help_expected = device.help(reference.q[:, 3:], reference.ground[:, 1])
    return SubjectController(reference, help_expected), device


def _forces(plant, truth: Truth, seat: SeatParameters | None):
    """Cuffs and chair as systems."""

    def link(name):
        return plant.GetBodyByName(name).index()

    pairs = {name: (link(name), link(f"exo_{name}")) for name in truth.cuffs}
    cuffs = Cuffs(pairs, truth.cuffs)
    return [cuffs] if seat is None else [cuffs, Seat(link("pelvis"), seat)]


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
            tree, truth.contact, truth.cuffs, seat, trial, rest
        )
        r = r[:, [1, 2, 6, 7, 8]]
        J = (r[1:] - r[0]).T / 1e-7
        step = np.clip(-np.linalg.solve(J, r[0]), -5e-3, 5e-3)
        q = q + step @ free
        if np.abs(step).max() < 1e-9:
            break
    return q


def _advance(simulator, end, tell):
    """Positions and velocities (9,) as functions of time from 0 to `end`.

    Velocities are splines through the steps' ends alone: slopes there carry
    what is left of the stiff foot's transients, which the contact's damping
    would turn into noise of the forces.
    """
    steps = []

    def note(context):
        time = context.get_time()
        tell(time)
        if time >= 0.0:
            state = context.get_continuous_state_vector().CopyToVector()
            steps.append((time, state))
        return EventStatus.DidNothing()

    simulator.Initialize()
    simulator.AdvanceTo(0.0)
    note(simulator.get_context())
    simulator.set_monitor(note)
    simulator.AdvanceTo(end)
    times, states = (np.array(column) for column in zip(*steps, strict=True))
    times, new = np.unique(times, return_index=True)
    q, v = states[new, :9], states[new, 9:]
    return CubicHermiteSpline(times, q, v), CubicSpline(times, v)


def _recorded(name, tree, truth, seat, controllers, motion) -> Simulated:
    end = motion[0].x[-1]
    times = np.arange(round(end * RATE_HZ) + 1) / RATE_HZ
    q, v = (spline(np.minimum(times, end)) for spline in motion)
    ground = ground_wrench(tree, truth.contact, q, v)
    subject, device = controllers
    torque = np.hstack(
        [
            subject.torques(times, q, v),
            device.torques(q[:, 6:], v[:, 6:], ground.force[:, 1]),
        ]
    )
    loads = applied(tree, truth.contact, truth.cuffs, seat, q, v)
    loads[:, 3:] += torque
    return Simulated(
        name,
        times,
        q,
        v,
        _accelerations(tree, q, v, loads),
        torque,
        ground,
        chair_wrench(tree, seat, q, v),
        interaction(tree, truth.cuffs, q, v)[0],
        tree,
    )


def _accelerations(tree: PlanarTree, q, v, loads) -> np.ndarray:
    """Accelerations (N, 9) under generalized forces (N, 9).

    From the equations of motion, so that truth obeys them at every sample.
    """
    rest = np.zeros_like(q)
    mass = tree.inverse_dynamics_jacobians(q, rest, rest)[2]
    excess = loads - tree.inverse_dynamics(q, v, rest)
    return np.linalg.solve(mass, excess[:, :, None])[:, :, 0]
