"""A subject out of quiet standing: each step against mechanics."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement import processing, subject
from drake_exo.measurement.sagittal import Axes, PlanarWrench
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.description import nominal_exoskeleton, nominal_human
from drake_exo.model.plant import Model
from drake_exo.model.segments import (
    CONTACT_RADIUS_M,
    CUFFED,
    SEGMENTS,
    HumanOverrides,
    SegmentOverrides,
    SegmentParameters,
    with_overrides,
)

HUMAN = nominal_human()


def stood(height=0.09, angles=(0.04, 0.10)):
    """A marker model of two feet that stand at angles, and their poses."""
    segments = ("pelvis", "foot_left", "foot_right")
    model = SimpleNamespace(
        ankle_height_m=height,
        sides=("left", "right"),
        lengths_m={"shank": 0.45, "thigh": 0.40},
        index=lambda s, side: segments.index(f"{s}_{side}"),
    )
    poses = SimpleNamespace(angles=np.array([[0.5, *angles]]))
    return model, poses


def test_a_modelled_person_has_its_mass_and_soles_on_the_floor():
    """A foot that leans by 0.07 rad has its spheres there all the same."""
    toes = SegmentParameters(0.2, (0.03, 0.0), 1e-4, 0.07)
    human = replace(HUMAN, toes=toes)
    model, poses = stood()
    found = subject._as_modelled(human, 2.0 * human.mass_kg, model, poses)
    assert found.mass_kg == pytest.approx(2.0 * human.mass_kg)
    for name in (*SEGMENTS, "toes"):
        own, other = getattr(found, name), getattr(human, name)
        assert own.mass_kg == pytest.approx(2.0 * other.mass_kg)
        assert own.inertia_kg_m2 == pytest.approx(2.0 * other.inertia_kg_m2)
        assert (own.length_m, own.com_m) == (other.length_m, other.com_m)
    assert found.ankle_height_m == 0.09
    for key in ("heel_m", "toe_m"):
        stands = complex(*getattr(found, key)) * np.exp(0.07j)
        assert 0.09 + stands.imag == pytest.approx(CONTACT_RADIUS_M)
        assert stands.real == pytest.approx(getattr(human, key)[0])


@pytest.mark.parametrize("com", [(0.2, 0.0), (0.0, -0.24), (0.0, 1.2)])
def test_a_centre_of_mass_off_its_segment_is_refused(com):
    given = HumanOverrides(thigh=SegmentOverrides(com_m=com))
    human = with_overrides(HUMAN, given, "subject.segments")
    with pytest.raises(InputError, match=r"segments\.thigh\.com_m is .* 0\.4"):
        subject._check_centres(given, human)
    subject._check_centres(HumanOverrides(), human)
    for name in CUFFED:
        own = {name: SegmentOverrides(com_m=getattr(HUMAN, name).com_m)}
        subject._check_centres(HumanOverrides(**own), HUMAN)


def test_a_measured_ankle_raises_all_that_is_below_it():
    found = subject._raised(HUMAN, 0.09)
    assert found.ankle_height_m == 0.09
    for key in ("heel_m", "toe_m"):
        x, z = getattr(found, key)
        assert x == getattr(HUMAN, key)[0]
        assert 0.09 + z == pytest.approx(CONTACT_RADIUS_M)
    # The foot's centre of mass stays at its share of the height.
    x, z = found.foot.com_m
    assert x == HUMAN.foot.com_m[0]
    assert z / 0.09 == pytest.approx(HUMAN.foot.com_m[1] / HUMAN.ankle_height_m)


@pytest.mark.parametrize("height", [0.019, 0.021, 0.299, 0.301])
def test_ankles_are_between_2_and_30_cm(height):
    if 0.02 < height < 0.3:
        subject._check_height("s.trc", height)
        return
    with pytest.raises(InputError, match=r"^s\.trc: .* m above the floor"):
        subject._check_height("s.trc", height)


def test_an_unknown_body_mass_names_the_file():
    settings = SimpleNamespace(
        assembly=SimpleNamespace(is_fitted=False, device=None),
        subject=SimpleNamespace(mass_kg=None),
        standing=SimpleNamespace(markers="s.trc", forces=None),
    )
    with pytest.raises(InputError, match=r"^s\.trc: the body mass is unknown"):
        subject._body_mass(settings, None, {}, None)


@pytest.mark.parametrize("kind", ["human", "coupled"])
def test_a_trunk_is_moved_until_standing_is_in_balance(kind):
    """With the device, which does not move."""
    device = nominal_exoskeleton() if kind == "coupled" else None
    model = Model(kind, HUMAN, device)
    q = np.zeros((1, 6))
    q[0, 3:] = 0.1, 0.15, 0.05
    com = model.rigid.tree.center_of_mass(q)[0, 0]
    settings = SimpleNamespace(standing=SimpleNamespace(forces="s.mot"))
    for ahead in (0.03, -0.05):
        cop = com + ahead
        wrench = PlanarWrench.of(np.array([[0.0, 700.0, -cop * 700.0]]))
        report = {}
        moved = subject._over_the_cop(settings, model, q, wrench, report)
        found = Model(kind, moved, device).rigid.tree.center_of_mass(q)[0, 0]
        # The trunk leans by 0.1 - 0.15 + 0.05 = 0: its x is forward.
        assert found == pytest.approx(cop, abs=1e-9)
        shift = moved.pelvis.com_m[0] - HUMAN.pelvis.com_m[0]
        assert report["trunk_com_shift_m"] == pytest.approx(shift)
    far = com + 0.3
    wrench = PlanarWrench.of(np.array([[0.0, 700.0, -far * 700.0]]))
    with pytest.raises(InputError, match="marker_axes and force_axes"):
        subject._over_the_cop(settings, model, q, wrench, {})


def weighed(assembly, stated, force):
    settings = SimpleNamespace(
        assembly=assembly,
        exoskeleton=None,
        gravity_m_s2=10.0,
        subject=SimpleNamespace(mass_kg=stated),
        standing=SimpleNamespace(forces="s.mot"),
    )
    wrench = PlanarWrench.of(np.array([[0.0, force, 0.0]]))
    report = {}
    return subject._body_mass(settings, wrench, report, None), report


def test_a_body_weighs_what_plates_bear_less_the_device():
    mass, report = weighed(Assembly(), None, 650.0)
    assert mass == report["standing_mass_kg"] == pytest.approx(65.0)
    assert report["mass_from"] == "standing"
    worn = SimpleNamespace(is_fitted=True, device=None)
    mass, report = weighed(worn, None, 850.0)
    own = nominal_exoskeleton().mass_kg
    assert mass == pytest.approx(85.0 - own) and own > 5.0
    mass, report = weighed(Assembly(), 70.0, 650.0)
    assert (mass, report["mass_from"]) == (70.0, "study")
    assert report["standing_mass_kg"] == pytest.approx(65.0)


def test_standing_is_from_its_start_to_its_end():
    time = np.arange(10) / 10.0
    for start, end, count in (
        (None, None, 10),
        (0.2, None, 8),
        (0.2, 0.5, 4),
        (np.nextafter(0.2, 1.0), np.nextafter(0.5, 0.0), 4),
    ):
        standing = SimpleNamespace(start_s=start, end_s=end)
        assert subject._inside(time, standing).sum() == count


def test_the_ball_of_a_measured_foot_is_a_spheres_radius_above_the_floor():
    """In front of the ankle as tables say."""
    settings = SimpleNamespace(
        assembly=Assembly(Person("two", "hinged")),
        subject=SimpleNamespace(height_m=1.75, sex="male", segments=None),
    )
    p = np.zeros((3, 2, 3))
    p[..., 2] = [0.08, 0.10]
    ankles = SimpleNamespace(left=("L",), right=("R",))
    markers = SimpleNamespace(joint_centres=SimpleNamespace(ankle=ankles))
    standing = SimpleNamespace(of=lambda names: p)
    x, z = subject._ball(settings, markers, standing, Axes("x", "z"), None)
    assert z == pytest.approx(CONTACT_RADIUS_M - 0.09)
    assert 0.1 < x < 0.2


def test_plates_are_timed_while_they_bear_half_the_body(monkeypatch):
    """Where nobody rises: only what is known of the movement."""
    time = np.arange(6) / 10.0
    F_z = np.array([0.0, 340.0, 360.0, 700.0, 700.0, 0.0])
    motion = SimpleNamespace(
        time=time, known=np.array([1, 1, 1, 1, 0, 1], bool)
    )
    rigid = SimpleNamespace(tree=SimpleNamespace(weight=700.0))
    forces = SimpleNamespace(
        total=lambda feet: F_z, at=lambda t: {},
        delayed=lambda lag: forces, source="f.mot",
    )  # fmt: skip
    said = []
    monkeypatch.setattr(processing, "needed_force", lambda *_: 2.0 * F_z)
    monkeypatch.setattr(processing, "_seating", lambda *_: ())
    monkeypatch.setattr(processing, "find_rises", lambda *_: [])
    monkeypatch.setattr(
        processing, "force_delay", lambda *x: said.append(x) or 0.01
    )
    lab = SimpleNamespace(largest_delay_s=0.2)
    assert processing._force_delay(motion, forces, rigid, lab) == 0.01
    np.testing.assert_array_equal(said[0][3], [0, 0, 1, 1, 0, 0])
    assert said[0][4] == 0.2


def test_seat_off_is_found_on_the_clock_that_is_found(monkeypatch):
    """Forces 40 ms late begin elsewhere: again, until a millisecond is left."""
    forces = SimpleNamespace(
        total=lambda feet: 0.0, at=lambda t: {},
        delayed=lambda lag: lag,
    )  # fmt: skip
    by_lag = {0.0: 0.056, 0.056: 0.05, 0.05: 0.048, 0.048: 0.049}
    monkeypatch.setattr(processing, "needed_force", lambda *_: 0.0)
    monkeypatch.setattr(processing, "_borne_by_feet", lambda m, lag, r: lag)
    monkeypatch.setattr(
        processing, "force_delay", lambda t, n, F_z, used, reach: by_lag[used]
    )
    lab, motion = (SimpleNamespace(largest_delay_s=0.1, time=np.zeros(2)),) * 2
    assert processing._force_delay(motion, forces, None, lab) == 0.049


@pytest.mark.parametrize("late", [0.05, 0.0484, 0.0486, -0.0486, 0.02])
def test_a_lag_at_the_end_of_its_search_is_told(late):
    """Within a step and a half of a millisecond."""
    said = processing._said(late, SimpleNamespace(largest_delay_s=0.05))
    assert said.startswith(f"estimated {1e3 * late:+.0f} ms")
    assert ("edge of the search" in said) == (abs(late) > 0.0485)
