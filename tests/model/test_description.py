import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from drake_exo.model import description
from drake_exo.model.assembly import Person
from drake_exo.model.description import (
    ball_m,
    body_width,
    exoskeleton_sdf,
    fit_exoskeleton,
    human_sdf,
    models_path,
    nominal_exoskeleton,
    nominal_human,
    soles,
)
from drake_exo.model.segments import (
    SEGMENTS,
    ExoskeletonOverrides,
    SegmentOverrides,
    scale_human,
)


def numbers(element):
    return [float(v) for v in element.text.split()]


def all_numbers(text):
    """Every number of a model, with where it stands."""
    for element in ET.fromstring(text).iter():
        values = (element.text or "").split()
        if values and element.tag not in ("diffuse", "uri"):
            yield element.tag, [float(v) for v in values]


@pytest.mark.parametrize(
    ("name", "rewritten"),
    [
        ("human.sdf", lambda: human_sdf(nominal_human())),
        ("exoskeleton.sdf", lambda: exoskeleton_sdf(nominal_exoskeleton())),
    ],
)
def test_model_files_already_hold_the_nominal_numbers(name, rewritten):
    written = list(all_numbers((models_path() / name).read_text()))
    expected = list(all_numbers(rewritten()))
    assert len(written) == len(expected) > 50
    for (tag, a), (other, b) in zip(written, expected, strict=True):
        assert tag == other
        assert a == pytest.approx(b, rel=1e-8, abs=1e-9)


def test_nominal_exoskeleton_fits_the_nominal_human():
    fitted = fit_exoskeleton(nominal_human())
    nominal = nominal_exoskeleton()
    for name in SEGMENTS:
        a, b = getattr(fitted, name), getattr(nominal, name)
        assert a.length_m == pytest.approx(b.length_m, abs=1e-9)
        assert a.com_m == pytest.approx(b.com_m, abs=1e-9)
        assert a.mass_kg == b.mass_kg
    assert fitted.heel_m == pytest.approx(nominal.heel_m, abs=1e-9)
    assert fitted.pelvis_cuff_m == pytest.approx(nominal.pelvis_cuff_m)


def test_exoskeleton_follows_the_wearer():
    human = scale_human(95.0, 1.95)
    device = fit_exoskeleton(human)
    assert device.shank.length_m == human.shank.length_m
    assert device.thigh.length_m == human.thigh.length_m
    assert device.thigh_cuff_m == human.thigh_cuff_m
    # The plate's thickness lies between the human's soles and the device's.
    thickness = human.heel_m[1] - device.heel_m[1]
    assert thickness == pytest.approx(0.022)
    assert device.heel_m[0] == pytest.approx(human.heel_m[0])
    ratio = human.shank.length_m / nominal_human().shank.length_m
    assert device.shank.inertia_kg_m2 == pytest.approx(
        nominal_exoskeleton().shank.inertia_kg_m2 * ratio**2
    )


def test_exoskeleton_overrides():
    human = nominal_human()
    device = fit_exoskeleton(
        human,
        ExoskeletonOverrides(
            pelvis=SegmentOverrides(mass_kg=8.5), toe_m=(0.15, -0.05)
        ),
    )
    assert device.pelvis.mass_kg == 8.5
    assert device.toe_m == (0.15, -0.05)


def test_visuals_reach_from_joint_to_joint_of_a_tall_subject():
    human = scale_human(90.0, 2.0)
    model = ET.fromstring(human_sdf(human))
    nominal = ET.fromstring(human_sdf(nominal_human()))
    for name in ("shank", "thigh"):
        ratio = getattr(human, name).length_m / (
            getattr(nominal_human(), name).length_m
        )
        tall, usual = (
            m.findall(f"model/link[@name='{name}']/visual/pose")
            for m in (model, nominal)
        )
        assert len(tall) == len(usual) > 0
        for a, b in zip(tall, usual, strict=True):
            assert numbers(a)[2] == pytest.approx(ratio * numbers(b)[2])


def test_heavier_subjects_are_drawn_wider():
    assert body_width(nominal_human()) == 1.0
    assert body_width(scale_human(140.0, 1.75)) == pytest.approx(np.sqrt(2))
    slim, stout = (
        ET.fromstring(human_sdf(scale_human(mass, 1.75)))
        for mass in (50.0, 120.0)
    )
    path = "model/link[@name='thigh']/visual[@name='left_thigh']/pose"
    assert numbers(stout.find(path))[1] > numbers(slim.find(path))[1] > 0


def test_turned_visuals_stretch_along_the_links_axes():
    """A strut's motor is a cylinder across: length along y, radius x and z."""
    tall = scale_human(95.0, 1.95)
    device = fit_exoskeleton(tall)
    path = "model/link[@name='exo_shank']/visual[@name='left_ankle_motor']"
    wide, usual = (
        ET.fromstring(exoskeleton_sdf(d, w)).find(path + "/geometry/cylinder")
        for d, w in ((device, 1.3), (nominal_exoskeleton(), 1.0))
    )
    ratio = device.shank.length_m / nominal_exoskeleton().shank.length_m
    length = numbers(wide.find("length"))[0] / numbers(usual.find("length"))[0]
    radius = numbers(wide.find("radius"))[0] / numbers(usual.find("radius"))[0]
    assert length == pytest.approx(1.3)
    assert radius == pytest.approx(np.sqrt(1.3 * ratio))


def test_a_plate_grows_with_the_foot():
    """Inertia as its length squared; heel and toe under the wearer's."""
    human = scale_human(95.0, 1.95)
    device, nominal = fit_exoskeleton(human), nominal_exoskeleton()
    ratio = human.foot.length_m / nominal_human().foot.length_m
    drop = nominal_human().ankle_height_m - human.ankle_height_m
    assert ratio > 1.05
    assert device.foot.inertia_kg_m2 == pytest.approx(
        nominal.foot.inertia_kg_m2 * ratio**2
    )
    assert device.foot.length_m == pytest.approx(nominal.foot.length_m * ratio)
    for what in ("heel_m", "toe_m"):
        x, z = getattr(nominal, what)
        assert getattr(device, what) == pytest.approx((x * ratio, z + drop))
    x, z = nominal.foot.com_m
    assert device.foot.com_m == pytest.approx((x * ratio, z + drop))
    for name in ("shank", "thigh"):
        ratio = getattr(human, name).length_m / (
            getattr(nominal_human(), name).length_m
        )
        own, usual = getattr(device, name), getattr(nominal, name)
        assert own.mass_kg == usual.mass_kg
        x, z = usual.com_m
        assert own.com_m == pytest.approx((x, z * ratio))


def test_a_body_of_one_density_is_as_wide_as_its_mass_asks_for():
    """Mass over height: over density it is the area across."""
    tall, short = scale_human(80.0, 2.0), scale_human(80.0, 1.6)
    ratio = body_width(short) / body_width(tall)
    assert ratio == pytest.approx(np.sqrt(2.0 / 1.6))


def test_cuffs_are_drawn_where_they_hold_the_limb():
    """As far from their frame as usual, by the stretch of the link."""
    human, width = scale_human(90.0, 1.9), 1.3
    device = replace(
        fit_exoskeleton(human),
        thigh_cuff_m=(0.03, 0.31),
        pelvis_cuff_m=(0.01, 0.2),
    )
    nominal = nominal_exoskeleton()
    drawn, usual = (
        ET.fromstring(text)
        for text in (
            exoskeleton_sdf(device, width),
            exoskeleton_sdf(nominal),
        )
    )
    for name, ending in (
        ("thigh", "_thigh_strap"),
        ("pelvis", "belt"),
        ("shank", "_calf_strap"),
    ):
        z = getattr(device, name).length_m / getattr(nominal, name).length_m
        found = 0
        for own, other in zip(
            drawn.findall(f"model/link[@name='exo_{name}']/visual"),
            usual.findall(f"model/link[@name='exo_{name}']/visual"),
            strict=True,
        ):
            if not own.get("name").endswith(ending):
                continue
            found += 1
            places = [
                np.array(numbers(v.find("pose")))[[0, 2]] for v in (own, other)
            ]
            off = places[0] - device.cuff_m(name)
            was = places[1] - nominal.cuff_m(name)
            np.testing.assert_allclose(off, was * [width, z], atol=1e-9)
        assert found


def test_spheres_of_a_foot_with_toes():
    """The toes' from their hinge; ahead of it in the foot it is the same."""
    human = nominal_human()
    rigid = soles(human, Person("one"))["foot"]
    assert rigid["toe"] == human.toe_m and rigid["heel"] == human.heel_m
    two = soles(human, Person("two", "hinged"))
    assert set(two) == {
        f"{b}_{s}" for b in ("foot", "toes") for s in ("left", "right")
    }
    ball = ball_m(human)
    assert ball == pytest.approx((0.5 * human.foot.length_m, human.toe_m[1]))
    toe = np.add(two["toes_left"]["toe"], ball)
    assert tuple(toe) == pytest.approx(human.toe_m)
    assert two["foot_left"]["ball"] == pytest.approx(
        (0.47 * human.foot.length_m, human.toe_m[1])
    )


def test_a_sole_has_some_depth():
    nominal = nominal_exoskeleton()
    assert description._sole_depth(nominal) == -nominal.heel_m[1]
    raised = replace(nominal, heel_m=(-0.05, 0.02))
    assert description._sole_depth(raised) == 0.01


@pytest.mark.parametrize(
    "sdf",
    [
        lambda drawn: human_sdf(scale_human(80.0, 1.8), Person("two"), drawn),
        lambda drawn: exoskeleton_sdf(nominal_exoskeleton(), 1.1, drawn),
    ],
)
def test_what_is_not_drawn_lacks_visuals_alone(sdf):
    whole, bare = (ET.fromstring(sdf(drawn)) for drawn in (True, False))
    visuals = [
        (link, v) for link in whole.iter("link") for v in link.findall("visual")
    ]
    for link, visual in visuals:
        link.remove(visual)

    def told(model):
        return [(e.tag, e.attrib, (e.text or "").split()) for e in model.iter()]

    assert visuals and told(bare) == told(whole)
