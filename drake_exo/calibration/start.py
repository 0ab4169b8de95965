"""Initial guess of a phase: the measured motion, feet settled to carry it."""

from typing import NamedTuple

import numpy as np

from drake_exo.collocation.initial_guess import settle_foot, settle_rolling
from drake_exo.collocation.kernels import FORCE_UNIT
from drake_exo.measurement.trial import Trial

# Typical changes, in least squares, of lengths [m], angles [rad] and feet.
_LENGTH_M, _ANGLE_RAD, _FOOT = 0.01, 0.05, 1e-4
_PASSES = 6
_RATE_X = 3  # index of the foot's dx/dt among a law's inputs
# Least slope of friction used [N s/m]; largest change of velocity [m/s].
_STEEP, _STEP = 100.0, 0.03


class Start(NamedTuple):
    """Motion (n, nq) at the nodes; segment that touches -> wrench (n, 3)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ground: dict[str, np.ndarray]


def settled(problem, movement, at: Trial, contact) -> Start:
    """A measured motion with its feet settled onto the measured forces.

    Args:
        problem: a `PhaseProblem`.
        movement: one of its trials.
        at: that trial at the nodes.
        contact: gives the spheres.
    """
    if list(problem.soles) == [problem.tree.root]:
        return _one_foot(problem, movement, at, contact)
    return _rolling_feet(problem, movement, at, contact)


def _one_foot(problem, movement, at, contact) -> Start:
    """Settle the root, a foot; joints move as measured."""
    tree, times = problem.tree, movement.grid.times
    root = tree.coordinates.root_columns
    q, v, a = at.q.copy(), at.v.copy(), at.a.copy()
    ground = at.ground.array
    if not ground.any():  # not measured
        forces = tree.inverse_dynamics(q, v, a) - movement.applied(q)
        ground = tree.ground_reaction(q, forces)
    q[:, root], v[:, root] = settle_foot(
        problem.kernels[tree.root],
        problem.sphere_values(contact, tree.root),
        times,
        at.q[:, root],
        ground,
    )
    a[:, root] = np.gradient(v[:, root], times, axis=0)
    return Start(q, v, a, {tree.root: ground})


def _rolling_feet(problem, movement, at, contact) -> Start:
    """Settle both feet; the coordinates follow them by least squares."""
    tree, times = problem.tree, movement.grid.times
    targets = []
    for side, bodies in problem.feet.items():
        # The foot, also if only other segments of it touch the ground.
        foot = "foot" if side == "both" else f"foot_{side}"
        measured = tree.poses(at.q, foot)
        spheres = [problem.sphere_values(contact, b) for b in bodies]
        places = [
            _in_foot(tree, at.q, measured, body, own)
            for body, own in zip(bodies, spheres, strict=True)
        ]
        pose, rate = settle_rolling(
            problem.kernels[bodies[0]],
            np.concatenate(spheres),
            np.concatenate(places, axis=1),
            times,
            measured,
            at.soles[side].array,
        )
        targets.append((foot, pose, rate))
    q = _followed(tree, at.q, targets)
    v = np.gradient(q, times, axis=0)
    J = np.hstack([tree.pose_jacobian(q, foot) for foot, _, _ in targets])
    wanted = np.hstack([rate for _, _, rate in targets])
    v = v + _least_change(tree, J, wanted - np.einsum("nij,nj->ni", J, v))
    for _ in range(_PASSES):
        v = v + _least_change(tree, J, _slip(problem, contact, at, q, v))
    a = np.gradient(v, times, axis=0)
    ground = {
        body: _law(problem, contact, body, q, v)[0] for body in problem.soles
    }
    return Start(q, v, a, ground)


def _law(problem, contact, body, q, v):
    """Wrench (n, 3) by the law, and dF_x/dv_x (n,) [N s/m]."""
    x = problem.law_inputs(contact, body, q, v)
    kernel = problem.kernels[body]
    slope = kernel.jacobian(x, None)[:, 0, _RATE_X] * FORCE_UNIT
    return kernel.wrench(x), slope


def _slip(problem, contact, at, q, v) -> np.ndarray:
    """Change (n, 3 feet) of the feet's velocities that corrects F_x.

    To be repeated: hinged toes creep differently from their foot.
    """
    columns = []
    for side, bodies in problem.feet.items():
        laws = [_law(problem, contact, body, q, v) for body in bodies]
        force = sum(wrench[:, 0] for wrench, _ in laws)
        slope = sum(slope for _, slope in laws)
        missing = at.soles[side].force_x - force
        steep = np.abs(slope) > _STEEP
        step = np.where(steep, missing / np.where(steep, slope, 1.0), 0.0)
        columns += [np.clip(step, -_STEP, _STEP), *np.zeros((2, len(step)))]
    return np.column_stack(columns)


def _in_foot(tree, q, foot, body, spheres) -> np.ndarray:
    """Places (n, m, 2) of a body's spheres in the foot's frame."""
    turn = np.exp(-1j * foot[:, 2])
    found = []
    for _, _, x, z, _ in spheres:
        p = tree.point_positions(q, body, (x, z)) - foot[:, :2]
        p = (p[:, 0] + 1j * p[:, 1]) * turn
        found.append(np.column_stack([p.real, p.imag]))
    return np.stack(found, axis=1)


def _least_change(tree, J, missing) -> np.ndarray:
    """Smallest weighted change (n, nq) with J change = missing (n, m)."""
    size = np.where(tree.coordinates.is_angle, _ANGLE_RAD, _LENGTH_M)
    A = J * size
    normal = A @ A.transpose(0, 2, 1) + _FOOT**2 * np.eye(A.shape[1])
    found = np.linalg.solve(normal, missing[..., None])
    return size * (A.transpose(0, 2, 1) @ found)[..., 0]


def _followed(tree, measured, targets) -> np.ndarray:
    """Coordinates (n, nq) near the measured ones that put feet in place."""
    q = measured.copy()
    wanted = np.hstack([pose for _, pose, _ in targets])
    for _ in range(_PASSES):
        J = np.hstack([tree.pose_jacobian(q, foot) for foot, _, _ in targets])
        off = wanted - np.hstack(
            [tree.poses(q, foot) for foot, _, _ in targets]
        )
        # The change is least from the measured posture, not from the last one.
        off = off + np.einsum("nij,nj->ni", J, q - measured)
        q = measured + _least_change(tree, J, off)
    return q
