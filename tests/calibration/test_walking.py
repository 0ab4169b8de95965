"""Phases A and C of a real walk: both legs, toes hinged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drake_exo.calibration import audit as auditing
from drake_exo.calibration.audit import audit, rms, rmsd
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    PeriodicStep,
    PredictionProblem,
)
from drake_exo.calibration.problem import measured_feet, torque_terms
from drake_exo.calibration.settings import PredictionSettings
from drake_exo.calibration.solving import solve
from drake_exo.calibration.start import settled
from drake_exo.collocation.kernels import SoleKernel
from drake_exo.errors import InputError
from drake_exo.model.assembly import Assembly, Person
from drake_exo.study import RecordedStudy, predict, read_study
from drake_exo.virtual_laboratory import synthetic

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
            now = problem.tree.poses(start.q, f"foot_{side}")
            moved = now - foot[:, :3]
            assert np.abs(moved[:, :2]).max() < 0.05


def test_each_foots_force_must_be_known(study):
    trials = [replace(trial, feet={}) for trial in study.trials()]
    with pytest.raises(InputError, match="under the left foot is not known"):
        FootGroundCalibration(study.model, trials, study.foot_ground)


def test_both_feet_are_calibrated(calibrated):
    assert_near_measured(calibrated)


def test_what_a_simulation_misses_is_not_the_integrators(
    calibrated, monkeypatch
):
    """Damping of the feedback makes moments of the error of a speed."""
    once = auditing.simulate(calibrated)
    monkeypatch.setattr(auditing, "_ACCURACY", 1e-7)
    off = auditing.simulate(calibrated).moments - once.moments
    assert rms(off, once.times).max() < 0.02


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


def test_a_step_repeats_itself_and_tracks_nothing(study, calibrated):
    """Mirrored ends at a given speed; what comes out is a person's step."""
    (files,) = (f for f in study.file.trials if f.name == "walking1")
    files = replace(files, end_s=None, end="toe_off right 1")
    step = RecordedStudy(replace(study.file, trials=(files,)), study.root)
    (trial,) = step.trials()
    noise = replace(study.prediction.noise, torque_nm=20.0, jerk=1000.0)
    solver = replace(
        study.prediction.solver, nodes_per_second=100.0, hessian="exact"
    )
    settings = replace(
        study.prediction,
        ends="periodic",
        speed_m_s=1.25,
        torque_limit_nm=120.0,
        noise=noise,
        solver=solver,
    )
    problem = PeriodicStep(step.model, [trial], calibrated.contact, settings)
    assert all(
        term.role == "regulariser"
        for movement in problem.movements
        for term in movement.tracked
    )
    found = problem.solve()
    assert found.success
    (own,), names = found.trials, trial.coordinates
    other = {"left": "right", "right": "left"}
    swapped = names.columns(
        ["_".join(other.get(p, p) for p in n.split("_")) for n in names.names]
    )
    ahead = np.zeros(len(names))
    ahead[names.index("pelvis_x")] = 1.25 * trial.duration
    for x, gain in ((own.q, ahead), (own.v, 0.0), (own.a, 0.0)):
        np.testing.assert_allclose(x[-1], x[0][swapped] + gain, atol=1e-4)
    # The feet bear alike, and together the body's weight over the step.
    np.testing.assert_allclose(
        own.feet["left"].force[-1], own.feet["right"].force[0], atol=0.5
    )
    weight = problem.tree.weight
    step_s = np.trapezoid(own.ground.force_z, own.times) / own.duration
    assert step_s == pytest.approx(weight, rel=0.05)
    assert np.abs(own.moments).max() <= 120.0 + 1e-6
    knee = np.rad2deg(own.coordinate("knee_left"))
    assert knee.max() > 35.0  # in swing
    assert knee.min() > -1.0
    swing = own.feet["left"].force_z < 5.0
    middle = np.flatnonzero(swing)[len(np.flatnonzero(swing)) // 2]
    spheres = problem.sphere_values(calibrated.contact, "foot_left")
    pose = problem.tree.states(own.q, own.v, "foot_left")
    assert SoleKernel(spheres).evaluate(pose, None)[middle].min() > 0.009


def test_a_line_is_no_start_for_steps(study, calibrated):
    (trial,) = study.trials("prediction")
    settings = replace(study.prediction, guess="line")
    with pytest.raises(
        InputError, match="cannot start a movement whose legs step"
    ):
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


def test_one_leg_makes_no_step():
    model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    settings = PredictionSettings(ends="periodic")
    contact = FootGroundCalibration(model, [trial]).contact
    with pytest.raises(InputError, match="stands for both legs at once"):
        PeriodicStep(model, [trial], contact, settings)
    with pytest.raises(ValueError, match="periodic ends"):
        PredictionProblem(model, [trial], contact, settings)
