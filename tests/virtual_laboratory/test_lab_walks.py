"""Walks: what is meant, how a body is held up, and what comes of it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import drake_exo as dx
from drake_exo.calibration.phases import PeriodicStep, mirrored
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.calibration.uncertainty import QUANTILE_95, bands
from drake_exo.contact.parameters import (
    ContactModel,
    Posterior,
    nominal_contact,
)
from drake_exo.errors import InputError
from drake_exo.files.opensim import read_table
from drake_exo.nlp.ipopt import Solution
from drake_exo.virtual_laboratory import simulation, two_legs
from drake_exo.virtual_laboratory.two_legs import (
    TwoLegs,
    WalkingController,
    WalkPlan,
    repeated,
    template,
    vary_walk,
    write_movements,
)

PLAN = WalkPlan()


def draw(path, seed, active):
    return TwoLegs(Path(), path, "walk", seed, active)


@pytest.fixture
def subject(alone):
    return draw(alone, 0, frozenset())


@pytest.fixture
def step(subject):
    model = subject.truth.model
    return template(model.tree, subject.truth.contact, PLAN)


def test_a_template_is_a_step(subject, step):
    """Feet change over, on the ground, and bear the body in turn."""
    tree, names = subject.truth.model.tree, step.coordinates
    other = mirrored(names)
    ahead = np.zeros(len(names))
    ahead[0] = PLAN.speed_m_s * PLAN.step_s
    off = step.q[-1] - other @ step.q[0] - ahead
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    weight = tree.weight
    assert step.ground.force_z.mean() == pytest.approx(weight, rel=0.003)
    left, right = (step.feet[side].force_z for side in ("left", "right"))
    assert left[0] == right[-1] == 0.0
    np.testing.assert_allclose(left[-1], right[0])
    knee = np.rad2deg(step.coordinate("knee_left"))
    assert 55.0 < knee.max() < 70.0
    # The foot that bears stays, while the body passes over it.
    ankle = tree.point_positions(step.q, "foot_right", (0.0, 0.0))[:, 0]
    bears = step.times < 0.6 * PLAN.step_s
    assert np.ptp(ankle[bears]) < 0.3 * np.ptp(step.q[bears, 0])
    # Its pressure rolls forward under the sole, heel to toe.
    right = step.feet["right"]
    under = (right.cop_x - ankle)[right.force_z > 1.0]
    spheres = subject.truth.contact.spheres.values()
    assert min(s.x - s.radius for s in spheres) < under.min()
    assert max(s.x + s.radius for s in spheres) > under.max()
    assert (np.diff(under) > 0.0).all()


def test_steps_follow_each_other(subject, step):
    """Mirrored, further on, and the ground's force under them."""
    moments = np.ones((len(step.times), len(step.coordinates.joints)))
    moments[:, :3] = np.linspace(0.0, 3.0, len(moments))[:, None]
    found = repeated(replace(step, moments=moments), 3)
    longer = repeated(replace(step, moments=moments), 2, step.duration)
    np.testing.assert_allclose(longer.q, found.q)
    n, T = len(step.times) - 1, step.duration
    assert found.times[-1] == pytest.approx(3 * T)
    assert (np.diff(found.times) > 0.0).all()
    far = PLAN.speed_m_s * T
    names = step.coordinates
    for rows, swapped in ((n, True), (2 * n, False)):
        knee = "knee_right" if swapped else "knee_left"
        np.testing.assert_allclose(
            found.q[rows : rows + n, names.index("knee_left")][1:],
            step.coordinate(knee)[1:n],
            atol=1e-12,
        )
        at = found.ground.array[rows + 5]
        own = step.ground.array[5]
        steps = rows / n
        np.testing.assert_allclose(at[:2], own[:2])
        cop = -at[2] / at[1] + own[2] / own[1]
        assert cop == pytest.approx(steps * far)
        torque = found.moments[rows + 5]
        first, last = torque[:3], torque[3:]
        first, last = (last, first) if swapped else (first, last)
        np.testing.assert_allclose(first, moments[5, :3])
        np.testing.assert_allclose(last, 1.0)


def test_a_leg_that_bears_holds_the_body(subject, step):
    """Torques do work towards the plan; a leg that swings minds itself."""
    model, names = subject.truth.model, subject.truth.model.coordinates
    zero = np.zeros((len(step.times), len(names.joints)))
    walk = repeated(replace(step, moments=zero), 1)
    weight = model.tree.weight
    controller = WalkingController(names, walk, weight)
    i = 20
    t = walk.times[i]
    q, v = (np.array(controller.off(t, 0.0 * walk.q[i], walk.q[i])[k])
            for k in (0, 1))  # fmt: skip
    q, v = q, walk.v[i]
    on_right = np.array([0.0, weight])
    at_rest = controller.torques(t, q, v, on_right)
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-9)

    def torques(**moved):
        off = q.copy()
        for name, by in moved.items():
            off[names.index(name)] += by
        found = controller.torques(t, off, v, on_right)
        return dict(zip(names.human, found, strict=True))

    # The pelvis lags: the standing ankle brings it along, no other joint.
    behind = torques(pelvis_x=-0.01)
    assert behind["ankle_right"] > 1.0
    assert np.count_nonzero(np.abs(list(behind.values())) > 1e-9) == 1
    # The trunk leans too far back: the standing hip pulls it forward.
    back = torques(pelvis_pitch=0.01)
    assert back["hip_right"] > 1.0
    assert back["hip_left"] == pytest.approx(0.0, abs=1e-9)
    # A swinging joint resists its own error alone.
    off = torques(hip_left=0.01)
    assert off["hip_left"] == pytest.approx(-6.0)
    assert np.count_nonzero(np.abs(list(off.values())) > 1e-9) == 1


def test_walks_differ(step):
    rng = np.random.default_rng(0)
    plans = [vary_walk(PLAN, rng) for _ in range(50)]
    speeds = [p.speed_m_s for p in plans]
    assert 1.1 < min(speeds) < 1.15 < 1.25 < max(speeds) < 1.3
    assert np.ptp([p.step_s for p in plans]) > 0.03


def test_who_stumbles_is_told(subject, step):
    """A body that is not where it means to be is not recorded."""
    zero = np.zeros((len(step.times), len(step.coordinates.joints)))
    walk = repeated(replace(step, moments=zero), 1)
    elsewhere = replace(walk, q=walk.q + np.eye(9)[0] * 0.11)
    names, weight = (
        subject.truth.model.coordinates,
        subject.truth.model.tree.weight,
    )
    walker = WalkingController(names, elsewhere, weight)
    with pytest.raises(InputError, match="walk: the walker stumbles after 0"):
        simulation.simulate("walk", subject.truth, walk, walker=walker)


def worn_step(worn):
    """A device's model, the template in it, and nominal cuffs."""
    subject = draw(worn, 0, frozenset())
    model, names = subject.truth.model, subject.truth.model.coordinates
    soles = replace(subject.truth.contact, constants=two_legs._SMOOTH)
    near = template(model.rigid.tree, soles, PLAN)
    q, v, a = (names.aligned(x) for x in (near.q, near.v, near.a))
    near = replace(near, coordinates=names, q=q, v=v, a=a)
    return model, near, ContactModel(soles, nominal_contact(model).bushings)


@pytest.mark.slow
def test_a_periodic_step_has_bands(worn):
    """It tracks nothing, but what a calibration left open moves it."""
    model, near, contact = worn_step(worn)
    name = "thigh_left.normal_stiffness"
    known = Posterior((name,), np.array([5e3]), np.array([[500.0**2]]))
    settings = PredictionSettings(ends="periodic", solver=Solver(10.0))
    problem = PeriodicStep(
        model, [near], replace(contact, posterior=known), settings
    )
    guess = problem.compiled.restrict(problem.guess())
    values = problem.compiled.expand(guess)
    solution = Solution(True, "", 0, 0.0, 0.0, [], 0, 0, 0, _values=values)
    found = bands(problem.result(solution))
    assert found.cuffs["thigh_left"][:, 1].max() > 0.1
    assert found.seen_q.shape == found.q.shape
    hip = model.coordinates.index("hip_left")
    noise = np.deg2rad(settings.noise.angle_deg)
    assert (found.seen_q[:, hip] > QUANTILE_95 * noise).all()


@pytest.mark.slow
def test_a_step_repeats_itself_in_a_device(worn):
    """Periodic ends of person and device, cuffs between them."""
    model, near, contact = worn_step(worn)
    names = model.coordinates
    settings = PredictionSettings(
        ends="periodic",
        speed_m_s=PLAN.speed_m_s,
        torque_limit_nm=300.0,
        noise=two_legs._NOISE,
        solver=Solver(25.0),
    )
    result = PeriodicStep(model, [near], contact, settings).solve()
    assert result.success
    (found,), other = result.trials, mirrored(names)
    ahead = np.zeros(len(names))
    ahead[0] = PLAN.speed_m_s * PLAN.step_s
    assert other[names.index("left_hip"), names.index("right_hip")] == 1.0
    np.testing.assert_allclose(
        found.q[-1], other @ found.q[0] + ahead, atol=1e-4
    )
    np.testing.assert_allclose(found.v[-1], other @ found.v[0], atol=1e-3)
    for joint in names.device:
        off = found.coordinate(joint) - found.coordinate(names.follows(joint))
        assert np.abs(off).max() < np.deg2rad(20.0)
    ends = [found.cuffs[f"thigh_{side}"].normal for side in ("left", "right")]
    assert ends[0][-1] == pytest.approx(ends[1][0])
    assert np.abs(ends[0]).max() > 5.0  # the device is carried along
    # What the ground gives over the step is the weight of both.
    lifted = np.trapezoid(found.ground.force_z, found.times) / found.duration
    assert lifted == pytest.approx(model.tree.weight, rel=0.05)


@pytest.mark.slow
def test_a_walk_is_recorded(alone, tmp_path):
    """A cycle on plates, as truth has it; what is read obeys Newton."""
    folder = tmp_path / "lab"
    folder.mkdir()
    study = dx.read_study(write_movements(folder, alone, "walk", 1, [], 1))
    (trial,) = study.trials()
    table = read_table(folder / "truth" / "walk_1.sto")
    at = trial.start_s + trial.times

    def true(name):
        column = table.values[:, table.names.index(name)]
        return np.interp(at, table.time, column)

    for side, foot in trial.feet.items():
        off = foot.force_z - true(f"{side}_force_z")
        assert np.sqrt(np.mean(off**2)) < 40.0  # a heel strikes within 20 ms
        assert (foot.force_z < 5.0).mean() == pytest.approx(0.38, abs=0.05)
        for joint, within in (("hip", 2.0), ("knee", 2.0), ("ankle", 3.0)):
            name = f"{joint}_{side}"
            off = np.rad2deg(trial.coordinate(name) - true(name))
            assert np.sqrt(np.mean(off**2)) < within
    # A cycle ends as it begins: the ground gave the weight, and no push.
    weight = study.model.tree.weight
    mean = np.trapezoid(trial.ground.force, trial.times, axis=0)
    mean /= trial.duration * weight
    np.testing.assert_allclose(mean, [0.0, 1.0], atol=0.02)
    far = np.ptp(trial.coordinate("pelvis_x"))
    assert far == pytest.approx(PLAN.speed_m_s * trial.duration, rel=0.1)
    assert 0.9 < trial.duration < 1.3
    assert all(check.holds for check in study.plausibility())
    # Toes leave within a node's time: where feet come and go, and not
    # elsewhere, nodes are closer, and the law holds between them.
    found = dx.calibrate_foot_ground(study)
    assert found.success
    assert all(audit.holds for audit in found.audit())
    (solved,) = found.trials
    steps = np.diff(solved.times)
    assert steps.min() < 0.3 * steps.max()
    assert np.median(steps) > 0.4 * steps.max()
    fine = solved.times[:-1][steps < 0.3 * steps.max()]
    changes = np.concatenate(
        [
            solved.times[1:][np.diff(foot.force_z > 1.0)]
            for foot in solved.feet.values()
        ]
    )
    assert len(changes) == 4
    assert (np.abs(fine[:, None] - changes).min(axis=1) < 0.05).mean() > 0.7
    # A forefoot comes down as well: the centre of pressure leaps forward.
    for foot in solved.feet.values():
        speed = np.gradient(foot.cop_x, solved.times)
        leaps = (foot.force_z > 50.0) & (speed > 1.5)
        changes = np.r_[changes, solved.times[leaps]]
    assert len(changes) < 0.1 * len(solved.times)
    assert np.abs(fine[:, None] - changes).min(axis=1).max() < 0.05


def test_a_foot_is_pressed_by_where_in_its_cycle_it_is(subject):
    """The table's own entries, in newtons, under a foot that is placed."""
    tree = subject.truth.model.tree
    names, weight = tree.coordinates, tree.weight
    q = np.zeros((4, len(names)))
    q[:, 0] = 1.0, 2.0, 3.0, 4.0
    q[:, 1] = 0.9
    ankle = tree.point_positions(q, "foot_left", (0.0, 0.0))[:, 0]
    cycle = np.array([0.0, 0.12, 0.3, 0.7])
    force = two_legs._borne(tree, q, "left", cycle)
    np.testing.assert_allclose(
        force.force_z, weight * np.array([0.0, 1.1, 0.78, 0.0])
    )
    np.testing.assert_allclose(force.force_x[1], -0.18 * weight)
    # 0.15 to 0.48 of the cycle: from 4 to 14 cm before the ankle.
    ahead = np.array([-0.03 + 0.07 * 0.12 / 0.15, 0.04 + 0.1 * 0.15 / 0.33])
    point = ankle[1:3] + ahead
    np.testing.assert_allclose(force.cop_x[1:3], point)
    assert force.moment[3] == 0.0


def test_the_lower_foot_is_in_the_ground_on_average(subject, step):
    """By 5 mm; what is left has no wave of one step."""
    lowest = np.min(
        [
            subject.truth.model.tree.point_positions(
                step.q, f"foot_{side}", (sphere.x, sphere.z)
            )[:, 1]
            - sphere.radius
            for side in ("left", "right")
            for sphere in subject.truth.contact.spheres.values()
        ],
        axis=0,
    )
    turn = 2.0 * np.pi * step.times / PLAN.step_s
    for wave in (1.0 + 0.0 * turn, np.cos(turn), np.sin(turn)):
        assert wave @ (lowest + 0.005) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(lowest).max() < 0.03


def test_a_template_has_the_angles_of_the_book(subject, step):
    """Toe-off at 62 % of a cycle, half a cycle before the other's."""
    assert step.times[-1] == pytest.approx(0.55) and len(step.times) == 56
    np.testing.assert_allclose(step.q[:, 0], 1.2 * step.times, atol=1e-12)
    np.testing.assert_allclose(step.q[:, 2], -np.deg2rad(3.0))
    # 38 % of the cycle after the left toes leave, at tenths of the cycle.
    for side, at, tenth in (
        ("left", 0.7, 7),
        ("left", 1.0, 0),
        ("right", 0.2, 2),
        ("right", 0.6, 6),
    ):
        begin = 0.62 if side == "left" else 0.12
        t = 2.0 * (at - begin) * PLAN.step_s
        for joint, angles in two_legs._CYCLE.items():
            found = np.interp(t, step.times, step.coordinate(f"{joint}_{side}"))
            assert np.rad2deg(found) == pytest.approx(angles[tenth], abs=0.2)
    np.testing.assert_allclose(
        step.v[3:-3], np.gradient(step.q, step.times, axis=0)[3:-3], atol=0.15
    )
    np.testing.assert_allclose(
        step.a[3:-3], np.gradient(step.v, step.times, axis=0)[3:-3], atol=5.0
    )


def test_a_step_and_a_part_of_the_next(step):
    """A walk ends in the middle of a step, velocities mirrored."""
    moments = np.ones((len(step.times), len(step.coordinates.joints)))
    whole = repeated(replace(step, moments=moments), 2)
    part = repeated(replace(step, moments=moments), 1, 0.1)
    assert part.times[-1] == pytest.approx(step.duration + 0.1)
    n = len(part.times)
    for key in ("times", "q", "v", "a", "moments"):
        np.testing.assert_array_equal(
            getattr(part, key), getattr(whole, key)[:n]
        )
    borne = part.ground.array
    np.testing.assert_array_equal(borne, whole.ground.array[:n])
    names = step.coordinates
    knees = [names.index(f"knee_{side}") for side in ("left", "right")]
    at = len(step.times) + 4
    np.testing.assert_allclose(part.v[at, knees], step.v[5, knees[::-1]])
    assert part.chair is None and not part.feet


def test_gains_of_a_leg_that_bears_and_one_that_swings(subject, step):
    """By hand: 10 mrad, 1 cm, 0.1 rad/s or 0.1 m/s off the plan."""
    names = subject.truth.model.coordinates
    zero = np.zeros((len(step.times), len(names.joints)))
    walk = repeated(replace(step, moments=zero), 1)
    weight = 1000.0
    controller = WalkingController(names, walk, weight)
    t = walk.times[20]
    q, v = walk.q[20], walk.v[20]

    def change(loads, rate=0.0, **moved):
        found = []
        for sign in (0.0, 1.0):
            off, speed = q.copy(), v.copy()
            for name, by in moved.items():
                if rate:
                    speed[names.index(name)] -= sign * by
                else:
                    off[names.index(name)] -= sign * by
            found.append(controller.torques(t, off, speed, np.array(loads)))
        off = dict(zip(names.human, found[1] - found[0], strict=True))
        return {name: x for name, x in off.items() if abs(x) > 1e-9}

    on_left, on_right, between = (weight, 0.0), (0.0, weight), (200.0, 0.0)
    approx = pytest.approx
    assert change(on_left, knee_left=0.01) == {
        "knee_left": approx(10.0),
        "ankle_left": approx(15.0),
    }
    assert change(on_right, knee_left=0.01) == {"knee_left": approx(4.0)}
    assert change(on_left, hip_left=0.01) == {"ankle_left": approx(-15.0)}
    assert change(on_left, pelvis_pitch=0.01) == {
        "hip_left": approx(-10.0),
        "ankle_left": approx(-15.0),
    }
    assert change(on_left, pelvis_x=0.01) == {"ankle_left": approx(7.2)}
    assert change(on_right, ankle_left=0.01) == {"ankle_left": approx(0.6)}
    assert change(on_left, ankle_left=0.01) == {}
    # A fifth of the weight is half way from 5 to 35 %.
    assert change(between, knee_left=0.01) == {
        "knee_left": approx(7.0),
        "ankle_left": approx(7.5),
    }
    rates = {"rate": 1.0}
    assert change(on_left, **rates, knee_left=0.1) == {
        "knee_left": approx(6.0),
        "ankle_left": approx(12.0),
    }
    assert change(on_left, **rates, pelvis_pitch=0.1) == {
        "hip_left": approx(-8.0),
        "ankle_left": approx(-12.0),
    }
    assert change(on_left, **rates, pelvis_x=0.1) == {"ankle_left": approx(36)}
    assert change(on_right, **rates, hip_left=0.1) == {"hip_left": approx(4.0)}
    assert change(on_right, **rates, knee_left=0.1) == {
        "knee_left": approx(2.5)
    }
    assert change(on_right, **rates, ankle_left=0.1) == {
        "ankle_left": approx(0.3)
    }


def test_a_walk_is_made_of_the_step_that_was_found(subject, step, monkeypatch):
    """Searched at the plan's speed, on soles that a search can follow."""
    asked = []
    moments = np.ones((len(step.times), len(step.coordinates.joints)))
    solution = SimpleNamespace(was_stopped=False, status="", explain=lambda: "")
    found = SimpleNamespace(
        success=True,
        solution=solution,
        trials=[replace(step, moments=moments), None],
    )

    def problem(model, trials, contact, settings):
        asked.append((trials[0], contact.ground, settings))
        return SimpleNamespace(solve=lambda on_iterate: found)

    monkeypatch.setattr(two_legs, "_Step", problem)
    soles = subject.truth.contact
    walk = two_legs.plan_walk(subject.truth.model, soles, PLAN, "walk")
    assert walk.times[-1] == pytest.approx(3 * PLAN.step_s + 0.25)
    near, ground, settings = asked[0]
    np.testing.assert_array_equal(near.q, step.q)
    assert ground.spheres == soles.spheres
    slower = soles.constants.transition_velocity
    assert ground.constants.transition_velocity > slower
    assert settings.speed_m_s == PLAN.speed_m_s
    assert settings.solver.nodes_per_second == 100.0
    # Newtons by the hundred, centimetres, tens of newton metres.
    noise = settings.noise
    assert 30.0 < noise.force_n < 300.0 and 0.01 < noise.cop_m < 0.1
    assert 10.0 < noise.torque_nm < 100.0 and noise.jerk > 100.0
    found.success = False
    with pytest.raises(InputError, match=r"no step of 1\.20 m/s was found"):
        two_legs.plan_walk(subject.truth.model, soles, PLAN, "walk")


def test_a_step_stays_within_degrees_of_the_template(subject, step):
    """Of the trunk's lean and the joints; its place is free."""
    names = step.coordinates
    own = SimpleNamespace(settings=SimpleNamespace(noise=two_legs._NOISE))
    rows = np.arange(step.q.size).reshape(step.q.shape)
    n = len(step.times)
    movement = SimpleNamespace(
        coordinates=names,
        grid=SimpleNamespace(q=rows),
        torque=np.arange(n * 6).reshape(n, 6),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(two_legs, "ground_terms", lambda *_: ["ground"])
        terms = two_legs._Step._terms(own, movement, step, None)
    tracked, ground, effort = terms
    assert ground == "ground"
    columns = names.columns(["pelvis_pitch", *names.human])
    np.testing.assert_array_equal(tracked.variables, rows[:, columns])
    np.testing.assert_array_equal(tracked.target, step.q[:, columns])
    assert np.rad2deg(np.unique(tracked.sigma)) == pytest.approx([6.0])
    assert np.unique(effort.sigma) == pytest.approx([20.0])
