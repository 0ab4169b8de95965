"""OpenSim models as they are read: numbers, functions, poses, refusals."""

import errno
from pathlib import Path

import numpy as np
import pytest
from osim_kinematics import Osim
from scipy.spatial.transform import Rotation
from small_osim import small_osim

from drake_exo.errors import InputError
from drake_exo.files import osim
from drake_exo.files.opensim import read_table, write_table
from drake_exo.files.osim import read_osim
from drake_exo.files.tables import Table


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
        ("<OpenSimDocument", "<Drawing", "is not XML"),
        ("<mass>9.7</mass>", "<mass>-1</mass>", "'pelvis' has a mass of -1"),
        ("<mass>9.7</mass>", "<mass>heavy</mass>", "is not a complete model"),
        ("<mass>9.7</mass>", "", "is not a complete model"),
        ("PolynomialFunction", "Sine", "'knee_r': has a Sine, which is not"),
        (
            "/bodyset/pelvis</socket_child_frame>",
            "/bodyset/belvis</socket_child_frame>",
            "its child 'belvis' is not a body",
        ),
        (
            "<socket_parent_frame>/ground<",
            "<socket_parent_frame>/bodyset/toes_r<",
            "hangs from nothing",
        ),
        (
            '<Coordinate name="pelvis_tilt"/>',
            "",
            "a PlanarJoint has 3 coordinates, but this one has 2",
        ),
        ("translation2", "translation1", "of rotation1, .*, translation3 once"),
        ('"rotation2"', '"turn2"', "of rotation1, .*, translation3 once"),
        ("</SpatialTransform>", "<TransformAxis/></SpatialTransform>", "once;"),
        ("<gravity>0 -9.80665 0", "<gravity>-9.8 0 0", "not along -y"),
        (">meters<", ">inches<", "lengths are in inches"),
        (
            '<MarkerSet name="markerset">',
            '<MarkerSet file="places.xml">',
            "its MarkerSet is in another file, 'places.xml'; put its <obj",
        ),
        (
            "</Model>",
            '<components><Body name="bag"/></components></Model>',
            "body 'bag' is not in the BodySet; put it there",
        ),
        (
            '"heel_l"><socket_parent_frame>/bodyset/calcn_l',
            '"heel_l"><socket_parent_frame>/bodyset/shoe',
            "marker 'heel_l' is on 'shoe', which is no body",
        ),
    ],
)
def test_what_cannot_be_read_is_said_in_a_sentence(tmp_path, old, new, words):
    text = small_osim("CustomJoint")
    assert old in text
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, text.replace(old, new))
    assert "\n" not in str(caught.value)


def test_axes_go_by_their_names_in_whatever_order(tmp_path):
    text = small_osim("CustomJoint").replace(">0</value>", ">0.3</value>")
    first, *others = text.split("<SpatialTransform>")
    swapped = []
    for part in others:
        inside, end = part.split("</SpatialTransform>")
        axes = inside.split("</TransformAxis>")[:-1]
        axes = "".join(f"{axis}</TransformAxis>" for axis in axes[::-1])
        swapped.append(f"{axes}</SpatialTransform>{end}")
    turned = read(tmp_path, "<SpatialTransform>".join([first, *swapped]))
    q = {"knee_angle_r": np.array([-0.7])}
    found, meant = turned.poses(q), read(tmp_path, text).poses(q)
    for part, own in zip(found["toes_r"], meant["toes_r"], strict=True):
        np.testing.assert_array_equal(part, own)


def without(text, *parts):
    for part in parts:
        assert part in text
        text = text.replace(part, "")
    return text


def test_what_opensim_does_not_write_is_its_default(tmp_path):
    """Zero centres and inertias, functions that are the coordinate."""
    text = small_osim("CustomJoint").replace("<scale>1.1<", "<scale>1<")
    text = text.replace("0.001 0.001 0.001 0 0 0", "0 0 0 0 0 0")
    told = read(tmp_path, text)
    left_out = without(
        text,
        "<mass_center>0 0 0</mass_center>",
        "<inertia>0 0 0 0 0 0</inertia>",
        "<scale>1</scale>",
        "<value>0</value>",
        "<orientation>0 0 0</orientation>",
        "<length_units>meters</length_units>",
    )
    linear = (
        '<LinearFunction name="function"><coefficients>1 0\n</coefficients>'
    )
    function = f"{linear}</LinearFunction>"
    q = {"knee_angle_r": np.array([-0.7])}
    for end in ("", function.replace("<coefficients>1 0\n</coefficients>", "")):
        assert function in left_out
        model = read(tmp_path, left_out.replace(function, end))
        for name, body in told.bodies.items():
            own = model.bodies[name]
            assert own.com_m.tolist() == body.com_m.tolist()
            assert own.inertia_kg_m2.tolist() == body.inertia_kg_m2.tolist()
        for found, meant in zip(
            model.poses(q)["toes_r"], told.poses(q)["toes_r"], strict=True
        ):
            np.testing.assert_array_equal(found, meant)
    bare = without(text, "<mass>9.7</mass>")
    with pytest.raises(InputError, match="is not a complete model"):
        read(tmp_path, bare)


def coupled(text, slope, value, enforced="true"):
    return text.replace(
        "</Model>",
        f"""<ConstraintSet><objects><CoordinateCouplerConstraint name="c">
        <isEnforced>{enforced}</isEnforced><coupled_coordinates_function>
        <LinearFunction><coefficients>{slope} {value}</coefficients>
        </LinearFunction></coupled_coordinates_function>
        <independent_coordinate_names>ankle_angle_r
        </independent_coordinate_names><dependent_coordinate_name>mtp_angle_r
        </dependent_coordinate_name></CoordinateCouplerConstraint></objects>
        </ConstraintSet></Model>""",
    )


def test_coordinates_rest_where_they_are_locked_or_coupled(tmp_path):
    ankle = '<Coordinate name="ankle_angle_r">'
    locked = f"{ankle}<default_value>0.3</default_value><locked>true</locked>"
    text = small_osim()
    plain = read(tmp_path, text)
    assert plain.rest == {}
    free = text.replace(ankle, locked.replace("true", "false"))
    assert read(tmp_path, free).rest == {}
    assert read(tmp_path, coupled(text, 2.0, 0.1, "false")).rest == {}
    model = read(tmp_path, coupled(text.replace(ankle, locked), 2.0, 0.1))
    assert model.rest == pytest.approx(
        {"ankle_angle_r": 0.3, "mtp_angle_r": 0.7}
    )
    q = {name: np.array([x]) for name, x in model.rest.items()}
    for found, meant in zip(
        model.poses()["toes_r"], plain.poses(q)["toes_r"], strict=True
    ):
        np.testing.assert_array_equal(found, meant)
    zero = {name: np.zeros(1) for name in model.rest}
    for found, meant in zip(
        model.poses(zero)["toes_r"], plain.poses()["toes_r"], strict=True
    ):
        np.testing.assert_array_equal(found, meant)
    point = plain.poses(q)["toes_r"][1]
    for found, meant in zip(
        model.motion("hip_flexion_r", "toes_r", point, {}, model.poses()),
        plain.motion("hip_flexion_r", "toes_r", point, q, plain.poses(q)),
        strict=True,
    ):
        np.testing.assert_array_equal(found, meant)


def test_lengths_between_bodies_rest_at_their_default(tmp_path):
    """A back that grows: at zero the torso would be in the pelvis."""
    text = small_osim()
    start = text.index('<WeldJoint name="back">')
    joint = text[start : text.index("</WeldJoint>", start)]
    slider = joint.replace("WeldJoint", "SliderJoint").replace(
        "<frames>",
        '<coordinates><Coordinate name="back_x"><default_value>0.07'
        "</default_value></Coordinate></coordinates><frames>",
    )
    text = text.replace(f"{joint}</WeldJoint>", f"{slider}</SliderJoint>")
    for name in ("tx", "ty", "tilt"):  # nobody stands at the ground's origin
        text = text.replace(
            f'<Coordinate name="pelvis_{name}"/>',
            f'<Coordinate name="pelvis_{name}"><default_value>0.9'
            "</default_value></Coordinate>",
        )
    model = read(tmp_path, text)
    assert model.rest == {"back_x": 0.07}
    place = model.poses()["torso"][1][0]
    np.testing.assert_allclose(place, [-0.1 + 0.07, 0.08, 0.0])


def test_markers_and_joints_may_be_on_frames_of_a_body(tmp_path):
    """A quarter turn about z: x of the frame is y of the body."""
    frame = """<components><PhysicalOffsetFrame name="imu"><socket_parent>..
    </socket_parent><translation>0.1 0.2 0</translation>
    <orientation>0 0 1.5707963267948966</orientation></PhysicalOffsetFrame>
    </components>"""
    text = small_osim().replace(
        '<Body name="torso">', f'<Body name="torso">{frame}'
    )
    marker = '<Marker name="shoulder_r"><socket_parent_frame>'
    text = text.replace(
        f"{marker}/bodyset/torso<", f"{marker}/bodyset/torso/imu<"
    )
    text = text.replace(
        "<socket_parent>/bodyset/torso<", "<socket_parent>/bodyset/torso/imu<"
    )
    marker = '<Marker name="elbow_r"><socket_parent_frame>'
    text = text.replace(
        f"{marker}/bodyset/humerus_r<",
        f"{marker}/jointset/shoulder_r/torso_offset<",
    )
    model = read(tmp_path, text)
    body, place = model.markers["shoulder_r"]
    assert body == "torso"
    np.testing.assert_allclose(place, [0.1 - 0.4, 0.2 - 0.02, 0.16])
    joint = model.joint_of("humerus_r")
    assert joint.parent == "torso"
    np.testing.assert_allclose(joint.X_PF.p, [0.1 - 0.36, 0.2, 0.17])
    body, place = model.markers["elbow_r"]
    assert body == "torso"
    np.testing.assert_allclose(place, [0.1 - 0.36 + 0.3, 0.2, 0.17 + 0.03])


def test_the_ground_may_have_frames(tmp_path):
    """A marker there is none of the person's; the pelvis moves from there."""
    ground = """<Ground name="ground"><components>
    <PhysicalOffsetFrame name="lab"><socket_parent>..</socket_parent>
    <translation>0.1 0.2 0</translation></PhysicalOffsetFrame></components>
    </Ground>"""
    text = small_osim().replace("<BodySet", f"{ground}<BodySet", 1)
    text = text.replace(
        "<socket_parent_frame>/ground<", "<socket_parent_frame>/ground/lab<"
    )
    marker = '<Marker name="elbow_r"><socket_parent_frame>'
    text = text.replace(f"{marker}/bodyset/humerus_r<", f"{marker}/ground/lab<")
    model = read(tmp_path, text)
    assert "elbow_r" not in model.markers
    assert model.joint_of("pelvis").parent == "ground"
    np.testing.assert_allclose(model.poses()["pelvis"][1][0], [0.1, 0.2, 0.0])


def test_a_line_of_several_pieces_goes_on_beyond_its_ends(tmp_path):
    text = small_osim("CustomJoint").replace(
        "SimmSpline>", "PiecewiseLinearFunction>"
    )
    axis = read(tmp_path, text).joint_of("tibia_r").translations[0]
    x, y = [-2, -1.2, -0.5, 0, 0.3], [-0.02, 0.004, 0.003, -0.001, -0.003]
    at = np.linspace(-2.0, 0.3, 24)
    np.testing.assert_allclose(
        axis.function(at, 0), 1.1 * np.interp(at, x, y), atol=1e-15
    )
    ends = np.array([-2.5, 0.6])
    slopes = 1.1 * np.array([0.024 / 0.8, -0.002 / 0.3])
    np.testing.assert_allclose(axis.function(ends, 1), slopes)
    np.testing.assert_allclose(
        axis.function(ends, 0),
        [-0.022 - 0.5 * slopes[0], -0.0033 + 0.3 * slopes[1]],
    )


def test_a_body_without_a_joint_is_named(tmp_path):
    text = small_osim()
    start = text.index('<WeldJoint name="shoulder_r"')
    end = text.index("</WeldJoint>", start) + len("</WeldJoint>")
    with pytest.raises(InputError, match="'humerus_r' hangs from no joint"):
        read(tmp_path, text[:start] + text[end:])


def test_joints_that_are_not_known_are_named(tmp_path):
    text = small_osim().replace("WeldJoint", "EllipsoidJoint")
    with pytest.raises(InputError, match="'back' is a EllipsoidJoint"):
        read(tmp_path, text)
    with pytest.raises(InputError, match="holds no OpenSim model"):
        read(tmp_path, "<robot/>")
    with pytest.raises(InputError, match="cannot be read"):
        read_osim(tmp_path / "missing.osim")


@pytest.mark.slow
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


@pytest.mark.parametrize("n", [2, 3, 4, 5, 7])
def test_a_spline_through_points_of_a_polynomial_is_that_polynomial(n):
    """Of third degree; through three points second, through two a line."""
    rng = np.random.default_rng(n)
    x = np.cumsum(rng.uniform(0.2, 1.5, n)) - 2.0
    curve = np.polynomial.Polynomial(rng.normal(size=min(n, 4)))
    spline = osim._simm_spline(x, curve(x))
    at = np.linspace(x[0], x[-1], 40)
    for order in (0, 1):
        expected = curve.deriv(order)(at) if order else curve(at)
        np.testing.assert_allclose(spline(at, order), expected, atol=1e-10)
    for end, step in ((x[0], -1.5), (x[-1], 1.5)):
        rate = curve.deriv()(end)
        beyond = np.array([end + step])
        assert spline(beyond, 0) == pytest.approx(curve(end) + step * rate)
        assert spline(beyond, 1) == pytest.approx(rate)


@pytest.mark.parametrize("knee", ["PinJoint", "CustomJoint"])
def test_motions_are_how_poses_change(tmp_path, knee):
    """Turn of a body and motion of a point, by differences."""
    text = small_osim(knee).replace(
        "<orientation>0 0 0</orientation>",
        "<orientation>0.2 -0.3 0.4</orientation>",
    )
    model = read(tmp_path, text)
    rng = np.random.default_rng(3)
    names = [c for joint in model.joints for c in joint.coordinates]
    n, h = 4, 1e-6
    q = {name: rng.uniform(-0.7, 0.7, n) for name in names}
    poses, place = model.poses(q, n), np.array([0.03, -0.05, 0.02])
    for body in ("torso", "toes_r", "tibia_l"):
        R, p = poses[body]
        point = p + R @ place
        for name in names:
            turn, motion = model.motion(name, body, point, q, poses)
            (R_a, p_a), (R_b, p_b) = (
                model.poses(q | {name: q[name] + s * h}, n)[body]
                for s in (1.0, -1.0)
            )
            moved = (p_a + R_a @ place - p_b - R_b @ place) / (2 * h)
            np.testing.assert_allclose(motion, moved, atol=1e-8)
            spin = (R_a - R_b) @ np.swapaxes(R, 1, 2) / (2 * h)
            turned = spin[:, [2, 0, 1], [1, 2, 0]]
            np.testing.assert_allclose(turn, turned, atol=1e-8)


def placed(tmp_path, kind, values):
    """A joint of a kind at values of its coordinates: R, p of its child."""
    coordinates = "".join(
        f'<Coordinate name="c{i}"/>' for i in range(len(values))
    )
    (tmp_path / "j.osim").write_text(
        f"""<OpenSimDocument Version="40000"><Model><BodySet><objects>
        <Body name="a"><mass>1</mass><mass_center>0 0 0</mass_center>
        <inertia>1 1 1 0 0 0</inertia></Body></objects></BodySet>
        <JointSet><objects><{kind} name="j">
        <socket_parent_frame>/ground</socket_parent_frame>
        <socket_child_frame>/bodyset/a</socket_child_frame>
        <coordinates>{coordinates}</coordinates></{kind}></objects></JointSet>
        </Model></OpenSimDocument>"""
    )
    model = read_osim(tmp_path / "j.osim")
    assert model.joints[0].ranges == ((-np.pi, np.pi),) * len(values)
    q = {f"c{i}": np.array([x]) for i, x in enumerate(values)}
    R, p = model.poses(q)["a"]
    return R[0], p[0].tolist()


def test_joints_turn_and_move_as_their_kind_says(tmp_path):
    def turn(axes, *angles):
        # One angle in a list is a list of rotations to older SciPy.
        return Rotation.from_euler(axes, angles).as_matrix().reshape(3, 3)

    a, b, c = 0.3, -0.5, 0.8
    for kind, values, R, p in (
        ("WeldJoint", (), np.eye(3), [0, 0, 0]),
        ("PinJoint", (a,), turn("Z", a), [0, 0, 0]),
        ("SliderJoint", (a,), np.eye(3), [a, 0, 0]),
        ("UniversalJoint", (a, b), turn("XY", a, b), [0, 0, 0]),
        ("GimbalJoint", (a, b, c), turn("XYZ", a, b, c), [0, 0, 0]),
        ("BallJoint", (a, b, c), turn("XYZ", a, b, c), [0, 0, 0]),
        ("PlanarJoint", (a, 1.0, 2.0), turn("Z", a), [1, 2, 0]),
        ("FreeJoint", (a, b, c, 1.0, 2.0, 3.0), turn("XYZ", a, b, c),
         [1, 2, 3]),
    ):  # fmt: skip
        found, place = placed(tmp_path, kind, values)
        np.testing.assert_allclose(found, R, atol=1e-15)
        assert place == p


def test_elements_that_are_written_are_read_as_they_were_meant(tmp_path):
    """A body that hangs from another by frames that lean."""
    (tmp_path / "m.osim").write_text(small_osim())
    file = osim.OsimFile(tmp_path / "m.osim")
    A = np.random.default_rng(0).normal(size=(3, 3))
    inertia = A @ A.T
    file.add("BodySet", osim.body("bar", 1.5, [0.1, -0.2, 0.3], inertia))
    R = [
        Rotation.from_rotvec(v).as_matrix()
        for v in ((0.3, -0.2, 0.5), (-0.1, 0.7, 0.2))
    ]
    ends = osim.Pose(R[0], [0.1, 0.2, 0.3]), osim.Pose(R[1], [0.0, -0.4, 0.1])
    pin = osim.joint("hinge", "turn", ("femur_r", ends[0]), ("bar", ends[1]))
    file.add("JointSet", pin)
    file.write(tmp_path / "n.osim")
    model = read_osim(tmp_path / "n.osim")
    bar, joint = model.bodies["bar"], model.joint_of("bar")
    assert bar.mass_kg == 1.5 and bar.com_m.tolist() == [0.1, -0.2, 0.3]
    np.testing.assert_allclose(bar.inertia_kg_m2, inertia)
    assert (joint.parent, joint.coordinates) == ("femur_r", ("turn",))
    for found, meant in ((joint.X_PF, ends[0]), (joint.X_CM, ends[1])):
        np.testing.assert_allclose(found.R, meant.R, atol=1e-12)
        np.testing.assert_allclose(found.p, meant.p)
    # The frames are one where the joint is at zero.
    poses = model.poses()
    for frame in (
        poses["femur_r"][0][0] @ R[0] - poses["bar"][0][0] @ R[1],
        poses["femur_r"][1][0] + poses["femur_r"][0][0] @ ends[0].p
        - poses["bar"][1][0] - poses["bar"][0][0] @ ends[1].p,
    ):  # fmt: skip
        np.testing.assert_allclose(frame, 0.0, atol=1e-12)


def test_a_full_disk_keeps_the_model_that_was_there(tmp_path, monkeypatch):
    (tmp_path / "m.osim").write_text(small_osim())
    file = osim.OsimFile(tmp_path / "m.osim")
    written = Path.write_bytes

    def full(path, data):
        written(path, data[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        file.write(tmp_path / "m.osim")
    assert (tmp_path / "m.osim").read_text() == small_osim()
    assert [p.name for p in tmp_path.iterdir()] == ["m.osim"]
    monkeypatch.undo()
    file.write(tmp_path / "m.osim")
    assert read_osim(tmp_path / "m.osim").bodies.keys() >= {"torso"}


@pytest.mark.parametrize("states", [False, True])
def test_coordinates_of_a_file_move_markers(tmp_path, states):
    """Angles in degrees, places in metres; speeds are none."""
    model = read(tmp_path, small_osim())
    time = np.arange(5) / 100.0
    names = [n for joint in model.joints for n in joint.coordinates]
    q = {n: 0.01 * k + 0.1 * time for k, n in enumerate(names)}
    turning = {a.coordinate for joint in model.joints for a in joint.turns}
    values = [np.rad2deg(q[n]) if n in turning else q[n] for n in names]
    columns = [f"/jointset/a/{n}/value" if states else n for n in names]
    if states:
        columns += [f"/jointset/a/{n}/speed" for n in names]
        values += [np.full(5, 7.0)] * len(names)
    table = Table(time, tuple(columns), np.column_stack(values), True)
    write_table(tmp_path / "ik.mot", table, digits=17)
    found = model.markers_along(read_table(tmp_path / "ik.mot"))
    assert found.names == tuple(model.markers)
    assert found.rate_hz == pytest.approx(100.0)
    poses = model.poses(q, 5)
    for name, (body, place) in model.markers.items():
        R, p = poses[body]
        np.testing.assert_allclose(
            found.of([name])[:, 0], p + R @ place, atol=1e-12
        )
    # As plates, whose header says nothing of angles.
    lacking = Table(time, ("pelvis_tilt",), np.zeros((5, 1)), None, "ik.mot")
    with pytest.raises(InputError, match=r"ik\.mot: has no column for coord"):
        model.markers_along(lacking)
