"""Contacts, cuffs and device in an OpenSim model, against OpenSim's forces."""

import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from opensim_answers import ask
from scipy.spatial.transform import Rotation
from small_osim import in_axes_of, small_osim

from drake_exo.calibration.results import write_contact, write_model
from drake_exo.cli import main
from drake_exo.contact.bushing import bushing_deflection, bushing_force
from drake_exo.contact.hunt_crossley import SimbodyConstants, sphere_wrench
from drake_exo.contact.parameters import nominal_contact
from drake_exo.contact.strap import (
    CuffDesign,
    Design,
    JointDesign,
    write_design,
)
from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table
from drake_exo.files.osim import OsimCoupler, OsimFile, Pose, read_osim
from drake_exo.files.output import Check, write_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import (
    COUPLED,
    Assembly,
    CuffLinks,
    DeviceFile,
    Person,
    Weld,
)
from drake_exo.model.description import fit_exoskeleton, models_path
from drake_exo.model.device_file import with_text
from drake_exo.model.osim_person import read_person
from drake_exo.model.plant import Model
from drake_exo.report import opensim_export
from drake_exo.report.opensim_export import export_opensim


def worn(file, weld, cuffs, human):
    """A person with one of the devices that ship."""
    device = DeviceFile(weld, Path(file))
    return with_text(Assembly(human, device, cuffs), models_path())


ONE = Person(osim=Path("m.osim"))
TWO = Person("two", "hinged", Path("m.osim"))
MODELS = {
    "alone": Assembly(ONE),
    "two legs": Assembly(TWO),
    "coupled": replace(COUPLED, human=ONE),
    "hip": worn(
        "hip_only.urdf",
        {"belt": "pelvis"},
        {"thigh": CuffLinks("thigh_right", "bar")},
        TWO,
    ),
    "turned ankle": worn(
        "ankle_only.urdf",
        {"shoe": Weld("foot", (0.02, -0.01), 12.0)},
        {"calf": CuffLinks("shank", "calf", (0.01, 0.22))},
        ONE,
    ),
}


@dataclass
class Case:
    """Results on disk, and what they hold."""

    folder: Path
    osim: Path
    model: Model
    contact: object
    trial: Trial

    def export(self, name="out.osim", **options):
        out = self.folder.parent / name
        return export_opensim(
            self.folder, self.osim, out, accept=["provenance"], **options
        )


@pytest.fixture
def case(tmp_path):
    """Makes results whose movement is any, with feet near the ground."""

    def made(
        kind,
        knee="CustomJoint",
        law="simbody",
        scale=1.1,
        shift=0.012,
        changed=str,
    ):
        osim = tmp_path / "m.osim"
        osim.write_text(changed(small_osim(knee)))
        assembly = MODELS[kind]
        human = read_person(osim, assembly.human, 1.75).human
        parts = {
            name: replace(
                part,
                mass_kg=scale * part.mass_kg,
                inertia_kg_m2=scale * part.inertia_kg_m2,
            )
            for name, part in vars(human).items()
            if name in ("foot", "shank", "thigh", "pelvis", "toes")
        }
        x, z = human.pelvis.com_m
        parts["pelvis"] = replace(parts["pelvis"], com_m=(x + shift, z))
        human = replace(human, **parts)
        device = fit_exoskeleton(human) if assembly.is_fitted else None
        model = Model(assembly, human, device)
        contact = nominal_contact(model, law)
        values = {
            name: value * (1.0 + 0.05 * i)
            for i, (name, value) in enumerate(contact.values().items())
            if not name.endswith("radius")
        }
        contact = contact.with_values(values)
        for name, bushing in contact.bushings.items():
            contact.bushings[name] = replace(
                bushing,
                preload_x=0.004,
                preload_z=-0.003,
                preload_angle=0.05,
                slip=0.0 if name == "pelvis" else 0.02,
            )
        trial = moved(model)
        folder = tmp_path / "results"
        folder.mkdir(exist_ok=True)
        write_model(folder, model)
        write_contact(folder, contact)
        trial.save(folder / "solution_a")
        return Case(folder, osim, model, contact, trial)

    return made


def moved(model, n=9):
    """Joints bent, a foot's lowest sphere 4 mm in the ground."""
    rng = np.random.default_rng(8)
    tree, names = model.tree, model.coordinates
    q = rng.uniform(-0.25, 0.25, (n, len(names)))
    v = rng.uniform(-1.0, 1.0, (n, len(names)))
    for i, name in enumerate(names.names):
        if "knee" in name:
            q[:, i] += 0.8
    q[:, :2] = 0.0
    lowest = [
        tree.point_positions(q, body, place)[:, 1]
        for body, spheres in model.soles.items()
        for place in spheres.values()
    ]
    q[:, 1] = 0.028 - np.min(lowest, axis=0)
    zero = PlanarWrench(np.ones((n, 2)) * [20.0, 700.0], np.full(n, -70.0))
    sides = ("left", "right") if model.assembly.human.sides else ()
    return Trial(
        "a",
        names,
        np.arange(n) / 100.0,
        q=q,
        v=v,
        a=0.0 * q,
        ground=zero + zero if sides else zero,
        feet=dict.fromkeys(sides, zero),
        moments=np.zeros((n, names.num_joints)),
        source="solved",
    )


def pose_and_motion(case, body):
    """x, z, angle of a body's frame and their rates, (3, n) each."""
    tree, q, v = case.model.tree, case.trial.q, case.trial.v
    J = tree.point_jacobian(q, body, (0.0, 0.0))
    motion = np.einsum("nij,nj->ni", J, v)
    p = tree.point_positions(q, body, (0.0, 0.0))
    angle = tree.body_angles(q, body)
    return (*p.T, angle), (*motion.T, v @ tree.turning(body))


def sphere_forces(case):
    """Force (n, 2) of each exported sphere by our law."""
    found = {}
    sides = bool(case.model.assembly.human.sides)
    for body, ground in case.contact.ground.under(case.model).items():
        for name, s in ground.spheres.items():
            tree, trial = case.model.tree, case.trial
            J = tree.point_jacobian(trial.q, body, (s.x, s.z))
            wrench = sphere_wrench(
                "simbody",
                *tree.point_positions(trial.q, body, (s.x, s.z)).T,
                *np.einsum("nij,nj->in", J, trial.v),
                trial.v @ tree.turning(body),
                s.stiffness,
                s.dissipation,
                s.radius,
                ground.constants,
            )
            force = np.column_stack([wrench.force_x, wrench.force_z])
            for end in "lr":
                if not sides:
                    found[f"contact_{name}_{end}"] = 0.5 * force
                elif body.split("_")[1][0] == end:
                    found[f"contact_{name}_{end}"] = force
    return found


def cuff_forces(case):
    """Force (n, 2) on the human and moment about the cuff's frame there."""
    found = {}
    for name, b in case.contact.bushings.items():
        human, device = case.model.tree.cuffs[name]
        h, h_motion = pose_and_motion(case, human)
        e, e_motion = pose_and_motion(case, device)
        d, rate = bushing_deflection(
            h, h_motion, e, e_motion, b.origin, b.preload
        )
        force = bushing_force(d, rate, b.stiffness, b.damping, b.slip)
        c, s = np.cos(h[2]), np.sin(h[2])
        F = np.column_stack(
            [
                c * force.normal - s * force.tangential,
                s * force.normal + c * force.tangential,
            ]
        )
        found[name] = F, force.rotation
    return found


def exported_forces(out, states):
    """Force (n, 2) of each sphere by the numbers of both files alone."""
    file, osim, table = OsimFile(out), read_osim(out), read_table(states)
    n = len(table.time)
    q, v = (
        {
            name.split("/")[3]: table.column(name)
            for name in table.names
            if name.endswith(what)
        }
        for what in ("/value", "/speed")
    )
    poses = osim.poses(q, n)
    found = {}
    kind = "SmoothSphereHalfSpaceForce"
    for force in file.model.iterfind(f"ForceSet/objects/{kind}"):
        name = force.get("name")
        shape = file.model.find(
            f"ContactGeometrySet/objects/ContactSphere[@name='{name}_sphere']"
        )
        body = shape.findtext("socket_frame").rpartition("/")[2]
        R, p = poses[body]
        centre = p + R @ np.array(shape.findtext("location").split(), float)
        turn, motion = np.zeros((2, n, 3))
        for coordinate, speed in v.items():
            rates = osim.motion(coordinate, body, centre, q, poses)
            turn += rates[0] * speed[:, None]
            motion += rates[1] * speed[:, None]
        constants = SimbodyConstants(
            **{
                key: float(force.findtext(key))
                for key in vars(SimbodyConstants())
                if key != "friction_rounding"
            }
        )
        wrench = sphere_wrench(
            "simbody",
            *centre[:, :2].T,
            *motion[:, :2].T,
            turn[:, 2],
            float(force.findtext("stiffness")),
            float(force.findtext("dissipation")),
            float(shape.findtext("radius")),
            constants,
        )
        found[name] = np.column_stack([wrench.force_x, wrench.force_z])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", MODELS)
def test_exported_numbers_give_the_calibrated_forces(case, kind):
    """Sliding knees and all, by the exported file and states alone."""
    one = case(kind)
    out, states, _ = one.export().files
    own, theirs = sphere_forces(one), exported_forces(out, states)
    assert max(np.abs(f).max() for f in own.values()) > 50.0
    assert own.keys() == theirs.keys()
    for name, force in own.items():
        assert np.abs(theirs[name] - force).max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("kind", MODELS)
def test_bodies_move_as_the_planar_ones(case, kind):
    one = case(kind)
    out, states, _ = one.export().files
    model, table = read_osim(out), read_table(states)
    q = {
        name.split("/")[3]: table.column(name)
        for name in table.names
        if name.endswith("value")
    }
    poses = model.poses(q, len(table.time))
    people = set(one.model.assembly.human.segments)
    links = [
        name
        for name in one.model.tree.names
        if name not in people and not name.endswith("_shell")
    ]
    sides = bool(one.model.assembly.human.sides)
    for link in links:
        for end in ("",) if sides else ("_l", "_r"):
            R, p = poses[link + end]
            (x, z, angle), _ = pose_and_motion(one, link)
            # A knee that slides takes the thigh along, and its pins with it.
            stiff = link.startswith(("exo_foot", "shoe", "belt"))
            if stiff:
                np.testing.assert_allclose(p[:, 0], x, atol=1e-9)
                np.testing.assert_allclose(p[:, 1], z, atol=1e-9)
                turned = np.exp(1j * angle)
                np.testing.assert_allclose(
                    R[:, 0, 0] + 1j * R[:, 1, 0], turned, atol=1e-9
                )
    # Nothing is lost or doubled.
    assert model.mass_kg == pytest.approx(one.model.tree.mass)
    if not links:
        com = sum(
            body.mass_kg * (p + R @ body.com_m)
            for name, body in model.bodies.items()
            for R, p in [poses[name]]
        )
        own = one.model.tree.center_of_mass(one.trial.q)
        # As far as the knees slide.
        found = com[:, :2] / model.mass_kg
        np.testing.assert_allclose(found, own, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("knee", ["PinJoint", "CustomJoint"])
@pytest.mark.parametrize("kind", MODELS)
def test_opensims_forces_are_ours(case, kind, knee, tmp_path):
    one = case(kind, knee)
    out, states, _ = one.export().files
    records = ask(tmp_path, model=str(out), states=str(states))["records"]
    spheres = sphere_forces(one)
    scale = max(np.abs(force).max() for force in spheres.values())
    assert scale > 50.0
    for name, force in spheres.items():
        found = [records[name][f"{name}.Sphere.force.{x}"] for x in "XY"]
        assert np.abs(np.transpose(found) - force).max() < 1e-9 * scale
    if knee == "CustomJoint":
        return  # there a cuff moves with the segment that slides
    for cuff, (force, _) in cuff_forces(one).items():
        scale = np.abs(force).max()
        assert scale > 5.0
        own = {n: r for n, r in records.items() if n.startswith(f"cuff_{cuff}")}
        share = 1.0 / len(own)
        for record in own.values():
            # The first frame is the human's.
            first = list(record.values())
            found = np.transpose(first[:2])
            assert np.abs(found - share * force).max() < 1e-9 * scale


def exported(one):
    """The written model, and its coordinates and speeds by name."""
    out, states, _ = one.export().files
    table = read_table(states)
    q, v = (
        {
            name.split("/")[3]: table.column(name)
            for name in table.names
            if name.endswith(what)
        }
        for what in ("value", "speed")
    )
    return out, read_osim(out), q, v


CT = Rotation.from_rotvec([2.0, -0.5, 1.0]).as_matrix()


def leaning(text):
    """With its back locked at 17 degrees, and without numbers that are zero."""
    text = text.replace("<mass_center>0 0 0</mass_center>", "")
    text = text.replace("<inertia>0.001 0.001 0.001 0 0 0</inertia>", "")
    before, joint = text.split('<WeldJoint name="back">')
    joint, after = joint.split("</WeldJoint>", 1)
    return f"""{before}<PinJoint name="back">{joint}<coordinates>
        <Coordinate name="lumbar_extension"><default_value>0.3</default_value>
        <locked>true</locked></Coordinate></coordinates></PinJoint>{after}"""


def loose(text):
    """With knees of six coordinates, whose bones are 0.05 m apart."""
    names = ("angle", "add", "rot", "tx", "ty", "tz")
    axes = ("0 0 1", "1 0 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")
    for s in "rl":
        start = text.index(f'<PinJoint name="knee_{s}">')
        pin = text[start : text.index("</PinJoint>", start)]
        (old,) = re.findall("<coordinates>.*?</coordinates>", pin, re.DOTALL)
        coordinates = "".join(
            f'<Coordinate name="knee_{name}_{s}"><default_value>'
            f"{-0.05 if name == 'ty' else 0.0}</default_value></Coordinate>"
            for name in names
        )
        transform = "".join(
            f'<TransformAxis name="{"rotation" if k < 3 else "translation"}'
            f'{k % 3 + 1}"><coordinates>knee_{name}_{s}</coordinates>'
            f"<axis>{axis}</axis><LinearFunction/></TransformAxis>"
            for k, (name, axis) in enumerate(zip(names, axes, strict=True))
        )
        free = pin.replace("PinJoint", "CustomJoint").replace(
            old, f"<coordinates>{coordinates}</coordinates>"
        )
        free += f"<SpatialTransform>{transform}</SpatialTransform>"
        text = text.replace(f"{pin}</PinJoint>", f"{free}</CustomJoint>")
    return text


@pytest.mark.slow
def test_bones_that_are_apart_by_default_stay_apart(case):
    one = case("two legs", "PinJoint", changed=loose)
    assert one.model.human.thigh.length_m == pytest.approx(
        np.hypot(0.45, 0.004)
    )
    _, model, q, _ = exported(one)
    assert model.rest == {"knee_ty_r": -0.05, "knee_ty_l": -0.05}
    for s in "rl":
        np.testing.assert_allclose(q[f"knee_ty_{s}"], -0.05, atol=1e-6)
        assert np.abs(q[f"knee_angle_{s}"]).max() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "changed"),
    [
        ("two legs", str),
        ("two legs", leaning),
        ("coupled", str),
        ("coupled", leaning),
        ("coupled", lambda text: in_axes_of(CT, text)),
        ("turned ankle", str),
    ],
)
def test_with_pins_all_bodies_are_where_the_planar_ones_are(
    case, kind, changed
):
    """Centre of mass, momentum and kinetic energy, person and device."""
    one = case(kind, "PinJoint", changed=changed)
    _, model, q, v = exported(one)
    tree, trial = one.model.tree, one.trial
    n, h = len(trial.times), 1e-6
    poses = model.poses(q, n)
    before, after = (
        model.poses({c: q[c] + s * h * v[c] for c in q}, n) for s in (-1, 1)
    )
    mass, com, momentum, energy = 0.0, 0.0, 0.0, 0.0
    for name, body in model.bodies.items():
        at, *ends = (
            p[name][1] + p[name][0] @ body.com_m for p in (poses, before, after)
        )
        speed = (ends[1] - ends[0]) / (2.0 * h)
        R = poses[name][0]
        spin = (after[name][0] - before[name][0]) @ np.swapaxes(R, 1, 2)
        spin = spin[:, 1, 0] / (2.0 * h)
        I_zz = (R @ body.inertia_kg_m2 @ np.swapaxes(R, 1, 2))[:, 2, 2]
        mass += body.mass_kg
        com = com + body.mass_kg * at
        momentum = momentum + body.mass_kg * speed
        energy = energy + 0.5 * body.mass_kg * (speed[:, :2] ** 2).sum(axis=1)
        energy = energy + 0.5 * I_zz * spin**2
    rest = np.zeros_like(trial.q)
    M = tree.inverse_dynamics_jacobians(trial.q, rest, rest)[2]
    own = 0.5 * np.einsum("ni,nij,nj->n", trial.v, M, trial.v)
    assert mass == pytest.approx(tree.mass)
    np.testing.assert_allclose(
        com[:, :2] / mass, tree.center_of_mass(trial.q), atol=1e-9
    )
    step = h * trial.v
    moved = tree.center_of_mass(trial.q + step)
    moved = (moved - tree.center_of_mass(trial.q - step)) / (2.0 * h)
    np.testing.assert_allclose(momentum[:, :2] / mass, moved, atol=1e-7)
    np.testing.assert_allclose(energy, own, rtol=1e-6)


def frame_of(file, force, number, model, q, n):
    """Place (n,) and turn (n,) of a force's frame, as complex numbers."""
    name = force.findtext(f"socket_frame{number}")
    frame = next(f for f in force.iterfind("frames/*") if f.get("name") == name)
    body = frame.findtext("socket_parent").rpartition("/")[2]
    place = np.array(frame.findtext("translation").split(), float)
    angles = np.array(frame.findtext("orientation").split(), float)
    R, p = model.poses(q, n)[body]
    R_F = R @ Rotation.from_euler("XYZ", angles).as_matrix()
    at = p + R @ place
    return at[:, 0] + 1j * at[:, 1], R_F[:, 0, 0] + 1j * R_F[:, 1, 0]


def designed(case):
    """As `drake-exo design` writes: today's model, contact of the design."""
    one = case("coupled", "PinJoint")
    design = Design(
        {"thigh": CuffDesign(along_m=0.03, preload_across_m=0.004)},
        joints={"exo_knee": JointDesign(0.02, -0.01)},
    )
    write_design(one.folder, design)
    contact = design.contact(one.contact)
    write_contact(one.folder, contact)
    return replace(one, model=design.model(one.model), contact=contact)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["coupled", "designed", "hip", "turned ankle"])
def test_cuffs_that_are_written_give_the_calibrated_forces(case, kind):
    """Bushings of the file alone: where they hold, and their numbers."""
    one = designed(case) if kind == "designed" else case(kind, "PinJoint")
    out, model, q, v = exported(one)
    n, h = len(one.trial.times), 1e-6
    forces = {
        f.get("name"): f
        for f in OsimFile(out).model.iterfind("ForceSet/objects/*")
        if f.get("name").startswith("cuff_")
    }
    for cuff, (force, moment) in cuff_forces(one).items():
        copies = [f for name, f in forces.items() if f"cuff_{cuff}" in name]
        assert len(copies) == (1 if one.model.assembly.human.sides else 2)
        total, turned = 0.0, 0.0
        for made in copies:

            def deflection(s, made=made):
                at = {c: q[c] + s * h * v[c] for c in q}
                (p, R), (p_D, R_D) = (
                    frame_of(out, made, k, model, at, n) for k in (1, 2)
                )
                d = (p_D - p) * R.conj()
                return np.array([d.real, d.imag, np.angle(R_D / R)]), R

            d, R = deflection(0.0)
            rate = (deflection(1.0)[0] - deflection(-1.0)[0]) / (2.0 * h)
            damping = [
                made.findtext(f"{what}_damping").split()
                for what in ("translational", "rotational")
            ]
            c = np.array([*damping[0][:2], damping[1][2]], float)
            if made.tag == "BushingForce":
                springs = [
                    made.findtext(f"{what}_stiffness").split()
                    for what in ("translational", "rotational")
                ]
                k = np.array([*springs[0][:2], springs[1][2]], float)
                held = k[:, None] * d
            else:
                names = {"delta_x": d[0], "delta_y": d[1], "theta_z": d[2]}
                held = np.array(
                    [
                        eval(made.findtext(e).replace("^", "**"), names)
                        for e in (
                            "Fx_expression",
                            "Fy_expression",
                            "Mz_expression",
                        )
                    ]
                )
            held = held + c[:, None] * rate
            F = (held[0] + 1j * held[1]) * R
            total = total + np.column_stack([F.real, F.imag])
            turned = turned + held[2]
        assert np.abs(force).max() > 5.0
        np.testing.assert_allclose(total, force, atol=1e-5)
        np.testing.assert_allclose(turned, moment, atol=1e-6)


@pytest.mark.slow
def test_the_device_hangs_on_both_legs(case):
    one = case("coupled")
    model = read_osim(one.export().files[0])
    for end in ("_l", "_r"):
        assert model.joint_of(f"exo_foot{end}").kind == "WeldJoint"
        assert model.joint_of(f"exo_foot{end}").parent == f"calcn{end}"
        assert model.joint_of(f"exo_thigh{end}").parent == f"exo_shank{end}"
        assert model.bodies[f"exo_thigh{end}"].mass_kg == pytest.approx(
            0.5 * one.model.exoskeleton.thigh.mass_kg
        )


@pytest.mark.slow
def test_ground_forces_are_each_foots(case):
    for kind, share in (("alone", 0.5), ("two legs", 1.0)):
        _, _, forces = case(kind).export(f"{share}.osim").files
        table = read_table(forces)
        for end in "lr":
            assert table.column(f"ground_force_{end}_vy") == pytest.approx(
                share * 700.0
            )
            assert table.column(f"ground_force_{end}_px") == pytest.approx(0.1)
            assert table.column(f"ground_torque_{end}_z") == pytest.approx(0.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["alone", "two legs"])
def test_chair_and_loads_are_among_the_forces(case, kind):
    """Without them OpenSim's inverse dynamics would miss a carried box."""
    one, n = case(kind), 9
    chair = PlanarWrench(np.full((n, 2), 300.0), np.full(n, 12.0))
    box = PlanarWrench(np.full((n, 2), [5.0, -100.0]), np.full(n, 40.0))
    trial = replace(one.trial, chair=chair, applied={"pelvis": box})
    if kind == "two legs":
        trial = replace(trial, chair=None, applied={"foot_left": box})
    trial.save(one.folder / "solution_a")
    done = one.export()
    table = read_table(done.files[2])
    body = next(iter(trial.applied))
    assert f"act on the {body} by ground_force_{body}" in done.lines[-1]
    at = {
        name: table.column(f"ground_{name.format(body)}")
        for name in ("force_{}_vx", "force_{}_vy", "force_{}_px", "torque_{}_z")
    }
    own = trial.borne()
    force = sum(w.force for _, w in own)
    np.testing.assert_allclose(at["force_{}_vx"], force[:, 0])
    np.testing.assert_allclose(at["force_{}_vy"], force[:, 1])
    moment = at["force_{}_px"] * at["force_{}_vy"] + at["torque_{}_z"]
    np.testing.assert_allclose(moment, -sum(w.moment for _, w in own))
    # A foot's own stay the ground's.
    share = 1.0 if kind == "two legs" else 0.5
    assert table.column("ground_force_l_vy") == pytest.approx(share * 700.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["alone", "two legs"])
def test_ground_forces_act_where_the_feet_are(case, kind):
    """On the midline they would bend the hips sideways."""
    one = case(kind)
    out, model, q, _ = exported(one)
    poses = model.poses(q, len(one.trial.times))
    table = read_table(out.with_name("out_a_ground_forces.sto"))
    for end in "lr":
        shape = f".//ContactSphere[@name='contact_heel_{end}_sphere']"
        place = OsimFile(out).model.find(shape).findtext("location").split()
        R, p = poses[f"calcn_{end}"]
        centre = p + R @ np.array(place, float)
        acts = table.column(f"ground_force_{end}_pz")
        np.testing.assert_allclose(acts, centre[:, 2], atol=2e-3)
        assert np.abs(acts).min() > 0.05


@pytest.mark.slow
def test_what_was_done_is_said(case):
    said = " ".join(case("coupled").export().lines)
    assert "one leg stands for both" in said
    assert "times 1.1000, as stated" in said
    assert "moved by +12.0 mm forward" in said
    assert "coordinate 'knee_angle_r' differs from the pin's angle" in said
    pins = case("coupled", "PinJoint").export("pins.osim").lines
    assert "differs" not in " ".join(pins)


@pytest.mark.slow
def test_what_cannot_be_carried_over_is_refused(case, tmp_path):
    one = case("alone", law="paper")
    with pytest.raises(InputError, match=r"law is 'paper', which OpenSim does"):
        one.export()
    constants = SimbodyConstants(friction_rounding=0.5)
    one = case("alone")
    ground = replace(one.contact.ground, constants=constants)
    write_contact(one.folder, replace(one.contact, ground=ground))
    with pytest.raises(InputError, match=r"friction is rounded .*rounding: 0"):
        one.export()
    one = case("alone")
    with pytest.raises(InputError, match=r"is refused: it is not known"):
        export_opensim(one.folder, one.osim, tmp_path / "o.osim")
    one.export()
    with pytest.raises(InputError, match=r"out.osim: exists; choose another"):
        one.export()
    one.export(force=True)
    with pytest.raises(InputError, match=r"must end in .osim"):
        one.export("out.xml")
    with pytest.raises(InputError, match="would replace the model"):
        one.export(one.osim, force=True)
    again = replace(one, osim=tmp_path / "out.osim")
    with pytest.raises(InputError, match=r"has a 'contact_ground' already"):
        again.export("again.osim")
    longer = small_osim("CustomJoint").replace("0.002 -0.42 0", "0.002 -0.44 0")
    (tmp_path / "m.osim").write_text(longer)
    with pytest.raises(InputError, match=r"its shank is not that of"):
        one.export("b.osim")
    plain = replace(one.model, kind=Assembly())
    write_model(one.folder, plain)
    with pytest.raises(InputError, match=r"was not read from an OpenSim model"):
        one.export("b.osim")


@pytest.mark.slow
def test_a_movement_that_is_gone_is_told(case):
    one = case("alone")
    (one.folder / "solution_a.npz").unlink()
    with pytest.raises(InputError, match=r"solution_a.npz: cannot be read"):
        one.export()


@pytest.mark.slow
def test_toes_that_the_model_holds_are_refused(case):
    one = case("two legs")
    text = one.osim.read_text()
    start = text.index('<PinJoint name="mtp_r"')
    end = text.index("</PinJoint>", start) + len("</PinJoint>")
    joint = text[start:end]
    coordinate = joint[joint.index("<coordinates>") : joint.index("<frames>")]
    fixed = joint.replace("PinJoint", "WeldJoint").replace(coordinate, "")
    one.osim.write_text(text.replace(joint, fixed))
    before = sorted(one.folder.parent.rglob("*"))
    with pytest.raises(InputError, match=r"joint 'mtp_r' is fixed, but the"):
        one.export()
    assert sorted(one.folder.parent.rglob("*")) == before


@pytest.mark.slow
def test_the_command(case, capsys):
    one = case("alone")
    out = one.folder.parent / "c.osim"
    words = ["export", "opensim", str(one.folder), "--model", str(one.osim)]
    words += ["--out", str(out)]
    assert main(words) == 2
    assert "is refused" in capsys.readouterr().err
    # A prediction's own checks count, not where its contact comes from.
    off = Check("audit", False, sentence="off by 3 N")
    for checks, code in (([off], 2), ([replace(off, holds=True)], 0)):
        found = {"checks": [asdict(c) for c in checks]}
        write_json(one.folder / "summary.json", found)
        assert main([*words, "--force"]) == code
        if code:
            said = capsys.readouterr().err
            assert "is refused: off by 3 N" in said and "--accept audit" in said
    (one.folder / "summary.json").unlink()
    capsys.readouterr()
    assert main([*words, "--force", "--accept", "provenance"]) == 0
    said = capsys.readouterr().out
    assert str(out) in said
    for what in ("states", "ground_forces"):
        head = out.with_name(f"c_a_{what}.sto").read_text().splitlines()[0]
        assert "DOES NOT HOLD: provenance.calibration" in head
    assert said.startswith("DOES NOT HOLD: provenance.calibration")
    # What failed is that of the results themselves.
    found = {"checks": [asdict(off)], "accepted": ["audit"]}
    write_json(one.folder / "summary.json", found)
    assert main([*words, "--force", "--accept", "audit"]) == 0
    assert "DOES NOT HOLD: audit\n" in capsys.readouterr().out
    assert "(DOES NOT HOLD: audit)" in (
        out.with_name("c_a_states.sto").read_text()
    )


@pytest.mark.parametrize(("off", "turn"), [(0.0, 0.0), (1.0, np.pi + 0.1)])
def test_a_frame_is_put_on_its_target(tmp_path, monkeypatch, off, turn):
    (tmp_path / "m.osim").write_text(small_osim())
    osim = read_osim(tmp_path / "m.osim")
    pelvis = opensim_export.Copy("pelvis", Pose(np.eye(3), np.zeros(3)), "")
    names = opensim_export._root(osim)
    assert names == ["pelvis_tilt", "pelvis_tx", "pelvis_ty"]
    q, v = ({name: np.zeros(1) for name in names} for _ in range(2))
    target, rate = np.zeros((2, 1, 6))
    target[0, 1:3], rate[0, :3] = (off, turn), (0.3, 0.4, 0.5)
    said = (osim, q, v, names, pelvis, target, rate, [0, 1, 2])
    assert opensim_export._reach(*said) == pytest.approx([0.0], abs=1e-12)
    assert q["pelvis_ty"] == pytest.approx([off])
    assert [v[name][0] for name in names] == pytest.approx([0.5, 0.3, 0.4])
    monkeypatch.setattr(opensim_export, "_STEPS", 0)
    target[0, 1] += 0.2
    assert opensim_export._reach(*said) == pytest.approx([0.2])


@pytest.mark.parametrize("short", [-1e-4, 5e-6])
def test_a_leg_too_short_is_stretched(tmp_path, short):
    """As a knee that slides may leave it, by micrometres."""
    (tmp_path / "m.osim").write_text(small_osim("PinJoint"))
    osim = read_osim(tmp_path / "m.osim")
    names = ["hip_flexion_r", "knee_angle_r", "ankle_angle_r"]
    q, v = ({name: np.zeros(1) for name in names} for _ in range(2))
    thigh, shank = -0.004 - 0.40j, 0.002 - 0.42j  # of the small model
    straight = np.angle(thigh / shank)
    down = thigh / abs(thigh)
    place = -0.06 - 0.07j + down * (abs(thigh) + abs(shank) + short)
    pulled = 0.01 * down
    target, rate = np.zeros((2, 1, 6))
    target[0, :2], rate[0, :2] = ((x.real, x.imag) for x in (place, pulled))
    q["knee_angle_r"] += straight - 0.01
    ankle = opensim_export.Copy("talus_r", Pose(np.eye(3), np.zeros(3)), "_r")
    said = (osim, q, v, names, ankle, target, rate, [0, 1, 2])
    (off,) = opensim_export._reach(*said)
    bend, speed = q["knee_angle_r"][0] - straight, v["knee_angle_r"][0]
    # Law of cosines: the length's loss and its rate by the knee's bend.
    by = 0.40 * 0.42 / (0.40 + 0.42)
    if short < 0.0:
        assert off < 1e-13
        assert bend == pytest.approx(-np.sqrt(-2.0 * short / by), rel=1e-3)
        assert -by * bend * speed == pytest.approx(0.01, rel=1e-3)
    else:
        assert off == pytest.approx(short, rel=1e-3)
        assert abs(bend) < 1e-3 and abs(speed) < 1e-3


@pytest.mark.slow
def test_knees_that_pass_through_straight_keep_their_side(case):
    """A leg of pins is as long bent as bent backwards."""
    one = case("alone", "PinJoint")
    knee = one.model.coordinates.names.index("knee")
    q, v = one.trial.q.copy(), one.trial.v.copy()
    q[:, knee], v[:, knee] = np.linspace(-0.05, 0.05, len(q)), 1.25
    replace(one.trial, q=q, v=v).save(one.folder / "solution_a")
    table = read_table(one.export().files[1])
    for end in "lr":
        own = f"/jointset/knee_{end}/knee_angle_{end}"
        angles = table.column(f"{own}/value")
        assert np.diff(angles) == pytest.approx(np.full(len(q) - 1, -0.0125))
        assert table.column(f"{own}/speed") == pytest.approx(-v[:, knee])


@pytest.mark.slow
def test_feet_that_cannot_be_reached_are_refused(case, monkeypatch):
    one = case("alone")
    monkeypatch.setattr(opensim_export, "_STEPS", 0)
    with pytest.raises(InputError, match=r"put the \w+ where .* in a at 0"):
        one.export()
    monkeypatch.setattr(opensim_export, "_FARTHEST", 10.0)
    assert "feet are up to" in " ".join(one.export().lines)


def test_coordinates_that_follow_others_move_with_them():
    """A patella at twice the square of the knee."""

    def function(x, order):
        return 2.0 * x**2 if order == 0 else 4.0 * x

    couplers = (
        OsimCoupler("patella", "knee", function),
        OsimCoupler("other", "none", function),
    )
    q, v = {"knee": np.array([0.5])}, {"knee": np.array([3.0])}
    opensim_export._couple(SimpleNamespace(couplers=couplers), q, v)
    assert q == {"knee": [0.5], "patella": [0.5]}
    assert v == {"knee": [3.0], "patella": [6.0]}
