"""Results on disk become the paper's tables and figures."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo.calibration.audit import rmsd, spread
from drake_exo.calibration.results import (
    read_trial,
    write_model,
    write_trial,
)
from drake_exo.cli import main, predict
from drake_exo.files.output import Check, Verdict, write_json
from drake_exo.measurement.trial import CuffForce
from drake_exo.model.plant import nominal_model
from drake_exo.papers import serrancoli
from drake_exo.report.gathering import gather
from drake_exo.virtual_laboratory import synthetic


def leave(folder, trials, phase, **more):
    """What a phase leaves behind, as far as a report looks."""
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for trial in trials:
        trial.save(folder / f"measured_{trial.name}")
        n = len(trial.times)
        force = CuffForce.of(np.full((n, 3), more.get("force", 3.0)))
        solved = replace(
            trial,
            source="solved",
            moments=trial.moments + 2.0,
            cuffs=dict.fromkeys(("shank", "thigh", "pelvis"), force),
        )
        write_trial(folder, solved)
        if "rmsd_uncalibrated" in more:
            solved.save(folder / f"uncalibrated_{trial.name}")
        found.append(solved)
    summary = {
        "phase": phase,
        "subject": "virtual_subject",
        "rmsd": [rmsd(f, t) for f, t in zip(found, trials, strict=True)],
        "measured_sd": spread(trials, nominal_model("coupled").tree),
        "success": True,
        **Verdict(()).summary(),
        **more,
    }
    write_json(folder / "summary.json", summary)
    return found


@pytest.fixture(scope="module")
def trials():
    return synthetic.rises_in_device(duration_s=0.8).trials


@pytest.fixture(scope="module")
def folder(trials, tmp_path_factory):
    place = tmp_path_factory.mktemp("report")
    leave(place / "cal" / "foot_ground", trials, "foot-ground")
    leave(place / "b", trials, "interaction")
    leave(place / "c1", trials, "prediction", scale_interaction=1.0)
    stiff = {"scale_interaction": 1.4, "force": 60.0}
    leave(place / "c2", trials, "prediction", **stiff)
    assert main(["report", str(place)]) == 0
    return place


@pytest.mark.slow
def test_tables_and_figures_are_there(folder):
    names = {p.name for p in (folder / "report").iterdir()}
    assert {f"figure_{k}.png" for k in range(2, 8)} <= names
    assert {"table_2.csv", "table_3.csv", "tables.txt"} <= names


@pytest.mark.slow
def test_predictions_stand_beside_uncalibrated_ones(trials, tmp_path):
    """Of the first run alone, and of none that an earlier version left."""
    for name, more in (("x", {}), ("c1", {"rmsd_uncalibrated": []})):
        leave(tmp_path / name / "c1", trials[:1], "prediction", **more)
        stiff = {"scale_interaction": 1.4, **more}
        leave(tmp_path / name / "c2", trials[:2], "prediction", **stiff)
    names = ["C1", "C2", "C1 uncalibrated"]
    for name, shown in (("x", names[:2]), ("c1", names)):
        found = {r.label: r for r in gather(tmp_path / name)}
        runs, measured = serrancoli._curves(found)
        assert list(runs) == shown
        assert [t.name for t in measured] == ["rise1", "rise2"]
    usual, missing = runs["C1 uncalibrated"]
    np.testing.assert_array_equal(usual.moments, runs["C1"][0].moments)
    assert missing is None


@pytest.mark.slow
def test_what_is_predicted_uncalibrated_is_kept(trials, tmp_path, monkeypatch):
    usual = replace(trials[0], source="solved", moments=trials[0].moments + 9.0)
    names = ("rmsd", "rmsd_uncalibrated", "solves", "design", "controller")
    summary = dict.fromkeys(names, ()) | {"measured_sd": {}, "starts_from": ""}
    summary["settings"] = {"ends": "measured"}
    summary["rmsd"] = [{"trial": t.name, "angles_deg": 1.0} for t in trials[:2]]
    summary["rmsd_uncalibrated"] = [summary["rmsd"][0], None]
    shown = []
    monkeypatch.setattr(predict, "draw_figures", lambda *a: shown.extend(a[3]))
    found = SimpleNamespace(write=lambda *_: None)
    good = [(found, usual, trials[0]), (found, None, trials[1])]
    predict._write(tmp_path, good, [None, None], summary, Verdict(()), False)
    assert shown == [usual, None]
    assert "the same with uncalibrated cuffs (not solved: rise2)" in (
        (tmp_path / "rmsd.txt").read_text("utf-8")
    )
    found = read_trial(tmp_path, "rise1", "uncalibrated")
    np.testing.assert_array_equal(found.moments, usual.moments)
    assert len(list(tmp_path.glob("uncalibrated_*"))) == 2


@pytest.mark.slow
def test_table_holds_the_numbers_of_the_summaries(folder):
    with (folder / "report" / "table_3.csv").open() as file:
        rows = {row["signal"]: row for row in csv.DictReader(file)}
    summary = json.loads((folder / "c2" / "summary.json").read_text("utf-8"))
    values = [
        r["interaction_n"]["pelvis"]
        for r in summary["rmsd"]
        if "pelvis" in r["interaction_n"]
    ]
    assert len(values) == 2
    row = rows["normal force pelvis [N]"]
    assert float(row["C2 mean"]) == pytest.approx(np.mean(values))
    assert float(row["C2 SD"]) == pytest.approx(np.std(values, ddof=1))
    assert row["paper C2"] == "> 30"
    assert float(rows["moment knee [N m]"]["C1 mean"]) == pytest.approx(2.0)
    assert rows["angle knee [deg]"]["measured SD"]


@pytest.mark.slow
def test_solved_trials_survive_disk(trials, tmp_path):
    (found, *_) = leave(tmp_path / "x", trials, "interaction")
    back = read_trial(tmp_path / "x", found.name)
    for cuff, force in found.cuffs.items():
        np.testing.assert_array_equal(
            back.cuffs[cuff].components, force.components
        )
    np.testing.assert_array_equal(back.q, found.q)


def test_a_folder_without_results_is_one_sentence(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "no results" in error and error.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("usual", [3.0, [3.0], [{"angles_deg": "x"}]])
def test_damaged_scores_of_nominal_cuffs_are_one_sentence(
    tmp_path, trials, capsys, usual
):
    leave(tmp_path, trials[:1], "prediction", rmsd_uncalibrated=usual)
    assert main(["report", str(tmp_path)]) == 2
    assert "is not as a phase writes it" in capsys.readouterr().err


_OFF = Verdict((Check("audit", False, 2.5, 1.0, "N", "rise1"),)).summary()


@pytest.mark.slow
def test_what_does_not_hold_is_marked_everywhere(trials, tmp_path):
    leave(tmp_path / "c1", trials[:1], "prediction", **_OFF)
    assert main(["report", str(tmp_path)]) == 0
    out = tmp_path / "report"
    assert "DOES NOT HOLD: audit (rise1, 2.5 N" in (
        (out / "tables.txt").read_text("utf-8")
    )
    header = (out / "table_3.csv").read_text("utf-8").splitlines()[0]
    assert header.count("C1 (DOES NOT HOLD)") == 2
    # The mark is drawn: other pixels than those of the same that holds.
    leave(tmp_path / "good" / "c1", trials[:1], "prediction")
    assert main(["report", str(tmp_path / "good")]) == 0
    good = tmp_path / "good" / "report"
    drawn = sorted(p.name for p in out.glob("*.png"))
    assert drawn == ["figure_6.png", "figure_7.png"]
    for name in drawn:
        assert (out / name).read_bytes() != (good / name).read_bytes()


@pytest.mark.slow
def test_what_was_not_solved_is_refused(trials, tmp_path, capsys):
    failed = Verdict((Check("solved", False, where="rise2"),)).summary()
    solves = [{"trial": "rise1", "success": True}]
    solves.append({"trial": "rise2", "success": False})
    more = {"success": False, "solves": solves, **failed}
    leave(tmp_path / "c1", trials[:1], "prediction", **more)
    assert main(["report", str(tmp_path)]) == 2
    assert "--accept solved" in capsys.readouterr().err
    with undrawn():
        assert main(["report", str(tmp_path), "--accept", "solved"]) == 0
    text = capsys.readouterr().out
    assert "NOT SOLVED: solved (rise2)" in text
    assert "means are of 1 trials; not solved: rise2" in text


def test_two_of_one_label_are_refused(trials, tmp_path, capsys):
    leave(tmp_path / "a", trials, "prediction")
    leave(tmp_path / "b", trials, "prediction")
    assert main(["report", str(tmp_path)]) == 2
    assert "are both C1" in capsys.readouterr().err


def test_two_subjects_are_refused(trials, tmp_path, capsys):
    leave(tmp_path / "a", trials, "prediction")
    leave(tmp_path / "b", trials, "interaction", subject="another")
    assert main(["report", str(tmp_path)]) == 2
    assert "report a folder of one subject" in capsys.readouterr().err


@pytest.mark.slow
def test_two_bodies_of_one_name_are_refused(trials, tmp_path, capsys):
    """Laboratories call more than one person "subject"."""
    leave(tmp_path / "a", trials, "prediction")
    leave(tmp_path / "b", trials, "interaction")
    model = nominal_model("coupled")
    write_model(tmp_path / "a", model)
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "r")]) == 0
    human = replace(model.human, shank_cuff_m=(0.0, 0.2))
    write_model(tmp_path / "b", replace(model, human=human))
    again = ["report", str(tmp_path), "--out", str(tmp_path / "r"), "--force"]
    assert main(again) == 0  # the same person in another device
    thigh = replace(human.thigh, length_m=human.thigh.length_m + 0.02)
    human = replace(human, thigh=thigh)
    write_model(tmp_path / "b", replace(model, human=human))
    assert main(again) == 2
    assert "of the same name" in capsys.readouterr().err
