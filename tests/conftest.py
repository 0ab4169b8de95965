"""Fixtures shared by all tests."""

import functools
import os
import signal
from pathlib import Path

import pytest

# As the command does: a run in a process of its own has the same digits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure(config):
    """Let Ctrl-C work where a shell in the background had it ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def nominal():
    """Nominal model of a kind; its tree is read once for all tests."""
    from drake_exo.model.plant import nominal_model

    return functools.cache(nominal_model)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the real recordings; skips where it is absent."""
    root = Path(os.environ.get("DRAKE_EXO_DATA", _DEFAULT_DATA))
    if not root.is_dir():
        pytest.skip(f"real recordings are not at {root} (DRAKE_EXO_DATA)")
    return root


@pytest.fixture(scope="session")
def reference_root(data_root) -> Path:
    """Folder of reference tables computed with OpenSim."""
    root = data_root.parent / "reference"
    if not root.is_dir():
        pytest.skip(f"reference tables are not at {root}")
    return root
