"""Parts of a shape problem and of its search that need no simulation."""

import numpy as np
import pytest

from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import SphericalSpline, brick
from drake_exo.soles.optimize.limits import soft_minimum
from drake_exo.soles.optimize.optimizer import Optimum, QuasiNewton, _Callbacks
from drake_exo.soles.optimize.problem import bends
from drake_exo.soles.simulation import sample_weights, thinned


def _load(count):
    up = np.tile([0.0, 0.0, 300.0], (count, 1))
    return Load(0.05 * np.arange(count), up, np.zeros((count, 2)))


def test_samples_of_several_loads_are_thinned_each():
    load = Load.one_after_another([_load(50), _load(20)], [1.0, 1.0])
    picked, counts, by_tr, by_rot = sample_weights(load, 0.1, 10)
    first = picked < 50
    for mine, total, strike in ((first, 50, 5), (~first, 20, 2)):
        assert counts[mine].sum() == pytest.approx(total)
        assert by_rot[mine].sum() == pytest.approx(total / 2)
        assert by_tr[mine].sum() == pytest.approx(strike / 2)
    assert load.at(picked).begins == (0, int(first.sum()))
    assert picked[~first].min() == 50 and picked.max() == 69


def test_learnt_curvature_is_that_of_a_quadratic():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((6, 6))
    H = root @ root.T + np.eye(6)
    hessian_approximation = QuasiNewton(np.eye(6))
    p, nothing = np.ones(6), np.zeros((0, 6))
    for _ in range(9):
        hessian_approximation.update(p, H @ p, nothing, np.zeros(0))
        step = np.linalg.solve(hessian_approximation.matrix, H @ p)
        p = p - (step @ H @ p) / (step @ H @ step) * step
    np.testing.assert_allclose(p, 0.0, atol=1e-7)
    np.testing.assert_allclose(
        hessian_approximation.matrix, H, rtol=1e-4, atol=1e-4
    )


@pytest.mark.parametrize(
    ("errors", "simulations", "ends"),
    [((9.0, 0.9, 0.2), 40, False), ((9.0, 9.0, 9.0), 40, True),
     ((0.9, 0.9, 0.3), 40, True), ((9e3, 9e2, 9e1), 40, True),
     ((0.9,) * 16, 1, True), ((0.9,) * 15, 1, False)],
)  # fmt: skip
def test_a_search_without_progress_ends(errors, simulations, ends):
    class Counted:
        evaluations = 0
        spline = SphericalSpline((2, 2))

    problem, best = Counted(), Optimum(np.ones(2))
    calls = _Callbacks(problem, None, best, None)
    # Cost, then violation get on; after that, if any, the error alone.
    rows = [(1.0, 0.1), (0.9, 0.1), (0.9, 0.0)]
    for iteration, row in enumerate(rows):
        problem.evaluations += simulations
        assert calls.watch(0, iteration, *row, errors[0], 0.1)
    goes_on = True
    for iteration, error in enumerate(errors[1:], len(rows)):
        problem.evaluations += simulations
        goes_on = calls.watch(0, iteration, *rows[-1], error, 0.1)
    assert calls.stalled == ends
    assert goes_on != ends


def test_sample_weights_stand_for_all_samples():
    for samples in (None, 20, 44):
        picked, by_tr, by_rot = thinned(219, samples, 0.1)
        assert by_tr.sum() == pytest.approx(21)
        assert by_rot.sum() == pytest.approx(219)
        # What changes linearly is summed exactly.
        assert by_tr @ picked == pytest.approx(np.arange(21).sum())
        late = picked >= 21
        assert (by_rot * picked)[late].sum() == pytest.approx(
            np.arange(21, 219).sum()
        )
        assert picked[0] == 0
        assert picked[-1] == 218


@pytest.mark.parametrize("fraction", [0.1, 0.5, 1.0])
def test_all_samples_are_all(fraction):
    """However many of them are in heel strike."""
    strike = int(40 * fraction)
    for samples in (None, 40, 70):
        picked, by_tr, by_rot = thinned(40, samples, fraction)
        np.testing.assert_array_equal(picked, np.arange(40))
        np.testing.assert_array_equal(by_tr, picked < strike)
        np.testing.assert_array_equal(by_rot, np.ones(40))
    assert len(thinned(40, 38, fraction)[0]) == 38


def test_soft_minimum_is_below_and_its_shares_add_up():
    x = np.array([0.5, 0.1, 0.3])
    value, share = soft_minimum(x)
    assert 0.05 < value <= 0.1
    assert share.sum() == pytest.approx(1.0)


def test_bends_of_a_surface_are_what_its_elements_do_not_resolve():
    mesh = brick((0.24, 0.12, 0.03), (12, 6, 2))
    rows = bends(mesh)
    # The rim of the fixed top has no row.
    assert rows.shape == (len(mesh.bare), len(mesh.nodes))
    assert np.abs(rows @ np.ones(len(mesh.nodes))).max() < 1e-14
    x, y, z = mesh.nodes[mesh.bare].T
    flat = (np.abs(x) < 0.11) & (np.abs(y) < 0.05) & (z < -0.029)
    assert flat.sum() == 11 * 5
    linear = mesh.nodes @ [1.0, -2.0, 0.5]
    assert np.abs((rows @ linear)[flat]).max() < 1e-15
    # Of a wave h²/4 of its curvature with four neighbours, 3 h²/8 with eight;
    # a zigzag counts most.
    waves = np.cos(mesh.nodes[:, 0] * 5.0)
    curved = -25.0 * waves[mesh.bare] * 0.02**2
    share = (rows @ waves)[flat] / curved[flat]
    near = np.abs(share[:, None] - [1 / 4, 3 / 8]).min(axis=1)
    assert near.max() < 1e-3
    zigzag = np.cos(np.pi * mesh.nodes[:, 0] / 0.02)
    assert np.abs((rows @ zigzag)[flat]).min() > 0.99


@pytest.mark.parametrize("refining", [True, False])
def test_rejected_trials_shorten_the_steps_that_follow(refining):
    class Counted:
        evaluations = 5

    calls = _Callbacks(Counted, None, None, None, refining)
    found = []
    for simulations in (1, 2, 5, 1, 1, 9, 9, 9, 9, 1):
        Counted.evaluations += simulations
        calls._adapt()
        found.append(calls._caution)
    wanted = [1.0, 2.0, 8.0, 8 / 1.5, 8 / 1.5**2]
    wanted += [4 * 8 / 1.5**2, 16 * 8 / 1.5**2, 64.0, 64.0, 64 / 1.5]
    np.testing.assert_allclose(found, wanted if refining else np.ones(10))
