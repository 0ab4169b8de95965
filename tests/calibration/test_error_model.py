"""Errors of measurement as unknowns: what they do, and that they are found."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from drake_exo.calibration.error_model import NO_ERRORS, ErrorModel, ErrorSizes
from drake_exo.calibration.phases import (
    InteractionCalibration,
    PredictionProblem,
    check_is_measured,
)
from drake_exo.calibration.results import read_calibration, write_contact
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.calibration.uncertainty import bands, posterior
from drake_exo.cli.crossvalidate import verdict
from drake_exo.contact.parameters import Posterior
from drake_exo.errors import InputError
from drake_exo.measurement.kinematics import (
    from_the_ground_up,
    inverse_dynamics,
)
from drake_exo.measurement.trial import CuffForce

SIZES = ErrorSizes()


@pytest.fixture(scope="module")
def errors(in_device):
    return ErrorModel(in_device.model, in_device.trials, SIZES)


def spoiled(made, trial, skin=0.0, encoder=0.0, unseen=0.0):
    """A trial as instruments with errors show it, by other code than ours.

    Skin turns the thigh's markers with flexion of the knee, the knee's encoder
    has an offset, and mats see a part of the force.
    """
    names, tree = trial.coordinates, made.model.rigid.tree
    knee, hip = names.index("knee"), names.index("hip")
    q, v, a = (x.copy() for x in (trial.q, trial.v, trial.a))
    for x, true in ((q, trial.q), (v, trial.v), (a, trial.a)):
        # The thigh leans back in flexion: its angle is shank's plus knee.
        x[:, knee] += skin * true[:, knee]
        x[:, hip] += skin * true[:, knee]
    body = names.body_columns
    torque = []
    for of in ((trial.q, trial.v, trial.a), (q, v, a)):
        of = [x[:, body] for x in of]
        Q = inverse_dynamics(tree, *of, {tree.root: trial.ground})
        Q = from_the_ground_up(tree, of[0], Q)
        torque.append(Q[:, tree.coordinates.joint_columns])
    moments = trial.moments.copy()
    moments[:, ~names.is_device_joint] += torque[1] - torque[0]
    q[:, names.index("exo_knee")] += encoder
    cuffs = {
        c: CuffForce((1.0 - unseen) * f.normal) for c, f in trial.cuffs.items()
    }
    return replace(trial, q=q, v=v, a=a, moments=moments, cuffs=cuffs)


@pytest.mark.parametrize("name", ["mat", "skin.1", "encoder", "friction"])
def test_a_trial_may_be_called_like_an_error(in_device, name):
    trial = in_device.trials[0]
    named = replace(trial, name=name)
    usual, found = (
        ErrorModel(in_device.model, [t], SIZES).effects(t)
        for t in (trial, named)
    )
    np.testing.assert_array_equal(found.q, usual.q)
    np.testing.assert_array_equal(found.moments, usual.moments)


def test_effects_are_what_instruments_do(in_device, errors):
    """Against a trial that was spoiled by other code, sizes one by one."""
    for trial in in_device.trials:
        found = errors.effects(trial)
        cuff = next(iter(trial.cuffs))
        for name, size in (
            ("skin.thigh.knee", {"skin": -1e-4}),
            ("encoder.exo_knee", {"encoder": 1e-4}),
            (f"mat.{cuff}.unseen", {"unseen": 1e-4}),
        ):
            k = errors.names.index(name)
            off = spoiled(in_device, trial, **size)
            sign = np.sign(next(iter(size.values())))
            for by, was, shown in (
                (found.q, trial.q, off.q),
                (found.v, trial.v, off.v),
                (found.moments, trial.moments, off.moments),
            ):
                change = (shown - was) / 1e-4
                own = by[:, :, k]
                if name.startswith("skin"):
                    own = own * _direction(in_device) * sign
                np.testing.assert_allclose(own, change, rtol=1e-3, atol=2e-3)
            if name.startswith("mat"):
                change = off.cuffs[cuff].normal - trial.cuffs[cuff].normal
                np.testing.assert_allclose(
                    found.normal[cuff][:, k], change / 1e-4, atol=1e-6
                )


def test_skin_that_bends_goes_with_the_square_of_flexion(in_device, errors):
    """Angle, and a rate that is its derivative."""
    trial = in_device.trials[0]
    found, names = errors.effects(trial), trial.coordinates
    k = errors.names.index("bend.thigh.knee")
    hip, knee = names.index("hip"), names.index("knee")
    square = trial.q[:, knee] ** 2
    np.testing.assert_allclose(np.abs(found.q[:, hip, k]), square)
    rate = CubicSpline(trial.times, found.q[:, :, k])(trial.times, 1)
    np.testing.assert_allclose(
        found.v[2:-2, :, k], rate[2:-2], atol=1e-4 * np.abs(rate).max()
    )


def test_a_late_clock_shows_what_was_before(in_device, errors):
    """By shifted splines: what is shown at t was true at t - lag."""
    lag = 1e-4
    trial = in_device.trials[0]
    names, moments = trial.coordinates, trial.moments.copy()
    exo = names.is_device_joint
    pulse = np.sin(np.pi * trial.times / trial.duration) ** 2
    moments[:, exo] = np.outer(pulse, [3.0, -20.0, 12.0])
    trial = replace(trial, moments=moments)
    found = errors.effects(trial)
    inside = slice(2, -2)

    def change(x):
        late = CubicSpline(trial.times, x)(trial.times - lag)
        return ((late - x) / lag)[inside]

    def of(what):
        return errors.names.index(f"{trial.name}.{what}")

    k = of("encoder_clock")
    device = names.device_columns
    others = [i for i in range(len(names)) if i not in device]
    for by, was in ((found.q, trial.q), (found.v, trial.v)):
        own = by[:, :, k]
        assert np.abs(own[:, others]).max() == 0.0
        np.testing.assert_allclose(
            own[inside, device], change(was[:, device]), atol=0.02, rtol=0.02
        )
        assert np.abs(own).max() > 0.1
    own = found.moments[inside, :, k]
    shown = change(trial.moments[:, exo])
    np.testing.assert_allclose(own[:, exo], shown, atol=0.1)
    # What the device bears more the human bears less, joint by joint.
    for device, change_nm in zip(names.device, shown.T, strict=True):
        human = names.joint(names.follows(device))
        np.testing.assert_allclose(own[:, human], -change_nm, atol=0.1)
    k = of("mat_clock")
    for cuff, force in trial.cuffs.items():
        np.testing.assert_allclose(
            found.normal[cuff][inside, k],
            change(force.normal),
            atol=0.02 * np.ptp(force.normal),
            rtol=0.05,
        )
        assert np.abs(found.normal[cuff][:, k]).max() > 1.0


def _direction(made) -> float:
    """+1 if a thigh that turns forwards flexes the knee, -1 otherwise."""
    tree, names = made.model.tree, made.model.coordinates
    return float(np.sign(tree.turning("thigh")[names.index("knee")]))


def test_priors_are_sizes_in_si_units(in_device):
    """Independent of each other, about zero."""
    sizes = ErrorSizes(
        skin=0.02,
        skin_bend=0.03,
        encoder_offset_deg=180.0,
        mat_share=0.04,
        mat_offset_n=5.0,
        encoder_clock_s=0.06,
        mat_clock_s=0.07,
    )
    model = ErrorModel(in_device.model, in_device.trials, sizes)
    mean, covariance = model.prior()
    assert not mean.any()
    np.testing.assert_allclose(covariance, np.diag(np.diag(covariance)))
    sd = dict(zip(model.names, np.sqrt(np.diag(covariance)), strict=True))
    trial = in_device.trials[0].name
    expected = {
        "skin.thigh.knee": 0.02,
        "bend.thigh.knee": 0.03,
        "encoder.exo_knee": np.pi,
        "mat.thigh.unseen": 0.04,
        "mat.thigh.offset": 5.0,
        f"{trial}.encoder_clock": 0.06,
        f"{trial}.mat_clock": 0.07,
    }
    assert {name: sd[name] for name in expected} == pytest.approx(expected)


def test_errors_that_are_none_are_no_unknowns(in_device):
    none = ErrorModel(in_device.model, in_device.trials, NO_ERRORS)
    assert none.unknowns == []
    part = ErrorModel(in_device.model, in_device.trials, ErrorSizes(skin=0.0))
    assert not any(n.startswith("skin.") for n in part.names)


@pytest.fixture(scope="module")
def estimated(in_device):
    """Phase B of three spoiled trials."""
    trials = [
        spoiled(in_device, t, skin=-0.03, encoder=0.03, unseen=0.05)
        for t in in_device.trials
    ]
    settings = in_device.settings(errors=SIZES)
    problem = InteractionCalibration(
        in_device.model, trials, in_device.contact, settings
    )
    return problem.solve()


@pytest.mark.slow
def test_errors_are_found_and_forces_with_them(in_device, estimated):
    assert estimated.success
    assert estimated.solution.iterations <= 40
    known = posterior(estimated)
    off = {n: v for n, v in zip(known.names, known.values, strict=True)}
    assert off["encoder.exo_knee"] == pytest.approx(0.03, abs=0.012)
    for found, trial in zip(estimated.trials, in_device.trials, strict=True):
        knee = found.coordinate("knee") - trial.coordinate("knee")
        assert np.rad2deg(np.abs(knee).max()) < 1.2
        # Measured 2.7 degrees off.
    blind = in_device.calibration(
        in_device.settings(), estimated.problem.trials
    ).solve()
    true = in_device.contact.values()

    def error(result):
        return np.mean(
            [
                abs(np.log(p.nominal / true[p.name]))
                for p in result.parameters
                if p.name.endswith("normal_stiffness")
            ]
        )

    assert error(estimated) < 0.5 * error(blind)


@pytest.mark.slow
def test_what_is_known_goes_to_disk_and_into_bands(
    in_device, estimated, tmp_path
):
    known = posterior(estimated)
    assert np.linalg.eigvalsh(known.covariance).min() > 0.0
    contact = replace(estimated.contact, posterior=known)
    write_contact(tmp_path, contact)
    again = read_calibration(tmp_path).contact
    assert again == contact
    stiff = again.scaled(1.4).posterior
    k = known.names.index("thigh.normal_stiffness")
    assert stiff.covariance[k, k] == pytest.approx(
        1.96 * known.covariance[k, k]
    )
    trial = estimated.problem.trials[0]
    settings = PredictionSettings(solver=Solver(50.0))
    widths = []
    for factor in (1.0, 0.1):
        less = replace(known, covariance=factor**2 * known.covariance)
        result = PredictionProblem(
            in_device.model, [trial], replace(again, posterior=less), settings
        ).solve()
        found = bands(result)
        widths.append(found.cuffs["pelvis"][:, 0].mean())
        cover = found.coverage(result.trials[0], trial)["interaction_n"]
        assert set(cover) == set(trial.cuffs)
    assert widths[1] < widths[0]
    # A parameter that ended at its bound.
    k = known.names.index("shank.origin_x")
    held = known.covariance.copy()
    held[k], held[:, k] = 0.0, 0.0
    at_bound = replace(contact, posterior=replace(known, covariance=held))
    write_contact(tmp_path, at_bound)
    result = PredictionProblem(
        in_device.model, [trial], read_calibration(tmp_path).contact, settings
    ).solve()
    assert np.isfinite(bands(result).cuffs["shank"]).all()
    plain = PredictionProblem(
        in_device.model, [trial], in_device.contact, settings
    ).solve()
    assert bands(plain) is None


@pytest.mark.slow
def test_bands_are_the_change_of_another_solve(in_device, estimated):
    """A stiffness moved by a little: what the optimum does, to first order."""
    known = posterior(estimated)
    contact = replace(estimated.contact, posterior=known)
    settings = PredictionSettings(solver=Solver(50.0, tolerance=1e-8))
    trial = estimated.problem.trials[0]

    def solve(contact):
        return PredictionProblem(
            in_device.model, [trial], contact, settings
        ).solve()

    name = "pelvis.rotational_stiffness"
    first = solve(contact)
    value = contact.values()[name]
    other = solve(contact.with_values({name: 1.02 * value}))
    from drake_exo.nlp.sensitivity import Optimum

    problem = first.problem
    program = problem.compiled
    y = program.restrict(first.solution.raw_values())
    border = problem.program.indices(problem.error_variables)
    optimum = Optimum(program, y, program.unknowns.column_of(border))
    variable = problem.program.indices(problem.variables_of([name]))
    by = program.unknowns.matrix @ optimum.by_fixed(variable)
    force = problem.program.indices(problem.movements[0].cuffs["pelvis"])
    predicted = 0.02 * value * by[force.ravel(), 0].reshape(force.shape)
    actual = (
        other.trials[0].cuffs["pelvis"].components
        - first.trials[0].cuffs["pelvis"].components
    )
    assert np.abs(actual).max() > 0.01
    assert np.abs(predicted - actual).max() < 0.15 * np.abs(actual).max()


def test_a_damaged_posterior_is_refused(in_device, tmp_path):
    known = Posterior(("a", "b"), np.zeros(2), np.array([[1.0, 2], [2, 1]]))
    write_contact(tmp_path, replace(in_device.contact, posterior=known))
    with pytest.raises(InputError, match="not positive"):
        read_calibration(tmp_path)
    # Errors are divided by their covariance: none may be known exactly.
    for entries in ([[0.0, 0], [0, 0]], [[1, 1], [1, 1]], [[1, 0.5], [0, 1]]):
        flat = replace(known, covariance=np.array(entries))
        write_contact(tmp_path, replace(in_device.contact, posterior=flat))
        with pytest.raises(InputError, match="not positive"):
            read_calibration(tmp_path)
    for part, words in (
        ({"values": np.zeros(1)}, "sizes of its parts"),
        ({"names": ("a", "a")}, "names repeat"),
    ):
        short = replace(known, **part)
        write_contact(tmp_path, replace(in_device.contact, posterior=short))
        with pytest.raises(InputError, match=words):
            read_calibration(tmp_path)


def test_a_verdict_says_whether_calibrating_helps():
    def fold(own, usual):
        return {
            "success": True,
            "rmsd": {"interaction_n": own},
            "rmsd_uncalibrated": {"interaction_n": usual},
        }

    folds = [
        fold({"pelvis": 4.0}, {"pelvis": 10.0}),
        fold({"thigh": 6.0, "shank": 2.0}, {"thigh": 9.0, "shank": 5.0}),
    ]
    found = verdict(folds)
    assert found["helps"] and found["ratio"] == pytest.approx(0.5)
    assert "4.0 N instead of 8.0 N" in found["sentence"]
    worse = verdict([fold({"thigh": 9.0}, {"thigh": 6.0})])
    assert not worse["helps"] and worse["ratio"] == pytest.approx(1.5)
    nothing = verdict([{"success": False}])
    assert nothing["helps"] is None and nothing["ratio"] is None


def unseen(trial):
    """A trial without encoders: its device's angles are the human's."""
    names = trial.coordinates
    aligned = {
        k: names.aligned(getattr(trial, k)[:, names.body_columns])
        for k in ("q", "v", "a")
    }
    said = {"exoskeleton_angles": "as the human's (no encoders)"}
    return replace(trial, **aligned, jerk=None, provenance=said)


@pytest.mark.slow
def test_angles_that_no_encoder_told_are_not_tracked(in_device):
    made, trials = in_device, in_device.trials[:1]
    blind = list(map(unseen, trials))
    device = made.model.coordinates.device_columns
    for own, known in ((trials, True), (blind, False)):
        for problem in (
            InteractionCalibration(made.model, own, made.contact),
            PredictionProblem(made.model, own, made.contact),
        ):
            (movement,) = problem.movements
            for term in movement.tracked[:2]:
                assert np.isfinite(term.sigma[:, device]).all() == known
                assert np.isfinite(term.sigma[:, :6]).all()
    check_is_measured([*trials, *blind])
    with pytest.raises(InputError, match="no trial has encoders"):
        check_is_measured(blind)
