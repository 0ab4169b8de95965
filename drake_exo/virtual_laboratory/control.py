"""Who moves: the subject, and the device that helps."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Multiplexer
from scipy.interpolate import CubicSpline

from drake_exo.contact.strap import Design
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory.plan import Reference

# Of the subject's own feedback, both legs together.
_STIFFNESS = {"ankle": 3000.0, "knee": 2000.0, "hip": 2000.0}  # N m/rad
_DAMPING = {"ankle": 250.0, "knee": 120.0, "hip": 120.0}  # N m s/rad
_SAMPLE_S = 1e-3
# The device helps when the feet bear this much of the weight.
_ENGAGED = (0.5, 0.9)


@dataclass(frozen=True)
class Friction:
    """Friction of the device's joints, both legs together.

    Attributes:
        viscous: of each joint: ankle, knee, hip [N m s/rad].
        coulomb: likewise [N m].
        speed: at which tanh(1) of the dry friction acts [rad/s].
    """

    viscous: tuple[float, ...] = (0.0, 0.0, 0.0)
    coulomb: tuple[float, ...] = (0.0, 0.0, 0.0)
    speed: float = field(default=0.05, metadata={"unit": "rad/s"})

    def torques(self, rates: np.ndarray) -> np.ndarray:
        """Torques (..., joints) at joint rates (..., joints)."""
        dry = np.array(self.coulomb) * np.tanh(rates / self.speed)
        return -np.array(self.viscous) * rates - dry


class SubjectController(LeafSystem):
    """Feed-forward joint torques and feedback towards a plan.

    Input state; output torques of the human's k joints [N m].

    Args:
        names: coordinates of the coupled model.
        reference: the plan; its ends are held before and after.
        help_expected: (n, k) torques that the device is trusted with.
    """

    def __init__(
        self,
        names: Coordinates,
        reference: Reference,
        help_expected: np.ndarray,
    ):
        super().__init__()
        self._body, self._nq = names.body_columns, len(names)
        self._held = held = _held(names)
        joints = [name.split("_")[0] for name in names.human]
        legs = joints.count("ankle")
        self._stiffness, self._damping = (
            np.array([gains[joint] / legs for joint in joints])
            for gains in (_STIFFNESS, _DAMPING)
        )
        self.set_name("subject")
        end = reference.times[-1]
        self._last = round(end / _SAMPLE_S) - 1
        times = np.linspace(0.0, end, self._last + 2)
        self._step = times[1]
        plan = np.hstack(
            [
                reference.q @ held.T,
                reference.v @ held.T,
                reference.torque - help_expected,
            ]
        )
        # Looked up ten thousand times: a table is quicker than the spline.
        self._table = CubicSpline(reference.times, plan)(times)
        self.DeclareVectorInputPort("state", 2 * self._nq)
        self.DeclareVectorOutputPort("torques", len(held), self._calc)

    def torques(self, time, q, v) -> np.ndarray:
        """Torques (..., k) at times (...) and states (..., nq)."""
        at = np.clip(time / self._step, 0.0, self._last + 1.0)
        i = np.minimum(at.astype(int), self._last)
        share = (at - i)[..., None]
        plan = (1.0 - share) * self._table[i] + share * self._table[i + 1]
        k = len(self._held)
        error = plan[..., :k] - q[..., self._body] @ self._held.T
        rate = plan[..., k : 2 * k] - v[..., self._body] @ self._held.T
        torque = plan[..., 2 * k :] + self._stiffness * error
        return torque + self._damping * rate

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        time = np.float64(context.get_time())
        output.SetFromVector(self.torques(time, *np.split(state, 2)))


def _held(names: Coordinates) -> np.ndarray:
    """What the feedback holds, (k, body's coordinates).

    The ankle holds the shank against the vertical, not against the foot: on
    soft soles a foot that tips would otherwise take the body along.
    """
    rows = dict(zip(names.body, np.eye(len(names.body)), strict=True))
    pitch, held = rows[names.root[-1]], []
    for name in names.human:
        joint, _, side = name.partition("_")
        if joint != "ankle":
            held.append(rows[name])
        elif not side:  # the foot is the root
            held.append(rows[name] - pitch)
        else:  # the pelvis is
            lean = rows[f"knee_{side}"] - rows[f"hip_{side}"] - pitch
            held.append(lean)
    return np.array(held)


class DeviceController(LeafSystem):
    """The exoskeleton's joints: friction, and help against gravity.

    Knows its own encoders and the load on its foot-plates: it bears a share
    of the torque that gravity asks of somebody who holds the posture of the
    device, as soon as the feet are loaded.

    Inputs state and ground_reaction; output torques: exo_ankle, exo_knee,
    exo_hip [N m].

    Args:
        model: the coupled one.
        share: of the gravity torque at each of its joints; only a device
            of ankle, knee and hip helps.
        friction: of the joints.
        design: factors on the help.
        span: begin and end of what a factor over the movement is over [s].
    """

    def __init__(
        self,
        model: Model,
        share: tuple[float, ...],
        friction: Friction,
        design: Design | None = None,
        span: tuple[float, float] = (0.0, 1.0),
    ):
        super().__init__()
        self.set_name("device")
        self._span = span
        self._tree, self._share = model.rigid.tree, np.array(share)
        self._weight = self._tree.weight
        names = model.coordinates
        self._columns, self._nq = names.device_columns, len(names)
        self._friction = friction
        self._design, self._joints = design or Design(), names.device
        self.DeclareVectorInputPort("state", 2 * self._nq)
        if self._share.any():
            self.DeclareVectorInputPort("ground_reaction", 3)
        self.DeclareVectorOutputPort("torques", len(self._columns), self._calc)

    def torques(self, times, angles, rates, load) -> np.ndarray:
        """Torques (N, 3) at times, angles and rates (N, 3), F_z (N,) [N]."""
        return self.help(times, angles, load) + self._friction.torques(rates)

    def help(self, times, angles, load) -> np.ndarray:
        """What the drives give, without friction."""
        if not self._share.any():
            return np.zeros_like(angles)
        joints = self._tree.coordinates.joint_columns
        q = np.zeros((len(angles), self._tree.num_positions))
        q[:, joints] = angles
        rest = np.zeros_like(q)
        gravity = self._tree.inverse_dynamics(q, rest, rest)[:, joints]
        low, high = _ENGAGED
        s = np.clip((load / self._weight - low) / (high - low), 0.0, 1.0)
        engaged = s * s * (3.0 - 2.0 * s)
        start, end = self._span
        share = (times - start) / (end - start)
        factors = self._design.factors(self._joints, angles, share)
        return engaged[:, None] * self._share * factors * gravity

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        load = np.zeros(1)
        if self._share.any():
            load = self.GetInputPort("ground_reaction").Eval(context)[1:2]
        q, v = np.split(state, 2)
        at = self._columns
        times = np.array([context.get_time()])
        found = self.torques(times, q[None, at], v[None, at], load)
        output.SetFromVector(found[0])


def controller(subject: SubjectController, device: DeviceController) -> Diagram:
    """Both as one system with the output joint_torques."""
    builder = DiagramBuilder()
    sizes = [s.GetOutputPort("torques").size() for s in (subject, device)]
    joined = builder.AddSystem(Multiplexer(sizes))
    for i, system in enumerate((subject, device)):
        builder.AddSystem(system)
        builder.Connect(
            system.GetOutputPort("torques"), joined.get_input_port(i)
        )
    builder.ExportInput(subject.GetInputPort("state"), "state")
    builder.ConnectInput("state", device.GetInputPort("state"))
    if device.HasInputPort("ground_reaction"):
        builder.ExportInput(
            device.GetInputPort("ground_reaction"), "ground_reaction"
        )
    builder.ExportOutput(joined.get_output_port(), "joint_torques")
    diagram = builder.Build()
    diagram.set_name("subject_and_device")
    return diagram
