"""Cuffs as they are: they stiffen when pressed in, and slip under shear.

With neither, they are the bushings of the model.
"""

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import LeafSystem

from drake_exo.forces.bushing import (
    BushingParameters,
    Components,
    bushing_deflection,
    bushing_force,
    bushing_wrench,
)
from drake_exo.forces.planar import (
    applied_force,
    declare_body_inputs,
    declare_force_output,
    read_bodies,
    relative_angles,
    to_body,
)


@dataclass(frozen=True)
class Cuff:
    """A bushing with two departures from its law.

    Attributes:
        bushing: the law at small deflection.
        progression: 1/d_0 [1/m]: springs give k d (1 + (d/d_0)^2) along and
            across the limb; 0 for linear ones.
        slip: 1/F_0 [1/N]: the force along the limb never exceeds F_0; 0 for
            cuffs that do not slip.
    """

    bushing: BushingParameters
    progression: float = field(default=0.0, metadata={"unit": "1/m"})
    slip: float = field(default=0.0, metadata={"unit": "1/N"})


def cuff_force(cuff: Cuff, deflection, rate) -> Components:
    """Force on the human; `Cuff`'s values broadcast with the deflection.

    Args:
        cuff: values of any common shape (...).
        deflection, rate: as from `bushing_deflection`, of shape (...).
    """
    linear = bushing_force(
        deflection, rate, cuff.bushing.stiffness, cuff.bushing.damping
    )
    more = [
        k * d * (cuff.progression * d) ** 2
        for k, d in zip(cuff.bushing.stiffness, deflection, strict=True)
    ]
    along = linear.tangential + more[0]
    return Components(
        along / np.sqrt(1.0 + (cuff.slip * along) ** 2),
        linear.normal + more[1],
        linear.rotation,
    )


def stacked(cuffs: Mapping[str, Cuff]) -> Cuff:
    """All cuffs as one, its values arrays (number of cuffs,)."""
    values = zip(*(astuple(c.bushing) for c in cuffs.values()), strict=True)
    return Cuff(
        BushingParameters(*(np.array(v) for v in values)),
        np.array([c.progression for c in cuffs.values()]),
        np.array([c.slip for c in cuffs.values()]),
    )


class Cuffs(LeafSystem):
    """Cuffs for a diagram: `build_diagram(..., forces=[Cuffs(...)])`.

    Inputs body_poses and body_spatial_velocities; output spatial_forces.

    Args:
        pairs: (human link, exoskeleton link) body indices by name.
        cuffs: by the same names.
    """

    def __init__(
        self,
        pairs: Mapping[str, tuple[BodyIndex, BodyIndex]],
        cuffs: Mapping[str, Cuff],
    ):
        super().__init__()
        self.set_name("cuffs")
        self._pairs = [pairs[name] for name in cuffs]
        self._bodies = [body for pair in self._pairs for body in pair]
        self._cuffs = stacked(cuffs)
        declare_body_inputs(self, float)
        declare_force_output(self, float, self._calc_spatial_forces)

    def _calc_spatial_forces(self, context, output):
        cuffs, law = self._cuffs, self._cuffs.bushing
        p, direction, motion = read_bodies(self, context, self._bodies)
        angles = relative_angles(direction[:, ::2], direction[:, 1::2])
        human = (*p[:, ::2], angles[0])
        device = (*p[:, 1::2], angles[1])
        deflection, rate = bushing_deflection(
            human,
            motion[:, ::2],
            device,
            motion[:, 1::2],
            law.origin,
            law.preload,
        )
        force = cuff_force(cuffs, deflection, rate)
        w = bushing_wrench(force, human, device, law.origin, law.preload)
        entries = []
        for k, side in ((0, 1.0), (1, -1.0)):
            points = to_body(
                p[:, k::2], direction[:, k::2], w.point_x, w.point_z
            )
            for i, pair in enumerate(self._pairs):
                entries.append(
                    applied_force(
                        float,
                        pair[k],
                        (points[0][i], points[1][i]),
                        (side * w.force_x[i], side * w.force_z[i]),
                        side * w.moment[i],
                    )
                )
        output.set_value(entries)
