"""A small campaign and a small sole, as files, for runs that go wrong."""

from pathlib import Path

import numpy as np
import pytest
from cli_runs import normal_use

_CASE = """
name: small
mesh:
  brick: {size_m: [0.23, 0.13, 0.03], divisions: [4, 3, 2]}
material: {name: neoprene}
start: {point_in_sole_m: [-0.115, 0.0, -0.03]}
load:
  csv: {file: load.csv}
optimize:
  intervals: [5, 5]
  stages:
    - {samples: 4, layer_m: 5.0e-5, kappa: 0.2, iterations: 4}
"""


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
    (place / "case.yaml").write_text(_CASE)
    rows = ["time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m"]
    for k, s in enumerate(np.linspace(0, 1, 8)):
        rows.append(
            f"{0.1 * k},{20 - 40 * s},0,{200 + 300 * s * (1 - s)},"
            f"{-0.07 + 0.12 * s},0.02"
        )
    (place / "load.csv").write_text("\n".join(rows))
    return place / "case.yaml"
