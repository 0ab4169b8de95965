"""True contact of the virtual subject: systems, and functions along a motion.

Cuffs stiffen with deflection and slip under shear; without either they are the
model's bushings. The chair is a cushion under the pelvis, in contact until
seat-off. The foot stands on soles in a frame that is level in quiet standing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import LeafSystem

from drake_exo.contact.bushing import (
    BushingParameters,
    BushingWrench,
    Components,
    bushing_deflection,
    bushing_force,
    bushing_wrench,
)
from drake_exo.contact.hunt_crossley import (
    Constants,
    Law,
    SimbodyConstants,
    SphereWrench,
    hertz_factor,
    sphere_wrench,
)
from drake_exo.contact.parameters import ContactSphere, GroundContact
from drake_exo.contact.scalars import sqrt
from drake_exo.contact.systems import (
    applied_force,
    declare_force_ports,
    opposite_forces,
    planar_poses,
    read_bodies,
)
from drake_exo.files.schema import quantity
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce
from drake_exo.model.assembly import SIDES
from drake_exo.model.planar_tree import PlanarTree


@dataclass(frozen=True)
class Cuff:
    """A bushing with two departures from its law.

    Attributes:
        bushing: the law at small deflection.
        progression: 1/d_0 [1/m]: springs give k d (1 + (d/d_0)^2) along and
            across the limb; 0 for linear ones.
        slip: 1/F_0 [1/N]: the force along the limb never exceeds F_0; 0 for
            cuffs that do not slip.
    """

    bushing: BushingParameters
    progression: float = quantity("1/m", 0.0)
    slip: float = quantity("1/N", 0.0)


def cuff_force(cuff: Cuff, deflection, rate) -> Components:
    """Force of a cuff on the human; its values broadcast with the deflection.

    Args:
        cuff: values of any common shape (...).
        deflection, rate: as from `bushing_deflection`, of shape (...).
    """
    law = cuff.bushing
    linear = bushing_force(
        deflection, rate, law.stiffness, law.damping, law.slip
    )
    more = [
        k * d * (cuff.progression * d) ** 2
        for k, d in zip(cuff.bushing.stiffness, deflection, strict=True)
    ]
    along = linear.tangential + more[0]
    return Components(
        along / sqrt(1.0 + (cuff.slip * along) ** 2),
        linear.normal + more[1],
        linear.rotation,
    )


def _exchanged(cuff: Cuff, poses, motions) -> tuple[Components, BushingWrench]:
    """Force of a cuff on the human, in components and as a world wrench.

    Args:
        cuff: the law.
        poses, motions: of human and device, as in `bushing_deflection`.
    """
    law = cuff.bushing
    deflection, rate = bushing_deflection(
        poses[0], motions[0], poses[1], motions[1], law.origin, law.preload
    )
    force = cuff_force(cuff, deflection, rate)
    return force, bushing_wrench(force, *poses, law.origin, law.preload)


class Cuffs(LeafSystem):
    """Cuffs for a diagram: `build_diagram(..., forces=[Cuffs(...)])`.

    Inputs body_poses and body_spatial_velocities; output spatial_forces.

    Args:
        plant: plant with the links that they join.
        ends: (human link, exoskeleton link) by name.
        cuffs: their laws, by the same names.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        ends: Mapping[str, tuple[str, str]],
        cuffs: Mapping[str, Cuff],
    ):
        super().__init__()
        self.set_name("cuffs")
        self._pairs = [
            tuple(plant.GetBodyByName(link).index() for link in ends[name])
            for name in cuffs
        ]
        self._bodies = [body for pair in self._pairs for body in pair]
        self._cuffs = list(cuffs.values())
        declare_force_ports(self, float, self._calc_spatial_forces)

    def _calc_spatial_forces(self, context, output):
        states = iter(read_bodies(self, context, self._bodies))
        entries = []
        for pair, cuff in zip(self._pairs, self._cuffs, strict=True):
            links = human, device = next(states), next(states)
            motions = human.motion, device.motion
            wrench = _exchanged(cuff, planar_poses(*links), motions)[1]
            entries += opposite_forces(float, pair, links, wrench)
        output.set_value(entries)


def foot_contact(
    law: Law, position, direction, motion, spheres, constants: Constants
) -> SphereWrench:
    """Contact wrench of a sphere on a planar body, or of many.

    Args:
        law: "paper" or "simbody".
        position, direction, motion: of the body, (x, z), (cosine, sine) and
            (v_x, v_z, rate), entries of any common shape (...).
        spheres: values of SPHERE_PARAMETERS, of shapes that broadcast.
        constants: of the law.

    Returns:
        Entries of shape (...).
    """
    stiffness, dissipation, x, z, radius = spheres
    (c, s), (v_x, v_z, rate) = direction, motion
    center_x = position[0] + c * x - s * z
    center_z = position[1] + s * x + c * z
    return sphere_wrench(
        law,
        center_x,
        center_z,
        v_x - rate * (center_z - position[1]),
        v_z + rate * (center_x - position[0]),
        rate,
        stiffness,
        dissipation,
        radius,
        constants,
    )


# The part of the pelvis that sits, in the pelvis link; it and the seat as one.
BUTTOCKS = ContactSphere(2.5e6, 1.0, x=-0.03, z=-0.06, radius=0.07)
_LAW = "simbody"
_CONSTANTS = SimbodyConstants(static_friction=0.6, dynamic_friction=0.6)
_CLEARANCE_M = 0.05


def seat_depth(force: float) -> float:
    """Static indentation [m] of a seat under a vertical force [N]."""
    factor = hertz_factor(_LAW, BUTTOCKS.stiffness, BUTTOCKS.radius)
    return float((force / factor) ** (2.0 / 3.0))


def seat_wrench(seat: float, position, direction, motion) -> SphereWrench:
    """Force of the seat on the pelvis, and the world point where it acts.

    Args:
        seat: height of the unloaded seat above the floor [m].
        position, direction, motion: of the pelvis, (x, z) [m], (cosine, sine)
            and (v_x, v_z, rate); entries of any common shape (...).

    Returns:
        Entries of shape (...).
    """
    sphere, above = BUTTOCKS.in_plane, (position[0], position[1] - seat)
    wrench = foot_contact(_LAW, above, direction, motion, sphere, _CONSTANTS)
    return wrench._replace(point_z=wrench.point_z + seat)


class Seat(LeafSystem):
    """`seat_wrench` for a diagram: `build_diagram(..., forces=[Seat(...)])`.

    Inputs body_poses and body_spatial_velocities; output spatial_forces.

    Args:
        plant: plant with the link pelvis.
        seat: height of the unloaded seat above the floor [m].
    """

    def __init__(self, plant: MultibodyPlant, seat: float):
        super().__init__()
        self.set_name("seat")
        self._pelvis = plant.GetBodyByName("pelvis").index()
        self._seat = seat
        # With the pelvis above this no posture reaches the seat.
        reach = np.hypot(BUTTOCKS.x, BUTTOCKS.z) + BUTTOCKS.radius
        self._clear_z = seat + reach + _CLEARANCE_M
        declare_force_ports(self, float, self._calc_spatial_forces)

    def _calc_spatial_forces(self, context, output):
        pose = self.GetInputPort("body_poses").Eval(context)[int(self._pelvis)]
        if pose.translation()[2] > self._clear_z:
            output.set_value([])
            return
        (pelvis,) = read_bodies(self, context, [self._pelvis])
        *force, x, z = seat_wrench(self._seat, *pelvis)
        output.set_value(
            [applied_force(float, self._pelvis, pelvis, (x, z), force)]
        )


def feet(tree: PlanarTree) -> list[str]:
    """Links that stand on the ground."""
    both = [f"foot_{side}" for side in SIDES]
    return both if both[0] in tree.names else [tree.root]


def ground_wrench(
    tree: PlanarTree, contact: GroundContact, q, v, foot: str | None = None
) -> PlanarWrench:
    """Ground reaction (N samples) on a foot, the root by default."""
    position, angle, motion = tree.link_motion(q, v, foot or tree.root)
    wrench = foot_contact(
        contact.law,
        position[:, :, None],
        np.array([np.cos(angle), np.sin(angle)])[:, :, None],
        motion[:, :, None],
        np.array([s.in_plane for s in contact.spheres.values()]).T[:, None],
        contact.constants,
    )
    return _total(wrench)


def chair_wrench(tree: PlanarTree, seat: float | None, q, v) -> PlanarWrench:
    """Wrench of the chair (N samples) on the pelvis; zero without one."""
    if seat is None:
        return PlanarWrench(np.zeros((len(q), 2)), np.zeros(len(q)))
    position, angle, motion = tree.link_motion(q, v, "pelvis")
    direction = np.array([np.cos(angle), np.sin(angle)])
    wrench = seat_wrench(seat, position, direction, motion)
    return _total(type(wrench)(*(w[:, None] for w in wrench)))


def interaction(
    tree: PlanarTree, cuffs: dict[str, Cuff], q, v
) -> tuple[dict[str, CuffForce], dict[str, PlanarWrench]]:
    """Forces of the cuffs along a motion of N samples.

    Returns:
        Cuff -> force on the human by component (N,), and cuff -> the same as a
        wrench about the world's origin.
    """
    forces, wrenches = {}, {}
    for name, cuff in cuffs.items():
        links = [tree.link_motion(q, v, body) for body in tree.cuffs[name]]
        poses = [(*position, angle) for position, angle, _ in links]
        force, w = _exchanged(cuff, poses, [motion for *_, motion in links])
        # The law's moments are toes-up positive, M_y is the opposite.
        wrenches[name] = PlanarWrench(
            np.column_stack([w.force_x, w.force_z]),
            w.point_z * w.force_x - w.point_x * w.force_z - w.moment,
        )
        forces[name] = CuffForce(force.normal, force.tangential, force.rotation)
    return forces, wrenches


def applied(
    tree: PlanarTree,
    contact: GroundContact,
    cuffs: dict[str, Cuff],
    seat: float | None,
    q,
    v,
) -> np.ndarray:
    """Generalized forces (N, nq) of ground, chair and cuffs together."""
    parts = [
        (foot, ground_wrench(tree, contact, q, v, foot)) for foot in feet(tree)
    ]
    parts.append(("pelvis", chair_wrench(tree, seat, q, v)))
    for name, w in interaction(tree, cuffs, q, v)[1].items():
        human, device = tree.cuffs[name]
        parts += [(human, w), (device, w.scaled(-1.0))]
    return sum(tree.wrench_on_body(q, body, w.array) for body, w in parts)


def _total(wrench) -> PlanarWrench:
    """Sum of sphere wrenches over the last axis, about the origin."""
    return PlanarWrench.of(np.stack(wrench.about_origin, axis=1).sum(axis=-1))


_DIFFERENCE = 1e-6
_NEWTON_STEPS = 60
_LARGEST_STEP = 2e-3  # m or rad
_FIRST_DEPTH_M = 5e-3
_PASSES = 3


def resting_foot(
    tree: PlanarTree, contact: GroundContact, load: np.ndarray, cop_m: float
) -> np.ndarray:
    """Foot coordinates x = 0, z, pitch (n, 3) under vertical loads (n,) [N].

    Args:
        tree: a model whose root is that foot.
        contact: of the foot with the ground.
        load: vertical force at rest, (n,) [N].
        cop_m: centre of pressure in front of the ankle.
    """
    q = np.zeros((len(load), tree.num_positions))
    spheres = contact.spheres.values()
    q[:, 1] = np.mean([s.radius - s.z for s in spheres]) - _FIRST_DEPTH_M
    wanted = np.column_stack([load, -cop_m * load])

    def excess(q):
        w = ground_wrench(tree, contact, q, np.zeros_like(q))
        return np.column_stack([w.force[:, 1], w.moment]) - wanted

    for _ in range(_NEWTON_STEPS):
        r, J = excess(q), np.empty((len(load), 2, 2))
        for k in (0, 1):
            moved = q.copy()
            moved[:, 1 + k] += _DIFFERENCE
            J[:, :, k] = (excess(moved) - r) / _DIFFERENCE
        step = -np.linalg.solve(J, r[:, :, None])[:, :, 0]
        q[:, 1:3] += np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        if np.abs(step).max() < 1e-9:
            break
    return q[:, :3]


def levelled(
    tree: PlanarTree,
    contact: GroundContact,
    weight: float,
    cop_m: float,
    ankle_height: float,
) -> GroundContact:
    """The same soles in a foot frame that is level in quiet standing.

    Markers give that frame, so places in truth and measurement are comparable.
    """
    for _ in range(_PASSES):
        foot = resting_foot(tree, contact, np.array([weight]), cop_m)
        _, z, pitch = foot[0]
        c, s = np.cos(pitch), np.sin(pitch)
        spheres = {
            name: replace(
                sphere,
                x=float(c * sphere.x - s * sphere.z),
                z=float(z + s * sphere.x + c * sphere.z - ankle_height),
            )
            for name, sphere in contact.spheres.items()
        }
        contact = replace(contact, spheres=spheres)
    return contact
