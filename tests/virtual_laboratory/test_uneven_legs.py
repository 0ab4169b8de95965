"""Two legs that bear unequally, and a device for hip and knee of both."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.interpolate import make_interp_spline

import drake_exo as dx
from drake_exo.calibration.design import DesignProblem, works
from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.settings import (
    DesignSettings,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.wearers import OwnMovement, Wearer
from drake_exo.cli import main
from drake_exo.contact.parameters import nominal_contact
from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table
from drake_exo.jobs.engine import Processes
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.measurement.mats import cell_directions
from drake_exo.measurement.settings import Mat, Scan
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import SIDES
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import campaign, plan, two_legs
from drake_exo.virtual_laboratory.campaign import write_yaml
from drake_exo.virtual_laboratory.forces import ground_wrench, resting_foot
from drake_exo.virtual_laboratory.instruments import (
    CELL_AREA_M2,
    Laboratory,
    cell_pressures,
    write_scans,
)
from drake_exo.virtual_laboratory.two_legs import (
    _SQUAT,
    ACTING,
    TwoLegs,
    write_movements,
)


def draw(path, seed, active, movement="rise"):
    return TwoLegs(Path(), path, movement, seed, active)


def test_an_ankle_holds_the_shank_against_the_vertical(alone):
    """However the pelvis, or the foot, stands."""
    two = draw(alone, 3, frozenset()).truth.model.rigid.tree
    for tree, sides in ((nominal_model("human").tree, [""]),
                        (two, ["_left", "_right"])):  # fmt: skip
        names = tree.coordinates
        q = np.linspace(0.1, 0.9, len(names)) ** 2
        held = dict(zip(names.human, plan.held_rows(names) @ q, strict=True))
        for side in sides:
            (turn,) = tree.body_angles(q[None], f"shank{side}")
            assert held[f"ankle{side}"] == pytest.approx(-turn)
            knee = q[names.index(f"knee{side}")]
            assert held[f"knee{side}"] == knee


def test_legs_reach_from_the_pelvis_to_the_foot(alone):
    """However both stand, bent at the knee."""
    subject = draw(alone, 3, frozenset())
    tree = subject.truth.model.rigid.tree
    names = tree.coordinates
    root = np.array([[0.1, 0.8, 0.0], [-0.2, 0.6, 0.3], [0.0, 0.7, -0.4]])
    foot = np.array([[0.0, 0.08, 0.0], [0.1, 0.07, -0.2], [-0.1, 0.1, 0.1]])
    q = np.zeros((3, len(names)))
    q[:, :3] = root
    bent = two_legs._bent(subject.truth.human, root, foot)
    for joint, angle in zip(("hip", "knee", "ankle"), bent, strict=True):
        q[:, names.index(f"{joint}_left")] = angle
    assert (bent[1] > 0.1).all()
    at = tree.point_positions(q, "foot_left", (0.0, 0.0))
    np.testing.assert_allclose(at, foot[:, :2], atol=1e-9)
    turn = tree.body_angles(q, "foot_left")
    np.testing.assert_allclose(turn, foot[:, 2], atol=1e-9)


@pytest.mark.slow
def test_a_plan_of_two_legs_obeys_newton(worn):
    """Feet where soles sink to, each leg bearing its share."""
    subject, share = draw(worn, 3, frozenset(ACTING)), 0.7
    quick = replace(_SQUAT, quiet_s=0.2, lean_s=0.6, rise_s=0.6, stand_s=0.2)
    squat = subject.planner.movement(quick)
    found = subject.both_legs(squat, share)
    tree = subject.truth.model.rigid.tree
    names = tree.coordinates
    path = make_interp_spline(found.times, found.q, k=5)
    v, a = (path.derivative(k)(found.times) for k in (1, 2))
    np.testing.assert_allclose(found.v, v)
    loads = {
        "foot_left": found.ground.scaled(share),
        "foot_right": found.ground.scaled(1.0 - share),
    }
    Q = inverse_dynamics(tree, found.q, v, a, loads)
    np.testing.assert_allclose(Q[:, names.root_columns], 0.0, atol=1e-7)
    np.testing.assert_allclose(Q[:, names.joint_columns], found.moments)
    weight = subject.truth.model.tree.weight
    np.testing.assert_allclose(found.ground.force_z[[0, -1]], weight, rtol=1e-3)
    left, right = (
        tree.point_positions(found.q, f"foot_{side}", (0.0, 0.0)).T
        for side in ("left", "right")
    )
    # Under one hip, and the heavier foot deeper in its sole.
    np.testing.assert_allclose([left[0], right[0]], 0.0, atol=1e-9)
    assert (left[1] < right[1] - 1e-4).all()
    assert np.abs(left[1] - right[1]).max() < 0.01
    # And both so deep that they bear the device, too.
    rest = np.zeros_like(found.q[:1])
    for foot, wrench in loads.items():
        contact = subject.truth.contact
        borne = ground_wrench(tree, contact, found.q[:1], rest, foot)
        np.testing.assert_allclose(borne.force_z, wrench.force_z[:1], rtol=1e-4)


@pytest.mark.slow
def test_an_uneven_rise_is_calibrated(alone, tmp_path):
    """One leg bears 70 %: forces of either foot within 10 N."""
    folder = tmp_path / "lab"
    folder.mkdir()
    study = write_movements(folder, alone, seed=2, trials=1, left_share=0.7)
    study = dx.read_study(study)
    (trial,) = study.trials()
    total = trial.ground.force_z
    share = trial.feet["left"].force_z / total
    assert share.mean() == pytest.approx(0.7, abs=2e-4)
    assert total[-1] == pytest.approx(study.model.tree.weight, abs=3.0)
    found = dx.calibrate_foot_ground(study)
    assert found.success
    # Spheres that nothing tells apart stay where the study has them.
    assert all(c.holds for c in found.verdict().checks if c.name == "bounds")
    (off,) = found.rmsd()
    assert max(off["grf_n"].values()) < 10.0
    assert max(off["angles_deg"].values()) < 1.0
    assert all(audit.holds for audit in found.audit())


@pytest.mark.slow
def test_mats_lie_under_the_cuffs_of_either_leg(worn, tmp_path):
    """Half the straps' tension each, where the leg stands, for its own cuff."""
    subject = draw(worn, 0, frozenset())
    model, mats = subject.truth.model, subject.mats
    assert {mat.cuff for mat in mats} == set(model.cuffs)
    assert [mat.name for mat in mats[:2]] == [
        "thigh_left_front",
        "thigh_left_back",
    ]
    names = model.coordinates
    q = np.zeros(len(names))
    q[names.index("knee_right")] = 0.8  # one leg is behind the other
    section = write_scans(tmp_path, model, q, mats)
    force = np.array([-30.0, 0.0, 25.0])
    total, axes = {}, {}
    for mat in mats:
        said = dict(section[mat.name])
        assert "legs" not in said  # nothing is doubled
        scan = said.pop("scan")
        axes[mat.cuff] = np.array(scan["segment_axis"])
        scan |= {key: Path(scan[key]) for key in ("file", "cells")}
        read = Mat(**said, scan=Scan(**scan))
        inward, _ = cell_directions(read, mat.name, tmp_path)
        pressure = cell_pressures(mat, model, force)
        own = {"thigh": 25.0, "shank": 20.0}[mat.segment]
        assert CELL_AREA_M2 * pressure[1] @ np.abs(inward[:, 0]) == (
            pytest.approx(own, rel=0.01)
        )
        found = CELL_AREA_M2 * pressure @ inward[:, 0]
        total[mat.cuff] = total.get(mat.cuff, 0.0) + found
    for found in total.values():
        np.testing.assert_allclose(found, force, atol=0.3)
    left, right = (np.diff(axes[f"shank_{s}"], axis=0)[0] for s in SIDES)
    assert abs(left[0]) < 1.0 < abs(right[0])  # the bent one is tilted


@pytest.mark.slow
def test_a_squat_in_a_device_is_recorded(worn, tmp_path):
    """Encoders of its four joints, which follow the person's; mats."""
    folder = tmp_path / "lab"
    folder.mkdir()
    path = write_movements(folder, worn, "squat", 1, [], 1)
    study = dx.read_study(path)
    (trial,) = study.trials()
    names = trial.coordinates
    assert names.device == ("left_hip", "left_knee", "right_hip", "right_knee")
    knee = np.rad2deg(trial.coordinate("knee_left"))
    assert knee.max() > 75.0
    assert max(knee[0], knee[-1]) < 30.0
    for joint in names.device:
        own = trial.coordinate(names.follows(joint))
        assert np.abs(own - trial.coordinate(joint)).max() < np.deg2rad(10.0)
    assert not trial.feet["left"].force_z.min() < 200.0
    table = read_table(folder / "truth" / "squat_1.sto")
    assert set(trial.cuffs) == set(study.model.cuffs)
    for cuff, shown in trial.cuffs.items():
        column = table.values[:, table.names.index(f"{cuff}_normal")]
        true = np.interp(trial.start_s + trial.times, table.time, column)
        assert np.ptp(true) > 2.0
        np.testing.assert_allclose(shown.normal, true, atol=0.2)
    assert all(check.holds for check in study.plausibility())


@pytest.mark.slow
def test_trials_at_once_are_those_one_after_another(
    worn, tmp_path, monkeypatch
):
    """By the command, and to the byte."""
    asked = []
    monkeypatch.setattr(
        campaign,
        "Processes",
        lambda count: asked.append(count) or Processes(count),
    )
    found = []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        command = ["lab", "--model", str(worn), "--movement", "squat"]
        command += ["--trials", "2", "--jobs", jobs, "--out", str(out)]
        assert main(command) == 0
        found.append(
            {p.name: p.read_bytes() for p in out.rglob("*") if p.is_file()}
        )
    assert found[0] == found[1] and asked == [2]


def test_what_cannot_be_simulated_is_refused(alone, tmp_path, capsys):
    one = tmp_path / "one.yaml"
    one.write_text("human: {legs: one}\n")
    for path, options, words in (
        (one, {}, "simulates two legs"),
        (alone, {"left_share": 0.95}, "give 0.1 to 0.9"),
        (alone, {"movement": "jump"}, "has rise, squat, walk"),
        (alone, {"movement": "walk", "left_share": 0.6}, "leave it out for"),
        (alone, {"trials": 0}, "trials is 0; give a whole number from 1 on"),
        (alone, {"seed": "x"}, "seed is 'x'; give a whole number from 0 on"),
        (5, {}, "description is 5; give a path"),
        (alone, {"files": "mat"}, "files is 'mat'; give one of c3d, opensim"),
        (alone, {"disturbances": ["gremlins"]}, "there is no 'gremlins'"),
        (tmp_path / "none.yaml", {}, "cannot be read"),
    ):
        with pytest.raises(InputError, match=words):
            write_movements(tmp_path, path, **options)
    out = str(tmp_path / "out")
    for options, words in (
        (["--left-share", "0.7"], "give --model FILE"),
        (["--movement", "squat"], "give --model FILE"),
        (
            ["--model", str(alone), "--full"],
            "work with the shipped exoskeleton alone",
        ),
        (
            ["--model", str(alone), "--truth", "near"],
            "work with the shipped exoskeleton alone",
        ),
        (["--full", "--trials", "2"], "leave out --trials"),
    ):
        assert main(["lab", "--out", out, *options]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_cuffs_on_two_legs_are_designed(worn):
    """A squat in which the device helps: less is felt, at the same work."""
    subject = draw(worn, 3, frozenset())
    plan = subject.both_legs(subject.planner.movement(_SQUAT), 0.5)
    model, rigid = (
        subject.truth.model,
        subject.truth.model.rigid.tree.coordinates,
    )
    names = subject.truth.model.coordinates
    used = np.flatnonzero((plan.times > 0.5) & (plan.times < 2.0))
    own = [n if n in rigid.names else names.follows(n) for n in names.names]
    columns = rigid.columns(own)
    accelerations = np.gradient(plan.v, plan.times, axis=0)
    q, v, a = (x[used][:, columns] for x in (plan.q, plan.v, accelerations))
    times = plan.times[used] - plan.times[used[0]]
    ground = plan.ground.cut(used)
    moments = np.zeros((len(times), len(names.joints)))
    helped = -5.0 * np.sin(np.pi * times / times[-1]) ** 2
    moments[:, names.is_device_joint] = helped[:, None]
    for joint in rigid.joints:
        torque = plan.moments[used, rigid.joint(joint)]
        moments[:, names.joint(joint)] = torque
    half = ground.scaled(0.5)
    squat = Trial(
        *("squat", names, times, q, v, a, ground),
        source="simulated",
        feet={"left": half, "right": half},
        moments=moments,
    )
    solver = Solver(20.0, tolerance=1e-5)
    phase = PredictionSettings(solver=solver, guess="data", errors=NO_ERRORS)
    contact = nominal_contact(model)
    moved = OwnMovement(model, [squat], contact, phase).solve()
    assert moved.success
    wearer = Wearer("somebody", model, contact, tuple(moved.trials))
    settings = DesignSettings(points=1, solver=solver)
    today = DesignProblem.of_today([wearer], settings).solve()
    found = DesignProblem([wearer], settings, today=today).solve()
    assert today.solution.success and found.solution.success
    # What is filled from one solution is nearly the other.
    assert today.solution.iterations < 6
    assert found.norm_n < 0.8 * today.norm_n
    work = [works(r)["somebody"] for r in (today, found)]
    assert work[1] == pytest.approx(work[0], rel=0.006)


@pytest.mark.slow
def test_each_of_two_soles_bears_half(worn):
    """Level and at the ankle's height, person and device on both."""
    for active in (frozenset(), frozenset(["contact", "friction"])):
        subject = draw(worn, 3, active)
        one, truth = subject.planner, subject.truth
        load = np.array([0.5 * truth.model.rigid.tree.weight])
        foot = resting_foot(one.tree, truth.contact, load, 0.045)
        height = truth.human.ankle_height_m
        np.testing.assert_allclose(foot, [[0.0, height, 0.0]], atol=1e-5)
        # One leg that stands for both has the same soles, twice as stiff.
        both = resting_foot(one.tree, one.contact, 2.0 * load, 0.045)
        np.testing.assert_allclose(both, foot, atol=1e-6)
        rough = float("friction" in active)
        assert truth.friction.viscous == (0.5 * rough,) * 4
        assert truth.friction.coulomb == (1.0 * rough,) * 4


def used_part(monkeypatch, movement, happened):
    """What a study is told to use of a movement that is given."""
    subject = TwoLegs.__new__(TwoLegs)
    subject.movement, subject.left_share, subject.truth = movement, 0.5, None
    subject.laboratory = SimpleNamespace(disturbances=frozenset())
    subject.planner = SimpleNamespace(
        seat=lambda plan: "chair",
        movement=lambda plan, seat: plan,
    )
    subject.both_legs = lambda plan, share: plan
    monkeypatch.setattr(two_legs, "simulate", lambda *_, **__: happened)
    return subject._stands(f"{movement}_1", 0, None)[1]


def test_the_used_part_of_a_squat_begins_and_ends_at_rest(monkeypatch):
    """A tenth of a second before it begins, and after it ends."""
    at = used_part(monkeypatch, "squat", None)
    plan = _SQUAT
    end = plan.quiet_s + plan.lean_s + plan.rise_s + 0.1
    assert at == pytest.approx((plan.quiet_s - 0.1, end))


def test_the_used_part_of_a_rise_begins_without_the_chair(monkeypatch):
    """Eight hundredths after its force is gone, in frames of 10 ms."""
    times = np.arange(3000) / 1000.0
    chair = SimpleNamespace(force_z=np.where(times < 1.2345, 300.0, 0.0))
    happened = SimpleNamespace(times=times, chair=chair)
    at = used_part(monkeypatch, "rise", happened)
    plan = two_legs._RISE
    end = plan.quiet_s + plan.lean_s + plan.rise_s + 0.1
    assert at == (1.31, pytest.approx(end))


def test_the_used_part_of_a_walk_is_a_cycle(monkeypatch, alone):
    """From the right foot in the air to the same a cycle later."""
    subject = draw(alone, 0, frozenset())
    times = np.arange(2500) / 1000.0
    borne = np.where((times % 1.1) < 0.62, 700.0, 0.0)
    feet = {"right": SimpleNamespace(force_z=borne)}
    happened = SimpleNamespace(times=times, feet=feet)
    nq = len(subject.truth.model.coordinates)
    walk = SimpleNamespace(
        times=np.linspace(0.0, 1.0, 11),
        q=np.zeros((11, nq)),
        v=np.zeros((11, nq)),
        moments=np.zeros((11, 6)),
    )
    monkeypatch.setattr(two_legs, "plan_walk", lambda *_: walk)
    monkeypatch.setattr(two_legs, "simulate", lambda *_, **__: happened)
    _, at = subject._walks("walk_1", 0, None)
    assert at == pytest.approx([0.62 + 0.05, 1.72 + 0.05])


def written(subject):
    """The study of three movements by such a subject."""
    entries = [{"name": f"{subject.movement}_{k}"} for k in (1, 2, 3)]
    return subject.study({}, entries)


@pytest.mark.slow
def test_a_study_of_two_legs_tells_what_is_known(worn):
    active = frozenset(["friction", "plate_drift"])
    subject = draw(worn, 3, active, "squat")
    study = written(subject)
    human = subject.truth.human
    assert study["subject"]["mass_kg"] == pytest.approx(human.mass_kg, abs=5e-4)
    assert study["subject"]["height_m"] == pytest.approx(
        human.height_m, abs=5e-5
    )
    assert study["gravity_m_s2"] == 9.81
    assert study["filter"] == {"cutoff_hz": 6.0, "order": 4}
    uses = [trial["use"] for trial in study["trials"]]
    assert uses == ["calibration", "calibration", "prediction"]
    assert study["standing"]["start_s"] == 0.5
    assert study["standing"]["plates"] == {"left": 1, "right": 2}
    assert study["standing"]["empty_plates"] == "plates_empty.c3d"
    assert study["foot_ground"]["heel"]["modulus_n_m2"]["nominal"] == 2.5e6
    names = list(subject.truth.model.coordinates.device)
    assert list(study["device"]["joints"]) == names
    for own in study["device"]["joints"].values():
        assert own == {
            "viscous_nm_s": 0.5,
            "coulomb_nm": 1.0,
            "coulomb_speed_rad_s": 0.05,
        }


def test_a_study_of_walks_lets_feet_roll(alone, tmp_path):
    study, still = (
        written(draw(alone, 3, frozenset(), movement))
        for movement in ("walk", "rise")
    )
    assert study["filter"]["cutoff_hz"] == 10.0 and "device" not in study
    for phase in ("foot_ground", "interaction", "prediction"):
        own, usual = study[phase]["noise"], still[phase]["noise"]
        assert own["velocity_deg_s"] == 8.0 and own["jerk"] == 300.0
        assert own["force_n"] == usual["force_n"]
    assert study["prediction"]["noise"]["moment_nm"] == 1.0
    assert list(study["foot_ground"]["spheres"]) == ["ball"]
    assert study["foot_ground"]["spheres"]["ball"]["x_m"] == {
        "below": 0.08,
        "above": 0.04,
    }
    assert study["foot_ground"]["solver"] == {"nodes_per_second": 200.0}
    write_yaml(tmp_path / "study.yaml", "walks", study)
    assert "&" not in (tmp_path / "study.yaml").read_text()  # read by people
    for phase in ("foot_ground", "interaction"):
        assert study[phase]["end_tolerance"]["pitch_deg"] == 5.0


@pytest.mark.slow
def test_a_device_s_file_lies_beside_the_study(worn, tmp_path, monkeypatch):
    folder = tmp_path / "lab"
    folder.mkdir()
    elsewhere = tmp_path / "devices"
    elsewhere.mkdir()
    (tmp_path / "hip_and_knee.urdf").rename(elsewhere / "hip_and_knee.urdf")
    text = worn.read_text().replace("hip_and", "devices/hip_and")
    worn.write_text(text)
    monkeypatch.setattr(TwoLegs, "prepare", lambda *_: {})
    monkeypatch.setattr(TwoLegs, "record", lambda *_: {"name": "rise_1"})
    study = yaml.safe_load(write_movements(folder, worn, trials=1).read_text())
    assert study["model"]["device"]["file"] == "hip_and_knee.urdf"
    assert (folder / "hip_and_knee.urdf").read_bytes() == (
        elsewhere / "hip_and_knee.urdf"
    ).read_bytes()


@pytest.mark.slow
def test_who_stands_is_scanned_at_the_end(worn, tmp_path, monkeypatch):
    """On both legs alike, with a device that does not help."""
    subject, asked = TwoLegs(tmp_path, worn, "rise", 3, frozenset()), []
    nq = len(subject.truth.model.coordinates)
    still = SimpleNamespace(q=np.outer([1.0, 2.0, 3.0], np.ones(nq)))

    def simulated(name, truth, plan, **more):
        asked.append((name, plan, more))
        return still

    monkeypatch.setattr(campaign, "simulate", simulated)
    monkeypatch.setattr(campaign, "write_happened", lambda *_: None)
    monkeypatch.setattr(
        campaign, "write_scans", lambda folder, model, q, mats: (q, mats)
    )
    monkeypatch.setattr(Laboratory, "record_motion", lambda *_, **__: None)
    q, mats = subject.prepare()
    ((name, plan, more),) = asked
    assert (name, more) == ("standing", {"tell": None})
    assert plan.times[-1] == 2.0
    np.testing.assert_array_equal(q, 3.0)
    assert mats == subject.mats
    names = subject.truth.model.rigid.coordinates
    knees = [names.index(f"knee_{s}") for s in SIDES]
    np.testing.assert_allclose(plan.q[:, knees[0]], plan.q[:, knees[1]])
