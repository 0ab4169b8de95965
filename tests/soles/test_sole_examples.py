"""The public names: documented, with examples that run."""

import doctest
import inspect
import re
from pathlib import Path

import pytest

from drake_exo import soles

pytestmark = pytest.mark.slow

NAMES = [name for name in soles.__all__ if name != "EXAMPLE"]
_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def _examples(thing) -> list[doctest.DocTest]:
    found = doctest.DocTestFinder(recurse=False).find(thing)
    return [test for test in found if test.examples]


@pytest.mark.parametrize("name", NAMES)
def test_every_name_has_an_example_that_runs(name):
    (example,) = _examples(getattr(soles, name))
    runner = doctest.DocTestRunner(optionflags=_FLAGS)
    assert runner.run(example).failed == 0


def test_the_front_pages_example_runs():
    (example,) = _examples(soles)
    runner = doctest.DocTestRunner(optionflags=_FLAGS)
    assert runner.run(example).failed == 0


@pytest.mark.parametrize("name", NAMES)
def test_every_public_member_is_documented(name):
    thing = getattr(soles, name)
    members = vars(thing) if inspect.isclass(thing) else {}
    for member, value in members.items():
        described = callable(value) or isinstance(
            value, property | classmethod | staticmethod
        )
        if not member.startswith("_") and described:
            assert inspect.getdoc(value), f"{name}.{member}"


def test_an_unknown_name_is_an_error():
    with pytest.raises(AttributeError, match="Sole"):
        soles.Sole  # noqa: B018 - the access is what is tested


def test_the_pages_example_runs(tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "soles.md").read_text("utf-8")
    # The two that follow are of a robot: tests/docs.
    block, _, _ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "case.yaml").write_text(soles.EXAMPLE)
    monkeypatch.chdir(tmp_path)
    exec(block, {})
    for name in ("step.html", "best/sole.stl", "best/summary.json"):
        assert (tmp_path / name).stat().st_size > 1000
