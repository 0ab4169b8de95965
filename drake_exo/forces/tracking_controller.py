"""A joint-torque controller that follows a trajectory."""

import numpy as np
from pydrake.systems.framework import LeafSystem
from scipy.interpolate import CubicSpline


class TrackingController(LeafSystem):
    """Feed-forward torques plus proportional-derivative feedback.

    Input state (q, v); output joint_torques, one for each coordinate after
    the foot's three [N m].

    Args:
        times: (n,) [s].
        q, v: (n, nq) reference.
        torque: (n, nq - 3) feed-forward [N m].
        stiffness: of the feedback [N m/rad].
        damping: of the feedback [N m s/rad].
    """

    def __init__(self, times, q, v, torque, stiffness=500.0, damping=30.0):
        super().__init__()
        self.set_name("tracking_controller")
        self._q = CubicSpline(times, q)
        self._v = CubicSpline(times, v)
        self._torque = CubicSpline(times, torque)
        self._gains = stiffness, damping
        self._num_positions = nq = q.shape[1]
        self.DeclareVectorInputPort("state", 2 * nq)
        self.DeclareVectorOutputPort("joint_torques", nq - 3, self._calc)

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        q, v = np.split(state, [self._num_positions])
        t = context.get_time()
        stiffness, damping = self._gains
        torque = self._torque(t)
        torque = torque + stiffness * (self._q(t) - q)[3:]
        torque = torque + damping * (self._v(t) - v)[3:]
        output.SetFromVector(torque)
