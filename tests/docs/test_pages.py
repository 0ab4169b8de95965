"""Documentation that stays true: links, commands, messages, keys, the map."""

import ast
import dataclasses
import re
import shlex
import sys
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drake_exo as dx
from drake_exo import cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("tutorials/*.md")]
)
SOURCES = sorted((ROOT / "drake_exo").rglob("*.py"))
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def prose(path: Path) -> str:
    """Text of a page without its blocks of code."""
    return _FENCE.sub("", path.read_text("utf-8"))


def anchors(path: Path) -> set[str]:
    """What links may point to, made as GitHub and its like do."""
    found = set()
    for title in re.findall(r"^#+ (.+)$", prose(path), re.MULTILINE):
        title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).lower()
        found.add(re.sub(r"[^\w\- ]", "", title).replace(" ", "-"))
    return found


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page):
    for link in _LINK.findall(prose(page)):
        if link.startswith(("http://", "https://")):
            continue
        place, _, anchor = link.partition("#")
        target = (page.parent / place).resolve() if place else page
        assert target.exists(), f"{name(page)}: {link}"
        if anchor:
            assert anchor in anchors(target), f"{name(page)}: {link}"


def test_every_page_is_linked():
    """From the index, or from the README."""
    linked = set()
    for page in (ROOT / "README.md", ROOT / "docs" / "README.md"):
        for link in _LINK.findall(prose(page)):
            linked.add((page.parent / link.partition("#")[0]).resolve())
    for page in (ROOT / "docs").glob("*.md"):
        assert page in linked or page.name == "README.md", name(page)


def commands() -> list[tuple[str, list[str]]]:
    """(page, words) of every `drake-exo` line in the pages' blocks."""
    found = []
    for page in PAGES:
        for language, block in _FENCE.findall(page.read_text("utf-8")):
            if language not in ("", "sh", "console"):
                continue
            for line in block.replace("\\\n", " ").splitlines():
                # Square brackets stand around what may be left out.
                line = line.split(" #")[0].replace("[", "").replace("]", "")
                words = shlex.split(line)
                if words and words[0].split("/")[-1] == "drake-exo":
                    found.append((name(page), words[1:]))
    for page in PAGES:
        for line in re.findall(r"`drake-exo ([^`]+)`", prose(page)):
            line = line.replace("[", "").replace("]", "")
            words = shlex.split(" ".join(line.split()))
            if {"--out", "STUDY.yaml", "DIR"} & set(words):
                found.append((name(page), words))
    return found


COMMANDS = commands()


def test_there_are_commands():
    seen = {words[0] for _, words in COMMANDS}
    assert seen >= {"check", "calibrate", "predict", "report", "lab", "sole"}


@pytest.mark.parametrize(
    ("page", "words"), COMMANDS, ids=lambda v: v if isinstance(v, str) else ""
)
def test_commands_are_understood(page, words):
    """Parsed by the program's own parser; nothing is run."""
    # Of choices the first, of placeholders a value.
    words = [word.split("|")[0] for word in words]
    words = [{"N": "1", "FACTOR": "1.4"}.get(word, word) for word in words]
    required = {"predict": ["--calibration", "--out"]}
    for name in (
        "calibrate",
        "crossvalidate",
        "sensitivity",
        "contact",
        "design",
    ):
        required[name] = ["--out"]
    inline = [w for w in required.get(words[0], []) if w not in words]
    for option in inline:  # quoted in a sentence, where it may be left out
        words = [*words, option, "x"]
    assert cli.parse(words).command == words[0]


def leaf(words: list[str]) -> str:
    """`sole simulate` of its words, `check` of others."""
    return " ".join(words[: 1 + (words[0] in ("sole", "export"))])


@pytest.mark.parametrize("command", sorted({leaf(w) for _, w in COMMANDS}))
def test_help_says_what_a_command_does(command, capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        cli.main([*command.split(), "--help"])
    usage, told = capsys.readouterr().out.split("\n\n")[:2]
    assert usage.startswith("usage: drake-exo")
    words = " ".join(told.split())
    own = (
        "Simulate a measurement"
        if command == "lab"
        else f"`drake-exo {command}`"
    )
    assert words.startswith(own), words


_LIGHT = ("contact",)


@pytest.mark.slow
@pytest.mark.parametrize("command", _LIGHT)
def test_light_commands_run(command, tmp_path, monkeypatch):
    words = next(w for _, w in COMMANDS if w[0] == command)
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 0
    assert any(tmp_path.iterdir())


def test_studies_in_the_pages_are_read():
    """Each block that is a whole study; fragments as a part of one."""
    from drake_exo.files import schema
    from drake_exo.study import StudyFile

    page = (ROOT / "docs" / "your_data.md").read_text("utf-8")
    whole = [b for k, b in _FENCE.findall(page) if "subject:" in b]
    assert len(whole) == 1
    schema.load_text(whole[0], StudyFile, "docs/your_data.md")
    count = 0
    for path in ("your_data.md", "your_exoskeleton.md"):
        text = (ROOT / "docs" / path).read_text("utf-8")
        for language, block in _FENCE.findall(text):
            if language != "yaml" or "subject:" in block or "..." in block:
                continue
            base = whole[0].replace("model: human # or coupled", "#")
            base += block if "model:" in block else f"model: coupled\n{block}"
            schema.load_text(base, StudyFile, f"docs/{path}")
            count += 1
    assert count >= 3


def test_the_device_in_the_page_is_worn():
    from drake_exo.files import schema
    from drake_exo.model.assembly import Assembly
    from drake_exo.model.description import models_path, nominal_human
    from drake_exo.model.device_file import with_text
    from drake_exo.model.plant import Model

    page = (ROOT / "docs" / "your_exoskeleton.md").read_text("utf-8")
    (block,) = [b for k, b in _FENCE.findall(page) if "ankle_only" in b]
    text = "\n".join(line[2:] for line in block.splitlines()[1:])
    assembly = schema.load_text(text, Assembly)
    model = Model(with_text(assembly, models_path()), nominal_human())
    assert model.coordinates.device == ("motor",)
    assert list(model.cuffs) == ["calf"]


@pytest.mark.slow
def test_the_controller_in_the_page_is_one(tmp_path, monkeypatch):
    from drake_exo.cli.predict import load_controller
    from drake_exo.collocation.kernels import ControllerKernel

    page = (ROOT / "docs" / "your_exoskeleton.md").read_text("utf-8")
    (block,) = [b for k, b in _FENCE.findall(page) if k == "python"]
    (tmp_path / "my_controller.py").write_text(block)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    kernel = ControllerKernel(load_controller("my_controller:Support"), 2)
    # The first at a right angle, the other one turning; and these torques.
    x = np.array([[np.pi / 2, 0.0, 0.0, 3.0, -10.0, -3.0]])
    np.testing.assert_allclose(kernel.evaluate(x, np.zeros((1, 1))), 0.0)


def said() -> list[str]:
    """Every string of the program; "…" where a value is put in."""
    found = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = (
                    str(v.value) if isinstance(v, ast.Constant) else "…"
                    for v in node.values
                )
                found.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return found


@pytest.mark.slow
def test_quoted_messages_exist():
    page = prose(ROOT / "docs" / "troubleshooting.md")
    quoted = re.findall(r"^\| `([^`]+)` \|", page, re.MULTILINE)
    assert len(quoted) > 35
    strings = said()
    for message in quoted:
        assert any(message in s for s in strings), message


def test_keys_are_those_of_the_program(monkeypatch):
    """If this fails: python docs/make_study_keys.py"""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import make_study_keys

    assert make_study_keys.PAGE.read_text("utf-8") == make_study_keys.page()
    sys.modules.pop("make_study_keys")


def test_the_map_is_true():
    """Every place that is named exists, and every place is named."""
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    named = re.findall(r"`((?:drake_exo|tests|models|docs)/[\w./]*)`", text)
    for place in named:
        assert (ROOT / place).exists(), place
    for path in (ROOT / "drake_exo").iterdir():
        if path.name.startswith("__"):
            continue
        place = name(path) + ("/" if path.is_dir() else "")
        assert place in named, place
    for place in re.findall(r"`phases/\w+\.py`", text):
        assert (ROOT / "drake_exo" / place.strip("`")).exists(), place


def test_pages_say_how_often_a_grid_is_refined():
    from drake_exo.calibration.solving import REFINEMENTS

    assert REFINEMENTS == 5
    places = ("docs/results.md", "docs/method.md")
    for place in (*places, "tutorials/06_calibrating.ipynb"):
        text = " ".join((ROOT / place).read_text("utf-8").split())
        assert re.search("at most five times|five times at most", text), place


def test_files_named_in_the_pages_exist():
    for page in PAGES:
        for place in re.findall(
            r"`((?:drake_exo|tests|benchmarks|docs|models)/[\w./]+\.\w+)`",
            prose(page),
        ):
            assert (ROOT / place).exists(), f"{name(page)}: {place}"


def test_every_key_of_a_case_is_in_the_soles_page():
    from drake_exo.soles.settings import Settings

    page = (ROOT / "docs" / "soles.md").read_text("utf-8")
    quoted = " ".join(re.findall(r"`([^`\n]+)`", page))
    words = set(re.findall(r"\w+", quoted))
    todo, seen = [Settings], set()
    while todo:
        cls = todo.pop()
        seen.add(cls)
        for field in dataclasses.fields(cls):
            key = field.metadata.get("key", field.name)
            assert key in words, f"{cls.__name__}.{field.name}"
        for hint in typing.get_type_hints(cls).values():
            for inner in (hint, *typing.get_args(hint)):
                if dataclasses.is_dataclass(inner) and inner not in seen:
                    todo.append(inner)
    assert len(seen) > 12


@pytest.mark.slow
def test_trials_from_arrays_are_made_as_the_page_says():
    page = (ROOT / "docs" / "your_data.md").read_text("utf-8")
    (block,) = [
        b for k, b in _FENCE.findall(page) if k == "python" and "Trial(" in b
    ]
    made = dx.synthetic.rises_in_device(1, nodes_per_second=100)
    given = made.trials[0]
    names = {
        "times": given.times,
        "q": given.q,
        "force": given.ground.force,
        "cop_x": given.ground.cop_x,
        "normal": given.cuff("pelvis").normal,
        "torques": given.device_moments,
    }
    exec(block, names)
    rise = names["rise"]
    assert names["model"] == made.model
    for name, near in (("v", 0.01), ("a", 0.5)):
        off = np.abs(getattr(rise, name) - getattr(given, name)).max()
        assert off < near, name
    assert np.abs(rise.ground.array - given.ground.array).max() < 1e-9
    assert np.abs(rise.moments - given.moments).max() < 10.0
    cuffs = names["cuffs"]
    assert names["contact"].success and cuffs.success
    assert [c.system for c in cuffs.clocks] == ["encoders", "pressure"]
    assert cuffs.rmsd()[0]["interaction_n"]["pelvis"] < 1.0


@pytest.mark.slow
def test_intervals_bands_and_nominal_cuffs_are_as_the_page_says():
    page = (ROOT / "docs" / "results.md").read_text("utf-8")
    block = [b for k, b in _FENCE.findall(page) if k == "python"][-1]
    made = dx.synthetic.rises_in_device(1, nodes_per_second=40)
    names = {"dx": dx, "trial": made.trials[0]}
    names["study"] = study = dx.Study(made.model, made.trials)
    for phase in ("interaction", "prediction"):
        solver = replace(getattr(study, phase).solver, nodes_per_second=40)
        changed = replace(getattr(study, phase), solver=solver)
        setattr(study, phase, changed)
    names["cuffs"] = dx.calibrate_interaction(study, None, made.contact)
    exec(block, names)
    known, found = names["known"], names["found"]
    assert len(known.names) == len(known.half_width)
    lower, upper = names["lower"], names["upper"]
    knee = found.coordinate("knee")
    assert ((lower < knee) & (knee < upper)).all()
    assert names["normal"].shape == found.times.shape
    assert names["usual"].posterior is None
    assert len(repr(known)) < 1000 and len(repr(names["band"])) < 200


@pytest.mark.slow
def test_a_robot_stands_on_soles_as_the_page_says(tmp_path, monkeypatch):
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia
    from pydrake.systems.analysis import (
        ApplySimulatorConfig,
        Simulator,
        SimulatorConfig,
    )
    from pydrake.systems.framework import DiagramBuilder

    page = (ROOT / "docs" / "soles.md").read_text("utf-8")
    page = page[page.index("## Under a robot of your own") :]
    put_under, fit = (b for k, b in _FENCE.findall(page) if k == "python")
    monkeypatch.chdir(tmp_path)
    Path("foot.yaml").write_text(dx.soles.EXAMPLE)
    exec(fit, {})
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    box = SpatialInertia.SolidBoxWithMass(40.0, 0.23, 0.33, 0.5)
    robot = plant.AddRigidBody("robot", box)
    for name, y in (("left_sole", 0.1), ("right_sole", -0.1)):
        X = RigidTransform([0.0, y, -0.4])
        plant.AddFrame(FixedOffsetFrame(name, robot.body_frame(), X))
    plant.Finalize()
    names = {"dx": dx, "builder": builder, "plant": plant}
    exec(put_under, names)
    simulator = Simulator(builder.Build())
    config = SimulatorConfig(
        integration_scheme="radau3", max_step_size=0.02, accuracy=1e-3
    )
    ApplySimulatorConfig(config, simulator)
    root = simulator.get_mutable_context()
    own = plant.GetMyMutableContextFromRoot(root)
    plant.SetFreeBodyPose(own, robot, RigidTransform([0.0, 0.0, 0.43]))
    simulator.AdvanceTo(1.0)
    pressed = [
        sole.GetOutputPort("spatial_reaction").Eval(
            sole.GetMyContextFromRoot(root)
        )[5]
        for sole in names["soles"]
    ]
    assert sum(pressed) == pytest.approx(40.0 * 9.81, rel=5e-3)
    # The other foot's sole is the mirror image: neither bears more.
    assert pressed[0] == pytest.approx(pressed[1], rel=1e-2)
    up = robot.EvalPoseInWorld(own).rotation().matrix()[2, 2]
    assert up > np.cos(0.02)
