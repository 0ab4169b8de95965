"""OpenSim models as they are read: numbers, functions, poses, refusals."""

import numpy as np
import pytest
from osim_kinematics import Osim
from small_osim import small_osim

from drake_exo.errors import InputError
from drake_exo.files.osim import read_osim


def read(tmp_path, text):
    (tmp_path / "m.osim").write_text(text)
    return read_osim(tmp_path / "m.osim")


def test_numbers_are_those_of_the_file(tmp_path):
    model = read(tmp_path, small_osim())
    assert model.mass_kg == pytest.approx(37.0 + 2 * 14.0)
    assert model.gravity_m_s2 == 9.80665
    torso = model.bodies["torso"]
    assert torso.com_m.tolist() == [-0.03, 0.31, 0.0]
    assert torso.inertia_kg_m2[0].tolist() == [1.2, 0.02, 0.0]
    assert model.markers["heel_l"][0] == "calcn_l"
    assert model.joint_of("femur_l").X_PF.p.tolist() == [-0.06, -0.07, -0.08]
    assert model.joint_of("femur_l").coordinates == ("hip_flexion_l",)


def test_a_leg_hangs_where_its_joints_put_it(tmp_path):
    model = read(tmp_path, small_osim("CustomJoint"))
    tilt, hip, knee = 0.2, 0.5, -0.9
    q = {"pelvis_tilt": tilt, "hip_flexion_r": hip, "knee_angle_r": knee}
    q |= {"pelvis_tx": 1.0, "pelvis_ty": 0.9}
    poses = model.poses({k: np.array([x]) for k, x in q.items()})

    def turn(angle):
        return np.exp(1j * angle)

    at_hip = 1.0 + 0.9j + turn(tilt) * (-0.06 - 0.07j)
    across = model.joint_of("tibia_r").translations[0].function(knee, 0)
    slide = complex(across, 0.004 * knee**2 + 0.001 * knee - 0.002)
    at_knee = at_hip + turn(tilt + hip) * (-0.004 - 0.40j + slide)
    at_ankle = at_knee + turn(tilt + hip + knee) * (0.002 - 0.42j)
    x, y, z = poses["talus_r"][1][0]
    assert complex(x, y) == pytest.approx(at_ankle, abs=1e-12)
    assert z == pytest.approx(0.08)


# At the places below, by OpenSim 4.6.
SPLINE = (
    -0.04811363279046324,
    -0.006430601989290569,
    0.00476477857796838,
    -0.00020804594512110553,
    -0.0024237845536350102,
    -0.004550112365785312,
)


def test_splines_are_opensims(tmp_path):
    model = read(tmp_path, small_osim("CustomJoint"))
    axis = model.joint_of("tibia_r").translations[0]
    at = np.array([-2.5, -1.7, -0.8, -0.1, 0.2, 0.6])
    found = axis.function(at, 0) / 1.1
    np.testing.assert_allclose(found, SPLINE, atol=1e-13)
    h = 1e-6
    slope = (axis.function(at + h, 0) - axis.function(at - h, 0)) / (2.0 * h)
    np.testing.assert_allclose(axis.function(at, 1), slope, atol=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('Version="40000"', 'Version="30000"', "of OpenSim 30000; open it"),
        ("<OpenSimDocument", "<Drawing", "is no XML"),
        ("<mass>9.7</mass>", "<mass>-1</mass>", "'pelvis' has a mass of -1"),
        ("<mass>9.7</mass>", "<mass>heavy</mass>", "is no complete model"),
        ("<mass>9.7</mass>", "", "is no complete model"),
        ("PolynomialFunction", "Sine", "'knee_r': has a Sine, which is not"),
        (
            "/bodyset/pelvis</socket_child_frame>",
            "/bodyset/belvis</socket_child_frame>",
            "its child 'belvis' is no body",
        ),
        (
            "<socket_parent_frame>/ground<",
            "<socket_parent_frame>/bodyset/toes_r<",
            "hangs from nothing",
        ),
        ("<gravity>0 -9.80665 0", "<gravity>-9.8 0 0", "not along -y"),
        (">meters<", ">inches<", "lengths are in inches"),
    ],
)
def test_what_cannot_be_read_is_said_in_a_sentence(tmp_path, old, new, words):
    text = small_osim("CustomJoint")
    assert old in text
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, text.replace(old, new))
    assert "\n" not in str(caught.value)


def test_joints_that_are_not_known_are_named(tmp_path):
    text = small_osim().replace("WeldJoint", "EllipsoidJoint")
    with pytest.raises(InputError, match="'back' is a EllipsoidJoint"):
        read(tmp_path, text)
    with pytest.raises(InputError, match="holds no OpenSim model"):
        read(tmp_path, "<robot/>")
    with pytest.raises(InputError, match="cannot be read"):
        read_osim(tmp_path / "missing.osim")


def test_poses_of_a_real_model_are_those_of_another_reader(data_root):
    path = data_root / (
        "opencap_subject4/Models/optimized_scale_and_markers.osim"
    )
    rng = np.random.default_rng(0)
    model = read_osim(path)
    names = [c for joint in model.joints for c in joint.coordinates]
    q = {name: rng.uniform(-0.6, 0.6, 5) for name in names}
    own, other = model.poses(q, 5), Osim(path).poses(q)
    for body in set(other) - {"patella_r", "patella_l"}:
        for found, expected in zip(own[body], other[body], strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)
