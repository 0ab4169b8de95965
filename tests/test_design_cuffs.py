"""How many cuffs a design has, and whether they hold the device."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo import designing
from drake_exo.calibration.settings import CuffFreedom, DesignSettings
from drake_exo.calibration.wearers import hold
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import nominal_contact
from drake_exo.contact.strap import CuffDesign, Design
from drake_exo.designed import Designed
from drake_exo.errors import InputError
from drake_exo.model.plant import nominal_model

CUFFS = ("shank", "thigh", "pelvis")


def design(without=(), norm=1.0, removable=CUFFS, stopped=False, alike=False):
    """As much of a design as is looked at."""
    settings = DesignSettings(
        cuffs={c: CuffFreedom(removable=True) for c in removable},
        symmetric=alike,
    )
    model = SimpleNamespace(cuffs=dict.fromkeys((*CUFFS, *removable)))
    return SimpleNamespace(
        norm_n=norm,
        design=None,
        solution=SimpleNamespace(was_stopped=stopped, success=not stopped),
        settings=settings,
        problem=SimpleNamespace(
            settings=settings,
            wearers=[SimpleNamespace(model=model)],
            without=tuple(without),
        ),
    )


@pytest.fixture
def norms(monkeypatch):
    """Cuffs left out -> norm in the forecast; there is no other design."""
    table = {}

    def without(found, without):
        norm = table.get(frozenset(without))
        if norm is None:
            raise InputError("it hangs loose")
        stopped = norm == "stopped"
        return design(without, 0.0 if stopped else norm, stopped=stopped)

    held = SimpleNamespace(stiffness=1.0)
    monkeypatch.setattr(designing, "_without", without)
    monkeypatch.setattr(Designed, "held", held)
    monkeypatch.setattr(
        Designed, "forecast_n", property(lambda made: made.after["norm"])
    )

    def given(pairs=(), **known):
        table.update(pairs)
        table.update({frozenset(k.split("_")): v for k, v in known.items()})

    return given


def built(found):
    """Promised is 0.5 less than what is forecast."""
    if "nobody" in str(found.norm_n):
        raise InputError("nobody moves so")
    if found.norm_n == "interrupted":
        raise KeyboardInterrupt
    return {"norm": found.norm_n + 0.5}


def fewer(found):
    """The best of it, and all that were tried."""
    whole = Designed(found.settings, None, found, {}, built(found))
    made = designing.fewer(whole, built)
    assert made.stopped == any("stopped" in t.why_not for t in made.tried)
    return made.found, list(made.tried)


def test_the_best_is_kept_and_less_is_tried_from_there(norms):
    norms(shank=0.8, thigh=0.6, shank_thigh=0.5)
    best, tried = fewer(design())
    assert set(best.problem.without) == {"shank", "thigh"}
    assert [t.without for t in tried] == [
        (),
        ("shank",),
        ("thigh",),
        ("pelvis",),
        ("thigh", "shank"),
        ("thigh", "pelvis"),
        ("thigh", "shank", "pelvis"),
    ]
    assert [t.norm_n for t in tried] == [1.0, 0.8, 0.6, None, 0.5, None, None]
    assert [t.forecast_n for t in tried[:3]] == [1.5, 1.3, 1.1]
    assert tried[3].why_not == "it hangs loose"


def test_a_cuff_that_buys_nothing_by_its_absence_stays(norms):
    norms(shank=1.0, thigh=1.2)
    best, tried = fewer(design())
    assert best.problem.without == ()
    assert len(tried) == 4


def test_one_that_nobody_can_move_on_is_none(norms):
    """However little it promised."""
    norms(shank="nobody")
    best, tried = fewer(design())
    assert best.problem.without == ()
    assert tried[1].why_not == "nobody moves so"


def test_only_what_may_be_removed_is_tried(norms):
    norms(shank=0.5, thigh=0.1)
    best, tried = fewer(design(removable=("shank",)))
    assert best.problem.without == ("shank",)
    assert [t.without for t in tried] == [(), ("shank",)]
    whole = design(removable=())
    assert fewer(whole) == (whole, [])


def test_of_a_symmetric_design_both_of_a_pair_are_left_out(norms):
    pair = frozenset({"calf_left", "calf_right"})
    norms({pair: 0.6, pair | {"shank"}: 0.4}, shank=0.8, calf=0.1)
    whole = design(removable=("shank", *pair), alike=True)
    best, tried = fewer(whole)
    assert set(best.problem.without) == pair | {"shank"}
    assert [set(t.without) for t in tried] == [
        set(), {"shank"}, pair, pair | {"shank"}
    ]  # fmt: skip
    assert tried[2].name == "calf_left and calf_right"


@pytest.mark.parametrize("how", ["stopped", "interrupted"])
def test_stopped_it_keeps_the_best_so_far(norms, how):
    """In a solve, or in the forecast after it."""
    norms(shank=0.8, thigh=0.9, shank_thigh=how)
    best, tried = fewer(design())
    assert best.problem.without == ("shank",)
    assert [t.without for t in tried][-2:] == [("pelvis",), ("shank", "thigh")]
    assert tried[-1].why_not == "stopped by the user"


def test_stopped_among_rivals_it_keeps_the_best_of_them(norms):
    norms(shank=0.3, thigh="stopped", pelvis=0.2)
    best, _ = fewer(design())
    assert best.problem.without == ("shank",)
    norms(shank=1.3)
    best, _ = fewer(design())
    assert best.problem.without == ()


# Of 9: foot, then ankle, knee, hip, then the device's, a little off.
BENT = np.deg2rad([0.0, 0.0, 2.0, 18.0, 85.0, 70.0, 19.0, 83.0, 71.0])
# The last is the loosest by its second mode alone.
LOW = np.deg2rad([0.0, 0.0, 2.0, 18.0, 40.0, 85.0, 19.0, 42.0, 83.0])
POSTURES = np.array([BENT, 0.3 * BENT, LOW])


def bent(model, contact, springs=0.0):
    """As much of a wearer as is looked at."""
    return SimpleNamespace(
        model=model,
        contact=contact,
        trials=[SimpleNamespace(q=POSTURES)],
        springs=springs,
    )


def least(model, contact):
    """Of the second differences of the energy by the device's joints.

    That of gravity and the cuffs' springs, by the systems of a diagram.
    """
    built = build_diagram(model, contact)
    context = built.diagram.CreateDefaultContext()
    own = built.plant_context(context)

    def energy(q):
        built.plant.SetPositions(own, q)
        springs = built.diagram.GetOutputPort("energies").Eval(context)
        return built.plant.CalcPotentialEnergy(own) + springs.sum()

    h, found = 1e-3, []
    steps = h * np.eye(9)[6:]
    for q in POSTURES:
        H = np.array(
            [
                [
                    sum(
                        a * b * energy(q + a * s + b * t)
                        for a in (1, -1)
                        for b in (1, -1)
                    )
                    for s in steps
                ]
                for t in steps
            ]
        )
        found.append(np.linalg.eigvalsh(H / (4.0 * h * h))[0])
    return min(found)


@pytest.mark.slow
@pytest.mark.parametrize("removed", [(), ("shank",), ("shank", "thigh")])
def test_curvature_is_that_of_the_energy_in_drake(removed):
    fewer = Design(dict.fromkeys(removed, CuffDesign(removed=True)))
    model = nominal_model("coupled")
    contact = fewer.contact(nominal_contact(model))
    model = fewer.model(model)
    held = hold(bent(model, contact))
    expected = least(model, contact)
    assert held.stiffness == pytest.approx(expected, rel=1e-3, abs=0.05)


def test_a_link_that_no_cuff_holds_falls():
    model = nominal_model("coupled")
    contact = nominal_contact(model)
    whole = hold(bent(model, contact))
    contact.bushings.pop("pelvis")
    loose = hold(bent(model, contact))
    assert whole.stiffness > 0.0 > loose.stiffness
    assert loose.joint == "exo_hip"
    # A spring across that joint alone holds it instead.
    springs = [0.0, 0.0, 500.0]
    held = hold(bent(model, contact, springs))
    assert held.stiffness > 0.0
    more = hold(bent(model, contact, 10.0)).stiffness
    assert more == pytest.approx(loose.stiffness + 10.0)
