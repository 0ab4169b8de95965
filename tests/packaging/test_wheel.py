"""The wheel, built and installed where the checkout cannot be imported."""

import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from drake_exo import __version__

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
_SOURCES = ("drake_exo", "models", "pyproject.toml", "README.md", "LICENSE")
_IGNORED = shutil.ignore_patterns("__pycache__", "*.pyc")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy: no leftover of an earlier build gets in."""
    place = tmp_path_factory.mktemp("wheel")
    for name in _SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / "src" / name, ignore=_IGNORED)
        else:
            shutil.copy(source, place / "src" / name)
    run(
        sys.executable, "-m", "build", "--wheel", "--no-isolation",
        "--outdir", place, place / "src", cwd=place,
    )  # fmt: skip
    (found,) = place.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel) -> Path:
    """A fresh environment with the wheel; its other packages are ours.

    A .pth file leads to them. Files of that kind in there, such as the one
    that makes the checkout importable, are not followed.
    """
    place = wheel.parent / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", place)
    run(
        sys.executable, "-m", "pip", "--python", place, "install",
        "--no-deps", "--no-index", wheel,
    )  # fmt: skip
    (packages,) = place.glob("lib/python*/site-packages")
    ours = sysconfig.get_paths()["purelib"]
    (packages / "others.pth").write_text(f"{ours}\n")
    return place


def run(*command, cwd=None) -> str:
    """Standard output; fails with the command's own words."""
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


def test_every_file_is_in_the_wheel(wheel):
    packed = set(zipfile.ZipFile(wheel).namelist())
    for folder, inside in (("drake_exo", ""), ("models", "drake_exo/")):
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts:
                assert inside + path.relative_to(ROOT).as_posix() in packed
    assert any(name.endswith("licenses/LICENSE") for name in packed)
    tops = {name.split("/")[0] for name in packed}
    assert tops == {"drake_exo", f"drake_exo-{__version__}.dist-info"}


def test_the_checkout_is_out_of_reach(installed, tmp_path):
    script = "import sys, drake_exo; print(drake_exo.__file__, *sys.path)"
    python = installed / "bin" / "python"
    file, *path = run(python, "-c", script, cwd=tmp_path).split()
    assert Path(file).is_relative_to(installed)
    assert str(ROOT) not in path


@pytest.mark.slow
def test_the_command_and_its_version(installed, tmp_path):
    command = installed / "bin" / "drake-exo"
    assert run(command, "--version", cwd=tmp_path) == f"{__version__}\n"
    text = run(command, "contact", "--out", tmp_path / "out", cwd=tmp_path)
    assert str(tmp_path) in text or list((tmp_path / "out").glob("*.png"))


_MODELS = """
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from drake_exo.model.description import (models_path)
from drake_exo.model.plant import nominal_model

assert nominal_model("coupled").plant().num_positions() == 9
plant = MultibodyPlant(0.0)
parser = Parser(plant)
parser.package_map().AddPackageXml(str(models_path() / "package.xml"))
for name in ("human", "exoskeleton"):
    parser.AddModelsFromUrl(f"package://drake_exo/{name}.sdf")
print(parser.package_map().GetPath("drake_exo"))
"""


def test_models_are_found_by_package_url(installed, tmp_path):
    python = installed / "bin" / "python"
    place = Path(run(python, "-c", _MODELS, cwd=tmp_path).strip())
    assert place.is_relative_to(installed)
    assert (place / "human.sdf").is_file()
    assert list((place / "meshes").glob("*.obj"))


@pytest.mark.slow
def test_a_subject_is_simulated_from_the_wheel(installed, tmp_path):
    command = installed / "bin" / "drake-exo"
    options = ("--trials", "1", "--without", "all", "--out", "campaign")
    assert "wrote" in run(command, "lab", *options, cwd=tmp_path)
    assert (tmp_path / "campaign" / "study.yaml").is_file()


def test_one_version_everywhere():
    assert re.fullmatch(r"\d+\.\d+\.\d+", __version__)
    citation = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {__version__}\n" in citation
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert f"\n## {__version__}" in changes
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    assert __version__ not in project
