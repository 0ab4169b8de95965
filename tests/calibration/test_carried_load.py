"""Phase A with a mass in the hands: as if the trunk weighed more."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.audit import audit
from drake_exo.calibration.phases import FootGroundCalibration
from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.measurement.kinematics import carried
from drake_exo.measurement.settings import Load
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory import synthetic

pytestmark = pytest.mark.slow

KG, AT = 8.0, (0.2, 0.4)


def lighter(human):
    """The person without a mass that is a part of the trunk."""
    trunk = human.pelvis
    mass = trunk.mass_kg - KG
    com = [
        (trunk.mass_kg * a - KG * b) / mass
        for a, b in zip(trunk.com_m, AT, strict=True)
    ]

    def off(p, q):
        return sum((a - b) ** 2 for a, b in zip(p, q, strict=True))

    inertia = trunk.inertia_kg_m2 - mass * off(com, trunk.com_m)
    inertia -= KG * off(AT, trunk.com_m)
    return replace(
        human,
        pelvis=replace(
            trunk, mass_kg=mass, com_m=tuple(com), inertia_kg_m2=inertia
        ),
    )


@pytest.fixture(scope="module")
def both():
    """Results of the heavier person, and of the lighter one who carries."""
    whole, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    bare = Model("human", lighter(whole.human))
    place = bare.tree.point_positions(trial.q, "pelvis", AT)
    load = Load("pelvis", mass_kg=KG, at_m=AT)
    wrench = carried(load, trial.times, place, bare.gravity_m_s2)
    loaded = replace(trial, applied={"pelvis": wrench})
    found = []
    for model, one in ((whole, trial), (bare, loaded), (bare, trial)):
        settings = FootGroundSettings()
        problem = FootGroundCalibration(model, [one], settings)
        found.append(problem.solve())
    return found


def test_a_carried_mass_is_as_a_heavier_trunk(both):
    heavy, carrying, without = (result.trials[0] for result in both)
    assert all(result.solution.success for result in both)
    force = heavy.ground.force_z
    assert np.abs(carrying.ground.force_z - force).max() < 2.0
    assert np.abs(without.ground.force_z - force).max() > 30.0
    for name in ("ankle", "knee", "hip"):
        off = carrying.moment(name) - heavy.moment(name)
        assert np.abs(off).max() < 1.5
    assert carrying.applied["pelvis"].force_z.mean() == pytest.approx(
        -KG * 9.81, rel=0.05
    )


def test_it_acts_in_the_simulation_and_between_nodes(both):
    found = audit(both[1])
    assert found.force_n < 1.0
    assert max(found.simulated_grf_n) < 1.0
