from dataclasses import replace

import numpy as np
import pytest
from angles import in_radians
from refusals import refusal

from drake_exo.errors import InputError
from drake_exo.files.opensim import (
    plates_of,
    read_plates,
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.tables import MarkerData, Table, uniform_time

TIME = np.arange(25) / 50.0


def mot(names, values, time=TIME, in_degrees="no", extra=()):
    lines = ["title", "version=1", f"nRows={len(time)}"]
    lines += [f"nColumns={len(names) + 1}"]
    lines += [f"inDegrees={in_degrees}"] if in_degrees else []
    lines += [*extra, "endheader", "\t".join(("time", *names))]
    for t, row in zip(time, values, strict=True):
        lines.append("\t".join(f"{x:.9g}" for x in (t, *row)))
    return "\n".join(lines) + "\n"


@pytest.fixture
def knee():
    """Degrees of a deep bend."""
    return 45.0 * (1.0 - np.cos(2.0 * np.pi * TIME))[:, None]


def write(tmp_path, text, name="a.mot"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read_coordinates(path):
    """Joint angles, in radians whatever the file has."""
    return in_radians(read_table(path))


def test_reads_degrees_as_radians(tmp_path, knee):
    path = write(tmp_path, mot(["knee"], knee, in_degrees="yes"))
    found = read_coordinates(path)
    np.testing.assert_allclose(found.column("knee"), np.deg2rad(knee[:, 0]))
    assert found.in_degrees is False


def test_lengths_are_not_angles(tmp_path, knee):
    values = np.hstack([knee, knee])
    names = ["knee", "pelvis_tx"]
    path = write(tmp_path, mot(names, values, in_degrees="yes"))
    found = read_coordinates(path)
    np.testing.assert_allclose(found.column("pelvis_tx"), knee[:, 0])


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace("\n", "\t\t\n"),
        lambda s: s.replace("\t", "   "),
        lambda s: s.replace("nRows=25", "nRows = 25\t"),
        lambda s: "\ufeff" + s,
        lambda s: s + "\n\n",
    ],
    ids=["crlf", "trailing tabs", "spaces", "header", "bom", "blank lines"],
)
def test_reads_real_files_quirks(tmp_path, knee, change):
    path = write(tmp_path, change(mot(["knee"], knee)))
    found = read_table(path)
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.values, knee, rtol=1e-8)


def test_table_survives_writing(tmp_path, knee):
    table = Table(TIME, ("knee",), knee, True)
    path = tmp_path / "b.sto"
    write_table(path, table)
    found = read_table(path)
    assert found.names == table.names and found.in_degrees is True
    np.testing.assert_allclose(found.values, knee, rtol=1e-9, atol=1e-12)


def test_missing_column_names_the_nearest(tmp_path, knee):
    table = read_table(write(tmp_path, mot(["knee_angle_r"], knee)))
    with pytest.raises(InputError, match="did you mean 'knee_angle_r'"):
        table.column("knee_angel_r")


def test_gap_is_told_when_the_column_is_used(tmp_path, knee):
    knee[7:9] = np.nan
    table = read_table(write(tmp_path, mot(["knee"], knee)))
    with pytest.raises(InputError, match=r"2 of 25 frames, first at 0\.14 s"):
        table.column("knee")


@pytest.mark.filterwarnings("error")
def test_a_column_of_gaps_alone_warns_of_nothing(tmp_path, knee):
    values = np.hstack([knee, np.full_like(knee, np.nan)])
    path = write(tmp_path, mot(["knee", "hip"], values, in_degrees="yes"))
    found = read_coordinates(path)
    with pytest.raises(InputError, match="25 of 25 frames"):
        found.column("hip")


def test_header_in_degrees_over_radians(tmp_path, knee):
    text = mot(["knee"], np.deg2rad(knee), in_degrees="yes")
    message = refusal(read_coordinates, write(tmp_path, text))
    assert "look like radians" in message and "inDegrees=no" in message


def test_header_in_radians_over_degrees(tmp_path, knee):
    text = mot(["knee"], knee, in_degrees="no")
    message = refusal(read_coordinates, write(tmp_path, text))
    assert "can only be degrees" in message and "inDegrees=yes" in message


def test_standing_still_in_degrees_is_believed(tmp_path):
    sway = 2.0 + 0.3 * np.sin(2.0 * np.pi * TIME)[:, None]
    text = mot(["knee"], sway, in_degrees="yes")
    found = read_coordinates(write(tmp_path, text))
    assert found.column("knee").max() < np.deg2rad(2.4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.replace("inDegrees=no\n", ""), "does not say whether"),
        (lambda s: s.replace("inDegrees=no", "inDegrees=np"), "yes or no"),
        (lambda s: s.replace("endheader", "end"), "no line 'endheader'"),
        (lambda s: s.replace("time\t", "t\t"), "first column must be 'time'"),
        (lambda s: s[: s.index("endheader") + 10], "ends after its header"),
        (lambda s: s[:-40], "truncated"),
        (lambda s: s[: s.rindex("\t")], "truncated"),
        (lambda s: s.replace("\n0.2\t", "\n0.1\t"), "does not increase"),
        (lambda s: s.replace("\n0.2\t", "\n0.18\t"), "from 0.18 to 0.18 s"),
        (lambda s: s.replace("\n0.2\t", "\nx0.2\t"), "among numbers ('x0.2')"),
        (lambda s: s.replace("\tknee", "\tknee\tknee"), "two columns"),
        (lambda s: s.replace("Columns=2", "Columns=3"), "nColumns=3, but"),
        (lambda s: b"\x00\x01" + s.encode(), "binary file"),
        (lambda s: s.encode("utf-16"), "in UTF-16; save it as UTF-8"),
        (lambda s: "", "no line 'endheader'"),
    ],
)
def test_refuses_tables(tmp_path, knee, change, words):
    path = write(tmp_path, change(mot(["knee"], np.deg2rad(knee))))
    assert words in refusal(read_coordinates, path)


def test_refuses_a_path_that_is_not_there(tmp_path):
    for reader in (read_table, read_trc):
        assert "cannot be read" in refusal(reader, tmp_path / "none.mot")
    assert "cannot be read" in refusal(read_table, tmp_path)


PLATE_NAMES = {
    "numbered": [
        f"ground_force_{n}_{k}{a}" for n in (1, 2) for k in "vpm" for a in "xyz"
    ],
    "opensim": [
        f"{n}ground_{w}{a}"
        for n in ("", "1_")
        for w in ("force_v", "force_p", "torque_")
        for a in "xyz"
    ],
    "torque": [
        f"ground_{w}{a}"
        for n in (1, 2)
        for w in (f"force_{n}_v", f"force_{n}_p", f"torque_{n}_")
        for a in "xyz"
    ],
    "no underscore": [
        f"ground_{w}{a}"
        for n in (1, 2)
        for w in (f"force{n}_v", f"force{n}_p", f"torque{n}_")
        for a in "xyz"
    ],
    **{
        f"{v} {m}": [
            f"{w.format(n)}{a}"
            for n in (1, 2)
            for w in (f"{v}_v", f"{v}_p", m)
            for a in "xyz"
        ]
        for v, m in (
            ("FP{}", "FP{}_moment_"),
            ("FP{}", "FP{}_m"),
            ("force{}", "torque{}_"),
            ("force_{}", "moment_{}_m"),
            ("plate_0{}", "plate_0{}_torque_"),
            ("Force_Plate{}", "Force_Plate{}_torque_"),
            ("{}", "{}_moment_m"),
        )
    },
    "bodies": [
        f"ground_force_calcn_{n}_{k}{a}"
        for n in "rl"
        for k in "vpm"
        for a in "xyz"
    ],
}


@pytest.mark.parametrize("names", PLATE_NAMES.values(), ids=PLATE_NAMES.keys())
def test_reads_plates_under_their_usual_names(tmp_path, names):
    row = np.arange(18.0)
    rng = np.random.default_rng(0)
    order = rng.permutation(9)
    order = np.concatenate([order, 9 + order])
    values = np.tile(row[order], (25, 1))
    path = write(tmp_path, mot([names[i] for i in order], values))
    time, plates = read_plates(path)
    assert [p.number for p in plates.values()] == [1, 2] == list(plates)
    for i, plate in enumerate(plates.values()):
        np.testing.assert_array_equal(plate.force[3], row[9 * i :][:3])
        np.testing.assert_array_equal(plate.point[3], row[9 * i + 3 :][:3])
        np.testing.assert_array_equal(plate.torque[3], row[9 * i + 6 :][:3])
        M = plate.moment_about_origin()[0]
        np.testing.assert_allclose(
            M,
            np.cross(row[9 * i + 3 :][:3], row[9 * i :][:3])
            + row[9 * i + 6 :][:3],
        )
    np.testing.assert_allclose(time, TIME)


def table(names, values=None):
    values = np.ones((25, len(names))) if values is None else values
    return Table(TIME, tuple(names), values, False, "f.mot")


def test_units_of_plates_in_a_csv_table_are_those_of_forces_and_points():
    names = [f"FP1_{k}{a}" for k in "vpm" for a in "xyz"]
    units = ["n"] * 3 + ["mm"] * 3 + ["nm", "n m", "nm"]
    assert list(plates_of(replace(table(names), units=tuple(units)))) == [1]
    for k, told in ((1, "in n"), (4, "in m or mm"), (8, "in nm or n m")):
        wrong = tuple([*units[:k], "rad", *units[k + 1 :]])
        said = f"f.mot:1: column '{names[k]}' is in 'rad'; give it {told}"
        with pytest.raises(InputError, match=said):
            plates_of(replace(table(names), units=wrong))


def test_plate_numbers_follow_the_columns():
    names = [
        f"ground_force_{n}_{k}{a}" for n in (3, 7) for k in "vp" for a in "xyz"
    ]
    plates = plates_of(table(names))
    assert [p.number for p in plates.values()] == [3, 7] == list(plates)
    assert not plates[3].torque.any()
    words = [n.replace("_7_", "_FP2_").replace("_3_", "_FP3_") for n in names]
    assert list(plates_of(table(words))) == [3, 2]
    # OpenSim's second plate is that wherever its columns stand.
    named = [
        f"{n}ground_force_{k}{a}"
        for n in ("1_", "")
        for k in "vp"
        for a in "xyz"
    ]
    plates = plates_of(table(named, np.tile(np.arange(12.0), (25, 1))))
    assert plates[1].force[0].tolist() == [6.0, 7.0, 8.0]
    assert plates[2].force[0].tolist() == [0.0, 1.0, 2.0]
    # A digit, but no number.
    plates = plates_of(table([n.replace("7", "²") for n in names[6:]]))
    assert list(plates) == [1]


@pytest.mark.parametrize("tail", ["", "\t\t"], ids=["", "trailing tabs"])
def test_empty_cells_between_tabs_are_gaps(tmp_path, tail):
    """As pandas writes the points of an unloaded plate."""
    names = PLATE_NAMES["numbered"]
    values = np.tile(np.arange(1.0, 19.0), (25, 1))
    values[4, 9:] = [0.0] * 3 + [np.nan] * 3 + [0.0] * 3
    values[5, -1] = np.nan
    text = mot(names, values).replace("nan", "").replace("\n", tail + "\n")
    found = read_table(write(tmp_path, text))
    np.testing.assert_array_equal(found.values, values)
    # Between blanks, nobody knows which one is missing.
    blanks = write(tmp_path, text.replace("\t", "  "))
    assert ":12: has 16 values where 19 are named" in refusal(
        read_table, blanks
    )


def test_missing_plate_component_is_named():
    names = [n for n in PLATE_NAMES["numbered"] if n != "ground_force_2_py"]
    with pytest.raises(InputError, match="plate 2 has no y component of its"):
        plates_of(table(names))


@pytest.mark.parametrize("other", ["1_ground_force_vx", "ground_moment_1_mx"])
def test_two_columns_of_one_component_are_refused(other):
    names = [f"ground_force_1_{k}{a}" for k in "vp" for a in "xyz"]
    names += [f"ground_torque_1_{a}" for a in "xyz"]
    with pytest.raises(InputError, match=f"and '{other}' are the same of one"):
        plates_of(table([*names, other]))


def test_numbered_columns_are_plates_unless_usual_names_are_there():
    """Other instruments may be numbered, too."""
    usual = [f"ground_force_{k}{a}" for k in "vp" for a in "xyz"]
    numbered = [f"FP2_{k}{a}" for k in "vp" for a in "xyz"]
    assert list(plates_of(table([*numbered, *usual]))) == [1]
    names = [*numbered, "knee1", "FP7", "hip_2", "calcn1_x", "FP2_rx"]
    assert list(plates_of(table(names))) == [2]


@pytest.mark.parametrize("other", ["plate2_vx", "FP02_vx", "handle_2_vx"])
def test_two_plates_of_one_number_are_refused(other):
    names = [f"FP2_{k}{a}" for k in "vp" for a in "xyz"]
    told = f"columns 'FP2_vx' and '{other}' are the same of one force plate"
    with pytest.raises(InputError, match=told):
        plates_of(table([*names, other]))
    with pytest.raises(InputError, match="plate 2 has no x component of its p"):
        plates_of(table(names[:3]))


def test_table_without_plates_is_refused():
    for name in ("knee", "FP_vx", "FP1_x", "FPa_vx"):
        with pytest.raises(InputError, match="has no force plate"):
            plates_of(table([name]))


def test_gaps_in_plates():
    names = PLATE_NAMES["numbered"]
    values = np.ones((25, 18))
    values[4, 4] = np.nan  # a point where the plate is loaded
    with pytest.raises(InputError, match=r"ground_force_1_px.*0\.08 s"):
        plates_of(table(names, values))
    values[4, :3] = 0.0  # unloaded: no point is no gap
    assert np.isfinite(plates_of(table(names, values))[1].point).all()


@pytest.fixture
def markers():
    rng = np.random.default_rng(1)
    p = rng.uniform(-1, 2, (25, 3, 3))
    return MarkerData(TIME, ("heel", "R.ASIS", "C7"), p, 50.0)


def test_markers_survive_writing(tmp_path, markers):
    markers.positions[3, 1] = markers.positions[24, 2] = np.nan
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    found = read_trc(path)
    assert found.names == markers.names and found.rate_hz == 50.0
    np.testing.assert_allclose(found.positions, markers.positions, atol=1e-8)
    with pytest.raises(InputError, match=r"'R\.ASIS' has no value in 1 of 25"):
        found.of(["heel", "R.ASIS"])
    with pytest.raises(InputError, match="did you mean 'heel'"):
        found.of(["heal"])


def test_markers_at_zero_were_not_seen(tmp_path, markers):
    markers.positions[3, 1] = 0.0
    markers.positions[4, 1, :2] = 0.0  # a marker may be at two of them
    write_trc(tmp_path / "m.trc", markers)
    found = read_trc(tmp_path / "m.trc").positions
    assert np.isnan(found[3, 1]).all()
    assert np.isfinite(found).sum() == found.size - 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.replace("\tm\t", "\tinch\t"), "write m, cm or mm"),
        (lambda s: s.replace("PathFile", "Path"), "not a .trc file"),
        (lambda s: s.replace("50\t50", "x\t50"), "DataRate"),
        (lambda s: s[:-200], "truncated"),
        (lambda s: s[: s.rindex("\n25\t")], "NumFrames=25"),
        (lambda s: s.replace("C7", "heel"), "two columns"),
        (lambda s: s.replace("C7", ""), "NumMarkers=3"),
        (lambda s: s.replace("\n9\t0.16", "\n9\t0.14"), "does not increase"),
        (lambda s: s.replace("\n9\t0.16", "\n9\t"), "frame 9 is missing"),
    ],
)
def test_refuses_markers(tmp_path, markers, change, words):
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    path.write_text(change(path.read_text()))
    assert words in refusal(read_trc, path)


def test_a_header_may_count_one_frame_too_many_or_too_few(tmp_path, markers):
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    text = path.read_text()
    for told in (24, 26):
        path.write_text(text.replace("\t25\t3\t", f"\t{told}\t3\t"))
        assert len(read_trc(path).time) == 25
    for told in (23, 27):
        path.write_text(text.replace("\t25\t3\t", f"\t{told}\t3\t"))
        assert f"NumFrames={told}, but there are 25" in refusal(read_trc, path)
    # A last line without its end may have been cut.
    path.write_text(text.replace("\t25\t3\t", "\t26\t3\t").rstrip())
    assert "truncated" in refusal(read_trc, path)


def test_marker_units_come_from_the_header(tmp_path, markers):
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    path.write_text(path.read_text().replace("\tm\t", "\tmm\t"))
    np.testing.assert_allclose(
        read_trc(path).positions, 1e-3 * markers.positions, atol=1e-9
    )


def test_units_may_be_words(tmp_path, markers):
    """As SIMM writes them."""
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    text = path.read_text()
    for word, scale in (("meters", 1.0), ("Millimeters", 1e-3)):
        path.write_text(text.replace("\tm\t", f"\t{word}\t"))
        np.testing.assert_allclose(
            read_trc(path).positions, scale * markers.positions, atol=1e-8
        )


def test_markers_between_blanks(tmp_path, markers):
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    text = path.read_text().replace("\t", "  ")
    path.write_text(text)
    found = read_trc(path)
    assert found.names == markers.names
    np.testing.assert_allclose(found.positions, markers.positions, atol=1e-8)
    # A marker's place cannot be told from the others once it is missing.
    lines = text.splitlines()
    lines[9] = "  ".join(lines[9].split()[:-3])
    path.write_text("\n".join(lines) + "\n")
    assert ":10: has 8 values where 11 are named" in refusal(read_trc, path)


def test_even_times_behind_rounded_stamps():
    exact = np.arange(151) / 60.0
    np.testing.assert_allclose(
        uniform_time("f", np.round(exact, 3), 60.0), exact, atol=1e-12
    )
    np.testing.assert_allclose(
        uniform_time("f", np.round(exact, 4)), exact, atol=1e-4
    )


def test_uneven_times_are_refused():
    time = np.delete(np.arange(50) / 50.0, 20)
    with pytest.raises(InputError, match="not evenly spaced"):
        uniform_time("f.trc", time)
    time = np.delete(np.arange(1400) / 100.0, 200)
    for rate_hz in (None, 100.0):
        with pytest.raises(InputError, match=r"2\.01 s \(frame 201\)"):
            uniform_time("f.trc", time, rate_hz)
    with pytest.raises(InputError, match=r"100 frames a second.*50"):
        uniform_time("f.trc", TIME, 100.0)
    with pytest.raises(InputError, match=r"47 frames a second.*50"):
        uniform_time("f.trc", TIME, 47.0)


@pytest.mark.slow
def test_real_files(data_root):
    found = read_trc(data_root / "opencap_subject4/MarkerData/STS1.trc")
    assert found.positions.shape == (1399, 51, 3) and found.rate_hz == 100.0
    walk = read_trc(data_root / "opensim_gait10dof/subject01_walk.trc")
    assert walk.positions.shape == (151, 41, 3)
    assert 1.7 < walk.of(["Top.Head"])[..., 1].mean() < 1.8  # was in mm
    ik = read_coordinates(data_root / "opencap_subject4/IK/STS1_ik.mot")
    degrees = np.rad2deg(ik.column("knee_angle_r"))
    assert 90.0 < degrees.max() < 105.0
    _, plates = read_plates(data_root / "opencap_subject4/ID/STS1_grf.mot")
    assert list(plates) == [1, 2, 3]
    assert not plates[3].force.any()
    _, plates = read_plates(
        data_root / "opensim_gait10dof/subject01_walk_grf.mot"
    )
    assert list(plates) == [1, 2]


def test_walking5_time_column_contradicts_its_header(data_root):
    path = data_root / "c3d/opensim_std_walking5_markers.trc"
    found = read_trc(path)
    with pytest.raises(InputError, match="250 frames a second"):
        uniform_time(path.name, found.time, found.rate_hz)


def test_a_row_may_end_before_its_last_marker_but_not_within_it(
    tmp_path, markers
):
    path = tmp_path / "m.trc"
    write_trc(path, markers)
    lines = path.read_text().splitlines()
    for ending in ("", "\t", "\t\t"):
        short = lines[9].rsplit("\t", 3)[0] + ending
        path.write_text("\n".join([*lines[:9], short, *lines[10:]]) + "\n")
        found = read_trc(path).positions
        assert np.isnan(found[:, 2]).any(axis=1).sum() == 1
    # Blanks behind the last row are no row that was cut off.
    path.write_text("\n".join([*lines[:9], short, *lines[10:], "  "]))
    np.testing.assert_array_equal(read_trc(path).positions, found)
    # A file that was cut off ends within a row.
    path.write_text("\n".join([*lines[:-1], lines[-1].rsplit("\t", 3)[0]]))
    assert "truncated" in refusal(read_trc, path)


def test_simm_s_header_says_how_many_rows(tmp_path):
    path = tmp_path / "s.mot"
    text = "name s.mot\ndatacolumns 2\ndatarows 3\nendheader\ntime a\n"
    path.write_text(text + "0 1\n1 2\n2 3\n")
    assert len(read_table(path).time) == 3
    path.write_text(text + "0 1\n1 2\n")
    assert "datarows=3" in refusal(read_table, path)
