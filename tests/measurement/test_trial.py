import json
from dataclasses import replace

import numpy as np
import pytest
from measured_trials import seen
from pydrake.multibody.tree import MultibodyForces

from drake_exo.errors import InputError
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.coordinates import Coordinates

NAMES = Coordinates(
    ("foot_x", "foot_z", "foot_pitch", "ankle", "knee", "exo_knee"),
    ("exo_knee",),
)


@pytest.fixture
def trial():
    t = np.arange(51) / 100.0
    phase = np.arange(6) / 3.0
    angle = 2.0 * np.pi * t[:, None] + phase
    F_z = 300.0 + 290.0 * np.cos(2.0 * np.pi * t)
    return Trial(
        "rise1",
        NAMES,
        t,
        np.sin(angle),
        2.0 * np.pi * np.cos(angle),
        -((2.0 * np.pi) ** 2) * np.sin(angle),
        PlanarWrench(np.column_stack([0.1 * F_z, F_z]), -0.1 * F_z),
        mass_kg=60.0,
        start_s=1.0,
        provenance={
            "markers": "a.trc",
            "filter": {"cutoff_hz": 6.0},
            "x": [1.5, None],
        },
    )


@pytest.fixture
def whole(trial):
    """A trial of which everything is known."""
    rng = np.random.default_rng(0)
    return replace(
        trial,
        source="solved",
        moments=rng.normal(size=(51, 3)),
        cuffs={
            "thigh": CuffForce.of(rng.normal(size=(51, 3))),
            "shank": CuffForce(rng.normal(size=51)),
        },
        chair=PlanarWrench.of(rng.normal(size=(51, 3))),
        chair_on_thighs=0.25,
        jerk=rng.normal(size=(50, 6)),
    )


def test_survives_saving_without_loss(trial, tmp_path):
    trial.save(tmp_path / "rise1")
    found = Trial.load(tmp_path / "rise1")
    for name in ("times", "q", "v", "a"):
        np.testing.assert_array_equal(
            getattr(found, name), getattr(trial, name)
        )
    np.testing.assert_array_equal(found.ground.array, trial.ground.array)
    for name in (
        *("name", "coordinates", "source", "mass_kg", "start_s"),
        *("provenance", "moments", "cuffs", "chair", "jerk"),
    ):
        assert getattr(found, name) == getattr(trial, name)


def test_survives_saving_whole(whole, tmp_path):
    whole.save(tmp_path / "rise1")
    found = Trial.load(tmp_path / "rise1")
    assert (found.source, found.chair_on_thighs) == ("solved", 0.25)
    for name in ("moments", "jerk"):
        np.testing.assert_array_equal(
            getattr(found, name), getattr(whole, name)
        )
    np.testing.assert_array_equal(found.chair.array, whole.chair.array)
    assert list(found.cuffs) == ["thigh", "shank"]
    for name, force in whole.cuffs.items():
        np.testing.assert_array_equal(
            found.cuff(name).components, force.components
        )
    assert found.cuff("shank").tangential is None


@pytest.mark.parametrize("name", ["rise1", "sit.to.stand"])
def test_names_with_dots_keep_their_files(trial, tmp_path, name):
    trial.save(tmp_path / name)
    assert {p.name for p in tmp_path.iterdir()} == {
        f"{name}.npz",
        f"{name}.json",
    }
    trial.save(tmp_path / f"{name}.npz")
    assert len(list(tmp_path.iterdir())) == 2
    assert Trial.load(tmp_path / f"{name}.json").name == trial.name


def test_damaged_files_are_refused(trial, tmp_path):
    trial.save(tmp_path / "rise1")
    with pytest.raises(InputError, match=r"rise2\.npz: cannot be read"):
        Trial.load(tmp_path / "rise2")
    place = tmp_path / "rise1.npz"
    place.write_bytes(place.read_bytes()[:200])
    with pytest.raises(InputError, match=r"rise1\.npz: is damaged; run what"):
        Trial.load(tmp_path / "rise1")
    trial.save(tmp_path / "rise1")
    place = tmp_path / "rise1.json"
    place.write_text(json.dumps({"name": "rise1"}))
    with pytest.raises(InputError, match="holds no trial"):
        Trial.load(tmp_path / "rise1")


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.pop("q"),
        lambda arrays: arrays.update(q=arrays["q"][:-1]),
        lambda arrays: arrays.update(q=np.nan * arrays["q"]),
        lambda arrays: arrays.update(ground=arrays["ground"][:, 0]),
        lambda arrays: arrays.update(chair=arrays["q"]),
        lambda arrays: arrays.update({"cuffs.thigh.shear": arrays["times"]}),
        lambda arrays: arrays.update({"cuffs.thigh": arrays["times"]}),
        lambda arrays: arrays.update(times=np.array("now")),
        lambda arrays: arrays.update(times=arrays["q"]),
        lambda arrays: arrays.update(jerk=arrays["q"][:, 1:]),
    ],
)
def test_files_that_hold_no_trial_are_refused(trial, tmp_path, change):
    trial.save(tmp_path / "t")
    with np.load(tmp_path / "t.npz") as stored:
        arrays = dict(stored)
    change(arrays)
    np.savez(tmp_path / "t.npz", **arrays)
    with pytest.raises(InputError, match=r"t: holds no trial.*run what wrote"):
        Trial.load(tmp_path / "t")


def test_saving_twice_gives_the_same_bytes(whole, tmp_path):
    for name in ("a", "b"):
        whole.save(tmp_path / name)
    for kind in ("npz", "json"):
        first, second = (tmp_path / f"{n}.{kind}" for n in "ab")
        assert first.read_bytes() == second.read_bytes()


def test_cop(trial):
    cop = trial.ground.cop_x
    unloaded = trial.ground.force_z <= 20.0
    assert unloaded.any() and np.isnan(cop[unloaded]).all()
    np.testing.assert_allclose(cop[~unloaded], 0.1)


def test_sampling_keeps_ends_and_shape(trial):
    fine = trial.sample(np.linspace(0.0, trial.duration, 101))
    assert fine.times[[0, -1]] == pytest.approx(trial.times[[0, -1]])
    np.testing.assert_allclose(fine.q[::2], trial.q, atol=1e-12)
    angle = 2.0 * np.pi * fine.times[:, None] + np.arange(6) / 3.0
    np.testing.assert_allclose(fine.q, np.sin(angle), atol=2e-6)
    np.testing.assert_allclose(fine.v, 2.0 * np.pi * np.cos(angle), atol=2e-5)
    assert (fine.name, fine.start_s) == (trial.name, trial.start_s)


def test_sampling_takes_everything_along(whole):
    part = whole.sample(whole.times[10:21])
    np.testing.assert_allclose(part.moments, whole.moments[10:21])
    np.testing.assert_allclose(part.chair.array, whole.chair.array[10:21])
    np.testing.assert_allclose(part.ground.array, whole.ground.array[10:21])
    np.testing.assert_allclose(
        part.cuff("thigh").components, whole.cuff("thigh").components[10:21]
    )
    assert part.cuff("shank").moment is None
    assert part.jerk is None  # of the nodes of a solution


def test_signals_by_name(whole):
    for k, name in enumerate(NAMES.names):
        np.testing.assert_array_equal(whole.coordinate(name), whole.q[:, k])
        np.testing.assert_array_equal(whole.velocity(name), whole.v[:, k])
        np.testing.assert_array_equal(whole.acceleration(name), whole.a[:, k])
    for k, name in enumerate(NAMES.joints):
        np.testing.assert_array_equal(whole.moment(name), whole.moments[:, k])
    force = whole.cuff("thigh")
    tangential, normal, moment = force.components.T
    np.testing.assert_array_equal(force.normal, normal)
    np.testing.assert_array_equal(force.tangential, tangential)
    np.testing.assert_array_equal(force.moment, moment)
    unknown = whole.cuff("shank").components
    assert np.isnan(unknown[:, [0, 2]]).all()
    assert np.isfinite(unknown[:, 1]).all()
    assert whole.duration == 0.5


def test_signals_that_are_not_known_are_refused(trial, whole):
    for read in (trial.coordinate, trial.velocity, trial.acceleration):
        with pytest.raises(InputError, match=r"'hip'; known are foot_x"):
            read("hip")
    with pytest.raises(InputError, match="joint moments are not known"):
        trial.moment("knee")
    with pytest.raises(InputError, match="no coordinate 'hip'"):
        whole.moment("hip")
    with pytest.raises(InputError, match="'foot_x' is not a joint"):
        whole.moment("foot_x")
    with pytest.raises(InputError, match=r"cuff 'thigh'; there are none"):
        trial.cuff("thigh")
    with pytest.raises(InputError, match=r"'pelvis'; there are thigh, shank"):
        whole.cuff("pelvis")


def test_work_of_the_device_is_that_of_its_own_joints():
    """-20 N m at 1 rad/s for 1.5 s; the person's do not count."""
    times, zero = np.linspace(0.0, 1.5, 4), np.zeros((4, len(NAMES)))
    ground = PlanarWrench.of(np.zeros((4, 3)))
    moments = np.full((4, 3), [7.0, 9.0, -20.0])
    moved = Trial(
        "a", NAMES, times, zero, zero + 1.0, zero, ground, moments=moments
    )
    assert moved.device_moments.tolist() == [[-20.0]] * 4
    assert moved.device_work == pytest.approx(-30.0)


def test_lags_are_those_of_the_recording(trial):
    assert trial.lags_s == {}
    said = {"delays_s": {"forces": 0.013}}
    assert replace(trial, provenance=said).lags_s == {"forces": 0.013}


def test_a_chair_acts_on_pelvis_and_thighs(trial, whole):
    assert trial.chair_shares == {}
    assert whole.chair_shares == {"pelvis": 0.75, "thigh": 0.25}
    alone = replace(whole, chair_on_thighs=0.0)
    assert alone.chair_shares == {"pelvis": 1.0}
    stands = replace(whole, chair=None)
    seated, risen = (
        sum(load.array for load in each.loads("foot").values())
        for each in (whole, stands)
    )
    np.testing.assert_allclose(seated - risen, whole.chair.array)
    nobody = PlanarWrench.of(np.zeros((51, 3)))
    assert replace(whole, chair=nobody).chair_shares == {}
    assert replace(whole, chair=nobody).borne() == stands.borne()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"q": np.zeros((51, 5))}, r"q has shape \(51, 5\), not \(51, 6\)"),
        ({"moments": np.zeros((51, 6))}, r"moments has shape .*\(51, 3\)"),
        ({"ground": PlanarWrench.of(np.zeros((9, 3)))}, "ground has shape"),
        ({"chair": PlanarWrench.of(np.zeros((9, 3)))}, "chair has shape"),
        ({"cuffs": {"shank": CuffForce(np.zeros(9))}}, r"shank\.normal has"),
    ],
)
def test_shapes_are_checked(trial, changes, words):
    with pytest.raises(ValueError, match=f"trial rise1: .*{words}"):
        replace(trial, **changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"ground": np.zeros((51, 3))}, "ground is .*; give a PlanarWrench"),
        ({"chair": np.zeros((51, 3))}, "chair is .*; give a PlanarWrench"),
        ({"cuffs": {"shank": np.zeros(51)}}, "shank is .*; give a CuffForce"),
        ({"feet": {"left": 3}}, r"feet\.left is 3; give a PlanarWrench"),
        ({"coordinates": ("ankle",)}, "coordinates is .*give a Coordinates"),
        # More than the whole chair would act on the thighs.
        ({"chair_on_thighs": 2.0}, "chair_on_thighs is 2, but must be at most"),
        ({"source": "mine"}, "source is 'mine'; give one of measured, solved"),
        ({"provenance": {"delays_s": 0.1}}, "delays_s is 0.1; give a dict"),
        (
            {"provenance": {"shifted_s": {"encoders": None}}},
            "provenance.shifted_s.encoders must be a number",
        ),
        ({"provenance": {"clocks": ["encoders"]}}, "clocks is .*; give a dict"),
        (
            {
                "provenance": {
                    "delays_s": {"encodrs": 0.0},
                    "clocks": {"encodrs": "to be found"},
                }
            },
            "clocks names 'encodrs'; lags .*; did you mean 'encoders'",
        ),
        ({"mass_kg": "70"}, "mass_kg must be a number"),
        ({"times": np.linspace(1.0, 0.0, 51)}, "times do not increase"),
        ({"times": np.full(51, np.nan)}, "times do not increase"),
    ],
)
def test_parts_are_checked(trial, changes, words):
    with pytest.raises(InputError, match=f"trial rise1: .*{words}"):
        replace(trial, **changes)


def test_a_name_is_text(trial):
    with pytest.raises(InputError, match="name is 3; give a str"):
        replace(trial, name=3)


def test_a_notebook_shows_a_line_not_the_arrays():
    trial = seen("rise", 2.0, ("thigh", "pelvis"))
    shown = repr(trial)
    assert shown.startswith("Trial('rise', measured, 2.00 s, 201 samples; foot")
    assert shown.endswith("exo_hip; cuffs thigh, pelvis)")
    assert repr(trial.cuff("thigh")) == (
        "CuffForce(201 samples, normal up to 40.0 N)"
    )
    assert repr(trial.ground) == (
        "PlanarWrench(201 samples, up to 20.0 N fore and aft, "
        "750.0 N vertically)"
    )


def test_arrays_are_real_numbers_whatever_they_are_given_as(trial, tmp_path):
    """What is saved can be read, of lists and of other numbers, too."""
    given = replace(
        trial, times=trial.times.tolist(), q=trial.q.astype(np.float32)
    )
    whole = np.full(len(trial.times), 12)
    standing = PlanarWrench(np.column_stack([0 * whole, whole]), -whole)
    given = replace(given, cuffs={"thigh": CuffForce(whole)}, ground=standing)
    given.save(tmp_path / "it")
    again = Trial.load(tmp_path / "it")
    np.testing.assert_allclose(again.q, trial.q, atol=1e-6)
    np.testing.assert_array_equal(again.cuff("thigh").normal, whole)
    np.testing.assert_array_equal(again.ground.array, standing.array)
    with pytest.raises(InputError, match="q holds no real numbers"):
        replace(trial, q=trial.q + 1j)
    assert CuffForce([1.0, 2.0]).normal.shape == (2,)
    assert PlanarWrench([[0, 700]], [-70]).cop_x[0] == pytest.approx(0.1)
    with pytest.raises(ValueError, match=r"give \(N, 2\) and \(N,\)"):
        PlanarWrench(np.zeros((3, 3)), np.zeros(3))


def test_nothing_is_sampled_outside_of_a_trial(trial):
    end = trial.times[-1]
    assert trial.sample([0.0, end + 1e-9]).times.shape == (2,)
    for times in ([0.0, end + 0.01], [-0.01, end], []):
        with pytest.raises(InputError, match="are asked for"):
            trial.sample(times)


def test_a_cuff_s_name_may_have_dots(whole, tmp_path):
    named = replace(whole, cuffs={"thigh.left": whole.cuffs["thigh"]})
    named.save(tmp_path / "dots")
    for found in (Trial.load(tmp_path / "dots"), named.sample(named.times)):
        np.testing.assert_allclose(
            found.cuffs["thigh.left"].normal, whole.cuffs["thigh"].normal
        )


def test_what_is_read_from_a_trial_does_not_change_it(whole):
    """Degrees made of radians in place would be what is calibrated on."""
    given = whole.q.copy()
    trial = replace(whole, q=given)
    for signal in (
        trial.times,
        trial.coordinate("knee"),
        trial.moment("knee"),
        trial.ground.force_z,
        trial.ground.moment,
        trial.cuff("thigh").normal,
        trial.sample(trial.times).q,
    ):
        with pytest.raises(ValueError, match="read-only"):
            signal *= 2.0
    given[:] = 0.0  # one array may serve for many trials
    np.testing.assert_array_equal(trial.q, whole.q)


def test_trials_made_of_each_other_have_forces_of_their_own(whole):
    without = replace(whole, name="without mats")
    for name in ("feet", "cuffs", "applied", "provenance"):
        assert getattr(without, name) is not getattr(whole, name)
    without.cuffs.clear()
    assert list(whole.cuffs) == ["thigh", "shank"]


@pytest.mark.parametrize("kind", ["coupled", "human"])
def test_moments_are_those_of_drake_less_the_device_s(nominal, kind):
    """Body and device as one plant, on the ground that it needs."""
    model = nominal(kind)
    names, plant = model.coordinates, model.rigid.plant()
    context, forces = plant.CreateDefaultContext(), MultibodyForces(plant)
    rng = np.random.default_rng(2)
    q, v, a = rng.normal(0.0, 0.5, (3, 4, len(names.body)))
    Q = np.zeros_like(q)
    for k in range(4):
        plant.SetPositions(context, q[k])
        plant.SetVelocities(context, v[k])
        plant.CalcForceElementsContribution(context, forces)
        Q[k] = plant.CalcInverseDynamics(context, a[k], forces)
    F_x, F_z, pitch = Q[:, :3].T
    M_y = q[:, 1] * F_x - q[:, 0] * F_z - pitch
    trial = Trial(
        "any",
        names,
        np.arange(4.0),
        *(names.aligned(x) for x in (q, v, a)),
        PlanarWrench(Q[:, :2], M_y),
    )
    torques = rng.normal(size=(4, len(names.device)))
    found = trial.with_moments(model, torques if names.device else None)
    np.testing.assert_array_equal(found.device_moments, torques)
    total = np.column_stack([found.moment(n) for n in names.human])
    if names.device:
        total += torques
    np.testing.assert_allclose(total, Q[:, 3:], atol=1e-9)
    wanted = rf"not \(4, {len(names.device)}\); give a column"
    for given in (np.zeros((4, 2)), torques[:3]):
        with pytest.raises(InputError, match=wanted):
            trial.with_moments(model, given)
    with pytest.raises(InputError, match=r"model is array.*give a Model"):
        trial.with_moments(torques)
