"""An assist controller, written as a LeafSystem, inside a program."""

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.framework import System

from drake_exo.errors import InputError, reason
from drake_exo.optimal_control.kernels import MOMENT_UNIT

STATE_PORT = "exoskeleton_state"
TORQUE_PORT = "exoskeleton_torques"


class ControllerKernel:
    """Torques that a stateless controller gives, minus the control.

    Inputs: the exoskeleton's angles (3) and rates (3), its torques (3). Data:
    (n, 1) time [s]. Outputs: differences in units of 100 N m.

    Args:
        controller: has the input port exoskeleton_state (6: angles, rates)
            and the output port exoskeleton_torques (3) [N m], no state, and
            converts to AutoDiffXd.

    Raises:
        InputError: it is not such a system.
    """

    def __init__(self, controller: System):
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
            [np.ones((3, 6), bool), np.eye(3, dtype=bool)]
        )

    def _try(self) -> None:
        """Ask for torques at rest, with and without derivatives.

        Raises:
            InputError: ports of other sizes, or it cannot say.
        """
        try:
            at_rest = self._torque(np.zeros(6), 0.0, False)
            self._torque(InitializeAutoDiff(np.zeros(6)).ravel(), 0.0, True)
        except Exception as error:  # it is the user's own code
            raise InputError(
                f"the controller gives no torques at rest ({reason(error)}); "
                f"{STATE_PORT} must have 6 values, and all it needs"
            ) from error
        if at_rest.shape != (3,) or not np.isfinite(at_rest).all():
            raise InputError(
                f"the controller's {TORQUE_PORT} must be 3 finite numbers"
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
                self._torque(row[:6], float(t), False)
                for row, t in zip(x, data[:, 0], strict=True)
            ]
        )
        return (torque - x[:, 6:]) / MOMENT_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        J = np.zeros((len(x), 3, 9))
        for i, (row, t) in enumerate(zip(x, data[:, 0], strict=True)):
            torque = self._torque(
                InitializeAutoDiff(row[:6]).ravel(), float(t), True
            )
            gradient = ExtractGradient(torque)
            # Empty where the controller depends on time alone.
            if gradient.size:
                J[i, :, :6] = gradient
        J[:, np.arange(3), 6 + np.arange(3)] = -1.0
        return J / MOMENT_UNIT
