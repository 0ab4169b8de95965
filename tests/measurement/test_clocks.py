"""Clocks of encoders and mats, of a device that hangs in its cuffs."""

import numpy as np
import pytest
from synthetic_recording import motion, step

from drake_exo.contact.bushing import NORMAL, BushingKinematics
from drake_exo.measurement.clocks import (
    cuff_deflections,
    encoder_delay,
    mat_delay,
)
from drake_exo.measurement.exoskeleton import Signal
from drake_exo.measurement.filters import derivatives
from drake_exo.model.description import fit_exoskeleton
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human

TIME = np.arange(300) / 100.0
STIFFNESS = np.array(
    [[1500.0, 4000.0, 40.0], [2000.0, 5000.0, 50.0], [2500.0, 6000.0, 60.0]]
)
REACH = 0.05


@pytest.fixture(scope="module")
def model():
    human = scale_human(70.0, 1.75)
    return Model("coupled", human, fit_exoskeleton(human))


def no_drive(_, q, v, a):
    return np.zeros((len(q), 3))


@pytest.fixture(scope="module")
def worn(model):
    """Human q, v, a, and the device's angles in balance with its cuffs."""
    seated, upright = motion(np.array([0.0, 3.0]), model.human)
    q = seated + step(TIME, 0.6, 2.2)[:, None] * (upright - seated)
    human = (q, *derivatives(TIME, q))
    exo = q[:, 3:].copy()
    # The deflection's own acceleration is small and left out.
    v, a = (np.hstack([x, x[:, 3:]]) for x in human[1:])

    def excess(angles):
        nine = np.hstack([q, angles])
        _, Q = cuff_deflections(model, nine)
        demand = model.tree.inverse_dynamics(nine, v, a)[:, 6:]
        return demand - np.einsum("njck,ck->nj", Q, STIFFNESS)

    for _ in range(8):
        r, J = excess(exo), np.empty((len(q), 3, 3))
        for i in range(3):
            moved = exo.copy()
            moved[:, i] += 1e-6
            J[:, :, i] = (excess(moved) - r) / 1e-6
        exo = exo - np.linalg.solve(J, r[:, :, None])[:, :, 0]
    assert np.abs(excess(exo)).max() < 1e-6
    assert np.rad2deg(np.abs(exo - q[:, 3:]).max()) > 2.0
    return human, exo


def encoders(exo, late):
    return Signal(TIME + late, exo, "encoders")


@pytest.mark.parametrize("late", [-0.021, 0.0, 0.017])
def test_encoders_are_timed_by_the_device_itself(model, worn, late):
    human, exo = worn
    found, explained = encoder_delay(
        TIME, human, encoders(exo, late), no_drive, model, REACH
    )
    assert found == pytest.approx(late, abs=0.002)
    assert explained > 0.99


def test_known_moments_of_the_device_are_taken_into_account(model, worn):
    """An assisted device: moments that its cuffs do not explain."""
    human, exo = worn
    late = 0.01

    def push(at, *_):
        return np.outer(step(at - late, 0.5, 1.0), [5.0, 20.0, 15.0])

    # A device pushed so by cuffs as before would need these on top.
    drive_only, _ = encoder_delay(
        TIME, human, encoders(exo, late), no_drive, model, REACH
    )
    _, spoilt = encoder_delay(
        TIME, human, encoders(exo, late), push, model, REACH
    )
    assert drive_only == pytest.approx(late, abs=0.0015)
    assert spoilt < 0.98  # moments that never acted do not fit


def test_noise_explains_nothing(model, worn):
    human, exo = worn
    rng = np.random.default_rng(0)
    wild = exo + np.cumsum(rng.normal(0.0, 0.05, exo.shape), axis=0)
    _, explained = encoder_delay(
        TIME, human, encoders(wild, 0.0), no_drive, model, REACH
    )
    assert explained < 0.8


@pytest.mark.parametrize("late", [-0.03, 0.012])
def test_mats_are_timed_by_the_cuffs(model, worn, late):
    human, exo = worn
    q = np.hstack([human[0], exo])
    d, _ = cuff_deflections(model, q)
    stiffening = (
        5000.0 * d[:, 1, NORMAL] * (1.0 + 200.0 * np.abs(d[:, 1, NORMAL]))
    )
    mats = [("thigh", TIME + late, stiffening)]
    # No cubic has this law, which costs 2 ms.
    found, explained = mat_delay(TIME, q, mats, model, REACH)
    assert found == pytest.approx(late, abs=0.003)
    assert explained > 0.99


def test_too_short_a_recording_tells_nothing(model, worn):
    human, exo = worn
    short = Signal(TIME[:25], exo[:25], "encoders")
    assert encoder_delay(TIME, human, short, no_drive, model, 0.1) == (0, 0)
    q = np.hstack([human[0], exo])
    mats = [("thigh", TIME[:25], exo[:25, 0])]
    assert mat_delay(TIME, q, mats, model, 0.1) == (0, 0)


def test_deflections_are_those_of_the_bushings(model, worn):
    human, exo = worn
    q = np.hstack([human[0], exo])
    d, Q = cuff_deflections(model, q)
    for i, name in enumerate(("shank", "thigh", "pelvis")):
        bushing = BushingKinematics(model.tree, name)
        origin = np.tile(model.human.cuff_m(name), (len(q), 1))
        terms = bushing.terms(q, origin)
        expected = bushing.deflection(q, terms)
        np.testing.assert_allclose(d[:, i], expected, atol=1e-12)
        J = bushing.deflection_jacobian(terms)[:, :, 6:]
        # The generalized force of unit stiffness is -d J.
        np.testing.assert_allclose(
            Q[:, :, i],
            -np.einsum("nk,nkj->njk", expected, J),
            atol=1e-12,
        )
