"""Kernels of a planar model's motion and ground contact, for all nodes at once.

Contact forces are decision variables ("controls"), so the equations of motion
and the contact laws are two algebraic constraints at each node.

A measured wrench, such as the chair's, is data at each node. Its generalized
force depends on q as in the Diagram: a chair bears hundreds of newtons,
so a hip that is a centimetre from where markers saw it changes joint moments by
newton metres. A controller is a LeafSystem that gives the device's torques.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from pydrake.autodiffutils import (
    ExtractGradient,
    ExtractValue,
    InitializeAutoDiff,
)
from pydrake.systems.framework import System
from scipy.interpolate import CubicSpline

from drake_exo.contact.bushing import ROTATION, BushingKinematics
from drake_exo.contact.hunt_crossley import (
    SphereWrench,
    sphere_wrench,
    sphere_wrench_derivatives,
)
from drake_exo.contact.parameters import SPHERE_PARAMETERS, GroundContact
from drake_exo.errors import InputError, reason
from drake_exo.model.planar_tree import PlanarTree

# Residuals are divided by these, so that all are of order one.
FORCE_UNIT = 100.0  # N
MOMENT_UNIT = 100.0  # N m
GROUND_MOMENT_UNIT = 10.0  # N m
WRENCH_UNITS = np.array([FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT])


class DynamicsKernel:
    """Inverse-dynamics residual of a model on the ground, in a device or not.

    Inputs: q, v, a (nq each), joint torques (nj), ground reaction F_x, F_z and
    M_y about the laboratory origin on each body, the bushings' forces (3 each:
    N, N, N m), and their places (see BushingKinematics). Data: wrenches
    (n, 3 m) of a load, see `AppliedWrench.at`. Outputs (nq): residual
    generalized force of each coordinate, in units of 100 N and 100 N m.

    Args:
        tree: the model.
        bodies: bodies that touch the ground; the root by default.
        bushings: kinematics of the cuffs.
        load: further wrenches on the model, if any.
    """

    # It saves a prediction no iteration, and takes a third of its time.
    exact_only = True

    def __init__(
        self,
        tree: PlanarTree,
        bodies: Sequence[str] | None = None,
        bushings: Sequence[BushingKinematics] = (),
        load: "AppliedWrench | None" = None,
    ):
        self.tree = tree
        nq = tree.num_positions
        self.num_positions = nq
        self._root = tree.coordinates.root_columns
        self._joints = tree.coordinates.joint_columns
        bodies = (tree.root,) if bodies is None else bodies
        self._load = load
        sizes = [nq, nq, nq, len(self._joints), 3 * len(bodies)]
        self._cuts = np.cumsum(sizes)
        # Bodies that touch, and columns of their wrenches.
        ends = self._cuts[3] + 3 * np.arange(len(bodies) + 1)
        own = [slice(*pair) for pair in pairwise(ends)]
        self._grounds = list(zip(bodies, own, strict=True))
        sizes = [3] * len(bushings) + [b.num_places for b in bushings]
        ends = self._cuts[-1] + np.cumsum([0, *sizes])
        slices = [slice(*pair) for pair in pairwise(ends)]
        # Each cuff's kinematics, and columns of its force and places.
        own = slices[: len(bushings)], slices[len(bushings) :]
        self._cuffs = list(zip(bushings, *own, strict=True))
        pattern = np.zeros((nq, ends[-1]), bool)
        pattern[:, : 3 * nq] = True
        # Inverse dynamics does not depend on the root's place and velocity.
        x, z, _ = self._root
        pattern[:, [x, z, nq + x, nq + z]] = False
        first = self._cuts[2]
        pattern[self._joints, first + np.arange(len(self._joints))] = True
        for body, own in self._grounds:
            turned = tree.moving(body) | (tree.turning(body) != 0.0)
            # Its moment is about the laboratory's origin.
            pattern[np.ix_(turned, [x, z])] = True
            pattern[turned, own] = True
            pattern[x, own.start] = pattern[z, own.start + 1] = True
        for bushing, force, places in self._cuffs:
            pattern[bushing.moved_by, force] = True
            pattern[bushing.moved_by, places] = True
        if load is not None:
            pattern[2:, :nq] = True
        self.sparsity = pattern
        self.curved_inputs = pattern.any(axis=0)
        self.curved_inputs[first : self._cuts[3]] = False  # joint torques

    def evaluate(self, x, data):
        """See Kernel."""
        q, v, a, torque = np.split(x, self._cuts, axis=1)[:4]
        r = self.tree.inverse_dynamics(q, v, a)
        for body, own in self._grounds:
            r -= self.tree.wrench_on_body(q, body, x[:, own])
        r[:, self._joints] -= torque
        r /= FORCE_UNIT
        for bushing, force, places in self._cuffs:
            J = bushing.deflection_jacobian(bushing.terms(q, x[:, places]))
            r += np.einsum("nc,ncq->nq", x[:, force], J) / FORCE_UNIT
        if self._load is not None:
            r -= self._load.generalized(q, data) / FORCE_UNIT
        return r

    def jacobian(self, x, data):
        """See Kernel."""
        q, v, a = np.split(x, self._cuts, axis=1)[:3]
        nq = self.num_positions
        J = np.zeros((len(x), *self.sparsity.shape))
        parts = self.tree.inverse_dynamics_jacobians(q, v, a)
        for n, part in enumerate(parts):
            J[:, :, n * nq : (n + 1) * nq] = part
        for body, own in self._grounds:
            J[:, :, :nq] -= self.tree.wrench_curvature(q, body, x[:, own])
            J[:, :, own] = -self.tree.by_wrench(q, body)
        J[:, self._joints, self._cuts[2] + np.arange(len(self._joints))] = -1.0
        J /= FORCE_UNIT
        for bushing, force, places in self._cuffs:
            F, turns = x[:, force], bushing.turns(q)
            terms = bushing.terms(q, x[:, places])
            by_force = bushing.deflection_jacobian(terms).transpose(0, 2, 1)
            by_places = bushing.gradient_by_places(turns, F)
            J[:, 2:, :nq] += bushing.curvature(terms, F)[:, 2:] / FORCE_UNIT
            J[:, :, force] = by_force / FORCE_UNIT
            J[:, :, places] = by_places / FORCE_UNIT
        if self._load is not None:
            J[:, :, :nq] -= self._load.by_positions(q, data) / FORCE_UNIT
        return J

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in)."""
        q, v, a = np.split(x, self._cuts, axis=1)[:3]
        nq, w = self.num_positions, weights / FORCE_UNIT
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        H[:, : 3 * nq, : 3 * nq] = self.tree.inverse_dynamics_curvature(
            q, v, a, w
        )
        for body, own in self._grounds:
            by_q, by_wrench = self.tree.wrench_bends(q, body, x[:, own], w)
            H[:, :nq, :nq] -= by_q
            add_pair(H, slice(nq), own, -by_wrench)
        for bushing, f, p in self._cuffs:
            force = x[:, f]
            terms = bushing.led(bushing.terms(q, x[:, p]), w)
            turns = bushing.led(bushing.turns(q), w)
            H[:, :nq, :nq] += bushing.curvature(terms, force)
            by_q = bushing.deflection_jacobian(terms)[:, :ROTATION]
            across = slice(f.start, f.start + ROTATION)
            add_pair(H, across, slice(nq), by_q)
            add_pair(H, across, p, bushing.by_places(turns))
            add_pair(H, slice(nq), p, bushing.gradient_by_places(turns, force))
        if self._load is not None:
            H[:, :nq, :nq] -= self._load.bends(q, data, w)
        return H


def add_pair(H, rows, columns, part) -> None:
    """Add a block and its mirror to Hessians (n, m, m)."""
    H[:, rows, columns] += part
    H[:, columns, rows] += np.swapaxes(part, 1, 2)


class PoseKernel:
    """Pose of a body and its rates by kinematics, minus their variables.

    Inputs: q, v (nq each), then x, z, angle of the body and their rates.
    Outputs: the six differences [m, rad; m/s, rad/s].

    Args:
        tree: the model.
        body: name of the body.
    """

    def __init__(self, tree: PlanarTree, body: str):
        self._tree, self._body = tree, body
        self._nq = nq = tree.num_positions
        moved = tree.moving(body)
        pattern = np.zeros((6, 2 * nq + 6), bool)
        pattern[:2, :nq] = pattern[3:5, :nq] = moved
        pattern[3:5, nq : 2 * nq] = moved
        pattern[[0, 1, 3, 4], [0, 1, nq, nq + 1]] = True
        pattern[2, :nq] = pattern[5, nq : 2 * nq] = tree.turning(body) != 0.0
        pattern[np.arange(6), 2 * nq + np.arange(6)] = True
        self.sparsity = pattern
        self.curved_inputs = np.zeros(2 * nq + 6, bool)
        self.curved_inputs[:nq] = self.curved_inputs[nq : 2 * nq] = moved

    def evaluate(self, x, data):
        """See Kernel."""
        q, v, own = np.split(x, [self._nq, 2 * self._nq], axis=1)
        return self._tree.states(q, v, self._body) - own

    def jacobian(self, x, data):
        """See Kernel."""
        nq, T = self._nq, self._tree.angles_by_q
        q, v = x[:, :nq], x[:, nq : 2 * nq]
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, :3, :nq] = self._tree.pose_jacobian(q, self._body)
        # The derivative of an arm's (-z, x) by its angle is (-x, -z).
        arms = self._tree.arms(q, self._body)
        J[:, 3:5, :nq] = (-(v @ T.T) * arms @ T).transpose(1, 0, 2)
        J[:, 3:, nq : 2 * nq] = J[:, :3, :nq]
        J[:, np.arange(6), 2 * nq + np.arange(6)] = -1.0
        return J

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in).

        It matters because stiff spheres make the multipliers large.
        """
        nq, tree = self._nq, self._tree
        arm_x, arm_z = tree.arms(x[:, :nq], self._body)
        rate = x[:, nq : 2 * nq] @ tree.angles_by_q.T
        place_x, place_z, _, motion_x, motion_z, _ = weights.T[:, :, None]
        along = motion_x * arm_x + motion_z * arm_z
        across = motion_x * arm_z - motion_z * arm_x
        by_phi = rate * across - (place_x * arm_x + place_z * arm_z)
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        H[:, :nq, :nq] = tree.turned_twice(by_phi)
        mixed = tree.turned_twice(-along)
        H[:, :nq, nq : 2 * nq] = H[:, nq : 2 * nq, :nq] = mixed
        return H


class FootGroundKernel:
    """Ground reaction by the spheres' law, minus the control.

    Inputs: q, v of the foot (x, z, pitch), F_x, F_z, M_y (about the
    laboratory origin), then for each sphere stiffness, dissipation, x and z
    of its centre in the foot frame, and radius (SPHERE_PARAMETERS).
    Outputs: differences in units of 100 N, 100 N, 10 N m, the last about the
    foot, so that it does not grow with the distance walked.

    Args:
        contact: gives law, constants and number of spheres; the spheres'
            parameters are inputs.
    """

    def __init__(self, contact: GroundContact):
        self.law = contact.law
        self.constants = contact.checked().constants
        self.num_spheres = num_spheres = len(contact.spheres)
        n_in = 9 + len(SPHERE_PARAMETERS) * num_spheres
        self.sparsity = np.ones((3, n_in), bool)
        self.sparsity[:2, 0] = False
        self.sparsity[:2, 6:9] = np.eye(2, 3, dtype=bool)
        # See `curvature`.
        self.curved_inputs = np.ones(n_in, bool)
        self.curved_inputs[8] = False
        self.curved_inputs[13 :: len(SPHERE_PARAMETERS)] = False

    def wrench(self, x: np.ndarray) -> np.ndarray:
        """The law's F_x, F_z [N] and M_y about the laboratory's origin [N m].

        Args:
            x: (n, n_in) inputs; F_x, F_z, M_y among them are not used.

        Returns:
            (n, 3).
        """
        total = np.zeros((len(x), 3), x.dtype)
        for s in range(self.num_spheres):
            p, motion, _ = self._sphere(x, s)
            wrench = sphere_wrench(
                self.law, *motion, p[0], p[1], p[4], self.constants
            )
            total = total + np.stack(wrench.about_origin, axis=1)
        return total

    def evaluate(self, x, data):
        """See Kernel."""
        off = self.wrench(x) - x[:, 6:9]
        off[:, 2] -= x[:, 1] * off[:, 0] - x[:, 0] * off[:, 1]
        return off / WRENCH_UNITS

    def jacobian(self, x, data):
        """See Kernel."""
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, np.arange(3), np.arange(6, 9)] = -1.0
        off = -x[:, 6:8]
        for s in range(self.num_spheres):
            p, motion, by_inputs = self._sphere(x, s)
            wrench, d = sphere_wrench_derivatives(
                self.law, *motion, p[0], p[1], p[4], self.constants
            )
            # (n, 3, 8): force and moment by all eight arguments.
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
            off += np.column_stack([wrench.force_x, wrench.force_z])
        J[:, 2] -= x[:, [1]] * J[:, 0] - x[:, [0]] * J[:, 1]
        J[:, 2, 0] += off[:, 1]
        J[:, 2, 1] -= off[:, 0]
        return J / WRENCH_UNITS[:, None]

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in).

        The law is so stiff that steps overshoot without it. Derivatives by the
        radius, which is coupled with z, are left out.
        """
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        # The point about which the moment is taken moves with the foot.
        turning = (weights[:, 2] / WRENCH_UNITS[2])[:, None]
        J = self.jacobian(x, data) * WRENCH_UNITS[:, None]
        for k, by_place in ((0, turning * J[:, 1]), (1, -turning * J[:, 0])):
            H[:, k] += by_place
            H[:, :, k] += by_place
        weights = weights / WRENCH_UNITS
        weights[:, 0] -= x[:, 1] * weights[:, 2]
        weights[:, 1] += x[:, 0] * weights[:, 2]
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
        inputs = np.array([*motion, p[0], p[1]])
        n = inputs.shape[1]
        steps = np.tile([[1e-7], [1e-6], [1e-6], [1e-5], [1e-5], [1e-5]], n)
        steps[4] *= p[0]
        # Unchanged; each input but the first a step up; a step down.
        moves = np.zeros((7, 13, n))
        k = np.arange(1, 7)
        moves[k, k], moves[k, 6 + k] = steps, -steps
        wrench, d = sphere_wrench_derivatives(
            self.law,
            *(inputs[:, None] + moves),
            np.broadcast_to(p[4], (13, n)),
            self.constants,
        )
        d = d[:2, :7].transpose(0, 2, 1, 3)
        wrench = SphereWrench(*(part[0] for part in wrench))
        second = np.zeros((2, 7, 7, n))
        second[:, 1:] = (d[:, 1:7] - d[:, 7:]) / (2.0 * steps[:, None])
        second = 0.5 * (second + second.transpose(0, 2, 1, 3))
        d = d[:, 0]
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


class SoleKernel:
    """Height of spheres under a body above the ground.

    Inputs: x, z, angle of the body and their rates. Outputs: height of each
    sphere's lowest point [m].

    Args:
        spheres: (m, 5) SPHERE_PARAMETERS.
    """

    def __init__(self, spheres: np.ndarray):
        _, _, self._x, self._z, self._radius = np.asarray(spheres).T
        self.sparsity = np.zeros((len(spheres), 6), bool)
        self.sparsity[:, 1:3] = True

    def evaluate(self, x, data):
        """See Kernel."""
        c, s = np.cos(x[:, [2]]), np.sin(x[:, [2]])
        return x[:, [1]] + s * self._x + c * self._z - self._radius

    def jacobian(self, x, data):
        """See Kernel."""
        c, s = np.cos(x[:, [2]]), np.sin(x[:, [2]])
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, :, 1] = 1.0
        J[:, :, 2] = c * self._x - s * self._z
        return J


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


class AppliedWrench:
    """Given wrenches over time, each shared by bodies of a model.

    Args:
        tree: the model.
        times: (n,) increasing [s].
        parts: m pairs: body name -> share of the wrench, and the wrench
            (n, 3): F_x, F_z [N] and M_y = z F_x - x F_z about the
            laboratory's origin [N m].
    """

    def __init__(
        self,
        tree: PlanarTree,
        times: np.ndarray,
        parts: Sequence[tuple[Mapping[str, float], np.ndarray]],
    ):
        self._spline = CubicSpline(times, np.hstack([w for _, w in parts]))
        self._tree = tree
        self._bodies = [
            (slice(3 * i, 3 * i + 3), share, name)
            for i, (shares, _) in enumerate(parts)
            for name, share in shares.items()
        ]

    def at(self, times: np.ndarray) -> np.ndarray:
        """The wrenches (n, 3 m) at times [s]."""
        return self._spline(times)

    def generalized(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Generalized forces (n, nq) of wrenches (n, 3 m) at positions q."""
        return sum(
            share * self._tree.wrench_on_body(q, body, wrench[:, own])
            for own, share, body in self._bodies
        )

    def by_positions(self, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Derivatives (n, nq, nq) of `generalized` by q."""
        return sum(
            share * self._tree.wrench_curvature(q, body, wrench[:, own])
            for own, share, body in self._bodies
        )

    def bends(self, q, wrench, weights) -> np.ndarray:
        """Second derivatives (n, nq, nq) by q of weights . `generalized`."""
        return sum(
            share * self._tree.wrench_bends(q, body, wrench[:, own], weights)[0]
            for own, share, body in self._bodies
        )


STATE_PORT = "exoskeleton_state"
TORQUE_PORT = "exoskeleton_torques"


class ControllerKernel:
    """Torques by a stateless controller, minus the control.

    Inputs: the angles, rates and torques of the device's m joints. Data:
    (n, 1) time [s]. Outputs (m): differences in units of 100 N m.

    Args:
        controller: LeafSystem without state that has the input port
            exoskeleton_state (2 m: angles, rates) and the output port
            exoskeleton_torques (m) [N m], and converts to AutoDiffXd.
        num_joints: m.

    Raises:
        InputError: the controller is not such a system.
    """

    def __init__(self, controller: System, num_joints: int):
        self._m = m = num_joints
        if not isinstance(controller, System):
            raise InputError(
                f"the controller is {controller!r}, not a Drake system; give "
                "an object, such as AssistController()"
            )
        if not controller.HasInputPort(STATE_PORT):
            raise InputError(f"the controller has no input port '{STATE_PORT}'")
        size = controller.GetInputPort(STATE_PORT).size()
        if size != 2 * m:
            raise InputError(
                f"the controller's {STATE_PORT} has {size} values, but the "
                f"device {m} joints: declare {2 * m}, angles and rates"
            )
        if not controller.HasOutputPort(TORQUE_PORT):
            raise InputError(
                f"the controller has no output port '{TORQUE_PORT}'"
            )
        if controller.num_continuous_states() > 0 or (
            controller.num_discrete_state_groups() > 0
        ):
            raise InputError(
                "the controller has state of its own; a prediction takes one "
                "that depends on time and the exoskeleton's motion alone"
            )
        try:
            derivative = controller.ToAutoDiffXd()
        except Exception as error:  # it is the user's own code
            raise InputError(
                "the controller does not convert to AutoDiffXd; define it "
                f"with TemplateSystem ({reason(error)})"
            ) from error
        self._systems = {
            False: (controller, controller.CreateDefaultContext()),
            True: (derivative, derivative.CreateDefaultContext()),
        }
        self._try()
        self.sparsity = np.hstack(
            [np.ones((m, 2 * m), bool), np.eye(m, dtype=bool)]
        )
        # Differences of a system node by node would take most of a solve.
        self.curved_inputs = np.zeros(3 * m, bool)

    def _try(self) -> None:
        """Evaluate torques at rest and bent, with and without derivatives.

        Raises:
            InputError: ports have other sizes, evaluation fails, or the system
                for AutoDiffXd gives other torques.
        """
        rest = np.zeros(2 * self._m)
        try:
            at_rest, bent, told = (
                self._torque(rest, 0.0, False),
                self._torque(rest + 0.1, 0.0, False),
                self._torque(InitializeAutoDiff(rest + 0.1).ravel(), 0.0, True),
            )
        except Exception as error:  # it is the user's own code
            raise InputError(
                f"the controller gives no torques at rest ({reason(error)}); "
                f"{STATE_PORT} must be all that it needs"
            ) from error
        if at_rest.shape != (self._m,) or not np.isfinite(at_rest).all():
            raise InputError(
                f"the controller's {TORQUE_PORT} must be {self._m} finite "
                "numbers"
            )
        if not np.allclose(bent, ExtractValue(told).ravel(), equal_nan=True):
            raise InputError(
                "the controller gives other torques once it is converted to "
                "AutoDiffXd; pass all its values on in _construct_copy"
            )

    def _torque(self, state, time, derivatives):
        system, context = self._systems[derivatives]
        context.SetTime(time)
        system.GetInputPort(STATE_PORT).FixValue(context, state)
        return system.GetOutputPort(TORQUE_PORT).Eval(context)

    def evaluate(self, x, data):
        """See Kernel."""
        torque = np.stack(
            [
                self._torque(row[: 2 * self._m], float(t), False)
                for row, t in zip(x, data[:, 0], strict=True)
            ]
        )
        return (torque - x[:, 2 * self._m :]) / MOMENT_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        m = self._m
        J = np.zeros((len(x), m, 3 * m))
        for i, (row, t) in enumerate(zip(x, data[:, 0], strict=True)):
            torque = self._torque(
                InitializeAutoDiff(row[: 2 * m]).ravel(), float(t), True
            )
            gradient = ExtractGradient(torque)
            # Empty if the torques depend on time alone.
            if gradient.size:
                J[i, :, : 2 * m] = gradient
        J[:, np.arange(m), 2 * m + np.arange(m)] = -1.0
        return J / MOMENT_UNIT
