"""The foot settled at its contact carries the measured ground reaction."""

import numpy as np
import pytest

from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.contact.hunt_crossley import default_constants, paper_stiffness

TIMES = np.linspace(0.0, 1.5, 151)
WEIGHT = 800.0


def kernel_and_parameters(law, modulus):
    k = paper_stiffness(modulus) if law == "paper" else modulus
    parameters = np.array(
        [k, 1.5, -0.05, -0.06, 0.032, 1.2 * k, 2.0, 0.16, -0.055, 0.03]
    )
    return FootGroundKernel(law, default_constants(law)), parameters


def reaction(cop, force_x):
    load = WEIGHT * (1.0 + 0.1 * np.sin(4.0 * TIMES))
    return np.column_stack([force_x * load, load, -cop * load])


def missing(kernel, parameters, q, v, ground):
    """Relative difference of the law's forces; CoP in m."""
    rows = np.broadcast_to(parameters, (len(q), 10))
    x = np.hstack([q, v, 0.0 * ground, rows])
    law = kernel.evaluate(x, None) * [100.0, 100.0, 10.0]
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


def test_impossible_reactions_leave_a_finite_guess():
    kernel, parameters = kernel_and_parameters("simbody", 1e6)
    measured = np.tile([0.0, 0.07, 0.0], (len(TIMES), 1))
    ground = reaction(np.linspace(-0.3, 0.5, len(TIMES)), 3.0)
    ground[40:60, 1] = -50.0  # lifted, or a faulty plate
    q, v = settle_foot(kernel, parameters, TIMES, measured, ground)
    assert np.isfinite(q).all() and np.isfinite(v).all()
    assert np.abs(q[:, 2]).max() < 1.0


def test_order_of_spheres_does_not_matter():
    kernel, parameters = kernel_and_parameters("simbody", 1e6)
    swapped = np.r_[parameters[5:], parameters[:5]]
    measured = np.tile([0.0, 0.07, 0.0], (len(TIMES), 1))
    ground = reaction(0.05 + 0.0 * TIMES, 0.01)
    first = settle_foot(kernel, parameters, TIMES, measured, ground)
    second = settle_foot(kernel, swapped, TIMES, measured, ground)
    assert np.allclose(first, second, atol=1e-12)
