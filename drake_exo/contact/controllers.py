"""Controllers of joint torques: one that tracks, one that assists.

The second is an example to start from: an assist controller for predictions
is a LeafSystem without state, with the input exoskeleton_state (angles, then
rates of the device's joints) and the output exoskeleton_torques [N m], defined
with TemplateSystem so that it converts to AutoDiffXd. `drake-exo predict
--controller MODULE:NAME` puts it into the program itself.
"""

import numpy as np
from pydrake.systems.framework import LeafSystem, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.interpolate import CubicSpline

from drake_exo.contact.scalars import sin


class TrackingController(LeafSystem):
    """Feed-forward torques plus proportional-derivative feedback.

    Input state (q, v); output joint_torques, one for each hinge [N m].

    Args:
        times: (n,) [s].
        q, v: (n, nq) reference.
        torque: (n, n_joints) feed-forward [N m]; hinges are the last
            coordinates.
        stiffness: of the feedback [N m/rad].
        damping: of the feedback [N m s/rad].

    >>> still = np.zeros((2, 6))
    >>> controller = TrackingController([0.0, 1.0], still, still, still[:, 3:])
    >>> controller.GetOutputPort("joint_torques").size()
    3
    """

    def __init__(self, times, q, v, torque, stiffness=500.0, damping=30.0):
        super().__init__()
        self.set_name("tracking_controller")
        nq, n_joints = q.shape[1], torque.shape[1]
        hinges = slice(nq - n_joints, nq)
        # The torque at rest in the origin; what feedback takes off it.
        at_zero = torque + stiffness * q[:, hinges] + damping * v[:, hinges]
        self._at_zero = CubicSpline(times, at_zero)
        self._feedback = np.zeros((n_joints, 2 * nq))
        self._feedback[:, hinges] = stiffness * np.eye(n_joints)
        rates = slice(2 * nq - n_joints, 2 * nq)
        self._feedback[:, rates] = damping * np.eye(n_joints)
        self.DeclareVectorInputPort("state", 2 * nq)
        self.DeclareVectorOutputPort("joint_torques", n_joints, self._calc)

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        torque = self._at_zero(context.get_time()) - self._feedback @ state
        output.SetFromVector(torque)


@TemplateSystem.define("AssistController_")
def AssistController_(T):
    """See `AssistController`."""

    class Impl(LeafSystem_[T]):
        """Gravity-like support at knee and hip that fades as they extend.

        torque = -support sin(angle) - damping rate, at knee and hip; flexion is
        positive, so support extends.

        Args of the constructor:
            knee_nm, hip_nm: support at a right angle, both legs [N m].
            damping: [N m s/rad].

        Input exoskeleton_state (6): ankle, knee, hip [rad], then rates [rad/s].
        Output exoskeleton_torques (3): ankle, knee, hip [N m].

        >>> controller = AssistController(knee_nm=20.0)
        >>> context = controller.CreateDefaultContext()
        >>> bent = [0.0, 1.5708, 0.0, 0.0, 0.0, 0.0]
        >>> port = controller.GetInputPort("exoskeleton_state")
        >>> port.FixValue(context, bent) and None
        >>> port = controller.GetOutputPort("exoskeleton_torques")
        >>> port.Eval(context).round(2) + 0.0
        array([  0., -20.,   0.])
        """

        def _construct(
            self,
            knee_nm: float = 15.0,
            hip_nm: float = 15.0,
            damping: float = 0.5,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            self.set_name("assist_controller")
            self._support = knee_nm, hip_nm
            self._damping = damping
            self.DeclareVectorInputPort("exoskeleton_state", 6)
            self.DeclareVectorOutputPort("exoskeleton_torques", 3, self._calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, *other._support, other._damping, converter=converter
            )

        def _calc(self, context, output):
            state = self.GetInputPort("exoskeleton_state").Eval(context)
            output.SetAtIndex(0, T(0.0))
            for joint, support in zip((1, 2), self._support, strict=True):
                torque = -support * sin(state[joint])
                torque = torque - self._damping * state[3 + joint]
                output.SetAtIndex(joint, torque)

    return Impl


AssistController = AssistController_[None]
