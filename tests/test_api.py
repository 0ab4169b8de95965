"""The public names: documented, with examples that run, and on one page."""

import doctest
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import drake_exo as dx
from drake_exo.files.output import Progress

ROOT = Path(__file__).resolve().parents[1]
_PLACES = {
    "": dx,
    **{
        f"{room}.": getattr(dx, room)
        for room in ("contact", "settings", "soles", "synthetic")
    },
}
MODULES = [place.__name__ for place in _PLACES.values()]
NAMES = [
    prefix + name
    for prefix, place in _PLACES.items()
    for name in place.__all__
    if callable(getattr(place, name))
]


def found(name: str):
    prefix, _, last = name.rpartition(".")
    return getattr(_PLACES[f"{prefix}." if prefix else ""], last)


def test_there_are_not_many():
    assert len(dx.__all__) <= 38
    assert set(dx.__all__) <= set(dir(dx))


def test_unknown_names_are_told():
    with pytest.raises(AttributeError, match="no attribute 'predikt'"):
        dx.predikt  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_documentation_has_an_example_that_runs(name, monkeypatch):
    """Progress depends on the clock: examples show none."""
    monkeypatch.setattr(Progress, "update", lambda *_, **more: None)
    thing = found(name)
    text = inspect.getdoc(thing)
    assert text and text.strip(), f"{name} is not documented"
    module = sys.modules[getattr(thing, "__module__", "drake_exo")]
    finder = doctest.DocTestFinder(recurse=False)
    # A template's documentation is that of the function that defines it.
    own = vars(module) | {name.rpartition(".")[2]: thing}
    (test, *_) = finder.find(_documented(thing, text), name, globs=own)
    assert test.examples, f"{name} has no example"
    results = doctest.DocTestRunner(
        verbose=False, optionflags=doctest.ELLIPSIS
    ).run(test)
    assert results.failed == 0


@pytest.mark.slow
def test_examples_of_what_is_not_public_run_too():
    public = {name.rpartition(".")[2] for name in NAMES} | set(MODULES)
    run = 0
    for found in pkgutil.walk_packages(dx.__path__, "drake_exo."):
        if found.name.endswith(("__main__", "_child")):
            continue  # they are run, not imported
        module = importlib.import_module(found.name)
        for test in doctest.DocTestFinder().find(module, found.name):
            own = test.name.removeprefix(f"{found.name}.")
            own = own.partition("_𝓣")[0]  # Drake's name of an instance
            if test.examples and not public & {own, test.name}:
                runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
                assert runner.run(test).failed == 0, test.name
                run += 1
    assert run > 20


def _documented(thing, text: str):
    """Something with this documentation, which doctest takes."""

    def stand_in():
        """See below."""

    stand_in.__doc__ = text
    return stand_in


def test_light_names_do_not_load_the_exoskeleton_half():
    code = (
        "import sys, drake_exo as dx\n"
        "dx.InputError, dx.soles\n"
        "bad = [m for m in sys.modules if m.startswith('pydrake.multibody')"
        " or m.startswith('drake_exo.model')]\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_the_page_of_all_names_is_made(tmp_path):
    """`make docs` writes it from the docstrings."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "make_api.py"), str(tmp_path)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    for name in NAMES:
        prefix, _, last = name.rpartition(".")
        page = tmp_path / "drake_exo.html"
        if prefix:
            place = _PLACES[f"{prefix}."].__name__.replace(".", "/")
            page = tmp_path / f"{place}.html"
        text = page.read_text("utf-8")
        assert f'id="{last}"' in text, name
        # With what it is, not the name alone; a template has no source.
        if getattr(found(name), "__name__", "") == last:
            assert f"{last}-view-source" in text, name
        else:
            assert f'class="name">{last}</span><wbr>(' in text, name
    # What a posed problem inherits, and what functions return.
    problems = tmp_path / "drake_exo" / "calibration" / "problem.html"
    assert 'id="PhaseProblem.solve"' in problems.read_text("utf-8")
    assert "problem.html#PhaseProblem.solve" in (
        tmp_path / "drake_exo.html"
    ).read_text("utf-8")
    diagrams = tmp_path / "drake_exo" / "contact" / "diagram.html"
    assert "energies; input" in diagrams.read_text("utf-8")


@pytest.mark.parametrize(
    ("room", "wrong", "right"),
    [
        (dx, "read_stdy", "read_study"),
        (dx.contact, "FootGroundContct", "FootGroundContact"),
        (dx.soles, "Cse", "Case"),
    ],
)
def test_a_misspelt_name_tells_the_right_one(room, wrong, right):
    with pytest.raises(AttributeError, match=f"did you mean '{right}'"):
        getattr(room, wrong)
