"""Who wears a design: drawn, of other sizes, with other torques."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from worn import wearer as worn

from drake_exo.calibration import wearers
from drake_exo.calibration.settings import (
    CuffFreedom,
    DesignSettings,
    JointFreedom,
    Population,
    PredictionSettings,
)
from drake_exo.calibration.wearers import (
    Size,
    Wearer,
    assisted,
    check_wearers,
    drawn,
    sized,
    with_more,
)
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import (
    ContactSphere,
    Posterior,
    nominal_contact,
)
from drake_exo.contact.strap import Assistance, Design, Gains
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.measurement.kinematics import inverse_dynamics
from drake_exo.model.assembly import Assembly, CuffLinks, DeviceFile
from drake_exo.model.description import (
    fit_exoskeleton,
    models_path,
    nominal_human,
)
from drake_exo.model.device_file import brought_in
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import scale_human


@pytest.fixture(scope="module")
def wearer():
    return worn(nominal_model("coupled"))


def test_assistance_moves_load_between_person_and_device(wearer):
    """What the device bears more, the person bears less; others as they do."""
    (own,) = wearer.trials
    design = Design(
        assistance={
            "exo_knee": Assistance((0.0,), (1.5,)),
            # Two coefficients: a straight line over the movement.
            "exo_hip": Assistance((), (1.0, 2.0), "movement"),
        }
    )
    changed = assisted(own, design)
    s = own.times / own.times[-1]
    for joint, share in (("knee", 0.5), ("hip", s), ("ankle", 0.0)):
        more = share * own.moment(f"exo_{joint}")
        np.testing.assert_allclose(
            changed.moment(f"exo_{joint}"), own.moment(f"exo_{joint}") + more
        )
        np.testing.assert_allclose(
            changed.moment(joint), own.moment(joint) - more
        )
    assert assisted(own, Design()) is own


def test_a_device_that_counts_the_other_way_takes_the_same_load(wearer):
    """What it gives and the person saves are of the same power."""
    (own,) = wearer.trials
    names = own.coordinates
    turned = replace(
        names, coupling=((0.0, 0.6, -0.4), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    torques = np.outer(1.0 + own.times, [3.0, -2.0, 5.0])
    more = with_more(replace(own, coordinates=turned), torques)
    change = more.moments - own.moments
    device = names.is_device_joint
    np.testing.assert_allclose(change[:, device], torques)
    human = own.v[:, names.joint_columns][:, ~device]
    given = np.sum(torques * (human @ np.array(turned.coupling).T), axis=1)
    saved = np.sum(change[:, ~device] * human, axis=1)
    np.testing.assert_allclose(saved, -given, atol=1e-12)
    assert np.abs(given).max() > 1.0


def test_gains_use_each_joint_s_own_angle_and_rate(wearer):
    (own,) = wearer.trials
    gains = Gains(0.5, 3.0, 8.0, 0.7)
    changed = assisted(own, Design(gains={"exo_hip": gains}))
    expected = (
        0.5 * own.moment("exo_hip")
        + 3.0
        - 8.0 * own.coordinate("exo_hip")
        - 0.7 * own.velocity("exo_hip")
    )
    np.testing.assert_allclose(changed.moment("exo_hip"), expected)


def test_wearers_are_drawn_from_what_is_known(wearer):
    """Correlated as a calibration left them; stiffness by its logarithm."""
    names = ("thigh.origin_z", "thigh.normal_stiffness")
    values = np.array([wearer.contact.values()[n] for n in names])
    sd = np.array([0.01, 0.2 * values[1]])
    covariance = np.outer(sd, sd) * [[1.0, 0.8], [0.8, 1.0]]
    known = Posterior(names, values, covariance)
    sure = replace(wearer, contact=replace(wearer.contact, posterior=known))
    draws = drawn(sure, 300)
    origin, stiffness = (
        np.array([d.contact.values()[n] for d in draws]) for n in names
    )
    assert origin.mean() == pytest.approx(values[0], abs=0.002)
    assert origin.std() == pytest.approx(0.01, rel=0.15)
    off = np.log(stiffness / values[1])
    assert off.mean() == pytest.approx(0.0, abs=0.04)
    assert off.std() == pytest.approx(0.2, rel=0.15)
    assert np.corrcoef(origin, off)[0, 1] == pytest.approx(0.8, abs=0.06)
    assert drawn(wearer, 3) == []
    assert drawn(sure, 1)[0].contact.values() == draws[0].contact.values()
    assert [d.name for d in draws[:2]] == ["somebody draw 1", "somebody draw 2"]
    assert all(d.is_drawn for d in draws)


def test_what_was_found_together_is_drawn_together(wearer):
    """A covariance of rank one: all of two places by the same amount."""
    names = ("thigh.origin_x", "thigh.origin_z")
    values = np.array([wearer.contact.values()[n] for n in names])
    known = Posterior(names, values, 1e-4 * np.ones((2, 2)))
    sure = replace(wearer, contact=replace(wearer.contact, posterior=known))
    for own in drawn(sure, 5):
        off = [own.contact.values()[n] for n in names] - values
        assert off[0] == pytest.approx(off[1], abs=1e-5)
        assert abs(off[0]) > 1e-4


def test_no_draw_of_a_stiffness_is_beyond_belief(wearer):
    """At most e^2 times what was found, or as little, however unsure it is."""
    name = "thigh.normal_stiffness"
    value = wearer.contact.values()[name]
    known = Posterior((name,), np.array([value]), np.array([[9.0 * value**2]]))
    unsure = replace(wearer, contact=replace(wearer.contact, posterior=known))
    found = [d.contact.values()[name] / value for d in drawn(unsure, 40)]
    assert max(found) == pytest.approx(np.exp(2.0))
    assert min(found) == pytest.approx(np.exp(-2.0))


def test_a_body_of_another_size_is_as_tables_have_it():
    """Tables are in proportion to height and mass; so is a body."""
    human = scale_human(70.0, 1.7)
    toes = replace(human.foot, mass_kg=0.3)
    human = replace(human, toes=toes, ball_m=(0.12, -0.05))
    found = Size("large", 1.1, 1.4).human(human)
    assert found.toes.mass_kg == pytest.approx(1.4 * 0.3)
    assert found.toes.length_m == pytest.approx(1.1 * toes.length_m)
    assert found.ball_m == pytest.approx((0.132, -0.055))
    expected = scale_human(1.4 * 70.0, 1.1 * 1.7)
    for name in ("foot", "shank", "thigh", "pelvis"):
        own, other = getattr(found, name), getattr(expected, name)
        for what in ("mass_kg", "com_m", "inertia_kg_m2", "length_m"):
            assert getattr(own, what) == pytest.approx(getattr(other, what))
    for what in ("ankle_height_m", "shank_cuff_m", "thigh_cuff_m"):
        assert getattr(found, what) == pytest.approx(getattr(expected, what))
    for what in ("heel_m", "toe_m"):
        longer = 1.1 * np.array(getattr(human, what))
        assert getattr(found, what) == pytest.approx(tuple(longer))
    assert found.height_m == pytest.approx(expected.height_m)


def resized(model, size):
    body = size.human(model.human)
    return replace(model, human=body, exoskeleton=fit_exoskeleton(body))


def test_a_body_of_another_size_obeys_the_same_physics(wearer):
    """Twice the mass and 1.1 times the height, standing still."""
    size = Size("large", 1.1, 2.0)
    human, model = wearer.model.human, resized(wearer.model, size)
    (own,) = wearer.trials
    still = replace(own, v=0.0 * own.v, a=0.0 * own.a)
    found = size.trial(still, model, human.ankle_height_m)
    np.testing.assert_allclose(found.ground.force_z, model.tree.weight)
    np.testing.assert_allclose(found.ground.force[:, 0], 0.0, atol=1e-8)
    ankle = model.human.ankle_height_m - human.ankle_height_m
    np.testing.assert_allclose(found.q[:, 1] - own.q[:, 1], ankle)
    # Over the middle of the foot, by the body's centre of mass.
    np.testing.assert_allclose(
        found.ground.cop_x, model.tree.center_of_mass(found.q)[:, 0]
    )
    q = still.q[:, :6]
    moments = [
        replace(m, kind="human", exoskeleton=None).tree.inverse_dynamics(
            q, 0.0 * q, 0.0 * q
        )[:, 3:]
        for m in (wearer.model, model)
    ]
    np.testing.assert_allclose(moments[1], 2.2 * moments[0])
    share = own.moment("exo_hip") * 2.2
    np.testing.assert_allclose(found.moment("exo_hip"), share, atol=1e-12)


def test_a_movement_of_another_body_is_in_balance(wearer):
    """Moments and ground together leave nothing over, but between the two."""
    size = Size("small", 0.9, 0.7)
    human, model = wearer.model.human, resized(wearer.model, size)
    (own,) = wearer.trials
    moved = replace(own, q=own.q + np.eye(9)[0] * 0.3)
    found = size.trial(moved, model, human.ankle_height_m)
    np.testing.assert_allclose(found.q[:, 0], 0.9 * 0.3, atol=1e-12)
    np.testing.assert_array_equal(found.q[:, 2:], own.q[:, 2:])
    for kind in ("v", "a"):
        before, after = getattr(own, kind), getattr(found, kind)
        np.testing.assert_allclose(after[:, :2], 0.9 * before[:, :2])
        np.testing.assert_array_equal(after[:, 2:], before[:, 2:])
    foot = {model.tree.root: found.ground}
    left = inverse_dynamics(model.tree, found.q, found.v, found.a, foot)
    np.testing.assert_allclose(left[:, :3], 0.0, atol=1e-9)
    left = left[:, 3:] - found.moments
    for joint in ("ankle", "knee", "hip"):
        both = [found.coordinates.joint(j) for j in (joint, f"exo_{joint}")]
        np.testing.assert_allclose(left[:, both].sum(axis=1), 0.0, atol=1e-9)
    assert found.cuffs == {} and found.mass_kg == model.human.mass_kg


@pytest.mark.parametrize(("law", "power"), [("simbody", 1), ("paper", 2 / 3)])
def test_contact_of_another_body_is_where_its_sole_is(wearer, law, power):
    """As high above the ground; so stiff that it sinks in as deep."""
    ground = replace(
        wearer.contact.ground,
        law=law,
        constants=None,
        spheres={"heel": ContactSphere(4e6, 1.5, -0.05, -0.06, 0.03)},
    )
    cuffs = {"thigh": BushingParameters(origin_x=0.02, origin_z=0.2)}
    contact = replace(wearer.contact, ground=ground, bushings=cuffs)
    found = Size("large", 1.1, 1.4).contact(contact, 0.08)
    heel = found.ground.spheres["heel"]
    assert heel.stiffness == pytest.approx(4e6 * 1.4**power)
    assert (heel.x, heel.radius) == pytest.approx((-0.055, 0.03))
    assert 1.1 * 0.08 + heel.z == pytest.approx(0.08 - 0.06)
    assert found.bushings["thigh"].origin == pytest.approx((0.022, 0.22))
    assert found.bushings["thigh"].stiffness == cuffs["thigh"].stiffness
    assert found.posterior is None


def as_given(model, trials, contact, settings):
    """An own movement that is not solved."""
    result = SimpleNamespace(success=True, trials=trials)
    return SimpleNamespace(solve=lambda on_iterate: result)


def test_a_population_has_its_heights_and_masses(wearer, monkeypatch):
    """Of each percentile a body, whose own movement is looked for."""
    monkeypatch.setattr(wearers, "OwnMovement", as_given)
    height, mass = wearer.model.human.height_m, wearer.model.human.mass_kg
    people = Population((height + 0.1, 0.08), (mass, 9.0), (5.0, 50.0))
    found = sized(wearer, people, PredictionSettings())
    for own, off in zip(found, (-1.644854, 0.0), strict=True):
        human = own.model.human
        assert human.height_m == pytest.approx(height + 0.1 + 0.08 * off)
        assert human.mass_kg == pytest.approx(mass + 9.0 * off)
        spheres = zip(
            own.contact.ground.spheres.values(),
            wearer.contact.ground.spheres.values(),
            strict=True,
        )
        for sphere, was in spheres:
            share = human.height_m / height
            assert sphere.x == pytest.approx(share * was.x)
            assert own.model.human.ankle_height_m + sphere.z == pytest.approx(
                wearer.model.human.ankle_height_m + was.z
            )
        assert own.model.exoskeleton == fit_exoskeleton(human)


def test_a_population_wears_the_study_s_device(wearer, monkeypatch):
    monkeypatch.setattr(wearers, "OwnMovement", as_given)
    device = wearer.model.exoskeleton
    heavy = replace(device, thigh=replace(device.thigh, mass_kg=11.0))
    wearer = replace(wearer, model=replace(wearer.model, exoskeleton=heavy))
    people = Population((1.5, 0.1), (60.0, 9.0), (50.0,))
    (found,) = sized(wearer, people, PredictionSettings())
    usual = fit_exoskeleton(found.model.human)
    thigh = replace(usual.thigh, mass_kg=11.0)
    assert found.model.exoskeleton == replace(usual, thigh=thigh)


@pytest.mark.parametrize("what", ["joints", "cuffs"])
def test_what_a_device_has_not_is_not_designed(wearer, what):
    freedom = {"joints": JointFreedom(), "cuffs": CuffFreedom()}[what]
    settings = DesignSettings(**{what: {"knee": freedom}})
    with pytest.raises(InputError, match=rf"design\.{what}\.knee: "):
        check_wearers([wearer], settings)


def test_wearers_wear_one_device():
    """Not two whose cuffs are called alike."""
    text = (models_path() / "hip_only.urdf").read_text()
    hip = Assembly(
        device=DeviceFile({"belt": "pelvis"}, Path("hip_only.urdf")),
        cuffs={"thigh": CuffLinks("thigh", "bar")},
    )
    models = [
        Model(brought_in(hip, text.replace("motor", joint)), nominal_human())
        for joint in ("motor", "drive")
    ]
    two = [Wearer(m.name, m, nominal_contact(m), ()) for m in models]
    with pytest.raises(InputError, match="the joints drive, but that of"):
        check_wearers(two, DesignSettings())


def test_bodies_are_at_their_percentiles():
    """Of a normal distribution: 5 % are smaller than 1.644854 SD below."""
    found = Population((1.70, 0.10), (70.0, 10.0), (5.0, 50.0, 97.5)).bodies()
    for (name, *sizes), score in zip(
        found, (-1.644854, 0.0, 1.959964), strict=True
    ):
        expected = [1.70 + 0.10 * score, 70.0 + 10.0 * score]
        assert sizes == pytest.approx(expected, rel=1e-6), name
    people = "height_m: [1.7, 0.1]\nmass_kg: [70, 10]\npercentiles: "
    schema.load_text(people + "[99]", Population)
    with pytest.raises(InputError, match="must be below 100"):
        schema.load_text(people + "[100]", Population)


def test_what_mats_show_is_one_where_nothing_measured_it():
    """A factor by cuff."""
    told = Wearer("somebody", None, None, (), differ={"thigh": 0.8})
    assert (told.shown("thigh"), told.shown("shank")) == (0.8, 1.0)
