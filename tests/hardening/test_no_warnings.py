"""Normal use prints no warning, and names the folders that will be there."""

import io
import sys

import pytest
from cli_runs import normal_use

from drake_exo import __version__
from drake_exo.cli import demo


def test_version_and_help():
    assert normal_use("--version").strip() == __version__
    assert "calibrate" in normal_use("--help")


@pytest.mark.parametrize("command", ["check", "sensitivity"])
def test_commands_on_a_study(command, campaign, tmp_path):
    out = str(tmp_path / "out")
    assert out in normal_use(command, str(campaign), "--out", out)


def test_calibrate_and_report(campaign, tmp_path):
    out = str(tmp_path / "out")
    phase = ("--phase", "foot-ground", "--no-front")
    assert out in normal_use("calibrate", str(campaign), *phase, "--out", out)
    assert "Table II" in normal_use("report", out)


def test_contact(tmp_path):
    normal_use("contact", "--out", str(tmp_path / "out"))


def test_sole(sole_case, tmp_path):
    out = tmp_path / "out"
    assert "c_tr" in normal_use(
        "sole", "simulate", str(sole_case), "--out", str(out)
    )


def test_the_demo_names_final_paths(monkeypatch, tmp_path):
    """Also where --force lets results grow elsewhere first."""
    out = tmp_path / "demo_results"
    out.mkdir()
    (out / "old.txt").write_text("old")
    seen = []

    def step(command):
        seen.append(command)
        print(f"results in {command[-1]}")
        return 0

    monkeypatch.setattr(demo, "main", step)
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    args = demo.argparse.Namespace(out=out, force=True)
    assert demo.run(args) == 0
    assert ["report", f"{out}.partial"] in seen
    text = sys.stdout.getvalue()
    assert ".partial" not in text
    assert f"results in {out}\n" in text
