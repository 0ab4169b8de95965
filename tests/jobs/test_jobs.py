"""Jobs in processes: order, failures, killed processes, memory."""

import errno
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import types

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.jobs.engine import (
    ATTEMPTS,
    BatchProgress,
    Ended,
    Heard,
    Here,
    Job,
    Processes,
    logged,
    run_jobs,
)

HERE = "example_jobs:"


def job(name, function, *needs, **arguments):
    return Job(name, HERE + function, arguments, needs)


@pytest.fixture(scope="module")
def pool():
    with Processes(2) as pool:
        yield pool


class Recorded:
    """A pool that does nothing, one at a time."""

    def __init__(self):
        self.begun, self.now = [], None

    def room(self):
        return int(self.now is None)

    def start(self, job):
        self.begun.append(job.name)
        self.now = job.name

    def wait(self, seconds):
        name, self.now = self.now, None
        if "bad" in name:
            return [Ended(name, "failed", 1, "torn")]
        return [Ended(name, "done", 1)]

    def running(self):
        return {self.now: 5.0} if self.now else {}

    def workers(self):
        return 1


def test_in_the_order_given_and_needs_before():
    jobs = [
        Job("alone", ""),
        Job("c", "", needs=("b",)),
        Job("b", "", needs=("a",)),
        Job("a", ""),
    ]
    pool = Recorded()
    ended = run_jobs(jobs, pool)
    assert pool.begun == ["alone", "a", "b", "c"]
    assert list(ended) == [j.name for j in jobs]


def test_what_needs_a_failure_is_skipped_and_the_rest_goes_on():
    jobs = [
        Job("bad", ""),
        Job("next", "", needs=("bad",)),
        Job("last", "", needs=("next",)),
        Job("other", ""),
    ]
    pool, told = Recorded(), []
    ended = run_jobs(jobs, pool, told.append)
    assert pool.begun == ["bad", "other"]
    assert [ended[n].state for n in ended] == [
        *("failed", "skipped", "skipped", "done"),
    ]
    assert "bad was not done" in ended["next"].error
    assert ended["next"].cause == ended["last"].cause == "torn"
    assert {row.name for row in told} == set(ended)


def test_what_needs_a_failure_of_an_earlier_run_is_skipped():
    jobs = [
        Job("b", "", needs=("a",)),
        Job("c", "", needs=("b", "d")),
        Job("e", "", needs=("d",)),
    ]
    before = {"a": Ended("a", "failed"), "d": Ended("d", "done")}
    pool = Recorded()
    ended = run_jobs(jobs, pool, before=before)
    assert pool.begun == ["e"]
    assert [(r.name, r.state, r.error) for r in ended.values()] == [
        ("b", "skipped", "not begun: a was not done"),
        ("c", "skipped", "not begun: b was not done"),
        ("e", "done", ""),
    ]


def sums():
    """Two, then their total, then its triple."""
    jobs = [job(name, "add", a=1, b=b) for name, b in (("x", 2), ("y", 3))]
    jobs.append(Job("t", HERE + "total", {}, ("x", "y"), given="values"))
    return [
        *jobs,
        Job("u", HERE + "total", {}, ("t", "x", "y"), given="values"),
    ]


def test_a_job_is_given_what_those_before_it_returned():
    """In the order in which it names them; others get nothing more."""
    said = []
    plain, further = sums()[:2], [j.told(say=said.append) for j in sums()[2:]]
    with Here() as pool:
        ended = run_jobs(plain + further, pool)
    assert [row.value for row in ended.values()] == [3, 4, 7, 14]
    assert said == ["2 values", "of x, y", "3 values", "of t, x, y"]
    assert {row.state for row in ended.values()} == {"done"}


def test_here_a_failure_is_raised():
    with pytest.raises(KeyError, match="ours"), Here() as pool:
        run_jobs([job("broken", "fail"), job("next", "add")], pool)


def test_what_jobs_say_last_is_heard_once(tmp_path):
    first, second = logged([Job("a", "", {"b": 1}), Job("c", "")], tmp_path)
    assert first.log != second.log and first.arguments["b"] == 1
    said = []
    heard = Heard(said.append)
    heard.update({}, None, [first, second, Job("silent", "")])
    assert said == []
    for line in ("one", "two"):
        pickle.loads(pickle.dumps(first.arguments["say"]))(line)
    second.arguments["say"]("three")
    for _ in range(2):
        heard.update({}, None, [first, second])
    assert said == ["three", "two"]
    second.arguments["say"]("four")
    heard.update({}, None, [first, second])
    assert said[2:] == ["four"]
    for word in ("five", "six"):
        first.arguments["say"](word)
        second.arguments["say"](word + "ty")
        heard.update({}, None, [first, second])
    assert said[3:] == ["five", "fivety", "sixty", "six"]


def test_what_a_job_came_to():
    assert Ended("a", "done", 3).result() == 3
    with pytest.raises(InputError, match="wrong; mend it"):
        Ended("a", "failed", error="wrong; mend it").result()
    for state, trace, error in (
        ("failed", "in fail", RuntimeError),
        ("skipped", "", RuntimeError),
        ("lost", "", InputError),  # a command says so in a sentence
        ("memory", "", InputError),
    ):
        with pytest.raises(error, match="a: no end"):
            Ended("a", state, error="no end", trace=trace).result()


def test_a_full_disk_is_told_as_it_would_be_here():
    """A command has a sentence for it."""
    with Processes(1) as pool:
        ended = run_jobs([job("a", "overfill")], pool)["a"]
    assert ended.state == "failed" and "overfill" in ended.trace
    with pytest.raises(OSError, match="No space left") as found:
        ended.result()
    assert found.value.errno == errno.ENOSPC
    assert found.value.filename == "a.csv"


def test_no_processes_are_refused():
    with pytest.raises(InputError, match="0 processes do no work"):
        Processes(0)


@pytest.mark.slow
def test_values_are_given_to_other_processes(pool, tmp_path):
    plain, said = sums()[:2], []
    ended = run_jobs(
        plain + logged(sums()[2:], tmp_path), pool, None, Heard(said.append)
    )
    assert [row.value for row in ended.values()] == [3, 4, 7, 14]
    assert said == ["of x, y", "of t, x, y"]


@pytest.mark.slow
def test_values_and_failures(pool):
    jobs = [
        job("sum", "add", a=1, b=2),
        job("refused", "refuse"),
        job("broken", "fail"),
        job("print", "spoil_streams"),
        job("absent", "no_such_function"),
    ]
    ended = run_jobs(jobs, pool)
    assert ended["sum"].value == 3 and ended["sum"].state == "done"
    assert ended["refused"].error == "a.yaml: wrong; mend it"
    assert not ended["refused"].trace
    assert ended["broken"].error == "KeyError: 'ours'"
    assert "in fail" in ended["broken"].trace
    assert ended["print"].value == "answered"
    assert "AttributeError" in ended["absent"].error


@pytest.mark.slow
def test_a_process_serves_many_jobs(pool):
    jobs = [job(str(k), "process") for k in range(10)]
    found = {row.value for row in run_jobs(jobs, pool).values()}
    assert len(found) <= 2 and os.getpid() not in found


@pytest.mark.slow
def test_a_killed_process_loses_its_job_alone(pool, tmp_path):
    jobs = [
        job("once", "die_until", place=str(tmp_path / "a"), times=1),
        job("ever", "die_until", place=str(tmp_path / "b"), times=99),
        job("sum", "add", a=1, b=2),
    ]
    ended = run_jobs(jobs, pool)
    assert ended["once"].state == "done" and ended["once"].attempts == 2
    assert ended["sum"].value == 3
    assert ended["ever"].state == "lost"
    assert ended["ever"].attempts == ATTEMPTS
    assert "SIGKILL" in ended["ever"].error
    assert ended["ever"].error.endswith("use fewer workers")
    with Processes(1, memory_mb=2000) as bounded:
        ended = run_jobs(jobs[1:2], bounded)
    assert ended["ever"].error.endswith("or allow more --memory")


@pytest.mark.slow
def test_killed_from_outside(pool):
    def kill():
        time.sleep(0.3)
        victim = next(w for w in pool._workers if w.job)
        victim._process.send_signal(signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    ended = run_jobs([job("nap", "sleep", seconds=1.0)], pool)
    thread.join()
    assert ended["nap"].state == "done" and ended["nap"].attempts == 2


@pytest.mark.slow
def test_an_idle_process_that_was_killed_is_made_anew():
    """What nobody took is still in its pipe."""
    with Processes(1) as pool:
        first = run_jobs([job("a", "add", a=1, b=2)], pool)
        assert first["a"].value == 3
        process = pool._workers[0]._process
        process.kill()
        process.wait()
        ended = run_jobs([job("b", "add", a=2, b=2)], pool)
    assert ended["b"].value == 4


@pytest.mark.slow
def test_arguments_that_cannot_be_read_there_are_told():
    module = types.ModuleType("only_here")
    module.Thing = type("Thing", (), {"__module__": "only_here"})
    sys.modules["only_here"] = module
    try:
        with Processes(1) as pool:
            strange = [job("a", "add", a=module.Thing(), b=2)]
            ended = run_jobs(strange, pool)["a"]
    finally:
        del sys.modules["only_here"]
    assert ended.state == "lost" and "only_here" in ended.error


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the bound is Linux's")
def test_memory_is_bounded_and_the_job_named():
    jobs = [
        job("large", "fill", megabytes=900),
        job("small", "fill", megabytes=50),
        job("inside", "abort"),
        job("threads", "abort", saying="can't start new thread"),
    ]
    with Processes(1, memory_mb=600) as pool:
        ended = run_jobs(jobs, pool)
    assert ended["small"].value == 50
    for name in ("large", "inside", "threads"):
        assert ended[name].state == "memory"
        assert "600 MB" in ended[name].error


@pytest.mark.parametrize("how", ["exhaust", "find_no_room"])
def test_memory_that_nobody_bounded_may_be_short(how):
    with Processes(1) as pool:
        ended = run_jobs([job("a", how)], pool)["a"]
    assert ended.state == "memory"
    assert ended.error.startswith("needs more memory than there is")
    with pytest.raises(InputError, match="a: needs more memory"):
        ended.result()


@pytest.mark.slow
def test_a_worker_ends_with_its_master():
    script = (
        "import sys, time\n"
        "from drake_exo.jobs.engine import Job\n"
        "from drake_exo.jobs.engine import Worker\n"
        "w = Worker()\n"
        "w.start(Job('nap', 'example_jobs:sleep', {'seconds': 60}))\n"
        "print(w._process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    master = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, env=env
    )
    child = int(master.stdout.readline())
    time.sleep(0.5)
    os.kill(child, 0)
    master.kill()
    master.wait()
    master.stdout.close()
    for _ in range(100):
        if not alive(child):
            return
        time.sleep(0.1)
    pytest.fail("the worker goes on without its master")


def alive(pid) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().split()[2] != "Z"
    except FileNotFoundError:
        return False


def test_progress_counts_and_estimates(tmp_path, monkeypatch, capsys):
    log = tmp_path / "log.txt"
    log.write_text("first\niteration 7\n")
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    say = BatchProgress("batch")
    jobs = [Job(f"s{k}/check", "", log=str(log)) for k in range(4)]
    ended = {
        "s0/check": Ended("s0/check", "done", seconds=60.0),
        "s1/check": Ended("s1/check", "failed"),
    }
    pool = Recorded()
    pool.now = "s2/check"
    now[0] = 29.0
    say.update(ended, pool, jobs)
    assert not capsys.readouterr().out
    now[0] = 31.0
    say.update(ended, pool, jobs)
    first, line = capsys.readouterr().out.splitlines()
    assert "2/4 done, 1 failed, 1 running, about 1 min 55 s left" in first
    assert line == "  s2/check, 5 s: iteration 7"
    # A job that is overdue does not end in no time.
    ended["s3/check"] = Ended("s3/check", "done", seconds=0.1)
    ended["s0/check"] = ended["s3/check"]
    now[0] = 62.0
    say.update(ended, pool, jobs)
    first, _ = capsys.readouterr().out.splitlines()
    assert first == "batch: 3/4 done, 1 failed, 1 running (62 s)"


class Clocked:
    """A pool of two whose jobs take as long as they are said to."""

    def __init__(self, seconds):
        self.seconds, self.ends, self.now = seconds, {}, 0.0

    def room(self):
        return 2 - len(self.ends)

    def start(self, job):
        self.ends[job.name] = self.now + self.seconds[job.name]

    def wait(self, seconds):
        name = min(self.ends, key=self.ends.get)
        self.now = self.ends.pop(name)
        return [Ended(name, "done", 1)]


def test_two_workers_wait_for_nothing():
    """Forty chains of three: within a tenth of the sum of times over two."""
    rng = np.random.default_rng(0)
    jobs, seconds = [], {}
    for k in range(40):
        before = ()
        for step, mean in (("lab", 0.1), ("calibrate", 0.2), ("predict", 0.1)):
            name = f"{k}/{step}"
            seconds[name] = mean * rng.uniform(0.5, 1.5)
            jobs.append(Job(name, "", needs=before))
            before = (name,)
    pool = Clocked(seconds)
    run_jobs(jobs, pool)
    assert pool.now <= 1.1 * sum(seconds.values()) / 2
