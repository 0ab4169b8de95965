"""Whether cuffs hold a device: by how much it resists being pushed off.

With the person held still, the cuffs' springs and gravity give each of the
device's joints a potential energy. Where its curvature is negative for some
combination of them, the device is pushed further off by its own weight: it
hangs loose, however well a movement on it solves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.parameters import ContactModel
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model

_STEP_RAD = 1e-5


class Hold(NamedTuple):
    """How well a device is held.

    Attributes:
        stiffness: least curvature of the energy by the device's joints, of
            unit length together, over all postures [N m/rad].
        joint: that turns most where it is least.
    """

    stiffness: float
    joint: str


def hold(model: Model, contact: ContactModel, trials: Sequence[Trial]) -> Hold:
    """Least stiffness that holds the device on a person who keeps still.

    Args:
        model: subject and device.
        contact: its bushings are the cuffs.
        trials: whose postures are looked at.
    """
    tree, names = model.tree, model.coordinates
    device = names.device_columns
    cuffs = [
        (BushingKinematics(tree, cuff, b.preload), b)
        for cuff, b in contact.bushings.items()
    ]

    def slope(q: np.ndarray) -> np.ndarray:
        """Of the energy by the device's joints (n, m) at q (n, nq)."""
        rest = np.zeros_like(q)
        found = tree.inverse_dynamics(q, rest, rest)
        for kinematics, bushing in cuffs:
            places = np.broadcast_to(bushing.origin, (len(q), 2))
            terms = kinematics.terms(q, places)
            d = kinematics.deflection(q, terms)
            found += np.einsum(
                "nc,ncq->nq",
                kinematics.force(d, bushing),
                kinematics.deflection_jacobian(terms),
            )
        return found[:, device]

    q = np.concatenate([t.q for t in trials])
    curvature = np.empty((len(q), len(device), len(device)))
    for i, column in enumerate(device):
        step = np.zeros(q.shape[1])
        step[column] = _STEP_RAD
        change = slope(q + step) - slope(q - step)
        curvature[:, :, i] = change / (2.0 * _STEP_RAD)
    # A cuff that slips has forces without a potential.
    curvature = 0.5 * (curvature + curvature.transpose(0, 2, 1))
    least, modes = np.linalg.eigh(curvature)
    worst = int(np.argmin(least[:, 0]))
    joint = names.device[int(np.argmax(np.abs(modes[worst, :, 0])))]
    return Hold(float(least[worst, 0]), joint)
