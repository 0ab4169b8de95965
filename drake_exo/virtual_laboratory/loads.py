"""Forces on the links along a motion, all samples at once.

The same laws as the diagram's systems call, evaluated on recorded states.
"""

from dataclasses import astuple

import numpy as np

from drake_exo.forces.bushing import bushing_deflection, bushing_wrench
from drake_exo.forces.contact_parameters import ContactParameters
from drake_exo.forces.contact_system import foot_contact
from drake_exo.laboratory.inverse_dynamics import wrench_on_body
from drake_exo.laboratory.sagittal import PlanarWrench
from drake_exo.planar_tree import PlanarTree
from drake_exo.virtual_laboratory.cuffs import Cuff, cuff_force
from drake_exo.virtual_laboratory.seat import SeatParameters, seat_wrench


def link_motion(tree: PlanarTree, q, v, body: str):
    """Pose and motion of a link.

    Args:
        tree: the model.
        q, v: (N, nq).
        body: name of the link.

    Returns:
        Position (2, N) [m], angle (N,) [rad] and (v_x, v_z, rate) (3, N).
    """
    J = tree.point_jacobian(q, body, (0.0, 0.0))
    segment = tree.segment_of[tree.body_index(body)]
    rate = v[:, 2:] @ tree.angle_map[segment]
    velocity = np.einsum("nij,nj->in", J, v)
    return (
        tree.point_positions(q, body, (0.0, 0.0)).T,
        tree.body_angles(q, body),
        np.vstack([velocity, rate]),
    )


def ground_wrench(
    tree: PlanarTree, contact: ContactParameters, q, v
) -> PlanarWrench:
    """Ground reaction (N,) on the foot."""
    position, angle, motion = link_motion(tree, q, v, "foot")
    wrench = foot_contact(
        contact.law,
        position[:, :, None],
        np.array([np.cos(angle), np.sin(angle)])[:, :, None],
        motion[:, :, None],
        np.array([astuple(s) for s in contact.spheres.values()]).T[:, None],
        contact.constants,
    )
    return _total(wrench)


def chair_wrench(
    tree: PlanarTree, seat: SeatParameters | None, q, v
) -> PlanarWrench:
    """Force of the chair (N,) on the pelvis; none without a chair."""
    if seat is None:
        return PlanarWrench(np.zeros((len(q), 2)), np.zeros(len(q)))
    position, angle, motion = link_motion(tree, q, v, "pelvis")
    direction = np.array([np.cos(angle), np.sin(angle)])
    wrench = seat_wrench(seat, position, direction, motion)
    return _total(type(wrench)(*(w[:, None] for w in wrench)))


def interaction(
    tree: PlanarTree, cuffs: dict[str, Cuff], q, v
) -> tuple[np.ndarray, dict[str, PlanarWrench]]:
    """Cuff forces along a motion.

    Returns:
        Tangential, normal and rotational component (N, 3 * cuffs) on the
        human as `HumanExoskeletonBushings` reports them, and the wrench
        on the human by segment.
    """
    components, wrenches = [], {}
    for name, cuff in cuffs.items():
        bushing = cuff.bushing
        links = []
        for body in (name, f"exo_{name}"):
            position, angle, motion = link_motion(tree, q, v, body)
            links.append(((*position, angle), motion))
        (human, human_motion), (device, device_motion) = links
        deflection, rate = bushing_deflection(
            human,
            human_motion,
            device,
            device_motion,
            bushing.origin,
            bushing.preload,
        )
        force = cuff_force(cuff, deflection, rate)
        w = bushing_wrench(
            force, human, device, bushing.origin, bushing.preload
        )
        # The law's moments are toes-up positive, M_y is the opposite.
        wrenches[name] = PlanarWrench(
            np.column_stack([w.force_x, w.force_z]),
            w.point_z * w.force_x - w.point_x * w.force_z - w.moment,
        )
        components.extend(force)
    return np.column_stack(components), wrenches


def applied(
    tree: PlanarTree,
    contact: ContactParameters,
    cuffs: dict[str, Cuff],
    seat: SeatParameters | None,
    q,
    v,
) -> np.ndarray:
    """Generalized forces (N, 9) of ground, chair and cuffs together."""
    loads = wrench_on_body(tree, q, "foot", ground_wrench(tree, contact, q, v))
    loads += wrench_on_body(tree, q, "pelvis", chair_wrench(tree, seat, q, v))
    for name, w in interaction(tree, cuffs, q, v)[1].items():
        back = PlanarWrench(-w.force, -w.moment)
        loads += wrench_on_body(tree, q, name, w)
        loads += wrench_on_body(tree, q, f"exo_{name}", back)
    return loads


def _total(wrench) -> PlanarWrench:
    """Sum over the last axis, moment about the origin."""
    moment = wrench.point_z * wrench.force_x - wrench.point_x * wrench.force_z
    force = np.stack([wrench.force_x, wrench.force_z], axis=-2)
    return PlanarWrench(force.sum(axis=-1), moment.sum(axis=-1))
