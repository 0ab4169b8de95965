"""A planar person read from an OpenSim model, against OpenSim's own solver."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from opensim_answers import ask
from osim_kinematics import Osim, joint_function
from scipy.spatial.transform import Rotation
from small_osim import in_axes_of, small_osim

from drake_exo.errors import InputError
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.osim_person import read_person
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human


def pinned(path, folder):
    """A gait model with pins for its knees, its back and toes fixed.

    Made by another reader than ours.
    """
    document = ET.parse(path)
    model = document.getroot().find("Model")
    joints = model.find("JointSet/objects")
    for joint in list(joints):
        name = joint.get("name")
        if name.startswith("knee"):
            joint.tag = "PinJoint"
            slide = [
                float(joint_function(Osim(path), name, f"translation{i}")(0.0))
                for i in (1, 2, 3)
            ]
            place = joint.find("frames/PhysicalOffsetFrame/translation")
            moved = np.array(place.text.split(), float) + slide
            place.text = " ".join(map(repr, moved.tolist()))
            joint.remove(joint.find("SpatialTransform"))
        elif name == "back":
            joint.tag = "WeldJoint"
            joint.remove(joint.find("coordinates"))
    out = folder / "pinned.osim"
    document.write(out)
    return out


class Pair:
    """A state of the planar model, and the same of the pins of OpenSim's."""

    def __init__(self, person, who, rng, n=6):
        self.model = Model(
            Assembly(who), person.human, gravity_m_s2=person.osim.gravity_m_s2
        )
        self.tree = tree = self.model.tree
        self.motion = rng.uniform(-1.0, 1.0, (3, n, tree.num_positions))
        tilt = self.motion @ tree.turning("pelvis")
        turned = {"pelvis_tilt": (tree.turning("pelvis"), 0.0)}
        for side, at in person.places.items():
            chain = [("pelvis", 0.0)]
            for segment, upper, lower in (
                ("thigh", "hip", "knee"),
                ("shank", "knee", "ankle"),
            ):
                # How the segment leans where OpenSim has its zero.
                lean = np.angle((at[upper] - at[lower]) / 1j)
                chain.append((f"{segment}_{side}", lean))
            chain.append((f"foot_{side}", 0.0))
            if who.toes == "hinged":
                chain.append((f"toes_{side}", 0.0))
            names = ("hip_flexion", "knee_angle", "ankle_angle", "mtp_angle")
            for name, (above, a), (below, b) in zip(
                names, chain, chain[1:], strict=False
            ):
                row = tree.turning(below) - tree.turning(above)
                turned[f"{name}_{side[0]}"] = (row, a - b)
        self.angles = list(turned)
        self.B = np.array([row for row, _ in turned.values()])
        lean = np.array([lean for _, lean in turned.values()])
        osim = self.motion @ self.B.T
        osim[0] += lean
        self.arm = person.middle * np.exp(1j * tilt[0])
        hips = self.motion[..., 0] + 1j * self.motion[..., 1]
        pelvis = hips - [
            self.arm,
            1j * tilt[1] * self.arm,
            (1j * tilt[2] - tilt[1] ** 2) * self.arm,
        ]
        self.osim = [
            {
                **dict(zip(self.angles, x.T.tolist(), strict=True)),
                "pelvis_tx": p.real.tolist(),
                "pelvis_ty": p.imag.tolist(),
            }
            for x, p in zip(osim, pelvis, strict=True)
        ]

    def forces(self, tau):
        """Ours, of OpenSim's generalized forces."""
        F = np.array(tau["pelvis_tx"]) + 1j * np.array(tau["pelvis_ty"])
        Q = np.column_stack([tau[name] for name in self.angles]) @ self.B
        Q[:, 0], Q[:, 1] = F.real, F.imag
        # The pelvis turns about the hips.
        Q += np.outer(
            (np.conj(F) * -1j * self.arm).real, self.tree.turning("pelvis")
        )
        return Q


def largest_error(tmp_path, path, toes):
    rng = np.random.default_rng(3)
    who = Person("two", toes)
    pair = Pair(read_person(path, who, 1.75), who, rng)
    n = len(pair.motion[0])
    pushes, loads = {}, {}
    for side in ("left", "right"):
        force, point = rng.normal(size=(n, 2)) * 500.0, rng.normal(size=(n, 2))
        moment = point[:, 1] * force[:, 0] - point[:, 0] * force[:, 1]
        loads[f"foot_{side}"] = PlanarWrench(force, moment)
        flat = np.zeros((n, 1))
        pushes[f"calcn_{side[0]}"] = [
            np.hstack([x, flat]).tolist() for x in (force, point)
        ]
    q, v, a = pair.osim
    answer = ask(tmp_path, model=str(path), q=q, v=v, a=a, pushes=pushes)
    expected = pair.forces(answer["tau"])
    found = inverse_dynamics(pair.tree, *pair.motion, loads)
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.slow
@pytest.mark.parametrize("toes", ["rigid", "hinged"])
def test_inverse_dynamics_of_two_legs_is_opensims(tmp_path, toes):
    """Toes that are stiff here do not move there."""
    path = tmp_path / "small.osim"
    path.write_text(small_osim())
    assert largest_error(tmp_path, path, toes) < 1e-9


@pytest.mark.slow
def test_inverse_dynamics_of_a_gait_model_with_pins_is_opensims(
    tmp_path, data_root
):
    path = pinned(data_root / "opensim_gait10dof/subject01.osim", tmp_path)
    assert largest_error(tmp_path, path, "rigid") < 1e-9


@pytest.fixture
def small(tmp_path):
    """Reads the small model, its text changed."""

    def read(*changes, knee="PinJoint", who=None):
        text = small_osim(knee)
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "m.osim").write_text(text)
        return read_person(tmp_path / "m.osim", who or Person(), 1.75)

    return read


def test_segments_are_the_bodies_between_joints(small):
    person = small()
    human = person.human
    assert human.mass_kg == pytest.approx(person.osim.mass_kg)
    assert human.thigh.mass_kg == pytest.approx(2 * 7.6)
    assert human.foot.mass_kg == pytest.approx(2 * (0.1 + 1.2 + 0.2))
    assert human.toes.mass_kg == pytest.approx(2 * 0.2)
    assert human.pelvis.mass_kg == pytest.approx(9.7 + 27.3 + 2 * 1.7)
    assert human.thigh.length_m == pytest.approx(np.hypot(0.004, 0.40))
    assert human.shank.length_m == pytest.approx(np.hypot(0.002, 0.42))
    assert human.ball_m == pytest.approx((-0.05 + 0.18, -0.045 - 0.002))
    # Cuffs sit at the usual share of segments that have another length.
    usual = scale_human(person.osim.mass_kg, 1.75)
    for name in ("shank", "thigh"):
        own, other = (
            getattr(h, f"{name}_cuff_m")[1] / getattr(h, name).length_m
            for h in (human, usual)
        )
        assert own == pytest.approx(other)
        assert getattr(usual, name).length_m != getattr(human, name).length_m
    assert human.toes.com_m == pytest.approx((0.035, 0.006))
    # The thigh leans; its centre of mass is seen along it.
    lean = np.exp(-1j * np.angle((0.004 + 0.40j) / 1j))
    com = ((0.005 + 0.004) + 1j * (0.40 - 0.17)) * lean
    assert complex(*human.thigh.com_m) == pytest.approx(com)
    # Parallel axes: pelvis, torso and two arms about their common centre.
    parts = [(9.7, -0.07 + 0.01j, 0.05), (27.3, -0.13 + 0.39j, 1.3)]
    parts += [(1.7, -0.1 + 0.27j, 0.012)] * 2
    mass = sum(m for m, _, _ in parts)
    com = sum(m * p for m, p, _ in parts) / mass
    inertia = sum(i + m * abs(p - com) ** 2 for m, p, i in parts)
    hip = -0.06 - 0.07j
    assert complex(*human.pelvis.com_m) == pytest.approx(com - hip)
    assert human.pelvis.inertia_kg_m2 == pytest.approx(inertia)


def test_markers_follow_their_segments(small):
    markers = small().markers
    assert markers["shoulder_r"][:2] == ("pelvis", None)
    assert markers["heel_l"][:2] == ("foot", "left")
    assert markers["toe1_r"][:2] == ("toes", "right")
    assert "elbow_l" not in markers
    hip = -0.06 - 0.07j
    assert markers["ASIS_l"][2] == pytest.approx(0.02 + 0.02j - hip)
    assert markers["knee_r"][2] == pytest.approx(-0.40j)


def test_a_sliding_knee_is_a_pin_where_it_is_at_zero(small):
    pin, slides = small(), small(knee="CustomJoint")
    slide = complex(-0.001 * 1.1, -0.002)
    for side in ("left", "right"):
        moved = slides.places[side]["knee"] - pin.places[side]["knee"]
        assert moved == pytest.approx(slide)
    assert not any("slides" in note for note in pin.notes)
    joint = slides.osim.joint_of("tibia_r")
    q = np.linspace(-np.deg2rad(100), np.deg2rad(100), 101)
    off = [
        axis.function(q, 0) - axis.function(np.zeros(1), 0)
        for axis in joint.translations[:2]
    ]
    far = 1e3 * np.hypot(*off).max()
    (note,) = (n for n in slides.notes if "'knee_r' slides" in n)
    assert f"up to {far:.1f} mm away" in note
    rms = 1e3 * np.sqrt(np.mean(np.square(off).sum(axis=0)))
    assert f"{rms:.1f} mm RMS" in note


def test_what_a_model_does_not_hold_is_in_proportion(small):
    """Sole by the foot's length, the trunk's by the stature."""
    human = small().human
    usual = scale_human(human.mass_kg, 1.75)
    # From the heel to the ball is 72 % of a foot.
    length = 0.18 / 0.72
    assert human.foot.length_m == pytest.approx(length)
    assert human.toes.length_m == pytest.approx(0.28 * length)
    for what in ("heel_m", "toe_m"):
        x, z = getattr(usual, what)
        expected = (x * length / usual.foot.length_m, z)
        assert getattr(human, what) == pytest.approx(expected)
    assert usual.heel_m[0] != pytest.approx(human.heel_m[0], abs=1e-4)
    standing = (
        human.ankle_height_m
        + human.shank.length_m
        + human.thigh.length_m
        + human.pelvis.length_m
    )
    assert standing == pytest.approx(1.75)


def test_what_is_lost_is_said(small):
    notes = small(who=Person("two", "rigid")).notes
    assert any(
        "stay at zero" in n and "mtp_angle_r, mtp_angle_l" in n for n in notes
    )
    assert not any("mtp" in n for n in small(who=Person("two", "hinged")).notes)
    (note,) = (
        n
        for n in small(
            (
                '<Body name="femur_r"><mass>7.6<',
                '<Body name="femur_r"><mass>8.1<',
            )
        ).notes
        if "differ" in n
    )
    assert "the thighs differ by 0.0 mm and 0.500 kg" in note


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("femur_r", "thigh_r", "has no body 'femur_r'; a person is read from"),
        (
            "<socket_parent_frame>femur_r_offset<",
            "<socket_parent_frame>/bodyset/pelvis<",
            "body 'tibia_r' hangs from 'pelvis', not from 'femur_r'",
        ),
        ("<mass>7.6<", "<mass>0<", "the thigh weighs nothing"),
    ],
)
def test_models_of_no_person_are_refused(small, old, new, words):
    with pytest.raises(InputError, match=words):
        small((old, new))


def test_fixed_joints_of_a_leg_are_refused_but_for_toes(small):
    fixed = (
        'PinJoint name="ankle_r"',
        'WeldJoint name="ankle_r"',
    )
    text = small_osim()
    assert fixed[0] in text
    coordinate = text[text.index('<Coordinate name="ankle_angle_r"') :]
    coordinate = coordinate[: coordinate.index("</coordinates>")]
    end = text[text.index(fixed[0]) :]
    end = end[: end.index("</PinJoint>") + len("</PinJoint>")]
    weld = end.replace("PinJoint", "WeldJoint").replace(coordinate, "")
    with pytest.raises(InputError, match=r"'ankle_r' has no coordinate that"):
        small((end, weld))


def leaning_back(kind, coordinate, lean="0 0 0"):
    """Change of the small model: its back is a joint of another kind."""
    text = small_osim()
    start = text.index('<WeldJoint name="back">')
    end = text.index("</WeldJoint>", start) + len("</WeldJoint>")
    old = text[start:end]
    new = old.replace("WeldJoint", kind).replace(
        "<frames>", f"<coordinates>{coordinate}</coordinates><frames>"
    )
    upright = "<orientation>0 0 0</orientation>"
    return old, new.replace(upright, f"<orientation>{lean}</orientation>", 1)


def test_a_locked_back_is_one_that_is_welded_there(small):
    """The osim-rl runner's is locked at -8 degrees; free ones are at zero."""
    coordinate = (
        '<Coordinate name="lumbar_extension"><default_value>-0.14'
        "</default_value><locked>{}</locked></Coordinate>"
    )
    weld = small(leaning_back("WeldJoint", "", "0 0 -0.14"))
    held = small(leaning_back("PinJoint", coordinate.format("true")))
    free = small(leaning_back("PinJoint", coordinate.format("false")))
    upright = small()
    for found, meant in ((held, weld), (free, upright)):
        assert found.human.thigh == meant.human.thigh
        for key in ("com_m", "inertia_kg_m2"):
            own, other = (getattr(x.human.pelvis, key) for x in (found, meant))
            assert own == pytest.approx(other, abs=1e-12)
        for name, (*on, place) in meant.markers.items():
            assert found.markers[name][:2] == tuple(on)
            assert found.markers[name][2] == pytest.approx(place)
    assert held.human.pelvis.com_m[0] - upright.human.pelvis.com_m[0] > 0.03
    assert any(
        "has them by default (rad or m): lumbar_extension at -0.14" in note
        for note in held.notes
    )
    assert not any("zero" in n and "lumbar" in n for n in held.notes)


def test_a_hinge_of_the_person_is_at_zero_even_if_the_model_locks_it(small):
    """Nor does it matter where the pelvis is locked."""
    ankle = '<Coordinate name="ankle_angle_{}">'
    changes = [
        (
            ankle.format(s),
            f"{ankle.format(s)}<default_value>0.3</default_value>"
            "<locked>true</locked>",
        )
        for s in "rl"
    ]
    locked = "<default_value>0.2</default_value><locked>true</locked>"
    changes += [
        (f'"{name}"/>', f'"{name}">{locked}</Coordinate>')
        for name in ("pelvis_tilt", "pelvis_ty")
    ]
    held = small(*changes)
    assert held.human == small().human
    assert held.osim.rest == {}


def test_toes_of_one_foot_alone_are_part_of_it(small):
    """The other may be a prosthesis."""
    text = small_osim()
    ends = (
        ('<Body name="toes_r">', "</Body>"),
        ('<PinJoint name="mtp_r">', "</PinJoint>"),
    )
    cuts = [
        text[text.index(a) : text.index(b, text.index(a)) + len(b)]
        for a, b in ends
    ]
    cuts += [
        line[: line.index("</Marker>") + len("</Marker>")]
        for line in (
            text[text.index(f'<Marker name="toe{k}_r">') :] for k in (1, 2)
        )
    ]
    changes = [(cut, "") for cut in cuts]
    person = small(*changes)
    assert person.human.toes is None
    assert person.human.mass_kg == pytest.approx(65.0 - 0.2)
    assert person.human.foot.mass_kg == pytest.approx(2 * 1.3 + 0.2)
    assert person.markers["toe1_l"][:2] == ("foot", "left")
    with pytest.raises(InputError, match="no bodies toes_r and toes_l"):
        small(*changes, who=Person("two", "hinged"))


@pytest.mark.parametrize("moved", [0.0, 0.05, 0.13, 0.25, -1.0])
def test_a_heel_elsewhere_than_calcn_s_origin_is_told(small, moved):
    """Its frame lies at a joint, or where CT had it; else soles are wrong."""
    changes = [
        (f"-0.05 -0.045 {w}0.01", f"{-0.05 + moved} -0.045 {w}0.01")
        for w in ("", "-")
    ]
    changes.append(("0.18 -0.002 0", f"{0.18 - moved} -0.002 0"))
    changes.append(("0.1 0.03 0", f"{0.1 - moved} 0.03 0"))
    person, plain = small(*changes), small()
    usual = scale_human(plain.human.mass_kg, 1.75).foot
    human, length = person.human, 0.18 / 0.72
    if moved:
        length = usual.length_m
    assert human.foot.length_m == pytest.approx(length)
    assert human.toes.length_m == pytest.approx(0.28 * length)
    own = plain.human
    for key in ("heel_m", "toe_m"):
        x, z = getattr(own, key)
        x *= length / own.foot.length_m
        assert getattr(human, key) == pytest.approx((x, z))
    assert human.ball_m == pytest.approx(own.ball_m)
    assert human.foot.com_m == pytest.approx(own.foot.com_m)
    said = [note for note in person.notes if "is not at the heel" in note]
    assert len(said) == (1 if moved else 0)
    assert not moved or f"{(0.18 - moved) / 0.72:.2f} m long" in said[0]


@pytest.mark.parametrize("vector", [(0, 0, 0.3), (2.0, -0.5, 1.0)])
def test_a_pelvis_may_have_axes_of_its_own(tmp_path, vector):
    """Such as CT's: upright is as its joint to the ground has it."""
    R = Rotation.from_rotvec(vector).as_matrix()
    found = []
    for text in (small_osim(), in_axes_of(R, small_osim())):
        (tmp_path / "m.osim").write_text(text)
        found.append(read_person(tmp_path / "m.osim", Person(), 1.75))
    plain, other = found
    for name in ("foot", "thigh", "pelvis", "toes"):
        for key in ("mass_kg", "com_m", "inertia_kg_m2", "length_m"):
            own, meant = (getattr(getattr(p.human, name), key)
                          for p in (other, plain))  # fmt: skip
            assert own == pytest.approx(meant)
    assert other.notes == plain.notes
    for name, (segment, side, place) in plain.markers.items():
        assert other.markers[name][:2] == (segment, side)
        assert other.markers[name][2] == pytest.approx(place)


CHAIR = (
    '<Body name="chair"><mass>9</mass><inertia>1 1 1 0 0 0</inertia></Body>',
    """<WeldJoint name="legs"><socket_parent_frame>/ground</socket_parent_frame>
    <socket_child_frame>/bodyset/chair</socket_child_frame></WeldJoint>""",
    """<Marker name="seat"><socket_parent_frame>/bodyset/chair
    </socket_parent_frame><location>0 0.4 0</location></Marker>""",
)


def test_what_stands_on_the_ground_is_not_the_person(small):
    places = ("BodySet", "JointSet", "MarkerSet")
    changes = [
        (f'<{s} name="{s.lower()}"><objects>', f"<{s}><objects>{more}")
        for s, more in zip(places, CHAIR, strict=True)
    ]
    person, plain = small(*changes), small()
    assert person.human == plain.human
    assert person.markers == plain.markers
    assert person.osim.mass_kg == pytest.approx(65.0)
    assert "left out, as the ground holds them, not the pelvis: chair" in (
        person.notes
    )
    tied = ("<socket_parent_frame>/ground<", "<socket_parent_frame>chair<")
    held = [(old, new.replace(*tied)) for old, new in changes[:1]]
    held += [tied, (changes[1][0], changes[1][1])]
    with pytest.raises(InputError, match="'pelvis' hangs from 'chair', not"):
        small(*held)


def test_toes_of_no_weight_may_be_rigid(small):
    """Some programs leave all of the foot's mass to calcn and talus."""
    light = ("<mass>0.2<", "<mass>0<")
    person = small(light, ("0.0001 0.0002 0.0003 0", "0 0 0 0"))
    assert person.human.toes is None
    plain = small()
    assert person.human.foot.mass_kg == pytest.approx(2 * 1.3)
    assert person.human.foot.length_m == plain.human.foot.length_m
    assert person.human.toe_m == plain.human.toe_m
    with pytest.raises(InputError, match="the toes weighs nothing"):
        small(light, who=Person("two", "hinged"))
