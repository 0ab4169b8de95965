"""What commands print and write, by hand; nothing is solved."""

import json
from argparse import Namespace
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration.clocks import Clock
from drake_exo.cli import (
    batch,
    calibrate,
    contact,
    crossvalidate,
    demo,
    sensitivity,
    sole,
    view,
)
from drake_exo.cli.calibrate import SUMMARY
from drake_exo.cli.view import REPLAY
from drake_exo.errors import InputError
from drake_exo.files.output import STOPPED_CODE, Check, Verdict, write_json


def test_sensitivity_tells_the_strongest_parts(capsys):
    found = SimpleNamespace(
        names=["a", "b", "c", "d"],
        influence=[1.0, 2.0, 3.0, 4.0],
        singular_values=[5.0],
        directions=[np.array([0.1, -0.8, 0.3, 0.5])],
        advice=lambda: ["fix b"],
    )
    sensitivity._print(found)
    said = capsys.readouterr().out.splitlines()
    (parts,) = (x for x in said if "-0.80 b" in x)
    assert parts.endswith("-0.80 b, +0.50 d, +0.30 c")
    assert "fix b" in said


@pytest.fixture
def left_out(monkeypatch):
    """Cross-validation of three trials whose folds are as they are put."""
    ground = SimpleNamespace(array=[0.0])
    trials = [
        SimpleNamespace(
            name=n, cuffs=["pelvis"], provenance={"encoders": n}, q=n,
            ground=ground,
        )
        for n in "abc"
    ]  # fmt: skip
    trials[2].cuffs.append("thigh")
    study = SimpleNamespace(
        model=None,
        name="x",
        trials=lambda use: trials,
        gate=lambda *_: (),
        reads=(),
    )
    monkeypatch.setattr(crossvalidate, "read_study", lambda *_: study)
    monkeypatch.setattr(crossvalidate, "check_has_cuffs", lambda _: None)

    def run(out, force=False, **stopped):
        def fold(study, name):
            if isinstance(stop := stopped.get(name), BaseException):
                raise stop
            mean = {"interaction_n": {"pelvis": 3.0}}
            usual = {"interaction_n": {"pelvis": 12.0}}
            row = {
                "trial": name, "success": name not in stopped,
                "stopped": stopped.get(name, False),
                "rmsd": mean, "rmsd_uncalibrated": usual,
            }  # fmt: skip
            return row, run.found.get(name)

        monkeypatch.setattr(crossvalidate, "fold", fold)
        args = Namespace(
            study=Path("s"), data_root=None, out=out, force=force, accept=()
        )
        return crossvalidate.run(args), json.loads((out / SUMMARY).read_text())

    run.trials, run.found = trials, {}
    return run


def test_the_only_trial_with_encoders_is_not_left_out(
    left_out, tmp_path, capsys
):
    """Without it nothing could be calibrated."""
    for trial in left_out.trials[1:]:
        trial.provenance = {"exoskeleton_angles": "the human's"}
    code, summary = left_out(tmp_path / "one")
    assert code == 0
    assert [f["trial"] for f in summary["folds"]] == ["b", "c"]
    assert (
        "a is never left out: only it has encoders" in capsys.readouterr().out
    )
    assert "only one trial has mats of thigh" in summary["sentence"]
    left_out.trials[0].cuffs += ["thigh", "shank"]
    _, summary = left_out(tmp_path / "told")
    # That trial tells the thigh's force always; of its shank nothing is asked.
    assert "only one" not in summary["sentence"]
    for trial in left_out.trials[1:]:
        trial.cuffs = []
    with pytest.raises(InputError, match="no trial that can be left out has"):
        left_out(tmp_path / "none")


def test_a_copy_of_a_trial_is_refused_before_any_fold(left_out, tmp_path):
    """Left out, a trial would be calibrated on by its copy."""
    left_out.trials[2].q = left_out.trials[0].q
    with pytest.raises(InputError, match="a and c are the same part of"):
        left_out(tmp_path / "copy")


def test_crossvalidation_goes_over_all_unless_it_is_stopped(left_out, tmp_path):
    code, summary = left_out(tmp_path / "whole")
    assert code == 0 and len(summary["folds"]) == 3
    assert summary["ratio"] == pytest.approx(0.25)
    assert "only one trial has mats of thigh" in summary["sentence"]
    code, summary = left_out(tmp_path / "stopped", b=True)
    assert code == STOPPED_CODE
    assert [f["stopped"] for f in summary["folds"]] == [False, True, False]
    code, summary = left_out(tmp_path / "failed", c=False)
    assert code == 1 and len(summary["folds"]) == 3
    # Between solves, too: what is left would look like the whole.
    code, summary = left_out(tmp_path / "between", b=KeyboardInterrupt())
    assert code == STOPPED_CODE and summary["verdict"] == "not solved"
    assert [f["success"] for f in summary["folds"]] == [True, False, False]
    with pytest.raises(ZeroDivisionError):  # as if it was killed
        left_out(tmp_path / "killed", b=ZeroDivisionError())
    summary = json.loads((tmp_path / "killed" / SUMMARY).read_text())
    assert summary["verdict"] == "not solved"
    assert [f["trial"] for f in summary["folds"]] == ["a", "b", "c"]


def test_a_crossvalidation_tells_the_clocks_of_trials_left_out(
    left_out, tmp_path, capsys
):
    """Mats that are read late count as an error of both cuffs."""
    trial = SimpleNamespace(
        name="b",
        lags_s={"pressure": 0.0},
        provenance={},
        times=np.arange(100) * 0.01,
        cuffs={"pelvis": SimpleNamespace(normal=np.sin(np.arange(100) * 0.2))},
    )
    problem = SimpleNamespace(trials=[trial])
    left_out.found["b"] = SimpleNamespace(
        clocks=(Clock("b", "pressure", -0.034, 0.002),),
        result=SimpleNamespace(problem=problem),
    )
    code, summary = left_out(tmp_path / "out")
    assert code == 0 and summary["verdict"] == "holds"
    ((system, lag_s),) = ((c["system"], c["lag_s"]) for c in summary["clocks"])
    assert (system, lag_s) == ("pressure", -0.034)
    said = capsys.readouterr().out
    assert "b, pressure       -34   ± 4" in said
    assert "set pressure_delay_s of this trial to it, and run" in said


@pytest.mark.parametrize("stopped", [True, False])
def test_a_crossvalidation_that_is_not_solved_replaces_none(
    stopped, left_out, tmp_path, capsys
):
    out = tmp_path / "whole"
    left_out(out)
    _, summary = left_out(out, force=True, b=stopped)
    assert all(f["success"] for f in summary["folds"])
    assert f"results in {out}.partial" in capsys.readouterr().out
    code, summary = left_out(out, force=True)
    assert code == 0 and len(summary["folds"]) == 3
    assert [p.name for p in tmp_path.iterdir()] == ["whole"]


def test_a_demo_that_is_not_solved_replaces_none(monkeypatch, tmp_path):
    args = Namespace(out=tmp_path / "demo", force=True)
    for code in (0, 1):

        def steps(out, code=code):
            (out / "replay.html").write_text(f"{code}")
            return code

        monkeypatch.setattr(demo, "_steps", steps)
        assert demo.run(args) == code
    assert (tmp_path / "demo" / "replay.html").read_text() == "0"


def test_a_fold_reads_both_on_the_clock_that_calibrated_cuffs_tell(
    monkeypatch,
):
    solved = SimpleNamespace(success=True, contact="calibrated")
    for name in ("calibrate_foot_ground", "calibrate_interaction"):
        monkeypatch.setattr(crossvalidate, name, lambda *_: solved)
    monkeypatch.setattr(crossvalidate, "uncalibrated", lambda *_: "nominal")

    def predict(study, trial, contact):
        late = contact == "calibrated"
        return SimpleNamespace(
            success=True,
            timed=lambda t: SimpleNamespace(name=t.name, lag=t.lag or 5 * late),
            rmsd=lambda t: (contact, t.name, t.lag),
            contact=contact,
        )

    monkeypatch.setattr(crossvalidate, "predict", predict)
    trials = [SimpleNamespace(name=n, lag=0) for n in "ab"]
    study = SimpleNamespace(model=None, trials=lambda use: trials)
    row, found = crossvalidate.fold(study, "b")
    assert found.contact == "calibrated"
    assert row["rmsd"] == ("calibrated", "b", 5)
    assert row["rmsd_uncalibrated"] == ("nominal", "b", 5)


def test_the_demo_times_each_trial_once(monkeypatch):
    """Half of them here, the others beside."""
    trials = list("abcdefg")
    study = SimpleNamespace(
        trials=lambda use: trials, alone=lambda some: f"only {''.join(some)}"
    )
    monkeypatch.setattr(
        demo, "find_clocks", lambda study, trials, contact: list(trials)
    )
    asked = []

    def beside(function, study, trials, contact):
        asked.append((study, contact))
        return SimpleNamespace(value=lambda: list(trials))

    found = demo._timed(study, "contact", beside)
    assert sorted(found) == trials
    ((alone, with_contact),) = asked
    assert with_contact == "contact"
    assert alone in ("only bdf", "only aceg")


def test_the_demos_parts_are_folders_of_one(monkeypatch, tmp_path, capsys):
    """Laboratory, calibration, both predictions, report and replay."""
    made = []

    @contextmanager
    def process():
        yield lambda function, **how: SimpleNamespace(
            value=lambda: (
                ("predicted", [])
                if function is demo.to_predict
                else (3, "said\n")
            )
        )

    study = SimpleNamespace(
        gate=lambda _: [], calibrated=lambda folder, accept: ("contact", [])
    )

    def noted(name, answer=None):
        def do(*said, **how):
            folder = how.get("out") or next(
                (Path(x) for x in said if isinstance(x, Path)), None
            )
            made.append((name, folder))
            return answer

        return do

    for name, value in (
        ("write_campaign", noted("lab")),
        ("read_study", lambda _: study),
        ("Beside", process),
        ("write_interaction", lambda s, folder, checks: noted("ab", 0)(folder)),
        ("_timed", lambda *_: []),
        ("write_predictions", noted("c1", 0)),
        ("write_report", noted("report")),
        ("gather", lambda out: out),
        ("write_view", lambda out, path: made.append(("view", path))),
    ):
        monkeypatch.setattr(demo, name, value)
    args = Namespace(out=tmp_path / "demo", force=False)
    assert demo.run(args) == 3  # of the stiff cuffs' prediction
    assert "nine movements, seed 1, wide truth" in capsys.readouterr().out
    out = tmp_path / "demo"
    assert made == [
        ("lab", out / "laboratory"),
        ("ab", out / "calibration"),
        ("c1", out / "prediction"),
        ("report", out / "report"),
        ("view", out / REPLAY),
    ]
    assert (out / "prediction_stiff").is_dir()


def test_a_batch_counts_what_holds(tmp_path):
    bad = [
        (SimpleNamespace(name=n), SimpleNamespace(verdict="v", sentence="s"))
        for n in "ab"
    ]
    found = SimpleNamespace(bad=bad, tasks=range(7), fresh=4, out="o")
    assert batch.text_of(found).splitlines() == [
        "a: v: s", "b: v: s", "5 of 7 tasks hold, 4 run now; results in o",
    ]  # fmt: skip


def test_figures_of_strain_go_into_the_summary_that_is_there(tmp_path):
    """Of a design, of a study, or into a new one."""
    path = tmp_path / SUMMARY

    def noted(found, before=None):
        path.unlink(missing_ok=True)
        if before is not None:
            write_json(path, before)
        sole._note(tmp_path, found)
        return json.loads(path.read_text())

    assert noted({"a": {"x": 1}}, {"name": "a"}) == {
        "name": "a", "finite_strain": {"x": 1},
    }  # fmt: skip
    assert noted({"a": {"x": 1}}) == {
        "cases": [{"name": "a", "finite_strain": {"x": 1}}]
    }
    study = {"cases": [{"name": "a"}, {"name": "b", "finite_strain": 5}]}
    assert noted({"a": {"x": 1}}, study)["cases"] == [
        {"name": "a", "finite_strain": {"x": 1}},
        {"name": "b", "finite_strain": 5},
    ]


def test_results_are_written_beside_their_source_once(tmp_path):
    args = Namespace(out=None, source=tmp_path, force=False)
    with sole._out_or_source(args, "table.txt") as out:
        assert Path(out) == tmp_path
    (tmp_path / "table.txt").write_text("")
    with pytest.raises(InputError, match=r"already holds table\.txt"):
        sole._out_or_source(args, "table.txt")
    args.force = True
    with sole._out_or_source(args, "table.txt") as out:
        assert Path(out) == tmp_path


def test_the_mesh_is_timed_by_itself(monkeypatch, tmp_path, capsys):
    clock = iter([5.0, 7.25, 9.0, 9.0, 9.0, 9.0])
    monkeypatch.setattr(
        sole, "time", SimpleNamespace(perf_counter=lambda: next(clock))
    )
    written = []
    step = SimpleNamespace(
        c_tr=1.0, c_rot=2.0, c=3.0,
        write=lambda *said: written.append(said) or Verdict(()),
    )  # fmt: skip
    case = SimpleNamespace(
        name="a", load=SimpleNamespace(times=range(4)),
        mesh=SimpleNamespace(tets=range(9)), simulate=lambda tell: step,
        settings=SimpleNamespace(files=[]),
    )  # fmt: skip
    monkeypatch.setattr(sole, "_case", lambda args: case)
    args = Namespace(
        out=tmp_path / "o", force=False, accept=(), mesh=None,
        case=tmp_path / "case.yaml", data_root=None,
    )  # fmt: skip
    sole._simulate(args)
    assert written[0][1] == {"mesh_seconds": 2.25}
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == [
        "a: 9 tets, 4 samples",
        "a: c_tr 1 N/m, c_rot 2 N·m/rad, c 3",
    ]


def test_a_study_is_looked_for_beside_its_case(monkeypatch, tmp_path):
    asked = []

    def read(path, data_root, mesh, read_step):
        return read_step("walk.yaml", "t", "left")

    monkeypatch.setattr(sole.soles.Case, "read", read)
    monkeypatch.setattr(
        "drake_exo.study.read_study",
        lambda path, root: (
            asked.append((path, root))
            or SimpleNamespace(step=lambda *which: which)
        ),
    )
    args = Namespace(data_root="d", mesh=None)
    found = sole._read_case(args, tmp_path / "cases" / "a.yaml")
    assert found == ("t", "left")
    assert asked == [(tmp_path / "cases" / "walk.yaml", "d")]


def test_a_finished_phase_is_known_by_its_summary(tmp_path):
    assert calibrate.finished(tmp_path, "it") is None
    for holds in (True, False):
        made = Verdict((Check("solved", holds),))
        write_json(tmp_path / SUMMARY, made.summary() | {"inputs": "it"})
        found = calibrate.finished(tmp_path, "it")
        assert (found is not None) == holds
        if holds:
            with pytest.raises(InputError, match="of another study"):
                calibrate.finished(tmp_path, "another")


def test_the_phase_before_is_done_in_a_folder_of_its_own(monkeypatch, tmp_path):
    """Its summary and what it does not hold go on into the second."""
    off = Check("audit", False, 2.0, 1.0, "N", "t", "coarse")
    seen = {}

    def ground(study, folder, *_):
        seen["first"] = folder
        write_json(folder / SUMMARY, {"a": 1} | Verdict((off,)).summary())
        return 3

    monkeypatch.setattr(calibrate, "write_foot_ground", ground)
    monkeypatch.setattr(
        calibrate, "read_calibration",
        lambda folder: SimpleNamespace(contact=("of", folder)),
    )  # fmt: skip
    monkeypatch.setattr(calibrate, "write_inputs", lambda *_: None)
    monkeypatch.setattr(calibrate, "inputs", lambda *_: "it")
    monkeypatch.setattr(
        calibrate, "calibrate_interaction",
        lambda study, contact, folder, resume: (contact, folder),
    )  # fmt: skip
    monkeypatch.setattr(calibrate, "_write", lambda *said: said)
    study = SimpleNamespace(model=None, trials=lambda use: [], interaction=None)
    found, out, more, front, checks, _ = calibrate.write_interaction(
        study, tmp_path
    )
    folder = tmp_path / calibrate.FOOT_GROUND
    assert seen["first"] == folder
    assert found == (("of", folder), tmp_path) and out == tmp_path
    assert more["foot_ground"]["a"] == 1 and not front
    assert more["inputs"] == "it"
    assert checks == [off]


def test_where_files_are_is_printed(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        contact, "write_figures", lambda folder, curves: [folder / "a.png"]
    )
    values = vars(contact.ContactCurves())
    out = tmp_path / "o"
    contact.run(Namespace(**values, out=out, force=False))
    assert capsys.readouterr().out == f"{out / 'a.png'}\n"
    served = []
    monkeypatch.setattr(
        view, "write_view", lambda results, path, accept: served.append(path)
    )
    monkeypatch.setattr(view, "_serve", lambda *said: served.append(said))
    view.run(Namespace(out=None, results=Path("r"), accept=(), no_browser=True))
    page, (folder, opened) = served
    assert page == folder / REPLAY and opened is False
