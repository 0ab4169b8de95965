"""Phase C: from end states alone."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.scores import rms, rmsd
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.cli.predict import load_controller
from drake_exo.contact.controllers import AssistController
from drake_exo.errors import InputError
from drake_exo.nlp.ipopt import SealedSolutionError


def settings(**changes):
    return PredictionSettings(solver=Solver(50.0), **changes)


@pytest.fixture(scope="module")
def predicted(cuffs_twin):
    problem = cuffs_twin.prediction(settings(), cuffs_twin.trials[0])
    return problem.solve()


def test_movement_and_forces_follow_from_end_states(predicted, cuffs_twin):
    assert predicted.solution.success
    scores = rmsd(predicted.trajectories[0], cuffs_twin.trials[0])
    assert max(scores["angles_deg"].values()) < 0.2
    assert max(scores["interaction_n"].values()) < 1.0


def test_line_and_data_lead_to_one_optimum(predicted, cuffs_twin):
    problem = cuffs_twin.prediction(
        settings(guess="data"), cuffs_twin.trials[0]
    )
    solution = problem.solve().solution
    assert solution.success
    assert solution.objective == pytest.approx(
        predicted.solution.objective, rel=1e-4
    )


def test_the_guess_takes_nothing_from_the_data(cuffs_twin):
    """Only the ends of the motion enter a prediction from a line."""
    trial = cuffs_twin.trials[0]
    bent = trial.q.copy()
    bent[5:-5] += 0.3
    v, a = trial.v.copy(), trial.a.copy()
    v[5:-5] += 1.0
    a[5:-5] += 10.0
    other = replace(trial, q=bent, v=v, a=a)
    guesses = [
        cuffs_twin.prediction(settings(), t).guess() for t in (trial, other)
    ]
    np.testing.assert_array_equal(*guesses)


def test_wrong_stiffness_predicts_worse(predicted, cuffs_twin):
    trial = cuffs_twin.trials[0]
    scaled = cuffs_twin.prediction(settings(), trial, scale=1.4).solve()
    assert scaled.solution.success
    force = [
        rmsd(r.trajectories[0], trial)["interaction_n"]["pelvis"]
        for r in (predicted, scaled)
    ]
    assert force[1] > 2.0 * force[0]
    angles = rmsd(scaled.trajectories[0], trial)["angles_deg"]
    assert max(angles.values()) < 3.3


def test_comfort_lowers_the_interaction(predicted, cuffs_twin):
    problem = cuffs_twin.prediction(
        settings(objective="comfort"), cuffs_twin.trials[0]
    )
    result = problem.solve()
    assert result.solution.success
    before, after = (
        rms(r.trajectories[0].interaction)[[1, 4, 7]]
        for r in (predicted, result)
    )
    assert (after < 0.8 * before).all()


def test_a_controller_gives_the_torques(cuffs_twin):
    controller = AssistController(knee_nm=20.0, hip_nm=10.0)
    problem = cuffs_twin.prediction(
        settings(), cuffs_twin.trials[0], controller=controller
    )
    result = problem.solve()
    assert result.solution.success
    t = result.trajectories[0]
    expected = np.column_stack(
        [
            np.zeros(len(t.times)),
            -20.0 * np.sin(t.q[:, 7]) - 0.5 * t.v[:, 7],
            -10.0 * np.sin(t.q[:, 8]) - 0.5 * t.v[:, 8],
        ]
    )
    np.testing.assert_allclose(t.torque[:, 3:], expected, atol=1e-2)


def test_low_torque_limit_is_named_and_sealed(cuffs_twin):
    problem = cuffs_twin.prediction(
        settings(torque_limit_nm=5.0), cuffs_twin.trials[0]
    )
    solution = problem.solve().solution
    assert not solution.success
    assert solution.is_sealed
    with pytest.raises(SealedSolutionError, match="torque"):
        solution.values(np.arange(3))
    named = " ".join(b.name for b in solution.binding)
    assert "hip torque" in named and "knee torque" in named
    assert all(abs(b.needed) > 5.0 for b in solution.binding)
    assert all(abs(b.bound) == pytest.approx(5.0) for b in solution.binding)
    assert "N m" in solution.explain()


def test_final_state_out_of_reach_is_named(cuffs_twin):
    """The foot would have to hang in the air at the end."""
    trial = cuffs_twin.trials[0]
    q = trial.q.copy()
    q[:, 1] += np.linspace(0.0, 0.3, len(q))
    problem = cuffs_twin.prediction(settings(), replace(trial, q=q))
    solution = problem.solve().solution
    assert not solution.success
    assert solution.binding[0].name.endswith("foot_z at 1.5 s")
    assert solution.binding[0].needed < 0.1 < solution.binding[0].bound


def test_a_limit_that_can_be_kept_is_kept(cuffs_twin):
    trial = cuffs_twin.trials[0]
    limit = 0.9 * np.abs(trial.moments).max()
    result = cuffs_twin.prediction(
        settings(objective="comfort", torque_limit_nm=limit), trial
    ).solve()
    assert result.solution.success
    assert np.abs(result.trajectories[0].torque).max() <= limit * (1 + 1e-6)


@pytest.mark.parametrize(
    "name", ["nothing", "drake_exo.nowhere:Thing", "math:pi", "os:nothing"]
)
def test_a_wrong_controller_is_one_sentence(name):
    with pytest.raises(InputError, match="--controller"):
        load_controller(name)
