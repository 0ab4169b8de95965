"""A campaign is reproducible, obeys mechanics, and reads back as its truth."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

import drake_exo
from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table
from drake_exo.files.output import read_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.description import nominal_human
from drake_exo.study import read_study
from drake_exo.virtual_laboratory import campaign
from drake_exo.virtual_laboratory.campaign import protocol, write_campaign
from drake_exo.virtual_laboratory.instruments import plate_recording
from drake_exo.virtual_laboratory.plan import RisePlan
from drake_exo.virtual_laboratory.truth import DISTURBANCES

SEED = 4
FIRST = "passive_pelvis_4_3"
WEIGHT = 85.0 * 9.81


def written(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


@pytest.fixture(scope="module")
def simulations():
    """Movements simulated without disturbance, by name."""
    return {}


@pytest.fixture(scope="module")
def clean(tmp_path_factory, simulations):
    folder = tmp_path_factory.mktemp("clean")
    simulate = campaign.simulate

    def keep(name, *args, **kwargs):
        simulations[name] = simulate(name, *args, **kwargs)
        return simulations[name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "simulate", keep)
        write_campaign(folder, SEED, ["variation"], trials=1)
    return folder


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory):
    """All disturbances, two movements, by the command: in two processes."""
    folder = tmp_path_factory.mktemp("disturbed") / "campaign"
    command = ["lab", "--seed", str(SEED), "--trials", "2", "--truth", "near"]
    assert main([*command, "--out", str(folder)]) == 0
    return folder


def handed_over(folder, tmp_path):
    """The campaign as a calibration gets it, without its truth, read."""
    place = tmp_path / "handed_over"
    shutil.copytree(folder, place)
    shutil.rmtree(place / "truth")
    study = read_study(place / "study.yaml")
    return study.model, study.trials()


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def errors(folder, trial, lag_s=0.0):
    """RMS differences of a trial from what truly happened.

    Encoders lag; how much is found with all else, when a calibration solves.
    """
    truth = read_table(folder / "truth" / f"{trial.name}.sto")
    time = trial.start_s + trial.times
    i = np.round((time - truth.time[0]) * 100).astype(int)
    ground = ["ground_force_x", "ground_force_z", "ground_moment_y"]
    F_x, F_z, M_y = truth.columns(ground)[i].T
    names = trial.coordinates
    q = truth.columns(names.names)[i]
    for column, name in enumerate(names.names):
        if name.startswith("exo_"):
            q[:, column] = np.interp(
                time - lag_s, truth.time, truth.column(name)
            )
    v = truth.columns([f"{c}_speed" for c in names.names])[i]
    torque = truth.columns([f"{c}_torque" for c in names.joints])[i]
    # A rise that is worth the comparison, after the chair.
    assert np.rad2deg(np.ptp(q[:, names.index("knee")])) > 80.0
    assert np.abs(torque).max() > 50.0
    assert truth.column("chair_force_z")[i].max() < 1.0
    return {
        "angles_deg": np.rad2deg(rms(trial.q - q)[2:]),
        "foot_m": rms(trial.q - q)[:2],
        "velocities_deg_s": np.rad2deg(rms(trial.v - v)[2:]),
        "grf_n": rms(trial.ground.force - np.column_stack([F_x, F_z])),
        "cop_m": rms(trial.ground.cop_x + M_y / F_z),
        "moments_nm": rms(trial.moments - torque),
        **{
            f"{cuff}_n": rms(force.normal - truth.column(f"{cuff}_normal")[i])
            for cuff, force in trial.cuffs.items()
        },
    }


@pytest.mark.slow
def test_same_seed_same_bytes_in_one_process_or_two(disturbed, tmp_path):
    write_campaign(tmp_path, SEED, trials=1, truth="near")
    first, second = written(disturbed), written(tmp_path)
    studies = [
        yaml.safe_load(files.pop("study.yaml")) for files in (first, second)
    ]
    assert second.items() <= first.items()
    assert {"truth/truth.json", "standing.c3d", f"{FIRST}.c3d"} <= set(second)
    del studies[0]["trials"][1:]
    assert studies[0] == studies[1]


@pytest.mark.slow
def test_a_wide_truth_shows_the_faults_that_it_tells(tmp_path):
    """One fault at a time would take minutes: those that leave plain marks."""
    faults = ["encoder_offset", "mat_share", "legs", "body", "windows"]
    write_campaign(tmp_path, SEED, ["variation", *faults], trials=1)
    told = read_json(tmp_path / "truth" / "truth.json", "")
    assert told["truth"] == "wide"
    _, (trial,) = handed_over(tmp_path, tmp_path)
    truth = read_table(tmp_path / "truth" / f"{trial.name}.sto")
    time = trial.start_s + trial.times
    i = np.round((time - truth.time[0]) * 100).astype(int)
    exo = trial.coordinates.device
    off = trial.q[:, trial.coordinates.device_columns] - truth.columns(exo)[i]
    offset = told["faults"]["encoder_offset_rad"]
    assert np.abs(offset).max() > np.deg2rad(0.5)
    np.testing.assert_allclose(off.mean(axis=0), offset, atol=2e-3)
    seen = told["faults"]["mat_share"]["pelvis"]
    force = truth.column("pelvis_normal")[i]
    found = trial.cuff("pelvis").normal
    assert found @ force / (force @ force) == pytest.approx(seen, abs=0.02)
    human = told["parameters"]["human"]
    usual = nominal_human()
    ratio = human["thigh"]["length_m"] / usual.thigh.length_m
    assert 0.005 < abs(ratio - 1.0) < 0.04
    stiffness = told["parameters"]["cuffs"]["thigh"]["bushing"]
    assert stiffness["normal_damping"] != 10.0


@pytest.mark.slow
def test_undisturbed_files_hold_the_truth(clean, tmp_path):
    _, (trial,) = handed_over(clean, tmp_path)
    error = errors(clean, trial)
    assert error["angles_deg"].max() < 0.1
    assert error["foot_m"].max() < 1e-4
    assert error["velocities_deg_s"].max() < 2.0
    assert error["grf_n"].max() < 2.0
    assert error["cop_m"] < 5e-4
    assert error["moments_nm"].max() < 5.0
    assert error["pelvis_n"] < 1.0


@pytest.mark.slow
def test_opensim_files_hold_the_same(clean, simulations, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "simulate", lambda n, *_, **__: simulations[n])
        (tmp_path / "opensim").mkdir()
        write_campaign(
            tmp_path / "opensim", SEED, ["variation"], 1, files="opensim"
        )
    assert (tmp_path / "opensim" / f"{FIRST}.trc").is_file()
    _, (text,) = handed_over(tmp_path / "opensim", tmp_path)
    _, (binary,) = handed_over(clean, tmp_path / "binary")
    np.testing.assert_allclose(text.q, binary.q, atol=1e-5)
    text, binary = text.ground, binary.ground
    np.testing.assert_allclose(text.force, binary.force, atol=1e-2)
    np.testing.assert_allclose(text.cop_x, binary.cop_x, atol=1e-5)


@pytest.mark.slow
def test_disturbed_files_are_near_the_truth(clean, disturbed, tmp_path):
    _, trials = handed_over(disturbed, tmp_path)
    _, (perfect,) = handed_over(clean, tmp_path / "clean")
    for trial in trials:
        told = disturbed / "truth" / f"{trial.name}_clocks.json"
        lag = read_json(told, "")["device"]
        error = errors(disturbed, trial, lag)
        assert error["angles_deg"].max() < 2.0
        assert errors(disturbed, trial)["angles_deg"].max() > 2.0
        assert error["grf_n"].max() < 5.0
        assert error["moments_nm"].max() < 10.0
        assert error["pelvis_n"] < 10.0
    # The disturbances do disturb.
    quiet = errors(clean, perfect)
    for name in ("angles_deg", "moments_nm", "pelvis_n"):
        assert np.max(errors(disturbed, trials[0])[name]) > 1.3 * np.max(
            quiet[name]
        )


@pytest.mark.slow
def test_forces_change_the_momentum(clean, tmp_path):
    """Newton for the whole body: from velocities, and at every sample."""
    model, _ = handed_over(clean, tmp_path)
    truth = read_table(clean / "truth" / f"{FIRST}.sto")
    tree = model.tree
    nq = tree.num_positions
    q, v, a = truth.values[:, : 3 * nq].reshape(-1, 3, nq).swapaxes(0, 1)
    force = truth.columns(["ground_force_x", "ground_force_z"])
    force = force + truth.columns(["chair_force_x", "chair_force_z"])
    needed = tree.inverse_dynamics(q, v, a)[:, :2]
    assert np.abs(needed - force).max() < 0.5
    mass = tree.inverse_dynamics_jacobians(q, 0.0 * q, 0.0 * q)[2]
    momentum = np.einsum("nij,nj->ni", mass, v)[:, :2]
    force[:, 1] -= tree.weight
    step = truth.time[1] - truth.time[0]
    pushed = np.cumsum(0.5 * step * (force[1:] + force[:-1]), axis=0)
    gained = momentum[1:] - momentum[0]
    assert np.ptp(gained, axis=0).min() > 20.0  # N s
    assert np.abs(gained - pushed).max() < 0.1


@pytest.mark.slow
def test_the_chair_bears_while_seated(clean):
    truth = read_table(clean / "truth" / f"{FIRST}.sto")
    chair, feet = truth.columns(["chair_force_z", "ground_force_z"])[0]
    assert 0.4 * WEIGHT < chair < 0.8 * WEIGHT
    assert chair + feet == pytest.approx(WEIGHT, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["clean", "disturbed"])
def test_standing_settles_to_body_weight(kind, request):
    folder = request.getfixturevalue(kind)
    standing = read_table(folder / "truth" / "standing.sto")
    force = standing.column("ground_force_z")
    assert force[-1] == pytest.approx(WEIGHT, rel=1e-3)
    assert np.abs(force / WEIGHT - 1.0).max() < 0.01
    pitch, ankle, knee, hip = standing.columns(
        ["foot_pitch", "ankle", "knee", "hip"]
    )[-1]
    assert np.rad2deg(abs(pitch)) < 0.2
    assert np.rad2deg(abs(pitch - ankle + knee - hip)) < 0.2


def test_protocol_is_that_of_the_paper():
    used, everything = protocol(), protocol(full=True)
    assert len(used) == 9
    assert [m.mode for m in used] == ["passive"] * 3 + ["assisted"] * 6
    assert [m.configuration for m in used[:3]].count("pelvis") == 2
    assert len(everything) == len(set(everything)) == 60
    assert everything[:9] == used
    assert protocol(3) == used[:3]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"disturbances": ["marker_nois"]}, "marker_noise"),
        (
            {"disturbances": "gaps"},
            "disturbances: 'gaps' is not a list of names",
        ),
        ({"seed": -1}, "seed is -1; give a whole number from 0 on"),
        ({"seed": "x"}, "seed is 'x'; give a whole number from 0 on"),
        ({"seed": 1.5}, "seed is 1.5; give a whole number"),
        ({"trials": 0}, "trials is 0"),
        ({"trials": "x"}, "trials is 'x'; give 1 to 9"),
        ({"trials": 1.5}, "trials is 1.5; give 1 to 9"),
        ({"processes": None}, "processes is None"),
        ({"design": "designed"}, "design is 'designed'; give a Design"),
        ({"folder": 5}, "folder is 5; give a path"),
        ({"trials": 10}, "1 to 9"),
        ({"files": "mat"}, "c3d, opensim"),
    ],
)
def test_bad_requests_are_refused(tmp_path, arguments, message):
    with pytest.raises(InputError, match=message):
        write_campaign(**{"folder": tmp_path, "seed": 0, **arguments})
    assert not list(tmp_path.iterdir())


def test_results_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "study.yaml").write_text("mine")
    with pytest.raises(InputError, match="holds a study already"):
        write_campaign(tmp_path, seed=1, trials=1)
    assert [p.name for p in tmp_path.iterdir()] == ["study.yaml"]
    (tmp_path / "study.yaml").rename(tmp_path / "notes.txt")
    assert main(["lab", "--out", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err


def test_command_names_the_disturbances(capsys):
    with pytest.raises(SystemExit):
        main(["lab", "--help"])
    text = capsys.readouterr().out
    assert all(name in text for name in DISTURBANCES)


def test_plates_keep_the_wrench_without_load():
    rng = np.random.default_rng(0)
    wrench = PlanarWrench(rng.normal(0.0, 20.0, (50, 2)), rng.normal(size=50))
    assert (wrench.force[:, 1] < 20.0).any()
    plate = plate_recording(1, wrench, "chair")
    moment = plate.moment_about_origin()
    np.testing.assert_allclose(-moment[:, 2], wrench.moment, atol=1e-12)


def test_calibration_never_looks_at_the_truth():
    """Only commands and the list of names know of the virtual laboratory."""
    package = Path(drake_exo.__file__).parent
    allowed = {"__init__.py", "cli/lab.py", "cli/demo.py", "cli/design.py"}
    for path in package.rglob("*.py"):
        name = path.relative_to(package).as_posix()
        if "virtual_laboratory" in path.parts or name in allowed:
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        # Examples in documentation are on made-up data.
        text = "\n".join(x for x in lines if not x.strip().startswith(">>>"))
        assert "virtual_laboratory" not in text, path
        assert "truth/" not in text, path
        assert "truth.json" not in text, path


def test_what_reaches_the_phases_is_weighed_by_its_noise():
    """Angles 0.5°, the foot 1 mm; forces 3 N, their point half a millimetre."""
    told = {
        "angle_deg": 0.5, "velocity_deg_s": 4.0, "foot_m": 1e-3,
        "foot_pitch_deg": 0.3, "force_n": 3.0, "cop_m": 5e-4,
    }  # fmt: skip
    forces = {"moment_nm": 5.0, "exo_moment_nm": 0.3, "energy_j": 1.0}
    found = campaign.phase_sections()
    ground = found["foot_ground"]
    assert ground["noise"] == told
    own = {"exo_angle_deg": 0.1, "exo_velocity_deg_s": 1.0}
    # Where only ends are held, skin is off by more than the error model knows.
    ends = {"angle_deg": 1.0}
    assert found["prediction"]["noise"] == told | forces | ends
    # A passive device's friction is known better than an assistance.
    forces["exo_moment_nm"] = 0.1
    assert found["interaction"]["noise"] == told | own | forces
    assert ground["solver"] == {"nodes_per_second": 100.0}
    # Soles of 1 to 20 MPa, half of it under either of two legs.
    for legs, moduli in ((1, (5e6, 1e6, 2e7)), (2, (2.5e6, 0.5e6, 1e7))):
        found = campaign.phase_sections(legs)["foot_ground"]
        for sphere in ("heel", "toe"):
            own = found[sphere]["modulus_n_m2"]
            assert tuple(own.values()) == moduli
            assert found[sphere]["dissipation_s_m"]["nominal"] == 2.0


@pytest.fixture
def job(tmp_path, monkeypatch):
    """A campaign that simulates nothing, and what it was asked to."""
    (tmp_path / "truth").mkdir()
    made = campaign.Campaign(tmp_path, 4, frozenset(), "c3d", "near")
    made.asked = []
    times = np.arange(5001) / 1000.0
    chair = PlanarWrench.of(
        np.outer(times < 1.4, [0.0, 400.0, 0.0]).astype(float)
    )

    def simulate(name, truth, plan, *said, **more):
        made.asked.append((name, plan, *said))
        q = np.zeros((3, len(truth.model.coordinates)))
        q[:, 0] = 1.0, 2.0, 3.0
        return SimpleNamespace(name=name, times=times, chair=chair, q=q)

    monkeypatch.setattr(campaign, "simulate", simulate)
    monkeypatch.setattr(campaign, "write_happened", lambda *_: None)
    monkeypatch.setattr(campaign.Campaign, "measure", lambda *_: None)
    monkeypatch.setattr(
        campaign.Laboratory, "record_motion", lambda *_, **__: None
    )
    monkeypatch.setattr(
        campaign, "write_scans", lambda folder, model, q, mats: (q, mats)
    )
    return made


def test_a_movement_is_helped_from_the_chair_to_the_stand(job, monkeypatch):
    """Its span begins 80 ms after the lean, and ends 100 ms after the rise."""
    plan = replace(RisePlan(), quiet_s=0.3, lean_s=0.6, rise_s=0.9, stand_s=0.5)
    monkeypatch.setattr(campaign, "RisePlan", lambda: plan)
    monkeypatch.setattr(job.planner, "seat", lambda plan: "seat")
    monkeypatch.setattr(
        job.planner, "movement", lambda plan, seat: (plan, seat)
    )
    for mode, help_share in (
        ("passive", ()),
        ("assisted", (0.0, 0.2, 0.2)),
    ):
        entry = job.record(campaign.Repetition(mode, "legs", 5))
        name, meant, seat, share, span, *_ = job.asked[-1]
        assert name == entry["name"] == f"{mode}_legs_5_3"
        assert meant == (plan, "seat") and seat == "seat"
        assert share == help_share
        assert span == pytest.approx((0.3 + 0.6 + 0.08, 0.3 + 0.6 + 0.9 + 0.1))
        use = "prediction" if "exo_moments" in entry else "calibration"
        assert entry["use"] == use and (mode == "assisted") == any(share)
        # The chair's last millisecond, 80 ms later, to the frame.
        assert (entry["start_s"], entry["end_s"]) == (1.48, 1.9)


def test_scans_are_taken_at_the_end_of_standing(job):
    q, mats = job.prepare()
    assert job.asked[0][0] == "standing"
    plan = job.asked[0][1]
    assert plan.times[-1] == 2.0
    cop = plan.ground.cop_x[0]
    assert cop == pytest.approx(0.045, abs=1e-3)
    assert q[0] == 3.0
    assert [mat.name for mat in mats] == [
        "pelvis_front", "pelvis_back", "thigh_front", "thigh_back",
        "shank_front", "shank_back",
    ]  # fmt: skip
