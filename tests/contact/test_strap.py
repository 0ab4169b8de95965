"""Cuffs as they are to be built: series of tissue and strap, places, files."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import Posterior, nominal_contact
from drake_exo.contact.strap import (
    SOFTEST_N_M,
    Assistance,
    CuffDesign,
    Design,
    Gains,
    JointDesign,
    device_sdf,
    in_series,
    links_above,
    read_design,
    splines,
    write_design,
)
from drake_exo.errors import InputError
from drake_exo.model.assembly import Assembly, CuffLinks, DeviceFile
from drake_exo.model.description import models_path, nominal_human
from drake_exo.model.device_file import brought_in
from drake_exo.model.plant import Model, nominal_model
from drake_exo.study import uncalibrated

MOVED = Design(
    {
        "thigh": CuffDesign(
            along_m=0.04,
            across_m=-0.01,
            strap_tangential_n_m=1500.0,
            strap_normal_n_m=8000.0,
            strap_rotational_nm_rad=20.0,
        )
    },
    {
        "exo_knee": Assistance((10.0, 90.0), (1.2, 0.8)),
        "exo_ankle": Assistance((), (1.1, 0.9, 1.0), "movement"),
    },
    {"exo_hip": JointDesign(0.01, -0.02)},
    {"exo_hip": Gains(0.9, 1.5, 4.0, 0.2)},
)


def test_links_beyond_a_joint_turn_with_it():
    """Also those that are fixed on, what cuffs hold, and from the other end."""
    text = (models_path() / "ankle_only.urdf").read_text()
    two = {
        "calf": CuffLinks("shank", "calf"),
        "low": CuffLinks("shank", "calf", (0.0, 0.1)),
    }
    device = DeviceFile({"shoe": "foot"}, Path("ankle_only.urdf"))
    swap = {"shoe": "calf", "calf": "shoe"}
    turned = re.sub(
        r'(<(?:parent|child) link=")(\w+)',
        lambda m: m[1] + swap[m[2]],
        text.replace("0 1 0", "0 -1 0"),
    )
    for written in (text, turned):
        assembly = brought_in(Assembly(device=device, cuffs=two), written)
        model = Model(assembly, nominal_human())
        found = links_above(model, "motor")
        assert found == ["calf", "calf_shell", "low_shell"]
        Design({"low": CuffDesign(removed=True)}).check(model)
        gone = dict.fromkeys(two, CuffDesign(removed=True))
        with pytest.raises(InputError, match="calf and low nothing holds"):
            Design(gone).check(model)


@pytest.fixture
def contact(nominal):
    return nominal_contact(nominal("coupled"))


def test_two_springs_in_a_row_deflect_as_both():
    tissue, strap, force = 4000.0, 1500.0, 30.0
    together = force / tissue + force / strap
    assert force / in_series(tissue, strap) == pytest.approx(together)


def test_a_strap_never_stiffens_and_none_changes_nothing():
    for strap in np.geomspace(SOFTEST_N_M, 1e9, 9):
        assert in_series(3000.0, strap) < 3000.0
    assert in_series(3000.0, None) == 3000.0
    assert in_series(0.0, 2000.0) == 0.0
    cuff = BushingParameters(origin_x=0.01, origin_z=0.2)
    assert CuffDesign().built(cuff) == cuff


def test_tissue_goes_along(contact):
    """A cuff built with a strap holds the tissue that was found."""
    built = MOVED.contact(contact).bushings["thigh"]
    own = contact.bushings["thigh"]
    assert built.origin_z == pytest.approx(own.origin_z + 0.04)
    assert built.origin_x == pytest.approx(own.origin_x - 0.01)
    straps = (1500.0, 8000.0, 20.0)
    for now, before, strap in zip(
        built.stiffness, own.stiffness, straps, strict=True
    ):
        assert 1.0 / now - 1.0 / strap == pytest.approx(1.0 / before)
    assert built.damping == own.damping
    for cuff in ("shank", "pelvis"):
        expected = contact.bushings[cuff]
        assert MOVED.contact(contact).bushings[cuff] == expected


def test_what_is_not_known_follows_by_derivatives(contact):
    names = ("thigh.origin_z", "thigh.normal_stiffness", "skin.thigh.knee")
    spread = np.diag([0.01, 900.0, 0.02])
    root = spread @ np.array([[1.0, 0, 0], [0.4, 0.9, 0], [0.1, 0.2, 0.9]])
    values = [contact.values().get(n, 0.0) for n in names]
    known = Posterior(names, np.array(values), root @ root.T)
    found = MOVED.contact(replace(contact, posterior=known)).posterior
    h, slope = 1e-3, [1.0, 0.0, 1.0]
    up, down = (
        MOVED.contact(
            contact.with_values({"thigh.normal_stiffness": values[1] + s * h})
        ).bushings["thigh"]
        for s in (1.0, -1.0)
    )
    slope[1] = (up.normal_stiffness - down.normal_stiffness) / (2.0 * h)
    expected = np.outer(slope, slope) * known.covariance
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6)
    assert found.values[0] == pytest.approx(values[0] + 0.04)
    assert found.values[2] == 0.0


def test_files_hold_designs(tmp_path):
    write_design(tmp_path, MOVED)
    assert read_design(tmp_path) == MOVED
    assert read_design(tmp_path / "design.yaml") == MOVED


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cuffs: {thigh: {strap_normal_n_m: 10}}", "at least 1000 N/m"),
        ("cuffs: {thigh: {along: 0.1}}", "did you mean 'along_m'"),
        ("\n", "design.yaml: is empty; write the design again"),
        ("# What is to be built\n\n", "design.yaml: is empty; write"),
        (
            "assistance: {exo_knee: {angle_deg: [9, 3], factor: [1, 1]}}",
            "angle_deg does not increase",
        ),
        (
            "assistance: {exo_knee: {angle_deg: [1, 3], factor: [1]}}",
            "1 factors at 2 angles",
        ),
        (
            "assistance: {exo_knee: {angle_deg: [1], factor: [-1]}}",
            "factor.0. is -1",
        ),
        ("gains: {exo_knee: {stiffness_nm_rad: -1}}", "at least 0 N m/rad"),
        ("gains: {exo_knee: {support: 110}}", "support is 110, but must be at"),
        (
            "assistance: {exo_knee: {factor: [130]}}",
            "factor.0. is 130, but must be at most 50",
        ),
        ("cuffs: {thigh: {area: 150}}", "area is 150, but must be at most 50"),
        ("gains: {exo_knee: {support: 1, spring: 2}}", "unknown key 'spring'"),
        ("gains: {exo_knee: {}}\nassistance: {exo_knee: {}}", "keep one"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path, text, said):
    (tmp_path / "design.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_design(tmp_path)


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match=r"design\.yaml: cannot be read"):
        read_design(tmp_path)


def test_a_design_of_another_device_is_refused(nominal):
    MOVED.check(nominal("coupled"))
    with pytest.raises(InputError, match=r"cuffs\.thigh"):
        MOVED.check(nominal("human"))
    for what, design in (
        ("assistance", Design(assistance={"exo_toe": Assistance()})),
        ("joints", Design(joints={"exo_toe": JointDesign()})),
        ("gains", Design(gains={"exo_toe": Gains()})),
    ):
        with pytest.raises(InputError, match=rf"{what}\.exo_toe"):
            design.check(nominal("coupled"))


@pytest.mark.parametrize(
    "moved",
    [
        {"along_m": 0.5},
        {"along_m": -0.45},
        {"across_m": 0.3},
        {"preload_across_m": 0.3},
        {"along_m": 0.2, "preload_along_m": 0.2},
    ],
)
def test_a_design_with_a_cuff_off_its_limb_is_refused(nominal, moved):
    design = Design({"thigh": CuffDesign(**moved)})
    with pytest.raises(InputError, match=r"cuffs\.thigh: .* off the thigh"):
        design.check(nominal("coupled"))


def test_area_makes_tissue_stiffer_and_known_likewise(contact):
    """Springs side by side; in rotation the lever grows, too."""
    values = contact.values()
    names = ("thigh.normal_stiffness", "thigh.rotational_stiffness")
    middle = np.array([values[n] for n in names])
    known = Posterior(names, middle, np.diag((0.1 * middle) ** 2))
    sure = replace(contact, posterior=known)
    wide = Design({"thigh": CuffDesign(area=1.5, strap_normal_n_m=9000.0)})
    built = wide.contact(sure)
    thigh, own = built.bushings["thigh"], contact.bushings["thigh"]
    assert thigh.rotational_stiffness == 1.5**2 * own.rotational_stiffness
    expected = in_series(1.5 * own.normal_stiffness, 9000.0)
    assert thigh.normal_stiffness == pytest.approx(expected)
    h = 1.0
    more = wide.contact(contact.with_values({names[0]: middle[0] + h}))
    slope = (more.values()[names[0]] - expected) / h
    sd = np.sqrt(np.diag(built.posterior.covariance))
    assert sd[0] == pytest.approx(slope * 0.1 * middle[0], rel=1e-3)
    assert sd[1] == pytest.approx(1.5**2 * 0.1 * middle[1])


def test_a_slide_takes_its_share_of_the_spring_away(contact):
    """And of what is not known of it; a free one leaves nothing of both."""
    name = "thigh.tangential_stiffness"
    middle = contact.values()[name]
    known = Posterior((name,), np.array([middle]), np.array([[100.0]]))
    sure = replace(contact, posterior=known)
    strap = {"strap_tangential_n_m": 2000.0}
    half, free = (
        Design({"thigh": CuffDesign(slide=s, **strap)}).contact(sure)
        for s in (0.5, 1.0)
    )
    whole = in_series(middle, 2000.0)
    assert half.values()[name] == pytest.approx(0.5 * whole)
    sd = np.sqrt(half.posterior.covariance.item())
    assert sd == pytest.approx(10.0 * 0.5 * (whole / middle) ** 2)
    assert free.values()[name] == 0.0
    assert free.posterior.covariance.item() == 0.0
    thigh, own = free.bushings["thigh"], contact.bushings["thigh"]
    assert thigh.rotational_stiffness == own.rotational_stiffness


def test_joints_and_cuffs_move_in_the_file_that_is_built(nominal):
    model = nominal("coupled")
    design = Design(
        {"shank": CuffDesign(along_m=0.03, preload_across_m=-0.004)},
        joints={"exo_hip": JointDesign(0.01, -0.02)},
    )
    plant = design.model(model).plant()
    for frame, link, moved in (
        ("exo_shank_cuff", "exo_shank", (-0.004, 0.03)),
        ("exo_hip_centre", "exo_thigh", (-0.02, 0.01)),
        ("exo_knee_centre", "exo_shank", (0.0, 0.0)),
    ):
        now, before = (
            p.GetFrameByName(frame)
            .CalcPose(p.CreateDefaultContext(), p.GetFrameByName(link))
            .translation()
            for p in (plant, model.plant())
        )
        np.testing.assert_allclose((now - before)[[0, 2]], moved, atol=1e-12)
    alone = nominal("human")
    assert Design().model(alone) is alone


def test_factors_are_linear_between_angles_and_constant_beyond():
    angles = np.deg2rad([[-30.0, 0.0], [50.0, 0.0], [70.0, 5.0], [120.0, 1.0]])
    today, rates = np.ones_like(angles), np.zeros_like(angles)
    joints = ["exo_knee", "exo_hip"]
    found = MOVED.torques(joints, today, angles, rates, 0.5)
    np.testing.assert_allclose(found[:, 0], [1.2, 1.0, 0.9, 0.8])
    # The hip's are gains.
    np.testing.assert_allclose(found[:, 1], 2.4 - 4.0 * angles[:, 1])


def test_a_spline_over_the_movement():
    """Cubic: what it can be is found again, and factors bound it."""
    share = np.linspace(-0.1, 1.1, 400)
    inside = (share >= 0.0) & (share <= 1.0)
    weights = splines(6, share)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert (weights >= -1e-12).all()
    # Any cubic over the whole movement is one of these splines.
    wanted = 1.0 + 0.3 * share - 0.5 * share**2 + 0.2 * share**3
    fit, *_ = np.linalg.lstsq(weights[inside], wanted[inside], rcond=None)
    np.testing.assert_allclose(weights[inside] @ fit, wanted[inside])
    # Before and after, what it begins and ends with.
    assist = Assistance((), tuple(fit), "movement")
    found = assist.torque(np.ones(400), np.zeros(400), 0.0, share)
    np.testing.assert_allclose(found[share < 0.0], 1.0)
    np.testing.assert_allclose(found[share > 1.0], 1.0)
    assert splines(1, 0.3) == pytest.approx(1.0)
    for angles, over, words in (
        ((1.0,), "movement", "leave angle_deg empty"),
        ((), "angle", "1 factors at 0 angles"),
    ):
        with pytest.raises(InputError, match=words):
            Assistance(angles, (1.0,), over)


LESS = Design({"shank": CuffDesign(removed=True, along_m=0.02)})


def test_a_cuff_that_is_left_out_is_not_there(nominal, contact):
    """Nor is what was known of it; what is known of others stays."""
    names = ("shank.normal_stiffness", "thigh.normal_stiffness", "heel.x")
    values = contact.values()
    middle = np.array([values[n] for n in names])
    spread = np.array([[9.0, 3.0, 1.0], [3.0, 4.0, 0.5], [1.0, 0.5, 2.0]])
    sure = replace(contact, posterior=Posterior(names, middle, spread))
    built = LESS.contact(sure)
    assert set(built.bushings) == {"thigh", "pelvis"}
    assert built.bushings["thigh"] == contact.bushings["thigh"]
    assert built.posterior.names == names[1:]
    np.testing.assert_array_equal(built.posterior.covariance, spread[1:, 1:])
    model = nominal("coupled")
    worn = LESS.model(model)
    assert list(worn.cuffs) == ["thigh", "pelvis"]
    assert worn.exoskeleton == model.exoskeleton
    # How the device is worn stays, so that a rigid one is what it was.
    q = np.array([[0.1, 0.9, 0.05, 0.2, 0.9, 0.7]])
    rest = np.zeros_like(q)
    np.testing.assert_allclose(
        worn.rigid.tree.inverse_dynamics(q, rest, rest),
        model.rigid.tree.inverse_dynamics(q, rest, rest),
        atol=1e-9,
    )


def test_the_file_that_is_built_has_no_cuff_there(nominal):
    own, text = (device_sdf(nominal("coupled"), d) for d in (Design(), LESS))
    for name in ("exo_shank_cuff", "_calf_strap", "_shin_guard"):
        assert name in own and name not in text
    assert "exo_thigh_cuff" in text and "_thigh_strap" in text
    joints = re.compile('joint name="([a-z_]*)"')
    assert joints.findall(text) == joints.findall(own)


@pytest.mark.parametrize(
    ("removed", "joint"),
    [(("pelvis",), "exo_hip"), (("shank", "thigh", "pelvis"), "exo_")],
)
def test_a_device_that_nothing_holds_is_refused(nominal, removed, joint):
    none = Design(dict.fromkeys(removed, CuffDesign(removed=True)))
    with pytest.raises(InputError, match=f"pelvis.*beyond {joint}"):
        none.check(nominal("coupled"))
    LESS.check(nominal("coupled"))


def test_files_say_which_cuff_is_left_out(tmp_path):
    write_design(tmp_path, LESS)
    assert read_design(tmp_path) == LESS
    (tmp_path / "design.yaml").write_text("cuffs: {shank: {removed: 1}}")
    with pytest.raises(InputError, match="removed"):
        read_design(tmp_path)


def test_a_design_s_device_has_its_cuffs_where_they_are_built(nominal):
    """Moved, and shifted on the device's half alone; joints, too."""
    model = nominal("coupled")
    thigh = CuffDesign(
        along_m=0.02,
        across_m=0.01,
        preload_along_m=0.005,
        preload_across_m=0.003,
    )
    joint = JointDesign(along_m=0.015, across_m=-0.01)
    design = Design({"thigh": thigh}, joints={"exo_hip": joint})
    built, own = design.model(model).exoskeleton, model.exoskeleton
    x, z = own.thigh_cuff_m
    assert built.thigh_cuff_m == pytest.approx((x + 0.013, z + 0.025))
    x, z = own.hip_off_m
    assert built.hip_off_m == pytest.approx((x - 0.01, z + 0.015))
    assert built.shank_cuff_m == own.shank_cuff_m
    cuff = design.contact(nominal_contact(model)).bushings["thigh"]
    was = nominal_contact(model).bushings["thigh"]
    assert np.subtract(cuff.origin, was.origin) == pytest.approx((0.01, 0.02))
    shift = np.subtract(cuff.preload[:2], was.preload[:2])
    assert shift == pytest.approx((0.003, 0.005))


def test_what_a_design_is_compared_with_is_worn_as_it_is():
    """Nominal cuffs where the design has them, as slack as the design's."""
    model, moved = nominal_model(), replace(MOVED, joints={})
    own = nominal_contact(model)
    usual = moved.contact(uncalibrated(model, own))
    made = build_diagram(moved.model(model), usual)
    context = made.diagram.CreateDefaultContext()
    off = made.diagram.GetOutputPort("deflections").Eval(context)
    np.testing.assert_allclose(off, 0.0, atol=1e-12)
    place = np.add(own.bushings["thigh"].origin, (-0.01, 0.04))
    assert usual.bushings["thigh"].origin == pytest.approx(tuple(place))
