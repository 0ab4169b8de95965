"""Design of a device as it is to be built: cuffs, straps, joints and torques.

A cuff is tissue and strap in series, 1/k = 1/k_tissue + 1/k_strap. Calibration
finds k. Only the strap can be designed; the tissue is the person's, and the
same wherever the cuff is moved. The present strap counts as rigid, so all of
the calibrated compliance is tissue: a new strap can soften a cuff, not stiffen
it.

A joint's torque is today's (that without the design) times a factor over the
joint's angle or over time, or a share of today's plus a controller's spring
and damper. Both are linear in their coefficients.
"""

import sys
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.interpolate import BSpline

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.systems import made_on_demand
from drake_exo.errors import InputError, path_of
from drake_exo.files import schema
from drake_exo.files.output import read_bytes
from drake_exo.files.schema import quantity
from drake_exo.model.description import (
    body_width,
    exoskeleton_sdf,
    hinged,
    without_cuffs,
)
from drake_exo.model.planar_tree import DEVICE
from drake_exo.model.plant import Model

# Bound of a share of today's value; a larger one was given in per cent.
OF_TODAY = {"maximum": 50.0}


def gain_parts(today, angle, rate) -> tuple:
    """Derivative of the torque by each of `Gains`, for any scalar type.

    Args:
        today: torque without the design [N m].
        angle: of the joint [rad].
        rate: of the angle [rad/s].
    """
    return today, 1.0 + 0.0 * angle, -angle, -rate


class _Linear:
    """A torque that is linear in its `coefficients` (k,).

    `parts` is its derivative by them, (..., k), with the arguments of `torque`.
    """

    def torque(self, today, angle, rate, share) -> np.ndarray:
        """Torque (...) [N m].

        Args:
            today: (...) without the design [N m].
            angle: (...) of the joint [rad].
            rate: (...) of the angle [rad/s].
            share: (...) elapsed share of the movement's time, 0 to 1.
        """
        return self.parts(today, angle, rate, share) @ self.coefficients


@dataclass(frozen=True)
class Gains(_Linear):
    """Gains of a joint's controller, which adds a spring and a damper.

    torque = support today + constant_nm - stiffness_nm_rad angle -
    damping_nm_s_rad rate. Neither spring nor damper may be negative, so that
    the feedback does not destabilise the joint.

    Attributes:
        support: factor on the torque without the design.
        constant_nm: constant torque.
        stiffness_nm_rad: of a spring towards the joint's zero.
        damping_nm_s_rad: of a damper against the joint's rate.

    >>> firm = Gains(0.5, stiffness_nm_rad=8.0)
    >>> firm.torque(np.array([10.0]), np.array([0.25]), np.zeros(1), 0.5)
    array([3.])
    """

    support: float = quantity("1", 1.0, minimum=0.0, **OF_TODAY)
    constant_nm: float = quantity("N m", 0.0)
    stiffness_nm_rad: float = quantity("N m/rad", 0.0, minimum=0.0)
    damping_nm_s_rad: float = quantity("N m s/rad", 0.0, minimum=0.0)

    @property
    def coefficients(self) -> np.ndarray:
        """The four gains (4,) in the order of the fields."""
        return np.array(astuple(self))

    def parts(self, today, angle, rate, share) -> np.ndarray:
        """Derivative of the torque by the gains, (..., 4)."""
        found = np.broadcast_arrays(*gain_parts(today, angle, rate))
        return np.stack(found, axis=-1)


@dataclass(frozen=True)
class Assistance(_Linear):
    """Factor on the torque of one joint of the device.

    Attributes:
        factor: one at each angle, linear between and constant beyond; or, if
            `over` is "movement", coefficients of a cubic B-spline on even,
            clamped knots.
        angle_deg: angles of the joint, increasing; empty for "movement".
        over: what the factor depends on: the joint's "angle", or the elapsed
            share of the "movement"'s time.

    >>> knee = Assistance((0.0, 60.0), (1.2, 0.9))
    >>> knee.torque(np.array([10.0]), np.deg2rad([30.0]), 0.0, 0.5)
    array([10.5])
    >>> spline = Assistance((), (1.0, 1.0, 2.0, 1.0, 1.0), "movement")
    >>> spline.torque(np.ones(2), np.zeros(2), 0.0, np.array([0.0, 0.5]))
    array([1. , 1.5])
    """

    angle_deg: tuple[float, ...] = quantity("deg", (0.0,))
    factor: tuple[float, ...] = quantity(None, (1.0,), minimum=0.0, **OF_TODAY)
    over: Literal["angle", "movement"] = "angle"

    def __post_init__(self):
        if self.over == "movement":
            if self.angle_deg or not self.factor:
                raise InputError(
                    "an assistance over the movement is given by factors "
                    "alone; leave angle_deg empty"
                )
            return
        if not self.angle_deg or len(self.angle_deg) != len(self.factor):
            raise InputError(
                f"{len(self.factor)} factors at {len(self.angle_deg)} angles; "
                "give one at each"
            )
        if (np.diff(self.angle_deg) <= 0.0).any():
            raise InputError("angle_deg does not increase; put it in order")

    @property
    def coefficients(self) -> np.ndarray:
        """The factors (k,)."""
        return np.array(self.factor)

    def parts(self, today, angle, rate, share) -> np.ndarray:
        """Derivative of the torque by the factors, (..., k)."""
        if self.over == "movement":
            weights = splines(len(self.factor), share)
        else:
            weights = hats(self.angle_deg, angle)
        return weights * np.asarray(today)[..., None]


def hats(angle_deg, angle: np.ndarray) -> np.ndarray:
    """Weights (..., k) interpolating between k angles [deg], at (...) [rad]."""
    points = np.deg2rad(angle_deg)
    return np.stack(
        [np.interp(angle, points, row) for row in np.eye(len(points))], axis=-1
    )


def splines(count: int, share) -> np.ndarray:
    """Values (..., count) of clamped B-splines at shares (...) in [0, 1]."""
    degree = min(3, count - 1)
    inner = np.linspace(0.0, 1.0, count - degree + 1)
    knots = np.pad(inner, degree, mode="edge")
    share = np.clip(np.asarray(share, float), 0.0, 1.0)
    found = BSpline.design_matrix(share.ravel(), knots, degree).toarray()
    return found.reshape(*share.shape, count)


@TemplateSystem.define("GainController_", scope=sys.modules[__name__])
def GainController_(T):
    """See `GainController`."""

    class Impl(LeafSystem_[T]):
        """Controller of a device's m joints with the torques of `Gains`.

        Input exoskeleton_state (2 m): angles [rad], then rates [rad/s] of the
        device's joints; today_torques (m): torques of its present controller
        [N m], zero if not connected. Output exoskeleton_torques (m) [N m].
        Numeric parameters: a vector for each joint, the fields of its `Gains`.

        Args of the constructor:
            gains: (m) `Gains` of the joints; a context starts with these.

        >>> knee = Gains(0.5, stiffness_nm_rad=8.0)
        >>> controller = GainController([knee])
        >>> context = controller.CreateDefaultContext()
        >>> port = controller.GetInputPort("exoskeleton_state")
        >>> port.FixValue(context, [0.25, 0.0]) and None
        >>> port = controller.GetOutputPort("exoskeleton_torques")
        >>> port.Eval(context)
        array([-2.])
        """

        def _construct(self, gains, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self.set_name("gain_controller")
            self._gains = tuple(schema.check(g, Gains, "gains") for g in gains)
            m = len(self._gains)
            for own in self._gains:
                self.DeclareNumericParameter(BasicVector_[T](astuple(own)))
            self.DeclareVectorInputPort("exoskeleton_state", 2 * m)
            self.DeclareVectorInputPort("today_torques", m)
            self.DeclareVectorOutputPort("exoskeleton_torques", m, self._calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._gains, converter=converter)

        def _calc(self, context, output):
            state = self.GetInputPort("exoskeleton_state").Eval(context)
            port = self.GetInputPort("today_torques")
            m = len(self._gains)
            today = port.Eval(context) if port.HasValue(context) else [0.0] * m
            for i in range(m):
                own = context.get_numeric_parameter(i).CopyToVector()
                parts = gain_parts(today[i], state[i], state[m + i])
                torques = [k * x for k, x in zip(own, parts, strict=True)]
                output.SetAtIndex(i, sum(torques))

    return Impl


__getattr__ = made_on_demand(globals())


DESIGN = "design.yaml"
TODAY = "today"  # folder beside it, with the contact before the design
EXTRAPOLATED = "EXTRAPOLATED beyond what was calibrated"
# Bounds of how far a cuff or joint moves [m]; more is not given in metres.
SHIFT = {"minimum": -1.0, "maximum": 1.0}
# Lower bounds of a strap's stiffness; softer, a cuff no longer holds a limb.
SOFTEST_N_M = 1000.0
SOFTEST_NM_RAD = 5.0
# From this stiffness on a strap adds next to no compliance to the tissue.
STIFF = {"N/m": 5e5, "N m/rad": 5e3}
# A cuff's stiffness -> field of `CuffDesign` for the strap in series with it.
STRAPS = {
    "tangential_stiffness": "strap_tangential_n_m",
    "normal_stiffness": "strap_normal_n_m",
    "rotational_stiffness": "strap_rotational_nm_rad",
}
# Exponent of the skin's area in each stiffness: springs in parallel add up;
# in rotation it is squared, since their lever arm grows as well.
_BY_AREA = {
    "tangential_stiffness": 1,
    "normal_stiffness": 1,
    "rotational_stiffness": 2,
}
BY_AREA = tuple(_BY_AREA.values())
# Release of a cuff -> stiffness that it takes away.
RELEASES = {"slide": "tangential_stiffness", "hinge": "rotational_stiffness"}
# Field of `BushingParameters` -> field of `CuffDesign` added to it.
PLACES = {
    "origin_x": "across_m",
    "origin_z": "along_m",
    "preload_x": "preload_across_m",
    "preload_z": "preload_along_m",
}


@dataclass(frozen=True)
class CuffDesign:
    """Changes of one cuff against the calibrated one.

    Attributes:
        removed: whether it is left out; all else is then ignored.
        along_m, across_m: how far it moves up the limb, and forwards.
        preload_along_m, preload_across_m: how far the device's half alone is
            shifted, so that the cuff presses while the chains are aligned.
        area: area of skin as a factor on the present one; the tissue under it
            acts as springs in parallel.
        slide, hinge: share of the tangential, and of the rotational, spring
            that a passive slide or hinge takes away: 1 if it moves freely.
        strap_tangential_n_m, strap_normal_n_m, strap_rotational_nm_rad:
            stiffness of the strap in series; null: rigid.

    >>> soft = CuffDesign(along_m=0.05, strap_normal_n_m=5000.0)
    >>> built = soft.built(BushingParameters(origin_z=0.25))
    >>> built.origin_z, built.normal_stiffness
    (0.3, 2500.0)
    >>> CuffDesign(hinge=1.0).built(BushingParameters()).rotational_stiffness
    0.0
    """

    removed: bool = False
    along_m: float = quantity("m", 0.0, **SHIFT)
    across_m: float = quantity("m", 0.0, **SHIFT)
    preload_along_m: float = quantity("m", 0.0, **SHIFT)
    preload_across_m: float = quantity("m", 0.0, **SHIFT)
    area: float = quantity("1", 1.0, above=0.0, **OF_TODAY)
    slide: float = quantity("1", 0.0, minimum=0.0, maximum=1.0)
    hinge: float = quantity("1", 0.0, minimum=0.0, maximum=1.0)
    strap_tangential_n_m: float | None = quantity(
        "N/m", None, minimum=SOFTEST_N_M
    )
    strap_normal_n_m: float | None = quantity("N/m", None, minimum=SOFTEST_N_M)
    strap_rotational_nm_rad: float | None = quantity(
        "N m/rad", None, minimum=SOFTEST_NM_RAD
    )

    def built(self, cuff: BushingParameters) -> BushingParameters:
        """The calibrated bushing with these changes."""
        moved = {k: getattr(cuff, k) + getattr(self, PLACES[k]) for k in PLACES}
        stiffness = {
            k: self.held(k)
            * in_series(
                self.area ** _BY_AREA[k] * getattr(cuff, k),
                getattr(self, strap),
            )
            for k, strap in STRAPS.items()
        }
        return replace(cuff, **moved, **stiffness)

    def held(self, stiffness: str) -> float:
        """Share of a stiffness, by name, that no slide or hinge takes away."""
        taken = (k for k, spring in RELEASES.items() if spring == stiffness)
        return 1.0 - sum(getattr(self, k) for k in taken)


@dataclass(frozen=True)
class JointDesign:
    """Shift of a joint of the device from its present place.

    Attributes:
        along_m, across_m: up and forwards in the link below the joint; all
            that is above moves with it.
    """

    along_m: float = quantity("m", 0.0, **SHIFT)
    across_m: float = quantity("m", 0.0, **SHIFT)


@dataclass(frozen=True)
class Design:
    """All changes of a design, as `design.yaml` holds them.

    Attributes:
        cuffs: cuff -> its changes.
        assistance: joint of the device -> factor on its torque.
        gains: joint of the device -> gains of a controller, instead of that.
        joints: joint of the shipped device (exo_knee, exo_hip) -> its shift.

    >>> Design().cuffs
    {}
    """

    cuffs: dict[str, CuffDesign] = field(default_factory=dict)
    assistance: dict[str, Assistance] = field(default_factory=dict)
    joints: dict[str, JointDesign] = field(default_factory=dict)
    gains: dict[str, Gains] = field(default_factory=dict)

    def __post_init__(self):
        for joint in self.gains:
            if joint in self.assistance:
                raise InputError(
                    f"{joint} has assistance and gains; keep one of them"
                )

    @property
    def given(self) -> dict[str, Assistance | Gains]:
        """Joint -> its assistance or gains; other joints stay as today."""
        return {**self.assistance, **self.gains}

    def torques(
        self, joints, today: np.ndarray, angles, rates, share
    ) -> np.ndarray:
        """Torques (..., m) of joints of the device [N m].

        Args:
            joints: (m,) names.
            today: (..., m) torques without the design [N m].
            angles: (..., m) [rad].
            rates: (..., m) [rad/s].
            share: (...) elapsed share of the movement's time, 0 to 1.
        """
        if not self.given:
            return today
        none = Assistance()
        columns = [
            self.given.get(joint, none).torque(
                today[..., i], angles[..., i], rates[..., i], share
            )
            for i, joint in enumerate(joints)
        ]
        return np.stack(columns, axis=-1)

    @property
    def removed(self) -> tuple[str, ...]:
        """Cuffs that are left out."""
        return tuple(n for n, cuff in self.cuffs.items() if cuff.removed)

    def check(self, model: Model) -> None:
        """Check that the design fits the model's device and leaves it held.

        Raises:
            InputError: it names a cuff or joint that the model has not, or
                leaves out every cuff beyond some joint of the device.
        """
        for what, own, known in (
            ("cuffs", self.cuffs, model.cuffs),
            ("joints", self.joints, movable(model)),
            ("assistance", self.assistance, model.coordinates.device),
            ("gains", self.gains, model.coordinates.device),
        ):
            for name in own:
                if name not in known:
                    raise InputError(
                        f"{DESIGN}: {what}.{name}: the model has none; it has "
                        f"{', '.join(known) or 'none'}"
                    )
        places = model.cuffs
        for name, cuff in self.cuffs.items():
            if cuff.removed:
                continue
            x, z = places[name]
            x, z = x + cuff.across_m, z + cuff.along_m
            model.check_on_limb(f"{DESIGN}: cuffs.{name}", name, (x, z))
            x, z = np.add(model.preload(name), (x, z))
            place = x + cuff.preload_across_m, z + cuff.preload_along_m
            what = f"{DESIGN}: cuffs.{name}: the device's half"
            model.check_on_limb(what, name, place)
        for joint in model.coordinates.device if self.removed else ():
            beyond = links_above(model, joint)
            cuffs = {c for c, (_, k) in model.tree.cuffs.items() if k in beyond}
            if cuffs <= set(self.removed):
                raise InputError(
                    f"without the cuff {' and '.join(sorted(cuffs))} "
                    f"nothing holds the device beyond {joint}, which would "
                    "turn freely; keep one of its cuffs in the design"
                )

    def model(self, model: Model) -> Model:
        """The model with the device's cuffs and joints as designed.

        A device from a file of the user's own stays as in that file, except
        for cuffs that are left out.
        """
        if self.removed:
            model = replace(model, kind=model.assembly.opened(self.removed))
        device = model.exoskeleton
        if device is None:
            return model
        moved = {}
        for name, cuff in self.cuffs.items():
            if cuff.removed:
                continue
            segment = model.assembly.cuffs[name].human
            x, z = device.cuff_m(segment)
            moved[f"{segment}_cuff_m"] = (
                x + cuff.across_m + cuff.preload_across_m,
                z + cuff.along_m + cuff.preload_along_m,
            )
        for name, joint in self.joints.items():
            key = MOVABLE[name]
            x, z = getattr(device, key)
            moved[key] = x + joint.across_m, z + joint.along_m
        return replace(model, exoskeleton=replace(device, **moved))

    def bushings(
        self, cuffs: Mapping[str, BushingParameters]
    ) -> dict[str, BushingParameters]:
        """Cuff -> its bushing as designed, without those left out."""
        return {
            name: self.cuffs[name].built(cuff) if name in self.cuffs else cuff
            for name, cuff in cuffs.items()
            if name not in self.removed
        }

    def contact(self, contact: ContactModel) -> ContactModel:
        """The contact with these cuffs, and its posterior carried over.

        Uncertainty of the tissue is the same wherever a cuff moves. A built
        stiffness k_built, the share s (see `held`) of a k (a for the area) in
        series with a strap, has the derivative (k_built/k)^2/(s a) by k.
        """
        built = replace(contact, bushings=self.bushings(contact.bushings))
        known = contact.posterior
        if known is None:
            return built
        known = known.part(
            [n for n in known.names if n.partition(".")[0] not in self.removed]
        )
        old, new = contact.values(), built.values()
        slope = np.ones(len(known.names))
        values = known.values.copy()
        for i, name in enumerate(known.names):
            if name not in new:
                continue
            cuff, _, what = name.partition(".")
            if what in _BY_AREA:
                own = self.cuffs.get(cuff, CuffDesign())
                share = own.held(what) * own.area ** _BY_AREA[what]
                slope[i] = (
                    (new[name] / old[name]) ** 2 / share if share else 0.0
                )
            values[i] += new[name] - old[name]
        covariance = np.outer(slope, slope) * known.covariance
        return replace(
            built,
            posterior=replace(known, values=values, covariance=covariance),
        )


# Joint that may be moved -> field of `ExoskeletonParameters` for its offset.
MOVABLE = {"exo_knee": "knee_off_m", "exo_hip": "hip_off_m"}


def movable(model: Model) -> tuple[str, ...]:
    """Joints of the device that a design may move."""
    if model.exoskeleton is None:
        return ()
    return tuple(j for j in MOVABLE if j in model.coordinates.device)


def links_above(model: Model, joint: str) -> list[str]:
    """Links of the device beyond one of its joints, which turn with it."""
    tree, column = model.tree, model.coordinates.index(joint)
    return [link for link in tree.names if tree.turning(link)[column]]


def weight_above(model: Model, joint: str) -> float:
    """Weight of `links_above` [N]."""
    device = model.exoskeleton
    masses = [
        getattr(device, link.removeprefix(DEVICE)).mass_kg
        for link in links_above(model, joint)
    ]
    return model.gravity_m_s2 * sum(masses)


def device_sdf(model: Model, design: Design) -> str | None:
    """SDF of the fitted device with its cuffs and joints moved, or removed.

    Returns:
        None without a device, or if it comes from a file of the user's own,
        which says itself where cuffs are.

    >>> from drake_exo.model.plant import nominal_model
    >>> moved = Design({"thigh": CuffDesign(along_m=0.02)})
    >>> "exo_thigh_cuff" in device_sdf(nominal_model("coupled"), moved)
    True
    """
    if model.exoskeleton is None:
        return None
    device = design.model(model).exoskeleton
    text = hinged(exoskeleton_sdf(device, body_width(model.human)))
    segments = [model.assembly.cuffs[c].human for c in design.removed]
    return without_cuffs(text, segments)


def in_series(stiffness: float, strap: float | None) -> float:
    """Stiffness of a cuff with a strap in series; None: a rigid strap."""
    if strap is None or stiffness == 0.0:
        return stiffness
    return 1.0 / (1.0 / stiffness + 1.0 / strap)


def read_design(folder: str | Path) -> Design:
    """Read the design.yaml that `drake-exo design` has written.

    Args:
        folder: its --out folder, or the file itself.

    Raises:
        InputError: the file is missing or empty, or a key or value is invalid.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_design(folder, Design({"thigh": CuffDesign(along_m=0.02)}))
    ...     read_design(folder).cuffs["thigh"].along_m
    0.02
    """
    path = path_of(folder, "folder")
    path = path / DESIGN if path.is_dir() else path
    found = schema.load(path, Design)
    lines = map(bytes.strip, read_bytes(path).splitlines())
    if all(line.startswith(b"#") for line in lines if line):
        raise InputError(
            f"{path}: is empty; write the design again, or 'cuffs: {{}}' for "
            "one that changes nothing"
        )
    return found


def write_design(
    folder: str | Path, design: Design, name: str = DESIGN
) -> None:
    """Write a design into a folder, for `read_design`."""
    text = schema.dump_text(design)
    (Path(folder) / name).write_text(
        "# What is to be built; predict --design and lab --design read it.\n"
        + text,
        encoding="utf-8",
    )
