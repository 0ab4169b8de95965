"""The chair in simulation: its measured wrench, played on pelvis and thighs."""

from collections.abc import Mapping

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem
from scipy.interpolate import CubicSpline

from drake_exo.errors import InputError
from drake_exo.forces.planar import (
    applied_force,
    declare_body_inputs,
    declare_force_output,
    read_bodies,
)


@TemplateSystem.define("Chair_", T_list=[float, AutoDiffXd])
def Chair_(T):
    """A wrench about the world's origin over time, on bodies by share.

    What acts on a body is the equivalent force and moment at its origin,
    wherever it is. Between samples the wrench is a cubic spline; before the
    first and after the last it is theirs. A time series has no symbolic form:
    diagrams with a chair convert to AutoDiffXd (whose derivatives by time it
    leaves out), not to Expression.

    Inputs, to be connected to the plant's ports of the same name:
        body_poses, body_spatial_velocities.
    Outputs:
        spatial_forces: for a plant's applied_spatial_force port.
        chair_reaction: F_x, F_z [N] and M_y = z F_x - x F_z about the
            world's origin [N m].

    Args of the constructor:
        bodies: body index -> share of the wrench; shares sum to 1.
        times: (n,) increasing [s].
        wrench: (n, 3) F_x, F_z, M_y.

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
            self._span = float(times[0]), float(times[-1])
            self._spline = CubicSpline(times, wrench)
            declare_body_inputs(self, T)
            declare_force_output(self, T, self._calc_spatial_forces)
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
            return self._spline(min(max(t, self._span[0]), self._span[1]))

        def _calc_spatial_forces(self, context, output):
            F_x, F_z, M_y = self._wrench(context)
            positions, directions, _ = read_bodies(self, context, self._bodies)
            entries = []
            for i, (body, share) in enumerate(self._bodies.items()):
                c, s = directions[:, i]
                x, z = positions[:, i]
                moment = M_y - (z * F_x - x * F_z)
                entry = applied_force(
                    T,
                    body,
                    (0.0 * c, 0.0 * s),
                    (share * F_x + 0.0 * c, share * F_z + 0.0 * c),
                    -share * moment,
                )
                entries.append(entry)
            output.set_value(entries)

        def _calc_reaction(self, context, output):
            output.SetFromVector(self._wrench(context))

    return Impl


Chair = Chair_[None]
