"""What acts on a model besides ground and cuffs, inside a program.

A measured wrench, such as the chair's, is data at each node, but where the
body is is not: a chair bears hundreds of newtons, and a hip that lies a
centimetre from where markers saw it changes joint moments by newton metres. So
its generalized force depends on q as in the Diagram, instead of being
evaluated along the measured motion. A controller is a LeafSystem that gives
the device's torques.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.framework import System
from scipy.interpolate import CubicSpline

from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    MOMENT_UNIT,
    BodyWrench,
)
from drake_exo.errors import InputError, reason
from drake_exo.model.planar_tree import PlanarTree


class AppliedWrench:
    """Wrenches over time, each on bodies of a model by share.

    Args:
        tree: the model.
        times: (n,) increasing [s].
        parts: m pairs: body name -> share of the wrench, and the wrench
            (n, 3): F_x, F_z [N] and M_y = z F_x - x F_z about the
            laboratory's origin [N m].
    """

    def __init__(
        self,
        tree: PlanarTree,
        times: np.ndarray,
        parts: Sequence[tuple[Mapping[str, float], np.ndarray]],
    ):
        self._spline = CubicSpline(times, np.hstack([w for _, w in parts]))
        self._bodies = [
            (slice(3 * i, 3 * i + 3), share, BodyWrench(tree, name))
            for i, (shares, _) in enumerate(parts)
            for name, share in shares.items()
        ]

    def at(self, times: np.ndarray) -> np.ndarray:
        """The wrenches (n, 3 m) at times [s]."""
        return self._spline(times)

    def generalized(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Generalized forces (n, nq) of wrenches (n, 3 m) at positions q."""
        return sum(
            k * b.generalized(q, wrench[:, own]) for own, k, b in self._bodies
        )

    def by_positions(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Derivatives (n, nq, nq) of `generalized` by q."""
        return sum(
            k * b.by_positions(q, wrench[:, own]) for own, k, b in self._bodies
        )


class LoadedDynamicsKernel:
    """A kernel of equations of motion, with an applied wrench.

    Inputs and outputs as those of the inner kernel, whose inputs start with
    q. Data: (n, 3 m) wrenches, as `AppliedWrench.at`; None for no load.

    Args:
        inner: such as DynamicsKernel; gets no data itself.
        load: the wrench.
    """

    def __init__(self, inner, load: AppliedWrench):
        self._inner = inner
        self._load = load
        nq = self._num_positions = inner.sparsity.shape[0]
        self.sparsity = inner.sparsity.copy()
        self.sparsity[2:, :nq] = True
        if hasattr(inner, "curvature"):  # the load's own is small
            self.curved_inputs = inner.curved_inputs
            self.curvature = inner.curvature

    def evaluate(self, x, data):
        """See Kernel."""
        r = self._inner.evaluate(x, None)
        if data is None:
            return r
        q = x[:, : self._num_positions]
        return r - self._load.generalized(q, data) / FORCE_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        J = self._inner.jacobian(x, None)
        if data is None:
            return J
        nq = self._num_positions
        J = J.copy()
        J[:, :, :nq] -= self._load.by_positions(x[:, :nq], data) / FORCE_UNIT
        return J


STATE_PORT = "exoskeleton_state"
TORQUE_PORT = "exoskeleton_torques"


class ControllerKernel:
    """Torques that a stateless controller gives, minus the control.

    Inputs: the angles, rates and torques of the device's m joints. Data:
    (n, 1) time [s]. Outputs (m): differences in units of 100 N m.

    Args:
        controller: has the input port exoskeleton_state (2 m: angles, rates)
            and the output port exoskeleton_torques (m) [N m], no state, and
            converts to AutoDiffXd.
        num_joints: m.

    Raises:
        InputError: it is not such a system.
    """

    def __init__(self, controller: System, num_joints: int):
        self._m = m = num_joints
        if not isinstance(controller, System):
            raise InputError(
                f"the controller is {controller!r}, no Drake system; give an "
                "object, such as AssistController()"
            )
        if not controller.HasInputPort(STATE_PORT):
            raise InputError(f"the controller has no input port '{STATE_PORT}'")
        if not controller.HasOutputPort(TORQUE_PORT):
            raise InputError(
                f"the controller has no output port '{TORQUE_PORT}'"
            )
        if controller.num_continuous_states() > 0 or (
            controller.num_discrete_state_groups() > 0
        ):
            raise InputError(
                "the controller has state of its own; a prediction takes one "
                "that depends on time and the exoskeleton's motion alone"
            )
        try:
            derivative = controller.ToAutoDiffXd()
        except Exception as error:  # it is the user's own code
            raise InputError(
                "the controller does not convert to AutoDiffXd; define it "
                f"with TemplateSystem ({reason(error)})"
            ) from error
        self._systems = {
            False: (controller, controller.CreateDefaultContext()),
            True: (derivative, derivative.CreateDefaultContext()),
        }
        self._try()
        self.sparsity = np.hstack(
            [np.ones((m, 2 * m), bool), np.eye(m, dtype=bool)]
        )

    def _try(self) -> None:
        """Ask for torques at rest, with and without derivatives.

        Raises:
            InputError: ports of other sizes, or it cannot say.
        """
        try:
            rest = np.zeros(2 * self._m)
            at_rest = self._torque(rest, 0.0, False)
            self._torque(InitializeAutoDiff(rest).ravel(), 0.0, True)
        except Exception as error:  # it is the user's own code
            raise InputError(
                f"the controller gives no torques at rest ({reason(error)}); "
                f"{STATE_PORT} must have {2 * self._m} values, and all it needs"
            ) from error
        if at_rest.shape != (self._m,) or not np.isfinite(at_rest).all():
            raise InputError(
                f"the controller's {TORQUE_PORT} must be {self._m} finite "
                "numbers"
            )

    def _torque(self, state, time, derivatives):
        system, context = self._systems[derivatives]
        context.SetTime(time)
        system.GetInputPort(STATE_PORT).FixValue(context, state)
        return system.GetOutputPort(TORQUE_PORT).Eval(context)

    def evaluate(self, x, data):
        """See Kernel."""
        torque = np.stack(
            [
                self._torque(row[: 2 * self._m], float(t), False)
                for row, t in zip(x, data[:, 0], strict=True)
            ]
        )
        return (torque - x[:, 2 * self._m :]) / MOMENT_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        m = self._m
        J = np.zeros((len(x), m, 3 * m))
        for i, (row, t) in enumerate(zip(x, data[:, 0], strict=True)):
            torque = self._torque(
                InitializeAutoDiff(row[: 2 * m]).ravel(), float(t), True
            )
            gradient = ExtractGradient(torque)
            # Empty where the controller depends on time alone.
            if gradient.size:
                J[i, :, : 2 * m] = gradient
        J[:, np.arange(m), 2 * m + np.arange(m)] = -1.0
        return J / MOMENT_UNIT
