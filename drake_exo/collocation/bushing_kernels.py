"""Human-exoskeleton bushings in a collocation problem.

Components are tangential, normal, rotation, as in `contact.bushing`. Forces
are on the human; the generalized force of a bushing is -(dd/dq)^T F.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from drake_exo.collocation.kernels import FORCE_UNIT, DynamicsKernel
from drake_exo.contact.bushing import (
    TANGENTIAL,
    BushingKinematics,
    bushing_energy,
    bushing_force,
    held_share,
)
from drake_exo.model.planar_tree import PlanarTree

INTERACTION_FORCE_UNIT = 10.0  # N
INTERACTION_MOMENT_UNIT = 1.0  # N m
UNITS = np.array(
    [
        INTERACTION_FORCE_UNIT,
        INTERACTION_FORCE_UNIT,
        INTERACTION_MOMENT_UNIT,
    ]
)


class CoupledDynamicsKernel:
    """DynamicsKernel with bushing forces.

    Inputs: those of DynamicsKernel, then the bushings' forces (3 each: N, N,
    N m), then their places (see BushingKinematics). Outputs as
    DynamicsKernel.
    """

    def __init__(
        self,
        tree: PlanarTree,
        bushings: list[BushingKinematics],
        bodies: Sequence[str] | None = None,
    ):
        self._dynamics = DynamicsKernel(tree, bodies)
        self._bushings = bushings
        nq, nb = tree.num_positions, len(bushings)
        self._first = self._dynamics.sparsity.shape[1]
        ends = np.cumsum([0, *(b.num_places for b in bushings)])
        ends += self._first + 3 * nb
        self._places = [slice(*pair) for pair in pairwise(ends)]
        pattern = np.zeros((nq, ends[-1]), bool)
        pattern[:, : self._first] = self._dynamics.sparsity
        for b, bushing in enumerate(bushings):
            angles = bushing.moved_by
            force = slice(self._first + 3 * b, self._first + 3 * b + 3)
            pattern[angles, force] = True
            pattern[angles, self._places[b]] = True
        self.sparsity = pattern

    def _parts(self, x, b):
        first = self._first + 3 * b
        return x[:, first : first + 3], x[:, self._places[b]]

    def evaluate(self, x, data):
        """See Kernel."""
        nq = self._dynamics.num_positions
        r = self._dynamics.evaluate(x[:, : self._first], data)
        for b, bushing in enumerate(self._bushings):
            force, places = self._parts(x, b)
            J = bushing.deflection_jacobian(bushing.terms(x[:, :nq], places))
            r += np.einsum("nc,ncq->nq", force, J) / FORCE_UNIT
        return r

    def jacobian(self, x, data):
        """See Kernel."""
        nq = self._dynamics.num_positions
        J = np.zeros((len(x), *self.sparsity.shape))
        J[:, :, : self._first] = self._dynamics.jacobian(
            x[:, : self._first], data
        )
        for b, bushing in enumerate(self._bushings):
            force, places = self._parts(x, b)
            q = x[:, :nq]
            terms = bushing.terms(q, places)
            J[:, 2:, :nq] += bushing.curvature(terms, force)[:, 2:] / FORCE_UNIT
            first = self._first + 3 * b
            J[:, :, first : first + 3] = (
                bushing.deflection_jacobian(terms).transpose(0, 2, 1)
                / FORCE_UNIT
            )
            J[:, :, self._places[b]] = (
                bushing.gradient_by_places(bushing.turns(q), force) / FORCE_UNIT
            )
        return J


class BushingKernel:
    """Force that a bushing's law gives, minus the control.

    Inputs: q, v, force (3), places, stiffness (3): of the origin alone, the
    last two are CALIBRATED. Outputs: differences in units of 10 N, 10 N, 1 N m.

    Args:
        bushing: the geometry.
        damping: (3,) tangential, normal [N s/m], rotational [N m s/rad].
    """

    def __init__(self, bushing: BushingKinematics, damping):
        self._bushing = bushing
        self._damping = np.asarray(damping, float)
        nq = self.nq = bushing.nq
        self._k = k = 2 * nq + 3 + bushing.num_places
        pattern = np.zeros((3, k + 4), bool)
        angles = bushing.moved_by
        pattern[:2, :nq] = pattern[:2, nq : 2 * nq] = angles
        pattern[2, :nq] = pattern[2, nq : 2 * nq] = bushing.rotation != 0.0
        pattern[:, 2 * nq : 2 * nq + 3] = np.eye(3, dtype=bool)
        pattern[:2, 2 * nq + 3 : k] = True
        pattern[:, k:-1] = np.eye(3, dtype=bool)
        pattern[TANGENTIAL, -1] = True
        self.sparsity = pattern
        # See `curvature`.
        self.curved_inputs = pattern.any(axis=0)
        self.curved_inputs[nq : 2 * nq + 3] = False

    def _split(self, x):
        nq = self.nq
        k = self._k
        return np.split(x, [nq, 2 * nq, 2 * nq + 3, k, k + 3], axis=1)

    def evaluate(self, x, data):
        """See Kernel."""
        q, v, force, places, stiffness, slip = self._split(x)
        terms = self._bushing.terms(q, places)
        d = self._bushing.deflection(q, terms)
        J = self._bushing.deflection_jacobian(terms)
        rate = np.einsum("ncq,nq->nc", J, v)
        law = bushing_force(d.T, rate.T, stiffness.T, self._damping, slip[:, 0])
        return (np.stack(law, axis=1) - force) / UNITS

    def jacobian(self, x, data):
        """See Kernel."""
        q, v, _, places, stiffness, slip = self._split(x)
        b, nq = self._bushing, self.nq
        terms = b.terms(q, places)
        D, d = b.deflection_jacobian(terms), b.deflection(q, terms)
        slope = np.ones((len(x), 3))
        slope[:, 0], by_slip = slipping(stiffness[:, 0] * d[:, 0], slip[:, 0])
        J = np.zeros((len(x), *self.sparsity.shape))
        damping = self._damping[:, None]
        J[:, :, :nq] = (slope * stiffness)[:, :, None] * D
        J[:, :, :nq] += damping * b.rate_jacobian(terms, v)
        J[:, :, nq : 2 * nq] = damping * D
        J[:, np.arange(3), 2 * nq + np.arange(3)] = -1.0
        turns = b.turns(q)
        by_places = (slope * stiffness)[:, :2, None] * b.by_places(turns)
        by_places += damping[:2] * b.by_places(b.led(turns, v))
        J[:, :2, 2 * nq + 3 : self._k] = by_places
        J[:, np.arange(3), self._k + np.arange(3)] = slope * d
        J[:, TANGENTIAL, -1] = by_slip
        return J / UNITS[:, None]

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in), of the springs.

        Stiffness times deflection: without this a solver that does not know
        the stiffness creeps. What damping adds is left out.
        """
        q, _, _, places, stiffness, slip = self._split(x)
        b, nq = self._bushing, self.nq
        w = weights / UNITS
        terms, turns = b.terms(q, places), b.turns(q)
        D, d = b.deflection_jacobian(terms), b.deflection(q, terms)
        o, k = slice(2 * nq + 3, self._k), slice(self._k, self._k + 3)
        # The spring along the limb, were it held, and how it bends.
        along = np.zeros(x.shape)
        along[:, :nq] = stiffness[:, [0]] * D[:, 0]
        along[:, o] = stiffness[:, [0]] * b.by_places(turns)[:, 0]
        along[:, k.start] = d[:, 0]
        force, slip = stiffness[:, 0] * d[:, 0], slip[:, 0]
        by_both, by_slips = slipping_bends(force, slip)
        H = np.einsum(
            "n,ni,nj->nij",
            w[:, 0] * slip * by_both,
            along,
            along,
            optimize=True,
        )
        H[:, :, -1] = H[:, -1, :] = (w[:, 0] * force * by_both)[:, None] * along
        H[:, -1, -1] = w[:, 0] * by_slips
        w[:, 0] *= slipping(force, slip)[0]
        H[:, :nq, :nq] += b.curvature(terms, w * stiffness)
        by_qo = b.gradient_by_places(turns, w * stiffness)
        by_qk = (w[:, :, None] * D).transpose(0, 2, 1)
        by_ok = np.zeros((len(x), b.num_places, 3))
        by_ok[:, :, :2] = (w[:, :2, None] * b.by_places(turns)).transpose(
            0, 2, 1
        )
        for rows, columns, part in (
            (slice(nq), o, by_qo),
            (slice(nq), k, by_qk),
            (o, k, by_ok),
        ):
            H[:, rows, columns] += part
            H[:, columns, rows] += part.transpose(0, 2, 1)
        return H


def slipping(force, slip) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of a cuff's force along the limb, see `contact.bushing`.

    Args:
        force: (n,) of the spring if it did not slip [N].
        slip: (n,) [1/N].

    Returns:
        By that force, and by `slip` [N^2].
    """
    share = held_share(force, slip)
    return share**5, -(force**2) * (slip * force) ** 3 * share**5


def slipping_bends(force, slip) -> tuple[np.ndarray, np.ndarray]:
    """Second derivatives of the same.

    Returns:
        By `force` twice over `slip`, which is that by both over `force`; and
        by `slip` twice.
    """
    past, share = (slip * force) ** 4, held_share(force, slip)
    by_both = -5.0 * (slip * force) ** 3 * share**9
    by_slips = force**5 * slip**2 * share**5 * (5.0 * past * share**4 - 3.0)
    return by_both, by_slips


class EnergyKernel:
    """Contact energy 1/2 k d^2 of a bushing's components, in joules / unit.

    Inputs: q, origin (2), stiffness (3), slip. Outputs: one for each component
    named; the cost is half the sum of their squares (paper, Table I).

    Args:
        bushing: the geometry.
        components: indices of tangential 0, normal 1, rotation 2.
        sigma: typical energy [J].
    """

    def __init__(self, bushing: BushingKinematics, components, sigma):
        self._bushing = bushing
        self._components = list(components)
        self._sigma = sigma
        nq = bushing.nq
        pattern = np.zeros((3, nq + 6), bool)
        pattern[:2, :nq] = bushing.moved_by
        pattern[:2, nq : nq + 2] = True
        pattern[2, :nq] = bushing.rotation != 0.0
        pattern[:, nq + 2 : -1] = np.eye(3, dtype=bool)
        pattern[TANGENTIAL, -1] = True
        self.sparsity = pattern[self._components]

    def _split(self, x):
        nq = self._bushing.nq
        return np.split(x, [nq, nq + 2, nq + 5], axis=1)

    def evaluate(self, x, data):
        """See Kernel."""
        q, origin, k, slip = self._split(x)
        d = self._bushing.deflection(q, self._bushing.terms(q, origin))
        energy = np.stack(bushing_energy(d.T, k.T, slip[:, 0]), axis=1)
        return energy[:, self._components] / self._sigma

    def jacobian(self, x, data):
        """See Kernel."""
        b = self._bushing
        nq = b.nq
        q, origin, k, slip = self._split(x)
        terms = b.terms(q, origin)
        d = b.deflection(q, terms)
        J = np.zeros((len(x), 3, nq + 6))
        # E = F^2/2k: by the deflection F dF/d(k d), by k of what is held.
        force, by_stiffness = k * d, 0.5 * d * d
        slope, by_slip = slipping(force[:, 0], slip[:, 0])
        share = slope**0.2
        J[:, 0, -1] = share * d[:, 0] * by_slip
        force[:, 0] *= share * slope
        by_stiffness[:, 0] *= share * (2.0 * slope - share)
        force = force[:, :, None]
        J[:, :, :nq] = force * b.deflection_jacobian(terms)
        J[:, :2, nq : nq + 2] = force[:, :2] * b.by_places(b.turns(q))
        index = np.arange(3)
        J[:, index, nq + 2 + index] = by_stiffness
        return J[:, self._components] / self._sigma
