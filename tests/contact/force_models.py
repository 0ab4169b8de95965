"""Diagrams with parameters none of which is a default, and random states."""

from dataclasses import astuple, replace

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.hunt_crossley import PaperConstants, SimbodyConstants
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
)
from drake_exo.model.plant import nominal_model


def unusual_ground(law):
    """Parameters none of which is a default."""
    constants = PaperConstants() if law == "paper" else SimbodyConstants()
    factors = np.linspace(0.8, 1.2, len(astuple(constants)))
    constants = type(constants)(*(factors * astuple(constants)))
    if law == "simbody":
        constants = replace(constants, friction_rounding=0.3)
    stiffness = 1.3e4 if law == "paper" else 4e6
    return GroundContact(
        law,
        {
            "heel": ContactSphere(stiffness, 1.5, -0.04, -0.06, 0.035),
            "ball": ContactSphere(0.8 * stiffness, 2.5, 0.12, -0.05, 0.030),
            "toe": ContactSphere(1.1 * stiffness, 0.0, 0.17, -0.055, 0.025),
        },
        constants,
    )


def unusual_bushings():
    return {
        name: BushingParameters(
            origin_x=-0.03 + 0.01 * i,
            origin_z=0.2 + 0.05 * i,
            tangential_stiffness=1500.0 + 100.0 * i,
            normal_stiffness=4000.0 + 300.0 * i,
            rotational_stiffness=40.0 + 5.0 * i,
            tangential_damping=11.0 + i,
            normal_damping=14.0 + i,
            rotational_damping=0.2 + 0.1 * i,
            preload_x=0.002 + 0.001 * i,
            preload_z=-0.001 * i,
            preload_angle=0.01 * i,
        )
        for i, name in enumerate(("shank", "thigh", "pelvis"))
    }


def unusual_contact(law):
    return ContactModel(unusual_ground(law), unusual_bushings())


def coupled(law):
    return build_diagram(nominal_model("coupled"), unusual_contact(law))


def random_state(model, seed):
    """A state with the foot in the ground, in a context of the diagram."""
    rng = np.random.default_rng(seed)
    context = model.diagram.CreateDefaultContext()
    q = rng.uniform(-0.3, 0.3, 9)
    q[1] = rng.uniform(0.06, 0.1)
    plant_context = model.plant_context(context)
    model.plant.SetPositions(plant_context, q)
    model.plant.SetVelocities(plant_context, rng.uniform(-0.5, 0.5, 9))
    return context


def body_state(plant, plant_context, name):
    """Planar pose and motion of a body, from the plant's own kinematics."""
    body = plant.GetBodyByName(name)
    X_WB = body.EvalPoseInWorld(plant_context)
    V_WB = body.EvalSpatialVelocityInWorld(plant_context)
    R_WB = X_WB.rotation().matrix()
    pose = (*X_WB.translation()[[0, 2]], np.arctan2(R_WB[2, 0], R_WB[0, 0]))
    motion = (*V_WB.translational()[[0, 2]], -V_WB.rotational()[1])
    return np.array(pose), np.array(motion)


def generalized_force(model, context, spatial_forces):
    """Of spatial forces, by the plant's Jacobians."""
    plant, plant_context = model.plant, model.plant_context(context)
    total = np.zeros(plant.num_velocities())
    for entry in spatial_forces:
        body = plant.get_body(entry.body_index)
        jacobian = plant.CalcJacobianSpatialVelocity(
            plant_context,
            JacobianWrtVariable.kV,
            body.body_frame(),
            entry.p_BoBq_B,
            plant.world_frame(),
            plant.world_frame(),
        )
        total += jacobian.T @ entry.F_Bq_W.get_coeffs()
    return total
