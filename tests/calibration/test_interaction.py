"""Phase B on data whose truth is the model."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration import audit
from drake_exo.calibration.scores import rmsd
from drake_exo.calibration.uncertainty import noise_basis, uncertainty
from drake_exo.virtual_laboratory.interaction_twin import (
    INSTRUMENT_NOISE,
    exact_settings,
)
from drake_exo.virtual_laboratory.twin import noisy, random_values

# Exact data determine all but the shank's cuff, which hardly moves.
SEEDS = 4


@pytest.fixture(scope="module")
def exact(cuffs_twin):
    problem = cuffs_twin.calibration(exact_settings(cuffs_twin))
    return problem, problem.solve()


def truth_of(twin):
    return np.array([p.nominal for p in twin.truth])


def test_identifiable_parameters_come_back(exact, cuffs_twin):
    _, result = exact
    assert result.solution.success
    truth = truth_of(cuffs_twin)
    for p, true in zip(result.parameters, truth, strict=True):
        if not p.name.startswith("shank"):
            assert p.nominal == pytest.approx(true, rel=0.01), p.name


def test_all_forces_come_back(exact, cuffs_twin):
    """Tangential forces and moments of cuffs were never given."""
    problem, result = exact
    for found, trial in zip(
        result.trajectories, cuffs_twin.trials, strict=True
    ):
        scores = rmsd(found, trial)
        assert max(scores["interaction_n"].values()) < 0.1
        assert max(scores["moments_nm"].values()) < 0.1
        assert max(scores["grf_n"].values()) < 0.1
    # At 50 nodes a second; 200 keep within audit.FORCE_TOLERANCE.
    assert audit.between_nodes(problem, result, 0)[0] < 3.0
    t = result.trajectories[0]
    wrong = replace(t, interaction=t.interaction + 10.0)
    wrong = replace(result, trajectories=[wrong])
    assert audit.between_nodes(problem, wrong, 0)[0] > 9.0


def test_audit_simulates_with_the_cuffs(exact, cuffs_twin):
    from drake_exo.model.description import fit_exoskeleton, nominal_human

    problem, result = exact
    human = nominal_human()
    model = ("coupled", human, fit_exoskeleton(human))
    simulated = audit.simulate(*model, 9.81, problem, result, 0)
    checked = audit.compare(result.trajectories[0], simulated, (0.0, 0.0))
    assert checked.simulated_interaction_n < 1.0
    assert checked.simulated_angles_deg < 0.1
    # With softer cuffs the same torques end elsewhere.
    soft = replace(
        result,
        parameters=[
            replace(p, nominal=max(0.5 * p.nominal, p.lower))
            if p.name.endswith("stiffness")
            else p
            for p in result.parameters
        ],
    )
    simulated = audit.simulate(*model, 9.81, problem, soft, 0)
    checked = audit.compare(result.trajectories[0], simulated, (0.0, 0.0))
    assert checked.simulated_interaction_n > 1.0


def test_random_starts_reach_one_optimum(exact, cuffs_twin):
    settings = cuffs_twin.settings()
    problem = cuffs_twin.calibration(settings)
    best = problem.solve().solution.objective
    for values in random_values(problem.parameters, 3, seed=0):
        solution = problem.solve(problem.guess(values)).solution
        assert solution.success
        assert solution.objective == pytest.approx(best, rel=1e-4)


def test_truth_lies_in_the_intervals(cuffs_twin):
    settings = cuffs_twin.settings(noise=INSTRUMENT_NOISE)
    truth = truth_of(cuffs_twin)
    inside, counted = 0, 0
    for seed in range(SEEDS):
        trials = [
            noisy(trial, 1000 * seed + k, INSTRUMENT_NOISE)
            for k, trial in enumerate(cuffs_twin.trials)
        ]
        problem = cuffs_twin.calibration(settings, trials)
        result = problem.solve()
        assert result.solution.success
        found = uncertainty(problem, result)
        error = np.abs(result.values() - truth)
        known = found.identifiable
        inside += np.sum(error[known] <= found.half_width[known])
        counted += known.sum()
    assert counted > 6 * SEEDS
    assert inside >= 0.85 * counted


def test_intervals_are_not_too_wide(cuffs_twin):
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
        settings = cuffs_twin.settings(noise=noise, prior_weight=1e-6)
        problem = cuffs_twin.calibration(settings)
        found = uncertainty(problem, problem.solve())
        widths.append(found.sd[found.names.index("pelvis.normal_stiffness")])
    assert widths[1] < 0.3 * widths[0]


def test_response_predicts_another_solve(exact, cuffs_twin):
    """Shift a measured signal, solve again, compare with first order."""
    from drake_exo.nlp.sensitivity import response

    settings = cuffs_twin.settings()
    problem = cuffs_twin.calibration(settings)
    result = problem.solve()
    program = problem.compile()
    y = program.restrict(result.solution.raw_values())
    index = problem.program.indices(problem.parameter_variables)
    columns = program.unknowns.column_of(index)
    found = response(program, y, columns)
    first, *rest = cuffs_twin.trials
    ramp = np.linspace(0.0, 1.0, len(first.times))[:, None]
    shifted = replace(first, moments=first.moments + 0.2 * ramp)
    other = cuffs_twin.calibration(settings, [shifted, *rest])
    moved = other.solve(result.solution.raw_values())
    change = other.compile().gradient(y) - program.gradient(y)
    predicted = found.by_gradient @ change
    actual = other.compile().restrict(moved.solution.raw_values()) - y
    strong = np.abs(predicted) > 0.05 * np.abs(predicted).max()
    np.testing.assert_allclose(
        actual[columns][strong], predicted[strong], rtol=0.2
    )
    # The planted error: a response of the wrong sign must not pass.
    assert not np.allclose(actual[columns], -predicted, rtol=0.2)


def test_noise_basis_is_filtered_noise():
    times = np.linspace(0.0, 1.5, 151)
    values, slopes = noise_basis(times, 6.0, 4)
    np.testing.assert_allclose((values**2).sum(axis=1), 1.0)
    numeric = np.gradient(values, times, axis=0)[1:-1]
    np.testing.assert_allclose(slopes[1:-1], numeric, atol=0.05 * slopes.max())


def test_a_study_without_exoskeleton_is_refused(request, data_root, capsys):
    from drake_exo.cli import main

    study = request.config.rootpath / "tests/studies/opencap_sts1.yaml"
    command = ["calibrate", str(study), "--data-root", str(data_root)]
    code = main([*command, "--phase", "interaction", "--out", "unused"])
    assert code == 2
    error = capsys.readouterr().err
    assert "exoskeleton" in error and error.count("\n") == 1
