"""Rotations against scipy's, and compiled products against numpy's."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from drake_exo.soles import numerics


def test_products_of_matrices():
    a, b = np.random.default_rng(1).normal(size=(2, 3, 3))
    out = np.full((3, 3), 9.0)
    numerics.multiply(a, b, out)
    np.testing.assert_allclose(out, a @ b)


def test_angles_and_tilt():
    angles = np.array([[0.1, -0.2, 0.3], [-0.4, 0.5, 1.0]])
    R = Rotation.from_euler("XYZ", angles).as_matrix()
    np.testing.assert_allclose(numerics.angles_xyz(R), angles)
    z = Rotation.from_matrix(R).apply([0.0, 0.0, 1.0])
    expected = np.degrees(np.arccos(z[:, 2]))
    up = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(numerics.tilt_deg(R, up), expected)
    np.testing.assert_allclose(numerics.tilt_deg(R, z[0])[0], 0.0, atol=1e-5)
    turned = numerics.rotation_z(0.7)
    np.testing.assert_allclose(
        turned, Rotation.from_euler("z", 0.7).as_matrix(), atol=1e-15
    )
    assert numerics.yaw_of(turned) == pytest.approx(0.7)


def test_exponentials_and_hats():
    w = np.array([0.3, -0.5, 0.2])
    for size in (0.0, 1e-9, 1e-3, 1.0, 6.0):
        expected = expm(numerics.hat(size * w))
        found = numerics.exp_rotation(size * w)
        np.testing.assert_allclose(found, expected, atol=1e-14)
    v = np.array([1.0, 2.0, -3.0])
    np.testing.assert_allclose(numerics.hat(w) @ v, np.cross(w, v))


def test_yaw_is_taken_off_behind_roll_and_pitch():
    angles = np.random.default_rng(2).uniform(-1, 1, (2, 5, 3))
    R = numerics.rotations_xyz(angles)
    level = numerics.rotations_xyz(angles * [1, 1, 0])
    np.testing.assert_allclose(numerics.without_yaw(R), level, atol=1e-12)
    np.testing.assert_allclose(
        numerics.without_yaw(R[0, 0]), level[0, 0], atol=1e-12
    )
    assert numerics.yaw_of(R[0, 1]) == pytest.approx(angles[0, 1, 2])


def test_angles_vectors_and_matrices_go_round():
    w = np.array([[0.3, -0.5, 0.2], [1.0, 2.0, -0.5], [0.0, 0.0, 1e-9]])
    for v in w:
        again = numerics.rotation_vector(numerics.exp_rotation(v))
        np.testing.assert_allclose(again, v, atol=1e-14)
    angles = np.random.default_rng(3).uniform(-1.5, 1.5, (20, 3))
    R = numerics.rotations_xyz(angles)
    np.testing.assert_allclose(numerics.angles_xyz(R), angles)
    hats = numerics.hat(w)
    np.testing.assert_allclose(hats, -np.swapaxes(hats, 1, 2))
    for v, of in zip(w, hats, strict=True):
        np.testing.assert_allclose(of @ [4.0, 5.0, 6.0], np.cross(v, [4, 5, 6]))
