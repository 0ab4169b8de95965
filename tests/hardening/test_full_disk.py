"""A full disk or a folder that cannot be written: one sentence, exit 2."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from undrawn import undrawn

from drake_exo.cli import main

# No file can grow beyond a limit: what a full disk or a quota answers.
_LIMITED = """
import resource, sys
from drake_exo import cli
from drake_exo.calibration import solving

solving._CHECKPOINT_SECONDS = 0.0
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(cli.main(sys.argv[2:]))
"""


def limited(limit_bytes, command):
    return subprocess.run(
        [sys.executable, "-c", _LIMITED, str(limit_bytes), *command],
        capture_output=True,
        text=True,
        timeout=300,
    )


def contents(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def assert_one_sentence(done, *words) -> None:
    assert done.returncode == 2, done.stderr[-3000:]
    assert done.stderr.count("\n") == 1, done.stderr[-3000:]
    for word in ("cannot be written", "File too large", *words):
        assert word in done.stderr


@pytest.mark.slow
def test_sole_keeps_earlier_results_when_the_disk_is_full(sole_case, tmp_path):
    out = tmp_path / "out"
    command = ["sole", "simulate", str(sole_case), "--out", str(out)]
    with undrawn():
        assert main(command) == 0
    before = contents(out)
    assert_one_sentence(limited(20_000, [*command, "--force"]), "out")
    assert contents(out) == before
    # With room again the same command goes through.
    with undrawn():
        assert main([*command, "--force"]) == 0
    assert set(contents(out)) == set(before)
    assert not (tmp_path / "out.partial").exists()


@pytest.mark.slow
def test_calibrate_stops_where_a_checkpoint_does_not_fit(campaign, tmp_path):
    out = tmp_path / "out"
    options = ["--phase", "foot-ground", "--no-front", "--out", str(out)]
    command = ["calibrate", str(campaign), *options]
    done = limited(40_000, command)
    assert_one_sentence(done)
    assert not (out / "summary.json").exists()
    kept = contents(out)
    assert any(name.startswith("measured_") for name in kept)
    with undrawn():
        assert main([*command, "--resume"]) == 0


@pytest.mark.parametrize("command", ["contact", "lab", "sole", "demo"])
@pytest.mark.parametrize("place", ["file/out", "/proc/out", "/proc/self"])
def test_folders_that_cannot_be_written(
    command, place, tmp_path, sole_case, capsys
):
    (tmp_path / "file").write_text("something")
    if not os.path.isdir("/proc"):
        pytest.skip("there is no /proc to try a read-only folder with")
    full = [command]
    if command == "sole":
        full += ["simulate", str(sole_case)]
    code = main([*full, "--force", "--out", str(tmp_path / place)])
    assert code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "cannot be written" in error and "--out" in error


@pytest.mark.slow
def test_a_reader_that_stops_listening_is_no_traceback(tmp_path):
    script = "import sys\nfrom drake_exo import cli\nsys.exit(cli.main({}))"
    command = ["contact", "--out", str(tmp_path / "out")]
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-c", script.format(command)],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
    )
    os.close(write)
    assert "Traceback" not in done.stderr
