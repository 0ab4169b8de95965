"""Smooth Hunt–Crossley force between a sphere and the ground plane z = 0.

Two laws, chosen by name. They are not interchangeable: a stiffness calibrated
with one is wrong in the other.

`paper`
    Serrancolí et al., appendix 1 (equations 4 to 7): Hertz force with a
    dissipative factor, both gated by tanh, a small term that keeps the slope
    positive when there is no contact, and Stribeck friction from fifth-order
    steps. Its stiffness k is half the plane-strain modulus to the power 2/3.
`simbody`
    `SmoothSphereHalfSpaceForce` of OpenSim and Simbody. Its stiffness is the
    plane-strain modulus E in N/m².

Everything here is a pure function of arrays that broadcast, for float and
complex numpy arrays, AutoDiffXd and Expression (`forces.scalars`). The
derivatives are in `hunt_crossley_derivatives`.

Signs: indentation is positive inside the ground, its rate is positive while
the sphere sinks, slip velocity is along world x, normal force is along world
z, friction along world x.
"""

from typing import Literal, NamedTuple

from drake_exo.errors import InputError
from drake_exo.forces.contact_constants import (
    Constants,
    PaperConstants,
    SimbodyConstants,
)
from drake_exo.forces.scalars import (
    any_scalar,
    exp,
    maximum,
    minimum,
    select_less,
    sqrt,
    tanh,
)

Law = Literal["paper", "simbody"]

# Below this dissipation [s/m] the velocity gate is exactly one in double
# precision for any rate slower than 600 m/s, so clamping the 1/c in it here
# changes nothing and makes c = 0 regular.
MIN_GATE_DISSIPATION = 1e-3
# Printed numbers of the paper's slope term, in metres (equation 6).
SLOPE_OFFSET = 0.01
SLOPE_LENGTH = 0.1


class SphereWrench(NamedTuple):
    """Contact force on a sphere and the world point where it acts."""

    force_x: object  # N
    force_z: object  # N
    point_x: object  # m
    point_z: object  # m


def paper_stiffness(modulus):
    """The paper's k for a plane-strain modulus E [N/m²]: ½ E^(2/3)."""
    return 0.5 * modulus ** (2.0 / 3.0)


def plane_strain_modulus(stiffness):
    """Plane-strain modulus E [N/m²] for the paper's k; inverts the above."""
    return (2.0 * stiffness) ** 1.5


def default_constants(law: Law) -> Constants:
    """Constants of a law with their defaults; InputError for unknown laws."""
    if law == "paper":
        return PaperConstants()
    if law == "simbody":
        return SimbodyConstants()
    raise InputError(
        f"contact law {law!r} is unknown; use 'paper' or 'simbody'"
    )


def hertz_factor(law: Law, stiffness, radius):
    """Force per (indentation)^(3/2) in N/m^(3/2).

    (4/3) k^(3/2) √r with the paper's k, which is (√2/3) E √r.
    """
    k_power = (
        stiffness * sqrt(stiffness) if law == "paper" else 0.5**1.5 * stiffness
    )
    return (4.0 / 3.0) * k_power * sqrt(radius)


def gate(sharpness, value):
    """½ + ½ tanh(sharpness · value): 0 for negative values, 1 for positive."""
    return 0.5 + 0.5 * tanh(sharpness * value)


def step5(t):
    """Fifth-order step from 0 at t ≤ 0 to 1 at t ≥ 1, twice differentiable."""
    t = minimum(maximum(t, 0.0), 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


def release_rate(dissipation):
    """2/(3c) [m/s]: the unloading rate at which the dissipative factor is 0.

    Finite for c = 0, but so large that the gate built on it is exactly 1.
    """
    c = select_less(
        MIN_GATE_DISSIPATION, dissipation, dissipation, MIN_GATE_DISSIPATION
    )
    return 2.0 / (3.0 * c)


def _paper_normal(x, x_dot, k, c, r, p: PaperConstants):
    delta = p.indentation_smoothing
    x_plus = 0.5 * (x + sqrt(x * x + delta * delta))
    shifted = x_dot + release_rate(c)
    hertz = hertz_factor("paper", k, r) * x_plus * sqrt(x_plus)
    hertz = hertz * gate(p.hertz_sharpness, x)
    damping = (1.0 + 1.5 * c * x_dot) * gate(p.damping_sharpness, shifted)
    slope = p.slope_force * exp((x - SLOPE_OFFSET) / SLOPE_LENGTH)
    slope = slope * gate(p.slope_sharpness, x)
    return hertz * damping + slope * gate(p.slope_rate_sharpness, shifted)


def _simbody_normal(x, x_dot, modulus, c, r, p: SimbodyConstants):
    root = sqrt(x * x + p.constant_contact_force)
    hertz = hertz_factor("simbody", modulus, r) * root * sqrt(root)
    hertz = hertz * gate(p.hertz_smoothing, x)
    damping = 1.0 + 1.5 * c * x_dot
    shifted = x_dot + release_rate(c)
    return hertz * damping * gate(p.hunt_crossley_smoothing, shifted)


def slip_speed(law: Law, slip_velocity, constants: Constants):
    """Smoothed |slip velocity| [m/s], positive also at rest."""
    if law == "paper":
        square = constants.slip_smoothing * constants.slip_smoothing
    else:
        square = constants.constant_contact_force
    return sqrt(slip_velocity * slip_velocity + square)


@any_scalar
def friction_coefficient(law: Law, speed, constants: Constants):
    """Friction coefficient at a slip speed [m/s] (paper: Figure 9).

    paper: u_v v + u_s S(v/v_t) − (u_s − u_d) S((v/v_t − 1)/2), the printed
    three pieces (equation 7) as one expression. simbody:
    min(v/v_t, 1) (u_d + 2 (u_s − u_d)/(1 + (v/v_t)²)) + u_v v.
    """
    u_s, u_d = constants.static_friction, constants.dynamic_friction
    ratio = speed / constants.transition_velocity
    viscous = constants.viscous_friction * speed
    if law == "paper":
        drop = (u_s - u_d) * step5(0.5 * (ratio - 1.0))
        return viscous + u_s * step5(ratio) - drop
    stribeck = u_d + 2.0 * (u_s - u_d) / (1.0 + ratio * ratio)
    return viscous + minimum(ratio, 1.0) * stribeck


@any_scalar
def sphere_force(
    law: Law,
    indentation,
    rate,
    slip_velocity,
    stiffness,
    dissipation,
    radius,
    constants: Constants | None = None,
):
    """Normal force and friction of one or many spheres.

    Args:
        law: "paper" or "simbody".
        indentation: Depth of the sphere's lowest point under z = 0 [m].
        rate: Time derivative of the indentation [m/s].
        slip_velocity: Velocity of the contact point along world x [m/s].
        stiffness: k = ½ E^(2/3) for paper, E [N/m²] for simbody.
        dissipation: Hunt–Crossley c [s/m], may be 0.
        radius: Of the sphere [m].
        constants: Friction and smoothing; the law's defaults if None.

    Returns:
        (normal, friction) in N with the broadcast shape of the arguments:
        force on the sphere along world z and along world x.

    Raises:
        InputError: The law is unknown, or the constants are another law's.
    """
    constants = checked_constants(law, constants)
    normal_force = _paper_normal if law == "paper" else _simbody_normal
    normal = normal_force(
        indentation, rate, stiffness, dissipation, radius, constants
    )
    speed = slip_speed(law, slip_velocity, constants)
    mu = friction_coefficient(law, speed, constants)
    return normal, -normal * mu * (slip_velocity / speed)


def checked_constants(law: Law, constants: Constants | None) -> Constants:
    """The constants given, or the law's defaults; InputError on a mismatch."""
    defaults = default_constants(law)
    if constants is None:
        return defaults
    if type(constants) is not type(defaults):
        raise InputError(
            f"contact law {law!r} needs {type(defaults).__name__}, "
            f"not {type(constants).__name__}"
        )
    return constants


def contact_arm(law: Law, indentation, radius):
    """Height of the sphere's centre above the contact point [m].

    The sphere's lowest point for paper, half the indentation for simbody.
    """
    return radius if law == "paper" else radius - 0.5 * indentation


@any_scalar
def sphere_wrench(
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
) -> SphereWrench:
    """Contact force of the ground on a sphere fixed in a moving body.

    Args:
        law: "paper" or "simbody".
        center_x, center_z: Sphere's centre in the world [m].
        velocity_x, velocity_z: Velocity of the centre [m/s].
        pitch_rate: Of the body, toes up positive (about world −y) [rad/s].
        stiffness, dissipation, radius, constants: As in `sphere_force`.

    Returns:
        Force on the sphere and the point where it acts. The slip velocity is
        that of the body's material point at the contact point.
    """
    indentation = radius - center_z
    arm = contact_arm(law, indentation, radius)
    normal, friction = sphere_force(
        law,
        indentation,
        -velocity_z,
        velocity_x + arm * pitch_rate,
        stiffness,
        dissipation,
        radius,
        constants,
    )
    return SphereWrench(friction, normal, center_x, center_z - arm)
