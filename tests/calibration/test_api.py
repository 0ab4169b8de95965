"""The phases from Python, without a file: `import drake_exo as dx`."""

import numpy as np
import pytest

import drake_exo as dx
from drake_exo.virtual_laboratory import synthetic


@pytest.fixture(scope="module")
def made():
    """One rise in the device, 40 nodes a second."""
    return synthetic.rises_in_device(1, nodes_per_second=40.0)


@pytest.fixture(scope="module")
def study(made):
    return dx.Study(made.model, made.trials, name="one rise")


@pytest.fixture(scope="module")
def cuffs(study, made):
    return dx.calibrate_interaction(study, made.trials, made.contact)


@pytest.fixture(scope="module")
def found(study, cuffs):
    return dx.predict(study, study.trials()[0], cuffs)


def test_every_public_name_is_there():
    assert {"Study", "predict", "read_study", "soles"} <= set(dx.__all__)
    for name in dx.__all__:
        assert getattr(dx, name) is not None
    with pytest.raises(AttributeError, match="nothing"):
        _ = dx.nothing


def test_a_study_needs_no_file(study, made):
    assert study.name == "one rise"
    assert study.model is made.model
    for use in (None, "calibration", "prediction"):
        assert study.trials(use) == tuple(made.trials)
    assert study.foot_ground == dx.FootGroundSettings()
    assert study.interaction == dx.InteractionSettings()
    assert study.prediction == dx.PredictionSettings()


def test_foot_and_ground_are_calibrated(study):
    found = dx.calibrate_foot_ground(study)
    assert found.success and found.phase == "foot-ground"
    assert found.parameter("toe.stiffness").unit == "N/m^2"
    assert found.contact.bushings == {}
    assert [t.name for t in found.trials] == ["rise1"]
    assert set(found.rmsd()[0]["angles_deg"]) == set(
        study.model.coordinates.joints
    )


def test_cuffs_are_calibrated(cuffs, made):
    assert cuffs.success and cuffs.phase == "interaction"
    assert list(cuffs.contact.bushings) == ["shank", "thigh", "pelvis"]
    assert cuffs.contact.ground == made.contact.ground
    stiffness = cuffs.parameter("pelvis.normal_stiffness")
    assert stiffness.lower < stiffness.nominal < stiffness.upper
    with pytest.raises(dx.InputError, match=r"known are shank\.origin_x"):
        cuffs.parameter("pelvis.stiffness")
    told = {row["name"]: row for row in cuffs.summary()["parameters"]}
    assert told["pelvis.normal_stiffness"]["half_width_95"] > 0.0


def test_a_calibration_is_written_and_read(cuffs, tmp_path):
    cuffs.write(tmp_path)
    assert dx.read_contact(tmp_path).values() == cuffs.contact.values()
    back = dx.read_trial(tmp_path, "rise1")
    np.testing.assert_array_equal(back.q, cuffs.trials[0].q)
    assert (tmp_path / "kinematics.png").stat().st_size > 1000


def test_a_prediction_is_read_by_names(found, study):
    assert isinstance(found, dx.Trial)
    assert found.success and found.source == "solved"
    for name in study.model.coordinates.names:
        place = study.model.coordinates.index(name)
        for read, array in (
            (found.coordinate, found.q),
            (found.velocity, found.v),
            (found.acceleration, found.a),
        ):
            np.testing.assert_array_equal(read(name), array[:, place])
    assert found.moment("exo_hip").shape == found.times.shape
    assert found.cuff("thigh").normal.shape == found.times.shape
    assert found.ground.force_z.min() > 0.0
    assert found.solution.iterations > 0
    for read in (found.coordinate, found.moment, found.cuff):
        with pytest.raises(dx.InputError, match="elbow"):
            read("elbow")


@pytest.mark.slow
def test_a_prediction_is_scored_audited_and_drawn(found, study):
    scores = found.rmsd(study.trials()[0])
    assert max(scores["angles_deg"].values()) < 3.3
    checked = found.audit()
    assert checked.trial == "rise1"
    assert checked.simulated_interaction_n < 1.0
    assert len(found.plot().axes) == 6
    assert set(dx.plot_trials([found], study.trials())) == {
        *("ground_reaction", "kinematics", "interaction", "moments"),
    }


def test_stiffer_cuffs_predict_another_interaction(found, study, cuffs):
    trial = study.trials()[0]
    stiff = dx.predict(study, trial, cuffs.contact, scale_interaction=1.4)
    assert stiff.success
    bushings = stiff.result.contact.bushings
    for cuff, bushing in cuffs.contact.bushings.items():
        assert bushings[cuff] == bushing.scaled(1.4)
    change = stiff.cuff("pelvis").normal - found.cuff("pelvis").normal
    assert np.abs(change).max() > 1.0


def test_without_a_device_there_is_no_interaction():
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40.0)
    with pytest.raises(dx.InputError, match="no exoskeleton"):
        dx.calibrate_interaction(dx.Study(model, trials))
