"""How many cuffs a design has: which are tried, which one is chosen."""

from types import SimpleNamespace

import pytest

from drake_exo.calibration import design_cuffs
from drake_exo.calibration.design_cuffs import Tried, fewer
from drake_exo.calibration.settings import CuffFreedom, DesignSettings

CUFFS = ("shank", "thigh", "pelvis")


def design(without=(), norm=1.0, removable=CUFFS, stopped=False):
    """As much of a design as is looked at."""
    settings = DesignSettings(
        cuffs={c: CuffFreedom(removable=True) for c in removable}
    )
    model = SimpleNamespace(cuffs=dict.fromkeys(CUFFS))
    return SimpleNamespace(
        norm_n=norm,
        design=None,
        solution=SimpleNamespace(was_stopped=stopped, success=not stopped),
        problem=SimpleNamespace(
            settings=settings,
            wearers=[SimpleNamespace(model=model)],
            without=tuple(without),
        ),
    )


@pytest.fixture
def norms(monkeypatch):
    """Cuffs left out -> norm; there is no other design."""
    table = {}

    def attempt(found, without, watch):
        norm = table.get(frozenset(without))
        if norm is None:
            return Tried(without, None, why_not="it hangs loose"), None
        stopped = norm == "stopped"
        rival = design(without, 0.0 if stopped else norm, stopped=stopped)
        return Tried(without, rival.norm_n), rival

    monkeypatch.setattr(design_cuffs, "_attempt", attempt)

    def given(**known):
        table.update({frozenset(k.split("_")): v for k, v in known.items()})

    return given


def test_the_best_is_kept_and_less_is_tried_from_there(norms):
    norms(shank=0.8, thigh=0.6, shank_thigh=0.5)
    best, tried = fewer(design(), None)
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
    assert tried[3].why_not == "it hangs loose"


def test_a_cuff_that_buys_nothing_by_its_absence_stays(norms):
    norms(shank=1.0, thigh=1.2)
    best, tried = fewer(design(), None)
    assert best.problem.without == ()
    assert len(tried) == 4


def test_only_what_may_be_removed_is_tried(norms):
    norms(shank=0.5, thigh=0.1)
    best, tried = fewer(design(removable=("shank",)), None)
    assert best.problem.without == ("shank",)
    assert [t.without for t in tried] == [(), ("shank",)]
    whole = design(removable=())
    assert fewer(whole, None) == (whole, [])


def test_stopped_it_keeps_the_best_so_far(norms):
    norms(shank=0.8, thigh=0.9, shank_thigh="stopped")
    best, tried = fewer(design(), None)
    assert best.problem.without == ("shank",)
    assert [t.without for t in tried][-1] == ("pelvis",)
