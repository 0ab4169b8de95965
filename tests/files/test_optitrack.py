import numpy as np
import pytest
from refusals import refusal

from drake_exo.errors import InputError
from drake_exo.files.optitrack import read_markers_csv, read_plate_csv


def markers(unit="Meters", frames=25, told=25):
    lines = [
        "Format Version,1.22,Take Name,x,Export Frame Rate,50.000000,"
        f"Total Exported Frames,{told},Length Units,{unit}",
        "",
        ",,Marker,Marker,Marker,Bone,Bone,Bone,Marker,Marker,Marker",
        ",,A:HEE,A:HEE,A:HEE,leg,leg,leg,A:TOE,A:TOE,A:TOE",
        ",,1,1,1,2,2,2,3,3,3",
        ",,Position,Position,Position,Position,Position,Position,Position,"
        "Position,Position",
        "Frame,Time (Seconds),X,Y,Z,X,Y,Z,X,Y,Z",
    ]
    for i in range(frames):
        toe = ",," if i == 3 else f"{0.3 + i},0.02,0.1"
        lines.append(f"{i},{i / 50:.6f},{0.1 + i},0.05,0.1,9,9,9,{toe}")
    return "\n".join(lines) + "\n"


def plate(frames=25):
    corners = {
        "PosX_PosY": (0.4, 0.0, 0.6),
        "NegX_PosY": (0.0, 0.0, 0.6),
        "NegX_NegY": (0.0, 0.0, 0.0),
        "PosX_NegY": (0.4, 0.0, 0.0),
    }
    lines = ["Format Version,1.0,", f"Total Exported Frames,{frames},"]
    for name, p in corners.items():
        lines += [f"{name}_{a},{x}" for a, x in zip("XYZ", p, strict=True)]
    lines += ["", "MocapFrame, MocapTime, DeviceFrame, Fx, Fy, Fz, Mx, My, Mz"]
    for i in range(frames):
        signals = [0.0] * 6 if i < 2 else [-5.0, 10.0, 700.0, 7.0, -35.0, 2.0]
        row = [i, i / 50, i, *signals]
        lines.append(",".join(f"{x:g}" for x in row))
    return "\n".join(lines) + "\n"


def write(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


def test_markers(tmp_path):
    found = read_markers_csv(write(tmp_path, markers()))
    assert found.names == ("A:HEE", "A:TOE") and found.rate_hz == 50.0
    np.testing.assert_allclose(found.of(["A:HEE"])[2, 0], [2.1, 0.05, 0.1])
    with pytest.raises(InputError, match="'A:TOE' has no value in 1 of 25"):
        found.of(["A:TOE"])


def test_markers_at_zero_were_not_seen(tmp_path):
    text = markers().replace("3.3,0.02,0.1", "0,0,0")
    text = text.replace("4.3,0.02,0.1", "0.000000,0.000000,0.000000")
    unseen = np.isnan(read_markers_csv(write(tmp_path, text)).positions[:, 1])
    assert np.flatnonzero(unseen.all(axis=1)).tolist() == [3, 4]


def test_axes_of_a_marker_are_told_by_their_names(tmp_path):
    text = markers() + "  \n"  # a blank line, as editors leave one
    turned = text.replace("X,Y,Z,X,Y,Z,X,Y,Z", "X,Z,Y,X,Y,Z,Z,X,Y")
    found = read_markers_csv(write(tmp_path, turned)).positions[2]
    np.testing.assert_allclose(found, [[2.1, 0.1, 0.05], [0.02, 0.1, 2.3]])


def test_a_time_code_is_no_number(tmp_path):
    lines = markers().splitlines()
    code = {"Frame": "TimeCode", "": ""}
    for i in range(2, len(lines)):
        first, time, rest = lines[i].split(",", 2)
        cell = code.get(first, "15:26:46:12.02")
        lines[i] = ",".join((first, time, cell, rest))
    found = read_markers_csv(write(tmp_path, "\n".join(lines)))
    plain = read_markers_csv(write(tmp_path, markers()))
    np.testing.assert_array_equal(found.positions, plain.positions)
    np.testing.assert_array_equal(found.time, plain.time)


def test_marker_units(tmp_path):
    found = read_markers_csv(write(tmp_path, markers(unit="Millimeters")))
    np.testing.assert_allclose(found.positions[2, 0], [2.1e-3, 5e-5, 1e-4])

    found = read_markers_csv(write(tmp_path, markers(unit="Centimeters")))
    np.testing.assert_allclose(found.positions[2, 0], [2.1e-2, 5e-4, 1e-3])
    np.testing.assert_allclose(found.time, np.arange(25) / 50.0)


def test_a_plate_may_lie_some_metres_away(tmp_path):
    far = plate().replace("_X,0.", "_X,7.")
    _, found = read_plate_csv(write(tmp_path, far))
    np.testing.assert_allclose(found[1].force[0], [5.0, 700.0, -10.0])


@pytest.mark.parametrize("repeated", [True, False])
@pytest.mark.parametrize("total", [5, 25], ids=["frames", "samples"])
def test_a_plate_is_sampled_more_often_than_markers(tmp_path, repeated, total):
    """Five samples in each of ten frames a second."""
    text = plate().replace(
        "Frames,25,",
        f"Frames,{total},\nMocap Rate,10,\nMocap Rate Multiple,5.0,",
    )
    lines = text.splitlines()
    start = next(i for i, s in enumerate(lines) if s.startswith("MocapF")) + 1
    for i in range(25):
        _, _, *rest = lines[start + i].split(",")
        time = 0.1 * (i // 5) if repeated else 0.02 * i
        lines[start + i] = ",".join([str(i // 5), f"{time:.6f}", *rest])
    text = "\n".join(lines)
    time, found = read_plate_csv(write(tmp_path, text))
    np.testing.assert_allclose(time, 0.02 * np.arange(2, 25), atol=1e-9)
    assert len(found[1].force) == 23
    if repeated:
        wrong = text.replace("Multiple,5.0", "Multiple,4.0")
        assert "do not agree at 4 samples" in refusal(
            read_plate_csv, write(tmp_path, wrong)
        )
    cut = "\n".join(lines[:-1])
    assert f"Frames={total}, but there are 4 frames" in refusal(
        read_plate_csv, write(tmp_path, cut)
    )


def test_plate_acts_on_the_body(tmp_path):
    time, plates = read_plate_csv(write(tmp_path, plate()))
    found = plates[1]
    # Two samples before the device streamed are left out.
    assert len(time) == 23 and time[0] == pytest.approx(0.04)
    # The plate's x is the laboratory's x, its y z, its z -y (down).
    np.testing.assert_allclose(found.force[0], [5.0, 700.0, -10.0])
    # CoP from the middle: x = -My/Fz = 0.05, y = Mx/Fz = 0.01.
    M = found.moment_about_origin()[0]
    cop = np.array([0.2 + 0.05, 0.0, 0.3 + 0.01])
    free = M - np.cross(cop, found.force[0])
    np.testing.assert_allclose(free[[0, 2]], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("reader", "text", "words"),
    [
        (read_markers_csv, markers(unit="Feet"), "Length Units is 'Feet'"),
        (read_markers_csv, markers(told=30), "Frames=30, but there are 25"),
        (read_markers_csv, markers()[:-30], "truncated"),
        (read_markers_csv, "a,b\n1,2\n", "not a marker export"),
        (read_markers_csv, "", "is empty"),
        (
            read_markers_csv,
            markers().replace("\n5,0.10", "\n5,0.08"),
            "not increase",
        ),
        (read_markers_csv, markers().replace("Marker,", "Bone,"), "no markers"),
        (read_markers_csv, markers().replace("X,Y,Z,X", "X,Y,Y,X"), "X, Y and"),
        (
            read_markers_csv,
            markers().replace(",A:TOE,A:TOE,A:TOE", ""),
            "no rows of marker names over all columns",
        ),
        (read_plate_csv, plate().replace("PosX_PosY_X", "P"), "no corners"),
        (
            read_plate_csv,
            plate().replace("1.0,\n", "1.0,\nCoordinate Space,Global,\n"),
            "Coordinate Space is 'Global'",
        ),
        (read_plate_csv, plate().replace(" Fz", " Fq"), "no column 'Fz'"),
        # Blank lines before count, too.
        (read_plate_csv, plate().replace("700", "7oo"), "csv:19: holds text"),
        (read_markers_csv, markers().replace("9.1", "x"), ":17: holds text"),
        (read_plate_csv, plate()[:-12], "truncated"),
        (
            read_markers_csv,
            markers(frames=5000).replace("\n7,", '\n7,"'),
            "is a quote open?",
        ),
        (read_plate_csv, plate().replace("MocapFrame", "Frame"), "MocapFra"),
        (read_plate_csv, plate().replace("3,0.06", "3,0.04"), "not increase"),
    ],
)
def test_refuses(tmp_path, reader, text, words):
    assert words in refusal(reader, write(tmp_path, text))


@pytest.mark.slow
def test_real_box_lifting(data_root):
    folder = data_root / "boxlifting_squat"
    found = read_markers_csv(folder / "SquatLifting_Markers.csv")
    assert found.positions.shape == (5967, 16, 3) and found.rate_hz == 100.0
    time, plates = read_plate_csv(folder / "SquatLifting_Forceplate.csv")
    assert len(time) == 5965 and time[0] == pytest.approx(0.02)
    assert plates[1].force[:500, 1].mean() == pytest.approx(687.0, abs=5.0)
