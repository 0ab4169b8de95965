from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from drake_exo import Trial, read_contact, read_design, read_study, soles
from drake_exo.errors import (
    InputError,
    check_bounds,
    check_count,
    check_fields,
    check_file_name,
    nearest,
    path_of,
)

MASS = {"unit": "kg", "above": 0.0, "maximum": 300.0}


@pytest.mark.parametrize("value", [1, 0.5, 300.0, np.float32(3), np.int64(3)])
def test_numbers_within_bounds_pass(value):
    check_bounds("mass", value, MASS)
    check_bounds("mass", value, {})


@pytest.mark.parametrize("value", [1.0, 1.5, "1", None, 0, True])
def test_other_numbers_than_whole_ones_are_refused(value):
    check_count(1, 1, "trials")
    check_count(np.int64(3), 1, "trials")
    with pytest.raises(InputError, match=r"trials is .*; give a whole number"):
        check_count(value, 1, "trials")


@pytest.mark.parametrize("value", [5, 2.5, None, b"a", ["a"]])
def test_what_is_no_path_is_refused(value):
    assert path_of("a", "folder") == path_of(Path("a"), "folder") == Path("a")
    with pytest.raises(InputError, match=r"folder is .*; give a path"):
        path_of(value, "folder")


@pytest.mark.parametrize(
    "read",
    [
        read_study,
        read_contact,
        read_design,
        soles.Case.read,
        soles.find_designs,
        Trial.load,
    ],
)
def test_readers_refuse_numbers_for_paths(read):
    with pytest.raises(InputError, match="is 5; give a path"):
        read(5)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (0.0, "mass is 0, but must be above 0 kg"),
        (301, "mass is 301, but must be at most 300 kg"),
        (np.nan, "mass is nan, but must be a finite number"),
        (-np.inf, "mass is -inf, but must be a finite number"),
        ("5", "mass must be a number [kg], but is '5'"),
        (True, "mass must be a number [kg], but is True"),
        (None, "mass must be a number [kg], but is None"),
    ],
)
def test_other_values_are_refused_in_a_sentence(value, sentence):
    with pytest.raises(InputError) as caught:
        check_bounds("mass", value, MASS)
    assert str(caught.value) == sentence


def test_exclusive_and_inclusive_bounds_differ():
    share = {"unit": "1", "minimum": 0.0, "below": 1.0}
    check_bounds("share", 0.0, share)
    with pytest.raises(InputError, match=r"share is 1, but must be below 1$"):
        check_bounds("share", 1.0, share)


def test_a_value_is_told_as_it_was_written():
    with pytest.raises(InputError, match="mass is -1e0, but"):
        check_bounds("mass", -1.0, MASS, "-1e0")


@dataclass
class Ball:
    mass: float = field(metadata=MASS)
    radius: float = field(metadata={"unit": "m", "above": 0.0})


def test_a_dataclass_is_checked_field_by_field():
    check_fields(Ball(1.0, 0.1), "ball 'heel'")
    with pytest.raises(InputError) as caught:
        check_fields(Ball(1.0, 0.0), "ball 'heel'")
    assert str(caught.value) == (
        "ball 'heel': radius is 0, but must be above 0 m"
    )


def test_the_nearest_name_is_suggested_if_one_is_near():
    names = ("hip_torque", "knee_torque")
    assert nearest("hip_torqe", names) == "; did you mean 'hip_torque'?"
    assert nearest("mass", names) == nearest(None, names) == ""
    found = nearest("L_calc", ("r_calc", "S4:L_calc"))
    assert found == "; did you mean 'S4:L_calc'?"
    assert nearest("L_calc", ("r_calc", "LCALC")).endswith("'LCALC'?")
    # A key of old that is gone is no misspelt other one.
    assert nearest("use_tr", ("strain", "starts")) == ""


@pytest.mark.parametrize("name", ["rise1", "Aufstehen 2 (links)", "a.b-c+d_é"])
def test_names_that_files_can_have_pass(name):
    check_file_name("trials[0].name", name)


@pytest.mark.parametrize(
    "name", ["", " ", "..", "a/b", "../x", "a\\b", "a\nb", "<i>", "x" * 101]
)
def test_names_that_no_file_should_have_are_refused(name):
    with pytest.raises(InputError, match="names files"):
        check_file_name("trials[0].name", name)
