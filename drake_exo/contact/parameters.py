"""A contact parameter: one object for simulation, calibration and report.

Spheres and constants of a foot–ground contact, as one set of values.
"""

from dataclasses import dataclass, field, fields

import numpy as np

from drake_exo.contact.hunt_crossley import (
    Constants,
    Law,
    checked_constants,
    paper_stiffness,
)
from drake_exo.errors import InputError


def check_range(nominal: float, lower: float, upper: float) -> None:
    """Refuse bounds that are none, and a value that is not within them.

    Raises:
        InputError: saying which.
    """
    if not lower < upper:
        raise InputError(
            f"lower bound {lower:g} is not below upper bound {upper:g}; swap "
            "them"
        )
    if not lower <= nominal <= upper:
        raise InputError(
            f"nominal {nominal:g} is not within its bounds {lower:g} to "
            f"{upper:g}; correct the bounds or the nominal value"
        )


@dataclass(frozen=True)
class ContactParameter:
    """A scalar of a contact model.

    Attributes:
        name: for reports, such as "heel.stiffness".
        unit: of all values.
        nominal: value if not calibrated, guess and prior mean otherwise.
        lower, upper: bounds when calibrated.
        free: whether it is calibrated.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    free: bool = True

    def __post_init__(self):
        try:
            check_range(self.nominal, self.lower, self.upper)
        except InputError as error:
            raise InputError(f"{self.name} [{self.unit}]: {error}") from error

    @property
    def span(self) -> float:
        """Distance between the bounds."""
        return self.upper - self.lower

    def at_bound(self, value: float, fraction: float = 1e-3) -> bool:
        """Whether a value sits at a bound, within a fraction of the span."""
        margin = fraction * self.span
        return value <= self.lower + margin or value >= self.upper - margin


NOMINAL_MODULUS = 5e6  # N/m², both legs' soles together
NOMINAL_DISSIPATION = 2.0  # s/m


@dataclass(frozen=True)
class ContactSphere:
    """A sphere fixed in the foot link. Values also of Drake's scalars.

    `stiffness` is k = ½ E^(2/3) for the paper's law and E in N/m² for
    simbody's; `x` and `z` place the centre in the link's frame.
    """

    x: float = field(metadata={"unit": "m"})
    z: float = field(metadata={"unit": "m"})
    radius: float = field(metadata={"unit": "m", "above": 0.0})
    stiffness: float = field(metadata={"unit": "", "above": 0.0})
    dissipation: float = field(metadata={"unit": "s/m", "minimum": 0.0})


# Numeric parameters of a sphere, in this order.
SPHERE_PARAMETERS = tuple(f.name for f in fields(ContactSphere))


@dataclass(frozen=True)
class ContactParameters:
    """Law, constants (the law's defaults if None) and spheres by name."""

    law: Law
    spheres: dict[str, ContactSphere]
    constants: Constants | None = None

    def checked(self) -> "ContactParameters":
        """These parameters with constants filled in.

        Raises:
            InputError: a value is out of its bounds, or the constants are
                those of the other law.
        """
        constants = checked_constants(self.law, self.constants)
        if not self.spheres:
            raise InputError("the foot–ground contact needs a sphere")
        for name, sphere in self.spheres.items():
            check_bounds(sphere, f"contact sphere '{name}'")
        check_bounds(constants, f"constants of contact law '{self.law}'")
        return ContactParameters(self.law, dict(self.spheres), constants)


def nominal_contact(
    law: Law,
    heel: tuple[float, float],
    toe: tuple[float, float],
    radius: float,
    constants: Constants | None = None,
) -> ContactParameters:
    """Two equal spheres of usual stiffness (both legs) and dissipation.

    Args:
        law: "paper" or "simbody".
        heel, toe: centres (x, z) in the foot link [m].
        radius: of both [m].
        constants: friction and smoothing; the law's defaults if None.
    """
    stiffness = NOMINAL_MODULUS
    if law == "paper":
        stiffness = paper_stiffness(NOMINAL_MODULUS)
    spheres = {
        name: ContactSphere(x, z, radius, stiffness, NOMINAL_DISSIPATION)
        for name, (x, z) in (("heel", heel), ("toe", toe))
    }
    return ContactParameters(law, spheres, constants).checked()


def check_bounds(values, what: str) -> None:
    """Checks a dataclass of floats against its fields' metadata.

    Raises:
        InputError: a value is not finite or out of its bounds.
    """
    for item in fields(values):
        value, bounds = getattr(values, item.name), item.metadata
        where = f"{what}: {item.name} is {value:g} {bounds['unit']}".rstrip()
        if not np.isfinite(value):
            raise InputError(f"{where}; give a finite number")
        if "above" in bounds and not value > bounds["above"]:
            raise InputError(f"{where}; it must be above {bounds['above']:g}")
        if "minimum" in bounds and value < bounds["minimum"]:
            raise InputError(
                f"{where}; it must be at least {bounds['minimum']:g}"
            )
