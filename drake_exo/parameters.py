"""A contact parameter: one object for simulation, calibration and report."""

from dataclasses import dataclass

from drake_exo.errors import InputError


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
        if not self.lower < self.upper:
            raise InputError(
                f"{self.name}: lower bound {self.lower:g} {self.unit} is not "
                f"below upper bound {self.upper:g} {self.unit}; swap them"
            )
        if not self.lower <= self.nominal <= self.upper:
            raise InputError(
                f"{self.name}: nominal {self.nominal:g} {self.unit} is not "
                f"within its bounds {self.lower:g} to {self.upper:g}; "
                "correct the bounds or the nominal value"
            )

    @property
    def span(self) -> float:
        """Distance between the bounds."""
        return self.upper - self.lower

    def at_bound(self, value: float, fraction: float = 1e-3) -> bool:
        """Whether a value sits at a bound, within a fraction of the span."""
        margin = fraction * self.span
        return value <= self.lower + margin or value >= self.upper - margin
