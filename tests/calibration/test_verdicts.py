"""A result that does not hold never passes for one that does."""

import json
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from undrawn import undrawn
from unmarked import unmarked

import drake_exo as dx
from drake_exo.calibration import solving
from drake_exo.calibration.audit import (
    FORCE_TOLERANCE,
    MOMENT_TOLERANCE,
    audit,
    between_nodes,
)
from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import FootGroundSettings, Solver
from drake_exo.calibration.solving import finer, solve, split
from drake_exo.cli import main
from drake_exo.files.output import read_json, write_json
from drake_exo.nlp.ipopt import SealedSolutionError
from drake_exo.virtual_laboratory import synthetic

STOPPED = FootGroundSettings(solver=Solver(40.0, max_iterations=2))


@pytest.fixture(scope="module")
def failed():
    """Phase A after two iterations."""
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    study = dx.Study(model, trials, foot_ground=STOPPED)
    return dx.calibrate_foot_ground(study)


@pytest.mark.parametrize("name", ["values", "parameters", "contact", "trials"])
def test_a_failed_solve_says_no_number(failed, name):
    with pytest.raises(SealedSolutionError):
        getattr(failed.result, name)
    assert getattr(failed.result.unsealed(), name) is not None
    with pytest.raises(SealedSolutionError):
        getattr(failed.result, name)


@pytest.mark.parametrize("name", ["contact", "trials", "parameters"])
def test_a_failed_calibration_says_none_either(failed, name):
    with pytest.raises(SealedSolutionError):
        getattr(failed, name)


@pytest.mark.slow
def test_a_failed_solve_is_written_marked(failed, tmp_path):
    with undrawn():
        summary = failed.write(tmp_path)
    assert summary["verdict"] == "not solved"
    assert summary["audit"] == []
    for path in (*tmp_path.glob("*.sto"), tmp_path / "rmsd.txt"):
        first = path.read_text("utf-8").splitlines()[0]
        assert "NOT SOLVED: solved" in first, path.name
    origin = read_json(tmp_path / "parameters.json", "")["origin"]
    assert (origin["verdict"], origin["failed"]) == ("not solved", ["solved"])


@pytest.mark.slow
def test_the_mark_is_on_everything_that_is_written(failed, tmp_path):
    """Figures and tables of the phase, and the report and the page on them."""
    failed.write(tmp_path / "a")
    assert unmarked(tmp_path) == []
    assert list(tmp_path.rglob("*.png")) and list(tmp_path.rglob("*.sto"))
    page = str(tmp_path / "page.html")
    accept = ["--accept", "solved"]
    assert main(["report", str(tmp_path / "a"), *accept]) == 0
    assert main(["view", str(tmp_path / "a"), *accept, "--out", page]) == 0
    tables = ("table_2.csv", "table_3.csv")
    assert unmarked(tmp_path, tables) == []


@pytest.mark.slow
def test_a_failed_calibration_goes_no_further(command, tmp_path, capsys):
    """calibrate exits 1; predict, report and view refuse its folder."""
    _, path, *root = command("calibrate")
    text = Path(path).read_text("utf-8")
    study = tmp_path / "study.yaml"
    assert "nodes_per_second: 200" in text
    study.write_text(
        text.replace(
            "nodes_per_second: 200", "nodes_per_second: 40, max_iterations: 2"
        )
        if "{nodes" in text
        else text.replace(
            "nodes_per_second: 200",
            "nodes_per_second: 40\n    max_iterations: 2",
        )
    )
    cal, out = str(tmp_path / "cal"), str(tmp_path / "c1")
    more = ["--phase", "foot-ground", "--no-front", "--out", cal]
    with undrawn():
        assert main(["calibrate", str(study), *root, *more]) == 1
        more = ["--calibration", cal, "--out", out]
        assert main(["predict", path, *root, *more]) == 2
    said = capsys.readouterr().err
    assert "not solved (solved)" in said
    assert "--accept provenance.calibration" in said
    assert not (tmp_path / "c1").exists()
    assert main(["report", cal]) == 2
    assert main(["view", cal, "--out", str(tmp_path / "page.html")]) == 2
    assert not (tmp_path / "page.html").exists()


@pytest.mark.slow
def test_a_calibration_of_another_is_refused(
    command, calibrated, tmp_path, capsys
):
    """Another subject, and another body of the same name."""
    other = tmp_path / "cal"
    other.mkdir()
    for name in ("parameters.json", "model.json", "summary.json"):
        (other / name).write_bytes((calibrated / name).read_bytes())
    stored = read_json(other / "parameters.json", "")
    stored["origin"] |= {"subject": "another", "model": "0" * 16}
    write_json(other / "parameters.json", stored)
    more = ["--calibration", str(other), "--out", str(tmp_path / "c1")]
    for own in (command("predict"), ["design", *command("predict")[1:]]):
        assert main([*own, *more]) == 2
        said = capsys.readouterr().err
        assert "it is of subject 'another'" in said
        assert "another model" in said
        assert not (tmp_path / "c1").exists()
    more += ["--accept", "provenance"]
    with undrawn():
        assert main([*command("predict"), *more]) == 0
    summary = json.loads((tmp_path / "c1" / "summary.json").read_text("utf-8"))
    assert summary["verdict"] == "does not hold"
    assert summary["accepted"] == ["provenance"]
    text = (tmp_path / "c1" / "rise4_coordinates.sto").read_text("utf-8")
    assert "DOES NOT HOLD: provenance.subject" in text.splitlines()[0]
    undrawn_ones = {p.name for p in (tmp_path / "c1").glob("*.png")}
    assert set(unmarked(tmp_path / "c1")) == undrawn_ones != set()


def test_a_grid_is_finer_where_forces_or_moments_miss(monkeypatch):
    """By 1 N and 0.5 N m; then until half of that should be missed."""
    parts = np.ones(4, int)
    grid = SimpleNamespace(parts=parts)
    movement = SimpleNamespace(grid=grid, may_alternate=False, is_tracked=True)
    trial = SimpleNamespace(name="rise")
    problem = SimpleNamespace(refined={}, movements=[movement], trials=[trial])
    result = SimpleNamespace(problem=problem)
    for force, moment, expected in (
        (0.9, 0.45, None),
        (1.1, 0.0, [4, 4, 2, 2]),
        (0.0, 0.55, [4, 4, 2, 2]),
        (1.9, 0.0, [4, 4, 2, 2]),
        (0.0, 1.1, [4, 4, 2, 2]),
    ):
        at = np.array([force, 0, 0, 0.6]), np.array([moment, 0, 0, 0])
        monkeypatch.setattr(solving, "between_nodes", lambda *_, at=at: at)
        found = solving.finer(result)
        if expected is None:
            assert found == {}
            continue
        np.testing.assert_array_equal(found["rise"], expected)
    # What alternates is damped first, on the same grid.
    movement.may_alternate = True
    np.testing.assert_array_equal(solving.finer(result)["rise"], parts)
    movement.is_tracked = False
    np.testing.assert_array_equal(solving.finer(result)["rise"], [4, 4, 2, 2])
    movement.is_tracked, problem.refined = True, {"rise": parts}
    np.testing.assert_array_equal(solving.finer(result)["rise"], [4, 4, 2, 2])


def test_no_errors_are_none():
    assert set(vars(NO_ERRORS).values()) == {0.0}


def test_what_misses_is_split_and_lengths_change_gently():
    """Until it should miss less than half, and neighbours with it."""
    even = np.ones(10, int)
    missed = np.full(10, 0.45)
    np.testing.assert_array_equal(split(even, missed), even)
    missed[5] = 0.55
    expected = [1, 1, 1, 1, 2, 2, 2, 1, 1, 1]
    np.testing.assert_array_equal(split(even, missed), expected)
    missed[5] = 1.05
    expected = [1, 1, 1, 2, 4, 4, 4, 2, 1, 1]
    np.testing.assert_array_equal(split(even, missed), expected)
    missed[5] = 1e6  # no more at once
    np.testing.assert_array_equal(split(even, missed), expected)
    # On an uneven grid; what holds stays as it is.
    parts = np.array([1, 2, 4, 4, 2, 1])
    missed = np.full(parts.sum(), 0.25)
    missed[[0, 5]] = 0.75  # the first interval, a part of the third
    expected = [4, 8, 8, 8, 4, 2]
    np.testing.assert_array_equal(split(parts, missed), expected)
    missed[5] = 0.25
    expected = [2, 2, 4, 4, 2, 1]
    np.testing.assert_array_equal(split(parts, missed), expected)


@pytest.mark.slow
@pytest.mark.parametrize("refined", [1, 2])
def test_a_grid_has_the_intervals_that_were_asked_for(refined):
    """Nodes a second, and twice as many where it was refined."""
    model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    settings = FootGroundSettings(solver=Solver(20.0))
    more = {} if refined == 1 else {trial.name: refined}
    posed = FootGroundCalibration(model, [trial], settings, refined=more)
    intervals = len(posed.movements[0].grid.times) - 1
    assert intervals == round(20.0 * refined * trial.duration)


@pytest.mark.slow
def test_a_grid_is_split_where_it_misses():
    """Two places in the program: the trial's grid, and the solve's start."""
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    settings = FootGroundSettings(solver=Solver(12.0))

    def pose(refined):
        posed = FootGroundCalibration(model, trials, settings, refined=refined)
        sizes.append(len(posed.movements[0].grid.times))
        return posed

    sizes = []
    coarse = pose({}).solve()
    assert coarse.success
    force, moment = between_nodes(coarse, 0)
    (parts,) = finer(coarse).values()
    misses = np.maximum(force / FORCE_TOLERANCE, moment / MOMENT_TOLERANCE) > 1
    assert (parts[misses] > 1).all()
    found = solve(pose, "calibrate")
    assert found.success
    n = sizes[0] - 1
    assert sizes[1:3] == [n + 1, parts.sum() + 1]
    assert audit(found).holds
    assert found.problem.refined["rise1"].max() >= 2


@pytest.mark.slow
def test_stopped_on_a_finer_grid_is_stopped(tmp_path):
    """What was found before stays to go on from; it is no result."""
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    settings = FootGroundSettings(solver=Solver(12.0))

    def pose(refined):
        posed = FootGroundCalibration(model, trials, settings, refined=refined)
        if refined:
            own = posed.solve

            def stopped(on_iterate, near):
                def stop(iterate):
                    on_iterate(iterate)
                    signal.raise_signal(signal.SIGINT)

                return own(on_iterate=stop, near=near)

            posed.solve = stopped
        return posed

    found = solve(pose, "calibrate", tmp_path)
    assert not found.success
    assert found.solution.was_stopped
    assert (tmp_path / "checkpoint.npz").is_file()


@pytest.mark.slow
def test_a_solve_without_success_leaves_where_it_ended(tmp_path, monkeypatch):
    """However short it was: not its start, which is kept first."""
    model, trials = synthetic.rises_on_spheres(1, nodes_per_second=40)
    settings = FootGroundSettings(solver=Solver(12.0, max_iterations=3))
    seen, follow = [], solving.SolveWatch.__call__

    def followed(watch, iterate):
        seen.append(iterate.x)
        follow(watch, iterate)

    monkeypatch.setattr(solving, "_CHECKPOINT_SECONDS", np.inf)
    monkeypatch.setattr(solving.SolveWatch, "__call__", followed)
    found = solve(
        lambda refined: FootGroundCalibration(model, trials, settings),
        "calibrate",
        tmp_path,
    )
    assert not found.success
    with np.load(tmp_path / "checkpoint.npz") as kept:
        np.testing.assert_array_equal(kept["x"], seen[-1])
    assert np.abs(seen[-1] - seen[0]).max() > 0.0
