"""A small campaign and a small sole, as files, for runs that go wrong."""

from pathlib import Path

import pytest
from cli_runs import normal_use
from small_step import stage, write_case, write_step


@pytest.fixture(scope="session")
def campaign(tmp_path_factory) -> Path:
    """Study file of one simulated movement."""
    out = tmp_path_factory.mktemp("hardening") / "campaign"
    options = ["--seed", "1", "--trials", "1", "--without", "all"]
    assert "wrote" in normal_use("lab", *options, "--out", str(out))
    study = out / "study.yaml"
    text = study.read_text("utf-8")
    assert text.count("nodes_per_second: 100.0") == 1
    text = text.replace("nodes_per_second: 100.0", "nodes_per_second: 40")
    study.write_text(text, encoding="utf-8")
    return study


@pytest.fixture(scope="session")
def sole_case(tmp_path_factory) -> Path:
    """Case file of a small sole."""
    place = tmp_path_factory.mktemp("hardening_sole")
    write_case(
        place / "case.yaml", intervals=[5, 5], stages=[stage(4, 5e-5, 4)]
    )
    write_step(place / "load.csv", 8)
    return place / "case.yaml"
