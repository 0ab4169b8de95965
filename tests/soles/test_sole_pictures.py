"""What the pictures of soles show: places, units, words, and where they lie."""

from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drake_exo.soles import pictures
from drake_exo.soles.contact.law import FLAT, Ground
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, brick
from drake_exo.soles.pictures import View

SIZE = (0.2, 0.1, 0.04)
ABOVE = View("", (0, 0, 1), (0, 1, 0))  # right: forward; up: left


@pytest.fixture(scope="module")
def mesh():
    return brick(SIZE, (4, 2, 1))


def _level(mesh):
    """Places of the nodes that may touch, set down [m]."""
    return mesh.nodes[mesh.contact, :2]


@pytest.fixture(scope="module")
def wedge():
    """120 × 60 mm, off the middle; 20 mm high at its heel, 40 at its toe."""
    mesh = brick((0.12, 0.06, 0.02), (8, 4, 2))
    nodes = mesh.nodes.copy()
    nodes[:, 2] *= 1.5 + nodes[:, 0] / 0.12
    return mesh.with_nodes(nodes + np.array([0.05, 0.01, 0.0]))


def _boxes(figure):
    """Every text with its place on the page [inches], (2, 2)."""
    figure.draw_without_rendering()
    texts = [*figure.texts, *(t for a in figure.axes for t in a.texts)]
    texts += [a.title for a in figure.axes]
    if figure._suptitle is not None:
        texts.append(figure._suptitle)
    found = {}
    for text in texts:
        if text.get_text().strip() and text.get_visible():
            box = text.get_window_extent().get_points() / figure.dpi
            found[(text.get_text(), *box[0])] = box
    return found


def _assert_texts_lie_apart(figure):
    boxes = _boxes(figure)
    page = figure.get_size_inches()
    for (word, *_), box in boxes.items():
        assert (box[0] > -0.02).all() and (box[1] < page + 0.02).all(), word
    for (first, a), (second, b) in combinations(boxes.items(), 2):
        shared = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
        assert (shared < 0.02).any(), (first[0], second[0])


# Surfaces


def _painted(corners, view, colour=0.5):
    axis = Figure().add_subplot()
    pictures.draw(axis, corners, np.full((len(corners), 3), colour), view)
    (drawn,) = axis.collections
    return [p.vertices[:3] for p in drawn.get_paths()], drawn.get_facecolor()


def test_what_is_nearer_is_painted_over_what_is_farther():
    rng = np.random.default_rng(1)
    corners = rng.uniform(-1, 1, (40, 3, 3))
    view = View("", (1.0, 2.0, -0.5))
    polygons, _ = _painted(corners, view)
    frame = view.axes()
    across = np.cross(
        corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    )
    seen = corners[across @ frame[2] > 0]
    assert 5 < len(polygons) == len(seen) < 35
    depth = seen.mean(axis=1) @ frame[2]
    np.testing.assert_allclose(
        polygons, (seen @ frame[:2].T)[np.argsort(depth)], atol=1e-12
    )


def _toward(normal):
    """A triangle that looks along a vector, (3, 3)."""
    first = np.cross(normal, [0.3, 1.0, 0.2])
    return np.stack([0 * first, first, np.cross(normal, first)])


def test_what_looks_at_the_light_is_brightest():
    """By the cosine of the angle; what looks away keeps the ambient part."""
    light = np.array([-0.4, -0.2, 0.894])
    beside = np.cross(light, [0, 0, 1.0])
    beside /= np.linalg.norm(beside)
    half = 0.5 * light + np.sqrt(0.75) * beside
    away = np.array([0.95, 0.2, 0.2])
    for normal, lit in ((light, 1.05), (half, 0.725), (away, 0.4)):
        _, colour = _painted(_toward(normal)[None], ABOVE)
        np.testing.assert_allclose(colour[0, :3], 0.5 * lit, rtol=2e-3)
    _, colour = _painted(_toward(light)[None], ABOVE, 0.99)
    np.testing.assert_array_equal(colour[0, :3], 1.0)
    # The light stays where the viewer is: from the upper left, before him.
    view = pictures.VIEWS[1]
    lit = np.array([-0.4, -0.2, 0.894]) @ view.axes()
    _, colour = _painted(_toward(lit)[None], view)
    np.testing.assert_allclose(colour[0, :3], 0.525, rtol=2e-3)


@pytest.mark.parametrize(
    ("view", "right", "up"),
    [
        (pictures.VIEWS[0], (1, 0, 0), (0, -1, 0)),
        (pictures.VIEWS[1], (-1, 0, 0), (0, 0, 1)),
        (pictures.VIEWS[2], (0, -1, 0), (0, 0, 1)),
        (ABOVE, (1, 0, 0), (0, 1, 0)),
    ],
)
def test_extent_in_millimetres(view, right, up):
    nodes = np.array(
        [[x, y, z] for x in (-0.1, 0.02, 0.1) for y in (-0.03, 0.05)
         for z in (-0.04, 0.01)]
    )  # fmt: skip
    flat = 1e3 * np.stack([nodes @ right, nodes @ up], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    found = pictures.extent(nodes, view)
    np.testing.assert_allclose(found, [low, high], atol=1e-9)


def test_outline_of_a_sole_goes_round_its_waist():
    """As from above a quarter of a block is missing; its sides are whole."""
    block = brick(SIZE, (4, 2, 1))
    x, y, _ = block.nodes[block.tets].mean(axis=1).T
    waist = TetMesh(block.nodes, block.tets[(x < 0) | (y < 0)], block.fixed)
    for view, area in zip((ABOVE, *pictures.VIEWS), (15000, 15000, 8000, 4000),
                          strict=False):  # fmt: skip
        axis = Figure().add_subplot()
        pictures.outline(axis, waist, view)
        twice = 0.0
        for line in axis.lines:
            ring = line.get_xydata()
            np.testing.assert_allclose(ring[0], ring[-1])
            pairs = np.stack([ring[:-1], ring[1:]], axis=1)
            twice += np.linalg.det(pairs).sum()
        assert twice == pytest.approx(2 * area)


# Plots of a step


def _load(mesh, count=23):
    t = np.linspace(0.4, 1.5, count)
    force = np.stack([3.0 * t, 5.0 - t, 700.0 + t], axis=1)
    zmp = np.stack([0.02 * t + 0.01, -0.01 * t + 0.03], axis=1)
    return Load(t, force, zmp)


def test_heel_strike_is_where_the_load_begins(mesh):
    load = _load(mesh)
    left, right, *_ = pictures.load_figure(load, _level(mesh), FLAT).axes
    start = 1e3 * load.zmp[0]
    np.testing.assert_allclose(left.lines[1].get_xydata(), [start])
    assert left.get_title().startswith("ZMP") and not left.texts
    assert "heel strike" in left.get_title()
    given = replace(load, rotation=np.tile(np.eye(3), (len(load.times), 1, 1)))
    drawn = pictures.load_figure(given, _level(mesh), FLAT).axes[0]
    assert drawn.get_title().startswith("Recorded ZMP")
    labels = [text.get_text() for text in right.get_legend().get_texts()]
    assert labels == ["$F_x$", "$F_y$", "$F_z$"]
    assert "mm" in left.get_xlabel() and "[N]" in right.get_ylabel()


def test_a_load_far_from_the_origin_is_labelled_within_the_figure():
    """A yawed sole at (1.3, -0.4) m, whose numbers are long."""
    outline = [[1.178, -0.381], [1.371, -0.299], [1.422, -0.419],
               [1.229, -0.501]]  # fmt: skip
    zmp = [[1.229, -0.452], [1.3, -0.39], [1.381, -0.386]]
    force = [[0.0, 0.0, 140.0], [-60.0, 40.0, 970.0], [40.0, 0.0, 125.0]]
    load = Load([0.0, 0.35, 0.71], force, zmp)
    figure = pictures.load_figure(load, np.array(outline), FLAT)
    FigureCanvasAgg(figure).draw()
    assert figure.axes[0].yaxis.label.get_window_extent().x0 > 0


def test_uneven_ground_is_drawn_under_the_sole(mesh):
    """Its ridge along y where it lies, its height in millimetres."""
    x, y = np.linspace(-3.0, 3.0, 301), np.linspace(-2.0, 2.0, 21)
    ridge = 0.02 - (x - 0.04) ** 2
    ground = Ground(x, y, np.repeat(ridge[:, None], 21, axis=1))
    left = pictures.load_figure(_load(mesh), _level(mesh), ground).axes[0]
    np.testing.assert_allclose(left.get_xlim(), [-110, 110])
    np.testing.assert_allclose(left.get_ylim(), [-55, 55])
    (heights,) = (c for c in left.collections if hasattr(c, "levels"))
    seen = heights.levels[(heights.levels > -2) & (heights.levels < 20)]
    assert len(seen) > 4
    lines = heights.get_paths()[list(heights.levels).index(seen[0])].vertices
    assert np.ptp(lines[:, 1]) == pytest.approx(110)
    away = np.sqrt(1e3 * (20 - seen[0]))
    np.testing.assert_allclose(np.abs(lines[:, 0] - 40), away, atol=1e-2)
    labels = [text for text in left.texts if text.get_text().endswith(" mm")]
    assert {f"{level:g} mm" for level in seen} <= {
        text.get_text() for text in labels
    }
    for text in labels:
        assert (np.abs(text.get_position()) < [110, 55]).all()


def test_heel_strike_is_shaded_in_the_stiffness():
    t = np.array([0.3, 0.4, 0.6, 0.9])
    values = zip(pictures.STIFFNESS, (1e4 + t, 10 + t), strict=True)
    curve = {"time_s": t, **dict(values)}
    soles = {name: {"one": curve} for name in ("first", "second")}
    axes = pictures.stiffness_figure(soles, [(0, 3)]).axes
    for axis in axes:
        (band,) = axis.patches
        x = band.get_extents().transformed(axis.transData.inverted())
        ends = (x.x0, x.x1)
        np.testing.assert_allclose(sorted(ends), [0.0, 0.3], atol=1e-9)
        assert axis.get_ylim()[0] == 0
    assert [axis.get_title() for axis in axes[:2]] == ["first", "second"]
    assert all("time" in axis.get_xlabel() for axis in axes[2:])
    assert [bool(axis.get_legend()) for axis in axes] == [True] + 3 * [False]
    assert "kN/m" in axes[0].get_ylabel()
    assert "rad" in axes[2].get_ylabel()


@pytest.mark.slow
def test_legends_keep_clear_of_many_loads(mesh):
    """Below the axes: no place within them is free of curves."""
    load = _load(mesh, 40)
    up = np.tile([[0.0, 0.0, 1.0], [0.0, 0.0, 900.0]], (20, 1))
    many = replace(load, force=up)
    names = ("origin_x_m", "origin_y_m", "origin_z_m", "roll_deg",
             "pitch_deg", "yaw_deg", "stability_n_per_m",
             "nodes_in_contact", "converged")  # fmt: skip
    columns = {name: up[:, 2] for name in names} | {"time_s": load.times}
    drawn = pictures.load_figure(many, _level(mesh), FLAT)
    posed = pictures.pose_figure(columns)
    for figure, axes in (
        (drawn, drawn.axes[1:2]), (posed, posed.axes[:2]),
    ):  # fmt: skip
        figure.draw_without_rendering()
        for axis in axes:
            box = axis.get_legend().get_window_extent()
            assert box.y1 < axis.get_window_extent().y0
            assert box.y0 > 0


def test_a_load_of_one_sample_is_a_point(mesh):
    load = _load(mesh, 4)
    for begins, marker in (((0,), "None"), ((0, 1), "."), ((0, 3), ".")):
        parts = replace(load, begins=begins, weights=(1.0,) * len(begins))
        _, force, _ = pictures.load_figure(parts, _level(mesh)).axes
        assert [line.get_marker() for line in force.lines] == 3 * [marker]


def test_times_of_a_single_sample_do_not_overlap(mesh):
    load = _load(mesh, 4)
    one = replace(load, times=load.times[:1] + 0.2, force=load.force[:1],
                  zmp=load.zmp[:1], begins=(0,), weights=(1.0,))  # fmt: skip
    _, force, _ = pictures.load_figure(one, _level(mesh)).axes
    assert list(force.get_xticks()) == list(one.times)


def test_pose_in_millimetres_degrees_and_kilonewtons():
    t = np.linspace(0, 1, 5)
    names = ("origin_x_m", "origin_y_m", "origin_z_m", "roll_deg",
             "pitch_deg", "yaw_deg", "stability_n_per_m",
             "nodes_in_contact")  # fmt: skip
    columns = {name: 0.01 * (k + 1) + t**k for k, name in enumerate(names)}
    columns["converged"] = np.array([1, 1, 0, 1, 1])
    figure = pictures.pose_figure({"time_s": t, **columns})
    columns = {n: np.where(columns["converged"], columns[n], np.nan)
               for n in names}  # fmt: skip
    place, turn, stable, nodes = figure.axes
    lines = {
        **dict(zip(names[:3], place.lines, strict=True)),
        **dict(zip(names[3:6], turn.lines, strict=True)),
    }
    for name, line in lines.items():
        values = columns[name]
        if name == "origin_z_m":
            values = values - values[0]
            assert line.get_label() == "z − 30.0 mm"
        scale = 1e3 if name.startswith("origin") else 1.0
        np.testing.assert_allclose(line.get_data(), (t, scale * values))
        if name != "origin_z_m":
            assert line.get_label() in name
    np.testing.assert_allclose(
        stable.lines[0].get_data(), (t, 1e-3 * columns["stability_n_per_m"])
    )
    assert list(stable.lines[1].get_ydata()) == [0, 0]
    np.testing.assert_allclose(
        nodes.lines[0].get_data(), (t, columns["nodes_in_contact"])
    )
    assert nodes.get_ylim()[0] == 0


@pytest.mark.slow
def test_pressure_at_eight_times_of_those_that_converged(mesh):
    load = _load(mesh)
    draw = partial(pictures.pressure_figure, mesh, load.times, load.zmp)
    rng = np.random.default_rng(2)
    pressure = rng.uniform(0, 9e4, (len(load.times), len(mesh.contact)))
    converged = np.ones(len(load.times), dtype=bool)
    converged[[0, 22]] = False
    pressure[0] = 1e9
    figure = draw(pressure, converged)
    *axes, bar = figure.axes
    assert len(axes) == 8
    # The 21 that are left, in even steps: 0, 2.86, 5.71, …, 20, rounded.
    at = 1 + np.array([0, 3, 6, 9, 11, 14, 17, 20])
    for axis, q in zip(axes, at, strict=True):
        (drawn,) = axis.collections
        np.testing.assert_allclose(drawn.get_array(), 1e-3 * pressure[q])
        assert drawn.get_clim() == (0, pytest.approx(1e-3 * pressure[at].max()))
        corners = np.concatenate([p.vertices for p in drawn.get_paths()])
        np.testing.assert_allclose(
            [corners.min(axis=0), corners.max(axis=0)], [[-100, -50], [100, 50]]
        )
        np.testing.assert_allclose(
            axis.lines[0].get_xydata(), [1e3 * load.zmp[q]]
        )
        assert axis.get_title() == f"{load.times[q]:.3f} s"
    assert all(axis.get_xlabel() == "x [mm]" for axis in axes[4:])
    assert [axis.get_ylabel() for axis in axes[::4]] == 2 * ["y [mm]"]
    assert "kPa" in bar.get_ylabel()
    none = draw(pressure, converged & False)
    assert none is None
    still = draw(0 * pressure, converged)
    assert still.axes[0].collections[0].get_clim()[1] > 0
    few = draw(pressure, converged & (np.arange(len(pressure)) < 4))
    titles = [axis.get_title() for axis in few.axes[:-1]]
    assert titles == [f"{t:.3f} s" for t in load.times[1:4]]


def test_the_underside_is_what_looks_down(wedge):
    """Its triangles cover the outline once, counter-clockwise from above."""
    faces, place = pictures._underside(wedge)
    np.testing.assert_array_equal(place, wedge.nodes[wedge.contact][:, :2])
    a, b, c = np.swapaxes(place[faces], 0, 1)
    e, f = b - a, c - a
    area = 0.5 * (e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])
    assert (area > 1e-8).all()
    assert area.sum() == pytest.approx(0.12 * 0.06)
    # On both sides of a keel at y = 0, steeper than 87°, it is a side; sides
    # with a draft belong to it, else parts of a rim would float.
    nodes = wedge.nodes - [0.05, 0.01, 0.0]
    for fall, count in ((19.8, 64), (20.2, 0)):
        keel = nodes.copy()
        below = wedge.contact
        keel[below, 2] = -0.2 + fall * np.abs(nodes[below, 1])
        assert len(pictures._underside(wedge.with_nodes(keel))[0]) == count


def test_the_underside_is_drawn_over_a_hollow_s_ceiling():
    solid = brick((0.2, 0.1, 0.03), (3, 3, 3))
    middle = np.abs(solid.nodes[solid.tets].mean(axis=1) - [0, 0, -0.015])
    inside = (middle < [0.033, 0.0166, 0.005]).all(axis=1)
    mesh = TetMesh(solid.nodes, solid.tets[~inside], solid.fixed)
    faces, _ = pictures._underside(mesh)
    z = mesh.nodes[mesh.contact, 2][faces].mean(axis=1)
    ceiling = z > -0.029
    np.testing.assert_array_equal(np.unique(z[ceiling].round(6)), [-0.01])
    assert not ceiling[ceiling.sum() :].any()


# Plots of an optimisation


def test_iterations_are_numbered_through_the_stages():
    trace = {
        "stage": np.array([1.0, 1.0, 2.0]),
        "cost": np.array([3.0, 2.0, 1.0]),
        "dual_infeasibility": np.array([1e-1, 1e-12, 0.0]),
        "violation": np.array([0.0, 1e-3, 1e-7]),
    }
    none = {key: values[:0] for key, values in trace.items()}
    figure = pictures.histories_figure({"one": trace, "two": none})
    for other in (figure, pictures.histories_figure({"a": none, "b": trace})):
        (legend,) = other.legends  # beside the curves, one for all soles
        assert [text.get_text() for text in legend.get_texts()] == [
            "dual infeasibility", "constraint violation",
        ]  # fmt: skip
    cost, empty, error, _ = figure.axes
    np.testing.assert_array_equal(cost.lines[0].get_data(), ([0, 1], [3, 2]))
    np.testing.assert_array_equal(cost.lines[1].get_data(), ([2], [1]))
    labels = [text.get_text() for text in cost.get_legend().get_texts()]
    assert labels == ["stage 1", "stage 2"]
    dual, violation = error.lines
    np.testing.assert_allclose(dual.get_ydata(), [1e-1, 1e-8, 1e-8])
    np.testing.assert_allclose(violation.get_ydata(), [1e-8, 1e-3, 1e-7])
    np.testing.assert_array_equal(dual.get_xdata(), [0, 1, 2])
    assert violation.get_label() == "constraint violation"
    assert error.get_yscale() == "log"
    (words,) = empty.texts
    assert words.get_text() == "no iterations"
    assert figure.axes[3].get_xlabel() == "iteration"
    assert "cost" in cost.get_ylabel() and "error" in error.get_ylabel()


@pytest.mark.slow
def test_both_costs_over_the_brick_s():
    points = [{"ratio_tr": 0.5, "ratio_rot": 1.5},
              {"ratio_tr": 0.25, "ratio_rot": 1.1}]  # fmt: skip
    rows = [{"name": "a", "ratio_tr": 0.7, "ratio_rot": 1.2},
            {"name": "b", "ratio_tr": 0.8, "ratio_rot": 1.3}]  # fmt: skip
    paper = {"a": (0.72, 1.21)}
    (axis,) = pictures.pareto_figure({"front": points}, rows, paper).axes
    drawn = [line.get_xydata().tolist() for line in axis.lines]
    assert drawn == [
        [[0.7, 1.2]],
        [[0.72, 1.21]],
        [[0.8, 1.3]],
        [],
        [[0.5, 1.5], [0.25, 1.1]],
    ]
    assert axis.lines[0].get_color() == axis.lines[1].get_color()
    assert "tr" in axis.get_xlabel() and "rot" in axis.get_ylabel()
    assert "initial shape" in axis.get_xlabel()
    axis.set_xlim(0.48, 2.4)
    FigureCanvasAgg(axis.figure).draw()
    ticks = axis.get_xticklabels(which="both")
    shown = {t.get_text() for t in ticks if 0.48 < t.get_position()[0] < 2.4}
    assert shown == {"0.5", "1", "2"}


# Sheets


@pytest.fixture(scope="module")
def sheet(mesh):
    """Two soles, the second longer at its toe than at first, and higher."""
    nodes = mesh.nodes * np.where(mesh.nodes[:, :1] > 0, 1.2, 1.0)
    change = np.linspace(-1.0, 2.0, len(mesh.nodes))
    soles = [
        ("first", "of it", mesh, mesh, change),
        ("second", "of that", mesh, mesh.with_nodes(nodes), change),
    ]
    figure = pictures.soles_figure(soles)
    figure.draw_without_rendering()
    return soles, figure


def _places(figure, soles):
    return np.array(figure.axes[: 4 * soles]).reshape(soles, 4)


@pytest.mark.slow
def test_texts_of_the_sheet_lie_apart(sheet):
    _assert_texts_lie_apart(sheet[1])


def test_views_have_a_page_to_themselves(sheet):
    """Side by side without a gap, one row below the other, none cut off."""
    soles, figure = sheet
    axes = _places(figure, 2)
    inches = figure.get_size_inches()
    boxes = np.array(
        [[a.get_position().get_points() * inches for a in row] for row in axes]
    )
    low, high = boxes[:, :, 0], boxes[:, :, 1]
    np.testing.assert_allclose(low[:, 0, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(high[:, -1, 0], inches[0])
    np.testing.assert_allclose(high[:, :-1, 0], low[:, 1:, 0])
    np.testing.assert_allclose(low[0, :, 1], high[1, :, 1])
    assert (low[1, :, 1] > 0.7).all() and (
        inches[1] - high[0, :, 1] > 0.3
    ).all()
    assert 6 < inches[0] < 16 and inches[1] < inches[0]
    every = np.concatenate([mesh.nodes for *_, mesh, _ in soles])
    for row in axes:
        for axis, view in zip(row, pictures.VIEWS, strict=True):
            below, above = pictures.extent(every, view)
            for ends, a, b in (
                (axis.get_xlim(), below[0], above[0]),
                (axis.get_ylim(), below[1], above[1]),
            ):
                assert ends[0] + 6.9 < a and b < ends[1] - 6.9
                assert sum(ends) == pytest.approx(a + b, abs=1e-6)
    # Nothing is lost: the widest view of the highest leaves no empty inch.
    free = [np.ptp(a.get_xlim()) - np.ptp(pictures.extent(every, v)[:, 0])
            for a, v in zip(axes[0], pictures.VIEWS, strict=True)]  # fmt: skip
    np.testing.assert_allclose(free, 14.0)


def test_each_view_says_its_name_above_itself(sheet):
    soles, figure = sheet
    axes, inches = _places(figure, 2), figure.get_size_inches()
    boxes = {text: box for (text, *_), box in _boxes(figure).items()}
    for axis, view in zip(axes[0], pictures.VIEWS, strict=True):
        place = axis.get_position().get_points() * inches
        words = boxes[view.name]
        middle = words[:, 0].mean()
        assert middle == pytest.approx(place[:, 0].mean())
        assert inches[1] - 0.3 < words[1, 1] < inches[1] - 0.08
        assert words[0, 1] > place[1, 1]
    for row, sole in zip(axes, soles, strict=True):
        top = row[0].get_position().y1 * inches[1]
        for words in sole[:2]:
            assert boxes[words][1, 1] == pytest.approx(top)
        assert boxes[sole[0]][0, 0] < 0.2
        assert boxes[sole[1]][0, 0] > boxes[sole[0]][1, 0]


def test_ends_are_named_where_they_are(sheet):
    """Heel at −x and toe at +x; seen from behind, left is left."""
    soles, figure = sheet
    for row, sole in zip(_places(figure, 2), soles, strict=True):
        for axis, view in zip(row, pictures.VIEWS, strict=True):
            if view.name == "from below, back left":
                assert not axis.texts
                continue
            lower = min(pictures.extent(m.nodes, view)[0, 1] for m in sole[2:4])
            ends = {"heel": (-0.1, 0, 0), "toe": (0.1, 0, 0)}
            if view.name == "back":
                ends = {"left": (0, 0.05, 0), "right": (0, -0.05, 0)}
            assert {text.get_text() for text in axis.texts} == set(ends)
            for text in axis.texts:
                wanted = 1e3 * view.axes()[0] @ ends[text.get_text()]
                x, y = text.get_position()
                assert x == pytest.approx(wanted)
                assert y == pytest.approx(lower - 3)
                side = "left" if wanted < 0 else "right"
                assert text.get_ha() == side and text.get_va() == "top"


def test_colours_of_a_sole_are_those_of_its_key(sheet, mesh):
    """White where nothing changed, the ends of the scale alike."""
    _, figure = sheet
    bar, key = figure.axes[-2:]
    assert bar.get_xlim() == pytest.approx((-2.0, 2.0))
    assert "[%]" in bar.get_xlabel()
    height = bar.get_position().height * figure.get_figheight()
    assert 0.1 < height < 0.15
    (scale, dashed) = key.lines
    words = {text.get_text(): text for text in key.texts}
    mm, shape = words["50 mm"], words["initial shape"]
    assert mm.get_position()[0] == pytest.approx(np.mean(scale.get_xdata()))
    assert mm.get_position()[1] < scale.get_ydata()[0]
    assert shape.get_position()[0] > dashed.get_xdata()[1]
    assert dashed.get_xdata()[0] > scale.get_xdata()[1] + 10
    assert shape.get_position()[1] == dashed.get_ydata()[0]
    # The silhouette before, in each view.
    for axis, view in zip(figure.axes[4:8], pictures.VIEWS, strict=True):
        ring = axis.lines[0].get_xydata()
        np.testing.assert_allclose(
            np.stack([ring.min(axis=0), ring.max(axis=0)]),
            pictures.extent(mesh.nodes, view),
            atol=1e-9,
        )
    norm = pictures.TwoSlopeNorm(0.0, -2.0, 2.0)
    change = np.zeros(len(mesh.nodes))
    change[0], change[1] = 2.0, -2.0
    colours = pictures._coloured(mesh, change, norm)
    faces = mesh.boundary_faces
    has = [(faces == k).any(axis=1) for k in (0, 1)]
    red, blue, grey = colours[has[0] & ~has[1]], colours[has[1] & ~has[0]], (
        colours[~has[0] & ~has[1]]
    )  # fmt: skip
    wanted = pictures._COLOURS(norm([2 / 3, -2 / 3, 0.0]))[:, :3]
    for found, colour in zip((red, blue, grey), wanted, strict=True):
        assert len(found)
        np.testing.assert_allclose(found, np.tile(colour, (len(found), 1)))
    assert red[0, 0] > red[0, 2] and blue[0, 2] > blue[0, 0]
    assert np.ptp(grey[0]) < 0.02 and grey.min() > 0.8


def test_no_change_at_the_origin_and_percent_elsewhere(mesh):
    class Twice:
        def stretch(self, nodes, p):
            return np.full(len(nodes), p)

    nodes = np.array([[0, 0, 0], [0, 0, -2e-9], [0.1, 0, 0]])
    found = pictures.radial_change(
        mesh.with_nodes(np.resize(nodes, mesh.nodes.shape)), Twice(), 1.03
    )
    np.testing.assert_allclose(found[:3], [0, 3, 3])


# Drawings


def test_a_section_is_as_large_as_the_cut(wedge):
    """Closed forms: rectangles across, a trapezoid along."""
    for x in (0.011, 0.05, 0.0873):
        axis = Figure().add_subplot()
        box = pictures._section(axis, wedge, 0, 1e3 * x, lambda p: p[:, 1:])
        tall = 1e3 * 0.02 * (1.5 + (x - 0.05) / 0.12)
        np.testing.assert_allclose(box, [[-20, -tall], [40, 0]], atol=1e-9)
        assert _area(axis) == pytest.approx(60 * tall)
    axis = Figure().add_subplot()
    box = pictures._section(axis, wedge, 1, 12.3, lambda p: p[:, [0, 2]])
    np.testing.assert_allclose(box, [[-10, -40], [110, 0]], atol=1e-9)
    assert _area(axis) == pytest.approx(120 * 30)
    axis = Figure().add_subplot()
    assert pictures._section(axis, wedge, 0, 120.0, lambda p: p[:, 1:]) is None
    assert not axis.collections


def _area(axis):
    """Of convex polygons side by side, each by its hull's shoelace."""
    (drawn,) = axis.collections
    total = 0.0
    for path in drawn.get_paths():
        x, y = path.vertices.T
        total += abs(x[:-1] @ y[1:] - x[1:] @ y[:-1] + x[-1] * y[0]
                     - x[0] * y[-1]) / 2  # fmt: skip
    return total


def _arrows(axis):
    """Dimensions of an axis: (start, end, words' place, words)."""
    lines = [t for t in axis.texts if getattr(t, "arrowprops", None)]
    words = [t for t in axis.texts if t.get_text()]
    found = []
    for arrow in lines:
        start, end = np.array(arrow.xyann), np.array(arrow.xy)
        near = min(
            words,
            key=lambda t, m=0.5 * (start + end): np.linalg.norm(
                np.array(t.get_position()) - m
            ),
        )
        found.append((start, end, near))
    return found


@pytest.mark.slow
def test_dimensions_stand_where_they_measure(wedge):
    """Arrows as long as they say, the words half-way, turned if upright."""
    figure = pictures.drawing_figure(wedge, "it", np.ones(len(wedge.contact)))
    above, _, side, along, across, _ = figure.axes[:6]
    at = -10 + 120 * np.array([0.15, 0.5, 0.85])
    tall = 20 + 20 * np.array([0.15, 0.5, 0.85])
    for axis, wanted in (
        (above, [[(-10, -27), (110, -27)], [(117, -20), (117, 40)]]),
        (side, [[(117, -40), (117, 0)]]),
        (along, [[(x, -t), (x, 0)] for x, t in zip(at, tall, strict=True)]),
        (
            across,
            [
                ends
                for k, t in enumerate(tall)
                for ends in (
                    [(20, -68 * k - t - 6), (80, -68 * k - t - 6)],
                    [(50, -68 * k - t), (50, -68 * k)],
                )
            ],
        ),
    ):
        arrows = _arrows(axis)
        assert len(arrows) == len(wanted)
        for (start, end, words), (a, b) in zip(arrows, wanted, strict=True):
            np.testing.assert_allclose(start, a, atol=1e-2)
            np.testing.assert_allclose(end, b, atol=1e-2)
            np.testing.assert_allclose(
                words.get_position(), 0.5 * (start + end)
            )
            length = np.linalg.norm(end - start)
            assert float(words.get_text()) == pytest.approx(length, abs=0.06)
            upright = abs(end - start)[1] > 0
            assert words.get_rotation() == (90 if upright else 0)
    # Where it is cut: a line over the whole width, the letter above it.
    lines = [line.get_xydata() for line in above.lines]
    letters = [t for t in above.texts if t.get_text() in "ABC" and t.get_text()]
    for line, letter, x in zip(lines, letters, at, strict=True):
        np.testing.assert_allclose(line, [[x, -23], [x, 43]], atol=1e-6)
        np.testing.assert_allclose(letter.get_position(), (x, 44), atol=1e-6)
    letters = [t for t in across.texts if t.get_text() in ("A", "B", "C")]
    for k, (letter, t) in enumerate(zip(letters, tall, strict=True)):
        assert letter.get_text() == "ABC"[k]
        middle = (14, -68 * k - t / 2)
        np.testing.assert_allclose(letter.get_position(), middle, atol=1e-6)
    # Seen from behind left is left: the sole's left is 40 mm from x = 0.
    cuts = across.collections[0].get_paths()
    x = np.concatenate([p.vertices[:, 0] for p in cuts])
    np.testing.assert_allclose([x.min(), x.max()], [20, 80], atol=1e-6)


@pytest.mark.slow
def test_a_drawing_has_one_scale_and_cuts_nothing_off(wedge):
    figure = pictures.drawing_figure(wedge, "it", np.ones(len(wedge.contact)))
    _assert_texts_lie_apart(figure)
    scales = []
    for axis in figure.axes[:6]:
        box = axis.get_window_extent()
        scales.append(box.width / np.ptp(axis.get_xlim()) / figure.dpi)
        upright = box.height / np.ptp(axis.get_ylim()) / figure.dpi
        assert upright == pytest.approx(scales[-1], rel=1e-6)
        np.testing.assert_allclose(axis.get_xlim(), [-28, 128])
        x, y = axis.get_xlim(), axis.get_ylim()
        for words in axis.texts:
            if words.get_text():
                at = words.get_position()
                assert x[0] < at[0] < x[1] and y[0] < at[1] < y[1]
        for drawn in axis.collections:
            for path in drawn.get_paths():
                low, high = path.vertices.min(0), path.vertices.max(0)
                assert x[0] < low[0] and high[0] < x[1]
                assert y[0] < low[1] and high[1] < y[1]
    assert np.ptp(scales[:5]) < 1e-3 * scales[0]


def test_the_largest_pressure_is_marked(wedge):
    peak = np.linspace(1e3, 9e3, len(wedge.contact))
    peak[7] = 55.4e3
    figure = pictures.drawing_figure(wedge, "it", peak)
    axis = figure.axes[5]
    place = 1e3 * wedge.nodes[wedge.contact[7], :2]
    np.testing.assert_allclose(axis.lines[0].get_xydata(), [place])
    drawn = next(c for c in axis.collections if c.get_array() is not None)
    np.testing.assert_allclose(drawn.get_array(), 1e-3 * peak)
    assert drawn.get_clim() == (0, pytest.approx(55.4))
    np.testing.assert_allclose(axis.get_ylim(), [-38, 58])
    assert "55 kPa" in axis.get_title()


@pytest.mark.parametrize("wider", [-0.5, 0.0, 0.5])
def test_red_is_a_side_that_looks_up(wider):
    """A sole wider below than above is held by its mould."""
    mesh = brick((0.12, 0.06, 0.02), (4, 2, 1))
    nodes = mesh.nodes.copy()
    nodes[:, :2] *= 1 - wider * nodes[:, 2:] / 0.02
    drawn = []
    axis = Figure().add_subplot()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "draw", lambda *given: drawn.extend(given))
        pictures._shaded(axis, mesh.with_nodes(nodes), ABOVE, "title")
    _, corners, colours, _ = drawn
    assert len(corners) == len(mesh.boundary_faces)
    mine = np.isclose(colours, pictures._UNDERCUT).all(axis=1)
    plain = np.isclose(colours, pictures._RUBBER).all(axis=1)
    assert (mine | plain).all()
    # Twelve quads of the sides, two triangles each.
    assert mine.sum() == (12 * 2 if wider > 0 else 0)
    low, high = pictures.extent(nodes, ABOVE)
    np.testing.assert_allclose(axis.get_ylim(), [low[1] - 18, high[1] + 18])


@pytest.mark.slow
def test_what_stands_at_the_side_of_a_thickness_is_not_measured(wedge):
    """Only between the lowest and the highest face over the point."""
    axis = Figure().add_subplot()
    pictures._thickness(axis, wedge, 20.0, -5.0, 7.0, lift=-100.0)
    ((start, end, words),) = _arrows(axis)
    tall = 20 * (1.5 + (20 - 50) / 120)
    np.testing.assert_allclose(start, (7, -100 - tall), atol=1e-3)
    np.testing.assert_allclose(end, (7, -100), atol=1e-3)
    assert words.get_text() == f"{tall:.1f}"
    axis = Figure().add_subplot()
    pictures._thickness(axis, wedge, 130.0, 0.0, 0.0)
    assert not axis.texts


def test_a_thickness_is_measured_on_the_mesh_s_own_lines():
    axis = Figure().add_subplot()
    mesh = brick((0.3, 0.12, 0.025), (20, 8, 3))
    for x in (0.0, 15.0, 45.0):
        pictures._thickness(axis, mesh, x, 0.0, x)
    assert [words.get_text() for *_, words in _arrows(axis)] == 3 * ["25.0"]
