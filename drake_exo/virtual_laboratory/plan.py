"""Planned movements of the virtual subject, and the controllers that follow.

The reference motion of ankle, knee and hip is a spline found by a small
least-squares problem: near a template (sit, lean forward, rise, stand), smooth,
and with the wanted centre of pressure under feet that stay in place. The chair
bears what its cushion gives. Loads and feed-forward torques are those of the
rigid model. `SubjectController` follows the plan; `DeviceController` helps.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    InputPort,
    LeafSystem,
)
from pydrake.systems.primitives import MatrixGain, Multiplexer
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.optimize import least_squares

from drake_exo.contact.parameters import GroundContact
from drake_exo.contact.strap import Design
from drake_exo.files.schema import quantity
from drake_exo.measurement.filters import minimum_jerk
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory.forces import (
    BUTTOCKS,
    chair_wrench,
    resting_foot,
    seat_depth,
)

_DEGREE = 5
_KNOT_S = 0.1
_NODE_S = 0.02
_HIP_HEIGHT_M = 0.9
_DIFFERENCE = 1e-6

# Standard deviations of the least-squares terms.
_QUIET_DEG = 0.3
_MOVING_DEG = 8.0
_COP_M = 0.004
_SEAT_SHARE = 0.03  # of the weight
_JERK = 80.0  # rad/s^3
# Begin and end of unloading the chair, in parts of the time of leaning forward.
_UNLOADING = (0.35, 1.0)


@dataclass(frozen=True)
class Posture:
    """A posture on resting feet, angles in degrees.

    Attributes:
        shank: forward lean of the shank.
        knee: flexion.
        trunk: forward lean of the trunk.
    """

    shank: float
    knee: float
    trunk: float

    def joints(self, pitch: np.ndarray) -> np.ndarray:
        """Ankle, knee, hip angles (n, 3) [rad], feet at pitch (n,) [rad]."""
        hip = self.knee - self.shank + self.trunk
        flat = np.deg2rad([self.shank, self.knee, hip])
        return flat + np.outer(pitch, [1.0, 0.0, 0.0])


@dataclass(frozen=True)
class RisePlan:
    """Postures and timing of a planned sit-to-stand.

    Attributes:
        seated: posture on the chair.
        leant: posture around seat-off.
        standing: final posture.
        quiet_s, lean_s, rise_s, stand_s: durations of sitting still, leaning
            forward, rising and standing still.
        cop_m: centre of pressure in front of the ankle.
    """

    seated: Posture = Posture(shank=16.0, knee=96.0, trunk=4.0)
    leant: Posture = Posture(shank=20.0, knee=92.0, trunk=42.0)
    standing: Posture = Posture(shank=6.0, knee=2.0, trunk=0.0)
    quiet_s: float = 0.5
    lean_s: float = 0.9
    rise_s: float = 1.5
    stand_s: float = 0.8
    cop_m: float = 0.050

    @property
    def duration(self) -> float:
        """Duration of the whole recording [s]."""
        return self.quiet_s + self.lean_s + self.rise_s + self.stand_s

    @property
    def times(self) -> np.ndarray:
        """Nodes (n,) of the plan [s]."""
        count = round(self.duration / _NODE_S) + 1
        return np.linspace(0.0, self.duration, count)


class Planner:
    """Plans movements of one subject, as trials of the rigid model.

    Args:
        tree: the rigid model with one leg (six coordinates).
        contact: foot-ground contact, into which the feet sink.
    """

    def __init__(self, tree: PlanarTree, contact: GroundContact):
        self.tree = tree
        self.contact = contact
        self.weight = tree.weight

    def standing(self, duration: float, cop_m: float) -> Trial:
        """Quiet standing, trunk upright, with the given centre of pressure."""
        times = np.linspace(0.0, duration, 11)
        foot = self._foot(np.array([self.weight]), cop_m)
        posture = RisePlan().standing
        for _ in range(4):
            q = np.hstack([foot, posture.joints(foot[:, 2])])
            gap = cop_m - self.tree.center_of_mass(q)[0, 0]
            lean = posture.shank + np.rad2deg(gap / _HIP_HEIGHT_M)
            posture = replace(posture, shank=float(lean))
        q = q.repeat(len(times), axis=0)
        return self._reference(None, times, q, 0.0 * q, 0.0 * q)

    def seat(self, plan: RisePlan) -> float:
        """Height of the seat [m] at which the seated posture is at rest."""
        q, share = self._seated(plan)
        z = self._buttocks(q)[0, 1]
        return float(z) - BUTTOCKS.radius + seat_depth(share * self.weight)

    def movement(self, plan: RisePlan, seat: float | None = None) -> Trial:
        """A sit-to-stand, or without a chair a squat from standing and back.

        Solves least squares for the joints' spline coefficients.

        Args:
            plan: of a squat, lean_s and rise_s are the durations of going down
                and up, and the seated posture must be a standing one.
            seat: what `seat` gives for the plan; None for a squat.
        """
        times, wanted = plan.times, np.zeros(len(plan.times))
        if seat is not None:  # the chair's share of the weight
            begin, end = plan.quiet_s + plan.lean_s * np.array(_UNLOADING)
            gone = minimum_jerk((times - begin) / (end - begin))[0]
            wanted = self._seated(plan)[1] * (1.0 - gone)
        foot = self._foot(self.weight * (1.0 - wanted), plan.cop_m)
        basis = _basis(plan.duration)
        B, B_v, B_a, B_j = (basis.derivative(k)(times) for k in range(4))
        spline = make_interp_spline(times, foot, k=_DEGREE)
        foot_v, foot_a = (spline.derivative(k)(times) for k in (1, 2))
        template, sigma = _template(plan, times, foot[:, 2])
        start = np.linalg.lstsq(B, template, rcond=None)[0]

        def motion(c):
            return (
                np.hstack([foot, B @ c]),
                np.hstack([foot_v, B_v @ c]),
                np.hstack([foot_a, B_a @ c]),
            )

        joints = self.tree.coordinates.joint_columns

        def residuals(x):
            c = x.reshape(start.shape)
            q, v, a = motion(c)
            ground, chair = self._loads(seat, q, v, a)
            share = chair.force_z / self.weight - wanted
            cop = ground.moment + plan.cop_m * ground.force_z
            return np.hstack(
                [
                    (cop / self.weight / _COP_M)[:, None],
                    (share / _SEAT_SHARE)[:, None],
                    (q[:, joints] - template) / sigma[:, None],
                    B_j @ c / _JERK,
                ]
            )

        found = least_squares(
            lambda x: residuals(x).ravel(),
            start.ravel(),
            jac=_banded_differences(residuals, B != 0.0),
            method="lm",
            ftol=1e-3,
            max_nfev=15,
        )
        c = found.x.reshape(start.shape)
        return self._reference(seat, times, *motion(c))

    def _seated(self, plan: RisePlan) -> tuple[np.ndarray, float]:
        """Seated coordinates (1, 6), and the chair's share of the weight."""
        share = 0.6
        for _ in range(3):
            load = np.array([self.weight * (1.0 - share)])
            foot = self._foot(load, plan.cop_m)
            q = np.hstack([foot, plan.seated.joints(foot[:, 2])])
            p = self._buttocks(q)
            com = self.tree.center_of_mass(q)
            share = (com[0, 0] - plan.cop_m) / (p[0, 0] - plan.cop_m)
        return q, float(share)

    def _buttocks(self, q: np.ndarray) -> np.ndarray:
        place = BUTTOCKS.x, BUTTOCKS.z
        return self.tree.point_positions(q, "pelvis", place)

    def _foot(self, load: np.ndarray, cop_m: float) -> np.ndarray:
        return resting_foot(self.tree, self.contact, load, cop_m)

    def _loads(self, seat, q, v, a):
        """Wrenches (n samples) of ground on feet and of seat on pelvis."""
        chair = chair_wrench(self.tree, seat, q, v)
        needed = inverse_dynamics(self.tree, q, v, a, {"pelvis": chair})
        ground = self.tree.ground_reaction(q, needed)
        return PlanarWrench.of(ground), chair

    def _reference(self, seat, times, q, v, a) -> Trial:
        ground, chair = self._loads(seat, q, v, a)
        loads = {"pelvis": chair, self.tree.root: ground}
        demand = inverse_dynamics(self.tree, q, v, a, loads)
        names = self.tree.coordinates
        return Trial(
            *("plan", names, times, q, v, a, ground),
            source="simulated",
            moments=demand[:, names.joint_columns],
            chair=chair,
        )


def _basis(duration: float) -> BSpline:
    """B-spline basis whose functions are at rest at both ends."""
    count = round(duration / _KNOT_S)
    inner = np.linspace(0.0, duration, count + 1)
    knots = np.r_[[0.0] * _DEGREE, inner, [duration] * _DEGREE]
    # Three equal coefficients have neither velocity nor acceleration.
    ends = np.eye(count + _DEGREE - 4)
    ends = np.repeat(ends, [3, *[1] * (len(ends) - 2), 3], axis=0)
    return BSpline(knots, ends, _DEGREE)


def _template(plan: RisePlan, times, pitch):
    """Template angles (n, 3), their standard deviations (n,) [rad]."""
    at = np.cumsum([0.0, plan.quiet_s, plan.lean_s, plan.rise_s])
    postures = [
        p.joints(pitch) for p in (plan.seated, plan.leant, plan.standing)
    ]
    template = postures[0]
    for k in (0, 1):
        step = postures[k + 1] - postures[k]
        phase = (times - at[k + 1]) / (at[k + 2] - at[k + 1])
        template = template + minimum_jerk(phase)[0][:, None] * step
    quiet = (times <= at[1]) | (times >= at[3])
    return template, np.deg2rad(np.where(quiet, _QUIET_DEG, _MOVING_DEG))


def _banded_differences(
    residuals: Callable[[np.ndarray], np.ndarray], touches: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Jacobian by differences that moves coefficients without overlap at once.

    Args:
        residuals: function of coefficients (m * 3,), shape (n, k).
        touches: (n, m) bool, which coefficient acts at which node.
    """
    n, m = touches.shape
    group_count = _DEGREE + 1

    def jacobian(c):
        base = residuals(c)
        k = base.shape[1]
        J = np.zeros((n, k, m, 3))
        for joint in range(3):
            for group in range(group_count):
                step = np.zeros((m, 3))
                step[group::group_count, joint] = _DIFFERENCE
                change = residuals(c + step.ravel()) - base
                for i in range(group, m, group_count):
                    rows = touches[:, i]
                    J[rows, :, i, joint] = change[rows] / _DIFFERENCE
        return J.reshape(n * k, m * 3)

    return jacobian


# Gains of the subject's feedback, both legs together.
_STIFFNESS = {"ankle": 3000.0, "knee": 2000.0, "hip": 2000.0}  # N m/rad
_DAMPING = {"ankle": 250.0, "knee": 120.0, "hip": 120.0}  # N m s/rad
_SAMPLE_S = 1e-3
# Shares of the weight on the feet from which, and fully at which, it helps.
_ENGAGED = (0.5, 0.9)


@dataclass(frozen=True)
class Friction:
    """Friction of the device's joints, both legs together.

    Attributes:
        viscous: of each joint: ankle, knee, hip [N m s/rad].
        coulomb: likewise [N m].
        speed: rate at which tanh(1) = 76 % of dry friction acts [rad/s].
    """

    viscous: tuple[float, ...] = (0.0, 0.0, 0.0)
    coulomb: tuple[float, ...] = (0.0, 0.0, 0.0)
    speed: float = quantity("rad/s", 0.05)

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
        help_expected: (n, k) torques expected of the device, which the
            feed-forward leaves to it [N m]; 0 if it does not help.
        held: (m, body's coordinates) linear combinations of coordinates that
            feedback holds to the plan; by default `held_rows`.
    """

    def __init__(
        self,
        names: Coordinates,
        reference: Trial,
        help_expected: np.ndarray | float,
        held: np.ndarray | None = None,
    ):
        super().__init__()
        self._body, self._nq = names.body_columns, len(names)
        self._held = held = held_rows(names) if held is None else held
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
                reference.moments - help_expected,
            ]
        )
        # Evaluated ten thousand times: a table is faster than the spline.
        self._table = CubicSpline(reference.times, plan)(times)
        self._ground: list[InputPort] = []  # ports of the feet's loads
        self.DeclareVectorInputPort("state", 2 * self._nq)
        self.DeclareVectorOutputPort("torques", len(joints), self._calc)

    def torques(self, time, q, v, loads=None) -> np.ndarray:
        """Torques (..., k) [N m] at times (...) and states (..., nq).

        Loads of the feet (..., 2) are ignored, since both feet stand.
        """
        error, rate, torque = self.off(time, q, v)
        return torque + self._stiffness * error + self._damping * rate

    def off(self, time, q, v) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Errors of the held quantities (plan minus actual) and of their rates.

        The third value is the feed-forward torques (..., k) [N m].

        Args:
            time: (...) [s].
            q, v: (..., nq) coordinates and velocities.
        """
        # Not np.clip: for a single number it takes ten times as long.
        at = np.minimum(np.maximum(time / self._step, 0.0), self._last + 1.0)
        i = np.minimum(at.astype(int), self._last)
        share = (at - i)[..., None]
        plan = (1.0 - share) * self._table[i] + share * self._table[i + 1]
        k = len(self._held)
        error = plan[..., :k] - q[..., self._body] @ self._held.T
        rate = plan[..., k : 2 * k] - v[..., self._body] @ self._held.T
        return error, rate, plan[..., 2 * k :]

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        time, nq = np.float64(context.get_time()), self._nq
        loads = np.array([port.Eval(context)[1] for port in self._ground])
        found = self.torques(time, state[:nq], state[nq:], loads)
        output.SetFromVector(found)


def held_rows(names: Coordinates) -> np.ndarray:
    """Quantities that feedback holds by default, (k, body's coordinates).

    Knee and hip hold their angles, but the ankle the shank's lean against the
    vertical: on soft soles a tipping foot would otherwise tip the body.
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


def comes_in(share, low: float, high: float):
    """Smooth step of a share of the weight: 0 below `low`, 1 above `high`."""
    s = (share - low) / (high - low)
    s = np.minimum(np.maximum(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


class DeviceController(LeafSystem):
    """Torques of the exoskeleton's joints: friction, and help against gravity.

    It uses only its own angles and the load on its foot-plates: once the feet
    are loaded, it gives a share of the torque that gravity demands of a person
    in the device's posture.

    Inputs state and, if it helps, ground_reaction; output torques, one for each
    joint of the device [N m].

    Args:
        model: the coupled one.
        share: share of the gravity torque at exo_ankle, exo_knee and exo_hip;
            empty for a passive device, the only choice for others.
        friction: of the joints.
        design: how it changes the help.
        span: begin and end of the movement, for a factor over it [s].
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
        """Torques (N, m) at times (N,), angles, rates (N, m), F_z (N,) [N]."""
        drive = self.help(times, angles, rates, load)
        return drive + self._friction.torques(rates)

    def help(self, times, angles, rates, load) -> np.ndarray:
        """Torques of the drives alone, without friction, (N, m) [N m]."""
        if not self._share.any():
            return np.zeros_like(angles)
        joints = self._tree.coordinates.joint_columns
        q = np.zeros((len(angles), self._tree.num_positions))
        q[:, joints] = angles
        rest = np.zeros_like(q)
        gravity = self._tree.inverse_dynamics(q, rest, rest)[:, joints]
        engaged = comes_in(load / self._weight, *_ENGAGED)
        start, end = self._span
        share = (times - start) / (end - start)
        drive = self._design.torques(
            self._joints, self._share * gravity, angles, rates, share
        )
        return engaged[:, None] * drive

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        load = np.zeros(1)
        if self._share.any():
            load = self.GetInputPort("ground_reaction").Eval(context)[1:2]
        q, v = state[: self._nq], state[self._nq :]
        at = self._columns
        times = np.array([context.get_time()])
        found = self.torques(times, q[None, at], v[None, at], load)
        output.SetFromVector(found[0])


def controller(
    names: Coordinates, subject: SubjectController, device: DeviceController
) -> Diagram:
    """Subject and device as one system with the output joint_torques."""
    builder = DiagramBuilder()
    sizes = [s.GetOutputPort("torques").size() for s in (subject, device)]
    joined = builder.AddSystem(Multiplexer(sizes))
    columns = np.split(np.eye(sum(sizes)), sizes[:1], axis=1)
    ordered = builder.AddSystem(MatrixGain(names.joined(*columns).T))
    builder.Connect(joined.get_output_port(), ordered.get_input_port())
    exported = set()
    for i, system in enumerate((subject, device)):
        builder.AddSystem(system)
        builder.Connect(
            system.GetOutputPort("torques"), joined.get_input_port(i)
        )
        for k in range(system.num_input_ports()):
            port = system.get_input_port(k)
            if port.get_name() in exported:
                builder.ConnectInput(port.get_name(), port)
            else:
                builder.ExportInput(port, port.get_name())
                exported.add(port.get_name())
    builder.ExportOutput(ordered.get_output_port(), "joint_torques")
    diagram = builder.Build()
    diagram.set_name("subject_and_device")
    return diagram
