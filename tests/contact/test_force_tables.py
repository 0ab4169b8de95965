"""The laws against tables that OpenSim 4.6 computed."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.contact.bushing import (
    bushing_deflection,
    bushing_force,
    bushing_wrench,
)
from drake_exo.contact.hunt_crossley import (
    SimbodyConstants,
    sphere_force,
    sphere_wrench,
)

# E, radius, dissipation and what differs from the defaults, as the README of
# the tables states.
SETS = {
    "A": (5e6, 0.032, 2.0, {"transition_velocity": 0.2}),
    "B": (
        1e6,
        0.032,
        2.0,
        {
            "static_friction": 0.9,
            "dynamic_friction": 0.6,
            "viscous_friction": 0.0,
            "transition_velocity": 0.05,
        },
    ),
    "C": (
        3067776.0,
        0.035,
        0.5,
        {
            "static_friction": 0.8,
            "dynamic_friction": 0.7,
            "viscous_friction": 0.6,
            "transition_velocity": 0.1,
            "hertz_smoothing": 500.0,
            "hunt_crossley_smoothing": 100.0,
        },
    ),
}


def read(root, name):
    return np.genfromtxt(
        root / "opensim" / f"{name}.csv", delimiter=",", names=True
    )


def constants_of(name):
    return replace(SimbodyConstants(), **SETS[name][3])


def assert_close(actual, expected, tolerance=1e-9):
    """Difference relative to the column's largest value."""
    scale = np.max(np.abs(expected))
    assert scale > 0.0
    assert np.max(np.abs(actual - expected)) <= tolerance * scale


@pytest.mark.parametrize("name", SETS)
def test_sphere_grid(reference_root, name):
    modulus, radius, dissipation, _ = SETS[name]
    table = read(reference_root, f"smooth_sphere_grid_{name}")
    assert len(table) == 8569
    x = table["indentation_m"]
    pressed, friction = sphere_force(
        "simbody",
        x,
        table["indentation_rate_mps"],
        table["tangential_velocity_mps"],
        modulus,
        dissipation,
        radius,
        constants_of(name),
    )
    force_x, force_z = table["Fx_on_sphere_N"], table["Fy_on_sphere_N"]
    assert_close(pressed, force_z)
    assert_close(friction, force_x)
    # Also row by row, down to the round-off of the gate 1 + tanh.
    np.testing.assert_allclose(pressed, force_z, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(friction, force_x, rtol=1e-9, atol=1e-12)
    # Contact at half the indentation, as seen from centre and from ground.
    assert_close(
        (radius - 0.5 * x) * friction,
        table["Mz_on_sphere_about_body_origin_Nm"],
    )


def test_sphere_on_a_moving_body(reference_root):
    modulus, radius, dissipation, _ = SETS["A"]
    table = read(reference_root, "smooth_sphere_planar_states_A")
    assert len(table) == 400
    angle, omega = table["rz_rad"], table["wz_radps"]
    c, s = np.cos(angle), np.sin(angle)
    # Centre of the sphere seen from the body's origin, world axes.
    arm_x = c * 0.17 + s * 0.054
    arm_z = s * 0.17 - c * 0.054
    origin_x, origin_z = table["tx_m"], table["ty_m"]
    wrench = sphere_wrench(
        "simbody",
        origin_x + arm_x,
        origin_z + arm_z,
        table["vx_mps"] - omega * arm_z,
        table["vy_mps"] + omega * arm_x,
        omega,
        modulus,
        dissipation,
        radius,
        constants_of("A"),
    )
    assert_close(wrench.force_x, table["Fx_on_body_N"])
    assert_close(wrench.force_z, table["Fy_on_body_N"])
    # Counter-clockwise moments about the body's and the world's origin.
    assert_close(
        (wrench.point_x - origin_x) * wrench.force_z
        - (wrench.point_z - origin_z) * wrench.force_x,
        table["Mz_on_body_about_body_origin_Nm"],
    )
    assert_close(
        wrench.point_z * wrench.force_x - wrench.point_x * wrench.force_z,
        table["Mz_on_halfspace_about_ground_origin_Nm"],
    )


@pytest.mark.parametrize("name", ["bushing_lin", "bushing_expr"])
def test_bushing(reference_root, name):
    table = read(reference_root, name)
    assert len(table) == 400

    def state(body, *columns):
        return np.array([table[f"b{body}_{column}"] for column in columns])

    pose_1, pose_2 = (state(b, "tx", "ty", "rz") for b in (1, 2))
    motion_1, motion_2 = (state(b, "vx", "vy", "wz") for b in (1, 2))
    # F2's place given as origin plus preload; OpenSim's y is our z.
    origin = (0.02, 0.25)
    preload = (0.015 - 0.02, 0.24 - 0.25, 0.05)
    deflection, rate = bushing_deflection(
        pose_1, motion_1, pose_2, motion_2, origin, preload
    )
    for value, column in (
        (deflection.normal, "dx_F1"),
        (deflection.tangential, "dy_F1"),
        (deflection.rotation, "dtheta"),
        (rate.normal, "ddx_F1"),
        (rate.tangential, "ddy_F1"),
        (rate.rotation, "ddtheta"),
    ):
        assert_close(value, table[column])
    force = bushing_force(
        deflection, rate, (5000.0, 2000.0, 50.0), (10.0, 10.0, 0.1)
    )
    wrench = bushing_wrench(force, pose_1, pose_2, origin, preload)
    assert_close(wrench.force_x, table["Fx_on_b1_G"])
    assert_close(wrench.force_z, table["Fy_on_b1_G"])
    assert_close(-wrench.force_x, table["Fx_on_b2_G"])
    assert_close(-wrench.force_z, table["Fy_on_b2_G"])
    for body, pose, sign, (x, z) in (
        (1, pose_1, 1.0, origin),
        (2, pose_2, -1.0, (0.015, 0.24)),
    ):
        # BushingForce reports moments about the bodies' origins, the
        # expression-based one about the bushing frames' origins.
        about_x, about_z = pose[0], pose[1]
        if name == "bushing_expr":
            c, s = np.cos(pose[2]), np.sin(pose[2])
            about_x = about_x + c * x - s * z
            about_z = about_z + s * x + c * z
        moment = wrench.moment + (
            (wrench.point_x - about_x) * wrench.force_z
            - (wrench.point_z - about_z) * wrench.force_x
        )
        assert_close(sign * moment, table[f"Mz_on_b{body}"])
