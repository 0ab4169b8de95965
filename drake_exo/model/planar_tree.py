"""Kinematics and dynamics of a planar tree for many states at once.

Drake evaluates one state at a time; collocation and inverse dynamics need
thousands. In the sagittal plane the motion of a tree has a closed
form: with complex numbers p = x + i z for points and w_k = exp(i phi_k) for
the absolute angle of segment k (counter-clockwise seen from the right, about
-y), every body origin is p_b = p_0 + sum_k L_bk w_k with constant L. The
constants are read from the Drake plant, so the SDF stays the only source, and
the result is compared with the plant's own inverse dynamics before it is used.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    JacobianWrtVariable,
    MultibodyForces,
)

from drake_exo.model.coordinates import Coordinates, read_coordinates

DEVICE = "exo_"  # prefix of the shipped device's links and joints
_SAMPLES = 64
_AGREEMENT = 1e-9


@dataclass(frozen=True)
class PlanarTree:
    """A planar floating tree: coordinates x, z, then angles.

    Attributes:
        coordinates: names of the coordinates.
        cuffs: cuff -> (link of the human, link of the device) that it joins;
            only cuffs whose links can move relative to each other.
        joints: hinge -> (inner, outer) link that it joins, seen from the root,
            whichever of them the file calls the child.
        root: body whose x, z and pitch are the first coordinates.
        names: body names, length nb.
        segment_of: (nb,) index of the rigid segment (one of ns) of each body.
        angle_map: (ns, nq - 2) T with absolute angles phi = T theta.
        origins: (nb, ns) complex L: body origins p_b = p_0 + L w [m].
        offsets: (nb,) complex unit numbers: rotation of each body's frame
            relative to its segment.
        mass: total mass [kg].
        first_moments: (ns,) complex h_k = sum_b m_b conj(L_bk) [kg m].
        second_moments: (ns, ns) complex G = sum_b m_b conj(L_b) L_b^T of the
            centres of mass [kg m^2].
        inertias: (ns,) central rotational inertia of each segment [kg m^2].
        gravity: magnitude of gravity along -z [m/s^2].

    """

    coordinates: Coordinates
    cuffs: dict[str, tuple[str, str]]
    joints: dict[str, tuple[str, str]]
    root: str
    names: tuple[str, ...]
    segment_of: np.ndarray
    angle_map: np.ndarray
    origins: np.ndarray
    offsets: np.ndarray
    mass: float
    first_moments: np.ndarray
    second_moments: np.ndarray
    inertias: np.ndarray
    gravity: float

    @property
    def num_positions(self) -> int:
        """Number of coordinates nq (x, z and the angles)."""
        return len(self.coordinates)

    @property
    def weight(self) -> float:
        """Weight of the whole tree [N]."""
        return self.mass * self.gravity

    @staticmethod
    def from_plant(
        plant: MultibodyPlant,
        cuffs: Mapping[str, tuple[str, str]] = MappingProxyType({}),
    ) -> "PlanarTree":
        """Read the constants of a finalized planar plant.

        Args:
            plant: positions are x, z [m] and angles [rad] of one tree, all
                revolute joints parallel to y.
            cuffs: (link of the human, link of the device) by name.

        Raises:
            ValueError: if the plant is not such a tree.

        """
        tree = _read_tree(plant, cuffs)
        _check_against_plant(tree, plant)
        return tree

    @cached_property
    def angles_by_q(self) -> np.ndarray:
        """Derivative of segments' absolute angles by q, (ns, nq)."""
        return np.hstack([np.zeros((len(self.angle_map), 2)), self.angle_map])

    def segment_angles(self, q: np.ndarray) -> np.ndarray:
        """Absolute segment angles (N, ns) [rad] of positions q (N, nq)."""
        return q[:, 2:] @ self.angle_map.T

    def body_index(self, name: str) -> int:
        """Index of a body by name.

        Raises:
            KeyError: if there is none of that name.

        """
        if name not in self.names:
            raise KeyError(f"no body '{name}'; there are {self.names}")
        return self.names.index(name)

    def arms(self, q, body: str, p_BoP=(0.0, 0.0)) -> np.ndarray:
        """Contribution (x, z) of each segment to p_WP, (2, N, ns) [m].

        Its derivative by the segment's angle is (-z, x).
        """
        index, phi = self.body_index(body), self.segment_angles(q)
        L = self.origins[index].copy()
        point = self.offsets[index] * (p_BoP[0] + 1j * p_BoP[1])
        L[self.segment_of[index]] += point
        c, s = np.cos(phi), np.sin(phi)
        return np.stack([c * L.real - s * L.imag, s * L.real + c * L.imag])

    def point_positions(self, q, body: str, p_BoP=(0.0, 0.0)) -> np.ndarray:
        """Positions p_WP (N, 2) [m] of a point fixed in a body.

        Args:
            q: (N, nq) positions.
            body: name of the body B.
            p_BoP: (2,) x and z of the point in B's frame [m].

        """
        return q[:, :2] + self.arms(q, body, p_BoP).sum(axis=2).T

    def point_jacobian(self, q, body: str, p_BoP=(0.0, 0.0)) -> np.ndarray:
        """d(p_WP)/dq, shape (N, 2, nq), of a point fixed in a body."""
        x, z = self.arms(q, body, p_BoP) @ self.angles_by_q
        J = np.stack([-z, x], axis=1)
        J[:, [0, 1], [0, 1]] = 1.0
        return J

    def hinge_place(self, joint: str) -> np.ndarray:
        """Place x, z (2,) [m] of a hinge while all coordinates are zero."""
        q, body = np.zeros((1, self.num_positions)), self.joints[joint][1]
        column = self.coordinates.index(joint)
        # Turned counter-clockwise about the hinge, the body moves across.
        turn = self.turning(body)[column]
        dx, dz = self.point_jacobian(q, body)[0, :, column] / turn
        x, z = self.point_positions(q, body)[0]
        return np.array([x - dz, z + dx])

    def moving(self, body: str) -> np.ndarray:
        """Angles that move a body's origin against the root's, (nq,) bool."""
        lever = self.origins[self.body_index(body)]
        return self.angles_by_q[lever != 0.0].any(axis=0)

    def body_angles(self, q, body: str) -> np.ndarray:
        """Absolute angle (N,) [rad] of a body, counter-clockwise."""
        index = self.body_index(body)
        phi = self.segment_angles(q)[:, self.segment_of[index]]
        return phi + np.angle(self.offsets[index])

    def turning(self, body: str) -> np.ndarray:
        """Derivative (nq,) of `body_angles` by the coordinates."""
        return self.angles_by_q[self.segment_of[self.body_index(body)]]

    def poses(self, q, body: str) -> np.ndarray:
        """Place x, z [m] and angle [rad] of a body, (N, 3)."""
        place = self.point_positions(q, body)
        return np.column_stack([place, self.body_angles(q, body)])

    def pose_jacobian(self, q, body: str) -> np.ndarray:
        """Derivative (N, 3, nq) of `poses` by the coordinates."""
        J = self.point_jacobian(q, body)
        turn = np.broadcast_to(self.turning(body), (len(q), 1, J.shape[2]))
        return np.concatenate([J, turn], axis=1)

    def link_motion(self, q, v, body: str, p_BoP=(0.0, 0.0)):
        """Pose and motion of a link, or of a point fixed in it.

        Args:
            q, v: (N, nq).
            body: name of the link.
            p_BoP: (2,) point in the link, as in `point_positions`.

        Returns:
            Position (2, N) [m], angle (N,) [rad], (v_x, v_z, rate) (3, N)
            [m/s, m/s, rad/s].
        """
        J = self.point_jacobian(q, body, p_BoP)
        velocity = np.einsum("nij,nj->in", J, v)
        return (
            self.point_positions(q, body, p_BoP).T,
            self.body_angles(q, body),
            np.vstack([velocity, v @ self.turning(body)]),
        )

    def states(self, q, v, body: str) -> np.ndarray:
        """Place x, z [m] and angle [rad] of a body, and their rates, (N, 6)."""
        place, angle, motion = self.link_motion(q, v, body)
        return np.column_stack([place.T, angle, motion.T])

    def by_wrench(self, q, body: str) -> np.ndarray:
        """Derivative of generalized forces by a wrench on a body, (N, nq, 3).

        The wrench is F_x, F_z [N] and M_y = z F_x - x F_z about the world's
        origin [N m].

        Args:
            q: (N, nq) positions.
            body: name of the body.
        """
        x, z = self.point_positions(q, body).T[:, :, None]
        dx, dz = self.point_jacobian(q, body).transpose(1, 0, 2)
        # Angles are counter-clockwise, M_y is about y: clockwise.
        turn = np.broadcast_to(self.turning(body), dx.shape)
        return np.stack([dx + z * turn, dz - x * turn, -turn], axis=2)

    def wrench_on_body(self, q, body: str, wrench: np.ndarray) -> np.ndarray:
        """Generalized forces (N, nq) of a wrench (N, 3), see `by_wrench`."""
        return np.einsum("nqw,nw->nq", self.by_wrench(q, body), wrench)

    def wrench_curvature(self, q, body: str, wrench: np.ndarray) -> np.ndarray:
        """Derivative by q (N, nq, nq) of a wrench's generalized forces.

        Args:
            q, body: as in `by_wrench`.
            wrench: (N, 3), held constant.
        """
        x, z = self.arms(q, body)
        F_x, F_z = wrench.T[:2, :, None]
        dx, dz = self.point_jacobian(q, body).transpose(1, 0, 2)
        J = self.turned_twice(-(F_x * x + F_z * z))
        moved = F_x * dz - F_z * dx
        return J + self.turning(body)[None, :, None] * moved[:, None, :]

    def wrench_bends(self, q, body: str, wrench, weights):
        """Second derivatives of weights . `wrench_on_body`.

        Args:
            q, body, wrench: as in `wrench_on_body`.
            weights: (N, nq) of the generalized forces.

        Returns:
            By q twice (N, nq, nq), and by q and the wrench (N, nq, 3).
        """
        x, z = self.arms(q, body)
        F_x, F_z = wrench.T[:2, :, None]
        dx, dz = self.point_jacobian(q, body).transpose(1, 0, 2)
        by_angle = weights @ self.angles_by_q.T
        turned = (weights @ self.turning(body))[:, None]
        own = (by_angle - turned) * (F_x * z - F_z * x)
        by_x = turned * dz - (x * by_angle) @ self.angles_by_q
        by_z = -turned * dx - (z * by_angle) @ self.angles_by_q
        by_wrench = np.stack([by_x, by_z, 0.0 * by_x], axis=2)
        return self.turned_twice(own), by_wrench

    def turned_twice(self, weights: np.ndarray) -> np.ndarray:
        """Hessians (N, nq, nq) by q, from (N, ns) by each absolute angle."""
        T = self.angles_by_q
        return contract(weights, T, T)

    def turned_alone(self, bodies, columns) -> np.ndarray:
        """Change of the coordinates (m, nq) if each body alone turns by 1 rad.

        Args:
            bodies: (m,) names; while one turns, the others of them do not.
            columns: (m,) columns of the angles that may change.
        """
        T = np.array([self.turning(body)[columns] for body in bodies])
        found = np.zeros((len(T), self.num_positions))
        found[:, columns] = np.linalg.inv(T).T
        return found

    def center_of_mass(self, q) -> np.ndarray:
        """Whole-body centre of mass (N, 2) [m] in the world."""
        w = np.exp(1j * self.segment_angles(q))
        p = w @ np.conj(self.first_moments) / self.mass
        return q[:, :2] + np.stack([p.real, p.imag], axis=1)

    def inverse_dynamics(self, q, v, vdot) -> np.ndarray:
        """Generalized forces M(q) vdot + C(q, v) v - tau_g(q).

        Args:
            q: (N, nq) positions, likewise v and vdot.

        Returns:
            (N, nq) forces [N] and moments [N m] that, applied along the
            coordinates, produce vdot without any other force.

        """
        w, phi_d, phi_dd, base = self._motion(q, v, vdot)
        alpha_w = (1j * phi_dd - phi_d**2) * w
        force = self.mass * base + alpha_w @ np.conj(self.first_moments)
        inner = self.first_moments * base[:, None]
        inner = inner + alpha_w @ self.second_moments.T
        moment = (np.conj(w) * inner).imag + self.inertias * phi_dd
        return np.column_stack(
            [force.real, force.imag, moment @ self.angle_map]
        )

    def inverse_dynamics_jacobians(self, q, v, vdot):
        """Derivatives of `inverse_dynamics`.

        Returns:
            (d/dq, d/dv, d/dvdot), each (N, nq, nq).

        """
        w, phi_d, phi_dd, base = self._motion(q, v, vdot)
        alpha = 1j * phi_dd - phi_d**2
        n, ns = w.shape
        h, T = self.first_moments, self.angle_map
        coupling = self._coupling(w)
        inner = h * base[:, None] + (alpha * w) @ self.second_moments.T
        dQ_dphi = (coupling * (1j * alpha)[:, None, :]).imag
        index = np.arange(ns)
        dQ_dphi[:, index, index] -= (np.conj(w) * inner).real
        dQ_dphi_d = coupling.imag * (-2.0 * phi_d)[:, None, :]
        dQ_dphi_dd = coupling.real.copy()
        dQ_dphi_dd[:, index, index] += self.inertias
        hw = np.conj(h) * w
        base_columns = np.conj(w) * h
        dF = (1j * alpha * hw, -2.0 * phi_d * hw, 1j * hw)
        dQ = (dQ_dphi, dQ_dphi_d, dQ_dphi_dd)
        result = []
        for dF_s, dQ_s in zip(dF, dQ, strict=True):
            J = np.zeros((n, self.num_positions, self.num_positions))
            dF_theta = dF_s @ T
            J[:, 0, 2:] = dF_theta.real
            J[:, 1, 2:] = dF_theta.imag
            J[:, 2:, 2:] = T.T @ dQ_s @ T
            result.append(J)
        mass = result[2]
        mass[:, 0, 0] = mass[:, 1, 1] = self.mass
        mass[:, 2:, 0] = base_columns.imag @ T
        mass[:, 2:, 1] = base_columns.real @ T
        return tuple(result)

    def inverse_dynamics_curvature(self, q, v, vdot, weights) -> np.ndarray:
        """Second derivatives of weights . `inverse_dynamics`.

        Args:
            q, v, vdot: as in `inverse_dynamics`.
            weights: (N, nq) of its generalized forces.

        Returns:
            (N, 3 nq, 3 nq) by q, v, vdot.
        """
        w, phi_d, phi_dd, base = self._motion(q, v, vdot)
        n, ns = w.shape
        turned = (weights @ self.angles_by_q.T)[:, :, None]
        alpha = (1j * phi_dd - phi_d**2)[:, None, :]
        rate = -2.0 * phi_d[:, None, :]
        # Weights times the moment on a segment, by the turning of another.
        P = turned * self._coupling(w)
        # Weights times the force that turning segments exert on the base.
        lead = weights[:, 0] - 1j * weights[:, 1]
        f = lead[:, None] * np.conj(self.first_moments) * w
        lever = turned[:, :, 0] * self.first_moments * np.conj(w)
        index = np.arange(ns)

        def by_angle(pairs, own):
            """d2/dphi d(phi, phi_d or phi_dd): angles enter by differences."""
            H = pairs.copy()
            H[:, index, index] += own - pairs.sum(axis=1)
            return H

        S = (P * alpha).imag
        own = -(f * alpha[:, 0]).real
        own -= (lever * base[:, None]).imag
        by_phi = by_angle(S + S.transpose(0, 2, 1), own)
        by_phi_d = by_angle(-(P * rate).real, (1j * f * rate[:, 0]).real)
        by_phi_dd = by_angle(P.imag, -f.real)
        nq, T = self.num_positions, self.angles_by_q
        H = np.zeros((n, 3 * nq, 3 * nq))
        for k, block in enumerate((by_phi, by_phi_d, by_phi_dd)):
            part = T.T @ block @ T
            if k == 2:
                part[:, :, 0] -= lever.real @ T
                part[:, :, 1] += lever.imag @ T
            H[:, :nq, k * nq : (k + 1) * nq] = part
            H[:, k * nq : (k + 1) * nq, :nq] = part.transpose(0, 2, 1)
        own = -2.0 * (P.imag.sum(axis=1) + f.real)
        H[:, nq : 2 * nq, nq : 2 * nq] = self.turned_twice(own)
        return H

    def ground_reaction(self, q: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """Wrench on the root equivalent to generalized forces Q of the root.

        Args:
            q: (N, nq) positions.
            Q: (N, nq) generalized forces.

        Returns:
            (N, 3) F_x, F_z [N] and M_y = z F_x - x F_z about the world's
            origin [N m].
        """
        F_x, F_z, pitch = Q[:, self.coordinates.root_columns].T
        # M_y is about y, angles are about -y.
        moment = q[:, 1] * F_x - q[:, 0] * F_z - pitch
        return np.column_stack([F_x, F_z, moment])

    def _coupling(self, w):
        """Moments (n, ns, ns) on segments by others' accelerations."""
        return np.conj(w)[:, :, None] * self.second_moments * w[:, None, :]

    def _motion(self, q, v, vdot):
        T = self.angle_map.T
        w = np.exp(1j * (q[:, 2:] @ T))
        base = vdot[:, 0] + 1j * (vdot[:, 1] + self.gravity)
        return w, v[:, 2:] @ T, vdot[:, 2:] @ T, base


def _read_tree(plant: MultibodyPlant, cuffs) -> PlanarTree:
    context = plant.CreateDefaultContext()
    bodies = [
        plant.get_body(index)
        for index in map(BodyIndex, range(1, plant.num_bodies()))
        if not plant.IsAnchored(plant.get_body(index))
    ]
    turns, offsets = _angles(plant, context, bodies)
    rows, segment_of = np.unique(
        np.round(turns, 9), axis=0, return_inverse=True
    )
    segment_of = segment_of.reshape(-1)
    origins = _origins(plant, context, bodies, rows)
    ns = len(rows)
    h = np.zeros(ns, complex)
    G = np.zeros((ns, ns), complex)
    inertias = np.zeros(ns)
    total = 0.0
    for b, body in enumerate(bodies):
        M_B = body.CalcSpatialInertiaInBodyFrame(context)
        mass, p = M_B.get_mass(), M_B.get_com()
        lever = origins[b].copy()
        lever[segment_of[b]] += offsets[b] * (p[0] + 1j * p[2])
        h += mass * np.conj(lever)
        G += mass * np.outer(np.conj(lever), lever)
        central = M_B.Shift(p).CalcRotationalInertia().CopyToFullMatrix3()
        inertias[segment_of[b]] += central[1, 1]
        total += mass
    gravity = plant.gravity_field().gravity_vector()
    names = tuple(body.name() for body in bodies)
    coordinates = read_coordinates(plant)
    turn = dict(zip(names, turns, strict=True))
    return PlanarTree(
        coordinates=coordinates,
        cuffs={
            cuff: links
            for cuff, links in cuffs.items()
            if len({segment_of[names.index(link)] for link in links}) == 2
        },
        joints=_joints(plant, turn, coordinates),
        root=bodies[0].name(),
        names=names,
        segment_of=segment_of,
        angle_map=rows,
        origins=origins,
        offsets=offsets,
        mass=total,
        first_moments=h,
        second_moments=G,
        inertias=inertias,
        gravity=-float(gravity[2]),
    )


def _joints(plant, turn, coordinates) -> dict[str, tuple[str, str]]:
    found = {}
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        if joint.num_positions() == 1:
            ends = (joint.parent_body().name(), joint.child_body().name())
            column = coordinates.index(joint.name()) - 2
            outward = turn[ends[1]][column] != 0.0
            found[joint.name()] = ends if outward else ends[::-1]
    return found


def _angles(plant, context, bodies):
    """Rows dphi/dtheta (nb, nq - 2), unit numbers exp(i phi) at zero (nb,)."""
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    turns, offsets = [], []
    for body in bodies:
        J = plant.CalcJacobianAngularVelocity(
            context,
            JacobianWrtVariable.kQDot,
            body.body_frame(),
            plant.world_frame(),
            plant.world_frame(),
        )
        turns.append(-J[1, 2:])
        axis = plant.EvalBodyPoseInWorld(context, body).rotation().matrix()
        offsets.append(axis[0, 0] + 1j * axis[2, 0])
    return np.array(turns), np.array(offsets)


def _origins(plant, context, bodies, rows):
    """Solve p_b = p_0 + L w for L from the plant's own kinematics."""
    rng = np.random.default_rng(0)
    theta = rng.uniform(-np.pi, np.pi, (_SAMPLES, rows.shape[1]))
    w = np.exp(1j * theta @ rows.T)
    p = np.empty((_SAMPLES, len(bodies)), complex)
    for s in range(_SAMPLES):
        plant.SetPositions(context, np.r_[0.0, 0.0, theta[s]])
        for b, body in enumerate(bodies):
            p_WB = plant.EvalBodyPoseInWorld(context, body).translation()
            p[s, b] = p_WB[0] + 1j * p_WB[2]
    L = np.linalg.lstsq(w, p, rcond=None)[0].T
    # Rounding leaves about 1e-16 where the geometry has exact zeros.
    return np.round(L.real, 14) + 1j * np.round(L.imag, 14)


def _check_against_plant(tree: PlanarTree, plant: MultibodyPlant) -> None:
    context = plant.CreateDefaultContext()
    rng = np.random.default_rng(1)
    q, v, vdot = rng.uniform(-1.0, 1.0, (3, plant.num_positions()))
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    expected = plant.CalcInverseDynamics(context, vdot, forces)
    found = tree.inverse_dynamics(q[None], v[None], vdot[None])[0]
    scale = np.abs(expected).max()
    if not np.abs(found - expected).max() <= _AGREEMENT * scale:
        raise ValueError(
            "the plant is not a planar tree with coordinates x, z and "
            "revolute joints about y: its inverse dynamics differ by "
            f"{np.abs(found - expected).max():.3g} from the planar ones"
        )


def contract(weights, rows, columns) -> np.ndarray:
    """sum_k weights_nk rows_ki columns_kj, (n, i, j), as one product."""
    pairs = rows[:, :, None] * columns[:, None]
    flat = weights @ pairs.reshape(len(pairs), -1)
    return flat.reshape(-1, *pairs.shape[1:])
