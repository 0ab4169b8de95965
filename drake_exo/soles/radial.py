"""Moves along rays from the sole frame's origin."""

import numba
import numpy as np

from drake_exo.soles.shape import SphericalSpline

_LEAST = 1e-300


def pull_back(
    nodes: np.ndarray, spline: SphericalSpline, p: np.ndarray
) -> np.ndarray:
    """Undeformed places X = X'/s of deformed nodes X' (n, 3) [m].

    s depends on the direction alone; the origin stays where it is.
    """
    return nodes / spline.stretch(nodes, p)[:, None]


def reach(X: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Factors (n,) that take points (n, 3) onto triangles (f, 3, 3).

    Of several triangles on a ray the nearest is taken; where rounding leaves
    none, that which misses by least. At the origin: infinite.
    """
    A = corners.transpose(0, 2, 1)  # columns are a triangle's corners
    size = np.linalg.norm(corners, axis=2).prod(axis=1)
    A = A[np.abs(np.linalg.det(A)) > 1e-9 * size]
    return _nearest(np.ascontiguousarray(X), np.linalg.inv(A))


@numba.njit(cache=True)
def _nearest(X, inverses):
    factors = np.full(len(X), np.inf)
    for n in range(len(X)):
        x, y, z = X[n]
        least = np.inf
        for f in range(len(inverses)):
            B = inverses[f]
            u = B[0, 0] * x + B[0, 1] * y + B[0, 2] * z
            v = B[1, 0] * x + B[1, 1] * y + B[1, 2] * z
            w = B[2, 0] * x + B[2, 1] * y + B[2, 2] * z
            total = u + v + w
            if total <= 0.0:
                continue
            outside = max(-min(u, v, w) / total, 1e-9)
            if outside >= least:
                continue
            merit = outside + 1e-6 * abs(np.log(total))
            if merit < least:
                least, factors[n] = merit, 1.0 / total
    return factors


def onto_edges(X: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Points (n, 3) moved onto the segments (k, 2, 3) next to their rays."""
    A = ends.transpose(0, 2, 1)  # columns are a segment's ends
    w = np.maximum(np.einsum("kij,nj->nki", np.linalg.pinv(A), X), 0.0)
    w /= np.maximum(w.sum(axis=2, keepdims=True), _LEAST)
    place = np.einsum("kij,nkj->nki", A, w)
    length = np.maximum(np.linalg.norm(place, axis=2), _LEAST)
    along = (place * X[:, None]).sum(axis=2) / length
    return place[np.arange(len(X)), along.argmax(axis=1)]
