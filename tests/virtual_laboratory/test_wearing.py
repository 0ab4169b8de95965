"""A design on the laboratory's subject: tissue and person stay."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

import drake_exo as dx
from drake_exo.cli import design as command
from drake_exo.cli import main
from drake_exo.contact.strap import (
    Assistance,
    CuffDesign,
    Design,
    GainController,
    Gains,
)
from drake_exo.errors import InputError
from drake_exo.measurement.settings import Plates, TrialFiles
from drake_exo.virtual_laboratory import campaign
from drake_exo.virtual_laboratory.campaign import (
    Campaign,
    Repetition,
    read_about,
    write_yaml,
)
from drake_exo.virtual_laboratory.plan import DeviceController
from drake_exo.virtual_laboratory.truth import (
    TRUTH,
    WIDE,
    draw_truth,
    wearing,
)

DESIGN = Design(
    {"thigh": CuffDesign(along_m=0.05, strap_normal_n_m=3000.0)},
    {"exo_knee": Assistance((0.0, 60.0), (1.0, 0.4))},
)


@pytest.fixture(scope="module")
def truth():
    return draw_truth(np.random.default_rng(3), frozenset(TRUTH))


def test_tissue_and_what_no_model_knows_stay_with_the_person(truth):
    worn = wearing(truth, DESIGN)
    own, built = truth.cuffs["thigh"], worn.cuffs["thigh"]
    assert built.bushing.origin_z == pytest.approx(own.bushing.origin_z + 0.05)
    tissue = 1.0 / built.bushing.normal_stiffness - 1.0 / 3000.0
    assert tissue == pytest.approx(1.0 / own.bushing.normal_stiffness)
    assert built.bushing.tangential_stiffness == (
        own.bushing.tangential_stiffness
    )
    assert (built.progression, built.slip) == (own.progression, own.slip)
    assert worn.cuffs["shank"] == truth.cuffs["shank"]
    assert worn.human == truth.human and worn.friction == truth.friction


def test_help_follows_the_factors_and_friction_does_not(truth):
    share = (0.0, 0.2, 0.2)
    angles = np.deg2rad([[10.0, 0.0, 30.0], [10.0, 60.0, 30.0]])
    load = np.full(2, truth.model.tree.weight)
    rates = np.ones((2, 3))
    own, built = (
        DeviceController(truth.model, share, truth.friction, design)
        for design in (None, DESIGN)
    )
    at = np.zeros(2), angles, rates
    ratio = built.help(*at, load)[:, 1:] / own.help(*at, load)[:, 1:]
    np.testing.assert_allclose(ratio, [[1.0, 1.0], [0.4, 1.0]])
    friction = [d.torques(*at, load) - d.help(*at, load) for d in (own, built)]
    np.testing.assert_allclose(*friction)


def test_help_follows_a_spline_over_the_movement(truth):
    """From 2 s to 4 s; the ends' factors before and after."""
    spline = Assistance((), (1.2, 1.0, 0.9, 0.8), "movement")
    share, times = (0.1, 0.2, 0.2), np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    angles = np.tile(np.deg2rad([10.0, 60.0, 30.0]), (5, 1))
    load, rest = np.full(5, truth.model.tree.weight), np.zeros((5, 3))
    own, built = (
        DeviceController(truth.model, share, truth.friction, design, (2.0, 4.0))
        for design in (None, Design(assistance={"exo_hip": spline}))
    )
    ratio = built.help(times, angles, rest, load) / own.help(
        times, angles, rest, load
    )
    # Four coefficients: a Bezier curve.
    middle = (1.2 + 3.0 * 1.0 + 3.0 * 0.9 + 0.8) / 8.0
    np.testing.assert_allclose(ratio[:, 2], [1.2, 1.2, middle, 0.8, 0.8])
    np.testing.assert_allclose(ratio[:, :2], 1.0)


def test_the_device_follows_gains_as_their_system_does(truth):
    """While the feet are loaded; passive, there is nothing to change."""
    gains = {
        "exo_knee": Gains(0.7, 2.0, 5.0, 0.3),
        "exo_hip": Gains(1.2, -1.0, 0.0, 0.8),
    }
    design, joints = Design(gains=gains), truth.model.coordinates.device
    share = (0.1, 0.2, 0.2)
    own, built, passive = (
        DeviceController(truth.model, s, truth.friction, d)
        for s, d in ((share, None), (share, design), ((0.0,) * 3, design))
    )
    rng = np.random.default_rng(4)
    angles, rates = rng.uniform(0.1, 1.5, (2, 6, 3))
    load = np.full(6, truth.model.tree.weight)
    at = np.zeros(6), angles, rates, load
    found, today = built.help(*at), own.help(*at)
    system = GainController([gains.get(j, Gains()) for j in joints])
    context = system.CreateDefaultContext()
    for i in range(6):
        for port, values in (
            ("exoskeleton_state", np.r_[angles[i], rates[i]]),
            ("today_torques", today[i]),
        ):
            system.GetInputPort(port).FixValue(context, values)
        expected = system.GetOutputPort("exoskeleton_torques").Eval(context)
        np.testing.assert_allclose(found[i], expected)
    unloaded = built.help(*at[:3], 0.0 * load)
    np.testing.assert_array_equal(unloaded, 0.0)
    np.testing.assert_array_equal(passive.help(*at), 0.0)


FEWER = Design({"shank": CuffDesign(removed=True)})


def test_who_wears_fewer_cuffs_is_the_same_subject(truth):
    worn = wearing(truth, FEWER)
    assert set(worn.cuffs) == {"thigh", "pelvis"} == set(worn.model.tree.cuffs)
    assert worn.cuffs["thigh"] == truth.cuffs["thigh"]
    assert worn.human == truth.human
    assert worn.model.exoskeleton == truth.model.exoskeleton
    with pytest.raises(InputError, match="turn freely"):
        wearing(truth, Design({"pelvis": CuffDesign(removed=True)}))


@pytest.mark.slow
def test_a_campaign_without_a_cuff_has_no_mats_of_it(tmp_path):
    """The same subject and faults; a study that knows what is there."""
    (tmp_path / "truth").mkdir()
    given = tmp_path, 3, frozenset(TRUTH | WIDE), "c3d", "wide"
    own, job = Campaign(*given), Campaign(*given, FEWER)
    assert job.laboratory.faults == own.laboratory.faults
    assert set(own.laboratory.faults.mat_share) == {"shank", "thigh", "pelvis"}
    mats = job.prepare()
    assert set(mats) == {
        f"{part}_{face}"
        for part in ("thigh", "pelvis")
        for face in ("front", "back")
    }
    assert not list(tmp_path.glob("*shank*"))
    entry = job.record(Repetition("assisted", "legs", 3))
    path = tmp_path / "study.yaml"
    write_yaml(path, "", job.study(mats, [entry]))
    study = dx.read_study(path)
    assert set(study.model.cuffs) == {"thigh", "pelvis"}
    (trial,) = study.trials()
    assert set(trial.cuffs) == {"thigh"}
    assert np.abs(trial.cuffs["thigh"].normal).max() > 5.0


@pytest.mark.slow
def test_the_study_says_where_cuffs_are_built(tmp_path):
    """By what the person's own are moved; a preload moves the device alone."""
    thigh = CuffDesign(along_m=0.03, across_m=-0.01, preload_along_m=0.02)
    soft = CuffDesign(strap_normal_n_m=3000.0)
    given = tmp_path, 3, frozenset(TRUTH | WIDE), "c3d", "wide"
    job = Campaign(*given, Design({"thigh": thigh, "shank": soft}))
    (x, z), path = job.truth.human.thigh_cuff_m, tmp_path / "study.yaml"
    write_yaml(path, "", job.study({}, []))
    said = yaml.safe_load(path.read_text())["model"]["cuffs"]
    assert said["thigh"]["at_m"] == pytest.approx(
        [x - 0.01, z + 0.03], abs=1e-4
    )
    assert "at_m" not in said["shank"]
    origin = job.truth.cuffs["thigh"].bushing
    off = np.array(said["thigh"]["at_m"]) - (origin.origin_x, origin.origin_z)
    assert np.abs(off).max() < 0.04  # as near as that of who wears no design
    job = Campaign(*given, Design({"shank": soft}))
    assert job.study({}, [])["model"] == "coupled"


def test_a_design_of_another_device_is_refused(truth):
    with pytest.raises(InputError, match=r"cuffs\.elbow"):
        wearing(truth, Design({"elbow": CuffDesign()}))


def test_the_laboratory_reads_designs(tmp_path, capsys):
    """A wrong one ends before anything is simulated."""
    (tmp_path / "design.yaml").write_text("cuffs: {thigh: {along: 1}}")
    out = tmp_path / "out"
    command = ["lab", "--design", str(tmp_path), "--out", str(out)]
    assert main(command) == 2
    assert "design.yaml" in capsys.readouterr().err
    assert not out.exists()


def test_what_was_built_is_read_as_the_study_reads(tmp_path, monkeypatch):
    """The trials that it predicts, in its windows, by its filter."""
    job = Campaign(tmp_path, 3, frozenset(), "c3d", "near")
    names = ("assisted_legs_3_3", "assisted_legs_4_3")
    paths = []
    for filter_hz, (start_s, count) in ((6.0, (1.0, 2)), (9.0, (1.2, 1))):
        path = tmp_path / f"{filter_hz:g}" / "study.yaml"
        path.parent.mkdir()
        entries = [
            {
                **dict(name=name, use="prediction", markers="x.c3d"),
                **dict(forces="x.c3d", plates={"left": 1, "right": 2}),
                **dict(start_s=start_s, end_s=3.0, rise=count),
            }
            for name in names[:count]
        ]
        write_yaml(path, "", job.study({}, entries))
        text = path.read_text().replace(
            "cutoff_hz: 6.0", f"cutoff_hz: {filter_hz}"
        )
        path.write_text(text)
        paths.append(path)
    there, own = paths
    monkeypatch.setattr(campaign, "write_campaign", lambda *_, **__: there)
    monkeypatch.setattr(command, "built", lambda _, study, measured: measured)
    monkeypatch.setattr(dx.study.RecordedStudy, "trials", lambda s, _: s.file)
    made = SimpleNamespace(design=DESIGN, before=["anna"])
    study = dx.read_study(own)
    file = command._built(made, study, {}, tmp_path)["anna"]
    assert [t.name for t in file.trials] == [names[0]]
    assert (file.trials[0].start_s, file.filter.cutoff_hz) == (1.2, 9.0)
    assert file.trials[0].rise == 1  # an own window, as all of it


def test_a_trial_that_no_laboratory_builds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "read_about", lambda _: {})
    file, plates = Path("x.c3d"), Plates(left=(1,), right=(2,))
    trials = [
        TrialFiles(name, file, file, plates, "prediction")
        for name in ("assisted_legs_3_3", "passive_legs_5_3")
    ]
    standing = SimpleNamespace(markers=file)
    about = SimpleNamespace(trials=trials, standing=standing)
    study = SimpleNamespace(file=about, root=tmp_path)
    with pytest.raises(InputError, match="'passive_legs_5_3' is for predict"):
        command._laboratory(tmp_path / "study.yaml", study)


@pytest.mark.slow
def test_the_laboratory_is_where_the_recordings_are(tmp_path):
    """A batch with a sweep designs by a changed copy of the study."""
    recorded, copy = tmp_path / "recorded", tmp_path / "copy.yaml"
    (recorded / "truth").mkdir(parents=True)
    about = {"seed": 4, "truth": "near", "disturbances": []}
    (recorded / "truth" / "truth.json").write_text(json.dumps(about))
    job = Campaign(recorded, 4, frozenset(), "c3d", "near")
    trial = dict(name="assisted_legs_3_3", use="prediction", markers="x.c3d")
    plates = {"left": 1, "right": 2}
    entry = {**trial, "forces": "x.c3d", "plates": plates}
    write_yaml(copy, "", job.study({}, [entry]))
    study = dx.read_study(copy, data_root=recorded)
    assert command._laboratory(copy, study)["seed"] == 4


def test_what_a_campaign_was_made_with(tmp_path):
    (tmp_path / "truth").mkdir()
    path = tmp_path / "truth" / "truth.json"
    about = {"seed": 4, "truth": "wide", "disturbances": ["shear"]}
    path.write_text(json.dumps(about))
    assert read_about(tmp_path) == {
        "seed": 4,
        "truth": "wide",
        "disturbances": frozenset({"shear"}),
    }
    for key, how in (("design", "--design"), ("left_share", "--model")):
        path.write_text(json.dumps(about | {key: {}}))
        said = f"'drake-exo lab {how}', with which no design can be built"
        with pytest.raises(InputError, match=said):
            read_about(tmp_path)
    for damaged in ("{}", '{"seed": "x"}', "[1]"):
        path.write_text(damaged)
        with pytest.raises(InputError, match=r"truth\.json: is damaged"):
            read_about(tmp_path)
    path.unlink()
    with pytest.raises(InputError, match=r"truth\.json: cannot be read"):
        read_about(tmp_path)
