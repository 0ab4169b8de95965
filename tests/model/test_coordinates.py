"""Names of coordinates, read from plants, and columns by name."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    PlanarJoint,
    RevoluteJoint,
    SpatialInertia,
    WeldJoint,
)

from drake_exo.errors import InputError
from drake_exo.model.coordinates import Coordinates, read_coordinates

ROOT = ("foot_x", "foot_z", "foot_pitch")
HUMAN = ("ankle", "knee", "hip")
DEVICE = ("exo_ankle", "exo_knee", "exo_hip")


@pytest.mark.parametrize(
    ("kind", "device"), [("human", ()), ("rigid", ()), ("coupled", DEVICE)]
)
def test_are_read_from_the_plant(nominal, kind, device):
    found = read_coordinates(nominal(kind).plant())
    assert found == nominal(kind).coordinates == nominal(kind).tree.coordinates
    assert found == Coordinates((*ROOT, *HUMAN, *device), device)
    assert found.root == ROOT
    assert found.joints == HUMAN + device
    assert found.human == HUMAN
    assert found.body == ROOT + HUMAN
    assert len(found) == nominal(kind).plant().num_positions()
    assert found.num_joints == len(found) - 3


def test_cuffs_are_where_two_links_move_against_each_other(nominal):
    assert nominal("coupled").tree.cuffs == {
        name: (name, f"exo_{name}") for name in ("shank", "thigh", "pelvis")
    }
    for kind in ("rigid", "human"):
        assert nominal(kind).tree.cuffs == {}


@pytest.fixture
def coupled(nominal):
    return nominal("coupled").coordinates


def test_columns(coupled):
    assert coupled.index("exo_ankle") == 6
    assert coupled.joint("exo_ankle") == 3
    np.testing.assert_array_equal(coupled.columns(["hip", "foot_x"]), [5, 0])
    np.testing.assert_array_equal(coupled.columns([]), np.empty(0, int))
    np.testing.assert_array_equal(coupled.root_columns, [0, 1, 2])
    np.testing.assert_array_equal(coupled.joint_columns, range(3, 9))
    np.testing.assert_array_equal(coupled.body_columns, range(6))
    np.testing.assert_array_equal(coupled.device_columns, [6, 7, 8])
    np.testing.assert_array_equal(
        coupled.is_device_joint, [False] * 3 + [True] * 3
    )
    np.testing.assert_array_equal(coupled.is_angle, [False] * 2 + [True] * 7)


def test_a_device_that_moves_as_the_human_does(coupled, nominal):
    body = np.arange(12.0).reshape(2, 6)
    found = coupled.aligned(body)
    np.testing.assert_array_equal(found, np.hstack([body, body[:, 3:]]))
    alone = nominal("human").coordinates
    np.testing.assert_array_equal(alone.aligned(body), body)
    assert [coupled.follows(name) for name in DEVICE] == list(HUMAN)


def test_follows_the_name_not_the_order():
    names = Coordinates((*ROOT, *HUMAN, "exo_hip", "exo_ankle"), DEVICE[::-2])
    body = np.arange(6.0)[None]
    np.testing.assert_array_equal(
        names.aligned(body), [[0, 1, 2, 3, 4, 5, 5, 3]]
    )


def test_a_device_s_hinge_may_lie_between_the_human_s():
    names = Coordinates(
        (*ROOT, "ankle_left", "exo_ankle_left", "ankle_right"),
        ("exo_ankle_left",),
    )
    np.testing.assert_array_equal(
        names.aligned(np.arange(5.0)[None]), [[0, 1, 2, 3, 3, 4]]
    )
    # Of hinges alone.
    found = names.joined(np.array([[7.0, 8.0]]), np.array([[9.0]]))
    np.testing.assert_array_equal(found, [[7, 9, 8]])


def test_unknown_names_are_refused(coupled):
    with pytest.raises(InputError, match=r"no coordinate 'toe'; known .*hip"):
        coupled.index("toe")
    with pytest.raises(InputError, match="no coordinate 'toe'"):
        coupled.joint("toe")
    with pytest.raises(InputError, match="no coordinate 'toe'"):
        coupled.columns(["hip", "toe"])
    with pytest.raises(InputError, match="did you mean 'exo_hip'"):
        coupled.index("exo_hpi")
    # As is what is no name, such as an index.
    for wrong in (1, 2.5, ["knee"]):
        with pytest.raises(InputError, match="there is no coordinate"):
            coupled.index(wrong)


def test_what_is_not_in_the_root_is_no_joint(coupled):
    with pytest.raises(
        InputError, match=r"'foot_x' is not a joint; known .*hip"
    ):
        coupled.joint("foot_x")


def test_a_joint_that_follows_nothing_is_refused():
    names = Coordinates((*ROOT, "ankle", "lift"), ("lift",))
    with pytest.raises(InputError, match=r"'lift' .* end in one of _ankle"):
        names.aligned(np.zeros((1, 4)))


def plant_of(root, joint):
    """A root on the ground and a link on it."""
    plant = MultibodyPlant(0.0)
    inertia = SpatialInertia.SolidCubeWithDensity(1e3, 0.1)
    base, link = (
        plant.AddRigidBody(name, inertia).body_frame()
        for name in ("base", "link")
    )
    plant.AddJoint(root("base", plant.world_frame(), base))
    plant.AddJoint(joint("joint", base, link))
    plant.Finalize()
    return plant


def hinge(name, parent, child):
    return RevoluteJoint(name, parent, child, [0.0, 1.0, 0.0])


def weld(name, parent, child):
    return WeldJoint(name, parent, child, RigidTransform())


def test_welds_have_no_coordinate():
    names = read_coordinates(plant_of(PlanarJoint, weld)).names
    assert names == ("base_x", "base_z", "base_pitch")


@pytest.mark.parametrize(
    ("root", "joint", "words"),
    [
        (hinge, weld, "joint 'base' of the root is not planar"),
        (PlanarJoint, BallRpyJoint, "joint 'joint' is not a hinge"),
    ],
)
def test_other_trees_are_refused(root, joint, words):
    with pytest.raises(ValueError, match=words):
        read_coordinates(plant_of(root, joint))


def test_lists_of_names_are_those_of_the_model(coupled):
    listed = Coordinates(list(coupled.names), list(coupled.device))
    assert listed == Coordinates(coupled.names, coupled.device)
    rows = np.eye(3)
    listed = replace(coupled, coupling=rows.tolist())
    assert listed == replace(coupled, coupling=tuple(map(tuple, rows)))
    assert coupled.names[:3] == listed.root
