"""Phase B on data whose truth is the model."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from measured_trials import saying

from drake_exo.calibration.audit import audit, between_nodes, rmsd
from drake_exo.calibration.phases import InteractionCalibration
from drake_exo.calibration.settings import InteractionSettings, Solver
from drake_exo.calibration.uncertainty import noise_basis, uncertainty
from drake_exo.cli import main
from drake_exo.measurement.trial import CuffForce
from drake_exo.nlp.sensitivity import response
from drake_exo.study import Calibration, Study
from drake_exo.virtual_laboratory.synthetic import (
    INSTRUMENT_NOISE,
    noisy,
    random_values,
)

pytestmark = pytest.mark.slow

# Exact data determine all but the shank's cuff, which hardly moves.
SEEDS = 4


def found_and_true(result, in_device):
    true = in_device.contact.values()
    return np.array([(p.nominal, true[p.name]) for p in result.parameters]).T


@pytest.mark.slow
def test_identifiable_parameters_come_back(exact, in_device):
    assert exact.success
    true = in_device.contact.values()
    for p in exact.parameters:
        if not p.name.startswith("shank"):
            assert p.nominal == pytest.approx(true[p.name], rel=0.01), p.name


@pytest.mark.slow
def test_all_forces_come_back(exact, in_device):
    """Tangential forces and moments of cuffs were never given."""
    for found, trial in zip(exact.trials, in_device.trials, strict=True):
        scores = rmsd(found, trial)
        assert max(scores["interaction_n"].values()) < 0.1
        assert max(scores["moments_nm"].values()) < 0.1
        assert max(scores["grf_n"].values()) < 0.1
    # At 50 nodes a second; 200 keep within audit.FORCE_TOLERANCE.
    assert between_nodes(exact, 0)[0].max() < 3.0
    t = exact.trials[0]
    wrong = {c: CuffForce.of(f.components + 10.0) for c, f in t.cuffs.items()}
    wrong = saying(exact, trials=[replace(t, cuffs=wrong)])
    assert between_nodes(wrong, 0)[0].max() > 9.0


@pytest.mark.slow
def test_a_strap_that_the_device_holds_elsewhere_is_strained(in_device):
    model = in_device.model
    x, z = model.exoskeleton.thigh_cuff_m
    device = replace(model.exoskeleton, thigh_cuff_m=(x + 0.004, z - 0.01))
    model = replace(model, exoskeleton=device)
    posed = InteractionCalibration(
        model, in_device.trials[:1], in_device.contact
    )
    cuffs = posed.contact.bushings
    assert cuffs["thigh"].preload == pytest.approx((0.004, -0.01, 0.0))
    assert cuffs["shank"].preload == (0.0, 0.0, 0.0)


def test_who_changes_a_contact_has_a_copy(exact, in_device):
    """A cuff made stiffer to predict with is not the calibration's."""
    study = Study(in_device.model, in_device.trials)
    found = Calibration("interaction", study, exact)
    values, contact = found.contact.values(), found.contact
    contact.bushings["thigh"] = contact.bushings["thigh"].scaled(2.0)
    contact.ground.spheres.clear()
    assert found.contact.values() == values


def test_audit_simulates_with_the_cuffs(exact):
    checked = audit(exact)
    assert checked.simulated_interaction_n < 1.0
    assert checked.simulated_angles_deg < 0.1
    # With softer cuffs the same torques end elsewhere.
    soft = exact.contact.with_values(
        {
            p.name: max(0.5 * p.nominal, p.lower)
            for p in exact.parameters
            if p.name.endswith("stiffness")
        }
    )
    checked = audit(saying(exact, contact=soft))
    assert checked.simulated_interaction_n > 1.0


@pytest.mark.slow
def test_random_starts_reach_one_optimum(regular):
    problem, best = regular.problem, regular.solution.objective
    for values in random_values(problem.parameters, 3, seed=0):
        solution = problem.solve(problem.guess(values)).solution
        assert solution.success
        assert solution.objective == pytest.approx(best, rel=1e-4)


@pytest.mark.slow
def test_truth_lies_in_the_intervals(in_device):
    # Next to no prior: noise alone is what intervals are to tell.
    settings = in_device.settings(noise=INSTRUMENT_NOISE, prior_weight=0.01)
    inside, counted = 0, 0
    for seed in range(SEEDS):
        trials = [
            noisy(trial, 1000 * seed + k, INSTRUMENT_NOISE)
            for k, trial in enumerate(in_device.trials)
        ]
        result = in_device.calibration(settings, trials).solve()
        assert result.success
        found = uncertainty(result)
        error = np.abs(np.subtract(*found_and_true(result, in_device)))
        known = found.identifiable
        inside += np.sum(error[known] <= found.half_width[known])
        counted += known.sum()
    assert counted > 6 * SEEDS
    assert inside >= 0.85 * counted


@pytest.mark.slow
def test_intervals_are_not_too_wide(in_device):
    """A tenth of the noise gives a tenth of the interval."""
    small = replace(
        INSTRUMENT_NOISE,
        **{
            name: 0.1 * value
            for name, value in vars(INSTRUMENT_NOISE).items()
            if name not in ("energy_j", "jerk", "torque_nm")
        },
    )
    widths = []
    for noise in (INSTRUMENT_NOISE, small):
        settings = in_device.settings(noise=noise, prior_weight=1e-6)
        found = uncertainty(in_device.calibration(settings).solve())
        widths.append(found.sd[found.names.index("pelvis.normal_stiffness")])
    assert widths[1] < 0.3 * widths[0]


def test_response_predicts_another_solve(regular, in_device):
    """Shift a measured signal, solve again, compare with first order."""
    problem = regular.problem
    program, start = problem.compiled, regular.solution.raw_values()
    y = program.restrict(start)
    index = problem.program.indices(problem.parameter_variables)
    columns = program.unknowns.column_of(index)
    found = response(program, y, columns)
    first, *rest = in_device.trials
    ramp = np.linspace(0.0, 1.0, len(first.times))[:, None]
    shifted = replace(first, moments=first.moments + 0.2 * ramp)
    other = in_device.calibration(problem.settings, [shifted, *rest])
    moved = other.solve(start)
    change = other.compiled.gradient(y) - program.gradient(y)
    predicted = found.by_gradient @ change
    actual = other.compiled.restrict(moved.solution.raw_values()) - y
    # What moves little follows curvature that Gauss and Newton leave out:
    # slipping cuffs, logarithms of priors.
    largest = np.abs(predicted).max()
    assert (np.abs(predicted) > 0.2 * largest).sum() >= 4
    near = {"rtol": 0.2, "atol": 0.06 * largest}
    np.testing.assert_allclose(actual[columns], predicted, **near)
    # Planted errors: a response of the wrong sign or size must not pass.
    for factor in (-1.0, 0.5, 2.0):
        assert not np.allclose(actual[columns], factor * predicted, **near)


def test_noise_basis_is_filtered_noise():
    times = np.linspace(0.0, 1.5, 151)
    values, slopes = noise_basis(times, 6.0, 4)
    np.testing.assert_allclose((values**2).sum(axis=1), 1.0)
    numeric = np.gradient(values, times, axis=0)[1:-1]
    np.testing.assert_allclose(slopes[1:-1], numeric, atol=0.05 * slopes.max())


def test_a_study_without_exoskeleton_is_refused(request, data_root, capsys):
    study = request.config.rootpath / "tests/studies/opencap_sts1.yaml"
    command = ["calibrate", str(study), "--data-root", str(data_root)]
    code = main([*command, "--phase", "interaction", "--out", "unused"])
    assert code == 2
    error = capsys.readouterr().err
    assert "exoskeleton" in error and error.count("\n") == 1


def test_near_its_solution_every_second_derivative_enters(
    in_device, monkeypatch
):
    """Of the Lagrangian, against differences of its gradient."""
    settings = InteractionSettings(solver=Solver(10.0))
    problem = InteractionCalibration(
        in_device.model, in_device.trials[:1], in_device.contact, settings
    )
    found = problem.solve()
    assert problem.solve(near=found).solution.strategy == "near_exact"
    program = problem.compiled
    rng = np.random.default_rng(3)
    y = program.restrict(found.solution.raw_values())
    weights = rng.standard_normal(program.num_constraints)
    along = rng.standard_normal(len(y)) * (program.y_upper > program.y_lower)

    def gradient(y):
        shape = (len(weights), len(y))
        entries = program.jacobian(y), program.jacobian_structure
        slopes = sp.csr_array(entries, shape).T @ weights
        return program.gradient(y) + slopes

    h = 1e-6
    expected = (gradient(y + h * along) - gradient(y - h * along)) / (2.0 * h)

    def bent():
        entries = program.hessian(y, weights, 1.0), program.hessian_structure
        lower = sp.csr_array(entries, (len(y), len(y)))
        return (lower + sp.tril(lower, -1).T) @ along

    off = np.abs(bent() - expected).max() / np.abs(expected).max()
    monkeypatch.setattr(program, "exact_hessian", True)
    exact = np.abs(bent() - expected).max() / np.abs(expected).max()
    assert exact < 1e-5 < 1e-3 < off
