import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.tables import Table, read_csv_table, write_csv_table

TEXT = "time [ms],exo_knee [deg],exo_knee_moment [Nm]\n0,90,1\n10,45,2\n"


def written(tmp_path, text):
    path = tmp_path / "encoders.csv"
    path.write_text(text)
    return path


def test_units_come_from_the_header(tmp_path):
    table = read_csv_table(written(tmp_path, TEXT))
    assert table.names == ("exo_knee", "exo_knee_moment")
    np.testing.assert_allclose(table.time, [0.0, 0.01])
    np.testing.assert_allclose(table.column("exo_knee"), [np.pi / 2, np.pi / 4])
    np.testing.assert_allclose(table.column("exo_knee_moment"), [1.0, 2.0])


def test_names_may_be_quoted(tmp_path):
    """As R and others write them."""
    head, rest = TEXT.split("\n", 1)
    quoted = ",".join(f'"{name}"' for name in head.split(","))
    found = read_csv_table(written(tmp_path, f"{quoted}\n{rest}"))
    plain = read_csv_table(written(tmp_path, TEXT))
    assert (found.names, found.units) == (plain.names, plain.units)
    np.testing.assert_array_equal(found.values, plain.values)


def test_comes_back_as_written(tmp_path):
    rng = np.random.default_rng(0)
    table = Table(np.arange(5) * 0.01, ("a", "b"), rng.normal(size=(5, 2)))
    write_csv_table(tmp_path / "t.csv", table, ["deg", "mm"])
    back = read_csv_table(tmp_path / "t.csv")
    np.testing.assert_allclose(back.values, table.values, rtol=1e-9)
    np.testing.assert_allclose(back.time, table.time)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("exo_knee [deg]", "exo_knee", "names no unit"),
        ("[deg]", "[grad]", "names no unit that is known"),
        ("[Nm]\n", "[Nm],EMG [mV]\n", r"'EMG \[mV\]' .* leave the column out"),
        ("time [ms]", "frame [s]", "first column must be 'time"),
        ("time [ms]", "time [deg]", "first column must be 'time"),
        ("exo_knee_moment [Nm]", "exo_knee [deg]", "two columns are named"),
        ("10,45,2", "10,45", ":3: has 2 values where 3"),
        ("10,45,2", "10,x,2", "text among numbers"),
        ("10,45,2", "10,4_5,2", r":3: holds text among numbers \('4_5'\)"),
        ("10,45,2", "10,٤٥,2", "text among numbers"),
        ("10,45,2", "\n10,x,2", ":4: holds text among numbers"),
        ("10,45,2", "0,45,2", "time does not increase"),
        ("10,45,2\n", "", "fewer than two"),
        (",", ";", ":1: semicolons separate the columns"),
        (",", "\t", ":1: tabs separate the columns"),
    ],
)
def test_refuses(tmp_path, old, new, words):
    path = written(tmp_path, TEXT.replace(old, new))
    with pytest.raises(InputError, match=words) as caught:
        read_csv_table(path)
    assert str(caught.value).startswith(str(path))


def test_a_gap_is_refused_where_it_is_asked_for(tmp_path):
    table = read_csv_table(written(tmp_path, TEXT.replace("45,2", ",2")))
    table.column("exo_knee_moment")
    with pytest.raises(InputError, match="no value in 1 of 2"):
        table.column("exo_knee")
