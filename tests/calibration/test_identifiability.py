"""Which parameters the data determine, and the front of weights."""

import argparse
import json
from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration.phases import (
    FootGroundCalibration,
    pareto_front,
)
from drake_exo.calibration.problem import PhaseProblem, PhaseResult
from drake_exo.calibration.settings import Solver
from drake_exo.calibration.uncertainty import (
    analyse,
    contact_sensitivity,
)
from drake_exo.cli import calibrate
from drake_exo.cli import sensitivity as command
from drake_exo.collocation.kernels import (
    FootGroundKernel,
)
from drake_exo.files.output import Verdict, save_figure, write_json
from drake_exo.nlp.ipopt import STOPPED_BY_USER
from drake_exo.report.figures import front_figure
from drake_exo.report.gathering import front_table
from drake_exo.study import Study
from drake_exo.virtual_laboratory import synthetic


@pytest.fixture(scope="module")
def study(human, nominal, defaults):
    """One exact trial of the human."""
    solver = Solver(nodes_per_second=30.0)
    settings = replace(defaults, front=(0.5,), solver=solver)
    trials = synthetic.consistent(
        human, synthetic.rises(1, 1.0), nominal, settings
    )
    return Study(human, trials, foot_ground=settings)


@pytest.fixture(scope="module")
def result(study):
    found = FootGroundCalibration(
        study.model, study.trials(), study.foot_ground
    ).solve()
    assert found.success
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
    # What the method fixes anyway, whatever moves more.
    (advice,) = analyse(
        ["toe.z", "toe.radius"], np.column_stack([-0.1 * a, a])
    ).advice()
    assert "fix toe.radius, as by default" in advice
    np.testing.assert_allclose(found.influence * np.sqrt(3), [5, 0.5, 1])
    expected = [5.0 * np.sqrt(1.01), 1.0, 0.0]
    np.testing.assert_allclose(found.singular_values, expected, atol=1e-12)


@pytest.mark.slow
def test_sensitivity_is_that_of_the_forces(result):
    """A parameter's influence, by differences of the law itself."""
    found = contact_sensitivity(result)
    (t,) = result.trials
    noise = result.problem.settings.noise
    kernel = FootGroundKernel(result.contact.ground)
    root = t.coordinates.root_columns

    def scaled(values):
        repeated = np.tile(values, (len(t.q), 1))
        x = np.hstack([t.q[:, root], t.v[:, root], t.ground.array, repeated])
        F_x, F_z, M = kernel.wrench(x).T
        F, cop = np.column_stack([F_x, F_z]), -M / F_z
        scaled = np.column_stack([F / noise.force_n, cop / noise.cop_m])
        return scaled[t.ground.is_loaded]

    values = np.array([p.nominal for p in result.parameters])
    for i, p in enumerate(result.parameters):
        step = np.zeros(len(values))
        step[i] = 1e-5 * p.span
        change = (scaled(values + step) - scaled(values - step)) / 2e-5 / 4.0
        influence = np.sqrt((change**2).sum() / change.size)
        assert found.influence[i] == pytest.approx(influence), p.name


@pytest.mark.slow
def test_sensitivity_counts_time_not_nodes(result):
    """The same movement on twice as fine a grid in one half."""
    before = contact_sensitivity(result)
    (trial,) = result.trials
    t = trial.times
    at = t > t[-1] - 0.4
    finer = np.sort(np.r_[t, 0.5 * (t[:-1] + t[1:])[at[:-1]]])
    fine = SimpleNamespace(
        problem=result.problem,
        parameters=result.parameters,
        contact=result.contact,
        trials=[trial.sample(finer)],
    )
    after = contact_sensitivity(fine)
    np.testing.assert_allclose(after.influence, before.influence, rtol=5e-3)
    spread, expected = (
        x.singular_values / x.singular_values[0] for x in (after, before)
    )
    np.testing.assert_allclose(spread, expected, rtol=0.02)


@pytest.mark.slow
def test_the_command_writes_what_it_found(
    study, result, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(command, "read_study", lambda *paths: study)
    args = argparse.Namespace(
        accept=[], study="s", data_root=None, out=tmp_path / "out", force=False
    )
    assert command.run(args) == 0
    printed = capsys.readouterr().out
    assert "singular value" in printed
    found = json.loads((tmp_path / "out" / "sensitivity.json").read_text())
    assert found["names"] == [p.name for p in result.parameters]


@pytest.mark.slow
def test_a_front_s_failed_solve_is_told(result):
    problem = copy(result.problem)
    settings = problem.settings
    solver = replace(settings.solver, max_iterations=1)
    problem.settings = replace(settings, solver=solver)
    rows = pareto_front(PhaseResult(problem, result.solution, result.compiled))
    assert [r["success"] for r in rows] == [False, True]
    assert "0.5 (failed)" in front_table(rows)


@pytest.mark.slow
def test_a_front_ends_where_it_is_stopped(result, monkeypatch, tmp_path):
    """With what it has, and the rest of the results as they are."""
    stopped = replace(result.solution, success=False, status=STOPPED_BY_USER)
    monkeypatch.setattr(
        PhaseProblem,
        "solve",
        lambda p, **_: PhaseResult(p, stopped, p.compiled),
    )
    problem = copy(result.problem)
    problem.settings = replace(problem.settings, front=(2.0, 4.0))
    rows = pareto_front(PhaseResult(problem, result.solution, result.compiled))
    assert [r["factor"] for r in rows] == [1.0]

    def interrupted(problem, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr(PhaseProblem, "solve", interrupted)
    assert (
        pareto_front(PhaseResult(problem, result.solution, result.compiled))
        == rows
    )
    study = SimpleNamespace(foot_ground=problem.settings)
    told = SimpleNamespace(
        study=study,
        result=PhaseResult(problem, result.solution, result.compiled),
        success=True,
        verdict=lambda *_: Verdict((), ()),
        write=lambda *_: (
            dict.fromkeys(("parameters", "rmsd", "measured_sd", "audit"), ())
            | {"clocks": ()}
        ),
    )
    for name in ("parameters_table", "rmsd_table", "audit_table"):
        monkeypatch.setattr(calibrate, name, lambda *_: "")
    assert calibrate._write(told, tmp_path, {}, True, (), ()) == 130
    found = json.loads((tmp_path / "summary.json").read_text())
    assert [r["factor"] for r in found["front"]] == [1.0]
    # What is missing is not complete.
    summary = {"checks": [], "inputs": "it", "front": found["front"]}
    write_json(tmp_path / "summary.json", summary)
    assert calibrate.finished(tmp_path, "it", 1) is not None
    assert calibrate.finished(tmp_path, "it", 3) is None


@pytest.mark.slow
def test_a_front_is_of_the_grid_that_was_found(result, monkeypatch):
    """Damped and made finer: what does not hold on another tells nothing."""
    posed, solved = [], PhaseProblem.solve

    def solve(problem, **more):
        posed.append(problem)
        return solved(problem, **more)

    (movement,) = result.problem.movements
    parts = np.ones_like(movement.grid.parts)
    parts[3] = 2
    own = replace(result.problem.settings, front=(0.5,))
    problem = FootGroundCalibration(
        result.problem.model,
        result.problem.trials,
        own,
        refined={movement.name: parts},
    )
    finer = problem.solve(near=result)
    monkeypatch.setattr(PhaseProblem, "solve", solve)
    rows = pareto_front(finer)
    assert all(r["success"] for r in rows)
    (half,) = posed
    np.testing.assert_array_equal(half.movements[0].grid.parts, parts)


@pytest.mark.slow
def test_front_trades_kinematics_for_forces(result, tmp_path):
    rows = pareto_front(result)
    assert [r["factor"] for r in rows] == [0.5, 1.0]
    assert all(r["success"] for r in rows)
    assert rows[0]["grf_n"] <= rows[1]["grf_n"] + 1e-6
    assert front_table(rows).count("\n") >= 2
    save_figure(tmp_path / "front.png", front_figure(rows))
    assert (tmp_path / "front.png").stat().st_size > 1000
