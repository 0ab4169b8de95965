"""Pieces of a batch by themselves: commands, what is done, lost processes."""

import io
import json
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drake_exo import cli
from drake_exo.batch import results, run
from drake_exo.batch.file import Task, variant_name
from drake_exo.batch.results import Row
from drake_exo.batch.run import outcome
from drake_exo.errors import InputError
from drake_exo.files.output import HOLDS, write_json
from drake_exo.jobs import engine as jobs
from drake_exo.jobs import process_child
from drake_exo.jobs.engine import Ended, Job, Worker

CALIBRATE = Task(
    "anna/calibrate", "anna", "", "calibrate", source=Path("/b/anna.yaml"),
    options=("--no-figures",), key="k" * 64,
)  # fmt: skip


def test_a_command_names_what_it_reads_and_where_it_writes(tmp_path):
    out, draft = tmp_path / "out", tmp_path / "draft"
    found = run._command(CALIBRATE, out, draft, [])
    assert found == [
        "calibrate", "/b/anna.yaml", "--data-root", "/b", "--no-figures",
        "--out", str(draft / "out"),
    ]  # fmt: skip
    predict = replace(
        CALIBRATE, step="predict", root=Path("/data"), options=(),
        needs={"calibrate": "anna/calibrate"},
    )  # fmt: skip
    assert run._command(predict, out, draft, [])[3:6] == [
        "/data", "--calibration", str(out / "anna/calibrate"),
    ]  # fmt: skip
    made = replace(CALIBRATE, source=None, needs={run.LAB: "seed=1/lab"})
    study = out / "seed=1/lab" / "study.yaml"
    assert run._command(made, out, draft, [])[1:4] == [
        str(study), "--data-root", str(study.parent),
    ]  # fmt: skip
    case = replace(CALIBRATE, step="sole simulate", options=())
    assert run._command(case, out, draft, []) == [
        "sole", "simulate", "/b/anna.yaml", "--out", str(draft / "out"),
    ]  # fmt: skip
    lab = replace(CALIBRATE, step=run.LAB, options=("--seed", "1"))
    assert run._command(lab, out, draft, []) == [
        run.LAB, "--seed", "1", "--jobs", "1", "--out", str(draft / "out"),
    ]  # fmt: skip


def test_a_changed_study_is_read_from_the_draft(tmp_path, monkeypatch):
    study = tmp_path / "anna.yaml"
    study.write_text("filter: {cutoff_hz: 6.0}\n")
    task = replace(CALIBRATE, source=study, changes={"filter.cutoff_hz": 9.0})
    draft = tmp_path / "draft"
    draft.mkdir()
    monkeypatch.setattr(run, "changed_text", lambda *said: f"{said[2]}")
    found = run._command(task, tmp_path / "out", draft, [])
    assert found[1:4] == [
        str(draft / "anna.yaml"), "--data-root", str(tmp_path),
    ]  # fmt: skip
    assert (draft / "anna.yaml").read_text() == "{'filter.cutoff_hz': 9.0}"
    assert "6.0" in study.read_text()


def test_long_names_of_variants_end_with_a_sum_of_theirs():
    short = {"filter.cutoff_hz": 6.0, "mass": 70}
    assert variant_name(short) == "filter.cutoff_hz=6,mass=70"
    long = {f"key{i}": "x" * 20 for i in range(6)}
    a, b = variant_name(long), variant_name(long | {"key5": "y" * 20})
    text = ",".join(f"{k}={v}" for k, v in long.items())
    assert a[:100] == text[:100] == b[:100]
    assert a[100] == "~" and len(a) == len(b) == 109 and a != b


def test_what_is_done_is_known_by_its_key(tmp_path):
    tasks = [replace(CALIBRATE, name=f"{n}/calibrate") for n in "abc"]
    for task in tasks[:2]:
        (tmp_path / task.name).mkdir(parents=True)
        found = outcome(task, 0, "", HOLDS)
        if task is tasks[1]:
            found = replace(found, key="another")
        write_json(tmp_path / task.name / run.TASK, found)
    done = run._done(tasks, tmp_path)
    assert list(done) == ["a/calibrate"] and done["a/calibrate"].is_solved
    own, other, none = (
        run._outcome(task, Ended(task.name, "lost", error="gone"), tmp_path)
        for task in tasks
    )
    assert own == done["a/calibrate"]
    for row in (other, none):
        assert row.code is None and row.sentence == "gone"
    assert run._outcome(tasks[2], None, tmp_path).verdict == "not done"


def test_a_folder_is_a_batchs_or_empty(tmp_path):
    out = tmp_path / "deep" / "out"
    with run._prepared(out, [CALIBRATE]):
        again = run._prepared(out, [CALIBRATE])
        with pytest.raises(InputError, match="another run is writing there"):
            again.__enter__()
    (mark,) = out.iterdir()
    assert json.loads(mark.read_text()) == {"anna/calibrate": "k" * 64}
    with run._prepared(out, [CALIBRATE]):
        pass
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    strange = run._prepared(tmp_path / "other", [CALIBRATE])
    with pytest.raises(InputError, match="holds something"), strange:
        pass


def test_the_last_line_of_a_log_is_told(tmp_path):
    log = tmp_path / "log"
    log.write_text("first\n last but one\n  the last one \n \n\n")
    assert run._last_line(log) == "the last one"
    log.write_text(" \n")
    assert run._last_line(log) == "it said nothing"


def died(monkeypatch, code, said=b"", attempt=3, memory_mb=None):
    """How a job ends whose process has, 4 s after it began."""
    worker = Worker(memory_mb)
    worker.since, worker.attempt = 10.0, attempt
    pipe = SimpleNamespace(close=lambda: None)
    worker._process = SimpleNamespace(
        stdin=pipe, stdout=pipe, wait=lambda: code
    )
    worker._said = io.BytesIO(said)
    monkeypatch.setattr(jobs.time, "monotonic", lambda: 14.0)
    begun = []
    monkeypatch.setattr(worker, "start", lambda *said: begun.append(said))
    job = Job("a", "m:f")
    ended = worker._died(job)
    assert worker._process is None
    # By the same worker, counted.
    assert begun == ([(job, attempt + 1)] if ended is None else [])
    return ended


def test_a_process_that_died_is_told_by_its_signal_or_code(monkeypatch):
    ended = died(monkeypatch, -signal.SIGKILL, b"so it was\n")
    assert (ended.state, ended.seconds, ended.attempts) == ("lost", 4.0, 3)
    assert "ended 3 times (SIGKILL);" in ended.error
    ended = died(monkeypatch, 7, b"one\ntwo\nthe end\n")
    assert "(code 7), saying 'the end';" in ended.error
    assert "saying" not in died(monkeypatch, 7).error
    assert died(monkeypatch, 7, attempt=2) is None  # tried again
    no_memory = b"what(): std::bad_alloc\n" + b"x" * 3000
    assert died(monkeypatch, 7, no_memory, 1, 100).state == "memory"
    # Further back than 4 kB nothing is looked for.
    assert died(monkeypatch, 7, no_memory + b"x" * 2000, 1, 100) is None
    assert died(monkeypatch, 7, no_memory, 1) is None


def test_a_pool_knows_for_how_long_its_jobs_run(monkeypatch):
    pool = jobs.Processes(3)
    monkeypatch.setattr(jobs.time, "monotonic", lambda: 25.0)
    for worker, since in zip(pool._workers[:2], (5.0, 22.5), strict=True):
        worker.job, worker.since = Job(f"j{since}", "m:f"), since
    assert pool.running() == {"j5.0": 20.0, "j22.5": 2.5}
    assert (pool.room(), pool.workers()) == (1, 3)


def test_a_job_that_was_begun_once_more_has_not_ended(monkeypatch):
    """One that has is handed over."""
    pool = jobs.Processes(2)
    lost, done = pool._workers
    for worker, row in ((lost, None), (done, Ended("b", "done"))):
        worker.job = Job("a" if row is None else "b", "m:f")
        monkeypatch.setattr(worker, "end", lambda row=row: row)
    monkeypatch.setattr(Worker, "pipe", property(id))
    monkeypatch.setattr(jobs, "wait_for", lambda pipes, seconds: pipes)
    assert pool.wait(0.1) == [Ended("b", "done")]


class Dask:
    """A scheduler that answers at a time, on a clock that tests turn."""

    def __init__(self, monkeypatch, answers_at):
        self.now, self.asked, self.answers_at = 100.0, [], answers_at
        monkeypatch.setattr(jobs.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(jobs.time, "sleep", self._sleep)
        pool = jobs.Cluster.__new__(jobs.Cluster)
        pool.address, pool._dask = (
            "tcp://a:1",
            SimpleNamespace(Client=self._ask),
        )
        self.pool = pool

    def _sleep(self, seconds):
        self.now += seconds

    def _ask(self, address, timeout, **_):
        self.asked.append(self.now - 100.0)
        if self.now < 100.0 + self.answers_at:
            self.now += timeout
            raise TimeoutError
        return "client"


def test_a_scheduler_has_a_minute_to_answer(monkeypatch):
    """Asked every five seconds and one of rest."""
    slow = Dask(monkeypatch, 50.0)
    assert slow.pool._connect() == "client"
    assert slow.asked == [0.0, 6.0, 12.0, 18.0, 24.0, 30.0, 36.0, 42.0, 48.0,
                          54.0]  # fmt: skip
    gone = Dask(monkeypatch, 500.0)
    with pytest.raises(InputError, match="tcp://a:1: does not answer"):
        gone.pool._connect()
    assert gone.now == 165.0  # the first answer after a minute is the last


def test_jobs_of_a_cluster_are_known_by_their_keys(monkeypatch):
    pool = jobs.Cluster.__new__(jobs.Cluster)
    pool._since = {"anna/x-y=1": 40.0, "berta/lab": 50.0}
    pool._client = SimpleNamespace(
        processing=lambda: {"w1": ("anna/x-y=1-123", "other-5"), "w2": ()},
        nthreads=lambda: {"w1": 2, "w2": 3},
    )
    monkeypatch.setattr(jobs.time, "monotonic", lambda: 47.5)
    assert pool.running() == {"anna/x-y=1": 7.5}
    assert pool.workers() == 5


def test_a_call_is_timed(monkeypatch):
    clock = iter([3.0, 8.0, 0.0, 0.0])
    monkeypatch.setattr(process_child.time, "perf_counter", lambda: next(clock))
    answer = process_child.call("math:sqrt", {})
    assert (answer["state"], answer["seconds"]) == ("failed", 5.0)
    assert answer["error"].startswith("TypeError")
    limits = []
    monkeypatch.setattr(
        "resource.setrlimit", lambda what, both: limits.append(both)
    )
    process_child.bound_memory(3)
    assert limits == [(3 * 1048576, 3 * 1048576)]


def test_memory_is_bound_on_linux_alone(monkeypatch, capsys):
    monkeypatch.setattr("sys.platform", "darwin")
    command = ["batch", "none.yaml", "--out", "none", "--memory", "100"]
    assert cli.main(command) == 2
    assert "--memory: only Linux bounds" in capsys.readouterr().err


def test_peaks_are_read_where_predictions_are(monkeypatch, tmp_path):
    """Each predicted trial once, as computed and as measured."""
    read = []

    def read_trial(folder, name, kind="solution"):
        read.append((folder, name, kind))
        return kind

    monkeypatch.setattr("drake_exo.calibration.results.read_trial", read_trial)
    peaks = {
        "solution": {("a", "N"): 3.0, ("of no mat", "N"): 5.0},
        "measured": {("a", "N"): 4.0},
    }
    monkeypatch.setattr(results, "_peaks", peaks.get)
    empty = dict.fromkeys(Row.__dataclass_fields__, "")

    def row(**values):
        return Row(**empty | values)

    rows = [
        row(phase="predict", trial="t", signal="rmsd.grf_n", folder="f"),
        row(phase="predict", trial="t", signal="rmsd.angles", folder="f"),
        row(phase="predict", trial="u", signal="objective", folder="f"),
        row(phase="foot-ground", trial="t", signal="rmsd.grf_n", folder="f"),
        row(phase="predict", trial="", signal="rmsd.grf_n", folder="f"),
    ]
    found = results.peak_rows(SimpleNamespace(out=tmp_path), rows)
    assert read == [(tmp_path / "f", "t", k) for k in ("solution", "measured")]
    assert [(r.signal, r.value, r.unit) for r in found] == [
        (results.PREDICTED + "a", 3.0, "N"),
        (results.MEASURED + "a", 4.0, "N"),
    ]
