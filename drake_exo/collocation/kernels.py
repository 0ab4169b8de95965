"""Equations of a planar model on a ground, for all nodes at once.

Forces enter as decision variables ("controls"), so the equations of motion
and the contact laws are two algebraic constraints at each node.
"""

import numpy as np

from drake_exo.contact.hunt_crossley import (
    sphere_wrench,
    sphere_wrench_derivatives,
)
from drake_exo.contact.parameters import SPHERE_PARAMETERS, GroundContact
from drake_exo.model.planar_tree import PlanarTree

# Residuals are divided by these, so that all are of order one.
FORCE_UNIT = 100.0  # N
MOMENT_UNIT = 100.0  # N m
GROUND_MOMENT_UNIT = 10.0  # N m


class DynamicsKernel:
    """Inverse-dynamics residual of a model that stands on its root.

    Inputs: q, v, a (nq each), joint torques (nj), then ground reaction F_x,
    F_z and M_y about the laboratory origin. Outputs (nq): generalized force
    missing in each coordinate, in units of 100 N and 100 N m.

    Data, if any: (n, nq) generalized forces applied by others.
    """

    def __init__(self, tree: PlanarTree):
        self.tree = tree
        nq = tree.num_positions
        self.num_positions = nq
        self._root = tree.coordinates.root_columns
        self._joints = tree.coordinates.joint_columns
        sizes = [nq, nq, nq, len(self._joints), 3]
        *self._cuts, n_in = np.cumsum(sizes)
        pattern = np.zeros((nq, n_in), bool)
        pattern[:, : 3 * nq] = True
        # No force depends on where the model stands or drifts.
        x, z, pitch = self._root
        for column in (x, z, nq + x, nq + z):
            pattern[:, column] = False
        pattern[pitch, [x, z]] = True
        torques, ground = self._columns()
        pattern[self._joints, torques] = True
        pattern[x, ground[0]] = pattern[z, ground[1]] = True
        pattern[pitch, ground] = True
        self.sparsity = pattern

    def _columns(self):
        """Columns of the torques and of the ground reaction."""
        first = self._cuts[2]
        count = len(self._joints)
        return first + np.arange(count), first + count + np.arange(3)

    def evaluate(self, x, data):
        """See Kernel."""
        q, v, a, torque, ground = np.split(x, self._cuts, axis=1)
        r = self.tree.inverse_dynamics(q, v, a)
        i, k, pitch = self._root
        r[:, [i, k]] -= ground[:, :2]
        # M_y about the origin of a force that acts at the root's origin.
        moment = q[:, k] * ground[:, 0] - q[:, i] * ground[:, 1]
        r[:, pitch] += ground[:, 2] - moment
        r[:, self._joints] -= torque
        if data is not None:
            r -= data
        return r / FORCE_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        q, v, a, _, ground = np.split(x, self._cuts, axis=1)
        nq = self.num_positions
        J = np.zeros((len(x), *self.sparsity.shape))
        parts = self.tree.inverse_dynamics_jacobians(q, v, a)
        for n, part in enumerate(parts):
            J[:, :, n * nq : (n + 1) * nq] = part
        i, k, pitch = self._root
        torques, (F_x, F_z, M_y) = self._columns()
        J[:, pitch, i] += ground[:, 1]
        J[:, pitch, k] -= ground[:, 0]
        J[:, i, F_x] = J[:, k, F_z] = -1.0
        J[:, pitch, F_x] = -q[:, k]
        J[:, pitch, F_z] = q[:, i]
        J[:, pitch, M_y] = 1.0
        J[:, self._joints, torques] = -1.0
        return J / FORCE_UNIT


class FootGroundKernel:
    """Ground reaction that the spheres' law gives, minus the control.

    Inputs: q, v of the foot (x, z, pitch), F_x, F_z, M_y (about the
    laboratory origin), then for each sphere stiffness, dissipation, x and z
    of its centre in the foot frame, and radius (SPHERE_PARAMETERS).
    Outputs: differences in units of 100 N, 100 N, 10 N m.

    Args:
        contact: law, constants, and how many spheres; their parameters are
            inputs.
    """

    def __init__(self, contact: GroundContact):
        self.law = contact.law
        self.constants = contact.checked().constants
        self.num_spheres = num_spheres = len(contact.spheres)
        n_in = 9 + len(SPHERE_PARAMETERS) * num_spheres
        self.sparsity = np.ones((3, n_in), bool)
        self.sparsity[:2, 0] = False
        self.sparsity[:, 6:9] = np.eye(3, dtype=bool)
        # See `curvature`.
        self.curved_inputs = np.ones(n_in, bool)
        self.curved_inputs[6:9] = False
        self.curved_inputs[13 :: len(SPHERE_PARAMETERS)] = False
        self._units = np.array([FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT])

    def evaluate(self, x, data):
        """See Kernel."""
        total = -x[:, 6:9]
        for s in range(self.num_spheres):
            p, motion, _ = self._sphere(x, s)
            wrench = sphere_wrench(
                self.law, *motion, p[0], p[1], p[4], self.constants
            )
            total = total + np.stack(
                [
                    wrench.force_x,
                    wrench.force_z,
                    wrench.point_z * wrench.force_x
                    - wrench.point_x * wrench.force_z,
                ],
                axis=1,
            )
        return total / self._units

    def jacobian(self, x, data):
        """See Kernel."""
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, np.arange(3), np.arange(6, 9)] = -1.0
        for s in range(self.num_spheres):
            self._add_sphere(J, x, s)
        return J / self._units[:, None]

    def _add_sphere(self, J, x, s):
        p, motion, by_inputs = self._sphere(x, s)
        wrench, d = sphere_wrench_derivatives(
            self.law, *motion, p[0], p[1], p[4], self.constants
        )
        # (n, 3, 8): force and moment by WRENCH_INPUTS.
        d_moment = (
            wrench.point_z * d[0]
            - wrench.point_x * d[1]
            + wrench.force_x * d[3]
            - wrench.force_z * d[2]
        )
        D = np.stack([d[0], d[1], d_moment]).transpose(2, 0, 1)
        by_motion = D[:, :, :5] @ by_inputs
        J[:, :, :6] += by_motion[:, :, :6]
        first = 9 + len(SPHERE_PARAMETERS) * s
        J[:, :, first : first + 2] += D[:, :, 5:7]
        J[:, :, first + 2 : first + 4] += by_motion[:, :, 6:]
        J[:, :, first + 4] += D[:, :, 7]

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in).

        The law is so stiff that without this the solver's steps overshoot;
        derivatives by the radius, which is coupled with z, are left out.
        """
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        weights = weights / self._units
        for s in range(self.num_spheres):
            p, motion, by_inputs = self._sphere(x, s)
            first = 9 + len(SPHERE_PARAMETERS) * s
            # Columns: q, v of the foot, place of the centre; then k and c.
            columns = [*range(6), first + 2, first + 3, first, first + 1]
            D = np.zeros((len(x), 7, 10))
            D[:, :5, :8] = by_inputs
            D[:, 5, 8] = D[:, 6, 9] = 1.0
            inner, gradient = self._sphere_curvature(motion, p, weights)
            block = D.transpose(0, 2, 1) @ inner @ D
            block += _motion_curvature(x, p, gradient)
            H[np.ix_(range(len(x)), columns, columns)] += block
        return H

    def _sphere_curvature(self, motion, p, weights):
        """Second and first derivatives of a weighted wrench.

        By the centre's x, z, v_x, v_z, the pitch rate, stiffness and
        dissipation: (n, 7, 7) and (n, 7). Second derivatives of the force
        are differences of its analytic first ones.
        """
        inputs = [*motion, p[0], p[1]]
        steps = [None, 1e-7, 1e-6, 1e-6, 1e-5, 1e-5 * p[0], 1e-5]

        def first(values):
            wrench, d = sphere_wrench_derivatives(
                self.law, *values, p[4], self.constants
            )
            return wrench, d[:2, :7]

        wrench, d = first(inputs)
        n = len(p[0])
        second = np.zeros((2, 7, 7, n))
        for k in range(1, 7):
            up, down = list(inputs), list(inputs)
            up[k], down[k] = inputs[k] + steps[k], inputs[k] - steps[k]
            second[:, k] = (first(up)[1] - first(down)[1]) / (2.0 * steps[k])
        second = 0.5 * (second + second.transpose(0, 2, 1, 3))
        # The contact point's height is a fixed share of the centre's.
        share = 1.0 if self.law == "paper" else 0.5
        along = weights[:, 0] + weights[:, 2] * wrench.point_z
        upward = weights[:, 1] - weights[:, 2] * wrench.point_x
        H = along * second[0] + upward * second[1]
        turning = weights[:, 2]
        H[1] += share * turning * d[0]
        H[:, 1] += share * turning * d[0]
        H[0] -= turning * d[1]
        H[:, 0] -= turning * d[1]
        gradient = along * d[0] + upward * d[1]
        gradient[0] -= turning * wrench.force_z
        gradient[1] += share * turning * wrench.force_x
        return H.transpose(2, 0, 1), gradient.T

    def _sphere(self, x, s):
        """Parameters, motion of the centre, and its derivatives (n, 5, 8).

        The derivatives are by q (3), v (3), and the centre's x, z in the foot.
        """
        first = 9 + len(SPHERE_PARAMETERS) * s
        p = x[:, first : first + len(SPHERE_PARAMETERS)].T
        c, s_ = np.cos(x[:, 2]), np.sin(x[:, 2])
        rate = x[:, 5]
        rx, rz = c * p[2] - s_ * p[3], s_ * p[2] + c * p[3]
        motion = (
            x[:, 0] + rx,
            x[:, 1] + rz,
            x[:, 3] - rz * rate,
            x[:, 4] + rx * rate,
            rate,
        )
        d = np.zeros((len(x), 5, 8))
        d[:, 0, 0] = d[:, 1, 1] = d[:, 2, 3] = d[:, 3, 4] = d[:, 4, 5] = 1.0
        d[:, 0, 2], d[:, 1, 2] = -rz, rx
        d[:, 2, 2], d[:, 3, 2] = -rx * rate, -rz * rate
        d[:, 2, 5], d[:, 3, 5] = -rz, rx
        d[:, 0, 6], d[:, 0, 7] = c, -s_
        d[:, 1, 6], d[:, 1, 7] = s_, c
        d[:, 2, 6], d[:, 2, 7] = -s_ * rate, -c * rate
        d[:, 3, 6], d[:, 3, 7] = c * rate, -s_ * rate
        return p, motion, d


def _motion_curvature(x, p, gradient):
    """Second derivatives of a sphere's motion, weighted: (n, 10, 10).

    By q, v of the foot and the place of the centre; see `_sphere`.
    """
    c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
    rate = x[:, 5]
    rx, rz = c * p[2] - s * p[3], s * p[2] + c * p[3]
    by_x, by_z, by_vx, by_vz = gradient[:, :4].T
    A, B = by_x + rate * by_vz, by_z - rate * by_vx
    H = np.zeros((len(x), 10, 10))
    H[:, 2, 2] = -A * rx - B * rz
    for i, j, value in (
        (2, 6, B * c - A * s),
        (2, 7, -A * c - B * s),
        (2, 5, -by_vz * rz - by_vx * rx),
        (5, 6, by_vz * c - by_vx * s),
        (5, 7, -by_vz * s - by_vx * c),
    ):
        H[:, i, j] += value
        H[:, j, i] += value
    return H
