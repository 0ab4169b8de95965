"""Cuffs as they are to be built: series of tissue and strap, places, files."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import Posterior, nominal_contact
from drake_exo.contact.strap import (
    SOFTEST_N_M,
    Assistance,
    CuffDesign,
    Design,
    in_series,
    read_design,
    write_design,
)
from drake_exo.errors import InputError

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
    {"exo_knee": Assistance((10.0, 90.0), (1.2, 0.8))},
)


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
        ("cuffs: {thigh: {strap_normal_n_m: 10}}", "1000"),
        ("cuffs: {thigh: {along: 0.1}}", "along_m"),
        (
            "assistance: {exo_knee: {angle_deg: [9, 3], factor: [1, 1]}}",
            "order",
        ),
        ("assistance: {exo_knee: {angle_deg: [1, 3], factor: [1]}}", "each"),
        ("assistance: {exo_knee: {angle_deg: [1], factor: [-1]}}", "factor"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path, text, said):
    (tmp_path / "design.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_design(tmp_path)


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match=r"design\.yaml"):
        read_design(tmp_path)


def test_a_design_of_another_device_is_refused():
    with pytest.raises(InputError, match=r"cuffs\.thigh"):
        MOVED.check(["shank"], ["exo_knee"])
    with pytest.raises(InputError, match=r"assistance\.exo_knee"):
        MOVED.check(["thigh"], ["exo_hip"])


def test_factors_are_linear_between_angles_and_constant_beyond():
    angles = np.deg2rad([[-30.0, 0.0], [50.0, 0.0], [70.0, 5.0], [120.0, 1.0]])
    found = MOVED.factors(["exo_knee", "exo_hip"], angles)
    np.testing.assert_allclose(found[:, 0], [1.2, 1.0, 0.9, 0.8])
    np.testing.assert_array_equal(found[:, 1], 1.0)
