"""Parameters of the contacts: foot with ground, and human with device.

`ContactModel` is the result of a calibration and an input of simulation and
prediction. Its scalars have names such as "heel.stiffness" or
"thigh.origin_x"; `ContactParameter` is one of them with bounds and prior.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from drake_exo.contact.bushing import CALIBRATED, BushingParameters
from drake_exo.contact.hunt_crossley import (
    Constants,
    Law,
    checked_constants,
    paper_stiffness,
)
from drake_exo.errors import (
    InputError,
    check_bounds,
    check_fields,
    check_names,
    check_type,
)
from drake_exo.files.schema import quantity
from drake_exo.model.plant import Model
from drake_exo.model.segments import CONTACT_RADIUS_M


def check_range(nominal: float, lower: float, upper: float) -> None:
    """Check that lower < upper and that `nominal` lies between them.

    Raises:
        InputError: one of the two does not hold.
    """
    if not lower < upper:
        raise InputError(
            f"lower bound {lower:g} is not below upper bound {upper:g}; "
            "correct them"
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
        nominal: its value if not calibrated, else first guess and prior mean.
        lower, upper: bounds when calibrated.
        free: whether it is calibrated.
        prior_sd: standard deviation of the prior about the nominal value;
            None: no prior.
        log_prior: whether `prior_sd` is that of the natural logarithm.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    free: bool = True
    prior_sd: float | None = None
    log_prior: bool = False

    @staticmethod
    def fixed(name: str, unit: str, value: float) -> "ContactParameter":
        """A parameter that is known, not calibrated."""
        return ContactParameter(name, unit, value, value, value, free=False)

    def __post_init__(self):
        if not self.free and self.lower == self.nominal == self.upper:
            return
        try:
            check_range(self.nominal, self.lower, self.upper)
        except InputError as error:
            raise InputError(f"{self.name} [{self.unit}]: {error}") from error

    @property
    def span(self) -> float:
        """Distance between the bounds, in `unit`."""
        return self.upper - self.lower

    def at_bound(self, value: float) -> bool:
        """Whether a value sits at a bound, within 1e-3 of the span."""
        margin = 1e-3 * self.span
        return value <= self.lower + margin or value >= self.upper - margin


NOMINAL_MODULUS = 5e6  # N/m², both legs' soles together
NOMINAL_DISSIPATION = 2.0  # s/m
TYPICAL_JERK = 200.0  # rad/s³
STIFFNESS_UNIT = {"paper": "(N/m^2)^(2/3)", "simbody": "N/m^2"}


@dataclass(frozen=True)
class ContactSphere:
    """A sphere fixed in a link; fields may also hold Drake's scalars.

    `stiffness` is k = ½ E^(2/3) for the law "paper" and E in N/m² for
    "simbody"; `x`, `y` and `z` place the centre in the link's frame. A model
    in the plane leaves `y` out.

    >>> ContactSphere(5e6, 2.0, x=-0.05, z=-0.04, radius=0.032).radius
    0.032
    """

    stiffness: float = quantity("", above=0.0)
    dissipation: float = quantity("s/m", minimum=0.0)
    x: float = quantity("m")
    z: float = quantity("m")
    radius: float = quantity("m", above=0.0)
    y: float = quantity("m", 0.0)

    @property
    def in_plane(self) -> tuple:
        """Values of SPHERE_PARAMETERS."""
        return tuple(getattr(self, name) for name in SPHERE_PARAMETERS)


# What a model in the plane knows of a sphere, in the order of its arrays.
SPHERE_PARAMETERS = ("stiffness", "dissipation", "x", "z", "radius")


@dataclass(frozen=True)
class GroundContact:
    """Law, constants (the law's defaults if None) and spheres by name.

    With `of_sole` the spheres stand for a sole: all of them lie under every
    foot of a model, whatever spheres the model itself names.

    >>> heel = ContactSphere(5e6, 2.0, x=-0.05, z=-0.04, radius=0.032)
    >>> GroundContact("simbody", {"heel": heel}).checked().constants
    ... # doctest: +ELLIPSIS
    SimbodyConstants(static_friction=0.8, ...)
    """

    law: Law
    spheres: dict[str, ContactSphere]
    constants: Constants | None = None
    of_sole: bool = False

    def checked(self) -> "GroundContact":
        """The same, checked, with the constants filled in.

        Raises:
            InputError: a value is out of its bounds, or the constants are
                those of the other law.
        """
        constants = checked_constants(self.law, self.constants)
        if not self.spheres:
            raise InputError("the foot–ground contact needs a sphere")
        for name, sphere in self.spheres.items():
            check_fields(sphere, f"contact sphere '{name}'")
        check_fields(constants, f"constants of contact law '{self.law}'")
        return replace(self, spheres=dict(self.spheres), constants=constants)

    def under(self, model: Model) -> "dict[str, GroundContact]":
        """Segment that touches the ground -> contact with only its spheres.

        Spheres of the same name on several segments share their parameters. If
        one segment alone touches the ground, it gets all spheres.

        Raises:
            InputError: the model has a sphere that this contact lacks.
        """
        if self.of_sole:
            person = model.assembly.human
            return {f"foot{end}": self for end in person.suffixes}
        if len(model.soles) == 1:
            return dict.fromkeys(model.soles, self)
        for name in model.spheres:
            if name not in self.spheres:
                raise InputError(
                    f"the contact has the spheres {', '.join(self.spheres)}, "
                    f"but the model has {', '.join(model.spheres)}; calibrate "
                    "with this model"
                )
        return {
            body: replace(self, spheres={n: self.spheres[n] for n in names})
            for body, names in model.soles.items()
        }


@dataclass(frozen=True, eq=False)
class Posterior:
    """Estimates of a calibration and their covariance.

    Attributes:
        names: (m,) contact parameters and errors of measurement.
        values: (m,) estimates, each in its own unit.
        covariance: (m, m) of the values.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Posterior)
            and self.names == other.names
            and np.array_equal(self.values, other.values)
            and np.array_equal(self.covariance, other.covariance)
        )

    __hash__ = None

    def of(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,) and covariance (k, k) of the quantities named."""
        i = [self.names.index(name) for name in names]
        return self.values[i], self.covariance[np.ix_(i, i)]

    def part(self, names: Sequence[str]) -> "Posterior":
        """The posterior of the quantities named, others dropped."""
        return Posterior(tuple(names), *self.of(names))

    def beside(self, other: "Posterior") -> "Posterior":
        """Both posteriors joined, as if estimated from independent data."""
        return Posterior(
            (*self.names, *other.names),
            np.concatenate([self.values, other.values]),
            block_diag(self.covariance, other.covariance),
        )


@dataclass(frozen=True)
class ContactModel:
    """Contact of foot and ground and, once calibrated, of the cuffs.

    Attributes:
        ground: contact of the foot with the ground.
        bushings: cuff -> its bushing; empty without a device, or before the
            cuffs are known.
        posterior: uncertainty of the calibrated values; None if not calibrated.
        jerk: typical jerk of the calibration trials [rad/s^3]; that of a brisk
            rise without a device if not calibrated.

    >>> from drake_exo.model.plant import nominal_model
    >>> contact = nominal_contact(nominal_model("coupled"))
    >>> contact.values()["thigh.normal_stiffness"]
    5000.0
    >>> contact.scaled(1.4).values()["thigh.normal_stiffness"]
    7000.0
    """

    ground: GroundContact
    bushings: dict[str, BushingParameters] = field(default_factory=dict)
    posterior: Posterior | None = field(default=None, repr=False)
    jerk: float = TYPICAL_JERK

    def values(self) -> dict[str, float]:
        """Parameters by name: all of spheres, then CALIBRATED of bushings."""
        return {
            f"{name}.{k}": float(getattr(part, k))
            for parts, keys in (
                (self.ground.spheres, SPHERE_PARAMETERS),
                (self.bushings, CALIBRATED),
            )
            for name, part in parts.items()
            for k in keys
        }

    def units(self) -> dict[str, str]:
        """Units of `values`, by the same names."""
        found = {}
        for name in self.values():
            group, _, key = name.partition(".")
            part = self.ground.spheres.get(group) or self.bushings[group]
            unit = part.__dataclass_fields__[key].metadata["unit"]
            found[name] = unit or STIFFNESS_UNIT[self.ground.law]
        return found

    def fixed(self, group: str) -> list[ContactParameter]:
        """Parameters of one sphere or cuff, as fixed `ContactParameter`s.

        Raises:
            InputError: no sphere or cuff has that name.
        """
        check_names([group], [*self.ground.spheres, *self.bushings])
        units = self.units()
        return [
            ContactParameter.fixed(name, units[name], value)
            for name, value in self.values().items()
            if name.startswith(f"{group}.")
        ]

    def with_values(self, values: Mapping[str, float]) -> "ContactModel":
        """The same with some values replaced.

        Args:
            values: by name, as `values` gives them.

        Raises:
            InputError: a name is unknown, or a value is out of its bounds.
        """
        check_names(values, self.values())

        def changed(group, part):
            own = {
                name.partition(".")[2]: float(value)
                for name, value in values.items()
                if name.startswith(f"{group}.")
            }
            found = replace(part, **own)
            check_fields(found, group)
            return found

        spheres = {n: changed(n, s) for n, s in self.ground.spheres.items()}
        return replace(
            self,
            ground=replace(self.ground, spheres=spheres),
            bushings={n: changed(n, b) for n, b in self.bushings.items()},
        )

    def scaled(self, factor: float) -> "ContactModel":
        """Bushings' stiffness and damping times `factor` (Phase C2)."""
        check_bounds("factor", factor, {"minimum": 0.0})
        bushings = {n: b.scaled(factor) for n, b in self.bushings.items()}
        known = self.posterior
        if known is not None:
            by = np.array(
                [factor if n.endswith("_stiffness") else 1 for n in known.names]
            )
            known = replace(
                known,
                values=by * known.values,
                covariance=np.outer(by, by) * known.covariance,
            )
        return replace(self, bushings=bushings, posterior=known)


def nominal_contact(model: Model, law: Law = "simbody") -> ContactModel:
    """Contact before calibration: equal spheres, equal bushings, usual values.

    If a cuff sits elsewhere on the exoskeleton than on the human, the offset
    becomes the bushing's preload.

    Args:
        model: gives the places of spheres and cuffs.
        law: of the foot-ground contact.

    >>> from drake_exo.model.plant import nominal_model
    >>> list(nominal_contact(nominal_model("human")).ground.spheres)
    ['heel', 'toe']
    """
    check_type(model, Model, "model")
    stiffness = NOMINAL_MODULUS
    if law == "paper":
        stiffness = paper_stiffness(NOMINAL_MODULUS)
    spheres = {
        name: ContactSphere(
            stiffness, NOMINAL_DISSIPATION, x, z, CONTACT_RADIUS_M
        )
        for name, (x, z) in model.spheres.items()
    }
    bushings = {}
    for name, (x, z) in model.cuffs.items():
        preload_x, preload_z = model.preload(name)
        bushings[name] = BushingParameters(
            origin_x=x, origin_z=z, preload_x=preload_x, preload_z=preload_z
        )
    return ContactModel(GroundContact(law, spheres).checked(), bushings)
