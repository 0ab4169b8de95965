"""Bushings between human and exoskeleton as a LeafSystem of a diagram."""

from collections.abc import Mapping
from dataclasses import astuple, fields

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from drake_exo.errors import InputError
from drake_exo.forces.bushing import (
    COMPONENTS,
    BushingParameters,
    bushing_deflection,
    bushing_energy,
    bushing_force,
    bushing_wrench,
)
from drake_exo.forces.contact_parameters import check_bounds
from drake_exo.forces.planar import (
    applied_force,
    declare_body_inputs,
    declare_force_output,
    read_bodies,
    relative_angles,
    to_body,
)

# Numeric parameters of a bushing, in this order.
BUSHING_PARAMETERS = tuple(f.name for f in fields(BushingParameters))


class _Bushings:
    """What `HumanExoskeletonBushings_` does for every scalar type."""

    def _declare(self, T, pairs, parameters):
        if not parameters or set(pairs) != set(parameters):
            raise InputError(
                f"bushings are given for {', '.join(parameters) or 'nothing'}, "
                f"pairs of links for {', '.join(pairs) or 'nothing'}; "
                "name the same"
            )
        for name, values in parameters.items():
            check_bounds(values, f"bushing '{name}'")
        self._T = T
        self._pairs = {name: tuple(pairs[name]) for name in parameters}
        self._parameters = dict(parameters)
        self.set_name("human_exoskeleton_bushings")
        declare_body_inputs(self, T)
        for values in parameters.values():
            self.DeclareNumericParameter(BasicVector_[T](astuple(values)))
        declare_force_output(self, T, self._calc_spatial_forces)
        size = len(COMPONENTS) * len(parameters)
        for name, calc in (
            ("interaction_forces", self._calc_forces),
            ("deflections", self._calc_deflections),
            ("energies", self._calc_energies),
        ):
            self.DeclareVectorOutputPort(name, size, calc)

    def parameters(self, context=None) -> dict[str, BushingParameters]:
        """Parameters in a context, or those of the construction."""
        if context is None:
            return dict(self._parameters)
        return {
            name: BushingParameters(*column)
            for name, column in zip(
                self._parameters, self._matrix(context).T, strict=True
            )
        }

    def set_parameters(
        self, context, parameters: Mapping[str, BushingParameters]
    ) -> None:
        """Writes parameters into a context.

        Raises:
            InputError: the names are not those of the construction.
        """
        if set(parameters) != set(self._parameters):
            raise InputError(
                f"bushings here are {', '.join(self._parameters)}, "
                f"not {', '.join(parameters)}"
            )
        for i, name in enumerate(self._parameters):
            context.get_mutable_numeric_parameter(i).SetFromVector(
                np.array(astuple(parameters[name]))
            )

    def _matrix(self, context) -> np.ndarray:
        """Parameters (number of parameters, number of bushings)."""
        return np.transpose(
            [
                context.get_numeric_parameter(i).CopyToVector()
                for i in range(len(self._parameters))
            ]
        )

    def _evaluate(self, context):
        """All bushings at once: entries of shape (number of bushings,)."""
        humans, devices = zip(*self._pairs.values(), strict=True)
        p_h, direction_h, motion_h = read_bodies(self, context, humans)
        p_e, direction_e, motion_e = read_bodies(self, context, devices)
        angle_h, angle_e = relative_angles(direction_h, direction_e)
        links = (
            (p_h, direction_h, (*p_h, angle_h)),
            (p_e, direction_e, (*p_e, angle_e)),
        )
        parameters = BushingParameters(*self._matrix(context))
        deflection, rate = bushing_deflection(
            links[0][2],
            motion_h,
            links[1][2],
            motion_e,
            parameters.origin,
            parameters.preload,
        )
        force = bushing_force(
            deflection, rate, parameters.stiffness, parameters.damping
        )
        return links, parameters, deflection, force

    def _calc_spatial_forces(self, context, output):
        links, parameters, _, force = self._evaluate(context)
        (p_h, direction_h, pose_h), (p_e, direction_e, pose_e) = links
        wrench = bushing_wrench(
            force, pose_h, pose_e, parameters.origin, parameters.preload
        )
        points = (
            to_body(p_h, direction_h, wrench.point_x, wrench.point_z),
            to_body(p_e, direction_e, wrench.point_x, wrench.point_z),
        )
        entries = []
        for i, pair in enumerate(self._pairs.values()):
            for body, point, sign in zip(pair, points, (1, -1), strict=True):
                entries.append(
                    applied_force(
                        self._T,
                        body,
                        (point[0][i], point[1][i]),
                        (sign * wrench.force_x[i], sign * wrench.force_z[i]),
                        sign * wrench.moment[i],
                    )
                )
        output.set_value(entries)

    def _calc_forces(self, context, output):
        output.SetFromVector(np.transpose(self._evaluate(context)[3]).ravel())

    def _calc_deflections(self, context, output):
        output.SetFromVector(np.transpose(self._evaluate(context)[2]).ravel())

    def _calc_energies(self, context, output):
        _, parameters, deflection, _ = self._evaluate(context)
        energies = bushing_energy(deflection, parameters.stiffness)
        output.SetFromVector(np.transpose(energies).ravel())


@TemplateSystem.define("HumanExoskeletonBushings_")
def HumanExoskeletonBushings_(T):
    """Planar bushings between pairs of links.

    Inputs, to be connected to the plant's ports of the same name:
        body_poses, body_spatial_velocities.
    Outputs, three values (tangential, normal, rotation) for each bushing:
        interaction_forces: on the human [N, N, N·m].
        deflections: [m, m, rad].
        energies: ½ k d² [J].
    and spatial_forces, for a plant's applied_spatial_force port.
    Numeric parameters:
        a vector for each bushing (BUSHING_PARAMETERS).

    Args of the constructor:
        pairs: (human link, exoskeleton link) body indices by name.
        parameters: `BushingParameters` by the same names; their order is
            that of the outputs. A context starts with these values.
    """

    class Impl(_Bushings, LeafSystem_[T]):
        def _construct(
            self,
            pairs: Mapping[str, tuple[BodyIndex, BodyIndex]],
            parameters: Mapping[str, BushingParameters],
            converter=None,
        ):
            LeafSystem_[T].__init__(self, converter=converter)
            self._declare(T, pairs, parameters)

        def _construct_copy(self, other, converter=None):
            Impl._construct(
                self, other._pairs, other._parameters, converter=converter
            )

    return Impl


HumanExoskeletonBushings = HumanExoskeletonBushings_[None]
