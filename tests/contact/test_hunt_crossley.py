from dataclasses import replace

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from drake_exo.contact.hunt_crossley import (
    LAWS,
    PaperConstants,
    SimbodyConstants,
    contact_arm,
    friction_coefficient,
    gate,
    paper_stiffness,
    slip_speed,
    sphere_force,
    sphere_wrench,
)
from drake_exo.errors import InputError

MODULUS = 5e6
RADIUS = 0.032
USUAL_MODULI = (1e6, 3e6, 5e6, 1e7, 2e7, 4e7)


def stiffness(law, modulus=MODULUS):
    return paper_stiffness(modulus) if law == "paper" else modulus


def normal(law, x, x_dot=0.0, c=2.0, modulus=MODULUS, constants=None):
    return sphere_force(
        law, x, x_dot, 0.0, stiffness(law, modulus), c, RADIUS, constants
    )[0]


def slope(law, x, x_dot=0.0, c=2.0, modulus=MODULUS, constants=None):
    return normal(law, x + 1e-30j, x_dot, c, modulus, constants).imag / 1e-30


def test_stiffness_of_the_two_laws_describe_the_same_hertz_force():
    assert (2.0 * paper_stiffness(5e6)) ** 1.5 == pytest.approx(5e6)
    x = 0.02
    hertz = 4.0 / 3.0 * paper_stiffness(MODULUS) ** 1.5
    hertz *= np.sqrt(RADIUS) * x**1.5
    # Simbody's own form of it.
    k = 0.5 * MODULUS ** (2.0 / 3.0)
    assert hertz == pytest.approx(4.0 / 3.0 * k * x * np.sqrt(RADIUS * k * x))
    # Deep inside both gates are open: what is left is smoothing.
    assert normal("paper", x, c=0.0) == pytest.approx(hertz, rel=1e-3)
    assert normal("simbody", x, c=0.0) == pytest.approx(hertz, rel=0.02)


@pytest.mark.parametrize("modulus", USUAL_MODULI)
def test_paper_force_out_of_contact_is_small_with_a_slope(modulus):
    x = np.linspace(-0.05, 0.0, 5001)
    force = normal("paper", x, modulus=modulus)
    assert np.all(force > 0.0)
    assert np.max(force) < 0.475
    assert np.min(slope("paper", x, modulus=modulus)) > 2.9


def test_a_sharp_slope_gate_would_lose_the_slope():
    sharp = PaperConstants(slope_sharpness=300.0)
    x = np.linspace(-0.05, 0.0, 501)
    assert np.min(slope("paper", x, constants=sharp)) < 1.0


def test_simbody_force_out_of_contact_is_not_small():
    # 9 N at 5 mm clearance: the bound above belongs to the paper's law.
    assert normal("simbody", -0.005) == pytest.approx(9.0, abs=0.5)


@pytest.mark.parametrize("modulus", USUAL_MODULI)
def test_hertz_part_at_zero_indentation(modulus):
    without_slope = PaperConstants(slope_force=0.0)
    assert normal("paper", 0.0, modulus=modulus, constants=without_slope) < 0.02
    assert normal("paper", 0.0, modulus=modulus, constants=without_slope) > 0.0
    # 2 (3 F / (2 k^(3/2) sqrt(r)))^(2/3) leaves F.
    delta = 2.0 * 0.03 ** (2 / 3) / paper_stiffness(modulus) / np.cbrt(RADIUS)
    assert delta >= PaperConstants().indentation_smoothing
    at_the_rule = replace(without_slope, indentation_smoothing=delta)
    assert normal(
        "paper", 0.0, modulus=modulus, constants=at_the_rule
    ) == pytest.approx(0.02, rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("c", [0.0, 0.5, 2.0, 5.0])
def test_normal_force_grows_with_indentation(law, c):
    x = np.linspace(-0.05, 0.04, 3001)
    release = 2.0 / (3.0 * c) if c else 1.0
    for x_dot in (-0.9 * release, -0.1, 0.0, 0.3, 1.0):
        x_dot = max(x_dot, -0.9 * release)
        force = normal(law, x, x_dot, c)
        rise = slope(law, x, x_dot, c)
        assert np.all(force > 0.0), x_dot
        assert np.all(rise > 0.0), x_dot


@pytest.mark.parametrize("law", LAWS)
def test_no_dissipation_is_regular(law):
    x = np.linspace(-0.02, 0.02, 41)
    at_rest = normal(law, x, 0.0, 0.0)
    for x_dot in (-1.0, -0.3, 0.4):
        np.testing.assert_array_equal(normal(law, x, x_dot, 0.0), at_rest)
        np.testing.assert_allclose(
            normal(law, x, x_dot, 1e-9), at_rest, rtol=1e-8
        )
    by_c = normal(law, x, 0.3, 1e-30j).imag / 1e-30
    assert np.all(np.isfinite(by_c))
    hertz = at_rest
    if law == "paper":
        hertz = normal(
            law, x, 0.0, 0.0, constants=PaperConstants(slope_force=0.0)
        )
    np.testing.assert_allclose(by_c, 1.5 * 0.3 * hertz, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("c", [0.0, 0.5, 2.0, 5.0])
def test_fast_approach_pushes_more_than_fast_release(law, c):
    # Sufficient for passivity: (f(x, v) - f(x, 0)) v >= 0 at every depth.
    x = np.linspace(-0.03, 0.03, 61)[:, None]
    x_dot = np.linspace(-3.0, 3.0, 601)
    excess = normal(law, x, x_dot, c) - normal(law, x, 0.0, c)
    assert np.min(excess * x_dot) >= -1e-12
    if c:
        assert np.max(excess * x_dot) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("c", [0.0, 1.0, 5.0])
def test_closed_cycles_never_create_energy(law, c):
    rng = np.random.default_rng(3)
    time = np.linspace(0.0, 1.0, 2**15, endpoint=False)
    works = []
    for _ in range(20):
        x, x_dot = np.full_like(time, rng.uniform(-0.01, 0.01)), 0.0
        for harmonic in range(1, 5):
            a, b = rng.normal(scale=0.008 / harmonic, size=2)
            omega = 2.0 * np.pi * harmonic
            x = x + a * np.cos(omega * time) + b * np.sin(omega * time)
            x_dot = x_dot + omega * (
                b * np.cos(omega * time) - a * np.sin(omega * time)
            )
        # On the sphere: the force is upwards, -x_dot the upward velocity.
        works.append(-np.mean(normal(law, x, x_dot, c) * x_dot))
    if c:
        assert np.max(works) < 0.0
        assert np.min(works) < -1.0
    else:
        assert np.max(np.abs(works)) < 1e-8  # error of the quadrature


@pytest.mark.parametrize("law", LAWS)
def test_adhesion_is_bounded(law):
    constants = LAWS[law]()
    if law == "paper":
        constants = replace(constants, slope_force=0.0)
        sharpness = constants.damping_sharpness
    else:
        sharpness = constants.hunt_crossley_smoothing
    x = np.linspace(-0.01, 0.03, 9)[:, None]
    x_dot = np.linspace(-2.0, 0.0, 20001)
    for c in (0.5, 2.0, 5.0):
        # Without dissipation only the gated Hertz force is left.
        hertz = normal(law, x, 0.0, 0.0, constants=constants)
        ratio = normal(law, x, x_dot, c, constants=constants) / hertz
        bound = 0.21 * c / sharpness
        assert np.min(ratio) >= -bound
        assert np.min(ratio) < -0.95 * bound, "the bound should be sharp"


@pytest.mark.parametrize("law", LAWS)
def test_friction_takes_power_wherever_the_ground_pushes(law):
    x = np.linspace(-0.02, 0.02, 21)[:, None, None]
    x_dot = np.linspace(-1.0, 1.0, 801)[:, None]
    slip = np.linspace(-1.0, 1.0, 21)
    pressed, friction = sphere_force(
        law, x, x_dot, slip, stiffness(law), 2.0, RADIUS
    )
    power = friction * slip
    pushes = np.broadcast_to(pressed >= 0.0, power.shape)
    assert np.all(power[pushes] <= 0.0)
    assert np.min(power) < -10.0
    sticks = ~pushes
    assert np.any(sticks), "adhesion should occur in this grid"


@pytest.mark.parametrize("law", LAWS)
def test_friction_is_odd_and_zero_at_rest(law):
    slip = np.linspace(-0.5, 0.5, 101)
    friction = sphere_force(law, 0.01, 0.0, slip, stiffness(law), 2.0, RADIUS)[
        1
    ]
    assert friction[50] == 0.0
    np.testing.assert_allclose(friction, -friction[::-1], atol=1e-12)


def test_paper_friction_coefficient_is_the_printed_one():
    p = PaperConstants(
        static_friction=0.9,
        dynamic_friction=0.6,
        viscous_friction=0.0,
        transition_velocity=0.05,
    )

    def printed(ratio):
        def step5(t):
            return 10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5

        if ratio > 3.0:
            return 0.6
        if ratio >= 1.0:
            return 0.9 - 0.3 * step5((ratio - 1.0) / 2.0)
        return 0.9 * step5(ratio)

    ratios = np.linspace(0.0, 5.0, 501)
    mu = friction_coefficient("paper", 0.05 * ratios, p)
    np.testing.assert_allclose(mu, [printed(r) for r in ratios], atol=1e-14)
    assert np.argmax(mu) == 100  # v_rel = 1
    assert mu[100] == pytest.approx(0.9)
    np.testing.assert_allclose(mu[300:], 0.6, rtol=1e-12)
    # Twice differentiable: second differences fall with the step.
    fine = np.linspace(0.0, 4.0, 400001)
    second = np.diff(friction_coefficient("paper", 0.05 * fine, p), 2) / 1e-10
    assert np.max(np.abs(np.diff(second))) < 1e-2
    viscous = replace(p, viscous_friction=0.5)
    np.testing.assert_allclose(
        friction_coefficient("paper", 0.05 * ratios, viscous) - mu,
        0.5 * 0.05 * ratios,
        atol=1e-15,
    )


def test_paper_friction_has_no_slope_at_rest_but_the_viscous_one():
    def slope_at_rest(law, constants):
        pressed, friction = sphere_force(
            law, 0.01, 0.0, 1e-30j, stiffness(law), 2.0, RADIUS, constants
        )
        return friction.imag / 1e-30 / pressed.real

    frictionless = PaperConstants(viscous_friction=0.0)
    assert abs(slope_at_rest("paper", frictionless)) < 1e-5
    assert slope_at_rest("paper", PaperConstants()) == pytest.approx(
        -0.5, rel=1e-4
    )
    simbody = SimbodyConstants()
    assert slope_at_rest("simbody", simbody) == pytest.approx(
        -0.8 / 0.05 - 0.5, rel=1e-9
    )


def test_simbody_friction_coefficient_has_stribeck_shape():
    p = SimbodyConstants(
        static_friction=0.9, dynamic_friction=0.6, viscous_friction=0.0
    )
    ratio = np.linspace(0.0, 50.0, 5001)
    mu = friction_coefficient("simbody", 0.05 * ratio, p)
    assert np.argmax(mu) == 100
    assert mu[100] == pytest.approx(0.9)
    assert mu[-1] == pytest.approx(0.6, abs=1e-3)


def test_rounded_friction_has_no_corner_and_the_same_ends():
    sharp = SimbodyConstants(viscous_friction=0.0, transition_velocity=0.2)
    rounded = replace(sharp, friction_rounding=0.5)
    speed = np.linspace(0.0, 4.0, 4001)
    mu, mu_sharp = (
        friction_coefficient("simbody", speed, p) for p in (rounded, sharp)
    )
    assert mu[0] == 0.0
    assert (np.diff(mu) > 0.0).all()
    assert (mu <= mu_sharp).all()
    assert mu[-1] == pytest.approx(0.8, rel=1e-3)
    # At the corner: 0.8 (sqrt(4.25) - 0.5)/2.
    assert mu[200] == pytest.approx(0.4 * (np.sqrt(4.25) - 0.5))
    # Slopes jump by 0.8/0.2 where there is a corner.
    jumps = [np.abs(np.diff(m, 2)).max() / 1e-3 for m in (mu, mu_sharp)]
    assert jumps[0] < 0.02
    assert jumps[1] == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_wrench_uses_the_material_point_in_contact(law):
    x, omega = 0.006, 1.5
    z = RADIUS - x
    wrench = sphere_wrench(
        law, 0.17, z, 0.02, -0.1, omega, stiffness(law), 2.0, RADIUS
    )
    arm = RADIUS if law == "paper" else RADIUS - 0.5 * x
    assert contact_arm(law, x, RADIUS) == pytest.approx(arm)
    assert wrench.point_x == 0.17
    assert wrench.point_z == pytest.approx(-x if law == "paper" else -x / 2)
    # Toes going up drive the lowest point forwards.
    pressed, friction = sphere_force(
        law, x, 0.1, 0.02 + omega * arm, stiffness(law), 2.0, RADIUS
    )
    assert wrench.force_z == pytest.approx(pressed)
    assert wrench.force_x == pytest.approx(friction)
    assert friction < 0.0
    # The two points move the CoP by (x/2) F_x/F_z.
    assert 0.5 * x * friction / pressed == pytest.approx(-0.0025, abs=3e-5)


@pytest.mark.parametrize("law", LAWS)
def test_every_scalar_type_gives_the_same_force(law):
    rng = np.random.default_rng(5)
    n = 24
    values = [
        rng.uniform(-0.02, 0.02, n),
        rng.uniform(-0.6, 0.6, n),
        rng.uniform(-0.3, 0.3, n),
        stiffness(law) * rng.uniform(0.5, 1.5, n),
        np.where(np.arange(n) % 3 == 0, 0.0, rng.uniform(0.0, 3.0, n)),
        rng.uniform(0.02, 0.05, n),
    ]
    constants = replace(LAWS[law](), static_friction=0.9, dynamic_friction=0.6)
    expected = sphere_force(law, *values, constants)
    autodiff = [
        np.array([AutoDiffXd(v, np.eye(6)[i]) for v in column])
        for i, column in enumerate(values)
    ]
    variables = [Variable(f"a{i}") for i in range(6)]
    symbolic = sphere_force(law, *(Expression(v) for v in variables), constants)
    for output in range(2):
        differentiated = sphere_force(law, *autodiff, constants)[output]
        np.testing.assert_allclose(
            [f.value() for f in differentiated],
            expected[output],
            rtol=1e-12,
            atol=1e-11,
        )
        evaluated = [
            symbolic[output].Evaluate(
                {
                    v: column[j]
                    for v, column in zip(variables, values, strict=True)
                }
            )
            for j in range(n)
        ]
        np.testing.assert_allclose(
            evaluated, expected[output], rtol=1e-12, atol=1e-11
        )
        for i in range(6):
            stepped = list(values)
            stepped[i] = stepped[i] + 1e-30j
            by_step = sphere_force(law, *stepped, constants)[output].imag
            np.testing.assert_allclose(
                [f.derivatives()[i] for f in differentiated],
                by_step / 1e-30,
                rtol=1e-9,
                atol=1e-9,
            )


def test_gate_and_slip_speed_are_between_their_limits():
    assert gate(300.0, 0.0) == 0.5
    np.testing.assert_allclose(gate(300.0, np.array([-1.0, 1.0])), [0.0, 1.0])
    assert slip_speed("paper", 0.0, PaperConstants()) == 1e-5
    assert slip_speed("simbody", 0.0, SimbodyConstants()) == np.sqrt(1e-5)


def test_unknown_law_and_foreign_constants_are_refused():
    with pytest.raises(InputError, match="use 'paper' or 'simbody'"):
        sphere_force("hertz", 0.0, 0.0, 0.0, 1e4, 2.0, 0.03)
    with pytest.raises(InputError, match="'paper' needs PaperConstants"):
        sphere_force("paper", 0.0, 0.0, 0.0, 1e4, 2.0, 0.03, SimbodyConstants())
