"""A contact as a set of named values."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.contact.bushing import CALIBRATED
from drake_exo.contact.parameters import (
    SPHERE_PARAMETERS,
    ContactModel,
    ContactParameter,
    nominal_contact,
)
from drake_exo.errors import InputError
from drake_exo.model.assembly import Assembly, Person


@pytest.fixture(params=["paper", "simbody"])
def contact(request, nominal):
    return nominal_contact(nominal("coupled"), request.param)


def test_nominal_contact_is_the_same_ground_for_both_laws(nominal):
    model = nominal("coupled")
    paper, simbody = (
        nominal_contact(model, law).ground for law in ("paper", "simbody")
    )
    assert paper.spheres["toe"].x == model.exoskeleton.toe_m[0]
    modulus = (2.0 * paper.spheres["heel"].stiffness) ** 1.5
    assert modulus == pytest.approx(simbody.spheres["heel"].stiffness)


def test_nominal_contact_touches_where_there_are_cuffs(nominal):
    assert list(nominal_contact(nominal("coupled")).bushings) == [
        "shank",
        "thigh",
        "pelvis",
    ]
    for kind in ("human", "rigid"):
        assert nominal_contact(nominal(kind)).bushings == {}


def test_spheres_of_another_foot_are_refused(nominal):
    stiff = nominal("human")
    bent = replace(stiff, kind=Assembly(Person(toes="hinged")))
    ground = nominal_contact(bent).ground
    assert {b: list(g.spheres) for b, g in ground.under(bent).items()} == {
        "foot": ["heel", "ball"],
        "toes": ["toe"],
    }
    with pytest.raises(
        InputError, match="heel, toe, but the model has heel, ball"
    ):
        nominal_contact(stiff).ground.under(bent)


def test_values_name_spheres_and_what_is_calibrated_of_bushings(contact):
    values = contact.values()
    assert list(values) == [
        *(f"{s}.{k}" for s in ("heel", "toe") for k in SPHERE_PARAMETERS),
        *(f"{c}.{k}" for c in ("shank", "thigh", "pelvis") for k in CALIBRATED),
    ]
    assert values["toe.x"] == contact.ground.spheres["toe"].x
    assert values["thigh.origin_z"] == contact.bushings["thigh"].origin_z
    assert all(type(value) is float for value in values.values())


def test_values_come_back(contact):
    changed = {n: 1.5 * x + 0.25 for n, x in contact.values().items()}
    found = contact.with_values(changed)
    assert found.values() == changed
    assert found.with_values(contact.values()) == contact
    # What is not named stays: damping, law and constants, other spheres.
    one = contact.with_values({"heel.radius": 0.04, "shank.origin_x": 0.01})
    assert one.ground.spheres["heel"].radius == 0.04
    assert one.ground.spheres["toe"] == contact.ground.spheres["toe"]
    assert one.ground.constants == contact.ground.constants
    assert one.bushings["shank"] == replace(
        contact.bushings["shank"], origin_x=0.01
    )


def test_every_value_has_its_unit(contact):
    units = contact.units()
    assert list(units) == list(contact.values())
    law = contact.ground.law
    stiffness = {"paper": "(N/m^2)^(2/3)", "simbody": "N/m^2"}[law]
    assert units["heel.stiffness"] == stiffness
    assert units["toe.dissipation"] == "s/m"
    assert units["pelvis.rotational_stiffness"] == "N m/rad"
    assert units["pelvis.normal_stiffness"] == "N/m"


def test_fixed_parameters_of_one_group(contact):
    found = contact.fixed("heel")
    assert [p.name for p in found] == [f"heel.{k}" for k in SPHERE_PARAMETERS]
    for p in found:
        assert not p.free
        assert p.lower == p.nominal == p.upper == contact.values()[p.name]
        assert p.unit == contact.units()[p.name]
    with pytest.raises(InputError, match="no 'hee'"):
        contact.fixed("hee")


def test_scaling_changes_bushings_alone(contact):
    scaled = contact.scaled(1.4)
    assert scaled.ground == contact.ground
    for name, bushing in contact.bushings.items():
        assert scaled.bushings[name] == bushing.scaled(1.4)
    before, after = contact.values(), scaled.values()
    ratios = {n: after[n] / before[n] for n in before if n.endswith("ness")}
    cuffs = [r for n, r in ratios.items() if n.split(".")[0] in scaled.bushings]
    np.testing.assert_allclose(cuffs, 1.4)
    alone = ContactModel(contact.ground)
    assert alone.scaled(1.4) == alone


@pytest.mark.parametrize(
    ("values", "words"),
    [((1.0, 2.0, 1.0), "lower bound 2 is not"), ((3.0, 1.0, 2.0), "nominal 3")],
)
def test_parameters_lie_within_their_bounds(values, words):
    with pytest.raises(InputError, match=rf"heel\.x \[m\]: {words}"):
        ContactParameter("heel.x", "m", *values)
    known = ContactParameter.fixed("heel.x", "m", 0.1)
    assert known.span == 0.0 and not known.free
