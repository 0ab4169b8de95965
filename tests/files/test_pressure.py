import numpy as np
import pytest
from refusals import refusal

from drake_exo.errors import InputError
from drake_exo.files.pressure import read_novel_asc, read_pressure_csv

HEAD = """\
file name:  mat.sol\tdate/time  01.01.26 10.00
sensor type:  s2140
total time [secs]:  {total}\ttime per frame [secs]:  0.02000\t\
scanning rate [Hz]:   50
pressure values in  {unit}

mask definition:
left mat: {left}
right mat: 1,2,3,

time[secs]\t  1\t  2\t  1\t  2\t  3\t
"""


def asc(unit="kPa", left="1,2,", frames=25, total=0.5):
    lines = [HEAD.format(unit=unit, left=left, total=total)]
    for i in range(frames):
        cells = "\t".join(f"{2.5 * (i + k):8.3f}" for k in range(5))
        lines.append(f"{0.02 * (i + 1):10.5f}\t{cells}\t\n")
    return "".join(lines)


def write(tmp_path, text, name="a.asc"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_units_of_other_lines_do_not_count(tmp_path):
    """A file is named by its movement, passive or assisted."""
    plain = read_novel_asc(write(tmp_path, asc()))
    text = "file name:\ts01 PA.sol\n" + asc()
    named = read_novel_asc(write(tmp_path, text))
    np.testing.assert_array_equal(named.pressure, plain.pressure)
    with pytest.raises(InputError, match="or several"):
        read_novel_asc(write(tmp_path, asc(unit="kPa (N/cm2)")))


def test_reads_the_cells_of_each_mat(tmp_path):
    found = read_novel_asc(write(tmp_path, asc()))
    assert list(found.groups) == ["left mat", "right mat"]
    np.testing.assert_allclose(found.time, 0.02 * np.arange(1, 26))
    for name, pascals in (
        ("left mat", [10e3, 12.5e3]),
        ("right mat", [15e3, 17.5e3, 20e3]),
    ):
        cells = found.pressure[4, found.groups[name]]
        np.testing.assert_allclose(cells, pascals)


def test_units_come_from_the_header(tmp_path):
    kilo = read_novel_asc(write(tmp_path, asc()))
    per_area = read_novel_asc(write(tmp_path, asc(unit="N/cm2"), "b.asc"))
    np.testing.assert_allclose(per_area.pressure, 10.0 * kilo.pressure)


def test_without_masks_all_cells_are_one_mat(tmp_path):
    text = "\n".join(
        s for s in asc().splitlines() if not s.startswith(("left", "right"))
    )
    found = read_novel_asc(write(tmp_path, text.replace("\n", "\r\n")))
    assert found.groups["mat"].size == 5


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (asc(unit="mmHg"), "no unit of pressure"),
        (asc(left="1,2,3,"), "names 6 cells, but the table has 5"),
        (
            asc().replace("  1\t  2\t  1\t  2\t", "  2\t  1\t  1\t  2\t"),
            "another order than the cells of the mask",
        ),
        (asc(total=5.0), "announces 5 s at 50 Hz, but holds 25 frames"),
        (
            asc(total=0.25).replace("rate [Hz]:   50", "rate [Hz]:   100"),
            "announces 100 Hz, but its time column runs at 50 Hz",
        ),
        (asc()[:-30], "has 3 values where 6"),
        (asc().replace(".", ","), "time in the header is '0,5'; export it"),
        (asc().replace("time[secs]", "t"), "starting with time[secs]"),
        (asc().replace("   2.500\t", "     abc\t", 1), "text among numbers"),
        (asc().replace("   0.10000\t", "   0.08000\t"), "does not increase"),
        (asc().replace("   2.500\t", "  -2.500\t", 1), "below zero"),
        (asc().replace("   2.500\t", "250000.0\t", 1), "2.5e+05 kPa at 0.02 s"),
        (asc().replace("   2.500\t", "     nan\t", 1), "no value in 1 of 25"),
        (asc().replace("rate [Hz]:   50", "rate [Hz]:"), "scanning rate"),
        (b"\x00\x01\x02" * 100, "binary"),
    ],
)
def test_refuses(tmp_path, text, words):
    assert words in refusal(read_novel_asc, write(tmp_path, text))


def test_wrong_number_of_cells_is_refused(tmp_path):
    found = read_novel_asc(write(tmp_path, asc()))
    with pytest.raises(InputError, match="has 3 cells, not 2 x 2"):
        found.matrix("right mat", 2, 2)
    assert found.matrix("right mat", 3, 1).shape == (25, 3, 1)


def csv(cells=6, unit="kPa", time="time [s]", step=0.02):
    lines = [f"{time}; {unit}," + ",".join(f"c{i}" for i in range(cells))]
    for i in range(4):
        row = [step * i, *(2.5 * (i + k) for k in range(cells))]
        lines.append(",".join(f"{x:g}" for x in row))
    return "\n".join(lines) + "\n"


MATS = {"thigh": (1, 2), "shank": (2, 2)}


def test_csv_of_several_mats(tmp_path):
    found = read_pressure_csv(write(tmp_path, csv(), "p.csv"), MATS)
    shank = found.matrix("shank", 2, 2)
    np.testing.assert_allclose(shank[1], [[7.5e3, 10e3], [12.5e3, 15e3]])
    text = csv(time="Time [ms]", step=20.0)
    same = read_pressure_csv(write(tmp_path, text, "p.csv"), MATS)
    np.testing.assert_allclose(same.time, found.time)
    np.testing.assert_array_equal(same.pressure, found.pressure)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (csv(cells=7), "has 7 cells, but the mats (thigh 1 x 2, shank 2 x 2)"),
        (csv(unit="psi"), "no unit of pressure"),
        (csv(time="time"), "must begin with 'time [s]' or 'time [ms]'"),
        (csv(time="time [min]"), "must begin with 'time [s]'"),
        (csv()[:-6], "truncated"),
        ("\n" + csv().replace("0.04", "\nx"), "p.csv:6: holds text"),
        ("\n" + csv(time="t"), "p.csv:2: the first column must"),
        (csv()[:54], "fewer than two frames"),
        (csv().replace(",", ";"), "p.csv:1: semicolons separate the columns"),
    ],
)
def test_refuses_csv(tmp_path, text, words):
    path = write(tmp_path, text, "p.csv")
    assert words in refusal(read_pressure_csv, path, MATS)


def test_real_insoles(data_root):
    path = data_root / "novel_asc" / "pressure_example.asc"
    found = read_novel_asc(path)
    assert found.pressure.shape == (1114, 198)
    assert found.time[-1] == pytest.approx(22.28)
    kilopascals = found.pressure / 1e3
    np.testing.assert_allclose(kilopascals % 2.5, 0.0)  # quantised
    # With insole cells of about 1.5 cm^2 the feet alternate under a load of
    # the order of body weight.
    left, right = (
        1.5e-4 * found.pressure[:, found.groups[f"{side} insole"]].sum(axis=1)
        for side in ("left", "right")
    )
    assert 400.0 < left.max() < 1200.0 and 400.0 < right.max() < 1200.0
    assert np.corrcoef(left, right)[0, 1] < -0.3
