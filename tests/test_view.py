"""`drake-exo view` as a user runs it."""

import http.client
import json
import re
import shutil
import signal
import subprocess
import sys

import pytest
from page_reader import clip_titles
from replayed_results import write_results

from drake_exo.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp("results") / "rise")


@pytest.fixture(scope="module")
def page(folder):
    path = folder.parent / "replay.html"
    assert main(["view", str(folder), "--out", str(path)]) == 0
    return path


def refused(capsys, *arguments):
    assert main(["view", *map(str, arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_page_is_written_and_named(folder, tmp_path, capsys):
    path = tmp_path / "page.html"
    assert main(["view", str(folder), "--out", str(path)]) == 0
    out = capsys.readouterr()
    assert str(path) in out.out
    assert out.err == ""
    assert clip_titles(path)


def test_page_is_not_replaced_unasked(folder, tmp_path, capsys):
    path = tmp_path / "page.html"
    path.write_text("mine")
    assert "--force" in refused(capsys, folder, "--out", path)
    assert path.read_text() == "mine"
    assert main(["view", str(folder), "--out", str(path), "--force"]) == 0
    assert path.read_text() != "mine"


def test_force_makes_no_page_of_another_file(folder, capsys):
    path = folder / "summary.json"
    before = path.read_bytes()
    said = refused(capsys, folder, "--out", path, "--force")
    assert "give a .html file" in said
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("results", "words"),
    [("nowhere", "is not a folder"), ("empty", "holds no results")],
)
def test_bad_folder_ends_in_a_sentence(tmp_path, capsys, results, words):
    (tmp_path / "empty").mkdir()
    out = tmp_path / "page.html"
    assert words in refused(capsys, tmp_path / results, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize("command", ["report", "compare gone"])
def test_a_folder_that_is_none_is_told_by_every_command(command, capsys):
    assert main([*command.split(), "gone"]) == 2
    assert "gone: is not a folder; give the --out" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["checkpoint.json", "a/checkpoint.npz"])
def test_a_run_that_was_cut_off_is_told(tmp_path, capsys, name):
    """Of soles and of movements; results beside it are shown."""
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"")
    said = refused(capsys, tmp_path, "--no-browser")
    assert "holds a run that was cut off, and nothing to replay yet" in said
    (tmp_path / "summary.json").write_text("{}")
    assert "cut off" not in refused(capsys, tmp_path, "--no-browser")


def test_bad_target_ends_in_a_sentence(folder, tmp_path, capsys):
    assert "folder" in refused(capsys, folder, "--out", tmp_path)
    missing = tmp_path / "no" / "page.html"
    assert "cannot be written" in refused(capsys, folder, "--out", missing)


def test_movements_and_soles_are_not_mixed(tmp_path, capsys):
    write_results(tmp_path / "rise")
    (tmp_path / "sole").mkdir()
    (tmp_path / "sole/summary.json").write_text('{"c_rot": 1.0}')
    line = refused(capsys, tmp_path, "--out", tmp_path / "page.html")
    assert str(tmp_path / "rise") in line
    assert str(tmp_path / "sole") in line


def test_a_trial_costs_little(folder, page, tmp_path):
    """Meshes are in a page once: dozens of trials stay under 20 MB."""
    for name in "abcdef":
        write_results(tmp_path / name)
    path = tmp_path / "page.html"
    assert main(["view", str(tmp_path), "--out", str(path)]) == 0
    (titles,) = clip_titles(path).values()
    assert len(titles) == 6
    more = path.stat().st_size - page.stat().st_size
    assert more < 5 * 0.2e6


def test_damaged_model_ends_in_a_sentence(tmp_path, capsys):
    folder = write_results(tmp_path / "rise")
    model = json.loads((folder / "model.json").read_text())
    del model["human"]["thigh"]
    (folder / "model.json").write_text(json.dumps(model))
    line = refused(capsys, folder, "--out", tmp_path / "page.html")
    assert "model.json" in line
    assert "thigh" in line


@pytest.mark.slow
def test_page_is_served_until_interrupted(folder):
    command = [
        *(sys.executable, "-m", "drake_exo.cli", "view", str(folder)),
        "--no-browser",
    ]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as server:
        try:
            line = server.stdout.readline()
            port, path = re.search(r"localhost:(\d+)(/\S+);", line).groups()
            asked = http.client.HTTPConnection(
                "localhost", int(port), timeout=60
            )
            asked.request("GET", path)
            answer = asked.getresponse()
            assert answer.status == 200
            assert b"const PLAYER" in answer.read()
        finally:
            server.send_signal(signal.SIGINT)
            _, errors = server.communicate(timeout=20)
    assert server.returncode == 0
    assert errors == ""


@pytest.mark.slow
def test_page_plays_in_a_browser_from_disk(page, tmp_path):
    """Opened without network, the page moves its bodies."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium on this machine")
    done = subprocess.run(
        [
            *(browser, "--headless=new", "--no-sandbox", "--disable-gpu"),
            *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--window-size=320,240", "--virtual-time-budget=3000"),
            *("--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom"),
            *(f"--user-data-dir={tmp_path}", "--enable-logging=stderr"),
            f"{page.as_uri()}#time=0.5&ghost=beside",
        ],
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert "Uncaught" not in done.stderr
    assert ">0.50 / 1.00 s<" in done.stdout
    # 400 N down the ramp, and the horizontal 25 N.
    assert ">401 N<" in done.stdout
    assert re.search(r">feet 401 N<", done.stdout)
