"""A calibration, written into the OpenSim model that its person was read from.

Spheres become SmoothSphereHalfSpaceForces, cuffs BushingForces (those that
slip ExpressionBasedBushingForces), the device's links bodies with pins. A
person of one leg has all of them on both legs, each with half the stiffness,
damping, mass and inertia. Movements become states of
the model: its pelvis, and feet, are where the planar ones are, so that knees
that slide do not move the contacts; hips, knees and ankles take up what the
planar pins lack.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.calibration.results import read_contact, read_model, read_trial
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.files import osim_writing as xml
from drake_exo.files.osim import Pose, read_osim
from drake_exo.model.osim_person import OsimPerson, read_person
from drake_exo.model.plant import Model
from drake_exo.model.segments import SEGMENTS
from drake_exo.report.opensim_states import (
    Copies,
    Link,
    about_z,
    exported_forces,
    on_frame,
    own_forces,
    states_of,
    turned_off,
    write_forces,
    write_states,
)

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
        difference_n: trial -> largest difference of a foot's force between
            our law at the solution and the exported numbers at the exported
            states, over time.
    """

    files: tuple[Path, ...]
    lines: tuple[str, ...]
    difference_n: dict[str, float]


def export_opensim(
    folder: str | Path,
    model_file: str | Path,
    out: str | Path,
    force: bool = False,
    accept: Sequence[str] = (),
) -> Export:
    """Write a model with calibrated contacts, and states of the movements.

    Args:
        folder: that `calibrate` or `predict` wrote.
        model_file: the scaled model that the study's person was read from.
        out: the .osim file to write; states and forces go beside it.
        force: whether to replace files.
        accept: names of checks of the calibration that need not hold.

    Raises:
        InputError: something cannot be carried over, or is there already.
    """
    folder, out = Path(folder), Path(out)
    contact, model = read_contact(folder, accept), read_model(folder)
    if contact.ground.law != "simbody":
        raise InputError(
            f"{folder}: its foot-ground law is {contact.ground.law!r}, which "
            "OpenSim does not have; calibrate with foot_ground.law: simbody"
        )
    if model.assembly.human.osim is None:
        raise InputError(
            f"{folder}: its person was not read from an OpenSim model; give "
            "model.human.osim in the study and calibrate again"
        )
    if out.suffix != ".osim":
        raise InputError(f"{out}: must end in .osim; correct --out")
    trials = [
        read_trial(folder, path.stem.removeprefix("solution_"))
        for path in sorted(folder.glob("solution_*.npz"))
    ]
    names = [
        f"{out.stem}_{trial.name}_{what}.sto"
        for trial in trials
        for what in ("states", "ground_forces")
    ]
    files = (out, *(out.with_name(name) for name in names))
    there = [path for path in files if path.exists()]
    if there and not force:
        raise InputError(f"{there[0]}: exists already; say --force to replace")
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
    file.write(out)
    written = read_osim(out)
    differences, largest = {}, {}
    for trial, states, forces in zip(
        trials, files[1::2], files[2::2], strict=True
    ):
        q, v = states_of(copies, links, written, trial)
        energies = [
            f"/forceset/{e.get('name')}/dissipated_energy"
            for e in file.model.iterfind("ForceSet/objects/BushingForce")
        ]
        write_states(states, written, trial, q, v, energies)
        write_forces(forces, copies, trial)
        own = own_forces(copies, contact, trial)
        theirs = exported_forces(xml.OsimFile(out), written, q, v)
        off = max(np.abs(own[s] - theirs[s]).max() for s in own)
        differences[trial.name] = float(off)
        for name, angle in turned_off(copies, q, trial).items():
            largest[name] = max(angle, largest.get(name, 0.0))
    lines = (
        *_said(copies, contact, mass, shift),
        *(
            f"coordinate {name!r} differs from the pin's angle by up to "
            f"{np.rad2deg(x):.1f} degrees, so that feet stay where they were"
            for name, x in largest.items()
            if x > np.deg2rad(0.05)
        ),
    )
    return Export(files, lines, differences)


def _carried(folder: Path, model: Model, person: OsimPerson):
    """Factor of the masses, and shift of the trunk's centre of mass.

    Raises:
        InputError: other values of the person were changed, or it is of
            another model.
    """
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
    """Masses as the study states them, the trunk's centre where it put it."""
    poses = person.osim.poses()
    R_GP = poses["pelvis"][0][0]
    moved = R_GP @ np.array([shift[0], shift[1], 0.0])
    for name, body in person.osim.bodies.items():
        element = file.body(name)
        element.find("mass").text = repr(float(factor * body.mass_kg))
        inertia = np.array(element.findtext("inertia").split(), float)
        element.find("inertia").text = xml.text_of(factor * inertia)
        if person.segments[name][0] == "pelvis" and shift.any():
            com = body.com_m + poses[name][0][0].T @ moved
            element.find("mass_center").text = xml.text_of(com)


def _add_spheres(file, copies: Copies, contact: ContactModel) -> None:
    file.add("ContactGeometrySet", xml.half_space(_GROUND))
    constants = contact.ground.constants
    for segment, ground in contact.ground.under(copies.model).items():
        for name, sphere in ground.spheres.items():
            for copy in copies.of(segment):
                place = on_frame(copy.frame, sphere.x, sphere.z).p
                label = f"contact_{name}{copy.end}"
                shape = f"{label}_sphere"
                file.add(
                    "ContactGeometrySet",
                    xml.sphere(shape, copy.body, place, sphere.radius),
                )
                values = {
                    # The force is in proportion to it.
                    "stiffness": copy.share * sphere.stiffness,
                    "dissipation": sphere.dissipation,
                    **vars(constants),
                }
                made = xml.sphere_force(label, shape, _GROUND, values)
                file.add("ForceSet", made)


def _add_cuffs(file, copies: Copies, contact: ContactModel) -> None:
    for name, b in contact.bushings.items():
        links = copies.model.assembly.cuffs[name]
        held, frame = _held(copies, name)
        for copy in copies.of(links.human):
            kind, springs = _springs(b, copy.share)
            t = copy.share
            values = {
                **springs,
                "rotational_damping": (0, 0, t * b.rotational_damping),
                "translational_damping": (
                    t * b.normal_damping,
                    t * b.tangential_damping,
                    0,
                ),
            }
            end = copy.end if len(copies.ends) > 1 else ""
            device = on_frame(
                frame,
                b.origin_x + b.preload_x,
                b.origin_z + b.preload_z,
                b.preload_angle,
            )
            human = on_frame(copy.frame, b.origin_x, b.origin_z)
            made = xml.bushing(
                f"cuff_{name}{end}",
                (copy.body, human),
                (f"{held}{end}", device),
                values,
                kind,
            )
            file.add("ForceSet", made)


def _springs(b: BushingParameters, share: float) -> tuple[str, dict]:
    """OpenSim's force that holds one copy of a cuff, and its springs."""
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
    """One body's frame in another's, both of the plane, in OpenSim's axes."""
    x, z, angle = poses[body] - poses[base]
    turn = about_z(-poses[base][2])
    return Pose(about_z(angle), turn @ np.array([x, z, 0.0]))


def _held(copies: Copies, cuff: str) -> tuple[str, Pose]:
    """Link of the device that a cuff holds, and the cuff's frame on it."""
    _, body = copies.tree.cuffs[cuff]
    link = copies.model.assembly.cuffs[cuff].device
    return link, _planar(copies.model.upright_poses, link, body)


def _add_device(file, copies: Copies) -> tuple[Link, ...]:
    """Bodies of the device, and their joints, from the person outwards."""
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
            share = 1.0 / len(copies.ends)
            file.add(
                "BodySet",
                xml.body(
                    f"{child}{end}",
                    share * M_B.get_mass(),
                    _Q @ com,
                    share * _Q @ central @ _Q.T,
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
    """Name's end, and (body, frame) that a link hangs from, copy by copy."""
    if parent in segments:
        for copy in copies.of(parent):
            end = copy.end if len(copies.ends) > 1 else ""
            yield end, (copy.body, copy.frame)
        return
    for end in copies.ends:
        yield end, (f"{parent}{end}", Pose(np.eye(3), np.zeros(3)))


def _at(pose: np.ndarray, place: complex, frame: Pose | None) -> Pose:
    """A frame along the world's axes at a place, as a link has it."""
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
