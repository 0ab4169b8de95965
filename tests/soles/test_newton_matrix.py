"""Newton's matrix of the contact problem against differences, and its parts."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.soles.contact import gauss_seidel
from drake_exo.soles.contact.gauss_seidel import (
    GaussSeidelSolver,
    _gauss_seidel,
    _slip,
)
from drake_exo.soles.contact.law import (
    COLUMNS,
    FLAT,
    ContactLaw,
    Ground,
    project,
)
from drake_exo.soles.contact.linearisation import ActiveSet
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Start,
    State,
    Target,
    deformed,
    residual,
    wrench_size,
)
from drake_exo.soles.elasticity import MATERIALS, Sole
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import exp_rotation

# Nodes of touching sets


@pytest.mark.parametrize("seed", range(3))
def test_the_inverse_follows_its_set(seed):
    """Few nodes more or less, many, none, and what rounding adds up."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((90, 90))
    C = root @ root.T + 30 * np.eye(90)
    active, there = ActiveSet(C), set()
    for step in range(110):
        few = rng.choice(30, rng.integers(0, 3 if step % 9 else 20), False)
        there ^= set(few.tolist())
        wanted = rng.permutation(sorted(there)).astype(int)
        active.update(wanted)
        assert sorted(active.nodes.tolist()) == sorted(there)
        dofs = (3 * active.nodes[:, None] + np.arange(3)).ravel()
        inverse = np.linalg.inv(C[np.ix_(dofs, dofs)])
        np.testing.assert_allclose(
            active.S, inverse, atol=1e-9 * np.abs(inverse).max(initial=1.0)
        )
    active.refresh()
    np.testing.assert_allclose(active.S, inverse, atol=1e-12)
    singular = ActiveSet(np.zeros((9, 9)))
    with pytest.raises(np.linalg.LinAlgError):
        singular.update(np.array([0, 2]))


# Residuals


def test_places_and_residuals_by_numpy():
    rng = np.random.default_rng(4)
    m, R = 7, exp_rotation(rng.standard_normal(3))
    root = rng.standard_normal((21, 21))
    C, lP = root @ root.T, rng.standard_normal((m, 3))
    F = rng.standard_normal((m, 3))
    F[[1, 4]] = 0.0
    Y = (lP + (C @ (F @ R).ravel()).reshape(m, 3)) @ R.T
    np.testing.assert_allclose(deformed(C, lP, R, F), Y)
    P, Q = rng.standard_normal((2, m, 3))
    axes = np.array([exp_rotation(w) for w in rng.standard_normal((m, 3))])
    zmp, law = rng.standard_normal(3), ContactLaw(0.7, 2.0, 0.3, 0.2)
    tau, phi, arm, wrench, largest = residual(
        P, F, Q, axes, zmp, law.penalty, law.friction, law.epsilon, law.kappa
    )
    own = np.einsum("kij,kj->ki", axes, F - 2.0 * (P - Q))
    np.testing.assert_allclose(tau, own)
    held = np.einsum("kji,kj->ki", axes, project(own, law))
    np.testing.assert_allclose(phi, F - held)
    np.testing.assert_allclose(arm, P - zmp)
    np.testing.assert_allclose(wrench[:3], F.sum(axis=0))
    np.testing.assert_allclose(wrench[3:], np.cross(P - zmp, F).sum(axis=0))
    assert largest == pytest.approx(np.abs(F - held).max())
    F[2, 1] = np.nan
    assert np.isnan(residual(P, F, Q, axes, zmp, 2.0, 0.7, 0.6, 0.2)[4])


# Newton's step


def _bumps():
    x, y = np.linspace(-0.3, 0.3, 25), np.linspace(-0.3, 0.3, 25)
    X, Y = np.meshgrid(x, y, indexing="ij")
    Z = 0.002 * np.sin(20 * X + 1) * np.cos(25 * Y) + 0.05 * X - 0.03 * Y
    columns = [v.ravel() for v in (X, Y, Z)]
    return Ground.of_table(dict(zip(COLUMNS, columns, strict=True)), "grid")


SOLE = Sole(brick((0.2, 0.1, 0.03), (5, 3, 2)), MATERIALS["neoprene"])


def _somewhere(solver, ground, of_start):
    """A state off its equilibrium: some nodes stick, some slip, some hover."""
    point = np.array([-0.1, 0.0, -0.03])
    place = np.array([-0.1, 0.0, 0.0])
    place[2] = ground.height(place[None])[0]
    start = Start(point, place, 0.1)
    rng = np.random.default_rng(5)
    R = exp_rotation(np.array([0.01, 0.015, 0.1]))
    O = start.point_W - R @ point + [0, 0, 5e-4]  # noqa: E741
    flat = start.places(R, solver.lP)
    reference = start if of_start else flat + 1e-4 * rng.standard_normal(
        flat.shape)  # fmt: skip
    zmp = np.array([-0.02, 0.01])
    target = Target(np.array([5.0, -3.0, 200.0]), zmp,
                    reference, 0.3,
                    height=float(ground.height(zmp[None])[0]))  # fmt: skip
    there = State(np.zeros_like(flat), O, R)
    held, _ = solver.solve(there, replace(target, is_held=True))
    F = held.F * rng.uniform(0.9, 1.1, held.F.shape)
    return State(F, O, R), target


@pytest.mark.parametrize("ground", [FLAT, _bumps()], ids=["flat", "bumps"])
@pytest.mark.parametrize("of_start", [True, False], ids=["first", "later"])
@pytest.mark.parametrize("is_held", [False, True], ids=["free", "held"])
def test_along_newton_s_step_all_residuals_fall_alike(
    ground, of_start, is_held
):
    """d/dt of every active node's law and of the wrench is what is left."""
    law = ContactLaw(0.5, SOLE.penalty, 2e-5, 0.2)
    solver = ContactSolver.of(SOLE, law, ground=ground)
    state, target = _somewhere(solver, ground, of_start)
    target.is_held = is_held
    if is_held and of_start:
        # With a pose that is held, references stay where they are.
        target.reference = target.reference.places(state.R, solver.lP)
    point = solver._released(solver._evaluate(state, target, 1.0), target)
    dF, dp = solver._direction(point, target)
    state, active = point.state, point.active
    assert 5 < active.sum() < len(active)
    slips = np.linalg.norm(point.tau[:, :2], axis=1) > 0.5 * point.tau[:, 2]
    assert (slips & active).any() and (~slips & active).any()

    def there(t):
        turn = exp_rotation(t * dp[3:])
        Z = target.point
        moved = State(state.F + t * dF, Z + turn @ (state.O - Z) + t * dp[:3],
                      turn @ state.R)  # fmt: skip
        found = solver._evaluate(moved, target, 1.0)
        return found.phi[active], found.wrench

    h = 1e-5
    # Where planes turn with the foot, Newton takes F for T, as in the end.
    near = 2e-3 if of_start and not (is_held or ground.is_flat) else 2e-5
    (a, u), (b, v) = there(h), there(-h)
    np.testing.assert_allclose(
        (a - b) / (2 * h), -point.phi[active],
        atol=near * np.abs(point.phi).max(),
    )  # fmt: skip
    if is_held:
        assert not dp.any() and not point.wrench.any()
    else:
        size = np.array([1, 1, 1, 0.05, 0.05, 0.05])
        left = point.wrench / size
        np.testing.assert_allclose(
            (u - v) / (2 * h) / size, -left, atol=near * np.abs(left).max()
        )
        assert np.abs(left).max() > 1.0
    assert np.abs(point.phi[active]).max() > 0.1


# Gauss–Seidel


def test_a_sliding_node_obeys_coulomb():
    """On the ground, at the cone's edge, against its slip."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        root = rng.standard_normal((3, 3))
        W = root @ root.T + 2 * np.eye(3)
        others = np.array([*rng.uniform(-3, 3, 2), -rng.uniform(0.2, 2)])
        F = _slip(W, others, 0.3)
        place = others + W @ F
        if not F.any():
            continue
        assert F[2] > 0 and place[2] == pytest.approx(0.0, abs=1e-9)
        size = np.hypot(*F[:2])
        assert size == pytest.approx(0.3 * F[2])
        slip = np.hypot(*place[:2])
        assert F[:2] @ place[:2] == pytest.approx(-size * slip, rel=1e-6)


def test_sweeps_end_in_all_nodes_laws():
    rng = np.random.default_rng(7)
    m, mu = 6, 0.4
    root = rng.standard_normal((18, 18))
    W = root @ root.T + 40 * np.eye(18)
    free = rng.uniform(-1, 1, (m, 3))
    F = np.abs(rng.uniform(0, 0.01, (m, 3)))
    delta = (W @ F.ravel()).reshape(m, 3) + free
    change, used = _gauss_seidel(W, F, delta, mu, 1e-13, 5000)
    assert change < 1e-13 and 2 < used < 5000
    np.testing.assert_allclose(
        delta, (W @ F.ravel()).reshape(m, 3) + free, atol=1e-12
    )
    up, size = F[:, 2], np.hypot(*F.T[:2])
    slip = np.hypot(*delta.T[:2])
    assert (up >= 0).all() and (delta[:, 2] > -1e-10).all()
    np.testing.assert_allclose(up * delta[:, 2], 0.0, atol=1e-10)
    assert (size <= mu * up + 1e-10).all()
    np.testing.assert_allclose((mu * up - size) * slip, 0.0, atol=1e-9)
    np.testing.assert_allclose(
        (F[:, :2] * delta[:, :2]).sum(axis=1), -size * slip, atol=1e-9
    )
    assert (up > 0).any() and (up == 0).any() and (slip[up > 0] > 1e-6).any()
    again, once = _gauss_seidel(W, F, delta, mu, 1e-9, 1)
    assert once == 1 and again < 1e-12
    assert _gauss_seidel(W, F, delta, mu, 1e-9, 0) == (np.inf, 0)


def test_sweeps_without_a_budget_have_not_settled(monkeypatch):
    solver = GaussSeidelSolver.of(SOLE, ContactLaw(0.5, SOLE.penalty))
    start = Start(np.array([-0.1, 0.0, -0.03]), np.array([-0.1, 0.0, -1e-4]))
    places = start.places(np.eye(3), solver.lP)
    state = State(0.0 * places, start.point_W - start.point_L, np.eye(3))
    force = np.array([5.0, -3.0, 200.0])
    held = Target(force, np.zeros(2), places, is_held=True)
    assert solver.solve(state, held)[1].converged
    monkeypatch.setattr(gauss_seidel, "_MAX_SWEEPS", 0)
    report = solver.solve(state, held)[1]
    assert not report.converged and "did not settle" in report.message


@pytest.mark.parametrize("kind", [ContactSolver, GaussSeidelSolver])
def test_a_sole_in_the_air_is_not_solved(kind):
    """No step of the pose is determined there, and that is told."""
    solver = kind.of(SOLE, ContactLaw(0.5, SOLE.penalty))
    places = solver.lP + np.array([0.0, 0.0, 0.04])
    state = State(0.0 * places, np.array([0.0, 0.0, 0.04]), np.eye(3))
    target = Target(np.array([0.0, 0.0, 200.0]), np.zeros(2), places)
    report = solver.solve(state, target)[1]
    assert not report.converged
    assert "singular Newton matrix with 0 nodes" in report.message


def test_moments_count_over_50_mm():
    wrench = np.array([1.0, -3.0, 2.0, 0.1, -0.2, 0.05])
    assert wrench_size(wrench) == pytest.approx(4.0)
    assert wrench_size(wrench * [1, 1, 1, 0, 0, 1]) == pytest.approx(3.0)
