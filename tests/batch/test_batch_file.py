"""What a batch file may say, and which tasks come of it."""

import dataclasses
import re
import typing
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from drake_exo.batch.file import (
    SOLE_KEYS,
    BatchFile,
    Entry,
    SeedRange,
    _digests,
    changed_text,
    check_key,
    entries,
    tasks_of,
)
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.soles.settings import Settings
from drake_exo.study import StudyFile


def batch(text):
    return schema.load_text(text, BatchFile, "batch.yaml")


@pytest.fixture
def folder(tmp_path):
    for name in ("anna", "bert"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "study.yaml").write_text("standing: {m: a.trc}\n")
        (tmp_path / name / "a.trc").write_text(name)
    return tmp_path


def keys(folder, text="steps: [check]\nstudies: ['*/study.yaml']"):
    return {t.name: t.key for t in tasks_of(batch(text), folder)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("steps: [chek]\nstudies: [a]", "did you mean 'check'"),
        ("steps: []\nstudies: [a]", "no step uses the studies"),
        ("steps: [check]", "needs studies or laboratories"),
        ("steps: [check]\nstudies: [a]\ncases: [b]", "uses the cases"),
        (
            "steps: [predict]\nstudies: [a]",
            "builds on 'calibrate'; add calibrate to",
        ),
        ("steps: [check]\nstudies: [a]\nsweep: {a.b: []}", "has no values"),
        ("steps: [check]\nstudies: [a]\nsweep: {a: [1, 1]}", "given twice"),
        ("steps: [check]\nstudies: [a]\noptions: {check: [--out]}", "itself"),
        (
            "steps: [check]\nstudies: [a]\nsweep: {cost.weight: [1]}",
            "'cost.weight' is a key of a case file, but the batch has no cases",
        ),
        (
            "steps: [sole simulate]\ncases: [a]\nsweep: [{model: human}]",
            "'model' is a key of a study file, but the batch has no studies",
        ),
        (
            "steps: [check]\nstudies: [a]\noptions: {check: [--data=b]}",
            "gives --data-root; leave --data=b out",
        ),
        (
            "steps: [check]\nstudies: [a]\noptions: {predict: [x]}",
            "not one of the steps",
        ),
        ("steps: [check]\nlaboratories: {seeds: [-1]}", "at least 0"),
        (
            "steps: [check]\n"
            f"laboratories: {{seeds: {{first: 3, last: {10**20}}}}}",
            "give 100000 at most",
        ),
        (
            "steps: [check]\nlaboratories: {seeds: {first: 3, last: 1}}",
            "before first",
        ),
        ("steps: [check]\nlaboratories: {seeds: []}", "give at least one"),
        (
            "steps: [check]\nlaboratories: {seeds: [1], trials: 10}",
            "trials is 10, but must be at most 9",
        ),
    ],
)
def test_bad_files(text, words):
    with pytest.raises(InputError, match=words):
        batch(text)


def test_a_pattern_that_finds_nothing(folder):
    with pytest.raises(InputError, match="finds no file"):
        entries(batch("steps: [check]\nstudies: [no/*.yaml]"), folder)


def test_a_folder_whose_name_looks_like_a_pattern(folder):
    odd = folder / "exo[1]*"
    (odd / "carl").mkdir(parents=True)
    (odd / "carl" / "study.yaml").write_text("")
    text = "steps: [check]\nstudies: ['*/study.yaml', ../anna/study.yaml]"
    (own, other), _ = entries(batch(text), odd)
    assert own == Entry("carl", odd / "carl" / "study.yaml")
    assert other == Entry("anna", folder / "anna" / "study.yaml")


def test_two_of_one_name(folder):
    (folder / "anna.yaml").write_text("")
    text = "steps: [check]\nstudies: ['*.yaml', '*/study.yaml']"
    with pytest.raises(InputError, match="both be called 'anna'"):
        entries(batch(text), folder)


def test_a_folder_of_data_that_is_none(folder):
    text = "steps: [check]\nstudies: ['*/study.yaml']\ndata_root: nix"
    with pytest.raises(InputError, match="data_root: nix is not a folder"):
        tasks_of(batch(text), folder)


def test_results_never_lie_among_those_of_another(folder):
    """One of them would be replaced with the other."""
    (folder / "anna" / "check.yaml").write_text("")
    text = "steps: [check]\nstudies: ['anna/*.yaml']"
    with pytest.raises(
        InputError, match="'anna/check' would be written among those"
    ):
        tasks_of(batch(text), folder)
    (folder / "anna" / "check.yaml").rename(folder / "anna" / "other.yaml")
    names = ["anna/other/check", "anna/check"]
    assert [t.name for t in tasks_of(batch(text), folder)] == names


def test_a_range_of_seeds_may_begin_anywhere():
    assert SeedRange(200_000, 299_999).last == 299_999
    with pytest.raises(InputError, match="are 100001 subjects"):
        SeedRange(200_000, 300_000)


def test_a_seed_and_a_study_of_one_name(folder):
    (folder / "seed_1.yaml").write_text("")
    text = "steps: [check]\nstudies: [seed_1.yaml]\nlaboratories: {seeds: [1]}"
    with pytest.raises(
        InputError, match=r"seed_1\.yaml and laboratories would"
    ):
        entries(batch(text), folder)


def test_the_graph():
    text = """
steps: [check, calibrate, predict, design]
laboratories: {seeds: {first: 2, last: 3}, truth: near, trials: 4}
sweep:
  interaction.thigh.normal_n_m.nominal: [2000, 5000]
  filter.cutoff_hz: [6.0]
options: {predict: [--scale-interaction, '1.4']}
"""
    tasks = {t.name: t for t in tasks_of(batch(text), Path("."))}
    place = "seed_2/interaction.thigh.normal_n_m.nominal=2000,filter."
    place += "cutoff_hz=6"
    assert len(tasks) == 2 * (1 + 2 * 4)
    predict = tasks[f"{place}/predict"]
    assert predict.needs == {
        "lab": "seed_2/lab",
        "calibrate": f"{place}/calibrate",
    }
    assert tasks[f"{place}/design"].needs == predict.needs
    assert predict.options == ("--scale-interaction", "1.4")
    assert tasks["seed_3/lab"].options == (
        *("--seed", "3", "--truth", "near", "--trials", "4"),
    )
    assert next(iter(tasks)) == "seed_2/lab"


def test_a_list_of_combinations(folder):
    text = """
steps: [check]
studies: [anna/study.yaml]
sweep: [{filter.cutoff_hz: 5}, {filter.cutoff_hz: 8, model: human}]
"""
    assert list(keys(folder, text)) == [
        "anna/filter.cutoff_hz=5/check",
        "anna/filter.cutoff_hz=8,model=human/check",
    ]


def test_each_key_goes_where_it_belongs(folder):
    (folder / "brick.yaml").write_text("name: brick")
    text = """
steps: [check, sole optimize]
studies: [anna/study.yaml]
cases: [brick.yaml]
sweep: {filter.cutoff_hz: [5, 6], contact.friction: [0.5, 0.8]}
"""
    assert list(keys(folder, text)) == [
        "anna/filter.cutoff_hz=5/check",
        "anna/filter.cutoff_hz=6/check",
        "brick/contact.friction=0.5/sole_optimize",
        "brick/contact.friction=0.8/sole_optimize",
    ]
    own = {key.partition(".")[0] for key in SOLE_KEYS}
    assert own == {f.name for f in fields(Settings)}
    for key in SOLE_KEYS:
        check_key(Settings, key)
        with pytest.raises(InputError, match=f"'{key}' is not a key"):
            check_key(StudyFile, key)


def test_keys_follow_contents_alone(folder):
    first = keys(folder)
    assert keys(folder) == first
    (folder / "anna" / "a.trc").write_text("changed")
    second = keys(folder)
    assert second["anna/check"] != first["anna/check"]
    assert second["bert/check"] == first["bert/check"]
    (folder / "anna" / "a.trc").unlink()
    assert keys(folder)["anna/check"] != second["anna/check"]
    (folder / "anna" / "study.yaml").write_text("not: [valid")
    assert keys(folder)["bert/check"] == first["bert/check"]
    options = "steps: [check]\nstudies: ['bert/*.yaml']\n"
    changed = keys(folder, options + "options: {check: [--accept, all]}")
    assert changed["bert/check"] != first["bert/check"]


def test_files_of_a_sweep_and_of_options_count(folder):
    (folder / "bert" / "b.trc").write_text("1")
    (folder / "cuffs").mkdir()
    (folder / "cuffs" / "design.yaml").write_text("1")
    text = (
        "steps: [check]\nstudies: ['bert/*.yaml']\n"
        "sweep: {standing.m: [a.trc, b.trc]}\n"
        "options: {check: [--design=cuffs, --controller, mine:make]}"
    )
    first = keys(folder, text)
    a, b = (f"bert/standing.m={x}.trc/check" for x in "ab")
    (folder / "bert" / "b.trc").write_text("2")
    second = keys(folder, text)
    assert second[a] == first[a] and second[b] != first[b]
    (folder / "cuffs" / "design.yaml").write_text("2")
    third = keys(folder, text)
    assert third[a] != second[a] and third[b] != second[b]
    (folder / "mine.py").write_text("make = 1")
    fourth = keys(folder, text)
    assert fourth[a] != third[a] and fourth[b] != third[b]


def test_folders_elsewhere_count_with_all_that_is_in_them(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / "a.yaml").write_text("1")
    text = (
        "steps: [check]\nstudies: ['bert/*.yaml']\n"
        f"options: {{check: [--design, {other}]}}"
    )
    first = keys(folder, text)
    (other / "a.yaml").write_text("2")
    assert keys(folder, text) != first


def test_a_laboratory_reads_its_own_data(folder):
    text = (
        "steps: [check]\nstudies: ['bert/*.yaml']\ndata_root: bert\n"
        "laboratories: {seeds: [3]}"
    )
    roots = {t.name: t.root for t in tasks_of(batch(text), folder)}
    assert roots["seed_3/check"] is None
    assert roots["bert/check"] == folder / "bert"


def test_values_that_are_close_are_told_apart(folder):
    text = (
        "steps: [check]\nstudies: ['bert/*.yaml']\n"
        "sweep: {subject.mass_kg: [70.12341, 70.12342, 70.0]}"
    )
    close = ("70.12341", "70.12342", "70")
    assert set(keys(folder, text)) == {
        f"bert/subject.mass_kg={x}/check" for x in close
    }


STUDY = """
subject: {name: a, mass_kg: 70, height_m: 1.8, sex: male}
standing: {markers: standing.trc}
markers:
  joint_centres:
    ankle: {left: [a], right: [b]}
    knee: {left: [a], right: [b]}
    hip: {left: [a], right: [b]}
  segments:
    foot: {left: [a], right: [b]}
    shank: {left: [a], right: [b]}
    thigh: {left: [a], right: [b]}
    pelvis: {left: [a], right: [b]}
trials:
  - {name: t, markers: t.trc, forces: t.mot, plates: {both: 1}}
"""


@pytest.mark.slow
def test_any_key_can_be_changed(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    changes = {
        "interaction.thigh.normal_n_m.nominal": 2500,
        "trials.0.use": "prediction",
        "foot_ground.law": "paper",
    }
    for key in changes:
        check_key(StudyFile, key)
    found = schema.load_text(
        changed_text(path, StudyFile, changes), StudyFile, "changed"
    )
    whole = schema.load(path, StudyFile)
    assert found.interaction.thigh.normal_n_m.nominal == 2500
    assert found.trials[0].use == "prediction"
    assert found.foot_ground.law == "paper"
    thigh = whole.interaction.thigh
    assert found.interaction.shank == whole.interaction.shank
    assert found.interaction.thigh.normal_n_m.lower == thigh.normal_n_m.lower
    # Without changes the text says the same.
    again = schema.load_text(changed_text(path, StudyFile, {}), StudyFile)
    assert again == whole


def test_keys_that_are_none(tmp_path):
    with pytest.raises(InputError, match="did you mean 'normal_n_m'"):
        check_key(StudyFile, "interaction.thigh.normal_nm.nominal")
    with pytest.raises(InputError, match="did you mean 'friction'"):
        check_key(Settings, "contact.frction")
    check_key(StudyFile, "mats.left.file")
    # Names of files, where fields have others.
    check_key(StudyFile, "trials.0.from")
    check_key(Settings, "load.to")
    with pytest.raises(InputError, match="'begin' is unknown"):
        check_key(Settings, "load.begin")
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    with pytest.raises(InputError, match=r"has no key .trials\.1\.use"):
        changed_text(path, StudyFile, {"trials.1.use": "prediction"})


def named_groups(cls, place=""):
    """Dotted keys of the groups in a study whose names are the user's."""
    for key, hint in schema.keys(cls).items():
        for option in (hint, *typing.get_args(hint)):
            if dataclasses.is_dataclass(option):
                yield from named_groups(option, f"{place}{key}.")
        values = typing.get_args(hint)[-1:]
        if typing.get_origin(hint) is dict and any(
            map(dataclasses.is_dataclass, values)
        ):
            yield f"{place}{key}.NAME"


def test_the_page_lists_every_group_with_a_name():
    page = Path(__file__).parents[2] / "docs" / "batches.md"
    told = re.findall(r"`([\w.]+\.NAME)`", page.read_text("utf-8"))
    assert set(told) == set(named_groups(StudyFile))


def test_case_files_too(tmp_path):
    from drake_exo.soles.case import EXAMPLE

    path = tmp_path / "case.yaml"
    path.write_text(EXAMPLE)
    text = changed_text(path, Settings, {"contact.friction": 0.5})
    assert schema.load_text(text, Settings).contact.friction == 0.5
    assert yaml.safe_load(text)["name"] == "example"
    # A group that the case leaves out.
    text = changed_text(path, Settings, {"ground.heights": "a.csv"})
    assert yaml.safe_load(text)["ground"] == {"heights": f"{tmp_path}/a.csv"}


@pytest.mark.parametrize("root", ["", "data_root: data/all\n"])
def test_recordings_of_a_case_count(folder, root):
    """They are named by a study beside the case, wherever its data are."""
    place = folder / ("data/all" if root else "anna")
    place.mkdir(parents=True, exist_ok=True)
    (place / "a.trc").write_text("1")
    case = "load: {recording: ../anna/study.yaml}\n"
    (folder / "bert" / "sole.yaml").write_text(case)
    text = f"steps: [sole simulate]\ncases: [bert/sole.yaml]\n{root}"
    first = keys(folder, text)
    (place / "a.trc").write_text("2")
    second = keys(folder, text)
    assert second != first
    (folder / "anna" / "study.yaml").write_text("standing: {n: a.trc}\n")
    assert keys(folder, text) != second


def test_a_swept_recording_counts_with_all_that_it_names(folder):
    (folder / "case.yaml").write_text("load: {}")
    text = (
        "steps: [sole simulate]\ncases: [case.yaml]\n"
        "sweep: {load.recording: [anna/study.yaml, bert/study.yaml]}"
    )
    first = keys(folder, text)
    (folder / "anna" / "a.trc").write_text("2")
    second = keys(folder, text)
    assert [second[task] != first[task] for task in first] == [True, False]


def test_files_that_name_each_other_come_to_an_end(tmp_path):
    (tmp_path / "a.yaml").write_text("[a.yaml, b.yaml]")
    (tmp_path / "b.yaml").write_text("[a.yaml, b.yaml]")
    names = {"a.yaml", "b.yaml"}
    assert set(_digests(tmp_path / "a.yaml", None)) == {""} | {
        f"{name}{further}"
        for name in names
        for further in ("", " ", *(f" {other}" for other in names))
    }


@pytest.mark.parametrize("root", [None, Path("/data")])
def test_a_swept_case_finds_its_files(tmp_path, root):
    """It is written elsewhere; of a root's folder paths stay as they were."""
    path = tmp_path / "case.yaml"
    path.write_text(
        "name: s\nmesh: {file: a.stl}\nmaterial: {name: neoprene}\n"
        "ground: {heights: a.csv}\nloads:\n"
        "- {recording: study.yaml, trial: walk, foot: left}\n"
        "- {csv: {file: ../b.csv}}\n"
    )
    beside = Path("") if root else tmp_path
    for changes in ({"contact.friction": 0.5}, {"loads.0.trial": "run"}):
        tree = yaml.safe_load(changed_text(path, Settings, changes, root))
        walk, other = tree["loads"]
        assert walk["recording"] == str(tmp_path / "study.yaml")
        assert tree["mesh"]["file"] == str(beside / "a.stl")
        assert tree["ground"]["heights"] == str(beside / "a.csv")
        theirs = "../b.csv" if root else str(tmp_path.parent / "b.csv")
        assert other["csv"]["file"] == theirs
