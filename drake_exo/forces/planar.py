"""Between Drake's spatial quantities and the sagittal plane.

A planar pose is (x, z, angle), a planar motion (v_x, v_z, rate): x forward,
z up, angle toes-up positive (counter-clockwise seen from the right, about
world −y).
"""

import functools

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform_
from pydrake.multibody.math import SpatialForce_, SpatialVelocity_
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.systems.framework import LeafSystem

from drake_exo.forces.scalars import any_scalar, arctan2


def declare_body_inputs(system: LeafSystem, T) -> None:
    """Declares the plant's "body_poses" and "body_spatial_velocities"."""
    system.DeclareAbstractInputPort(
        "body_poses", AbstractValue.Make([RigidTransform_[T]()])
    )
    system.DeclareAbstractInputPort(
        "body_spatial_velocities", AbstractValue.Make([SpatialVelocity_[T]()])
    )


def declare_force_output(system: LeafSystem, T, calc) -> None:
    """Declares "spatial_forces" for a plant's applied_spatial_force port."""
    entry = ExternallyAppliedSpatialForce_[T]
    system.DeclareAbstractOutputPort(
        "spatial_forces", lambda: AbstractValue.Make([entry()]), calc
    )


def read_bodies(system: LeafSystem, context, bodies) -> tuple:
    """Positions, (cos, sin) and motions of bodies, from the ports above.

    Args:
        system: that declared the ports.
        context: of it.
        bodies: n body indices.

    Returns:
        Arrays (2, n) of x, z [m]; (2, n) of cosine and sine of the angle;
        (3, n) of v_x, v_z [m/s] and rate [rad/s].
    """
    poses = system.GetInputPort("body_poses").Eval(context)
    velocities = system.GetInputPort("body_spatial_velocities").Eval(context)
    positions, directions, motions = [], [], []
    for body in bodies:
        X_WB, V_WB = poses[int(body)], velocities[int(body)]
        p_WB, R_WB = X_WB.translation(), X_WB.rotation().matrix()
        v_WB, w_WB = V_WB.translational(), V_WB.rotational()
        positions.append((p_WB[0], p_WB[2]))
        directions.append((R_WB[0, 0], R_WB[2, 0]))
        motions.append((v_WB[0], v_WB[2], -w_WB[1]))
    return tuple(np.array(rows).T for rows in (positions, directions, motions))


@any_scalar
def to_world(position, direction, x, z):
    """World (x, z) of a point given in a body's axes.

    Args:
        position, direction: (x, z) and (cosine, sine) of the body.
        x, z: of the point in the body.
    """
    c, s = direction
    return position[0] + c * x - s * z, position[1] + s * x + c * z


@any_scalar
def to_body(position, direction, x, z):
    """Inverse of `to_world`."""
    c, s = direction
    dx, dz = x - position[0], z - position[1]
    return c * dx + s * dz, c * dz - s * dx


@any_scalar
def relative_angles(first, second):
    """Angles of two bodies that never jump against each other.

    Args:
        first, second: (cosine, sine) of each.

    Returns:
        Angle of the first in (−π, π], and that plus the second's relative
        angle in (−π, π], so that their difference has no jump at ±π.
    """
    angle = arctan2(first[1], first[0])
    turn = arctan2(
        second[1] * first[0] - second[0] * first[1],
        second[0] * first[0] + second[1] * first[1],
    )
    return angle, angle + turn


@functools.cache
def _force_types(T) -> tuple:
    """Classes of an entry and of its force; looking them up is slow."""
    return ExternallyAppliedSpatialForce_[T], SpatialForce_[T]


def applied_force(T, body, point, force, moment=0.0):
    """One entry of a plant's "applied_spatial_force" port.

    Args:
        T: scalar type.
        body: index of the body that receives the force.
        point: (x, z) where it acts, in the body's axes [m].
        force: (F_x, F_z) in the world [N].
        moment: toes-up positive (about world −y) [N·m].
    """
    Entry, Force = _force_types(T)
    entry = Entry()
    entry.body_index = body
    entry.p_BoBq_B = np.array([point[0], 0.0, point[1]])
    entry.F_Bq_W = Force(
        tau=np.array([0.0, -moment, 0.0]),
        f=np.array([force[0], 0.0, force[1]]),
    )
    return entry
