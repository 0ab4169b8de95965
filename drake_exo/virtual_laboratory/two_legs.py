"""A person of two legs in a device of the user's own: rise, squat, walk.

A rise or squat is planned for one leg that stands for both. Each leg then bears
a constant share of the ground's force, and its torques follow from that. The
device does not help. Mats lie under every cuff except on feet.

For a walk, a periodic step is optimised near how people walk, on the subject's
soles with smoothed contact, the device being a rigid part of the body; further
steps are its mirror images. The movement is then simulated on soles without
smoothing, in a device on compliant cuffs that the controller knows nothing of.
"""

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.interpolate import CubicSpline, PchipInterpolator, make_interp_spline

from drake_exo.calibration.phases import PeriodicStep, mirrored
from drake_exo.calibration.problem import ground_terms, solved
from drake_exo.calibration.settings import (
    InteractionNoise,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.solving import SolveWatch
from drake_exo.collocation.trial_program import Tracking, minimised
from drake_exo.contact.hunt_crossley import SimbodyConstants
from drake_exo.contact.parameters import (
    ContactModel,
    GroundContact,
    nominal_contact,
)
from drake_exo.errors import InputError, check_count, path_of
from drake_exo.files import schema
from drake_exo.measurement.events import contacts
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import SIDES, Assembly
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.description import nominal_human
from drake_exo.model.device_file import with_text
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import Model
from drake_exo.model.segments import HumanParameters
from drake_exo.virtual_laboratory.campaign import (
    Session,
    after_chair,
    device_section,
    phase_sections,
    to_frames,
    vary,
)
from drake_exo.virtual_laboratory.forces import levelled, resting_foot
from drake_exo.virtual_laboratory.instruments import PLATES, Faults, mats_of
from drake_exo.virtual_laboratory.plan import (
    Friction,
    Planner,
    Posture,
    RisePlan,
    SubjectController,
    comes_in,
    held_rows,
)
from drake_exo.virtual_laboratory.simulation import simulate
from drake_exo.virtual_laboratory.truth import (
    MEASUREMENT,
    STANDING_COP_M,
    TRUTH,
    Truth,
    checked,
    drawn_cuffs,
    five_spheres,
    other_masses,
    two_spheres,
)

MOVEMENTS = ("rise", "squat", "walk")
# Disturbances that can act: all but those of a wide truth.
ACTING = (*TRUTH, *MEASUREMENT)
_PLATES = {side: PLATES[side] for side in SIDES}
_VISCOUS, _COULOMB = 0.5, 1.0  # N m s/rad, N m in each joint of the device
# Knees stay bent: a straight leg cannot adapt its length to the other leg.
_STANDING = Posture(shank=9.0, knee=14.0, trunk=2.0)
_BOTTOM = Posture(shank=24.0, knee=85.0, trunk=36.0)
_PRIOR_WEIGHT = 10.0  # a foot's forces hardly determine its spheres' places
_AFTER_TOE_OFF_S = 0.05
_QUIET_S = 0.1  # used part of standing before and after the movement
_RISE = RisePlan(standing=_STANDING)
_SQUAT = RisePlan(_STANDING, _BOTTOM, _STANDING, lean_s=1.4, rise_s=1.4)


def write_movements(
    folder: str | Path,
    description: str | Path,
    movement: str = "rise",
    seed: int = 0,
    disturbances: Iterable[str] = ACTING,
    trials: int = 3,
    *,
    left_share: float = 0.5,
    files: str = "c3d",
    processes: int = 1,
) -> Path:
    """Simulate a person of two legs and write the files of a gait laboratory.

    Args:
        folder: exists; receives study.yaml, standing and trial files, the
            device's file, and truth/.
        description: YAML file with the keys of a study's `model`.
        movement: a name in MOVEMENTS.
        seed: of all random numbers; the same seed gives the same bytes.
        disturbances: names that act; those not in `ACTING` are ignored.
        trials: number of trials.
        left_share: share of the ground's force that the left leg bears.
        files: "c3d" or "opensim" (.trc and .mot).
        processes: number of parallel ones; no influence on the result.

    Returns:
        The study file.

    Raises:
        InputError: the description is invalid, or not of two legs with rigid
            toes; an unknown movement, disturbance or kind of files; a share
            outside 0.1 to 0.9, or other than 0.5 for a walk.
    """
    folder = path_of(folder, "folder")
    description = path_of(description, "description")
    if movement not in MOVEMENTS:
        raise InputError(
            f"movement is {movement!r}; the virtual laboratory has "
            f"{', '.join(MOVEMENTS)}"
        )
    if movement == "walk" and left_share != 0.5:
        raise InputError(
            "left_share (--left-share) is for standing on both feet; leave it "
            "out for a walk"
        )
    if not 0.1 <= left_share <= 0.9:
        raise InputError(
            f"left_share (--left-share) is {left_share:g}; give 0.1 to 0.9, as "
            "both feet stand"
        )
    check_count(trials, 1, "trials")
    check_count(seed, 0, "seed")
    check_count(processes, 1, "processes")
    active = checked(disturbances) & frozenset(ACTING)
    job = TwoLegs(
        folder, description, movement, seed, active, left_share, files
    )
    device = job.description.get("device")
    if device is not None:  # the study names a copy of its file
        source = description.parent / device["file"]
        shutil.copyfile(source, folder / source.name)
        device["file"] = source.name
    numbers = {f"{movement}_{k + 1}": k for k in range(trials)}
    title = f"A virtual subject of two legs: {movement}."
    return job.write(numbers, processes, title)


class TwoLegs(Session):
    """A session of a subject with two legs, drawn about the nominal adult.

    Arguments are those of `write_movements`; only the description (`path`) has
    not been checked.
    """

    first_key = 20

    def __init__(
        self,
        folder: Path,
        path: Path,
        movement: str,
        seed: int,
        active: frozenset[str],
        left_share: float = 0.5,
        files: str = "c3d",
    ):
        self.seed, self.movement, self.left_share = seed, movement, left_share
        truth, planner = self._drawn(path, active)
        self.description = yaml.safe_load(path.read_text("utf-8"))
        super().__init__(
            seed,
            truth,
            planner,
            mats_of(truth.model),
            {"seed": seed, "disturbances": active, "left_share": left_share},
            folder=folder,
            files=files,
            disturbances=active,
            faults=Faults(encoder_offset_rad=(0.0,)),
            walkway_m=WALKWAY_M if movement == "walk" else 0.0,
        )

    def _drawn(self, path: Path, active) -> tuple[Truth, Planner]:
        """The subject, and the planner of one leg for both, without device.

        The truth's contact is that of each single foot.
        """
        assembly = schema.load(path, Assembly)
        if assembly.human.legs != "two" or assembly.human.toes != "rigid":
            raise InputError(
                f"{path}: the virtual laboratory simulates two legs with rigid "
                "toes; say 'human: {legs: two}'"
            )
        if assembly.human.osim is not None or assembly.is_fitted:
            raise InputError(
                f"{path}: the virtual laboratory has a person of its own and "
                "no shipped device; leave osim out, and give the device's file"
            )
        rng, person = self.rng(0), nominal_human()
        alone = Model("human", person)
        worn = with_text(assembly, path.parent)
        two = two_spheres(nominal_contact(alone).ground, rng)
        five = five_spheres(person, rng)
        masses = other_masses(person, rng)
        soles = levelled(
            alone.tree,
            (five if "contact" in active else two).checked(),
            Model(worn, person).tree.weight,
            STANDING_COP_M,
            person.ankle_height_m,
        )
        if "segments" in active:
            alone = replace(alone, human=masses)
        places = {name: (s.x, s.z) for name, s in soles.spheres.items()}
        ground = {f"foot_{side}": places for side in SIDES}
        model = Model(replace(worn, ground=ground), alone.human)
        usual = nominal_contact(model)
        cuffs = drawn_cuffs(usual.bushings, rng, active, "near")
        joints = len(model.coordinates.device)
        rough = "friction" in active
        friction = Friction(
            (_VISCOUS * rough,) * joints, (_COULOMB * rough,) * joints
        )
        each = {
            name: replace(sphere, stiffness=0.5 * sphere.stiffness)
            for name, sphere in soles.spheres.items()
        }
        contact = replace(soles, spheres=each)
        truth = Truth(model, contact, cuffs, friction)
        return truth, Planner(alone.tree, soles)

    def standing(self) -> Trial:
        """The plan of quiet standing, on both legs alike."""
        return self.both_legs(super().standing(), 0.5)

    def both_legs(self, plan: Trial, share: float) -> Trial:
        """The plan for two legs that share the load, from that for one.

        Args:
            plan: of one leg that stands for both.
            share: share of the ground's force that the left leg bears.
        """
        one, tree = self.planner.tree, self.truth.model.rigid.tree
        names = tree.coordinates
        # The plan is of a person without the device.
        heavier = tree.weight / one.weight
        shares = dict(zip(SIDES, (share, 1.0 - share), strict=True))
        q = np.zeros((len(plan.q), len(names)))
        q[:, :3] = one.poses(plan.q, "pelvis")
        for side, part in shares.items():
            # Soles are indented unequally, so each leg needs its own angles.
            load = part * heavier * plan.ground.force_z
            cop = -plan.ground.moment.sum() / plan.ground.force_z.sum()
            foot = resting_foot(one, self.truth.contact, load, cop)
            bent = _bent(self.truth.human, q, foot)
            for joint, angle in zip(
                ("hip", "knee", "ankle"), bent, strict=True
            ):
                q[:, names.index(f"{joint}_{side}")] = angle
        path = make_interp_spline(plan.times, q, k=5)
        v, a = (path.derivative(k)(plan.times) for k in (1, 2))
        loads = {"pelvis": plan.chair}
        ground = tree.ground_reaction(q, inverse_dynamics(tree, q, v, a, loads))
        ground = PlanarWrench.of(ground)
        for side, part in shares.items():
            loads[f"foot_{side}"] = ground.scaled(part)
        torque = inverse_dynamics(tree, q, v, a, loads)[:, names.joint_columns]
        own = {"q": q, "v": v, "a": a, "ground": ground, "moments": torque}
        return replace(plan, coordinates=names, **own)

    def record(
        self, number: int, tell: Callable[[str], None] | None = None
    ) -> dict:
        """Simulate a trial and write its files; its entry in `trials`.

        Args:
            number: index of the trial, from 0.
            tell: see `simulate`.
        """
        name, laboratory = f"{self.movement}_{number + 1}", self.laboratory
        act = self._walks if self.movement == "walk" else self._stands
        happened, (start, end) = act(name, number, tell)
        self.measure(happened, self.rng(4, number), self.mats)
        used = {"name": name, **laboratory.motion_files(name)}
        if self.truth.model.coordinates.device:
            used["encoders"] = laboratory.device_file(name, "encoders")
        if self.mats:
            mats = [mat.name for mat in self.mats]
            used["pressure"] = [{"file": f"{name}.asc", "mats": mats}]
        return {
            **used,
            "plates": _PLATES,
            **laboratory.empty_files,
            "start_s": start,
            "end_s": end,
        }

    def _stands(self, name, number, tell) -> tuple[Trial, tuple]:
        """Simulate a rise or squat; with start and end of its used part [s]."""
        rises, seat = self.movement == "rise", None
        plan = self.varied(vary, _RISE if rises else _SQUAT, number)
        if rises:
            seat = self.planner.seat(plan)
        else:
            plan = replace(plan, seated=plan.standing)
        motion = self.planner.movement(plan, seat)
        motion = self.both_legs(motion, self.left_share)
        happened = simulate(name, self.truth, motion, seat, tell=tell)
        end = plan.duration - plan.stand_s + _QUIET_S
        begin = plan.quiet_s - _QUIET_S
        if rises:
            begin = after_chair(happened, happened.chair.force_z)
        return happened, to_frames(begin, end)

    def _walks(self, name, number, tell) -> tuple[Trial, tuple]:
        """Simulate a walk; with start and end of the cycle that is used [s]."""
        truth, names = self.truth, self.truth.model.coordinates
        plan = self.varied(vary_walk, WalkPlan(), number)
        rigid = truth.model.rigid
        motion = plan_walk(rigid, truth.contact, plan, name)
        happened = simulate(
            name,
            truth,
            motion,
            tell=tell,
            walker=WalkingController(names, motion, rigid.tree.weight),
        )
        # A cycle from just after toe-off, where the filter smears no force in.
        borne = happened.feet["right"].force_z
        left = [c.end_s for c in contacts(happened.times, borne) if c.ends]
        return happened, [round(t + _AFTER_TOE_OFF_S, 2) for t in left[:2]]

    def study(self, mats: dict, entries: list[dict]) -> dict:
        """The contents of study.yaml; the last of several trials is predicted.

        Args:
            mats: the section `mats`.
            entries: the section `trials`, to which `use` is added.
        """
        for k, entry in enumerate(entries):
            last = k > 0 and k == len(entries) - 1
            entry["use"] = "prediction" if last else "calibration"
        truth, model = self.truth, self.description
        cutoff_hz, walks = 6.0, self.movement == "walk"
        if walks:  # a foot that rolls needs three spheres
            spheres, cutoff_hz = ["heel", "ball", "toe"], 10.0
            model = model | {"ground": {f"foot_{s}": spheres for s in SIDES}}
        study = {
            **self.recorded(model, _PLATES, cutoff_hz),
            **({"mats": mats} if mats else {}),
            "trials": entries,
            **phase_sections(legs=2),
        }
        if walks:
            study |= _rolling(study)
        else:
            study["foot_ground"]["prior_weight"] = _PRIOR_WEIGHT
        joints = truth.model.coordinates.device
        if joints:
            friction = truth.friction
            own = device_section(joints, friction, (1.0,) * len(joints))
            study["device"] = {"joints": own}
        return study


def _bent(human: HumanParameters, q, foot):
    """Hip, knee, ankle (n,) [rad] from q of the pelvis and foot (n, 3)."""
    thigh, shank = human.thigh.length_m, human.shank.length_m
    x, z = (q[:, :2] - foot[:, :2]).T
    square = x * x + z * z
    cosine = (square - thigh**2 - shank**2) / (2.0 * thigh * shank)
    knee = np.arccos(np.clip(cosine, -1.0, 1.0))
    lean = np.arctan2(x, z) + np.arcsin(thigh * np.sin(knee) / np.sqrt(square))
    return knee - lean - q[:, 2], knee, lean + foot[:, 2]


def _rolling(study: dict) -> dict:
    """Sections of Phases A to C in `study`, changed for feet that roll.

    Steps are jerkier than movements on standing feet, and the ball's sphere may
    be anywhere between its neighbours.
    """
    jerky = {"velocity_deg_s": 8.0, "jerk": 300.0}
    found = {
        phase: study[phase] | {"noise": study[phase]["noise"] | jerky}
        for phase in ("foot_ground", "interaction", "prediction")
    }
    contact, cuffs = found["foot_ground"], found["interaction"]
    ball = contact["heel"] | {"x_m": {"below": 0.08, "above": 0.04}}
    ends = {"x_m": 0.01, "z_m": 0.01, "pitch_deg": 5.0}
    contact |= {
        # A heel slides at touch-down: a solver would oscillate at the corner.
        "constants": {"transition_velocity": 0.2, "friction_rounding": 0.5},
        "spheres": {"ball": ball},
        "prior_weight": _PRIOR_WEIGHT,
        "end_tolerance": ends,
        "solver": {"nodes_per_second": 200.0},  # toe-off takes milliseconds
    }
    cuffs["end_tolerance"] = ends
    # As for recorded walks: 5 N m would leave the swinging leg undetermined.
    found["prediction"]["noise"]["moment_nm"] = 1.0
    return found


# Joint angles of an adult walking at ordinary speed, from heel strike on, every
# tenth of the cycle [deg]; toe-off is at 62 % of it. Read off coarsely from
# Winter, The Biomechanics and Motor Control of Human Gait, 1991.
_CYCLE = {
    "hip": (26, 23, 16, 7, -2, -9, -6, 12, 25, 29),
    "knee": (5, 18, 18, 11, 7, 12, 38, 62, 50, 18),
    "ankle": (0, -3, 4, 7, 10, 8, -14, -12, 0, 1),
}
_TRUNK_LEAN_DEG = 3.0
_TOE_OFF = 0.62
# Ground's force on one foot, in parts of the weight, against the cycle, and its
# point in front of the ankle [m]. Only the start of the search.
_FORCE_Z = (
    (0.0, 0.05, 0.12, 0.3, 0.48, 0.55, 0.62),
    (0, 0.55, 1.1, 0.78, 1.1, 0.6, 0),
)
_FORCE_X = ((0.0, 0.04, 0.12, 0.32, 0.52, 0.62), (0, -0.08, -0.18, 0, 0.2, 0))
_POINT_M = ((0.0, 0.15, 0.48, 0.62), (-0.03, 0.04, 0.14, 0.18))
_SUNK_M = 0.005
WALKWAY_M = 3.0  # longer than any walk
# Full steps (in the first, device and soles settle), and part of another [s].
_FULL_STEPS, _AFTER_S = 3, 0.25
_NODES_PER_SECOND = 100.0
# Standard deviations about these curves in the search.
_NEAR_DEG = 6.0
_NOISE = InteractionNoise(
    force_n=100.0, cop_m=0.03, torque_nm=20.0, jerk=1000.0
)
_STRONGEST_NM = 300.0
_CLEARANCE_M = 0.03
# Friction smooth enough for the search; simulated soles nearly stick.
_SMOOTH = SimbodyConstants(transition_velocity=0.2)


@dataclass(frozen=True)
class WalkPlan:
    """Speed and steps of a planned walk.

    Attributes:
        speed_m_s: mean speed of the pelvis.
        step_s: duration of one step, half a cycle.
    """

    speed_m_s: float = 1.2
    step_s: float = 0.55


def vary_walk(plan: WalkPlan, rng: np.random.Generator) -> WalkPlan:
    """The plan of another walk, with speed and step time drawn."""
    return replace(
        plan,
        speed_m_s=float(plan.speed_m_s * rng.uniform(0.92, 1.08)),
        step_s=float(plan.step_s * rng.uniform(0.95, 1.05)),
    )


def plan_walk(
    model: Model, soles: GroundContact, plan: WalkPlan, title: str
) -> Trial:
    """A walk of several steps, from the left toe-off on.

    Args:
        model: subject, with the device as a rigid part of the body.
        soles: contact under each foot.
        plan: speed and timing of the steps.
        title: title of the progress messages.

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
    result = solved(
        problem,
        f"{title}: no step of {plan.speed_m_s:.2f} m/s was found for this "
        "person and device; give another seed, or a lighter device",
        SolveWatch(f"{title}, step"),
    )
    return repeated(result.trials[0], _FULL_STEPS, _AFTER_S)


class _Step(PeriodicStep):
    """A periodic step that stays near the template, with little torque."""

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
    """Half a cycle of ordinary gait, from the left toe-off to the right one.

    Args:
        tree: of the subject, two legs on a pelvis.
        soles: contact under each foot.
        plan: speed and timing of the step.
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
    """Height of the pelvis (n,) with its lower foot on the ground [m].

    Only its mean and first harmonic over the step are kept, since it has a
    corner where the load changes feet.
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
    """Ground reaction on a foot at its phases of the cycle (n,)."""
    stance = cycle < _TOE_OFF
    at = np.minimum(cycle, _TOE_OFF)
    force_x, force_z = (
        np.where(stance, PchipInterpolator(*curve)(at), 0.0) * tree.weight
        for curve in (_FORCE_X, _FORCE_Z)
    )
    ankle = tree.point_positions(q, f"foot_{side}")[:, 0]
    point = ankle + np.interp(at, *_POINT_M)
    return PlanarWrench(np.column_stack([force_x, force_z]), -point * force_z)


def repeated(step: Trial, count: int, after_s: float = 0.0) -> Trial:
    """A walk of a step and its mirror images in turn.

    Args:
        step: its end is its start with left and right exchanged.
        count: number of full steps.
        after_s: duration of the part of a further step at the end [s].
    """
    names, other = step.coordinates, mirrored(step.coordinates)
    joints = names.joint_columns
    of_joints = other[np.ix_(joints, joints)]
    q, v, a, torque = step.q, step.v, step.a, step.moments
    ahead = np.zeros(len(names))
    ahead[names.index(names.root[0])] = q[-1, 0] - q[0, 0]
    parts = []
    for k in range(count + 1):
        rows = slice(int(k > 0), None)
        parts.append(
            [x[rows] for x in (step.times + k * step.duration, q, v, a, torque)]
            + [step.ground.shifted(k * ahead[0]).array[rows]]
        )
        q = q @ other.T + ahead
        v, a, torque = v @ other.T, a @ other.T, torque @ of_joints.T
    until = count * step.duration + after_s
    joined = [np.concatenate(part) for part in zip(*parts, strict=True)]
    rows = joined[0] <= until + 1e-9
    times, q, v, a, torque, ground = (part[rows] for part in joined)
    return Trial(
        *("walk", names, times, q, v, a, PlanarWrench.of(ground)),
        source="simulated",
        moments=torque,
    )


# Gains of the subject's feedback, N m/rad and N m s/rad. A leg in swing holds
# its joints' angles; in stance its hip holds the trunk upright, and its ankle
# holds the shank and moves the pelvis to its planned x (N and N s).
_SWING = {"hip": (600.0, 40.0), "knee": (400.0, 25.0), "ankle": (60.0, 3.0)}
_TRUNK, _KNEE, _SHANK = (1000.0, 80.0), (1000.0, 60.0), (1500.0, 120.0)
_ALONG = (720.0, 360.0)
# Shares of the weight between which a leg changes from swing to stance gains.
_BEARS = (0.05, 0.35)


class WalkingController(SubjectController):
    """Feed-forward joint torques and feedback towards a planned walk.

    Inputs state and the ground reaction on either foot, which tells stance from
    swing; output torques of the human's k joints [N m].

    Args:
        names: coordinates of the coupled model.
        reference: the walk; its ends are held before and after.
        weight: of subject and device [N].
    """

    def __init__(self, names: Coordinates, reference: Trial, weight: float):
        everything = np.eye(len(names.body))
        super().__init__(names, reference, 0.0, everything)
        self._weight = weight
        self._swing, self._stance = _gains(names)
        sides = [name.partition("_")[2] for name in names.human]
        self._foot = [SIDES.index(side) for side in sides]
        self._ground = [
            self.DeclareVectorInputPort(f"ground_reaction_foot_{side}", 3)
            for side in SIDES
        ]

    def torques(self, time, q, v, loads) -> np.ndarray:
        """Torques (..., k) [N m] at times (...) and states (..., nq).

        Args:
            time: (...) [s].
            q, v: (..., nq) coordinates and velocities.
            loads: (..., 2) vertical forces on the left and the right foot [N].
        """
        error, rate, torque = self.off(time, q, v)
        off = np.concatenate([error, rate], axis=-1)
        bears = comes_in(loads / self._weight, *_BEARS)[..., self._foot]
        swing, stance = off @ self._swing.T, off @ self._stance.T
        return torque + swing + bears * (stance - swing)


def _gains(names: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Gain matrices of swing and of stance, each (k, 2 body's coordinates).

    They act on errors of the body's coordinates, then on those of their rates.
    """
    rows = dict(zip(names.body, np.eye(len(names.body)), strict=True))
    x, _, pitch = names.root
    swing, stance = [], []
    for name, held in zip(names.human, held_rows(names), strict=True):
        joint = name.split("_")[0]
        swing.append(np.kron(_SWING[joint], rows[name]))
        if joint == "hip":  # flexes if the trunk leans too far back
            stance.append(np.kron(_TRUNK, -rows[pitch]))
        elif joint == "knee":
            stance.append(np.kron(_KNEE, held))
        else:
            stance.append(np.kron(_SHANK, held) + np.kron(_ALONG, rows[x]))
    return np.array(swing), np.array(stance)
