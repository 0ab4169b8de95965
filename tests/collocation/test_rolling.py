"""Feet that roll and lift, settled onto their forces before a solve."""

import numpy as np
import pytest
from kernel_derivatives import check_curvature, check_jacobian
from scipy.optimize import brentq
from test_kernels import _states

from drake_exo.collocation import initial_guess
from drake_exo.collocation.initial_guess import settle_rolling
from drake_exo.collocation.kernels import (
    DynamicsKernel,
    FootGroundKernel,
    PoseKernel,
)
from drake_exo.contact.hunt_crossley import sphere_force
from drake_exo.contact.parameters import ContactSphere, GroundContact
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.description import nominal_human
from drake_exo.model.plant import Model

BODIES = ("foot_left", "toes_left", "foot_right", "toes_right")


@pytest.fixture(scope="module")
def walker():
    return Model(Assembly(Person("two", "hinged")), nominal_human())


def test_derivatives_of_two_legs_on_the_ground(walker):
    kernel = DynamicsKernel(walker.tree, BODIES)
    check_jacobian(kernel, _states(4, kernel.sparsity.shape[1]))


@pytest.mark.parametrize("body", ["toes_left", "foot_right", "pelvis"])
def test_derivatives_of_poses(walker, body):
    kernel = PoseKernel(walker.tree, body)
    x = _states(4, kernel.sparsity.shape[1])
    check_jacobian(kernel, x)
    weights = _states(4, 6, seed=1)
    if body == "pelvis":  # the root: its coordinates are its pose
        assert not kernel.curvature(x, weights, None).any()
    else:
        check_curvature(kernel, x, weights)


def test_poses_are_those_of_the_plant(walker):
    plant = walker.plant()
    context = plant.CreateDefaultContext()
    q, v = np.random.default_rng(0).normal(size=(2, walker.tree.num_positions))
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    body = plant.GetBodyByName("toes_right")
    pose = plant.EvalBodyPoseInWorld(context, body)
    motion = plant.EvalBodySpatialVelocityInWorld(context, body)
    (found,) = walker.tree.states(q[None], v[None], "toes_right")
    ahead = pose.rotation().matrix()[:, 0]
    np.testing.assert_allclose(found[:2], pose.translation()[[0, 2]])
    np.testing.assert_allclose(np.cos(found[2]), ahead[0])
    np.testing.assert_allclose(np.sin(found[2]), ahead[2])
    np.testing.assert_allclose(found[3:5], motion.translational()[[0, 2]])
    np.testing.assert_allclose(found[5], -motion.rotational()[1])


SPHERES = {
    "heel": ContactSphere(2e6, 0.5, -0.05, -0.06, 0.032),
    "ball": ContactSphere(2e6, 0.5, 0.13, -0.06, 0.032),
}
TIMES = np.linspace(0.0, 0.6, 121)
STANCE = slice(20, 100)


def rolling():
    """A step: down on the heel, over the foot, off the ball, off-centre."""
    s = np.clip((TIMES - 0.1) / 0.4, 0.0, 1.0)
    foot = np.zeros((len(TIMES), 3))
    foot[:, 1] = 0.11
    foot[:, 2] = 0.25 - 0.7 * s**3
    load = np.zeros(len(TIMES))
    load[STANCE] = 700.0 * np.sin(np.pi * s[STANCE]) ** 0.5 + 6.0
    ahead = -0.045 + 0.17 * s
    ground = np.column_stack([0.1 * load * (2 * s - 1), load, -ahead * load])
    return foot, ground


def law(kernel, q, v):
    values = [s.in_plane for s in SPHERES.values()]
    rows = np.tile(np.ravel(values), (len(q), 1))
    x = np.hstack([q, v, 0.0 * q, rows])
    return kernel.wrench(x)


def settled():
    """The kernel; a foot and its load as measured; as it is settled."""
    kernel = FootGroundKernel(GroundContact("simbody", SPHERES))
    spheres = np.array([s.in_plane for s in SPHERES.values()])
    places = np.broadcast_to(spheres[:, 2:4], (len(TIMES), 2, 2))
    foot, ground = rolling()
    q, v = settle_rolling(kernel, spheres, places, TIMES, foot, ground)
    return kernel, foot, ground, q, v


def test_a_rolling_foot_bears_what_was_measured():
    kernel, foot, ground, q, v = settled()
    still = law(kernel, q, 0.0 * v)
    # At rest; what sinking dissipates is left to the solver.
    off = np.abs(still[:, 1] - ground[:, 1])[STANCE]
    assert off.max() < 1e-9
    # As measured it would hang in the air, or be pressed into the ground.
    raw = np.abs(law(kernel, foot, 0.0 * v)[:, 1] - ground[:, 1])[STANCE]
    assert raw.max() > 100.0
    # In the air it touches nothing, and it stays near where it was seen.
    in_air = np.r_[0 : STANCE.start, STANCE.stop : len(TIMES)]
    assert np.abs(law(kernel, q, v)[in_air, 1]).max() < 5.0
    assert np.abs(q[:, 2] - foot[:, 2]).max() < 0.11
    # Where it slips to is what its speed adds up to.
    speed = np.gradient(q[:, 0], TIMES)[STANCE][2:-2]
    slipping = v[STANCE, 0][2:-2]
    assert np.abs(slipping).max() > 0.5
    np.testing.assert_allclose(speed, slipping, atol=0.005)
    # Rolling moves the ankle, which was drawn as standing.
    assert np.abs(q[:, 0] - foot[:, 0]).max() < 0.06


def test_a_foot_turns_towards_where_its_load_was_measured():
    """Nearer to the measured centre of pressure than as it was seen."""
    kernel, foot, ground, q, _ = settled()
    turned = np.flatnonzero(np.abs(q[:, 2] - foot[:, 2]) > 0.02)
    turned = turned[(turned >= STANCE.start) & (turned < STANCE.stop)]
    assert len(turned) > 5

    def cop(at):
        """Ahead of the ankle [m], at rest."""
        wrench = law(kernel, at[None], np.zeros((1, 3)))[0]
        return -wrench[2] / wrench[1] - at[0]

    def seen(k):
        """With the load at the pitch that was measured."""

        def missing(z):
            at = np.r_[0.0, z, foot[k, 2]]
            return law(kernel, at[None], np.zeros((1, 3)))[0, 1] - ground[k, 1]

        return np.r_[0.0, brentq(missing, 0.0, 0.2), foot[k, 2]]

    measured = -ground[turned, 2] / ground[turned, 1] - foot[turned, 0]
    off = np.abs([cop(q[k]) for k in turned] - measured)
    before = np.abs([cop(seen(k)) for k in turned] - measured)
    # The turn is smoothed over time, so that not all of it is there.
    assert off.mean() < 0.75 * before.mean()


def test_a_foot_in_the_air_is_just_clear_of_the_ground():
    kernel = FootGroundKernel(GroundContact("simbody", SPHERES))
    spheres = np.array([s.in_plane for s in SPHERES.values()])
    places = np.broadcast_to(spheres[:, 2:4], (len(TIMES), 2, 2))
    foot = np.zeros((len(TIMES), 3))
    foot[:, 1] = np.linspace(0.05, 0.15, len(TIMES))  # soles at 0.092
    q, _ = settle_rolling(
        kernel, spheres, places, TIMES, foot, np.zeros((len(TIMES), 3))
    )
    np.testing.assert_allclose(q[:, 1], np.maximum(foot[:, 1], 0.097))
    np.testing.assert_array_equal(q[:, [0, 2]], foot[:, [0, 2]])


def test_a_rolling_foot_slips_as_far_as_it_is_pushed():
    """Without dissipation F_x is as measured, also where the foot turns."""
    spheres = np.array(
        [[2e6, 0.0, -0.05, -0.06, 0.032], [2e6, 0.0, 0.13, -0.06, 0.032]]
    )
    own = {
        name: ContactSphere(*values)
        for name, values in zip(SPHERES, spheres, strict=True)
    }
    kernel = FootGroundKernel(GroundContact("simbody", own))
    places = np.broadcast_to(spheres[:, 2:4], (len(TIMES), 2, 2))
    foot, ground = rolling()
    q, v = settle_rolling(kernel, spheres, places, TIMES, foot, ground)
    rows = np.tile(spheres.ravel(), (len(q), 1))
    x = np.hstack([q, v, np.zeros_like(q), rows])
    found = kernel.wrench(x)
    inside = slice(STANCE.start + 3, STANCE.stop - 3)
    off = np.abs(found[:, 0] - ground[:, 0])[inside]
    assert np.abs(ground[inside, 0]).max() > 30.0
    assert np.abs(v[inside, 2]).max() > 2.0
    assert off.max() < 0.5, off.max()


def test_offsets_fade_from_the_nearest_loaded_sample():
    """As exp(-(t / 0.1 s)^2), on either side."""
    times = 0.05 * np.arange(8.0)
    loaded = np.array([0, 0, 1, 1, 0, 0, 0, 1], bool)
    off = np.array([9.0, 9.0, 0.3, -0.2, 9.0, 9.0, 9.0, 0.5])
    e = np.exp([-0.25, -1.0])
    expected = [
        0.3 * e[1],
        0.3 * e[0],
        0.3,
        -0.2,
        -0.2 * e[0],
        -0.2 * e[1],
        0.5 * e[0],
        0.5,
    ]
    found = initial_guess._bridged(off, loaded, times)
    np.testing.assert_allclose(found, expected)
    for every in (np.ones(8, bool), np.zeros(8, bool)):
        np.testing.assert_array_equal(
            initial_guess._bridged(off, every, times), off
        )


@pytest.mark.parametrize("force_x", [-30.0, 0.0, 45.0])
def test_slip_that_gives_a_force(force_x):
    """Of two spheres together; beyond friction it is as fast as may be."""
    kernel = FootGroundKernel(GroundContact("simbody", SPHERES))
    spheres = np.array([s.in_plane for s in SPHERES.values()])
    loads = np.array([[50.0, 20.0], [10.0, 90.0]])
    wanted = np.array([force_x, 2.0 * force_x])
    slip = initial_guess.slip_velocity(kernel, spheres, loads, wanted)
    for total, speed, force in zip(
        loads.sum(axis=1), slip, wanted, strict=True
    ):
        # A depth at which one sphere bears all of it.
        depth = brentq(
            lambda d, total=total: (
                initial_guess.static_force(kernel, spheres[:1], d)[0] - total
            ),
            1e-6,
            0.02,
        )
        _, friction = sphere_force(
            "simbody",
            depth,
            0.0,
            speed,
            *spheres[0, [0, 1, 4]],
            kernel.constants,
        )
        assert friction == pytest.approx(force, rel=1e-3, abs=1e-3)
    sign = np.sign(slip)
    np.testing.assert_array_equal(
        sign[wanted != 0.0], -np.sign(wanted)[wanted != 0.0]
    )


def test_a_foot_sinks_until_it_bears():
    """Under spheres of different reach, by a root of the summed force."""
    kernel = FootGroundKernel(GroundContact("simbody", SPHERES))
    spheres = np.array([s.in_plane for s in SPHERES.values()])
    below = np.array([[0.09, 0.088], [0.05, 0.07]])
    force = np.array([700.0, 300.0])
    places = np.stack([0.0 * below, spheres[:, 4] - below], axis=2)
    height, depths, bears = initial_guess.sunk(
        kernel, spheres, places, np.zeros(2), force, 0.05
    )
    np.testing.assert_allclose(depths, below - height[:, None])
    np.testing.assert_allclose(bears.sum(axis=1), force, rtol=1e-6)
    assert bears[1, 0] < 5.0 < 50.0 < bears[0, 1]
