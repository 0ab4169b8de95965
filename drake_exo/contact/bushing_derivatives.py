"""First derivatives of the bushing, analytic, for whole arrays.

The generalised force of a bushing is −(∂d/∂q)ᵀ F, so the rows of the
deflection's derivatives also serve to apply a given bushing force. They may
be evaluated with complex arrays: a complex step then gives second ones.
"""

from typing import NamedTuple

import numpy as np

from drake_exo.contact.bushing import Components, bushing_deflection

# Order of the derivatives' second axis.
DEFLECTION_INPUTS = (
    "human_x",
    "human_z",
    "human_angle",
    "human_velocity_x",
    "human_velocity_z",
    "human_rate",
    "exoskeleton_x",
    "exoskeleton_z",
    "exoskeleton_angle",
    "exoskeleton_velocity_x",
    "exoskeleton_velocity_z",
    "exoskeleton_rate",
    "origin_x",
    "origin_z",
)
FORCE_INPUTS = (
    *DEFLECTION_INPUTS,
    "tangential_stiffness",
    "normal_stiffness",
    "rotational_stiffness",
    "tangential_damping",
    "normal_damping",
    "rotational_damping",
)


class BushingForceDerivatives(NamedTuple):
    """Force on the human and its derivatives, with what they came from.

    Shapes: (3, ...) for values, (3, 14, ...) for the derivatives of
    deflection and rate by DEFLECTION_INPUTS, (3, 20, ...) for those of the
    force by FORCE_INPUTS. First axis as in `bushing.COMPONENTS`.
    """

    force: np.ndarray
    d_force: np.ndarray
    deflection: np.ndarray
    rate: np.ndarray
    d_deflection: np.ndarray
    d_rate: np.ndarray


def bushing_deflection_derivatives(
    human_pose,
    human_motion,
    exoskeleton_pose,
    exoskeleton_motion,
    origin,
    preload=(0.0, 0.0, 0.0),
) -> tuple[Components, Components, np.ndarray, np.ndarray]:
    """`bushing_deflection` and its derivatives.

    Arguments as there, float or complex.

    Returns:
        (deflection, rate, d_deflection, d_rate), derivatives of shape
        (3, 14, ...) by DEFLECTION_INPUTS.
    """
    deflection, rate = bushing_deflection(
        human_pose,
        human_motion,
        exoskeleton_pose,
        exoskeleton_motion,
        origin,
        preload,
    )
    c, s = np.cos(human_pose[2]), np.sin(human_pose[2])
    turn = exoskeleton_pose[2] - human_pose[2]
    c_t, s_t = np.cos(turn), np.sin(turn)
    a_x, a_z = origin[0] + preload[0], origin[1] + preload[1]
    # F2's origin seen from the exoskeleton link and from the human one, both
    # in the axes of the human link.
    s_x, s_z = c_t * a_x - s_t * a_z, s_t * a_x + c_t * a_z
    f_x, f_z = deflection.normal + origin[0], deflection.tangential + origin[1]
    by_human = ((s, -c, -f_x), (-c, -s, f_z), (0.0, 0.0, -1.0))
    by_exoskeleton = ((-s, c, s_x), (c, s, -s_z), (0.0, 0.0, 1.0))
    by_origin = ((s_t, c_t - 1.0), (c_t - 1.0, -s_t), (0.0, 0.0))
    shape = np.broadcast_shapes(*(np.shape(entry) for entry in rate))
    dtype = np.result_type(*deflection, *rate)
    d_deflection = np.zeros((3, 14, *shape), dtype=dtype)
    d_rate = np.zeros((3, 14, *shape), dtype=dtype)
    _fill(d_deflection[:, 0:3], by_human)
    _fill(d_deflection[:, 6:9], by_exoskeleton)
    _fill(d_deflection[:, 12:14], by_origin)
    # A rate is linear in the velocities, with the deflection's derivatives.
    d_rate[:, 3:6] = d_deflection[:, 0:3]
    d_rate[:, 9:12] = d_deflection[:, 6:9]
    w_h = human_motion[2]
    w = exoskeleton_motion[2] - w_h
    d_rate[0, 0], d_rate[0, 1] = w_h * c, w_h * s
    d_rate[1, 0], d_rate[1, 1] = w_h * s, -w_h * c
    d_rate[:2, 6:8] = -d_rate[:2, 0:2]
    d_rate[0, 8], d_rate[1, 8] = -w * s_z, -w * s_x
    # The human's angle only turns the axes in which the rate is seen.
    d_rate[0, 2], d_rate[1, 2] = -rate.normal, rate.tangential
    d_rate[0, 12], d_rate[0, 13] = w * c_t, -w * s_t
    d_rate[1, 12], d_rate[1, 13] = -w * s_t, -w * c_t
    return deflection, rate, d_deflection, d_rate


def _fill(target, rows) -> None:
    """Copies nested rows of broadcastable entries into (rows, columns, ...)."""
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            target[i, j] = entry


def bushing_force_derivatives(
    human_pose,
    human_motion,
    exoskeleton_pose,
    exoskeleton_motion,
    origin,
    stiffness,
    damping,
    preload=(0.0, 0.0, 0.0),
) -> BushingForceDerivatives:
    """Force on the human and its derivatives by FORCE_INPUTS.

    Arguments as in `bushing_deflection` and `bushing_force`.
    """
    deflection, rate, d_deflection, d_rate = bushing_deflection_derivatives(
        human_pose,
        human_motion,
        exoskeleton_pose,
        exoskeleton_motion,
        origin,
        preload,
    )
    shape = d_rate.shape[2:]
    dtype = np.result_type(d_rate, *stiffness, *damping)
    force = np.empty((3, *shape), dtype=dtype)
    d_force = np.zeros((3, len(FORCE_INPUTS), *shape), dtype=dtype)
    for i in range(3):
        k, b = np.asarray(stiffness[i]), np.asarray(damping[i])
        force[i] = k * deflection[i] + b * rate[i]
        np.multiply(b, d_rate[i], out=d_force[i, :14])
        # Deflection depends on poses and origin only.
        for columns in (slice(0, 3), slice(6, 9), slice(12, 14)):
            d_force[i, columns] += k * d_deflection[i, columns]
        d_force[i, 14 + i] = deflection[i]
        d_force[i, 17 + i] = rate[i]
    return BushingForceDerivatives(
        force,
        d_force,
        np.array(np.broadcast_arrays(*deflection, force[0])[:3]),
        np.array(np.broadcast_arrays(*rate, force[0])[:3]),
        d_deflection,
        d_rate,
    )
