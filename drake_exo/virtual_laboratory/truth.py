"""True parameters of the virtual subject, which no calibration reads."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from drake_exo.contact.bushing import COMPONENTS
from drake_exo.contact.hunt_crossley import SimbodyConstants
from drake_exo.contact.parameters import (
    NOMINAL_DISSIPATION,
    NOMINAL_MODULUS,
    ContactSphere,
    GroundContact,
    nominal_contact,
)
from drake_exo.contact.strap import Design
from drake_exo.errors import InputError, check_names
from drake_exo.files.output import write_json
from drake_exo.files.tables import Table
from drake_exo.measurement.trial import Trial
from drake_exo.model.description import fit_exoskeleton
from drake_exo.model.plant import Model, nominal_model
from drake_exo.model.segments import CONTACT_RADIUS_M, SEGMENTS, HumanParameters
from drake_exo.virtual_laboratory.forces import Cuff, levelled
from drake_exo.virtual_laboratory.plan import Friction

# How far true parameters may be from the nominal ones of a calibration.
KINDS = ("wide", "near")
# Disturbances make the truth richer than the model, and measurements worse.
# Each can be switched off by name. Without any, the subject obeys the model
# that is calibrated, and instruments are perfect. Those of subject and device:
TRUTH = {
    "contact": "soles of five spheres without smoothing",
    "progressive": "cuffs that stiffen with deflection",
    "shear": "cuffs that slip along the limb beyond 25 N",
    "friction": "dry and viscous friction in the device's joints",
    "segments": "masses that differ by up to 3 % from the table",
    "variation": "posture, duration and load differ between movements",
}
# Disturbances of the instruments.
MEASUREMENT = {
    "marker_noise": "0.3 mm white noise on every marker coordinate",
    "soft_tissue": "markers that slide millimetres on the skin",
    "gaps": "markers that are hidden for up to 0.12 s",
    "plate_noise": "0.5 N and 0.2 N m white noise on every plate",
    "plate_drift": "plates with an offset of some newtons that drifts",
    "encoder_noise": "0.02 degree and 0.1 N m of noise in the device",
    "pressure_steps": "pressure in steps of 2.5 kPa, up to 30 kPa",
    "clocks": "device and mats that start up to 40 ms apart",
}
# Disturbances of a wide truth alone, in subject and instruments.
WIDE = {
    "body": "lengths up to 4 %, centres of mass 3 % off the table",
    "legs": "legs that bear and press unequally, by up to 5 %",
    "bench": "friction of the device known to 50 %",
    "encoder_offset": "encoders with an offset of up to 3 degrees",
    "mat_share": "mats that see 85 to 100 % of the force",
    "windows": "trials cut where noisy signals say so",
}
DISTURBANCES = {**TRUTH, **MEASUREMENT, **WIDE}
STANDING_COP_M = 0.045  # in front of the ankle

# Simbody's law with next to no smoothing: contact begins and ends, and the
# foot sticks.
_SHARP = SimbodyConstants(
    transition_velocity=0.02,
    constant_contact_force=1e-8,
    hertz_smoothing=1e4,
    hunt_crossley_smoothing=1e3,
)
# Place from heel (0) to toe (1); radius [m]; share of the nominal modulus.
_RICH_SOLE = {
    "calcaneus_back": (-0.08, 0.025, 0.45),
    "calcaneus_front": (0.10, 0.030, 0.50),
    "midfoot": (0.42, 0.035, 0.15),
    "metatarsals": (0.80, 0.030, 0.60),
    "toes": (1.08, 0.022, 0.40),
}
_COM_SHIFT = 0.03  # largest shift along the segment, share of its length
_COM_SHIFT_M = 0.008  # largest shift across it
_LENGTH = 0.04  # largest change of a length, as a share
_CUFF_PROGRESSION = 1.0 / 0.02  # 1/m
_CUFF_SLIP = 1.0 / 25.0  # 1/N
JOINT_FRICTION = Friction(viscous=(0.3, 0.5, 0.5), coulomb=(0.8, 1.2, 1.5))


def checked(names: Iterable[str]) -> frozenset[str]:
    """Names of disturbances as a set.

    Raises:
        InputError: a name is unknown, or `names` is a single string.
    """
    names = names if isinstance(names, str) else tuple(names)
    try:
        check_names(names, DISTURBANCES)
    except InputError as error:
        raise InputError(f"disturbances: {error}") from None
    return frozenset(names)


# Ranges that cuffs are drawn from: stiffness and damping log-uniform between
# these multiples of nominal values, the origin uniform about its own [m]. Wide
# ones are not centred, so that a prior about nominal values is not the truth's.
_WIDE_SHARES = (1.3 / 3.3, 1.3 * 3.3)
_CUFFS: dict[str, dict[str, tuple[float, float]]] = {
    "near": {"stiffness": (0.74, 1.35), "origin": (-0.015, 0.015)},
    "wide": {
        "stiffness": _WIDE_SHARES,
        "damping": _WIDE_SHARES,
        "origin": (-0.022, 0.038),
    },
}


@dataclass(frozen=True)
class Truth:
    """True parameters of the subject, the device and their contacts.

    Attributes:
        model: subject and device, sums over both legs.
        contact: foot-ground contact, spheres in the foot link.
        cuffs: between human and exoskeleton, by name.
        friction: of the device's joints.
        design: design that is worn, already part of `model` and `cuffs`.
    """

    model: Model
    contact: GroundContact
    cuffs: dict[str, Cuff]
    friction: Friction
    design: Design = field(default_factory=Design)

    @property
    def human(self) -> HumanParameters:
        """The subject."""
        return self.model.human


def draw_truth(
    rng: np.random.Generator, active: frozenset[str], kind: str = "wide"
) -> Truth:
    """Draw true parameters about the nominal ones.

    The feet's stiffness and dissipation are within 35 % of nominal values,
    spheres within 12 mm along the foot. Cuffs are drawn from `_CUFFS`.
    The foot's frame is level and at the ankle's height in standing, like that
    of the markers, so spheres lie lower than nominal ones by their indentation.

    Args:
        rng: numbers are drawn in the same order whatever is active.
        active: names of `TRUTH` that act.
        kind: a name in KINDS.
    """
    nominal = nominal_model("coupled")
    if kind == "wide":
        other = _other_body(nominal, rng)
        nominal = other if "body" in active else nominal
    usual, human = nominal_contact(nominal), nominal.human
    two = two_spheres(usual.ground, rng)
    five = five_spheres(nominal.exoskeleton, rng)
    contact = (five if "contact" in active else two).checked()
    cuffs = drawn_cuffs(usual.bushings, rng, active, kind)
    masses = other_masses(human, rng)
    flat = levelled(
        nominal.rigid.tree,
        contact,
        nominal.tree.weight,
        STANDING_COP_M,
        human.ankle_height_m,
    )
    if "segments" in active:
        nominal = replace(nominal, human=masses)
    friction = JOINT_FRICTION if "friction" in active else Friction()
    return Truth(nominal, flat, cuffs, friction)


def wearing(truth: Truth, design: Design) -> Truth:
    """The same subject wearing a design; the tissue under cuffs is the same.

    Stiffness at small deflection is that of tissue and strap in series;
    stiffening and slip of the cuffs stay.

    Raises:
        InputError: the design does not fit the device.
    """
    design.check(truth.model)
    built = design.bushings({n: c.bushing for n, c in truth.cuffs.items()})
    cuffs = {
        name: replace(cuff, bushing=built[name])
        for name, cuff in truth.cuffs.items()
        if name in built
    }
    model = design.model(truth.model)
    return replace(truth, model=model, cuffs=cuffs, design=design)


def two_spheres(usual: GroundContact, rng) -> GroundContact:
    """The model's two spheres, with other values drawn."""
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


def five_spheres(device, rng) -> GroundContact:
    """Five spheres between heel_m and toe_m of a device or a person."""
    heel, toe = np.array(device.heel_m), np.array(device.toe_m)
    sole = heel[1] - CONTACT_RADIUS_M
    spheres = {}
    for name, (at, radius, share) in _RICH_SOLE.items():
        x = float(heel[0] + at * (toe[0] - heel[0]))
        # Drawn in this order: place, stiffness, dissipation.
        x += rng.uniform(-0.006, 0.006)
        z = float(sole + radius) + rng.uniform(-0.001, 0.001)
        spheres[name] = ContactSphere(
            stiffness=share * NOMINAL_MODULUS * _factor(rng),
            dissipation=NOMINAL_DISSIPATION * _factor(rng),
            x=x,
            z=z,
            radius=radius,
        )
    return GroundContact("simbody", spheres, _SHARP)


def drawn_cuffs(usual, rng, active, kind: str) -> dict[str, Cuff]:
    """Cuffs with values drawn about those of the usual bushings."""
    cuffs, draw = {}, _CUFFS[kind]
    for name, bushing in usual.items():
        values = {
            f.name: getattr(bushing, f.name) * _factor(rng, *shares)
            for what, shares in draw.items()
            for f in fields(bushing)
            if f.name.endswith(f"_{what}")
        }
        bushing = replace(
            bushing,
            origin_x=bushing.origin_x + rng.uniform(*draw["origin"]),
            origin_z=bushing.origin_z + rng.uniform(*draw["origin"]),
            **values,
        )
        cuffs[name] = Cuff(
            bushing,
            _CUFF_PROGRESSION if "progressive" in active else 0.0,
            _CUFF_SLIP if "shear" in active else 0.0,
        )
    return cuffs


def _other_body(model: Model, rng) -> Model:
    """Lengths and centres of mass drawn anew, and the device fitted."""
    human = model.human
    parts = {}
    for name in SEGMENTS:
        part = getattr(human, name)
        # Not the foot, which is measured and welded to the device's.
        ratio = 1.0 + (name != "foot") * rng.uniform(-_LENGTH, _LENGTH)
        x, z = part.com_m
        along = rng.uniform(-_COM_SHIFT, _COM_SHIFT) * part.length_m
        across = rng.uniform(-_COM_SHIFT_M, _COM_SHIFT_M)
        if name == "foot":
            along = across = 0.0
        parts[name] = replace(
            part,
            length_m=ratio * part.length_m,
            com_m=(x + across, ratio * z + along),
            inertia_kg_m2=ratio**2 * part.inertia_kg_m2,
        )
    human = replace(human, **parts)
    return replace(model, human=human, exoskeleton=fit_exoskeleton(human))


def other_masses(human: HumanParameters, rng) -> HumanParameters:
    """Legs' masses drawn within 3 %; the pelvis keeps the body mass."""
    names = [name for name in SEGMENTS if name != "pelvis"]
    parts = {name: getattr(human, name) for name in names}
    factors = {name: rng.uniform(0.97, 1.03) for name in names}
    rest = sum((1.0 - factors[n]) * parts[n].mass_kg for n in names)
    parts["pelvis"] = human.pelvis
    factors["pelvis"] = 1.0 + rest / human.pelvis.mass_kg
    return replace(
        human, **{n: part.heavier(factors[n]) for n, part in parts.items()}
    )


def _factor(
    rng: np.random.Generator, low: float = 0.74, high: float = 1.35
) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def write_parameters(folder: Path, truth: Truth, about: dict) -> None:
    """Write the truth, and the true parameters of Phases A and B by name.

    Args:
        folder: receives truth.json, foot_ground.json and interaction.json.
        truth: the parameters.
        about: entries on the campaign, repeated in every file.
    """
    whole = {
        "human": truth.human,
        "exoskeleton": truth.model.exoskeleton,
        "contact": truth.contact,
        "cuffs": truth.cuffs,
        "friction": truth.friction,
        "gravity": truth.model.gravity_m_s2,
    }
    write_json(folder / "truth.json", {**about, "parameters": whole})
    # In a phase slip is the bushing's parameter, in the laboratory the cuff's.
    cuffs = {n: replace(c.bushing, slip=c.slip) for n, c in truth.cuffs.items()}
    for name, contacts in (
        ("foot_ground", truth.contact.spheres),
        ("interaction", cuffs),
    ):
        values = {
            f"{part}.{key}": value
            for part, contact in contacts.items()
            for key, value in vars(contact).items()
        }
        write_json(folder / f"{name}.json", {**about, "parameters": values})


def truth_table(movement: Trial, step: int = 1) -> Table:
    """Table of motion, joint torques and forces in SI units.

    Args:
        movement: the true movement.
        step: only every `step`-th sample is kept.
    """
    names = movement.coordinates
    columns, values = [], []
    for suffix, x in (
        ("", movement.q),
        ("_speed", movement.v),
        ("_acceleration", movement.a),
    ):
        columns += [name + suffix for name in names.names]
        values.append(x)
    columns += [f"{name}_torque" for name in names.joints]
    values.append(movement.moments)
    borne = {"ground": movement.ground, **movement.feet}
    for place, w in (*borne.items(), ("chair", movement.chair)):
        columns += [f"{place}_{k}" for k in ("force_x", "force_z", "moment_y")]
        values.append(w.array)
    for cuff, force in movement.cuffs.items():
        columns += [f"{cuff}_{component}" for component in COMPONENTS]
        values.append(force.components)
    table = np.hstack(values)[::step]
    return Table(movement.times[::step], tuple(columns), table, False)
