from dataclasses import replace

import numpy as np
import pytest

from drake_exo.contact.hunt_crossley import (
    LAWS,
    paper_stiffness,
    sphere_force,
    sphere_force_derivatives,
    sphere_wrench,
    sphere_wrench_derivatives,
)


def constants_of(law, dynamic=0.6, rounding=0.0):
    found = replace(LAWS[law](), static_friction=0.9, dynamic_friction=dynamic)
    return replace(found, friction_rounding=rounding) if rounding else found


def parameters(law, rng, n):
    modulus = rng.uniform(1e6, 1e7, n)
    dissipation = rng.uniform(0.0, 4.0, n)
    dissipation[: n // 10] = 0.0
    return [
        paper_stiffness(modulus) if law == "paper" else modulus,
        dissipation,
        rng.uniform(0.02, 0.05, n),
    ]


@pytest.mark.parametrize(
    ("law", "rounding"), [("paper", 0.0), ("simbody", 0.0), ("simbody", 0.4)]
)
@pytest.mark.parametrize("dynamic", [0.6, 0.9])
@pytest.mark.parametrize(
    "regime",
    {
        "in the air": (-0.05, -0.005, -0.6, 0.6, -0.3, 0.3),
        "touching": (-0.002, 0.002, -0.6, 0.6, -0.3, 0.3),
        "sticking": (0.0, 0.02, -0.1, 0.1, -0.01, 0.01),
        "sliding": (0.0, 0.02, -0.1, 0.1, 0.1, 1.0),
        "letting go": (0.0, 0.02, -1.0, -0.2, -0.3, 0.3),
    }.items(),
    ids=lambda item: item[0],
)
def test_force_derivatives(law, rounding, dynamic, regime, check_derivatives):
    rng = np.random.default_rng(11)
    n = 300
    low_x, high_x, low_rate, high_rate, low_slip, high_slip = regime[1]
    arguments = [
        rng.uniform(low_x, high_x, n),
        rng.uniform(low_rate, high_rate, n),
        rng.uniform(low_slip, high_slip, n),
        *parameters(law, rng, n),
    ]
    constants = constants_of(law, dynamic, rounding)
    force, jacobian = sphere_force_derivatives(law, *arguments, constants)
    assert jacobian.shape == (2, 6, n)
    expected = sphere_force(law, *arguments, constants)
    np.testing.assert_allclose(force, expected, rtol=1e-13, atol=1e-13)
    check_derivatives(
        lambda *a: np.array(sphere_force(law, *a, constants)),
        arguments,
        jacobian,
    )


@pytest.mark.parametrize("law", LAWS)
def test_wrench_derivatives(law, check_derivatives):
    rng = np.random.default_rng(12)
    n = 300
    arguments = [
        rng.uniform(-1.0, 1.0, n),
        rng.uniform(0.0, 0.06, n),
        rng.uniform(-0.3, 0.3, n),
        rng.uniform(-0.6, 0.6, n),
        rng.uniform(-3.0, 3.0, n),
        *parameters(law, rng, n),
    ]
    constants = constants_of(law)
    wrench, jacobian = sphere_wrench_derivatives(law, *arguments, constants)
    assert jacobian.shape == (4, 8, n)
    np.testing.assert_allclose(
        wrench, sphere_wrench(law, *arguments, constants), rtol=1e-12
    )
    check_derivatives(
        lambda *a: np.array(sphere_wrench(law, *a, constants)),
        arguments,
        jacobian,
    )


@pytest.mark.parametrize("law", LAWS)
def test_arguments_broadcast(law):
    rng = np.random.default_rng(13)
    k, c, r = (p[-1] for p in parameters(law, rng, 20))
    x = rng.uniform(-0.02, 0.02, (5, 1))
    slip = rng.uniform(-0.1, 0.1, 7)
    force, jacobian = sphere_force_derivatives(law, x, 0.1, slip, k, c, r)
    assert force[0].shape == force[1].shape == (5, 7)
    assert jacobian.shape == (2, 6, 5, 7)
    one, own = sphere_force_derivatives(law, x[3, 0], 0.1, slip[4], k, c, r)
    assert one[0] == force[0][3, 4]
    np.testing.assert_allclose(own[1], jacobian[1, :, 3, 4], rtol=1e-14)
    wrench, jacobian = sphere_wrench_derivatives(
        law, slip, r - x, 0.0, 0.0, 0.0, k, c, r
    )
    assert wrench.point_x.shape == wrench.point_z.shape == (5, 7)
    assert jacobian.shape == (4, 8, 5, 7)
