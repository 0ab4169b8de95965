"""Filling short gaps of markers, and saying how much was filled."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from drake_exo.errors import InputError
from drake_exo.laboratory.tables import MarkerData, missing_column

_NEIGHBOURS = 10  # seen frames on each side that carry the spline


def fill_gaps(
    data: MarkerData, names, longest_s: float
) -> tuple[MarkerData, dict[str, float]]:
    """Fill gaps of some markers by cubic splines through their surroundings.

    Args:
        data: markers on an even time base.
        names: the markers that are needed; others stay as they are.
        longest_s: longest gap that may be filled [s].

    Returns:
        The markers without gaps, and the share of frames that was filled of
        each marker that had any.

    Raises:
        InputError: a marker is missing, or unseen for longer than
            `longest_s`, or at either end of the recording.
    """
    positions = data.positions.copy()
    shares = {}
    for name in dict.fromkeys(names):
        if name not in data.names:
            raise missing_column(data.source, name, data.names, "marker")
        p = positions[:, data.names.index(name)]
        unseen = ~np.isfinite(p).all(axis=1)
        if not unseen.any():
            continue
        shares[name] = float(unseen.mean())
        edges = np.flatnonzero(np.diff(np.r_[0, unseen, 0]))
        for start, end in edges.reshape(-1, 2):
            _check_gap(data, name, int(start), int(end), longest_s)
        _fill(data.time, p, unseen)
    return replace(data, positions=positions), shares


def _check_gap(data, name, start: int, end: int, longest_s: float) -> None:
    length = (end - start) / data.rate_hz
    where = (
        f"{data.source}: marker {name!r} has no value in {end - start} "
        f"frames from {data.time[start]:g} s"
    )
    if length > longest_s + 1e-9:
        raise InputError(
            f"{where}, {length:g} s long; gaps up to laboratory.fill_gaps_s "
            f"({longest_s:g} s) are filled: raise it, or fill the gap in the "
            "motion-capture software"
        )
    if start == 0 or end == len(data.time):
        raise InputError(
            f"{where}, at the end of the recording, where nothing can be "
            "interpolated; cut those frames off"
        )


def _fill(time: np.ndarray, p: np.ndarray, unseen: np.ndarray) -> None:
    """Fill p (N, 3) in place."""
    edges = np.flatnonzero(np.diff(np.r_[0, unseen, 0])).reshape(-1, 2)
    seen = np.flatnonzero(~unseen)
    for start, end in edges:
        before = seen[seen < start][-_NEIGHBOURS:]
        after = seen[seen >= end][:_NEIGHBOURS]
        knots = np.r_[before, after]
        degree = min(3, len(knots) - 1)
        spline = make_interp_spline(time[knots], p[knots], k=degree)
        p[start:end] = spline(time[start:end])
