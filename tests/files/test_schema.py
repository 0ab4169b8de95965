import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files import schema


@dataclass(frozen=True)
class Segment:
    length_m: float = field(
        default=0.4, metadata={"unit": "m", "above": 0.0, "maximum": 1.0}
    )
    com_m: tuple[float, float] = (0.0, 0.2)


@dataclass(frozen=True)
class Subject:
    name: str
    mass_kg: float = field(metadata={"unit": "kg", "above": 0.0})
    segments: dict[str, Segment] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    subject: Subject
    model: Literal["coupled", "human"] = "coupled"
    trials: list[str] = field(default_factory=list)
    plates: dict[Literal["left", "right"], int] = field(default_factory=dict)
    start_s: float | None = None
    order: int = field(default=4, metadata={"minimum": 2})
    report: bool = True
    folder: Path = Path(".")
    weights: tuple[float, ...] = field(default=(), metadata={"minimum": 0.0})
    filter: Segment | float = 6.0
    extra: Any = None


GOOD = """\
subject:
  name: S4
  mass_kg: 60
  segments:
    shank: {length_m: 0.41, com_m: [0, 0.2]}
model: human
trials: [a, b]
plates: {left: 2, right: 1}
start_s: 1e-1
order: 2
report: no
folder: here/there
weights: [1, 0, 2.5]
filter: {length_m: 0.3}
extra: {a: [1, 2]}
"""


def refusal(text: str) -> str:
    with pytest.raises(InputError) as caught:
        schema.load_text(text, Study, "study.yaml")
    message = str(caught.value)
    assert "\n" not in message
    return message


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return refusal(GOOD.replace(old, new))


def test_a_text_of_several_lines_is_one():
    """As the description of a device in model.json."""
    study = schema.load_text(GOOD.replace("S4", '"a\\n\\tb"'), Study)
    assert study.subject.name == "a\n\tb"


def test_reads_every_kind_of_value():
    study = schema.load_text(GOOD, Study)
    assert study.subject == Subject(
        "S4", 60.0, {"shank": Segment(0.41, (0.0, 0.2))}
    )
    assert isinstance(study.subject.mass_kg, float)
    assert study.model == "human"
    assert study.trials == ["a", "b"]
    assert study.plates == {"left": 2, "right": 1}
    assert study.start_s == 0.1
    assert study.order == 2
    assert study.report is False
    assert study.folder == Path("here/there")
    assert study.weights == (1.0, 0.0, 2.5)
    assert study.filter == Segment(0.3)
    assert study.extra == {"a": [1, 2]}


def test_defaults_and_null():
    text = "subject: {name: x, mass_kg: 1}\nstart_s: null\n"
    study = schema.load_text(text, Study)
    assert study.start_s is None
    assert study == Study(Subject("x", 1.0))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("1e-1", "none", "study.yaml:9: start_s is 'none'; write null"),
        # Not where a word may stand, nor where null may not.
        ("name: S4", "name: none", None),
        (
            "mass_kg: 60",
            "mass_kg: none",
            "must be a number [kg], but is 'none'",
        ),
        ("{length_m: 0.3}", "none", "filter must be a number, but is 'none'"),
    ],
)
def test_none_is_told_to_be_null(old, new, told):
    text = GOOD.replace(old, new)
    if told is None:
        assert schema.load_text(text, Study).subject.name == "none"
    else:
        assert told in changed(old, new)


def test_dump_reads_back():
    study = schema.load_text(GOOD, Study)
    assert schema.load_text(schema.dump_text(study), Study) == study


def test_result_is_frozen():
    study = schema.load_text(GOOD, Study)
    with pytest.raises(dataclasses.FrozenInstanceError):
        study.subject.mass_kg = 2.0


def test_misspelt_key_names_file_line_and_nearest():
    assert changed("mass_kg", "mas_kg") == (
        "study.yaml:3: unknown key 'mas_kg' in subject; did you mean 'mass_kg'?"
    )


def test_alien_key_lists_known_ones():
    message = changed("model:", "zzz:")
    assert message.startswith("study.yaml:6: unknown key 'zzz'; known keys")
    assert "subject" in message


def test_duplicate_key_names_both_lines():
    message = changed("model: human", "model: human\nmodel: coupled")
    assert message.startswith("study.yaml:7: duplicate key 'model'")
    assert "line 6" in message


def test_duplicate_key_in_a_dict():
    message = changed("left: 2,", "left: 2, left: 1,")
    assert message.startswith("study.yaml:8: duplicate key 'left' in plates")


@pytest.mark.parametrize("number", ["2,5", "2,000,000"])
def test_a_comma_in_a_number_is_told(number):
    """It was a key '000', given twice: keep one of them."""
    message = changed("left: 2,", f"left: {number},")
    assert message.startswith("study.yaml:8: plates has '")
    assert "after a comma; write numbers with a point" in message


def test_missing_key_tells_unit():
    message = changed("  mass_kg: 60\n", "")
    assert message.startswith("study.yaml:2: missing key 'mass_kg' in subject")
    assert "kg" in message


def test_empty_text_misses_its_first_key():
    assert refusal("") == (
        "study.yaml:1: missing key 'subject'; add 'subject: ...'"
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass_kg: 60", "mass_kg: heavy", "3: subject.mass_kg must be a num"),
        ("mass_kg: 60", "mass_kg: '60'", "subject.mass_kg must be a number"),
        ("mass_kg: 60", "mass_kg: true", "must be a number"),
        ("mass_kg: 60", "mass_kg:", "but is empty"),
        ("mass_kg: 60", "mass_kg: .nan", "finite"),
        ("mass_kg: 60", "mass_kg: nan", "finite"),
        ("mass_kg: 60", "mass_kg: -.inf", "finite"),
        ("mass_kg: 60", "mass_kg: 1e999", "too large"),
        ("mass_kg: 60", "mass_kg: 0", "subject.mass_kg is 0, but must be abo"),
        ("mass_kg: 60", "mass_kg: -3", "above 0 kg"),
        ("length_m: 0.41", "length_m: 1.5", "at most 1 m"),
        ("com_m: [0, 0.2]", "com_m: [0]", "must hold 2 values, not 1"),
        ("com_m: [0, 0.2]", "com_m: 3", "must be a list"),
        ("model: human", "model: humen", "did you mean 'human'?"),
        ("trials: [a, b]", "trials: a", "trials must be a list"),
        ("right: 1", "righ: 1", "did you mean 'right'?"),
        ("order: 2", "order: 2.5", "whole number"),
        ("order: 2", "order: 1", "at least 2"),
        ("report: no", "report: maybe", "true or false"),
        ("[1, 0, 2.5]", "[1, -1]", "weights[1] is -1"),
        ("filter: {length_m: 0.3}", "filter: {lenth_m: 1}", "'length_m'?"),
        ("filter: {length_m: 0.3}", "filter: six", "must be a number"),
        ("subject:\n", "subject: 3\nother:\n", "unknown key 'other'"),
        ("model: human", "model: [human", "not valid YAML"),
        ("model: human", f"model: {'[' * 3000}", "not valid YAML"),
        ("name: S4", 'name: "S\\ud800"', r"subject.name is 'S\ud800', with a"),
        ("here/there", '"a\\0b"', r"folder is 'a\x00b', with a character"),
    ],
)
def test_refuses(old, new, words):
    message = changed(old, new)
    assert words in message
    assert message.startswith("study.yaml:")


def test_post_init_complaints_carry_file_and_line():
    @dataclass(frozen=True)
    class Window:
        start_s: float
        end_s: float

        def __post_init__(self):
            if self.end_s <= self.start_s:
                raise ValueError("end_s must be after start_s")

    @dataclass(frozen=True)
    class Outer:
        window: Window

    text = "\nwindow:\n  start_s: 2\n  end_s: 1\n"
    # Where the key stands that the sentence begins with.
    with pytest.raises(InputError, match=r"f:4: window: end_s must be after"):
        schema.load_text(text, Outer, "f")


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        schema.load(tmp_path / "none.yaml", Study)
    os.mkfifo(tmp_path / "p.yaml")
    with pytest.raises(InputError, match=r"p\.yaml: .*no regular file"):
        schema.load(tmp_path / "p.yaml", Study)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"b\.yaml: is not a text file"):
        schema.load(binary, Study)
    control = tmp_path / "c.yaml"
    control.write_bytes(b"a: \x00\x01")
    with pytest.raises(InputError, match=r"c\.yaml: is not valid YAML"):
        schema.load(control, Study)


def test_loads_file(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(GOOD)
    assert schema.load(path, Study).subject.name == "S4"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model": "foo"}, "settings: model must be one of coupled, human"),
        ({"start_s": float("nan")}, "settings: start_s is .*finite"),
        ({"order": 1}, "settings: order is 1, but must be at least 2"),
        ({"order": "3"}, "settings: order must be a whole number"),
        ({"filter": Segment(2.0)}, r"filter\.length_m is 2"),
        ({"folder": object()}, "settings: .*object object"),
    ],
)
def test_settings_made_in_python_are_held_to_the_same(changes, words):
    made = schema.load_text(GOOD, Study)
    assert schema.check(made, Study, "settings") == made
    numbers = dataclasses.replace(made, start_s=np.float64(0.1))
    schema.check(numbers, Study, "settings")
    with pytest.raises(InputError, match=words):
        schema.check(dataclasses.replace(made, **changes), Study, "settings")


def test_groups_made_in_python_are_read_as_in_a_file():
    made = schema.load_text(GOOD, Study)
    given = dataclasses.replace(made, filter={"length_m": 0.5})
    found = schema.check(given, Study, "settings")
    assert found == dataclasses.replace(made, filter=Segment(0.5))
    wrong = dataclasses.replace(made, filter={"lenght_m": 0.5})
    with pytest.raises(InputError, match="settings: unknown key 'lenght_m'"):
        schema.check(wrong, Study, "settings")


def test_settings_of_another_class_are_refused():
    with pytest.raises(InputError, match=r"settings is .*order.*; give a St"):
        schema.check({"order": 2}, Study, "settings")


def test_a_subclass_does_for_what_it_inherits():
    @dataclass(frozen=True)
    class Longer(Segment):
        more: float = 3.0

    @dataclass(frozen=True)
    class Holder:
        segment: Segment = field(default_factory=Segment)

    schema.check(Holder(Longer()), Holder, "h")
    with pytest.raises(InputError, match=r"h: segment\.length_m is 7"):
        schema.check(Holder(Longer(7.0)), Holder, "h")


def test_dates_are_text_where_anything_may_stand():
    text = GOOD.replace("{a: [1, 2]}", "[2024-01-31, 2024-13-01]")
    extra = schema.load_text(text, Study).extra
    assert extra == ["2024-01-31", "2024-13-01"]


@pytest.mark.parametrize("value", ["!of_ours 3", "{[1]: 2}", "!!int x"])
def test_what_is_no_value_is_refused_where_anything_may_stand(value):
    text = GOOD.replace("{a: [1, 2]}", value)
    with pytest.raises(InputError, match="extra is not a text, number"):
        schema.load_text(text, Study)
