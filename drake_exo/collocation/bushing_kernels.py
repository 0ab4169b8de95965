"""Human-exoskeleton bushings in a collocation problem.

With complex numbers, the deflection of the exoskeleton's frame seen from the
human's is delta = sum_k D_k exp(i psi_k), psi_k = phi_k - phi_human: constant
coefficients D, and angles relative to the human segment. Its real part is the
normal deflection, the imaginary part the tangential one. All derivatives
follow term by term; `forces.bushing` is the law that they are tested against.

Components are in the order of `forces.bushing`: tangential, normal, rotation.
Forces are on the human; the generalized force of a bushing is -(dd/dq)^T F.
"""

import numpy as np

from drake_exo.collocation.kernels import FORCE_UNIT, DynamicsKernel
from drake_exo.model.planar_tree import PlanarTree

BUSHINGS = ("shank", "thigh", "pelvis")
BUSHING_PARAMETERS = (
    "origin_x",
    "origin_z",
    "tangential_stiffness",
    "normal_stiffness",
    "rotational_stiffness",
)
NORMAL = 1  # component that a pressure mat measures
INTERACTION_FORCE_UNIT = 10.0  # N
INTERACTION_MOMENT_UNIT = 1.0  # N m
UNITS = np.array(
    [
        INTERACTION_FORCE_UNIT,
        INTERACTION_FORCE_UNIT,
        INTERACTION_MOMENT_UNIT,
    ]
)


class Bushing:
    """Geometry of one bushing for all nodes at once.

    Args:
        tree: the coupled model.
        segment: "shank", "thigh" or "pelvis".
        preload: (x, z, angle) of the exoskeleton's frame beyond the human's
            when both chains are aligned [m, m, rad].
    """

    def __init__(self, tree: PlanarTree, segment: str, preload=(0, 0, 0)):
        human, device = (
            tree.body_index(segment),
            tree.body_index(f"exo_{segment}"),
        )
        self.nq = tree.num_positions
        self._h = tree.segment_of[human]
        self._e = tree.segment_of[device]
        self._D0 = tree.origins[device] - tree.origins[human]
        self._D0 = self._D0.astype(complex)
        self._D0[self._e] += preload[0] + 1j * preload[1]
        self._angle = preload[2]
        T = tree.angle_map
        self.relative = T - T[self._h]
        self.rotation = np.zeros(self.nq)
        self.rotation[2:] = T[self._e] - T[self._h]

    def terms(self, q, origin):
        """D_k exp(i psi_k), (n, ns), at q (n, nq), origin (n, 2)."""
        w = np.exp(1j * (q[:, 2:] @ self.relative.T))
        o = origin[:, 0] + 1j * origin[:, 1]
        terms = self._D0 * w
        terms[:, self._e] += o * w[:, self._e]
        terms[:, self._h] -= o
        return terms

    def turn(self, q):
        """exp(i psi) of the exoskeleton's segment, (n,)."""
        return np.exp(1j * (q[:, 2:] @ self.relative[self._e]))

    def deflection(self, q, terms):
        """Tangential, normal [m], rotation [rad]: (n, 3)."""
        delta = terms.sum(axis=1)
        angle = q @ self.rotation + self._angle
        return np.stack([delta.imag, delta.real, angle], axis=1)

    def deflection_jacobian(self, terms):
        """By q: (n, 3, nq)."""
        d = (1j * terms) @ self.relative
        J = np.zeros((len(terms), 3, self.nq))
        J[:, 0, 2:], J[:, 1, 2:] = d.imag, d.real
        J[:, 2] = self.rotation
        return J

    def rate_jacobian(self, terms, v):
        """Of the deflection's rate by q, (n, 3, nq)."""
        speed = v[:, 2:] @ self.relative.T
        d = (-terms * speed) @ self.relative
        J = np.zeros((len(terms), 3, self.nq))
        J[:, 0, 2:], J[:, 1, 2:] = d.imag, d.real
        return J

    def by_origin(self, turn):
        """Of tangential and normal deflection by origin x, z: (n, 2, 2)."""
        g = turn - 1.0
        return np.stack(
            [
                np.stack([g.imag, g.real], axis=1),
                np.stack([g.real, -g.imag], axis=1),
            ],
            axis=1,
        )

    def curvature(self, terms, force):
        """Hessian by the angles of F . d, (n, nq - 2, nq - 2)."""
        f = force[:, 1] + 1j * force[:, 0]
        c = -(np.conj(f)[:, None] * terms).real
        return np.einsum(
            "nk,ki,kj->nij", c, self.relative, self.relative, optimize=True
        )

    def gradient_by_origin(self, turn, force):
        """d2(F . d)/(dq d origin), (n, nq, 2): how the moment arm moves."""
        f = force[:, 1] + 1j * force[:, 0]
        g = (np.conj(f) * 1j * turn)[:, None] * self.relative[self._e]
        result = np.zeros((len(turn), self.nq, 2))
        result[:, 2:, 0] = g.real
        result[:, 2:, 1] = (1j * g).real
        return result


class CoupledDynamicsKernel:
    """DynamicsKernel with bushing forces.

    Inputs: those of DynamicsKernel, then the bushings' forces (3 each: N, N,
    N m), then their origins (x, z each). Outputs as DynamicsKernel.
    """

    def __init__(self, tree: PlanarTree, bushings: list[Bushing]):
        self._dynamics = DynamicsKernel(tree)
        self._bushings = bushings
        nq, nb = tree.num_positions, len(bushings)
        self._first = self._dynamics.sparsity.shape[1]
        pattern = np.zeros((nq, self._first + 5 * nb), bool)
        pattern[:, : self._first] = self._dynamics.sparsity
        moved = np.zeros((nq, 2), bool)
        moved[2:] = True
        for b, bushing in enumerate(bushings):
            angles = np.zeros(nq, bool)
            angles[2:] = (bushing.relative != 0.0).any(axis=0)
            force = slice(self._first + 3 * b, self._first + 3 * b + 3)
            pattern[angles, force] = True
            first = self._first + 3 * nb + 2 * b
            pattern[angles, first : first + 2] = True
        self.sparsity = pattern

    def _parts(self, x, b):
        nb = len(self._bushings)
        force = x[:, self._first + 3 * b : self._first + 3 * b + 3]
        first = self._first + 3 * nb + 2 * b
        return force, x[:, first : first + 2]

    def evaluate(self, x, data):
        """See Kernel."""
        nq = self._dynamics.num_positions
        r = self._dynamics.evaluate(x[:, : self._first], data)
        for b, bushing in enumerate(self._bushings):
            force, origin = self._parts(x, b)
            J = bushing.deflection_jacobian(bushing.terms(x[:, :nq], origin))
            r += np.einsum("nc,ncq->nq", force, J) / FORCE_UNIT
        return r

    def jacobian(self, x, data):
        """See Kernel."""
        nq, nb = self._dynamics.num_positions, len(self._bushings)
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, :, : self._first] = self._dynamics.jacobian(
            x[:, : self._first], data
        )
        for b, bushing in enumerate(self._bushings):
            force, origin = self._parts(x, b)
            q = x[:, :nq]
            terms = bushing.terms(q, origin)
            J[:, 2:, 2:nq] += bushing.curvature(terms, force) / FORCE_UNIT
            first = self._first + 3 * b
            J[:, :, first : first + 3] = (
                bushing.deflection_jacobian(terms).transpose(0, 2, 1)
                / FORCE_UNIT
            )
            first = self._first + 3 * nb + 2 * b
            J[:, :, first : first + 2] = (
                bushing.gradient_by_origin(bushing.turn(q), force) / FORCE_UNIT
            )
        return J


class BushingKernel:
    """Force that a bushing's law gives, minus the control.

    Inputs: q, v, force (3), then BUSHING_PARAMETERS. Outputs: differences in
    units of 10 N, 10 N, 1 N m.

    Args:
        bushing: the geometry.
        damping: (3,) tangential, normal [N s/m], rotational [N m s/rad].
        scale: multiplies stiffness and damping, as in Phase C2.
    """

    def __init__(self, bushing: Bushing, damping, scale: float = 1.0):
        self._bushing = bushing
        self._damping = scale * np.asarray(damping, float)
        self._scale = scale
        nq = self.nq = bushing.nq
        pattern = np.zeros((3, 2 * nq + 8), bool)
        angles = np.zeros(nq, bool)
        angles[2:] = (bushing.relative != 0.0).any(axis=0)
        pattern[:2, :nq] = pattern[:2, nq : 2 * nq] = angles
        pattern[2, :nq] = pattern[2, nq : 2 * nq] = bushing.rotation != 0.0
        pattern[:, 2 * nq : 2 * nq + 3] = np.eye(3, dtype=bool)
        pattern[:2, 2 * nq + 3 : 2 * nq + 5] = True
        pattern[:, 2 * nq + 5 :] = np.eye(3, dtype=bool)
        self.sparsity = pattern

    def _split(self, x):
        nq = self.nq
        q, v, force, origin, stiffness = np.split(
            x, [nq, 2 * nq, 2 * nq + 3, 2 * nq + 5], axis=1
        )
        return q, v, force, origin, self._scale * stiffness

    def evaluate(self, x, data):
        """See Kernel."""
        q, v, force, origin, stiffness = self._split(x)
        terms = self._bushing.terms(q, origin)
        d = self._bushing.deflection(q, terms)
        J = self._bushing.deflection_jacobian(terms)
        rate = np.einsum("ncq,nq->nc", J, v)
        return (stiffness * d + self._damping * rate - force) / UNITS

    def jacobian(self, x, data):
        """See Kernel."""
        q, v, _, origin, stiffness = self._split(x)
        b, nq = self._bushing, self.nq
        terms = b.terms(q, origin)
        D = b.deflection_jacobian(terms)
        J = np.zeros((len(x), *self.sparsity.shape))
        damping = self._damping[:, None]
        J[:, :, :nq] = stiffness[:, :, None] * D
        J[:, :, :nq] += damping * b.rate_jacobian(terms, v)
        J[:, :, nq : 2 * nq] = damping * D
        J[:, np.arange(3), 2 * nq + np.arange(3)] = -1.0
        turn = b.turn(q)
        by_origin = stiffness[:, :2, None] * b.by_origin(turn)
        spin = (1j * turn) * (v[:, 2:] @ b.relative[b._e])
        rate_by_origin = b.by_origin(spin + 1.0)
        by_origin += damping[:2] * rate_by_origin
        J[:, :2, 2 * nq + 3 : 2 * nq + 5] = by_origin
        J[:, np.arange(3), 2 * nq + 5 + np.arange(3)] = (
            self._scale * b.deflection(q, terms)
        )
        return J / UNITS[:, None]


class EnergyKernel:
    """Contact energy 1/2 k d^2 of a bushing's components, in joules / unit.

    Inputs: q, origin (2), stiffness (3). Outputs: one for each component
    named; the cost is half the sum of their squares (paper, Table I).

    Args:
        bushing: the geometry.
        components: indices of tangential 0, normal 1, rotation 2.
        sigma: typical energy [J].
        scale: multiplies stiffness.
    """

    def __init__(self, bushing: Bushing, components, sigma, scale=1.0):
        self._bushing = bushing
        self._components = list(components)
        self._sigma = sigma
        self._scale = scale
        nq = bushing.nq
        pattern = np.zeros((3, nq + 5), bool)
        pattern[:2, 2:nq] = (bushing.relative != 0.0).any(axis=0)
        pattern[:2, nq : nq + 2] = True
        pattern[2, :nq] = bushing.rotation != 0.0
        pattern[:, nq + 2 :] = np.eye(3, dtype=bool)
        self.sparsity = pattern[self._components]

    def evaluate(self, x, data):
        """See Kernel."""
        nq = self._bushing.nq
        q, origin = x[:, :nq], x[:, nq : nq + 2]
        k = self._scale * x[:, nq + 2 :]
        d = self._bushing.deflection(q, self._bushing.terms(q, origin))
        return (0.5 * k * d * d)[:, self._components] / self._sigma

    def jacobian(self, x, data):
        """See Kernel."""
        b = self._bushing
        nq = b.nq
        q, origin = x[:, :nq], x[:, nq : nq + 2]
        k = self._scale * x[:, nq + 2 :]
        terms = b.terms(q, origin)
        d = b.deflection(q, terms)
        J = np.zeros((len(x), 3, nq + 5))
        force = (k * d)[:, :, None]
        J[:, :, :nq] = force * b.deflection_jacobian(terms)
        J[:, :2, nq : nq + 2] = force[:, :2] * b.by_origin(b.turn(q))
        index = np.arange(3)
        J[:, index, nq + 2 + index] = self._scale * 0.5 * d * d
        return J[:, self._components] / self._sigma
