"""How commands end: exit codes, and one sentence where a user can act."""

import argparse
import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drake_exo import cli
from drake_exo.cli import lab
from drake_exo.errors import InputError, reason
from drake_exo.virtual_laboratory.truth import DISTURBANCES


def ending(error, **arguments):
    def run(args):
        raise error

    return cli._run(lambda: argparse.Namespace(run=run, **arguments))


def test_what_a_command_returns():
    for found, code in ((None, 0), (1, 1)):
        args = argparse.Namespace(run=lambda args, found=found: found)
        assert cli._run(lambda args=args: args) == code


@pytest.mark.parametrize("modules", [0, 1, 3])
def test_ctrl_c_while_a_command_is_imported(modules, capsys):
    """Each extension module on the way makes another error of it."""

    def parsed():
        error = KeyboardInterrupt()
        for _ in range(modules):
            outer = ImportError("initialization failed")
            outer.__cause__, error = error, outer
        raise error

    assert cli._run(parsed) == 130
    assert capsys.readouterr().err == "drake-exo: interrupted\n"


@pytest.mark.parametrize(
    ("resume", "more"),
    [
        (False, "; --resume goes on from what is kept"),
        (None, ""),  # of soles, `--resume DIR`
        (Path("x"), ""),
    ],
)
def test_ctrl_c_outside_a_solve_tells_how_to_go_on(resume, more, capsys):
    def run(args):
        raise KeyboardInterrupt

    args = argparse.Namespace(run=run, resume=resume)
    assert cli._run(lambda: args) == 130
    assert capsys.readouterr().err == f"drake-exo: interrupted{more}\n"


@pytest.mark.parametrize("ignored", [False, True])
def test_sigterm_ends_a_command_as_ctrl_c_does(ignored, monkeypatch, capsys):
    """Unless that is ignored, as by jobs in the background of a script."""
    seen = []

    def run(args):
        seen.append(signal.getsignal(signal.SIGTERM))
        if not ignored:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1.0)

    monkeypatch.setattr(cli, "parse", lambda argv: argparse.Namespace(run=run))
    before = signal.getsignal(signal.SIGTERM)
    handled = signal.SIG_IGN if ignored else signal.default_int_handler
    usual = signal.signal(signal.SIGINT, handled)
    try:
        code = cli.main(["check"])
    finally:
        signal.signal(signal.SIGINT, usual)
    assert code == (0 if ignored else 130)
    assert (seen[0] is before) == ignored
    assert signal.getsignal(signal.SIGTERM) is before
    assert ("interrupted" in capsys.readouterr().err) != ignored


def test_help_imports_no_command():
    code = "import sys; from drake_exo import cli; cli.main(['--help'])"
    code = (
        "import atexit, sys\n"
        "atexit.register(lambda: print('pydrake' in sys.modules))\n" + code
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert all(name in said for name in cli._COMMANDS)
    assert said.endswith("False\n")


@pytest.mark.slow
def test_a_batch_that_is_done_loads_little(tmp_path):
    """What its results are read and drawn with takes seconds to load."""
    case = "name: a\nmaterial: {name: butyl}\nmesh: {brick: {divisions: [2]}}\n"
    (tmp_path / "a.yaml").write_text(case)
    batch = tmp_path / "batch.yaml"
    batch.write_text("cases: [a.yaml]\nsteps: [sole simulate]\n")
    run = ["batch", str(batch), "--out", str(tmp_path / "out")]
    assert cli.main(run) == 3  # told: no brick
    code = (
        f"import sys; from drake_exo import cli; cli.main({run}); "
        "print({'pydrake', 'scipy', 'matplotlib'} & {*sys.modules})"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert said.endswith("set()\n")


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError("a.yaml: wrong; mend it"), 2, "a.yaml: wrong; mend it"),
        (OSError(errno.ENOSPC, "No space"), 2, "results: cannot be written"),
        (OSError(errno.EROFS, "Read-only", "x/y"), 2, "x/y: cannot be written"),
        (OSError(errno.ENAMETOOLONG, "Too long", "x"), 2, "x: Too long; give"),
        (
            FileExistsError(errno.EEXIST, "Is there", "x"),
            2,
            "x: Is there; give",
        ),
        (OSError(errno.ENOTDIR, "No folder", "x"), 2, "x: No folder; give"),
        (OSError(errno.EISDIR, "A folder", "x"), 2, "x: A folder; give"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError("Unable to allocate 6 GiB"), 2, "allocate 6 GiB"),
    ],
)
def test_one_sentence(error, code, words, capsys):
    assert ending(error, out="results") == code
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1


def test_mistakes_of_ours_are_not_hidden():
    with pytest.raises(FileNotFoundError):
        ending(FileNotFoundError(errno.ENOENT, "No such file", "x"))
    with pytest.raises(ValueError, match="ours"):
        ending(ValueError("ours"))


def test_nobody_listens(monkeypatch):
    replaced = []
    monkeypatch.setattr(os, "dup2", lambda *fds: replaced.append(fds))
    assert ending(BrokenPipeError()) == 141
    assert len(replaced) == 1


def test_only_the_wanted_half_is_offered(capsys):
    """`sole` must not load the exoskeleton's commands."""
    with pytest.raises(SystemExit):
        cli.parse(["sole", "--help"])
    assert "optimize" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        cli.parse(["nothing"])
    assert end.value.code == 2
    assert "calibrate" in capsys.readouterr().err


def test_reasons_are_short():
    assert reason(ValueError("one\ntwo")) == "one"
    assert reason(KeyError()) == "KeyError"
    assert len(reason(ValueError("x" * 1000))) < 130
    assert "\x1b" not in reason(ValueError("a\x1b[31mb"))


@pytest.mark.parametrize(
    ("without", "left"),
    [
        ([], list(DISTURBANCES)),
        (["all"], ["variation"]),
        (["all", "variation"], []),
        (["gaps"], [d for d in DISTURBANCES if d != "gaps"]),
    ],
)
def test_what_the_laboratory_is_to_leave_out(
    without, left, monkeypatch, tmp_path, capsys
):
    asked = []

    def write(folder, seed, active, trials, **options):
        asked.append(active)
        return folder / "study.yaml"

    monkeypatch.setattr(lab, "write_campaign", write)
    options = ["--without", *without] if without else []
    out = str(tmp_path / "out")
    assert cli.main(["lab", "--seed", "1", "--out", out, *options]) == 0
    assert asked == [left]
    told = capsys.readouterr().out
    assert told.endswith(f"study.yaml with {lab.NUM_USED} trials\n")
    one = ["lab", "--trials", "1", "--out", f"{out}1"]
    assert cli.main(one) == 0
    assert capsys.readouterr().out.endswith("with 1 trial\n")


@pytest.mark.parametrize("what", ["--design", "--model"])
def test_the_laboratory_does_not_replace_what_it_reads(
    what, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(lab, "read_design", lambda folder: None)
    (tmp_path / "design.yaml").touch()
    read = tmp_path if what == "--design" else tmp_path / "design.yaml"
    words = [what, str(read), "--out", str(tmp_path), "--force"]
    assert cli.main(["lab", *words]) == 2
    assert "would replace" in capsys.readouterr().err


def test_sums_do_not_depend_on_how_many_cores_there_are():
    """One thread, said before numpy loads its BLAS, unless a user says else."""
    said = (
        "import os, sys, drake_exo; assert 'numpy' not in sys.modules;"
        "print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    for given, seen in ({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3"):
        env = os.environ.copy()
        env.pop("OPENBLAS_NUM_THREADS", None)
        done = subprocess.run(
            [sys.executable, "-c", said],
            env=env | given,
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == seen


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("design {loop} --calibration here --out here", "loop: "),
        ("batch {loop} --out here", "loop: "),
        ("lab --model {loop} --out here", "loop: "),
        ("sole report {long}", "xxx"),  # in other words from Python 3.14 on
        ("sole reduce here --out .", "give a .yaml file for --out"),
        ("sole reduce here --out law.txt", "give a .yaml file for --out"),
        ("sole study --data-root gone --out here", "gone: is not a folder"),
    ],
)
def test_a_path_that_cannot_be_is_one_sentence(
    command, words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    argv = command.format(loop="loop", long="x" * 300).split()
    assert cli.main(argv) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["loop"]
