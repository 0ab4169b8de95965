"""The phases from Python, without a file: `import drake_exo as dx`."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drake_exo as dx
from drake_exo.contact.reduction import SoleLaw, SoleSphere
from drake_exo.files.output import Check, Verdict
from drake_exo.measurement.settings import Filter
from drake_exo.virtual_laboratory import synthetic

pytestmark = pytest.mark.slow


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


def test_a_study_shows_its_trials(study):
    assert repr(study).startswith(f"Study({study.name!r}, ")
    assert repr(study).endswith(", ".join(t.name for t in study.trials()) + ")")


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
    head, *rows = repr(cuffs).splitlines()
    assert head == "Calibration('interaction', 'solved')"
    assert len(rows) == len(cuffs.parameters)
    value = f"{stiffness.nominal:.4g}"
    assert ["pelvis.normal_stiffness", value, "N/m"] in map(str.split, rows)
    labels = [ax.get_ylabel() for ax in cuffs.plot().axes]
    assert labels == [
        "shank normal [N]",
        "thigh normal [N]",
        "pelvis normal [N]",
    ]
    told = {row["name"]: row for row in cuffs.summary()["parameters"]}
    assert told["pelvis.normal_stiffness"]["half_width_95"] > 0.0


def test_calibrated_cuffs_are_compared_with_their_mats(cuffs):
    (told,) = (c for c in cuffs.verdict().checks if c.name == "cuffs")
    assert told.where == "pelvis" and told.holds and told.value < 0.05


def test_a_calibration_is_written_and_read(cuffs, tmp_path):
    cuffs.write(tmp_path)
    assert dx.read_contact(tmp_path).values() == cuffs.contact.values()
    back = dx.read_trial(tmp_path, "rise1")
    np.testing.assert_array_equal(back.q, cuffs.trials[0].q)
    assert (tmp_path / "kinematics.png").stat().st_size > 1000


def test_for_another_process_it_is_told_what_to_pass_on(cuffs, found):
    for solved in (cuffs, found):
        with pytest.raises(TypeError, match="pass on a calibration's contact"):
            pickle.dumps(solved)
    given = pickle.dumps((cuffs.contact, cuffs.trials, found.result.trials))
    contact, (trial,), (predicted,) = pickle.loads(given)
    assert contact.values() == cuffs.contact.values()
    np.testing.assert_array_equal(trial.q, cuffs.trials[0].q)
    np.testing.assert_array_equal(predicted.q, found.q)


def test_what_is_handed_out_may_be_changed(cuffs, found):
    """Or says that it may not: later answers stay what they were."""
    cuffs.trials.clear()
    cuffs.parameters.reverse()
    assert len(cuffs.trials) == len(cuffs.rmsd())
    assert [p.name for p in cuffs.parameters] == list(cuffs.contact.values())[
        -len(cuffs.parameters) :
    ]
    width = found.bands().q.copy()
    found.bands().q[:] = 0.0
    np.testing.assert_array_equal(found.bands().q, width)
    with pytest.raises(ValueError, match="read-only"):
        found.result.values[:] = 0.0


def test_a_result_stays_what_it_was_whatever_the_study_is_by_now(made):
    coarse = dx.settings.Solver(nodes_per_second=20.0)
    own = dx.Study(
        made.model,
        made.trials,
        foot_ground=dx.FootGroundSettings(solver=coarse),
        interaction=dx.InteractionSettings(solver=coarse),
    )
    results = [
        dx.calibrate_foot_ground(own),
        dx.calibrate_interaction(own, contact=made.contact),
    ]
    widths = [r.uncertainty().half_width for r in results]
    own.name, own.filter = "another", Filter(cutoff_hz=2.0)
    for result, width in zip(results, widths, strict=True):
        assert result.study.name == "subject"
        np.testing.assert_array_equal(result.uncertainty().half_width, width)


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
    with pytest.raises(dx.InputError, match="meshcat is None; give a Meshcat"):
        found.view(None)


@pytest.mark.slow
def test_of_a_prediction_at_other_times_the_movement_is_left(found):
    """The result is of its own nodes."""
    at = found.sample(found.times[::2])
    assert type(at) is dx.Trial
    np.testing.assert_allclose(at.q, found.q[::2], atol=1e-12)


@pytest.mark.slow
def test_a_prediction_is_scored_audited_and_drawn(found, study):
    scores = found.rmsd(study.trials()[0])
    assert max(scores["angles_deg"].values()) < 3.3
    checked = found.audit()
    assert checked.trial == "rise1"
    assert checked.simulated_interaction_n < 1.0
    # Angles, velocities, cuffs and ground reaction, three of each.
    assert len(found.plot().axes) == 12
    assert set(dx.plot_trials([found], study.trials())) == {
        *("ground_reaction", "kinematics", "interaction", "moments"),
    }


@pytest.mark.slow
def test_a_prediction_is_written_and_read(found, study, tmp_path):
    found.write(tmp_path / "new")
    back = dx.read_trial(tmp_path / "new", "rise1")
    np.testing.assert_array_equal(back.q, found.q)
    measured = dx.read_trial(tmp_path / "new", "rise1", "measured")
    np.testing.assert_array_equal(measured.q, study.trials()[0].q)
    off = Verdict((Check("audit", False, 2.5, 1.0, "N", "rise1"),))
    found.write(tmp_path / "new", off)
    tables = list((tmp_path / "new").glob("*.sto"))
    assert tmp_path / "new" / "rise1_bands.sto" in tables
    for path in tables:
        assert "DOES NOT HOLD: audit" in path.read_text("utf-8").splitlines()[0]


def test_stiffer_cuffs_predict_another_interaction(found, study, cuffs):
    trial = study.trials()[0]
    stiff = dx.predict(study, trial, cuffs.contact, scale_interaction=1.4)
    assert stiff.success
    bushings = stiff.result.contact.bushings
    for cuff, bushing in cuffs.contact.bushings.items():
        assert bushings[cuff] == bushing.scaled(1.4)
    change = stiff.cuff("thigh").normal - found.cuff("thigh").normal
    assert np.abs(change).max() > 1.0
    assert [found, stiff].index(stiff) == 1
    assert len({found, stiff, cuffs}) == 3


def test_without_a_device_there_is_no_interaction():
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40.0)
    with pytest.raises(dx.InputError, match="model has no exoskeleton with"):
        dx.calibrate_interaction(dx.Study(model, trials))


def test_a_failed_solve_is_sealed_until_it_is_unsealed(study, made, tmp_path):
    settings = dx.PredictionSettings(
        torque_limit_nm=1.0, solver=dx.settings.Solver(40.0, max_iterations=3)
    )
    found = dx.predict(study, made.trials[0], made.contact, settings=settings)
    assert not found.success
    for read in (
        lambda: found.coordinate("hip"),
        lambda: found.ground,
        lambda: found.feet,
        lambda: found.rmsd(made.trials[0]),
    ):
        with pytest.raises(dx.SealedSolutionError):
            read()
    assert repr(found).startswith("Prediction('rise1', '")
    with pytest.raises(dx.SealedSolutionError):
        found.write("nowhere")
    found.solution.unseal()
    assert found.coordinate("hip").shape == found.times.shape
    assert found.source == "not solved"
    found.write(tmp_path)
    with pytest.raises(dx.InputError, match="rise1 was not solved"):
        dx.read_trial(tmp_path, "rise1")
    back = dx.read_trial(tmp_path, "rise1", accept=["solved"])
    np.testing.assert_array_equal(back.q, found.q)
    assert dx.read_trial(tmp_path, "rise1", "measured").source != "not solved"


def test_cuffs_do_not_go_on_from_a_failed_foot(made):
    settings = dx.FootGroundSettings(
        solver=dx.settings.Solver(40.0, max_iterations=1)
    )
    study = dx.Study(made.model, made.trials, foot_ground=settings)
    with pytest.raises(dx.SealedSolutionError):
        dx.calibrate_interaction(study)


def test_a_person_alone_is_predicted_with_a_whole_calibration(made):
    model, [trial] = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    true = dx.FootGroundSettings().contact(model.spheres)
    contact = replace(made.contact, ground=true.ground)
    found = dx.predict(dx.Study(model, [trial]), trial, contact)
    assert found.success and found.cuffs == {}


def test_results_are_written_whole(cuffs, tmp_path):
    folder = tmp_path / "new" / "results"
    cuffs.write(folder)
    assert dx.read_contact(folder).values() == cuffs.contact.values()
    assert dx.read_trial(folder, "rise1").duration == 1.5
    for name in ("summary.json", "rmsd.txt", "kinematics.png"):
        assert (folder / name).is_file()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: {"times": t.times + 1.0}, "must start at 0"),
        (
            lambda t: {"q": np.full_like(t.q, np.nan)},
            "values that are not finite",
        ),
    ],
)
def test_trials_that_are_none_are_told(study, made, change, words):
    [trial] = made.trials
    wrong = replace(trial, **change(trial))
    with pytest.raises(dx.InputError, match=words):
        dx.predict(study, wrong, made.contact)


def test_a_start_near_something_else_is_told(study, made, found):
    """Its refined grid has other intervals."""
    [trial] = made.trials
    coarse = dx.PredictionSettings(solver=dx.settings.Solver(50.0))
    with pytest.raises(dx.InputError, match="with 200 nodes_per_second, but"):
        dx.predict(study, trial, made.contact, near=found, settings=coarse)
    cut = trial.sample(trial.times[trial.times < 1.0])
    with pytest.raises(dx.InputError, match=r"near lasts 1\.5 s, but"):
        dx.predict(study, cut, made.contact, near=found)
    bare, [rise] = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    with pytest.raises(dx.InputError, match="near has the coordinates"):
        dx.predict(dx.Study(bare, [rise]), rise, made.contact, near=found)


def test_input_of_the_api_is_told(study, made):
    [trial] = made.trials
    _, [alone] = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    with pytest.raises(dx.InputError, match="trials of this model"):
        dx.predict(study, alone, made.contact)
    with pytest.raises(dx.InputError, match="scale_interaction is -1"):
        dx.predict(study, trial, made.contact, scale_interaction=-1.0)
    with pytest.raises(dx.InputError, match="clocks is"):
        dx.predict(study, trial, made.contact, clocks="x")
    with pytest.raises(dx.InputError, match="near is"):
        dx.predict(study, trial, made.contact, near="x")
    with pytest.raises(dx.InputError, match="use is 'banana'"):
        study.trials("banana")
    bare, [rise] = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    with pytest.raises(dx.InputError, match="has no cuffs; leave it out"):
        dx.predict(
            dx.Study(bare, [rise]), rise, made.contact, scale_interaction=2.0
        )
    with pytest.raises(dx.InputError, match="not a Drake system"):
        dx.predict(study, trial, made.contact, controller=dx.AssistController)
    with pytest.raises(dx.InputError, match="no model 'cupled'"):
        dx.nominal_model("cupled")
    with pytest.raises(dx.InputError, match="needs an exoskeleton"):
        dx.Model("coupled", made.model.human)
    with pytest.raises(dx.InputError, match="there are no trials"):
        dx.Study(made.model, [])
    with pytest.raises(dx.InputError, match="model is 'coupled'; give a"):
        dx.Study("coupled", made.trials)
    with pytest.raises(dx.InputError, match="'rise1' is not a trial"):
        dx.predict(study, "rise1", made.contact)
    with pytest.raises(dx.InputError, match="contact is None; give a"):
        dx.predict(study, trial, None)
    other = replace(
        made.contact, bushings={"calf": made.contact.bushings["shank"]}
    )
    words = "knows the cuffs calf, not the model's shank, thigh, pelvis"
    with pytest.raises(dx.InputError, match=words):
        dx.predict(study, trial, other)
    with pytest.raises(dx.InputError, match="is not a list of trials"):
        dx.calibrate_foot_ground(study, trial)
    with pytest.raises(dx.InputError, match="'a' is not a trial"):
        dx.calibrate_interaction(study, ["a"], made.contact)
    with pytest.raises(dx.InputError, match="0 trials found and 1 measured"):
        dx.plot_trials([], [trial])
    with pytest.raises(dx.InputError, match="found are a, but measured are ri"):
        dx.plot_trials([replace(trial, name="a")], [trial])
    with pytest.raises(dx.InputError, match="resume goes on from folder"):
        dx.predict(study, trial, made.contact, resume=True)
    with pytest.raises(dx.InputError, match="give a Sequence"):
        dx.plot_trials(trial, trial)
    with pytest.raises(dx.InputError, match=r"model is .*give a Exo"):
        dx.build_simulator(study.model)
    with pytest.raises(dx.InputError, match=r"model is Study.*give a Model"):
        dx.nominal_contact(study)


@pytest.fixture(scope="module")
def worn(made, study):
    """The same feet, as a sole's law says them."""
    ground = made.contact.ground
    spheres = {
        f"of_{name}": SoleSphere(
            0.5 * s.stiffness, 1.0, s.dissipation, s.radius, x_m=s.x, z_m=s.z
        )
        for name, s in ground.spheres.items()
    }
    law = SoleLaw((0.26, 0.1, 0.02), spheres, ground.constants)
    settings = dx.FootGroundSettings(law=Path("law.yaml"), sole_at_m=(0.0, 0.0))
    return dx.Study(made.model, made.trials, foot_ground=settings, sole=law)


def test_a_sole_s_law_predicts_as_its_spheres_do(worn, cuffs, found):
    ours = dx.predict(worn, worn.trials()[0], cuffs)
    assert ours.success
    np.testing.assert_allclose(ours.q, found.q, atol=1e-6)
    np.testing.assert_allclose(
        ours.ground.array, found.ground.array, atol=1e-3, rtol=1e-4
    )


def test_a_sole_s_law_is_not_in_its_settings(worn, made):
    """A problem that is posed without a study needs it, too."""
    with pytest.raises(dx.InputError, match="a sole's, and nothing of it is"):
        dx.FootGroundCalibration(made.model, made.trials, worn.foot_ground)
    posed = dx.FootGroundCalibration(
        made.model, made.trials, worn.foot_ground, ground=worn.ground
    )
    assert posed.contact.ground == worn.ground


def test_a_law_that_is_off_its_sole_is_noted(worn):
    assert [c.holds for c in worn.gate()] == [True] * 4
    far = replace(worn.sole, force_error_rms=0.031, cop_error_rms_m=1.9e-3)
    settings = worn.foot_ground
    study = dx.Study(worn.model, worn.trials(), foot_ground=settings, sole=far)
    *_, force, cop = study.gate()
    assert (force.name, cop.name) == ("sole.force", "sole.cop") and cop.holds
    assert not force.holds and force.level == "note"
    assert (force.value, force.limit) == (0.031, 0.03)
    assert force.where == "law.yaml"
    assert force.sentence.startswith("forces of the law differ by so much")


def test_a_calibration_is_of_the_phase_that_it_says(cuffs):
    """That of feet has no intervals: those of cuffs would be lost silently."""
    study, result = cuffs.study, cuffs.result
    for given, words in (
        (("foot-ground", study, result), "give a FootGroundCalibration"),
        (("B", study, result), "is 'B'; give one of foot-ground, interaction"),
        ((study, "interaction", result), r"phase is Study\(.*; give one of"),
        (("interaction", study, result.solution), "give a PhaseResult"),
        (("interaction", study.trials(), result), "give a Study"),
    ):
        with pytest.raises(dx.InputError, match=words):
            dx.Calibration(*given)


def test_with_a_sole_nothing_of_the_feet_is_calibrated(worn, tmp_path):
    ours = dx.calibrate_foot_ground(worn)
    assert ours.success and ours.parameters == []
    assert ours.uncertainty() is None
    ours.write(tmp_path)
    again = dx.read_contact(tmp_path)
    assert again.ground.of_sole and again.ground == worn.ground
    assert repr(ours) == "Calibration('foot-ground', 'solved')"


def test_a_solution_is_kept_until_its_results_are_written(tmp_path, capsys):
    """Ctrl-C in an audit, which takes longer than a solve, loses nothing."""
    model, trials = dx.synthetic.rises_on_spheres(1, nodes_per_second=40)
    study = dx.Study(model, trials)
    found = dx.calibrate_foot_ground(study, trials, folder=tmp_path)
    assert found.success
    with np.load(tmp_path / "checkpoint.npz") as kept:
        np.testing.assert_array_equal(kept["x"], found.result.values)
    again = dx.calibrate_foot_ground(
        study, trials, folder=tmp_path, resume=True
    )
    assert "resumed from checkpoint.npz" in capsys.readouterr().out
    assert again.success
    assert again.solution.objective == pytest.approx(
        found.solution.objective, rel=1e-6
    )
    again.write(tmp_path)
    assert not list(tmp_path.glob("checkpoint*"))
