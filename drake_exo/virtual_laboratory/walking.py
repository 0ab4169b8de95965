"""Walking on two legs: what the subject means to do, and how it is held up.

A step that repeats itself is searched near how people walk, on the subject's
own soles, with the device as a part of the body. The steps that follow are its
mirror images. What then happens is simulated: soles without smoothing, a device
on cuffs that give way, and a controller that knows nothing of them.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from drake_exo.calibration.periodic import PeriodicStep, mirrored
from drake_exo.calibration.problem import ground_terms
from drake_exo.calibration.settings import (
    InteractionNoise,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.solving import SolveWatch
from drake_exo.collocation.trial_program import Tracking, minimised
from drake_exo.contact.hunt_crossley import SimbodyConstants
from drake_exo.contact.parameters import ContactModel, GroundContact
from drake_exo.errors import InputError
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import SIDES
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory.plan import (
    Reference,
    SubjectController,
    comes_in,
)

# Angles of an adult who walks at an ordinary speed, from one heel strike on,
# every tenth of the cycle [deg]; toe-off is at 62 % of it. After Winter, The
# Biomechanics and Motor Control of Human Gait, 1991, read off coarsely.
_CYCLE = {
    "hip": (26, 23, 16, 7, -2, -9, -6, 12, 25, 29),
    "knee": (5, 18, 18, 11, 7, 12, 38, 62, 50, 18),
    "ankle": (0, -3, 4, 7, 10, 8, -14, -12, 0, 1),
}
_TRUNK_LEAN_DEG = 3.0
_TOE_OFF = 0.62
# Of the ground's force on one foot, in parts of the weight, against the cycle;
# and its point, in front of the ankle [m]. Where the search starts, no more.
_FORCE_Z = (
    (0.0, 0.05, 0.12, 0.3, 0.48, 0.55, 0.62),
    (0, 0.55, 1.1, 0.78, 1.1, 0.6, 0),
)
_FORCE_X = ((0.0, 0.04, 0.12, 0.32, 0.52, 0.62), (0, -0.08, -0.18, 0, 0.2, 0))
_POINT_M = ((0.0, 0.15, 0.48, 0.62), (-0.03, 0.04, 0.14, 0.18))
_SUNK_M = 0.005
WALKWAY_M = 3.0  # further than any walk goes
_NODES_PER_SECOND = 100.0
# How near the search stays to all that.
_NEAR_DEG = 6.0
_NOISE = InteractionNoise(
    force_n=100.0, cop_m=0.03, torque_nm=20.0, jerk=1000.0
)
_STRONGEST_NM = 300.0
_CLEARANCE_M = 0.03
# Soles that the search can follow; those that are simulated stick.
_SMOOTH = SimbodyConstants(transition_velocity=0.2)


@dataclass(frozen=True)
class WalkPlan:
    """How a walk is meant to go.

    Attributes:
        speed_m_s: of the pelvis.
        step_s: time of one step, half a cycle.
        steps: in full; the first one settles device and soles.
        after_s: of another one.
    """

    speed_m_s: float = 1.2
    step_s: float = 0.55
    steps: int = 3
    after_s: float = 0.25


def vary_walk(plan: WalkPlan, rng: np.random.Generator) -> WalkPlan:
    """Another walk of the same subject."""
    return replace(
        plan,
        speed_m_s=float(plan.speed_m_s * rng.uniform(0.92, 1.08)),
        step_s=float(plan.step_s * rng.uniform(0.95, 1.05)),
    )


def plan_walk(
    model: Model, soles: GroundContact, plan: WalkPlan, title: str
) -> Reference:
    """A walk of several steps, from the moment the left toes leave the ground.

    Args:
        model: subject, with the device as a part of the body.
        soles: under each foot.
        plan: speed and length of the steps.
        title: of the progress.

    Raises:
        InputError: no step was found.
    """
    contact = ContactModel(replace(soles, constants=_SMOOTH))
    settings = PredictionSettings(
        ends="periodic",
        speed_m_s=plan.speed_m_s,
        clearance_m=_CLEARANCE_M,
        torque_limit_nm=_STRONGEST_NM,
        noise=_NOISE,
        solver=Solver(_NODES_PER_SECOND),
    )
    near = template(model.tree, soles, plan)
    problem = _Step(model, [near], contact, settings)
    result = problem.solve(on_iterate=SolveWatch(f"{title}, step"))
    if not result.success:
        raise InputError(
            f"{title}: no step of {plan.speed_m_s:.2f} m/s was found for this "
            "person and device; give another seed, or a lighter device"
        )
    return repeated(result.trials[0], plan.steps, plan.after_s)


class _Step(PeriodicStep):
    """A periodic step near the template, with little effort."""

    def _terms(self, movement, at, effects):
        names = movement.coordinates
        pitch = names.root[-1]
        columns = names.columns([pitch, *names.human])
        return [
            Tracking(
                movement.grid.q[:, columns],
                at.q[:, columns],
                np.deg2rad(_NEAR_DEG),
            ),
            *ground_terms(movement, at, self.settings.noise),
            minimised(movement.torque, self.settings.noise.torque_nm),
        ]


def template(tree: PlanarTree, soles: GroundContact, plan: WalkPlan) -> Trial:
    """Half a cycle as people walk, from the left toe-off to the right one.

    Args:
        tree: of the subject, two legs on a pelvis.
        soles: under each foot.
        plan: speed and length of the step.
    """
    names = tree.coordinates
    times = np.linspace(0.0, plan.step_s, round(100 * plan.step_s) + 1)
    step = 0.5 * times / plan.step_s
    cycle = {"left": (_TOE_OFF + step) % 1.0, "right": _TOE_OFF - 0.5 + step}
    tenths = np.linspace(0.0, 1.0, 11)
    x, z, pitch = names.root
    q = np.zeros((len(times), len(names)))
    q[:, names.index(x)] = plan.speed_m_s * times
    q[:, names.index(pitch)] = -np.deg2rad(_TRUNK_LEAN_DEG)
    for side, at in cycle.items():
        for joint, angles in _CYCLE.items():
            closed = np.deg2rad([*angles, angles[0]])
            curve = CubicSpline(tenths, closed, bc_type="periodic")
            q[:, names.index(f"{joint}_{side}")] = curve(at)
    q[:, names.index(z)] = _height(tree, soles, q, step)
    motion = CubicSpline(times, q)
    feet = {side: _borne(tree, q, side, at) for side, at in cycle.items()}
    return Trial(
        "step",
        names,
        times,
        q,
        motion(times, 1),
        motion(times, 2),
        feet["left"] + feet["right"],
        source="simulated",
        feet=feet,
    )


def _height(tree, soles: GroundContact, q, step) -> np.ndarray:
    """Of a pelvis (n,) whose lower foot is on the ground [m].

    Its mean and the wave of a step: where feet change over there is a corner.
    """
    lowest = np.min(
        [
            tree.point_positions(q, f"foot_{side}", (s.x, s.z))[:, 1] - s.radius
            for side in SIDES
            for s in soles.spheres.values()
        ],
        axis=0,
    )
    angle = 4.0 * np.pi * step
    waves = np.column_stack([np.ones_like(step), np.cos(angle), np.sin(angle)])
    return waves @ np.linalg.lstsq(waves, -lowest - _SUNK_M, rcond=None)[0]


def _borne(tree: PlanarTree, q, side: str, cycle) -> PlanarWrench:
    """What the ground does to a foot, by where in its cycle (n,) it is."""
    stance = cycle < _TOE_OFF
    at = np.minimum(cycle, _TOE_OFF)
    force_x, force_z = (
        np.where(stance, PchipInterpolator(*curve)(at), 0.0) * tree.weight
        for curve in (_FORCE_X, _FORCE_Z)
    )
    ankle = tree.point_positions(q, f"foot_{side}", (0.0, 0.0))[:, 0]
    point = ankle + np.interp(at, *_POINT_M)
    return PlanarWrench(np.column_stack([force_x, force_z]), -point * force_z)


def repeated(step: Trial, count: int, after_s: float = 0.0) -> Reference:
    """A step, then its mirror image, and so on.

    Args:
        step: that ends as it began with left and right exchanged.
        count: of steps.
        after_s: of another one, at the end.
    """
    names, other = step.coordinates, mirrored(step.coordinates)
    joints = names.joint_columns
    of_joints = other[np.ix_(joints, joints)]
    q, v, torque = step.q, step.v, step.moments
    ground = step.ground.array
    ahead = np.zeros(len(names))
    ahead[names.index(names.root[0])] = q[-1, 0] - q[0, 0]
    parts = []
    for k in range(count + 1):
        rows = slice(int(k > 0), None)
        parts.append(
            [x[rows] for x in (step.times + k * step.duration, q, v, torque)]
            + [PlanarWrench.of(ground).shifted(k * ahead[0]).array[rows]]
        )
        q = q @ other.T + ahead
        v, torque = v @ other.T, torque @ of_joints.T
    until = count * step.duration + after_s
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
    rows = joined[0] <= until + 1e-9
    times, q, v, torque, ground = (part[rows] for part in joined)
    return Reference(times, q, v, torque, ground, np.zeros_like(ground))


# Of the subject's own feedback, N m/rad and N m s/rad. A leg that bears the
# body holds the trunk upright with its hip and the shank with its ankle, which
# also brings the pelvis along (N and N s, of metres); one that swings holds its
# joints.
_SWING = {"hip": (600.0, 40.0), "knee": (400.0, 25.0), "ankle": (60.0, 3.0)}
_TRUNK, _KNEE, _SHANK = (1000.0, 80.0), (1000.0, 60.0), (1500.0, 120.0)
_ALONG = (720.0, 360.0)
# Parts of the weight from which, and up to which, a leg comes to bear the body.
_BEARS = (0.05, 0.35)


class WalkingController(SubjectController):
    """Feed-forward joint torques and feedback towards a walk.

    Inputs state, and the ground reaction on either foot, which says what a leg
    is there for; output torques of the human's k joints [N m].

    Args:
        names: coordinates of the coupled model.
        reference: the walk; its ends are held before and after.
        weight: of subject and device [N].
    """

    def __init__(self, names: Coordinates, reference: Reference, weight: float):
        everything = np.eye(len(names.body))
        nothing = np.zeros_like(reference.torque)
        super().__init__(names, reference, nothing, everything)
        self._weight = weight
        self._swing, self._stance = _gains(names)
        sides = [name.partition("_")[2] for name in names.human]
        self._foot = [SIDES.index(side) for side in sides]
        self._ports = [
            self.DeclareVectorInputPort(f"ground_reaction_foot_{side}", 3)
            for side in SIDES
        ]

    def torques(self, time, q, v, loads) -> np.ndarray:
        """Torques (..., k) at times (...) and states (..., nq).

        Args:
            time: (...).
            q, v: (..., nq).
            loads: (..., 2) vertical forces on the left and the right foot [N].
        """
        error, rate, torque = self.off(time, q, v)
        off = np.concatenate([error, rate], axis=-1)
        bears = comes_in(loads / self._weight, *_BEARS)[..., self._foot]
        swing, stance = off @ self._swing.T, off @ self._stance.T
        return torque + swing + bears * (stance - swing)

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        time, nq = np.float64(context.get_time()), self._nq
        loads = np.array([port.Eval(context)[1] for port in self._ports])
        found = self.torques(time, state[:nq], state[nq:], loads)
        output.SetFromVector(found)


def _gains(names: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Of a leg that swings and of one that bears, each (k, 2 body's).

    On what coordinates, then their rates, lack of the plan.
    """
    rows = dict(zip(names.body, np.eye(len(names.body)), strict=True))
    x, _, pitch = names.root
    swing, stance = [], []
    for name in names.human:
        joint, _, side = name.partition("_")
        swing.append(np.kron(_SWING[joint], rows[name]))
        if joint == "hip":  # flexes where the trunk leans too far back
            stance.append(np.kron(_TRUNK, -rows[pitch]))
        elif joint == "knee":
            stance.append(np.kron(_KNEE, rows[name]))
        else:
            lean = rows[f"knee_{side}"] - rows[f"hip_{side}"] - rows[pitch]
            stance.append(np.kron(_SHANK, lean) + np.kron(_ALONG, rows[x]))
    return np.array(swing), np.array(stance)
