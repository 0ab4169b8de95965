"""Foot–ground contact as a LeafSystem of a Drake diagram."""

from dataclasses import astuple

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_exo.errors import InputError
from drake_exo.forces.contact_constants import Constants
from drake_exo.forces.contact_parameters import (
    ContactParameters,
    ContactSphere,
)
from drake_exo.forces.hunt_crossley import Law, SphereWrench, sphere_wrench
from drake_exo.forces.planar import (
    applied_force,
    declare_body_inputs,
    declare_force_output,
    read_bodies,
    to_body,
    to_world,
)
from drake_exo.forces.scalars import any_scalar


@any_scalar
def foot_contact(
    law: Law, position, direction, motion, spheres, constants: Constants
) -> SphereWrench:
    """Contact wrenches of spheres on one planar body.

    Args:
        law: "paper" or "simbody".
        position, direction, motion: of the body, (x, z), (cosine, sine) and
            (v_x, v_z, rate), scalars.
        spheres: (number of parameters, n) in the order of SPHERE_PARAMETERS.
        constants: of the law.

    Returns:
        Wrenches with entries of shape (n,).
    """
    x, z, radius, stiffness, dissipation = spheres
    center_x, center_z = to_world(position, direction, x, z)
    v_x, v_z, rate = motion
    return sphere_wrench(
        law,
        center_x,
        center_z,
        v_x - rate * (center_z - position[1]),
        v_z + rate * (center_x - position[0]),
        rate,
        stiffness,
        dissipation,
        radius,
        constants,
    )


@any_scalar
def ground_reaction(wrenches: SphereWrench) -> np.ndarray:
    """F_x, F_z [N] and M_y about the world's origin [N·m] of all spheres.

    Sums over the first axis of the entries; M_y = z F_x − x F_z, so the
    centre of pressure on z = 0 is −M_y/F_z.
    """
    moment = (
        wrenches.point_z * wrenches.force_x
        - wrenches.point_x * wrenches.force_z
    )
    return np.array(
        [
            np.sum(values, axis=0)
            for values in (wrenches.force_x, wrenches.force_z, moment)
        ]
    )


class _FootGroundContact:
    """What `FootGroundContact_` does for every scalar type."""

    def _declare(self, T, body: BodyIndex, parameters: ContactParameters):
        self._T = T
        self._body = body
        self._parameters = parameters = parameters.checked()
        self.set_name("foot_ground_contact")
        declare_body_inputs(self, T)
        for values in (*parameters.spheres.values(), parameters.constants):
            self.DeclareNumericParameter(BasicVector_[T](astuple(values)))
        declare_force_output(self, T, self._calc_spatial_forces)
        self.DeclareVectorOutputPort(
            "ground_reaction", 3, self._calc_ground_reaction
        )
        self.DeclareVectorOutputPort(
            "sphere_wrenches",
            4 * len(parameters.spheres),
            self._calc_sphere_wrenches,
        )

    def parameters(self, context=None) -> ContactParameters:
        """Parameters in a context, or those of the construction."""
        if context is None:
            return self._parameters
        *vectors, constants = self._vectors(context)
        spheres = zip(self._parameters.spheres, vectors, strict=True)
        return ContactParameters(
            self._parameters.law,
            {name: ContactSphere(*vector) for name, vector in spheres},
            self._constants(constants),
        )

    def set_parameters(self, context, parameters: ContactParameters) -> None:
        """Writes parameters into a context: same law, same spheres.

        Raises:
            InputError: law or names of the spheres differ.
        """
        own = self._parameters
        if parameters.law != own.law or list(parameters.spheres) != list(
            own.spheres
        ):
            raise InputError(
                f"this contact has the law '{own.law}' and the spheres "
                f"{', '.join(own.spheres)}; build another one"
            )
        constants = parameters.constants or own.constants
        vectors = (*parameters.spheres.values(), constants)
        for i, values in enumerate(vectors):
            context.get_mutable_numeric_parameter(i).SetFromVector(
                np.array(astuple(values))
            )

    def _vectors(self, context) -> list[np.ndarray]:
        return [
            context.get_numeric_parameter(i).CopyToVector()
            for i in range(len(self._parameters.spheres) + 1)
        ]

    def _constants(self, vector) -> Constants:
        return type(self._parameters.constants)(*vector)

    def _wrenches(self, context):
        bodies = read_bodies(self, context, [self._body])
        position, direction, motion = (array[:, 0] for array in bodies)
        *spheres, constants = self._vectors(context)
        wrenches = foot_contact(
            self._parameters.law,
            position,
            direction,
            motion,
            np.array(spheres).T,
            self._constants(constants),
        )
        return position, direction, wrenches

    def _calc_spatial_forces(self, context, output):
        position, direction, wrenches = self._wrenches(context)
        points = to_body(
            position, direction, wrenches.point_x, wrenches.point_z
        )
        forces = (wrenches.force_x, wrenches.force_z)
        output.set_value(
            [
                applied_force(self._T, self._body, point, force)
                for point, force in zip(
                    np.transpose(points), np.transpose(forces), strict=True
                )
            ]
        )

    def _calc_ground_reaction(self, context, output):
        output.SetFromVector(ground_reaction(self._wrenches(context)[2]))

    def _calc_sphere_wrenches(self, context, output):
        output.SetFromVector(np.transpose(self._wrenches(context)[2]).ravel())


@TemplateSystem.define("FootGroundContact_")
def FootGroundContact_(T):
    """Smooth Hunt–Crossley contact of spheres on the foot with z = 0.

    Inputs, to be connected to the plant's ports of the same name:
        body_poses, body_spatial_velocities.
    Outputs:
        spatial_forces: for a plant's applied_spatial_force port.
        ground_reaction: F_x, F_z [N] on the foot and the moment
            M_y = z F_x − x F_z about the world's origin [N·m], sums.
        sphere_wrenches: F_x, F_z [N], x, z of the contact point [m] of each
            sphere in turn.
    Numeric parameters:
        a vector for each sphere (SPHERE_PARAMETERS), then one with the law's
        constants (in the order of their fields).

    Args of the constructor:
        body: index of the foot link in the plant.
        parameters: `ContactParameters`; a context starts with these values.
    """

    class Impl(_FootGroundContact, LeafSystem_[T]):
        def _construct(self, body, parameters, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self._declare(T, body, parameters)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, other._body, other._parameters, converter=converter
            )

    return Impl


FootGroundContact = FootGroundContact_[None]
