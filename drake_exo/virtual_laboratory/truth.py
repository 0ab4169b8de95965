"""The subject as it really is, which no calibration may look at."""

from dataclasses import dataclass, replace

import numpy as np

from drake_exo.description import fit_exoskeleton, nominal_human
from drake_exo.forces.bushing import BushingParameters
from drake_exo.forces.contact_parameters import (
    ContactParameters,
    ContactSphere,
    nominal_contact,
)
from drake_exo.forces.diagram import nominal_bushings
from drake_exo.forces.hunt_crossley import hertz_factor
from drake_exo.plant import GRAVITY
from drake_exo.segments import (
    CONTACT_RADIUS_M,
    ExoskeletonParameters,
    HumanParameters,
)

STANDING_COP_M = 0.045  # in front of the ankle

_STIFFNESSES = (
    "tangential_stiffness",
    "normal_stiffness",
    "rotational_stiffness",
)


@dataclass(frozen=True)
class Truth:
    """True parameters of the subject, the device and their contacts.

    Attributes:
        human, exoskeleton: segments, sums over both legs.
        contact: foot-ground contact, spheres in the foot link.
        bushings: between human and exoskeleton, by segment.
        gravity: [m/s^2].
    """

    human: HumanParameters
    exoskeleton: ExoskeletonParameters
    contact: ContactParameters
    bushings: dict[str, BushingParameters]
    gravity: float = GRAVITY


def draw_truth(rng: np.random.Generator) -> Truth:
    """Parameters off the nominal ones by what a calibration has to find.

    Stiffness and dissipation are within 35 % of nominal values, spheres
    within 12 mm along the foot, cuffs within 15 mm. The foot's frame is
    level in standing, as that of the markers is: spheres lie lower than
    nominal ones by what they sink in.
    """
    human = nominal_human()
    device = fit_exoskeleton(human)
    usual = nominal_contact(
        "simbody", device.heel_m, device.toe_m, CONTACT_RADIUS_M
    )
    spheres = {
        name: replace(
            sphere,
            x=sphere.x + rng.uniform(-0.012, 0.012),
            stiffness=sphere.stiffness * _factor(rng),
            dissipation=sphere.dissipation * _factor(rng),
        )
        for name, sphere in usual.spheres.items()
    }
    spheres = _levelled(spheres, (human.mass_kg + device.mass_kg) * GRAVITY)
    bushings = {}
    for name, bushing in nominal_bushings(human, device).items():
        stiffness = {
            key: getattr(bushing, key) * _factor(rng) for key in _STIFFNESSES
        }
        bushings[name] = replace(
            bushing,
            origin_x=bushing.origin_x + rng.uniform(-0.015, 0.015),
            origin_z=bushing.origin_z + rng.uniform(-0.015, 0.015),
            **stiffness,
        )
    contact = ContactParameters(usual.law, spheres, usual.constants)
    return Truth(human, device, contact.checked(), bushings)


def _levelled(spheres, weight: float) -> dict[str, ContactSphere]:
    """Heel and toe so deep that the standing foot is level."""
    heel, toe = spheres["heel"], spheres["toe"]
    on_toe = (STANDING_COP_M - heel.x) / (toe.x - heel.x)
    loads = {"heel": (1.0 - on_toe) * weight, "toe": on_toe * weight}
    deeper = {}
    for name, load in loads.items():
        s = spheres[name]
        factor = hertz_factor("simbody", s.stiffness, s.radius)
        depth = float((load / factor) ** (2.0 / 3.0))
        deeper[name] = replace(s, z=s.z - depth)
    return deeper


def _factor(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(0.74), np.log(1.35))))
