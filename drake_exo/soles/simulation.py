"""Quasi-static simulation of a sole through the samples of a step.

`simulate` solves one sample after another, each from the one before. The first
sample of a contact phase needs a start of its own (`first_step`): a level foot
fails on curved soles, where only one to three nodes touch at a few newtons. The
undeformed sole is therefore laid flat on facets of its convex hull, least tilt
first among those whose support holds the ZMP. From there the force is reduced
from a larger one, and the contact law, if need be, sharpened from a smoother.

The Cartesian stiffness about the ZMP is K_c, [dF; dΓ_Z] = K_c [dzO; dω]; the
physical stiffness is −K_c (blocks in N/m, N, N, N·m/rad).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from drake_exo.errors import InputError
from drake_exo.files.output import read_arrays
from drake_exo.soles.contact.law import ARRAYS, FLAT, ContactLaw, Ground
from drake_exo.soles.contact.linearisation import Linearisation
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.numerics import rotation_z, rotations_xyz

# Diagonal of S: a length of 0.05 m makes the blocks of K_c comparable.
STABILITY_SCALE = np.array([1.0] * 3 + [1.0 / 0.05] * 3)


def sigma_max_translation(K_c: np.ndarray) -> np.ndarray:
    """Largest singular value of K_c's translational block [N/m], (...)."""
    return _singular_values(K_c[..., :3, :3])[..., 0]


def sigma_min_rotation(K_c: np.ndarray) -> np.ndarray:
    """Least singular value of K_c's rotational block [N·m/rad], (...)."""
    return _singular_values(K_c[..., 3:, 3:])[..., -1]


def _singular_values(K: np.ndarray) -> np.ndarray:
    """Singular values (..., 3), largest first; NaN where K is not finite."""
    return np.linalg.svd(np.nan_to_num(K), compute_uv=False) + 0.0 * K[..., 0]


def stability(K_c: np.ndarray) -> np.ndarray:
    """Least eigenvalue of S sym(−K_c) S, S = diag(I, I/L) [N/m], (...).

    L = 0.05 m. Positive is enough for stability under a dead wrench (K_c is not
    symmetric).
    """
    sym = -0.5 * (K_c + np.swapaxes(K_c, -1, -2))
    sym = sym * np.outer(STABILITY_SCALE, STABILITY_SCALE)
    least = np.linalg.eigvalsh(np.nan_to_num(sym))[..., 0]
    return least + 0.0 * sym[..., 0, 0]


def heel_strike_count(samples: int, fraction: float = 0.1) -> int:
    """Number of a phase's first samples that are heel strike, at least 1."""
    return max(1, int(fraction * samples + 1e-9))  # 0.29 · 100 < 29


def sample_weights(
    load: Load, fraction: float, samples: int | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples of a load, how many each stands for, weights in c_tr and c_rot.

    Of one contact phase c_tr is the sum over heel strike (the first `fraction`
    of samples), c_rot over all; of several, the weighted mean of their sums.
    Every phase is `thinned` to as many `samples`. Arrays (k,).
    """
    parts = []
    for phase in load.phases:
        picked, *factors = thinned(phase.stop - phase.start, samples, fraction)
        parts.append((picked + phase.start, *factors))
    picked, strike, count = map(np.concatenate, zip(*parts, strict=True))
    share = load.shares[load.phase[picked]]
    return picked, count, share * strike, share * count


def thinned(total: int, samples: int | None, fraction: float):
    """Samples of a phase to simulate, weights in c_tr and c_rot, (k,) each.

    A third of them is in heel strike, where stiffness changes most from sample
    to sample (more if the rest has too few). Weights take stiffness as linear
    in time between two of them. None simulates all.
    """
    strike = heel_strike_count(total, fraction)
    count = min(samples or total, total)
    early = max(round(count / 3), 4, count - (total - strike))
    early = min(strike, early)
    late = min(total - strike, max(2, count - early))
    parts = [
        _evenly(first, last, number)
        for first, last, number in ((0, strike, early), (strike, total, late))
    ]
    picked, by_rot = map(np.concatenate, zip(*parts, strict=True))
    return picked, np.where(picked < strike, by_rot, 0.0), by_rot


def _evenly(first: int, last: int, number: int):
    """About evenly spaced samples of a range; how many each stands for."""
    every = np.arange(first, last)
    if number == len(every):
        return every, np.ones(number)
    picked = np.linspace(first, last - 1, number).round().astype(int)
    hats = np.eye(number)
    return picked, np.array(
        [np.interp(every, picked, hat).sum() for hat in hats]
    )


_MAX_TILT = np.deg2rad(80.0)  # from the ground's normal: beyond, tipped over
_SMOOTHING_LAYER, _SMOOTHING_KAPPA = 1e-4, 0.2
_MAX_CANDIDATES = 12
_LEAST_STEP = 1.0 / 256.0  # smallest part of the way to a load
_LEAP = 0.1  # rad from a neighbouring design's pose: perhaps another branch
_SAME = 1e-6  # rad; solutions of one branch are far closer than branches
_LEAST_PART = 1 / 64  # smallest part of the time between samples
_LARGEST = 1e30  # larger numbers in a file are damage
_TOGETHER = 64  # samples whose displacements are computed at a time
_PATIENCE = 3  # times the Newton steps of a neighbouring design
# Files of a simulation, and of the initial shape's beside a design.
HISTORY, FIRST_HISTORY = "history.npz", "initial_history.npz"


def candidate_poses(lP: np.ndarray, target: Target, ground) -> list[State]:
    """Poses that lay the undeformed sole flat on a hull facet, best first.

    Facets whose support holds the ZMP come first, by tilt; then the others, by
    the ZMP's distance from it. A prescribed orientation is the only candidate.
    """
    start, rotation = target.reference, target.rotation
    if rotation is not None:
        O = start.point_W - rotation @ start.point_L  # noqa: E741
        O[2] = 0.0
        P = lP @ rotation.T + O
        O[2] = -(P[:, 2] - ground.height(P)).min()
        return [State(np.zeros_like(lP), O, rotation)]
    # With the foot's origin above: a flat surface alone has no hull.
    points = np.vstack([lP, np.zeros(3)])
    hull = ConvexHull(points)
    normals, which = np.unique(
        np.round(hull.equations[:, :3], 6), axis=0, return_inverse=True
    )
    down = -ground.normal(start.places(np.eye(3), lP))
    ranked = []
    for index, normal in enumerate(normals):
        tilt = np.arccos(np.clip(-normal[2], -1.0, 1.0))
        if tilt > _MAX_TILT:
            continue
        R = _laid_flat(normal, down, start.yaw)
        corners = np.unique(hull.simplices[which.ravel() == index])
        O = start.point_W - R @ start.point_L  # noqa: E741
        placed = points[corners] @ R.T + O
        O[2] -= (placed[:, 2] - ground.height(placed)).mean()
        outside = _distance(placed[:, :2], target.zmp)
        state = State(np.zeros_like(lP), O, R)
        ranked.append((outside > 0, outside if outside > 0 else tilt, state))
    ranked.sort(key=lambda item: item[:2])
    return [item[2] for item in ranked[:_MAX_CANDIDATES]]


def _laid_flat(normal, down, yaw: float) -> np.ndarray:
    """R = Rx·Ry·Rz(yaw) that carries a facet's normal onto `down`."""
    x, y, z = rotation_z(yaw) @ normal
    # Ry turns x to that of `down`, Rx what is left, both still downwards.
    size = np.hypot(x, z)
    pitch = np.pi - np.arcsin(np.clip(down[0] / size, -1.0, 1.0))
    below = size * np.cos(pitch)
    roll = np.arctan2(down[2], down[1]) - np.arctan2(below, y)
    return rotations_xyz(np.array([roll, pitch - np.arctan2(x, z), yaw]))


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
    """Solve the first sample of a contact phase, from a cold start.

    Every candidate is pressed into the ground at its own pose, by at least a
    fifth of the phase's largest |F| [N], so that enough nodes touch. Then force
    and ZMP are moved to the wanted ones, with the wanted law, else with a
    smoother one that is sharpened afterwards. If the pose found is turned far
    from `near`, a neighbouring design's first state, and does not follow from
    it either, it is on another branch: no state is returned. After `patience`
    Newton steps no further facet is tried.
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
    """Largest difference of two orientations' entries, roughly in rad."""
    return float(np.abs(a.R - b.R).max())


def _follow_design(solver, target, near, press):
    state, report = solver.solve(near, target)
    if not report.converged:
        unloaded = State(np.zeros_like(solver.lP), near.O.copy(), near.R)
        state, report = _lead(solver, target, unloaded, press, [solver.law])
    return state, report


def _cold_start(solver, target, press, patience):
    report = Convergence(False, 0, np.inf, "no hull facet to stand on")
    candidates = candidate_poses(solver.lP, target, solver.ground)
    up = solver.ground.normal(target.places_before(np.eye(3), solver.lP))
    total, tried, smoother = 0, 0, _smoother(solver.law)
    # Not if the law is as smooth itself: the same solve would fail again.
    ways = [[solver.law]] + [smoother] * (smoother[0] != solver.law)
    for guess in candidates:
        if total > patience:
            break
        tried += 1
        for laws in ways:
            state, report = _lead(solver, target, guess, press, laws)
            total += report.iterations
            report.iterations = total
            if report.converged and state.R[:, 2] @ up > np.cos(_MAX_TILT):
                return state, report
    report.converged = False
    report.message = (
        f"no start from {tried} hull facets ({report.message}); where its ZMP "
        "is near the sole's edge, begin later (from, skip_first, "
        "least_force_n)"
    )
    return None, report


def _smoother(law) -> list:
    """Ever less smoothed contact laws, down to the wanted one."""
    return [
        replace(
            law,
            layer=max(law.layer, shrink * _SMOOTHING_LAYER),
            kappa=max(law.kappa, shrink * _SMOOTHING_KAPPA),
        )
        for shrink in (1.0, 0.2, 0.04)
    ] + [law]


def _lead(solver, target, guess, press, laws):
    """Solve for the target from a pose, with one law after the other."""
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
    """Lower the sole at fixed orientation until it carries about `press` [N].

    Returns the state, the load that it carries and the Newton steps taken.
    """
    depth, total = 1e-4, 0
    force = np.array([0.0, 0.0, press])
    aim = replace(target, force=force, rotation=None, is_held=True)
    for _ in range(6):
        # From no forces at every height: a deeper one's would remain.
        state = guess.copy()
        state.O[2] -= depth
        # The references follow the held pose, as for the first sample.
        state, report = solver.solve(state, aim)
        total += report.iterations
        carried = state.F[:, 2].sum()
        if carried > 0.5 * press and carried < 2 * press:
            break
        depth *= np.clip(press / max(carried, 1e-3 * press), 0.2, 10.0)
    resultant = state.F.sum(axis=0)
    P = solver.places(state)
    zmp = (P[:, :2] * state.F[:, 2:]).sum(axis=0) / max(resultant[2], 1e-9)
    x, y = (P[:, :2] - zmp).T
    moment = float(x @ state.F[:, 1] - y @ state.F[:, 0])
    carried = replace(target, force=resultant, zmp=zmp, moment=moment)
    return state, carried, total


def follow_load(
    solver: ContactSolver,
    state: State,
    before: Target,
    target: Target,
    guess: State | None = None,
) -> tuple[State, Convergence]:
    """Solve for the target by Newton from a guess, else by `lead`.

    `state` is the solution for the load `before`; the references are the
    target's all along.
    """
    spent = 0
    if guess is not None:
        new, report = solver.solve(guess, target)
        if report.converged:
            return new, report
        spent = report.iterations
    state, report = lead(solver, state, before, target)
    report.iterations += spent
    return state, report


def lead(solver, state, before: Target, target: Target):
    """Move the load from `before` (equilibrium `state`) to `target` in parts.

    A part that fails is halved. In small or finite strain; the references are
    the target's all along. Returns the last equilibrium and the report.
    """
    done, step, total = 0.0, 1.0, 0
    while done < 1.0 and step >= _LEAST_STEP:
        aim = min(1.0, done + step)
        trial, report = solver.solve(state, target.partway(before, aim))
        total += report.iterations
        if report.converged:
            state, done, step = trial, aim, 2.0 * step
        else:
            step *= 0.5
    report.iterations, report.reached = total, done
    report.converged = done >= 1.0
    if not report.converged:
        report.message += f"; no equilibrium found beyond {done:.3f} of the way"
    return state, report


def refine_time(
    solver: ContactSolver,
    state: State,
    places: np.ndarray,
    before: Target,
    target: Target,
) -> tuple[State, Convergence, np.ndarray]:
    """Reach the target by samples in between, the load linear in time.

    Unlike in `follow_load`, every part is a sample of its own: its references
    are the nodes' places after the part before. `state` and `places` (m, 3) are
    those at `before`. Returns the last state found, its report and references.
    """
    done, part, parts, total = 0.0, 0.5, 0, 0
    references = places
    while done < 1.0 and part >= _LEAST_PART:
        ahead = min(done + part, 1.0)
        end = replace(target, reference=places)
        here, aim = (end.partway(before, t) for t in (done, ahead))
        trial, report = follow_load(solver, state, here, aim)
        total += report.iterations
        if report.converged:
            state, done, references = trial, ahead, places
            places = solver.places(state)
            part, parts = 2.0 * part, parts + 1
        else:
            part *= 0.5
    report.converged, report.iterations, report.parts = done >= 1, total, parts
    if not report.converged:
        report.message = (
            f"no equilibrium beyond {100 * done:.2f} % of the way from the "
            f"sample before, in steps of 1/{round(1 / _LEAST_PART)} of it "
            f"({report.message})"
        )
    return state, report, references


@dataclass
class StepHistory:
    """States of a sole over the N samples of a step.

    A failed sample holds the last attempt's state, and NaN in K_c.

    Attributes:
        F: Forces of the ground on the contact nodes, world [N], (N, m, 3).
        O: Place of the sole frame's origin, world [m], (N, 3).
        R: Orientation, (N, 3, 3).
        P: Places of the contact nodes, world [m], (N, m, 3).
        K_c: Cartesian stiffness about the ZMP, (N, 6, 6).
        reports: Convergence of every sample.
        between: By sample that was reached through others in between, its
            references: places (m, 3) at the last of them.
        linear: Linearisation of every sample, if kept.
        friction: Coulomb's coefficient μ; None if a file lacks it.
    """

    F: np.ndarray
    O: np.ndarray  # noqa: E741
    R: np.ndarray
    P: np.ndarray
    K_c: np.ndarray
    reports: list[Convergence] = field(default_factory=list)
    between: dict[int, np.ndarray] = field(default_factory=dict)
    linear: list[Linearisation] = field(default_factory=list)
    friction: float | None = None

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,); of a file, too."""
        return np.isfinite(self.K_c).all(axis=(1, 2))

    @property
    def failed_steps(self) -> int:
        """Number of samples without a solution."""
        return int((~self.converged).sum())

    def state(self, q: int) -> State:
        """State at sample q (counted from 0)."""
        return State(self.F[q], self.O[q], self.R[q])


def touches_elsewhere(
    sole: Sole, law: ContactLaw, history: StepHistory, ground: Ground = FLAT
) -> bool:
    """Whether a bare node outside the contact nodes reaches the ground."""
    others = np.setdiff1d(sole.mesh.bare, sole.mesh.contact)
    good = np.flatnonzero(history.converged)
    for first in range(0, len(good), _TOGETHER):
        q = good[first : first + _TOGETHER]
        u = sole.displacement(history.F[q] @ history.R[q])
        P = sole.mesh.nodes[others] + u[:, others]
        P = P @ history.R[q].transpose(0, 2, 1) + history.O[q, None]
        P = P.reshape(-1, 3)
        if (P[:, 2] - ground.height(P)).min(initial=np.inf) < law.layer:
            return True
    return False


def write_history(
    path: Path, mesh: TetMesh, times, history, ground=FLAT
) -> None:
    """Write forces, poses, places and stiffness over time as NPZ.

    Also mesh, μ, and the heights of a ground that is not flat.
    """
    known = {} if history.friction is None else {"friction": history.friction}
    np.savez_compressed(
        path,
        times=times,
        force_W=history.F,
        origin_W=history.O,
        rotation_WL=history.R,
        place_W=history.P,
        stiffness=history.K_c,
        contact_nodes=mesh.contact,
        nodes_L=mesh.nodes,
        tets=mesh.tets,
        **known,
        **ground.arrays(),
    )


# What `simulation.write_history` writes: N samples, c contact nodes.
_HISTORY = {
    "times": ("N",),
    "stiffness": ("N", 6, 6),
    "origin_W": ("N", 3),
    "rotation_WL": ("N", 3, 3),
    "place_W": ("N", "c", 3),
    "force_W": ("N", "c", 3),
    "contact_nodes:int": ("c",),
    "nodes_L": ("n", 3),
    "tets:int": ("e", 4),
}
_GROUND = dict(zip(ARRAYS, (("a",), ("b",), ("a", "b")), strict=True))


def read_history(path: Path, remedy: str):
    """Read `write_history`'s file: mesh, times, StepHistory, ground.

    Raises:
        InputError: It is missing or damaged; the message ends with `remedy`.
    """
    data = read_arrays(path, remedy)
    wanted = _HISTORY | (_GROUND if ARRAYS[0] in data else {})
    wanted |= {"friction": ()} if "friction" in data else {}
    _check_arrays(path, data, wanted, remedy)
    names = ("force_W", "origin_W", "rotation_WL", "place_W", "stiffness")
    times, nodes, tets = (data[n] for n in ("times", "nodes_L", "tets"))
    history = StepHistory(*(data[name] for name in names))
    if "friction" in data:
        history.friction = float(data["friction"])
    good = history.converged
    values = (
        *(nodes, data.get("friction", 0.0)),
        *(data[n][good] for n in ("times", *names)),
    )
    if not all((np.abs(x) < _LARGEST).all() for x in values):
        raise InputError(f"{path}: holds gaps; {remedy}")
    is_sound = tets.size and tets.min() >= 0 and tets.max() < len(nodes)
    if is_sound:
        touching = data["contact_nodes"]
        mesh = TetMesh(nodes, tets, np.array([], int))
        surface = np.unique(mesh.boundary_faces)
        fixed = np.setdiff1d(surface, touching)
        is_sound = len(fixed) + len(touching) == len(surface)
    if not is_sound:
        raise InputError(f"{path}: its mesh is damaged; {remedy}")
    # The contact nodes may include sides.
    mesh = replace(mesh, fixed=fixed).with_contact(touching)
    return mesh, times, history, Ground.of_arrays(data)


def _check_arrays(path: Path, arrays, shapes, remedy: str) -> None:
    """Refuse arrays that are missing or of a wrong type or shape.

    In `shapes`, such as `_HISTORY`, letters stand for sizes that must agree. A
    name ending in ":int" must hold integers, others floats.
    """
    sizes: dict[str, int] = {}
    for label, shape in shapes.items():
        name, _, kind = label.partition(":")
        x = arrays.get(name)
        fits = (
            x is not None
            and x.ndim == len(shape)
            and np.issubdtype(x.dtype, np.integer if kind else np.floating)
            and all(
                n == (sizes.setdefault(s, n) if isinstance(s, str) else s)
                for n, s in zip(x.shape, shape, strict=True)
            )
        )
        if not fits:
            raise InputError(
                f"{path}: {name} is missing or of another shape; {remedy}"
            )


def simulate(
    solver: ContactSolver,
    load: Load,
    start: Start,
    *,
    stop_at_failure: bool = False,
    near: StepHistory | None = None,
    largest_force: float | None = None,
    keep: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> StepHistory:
    """Solve for the desired force and ZMP, sample by sample.

    Args:
        solver, load, start: The sole and its contact law, what is asked for,
            and how the sole is held just before contact.
        stop_at_failure: Leave the remaining samples out after a failure.
            Otherwise a sample that cannot be reached from the one before is
            approached through samples in between, see `refine_time`.
        near: History of a neighbouring design, whose increments are first
            guesses. A start on another branch of poses then fails, and so does
            a simulation that takes far more Newton steps than it.
        largest_force: |F| [N] for `first_step`; by default the phase's.
        keep: Keep every sample's linearisation, for derivatives.
        progress: Called with the number of samples done, and of all.
    """
    steps, m = len(load.times), len(solver.lP)
    history = StepHistory(
        np.zeros((steps, m, 3)),
        np.zeros((steps, 3)),
        np.tile(np.eye(3), (steps, 1, 1)),
        np.zeros((steps, m, 3)),
        np.full((steps, 6, 6), np.nan),
        friction=solver.law.friction,
    )
    good = None  # the last sample that converged
    left = 0 if near else np.inf  # Newton steps that may still be taken
    for q in range(steps):
        if q in load.begins:
            good = None
        reference = start if good is None else history.P[good]
        target = load.target(q, reference, solver.ground)
        if near is not None:
            left += _PATIENCE * (10 + near.reports[q].iterations)
        if good is None:
            first = near.state(q) if near else None
            part = load.at(np.flatnonzero(load.phase == load.phase[q]))
            state, report = first_step(
                solver, target, largest_force or part.largest_force, first, left
            )
        else:
            old = history.state(good)
            before = load.target(good, reference, solver.ground)
            guess = _alike(near, good, q, old) if near else None
            state, report = follow_load(solver, old, before, target, guess)
            if not (report.converged or stop_at_failure):
                spent = report.iterations
                state, report, target.reference = refine_time(
                    solver, old, reference, before, target
                )
                report.iterations += spent
                history.between[q] = target.reference
        if state is not None:
            history.F[q], history.O[q] = state.F, state.O
            history.R[q] = state.R
            history.P[q] = solver.places(state)
        left -= report.iterations
        if left < 0:
            report.converged = False
            report.message = "takes far longer than a neighbouring design"
        history.reports.append(report)
        if report.converged:
            lin = solver.linearise(state, target, history.P[q])
            history.K_c[q] = lin.cartesian_stiffness
            if keep:
                history.linear.append(lin.kept())
            good = q
        elif stop_at_failure:
            rest = Convergence(False, 0, np.inf, "left out after a failure")
            history.reports += [rest] * (steps - q - 1)
            break
        if progress is not None:
            progress(q + 1, steps)
    return history


def _alike(near: StepHistory, before: int, now: int, state: State) -> State:
    """A guess: the state, changed as the neighbour's is between samples."""
    old, new = near.state(before), near.state(now)
    # Projected onto rotations: rounding would grow from design to design.
    U, _, Vt = np.linalg.svd(new.R @ old.R.T @ state.R)
    return State(state.F + new.F - old.F, state.O + new.O - old.O, U @ Vt)
