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

Signs: indentation is positive inside the ground, its rate is positive while
the sphere sinks, normal force is along world z. Slip velocity and friction are
along world x; in space friction is against the velocity of the contact point
along world x and y, its size by the smoothed length of that velocity.

First come the constants; their fields' metadata give unit and bounds, so that a
study file is read straight into them. Then the laws: pure functions that
broadcast over float and complex arrays, AutoDiffXd and Expression
(`contact.scalars`). Last their analytic first derivatives for float arrays,
which share intermediate results, because collocation evaluates every sphere at
every node in each iteration; tests compare them with complex-step derivatives.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from drake_exo.contact.scalars import (
    any_scalar,
    exp,
    maximum,
    minimum,
    sqrt,
    tanh,
)
from drake_exo.errors import InputError
from drake_exo.files.schema import quantity

# Beyond these a constant has another unit: ground that is softer bears a foot
# 0.1 m above it, halves the force of one at rest, or lets it slide like ice
# at 1 m/s.
_SHARP_1_M, _SHARP_S_M = {"minimum": 10.0}, {"minimum": 1.0}
_SLIP = {"above": 0.0, "maximum": 1.0}


@dataclass(frozen=True)
class PaperConstants:
    """Constants of the paper's law.

    The paper prints neither friction nor smoothing constants. Friction is what
    is usual with OpenSim; the smoothing constants are chosen here:

    - b_c = 300 1/m (`hertz_sharpness`) and s/m (`damping_sharpness`), one
      letter in the paper: the Hertz force is within 0.3 % of the sharp law
      from 10 mm on, and adhesion stays below 0.21 c/300 of it.
    - b_d = 20 1/m (`slope_sharpness`), b_n = 1 N (`slope_force`): up to 50 mm
      above the ground the force out of contact stays under 0.48 N and its
      slope above 2.9 N/m, which a sharper b_d would remove.
    - b_v = 50 s/m (`slope_rate_sharpness`) as in Simbody.
    - delta = 10 µm (`indentation_smoothing`): the Hertz part is below 0.02 N
      at zero indentation up to E = 4e7 N/m² at r = 32 mm; for stiffer spheres
      set it to 0.193 m N^(2/3) / (k r^(1/3)).
    - epsilon = 10 µm/s (`slip_smoothing`) makes √(v²) differentiable at rest.
    """

    static_friction: float = quantity("1", 0.8, minimum=0.0, maximum=10.0)
    dynamic_friction: float = quantity("1", 0.8, minimum=0.0, maximum=10.0)
    viscous_friction: float = quantity("s/m", 0.5, minimum=0.0)
    transition_velocity: float = quantity("m/s", 0.05, **_SLIP)
    hertz_sharpness: float = quantity("1/m", 300.0, **_SHARP_1_M)
    damping_sharpness: float = quantity("s/m", 300.0, **_SHARP_S_M)
    slope_sharpness: float = quantity("1/m", 20.0, above=0.0)
    slope_force: float = quantity("N", 1.0, minimum=0.0)
    slope_rate_sharpness: float = quantity("s/m", 50.0, above=0.0)
    indentation_smoothing: float = quantity("m", 1e-5, above=0.0, maximum=0.1)
    slip_smoothing: float = quantity("m/s", 1e-5, **_SLIP)


@dataclass(frozen=True)
class SimbodyConstants:
    """Constants of Simbody's law, named as in OpenSim.

    The smoothing defaults are OpenSim's, the friction ones those usual in
    its examples. The transition velocity is a compromise: the foot creeps at
    about v_t · (F_x/F_z)/u_s, so OpenSim's usual 0.2 m/s lets it slide
    centimetres, while its default 0.01 m/s makes the equations stiff.
    `constant_contact_force` smooths both |indentation| (m²) and |slip|
    (m²/s²). `friction_rounding`, which OpenSim does not have, rounds the
    corner at the transition velocity: a foot that touches down while
    sliding crosses it within milliseconds, which no grid resolves.
    """

    static_friction: float = quantity("1", 0.8, minimum=0.0, maximum=10.0)
    dynamic_friction: float = quantity("1", 0.8, minimum=0.0, maximum=10.0)
    viscous_friction: float = quantity("s/m", 0.5, minimum=0.0)
    transition_velocity: float = quantity("m/s", 0.05, **_SLIP)
    constant_contact_force: float = quantity(
        "m², m²/s²", 1e-5, above=0.0, maximum=0.01
    )
    hertz_smoothing: float = quantity("1/m", 300.0, **_SHARP_1_M)
    hunt_crossley_smoothing: float = quantity("s/m", 50.0, **_SHARP_S_M)
    friction_rounding: float = quantity("1", 0.0, minimum=0.0)


Constants = PaperConstants | SimbodyConstants


Law = Literal["paper", "simbody"]
# Law -> class of its constants.
LAWS = {"paper": PaperConstants, "simbody": SimbodyConstants}

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

    @property
    def about_origin(self) -> tuple:
        """F_x, F_z and the moment M_y about the origin, z F_x - x F_z."""
        moment = self.point_z * self.force_x - self.point_x * self.force_z
        return self.force_x, self.force_z, moment


class SpatialSphereWrench(NamedTuple):
    """Contact force on a sphere in space and the point where it acts."""

    force: tuple  # F_x, F_y, F_z in the world [N]
    point: tuple  # x, y, z in the world [m]

    @property
    def in_plane(self) -> SphereWrench:
        """Its components in the x–z plane."""
        (f_x, _, f_z), (x, _, z) = self
        return SphereWrench(f_x, f_z, x, z)

    @property
    def about_origin(self) -> tuple:
        """Moment about the world's origin [N·m] and force [N], six scalars."""
        (f_x, f_y, f_z), (x, y, z) = self
        moment = y * f_z - z * f_y, z * f_x - x * f_z, x * f_y - y * f_x
        return *moment, f_x, f_y, f_z


def paper_stiffness(modulus):
    """The paper's k for a plane-strain modulus E [N/m²]: ½ E^(2/3).

    >>> round(paper_stiffness(8e6))
    20000
    """
    return 0.5 * modulus ** (2.0 / 3.0)


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

    For c = 0 it is finite, but so large that the gate using it is exactly 1.
    """
    return 2.0 / (3.0 * maximum(MIN_GATE_DISSIPATION, dissipation))


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


def slip_speed(law: Law, slip_velocity, constants: Constants, sideways=0.0):
    """Smoothed length [m/s] of a slip velocity, positive also at rest."""
    if law == "paper":
        square = constants.slip_smoothing * constants.slip_smoothing
    else:
        square = constants.constant_contact_force
    along = slip_velocity * slip_velocity
    return sqrt(along + sideways * sideways + square)


def friction_coefficient(law: Law, speed, constants: Constants):
    """Friction coefficient at a slip speed [m/s] (paper: Figure 9).

    paper: u_v v + u_s S(v/v_t) − (u_s − u_d) S((v/v_t − 1)/2), the printed
    three pieces (equation 7) as one expression. simbody:
    min(v/v_t, 1) (u_d + 2 (u_s − u_d)/(1 + (v/v_t)²)) + u_v v, the minimum
    rounded where the constants say so (`saturated`).
    """
    u_s, u_d = constants.static_friction, constants.dynamic_friction
    ratio = speed / constants.transition_velocity
    viscous = constants.viscous_friction * speed
    if law == "paper":
        drop = (u_s - u_d) * step5(0.5 * (ratio - 1.0))
        return viscous + u_s * step5(ratio) - drop
    stribeck = u_d + 2.0 * (u_s - u_d) / (1.0 + ratio * ratio)
    return viscous + saturated(ratio, constants.friction_rounding) * stribeck


def saturated(ratio, rounding):
    """min(ratio, 1) for ratio ≥ 0, its corner rounded by w = `rounding`.

    ½ (√((ratio + 1)² + w²) − √((ratio − 1)² + w²)): exactly the minimum for
    w = 0; for every w it is 0 at ratio = 0 and tends to 1.
    """
    if isinstance(rounding, float) and rounding == 0.0:
        return minimum(ratio, 1.0)
    above, below = ratio + 1.0, ratio - 1.0
    w = rounding * rounding
    return 0.5 * (sqrt(above * above + w) - sqrt(below * below + w))


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

    All but law and constants are numbers (also AutoDiffXd or Expression) or
    arrays of them, but no lists.

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

    >>> normal, friction = sphere_force(
    ...     "simbody", 0.005, 0.0, 0.1, 5e6, 2.0, 0.032)
    >>> round(float(normal)), round(float(friction))
    (183, -155)
    """
    normal, friction, _ = _force(
        law,
        indentation,
        rate,
        (slip_velocity, 0.0),
        stiffness,
        dissipation,
        radius,
        checked_constants(law, constants),
    )
    return normal, friction


def _force(law, x, x_dot, slip_velocity, k, c, r, constants: Constants):
    """Normal force, and friction along the two parts of the slip velocity."""
    normal_force = _paper_normal if law == "paper" else _simbody_normal
    normal = normal_force(x, x_dot, k, c, r, constants)
    along, sideways = slip_velocity
    speed = slip_speed(law, along, constants, sideways)
    mu = friction_coefficient(law, speed, constants)
    pull = -normal * mu
    return normal, pull * (along / speed), pull * (sideways / speed)


def checked_constants(law: Law, constants: Constants | None) -> Constants:
    """The constants given, or the law's defaults.

    Raises:
        InputError: the law is unknown, or the constants are another law's.
    """
    if law not in LAWS:
        raise InputError(
            f"contact law {law!r} is unknown; use 'paper' or 'simbody'"
        )
    if constants is None:
        return LAWS[law]()
    if type(constants) is not LAWS[law]:
        raise InputError(
            f"contact law {law!r} needs {LAWS[law].__name__}, "
            f"not {type(constants).__name__}"
        )
    return constants


def check_slides(constants: Constants, what: str) -> None:
    """Refuse constants, named `what`, that slide harder than they stick.

    Raises:
        InputError: dynamic friction is above static friction.
    """
    if constants.dynamic_friction > constants.static_friction:
        raise InputError(
            f"{what}: dynamic_friction {constants.dynamic_friction:g} is above "
            f"static_friction {constants.static_friction:g}; give both, the "
            "dynamic one no higher"
        )


def contact_arm(law: Law, indentation, radius):
    """Height of the sphere's centre above the point where force acts [m].

    That is the sphere's lowest point (paper) or half the indentation (simbody).
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
        Force on the sphere and the point where it acts. Slip is the velocity
        of the body's material point there.
    """
    return spatial_sphere_wrench(
        law,
        (center_x, 0.0, center_z),
        (velocity_x, 0.0, velocity_z),
        (0.0, -pitch_rate, 0.0),
        stiffness,
        dissipation,
        radius,
        checked_constants(law, constants),
    ).in_plane


@any_scalar
def spatial_sphere_wrench(
    law: Law,
    center,
    velocity,
    angular_velocity,
    stiffness,
    dissipation,
    radius,
    constants: Constants,
) -> SpatialSphereWrench:
    """`sphere_wrench` of a body that moves in space.

    Args:
        law: "paper" or "simbody".
        center: x, y, z of the sphere's centre in the world [m].
        velocity: of the centre, in the world [m/s].
        angular_velocity: of the body, in the world [rad/s].
        stiffness, dissipation, radius, constants: As in `sphere_force`.
    """
    (x, y, z), (v_x, v_y, v_z) = center, velocity
    w_x, w_y, _ = angular_velocity
    indentation = radius - z
    arm = contact_arm(law, indentation, radius)
    normal, along, sideways = _force(
        law,
        indentation,
        -v_z,
        (v_x - arm * w_y, v_y + arm * w_x),
        stiffness,
        dissipation,
        radius,
        constants,
    )
    return SpatialSphereWrench((along, sideways, normal), (x, y, z - arm))


def _gate(sharpness, value):
    """`gate` and its derivative by `value`."""
    tanh = np.tanh(sharpness * value)
    return 0.5 + 0.5 * tanh, 0.5 * sharpness * (1.0 - tanh * tanh)


def _dissipation(x_dot, c, sharpness, shifted, d_shifted_dc):
    """Factor (1 + 3/2 c ẋ)·gate, and its derivatives by ẋ and c."""
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


def _paper_normal_derivatives(x, x_dot, k, c, r, p: PaperConstants, d_normal):
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


def _simbody_normal_derivatives(
    x, x_dot, modulus, c, r, p: SimbodyConstants, d_normal
):
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
    """`step5` and its derivative, both constant outside [0, 1]."""
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
    rise = saturated(ratio, p.friction_rounding)
    if p.friction_rounding == 0.0:
        slope = np.where(ratio < 1.0, 1.0, 0.0)
    else:
        above, below = ratio + 1.0, ratio - 1.0
        w = p.friction_rounding**2
        slope = 0.5 * (above / np.sqrt(above**2 + w))
        slope -= 0.5 * (below / np.sqrt(below**2 + w))
    mu = p.viscous_friction * speed + rise * stribeck
    d_mu = slope * stribeck + rise * d_stribeck
    return mu, p.viscous_friction + scale * d_mu


def sphere_force_derivatives(
    law: Law,
    indentation,
    rate,
    slip_velocity,
    stiffness,
    dissipation,
    radius,
    constants: Constants | None = None,
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """`sphere_force` and its derivatives.

    Arguments and errors as in `hunt_crossley.sphere_force`, floats only.
    Where the simbody law has a corner, at slip speed v_t without rounding,
    the derivative is the one from above.

    Returns:
        The forces, and derivatives of shape (2, 6, ...): normal, friction by
        the arguments from indentation to radius.
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
    d_normal, d_friction = jacobian = np.empty((2, 6, *shape))
    if law == "paper":
        normal = _paper_normal_derivatives(x, x_dot, k, c, r, p, d_normal)
        slip_square = p.slip_smoothing**2
        speed = np.sqrt(v * v + slip_square)
        mu, d_mu = _paper_coefficient(speed, p)
    else:
        normal = _simbody_normal_derivatives(x, x_dot, k, c, r, p, d_normal)
        slip_square = p.constant_contact_force
        speed = np.sqrt(v * v + slip_square)
        mu, d_mu = _simbody_coefficient(speed, p)
    d_normal[2] = 0.0
    direction = v / speed
    minus_ratio = -mu * direction  # friction / normal
    np.multiply(minus_ratio, d_normal, out=d_friction)
    by_slip = d_mu * direction**2 + mu * slip_square / (speed * speed * speed)
    d_friction[2] = -normal * by_slip
    friction = minus_ratio * normal
    force = np.broadcast_to(normal, shape), np.broadcast_to(friction, shape)
    return force, jacobian


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
        point_x, point_z by the arguments from center_x to radius.
    """
    indentation = radius - np.asarray(center_z, dtype=float)
    arm = contact_arm(law, indentation, radius)
    (normal, friction), (d_normal, d_friction) = sphere_force_derivatives(
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
        normal.shape, np.shape(center_x), np.shape(pitch_rate)
    )
    # arm = radius for paper, (radius + center_z)/2 for simbody.
    arm_by_z, arm_by_r = (0.0, 1.0) if law == "paper" else (0.5, 0.5)
    jacobian = np.zeros((4, 8, *shape))
    by_slip = d_friction[2]
    for row, d_force in ((0, d_friction), (1, d_normal)):
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
        friction,
        normal,
        np.broadcast_to(np.asarray(center_x, dtype=float), shape),
        np.broadcast_to(center_z - arm, shape),
    )
    return wrench, jacobian
