"""Trials that start on a chair, in an exoskeleton."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from seated_recording import VISCOUS, write_seated
from synthetic_recording import RATE, SEAT_OFF, load

from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table, write_table
from drake_exo.measurement.events import until_seat_off
from drake_exo.measurement.processing import Recordings
from drake_exo.measurement.quality import assess, force_residual, text_of
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import (
    Device,
    Load,
    Mat,
    Plates,
    PressureFile,
    TrialFiles,
)
from drake_exo.measurement.subject import fit_subject
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.segments import scale_human


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seated")
    human = scale_human(70.0, 1.75)
    return folder, *write_seated(folder, human)


@pytest.fixture(scope="module")
def loaded(made):
    folder, _, study = made
    subject, (trial,) = load(study, folder)
    return subject, trial


def samples(trial):
    """Of the recording that are the trial's."""
    return np.round((trial.start_s + trial.times) * RATE).astype(int)


def with_trial(study, **changes):
    return replace(study, trials=(replace(study.trials[0], **changes),))


def with_laboratory(study, **changes):
    return replace(study, laboratory=replace(study.laboratory, **changes))


@pytest.mark.slow
def test_starts_seated_and_ends_standing(loaded):
    _, trial = loaded
    part = trial.provenance["part"]
    assert part["seated_s"] == 0.8
    assert trial.start_s == pytest.approx(part["seat_off_s"] - 0.8)
    assert SEAT_OFF[0] - 0.15 < part["seat_off_s"] < SEAT_OFF[0] + 0.02
    chair = trial.chair.array
    assert chair[0, 1] > 500.0 and not chair[-1].any()


@pytest.mark.slow
def test_chair_is_as_it_was_until_seat_off(loaded, made):
    _, truth, _ = made
    subject, trial = loaded
    chair, true = trial.chair.array, truth.chair.array[samples(trial)]
    share = 0.05 * subject.model.tree.weight
    off = trial.provenance["part"]["seat_off_s"]
    time = trial.start_s + trial.times
    before, after = time < off - 0.2, time > off + 0.05
    assert np.abs(chair - true)[before].max() < 8.0  # the filter
    assert np.abs(chair - true).max() < share
    assert not chair[after].any()


def test_newton_holds_from_the_chair_to_standing(loaded):
    subject, trial = loaded
    residual = force_residual(subject, trial)
    off = trial.provenance["part"]["seat_off_s"]
    near = (
        np.abs(trial.start_s + trial.times - off) < 0.1
    )  # where 5 % are let go
    assert np.abs(residual[~near, :2]).max() < 6.0
    assert np.abs(residual[~near, 2]).max() < 3.0
    unaware = replace(trial, chair=None)
    assert np.abs(force_residual(subject, unaware)).max() > 500.0


@pytest.mark.slow
def test_a_sit_ends_on_the_chair(made):
    """From standing until half a second after the first touch."""
    folder, truth, study = made
    study = with_trial(study, rise=None, sit=1, seated_s=0.5)
    subject, (trial,) = load(study, folder)
    part = trial.provenance["part"]
    assert trial.start_s == pytest.approx(part["standing_s"])
    end = trial.start_s + trial.times[-1]
    assert end == pytest.approx(part["seat_on_s"] + 0.5)
    chair, true = trial.chair.array, truth.chair.array[samples(trial)]
    assert not chair[0].any() and chair[-1, 1] > 500.0
    time = trial.start_s + trial.times
    touched = np.abs(time - part["seat_on_s"]) < 0.1
    assert np.abs(chair - true)[~touched].max() < 8.0
    residual = force_residual(subject, trial)
    assert np.abs(residual[~touched, :2]).max() < 6.0


def test_moments_are_the_true_ones(loaded, made):
    _, truth, _ = made
    _, trial = loaded
    at = samples(trial)
    human = (truth.resultant - truth.exo)[at]
    off = np.abs(trial.moments[:, :3] - human)
    assert np.sqrt((off**2).mean(axis=0)).max() < 2.0 and off.max() < 8.0
    assert np.abs(trial.moments[:, 3:] - truth.exo[at]).max() < 0.03
    said = trial.provenance["moments"]
    assert said["exoskeleton"] == "device model"


@pytest.mark.slow
def test_recorded_moments_come_before_the_model(made, loaded):
    folder, truth, study = made
    recorded = with_trial(study, exo_moments=Path("moments.csv"))
    _, (trial,) = load(recorded, folder)
    at = samples(trial)
    assert np.abs(trial.moments[:, 3:] - truth.exo[at]).max() < 0.03
    assert trial.provenance["moments"]["exoskeleton"] == "recorded"
    total = trial.moments[:, :3] + trial.moments[:, 3:]
    _, modelled = loaded
    np.testing.assert_allclose(
        total, modelled.moments[:, :3] + modelled.moments[:, 3:], atol=1e-9
    )
    # One leg's file counts twice, and is said to.
    one = replace(recorded, device=Device(moment_legs="right"))
    _, (doubled,) = load(one, folder)
    np.testing.assert_allclose(
        doubled.moments[:, 3:], 2.0 * trial.moments[:, 3:]
    )
    assert "right leg doubled" in doubled.provenance["moments"]["exoskeleton"]


@pytest.mark.slow
def test_without_device_and_recording_the_split_is_unknown(made):
    folder, _, study = made
    _, (trial,) = load(replace(study, device=None), folder)
    assert trial.moments is None
    assert "unknown" in trial.provenance["moments"]["human"]


@pytest.mark.slow
def test_a_share_of_the_chair_on_the_thighs(made, loaded):
    """It bears the same; knees and above feel the difference, not below."""
    folder, _, study = made
    _, (shared,) = load(with_laboratory(study, chair_on_thighs=0.4), folder)
    subject, trial = loaded
    assert shared.chair_on_thighs == 0.4
    np.testing.assert_array_equal(shared.chair.array, trial.chair.array)
    np.testing.assert_allclose(
        force_residual(subject, shared),
        force_residual(subject, trial),
        atol=1e-9,
    )
    # From the ground up, a joint feels what acts below it.
    change = shared.moments[:, :3] - trial.moments[:, :3]
    np.testing.assert_allclose(change[:, :2], 0.0, atol=1e-9)
    # About the hips, what the chair does to the thighs.
    hip = made[1].tree.point_positions(trial.q[:, :6], "pelvis", (0.0, 0.0))[
        0, 0
    ]
    moment = trial.chair.moment[0] + hip * trial.chair.force_z[0]
    assert np.abs(change[0, 2]) == pytest.approx(0.4 * abs(moment), abs=2e-7)


def test_trials_with_chair_and_mats_survive_saving(tmp_path, loaded):
    _, trial = loaded
    trial = replace(
        trial,
        cuffs={"shank": CuffForce(trial.ground.force_x)},
        chair_on_thighs=0.25,
    )
    trial.save(tmp_path / "t")
    back = Trial.load(tmp_path / "t")
    np.testing.assert_array_equal(back.chair.array, trial.chair.array)
    np.testing.assert_array_equal(
        back.cuff("shank").normal, trial.ground.force_x
    )
    np.testing.assert_array_equal(back.moments, trial.moments)
    assert back.chair_on_thighs == 0.25


@pytest.mark.slow
def test_plates_are_levelled_by_an_empty_recording_and_by_themselves(files):
    """Feet never leave their plates; the chair is left at seat-off."""
    folder, study = files
    _, (plain,) = load(study, folder)

    def shift(name, offset):
        table = read_table(folder / name)
        values = table.values + 0.0
        for number, force in offset.items():
            column = table.names.index(f"ground_force_{number}_vy")
            values[:, column] += force
        write_table(folder / name, replace(table, values=values))

    nothing = read_table(folder / "sts.mot")
    write_table(
        folder / "empty.mot", replace(nothing, values=0 * nothing.values)
    )
    for name in ("sts.mot", "empty.mot"):
        shift(name, {1: 14.0, 2: -8.0})
    shift("sts.mot", {3: 60.0})
    levelled = with_laboratory(
        with_trial(study, empty_plates=Path("empty.mot")),
        remove_plate_drift=True,
    )
    _, (trial,) = load(levelled, folder)
    np.testing.assert_allclose(
        trial.ground.force, plain.ground.force, atol=1e-6
    )
    assert np.abs(trial.chair.array - plain.chair.array).max() < 1e-6
    found = trial.provenance["plate_levels"]
    assert found["right"]["empty_plate_n"] == pytest.approx(14.0)
    assert found["left"]["unloaded_s"] == 0.0
    assert found["chair"]["offset_n"] == pytest.approx(60.0)


@pytest.mark.slow
def test_a_chair_weighs_nothing(files, loaded):
    """Also where nothing else is levelled."""
    folder, study = files
    table = read_table(folder / "sts.mot")
    values = table.values + 0.0
    for number in (1, 3):
        values[:, table.names.index(f"ground_force_{number}_vy")] += 12.0
    write_table(folder / "sts.mot", replace(table, values=values))
    _, (trial,) = load(study, folder)
    off = trial.chair.force_z - loaded[1].chair.force_z
    assert np.abs(off).max() < 1e-8
    off = trial.ground.force_z - loaded[1].ground.force_z
    np.testing.assert_allclose(off, 12.0)


def test_plates_that_somebody_stands_on_are_not_empty(files):
    folder, study = files
    with pytest.raises(InputError, match=r"empty_plates bear \d{3} N; name"):
        load(with_trial(study, empty_plates=Path("sts.mot")), folder)


@pytest.mark.slow
def test_a_late_force_clock_is_found_by_feet_and_chair(files):
    folder, study = files
    table = read_table(folder / "sts.mot")
    write_table(folder / "sts.mot", replace(table, time=table.time + 0.013))
    found = with_laboratory(study, estimate_force_delay=True)
    _, (trial,) = load(found, folder)
    assert trial.provenance["delays_s"]["forces"] == pytest.approx(0.013)


@pytest.mark.slow
def test_a_lag_that_is_found_is_that_of_all_forces(files):
    """Of a handle's, too, and what ends before the markers is not held."""
    folder, study = files
    table = read_table(folder / "sts.mot")
    share = np.array([n.startswith("ground_force_1_v") for n in table.names])
    late, end = table.time + 0.1, table.time[-1]
    for name, factor in (("sts", 1.0 - 0.4 * share), ("handle", 0.4 * share)):
        one = replace(table, time=late, values=factor * table.values)
        rows = late <= end
        one = replace(one, time=late[rows], values=one.values[rows])
        write_table(folder / f"{name}.mot", one)
    loads = (Load("pelvis", forces=Path("handle.mot"), plate=1),)
    study = with_laboratory(
        with_trial(study, loads=loads),
        estimate_force_delay=True,
        largest_delay_s=0.2,
    )
    subject = fit_subject(study, folder)
    found = Recordings(study, folder, subject).of(study.trials[0])
    lag = found.delays_s["forces"]
    assert lag == pytest.approx(0.1)
    time = found.motion.time
    assert end - lag - 0.011 < time[-1] <= found.forces.time[-1] + 1e-9
    for one in (found.motion.q, found.motion.legs["left"], found.chair.moment):
        assert len(one) == len(time)
    handle = found.motion.applied["pelvis"].force_z
    foot = found.feet["right"].force_z
    np.testing.assert_allclose(handle, foot * 0.4 / 0.6, atol=1e-6)


def pressure_csv(path, cells, end=9.0):
    time = np.arange(0.0, end, 0.02)
    names = ",".join(f"c{i}" for i in range(cells))
    rows = [f"{t:.2f}," + ",".join(["10"] * cells) for t in time]
    path.write_text("\n".join([f"time [s]; kPa,{names}", *rows]) + "\n")


def with_mat(study, **changes):
    mat = {
        "segment": "thigh",
        "rows": 2,
        "columns": 3,
        "cell_area_m2": 2e-4,
        "plane_normal": (1.0, 0.0, 0.0),
        **changes,
    }
    file = PressureFile(Path("mat.csv"), ("front",))
    study = replace(study, mats={"front": Mat(**mat)})
    return with_trial(study, pressure=(file,))


@pytest.mark.slow
def test_mats_push_by_segment_and_one_leg_counts_twice(files):
    folder, study = files
    pressure_csv(folder / "mat.csv", 6)
    _, (trial,) = load(with_mat(study), folder)
    np.testing.assert_allclose(trial.cuff("thigh").normal, -12.0, rtol=1e-6)
    subject, (one,) = load(with_mat(study, legs="left"), folder)
    np.testing.assert_allclose(one.cuff("thigh").normal, -24.0, rtol=1e-6)
    report = text_of(assess(subject, (one,)))
    assert "left leg measured, doubled" in report
    _, (bare,) = load(replace(with_mat(study), model="human"), folder)
    assert bare.cuffs == {} and "pressure" not in bare.provenance["delays_s"]


@pytest.mark.slow
@pytest.mark.parametrize(("own", "lag"), [(None, 0.1), (-0.2, -0.2)])
def test_mats_of_a_trial_may_have_a_lag_of_their_own(files, own, lag):
    folder, study = files
    late = replace(study.laboratory, pressure_delay_s=0.1)
    study = replace(with_mat(study), laboratory=late)
    time = np.arange(0.0, 9.0, 0.02)
    rows = [f"{t:.2f}," + ",".join([f"{10 * t:g}"] * 6) for t in time]
    head = "time [s]; kPa,a,b,c,d,e,f"
    (folder / "mat.csv").write_text("\n".join([head, *rows]) + "\n")
    _, (trial,) = load(with_trial(study, pressure_delay_s=own), folder)
    assert trial.lags_s["pressure"] == lag
    shown = -12.0 * (trial.times + trial.start_s + lag)
    np.testing.assert_allclose(trial.cuff("thigh").normal, shown, atol=1e-3)


@pytest.mark.slow
def test_refuses_mats_that_are_short_or_of_another_size(files):
    folder, study = files
    pressure_csv(folder / "mat.csv", 6, end=1.6)
    with pytest.raises(InputError, match=r"mat\.csv: pressures of front cover"):
        load(with_mat(study), folder)
    with pytest.raises(InputError, match=r"has 6 cells.*front 16 x 8"):
        load(with_mat(study, rows=16, columns=8), folder)


@pytest.mark.slow
def test_refuses_encoders_and_moments_that_are_short(files):
    folder, study = files
    for name in ("exo.csv", "moments.csv"):
        path = folder / name
        whole = path.read_text()
        path.write_text("\n".join(whole.splitlines()[:180]) + "\n")
        case = with_trial(study, exo_moments=Path("moments.csv"))
        with pytest.raises(
            InputError,
            match=rf"{name}: .* cover 0 to 1\.78 s.* or correct enc.*_delay_s",
        ):
            load(case, folder)
        path.write_text(whole)


def test_refuses_a_chair_plate_that_is_not_there(files):
    folder, study = files
    plates = Plates(left=2, right=1, chair=7)
    with pytest.raises(InputError, match="has no force plate 7"):
        load(with_trial(study, plates=plates), folder)


def test_a_seated_start_needs_a_rise_and_a_chair():
    common = {
        "name": "t",
        "markers": Path("m"),
        "forces": Path("f"),
        "seated_s": 1.0,
    }
    with pytest.raises(InputError, match="needs the chair's plate"):
        TrialFiles(plates=Plates(left=1, right=2), rise=1, **common)
    with pytest.raises(InputError, match="counts back from a rise"):
        TrialFiles(plates=Plates(left=1, right=2, chair=3), **common)
    plates = Plates(left=1, right=2, chair=3)
    with pytest.raises(InputError, match="seated_s and start_s both say"):
        TrialFiles(plates=plates, rise=1, start_s=2.0, **common)
    with pytest.raises(InputError, match="seated_s and end_s both say"):
        TrialFiles(plates=plates, sit=1, end_s=2.0, **common)
    TrialFiles(plates=plates, rise=1, end_s=2.0, **common)
    for what, key in {"rise": "begin", "sit": "end"}.items():
        with pytest.raises(InputError, match=f"where the {what} .*s; leave"):
            TrialFiles(
                plates=plates, **{what: 1, key: "toe_off left 1"}, **common
            )
    # From a chair into a walk.
    TrialFiles(plates=plates, rise=1, end="toe_off left 1", **common)
    with pytest.raises(InputError, match="under the chair and a foot"):
        Plates(left=1, right=2, chair=2)


def test_nothing_is_left_of_a_chair_nobody_sits_on():
    time = np.arange(100) / 100.0
    noise = PlanarWrench(np.full((100, 2), 3.0), np.full(100, 1.0))
    found = until_seat_off(time, noise, 700.0)
    assert not found.force.any() and not found.moment.any()


def test_friction_of_the_device_is_that_of_the_study(made):
    _, _, study = made
    assert [
        getattr(study.device, j).viscous_nm_s for j in ("ankle", "knee", "hip")
    ] == list(VISCOUS)
