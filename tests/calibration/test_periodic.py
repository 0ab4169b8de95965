"""A periodic step, posed and not solved: what its ends and bounds say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from program_bounds import bounds

from drake_exo.calibration.error_model import _squared
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    PeriodicStep,
    _held_toes,
    _middle,
    mirrored,
)
from drake_exo.calibration.settings import (
    FootGroundSettings,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.uncertainty import _regulariser
from drake_exo.contact.parameters import nominal_contact
from drake_exo.errors import InputError
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import scale_human

TIMES = np.linspace(0.0, 0.5, 51)
SPEED = 1.2


@pytest.fixture(scope="module")
def model():
    return Model(Assembly(Person("two")), scale_human(70.0, 1.75))


@pytest.fixture(scope="module")
def step(model):
    """Left and right exchange roles; the right foot swings in the middle."""
    names, s = model.coordinates, np.pi * TIMES / TIMES[-1]
    q = np.zeros((len(TIMES), len(names)))
    q[:, names.index("pelvis_x")] = 0.3 + SPEED * TIMES
    q[:, names.index("pelvis_z")] = 0.93 + 0.01 * np.sin(2.0 * s)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for joint, mean, reach in (
            ("hip", 0.2, 0.3),
            ("knee", 0.4, 0.2),
            ("ankle", 0.0, 0.8),
        ):
            i = names.index(f"{joint}_{side}")
            q[:, i] = mean + sign * reach * np.cos(s)
    v = np.gradient(q, TIMES, axis=0)
    a = np.gradient(v, TIMES, axis=0)
    load = {"left": 700.0 + 0.0 * s, "right": np.where(_air(s), 0.0, 500.0)}
    feet = {
        side: PlanarWrench.of(np.column_stack([0 * f, f, -0.3 * f]))
        for side, f in load.items()
    }
    whole = feet["left"] + feet["right"]
    return Trial("step", names, TIMES, q, v, a, whole, feet=feet)


def _air(s):
    return (s > 0.2 * np.pi) & (s < 0.8 * np.pi)


def posed(model, step, **settings):
    own = PredictionSettings(ends="periodic", solver=Solver(20.0), **settings)
    return PeriodicStep(model, [step], nominal_contact(model), own)


def blocks(problem, what):
    return [b for b in problem.program.constraints if what in b.name]


def test_left_and_right_are_exchanged():
    root = ("pelvis_x", "pelvis_z", "pelvis_pitch")
    legs = ("hip_left", "knee_left", "hip_right", "knee_right")
    names = Coordinates((*root, *legs))
    found = mirrored(names) @ [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    np.testing.assert_array_equal(found, [1, 2, 3, 6, 7, 4, 5])
    with pytest.raises(InputError, match="ankle stands for both legs"):
        mirrored(nominal_model("human").coordinates)


def test_joints_of_a_device_may_count_the_other_way_on_the_other_side():
    root = ("pelvis_x", "pelvis_z", "pelvis_pitch")
    legs = ("hip_left", "knee_left", "motor_left", "hip_right", "knee_right")
    turned = {"hip": (1.0, 0.0, 0.0, 0.0), "other": (0.0, 0.0, -1.0, 0.0)}
    names = Coordinates(
        (*root, *legs, "motor_right"),
        ("motor_left", "motor_right"),
        tuple(turned.values()),
    )
    found = mirrored(names) @ np.arange(1.0, 10.0)
    np.testing.assert_array_equal(found, [1, 2, 3, 7, 8, -9, 4, 5, -6])
    # It moves as the person does, before and after.
    S = names.aligned(np.eye(7)).T
    human = mirrored(Coordinates(names.body))
    np.testing.assert_array_equal(mirrored(names) @ S, S @ human)
    knee = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(InputError, match="motor_left turns with other"):
        mirrored(replace(names, coupling=knee))


def test_joints_of_a_device_find_each_other_whatever_their_names():
    """Of pairs that turn with left and right legs, one may count backwards."""
    root = ("pelvis_x", "pelvis_z", "pelvis_pitch")
    legs = ("hip_left", "knee_left", "M1", "hip_right", "knee_right", "M2")
    turned = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0))
    names = Coordinates((*root, *legs), ("M1", "M2"), turned)
    found = mirrored(names) @ np.arange(1.0, 10.0)
    np.testing.assert_array_equal(found, [1, 2, 3, 7, 8, -9, 4, 5, -6])
    knee = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(InputError, match="that of M1 on the other leg is not"):
        mirrored(replace(names, coupling=knee))
    twice = Coordinates(
        (*root, *legs, "M3"), ("M1", "M2", "M3"), (*turned, turned[1])
    )
    with pytest.raises(InputError, match="differ in left and right alone"):
        mirrored(twice)
    # One name tells a side; others beside the same joints tell theirs.
    half = Coordinates((*root, *legs), ("M1", "M2"), turned)
    half = replace(
        half,
        names=tuple(n.replace("M1", "exo_left") for n in half.names),
        device=("exo_left", "M2"),
    )
    np.testing.assert_array_equal(mirrored(half), mirrored(names))
    pair = ("exo_left", "exo_right")
    both = Coordinates(
        (*root, *legs, *pair), ("M1", "M2", *pair), (*turned, *turned)
    )
    found = mirrored(both)
    np.testing.assert_array_equal(found @ found, np.eye(11))
    assert found[5, 8] == found[9, 10] == -1.0
    alone = Coordinates(
        (*root, *(n for n in legs if n != "M2"), *pair),
        ("M1", *pair),
        (turned[0], *turned),
    )
    with pytest.raises(InputError, match="that of M1 on the other leg is not"):
        mirrored(alone)


def test_two_steps_are_no_step(model, step):
    """A stride was sought with legs exchanged over its time: none is found."""
    stride = replace(step, q=np.vstack([step.q[::2], step.q[-2::-2]]))
    with pytest.raises(InputError, match="trial step: ends with legs as they"):
        posed(model, stride)
    # Legs that move alike are as they began, and exchanged as well.
    posed(model, replace(step, q=0.0 * step.q))


@pytest.mark.parametrize("speed", [None, 0.7])
def test_a_step_ends_as_it_began_but_ahead(model, step, speed):
    """With a leg's angles those of the other, and its rates."""
    problem = posed(model, step, speed_m_s=speed)
    (movement,) = problem.movements
    grid, names = movement.grid, movement.coordinates
    x = np.zeros(problem.program.prog.num_vars())
    rng = np.random.default_rng(0)
    for values in (grid.q, grid.v, grid.a):
        first = rng.standard_normal(len(names))
        last = first.copy()
        for joint in ("hip", "knee", "ankle"):
            left, right = (
                names.index(f"{joint}_{s}") for s in ("left", "right")
            )
            last[left], last[right] = first[right], first[left]
        if values is grid.q:
            last[0] += (SPEED if speed is None else speed) * 0.5
        if values is grid.a:
            last[:3] = 99.0  # follow from all else
        for row, numbers in ((0, first), (-1, last)):
            x[problem.program.indices(values[row])] = numbers
    found = blocks(problem, "mirrored")
    assert len(found) == 3
    for batch in found:
        value = batch.kernel.evaluate(x[batch.indices], batch.data)
        np.testing.assert_allclose(value, batch.lower, atol=1e-12)
        np.testing.assert_array_equal(batch.lower, batch.upper)
    sizes = {b.name.split()[-1]: b.num_outputs for b in found}
    n = len(names)
    assert sizes == {"positions": n, "velocities": n, "accelerations": n - 3}
    lower, upper = bounds(problem, grid.q[0, [0]])
    assert (lower, upper) == pytest.approx((0.3, 0.3))


@pytest.mark.parametrize("speed", [None, 0.7])
def test_a_load_goes_along_at_another_speed(model, step, speed):
    """It is borne at the same place of the body, from start to end."""
    at = step.q[:, 0] + 0.05
    weight = np.column_stack([0.0 * at, -80.0 + 0.0 * at])
    load = PlanarWrench(weight, 80.0 * at)
    borne = replace(step, applied={"pelvis": load})
    (given,) = posed(model, borne, speed_m_s=speed).trials
    found = given.applied["pelvis"]
    pelvis = 0.3 + (SPEED if speed is None else speed) * TIMES
    place = -found.moment / found.force_z
    np.testing.assert_allclose(place, pelvis + 0.05, atol=1e-12)
    np.testing.assert_array_equal(found.force, load.force)


def test_joints_turn_as_far_as_people_s(model, step):
    """Or as far as they do in the trial."""
    problem = posed(model, step)
    (movement,) = problem.movements
    names, q = movement.coordinates, movement.grid.q
    for joint, (least, most) in {
        "hip_left": (-30.0, 120.0),
        "knee_right": (0.0, 140.0),
        # Its own reach is larger.
        "ankle_left": (-50.0, 35.0),
    }.items():
        at = step.sample(movement.grid.times).coordinate(joint)
        lower, upper = bounds(problem, q[1:-1, names.index(joint)])
        np.testing.assert_allclose(lower, min(np.deg2rad(least), at.min()))
        np.testing.assert_allclose(upper, max(np.deg2rad(most), at.max()))
    assert np.rad2deg(at.max()) > 35.0


def test_a_swinging_foot_clears_the_ground_in_the_middle(model, step):
    problem = posed(model, step, clearance_m=0.02)
    (movement,) = problem.movements
    (batch,) = blocks(problem, "clearance")
    assert batch.name == "step clearance of foot_right"
    np.testing.assert_array_equal(batch.lower, 0.02)
    times = movement.grid.times
    pose = problem.program.indices(movement.poses["foot_right"])
    used = times[np.isin(pose[:, 0], batch.indices[:, 0])]
    # In the air from 0.1 to 0.4 s: its middle half.
    assert used.min() > 0.15 and used.max() < 0.36
    assert len(used) >= 3
    x = model.tree.states(step.q[:1], step.v[:1], "foot_right")
    height = batch.kernel.evaluate(x, None)
    spheres = problem.sphere_values(problem.contact, "foot_right")
    for value, (_, _, ahead, up, radius) in zip(
        height[0], spheres, strict=True
    ):
        turned = (ahead + 1j * up) * np.exp(1j * x[0, 2])
        assert value == pytest.approx(x[0, 1] + turned.imag - radius)


def test_toes_clear_the_ground_as_their_foot_does(step):
    """Those of the foot in the air, which hang lower than its heel."""
    kind = Assembly(Person("two", "hinged"))
    hinged = Model(kind, scale_human(70.0, 1.75))
    names = hinged.coordinates
    columns = [names.index(n) for n in step.coordinates.names]
    motion = [np.zeros((len(TIMES), len(names))) for _ in range(3)]
    for own, x in zip(motion, (step.q, step.v, step.a), strict=True):
        own[:, columns] = x
    q, v, a = motion
    walked = replace(step, coordinates=names, q=q, v=v, a=a)
    problem = posed(hinged, walked, clearance_m=0.02)
    found = [b.name.split()[-1] for b in blocks(problem, "clearance")]
    assert found == ["foot_right", "toes_right"]


def test_toes_are_held_near_a_line():
    """Three degrees off the line between their ends are one deviation."""
    kind = Assembly(Person("two", "hinged"))
    names = Model(kind, scale_human(70.0, 1.75)).coordinates
    columns = names.columns(["toes_left", "toes_right"])
    q = np.zeros((len(TIMES), len(names)))
    q[-1, columns] = 0.2, -0.4
    grid = SimpleNamespace(q=np.zeros_like(q))
    at = SimpleNamespace(coordinates=names, times=TIMES, q=q)
    (held,) = _held_toes(SimpleNamespace(grid=grid), at)
    middle = len(TIMES) // 2
    share = TIMES[middle] / TIMES[-1]
    np.testing.assert_allclose(held.target[middle], share * q[-1, columns])
    np.testing.assert_allclose(held.sigma, np.deg2rad(3.0))


def test_the_middle_half_of_the_longest_run():
    free = np.zeros(30, bool)
    free[2:10] = free[20:24] = True
    times = 0.02 * np.arange(30)

    def middle():
        return _middle(free, times, 0.02)

    np.testing.assert_array_equal(middle(), np.arange(4, 8))
    free[20:30] = True  # 10 long: a quarter is 2
    np.testing.assert_array_equal(middle(), np.arange(22, 28))
    free[:] = False
    assert len(middle()) == 0


def test_a_swing_has_the_same_middle_on_a_finer_grid(model, step):
    """Where its foot lifts and comes down there are more nodes."""

    def cleared(refined):
        contact, settings = (
            nominal_contact(model),
            PredictionSettings(ends="periodic", solver=Solver(40.0)),
        )
        problem = PeriodicStep(
            model, [step], contact, settings, refined=refined
        )
        (movement,), (batch,) = problem.movements, blocks(problem, "clearance")
        pose = problem.program.indices(movement.poses["foot_right"])
        return movement.grid.times[np.isin(pose[:, 0], batch.indices[:, 0])]

    parts = np.ones(20, int)
    parts[2:7] = 4
    plain, fine = cleared({}), cleared({"step": parts})
    np.testing.assert_allclose(fine[[0, -1]], plain[[0, -1]], atol=0.02)
    assert len(fine) > len(plain)


def test_effort_alone_is_minimised(model, step):
    problem = posed(model, step)
    noise = replace(problem.settings.noise, torque_nm=20.0)
    own = PeriodicStep(
        model,
        [step],
        nominal_contact(model),
        replace(problem.settings, noise=noise),
    )
    (term,) = own.movements[0].tracked
    np.testing.assert_allclose(term.sigma, 20.0)
    np.testing.assert_allclose(term.target, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("damped", [False, True])
def test_a_regulariser_s_gradient_is_that_of_the_cost(model, step, damped):
    """Of a periodic step all that costs: effort, jerk, what alternates."""
    problem = posed(model, step)
    if damped:
        problem.movements[0].damp()
    program = problem.compiled
    rng = np.random.default_rng(3)
    y = program.restrict(problem.guess())
    y = y + 0.1 * rng.standard_normal(len(y))
    found = _regulariser(problem, program, y)
    expected = program.gradient(y)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(
        found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()
    )


def test_derivatives_of_a_square():
    """Of a force that swings, by differences in time."""
    t, h = np.linspace(0.0, 2.0, 9), 1e-4

    def f(t):
        return 30.0 + 10.0 * np.sin(3.0 * t)

    found = _squared(f(t), 30.0 * np.cos(3.0 * t), -90.0 * np.sin(3.0 * t))
    up, at, down = (f(t + k * h) ** 2 for k in (1, 0, -1))
    np.testing.assert_allclose(found[0], at)
    np.testing.assert_allclose(found[1], (up - down) / (2.0 * h), atol=1e-4)
    np.testing.assert_allclose(
        found[2], (up - 2.0 * at + down) / h**2, rtol=1e-4, atol=1e-2
    )


def test_a_foot_that_stays_in_the_air_has_no_centre_of_pressure(model, step):
    """All warnings are errors here."""
    air = PlanarWrench.of(np.zeros((len(TIMES), 3)))
    hop = replace(step, feet={**step.feet, "right": air})
    settings = FootGroundSettings(solver=Solver(20.0))
    (movement,) = FootGroundCalibration(model, [hop], settings).movements
    tracked = [np.isfinite(t.sigma).any() for t in movement.tracked]
    assert tracked.count(False) == 1


def test_a_step_without_data_is_not_shaped_by_what_would_damp_it(model, step):
    """On a refined grid its cost is still effort and jerk alone."""
    settings = posed(model, step).settings
    contact = nominal_contact(model)
    finer = {step.name: 1}
    own = PeriodicStep(model, [step], contact, settings, refined=finer)
    assert own.movements[0].may_alternate
    assert not len(own.movements[0].damped[0])
