from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plate_types import PlateDesign, write_types
from synthetic_recording import (
    RATE,
    SEAT_OFF,
    STANDING,
    load,
    write_recording,
)

from drake_exo.calibration.clocks import Clock, retimed
from drake_exo.errors import InputError
from drake_exo.files.c3d import write_c3d
from drake_exo.files.inspection import inspect
from drake_exo.files.opensim import (
    read_plates,
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.tables import MarkerData, Table, write_csv_table
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.processing import Recordings
from drake_exo.measurement.settings import Axes, Scaling
from drake_exo.measurement.subject import fit_subject
from drake_exo.model.segments import scale_human
from drake_exo.study import read_study


@pytest.fixture(scope="module")
def human():
    body = scale_human(70.0, 1.75)
    pelvis = replace(body.pelvis, com_m=(-0.02, body.pelvis.com_m[1]))
    return replace(body, pelvis=pelvis)


@pytest.fixture(scope="module")
def made(tmp_path_factory, human):
    folder = tmp_path_factory.mktemp("recording")
    scaling = {"lengths": "markers", "trunk_com": "standing"}
    truth, study = write_recording(folder, human, scaling=scaling)
    return folder, truth, study


@pytest.fixture(scope="module")
def loaded(made):
    folder, _, study = made
    return load(study, folder)


def residual(subject, trial):
    tree = subject.model.rigid.tree
    loads = {tree.root: trial.ground}
    return inverse_dynamics(tree, trial.q, trial.v, trial.a, loads)[:, :3]


def by_plate(path):
    """Write each plate of a force file to one of its own, as Motive does."""
    table = read_table(path)
    for number in ("1", "2"):
        own = [i for i, n in enumerate(table.names) if f"_{number}_" in n]
        names = tuple(table.names[i] for i in own)
        one = replace(table, names=names, values=table.values[:, own])
        write_table(path.with_name(f"{path.stem}{number}.mot"), one)


def test_each_plate_may_have_a_file_of_its_own(files):
    folder, study = files
    (whole, _) = load(study, folder)[1]
    for name in ("sts", "static"):
        by_plate(folder / f"{name}.mot")
    text = (folder / "study.yaml").read_text()
    # Numbers are places in the list: 1 is the left foot's file here.
    for name in ("sts", "static"):
        text = text.replace(
            f"forces: {name}.mot", f"forces: [{name}2.mot, {name}1.mot]"
        )
    text = text.replace("left: 2", "left: 1").replace("right: 1", "right: 2")
    (folder / "study.yaml").write_text(text)
    trial = read_study(folder / "study.yaml").trials()[0]
    np.testing.assert_array_equal(trial.ground.array, whole.ground.array)
    assert trial.provenance["forces"] == "sts2.mot, sts1.mot"


def test_plates_may_be_columns_of_a_csv_table(files):
    folder, study = files
    (whole, _) = load(study, folder)[1]
    table = read_table(folder / "sts.mot")
    names = tuple(n.replace("ground_force_", "FP") for n in table.names)
    unit = {"v": "N", "p": "mm", "m": "Nm"}
    units = [unit[name.split("_")[1][0]] for name in names]
    path = folder / "sts.csv"
    write_csv_table(path, replace(table, names=names), units)
    assert "plate 2: loaded 100 %" in inspect(path)
    text = (folder / "study.yaml").read_text().replace("sts.mot", "sts.csv")
    (folder / "study.yaml").write_text(text)
    trial = read_study(folder / "study.yaml").trials()[0]
    np.testing.assert_allclose(
        trial.ground.array, whole.ground.array, atol=1e-5
    )


def test_files_of_one_plate_each_must_belong_together(files):
    folder, _ = files
    by_plate(folder / "sts.mot")
    lines = (folder / "sts2.mot").read_text().splitlines()
    text = (folder / "study.yaml").read_text()

    def refusal(second):
        made = text.replace("forces: sts.mot", f"forces: [sts1.mot, {second}]")
        (folder / "study.yaml").write_text(made)
        with pytest.raises(InputError) as error:
            read_study(folder / "study.yaml").trials()
        return str(error.value)

    assert "sts.mot: holds 2 force plates, but each file" in refusal("sts.mot")
    assert "forces names sts1.mot more than once" in refusal("sts1.mot")
    half = [*lines[:7], *lines[7::2]]
    half[2] = f"nRows={len(half) - 7}"
    (folder / "half.mot").write_text("\n".join(half))
    assert "half.mot: is not sampled at the times of" in refusal("half.mot")


def time_of(trial):
    """In the recording [s]."""
    return trial.start_s + trial.times


@pytest.mark.slow
def test_subject_is_measured_from_standing(loaded, human):
    subject, _ = loaded
    assert subject.mass_kg == pytest.approx(70.0)
    assert subject.model.human.shank.length_m == pytest.approx(
        human.shank.length_m
    )
    assert subject.model.human.thigh.length_m == pytest.approx(
        human.thigh.length_m
    )
    assert subject.model.human.ankle_height_m == pytest.approx(
        human.ankle_height_m
    )
    assert subject.model.human.pelvis.com_m[0] == pytest.approx(-0.02, abs=1e-6)
    report = subject.report
    assert report["standing_mass_kg"] == pytest.approx(70.0, abs=1e-6)
    assert report["trunk_com_shift_m"] == pytest.approx(-0.02, abs=1e-6)
    assert report["standing_com_x_m"] == pytest.approx(
        report["standing_cop_x_m"]
    )


@pytest.mark.slow
def test_trunk_from_the_table_stays_above_the_hips(made):
    folder, _, study = made
    table = replace(study, scaling=Scaling(trunk_com="table"))
    subject = fit_subject(table, folder)
    assert subject.model.human.pelvis.com_m[0] == 0.0


def test_stretched_segments_keep_their_proportions(made, human):
    folder, _, study = made
    tall = replace(study, subject=replace(study.subject, height_m=1.9))
    shank = fit_subject(tall, folder).model.human.shank
    assert shank.length_m == pytest.approx(human.shank.length_m)
    assert shank.com_m == pytest.approx(human.shank.com_m)
    assert shank.inertia_kg_m2 == pytest.approx(human.shank.inertia_kg_m2)


@pytest.mark.slow
def test_rises_are_found_where_they_are(loaded):
    _, trials = loaded
    for trial, off, up in zip(trials, SEAT_OFF, STANDING, strict=True):
        part = trial.provenance["part"]
        # 5 % of body weight leave the chair a little before the last newton.
        assert off - 0.15 < part["seat_off_s"] < off + 0.02
        assert up - 0.5 < part["standing_s"] < up + 0.05
        assert part["chair_bore_weight"] and part["standing_is_steady"]
        assert trial.start_s == part["seat_off_s"]
        assert time_of(trial)[-1] == pytest.approx(part["standing_s"])


def test_motion_and_forces_come_back(loaded, made):
    _, truth, _ = made
    subject, trials = loaded
    for trial in trials:
        at = np.round(time_of(trial) * RATE).astype(int)
        assert np.abs(trial.q - truth.q[at])[:, 2:].max() < np.deg2rad(0.005)
        assert np.abs(trial.q - truth.q[at])[:, :2].max() < 1e-9
        assert np.abs(trial.ground.force - truth.wrench.force[at]).max() < 5.0
        # Filtering alike keeps Newton's law: what is left stems from the
        # model's nonlinearity and the chair's last newtons.
        left = np.abs(residual(subject, trial))[15:]
        assert left[:, :2].max() < 0.2 and left[:, 2].max() < 0.1


def test_provenance_names_files_filter_and_shifts(loaded):
    _, trials = loaded
    said = trials[0].provenance
    assert said["markers"] == "sts.trc" and said["forces"] == "sts.mot"
    assert said["filter"]["cutoff_hz"] == 6.0
    assert max(map(abs, said["plate_shift_m"].values())) < 1e-9
    assert max(said["marker_residual_rms_m"].values()) < 1e-8
    assert said["one_leg_doubled"] is False


def test_one_trial_is_like_many(made, loaded):
    folder, _, study = made
    subject, trials = loaded
    (single,) = Recordings(study, folder, subject).trials(study.trials[1:])
    np.testing.assert_array_equal(single.q, trials[1].q)


@pytest.mark.slow
def test_window_instead_of_a_rise(made, loaded):
    folder, _, study = made
    subject, _ = loaded
    files = replace(study.trials[0], rise=None, start_s=2.0, end_s=3.0)
    (trial,) = Recordings(study, folder, subject).trials((files,))
    assert time_of(trial)[[0, -1]] == pytest.approx([2.0, 3.0])
    # A frame's time and a study's are not rounded alike.
    files = replace(files, start_s=2.0 + 1e-12, end_s=3.0 - 1e-12)
    (same,) = Recordings(study, folder, subject).trials((files,))
    np.testing.assert_array_equal(time_of(same), time_of(trial))
    files = replace(study.trials[0], rise=1, end_s=3.0)
    (trial,) = Recordings(study, folder, subject).trials((files,))
    assert time_of(trial)[-1] == pytest.approx(3.0)
    assert trial.start_s == trial.provenance["part"]["seat_off_s"]
    files = replace(study.trials[0], rise=None, start_s=2.0, end_s=2.17)
    assert len(Recordings(study, folder, subject).trials((files,))) == 1
    files = replace(files, end_s=2.16)
    with pytest.raises(InputError, match=r"shorter than a period .* \(6 Hz\)"):
        Recordings(study, folder, subject).trials((files,))


def test_one_leg_is_doubled(made, loaded):
    folder, truth, study = made
    subject, _ = loaded
    plates = replace(study.trials[0].plates, left=None)
    files = replace(study.trials[0], plates=plates)
    (trial,) = Recordings(study, folder, subject).trials((files,))
    assert trial.provenance["one_leg_doubled"] is True
    at = np.round(time_of(trial) * RATE).astype(int)
    # Plate 1 bears 40 %, so two of it bear 80 %.
    expected = 0.8 * truth.wrench.force[at, 1]
    np.testing.assert_allclose(trial.ground.force_z, expected, atol=0.2)


@pytest.mark.slow
def test_legs_apart_fore_and_aft(files, loaded):
    """Feet 8 cm apart give what feet side by side give."""
    folder, study = files
    stagger = {"L": 0.04, "R": -0.04}

    def move_legs(data):
        for i, name in enumerate(data.names):
            if name[2:] not in ("asis", "psis"):
                data.positions[:, i, 0] += stagger[name[0]]
        return data

    def move_plates(table):
        for side, number in (("L", 2), ("R", 1)):
            column = table.names.index(f"ground_force_{number}_px")
            table.values[:, column] += stagger[side]
        return table

    for name in ("sts", "static"):
        edit_markers(folder, move_legs, f"{name}.trc")
        edit_forces(folder, move_plates, f"{name}.mot")
    _, trials = load(study, folder)
    shifts = trials[0].provenance["plate_shift_m"]
    # Hips apart turn with the pelvis, which the shifted markers do not: the
    # trunk's angle suffers, the legs' hardly.
    assert shifts == pytest.approx({"left": -0.04, "right": 0.04}, abs=1e-3)
    q = trials[0].q - loaded[1][0].q
    assert np.abs(q[:, 2:5]).max() < np.deg2rad(0.5)
    assert (
        np.abs(trials[0].ground.cop_x - loaded[1][0].ground.cop_x).max() < 1e-3
    )


@pytest.fixture
def coupled(files):
    folder, study = files
    time = np.arange(900) / 150.0 + 0.5
    q = 20.0 * (1.0 - np.cos(time))[:, None] * [1.0, 2.0, 2.0]
    names = ("exo_ankle", "exo_knee", "exo_hip")
    write_table(folder / "exo.mot", Table(time, names, q, True))
    trials = tuple(
        replace(t, encoders=folder / "exo.mot") for t in study.trials
    )
    return folder, replace(study, model="coupled", trials=trials)


@pytest.mark.slow
def test_encoders_join_at_their_own_rate(coupled):
    folder, study = coupled
    study = replace(study, trials=study.trials[:1])
    _, (trial,) = load(study, folder)
    assert trial.coordinates.device == ("exo_ankle", "exo_knee", "exo_hip")
    t = time_of(trial)
    ankle = np.deg2rad(20.0) * (1.0 - np.cos(t))
    np.testing.assert_allclose(trial.q[:, 6], ankle, atol=2e-7)
    np.testing.assert_allclose(trial.q[:, 7], 2 * ankle, atol=4e-7)
    speed = np.deg2rad(20.0) * np.sin(t)
    np.testing.assert_allclose(trial.v[:, 6], speed, atol=3e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("own", "lag"), [(None, 0.1), (-0.04, -0.04)])
def test_a_trial_may_have_a_lag_of_its_own(coupled, own, lag):
    """Systems that are started by hand lag by another time in each trial."""
    folder, study = coupled
    late = replace(study.laboratory, encoder_delay_s=0.1)
    trials = (replace(study.trials[0], encoder_delay_s=own),)
    _, (trial,) = load(replace(study, trials=trials, laboratory=late), folder)
    assert trial.lags_s["encoders"] == lag
    ankle = np.deg2rad(20.0) * (1.0 - np.cos(time_of(trial) + lag))
    np.testing.assert_allclose(trial.q[:, 6], ankle, atol=2e-7)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [-0.06, 0.0234, 0.15])
def test_a_trial_goes_on_another_clock_as_if_read_again(coupled, lag):
    """Up to its ends: it knows what was shown before and after, too."""
    folder, study = coupled
    study = replace(study, trials=study.trials[:1])
    _, (trial,) = load(study, folder)
    reach = trial.around.times - trial.around.times[0]
    assert reach[-1] == pytest.approx(trial.duration + 0.2)
    assert trial.around.start_s == pytest.approx(trial.start_s - 0.1)
    assert trial.around.provenance == {}
    late = replace(study.laboratory, encoder_delay_s=lag)
    _, (again,) = load(replace(study, laboratory=late), folder)
    clocks = [Clock(trial.name, "encoders", lag, 0.004)]
    # Beyond 0.1 s the splines extrapolate.
    near = 1e-9 if abs(lag) <= 0.1 else 2e-4
    found = retimed(trial, clocks)
    np.testing.assert_allclose(found.q, again.q, atol=near)
    np.testing.assert_allclose(found.v, again.v, atol=50.0 * near)
    # From the readings, not from what was shifted before; and once more.
    first = retimed(trial, [Clock(trial.name, "encoders", -0.05, 0.004)])
    np.testing.assert_allclose(retimed(first, clocks).q, found.q, atol=1e-12)
    assert retimed(first, clocks).lags_s == found.lags_s
    # What somebody changed of the trial stays changed.
    other = replace(trial, q=trial.q + 0.01)
    np.testing.assert_allclose(retimed(other, clocks).q, found.q + 0.01)
    # What it got besides was not read around it.
    known = replace(trial, moments=np.zeros((len(trial.times), 6)))
    assert trial.readings is trial.around and known.readings is known
    assert retimed(known, clocks).around is known


@pytest.mark.slow
def test_what_is_around_a_trial_was_recorded(coupled):
    folder, study = coupled
    (files, *_), (start, end) = study.trials, (1.5, 3.0)
    files = replace(files, rise=None, start_s=start, end_s=end)
    table = read_table(folder / "exo.mot")
    for first, last in ((1.0, 3.5), (1.45, 3.03)):
        seen = (table.time >= first - 1e-9) & (table.time <= last + 1e-9)
        write_table(
            folder / "exo.mot",
            Table(table.time[seen], table.names, table.values[seen], True),
        )
        _, (trial,) = load(replace(study, trials=(files,)), folder)
        wide = trial.around
        ends = wide.start_s, wide.start_s + wide.duration
        wanted = max(first, start - 0.1), min(last, end + 0.1)
        assert ends == pytest.approx(wanted, abs=0.011)
    # Of people without a device nothing is shifted.
    human = replace(files, encoders=None)
    _, (alone,) = load(replace(study, model="human", trials=(human,)), folder)
    assert alone.around is None


@pytest.mark.slow
def test_without_encoders_the_exoskeleton_is_aligned(coupled):
    folder, study = coupled
    trials = (replace(study.trials[0], encoders=None),)
    _, (trial,) = load(replace(study, trials=trials), folder)
    np.testing.assert_array_equal(trial.q[:, 6:], trial.q[:, 3:6])
    assert "no encoders" in trial.provenance["exoskeleton_angles"]


@pytest.mark.slow
def test_encoders_shorter_than_the_trial(coupled):
    folder, study = coupled
    with pytest.raises(InputError, match=r"exo\.mot.*cover 0\.5 to 6\.49"):
        load(study, folder)  # the second rise ends at 7.6 s


def refusal(study, folder):
    with pytest.raises(InputError) as caught:
        load(study, folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edit_markers(folder, change, name="sts.trc"):
    data = read_trc(folder / name)
    write_trc(folder / name, change(data))


def edit_forces(folder, change, name="sts.mot"):
    write_table(folder / name, change(read_table(folder / name)))


def test_refuses_files_that_do_not_overlap(files):
    folder, study = files
    edit_forces(folder, lambda t: replace(t, time=t.time + 100.0))
    message = refusal(study, folder)
    assert "sts.mot" in message and "do not overlap in time" in message
    assert "laboratory.force_delay_s" in message  # 30 for 0.03 looks alike


def test_refuses_hardly_any_overlap(files):
    folder, study = files
    edit_forces(folder, lambda t: replace(t, time=t.time + 8.35))
    assert "at least 20" in refusal(study, folder)


def test_refuses_slow_markers(files):
    folder, study = files

    def thin(data):
        return replace(
            data,
            time=data.time[::5],
            positions=data.positions[::5],
            rate_hz=20.0,
        )

    edit_markers(folder, thin)
    message = refusal(study, folder)
    assert "sts.trc" in message and "four times" in message


def test_refuses_few_frames(files):
    folder, study = files
    edit_markers(
        folder,
        lambda d: replace(d, time=d.time[:19], positions=d.positions[:19]),
    )
    assert "holds 19 frames" in refusal(study, folder)


def test_refuses_slow_forces(files):
    folder, study = files

    def thin(table):
        return replace(table, time=table.time[::5], values=table.values[::5])

    edit_forces(folder, thin)
    message = refusal(study, folder)
    assert "sts.mot" in message and "four times" in message


def hide(folder, names, start, end, file="sts.trc"):
    """Markers unseen in the frames from start to end."""

    def change(data):
        for name in names:
            data.positions[start:end, data.names.index(name)] = np.nan
        return data

    edit_markers(folder, change, file)


@pytest.mark.slow
def test_a_marker_hidden_for_long_is_left_out_where_it_matters(files, loaded):
    folder, study = files
    hide(folder, ["R_sh1"], 150, 180)
    _, trials = load(study, folder)
    told = [t.provenance["markers_left_out"] for t in trials]
    assert told == [["R_sh1"], []]  # the second rise is elsewhere
    assert all(t.provenance["gaps_filled"] == {} for t in trials)
    for trial, whole in zip(trials, loaded[1], strict=True):
        assert np.abs(trial.q - whole.q).max() < 1e-6
    alone = Recordings(study, folder, loaded[0]).trials(study.trials[1:])
    np.testing.assert_array_equal(alone[0].q, trials[1].q)


@pytest.mark.slow
def test_refuses_too_few_markers_and_lists_all_gaps(files):
    folder, study = files
    hide(folder, ["R_heel"], 150, 180)
    hide(folder, ["R_meta"], 170, 185)
    hide(folder, ["R_ank"], 190, 200)
    hide(folder, ["L_meta", "L_heel", "L_ank"], 690, 700)
    message = refusal(study, folder)
    for part in (
        "sts.trc: trial rise1: ",
        "'R_heel' in 30 frames from 1.5 s (0.3 s)",
        "'R_meta' in 15 frames from 1.7 s",
        "'R_ank' in 10 frames from 1.9 s",
        "too few others are left on the foot right",
        "trial rise2: ",
        "'L_meta' in 10 frames from 6.9 s",
        "too few others are left on the foot left",
        "laboratory.fill_gaps_s (0 s)",
    ):
        assert part in message


@pytest.mark.slow
def test_fills_gaps_up_to_the_stated_length(files, loaded):
    folder, study = files
    hide(folder, ["R_sh1"], 160, 180)
    lax = replace(study.laboratory, fill_gaps_s=0.2)
    _, trials = load(replace(study, laboratory=lax), folder)
    frames = len(trials[0].times)
    assert trials[0].provenance["gaps_filled"] == {"R_sh1": 20 / frames}
    assert trials[1].provenance["gaps_filled"] == {}
    change = np.abs(trials[0].q - loaded[1][0].q)
    assert 0.0 < change.max() < 5e-4


def test_a_gap_across_the_edge_of_the_quiet_part_is_filled(files):
    folder, study = files
    part = replace(study.standing, start_s=0.4, end_s=0.8)
    lax = replace(study.laboratory, fill_gaps_s=0.2)
    lax = replace(study, standing=part, laboratory=lax)
    hide(folder, ["L_kne"], 35, 45, "static.trc")
    hide(folder, ["R_kne"], 0, 30, "static.trc")
    report = fit_subject(lax, folder).report
    assert report["standing_gaps_filled"] == {"L_kne": 5}
    hide(folder, ["L_kne"], 15, 45, "static.trc")
    with pytest.raises(InputError, match="'L_kne' in 30 frames"):
        fit_subject(lax, folder)


@pytest.mark.slow
def test_gaps_outside_the_used_part_do_no_harm(files, loaded):
    folder, study = files
    everything = [f"R_{n}" for n in ("sh1", "sh2", "kne", "heel", "meta")]
    hide(folder, everything, 840, 850)
    _, trials = load(study, folder)
    for trial, whole in zip(trials, loaded[1], strict=True):
        assert trial.provenance["markers_left_out"] == []
        assert np.abs(trial.q - whole.q).max() < 1e-12


@pytest.mark.slow
def test_lengths_in_another_unit_are_told(files):
    folder, study = files

    def in_millimetres(data):
        return replace(data, positions=1e3 * data.positions)

    edit_markers(folder, in_millimetres)
    message = refusal(study, folder)
    assert "sts.trc" in message and "another unit of length" in message

    def one_in_metres(data):
        p = 1e-3 * data.positions
        p[:, data.names.index("R_sh1")] *= 1e3
        return replace(data, positions=p)

    edit_markers(folder, one_in_metres)
    message = refusal(study, folder)
    assert "R_sh1 lie" in message and "another unit of length" in message


@pytest.mark.slow
def test_refuses_a_missing_marker(files):
    folder, study = files
    edit_markers(
        folder,
        lambda d: replace(
            d, names=tuple(n.replace("R_sh1", "R_shin1") for n in d.names)
        ),
    )
    assert "no marker 'R_sh1'; did you mean" in refusal(study, folder)


def test_refuses_a_plate_that_is_not_there(files):
    folder, study = files
    trial = replace(
        study.trials[0], plates=replace(study.trials[0].plates, left=3)
    )
    message = refusal(replace(study, trials=(trial,)), folder)
    assert "no force plate 3; it holds plates 1, 2" in message


@pytest.mark.slow
def test_forces_on_the_plate(files, loaded):
    folder, study = files

    def flip(table):
        sign = [-1.0 if "_v" in n else 1.0 for n in table.names]
        return replace(table, values=table.values * sign)

    plate = replace(study.laboratory, forces_act_on="plate")
    turned = replace(study, laboratory=plate)
    assert "forces_act_on: body" in refusal(turned, folder)
    edit_forces(folder, flip)
    assert "forces_act_on: plate" in refusal(study, folder)
    edit_forces(folder, flip, "static.mot")
    _, trials = load(turned, folder)
    np.testing.assert_allclose(
        trials[0].ground.force, loaded[1][0].ground.force, atol=1e-6
    )
    np.testing.assert_allclose(
        trials[0].ground.cop_x, loaded[1][0].ground.cop_x, atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_laboratory_may_be_written_down_in_any_way(files, loaded, mirrored):
    """Turned, elsewhere, later, points as moments; left and right exchanged."""
    folder, study = files
    ahead = np.array([7.0, 0.0, 2.0])
    across = np.array([1.0, 1.0, -1.0 if mirrored else 1.0])

    def move(table):
        # Force, point and moment of each plate.
        parts = table.values.reshape(-1, 2, 3, 3) * across
        # No point, but the moment about the origin.
        parts[:, :, 2] = np.cross(parts[:, :, 1] + ahead, parts[:, :, 0])
        parts[:, :, 1] = 0.0
        parts = parts[:, ::-1] if mirrored else parts
        values = (parts[..., [1, 2, 0]] * [-1, -1, 1]).reshape(len(parts), -1)
        return replace(table, time=table.time + 1000.0, values=values)

    other = str.maketrans("LR", "RL") if mirrored else {}
    for name in ("sts", "static"):
        seen = read_trc(folder / f"{name}.trc")
        names = tuple(n.translate(other) for n in seen.names)
        p = (seen.positions * across + ahead)[..., [2, 0, 1]] * [-1, -1, 1]
        data = MarkerData(seen.time + 1000.0, names, p, seen.rate_hz)
        write_trc(folder / f"{name}.trc", data)
        edit_forces(folder, move, f"{name}.mot")
    laboratory = replace(
        study.laboratory,
        marker_axes=Axes("-y", "z"),
        force_axes=Axes("z", "-x"),
    )
    _, trials = load(replace(study, laboratory=laboratory), folder)
    for found, plain in zip(trials, loaded[1], strict=True):
        assert found.start_s == pytest.approx(plain.start_s + 1000.0)
        q = found.q - np.eye(6)[0] * ahead[0]
        back = found.ground.shifted(-ahead[0])
        np.testing.assert_allclose(q, plain.q, atol=1e-6)
        np.testing.assert_allclose(back.array, plain.ground.array, atol=1e-4)
        np.testing.assert_allclose(found.moments, plain.moments, atol=1e-3)


@pytest.mark.slow
def test_reads_c3d_alike(files, loaded):
    folder, study = files
    data = read_trc(folder / "sts.trc")
    _, plates = read_plates(folder / "sts.mot")
    corners = np.array(
        [[0.9, 0, -0.3], [0, 0, -0.3], [0, 0, 0.3], [0.9, 0, 0.3]]
    )
    designs = [PlateDesign(corners), PlateDesign(corners, 3, (0.1, 0.2, -0.05))]
    write_types(folder / "sts.c3d", data, list(plates.values()), designs)
    trials = tuple(
        replace(t, markers=Path("sts.c3d"), forces=Path("sts.c3d"))
        for t in study.trials
    )
    _, found = load(replace(study, trials=trials), folder)
    np.testing.assert_allclose(found[0].q, loaded[1][0].q, atol=1e-6)
    np.testing.assert_allclose(
        found[0].ground.force, loaded[1][0].ground.force, atol=1e-3
    )
    np.testing.assert_allclose(
        found[0].ground.cop_x, loaded[1][0].ground.cop_x, atol=1e-5
    )
    bare = replace(study.trials[0], markers=Path("sts.c3d"))
    write_c3d(folder / "sts.c3d", data)
    bare = replace(bare, forces=Path("sts.c3d"))
    message = refusal(replace(study, trials=(bare,)), folder)
    assert "holds no force plate" in message


def test_refuses_files_of_another_kind(files):
    folder, study = files
    odd = replace(study.trials[0], markers=Path("sts.mot"))
    message = refusal(replace(study, trials=(odd,)), folder)
    assert "is not a marker file that can be read; give one of .trc" in message
    assert "whose coordinates it holds (model.human.osim)" in message


def test_refuses_a_rise_that_is_not_there(files):
    folder, study = files
    trial = replace(study.trials[0], rise=3)
    message = refusal(replace(study, trials=(trial,)), folder)
    assert "rise 3 was asked for, but 2 were found in sts.trc (" in message
    trial = replace(study.trials[0], rise=None, sit=2)
    message = refusal(replace(study, trials=(trial,)), folder)
    assert "sit 2 was asked for, but 1 were found" in message
    with pytest.raises(InputError, match="rise and sit both say which part"):
        replace(study.trials[0], sit=1)


@pytest.mark.slow
def test_refuses_a_window_outside(files):
    folder, study = files
    trial = replace(study.trials[0], rise=None, start_s=5.0, end_s=20.0)
    message = refusal(replace(study, trials=(trial,)), folder)
    assert "5 to 20 s reaches beyond the recording (0 to 8.49 s)" in message


def test_refuses_an_unknown_body_mass(made):
    folder, _, study = made
    study = replace(
        study,
        subject=replace(study.subject, mass_kg=None),
        standing=replace(study.standing, forces=None, plates=None),
        scaling=Scaling(trunk_com="table"),
    )
    assert "give subject.mass_kg" in refusal(study, folder)


def test_mass_comes_from_standing_if_not_stated(made):
    folder, _, study = made
    study = replace(study, subject=replace(study.subject, mass_kg=None))
    subject = fit_subject(study, folder)
    assert subject.mass_kg == pytest.approx(70.0, abs=1e-6)
    assert subject.report["mass_from"] == "standing"


@pytest.mark.slow
def test_real_rises_are_found(data_root, request):
    """Crossings of 0.75 m as the data's README lists them, five rises."""
    path = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    study = read_study(path, data_root)
    file, subject = study.file, study.subject
    recording = Recordings(file, study.root, subject).of(file.trials[0])
    halfway = [rise.halfway_s for rise in recording.rises]
    np.testing.assert_allclose(
        halfway, [1.12, 3.79, 6.40, 9.02, 11.72], atol=0.04
    )
    for rise in recording.rises:
        assert rise.chair_bore_weight and rise.standing_is_steady
        assert 0.5 < rise.standing_s - rise.seat_off_s < 1.0
        # The push-off is under way: force is far above body weight.
        i = np.searchsorted(recording.motion.time, rise.seat_off_s - 1e-9)
        F_z = sum(w.force_z[i] for w in recording.feet.values())
        assert 650.0 < F_z < 850.0
    sits = [sit.halfway_s for sit in recording.sits]
    # Where the recorded inverse kinematics has the pelvis come down past it.
    np.testing.assert_allclose(
        sits, [2.20, 4.85, 7.41, 10.13, 12.92], atol=0.04
    )
    for sit in recording.sits:
        assert sit.chair_bore_weight and sit.standing_is_steady
        assert 0.5 < sit.seat_on_s - sit.standing_s < 0.8
    assert subject.report["standing_mass_kg"] == pytest.approx(60.03, abs=0.01)


@pytest.mark.slow
def test_real_trials_obey_newton(data_root, request):
    path = request.path.parents[1] / "studies" / "opencap_sts1.yaml"
    study = read_study(path, data_root)
    for trial in study.trials():
        rms = np.sqrt(np.mean(residual(study.subject, trial) ** 2, axis=0))
        assert (rms < [24.0, 34.0, 24.0]).all(), rms


@pytest.mark.slow
def test_what_is_hidden_just_after_the_used_part_reaches_into_it(files, loaded):
    """By the filter: as far as a period of its cut-off."""
    folder, study = files
    _, (trial, _) = loaded
    end = round(RATE * (trial.start_s + trial.duration))
    hide(folder, ["R_sh1"], end + 5, end + 40)
    _, trials = load(study, folder)
    assert trials[0].provenance["markers_left_out"] == ["R_sh1"]
    assert np.abs(trials[0].v - trial.v).max() < 1e-8
    # All of a segment's own: its neighbours tell where it is.
    hide(folder, ["R_sh2", "R_kne"], end + 5, end + 40)
    _, trials = load(study, folder)
    assert len(trials[0].provenance["markers_left_out"]) == 3
    assert np.abs(trials[0].v - trial.v).max() < 5e-8


@pytest.mark.slow
def test_no_point_is_held_where_no_foot_ever_bears_enough(files):
    """The points were left as they were, as if nothing were to hold."""
    folder, study = files
    held = replace(study.laboratory, hold_cop_below_n=5e3)
    told = refusal(replace(study, laboratory=held), folder)
    assert "hold_cop_below_n is 5000, but no foot bears more than" in told
    # Of forces in kN the unit is told.
    edit_forces(
        folder,
        lambda t: replace(t, values=1e-3 * t.values),
    )
    held = replace(study.laboratory, hold_cop_below_n=50.0)
    told = refusal(replace(study, laboratory=held), folder)
    assert "(N, not kN)" in told and "hold_cop" not in told


@pytest.mark.slow
def test_a_clock_that_is_known_is_set_before_files_are_compared(files, loaded):
    folder, study = files
    table = read_table(folder / "sts.mot")
    write_table(folder / "sts.mot", replace(table, time=table.time + 30.0))
    late = replace(study.laboratory, force_delay_s=30.0)
    _, trials = load(replace(study, laboratory=late), folder)
    for trial, plain in zip(trials, loaded[1], strict=True):
        np.testing.assert_allclose(
            trial.ground.force, plain.ground.force, atol=1e-3
        )


@pytest.mark.slow
@pytest.mark.parametrize("everywhere", [False, True])
def test_who_faces_obliquely_does_so_on_the_plates(files, loaded, everywhere):
    """Turned by 217° to the left, in one trial or in the whole laboratory."""
    folder, study = files
    c, s = np.cos(np.deg2rad(217.0)), np.sin(np.deg2rad(217.0))
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    def move(table):
        values = table.values.reshape(len(table.values), -1, 3) @ turn.T
        return replace(table, values=values.reshape(table.values.shape))

    for name in ("sts", "static") if everywhere else ("sts",):
        data = read_trc(folder / f"{name}.trc")
        turned = replace(data, positions=data.positions @ turn.T)
        write_trc(folder / f"{name}.trc", turned)
        edit_forces(folder, move, f"{name}.mot")
    axes = Axes("-x", "y", 37.0)
    if everywhere:
        laboratory = replace(
            study.laboratory, marker_axes=axes, force_axes=axes
        )
        study = replace(study, laboratory=laboratory)
    else:
        trials = tuple(replace(t, marker_axes=axes) for t in study.trials)
        study = replace(study, trials=trials)
    _, trials = load(study, folder)
    for found, plain in zip(trials, loaded[1], strict=True):
        np.testing.assert_allclose(found.q, plain.q, atol=1e-6)
        np.testing.assert_allclose(
            found.ground.array, plain.ground.array, atol=1e-4
        )
        np.testing.assert_allclose(found.moments, plain.moments, atol=1e-3)


def test_who_faces_another_way_in_standing_does_so_on_its_plates(files, human):
    """Standing on a turned file, with all of its directions turned."""
    folder, study = files
    subject = fit_subject(study, folder)
    data = read_trc(folder / "static.trc")
    turn = np.array([-1.0, 1.0, -1.0])
    write_trc(
        folder / "static.trc", replace(data, positions=data.positions * turn)
    )
    table = read_table(folder / "static.mot")
    signs = [-1.0 if name.endswith(("x", "z")) else 1.0 for name in table.names]
    write_table(
        folder / "static.mot", replace(table, values=table.values * signs)
    )
    standing = replace(study.standing, marker_axes=Axes("-x", "y"))
    turned = fit_subject(replace(study, standing=standing), folder)
    assert turned.model.human.pelvis.com_m == pytest.approx(
        subject.model.human.pelvis.com_m
    )
