"""Limits of a shape problem: values by hand, slopes by differences."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import nnls
from small_parts import with_setup

from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, brick
from drake_exo.soles.numerics import exp_rotation, rotations_xyz
from drake_exo.soles.optimize import limits as module
from drake_exo.soles.optimize.limits import (
    SurfaceLimits,
    active_limits,
    soft_minimum,
)
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.search import nearest_allowed

NAMES = ["volume", "elements", "depth", "height", "draft_deg", "stability",
         "tilt_deg", "strain", "c_rot"]  # fmt: skip


@pytest.fixture(scope="module")
def problem():
    """Every limit there is, two samples, the second harder."""
    case = Case.from_text(EXAMPLE)
    block = replace(
        case.settings.optimize, stability_n_per_m=500.0, tilt_deg=15.0,
        strain=0.4, c_rot_nm_per_rad=300.0, roughness=0.1,
    )  # fmt: skip
    shape = replace(
        block.shape, least_depth_m=0.02, largest_height_m=0.05, draft_deg=2.0
    )
    settings = replace(case.settings, optimize=replace(block, shape=shape))
    load = case.load.at(np.arange(2))
    zmp = load.zmp + np.array([[0.0, 0.0], [0.02, -0.01]])
    load = replace(load, force=load.force * [[1.0], [1.4]], zmp=zmp)
    setup = replace(case, settings=settings, load=load)
    return ShapeProblem(setup, settings.optimize.stages[0])


@pytest.fixture(scope="module")
def design(problem):
    rng = np.random.default_rng(1)
    return 0.97 + 0.02 * rng.standard_normal(problem.spline.count)


@pytest.mark.slow
def test_slopes_of_cost_and_every_limit(problem, design):
    assert problem.names() == NAMES
    direction = np.random.default_rng(2).standard_normal(len(design))
    gradient, jacobian = problem.derivatives(design)
    exact = [gradient @ direction, *(jacobian @ direction)]
    h = 1e-6

    def values(p):
        free = problem.cost(p) - problem.regularization(p)[0]
        return np.array([free, *problem.constraints(p)])

    ahead, behind = (values(design + s * h * direction) for s in (1, -1))
    numeric = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(exact, numeric, rtol=2e-5, atol=1e-7)
    assert np.abs(numeric).min() > 1e-3


@pytest.mark.slow
def test_the_nearest_design_that_its_shape_allows(problem, design):
    """What pulls it back is held by limits alone; within them it stays."""

    def limits(p):
        return problem.shape_limits(p, problem.deformed(p))

    assert min(value for _, value, _ in limits(design)) < -0.05
    found = nearest_allowed(problem, (0.3, 1.4), design)
    values = np.array([value for _, value, _ in limits(found)])
    assert values.min() == pytest.approx(0.01, abs=1e-6)
    held = [row for _, value, row in limits(found) if value < 0.0101]
    pull = problem.metric @ (found - design)
    _, left = nnls(np.array(held).T, pull)
    assert left < 0.01 * np.linalg.norm(pull)
    np.testing.assert_allclose(
        nearest_allowed(problem, (0.3, 1.4), found), found, atol=1e-4
    )


@pytest.mark.slow
def test_slopes_by_force_and_zmp(problem, design):
    """Of cost and of the limits that need a simulation, each sample's own."""
    *_, by_load = problem._derivatives(design)
    assert by_load.shape == (5, 2, 5)
    rng = np.random.default_rng(5)
    for q in range(2):
        d, h = np.zeros((2, 5)), 1e-4
        d[q] = rng.standard_normal(5) * [1, 1, 1, 1e-3, 1e-3]

        def values(step, d=d):
            load = replace(
                problem.load, force=problem.load.force + step * d[:, :3],
                zmp=problem.load.zmp + step * d[:, 3:],
            )  # fmt: skip
            there = copy(problem)  # the first shape and its scales stay
            there.load, there.branch, there._cache = load, None, {}
            limits = there.constraints(design)[-4:]
            return np.array([there.cost(design), *limits])

        numeric = (values(h) - values(-h)) / (2 * h)
        exact = (by_load * d).sum(axis=(1, 2))
        size = np.abs(numeric).max()
        np.testing.assert_allclose(exact, numeric, rtol=1e-7, atol=1e-7 * size)


def test_cost_is_the_scaled_sum_of_its_samples(problem, design):
    e = problem.evaluate(design)
    K = e.history.K_c
    tr = [np.linalg.svd(block[:3, :3])[1].max() for block in K]
    rot = [np.linalg.svd(block[3:, 3:])[1].min() for block in K]
    assert e.c_tr == pytest.approx(tr[0])  # heel strike is the first alone
    assert e.c_rot == pytest.approx(sum(rot))
    first = problem.first
    scale = abs(first.c_tr - problem.weight * first.c_rot)
    wanted = (e.c_tr - problem.weight * e.c_rot) / scale
    rough = problem.regularization(design)[0]
    assert problem.cost(design) == pytest.approx(wanted + rough)
    values = dict(zip(NAMES, problem.constraints(design), strict=True))
    mesh = e.sole.mesh
    assert values["volume"] == pytest.approx(
        1 - mesh.volume / problem.limits["volume"]
    )
    nodes = problem.spline.deform(problem.finer.nodes, design)
    finer = problem.finer.with_nodes(nodes)
    x = np.concatenate(
        [m.quality() / rest.quality() - 0.35
         for m, rest in ((mesh, problem.mesh), (finer, problem.finer))]
    )  # fmt: skip
    assert len(x) > len(mesh.tets)
    wanted = -np.log(np.exp(-200 * x).sum()) / 200
    assert values["elements"] == pytest.approx(wanted)
    assert values["strain"] == pytest.approx(1 - e.strain.value / 0.4)
    assert values["c_rot"] == pytest.approx(e.c_rot / 300.0 - 1)


@pytest.mark.slow
@pytest.mark.parametrize("of", ["mean", "worst"])
def test_several_loads_count_by_their_weights(problem, design, of):
    """One, and one thrice as much, each over its first shape's."""
    harder = replace(problem.load, force=1.3 * problem.load.force)
    loads = Load.one_after_another([problem.load, harder], [1.0, 3.0])
    free = problem.setup.optimizing(
        stability_n_per_m=None, tilt_deg=None, strain=None,
        c_rot_nm_per_rad=None,
    ).settings  # fmt: skip
    settings = replace(free, cost=replace(free.cost, of=of))

    def of_load(load):
        return with_setup(problem, load=load, settings=settings)

    both = of_load(loads)
    rough = problem.regularization(design)[0]
    alone = [
        of_load(load).cost(design) - rough for load in (problem.load, harder)
    ]
    found = both.cost(design) - rough
    if of == "mean":
        wanted = 0.25 * alone[0] + 0.75 * alone[1]
        assert found == pytest.approx(wanted, rel=1e-6)
    else:
        assert max(alone) <= found <= max(alone) + np.log(2) / 40
    direction = np.random.default_rng(4).standard_normal(len(design))
    slope, h = both.derivatives(design)[0] @ direction, 1e-6
    ends = [
        both.cost(x) - both.regularization(x)[0]
        for x in (design + h * direction, design - h * direction)
    ]
    assert slope == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=2e-5)


def test_roughness_is_the_mean_square_of_bends_over_a_tenth(problem, design):
    by_hand = []
    stretch = problem.spline.stretch(problem.mesh.nodes, design)
    faces = problem.mesh.contact_faces
    for node in np.setdiff1d(np.unique(faces), problem.mesh.fixed):
        near = np.unique(faces[(faces == node).any(axis=1)])
        near = near[near != node]
        by_hand.append((stretch[near].mean() - stretch[node]) / 0.1)
    value, gradient, hessian = problem.regularization(design)
    assert value == pytest.approx(0.1 * np.mean(np.square(by_hand)))
    h = 1e-4
    for d in np.eye(len(design))[:4]:
        ends = [problem.regularization(design + s * h * d) for s in (1, -1)]
        assert gradient @ d == pytest.approx(
            (ends[0][0] - ends[1][0]) / (2 * h)
        )
        np.testing.assert_allclose(
            hessian @ d, (ends[0][1] - ends[1][1]) / (2 * h), atol=1e-9
        )


def test_rough_changes_are_farther_than_smooth_ones(problem):
    """Up to 21 times; what does not bend at all is as far as it is."""
    metric, bends = problem.metric, problem.regularization(
        np.ones(problem.spline.count))[2]  # fmt: skip
    values, vectors = np.linalg.eigh(bends)
    found = np.diag(vectors.T @ metric @ vectors)
    np.testing.assert_allclose(found, 1 + 20 * values / values[-1], rtol=1e-9)
    np.testing.assert_allclose(
        vectors.T @ metric @ vectors, np.diag(found), atol=1e-9
    )


UP = np.array([0.0, 0.0, 1.0])


def _evaluation(K=None, R=None, held=None):
    count = len(K) if K is not None else len(R)
    if R is None:
        R = np.tile(np.eye(3), (count, 1, 1))
    return SimpleNamespace(
        history=SimpleNamespace(K_c=K, R=R), c_rot=450.0,
        strain=SimpleNamespace(value=0.3),
        load=SimpleNamespace(
            is_measured=np.zeros(count, bool) if held is None else held
        ),
    )  # fmt: skip


def test_values_by_hand():
    K = -np.diag([1e4, 3e4, 2e4, 50.0, 20.0, 70.0])[None]  # 8 kN/m

    def stability(K):
        return module._stability(_evaluation(K), 2e3, 3e3)[0]

    assert stability(K) == pytest.approx(2 / np.sqrt(5))
    lean = np.array([[np.deg2rad(10.0), 0, 0]])
    R = rotations_xyz(lean)
    tilt = module._tilt(_evaluation(R=R), 20.0, UP)[0]
    wanted = np.cos(np.deg2rad(10)) - np.cos(np.deg2rad(20))
    assert tilt == pytest.approx(wanted / 0.06)
    strain, _ = module.strain_limit(_evaluation(K), 0.4)
    assert strain == pytest.approx(0.25)
    assert module.rotation_limit(_evaluation(K), 300.0, np.ones(1))[0] == 0.5
    found = stability(np.concatenate([K, 3 * K]))
    one = 2 / np.sqrt(5)
    assert one - np.log(2) / 60 < found < one
    found = module._tilt(_evaluation(R=np.concatenate([R, R])), 20.0, UP)[0]
    assert found == pytest.approx(tilt - np.log(2) / 60)
    # On a slope from that, and so do its derivatives by turns of the sole.
    up = rotations_xyz(np.deg2rad([4.0, 3.0, 0.0]))[:, 2]
    R = rotations_xyz(np.deg2rad([[4.0, 3.0, 50.0]]))
    level, _ = module._tilt(_evaluation(R=R), 20.0, up)
    assert level == pytest.approx((1 - np.cos(np.deg2rad(20))) / 0.06)
    R = rotations_xyz(np.deg2rad([[15.0, -8.0, 20.0]]))
    by_turn = module._tilt(_evaluation(R=R), 20.0, up)[1]().by_turn[0]
    for w, slope in zip(1e-6 * np.eye(3), by_turn, strict=True):
        ends = [
            module._tilt(_evaluation(R=exp_rotation(s * w) @ R), 20.0, up)[0]
            for s in (1, -1)
        ]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope, rel=1e-6)


def test_a_pose_that_is_prescribed_tips_nothing():
    """Beside one that is free, which has to stand."""
    K = -np.diag([1e4, 3e4, 2e4, 50.0, 20.0, 70.0])[None]
    held = np.array([False, True])
    both = np.concatenate([K, -5.0 * K])  # the second would tip
    R = rotations_xyz(np.deg2rad([[2.0, 0, 0], [50.0, 0, 0]]))
    first = _evaluation(both, R, held)
    limits = active_limits(
        {"stability": 2e3, "tilt_deg": 20.0}, first, None, UP
    )
    assert list(limits) == ["stability", "tilt_deg"]
    assert limits["stability"].keywords["scale"] == pytest.approx(8e3)
    assert list(limits["stability"](first)[1]().pairs) == [0]
    ((q, turn),) = limits["tilt_deg"](first)[1]().by_turn.items()
    share = -0.06 * turn / np.sin(np.deg2rad(2.0))
    assert q == 0 and share[0] > 0.99 and not share[1:].any()
    for limit in limits.values():
        alone = limit(_evaluation(K, R[:1]))[0]
        assert limit(first)[0] == pytest.approx(alone)
        all_free = _evaluation(both, R, np.zeros(2, bool))
        assert limit(all_free)[0] < 0.0


def test_limits_that_are_given_are_active():
    K = -np.diag([1e4, 3e4, 2e4, 50.0, 20.0, 70.0])[None]
    first = _evaluation(np.concatenate([K, 2 * K]))
    assert active_limits({"volume": 1.0}, first, None, UP) == {}
    given = {"stability": 500.0, "tilt_deg": 8.0, "strain": 0.1, "c_rot": 30.0}
    found = active_limits(given, first, "w", UP)
    stability, tilt, strain, c_rot = (x.keywords for x in found.values())
    assert stability["least"] == 500.0
    assert stability["scale"] == pytest.approx(8e3)
    assert (tilt["largest_deg"], strain["largest"]) == (8.0, 0.1)
    assert (c_rot["least"], c_rot["by_rot"]) == (30.0, "w")


def test_a_first_shape_that_tips_does_not_turn_the_limit_round():
    tips = np.diag([1e4, 3e4, -200.0, 50.0, 20.0, 70.0])
    first = _evaluation(-tips[None])
    (limit,) = active_limits({"stability": 1e3}, first, None, UP).values()
    values = []
    for least in (-200.0, 100.0, 2500.0):
        K = -np.diag([1e4, 3e4, least, 50.0, 20.0, 70.0])[None]
        values.append(limit(_evaluation(K))[0])
    assert values == sorted(values)
    assert values[1] < 0.0 < values[2]


def test_soft_minima_err_on_the_safe_side():
    x = np.array([0.5, 0.1, 0.3, 0.1])
    for sharpness in (60.0, 500.0):
        value, share = soft_minimum(x, sharpness)
        assert value == pytest.approx(
            0.1 - np.log(2 + np.exp(-sharpness * 0.4)
                         + np.exp(-sharpness * 0.2)) / sharpness
        )  # fmt: skip
        h = 1e-6
        for k in range(4):
            d = h * np.eye(4)[k]
            ends = [soft_minimum(x + s * d, sharpness)[0] for s in (1, -1)]
            assert share[k] == pytest.approx((ends[0] - ends[1]) / (2 * h),
                                             abs=1e-10)  # fmt: skip
    assert soft_minimum(x)[0] == soft_minimum(x, 60.0)[0]
    y, slope = module._saturate(np.array([-3.0, 0.0, 0.75]))
    np.testing.assert_allclose(y, [-3 / np.sqrt(10), 0, 0.6])
    np.testing.assert_allclose(slope, [10**-1.5, 1.0, 0.512])


def test_powers_of_matrices():
    rng = np.random.default_rng(3)
    a = rng.standard_normal((4, 3, 3))
    for order in (1, 2, 5, 63, 64):
        wanted = [np.linalg.matrix_power(m, order) for m in a]
        np.testing.assert_allclose(module._powers(a, order), wanted, rtol=1e-9)


def test_strain_is_the_norm_of_all_that_counts(problem, design):
    """(Σ n tr ε⁶⁴)^(1/64) over elements and samples, none left out."""
    e = problem.evaluate(design)
    total = 0.0
    for q, count in enumerate(e.counts):
        f = e.history.F[q] @ e.history.R[q]
        eps = e.sole.strain(e.sole.displacement(f))
        total += count * (np.linalg.eigvalsh(eps / 0.1) ** 64).sum()
    assert e.strain.value == pytest.approx(0.1 * total ** (1 / 64), rel=1e-12)


def test_what_the_surface_measures(problem):
    """A box that is sheared: its draft is the shear's angle."""
    mesh = problem.mesh
    shear = np.eye(3)
    shear[0, 2] = 0.2  # the heel's side leans out by 11.3° below
    sheared = mesh.with_nodes(mesh.nodes @ shear.T)
    moving = np.ones(len(mesh.nodes), bool)
    limits = SurfaceLimits({"depth": 0.02, "height": 0.05, "draft_deg": 3.0},
                           mesh, moving)  # fmt: skip
    told = limits.measures(sheared)
    angle = np.arctan(0.2)
    assert told["draft"] == pytest.approx(-np.degrees(angle))
    assert told["depth"] == told["height"] == pytest.approx(0.03)
    found = {name: value for name, value, _ in limits.evaluate(sheared)}
    wanted = {
        "depth": 0.03 / 0.02 - 1, "height": 1 - 0.03 / 0.05,
        # In tenths of a radian, and what counts as feasible has all of it.
        "draft_deg": -10 * (np.sin(angle) + np.sin(np.deg2rad(3.0))) - 0.005,
    }  # fmt: skip
    for name, value in wanted.items():
        soft = np.log(200) / (50 if name == "draft_deg" else 500)
        assert value - soft < found[name] <= value + 1e-12


def test_a_bottom_that_stays_is_measured_as_it_was_given(problem):
    mesh = problem.mesh
    moving = mesh.nodes[:, 2] > -0.0299
    limits = SurfaceLimits(
        {"depth": 0.02, "height": 0.05, "draft_deg": 3.0}, mesh, moving
    )
    told = limits.measures(mesh)
    assert told["depth"] == pytest.approx(0.03)
    assert {name for name, *_ in limits.evaluate(mesh)} == {
        "height", "draft_deg",
    }  # fmt: skip


def test_a_groove_in_a_side_has_no_draft(problem):
    """Its lip looks upwards, though no fixed rim is near."""
    mesh = brick((0.08, 0.06, 0.04), (8, 6, 8))
    centre = mesh.nodes[mesh.tets].mean(axis=1)
    cut = (centre[:, 0] > 0.02) & (np.abs(centre[:, 2] + 0.0225) < 0.0025)
    kept = mesh.tets[~cut]
    used = np.unique(kept)
    place = np.full(len(mesh.nodes), -1)
    place[used] = np.arange(len(used))
    fixed = place[mesh.fixed]
    grooved = TetMesh(mesh.nodes[used], place[kept], fixed)
    limits = SurfaceLimits(
        {"draft_deg": 0.0}, grooved, np.ones(len(used), bool)
    )
    assert limits.measures(grooved)["draft"] == pytest.approx(-90.0)
    ((_, value, _),) = limits.evaluate(grooved)
    assert value < -0.9
