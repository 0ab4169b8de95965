"""Views of surfaces: what faces the viewer, what lies in front, colours."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from drake_exo.soles import pictures
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import SphericalSpline, brick


@pytest.fixture(scope="module")
def mesh():
    return brick((0.2, 0.1, 0.04), (4, 2, 1))


@pytest.mark.parametrize("view", pictures.VIEWS, ids=lambda v: v.name)
def test_axes_are_right_handed(view):
    frame = view.axes()
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_the_heel_is_on_the_left_from_below():
    below = pictures.VIEWS[0].axes()
    assert below[0] @ [1, 0, 0] == pytest.approx(1.0)
    assert below[2] @ [0, 0, -1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("view", "colour"), [(pictures.VIEWS[0], 0), (pictures.VIEWS[2], 1)]
)
def test_only_what_faces_the_viewer_is_painted(mesh, view, colour):
    """Bottom red, back green: each view shows its own."""
    centre = mesh.nodes[mesh.boundary_faces].mean(axis=1)
    paint = np.zeros_like(centre)
    paint[centre[:, 2] < -0.0399, 0] = 1.0
    paint[centre[:, 0] < -0.0999, 1] = 1.0
    axis = Figure().add_subplot()
    pictures.draw(axis, mesh.nodes[mesh.boundary_faces], paint, view)
    seen = axis.collections[0].get_facecolor()[:, :3]
    assert (seen[:, colour] > 0.3).all()
    others = [k for k in range(3) if k != colour]
    assert np.abs(seen[:, others]).max() == 0.0


def test_change_is_radial(mesh):
    spline = SphericalSpline((4, 4))
    p = np.linspace(0.8, 1.2, spline.count)
    away = np.linalg.norm(mesh.nodes, axis=1) > 0
    shaped = mesh.with_nodes(spline.deform(mesh.nodes, p))
    before, after = (np.linalg.norm(m.nodes, axis=1) for m in (mesh, shaped))
    change = pictures.radial_change(shaped, spline, p)
    np.testing.assert_allclose(
        change[away], 100 * (after[away] / before[away] - 1), atol=1e-10
    )
    assert (change[~away] == 0).all()


@pytest.mark.slow
def test_a_load_is_drawn_in_millimetres_and_newtons(mesh):
    """ZMP on the outline, force over time."""
    t = np.linspace(0.0, 1.0, 5)
    force = np.stack([3.0 * t, 5.0 - t, 700.0 + t], axis=1)
    zmp = np.stack([0.02 * t, -0.01 * t], axis=1)
    level = mesh.nodes[mesh.contact, :2]
    left, right = pictures.load_figure(Load(t, force, zmp), level).axes[:2]
    (dots,) = left.collections
    np.testing.assert_allclose(dots.get_offsets(), 1e3 * zmp)
    np.testing.assert_allclose(dots.get_array(), t)
    (ring,) = left.patches
    corners = ring.get_xy()
    np.testing.assert_allclose(np.abs(corners), [[100.0, 50.0]] * 5)
    np.testing.assert_allclose(left.lines[0].get_xydata(), corners)
    for k, line in enumerate(right.lines[:3]):
        np.testing.assert_allclose(line.get_data(), (t, force[:, k]))


@pytest.mark.slow
def test_stiffness_of_each_sole_has_room():
    """Kilonewtons a metre since contact; columns as wide for two as for six."""
    t = np.array([0.3, 0.4, 0.6])
    tr, rot = np.array([4e4, 9e4, 7e4]), np.array([30.0, 80.0, 50.0])
    names = ("time_s", *pictures.STIFFNESS)
    curves = {
        "initial": dict(zip(names, (t, tr, rot), strict=True)),
        "optimised": dict(zip(names, (t, 2 * tr, 3 * rot), strict=True)),
    }
    for count in (1, 2, 6):
        figure = pictures.stiffness_figure(
            {f"sole {k}": curves for k in range(count)}, strikes=[(0, 2)]
        )
        above, below = figure.axes[:count], figure.axes[count:]
        assert figure.get_figwidth() / count >= 2.7
        for axis, values in ((above[-1], 1e-3 * tr), (below[-1], rot)):
            first, second = axis.lines
            by = 2 if axis is above[-1] else 3
            np.testing.assert_allclose(first.get_data(), (t - 0.3, values))
            np.testing.assert_allclose(
                second.get_data(), (t - 0.3, by * values)
            )


@pytest.mark.slow
def test_the_key_of_all_soles_lies_below_them(mesh):
    """On the same scale: its 50 mm are those of the soles."""
    change = np.linspace(-1.0, 2.0, len(mesh.nodes))
    sole = "sole", "said of it", mesh, mesh, change
    figure = pictures.soles_figure([sole, sole])
    Figure.draw_without_rendering(figure)
    *soles, bar, key = figure.axes
    lowest = min(axis.get_window_extent().y0 for axis in soles)
    for axis in (bar, key):
        assert axis.get_tightbbox().y1 < lowest
        assert axis.get_tightbbox().y0 > 0

    def inches(axis, ends):
        at = axis.transData.transform([[x, 0.0] for x in ends])
        return np.ptp(at[:, 0]) / figure.dpi

    ends = key.lines[0].get_xdata()
    assert np.ptp(ends) == 50.0
    for axis in soles:
        assert inches(axis, (0.0, 50.0)) == pytest.approx(inches(key, ends))


def test_dimensions_of_a_drawing_are_the_mesh_s():
    """A wedge: 120 mm long, 20 mm high at its heel and 40 at its toe."""
    mesh = brick((0.12, 0.06, 0.02), (8, 4, 2))
    nodes = mesh.nodes * [1, 1, 0]
    nodes[:, 2] = mesh.nodes[:, 2] * (1.5 + mesh.nodes[:, 0] / 0.12)
    peak = np.zeros(len(mesh.contact))
    peak[3] = 123e3
    figure = pictures.drawing_figure(mesh.with_nodes(nodes), "wedge", peak)
    above, below, side, along, across, pressed = figure.axes[:6]
    for axis in (below, side):  # which end is which
        ends = sorted(axis.texts, key=lambda text: text.get_position()[0])
        words = [text.get_text() for text in ends]
        assert [w for w in words if w.isalpha()] == ["heel", "toe"]

    def numbers(axis):
        texts = (text.get_text() for text in axis.texts)
        return [float(t) for t in texts if t.replace(".", "").isdigit()]

    assert numbers(above) == [120.0, 60.0]
    assert numbers(side) == [40.0]
    assert numbers(along) == pytest.approx([23.0, 30.0, 37.0], abs=0.11)
    # Widths and thicknesses, cut by cut.
    wanted = [60.0, 23.0, 60.0, 30.0, 60.0, 37.0]
    assert numbers(across) == pytest.approx(wanted, abs=0.11)
    assert "from above; ×: 123 kPa" in pressed.get_title()
    assert "undercut 0.0 %" in above.get_title()
    assert "216 cm³" in figure._suptitle.get_text()


def test_what_no_mould_lets_go_of_is_red():
    mesh = brick((0.12, 0.06, 0.02), (8, 4, 2))
    nodes = mesh.nodes * np.where(mesh.nodes[:, 2:] < -0.015, 1.3, 1.0)
    figure = pictures.drawing_figure(
        mesh.with_nodes(nodes), "wide", np.ones(len(mesh.contact))
    )
    (drawn,) = (
        c for c in figure.axes[0].collections if len(c.get_facecolors())
    )
    red = drawn.get_facecolors()[:, 0] > 2 * drawn.get_facecolors()[:, 2]
    assert red.any() and not red.all()
