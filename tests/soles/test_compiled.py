"""Compiled functions: of the sources that went into them; ended by Ctrl-C."""

import importlib
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from drake_exo import soles
from drake_exo.soles import numerics
from drake_exo.soles.contact.law import ContactLaw, project

LAW = """
from drake_exo.soles.numerics import njit

@njit()
def outer(x):
    return inner(x)

@njit()
def inner(x):
    return {factor} * x
"""
CALLER = """
from drake_exo.soles.numerics import njit
from stale_law import outer

@njit()
def called(x):
    return outer(x) + 1.0
"""


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Imports the caller as a new process would, after the law is written."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "stale_caller.py").write_text(CALLER)

    def load(factor: str):
        (tmp_path / "stale_law.py").write_text(LAW.format(factor=factor))
        for name in ("stale_law", "stale_caller"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("stale_caller").called

    yield load
    for name in ("stale_law", "stale_caller"):
        sys.modules.pop(name, None)


@pytest.mark.slow
def test_an_edited_law_is_seen_by_its_callers_in_other_files(fresh):
    assert fresh("2.0")(3.0) == 7.0
    found = fresh("5.00")
    assert found(3.0) == 16.0
    assert not found.stats.cache_hits


@pytest.mark.slow
def test_what_nobody_edited_is_not_compiled_again(fresh, monkeypatch):
    fresh("2.0")(3.0)
    sys.modules.pop("stale_law")
    sys.modules.pop("stale_caller")
    again = importlib.import_module("stale_caller").called
    assert again(3.0) == 7.0
    assert sum(again.stats.cache_hits.values()) == 1

    # How things are compiled may have changed.
    monkeypatch.setattr(numerics, "_OWN_STAMP", 0)
    sys.modules.pop("stale_law")
    sys.modules.pop("stale_caller")
    anew = importlib.import_module("stale_caller").called
    assert anew(3.0) == 7.0
    assert not anew.stats.cache_hits


@pytest.mark.slow
def test_a_callee_keeps_nan_whoever_compiles_it_first(fresh, monkeypatch):
    """Fast mathematics, which its caller may have, takes x − x as 0."""
    law = LAW.replace("()", "(fastmath=True)", 1)
    law = law.replace("{factor} * x", "{factor} + (x - x)")
    monkeypatch.setitem(globals(), "LAW", law)
    assert fresh("2.0")(0.0) == 3.0
    assert np.isnan(sys.modules["stale_law"].inner(np.nan))


def test_no_sole_is_compiled_in_another_way():
    for path in Path(soles.__file__).parent.rglob("*.py"):
        if path.name != "numerics.py":
            assert "numba.njit" not in path.read_text("utf-8"), path


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no such timer")
def test_ctrl_c_is_ctrl_c_in_compiled_code():
    """numba makes a SystemError of it, which no command takes for one."""
    law, tau = ContactLaw(0.8, 1e5), np.ones((30, 3))
    project(tau, law)
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        for _ in range(10):
            with pytest.raises(KeyboardInterrupt):
                signal.setitimer(signal.ITIMER_REAL, 0.01)
                while True:
                    project(tau, law)
    finally:
        signal.signal(signal.SIGALRM, before)
