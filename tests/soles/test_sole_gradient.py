"""Gradients of the simulation by shape against finite differences."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from small_parts import START, measure, small_problem, with_setup

from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.elasticity import MATERIALS, Sole, energy_gradients
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import SphericalSpline, brick
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.optimize.adjoint import gradients, singular_terms
from drake_exo.soles.optimize.limits import StrainNorm
from drake_exo.soles.optimize.search import settle
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Stage
from drake_exo.soles.simulation import simulate

pytestmark = pytest.mark.slow

SIZE = (0.23, 0.13, 0.03)
STAGE = {"layer_m": 5e-5, "kappa": 0.2}


def _load(count):
    s = np.linspace(0, 1, count)
    force = np.stack(
        [40 * np.cos(np.pi * s), -20 * np.sin(np.pi * s),
         150 + 500 * np.sin(np.pi * s)], axis=1,
    )  # fmt: skip
    zmp = np.stack([-0.08 + 0.13 * s, 0.04 - 0.02 * np.sin(np.pi * s)], 1)
    return Load(0.05 * np.arange(count), force, zmp)


def _rolling(load, pose):
    """The load with a free moment, or with a measured pose."""
    s = np.linspace(0, 1, len(load.times))
    if pose == "moment":
        return replace(load, free_moment=1.5 * np.sin(2 * np.pi * s))
    angles = np.stack([0.02 * np.cos(s), -0.03 + 0.08 * s, 0 * s], axis=1)
    return replace(load, rotation=rotations_xyz(angles))


class Setting:
    def __init__(self, divisions, count, element="linear", layer=5e-5):
        self.mesh = brick(SIZE, divisions)
        self.spline = SphericalSpline((6, 6))
        self.M, _ = self.spline.basis(self.mesh.nodes)
        self.element = element
        self.load = _load(count)
        self.material = MATERIALS["neoprene"]
        r = Sole(self.mesh, self.material, element).penalty
        self.law = ContactLaw(0.8, r, layer, 0.2)

    def forward(self, p):
        mesh = self.mesh.with_nodes(self.spline.deform(self.mesh.nodes, p))
        sole = Sole(mesh, self.material, self.element)
        solver = ContactSolver.of(sole, self.law, tolerance=1e-13)
        history = simulate(solver, self.load, START, keep=True)
        assert history.failed_steps == 0
        return sole, solver, history

    def gradient(self, p, by_tr, by_rot):
        sole, solver, history = self.forward(p)
        (X,), _ = gradients(
            sole, solver, self.load, START, history,
            [singular_terms(history.K_c, by_tr, by_rot)],
        )  # fmt: skip
        return self.M.T @ (X * self.mesh.nodes).sum(axis=1)


@pytest.mark.parametrize(
    ("divisions", "count", "element"),
    [((6, 4, 3), 1, "linear"), ((6, 5, 4), 8, "linear"),
     ((6, 4, 3), 5, "smoothed"), ((14, 8, 4), 4, "linear")],
)  # fmt: skip
def test_gradient_matches_central_differences(divisions, count, element):
    setting = Setting(divisions, count, element)
    rng = np.random.default_rng(0)
    p = 1 + 0.05 * rng.standard_normal(setting.spline.count)
    by_tr = (np.arange(count) < 2).astype(float)
    by_rot = -3.0 * np.ones(count)
    direction = rng.standard_normal(len(p))
    slope = setting.gradient(p, by_tr, by_rot) @ direction
    errors = []
    for h in (1e-6, 3e-7):
        plus, minus = (
            measure(setting.forward(p + s * h * direction)[2], by_tr, by_rot)
            for s in (1, -1)
        )
        errors.append(abs((plus - minus) / (2 * h) / slope - 1))
    assert min(errors) < 1e-5
    # A planted error of a tenth of a per mille must not go unnoticed.
    assert abs((plus - minus) / (2 * h) / (1.0001 * slope) - 1) > 1e-5


@pytest.mark.parametrize("element", ["linear", "smoothed"])
def test_gradient_by_the_load_matches_central_differences(element):
    """By forces and ZMPs of all samples together, and of each alone."""
    setting, count = Setting((6, 5, 4), 6, element), 6
    rng = np.random.default_rng(2)
    p = 1 + 0.05 * rng.standard_normal(setting.spline.count)
    by_tr = (np.arange(count) < 3).astype(float)
    by_rot = -3.0 * np.ones(count)
    given = setting.load
    sole, solver, history = setting.forward(p)
    terms = singular_terms(history.K_c, by_tr, by_rot)
    _, (found,) = gradients(sole, solver, given, START, history, [terms])

    def at(force, zmp):
        setting.load = replace(given, force=force, zmp=zmp)
        return measure(setting.forward(p)[2], by_tr, by_rot)

    weights = [np.ones(count), np.eye(count)[0], np.eye(count)[3]]
    for row, part in itertools.product(weights, ("force", "zmp")):
        d = rng.standard_normal((count, 3)) * row[:, None]
        h = 1e-3 if part == "force" else 1e-7
        ends = [
            at(given.force + s * h * d, given.zmp)
            if part == "force"
            else at(given.force, given.zmp + s * h * d[:, :2])
            for s in (1, -1)
        ]
        numeric = (ends[0] - ends[1]) / (2 * h)
        exact = (
            (found[:, :3] * d).sum()
            if part == "force"
            else (found[:, 3:] * d[:, :2]).sum()
        )
        assert exact == pytest.approx(numeric, rel=3e-5)


@pytest.mark.parametrize("pose", ["moment", "measured"])
def test_gradient_with_a_free_moment_or_a_measured_pose(pose):
    setting = Setting((6, 4, 3), 4, "smoothed")
    setting.load = _rolling(setting.load, pose)
    rng = np.random.default_rng(0)
    p = 1 + 0.05 * rng.standard_normal(setting.spline.count)
    by_tr, by_rot = np.array([1.0, 1.0, 0.0, 0.0]), -3.0 * np.ones(4)
    direction, h = rng.standard_normal(len(p)), 1e-6
    slope = setting.gradient(p, by_tr, by_rot) @ direction
    plus, minus = (
        measure(setting.forward(p + s * h * direction)[2], by_tr, by_rot)
        for s in (1, -1)
    )
    assert (plus - minus) / (2 * h) == pytest.approx(slope, rel=1e-5)
    # The load as it was before has another gradient.
    setting.load = replace(setting.load, free_moment=None, rotation=None)
    other = setting.gradient(p, by_tr, by_rot) @ direction
    assert other != pytest.approx(slope, rel=1e-3)


def _two_loads(of):
    """A problem of two loads, the second a faster, harder step."""
    setting = Setting((6, 4, 3), 6, "smoothed")
    hard = replace(setting.load, force=1.3 * setting.load.force).every(5)
    both = Load.one_after_another([setting.load, hard], [1.0, 3.0])
    return small_problem(
        setting.mesh, both, START, Stage(samples=4, **STAGE), "smoothed",
        {"weight": 1.0, "heel_strike_fraction": 0.4, "of": of},
        intervals=(6, 6), roughness=1e-2, stability_n_per_m=None,
        tilt_deg=20.0, strain=None,
    )  # fmt: skip


@pytest.mark.parametrize("of", ["mean", "worst"])
def test_gradient_for_several_loads(of):
    problem = _two_loads(of)
    rng = np.random.default_rng(3)
    p = 1 + 0.04 * rng.standard_normal(problem.spline.count)
    direction, h = rng.standard_normal(len(p)), 1e-6
    gradient, jacobian = problem.derivatives(p)
    slope = gradient @ direction + problem.regularization(p)[1] @ direction
    plus, minus = (problem.cost(p + s * h * direction) for s in (1, -1))
    assert (plus - minus) / (2 * h) == pytest.approx(slope, rel=1e-5)
    over, under = (problem.constraints(p + s * h * direction) for s in (1, -1))
    np.testing.assert_allclose(
        jacobian @ direction, (over - under) / (2 * h), rtol=1e-4, atol=1e-6
    )


def test_several_loads_are_as_each_alone():
    problem = _two_loads("mean")
    p = 1 + 0.03 * np.random.default_rng(4).standard_normal(
        problem.spline.count
    )
    ratios = []
    for phase, loads in zip(problem.load.phases, (1.0, 3.0), strict=True):
        load = problem.load.at(np.arange(len(problem.load.times))[phase])
        alone = with_setup(problem, load=load)
        assert alone.load.weights == (loads,)
        free = alone.cost(p) - alone.regularization(p)[0]
        ratios.append(free)
    mean = problem.cost(p) - problem.regularization(p)[0]
    assert mean == pytest.approx(0.25 * ratios[0] + 0.75 * ratios[1], rel=1e-9)
    worst = _two_loads("worst").cost(p) - problem.regularization(p)[0]
    assert max(ratios) <= worst <= max(ratios) + np.log(2) / 40


def _problem(element):
    setting = Setting((6, 4, 3), 12, element)
    return small_problem(
        setting.mesh, setting.load, START, Stage(samples=8, **STAGE), element,
        {"weight": 1.0, "heel_strike_fraction": 0.1},
        intervals=(6, 6), roughness=1e-2, stability_n_per_m=500.0,
        tilt_deg=20.0, strain=0.5, c_rot_nm_per_rad=1e4,
    )  # fmt: skip


@pytest.fixture(scope="module")
def problem():
    return _problem("linear")


@pytest.fixture(scope="module")
def smoothed():
    return _problem("smoothed")


@pytest.mark.slow
@pytest.mark.parametrize("element", ["problem", "smoothed"])
def test_cost_and_constraints_have_right_derivatives(element, request):
    problem = request.getfixturevalue(element)
    rng = np.random.default_rng(1)
    p = 0.97 + 0.02 * rng.standard_normal(problem.spline.count)
    direction = rng.standard_normal(len(p))
    gradient, jacobian = problem.derivatives(p)
    gradient = gradient + problem.regularization(p)[1]
    assert jacobian.shape == (len(problem.names()), len(p))
    exact = np.array([gradient @ direction, *(jacobian @ direction)])

    def values(x):
        return np.array([problem.cost(x), *problem.constraints(x)])

    errors = [
        np.abs(
            (values(p + h * direction) - values(p - h * direction))
            / (2 * h * exact)
            - 1
        )
        for h in (1e-6, 1e-7)
    ]
    np.testing.assert_array_less(np.min(errors, axis=0), 1e-5)


def test_strain_gradient_without_its_adjoint_is_caught(problem):
    p = np.full(problem.spline.count, 0.97)
    direction = np.random.default_rng(2).standard_normal(len(p))
    row = problem.names().index("strain")
    slope = problem.derivatives(p)[1][row] @ direction
    e = problem.evaluate(p)
    direct = e.strain.derivatives()
    by_nodes = direct.by_nodes + energy_gradients(e.sole, [direct.fields])[0]
    partial = problem.by_coefficients(by_nodes) @ direction
    h = 1e-6
    plus, minus = (
        problem.evaluate(p + s * h * direction).strain.value for s in (1, -1)
    )
    difference = (plus - minus) / (2 * h)
    assert -0.5 * slope == pytest.approx(difference, rel=1e-5)
    assert abs(partial / difference - 1) > 1e-3


def test_strain_norm_is_close_above_the_largest_strain(problem):
    e = problem.evaluate(np.full(problem.spline.count, 0.97))
    step = Step(problem.setup, e.sole, problem.law, e.history)
    largest = step.largest_strain
    assert largest <= e.strain.value < 1.15 * largest


@pytest.mark.slow
def test_shares_of_the_averages_count_in_the_strains_gradient(
    smoothed, monkeypatch
):
    p = np.full(smoothed.spline.count, 0.97)
    direction = np.random.default_rng(4).standard_normal(len(p))
    row = smoothed.names().index("strain")
    right = smoothed.derivatives(p)[1][row] @ direction
    around = StrainNorm._elements_around
    monkeypatch.setattr(
        StrainNorm,
        "_elements_around",
        lambda self, by_nodes: around(self, np.zeros_like(by_nodes)),
    )
    assert abs(smoothed.derivatives(p)[1][row] @ direction / right - 1) > 1e-4


def test_second_derivative_of_the_smoothness(problem):
    rng = np.random.default_rng(3)
    p, d = rng.standard_normal((2, problem.spline.count))
    value, gradient, hessian = problem.regularization(p)
    exact = value + gradient @ d + 0.5 * d @ hessian @ d
    assert problem.regularization(p + d)[0] == pytest.approx(exact, rel=1e-12)


def test_a_shape_that_cannot_be_simulated_is_nan(problem):
    p = np.ones(problem.spline.count)
    p[::2] = -1.0
    assert np.isnan(problem.cost(p))
    assert np.isnan(problem.constraints(p)).all()


def test_optimiser_lowers_the_cost_within_the_limits(problem):
    from drake_exo.soles.optimize.optimizer import minimise

    p0 = np.full(problem.spline.count, 0.96)
    best = minimise(problem, p0, (0.5, 1.25), iterations=13)
    assert best.violation < 1e-4
    assert best.cost < 0.8 * problem.cost(p0)
    # What was found is found again from a cold start.
    assert problem.branch is None
    assert problem.cost(best.p) == pytest.approx(best.cost, rel=1e-9)
    assert (best.p >= 0.5).all()
    assert (best.p <= 1.25).all()


@pytest.mark.slow
def test_a_design_without_a_cold_start_gives_way(problem, monkeypatch):
    from drake_exo.soles.optimize.optimizer import minimise

    p0, real = np.full(problem.spline.count, 0.96), problem._simulate
    lost = minimise(problem, p0, (0.5, 1.25), iterations=6).p
    problem.leave_branch()

    def simulate(p):
        cold = problem.branch is None and np.allclose(p, lost, atol=1e-9)
        return None if cold else real(p)

    monkeypatch.setattr(problem, "_simulate", simulate)
    best = minimise(problem, p0, (0.5, 1.25), iterations=6)
    assert np.abs(best.p - lost).max() > 1e-4
    assert best.cost == pytest.approx(problem.cost(best.p), rel=1e-9)
    assert best.status == "only followed from a neighbour"
    problem.leave_branch()


def test_first_guesses_from_a_neighbour_change_nothing(problem, monkeypatch):
    monkeypatch.setattr(problem, "branch", None)
    monkeypatch.setattr(problem, "_cache", {})
    rng, p = np.random.default_rng(3), np.full(problem.spline.count, 0.96)
    cold = problem.evaluate(p)
    for _ in range(25):  # rounding must not grow from design to design
        problem.accept(p)
        p = p + 2e-3 * rng.standard_normal(len(p))
        near = problem.evaluate(p)
    turned = near.history.R @ near.history.R.swapaxes(1, 2)
    assert np.abs(turned - np.eye(3)).max() < 1e-13
    problem.leave_branch()
    again = problem.evaluate(p)
    scale = np.abs(again.history.K_c).max()
    assert np.abs(near.history.K_c - again.history.K_c).max() < 1e-9 * scale
    assert np.abs(near.history.K_c - cold.history.K_c).max() > 1e-3 * scale
    steps = [
        sum(r.iterations for r in e.history.reports[1:]) for e in (near, again)
    ]
    assert steps[0] < steps[1]


def test_a_trial_that_takes_too_long_is_a_failure(problem, monkeypatch):
    monkeypatch.setattr(problem, "branch", None)
    monkeypatch.setattr(problem, "_cache", {})
    p = np.full(problem.spline.count, 0.96)
    problem.accept(p)
    assert problem.evaluate(0.99 * p) is not None
    monkeypatch.setattr("drake_exo.soles.simulation._PATIENCE", 0.1)
    assert problem.evaluate(0.98 * p) is None
    problem.leave_branch()
    assert problem.evaluate(0.98 * p) is not None


def test_a_design_that_inverts_elements_is_smoothed(problem):
    rng = np.random.default_rng(5)
    p = 0.97 + 0.6 * rng.standard_normal(problem.spline.count)
    p = np.clip(p, 0.3, 1.4)
    assert problem.evaluate(p) is None
    q = settle(problem, p)
    assert problem.constraints(q)[1] >= 0
    assert np.corrcoef(p, q)[0, 1] > 0.3
    np.testing.assert_array_equal(settle(problem, q), q)
