"""What makes the truth richer than the model, and measurements worse.

Every one can be switched off by name. Without any, the subject obeys the very
model that is calibrated, and instruments are perfect.
"""

from collections.abc import Iterable

from drake_exo.errors import InputError

# Of the subject and the device.
TRUTH = {
    "contact": "soles of five spheres without smoothing",
    "progressive": "cuffs that stiffen with deflection",
    "shear": "cuffs that slip along the limb beyond 25 N",
    "friction": "dry and viscous friction in the device's joints",
    "segments": "masses that differ by up to 3 % from the table",
    "variation": "posture, duration and load differ between movements",
}
# Of the instruments.
MEASUREMENT = {
    "marker_noise": "0.3 mm white noise on every marker coordinate",
    "soft_tissue": "markers that slide millimetres on the skin",
    "gaps": "markers that are hidden for up to 0.12 s",
    "plate_noise": "0.5 N and 0.2 N m white noise on every plate",
    "plate_drift": "plates with an offset of some newtons that drifts",
    "encoder_noise": "0.02 degree and 0.1 N m of noise in the device",
    "pressure_steps": "pressure in steps of 2.5 kPa, up to 30 kPa",
    "clocks": "device and mats that start up to 40 ms apart",
}
DISTURBANCES = {**TRUTH, **MEASUREMENT}


def checked(names: Iterable[str]) -> frozenset[str]:
    """The names as a set.

    Raises:
        InputError: one is unknown.
    """
    active = frozenset(names)
    for name in sorted(active - set(DISTURBANCES)):
        raise InputError(
            f"no disturbance is called '{name}'; known are "
            f"{', '.join(DISTURBANCES)}"
        )
    return active
