"""A contact parameter: one object for simulation, calibration and report."""

from dataclasses import dataclass

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
