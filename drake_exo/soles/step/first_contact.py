"""Where to start: poses from the hull's facets, and two homotopies.

A flat start fails on curved soles: at a few newtons only one to three nodes
touch. Candidates lay the undeformed sole flat on each facet of its convex
hull, least tilt first among those whose support holds the ZMP; the force
then comes down from a larger one and the law from a smoother one.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.rotations import rotation_between, rotation_z, yaw_of

_MAX_TILT = np.deg2rad(80.0)  # beyond, a foot has tipped over
_SMOOTHING_LAYER, _SMOOTHING_KAPPA = 1e-4, 0.2
_MAX_CANDIDATES = 12
_MAX_SUBSTEPS = 60
_LEAP = 0.1  # rad between designs
_SAME = 1e-6  # rad; solutions are far closer than branches


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
    solver: ContactSolver,
    target: Target,
    largest_force: float,
    near: State | None = None,
    patience: float = np.inf,
) -> tuple[State | None, Convergence]:
    """Solve the first step of a contact phase, from a cold start.

    Every candidate is pressed into the ground at its own pose, then force
    and ZMP are led to the wanted ones: with the wanted law, else with a
    smoother law that is sharpened afterwards.

    Args:
        solver: Newton solver with the wanted law.
        target: First sample; its reference is a Start.
        largest_force: Largest |F| of the phase [N]; pressing in uses at
            least a fifth of it, so that enough nodes touch.
        near: First state of a neighbouring design. A pose turned far from
            it that does not follow from it either is a leap to another
            branch, and fails.
        patience: Newton steps after which no other facet is tried.
    """
    press = max(np.linalg.norm(target.force), 0.2 * largest_force)
    state, report = _cold_start(solver, target, press, patience)
    if near is None or not report.converged or _turn(state, near) < _LEAP:
        return state, report
    followed, _ = _follow_design(solver, target, near, press)
    if _turn(state, followed) < _SAME:
        return state, report
    return None, replace(report, converged=False, message="another branch")


def _turn(a: State, b: State) -> float:
    """Largest difference of two orientations' entries, about radians."""
    return float(np.abs(a.R - b.R).max())


def _follow_design(solver, target, near, press):
    state, report = solver.solve(near, target)
    if not report.converged:
        solver.active.refresh()
        unloaded = State(np.zeros_like(solver.lP), near.O.copy(), near.R)
        laws = [solver.law]
        state, report = _lead(solver, target, unloaded, press, laws)
    return state, report


def _cold_start(solver, target, press, patience):
    report = Convergence(False, 0, np.inf, "no hull facet to stand on")
    candidates = candidate_poses(solver.lP, target.zmp, target.reference)
    total, smoother = 0, _smoother(solver.law)
    # Where the law itself is as smooth, they would fail alike.
    ways = [[solver.law]] + [smoother] * (smoother[0] != solver.law)
    tried = 0
    for guess in candidates:
        if total > patience:
            break
        tried += 1
        for laws in ways:
            state, report = _lead(solver, target, guess, press, laws)
            total += report.iterations
            report.iterations = total
            if report.converged and state.R[2, 2] > np.cos(_MAX_TILT):
                return state, report
    report.converged = False
    report.message = f"no start from {tried} hull facets ({report.message})"
    return None, report


def _smoother(law) -> list:
    """A smoother law, brought down to the wanted one."""
    return [
        replace(
            law,
            layer=max(law.layer, shrink * _SMOOTHING_LAYER),
            kappa=max(law.kappa, shrink * _SMOOTHING_KAPPA),
        )
        for shrink in (1.0, 0.2, 0.04)
    ] + [law]


def _lead(solver, target, guess, press, laws):
    """From a pose to the target, with one law after the other."""
    law = solver.law
    try:
        solver.law = laws[0]
        state, before, total = _press_in(solver, target, guess, press)
        for stage in laws:
            solver.law = stage
            state, report = follow_load(solver, state, before, target)
            before = target
            total += report.iterations
            if not report.converged:
                break
    finally:
        solver.law = law
    report.iterations = total
    return state, report


def _press_in(solver, target, guess, press) -> tuple[State, Target, int]:
    """Lower the sole at fixed orientation until it carries about `press`.

    Returns:
        State, load that it carries, Newton steps taken.
    """
    state, depth, total = guess.copy(), 1e-4, 0
    aim = replace(target, force=np.array([0.0, 0.0, press]))
    for _ in range(6):
        state.O[2] = guess.O[2] - depth
        # The references follow the held pose, as for the first sample.
        trial, report = solver.solve(state, aim, fixed_pose=True)
        total += report.iterations
        carried = trial.F[:, 2].sum()
        state = trial
        if carried > 0.5 * press and carried < 2 * press:
            break
        depth *= np.clip(press / max(carried, 1e-3 * press), 0.2, 10.0)
    resultant = state.F.sum(axis=0)
    P = solver.deformed(state.F, state.R) + state.O
    zmp = (P[:, :2] * state.F[:, 2:]).sum(axis=0) / max(resultant[2], 1e-9)
    return state, replace(target, force=resultant, zmp=zmp), total


def follow_load(
    solver: ContactSolver,
    state: State,
    before: Target,
    target: Target,
    guess: State | None = None,
) -> tuple[State, Convergence]:
    """Newton at the target, else continuation in force and ZMP.

    Args:
        solver: Newton solver.
        state: Solution for `before`.
        before: Load that `state` carries.
        target: Load wanted; its references hold all along.
        guess: Tried first, before `state` itself.
    """
    total = 0
    for begin in (guess, state):
        if begin is None:
            continue
        new, report = solver.solve(begin, target)
        total += report.iterations
        if report.converged:
            report.iterations = total
            return new, report
        solver.active.refresh()
    done, step = 0.0, 0.25
    for _ in range(_MAX_SUBSTEPS):
        aim = min(1.0, done + step)
        trial, sub = solver.solve(state, target.partway(before, aim))
        total += sub.iterations
        if sub.converged:
            state, done, step = trial, aim, 1.5 * step
            if done >= 1.0:
                sub.iterations = total
                return state, sub
        else:
            step *= 0.5
            if step < 1e-3:
                break
    report.message += f"; continuation in the load stopped at {done:.3f}"
    report.iterations = total
    return new, report
