"""`drake-exo batch` as a user runs it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from small_step import stage, write_case, write_step

from drake_exo.batch import run
from drake_exo.batch.file import BatchFile, changed_text, tasks_of
from drake_exo.batch.run import TIMING
from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.files import schema

pytestmark = pytest.mark.slow

LABORATORY = """
steps: [calibrate]
laboratories: {seeds: [1, 2], trials: 1, without: [all]}
sweep: {foot_ground.solver.nodes_per_second: [40]}
options:
  calibrate: [--phase, foot-ground, --no-front, --accept, all]
"""
CHECKS = """
steps: [check]
studies: ['s*/study.yaml']
options: {check: [--accept, all]}
"""


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every result, but for times."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != TIMING
    }


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A finished batch of two simulated subjects, by one worker."""
    folder = tmp_path_factory.mktemp("batch")
    path = write(folder / "batch.yaml", LABORATORY)
    out = folder / "one"
    assert main(["batch", str(path), "--out", str(out), "--workers", "1"]) == 0
    return path, out


def test_results_of_every_task(laboratory):
    _, out = laboratory
    place = out / "seed_2" / "foot_ground.solver.nodes_per_second=40"
    assert (out / "seed_2" / "lab" / "study.yaml").is_file()
    summary = json.loads((place / "calibrate" / "summary.json").read_text())
    assert summary["success"] and "solve_seconds" not in summary
    assert summary["settings"]["solver"]["nodes_per_second"] == 40
    timing = json.loads((place / "calibrate" / TIMING).read_text())
    assert timing["files"]["summary.json"]["solve_seconds"] > 0.0
    assert any("parameter" in line for line in timing["log"])
    assert not (out / ".drafts").exists()


def test_nothing_is_done_twice(laboratory, capsys):
    path, out = laboratory
    before = contents(out)
    assert main(["batch", str(path), "--out", str(out)]) == 0
    assert "4 of 4 tasks hold, 0 run now" in capsys.readouterr().out
    assert {"results.csv", "report.html", "summary.json"} <= set(before)
    assert contents(out) == before


def test_same_bytes_by_two_workers_one_of_them_killed(laboratory, tmp_path):
    path, out = laboratory
    again = tmp_path / "two"
    batch = subprocess.Popen(
        [
            *(sys.executable, "-m", "drake_exo.cli", "batch", str(path)),
            *("--out", str(again), "--workers", "2"),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    kills = 0
    while batch.poll() is None:
        if kills < 3 and (again / ".drafts").is_dir():
            kills += kill_a_worker(batch.pid)
        time.sleep(0.7)
    said = batch.communicate()[0]
    assert batch.returncode == 0, said
    assert kills == 3
    one, two = contents(out), contents(again)
    assert set(one) == set(two)
    assert [name for name in one if one[name] != two[name]] == []


def kill_a_worker(master: int) -> int:
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(place.read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if parent == master:
            os.kill(int(place.parent.name), signal.SIGKILL)
            return 1
    return 0


def test_seven_are_broken_in_seven_ways(laboratory, tmp_path, capsys):
    """Of eight small studies; the other goes on, each is told."""
    _, out = laboratory
    sound = out / "seed_1" / "lab"
    for k in range(8):
        shutil.copytree(sound, tmp_path / f"s{k}")

    def edit(k, old, new):
        path = tmp_path / f"s{k}" / "study.yaml"
        text = path.read_text("utf-8")
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    movement = next((tmp_path / "s0").glob("passive*.c3d")).name
    edit(0, "subject:", "subject")
    edit(1, "mass_kg:", "mass_lb:")
    edit(2, "height_m: 1", "height_m: -1")
    (tmp_path / "s3" / movement).unlink()
    whole = (tmp_path / "s4" / movement).read_bytes()
    (tmp_path / "s4" / movement).write_bytes(whole[: len(whole) // 2])
    (tmp_path / "s5" / "study.yaml").write_bytes(b"\xff\xfe\x00")
    edit(6, "end_s:", "end_s: -9 #")
    checks = CHECKS.replace("all]", "all, --accept, audti]")
    path = write(tmp_path / "batch.yaml", checks)
    to = tmp_path / "out"
    assert main(["batch", str(path), "--out", str(to)]) == 3
    said = capsys.readouterr().out
    assert "note: options of check: --accept audti: no check" in said
    assert "1 of 8 tasks hold, 8 run now" in said
    lines = [line for line in said.splitlines() if "/check: failed: " in line]
    assert len(lines) == 7
    assert len({line.partition("failed: ")[2] for line in lines}) == 7
    assert str(tmp_path) not in "".join(lines)
    for k in range(7):
        found = json.loads((to / f"s{k}" / "check" / "task.json").read_text())
        assert found["code"] == 2 and found["sentence"]
    assert (to / "s7" / "check" / "quality.json").is_file()
    # Mended, it alone is run again.
    edit(1, "mass_lb:", "mass_kg:")
    assert main(["batch", str(path), "--out", str(to)]) == 3
    assert "2 of 8 tasks hold, 1 run now" in capsys.readouterr().out


def test_soles_too(tmp_path, capsys):
    write_case(tmp_path / "brick.yaml", stages=[stage(4, 5e-5, 4)])
    write_step(tmp_path / "load.csv", 8)
    path = write(
        tmp_path / "batch.yaml",
        "steps: [sole simulate]\ncases: [brick.yaml]\n"
        "sweep: {contact.friction: [0.5, 0.8]}",
    )
    out = tmp_path / "out"
    assert main(["batch", str(path), "--out", str(out)]) == 0
    assert "2 of 2 tasks hold" in capsys.readouterr().out
    rows = [
        json.loads(p.read_text())
        for p in out.rglob("sole_simulate/summary.json")
    ]
    assert len(rows) == 2 and rows[0] != rows[1]


def test_a_bad_batch_file_ends_with_two(tmp_path, capsys):
    path = write(tmp_path / "batch.yaml", "steps: [check]\nstudies: [no.yaml]")
    out = tmp_path / "out"
    assert main(["batch", str(path), "--out", str(out)]) == 2
    assert "batch.yaml: studies: no.yaml finds no file" in (
        capsys.readouterr().err
    )
    assert not out.exists()
    write(
        path,
        "steps: [check]\nlaboratories: {seeds: [1]}\n"
        "sweep: {fitler.order: [2]}",
    )
    assert main(["batch", str(path), "--out", str(out)]) == 2
    assert "did you mean 'filter'" in capsys.readouterr().err
    assert not out.exists()
    # A place that no file has, too; what one of two has is that file's affair.
    study = Path(__file__).parents[1] / "studies" / "opencap_sts1.yaml"
    for name in ("a", "b"):
        shutil.copy(study, tmp_path / f"{name}.yaml")
    # A cuff of another device that no file names, too.
    key = "interaction.cuffs.low.normal_n_m.nominal"
    write(
        path,
        f"steps: [check]\nstudies: [a.yaml, b.yaml]\nsweep: {{{key}: [5000]}}",
    )
    assert main(["batch", str(path), "--out", str(out)]) == 2
    told = f"a.yaml: has no key {key!r} to sweep: 'low' is unknown; give it in"
    assert told in capsys.readouterr().err
    assert not out.exists()
    write(
        path,
        "steps: [check]\nstudies: [a.yaml, b.yaml]\n"
        "sweep: {trials.3.use: [prediction]}",
    )
    assert main(["batch", str(path), "--out", str(out)]) == 2
    assert (
        "a.yaml: has no key 'trials.3.use' to sweep: '3' is unknown; the list "
        "has 3 elements, the first is 0" in capsys.readouterr().err
    )
    assert not out.exists()
    text = study.read_text("utf-8")
    more = "  - {name: a, markers: a.trc, forces: a.mot, plates: {both: 1}}\n"
    write(tmp_path / "b.yaml", text.replace("trials:\n", f"trials:\n{more}"))
    assert main(["batch", str(path), "--out", str(out), "--workers", "1"]) == 3
    assert "a/trials.3.use=prediction/check: failed" in capsys.readouterr().out
    (tmp_path / "other").mkdir()
    write(tmp_path / "other" / "mine.txt", "")
    write(path, "steps: [check]\nlaboratories: {seeds: [1]}")
    assert main(["batch", str(path), "--out", str(tmp_path / "other")]) == 2
    assert "is not a batch" in capsys.readouterr().err


def test_what_no_task_could_use_is_told_once(tmp_path, capsys):
    study = Path(__file__).parents[1] / "studies" / "opencap_sts1.yaml"
    shutil.copy(study, tmp_path / "a.yaml")
    path, out = tmp_path / "batch.yaml", tmp_path / "out"

    def refused(text):
        write(path, f"studies: [a.yaml]\n{text}")
        assert main(["batch", str(path), "--out", str(out)]) == 2
        assert not out.exists()
        return capsys.readouterr().err

    said = refused(
        "steps: [calibrate, predict]\noptions: {predict: [--design, best]}"
    )
    assert (
        "batch.yaml: options of predict: best: cannot be read (No such file or "
        "directory); check the path" in said
    )
    key = "foot_ground.constants.stickiness"
    said = refused(f"steps: [check]\nsweep: {{{key}: [1]}}")
    assert "the law 'simbody' has no 'stickiness'; it has static_" in said
    said = refused("steps: [check]\nsweep: {filter.order: [2, x]}")
    assert "filter.order must be a whole number, but is 'x'" in said


def test_a_file_is_read_once_for_all_of_its_values(tmp_path, monkeypatch):
    """Each of many keys has a value of its own in every combination."""
    study = Path(__file__).parents[1] / "studies" / "opencap_sts1.yaml"
    shutil.copy(study, tmp_path / "a.yaml")
    cutoffs, orders = [5.0, 6.0, 7.0], [2, 4, -4]
    sweep = [
        {"filter.cutoff_hz": hz, "filter.order": n}
        for hz, n in zip(cutoffs, orders, strict=True)
    ]
    path = tmp_path / "batch.yaml"
    text = {"steps": ["check"], "studies": ["a.yaml"], "sweep": sweep}
    write(path, json.dumps(text))
    read = []

    def counted(path, cls, changes, root):
        read.append(changes)
        return changed_text(path, cls, changes, root)

    monkeypatch.setattr(run, "changed_text", counted)
    tasks = tasks_of(schema.load(path, BatchFile), tmp_path)
    with pytest.raises(InputError, match=r"filter\.order"):
        run._check_values(tasks)
    assert read == sweep
    # Of a good value in a bad combination, another one may be found good.
    sound = replace(tasks[0], variant="x", changes={"filter.cutoff_hz": 7.0})
    with pytest.raises(InputError, match=r"filter\.order"):
        run._check_values([*tasks, sound])
    run._check_values(tasks[:2])


_FULL = """
import resource, sys
from drake_exo import cli

limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(cli.main(sys.argv[2:]))
"""


def test_a_full_disk_is_told_and_the_batch_goes_on_later(laboratory, tmp_path):
    path, out = laboratory
    to = tmp_path / "out"
    shutil.copytree(out / "seed_1" / "lab", tmp_path / "s1")
    path = write(tmp_path / "batch.yaml", CHECKS)
    command = ["batch", str(path), "--out", str(to)]
    done = subprocess.run(
        [sys.executable, "-c", _FULL, "20000", *command],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 3, done.stderr
    assert "cannot be written (File too large)" in done.stdout
    assert not (to / "s1" / "check").exists()
    assert main(command) == 0


def test_stopped_by_ctrl_c_and_gone_on(laboratory, tmp_path):
    path, _ = laboratory
    to = tmp_path / "out"
    command = ["batch", str(path), "--out", str(to), "--workers", "1"]
    batch = subprocess.Popen(
        [sys.executable, "-m", "drake_exo.cli", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    while not (to / "seed_1" / "lab" / "task.json").is_file():
        assert batch.poll() is None
        time.sleep(0.1)
    batch.send_signal(signal.SIGINT)
    said = batch.communicate()[0]
    assert batch.returncode == 130
    assert "Traceback" not in said
    assert "seed_2/lab: not done: stopped by the user" in said
    assert "stopped by the user" in (to / "results.csv").read_text("utf-8")
    assert "task.json" in os.listdir(to / "seed_1" / "lab")
