"""Normal use prints no warning, and names the folders that will be there."""

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


def test_the_demo_names_final_paths(monkeypatch, tmp_path, capsys):
    """Also where --force lets results grow elsewhere first."""
    out = tmp_path / "demo_results"
    out.mkdir()
    (out / "old.txt").write_text("old")
    monkeypatch.setattr(
        demo, "_steps", lambda folder: (folder / demo.REPLAY).touch()
    )
    assert demo.run(demo.argparse.Namespace(out=out, force=True)) is None
    page = capsys.readouterr().out.splitlines()[-1].strip()
    assert page == str(out / demo.REPLAY)
    assert (out / demo.REPLAY).exists()
