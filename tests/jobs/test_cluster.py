"""Jobs on a Dask cluster: a scheduler and workers in processes over TCP."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from drake_exo.errors import InputError
from drake_exo.jobs.engine import Cluster, Job, run_jobs

pytestmark = pytest.mark.slow
HERE = "example_jobs:"


def test_without_dask_a_sentence_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"drake_exo\[batch\]"):
        Cluster("tcp://127.0.0.1:1")


class Machines:
    """A scheduler and workers on this machine, to be killed."""

    def __init__(self, folder, environment=(), protocol="tcp"):
        self.env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        self.env |= dict(environment)
        self.file = folder / "scheduler.json"
        self.log = (folder / "log.txt").open("wb")
        self.processes = []
        self.protocol = protocol
        self.port = "0"
        self.start_scheduler()

    def start(self, *command):
        process = subprocess.Popen(
            [sys.executable, "-m", *command],
            env=self.env,
            stdout=self.log,
            stderr=self.log,
            start_new_session=True,
        )
        self.processes.append(process)
        return process

    def start_scheduler(self):
        self.file.unlink(missing_ok=True)
        self.scheduler = self.start(
            *("distributed.cli.dask_scheduler", "--no-dashboard"),
            *("--host", "127.0.0.1", "--port", self.port),
            *("--protocol", self.protocol),
            *("--scheduler-file", str(self.file)),
        )
        for _ in range(600):
            if self.file.is_file() and self.file.stat().st_size:
                break
            time.sleep(0.1)
        self.address = json.loads(self.file.read_text())["address"]
        self.port = self.address.rpartition(":")[2]

    def start_worker(self):
        return self.start(
            *("distributed.cli.dask_worker", self.address, "--no-nanny"),
            *("--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"),
        )

    def close(self):
        for process in self.processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self.log.close()


@pytest.fixture
def machines(tmp_path):
    pytest.importorskip("distributed", reason="dask.distributed is absent")
    found = Machines(tmp_path)
    yield found
    found.close()


def naps(count, seconds):
    return [
        Job(f"n{k}", HERE + "sleep", {"seconds": seconds}) for k in range(count)
    ]


def after(seconds, function):
    timer = threading.Timer(seconds, function)
    timer.start()
    return timer


def test_a_killed_worker_loses_nothing(machines):
    workers = [machines.start_worker() for _ in range(3)]
    jobs = [*naps(12, 0.7), Job("bad", HERE + "refuse")]
    jobs.append(Job("next", HERE + "add", {"a": 1, "b": 2}, ("n0", "n1")))
    with Cluster(machines.address) as cluster:
        while cluster.workers() < 3:
            time.sleep(0.2)
        timer = after(1.5, workers[0].kill)
        ended = run_jobs(jobs, cluster)
        timer.join()
    assert [ended[j.name].state for j in jobs] == [
        *["done"] * 12,
        "failed",
        "done",
    ]
    assert ended["next"].value == 3
    assert ended["bad"].error == "a.yaml: wrong; mend it"


def test_a_scheduler_that_starts_again_loses_nothing(machines):
    machines.start_worker()
    with Cluster(machines.address) as cluster:

        def restart():
            os.killpg(machines.scheduler.pid, signal.SIGKILL)
            machines.start_scheduler()
            machines.start_worker()

        timer = after(1.0, restart)
        ended = run_jobs(naps(6, 0.5), cluster)
        timer.join()
    assert all(row.state == "done" for row in ended.values())


def test_encrypted(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="dask.distributed is absent")
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    made = subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes"),
            *("-keyout", str(key), "-out", str(certificate), "-days", "2"),
            *("-subj", "/CN=127.0.0.1"),
            *("-addext", "subjectAltName=IP:127.0.0.1"),
        ],
        capture_output=True,
    )
    if made.returncode:
        pytest.skip("no openssl on this machine")
    import dask

    ours = {
        "distributed.comm.tls.ca-file": str(certificate),
        "distributed.comm.tls.client.cert": str(certificate),
        "distributed.comm.tls.client.key": str(key),
    }
    setting = "DASK_DISTRIBUTED__COMM__TLS__"
    env = {setting + "CA_FILE": str(certificate)}
    for who in ("CLIENT", "SCHEDULER", "WORKER"):
        env[f"{setting}{who}__CERT"] = str(certificate)
        env[f"{setting}{who}__KEY"] = str(key)
    machines = Machines(tmp_path, env, "tls")
    try:
        workers = [machines.start_worker() for _ in range(3)]
        assert machines.address.startswith("tls://")
        with (
            dask.config.set(ours),
            Cluster(machines.address) as cluster,
        ):
            timer = after(2.0, workers[1].kill)
            ended = run_jobs(naps(12, 0.7), cluster)
            timer.join()
        assert all(row.state == "done" for row in ended.values())
    finally:
        machines.close()


def test_nobody_answers(monkeypatch):
    pytest.importorskip("distributed", reason="dask.distributed is absent")
    from drake_exo.jobs import engine

    monkeypatch.setattr(engine, "_CONNECT_SECONDS", 0.0)
    with pytest.raises(InputError, match="does not answer"):
        Cluster("tcp://127.0.0.1:9")


def test_an_answer_that_dies_with_the_scheduler_is_asked_for_again():
    def gone():
        raise OSError("the connection is closed")  # as CommClosedError

    class Lost:
        cancelled = exception = staticmethod(lambda: None)
        result = staticmethod(gone)

    lost = Lost()
    pool, job, again = object.__new__(Cluster), naps(1, 0.1)[0], []
    pool._client = SimpleNamespace(status="running")
    pool._done, pool._futures = queue.Queue(), {lost: job.name}
    pool._jobs, pool._since = {job.name: job}, {job.name: 0.0}
    pool._submit = again.append
    pool._done.put(lost)
    assert pool.wait(1.0) == []
    assert again == [job] and pool._jobs == {job.name: job}
