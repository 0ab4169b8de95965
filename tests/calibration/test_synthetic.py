"""Made-up data: noise of the size asked for, rises as they are described."""

from dataclasses import replace

import numpy as np
import pytest
from measured_trials import seen

from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import synthetic
from drake_exo.virtual_laboratory.synthetic import INSTRUMENT_NOISE, Rise


def test_noise_is_as_large_as_it_is_asked_to_be():
    """Of every signal by itself; that of velocities is its derivative."""
    trial = seen(n=401, duration=4.0)
    noise = replace(
        INSTRUMENT_NOISE,
        angle_deg=0.5,
        exo_angle_deg=0.2,
        foot_m=0.003,
        foot_pitch_deg=0.7,
        force_n=4.0,
        cop_m=0.002,
        moment_nm=5.0,
        exo_moment_nm=0.6,
        normal_force_n=1.5,
    )
    off = synthetic.noisy(trial, 3, noise)
    dq = off.q - trial.q
    degrees = np.rad2deg(dq.std(axis=0))
    np.testing.assert_allclose(dq[:, :2].std(axis=0), 0.003, rtol=1e-6)
    np.testing.assert_allclose(degrees[2], 0.7, rtol=1e-6)
    np.testing.assert_allclose(degrees[3:6], 0.5, rtol=1e-6)
    np.testing.assert_allclose(degrees[6:], 0.2, rtol=1e-6)
    inner = slice(5, -5)
    h = trial.times[1] - trial.times[0]
    dv = np.gradient(dq, h, axis=0)
    size = np.abs(dv).max(axis=0)
    assert (np.abs(off.v - trial.v - dv)[inner] < 0.1 * size).all()
    da = np.gradient(dv, h, axis=0)
    size = np.abs(da).max(axis=0)
    assert (np.abs(off.a - trial.a - da)[inner] < 0.3 * size).all()
    force = off.ground.force - trial.ground.force
    np.testing.assert_allclose(force.std(axis=0), 4.0, rtol=1e-6)
    cop = off.ground.cop_x - trial.ground.cop_x
    assert cop.std() == pytest.approx(0.002, rel=1e-6)
    moments = (off.moments - trial.moments).std(axis=0)
    np.testing.assert_allclose(moments, [5.0] * 3 + [0.6] * 3, rtol=1e-6)
    normal = off.cuffs["thigh"].normal - trial.cuffs["thigh"].normal
    assert normal.std() == pytest.approx(1.5, rel=1e-6)
    # Smooth: nothing beyond the filter's cut-off of 6 Hz.
    power = np.abs(np.fft.rfft(dq[:, 4] * np.hanning(len(dq)))) ** 2
    frequency = np.fft.rfftfreq(len(dq), h)
    assert power[frequency > 15.0].sum() < 1e-3 * power.sum()


def test_the_same_seed_gives_the_same_noise():
    one, two, other = (
        synthetic.noisy(seen(), seed, INSTRUMENT_NOISE) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.q, two.q)
    assert np.abs(one.q - other.q).max() > 0.0


@pytest.mark.parametrize("kind", ["human", "coupled"])
def test_a_rise_is_drawn_as_it_is_described(kind):
    tree = nominal_model(kind).tree
    rise = Rise("one", 1.2, (85.0, 3.0), (90.0, 6.0), (0.05, 0.09, 0.06), 3.0)
    trial = synthetic.draw(tree, rise)
    assert trial.duration == pytest.approx(1.2)
    for joint, ends in (("knee", (85.0, 3.0)), ("hip", (90.0, 6.0))):
        angle = np.rad2deg(trial.coordinate(joint))
        np.testing.assert_allclose(angle[[0, -1]], ends)
        # Half way is the mean of both ends.
        middle = angle[len(angle) // 2]
        assert middle == pytest.approx(np.mean(ends))
    x = tree.center_of_mass(trial.q)[:, 0]
    half = len(x) // 2
    np.testing.assert_allclose(x[[0, half, -1]], [0.05, 0.09, 0.06], atol=1e-6)
    # Newton for the whole body, by differences.
    h = trial.times[1] - trial.times[0]
    com = tree.center_of_mass(trial.q)
    acceleration = np.gradient(np.gradient(com, h, axis=0), h, axis=0)[3:-3]
    expected = tree.mass * (acceleration + np.array([0.0, 9.81]))
    np.testing.assert_allclose(
        trial.ground.force[3:-3], expected, atol=0.02 * tree.weight
    )
    if kind == "coupled":
        names = trial.coordinates
        lag = np.rad2deg(trial.q[half, 6:] - trial.q[half, 3:6])
        np.testing.assert_allclose(lag, [3.0, -1.5, 2.1], atol=1e-9)
        assert names.device == names.joints[3:]


def test_rises_differ_within_what_they_are_drawn_from():
    many = synthetic.rises(200, 1.1, seed=5)
    assert [r.name for r in many[:2]] == ["rise1", "rise2"]
    assert all(r.duration_s == 1.1 for r in many)
    knee = np.array([r.knee_deg for r in many])
    hip = np.array([r.hip_deg for r in many])
    balance = np.array([r.balance_m for r in many])
    for values, low, high in (
        (knee[:, 0], 75.0, 85.0),
        (knee[:, 1], 4.0, 10.0),
        (hip[:, 0] - knee[:, 0], 1.0, 9.0),
        (balance[:, 0], 0.04, 0.06),
        (balance[:, 1], 0.07, 0.09),
        (balance[:, 2], 0.05, 0.07),
    ):
        reach = high - low
        assert low <= values.min() < low + 0.1 * reach
        assert high - 0.1 * reach < values.max() <= high
    np.testing.assert_array_equal(hip[:, 1], knee[:, 1])
