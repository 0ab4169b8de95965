"""The foot settled at its contact carries the measured ground reaction."""

import numpy as np
import pytest

from drake_exo.collocation.initial_guess import settle_foot, straight_line
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.hunt_crossley import paper_stiffness
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
)
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates

TIMES = np.linspace(0.0, 1.5, 151)
WEIGHT = 800.0


def kernel_and_parameters(law, modulus, middle=()):
    """Of heel and toe, and of spheres (x, z, radius) between them."""
    k = paper_stiffness(modulus) if law == "paper" else modulus
    spheres = {
        "heel": ContactSphere(k, 1.5, -0.05, -0.06, 0.032),
        "toe": ContactSphere(1.2 * k, 2.0, 0.16, -0.055, 0.03),
    }
    for i, place in enumerate(middle):
        spheres[f"ball{i}"] = ContactSphere(0.8 * k, 1.0, *place)
    contact = ContactModel(GroundContact(law, spheres))
    parameters = np.array(list(contact.values().values()))
    return FootGroundKernel(contact.ground), parameters


def reaction(cop, force_x):
    load = WEIGHT * (1.0 + 0.1 * np.sin(4.0 * TIMES))
    return np.column_stack([force_x * load, load, -cop * load])


def missing(kernel, parameters, q, v, ground):
    """Relative difference of the law's forces; CoP in m."""
    rows = np.broadcast_to(parameters, (len(q), len(parameters)))
    x = np.hstack([q, v, 0.0 * ground, rows])
    law = kernel.wrench(x)
    force = (law[:, :2] - ground[:, :2]) / WEIGHT
    cop = law[:, 2] / law[:, 1] - ground[:, 2] / ground[:, 1]
    return np.column_stack([force, cop])


@pytest.mark.parametrize("law", ["simbody", "paper"])
@pytest.mark.parametrize("modulus", [1e6, 1e7, 5e7])
def test_contact_gives_the_ground_reaction(law, modulus):
    kernel, parameters = kernel_and_parameters(law, modulus)
    ground = reaction(0.06 + 0.04 * np.sin(3.0 * TIMES), 0.02)
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    off = np.abs(missing(kernel, parameters, q, v, ground))
    # Dissipation by the slow sinking is left to the solver.
    assert off.max() < 0.03
    assert off[:, 2].max() < 6e-3


@pytest.mark.parametrize("law", ["simbody", "paper"])
@pytest.mark.parametrize("modulus", [2e5, 1e6, 1e7, 5e7])
def test_foot_at_rest_is_exact(law, modulus):
    kernel, parameters = kernel_and_parameters(law, modulus)
    ground = reaction(0.06, 0.0)
    ground[:] = ground[:1]
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    assert np.abs(v).max() < 1e-9
    off = missing(kernel, parameters, q, v, ground)
    assert np.abs(off[:, :2]).max() < 1e-9
    assert np.abs(off[:, 2]).max() < 2e-4


@pytest.mark.parametrize("law", ["simbody", "paper"])
def test_foot_creeps_about_its_measured_place(law):
    kernel, parameters = kernel_and_parameters(law, 1e6)
    measured = np.tile([0.3, 0.07, 0.1], (len(TIMES), 1))
    ground = reaction(0.06 + 0.3 + 0.0 * TIMES, 0.1 * np.cos(TIMES))
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    assert q[:, 0].mean() == pytest.approx(0.3, abs=1e-6)
    assert np.ptp(q[:, 0]) > 1e-3
    drift = np.cumsum(0.5 * np.diff(TIMES) * (v[1:, 0] + v[:-1, 0]))
    assert np.allclose(np.diff(q[:, 0]).cumsum(), drift, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("middle", [(), [(0.05, -0.08, 0.03)]])
@pytest.mark.parametrize("law", ["simbody", "paper"])
def test_impossible_reactions_leave_a_finite_guess(law, middle):
    kernel, parameters = kernel_and_parameters(law, 1e6, middle)
    measured = np.tile([0.0, 0.07, 0.0], (len(TIMES), 1))
    ground = reaction(np.linspace(-0.3, 0.5, len(TIMES)), 3.0)
    ground[40:60, 1] = -50.0  # lifted, or a faulty plate
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    assert np.isfinite(q).all() and np.isfinite(v).all()
    assert np.abs(q[:, 2]).max() < 1.0


MIDDLES = {
    "below the ends": [(0.09, -0.06, 0.03)],
    "to rock on": [(0.05, -0.08, 0.03)],
    "in the air": [(0.05, -0.02, 0.03)],
    "two": [(0.02, -0.058, 0.032), (0.1, -0.056, 0.03)],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "modulus"),
    [
        ("simbody", 1e6),
        pytest.param("simbody", 5e7, marks=pytest.mark.slow),
        pytest.param("paper", 5e7, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("middle", MIDDLES.values(), ids=MIDDLES)
def test_foot_rests_on_more_than_two_spheres(law, modulus, middle):
    kernel, parameters = kernel_and_parameters(law, modulus, middle)
    ground = reaction(0.06, 0.0)
    ground[:] = ground[:1]
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    assert np.abs(v).max() < 1e-9
    off = missing(kernel, parameters, q, v, ground)
    assert np.abs(off[:, :2]).max() < 1e-9
    assert np.abs(off[:, 2]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("law", ["simbody", "paper"])
@pytest.mark.parametrize("name", ["below the ends", "two"])
def test_more_spheres_give_the_ground_reaction(law, name):
    kernel, parameters = kernel_and_parameters(law, 1e7, MIDDLES[name])
    ground = reaction(0.06 + 0.04 * np.sin(3.0 * TIMES), 0.02)
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    off = np.abs(missing(kernel, parameters, q, v, ground))
    assert off[:, :2].max() < 0.03
    assert off[:, 2].max() < 6e-3


@pytest.mark.slow
def test_a_third_sphere_that_bears_nothing_changes_nothing():
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    ground = reaction(0.06, 0.01)
    two, three = (
        settle_foot(
            *kernel_and_parameters("simbody", 1e6, middle),
            TIMES,
            measured,
            ground,
        )
        for middle in ((), MIDDLES["in the air"])
    )
    np.testing.assert_allclose(two, three, atol=2e-4)


def test_order_of_spheres_does_not_matter():
    kernel, parameters = kernel_and_parameters("simbody", 1e6)
    swapped = np.r_[parameters[5:], parameters[:5]]
    measured = np.tile([0.0, 0.07, 0.0], (len(TIMES), 1))
    ground = reaction(0.05 + 0.0 * TIMES, 0.01)
    first = settle_foot(kernel, parameters, TIMES, measured, ground)
    second = settle_foot(kernel, swapped, TIMES, measured, ground)
    assert np.allclose(first, second, atol=1e-12)


def test_straight_line_joins_the_ends_at_rest():
    names = Coordinates(("foot_x", "foot_z", "foot_pitch", "ankle"))
    ends = np.linspace([0.0, 0.07, 0.0, 0.3], [0.1, 0.08, 0.1, -0.2], 9)
    zero = np.zeros((9, 4))
    ground = PlanarWrench.of(np.ones((9, 3)))
    trial = Trial("rise", names, np.arange(9.0), ends, zero, zero, ground)
    times = np.linspace(0.0, 1.5, 61)
    line = straight_line(trial, times)
    assert (line.name, line.coordinates) == ("rise", names)
    assert line.duration == 1.5 and not line.ground.array.any()
    np.testing.assert_allclose(line.q[[0, -1]], ends[[0, -1]])
    np.testing.assert_allclose(line.q[30], 0.5 * (ends[0] + ends[-1]))
    assert not line.v[[0, -1]].any() and not line.a[[0, -1]].any()
    step = times[1]
    for x, derivative in ((line.q, line.v), (line.v, line.a)):
        slope = (x[2:] - x[:-2]) / (2 * step)
        np.testing.assert_allclose(slope, derivative[1:-1], atol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.35, -0.35])
def test_a_sole_that_is_turned_on_its_foot_turns_the_foot_back(turn):
    """Three spheres bear as before, the foot pitched by as much."""
    kernel, parameters = kernel_and_parameters(
        "simbody", 1e6, MIDDLES["below the ends"]
    )
    spheres = parameters.reshape(-1, 5).copy()
    place = (spheres[:, 2] + 1j * spheres[:, 3]) * np.exp(1j * turn)
    spheres[:, 2], spheres[:, 3] = place.real, place.imag
    ground = reaction(0.06, 0.0)
    ground[:] = ground[:1]
    measured = np.tile([0.01, 0.07, 0.1], (len(TIMES), 1))
    plain, _ = settle_foot(kernel, parameters, TIMES, measured, ground)
    found, _ = settle_foot(kernel, spheres.ravel(), TIMES, measured, ground)
    # The foot's pitch and height, and where the load is, make up for it.
    np.testing.assert_allclose(found[:, 2], plain[:, 2] - turn, atol=1e-9)
    np.testing.assert_allclose(found[:, 1], plain[:, 1], atol=1e-5)
