import numpy as np
import pytest

from drake_exo.files import schema
from drake_exo.files.tables import PlateRecording
from drake_exo.measurement.sagittal import (
    Axes,
    PlanarWrench,
    external_loads,
    merge_plates,
    spatial_wrench,
)
from drake_exo.measurement.trial import CuffForce


def plate(force, point, torque=(0.0, 0.0, 0.0)):
    return PlateRecording(
        1, *(np.array([x], float) for x in (force, point, torque))
    )


def planar(plate, frame):
    return PlanarWrench.of_spatial(spatial_wrench(plate, frame))


@pytest.mark.parametrize(
    ("forward", "up", "left"),
    [("x", "y", (0, 0, -1)), ("-z", "y", (-1, 0, 0)), ("y", "z", (-1, 0, 0))],
)
def test_left_is_up_cross_forward(forward, up, left):
    frame = Axes(forward, up)
    np.testing.assert_allclose(frame.space(left), [0.0, 1.0, 0.0])
    np.testing.assert_allclose(np.linalg.det(frame.R_PL), 1.0)


@pytest.mark.parametrize("facing", [-180.0, -91.0, 0.0, 37.0, 180.0, 350.0])
def test_facing_is_to_the_left_seen_from_above(facing):
    text = f"{{forward: -z, up: y, facing_deg: {facing}}}"
    frame = schema.load_text(text, Axes)
    ahead = np.deg2rad(facing)
    direction = Axes("-z", "y").R_PL.T @ [np.cos(ahead), np.sin(ahead), 0.0]
    np.testing.assert_allclose(
        frame.space(direction), [1.0, 0.0, 0.0], atol=1e-15
    )
    np.testing.assert_allclose(frame.space([0.0, 1.0, 0.0]), [0.0, 0.0, 1.0])
    same = Axes.of(frame.R_PL)
    assert abs(same.facing_deg) <= 45.0
    np.testing.assert_allclose(same.R_PL, frame.R_PL, atol=1e-15)


def test_opensim_points():
    frame = Axes()
    np.testing.assert_allclose(frame.points([[1.0, 2.0, 3.0]]), [[1.0, 2.0]])
    np.testing.assert_allclose(
        Axes("-z", "y").points([1.0, 2.0, 3.0]), [-3.0, 2.0]
    )


def test_moment_is_z_fx_minus_x_fz():
    wrench = planar(plate((30.0, 600.0, 7.0), (0.2, 0.006, -0.5)), Axes())
    np.testing.assert_allclose(wrench.force, [[30.0, 600.0]])
    np.testing.assert_allclose(wrench.moment, 0.006 * 30.0 - 0.2 * 600.0)


def test_surface_height_moves_the_cop():
    # On a plate 6 mm above the floor the line of action meets z = 0 elsewhere.
    wrench = planar(plate((60.0, 600.0, 0.0), (0.2, 0.006, 0.0)), Axes())
    np.testing.assert_allclose(wrench.cop_x, 0.2 - 0.006 * 60.0 / 600.0)


def test_free_moment_about_the_lateral_axis_counts():
    # OpenSim's z points right, our y left: +5 about z is -5 about y.
    wrench = planar(
        plate((0.0, 500.0, 0.0), (0.1, 0.0, 0.0), (9.0, 9.0, 5.0)),
        Axes(),
    )
    np.testing.assert_allclose(wrench.moment, -0.1 * 500.0 - 5.0)
    np.testing.assert_allclose(wrench.cop_x, 0.11)


def test_no_cop_without_load():
    wrench = PlanarWrench(np.array([[0.0, 19.0], [0.0, 21.0]]), np.ones(2))
    cop = wrench.cop_x
    assert np.isnan(cop[0]) and cop[1] == pytest.approx(-1.0 / 21.0)


def test_shifting_load_between_staggered_feet_keeps_the_cop():
    # Feet 6 cm apart fore and aft, each loaded 5 cm before its ankle.
    ankles = {"left": 0.03, "right": -0.03}
    share = np.linspace(0.0, 1.0, 5)
    wrenches = {}
    for side, s in (("left", share), ("right", 1.0 - share)):
        F_z = 600.0 * s
        wrenches[side] = PlanarWrench(
            np.column_stack([0.1 * F_z, F_z]), -(ankles[side] + 0.05) * F_z
        )
    at = {side: np.array([[x, 0.0]]) for side, x in ankles.items()}
    merged, shifts = merge_plates(wrenches, at)
    np.testing.assert_allclose(merged.cop_x, 0.05)
    assert shifts == {"left": -0.03, "right": 0.03}
    np.testing.assert_allclose(merged.force, [[60.0, 600.0]] * 5)


def test_one_foot_counts_twice():
    wrench = PlanarWrench(np.array([[10.0, 300.0]]), np.array([-30.0]))
    at = np.array([[0.1, 0.0]])
    merged, shifts = merge_plates({"right": wrench}, {"right": at})
    np.testing.assert_allclose(merged.force, [[20.0, 600.0]])
    np.testing.assert_allclose(merged.cop_x, [0.1])
    assert shifts == {"right": 0.0}


def test_one_foot_on_a_plate_stands_for_both_about_both_ankles():
    """Its centre of pressure is 7 cm before its own ankle: before both's."""
    F_z = np.full(3, 350.0)
    wrench = PlanarWrench(np.column_stack([0.0 * F_z, F_z]), -0.10 * F_z)
    places = {"left": np.full((3, 2), 0.03), "right": np.full((3, 2), -0.03)}
    merged, shifts = merge_plates({"left": wrench}, places)
    np.testing.assert_allclose(merged.cop_x, 0.07)
    assert shifts == {"left": pytest.approx(-0.03)}
    np.testing.assert_allclose(merged.force_z, 700.0)
    alone, shifts = merge_plates({"left": wrench}, {"left": places["left"]})
    np.testing.assert_allclose(alone.cop_x, 0.10)
    assert shifts == {"left": 0.0}


def test_walking_force_pushes_back_then_forward(data_root):
    from drake_exo.files.opensim import read_plates

    path = data_root / "opencap_subject4/ID/walking1_grf.mot"
    time, plates = read_plates(path)
    left = planar(plates[2], Axes())
    stance = (time > 0.56) & (time < 1.18)
    cop = left.cop_x[stance]
    direction = np.sign(cop[-1] - cop[0])
    F_x = direction * left.force[stance, 0]
    half = len(F_x) // 2
    assert F_x[:half].mean() < -10.0 < 10.0 < F_x[half:].mean()


def test_rows_may_be_lists():
    wrench = PlanarWrench.of([[1.0, 700.0, -70.0], [2.0, 600.0, 0.0]])
    assert wrench.array.tolist() == [[1.0, 700.0, -70.0], [2.0, 600.0, 0.0]]
    assert CuffForce.of([[1.0, 2.0, 3.0]]).components.tolist() == [[1, 2, 3]]


def test_a_wrench_is_its_array():
    array = np.arange(12.0).reshape(4, 3)
    wrench = PlanarWrench.of(array)
    np.testing.assert_array_equal(wrench.array, array)
    assert wrench.force.shape == (4, 2) and wrench.moment.shape == (4,)


def test_external_loads_are_the_wrench():
    """Force, point below the centre of pressure, free moment; y up, z right."""
    wrench = PlanarWrench(np.array([[5.0, 700.0], [1, 15]]), np.array([-70, 3]))
    names, values = external_loads({"_r": wrench, "_l": wrench}, 0.5)
    assert names[:9] == [
        *(f"ground_force_r_{k}{a}" for k in "vp" for a in "xyz"),
        *(f"ground_torque_r_{a}" for a in "xyz"),
    ]
    assert names[9] == "ground_force_l_vx"
    for one in (values[:, :9], values[:, 9:]):
        assert one.tolist() == [
            [2.5, 350, 0, 0.1, 0, 0, 0, 0, 0],
            [0.5, 7.5, 0, 0, 0, 0, 0, 0, -1.5],
        ]


def test_centre_of_pressure_at_a_height():
    """On a seat, as on the ground, none is told where there is no load."""
    wrench = PlanarWrench.of([[60.0, 600.0, -90.0], [1.0, 19.0, 3.0]])
    at = wrench.cop_at(0.5)
    assert at[0] == pytest.approx(0.15 + 0.5 * 60.0 / 600.0)
    assert np.isnan(at[1])
