import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files import output
from drake_exo.files.opensim import write_table, write_trc
from drake_exo.files.output import (
    LOCK,
    MANIFEST,
    Progress,
    checksum,
    prepare_output_folder,
    read_arrays,
    write_csv,
    write_json,
)
from drake_exo.files.tables import MarkerData, Table, write_csv_table


def test_fresh_folder_is_written_in_place(tmp_path):
    target = tmp_path / "a" / "b"
    with prepare_output_folder(target) as folder:
        assert folder == target
        (folder / "x.txt").write_text("1")
        assert (target / "x.txt").exists()


def test_occupied_folder_is_refused(tmp_path):
    (tmp_path / "old.txt").write_text("old")
    with pytest.raises(InputError, match=r"already holds results.*--force$"):
        prepare_output_folder(tmp_path)
    assert (tmp_path / "old.txt").read_text() == "old"
    # As a run leaves it that was killed.
    (tmp_path / "unfinished_rise1").mkdir()
    (tmp_path / "unfinished_rise1" / "checkpoint.npz").write_text("")
    with pytest.raises(InputError, match=r"--force, or .* with --resume$"):
        prepare_output_folder(tmp_path, resume=False)
    with pytest.raises(InputError, match=r"replace them with --force$"):
        prepare_output_folder(tmp_path)


def test_file_in_place_of_folder_is_refused(tmp_path):
    (tmp_path / "f").write_text("")
    with pytest.raises(InputError, match="is a file"):
        prepare_output_folder(tmp_path / "f", force=True)


def test_force_replaces_old_results_only_at_the_end(tmp_path):
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
        (folder / "two.txt").write_text("old")
    (target / "mine.txt").write_text("not a result")
    with prepare_output_folder(target, force=True) as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "three.txt").write_text("new")
        (folder / "one.txt").write_text("new")
        assert (target / "one.txt").read_text() == "old"
    assert (target / "one.txt").read_text() == "new"
    assert (target / "sub" / "three.txt").read_text() == "new"
    assert not (target / "two.txt").exists()
    assert (target / "mine.txt").read_text() == "not a result"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_failing_run_keeps_old_results(tmp_path):
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    with (
        pytest.raises(KeyboardInterrupt),
        prepare_output_folder(target, force=True) as folder,
    ):
        (folder / "one.txt").write_text("best so far")
        raise KeyboardInterrupt
    assert (target / "one.txt").read_text() == "old"
    assert (tmp_path / "out.partial/one.txt").read_text() == "best so far"


def test_interrupted_first_run_leaves_its_best(tmp_path):
    target = tmp_path / "out"
    with (
        pytest.raises(KeyboardInterrupt),
        prepare_output_folder(target) as folder,
    ):
        (folder / "one.txt").write_text("best so far")
        raise KeyboardInterrupt
    assert (target / "one.txt").read_text() == "best so far"
    with prepare_output_folder(target, force=True) as folder:
        (folder / "two.txt").write_text("new")
    assert not (target / "one.txt").exists()


def test_json_is_plain_and_stable(tmp_path):
    @dataclass(frozen=True)
    class Item:
        path: Path
        value: float

    obj = {
        "b": np.arange(3),
        "a": [np.float64(0.1), np.nan, np.inf, (1, True, None)],
        "c": Item(Path("x/y"), 2.0),
        "d": {"z", "y"},
        3: np.bool_(True),
    }
    path = tmp_path / "s.json"
    write_json(path, obj)
    first = path.read_bytes()
    write_json(path, dict(reversed(obj.items())))
    assert path.read_bytes() == first
    assert json.loads(first) == {
        "3": True,
        "a": [0.1, None, None, [1, True, None]],
        "b": [0, 1, 2],
        "c": {"path": "x/y", "value": 2.0},
        "d": ["y", "z"],
    }
    assert [p.name for p in tmp_path.iterdir()] == ["s.json"]


def test_nothing_is_written_as_minus_zero(tmp_path):
    names, nothing = ("a", "b"), np.array([[-0.0, 0.0], [0.0, -0.0]])
    table = Table(np.array([-0.0, 0.5]), names, nothing, in_degrees=False)
    write_json(tmp_path / "a.json", {"lag": -0.0, "more": [nothing]})
    write_csv(tmp_path / "b.csv", {"x": [-0.0], "word": ["-0"]})
    write_csv_table(tmp_path / "c.csv", table, ["n", "deg"])
    write_table(tmp_path / "d.sto", table)
    points = nothing[:, :, None] * np.ones(3)
    markers = MarkerData(np.array([0.0, 0.5]), names, points, 2.0)
    write_trc(tmp_path / "e.trc", markers)
    for path in tmp_path.iterdir():
        cells = re.split(r"[\s,:]+", path.read_text())
        assert ("-0" in cells) == (path.name == "b.csv"), path.name
        assert "-0.0" not in cells, path.name


def test_progress_prints_at_most_one_line_per_interval(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(output.time, "monotonic", lambda: now[0])
    progress = Progress("IK", 100)
    for i in range(100):
        now[0] += 0.02
        progress.update("rms 1 mm", done=i + 1)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0] == "IK: 25/100, rms 1 mm (0.5 s)"


def test_progress_is_silent_for_short_jobs(capsys):
    Progress("quick").update("x")
    assert capsys.readouterr().out == ""


def test_progress_goes_to_stdout(capsys):
    progress = Progress("slow", interval_seconds=0.0)
    progress.update("iteration 3", done=3)
    assert capsys.readouterr().out.startswith("slow: 3, iteration 3 (")


def test_a_manifest_removes_nothing_outside_its_folder(tmp_path):
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept.txt").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / "linked").symlink_to(elsewhere)
    (out / "old.txt").write_text("ours")
    names = ["../victim.txt", str(victim), "linked/kept.txt", "old.txt"]
    (out / MANIFEST).write_text("\n".join(names))
    with prepare_output_folder(out, force=True) as folder:
        (folder / "new.txt").write_text("new")
    assert victim.read_text() == "mine"
    assert (elsewhere / "kept.txt").read_text() == "mine"
    assert not (out / "old.txt").exists()


def test_the_working_folder_can_be_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.txt").write_text("ours")
    with prepare_output_folder(".", force=True) as folder:
        (folder / "new.txt").write_text("new")
    assert (tmp_path / "new.txt").read_text() == "new"
    assert not tmp_path.with_name(tmp_path.name + ".partial").exists()


def test_a_second_run_into_a_folder_is_refused(tmp_path):
    out = tmp_path / "out"
    with prepare_output_folder(out) as folder:
        for options in ({}, {"force": True}, {"resume": True}):
            with pytest.raises(InputError, match="another run is writing"):
                prepare_output_folder(out, **options)
        (folder / "a.txt").write_text("a")
    assert not (out / LOCK).exists()
    with prepare_output_folder(out, force=True) as folder:
        (folder / "b.txt").write_text("b")
    assert sorted(p.name for p in out.iterdir()) == [MANIFEST, "b.txt"]


def test_the_lock_of_a_run_that_was_killed_is_stale(tmp_path):
    code = (
        "import os, signal, sys\n"
        "from drake_exo.files.output import prepare_output_folder\n"
        "kept = prepare_output_folder(sys.argv[1])\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", code, str(out)], check=False)
    assert (out / LOCK).exists()
    with prepare_output_folder(out) as folder:
        (folder / "a.txt").write_text("a")
    assert not (out / LOCK).exists()


def test_a_refused_run_lets_go_of_the_folder(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "old.txt").write_text("old")
    with pytest.raises(InputError, match="already holds"):
        prepare_output_folder(out)
    assert not (out / LOCK).exists()
    with prepare_output_folder(out, force=True):
        pass


def test_arrays_that_unpack_to_too_much_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, x=np.zeros(10**6))
    assert path.stat().st_size < 20_000
    assert read_arrays(path, "again")["x"].size == 10**6
    monkeypatch.setattr(output, "_LARGEST_ARRAYS", 10**6)
    with pytest.raises(InputError, match="unpacks to"):
        read_arrays(path, "again")


def test_arrays_of_another_version_of_zip_are_damaged(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.zeros(3))
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\x01\x02") + 6] = 173  # of 17.3, which there is not
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"a\.npz: is damaged; again"):
        read_arrays(path, "again")


def test_contents_that_differ_beyond_six_digits_are_the_same():
    """Sixteen hexadecimal digits; zero has no sign; order does not count."""
    one = checksum({"a": [1.0, -0.0], "b": {"c": 2.5}})
    assert len(one) == 16 and set(one) <= set("0123456789abcdef")
    assert one == checksum({"b": {"c": 2.5000001}, "a": [1.0, 0.0]})
    others = [
        checksum({"a": [1.00001, 0.0], "b": {"c": 2.5}}),
        checksum({"a": [0.0, 1.0], "b": {"c": 2.5}}),
        checksum({"a": [1.0, 0.0], "b": {"c": -2.5}}),
        checksum({"a": [1.0, 0.0], "b": {"c": 2.6}}),
    ]
    assert len({one, *others}) == 5
    assert checksum([3.0]) != checksum([4.0])


def test_a_file_is_the_same_wherever_it_lies():
    """The same device, named from the study of another folder."""
    one = checksum({"file": Path("device.urdf")})
    assert one == checksum({"file": Path("../models/device.urdf")})
    assert one != checksum({"file": Path("another.urdf")})


def test_somebodys_file_of_a_results_name_is_not_replaced(tmp_path):
    target = tmp_path / "data"
    target.mkdir()
    (target / "steps.csv").write_text("mine")
    with (
        pytest.raises(InputError, match=r"steps\.csv: no run wrote this"),
        prepare_output_folder(target, force=True) as out,
    ):
        (out / "steps.csv").write_text("theirs")
    assert (target / "steps.csv").read_text() == "mine"
    assert (tmp_path / "data.partial" / "steps.csv").read_text() == "theirs"


@pytest.mark.parametrize("resume", [False, True])
def test_force_removes_nobodys_folder_of_the_name_new_results_grow_in(
    tmp_path, resume
):
    target, beside = tmp_path / "out", tmp_path / "out.partial"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    beside.mkdir()
    (beside / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt: no run wrote this"):
        prepare_output_folder(target, force=True, resume=resume)
    assert (beside / "notes.txt").read_text() == "mine"
    assert (target / "one.txt").read_text() == "old"


def test_force_leaves_what_a_stopped_run_left_where_that_is_read(tmp_path):
    target, left = tmp_path / "out", tmp_path / "out.partial"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    stopped = prepare_output_folder(target, force=True)
    with stopped as folder:
        (folder / "checkpoint.npz").write_text("so far")
        stopped.end(1)
    with pytest.raises(InputError, match=r"would replace .*out\.partial"):
        prepare_output_folder(target, force=True, reads=[left])
    assert (left / "checkpoint.npz").read_text() == "so far"


def test_resuming_does_not_make_others_files_its_own(tmp_path):
    """As a study beside its results: a later --force leaves it."""
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    (target / "study.yaml").write_text("mine")
    with prepare_output_folder(target, resume=True) as folder:
        (folder / "two.txt").write_text("more")
    with prepare_output_folder(target, force=True):
        pass
    assert not (target / "one.txt").exists()
    assert not (target / "two.txt").exists()
    assert (target / "study.yaml").read_text() == "mine"


@pytest.mark.parametrize("resume", [False, True])
def test_what_a_killed_run_left_is_its_own(tmp_path, resume):
    """Whether it began the folder or went on in one with another's file."""
    target = tmp_path / "out"
    if resume:
        with prepare_output_folder(target) as folder:
            (folder / "none.txt").write_text("before")
        (target / "study.yaml").write_text("mine")
    folder = prepare_output_folder(target, resume=resume)
    (folder.path / "one.txt").write_text("so far")
    folder._lock.close()  # as the system does
    again = prepare_output_folder(target, resume=True)
    assert again._others == ({"study.yaml"} if resume else set())
    again._lock.close()
    with prepare_output_folder(target, force=True) as folder:
        (folder / "two.txt").write_text("new")
    assert (target / MANIFEST).read_text() == "two.txt\n"
    theirs = ["study.yaml"] if resume else []
    names = sorted(p.name for p in target.iterdir())
    assert names == [MANIFEST, *theirs, "two.txt"]


def test_a_user_s_file_may_be_called_anything(tmp_path):
    """Kept by runs that go on, are killed, and begin again."""
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("before")
    theirs = [os.fsdecode(b"m\xfcller"), "a\u2028b", "a\nb", "*"]
    for name in theirs:
        (target / name).write_text("mine")
    folder = prepare_output_folder(target, resume=True)
    folder._lock.close()
    with prepare_output_folder(target, force=True) as folder:
        (folder / "two.txt").write_text("new")
    names = {p.name for p in target.iterdir()}
    assert names == {MANIFEST, *theirs, "two.txt"}


def test_a_run_killed_while_it_replaces_can_be_replaced(tmp_path, monkeypatch):
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    (target / "study.yaml").write_text("mine")

    def cut(whole, place):
        if whole.name == "two.txt":
            raise KeyboardInterrupt
        os.rename(whole, place)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(output.os, "replace", cut)
        with prepare_output_folder(target, force=True) as folder:
            (folder / "new.txt").write_text("new")
            (folder / "two.txt").write_text("new")
    with prepare_output_folder(target, force=True) as folder:
        (folder / "new.txt").write_text("newer")
    names = sorted(p.name for p in target.iterdir())
    assert names == [MANIFEST, "new.txt", "study.yaml"]


@pytest.mark.parametrize(
    ("code", "kept"), [(0, "new"), (3, "new"), (1, "old"), (130, "old")]
)
def test_what_is_not_solved_replaces_nothing(tmp_path, code, kept):
    target = tmp_path / "out"
    with prepare_output_folder(target) as folder:
        (folder / "one.txt").write_text("old")
    folder = prepare_output_folder(target, force=True)
    with folder as place:
        (place / "one.txt").write_text("new")
        assert folder.end(code) == code
    assert (target / "one.txt").read_text() == kept
    assert (folder.path / "one.txt").read_text() == "new"
    # The first run into a folder stays there, solved or not.
    first = prepare_output_folder(tmp_path / "first")
    with first as place:
        (place / "one.txt").write_text("first")
        first.end(code)
    assert (tmp_path / "first/one.txt").read_text() == "first"


@pytest.mark.parametrize("there", [False, True])
def test_a_run_that_wrote_nothing_leaves_no_folder_of_its_own(tmp_path, there):
    target = tmp_path / "out"
    if there:
        target.mkdir()
    with pytest.raises(InputError), prepare_output_folder(target):
        raise InputError("bad settings")
    assert target.exists() == there
    with pytest.raises(InputError), prepare_output_folder(target) as folder:
        (folder / "checkpoint.txt").write_text("so far")
        raise InputError("killed")
    assert (target / "checkpoint.txt").exists()


@pytest.mark.parametrize("damage", [b"\xff\xfe\n", b"a\0b.txt\n"])
def test_a_damaged_list_of_files_removes_nothing(tmp_path, damage):
    with prepare_output_folder(tmp_path) as folder:
        (folder / "one.txt").write_text("old")
    (tmp_path / MANIFEST).write_bytes(damage)
    with prepare_output_folder(tmp_path, force=True) as folder:
        (folder / "two.txt").write_text("new")
    assert (tmp_path / "one.txt").read_text() == "old"
    assert (tmp_path / "two.txt").read_text() == "new"


def test_what_is_read_is_not_replaced(tmp_path):
    target = tmp_path / "out"
    with prepare_output_folder(target / "foot_ground") as folder:
        (folder / "one.txt").write_text("old")
    for source in (target, target / "foot_ground"):
        with pytest.raises(InputError, match="is read; choose another"):
            prepare_output_folder(target, force=True, reads=[None, source])
    prepare_output_folder(target / "next", reads=[target]).__exit__(*[None] * 3)


def test_what_a_stopped_run_left_is_none_of_the_results(tmp_path):
    for name in ("A", "A.partial", "B/C", "B.partial/C"):
        (tmp_path / name).mkdir(parents=True)
        write_json(tmp_path / name / "summary.json", {})
    found = [p.parent for p in output.summaries(tmp_path)]
    assert found == [tmp_path / "A", tmp_path / "B/C"]
    # Asked for by itself it can be looked at.
    partial = tmp_path / "A.partial"
    assert output.summaries(partial) == [partial / "summary.json"]
