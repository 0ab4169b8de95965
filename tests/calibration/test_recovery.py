"""Phase A: data that the model made give back its parameters."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import Solver
from drake_exo.virtual_laboratory import synthetic

pytestmark = pytest.mark.slow

# What the truth adds to, or multiplies, at heel and toe.
_SHIFT = {"x": (0.01, -0.012), "z": (-0.004, 0.005)}
_FACTOR = {"stiffness": (1.3, 0.8), "dissipation": (1.4, 0.7)}
_STARTS = 6


@pytest.fixture(scope="module")
def truth(nominal):
    def true(p):
        sphere, name = p.name.split(".")
        toe = int(sphere == "toe")
        shift = _SHIFT.get(name, (0.0, 0.0))[toe]
        factor = _FACTOR.get(name, (1.0, 1.0))[toe]
        return replace(p, nominal=factor * p.nominal + shift)

    return [true(p) for p in nominal]


@pytest.fixture(scope="module")
def exact_data(human, truth, defaults):
    drawn = synthetic.rises(3, 1.0)
    return synthetic.consistent(human, drawn, truth, defaults)


@pytest.fixture(scope="module")
def noisy_data(exact_data, defaults):
    noise = replace(
        defaults.noise,
        angle_deg=0.3,
        foot_m=0.0005,
        foot_pitch_deg=0.1,
        force_n=3.0,
        cop_m=0.002,
    )
    return [
        synthetic.noisy(movement, seed, noise, cutoff_hz=2.0)
        for seed, movement in enumerate(exact_data)
    ]


def errors(result, truth):
    """Relative error of each free parameter by name."""
    return {
        p.name: p.nominal / q.nominal - 1.0
        for p, q in zip(result.parameters, truth, strict=True)
        if p.free
    }


def values(result):
    return [p.nominal for p in result.parameters]


def listed(errors):
    return ", ".join(f"{n} {100.0 * e:+.2f} %" for n, e in errors.items())


def test_data_load_heel_and_toe(exact_data, truth):
    true = {p.name: p.nominal for p in truth}
    heel, toe = true["heel.x"], true["toe.x"]
    for trial in exact_data:
        cop = trial.ground.cop_x
        share = (cop - trial.coordinate("foot_x") - heel) / (toe - heel)
        assert share.min() < 0.5 < share.max()
        assert np.ptp(share) > 0.2


def test_every_parameter_comes_back(human, exact_data, truth, defaults):
    noise = replace(defaults.noise, torque_nm=1e9, jerk=1e9)
    settings = replace(defaults, noise=noise, prior_weight=1e-9)
    problem = FootGroundCalibration(human, exact_data, settings)
    result = problem.solve()
    assert result.success, result.solution.explain()
    found = errors(result, truth)
    print("regularisers towards zero:", listed(found))
    assert len(found) == 8
    assert max(map(abs, found.values())) < 0.01, listed(found)
    biased = FootGroundCalibration(human, exact_data, defaults).solve()
    assert biased.success
    bias = errors(biased, truth)
    print("bias at default weights:", listed(bias))
    # The regularisers pull: without them the match is far closer.
    assert max(map(abs, bias.values())) > max(map(abs, found.values()))


def test_every_parameter_comes_back_on_the_papers_grid(human, truth, defaults):
    solver = Solver(nodes_per_second=20.0, transcription="pseudospectral")
    settings = replace(defaults, solver=solver)
    data = synthetic.consistent(human, synthetic.rises(2, 1.0), truth, settings)
    noise = replace(defaults.noise, torque_nm=1e9, jerk=1e9)
    settings = replace(settings, noise=noise, prior_weight=1e-9)
    result = FootGroundCalibration(human, data, settings).solve()
    assert result.success, result.solution.explain()
    found = errors(result, truth)
    print("on the paper's grid:", listed(found))
    assert max(map(abs, found.values())) < 0.01, listed(found)


@pytest.mark.slow
def test_random_starts_reach_one_optimum(human, noisy_data, nominal, defaults):
    problem = FootGroundCalibration(human, noisy_data, defaults)
    objectives = []
    for start in synthetic.random_values(nominal, _STARTS, seed=0):
        result = problem.solve(problem.guess(start))
        assert result.success, result.solution.explain()
        objectives.append(result.solution.objective)
        # Times are of this solve, though the program has been solved before.
        assert min(result.solution.seconds.values()) >= 0.0
    assert len(objectives) == _STARTS
    spread = max(objectives) / min(objectives) - 1.0
    assert spread < 1e-4


def test_random_starts_fill_the_bounds(nominal):
    starts = np.array(list(synthetic.random_values(nominal, 200, seed=1)))
    for column, p in zip(starts.T, nominal, strict=True):
        assert column.min() >= p.lower and column.max() <= p.upper
        if p.free:
            assert np.ptp(column) > 0.9 * p.span
        else:
            assert np.ptp(column) == 0.0


def test_reduced_and_full_problems_agree(human, noisy_data, defaults):
    results = [
        FootGroundCalibration(
            human,
            noisy_data[:1],
            replace(
                defaults,
                solver=replace(defaults.solver, reduce=reduce, tolerance=1e-8),
            ),
        ).solve()
        for reduce in (True, False)
    ]
    reduced, full = results
    assert reduced.success and full.success
    assert reduced.solution.num_variables < full.solution.num_variables
    assert reduced.solution.objective == pytest.approx(
        full.solution.objective, rel=1e-7
    )
    np.testing.assert_allclose(values(reduced), values(full), rtol=1e-4)


@pytest.mark.slow
def test_drakes_own_solver_reaches_the_same_optimum(
    human, nominal, truth, defaults
):
    # Without a Hessian it takes some 260 to 380 iterations, by rounding.
    solver = Solver(nodes_per_second=10.0, tolerance=1e-4, max_iterations=800)
    settings = replace(defaults, solver=solver, prior_weight=1.0)
    data = synthetic.consistent(human, synthetic.rises(1, 0.5), truth, settings)
    free = [replace(p, free=p.name.endswith(".z")) for p in nominal]
    ours = FootGroundCalibration(human, data, settings, free).solve()
    drake = replace(settings, solver=replace(solver, solver="drake"))
    theirs = FootGroundCalibration(human, data, drake, free).solve()
    assert ours.success and theirs.success
    assert ours.solution.objective == pytest.approx(
        theirs.solution.objective, rel=1e-4
    )
    np.testing.assert_allclose(values(ours), values(theirs), rtol=1e-3)
