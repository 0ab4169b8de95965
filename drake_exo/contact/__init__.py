"""Force laws and their derivatives, and LeafSystems around them."""

from drake_exo.contact.bushing import (
    BushingParameters,
    bushing_deflection,
    bushing_force,
)
from drake_exo.contact.controllers import AssistController, TrackingController
from drake_exo.contact.hunt_crossley import paper_stiffness, sphere_force
from drake_exo.contact.parameters import ContactSphere, GroundContact
from drake_exo.contact.systems import (
    FootGroundContact,
    HumanExoskeletonBushings,
)

__all__ = [
    "AssistController",
    "BushingParameters",
    "ContactSphere",
    "FootGroundContact",
    "GroundContact",
    "HumanExoskeletonBushings",
    "TrackingController",
    "bushing_deflection",
    "bushing_force",
    "paper_stiffness",
    "sphere_force",
]
