"""One movement of the virtual subject, simulated as a Drake diagram.

Plant, foot-ground contact, cuffs and chair are systems of the diagram; the
subject is a controller that follows its plan. Measurements are made of the
simulated motion, which differs from the plan.
"""

from collections.abc import Callable
from functools import reduce
from operator import add

import numpy as np

from drake_exo.contact.diagram import build_diagram, integrate
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory.forces import (
    Cuffs,
    Seat,
    applied,
    chair_wrench,
    feet,
    ground_wrench,
    interaction,
)
from drake_exo.virtual_laboratory.plan import (
    DeviceController,
    SubjectController,
    controller,
)
from drake_exo.virtual_laboratory.truth import Truth

RATE_HZ = 1000.0
_SETTLE_S = 0.4
_ASTRAY_M = 0.1  # deviation of the pelvis from its plan that is a stumble


def simulate(
    name: str,
    truth: Truth,
    reference: Trial,
    seat: float | None = None,
    help_share: tuple[float, ...] = (),
    span: tuple[float, float] = (0.0, 1.0),
    tell: Callable[[str], None] | None = None,
    *,
    walker: SubjectController | None = None,
) -> Trial:
    """Simulate the subject following its plan; the true motion at 1000 Hz.

    Args:
        name: of the trial.
        truth: the subject.
        reference: its plan.
        seat: height of the chair's seat [m], if there is one.
        help_share: share of the gravity torque at ankle, knee and hip that the
            exoskeleton gives; empty if it is passive.
        span: begin and end of the movement for the exoskeleton's design [s].
        tell: called at every step with the progress in words.
        walker: controller of a walk, in motion from the start; by default the
            subject stands on both feet and settles first.

    Raises:
        InputError: the walker stumbles, or the integrator fails.
    """
    names = truth.model.coordinates
    device = DeviceController(
        truth.model, help_share, truth.friction, truth.design, span
    )
    subject = walker or _follower(truth.model, reference, device)
    plant, ends = truth.model.plant(), truth.model.tree.cuffs
    built = build_diagram(
        truth.model,
        ContactModel(truth.contact),
        controller=controller(names, subject, device),
        forces=[
            Cuffs(plant, ends, truth.cuffs),
            *([] if seat is None else [Seat(plant, seat)]),
        ],
    )
    context = built.diagram.CreateDefaultContext()
    plant_context = built.plant_context(context)
    if truth.model.assembly.human.sides:  # settles on its feet by itself
        q = names.aligned(reference.q[:1])[0]
    else:
        q = equilibrium(truth, seat, reference.q[0])
    built.plant.SetPositions(plant_context, q)
    if walker is None:
        context.SetTime(-_SETTLE_S)
    else:
        v = names.aligned(reference.v[:1])[0]
        built.plant.SetVelocities(plant_context, v)
    end = float(reference.times[-1])

    def watch(time: float, state: np.ndarray) -> None:
        if walker is not None:
            off, *_ = walker.off(np.float64(time), *np.split(state, 2))
            if np.hypot(*off[:2]) > _ASTRAY_M:
                raise InputError(
                    f"{name}: the walker stumbles after {time:.1f} s; give "
                    "another seed, or a lighter device"
                )
        if tell is not None:
            now = max(time, 0.0)  # negative while settling
            tell(f"{name}, {now:.2f} of {end:.2f} s")

    motion = integrate(built.diagram, context, end, watch)
    if motion.t_max < end:
        raise InputError(
            f"{name}: the movement cannot be simulated after "
            f"{motion.t_max:.2f} s; give another seed"
        )
    return _recorded(name, truth, seat, (subject, device), motion)


def _follower(
    model: Model, reference: Trial, device: DeviceController
) -> SubjectController:
    """Controller that leaves to the device the help expected on the plan."""
    joints = model.rigid.coordinates.joint_columns
    angles, rates = reference.q[:, joints], reference.v[:, joints]
    loads = reference.ground.force_z
    helped = device.help(reference.times, angles, rates, loads)
    return SubjectController(model.coordinates, reference, helped)


def equilibrium(
    truth: Truth, seat: float | None, posture: np.ndarray
) -> np.ndarray:
    """Coordinates (nq,) in static equilibrium of foot, device and loads.

    Args:
        truth: the subject.
        seat: height of the chair's seat [m], if there is one.
        posture: (6,) of the rigid model; shank's attitude, knee, hip are kept.
    """
    tree, names = truth.model.tree, truth.model.coordinates
    _, z, pitch = names.root_columns
    given = np.r_[z, pitch, names.device_columns]
    free = np.eye(len(names))[given]
    # The ankle follows the foot's pitch, so that the shank keeps its attitude.
    free[1, names.index(names.human[0])] = 1.0
    q = names.aligned(posture[None])[0]
    for _ in range(60):
        trial = q + np.vstack([np.zeros_like(q), 1e-7 * free])
        rest = np.zeros_like(trial)
        r = tree.inverse_dynamics(trial, rest, rest) - applied(
            tree, truth.contact, truth.cuffs, seat, trial, rest
        )
        r = r[:, given]
        J = (r[1:] - r[0]).T / 1e-7
        step = np.clip(-np.linalg.solve(J, r[0]), -5e-3, 5e-3)
        q = q + step @ free
        if np.abs(step).max() < 1e-9:
            break
    return q


def _recorded(name, truth: Truth, seat, controllers, motion) -> Trial:
    tree, names = truth.model.tree, truth.model.coordinates
    end = motion.t_max
    times = np.arange(round(end * RATE_HZ) + 1) / RATE_HZ
    q, v = np.split(motion(np.minimum(times, end)).T, 2, axis=1)
    stood = {f: ground_wrench(tree, truth.contact, q, v, f) for f in feet(tree)}
    ground = reduce(add, stood.values())
    subject, device = controllers
    loads = np.column_stack([wrench.force_z for wrench in stood.values()])
    exo = names.device_columns
    torque = names.joined(
        subject.torques(times, q, v, loads),
        device.torques(times, q[:, exo], v[:, exo], ground.force_z),
    )
    loads = applied(tree, truth.contact, truth.cuffs, seat, q, v)
    loads[:, names.joint_columns] += torque
    sided = {foot.removeprefix("foot_"): w for foot, w in stood.items()}
    return Trial(
        name,
        names,
        times,
        q,
        v,
        _accelerations(tree, q, v, loads),
        ground,
        source="simulated",
        feet={} if len(stood) == 1 else sided,
        moments=torque,
        cuffs=interaction(tree, truth.cuffs, q, v)[0],
        chair=chair_wrench(tree, seat, q, v),
        mass_kg=truth.human.mass_kg,
    )


def _accelerations(tree: PlanarTree, q, v, loads) -> np.ndarray:
    """Accelerations (N, nq) under generalized forces (N, nq).

    Taken from the equations of motion, which the truth thus satisfies exactly.
    """
    rest = np.zeros_like(q)
    mass = tree.inverse_dynamics_jacobians(q, rest, rest)[2]
    excess = loads - tree.inverse_dynamics(q, v, rest)
    return np.linalg.solve(mass, excess[:, :, None])[:, :, 0]
