import base64
import re

import numpy as np
import pytest
import umsgpack

from drake_exo.report.pictures import SEATED_DEG, upright_pose
from drake_exo.report.replay import ForceTrace, save_replay
from drake_exo.report.scene import Scene

TIME = np.linspace(2.0, 3.0, 101)


@pytest.fixture(scope="module")
def motion():
    seated = upright_pose(Scene("coupled"), SEATED_DEG)
    return np.linspace(seated, np.r_[seated[:3], np.zeros(6)], len(TIME))


def force(name="ground", size_n=600.0):
    ramp = np.linspace(0.0, 1.0, len(TIME))
    return ForceTrace(
        name,
        point_m=np.column_stack([0.05 + 0.1 * ramp, 0.0 * ramp]),
        force_n=np.column_stack([0.0 * ramp, size_n * ramp]),
    )


def recorded(page):
    """Frames and values of each animated property, by path and name."""
    tracks = {}
    for blob in re.findall(r'base64,([A-Za-z0-9+/=]+)"', page.read_text()):
        try:
            command = umsgpack.unpackb(base64.b64decode(blob))
        except umsgpack.UnpackException:
            continue  # a mesh or the viewer itself
        if isinstance(command, dict) and command["type"] == "set_animation":
            for item in command["animations"]:
                for track in item["clip"]["tracks"]:
                    keys = track["keys"]
                    tracks[item["path"], track["name"]] = (
                        np.array([key["time"] for key in keys]),
                        np.array([key["value"] for key in keys]),
                    )
    return tracks


def test_arrow_follows_the_force(tmp_path, motion):
    page = tmp_path / "replay.html"
    save_replay(
        page,
        TIME,
        motion,
        forces=[force()],
        metres_per_newton=1e-3,
        frames_per_second=20.0,
        smallest_n=100.0,
    )
    tracks = recorded(page)
    frame, visible = tracks["/forces/ground", ".visible"]
    np.testing.assert_array_equal(frame, np.arange(21))
    np.testing.assert_array_equal(visible, 600.0 * frame / 20 >= 100.0)
    frame, scale = tracks["/forces/ground/shaft", ".scale"]
    head = tracks["/forces/ground/head", ".position"][1][:, 2]
    # Tip of the arrow: 1 mm for each newton.
    np.testing.assert_allclose(head, 0.6 * frame / 20, atol=1e-12)
    np.testing.assert_allclose(scale[:, 2], head - 0.06, atol=1e-12)
    at = tracks["/forces/ground", ".position"][1]
    np.testing.assert_allclose(at[:, 0], 0.05 + 0.1 * frame / 20)


def test_model_moves_as_told(tmp_path, motion):
    page = tmp_path / "replay.html"
    save_replay(page, TIME, motion, frames_per_second=10.0)
    (path,) = {
        path for path, _ in recorded(page) if path.endswith("human/pelvis")
    }
    frame, position = recorded(page)[path, ".position"]
    scene = Scene("coupled")
    context = scene.plant.CreateDefaultContext()
    pelvis = scene.plant.GetBodyByName("pelvis")
    for k, p in zip(frame, position, strict=True):
        scene.plant.SetPositions(context, motion[10 * k])
        expected = scene.plant.EvalBodyPoseInWorld(context, pelvis)
        np.testing.assert_allclose(p, expected.translation(), atol=1e-9)
    assert position[-1][2] > position[0][2] + 0.2


def test_replay_is_small_and_repeats_itself(tmp_path, motion):
    for name in ("a", "b"):
        save_replay(
            tmp_path / f"{name}.html",
            TIME,
            motion,
            forces=[force("ground"), force("chair")],
            frames_per_second=60.0,
            chair_height_m=0.43,
        )
    page = (tmp_path / "a.html").read_bytes()
    assert page == (tmp_path / "b.html").read_bytes()
    assert len(page) < 20e6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time_s": TIME[::-1]}, "increasing"),
        ({"time_s": TIME[:-1]}, "100 times"),
        ({"q": np.full((101, 9), np.nan)}, "NaN"),
        ({"forces": [force(), force()]}, "names"),
        ({"forces": [force(size_n=np.nan)]}, "'ground'"),
    ],
)
def test_wrong_motion_is_refused(tmp_path, motion, change, words):
    arguments = {"time_s": TIME, "q": motion, **change}
    with pytest.raises(ValueError, match=words):
        save_replay(tmp_path / "replay.html", **arguments)
    assert not (tmp_path / "replay.html").exists()
