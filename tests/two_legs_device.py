"""A device of the user's own with two legs, strapped to thighs and shanks."""

_LINK = """<link name="{}"><inertial><origin xyz="0 0 {}"/>
<mass value="{}"/><inertia ixx="0.03" iyy="0.03" izz="0.03" ixy="0" ixz="0"
iyz="0"/></inertial></link>"""
_JOINT = """<joint name="{}" type="revolute"><parent link="{}"/>
<child link="{}"/><origin xyz="0 0 {}"/><axis xyz="0 {} 0"/>
<limit lower="-3" upper="3" effort="100" velocity="10"/></joint>"""
CUFFS = "".join(
    f"  {part}_{side}: {{human: {part}_{side}, device: {part}_bar_{side}}}\n"
    for side in ("left", "right")
    for part in ("thigh", "shank")
)


def device():
    """A belt with a thigh and a shank bar on either side, as URDF."""
    parts = [_LINK.format("belt", 0.05, 4.0)]
    for side in ("left", "right"):
        thigh, shank = f"thigh_bar_{side}", f"shank_bar_{side}"
        parts += [
            _LINK.format(thigh, -0.2, 1.8),
            _LINK.format(shank, -0.15, 1.0),
            _JOINT.format(f"{side}_hip", "belt", thigh, 0.0, -1),
            _JOINT.format(f"{side}_knee", thigh, shank, -0.42, 1),
        ]
    return f'<robot name="hip_and_knee">{"".join(parts)}</robot>'


def write(folder):
    """Write its file, and beside it what a study's `model` says; that path."""
    (folder / "hip_and_knee.urdf").write_text(device())
    path = folder / "worn.yaml"
    path.write_text(
        "human: {legs: two}\n"
        "device: {file: hip_and_knee.urdf, weld: {belt: pelvis}}\n"
        f"cuffs:\n{CUFFS}"
    )
    return path
