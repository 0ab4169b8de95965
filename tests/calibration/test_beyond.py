"""What is not kept today, encoders that are off, drives that go by posture."""

from dataclasses import replace

import numpy as np
import pytest
from test_design_program import SETTINGS
from worn import as_guessed, each
from worn import wearer as worn

from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.problem import torque_terms
from drake_exo.calibration.settings import DesignLimits, PredictionSettings
from drake_exo.calibration.wearers import (
    OwnMovement,
    answer,
    assisted,
    posture_law,
    springs_answer,
)
from drake_exo.contact.parameters import Posterior
from drake_exo.contact.strap import Assistance, Design, Gains
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.model.plant import nominal_model


@pytest.fixture(scope="module")
def wearer():
    return worn(nominal_model("coupled"))


@pytest.mark.slow
def test_migration_beyond_its_limit_costs_more_than_forces_do(wearer):
    """2.5 times the objective's weight for all of it, either way."""
    today = as_guessed(DesignProblem([wearer], SETTINGS, held=True))
    slid = each(today.wearers["somebody"], "largest_deflection")
    limit = 1e3 * 0.5 * min(d[0] for d in slid.values())
    settings = replace(
        SETTINGS, weight=3.0, limits=DesignLimits(migration_mm=limit)
    )
    problem = DesignProblem([wearer], settings, today=today)
    (part,) = problem.parts
    _, slope, _ = problem.program.quadratic_cost()
    indices = problem.program.indices
    rows = {
        str(b.evaluator().get_description()): []
        for b in problem.program.prog.linear_constraints()
    }
    for b in problem.program.prog.linear_constraints():
        rows[str(b.evaluator().get_description())].append(b)
    (movement,) = part.movements
    for cuff, deflection in slid.items():
        over = deflection[0] - 1e-3 * limit
        beyond = part._beyond[cuff]
        assert slope[indices(beyond)[0]] == pytest.approx(2.5 * 3.0 / over)
        name = f"{movement.name} {cuff} migration beyond its limit"
        x = np.zeros(problem.program.prog.num_vars())
        x[indices(beyond)] = 0.3 * over
        at = indices(part._limited["migration", cuff, movement.name]).ravel()
        kept = []
        for far, holds in (
            (0.29, True),
            (-0.29, True),
            (0.31, False),
            (-0.31, False),
        ):
            x[at] = np.sign(far) * (1e-3 * limit + abs(far) * over)
            kept.append(
                all(
                    (
                        b.evaluator().GetDenseA()
                        @ x[indices(np.asarray(b.variables()))]
                        <= b.evaluator().upper_bound()
                    ).all()
                    for b in rows[name]
                )
            )
            assert kept[-1] == holds


def test_a_controller_acts_at_true_angles(wearer):
    """Those of encoders less what a calibration found them to be off."""
    (own,) = wearer.trials
    names = ("encoder.exo_knee", "encoder.exo_hip")
    known = Posterior(names, np.array([0.05, -0.02]), 1e-6 * np.eye(2))
    contact = replace(wearer.contact, posterior=known)
    spring = Gains(1.0, 0.0, 8.0, 0.0)
    design = Design(gains={"exo_knee": spring, "exo_hip": spring})
    # Without encoders angles are the person's.
    taken = replace(own, provenance={"exoskeleton_angles": "the person's"})
    for trial, share in ((own, 1.0), (taken, 0.0)):
        changed = assisted(trial, design, contact, passive=0.7)
        for joint, off in (("exo_knee", 0.05), ("exo_hip", -0.02)):
            more = -8.0 * (own.coordinate(joint) - share * off)
            np.testing.assert_allclose(
                changed.moment(joint) - own.moment(joint), more
            )
    half = Design(gains={"exo_hip": Gains(0.5)})
    changed = assisted(own, half, contact, passive=0.7)
    # Friction is there whatever the drive gives.
    expected = 0.5 * (own.moment("exo_hip") - 0.7) + 0.7
    np.testing.assert_allclose(changed.moment("exo_hip"), expected)


def test_a_springs_torque_is_as_its_moments_were_made(wearer):
    """At true angles as recorded; the device's model took the encoders'."""
    (own,) = wearer.trials
    known = Posterior(("encoder.exo_knee",), np.array([0.05]), 1e-6 * np.eye(1))
    contact = replace(wearer.contact, posterior=known)
    device = Device(knee=JointDrive(stiffness_nm_rad=60.0, rest_deg=20.0))
    sprung = replace(wearer, contact=contact, device=device)
    k = own.coordinates.device.index("exo_knee")
    knee, rest = own.coordinate("exo_knee"), np.deg2rad(20.0)
    taken = {"exoskeleton_angles": "the person's"}
    for said, off in (
        ({"moments": {"exoskeleton": "recorded"}}, 0.05),
        ({"moments": {"exoskeleton": "device model"}}, 0.0),
        (taken, 0.0),
    ):
        trial = replace(own, provenance=said)
        found = springs_answer(trial, device)
        assert (found.slope[:, k, k] == -60.0).all()
        np.testing.assert_allclose(found.there[:, k], -60.0 * knee)
        assert not np.delete(found.there, k, axis=1).any()
        assert found.springs.tolist() == [0.0, 60.0 if off else 0.0, 0.0]
        # A factor on drives leaves a spring as it is.
        passive = sprung.passive(trial)
        np.testing.assert_allclose(passive[:, k], -60.0 * (knee - off - rest))
        solved = replace(trial, source="solved")
        passive = sprung.passive(solved)
        np.testing.assert_allclose(passive[:, k], -60.0 * (knee - rest))
    assert springs_answer(own, None) is None


# Torque of knee and hip by the sine of the links' inclinations [N m].
LAW = {
    "exo_knee": np.array([0.0, -40.0, -25.0]),
    "exo_hip": np.array([0.0, 0.0, 30.0]),
}
# Of the device's links from the vertical, by its joints: toes up, knees bend
# backwards.
TURNS = np.array([[-1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, 1.0, -1.0]])


def by_posture(trial, q):
    """Torques (n, 3) of the drives of `LAW`."""
    angles = q[:, trial.coordinates.device_columns]
    rows = np.array([np.zeros(3), *LAW.values()])
    return np.sin(angles @ TURNS.T) @ rows.T


def led(trial, more=0.0):
    """The trial with drives that go by the device's posture, and by more."""
    names, moments = trial.coordinates, trial.moments.copy()
    drive = by_posture(trial, trial.q)
    drive[:, 1:] += 2.0 + np.multiply.outer(more, [1.0, 1.0])
    moments[:, names.is_device_joint] = drive + 0.7
    return replace(trial, moments=moments)


def trials_of(wearer):
    """Three movements whose devices lag differently behind the person."""
    (own,) = wearer.trials
    found = []
    for off in (0.0, 0.1, -0.07):
        q = own.q.copy()
        s = own.times / own.duration
        q[:, own.coordinates.device_columns] += off * np.stack(
            [s, s**2, np.cos(3.0 * s)], axis=1
        )
        found.append(replace(own, q=q))
    return found


def test_recordings_tell_how_drives_go_by_posture(wearer):
    trials = [led(t) for t in trials_of(wearer)]

    def law(trials, noise_nm=0.3, wearer=wearer):
        return posture_law(replace(wearer, trials=trials), noise_nm)

    found = law(trials)
    assert list(found) == ["exo_knee", "exo_hip"]
    for joint, by in found.items():
        np.testing.assert_allclose(by, LAW[joint], atol=1e-6)
    # Torques that posture does not tell to within their noise.
    other = [led(t, np.sin(30.0 * t.times)) for t in trials]
    assert law(other) == {}
    assert set(law(other, 1.0)) == set(LAW)
    # Drives that hardly give more than noise.
    assert law(trials, 50.0) == {}
    # Springs of a device that carries nothing are none.
    passive = replace(wearer, device=Device())
    said = {"moments": {"exoskeleton": "device model"}}
    modelled = [replace(t, provenance=said) for t in trials]
    assert law(modelled) != {}
    assert law(modelled, wearer=passive) == {}
    assert law([]) == {}


def test_slope_by_posture_is_that_of_differences(wearer):
    (own,) = wearer.trials
    slope = replace(wearer, law=LAW).slope(own.q)
    device = own.coordinates.device_columns
    for k, column in enumerate(device):
        step = np.zeros(own.q.shape[1])
        step[column] = 1e-6
        change = by_posture(own, own.q + step) - by_posture(own, own.q - step)
        np.testing.assert_allclose(slope[:, :, k], change / 2e-6, atol=1e-6)
    assert not wearer.slope(own.q).any()


@pytest.mark.slow
def test_a_forecast_s_torques_answer_as_far_as_the_device_strays(wearer):
    """Torques are as designed where it is today, and answer from there."""
    who = replace(wearer, law=LAW)
    (own,) = who.trials
    design = Design(assistance={"exo_hip": Assistance((0.0,), (0.5,))})
    answers = answer(own, who, own, design)
    posed = OwnMovement(
        who.model,
        [own],
        who.contact,
        PredictionSettings(),
        answers={own.name: answers},
    )
    (movement,) = posed.movements
    at = own.sample(movement.grid.times)
    (term,) = torque_terms(movement, at, posed.settings.noise, answer=answers)
    assert any(
        np.array_equal(t.rows, term.rows)
        and np.array_equal(t.target, term.target)
        for t in movement.tracked
        if t.rows.shape == term.rows.shape
    )
    device = own.coordinates.device_columns
    for off in (0.0, 0.01):
        moments = at.moments.copy()
        q = at.q.copy()
        q[:, device] += off * np.array([1.0, -2.0, 0.5])
        more = by_posture(own, q) - by_posture(own, at.q)
        moments[:, own.coordinates.is_device_joint] += more * [1.0, 1.0, 0.5]
        x = np.hstack([moments, q[:, device]])
        found = np.einsum("nrm,nm->nr", term.rows, x)
        np.testing.assert_allclose(found, term.target, atol=0.02)
        if off:
            assert np.abs(more).max() > 0.5


def test_a_design_s_torques_answer_with_their_factor(wearer):
    who = replace(wearer, law=LAW)
    today = as_guessed(DesignProblem([who], SETTINGS, held=True))
    problem = DesignProblem([who], SETTINGS, today=today)
    (part,) = problem.parts
    (movement,) = part.movements
    names = movement.coordinates
    at = who.trials[0].sample(movement.grid.times)
    factors = {
        v.name: 0.8 for v in problem.design if v.name.startswith("exo_hip.f")
    }
    x = problem.guess(factors)
    q = at.q.copy()
    q[:, names.device_columns] += 0.01 * np.array([1.0, -2.0, 0.5])
    index = problem.program.indices
    x[index(movement.grid.q)] = q
    (hip,) = np.flatnonzero(np.array(names.joints) == "exo_hip")
    drive = at.moments[:, hip] + by_posture(at, q)[:, 2]
    drive -= by_posture(at, at.q)[:, 2]
    x[index(movement.torque[:, hip])] = 0.8 * drive
    name = f"{movement.name} exo_hip assistance"
    (group,) = (g for g in problem.program.constraints if g.name == name)
    inputs = x[group.indices]
    left = group.kernel.evaluate(inputs, group.data) - group.lower
    assert np.abs(left).max() < 1e-3
