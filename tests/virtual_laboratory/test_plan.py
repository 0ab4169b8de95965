"""Plans against what mechanics asks of them, and their parts by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from drake_exo.contact.parameters import nominal_contact
from drake_exo.contact.strap import Assistance, Design
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import plan as planning
from drake_exo.virtual_laboratory.forces import chair_wrench
from drake_exo.virtual_laboratory.plan import (
    DeviceController,
    Friction,
    Planner,
    Posture,
    RisePlan,
    SubjectController,
    comes_in,
)

MODEL = nominal_model("coupled")
TREE = MODEL.rigid.tree
CONTACT = nominal_contact(MODEL).ground
SHORT = RisePlan(quiet_s=0.3, lean_s=0.5, rise_s=0.7, stand_s=0.3)


@pytest.fixture(scope="module")
def planner():
    return Planner(TREE, CONTACT)


@pytest.fixture(scope="module")
def seat(planner):
    return planner.seat(SHORT)


@pytest.fixture(scope="module")
def rise(planner, seat):
    return planner.movement(SHORT, seat)


@pytest.fixture(scope="module")
def squat(planner):
    upright = replace(SHORT, seated=Posture(shank=9.0, knee=14.0, trunk=2.0))
    return planner.movement(upright)


def lean(q):
    """Of shank, knee and trunk [degrees]."""
    ankle, knee, hip = (q[3:] - [q[2], 0.0, 0.0]).T
    return np.rad2deg([ankle, knee, ankle - knee + hip])


def test_who_sits_is_in_balance(planner, seat):
    """Gravity, the chair and a foot that is pressed at the plan's place."""
    q, share = planner._seated(SHORT)
    chair = chair_wrench(TREE, seat, q, 0.0 * q)
    (F_x, F_z), (moment,) = chair.force[0], chair.moment
    assert 0.4 < share < 0.9
    assert F_z == pytest.approx(share * TREE.weight, rel=0.05)  # smoothed
    com = TREE.center_of_mass(q)[0, 0]
    # Moments about where the foot is pressed; M_y = z F_x - x F_z.
    to_chair = -moment / F_z - SHORT.cop_m
    assert share * to_chair == pytest.approx(com - SHORT.cop_m)
    assert F_x == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(lean(q[0]), [16.0, 96.0, 4.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("movement", ["rise", "squat"])
def test_what_bears_a_plan_moves_its_centre_of_mass(movement, request):
    """The sum of all forces is m (a + g), its moment the work of torques."""
    made = request.getfixturevalue(movement)
    force = made.ground.array + made.chair.array
    mass = TREE.weight / 9.81
    com = CubicSpline(made.times, TREE.center_of_mass(made.q))
    a = com(made.times, 2)
    inner = slice(3, -3)
    np.testing.assert_allclose(
        force[inner, 0], (mass * a[:, 0])[inner], atol=2.0
    )
    np.testing.assert_allclose(
        force[inner, 1], (mass * a[:, 1] + TREE.weight)[inner], atol=2.0
    )
    # From rest to rest.
    np.testing.assert_allclose(made.v[[0, -1], 3:], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        made.v[inner], np.gradient(made.q, made.times, axis=0)[inner], atol=0.03
    )


@pytest.mark.parametrize("movement", ["rise", "squat"])
def test_at_rest_torques_hold_what_gravity_asks(movement, request):
    made = request.getfixturevalue(movement)
    plant = nominal_model("rigid").plant()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, made.q[-1])
    held = -plant.CalcGravityGeneralizedForces(context)[3:]
    np.testing.assert_allclose(made.moments[-1], held, atol=1e-9)


def test_a_rise_goes_by_its_times(rise, seat):
    """Sits, leans until the chair is free, rises, stands."""
    np.testing.assert_allclose(rise.times, np.linspace(0.0, 1.8, 91))
    share = rise.chair.force_z / TREE.weight
    first = share[0]
    assert 0.4 < first < 0.9
    # Seat-off between 35 and 100 % of the lean, half of it in the middle.
    at = np.interp([0.3, 0.3 + 0.675 * 0.5, 0.8], rise.times, share)
    assert at[0] == pytest.approx(first, abs=0.03)
    assert at[1] == pytest.approx(0.5 * first, abs=0.06)
    assert at[2] == pytest.approx(0.0, abs=1e-7)
    assert np.abs(share[rise.times > 0.95]).max() < 0.005
    cop = rise.ground.cop_x
    assert np.sqrt(np.mean((cop - SHORT.cop_m) ** 2)) < 0.006
    np.testing.assert_allclose(lean(rise.q[0]), [16.0, 96.0, 4.0], atol=0.7)
    np.testing.assert_allclose(lean(rise.q[-1]), [6.0, 2.0, 0.0], atol=1.5)
    i = np.argmin(np.abs(rise.times - 0.8))
    np.testing.assert_allclose(lean(rise.q[i]), [20.0, 92.0, 42.0], atol=12.0)


def test_a_squat_goes_down_and_up_again(squat):
    assert not squat.chair.array.any()
    np.testing.assert_allclose(squat.times, np.linspace(0.0, 1.8, 91))
    cop = squat.ground.cop_x
    assert np.sqrt(np.mean((cop - SHORT.cop_m) ** 2)) < 0.006
    np.testing.assert_allclose(lean(squat.q[0]), [9.0, 14.0, 2.0], atol=1.5)
    knee = np.rad2deg(squat.q[:, 4])
    assert squat.times[knee.argmax()] == pytest.approx(0.8, abs=0.1)
    assert knee.max() == pytest.approx(92.0, abs=8.0)
    # The foot is where the whole weight at rest presses it.
    np.testing.assert_allclose(squat.q[:, :3] - squat.q[0, :3], 0.0, atol=1e-9)


def test_who_stands_has_the_mass_over_the_pressure(planner):
    stood = planner.standing(2.0, 0.03)
    np.testing.assert_allclose(stood.times, np.linspace(0.0, 2.0, 11))
    com = TREE.center_of_mass(stood.q)[:, 0]
    np.testing.assert_allclose(com, 0.03, atol=5e-4)
    np.testing.assert_allclose(stood.ground.force_z, TREE.weight)
    cop = stood.ground.cop_x
    np.testing.assert_allclose(cop, com, atol=1e-6)
    _, knee, trunk = lean(stood.q[0])
    assert (knee, trunk) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-9))
    assert not stood.v.any() and not stood.chair.array.any()


def test_a_template_goes_from_posture_to_posture():
    plan = RisePlan(
        Posture(10.0, 90.0, 0.0),
        Posture(20.0, 80.0, 40.0),
        Posture(4.0, 0.0, 0.0),
        quiet_s=1.0,
        lean_s=2.0,
        rise_s=4.0,
        stand_s=1.0,
    )
    assert plan.duration == 8.0
    # Still, half leant, leant, half risen, risen; a foot of 1 degree.
    times = np.array([0.5, 2.0, 3.0, 5.0, 7.5])
    angles, sigma = planning._template(plan, times, np.deg2rad(np.ones(5)))
    np.testing.assert_allclose(
        np.rad2deg(angles),
        [
            [11.0, 90.0, 80.0],
            [16.0, 85.0, 90.0],
            [21.0, 80.0, 100.0],
            [13.0, 40.0, 48.0],
            [5.0, 0.0, -4.0],
        ],
        atol=1e-9,
    )
    # A quarter of the way in time, 10.35 % in place (10 s³ - 15 s⁴ + 6 s⁵).
    (row,), _ = planning._template(plan, np.array([1.5]), np.zeros(1))
    assert np.rad2deg(row[0]) == pytest.approx(10.0 + 10.0 * 0.103515625)
    np.testing.assert_allclose(np.rad2deg(sigma), [0.3, 8.0, 8.0, 8.0, 0.3])


def test_a_basis_rests_at_both_ends_and_can_be_constant():
    basis = planning._basis(1.3)
    times = np.linspace(0.0, 1.3, 200)
    B = basis(times)
    np.testing.assert_allclose(B.sum(axis=1), 1.0)
    for k in (1, 2):
        at_ends = basis.derivative(k)([0.0, 1.3])
        np.testing.assert_allclose(at_ends, 0.0, atol=1e-9)
    # Knots every 0.1 s, of degree 5; two coefficients fewer at either end.
    assert B.shape[1] == 13 + 5 - 4
    assert ((B > 1e-12).sum(axis=1) <= 6).all()
    inner = basis.derivative(5)(0.1 * np.arange(13) + 0.05)
    assert (np.abs(np.diff(inner, axis=0)).max(axis=1) > 0.0).all()


def test_differences_by_groups_are_those_one_by_one():
    """As many coefficients at a time as do not meet at any node."""
    times = np.linspace(0.0, 1.3, 66)
    B = planning._basis(1.3)(times)

    def residuals(x):
        angles = B @ x.reshape(-1, 3)
        a, b, c = angles.T
        return np.column_stack([a * b, np.sin(c) + a, b * c**2, angles])

    x = np.random.default_rng(0).normal(size=3 * B.shape[1])
    J = planning._banded_differences(residuals, B != 0.0)(x)
    step = 1e-6
    for k, unit in enumerate(np.eye(len(x))):
        up, down = (residuals(x + s * step * unit) for s in (1, -1))
        np.testing.assert_allclose(
            J[:, k], (up - down).ravel() / (2 * step), atol=1e-4
        )


def test_help_comes_in_smoothly():
    found = comes_in(np.array([0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]), 0.5, 0.9)
    np.testing.assert_allclose(found, [0, 0, 5 / 32, 0.5, 27 / 32, 1, 1])


def test_a_factor_of_the_help_counts_the_movements_time():
    """From its begin to its end."""
    # Clamped cubic: the first and last coefficient at the ends, a quarter,
    # a half and a quarter of the others in the middle.
    ramp = Assistance((), (1.0, 1.0, 2.0, 3.0, 3.0), "movement")
    device = DeviceController(
        MODEL,
        (0.1, 0.1, 0.1),
        Friction(),
        Design(assistance={"exo_knee": ramp}),
        span=(2.0, 6.0),
    )
    plain = DeviceController(MODEL, (0.1, 0.1, 0.1), Friction())
    times = np.array([2.0, 4.0, 6.0])
    angles, load = np.tile([0.2, 1.0, 0.8], (3, 1)), np.full(3, TREE.weight)
    own, today = (
        d.help(times, angles, 0.0 * angles, load) for d in (device, plain)
    )
    np.testing.assert_allclose(own[:, 1] / today[:, 1], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(own[:, [0, 2]], today[:, [0, 2]])


def test_the_subject_knows_its_plan_at_all_times():
    """A cubic plan, between the table's rows and beyond its ends."""
    times = np.linspace(0.0, 1.0, 21)
    q = np.outer(times**3, np.arange(6.0))
    v = np.outer(3.0 * times**2, np.arange(6.0))
    nothing = np.zeros((21, 3))
    plan = Trial(
        *("plan", TREE.coordinates, times, q, v, 0.0 * v),
        PlanarWrench.of(nothing),
        moments=nothing,
    )
    names = MODEL.coordinates
    subject = SubjectController(names, plan, nothing)
    zero = np.zeros((4, len(names)))
    at = np.array([-0.3, 0.12345, 0.7, 4.0])
    error, rate, torque = subject.off(at, zero, zero)
    held = np.clip(at, 0.0, 1.0)
    factor = [3.0 - 2.0, 4.0, 5.0]  # the ankle without the foot's pitch
    np.testing.assert_allclose(error, np.outer(held**3, factor), atol=1e-5)
    np.testing.assert_allclose(rate, np.outer(3 * held**2, factor), atol=1e-5)
    assert not torque.any()
