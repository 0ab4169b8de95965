import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.opensim import write_table
from drake_exo.files.tables import Table, write_csv_table
from drake_exo.measurement.exoskeleton import (
    drive_moments,
    read_angles,
    read_moments,
)
from drake_exo.measurement.settings import Device, Filter, JointDrive

EXO_JOINTS = ("exo_ankle", "exo_knee", "exo_hip")
FILTER = Filter()
TIME = np.arange(400) / 200.0
ANGLES = 0.6 * np.column_stack(
    [1.0 - np.cos(TIME), np.sin(TIME), np.cos(0.5 * TIME)]
)
INNER = slice(60, -60)  # the filter's ends are left out


def moment_names(ending=""):
    return tuple(f"{joint}_moment{ending}" for joint in EXO_JOINTS)


def test_mot_and_csv_say_the_same(tmp_path):
    degrees = Table(TIME, EXO_JOINTS, np.rad2deg(ANGLES), True)
    write_table(tmp_path / "e.mot", degrees)
    write_csv_table(
        tmp_path / "e.csv", Table(TIME, EXO_JOINTS, ANGLES), ["deg"] * 3
    )
    a = read_angles(tmp_path / "e.mot", EXO_JOINTS, "both", FILTER)
    b = read_angles(tmp_path / "e.csv", EXO_JOINTS, "both", FILTER)
    np.testing.assert_allclose(a.values, b.values, atol=1e-9)
    np.testing.assert_allclose(a.values[INNER], ANGLES[INNER], atol=2e-4)
    assert a.one_leg is None


def test_moments_stand_beside_angles_in_degrees(tmp_path):
    """Moments stay what they are when angles become radians."""
    moments = 30.0 * ANGLES
    table = Table(
        TIME,
        (*EXO_JOINTS, *moment_names()),
        np.hstack([np.rad2deg(ANGLES), moments]),
        True,
    )
    write_table(tmp_path / "e.mot", table)
    angles = read_angles(tmp_path / "e.mot", EXO_JOINTS, "both", FILTER)
    found = read_moments(tmp_path / "e.mot", EXO_JOINTS, "both", FILTER)
    np.testing.assert_allclose(angles.values[INNER], ANGLES[INNER], atol=2e-4)
    np.testing.assert_allclose(found.values[INNER], moments[INNER], atol=6e-3)


def test_joints_are_angles_whatever_their_names_end_in(tmp_path):
    """hip_y turns about y; slides and moments beside it stay what they are."""
    names = ("hip_y", "knee_z_left", "knee_z_right", "hip_y_slide")
    values = np.rad2deg(ANGLES[:, [0, 1, 1, 2]])
    write_table(tmp_path / "e.mot", Table(TIME, names, values, True))
    found = read_angles(tmp_path / "e.mot", ("hip_y", "knee_z"), "both", FILTER)
    np.testing.assert_allclose(
        found.values[INNER], ANGLES[INNER, :2], atol=2e-4
    )
    small = np.column_stack([1e-3 * ANGLES[:, 0], values[:, 1:]])
    write_table(tmp_path / "e.mot", Table(TIME, names, small, False))
    with pytest.raises(InputError, match="can only be degrees"):
        read_angles(tmp_path / "e.mot", ("hip_y", "knee_z"), "both", FILTER)


def test_legs_are_averaged_added_or_doubled(tmp_path):
    left, right = ANGLES, 3.0 * ANGLES
    for ending, read in (("", read_angles), ("_moment", read_moments)):
        names = [
            f"{joint}{ending}_{side}"
            for side in ("left", "right")
            for joint in EXO_JOINTS
        ]
        unit = "Nm" if ending else "rad"
        path = tmp_path / f"both{ending}.csv"
        table = Table(TIME, tuple(names), np.hstack([left, right]))
        write_csv_table(path, table, [unit] * 6)
        total = 2.0 if ending else 1.0
        for legs, mean in (("both", 2.0), ("left", 1.0), ("right", 3.0)):
            signal = read(path, EXO_JOINTS, legs, FILTER)
            expected = total * mean * ANGLES
            np.testing.assert_allclose(
                signal.values[INNER], expected[INNER], atol=3e-6
            )
            assert signal.one_leg == (None if legs == "both" else legs)


def test_a_sum_of_both_legs_is_not_doubled(tmp_path):
    path = tmp_path / "m.csv"
    write_csv_table(path, Table(TIME, moment_names(), ANGLES), ["Nm"] * 3)
    both = read_moments(path, EXO_JOINTS, "both", FILTER).values
    one = read_moments(path, EXO_JOINTS, "right", FILTER).values
    np.testing.assert_allclose(one, 2.0 * both)


def test_columns_that_nothing_reads_have_any_unit(tmp_path):
    names = ("motor", "motor_current", "motor_moment_arm")
    table = Table(TIME, names, ANGLES)
    write_csv_table(tmp_path / "e.csv", table, ["rad", "N", "m"])
    found = read_angles(tmp_path / "e.csv", ("motor",), "both", FILTER)
    np.testing.assert_allclose(
        found.values[INNER, 0], ANGLES[INNER, 0], atol=4e-7
    )


def test_a_delay_moves_the_clock(tmp_path):
    path = tmp_path / "e.csv"
    write_csv_table(path, Table(TIME, EXO_JOINTS, ANGLES), ["rad"] * 3)
    signal = read_angles(path, EXO_JOINTS, "both", FILTER).delayed(0.1)
    at = np.linspace(0.5, 1.5, 20)
    q, v, _ = signal.motion(at)
    np.testing.assert_allclose(q[:, 1], 0.6 * np.sin(at + 0.1), atol=4e-7)
    np.testing.assert_allclose(v[:, 1], 0.6 * np.cos(at + 0.1), atol=4e-7)


@pytest.mark.parametrize(
    ("names", "legs", "words"),
    [
        (("exo_ankle", "exo_kne", "exo_hip"), "both", "did you mean 'exo_kne"),
        (tuple(f"{j}_left" for j in EXO_JOINTS), "right", "exo_ankle_right"),
        (tuple(f"{j}_left" for j in EXO_JOINTS), "both", "encoder_legs: left"),
    ],
)
def test_refuses_joints_that_are_missing(tmp_path, names, legs, words):
    path = tmp_path / "e.csv"
    write_csv_table(path, Table(TIME, names, ANGLES), ["rad"] * 3)
    with pytest.raises(InputError, match=words):
        read_angles(path, EXO_JOINTS, legs, FILTER)


def test_refuses_what_is_too_short_too_slow_or_unknown(tmp_path):
    path = tmp_path / "e.csv"
    table = Table(TIME[:10], EXO_JOINTS, ANGLES[:10])
    write_csv_table(path, table, ["rad"] * 3)
    with pytest.raises(InputError, match="10 frames"):
        read_angles(path, EXO_JOINTS, "both", FILTER)
    table = Table(TIME * 20, EXO_JOINTS, ANGLES)
    write_csv_table(path, table, ["rad"] * 3)
    with pytest.raises(InputError, match="sampled at 10 Hz"):
        read_angles(path, EXO_JOINTS, "both", FILTER)
    with pytest.raises(InputError, match=r"give one of \.mot"):
        read_angles(tmp_path / "e.txt", EXO_JOINTS, "both", FILTER)


@pytest.fixture(scope="module")
def coupled(nominal):
    return nominal("coupled").tree


def motion(n=50):
    rng = np.random.default_rng(0)
    return tuple(rng.uniform(-1.0, 1.0, (n, 9)) for _ in range(3))


def test_each_part_of_a_drive_has_its_term(coupled):
    q, v, a = motion()
    joint = JointDrive(
        inertia_kg_m2=0.3,
        viscous_nm_s=2.0,
        coulomb_nm=4.0,
        coulomb_speed_rad_s=0.1,
        stiffness_nm_rad=20.0,
        rest_deg=30.0,
    )
    found = drive_moments(Device(knee=joint), coupled, q, v, a)
    assert not found[:, [0, 2]].any()
    expected = (
        -0.3 * a[:, 7]
        - 2.0 * v[:, 7]
        - 4.0 * np.tanh(v[:, 7] / 0.1)
        - 20.0 * (q[:, 7] - np.pi / 6)
    )
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-12)


def test_friction_takes_power(coupled):
    q, v, a = motion()
    joint = JointDrive(viscous_nm_s=2.0, coulomb_nm=4.0)
    device = Device(ankle=joint, knee=joint, hip=joint)
    tau = drive_moments(device, coupled, q, v, a)
    assert ((tau * v[:, 6:]).sum(axis=1) < 0.0).all()


def test_a_device_that_carries_itself_leaves_the_human_alone(coupled, nominal):
    """Resultant minus its moments is what the human needs without it.

    But for the foot-plate, which the human's foot always carries.
    """
    q6, v6, a6 = (x[:, :6] for x in motion())
    nine = [coupled.coordinates.aligned(x) for x in (q6, v6, a6)]
    carried = drive_moments(Device(carries_itself=1.0), coupled, *nine)
    rigid, human = nominal("rigid").tree, nominal("human").tree
    resultant = rigid.inverse_dynamics(q6, v6, a6)[:, 3:]
    alone = human.inverse_dynamics(q6, v6, a6)[:, 3:]
    np.testing.assert_allclose(resultant - carried, alone, atol=1e-9)


@pytest.mark.parametrize(
    ("reader", "names", "unit", "words"),
    [
        (read_angles, EXO_JOINTS, "N", "'exo_ankle' is in 'n'; give an angle"),
        (read_angles, EXO_JOINTS, "mm", "in deg or rad"),
        (read_moments, moment_names(), "deg", "give a moment in nm or n m"),
    ],
)
def test_units_are_those_of_what_is_read(tmp_path, reader, names, unit, words):
    path = tmp_path / "e.csv"
    write_csv_table(path, Table(TIME, tuple(names), ANGLES), [unit] * 3)
    with pytest.raises(InputError, match=words):
        reader(path, EXO_JOINTS, "both", FILTER)
