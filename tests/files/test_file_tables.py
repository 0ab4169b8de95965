"""Tables, units and times: each number by hand."""

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.mesh import read_cells
from drake_exo.files.tables import (
    LENGTHS,
    UNITS,
    Table,
    check_gaps,
    check_increasing,
    frame_rate,
    kept,
    number_rows,
    plate_axes,
    read_csv_table,
    runs,
    uniform_time,
    write_csv_table,
)

ONE_IN_SI = {
    "s": 1.0, "ms": 0.001, "rad": 1.0, "deg": 0.017453292519943295,
    "nm": 1.0, "n m": 1.0, "n": 1.0, "m": 1.0, "mm": 0.001,
}  # fmt: skip


def test_units_are_those_of_the_si(tmp_path):
    assert pytest.approx(ONE_IN_SI) == UNITS
    assert LENGTHS == {"m": 1.0, "cm": 0.01, "mm": 0.001}
    head = ",".join(f"a{i} [{unit}]" for i, unit in enumerate(UNITS))
    path = tmp_path / "t.csv"
    ones = ",".join(["1"] * (1 + len(UNITS)))
    twos = ones.replace("1", "2")
    path.write_text(f"time [s],{head}\n{ones}\n{twos}\n")
    table = read_csv_table(path)
    np.testing.assert_allclose(table.values[0], list(ONE_IN_SI.values()))
    np.testing.assert_allclose(table.values[1], 2.0 * table.values[0])
    # What is written in degrees and millimetres, as a reader sees it.
    table = Table(np.array([0.0, 0.5]), ("a", "b"), np.array([[0.5, 2.0]] * 2))
    write_csv_table(path, table, ["deg", "mm"])
    head, *rows = path.read_text().splitlines()
    assert head == "time [s],a [deg],b [mm]"
    found = [[float(x) for x in row.split(",")] for row in rows]
    np.testing.assert_allclose(
        found, [[0, 28.64788976, 2e3], [0.5, 28.64788976, 2e3]]
    )


def test_runs_begin_and_end_where_they_do():
    mask = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1], bool)
    assert runs(mask) == [[0, 2], [3, 4], [6, 9]]
    assert runs(~mask) == [[2, 3], [4, 6]]
    assert runs(np.zeros(3, bool)) == []


def test_axes_of_a_plate_follow_its_corners():
    """x from the second corner to the first, y from the fourth."""
    corners = np.array(
        [[3.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 4.0, 0.0], [3.0, 4.0, 0.0]]
    )
    expected = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(plate_axes(corners), expected.T, atol=1e-12)
    # A right-handed frame, whatever the corners.
    skew = corners + np.random.default_rng(0).normal(0.0, 0.1, (4, 3))
    R = plate_axes(skew)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, 0] @ (skew[0] - skew[1]) == pytest.approx(
        np.linalg.norm(skew[0] - skew[1])
    )


@pytest.mark.parametrize(
    ("degrees", "span", "words"),
    [
        (False, (0.0, 6.3), "can only be degrees"),
        (False, (0.0, 6.28), None),
        (False, (-6.3, 0.0), "can only be degrees"),
        (True, (0.0, 0.36), "look like radians"),
        (True, (0.0, 0.34), None),
        (True, (2.5, 3.1), "look like radians"),
        (True, (2.5, 3.2), None),
    ],
)  # fmt: skip
def test_angles_tell_their_unit(degrees, span, words):
    """Beyond a turn: degrees. Within half and moving by 20°: radians."""
    angles = np.column_stack([np.linspace(*span, 20), np.full(20, span[0])])
    table = Table(np.arange(20.0), ("a", "b"), angles, degrees, "f")
    if words is None:
        table.in_radians(table.names)
        return
    with pytest.raises(InputError, match=words):
        table.in_radians(table.names)


def test_only_angles_are_turned_into_radians():
    table = Table(
        np.arange(2.0), ("knee", "pelvis_tx", "slide"),
        np.array([[90.0, 2.0, 3.0], [180.0, 2.0, 3.0]]), True, "f",
    )  # fmt: skip
    found = table.in_radians(("knee",))
    np.testing.assert_allclose(
        found.values, [[np.pi / 2, 2.0, 3.0], [np.pi, 2.0, 3.0]]
    )
    assert found.in_degrees is False


@pytest.mark.parametrize("text", ["0", "-5", "1e6", "x", None, "nan", "inf"])
def test_a_rate_is_positive_and_below_a_megahertz(text):
    assert frame_rate("f", "9.9e5", "Rate") == 9.9e5
    assert frame_rate("f", "0.5", "Rate") == 0.5
    with pytest.raises(InputError, match="write frames per second"):
        frame_rate("f", text, "Rate")


def test_numbers_of_rows_are_told_by_their_line():
    rows = [(3, ["1", " "]), (5, ["2", "1e30"])]
    found = number_rows("f", rows, 2)
    np.testing.assert_array_equal(found, [[1.0, np.nan], [2.0, 1e30]])
    with pytest.raises(InputError, match=r"f:5: '-2e30' is larger"):
        number_rows("f", [rows[0], (5, ["2", "-2e30"])], 2)
    with pytest.raises(InputError, match=r"f:5: has 4 .* decimal commas$"):
        number_rows("f", [rows[0], (5, ["0", "01", "1", "5"])], 2)
    comma = r"\('-,02'\); export it with decimal points, not commas$"
    with pytest.raises(InputError, match=rf"^f:5: holds text .* {comma}"):
        number_rows("f", [rows[0], (5, ["1", "-,02"])], 2)


def test_gaps_are_counted():
    values = np.arange(12.0).reshape(6, 2)
    values[[2, 4], [0, 1]] = np.nan
    time = 0.5 * np.arange(6)
    with pytest.raises(
        InputError, match="no value in 2 of 6 frames, first at 1 s"
    ):
        check_gaps("f", "a", time, values)


def test_times_that_do_not_increase_are_told_by_frame():
    with pytest.raises(InputError, match=r"from 2 to 1\.5 s \(frame 4\)"):
        check_increasing("f", np.array([0.0, 1.0, 2.0, 1.5, 3.0]))
    with pytest.raises(InputError, match="time of frame 3 is missing; cor"):
        check_increasing("f", np.array([0.0, 1.0, np.nan, 1.5]))


def test_even_times_take_the_header_s_rate_where_it_fits():
    """Within the rounding of the stamps; a header may be rounded itself."""
    for digits, true, fits in (
        (3, 60.0, True),
        (3, 80.0, True),
        (6, 60.0, True),
        (6, 59.94, False),
        (3, 59.94, False),
        (12, 100.1, False),
    ):
        exact = 2.0 + np.arange(150) / true
        time = np.round(exact, digits)
        found = uniform_time("f", time, np.round(true))
        own = np.linspace(time[0], time[-1], len(time))
        np.testing.assert_allclose(found, exact if fits else own, atol=1e-9)
    np.testing.assert_allclose(uniform_time("f", own), own)


@pytest.mark.parametrize(
    ("rate", "n", "words"),
    [
        (101.5, 60, None),
        (102.5, 60, "102.5 frames a second"),
        (102.5, 10, None),
        (119.0, 15, None),
        (121.0, 15, "121 frames a second"),
        (81.0, 15, None),
        (79.0, 15, "79 frames a second, the time column 100"),
    ],
)
def test_header_and_times_may_differ_by_two_percent(rate, n, words):
    """By a fifth where there are less than twenty frames."""
    time = np.arange(n) / 100.0
    if words is None:
        assert len(uniform_time("f", time, rate)) == n
        return
    with pytest.raises(InputError, match=words):
        uniform_time("f", time, rate)


@pytest.mark.parametrize(("off", "fits"), [(0.42, True), (0.48, False)])
def test_stamps_may_be_off_by_nearly_half_a_frame(off, fits):
    time = 1.0 + np.arange(100.0)
    time[50] += off
    if fits:
        np.testing.assert_allclose(
            uniform_time("f", time), 1.0 + np.arange(100.0)
        )
        return
    with pytest.raises(InputError, match=r"around 51\.48 s \(frame 51\)"):
        uniform_time("f", time)


def test_a_file_is_read_once_while_it_stays_the_same(tmp_path):
    """Told by its content: whenever it was written, wherever it is read."""
    read = []

    @kept(2)
    def reader(path, *args):
        text = path.read_text()
        if text == "bad":
            raise InputError(f"{path}: is bad")
        read.append((path.name, *args))
        return text

    first, second, third = (tmp_path / name for name in "abc")
    for path in (first, second, third):
        path.write_text("same")
    assert [reader(first), reader(str(first))] == ["same", "same"]
    assert read == [("a",)]
    first.write_text("else")  # as long, and perhaps as old
    assert reader(first) == "else"
    assert reader(first, 1) == "else"
    assert read == [("a",), ("a",), ("a", 1)]
    for path in (second, third, second, first):
        reader(path)
    assert read[3:] == [("b",), ("c",), ("a",)]
    for _ in range(2):  # an error is not kept
        first.write_text("bad")
        with pytest.raises(InputError, match="a: is bad"):
            reader(first)
    with pytest.raises(InputError, match="none: cannot be read"):
        reader(tmp_path / "none")


def test_what_is_kept_cannot_be_written_to(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for array in read_cells(path, "triangle", "export it again")[:2]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize("line", ["2 4 2 7 7 2 3 4", "2 4 2 7 7 2 3 4 5 1"])
def test_a_gmsh_element_of_another_number_of_nodes_is_refused(tmp_path, line):
    """meshio takes a tag for its first node, or leaves the first one out."""
    whole = "2 4 2 7 7 2 3 4 5"
    text = (
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n7\n1 0 0 0\n2 1 0 0\n"
        "3 0 1 0\n4 0 0 1\n5 1 1 1\n6 2 0 0\n7 3 0 0\n$EndNodes\n"
        f"$Elements\n3\n1 4 2 7 7 1 2 3 4\n{whole}\n3 2 2 7 7 1 2 3\n"
        "$EndElements\n"
    )
    path = tmp_path / "a.msh"
    path.write_text(text)
    _, cells, _ = read_cells(path, "tetra", "export it again")
    assert cells.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    for before in ("", "$Comments\nby hand\n$EndComments\n"):
        path.write_text(before + text.replace(whole, line))
        with pytest.raises(
            InputError, match=r"a\.msh: .*fewer nodes than others"
        ):
            read_cells(path, "tetra", "export it again")
