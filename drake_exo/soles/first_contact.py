"""Where to start: poses from the hull's facets, and two homotopies.

A flat start fails on curved soles: at a few newtons only one to three nodes
touch. Candidates lay the undeformed sole flat on each facet of its convex
hull, least tilt first among those whose support holds the ZMP; the force
then comes down from a larger one and the law from a smoother one.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from drake_exo.soles.contact import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.rotations import (
    rotation_between,
    rotation_z,
    yaw_of,
)

_MAX_TILT = np.deg2rad(80.0)
_SMOOTHING_LAYER, _SMOOTHING_KAPPA = 1e-4, 0.2
_MAX_CANDIDATES = 12


def candidate_poses(lP: np.ndarray, zmp, start: Start) -> list[State]:
    """Poses that lay the rest shape flat on a hull facet, best first.

    Facets whose support holds the ZMP come first, by tilt; then the others,
    by the distance of the ZMP from the support.
    """
    hull = ConvexHull(lP)
    normals, which = np.unique(
        np.round(hull.equations[:, :3], 6), axis=0, return_inverse=True
    )
    down = np.array([0.0, 0.0, -1.0])
    ranked = []
    for index, normal in enumerate(normals):
        tilt = np.arccos(np.clip(normal @ down, -1.0, 1.0))
        if tilt > _MAX_TILT:
            continue
        R = rotation_between(normal, down)
        R = R @ rotation_z(start.yaw - yaw_of(R))
        corners = np.unique(hull.simplices[which.ravel() == index])
        O = start.point_W - R @ start.point_L  # noqa: E741
        O[2] = -(lP[corners] @ R.T)[:, 2].mean()
        outside = _distance((lP[corners] @ R.T + O)[:, :2], np.asarray(zmp))
        state = State(np.zeros_like(lP), O, R)
        ranked.append((outside > 0, outside if outside > 0 else tilt, state))
    ranked.sort(key=lambda item: item[:2])
    return [item[2] for item in ranked[:_MAX_CANDIDATES]]


def _distance(points: np.ndarray, z: np.ndarray) -> float:
    """How far z lies outside the convex hull of points in the plane [m]."""
    hull = ConvexHull(points, qhull_options="QJ")
    signed = hull.equations[:, :2] @ z + hull.equations[:, 2]
    return float(max(signed.max(), 0.0))


def first_step(
    solver: ContactSolver, target: Target, largest_force: float
) -> tuple[State, Convergence]:
    """Solve the first step of a contact phase.

    Args:
        solver: Newton solver with the wanted law.
        target: First sample; its reference is a Start.
        largest_force: Largest |F| of the phase [N]: the homotopy's start.
    """
    report = Convergence(False, 0, np.inf, "no hull facet to stand on")
    candidates = candidate_poses(solver.lP, target.zmp, target.reference)
    for guess in candidates:
        state, report = _descend(solver, target, guess, largest_force)
        if report.converged:
            return state, report
    return candidates[0] if candidates else None, Convergence(
        False,
        report.iterations,
        report.residual,
        f"no start from {len(candidates)} hull facets ({report.message})",
    )


def _descend(solver, target, guess, largest_force):
    """From a facet's pose: larger force and smoother law, then down."""
    force = np.linalg.norm(target.force)
    start_force = max(force, 0.3 * largest_force)
    law = solver.law
    smooth = replace(
        law,
        layer=max(20 * law.layer, _SMOOTHING_LAYER),
        kappa=max(law.kappa, _SMOOTHING_KAPPA),
    )
    # Press in evenly, so that the facet's nodes carry load at once.
    state = guess.copy()
    near = guess.O[2] + (solver.lP @ guess.R.T)[:, 2] < 2e-3
    state.F[near] = target.force * start_force / (force * near.sum())
    shortfall = (solver.deformed(state.F, state.R) + state.O)[near, 2]
    state.O[2] -= np.median(shortfall)
    total = 0
    factors = [f for f in (1.0, 0.5, 0.25, 0.12, 0.06, 0.03, 0.015, 0.007)
               if f * start_force > force]  # fmt: skip
    try:
        for factor in factors:
            eased = replace(
                target, force=target.force * factor * start_force / force
            )
            state, report = _with_law(solver, smooth, state, eased)
            total += report.iterations
            if not report.converged:
                return state, report
        for shrink in (1.0, 0.2, 0.04):
            eased_law = replace(
                smooth,
                layer=max(law.layer, shrink * smooth.layer),
                kappa=max(law.kappa, shrink * smooth.kappa),
            )
            state, report = _with_law(solver, eased_law, state, target)
            total += report.iterations
            if not report.converged:
                return state, report
    finally:
        solver.law = law
    state, report = solver.solve(state, target)
    report.iterations += total
    return state, report


def _with_law(solver, law, state, target):
    solver.law = law
    return solver.solve(state, target)
