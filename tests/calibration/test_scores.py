"""RMSD and SD of signals whose differences the test has chosen."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from measured_trials import JOINTS, NAMES, TREE, moved, seen

from drake_exo.calibration import audit
from drake_exo.calibration.audit import rms, rmsd
from drake_exo.errors import InputError
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model
from drake_exo.model.segments import scale_human

spread = partial(audit.spread, tree=TREE)


def test_names_are_as_these_tests_write_them_down():
    assert NAMES.names[:3] == ("foot_x", "foot_z", "foot_pitch")
    assert NAMES.joints == NAMES.names[3:] == JOINTS


def test_rms_is_over_time_and_leaves_out_what_is_missing():
    values = np.array([[3.0, np.nan], [4.0, 5.0], [np.nan, -5.0]])
    np.testing.assert_allclose(rms(values), [np.sqrt(12.5), 5.0])


def test_a_value_counts_as_long_as_it_stands_for():
    """However many nodes a grid has in a short time."""
    coarse = np.linspace(0.0, 1.0, 101)
    fine = np.unique(np.r_[coarse, np.linspace(0.5, 0.51, 50)])
    values = [np.exp(3.0 * t) * (t > 0.3) for t in (coarse, fine)]
    expected = rms(values[0])
    assert rms(values[0], coarse) == pytest.approx(expected)
    assert rms(values[1], fine) == pytest.approx(expected, rel=2e-6)
    assert rms(values[1]) < 0.95 * expected
    hidden = np.where(fine < 0.3, np.nan, values[1])[:, None]
    seen = fine >= 0.3
    np.testing.assert_allclose(
        rms(hidden, fine), rms(values[1][seen], fine[seen])
    )


def test_each_signal_by_its_name_in_its_unit():
    measured = seen()
    dq = np.array([0.001, 0.002, 0.003, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    off = moved(
        measured,
        q=dq,
        v=10.0 * dq,
        moments=np.arange(2.0, 8.0),
        force=[3.0, -4.0],
        cop=0.005,
        normal=-6.0,
    )
    found = rmsd(replace(off, name="found"), measured)
    assert found["trial"] == "found"
    degrees = 180.0 / np.pi
    for k, joint in enumerate(JOINTS):
        angle = degrees * (k + 1) / 100.0
        assert found["angles_deg"][joint] == pytest.approx(angle)
        assert found["velocities_deg_s"][joint] == pytest.approx(10.0 * angle)
        assert found["moments_nm"][joint] == pytest.approx(k + 2.0)
    assert list(found["angles_deg"]) == list(JOINTS)
    # Without encoders the device's angles are the human's.
    bare = {"exoskeleton_angles": "the human's"}
    found = rmsd(off, replace(measured, provenance=bare))
    for kind in ("angles_deg", "velocities_deg_s"):
        assert list(found[kind]) == ["ankle", "knee", "hip"]
    assert found["foot"] == pytest.approx(
        {"x_mm": 1.0, "z_mm": 2.0, "pitch_deg": 0.003 * degrees}
    )
    assert found["grf_n"] == pytest.approx({"horizontal": 3.0, "vertical": 4.0})
    assert found["cop_mm"] == pytest.approx(5.0)
    assert found["interaction_n"] == pytest.approx({"thigh": 6.0})


def test_differences_are_squared_and_averaged():
    """A tenth of the samples is off by 1, the others are not."""
    measured = seen(n=201)
    off = np.zeros((201, 1))
    off[:20] = 1.0
    share = np.sqrt(20.0 / 201.0)
    found = rmsd(moved(measured, q=off, normal=off[:, 0]), measured)
    assert found["angles_deg"]["knee"] == pytest.approx(np.rad2deg(share))
    assert found["interaction_n"]["thigh"] == pytest.approx(share)


def test_a_measurement_is_compared_at_the_nodes_of_what_was_found():
    measured = seen(n=201)
    found = measured.sample(np.linspace(0.0, 2.0, 37))
    scores = rmsd(found, measured)
    values = [*scores["angles_deg"].values(), *scores["moments_nm"].values()]
    assert max(values) < 1e-9
    later = found.sample(found.times)
    later = replace(later, times=found.times, q=np.roll(found.q, 1, axis=0))
    assert rmsd(later, measured)["angles_deg"]["hip"] > 1.0


def test_what_means_nothing_or_is_not_measured_is_left_out():
    measured = seen(cuffs=("thigh", "pelvis"))
    found = replace(measured, cuffs={"thigh": CuffForce(measured.times)})
    assert set(rmsd(found, measured)["interaction_n"]) == {"thigh"}
    assert rmsd(found, measured, loads=False)["moments_nm"] == {}
    without = replace(measured, moments=None)
    assert rmsd(found, without)["moments_nm"] == {}
    bare = replace(found, cuffs={})
    assert rmsd(bare, measured)["interaction_n"] == {}


def test_a_trial_of_another_model_is_not_compared():
    measured = seen()
    other = replace(
        measured,
        coordinates=Coordinates(NAMES.names[:6]),
        q=measured.q[:, :6],
        v=measured.v[:, :6],
        a=measured.a[:, :6],
        moments=None,
        friction=None,
    )
    with pytest.raises(InputError, match=r"hip, but .* exo_hip; give trials"):
        rmsd(measured, other)


def test_a_centre_of_pressure_counts_only_under_load():
    measured = seen()
    F = measured.ground.force.copy()
    F[:50, 1] = 5.0
    ground = PlanarWrench(F, -0.3 * F[:, 1])
    lifted = replace(measured, ground=ground)
    F = measured.ground.force
    found = replace(measured, ground=PlanarWrench(F, -0.31 * F[:, 1]))
    # 10 mm wherever both bear load; else there is no such difference.
    assert rmsd(found, lifted)["cop_mm"] == pytest.approx(10.0, rel=1e-6)


def test_spread_is_one_sd_over_trials_of_any_length():
    """Constants about 0 with SD 1: (-1, 0, 1) times what stands there."""
    signs = (-1.0, 0.0, 1.0)
    dq = np.array([0.005, 0.0, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    trials = []
    for k, sign in enumerate(signs):
        trial = seen(f"rise{k}", 1.0 + 0.3 * k)
        shift = {"q": dq, "v": 2.0 * dq, "moments": np.arange(1.0, 7.0)}
        shift |= {"force": np.array([2.0, 9.0]), "cop": 0.012, "normal": 4.0}
        trials.append(moved(trial, **{n: sign * x for n, x in shift.items()}))
    found = spread(trials)
    for k, joint in enumerate(JOINTS):
        angle = np.rad2deg((k + 1) / 100.0)
        assert found["angles_deg"][joint] == pytest.approx(angle, rel=1e-4)
        assert found["velocities_deg_s"][joint] == pytest.approx(
            2.0 * angle, rel=1e-4
        )
        assert found["moments_nm"][joint] == pytest.approx(k + 1.0, rel=1e-4)
    assert found["grf_n"] == pytest.approx(
        {"horizontal": 2.0, "vertical": 9.0}, rel=1e-4
    )
    # Of the centre of pressure in front of the foot, which moves 5 mm.
    assert found["cop_mm"] == pytest.approx(7.0, rel=1e-4)
    assert found["interaction_n"] == pytest.approx({"thigh": 4.0}, rel=1e-4)


def test_spread_averages_the_sd_of_each_instant():
    """An SD that grows linearly from 0 to 1 is a half on average."""
    trials = [
        moved(t, q=sign * (t.times / t.duration)[:, None])
        for t in (seen("a"), seen("b", 1.5))
        for sign in (-1.0, 1.0)
    ]
    found = spread(trials)["angles_deg"]["knee"]
    # Four values -s, s, -s, s have the SD s sqrt(4/3).
    expected = np.rad2deg(0.5 * np.sqrt(4.0 / 3.0))
    assert found == pytest.approx(expected)


def test_spread_of_cuffs_counts_trials_that_have_them():
    trials = [seen("a", cuffs=("pelvis",)), seen("b", cuffs=("thigh",))]
    trials.append(moved(trials[1], normal=2.0))
    found = spread(trials)["interaction_n"]
    assert found["thigh"] == pytest.approx(np.sqrt(2.0))
    assert found["pelvis"] is None
    assert (
        spread([replace(t, moments=None) for t in trials])["moments_nm"] == {}
    )


def test_spread_of_the_device_counts_trials_with_encoders():
    none = {"exoskeleton_angles": "those of the human"}
    told = [seen("a"), moved(seen("b"), q=0.02)]
    untold = [replace(moved(t, q=1.0), provenance=none) for t in told]
    both, own = spread([*told, *untold]), spread(told)
    for key in ("angles_deg", "velocities_deg_s"):
        for joint in ("exo_ankle", "exo_knee", "exo_hip"):
            assert both[key][joint] == own[key][joint]
            assert np.isnan(spread(untold)[key][joint])
    assert both["angles_deg"]["knee"] > 10.0 * own["angles_deg"]["knee"]


def test_spread_of_pressure_where_all_trials_load_the_foot():
    trials = [moved(seen("a"), cop=0.012), moved(seen("b"), cop=-0.012)]
    F = trials[0].ground.force.copy()
    F[:50, 1] = 5.0
    moment = trials[0].ground.moment.copy()
    lifted = replace(trials[0], ground=PlanarWrench(F, moment))
    assert spread([lifted, trials[1]])["cop_mm"] == pytest.approx(
        12.0 * np.sqrt(2.0), rel=1e-4
    )
    F = F.copy()
    F[:, 1] = 5.0
    never = replace(trials[0], ground=PlanarWrench(F, moment))
    assert np.isnan(spread([never, trials[1]])["cop_mm"])


def test_pressure_of_two_legs_is_taken_from_each_foot():
    """A walker's pelvis moves on over feet whose pressure stays in them."""
    model = Model(Assembly(Person("two")), scale_human(70.0, 1.75))
    tree, names = model.tree, model.coordinates
    times = np.linspace(0.0, 1.0, 11)
    trials = []
    for speed, ahead in ((1.0, 0.06), (1.5, 0.06), (2.0, 0.09)):
        q = np.zeros((11, len(names)))
        q[:, 0] = speed * times
        q[:, names.index("hip_left")] = 0.3 * times
        feet = {}
        for side in ("left", "right"):
            foot = tree.point_positions(q, f"foot_{side}", (0.0, 0.0))
            force = np.tile([0.0, 400.0], (11, 1))
            at = foot[:, 0] + ahead * (side == "left")
            feet[side] = PlanarWrench(force, -400.0 * at)
        whole = feet["left"] + feet["right"]
        trials.append(
            Trial(f"{speed}", names, times, q, q, q, whole, feet=feet)
        )
    found = audit.spread(trials, tree)["cop_mm"]
    assert found["left"] == pytest.approx(np.sqrt(300.0), rel=1e-3)
    assert found["right"] == pytest.approx(0.0, abs=0.01)


def test_one_trial_has_no_spread():
    found = spread([seen()])
    assert np.isnan(list(found["angles_deg"].values())).all()
    assert np.isnan(found["cop_mm"])


def cuffed(normals, **of) -> Trial:
    """A trial whose cuffs bear these constant forces."""
    cuffs = {c: CuffForce(np.full(201, n)) for c, n in normals.items()}
    return replace(seen(), cuffs=cuffs, **of)


def test_a_cuff_that_bears_nothing_of_what_mats_show_is_noted():
    """Over the trials that have mats of it; little force tells little."""
    found = [
        cuffed({"thigh": 1.0, "shank": 40.0, "pelvis": 7.0}, name="a"),
        cuffed({"thigh": 1.0, "shank": 50.0, "pelvis": 7.0}, name="b"),
    ]
    measured = [
        cuffed({"thigh": -30.0, "pelvis": 3.0}, name="a"),
        cuffed({"thigh": -40.0, "shank": 45.0}, name="b"),
    ]
    thigh, shank, pelvis = audit.cuff_checks(found, measured)
    off, shown = np.sqrt((31.0**2 + 41.0**2) / 2.0), np.sqrt(1250.0)
    assert thigh.value == pytest.approx(off / shown)
    assert (thigh.holds, thigh.level, thigh.where) == (False, "note", "thigh")
    assert thigh.sentence.startswith(
        "the calibrated cuff is off by 36.3 N where its mats show 35.4 N"
    )
    assert shank.holds and shank.value == pytest.approx(5.0 / 45.0)
    assert pelvis.holds and pelvis.value == pytest.approx(0.4)
    assert [c.where for c in audit.cuff_checks(found[:1], measured[:1])] == [
        "thigh",
        "pelvis",
    ]
