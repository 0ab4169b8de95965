"""Writes a calibration into the OpenSim model that its person was read from.

Spheres become SmoothSphereHalfSpaceForces, cuffs BushingForces (those that
slip ExpressionBasedBushingForces), the device's links bodies with pin joints.
If one leg stands for both, both get all of these, each with half the
stiffness, damping, mass and inertia.

Movements become states of the model. Inverse kinematics puts its pelvis and
feet where the planar ones are, so that a knee that slides as it flexes does not
move the contacts: hip, knee and ankle differ from planar pins instead. If a leg
has six coordinates, its foot is also kept upright.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drake_exo.calibration.results import (
    read_calibration,
    read_model,
    read_trial,
)
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import DESIGN, read_design
from drake_exo.errors import InputError
from drake_exo.files import osim as xml
from drake_exo.files.opensim import write_table
from drake_exo.files.osim import OsimModel, Pose, read_osim
from drake_exo.files.output import (
    SOLVED,
    Verdict,
    check_new,
    read_json,
    stored,
)
from drake_exo.files.tables import Table
from drake_exo.measurement.sagittal import external_loads
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import Person
from drake_exo.model.osim_person import (
    ENDS,
    JOINTS,
    OsimPerson,
    flexing,
    read_person,
    upright,
)
from drake_exo.model.plant import Model
from drake_exo.model.segments import SEGMENTS

_BODIES = {"thigh": "femur", "shank": "tibia", "foot": "calcn", "toes": "toes"}
_ORIGINS = {"thigh": "knee", "shank": "ankle", "foot": "ankle", "toes": "toes"}
_STEPS, _THERE = 60, 1e-14  # most steps, tolerance [m or rad]
# Damping of steps at first and at least; singular values that count as none.
_DAMPING, _LEAST_DAMPING, _SINGULAR = 1e-3, 1e-14, 1e-4
# Misfit [m or rad] that is told, and one that is refused: in a real walk feet
# that much deeper bear up to 0.9 N more, and an audit lets 1 N pass.
_TOLD, _FARTHEST = 1e-8, 1e-5


@dataclass(frozen=True)
class Copy:
    """One copy of a planar body in the OpenSim model.

    Attributes:
        body: of the OpenSim model.
        frame: pose of the planar body's frame in it.
        end: suffix of names, such as "_r"; empty for what exists once.
    """

    body: str
    frame: Pose
    end: str


class Copies:
    """Finds the planar model's bodies in the OpenSim model.

    Args:
        model: planar, of one leg or two.
        person: the OpenSim model, as read.
    """

    def __init__(self, model: Model, person: OsimPerson):
        self.model, self.person = model, person
        self.who: Person = model.assembly.human
        self.tree = model.tree
        self.zero = {
            name: (R[0], p[0]) for name, (R, p) in person.osim.poses().items()
        }

    @property
    def ends(self) -> tuple[str, ...]:
        """Name suffixes of the copies of a body that has no side."""
        return ("",) if self.who.sides else tuple(ENDS.values())

    @property
    def share(self) -> float:
        """Share of stiffness and mass that each of these copies gets."""
        return 1.0 / len(self.ends)

    def of(self, segment: str) -> Iterator[Copy]:
        """Copies of a segment of the person."""
        part, _, side = segment.partition("_")
        for end in self.ends:
            own = side or next((s for s, e in ENDS.items() if e == end), "")
            body = "pelvis" if part == "pelvis" else _BODIES[part] + ENDS[own]
            named = end or (ENDS[own] if own else "")
            yield Copy(body, self._frame(body, part, own), named)

    def aside(self, copy: Copy) -> float:
        """Place to the right [m] of a copy's frame; it moves in this plane."""
        R, p = self.zero[copy.body]
        return float((p + R @ copy.frame.p)[2])

    def _frame(self, body: str, part: str, side: str) -> Pose:
        """Pose of a segment's frame in a body, with all coordinates zero."""
        R_GP, (_, p_GP) = upright(self.person.osim), self.zero["pelvis"]
        place, lean, aside = self.person.middle, 0.0, 0.0
        if part != "pelvis":
            at = self.person.places[side]
            place = place + at[_ORIGINS[part]]
            above = {"thigh": "hip", "shank": "knee"}.get(part)
            if above is not None:
                along = at[above] - at[_ORIGINS[part]]
                lean = np.angle(along / 1j)
            hung = JOINTS[_ORIGINS[part]] + ENDS[side]
            R, p = self.zero[hung]
            p_M = p + R @ self.person.osim.joint_of(hung).X_CM.p
            aside = (R_GP.T @ (p_M - p_GP))[2]
        p_PS = np.array([place.real, place.imag, aside])
        R_GB, p_GB = self.zero[body]
        return Pose(
            R_GB.T @ R_GP @ about_z(lean), R_GB.T @ (p_GP + R_GP @ p_PS - p_GB)
        )


def about_z(angle: float) -> np.ndarray:
    """Rotation matrix of a turn about z [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def on_frame(frame: Pose, x: float, z: float, angle: float = 0.0) -> Pose:
    """Pose in a body of a planar frame that is given in a segment's frame."""
    return Pose(
        frame.R @ about_z(angle), frame.p + frame.R @ np.array([x, z, 0.0])
    )


@dataclass(frozen=True)
class Link:
    """A pin joint of the device: its name, and the links that it joins."""

    joint: str
    parent: str
    child: str


def states_of(copies: Copies, links, osim: OsimModel, trial: Trial):
    """Coordinates and speeds (n,) of the OpenSim model in a trial, by name.

    And the largest misfit of a segment [m or rad]: a leg that is nearly
    straight may be too short by what a sliding knee takes.

    Raises:
        InputError: a misfit is beyond 10 µm or µrad.
    """
    tree, n = copies.tree, len(trial.times)
    q: dict[str, np.ndarray] = {}
    v: dict[str, np.ndarray] = {}
    misfits = [0.0]

    def reach(names, segment, copy: Copy, rows=(0, 1, 2)):
        aside = np.array([copies.aside(copy), 0.0, 0.0])
        place, angle, motion = tree.link_motion(trial.q, trial.v, segment)
        target = np.column_stack([place.T, angle, np.tile(aside, (n, 1))])
        rate = np.column_stack([motion.T, np.zeros((n, 3))])
        misfit = _reach(osim, q, v, names, copy, target, rate, list(rows))
        worst = int(np.argmax(misfit))
        if misfit[worst] > _FARTHEST:
            raise InputError(
                f"{osim.source}: cannot put the {segment.replace('_', ' ')} "
                f"where the calibrated person has it in {trial.name} at "
                f"{trial.times[worst]:.2f} s ({1e6 * misfit[worst]:.0f} µm or "
                "µrad off); give the model that the study was calibrated with"
            )
        misfits.append(float(misfit[worst]))

    (pelvis,) = {copy.body: copy for copy in copies.of("pelvis")}.values()
    names = _root(osim)
    for name in names:
        q[name], v[name] = np.zeros((2, n))
    reach(names, "pelvis", pelvis)
    for part_of in copies.who.suffixes:
        for copy in copies.of(f"foot{part_of}"):
            pins = pin_motions(copies, osim, trial, copy.end)
            names = list(pins)
            for name, (angle, rate) in pins.items():
                q[name], v[name] = angle, rate
            free = _free(osim, copy.body)
            if len(free) < 6:
                reach(names, f"foot{part_of}", copy)
                continue
            for name in free:
                q.setdefault(name, np.full(n, osim.rest.get(name, 0.0)))
                v.setdefault(name, np.zeros(n))
            reach(free, f"foot{part_of}", copy, range(6))
        if copies.who.toes == "hinged":
            for copy in copies.of(f"toes{part_of}"):
                name, _ = _hinge(osim, f"toes{copy.end}")
                q[name], v[name] = np.zeros((2, n))
                reach([name], f"toes{part_of}", copy, (2,))
    for link in links:
        row = tree.turning(link.child) - tree.turning(link.parent)
        q[f"{link.joint}_angle"] = trial.q @ row
        v[f"{link.joint}_angle"] = trial.v @ row
    _couple(osim, q, v)
    return q, v, max(misfits)


def _hinge(osim: OsimModel, body: str) -> tuple[str, float]:
    """Coordinate that turns a body about z, and the angle by it."""
    joint = osim.joint_of(body)
    found = flexing(osim, joint)
    if found is None:
        raise InputError(
            f"{osim.source}: joint {joint.name!r} is fixed, but the "
            "calibrated person's turns; say toes: rigid and calibrate again"
        )
    return found


def pin_motions(copies: Copies, osim: OsimModel, trial: Trial, end: str):
    """Coordinate of a leg -> angle and speed (n,) that it had as a pin."""
    (side,) = (side for side, own in ENDS.items() if own == end)
    suffix = f"_{side}" if copies.who.sides else ""
    parts = ("pelvis", *(f"{p}{suffix}" for p in ("thigh", "shank", "foot")))
    at, tree = copies.person.places[side], copies.tree
    along = 1j, at["hip"] - at["knee"], at["knee"] - at["ankle"], 1j
    angles = [
        tree.body_angles(trial.q, part) - np.angle(upwards / 1j)
        for part, upwards in zip(parts, along, strict=True)
    ]
    rates = [trial.v @ tree.turning(part) for part in parts]
    found = {}
    for i, joint in enumerate(("hip", "knee", "ankle")):
        name, turn = _hinge(osim, JOINTS[joint] + end)
        found[name] = [(x[i + 1] - x[i]) / turn for x in (angles, rates)]
    return found


def _free(osim: OsimModel, body: str) -> list[str]:
    """Coordinates between the pelvis and a body that are not locked."""
    found = []
    while body != "pelvis":
        joint = osim.joint_of(body)
        found += [
            name
            for name, locked in zip(
                joint.coordinates, joint.locked, strict=True
            )
            if not locked
        ]
        body = joint.parent
    return found


def _root(osim: OsimModel) -> list[str]:
    """Coordinates that tilt the pelvis, and move it forward and up."""
    joint = osim.joint_of("pelvis")
    tilt = flexing(osim, joint)
    poses, p = osim.poses(), osim.poses()["pelvis"][1]
    moved = {
        name: osim.motion(name, "pelvis", p, {}, poses)[1][0]
        for name in joint.coordinates
        if tilt is None or name != tilt[0]
    }
    found = [
        max(moved, key=lambda name: abs(moved[name][axis]), default="")
        for axis in (0, 1)
    ]
    if tilt is None or any(
        not abs(moved[name][axis]) > 0.9 for axis, name in enumerate(found)
    ):
        raise InputError(
            f"{osim.source}: joint {joint.name!r} does not move the pelvis "
            "forward, up and about z"
        )
    return [tilt[0], *found]


def _reach(osim, q, v, names, copy: Copy, target, rate, rows) -> np.ndarray:
    """Find coordinates `q`, speeds `v` that put a body's frame on a target.

    By Levenberg and Marquardt's method, all n states at once, from `q` on;
    speeds are those nearest to `v`. Columns of `target`, `rate` (n, 6), of
    which `rows` are met: x, y, angle in the plane, z, and x and y of the
    frame's z axis, zero where it is normal to the plane.

    Returns:
        Largest misfit of each state, (n,).
    """
    n = len(target)

    def jacobian(q, of):
        poses = osim.poses(q, n)
        R_GB, p_GB = poses[copy.body]
        R, p = R_GB @ copy.frame.R, p_GB + R_GB @ copy.frame.p
        J = np.zeros((n, 6, len(of)))
        c, s = R[:, 0, 0], R[:, 1, 0]
        for k, name in enumerate(of):
            turn, motion = osim.motion(name, copy.body, p, q, poses)
            spin = np.cross(turn, R[:, :, 0])
            J[:, :2, k] = motion[:, :2]
            J[:, 2, k] = (c * spin[:, 1] - s * spin[:, 0]) / (c**2 + s**2)
            J[:, 3, k] = motion[:, 2]
            J[:, 4:, k] = np.cross(turn, R[:, :, 2])[:, :2]
        pose = [p[:, :2], np.arctan2(s, c), p[:, 2], R[:, :2, 2]]
        error = target - np.column_stack(pose)
        error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
        return error[:, rows], J[:, rows]

    damping, eye = np.full(n, _DAMPING), np.eye(len(rows))
    error, J = jacobian(q, names)
    for _ in range(_STEPS):
        if np.abs(error).max() < _THERE:
            break
        A = J @ J.transpose(0, 2, 1) + damping[:, None, None] * eye
        pull = np.linalg.solve(A, error[:, :, None])
        step = (J.transpose(0, 2, 1) @ pull)[:, :, 0]
        tried = q | {name: q[name] + step[:, k] for k, name in enumerate(names)}
        left, slope = jacobian(tried, names)
        nearer = np.linalg.norm(left, axis=1) < np.linalg.norm(error, axis=1)
        for name in names:
            q[name] = np.where(nearer, tried[name], q[name])
        error = np.where(nearer[:, None], left, error)
        J = np.where(nearer[:, None, None], slope, J)
        damping = np.where(nearer, 0.1, 10.0) * damping
        damping = np.maximum(damping, _LEAST_DAMPING)
    moving = list(v)
    _, K = jacobian(q, moving)
    known = np.stack([v[name] for name in moving], axis=1)
    left = rate[:, rows] - np.einsum("nij,nj->ni", K, known)
    more = np.linalg.pinv(J, rcond=_SINGULAR) @ left[:, :, None]
    for k, name in enumerate(names):
        v[name] = v[name] + more[:, k, 0]
    return np.abs(error).max(axis=1)


def _couple(osim: OsimModel, q, v) -> None:
    """Set the coordinates that the model's constraints couple to others."""
    for coupler in osim.couplers:
        at = q.get(coupler.independent)
        if at is not None:
            slope = coupler.function(at, 1)
            q[coupler.dependent] = coupler.function(at, 0)
            v[coupler.dependent] = slope * v[coupler.independent]


def write_states(
    path: Path,
    osim: OsimModel,
    trial: Trial,
    q,
    v,
    energies: list[str],
    mark: str = "",
) -> None:
    """Write states by OpenSim's names; coordinates that do not move rest.

    Zero are `energies`, dissipated in bushings, whose start does not matter.
    """
    columns, values = [], []
    zero = np.zeros(len(trial.times))
    q = osim.at_rest(len(zero)) | q
    for joint in osim.joints:
        for name in joint.coordinates:
            for what, of in (("value", q), ("speed", v)):
                columns.append(f"/jointset/{joint.name}/{name}/{what}")
                values.append(of.get(name, zero))
    columns += energies
    values += [zero] * len(energies)
    table = Table(
        trial.times, tuple(columns), np.column_stack(values), in_degrees=False
    )
    write_table(path, table, f"States of {trial.name}", mark, digits=17)


def write_forces(
    path: Path, copies: Copies, trial: Trial, mark: str = ""
) -> None:
    """Write the forces on each foot, by chair and loads as OpenSim reads them.

    A foot's acts in the plane in which it moves, others in the middle.
    """
    two = bool(copies.who.sides)
    columns, values = external_loads(
        {
            end: trial.soles[side if two else "both"]
            for side, end in ENDS.items()
        },
        1.0 if two else 0.5,
    )
    for part_of in copies.who.suffixes:
        for copy in copies.of(f"foot{part_of}"):
            at = columns.index(f"ground_force{copy.end}_pz")
            values[:, at] = copies.aside(copy)
    if others := trial.loads(None):
        named, more = external_loads({f"_{b}": w for b, w in others.items()})
        columns, values = columns + named, np.hstack([values, more])
    table = Table(trial.times, tuple(columns), values, in_degrees=False)
    title = f"Ground reaction of {trial.name}"
    write_table(path, table, title, mark, digits=17)


def turned_off(copies: Copies, q, trial: Trial) -> dict[str, float]:
    """Leg's coordinate -> largest difference from the pin's angle [rad]."""
    return {
        name: float(np.abs(q[name] - angle).max())
        for end in ENDS.values()
        for name, (angle, _) in pin_motions(
            copies, copies.person.osim, trial, end
        ).items()
    }


_GROUND = "contact_ground"
# From x forward, y left, z up to OpenSim's x forward, y up, z right.
_Q = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_SAME = 1e-6  # relative, of lengths and masses


@dataclass(frozen=True)
class Export:
    """What an export has written.

    Attributes:
        files: the model first.
        lines: what was carried over and how, in sentences.
    """

    files: tuple[Path, ...]
    lines: tuple[str, ...]


def _contact(folder: Path, accept: Sequence[str]) -> tuple[ContactModel, str]:
    """Contact in a folder, if it holds or is accepted, and its mark."""
    found, path = read_calibration(folder), folder / "summary.json"
    said, own = None, Verdict((found.own_check,))
    if path.is_file():
        again = "run the command that wrote it again"
        said = stored(read_json(path, again), path)
    asked = own if said is None or found.origin is not None else said
    return found.taken(asked.failing, accept), (said or own).mark


def export_opensim(
    folder: str | Path,
    model_file: str | Path,
    out: str | Path,
    force: bool = False,
    accept: Sequence[str] = (),
) -> Export:
    """Write an OpenSim model with calibrated contacts, states and forces.

    Args:
        folder: that `calibrate`, `predict` or `design` wrote; of a design its
            cuffs and joints, without movements.
        model_file: the scaled model that the study's person was read from.
        out: the .osim file to write; states and forces go beside it.
        force: whether to replace files.
        accept: names of checks of the calibration that need not hold.

    Raises:
        InputError: something cannot be carried over, or is there already.
    """
    folder, out = Path(folder), Path(out)
    (contact, mark), model = _contact(folder, accept), read_model(folder)
    if (folder / DESIGN).is_file():  # the model is today's
        model = read_design(folder).model(model)
    if contact.ground.law != "simbody":
        raise InputError(
            f"{folder}: its foot-ground law is {contact.ground.law!r}, which "
            "OpenSim does not have; calibrate with foot_ground.law: simbody"
        )
    if contact.ground.constants.friction_rounding:
        raise InputError(
            f"{folder}: its friction is rounded at the transition velocity, "
            "but OpenSim's has a corner there; calibrate with "
            "foot_ground.constants.friction_rounding: 0"
        )
    if model.assembly.human.osim is None:
        raise InputError(
            f"{folder}: its person was not read from an OpenSim model; give "
            "model.human.osim in the study and calibrate again"
        )
    if out.suffix != ".osim":
        raise InputError(f"{out}: must end in .osim; correct --out")
    if os.path.realpath(out) == os.path.realpath(model_file):
        raise InputError(
            f"{out}: --out would replace the model that it is made of; "
            "choose another file"
        )
    # By both of a trial's files, so that one that is missing is told.
    stems = {
        path.stem.removeprefix("solution_")
        for path in folder.glob("solution_*")
        if path.suffix in (".npz", ".json")
    }
    trials = [read_trial(folder, s, accept=[SOLVED]) for s in sorted(stems)]
    names = [
        f"{out.stem}_{trial.name}_{what}.sto"
        for trial in trials
        for what in ("states", "ground_forces")
    ]
    files = (out, *(out.with_name(name) for name in names))
    for path in files:
        check_new(path, force)
    who = model.assembly.human
    person = read_person(model_file, who, model.human.height_m)
    mass, shift = _carried(folder, model, person)
    file = xml.OsimFile(model_file)
    _weigh(file, person, mass, shift)
    copies = Copies(model, person)
    _add_spheres(file, copies, contact)
    links = _add_device(file, copies) if model.has_device else ()
    _add_cuffs(file, copies, contact)
    out.parent.mkdir(parents=True, exist_ok=True)
    largest: dict[str, float] = {}
    misfits = {}
    # All files or none: a movement may be one that the model cannot make.
    with TemporaryDirectory(prefix=".", dir=out.parent) as draft:
        made = [Path(draft, path.name) for path in files]
        file.write(made[0])
        written = replace(read_osim(made[0]), source=person.osim.source)
        for trial, states, forces in zip(
            trials, made[1::2], made[2::2], strict=True
        ):
            q, v, misfits[trial.name] = states_of(copies, links, written, trial)
            energies = [
                f"/forceset/{e.get('name')}/dissipated_energy"
                for e in file.model.iterfind("ForceSet/objects/BushingForce")
            ]
            write_states(states, written, trial, q, v, energies, mark)
            write_forces(forces, copies, trial, mark)
            for name, angle in turned_off(copies, q, trial).items():
                largest[name] = max(angle, largest.get(name, 0.0))
        for path, target in zip(made, files, strict=True):
            os.replace(path, target)
    lines = (
        *([mark] if mark else []),
        *_said(copies, contact, mass, shift),
        *(
            f"coordinate {name!r} differs from the pin's angle by up to "
            f"{np.rad2deg(x):.1f} degrees, so that feet stay where they were"
            for name, x in largest.items()
            if x > np.deg2rad(0.05)
        ),
        *(
            f"{name}: feet are up to {1e6 * off:.1f} µm or µrad from where "
            "they were, out of a leg's reach"
            for name, off in misfits.items()
            if off > _TOLD
        ),
        *(
            f"{trial.name}: chair and loads act on the {body} by "
            f"ground_force_{body}"
            for trial in trials
            for body in trial.loads(None)
        ),
    )
    return Export(files, lines)


def _carried(folder: Path, model: Model, person: OsimPerson):
    """Factor on masses, and shift of the trunk's centre of mass (2,) [m]."""
    ours, theirs = model.human, person.human
    factor = ours.mass_kg / theirs.mass_kg
    shift = np.subtract(ours.pelvis.com_m, theirs.pelvis.com_m)
    for name in SEGMENTS:
        a, b = getattr(ours, name), getattr(theirs, name)
        pairs = [
            (a.mass_kg, factor * b.mass_kg),
            (a.inertia_kg_m2, factor * b.inertia_kg_m2),
        ]
        if name in ("thigh", "shank"):
            pairs.append((a.length_m, b.length_m))
        if name != "pelvis":
            pairs += zip(a.com_m, b.com_m, strict=True)
        if any(abs(x - y) > _SAME * (1e-3 + abs(y)) for x, y in pairs):
            raise InputError(
                f"{person.osim.source}: its {name} is not that of {folder}; "
                "give the model that the study was calibrated with, and leave "
                "subject.segments out"
            )
    return factor, shift


def _weigh(file: xml.OsimFile, person: OsimPerson, factor, shift) -> None:
    """Set masses, inertias and the trunk's centre of mass to the study's."""
    poses = person.osim.poses()
    moved = upright(person.osim) @ np.array([shift[0], shift[1], 0.0])
    for name, body in person.osim.bodies.items():
        element = file.body(name)
        xml.put(element, "mass", factor * body.mass_kg)
        xml.put(element, "inertia", xml.six(factor * body.inertia_kg_m2))
        if person.segments[name][0] == "pelvis" and shift.any():
            com = body.com_m + poses[name][0][0].T @ moved
            xml.put(element, "mass_center", com)


def _add_spheres(file, copies: Copies, contact: ContactModel) -> None:
    floor = xml.element(
        "ContactHalfSpace",  # below y = 0
        _GROUND,
        socket_frame="/ground",
        location="0 0 0",
        orientation=(0.0, 0.0, -0.5 * np.pi),
    )
    file.add("ContactGeometrySet", floor)
    constants = dict(vars(contact.ground.constants))
    del constants["friction_rounding"]
    for segment, ground in contact.ground.under(copies.model).items():
        for name, sphere in ground.spheres.items():
            for copy in copies.of(segment):
                place = on_frame(copy.frame, sphere.x, sphere.z).p
                label = f"contact_{name}{copy.end}"
                shape = f"{label}_sphere"
                ball = xml.element(
                    "ContactSphere",
                    shape,
                    socket_frame=f"/bodyset/{copy.body}",
                    location=place,
                    orientation="0 0 0",
                    radius=sphere.radius,
                )
                file.add("ContactGeometrySet", ball)
                made = xml.element(
                    "SmoothSphereHalfSpaceForce",
                    label,
                    socket_sphere=f"/contactgeometryset/{shape}",
                    socket_half_space=f"/contactgeometryset/{_GROUND}",
                    # The force is proportional to it.
                    stiffness=copies.share * sphere.stiffness,
                    dissipation=sphere.dissipation,
                    **constants,
                )
                file.add("ForceSet", made)


def _add_cuffs(file, copies: Copies, contact: ContactModel) -> None:
    t = copies.share
    for name, b in contact.bushings.items():
        links = copies.model.assembly.cuffs[name]
        held, frame = _held(copies, name)
        for copy in copies.of(links.human):
            kind, springs = _springs(b, t)
            end = copy.end if len(copies.ends) > 1 else ""
            device = on_frame(
                frame,
                b.origin_x + b.preload_x,
                b.origin_z + b.preload_z,
                b.preload_angle,
            )
            human = on_frame(copy.frame, b.origin_x, b.origin_z)
            label = f"cuff_{name}{end}"
            ends = {
                f"{label}_human": (copy.body, human),
                f"{label}_device": (f"{held}{end}", device),
            }
            first, second = ends
            made = xml.element(
                kind,
                label,
                socket_frame1=first,
                socket_frame2=second,
                **springs,
                rotational_damping=(0, 0, t * b.rotational_damping),
                translational_damping=(
                    t * b.normal_damping,
                    t * b.tangential_damping,
                    0,
                ),
            )
            xml.add_frames(made, ends)
            file.add("ForceSet", made)


def _springs(b: BushingParameters, share: float) -> tuple[str, dict]:
    """Class of OpenSim's force for one copy of a cuff, and its springs."""
    normal, along, turn = (
        share * k
        for k in (
            b.normal_stiffness,
            b.tangential_stiffness,
            b.rotational_stiffness,
        )
    )
    if b.slip == 0.0:
        return "BushingForce", {
            "rotational_stiffness": (0, 0, turn),
            "translational_stiffness": (normal, along, 0),
        }
    held = b.slip / share * along  # copies slip at their share of the force
    return "ExpressionBasedBushingForce", {
        "Mz_expression": f"{turn!r}*theta_z",
        "Fx_expression": f"{normal!r}*delta_x",
        "Fy_expression": (f"{along!r}*delta_y/(1+({held!r}*delta_y)^4)^0.25"),
    }


def _planar(poses: dict[str, np.ndarray], base: str, body: str) -> Pose:
    """Pose of one planar body in another (`base`), in OpenSim's axes."""
    x, z, angle = poses[body] - poses[base]
    turn = about_z(-poses[base][2])
    return Pose(about_z(angle), turn @ np.array([x, z, 0.0]))


def _held(copies: Copies, cuff: str) -> tuple[str, Pose]:
    """Link of the device that a cuff holds, and the cuff's frame on it."""
    _, body = copies.tree.cuffs[cuff]
    link = copies.model.assembly.cuffs[cuff].device
    return link, _planar(copies.model.upright_poses, link, body)


def _add_device(file, copies: Copies) -> tuple[Link, ...]:
    """Add the device's bodies and their joints, from the person outwards."""
    model = copies.model
    plant, poses = model.plant(), model.upright_poses
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    segments = set(copies.who.segments)
    shells = {f"{name}_shell" for name in model.assembly.cuffs}
    edges = []
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        ends = [joint.parent_body().name(), joint.child_body().name()]
        if joint.type_name() == "planar" or set(ends) <= segments:
            continue
        if not shells & set(ends):
            edges.append((joint, ends))
    found, done = [], set(segments)
    while edges:
        joint, ends = next(e for e in edges if set(e[1]) & done)
        edges = [e for e in edges if e[0] is not joint]
        parent, child = ends if ends[0] in done else ends[::-1]
        done.add(child)
        x, _, z = joint.frame_on_child().CalcPoseInWorld(context).translation()
        M_B = plant.GetBodyByName(child).CalcSpatialInertiaInBodyFrame(context)
        com = M_B.get_com()
        central = M_B.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()
        hinge = joint.num_positions() == 1
        for end, on in _ends_of(copies, parent, segments):
            file.add(
                "BodySet",
                xml.body(
                    f"{child}{end}",
                    copies.share * M_B.get_mass(),
                    _Q @ com,
                    copies.share * _Q @ central @ _Q.T,
                ),
            )
            name = f"{joint.name()}{end}" if hinge else f"{child}{end}_weld"
            places = [
                _at(poses[link], complex(x, z), frame)
                for link, frame in ((parent, on[1]), (child, None))
            ]
            file.add(
                "JointSet",
                xml.joint(
                    name,
                    f"{name}_angle" if hinge else None,
                    (on[0], places[0]),
                    (f"{child}{end}", places[1]),
                ),
            )
            if hinge:
                found.append(Link(name, parent, child))
    return tuple(found)


def _ends_of(copies: Copies, parent: str, segments):
    """Name's suffix, and (body, frame) that a link hangs from, of each copy."""
    if parent in segments:
        for copy in copies.of(parent):
            end = copy.end if len(copies.ends) > 1 else ""
            yield end, (copy.body, copy.frame)
        return
    for end in copies.ends:
        yield end, (f"{parent}{end}", Pose(np.eye(3), np.zeros(3)))


def _at(pose: np.ndarray, place: complex, frame: Pose | None) -> Pose:
    """Pose in a link of a frame at a place, along the world's axes."""
    x, z, angle = pose
    p = (place - complex(x, z)) * np.exp(-1j * angle)
    return on_frame(
        frame or Pose(np.eye(3), np.zeros(3)), p.real, p.imag, -angle
    )


def _said(copies: Copies, contact: ContactModel, mass, shift):
    """What was carried over, in sentences."""
    if not copies.who.sides:
        yield (
            "one leg stands for both: spheres, cuffs and links are on both "
            "legs, each with half the stiffness, damping, mass and inertia"
        )
    if abs(mass - 1.0) > _SAME:
        yield f"masses and inertias of all bodies times {mass:.4f}, as stated"
    if np.abs(shift).max() > _SAME:
        yield (
            "the trunk's centre of mass moved by "
            f"{1e3 * shift[0]:+.1f} mm forward, {1e3 * shift[1]:+.1f} mm up"
        )
    if contact.posterior is not None:
        yield "intervals of the parameters have no place in an OpenSim model"
    if copies.model.has_device:
        yield (
            "the device's links turn in the sagittal plane; their cuffs bear "
            "nothing to the side"
        )
