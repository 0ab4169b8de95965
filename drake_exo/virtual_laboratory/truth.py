"""The subject as it really is, which no calibration may look at."""

from dataclasses import dataclass, fields, replace

import numpy as np

from drake_exo.contact.diagram import nominal_bushings
from drake_exo.contact.hunt_crossley import SimbodyConstants
from drake_exo.contact.parameters import (
    NOMINAL_DISSIPATION,
    NOMINAL_MODULUS,
    ContactParameters,
    ContactSphere,
    nominal_contact,
)
from drake_exo.model.description import fit_exoskeleton, nominal_human
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import GRAVITY, build_plant
from drake_exo.model.segments import (
    CONTACT_RADIUS_M,
    SEGMENTS,
    ExoskeletonParameters,
    HumanParameters,
)
from drake_exo.virtual_laboratory.control import Friction
from drake_exo.virtual_laboratory.forces import Cuff, levelled

STANDING_COP_M = 0.045  # in front of the ankle

# Simbody's law with next to no smoothing: contact begins and ends, and the
# foot sticks.
_SHARP = SimbodyConstants(
    transition_velocity=0.02,
    constant_contact_force=1e-8,
    hertz_smoothing=1e4,
    hunt_crossley_smoothing=1e3,
)
# Between heel (0) and toe (1); radius [m]; modulus, as a share.
_RICH_SOLE = {
    "calcaneus_back": (-0.08, 0.025, 0.45),
    "calcaneus_front": (0.10, 0.030, 0.50),
    "midfoot": (0.42, 0.035, 0.15),
    "metatarsals": (0.80, 0.030, 0.60),
    "toes": (1.08, 0.022, 0.40),
}
_CUFF_PROGRESSION = 1.0 / 0.02  # 1/m
_CUFF_SLIP = 1.0 / 25.0  # 1/N
_FRICTION = Friction(viscous=(0.3, 0.5, 0.5), coulomb=(0.8, 1.2, 1.5))


@dataclass(frozen=True)
class Truth:
    """True parameters of the subject, the device and their contacts.

    Attributes:
        human, exoskeleton: segments, sums over both legs.
        contact: foot-ground contact, spheres in the foot link.
        cuffs: between human and exoskeleton, by segment.
        friction: of the device's joints.
        gravity: [m/s^2].
    """

    human: HumanParameters
    exoskeleton: ExoskeletonParameters
    contact: ContactParameters
    cuffs: dict[str, Cuff]
    friction: Friction
    gravity: float = GRAVITY

    @property
    def weight(self) -> float:
        """Of human and exoskeleton [N]."""
        return (self.human.mass_kg + self.exoskeleton.mass_kg) * self.gravity


def draw_truth(rng: np.random.Generator, active: frozenset[str]) -> Truth:
    """Parameters off the nominal ones by what a calibration has to find.

    Stiffness and dissipation are within 35 % of nominal values, spheres
    within 12 mm along the foot, cuffs within 15 mm. The foot's frame is
    level in standing, as that of the markers is: spheres lie lower than
    nominal ones by what they sink in.

    Args:
        rng: numbers are drawn in the same order whatever is active.
        active: names of `disturbances.TRUTH` that act.
    """
    human = nominal_human()
    device = fit_exoskeleton(human)
    two, five = _two_spheres(device, rng), _five_spheres(device, rng)
    contact = five if "contact" in active else two
    cuffs = _cuffs(human, device, rng, active)
    masses = _other_masses(human, rng)
    truth = Truth(
        masses if "segments" in active else human,
        device,
        contact.checked(),
        cuffs,
        _FRICTION if "friction" in active else Friction(),
    )
    plant = build_plant("rigid", human, device)
    flat = levelled(
        PlanarTree.from_plant(plant),
        truth.contact,
        truth.weight,
        STANDING_COP_M,
        human.ankle_height_m,
    )
    return replace(truth, contact=flat)


def _two_spheres(device, rng) -> ContactParameters:
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
    return replace(usual, spheres=spheres)


def _five_spheres(device, rng) -> ContactParameters:
    heel, toe = np.array(device.heel_m), np.array(device.toe_m)
    sole = heel[1] - CONTACT_RADIUS_M
    spheres = {}
    for name, (at, radius, share) in _RICH_SOLE.items():
        spheres[name] = ContactSphere(
            float(heel[0] + at * (toe[0] - heel[0]))
            + rng.uniform(-0.006, 0.006),
            float(sole + radius) + rng.uniform(-0.001, 0.001),
            radius,
            share * NOMINAL_MODULUS * _factor(rng),
            NOMINAL_DISSIPATION * _factor(rng),
        )
    return ContactParameters("simbody", spheres, _SHARP)


def _cuffs(human, device, rng, active) -> dict[str, Cuff]:
    cuffs = {}
    for name, bushing in nominal_bushings(human, device).items():
        stiffness = {
            f.name: getattr(bushing, f.name) * _factor(rng)
            for f in fields(bushing)
            if f.name.endswith("_stiffness")
        }
        bushing = replace(
            bushing,
            origin_x=bushing.origin_x + rng.uniform(-0.015, 0.015),
            origin_z=bushing.origin_z + rng.uniform(-0.015, 0.015),
            **stiffness,
        )
        cuffs[name] = Cuff(
            bushing,
            _CUFF_PROGRESSION if "progressive" in active else 0.0,
            _CUFF_SLIP if "shear" in active else 0.0,
        )
    return cuffs


def _other_masses(human: HumanParameters, rng) -> HumanParameters:
    """The same body mass, shared out in another way."""
    names = [name for name in SEGMENTS if name != "pelvis"]
    parts = {name: getattr(human, name) for name in names}
    factors = {name: rng.uniform(0.97, 1.03) for name in names}
    rest = sum((1.0 - factors[n]) * parts[n].mass_kg for n in names)
    parts["pelvis"] = human.pelvis
    factors["pelvis"] = 1.0 + rest / human.pelvis.mass_kg
    return replace(
        human,
        **{
            name: replace(
                part,
                mass_kg=factors[name] * part.mass_kg,
                inertia_kg_m2=factors[name] * part.inertia_kg_m2,
            )
            for name, part in parts.items()
        },
    )


def _factor(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(0.74), np.log(1.35))))
