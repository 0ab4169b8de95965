from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from egl import draws

from drake_exo.errors import InputError
from drake_exo.model.assembly import Assembly, CuffLinks, DeviceFile, Person
from drake_exo.model.description import (
    fit_exoskeleton,
    models_path,
    nominal_human,
)
from drake_exo.model.device_file import with_text
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import scale_human
from drake_exo.report import scene
from drake_exo.report.scene import Scene

HALFWAY_DEG, STANDING_DEG = (20.0, 60.0, 75.0), (0.0, 0.0, 0.0)


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


def test_a_device_of_ones_own_stands_upright():
    """With as many joints as it has."""
    device = DeviceFile({"shoe": "foot"}, Path("ankle_only.urdf"))
    cuffs = {"calf": CuffLinks("shank", "calf")}
    worn = with_text(Assembly(device=device, cuffs=cuffs), models_path())
    scene = Scene(Model(worn, nominal_human()))
    q = scene.upright_pose(HALFWAY_DEG)
    motor = scene.coordinates.index("motor")
    along = q - scene.upright_pose(HALFWAY_DEG, [-2.0])
    assert along[motor] == pytest.approx(np.radians(2.0))
    assert np.delete(along, motor) == pytest.approx(0.0)


def test_two_legs_stand_upright():
    scene = Scene(Model(Assembly(Person("two")), nominal_human()))
    left, right = (30.0, 50.0, 20.0), (10.0, 10.0, 5.0)
    q = scene.upright_pose([*left, *right])
    for end in ("heel", "toe"):
        found = height_of(scene, q, f"sole_{end}_left")
        assert found == pytest.approx(0.0, abs=1e-12)
    assert np.degrees(q[3:]) == pytest.approx([*left, *right])


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        (((1.0, 2.0),), "joints_deg has the shape .* each of ankle, knee, hip"),
        ((HALFWAY_DEG, [1.0]), "offsets_deg .* exo_ankle, exo_knee, exo_hip"),
        (((1.0, float("nan"), 2.0),), "joints_deg holds values that are not"),
    ],
)
def test_an_upright_pose_needs_an_angle_for_each_joint(angles, words):
    with pytest.raises(InputError, match=words):
        Scene(nominal_model()).upright_pose(*angles)


@draws
@pytest.mark.slow
def test_picture_shows_a_subject_of_the_right_height():
    """Rows that hold colour (shirt, skin) span what the camera sees."""
    scene = Scene(nominal_model("human"))
    picture = scene.render(
        scene.upright_pose(STANDING_DEG), width=120, height=160
    )
    assert picture.shape == (160, 120, 3)
    coloured = np.ptp(picture.astype(int), axis=2) > 40
    rows = np.flatnonzero(coloured.any(axis=1))
    assert 0.5 * 160 < np.ptp(rows) < 0.9 * 160
    assert (picture[0] == 255).all()  # white above the head


def test_pose_of_another_plant_is_refused():
    with pytest.raises(ValueError, match="6 positions"):
        Scene(nominal_model("rigid")).set_pose(np.zeros(9))
    with pytest.raises(InputError, match="pose holds values that are not"):
        Scene(nominal_model("rigid")).set_pose(np.full(6, np.nan))


def test_a_stool_stands_on_the_floor_under_its_seat():
    parts = scene._stool(0.45)
    seat, place, _ = parts.pop("seat")
    under = place[2] - 0.5 * seat.height()
    assert under + seat.height() == pytest.approx(0.45)
    assert len({tuple(p[:2]) for _, p, _ in parts.values()}) == 4
    for leg, (_, _, z), _ in parts.values():
        assert z - 0.5 * leg.length() == pytest.approx(0.0)
        assert z + 0.5 * leg.length() == pytest.approx(under)


class Noted:
    """Meshcat's place, of which only what is said to it is kept."""

    def __init__(self):
        self.shapes, self.places, self.lines = {}, {}, {}

    def SetObject(self, path, shape, colour):
        self.shapes[path] = shape, colour

    def SetTransform(self, path, X, time=None):
        self.places[path] = X.translation()

    def SetProperty(self, path, name, value):
        pass

    def SetLineSegments(self, path, start, end, width, colour):
        self.lines[path] = start.T, end.T


def test_a_stool_is_as_wide_as_its_legs_stand():
    noted = Noted()
    scene.add_stool(noted, "/chair", 0.45)
    seat, colour = noted.shapes.pop("/chair/seat")
    assert colour.a() == 1.0
    assert len(noted.shapes) == 4
    for path, (leg, _) in noted.shapes.items():
        x, y, _ = noted.places[path]
        assert 0.0 < 0.5 * seat.width() - abs(x) - leg.radius() < 0.05
        assert 0.0 < 0.5 * seat.depth() - abs(y) - leg.radius() < 0.05


def test_a_floor_is_under_the_feet_with_a_line_every_25_cm():
    """5 m by 2.5 m about a place; its slab under the lines."""
    noted = Noted()
    scene.add_floor(noted, 0.75)
    ((slab, _),) = noted.shapes.values()
    place = noted.places["/floor/slab"]
    np.testing.assert_allclose(place[:2], [0.75, 0.0])
    assert -0.01 < place[2] + 0.5 * slab.height() < 0.0
    starts, ends = noted.lines["/floor/grid"]
    assert not starts[:, 2].any() and not ends[:, 2].any()
    along = starts[:, 0] == ends[:, 0]
    for lines, k, size, middle in (
        (along, 0, slab.width(), 0.75),
        (~along, 1, slab.depth(), 0.0),
    ):
        other = 1 - k
        np.testing.assert_allclose(
            starts[lines, k],
            middle + np.arange(-size / 2, size / 2 + 0.1, 0.25),
        )
        np.testing.assert_allclose(ends[lines, k], starts[lines, k])
        far = (slab.depth(), slab.width())[k]
        at = (0.0, 0.75)[k]
        np.testing.assert_allclose(starts[lines, other], at - 0.5 * far)
        np.testing.assert_allclose(ends[lines, other], at + 0.5 * far)


def test_a_camera_looks_at_its_target_upright():
    view = scene.View((2.0, -3.0, 2.5), (0.5, 1.0, 0.5))
    X_WC = view.pose()
    away = np.array(view.target) - view.eye
    seen = X_WC.inverse() @ np.array(view.target)
    np.testing.assert_allclose(
        seen, [0.0, 0.0, np.linalg.norm(away)], atol=1e-12
    )
    np.testing.assert_allclose(X_WC.translation(), view.eye)
    x, y, _ = X_WC.rotation().matrix().T
    assert x[2] == pytest.approx(0.0) and y[2] < -0.5
    # Who looks forward from the right sees the walker go to the right.
    side = scene.View((0.0, -4.0, 1.0), (0.0, 0.0, 1.0)).pose()
    np.testing.assert_allclose(
        side.inverse() @ np.array([1.0, 0, 1.0]), [1, 0, 4]
    )


@draws
def test_a_picture_is_averaged_over_four_of_its_points(monkeypatch):
    """Drawn twice as fine: a chequered one is grey."""
    made = Scene(nominal_model("human"))
    fine = np.indices((16, 12)).sum(axis=0) % 2 * 255
    fine[:2, :2] = 200
    image = SimpleNamespace(
        data=np.dstack([fine, fine, fine, fine]).astype(np.uint8)
    )
    asked = []

    def drawn(camera, parent, X):
        asked.append(camera)
        return image

    monkeypatch.setattr(
        made, "geometry_query", lambda: SimpleNamespace(RenderColorImage=drawn)
    )
    picture = made.render(made.upright_pose(STANDING_DEG), width=6, height=8)
    expected = np.full((8, 6, 3), 128)
    expected[0, 0] = 200
    np.testing.assert_array_equal(picture, expected)
    size = asked[0].core().intrinsics()
    assert (size.width(), size.height()) == (12, 16)
    assert np.rad2deg(size.fov_y()) == pytest.approx(30.0)
