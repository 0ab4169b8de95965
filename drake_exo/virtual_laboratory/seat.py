"""The chair: a cushion under the pelvis, felt until seat-off."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import LeafSystem

from drake_exo.forces.contact_constants import SimbodyConstants
from drake_exo.forces.contact_system import foot_contact, ground_reaction
from drake_exo.forces.hunt_crossley import SphereWrench, hertz_factor
from drake_exo.forces.planar import (
    applied_force,
    declare_body_inputs,
    declare_force_output,
    read_bodies,
    to_body,
)

_LAW = "simbody"
_CLEARANCE_M = 0.05


@dataclass(frozen=True)
class SeatParameters:
    """A horizontal seat and the part of the pelvis that sits on it.

    Attributes:
        height_m: of the unloaded seat above the floor.
        x_m, z_m: centre of the buttocks' sphere in the pelvis link.
        radius_m: of that sphere.
        modulus_n_m2, dissipation_s_m: of simbody's law, both sides together.
        constants: friction and smoothing.
    """

    height_m: float
    x_m: float = -0.03
    z_m: float = -0.06
    radius_m: float = 0.07
    modulus_n_m2: float = 2.5e6
    dissipation_s_m: float = 1.0
    constants: SimbodyConstants = field(
        default_factory=lambda: SimbodyConstants(
            static_friction=0.6, dynamic_friction=0.6
        )
    )

    def depth(self, force: float) -> float:
        """Static indentation [m] under a vertical force [N]."""
        factor = hertz_factor(_LAW, self.modulus_n_m2, self.radius_m)
        return float((force / factor) ** (2.0 / 3.0))


def seat_wrench(
    seat: SeatParameters, position, direction, motion
) -> SphereWrench:
    """Force of the seat on the pelvis, and the world point where it acts.

    Args:
        seat: the chair.
        position, direction, motion: of the pelvis, (x, z) [m], (cosine, sine)
            and (v_x, v_z, rate); entries of any common shape (...).

    Returns:
        Entries of shape (...).
    """
    sphere = (
        seat.x_m,
        seat.z_m,
        seat.radius_m,
        seat.modulus_n_m2,
        seat.dissipation_s_m,
    )
    above = (position[0], position[1] - seat.height_m)
    wrench = foot_contact(
        _LAW, above, direction, motion, sphere, seat.constants
    )
    return wrench._replace(point_z=wrench.point_z + seat.height_m)


class Seat(LeafSystem):
    """`seat_wrench` for a diagram: `build_diagram(..., forces=[Seat(...)])`.

    Inputs body_poses and body_spatial_velocities; outputs spatial_forces and
    seat_reaction: F_x, F_z [N] on the pelvis and M_y = z F_x - x F_z about
    the world's origin [N m].

    Args:
        pelvis: index of the link in the plant.
        seat: the chair.
    """

    def __init__(self, pelvis: BodyIndex, seat: SeatParameters):
        super().__init__()
        self.set_name("seat")
        self._pelvis = pelvis
        self._seat = seat
        # From there up no posture reaches the seat: nothing to evaluate.
        reach = np.hypot(seat.x_m, seat.z_m) + seat.radius_m
        self._clear_z = seat.height_m + reach + _CLEARANCE_M
        declare_body_inputs(self, float)
        declare_force_output(self, float, self._calc_spatial_forces)
        self.DeclareVectorOutputPort("seat_reaction", 3, self._calc_reaction)

    def _evaluate(self, context):
        bodies = read_bodies(self, context, [self._pelvis])
        position, direction, motion = (array[:, 0] for array in bodies)
        wrench = seat_wrench(self._seat, position, direction, motion)
        return position, direction, wrench

    def _calc_spatial_forces(self, context, output):
        pose = self.GetInputPort("body_poses").Eval(context)[int(self._pelvis)]
        if pose.translation()[2] > self._clear_z:
            output.set_value([])
            return
        position, direction, wrench = self._evaluate(context)
        point = to_body(position, direction, wrench.point_x, wrench.point_z)
        force = (wrench.force_x, wrench.force_z)
        output.set_value([applied_force(float, self._pelvis, point, force)])

    def _calc_reaction(self, context, output):
        wrench = self._evaluate(context)[2]
        output.SetFromVector(
            ground_reaction(SphereWrench(*(np.array([w]) for w in wrench)))
        )
