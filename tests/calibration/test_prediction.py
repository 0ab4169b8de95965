"""Phase C: from end states alone."""

from dataclasses import replace

import numpy as np
import pytest

import drake_exo as dx
from drake_exo.calibration.audit import rms, rmsd
from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.cli.predict import load_controller
from drake_exo.contact.parameters import Posterior
from drake_exo.contact.systems import AssistController
from drake_exo.errors import InputError
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.nlp.ipopt import SealedSolutionError
from drake_exo.virtual_laboratory.synthetic import rises_in_device

pytestmark = pytest.mark.slow


def settings(**changes):
    return PredictionSettings(solver=Solver(50.0), **changes)


def test_movement_and_forces_follow_from_end_states(predicted, in_device):
    assert predicted.success
    scores = rmsd(predicted.trials[0], in_device.trials[0])
    assert max(scores["angles_deg"].values()) < 0.2
    assert max(scores["interaction_n"].values()) < 1.0


def test_ends_are_given_where_instruments_are_perfect(predicted, in_device):
    """The paper's way; errors of measurement set them free (test_costs)."""
    found, trial = predicted.trials[0], in_device.trials[0]
    joints = trial.coordinates.joint_columns
    for own, given in ((found.q, trial.q), (found.v, trial.v)):
        ends = [0, -1]
        np.testing.assert_allclose(
            own[ends][:, joints], given[ends][:, joints], atol=1e-6
        )


def test_line_and_data_lead_to_one_optimum(predicted, in_device):
    problem = in_device.prediction(settings(guess="data"), in_device.trials[0])
    solution = problem.solve().solution
    assert solution.success
    assert solution.objective == pytest.approx(
        predicted.solution.objective, rel=1e-4
    )


def test_the_guess_takes_nothing_from_the_data(in_device):
    """Only the ends of the motion enter a prediction from a line."""
    trial = in_device.trials[0]
    bent = trial.q.copy()
    bent[5:-5] += 0.3
    v, a = trial.v.copy(), trial.a.copy()
    v[5:-5] += 1.0
    a[5:-5] += 10.0
    other = replace(trial, q=bent, v=v, a=a)
    guesses = [
        in_device.prediction(settings(), t).guess() for t in (trial, other)
    ]
    np.testing.assert_array_equal(*guesses)


def test_wrong_stiffness_predicts_worse(predicted, in_device):
    trial = in_device.trials[0]
    stiff = in_device.contact.scaled(1.4)
    scaled = in_device.prediction(settings(), trial, stiff).solve()
    assert scaled.success
    force = [
        rmsd(r.trials[0], trial)["interaction_n"]["pelvis"]
        for r in (predicted, scaled)
    ]
    assert force[1] > 2.0 * force[0]
    angles = rmsd(scaled.trials[0], trial)["angles_deg"]
    assert max(angles.values()) < 3.3


def test_comfort_lowers_the_interaction(predicted, in_device):
    problem = in_device.prediction(
        settings(objective="comfort"), in_device.trials[0]
    )
    result = problem.solve()
    assert result.success
    before, after = (
        rms(np.column_stack([f.normal for f in r.trials[0].cuffs.values()]))
        for r in (predicted, result)
    )
    assert (after < 0.8 * before).all()


def test_a_controller_gives_the_torques(in_device):
    controller = AssistController(knee_nm=20.0, hip_nm=10.0)
    problem = in_device.prediction(
        settings(), in_device.trials[0], controller=controller
    )
    result = problem.solve()
    assert result.success
    t = result.trials[0]
    for joint, nm in (("exo_ankle", 0.0), ("exo_knee", 20.0), ("exo_hip", 10)):
        expected = -nm * np.sin(t.coordinate(joint))
        if nm:
            expected = expected - 0.5 * t.velocity(joint)
        np.testing.assert_allclose(t.moment(joint), expected, atol=1e-2)
    # The device does not straighten until its torques are those measured.
    off = rmsd(t, in_device.trials[0])["angles_deg"]
    assert max(off[joint] for joint in in_device.model.coordinates.device) < 7.0
    with pytest.raises(InputError, match="damping is -1, but must be at least"):
        AssistController(damping=-1.0)
    with pytest.raises(InputError, match=r"hip_nm must be a number \[N m\]"):
        AssistController(hip_nm="10")


@pytest.mark.slow
def test_low_torque_limit_is_named_and_sealed(in_device):
    problem = in_device.prediction(
        settings(torque_limit_nm=5.0), in_device.trials[0]
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


@pytest.mark.slow
def test_final_state_out_of_reach_is_named(in_device):
    """The foot would have to hang in the air at the end."""
    trial = in_device.trials[0]
    q = trial.q.copy()
    q[:, trial.coordinates.index("foot_z")] += np.linspace(0.0, 0.3, len(q))
    problem = in_device.prediction(settings(), replace(trial, q=q))
    solution = problem.solve().solution
    assert not solution.success
    assert solution.binding[0].name.endswith("foot_z at 1.5 s")
    assert solution.binding[0].needed < 0.1 < solution.binding[0].bound


def test_a_limit_that_can_be_kept_is_kept(in_device):
    trial = in_device.trials[0]
    limit = 0.9 * np.abs(trial.moments).max()
    result = in_device.prediction(
        settings(objective="comfort", torque_limit_nm=limit), trial
    ).solve()
    assert result.success
    assert np.abs(result.trials[0].moments).max() <= limit * (1 + 1e-6)


@pytest.mark.parametrize(
    "name", ["nothing", "drake_exo.nowhere:Thing", "math:pi", "os:nothing"]
)
def test_a_wrong_controller_is_one_sentence(name):
    with pytest.raises(InputError, match="--controller"):
        load_controller(name)


def test_a_start_from_another_contact_ends_at_the_same_optimum(
    predicted, in_device
):
    stiffer = in_device.contact.scaled(1.4)
    problem = in_device.prediction(settings(), in_device.trials[0], stiffer)
    cold, near = (
        problem.solve().solution,
        problem.solve(near=predicted).solution,
    )
    assert near.strategy == "near"
    assert near.objective == pytest.approx(cold.objective, rel=1e-6)
    assert predicted.solution.objective != pytest.approx(
        cold.objective, rel=1e-3
    )


def test_springs_answer_to_where_the_device_goes():
    """Measured, a spring's torque is that of where the device was then."""
    made = rises_in_device(1, nodes_per_second=20)
    (trial,) = made.trials
    study = dx.Study(made.model, made.trials)
    study.prediction = settings()
    contact = made.contact.with_values({"thigh.normal_stiffness": 2000.0})
    plain = dx.predict(study, trial, contact)
    study.device = Device(joints={"exo_ankle": JointDrive(viscous_nm_s=1.0)})
    rubbing = dx.predict(study, trial, contact)
    assert (rubbing.q == plain.q).all()
    assert (rubbing.moments == plain.moments).all()
    study.device = Device(knee=JointDrive(stiffness_nm_rad=60.0, rest_deg=20.0))
    found = dx.predict(study, trial, contact)
    at = trial.sample(found.times)
    off = found.coordinate("exo_knee") - at.coordinate("exo_knee")
    more = found.moment("exo_knee") - at.moment("exo_knee")
    assert np.abs(60.0 * off).max() > 1.0
    np.testing.assert_allclose(more, -60.0 * off, atol=0.4)
    # Where encoders are off by what a calibration found, a spring is, too.
    names = trial.coordinates
    known = Posterior(
        ("encoder.exo_knee",), np.array([0.05]), 1e-10 * np.eye(1)
    )
    sure = replace(contact, posterior=known)
    shifted = trial.q.copy()
    shifted[:, names.index("exo_knee")] += 0.05
    study.prediction = settings(
        errors=replace(NO_ERRORS, encoder_offset_deg=2.0)
    )
    as_off = dx.predict(study, replace(trial, q=shifted), sure)
    known = replace(known, values=np.zeros(1))
    as_is = dx.predict(study, trial, replace(contact, posterior=known))
    np.testing.assert_allclose(as_off.moments, as_is.moments, atol=1e-3)
    # A controller gives all of the torque.
    study.prediction = settings()
    controller = AssistController(knee_nm=10.0)
    driven = dx.predict(study, trial, contact, controller=controller)
    study.device = None
    alone = dx.predict(study, trial, contact, controller=controller)
    assert (driven.q == alone.q).all()
