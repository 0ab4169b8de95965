"""Generalized forces of the rigid model from motion and measured forces."""

import numpy as np

from drake_exo.laboratory.sagittal import PlanarWrench
from drake_exo.planar_tree import PlanarTree


def wrench_on_body(
    tree: PlanarTree, q: np.ndarray, body: str, wrench: PlanarWrench
) -> np.ndarray:
    """Generalized forces (N, nq) of a wrench about the world's origin.

    Args:
        tree: the model.
        q: (N, nq) positions.
        body: the body that the wrench acts on.
        wrench: force [N] and moment M_y about the origin [N m].
    """
    p = tree.point_positions(q, body, (0.0, 0.0))
    J = tree.point_jacobian(q, body, (0.0, 0.0))
    # Moment about the body's own origin; the tree turns about -y.
    F_x, F_z = wrench.force.T
    turning = -(wrench.moment - (p[:, 1] * F_x - p[:, 0] * F_z))
    Q = np.einsum("nij,ni->nj", J, wrench.force)
    row = tree.angle_map[tree.segment_of[tree.body_index(body)]]
    Q[:, 2:] += turning[:, None] * row
    return Q


def inverse_dynamics(
    tree: PlanarTree,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    loads: dict[str, PlanarWrench],
) -> np.ndarray:
    """Generalized forces that remain after the measured loads.

    The tree's root is the foot, so the first three components are the forces
    [N] and the pitch moment [N m] about the ankle that motion demands and no
    load explains (zero for perfect data), and the joint moments are those of
    the segments above each joint.

    Args:
        tree: the model.
        q, v, a: (N, nq) filtered positions, velocities, accelerations.
        loads: body name -> wrench on it.

    Returns:
        (N, nq).
    """
    Q = tree.inverse_dynamics(q, v, a)
    for body, wrench in loads.items():
        Q = Q - wrench_on_body(tree, q, body, wrench)
    return Q


def from_the_ground_up(
    tree: PlanarTree, q: np.ndarray, Q: np.ndarray, top: str = "pelvis"
) -> np.ndarray:
    """Move the unexplained force from the foot to the topmost body.

    Joint moments then follow from the ground reaction and the segments
    below each joint, as OpenSim computes them; the first three components
    become zero, and what was there acts on `top` instead.

    Args:
        tree: the model.
        q: (N, nq) positions.
        Q: (N, nq) from `inverse_dynamics`.
        top: body that takes the residual.

    Returns:
        (N, nq) with joint moments changed.
    """
    p = q[:, :2]
    residual = PlanarWrench(
        Q[:, :2], p[:, 1] * Q[:, 0] - p[:, 0] * Q[:, 1] - Q[:, 2]
    )
    return Q - wrench_on_body(tree, q, top, residual)
