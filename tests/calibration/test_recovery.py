"""Twin experiment: data that the model made give back its parameters."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.settings import Solver
from drake_exo.virtual_laboratory import twin

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
def exact_data(tree, truth, defaults):
    return twin.consistent(tree, twin.rises(3, 1.0), truth, defaults)


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
        twin.noisy(movement, seed, noise, cutoff_hz=2.0)
        for seed, movement in enumerate(exact_data)
    ]


def errors(result, truth):
    """Relative error of each free parameter by name."""
    return {
        p.name: p.nominal / q.nominal - 1.0
        for p, q in zip(result.parameters, truth, strict=True)
        if p.free
    }


def listed(errors):
    return ", ".join(f"{n} {100.0 * e:+.2f} %" for n, e in errors.items())


def test_data_load_heel_and_toe(exact_data, truth):
    heel, toe = truth[2].nominal, truth[7].nominal
    for movement in exact_data:
        cop = -movement.ground[:, 2] / movement.ground[:, 1]
        share = (cop - movement.q[:, 0] - heel) / (toe - heel)
        assert share.min() < 0.5 < share.max()
        assert np.ptp(share) > 0.2


def test_every_parameter_comes_back(tree, exact_data, nominal, truth, defaults):
    noise = replace(defaults.noise, torque_nm=1e9, jerk=1e9)
    settings = replace(defaults, noise=noise, prior_weight=1e-9)
    problem = FootGroundProblem(tree, exact_data, nominal, settings)
    result = problem.solve()
    assert result.solution.success, result.solution.explain()
    found = errors(result, truth)
    print("twin, regularisers towards zero:", listed(found))
    assert len(found) == 8
    assert max(map(abs, found.values())) < 0.01, listed(found)
    biased = FootGroundProblem(tree, exact_data, nominal, defaults).solve()
    assert biased.solution.success
    bias = errors(biased, truth)
    print("bias at default weights:", listed(bias))
    # The regularisers pull: without them the match is far closer.
    assert max(map(abs, bias.values())) > max(map(abs, found.values()))


def test_every_parameter_comes_back_on_the_papers_grid(
    tree, nominal, truth, defaults
):
    solver = Solver(nodes_per_second=20.0, transcription="pseudospectral")
    settings = replace(defaults, solver=solver)
    data = twin.consistent(tree, twin.rises(2, 1.0), truth, settings)
    noise = replace(defaults.noise, torque_nm=1e9, jerk=1e9)
    settings = replace(settings, noise=noise, prior_weight=1e-9)
    result = FootGroundProblem(tree, data, nominal, settings).solve()
    assert result.solution.success, result.solution.explain()
    found = errors(result, truth)
    print("twin on the paper's grid:", listed(found))
    assert max(map(abs, found.values())) < 0.01, listed(found)


def test_random_starts_reach_one_optimum(tree, noisy_data, nominal, defaults):
    problem = FootGroundProblem(tree, noisy_data, nominal, defaults)
    objectives = []
    for values in twin.random_values(nominal, _STARTS, seed=0):
        result = problem.solve(problem.guess(values))
        assert result.solution.success, result.solution.explain()
        objectives.append(result.solution.objective)
    assert len(objectives) == _STARTS
    spread = max(objectives) / min(objectives) - 1.0
    assert spread < 1e-4


def test_random_starts_fill_the_bounds(nominal):
    values = np.array(list(twin.random_values(nominal, 200, seed=1)))
    for column, p in zip(values.T, nominal, strict=True):
        assert column.min() >= p.lower and column.max() <= p.upper
        if p.free:
            assert np.ptp(column) > 0.9 * p.span
        else:
            assert np.ptp(column) == 0.0


def test_reduced_and_full_problems_agree(tree, noisy_data, nominal, defaults):
    results = [
        FootGroundProblem(
            tree,
            noisy_data[:1],
            nominal,
            replace(
                defaults,
                solver=replace(defaults.solver, reduce=reduce, tolerance=1e-8),
            ),
        ).solve()
        for reduce in (True, False)
    ]
    reduced, full = results
    assert reduced.solution.success and full.solution.success
    assert reduced.solution.num_variables < full.solution.num_variables
    assert reduced.solution.objective == pytest.approx(
        full.solution.objective, rel=1e-7
    )
    np.testing.assert_allclose(reduced.values(), full.values(), rtol=1e-4)


def test_drakes_own_solver_reaches_the_same_optimum(
    tree, nominal, truth, defaults
):
    solver = Solver(nodes_per_second=10.0, tolerance=1e-4)
    settings = replace(defaults, solver=solver, prior_weight=1.0)
    data = twin.consistent(tree, twin.rises(1, 0.7), truth, settings)
    free = [replace(p, free=p.name.endswith(".z")) for p in nominal]
    ours = FootGroundProblem(tree, data, free, settings).solve()
    drake = replace(settings, solver=replace(solver, solver="drake"))
    theirs = FootGroundProblem(tree, data, free, drake).solve()
    assert ours.solution.success and theirs.solution.success
    assert ours.solution.objective == pytest.approx(
        theirs.solution.objective, rel=1e-4
    )
    np.testing.assert_allclose(ours.values(), theirs.values(), rtol=1e-3)
