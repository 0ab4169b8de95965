"""Clocks of encoders and mats that a calibration finds."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from undrawn import undrawn

from benchmarks.seeds import _known
from drake_exo.calibration.audit import rmsd, spread
from drake_exo.calibration.clocks import (
    Clock,
    Timing,
    clock_checks,
    clocks_of,
    left,
    retimed,
    settle,
)
from drake_exo.calibration.error_model import NO_ERRORS, ErrorModel, ErrorSizes
from drake_exo.calibration.results import (
    Origin,
    read_calibration,
    read_trial,
)
from drake_exo.calibration.settings import Solver
from drake_exo.calibration.uncertainty import QUANTILE_95
from drake_exo.cli.predict import _summary
from drake_exo.contact.parameters import Posterior
from drake_exo.contact.reduction import SoleLaw, SoleSphere
from drake_exo.errors import InputError
from drake_exo.files.output import Verdict
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.report.gathering import clocks_table
from drake_exo.study import (
    Calibration,
    Prediction,
    Study,
    calibrate_interaction,
    find_clocks,
    predict,
)

LAGS = {"encoders": 0.03, "pressure": -0.02}


def recorded(trial, said=("encoders", "pressure"), **lags):
    """The trial with what the processing says of its clocks."""
    given = dict.fromkeys(("forces", "encoders", "pressure"), 0.0) | lags
    text = {system: "left to the calibration, unsure" for system in said}
    return replace(trial, provenance={"delays_s": given, "clocks": text})


def late(trial, encoders=0.0, pressure=0.0):
    """As instruments show it whose clocks lag, by shifted splines."""
    names, t = trial.coordinates, trial.times
    device = names.device_columns

    def shown(x, lag):
        return CubicSpline(t, x)(np.clip(t - lag, t[0], t[-1]))

    q, v, a, moments = (
        x.copy() for x in (trial.q, trial.v, trial.a, trial.moments)
    )
    for x in (q, v, a):
        x[:, device] = shown(x[:, device], encoders)
    cuffs = {
        c: CuffForce(shown(f.normal, pressure)) for c, f in trial.cuffs.items()
    }
    return replace(trial, q=q, v=v, a=a, moments=moments, cuffs=cuffs)


def known_of(trial, encoders, pressure, sd=0.004):
    names = (f"{trial.name}.encoder_clock", "other", f"{trial.name}.mat_clock")
    values = np.array([encoders, 7.0, pressure])
    return Posterior(names, values, np.diag([sd**2, 9.0, (3.0 * sd) ** 2]))


def test_a_clock_of_no_system_is_refused():
    with pytest.raises(InputError, match="no 'mats'; there are encoders, pres"):
        Clock("rise1", "mats", 0.0, 0.01)


def test_a_clock_is_what_was_taken_out_and_what_was_left(in_device):
    trial = recorded(in_device.trials[0], pressure=0.05)
    found = clocks_of([trial], known_of(trial, 0.03, -0.02))
    assert [c.system for c in found] == ["encoders", "pressure"]
    assert [c.lag_s for c in found] == pytest.approx([0.03, 0.03])
    assert [c.sd_s for c in found] == pytest.approx([0.004, 0.012])
    again = left(trial, found)
    assert again.names == tuple(
        f"{trial.name}.{c}" for c in ("encoder_clock", "mat_clock")
    )
    np.testing.assert_allclose(again.values, [0.03, -0.02])
    np.testing.assert_allclose(again.covariance, np.diag([16e-6, 144e-6]))
    # Of a trial that was not recorded nothing is told.
    assert clocks_of(in_device.trials, known_of(trial, 0.03, -0.02)) == []
    assert left(in_device.trials[0], []).names == ()


def test_a_trial_goes_on_the_clock_that_was_found(in_device):
    """By other splines; a torque that sets in is where it was."""
    trial = in_device.trials[0]
    names, t = trial.coordinates, trial.times
    moments, exo = trial.moments.copy(), trial.coordinates.is_device_joint
    moments[:, exo] = np.outer(np.tanh((t - 0.7) / 0.1), [1.0, -20.0, 12.0])
    true = replace(trial, moments=moments, friction=None)
    shown = late(true, encoders=0.03)
    spline = CubicSpline(t, moments[:, exo])
    seen = shown.moments.copy()
    seen[:, exo] = spline(np.clip(t - 0.03, t[0], None))
    change = seen[:, exo] - moments[:, exo]
    for column, device in zip(change.T, names.device, strict=True):
        seen[:, names.joint(names.follows(device))] -= column
    shown = recorded(replace(shown, moments=seen), encoders=0.01)
    found = retimed(shown, [Clock(trial.name, "encoders", 0.04, 0.004)])
    inside = (t > 0.1) & (t < t[-1] - 0.1)
    device = names.device_columns
    for part in ("q", "v", "a"):
        own, expected = (getattr(x, part)[inside] for x in (found, true))
        size = np.abs(expected[:, device]).max()
        np.testing.assert_allclose(own, expected, atol=3e-4 * size)
    np.testing.assert_allclose(
        found.moments[inside], moments[inside], atol=3e-3
    )
    off = np.abs(shown.moments - moments)[inside].max()
    assert off > 3.0  # before
    assert found.provenance["delays_s"]["encoders"] == 0.04
    assert found.provenance["delays_s"]["pressure"] == 0.0
    said = found.provenance["clocks"]
    assert said["encoders"] == "+40 ± 8 ms"
    assert said["pressure"] == "left to the calibration, unsure"
    assert retimed(shown, []) is shown
    mats = [Clock(trial.name, "pressure", 0.04, 0.004)]
    unready = late(shown, pressure=0.04)
    on_time = retimed(unready, mats)
    for cuff, force in trial.cuffs.items():
        own = on_time.cuffs[cuff].normal[inside]
        np.testing.assert_allclose(own, force.normal[inside], atol=0.02)
    np.testing.assert_array_equal(on_time.q, unready.q)
    vague = [Clock(trial.name, "encoders", 0.04, 0.01), *mats]
    assert retimed(shown, vague).provenance["clocks"] == {
        "encoders": "+40 ± 20 ms, unsure",
        "pressure": "+40 ± 8 ms",
    }
    # Of a trial made in Python nothing was taken out.
    bare = replace(shown, provenance={})
    own = [Clock(trial.name, "encoders", 0.03, 0.004)]
    np.testing.assert_allclose(retimed(bare, own).q, found.q)
    assert left(bare, own).values == pytest.approx([0.03])


def test_a_trial_on_its_clock_goes_on_another_without_what_is_around_it(
    in_device, tmp_path
):
    """Saved or resampled it has only its readings, which were shifted."""
    trial = recorded(in_device.trials[0])
    once, twice = (
        [
            Clock(trial.name, "encoders", encoders, 0.004),
            Clock(trial.name, "pressure", mats, 0.004),
        ]
        for encoders, mats in ((0.03, -0.03), (0.05, 0.01))
    )
    on_time, expected = retimed(trial, once), retimed(trial, twice)
    on_time.save(tmp_path / "once")
    inside = slice(10, -10)
    for shown in (
        Trial.load(tmp_path / "once"),
        on_time.sample(on_time.times),
        replace(on_time, around=None),
    ):
        assert shown.around is None
        again = retimed(shown, twice)
        assert again.provenance["shifted_s"] == pytest.approx(
            expected.provenance["shifted_s"]
        )
        np.testing.assert_allclose(
            again.q[inside], expected.q[inside], atol=1e-4
        )
        for cuff, force in expected.cuffs.items():
            own = again.cuffs[cuff].normal[inside]
            np.testing.assert_allclose(own, force.normal[inside], atol=0.05)
        # And once more: what is around it now is what it was.
        back = retimed(again, once)
        np.testing.assert_allclose(back.q, on_time.q, atol=1e-12)


def test_moments_of_a_device_model_go_with_its_encoders(in_device):
    """They are a function of what encoders showed, friction as well."""
    trial = in_device.trials[0]
    names, t = trial.coordinates, trial.times
    swing = np.outer(np.sin(3.0 * t), [1.0, -20.0, 12.0])
    moments = trial.moments.copy()
    moments[:, names.is_device_joint] = swing
    shown = recorded(replace(trial, moments=moments, friction=0.1 * swing))
    found = retimed(shown, [Clock(trial.name, "encoders", 0.03, 0.004)])
    inside = t < t[-1] - 0.1
    true = np.outer(np.sin(3.0 * (t + 0.03)), [1.0, -20.0, 12.0])[inside]
    own = found.moments[inside][:, names.is_device_joint]
    np.testing.assert_allclose(own, true, atol=2e-6)
    np.testing.assert_allclose(found.friction[inside], 0.1 * true, atol=2e-7)
    total = moments[:, ~names.is_device_joint] + swing @ names.turned_by
    kept = found.moments[:, ~names.is_device_joint][inside]
    np.testing.assert_allclose(
        kept + own @ names.turned_by, total[inside], atol=1e-9
    )
    # To first order likewise, as an unknown of the error model.
    errors = ErrorModel(in_device.model, [shown], ErrorSizes())
    k = errors.names.index(f"{trial.name}.encoder_clock")
    change = errors.effects(shown).moments[:, names.is_device_joint, k]
    np.testing.assert_allclose(
        0.001 * change[5:-5], (-0.003 * np.outer(
            np.cos(3.0 * t), [1.0, -20.0, 12.0]))[5:-5], atol=1e-4,
    )  # fmt: skip


def test_a_prediction_is_compared_on_the_clock_that_was_found(
    predicted, in_device
):
    trial = in_device.trials[0]
    shown = recorded(late(trial, encoders=0.03))
    clock = Clock(trial.name, "encoders", 0.03, 0.004)
    (own,) = predicted.trials
    values = {f.name: getattr(own, f.name) for f in fields(own)}
    found, unknown = (
        Prediction(**values, result=predicted, clocks=clocks)
        for clocks in ((clock,), ())
    )
    off, raw = (p.rmsd(shown)["angles_deg"]["exo_knee"] for p in
                (found, unknown))  # fmt: skip
    assert raw > 1.0 > 3.0 * off
    assert found.timed(trial) is trial  # nothing was recorded of its clocks
    other = replace(shown, name="another")
    assert found.timed(other).provenance == other.provenance


@pytest.mark.slow
def test_signals_are_spread_on_the_clocks_that_were_found(
    predicted, regular, in_device
):
    """Trials that differ by nothing but their clocks do not spread."""
    (own,) = predicted.trials
    values = {f.name: getattr(own, f.name) for f in fields(own)}
    shown, found = [], []
    for name, lag in (("early", -0.03), ("late", 0.03)):
        trial = recorded(late(in_device.trials[0], encoders=lag))
        shown.append(replace(trial, name=name))
        clocks = (Clock(name, "encoders", lag, 0.004),)
        named = values | {"name": name, "result": predicted, "clocks": clocks}
        found.append(Prediction(**named))
    study = Study(in_device.model, shown)
    spreads = (
        _summary(study, of, shown, None)["measured_sd"]["angles_deg"]
        for of in (found, [])
    )
    known, raw = (sd["exo_knee"] for sd in spreads)
    assert raw > 1.0 > 3.0 * known
    # Phase B's: of the trials that it is compared with.
    moved = [
        late(t, pressure=lag)
        for t, lag in zip(in_device.trials, (-0.03, 0.0, 0.03), strict=True)
    ]
    found = Calibration("interaction", study, regular)
    vars(found)["_measured"] = moved
    told = found.summary()["measured_sd"]
    assert told == spread(moved, in_device.model.tree)
    assert told != spread(in_device.trials, in_device.model.tree)


def test_a_clock_is_sure_if_it_is_known_to_ten_milliseconds():
    limit = 0.01 / QUANTILE_95
    assert Clock("rise", "encoders", 0.0, 0.999 * limit).sure
    assert not Clock("rise", "encoders", 0.0, 1.001 * limit).sure
    rows = [
        Clock("rise", "encoders", 0.0314, 0.002).summary(),
        Clock("rise", "pressure", -0.0062, 0.02).summary(),
    ]
    lines = clocks_table(rows).splitlines()
    assert lines[2].split() == ["rise,", "encoders", "+31", "±", "4"]
    assert lines[3].split() == ["rise,", "pressure", "-6", "±", "39", "unsure"]


def test_checks_tell_what_is_known_of_each_clock(in_device):
    trial = recorded(in_device.trials[0], encoders=0.03, pressure=0.02)
    found = [
        Clock(trial.name, "encoders", 0.031, 0.004),
        Clock(trial.name, "pressure", -0.01, 0.02),
    ]
    by = {c.where: c for c in clock_checks([trial], found)}
    good = by[f"{trial.name}, encoders"]
    assert good.holds and good.sentence == ""
    assert good.value == pytest.approx(4.0 * QUANTILE_95)
    assert (good.limit, good.unit, good.level) == (10.0, "ms", "note")
    bad = by[f"{trial.name}, pressure"]
    assert not bad.holds and bad.sentence == "-10 ± 39 ms"
    # As long as it is within its interval of the lag taken out, it is settled.
    raw = recorded(in_device.trials[0], encoders=0.024, pressure=-0.05)
    near, _, far = clock_checks([raw], found)[:3]
    assert len(clock_checks([raw], found)) == 3
    assert near.holds and not far.holds
    assert far.where == f"{trial.name}, pressure"
    assert (far.value, far.limit) == pytest.approx((40.0, 20.0 * QUANTILE_95))
    assert far.sentence == (
        "-10 ± 39 ms, but readings were shifted by -50 ms: a rough value; set "
        "pressure_delay_s of this trial to it, and run again"
    )
    unfound = clock_checks([trial])
    assert [c.holds for c in unfound] == [False, False]
    assert unfound[0].sentence == "left to the calibration, unsure"
    assert clock_checks([recorded(trial, said=())]) == []


def test_a_clock_that_the_study_gives_is_no_unknown(in_device):
    for said, expected in (
        (("encoders", "pressure"), ["encoder_clock", "mat_clock"]),
        (("pressure",), ["mat_clock"]),
        ((), []),
    ):
        trial = recorded(in_device.trials[0], said)
        names = ErrorModel(in_device.model, [trial], ErrorSizes()).names
        own = [n for n in names if n.startswith(trial.name)]
        assert own == [f"{trial.name}.{what}" for what in expected]
    # Nor is that of a system that recorded nothing.
    bare = replace(recorded(in_device.trials[0]), provenance={
        "delays_s": {"forces": 0.0}, "clocks": {}})  # fmt: skip
    names = ErrorModel(in_device.model, [bare], ErrorSizes()).names
    assert not [n for n in names if n.startswith(bare.name)]


def test_angles_that_no_encoder_showed_stay_where_they_are(in_device):
    """Moments recorded without encoders go on their clock alone."""
    trial = recorded(in_device.trials[0])
    said = trial.provenance | {"exoskeleton_angles": "as the human's"}
    trial = replace(trial, provenance=said)
    found = retimed(trial, [Clock(trial.name, "encoders", 0.04, 0.004)])
    np.testing.assert_array_equal(found.q, trial.q)
    assert np.abs(found.moments - trial.moments).max() > 0.2


def test_what_is_known_of_others_comes_beside():
    one = Posterior(("a", "b"), np.array([1.0, 2.0]), np.diag([4.0, 9.0]))
    one.covariance[0, 1] = one.covariance[1, 0] = 1.0
    both = one.beside(Posterior(("c",), np.array([3.0]), np.array([[16.0]])))
    assert both.names == ("a", "b", "c")
    np.testing.assert_array_equal(both.values, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(
        both.covariance, [[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 16.0]]
    )
    part = both.part(["c", "a"])
    assert part.names == ("c", "a")
    np.testing.assert_array_equal(part.covariance, np.diag([16.0, 4.0]))


@pytest.mark.slow
def test_a_calibration_is_compared_on_the_clocks_that_it_found(
    in_device, tmp_path
):
    """In its summary, its tables and what is written as measured."""
    shown = recorded(late(in_device.trials[0], encoders=0.03))
    sizes = replace(NO_ERRORS, encoder_clock_s=0.03)
    settings = in_device.settings(errors=sizes, solver=Solver(10.0))
    study = Study(in_device.model, [shown], interaction=settings)
    found = calibrate_interaction(study, [shown], in_device.contact)
    vars(found)["_audits"] = ()  # it need not simulate
    with undrawn():
        summary = found.write(tmp_path)
    (off,), (raw,) = found.rmsd(), [rmsd(found.trials[0], shown)]
    assert summary["rmsd"] == [off]
    for joint in ("exo_knee", "exo_hip"):
        own, other = (x["angles_deg"][joint] for x in (off, raw))
        assert other > 1.0 > 3.0 * own
    assert off["angles_deg"]["knee"] == raw["angles_deg"]["knee"]
    measured = read_trial(tmp_path, shown.name, "measured")
    (clock,) = found.clocks
    assert measured.provenance["delays_s"]["encoders"] == clock.lag_s
    np.testing.assert_allclose(measured.q, retimed(shown, [clock]).q)
    # What it was made of stays what was recorded.
    own = read_calibration(tmp_path).origin
    assert own.data == Origin.of("", study.model, [shown], Verdict(())).data


@pytest.fixture(scope="module")
def studied(in_device):
    """Phase B of two trials whose clocks lag, and a third one to predict."""
    trials = [recorded(late(t, **LAGS)) for t in in_device.trials]
    sizes = replace(NO_ERRORS, encoder_clock_s=0.03, mat_clock_s=0.03)
    settings = in_device.settings(errors=sizes)
    study = Study(in_device.model, trials, interaction=settings)
    study.prediction = replace(
        study.prediction, errors=sizes, solver=settings.solver
    )
    found = calibrate_interaction(study, trials[:2], in_device.contact)
    assert found.success
    return study, found


@pytest.mark.slow
def test_phase_b_finds_clocks_and_says_how_sure(studied):
    _, found = studied
    assert len(found.clocks) == 4
    for clock in found.clocks:
        off = clock.lag_s - LAGS[clock.system]
        assert abs(off) < 3.0 * clock.sd_s
        # Encoders are told, mats hardly.
        assert clock.sd_s < (0.015 if clock.system == "encoders" else 0.03)
    summary = found.summary()
    assert summary["clocks"] == [c.summary() for c in found.clocks]
    told = [c for c in summary["checks"] if c["name"] == "clocks"]
    assert [c["holds"] for c in told] == [c.sure for c in found.clocks]
    own = [n for n in found.posterior.names if n.endswith("_clock")]
    assert own == []  # no other trial has those


@pytest.mark.slow
def test_a_trial_to_predict_is_timed_with_known_cuffs(studied):
    study, cuffs = studied
    trial = study.trials()[2]
    own = find_clocks(study, [trial], cuffs)
    assert [c.system for c in own] == ["encoders", "pressure"]
    assert own[0].sd_s < 0.015
    for clock in own:
        assert abs(clock.lag_s - LAGS[clock.system]) < 3.0 * clock.sd_s
    predicted = predict(study, trial, cuffs)
    assert list(predicted.clocks) == own
    # The prediction counts with them.
    problem = predicted.result.problem
    k = problem.errors.names.index(f"{trial.name}.encoder_clock")
    mean, covariance = problem.errors.prior()
    (used,) = problem.trials
    assert used.provenance["delays_s"]["encoders"] == own[0].lag_s
    assert mean[k] == 0.0
    assert covariance[k, k] == pytest.approx(own[0].sd_s ** 2)
    given = [Clock(trial.name, "encoders", 0.01, 1e-4)]
    other = predict(study, trial, cuffs, clocks=given)
    assert other.clocks == tuple(given)
    # Cuffs that nobody calibrated time nothing.
    assert find_clocks(study, [trial], cuffs.result.contact) == []


def test_clocks_are_found_on_the_study_s_sole(in_device, monkeypatch):
    spheres = {"heel": SoleSphere(2e7, x_m=-0.1), "toe": SoleSphere(2e7)}
    law = SoleLaw((0.26, 0.1, 0.02), spheres)
    trial = recorded(in_device.trials[0])
    study = Study(in_device.model, [trial], sole=law)
    known = replace(in_device.contact, posterior=known_of(trial, 0.0, 0.0))
    seen = []

    def stopped(model, trials, contact, settings, solved):
        seen.append(contact.ground)
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_exo.study.Timing", stopped)
    for find in (find_clocks, lambda s, t, c: predict(s, t[0], c)):
        with pytest.raises(KeyboardInterrupt):
            find(study, [trial], known)
    assert seen == [study.ground] * 2


def test_a_lag_that_was_taken_out_still_counts_for_its_prior(in_device):
    """30 ms are as likely before readings are shifted by them as after."""
    trial = recorded(in_device.trials[0])
    sizes = replace(NO_ERRORS, encoder_clock_s=0.02, mat_clock_s=0.05)
    own = [
        Clock(trial.name, "encoders", 0.03, 0.004),
        Clock(trial.name, "pressure", -0.01, 0.004),
    ]
    errors = ErrorModel(in_device.model, [retimed(trial, own)], sizes)
    mean, covariance = errors.prior()
    np.testing.assert_allclose(mean, [-0.03, 0.01])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.02, 0.05])


def test_noise_does_not_shorten_a_lag(in_device):
    """Rates are told by solutions, not by readings with their noise."""
    true = in_device.trials[0]
    rng = np.random.default_rng(0)
    noise = 3.0 * rng.standard_normal(len(true.times))
    cuffs = {
        c: replace(f, normal=f.normal + noise) for c, f in true.cuffs.items()
    }
    v = true.v + 0.2 * noise[:, None]
    shown = recorded(replace(true, v=v, cuffs=cuffs))
    model, sizes = in_device.model, ErrorSizes()
    exact, near, raw = (
        ErrorModel(model, [shown], sizes, solved=solved).effects(at)
        for solved, at in (((), true), ((true,), shown), ((), shown))
    )
    for name in ("q", "v"):
        own, expected = getattr(near, name), getattr(exact, name)
        clocks = [-2, -1]
        np.testing.assert_allclose(
            own[..., clocks], expected[..., clocks], atol=1e-12
        )
    for cuff, by in exact.normal.items():
        told = near.normal[cuff][:, -1]
        np.testing.assert_allclose(told, by[:, -1], atol=1e-9)
        assert np.std(raw.normal[cuff][:, -1]) > 1.5 * np.std(by[:, -1])


def test_lags_that_do_not_settle_are_not_sure(in_device, monkeypatch):
    """Each pass moves them by 30 ms: they may be as far off."""
    trials = [recorded(in_device.trials[0])]
    model, sizes = in_device.model, ErrorSizes()
    solution = SimpleNamespace(iterations=2, seconds={})
    result = SimpleNamespace(success=True, trials=trials, solution=solution)
    posed = []

    def pose(trials, solved):
        posed.append(trials[0])
        errors = ErrorModel(model, trials, sizes, solved=solved)
        return SimpleNamespace(errors=errors, solve=lambda **_: result)

    def posterior(_):
        return known_of(trials[0], 0.03 if len(posed) < 9 else 0.0, 0.0)

    monkeypatch.setattr("drake_exo.calibration.clocks.posterior", posterior)
    _, found = settle(trials, pose, "time")
    assert len(posed) == 6
    lags = [t.lags_s["encoders"] for t in posed]
    np.testing.assert_allclose(lags, 0.03 * np.arange(6))
    encoders, mats = found
    assert encoders.lag_s == pytest.approx(0.18) and not encoders.sure
    assert encoders.sd_s == pytest.approx(np.hypot(0.004, 0.03))
    assert mats.sd_s == pytest.approx(0.012)
    # Two passes at least: the first one has rates with noise.
    posed[:] = posed * 2
    _, found = settle(trials, pose, "time")
    assert len(posed) == 14 and found[0].sd_s == pytest.approx(0.004)


@pytest.mark.slow
def test_a_lag_beyond_the_first_order_is_found(in_device):
    """Of 80 ms, what is linear in the lag tells 55 to 68."""
    lags = {"encoders": 0.08, "pressure": -0.06}
    trials = [recorded(late(t, **lags)) for t in in_device.trials[:2]]
    sizes = replace(NO_ERRORS, encoder_clock_s=0.1, mat_clock_s=0.1)
    settings = in_device.settings(errors=sizes)
    study = Study(in_device.model, trials, interaction=settings)
    found = calibrate_interaction(study, trials, in_device.contact)
    assert found.success
    for clock in found.clocks:
        off = abs(clock.lag_s - lags[clock.system])
        assert off < max(3.0 * clock.sd_s, 0.005)
        assert off < 0.015
    # As it was solved: on the clocks found.
    for used in found.result.problem.trials:
        assert used.lags_s["encoders"] == pytest.approx(0.08, abs=0.01)


def test_what_is_known_comes_before_a_trials_own_data(in_device):
    """One prior of parameters and errors, and what no bushing tells."""
    contact = in_device.contact
    values, trial = contact.values(), recorded(in_device.trials[0])
    names = ("thigh.origin_x", "thigh.normal_stiffness", "skin.thigh.knee")
    known = Posterior(
        names,
        np.array([values[names[0]], values[names[1]], 0.02]),
        np.array([[1e-4, 0.2, 1e-5], [0.2, 9e4, 0.3], [1e-5, 0.3, 4e-4]]),
    )
    problem = Timing(
        in_device.model,
        [trial],
        replace(contact, posterior=known),
        in_device.settings(errors=ErrorSizes()),
    )
    cuffs, mean, covariance = problem._prior()
    all_names = cuffs + problem.errors.names
    i = [all_names.index(name) for name in names]
    np.testing.assert_allclose(mean[i], known.values)
    expected = known.covariance.copy()
    expected[0, 0] += 1e-3**2
    expected[1, 1] += (0.12 * values[names[1]]) ** 2
    np.testing.assert_allclose(covariance[np.ix_(i, i)], expected)
    k = all_names.index(f"{trial.name}.encoder_clock")
    assert mean[k] == 0.0 and covariance[k, k] == pytest.approx(0.03**2)
    # The cost of what is known, at another place.
    x = problem.guess()
    place = problem.program.indices
    free = [p.name for p in problem.parameters]
    assert not any(name.endswith("slip") for name in free)
    assert cuffs == free
    index = place(np.r_[problem.variables_of(free), problem.error_variables])
    program = problem.program.prog
    costs = [
        c
        for c in program.quadratic_costs()
        if c.variables().shape == (len(all_names),)
    ]
    (cost,) = costs
    rng = np.random.default_rng(0)
    off = np.sqrt(np.diag(covariance)) * rng.normal(size=len(mean))
    x[index] = mean + off
    found = cost.evaluator().Eval(x[place(cost.variables())])[0]
    expected = 0.5 * off @ np.linalg.solve(covariance, off)
    assert found == pytest.approx(expected, rel=1e-6)


def test_cuffs_beyond_the_bounds_of_phase_b_time_a_trial(in_device):
    """They are scaled, or a calibration with other bounds found them."""
    contact, name = in_device.contact, "thigh.normal_stiffness"
    known = Posterior((name,), np.array([7e3]), np.array([[1e4]]))
    for factor in (1e-3, 1e3):
        own = replace(contact, posterior=known).scaled(factor)
        problem = Timing(
            in_device.model, in_device.trials[:1], own, in_device.settings()
        )
        p = {p.name: p for p in problem.parameters}[name]
        assert p.nominal == own.values()[name]
        assert p.nominal in (p.lower, p.upper)


def test_a_campaign_counts_clocks_that_are_sure_and_off():
    told = [(0.02, 0.001), (0.0, 0.02), (0.001, 0.002), (0.1, None)]
    rows = [{"error_s": error, "sd_s": sd} for error, sd in told]
    found = _known(rows)
    assert found["clocks"] == 3
    assert found["unsure"] == pytest.approx(1 / 3)
    assert found["beyond_10_ms_unmarked"] == 1
