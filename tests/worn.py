"""A wearer at once: a drawn rise whose torques and forces nothing solved."""

from dataclasses import fields, replace

import numpy as np
import pytest

from drake_exo.calibration import design as posed
from drake_exo.calibration.settings import CuffFreedom, JointFreedom
from drake_exo.calibration.uncertainty import Bands
from drake_exo.calibration.wearers import Wearer
from drake_exo.contact.parameters import nominal_contact
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import Model
from drake_exo.nlp.ipopt import Solution
from drake_exo.virtual_laboratory.synthetic import Rise, draw

# Largest torque of each joint of the device.
TORQUES_NM = {"exo_ankle": 0.5, "exo_knee": -20.0, "exo_hip": -12.0}
# Largest force of each cuff: along, across, and its moment.
FORCES = {
    "shank": (8.0, 20.0, 1.0),
    "thigh": (-5.0, -30.0, 2.0),
    "pelvis": (4.0, 25.0, -1.5),
}
_CM = (-0.01, 0.01)
# Whatever may change, but assistance.
FREEDOM = {
    "cuffs": dict.fromkeys(
        FORCES,
        CuffFreedom(
            across_m=_CM,
            preload_across_m=_CM,
            preload_along_m=_CM,
            area=(0.8, 1.2),
            slide=(0.0, 1.0),
            hinge=(0.0, 1.0),
        ),
    ),
    "joints": dict.fromkeys(("exo_knee", "exo_hip"), JointFreedom(_CM, _CM)),
}


def trial(model: Model, duration_s=1.5) -> Trial:
    """Torques and forces grow from nothing and fade."""
    drawn = draw(model.tree, Rise("rise", duration_s))
    s = np.sin(np.pi * drawn.times / drawn.duration) ** 2
    forces = model.tree.inverse_dynamics(drawn.q, drawn.v, drawn.a)
    names = drawn.coordinates
    moments = forces[:, names.joint_columns]
    for joint, torque in TORQUES_NM.items():
        moments[:, names.joint(joint)] = torque * s
    cuffs = {c: CuffForce.of(np.outer(s, FORCES[c])) for c in model.cuffs}
    return replace(drawn, moments=moments, cuffs=cuffs)


def wearer(model: Model, name="somebody", duration_s=1.5) -> Wearer:
    """In the nominal contact."""
    contact = nominal_contact(model)
    return Wearer(name, model, contact, (trial(model, duration_s),))


def norm_of(trials, settings, design=None, differ=()):
    """The norm of somebody's trials on a design."""
    who = Wearer("somebody", None, None, tuple(trials), differ=dict(differ))
    return posed.norm_of(who, settings, design)


def each(wearer: Wearer, what: str) -> dict:
    """Cuff -> what a method of the wearer says of it."""
    return {c: getattr(wearer, what)(c) for c in wearer.contact.bushings}


def as_guessed(problem):
    """The result of a solver that leaves a design's program as it is."""

    def solve(compiled, guess, options, on_iterate):
        cost = compiled.objective(compiled.restrict(guess))
        values = np.array(guess)
        return Solution(
            True,
            "",
            0,
            cost,
            0.0,
            [],
            0,
            0,
            0,
            seconds={"solve": 0.0},
            _values=values,
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drake_exo.calibration.design.ipopt.solve", solve)
        return problem.solve()


def bands_of(cuffs, mats) -> Bands:
    """Bands of which half widths of cuffs and mats alone are looked at."""
    nothing = dict.fromkeys(f.name for f in fields(Bands))
    return Bands(**nothing | {"cuffs": cuffs, "mats": mats})
