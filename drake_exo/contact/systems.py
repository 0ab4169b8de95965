"""LeafSystems for a diagram: contacts, the chair and controllers of joints.

Contacts are those of foot with ground and human with device; the chair applies
a measured wrench. The foot moves in space, all others in the plane. A planar
pose is (x, z, angle), a planar motion (v_x, v_z, rate): x forward, z up, angle
toes-up positive (counter-clockwise seen from the right, about world −y).

`TrackingController` follows a reference. `AssistController` is an example of
an assist controller for predictions: a LeafSystem without state, with the
input exoskeleton_state (angles, then rates of the device's joints) and output
exoskeleton_torques [N m], defined with TemplateSystem so that it converts to
AutoDiffXd. `drake-exo predict --controller MODULE:NAME` puts such a controller
into the optimisation itself.
"""

import functools
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform_
from pydrake.multibody.math import SpatialForce_, SpatialVelocity_
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.multibody.tree import BodyIndex
from pydrake.symbolic import Expression
from pydrake.systems.framework import (
    BasicVector_,
    LeafSystem,
    LeafSystem_,
    ValueProducer,
)
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from drake_exo.contact.bushing import (
    COMPONENTS,
    BushingParameters,
    bushing_deflection,
    bushing_energy,
    bushing_force,
    bushing_wrench,
)
from drake_exo.contact.hunt_crossley import (
    Constants,
    Law,
    SpatialSphereWrench,
    spatial_sphere_wrench,
)
from drake_exo.contact.parameters import ContactSphere, GroundContact
from drake_exo.contact.scalars import arctan2, sin
from drake_exo.errors import (
    InputError,
    check_bounds,
    check_fields,
    check_type,
)

# Least cosine between a body's y axis and the world's: half a millimetre where
# a cuff is half a metre from its link's origin.
_IN_PLANE = 0.999


def made_on_demand(scope: dict) -> Callable[[str], type]:
    """A module's `__getattr__`: NAME is the float system of template `NAME_`.

    Made on first use only, because Drake searches all modules for each.

    Args:
        scope: The module's globals.
    """

    def __getattr__(name: str) -> type:  # noqa: N807
        template = scope.get(f"{name}_")
        if not isinstance(template, TemplateSystem):
            raise AttributeError(
                f"module {scope['__name__']!r} has no attribute {name!r}"
            )
        return template[float]

    return __getattr__


__getattr__ = made_on_demand(globals())


def declare_force_ports(system: LeafSystem, T, calc) -> None:
    """Declares the ports of a system that applies forces to bodies.

    Inputs "body_poses" and "body_spatial_velocities" of the plant; the output
    "spatial_forces", computed by `calc`, for its applied_spatial_force.
    """
    for name, kind in (
        ("body_poses", RigidTransform_[T]),
        ("body_spatial_velocities", SpatialVelocity_[T]),
    ):
        system.DeclareAbstractInputPort(name, AbstractValue.Make([kind()]))
    entry = ExternallyAppliedSpatialForce_[T]
    system.DeclareAbstractOutputPort(
        "spatial_forces", lambda: AbstractValue.Make([entry()]), calc
    )


def _cached(system: LeafSystem, name: str, calc, *tickets):
    """Declares a cache entry for a Python object; by default of all sources."""
    producer = ValueProducer(
        allocate=lambda: AbstractValue.Make(object()), calc=calc
    )
    sources = set(tickets) or {system.all_sources_ticket()}
    return system.DeclareCacheEntry(name, producer, sources)


class BodyState(NamedTuple):
    """Pose and motion of a body in the plane, scalars."""

    position: tuple  # x, z [m]
    direction: tuple  # cosine and sine of the angle
    motion: tuple  # v_x, v_z [m/s], rate [rad/s]


def read_bodies(system: LeafSystem, context, bodies) -> list[BodyState]:
    """States of bodies, from the ports of `declare_force_ports`.

    Args:
        system: the system that declared the ports.
        context: of that system.
        bodies: body indices.

    Raises:
        InputError: a body is turned out of the plane, in which alone forces
            are known; not told of Expression.
    """
    poses = system.GetInputPort("body_poses").Eval(context)
    velocities = system.GetInputPort("body_spatial_velocities").Eval(context)
    found = []
    for body in bodies:
        X_WB = poses[int(body)].GetAsMatrix34().tolist()
        (c, _, _, x), (_, upright, _, _), (s, _, _, z) = X_WB
        if not isinstance(upright, Expression) and upright < _IN_PLANE:
            raise InputError(
                f"{system.get_name()}: body {int(body)} is turned out of the "
                "x-z plane, in which alone forces are known; hold it there "
                "by a planar joint, its y axis along the world's"
            )
        V_WB = velocities[int(body)].get_coeffs().tolist()
        _, w_y, _, v_x, _, v_z = V_WB
        found.append(BodyState((x, z), (c, s), (v_x, v_z, -w_y)))
    return found


def planar_poses(first: BodyState, second: BodyState) -> tuple:
    """(x, z, angle) of two bodies, angles on the same branch.

    The first angle is in (−π, π], the second within π of the first.
    """
    (c, s), (c_2, s_2) = first.direction, second.direction
    angle = arctan2(s, c)
    turn = arctan2(s_2 * c - c_2 * s, c_2 * c + s_2 * s)
    return (*first.position, angle), (*second.position, angle + turn)


@functools.cache
def _force_types(T) -> tuple:
    """Drake's classes of `applied_force`; looking them up is slow."""
    return ExternallyAppliedSpatialForce_[T], SpatialForce_[T]


def applied_force(T, body, link: BodyState, point, force, moment=0.0):
    """One entry of a plant's "applied_spatial_force" port.

    Args:
        T: scalar type.
        body: index of the body that receives the force.
        link: state of that body.
        point: (x, z) where it acts, in the world [m].
        force: (F_x, F_z) in the world [N].
        moment: toes-up positive (about world −y) [N·m].
    """
    c, s = link.direction
    dx, dz = point[0] - link.position[0], point[1] - link.position[1]
    p_BoBq_B = [c * dx + s * dz, 0.0, c * dz - s * dx]
    F_Bq_W = [0.0, -moment, 0.0, force[0], 0.0, force[1]]
    return _entry(T, body, p_BoBq_B, F_Bq_W)


def _entry(T, body, p_BoBq_B, F_Bq_W):
    """Entry of the port: moment and force [N·m, N] at a point of a body [m]."""
    Entry, Force = _force_types(T)
    entry = Entry()
    entry.body_index = body
    entry.p_BoBq_B = np.array(p_BoBq_B)
    entry.F_Bq_W = Force(F=np.array(F_Bq_W))
    return entry


def opposite_forces(T, pair, links, wrench) -> list:
    """Applied forces of a bushing: on the human, and opposite on the device.

    Args:
        T: scalar type.
        pair: body indices (human, device).
        links: `BodyState` of each.
        wrench: `BushingWrench` on the human.
    """
    *wrench, x, z = wrench
    entries = []
    for body, link, sign in zip(pair, links, (1, -1), strict=True):
        *force, moment = (sign * value for value in wrench)
        entries.append(applied_force(T, body, link, (x, z), force, moment))
    return entries


class SpatialState(NamedTuple):
    """Pose and motion of a body in space, scalars in the world frame."""

    rotation: tuple  # three rows
    position: tuple  # of its origin [m]
    angular_velocity: tuple  # [rad/s]
    velocity: tuple  # of its origin [m/s]

    def from_body(self, vector) -> list:
        """A vector given in the body's frame, in the world's."""
        x, y, z = vector
        return [a * x + b * y + c * z for a, b, c in self.rotation]

    def to_body(self, vector) -> list:
        """A vector given in the world's frame, in the body's."""
        x, y, z = vector
        columns = zip(*self.rotation, strict=True)
        return [a * x + b * y + c * z for a, b, c in columns]


def _read_foot(system: LeafSystem, context, body: BodyIndex) -> SpatialState:
    """State of a body, from the ports of `declare_force_ports`."""
    pose = system.GetInputPort("body_poses").Eval(context)[int(body)]
    motion = system.GetInputPort("body_spatial_velocities").Eval(context)
    rows = pose.GetAsMatrix34().tolist()
    V_WB = motion[int(body)].get_coeffs().tolist()
    rotation, position = zip(*((r[:3], r[3]) for r in rows), strict=True)
    return SpatialState(rotation, position, V_WB[:3], V_WB[3:])


def _foot_contact(
    law: Law,
    foot: SpatialState,
    sphere: ContactSphere,
    constants: Constants,
) -> SpatialSphereWrench:
    """Contact force of the ground on a sphere of a foot."""
    arm = a_x, a_y, a_z = foot.from_body((sphere.x, sphere.y, sphere.z))
    center = [o + a for o, a in zip(foot.position, arm, strict=True)]
    (v_x, v_y, v_z), (w_x, w_y, w_z) = foot.velocity, foot.angular_velocity
    velocity = (
        v_x + w_y * a_z - w_z * a_y,
        v_y + w_z * a_x - w_x * a_z,
        v_z + w_x * a_y - w_y * a_x,
    )
    return spatial_sphere_wrench(
        law,
        center,
        velocity,
        foot.angular_velocity,
        sphere.stiffness,
        sphere.dissipation,
        sphere.radius,
        constants,
    )


def _index_of(body, what: str) -> BodyIndex:
    """The index of a body, given as such or as a number.

    Raises:
        InputError: it is neither; it names the argument `what`.
    """
    try:
        return BodyIndex(int(body))
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{what} is {body!r:.60}; give its index in the plant, as "
            "plant.GetBodyByName(...).index() returns it"
        ) from error


# The scope is given so that Drake need not search all modules for it.
@TemplateSystem.define("FootGroundContact_", scope=sys.modules[__name__])
def FootGroundContact_(T):
    """See `FootGroundContact`."""

    class Impl(LeafSystem_[T]):
        """Smooth Hunt–Crossley contact of spheres on a foot with z = 0.

        For a link of any plant: it may turn and move in the plane or in space.

        Inputs, to be connected to the plant's ports of the same name:
            body_poses, body_spatial_velocities.
        Outputs:
            spatial_forces: for a plant's applied_spatial_force port; Drake's
                ExternallyAppliedSpatialForceMultiplexer joins several.
            spatial_reaction: M_x, M_y, M_z about the world's origin [N·m],
                F_x, F_y, F_z [N] on the foot, summed over spheres.
            ground_reaction: F_x, F_z and M_y of it, all there is in the plane;
                M_y = z F_x − x F_z.
            sphere_wrenches: F_x, F_z [N], contact point x, z [m], by sphere.
        Numeric parameters:
            a vector for each sphere, then one with the law's constants (both
            in the order of their fields).

        Args of the constructor:
            body: index of the foot link in the plant.
            parameters: `GroundContact`; a context starts with these values.

        >>> from drake_exo.contact.parameters import ContactSphere
        >>> heel = ContactSphere(5e6, 2.0, x=-0.05, z=-0.04, radius=0.032)
        >>> contact = FootGroundContact(
        ...     BodyIndex(1), GroundContact("simbody", {"heel": heel}))
        >>> contact.GetOutputPort("spatial_reaction").size()
        6
        """

        def _construct(
            self, body: BodyIndex, parameters: GroundContact, converter=None
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            check_type(parameters, GroundContact, "parameters")
            self._body = _index_of(body, "body")
            self._parameters = parameters = parameters.checked()
            self.set_name("foot_ground_contact")
            declare_force_ports(self, T, self._calc_spatial_forces)
            for values in (*parameters.spheres.values(), parameters.constants):
                self.DeclareNumericParameter(BasicVector_[T](astuple(values)))
            self._values = _cached(
                self, "values", self._calc_values, self.all_parameters_ticket()
            )
            # Shared by all outputs, so wrenches are computed once.
            self._wrenches = _cached(self, "wrenches", self._calc_wrenches)
            self.DeclareVectorOutputPort(
                "ground_reaction", 3, self._calc_ground_reaction
            )
            self.DeclareVectorOutputPort(
                "spatial_reaction", 6, self._calc_spatial_reaction
            )
            self.DeclareVectorOutputPort(
                "sphere_wrenches",
                4 * len(parameters.spheres),
                self._calc_sphere_wrenches,
            )

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, other._body, other._parameters, converter=converter
            )

        def parameters(self, context=None) -> GroundContact:
            """Parameters in a context, or those of the construction."""
            if context is None:
                return self._parameters
            spheres, constants = self._held(context)
            named = zip(self._parameters.spheres, spheres, strict=True)
            return GroundContact(self._parameters.law, dict(named), constants)

        def set_parameters(self, context, parameters: GroundContact) -> None:
            """Writes parameters of the same law and spheres into a context.

            Raises:
                InputError: law or names of the spheres differ, or a value is
                    out of its bounds.
            """
            own, parameters = self._parameters, parameters.checked()
            if parameters.law != own.law or list(parameters.spheres) != list(
                own.spheres
            ):
                raise InputError(
                    f"this contact has the law '{own.law}' and the spheres "
                    f"{', '.join(own.spheres)}; build another one"
                )
            vectors = (*parameters.spheres.values(), parameters.constants)
            for i, values in enumerate(vectors):
                context.get_mutable_numeric_parameter(i).SetFromVector(
                    np.array(astuple(values))
                )

        def _held(self, context) -> tuple[list[ContactSphere], Constants]:
            """Spheres and constants, from a context."""
            *spheres, constants = (
                context.get_numeric_parameter(i).CopyToVector().tolist()
                for i in range(len(self._parameters.spheres) + 1)
            )
            return (
                [ContactSphere(*values) for values in spheres],
                type(self._parameters.constants)(*constants),
            )

        def _calc_values(self, context, output):
            output.set_value(self._held(context))

        def _calc_wrenches(self, context, output):
            foot = _read_foot(self, context, self._body)
            spheres, constants = self._values.Eval(context)
            wrenches = [
                _foot_contact(self._parameters.law, foot, sphere, constants)
                for sphere in spheres
            ]
            output.set_value((foot, wrenches))

        def _calc_spatial_forces(self, context, output):
            foot, wrenches = self._wrenches.Eval(context)
            entries = []
            for force, point in wrenches:
                arm = (p - o for p, o in zip(point, foot.position, strict=True))
                F_Bq_W = [0.0, 0.0, 0.0, *force]
                entries.append(_entry(T, self._body, foot.to_body(arm), F_Bq_W))
            output.set_value(entries)

        def _reaction(self, context) -> list:
            """`about_origin` [N·m, N], summed over spheres."""
            wrenches = self._wrenches.Eval(context)[1]
            parts = zip(*(w.about_origin for w in wrenches), strict=True)
            return [sum(values[1:], values[0]) for values in parts]

        def _calc_spatial_reaction(self, context, output):
            output.SetFromVector(self._reaction(context))

        def _calc_ground_reaction(self, context, output):
            _, M_y, _, F_x, _, F_z = self._reaction(context)
            output.SetFromVector([F_x, F_z, M_y])

        def _calc_sphere_wrenches(self, context, output):
            wrenches = self._wrenches.Eval(context)[1]
            parts = [x for wrench in wrenches for x in wrench.in_plane]
            output.SetFromVector(parts)

    return Impl


def _check_bushings(parameters: Mapping[str, BushingParameters]) -> None:
    for name, values in parameters.items():
        check_fields(values, f"bushing '{name}'")


@TemplateSystem.define("HumanExoskeletonBushings_", scope=sys.modules[__name__])
def HumanExoskeletonBushings_(T):
    """See `HumanExoskeletonBushings`."""

    class Impl(LeafSystem_[T]):
        """Planar bushings between pairs of links.

        Inputs, to be connected to the plant's ports of the same name:
            body_poses, body_spatial_velocities.
        Outputs, three values (tangential, normal, rotation) for each bushing:
            interaction_forces: on the human [N, N, N·m].
            deflections: [m, m, rad].
            energies: ½ k d² [J], d without what has slipped.
        and spatial_forces, as of `FootGroundContact`.
        Numeric parameters:
            a vector for each bushing (fields of `BushingParameters`).

        Args of the constructor:
            pairs: (human link, exoskeleton link) body indices by name.
            parameters: `BushingParameters` by the same names; their order is
                that of the outputs. A context starts with these values.

        Outputs raise InputError where a link's y axis leaves the world's.

        >>> cuffs = HumanExoskeletonBushings(
        ...     {"thigh": (BodyIndex(1), BodyIndex(2))},
        ...     {"thigh": BushingParameters()})
        >>> cuffs.GetOutputPort("interaction_forces").size()
        3
        """

        def _construct(
            self,
            pairs: Mapping[str, tuple[BodyIndex, BodyIndex]],
            parameters: Mapping[str, BushingParameters],
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            if not parameters or set(pairs) != set(parameters):
                raise InputError(
                    "bushings are given for "
                    f"{', '.join(parameters) or 'nothing'}, pairs of links for "
                    f"{', '.join(pairs) or 'nothing'}; name the same cuffs in "
                    "both"
                )
            _check_bushings(parameters)
            self._pairs = {
                name: tuple(_index_of(b, f"pairs: {name}") for b in pairs[name])
                for name in parameters
            }
            self._parameters = dict(parameters)
            self.set_name("human_exoskeleton_bushings")
            declare_force_ports(self, T, self._calc_spatial_forces)
            for values in parameters.values():
                self.DeclareNumericParameter(BasicVector_[T](astuple(values)))
            self._values = _cached(
                self, "values", self._calc_values, self.all_parameters_ticket()
            )
            size = len(COMPONENTS) * len(parameters)
            for name, read in (
                ("interaction_forces", lambda own, d, force: force),
                ("deflections", lambda own, d, force: d),
                (
                    "energies",
                    lambda own, d, force: bushing_energy(
                        d, own.stiffness, own.slip
                    ),
                ),
            ):
                calc = functools.partial(self._calc_read, read)
                self.DeclareVectorOutputPort(name, size, calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, other._pairs, other._parameters, converter=converter
            )

        def parameters(self, context=None) -> dict[str, BushingParameters]:
            """Parameters in a context, or those of the construction."""
            if context is None:
                return dict(self._parameters)
            return {
                name: BushingParameters(
                    *context.get_numeric_parameter(i).CopyToVector().tolist()
                )
                for i, name in enumerate(self._parameters)
            }

        def set_parameters(
            self, context, parameters: Mapping[str, BushingParameters]
        ) -> None:
            """Writes parameters into a context.

            Raises:
                InputError: the names are not those of the construction, or a
                    value is out of its bounds.
            """
            if set(parameters) != set(self._parameters):
                raise InputError(
                    f"bushings here are {', '.join(self._parameters)}, "
                    f"not {', '.join(parameters)}"
                )
            _check_bushings(parameters)
            for i, name in enumerate(self._parameters):
                context.get_mutable_numeric_parameter(i).SetFromVector(
                    np.array(astuple(parameters[name]))
                )

        def _calc_values(self, context, output):
            output.set_value(list(self.parameters(context).values()))

        def _evaluate(self, context) -> Iterator[tuple]:
            """Links, poses, parameters, deflection, force of each bushing."""
            bodies = [body for pair in self._pairs.values() for body in pair]
            states = iter(read_bodies(self, context, bodies))
            known = self._values.Eval(context)
            for human, device, own in zip(states, states, known, strict=True):
                poses = planar_poses(human, device)
                deflection, rate = bushing_deflection(
                    poses[0],
                    human.motion,
                    poses[1],
                    device.motion,
                    own.origin,
                    own.preload,
                )
                force = bushing_force(
                    deflection, rate, own.stiffness, own.damping, own.slip
                )
                yield (human, device), poses, own, deflection, force

        def _calc_spatial_forces(self, context, output):
            entries = []
            for pair, (links, poses, own, _, force) in zip(
                self._pairs.values(), self._evaluate(context), strict=True
            ):
                wrench = bushing_wrench(force, *poses, own.origin, own.preload)
                entries += opposite_forces(T, pair, links, wrench)
            output.set_value(entries)

        def _calc_read(self, read, context, output):
            parts = (read(*known) for _, _, *known in self._evaluate(context))
            output.SetFromVector([x for values in parts for x in values])

    return Impl


@TemplateSystem.define(
    "Chair_", T_list=[float, AutoDiffXd], scope=sys.modules[__name__]
)
def Chair_(T):
    """A recorded wrench over time, shared among bodies.

    Each body receives its share as the equivalent force and moment at its
    origin. The wrench is a cubic spline between samples, constant before the
    first and after the last. A time series has no symbolic form: diagrams with
    a chair convert to AutoDiffXd (without derivatives by time), not Expression.

    Inputs, to be connected to the plant's ports of the same name:
        body_poses, body_spatial_velocities.
    Outputs:
        spatial_forces: for a plant's applied_spatial_force port.
        chair_reaction: F_x, F_z [N] and M_y = z F_x - x F_z about the
            world's origin [N m].

    Args of the constructor:
        bodies: body index -> share of the wrench; shares sum to 1.
        times: (n,) increasing [s].
        wrench: (n, 3) F_x, F_z [N], M_y [N m] about the world's origin.

    Raises:
        InputError: shares that do not sum to 1, or shapes that differ.
    """

    class Impl(LeafSystem_[T]):
        def _construct(
            self,
            bodies: Mapping[BodyIndex, float],
            times: np.ndarray,
            wrench: np.ndarray,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            self.set_name("chair")
            if abs(sum(bodies.values()) - 1.0) > 1e-9:
                raise InputError("the shares of the chair must sum to 1")
            if np.shape(wrench) != (len(times), 3):
                raise InputError(
                    f"the chair's wrench has shape {np.shape(wrench)}, not "
                    f"({len(times)}, 3)"
                )
            self._bodies = dict(bodies)
            self._spline = CubicSpline(times, wrench)
            declare_force_ports(self, T, self._calc_spatial_forces)
            self.DeclareVectorOutputPort(
                "chair_reaction", 3, self._calc_reaction
            )

        def _construct_copy(self, other, converter=None):
            times = other._spline.x
            Impl._construct(
                self, other._bodies, times, other._spline(times), converter
            )

        def _wrench(self, context) -> np.ndarray:
            t = context.get_time()
            t = t if T is float else ExtractValue(np.array([t])).item()
            return self._spline(np.clip(t, *self._spline.x[[0, -1]]))

        def _calc_spatial_forces(self, context, output):
            F_x, F_z, M_y = self._wrench(context)
            states = read_bodies(self, context, self._bodies)
            entries = []
            for (body, share), state in zip(
                self._bodies.items(), states, strict=True
            ):
                x, z = state.position
                moment = M_y - (z * F_x - x * F_z)
                force = T(share * F_x), T(share * F_z)
                entry = applied_force(
                    T, body, state, (x, z), force, -share * moment
                )
                entries.append(entry)
            output.set_value(entries)

        def _calc_reaction(self, context, output):
            output.SetFromVector(self._wrench(context))

    return Impl


class TrackingController(LeafSystem):
    """Feed-forward torques plus proportional-derivative feedback.

    Input state (q, v); output joint_torques, one for each hinge [N m].

    Args:
        times: (n,) increasing [s]; before and after them the ends are held.
        q, v, a: (n, nq) reference; v and a set the slopes between the times,
            so that interpolation asks for no speed that is not in it.
        torque: (n, n_joints) feed-forward [N m]; hinges are the last
            coordinates.
        stiffness: of the feedback [N m/rad]; one, or (n_joints,) each.
        damping: of the feedback [N m s/rad]; likewise.

    It does not convert to other scalar types. To differentiate or linearise a
    diagram, build it without and set its input joint_torques.

    Raises:
        InputError: an array has another shape, or times do not increase.

    >>> still = np.zeros((2, 6))
    >>> torque = still[:, 3:]
    >>> controller = TrackingController([0, 1], still, still, still, torque)
    >>> controller.GetOutputPort("joint_torques").size()
    3
    """

    def __init__(self, times, q, v, a, torque, stiffness=500.0, damping=30.0):
        super().__init__()
        self.set_name("tracking_controller")
        times, q, v, a, torque = map(np.asarray, (times, q, v, a, torque))
        n, nq = len(times), q.shape[-1]
        hinges, n_joints = slice(3, nq), nq - 3
        shapes = {x.shape for x in (q, v, a)}, torque.shape
        if shapes != ({(n, nq)}, (n, n_joints)):
            told = ", ".join(str(x.shape) for x in (q, v, a, torque))
            raise InputError(
                f"q, v, a, torque have the shapes {told}; for {n} times they "
                "have to be (n, nq) and, one for each hinge, (n, nq - 3)"
            )
        if not (np.diff(times) > 0.0).all():
            raise InputError("times do not increase; sort the samples")
        q, v, a = (x[:, hinges] for x in (q, v, a))
        self._ends = times[0], times[-1]
        self._torque = CubicSpline(times, torque)
        # The reference's part of the feedback torque, with its time derivative.
        self._held = CubicHermiteSpline(
            times, stiffness * q + damping * v, stiffness * v + damping * a
        )
        self._feedback = np.zeros((n_joints, 2 * nq))
        self._feedback[:, hinges] = stiffness * np.eye(n_joints)
        self._feedback[:, nq + 3 :] = damping * np.eye(n_joints)
        self.DeclareVectorInputPort("state", 2 * nq)
        self.DeclareVectorOutputPort("joint_torques", n_joints, self._calc)

    def _calc(self, context, output):
        state = self.GetInputPort("state").Eval(context)
        time = np.clip(context.get_time(), *self._ends)
        held = self._held(time) - self._feedback @ state
        output.SetFromVector(self._torque(time) + held)


@TemplateSystem.define("AssistController_", scope=sys.modules[__name__])
def AssistController_(T):
    """See `AssistController`."""

    class Impl(LeafSystem_[T]):
        """Support of knee and hip, as against gravity, fading as they extend.

        torque = -support sin(angle) - damping rate at knee and hip. Flexion is
        positive, so the support extends the joints.

        Args of the constructor:
            knee_nm, hip_nm: support at 90°, both legs [N m]; default 15.
            damping: [N m s/rad]; default 0.5.

        Input exoskeleton_state (6): ankle, knee, hip [rad], then rates [rad/s].
        Output exoskeleton_torques (3): ankle, knee, hip [N m].

        >>> controller = AssistController(knee_nm=20.0)
        >>> context = controller.CreateDefaultContext()
        >>> bent = [0.0, 1.5708, 0.0, 0.0, 0.0, 0.0]
        >>> port = controller.GetInputPort("exoskeleton_state")
        >>> port.FixValue(context, bent) and None
        >>> port = controller.GetOutputPort("exoskeleton_torques")
        >>> port.Eval(context).round(2) + 0.0
        array([  0., -20.,   0.])
        """

        def _construct(
            self,
            knee_nm: float = 15.0,
            hip_nm: float = 15.0,
            damping: float = 0.5,
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            check_bounds("knee_nm", knee_nm, {"unit": "N m"})
            check_bounds("hip_nm", hip_nm, {"unit": "N m"})
            check_bounds(
                "damping", damping, {"unit": "N m s/rad", "minimum": 0.0}
            )
            self.set_name("assist_controller")
            self._support = knee_nm, hip_nm
            self._damping = damping
            self.DeclareVectorInputPort("exoskeleton_state", 6)
            self.DeclareVectorOutputPort("exoskeleton_torques", 3, self._calc)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, *other._support, other._damping, converter=converter
            )

        def _calc(self, context, output):
            state = self.GetInputPort("exoskeleton_state").Eval(context)
            output.SetAtIndex(0, T(0.0))
            for joint, support in zip((1, 2), self._support, strict=True):
                torque = -support * sin(state[joint])
                torque = torque - self._damping * state[3 + joint]
                output.SetAtIndex(joint, torque)

    return Impl
