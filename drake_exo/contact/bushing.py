"""Planar bushing: the spring–damper between a human and an exoskeleton link.

Defined as in OpenSim. Frame F1 sits on the human link at `origin`, parallel
to it; F2 sits on the exoskeleton link. Deflection is the pose of F2 seen from
F1, in F1's axes, and its rate is the time derivative seen from F1. The force
is linear in both, except that a cuff may slip: the spring along the limb gives
k d/(1 + (s k d)^4)^(1/4), never more than 1/s. Equal and opposite forces act
on both links at F2's origin, so the pair makes no net moment.

Components, in this order everywhere:

- tangential: along the human link (z of F1), m and N;
- normal: perpendicular to it (x of F1), m and N;
- rotation: toes-up positive (about world −y), rad and N·m.

Reported force is the force **on the human**. With deflection d it is
K d + B ḋ: an exoskeleton displaced forwards pulls the human forwards. The
power of the pair is −F·ḋ, so its generalised force is −(∂d/∂q)ᵀ F.

Pure functions that broadcast over float, complex, AutoDiffXd and Expression.
Poses are (x, z, angle) and motions (v_x, v_z, rate) of the link frames in the
world, angle counter-clockwise seen from the right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_exo.contact.scalars import any_scalar, cos, sin, sqrt
from drake_exo.files.schema import quantity
from drake_exo.model.planar_tree import PlanarTree, contract

COMPONENTS = ("tangential", "normal", "rotation")
TANGENTIAL, NORMAL, ROTATION = range(3)
# Calibrated fields of `BushingParameters`, in the order of arrays.
CALIBRATED = (
    "origin_x",
    "origin_z",
    "tangential_stiffness",
    "normal_stiffness",
    "rotational_stiffness",
    "slip",
)


@dataclass(frozen=True)
class BushingParameters:
    """One bushing. Fields may also hold AutoDiffXd or Expression values.

    `origin` places F1 in the human link frame and F2 at the same place of the
    exoskeleton link, so they coincide while both chains are aligned.
    `preload` moves F2 from there, in the axes of the exoskeleton link, like a
    strap under tension. `slip` is the reciprocal of the force along the limb
    at which the cuff slips; zero, as in the paper, for one that never slips.

    >>> BushingParameters(origin_z=0.25).scaled(1.4).normal_stiffness
    7000.0
    """

    origin_x: float = quantity("m", 0.0)
    origin_z: float = quantity("m", 0.0)
    tangential_stiffness: float = quantity("N/m", 2000.0, minimum=0.0)
    normal_stiffness: float = quantity("N/m", 5000.0, minimum=0.0)
    rotational_stiffness: float = quantity("N m/rad", 50.0, minimum=0.0)
    tangential_damping: float = quantity("N s/m", 10.0, minimum=0.0)
    normal_damping: float = quantity("N s/m", 10.0, minimum=0.0)
    rotational_damping: float = quantity("N m s/rad", 0.1, minimum=0.0)
    preload_x: float = quantity("m", 0.0)
    preload_z: float = quantity("m", 0.0)
    preload_angle: float = quantity("rad", 0.0)
    slip: float = quantity("1/N", 0.0, minimum=0.0)

    @property
    def stiffness(self) -> tuple:
        """Stiffnesses [N/m, N/m, N m/rad] in the order of COMPONENTS."""
        return (
            self.tangential_stiffness,
            self.normal_stiffness,
            self.rotational_stiffness,
        )

    @property
    def damping(self) -> tuple:
        """Dampings [N s/m, N s/m, N m s/rad], order of COMPONENTS."""
        return (
            self.tangential_damping,
            self.normal_damping,
            self.rotational_damping,
        )

    @property
    def origin(self) -> tuple:
        """Place (x, z) of F1 in the human link [m]."""
        return self.origin_x, self.origin_z

    @property
    def preload(self) -> tuple:
        """(x, z, angle) of F2 from its aligned place [m, m, rad]."""
        return self.preload_x, self.preload_z, self.preload_angle

    def scaled(self, factor: float) -> "BushingParameters":
        """The same with stiffness and damping times `factor` (Phase C2)."""
        values = {
            name: factor * value
            for name, value in vars(self).items()
            if name.endswith(("_stiffness", "_damping"))
        }
        return replace(self, **values)


class Components(NamedTuple):
    """Values in the order of COMPONENTS."""

    tangential: object
    normal: object
    rotation: object


class BushingWrench(NamedTuple):
    """Wrench on the human in the world, at F2's origin."""

    force_x: object  # N
    force_z: object  # N
    moment: object  # N·m, toes-up positive (about world −y)
    point_x: object  # m
    point_z: object  # m


@any_scalar
def bushing_deflection(
    human_pose,
    human_motion,
    exoskeleton_pose,
    exoskeleton_motion,
    origin,
    preload=(0.0, 0.0, 0.0),
) -> tuple[Components, Components]:
    """Deflection of a bushing and its rate.

    Args:
        human_pose, exoskeleton_pose: (x, z, angle) of the link frames, each
            entry of shape (...); an array (3, ...) works as well.
        human_motion, exoskeleton_motion: (v_x, v_z, rate) likewise.
        origin: (x, z) of F1 in the human link and of F2 in the exoskeleton's.
        preload: (x, z, angle) of F2 relative to its aligned place.

    Returns:
        (deflection, rate): [m, m, rad] and [m/s, m/s, rad/s], each entry of
        the broadcast shape.

    >>> rest = (0.0, 0.0, 0.0)
    >>> device = (0.005, 0.0, 0.0)  # 5 mm further forward
    >>> d, rate = bushing_deflection(rest, rest, device, rest, (0.0, 0.25))
    >>> float(d.normal)
    0.005
    """
    x_h, z_h, angle_h = human_pose
    x_e, z_e, angle_e = exoskeleton_pose
    vx_h, vz_h, rate_h = human_motion
    vx_e, vz_e, rate_e = exoskeleton_motion
    cos_h, sin_h = cos(angle_h), sin(angle_h)
    turn, turn_rate = angle_e - angle_h, rate_e - rate_h
    cos_t, sin_t = cos(turn), sin(turn)
    # Exoskeleton link seen from the human link, in its axes.
    r_x = cos_h * (x_e - x_h) + sin_h * (z_e - z_h)
    r_z = cos_h * (z_e - z_h) - sin_h * (x_e - x_h)
    v_x = cos_h * (vx_e - vx_h) + sin_h * (vz_e - vz_h) + rate_h * r_z
    v_z = cos_h * (vz_e - vz_h) - sin_h * (vx_e - vx_h) - rate_h * r_x
    # F2's origin in the exoskeleton link, turned into the human link.
    a_x, a_z = origin[0] + preload[0], origin[1] + preload[1]
    s_x = cos_t * a_x - sin_t * a_z
    s_z = sin_t * a_x + cos_t * a_z
    deflection = Components(
        r_z + s_z - origin[1], r_x + s_x - origin[0], turn + preload[2]
    )
    rate = Components(v_z + turn_rate * s_x, v_x - turn_rate * s_z, turn_rate)
    return deflection, rate


@any_scalar
def bushing_force(deflection, rate, stiffness, damping, slip=0.0) -> Components:
    """Force on the human in F1: K d + B ḋ, component by component.

    Args:
        deflection, rate: As from `bushing_deflection`.
        stiffness, damping: Three values in the order of COMPONENTS.
        slip: 1/N, of the tangential spring, as in `BushingParameters`.

    >>> still = (0.0, 0.0, 0.0)
    >>> bushing_force((0, 0.005, 0), still, (1, 4000.0, 1), still).normal
    20.0
    """
    held = (held_share(stiffness[0] * deflection[0], slip), 1.0, 1.0)
    return Components(
        *(
            k * d * share + b * d_dot
            for k, d, share, b, d_dot in zip(
                stiffness, deflection, held, damping, rate, strict=True
            )
        )
    )


@any_scalar
def bushing_energy(deflection, stiffness, slip=0.0) -> Components:
    """Energy ½ k d² [J] of each component, d without what has slipped."""
    held = (held_share(stiffness[0] * deflection[0], slip), 1.0, 1.0)
    return Components(
        *(
            0.5 * k * (share * d) ** 2
            for k, d, share in zip(stiffness, deflection, held, strict=True)
        )
    )


def held_share(force, slip):
    """Share of the linear force k d that remains with slip: (1 + (sF)⁴)^-¼."""
    square = (slip * force) ** 2
    return 1.0 / sqrt(sqrt(1.0 + square * square))


@any_scalar
def bushing_wrench(
    force, human_pose, exoskeleton_pose, origin, preload=(0.0, 0.0, 0.0)
) -> BushingWrench:
    """Wrench on the human in world axes at F2's origin.

    The exoskeleton receives the opposite at the same point.

    Args:
        force: From `bushing_force`.
        human_pose, exoskeleton_pose, origin, preload: As given to
            `bushing_deflection`.
    """
    cos_h, sin_h = cos(human_pose[2]), sin(human_pose[2])
    x_e, z_e, angle_e = exoskeleton_pose
    cos_e, sin_e = cos(angle_e), sin(angle_e)
    a_x, a_z = origin[0] + preload[0], origin[1] + preload[1]
    tangential, normal, rotation = force
    return BushingWrench(
        cos_h * normal - sin_h * tangential,
        sin_h * normal + cos_h * tangential,
        rotation,
        x_e + cos_e * a_x - sin_e * a_z,
        z_e + sin_e * a_x + cos_e * a_z,
    )


class BushingKinematics:
    """Deflection of a cuff and its derivatives, for all nodes at once.

    With complex numbers, the deflection of the device's frame seen from the
    human's is delta = sum_k D_k exp(i psi_k), psi_k = phi_k - phi_human:
    constant coefficients D, and angles relative to the human segment. Its
    real part is the normal deflection, the imaginary part the tangential one,
    as `bushing_deflection` has it; all derivatives follow term by term. The
    generalized force of a bushing is -(dd/dq)^T F.

    `places` is the vector of lengths [m] that say where the cuff sits: the
    origin (x, z) of both frames, then those of `moving`.

    Args:
        tree: the coupled model.
        cuff: a name in `tree.cuffs`.
        preload: (x, z, angle) of the device's frame beyond the human's
            when both chains are aligned [m, m, rad].
        moving: (segment, direction) of each further place, such as a joint
            that is moved: per metre of it, the device's frame moves by the
            complex number x + i z in the axes of that segment of the tree.
    """

    def __init__(
        self,
        tree: PlanarTree,
        cuff: str,
        preload=(0, 0, 0),
        moving: Sequence[tuple[int, complex]] = (),
    ):
        human, device = map(tree.body_index, tree.cuffs[cuff])
        self.nq = tree.num_positions
        self._h = tree.segment_of[human]
        self._e = tree.segment_of[device]
        self._D0 = tree.origins[device] - tree.origins[human]
        self._D0[self._e] += preload[0] + 1j * preload[1]
        self._angle = preload[2]
        psi = tree.angles_by_q - tree.angles_by_q[self._h]
        self.relative = psi  # (ns, nq): psi = relative @ q
        self.rotation = psi[self._e]
        self.num_places = 2 + len(moving)
        # Derivative of D by the places, (ns, num_places).
        self._by = np.zeros((len(psi), self.num_places), complex)
        self._by[self._e, :2] += (1.0, 1j)
        self._by[self._h, :2] -= (1.0, 1j)
        for k, (segment, direction) in enumerate(moving, 2):
            self._by[segment, k] += direction

    def turns(self, q):
        """Unit vectors exp(i psi_k) (n, ns) at q (n, nq)."""
        return np.exp(1j * (q @ self.relative.T))

    def terms(self, q, places):
        """D_k exp(i psi_k) (n, ns) at q (n, nq), places (n, num_places)."""
        return (self._D0 + places @ self._by.T) * self.turns(q)

    def led(self, terms, direction):
        """Derivative of terms or turns along a direction of q (n, nq)."""
        return 1j * (direction @ self.relative.T) * terms

    @property
    def moved_by(self) -> np.ndarray:
        """Coordinates that move the deflection, (nq,) bool."""
        return (self.relative != 0.0).any(axis=0)

    def deflection(self, q, terms):
        """Tangential, normal [m], rotation [rad]: (n, 3)."""
        delta = terms.sum(axis=1)
        angle = q @ self.rotation + self._angle
        return np.stack([delta.imag, delta.real, angle], axis=1)

    def largest(self, trials, origin) -> np.ndarray:
        """Largest absolute deflection (3,) over trials [m, m, rad].

        Args:
            trials: objects with coordinates q (n, nq).
            origin: (2,) [m]; all other places are zero.
        """
        places = np.zeros((1, self.num_places))
        places[:, :2] = origin
        found = [self.deflection(t.q, self.terms(t.q, places)) for t in trials]
        return np.abs(np.concatenate(found)).max(axis=0)

    def force(self, deflection, bushing: BushingParameters):
        """Force of the springs (n, 3) at deflections (n, 3), no damping."""
        none = (0.0, 0.0, 0.0)
        springs = bushing_force(
            deflection.T, none, bushing.stiffness, none, bushing.slip
        )
        return np.stack(springs, axis=1)

    def deflection_jacobian(self, terms):
        """Derivative of the deflection by q, (n, 3, nq)."""
        d = (1j * terms) @ self.relative
        rotation = np.broadcast_to(self.rotation, d.shape)
        return np.stack([d.imag, d.real, rotation], axis=1)

    def by_places(self, turns):
        """Tangential, normal deflection by places, (n, 2, num_places)."""
        g = turns @ self._by
        return np.stack([g.imag, g.real], axis=1)

    def curvature(self, terms, force):
        """Hessian (n, nq, nq) by q of F · d, the force F (n, 3) held."""
        f = force[:, 1] + 1j * force[:, 0]
        c = -(np.conj(f)[:, None] * terms).real
        return contract(c, self.relative, self.relative)

    def gradient_by_places(self, turns, force):
        """d²(F · d)/(dq d places), (n, nq, num_places), F (n, 3) held."""
        f = force[:, 1] + 1j * force[:, 0]
        g = np.conj(f)[:, None] * 1j * turns
        by = self._by
        real = contract(g.real, self.relative, by.real)
        return real - contract(g.imag, self.relative, by.imag)
