"""What a designed device gives at a joint, by what it gives today.

Either a factor on today's torque, over the joint's angle or the movement's
time; or the gains of a controller, which adds a spring and a damper of its own.
Each is linear in its coefficients.
"""

import sys
from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass, field
from typing import Literal

import numpy as np
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.interpolate import BSpline

from drake_exo.errors import InputError


def gain_parts(today, angle, rate) -> tuple:
    """Torque by each of `Gains`: plain arithmetic, any kind of scalar.

    Args:
        today: torque without the design [N m].
        angle: of the joint [rad].
        rate: of the angle [rad/s].
    """
    return today, 1.0 + 0.0 * angle, -angle, -rate


class _Linear(ABC):
    """A torque that is linear in its coefficients."""

    @property
    @abstractmethod
    def coefficients(self) -> np.ndarray:
        """(k,) that the torque is linear in."""

    @abstractmethod
    def parts(self, today, angle, rate, share) -> np.ndarray:
        """Torque by each coefficient, (..., k); of what `torque` is of."""

    def torque(self, today, angle, rate, share) -> np.ndarray:
        """Torque (...) [N m].

        Args:
            today: (...) without the design [N m].
            angle: (...) of the joint [rad].
            rate: (...) of the angle [rad/s].
            share: (...) of the movement's time that is over.
        """
        return self.parts(today, angle, rate, share) @ self.coefficients


@dataclass(frozen=True)
class Gains(_Linear):
    """Of a joint's controller, which adds a spring and a damper.

    torque = support today + constant_nm - stiffness_nm_rad angle -
    damping_nm_s_rad rate. None of it pushes a joint off: neither spring nor
    damper is negative.

    Attributes:
        support: factor on today's torque.
        constant_nm: always there.
        stiffness_nm_rad: of a spring towards the joint's zero.
        damping_nm_s_rad: against the joint's rate.

    >>> firm = Gains(0.5, stiffness_nm_rad=8.0)
    >>> firm.torque(np.array([10.0]), np.array([0.25]), np.zeros(1), 0.5)
    array([3.])
    """

    support: float = field(default=1.0, metadata={"unit": "1", "minimum": 0.0})
    constant_nm: float = field(default=0.0, metadata={"unit": "N m"})
    stiffness_nm_rad: float = field(
        default=0.0, metadata={"unit": "N m/rad", "minimum": 0.0}
    )
    damping_nm_s_rad: float = field(
        default=0.0, metadata={"unit": "N m s/rad", "minimum": 0.0}
    )

    @property
    def coefficients(self) -> np.ndarray:
        """(4,) in this order."""
        return np.array(astuple(self))

    def parts(self, today, angle, rate, share) -> np.ndarray:
        """See _Linear; (..., 4)."""
        found = np.broadcast_arrays(*gain_parts(today, angle, rate))
        return np.stack(found, axis=-1)


@dataclass(frozen=True)
class Assistance(_Linear):
    """Factor on the torque of one joint of the device.

    Attributes:
        factor: at each angle, linear between them and constant beyond; or,
            over the movement, coefficients of a cubic spline (B-splines on
            even knots, clamped).
        angle_deg: of the joint, increasing; empty over the movement.
        over: what the factor depends on: the joint's "angle", or how much of
            the "movement"'s time is over.

    >>> knee = Assistance((0.0, 60.0), (1.2, 0.9))
    >>> knee.torque(np.array([10.0]), np.deg2rad([30.0]), 0.0, 0.5)
    array([10.5])
    >>> spline = Assistance((), (1.0, 1.0, 2.0, 1.0, 1.0), "movement")
    >>> spline.torque(np.ones(2), np.zeros(2), 0.0, np.array([0.0, 0.5]))
    array([1. , 1.5])
    """

    angle_deg: tuple[float, ...] = field(
        default=(0.0,), metadata={"unit": "deg"}
    )
    factor: tuple[float, ...] = field(default=(1.0,), metadata={"minimum": 0.0})
    over: Literal["angle", "movement"] = "angle"

    def __post_init__(self):
        if self.over == "movement":
            if self.angle_deg or not self.factor:
                raise InputError(
                    "over the movement there are factors alone; leave "
                    "angle_deg empty"
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
        """The factors."""
        return np.array(self.factor)

    def parts(self, today, angle, rate, share) -> np.ndarray:
        """See _Linear."""
        if self.over == "movement":
            weights = splines(len(self.factor), share)
        else:
            weights = hats(self.angle_deg, angle)
        return weights * np.asarray(today)[..., None]


def hats(angle_deg, angle: np.ndarray) -> np.ndarray:
    """Weights (..., k) of values at k angles [deg], at angles (...) [rad]."""
    points = np.deg2rad(angle_deg)
    return np.stack(
        [np.interp(angle, points, row) for row in np.eye(len(points))], axis=-1
    )


def splines(count: int, share) -> np.ndarray:
    """Weights (..., count) of a spline's coefficients, at shares (...)."""
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
        """Gains on what a device gives today.

        Input exoskeleton_state (2 m): angles [rad], then rates [rad/s] of the
        device's joints; today_torques (m): what its own controller asks for
        [N m], zero where not connected. Output exoskeleton_torques (m) [N m].
        Numeric parameters: of each joint its `Gains`, in their order.

        Args of the constructor:
            gains: (m) of the joints; a context starts with these.

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
            self._gains = tuple(gains)
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


GainController = GainController_[None]
