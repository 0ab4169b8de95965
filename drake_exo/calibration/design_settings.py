"""Settings of Phase D, as they stand under `design` in a study file."""

from dataclasses import dataclass, field
from typing import Literal

from scipy.special import ndtri

from drake_exo.calibration.settings import Solver
from drake_exo.contact.strap import PLACES, SOFTEST_N_M, SOFTEST_NM_RAD
from drake_exo.errors import InputError


def _positive(default: float | None, unit: str):
    return field(default=default, metadata={"unit": unit, "above": 0.0})


@dataclass(frozen=True)
class CuffFreedom:
    """What may change of one cuff.

    Attributes:
        along_m: how far it may move down (negative) and up its limb.
        across_m: likewise backwards and forwards; [0, 0] to keep it.
        preload_across_m: how far the device's half alone may be shifted
            across the limb: the cuff then presses where both are aligned.
        preload_along_m: likewise along it.
        strap_n_m: softest strap along and across the limb; null to add none.
        strap_nm_rad: softest strap in rotation; null to add none.
        area_m2: of skin that bears its force today.
        area: least and most of it, as a share of that; tissue under a larger
            cuff is stiffer in proportion.

    >>> CuffFreedom(along_m=(-0.02, 0.05)).across_m
    (0.0, 0.0)
    """

    along_m: tuple[float, float] = field(
        default=(-0.1, 0.1), metadata={"unit": "m"}
    )
    across_m: tuple[float, float] = field(
        default=(0.0, 0.0), metadata={"unit": "m"}
    )
    preload_across_m: tuple[float, float] = field(
        default=(0.0, 0.0), metadata={"unit": "m"}
    )
    preload_along_m: tuple[float, float] = field(
        default=(0.0, 0.0), metadata={"unit": "m"}
    )
    strap_n_m: float | None = field(
        default=SOFTEST_N_M, metadata={"unit": "N/m", "minimum": SOFTEST_N_M}
    )
    strap_nm_rad: float | None = field(
        default=SOFTEST_NM_RAD,
        metadata={"unit": "N m/rad", "minimum": SOFTEST_NM_RAD},
    )
    area_m2: float = _positive(0.01, "m^2")
    area: tuple[float, float] = field(
        default=(1.0, 1.0), metadata={"unit": "1", "above": 0.0}
    )

    def __post_init__(self):
        _check_today(self, (*PLACES.values(), "area"))


@dataclass(frozen=True)
class JointFreedom:
    """How far a joint of the device may be off the wearer's.

    Attributes:
        along_m: along the link below it.
        across_m: across that link.
    """

    along_m: tuple[float, float] = field(
        default=(0.0, 0.0), metadata={"unit": "m"}
    )
    across_m: tuple[float, float] = field(
        default=(0.0, 0.0), metadata={"unit": "m"}
    )

    def __post_init__(self):
        _check_today(self, ("along_m", "across_m"))


def _check_today(freedom, names) -> None:
    """Refuse bounds that leave out what is today."""
    for what in names:
        lower, upper = getattr(freedom, what)
        today = 1.0 if what == "area" else 0.0
        if not lower <= today <= upper:
            raise InputError(
                f"{what} is {lower:g} to {upper:g}; what it is today, "
                f"{today:g}, must be within"
            )


@dataclass(frozen=True)
class DesignLimits:
    """What no wearer may feel more of; null for no such limit.

    Attributes:
        normal_n: force of a cuff across the limb.
        shear_n: along it.
        pressure_kpa: force across the limb over the cuff's area, mean.
        migration_mm: deflection along the limb; where it is larger today,
            no more than today.
        moment_nm: of a cuff on the limb.
        moment_factor: its moment against the largest one of today.
        shear_factor: its force along the limb, likewise.
        effort_factor: moments of the person's joints against the largest
            ones of today.
        support: how far the device's work may be from today's, as a share.
    """

    normal_n: float | None = _positive(None, "N")
    shear_n: float | None = _positive(None, "N")
    pressure_kpa: float | None = _positive(None, "kPa")
    migration_mm: float | None = _positive(10.0, "mm")
    moment_nm: float | None = _positive(None, "N m")
    moment_factor: float | None = _positive(1.0, "1")
    shear_factor: float | None = _positive(None, "1")
    effort_factor: float | None = _positive(1.05, "1")
    support: float | None = _positive(0.005, "1")


@dataclass(frozen=True)
class Population:
    """People of other sizes, normally distributed.

    Nothing is built in, as populations differ: give your own.

    Attributes:
        height_m: mean and standard deviation.
        mass_kg: likewise.
        percentiles: of both at once, a body each.

    >>> Population((1.70, 0.10), (70.0, 10.0), (50.0,)).bodies()
    [('50th percentile', 1.7, 70.0)]
    """

    height_m: tuple[float, float] = field(metadata={"unit": "m", "above": 0.0})
    mass_kg: tuple[float, float] = field(metadata={"unit": "kg", "above": 0.0})
    percentiles: tuple[float, ...] = field(
        default=(5.0, 50.0, 95.0), metadata={"above": 0.0}
    )

    def __post_init__(self):
        for percentile in self.percentiles:
            if not percentile < 100.0:
                raise InputError(
                    f"percentile {percentile:g} is none; give one between 0 "
                    "and 100"
                )

    def bodies(self) -> list[tuple[str, float, float]]:
        """Of each percentile: name, height [m] and mass [kg]."""
        found = []
        for percentile in self.percentiles:
            off = float(ndtri(percentile / 100.0))
            height, mass = (
                mean + off * sd for mean, sd in (self.height_m, self.mass_kg)
            )
            name = f"{percentile:g}th percentile"
            if min(height, mass) <= 0.0:
                raise InputError(f"nobody is as small as the {name}")
            found.append((name, height, mass))
        return found


@dataclass(frozen=True)
class DesignSettings:
    """Phase D.

    Attributes:
        objective: "peak" (the norm of order `order` over time, cuffs, trials
            and wearers) or "mean" (of order 2).
        order: of the norm; the larger, the nearer to the largest force.
        shear_weight: of forces along the limb beside those across it.
        weight: of the objective against the person's own movement.
        response: how the person answers: "own" (moves as before) or "free"
            (as is least effort, between the ends).
        own_angle_deg: how near to the own movement, one standard deviation.
        effort_nm: typical moment of the person's joints in the cost.
        jerk: typical jerk there; if left out, ten times that of the movements
            that calibrated: what is known already is no part of what is
            minimised.
        draws: wearers drawn from each calibration's posterior, besides the
            one that it found; a design for them is safer and less good.
        seed: of those draws.
        population: wearers of other sizes besides, who move as each
            calibrated one; none if left out.
        cuffs: what may change of each, by name; defaults where none is
            named.
        joints: how far those of the shipped device may move, exo_knee and
            exo_hip, by name; where they are if none is named.
        assistance: lowest and highest factor on the device's torques.
        assistance_over: what they depend on: the "angle" of their joint, or
            how much of the "movement"'s time is over.
        points: factors of each joint: at that many angles, or that many
            coefficients of a cubic spline over the movement; 1 for one
            throughout.
        limits: what no wearer may feel more of.
        solver: grid and solver.

    >>> DesignSettings(cuffs={"thigh": CuffFreedom(strap_n_m=None)}).freedom(
    ...     "shank").strap_n_m
    1000.0
    """

    objective: Literal["peak", "mean"] = "peak"
    order: float = field(default=8.0, metadata={"minimum": 4.0})
    shear_weight: float = field(default=0.25, metadata={"minimum": 0.0})
    weight: float = _positive(2.0, "1")
    response: Literal["own", "free"] = "own"
    own_angle_deg: float = _positive(0.02, "deg")
    effort_nm: float = _positive(2000.0, "N m")
    jerk: float | None = _positive(None, "rad/s^3")
    draws: int = field(default=0, metadata={"minimum": 0})
    seed: int = field(default=0, metadata={"minimum": 0})
    population: Population | None = None
    cuffs: dict[str, CuffFreedom] = field(default_factory=dict)
    joints: dict[str, JointFreedom] = field(default_factory=dict)
    assistance: tuple[float, float] = field(
        default=(0.7, 1.3), metadata={"above": 0.0}
    )
    assistance_over: Literal["angle", "movement"] = "angle"
    points: int = field(default=4, metadata={"minimum": 1})
    limits: DesignLimits = DesignLimits()
    solver: Solver = field(
        default_factory=lambda: Solver(nodes_per_second=50.0, tolerance=1e-4)
    )

    def __post_init__(self):
        lower, upper = self.assistance
        if not lower <= 1.0 <= upper:
            raise InputError(
                f"assistance is {lower:g} to {upper:g}; the factor of today, "
                "1, must be within"
            )

    @property
    def exponent(self) -> float:
        """Order of the norm."""
        return self.order if self.objective == "peak" else 2.0

    def freedom(self, cuff: str) -> CuffFreedom:
        """What may change of a cuff."""
        return self.cuffs.get(cuff, CuffFreedom())
