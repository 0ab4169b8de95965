"""First derivatives of the contact laws, analytic, for whole float arrays.

The collocation evaluates every sphere at every node in each iteration, so
intermediate results are shared and each tanh, exp and root is taken once.
Tests hold these functions to complex-step derivatives of
`hunt_crossley.sphere_force`.
"""

from typing import NamedTuple

import numpy as np

from drake_exo.forces.contact_constants import (
    Constants,
    PaperConstants,
    SimbodyConstants,
)
from drake_exo.forces.hunt_crossley import (
    MIN_GATE_DISSIPATION,
    SLOPE_LENGTH,
    SLOPE_OFFSET,
    Law,
    SphereWrench,
    checked_constants,
    contact_arm,
    hertz_factor,
    release_rate,
)

# Order of the first axis of the derivatives.
FORCE_INPUTS = (
    "indentation",
    "rate",
    "slip_velocity",
    "stiffness",
    "dissipation",
    "radius",
)
WRENCH_INPUTS = (
    "center_x",
    "center_z",
    "velocity_x",
    "velocity_z",
    "pitch_rate",
    "stiffness",
    "dissipation",
    "radius",
)


class SphereForceDerivatives(NamedTuple):
    """Forces [N] of shape (...) and derivatives of shape (6, ...).

    First axis as in FORCE_INPUTS.
    """

    normal: np.ndarray
    friction: np.ndarray
    d_normal: np.ndarray
    d_friction: np.ndarray


def _gate(sharpness, value):
    """Gate ½ + ½ tanh and its derivative with respect to `value`."""
    tanh = np.tanh(sharpness * value)
    return 0.5 + 0.5 * tanh, 0.5 * sharpness * (1.0 - tanh * tanh)


def _dissipation(x_dot, c, sharpness, shifted, d_shifted_dc):
    """Factor (1 + 3/2 c ẋ)·gate with derivatives by rate and dissipation."""
    gate, d_gate = _gate(sharpness, shifted)
    factor = 1.0 + (1.5 * c) * x_dot
    by_gate = factor * d_gate
    d_rate = (1.5 * c) * gate + by_gate
    d_c = 1.5 * x_dot * gate + by_gate * d_shifted_dc
    return factor * gate, d_rate, d_c


def _shifted_rate(x_dot, c):
    """ẋ + 2/(3c) and its derivative by c, zero where c is clamped."""
    shift = release_rate(c)
    d_shift = np.where(c > MIN_GATE_DISSIPATION, -1.5 * shift * shift, 0.0)
    return x_dot + shift, d_shift


def _paper_normal(x, x_dot, k, c, r, p: PaperConstants, d_normal):
    root = np.sqrt(x * x + p.indentation_smoothing**2)
    x_plus = 0.5 * (x + root)
    sharp_hertz = hertz_factor("paper", k, r) * (x_plus * np.sqrt(x_plus))
    gate, d_gate = _gate(p.hertz_sharpness, x)
    hertz = sharp_hertz * gate
    shifted, d_shift = _shifted_rate(x_dot, c)
    damping, by_rate, by_c = _dissipation(
        x_dot, c, p.damping_sharpness, shifted, d_shift
    )
    growth = p.slope_force * np.exp((x - SLOPE_OFFSET) / SLOPE_LENGTH)
    rise, d_rise = _gate(p.slope_sharpness, x)
    open_, d_open = _gate(p.slope_rate_sharpness, shifted)
    slope = growth * rise
    force = hertz * damping
    d_normal[0] = damping * (1.5 * hertz / root + sharp_hertz * d_gate)
    d_normal[0] += open_ * (slope / SLOPE_LENGTH + growth * d_rise)
    d_normal[1] = hertz * by_rate + slope * d_open
    d_normal[3] = 1.5 * force / k
    d_normal[4] = hertz * by_c + slope * d_open * d_shift
    d_normal[5] = 0.5 * force / r
    return force + slope * open_


def _simbody_normal(x, x_dot, modulus, c, r, p: SimbodyConstants, d_normal):
    square = x * x + p.constant_contact_force
    root = np.sqrt(square)
    sharp_hertz = hertz_factor("simbody", modulus, r) * (root * np.sqrt(root))
    gate, d_gate = _gate(p.hertz_smoothing, x)
    hertz = sharp_hertz * gate
    shifted, d_shift = _shifted_rate(x_dot, c)
    damping, by_rate, by_c = _dissipation(
        x_dot, c, p.hunt_crossley_smoothing, shifted, d_shift
    )
    force = hertz * damping
    d_normal[0] = damping * (1.5 * x / square * hertz + sharp_hertz * d_gate)
    d_normal[1] = hertz * by_rate
    d_normal[3] = force / modulus
    d_normal[4] = hertz * by_c
    d_normal[5] = 0.5 * force / r
    return force


def _step5(t):
    """Step and its derivative, both flat outside [0, 1]."""
    t = np.clip(t, 0.0, 1.0)
    square = t * t
    step = square * t * (10.0 + t * (6.0 * t - 15.0))
    return step, 30.0 * square * (1.0 - t) ** 2


def _paper_coefficient(speed, p: PaperConstants):
    """Friction coefficient and its derivative by speed."""
    scale = 1.0 / p.transition_velocity
    drop_size = p.static_friction - p.dynamic_friction
    rise, d_rise = _step5(speed * scale)
    mu = p.viscous_friction * speed + p.static_friction * rise
    d_mu = p.viscous_friction + (p.static_friction * scale) * d_rise
    if drop_size != 0.0:
        drop, d_drop = _step5(0.5 * (speed * scale - 1.0))
        mu -= drop_size * drop
        d_mu -= (0.5 * scale * drop_size) * d_drop
    return mu, d_mu


def _simbody_coefficient(speed, p: SimbodyConstants):
    """Friction coefficient and its derivative by speed."""
    scale = 1.0 / p.transition_velocity
    ratio = speed * scale
    drop_size = p.static_friction - p.dynamic_friction
    peak = 2.0 * drop_size / (1.0 + ratio * ratio)
    stribeck = p.dynamic_friction + peak
    d_stribeck = -2.0 * ratio * peak / (1.0 + ratio * ratio)
    slow = ratio < 1.0
    rise = np.where(slow, ratio, 1.0)
    mu = p.viscous_friction * speed + rise * stribeck
    d_rise = np.where(slow, stribeck, 0.0) + rise * d_stribeck
    return mu, p.viscous_friction + scale * d_rise


def sphere_force_derivatives(
    law: Law,
    indentation,
    rate,
    slip_velocity,
    stiffness,
    dissipation,
    radius,
    constants: Constants | None = None,
) -> SphereForceDerivatives:
    """`sphere_force` and its derivatives by FORCE_INPUTS.

    Arguments and errors as in `hunt_crossley.sphere_force`, floats only.
    Where the simbody law has a corner, at slip speed v_t, the derivative is
    the one from above.
    """
    p = checked_constants(law, constants)
    x, x_dot, v, k, c, r = (
        np.asarray(a, dtype=float)
        for a in (
            indentation,
            rate,
            slip_velocity,
            stiffness,
            dissipation,
            radius,
        )
    )
    shape = np.broadcast_shapes(*(a.shape for a in (x, x_dot, v, k, c, r)))
    d_normal = np.empty((6, *shape))
    d_friction = np.empty((6, *shape))
    if law == "paper":
        normal = _paper_normal(x, x_dot, k, c, r, p, d_normal)
        slip_square = p.slip_smoothing**2
        speed = np.sqrt(v * v + slip_square)
        mu, d_mu = _paper_coefficient(speed, p)
    else:
        normal = _simbody_normal(x, x_dot, k, c, r, p, d_normal)
        slip_square = p.constant_contact_force
        speed = np.sqrt(v * v + slip_square)
        mu, d_mu = _simbody_coefficient(speed, p)
    d_normal[2] = 0.0
    direction = v / speed
    minus_ratio = -mu * direction  # friction / normal
    np.multiply(minus_ratio, d_normal, out=d_friction)
    by_slip = d_mu * direction**2 + mu * slip_square / (speed * speed * speed)
    d_friction[2] = -normal * by_slip
    return SphereForceDerivatives(
        np.broadcast_to(normal, shape),
        np.broadcast_to(minus_ratio * normal, shape),
        d_normal,
        d_friction,
    )


def sphere_wrench_derivatives(
    law: Law,
    center_x,
    center_z,
    velocity_x,
    velocity_z,
    pitch_rate,
    stiffness,
    dissipation,
    radius,
    constants: Constants | None = None,
) -> tuple[SphereWrench, np.ndarray]:
    """`sphere_wrench` and its derivatives.

    Arguments and errors as in `hunt_crossley.sphere_wrench`, floats only.

    Returns:
        The wrench, and derivatives of shape (4, 8, ...): force_x, force_z,
        point_x, point_z by WRENCH_INPUTS.
    """
    indentation = radius - np.asarray(center_z, dtype=float)
    arm = contact_arm(law, indentation, radius)
    force = sphere_force_derivatives(
        law,
        indentation,
        -np.asarray(velocity_z, dtype=float),
        velocity_x + arm * pitch_rate,
        stiffness,
        dissipation,
        radius,
        constants,
    )
    shape = np.broadcast_shapes(
        force.normal.shape, np.shape(center_x), np.shape(pitch_rate)
    )
    # arm = radius for paper, (radius + center_z)/2 for simbody.
    arm_by_z, arm_by_r = (0.0, 1.0) if law == "paper" else (0.5, 0.5)
    jacobian = np.zeros((4, 8, *shape))
    by_slip = force.d_friction[2]
    for row, d_force in ((0, force.d_friction), (1, force.d_normal)):
        jacobian[row, 1] = -d_force[0]
        jacobian[row, 3] = -d_force[1]
        jacobian[row, 5:7] = d_force[3:5]
        jacobian[row, 7] = d_force[5] + d_force[0]
    jacobian[0, 1] += by_slip * arm_by_z * pitch_rate
    jacobian[0, 2] = by_slip
    jacobian[0, 4] = by_slip * arm
    jacobian[0, 7] += by_slip * arm_by_r * pitch_rate
    jacobian[2, 0] = 1.0
    jacobian[3, 1] = 1.0 - arm_by_z
    jacobian[3, 7] = -arm_by_r
    wrench = SphereWrench(
        force.friction,
        force.normal,
        np.broadcast_to(np.asarray(center_x, dtype=float), shape),
        np.broadcast_to(center_z - arm, shape),
    )
    return wrench, jacobian
