"""Made-up data: noise of the size asked for, rises as they are described."""

from dataclasses import replace

import numpy as np
import pytest
from measured_trials import seen

from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.measurement.filters import low_pass
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import synthetic
from drake_exo.virtual_laboratory.forces import ground_wrench
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
    assert abs(cop.mean()) < 0.001
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
        trial.ground.force[3:-3], expected, atol=0.005 * tree.weight
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


def test_a_foot_bears_the_weight_over_the_drawn_balance():
    """The soles' own force, at rest: 833 N and so, under that point."""
    tree = nominal_model("human").tree
    settings = FootGroundSettings()
    contact = settings.contact(nominal_model("human").spheres)
    times = np.linspace(0.0, 1.0, 5)
    balance = np.array([0.05, 0.06, 0.07, 0.08, 0.06])
    foot = synthetic._standing(tree, contact, times, balance)
    values = {
        p.name: p.nominal
        for s in contact.ground.spheres
        for p in contact.fixed(s)
    }
    ground = contact.with_values(values).ground
    q = np.zeros((5, 6))
    q[:, :3] = foot
    borne = ground_wrench(tree, ground, q, 0.0 * q)
    np.testing.assert_allclose(borne.force_z, tree.weight)
    np.testing.assert_allclose(borne.cop_x, balance, atol=1e-7)


@pytest.mark.parametrize("kind", ["human", "coupled"])
def test_an_ankle_balances_the_body_over_a_foot_that_tips(kind):
    tree = nominal_model(kind).tree
    names = tree.coordinates
    q = np.zeros((3, tree.num_positions))
    q[:, :3] = [[0.0, 0.07, 0.0], [0.1, 0.07, 0.05], [-0.2, 0.1, -0.03]]
    q[:, names.index("knee")] = 0.9, 0.5, 0.1
    q[:, names.index("hip")] = 0.7, 0.5, 0.2
    kept = q[:, [0, 1, 2, 4, 5]].copy()
    balance = np.array([0.04, 0.06, 0.05])
    lag = np.outer([0.01, 0.02, 0.0], np.ones(len(names.device)))
    synthetic._balance(tree, q, balance, lag)
    ahead = tree.center_of_mass(q)[:, 0] - q[:, 0]
    np.testing.assert_allclose(ahead, balance, atol=1e-6)
    np.testing.assert_array_equal(q[:, [0, 1, 2, 4, 5]], kept)
    if names.device:
        body = names.aligned(q[:, names.body_columns])
        off = q[:, names.device_columns] - body[:, names.device_columns]
        np.testing.assert_allclose(off, lag, atol=1e-6)


def test_a_rise_begins_with_the_ankle_a_millimetre_in_the_ground():
    model = nominal_model("coupled")
    trial = synthetic.draw(model.tree, Rise("one"))
    moved = synthetic._on_ground(trial, model)
    up = moved.q - trial.q
    z = model.coordinates.index("foot_z")
    assert moved.q[0, z] == pytest.approx(model.human.ankle_height_m - 0.001)
    np.testing.assert_allclose(up[:, z], up[0, z])
    up[:, z] = 0.0
    assert not up.any()


def test_noise_comes_from_a_longer_recording():
    """White at the movement's rate; a second before and after is cut off."""
    for rate in (100.0, 50.0):
        times = 3.0 + np.arange(round(2 * rate) + 1) / rate
        rng = np.random.default_rng(0)
        found = synthetic._smooth(rng, times, [1.0, 3.0], 6.0)
        assert found.shape == (len(times), 2)
        np.testing.assert_allclose(found.std(axis=0), [1.0, 3.0])
        white = np.random.default_rng(0).standard_normal(
            (len(times) + 2 * round(rate), 2)
        )
        kept = low_pass(white, rate, 6.0, 4, "noise")[round(rate) :][
            : len(times)
        ]
        for k in (0, 1):
            assert np.corrcoef(found[:, k], kept[:, k])[0, 1] > 1.0 - 1e-9


def test_true_cuffs_are_moved_from_the_models_own(monkeypatch):
    """Origins by the table's offsets; stiffnesses as it says."""
    seen = {}

    class CaughtError(Exception):
        pass

    class Problem:
        def __init__(self, model, drawn, contact, mats, settings):
            seen.update(model=model, contact=contact, drawn=drawn)
            raise CaughtError

    monkeypatch.setattr(synthetic, "_PassiveDevice", Problem)
    with pytest.raises(CaughtError):
        synthetic.rises_in_device(2, nodes_per_second=40)
    found = seen["contact"].bushings
    table = {  # offset [m], then stiffnesses
        "shank": (0.01, 0.03, 1500.0, 4000.0, 30.0),
        "thigh": (-0.01, -0.02, 2500.0, 7000.0, 60.0),
        "pelvis": (0.02, 0.03, 3000.0, 6000.0, 80.0),
    }
    for cuff, (dx, dz, *stiffness) in table.items():
        x, z = seen["model"].cuffs[cuff]
        own = found[cuff]
        assert (own.origin_x, own.origin_z) == pytest.approx((x + dx, z + dz))
        assert own.stiffness == pytest.approx(tuple(stiffness))
    assert [t.name for t in seen["drawn"]] == ["rise1", "rise2"]


def test_exact_data_are_hardly_held_by_anything_else():
    """Energy, jerk and priors weigh next to nothing in such settings."""
    made = synthetic.RisesInDevice(nominal_model("coupled"), None, [], 50.0)
    usual, exact = made.settings(), made.exact_settings()
    assert usual.solver.nodes_per_second == 50.0
    assert usual.solver.tolerance == 1e-6 and exact.solver.tolerance == 1e-9
    assert exact.noise.energy_j > 100.0 * usual.noise.energy_j
    assert exact.noise.jerk >= 1e5  # m/s³ and rad/s³: no movement has more
    assert exact.prior_weight < 1e-6


def test_instruments_leave_what_they_are_said_to():
    """Markers of 0.3 mm and so, filtered: see the documentation's table."""
    noise = INSTRUMENT_NOISE
    assert noise.foot_m < 3e-4 and noise.angle_deg < 0.1
    # Encoders are twice as fine as markers, in place and speed.
    assert noise.exo_angle_deg == pytest.approx(0.5 * noise.angle_deg)
    assert noise.exo_velocity_deg_s == pytest.approx(0.5 * noise.velocity_deg_s)
    # Cuffs' energy and jerk hardly count.
    assert noise.energy_j >= 100.0
