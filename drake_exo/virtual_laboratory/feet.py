"""The foot at rest on the ground, and the frame in which it is level."""

from dataclasses import replace

import numpy as np

from drake_exo.forces.contact_parameters import ContactParameters
from drake_exo.planar_tree import PlanarTree
from drake_exo.virtual_laboratory.loads import ground_wrench

_DIFFERENCE = 1e-6
_NEWTON_STEPS = 60
_LARGEST_STEP = 2e-3  # m or rad
_FIRST_DEPTH_M = 5e-3
_PASSES = 3


def resting_foot(
    tree: PlanarTree,
    contact: ContactParameters,
    load: np.ndarray,
    cop_m: float,
) -> np.ndarray:
    """Foot coordinates x = 0, z, pitch (n, 3) under vertical loads (n,) [N].

    Args:
        tree: a model with that foot.
        contact: of the foot with the ground.
        load: borne at rest.
        cop_m: centre of pressure in front of the ankle.
    """
    q = np.zeros((len(load), tree.num_positions))
    spheres = contact.spheres.values()
    q[:, 1] = np.mean([s.radius - s.z for s in spheres]) - _FIRST_DEPTH_M
    wanted = np.column_stack([load, -cop_m * load])

    def excess(q):
        w = ground_wrench(tree, contact, q, np.zeros_like(q))
        return np.column_stack([w.force[:, 1], w.moment]) - wanted

    for _ in range(_NEWTON_STEPS):
        r, J = excess(q), np.empty((len(load), 2, 2))
        for k in (0, 1):
            moved = q.copy()
            moved[:, 1 + k] += _DIFFERENCE
            J[:, :, k] = (excess(moved) - r) / _DIFFERENCE
        step = -np.linalg.solve(J, r[:, :, None])[:, :, 0]
        q[:, 1:3] += np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        if np.abs(step).max() < 1e-9:
            break
    return q[:, :3]


def levelled(
    tree: PlanarTree,
    contact: ContactParameters,
    weight: float,
    cop_m: float,
    ankle_height: float,
) -> ContactParameters:
    """The same soles in a foot frame that is level in quiet standing.

    That is the frame which markers give, so truth and measurement agree.
    """
    for _ in range(_PASSES):
        foot = resting_foot(tree, contact, np.array([weight]), cop_m)
        _, z, pitch = foot[0]
        c, s = np.cos(pitch), np.sin(pitch)
        spheres = {
            name: replace(
                sphere,
                x=float(c * sphere.x - s * sphere.z),
                z=float(z + s * sphere.x + c * sphere.z - ankle_height),
            )
            for name, sphere in contact.spheres.items()
        }
        contact = replace(contact, spheres=spheres)
    return contact
