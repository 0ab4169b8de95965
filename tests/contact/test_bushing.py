from dataclasses import replace

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from drake_exo.contact.bushing import (
    BushingParameters,
    bushing_deflection,
    bushing_energy,
    bushing_force,
    bushing_wrench,
)

STIFFNESS = (2000.0, 5000.0, 50.0)
DAMPING = (10.0, 20.0, 0.1)
REST = (0.0, 0.0, 0.0)


def states(n, seed=0):
    """Poses and motions of both links, four arrays of shape (3, n)."""
    return np.random.default_rng(seed).normal(size=(4, 3, n))


def force_of_inputs(*z, preload=REST):
    deflection, rate = bushing_deflection(
        z[0:3], z[3:6], z[6:9], z[9:12], z[12:14], preload
    )
    return np.array(bushing_force(deflection, rate, z[14:17], z[17:20]))


def inputs(n, seed=0):
    motion = states(n, seed)
    origin = np.random.default_rng(seed + 1).normal(size=(2, n))
    gains = np.multiply.outer(np.array([*STIFFNESS, *DAMPING]), np.ones(n))
    return [*motion.reshape(12, n), *origin, *gains]


def test_directions_follow_the_human_link():
    # A link that leans forwards by 0.5 rad; the device moves along it.
    angle = -0.5
    along = np.array([np.sin(0.5), np.cos(0.5)])
    pose = (0.3, 0.4, angle)
    device = (0.3 + 0.01 * along[0], 0.4 + 0.01 * along[1], angle)
    deflection, rate = bushing_deflection(pose, REST, device, REST, (0.1, 0.2))
    np.testing.assert_allclose(deflection, [0.01, 0.0, 0.0], atol=1e-15)
    np.testing.assert_array_equal(rate, [0.0, 0.0, 0.0])
    force = bushing_force(deflection, rate, STIFFNESS, DAMPING)
    np.testing.assert_allclose(force, [20.0, 0.0, 0.0], atol=1e-12)
    wrench = bushing_wrench(force, pose, device, (0.1, 0.2))
    # The human is pulled after the device.
    np.testing.assert_allclose(
        [wrench.force_x, wrench.force_z], 20.0 * along, atol=1e-12
    )


def test_rotation_and_preload():
    deflection, _ = bushing_deflection(
        REST, REST, (0.0, 0.0, 0.1), REST, (0.0, 0.3), (0.0, 0.0, 0.02)
    )
    assert deflection.rotation == pytest.approx(0.12)
    # Counter-clockwise rotation carries a point above the joint backwards.
    assert deflection.normal == pytest.approx(-0.3 * np.sin(0.1))
    assert deflection.tangential == pytest.approx(0.3 * (np.cos(0.1) - 1.0))
    preloaded, _ = bushing_deflection(
        REST, REST, REST, REST, (0.1, 0.3), (0.004, -0.002, 0.0)
    )
    np.testing.assert_allclose(preloaded, [-0.002, 0.004, 0.0], atol=1e-15)


def test_aligned_chains_feel_nothing_wherever_the_origin_is():
    pose, motion = states(1)[0][:, 0], states(1)[1][:, 0]
    deflection, rate = bushing_deflection(
        pose, motion, pose, motion, (0.07, 0.3)
    )
    np.testing.assert_allclose([*deflection, *rate], 0.0, atol=1e-15)


def test_rate_is_the_time_derivative_seen_from_the_human():
    pose_h, motion_h, pose_e, motion_e = states(30)
    step = 1e-30j
    moved, _ = bushing_deflection(
        pose_h + step * motion_h,
        motion_h,
        pose_e + step * motion_e,
        motion_e,
        (0.1, 0.3),
    )
    _, rate = bushing_deflection(pose_h, motion_h, pose_e, motion_e, (0.1, 0.3))
    np.testing.assert_allclose(rate, np.imag(moved) / 1e-30, rtol=1e-12)


def test_what_the_human_sees_does_not_depend_on_where_it_stands():
    z = inputs(1)
    turn, shift = 0.7, np.array([3.0, -2.0])
    c, s = np.cos(turn), np.sin(turn)

    def moved(pose, offset):
        x, y, angle = pose
        return (
            c * x - s * y + offset[0],
            s * x + c * y + offset[1],
            angle + offset[2],
        )

    place, still = (*shift, turn), (0.0, 0.0, 0.0)
    there = [
        *moved(z[0:3], place),
        *moved(z[3:6], still),
        *moved(z[6:9], place),
        *moved(z[9:12], still),
        *z[12:],
    ]
    np.testing.assert_allclose(
        force_of_inputs(*there), force_of_inputs(*z), rtol=1e-12
    )


def test_power_of_the_pair_is_minus_force_times_rate():
    pose_h, motion_h, pose_e, motion_e = states(50)
    origin, preload = (0.1, 0.3), (0.01, 0.02, 0.05)
    deflection, rate = bushing_deflection(
        pose_h, motion_h, pose_e, motion_e, origin, preload
    )
    force = bushing_force(deflection, rate, STIFFNESS, DAMPING)
    wrench = bushing_wrench(force, pose_h, pose_e, origin, preload)

    def power(pose, motion):
        """Of the wrench on the human, were it applied to this link."""
        v_x = motion[0] - motion[2] * (wrench.point_z - pose[1])
        v_z = motion[1] + motion[2] * (wrench.point_x - pose[0])
        return (
            wrench.force_x * v_x
            + wrench.force_z * v_z
            + wrench.moment * motion[2]
        )

    pair = power(pose_h, motion_h) - power(pose_e, motion_e)
    expected = -sum(f * r for f, r in zip(force, rate, strict=True))
    np.testing.assert_allclose(pair, expected, rtol=1e-10, atol=1e-9)
    # Springs alone: the pair's power is the loss of stored energy.
    spring = bushing_force(deflection, rate, STIFFNESS, REST)
    stepped, _ = bushing_deflection(
        pose_h + 1e-30j * motion_h,
        motion_h,
        pose_e + 1e-30j * motion_e,
        motion_e,
        origin,
        preload,
    )
    gain = np.imag(sum(bushing_energy(stepped, STIFFNESS))) / 1e-30
    np.testing.assert_allclose(
        sum(f * r for f, r in zip(spring, rate, strict=True)), gain, rtol=1e-10
    )


def test_every_scalar_type_gives_the_same_force():
    z = [column[0] for column in inputs(1)]
    expected = force_of_inputs(*z)
    autodiff = force_of_inputs(*(AutoDiffXd(v) for v in z))
    np.testing.assert_allclose([f.value() for f in autodiff], expected)
    variables = [Variable(f"z{i}") for i in range(len(z))]
    symbolic = force_of_inputs(*(Expression(v) for v in variables))
    environment = dict(zip(variables, z, strict=True))
    np.testing.assert_allclose(
        [f.Evaluate(environment) for f in symbolic], expected
    )


def test_scaling_leaves_origins_and_preload():
    parameters = BushingParameters(
        origin_x=0.1, origin_z=0.3, normal_damping=12.0, preload_angle=0.05
    )
    scaled = parameters.scaled(1.4)
    np.testing.assert_allclose(
        scaled.stiffness, 1.4 * np.array(parameters.stiffness)
    )
    np.testing.assert_allclose(
        scaled.damping, 1.4 * np.array(parameters.damping)
    )
    assert scaled.damping[1] == pytest.approx(16.8)
    assert (
        replace(
            scaled,
            **{
                name: getattr(parameters, name)
                for name in parameters.__dataclass_fields__
                if name.endswith(("_stiffness", "_damping"))
            },
        )
        == parameters
    )
