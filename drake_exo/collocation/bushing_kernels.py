"""Kernels of human-exoskeleton bushings, as calibrated or designed.

Components are tangential, normal, rotation, as in `contact.bushing`. Forces
are on the human; the generalized force of a bushing is -(dd/dq)^T F. For a
design (Phase D): cuffs that change, assistance, forces felt, limits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drake_exo.collocation.kernels import (
    FORCE_UNIT,
    MOMENT_UNIT,
    DynamicsKernel,
    add_pair,
)
from drake_exo.contact.bushing import (
    ROTATION,
    TANGENTIAL,
    BushingKinematics,
    bushing_energy,
    bushing_force,
    held_share,
)

INTERACTION_FORCE_UNIT = 10.0  # N
INTERACTION_MOMENT_UNIT = 1.0  # N m
UNITS = np.array(
    [
        INTERACTION_FORCE_UNIT,
        INTERACTION_FORCE_UNIT,
        INTERACTION_MOMENT_UNIT,
    ]
)


class BushingKernel:
    """Force by a bushing's law, minus the control.

    Inputs: q, v, force (3), places (the origin first), stiffness (3), slip: if
    places are the origin alone, CALIBRATED from there on. Outputs: differences
    in units of 10 N, 10 N, 1 N m.

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
        self.curved_inputs = pattern.any(axis=0)
        self.curved_inputs[2 * nq : 2 * nq + 3] = False

    def _split(self, x):
        nq, k = self.nq, self._k
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
        by_q = b.deflection_jacobian(b.led(terms, v))[:, :ROTATION]
        J[:, :ROTATION, :nq] += damping[:ROTATION] * by_q
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
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in).

        Force is stiffness times deflection: without this, steps are short while
        the stiffness is unknown.
        """
        q, v, _, places, stiffness, slip = self._split(x)
        b, nq = self._bushing, self.nq
        w = weights / UNITS
        terms, turns = b.terms(q, places), b.turns(q)
        D, d = b.deflection_jacobian(terms), b.deflection(q, terms)
        o, k = slice(2 * nq + 3, self._k), slice(self._k, self._k + 3)
        # Gradient of the tangential spring's force without slip; then its slip.
        along = np.zeros(x.shape)
        along[:, :nq] = stiffness[:, [0]] * D[:, 0]
        along[:, o] = stiffness[:, [0]] * b.by_places(turns)[:, 0]
        along[:, k.start] = d[:, 0]
        force, slip = stiffness[:, 0] * d[:, 0], slip[:, 0]
        by_both, by_slips = slipping_bends(force, slip)
        bend = (w[:, 0] * slip * by_both)[:, None] * along
        H = bend[:, :, None] * along[:, None]
        H[:, :, -1] = H[:, -1, :] = (w[:, 0] * force * by_both)[:, None] * along
        H[:, -1, -1] = w[:, 0] * by_slips
        pull = w * self._damping
        led = b.led(terms, v), b.led(turns, v)
        H[:, :nq, :nq] += b.curvature(led[0], pull)
        add_pair(H, slice(nq), o, b.gradient_by_places(led[1], pull))
        rates = slice(nq, 2 * nq)
        add_pair(H, slice(nq), rates, b.curvature(terms, pull))
        add_pair(H, rates, o, b.gradient_by_places(turns, pull))
        w[:, 0] *= slipping(force, slip)[0]
        H[:, :nq, :nq] += b.curvature(terms, w * stiffness)
        add_pair(H, slice(nq), o, b.gradient_by_places(turns, w * stiffness))
        add_pair(H, slice(nq), k, np.swapaxes(w[:, :, None] * D, 1, 2))
        across = slice(k.start, k.start + ROTATION)
        add_pair(H, across, o, w[:, :2, None] * b.by_places(turns))
        return H


def slipping(force, slip) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of a slipping cuff's force, see `contact.bushing`.

    Args:
        force: (n,) k d, the tangential spring's force without slip [N].
        slip: (n,) s, inverse of the largest force [1/N].

    Returns:
        Derivatives (n,) by `force` [1] and by `slip` [N^2].
    """
    share = held_share(force, slip)
    return share**5, -(force**2) * (slip * force) ** 3 * share**5


def slipping_bends(force, slip) -> tuple[np.ndarray, np.ndarray]:
    """Second derivatives of a slipping cuff's force, see `slipping`.

    Returns:
        p (n,): twice by `force` it is p slip, by both it is p force; and the
        second derivative by `slip` (n,) [N^3].
    """
    past, share = (slip * force) ** 4, held_share(force, slip)
    by_both = -5.0 * (slip * force) ** 3 * share**9
    by_slips = force**5 * slip**2 * share**5 * (5.0 * past * share**4 - 3.0)
    return by_both, by_slips


class EnergyKernel:
    """Contact energy 1/2 k d^2 of some components of a bushing, over sigma.

    d is the deflection without what slips. Inputs: q, origin (2), stiffness
    (3), slip. Outputs: energy of each component over sigma, times the weight in
    `data` (n, 1); the cost is half the sum of squares (paper, Table I).

    Args:
        bushing: the geometry.
        components: indices: tangential 0, normal 1, rotation 2.
        sigma: typical energy [J].
    """

    exact_only = True  # it is small

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
        return data * energy[:, self._components] / self._sigma

    def jacobian(self, x, data):
        """See Kernel."""
        b = self._bushing
        nq = b.nq
        q, origin, k, slip = self._split(x)
        terms = b.terms(q, origin)
        d = b.deflection(q, terms)
        J = np.zeros((len(x), 3, nq + 6))
        # E = F^2/(2 k), F(k d, slip): F dF/d(k d) by d; by_stiffness by k.
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
        return data[:, :, None] * J[:, self._components] / self._sigma

    def curvature(self, x, weights, data):
        """sum_i weights_i d2 f_i/dx2, (n, n_in, n_in)."""
        b, nq = self._bushing, self._bushing.nq
        q, origin, stiffness, slip = self._split(x)
        terms, turns = b.terms(q, origin), b.turns(q)
        d = b.deflection(q, terms)
        moved = np.zeros((len(x), 3, nq + 2))  # d by q and origin
        moved[:, :, :nq] = b.deflection_jacobian(terms)
        moved[:, :ROTATION, nq:] = b.by_places(turns)
        pull = np.zeros((len(x), 3))  # weights times dE/d(k d) k
        H = np.zeros((len(x), nq + 6, nq + 6))
        for c, w in zip(
            self._components, (data * weights / self._sigma).T, strict=True
        ):
            k, s = stiffness[:, c], slip[:, 0] * (c == TANGENTIAL)
            # E = f^2/(2 k) of the slipping force f(F = k d, s).
            F = k * d[:, c]
            f = F * held_share(F, s)
            f_F, f_s = slipping(F, s)
            by_both, f_ss = slipping_bends(F, s)
            E = np.zeros((len(x), 3, 3))
            E[:, 0, 0] = f_F**2 + f * s * by_both
            E[:, 0, 1] = E[:, 1, 0] = -f * f_F / k
            E[:, 0, 2] = E[:, 2, 0] = f_F * f_s + f * F * by_both
            E[:, 1, 1] = (f / k) ** 2
            E[:, 1, 2] = E[:, 2, 1] = -f * f_s / k
            E[:, 2, 2] = f_s**2 + f * f_ss
            along = np.zeros((len(x), 3, nq + 6))  # F, k, s by the inputs
            along[:, 0, : nq + 2] = k[:, None] * moved[:, c]
            along[:, 0, nq + 2 + c] = d[:, c]
            along[:, 1, nq + 2 + c] = 1.0
            along[:, 2, -1] = c == TANGENTIAL
            scaled = (w / k)[:, None, None] * E
            H += np.swapaxes(along, 1, 2) @ scaled @ along
            pull[:, c] = w * f * f_F
            stretched = slice(nq + 2 + c, nq + 3 + c)
            part = (pull[:, c] / k)[:, None] * moved[:, c]
            add_pair(H, slice(nq + 2), stretched, part[:, :, None])
        H[:, :nq, :nq] += b.curvature(terms, pull)
        add_pair(
            H, slice(nq), slice(nq, nq + 2), b.gradient_by_places(turns, pull)
        )
        return H


PLACE_UNIT = 0.01  # m
# Added to the square of a force over its scale: its norm is smooth at zero.
_SMALL = 1e-6


@dataclass(frozen=True)
class MovedWeight:
    """Weight of links that move with a place of a cuff.

    See DesignDynamicsKernel.

    Attributes:
        bushing, place: index of the bushing, and of one of its places.
        segment: segment of the tree with which the place turns.
        weight: force of gravity on the links that move along [N], times the
            complex direction x + i z of the place in the segment.
    """

    bushing: int
    place: int
    segment: int
    weight: complex


class DesignDynamicsKernel(DynamicsKernel):
    """DynamicsKernel for a design, with the weight of moved links.

    It adds the weight of links whose joints are moved, but not their inertia:
    in a rise of 1.5 s at most 0.16 N m per centimetre, against 1 N m of weight.
    The forecast on the device as built has both.
    """

    # As cuffs move, forces and moment arms change together: without curvature
    # a design takes hundreds of iterations more.
    exact_only = False

    def __init__(
        self,
        tree,
        bodies=None,
        bushings=(),
        load=None,
        moved: Sequence[MovedWeight] = (),
    ):
        super().__init__(tree, bodies, bushings, load)
        self._moved = [
            (
                self._cuffs[m.bushing][2].start + m.place,
                tree.angles_by_q[m.segment],
                m.weight,
            )
            for m in moved
        ]
        for place, by_q, _ in self._moved:
            self.sparsity[by_q != 0.0, place] = True

    def evaluate(self, x, data):
        """See Kernel."""
        r = super().evaluate(x, data)
        nq = self.num_positions
        for place, by_q, weight in self._moved:
            turned = weight * np.exp(1j * (x[:, :nq] @ by_q))
            r += (turned.real * x[:, place] / FORCE_UNIT)[:, None] * by_q
        return r

    def jacobian(self, x, data):
        """See Kernel."""
        J = super().jacobian(x, data)
        nq = self.num_positions
        for place, by_q, weight in self._moved:
            turned = weight * np.exp(1j * (x[:, :nq] @ by_q)) / FORCE_UNIT
            J[:, :, place] += turned.real[:, None] * by_q
            lever = -turned.imag * x[:, place]
            J[:, :, :nq] += lever[:, None, None] * np.outer(by_q, by_q)
        return J

    def curvature(self, x, weights, data):
        """See DynamicsKernel."""
        H = super().curvature(x, weights, data)
        nq = self.num_positions
        q, w = x[:, :nq], weights / FORCE_UNIT
        for place, by_q, weight in self._moved:
            turned = weight * np.exp(1j * (q @ by_q)) * (w @ by_q)
            own = np.outer(by_q, by_q)
            bend = -turned.real * x[:, place]
            H[:, :nq, :nq] += bend[:, None, None] * own
            lever = -turned.imag[:, None, None] * by_q[:, None]
            add_pair(H, slice(nq), slice(place, place + 1), lever)
        return H


class CuffKernel:
    """Ties a wearer's cuff to the design; zero if it is as designed.

    Inputs: origin (2) and stiffness (3) of the cuff; of the design its shift
    x, z [m], compliance of its straps (3) [m/N, m/N, rad/(N m)], area relative
    to today's, and released shares of the springs along the limb and in
    rotation (2). Outputs: origin - today's origin - shift, in cm; stiffness
    (today's compliance/area^n + the strap's) - 1 + released share (0 across).
    Data: (1, 5) today's origin and compliance.

    Args:
        powers: (3,) exponent n for each stiffness.
    """

    def __init__(self, powers):
        self._powers = np.array(powers, float)
        pattern = np.zeros((5, 13), bool)
        pattern[np.arange(5), np.arange(5)] = True
        pattern[np.arange(5), 5 + np.arange(5)] = True
        pattern[2:, 10] = True
        pattern[[2, 4], [11, 12]] = True
        self.sparsity = pattern

    def _split(self, x):
        return np.split(x, [2, 5, 7, 10, 11], axis=1)

    def evaluate(self, x, data):
        """See Kernel."""
        origin, stiffness, place, strap, area, released = self._split(x)
        tissue = data[:, 2:] * area**-self._powers
        held = stiffness * (tissue + strap) - 1.0
        held[:, [0, 2]] += released
        return np.hstack([(origin - data[:, :2] - place) / PLACE_UNIT, held])

    def jacobian(self, x, data):
        """See Kernel."""
        J = np.zeros((len(x), 5, 13))
        i, k = np.arange(2), np.arange(2, 5)
        _, stiffness, _, strap, area, _ = self._split(x)
        tissue = data[:, 2:] * area**-self._powers
        J[:, i, i] = 1.0 / PLACE_UNIT
        J[:, i, 5 + i] = -1.0 / PLACE_UNIT
        J[:, k, k] = tissue + strap
        J[:, k, 5 + k] = stiffness
        J[:, k, 10] = -stiffness * self._powers * tissue / area
        J[:, [2, 4], [11, 12]] = 1.0
        return J

    def curvature(self, x, weights, data):
        """See Kernel."""
        H = np.zeros((len(x), 13, 13))
        k, n = np.arange(2, 5), self._powers
        _, stiffness, _, _, area, _ = self._split(x)
        tissue = data[:, 2:] * area**-n
        H[:, k, 5 + k] = H[:, 5 + k, k] = weights[:, k]
        H[:, k, 10] = H[:, 10, k] = -weights[:, k] * n * tissue / area
        bend = weights[:, k] * stiffness * n * (n + 1.0) * tissue / area**2
        H[:, 10, 10] = bend.sum(axis=1)
        return H


class AssistanceKernel:
    """Torque of a joint of the device minus that by the design.

    The design's is linear in k variables. Today's drive torque, which some of
    them multiply, changes with the device's posture. Inputs: torque [N m], the
    device's m angles [rad], the variables (k). Data (n, 2 k + 2 m + 1): torque
    by each variable at today's drive torque; its derivative by the drive
    torque; the drive torque's slope by the angles [N m/rad]; that times today's
    angles [N m]; and the slope of springs, which no variable multiplies (m).

    Args:
        num_angles, num_points: m and k.
    """

    def __init__(self, num_angles: int, num_points: int):
        self._at = np.cumsum([1, num_angles])
        self._in = np.cumsum([num_points, num_points, num_angles, 1])
        self.sparsity = np.ones((1, 1 + num_angles + num_points), bool)

    def _parts(self, x, data):
        """Variables, torque by each, its derivative, slopes; see Data."""
        _, angles, factors = np.split(x, self._at, axis=1)
        today, change, slope, there, springs = np.split(data, self._in, axis=1)
        answer = np.sum(slope * angles, axis=1, keepdims=True) - there
        return factors, today + change * answer, change, slope, springs

    def evaluate(self, x, data):
        """See Kernel."""
        factors, by, *_, springs = self._parts(x, data)
        given = np.sum(factors * by, axis=1, keepdims=True)
        angles = x[:, slice(*self._at)]
        given += np.sum(springs * angles, axis=1, keepdims=True)
        return (x[:, :1] - given) / MOMENT_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        factors, by, change, slope, springs = self._parts(x, data)
        more = np.sum(factors * change, axis=1, keepdims=True)
        by_angles = -more * slope - springs
        J = np.hstack([np.ones((len(x), 1)), by_angles, -by])
        return J[:, None] / MOMENT_UNIT

    def curvature(self, x, weights, data):
        """See Kernel."""
        _, _, change, slope, _ = self._parts(x, data)
        first, last = self._at
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        part = slope[:, :, None] * change[:, None] / MOMENT_UNIT
        part = -weights[:, :1, None] * part
        add_pair(H, slice(first, last), slice(last, None), part)
        return H


class ForceNormKernel:
    """A cuff's force on the skin to a power; half the squares sum to a norm.

    Inputs: force along and across the limb [N], area relative to today's.
    Output: the weight in `data` (n, 1) times u^(order/4), u = (across^2 + shear
    along^2)/(scale area)^2.

    Args:
        order: order of the norm, at least 2.
        scale: typical force [N].
        shear: weight of the square of the force along the limb.
    """

    sparsity = np.ones((1, 3), bool)

    def __init__(self, order: float, scale: float, shear: float):
        self._power = order / 4.0
        self._weights = np.array([shear, 1.0]) / scale**2

    def _square(self, x):
        return x[:, :2] ** 2 @ self._weights / x[:, 2] ** 2 + _SMALL

    def _slopes(self, x):
        """Derivatives (n, 3) of the square u by the inputs."""
        along = 2.0 * x[:, :2] * self._weights / x[:, [2]] ** 2
        by_area = -2.0 * (self._square(x) - _SMALL) / x[:, 2]
        return np.column_stack([along, by_area])

    def evaluate(self, x, data):
        """See Kernel."""
        return data * (self._square(x) ** self._power)[:, None]

    def jacobian(self, x, data):
        """See Kernel."""
        slope = self._power * self._square(x) ** (self._power - 1.0)
        return (data * slope[:, None] * self._slopes(x))[:, None, :]

    def curvature(self, x, weights, data):
        """See Kernel; without it a norm of high order is found slowly."""
        u, a, n = self._square(x), self._power, self._slopes(x)
        bend = a * (a - 1.0) * u ** (a - 2.0)
        H = bend[:, None, None] * n[:, :, None] * n[:, None, :]
        slope = a * u ** (a - 1.0)
        own = np.zeros_like(H)
        i, area = np.arange(2), x[:, [2]]
        own[:, i, i] = 2.0 * self._weights / area**2
        own[:, i, 2] = own[:, 2, i] = -2.0 * n[:, :2] / area
        own[:, 2, 2] = -3.0 * n[:, 2] / x[:, 2]
        H += slope[:, None, None] * own
        return (weights * data)[:, :, None] * H


class MigrationKernel:
    """Migration (deflection along the limb) minus its variable, in cm.

    Inputs: q, places of the cuff, the variable [m].
    """

    def __init__(self, bushing: BushingKinematics):
        self._bushing = bushing
        nq = self._nq = bushing.nq
        self.sparsity = np.ones((1, nq + bushing.num_places + 1), bool)
        self.sparsity[:, :nq] = bushing.moved_by

    def evaluate(self, x, data):
        """See Kernel."""
        q, places = x[:, : self._nq], x[:, self._nq : -1]
        d = self._bushing.deflection(q, self._bushing.terms(q, places))
        return (d[:, [TANGENTIAL]] - x[:, [-1]]) / PLACE_UNIT

    def jacobian(self, x, data):
        """See Kernel."""
        q, places = x[:, : self._nq], x[:, self._nq : -1]
        b, nq = self._bushing, self._nq
        J = np.zeros((len(x), *self.sparsity.shape))
        terms = b.terms(q, places)
        J[:, 0, :nq] = b.deflection_jacobian(terms)[:, TANGENTIAL]
        J[:, 0, nq:-1] = b.by_places(b.turns(q))[:, TANGENTIAL]
        J[:, 0, -1] = -1.0
        return J / PLACE_UNIT

    def curvature(self, x, weights, data):
        """See Kernel."""
        q, places = x[:, : self._nq], x[:, self._nq : -1]
        b, nq = self._bushing, self._nq
        along = np.zeros((len(x), 3))
        along[:, TANGENTIAL] = weights[:, 0] / PLACE_UNIT
        H = np.zeros((len(x), x.shape[1], x.shape[1]))
        H[:, :nq, :nq] = b.curvature(b.terms(q, places), along)
        part = b.gradient_by_places(b.turns(q), along)
        add_pair(H, slice(nq), slice(nq, -1), part)
        return H


class ProductKernel:
    """A variable minus a product of two, such as force = pressure times area.

    Inputs: whole, a, b; data: (n, 1) a0, or None for 0. Output: whole - factor
    (a - a0) b, in units of `unit`.

    Args:
        factor: factor of the product.
        unit: unit of the output.
    """

    sparsity = np.ones((1, 3), bool)

    def __init__(self, factor: float, unit: float):
        self._factor, self._unit = factor, unit

    def _shifted(self, x, data):
        whole, a, b = x.T
        return whole, a if data is None else a - data[:, 0], b

    def evaluate(self, x, data):
        """See Kernel."""
        whole, a, b = self._shifted(x, data)
        return (whole - self._factor * a * b)[:, None] / self._unit

    def jacobian(self, x, data):
        """See Kernel."""
        _, a, b = self._shifted(x, data)
        slope = [np.ones_like(a), -self._factor * b, -self._factor * a]
        return np.stack(slope, axis=1)[:, None] / self._unit

    def curvature(self, x, weights, data):
        """See Kernel."""
        H = np.zeros((len(x), 3, 3))
        H[:, 1, 2] = H[:, 2, 1] = -weights[:, 0] * self._factor / self._unit
        return H
