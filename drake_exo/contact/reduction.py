"""Reduction of a compliant sole to spheres with nearly the same forces.

The simulated step of a sole gives vertical force and centre of pressure at
many poses. Spheres of the law "simbody", at rest in the same poses, are fitted
to both by least squares, in the plane (pitch, forward) or in space. Friction
is not fitted: the force of a sticking sole depends on where it stuck, which a
law of slip velocity cannot represent. Both slip at the same coefficient μ.
What free moment friction bears follows from where the spheres are, and is told.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import LeafSystem
from scipy.optimize import least_squares

from drake_exo.contact.hunt_crossley import (
    SimbodyConstants,
    check_slides,
    sphere_force,
)
from drake_exo.contact.parameters import (
    NOMINAL_DISSIPATION,
    ContactSphere,
    GroundContact,
)
from drake_exo.contact.systems import FootGroundContact_
from drake_exo.errors import InputError, check_count, check_type, path_of
from drake_exo.files import schema
from drake_exo.files.output import Check, write_csv
from drake_exo.model.assembly import Person
from drake_exo.model.plant import Model
from drake_exo.model.segments import CONTACT_RADIUS_M, IN_BODY

_USUAL_DEPTH_M = 0.01  # indentation that the default smoothing is made for
_LOADED = 0.1  # share of the largest force above which the CoP is fitted
_FORCE, _COP_M = 0.03, 0.002  # errors of weight one: share of F_max, and [m]
_STARTS = 6  # first guesses of the fit
_LOWER_N_M2, _UPPER_N_M2 = 1e4, 1e10  # bounds of the modulus
# What no law of a sole reaches: its spheres' extent over the sole's, how far
# they are from one height, and from the sole's bottom [m].
_SPREAD, _UNEVEN_M, _OFF_M = 1.5, 0.1, 0.2
_LOWEST = "z_m - radius_m"
_SD = 1.96  # standard deviations in the half-width of a 95 % interval


def loaded(samples: NamedTuple) -> np.ndarray:
    """Samples whose centre of pressure is fitted, (N,) bool."""
    return samples.force > _LOADED * samples.force.max()


def depth(samples: NamedTuple) -> float:
    """Deepest a corner of the undeformed sole is under the ground [m]."""
    (x, y, z), up = samples.size, samples.rotation[:, 2]
    lowest = samples.origin[:, 2] + up @ [*samples.middle, -z]
    lowest = lowest - np.abs(up[:, :2]) @ [x / 2, y / 2]
    return float(max(-lowest.min(), 1e-6))


def softened(
    share: float, friction: float = SimbodyConstants.static_friction
) -> SimbodyConstants:
    """Simbody's constants with smoothing for `share` of the usual indentation.

    The defaults suit a heel pad that is indented by a centimetre; smoothing is
    scaled in proportion. Friction is Coulomb's at any speed: this law has a
    slope below the transition velocity even without a viscous part.
    """
    usual = SimbodyConstants()
    return replace(
        usual,
        constant_contact_force=share**2 * usual.constant_contact_force,
        hertz_smoothing=usual.hertz_smoothing / share,
        static_friction=friction,
        dynamic_friction=friction,
        viscous_friction=0.0,
    )


@dataclass(frozen=True)
class SoleSphere:
    """One sphere of a sole's law.

    Attributes:
        modulus_n_m2: plane-strain modulus, of one sole [N/m²].
        modulus_factor_95: f of its 95 % interval, modulus / f to modulus · f.
        dissipation_s_m: Hunt–Crossley c [s/m]; not fitted.
        radius_m: of the sphere.
        x_m, y_m, z_m: centre in the sole's frame.
        x_m_95, y_m_95, z_m_95: half-widths of their 95 % intervals.
    """

    modulus_n_m2: float = schema.quantity("N/m^2", minimum=_LOWER_N_M2)
    modulus_factor_95: float = schema.quantity(None, 1.0, minimum=1.0)
    dissipation_s_m: float = schema.quantity(
        "s/m", NOMINAL_DISSIPATION, minimum=0.0
    )
    radius_m: float = schema.quantity(
        "m", CONTACT_RADIUS_M, above=0.0, maximum=IN_BODY["maximum"]
    )
    x_m: float = field(default=0.0, metadata=IN_BODY)
    x_m_95: float = schema.quantity("m", 0.0, minimum=0.0)
    y_m: float = field(default=0.0, metadata=IN_BODY)
    y_m_95: float = schema.quantity("m", 0.0, minimum=0.0)
    z_m: float = field(default=0.0, metadata=IN_BODY)
    z_m_95: float = schema.quantity("m", 0.0, minimum=0.0)


@dataclass(frozen=True)
class SoleLaw:
    """A sole as spheres of the law "simbody": the contents of law.yaml.

    Attributes:
        size_m: length, width and depth of the sole below its frame [m].
        spheres: by name, of one sole, in its frame.
        constants: of the law.
        planar: whether fitted in the plane, without y and roll.
        force_error_rms: RMS error of the force as share of the largest force.
        cop_error_rms_m: RMS error of the centre of pressure where loaded.
        spin_error_rms: RMS error of the largest free moment that friction
            bears, as share of its largest value; None if planar.
        support_share: least reach of the spheres' support polygon from the
            sole's middle, as share of its outline's there; None if planar.

    >>> from drake_exo.model.plant import nominal_model
    >>> two = {"heel": SoleSphere(2e7, x_m=-0.1, z_m=0.01),
    ...        "ball": SoleSphere(3e7, x_m=0.1, z_m=0.01)}
    >>> law = SoleLaw((0.26, 0.1, 0.022), two)
    >>> ground = law.ground(nominal_model("human"))
    >>> round(ground.spheres["ball"].x - ground.spheres["heel"].x, 6)
    0.2
    """

    size_m: tuple[float, float, float] = schema.quantity(
        "m", above=0.0, maximum=IN_BODY["maximum"]
    )
    spheres: dict[str, SoleSphere]
    constants: SimbodyConstants = field(default_factory=SimbodyConstants)
    planar: bool = False
    force_error_rms: float = 0.0
    cop_error_rms_m: float = schema.quantity("m", 0.0)
    spin_error_rms: float | None = None
    support_share: float | None = None

    def __post_init__(self):
        if len(self.spheres) < 2:
            raise InputError(
                "spheres: a foot would only roll over a single sphere; reduce "
                "to two or more (--spheres 2)"
            )
        for name in self.spheres:
            if "." in name or not name.strip():
                raise InputError(f"spheres: {name!r} is not a name; rename it")
        self._check_places()
        check_slides(self.constants, "constants")

    def _check_places(self) -> None:
        """Refuse spheres that cannot lie at the bottom of such a sole."""
        length, width, deep = self.size_m
        spheres = self.spheres.values()
        places = {
            "x_m": [s.x_m for s in spheres],
            "y_m": [s.y_m for s in spheres],
            _LOWEST: [s.z_m - s.radius_m for s in spheres],
        }
        for name, lowest in zip(self.spheres, places[_LOWEST], strict=True):
            if abs(lowest + deep) > _OFF_M:
                raise InputError(
                    f"spheres: {name} reaches down to {lowest:g} m ({_LOWEST}"
                    f"), far off the bottom of its sole at {-deep:g} m (the "
                    "last of size_m); correct them, in metres"
                )
        most = _SPREAD * length, _SPREAD * width, _UNEVEN_M
        for (axis, found), limit in zip(places.items(), most, strict=True):
            if np.ptp(found) > limit:
                raise InputError(
                    f"spheres: their {axis} lie up to {np.ptp(found):g} m "
                    f"apart, too far for a sole of {length:g} x {width:g} x "
                    f"{deep:g} m (size_m); correct them: x forward, y left, z "
                    "up, in metres"
                )

    @staticmethod
    def read(path: str | Path) -> "SoleLaw":
        """Read what `drake-exo sole reduce` wrote.

        Raises:
            InputError: with file, line and key.
        """
        return schema.load(path, SoleLaw)

    def check_worn(self, person: Person) -> None:
        """Raise InputError if the person's toes are hinged."""
        if person.toes != "rigid":
            raise InputError(
                "foot_ground.law: the law of a sole is that of a rigid foot; "
                "set model.human.toes to rigid"
            )

    def mirrored(self) -> "SoleLaw":
        """The law of the other foot's sole: left and right exchanged."""
        spheres = {n: replace(s, y_m=-s.y_m) for n, s in self.spheres.items()}
        return replace(self, spheres=spheres)

    def under(self, frame: Frame) -> LeafSystem:
        """The sole under a frame of any plant, on the ground z = 0.

        A planar law holds a foot in the plane alone: its spheres are on a line.

        Args:
            frame: fixed in the foot; the sole's own frame lies there (x
                forward, y left, z up, its origin in the sole's top).

        Returns:
            `FootGroundContact`, which `connect_forces` joins to the plant.

        >>> from pydrake.multibody.plant import MultibodyPlant
        >>> from pydrake.multibody.tree import SpatialInertia
        >>> plant = MultibodyPlant(0.0)
        >>> box = SpatialInertia.SolidBoxWithMass(5.0, 0.3, 0.1, 0.1)
        >>> foot = plant.AddRigidBody("foot", box)
        >>> two = {"heel": SoleSphere(2e7, x_m=-0.1, z_m=0.01),
        ...        "ball": SoleSphere(3e7, x_m=0.1, z_m=0.01)}
        >>> system = SoleLaw((0.26, 0.1, 0.022), two).under(foot.body_frame())
        >>> system.parameters().spheres["ball"].x
        0.1
        """
        check_type(frame, Frame, "frame")
        X_BF = frame.GetFixedPoseInBodyFrame()
        spheres = {}
        for name, s in self.spheres.items():
            x, y, z = (X_BF @ np.array([s.x_m, s.y_m, s.z_m])).tolist()
            spheres[name] = ContactSphere(
                s.modulus_n_m2, s.dissipation_s_m, x, z, s.radius_m, y
            )
        ground = GroundContact("simbody", spheres, self.constants, True)
        system = FootGroundContact_[float](frame.body().index(), ground)
        place = str(frame.scoped_name()).replace("::", "_")
        system.set_name(f"{system.get_name()}_{place}")
        return system

    def checks(self, where: str) -> tuple[Check, Check]:
        """Notes on how near the law, told of as `where`, is to its sole."""
        rows = (
            ("force", self.force_error_rms, _FORCE, "", "forces"),
            ("cop", self.cop_error_rms_m, _COP_M, "m", "centres of pressure"),
        )
        return tuple(
            Check(
                f"sole.{what}", value <= limit, value, limit, unit, where,
                f"{signals} of the law differ by so much (RMS) from those of "
                "the sole that it stands for; more spheres (sole reduce) may "
                "come nearer",
                "note",
            )
            for what, value, limit, unit, signals in rows
        )  # fmt: skip

    def ground(
        self, model: Model, at_m: tuple[float, float] | None = None
    ) -> GroundContact:
        """Ground contact of the model's feet wearing this sole.

        Args:
            model: with rigid toes. If its one leg stands for both, the modulus
                is that of two soles.
            at_m: the sole frame's origin (x, z) in the foot [m]; by default x
                is midway between the foot's own spheres, and the sole's bottom
                on the floor of the standing trial.

        Raises:
            InputError: toes are hinged, or the sole lies above the ankle.
        """
        self.check_worn(model.assembly.human)
        if at_m is None:
            x = [x for x, _ in model.spheres.values()]
            floor = -model.human.ankle_height_m
            at_m = 0.5 * (min(x) + max(x)), floor + self.size_m[2]
        bottom = float(at_m[1] - self.size_m[2])
        if bottom >= 0.0:
            raise InputError(
                f"foot_ground.sole_at_m: the bottom of the sole lies at z = "
                f"{bottom:g} m in the foot, not below its ankle; give (x, z) "
                "of the sole's frame from there, z upwards, in metres"
            )
        soles = 1 if model.assembly.human.sides else 2
        spheres = {
            name: ContactSphere(
                soles * s.modulus_n_m2,
                s.dissipation_s_m,
                float(at_m[0] + s.x_m),
                float(at_m[1] + s.z_m),
                s.radius_m,
            )
            for name, s in self.spheres.items()
        }
        return GroundContact("simbody", spheres, self.constants, True).checked()


@dataclass(frozen=True, repr=False, eq=False)
class Reduction:
    """S spheres fitted to a sole's N samples, and their forces there.

    Attributes:
        samples: what they were fitted to, of `dx.soles.sole_samples`.
        planar: whether y and roll were left out.
        stiffness: plane-strain modulus of each sphere [N/m²], (S,).
        place: centre of each in the sole frame [m], (S, 3).
        constants: of the law.
        interval: 95 % half-widths of log stiffness and place [m], (S, 4).
        force: vertical force of the spheres at each sample [N], (N,).
        cop: centre of pressure of the spheres [m], (N, 2).
        arm: mean distance of their force from it [m], (N,).
    """

    samples: NamedTuple
    planar: bool
    stiffness: np.ndarray
    place: np.ndarray
    constants: SimbodyConstants
    interval: np.ndarray
    force: np.ndarray
    cop: np.ndarray
    arm: np.ndarray

    def __repr__(self) -> str:
        # Without the arrays: a notebook prints this for its last line.
        return (
            f"Reduction({len(self.stiffness)} spheres; force off by "
            f"{100.0 * self.force_error:.1f} %, centre of pressure by "
            f"{1e3 * self.cop_error:.1f} mm RMS)"
        )

    @property
    def force_error(self) -> float:
        """RMS error of the force as share of the sole's largest force."""
        off = self.force - self.samples.force
        return float(np.sqrt(np.mean(off**2)) / self.samples.force.max())

    @property
    def cop_error(self) -> float:
        """RMS error of the centre of pressure where loaded [m]."""
        off = (self.cop - self.samples.cop)[loaded(self.samples)]
        off = off[:, :1] if self.planar else off
        return float(np.sqrt((off**2).sum(axis=1).mean()))

    @property
    def _spins(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest free moment [N m] that friction bears: sole, spheres."""
        mine = self.samples
        mu = mine.friction
        return mu * mine.force * mine.arm, mu * self.force * self.arm

    @property
    def spin_error(self) -> float | None:
        """RMS error of the largest free moment as share of the sole's largest.

        It is the moment at which the sole turns about its centre of pressure.
        None in the plane.
        """
        if self.planar:
            return None
        sole, spheres = self._spins
        return float(np.sqrt(np.mean((spheres - sole) ** 2)) / sole.max())

    @property
    def support_share(self) -> float | None:
        """Least reach of the support polygon as share of the outline's.

        Both are from the sole's middle, in the same direction; the outline is
        the rectangle around the sole. Beyond the polygon a foot tips over.
        Below 0 the middle is outside of it. None in the plane.
        """
        if self.planar:
            return None
        turn = np.linspace(0.0, 2 * np.pi, 361)
        ways = np.stack([np.cos(turn), np.sin(turn)])
        mine = self.samples
        polygon = ((self.place[:, :2] - mine.middle) @ ways).max(axis=0)
        outline = 0.5 * mine.size[:2] @ np.abs(ways)
        return float((polygon / outline).min())

    @property
    def is_near(self) -> bool:
        """Whether these RMS errors are within 3 % and 2 mm."""
        return self.force_error <= _FORCE and self.cop_error <= _COP_M

    def table(self) -> dict[str, np.ndarray]:
        """Columns (N,): force, CoP and, in space, the largest free moment."""
        mine = self.samples
        columns = {
            "force_n": mine.force,
            "force_spheres_n": self.force,
            "cop_x_m": mine.cop[:, 0],
            "cop_x_spheres_m": self.cop[:, 0],
        }
        if not self.planar:
            columns["cop_y_m"] = mine.cop[:, 1]
            columns["cop_y_spheres_m"] = self.cop[:, 1]
            columns["spin_n_m"], columns["spin_spheres_n_m"] = self._spins
        return columns | {"loaded": loaded(mine).astype(int)}

    @property
    def law(self) -> SoleLaw:
        """The contents of law.yaml: spheres in the sole's frame."""
        spheres = {}
        for k, (E, (x, y, z), half) in enumerate(
            zip(self.stiffness, self.place.tolist(), self.interval.tolist(),
                strict=True)
        ):  # fmt: skip
            spheres[f"sphere{k + 1}"] = SoleSphere(
                float(E), float(np.exp(half[0])),
                x_m=x, x_m_95=half[1], y_m=y, y_m_95=half[2],
                z_m=z, z_m_95=half[3],
            )  # fmt: skip
        return SoleLaw(
            tuple(self.samples.size.tolist()),
            spheres,
            self.constants,
            self.planar,
            self.force_error,
            self.cop_error,
            self.spin_error,
            self.support_share,
        )

    def write(self, path: Path | str) -> None:
        """Write the law, and `table` beside it as .csv.

        Raises:
            InputError: there is one sphere alone, or writing fails.
        """
        path, text = path_of(path, "path"), schema.dump_text(self.law)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            write_csv(path.with_suffix(".csv"), self.table())
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); choose "
                "another place for it"
            ) from error


def borne(samples: NamedTuple, stiffness, place, constants):
    """Force and centre of pressure of spheres at rest in each pose.

    Stiffness, place and constants are those of `Reduction`.

    Returns:
        Sum of the vertical forces (N,) [N], centre of pressure (N, 2) [m].
    """
    normal, centre = _pressed(samples, stiffness, place, constants)
    total = normal.sum(axis=1)
    cop = np.einsum("ns,nsi->ni", normal, centre[..., :2])
    return total, cop / np.maximum(total, 1e-9)[:, None]


def _pressed(samples: NamedTuple, stiffness, place, constants):
    """Vertical force (N, S) and centre (N, S, 3) of each sphere."""
    turned = place @ np.swapaxes(samples.rotation, 1, 2)
    centre = samples.origin[:, None] + turned
    depth, rest = CONTACT_RADIUS_M - centre[..., 2], np.zeros(centre.shape[:2])
    normal, _ = sphere_force(
        "simbody", depth, rest, rest, stiffness, 0.0, CONTACT_RADIUS_M,
        constants,
    )  # fmt: skip
    return normal, centre


def _arm(samples: NamedTuple, cop, *spheres) -> np.ndarray:
    """Mean distance of spheres' force from the centre of pressure (N,) [m]."""
    normal, centre = _pressed(samples, *spheres)
    away = np.linalg.norm(centre[..., :2] - cop[:, None], axis=2)
    total = np.maximum(normal.sum(axis=1), 1e-9)
    return (normal * away).sum(axis=1) / total


def reduce_sole(
    samples: NamedTuple, spheres: int = 4, planar: bool = False
) -> Reduction:
    """Fit spheres to a simulated sole, for use in a study of a person.

    With `replace` from `dataclasses`:

    >>> import drake_exo as dx
    >>> zmp = [[0.01 * k, 0.0] for k in range(-4, 5)]
    >>> times = [0.1 * k for k in range(9)]
    >>> load = dx.soles.Load(times, [[0, 0, 300.0]] * 9, zmp)
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> samples = dx.soles.sole_samples(replace(case, load=load).simulate())
    >>> found = dx.contact.reduce_sole(samples, 2, planar=True)
    >>> found.law.spheres["sphere1"].modulus_n_m2 > 1e6
    True
    >>> found.is_near, found.force_error < 0.03, found.cop_error < 2e-3
    (True, True, True)

    Args:
        samples: the result of `dx.soles.sole_samples`.
        spheres: their number S.
        planar: fit without y and roll, as for the foot of a planar model;
            forward is the sole's mean heading.

    Returns:
        Spheres and errors; its `write` makes the file for `foot_ground.law`.

    Raises:
        InputError: the samples are not a sole's, spheres < 1, or the distinct
            samples hold fewer values than there are unknowns.
    """
    if not hasattr(samples, "middle"):
        raise InputError(
            "samples are not those of a sole; give what dx.soles.sole_samples "
            "returns for a step, or for its folder"
        )
    check_count(spheres, 1, "spheres")
    columns = [0, 1, 3] if planar else [0, 1, 2, 3]
    unknowns = spheres * len(columns) + 1
    if planar:
        samples = _in_plane(samples)
    first, bears = _that_differ(samples), loaded(samples)
    known = len(first)
    known += (1 if planar else 2) * np.count_nonzero(bears[first])
    if known < unknowns:
        raise InputError(
            f"samples ({len(first)} that differ) do not determine {unknowns} "
            f"unknowns of {spheres} spheres; take fewer spheres or a longer "
            "step"
        )
    largest = samples.force.max()
    scale = np.array([1.0, *(0.1 * samples.size[:2]), 1e-3])

    def unpacked(u):
        full = np.zeros((spheres, 4))
        full[:, columns] = u[1:].reshape(spheres, -1)
        full = full * scale
        touch = [*samples.middle, CONTACT_RADIUS_M - samples.size[2]]
        place = full[:, 1:] + touch
        constants = softened(float(np.exp(u[0])), samples.friction)
        return np.exp(full[:, 0]), place, constants

    def residuals(u):
        total, cop = borne(samples, *unpacked(u))
        off = (cop - samples.cop)[bears]
        off = off[:, :1] if planar else off
        return np.concatenate(
            [(total - samples.force) / (_FORCE * largest), off.ravel() / _COP_M]
        )

    def bound(share, *row):
        return np.r_[np.log(share), np.tile(np.array(row)[columns], spheres)]

    low = bound(0.003, np.log(_LOWER_N_M2), -6.0, -6.0, -20.0)
    high = bound(1.0, np.log(_UPPER_N_M2), 6.0, 6.0, 20.0)
    fits = [
        least_squares(
            residuals,
            np.clip(guess, low + 1e-6, high - 1e-6),
            bounds=(low, high),
            x_scale="jac",
            max_nfev=300,
        )
        for guess in _guesses(spheres, columns, depth(samples))
    ]
    best = min(fits, key=lambda found: found.cost)
    found = unpacked(best.x)
    half = np.zeros((spheres, 4))
    width = np.minimum(_SD * _deviations(best), high - low)
    half[:, columns] = width[1:].reshape(spheres, -1)
    force, cop = borne(samples, *found)
    arm = _arm(samples, cop, *found)
    return Reduction(samples, planar, *found, half * scale, force, cop, arm)


def _deviations(best) -> np.ndarray:
    """Standard deviations (m,) of the unknowns, by the Gauss–Newton Hessian.

    Noise is the scatter of the residuals. They are very large where the samples
    determine nothing, as for a sphere that never touches the ground.
    """
    told, ways = np.linalg.eigh(best.jac.T @ best.jac)
    spare = max(len(best.fun) - len(best.x), 1)
    variance = ways**2 @ (1 / np.maximum(told, 1e-15 * told.max()))
    return np.sqrt(variance * 2 * best.cost / spare)


def _that_differ(samples: NamedTuple) -> np.ndarray:
    """Indices (K,) of samples that differ by over 1 µm or a millionth.

    Repetitions of the same pose and load count as one sample.
    """
    count = len(samples.force)
    told = np.column_stack(
        [
            samples.origin, samples.rotation.reshape(count, 9),
            samples.force / samples.force.max(), samples.cop,
        ]
    )  # fmt: skip
    return np.unique(told.round(6), axis=0, return_index=True)[1]


def _in_plane(samples: NamedTuple) -> NamedTuple:
    """Samples projected on the vertical plane of the sole's mean heading.

    Roll, sideways positions and yaw about the mean heading are dropped.
    """
    R = samples.rotation
    yaw = np.arctan2(-R[:, 0, 1].sum(), R[:, 0, 0].sum())
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    pitch = np.arcsin(np.clip(R[:, :2, 2] @ ahead, -1, 1))
    c, s, zero, one = np.cos(pitch), np.sin(pitch), 0 * pitch, 0 * pitch + 1
    turn = np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]])
    x, height = samples.origin[:, :2] @ ahead, samples.origin[:, 2]
    return samples._replace(
        origin=np.stack([x, zero, height], axis=1),
        rotation=np.moveaxis(turn, 2, 0),
        cop=np.stack([samples.cop @ ahead, zero], axis=1),
        middle=samples.middle * [1, 0],
    )


def _guesses(spheres: int, columns, depth: float):
    """First guesses: spheres spread over the sole, soft to stiff."""
    rng = np.random.default_rng(0)
    x = np.linspace(-4.0, 4.0, spheres)
    y = np.where(np.arange(spheres) % 2, -3.0, 3.0)
    for k in range(_STARTS):
        log_E = np.log([1e6, 1e7, 1e8][k % 3]) * np.ones(spheres)
        full = np.stack([log_E, x, y, np.zeros(spheres)], axis=1)
        full[:, 1:3] += 0.7 * rng.standard_normal((spheres, 2))
        share = np.log(min(depth / _USUAL_DEPTH_M, 0.9))
        yield np.r_[share, full[:, columns].ravel()]
