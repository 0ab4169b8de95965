"""Finite strain in contact: small-load limit, stiffness, continuation."""

from dataclasses import replace

import numpy as np
import pytest
from as_load import as_load
from scipy.spatial.transform import Rotation
from small_parts import START, complementarity

from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Target,
)
from drake_exo.soles.elasticity import MATERIALS, Sole
from drake_exo.soles.finite_strain import (
    FiniteHistory,
    FiniteStrainSolver,
    NeoHookeanBody,
    follow,
    lead,
)
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import exp_rotation
from drake_exo.soles.simulation import StepHistory, simulate


def _load(count=5):
    s = np.linspace(0, 1, count)
    force = np.stack([60 - 80 * s, -15 * s, 150 + 300 * s], axis=1)
    return force, np.stack([-0.07 + 0.05 * s, 0.02 - 0.01 * s], axis=1)


@pytest.fixture(scope="module")
def sole():
    return Sole(brick((0.23, 0.13, 0.03), (7, 4, 2)), MATERIALS["neoprene"])


@pytest.fixture(scope="module")
def law(sole):
    return ContactLaw(0.8, sole.penalty)


@pytest.fixture(scope="module")
def history(sole, law):
    return follow(sole, law, as_load(*_load()), START)


@pytest.mark.slow
def test_every_sample_is_in_equilibrium(sole, history):
    assert history.converged.all()
    force, zmp = _load()
    solver = FiniteStrainSolver(
        NeoHookeanBody(sole.mesh, sole.material), ContactLaw(0.8, 1.0)
    )
    for q, state in enumerate(history.states):
        P = solver.places(state)
        np.testing.assert_allclose(state.F.sum(axis=0), force[q], atol=1e-5)
        arm = P - [*zmp[q], 0.0]
        moment = np.cross(arm, state.F).sum(axis=0)
        np.testing.assert_allclose(moment, 0.0, atol=1e-6)
        f = solver.body.internal_force(state.u)
        f[solver.nodes] -= state.F @ state.R
        np.testing.assert_allclose(f[solver.body.free], 0.0, atol=1e-5)


def _as_steps(sole, law, history: FiniteHistory) -> StepHistory:
    solver = FiniteStrainSolver(NeoHookeanBody(sole.mesh, sole.material), law)
    return StepHistory(
        np.array([s.F for s in history.states]),
        np.array([s.O for s in history.states]),
        np.array([s.R for s in history.states]),
        np.array([solver.places(s) for s in history.states]),
        history.K_c,
        history.reports,
    )


@pytest.mark.slow
def test_signorini_and_coulomb_hold_along_the_path(sole, law, history):
    steps = _as_steps(sole, law, history)
    error = complementarity(steps, law, START, sole.positions)
    assert error < 1e-12
    slipped = np.linalg.norm(np.diff(steps.P[:, :, :2], axis=0), axis=2)
    touching = steps.F[1:, :, 2] > 0
    assert slipped[touching].max() > 1e-6  # the path is not all sticking


@pytest.mark.slow
def test_tends_to_small_strain_as_the_load_does(sole, law):
    """The relative difference falls in proportion to the load."""
    force, zmp = _load(3)
    differences = []
    for scale in (0.1, 0.01, 0.001):
        load = as_load(scale * force, zmp)
        small = simulate(ContactSolver.of(sole, law), load, START)
        large = follow(sole, law, load, START)
        assert large.converged.all()
        K0 = small.K_c[-1]
        differences.append(np.abs(large.K_c[-1] - K0).max() / np.abs(K0).max())
    assert differences[2] < 1e-4
    rates = np.log10(np.array(differences[:-1]) / differences[1:])
    np.testing.assert_allclose(rates, 1.0, atol=2e-3)


def _pose_change(before, after, zmp) -> np.ndarray:
    """(dzO, dω) about the ZMP that lead from one state to the other."""
    Z = np.array([*zmp, 0.0])
    turn = after.R @ before.R.T
    w = Rotation.from_matrix(turn).as_rotvec()
    return np.r_[after.O - Z - turn @ (before.O - Z), w]


@pytest.mark.slow
def test_stiffness_is_the_change_of_the_wrench(sole, law, history):
    """K_c against poses re-solved under changed force and ZMP."""
    force, zmp = _load()
    smooth = replace(law, layer=2e-5, kappa=0.2)  # nobody at a corner
    solver = FiniteStrainSolver(
        NeoHookeanBody(sole.mesh, sole.material), smooth, tolerance=1e-13
    )
    reference = solver.places(history.states[1])
    target = Target(force[2], zmp[2], reference)
    state, report = solver.solve(history.states[2], target)
    assert report.converged
    K = solver.cartesian_stiffness(state, target)
    size = np.array([1, 1, 1, 0.05, 0.05, 0.05])
    for k in range(5):
        change = []
        wrench = np.zeros(6)
        for sign in (1, -1):
            dF, dz = np.zeros(3), np.zeros(2)
            if k < 3:
                dF[k] = sign * 1e-2
                wrench[:3] = dF * sign
            else:
                dz[k - 3] = sign * 1e-6
                wrench[3:] = np.cross([*(dz * sign), 0.0], force[2])
            moved = Target(force[2] + dF, zmp[2] + dz, reference)
            other, report = solver.solve(state, moved)
            assert report.converged
            change.append(_pose_change(state, other, zmp[2]))
        pose = 0.5 * (change[0] - change[1])
        np.testing.assert_allclose(
            K @ pose / size,
            wrench / size,
            atol=1e-5 * np.abs(wrench / size).max(),
        )


def test_newton_converges_quadratically(sole, law, history, monkeypatch):
    """The Newton matrix is the derivative, first sample's yaw included."""
    force, zmp = _load()
    solver = FiniteStrainSolver(
        NeoHookeanBody(sole.mesh, sole.material), law, tolerance=1e-12
    )
    state = history.states[0]
    state = replace(
        state,
        u=state.u * 1.001,
        R=exp_rotation(np.array([1e-5, -1e-5, 2e-5])) @ state.R,
    )
    plain, errors = solver._evaluate, []

    def evaluate(*given):
        point = plain(*given)
        errors.append(point.merit)
        return point

    monkeypatch.setattr(solver, "_evaluate", evaluate)
    _, report = solver.solve(state, Target(force[0], zmp[0], START))
    assert report.converged and report.iterations == len(errors) - 1
    errors = np.array(errors)
    errors = errors[(errors < 1e-2) & (errors > 1e-11)]
    assert len(errors) >= 2
    assert (errors[1:] < 30 * errors[:-1] ** 1.8).all()


class _Stubborn:
    """Finds an equilibrium only for short ways and up to a limit."""

    def __init__(self, limit):
        self.limit = limit

    def solve(self, state, target):
        x = target.force[0]
        fine = x - state <= 0.3 and x <= self.limit
        report = Convergence(fine, 1, 0.0, "" if fine else "stuck")
        return (x if fine else state), report


def test_the_way_is_bisected():
    before = Target(np.zeros(3), np.zeros(2), None)
    target = replace(before, force=np.ones(3))
    state, report = lead(_Stubborn(2.0), 0.0, before, target)
    assert report.converged
    assert state == report.reached == 1.0


def test_a_collapse_is_said_plainly():
    before = Target(np.zeros(3), np.zeros(2), None)
    target = replace(before, force=np.ones(3))
    _, report = lead(_Stubborn(0.7), 0.0, before, target)
    assert not report.converged
    assert 0.69 < report.reached <= 0.7
    assert "no equilibrium found beyond 0.69" in report.message


@pytest.mark.slow
def test_samples_after_a_collapse_are_left_out(sole, law):
    """A force outside friction's cone has no equilibrium."""
    force, zmp = _load()
    force[2] = [400.0, 0.0, 100.0]
    history = follow(sole, law, as_load(force, zmp), START)
    assert history.converged.tolist() == [True, True, False, False, False]
    assert len(history.states) == len(history.reports) == 5
    assert 0 < history.reports[2].reached < 1
    assert "no equilibrium" in history.reports[2].message
    assert "left out" in history.reports[3].message
    assert np.isnan(history.K_c[2:]).all()
    # The way to it ends where the cone does.
    way = history.reports[2].reached
    F = force[1] + way * (force[2] - force[1])
    assert np.hypot(F[0], F[1]) == pytest.approx(0.8 * F[2], rel=0.02)
