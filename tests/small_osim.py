"""A small OpenSim model, written out: the whole format with made-up numbers."""

import numpy as np
from scipy.spatial.transform import Rotation

# body: mass, centre, inertia about it (xx yy zz xy xz yz)
_BODIES = {
    "pelvis": "9.7 | -0.07 0.01 0 | 0.09 0.08 0.05 0 0 0",
    "torso": "27.3 | -0.03 0.31 0 | 1.2 0.6 1.3 0.02 0 0",
    "humerus_{s}": "1.7 | 0 -0.17 0 | 0.012 0.003 0.012 0 0 0",
    "femur_{s}": "7.6 | 0.005 -0.17 0 | 0.11 0.03 0.12 0 0 0",
    "tibia_{s}": "3.2 | 0 -0.19 0 | 0.05 0.004 0.051 0 0 0",
    "talus_{s}": "0.1 | 0 0 0 | 0.001 0.001 0.001 0 0 0",
    "calcn_{s}": "1.2 | 0.1 0.03 0 | 0.0014 0.004 0.0043 0 0 0",
    "toes_{s}": "0.2 | 0.035 0.006 0 | 0.0001 0.0002 0.0003 0 0 0",
}
# joint: kind, parent, place, child
_JOINTS = {
    "hip_{s}": "PinJoint | pelvis | -0.06 -0.07 {w}0.08 | femur_{s}",
    "knee_{s}": "{knee} | femur_{s} | -0.004 -0.40 0 | tibia_{s}",
    "ankle_{s}": "PinJoint | tibia_{s} | 0.002 -0.42 0 | talus_{s}",
    "subtalar_{s}": "WeldJoint | talus_{s} | -0.05 -0.045 {w}0.01 | calcn_{s}",
    "mtp_{s}": "PinJoint | calcn_{s} | 0.18 -0.002 0 | toes_{s}",
    "shoulder_{s}": "WeldJoint | torso | 0 0.36 {w}0.17 | humerus_{s}",
}
_COORDINATES = {
    "hip": "hip_flexion",
    "knee": "knee_angle",
    "ankle": "ankle_angle",
    "mtp": "mtp_angle",
}
_MARKERS = {
    "ASIS_{s}": "pelvis | 0.02 0.02 {w}0.12",
    "PSIS_{s}": "pelvis | -0.17 0.03 {w}0.05",
    "shoulder_{s}": "torso | -0.02 0.4 {w}0.16",
    "elbow_{s}": "humerus_{s} | 0 -0.3 {w}0.03",
    "thigh1_{s}": "femur_{s} | 0.06 -0.15 {w}0.08",
    "thigh2_{s}": "femur_{s} | -0.04 -0.24 {w}0.08",
    "knee_{s}": "femur_{s} | 0 -0.40 {w}0.05",
    "shank1_{s}": "tibia_{s} | 0.04 -0.1 {w}0.04",
    "shank2_{s}": "tibia_{s} | -0.03 -0.2 {w}0.06",
    "ankle_{s}": "tibia_{s} | 0 -0.42 {w}0.04",
    "heel_{s}": "calcn_{s} | -0.02 0.02 0",
    "meta_{s}": "calcn_{s} | 0.15 0 {w}0.05",
    "toe1_{s}": "toes_{s} | 0.04 0.02 0",
    "toe2_{s}": "toes_{s} | 0.03 -0.01 {w}0.03",
}
_KNEE = """<SpatialTransform>
<TransformAxis name="rotation1"><coordinates>knee_angle_{s}</coordinates>
<axis>0 0 1</axis><LinearFunction name="function"><coefficients>1 0
</coefficients></LinearFunction></TransformAxis>
<TransformAxis name="rotation2"><coordinates/><axis>0 1 0</axis>
<Constant name="function"><value>0</value></Constant></TransformAxis>
<TransformAxis name="rotation3"><coordinates/><axis>1 0 0</axis>
<Constant name="function"><value>0</value></Constant></TransformAxis>
<TransformAxis name="translation1"><coordinates>knee_angle_{s}</coordinates>
<axis>1 0 0</axis><MultiplierFunction name="function"><function>
<SimmSpline><x>-2 -1.2 -0.5 0 0.3</x><y>-0.02 0.004 0.003 -0.001 -0.003</y>
</SimmSpline></function><scale>1.1</scale></MultiplierFunction></TransformAxis>
<TransformAxis name="translation2"><coordinates>knee_angle_{s}</coordinates>
<axis>0 1 0</axis><PolynomialFunction name="function"><coefficients>0.004 0.001
-0.002</coefficients></PolynomialFunction></TransformAxis>
<TransformAxis name="translation3"><coordinates/><axis>0 0 1</axis>
<Constant name="function"><value>0</value></Constant></TransformAxis>
</SpatialTransform>"""


def _sided(table):
    for name, text in table.items():
        if "{s}" not in name:
            yield name, text
            continue
        for s, w in (("r", ""), ("l", "-")):
            yield (
                name.replace("{s}", s),
                text.replace("{s}", s).replace("{w}", w),
            )


def _joint(name, kind, parent, place, child, knee=""):
    joint, _, side = name.partition("_")
    coordinate, coordinates = _COORDINATES.get(joint), ""
    if coordinate:
        coordinates = (
            f'<coordinates><Coordinate name="{coordinate}_{side}">'
            "<range>-2 2</range></Coordinate></coordinates>"
        )
    return f"""<{kind} name="{name}">
<socket_parent_frame>{parent}_offset</socket_parent_frame>
<socket_child_frame>{child}_offset</socket_child_frame>
{coordinates}<frames><PhysicalOffsetFrame name="{parent}_offset">
<socket_parent>/bodyset/{parent}</socket_parent>
<translation>{place}</translation><orientation>0 0 0</orientation>
</PhysicalOffsetFrame><PhysicalOffsetFrame name="{child}_offset">
<socket_parent>/bodyset/{child}</socket_parent>
<translation>0 0 0</translation><orientation>0 0 0</orientation>
</PhysicalOffsetFrame></frames>{knee}</{kind}>"""


def small_osim(knee: str = "PinJoint") -> str:
    """Text of the model.

    Args:
        knee: "PinJoint", or "CustomJoint" for knees that slide.
    """
    bodies = []
    for name, text in _sided(_BODIES):
        mass, com, inertia = text.split(" | ")
        bodies.append(
            f'<Body name="{name}"><mass>{mass}</mass><mass_center>{com}'
            f"</mass_center><inertia>{inertia}</inertia></Body>"
        )
    joints = [
        """<PlanarJoint name="ground_pelvis">
<socket_parent_frame>/ground</socket_parent_frame>
<socket_child_frame>/bodyset/pelvis</socket_child_frame>
<coordinates><Coordinate name="pelvis_tilt"/><Coordinate name="pelvis_tx"/>
<Coordinate name="pelvis_ty"/></coordinates></PlanarJoint>""",
        _joint("back", "WeldJoint", "pelvis", "-0.1 0.08 0", "torso"),
    ]
    for name, text in _sided(_JOINTS):
        kind, *rest = text.split(" | ")
        kind = kind.replace("{knee}", knee)
        slides = ""
        if kind == "CustomJoint":
            slides = _KNEE.replace("{s}", name[-1])
        joints.append(_joint(name, kind, *rest, knee=slides))
    markers = [
        f'<Marker name="{name}"><socket_parent_frame>/bodyset/'
        f"{text.split(' | ')[0]}</socket_parent_frame>"
        f"<location>{text.split(' | ')[1]}</location></Marker>"
        for name, text in _sided(_MARKERS)
    ]
    return f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000"><Model name="small">
<gravity>0 -9.80665 0</gravity><length_units>meters</length_units>
<BodySet name="bodyset"><objects>{"".join(bodies)}</objects></BodySet>
<JointSet name="jointset"><objects>{"".join(joints)}</objects></JointSet>
<ForceSet name="forceset"><objects/></ForceSet>
<MarkerSet name="markerset"><objects>{"".join(markers)}</objects></MarkerSet>
</Model></OpenSimDocument>
"""


def in_axes_of(R, text):
    """The small model, its pelvis described in axes turned by R (3, 3)."""

    def turned(numbers):
        return " ".join(map(repr, (R.T @ np.array(numbers, float)).tolist()))

    for old in ("-0.07 0.01 0", "0.02 0.02 0.12", "0.02 0.02 -0.12",
                "-0.17 0.03 0.05", "-0.17 0.03 -0.05"):  # fmt: skip
        assert old in text
        text = text.replace(f">{old}<", f">{turned(old.split())}<")
    A = R.T @ np.diag([0.09, 0.08, 0.05]) @ R
    pairs = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
    six = " ".join(repr(float(A[pair])) for pair in pairs)
    text = text.replace("0.09 0.08 0.05 0 0 0", six)
    angles = Rotation.from_matrix(R.T).as_euler("XYZ")
    lean = f"<orientation>{' '.join(map(repr, angles.tolist()))}</orientation>"
    zero = "<orientation>0 0 0</orientation>"
    parts = text.split('<PhysicalOffsetFrame name="pelvis_offset">')
    for k, part in enumerate(parts[1:], 1):
        place, rest = part.split("</translation>", 1)
        start, numbers = place.split("<translation>")
        parts[k] = (
            f"{start}<translation>{turned(numbers.split())}</translation>"
            f"{rest.replace(zero, lean, 1)}"
        )
    text = '<PhysicalOffsetFrame name="pelvis_offset">'.join(parts)
    child = "<socket_child_frame>/bodyset/pelvis</socket_child_frame>"
    assert child in text
    frame = f"""<socket_child_frame>pelvis_child</socket_child_frame><frames>
    <PhysicalOffsetFrame name="pelvis_child"><socket_parent>/bodyset/pelvis
    </socket_parent>{lean}</PhysicalOffsetFrame></frames>"""
    return text.replace(child, frame)
