"""Compilation with numba, and rotations: hat operator, vectors, angles."""

import os
from collections.abc import Callable

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from scipy.spatial.transform import Rotation

from drake_exo.errors import was_interrupted


class _Compiled(Dispatcher):
    """Compiled function; Ctrl-C raises KeyboardInterrupt, not SystemError."""

    def __call__(self, *args):
        try:
            return super().__call__(*args)
        except SystemError as error:
            if was_interrupted(error):
                raise KeyboardInterrupt from error
            raise


_OWN_STAMP = os.stat(__file__).st_mtime_ns


def njit(fastmath: bool = False) -> Callable[[Callable], Dispatcher]:
    """Decorator like `numba.njit(cache=True)`, but aware of callees' files.

    Each function keeps its own `fastmath`: in numba's default it is that of the
    caller that happens to compile it first, and NaN or rounding change with it.

    numba compiles anew when a function's own file has changed. Functions of
    other modules are compiled into it, so here the files of all compiled
    functions that its module imports count, too, and this one. Decorate only in
    modules on disk: numba knows no other place for its cache.
    """

    def compiled(function: Callable) -> Dispatcher:
        found = numba.njit(cache=True, fastmath=fastmath)(function)
        found.__class__ = _Compiled
        imported = [
            value
            for value in function.__globals__.values()
            if isinstance(value, Dispatcher)
            and value.__module__ != function.__module__
        ]
        # The cache on disk holds only for these versions of all files.
        index = found._cache._cache_file
        index._source_stamp = (
            index._source_stamp,
            _OWN_STAMP,
            *(other._cache._cache_file._source_stamp for other in imported),
        )
        return found

    return compiled


def hat(v: np.ndarray) -> np.ndarray:
    """Skew matrices (..., 3, 3) of vectors (..., 3); times b they are v × b."""
    v = np.asarray(v)
    out = np.zeros((*v.shape[:-1], 3, 3), dtype=v.dtype)
    out[..., 0, 1] = -v[..., 2]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    out[..., 1, 2] = -v[..., 0]
    out[..., 2, 0] = -v[..., 1]
    out[..., 2, 1] = v[..., 0]
    return out


@njit()
def multiply(a, b, out):
    """Write the product of 3 × 3 matrices into out, in compiled code."""
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
            for k in range(3):
                out[i, j] += a[i, k] * b[k, j]


def exp_rotation(w: np.ndarray) -> np.ndarray:
    """Rotation matrix exp(hat(w)) of a rotation vector w [rad] (3,)."""
    return Rotation.from_rotvec(w).as_matrix()


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vector w [rad] (3,), at most π long, with exp(hat(w)) = R."""
    return Rotation.from_matrix(R).as_rotvec()


def angles_xyz(R: np.ndarray) -> np.ndarray:
    """Angles [rad] (..., 3) with R = Rx·Ry·Rz, pitch in [-π/2, π/2]."""
    return np.stack(
        [
            np.arctan2(-R[..., 1, 2], R[..., 2, 2]),
            np.arcsin(np.clip(R[..., 0, 2], -1.0, 1.0)),
            np.arctan2(-R[..., 0, 1], R[..., 0, 0]),
        ],
        axis=-1,
    )


def rotations_xyz(angles: np.ndarray) -> np.ndarray:
    """Rotations R = Rx·Ry·Rz (..., 3, 3) of angles [rad] (..., 3)."""
    # SciPy 1.15 takes at most two dimensions.
    rows = Rotation.from_euler("XYZ", np.reshape(angles, (-1, 3)))
    return rows.as_matrix().reshape(*np.shape(angles), 3)


def rotation_z(yaw: float) -> np.ndarray:
    """Rotation matrix (3, 3) of a turn by `yaw` [rad] about z."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def yaw_of(R: np.ndarray) -> float:
    """Yaw ψ [rad] of R = Rx·Ry·Rz(ψ)."""
    return float(np.arctan2(-R[0, 1], R[0, 0]))


def without_yaw(R: np.ndarray) -> np.ndarray:
    """The part Rx·Ry of rotations R = Rx·Ry·Rz, (..., 3, 3)."""
    c, s = R[..., 0, 0], -R[..., 0, 1]
    size = np.hypot(c, s)
    c, s, zero, one = c / size, s / size, np.zeros_like(c), np.ones_like(c)
    back = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    return R @ np.moveaxis(back, (0, 1), (-2, -1))


def tilt_deg(R: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Angle [°] (...) between a sole's z axis and the normal `up` (3,)."""
    return np.rad2deg(np.arccos(np.clip(R[..., 2] @ up, -1.0, 1.0)))
