"""Calibrated contact predicts rises of a real recording."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo.calibration import solving
from drake_exo.calibration.audit import Audit, spread
from drake_exo.calibration.results import (
    read_contact,
    read_trial,
    write_contact,
)
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.calibration.solving import read_checkpoint
from drake_exo.cli import main
from drake_exo.cli.calibrate import inputs
from drake_exo.cli.predict import (
    _accuracy,
    _source_of_torques,
    _summary,
    extrapolations,
    write_predictions,
)
from drake_exo.contact.parameters import Posterior, nominal_contact
from drake_exo.contact.strap import Design, Gains
from drake_exo.contact.systems import AssistController
from drake_exo.errors import InputError
from drake_exo.files.output import (
    Check,
    Verdict,
    prepare_output_folder,
    read_json,
    write_json,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.study import Prediction, Study, predict, read_study
from drake_exo.virtual_laboratory import synthetic


@pytest.fixture(scope="module")
def summary(command, calibrated):
    out = calibrated.parent / "c1"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    with undrawn():
        assert main([*command("predict"), *more]) == 0
    return json.loads((out / "summary.json").read_text("utf-8"))


@pytest.mark.slow
def test_sits_are_predicted_by_the_contact_of_rises(
    calibrated, data_root, tmp_path
):
    """Each nearer than a standard deviation of what was measured."""
    path = Path(__file__).parents[1] / "studies" / "opencap_sit.yaml"
    study = read_study(path, data_root)
    contact, _ = study.calibrated(calibrated)
    trials = study.trials("prediction")
    sd = spread(trials, study.model.tree)
    for trial in trials[:2]:
        row = predict(study, trial, contact).rmsd(trial)
        for key, limit in (("angles_deg", 3.3), ("grf_n", 10.0)):
            for name, value in row[key].items():
                assert value < min(sd[key][name], limit)


@pytest.mark.slow
def test_unseen_rises_are_predicted(summary):
    """The paper's C1: angles up to 3.3 deg."""
    assert summary["success"] is True
    assert [r["trial"] for r in summary["rmsd"]] == ["rise4", "rise5"]
    for row in summary["rmsd"]:
        assert max(row["angles_deg"].values()) < 3.3
        assert max(row["velocities_deg_s"].values()) < 25.0
        assert max(row["grf_n"].values()) < 15.0
        assert set(row["moments_nm"]) == {"ankle", "knee", "hip"}
        assert row["interaction_n"] == {}
    assert all(row["holds"] for row in summary["audit"])
    accuracy = [c for c in summary["checks"] if c["name"] == "accuracy"]
    assert [c["value"] for c in accuracy] == [
        max(row["angles_deg"].values()) for row in summary["rmsd"]
    ]
    assert all(c["holds"] for c in accuracy)


def test_angles_far_from_the_measured_ones_are_noted():
    check = _accuracy(
        {"trial": "walk", "angles_deg": {"ankle_left": 16.2, "hip_left": 2.1}}
    )
    assert (check.holds, check.level) == (False, "note")
    assert check.where == "walk, ankle_left" and check.value == 16.2
    assert "moved in another way" in check.sentence


@pytest.mark.slow
def test_what_is_complete_is_not_begun_again(
    summary, command, calibrated, capsys
):
    """Nor replaced by what is made of something else."""
    out = calibrated.parent / "c1"
    before = (out / "summary.json").read_bytes()
    given = ["--calibration", str(calibrated), "--out", str(out), "--resume"]
    assert main([*command("predict"), *given]) == 0
    assert "is complete and kept as it is" in capsys.readouterr().out
    for more in (["--scale-interaction", "1.2"], ["--torque-limit", "900"]):
        assert main([*command("predict"), *given, *more]) == 2
        assert "another study or other settings" in capsys.readouterr().err
    again = [*command("calibrate"), "--phase", "foot-ground", "--resume"]
    assert main([*again, "--out", str(out)]) == 2
    assert "another study or other settings" in capsys.readouterr().err
    assert (out / "summary.json").read_bytes() == before


@pytest.mark.slow
def test_springs_tell_predictions_apart():
    """Those of moments that were measured, too: `--resume` keeps neither."""
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    uses, found = ("calibration", "prediction"), []
    for stiffness in (0.0, 60.0):
        knee = JointDrive(stiffness_nm_rad=stiffness)
        study = Study(made.model, made.trials, device=Device(knee=knee))
        found.append(
            [inputs(study, use, study.prediction, made.contact) for use in uses]
        )
    assert [a == b for a, b in zip(*found, strict=True)] == [True, False]
    # As does the subject's name, which is in the results.
    study.name = "somebody else"
    again = inputs(study, uses[0], study.prediction, made.contact)
    assert again != found[1][0]


@pytest.mark.slow
def test_names_of_files_do_not_tell_runs_apart_but_clocks_do():
    """`--resume` goes on after files were moved."""
    made = synthetic.rises_in_device(1, nodes_per_second=20)

    def of(file, clocks):
        said = {"markers": file, "delays_s": {"encoders": 0.0}}
        said["clocks"] = clocks
        study = Study(made.model, [replace(made.trials[0], provenance=said)])
        return inputs(study, "calibration", study.interaction)

    unknown = {"encoders": "left to the calibration, unsure"}
    assert of("a.c3d", unknown) == of("b/a.c3d", unknown)
    assert of("a.c3d", unknown) != of("a.c3d", {})


@pytest.mark.slow
def test_ctrl_c_between_solves_keeps_what_is_finished(
    command, calibrated, tmp_path, monkeypatch, capsys
):
    """While the second trial is audited, no solver hears it."""
    audits = iter([Prediction.audit])

    def audit(self):
        for own in audits:
            return own(self)
        raise KeyboardInterrupt

    monkeypatch.setattr(Prediction, "audit", audit)
    out = tmp_path / "c1"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    with undrawn():
        assert main([*command("predict"), *more]) == 130
    told = f"results in {out}; --resume goes on from there\n"
    assert capsys.readouterr().out.endswith(told)
    found = json.loads((out / "summary.json").read_text("utf-8"))
    assert found["success"] is False and found["verdict"] == "not solved"
    assert [row["trial"] for row in found["rmsd"]] == ["rise4"]
    assert (out / "solution_rise4.npz").is_file()
    # Finished trials are solved from their solutions, not anew.
    assert (out / "unfinished_rise4" / "checkpoint.npz").is_file()
    monkeypatch.undo()
    with undrawn():
        assert main([*command("predict"), *more, "--resume"]) == 0
    again = json.loads((out / "summary.json").read_text("utf-8"))
    before, now = (f["solves"][0]["iterations"] for f in (found, again))
    assert now < before
    assert not list(out.glob("unfinished_*"))


@pytest.mark.slow
def test_ctrl_c_while_results_are_written_keeps_the_checkpoints(
    command, calibrated, tmp_path, monkeypatch
):
    """Nothing is on disk by then but these; --resume goes on from there."""
    out = tmp_path / "c1"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    monkeypatch.setattr(solving, "_CHECKPOINT_SECONDS", 0.0)

    def interrupted(*given):
        raise KeyboardInterrupt

    with monkeypatch.context() as within:
        within.setattr("drake_exo.cli.predict._write", interrupted)
        assert main([*command("predict"), *more]) == 130
    kept = sorted(path.parent.name for path in out.glob("*/checkpoint.npz"))
    assert kept == ["unfinished_rise4", "unfinished_rise5"]
    with undrawn():
        assert main([*command("predict"), *more, "--resume"]) == 0
    assert not list(out.glob("unfinished_*"))


@pytest.mark.slow
def test_a_limit_too_low_fails_with_names(
    command, calibrated, tmp_path, capsys
):
    _, fine, *root = command("predict")
    study = Path(fine).read_text("utf-8")
    assert study.count("nodes_per_second: 200") == 2
    coarse = tmp_path / "study.yaml"
    coarse.write_text(study.replace("per_second: 200", "per_second: 50"))
    out = tmp_path / "low"
    more = ["--calibration", str(calibrated), "--out", str(out)]
    more += ["--torque-limit", "5"]
    assert main(["predict", str(coarse), *root, *more]) == 1
    text = capsys.readouterr().out
    assert "torque" in text and "its bound is" in text
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["success"] is False
    assert summary["rmsd"] == []
    assert all(s["binding_bounds"] for s in summary["solves"])


@pytest.mark.slow
def test_a_checkpoint_of_another_problem_is_refused(command, tmp_path, capsys):
    out = tmp_path / "other"
    out.mkdir()
    np.savez(out / "checkpoint.npz", x=np.zeros(3), structure="another")
    again = [*command("calibrate"), "--out", str(out), "--resume"]
    assert main(again) == 2
    error = capsys.readouterr().err
    assert "--resume" in error and error.count("\n") == 1


def test_a_checkpoint_of_another_machine_is_taken(tmp_path):
    """Last digits of the same study differ; those of another study do more."""
    path, x = tmp_path / "checkpoint.npz", np.arange(4.0)
    values = np.array([-np.inf, 0.0, 3.0, np.inf])
    np.savez(path, x=x, structure="a", values=values * (1.0 + 1e-13))
    np.testing.assert_array_equal(read_checkpoint(path, ("a", values), 4), x)
    for other in (("b", values), ("a", values[:3]), ("a", values + 1e-3)):
        with pytest.raises(InputError, match=r"study .*without resume"):
            read_checkpoint(path, other, 4)


def test_a_prediction_remarks_that_its_design_is_an_extrapolation(tmp_path):
    far, near = (
        Check(f"design.{name}", False, where="thigh", level="note")
        for name in ("extrapolation", "bounds")
    )
    assert extrapolations(tmp_path / "design.yaml") == []
    summary = Verdict((far, near)).summary()
    write_json(tmp_path / "summary.json", summary)
    assert extrapolations(tmp_path) == [far]
    for damaged in (3, None, {"checks": 3}):
        write_json(tmp_path / "summary.json", damaged)
        with pytest.raises(InputError, match=r"summary\.json: checks are not"):
            extrapolations(tmp_path)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--controller", "nowhere"], "MODULE:NAME"),
        (["--design", "nowhere"], "nowhere: cannot be read"),
    ],
)
def test_bad_options_are_one_sentence(
    options, words, command, human, tmp_path, capsys
):
    write_contact(tmp_path, nominal_contact(human))
    more = ["--calibration", str(tmp_path), "--out", str(tmp_path / "x")]
    assert main([*command("predict"), *more, *options]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@pytest.mark.slow
def test_what_a_prediction_refuses_leaves_no_folder(tmp_path):
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    study = Study(made.model, made.trials)
    ground = replace(made.contact, bushings={})
    out = tmp_path / "out"
    with (
        pytest.raises(InputError, match="holds no interaction parameters"),
        prepare_output_folder(out) as folder,
    ):
        write_predictions(study, ground, folder)
    assert not out.exists()


@pytest.mark.slow
def test_what_is_solved_is_written_before_another_trial_is_refused(
    tmp_path, monkeypatch
):
    """Whatever is wrong with that one."""
    model, (one, other) = synthetic.rises_on_spheres(2, nodes_per_second=20)
    other = replace(other, q=np.full_like(other.q, np.nan))
    settings = PredictionSettings(solver=Solver(10.0))
    study = Study(model, [one, other], prediction=settings)
    audit = Audit("rise1", 0.0, 0.0, (0.0, 0.0), 0.0)
    monkeypatch.setattr(Prediction, "audit", lambda found: audit)
    with (
        undrawn(),
        pytest.raises(InputError, match="rise2: q holds values that are not"),
        prepare_output_folder(tmp_path / "out") as folder,
    ):
        write_predictions(study, nominal_contact(model), folder)
    assert read_trial(tmp_path / "out", "rise1").source == "solved"
    # --resume goes on from it when the other is mended.
    assert (tmp_path / "out/unfinished_rise1/checkpoint.npz").is_file()
    summary = read_json(tmp_path / "out" / "summary.json", "")
    assert (summary["success"], summary["verdict"]) == (False, "not solved")
    assert "rise2: q holds" in summary["status"]
    assert [row["trial"] for row in summary["rmsd"]] == ["rise1"]


@pytest.mark.slow
@pytest.mark.parametrize("designed", [False, True])
def test_differences_from_another_device_say_so(
    designed, tmp_path, monkeypatch, capsys
):
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    settings = PredictionSettings(solver=Solver(10.0))
    study = Study(made.model, made.trials, prediction=settings)
    audit = Audit("rise1", 0.0, 0.0, (0.0, 0.0), 0.0)
    monkeypatch.setattr(Prediction, "audit", lambda found: audit)
    more = {
        "usual": made.contact,
        "worn": Design(gains={"exo_hip": Gains()}),
        "controller": AssistController(),
        "controller_name": "drake_exo:AssistController",
    }
    with undrawn():
        write_predictions(
            study, made.contact, tmp_path, **(more if designed else {})
        )
    told = read_json(tmp_path / "summary.json", "")["design"]
    assert (told and told["exo_hip"]["support"]) == (1.0 if designed else None)
    printed = capsys.readouterr().out
    for text in ((tmp_path / "rmsd.txt").read_text(), printed):
        assert "movements start from" in text
        assert ("measured in the device of today" in text) == designed
        assert ("gains have no effect" in text) == designed
        assert ("accuracy" in text) == (not designed and text is printed)


@pytest.mark.parametrize("designed", [None, {}, {"thigh": {}}])
def test_a_step_finds_the_torques_of_a_device_itself(designed):
    """Those of a design's forecast, and that it is passive, are not used."""
    alone, worn = (
        SimpleNamespace(coordinates=SimpleNamespace(device=device))
        for device in ((), ("motor",))
    )

    def told(trial, ends, controller=None):
        settings = {"ends": ends}
        given = {"design": designed, "controller": controller}
        return _source_of_torques({"settings": settings, **given}, trial)

    assert told(alone, "periodic") == told(worn, "measured") == ""
    text = told(worn, "periodic")
    assert text.startswith("\na step without data finds the device's torques")
    assert ("gains have no effect" in text) == bool(designed)
    assert ("the controller" in told(worn, "periodic", "a:b")) == bool(designed)


@pytest.mark.slow
def test_movements_start_from_a_chair_only_where_it_bears():
    """An empty plate may lie under the seat; a squat has no seat."""
    model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=20)
    rise = {"part": {"from": "rise", "rise": 1}}
    squat = {"part": {"from": "whole recording", "start_s": 2.0}}
    starts = []
    sit = {"part": {"from": "sit", "sit": 1, "seated_s": 0.5}}
    given = (0.0, rise), (0.3, rise), (0.0, squat), (0.3, sit)
    for share, origin in given:
        chair = PlanarWrench.of(share * trial.ground.array)
        seated = replace(trial, chair=chair, provenance=origin)
        found = _summary(Study(model, [seated]), [], [seated], None)
        starts.append(found["starts_from"])
    assert starts[0].startswith("seat-off")
    assert starts[1] == "the measured chair force"
    assert starts[2:] == ["their first measured state"] * 2
    settings = PredictionSettings(
        ends="periodic", speed_m_s=1.2, torque_limit_nm=200.0
    )
    study = Study(model, [trial], prediction=settings)
    found = _summary(study, [], [trial], None)
    assert found["starts_from"].startswith("a state of their own")


@pytest.mark.slow
def test_the_contact_beside_scaled_predictions_is_the_scaled_one(
    tmp_path, monkeypatch
):
    """It is what forces and an export to OpenSim belong to."""
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    known = replace(
        made.contact,
        posterior=Posterior(
            ("thigh.normal_stiffness",), np.array([7e3]), np.array([[1e4]])
        ),
    )

    def stopped(*given, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_exo.cli.predict.predict", stopped)
    study = Study(made.model, made.trials)
    write_predictions(study, known, tmp_path, scale_interaction=1.4)
    found = read_contact(tmp_path, accept=["provenance"])
    assert found == known.scaled(1.4)
    assert found.values() != known.values()


@pytest.mark.slow
def test_a_folder_that_holds_no_calibration(command, tmp_path, capsys):
    (tmp_path / "parameters.json").write_text('{"law": "simbody"}')
    more = ["--calibration", str(tmp_path), "--out", str(tmp_path / "x")]
    assert main([*command("predict"), *more]) == 2
    error = capsys.readouterr().err
    assert "parameters.json" in error and error.count("\n") == 1
