"""How a simulation begins and goes on: poses, ways to a load, guesses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles import simulation
from drake_exo.soles.contact.law import COLUMNS, FLAT, ContactLaw, Ground
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
    capped,
    line_search,
    move,
)
from drake_exo.soles.elasticity import MATERIALS, Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import (
    exp_rotation,
    rotation_vector,
    rotation_z,
    rotations_xyz,
    yaw_of,
)
from drake_exo.soles.simulation import (
    StepHistory,
    _alike,
    _distance,
    _press_in,
    _smoother,
    candidate_poses,
    first_step,
    lead,
    refine_time,
    simulate,
)

POINT = np.array([-0.1, 0.0, -0.03])
START = Start(POINT, np.array([0.2, 0.1, 0.0]), 0.3)


def _roof():
    """A sole with two soles: a level half, and one that rises by 0.2."""
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(-0.05, 0.05, 3))
    z = -0.03 + 0.2 * np.maximum(x, 0)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _target(zmp, **more):
    return Target(np.array([0, 0, 100.0]), np.array(zmp), START, **more)


def _slope(by_x=0.0, by_y=0.0, height=0.0):
    x, y = np.linspace(-0.6, 0.6, 13), np.linspace(-0.6, 0.6, 13)
    X, Y = np.meshgrid(x, y, indexing="ij")
    columns = [X.ravel(), Y.ravel(), (height + by_x * X + by_y * Y).ravel()]
    return Ground.of_table(dict(zip(COLUMNS, columns, strict=True)), "grid")


@pytest.mark.parametrize(
    "ground", [FLAT, _slope(height=0.05), _slope(by_y=0.1)]
)
def test_candidates_lie_on_the_ground_with_a_facet(ground):
    """Every pose: at least three corners on it, none below, its own yaw."""
    lP = _roof()
    at = START.places(np.eye(3), np.array([[-0.05, 0.0, -0.03]]))[0, :2]
    poses = candidate_poses(lP, _target(at), ground)
    assert len(poses) >= 2
    for pose in poses:
        P = lP @ pose.R.T + pose.O
        gap = P[:, 2] - ground.height(P)
        assert gap.min() > -1e-6
        assert (gap < 1e-6).sum() >= 3
        assert yaw_of(pose.R) == pytest.approx(0.3, abs=1e-6)
        # The fixed point is where it was set down, but for its height.
        place = pose.R @ POINT + pose.O
        np.testing.assert_allclose(place[:2], [0.2, 0.1], atol=1e-9)
        assert not pose.F.any()
        assert np.degrees(np.arccos(pose.R[2, 2])) <= 80.1 + 6
    # On the level half first: its support holds the ZMP.
    n = np.array([0, 0, 1.0]) if ground.is_flat else ground.normal(lP)
    assert poses[0].R[:, 2] @ n == pytest.approx(1.0)


def test_a_facet_that_holds_the_zmp_comes_first():
    """Under the toe the risen half, tilted; then by the distance outside."""
    lP, level = _roof(), rotation_z(0.3)
    toe = START.places(np.eye(3), np.array([[0.06, 0.0, -0.02]]))[0, :2]
    first, second, *rest = candidate_poses(lP, _target(toe), FLAT)
    normal = np.array([0.2, 0.0, -1.0]) / np.sqrt(1.04)
    np.testing.assert_allclose(first.R @ normal, [0, 0, -1], atol=1e-6)
    assert yaw_of(first.R) == pytest.approx(0.3, abs=1e-6)
    np.testing.assert_allclose(second.R, level, atol=1e-6)
    off = [
        _distance((_roof() @ pose.R.T + pose.O)[_lowest(pose)][:, :2], toe)
        for pose in (second, *rest)
    ]
    assert off == sorted(off) and off[0] > 0.02


def _lowest(pose):
    z = (_roof() @ pose.R.T + pose.O)[:, 2]
    # With the foot's own point, of which facets may be, too.
    return z < z.min() + 1e-4 if (z < z.min() + 1e-4).sum() > 2 else z < 9


def test_a_pose_that_is_asked_for_touches_the_ground():
    lP = _roof()
    R = rotations_xyz(np.array([0.1, -0.2, 0.4]))
    for ground in (FLAT, _slope(0.1, -0.05, 0.02)):
        (pose,) = candidate_poses(lP, _target([0, 0], rotation=R), ground)
        np.testing.assert_array_equal(pose.R, R)
        P = lP @ R.T + pose.O
        gap = P[:, 2] - ground.height(P)
        assert gap.min() == pytest.approx(0.0, abs=1e-9)
        place = R @ POINT + pose.O
        np.testing.assert_allclose(place[:2], [0.2, 0.1], atol=1e-12)


def test_distance_from_a_support():
    square = np.array([[0, 0], [2, 0], [2, 1], [0, 1], [1, 0.5]])
    for z, wanted in (
        ((1, 0.5), 0.0), ((2.5, 0.5), 0.5), ((1, -0.25), 0.25),
        ((-1, 0.2), 1.0), ((0.1, 1.125), 0.125),
    ):  # fmt: skip
        found = _distance(square, np.array(z, float))
        assert found == pytest.approx(wanted, abs=1e-6)


@pytest.fixture(scope="module")
def solver():
    sole = Sole(brick((0.2, 0.1, 0.03), (4, 3, 2)), MATERIALS["neoprene"])
    return ContactSolver.of(sole, ContactLaw(0.8, sole.penalty))


def test_pressed_in_it_carries_about_what_is_asked(solver):
    """At its own pose; force, ZMP and moment are those of its nodes."""
    start = Start(np.array([-0.1, 0, -0.03]), np.array([-0.1, 0.0, 0.0]))
    target = Target(np.array([5.0, 3.0, 20.0]), np.array([0.01, 0.02]), start)
    guess = candidate_poses(solver.lP, target, FLAT)[0]
    for press in (2.0, 100.0, 1500.0):
        state, carried, steps = _press_in(solver, target, guess, press)
        np.testing.assert_array_equal(state.R, guess.R)
        np.testing.assert_array_equal(state.O[:2], guess.O[:2])
        total = state.F.sum(axis=0)
        assert 0.5 * press < total[2] < 2 * press
        assert steps >= 1
        np.testing.assert_allclose(carried.force, total)
        P = solver.places(state)
        point = np.array([*carried.zmp, 0.0])
        moment = np.cross(P - point, state.F).sum(axis=0)
        heights = (P[:, 2:] * state.F[:, :2]).sum(axis=0)
        # About the ZMP on the ground: but for what shear does at heights.
        np.testing.assert_allclose(
            moment[:2], [-heights[1], heights[0]], atol=1e-9 * press
        )
        assert carried.moment == pytest.approx(moment[2], abs=1e-12)


def test_smoother_laws_come_down_to_the_wanted_one():
    law = ContactLaw(0.8, 1000.0, 1e-5, 0.03)
    found = [(way.layer, way.kappa) for way in _smoother(law)]
    np.testing.assert_allclose(
        found, [(1e-4, 0.2), (2e-5, 0.04), (1e-5, 0.03), (1e-5, 0.03)]
    )
    assert all(way.friction == 0.8 for way in _smoother(law))


class Reach:
    """Equilibria are numbers; steps longer than `far` do not converge."""

    def __init__(self, far, edge=np.inf):
        self.far, self.edge, self.tried = far, edge, []

    def solve(self, state, target):
        aim = float(target.force[2])
        self.tried.append(aim)
        ok = abs(aim - state.F[0, 0]) <= self.far and aim <= self.edge
        new = State(
            np.full((1, 3), aim if ok else np.nan), np.zeros(3), np.eye(3)
        )
        return new, Convergence(ok, 5, 0.0 if ok else 1.0, "" if ok else "far")

    def places(self, state):
        return 10 * state.F


def _ends():
    aim = [Target(np.array([0, 0, f]), np.zeros(2), "r") for f in (0.0, 1.0)]
    return State(np.zeros((1, 3)), np.zeros(3), np.eye(3)), *aim


def test_a_way_is_halved_and_doubled():
    state, before, target = _ends()
    reach = Reach(0.3)
    found, report = lead(reach, state, before, target)
    np.testing.assert_allclose(
        reach.tried, [1, 0.5, 0.25, 0.75, 0.5, 1, 0.75, 1]
    )
    assert found.F[0, 0] == report.reached == 1.0 and report.converged
    assert report.iterations == 5 * len(reach.tried)
    found, report = lead(Reach(9, 0.6), state, before, target)
    assert not report.converged
    done = report.reached
    assert done == 153 / 256 <= 0.6
    assert found.F[0, 0] == done
    assert f"beyond {done:.3f} of the way" in report.message


def test_time_between_samples_is_parted():
    """Each part's references are the places that the one before has left."""
    state, before, target = _ends()
    reach = Reach(0.3)
    asked = []
    with pytest.MonkeyPatch.context() as patch:

        def follow(solver, state, here, aim):
            asked.append((here.force[2], aim.force[2], aim.reference))
            return solver.solve(state, aim)

        patch.setattr(simulation, "follow_load", follow)
        found, report, references = refine_time(
            reach, state, "first", before, target
        )
        np.testing.assert_allclose(
            [(a, b) for a, b, _ in asked],
            [(0, 0.5), (0, 0.25), (0.25, 0.75), (0.25, 0.5), (0.5, 1),
             (0.5, 0.75), (0.75, 1)],
        )  # fmt: skip
        assert asked[1][2] == "first"
        np.testing.assert_allclose(asked[3][2], np.full((1, 3), 2.5))
        np.testing.assert_allclose(references, np.full((1, 3), 7.5))
        assert found.F[0, 0] == 1.0 and report.converged
        assert (report.parts, report.iterations) == (4, 35)
        _, report, _ = refine_time(
            Reach(9, 0.6), state, "first", before, target
        )
    assert not report.converged
    assert "beyond 59.38 % of" in report.message and "1/64" in report.message


def test_part_of_the_way_from_one_load_to_another():
    a = Target(np.array([1.0, 2, 3]), np.array([4.0, 5]), "a", 6.0,
               exp_rotation(np.array([0.1, 0, 0])), 7.0)  # fmt: skip
    turn = np.array([0.2, -0.3, 0.4])
    b = Target(np.array([2.0, 4, 8]), np.array([5.0, 9]), "b", 10.0,
               exp_rotation(turn) @ a.rotation, 17.0)  # fmt: skip
    found = b.partway(a, 0.25)
    np.testing.assert_allclose(found.force, [1.25, 2.5, 4.25])
    np.testing.assert_allclose(found.zmp, [4.25, 6.0])
    assert (found.moment, found.height, found.reference) == (7.0, 9.5, "b")
    back = rotation_vector(found.rotation @ a.rotation.T)
    np.testing.assert_allclose(back, 0.25 * turn)
    free = replace(b, rotation=None).partway(a, 0.25)
    assert free.rotation is None
    np.testing.assert_array_equal(
        b.partway(replace(a, rotation=None), 0.25).rotation, b.rotation
    )
    np.testing.assert_array_equal(found.point, [4.25, 6.0, 9.5])
    np.testing.assert_allclose(b.missed(np.arange(6.0)), [-2, -3, -6, 0, 0, 0])
    np.testing.assert_allclose(
        free.missed(np.arange(6.0)), [-1.25, -1.5, -2.25, 3, 4, 5 - 7.0]
    )
    # Turned about the ZMP: what was there stays there.
    R = exp_rotation(np.array([0.3, 0.1, -0.2]))
    O = np.array([1.0, 2.0, 3.0])  # noqa: E741
    place, rotation = found.turned(O, R)
    held = R.T @ (found.point - O)
    np.testing.assert_allclose(rotation @ held + place, found.point)
    np.testing.assert_array_equal(rotation, found.rotation)


def test_a_neighbours_increments_are_a_guess():
    rng = np.random.default_rng(0)
    turns = [exp_rotation(w) for w in rng.standard_normal((3, 3))]
    history = StepHistory(
        rng.standard_normal((3, 4, 3)), rng.standard_normal((3, 3)),
        np.array(turns), np.zeros((3, 4, 3)), np.zeros((3, 6, 6)),
    )  # fmt: skip
    same = _alike(history, 0, 2, history.state(0))
    np.testing.assert_allclose(same.F, history.F[2])
    np.testing.assert_allclose(same.O, history.O[2])
    np.testing.assert_allclose(same.R, turns[2], atol=1e-12)
    turn = exp_rotation(np.array([0.1, 0.2, 0.3]))
    other = State(history.F[0] + 1, history.O[0] - 2, turns[0] @ turn)
    found = _alike(history, 0, 2, other)
    np.testing.assert_allclose(found.F, history.F[2] + 1)
    np.testing.assert_allclose(found.O, history.O[2] - 2)
    np.testing.assert_allclose(found.R, turns[2] @ turn, atol=1e-12)


def test_increments_move_a_state_about_the_zmp():
    rng = np.random.default_rng(1)
    R = exp_rotation(np.array([0.3, 0.2, -0.1]))
    state = State(rng.standard_normal((2, 3)), np.array([0.1, 0.2, 0.3]), R)
    Z, dF = np.array([0.5, -0.5, 0.0]), rng.standard_normal((2, 3))
    dp = np.array([0.01, 0.02, 0.03, 0.1, -0.2, 0.3])
    found = move(state, dF, dp, Z)
    np.testing.assert_allclose(found.F, state.F + dF)
    turn = exp_rotation(dp[3:])
    np.testing.assert_allclose(found.R, turn @ R)
    held = R.T @ (Z - state.O)  # of the sole, at the ZMP: shifted alone
    np.testing.assert_allclose(found.R @ held + found.O, Z + dp[:3])


def test_steps_are_capped_in_turn_and_shift():
    dp = np.array([0.003, 0.0, 0.004, 0.0, 0.5, 0.0])
    assert capped(dp, 1.0, 1.0) == 1.0
    assert capped(dp, 0.1, 1.0) == pytest.approx(0.2)
    assert capped(dp, 1.0, 0.001) == pytest.approx(0.2)
    assert capped(np.zeros(6), 0.1, 0.1) == 1.0


@pytest.mark.parametrize(
    ("merits", "taken"),
    [([5, 1], 0.5), ([9, 8, 7], 0.125), ([0.5], 0.5), ([3, 7, 2.5], 0.125)],
)
def test_a_step_is_halved_until_it_gains(merits, taken):
    """Else the best of those that were met."""
    asked = []

    def trial(step):
        asked.append(step)
        return SimpleNamespace(step=step, merit=merits[len(asked) - 1])

    start = SimpleNamespace(merit=2.0)
    found = line_search(start, trial, 0.5, 2)
    wanted = [0.5, 0.25, 0.125][: len(asked)]
    np.testing.assert_allclose(asked, wanted)
    best = 0.25 if merits == [5, 1] else taken
    assert found.step == best


def test_a_start_s_places_follow_the_turn():
    """All but yaw, which stays; by differences."""
    rng = np.random.default_rng(2)
    lP = 0.1 * rng.standard_normal((5, 3))
    R = rotations_xyz(np.array([0.2, -0.3, 0.7]))
    own = START.orientation(R)
    np.testing.assert_allclose(
        own, rotations_xyz(np.array([0.2, -0.3, 0.3])), atol=1e-12
    )
    P = START.places(R, lP)
    np.testing.assert_allclose(P, START.point_W + (lP - POINT) @ own.T)
    found, h = START.places_by_turn(R, lP), 1e-6
    for k in range(3):
        ahead, behind = (
            START.places(exp_rotation(s * h * np.eye(3)[k]) @ R, lP)
            for s in (1, -1)
        )
        np.testing.assert_allclose(
            found[:, :, k], (ahead - behind) / (2 * h), atol=1e-8
        )


def test_samples_after_a_failure_are_left_out(monkeypatch):
    """Or tried each from where the last success was."""
    load = Load(np.arange(5.0), np.tile([0, 0, 1.0], (5, 1)), np.zeros((5, 2)))
    lost = Convergence(False, 3, 1.0, "lost")
    monkeypatch.setattr(simulation, "first_step", lambda *_: (None, lost))
    law = SimpleNamespace(friction=0.8)
    solver = SimpleNamespace(lP=np.zeros((2, 3)), ground=FLAT, law=law)
    said = []

    def told(done, count):
        said.append((done, count))

    history = simulate(solver, load, START, stop_at_failure=True, progress=told)
    words = [r.message for r in history.reports]
    assert words == ["lost"] + 4 * ["left out after a failure"]
    assert history.failed_steps == 5 and said == []
    history = simulate(solver, load, START, progress=told)
    assert [r.message for r in history.reports] == 5 * ["lost"]
    assert said == [(k, 5) for k in range(1, 6)]


def test_what_takes_far_longer_than_a_neighbour_fails(monkeypatch):
    """Three times ten steps and the neighbour's, over all samples so far."""
    load = Load(np.arange(3.0), np.tile([0, 0, 1.0], (3, 1)), np.zeros((3, 2)))
    states = State(np.zeros((2, 3)), np.zeros(3), np.eye(3))
    near = StepHistory(
        np.zeros((3, 2, 3)), np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1)),
        np.zeros((3, 2, 3)), np.zeros((3, 6, 6)),
        [Convergence(True, n, 0.0) for n in (2, 5, 0)],
    )  # fmt: skip
    solver = SimpleNamespace(
        lP=np.zeros((2, 3)), ground=FLAT, places=lambda state: state.F,
        law=SimpleNamespace(friction=0.8),
        linearise=lambda *_: SimpleNamespace(cartesian_stiffness=np.eye(6)),
    )  # fmt: skip
    given, steps = [], []

    def first_step(solver, target, largest, near, patience):
        given.append((largest, patience))
        return states, Convergence(True, steps[0], 0.0)

    def follow_load(solver, state, before, target, guess):
        given.append(guess)
        return states, Convergence(True, steps[len(given) - 1], 0.0)

    monkeypatch.setattr(simulation, "first_step", first_step)
    monkeypatch.setattr(simulation, "follow_load", follow_load)
    # 36 steps may be taken by the first, 81 by both, 111 by all three.
    for taken, good in (
        ((36, 45, 30), [True, True, True]),
        ((37, 0, 0), [False, False, False]),
        ((30, 52, 0), [True, False, False]),
        ((30, 51, 31), [True, True, False]),
    ):
        given.clear()
        steps[:] = taken
        history = simulate(solver, load, START, near=near, stop_at_failure=True)
        assert history.converged.tolist() == good
        assert given[0] == (1.0, 36)


def test_neighbours_poses_are_branches(monkeypatch):
    """Within 0.1 they are one; farther off it has to follow from there."""
    law = ContactLaw(0.8, 1.0)
    solver = SimpleNamespace(law=law, lP=np.zeros((1, 3)))
    target = Target(np.array([0, 0, 3.0]), np.zeros(2), START)

    def at(angle):
        R = exp_rotation(np.array([0, 0, angle]))
        return State(np.zeros((1, 3)), np.zeros(3), R)

    press, followed = [], [at(0.5)]
    done = Convergence(True, 1, 0.0)

    def cold(solver, target, force, patience):
        press.append(force)
        return at(0.5), done

    monkeypatch.setattr(simulation, "_cold_start", cold)
    monkeypatch.setattr(
        simulation, "_follow_design", lambda *_: (followed[0], done)
    )
    for largest in (10.0, 100.0):
        assert first_step(solver, target, largest, None)[1].converged
    assert press == [3.0, 20.0]
    followed[0] = at(0.0)
    assert first_step(solver, target, 1.0, at(0.41))[1].converged
    state, report = first_step(solver, target, 1.0, at(0.38))
    assert state is None and report.message == "another branch"
    for angle, good in ((0.5 + 5e-7, True), (0.5 + 5e-6, False)):
        followed[0] = at(angle)
        found = first_step(solver, target, 1.0, at(0.3))[1]
        assert found.converged is good
