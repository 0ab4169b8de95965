"""Models put together from descriptions, and what is refused."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from opensim_answers import expanded
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder
from scipy.interpolate import make_interp_spline

from drake_exo.calibration.problem import foot_turn
from drake_exo.calibration.settings import (
    FootGroundSettings,
    Range,
    SphereSettings,
)
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.measurement.exoskeleton import friction_moments
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.model import device_file
from drake_exo.model import plant as plant_module
from drake_exo.model.assembly import (
    ASSEMBLIES,
    COUPLED,
    Assembly,
    CuffLinks,
    DeviceFile,
    Person,
    Weld,
)
from drake_exo.model.description import (
    foot_and_toes,
    models_path,
    nominal_human,
)
from drake_exo.model.device_file import brought_in, with_text
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import SegmentParameters

ANKLE = Assembly(
    device=DeviceFile({"shoe": "foot"}, Path("ankle_only.urdf")),
    cuffs={"calf": CuffLinks("shank", "calf")},
)
HUMAN = nominal_human()
HIP = Assembly(
    device=DeviceFile({"belt": "pelvis"}, Path("hip_only.urdf")),
    cuffs={"thigh": CuffLinks("thigh", "bar")},
)


def built(assembly):
    return Model(with_text(assembly, models_path()), nominal_human())


def edited(assembly, *changes):
    """The model with its device's file changed."""
    text = (models_path() / assembly.device.file).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return Model(brought_in(assembly, text), nominal_human())


@pytest.mark.parametrize(
    ("assembly", "mass", "beside"),
    [(ANKLE, 3.6, "ankle"), (HIP, 4.5, "hip")],
)
def test_a_device_of_one_joint(assembly, mass, beside):
    model = built(assembly)
    names = model.coordinates
    assert names.device == ("motor",)
    assert names.follows("motor") == beside
    assert list(model.cuffs) == list(assembly.cuffs)
    assert model.tree.mass == pytest.approx(70.0 + mass)
    assert model.tree.mass == pytest.approx(model.rigid.tree.mass)


def test_a_file_describes_a_model_without_a_study(tmp_path):
    """Its device's path starts from its folder."""
    text = (models_path() / "ankle_only.urdf").read_text()
    (tmp_path / "own.urdf").write_text(text)
    described = tmp_path / "model.yaml"
    described.write_text(
        "device: {file: own.urdf, weld: {shoe: foot}}\n"
        "cuffs: {calf: {human: shank, device: calf}}\n"
    )
    model = nominal_model(described, mass_kg=62.0)
    assert model.coordinates.device == ("motor",)
    assert list(model.cuffs) == ["calf"]
    assert model.tree.mass == pytest.approx(62.0 + 3.6)
    described.write_text("human: {legs: two}")
    two = nominal_model(str(described))
    assert two.coordinates.root[0] == "pelvis_x"
    assert two.coordinates.device == ()
    described.write_text("device: {weld: {exo_foot: foot}}")
    assert len(nominal_model(described).coordinates.device) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("devce: {}", "model.yaml:1: unknown key 'devce'; did you mean"),
        ("human: {osim: a.osim}", "model.yaml: human.osim scales a person"),
        (
            "device: {file: no.urdf, weld: {shoe: foot}}",
            "no.urdf: cannot be read",
        ),
    ],
)
def test_a_file_that_describes_no_model_is_refused(tmp_path, text, words):
    described = tmp_path / "model.yaml"
    described.write_text(text)
    with pytest.raises(InputError, match=words):
        nominal_model(described)


# Hinges of the device between those of the person.
HIP_AND_TOES = replace(HIP, human=Person(toes="hinged"))
LEFT_ANKLE = Assembly(
    Person("two"),
    DeviceFile({"shoe": "foot_left"}, Path("ankle_only.urdf")),
    {"calf": CuffLinks("shank_left", "calf")},
)


@pytest.mark.parametrize("assembly", [ANKLE, HIP, HIP_AND_TOES, LEFT_ANKLE])
def test_worn_stiffly_it_moves_as_the_person_does(assembly):
    """The rigid model's forces are S^T of those with the device's joints."""
    model = built(assembly)
    names = model.coordinates
    S = names.aligned(np.eye(len(names.body))).T
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, len(names.body)))
    found = model.rigid.tree.inverse_dynamics(q, v, a)
    expected = model.tree.inverse_dynamics(q @ S.T, v @ S.T, a @ S.T) @ S
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_link_that_leans_is_worn_as_it_leans():
    """Stiffly: forces are those of the joints, wherever the frame points."""
    lean = '<child link="calf"/><origin rpy="0 0.3 0"/>'
    model = edited(ANKLE, ('<child link="calf"/>', lean))
    weld = model.rigid.assembly.device.welds["calf"]
    assert weld.to == "shank"
    # Up and back about y is clockwise; angles count the other way round.
    assert weld.pitch_deg == pytest.approx(-np.rad2deg(0.3))
    names = model.coordinates
    S = names.aligned(np.eye(len(names.body))).T
    q, v, a = np.random.default_rng(0).normal(size=(3, 5, len(names.body)))
    found = model.rigid.tree.inverse_dynamics(q, v, a)
    expected = model.tree.inverse_dynamics(q @ S.T, v @ S.T, a @ S.T) @ S
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("moments", "products", "left_out"),
    [
        # A disc: two moments add up to the third.
        (("0.01", "0.01", "0.02"), "0", False),
        # The same, turned about y by 30 degrees.
        (("0.0125", "0.01", "0.0175"), "0.00433012701892", False),
        # A body, if only just; and none.
        (("0.01", "0.012", "0.02"), "0.002", False),
        (("0.01", "0.012", "0.02"), "0.015", True),
    ],
)
def test_inertias_at_the_edge_of_what_a_body_has(moments, products, left_out):
    old = 'ixx="0.02" iyy="0.02" izz="0.006" ixy="0" ixz="0"'
    x, y, z = moments
    new = f'ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="{products}"'
    notes = edited(ANKLE, (old, new)).assembly.device.notes
    assert bool(notes) == left_out


def test_an_inertia_in_other_units_is_refused():
    """No link's mass is over 1 m out; that of a sensor's frame may be."""
    old = 'ixx="0.02" iyy="0.02" izz="0.006" ixy="0" ixz="0"'
    new = old.replace("0.02", "2e4").replace("0.006", "6e3")
    with pytest.raises(InputError, match=r"2\.4 kg is that of a ring of 91 m"):
        edited(ANKLE, (old, new))
    dot = """<link name="dot"><inertial><mass value="1e-4"/><inertia ixx="1e-3"
    iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="glue" type="fixed"><parent link="calf"/><child link="dot"/>
    </joint></robot>"""
    model = edited(ANKLE, ("</robot>", dot))
    assert model.tree.mass == pytest.approx(73.6001)


@pytest.mark.parametrize(("off", "taken"), [("1e-8", True), ("1e-4", False)])
def test_an_axis_may_leave_the_plane_s_normal_by_rounding(off, taken):
    change = ('<axis xyz="0 1 0"/>', f'<axis xyz="{off} 1 0"/>')
    if taken:
        assert edited(ANKLE, change).coordinates.device == ("motor",)
        return
    with pytest.raises(InputError, match="out of the sagittal plane"):
        edited(ANKLE, change).tree  # noqa: B018


@pytest.mark.parametrize(
    "change",
    [
        ('xyz="0.02 0 0.16"', 'xyz="20 0 160"'),
        ("<child", '<origin xyz="0 0 -420"/><child'),
    ],
)
def test_a_device_in_millimetres_is_refused(change):
    """Else Newton's law is missed, and the plates are blamed."""
    with pytest.raises(InputError, match="give the file's lengths in metres"):
        edited(ANKLE, change).tree  # noqa: B018


def test_a_joint_that_counts_the_other_way_round():
    model = edited(ANKLE, ('xyz="0 1 0"', 'xyz="0 -1 0"'))
    assert model.coordinates.turned_by.tolist() == [[-1.0, 0.0, 0.0]]
    assert model.coordinates.follows("motor") == "ankle"


@pytest.mark.slow
def test_a_device_written_from_its_other_end_is_the_same():
    """An angle is the child's against the parent, whichever is welded."""
    turned = edited(
        ANKLE,
        ('<parent link="shoe"/>', '<parent link="X"/>'),
        ('<child link="calf"/>', '<child link="shoe"/>'),
        ('<parent link="X"/>', '<parent link="calf"/>'),
        ('xyz="0 1 0"', 'xyz="0 -1 0"'),
    )
    assert turned.coordinates == built(ANKLE).coordinates
    assert turned.tree.joints == built(ANKLE).tree.joints
    assert turned.tree.joints["motor"] == ("shoe", "calf")
    np.testing.assert_array_equal(
        foot_turn(turned.tree), foot_turn(built(ANKLE).tree)
    )
    motion = np.random.default_rng(1).normal(size=(3, 2, 7))
    np.testing.assert_allclose(
        turned.tree.inverse_dynamics(*motion),
        built(ANKLE).tree.inverse_dynamics(*motion),
    )


@pytest.mark.slow
def test_joints_may_be_written_in_any_order():
    """Of a chain of three from pelvis to thigh the last one is the hip."""
    link = """<link name="{}"><inertial><mass value="0.5"/><inertia ixx="0.01"
      iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    joint = """<joint name="{0}_{1}" type="continuous"><parent link="{2}"/>
      <child link="{3}"/><axis xyz="0 {4} 0"/></joint>"""
    chain = ("belt", "a", "b", "bar")
    ends = list(itertools.pairwise(chain))
    down = [joint.format(*e, *e, -1) for e in ends]
    up = [joint.format(*e, *e[::-1], 1) for e in ends]
    orders = [*itertools.permutations(down), *itertools.permutations(up)]
    held = {n: CuffLinks("pelvis", n, (0.0, 0.1), open=True) for n in "ab"}
    worn = replace(HIP, cuffs=HIP.cuffs | held)
    for order in orders:
        text = "".join([*map(link.format, chain), *order])
        text = f"<robot name='r'>{text}</robot>"
        model = Model(brought_in(worn, text), HUMAN)
        names = model.coordinates
        turned = dict(zip(names.device, names.turned_by.tolist(), strict=True))
        assert turned.pop("b_bar") == [0.0, 0.0, 1.0]
        assert turned == {k: [0.0] * 3 for k in ("belt_a", "a_b")}


@pytest.mark.parametrize("joint", ["knee", "foot_pitch"])
def test_joints_called_as_the_person_s_are_refused(joint):
    with pytest.raises(
        InputError, match=rf"joint '{joint}' has the name of one"
    ):
        edited(ANKLE, ('name="motor"', f'name="{joint}"')).tree  # noqa: B018


@pytest.mark.parametrize(
    "joint",
    ["left.motor", "a,b", "hip [deg]", "m&quot;", " hip", "time", "hip_moment"],
)
def test_joints_that_cannot_name_a_column_are_refused(joint):
    """Encoders are columns NAME and NAME_moment; found is JOINT.factor."""
    with pytest.raises(InputError, match="cannot name a column"):
        edited(ANKLE, ('name="motor"', f'name="{joint}"')).tree  # noqa: B018


@pytest.mark.parametrize("joint", ["m", "mot L1", "q/1", "times", "Hüfte"])
def test_other_names_of_joints_are_the_file_s(joint):
    model = edited(ANKLE, ('name="motor"', f'name="{joint}"'))
    assert model.tree.coordinates.device == (joint,)


@pytest.mark.parametrize("name", ["calf", "thigh", "exo_calf", "shank_cuff"])
def test_a_cuff_s_name_says_nothing_of_what_it_joins(name):
    cuffs = {name: CuffLinks("shank", "calf")}
    model = built(replace(ANKLE, cuffs=cuffs))
    assert model.tree.cuffs == {name: ("shank", f"{name}_shell")}
    other = {"shank": CuffLinks("shank", "exo_thigh")}
    crossed = replace(
        nominal_model("coupled"), kind=replace(COUPLED, cuffs=other)
    )
    with pytest.raises(InputError, match=r"'shank' does not join two links"):
        crossed.tree  # noqa: B018


@pytest.mark.slow
def test_dynamics_in_the_file_are_left_out():
    """The study's are used; those of the file were no planar tree's."""
    axis, said = '<axis xyz="0 1 0"/>', []
    for damping in ("0.3", "0.0"):
        own = f'{axis}<dynamics damping="{damping}" friction="0.0"/>'
        model = edited(ANKLE, (axis, own))
        assert model.tree.mass == built(ANKLE).tree.mass
        said.append(model.assembly.device.notes)
    ((note,), nothing) = said
    assert "joint 'motor': its dynamics" in note
    assert "device.joints.motor" in note
    assert nothing == ()


def test_cuffs_are_slack_while_both_stand_upright():
    """Also where the device's link has a frame of its own."""
    shifted = edited(
        ANKLE,
        ('<child link="calf"/>', '<child link="calf"/><origin xyz="0 0 0.1"/>'),
        ('xyz="0.02 0 0.16"', 'xyz="0.02 0 0.06"'),
    )
    for model in (built(ANKLE), shifted):
        tree = model.tree
        q = np.zeros((1, tree.num_positions))
        for link in tree.cuffs["calf"]:
            p = tree.point_positions(q, link, (0.0, 0.25))
            np.testing.assert_allclose(p, [[0.0, 0.25]], atol=1e-12)
    # The same centre of mass by another frame is the same device.
    rng = np.random.default_rng(1)
    motion = rng.normal(size=(3, 2, 7))
    motion[0, :, -1] = 0.0
    motion[1:, :, -1] = 0.0
    for own, other in zip(
        built(ANKLE).tree.inverse_dynamics(*motion)[:, :3],
        shifted.tree.inverse_dynamics(*motion)[:, :3],
        strict=True,
    ):
        np.testing.assert_allclose(own, other, atol=1e-9)


def test_a_device_that_looks_backward_is_turned():
    """Turned in the file, and turned back, it is the same."""
    text = (models_path() / "ankle_only.urdf").read_text()

    def turned(match):
        x, y, z = (float(part) for part in match[2].split())
        return f'{match[1]}="{-x} {-y} {z}"'

    backward = re.sub(r'(xyz)="([^"]*)"', turned, text)
    assert backward != text
    products = (('ixz="0"', 'ixz="0.001"'), ('ixz="0"', 'ixz="-0.001"'))
    own = brought_in(ANKLE, text.replace(*products[0]))
    device = replace(ANKLE.device, forward="-x")
    other = brought_in(
        replace(ANKLE, device=device), backward.replace(*products[1])
    )
    assert other.device.forward == "x"
    one, two = (Model(a, nominal_human()) for a in (own, other))
    motion = np.random.default_rng(4).normal(size=(3, 3, 7))
    np.testing.assert_allclose(
        one.tree.inverse_dynamics(*motion),
        two.tree.inverse_dynamics(*motion),
        atol=1e-10,
    )
    assert one.coordinates == two.coordinates


SIDEWAYS = """<link name="side"><inertial><mass value="1"/><inertia
  ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="abduction" type="revolute"><parent link="shoe"/>
  <child link="side"/><axis xyz="1 0 0"/><dynamics damping="0.1"/>
  <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_joints_out_of_the_plane_can_be_held():
    change = ("</robot>", SIDEWAYS)
    with pytest.raises(InputError, match=r"'abduction' turns about \(1, 0, 0"):
        edited(ANKLE, change).tree  # noqa: B018
    held = replace(ANKLE.device, fixed=("abduction",))
    model = edited(replace(ANKLE, device=held), change)
    assert model.coordinates.device == ("motor",)
    assert model.tree.mass == pytest.approx(70.0 + 3.6 + 1.0)
    wrong = replace(ANKLE.device, fixed=("adduction",))
    with pytest.raises(
        InputError, match=r"no joint 'adduction' to fix; it has"
    ):
        edited(replace(ANKLE, device=wrong), change)


def test_links_may_be_named_as_segments():
    names = {"calf": "shank", "shoe": "foot"}
    changes = [(f'"{a}"', f'"{b}"') for a, b in names.items()]
    weld = {"foot": "foot"}
    cuffs = {"calf": CuffLinks("shank", "shank")}
    same = replace(ANKLE, device=replace(ANKLE.device, weld=weld), cuffs=cuffs)
    model, plain = edited(same, *changes), built(ANKLE)
    assert model.tree.cuffs == {"calf": ("shank", "calf_shell")}
    motion = np.random.default_rng(4).normal(size=(3, 3, 7))
    np.testing.assert_allclose(
        model.tree.inverse_dynamics(*motion),
        plain.tree.inverse_dynamics(*motion),
        atol=1e-10,
    )
    q = motion[0]
    p = model.tree.point_positions(q, "shank", (0.0, 0.1))
    expected = plain.tree.point_positions(q, "shank", (0.0, 0.1))
    np.testing.assert_allclose(p, expected, atol=1e-12)


def test_what_is_fixed_to_a_strapped_link_moves_with_it():
    """A hinge above it turns with the joint of the person beside it."""
    plate = """<link name="plate"><inertial><mass value="0.5"/><inertia
      ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
      </link><joint name="glue" type="fixed"><parent link="calf"/>
      <child link="plate"/></joint></robot>"""
    cuffs = {"calf": CuffLinks("shank", "plate")}
    model = edited(replace(ANKLE, cuffs=cuffs), ("</robot>", plate))
    assert model.coordinates.turned_by.tolist() == [[1.0, 0.0, 0.0]]


def test_a_misspelt_inertial_is_told():
    """Drake skips it, and a link that is welded on may weigh nothing."""
    plate = (
        '<joint name="glue" type="fixed"><parent link="calf"/>'
        '<child link="plate"/></joint><link name="plate">{}<visual/></link>'
        "</robot>"
    )
    own = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1"/>'
    lost, kept, none = (
        edited(ANKLE, ("</robot>", plate.format(more)))
        for more in (
            f"<inertail>{own}</inertail>",
            f"<inertial>{own}</inertial>",
            "",
        )
    )
    assert lost.tree.mass == pytest.approx(kept.tree.mass - 1.0)
    (note,) = lost.assembly.device.notes
    assert "link 'plate': <inertail> is not read; is it <inertial>?" in note
    assert kept.assembly.device.notes == none.assembly.device.notes == ()


def test_products_of_inertia_that_no_body_has_are_left_out():
    old = 'ixx="0.02" iyy="0.02" izz="0.006" ixy="0" ixz="0"'
    new = old.replace('ixz="0"', 'ixz="0.05"')
    model, plain = edited(ANKLE, (old, new)), built(ANKLE)
    (note,) = model.assembly.device.notes
    assert "link 'calf': no body has such products of inertia" in note
    motion = np.random.default_rng(4).normal(size=(3, 3, 7))
    np.testing.assert_allclose(
        model.tree.inverse_dynamics(*motion),
        plain.tree.inverse_dynamics(*motion),
        atol=1e-10,
    )
    assert plain.assembly.device.notes == ()
    with pytest.raises(InputError, match=r"'calf': no body has moments of in"):
        edited(ANKLE, (old, old.replace('iyy="0.02"', 'iyy="0.2"')))


@pytest.mark.slow
def test_a_real_exoskeleton(tmp_path, data_root):
    """Project March's fourth: seven links a side, its own frames and names."""
    source = data_root / "exo_models/march4.xacro"
    (tmp_path / "march4.urdf").write_text(expanded(source, tmp_path))
    page = Path(__file__).parents[2] / "docs/your_exoskeleton.md"
    (block,) = re.findall(
        r"```yaml\n(model:[^`]*march4[^`]*)```", page.read_text()
    )
    lines = (line[2:] for line in block.splitlines()[1:])
    assembly = schema.load_text("\n".join(lines), Assembly)
    model = Model(with_text(assembly, tmp_path), nominal_human())
    # 8.7 kg at the hips, 14.3 kg a leg.
    device = 8.686 + 2.0 * (2.982 + 4.995 + 4.458 + 1.821)
    assert model.tree.mass == pytest.approx(70.0 + device)
    names = model.coordinates
    assert len(names.device) == 6
    for name in names.device:
        side, what = name.split("_")[:2]
        assert names.follows(name) == f"{what}_{side}"
        assert names.turned_by[names.device.index(name)].sum() == 1.0
    for side in ("left", "right"):
        # Upper and lower leg are 0.385 m, the hips 0.1395 m before the base.
        x, z, _ = model.upright_poses[f"ankle_plate_{side}"]
        assert (x, z) == pytest.approx((0.0, -0.77), abs=1e-3)
    assert len(assembly.device.notes) == 0
    notes = model.assembly.device.notes
    assert [n.split("'")[1] for n in notes] == ["foot_left", "foot_right"]


def test_the_shipped_three_are_descriptions():
    for kind, assembly in ASSEMBLIES.items():
        named = nominal_model(kind)
        described = replace(named, kind=assembly)
        assert described.coordinates == named.coordinates
        assert described.cuffs == named.cuffs
        assert described.spheres == named.spheres
        text = schema.dump_text(assembly)
        assert schema.load_text(text, Assembly) == assembly


def test_part_of_the_shipped_device():
    cuffs = {"thigh": CuffLinks("thigh", "exo_thigh")}
    whole = nominal_model("coupled")
    model = replace(whole, kind=replace(whole.assembly, cuffs=cuffs))
    assert list(model.tree.cuffs) == ["thigh"]
    assert model.coordinates == whole.coordinates
    human = replace(model.human, thigh_cuff_m=(0.02, 0.20))
    device = replace(model.exoskeleton, thigh_cuff_m=(0.05, 0.27))
    moved = replace(model, human=human, exoskeleton=device)
    assert moved.preload("thigh") == pytest.approx((0.03, 0.07))
    # Where the description says, it is slack.
    cuffs = {"thigh": replace(cuffs["thigh"], at_m=(0.0, 0.3))}
    model = replace(whole, kind=replace(whole.assembly, cuffs=cuffs))
    assert model.cuffs == {"thigh": (0.0, 0.3)}
    assert model.preload("thigh") == (0.0, 0.0)


@pytest.mark.parametrize(
    ("place", "axis"),
    [
        ((0.25, 0.0), "x"),  # [z, x]
        ((0.0, 2.5), "z"),
        ((0.0, -0.25), "z"),
    ],
)
def test_a_cuff_off_its_limb_is_refused(place, axis):
    whole = nominal_model("coupled")
    human = replace(whole.human, thigh_cuff_m=place)
    device = replace(whole.exoskeleton, thigh_cuff_m=place)
    cuffs = {"thigh": CuffLinks("thigh", "exo_thigh", at_m=place)}
    for model, field in (
        (replace(whole, human=human), "subject.segments.thigh_cuff_m"),
        (replace(whole, exoskeleton=device), "exoskeleton.thigh_cuff_m"),
        (replace(whole, kind=replace(COUPLED, cuffs=cuffs)), "model.cuffs"),
    ):
        with pytest.raises(InputError, match=f"{field}.*: {axis} is .* thigh"):
            model.cuffs  # noqa: B018


def test_a_cuff_lies_anywhere_on_its_limb():
    whole = nominal_model("coupled")
    foot = CuffLinks("foot", "exo_shank", at_m=(0.05, -0.03))
    for segment in ("shank", "thigh", "pelvis"):
        length = getattr(whole.human, segment).length_m
        for at in ((0.0, 0.0), (0.15, length), (-0.15, 0.5 * length)):
            cuffs = {"a": CuffLinks(segment, f"exo_{segment}", at_m=at)}
            kind = replace(COUPLED, cuffs=cuffs | {"b": foot})
            model = replace(whole, kind=kind)
            model.check_on_limb("at_m", "a", at)
            model.check_on_limb("at_m", "b", foot.at_m)


def test_a_heel_in_front_of_its_toe_is_refused():
    whole = nominal_model("coupled")
    device = whole.exoskeleton
    swapped = replace(device, heel_m=device.toe_m, toe_m=device.heel_m)
    ground = {"foot": {"heel": (0.12, -0.06), "toe": (-0.05, -0.06)}}
    for model in (
        replace(whole, exoskeleton=swapped),
        replace(whole, kind=replace(COUPLED, ground=ground)),
    ):
        with pytest.raises(InputError, match=r"heel of the foot .* no further"):
            model.soles  # noqa: B018


def test_every_sphere_is_under_the_foot_plate():
    ground = {"foot": ("heel", "ball", "toe")}
    model = nominal_model("coupled")
    worn = replace(model, kind=replace(COUPLED, ground=ground))
    x, z = np.transpose(list(worn.spheres.values()))
    assert (z == model.exoskeleton.toe_m[1]).all()
    assert (np.diff(x) > 0.0).all()


def test_links_between_those_that_are_held_ride_beside_their_segments():
    whole = nominal_model("coupled")
    cuffs = {"pelvis": COUPLED.cuffs["pelvis"]}
    model = replace(whole, kind=replace(COUPLED, cuffs=cuffs))
    q = np.array([[0.1, 0.0, 0.1, 0.4, 1.2, 0.9]])
    com, expected = (m.rigid.tree.center_of_mass(q) for m in (model, whole))
    np.testing.assert_allclose(com, expected, atol=1e-12)


LEG = ("hip", "knee", "ankle")


def two_legged(q):
    """Coordinates of two legs that move as the one leg (n, 6) does."""
    one = nominal_model("human").tree
    hip = one.point_positions(q, "pelvis", (0.0, 0.0))
    pitch = one.body_angles(q, "pelvis")[:, None]
    leg = q[:, one.coordinates.columns(LEG)]
    return np.hstack([hip, pitch, leg, leg])


@pytest.mark.parametrize("toes", ["rigid", "hinged"])
def test_two_legs_that_move_alike_are_the_one_leg(toes):
    one = nominal_model("human").tree
    two = Model(Assembly(Person("two", toes)), nominal_human()).tree
    t = np.linspace(0.0, 1.0, 201)
    rng = np.random.default_rng(2)
    knots = np.cumsum(rng.normal(size=(12, 6)), axis=0) * 0.1
    path = make_interp_spline(np.linspace(0.0, 1.0, 12), knots, k=7)
    q1 = path(t)
    q2 = np.zeros((len(t), two.num_positions))
    q2[
        :,
        two.coordinates.columns(
            ["pelvis_x", "pelvis_z", "pelvis_pitch"]
            + [f"{j}_{s}" for s in ("left", "right") for j in LEG]
        ),
    ] = two_legged(q1)
    np.testing.assert_allclose(
        two.center_of_mass(q2), one.center_of_mass(q1), atol=1e-12
    )

    def power(tree, path):
        q, v, a = path(t), path.derivative(1)(t), path.derivative(2)(t)
        return np.sum(v * tree.inverse_dynamics(q, v, a), axis=1)[20:-20]

    found = power(two, make_interp_spline(t, q2, k=7))
    np.testing.assert_allclose(found, power(one, path), rtol=1e-5, atol=1e-3)


def test_foot_and_toes_are_the_foot():
    human = nominal_human()
    foot, toes = foot_and_toes(human)
    assert foot.mass_kg + toes.mass_kg == pytest.approx(human.foot.mass_kg)
    assert foot.inertia_kg_m2 > 0.0
    # A rod from the ball to the tip, about its middle.
    length = 2.0 * toes.com_m[0]
    assert toes.length_m == pytest.approx(length)
    rod = toes.mass_kg * length**2 / 12.0
    assert toes.inertia_kg_m2 == pytest.approx(rod)
    stiff, hinged = (
        Model(Assembly(Person("one", toes)), human).tree
        for toes in ("rigid", "hinged")
    )
    q, v, a = np.random.default_rng(3).normal(size=(3, 4, 7))
    for x in (q, v, a):
        x[:, -1] = 0.0
    np.testing.assert_allclose(
        hinged.inverse_dynamics(q, v, a)[:, :6],
        stiff.inverse_dynamics(q[:, :6], v[:, :6], a[:, :6]),
        atol=1e-9,
    )


def test_toes_of_one_s_own_leave_the_rest_of_the_foot():
    """Masses, centres and moments of inertia of both are the whole's."""
    toes = SegmentParameters(0.3, (0.03, 0.008), 4e-4, 0.07)
    human = replace(nominal_human(), toes=toes, ball_m=(0.12, -0.05))
    rest, cut = foot_and_toes(human)
    assert cut == toes
    places = (
        (rest.mass_kg, np.array(rest.com_m), rest.inertia_kg_m2),
        (0.3, np.array([0.12 + 0.03, -0.05 + 0.008]), 4e-4),
    )
    mass = sum(m for m, _, _ in places)
    com = sum(m * p for m, p, _ in places) / mass
    inertia = sum(i + m * np.sum((p - com) ** 2) for m, p, i in places)
    assert mass == pytest.approx(human.foot.mass_kg)
    assert tuple(com) == pytest.approx(human.foot.com_m)
    assert inertia == pytest.approx(human.foot.inertia_kg_m2)


def test_a_body_s_place_seen_from_one_that_leans():
    """Where it is welded it is where it was."""
    lean = '<child link="calf"/><origin xyz="0.01 0 0.02" rpy="0 0.3 0"/>'
    model = edited(ANKLE, ('<child link="calf"/>', lean))
    tree = model.tree
    q = np.zeros((1, tree.num_positions))
    for base, body in (("calf", "shank"), ("shank", "calf")):
        weld = plant_module._seen_from(model, base, body)
        place = tree.point_positions(q, base, weld.at_m)
        there = tree.point_positions(q, body, (0.0, 0.0))
        np.testing.assert_allclose(place, there, atol=1e-12)
        turn = tree.body_angles(q, body) - tree.body_angles(q, base)
        assert weld.pitch_deg == pytest.approx(np.rad2deg(turn[0]))
        assert np.hypot(*weld.at_m) > 0.02


def test_toes_go_up():
    tree = Model(Assembly(Person("two", "hinged")), nominal_human()).tree
    q = np.zeros((2, tree.num_positions))
    q[1, tree.coordinates.index("toes_left")] = 0.3
    tip = tree.point_positions(q, "toes_left", (0.05, 0.0))[:, 1]
    assert tip[1] > tip[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            [('xyz="0 1 0"', 'xyz="1 0 0"')],
            r"ankle_only.urdf: joint 'motor' turns about \(1, 0, 0\)",
        ),
        (
            [('type="revolute"', 'type="prismatic"')],
            "joint 'motor' is prismatic",
        ),
        (
            [
                ('<mass value="2.4"/>', '<mass value="0"/>'),
                (
                    'ixx="0.02" iyy="0.02" izz="0.006"',
                    'ixx="0" iyy="0" izz="0"',
                ),
            ],
            "link 'calf' moves and weighs nothing",
        ),
        (
            [
                (
                    '<joint name="motor" type="revolute">',
                    '<joint name="m" type="revolute">',
                ),
                ('<parent link="shoe"/>', '<parent link="sho"/>'),
            ],
            "ankle_only.urdf: ",
        ),
        (
            [('lower="-1" upper="1"', 'lower="1" upper="-1"')],
            "'motor' has a lower limit of 1, but an upper one of -1; correct",
        ),
        ([("</robot>", "")], "is not XML"),
        ([("<robot", "<car"), ("</robot", "</car")], "holds no <robot>"),
        ([('<robot name="ankle_only"', '<robot name=""')], "has no name; give"),
        (
            [
                (
                    "</robot>",
                    '<link name="loose"><inertial><mass value="1"/>'
                    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
                    "</inertial></link></robot>",
                )
            ],
            "link 'loose' is attached to nothing",
        ),
    ],
)
def test_devices_that_cannot_be_are_refused(change, words):
    with pytest.raises(InputError, match=words) as caught:
        edited(ANKLE, *change).tree  # noqa: B018
    assert str(caught.value).count("\n") == 0


def test_limits_of_a_joint_that_is_fixed_do_not_matter():
    device = replace(ANKLE.device, fixed=("motor",))
    model = edited(
        Assembly(device=device),
        ('lower="-1" upper="1"', 'lower="1" upper="-1"'),
    )
    assert model.coordinates.device == ()


def test_loops_are_refused():
    """Both ends of a chain welded, its joints still there."""
    knee = """<link name="thigh_bar"><inertial><mass value="1"/><inertia
      ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="upper" type="revolute"><parent link="calf"/>
      <child link="thigh_bar"/><axis xyz="0 1 0"/>
      <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""
    model = edited(ANKLE, ("</robot>", knee))
    both = {"shoe": "foot", "thigh_bar": "thigh"}
    loop = replace(
        model.assembly, device=replace(model.assembly.device, weld=both)
    )
    with pytest.raises(InputError, match=r"joint '.*' closes a loop"):
        replace(model, kind=loop).tree  # noqa: B018


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{device: {weld: {}}}", "attached to nothing"),
        ("{device: {weld: {exo_foot: foott}}}", "no segment 'foott'"),
        ("{human: {legs: three}}", "human.legs must be one of one, two"),
        ("{cuffs: {thigh: {human: thigh, device: x}}}", "cuffs need a device"),
        ("{ground: {foot: []}}", "foot has no sphere"),
        ("{ground: {foot: [heel, heel]}}", "foot names a sphere more than"),
        (
            "{ground: {foot: [heel, a.b]}}",
            "'a.b' cannot be the name of a cuff or sph",
        ),
        (
            "{device: {weld: {exo_foot: foot}}, "
            "cuffs: {heel: {human: thigh, device: exo_thigh}}}",
            "a cuff and a sphere are called 'heel'",
        ),
        ("{ground: {sole: [heel]}}", "no segment 'sole'"),
        (
            "{human: {legs: two}, ground: {foot_left: [heel, toe]}}",
            "the right foot never touches",
        ),
        ("{human: {trunk: bent}}", "human.trunk must be one of rigid"),
        ("{ground: {foot: same}}", "foot is 'same', but that segment"),
        ("{ground: {foot: heel}}", "ground.foot must be a list, but is 'heel'"),
        (
            "{human: {legs: two}, ground: {foot_left: same, foot_right: same}}",
            "foot_left is 'same', but that segment",
        ),
    ],
)
def test_descriptions_that_cannot_be_are_refused(text, words):
    with pytest.raises(InputError, match=words):
        schema.load_text(text, Assembly)


@pytest.mark.parametrize(
    ("assembly", "words"),
    [
        (
            replace(ANKLE, cuffs={"calf": CuffLinks("shank", "claf")}),
            "has no link 'claf'; it has shoe, calf",
        ),
        (
            replace(ANKLE, device=replace(ANKLE.device, weld={"sho": "foot"})),
            "has no link 'sho'",
        ),
        (
            Assembly(ground={"foot": ("heel", "big_toe")}),
            r"'big_toe' has no .* toe\); give big_toe: \[x, z\] in m$",
        ),
        (  # of a foot whose toes are a segment of their own
            Assembly(Person(toes="hinged"), ground={"toes": ("heel", "toe")}),
            r"toe\); name it on foot, or give heel: \[x, z\] in m$",
        ),
        (
            replace(ANKLE, cuffs={"f": CuffLinks("foot", "calf")}),
            "cuff 'f' has no usual place on foot",
        ),
        (
            replace(ANKLE, cuffs={"f": CuffLinks("foot", "shoe", (0.0, 0.0))}),
            "cuff 'f' does not join two links that move",
        ),
    ],
)
def test_names_that_are_not_there_are_refused(assembly, words):
    with pytest.raises(InputError, match=words):
        (model := built(assembly)).cuffs, model.spheres


def test_cuffs_of_the_shipped_device_are_called_as_their_segments(nominal):
    calf = {"calf": CuffLinks("shank", "exo_shank")}
    named = replace(COUPLED, cuffs=COUPLED.cuffs | calf)
    with pytest.raises(
        InputError, match=r"'calf' does not join .* shank, thigh, pelv"
    ):
        replace(nominal("coupled"), kind=named).tree  # noqa: B018


def test_files_that_are_no_device_are_refused(tmp_path):
    for name, words in (
        ("d.xacro", r"expand it first \('xacro d\.xacro > d\.urdf'\)"),
        ("d.urdf.xacro", r"\('xacro d\.urdf\.xacro > d\.urdf'\)"),
        ("d.sdf.xacro", r"\('xacro d\.sdf\.xacro > d\.sdf'\)"),
        ("d.obj", "is not a device"),
    ):
        device = DeviceFile({"shoe": "foot"}, Path(name))
        with pytest.raises(InputError, match=words):
            with_text(Assembly(device=device), tmp_path)
    device = DeviceFile({"shoe": "foot"}, Path("missing.urdf"))
    with pytest.raises(InputError, match=r"missing.urdf: cannot be read"):
        with_text(Assembly(device=device), tmp_path)


@pytest.mark.parametrize(
    "rest",
    [
        '<xacro:leg side="left"/>',
        '<xacro:if value="1"><link name="more"/></xacro:if>',
    ],
)
@pytest.mark.parametrize(
    "space", ["", ' xmlns:xacro="http://www.ros.org/wiki/xacro"']
)
def test_a_xacro_file_of_another_name_is_told(rest, space):
    """Else what it includes or repeats would be left out without a word."""
    name = '<robot name="ankle_only"'
    with pytest.raises(InputError, match=r"xacro ankle_only\.urdf > ankle"):
        edited(ANKLE, (name, name + space), ("</robot>", f"{rest}</robot>"))
    if space:  # what is left of it once expanded
        said = f"<!-- {rest} --></robot>"
        model = edited(ANKLE, (name, name + space), ("</robot>", said))
        assert model.tree.mass == built(ANKLE).tree.mass


def test_a_link_turned_on_its_segment():
    """Its own frame counts for nothing; where its mass is does."""
    turned = replace(
        ANKLE,
        device=replace(
            ANKLE.device, weld={"shoe": Weld("foot", (0.1, 0.0), 90.0)}
        ),
    )
    tree = built(turned).tree
    q = np.zeros((1, tree.num_positions))
    # Toes up by 90 degrees: what lay ahead lies above.
    place = tree.point_positions(q, "shoe", (0.2, 0.0))
    np.testing.assert_allclose(place, [[0.1, 0.2]], atol=1e-12)


@pytest.mark.parametrize("spheres", ["[heel, toe]", "{heel: [-0.1, -0.1]}"])
def test_a_foot_may_be_described_as_the_same_as_the_other(spheres):
    found = schema.load_text(
        "{human: {legs: two, toes: rigid, trunk: rigid}, "
        f"ground: {{foot_right: {spheres}, foot_left: same}}}}",
        Assembly,
    )
    assert found.ground["foot_left"] == found.ground["foot_right"]
    assert found.spheres["foot_left"] == found.spheres["foot_right"]


def test_feet_may_have_parameters_of_their_own():
    """Each sphere where the shared one is, bounded as it, and on its own."""
    sides = ("left", "right")
    ground = {f"foot_{s}": (f"heel_{s}", f"toe_{s}") for s in sides}
    own = Model(Assembly(Person("two"), ground=ground), nominal_human())
    shared = Model(Assembly(Person("two")), nominal_human())
    soft = SphereSettings(modulus_n_m2=Range(2e6, 1e6, 3e6))
    odd = SphereSettings(modulus_n_m2=Range(4e6, 1e6, 5e6))
    settings = FootGroundSettings(heel=soft, spheres={"toe_left": odd})
    for side in sides:
        for name in ("heel", "toe"):
            place = own.soles[f"foot_{side}"][f"{name}_{side}"]
            assert place == shared.soles[f"foot_{side}"][name]
    found = {p.name: p for p in settings.parameters(own.spheres)}
    assert len(found) == 2 * len(settings.parameters(shared.spheres))
    moduli = {n: p.nominal for n, p in found.items() if "stiffness" in n}
    assert moduli == {
        "heel_left.stiffness": 2e6,
        "toe_left.stiffness": 4e6,
        "heel_right.stiffness": 2e6,
        "toe_right.stiffness": 1e7,
    }
    contact = settings.contact(own.spheres).ground.under(own)
    assert list(contact["foot_left"].spheres) == ["heel_left", "toe_left"]


CALF = (
    '<link name="calf"',
    '<child link="calf"/>',
    '<axis xyz="0 1 0"/>',
    'xyz="0.02 0 0.16"',
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rpy", "axis", "com"),
    [
        ("1.5707963267949 0 0", "0 0 -1", "0.02 0.16 0"),  # as CAD exports
        ("1.5708 0 0", "0 0 -1", "0.02 0.16 0"),  # rounded
        ("0 0 3.14159265358979", "0 -1 0", "-0.02 0 0.16"),  # mirrored
        ("0 0.4 1.57079632679490", None, None),
    ],
)
def test_frames_of_links_may_lie_as_cad_left_them(rpy, axis, com):
    """The same device, with a massless strap, whatever a frame's axes are."""
    strap = (
        '<link name="strap"/><joint name="sewn" type="fixed">'
        '<parent link="calf"/><child link="strap"/>'
        '<origin xyz="-0.03 0 0.2" rpy="{}"/></joint></robot>'
    )
    plain, turned = "0 0 0", rpy
    changes = [("</robot>", strap.format(turned))]
    if axis is not None:
        changes = [
            (CALF[1], f'{CALF[1]}<origin rpy="{rpy}"/>'),
            (CALF[2], f'<axis xyz="{axis}"/>'),
            (CALF[3], f'xyz="{com}"'),
            # A rolled link's moments change places.
            ('iyy="0.02" izz="0.006"', 'iyy="0.006" izz="0.02"')
            if rpy.startswith("1.57")
            else ("<robot", "<robot"),
            ("</robot>", strap.format(plain)),
        ]
    cuffs = {"calf": CuffLinks("shank", "strap")}
    worn = replace(ANKLE, cuffs=cuffs)
    own = edited(worn, ("</robot>", strap.format(plain)))
    other = edited(worn, *changes)
    q, v, a = np.random.default_rng(0).normal(size=(3, 4, 7))
    for one, two in ((own, other), (own.rigid, other.rigid)):
        n = one.tree.num_positions
        np.testing.assert_allclose(
            two.tree.inverse_dynamics(q[:, :n], v[:, :n], a[:, :n]),
            one.tree.inverse_dynamics(q[:, :n], v[:, :n], a[:, :n]),
            atol=1e-4 if rpy == "1.5708 0 0" else 1e-8,
        )
    plant = other.plant()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q[0])
    tree = other.tree
    upright = np.zeros((1, 7))
    for place in ((0.0, 0.25), (0.1, 0.0)):
        ends = [
            tree.point_positions(upright, b, place) for b in tree.cuffs["calf"]
        ]
        np.testing.assert_allclose(*ends, atol=1e-9)
    shell = plant.GetBodyByName("calf_shell").EvalPoseInWorld(context)
    p = shell @ np.array([0.1, 0.0, 0.25])
    found = tree.point_positions(q[:1], "calf_shell", (0.1, 0.25))[0]
    np.testing.assert_allclose(p[[0, 2]], found, atol=1e-5)


SDF = """<sdf version="1.9"><model name="d" canonical_link="shank">
<link name="shoe"><inertial><pose>0.05 0 -0.07 0 0 0</pose><mass>1.2</mass>
<inertia><ixx>0.004</ixx><iyy>0.006</iyy><izz>0.006</izz></inertia></inertial></link>
<joint name="motor" type="revolute"><pose relative_to="shoe">0 0 0 0 0 0</pose>
<parent>shoe</parent><child> shank </child>
<axis><xyz expressed_in="shank">0 1 0</xyz></axis></joint>
<link name="shank"><pose relative_to="motor">0 0 0 0 0 0</pose>
<inertial><pose>0.02 0 0.16 0 0 0</pose><mass>2.4</mass>
<inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.006</izz></inertia></inertial>
<visual name="v"><pose degrees="true">0 0 0.1 0 90 0</pose>
<geometry><box><size>0.2 0.01 0.03</size></box></geometry></visual></link>
</model></sdf>"""


@pytest.mark.slow
def test_places_in_an_sdf_may_be_told_from_joints():
    """As `gz sdf -p` writes them; also of links that are renamed."""
    assembly = Assembly(
        device=DeviceFile({"shoe": "foot"}, Path("gz.sdf")),
        cuffs={"calf": CuffLinks("shank", "shank")},
    )
    model = Model(brought_in(assembly, SDF), HUMAN)
    own = built(ANKLE)
    q, v, a = np.random.default_rng(0).normal(size=(3, 4, 7))
    np.testing.assert_allclose(
        model.tree.inverse_dynamics(q, v, a),
        own.tree.inverse_dynamics(q, v, a),
        atol=1e-9,
    )
    assert model.rigid.tree.mass == pytest.approx(own.tree.mass)


OLD_SDF = """<sdf version="{version}"><model name="d"><pose>1 0 2 0 0 0</pose>
<link name="shoe"><inertial><mass>1.2</mass><inertia><ixx>0.004</ixx>
<iyy>0.006</iyy><izz>0.006</izz></inertia></inertial></link>
<link name="bar"><pose>0.1 0.02 0.3 {rpy}</pose><inertial>
<pose>0.03 0.05 0.16 0 0 0</pose><mass>2.4</mass><inertia><ixx>0.02</ixx>
<iyy>0.02</iyy><izz>0.006</izz></inertia></inertial></link>
<joint name="motor" type="revolute"><pose>0.01 0.02 0.03 0 0 0</pose>
<parent>shoe</parent><child>bar</child><axis>
<xyz{told}>{axis}</xyz>{more}</axis></joint></model></sdf>"""
IN_MODEL = "<use_parent_model_frame>1</use_parent_model_frame>"


@pytest.mark.parametrize(
    ("rpy", "axis"),
    [
        # A turned link, and y in its axes.
        ("0 0 3.141592653589793", "0 -1 0"),
        ("1.5707963267948966 0 0", "0 0 -1"),
        ("0 0.4 0", "0 1 0"),
    ],
)
@pytest.mark.parametrize(
    ("version", "more", "told", "in_model"),
    [
        ("1.4", "", "", True),
        ("1.5", IN_MODEL, "", True),
        ("1.6", IN_MODEL, "", True),
        ("1.6", "", "", False),
        ("1.9", "", ' expressed_in="__model__"', True),
        ("1.9", "", "", False),
    ],
)
def test_an_axis_of_an_sdf_is_in_the_axes_of_its_version(
    rpy, axis, version, more, told, in_model
):
    """Where Drake's own parser has the link, whose joint turns by 0.4 rad."""
    text = OLD_SDF.format(
        version=version,
        rpy=rpy,
        told=told,
        more=more,
        axis="0 1 0" if in_model else axis,
    )
    device = DeviceFile({"shoe": "foot"}, Path("d.sdf"))
    worn = Assembly(device=device, cuffs={"calf": CuffLinks("shank", "bar")})
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("shoe"))
    plant.Finalize()
    found = []
    for one in (plant, Model(brought_in(worn, text), HUMAN).plant()):
        context = one.CreateDefaultContext()
        one.SetPositions(context, np.zeros(one.num_positions()))
        one.GetJointByName("motor").set_angle(context, 0.4)
        shoe, bar = (
            one.GetBodyByName(n).EvalPoseInWorld(context)
            for n in ("shoe", "bar")
        )
        com = one.GetBodyByName("bar").CalcCenterOfMassInBodyFrame(context)
        found.append(shoe.inverse() @ (bar @ com))
    np.testing.assert_allclose(*found, atol=1e-12)


@pytest.mark.parametrize(
    ("first", "second"), [("1.57", "-1.5708"), ("3.14", "-1.571")]
)
def test_quarter_turns_may_be_rounded(first, second):
    """Axes are then those of exact turns, not a thousandth off the plane."""
    chain = """<robot name="r">{shoe}<link name="a"/>{calf}
    <joint name="first" type="fixed"><parent link="shoe"/><child link="a"/>
    <origin xyz="0.02 0 0.1" rpy="{first} 0 0"/></joint>
    <joint name="motor" type="continuous"><parent link="a"/>
    <child link="calf"/><origin rpy="{second} 0 0"/>
    <axis xyz="{axis}"/></joint></robot>"""
    link = """<link name="{}"><inertial><origin xyz="0.02 0.01 0.2"/>
    <mass value="1.4"/><inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0"
    ixz="0" iyz="0"/></inertial></link>"""
    models = []
    for exact in (False, True):
        turns = [_exactly(x) if exact else x for x in (first, second)]
        text = chain.format(
            shoe=link.format("shoe"),
            calf=link.format("calf"),
            first=turns[0],
            second=turns[1],
            axis="0 1 0" if first == "1.57" else "0 0 1",
        )
        models.append(Model(brought_in(ANKLE, text), HUMAN))
    q, v, a = np.random.default_rng(0).normal(size=(3, 4, 7))
    found, meant = (m.tree.inverse_dynamics(q, v, a) for m in models)
    np.testing.assert_allclose(found, meant, atol=1e-9)


BENT_URDF = """<robot name="r">{base}{thigh}{shank}
<joint name="h" type="revolute"><parent link="base"/><child link="thigh_link"/>
<origin xyz="0.02 0.1 -0.03" rpy="-1.5708 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/>
<calibration rising="0"/></joint>
<joint name="k" type="revolute"><parent link="thigh_link"/>
<child link="shank_link"/><origin xyz="0.24 0.28 0"/><axis xyz="0 0 -1"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint></robot>"""
BENT_SDF = """<sdf version="1.7"><model name="r"><self_collide>0</self_collide>
{base}{thigh}{shank}
<joint name="h" type="revolute"><parent>base</parent><child>thigh_link</child>
<axis><xyz>0 0 1</xyz></axis></joint>
<joint name="k" type="revolute"><parent>thigh_link</parent>
<child>shank_link</child><axis><xyz>0 0 -1</xyz></axis></joint></model></sdf>"""


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
@pytest.mark.parametrize("forward", ["x", "-x"])
def test_a_file_s_zero_may_be_bent(kind, forward, caplog):
    """Counted from there, links are where Drake's own parser has them."""
    places = {
        "base": "0 0 0 0 0 0",
        "thigh": "0.02 0.1 -0.03 -1.5707963267948966 0 0",
        "shank": "0.26 0.1 -0.31 -1.5707963267948966 0 0",
    }
    links = {}
    for name, place in places.items():
        own = name if name == "base" else f"{name}_link"
        moments = {"ixx": 0.02, "iyy": 0.01, "izz": 0.02}
        if kind == "urdf":
            told = " ".join(f'{k}="{v}"' for k, v in moments.items())
            links[name] = f"""<link name="{own}"><inertial>
            <origin xyz="0.1 0.12 0.01"/><mass value="2"/>
            <inertia {told} ixy="0" ixz="0" iyz="0"/></inertial></link>"""
        else:
            told = "".join(f"<{k}>{v}</{k}>" for k, v in moments.items())
            links[name] = f"""<link name="{own}"><pose>{place}</pose><inertial>
            <pose>0.1 0.12 0.01 0 0 0</pose><mass>2</mass>
            <inertia>{told}</inertia></inertial></link>"""
    text = (BENT_URDF if kind == "urdf" else BENT_SDF).format(**links)
    upright = {"h": 49.4, "k": -22.0}
    worn = Assembly(
        device=DeviceFile(
            {"base": "pelvis"}, Path(f"d.{kind}"), forward, (), upright
        ),
        cuffs={
            "thigh": CuffLinks("thigh", "thigh_link"),
            "shank": CuffLinks("shank", "shank_link"),
        },
    )
    caplog.clear()
    model = Model(brought_in(worn, text), HUMAN)
    assert not caplog.records
    assert model.assembly.device.upright_deg == {}
    plant = MultibodyPlant(0.0)
    exact = text.replace("-1.5708", "-1.5707963267948966")
    Parser(plant).AddModelsFromString(exact, kind)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    found = []
    for one, zero in ((plant, upright), (model.plant(), {})):
        context = one.CreateDefaultContext()
        one.SetPositions(context, np.zeros(one.num_positions()))
        for name, turned in (("h", 0.3), ("k", -0.5)):
            angle = turned + np.deg2rad(zero.get(name, 0.0))
            one.GetJointByName(name).set_angle(context, angle)
        base = one.GetBodyByName("base").EvalPoseInWorld(context)
        places = []
        for name in ("thigh_link", "shank_link"):
            body = one.GetBodyByName(name)
            com = body.CalcCenterOfMassInBodyFrame(context)
            at = body.EvalPoseInWorld(context) @ com
            places.append(base.inverse() @ at)
        found.append(np.array(places))
    if forward == "-x":
        found[1] *= (-1.0, -1.0, 1.0)
    np.testing.assert_allclose(*found, atol=1e-9)
    with pytest.raises(InputError, match="has no joint 'knee'; it has h, k"):
        device = replace(worn.device, upright_deg={"knee": 10.0})
        brought_in(replace(worn, device=device), text)
    held = re.sub('(name="h" type=)"revolute"', r'\1"fixed"', text)
    with pytest.raises(InputError, match="'h' is fixed, and turns by no angle"):
        brought_in(worn, held)
    for bad, told in ((np.nan, "h is nan, but must be a"), ("x", "but is 'x'")):
        with pytest.raises(InputError, match=f"upright_deg.*{told}"):
            replace(worn.device, upright_deg={"h": bad})
    with pytest.raises(InputError, match="joint 'h' is fixed, at zero; leave"):
        replace(worn.device, fixed=("h",))


def _exactly(text):
    return repr(round(float(text) / (np.pi / 2.0)) * (np.pi / 2.0))


def test_a_device_with_y_up_hangs_from_a_link_that_turns_it():
    """As docs/your_exoskeleton.md tells."""
    page = Path(__file__).parents[2] / "docs/your_exoskeleton.md"
    told = " ".join(page.read_text().split())
    (turn,) = re.findall(
        r'`(<link name="worn"/>)` and `(<joint.*?</joint>)`', told
    )
    link = """<link name="{}"><inertial><origin xyz="{}"/><mass value="2"/>
    <inertia ixx="0.02" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/></inertial>
    </link>"""
    joint = """<joint name="motor" type="continuous"><parent link="base"/>
    <child link="bar"/><axis xyz="{}"/></joint>"""
    text = '<robot name="r">{}{}{}</robot>'
    upright = text.format(
        link.format("base", "-0.1 0 0.1", 0.03, 0.01),
        link.format("bar", "0.01 0 -0.2", 0.03, 0.01),
        joint.format("0 -1 0"),
    )
    y_up = text.format(
        link.format("base", "-0.1 0.1 0", 0.01, 0.03),
        link.format("bar", "0.01 -0.2 0", 0.01, 0.03),
        joint.format("0 0 1") + "".join(turn),
    )
    trees = [
        Model(
            brought_in(
                replace(HIP, device=DeviceFile(weld, HIP.device.file)), x
            ),
            HUMAN,
        ).tree
        for weld, x in (
            ({"base": "pelvis"}, upright),
            ({"worn": "pelvis"}, y_up),
        )
    ]
    q, v, a = np.random.default_rng(0).normal(size=(3, 4, 7))
    found, meant = (tree.inverse_dynamics(q, v, a) for tree in trees)
    np.testing.assert_allclose(found, meant, atol=1e-9)
    with pytest.raises(
        InputError, match="weld a link whose x is forward and z"
    ):
        device = DeviceFile({"base": "pelvis"}, HIP.device.file)
        Model(brought_in(replace(HIP, device=device), y_up), HUMAN).tree  # noqa: B018


def test_other_angles_are_as_they_are_told():
    for text in ("1.58", "1.56", "1.5", "0.002", "0", "-0.785", "x", "nan"):
        assert device_file._quarters(text) == text
    sdf = OLD_SDF.format(
        version="1.9", rpy="1.57 0 3.1416", told="", axis="0 0 -1", more=""
    )
    device = DeviceFile({"shoe": "foot"}, Path("d.sdf"))
    worn = Assembly(device=device, cuffs={"calf": CuffLinks("shank", "bar")})
    pose = "<pose>0.1"
    for told in (pose, pose.replace(">", ' rotation_format="euler_rpy">')):
        model = Model(brought_in(worn, sdf.replace(pose, told)), HUMAN)
        assert model.coordinates.device == ("motor",)


def test_an_sdf_that_looks_backward_may_tell_its_turns_in_any_way():
    device = DeviceFile({"shoe": "foot"}, Path("gz.sdf"), forward="-x")
    assembly = Assembly(
        device=device, cuffs={"calf": CuffLinks("shank", "shank")}
    )
    old = '<pose relative_to="motor">0 0 0 0 0 0</pose>'
    new = (
        '<pose relative_to="motor" rotation_format="quat_xyzw">'
        "0 0 0 0 0 0 1</pose>"
    )
    motion = np.random.default_rng(0).normal(size=(3, 4, 7))
    one, two = (
        Model(brought_in(assembly, text), HUMAN).tree.inverse_dynamics(*motion)
        for text in (SDF, SDF.replace(old, new))
    )
    np.testing.assert_allclose(one, two, atol=1e-12)


def test_a_joint_that_follows_another_is_refused():
    follow = ("</joint>", '<mimic joint="other"/></joint>')
    with pytest.raises(InputError, match="'motor' follows another one"):
        edited(ANKLE, follow)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            [
                ('<parent link="shoe"/>', '<parent link="c"/>'),
                ('<child link="calf"/>', '<child link="shoe"/>'),
                ('<parent link="c"/>', '<parent link="calf"/>'),
                ('<mass value="2.4"/>', '<mass value="0"/>'),
                (
                    'ixx="0.02" iyy="0.02" izz="0.006"',
                    'ixx="0" iyy="0" izz="0"',
                ),
            ],
            "link 'calf' moves and weighs nothing",
        ),
        (
            [
                ('xyz="0.02 0 0.16"', 'xyz="0 0 0"'),
                (
                    'ixx="0.02" iyy="0.02" izz="0.006"',
                    'ixx="0" iyy="0" izz="0"',
                ),
            ],
            "joint 'motor': what it turns has no inertia",
        ),
        (
            [
                ('<mass value="2.4"/>', '<mass value="-2.4"/>'),
                (
                    'ixx="0.02" iyy="0.02" izz="0.006"',
                    'ixx="0" iyy="0" izz="0"',
                ),
            ],
            "link 'calf': has a mass of -2.4; give one above zero",
        ),
        (
            [('<mass value="2.4"/>', "")],  # Drake would take 1 kg
            "link 'calf': has moments of inertia but a mass of nothing",
        ),
        ([('type="revolute"', 'type="planar"')], "joint 'motor' is planar"),
        ([('"calf"', '"calf_shell"')], "rename the cuff"),
    ],
)
def test_devices_without_dynamics_are_refused(change, words):
    worn = replace(ANKLE, cuffs={"calf": CuffLinks("shank", "calf_shell")})
    own = worn if change[0][1] == '"calf_shell"' else ANKLE
    with pytest.raises(InputError, match=words):
        edited(own, *change).tree  # noqa: B018


@pytest.mark.parametrize("text", ["nan", "inf", "1e400", "none"])
@pytest.mark.parametrize("key", ["ixx", "iyy", "ixz"])
def test_inertias_that_are_no_numbers_are_refused(key, text):
    """As CAD writes them of what it has no material for."""
    told = {"ixx": "0.02", "iyy": "0.02", "izz": "0.006", "ixy": "0"}
    told |= {"ixz": "0", key: text}
    inertia = " ".join(f'{k}="{v}"' for k, v in told.items())
    old = 'ixx="0.02" iyy="0.02" izz="0.006" ixy="0" ixz="0"'
    with pytest.raises(
        InputError, match=f"link 'calf': {key} is '{text}'; give a number"
    ):
        edited(ANKLE, (old, inertia))


@pytest.mark.parametrize("wide", ["0.01", "0", "-0.01", "nan", "inf", "w"])
def test_a_shape_without_size_is_not_drawn(wide):
    """Drake would end the program where one is looked at."""
    model = edited(ANKLE, ("0.03 0.01 0.3", f"0.03 {wide} 0.3"))
    shapes = model.assembly.device.text.count("<visual")
    assert shapes == (wide == "0.01")
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    assert model.plant(plant).num_bodies() > 6


ROUND = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
PAD = f"""<robot name="r">
<link name="belt"><inertial><mass value="3"/>{ROUND}</inertial></link>
<link name="bar"><inertial><mass value="1"/>{ROUND}</inertial></link>
<link name="pad"><inertial><mass value="0.2"/>{ROUND}</inertial></link>
<joint name="motor" type="continuous"><parent link="belt"/><child link="bar"/>
<axis xyz="0 1 0"/></joint>
<joint name="pivot" type="continuous"><parent link="bar"/><child link="pad"/>
<origin xyz="0 0 -0.18"/><axis xyz="0 1 0"/></joint></robot>"""


def test_a_link_between_goes_with_the_segment_that_an_open_cuff_tells():
    """A pad hinged to a hip exoskeleton's bar: the motor turns, not it."""
    assembly = Assembly(
        device=DeviceFile({"belt": "pelvis"}, Path("pad.urdf")),
        cuffs={"thigh": CuffLinks("thigh", "pad")},
    )
    with pytest.raises(InputError, match="link 'bar' is neither welded nor"):
        _ = Model(brought_in(assembly, PAD), HUMAN).tree
    cuffs = assembly.cuffs | {"bar": CuffLinks("thigh", "bar", open=True)}
    assembly = replace(assembly, cuffs=cuffs)
    model = Model(brought_in(assembly, PAD), HUMAN)
    names = model.coordinates
    assert names.turned_by.tolist() == [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]
    assert [names.follows(joint) for joint in names.device] == ["hip", None]
    Device(hip=JointDrive(coulomb_nm=2.0)).check(names)
    with pytest.raises(InputError, match="joint; it has hip"):
        Device(ankle=JointDrive(coulomb_nm=2.0)).check(names)
    ankle = Device(ankle=JointDrive(viscous_nm_s=5.0))  # of another device
    moments = friction_moments(ankle, model.tree, np.ones((1, len(names))))
    np.testing.assert_array_equal(moments, [[0.0, 0.0]])
    bent = names.aligned(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]))
    ends = [
        model.tree.point_positions(bent, body, (0.0, 0.2))
        for body in model.tree.cuffs["thigh"]
    ]
    np.testing.assert_allclose(*ends, atol=1e-12)


def test_bars_without_straps_go_with_the_segments_of_open_cuffs():
    """From the foot up to the pelvis, joints on the person's: slack."""
    spans = HUMAN.shank.length_m, HUMAN.thigh.length_m
    links = ("shoe", "shank_bar", "thigh_bar", "belt")
    joint = (
        '<joint name="j{0}" type="continuous"><parent link="{1}"/>'
        '<child link="{2}"/><origin xyz="0 0 {3}"/><axis xyz="0 1 0"/></joint>'
    )
    text = "".join(
        f'<link name="{n}"><inertial><mass value="1"/>{ROUND}</inertial></link>'
        for n in links
    ) + "".join(
        joint.format(i, links[i], links[i + 1], height)
        for i, height in enumerate((0.0, *spans))
    )
    assembly = Assembly(
        device=DeviceFile({"shoe": "foot"}, Path("up.urdf")),
        cuffs={
            "waist": CuffLinks("pelvis", "belt"),
            "shank": CuffLinks("shank", "shank_bar", open=True),
            "thigh": CuffLinks("thigh", "thigh_bar", open=True),
        },
    )
    text = f'<robot name="r">{text}</robot>'
    names = Model(brought_in(assembly, text), HUMAN).coordinates
    assert names.turned_by.tolist() == np.diag([1.0, -1.0, 1.0]).tolist()


HALF = """<link name="shoe_{0}"><pose>0 0 0 {1}</pose>{3}</link>
<link name="calf_{0}"><pose relative_to="j_{0}"/>{3}</link>
<frame name="knee_{0}" attached_to="calf_{0}"/>
<joint name="j_{0}" type="revolute"><pose relative_to="shoe_{0}"/>
<parent>shoe_{0}</parent><child>knee_{0}</child>
<axis><xyz>0 {2} 0</xyz></axis></joint>"""


@pytest.mark.slow
def test_either_side_of_a_device_may_be_drawn_its_own_way():
    """Each half hangs from its own welded link; joints' ends are frames."""
    inertial = (
        "<inertial><pose>0.1 0 0.1 0 0 0</pose><mass>1</mass><inertia>"
        "<ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>"
    )
    found = []
    for turn in ("0 0 0", "0 0 3.14159265358979", "0 0 1.5707963267949"):
        text = HALF.format("left", "0 0 0", 1, inertial)
        text += HALF.format("right", turn, 1, inertial)
        sides = ("left", "right")
        assembly = Assembly(
            Person("two"),
            DeviceFile(
                {f"shoe_{s}": f"foot_{s}" for s in sides}, Path("h.sdf")
            ),
            {s: CuffLinks(f"shank_{s}", f"calf_{s}") for s in sides},
        )
        text = f'<sdf version="1.9"><model name="d">{text}</model></sdf>'
        tree = Model(brought_in(assembly, text), HUMAN).tree
        motion = np.random.default_rng(0).normal(
            size=(3, 4, tree.num_positions)
        )
        found.append(tree.inverse_dynamics(*motion))
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], atol=1e-9)


BAR = """<link name="bar"><inertial><mass>1</mass><inertia><ixx>0.1</ixx>
<iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>"""
HINGE = (
    '<joint name="j{0}" type="revolute"><parent>{0}</parent>'
    "<child>{1}</child><axis><xyz>0 1 0</xyz></axis></joint>"
)
CRANK = BAR + HINGE.format("shank", "bar")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (CRANK + HINGE.format("bar", "shoe"), "'jbar' closes a loop"),
        # As a four-bar is written in Drake's own SDF.
        (CRANK + "<drake:linear_bushing_rpy/>", "drake:linear_bushing_rpy hol"),
        (CRANK + "<drake:ball_constraint/>", "drake:ball_constraint holds lin"),
        (
            CRANK.replace("</axis>", '</axis><drake:mimic joint="motor"/>'),
            "'jshank' follows another one",
        ),
        # For which SDF has 1 kg and 1 kg m^2.
        (CRANK + '<link name="tag"/>', "'tag': has no mass or not all"),
        (CRANK.replace("<mass>1</mass>", ""), "'bar': has no mass or not all"),
        (CRANK.replace("<mass>1<", "<mass>inf<"), "'bar': mass is 'inf'; give"),
        ('<model name="e">' + BAR + "</model>", "models in one"),
    ],
)
def test_what_an_sdf_may_not_have_is_refused(more, words):
    text = SDF.replace("<sdf ", '<sdf xmlns:drake="http://drake.mit.edu" ')
    assembly = Assembly(device=DeviceFile({"shoe": "foot"}, Path("d.sdf")))
    with pytest.raises(InputError, match=words):
        brought_in(assembly, text.replace("</model>", more + "</model>"))


def test_what_drake_cannot_read_is_one_sentence(caplog):
    """It logs the same again; its lines are not those of the file."""
    assembly = Assembly(device=DeviceFile({"shoe": "foot"}, Path("d.sdf")))
    with pytest.raises(InputError) as caught:
        brought_in(assembly, SDF.replace(">0 1 0<", ">y<"))
    assert str(caught.value).startswith('d.sdf: /joint[@name="')
    assert str(caught.value).endswith("element <xyz>; correct it")
    with pytest.raises(
        InputError,
        match="urdf: Joint 'motor' has unrecognized type: 'pin'; correct it",
    ):
        edited(ANKLE, ('type="revolute"', 'type="pin"'))
    assert not caplog.records


def test_a_rotor_of_an_sdf_is_told_to_be_left_out():
    rotor = "<drake:rotor_inertia>1e-4</drake:rotor_inertia><axis>"
    text = SDF.replace("<sdf ", '<sdf xmlns:drake="http://drake.mit.edu" ')
    assembly = Assembly(device=DeviceFile({"shoe": "foot"}, Path("d.sdf")))
    device = brought_in(assembly, text.replace("<axis>", rotor)).device
    (note,) = device.notes
    assert "give them as device.joints.motor" in note
    assert "rotor_inertia" not in device.text


def test_dynamics_of_nothing_are_not_told():
    """Whatever a file is indented with."""
    none = "<axis><dynamics>\n\t<damping> 0.0 </damping>\n\t</dynamics>"
    assembly = Assembly(device=DeviceFile({"shoe": "foot"}, Path("d.sdf")))
    device = brought_in(assembly, SDF.replace("<axis>", none)).device
    assert device.notes == ()


def test_an_axis_that_is_left_out_is_the_format_s_own():
    turned = '<child link="calf"/><origin rpy="0 0 1.5707963267949"/>'
    model = edited(
        ANKLE, ('<child link="calf"/>', turned), ('<axis xyz="0 1 0"/>', "")
    )
    assert model.coordinates.turned_by.tolist() == [[1.0, 0.0, 0.0]]


def test_a_foot_with_hinged_toes_has_its_toe_sphere_on_them():
    found = schema.load_text(
        "{human: {legs: two, toes: hinged, trunk: rigid}, "
        "ground: {foot_right: [heel, ball, toe], foot_left: same}}",
        Assembly,
    )
    usual = Assembly(Person("two", "hinged"))
    assert built(found).soles == built(usual).soles
