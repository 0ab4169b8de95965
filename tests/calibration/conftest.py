"""What several tests of the phases share: the human and twins of it."""

import pytest

from drake_exo.calibration.settings import (
    FootGroundSettings,
    Range,
    Solver,
    SphereSettings,
)
from drake_exo.model.description import nominal_human
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant
from drake_exo.virtual_laboratory.interaction_twin import interaction_twin


@pytest.fixture(scope="session")
def cuffs_twin():
    """Three exact trials with known cuffs, 50 nodes a second."""
    return interaction_twin()


@pytest.fixture(scope="session")
def tree():
    """The human without exoskeleton."""
    return PlanarTree.from_plant(build_plant("human"))


@pytest.fixture(scope="session")
def defaults():
    """Heel and toe of one material, 40 nodes a second."""
    sphere = SphereSettings(
        modulus_n_m2=Range(4e6, 5e5, 2e7), dissipation_s_m=Range(1.0, 0.0, 5.0)
    )
    return FootGroundSettings(
        heel=sphere, toe=sphere, solver=Solver(nodes_per_second=40.0)
    )


@pytest.fixture(scope="session")
def nominal(defaults):
    """Contact parameters of the nominal human's foot."""
    human = nominal_human()
    return defaults.parameters(human.heel_m, human.toe_m)
