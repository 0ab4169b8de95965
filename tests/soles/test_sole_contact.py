"""Contact and pose: closed forms, both methods, stiffness, Hertz."""

from dataclasses import replace

import numpy as np
import pytest
from as_load import as_load
from small_parts import START, complementarity
from sole_at_pose import contact_at_pose

from drake_exo.soles import simulation
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact import newton as contact
from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver
from drake_exo.soles.contact.law import ContactLaw, Ground
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.elasticity import MATERIALS, Material, Sole
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import exp_rotation, tilt_deg
from drake_exo.soles.results import Step
from drake_exo.soles.simulation import (
    _follow_design,
    first_step,
    simulate,
    touches_elsewhere,
)

SIZE = (0.23, 0.13, 0.03)


def _load(count=20):
    """Heel to toe with a sideways push, well inside the brick."""
    s = np.linspace(0, 1, count)
    force = np.stack(
        [60 * np.cos(np.pi * s), -25 * np.sin(np.pi * s),
         150 + 500 * np.sin(np.pi * s)], axis=1,
    )  # fmt: skip
    zmp = np.stack([-0.08 + 0.14 * s, 0.03 - 0.02 * s], axis=1)
    return force, zmp


@pytest.fixture(scope="module")
def sole():
    return Sole(brick(SIZE, (8, 5, 3)), MATERIALS["neoprene"])


@pytest.fixture(scope="module")
def history(sole):
    law = ContactLaw(0.8, sole.penalty)
    return simulate(ContactSolver.of(sole, law), as_load(*_load()), START)


def test_force_and_zmp_are_reached(history):
    force, zmp = _load()
    assert history.failed_steps == 0
    np.testing.assert_allclose(history.F.sum(axis=1), force, atol=1e-6)
    moment = np.einsum(
        "qmi->qi",
        np.cross(
            history.P - np.c_[zmp, np.zeros(len(zmp))][:, None], history.F
        ),
    )
    assert np.abs(moment).max() < 1e-7


def test_complementarity_is_met_in_exact_mode(sole, history):
    law = ContactLaw(0.8, sole.penalty)
    error = complementarity(history, law, START, sole.positions)
    assert error < 1e-10
    history_bad = replace(history, P=history.P + 1e-7 * np.eye(3)[2])
    assert complementarity(history_bad, law, START, sole.positions) > 1e-10


@pytest.mark.slow
def test_gauss_seidel_and_newton_agree(sole, history):
    law = ContactLaw(0.8, sole.penalty)
    solver = GaussSeidelSolver(sole.compliance, sole.positions, law)
    other = simulate(solver, as_load(*_load()), START)
    assert other.failed_steps == 0
    assert np.abs(other.O - history.O).max() < 1e-8
    assert np.abs(other.R - history.R).max() < 1e-8
    assert np.abs(other.P - history.P).max() < 1e-8


def _moment_about(history, zmp):
    arm = history.P - np.c_[zmp, np.zeros(len(zmp))][:, None]
    return np.cross(arm, history.F).sum(axis=1)


@pytest.mark.parametrize("kind", [ContactSolver, GaussSeidelSolver])
def test_a_free_moment_is_reached(sole, kind):
    force, zmp = _load(6)
    wanted = np.linspace(-0.5, 1.0, 6)
    load = as_load(force, zmp, free_moment=wanted)
    history = simulate(
        kind.of(sole, ContactLaw(0.8, sole.penalty)), load, START
    )
    assert history.failed_steps == 0
    moment = _moment_about(history, zmp)
    np.testing.assert_allclose(moment[:, 2], wanted, atol=1e-6)
    np.testing.assert_allclose(moment[:, :2], 0.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [ContactSolver, GaussSeidelSolver])
def test_a_measured_pose_is_kept_and_its_force_reached(sole, history, kind):
    """The free step's orientations, prescribed, give its ZMP again."""
    force, zmp = _load()
    load = as_load(force, zmp, rotation=history.R)
    again = simulate(kind.of(sole, ContactLaw(0.8, sole.penalty)), load, START)
    assert again.failed_steps == 0
    np.testing.assert_allclose(again.R, history.R, atol=1e-14)
    np.testing.assert_allclose(again.F.sum(axis=1), force, atol=1e-6)
    moment = _moment_about(again, zmp)
    assert np.abs(moment).max() < 1e-10 * np.abs(force).max()
    assert np.abs(again.O - history.O).max() < 1e-8
    # A tilt of a milliradian more moves it by some millimetres.
    leaning = history.R @ exp_rotation(np.array([0.0, 1e-3, 0.0]))
    load = as_load(force, zmp, rotation=leaning)
    other = simulate(kind.of(sole, ContactLaw(0.8, sole.penalty)), load, START)
    assert np.abs(_moment_about(other, zmp)[5:15, 1]).min() > 0.1


def test_moments_that_no_ground_bears_are_cut():
    force = np.array([[0.0, 0, 100], [60, 0, 100], [90, 0, 100]])
    load = as_load(force, np.zeros((3, 2)), free_moment=[9.0, -1.0, -1.0])
    up = np.array([0.0, 0.0, 1.0])
    cut = load.bearable(0.8, 0.12, up)
    np.testing.assert_allclose(cut.free_moment, [2.4, -0.6, 0.0])
    assert cut.moments_cut == 3
    part = load.bearable(1.0, 0.36, up).at([0, 2])
    np.testing.assert_array_equal(part.moment_cut, [0, 1])
    both = cut.one_after_another([load, part, cut], [1, 1, 1])
    np.testing.assert_array_equal(both.moment_cut, [0, 0, 0, 0, 1, 1, 1, 1])
    assert both.moments_cut == 4
    assert cut.straight().moments_cut == 0
    plain = as_load(force, np.zeros((3, 2)))
    assert plain.bearable(0.8, 0.1, up).moments_cut == 0


def test_first_jacobian_includes_the_moving_reference(sole):
    """Newton at the first sample converges quadratically, so dQ is right."""
    law = ContactLaw(0.8, sole.penalty)
    force, zmp = _load()
    solver = ContactSolver(sole.compliance, sole.positions, law)
    history = simulate(solver, as_load(force[:1], zmp[:1]), START)
    target = Target(force[0] * 1.0001, zmp[0], START)
    _, report = solver.solve(history.state(0), target)
    assert report.converged
    assert report.iterations <= 3


@pytest.mark.slow
def test_stiffness_matches_finite_differences(sole, history):
    """K_c against contact at perturbed poses, references frozen."""
    law = ContactLaw(0.8, sole.penalty)
    _, zmp = _load()
    solver = ContactSolver(
        sole.compliance, sole.positions, law, tolerance=1e-15
    )
    checked = 0
    for q in (3, 10, 15):
        Z = np.array([*zmp[q], 0.0])
        reference = history.P[q - 1]
        K, same = np.zeros((6, 6)), True
        for k in range(6):
            h = 1e-8 if k < 3 else 1e-7
            wrench = []
            for sign in (1, -1):
                dp = np.zeros(6)
                dp[k] = sign * h
                turn = exp_rotation(dp[3:])
                state, _ = contact_at_pose(
                    solver,
                    turn @ history.R[q],
                    Z + turn @ (history.O[q] - Z) + dp[:3],
                    reference,
                    history.F[q],
                )
                same &= ((state.F[:, 2] > 0) == (history.F[q][:, 2] > 0)).all()
                P = solver.places(state)
                wrench.append(
                    np.concatenate(
                        [
                            state.F.sum(axis=0),
                            np.cross(P - Z, state.F).sum(axis=0),
                        ]
                    )
                )
            K[:, k] = (wrench[0] - wrench[1]) / (2 * h)
        assert same
        scale = np.array([1.0] * 3 + [0.05] * 3)
        error = scale[:, None] ** -1 * (K - history.K_c[q]) / scale
        size = scale[:, None] ** -1 * history.K_c[q] / scale
        assert np.abs(error).max() < 1e-6 * np.abs(size).max()
        checked += 1
    assert checked == 3


@pytest.mark.parametrize("layer", [0.0, 5e-5])
def test_nodes_that_came_to_rest_stick(sole, layer):
    """Where the load stays, no rounding tells slip from stick."""
    law = ContactLaw(0.8, sole.penalty, layer)
    solver = ContactSolver.of(sole, law)
    history, found = simulate(solver, as_load(*_load(1)), START), []
    for part in (1 - 1e-13, 1.0, 1 + 1e-13):
        state = history.state(0)
        target = Target(state.F.sum(axis=0), [-0.08, 0.03], history.P[0])
        state.F[:, :2] *= part
        lin = solver.linearise(state, target, history.P[0])
        found.append(lin.cartesian_stiffness)
    slips = np.hypot(*state.F[:, :2].T) > (0.8 - 1e-12) * state.F[:, 2]
    pressed = state.F[:, 2] > 0
    if layer:
        pressed &= state.F[:, 2] < law.epsilon
    assert (slips & pressed).any()
    np.testing.assert_allclose(found[::2], [found[1]] * 2, rtol=1e-9, atol=1e-3)


def test_springs_stick_and_slip_as_in_closed_form():
    """A block on independent springs: forth and back with hysteresis."""
    m, k_n, k_t, mu = 9, 2e4, 1e4, 0.5
    C = np.diag(np.tile([1 / k_t, 1 / k_t, 1 / k_n], m))
    grid = np.linspace(-0.05, 0.05, 3)
    lP = np.stack([*np.meshgrid(grid, grid), np.zeros((3, 3))], -1)
    lP = lP.reshape(-1, 3)
    solver = ContactSolver(C, lP, ContactLaw(mu, 1.5e4), tolerance=1e-14)
    depth, limit = 1e-3, mu * k_n * 1e-3
    reference, stretch, F = lP.copy(), 0.0, None
    place = 0.0
    for target in (3e-4, 9e-4, 1.4e-3, 1.0e-3, -5e-4):
        stretch = np.clip(stretch + target - place, -limit / k_t, limit / k_t)
        place = target
        O = np.array([target, 0.0, -depth])  # noqa: E741
        state, report = contact_at_pose(solver, np.eye(3), O, reference, F)
        assert report.converged
        np.testing.assert_allclose(
            state.F,
            np.tile([-k_t * stretch, 0.0, k_n * depth], (m, 1)),
            atol=1e-9,
        )
        F, reference = state.F, solver.places(state)


def test_elastic_block_slides_at_the_friction_limit(sole):
    law = ContactLaw(0.5, sole.penalty)
    solver = ContactSolver(sole.compliance, sole.positions, law)
    reference = sole.positions
    F = None
    for push in (1e-4, 5e-4, 2e-3, 5e-3, 1e-2):
        O = np.array([push, 0.0, 0.03 - 5e-4])  # noqa: E741
        state, report = contact_at_pose(solver, np.eye(3), O, reference, F)
        assert report.converged
        F = state.F
    total = F.sum(axis=0)
    assert total[0] == pytest.approx(-0.5 * total[2], rel=1e-3)


def test_both_methods_agree_without_friction(sole):
    law = ContactLaw(0.0, sole.penalty)
    pose = exp_rotation(np.array([0.02, -0.01, 0.0]))
    O = np.array([0.0, 0.0, 0.0305])  # noqa: E741
    reference = sole.positions
    states = []
    for kind in (ContactSolver, GaussSeidelSolver):
        solver = kind(sole.compliance, sole.positions, law)
        state, report = contact_at_pose(solver, pose, O, reference)
        assert report.converged
        states.append(state.F)
    assert np.abs(states[0][:, :2]).max() < 1e-12 * states[0].max()
    np.testing.assert_allclose(*states, atol=1e-6 * states[0].max())


@pytest.mark.slow
@pytest.mark.parametrize("element", ["linear", "smoothed"])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_contact_patch_is_uniform(element, nu):
    """A thin pad pressed flat: uniform pressure within 1 %.

    With ν = 0 everywhere; else far from the free rim, where the pad is in
    uniaxial strain.
    """
    material = Material("m", 1e6, nu, 1000.0)
    height, depth = 0.002, 1e-5
    pad = Sole(brick((0.2, 0.16, height), (20, 16, 2)), material, element)
    solver = ContactSolver(
        pad.compliance, pad.positions, ContactLaw(0.0, pad.penalty)
    )
    O = np.array([0.0, 0.0, height - depth])  # noqa: E741
    state, report = contact_at_pose(solver, np.eye(3), O, pad.positions)
    assert report.converged
    area = _bottom_area(pad)
    x = pad.positions
    rim = 0.0 if nu == 0 else 30 * height
    inner = (
        (np.abs(x[:, 0]) <= 0.1 - rim)
        & (np.abs(x[:, 1]) <= 0.08 - rim)
        & (x[:, 2] < -0.99 * height)
    )
    pressure = state.F[inner, 2] / area[inner]
    modulus = material.lame_lambda + 2 * material.shear_modulus
    exact = modulus * depth / height
    np.testing.assert_allclose(pressure, exact, rtol=0.01)


def _bottom_area(pad):
    faces = pad.mesh.contact_faces
    x = pad.mesh.nodes[faces]
    low = pad.mesh.nodes[:, 2].min()
    bottom = np.isclose(x[:, :, 2], low).all(axis=1)
    area = 0.5 * np.linalg.norm(
        np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
    )
    total = np.bincount(
        faces[bottom].ravel(),
        np.repeat(area[bottom] / 3, 3),
        len(pad.mesh.nodes),
    )
    return total[pad.mesh.contact]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "weight"), [("J_f100", 98.1), ("J_f400", 392.4)]
)
def test_authors_outputs_are_reproduced(data_root, name, weight):
    from scipy.io import loadmat

    from drake_exo.soles.mesh import read_mesh
    from drake_exo.soles.numerics import angles_xyz

    folder = data_root / "soft_sole_hrp4"
    raw = loadmat(folder / "reference" / f"{name}.mat")
    raw = raw["Jmat"][0, 0]["step_1"][0, 0]
    force, zmp = raw["Ftot_tot"].T, raw["Z_tot"].T - [0.115, 0.0]
    assert force[0, 2] == pytest.approx(weight)
    mesh = read_mesh(folder / "meshes" / "brick_0.23x0.13x0.021_316nodes.msh")
    sole = Sole(mesh, Material("foam", 320e3, 0.3, 1230.0))
    point = np.array([-0.115, 0.0, -0.021])
    history = simulate(
        ContactSolver.of(sole, ContactLaw(0.65, sole.penalty)),
        as_load(force, zmp),
        Start(point, np.array([-0.115, 0.0, 0.0])),
    )
    assert history.failed_steps == 0
    place = history.O + history.R @ point + [0.115, 0.0, 0.0]
    part = slice(0, 140)
    assert np.abs(place - raw["displ_tot"].T)[part].max() < 1e-8
    angles = angles_xyz(history.R)
    assert np.abs(angles - raw["angleact_tot"].T)[part].max() < 1e-8
    theirs = raw["Kcart_tot"].reshape(-1, 6, 6)
    np.testing.assert_allclose(
        np.einsum("qii->qi", history.K_c)[part],
        np.einsum("qii->qi", theirs)[part],
        rtol=1e-3,
    )


@pytest.mark.slow
def test_an_impossible_load_says_why(sole):
    """Sideways force beyond friction: refused step by step, with a reason."""
    law = ContactLaw(0.3, sole.penalty)
    force = np.array([[0.0, 0, 300], [60.0, 0, 300], [150.0, 0, 300]])
    zmp = np.zeros((3, 2))
    history = simulate(ContactSolver.of(sole, law), as_load(force, zmp), START)
    assert list(history.converged) == [True, True, False]
    assert "no equilibrium found beyond" in history.reports[2].message
    assert np.isnan(history.K_c[2]).all()


@pytest.mark.parametrize("is_held", [True, False])
@pytest.mark.parametrize("of", ["F", "O"])
def test_a_start_that_is_no_number_does_not_converge(sole, of, is_held):
    solver = ContactSolver.of(sole, ContactLaw(0.8, sole.penalty))
    m = len(sole.positions)
    state = State(np.zeros((m, 3)), np.array([0.0, 0.0, 0.03]), np.eye(3))
    getattr(state, of)[...] = np.nan
    target = Target(np.array([0.0, 0.0, 10.0]), np.zeros(2), np.zeros((m, 3)))
    _, report = solver.solve(state, replace(target, is_held=is_held))
    assert not report.converged


def test_state_copy_is_deep():
    state = State(np.zeros((2, 3)), np.zeros(3), np.eye(3))
    other = state.copy()
    other.F[0, 0] = other.O[0] = other.R[0, 1] = 1.0
    assert state.F[0, 0] == state.O[0] == state.R[0, 1] == 0.0


def test_a_first_contact_on_another_branch_is_refused(sole):
    """Standing on a side face the brick is in balance, too."""
    law = ContactLaw(0.8, sole.penalty, 1e-5, 0.2)
    solver = ContactSolver(sole.compliance, sole.positions, law)
    target = Target(np.array([0.0, 0.0, 300.0]), np.zeros(2), START)
    flat, report = first_step(solver, target, 300.0)
    assert report.converged
    again, report = first_step(solver, target, 300.0, near=flat)
    assert report.converged
    np.testing.assert_array_equal(again.F, flat.F)  # the cold start's own

    upright = exp_rotation(np.array([np.deg2rad(88), 0.0, 0.0]))
    below = np.array([0.0, -0.065, -0.02])
    O = np.append(target.zmp, 0.0) - upright @ below  # noqa: E741
    unloaded = State(np.zeros_like(sole.positions), O, upright)
    tipped, report = _follow_design(solver, target, unloaded, 300.0)
    assert report.converged
    assert tilt_deg(tipped.R, np.array([0.0, 0.0, 1.0])) > 80
    state, report = first_step(solver, target, 300.0, near=tipped)
    assert state is None
    assert not report.converged
    assert "another branch" in report.message


def test_a_foot_that_has_tipped_over_does_not_stand(sole, monkeypatch):
    law = ContactLaw(0.8, sole.penalty)
    solver = ContactSolver(sole.compliance, sole.positions, law)
    target = Target(np.array([0.0, 0.0, 300.0]), np.zeros(2), START)
    stands, report = first_step(solver, target, 300.0)
    tipped = replace(stands, R=exp_rotation(np.array([1.45, 0.0, 0.0])))
    found = [tipped, tipped, stands]
    monkeypatch.setattr(
        simulation, "_lead", lambda *_: (found.pop(0), replace(report))
    )
    monkeypatch.setattr(
        simulation, "candidate_poses", lambda *_: [stands, stands]
    )
    state, again = first_step(solver, target, 300.0)
    assert again.converged
    assert state is stands
    found[:] = [tipped] * 4
    state, again = first_step(solver, target, 300.0)
    assert state is None
    assert not again.converged


@pytest.mark.parametrize(("from_ground", "holds"), [(60, True), (-83, False)])
def test_a_foot_tips_over_from_the_ground_not_from_the_vertical(
    from_ground, holds, sole, monkeypatch
):
    """Down a slope of 42° it is steeper, up it less steep than it looks."""
    x = np.linspace(-0.6, 0.6, 13)
    slope = Ground(x, x, 0.9 * np.repeat(x[:, None], 13, axis=1))
    law = ContactLaw(0.8, sole.penalty)
    solver = ContactSolver(sole.compliance, sole.positions, law, ground=slope)
    turn = -np.arctan(0.9) - np.deg2rad(from_ground)
    R = exp_rotation(np.array([0.0, turn, 0.0]))
    leans = State(np.zeros_like(sole.positions), np.zeros(3), R)
    found = Convergence(True, 1, 0.0)
    monkeypatch.setattr(simulation, "_lead", lambda *_: (leans, replace(found)))
    target = Target(np.array([0.0, 0.0, 300.0]), np.zeros(2), START)
    state, report = first_step(solver, target, 300.0)
    assert report.converged == holds
    assert (state is leans) == holds


def test_newton_that_goes_in_circles_is_told_from_one_that_gains():
    circles = contact._goes_in_circles
    assert circles([0.5, 0.11, 0.011, 0.0064, 0.11, 0.011, 0.0064])
    assert not circles([0.11, 0.011, 0.0064, 0.11, 0.011])  # too early
    assert not circles([0.24, 0.16, 0.16, 0.12, 0.11, 0.07])
    assert not circles([1.0, 0.9, 0.8, 1.2, 0.6, 0.3])


def test_a_further_node_that_gets_to_the_ground_is_noticed():
    """Left out by hand here; else one of a side that rolls or bulges."""
    case = Case.from_text(EXAMPLE)
    bottom = case.mesh.contact
    np.testing.assert_array_equal(
        bottom, np.flatnonzero(np.isclose(case.mesh.nodes[:, 2], -0.03))
    )
    whole = case.simulate()
    assert not touches_elsewhere(whole.sole, whole.law, whole.history)
    mesh = case.mesh.with_nodes(case.mesh.nodes)
    mesh.__dict__["contact"] = bottom[::2]
    sole = Sole(mesh, MATERIALS["neoprene"], "smoothed")
    step = Step.of(replace(case, mesh=mesh), sole, whole.law.penalty)
    np.testing.assert_array_equal(step.sole.mesh.contact, mesh.bare)
    assert step.c == pytest.approx(whole.c, rel=1e-9)
