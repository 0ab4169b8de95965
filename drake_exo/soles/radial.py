"""Moves along rays from the sole frame's origin."""

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
    w = np.einsum("fij,nj->nfi", np.linalg.inv(A), X)
    total = w.sum(axis=2)
    factor = 1.0 / np.where(total > 0, total, np.nan)
    outside = np.maximum(-(w * factor[..., None]).min(axis=2), 1e-9)
    merit = outside + 1e-6 * np.abs(np.log(factor))
    merit[np.isnan(merit)] = np.inf
    found = factor[np.arange(len(X)), merit.argmin(axis=1)]
    return np.where(np.isnan(found), np.inf, found)


def onto_edges(X: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Points (n, 3) moved onto the segments (k, 2, 3) next to their rays."""
    A = ends.transpose(0, 2, 1)  # columns are a segment's ends
    w = np.maximum(np.einsum("kij,nj->nki", np.linalg.pinv(A), X), 0.0)
    w /= np.maximum(w.sum(axis=2, keepdims=True), _LEAST)
    place = np.einsum("kij,nkj->nki", A, w)
    length = np.maximum(np.linalg.norm(place, axis=2), _LEAST)
    along = (place * X[:, None]).sum(axis=2) / length
    return place[np.arange(len(X)), along.argmax(axis=1)]
