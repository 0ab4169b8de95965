"""Which parameters the data determine, and the front of weights, on a twin."""

import argparse
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.pareto import pareto_front
from drake_exo.calibration.settings import Solver
from drake_exo.calibration.uncertainty import analyse, contact_sensitivity
from drake_exo.cli import sensitivity as sensitivity_command
from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    GROUND_MOMENT_UNIT,
    FootGroundKernel,
)
from drake_exo.virtual_laboratory import twin


@pytest.fixture(scope="module")
def inputs(tree, nominal, defaults):
    """One exact trial of the human, as the commands hold it."""
    solver = Solver(nodes_per_second=30.0)
    settings = replace(defaults, front=(0.5,), solver=solver)
    trials = twin.consistent(tree, twin.rises(1, 1.0), nominal, settings)
    return SimpleNamespace(
        tree=tree,
        trials=trials,
        parameters=nominal,
        settings=settings,
        problem=lambda: FootGroundProblem(tree, trials, nominal, settings),
    )


@pytest.fixture(scope="module")
def result(inputs):
    found = inputs.problem().solve()
    assert found.solution.success
    return found


def test_coupled_parameters_are_found():
    """Two columns alike but for size, and one across."""
    a, b = np.array([3.0, 4.0, 0.0]), np.array([0.0, 0.0, 1.0])
    found = analyse(["a", "weak", "b"], np.column_stack([a, -0.1 * a, b]))
    (pair,) = found.coupled_pairs()
    assert pair[:2] == ("a", "weak")
    assert pair[2] == pytest.approx(-1.0)
    (advice,) = found.advice()
    assert "fix weak" in advice
    np.testing.assert_allclose(found.influence * np.sqrt(3), [5, 0.5, 1])
    expected = [5.0 * np.sqrt(1.01), 1.0, 0.0]
    np.testing.assert_allclose(found.singular_values, expected, atol=1e-12)


def test_sensitivity_is_that_of_the_forces(inputs, result):
    """A parameter's influence, by differences of the law itself."""
    found = contact_sensitivity(result)
    (t,) = result.trajectories
    settings = inputs.settings
    kernel = FootGroundKernel(settings.law, settings.law_constants())
    loaded = t.ground[:, 1] > 20.0

    def scaled(values):
        x = np.hstack(
            [t.q[:, :3], t.v[:, :3], t.ground, np.tile(values, (len(t.q), 1))]
        )
        # The kernel is law minus control: add the control again.
        missing = kernel.evaluate(x, None)
        F = missing[:, :2] * FORCE_UNIT + t.ground[:, :2]
        M = missing[:, 2] * GROUND_MOMENT_UNIT + t.ground[:, 2]
        noise = settings.noise
        cop = -M / F[:, 1]
        return np.column_stack([F / noise.force_n, cop / noise.cop_m])[loaded]

    values = result.values()
    for i, p in enumerate(result.parameters):
        step = np.zeros(len(values))
        step[i] = 1e-5 * p.span
        change = (scaled(values + step) - scaled(values - step)) / 2e-5 / 4.0
        influence = np.sqrt((change**2).sum() / change.size)
        assert found.influence[i] == pytest.approx(influence, rel=1e-3), p.name


def test_the_command_calibrates_with_other_radii(
    inputs, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(
        sensitivity_command, "load_inputs", lambda *paths: inputs
    )
    args = argparse.Namespace(
        study="s", data_root=None, out=tmp_path / "out", force=False
    )
    assert sensitivity_command.run(args) == 0
    assert "Calibrated again with other radii" in capsys.readouterr().out
    found = json.loads((tmp_path / "out" / "sensitivity.json").read_text())
    rows = found["radius_profile"]
    assert [r["radius_factor"] for r in rows] == [0.75, 1.0, 1.25]
    # The same forces come out whatever the radius is held at.
    assert all(r["success"] for r in rows)
    assert max(r["vertical_force_rmsd_n"] for r in rows) < 1.0
    lowest = [r["heel.z"] - r["heel.radius"] for r in rows]
    assert np.ptp(lowest) < 0.002


def test_front_trades_kinematics_for_forces(inputs, result, tmp_path, capsys):
    rows = pareto_front(tmp_path, inputs, result)
    assert [r["factor"] for r in rows] == [0.5, 1.0]
    assert all(r["success"] for r in rows)
    assert rows[0]["grf_n"] <= rows[1]["grf_n"] + 1e-6
    assert "Pareto front" in capsys.readouterr().out
    assert (tmp_path / "front.png").stat().st_size > 1000
