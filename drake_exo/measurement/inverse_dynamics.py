"""Generalized forces of the rigid model from motion and measured forces."""

import numpy as np

from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.planar_tree import PlanarTree


def wrench_on_body(
    model: PlanarTree, q: np.ndarray, body: str, wrench: PlanarWrench
) -> np.ndarray:
    """Generalized forces (N, nq) of a wrench about the world's origin.

    Args:
        model: the dynamics.
        q: (N, nq) positions.
        body: the body that the wrench acts on.
        wrench: force [N] and moment M_y about the origin [N m].
    """
    p = model.point_positions(q, body, (0, 0))
    J = model.point_jacobian(q, body, (0, 0))
    F_x, F_z = wrench.force.T
    moment = wrench.moment - (p[:, 1] * F_x - p[:, 0] * F_z)
    Q = np.einsum("nij,ni->nj", J, wrench.force)
    # M_y is about y, angles are about -y.
    return Q - moment[:, None] * model.turning(body)


def inverse_dynamics(
    model: PlanarTree,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    loads: dict[str, PlanarWrench],
) -> np.ndarray:
    """Generalized forces that remain after the measured loads.

    With the foot as root, the first three components are the forces
    [N] and the pitch moment [N m] about the ankle that motion demands and no
    load explains (zero for perfect data), and the joint moments are those of
    the segments above each joint.

    Args:
        model: the dynamics.
        q, v, a: (N, nq) filtered positions, velocities, accelerations.
        loads: body name -> wrench on it.

    Returns:
        (N, nq).
    """
    Q = model.inverse_dynamics(q, v, a)
    for body, wrench in loads.items():
        Q = Q - wrench_on_body(model, q, body, wrench)
    return Q


def from_the_ground_up(
    model: PlanarTree, q: np.ndarray, Q: np.ndarray, top: str = "pelvis"
) -> np.ndarray:
    """Move the unexplained force from the foot to the topmost body.

    Joint moments then follow from the ground reaction and the segments
    below each joint, as OpenSim computes them; the first three components
    become zero, and what was there acts on `top` instead.

    Args:
        model: the dynamics.
        q: (N, nq) positions.
        Q: (N, nq) from `inverse_dynamics`.
        top: body that takes the residual.

    Returns:
        (N, nq) with joint moments changed.
    """
    residual = PlanarWrench.of(model.ground_reaction(q, Q))
    return Q - wrench_on_body(model, q, top, residual)
