"""Generalized forces of the rigid model from motion and measured forces."""

from typing import Protocol

import numpy as np

from drake_exo.measurement.sagittal import PlanarWrench


class PlanarDynamics(Protocol):
    """What inverse dynamics asks of a model; `PlanarTree` offers it."""

    def inverse_dynamics(self, q, v, vdot) -> np.ndarray:
        """Generalized forces (N, nq) of motion and gravity alone."""

    def point_positions(self, q, body: str, p_BoP) -> np.ndarray:
        """Points (N, 2) of a body in the world."""

    def point_jacobian(self, q, body: str, p_BoP) -> np.ndarray:
        """Their derivatives (N, 2, nq)."""


def wrench_on_body(
    model: PlanarDynamics, q: np.ndarray, body: str, wrench: PlanarWrench
) -> np.ndarray:
    """Generalized forces (N, nq) of a wrench about the world's origin.

    Args:
        model: the dynamics.
        q: (N, nq) positions.
        body: the body that the wrench acts on.
        wrench: force [N] and moment M_y about the origin [N m].
    """
    p, tip = (model.point_positions(q, body, e) for e in ((0, 0), (1, 0)))
    J, J_tip = (model.point_jacobian(q, body, e) for e in ((0, 0), (1, 0)))
    # Seen from the right, counter-clockwise (about -y) is positive: the tip
    # of a unit vector then moves along the vector turned by a quarter.
    quarter = np.column_stack([-(tip - p)[:, 1], (tip - p)[:, 0]])
    turning = np.einsum("nij,ni->nj", J_tip - J, quarter)
    F_x, F_z = wrench.force.T
    moment = wrench.moment - (p[:, 1] * F_x - p[:, 0] * F_z)
    Q = np.einsum("nij,ni->nj", J, wrench.force)
    return Q - moment[:, None] * turning


def inverse_dynamics(
    model: PlanarDynamics,
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
    model: PlanarDynamics, q: np.ndarray, Q: np.ndarray, top: str = "pelvis"
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
    p = q[:, :2]
    residual = PlanarWrench(
        Q[:, :2], p[:, 1] * Q[:, 0] - p[:, 0] * Q[:, 1] - Q[:, 2]
    )
    return Q - wrench_on_body(model, q, top, residual)
