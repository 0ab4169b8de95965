"""Phases A and C of a real walk: both legs, toes hinged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drake_exo.calibration.audit import _about, audit
from drake_exo.calibration.foot_ground import FootGroundCalibration
from drake_exo.calibration.prediction import PredictionProblem
from drake_exo.calibration.problem import measured_feet, torque_terms
from drake_exo.calibration.scores import rmsd
from drake_exo.calibration.solving import solve
from drake_exo.calibration.start import settled
from drake_exo.errors import InputError
from drake_exo.model.assembly import Assembly, Person
from drake_exo.study import RecordedStudy, predict, read_study

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study(data_root):
    path = Path(__file__).parents[1] / "studies" / "opencap_walking.yaml"
    return read_study(path, data_root)


def calibrate(study):
    """Phase A of walking1, on a grid on which the audit holds."""
    trials = study.trials("calibration")
    return solve(
        lambda refined: FootGroundCalibration(
            study.model, trials, study.foot_ground, refined=refined
        ),
        "walk",
    )


@pytest.fixture(scope="module")
def calibrated(study):
    return calibrate(study)


@pytest.fixture(scope="module")
def predicted(study, calibrated):
    (trial,) = study.trials("prediction")
    return predict(study, trial, calibrated.contact), trial


def test_a_start_stands_on_its_feet(study):
    trials = study.trials()
    problem = FootGroundCalibration(study.model, trials, study.foot_ground)
    for movement, trial in zip(problem.movements, trials, strict=True):
        at = trial.sample(movement.grid.times)
        start = settled(problem, movement, at, problem.contact)
        for side, bodies in problem.feet.items():
            force = sum(start.ground[body] for body in bodies)
            off = force - at.feet[side].array
            assert np.sqrt(np.mean(off**2, axis=0)).max() < 50.0
            foot = measured_feet(movement, at)[f"foot_{side}"]
            tie = movement.ties[f"foot_{side}"]
            moved = tie.poses(start.q, start.v)[:, :3] - foot[:, :3]
            assert np.abs(moved[:, :2]).max() < 0.05


def test_both_feet_are_calibrated(calibrated):
    assert_near_measured(calibrated)


def assert_near_measured(result):
    assert result.success
    assert result.solution.iterations <= 80
    found, measured = result.trials[0], result.problem.trials[0]
    off = rmsd(found, measured, loads=False)
    assert max(off["angles_deg"].values()) < 1.5
    for side in ("left", "right"):
        assert off["cop_mm"][side] < 7.0
        assert off["grf_n"][f"vertical {side}"] < 15.0
        assert off["grf_n"][f"horizontal {side}"] < 6.0
    # LeafSystems under the segments, by an integrator of its own.
    assert audit(result).holds


def test_hinged_toes_are_calibrated(study):
    """A segment more on each leg, with a sphere of its own."""
    file = replace(study.file, model=Assembly(Person("two", "hinged")))
    hinged = RecordedStudy(file, study.root)
    assert_near_measured(calibrate(hinged))


def test_one_walk_predicts_another(predicted):
    """From its ends, forces and moments; nothing was fitted to it."""
    found, measured = predicted
    assert found.success
    off = found.rmsd(measured)
    assert max(off["angles_deg"].values()) < 4.0
    weight = found.result.problem.tree.weight
    for side in ("left", "right"):
        assert off["grf_n"][f"vertical {side}"] < 0.05 * weight
    assert found.audit().holds


def test_a_prediction_does_not_depend_on_its_start(study, predicted):
    """Another start: the trial with all joints off by degrees."""
    found, trial = predicted
    off = np.zeros(len(trial.coordinates))
    off[2:] = np.deg2rad(np.random.default_rng(0).uniform(-5, 5, len(off) - 2))
    posed = PredictionProblem(
        study.model, [trial], found.result.problem.contact, study.prediction
    )
    at = posed.solve().solution
    posed.trials = [replace(trial, q=trial.q + off)]
    guess = posed.guess()
    posed.trials = [trial]
    again = posed.solve(guess).solution
    assert at.success
    assert again.success
    assert again.objective == pytest.approx(at.objective, rel=1e-3)


def test_a_line_is_no_start_for_steps(study, calibrated):
    (trial,) = study.trials("prediction")
    settings = replace(study.prediction, guess="line")
    with pytest.raises(InputError, match="no start for legs that step"):
        predict(study, trial, calibrated.contact, settings=settings)


def test_moments_weigh_more_in_swing(study, predicted):
    found, _ = predicted
    problem = found.result.problem
    (movement,), names = problem.movements, found.coordinates
    at = problem.trials[0].sample(movement.grid.times)
    (term,) = torque_terms(movement, at, study.prediction.noise)
    usual = study.prediction.noise.moment_nm
    for side, wrench in at.feet.items():
        sigma = term.sigma[:, names.joint(f"knee_{side}")]
        assert sigma.max() == pytest.approx(usual)
        assert sigma.min() == pytest.approx(0.03 * usual)
        # Not before the filter's tail of touch-down or lift-off is over.
        loaded = wrench.force_z > 0.1 * at.ground.force_z.mean()
        i = int(np.argmin(sigma))
        near = np.abs(at.times - at.times[i]) < 0.1
        assert not loaded[near].any()


def test_moments_missing_are_told_about_the_foot():
    """A vertical newton too much at the foot's place has no moment there."""
    x = np.array([[6.0, 0.1, 0.0]])
    wrench = np.array([[2.0, 1.0, 0.1 * 2.0 - 6.0 * 1.0 + 0.3]])
    np.testing.assert_allclose(_about(x, wrench), [[0.3]])
