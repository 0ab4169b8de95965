"""Whether a device hangs loose, against Drake's own plant and bushings."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration.design_cuffs import hold
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import nominal_contact
from drake_exo.contact.strap import CuffDesign, Design
from drake_exo.model.plant import nominal_model

# Of 9: foot, then ankle, knee, hip, then the device's, a little off.
BENT = np.deg2rad([0.0, 0.0, 2.0, 18.0, 85.0, 70.0, 19.0, 83.0, 71.0])
POSTURES = np.array([BENT, 0.3 * BENT])


def least(model, contact):
    """Of the second differences of the energy by the device's joints.

    That of gravity and the cuffs' springs, by the systems of a diagram.
    """
    built = build_diagram(model, contact)
    context = built.diagram.CreateDefaultContext()
    own = built.plant_context(context)

    def energy(q):
        built.plant.SetPositions(own, q)
        springs = built.diagram.GetOutputPort("energies").Eval(context)
        return built.plant.CalcPotentialEnergy(own) + springs.sum()

    h, found = 1e-3, []
    steps = h * np.eye(9)[6:]
    for q in POSTURES:
        H = np.array(
            [
                [
                    sum(
                        a * b * energy(q + a * s + b * t)
                        for a in (1, -1)
                        for b in (1, -1)
                    )
                    for s in steps
                ]
                for t in steps
            ]
        )
        found.append(np.linalg.eigvalsh(H / (4.0 * h * h))[0])
    return min(found)


@pytest.mark.parametrize("removed", [(), ("shank",), ("shank", "thigh")])
def test_curvature_is_that_of_the_energy_in_drake(removed):
    fewer = Design(dict.fromkeys(removed, CuffDesign(removed=True)))
    model = nominal_model("coupled")
    contact = fewer.contact(nominal_contact(model))
    model = fewer.model(model)
    held = hold(model, contact, [SimpleNamespace(q=POSTURES)])
    expected = least(model, contact)
    assert held.stiffness == pytest.approx(expected, rel=1e-3, abs=0.05)


def test_a_link_that_no_cuff_holds_falls():
    model = nominal_model("coupled")
    contact = nominal_contact(model)
    postures = [SimpleNamespace(q=POSTURES)]
    whole = hold(model, contact, postures)
    contact.bushings.pop("pelvis")
    loose = hold(model, contact, postures)
    assert whole.stiffness > 0.0 > loose.stiffness
    assert loose.joint == "exo_hip"
