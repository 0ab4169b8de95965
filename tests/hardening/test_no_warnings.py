"""Normal use prints no warning, and names the folders that will be there."""

import argparse
import contextlib
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli_runs import normal_use

from drake_exo import __version__
from drake_exo.cli import demo

pytestmark = pytest.mark.slow


@pytest.mark.slow
def test_version_and_help():
    assert normal_use("--version").strip() == __version__
    assert "calibrate" in normal_use("--help")


@pytest.mark.slow
@pytest.mark.parametrize("command", ["check", "sensitivity"])
def test_commands_on_a_study(command, campaign, tmp_path):
    out = str(tmp_path / "out")
    assert out in normal_use(command, str(campaign), "--out", out)


@pytest.mark.slow
def test_calibrate_and_report(campaign, tmp_path):
    out = str(tmp_path / "out")
    phase = ("--phase", "foot-ground", "--no-front")
    assert out in normal_use("calibrate", str(campaign), *phase, "--out", out)
    assert "Table II" in normal_use("report", out)


def test_contact(tmp_path):
    normal_use("contact", "--out", str(tmp_path / "out"))


@pytest.mark.slow
def test_sole(sole_case, tmp_path):
    out = tmp_path / "out"
    assert "c_tr" in normal_use(
        "sole", "simulate", str(sole_case), "--out", str(out)
    )


def test_the_demo_names_final_paths(monkeypatch, tmp_path, capsys):
    """Also where --force lets results grow elsewhere first."""
    out = tmp_path / "demo_results"
    out.mkdir()
    (out / "old.txt").write_text("old")
    places = []

    def step(*arguments, **options):
        given = (*arguments, *options.values())
        places.extend(a for a in given if isinstance(a, Path))
        return 0

    class Passed:
        def gate(self, use):
            return ()

        def trials(self, use):
            return ()

        def calibrated(self, folder, accepted):
            return None, []

        def alone(self, trials):
            return self

    @contextlib.contextmanager
    def one_beside():
        def begin(function, **arguments):
            return SimpleNamespace(value=lambda: function(**arguments))

        yield begin

    for name in (
        *("write_campaign", "write_interaction"),
        *("write_predictions", "write_report", "gather", "write_view"),
    ):
        monkeypatch.setattr(demo, name, step)
    monkeypatch.setattr(demo, "read_study", lambda *_: Passed())
    monkeypatch.setattr(demo, "Beside", one_beside)
    monkeypatch.setattr(demo, "find_clocks", lambda *_, **__: [])
    assert demo.run(argparse.Namespace(out=out, force=True)) == 0
    growing = Path(f"{out}.partial")
    written = ("laboratory", "calibration", "prediction", "prediction_stiff")
    for name in (*written, "report"):
        assert growing / name in places
    text = capsys.readouterr().out
    assert ".partial" not in text
    assert str(out / "replay.html") in text
