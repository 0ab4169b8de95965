"""Spheres and constants of a foot–ground contact, as one set of values."""

from dataclasses import dataclass, field, fields

import numpy as np

from drake_exo.errors import InputError
from drake_exo.forces.contact_constants import Constants
from drake_exo.forces.hunt_crossley import (
    Law,
    checked_constants,
    paper_stiffness,
)

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
