"""Places of the contact nodes, residuals of node law and wrench, compiled."""

import numba
import numpy as np

from drake_exo.soles.node_law import project_node


@numba.njit(cache=True)
def deformed(C, lP, R, F):
    """Y = R (lP + C Rᵀ F): places relative to O, world [m], (m, 3).

    Args:
        C: Compliance of the contact nodes, sole frame [m/N], (3m, 3m).
        lP: Their rest positions, sole frame [m], (m, 3).
        R: Orientation, (3, 3).
        F: Forces on them, world [N], (m, 3); most are zero.
    """
    m = len(lP)
    u = np.zeros(3 * m)
    for i in range(m):
        x, y, z = F[i, 0], F[i, 1], F[i, 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        f0 = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
        f1 = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
        f2 = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        # C is symmetric: its rows lie together in memory.
        c0, c1, c2 = C[3 * i], C[3 * i + 1], C[3 * i + 2]
        for j in range(3 * m):
            u[j] += f0 * c0[j] + f1 * c1[j] + f2 * c2[j]
    Y = np.empty((m, 3))
    for i in range(m):
        # Added last: rest positions are large against displacements.
        x, y, z = lP[i] + u[3 * i : 3 * i + 3]
        for k in range(3):
            Y[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z
    return Y


@numba.njit(cache=True)
def residual(P, F, Q_t, zmp, r, mu, epsilon, kappa):
    """Residuals of the node law and of the wrench at places P.

    Args:
        P: World places [m], (m, 3).
        F: World forces [N], (m, 3).
        Q_t: Tangential references [m], (m, 2).
        zmp: Desired ZMP on the ground [m], (2,).
        r: Penalty [N/m].
        mu, epsilon, kappa: The contact law's, see `node_law`.

    Returns:
        τ = F − r δ and φ = F − T(τ) (m, 3) [N], arms P − ZMP (m, 3) [m],
        force and moment about the ZMP (6,), largest |φ|.
    """
    m = len(P)
    tau, phi, arm = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))
    wrench, largest = np.zeros(6), 0.0
    T, D = np.empty(3), np.empty((3, 3))
    for i in range(m):
        tau[i, 0] = F[i, 0] - r * (P[i, 0] - Q_t[i, 0])
        tau[i, 1] = F[i, 1] - r * (P[i, 1] - Q_t[i, 1])
        tau[i, 2] = F[i, 2] - r * P[i, 2]
        project_node(tau[i], mu, epsilon, kappa, T, D)
        arm[i, 0], arm[i, 1] = P[i, 0] - zmp[0], P[i, 1] - zmp[1]
        arm[i, 2] = P[i, 2]
        for j in range(3):
            k, h = (j + 1) % 3, (j + 2) % 3
            phi[i, j] = F[i, j] - T[j]
            size = abs(phi[i, j])
            if size > largest or size != size:  # once NaN, always NaN
                largest = size
            wrench[j] += F[i, j]
            wrench[3 + j] += arm[i, k] * F[i, h] - arm[i, h] * F[i, k]
    return tau, phi, arm, wrench, largest
