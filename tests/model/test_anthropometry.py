import csv

import pytest

from drake_exo.errors import InputError
from drake_exo.model import segments
from drake_exo.model.segments import (
    DE_LEVA,
    MEAN_HEIGHT_MM,
    SEGMENTS,
    SHOULDER_HEIGHT_MM,
    VERTEX_HEIGHT_MM,
    HumanOverrides,
    SegmentOverrides,
    scale_human,
    with_overrides,
)

SEXES = ("male", "female")


def rows_of_numbers(path):
    with open(path, newline="") as file:
        return [[float(cell) for cell in row] for row in csv.reader(file)]


@pytest.mark.parametrize("sex", SEXES)
def test_masses_agree_with_zatsiorsky_seluyanov(data_root, sex):
    path = data_root / f"anthropometry/scaled-mass/zats-selu1979{sex[0]}.csv"
    with open(path, newline="") as file:
        table = {row[0]: float(row[1]) for row in list(csv.reader(file))[1:]}
    names = {
        "headneck": "head",
        "arm": "upper_arm",
        "forearm": "forearm",
        "hand": "hand",
        "thigh": "thigh",
        "leg": "shank",
        "foot": "foot",
    }
    for theirs, ours in names.items():
        # The tables round men's arm to 2.70 and forearm to 1.63.
        assert DE_LEVA[sex][ours].mass == pytest.approx(
            table[theirs], abs=0.0101
        )
    trunk = sum(
        table[name]
        for name in ("trunk", "thorax", "abdo", "pelvis")
        if name in table
    )
    assert DE_LEVA[sex]["trunk"].mass == pytest.approx(trunk, abs=0.0101)


@pytest.mark.parametrize("sex", SEXES)
def test_lengths_and_gyration_agree_with_the_tables(data_root, sex):
    folder = data_root / "anthropometry/zats-tables"
    table = rows_of_numbers(folder / f"zats-mean-{sex}-comgyr.csv")
    lines = {
        "head": 0,
        "trunk": 1,
        "upper_arm": 5,
        "forearm": 6,
        "hand": 7,
        "thigh": 8,
        "shank": 9,
        "foot": 10,
    }
    for name, line in lines.items():
        length, com, _, transverse, _ = table[line]
        row = DE_LEVA[sex][name]
        if (sex, name) == ("female", "shank"):
            # The digits are swapped there: only with 432.3 mm does the centre
            # of mass lie where the row from the knee to the lateral malleolus
            # (line 19) puts it.
            assert length == 423.3
            other = table[19]
            assert row.length * row.com == pytest.approx(
                other[0] * other[1], rel=5e-4
            )
            assert length * com != pytest.approx(other[0] * other[1], rel=5e-3)
        else:
            assert row.length == length
        assert (row.com, row.gyration) == (com, transverse)
    assert VERTEX_HEIGHT_MM[sex] == table[11][0] + table[12][0]
    assert SHOULDER_HEIGHT_MM[sex] == table[13][0]


@pytest.mark.parametrize("sex", SEXES)
def test_every_row_adds_up_to_the_whole_body(sex):
    rows = DE_LEVA[sex]
    total = sum(
        row.mass * (1 if name in ("head", "trunk") else 2)
        for name, row in rows.items()
    )
    assert total == pytest.approx(100.0, abs=0.011)


@pytest.mark.parametrize("sex", SEXES)
def test_segments_add_up_to_the_subject(sex):
    human = scale_human(62.6, 1.68, sex)
    assert human.mass_kg == pytest.approx(62.6, rel=1e-14)
    assert human.height_m == pytest.approx(1.68, rel=1e-14)


def test_thigh_by_hand():
    thigh = scale_human(73.0, 1.741, "male").thigh
    assert thigh.mass_kg == pytest.approx(2 * 0.1416 * 73.0)
    assert thigh.length_m == pytest.approx(0.4222)
    assert thigh.com_m == (0.0, pytest.approx((1 - 0.4095) * 0.4222))
    assert thigh.inertia_kg_m2 == pytest.approx(
        2 * 0.1416 * 73.0 * (0.329 * 0.4222) ** 2
    )


def test_upper_body_centre_of_mass_and_inertia_by_point_masses():
    """Steiner's theorem with the men's pieces, heights written out in mm."""
    pieces = [  # mass %, height of the centre of mass, radius of gyration
        (6.94, 846.2 - 0.5976 * 203.3, 0.376 * 203.3),
        (43.46, 531.9 * (1 - 0.4486), 0.347 * 531.9),
        (2 * 2.71, 515.5 - 0.5772 * 281.7, 0.269 * 281.7),
        (2 * 1.62, 233.8 - 0.4574 * 268.9, 0.265 * 268.9),
        (2 * 0.61, -35.1 - 0.79 * 86.2, 0.513 * 86.2),
    ]
    share = sum(p[0] for p in pieces)
    com = sum(p[0] * p[1] for p in pieces) / share
    inertia = sum(p[0] * (p[2] ** 2 + (p[1] - com) ** 2) for p in pieces)
    pelvis = scale_human(100.0, 1.741, "male").pelvis
    assert pelvis.mass_kg == pytest.approx(share)
    assert pelvis.com_m == (0.0, pytest.approx(com / 1000))
    assert pelvis.inertia_kg_m2 == pytest.approx(inertia / 1e6)


def test_doubled_height_doubles_lengths_and_quadruples_inertias():
    small, tall = scale_human(80.0, 1.2), scale_human(80.0, 2.4)
    for name in SEGMENTS:
        a, b = getattr(small, name), getattr(tall, name)
        assert b.length_m == pytest.approx(2 * a.length_m)
        assert b.com_m == pytest.approx(tuple(2 * c for c in a.com_m))
        assert b.mass_kg == pytest.approx(a.mass_kg)
        assert b.inertia_kg_m2 == pytest.approx(4 * a.inertia_kg_m2)


def test_spheres_lie_under_heel_and_toes():
    """Ankle at 0; the heel's back is 22 % of the foot behind it."""
    human = scale_human(70.0, 1.75)
    length = human.foot.length_m
    back, front = -0.22 * length, 0.78 * length
    for (x, z), low, high in (
        (human.heel_m, back, 0.0),
        (human.toe_m, 0.5 * length, front),
    ):
        assert low < x < high
        assert -human.ankle_height_m < z < 0.0
    assert human.heel_m[0] == pytest.approx(-0.173 * length)
    assert human.toe_m[0] == pytest.approx(0.636 * length)


@pytest.mark.parametrize(
    ("sex", "share", "vertex"),
    [("male", 0.4415, 846.2), ("female", 0.4014, 858.5)],
)
def test_feet_and_head_by_hand(sex, share, vertex):
    """De Leva's shares from the heel, which is 22 % behind the ankle."""
    human = scale_human(70.0, 1.75, sex)
    length = human.foot.length_m
    assert human.foot.com_m == pytest.approx(
        ((share - 0.22) * length, -0.5 * 0.039 * 1.75)
    )
    assert human.ankle_height_m == pytest.approx(0.039 * 1.75)
    assert segments.VERTEX_HEIGHT_MM[sex] == pytest.approx(vertex)
    assert segments.CUFFED == ("shank", "thigh", "pelvis")


@pytest.mark.parametrize("sex", SEXES)
def test_mean_subject_has_plausible_joint_heights(sex):
    human = scale_human(70.0, MEAN_HEIGHT_MM[sex] / 1000, sex)
    knee = human.ankle_height_m + human.shank.length_m
    hip = knee + human.thigh.length_m
    assert 0.27 < knee / human.height_m < 0.30  # Winter: 0.285
    assert 0.49 < hip / human.height_m < 0.54  # Winter: 0.530


def test_overrides_replace_single_values_only():
    base = scale_human(70.0, 1.75)
    found = with_overrides(
        base,
        HumanOverrides(
            shank=SegmentOverrides(mass_kg=6.5), heel_m=(-0.05, -0.06)
        ),
        "human",
    )
    assert found.shank.mass_kg == 6.5
    assert found.shank.length_m == base.shank.length_m
    assert found.heel_m == (-0.05, -0.06)
    assert found.thigh == base.thigh


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"shank": SegmentOverrides(mass_kg=0.0)}, "shank.*above 0 kg"),
        ({"shank": SegmentOverrides(mass_kg="6")}, r"a number \[kg\]"),
        ({"heel_m": ("a", "b")}, r"heel_m must be a number \[m\]"),
        ({"toe_m": (0.1, float("nan"))}, "toe_m.*finite"),
        ({"thigh_cuff_m": (0.0, 250.0)}, "thigh_cuff_m is 250, .* most 3 m"),
        (
            {"shank": SegmentOverrides(inertia_kg_m2=60.0)},
            r"human\.shank: inertia_kg_m2 60 of .* kg is that of a ring of",
        ),
        ({"shank": SegmentOverrides(length_m=430.0)}, "length_m.*most 3 m"),
    ],
)
def test_impossible_overrides_are_refused(overrides, words):
    with pytest.raises(InputError, match=words):
        with_overrides(
            scale_human(70.0, 1.75), HumanOverrides(**overrides), "human"
        )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, 1.75), "mass_kg"),
        ((-70.0, 1.75), "mass_kg"),
        ((float("nan"), 1.75), "mass_kg"),
        ((70000.0, 1.75), "kilograms"),
        ((70.0, 175.0), "give metres"),
        ((70.0, 0.0), "height_m"),
        ((20.0, 2.2), "body mass index"),
        ((70.0, 1.75, "unknown"), "male or female"),
    ],
)
def test_impossible_subjects_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        scale_human(*arguments)
