import numpy as np
import pytest

from drake_exo.model.description import fit_exoskeleton
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import scale_human
from drake_exo.report import scene
from drake_exo.report.scene import (
    HALFWAY_DEG,
    STANDING_DEG,
    Scene,
    write_page,
    write_png,
)


def height_of(scene, q, frame):
    plant = scene.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    pose = plant.GetFrameByName(frame).CalcPoseInWorld(context)
    return pose.translation()[2]


@pytest.mark.parametrize(
    ("kind", "sole"), [("human", "sole"), ("coupled", "plate")]
)
def test_upright_pose_stands_on_the_ground(kind, sole):
    human = scale_human(55.0, 1.60, "female")
    device = fit_exoskeleton(human) if kind == "coupled" else None
    scene = Scene(Model(kind, human, device))
    q = scene.upright_pose(HALFWAY_DEG)
    assert height_of(scene, q, f"{sole}_heel") == pytest.approx(0.0)
    assert height_of(scene, q, f"{sole}_toe") == pytest.approx(0.0)
    assert np.degrees(q[3:6]) == pytest.approx(HALFWAY_DEG)


def test_exoskeleton_may_stand_off_the_human():
    scene = Scene(nominal_model())
    q = scene.upright_pose(HALFWAY_DEG, (1.0, -2.0, 3.0))
    assert np.degrees(q[6:] - q[3:6]) == pytest.approx([1.0, -2.0, 3.0])


def test_picture_shows_a_subject_of_the_right_height():
    """Rows that hold colour (shirt, skin) span what the camera sees."""
    scene = Scene(nominal_model("human"), stills=True)
    picture = scene.render(
        scene.upright_pose(STANDING_DEG), width=120, height=160
    )
    assert picture.shape == (160, 120, 3)
    coloured = np.ptp(picture.astype(int), axis=2) > 40
    rows = np.flatnonzero(coloured.any(axis=1))
    assert 0.5 * 160 < np.ptp(rows) < 0.9 * 160
    assert (picture[0] == 255).all()  # white above the head


def test_picture_is_written_as_png(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((4, 6, 3), dtype=np.uint8))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_page_is_small_and_repeats_itself(tmp_path):
    for name in ("a", "b"):
        path = tmp_path / f"{name}.html"
        write_page(path, nominal_model(), chair_height_m=0.43)
    page = (tmp_path / "a.html").read_bytes()
    assert page == (tmp_path / "b.html").read_bytes()
    assert 1e6 < len(page) < 20e6


def test_pose_of_another_plant_is_refused():
    with pytest.raises(ValueError, match="6 positions"):
        Scene(nominal_model("rigid")).set_pose(np.zeros(9))


def test_a_stool_stands_on_the_floor_under_its_seat():
    parts = scene._stool(0.45)
    seat, place, _ = parts.pop("seat")
    under = place[2] - 0.5 * seat.height()
    assert under + seat.height() == pytest.approx(0.45)
    assert len({tuple(p[:2]) for _, p, _ in parts.values()}) == 4
    for leg, (_, _, z), _ in parts.values():
        assert z - 0.5 * leg.length() == pytest.approx(0.0)
        assert z + 0.5 * leg.length() == pytest.approx(under)
