"""C3D files: decoded at arm's length, and what their plates mean."""

import copy
import re
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from plate_types import PlateDesign, write_types
from refusals import refusal

from drake_exo.errors import InputError
from drake_exo.files import c3d as c3d_files
from drake_exo.files.c3d import decode, read_c3d, write_c3d
from drake_exo.files.inspection import inspect
from drake_exo.files.opensim import read_trc
from drake_exo.files.tables import MarkerData, PlateRecording, plate_axes

# x of the plate along -y of the laboratory, z down.
CORNERS = np.array(
    [[0.8, -0.1, 0.0], [0.8, 0.5, 0.0], [0.2, 0.5, 0.0], [0.2, -0.1, 0.0]]
)


@pytest.fixture
def markers():
    rng = np.random.default_rng(0)
    p = rng.uniform(-1.0, 2.0, (30, 3, 3))
    p[3, 1] = np.nan
    return MarkerData(np.arange(30) / 100.0, ("heel", "R.ASIS", "C7"), p, 100.0)


@pytest.fixture
def plate():
    """A body of 70 kg on the plate, walking along +x."""
    rng = np.random.default_rng(1)
    n = 300
    F = np.column_stack(
        [
            np.linspace(-80.0, 80.0, n),
            rng.normal(0.0, 20.0, n),
            687.0 + rng.normal(0.0, 5.0, n),
        ]
    )
    point = np.column_stack(
        [np.linspace(0.3, 0.7, n), np.full(n, 0.15), np.zeros(n)]
    )
    torque = np.column_stack([np.zeros((n, 2)), rng.normal(0.0, 5.0, n)])
    return PlateRecording(1, F, point, torque)


def design(kind):
    rng = np.random.default_rng(2)
    calibration = np.diag([3.0, 3.0, 11.5, 2e3, 1.9e3, 9e2])
    return PlateDesign(
        CORNERS,
        kind,
        (0.2, 0.12, -0.05) if kind == 3 else (0.001, -0.002, -0.04),
        calibration + rng.normal(size=(6, 6)) if kind == 4 else None,
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", [None, 1, 2, 3, 4])
def test_plates_of_every_type(tmp_path, markers, plate, kind):
    """None is that of our own files."""
    path = tmp_path / "a.c3d"
    if kind is None:
        write_c3d(path, markers, [plate], [CORNERS], 10)
    else:
        write_types(path, markers, [plate], [design(kind)], 10)
    found = read_c3d(path)
    read = found.plates[1]
    np.testing.assert_allclose(read.force, plate.force, atol=1e-3)
    np.testing.assert_allclose(
        read.moment_about_origin(), plate.moment_about_origin(), atol=1e-3
    )
    np.testing.assert_allclose(found.plate_time, np.arange(300) / 1000.0)
    np.testing.assert_allclose(read.point[0], CORNERS.mean(0), atol=1e-7)
    # An independent decoder agrees where the wrench acts.
    (other,) = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"][
        "platform"
    ]
    np.testing.assert_allclose(read.force, other["force"].T, atol=1e-6)
    cop = 1e-3 * other["center_of_pressure"].T
    np.testing.assert_allclose(cop, plate.point, atol=1e-6)


@pytest.mark.slow
def test_markers_come_back(tmp_path, markers):
    path = tmp_path / "a.c3d"
    write_c3d(path, markers)
    found = read_c3d(path)
    assert found.markers.names == markers.names
    assert found.markers.rate_hz == 100.0
    np.testing.assert_allclose(
        found.markers.positions, markers.positions, atol=1e-6
    )
    np.testing.assert_allclose(found.markers.time, markers.time)
    assert not found.plates and found.analog is None


@pytest.mark.slow
def test_writing_twice_gives_the_same_bytes(tmp_path, markers, plate):
    for name in "ab":
        path = tmp_path / f"{name}.c3d"
        write_c3d(path, markers, [plate], [CORNERS], 10)
    first, second = (tmp_path / f"{n}.c3d" for n in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_a_full_disk_is_told(tmp_path, markers, monkeypatch):
    """The library writes as much as there is room for, and is silent."""
    whole = ezc3d.c3d.write

    def cut(file, path):
        whole(file, path)
        data = Path(path).read_bytes()
        Path(path).write_bytes(data[: len(data) // 2])

    monkeypatch.setattr(ezc3d.c3d, "write", cut)
    with pytest.raises(InputError, match=r"cannot be written \(.*; make room"):
        write_c3d(tmp_path / "a.c3d", markers)


@pytest.mark.slow
def test_two_plates_keep_their_numbers(tmp_path, markers, plate):
    light = replace(plate, force=0.1 * plate.force, torque=0 * plate.torque)
    path = tmp_path / "a.c3d"
    designs = [design(3), design(2)]
    write_types(path, markers, [light, plate], designs, 10)
    found = read_c3d(path)
    assert [p.number for p in found.plates.values()] == [1, 2]
    assert found.plates[1].force[:, 2].mean() == pytest.approx(68.7, abs=0.1)
    assert found.plates[2].force[:, 2].mean() == pytest.approx(687.0, abs=1.0)
    assert found.analog.names[:2] == ("Fx12_1", "Fx34_1")
    units = decode(path).texts("ANALOG", "UNITS")
    assert units[found.analog.names.index("Mx_2")] == "Nmm"


def edited(tmp_path, markers, plate, kind, change):
    """A file whose parameters were changed afterwards."""
    path = tmp_path / "a.c3d"
    write_types(path, markers, [plate], [design(kind)], 10)
    file = ezc3d.c3d(str(path))
    change(file["parameters"])
    file["data"]["meta_points"] = {}
    file.write(str(path))
    return path


@pytest.mark.slow
def test_origin_with_the_wrong_sign_is_turned(tmp_path, markers, plate):
    def flip(parameters):
        parameters["FORCE_PLATFORM"]["ORIGIN"]["value"] *= -1.0

    path = edited(tmp_path, markers, plate, 2, flip)
    read = read_c3d(path).plates[1]
    np.testing.assert_allclose(
        read.moment_about_origin(), plate.moment_about_origin(), atol=1e-3
    )


@pytest.mark.slow
def test_counts_without_sign(monkeypatch, tmp_path, markers, plate):
    """As ezc3d hands them over: read as signed, less the offset's size."""
    path = tmp_path / "a.c3d"
    write_c3d(path, markers, [plate], [CORNERS], 10)
    plain = decode(path)
    offset = np.repeat([32768, 33536], 3)
    scale = np.abs(plain.analogs).max(axis=0) / 3e4
    counts = np.round(plain.analogs / scale) + offset
    signed = counts - 65536.0 * (counts >= 32768)
    analog = dict(
        FORMAT=["UNSIGNED"],
        SCALE=scale,
        OFFSET=offset - 65536,
        GEN_SCALE=np.ones(1),
    )
    parameters = plain.parameters | {
        "ANALOG": plain.parameters["ANALOG"] | analog,
        "POINT": plain.parameters["POINT"] | {"SCALE": np.array([0.1])},
    }
    analogs = scale * (signed - np.abs(offset - 65536))
    found = replace(plain, analogs=analogs, parameters=parameters)
    assert (np.abs(found.analogs - plain.analogs) > 100.0 * scale).any()
    monkeypatch.setattr(c3d_files, "decode", lambda path: found)
    off = np.abs(read_c3d(path).analog.values - plain.analogs)
    assert (off <= 0.501 * scale).all()
    analog["OFFSET"] = analog["OFFSET"][:5]
    parameters["ANALOG"] |= analog
    with pytest.raises(InputError, match="OFFSET holds 5 of 6 channels'"):
        read_c3d(path)


@pytest.mark.slow
def test_offsets_below_zero(tmp_path, markers, plate):
    """(count - OFFSET) SCALE, says the manual; ezc3d takes the magnitude."""
    path = tmp_path / "a.c3d"
    write_c3d(path, markers, [plate], [CORNERS], 10)
    plain, data = read_c3d(path).analog.values, bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<6h", data, data.index(b"OFFSET") + 11)[:1]
    assert first == 0
    struct.pack_into("<6h", data, data.index(b"OFFSET") + 11, *6 * [-100])
    path.write_bytes(data)
    scale = decode(path).numbers("ANALOG", "SCALE")
    found = read_c3d(path).analog.values
    np.testing.assert_allclose(found, plain + 100.0 * scale, atol=1e-3)


@pytest.mark.slow
def test_units_of_channels_are_those_that_the_file_names(
    tmp_path, markers, plate
):
    """Numbers that are written as N and N mm, said to be kN and N cm."""

    def change(parameters):
        units = ["kN"] * 3 + ["N.cm"] * 3
        parameters["ANALOG"]["UNITS"]["value"] = units

    path = edited(tmp_path, markers, plate, 2, change)
    read = read_c3d(path).plates[1]
    np.testing.assert_allclose(read.force, 1e3 * plate.force, rtol=1e-5)
    raw = decode(path).analogs
    # About the middle: the signals' origin is 4 cm below it.
    F, M = 1e3 * raw[:, :3], 1e-2 * raw[:, 3:]
    M -= np.cross([0.001, -0.002, -0.04], F)
    np.testing.assert_allclose(read.torque, M @ plate_axes(CORNERS).T)
    assert c3d_files._FORCES == {"n": 1.0, "kn": 1000.0, "mn": 0.001}
    assert c3d_files._MOMENTS == {"nm": 1.0, "ncm": 0.01, "nmm": 0.001}


def no_corners(parameters):
    parameters["FORCE_PLATFORM"]["CORNERS"]["value"] *= 0.0


def corners_in_metres(parameters):
    parameters["FORCE_PLATFORM"]["CORNERS"]["value"] *= 1e-3


def no_calibration(parameters):
    del parameters["FORCE_PLATFORM"]["CAL_MATRIX"]


def no_units(parameters):
    parameters["POINT"]["UNITS"]["value"] = ["parsec"]


def strange_force_unit(parameters):
    parameters["ANALOG"]["UNITS"]["value"] = ["lbf"] * 6


def strange_type(parameters):
    parameters["FORCE_PLATFORM"]["TYPE"]["value"] = np.array([7.0])


def lost_channel(parameters):
    parameters["FORCE_PLATFORM"]["CHANNEL"]["value"] += 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        (2, no_corners, "force plate 1 has no corners"),
        (2, corners_in_metres, "CORNERS are in another unit than POINT:UNITS"),
        (4, no_calibration, "has no calibration matrix"),
        (2, no_units, "unit of POINT:UNITS is 'parsec'"),
        (2, strange_force_unit, "channels of force plate 1 is 'lbf'"),
        (2, strange_type, "is of type 7"),
        (2, lost_channel, "names analog channel 9, but there are 6"),
    ],
)
def test_refuses_damaged_parameters(
    tmp_path, markers, plate, kind, change, words
):
    path = edited(tmp_path, markers, plate, kind, change)
    assert words in refusal(lambda path: dict(read_c3d(path).plates), path)


@pytest.mark.slow
def test_a_plate_that_cannot_be_read_blocks_nothing_else(
    monkeypatch, tmp_path, markers, plate
):
    path = tmp_path / "a.c3d"
    write_c3d(path, markers, [plate] * 2, [CORNERS] * 2, 10)
    found = copy.deepcopy(decode(path))
    found.parameters["FORCE_PLATFORM"]["CORNERS"][..., 0] = 0.0
    monkeypatch.setattr(c3d_files, "decode", lambda path: found)
    read = read_c3d(path)
    assert read.markers.names == markers.names
    np.testing.assert_allclose(read.plates[2].force, plate.force, atol=1e-3)
    with pytest.raises(InputError, match="force plate 1 has no corners"):
        read.plates[1]
    said = inspect(path)
    first, second = re.findall(r"2 force plates.*\n(.*)\n(.*)\n", said)[0]
    assert "plate 1: cannot be read (" in first
    assert "plate 2: loaded 100 %" in second


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.05, "is not a C3D file; check the path"),
        (0.3, "ends before its last frame"),
        (0.9, "ends before its last frame"),
        (0.95, "ends before its last frame"),
    ],
)
def test_refuses_truncated_files(tmp_path, markers, plate, share, words):
    path = tmp_path / "a.c3d"
    write_c3d(path, markers, [plate], [CORNERS], 10)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=rf"a\.c3d: {words}"):
        read_c3d(path)


def test_refuses_what_is_no_c3d(tmp_path):
    path = tmp_path / "a.c3d"
    path.write_text("not at all " * 200)
    with pytest.raises(InputError, match="not a C3D file"):
        read_c3d(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_c3d(tmp_path / "none.c3d")


# macOS: no bound on the address space is accepted.
_AS_MACOS = """
import resource, runpy, sys
sys.platform = "darwin"
bound = resource.setrlimit
def refuse(what, both):
    if what == resource.RLIMIT_AS:
        raise ValueError("current limit exceeds maximum limit")
    bound(what, both)
resource.setrlimit = refuse
runpy.run_path(sys.argv[1], run_name="__main__")
"""


@pytest.mark.slow
def test_decodes_where_memory_cannot_be_bound(tmp_path):
    path = tmp_path / "a.c3d"
    path.write_text("not at all " * 200)
    command = [sys.executable, "-c", _AS_MACOS, c3d_files._CHILD, path]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert "limit" not in ended.stderr
    assert ended.returncode == 1


@pytest.fixture(scope="module")
def walking(data_root):
    return read_c3d(data_root / "c3d" / "opensim_walking5.c3d")


@pytest.mark.slow
def test_walking_markers_equal_opensims_export(walking, data_root):
    trc = read_trc(data_root / "c3d" / "opensim_std_walking5_markers.trc")
    assert trc.names == walking.markers.names
    # The export holds every tenth frame, printed with five digits.
    frames = np.round(trc.time * 250.0).astype(int)
    ours = 1e3 * walking.markers.positions[frames]
    theirs = 1e3 * trc.positions
    seen = np.isfinite(theirs)
    assert (np.isfinite(ours) == seen).all() and seen.sum() > 5000
    digits = np.where(np.abs(theirs[seen]) < 1000.0, 100.0, 10.0)
    printed = np.round(ours[seen] * digits) / digits
    assert np.abs(printed - theirs[seen]).max() < 0.01 + 1e-6


@pytest.mark.slow
def test_walking_forces_carry_the_body(walking):
    """Fails if a plate is flipped, turned or shifted."""
    names = walking.markers.names
    p = walking.markers.positions
    stance = []
    for number, side in ((1, "L"), (2, "R")):
        plate = walking.plates[number]
        F = plate.force.reshape(-1, 8, 3).mean(axis=1)
        M = plate.moment_about_origin().reshape(-1, 8, 3).mean(axis=1)
        loaded = F[:, 2] > 300.0
        stance.append(loaded)
        assert 700.0 < F[:, 2].max() < 1000.0
        # The centre of pressure lies under the foot that stands there.
        heel = p[loaded, names.index(f"{side}CAL")][:, :2]
        toe = p[loaded, names.index(f"{side}MT2")][:, :2]
        x = -M[loaded, 1] / F[loaded, 2]
        y = M[loaded, 0] / F[loaded, 2]
        along = toe - heel
        length = np.linalg.norm(along, axis=1)
        d = np.column_stack([x, y]) - heel
        share = np.sum(d * along, axis=1) / length**2
        aside = (d[:, 0] * along[:, 1] - d[:, 1] * along[:, 0]) / length
        assert share.min() > -0.2 and share.max() < 1.5
        assert np.abs(aside).max() < 0.07
        # It first brakes, then drives: along the foot's direction.
        forward = np.sign(along[:, 0].mean())
        push = forward * F[loaded, 0]
        half = len(push) // 2
        assert push[:half].mean() < -20.0 < 20.0 < push[half:].mean()
    assert stance[0].any() and stance[1].any()


@pytest.mark.slow
def test_type_4_plates(data_root):
    """Four calibrated plates; their signals are drift of some newtons."""
    path = data_root / "c3d" / "nimble_UpsideDown_trial2_type4.c3d"
    found = read_c3d(path)
    assert len(found.plates) == 4 and found.markers.rate_hz == 240.0
    file = ezc3d.c3d(str(path), extract_forceplat_data=True)
    for plate, other in zip(
        found.plates.values(), file["data"]["platform"], strict=True
    ):
        np.testing.assert_allclose(plate.force, other["force"].T, atol=1e-9)
        np.testing.assert_allclose(
            plate.torque, 1e-3 * other["moment"].T, atol=1e-9
        )
    # By hand: the third plate's first sample, third row of its matrix; its
    # z points down.
    raw = found.analog.values[0, 12:18]
    row = [0.049, 0.053, 11.512, -0.005, -0.025, 0.014]
    assert found.plates[3].force[0, 2] == pytest.approx(-np.dot(row, raw))


@pytest.mark.slow
def test_markers_alone(data_root):
    found = read_c3d(data_root / "c3d" / "ktk_walkingOptiTrack.c3d")
    assert not found.plates and found.analog is None
    assert found.markers.positions.shape == (3361, 12, 3)
    assert np.nanmax(np.abs(found.markers.positions)) < 10.0  # was in mm


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "ktk_walkingOptiTrack",
        "nimble_UpsideDown_trial2_type4",
        "opensim_walking5",
    ],
)
def test_hands_over_what_ezc3d_reads(name, data_root):
    path = data_root / "c3d" / f"{name}.c3d"
    found, other = decode(path), ezc3d.c3d(str(path))
    points = other["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(found.points, points)
    analogs = other["data"]["analogs"][0].T
    np.testing.assert_array_equal(found.analogs, analogs)
    assert found.rate_hz == other["header"]["points"]["frame_rate"]
    for group, values in found.parameters.items():
        for key, value in values.items():
            if isinstance(value, list):
                continue
            expected = other["parameters"][group][key]["value"]
            np.testing.assert_array_equal(np.ravel(value), np.ravel(expected))


def bare_header(processor=84, frames=3, is_real=True) -> bytes:
    """Two points, no channels, and no parameters but the processor."""
    words = struct.pack("<5H", 2, 0, 1, frames, 10)
    scale = struct.pack("<f", -1.0 if is_real else 1.0)
    if processor == 85:  # VAX: words swapped
        scale = scale[2:] + scale[:2]
    block = bytes([2, 0x50]) + words + scale + struct.pack("<H", 3)
    parameters = bytes([1, 0x50, 1, processor])
    return block.ljust(512, b"\0") + parameters.ljust(512, b"\0")


@pytest.mark.slow
@pytest.mark.parametrize(("is_real", "size"), [(True, 4), (False, 2)])
@pytest.mark.parametrize("processor", [84, 85])
def test_truncated_files_are_told_by_their_header(
    tmp_path, processor, is_real, size
):
    path = tmp_path / "a.c3d"
    whole = bare_header(processor, is_real=is_real) + bytes(3 * 2 * 4 * size)
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match="ends before its last frame"):
        decode(path)
    path.write_bytes(whole)  # complete, though without parameters
    with pytest.raises(InputError, match="says no frame rate"):
        decode(path)


@pytest.mark.slow
def test_more_frames_than_can_be_counted(tmp_path, markers, monkeypatch):
    """Of which ezc3d reads as many as its header says, or none beyond."""
    path = tmp_path / "a.c3d"
    write_c3d(path, markers)
    whole, (n, m) = path.read_bytes(), markers.positions.shape[:2]
    path.write_bytes(whole + bytes(0x10000 * m * 16))
    with pytest.raises(InputError, match="holds more than 65535 frames"):
        decode(path)
    path.write_bytes(whole + bytes(512))
    monkeypatch.setattr(c3d_files, "_LONG", n)
    with pytest.raises(InputError, match=f"holds more than {n} frames"):
        decode(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a C3D file"),
        (b"\x09" + bare_header()[1:], "ends before"),
        (bare_header(7), "names no processor"),
        (bare_header(86), "MIPS processor, which cannot be read; save"),
    ],
)
def test_refuses_headers(tmp_path, data, words):
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        decode(path)


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("import os; os.abort()", "contradict each other"),
        ("import sys; sys.exit('no such group\\nat all')", "no such group"),
    ],
)
def test_survives_what_happens_to_the_library(
    tmp_path, monkeypatch, does, words
):
    child = tmp_path / "child.py"
    child.write_text(does)
    monkeypatch.setattr(c3d_files, "_CHILD", child)
    path = tmp_path / "a.c3d"
    path.write_bytes(bare_header() + bytes(96))
    with pytest.raises(InputError, match=words):
        decode(path)
