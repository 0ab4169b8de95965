"""Contacts of foot and ground, and of human and device, as sets of values.

`ContactModel` is what a calibration finds and what simulation and prediction
take; single scalars of it are called "heel.stiffness" or "thigh.origin_x". A
`ContactParameter` is such a scalar with its bounds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

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
    """Refuse bounds that are none, and a value that is not within them.

    Raises:
        InputError: saying which.
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
        nominal: value if not calibrated, guess and prior mean otherwise.
        lower, upper: bounds when calibrated.
        free: whether it is calibrated.
        prior_sd: standard deviation of the prior about the nominal value;
            None for none.
        log_prior: whether that is of the logarithm.
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
        """One that is known."""
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
        """Distance between the bounds."""
        return self.upper - self.lower

    def at_bound(self, value: float, fraction: float = 1e-3) -> bool:
        """Whether a value sits at a bound, within a fraction of the span."""
        margin = fraction * self.span
        return value <= self.lower + margin or value >= self.upper - margin


NOMINAL_MODULUS = 5e6  # N/m², both legs' soles together
NOMINAL_DISSIPATION = 2.0  # s/m
TYPICAL_JERK = 200.0  # rad/s³
STIFFNESS_UNIT = {"paper": "(N/m^2)^(2/3)", "simbody": "N/m^2"}


@dataclass(frozen=True)
class ContactSphere:
    """A sphere fixed in the foot link. Values also of Drake's scalars.

    `stiffness` is k = ½ E^(2/3) for the paper's law and E in N/m² for
    simbody's; `x` and `z` place the centre in the link's frame.

    >>> ContactSphere(5e6, 2.0, x=-0.05, z=-0.04, radius=0.032).radius
    0.032
    """

    stiffness: float = quantity("", above=0.0)
    dissipation: float = quantity("s/m", minimum=0.0)
    x: float = quantity("m")
    z: float = quantity("m")
    radius: float = quantity("m", above=0.0)


# Parameters of a sphere in the order of arrays and numeric parameters.
SPHERE_PARAMETERS = tuple(f.name for f in fields(ContactSphere))


@dataclass(frozen=True)
class GroundContact:
    """Law, constants (the law's defaults if None) and spheres by name.

    Those `of_sole` stand for a sole, which lies under every foot of a model
    whatever spheres that names.

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
        """The same with constants filled in.

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
        """Segment that touches the ground -> the contact of its spheres.

        Segments may have spheres of one name, which share their parameters;
        where one segment touches, all spheres are its own.

        Raises:
            InputError: there is none of a name that a segment has.
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
    """What a calibration knows: values and how sure they are.

    Attributes:
        names: of contact parameters and shared errors.
        values: (m,).
        covariance: (m, m).
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
        """Values (k,) and covariance (k, k) of some."""
        i = [self.names.index(name) for name in names]
        return self.values[i], self.covariance[np.ix_(i, i)]

    def part(self, names: Sequence[str]) -> "Posterior":
        """The same of some alone."""
        return Posterior(tuple(names), *self.of(names))

    def beside(self, other: "Posterior") -> "Posterior":
        """With what is known of others, as if by other data."""
        return Posterior(
            (*self.names, *other.names),
            np.concatenate([self.values, other.values]),
            block_diag(self.covariance, other.covariance),
        )


@dataclass(frozen=True)
class ContactModel:
    """Contact of foot and ground and, once calibrated, of the cuffs.

    Attributes:
        ground: contact of the foot.
        bushings: cuff -> its bushing; empty where human and device do not
            touch, or nothing is known of it.
        posterior: how sure a calibration is of them; None without one.
        jerk: typical jerk of the movements that it was calibrated on
            [rad/s^3]; without a calibration that of a brisk rise.

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
        """Parameters by name: spheres', then bushings' that are calibrated."""
        found = {}
        for name, sphere in self.ground.spheres.items():
            found |= {
                f"{name}.{k}": getattr(sphere, k) for k in SPHERE_PARAMETERS
            }
        for name, bushing in self.bushings.items():
            for k in CALIBRATED:
                found[f"{name}.{k}"] = getattr(bushing, k)
        return {name: float(value) for name, value in found.items()}

    def units(self) -> dict[str, str]:
        """Units of `values`."""
        found = {}
        for name in self.values():
            group, _, key = name.partition(".")
            part = self.ground.spheres.get(group) or self.bushings[group]
            unit = part.__dataclass_fields__[key].metadata["unit"]
            found[name] = unit or STIFFNESS_UNIT[self.ground.law]
        return found

    def fixed(self, group: str) -> list[ContactParameter]:
        """Parameters of one sphere or cuff, as known ones.

        Raises:
            InputError: there is none of that name.
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
            InputError: there is none of that name, or out of its bounds.
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
    """Equal spheres and equal bushings of usual values.

    Where the exoskeleton's cuff is not at the human's, its bushing is
    preloaded.

    Args:
        model: says where spheres and cuffs are.
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
