"""Settings of all phases; each class is a group of keys of a study file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from math import log
from pathlib import Path
from typing import Literal

from scipy.special import ndtri

from drake_exo.calibration.error_model import ErrorSizes
from drake_exo.contact.bushing import (
    NORMAL,
    ROTATION,
    TANGENTIAL,
    BushingParameters,
)
from drake_exo.contact.hunt_crossley import (
    LAWS,
    Constants,
    check_slides,
    paper_stiffness,
)
from drake_exo.contact.parameters import (
    STIFFNESS_UNIT,
    ContactModel,
    ContactParameter,
    ContactSphere,
    GroundContact,
    check_range,
)
from drake_exo.contact.strap import (
    OF_TODAY,
    PLACES,
    RELEASES,
    SHIFT,
    SOFTEST_N_M,
    SOFTEST_NM_RAD,
)
from drake_exo.errors import InputError, check_bounds
from drake_exo.files.schema import not_negative, positive, quantity
from drake_exo.measurement.settings import Device, Filter, JointDrive
from drake_exo.model.assembly import either_side
from drake_exo.model.segments import CUFFED, check_body, place
from drake_exo.nlp.ipopt import SolverOptions

__all__ = [
    "BushingSettings",
    "CuffFreedom",
    "DesignLimits",
    "DesignSettings",
    "Device",
    "DriveLimits",
    "EndTolerance",
    "ErrorSizes",
    "Filter",
    "FootGroundSettings",
    "GainFreedom",
    "InteractionNoise",
    "InteractionSettings",
    "JointDrive",
    "JointFreedom",
    "Population",
    "PredictionEnds",
    "PredictionSettings",
    "Range",
    "Solver",
    "SphereSettings",
    "Spread",
    "TrackingNoise",
]


@dataclass(frozen=True)
class Range:
    """A parameter, in the unit of its key.

    Attributes:
        nominal: initial guess and prior mean; if not free, the value itself.
        lower: lower bound.
        upper: upper bound.
        free: whether it is calibrated.

    >>> Range(5e6, 1e6, 2e7).upper
    20000000.0
    """

    nominal: float
    lower: float
    upper: float
    free: bool = True

    def __post_init__(self):
        check_range(self.nominal, self.lower, self.upper)


def _ranges(settings) -> dict[str, Range]:
    """Ranges by name, but for dicts: `schema.check` makes ranges of them.

    Raises:
        InputError: one reaches below zero.
    """
    found = {k: x for k, x in vars(settings).items() if isinstance(x, Range)}
    for name, value in found.items():
        if value.lower < 0.0:
            raise InputError(
                f"{name}: lower bound {value.lower:g} is negative; give 0 or "
                "more"
            )
    return found


@dataclass(frozen=True)
class Spread:
    """A parameter whose nominal value the model gives.

    Attributes:
        below, above: how far this bound lies from the model's value.
        shift: added to the model's value to give the nominal one.
        free: whether it is calibrated.

    >>> Spread(0.03, 0.03, shift=0.01).shift
    0.01
    """

    # As far as a design's: more is not given in metres.
    below: float = quantity("m", above=0.0, maximum=SHIFT["maximum"])
    above: float = quantity("m", above=0.0, maximum=SHIFT["maximum"])
    shift: float = quantity("m", 0.0)
    free: bool = True

    def __post_init__(self):
        if not -self.below <= self.shift <= self.above:
            raise InputError(
                f"shift is {self.shift:g} m, but its bounds are below and "
                f"above: {-self.below:g} to {self.above:g} m; correct one"
            )


@dataclass(frozen=True)
class SphereSettings:
    """One contact sphere.

    Attributes:
        modulus_n_m2: plane-strain modulus E, both feet together [N/m^2].
            The paper's law converts it, and its bounds, to k = E^(2/3)/2.
        dissipation_s_m: Hunt-Crossley dissipation [s/m].
        x_m, z_m: place of the centre, relative to the model's heel or toe.
        radius_m: radius; not free by default, because its effect is hard to
            tell from that of z.

    >>> soft = SphereSettings(modulus_n_m2=Range(2e6, 1e6, 2e7))
    >>> FootGroundSettings(heel=soft).heel.modulus_n_m2.nominal
    2000000.0
    """

    modulus_n_m2: Range = Range(1e7, 1e6, 1e8)
    dissipation_s_m: Range = Range(1.0, 0.0, 5.0)
    x_m: Spread = Spread(0.06, 0.06)
    z_m: Spread = Spread(0.025, 0.025)
    radius_m: Range = Range(0.032, 0.01, 0.06, free=False)

    def __post_init__(self):
        # A person would sink into anything softer; smaller is no sphere.
        least = {
            "modulus_n_m2": {"unit": "N/m^2", "minimum": 1e4},
            "radius_m": {"unit": "m", "minimum": 1e-3},
        }
        most = {  # diamond's modulus
            "modulus_n_m2": {"unit": "N/m^2", "maximum": 1.2e12},
            "radius_m": {"unit": "m", "maximum": 1.0},
        }
        for name, given in _ranges(self).items():
            for end, bounds in (("lower", least), ("upper", most)):
                value, own = getattr(given, end), bounds.get(name, {})
                check_bounds(f"{name}: {end} bound", value, own)


@dataclass(frozen=True)
class TrackingNoise:
    """Standard deviation of each signal's measurement; weights are 1/s^2.

    Attributes:
        angle_deg, velocity_deg_s: angles and rates of the person's joints,
            from markers on the skin.
        exo_angle_deg, exo_velocity_deg_s: angles and rates of the
            exoskeleton's joints, from encoders.
        foot_m: place of the foot.
        foot_pitch_deg: pitch of the foot.
        foot_velocity_m_s: velocity of the foot.
        foot_pitch_rate_deg_s: pitch rate of the foot.
        pelvis_m, pelvis_velocity_m_s: place and velocity of the pelvis in a
            model of two legs, whose hips share one place in the plane.
        force_n: ground reaction.
        cop_m: centre of pressure.
        torque_nm: typical torque; it is large, so that torques are minimised
            without competing with what was measured.
        jerk: typical jerk [rad/s^3 or m/s^3], in the same role. If it is much
            larger, the motion wiggles between the nodes, or a device swings on
            its cuffs. If left out, three times the RMS jerk of the person's
            joints in the calibration trials, and half of that in Phase C.

    >>> FootGroundSettings(noise=TrackingNoise(force_n=3.0)).noise.cop_m
    0.001
    """

    angle_deg: float = positive("deg", 0.5)
    velocity_deg_s: float = positive("deg/s", 4.0)
    exo_angle_deg: float = positive("deg", 0.1)
    exo_velocity_deg_s: float = positive("deg/s", 1.0)
    foot_m: float = positive("m", 0.005)
    foot_pitch_deg: float = positive("deg", 1.0)
    foot_velocity_m_s: float = positive("m/s", 0.03)
    foot_pitch_rate_deg_s: float = positive("deg/s", 5.0)
    pelvis_m: float = positive("m", 0.01)
    pelvis_velocity_m_s: float = positive("m/s", 0.05)
    force_n: float = positive("N", 5.0)
    cop_m: float = positive("m", 0.001)
    torque_nm: float = positive("N m", 5000.0)
    jerk: float | None = positive("rad/s^3", None)


@dataclass(frozen=True)
class EndTolerance:
    """How far the foot may be from what was measured at both ends.

    Attributes:
        x_m, z_m, pitch_deg: place and pitch of the foot.
        velocity_m_s, pitch_rate_deg_s: velocity and pitch rate of the foot;
            null leaves them free at the ends, where they are only tracked.

    >>> EndTolerance(x_m=0.02).z_m
    0.005
    """

    x_m: float = positive("m", 0.01)
    z_m: float = positive("m", 0.005)
    pitch_deg: float = positive("deg", 2.0)
    velocity_m_s: float | None = quantity("m/s", None, minimum=0.0)
    pitch_rate_deg_s: float | None = quantity("deg/s", None, minimum=0.0)


@dataclass(frozen=True)
class PredictionEnds(EndTolerance):
    """How far the foot may be from what was measured at both ends.

    With free velocities the foot might throw the body up.

    >>> PredictionEnds().velocity_m_s
    0.05
    """

    velocity_m_s: float | None = positive("m/s", 0.05)
    pitch_rate_deg_s: float | None = positive("deg/s", 10.0)


@dataclass(frozen=True)
class Solver:
    """Grid and solver.

    Attributes:
        nodes_per_second: intervals of the time grid per second.
        transcription: "hermite_simpson" (Drake's DirectCollocation) or
            "pseudospectral" (the paper's, degree 3).
        reduce: whether to eliminate the linear collocation constraints; the
            same optimum is found with fewer unknowns.
        hessian: second derivatives: "gauss_newton" (approximate) or "exact".
        solver: "ipopt" (sparse derivatives) or "drake" (Drake's own
            IpoptSolver: slow, for small cases).
        tolerance: tolerance of optimality and feasibility, scaled.
        max_iterations: largest number of iterations of one attempt.

    >>> FootGroundSettings(solver=Solver(nodes_per_second=50)).solver.tolerance
    1e-05
    """

    nodes_per_second: float = quantity("1/s", 200.0, minimum=10.0)
    transcription: Literal["hermite_simpson", "pseudospectral"] = (
        "hermite_simpson"
    )
    reduce: bool = True
    hessian: Literal["gauss_newton", "exact"] = "gauss_newton"
    solver: Literal["ipopt", "drake"] = "ipopt"
    # Any start is a solution to looser ones.
    tolerance: float = quantity(None, 1e-5, above=0.0, maximum=0.1)
    max_iterations: int = quantity(None, 300, minimum=1, maximum=1e9)

    def options(self) -> SolverOptions:
        """These settings as options of the bridge to IPOPT."""
        return SolverOptions(
            tolerance=self.tolerance, max_iterations=self.max_iterations
        )


@dataclass(frozen=True)
class FootGroundSettings:
    """Phase A.

    Attributes:
        law: contact law: "simbody", or "paper" (whose friction has zero slope
            at zero slip, which slows an optimiser down); or a file of
            `drake-exo sole reduce`: the feet then wear that sole, and nothing
            of it is calibrated.
        constants: friction and smoothing constants of the law by name.
        heel: contact sphere at the heel.
        toe: contact sphere at the toe.
        spheres: contact spheres of other names in the model's `ground`.
        prior_weight: weight w of the prior 1/2 w ((p - nominal)/span)^2.
        front: factors on the noise of forces and centre of pressure, for
            the Pareto front of kinematics against forces.
        sole_at_m: with a sole's law, place (x, z) of the sole's frame in the
            foot's. If left out, the sole lies in the middle of the foot's own
            spheres, with its bottom on the floor of the standing trial.

    >>> FootGroundSettings(law="paper").law_constants().static_friction
    0.8
    """

    law: Literal["simbody", "paper"] | Path = "simbody"
    constants: dict[str, float] = field(default_factory=dict)
    heel: SphereSettings = SphereSettings()
    toe: SphereSettings = SphereSettings()
    spheres: dict[str, SphereSettings] = field(default_factory=dict)
    noise: TrackingNoise = TrackingNoise()
    end_tolerance: EndTolerance = EndTolerance()
    prior_weight: float = quantity(None, 0.01, minimum=0.0)
    front: tuple[float, ...] = quantity(None, (0.25, 0.5, 2.0, 4.0), above=0.0)
    solver: Solver = Solver()
    sole_at_m: tuple[float, float] | None = place(None)

    def __post_init__(self):
        _check_once(self, "spheres")
        if self.of_sole:
            if self.law.suffix not in (".yaml", ".yml"):
                raise InputError(
                    f"law is {str(self.law)!r}; give simbody, paper or a .yaml "
                    "file of 'drake-exo sole reduce'"
                )
            given = _given(self, ("constants", *_SPHERES, "spheres"))
            if given:
                raise InputError(
                    f"{given[0]} belongs to calibrated spheres, and {self.law} "
                    "has its own; leave one of them out"
                )
        elif self.sole_at_m is not None:
            raise InputError("sole_at_m belongs to a law of a sole; give law")

    @property
    def front_factors(self) -> list[float]:
        """Sorted factors of the Pareto front, 1 (the calibration) included."""
        return sorted({1.0, *self.front})

    @property
    def of_sole(self) -> bool:
        """Whether the law is a sole's, from a file."""
        return isinstance(self.law, Path)

    def law_constants(self) -> Constants:
        """Constants of the law.

        Raises:
            InputError: a name that the law does not have, a value out of its
                bounds, or a foot that slides harder than it sticks.
        """
        law = LAWS["simbody" if self.of_sole else self.law]
        known = {f.name: f.metadata for f in fields(law)}
        for name, value in self.constants.items():
            if name not in known:
                raise InputError(
                    f"foot_ground.constants: the law '{self.law}' has no "
                    f"'{name}'; it has {', '.join(known)}"
                )
            check_bounds(f"foot_ground.constants.{name}", value, known[name])
        found = law(**self.constants)
        check_slides(found, "foot_ground.constants")
        return found

    def of(self, sphere: str) -> SphereSettings:
        """Settings of one sphere by name; `heel` also gives `heel_left`."""
        own = {"heel": self.heel, "toe": self.toe} | self.spheres
        return either_side(own, sphere, SphereSettings())

    def parameters(
        self, places: dict[str, tuple[float, float]]
    ) -> list[ContactParameter]:
        """Contact parameters of the spheres, in the kernel's order.

        Args:
            places: sphere -> the model's centre (x, z) in the foot frame [m].

        Raises:
            InputError: the law is a sole's.
        """
        if self.of_sole:
            raise InputError(
                f"law is {str(self.law)!r}, a sole's, and nothing of it is "
                "calibrated; give ground, as of "
                "drake_exo.contact.SoleLaw.read(...).ground(model)"
            )
        found = [
            p
            for name, place in places.items()
            for p in _sphere(name, self.of(name), place, self.law)
        ]
        if self.prior_weight == 0.0:
            return found
        width = self.prior_weight**-0.5
        return [replace(p, prior_sd=width * p.span) for p in found]

    def contact(self, places: dict[str, tuple[float, float]]) -> ContactModel:
        """Contact with nominal values; `places` as for `parameters`."""
        spheres = {
            name: ContactSphere(**values)
            for name, values in _by_group(self.parameters(places)).items()
        }
        return ContactModel(
            GroundContact(self.law, spheres, self.law_constants())
        )


# Spheres that have keys of their own, like the cuffs in CUFFED.
_SPHERES = ("heel", "toe")


def own_keys(settings) -> list[str]:
    """Spheres or cuffs whose own key is set to anything but its default."""
    return _given(settings, (*_SPHERES, *CUFFED))


def _given(settings, keys: Sequence[str]) -> list[str]:
    """Those of some keys that exist and are not at their defaults."""
    # A field with a default_factory is no attribute of the class.
    usual = type(settings)
    return [
        k for k in keys if getattr(settings, k, {}) != getattr(usual, k, {})
    ]


def _check_once(settings, group: str) -> None:
    """Refuse a name that is given by its own key and in a group as well."""
    for name in own_keys(settings):
        if name in getattr(settings, group):
            raise InputError(
                f"{group}: {name!r} is given by the key {name}, too; keep one "
                "of them"
            )


def _by_group(parameters) -> dict[str, dict[str, float]]:
    """Sphere or cuff -> its parameters' nominal values by name."""
    found: dict[str, dict[str, float]] = {}
    for p in parameters:
        group, _, what = p.name.partition(".")
        found.setdefault(group, {})[what] = p.nominal
    return found


def _placed(name, spread, model, prior_sd=None):
    """Parameter of a place, given relative to the model's own (`model`)."""
    return ContactParameter(
        name,
        "m",
        model + spread.shift,
        model - spread.below,
        model + spread.above,
        spread.free,
        prior_sd,
    )


def _sphere(name, settings, place, law):
    def ranged(field_name, unit, r, convert=float):
        values = (convert(v) for v in (r.nominal, r.lower, r.upper))
        return ContactParameter(f"{name}.{field_name}", unit, *values, r.free)

    return [
        ranged(
            "stiffness",
            STIFFNESS_UNIT[law],
            settings.modulus_n_m2,
            paper_stiffness if law == "paper" else float,
        ),
        ranged("dissipation", "s/m", settings.dissipation_s_m),
        _placed(f"{name}.x", settings.x_m, place[0]),
        _placed(f"{name}.z", settings.z_m, place[1]),
        ranged("radius", "m", settings.radius_m),
    ]


@dataclass(frozen=True)
class BushingSettings:
    """One human-exoskeleton bushing.

    Attributes:
        origin_x_m, origin_z_m: place in the human segment, relative to the
            model's cuff.
        tangential_n_m, normal_n_m, rotational_nm_rad: stiffness (tangential:
            along the limb; normal: across it).
        slip_n: force along the limb at which the cuff slips; null for a
            strap that never slips, as in the paper.
        tangential_damping, normal_damping, rotational_damping: damping; it is
            not calibrated (paper, II-C).

    >>> BushingSettings().damping["normal_damping"]
    10.0
    """

    origin_x_m: Spread = Spread(0.05, 0.05)
    origin_z_m: Spread = Spread(0.1, 0.1)
    tangential_n_m: Range = Range(2000.0, 100.0, 20000.0)
    normal_n_m: Range = Range(5000.0, 100.0, 50000.0)
    rotational_nm_rad: Range = Range(50.0, 1.0, 500.0)
    slip_n: Range | None = Range(30.0, 5.0, 300.0)
    tangential_damping: float = not_negative("N s/m", 10.0)
    normal_damping: float = not_negative("N s/m", 10.0)
    rotational_damping: float = not_negative("N m s/rad", 0.1)

    def __post_init__(self):
        if isinstance(self.slip_n, Range) and self.slip_n.lower <= 0.0:
            raise InputError(
                f"slip_n: lower bound {self.slip_n.lower:g} is not a force; "
                "give one above 0, or null for a cuff that never slips"
            )
        for name, given in _ranges(self).items():
            if given.free and given.nominal == 0.0:
                raise InputError(
                    f"{name}: nominal is 0, but the prior is a factor on the "
                    "nominal value; give one above 0, or free: false"
                )
            if name == "normal_n_m" and given.nominal > 0.0:
                # A softer one would hold nothing: it was given in N/mm.
                least = {"unit": "N/m", "minimum": 100.0}
                check_bounds(f"{name}: nominal", given.nominal, least)

    @property
    def damping(self) -> dict[str, float]:
        """Damping by the names of `BushingParameters`."""
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name.endswith("_damping")
        }


@dataclass(frozen=True)
class InteractionNoise(TrackingNoise):
    """Noise of the signals that Phases B and C track, beside those of Phase A.

    Attributes:
        moment_nm: moments of the person's joints.
        exo_moment_nm: moments of the exoskeleton's joints.
        normal_force_n: error of a mat's resultant force beyond what `errors`
            explain, for an error that lasts a second. Cells that round to
            2.5 kPa together are 1 to 5 N off for a sixth of a second, and no
            bushing is as linear as its model.
        energy_j: typical contact energy of a component; the square of the
            energy over this is minimised.

    >>> mats = InteractionNoise(normal_force_n=0.5)
    >>> InteractionSettings(noise=mats).noise.normal_force_n
    0.5
    """

    moment_nm: float = positive("N m", 5.0)
    exo_moment_nm: float = positive("N m", 1.0)
    normal_force_n: float = positive("N", 1.0)
    energy_j: float = positive("J", 1.0)


@dataclass(frozen=True)
class InteractionSettings:
    """Phase B, and the models of Phase C.

    Attributes:
        shank, thigh, pelvis: the cuff of this name, on either leg.
        cuffs: cuffs of other names in the model's `cuffs`.
        stiffness_factor: one standard deviation of the prior of every
            stiffness, and of the force at which a cuff slips, as a factor.
            The prior is log-normal: two of three values are within this factor
            of the nominal one.
        origin_sd_m: standard deviation of the prior of every origin.
        prior_weight: weight of these priors; 0 for none.
        errors: priors of systematic errors of the measurement.

    >>> soft = BushingSettings(normal_n_m=Range(2000.0, 100.0, 9000.0))
    >>> InteractionSettings(thigh=soft).bushings(
    ...     {"thigh": (0.0, 0.2)})["thigh"].normal_stiffness
    2000.0
    """

    shank: BushingSettings = BushingSettings()
    thigh: BushingSettings = BushingSettings()
    pelvis: BushingSettings = BushingSettings()
    cuffs: dict[str, BushingSettings] = field(default_factory=dict)
    noise: InteractionNoise = InteractionNoise()
    end_tolerance: EndTolerance = EndTolerance()
    stiffness_factor: float = quantity(None, 2.0, above=1.0)
    origin_sd_m: float = quantity("m", 0.015, above=0.0, maximum=1.0)
    prior_weight: float = quantity(None, 1.0, minimum=0.0)
    errors: ErrorSizes = field(default_factory=ErrorSizes)
    solver: Solver = Solver()

    def __post_init__(self):
        _check_once(self, "cuffs")

    def of(self, cuff: str) -> BushingSettings:
        """Settings of one cuff by name; `thigh` also gives `thigh_left`."""
        own = {name: getattr(self, name) for name in CUFFED} | self.cuffs
        return either_side(own, cuff, BushingSettings())

    def parameters(
        self, places: dict[str, tuple[float, float]]
    ) -> list[ContactParameter]:
        """Parameters of the bushings, six each, in the kernel's order.

        Args:
            places: cuff -> the model's place (x, z) in the human segment [m].
        """
        return [
            p
            for name, place in places.items()
            for p in self._bushing(name, self.of(name), place)
        ]

    def _bushing(self, name, settings, place) -> list[ContactParameter]:
        """Parameters of one cuff, in the order of `bushing.CALIBRATED`."""
        width = self.prior_weight**-0.5 if self.prior_weight else None
        factor = width and width * log(self.stiffness_factor)
        origin = width and width * self.origin_sd_m

        def log_normal(what, unit, free, *values):  # nominal, lower, upper
            return ContactParameter(
                f"{name}.{what}", unit, *values, free, factor, log_prior=True
            )

        def stiffness(what, unit, r):
            values = r.nominal, r.lower, r.upper
            return log_normal(f"{what}_stiffness", unit, r.free, *values)

        slip = ContactParameter.fixed(f"{name}.slip", "1/N", 0.0)
        if (r := settings.slip_n) is not None:
            values = (1.0 / f for f in (r.nominal, r.upper, r.lower))
            slip = log_normal("slip", "1/N", r.free, *values)

        x, z = settings.origin_x_m, settings.origin_z_m
        return [
            _placed(f"{name}.origin_x", x, place[0], origin),
            _placed(f"{name}.origin_z", z, place[1], origin),
            stiffness("tangential", "N/m", settings.tangential_n_m),
            stiffness("normal", "N/m", settings.normal_n_m),
            stiffness("rotational", "N m/rad", settings.rotational_nm_rad),
            slip,
        ]

    def bushings(
        self, places: dict[str, tuple[float, float]]
    ) -> dict[str, BushingParameters]:
        """Cuff -> bushing with nominal values; see `parameters`."""
        return {
            name: BushingParameters(**values, **self.of(name).damping)
            for name, values in _by_group(self.parameters(places)).items()
        }


@dataclass(frozen=True)
class PredictionSettings:
    """Phase C.

    Attributes:
        objective: "tracking" (forces, centre of pressure and torques, as the
            paper) or "comfort" (interaction forces minimised, ground
            reaction free, effort bounded).
        torque_limit_nm: bound on every joint torque, both legs together.
        ends: "measured", or "periodic": a step of two legs that ends as it
            begins with left and right exchanged, at `speed_m_s`. Nothing is
            tracked then; the trial gives the start of the search and the
            duration of the step.
        speed_m_s: speed of the pelvis over a periodic step; that of the trial
            if null.
        clearance_m: least height of a foot above the ground in the middle half
            of its measured swing, in a periodic step.
        guess: where the search starts: "data" (the measured motion), or "line"
            (a minimum-jerk line between the end states, unsuitable for legs
            that step). By default the line for one leg, data for two.
        errors: priors of systematic errors of the measurement; for errors that
            trials share, the calibration's results are used.

    >>> PredictionSettings(objective="comfort").torque_limit_nm
    1000.0
    """

    objective: Literal["tracking", "comfort"] = "tracking"
    noise: InteractionNoise = InteractionNoise()
    end_tolerance: PredictionEnds = PredictionEnds()
    torque_limit_nm: float = positive("N m", 1000.0)
    ends: Literal["measured", "periodic"] = "measured"
    speed_m_s: float | None = quantity("m/s", None, above=0.0, maximum=10.0)
    clearance_m: float = quantity("m", 0.01, minimum=0.0, maximum=0.3)
    guess: Literal["data", "line"] | None = None
    errors: ErrorSizes = field(default_factory=ErrorSizes)
    solver: Solver = Solver()

    def __post_init__(self):
        if self.ends == "periodic":
            if self.objective == "comfort":
                raise InputError(
                    "objective is comfort, but a step without data (ends: "
                    "periodic) minimises effort alone; leave one of them out"
                )
        elif given := _given(self, ("speed_m_s", "clearance_m")):
            raise InputError(
                f"{given[0]} is that of a step without data, this one ends as "
                "measured; leave it out, or give ends: periodic"
            )


_SHARE = {"unit": "1", "minimum": 0.0, "maximum": 1.0}


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
        area_m2: area of skin that bears its force today.
        area: least and most area, as a share of today's; tissue under a larger
            cuff is stiffer in proportion.
        slide: least and most share of the spring along the limb that a
            passive slide in the cuff takes away, 1 for one that moves freely;
            its travel counts as migration.
        hinge: likewise for the spring in rotation and a passive hinge.
        removable: whether a design may leave the cuff out.

    >>> CuffFreedom(along_m=(-0.02, 0.05)).across_m
    (0.0, 0.0)
    """

    along_m: tuple[float, float] = quantity("m", (-0.1, 0.1), **SHIFT)
    across_m: tuple[float, float] = quantity("m", (0.0, 0.0), **SHIFT)
    preload_across_m: tuple[float, float] = quantity("m", (0.0, 0.0), **SHIFT)
    preload_along_m: tuple[float, float] = quantity("m", (0.0, 0.0), **SHIFT)
    strap_n_m: float | None = quantity("N/m", SOFTEST_N_M, minimum=SOFTEST_N_M)
    strap_nm_rad: float | None = quantity(
        "N m/rad", SOFTEST_NM_RAD, minimum=SOFTEST_NM_RAD
    )
    # All of a person's skin is 2 m^2.
    area_m2: float = quantity("m^2", 0.01, above=0.0, maximum=1.0)
    area: tuple[float, float] = quantity("1", (1.0, 1.0), above=0.0, **OF_TODAY)
    slide: tuple[float, float] = field(default=(0.0, 0.0), metadata=_SHARE)
    hinge: tuple[float, float] = field(default=(0.0, 0.0), metadata=_SHARE)
    removable: bool = False

    def __post_init__(self):
        _check_today(self, (*PLACES.values(), "area", *RELEASES))


@dataclass(frozen=True)
class JointFreedom:
    """How far a joint of the device may be off the wearer's.

    Attributes:
        along_m: along the link below it.
        across_m: across that link.

    >>> JointFreedom(along_m=(-0.01, 0.01)).across_m
    (0.0, 0.0)
    """

    along_m: tuple[float, float] = quantity("m", (0.0, 0.0), **SHIFT)
    across_m: tuple[float, float] = quantity("m", (0.0, 0.0), **SHIFT)

    def __post_init__(self):
        _check_today(self, ("along_m", "across_m"))


@dataclass(frozen=True)
class GainFreedom:
    """How far the gains of a joint's controller may go.

    Attributes:
        constant_nm: lowest and highest constant torque.
        stiffness_nm_rad: stiffest spring towards the joint's zero.
        damping_nm_s_rad: largest damping.

    >>> GainFreedom(stiffness_nm_rad=0.0).damping_nm_s_rad
    5.0
    """

    constant_nm: tuple[float, float] = quantity("N m", (-10.0, 10.0))
    stiffness_nm_rad: float = not_negative("N m/rad", 20.0)
    damping_nm_s_rad: float = not_negative("N m s/rad", 5.0)

    def __post_init__(self):
        _check_today(self, ("constant_nm",))


def _check_today(freedom, names) -> None:
    """Refuse bounds that exclude today's value."""
    for what in names:
        lower, upper = getattr(freedom, what)
        today = 1.0 if what == "area" else 0.0
        if not lower <= today <= upper:
            raise InputError(
                f"{what} is {lower:g} to {upper:g}, which must include its "
                f"value today, {today:g}"
            )


@dataclass(frozen=True)
class DriveLimits:
    """What the drive of a device's joint can do; null for no such limit.

    Attributes:
        torque_nm: largest torque of the drive, without the joint's friction.
        speed_deg_s: largest speed of the joint.
        power_w: largest power that it gives or takes up: torque times speed.

    >>> DriveLimits(torque_nm=30.0).power_w is None
    True
    """

    torque_nm: float | None = positive("N m", None)
    speed_deg_s: float | None = positive("deg/s", None)
    power_w: float | None = positive("W", None)


def _factor(default):
    """A limit as a share of today's value."""
    return quantity("1", default, above=0.0, **OF_TODAY)


@dataclass(frozen=True)
class DesignLimits:
    """Largest values that a wearer may feel; null for no such limit.

    Attributes:
        normal_n: force of a cuff across the limb.
        mean_n: mean of that force over time, then over a wearer's trials.
        rate_n_s: how fast that force rises or falls.
        shear_n: force of a cuff along the limb.
        pressure_kpa: mean pressure: force across the limb over the cuff's area.
        migration_mm: deflection along the limb, estimated from encoders; the
            default is such that 10 mm hold once it is built. If it is beyond
            the limit today, it comes as near to the limit as it can.
        moment_nm: moment of a cuff on the limb.
        moment_factor: moment of a cuff on the limb, as a share of today's
            largest.
        shear_factor: force of a cuff along the limb, as a share of today's
            largest.
        effort_factor: moments of the person's joints, as a share of today's
            largest.
        support: how far the device's work may be from today's, as a share.
        drives: limits of the drives of the device's joints, by name; a drive
            that is not named has none.

    >>> DesignLimits(pressure_kpa=8.0).migration_mm
    7.0
    """

    normal_n: float | None = positive("N", None)
    mean_n: float | None = positive("N", None)
    rate_n_s: float | None = positive("N/s", None)
    shear_n: float | None = positive("N", None)
    # More than tissue bears, in any mean over a cuff: it was given in Pa.
    pressure_kpa: float | None = quantity(
        "kPa", None, above=0.0, maximum=1000.0
    )
    migration_mm: float | None = positive("mm", 7.0)
    moment_nm: float | None = positive("N m", None)
    moment_factor: float | None = _factor(1.0)
    shear_factor: float | None = _factor(None)
    effort_factor: float | None = _factor(1.05)
    support: float | None = positive("1", 0.005)
    drives: dict[str, DriveLimits] = field(default_factory=dict)

    def of_forces(
        self, today: Sequence[float]
    ) -> Iterator[tuple[int, str, float]]:
        """Yield component, name and value of each limit on a cuff's force.

        Args:
            today: largest components (3,) today [N, N, N m].
        """
        for k, name, size in (
            (NORMAL, "normal_n", 1.0),
            (TANGENTIAL, "shear_n", 1.0),
            (TANGENTIAL, "shear_factor", today[TANGENTIAL]),
            (ROTATION, "moment_nm", 1.0),
            (ROTATION, "moment_factor", today[ROTATION]),
        ):
            value = getattr(self, name)
            if value is not None:
                yield k, name, value * size


@dataclass(frozen=True)
class Population:
    """People of other sizes, normally distributed.

    Nothing is built in, as populations differ: give your own.

    Attributes:
        height_m: mean and standard deviation of stature.
        mass_kg: mean and standard deviation of body mass.
        percentiles: percentiles, each of both at once; each makes a body.

    >>> Population((1.70, 0.10), (70.0, 10.0), (50.0,)).bodies()
    [('50th percentile', 1.7, 70.0)]
    """

    height_m: tuple[float, float] = quantity("m", above=0.0)
    mass_kg: tuple[float, float] = quantity("kg", above=0.0)
    percentiles: tuple[float, ...] = quantity(
        None, (5.0, 50.0, 95.0), above=0.0, below=100.0
    )

    def __post_init__(self):
        for name in ("height_m", "mass_kg"):
            pair, own = getattr(self, name), self.__dataclass_fields__[name]
            if not isinstance(pair, tuple | list) or len(pair) != 2:
                raise InputError(
                    f"{name} is {pair!r:.60}; give mean and standard deviation"
                )
            for value in pair:
                check_bounds(name, value, own.metadata)
        if not self.percentiles:
            raise InputError(
                "percentiles is empty; give at least one, or leave population "
                "out"
            )
        most = max(self.percentiles)
        if most < 1.0:  # shares
            raise InputError(
                f"percentiles are all below 1 %, up to {most:g}; give per "
                "cent, such as 5, 50, 95"
            )
        if len(set(self.percentiles)) < len(self.percentiles):
            raise InputError("a percentile is given twice; give each once")
        for name, height, mass in self.bodies():
            check_body(mass, height, name)

    def bodies(self) -> list[tuple[str, float, float]]:
        """Name, height [m] and mass [kg] of each percentile's body."""
        found = []
        for percentile in self.percentiles:
            off = float(ndtri(percentile / 100.0))
            height, mass = (
                mean + off * sd for mean, sd in (self.height_m, self.mass_kg)
            )
            found.append((f"{percentile:g}th percentile", height, mass))
        return found


@dataclass(frozen=True)
class DesignSettings:
    """Phase D.

    Attributes:
        objective: "peak" (the norm of order `order` over time, cuffs, trials
            and wearers) or "mean" (of order 2).
        order: order of the norm; the larger, the nearer to the largest force.
        shear_weight: weight of forces along the limb beside those across it.
        weight: weight of the objective against the person's own movement.
        response: how the person responds: "own" (moves as before) or "free"
            (moves between the given ends with the least effort).
        own_angle_deg: how closely the own movement is kept, one standard
            deviation.
        effort_nm: typical moment of the person's joints in the cost.
        jerk: typical jerk in the cost. If left out, ten times that of the
            calibration trials, so that jerk of the known movement hardly
            counts.
        draws: number of wearers drawn from each calibration's posterior,
            besides the one that it found; a design for them is safer but gains
            less.
        seed: seed of those draws.
        population: additional wearers of other sizes, who move as each
            calibrated one; none if left out.
        cuffs: what may change of each cuff, by name; `thigh` also gives
            `thigh_left`; defaults for those that are not named.
        symmetric: whether cuffs and joints whose names differ in left and right
            alone change alike: shifts along and across their limbs, straps,
            areas, and factors on torques.
        joints: how far the joints exo_knee and exo_hip of the shipped device
            may move, by name; a joint that is not named stays where it is.
        assistance: lowest and highest factor on the device's torques.
        assistance_over: what these factors depend on: the "angle" of their
            joint, or how much of the "movement"'s time is over; or "gains":
            one factor throughout, and a constant, a spring and a damper of
            each joint's controller.
        gains: bounds of that constant, spring and damper.
        points: number of factors of each joint: at that many angles, or that
            many coefficients of a cubic spline over the movement; 1 for one
            factor throughout.
        limits: largest values that a wearer may feel.
        solver: grid and solver.

    >>> DesignSettings(cuffs={"thigh": CuffFreedom(strap_n_m=None)}).freedom(
    ...     "shank").strap_n_m
    1000.0
    """

    objective: Literal["peak", "mean"] = "peak"
    # The power of 1000 N, summed over time, is still a number.
    order: float = quantity(None, 8.0, minimum=4.0, maximum=100.0)
    shear_weight: float = quantity(None, 0.25, minimum=0.0)
    weight: float = positive("1", 10.0)
    response: Literal["own", "free"] = "own"
    own_angle_deg: float = positive("deg", 0.02)
    effort_nm: float = positive("N m", 2000.0)
    jerk: float | None = positive("rad/s^3", None)
    # All wearers are in one program; no computer holds more.
    draws: int = quantity(None, 0, minimum=0, maximum=1000)
    seed: int = quantity(None, 0, minimum=0)
    population: Population | None = None
    cuffs: dict[str, CuffFreedom] = field(default_factory=dict)
    symmetric: bool = False
    joints: dict[str, JointFreedom] = field(default_factory=dict)
    assistance: tuple[float, float] = quantity(
        None, (0.7, 1.3), above=0.0, **OF_TODAY
    )
    assistance_over: Literal["angle", "movement", "gains"] = "angle"
    gains: GainFreedom = GainFreedom()
    points: int = quantity(None, 4, minimum=1)
    limits: DesignLimits = DesignLimits()
    solver: Solver = field(
        default_factory=lambda: Solver(nodes_per_second=50.0, tolerance=1e-4)
    )

    def __post_init__(self):
        lower, upper = self.assistance
        if not lower <= 1.0 <= upper:
            raise InputError(
                f"assistance is {lower:g} to {upper:g}, which must include "
                "today's factor, 1"
            )
        if self.assistance_over != "gains" and self.gains != GainFreedom():
            raise InputError(
                "gains are those of assistance_over: gains, but it is "
                f"{self.assistance_over}; leave gains out, or change it"
            )

    @property
    def exponent(self) -> float:
        """Order of the norm."""
        return self.order if self.objective == "peak" else 2.0

    def freedom(self, cuff: str) -> CuffFreedom:
        """What may change of a cuff; `thigh` also gives `thigh_left`."""
        return either_side(self.cuffs, cuff, CuffFreedom())
