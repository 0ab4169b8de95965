"""Friction and smoothing constants of the two contact laws.

Field metadata hold unit and bounds, so that a study file can be read straight
into these classes. Fields may also hold AutoDiffXd or Expression values.
"""

from dataclasses import dataclass, field

from drake_exo.forces.scalars import sqrt


def _constant(default: float, unit: str, **bounds):
    return field(default=default, metadata={"unit": unit, **bounds})


@dataclass(frozen=True)
class PaperConstants:
    """Constants of the paper's law.

    Friction values are the ones usual with OpenSim; the paper prints none,
    nor its smoothing constants. Those are chosen here:

    - b_c = 300 for indentation (1/m) and for its rate (s/m), as the paper
      uses one letter for both: the Hertz force is within 0.3 % of the sharp
      law from 10 mm on, and adhesion stays below 0.21 c/300 of it.
    - b_d = 20 1/m, b_n = 1 N: out of contact the total force stays under
      0.48 N and its slope above 2.9 N/m down to 50 mm above the ground. A
      sharper b_d would remove the slope that the term is meant to give.
    - b_v = 50 s/m as in Simbody.
    - delta = 10 µm keeps the Hertz part below 0.02 N at zero indentation up
      to E = 4e7 N/m² at 32 mm radius (`regularisation_length` for others).
    - epsilon = 10 µm/s only makes √(v²) differentiable at rest.
    """

    static_friction: float = _constant(0.8, "1", minimum=0.0)
    dynamic_friction: float = _constant(0.8, "1", minimum=0.0)
    viscous_friction: float = _constant(0.5, "s/m", minimum=0.0)
    transition_velocity: float = _constant(0.05, "m/s", above=0.0)
    hertz_sharpness: float = _constant(300.0, "1/m", above=0.0)
    damping_sharpness: float = _constant(300.0, "s/m", above=0.0)
    slope_sharpness: float = _constant(20.0, "1/m", above=0.0)
    slope_force: float = _constant(1.0, "N", minimum=0.0)
    slope_rate_sharpness: float = _constant(50.0, "s/m", above=0.0)
    indentation_smoothing: float = _constant(1e-5, "m", above=0.0)
    slip_smoothing: float = _constant(1e-5, "m/s", above=0.0)


@dataclass(frozen=True)
class SimbodyConstants:
    """Constants of Simbody's law, named as in OpenSim.

    The smoothing defaults are OpenSim's, the friction ones those usual in
    its examples. The transition velocity is a compromise: the foot creeps at
    about v_t · (F_x/F_z)/u_s, so OpenSim's usual 0.2 m/s lets it slide
    centimetres, while its default 0.01 m/s makes the equations stiff.
    `constant_contact_force` smooths both |indentation| (m²) and |slip|
    (m²/s²).
    """

    static_friction: float = _constant(0.8, "1", minimum=0.0)
    dynamic_friction: float = _constant(0.8, "1", minimum=0.0)
    viscous_friction: float = _constant(0.5, "s/m", minimum=0.0)
    transition_velocity: float = _constant(0.05, "m/s", above=0.0)
    constant_contact_force: float = _constant(1e-5, "m², m²/s²", above=0.0)
    hertz_smoothing: float = _constant(300.0, "1/m", above=0.0)
    hunt_crossley_smoothing: float = _constant(50.0, "s/m", above=0.0)


Constants = PaperConstants | SimbodyConstants


def regularisation_length(stiffness, radius, residual_force=0.02):
    """Largest delta of the paper's law for a given stiffness and radius.

    With it the Hertz part is `residual_force` [N] at zero indentation:
    ½ (4/3) k^(3/2) √r (delta/2)^(3/2) = residual_force.

    Args:
        stiffness: The paper's k, the stiffest that is expected.
        radius: Sphere radius [m].
        residual_force: Force at zero indentation [N].

    Returns:
        delta [m].
    """
    factor = (2.0 / 3.0) * stiffness * sqrt(stiffness) * sqrt(radius)
    return 2.0 * (residual_force / factor) ** (2.0 / 3.0)
