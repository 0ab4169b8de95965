"""One task: its command, its verdict, its times, what a full disk does."""

import argparse
import errno
import json
from dataclasses import replace
from pathlib import Path

import pytest

from drake_exo.batch import run
from drake_exo.batch.file import BatchFile, Task, tasks_of
from drake_exo.batch.run import (
    _MARK,
    TASK,
    TIMING,
    outcome,
    read_outcome,
    run_batch,
    run_task,
)
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.output import locked, write_json

TASK_OF_BERT = Task(
    "bert/check", "bert", "", "check", source=Path("/b/bert.yaml"), key="k" * 64
)
ACTED = {}


def parse(command):
    """In the place of the command line's: does what a test wants."""
    ACTED["command"] = command
    out = Path(command[command.index("--out") + 1])
    return argparse.Namespace(run=lambda args: ACTED["run"](out))


def act(tmp_path, run, task=TASK_OF_BERT):
    ACTED["run"] = run
    near = tmp_path.parent / f"{tmp_path.name}_b"
    near.mkdir(exist_ok=True)
    return run_task(vars(task), str(tmp_path), f"{__name__}:parse", str(near))


def test_results_hold_no_times(tmp_path):
    def run(out):
        out.mkdir()
        print("iteration 7")
        tree = {
            "solve_seconds": 1.5,
            "cases": [{"seconds": 3.0, "nodes_per_second": 40}],
        }
        write_json(out / "summary.json", tree)
        return 0

    assert act(tmp_path, run) == "holds"
    folder = tmp_path / "bert" / "check"
    found = json.loads((folder / "summary.json").read_text())
    assert found == {"cases": [{"nodes_per_second": 40}]}
    timing = json.loads((folder / TIMING).read_text())
    assert timing["files"] == {
        "summary.json": {"solve_seconds": 1.5, "cases.0.seconds": 3.0}
    }
    assert "iteration 7" in timing["log"] and timing["host"]
    assert read_outcome(folder).key == TASK_OF_BERT.key


def test_earlier_results_are_replaced_whole(tmp_path):
    folder = tmp_path / "bert" / "check"
    folder.mkdir(parents=True)
    (folder / "old.txt").write_text("old")
    assert act(tmp_path, lambda out: out.mkdir()) == "holds"
    assert not (folder / "old.txt").exists()
    assert {p.name for p in folder.iterdir()} == {TASK, TIMING}
    assert not list((tmp_path / ".drafts").iterdir())


def refused(out):
    # Its folder is the batch file's.
    near = Path.cwd()
    raise InputError(f"{near / 'bert.yaml'}: wrong in {out / 'x'}; mend it")


def test_bad_input_is_told_without_the_machine(tmp_path):
    with pytest.raises(InputError, match="mend it"):
        act(tmp_path, refused)
    found = read_outcome(tmp_path / "bert" / "check")
    assert (found.code, found.verdict) == (2, "failed")
    assert found.sentence == "bert.yaml: wrong in out/x; mend it"
    assert not found.is_solved


# The cause comes last: nothing of it is cut off.
LONG = f"3 N; {'forces are late, ' * 9}check the cable"


def check_that_fails(accepted):
    def run(out):
        out.mkdir()
        row = {
            "name": "audit",
            "where": "t1",
            "sentence": LONG,
            "holds": False,
        }
        row["level"] = "fail"
        summary = {"checks": [row], "verdict": "does not hold"}
        write_json(out / "summary.json", summary)
        return 0 if accepted else 3

    return run


@pytest.mark.parametrize("accepted", [True, False])
def test_what_does_not_hold_says_so_accepted_or_not(tmp_path, accepted):
    run = check_that_fails(accepted)
    assert act(tmp_path, run) == "does not hold"
    found = read_outcome(tmp_path / "bert" / "check")
    assert found.code == (0 if accepted else 3)
    assert found.sentence == f"audit: t1: {LONG}" and found.is_solved


def test_not_solved(tmp_path):
    def run(out):
        out.mkdir()
        print("not solved: iteration limit after 5 iterations. More.")
        return 1

    with pytest.raises(InputError, match="iteration limit"):
        act(tmp_path, run)
    found = read_outcome(tmp_path / "bert" / "check")
    assert found.verdict == "not solved" and not found.is_solved


def test_a_full_disk_leaves_the_task_to_the_next_run(tmp_path):
    def run(out):
        try:
            raise OSError(errno.ENOSPC, "No space left on device")
        except OSError as error:
            raise InputError("out: cannot be written") from error

    with pytest.raises(InputError, match="make room and run the batch again"):
        act(tmp_path, run)
    assert read_outcome(tmp_path / "bert" / "check") is None
    assert not list((tmp_path / ".drafts").glob("*/out"))


def test_a_mistake_of_ours_is_no_outcome(tmp_path):
    def run(out):
        raise ZeroDivisionError("ours")

    with pytest.raises(ZeroDivisionError):
        act(tmp_path, run)
    assert read_outcome(tmp_path / "bert" / "check") is None


def test_a_sole_goes_on_from_its_checkpoint(tmp_path):
    task = replace(
        TASK_OF_BERT, step="sole optimize", name="bert/sole_optimize"
    )

    def killed(out):
        out.mkdir()
        (out / "checkpoint.json").write_text("{}")
        raise ZeroDivisionError("in the place of kill -9")

    with pytest.raises(ZeroDivisionError):
        act(tmp_path, killed, task)
    assert "--resume" not in ACTED["command"]
    act(tmp_path, lambda out: out.mkdir(), task)
    command = ACTED["command"]
    left = Path(command[command.index("--resume") + 1])
    assert left.name == "out" and left.parent.parent.name == ".drafts"
    assert not list((tmp_path / ".drafts").iterdir())


def test_damaged_task_files_are_none(tmp_path):
    for text in ("", "{", "[]", '{"code": 0}'):
        (tmp_path / TASK).write_text(text)
        assert read_outcome(tmp_path) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("[--no-such]", "unrecognized arguments: --no-such"),
        ("[--help]", "options of predict: help"),
        (
            "[--scale-interaction, '0']",
            "interaction: 0 is not a number above 0",
        ),
        ("[--scale-interaction, '-1.4']", "-1.4 is not a number above 0"),
        ("[--torque-limit, nan]", "limit: nan is not a number above 0"),
        ("[--torque-limit, fast]", "limit: fast is not a number above 0"),
    ],
)
def test_options_are_parsed_before_anything_runs(tmp_path, options, words):
    from drake_exo import cli

    path = tmp_path / "b.yaml"
    path.write_text(
        "steps: [calibrate, predict]\nlaboratories: {seeds: [1]}\n"
        f"options: {{predict: {options}}}"
    )
    out = tmp_path / "out"
    with pytest.raises(InputError, match=words):
        run_batch(path, out, lambda: None, f"{cli.__name__}:parse", print)
    assert not out.exists()


@pytest.mark.slow
def test_disturbances_are_looked_at_before_anything_runs(tmp_path):
    path, out = tmp_path / "b.yaml", tmp_path / "out"
    text = "steps: [check]\nlaboratories: {seeds: [1], without: [noise]}\n"
    path.write_text(text)
    with pytest.raises(InputError, match="invalid choice: 'noise'"):
        run_batch(path, out, lambda: None, "drake_exo.cli:parse", print)
    assert not out.exists()


def test_tables_are_written_while_no_other_run_may(tmp_path):
    path, out, told = tmp_path / "b.yaml", tmp_path / "out", []
    path.write_text("steps: [check]\nlaboratories: {seeds: [1]}\n")

    def stop():
        raise KeyboardInterrupt

    def write(found):
        told.append(found)
        with pytest.raises(InputError, match="another run"), locked(out):
            pass

    found = run_batch(path, out, stop, "drake_exo.cli:parse", write)
    assert told == [found] and found.exit_code == 130


@pytest.mark.parametrize("other", ["a", "seed_1"])
def test_a_place_that_one_file_has_is_each_file_s_affair(tmp_path, other):
    """Of what is done already, or yet to be written by a laboratory."""
    path, out = tmp_path / "b.yaml", tmp_path / "out"
    study = Path(__file__).parents[1] / "studies" / "opencap_sts1.yaml"
    text = study.read_text("utf-8")
    (tmp_path / "c.yaml").write_text(text)
    more = "  - {name: a, markers: a.trc, forces: a.mot, plates: {both: 1}}\n"
    (tmp_path / "a.yaml").write_text(
        text.replace("trials:\n", f"trials:\n{more}")
    )
    entries = {"a": "studies: [a.yaml, c.yaml]", "seed_1": "studies: [c.yaml]"}
    path.write_text(
        f"steps: [check]\n{entries[other]}\n"
        "sweep: {trials.3.use: [prediction]}\n"
        + "laboratories: {seeds: [1]}\n"
        * (other != "a")
    )
    for task in tasks_of(schema.load(path, BatchFile), tmp_path):
        if task.entry == "a":
            (out / task.name).mkdir(parents=True)
            write_json(out / task.name / TASK, outcome(task, 0))
            (out / _MARK).touch()

    def stop():
        raise KeyboardInterrupt

    found = run_batch(path, out, stop, "drake_exo.cli:parse", print)
    assert found.interrupted and {t.entry for t in found.tasks} == {other, "c"}


@pytest.mark.parametrize("name", ["case.yaml", "bert.yml"])
def test_a_swept_file_replaces_none_of_the_results(tmp_path, monkeypatch, name):
    """A design writes a case.yaml of its own, with the start it found."""
    path = tmp_path / name
    path.write_text("anything")
    monkeypatch.setattr(run, "changed_text", lambda *how: "swept")
    task = replace(TASK_OF_BERT, source=path, changes={"a.b": 1})

    def design(out):
        out.mkdir()
        (out / "case.yaml").write_text("found")
        return 0

    act(tmp_path, design, task)
    folder = tmp_path / "bert" / "check"
    assert (folder / "case.yaml").read_text() == "found"
    other = {"case.yaml": "swept_case.yaml", "bert.yml": "bert.yml"}[name]
    assert (folder / other).read_text() == "swept"
