"""The planter of errors: what it plants, where, and that tests notice."""

import ast
import sys

import mutants
import pytest
from mutants import ROOT, Copy, Mutant, drawn, sites
from mutants_listed import LISTED, TESTS

SOURCE = '''
def area(width: "tuple[0]", height=[1.0][0]):
    """A text * 2 stays."""
    if width < 0:
        raise ValueError(f"width is {-width + 1}")
    name = "a" + "b"
    turned = np.deg2rad(width)
    return 1e3 * width - height[-1], turned
'''


def planted(source=SOURCE):
    return {
        (kind, ast.get_source_segment(source, node)): new
        for kind, node, new in sites(ast.parse(source))
    }


def test_what_may_be_planted():
    found = planted()
    assert found == {
        ("sign", "1e3 * width - height[-1]"): (
            "(1000.0 * width + (height[-1]))"
        ),
        ("dropped term", "1e3 * width - height[-1]"): "(1000.0 * width)",
        ("factor 2", "1e3 * width"): "(2 * (1000.0 * width))",
        ("dropped factor", "1e3 * width"): "(1000.0)",
        ("index", "0"): "1",
        ("index", "-1"): "-2",
        ("unit", "1e3"): "1.0",
        ("unit", "np.deg2rad(width)"): "(width)",
    }


@pytest.mark.slow
def test_drawn_errors_are_many_repeatable_and_python():
    found = drawn(40, 3)
    assert found == drawn(40, 3)
    assert len(set(found)) == 40
    assert len({m.kind for m in found}) >= 5
    assert len({m.file for m in found}) >= 20
    for mutant in found:
        source = (ROOT / mutant.file).read_bytes()
        changed = mutant.planted(source)
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(source))


def test_the_list_is_long_and_says_what_fits_no_more(monkeypatch):
    assert sum(map(len, LISTED.values())) >= 100
    assert mutants.listed([])[1] == []
    file = "drake_exo/errors.py"
    monkeypatch.setitem(LISTED, file, [("import no such thing", ""), ("e", "")])
    found, wrong = mutants.listed([file])
    assert found == []
    assert wrong[0].startswith(f"{file}: found 0 times, not once")
    assert len(wrong) == 2 and "found 0" not in wrong[1]


def test_every_file_has_tests():
    for tests in TESTS.values():
        assert all((ROOT / test.split("::")[0]).exists() for test in tests)
    for file in LISTED:
        assert (ROOT / file).is_file()
    near, *_ = mutants.tests_of("drake_exo/report/gathering.py")
    assert near == ["tests/report/test_tables.py"]


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A checkout of one function and its test."""
    file = "drake_exo/doubled.py"
    for name, text in (
        (file, "def doubled(x):\n    return x + x  # a remark\n"),
        (
            "tests/test_doubled.py",
            "from drake_exo.doubled import doubled\n\n"
            "def test_it():\n    assert doubled(3) == 6\n",
        ),
        ("drake_exo/__init__.py", ""),
        ("pyproject.toml", "[tool.pytest.ini_options]\n"),
    ):
        path = tmp_path / "checkout" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(mutants, "ROOT", tmp_path / "checkout")
    monkeypatch.setitem(TESTS, "drake_exo/", ["tests/test_doubled.py"])
    for name in [n for n in sys.modules if n.startswith("drake_exo")]:
        monkeypatch.delitem(sys.modules, name)
    return tmp_path / "checkout" / file


@pytest.mark.slow
def test_an_error_is_killed_and_a_changed_remark_survives(small, tmp_path):
    """In a copy; the working tree stays as it is."""
    source = small.read_bytes()
    copy = Copy(tmp_path / "work")
    for old, new, alive in (
        (b"x + x", "(x - (x))", False),
        (b"a remark", "another", True),
        (b"x + x", "x + ", False),
    ):
        start = source.index(old)
        mutant = Mutant(
            "drake_exo/doubled.py", start, start + len(old), new, "listed"
        )
        assert copy.survives(mutant, ["not slow"]) is alive
    assert small.read_bytes() == source
