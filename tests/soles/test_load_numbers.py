"""Loads and the files they come from, number by number."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.soles.load_blocks import (
    Constant,
    Csv,
    ForcePlate,
    LoadBlock,
    OneFoot,
    Playback,
    share_double_support,
    stances,
)
from drake_exo.soles.loads import Load, read_csv
from drake_exo.soles.numerics import rotation_z, rotations_xyz

COUNT = 6


@pytest.fixture
def load():
    """Every number another one."""
    s = np.arange(float(COUNT))
    return Load(
        0.1 * s + 0.05 * s**2,
        np.stack([10 + s, 20 - s, 200 + 10 * s], axis=1),
        np.stack([0.01 * s, 0.02 - 0.005 * s], axis=1),
        "it",
        0.1 * s,
        rotations_xyz(np.stack([0.01 * s, 0.02 * s, 0.03 * s], axis=1)),
    )


# Loads


def test_samples_are_picked_with_all_that_belongs_to_them(load):
    some = load.at(np.array([1, 4]))
    for name in ("times", "force", "zmp", "free_moment", "rotation"):
        np.testing.assert_array_equal(
            getattr(some, name), getattr(load, name)[[1, 4]]
        )
    np.testing.assert_array_equal(load.every(3).times, load.times[[0, 2, 5]])
    np.testing.assert_array_equal(load.every(99).times, load.times)
    assert load.every(1).times == [load.times[0]]
    assert load.largest_force == pytest.approx(
        np.sqrt(15.0**2 + 15.0**2 + 250.0**2)
    )


def test_a_load_seen_from_a_foot_is_the_same_load(load):
    """Its moment about a point of the world, as before."""
    origin, yaw = np.array([0.3, -0.2]), 0.4
    seen = load.placed(origin, yaw)
    turn = rotation_z(yaw)
    np.testing.assert_allclose(seen.force @ turn.T, load.force)
    there = seen.zmp @ turn[:2, :2].T + origin
    np.testing.assert_allclose(there, load.zmp, atol=1e-12)
    np.testing.assert_allclose(turn @ seen.rotation, load.rotation, atol=1e-12)
    np.testing.assert_array_equal(seen.free_moment, load.free_moment)


def test_straight_leaves_what_is_forward_and_up(load):
    found = load.straight()
    np.testing.assert_array_equal(found.force[:, [0, 2]], load.force[:, [0, 2]])
    np.testing.assert_array_equal(found.zmp[:, 0], load.zmp[:, 0])
    assert not found.force[:, 1].any() and not found.zmp[:, 1].any()
    assert found.free_moment is None


def test_phases_of_a_load_stay_among_others(load):
    two = Load.one_after_another([load, load], [1.0, 3.0])
    both = Load.one_after_another([two, load], [1.0, 1.0])
    n = len(load.times)
    assert both.begins == (0, n, 2 * n)
    assert both.weights == (0.25, 0.75, 1.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda _: Load.one_after_another([], []), "0 loads"),
        (lambda x: Load.one_after_another([x], [1, 2]), "1 loads and 2 w"),
        (lambda x: replace(x, force=[["a"] * 3] * len(x.times)), "no numbers"),
        (lambda x: replace(x, force=[[1], [1, 2]]), "no numbers"),
        (
            lambda x: replace(x, rotation=[2 * np.eye(3)] * len(x.times)),
            "are not rotations",
        ),
    ],
)
def test_what_is_no_load_is_refused(load, make, words):
    with pytest.raises(InputError, match=words):
        make(load)


def test_one_after_another_and_apart_again(load):
    short = load.at(np.arange(2))
    both = Load.one_after_another([load, short, load], [1, 2, 5])
    n = COUNT
    assert both.begins == (0, n, n + 2) and len(both.times) == 2 * n + 2
    np.testing.assert_allclose(np.diff(both.times)[[n - 1, n + 1]], 0.2)
    np.testing.assert_allclose(
        np.diff(both.times)[n + 2 :], np.diff(load.times)
    )
    assert both.phase.tolist() == [0] * n + [1] * 2 + [2] * n
    assert both.phases == [
        slice(0, n),
        slice(n, n + 2),
        slice(n + 2, 2 * n + 2),
    ]
    np.testing.assert_allclose(both.shares, [0.125, 0.25, 0.625])
    last = both.at(np.arange(2 * n + 2)[both.phases[2]])
    np.testing.assert_array_equal(last.force, load.force)
    assert (last.begins, last.weights) == ((0,), (5.0,))
    # Some samples of the second and the third alone.
    some = both.at(np.array([n + 1, n + 3, n + 4]))
    assert (some.begins, some.weights) == ((0, 1), (2.0, 5.0))


def test_what_only_one_of_two_loads_has(load):
    plain = Load(load.times, load.force, load.zmp)
    both = Load.one_after_another([plain, load], [1, 1])
    np.testing.assert_array_equal(
        both.free_moment, [*np.zeros(COUNT), *load.free_moment]
    )
    assert both.is_measured.tolist() == [False] * COUNT + [True] * COUNT
    assert both.target(2, None).rotation is None
    target = both.target(COUNT + 3, "reference")
    np.testing.assert_array_equal(target.rotation, load.rotation[3])
    np.testing.assert_array_equal(target.force, load.force[3])
    np.testing.assert_array_equal(target.zmp, load.zmp[3])
    assert target.moment == pytest.approx(0.3) and target.height == 0.0
    assert target.reference == "reference"
    assert not plain.is_measured.any() and plain.target(0, None).moment == 0
    none = Load.one_after_another([plain, plain], [1, 1])
    assert none.free_moment is None and none.rotation is None


def test_friction_is_asked_for_along_the_ground():
    """On a slope of 3 to 4 a vertical force asks for three quarters."""
    force = np.array([[0, 0, 100], [30, 40, 100], [80, 0, 60], [60, 0, 80.0]])
    load = Load(np.arange(4.0), force, np.zeros((4, 2)), "it")
    flat, slope = np.array([0, 0, 1.0]), np.array([0.6, 0, 0.8])
    np.testing.assert_allclose(
        load.friction_used(flat), [0, 0.5, 80 / 60, 0.75]
    )
    found = load.friction_used(slope)
    assert found[0] == pytest.approx(0.75)
    np.testing.assert_allclose(found[3], 0.0, atol=1e-12)
    pulled = Load([0.0], [[-200.0, 0, 100]], [[0.0, 0]])
    assert pulled.friction_used(slope)[0] == np.inf
    load.at(np.array([0, 1])).check_friction(0.501, flat)
    with pytest.raises(InputError, match=r"at 1 s asks for .* 0\.500 .*; 3 of"):
        load.check_friction(0.5, flat)


def test_moments_are_cut_to_what_a_line_bears():
    """μ F w / 4 of what friction the force along the ground leaves."""
    force = np.array([[30, 40, 100], [0, 0, 100], [30, 40, 100], [90, 0, 100]])
    load = Load(
        np.arange(4.0), force, np.zeros((4, 2)), "it",
        np.array([0.8, -9.0, -0.4, 0.1]),
    )  # fmt: skip
    flat = np.array([0.0, 0.0, 1.0])
    found = load.bearable(0.8, 0.08, flat)
    # 0.8 · 100 − 50 = 30 N, 80 N, 30 N, none; a quarter of 0.08 m.
    np.testing.assert_allclose(found.free_moment, [0.6, -1.6, -0.4, 0.0])
    assert found.moments_cut == 3
    plain = Load(load.times, load.force, load.zmp)
    assert plain.bearable(0.8, 0.08, flat) is plain
    # On a slope about its normal: 0.8 · 0.8 · 100 − 0.6 · 100 N along it.
    upright = replace(load, force=np.tile([0, 0, 100.0], (4, 1)))
    found = upright.bearable(0.8, 0.08, np.array([0.6, 0.0, 0.8]))
    np.testing.assert_allclose(found.free_moment, [0.1, -0.1, -0.1, 0.1])


def test_a_zmp_outside_is_told_by_how_much():
    """And how far the middle of its path is off the sole's."""
    places = np.array([[-0.1, -0.04], [0.2, -0.04], [0.2, 0.06], [-0.1, 0.06]])
    force = np.tile([0.0, 0, 100], (3, 1))
    zmp = np.array([[0.15, 0.0], [0.205, 0.05], [0.21, 0.1]])
    load = Load([0.0, 0.5, 1.0], force, zmp, "it")
    load.at(np.array([0])).check_inside(places)
    with pytest.raises(InputError) as caught:
        load.check_inside(places)
    said = str(caught.value)
    assert "outside the sole by 5.0 mm at 0.5 s" in said
    assert "x 0.2050 m, y 0.0500 m" in said and "2 of 3 samples" in said
    assert "100 N at most there)" in said  # what least_force_n has to leave out
    # Its middle at (180, 50) mm, the sole's at (50, 10).
    assert (
        "130 mm in front and 40 mm to the left" in said
        and "least_force_n" in said
    )
    assert "in a pattern least_share" in said and "not mm" not in said
    with pytest.raises(InputError, match="8 mm behind and 112 mm to the right"):
        load.check_inside(np.add(places, [0.138, 0.152]))
    far = Load([0.0, 0.5, 1.0], force, 1e3 * zmp, "it")
    with pytest.raises(InputError, match="3 samples; the ZMP is in m, not mm"):
        far.check_inside(places)
    edge = Load([0.0], force[:1], [[0.2, 0.06]])
    edge.check_inside(places)
    # Where the pose is given, it is only what was recorded.
    given = np.full((3, 3, 3), np.nan)
    given[2] = np.eye(3)
    with pytest.raises(InputError, match="1 of 3 samples"):
        replace(load, rotation=given).check_inside(places)
    given[1] = np.eye(3)
    replace(load, rotation=given).check_inside(places)


@pytest.mark.parametrize(
    ("times", "up", "sentence"),
    [
        ([0, 1, 1], [1, 1, 1], r"two samples at one time \(1 s\)"),
        ([0, 2, 1], [1, 1, 1], r"runs backwards \(1 s\)"),
        (
            [0, 1, 2],
            [5, -3, 0.5],
            "is -3 N at 1 s.*leave the swing phase out, and",
        ),
        ([0, 1, 2], [-1, -3, 2], "turn all signs: .* or, where z points down"),
        ([0, 1, np.nan], [1, 1, 1], "times holds NaN"),
        ([], [], "no samples"),
        (range(100_001), [1] * 100_001, "100001 samples, more than 100000"),
    ],
)
def test_bad_samples_are_named(times, up, sentence):
    force = np.zeros((len(up), 3))
    force[:, 2] = up
    with pytest.raises(InputError, match=sentence):
        Load(times, force, np.zeros((len(up), 2)))


# Files


def _written(path, head, rows, separator=" "):
    lines = [separator.join(f"{v:.9g}" for v in row) for row in rows]
    path.write_text("\n".join([*head, *lines]) + "\n")


def test_the_authors_file_of_one_foot(tmp_path):
    rng = np.random.default_rng(0)
    table = rng.uniform(0.5, 1, (9, 8))
    table[:, 0] = np.arange(9)
    _written(tmp_path / "foot.txt", ["# head"], table)
    load = OneFoot("foot.txt", (0.3, 0.4), 2, 3).load(tmp_path)
    np.testing.assert_allclose(load.times, [2, 3, 4, 5])
    np.testing.assert_allclose(load.zmp, table[2:6, 1:3] - [0.3, 0.4])
    np.testing.assert_allclose(load.force, table[2:6, 5:8])
    table[4, 3] = np.nan
    _written(tmp_path / "foot.txt", ["# head"], table)
    with pytest.raises(InputError, match=r"foot\.txt:6: .*1 such rows"):
        OneFoot("foot.txt", (0.3, 0.4), 2, 3).load(tmp_path)
    _written(tmp_path / "foot.txt", [], table)
    with pytest.raises(InputError, match=r"foot\.txt:1: holds numbers where"):
        OneFoot("foot.txt", (0.3, 0.4), 2, 3).load(tmp_path)
    table[4, 3] = 0.5
    for count in ("9", "--------"):  # rows, or a line
        _written(tmp_path / "foot.txt", [count], table)
        again = OneFoot("foot.txt", (0.3, 0.4), 2, 3).load(tmp_path)
        np.testing.assert_allclose(again.times, load.times)


def test_a_table_of_several_loads(tmp_path, load):
    head = ("time_s,zmp_y_m,force_x_n,load,force_y_n,force_z_n,zmp_x_m,weight,"
            "free_moment_nm")  # fmt: skip
    number = np.array([0, 0, 1, 1, 1, 2])
    weight = np.array([2.0, 2, 3, 3, 3, 7])
    columns = [
        load.times, load.zmp[:, 1], load.force[:, 0], number,
        load.force[:, 1], load.force[:, 2], load.zmp[:, 0], weight,
        load.free_moment,
    ]  # fmt: skip
    path = tmp_path / "load.csv"
    _written(path, [head], np.transpose(columns), ",")
    found = read_csv(path)
    for name in ("times", "force", "zmp", "free_moment"):
        np.testing.assert_allclose(getattr(found, name), getattr(load, name))
    assert (found.begins, found.weights) == ((0, 2, 5), (2.0, 3.0, 7.0))
    placed = Csv("load.csv", (0.1, 0.2), 0.3).load(tmp_path)
    wanted = found.placed((0.1, 0.2), 0.3)
    np.testing.assert_array_equal(placed.zmp, wanted.zmp)
    np.testing.assert_array_equal(placed.force, wanted.force)


def test_a_plate_of_opensim_is_turned_upright(tmp_path):
    """x forward, y up, z right: forward, left, up."""
    names = [f"p_{s}{axis}" for s in "vpm" for axis in "xyz"]
    rng = np.random.default_rng(1)
    table = np.column_stack([0.1 * np.arange(8), rng.uniform(0, 1, (8, 9))])
    table[:, 2] = [0, 300, 10, 300, 200, 30, 10, 0]  # up
    _written(
        tmp_path / "grf.mot",
        ["it", "version=1", "nRows=8", "nColumns=10", "inDegrees=no",
         "endheader", "\t".join(["time", *names])],
        table, "\t",
    )  # fmt: skip
    plate = ForcePlate("grf.mot", "p", 0.2, 0.6, (0.5, -0.25), 0.0, 20.0)
    load = plate.load(tmp_path)
    rows = [3, 4, 5]  # in the window from the first to the last above 20 N
    vx, vy, vz, px, _, pz, _, my, _ = table[rows, 1:].T
    np.testing.assert_allclose(load.times, table[rows, 0])
    np.testing.assert_allclose(load.force, np.stack([vx, -vz, vy], axis=1))
    np.testing.assert_allclose(
        load.zmp, np.stack([px - 0.5, -pz + 0.25], axis=1)
    )
    np.testing.assert_allclose(load.free_moment, my)
    turned = ForcePlate("grf.mot", "p", 0.2, 0.6, (0.5, -0.25), 0.3, 20.0)
    wanted = load.placed((0.0, 0.0), 0.3)
    np.testing.assert_allclose(turned.load(tmp_path).zmp, wanted.zmp)
    with pytest.raises(InputError, match=r"less than 20 N from 0\.6 to 0\.7"):
        ForcePlate("grf.mot", "p", 0.6, 0.7, (0.0, 0.0)).load(tmp_path)
    with pytest.raises(InputError, match="or a lower least_force_n"):
        ForcePlate(
            "grf.mot", "p", 0.2, 0.6, (0.0, 0.0), least_force_n=2000.0
        ).load(tmp_path)
    with pytest.raises(InputError, match=r"end_s \(0.2\) is before start_s"):
        ForcePlate("grf.mot", "p", 0.6, 0.2, (0.0, 0.0))


# Both feet of a walk: 0 both, 1 left, 2 right.
PHASE = np.array([0, 0, 1, 1, 1, 0, 0, 0, 2, 2, 0, 0, 1, 1, 0, 0, 2, 2, 2, 0])


def test_stances_are_whole_ones_with_both_double_supports():
    assert stances(PHASE, 2) == [(5, 12)]
    assert stances(PHASE, 1) == [(10, 16)]
    assert stances(np.array([1, 0, 2, 0, 1]), 2) == [(1, 4)]
    assert stances(np.array([2, 0, 1, 0]), 2) == []


def _zmp():
    """Left feet at y = 0.1, right ones at −0.1; straight in between."""
    x = np.cumsum(np.where(PHASE == 0, 0.04, 0.01))
    y = np.interp(
        np.arange(20), np.flatnonzero(PHASE), np.array([0, 0.1, -0.1])[
            PHASE[PHASE > 0]]
    )  # fmt: skip
    return np.stack([x, y + 0.002 * np.sin(np.arange(20))], axis=1)


def test_both_feet_add_up_to_the_whole():
    zmp = _zmp()
    (left, a), (right, b) = (
        share_double_support(zmp, PHASE, k) for k in (1, 2)
    )
    rows = slice(5, 16)
    np.testing.assert_allclose((left + right)[rows], 1.0)
    total = left[:, None] * a + right[:, None] * b
    np.testing.assert_allclose(total[rows], zmp[rows])
    for k, share, own in ((1, left, a), (2, right, b)):
        alone, other = np.equal(PHASE, k), np.equal(PHASE, 3 - k)
        assert (share[alone] == 1).all() and not share[other].any()
        np.testing.assert_array_equal(own[alone], zmp[alone])
    # From the last place on the left foot to the first on the right one.
    A, B = zmp[4], zmp[8]
    for q in (5, 6, 7):
        alpha = (zmp[q] - A) @ (B - A) / ((B - A) @ (B - A))
        assert right[q] == pytest.approx(alpha) and 0 < alpha < 1
        # Each foot is off its own place by the same.
        np.testing.assert_allclose(a[q] - A, b[q] - B)
        assert (a[q] - A) @ (B - A) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("foot", "side"), [("left", 1), ("right", -1)])
def test_a_stance_of_a_playback(tmp_path, foot, side):
    mine = 1 if foot == "left" else 2
    rng = np.random.default_rng(2)
    table = rng.uniform(-1, 1, (20, 37))
    table[:, 0], table[:, 1:3] = PHASE, _zmp()
    _written(tmp_path / "walk.txt", [], table)
    block = Playback("walk.txt", foot, 0, 40.0, 0.01, 10.0, (0.02, 0.01), 30.0)
    load = block.load(tmp_path)
    share, own = share_double_support(table[:, 1:3], PHASE, mine)
    force = 40.0 * (table[:, 10:13] + [0, 0, 10.0])
    first, last = stances(PHASE, mine)[0]
    rows = [q for q in range(first, last) if share[q] * force[q, 2] >= 30.0]
    np.testing.assert_allclose(load.times, 0.01 * np.array(rows))
    np.testing.assert_allclose(
        load.force, (share[:, None] * force)[rows], rtol=1e-6
    )
    # The ankle in the middle of its single support; outward is its own side.
    middle = (8, 9)[1] if foot == "right" else (12, 13)[1]
    column = 13 if foot == "left" else 22
    centre = table[middle, column : column + 2] + [0.02, side * 0.01]
    np.testing.assert_allclose(load.zmp, own[rows] - centre, atol=1e-7)
    with pytest.raises(InputError, match="1 stances; step 1"):
        Playback("walk.txt", foot, 1).load(tmp_path)
    with pytest.raises(InputError, match="never carries 20 N; check mass_kg"):
        Playback("walk.txt", foot, 0, mass_kg=1.0).load(tmp_path)
    still = table.copy()
    still[:, 1:3] = 0.1
    _written(tmp_path / "walk.txt", [], still)
    with pytest.raises(InputError, match=r"walk\.txt: the ZMP .* not move"):
        Playback("walk.txt", foot, 0).load(tmp_path)
    table[:, 0] = np.where(PHASE == 0, 3, PHASE)
    _written(tmp_path / "walk.txt", [], table)
    with pytest.raises(InputError, match=r"walk\.txt: .* the phase 3; write 0"):
        Playback("walk.txt", foot, 0).load(tmp_path)


def test_a_constant_load_is_5_ms_apart():
    load = Constant((1.0, 2.0, 300.0), (0.01, 0.02), 4).load()
    np.testing.assert_allclose(load.times, [0, 0.005, 0.01, 0.015])
    np.testing.assert_array_equal(load.force, 4 * [[1.0, 2.0, 300.0]])
    np.testing.assert_array_equal(load.zmp, 4 * [[0.01, 0.02]])


_FORCE, _ZMP = [[0, 0, 300.0]] * 2, [[0.0, 0.01]] * 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"force": _FORCE[:1]}, "force has the shape"),
        ({"zmp": [[0.0, 0.0, 0.0]] * 2}, "zmp has the shape"),
        ({"free_moment": [0.0]}, "free_moment has the shape"),
        ({"free_moment": [0.0, np.nan]}, "free_moment holds NaN"),
        ({"rotation": np.eye(3)}, "rotation has the shape"),
        (
            {"rotation": [np.diag([1.0, -1, 1])] * 2},
            "rotation holds matrices that are not",
        ),
        ({"begins": (0, 5), "weights": (1.0, 1.0)}, "begins is"),
        ({"begins": (1,)}, "begins is"),
        ({"weights": (1.0, 2.0)}, "one above 0 for each of 1"),
        ({"weights": (-1.0,)}, "one above 0"),
        ({"weights": (np.nan,)}, "one above 0"),
    ],
)
def test_a_load_made_in_python_is_whole(change, words):
    given = {"times": [0.0, 0.1], "force": _FORCE, "zmp": _ZMP} | change
    with pytest.raises(InputError, match=words):
        Load(**given)


def test_a_load_keeps_its_numbers():
    force = np.array(_FORCE)
    load = Load([0.0, 0.1], force, _ZMP)
    force[:] = 0.0
    assert (load.force[:, 2] == 300.0).all()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"begin": "x"}, "from must be a number .s., but is 'x'"),
        ({"end": float("nan")}, "to is nan, but must be a finite number"),
        ({"begin": "x", "end": "y"}, "from must be a number"),
    ],
)
def test_a_part_of_a_recording_is_numbers_or_events(given, said):
    with pytest.raises(InputError, match=said):
        LoadBlock(recording="a.yaml", trial="walk", foot="left", **given)
