"""The scene and the clips of a sole's page, by their numbers."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_exo.soles import animation
from drake_exo.soles.animation import SoleMotion, _Box
from drake_exo.soles.contact.law import Ground
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.simulation import StepHistory

TIMES = np.array([0.5, 0.6, 0.9])


@pytest.fixture(scope="module")
def motion():
    """A sole that rolls, its forces made up."""
    mesh = brick((0.2, 0.1, 0.04), (2, 2, 1))
    angles = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.3], [-0.1, 0.1, 0.0]])
    R = rotations_xyz(angles)
    O = np.array([[0.0, 0.1, 0.06], [0.02, 0.1, 0.05], [0.04, 0.1, 0.06]])  # noqa: E741
    rest = mesh.nodes[mesh.contact]
    places = np.einsum("qij,nj->qni", R, rest) + O[:, None]
    force = np.zeros_like(places)
    force[:, 2] = [[1.0, 2.0, 60.0]]
    force[:, 5] = [[3.0, -2.0, 20.0]]
    return SoleMotion("it", "", TIMES, mesh, O, R, places, force)


def test_a_clip_is_the_motion_s(motion):
    box = _Box.of([motion])
    values = np.zeros((3, len(motion.surface)))
    clip = animation._clip(4, motion, values, box)
    np.testing.assert_allclose(clip.times, TIMES - 0.5)
    assert clip.note == "0.40 s of contact"
    assert (clip.title, clip.group) == ("it", "Step")
    assert animation._clip(4, replace(motion, group="g"), 0, box).group == "g"
    zmp = clip.bodies["/zmp"]
    P, up = motion.places, motion.force[:, :, 2]
    wanted = (P[:, 2, :2] * 60 + P[:, 5, :2] * 20) / 80
    # On the ground, z = 0: what pulls along it does so at its own height.
    wanted -= (P[:, :, 2:] * motion.force[:, :, :2]).sum(axis=1) / 80
    np.testing.assert_allclose(up.sum(axis=1), 80.0)
    np.testing.assert_allclose(zmp[:, :2], wanted)
    np.testing.assert_allclose(zmp[:, 2:], np.tile([0, 1, 0, 0, 0], (3, 1)))
    pose = clip.bodies["/undeformed/4"]
    np.testing.assert_allclose(pose[:, :3], motion.origin)
    # Quaternions with their scalar first.
    turned = Rotation.from_quat(pose[:, [4, 5, 6, 3]]).as_matrix()
    np.testing.assert_allclose(turned, motion.rotation, atol=1e-12)
    arrow = clip.arrows["ground"]
    np.testing.assert_allclose(arrow[:, :2], wanted)
    np.testing.assert_allclose(arrow[:, 3:], np.tile([4.0, 0, 80.0], (3, 1)))
    surface = clip.surfaces["/sole/4"]
    corners = surface.places[1][surface.faces]
    whole = motion.mesh.nodes[motion.mesh.boundary_faces]
    wanted = whole @ motion.rotation[1].T + motion.origin[1]
    np.testing.assert_allclose(corners, wanted, atol=1e-12)


def test_the_underside_is_a_mirror_s_before_the_sole(motion):
    """Upside down, 80 mm from the sole, all of it above the ground."""
    box = _Box.of([motion])
    places = motion.surface_places().reshape(-1, 3)
    np.testing.assert_allclose(box.low, places.min(axis=0))
    np.testing.assert_allclose(box.high, places.max(axis=0))
    matrix = box.mirror
    shown = places @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(shown[:, 0], places[:, 0])
    size = box.high - box.low
    np.testing.assert_allclose(places[:, 1] - shown[:, 1], size[1] + 0.08)
    np.testing.assert_allclose(shown[:, 2] + places[:, 2], box.high[2])
    np.testing.assert_array_equal(matrix[3], [0, 0, 0, 1])
    far = replace(
        motion, places=motion.places + 0.1, origin=motion.origin + 0.1
    )
    both = _Box.of([motion, far])
    np.testing.assert_allclose(both.low, box.low)
    np.testing.assert_allclose(both.high, box.high + 0.1)
    # A foot that rolls far, 0.2 m high: 0.2 m from it.
    assert _Box(np.zeros(3), np.full(3, 0.2)).mirror[1, 3] == -0.4


def test_sole_and_mirror_are_in_the_picture(motion):
    """A viewer of 32° sees the corners of both, and that they fill half."""
    box = _Box.of([motion])
    page = animation._page("title", 123.4, box)
    eye, target = np.array(page.eye), np.array(page.target)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    upward = np.cross(right, ahead)
    ends = np.array([box.low, box.high])
    corners = np.array(np.meshgrid(*ends.T)).reshape(3, -1).T
    mirrored = corners @ box.mirror[:3, :3].T + box.mirror[:3, 3]
    off = np.concatenate([corners, mirrored]) - eye
    assert (off @ ahead > 0).all() and eye[2] > box.high[2]
    high = np.rad2deg(np.arctan((off @ upward) / (off @ ahead)))
    wide = np.rad2deg(np.arctan((off @ right) / (off @ ahead)))
    assert page.field_of_view_deg == 32.0
    assert 4 < high.max() < 16 and -16 < high.min() < -6
    assert 6 < wide.max() < 24 and -24 < wide.min() < -6
    assert "123 kPa" in page.legend[0]
    # An arrow of 0.1 m is 500 N.
    assert "0.1 m is 500 N" in page.legend[0]
    assert 500 * page.arrows[0].metres_per_newton == pytest.approx(0.1)
    # From dark to light; the scale, evenly from its first stop to its last.
    assert page.colours.shape == (256, 3)
    assert (np.diff(page.colours @ [0.3, 0.6, 0.1]) > 0).all()
    stops = re.findall(r"rgb\((\d+),(\d+),(\d+)\)", page.legend[0])
    at = np.linspace(0, 255, len(stops))
    assert len(stops) > 6 and (at == np.rint(at)).all()
    wanted = np.rint(255 * page.colours[at.astype(int)])
    np.testing.assert_array_equal(np.array(stops, int), wanted)


def test_boxes_hide_what_a_clip_does_not_show_again(motion):
    """Its bodies are shown anew at every instant."""
    box = _Box.of([motion])
    page = animation._page("title", 1.0, box)
    clip = animation._clip(0, motion, np.zeros((3, 1)), box)
    switched = {path for paths in page.switches.values() for path in paths}
    assert not switched & {*clip.bodies, *clip.surfaces}


def _of(ground, box):
    """Slab and lines of the stage: corners (n, 3), faces, ends (l, 2, 3)."""
    slab, grid, *_ = animation._stage(box, ground)
    shape = slab.object.geometry
    points = grid.object.geometry.position
    return shape.vertices, shape.faces, np.reshape(points.T, (-1, 2, 3))


FLAT = animation.FLAT
LOW, HIGH = np.array([-0.13, -0.062, 0.0]), np.array([0.12, 0.06, 0.05])


def test_the_ground_reaches_beyond_sole_and_mirror():
    box = _Box(LOW, HIGH)
    vertices, faces, lines = _of(FLAT, box)
    # x: 50 mm beyond, to the next line. y: the mirror's 122 + 80 mm as well.
    low, high = [-0.2, -0.15 - 0.25, -8e-4], [0.2, 0.15, -8e-4]
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=1e-9)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=1e-9)
    a, b, c = np.swapaxes(vertices[faces], 0, 1)
    area = 0.5 * np.cross(b - a, c - a)
    assert (area[:, 2] > 0).all()
    assert area[:, 2].sum() == pytest.approx(0.4 * 0.55)
    # Lines of the grid: 50 mm apart, in pieces, above the slab.
    np.testing.assert_allclose(lines[..., 2], -6e-4, atol=1e-9)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    np.testing.assert_allclose(length, 0.05, atol=1e-7)
    along = np.abs(lines[:, 1] - lines[:, 0]).argmax(axis=1)
    assert (along == 0).sum() == 8 * 12 and (along == 1).sum() == 11 * 9
    for axis, other, count in ((0, 1, 12), (1, 0, 9)):
        places = np.unique(lines[along == axis][:, :, other].round(6))
        assert len(places) == count
        np.testing.assert_allclose(np.diff(places), 0.05, atol=1e-5)
        ends = lines[along == axis][:, :, axis]
        np.testing.assert_allclose(
            [ends.min(), ends.max()], [low[axis], high[axis]], atol=1e-6
        )


def test_uneven_ground_is_drawn_by_the_centimetre():
    x, y = np.linspace(-0.5, 0.5, 21), np.linspace(-0.8, 0.8, 21)
    heights = 0.05 * x[:, None] + 0.02 * y
    ground = Ground(x, y, heights)
    vertices, _, lines = _of(ground, _Box(LOW, HIGH))
    wanted = 0.05 * vertices[:, 0] + 0.02 * vertices[:, 1] - 8e-4
    np.testing.assert_allclose(vertices[:, 2], wanted, atol=1e-7)
    assert len(vertices) == 41 * 56
    wanted = 0.05 * lines[..., 0] + 0.02 * lines[..., 1] - 6e-4
    np.testing.assert_allclose(lines[..., 2], wanted, atol=1e-7)
    flat = np.linalg.norm((lines[:, 1] - lines[:, 0])[:, :2], axis=1)
    np.testing.assert_allclose(flat, 0.01, atol=1e-6)
    places = np.unique(lines[np.ptp(lines[..., 0], axis=1) < 1e-9][:, 0, 0]
                       .round(6))  # fmt: skip
    np.testing.assert_allclose(np.diff(places), 0.05, atol=1e-5)


def test_the_shape_at_rest_is_the_mesh_s(motion):
    shape = animation._undeformed(2, motion).object.geometry
    corners = shape.vertices[shape.faces]
    whole = motion.mesh.nodes[motion.mesh.boundary_faces]
    np.testing.assert_allclose(corners, whole, atol=1e-9)


def test_colours_go_up_to_what_a_hundredth_exceeds(motion, tmp_path):
    """One scale for all; of the values above 0, corners aside."""
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            animation, "write_page",
            lambda path, stage, page, clips: told.append((stage, page, clips)),
        )  # fmt: skip
        force = motion.force.copy()
        force[1] *= 3.0
        high = replace(motion, title="high", force=force)
        animation.write_animation(tmp_path / "p.html", [motion, high], "a<b")
    ((stage, page, clips),) = told
    values = high.pressure()
    top = np.quantile(values[values > 0], 0.99)
    assert f"{top:.0f} kPa" in page.legend[0]
    for k, (clip, mine) in enumerate(zip(clips, (motion, high), strict=True)):
        shown = clip.surfaces[f"/sole/{k}"].values
        np.testing.assert_allclose(shown, mine.pressure() / top)
    assert html.escape("a<b") in stage and "a<b" not in stage
    assert "{" not in page.title and stage.count("show(") > 6


def test_pressure_is_force_over_area_in_kilopascals(motion):
    values = motion.pressure()
    area = motion.mesh.contact_areas
    at = np.searchsorted(motion.surface, motion.mesh.contact)
    np.testing.assert_allclose(values[:, at[2]], 1e-3 * 60 / area[2])
    np.testing.assert_allclose(values[:, at[5]], 1e-3 * 20 / area[5])
    assert (values > 0).sum() == 3 * 2


def test_one_sample_is_no_motion(motion):
    K = np.zeros((3, 6, 6))
    K[1] = np.nan
    history = StepHistory(
        motion.force, motion.origin, motion.rotation, motion.places, K
    )
    made = SoleMotion.of("it", motion.mesh, TIMES, history)
    np.testing.assert_array_equal(made.times, [0.5, 0.9])
    np.testing.assert_array_equal(made.places, motion.places[[0, 2]])
    history.K_c[2, 0, 3] = np.nan
    assert SoleMotion.of("it", motion.mesh, TIMES, history) is None


def test_a_mark_is_the_result_s_not_its_first_shape_s(
    motion, tmp_path, monkeypatch
):
    told = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / animation.HISTORY).write_bytes(b"")
    (tmp_path / "b" / animation.FIRST_HISTORY).write_bytes(b"")
    monkeypatch.setattr(
        SoleMotion, "read",
        lambda file, title, name, mark="": replace(
            motion, title=title, group=name, mark=mark
        ),
    )  # fmt: skip
    monkeypatch.setattr(
        animation, "_told",
        lambda folder: (f"sole {folder.name}", f"{folder.name} does not hold"),
    )  # fmt: skip
    monkeypatch.setattr(
        animation, "write_animation", lambda *given: told.extend(given)
    )
    animation.replay_soles(tmp_path, tmp_path / "p.html")
    path, shown, title = told
    assert (path, title) == (tmp_path / "p.html", "Sole sole a, sole b")
    assert [(m.title, m.mark) for m in shown] == [
        ("sole a", "a does not hold"),
        ("sole b: optimised", "b does not hold"),
        ("sole b: initial shape", ""),
    ]


@pytest.mark.parametrize(
    ("most", "shown"), [(6, [0, 2, 4, 6, 8, 12]), (20, [*range(9), 10, 11, 12])]
)
def test_samples_of_a_long_step_are_spread_evenly(
    motion, monkeypatch, most, shown
):
    """Over those that converged: the tenth did not."""
    monkeypatch.setattr(animation, "_MAX_FRAMES", most)
    times, K = np.linspace(0, 1, 13), np.zeros((13, 6, 6))
    K[9] = np.nan
    parts = {"O": "origin", "R": "rotation", "P": "places", "F": "force"}
    many = {
        name: np.repeat(getattr(motion, own)[:1], 13, axis=0)
        for name, own in parts.items()
    }
    history = StepHistory(K_c=K, **many)
    found = SoleMotion.of("it", motion.mesh, times, history)
    np.testing.assert_array_equal(found.times, times[shown])
    assert len(found.places) == len(shown)
